"""Commands that say how far a fit can be trusted: before it, after it, on other trials, beside other fits."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.options import Dask, Json, Quiet, Surface, Threads

Fit = Annotated[Path, typer.Argument(help="Fit folder.", show_default=False)]
Campaign = Annotated[Path, typer.Argument(help="Campaign file (TOML).", show_default=False)]
OwnCampaign = Annotated[
    Path | None, typer.Option("--campaign", help="The fit's campaign; default: where it lay.")
]


def _say(quiet: bool) -> Callable[[str], None] | None:
    return None if quiet else lambda sentence: typer.echo(sentence, err=True)


def check(
    campaign: Campaign,
    surface: Surface = None,
    threads: Threads = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Judge a campaign before the fit: logs, excitation, what will be fixed, what to record next."""
    from sysid.workflows.check import check_campaign
    from sysid.workflows.trust_printing import print_check

    print_check(check_campaign(campaign, surface=surface, threads=threads, say=_say(quiet or json)), json)


def trust(
    fit: Fit,
    campaign: OwnCampaign = None,
    resamples: Annotated[int, typer.Option(help="Of the bootstrap over trials; 0: none.", min=0)] = 100,
    seed: Annotated[int, typer.Option(help="Of the bootstrap.", min=0)] = 1,
    threads: Threads = None,
    dask: Dask = None,
    quiet: Quiet = False,
    json: Json = False,
    long: Annotated[
        bool, typer.Option("--long", help="68 % intervals and the runs' predictions too.")
    ] = False,
) -> None:
    """Profile every free parameter of a fit: intervals, verdicts, bootstrap, spread of the runs."""
    from sysid.workflows.trust import TrustOptions, assess_fit
    from sysid.workflows.trust_printing import print_trust

    options = TrustOptions(campaign, resamples, seed, threads, dask)
    print_trust(assess_fit(fit, options, _say(quiet or json)), fit, json, long=long)


def validate(
    fit: Fit, campaign: Campaign, threads: Threads = None, quiet: Quiet = False, json: Json = False
) -> None:
    """Predict trials that a fit has not seen: NRMSE over the noise, when it ends, where it stops."""
    from sysid.workflows.trust_printing import print_validation
    from sysid.workflows.validate import validate_fit

    print_validation(validate_fit(fit, campaign, threads=threads, say=_say(quiet or json)), fit, json)


def cross_validate(
    fit: Fit,
    campaign: OwnCampaign = None,
    threads: Threads = None,
    dask: Dask = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Leave out one trial after the other, fit the others anew, predict the one left out."""
    from sysid.workflows.trust_printing import print_validation
    from sysid.workflows.validate import cross_validate as leave_out

    found = leave_out(fit, campaign, threads=threads, dask=dask, say=_say(quiet or json))
    print_validation(found, fit, json)


def compare(
    fits: Annotated[list[Path], typer.Argument(help="Fit folders, two or more.", show_default=False)],
    cross: Annotated[bool, typer.Option(help="Predict each fit's trials with every other.")] = True,
    threads: Threads = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Compare fits: Table II side by side, which differences are real, which fit predicts which trials."""
    from sysid.workflows.compare import compare_fits
    from sysid.workflows.trust_printing import print_comparison

    print_comparison(*compare_fits(fits, cross=cross, threads=threads, say=_say(quiet or json)), json)


COMMANDS: dict[str, Callable[..., None]] = {
    "check": check,
    "trust": trust,
    "validate": validate,
    "cross-validate": cross_validate,
    "compare": compare,
}
