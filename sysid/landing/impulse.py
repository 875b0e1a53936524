"""Impulse control (section III-C): the delay and duration that stop the pitching at the second impact.

At the first impact the motors idle; after a delay the front pair pushes for a duration; then all reverse.
The best pair of numbers leaves the smallest angular speed when the front foot first touches down, and among
equals the attitude nearest the slope's.

A landing knows nothing of commands that are still to come. So when the front foot touches at ``t``, all
pairs whose commands agree up to ``t`` share one simulation: every duration once ``delay >= t`` without an
impulse, and every longer duration once ``delay + duration >= t``. What is left is simulated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid.gear.propulsion import Propulsion
from sysid.landing.controllers import Step, impulse
from sysid.landing.drone import Drone, Motors
from sysid.landing.outcomes import Rules
from sysid.landing.settings import LANDING_TOLERANCE, ImpulseSettings, Scenario
from sysid.landing.simulate import second_impacts
from sysid.types import BoolArray, FloatArray, IntArray

# Number of landings that one call simulates, which bounds the memory.
_AT_ONCE = 20_000
# Largest difference of angular speed that makes no difference when an optimum is refined [rad/s].
_EQUAL_TURN = 0.02


@dataclass(frozen=True, eq=False)
class Optimum:
    """The best impulse of each of n landings, on the grid and refined; arrays are (n,).

    Delay and duration are 0 where no impulse is worth it or the front foot never touches down: all motors
    reverse (what follows the impulse) at once.
    """

    delay: FloatArray  # [s]
    duration: FloatArray  # [s]
    turn: FloatArray  # angular speed at the second impact [rad/s]; NaN without one
    attitude: FloatArray  # pitch minus slope at the second impact [rad]; NaN without one
    refined_delay: FloatArray
    refined_duration: FloatArray
    refined_turn: FloatArray
    refined_attitude: FloatArray
    simulated: IntArray  # landings that the grid took; every other pair of it equals one of them


class Impulses:
    """Impulses of one drone, with their thrust histories.

    By the `rules` of the landings, a drone that has flipped has no second impact, and there is none after
    their horizon. `tolerance` and `threads` are as in `sysid.landing.simulate.land_many`.
    """

    def __init__(
        self,
        drone: Drone,
        settings: ImpulseSettings,
        rules: Rules | None = None,
        tolerance: float = LANDING_TOLERANCE,
        threads: int | None = None,
    ) -> None:
        rules = rules or Rules()
        self._drone = drone
        self._settings = settings
        self._rules = replace(rules, horizon=min(settings.horizon, rules.horizon))
        self._accuracy = (tolerance, threads)
        self._motors = Motors(drone, settings.ideal_reversal)
        self._thrust: dict[tuple[float, float], Propulsion] = {}

    def thrust(self, delay: float, duration: float) -> Propulsion:
        """Return the thrust of an impulse; an infinite delay idles for ever."""
        key = (delay, duration)
        if key not in self._thrust:
            how = self._settings
            steps: Sequence[Step] = [Step(0.0, how.idle, how.idle)]
            if delay != math.inf:
                steps = impulse(delay, duration, how.after, how.front, how.rear_pair, how.idle)
            self._thrust[key] = self._motors.propulsion(steps)
        return self._thrust[key]

    def second_impacts(
        self, cells: Sequence[Scenario], delay: FloatArray, duration: FloatArray
    ) -> FloatArray:
        """Return time [s], turn rate [rad/s] and pitch minus slope [rad] (n, 3) at each second impact.

        NaN where the front foot does not touch down within the horizon, or not before the drone has flipped.
        """
        out = np.empty((len(cells), 3))
        for first in range(0, len(cells), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            pairs = zip(delay[part].tolist(), duration[part].tolist(), strict=True)
            thrust = [self.thrust(*pair) for pair in pairs]
            out[part] = second_impacts(self._drone, cells[part], thrust, self._rules, *self._accuracy)
        return out

    def search(self, cells: Sequence[Scenario]) -> tuple[FloatArray, IntArray]:
        """Return what every pair of the grid leaves at the second impact of every landing.

        Impacts (n, n_delays, n_durations, 3) as of `second_impacts`, and how many landings (n,) it took.
        """
        settings = self._settings
        delays, durations = np.array(settings.delays), np.array(settings.durations)
        impacts = np.full((len(cells), len(delays), len(durations), 3), np.nan)
        simulated = np.zeros(len(cells), dtype=np.int64)

        def simulate(which: IntArray, delay: FloatArray, duration: FloatArray) -> FloatArray:
            np.add.at(simulated, which, 1)
            chosen = [cells[i] for i in which.tolist()]
            return self.second_impacts(chosen, delay, duration)

        every = np.arange(len(cells))
        idle = simulate(every, np.full(len(cells), np.inf), np.zeros(len(cells)))
        # NaN compares as false: without a second impact nothing is shared.
        late = delays[None] >= idle[:, :1]
        impacts[late] = np.broadcast_to(idle[:, None], (len(cells), len(delays), 3))[late][:, None]
        which, d = np.nonzero(~late)
        longest = simulate(which, delays[d], np.full(len(d), durations[-1]))
        impacts[which, d, -1] = longest
        shared = delays[d][:, None] + durations[None] >= longest[:, :1]
        shared[:, -1] = True
        rows, t = np.nonzero(shared)
        impacts[which[rows], d[rows], t] = longest[rows]
        rows, t = np.nonzero(~shared)
        impacts[which[rows], d[rows], t] = simulate(which[rows], delays[d[rows]], durations[t])
        return impacts, simulated

    def optimize(self, cells: Sequence[Scenario]) -> Optimum:
        """Return the best impulse of every landing, on the grid and refined."""
        settings = self._settings
        impacts, simulated = self.search(cells)
        flat = impacts.reshape(len(cells), -1, 3)
        delay, duration = (
            axis.ravel() for axis in np.meshgrid(settings.delays, settings.durations, indexing="ij")
        )
        if not settings.has_none:
            none = np.zeros(len(cells))
            alone = self.second_impacts(cells, none, none)
            flat = np.concatenate([alone[:, None], flat], axis=1)
            delay, duration = np.insert(delay, 0, 0.0), np.insert(duration, 0, 0.0)
            simulated = simulated + 1
        best = np.array([best_pair(impact, delay, duration, settings.equal) for impact in flat])
        everyone = np.arange(len(cells))
        least = np.maximum(np.abs(flat[everyone, best, 1]), settings.equal)
        # The first pair is no impulse. NaN compares as false; where nothing ever touches, it is the best.
        omitted = (1.0 - settings.worth) * np.abs(flat[:, 0, 1]) <= least
        best[omitted] = 0
        chosen = flat[everyone, best]
        grid_delay, grid_duration = delay[best], duration[best]
        refined_delay, refined_duration, refined = grid_delay.copy(), grid_duration.copy(), chosen.copy()
        step = 0.5 * min([*np.diff(settings.delays), *np.diff(settings.durations), 0.01])
        while settings.finest > 0 and step >= 0.999 * settings.finest:
            self._refine(cells, ~omitted, step, refined_delay, refined_duration, refined)
            step /= 2
        return Optimum(
            grid_delay, grid_duration, chosen[:, 1], chosen[:, 2],
            refined_delay, refined_duration, refined[:, 1], refined[:, 2], simulated,
        )  # fmt: skip

    def _refine(
        self,
        cells: Sequence[Scenario],
        which_cells: BoolArray,
        step: float,
        delay: FloatArray,
        duration: FloatArray,
        impacts: FloatArray,
    ) -> None:
        """Move every optimum to the best of its eight neighbours at a distance, where one is better."""
        settings = self._settings
        # An impulse that comes too late to matter is not refined.
        chosen = np.flatnonzero(which_cells & np.isfinite(impacts[:, 0]) & (delay < impacts[:, 0]))
        around = np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b]) * step
        which = np.repeat(chosen, len(around))
        tried = np.tile(around, (len(chosen), 1)) + np.column_stack([delay[which], duration[which]])
        tried = np.round(tried, 9)
        inside = (tried[:, 0] >= settings.delays[0]) & (tried[:, 0] <= settings.delays[-1])
        inside &= (tried[:, 1] >= settings.durations[0]) & (tried[:, 1] <= settings.durations[-1])
        which, tried = which[inside], tried[inside]
        if not len(which):
            return
        new = self.second_impacts([cells[i] for i in which.tolist()], tried[:, 0], tried[:, 1])
        for i in chosen:
            near = np.flatnonzero(which == i)
            trials = np.vstack([impacts[i], new[near]])
            pairs = np.vstack([[delay[i], duration[i]], tried[near]])
            best = best_pair(trials, pairs[:, 0], pairs[:, 1], max(_EQUAL_TURN, settings.equal))
            impacts[i], (delay[i], duration[i]) = trials[best], pairs[best]


def best_pair(impacts: FloatArray, delay: FloatArray, duration: FloatArray, equal: float = 0.0) -> int:
    """Return which of n impulses, by impact (n, 3) as of `Impulses.second_impacts`, is the best.

    The smallest turn rate; among equals the attitude nearest the slope, then the shortest and the earliest
    impulse, so that one which comes too late is none. Turn rates below `equal` [rad/s] are equal. Without
    any second impact: the first.
    """
    turn = np.abs(impacts[:, 1])
    turn = np.where(np.isnan(turn), np.inf, np.maximum(turn, equal))
    attitude = np.nan_to_num(np.abs(impacts[:, 2]), nan=np.inf)
    return int(np.lexsort((delay, duration, attitude, turn))[0])
