"""What goes into the gear's simulations and what comes out: drops, trajectories, how they ended."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid.errors import CampaignError
from sysid.gear.kernel import driver as kernel
from sysid.gear.propulsion import Propulsion, plans
from sysid.types import FloatArray, IntArray


class Status(IntEnum):
    """How a simulated drop ended."""

    OK = kernel.OK
    STEP_COLLAPSED = kernel.STEP_COLLAPSED
    TOO_EXPENSIVE = kernel.TOO_EXPENSIVE
    BLEW_UP = kernel.BLEW_UP
    CAME_TO_REST = kernel.CAME_TO_REST
    FLIPPED_OVER = kernel.FLIPPED_OVER
    BOTH_TOUCHED = kernel.BOTH_TOUCHED

    @property
    def text(self) -> str:
        """Say what happened and what would help."""
        return {
            Status.OK: "integrated to the end",
            Status.STEP_COLLAPSED: "the step shrank below 1 ns: the parameters or the state are not physical",
            Status.TOO_EXPENSIVE: (
                "needed many times an ordinary drop's work: a contact or leg too stiff, or too many bounces "
                "and mode switches"
            ),
            Status.BLEW_UP: "a leg was pushed through its joint: the legs are too soft for this impact",
            Status.CAME_TO_REST: "ended at rest, as asked",
            Status.FLIPPED_OVER: "ended when it had flipped, as asked",
            Status.BOTH_TOUCHED: "ended when both feet had touched, as asked",
        }[self]


@dataclass(frozen=True)
class Ending:
    """When a drop is over, and what counts as rest and as a flip.

    Parameters
    ----------
    at : {"clock", "rest", "both feet"}
        Run to the end of the clock; end at rest or when flipped; end then or when both feet have touched.
    rest_speed, rest_turn, rest_time : float
        At rest while the body stays below this speed [m/s] and this turn rate [rad/s] for this time [s];
        under thrust not before `Propulsion.settled`.
    flip_angle : float
        Flipped beyond this angle from the slope [rad].
    """

    at: Literal["clock", "rest", "both feet"] = "clock"
    rest_speed: float = 0.05
    rest_turn: float = 0.2
    rest_time: float = 0.2
    flip_angle: float = math.radians(80.0)

    @property
    def packed(self) -> tuple[float, ...]:
        """What the kernel reads."""
        mode = ("clock", "rest", "both feet").index(self.at)
        return (float(mode), self.rest_speed, self.rest_turn, self.rest_time, self.flip_angle)


TO_THE_CLOCK = Ending()


class EventKind(IntEnum):
    """What happens to a foot, or to the body."""

    TOUCHDOWN = kernel.TOUCHDOWN
    LIFT_OFF = kernel.LIFT_OFF
    SLIP = kernel.SLIP
    STICK = kernel.STICK
    FLIP = kernel.FLIP
    REST = kernel.REST


@dataclass(frozen=True)
class Event:
    """One located event of a simulated drop.

    Parameters
    ----------
    time : float
        Since the drop's first sample [s].
    kind : EventKind
        SLIP and STICK are the beginnings of those modes. FLIP and REST as `Ending` says: by default turned
        beyond 80 deg from the slope; from here on below 0.05 m/s and 0.2 rad/s for 0.2 s at least.
    foot : {"rear", "front", "body"}
        What it happens to.
    """

    time: float
    kind: EventKind
    foot: Literal["rear", "front", "body"]


@dataclass(frozen=True, eq=False)
class GearTrajectory:
    """One simulated drop on its sample times.

    Parameters
    ----------
    time : (n,) array
        Sample times [s].
    state : (n, 14) array
        The seven `COORDINATES` [m, rad], then their rates, frame N; NaN after a failure.
    normal_force, friction_force : (n, 2) array
        Force of the surface on the rear and the front feet along its normal and down-slope [N].
    status : Status
        How it ended.
    reached : float
        Time integrated before the end or a failure [s].
    rhs_evaluations : int
        Right-hand sides spent.
    switches : (n_switches, 7) array
        Mode switches on a high-friction surface: time since the start [s], foot (0 rear, 1 front), 1 if it
        sticks from then on and 0 if it slips, friction available to the rear and front foot and required by
        them [N]; no rows on a low-friction surface. The available friction belongs to the mode that the foot
        has or has just lost: mu_k F_n where a slip came to zero, mu_s F_n where a stuck foot was released. A
        slipping foot that fails to stick slips back: a row with 0 for a foot that had not stuck. A release
        that heals within a step may be missed: 4 of 20 on a flat board at a tolerance of 1e-3 or 3e-4, none
        seen at 3e-5, the default of a single drop with events.
    events : tuple of Event
        Touchdowns, lift-offs, slips, sticks, flip and rest in the order of time, each as exact as the
        trajectory: located to 1e-6 s at `TIGHT_TOLERANCE`.
    thrust : (n, 2) array
        Of the rear and front pair of motors [N].
    """

    time: FloatArray
    state: FloatArray
    normal_force: FloatArray
    friction_force: FloatArray
    status: Status
    reached: float
    rhs_evaluations: int
    switches: FloatArray
    events: tuple[Event, ...]
    thrust: FloatArray


@dataclass(frozen=True, eq=False)
class Drops:
    """Drops that every candidate is simulated on.

    Parameters
    ----------
    slope : (D,) array
        Angle of each surface [rad], positive falls toward +x.
    body_state : (D, 6) array
        x_B, z_B, q_B and their rates at each drop's first sample, frame N [m, rad, s].
    time : sequence of D arrays
        Sample times of each drop [s], increasing; spacing may vary.
    propulsion : Propulsion, or sequence of D of them or None, optional
        Thrust of every drop, or of each; none by default.
    clock : (n_total,) array
        Derived: sample times since each drop's start, concatenated [s].
    offset : (D + 1,) array
        Derived: drop d owns samples offset[d]:offset[d + 1].
    segments, plans : arrays
        Derived: the thrust as the kernel reads it.
    """

    slope: FloatArray
    body_state: FloatArray
    time: Sequence[FloatArray]
    propulsion: Propulsion | Sequence[Propulsion | None] | None = None
    clock: FloatArray = field(init=False)
    offset: IntArray = field(init=False)
    segments: FloatArray = field(init=False)
    plans: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        slope = _frozen(self.slope)
        body = _frozen(self.body_state)
        times = tuple(_frozen(t) for t in self.time)
        if slope.ndim != 1 or body.shape != (len(slope), 6) or len(times) != len(slope) or not len(slope):
            raise CampaignError(
                f"drops: found slopes {slope.shape}, initial states {body.shape} and {len(times)} clocks; "
                "give D slopes, (D, 6) states and D clocks"
            )
        for number, (angle, state, clock) in enumerate(zip(slope, body, times, strict=True)):
            if not (math.isfinite(angle) and abs(angle) < math.pi / 2 and np.isfinite(state).all()):
                raise CampaignError(
                    f"drop {number}: slope {angle:g} rad or initial state {state.tolist()} is not usable; "
                    "give finite numbers and a slope between -pi/2 and pi/2"
                )
            increasing = clock.ndim == 1 and np.isfinite(clock).all() and (np.diff(clock) > 0).all()
            if not (increasing and len(clock)):
                raise CampaignError(
                    f"drop {number}: sample times do not increase; give one or more increasing times"
                )
        given = self.propulsion
        each = (given,) * len(slope) if given is None or isinstance(given, Propulsion) else tuple(given)
        if len(each) != len(slope):
            raise CampaignError(
                f"drops: found {len(each)} propulsions for {len(slope)} drops; give one for all, or one each"
            )
        segments, plan = plans(each)
        derived = {
            "propulsion": each,
            "segments": _frozen(segments),
            "plans": _frozen(plan),
            "slope": slope,
            "body_state": body,
            "time": times,
            "clock": _frozen(np.concatenate([t - t[0] for t in times])),
            "offset": np.cumsum([0, *(len(t) for t in times)], dtype=np.int64),
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True, eq=False)
class PopulationSamples:
    """Every candidate on every drop.

    Parameters
    ----------
    samples : (P, n_total, 6) array
        x_B, z_B, q_B and their rates at every sample of every drop, concatenated in drop order; NaN after a
        failure.
    reached : (P, D) array
        Share of the drop's time integrated before a failure, 1 without one.
    status : (P, D) int8 array
        `Status` codes.
    rhs_evaluations : (P, D) int64 array
        Right-hand sides spent.
    switches : (P, D) int64 array
        Mode switches on a high-friction surface; at a fit's tolerance up to a fifth of them are missed.
    first_contact : (P, D, 2) array
        First touchdown of the rear and of the front foot since the drop's start [s]; NaN where none.
    flip, rest : (P, D) array
        When the body flipped, and from when on it stayed at rest, by `Ending` [s], the latter to a step's
        length; NaN where it did not.
    contact_state : (P, D, 2, 6) array
        x_B, z_B, q_B and their rates at the two first touchdowns.
    end_state : (P, D, 6) array
        The same at the end: of the clock, of a failure, or where a drop was to end at rest or flipped.
    marks : (n, 7) array
        The events of a single drop as the kernel writes them.
    """

    samples: FloatArray
    reached: FloatArray
    status: NDArray[np.int8]
    rhs_evaluations: IntArray
    switches: IntArray
    first_contact: FloatArray
    flip: FloatArray
    rest: FloatArray
    contact_state: FloatArray
    end_state: FloatArray
    marks: FloatArray


def _frozen(values: ArrayLike) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array
