"""Commands that fit, judge a fit, and hand its sets on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from sysid.cli.adapter import command
from sysid.cli.root import FLAGGED, app, unless
from sysid.marks import Argument, Flag
from sysid.workflows.options import (
    CampaignPath,
    Dask,
    Details,
    Draws,
    Figure,
    FitCampaign,
    FitFolder,
    FitOptions,
    Force,
    Json,
    OtherCampaign,
    Quiet,
    ReportOptions,
    Sets,
    SlopeOfGround,
    Strict,
    Surface,
    Threads,
    TrustOptions,
)

if TYPE_CHECKING:
    from sysid.fit.result import FitResult


@command(app, "fit-motor", "sysid fit-motor data_samples/motor")
def fit_motor(campaign: CampaignPath, options: FitOptions, strict: Strict = False, json: Json = False) -> int:
    """Fit a motor to thrust-stand and load-cell logs."""
    from sysid.workflows.fit import fit_motor as fit

    return _fit(fit, campaign, options, strict, json)


@command(app, "fit", "sysid fit data_samples/motor")
def fit(campaign: CampaignPath, options: FitOptions, strict: Strict = False, json: Json = False) -> int:
    """Fit the model that a campaign names: gear, motor or own.

    A model of your own is in a Python file that --plugin names behind this and any other command.
    """
    from sysid.workflows.fit import fit_campaign

    return _fit(fit_campaign, campaign, options, strict, json)


@command(app, "fit-gear", "sysid fit-gear data_samples/gear-lf")
def fit_gear(
    campaign: CampaignPath,
    options: FitOptions,
    surface: Surface = None,
    strict: Strict = False,
    json: Json = False,
) -> int:
    """Fit a landing gear to motion-capture logs of drops."""
    from sysid.workflows.fit import fit_gear as fit

    return _fit(partial(fit, surface=surface), campaign, options, strict, json)


def _fit(
    fit: Callable[..., tuple[FitResult, Path]], campaign: Path, options: FitOptions, strict: bool, json: bool
) -> int:
    from sysid.workflows.show import is_unfinished, print_fit

    tell = unless(options.quiet)
    result, folder = fit(campaign, replace(options, quiet=options.quiet or json), say=tell)
    print_fit(result, folder, json, options.details)
    if result.provenance.get("cut_short") == "interrupted":
        return 130
    return FLAGGED if strict and is_unfinished(result) else 0


@command(app, "check", "sysid check data_samples/gear-lf")
def check(
    campaign: CampaignPath,
    surface: Surface = None,
    threads: Threads = None,
    quiet: Quiet = False,
    details: Details = False,
    json: Json = False,
) -> int:
    """Say before a fit what the trials will determine.

    Judges every log, names what excites the model, and says what to record next. The exit code is 3 where the
    logs contradict the campaign: no verdict is given then. It is 2 where a log cannot be used at all, for
    example where a foot lies below the surface before the drop falls.
    """
    from sysid.report.trust_tables import print_check
    from sysid.workflows.check import check_campaign

    document = check_campaign(
        campaign, surface=surface, threads=threads, say=unless(quiet or json), details=details
    )
    print_check(document, json, details=details)
    return FLAGGED if document.withheld else 0


@command(app, "trust", "sysid trust fits/demo/motor")
def trust(
    fit: FitFolder, options: TrustOptions, quiet: Quiet = False, json: Json = False, details: Details = False
) -> None:
    """Give every parameter of a fit an interval and a verdict.

    Profiles every free parameter, fits without each trial in turn, and resamples the trials.
    """
    from sysid.report.trust_tables import print_trust
    from sysid.workflows.trust import assess_fit

    document = assess_fit(fit, options, unless(quiet or json))
    print_trust(document, fit, json, long=details)


@command(app, "validate", "sysid validate fits/demo/gear-lf data_samples/gear-lf", alias="cross-validate")
def validate(
    fit: FitFolder,
    other: OtherCampaign = None,
    campaign: FitCampaign = None,
    threads: Threads = None,
    dask: Dask = None,
    quiet: Quiet = False,
    json: Json = False,
) -> int:
    """Predict trials that a fit has not seen.

    Without a campaign every trial of the fit is predicted by a fit of the others. Says the NRMSE over the
    noise, from when on a prediction is off by more, and which numbers of use (place and time of rest, pitch,
    touchdowns; speeds and times of a motor) lie within 95 % of the draws. The exit code is 3 where a
    prediction is flagged or the fit does not predict.
    """
    from sysid.report.trust_tables import print_validation
    from sysid.trust.use import NOT
    from sysid.workflows.predict import cross_validate, validate_fit

    say = unless(quiet or json)
    document = (
        cross_validate(fit, campaign, threads=threads, dask=dask, say=say)
        if other is None
        else validate_fit(fit, other, threads=threads, say=say)
    )
    print_validation(document, fit, json)
    word = document.use.word if document.use else ""
    return FLAGGED if document.flagged or word == NOT else 0


@command(app, "compare", "sysid compare fits/demo/gear-lf fits/demo/gear-hf")
def compare(
    fits: Annotated[tuple[Path, ...], Argument("Two or more fit folders.")],
    cross: Annotated[
        bool, Flag("Predict the trials of every fit with every other fit.", "--cross/--no-cross")
    ] = True,
    report: Annotated[bool, Flag("Write a page with the parameters and the traces of all fits.")] = False,
    out: Annotated[Path, Flag("Write the page to this file.")] = Path("comparison.html"),
    threads: Threads = None,
    force: Force = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Say which differences between fits are real.

    Prints Table II side by side, and which fit predicts which trials.
    """
    from sysid.workflows.compare import compare_and_print

    compare_and_print(
        fits, cross=cross, page=out if report else None, threads=threads, force=force,
        say=unless(quiet or json), json=json,
    )  # fmt: skip


@command(app, "explain", "sysid explain fits/demo/gear-lf", alias="ladder")
def explain(
    fit: FitFolder,
    campaign: FitCampaign = None,
    figure: Figure = None,
    adopt: Annotated[
        Path | None, Flag("Write a campaign with what to change to this file.", "--adopt", "--out")
    ] = None,
    threads: Threads = None,
    force: Force = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Say what a campaign states wrongly, or a model lacks.

    Tries stated values, exchanges and single trials first. To what they leave it adds each declared term,
    finds those to keep among all together, and judges them on trials left out.
    """
    from sysid.workflows.explain import explain_and_print

    explain_and_print(
        fit, campaign, adopt=adopt, figure=figure, force=force, threads=threads, json=json,
        say=unless(quiet or json),
    )  # fmt: skip


@command(app, "report", "sysid report fits/demo/gear-lf")
def report(
    result: Annotated[Path, Argument("Fit folder, or file of landing maps or of a design study.")],
    options: ReportOptions,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Write a report: one HTML page with every trial.

    The page of landing maps, or of a design study, shows every cell with the command that simulates it.
    """
    from sysid.workflows.report import print_report

    print_report(result, options, json, unless(quiet or json))


@command(app, "show", "sysid show fits/demo/gear-lf", alias="fits")
def show(
    source: Annotated[Path, Argument("Fit folder, file of sets, or folder with fits in it.")] = Path("fits"),
    json: Json = False,
) -> None:
    """Print the sets of a fit, or the fits of a folder.

    A folder is listed with the state, NRMSE and age of each fit in it.
    """
    if source.is_dir() and not (source / "fit.h5").is_file():
        from sysid.workflows.fits import list_fits, print_fits

        if fits := list_fits(source):
            return print_fits(fits, json)
    from sysid.workflows.show import print_sets

    print_sets(source, json)


@command(app, "export", "sysid export fits/demo/motor --for gazebo --mass '1.2 kg'")
def export(
    fit: Sets,
    out: Annotated[Path | None, Flag("File to write: .json, .csv, .h5, .mat, .xml or .sdf.")] = None,
    target: Annotated[
        str | None, Flag("Print a motor's numbers for gazebo, rotorpy, crazyflow, px4 or ardupilot.", "--for")
    ] = None,
    mass: Annotated[float | None, Flag("Mass of a drone that hovers (--for).", unit="kg", least=0)] = None,
    set: Annotated[int | None, Flag("Write only the set of this rank (.xml, .sdf).", least=1)] = None,
    slope: SlopeOfGround = 0.0,
    per_leg: Annotated[bool, Flag("Model four single legs in space (.xml).")] = False,
    draws: Draws = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write the ranked sets for a simulator.

    MuJoCo (.xml) and Gazebo (.sdf, a motor) get one model file per set: NAME-1.xml is the best set,
    and so on. With --for, it prints the best set's numbers under the target's names, with units and 95 %
    intervals, and --out writes them.
    """
    from sysid.workflows.export_models import print_exported

    print_exported(
        fit, out, force, json, target=target, mass=mass, rank=set, slope=slope, per_leg=per_leg, draws=draws
    )


@command(app, "codes", "sysid codes not-explained")
def codes(
    code: Annotated[str | None, Argument("Code behind a warning. Without it, all codes.")] = None,
    json: Json = False,
) -> None:
    """Say what the code behind a warning means, and what to do."""
    from sysid.workflows.codes import print_codes

    print_codes(code, json)


@command(app, "schema", "sysid schema trust")
def schema(
    name: Annotated[str | None, Argument("Name of a document. Without it, it prints all names.")] = None,
) -> None:
    """Print the JSON Schema of a document that sysid writes."""
    from sysid.workflows.schema import print_schema

    print_schema(name)


@command(app, "demo", "sysid demo")
def demo(
    data: Annotated[Path | None, Flag("Folder with the data samples.", default="found")] = None,
    out: Annotated[Path, Flag("Write the results to this folder.")] = Path("fits") / "demo",
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Fit the sample data and write reports to look at."""
    from sysid.workflows.demo import run_demo

    run_demo(data, out, quiet, unless(quiet), json)
