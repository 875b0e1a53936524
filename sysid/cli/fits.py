"""Commands that fit, judge a fit, and hand its sets on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from sysid.cli.adapter import command
from sysid.cli.root import app, print_json, unless
from sysid.workflows.options import (
    Argument,
    CampaignPath,
    Dask,
    FitCampaign,
    FitFolder,
    FitOptions,
    Flag,
    Force,
    Json,
    Quiet,
    ReportOptions,
    Sets,
    SlopeOfGround,
    Surface,
    Threads,
    TrustOptions,
)


@command(app, "fit-motor")
def fit_motor(campaign: CampaignPath, options: FitOptions, json: Json = False) -> int:
    """Fit a motor to thrust-stand and load-cell logs: five ranked parameter sets."""
    from sysid.workflows.fit import fit_motor as fit

    return _fit(fit, campaign, options, json)


@command(app, "fit-gear")
def fit_gear(campaign: CampaignPath, options: FitOptions, surface: Surface = None, json: Json = False) -> int:
    """Fit the landing gear to motion-capture logs of drops: five ranked parameter sets."""
    from sysid.workflows.fit import fit_gear as fit

    return _fit(fit, campaign, options, json, surface=surface)


def _fit(fit: Any, campaign: Path, options: FitOptions, json: bool, **more: Any) -> int:
    from sysid.workflows.show import print_fit, stopped_by_user

    tell = unless(options.quiet)
    result, folder = fit(campaign, replace(options, quiet=options.quiet or json), say=tell, **more)
    if json or not options.quiet:
        print_fit(result, folder, json)
    return 130 if stopped_by_user(result) else 0


@command(app, "check")
def check(
    campaign: CampaignPath,
    surface: Surface = None,
    threads: Threads = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Judge a campaign before the fit: logs, excitation, what the trials determine, what to record next."""
    from sysid.report.trust_tables import print_check
    from sysid.workflows.check import check_campaign

    document = check_campaign(campaign, surface=surface, threads=threads, say=unless(quiet or json))
    print_check(document, json)


@command(app, "trust")
def trust(
    fit: FitFolder,
    options: TrustOptions,
    quiet: Quiet = False,
    json: Json = False,
    long: Annotated[bool, Flag("Print the 68 % intervals and the predictions of the runs too.")] = False,
) -> None:
    """Profile every free parameter of a fit: intervals, verdicts, bootstrap, spread of the runs."""
    from sysid.report.trust_tables import print_trust
    from sysid.workflows.trust import assess_fit

    print_trust(assess_fit(fit, options, unless(quiet or json)), fit, json, long=long)


@command(app, "validate")
def validate(
    fit: FitFolder, campaign: CampaignPath, threads: Threads = None, quiet: Quiet = False, json: Json = False
) -> None:
    """Predict trials that a fit has not seen: NRMSE over the noise, when it ends, where it stops."""
    from sysid.report.trust_tables import print_validation
    from sysid.workflows.predict import validate_fit

    print_validation(validate_fit(fit, campaign, threads=threads, say=unless(quiet or json)), fit, json)


@command(app, "cross-validate")
def cross_validate(
    fit: FitFolder,
    campaign: FitCampaign = None,
    threads: Threads = None,
    dask: Dask = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Leave out one trial after the other, fit the rest again, predict the trial left out."""
    from sysid.report.trust_tables import print_validation
    from sysid.workflows.predict import cross_validate as leave_out

    document = leave_out(fit, campaign, threads=threads, dask=dask, say=unless(quiet or json))
    print_validation(document, fit, json)


@command(app, "compare")
def compare(
    fits: Annotated[tuple[Path, ...], Argument("Two or more fit folders.")],
    cross: Annotated[
        bool, Flag("Predict the trials of every fit with every other fit.", "--cross/--no-cross")
    ] = True,
    threads: Threads = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Compare fits: Table II side by side, which differences are real, which fit predicts which trials."""
    from sysid.report.trust_tables import print_comparison
    from sysid.workflows.compare import compare_fits

    print_comparison(*compare_fits(fits, cross=cross, threads=threads, say=unless(quiet or json)), json)


@command(app, "report")
def report(fit: FitFolder, options: ReportOptions, quiet: Quiet = False, json: Json = False) -> None:
    """Write a fit's report: one HTML page that needs nothing else."""
    from sysid.workflows.report import print_report

    print_report(fit, options, json, unless(quiet or json))


@command(app, "show")
def show(fit: Sets, json: Json = False) -> None:
    """Print the ranked sets of a fit: values, spread, bounds, NRMSE."""
    from sysid.workflows.show import print_sets

    print_sets(fit, json)


@command(app, "export")
def export(
    fit: Sets,
    to: Annotated[Path, Flag("File to write: .json, .csv, .h5, .mat, .xml or .sdf.")],
    set: Annotated[int | None, Flag("Write only the set of this rank (.xml, .sdf).", least=1)] = None,
    slope: SlopeOfGround = 0.0,
    per_leg: Annotated[bool, Flag("Model four single legs in space (.xml).")] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write the ranked sets for a simulator, or each as a MuJoCo (.xml) or Gazebo motor (.sdf) model."""
    from sysid.workflows.export_models import export_sets

    files = export_sets(fit, to, force, rank=set, slope=slope, per_leg=per_leg)
    if json:
        print_json({"written": [str(file) for file in files]})
    for file in () if json else files:
        typer.echo(f"wrote {file}")


@command(app, "fits")
def fits(
    folder: Annotated[Path, Argument("Folder with fits in it.")] = Path("fits"), json: Json = False
) -> None:
    """List the fits of a folder: running, stopped or done, NRMSE, age."""
    from sysid.workflows.fits import print_fits

    print_fits(folder, json)


@command(app, "schema")
def schema(
    name: Annotated[str | None, Argument("Name of a document. Without it, it prints all names.")] = None,
) -> None:
    """Print the JSON Schema of a document that sysid writes: fit, trust, validation, …"""
    from sysid.workflows.schema import print_schema

    print_schema(name)


@command(app, "demo")
def demo(
    data: Annotated[Path | None, Flag("Folder with the data samples.", default="found")] = None,
    out: Annotated[Path, Flag("Write the results to this folder.")] = Path("fits") / "demo",
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Run the whole job on data_samples: load, filter, fits, exports, figures, reports."""
    from sysid.workflows.demo import run_demo

    run_demo(data, out, quiet, unless(quiet), json)
