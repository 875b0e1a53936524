"""Thrust of a drone's motor pairs under a controller's steps: computed once, shared by every landing.

The thrust does not depend on the motion, and before the trigger every landing hovers; so one history per
list of steps, on a clock that starts at the trigger, serves every slope and speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter
from typing import Literal

from sysid.gear.propulsion import Propulsion
from sysid.integrate.piecewise import PiecewiseCubic
from sysid.landing.controllers import Step
from sysid.landing.drone import MOTORS_PER_PAIR, Drone
from sysid.motor.pair_thrust import thrust_history

# The thrust is computed for this time after the last command [s] and is constant from then on: ten
# electromechanical time constants of 0.08 s, and a reversal ends after 0.25 s.
SETTLING = 1.0

Commands = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class MotorState:
    """Command u [1], current [A] and speed [rad/s] of the (rear, front) motors when the trigger comes."""

    command: tuple[float, float]
    current: tuple[float, float]
    speed: tuple[float, float]


class Motors:
    """Thrust histories of one drone that hovers until the trigger, or whose motors then have a `state`."""

    def __init__(self, drone: Drone, ideal_reversal: bool = False, state: MotorState | None = None) -> None:
        self._state = state
        self._drone = drone
        self._ideal = ideal_reversal
        self._histories: dict[tuple[int, Commands], PiecewiseCubic] = {}

    def history(self, commands: Commands, pair: int = 0) -> PiecewiseCubic:
        """Return the thrust of a pair (0 rear, 1 front) [N] on the trigger's clock.

        `commands` are instants since the trigger [s] and the command u from each on. The pairs differ only
        where the motors have a `MotorState`.
        """
        # A command that repeats the one before changes nothing.
        changes = tuple(next(equal) for _, equal in groupby(commands, key=itemgetter(1)))
        state = self._state
        key = (0 if state is None else pair, changes)
        if key not in self._histories:
            times = [-1.0, *(time for time, _ in changes)]
            before = self._drone.hover_command if state is None else state.command[pair]
            levels = [before, *(level for _, level in changes)]
            self._histories[key] = thrust_history(
                self._drone.motor,
                times,
                levels,
                changes[-1][0] + SETTLING,
                motors=MOTORS_PER_PAIR,
                initial="steady" if state is None else (state.current[pair], state.speed[pair]),
                ideal_reversal=self._ideal,
            )
        return self._histories[key]

    def propulsion(self, steps: Sequence[Step], begins: float | Literal["first contact"] = 0.0) -> Propulsion:
        """Return the thrust of both pairs; the trigger comes at `begins` since the first sample [s]."""
        return Propulsion(
            self.history(tuple((step.after, step.rear) for step in steps)),
            self.history(tuple((step.after, step.front) for step in steps), pair=1),
            begins=begins,
            settled=steps[-1].after,
        )
