"""Impulse control over slope and touchdown speed (Figs. 9 to 11): the best impulse, and how it lands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from sysid.gear.propulsion import Propulsion
from sysid.landing.controllers import Controller, Step
from sysid.landing.drone import Drone
from sysid.landing.impulse import Impulses, Optimum
from sysid.landing.maps import CellMap, Fleets, LandingMap, columns_of_fleets, judged, numbers_of
from sysid.landing.settings import ImpulseSettings, MapSettings, Scenario
from sysid.landing.simulate import Landings, run
from sysid.parallel import Columns
from sysid.resume import Computing
from sysid.types import FloatArray

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
