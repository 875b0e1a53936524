"""Commands that land a drone with identified sets, and judge its design."""

from collections.abc import Callable
from typing import Annotated, TypeVar

from sysid.cli.adapter import command
from sysid.cli.root import app, unless
from sysid.journal import Journal
from sysid.marks import Flag
from sysid.workflows.options import (
    DesignStudyOptions,
    GearSets,
    ImpulseMapOptions,
    Json,
    LandingMapOptions,
    SimulateOptions,
)

Options = TypeVar("Options", LandingMapOptions, ImpulseMapOptions, DesignStudyOptions)


@command(
    app,
    "simulate",
    'sysid simulate fits/demo/gear-lf --motor fits/demo/motor --slope "20 deg" --speed "0.5 m/s"',
)
def simulate(options: SimulateOptions) -> None:
    """Land once per set: history, events, outcome."""
    from sysid.workflows.landing import simulate_landings

    simulate_landings(options)


@command(app, "landing-map", "sysid landing-map fits/demo/gear-lf --motor fits/demo/motor --out map.h5")
def landing_map(options: LandingMapOptions) -> int:
    """Map what becomes of landings over slope and speed.

    One map for every surface and controller, in one file and one figure.
    """
    from sysid.workflows.landing_maps import compute_landing_maps

    return _journalled(compute_landing_maps, options)


@command(
    app,
    "impulse-map",
    "sysid impulse-map fits/demo/gear-lf --motor fits/demo/motor --slopes 0:30:10deg --speeds 0.4,0.8 "
    "--out impulses.h5",
)
def impulse_map(options: ImpulseMapOptions) -> int:
    """Find the impulse that stops the pitching, and land.

    For every slope and speed: the delay and duration after which the drone turns least at its second impact.
    """
    from sysid.workflows.landing_maps import compute_impulse_maps

    return _journalled(compute_impulse_maps, options)


@command(
    app,
    "design-study",
    "sysid design-study fits/demo/gear-lf --motor fits/demo/motor --vary k_t=0.5:2:3 --slopes 0:60:5deg "
    "--out study.h5",
)
def design_study(options: DesignStudyOptions) -> int:
    """Vary legs, feet and motors: which change buys most.

    Says the steepest slope that each design lands on.
    """
    from sysid.workflows.landing_maps import study_designs

    return _journalled(study_designs, options)


@command(app, "static-limits", "sysid static-limits fits/demo/gear-lf --thrust 12")
def static_limits(
    sets: GearSets,
    thrust: Annotated[
        tuple[float, ...], Flag("Reverse thrust. Repeat it for several.", unit="N", default="0 and 12")
    ] = (0.0, 12.0),
    json: Json = False,
) -> None:
    """Print the steepest slope on which a drone stays.

    For every set, with rigid legs and with the legs as fitted.
    """
    from sysid.workflows.static_limits import print_static_limits

    print_static_limits(sets, thrust, json)


def _journalled(compute: Callable[[Options], object], options: Options) -> int:
    """Compute with a journal; return the exit code, 130 where the user stopped the computation."""
    with Journal(unless(options.compute.quiet), "landings"):
        return 130 if compute(options) is None else 0
