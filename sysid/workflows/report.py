"""`sysid report`: a fit as one page, with vector figures and films."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.text import Text

from sysid import exact_json
from sysid.errors import ExportError, SysidError
from sysid.fit.store import fit_folder, read_fit
from sysid.journal import Say
from sysid.report.drawing import save_figure
from sysid.report.fit_report import FitReport
from sysid.report.snapshots import check_film, write_film
from sysid.storage import write_file
from sysid.trust.documents import with_intervals
from sysid.workflows.kinds import find_report
from sysid.workflows.options import ReportOptions
from sysid.workflows.predict import predicted_fit


def open_report(fit: str | Path, against: str | Path | None = None) -> FitReport:
    """Read a fit for its report; `against` is a folder with the same sets on trials of another campaign.

    Raises `FitError` when there is no fit.
    """
    folder = fit_folder(Path(fit))
    result = with_intervals(read_fit(fit), folder)
    report: FitReport = find_report(result.kind)(folder, result, read_fit(against) if against else None)
    return report


def write_report(
    folder: str | Path, options: ReportOptions | None = None, say: Say = None
) -> dict[str, Path]:
    """Write the report of a fit folder and its further files; return the files by what they are.

    Raises `SysidError` when something is missing or would be overwritten; nothing has been written then.
    """
    options = options or ReportOptions()
    tell = say or (lambda sentence: None)
    report = open_report(folder)
    out = options.out if options.out is not None else report.folder / "report.html"
    _check_targets(report, options, out)
    if options.against is not None:
        tell(f"simulating the trials of {options.against} with the sets of {report.fit.name}")
        report = replace(report, against=predicted_fit(report.fit, options.against))
    tell(f"drawing the figures of {report.fit.name}")
    write_file(out, report.page().encode("utf-8"), ExportError)
    written = {"report": out}
    if options.figure is not None:
        options.figure.mkdir(parents=True, exist_ok=True)
        for name, figure in report.figures().items():
            written[f"figure/{name}"] = save_figure(figure, options.figure / f"{name}.pdf")
    for path in options.films:
        tell(f"drawing {path}")
        written[path.suffix[1:].lower()] = write_film(report.film(options.drop), path, force=options.force)
    return written


def print_report(folder: str | Path, options: ReportOptions, json: bool, say: Say) -> None:
    """Write a report and print its path."""
    started = time.perf_counter()
    console = Console(stderr=True)
    if say is not None and console.is_terminal:
        with console.status("writing the report") as status:
            written = write_report(folder, options, lambda sentence: status.update(Text(sentence)))
    else:
        written = write_report(folder, options, say)
    if json:
        sizes = {what: {"path": str(path), "bytes": path.stat().st_size} for what, path in written.items()}
        print(exact_json.dumps({"written": sizes, "seconds": time.perf_counter() - started}))
        return
    for path in written.values():
        print(f"wrote {path}")


def _check_targets(report: FitReport, options: ReportOptions, out: Path) -> None:
    if out.is_dir():
        raise ExportError(f"{out}: is a folder; name the page in it, such as {out / 'report.html'}")
    targets = [path.resolve() for path in (out, *options.films)]
    for path in options.films:
        if targets.count(path.resolve()) > 1:
            raise ExportError(f"{path}: is named for two files of one report; give each another name")
    if options.out is not None and out.exists() and not options.force:
        raise ExportError(f"{out}: exists already; choose a new name or add --force")
    if not out.parent.is_dir():
        raise ExportError(f"{out}: the folder {out.parent} does not exist; make it first")
    figures = options.figure
    if figures is not None:
        if figures.exists() and not figures.is_dir():
            raise ExportError(f"{figures}: is a file, expected a folder for the figures")
        if figures.is_dir() and any(figures.glob("*.pdf")) and not options.force:
            raise ExportError(f"{figures}: has PDF files already; choose a new folder or add --force")
    if options.drop is not None and not options.films:
        raise SysidError("--drop names the drop of a film; add --gif FILE or --mp4 FILE")
    if options.films:
        report.film(options.drop)
        for path in options.films:
            check_film(path, options.force)
