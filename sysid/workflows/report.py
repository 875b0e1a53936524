"""`sysid report`: a fit as one page, with vector figures and films; a page of landing maps or a study."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.text import Text

from sysid import exact_json
from sysid.errors import ExportError, FitError, SysidError
from sysid.export import read_judged_fit
from sysid.fit.result import FitResult
from sysid.fit.store import fit_folder
from sysid.journal import Journal, Say
from sysid.report.answer import Reopened
from sysid.report.drawing import figure_bytes
from sysid.report.fit_report import FitReport
from sysid.report.snapshots import check_film, film_bytes
from sysid.storage import check_file, schema_of, write_file, write_files
from sysid.trust import documents
from sysid.trust.use import judged_use
from sysid.workflows.draws import stored_draws
from sysid.workflows.kinds import find_report
from sysid.workflows.map_pages import PAGES
from sysid.workflows.options import ReportOptions
from sysid.workflows.predict import foreseen, predict, predicted_fit
from sysid.workflows.reopen import reopen


def open_report(fit: str | Path) -> FitReport:
    """Read a fit for its report; FitError when there is none."""
    folder = fit_folder(Path(fit))
    result = documents.with_intervals(read_judged_fit(fit), folder)
    report: FitReport = find_report(result.kind)(folder, result)
    return report


# Number of draws behind a band: the quantiles of more differ by less than a line's width.
_DRAWS = 100


def reopened(report: FitReport) -> Reopened:
    """Return what the campaign of a fit tells; where it cannot be read, nothing but the reason.

    At every sample, the band has 95 % of the predictions by draws of the fit.
    """
    fit = report.fit
    try:
        with Journal():
            opened = reopen(report.folder, fit, None, 1)
            stored = stored_draws(report.folder, fit)
            draws = fit.values[:0] if stored is None else stored[:_DRAWS]
            predicted = predict(fit, opened.kind, opened.whole)
            trials, sets = predicted.problem.trials, slice(None)
            band = {}
            if len(draws):
                drawn = predicted.story.signals(fit, np.concatenate([fit.values[:1], draws]))
                for trial, signals in zip(trials, drawn, strict=True):
                    low, high = np.quantile(signals[1:], [0.025, 0.975], axis=0)
                    band[trial.name] = low, high
            held_out = {
                trial.name: float(predicted.judge(t, sets, predicted.floor).ratio)
                for t, trial in enumerate(trials)
                if trial.use == "validate"
            }
            fresh = [trial.name for trial in trials if trial.use == "validate"]
            use = None
            if fresh:
                story = opened.kind.story(opened.whole.only(fresh).exact)
                use = judged_use(foreseen(story, fit, fit.values[:1], stored), drawn=stored is not None)
            truth, evidence = opened.truth, predicted.evidence
    except (SysidError, OSError) as error:
        return Reopened(why_not=str(error))
    noise = dict(zip((trial.name for trial in trials), predicted.floor, strict=True))
    return Reopened(band, noise, held_out, use, truth, evidence)


def write_report(
    folder: str | Path, options: ReportOptions | None = None, say: Say = None
) -> dict[str, Path]:
    """Write the report of a fit folder and its further files; return the files by what they are.

    A file of landing maps or of a design study has a page of its own. Raises `SysidError` when something is
    missing or would be overwritten; nothing has been written then.
    """
    options = options or ReportOptions()
    tell = say or (lambda sentence: None)
    path = Path(folder)
    if path.is_file() and path.suffix.lower() in (".h5", ".hdf5"):
        make_page = PAGES.get(schema_of(path, ExportError))
        if make_page is not None:
            for name in ("against", "figure", "gif", "mp4", "drop"):
                if getattr(options, name) is not None:
                    raise ExportError(f"{path}: --{name} is for the report of a fit; leave it out")
            out = options.out or path.with_suffix(".html")
            check_file(out, force=options.force, error_type=ExportError)
            write_file(out, make_page(path).encode("utf-8"), ExportError)
            return {"report": out}
    report = open_report(folder)
    if options.compare is not None:
        report = replace(report, beside=second_fit(report, options.compare))
    out = options.out if options.out is not None else report.folder / "report.html"
    _check_targets(options, out)
    films = {path: report.film(options.drop) for path in options.films}
    if options.against is not None:
        tell(f"simulating the trials of {options.against} with the sets of {report.fit.name}")
        report = replace(report, against=predicted_fit(report.fit, options.against))
    tell(f"simulating the draws of {report.fit.name}")
    report = replace(report, known=reopened(report))
    tell(f"drawing the figures of {report.fit.name}")
    written, files = {"report": out}, {out: report.page().encode("utf-8")}
    if options.figure is not None:
        for name, figure in report.figures().items():
            path = written[f"figure/{name}"] = options.figure / f"{name}.pdf"
            files[path] = figure_bytes(figure, "pdf")
        options.figure.mkdir(parents=True, exist_ok=True)
    for path, film in films.items():
        tell(f"drawing {path}")
        kind = path.suffix[1:].lower()
        written[kind], files[path] = path, film_bytes(film, kind)
    write_files(files, ExportError)
    return written


def second_fit(report: FitReport, folder: Path) -> FitReport:
    """Return the report of a second fit with the trials that it shares; a FitError where there are none."""
    other = open_report(folder)
    if other.fit.kind != report.fit.kind:
        raise FitError(
            f"{folder}: is a {other.fit.kind} fit and {report.folder} a {report.fit.kind} fit; "
            "--compare needs two fits of one kind"
        )
    # Two logs may have one name: their bytes decide whether they are the same.
    known = _logs(report.fit)
    shared = tuple(
        t for t in other.fit.trials if t.name in known and known[t.name] == _logs(other.fit)[t.name]
    )
    if not shared:
        raise FitError(
            f"{folder}: shares no trial with {report.folder} ({', '.join(known)}): names or logs differ; "
            "--compare draws the trials that both fits have"
        )
    return replace(other, fit=replace(other.fit, trials=shared))


def _logs(fit: FitResult) -> dict[str, str | None]:
    logs = fit.provenance.get("logs", {})
    return {trial.name: logs.get(trial.name, {}).get("sha256") for trial in fit.trials}


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


def _check_targets(options: ReportOptions, out: Path) -> None:
    if out.is_dir():
        raise ExportError(f"{out}: is a folder; name the page in it, such as {out / 'report.html'}")
    targets = [path.resolve() for path in (out, *options.films)]
    for path in options.films:
        if targets.count(path.resolve()) > 1:
            raise ExportError(f"{path}: is named for two files of one report; give each another name")
    figures = options.figure
    if figures is not None:
        if figures.exists() and not figures.is_dir():
            raise ExportError(f"{figures}: is a file, expected a folder for the figures")
        if figures.is_dir() and any(figures.glob("*.pdf")) and not options.force:
            raise ExportError(f"{figures}: has PDF files already; choose a new folder or add --force")
    if options.drop is not None and not options.films:
        raise SysidError("--drop names the drop of a film; add --gif FILE or --mp4 FILE")
    for path in options.films:
        check_film(path)
    # A report in the folder of its fit takes the place of an older one.
    check_file(out, force=options.force or options.out is None, error_type=ExportError)
    for path in options.films:
        check_file(path, force=options.force, error_type=ExportError)
