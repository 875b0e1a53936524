"""Impulse control (section III-C, Figs. 9 to 11): the best impulse of a landing, and maps of both.

The best delay and duration stop the pitching at the second impact.

At the first impact the motors idle; after a delay the front pair pushes for a duration; then all reverse.
The best pair of numbers leaves the smallest angular speed when the front foot first touches down, and among
equals the attitude nearest the slope's.

A landing knows nothing of commands that are still to come. So when the front foot touches at ``t``, all
pairs whose commands agree up to ``t`` share one simulation: every duration once ``delay >= t`` without an
impulse, and every longer duration once ``delay + duration >= t``. What is left is simulated.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from sysid.gear.propulsion import Propulsion
from sysid.landing.controllers import Controller, Step, impulse
from sysid.landing.drone import Drone, Motors
from sysid.landing.maps import CellMap, Fleets, LandingMap, columns_of_fleets, judged, numbers_of
from sysid.landing.outcomes import Rules
from sysid.landing.settings import LANDING_TOLERANCE, ImpulseSettings, MapSettings, Scenario
from sysid.landing.simulate import Landings, run, second_impacts
from sysid.parallel import Columns
from sysid.resume import Computing
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


OPTIMUM = tuple(Optimum.__dataclass_fields__)
UNITS = {
    "delay": "s", "duration": "s", "turn": "rad/s", "attitude": "rad", "simulated": "1",
    "refined_delay": "s", "refined_duration": "s", "refined_turn": "rad/s", "refined_attitude": "rad",
}  # fmt: skip


def variants(impulses: ImpulseSettings) -> tuple[str, ...]:
    """Name the landings after the search: impulse of the grid or refined, and what follows it."""
    then = {-1.0: "reverse", 0.0: "off"}.get(impulses.after, f"command:{impulses.after:g}")
    return f"impulse, then {then}", f"refined impulse, then {then}", "impulse alone"


def after_impulses(impulses: ImpulseSettings) -> tuple[Controller, ...]:
    """Return what each of `variants` ends with, under the name of its map: a static limit needs no more."""
    levels = (impulses.after, impulses.after, 0.0)
    return tuple(
        Controller(name, (Step(0.0, level, level),), impulses.ideal_reversal)
        for name, level in zip(variants(impulses), levels, strict=True)
    )


@dataclass(frozen=True, eq=False)
class ImpulseMap(CellMap):
    """The best impulse of every cell and set: (S, n, m) arrays by the names of `Optimum`."""

    optimum: dict[str, FloatArray]

    def mean(self, name: str) -> FloatArray:
        """Mean over the sets (n, m) [SI]."""
        return np.asarray(self.optimum[name].mean(axis=0))

    def sigma(self, name: str) -> FloatArray:
        """Standard deviation over the sets (n, m) [SI], divided by S - 1; 0 for a single set."""
        values = self.optimum[name]
        return np.asarray(values.std(axis=0, ddof=1)) if len(values) > 1 else np.zeros(values.shape[1:])


@dataclass(frozen=True, eq=False)
class ImpulseWork:
    """Rows (P, 3) of a drone's number, slope [rad] and speed [m/s] to the best impulse and how it lands.

    All rows have one drone. The columns are the fields of `Optimum`, then `judged` of each variant.
    """

    drones: tuple[Drone, ...]
    settings: MapSettings
    impulses: ImpulseSettings
    threads: int | None = None
    _known: dict[tuple[int, float], Impulses] = field(default_factory=dict, init=False, repr=False)

    def __call__(self, rows: FloatArray) -> Columns:
        number, settings = int(rows[0, 0]), self.settings
        cells = [Scenario(slope, speed) for slope, speed in rows[:, 1:].tolist()]
        search, alone = self._impulses(number, self.impulses.after), self._impulses(number, 0.0)
        best = search.optimize(cells)
        out = [getattr(best, name) for name in OPTIMUM]
        for source, delay, duration in (
            (search, best.delay, best.duration),
            (search, best.refined_delay, best.refined_duration),
            (alone, best.delay, best.duration),
        ):
            thrust = [source.thrust(*pair) for pair in zip(delay.tolist(), duration.tolist(), strict=True)]

            def land(tolerance: float, thrust: Sequence[Propulsion] = thrust) -> Landings:
                return run(
                    self.drones[number], cells, thrust, np.zeros(len(cells)), settings.rules, tolerance,
                    self.threads,
                )  # fmt: skip

            out += judged(land, settings)
        return tuple(out)

    def _impulses(self, drone: int, after: float) -> Impulses:
        key = (drone, after)
        if key not in self._known:
            # The thousands of thrust histories of a drone are hundreds of megabytes: keep one drone's.
            for other in [known for known in self._known if known[0] != drone]:
                del self._known[other]
            settings = replace(self.impulses, after=after)
            self._known[key] = Impulses(
                self.drones[drone], settings, self.settings.rules, self.settings.tolerance, self.threads
            )
        return self._known[key]


def impulse_maps(
    fleets: Fleets,
    settings: MapSettings | None = None,
    impulses: ImpulseSettings | None = None,
    how: Computing | None = None,
) -> tuple[tuple[ImpulseMap, ...], tuple[LandingMap, ...]]:
    """Search the best impulse of every cell and set, and land with it.

    The arguments are as in `sysid.landing.maps.landing_maps`. Per surface there are one impulse map and three
    landing maps: the impulse and then `impulses.after`, the same refined, and the impulse alone (all motors
    off after it, at the delay and duration found with `impulses.after` following). Where the work was stopped
    there are none.
    """
    settings, impulses, how = settings or MapSettings(), impulses or ImpulseSettings(), how or Computing()
    drones = tuple(drone for fleet in fleets for drone in fleet)
    cells = np.array([(cell.slope, cell.speed) for cell in settings.cells()])
    by_slope = cells.reshape(len(settings.slopes_deg), len(settings.speeds), 2)
    parts = {f"slope-{s + 1}": rows for s, rows in enumerate(by_slope)}
    work = ImpulseWork(drones, settings, impulses, how.threads)
    ideal = ", ideal reversal" if impulses.ideal_reversal else ""
    axes = np.array(settings.slopes_deg), np.array(settings.speeds)
    searched, landed = [], []
    for fleet, columns in zip(fleets, columns_of_fleets(work, fleets, parts, how), strict=False):
        whole = iter([np.stack(rows, axis=1) for rows in zip(*columns.values(), strict=True)])
        surface, names = fleet[0].surface, tuple(drone.name for drone in fleet)
        optimum = {name: next(whole) for name in OPTIMUM}
        searched.append(ImpulseMap(surface, f"impulse{ideal}", names, *axes, optimum))
        landed += [
            LandingMap(
                surface, f"{variant}{ideal}", names, *axes, *islice(whole, 4),
                checked=settings.check, numbers=numbers_of(fleet),
            )
            for variant in variants(impulses)
        ]  # fmt: skip
    return tuple(searched), tuple(landed)
