"""Commands that land a drone with identified sets, and judge its design."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from sysid.cli.adapter import command
from sysid.cli.root import app, unless
from sysid.journal import Journal
from sysid.workflows.options import (
    DesignStudyOptions,
    Flag,
    GearSets,
    ImpulseMapOptions,
    Json,
    LandingMapOptions,
    SimulateOptions,
)


@command(app, "simulate")
def simulate(options: SimulateOptions) -> None:
    """Land once per set: history, events, outcome."""
    from sysid.workflows.landing import simulate_landings

    simulate_landings(options)


@command(app, "landing-map")
def landing_map(options: LandingMapOptions) -> int:
    """Map what becomes of landings over slope and touchdown speed, for every surface and controller."""
    from sysid.workflows.landing_maps import compute_landing_maps

    return _journalled(compute_landing_maps, options)


@command(app, "impulse-map")
def impulse_map(options: ImpulseMapOptions) -> int:
    """Find for every slope and speed the impulse that stops the pitching at the second impact, and land."""
    from sysid.workflows.landing_maps import compute_impulse_maps

    return _journalled(compute_impulse_maps, options)


@command(app, "design-study")
def design_study(options: DesignStudyOptions) -> int:
    """Vary legs, feet and motors: the steepest slope that the drone lands on, and which change buys most."""
    from sysid.workflows.design_study import study_designs

    return _journalled(study_designs, options)


@command(app, "static-limits")
def static_limits(
    sets: GearSets,
    thrust: Annotated[
        tuple[float, ...], Flag("Reverse thrust [N]. Repeat it for several.", default="0 and 12")
    ] = (0.0, 12.0),
    json: Json = False,
) -> None:
    """Print the steepest slope on which each set's drone stays, its legs rigid and as fitted."""
    from sysid.workflows.static_limits import print_static_limits

    print_static_limits(sets, thrust, json)


def _journalled(compute: Callable[[Any], object], options: Any) -> int:
    """Compute with a journal; return the exit code, 130 where the user stopped the computation."""
    with Journal(unless(options.compute.quiet), "landings"):
        return 130 if compute(options) is None else 0
