"""Commands that judge a design: how steep it stands, and what changing it buys."""

from __future__ import annotations

from collections.abc import Callable
from math import radians
from typing import Annotated

import typer

from sysid.cli.landing import (
    ControllerFile,
    FlipAngle,
    Gear,
    Horizon,
    Ideal,
    Long,
    MapOut,
    Motor,
    Pair,
    Pairing,
    RestSpeed,
    RestTime,
    RestTurn,
    Short,
)
from sysid.cli.options import Dask, Force, Json, Quiet, Resume, Threads

Speeds = Annotated[str, typer.Option(help="Touchdown speeds in m/s: a list, or first:last:step.")]
Slopes = Annotated[str, typer.Option(help="Slopes in degrees: first:last:step or a list.")]


def static_limits(
    sets: Gear,
    thrust: Annotated[
        list[float] | None, typer.Option(help="Reverse thrust in newton; repeat it.", show_default="0 and 12")
    ] = None,
    json: Json = False,
) -> None:
    """Print the steepest slope on which each set's drone stays, its legs rigid and as fitted."""
    from sysid.workflows.static_limits import print_static_limits

    print_static_limits(sets, thrust or [0.0, 12.0], json)


def design_study(
    sets: Gear,
    motor: Motor,
    vary: Annotated[
        str,
        typer.Option(
            help="Factors first:last:count, as k_t=0.5:2:5,dx_f=0.8:1.4:4; reversal_delay=0ms:200ms:5 adds",
            show_default=False,
        ),
    ],
    out: MapOut,
    controller: Annotated[str, typer.Option(help="As for landing-map.")] = "reverse",
    slopes: Slopes = "0:60:1",
    speeds: Speeds = "0.3,0.6,0.9,1.2",
    share: Annotated[float, typer.Option(help="Share at rest within --long that makes a slope safe.")] = 0.5,
    spread_deg: Annotated[
        float, typer.Option(help="Each set lands with its nose so far up and down, too.")
    ] = 0,
    together: Annotated[bool, typer.Option("--together", help="Two changes on a grid: a map.")] = False,
    pair: Pairing = Pair.best,
    controllers: ControllerFile = None,
    ideal_reversal: Ideal = False,
    horizon: Horizon = 3.0,
    short: Short = 0.45,
    long: Long = 1.0,
    rest_speed: RestSpeed = 0.05,
    rest_turn: RestTurn = 0.2,
    rest_time: RestTime = 0.2,
    flip_deg: FlipAngle = 80.0,
    force: Force = False,
    resume: Resume = False,
    dask: Dask = None,
    threads: Threads = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Vary legs, feet and motors: the steepest slope that the drone lands on, and which change buys most."""
    from sysid.landing.design_study import StudySettings
    from sysid.landing.maps import MapSettings
    from sysid.landing.outcomes import Rules
    from sysid.workflows.design_study import study_designs
    from sysid.workflows.landing_sources import LandingFiles, LandingOptions, span

    sources = LandingOptions(motor, pair.value, (controller,), controllers, ideal_reversal)
    grid = (span(slopes, "--slopes"), span(speeds, "--speeds"))
    rules = Rules(horizon, short, long, rest_speed, rest_turn, rest_time, radians(flip_deg))
    settings = StudySettings(*grid, share, spread_deg, together, MapSettings(rules=rules, check=False))
    files = LandingFiles(out, force, resume, dask, threads, quiet, json)
    if study_designs(sets, sources, vary, settings, files) is None:
        raise typer.Exit(130)


COMMANDS: dict[str, Callable[..., None]] = {"static-limits": static_limits, "design-study": design_study}
