"""Landings in time: one with everything that happens, or many side by side with what became of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import CampaignError
from sysid.gear.model import (
    TO_THE_CLOCK,
    Drops,
    Ending,
    EventKind,
    GearTrajectory,
    PopulationSamples,
    Status,
    simulate,
    simulate_population,
)
from sysid.gear.propulsion import Propulsion
from sysid.landing.controllers import Controller
from sysid.landing.drone import Drone, Motors
from sysid.landing.outcomes import Outcome, Rules
from sysid.landing.settings import LANDING_TOLERANCE, Scenario
from sysid.shown import Shown
from sysid.types import BoolArray, FloatArray

if TYPE_CHECKING:
    import pandas as pd

# Largest number of samples of one landing's history; 40 columns of them are 300 MB.
MOST_SAMPLES = 1_000_000
HISTORY = (
    "time [s]",
    "x_B [m]", "z_B [m]", "q_B [rad]", "h_C [m]", "q_C [rad]", "h_D [m]", "q_D [rad]",
    "x_B_rate [m/s]", "z_B_rate [m/s]", "q_B_rate [rad/s]", "h_C_rate [m/s]", "q_C_rate [rad/s]",
    "h_D_rate [m/s]", "q_D_rate [rad/s]",
    "rear_normal_force [N]", "front_normal_force [N]", "rear_friction [N]", "front_friction [N]",
    "rear_thrust [N]", "front_thrust [N]",
)  # fmt: skip
# Upward unit vector of the frame N (x, z): at rest an accelerometer reads gravity along it.
_UP = np.array([0.0, 1.0])
_FAILED = (Status.STEP_COLLAPSED, Status.TOO_EXPENSIVE, Status.BLEW_UP)


@dataclass(frozen=True, eq=False)
class Landings:
    """What became of n landings; arrays are (n,), times [s] count from touchdown, NaN: never."""

    outcome: NDArray[np.int8]  # `Outcome` codes
    distance: FloatArray  # way of the centre of mass down the slope to rest, flip or the horizon [m]
    time: FloatArray  # of the rest
    flip: FloatArray
    trigger: FloatArray  # of the controller's beginning


class EventRow(TypedDict):
    """Time since touchdown [s], kind and place of an event."""

    time: float
    event: str
    of: str


EVENT = tuple(EventRow.__annotations__)


@dataclass(frozen=True, eq=False, repr=False)
class Landing(Shown):
    """One landing with its history from touchdown to the horizon; numbers as in `Landings`.

    Without a controller the motors stand still: a drop.
    """

    drone: Drone
    scenario: Scenario
    controller: Controller | None
    rules: Rules
    trajectory: GearTrajectory
    outcome: Outcome
    distance: float
    time: float
    trigger: float

    @property
    def label(self) -> str:
        """What the motors do."""
        return "no thrust" if self.controller is None else self.controller.label

    def __repr__(self) -> str:
        place = (
            f"{math.degrees(self.scenario.slope):g} deg, {self.scenario.speed:g} m/s, {self.drone.surface}"
        )
        came = f" after {self.time:.3f} s" if math.isfinite(self.time) else ""
        return f"<Landing ({self.label}; {place}): {self.outcome.name.lower()}{came}, {self.distance:.3f} m>"

    @property
    def samples(self) -> FloatArray:
        """(n, 21) the history in the units of `HISTORY`."""
        t = self.trajectory
        return np.column_stack([t.time, t.state, t.normal_force, t.friction_force, t.thrust])

    def to_frame(self) -> pd.DataFrame:
        """Return states and forces as columns such as ``x_B [m]`` over the time since touchdown [s]."""
        import pandas as pd

        return pd.DataFrame(self.samples, columns=HISTORY).set_index(HISTORY[0])

    @property
    def event_rows(self) -> list[EventRow]:
        """The events in the order of time."""
        events = [(self.trigger, "trigger", "body")] if math.isfinite(self.trigger) else []
        events += [(event.time, event.kind.name.lower(), event.foot) for event in self.trajectory.events]
        return [{"time": time, "event": kind, "of": place} for time, kind, place in sorted(events)]

    @property
    def events(self) -> pd.DataFrame:
        """Touchdowns, lift-offs, slips, sticks, flip, rest and trigger over the time since touchdown [s]."""
        import pandas as pd

        return pd.DataFrame(self.event_rows, columns=EVENT).rename(columns={"time": HISTORY[0]})


def ending_of(rules: Rules, at: Literal["clock", "rest", "both feet"]) -> Ending:
    """Return the rules in the form that the kernel takes."""
    return Ending(at, rules.rest_speed, rules.rest_turn, rules.rest_time, rules.flip_angle)


def classes(
    rules: Rules, distance: FloatArray, rest: FloatArray, flip: FloatArray, lost: BoolArray
) -> NDArray[np.int8]:
    """Return the `Outcome` codes (...) of landings.

    `distance` is the displacement of the body's centre of mass down the slope when the landing was over [m].
    `rest` and `flip` are the times when it came to rest and flipped [s], NaN where it did not; the earlier
    one counts. `lost` is whether the simulation failed.
    """
    far = np.abs(distance)
    flipped = np.isfinite(flip) & ~(rest < flip)
    rested = np.isfinite(rest) & ~flipped
    out = np.full(np.shape(distance), Outcome.OTHER, dtype=np.int8)
    out[rested & (far <= rules.long)] = Outcome.NEAR
    out[rested & (far <= rules.short)] = Outcome.SHORT
    out[flipped & (far <= rules.long)] = Outcome.FLIPPED
    out[np.asarray(lost)] = Outcome.LOST
    return out


def down_slope(position: FloatArray, slope: ArrayLike) -> FloatArray:
    """Return the coordinate down the slope (...) [m] of x and z, the first two entries of (..., >= 2)."""
    angle = np.asarray(slope, dtype=np.float64)
    return np.asarray(position[..., 0] * np.cos(angle) - position[..., 1] * np.sin(angle))


def land_many(
    drone: Drone,
    scenarios: Sequence[Scenario],
    controller: Controller,
    *,
    rules: Rules | None = None,
    tolerance: float = LANDING_TOLERANCE,
    threads: int | None = None,
    motors: Motors | None = None,
) -> Landings:
    """Simulate one drone's landings until each is at rest, flipped or over.

    The numbers do not depend on the number of threads, nor on what else is simulated. `tolerance` bounds the
    weighted rms error of the rates per step; `motors` are thrust histories that were computed before.
    """
    rules = rules or Rules()
    source = motors or Motors(drone, controller.ideal_reversal)
    triggers = _triggers(drone, scenarios, controller, source, rules, tolerance, threads)
    thrust = _propulsions(source, controller, triggers, rules)
    return run(drone, scenarios, thrust, triggers, rules, tolerance, threads)


def run(
    drone: Drone,
    scenarios: Sequence[Scenario],
    thrust: Propulsion | Sequence[Propulsion],
    triggers: FloatArray,
    rules: Rules,
    tolerance: float,
    threads: int | None = None,
) -> Landings:
    """Simulate landings under a given thrust, triggered at `triggers` (D,) [s]; see `land_many`."""
    clock = np.array([0.0, rules.horizon])
    drops, flown = _fly(drone, scenarios, thrust, clock, tolerance, threads, ending_of(rules, "rest"))
    rest, flip = flown.rest[0], flown.flip[0]
    distance = down_slope(flown.end_state[0], drops.slope) - down_slope(drops.body_state, drops.slope)
    outcome = classes(rules, distance, rest, flip, np.isin(flown.status[0], _FAILED))
    return Landings(outcome, distance, rest, flip, triggers)


def _fly(
    drone: Drone,
    scenarios: Sequence[Scenario],
    thrust: Propulsion | Sequence[Propulsion],
    clock: FloatArray,
    tolerance: float,
    threads: int | None,
    ending: Ending = TO_THE_CLOCK,
) -> tuple[Drops, PopulationSamples]:
    """Simulate landings in the gear's kernel; all share one clock [s]."""
    starts = np.array([drone.start(scenario) for scenario in scenarios])
    slopes = np.array([scenario.slope for scenario in scenarios])
    drops = Drops(slopes, starts, [clock] * len(scenarios), thrust)
    return drops, simulate_population(
        drone.row, drops, surface=drone.surface, tolerance=tolerance, threads=threads, ending=ending
    )


def second_impacts(
    drone: Drone,
    scenarios: Sequence[Scenario],
    thrust: Propulsion | Sequence[Propulsion],
    rules: Rules,
    tolerance: float,
    threads: int | None = None,
) -> FloatArray:
    """Return time [s], turn rate [rad/s], pitch minus slope [rad] (n, 3) at the front foot's first touch.

    NaN where it does not within the horizon, or not before the drone has flipped.
    """
    clock = np.array([0.0, rules.horizon])
    drops, flown = _fly(drone, scenarios, thrust, clock, tolerance, threads, ending_of(rules, "both feet"))
    state = flown.contact_state[0, :, 1]
    return np.column_stack([flown.first_contact[0, :, 1], state[:, 5], state[:, 2] - drops.slope])


def land(
    drone: Drone,
    scenario: Scenario,
    controller: Controller | None,
    *,
    rules: Rules | None = None,
    rate: float = 1000.0,
    motors: Motors | None = None,
) -> Landing:
    """Simulate one landing to the horizon and keep its history, sampled at `rate` [Hz]; see `land_many`.

    Without a controller there is no thrust.
    """
    rules = rules or Rules()
    if not 0.0 < rules.horizon * rate <= MOST_SAMPLES:
        raise CampaignError(
            f"landing: a history of {rules.horizon:g} s at {rate:g} samples per second; expected a rate "
            f"above 0 and at most {MOST_SAMPLES:g} samples, so lower the rate"
        )
    thrust, trigger = None, math.nan
    if controller is not None:
        source = motors or Motors(drone, controller.ideal_reversal)
        triggers = _triggers(drone, [scenario], controller, source, rules, LANDING_TOLERANCE, 1)
        (thrust,), trigger = _propulsions(source, controller, triggers, rules), float(triggers[0])
    clock = np.arange(round(rules.horizon * rate) + 1) / rate
    trajectory = simulate(
        drone.row, scenario.slope, drone.start(scenario), clock,
        surface=drone.surface, tolerance=LANDING_TOLERANCE, propulsion=thrust,
        ending=ending_of(rules, "clock"),
    )  # fmt: skip
    first = {event.kind: event.time for event in reversed(trajectory.events)}
    rest = first.get(EventKind.REST, math.nan)
    flip = first.get(EventKind.FLIP, math.nan)
    over = np.nanmin([flip, rest + rules.rest_time, math.inf])
    down = down_slope(trajectory.state, scenario.slope)
    known = np.isfinite(down)
    distance = float(np.interp(over, clock[known], down[known]) - down[0])
    if flip < rest:
        rest = math.nan  # what comes to rest on its back never landed
    lost = np.array(trajectory.status in _FAILED)
    code = classes(rules, np.array(distance), np.array(rest), np.array(flip), lost)
    return Landing(
        drone, scenario, controller, rules, trajectory, Outcome(int(code)), distance, rest, trigger
    )


def _propulsions(
    motors: Motors, controller: Controller, triggers: FloatArray, rules: Rules
) -> list[Propulsion]:
    """Return the thrust of every landing; those that trigger at touchdown share one."""
    late = rules.horizon + 1.0  # for a trigger that never comes
    begins = np.where(np.isfinite(triggers), triggers, late).tolist()
    shared = {begin: motors.propulsion(controller.steps, begin) for begin in set(begins)}
    return [shared[begin] for begin in begins]


def _triggers(
    drone: Drone,
    scenarios: Sequence[Scenario],
    controller: Controller,
    motors: Motors,
    rules: Rules,
    tolerance: float,
    threads: int | None,
) -> FloatArray:
    """Return when the controller begins in each landing [s], NaN where nothing triggers it.

    Landings begin at touchdown. The drone's sensor sees a flight whose motors keep the hover command.
    """
    controller.check_within(rules.horizon)
    if controller.sensing is None:
        return np.zeros(len(scenarios))
    sensing = controller.sensing
    clock = np.arange(round(sensing.window * sensing.rate) + 1) / sensing.rate
    hovering = motors.propulsion(controller.steps, rules.horizon + 1.0)
    _, flown = _fly(drone, scenarios, hovering, clock, tolerance, threads)
    states = flown.samples[0].reshape(len(scenarios), len(clock), 6)
    return np.array([sensing.trigger(specific_force(state, sensing.rate, drone)) for state in states])


def specific_force(states: FloatArray, rate: float, drone: Drone) -> FloatArray:
    """Return what an accelerometer at the body's centre of mass reads (n, 2) [m/s²], along ex and ez of it.

    `states` (n, 6) are x_B, z_B, q_B and rates, sampled at `rate` [Hz]; one that is NaN reads as hovering.
    Each reading is the mean over the sample before it, ``Δv/Δt + g``, in the axes of the body; the first is
    hovering flight.
    """
    gravity = drone.value("gravity")
    push = np.vstack([np.zeros(2), np.diff(states[:, 3:5], axis=0) * rate]) + gravity * _UP
    c, s = np.cos(states[:, 2]), np.sin(states[:, 2])
    read = np.column_stack([c * push[:, 0] - s * push[:, 1], s * push[:, 0] + c * push[:, 1]])
    return np.where(np.isfinite(read), read, gravity * _UP)
