"""Notebooks: find them, run them with parameters, and turn what they show into one page.

Formulas become MathML, so that no script has to draw them.
"""

from __future__ import annotations

import html
import os
import re
import sysconfig
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt

import sysid
from sysid.errors import ExportError, SysidError
from sysid.report.html import NOTHING, Html, identity, joined, preformatted
from sysid.report.page import page

_BLOCK, _INLINE = re.compile(r"\$\$(.+?)\$\$", re.DOTALL), re.compile(r"(?<!\\)\$([^$\n]+?)\$")
_HEADING = re.compile(r"<h([1-6])>(.*?)</h\1>")
_LIBRARIES = ("papermill", "ipykernel", "latex2mathml")


def check_notebook_tools() -> None:
    """Refuse where the libraries that run notebooks are missing.

    Raises
    ------
    SysidError
        With the command that installs them.
    """
    missing = [name for name in _LIBRARIES if find_spec(name) is None]
    if missing:
        raise SysidError(
            f"a notebook needs {', '.join(_LIBRARIES)} (missing: {', '.join(missing)}); install them with: "
            'pip install "sysid[report]"'
        )


def find_notebook(name: str) -> Path:
    """Return a notebook by name: of the working directory, of the sources, or as installed.

    Raises
    ------
    SysidError
        When it is nowhere.
    """
    sources = Path(sysid.__file__).resolve().parents[1] / "notebooks"
    installed = Path(sysconfig.get_path("data")) / "share" / "sysid" / "notebooks"
    for folder in (sources, installed, Path("notebooks")):
        path = folder / f"{name}.ipynb"
        if path.is_file():
            return path
    raise SysidError(f"no notebook {name}.ipynb in {sources}, {installed} or notebooks; install sysid again")


def run_notebook(path: Path, parameters: Mapping[str, Any], *, cwd: Path | None = None) -> Any:
    """Run a notebook with parameters and return it with what its cells gave (nbformat).

    A cell of the notebook is tagged ``parameters``. It runs in `cwd`, by default in the notebook's folder, so
    paths among the parameters are absolute.

    Raises
    ------
    ExportError
        When a cell fails.
    """
    check_notebook_tools()
    import papermill
    from papermill.exceptions import PapermillException
    from traitlets.config import Config

    # Kernel and caller speak through files, where the system has such sockets, not by network.
    config = Config({"KernelManager": {"transport": "ipc"}} if os.name == "posix" else {})
    with _quiet_kernel() as folder:
        finished = folder / "finished.ipynb"
        try:
            return papermill.execute_notebook(
                str(path), str(finished), dict(parameters), kernel_name="python3", progress_bar=False,
                cwd=str(cwd or path.parent), extra_arguments=["--log-level=CRITICAL"], config=config,
            )  # fmt: skip
        except PapermillException as error:
            what = getattr(error, "evalue", "") or str(error)
            raise ExportError(f"{path.name}: {' '.join(str(what).split())}") from error


@contextmanager
def _quiet_kernel() -> Iterator[Path]:
    """Let kernels keep their history and connection files in a folder that goes away with them."""
    names = ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "PYDEVD_DISABLE_FILE_VALIDATION")
    before = {name: os.environ.get(name) for name in names}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        os.environ.update(dict(zip(names, (f"{folder}/ipython", f"{folder}/runtime", "1"), strict=True)))
        try:
            yield Path(folder)
        finally:
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value


def notebook_page(notebook: Any, title: str) -> str:
    """Return a notebook that has run as one page: its prose and what its cells return, none of its code."""
    markdown = MarkdownIt()
    pieces = []
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            markup = markdown.render(with_mathml(cell.source))
            # A link can name a heading by its identity.
            pieces.append(Html(_HEADING.sub(_named, markup)))
        else:
            pieces += [_shown(output) for output in cell.get("outputs", ())]
    return page(title, joined(pieces))


def _shown(output: Any) -> Html:
    data = output.get("data", {})
    if "text/html" in data:
        return Html(data["text/html"])
    text = data.get("text/plain", output.get("text", ""))
    return preformatted(text) if text else NOTHING


def with_mathml(source: str) -> str:
    """Return Markdown with its formulas, between dollars, as MathML."""
    from latex2mathml.converter import convert

    def block(match: re.Match[str]) -> str:
        return "\n\n" + convert(" ".join(match.group(1).split()), display="block") + "\n\n"

    def inline(match: re.Match[str]) -> str:
        return str(convert(match.group(1).strip(), display="inline"))

    return _INLINE.sub(inline, _BLOCK.sub(block, source))


def _named(match: re.Match[str]) -> str:
    return f'<h{match[1]} id="{identity(html.unescape(match[2]))}">{match[2]}</h{match[1]}>'
