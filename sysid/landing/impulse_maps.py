"""Impulse control over slope and touchdown speed (Figs. 9 to 11): the best impulse, and how it lands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sysid.landing.controllers import Controller, Step
from sysid.landing.drone import Drone
from sysid.landing.impulse import Impulses, ImpulseSettings, Optimum
from sysid.landing.maps import CellMap, LandingMap, MapSettings, map_identity
from sysid.landing.scenario import Scenario
from sysid.landing.simulate import run
from sysid.parallel import Columns
from sysid.resume import Computing
from sysid.types import FloatArray

OPTIMUM = tuple(Optimum.__dataclass_fields__)
UNITS = {
    "delay": "s", "duration": "s", "turn": "rad/s", "attitude": "rad", "simulated": "1",
    "refined_delay": "s", "refined_duration": "s", "refined_turn": "rad/s", "refined_attitude": "rad",
}  # fmt: skip
_LANDING_COLUMNS = 4


def variants(impulses: ImpulseSettings) -> tuple[str, ...]:
    """Name the landings after the search: impulse of the grid or refined, and what follows it."""
    then = impulses.followed_by
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
        """Mean over the sets (n, m)."""
        return np.asarray(self.optimum[name].mean(axis=0))

    def sigma(self, name: str) -> FloatArray:
        """Standard deviation over the sets (n, m), divided by S - 1; 0 for a single set."""
        values = self.optimum[name]
        return np.asarray(values.std(axis=0, ddof=1)) if len(values) > 1 else np.zeros(values.shape[1:])


@dataclass(frozen=True, eq=False)
class ImpulseWork:
    """Rows (P, 3) of drone number, slope [rad] and speed [m/s] to the best impulse and how it lands.

    Columns: those of `Optimum`, then outcome, distance, time and uncertain of each variant.
    """

    drones: tuple[Drone, ...]
    settings: MapSettings
    impulses: ImpulseSettings
    threads: int | None = None
    _known: dict[tuple[int, float], Impulses] = field(default_factory=dict, init=False, repr=False)

    def __call__(self, rows: FloatArray) -> Columns:
        parts = []
        for drone in np.unique(rows[:, 0]).astype(int).tolist():
            chosen = np.flatnonzero(rows[:, 0] == drone)
            parts.append((chosen, self._cells(drone, rows[chosen, 1:])))
        order = np.argsort(np.concatenate([chosen for chosen, _ in parts]), kind="stable")
        columns = [np.concatenate(column) for column in zip(*(column for _, column in parts), strict=True)]
        return tuple(column[order] for column in columns)

    def _cells(self, drone: int, cells: FloatArray) -> Columns:
        scenarios = [Scenario(float(slope), float(speed)) for slope, speed in cells]
        search = self._impulses(drone, self.impulses.after)
        best = search.optimize(scenarios, self.settings.tolerance, self.threads)
        out = [getattr(best, name) for name in OPTIMUM]
        alone = self._impulses(drone, 0.0)
        for source, delay, duration in (
            (search, best.delay, best.duration),
            (search, best.refined_delay, best.refined_duration),
            (alone, best.delay, best.duration),
        ):
            thrust = [source.thrust(*pair) for pair in zip(delay.tolist(), duration.tolist(), strict=True)]
            landings = [
                run(
                    self.drones[drone], scenarios, thrust, np.zeros(len(cells)), self.settings.rules,
                    self.settings.tolerance / halved, self.threads,
                )
                for halved in ((1, 2) if self.settings.check else (1,))
            ]  # fmt: skip
            over = np.isfinite(landings[0].time)
            out += [landings[0].outcome, np.where(over, landings[0].distance, np.nan), landings[0].time]
            out.append(landings[-1].outcome != landings[0].outcome)
        return tuple(out)

    def _impulses(self, drone: int, after: float) -> Impulses:
        key = (drone, after)
        if key not in self._known:
            # A drone's thousands of thrust histories are hundreds of megabytes: keep those of one.
            for other in [known for known in self._known if known[0] != drone]:
                del self._known[other]
            settings = replace(self.impulses, after=after)
            self._known[key] = Impulses(self.drones[drone], settings, self.settings.rules)
        return self._known[key]


def impulse_identity(
    fleets: Sequence[Sequence[Drone]], settings: MapSettings, impulses: ImpulseSettings
) -> dict[str, Any]:
    """Return what must be equal for an unfinished map to be continued."""
    return map_identity(fleets, (), settings) | {"impulse_search": impulses.document()}


def impulse_maps(
    fleets: Sequence[Sequence[Drone]],
    settings: MapSettings | None = None,
    impulses: ImpulseSettings | None = None,
    how: Computing | None = None,
) -> tuple[tuple[ImpulseMap, ...], tuple[LandingMap, ...]]:
    """Search the best impulse of every cell and set, and land with it.

    Parameters
    ----------
    fleets : sequence of sequences of Drone
        The sets of each surface.
    settings, impulses : optional
        The paper's grids of cells and of pairs without.
    how : Computing, optional
        As in `sysid.landing.maps.landing_maps`.

    Returns
    -------
    impulse maps, landing maps : tuples
        One and three per surface: impulse and then `impulses.after`, the same refined, the impulse alone (all
        motors off after it, at the delay and duration found with `impulses.after` following).
        Empty where the work was stopped.
    """
    settings, impulses = settings or MapSettings(), impulses or ImpulseSettings()
    all_drones = tuple(drone for fleet in fleets for drone in fleet)
    how = how or Computing()
    work = ImpulseWork(all_drones, settings, impulses, how.threads)
    cells = np.array([(cell.slope, cell.speed) for cell in settings.cells()])
    by_slope = cells.reshape(len(settings.slopes_deg), len(settings.speeds), 2)
    blocks = {
        f"set-{d + 1}-slope-{s + 1}": np.column_stack([np.full(len(settings.speeds), float(d)), row])
        for d in range(len(all_drones))
        for s, row in enumerate(by_slope)
    }
    done = how.blocks(work, blocks)
    if len(done) < len(blocks):
        return (), ()
    ideal = ", ideal reversal" if impulses.ideal_reversal else ""
    names_of_maps = variants(impulses)
    axes = (np.array(settings.slopes_deg), np.array(settings.speeds))
    searched, landed = [], []
    first = 0
    for fleet in fleets:
        numbers = range(first + 1, first + len(fleet) + 1)
        first += len(fleet)
        names = tuple(drone.name for drone in fleet)
        columns = [
            np.array([[done[f"set-{d}-slope-{s + 1}"][k] for s in range(len(axes[0]))] for d in numbers])
            for k in range(len(OPTIMUM) + _LANDING_COLUMNS * len(names_of_maps))
        ]
        optimum = dict(zip(OPTIMUM, columns, strict=False))
        searched.append(ImpulseMap(fleet[0].surface, f"impulse{ideal}", names, *axes, optimum))
        for v, variant in enumerate(names_of_maps):
            start = len(OPTIMUM) + _LANDING_COLUMNS * v
            part = columns[start : start + _LANDING_COLUMNS]
            landed.append(
                LandingMap(fleet[0].surface, f"{variant}{ideal}", names, *axes, *part, checked=settings.check)
            )
    return tuple(searched), tuple(landed)
