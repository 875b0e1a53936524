"""`sysid show FOLDER`: the fits in a folder, finished or not."""

import time
from dataclasses import asdict, dataclass
from pathlib import Path

from sysid.errors import FitError
from sysid.fit.checkpoint import Checkpoint, glance
from sysid.fit.store import FIT_FILE, check_unchanged
from sysid.report.fold import print_lines, print_result, print_table
from sysid.report.table import listed
from sysid.resume import in_use
from sysid.storage import numbered


@dataclass(frozen=True)
class FitEntry:
    """One fit of a folder."""

    name: str
    # ``running`` (a process works on it), ``stopped`` (can be continued), ``unfinished`` (one of these two;
    # its lock may not be opened), ``done``, ``cut`` (a run ended by its budget of candidates or generations),
    # or ``damaged``.
    state: str
    # Best NRMSE until now [1].
    nrmse: float | None
    # Number of runs begun.
    runs: int
    # Last change [s since 1970].
    changed: float


def list_fits(folder: str | Path) -> list[FitEntry]:
    """Return the fits of a folder and of the folders in it by name, such as ``demo/motor``.

    An unfinished fit takes the place of an earlier, partial result.
    """
    folder = Path(folder)
    entries: dict[str, FitEntry] = {}
    for path in (*folder.glob("*/fit.h5"), *folder.glob("*/*/fit.h5")):
        name = path.parent.relative_to(folder).as_posix()
        changed = path.stat().st_mtime
        try:
            with FIT_FILE.opened(path) as file:
                check_unchanged(path.parent)
                nrmse = float(file["sets/nrmse"][()].min())
                state, begun = str(file.attrs["state"]), numbered(file, "runs")
                ended = {numbered(run, "stages")[-1].attrs["stop_reason"] for run in begun}
                if state == "done" and ended & {"evaluations", "generations"}:
                    state = "cut"
                entries[name] = FitEntry(name, state, nrmse, len(begun), changed)
        except FitError:
            entries[name] = FitEntry(name, "damaged", None, 0, changed)
    for path in (*folder.glob(f"*{Checkpoint.SUFFIX}"), *folder.glob(f"*/*{Checkpoint.SUFFIX}")):
        if Checkpoint.kept(path):
            name = path.relative_to(folder).as_posix().removesuffix(Checkpoint.SUFFIX)
            runs, lowest, changed = glance(path)
            state = {True: "running", False: "stopped", None: "unfinished"}[in_use(path)]
            entries[name] = FitEntry(name, state, lowest, runs, changed)
    return [entries[name] for name in sorted(entries)]


def print_fits(entries: list[FitEntry], json: bool = False) -> None:
    """Print the fits of a folder: state, NRMSE, runs, age."""
    if print_result([asdict(entry) for entry in entries], json):
        return
    now = time.time()
    rows = [
        (
            entry.name, entry.state, "-" if entry.nrmse is None else f"{100 * entry.nrmse:.2f} %",
            str(entry.runs), _age(now - entry.changed) if entry.changed else "-",
        )
        for entry in entries
    ]  # fmt: skip
    print_table(listed("", rows, ("fit", "state", "NRMSE", "runs", "age"), texts=2))
    if any(entry.state == "stopped" for entry in entries):
        print_lines(["a stopped fit goes on with its command and --resume"])
    if any(entry.state == "cut" for entry in entries):
        print_lines(["runs of a cut fit ended by their budget; fit again with a larger one"])


def _age(seconds: float) -> str:
    for size, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if seconds >= size:
            return f"{seconds / size:.0f} {unit}"
    return f"{max(0.0, seconds):.0f} s"
