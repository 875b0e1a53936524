"""Commands that land a drone with identified sets."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from math import radians
from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.options import Dask, Force, Json, Quiet, Resume, Threads


class Pair(StrEnum):
    """Which motor set goes with a gear set."""

    best = "best"
    each = "each"


class Trigger(StrEnum):
    """What starts a controller."""

    contact = "contact"
    imu = "imu"


Gear = Annotated[Path, typer.Argument(help="Gear sets: fit folder or exported file.", show_default=False)]
Gears = Annotated[
    list[Path], typer.Argument(help="Gear sets, one fit folder or file per surface.", show_default=False)
]
Motor = Annotated[Path, typer.Option(help="Motor sets: fit folder or exported file.", show_default=False)]
Pairing = Annotated[Pair, typer.Option(help="Motor set for every gear set: the best, or set i for set i.")]
Controllers = Annotated[
    list[str] | None,
    typer.Option(
        "--controller",
        help="off, reverse, command:U, impulse:delay=50ms,duration=0.1, or one's own; repeat it.",
        show_default="off and reverse",
    ),
]
ControllerFile = Annotated[
    Path | None, typer.Option("--controllers", help="Python file that registers controllers.")
]
Ideal = Annotated[bool, typer.Option("--ideal-reversal", help="Motors without reversal delay.")]
TriggerBy = Annotated[
    Trigger, typer.Option(help="First contact, or the drone's own accelerometer (2 g, 30 Hz).")
]
Pitch = Annotated[float, typer.Option(help="At touchdown, positive down-slope [deg].")]
Drift = Annotated[float, typer.Option(help="Horizontal speed at touchdown, positive down-slope [m/s].")]
Horizon = Annotated[float, typer.Option(help="Simulated time from touchdown [s].")]
Short = Annotated[float, typer.Option(help="Short distance that divides the classes [m].")]
Long = Annotated[float, typer.Option(help="Long distance that divides the classes [m].")]
RestSpeed = Annotated[float, typer.Option(help="At rest below this speed [m/s].")]
RestTurn = Annotated[float, typer.Option(help="At rest below this turn rate [rad/s].")]
RestTime = Annotated[float, typer.Option(help="At rest when slow for this long [s].")]
FlipAngle = Annotated[float, typer.Option(help="Flipped beyond this angle from the slope [deg].")]
Slopes = Annotated[str, typer.Option(help="Slopes [deg]: first:last:step or a list.")]
Speeds = Annotated[str, typer.Option(help="Touchdown speeds [m/s]: first:last:step or a list.")]
MapOut = Annotated[Path, typer.Option(help="HDF5 file to write.", show_default=False)]
Figure = Annotated[Path | None, typer.Option(help="Figure.", show_default="beside the HDF5 file")]
NoCheck = Annotated[
    bool, typer.Option("--no-check", help="Do not repeat with half the tolerance to mark uncertain cells.")
]


def simulate(
    sets: Gear,
    motor: Motor,
    slope_deg: Annotated[float, typer.Option(help="Slope of the surface [deg].")],
    speed: Annotated[float, typer.Option(help="Vertical touchdown speed [m/s].", min=0)],
    controller: Annotated[str, typer.Option(help="As for landing-map.")] = "reverse",
    out: Annotated[Path | None, typer.Option(help="Histories: .csv or .h5.", show_default=False)] = None,
    pair: Pairing = Pair.best,
    controllers: ControllerFile = None,
    ideal_reversal: Ideal = False,
    trigger: TriggerBy = Trigger.contact,
    pitch_deg: Pitch = 0.0,
    pitch_rate: Annotated[float, typer.Option(help="At touchdown [rad/s].")] = 0.0,
    horizontal_speed: Drift = 0.0,
    height: Annotated[
        float | None, typer.Option(help="Descend from so far above the touchdown, attitude controlled [m].")
    ] = None,
    horizon: Horizon = 3.0,
    short: Short = 0.45,
    long: Long = 1.0,
    rest_speed: RestSpeed = 0.05,
    rest_turn: RestTurn = 0.2,
    rest_time: RestTime = 0.2,
    flip_deg: FlipAngle = 80.0,
    rate: Annotated[float, typer.Option(help="Samples per second [Hz].", min=10)] = 1000.0,
    force: Force = False,
    json: Json = False,
) -> None:
    """Land once per set: history, events, outcome."""
    from sysid.landing.outcomes import Rules
    from sysid.landing.scenario import Scenario
    from sysid.workflows.landing import simulate_landings
    from sysid.workflows.landing_sources import LandingOptions

    imu = trigger is Trigger.imu
    sources = LandingOptions(motor, pair.value, (controller,), controllers, ideal_reversal, imu)
    begin = Scenario(radians(slope_deg), speed, radians(pitch_deg), pitch_rate, horizontal_speed)
    rules = Rules(horizon, short, long, rest_speed, rest_turn, rest_time, radians(flip_deg))
    simulate_landings(sets, sources, begin, rules, out=out, height=height, rate=rate, force=force, json=json)


def landing_map(
    sets: Gears,
    motor: Motor,
    out: MapOut,
    controller: Controllers = None,
    figure: Figure = None,
    experiments: Annotated[Path | None, typer.Option(help="Real landings (CSV) to lay over.")] = None,
    slopes: Slopes = "0:45:1",
    speeds: Speeds = "0:2:0.05",
    pair: Pairing = Pair.best,
    controllers: ControllerFile = None,
    ideal_reversal: Ideal = False,
    trigger: TriggerBy = Trigger.contact,
    pitch_deg: Pitch = 0.0,
    horizontal_speed: Drift = 0.0,
    horizon: Horizon = 3.0,
    short: Short = 0.45,
    long: Long = 1.0,
    rest_speed: RestSpeed = 0.05,
    rest_turn: RestTurn = 0.2,
    rest_time: RestTime = 0.2,
    flip_deg: FlipAngle = 80.0,
    no_check: NoCheck = False,
    force: Force = False,
    resume: Resume = False,
    dask: Dask = None,
    threads: Threads = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Map what becomes of landings over slope and touchdown speed, for every surface and controller."""
    from sysid.landing.maps import MapSettings
    from sysid.landing.outcomes import Rules
    from sysid.workflows.landing_maps import MapOptions, compute_landing_maps
    from sysid.workflows.landing_sources import LandingOptions, span

    names, imu = tuple(controller or ("off", "reverse")), trigger is Trigger.imu
    sources = LandingOptions(motor, pair.value, names, controllers, ideal_reversal, imu)
    rules = Rules(horizon, short, long, rest_speed, rest_turn, rest_time, radians(flip_deg))
    cells = (span(slopes, "--slopes"), span(speeds, "--speeds"))
    settings = MapSettings(
        *cells, rules, check=not no_check, pitch=radians(pitch_deg), horizontal_speed=horizontal_speed
    )
    options = MapOptions(out, force, resume, dask, threads, quiet or json, json, figure, experiments)
    _end(compute_landing_maps(sets, sources, settings, options, None if quiet else _say))


def impulse_map(
    sets: Gears,
    motor: Motor,
    out: MapOut,
    figure: Figure = None,
    slopes: Slopes = "0:45:1",
    speeds: Speeds = "0:2:0.05",
    delays: Annotated[str, typer.Option(help="Delays of the impulse [s].")] = "0:0.26:0.01",
    durations: Annotated[str, typer.Option(help="Durations of the impulse [s].")] = "0:0.16:0.01",
    front: Annotated[float, typer.Option(help="Command of the front pair in the impulse.")] = 0.8,
    rear: Annotated[
        float | None,
        typer.Option(
            help="Command of the rear pair in the impulse.",
            show_default="0.1; with --ideal-reversal the opposite of the front pair's",
        ),
    ] = None,
    idle: Annotated[float, typer.Option(help="Command of all motors until the impulse.")] = 0.1,
    after: Annotated[float, typer.Option(help="Command of all motors after it.")] = -1.0,
    worth: Annotated[
        float, typer.Option(help="Share of the turn rate that an impulse must take away.")
    ] = 0.05,
    equal: Annotated[
        float, typer.Option(help="Turn rates below this are equal: attitude decides [rad/s].")
    ] = 0.0,
    pair: Pairing = Pair.best,
    ideal_reversal: Ideal = False,
    horizon: Horizon = 3.0,
    short: Short = 0.45,
    long: Long = 1.0,
    rest_speed: RestSpeed = 0.05,
    rest_turn: RestTurn = 0.2,
    rest_time: RestTime = 0.2,
    flip_deg: FlipAngle = 80.0,
    no_check: NoCheck = False,
    force: Force = False,
    resume: Resume = False,
    dask: Dask = None,
    threads: Threads = None,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Find for every slope and speed the impulse that stops the pitching at the second impact, and land."""
    from sysid.landing.impulse import ImpulseSettings, rear_command
    from sysid.landing.maps import MapSettings
    from sysid.landing.outcomes import Rules
    from sysid.workflows.landing_maps import MapOptions, compute_impulse_maps
    from sysid.workflows.landing_sources import LandingOptions, span

    sources = LandingOptions(motor, pair.value, ideal_reversal=ideal_reversal)
    tried = (span(delays, "--delays"), span(durations, "--durations"))
    behind = rear_command(front, ideal_reversal=ideal_reversal) if rear is None else rear
    impulses = ImpulseSettings(*tried, front, behind, idle, after, ideal_reversal, worth=worth, equal=equal)
    cells = (span(slopes, "--slopes"), span(speeds, "--speeds"))
    rules = Rules(horizon, short, long, rest_speed, rest_turn, rest_time, radians(flip_deg))
    settings = MapSettings(*cells, rules, check=not no_check)
    options = MapOptions(out, force, resume, dask, threads, quiet or json, json, figure)
    _end(compute_impulse_maps(sets, sources, settings, impulses, options, None if quiet else _say))


COMMANDS: dict[str, Callable[..., None]] = {
    "simulate": simulate,
    "landing-map": landing_map,
    "impulse-map": impulse_map,
}


def _say(sentence: str) -> None:
    typer.echo(sentence, err=True)


def _end(result: object) -> None:
    """Tell the shell that a map was stopped by the user."""
    if result is None:
        raise typer.Exit(130)
