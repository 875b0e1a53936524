"""`sysid report`: a fit as one page; vector figures and films beside it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.text import Text

from sysid import exact_json
from sysid.campaign import GearCampaign, MotorCampaign, read_campaign
from sysid.errors import CampaignError, ExportError, FitError, SysidError
from sysid.fit.result import FitResult, TrialResult
from sysid.report.drawing import save_figure
from sysid.report.fit_report import FitReport
from sysid.report.kinds import open_fit
from sysid.report.snapshots import check_film, write_film
from sysid.storage import write_file
from sysid.workflows.options import ReportOptions as ReportOptions
from sysid.workflows.search import collected_warnings, naming


def write_report(
    folder: str | Path, options: ReportOptions | None = None, say: Callable[[str], None] | None = None
) -> dict[str, Path]:
    """Write a fit's report and what else is asked for; return the files by what they are.

    Parameters
    ----------
    folder : str or Path
        Fit folder.
    options : ReportOptions
    say : callable, optional
        Called with one sentence at a time.

    Raises
    ------
    SysidError
        When something is missing or would be overwritten; nothing has been written then.
    """
    options = options or ReportOptions()
    tell = say or (lambda sentence: None)
    report = open_fit(folder)
    out = options.out if options.out is not None else report.folder / "report.html"
    _check_targets(report, options, out)
    if options.against is not None:
        tell(f"simulating the trials of {options.against} with the sets of {report.fit.name}")
        report = replace(report, against=predicted(report.fit, options.against, tell))
    tell(f"drawing the figures of {report.fit.name}")
    write_file(out, report.page().encode("utf-8"), ExportError)
    written = {"report": out}
    if options.pdf_figures is not None:
        options.pdf_figures.mkdir(parents=True, exist_ok=True)
        for name, figure in report.figures().items():
            written[f"figure {name}"] = save_figure(figure, options.pdf_figures / f"{name}.pdf")
    for path in options.films:
        tell(f"drawing {path}")
        written[path.suffix[1:].lower()] = write_film(report.film(options.drop), path, force=options.force)
    return written


def print_report(
    folder: str | Path, options: ReportOptions, json: bool, say: Callable[[str], None] | None
) -> None:
    """Write a report and print where it lies."""
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


def predicted(fit: FitResult, campaign_path: Path, say: Callable[[str], None]) -> FitResult:
    """Return the sets of a fit on the trials of a campaign whose logs the fit does not hold.

    Those that it held back are in its report already.

    Raises
    ------
    SysidError
        When the campaign is of the other kind, cannot be used, or holds nothing but trials of the fit.
    """
    campaign = read_campaign(campaign_path)
    if campaign.kind != fit.kind:
        raise CampaignError(
            f"{campaign_path}: is a {campaign.kind} campaign, and {fit.name} is a fit of a {fit.kind}; name "
            f"a {fit.kind} campaign with other trials"
        )
    with naming(campaign_path), collected_warnings(lambda text: say(f"warning: {text}")) as doubts:
        if isinstance(campaign, GearCampaign):
            trials, logs = _gear_trials(fit, campaign, campaign_path)
        else:
            assert isinstance(campaign, MotorCampaign)
            trials, logs = _motor_trials(fit, campaign, campaign_path)
    return replace(
        fit,
        name=campaign.name,
        runs=(),
        trials=tuple(replace(trial, use="validate") for trial in trials),
        provenance={**fit.provenance, "logs": logs},
        warnings=tuple(doubts),
    )


def _gear_trials(
    fit: FitResult, campaign: GearCampaign, path: Path
) -> tuple[tuple[TrialResult, ...], dict[str, Any]]:
    from sysid.gear.drops import prepare_drops
    from sysid.gear.model import PARAMETERS
    from sysid.gear.problem import GearObjective, on_surface, search_space, trial_results

    campaign, _ = on_surface(campaign, str(fit.settings["surface"]))
    drops = prepare_drops(campaign, path)
    names = _not_in_fit(fit, {drop.name: str(drop.provenance["sha256"]) for drop in drops}, path)
    drops = tuple(drop for drop in drops if drop.name in names)
    objective = GearObjective.build(campaign, search_space(campaign), drops)
    names = [record.name for record in fit.parameters]
    rows = fit.values[:, [names.index(name) for name in PARAMETERS]]
    # Offsets of single drops are of the fitted ones.
    table = objective.space.table
    rows = np.hstack([rows, np.zeros((len(rows), len(table) - len(PARAMETERS)))])
    trials, _ = trial_results(objective, rows)
    return trials, {drop.name: drop.provenance for drop in drops}


def _motor_trials(
    fit: FitResult, campaign: MotorCampaign, path: Path
) -> tuple[tuple[TrialResult, ...], dict[str, Any]]:
    from sysid.motor.known_values import prepare_bench, search_space
    from sysid.motor.objective import MotorObjective
    from sysid.motor.problem import motor_trial_results

    bench = prepare_bench(campaign, path)
    left = _not_in_fit(fit, {trial.entry.name: trial.hashes.split()[0] for trial in bench.trials}, path)
    chosen = tuple(trial for trial in bench.trials if trial.entry.name in left)
    space = search_space(campaign, bench)
    own = MotorObjective.build(campaign, space, bench, chosen)
    # The no-load lines are those of the fit, not tied to the other campaign's curves.
    objective = MotorObjective(space, chosen, {}, own.cost, own.jobs)
    names = [record.name for record in fit.parameters]
    rows = np.empty((len(fit.values), len(space.table)))
    for column, row in enumerate(space.table.values()):
        # A log that was not fitted has the mean delay.
        source = row.name if row.name in names else row.common_name
        rows[:, column] = fit.values[:, names.index(source)]
    return motor_trial_results(objective, rows), {t.entry.name: t.provenance for t in chosen}


def _not_in_fit(fit: FitResult, hashes: dict[str, str], path: Path) -> list[str]:
    """Return the names of the trials that the fit neither was made from nor held back.

    Raises
    ------
    FitError
        When there are none.
    """
    from sysid.workflows.validate import unseen

    logs = fit.provenance.get("logs", {})
    held = {str(logs[t.name].get("sha256")) for t in fit.trials if t.use != "fit" and t.name in logs}
    left = [name for name in unseen(fit, hashes, path) if hashes[name] not in held]
    if not left:
        raise FitError(
            f"{path}: every trial in it is one of {fit.name}, whose report shows the ones held back anyway; "
            "leave --against out, or name a campaign with other logs"
        )
    return left


def _check_targets(report: FitReport, options: ReportOptions, out: Path) -> None:
    if out.is_dir():
        raise ExportError(f"{out}: is a folder; name the page in it, such as {out / 'report.html'}")
    targets = [path.resolve() for path in (out, *options.films)]
    for path in options.films:
        if targets.count(path.resolve()) > 1:
            raise ExportError(f"{path}: is named for two files of one report; give each a name of its own")
    if options.out is not None and out.exists() and not options.force:
        raise ExportError(f"{out}: exists already; choose a new name or add --force")
    if not out.parent.is_dir():
        raise ExportError(f"{out}: the folder {out.parent} does not exist; make it first")
    figures = options.pdf_figures
    if figures is not None:
        if figures.exists() and not figures.is_dir():
            raise ExportError(f"{figures}: is a file, expected a folder for the figures")
        if figures.is_dir() and any(figures.glob("*.pdf")) and not options.force:
            raise ExportError(f"{figures}: holds PDF files already; choose a new folder or add --force")
    if options.drop is not None and not options.films:
        raise SysidError("--drop names the drop of a film; add --gif FILE or --mp4 FILE")
    if options.films:
        report.film(options.drop)
        for path in options.films:
            check_film(path, options.force)
