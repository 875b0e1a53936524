"""Notebooks: execute them, keep small outputs, compare what comes out with what is stored.

python tests/fakes/notebooks.py NAME...    # execute and store; without a name all of them
"""

import base64
import io
import os
import re
import shutil
import sys
import tempfile
from html import unescape
from itertools import zip_longest
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = ROOT / "notebooks"
# In reading order, each with the notebook whose fit it reads.
ORDER = {
    "01-first-fit": None, "02-your-own-drops": None, "03-your-own-motor": None, "04-python": None,
    "05-landing-maps": None, "06-which-digits-to-believe": "01-first-fit",
    "07-numbers-for-simulators": "03-your-own-motor", "08-a-model-of-your-own": None, "the-model": None,
    "fit-report-gear": "06-which-digits-to-believe", "fit-report-motor": "03-your-own-motor",
}  # fmt: skip
# A notebook takes no longer [s]; the limit of a cell leaves room for a busy machine.
_LIMIT = 60
# Numbers agree within this share of their size, or within two of their last printed digit.
TOLERANCE = 0.02
_WIDEST, _COLOURS = 1000, 256
_NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
# What differs between machines and days: instants, time that passed, addresses, hashes, folders.
_MASKS = (
    (re.compile(r"\d{4}-\d\d-\d\d(?:[T ][\d:.]+(?:Z|[+-]\d\d:\d\d)?)?"), "DATE"),
    (re.compile(r"\b(?:0x)?[0-9a-f]{10,}\b"), "HASH"),
    (re.compile(r"\b(?:took|in|after) [\d.]+ (?:s|min)\b"), "TIME"),
    (re.compile(r"(?:/[\w.+-]+){2,}"), "PATH"),
    # Values of what the data do not determine, and where a search happened to look.
    (re.compile(r"\S+ (?=\S+ -inf )"), "VALUE "),
    (re.compile(r"sets from \S+ to \S+"), "sets from VALUE to VALUE"),
    (re.compile(r"identifiable no better than this.*"), "LOOSE"),
)


def execute(name, folder):
    """Execute a notebook in `folder`, where its fits stay, after the one that it reads; return it."""
    before = ORDER[name]
    if before is not None and not (folder / "done" / before).exists():
        execute(before, folder)
    work = folder / "notebooks"
    if not work.exists():
        shutil.copytree(NOTEBOOKS, work)
        (folder / "data_samples").symlink_to(ROOT / "data_samples", target_is_directory=True)
        (folder / "done").mkdir()
    notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count = [], None
    environment = {
        **os.environ, "PYTHONPATH": str(ROOT), "IPYTHONDIR": str(folder / "ipython"), "NO_COLOR": "1",
        "JUPYTER_RUNTIME_DIR": str(folder / "runtime"),
    }  # fmt: skip
    client = NotebookClient(
        notebook, timeout=10 * _LIMIT, kernel_name="python3", resources={"metadata": {"path": str(work)}},
    )  # fmt: skip
    client.execute(env=environment)
    (folder / "done" / name).touch()
    return slim(notebook)


def slim(notebook):
    """Return a notebook whose outputs are small, and whose metadata names no machine and no moment."""
    for cell in notebook.cells:
        cell.metadata = {key: value for key, value in cell.metadata.items() if key == "tags"}
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if "image/png" in data:
                data["image/png"] = _small(data["image/png"])
            output.pop("metadata", None) if output.output_type == "error" else None
            if output.output_type == "error":
                output.traceback = [f"{output.ename}: {output.evalue}"]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    notebook.metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return notebook


def _small(png):
    """Return a picture no wider than a page, in few colours."""
    picture = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")
    if picture.width > _WIDEST:
        size = (_WIDEST, round(picture.height * _WIDEST / picture.width))
        picture = picture.resize(size, Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    picture.quantize(_COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
        buffer, "PNG", optimize=True
    )
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def texts(cell):
    """Return what a code cell shows, as words: its tables and texts, and that there is a picture."""
    out = []
    for output in cell.outputs:
        data = output.get("data", {})
        if output.output_type == "error":
            out.append(f"{output.ename}: {output.evalue}")
        elif "image/png" in data:
            out.append("PICTURE")
        elif "text/html" in data:
            out.append(
                unescape(re.sub(r"<style.*?</style>|<[^>]*>", " ", data["text/html"], flags=re.DOTALL))
            )
        else:
            out.append(data.get("text/markdown", data.get("text/plain", output.get("text", ""))))
    return [" ".join(text.split()) for text in out]


def masked(text):
    """Return a text without what differs between machines and days."""
    for pattern, word in _MASKS:
        text = pattern.sub(word, text)
    return text


def differences(stored, anew):
    """Return where two executions differ, a sentence each: words exactly, numbers by tolerance."""
    found = []
    cells = [[cell for cell in book.cells if cell.cell_type == "code"] for book in (stored, anew)]
    for number, (old, new) in enumerate(zip(*cells, strict=True), start=1):
        for before, after in zip_longest(texts(old), texts(new), fillvalue=""):
            before, after = masked(before), masked(after)
            if _NUMBER.sub("#", before) != _NUMBER.sub("#", after):
                found.append(f"code cell {number}: stored {before!r}, now {after!r}")
                continue
            pairs = zip(_NUMBER.findall(before), _NUMBER.findall(after), strict=True)
            found += [f"code cell {number}: stored {a}, now {b}" for a, b in pairs if not _agree(a, b)]
    return found


def _agree(before, after):
    a, b = (float(number.replace("−", "-")) for number in (before, after))
    return abs(a - b) <= max(TOLERANCE * abs(a), 2.0 * _last_digit(before))


def _last_digit(number):
    mantissa, _, exponent = number.partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2])) if "." in mantissa else 0.0


def store(names):
    """Execute notebooks and store them with their outputs."""
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            before = os.times().children_user
            notebook, path = execute(name, Path(folder)), NOTEBOOKS / f"{name}.ipynb"
            nbformat.validate(notebook)
            nbformat.write(notebook, path)
            spent = os.times().children_user - before
            print(f"{name}: {path.stat().st_size / 1000:.0f} kB, {spent:.0f} s of processor time")


if __name__ == "__main__":
    store(sys.argv[1:] or list(ORDER))
