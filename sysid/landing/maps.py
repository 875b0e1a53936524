"""Landing maps (Fig. 8): what becomes of a landing, over slope and touchdown speed, for every set."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any, NotRequired, TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from sysid import __version__
from sysid.landing.controllers import Controller
from sysid.landing.drone import Drone, Motors
from sysid.landing.outcomes import LANDED, OUTCOMES, Outcome
from sysid.landing.settings import MapSettings, Scenario
from sysid.landing.simulate import Landings, land_many
from sysid.parallel import Columns, Work
from sysid.resume import Computing, digest
from sysid.types import BoolArray, FloatArray

Fleets = Sequence[Sequence[Drone]]

# Touchdown speeds at which a map with more than four speeds is summarized [m/s], as far as the map has them.
# A map that has none of these is summarized at four of its speeds.
_USUAL_SPEEDS = (0.3, 0.6, 1.0, 1.5)


@dataclass(frozen=True, eq=False)
class CellMap:
    """A map of S sets by name on a surface under a controller, over slope and touchdown speed."""

    surface: str
    controller: str  # label of the controller
    sets: tuple[str, ...]
    slopes_deg: FloatArray  # (n,)
    speeds: FloatArray  # (m,) [m/s]
    law: str = field(default="", kw_only=True)  # name of the controller, whatever triggers it
    # Numbers (S,) [SI] by parameter that differ between draws; without draws there are none.
    numbers: Mapping[str, FloatArray] = field(default_factory=dict, kw_only=True)

    @property
    def of(self) -> str:
        """What the sets are: draws of what the data leave open, or the runs of a fit."""
        return "draws" if self.numbers else "sets"

    @property
    def enough(self) -> float:
        """Share [1] of the sets that must land where a drone is called to land: 95 % of draws, half of runs.

        Runs of one optimum are no sample of what the data leave open.
        """
        return 0.95 if self.numbers else 0.5

    @property
    def quorum(self) -> str:
        """`enough` in words."""
        return "95 % of the draws" if self.numbers else "half of the sets"

    @property
    def title(self) -> str:
        """Surface and controller in words."""
        return f"{self.surface.upper()}, {self.controller}"


class MapSummary(TypedDict):
    """A map in a few numbers."""

    surface: str
    controller: str
    sets: int
    cells: dict[str, int]  # number of cells by likeliest class
    speeds: list[float]  # touchdown speeds [m/s] of the next two
    quorum: str  # how many of the sets are enough
    steepest_deg: list[float]  # slopes up to which enough of the sets land
    at_edge: list[bool]  # whether that slope is the map's last one, and a lower bound
    mean_time: float  # over the cells on which enough of the sets land [s]
    mean_distance: float  # over the same cells [m]
    uncertain: float | None  # share of all landings [1]; None: untried
    lost: int  # landings that could not be simulated
    real_landings: NotRequired[dict[str, object]]


@dataclass(frozen=True, eq=False)
class LandingMap(CellMap):
    """How landings end in every cell of a `CellMap`; arrays are (S, n, m)."""

    outcome: NDArray[np.int8]  # `Outcome` codes
    distance: FloatArray  # displacement down the slope [m]; NaN: not at rest
    time: FloatArray  # time to rest [s]; NaN: not at rest
    uncertain: BoolArray  # whether half the tolerance changes the class, where that was `checked`
    checked: bool = field(default=True, kw_only=True)

    def share(self, outcome: Outcome) -> FloatArray:
        """Return the share (n, m) [1] that ends so of the sets that were not lost; NaN without any."""
        sound = np.sum(self.outcome != Outcome.LOST, axis=0)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sum(self.outcome == outcome, axis=0) / np.where(sound, sound, np.nan))

    def error(self, share: FloatArray) -> FloatArray:
        """Return the standard error (n, m) [1] that a share has because the draws are so few."""
        sound = np.maximum(np.sum(self.outcome != Outcome.LOST, axis=0), 1)
        return np.asarray(np.sqrt(share * (1 - share) / sound))

    def deciding(self) -> tuple[NDArray[np.str_], FloatArray]:
        """Return which parameter (n, m) decides a doubtful cell, and its rank correlation [1] with landing.

        Doubtful is a cell on which 5 to 95 % of the draws land. The name is empty, and the number NaN, in
        other cells, and where no correlation exceeds what unrelated numbers reach in one of twenty cells.
        """
        landed = np.isin(self.outcome, LANDED).reshape(len(self.sets), -1).astype(float)
        share = landed.mean(axis=0)
        doubtful = np.flatnonzero((share > 0.05) & (share < 0.95))
        names, rho = np.full(share.shape, "", dtype=object), np.full(share.shape, np.nan)
        if self.numbers and len(doubtful):
            known = np.array(list(self.numbers))
            ranks = np.argsort(np.argsort(np.array(list(self.numbers.values())), axis=1), axis=1)
            by = np.corrcoef(ranks, landed[:, doubtful].T)[: len(known), len(known) :]
            best = np.argmax(np.abs(by), axis=0)
            chosen = by[best, np.arange(len(doubtful))]
            # The largest of p unrelated correlations, each normal with the deviation 1/sqrt(S - 1).
            limit = -ndtri(0.05 / 2 / len(known)) / np.sqrt(len(landed) - 1)
            clear = np.abs(chosen) > limit
            names[doubtful[clear]], rho[doubtful[clear]] = known[best[clear]], chosen[clear]
        shape = self.outcome.shape[1:]
        return names.astype(str).reshape(shape), rho.reshape(shape)

    @property
    def landed(self) -> FloatArray:
        """Share (n, m) [1] of the sets that come to rest within the long distance."""
        return np.sum([self.share(outcome) for outcome in LANDED], axis=0)

    @property
    def likeliest(self) -> NDArray[np.int8]:
        """Most frequent class of each cell (n, m), the better one of equals; LOST where every set is lost."""
        shares = np.array([self.share(outcome) for outcome in OUTCOMES])
        lost = np.isnan(shares).all(axis=0)
        first = np.argmax(np.nan_to_num(shares), axis=0)
        return np.where(lost, int(Outcome.LOST), first).astype(np.int8)

    @property
    def mean_distance(self) -> FloatArray:
        """Mean (n, m) over the sets that came to rest [m], NaN where none did."""
        return _mean(np.abs(self.distance))

    @property
    def mean_time(self) -> FloatArray:
        """Mean (n, m) over the sets that came to rest [s], NaN where none did."""
        return _mean(self.time)

    def steepest(self, speed: float) -> float:
        """Return the steepest slope [deg] up to which `enough` of the sets land; NaN without one.

        NaN also where the map has no cell at that touchdown speed [m/s]. The map's steepest slope is a lower
        bound: the map does not show where landings end.
        """
        nearest = nearest_cell(self.speeds, speed)
        if nearest is None:
            return float("nan")
        column = self.landed[:, nearest]
        fails = np.flatnonzero(~(column >= self.enough))
        last = (fails[0] if len(fails) else len(column)) - 1
        return float(self.slopes_deg[last]) if last >= 0 else float("nan")

    def summary(self) -> MapSummary:
        """Return the map in a few numbers, ready for JSON."""
        classes, counts = np.unique(self.likeliest, return_counts=True)
        speeds = self.speeds.tolist()
        if len(speeds) > 4:
            usual = [speed for speed in _USUAL_SPEEDS if (abs(self.speeds - speed) < 1e-9).any()]
            spaced = np.unique(np.linspace(0, len(self.speeds) - 1, 4).round().astype(int))
            speeds = usual or self.speeds[spaced].tolist()
        steepest = [self.steepest(speed) for speed in speeds]
        chosen = (self.landed >= self.enough) & np.isfinite(self.mean_time)
        return {
            "surface": self.surface,
            "controller": self.controller,
            "sets": len(self.sets),
            "quorum": self.quorum,
            "cells": {Outcome(c).name.lower(): n for c, n in zip(classes, counts.tolist(), strict=True)},
            "speeds": speeds,
            "steepest_deg": steepest,
            "at_edge": [slope == float(self.slopes_deg[-1]) for slope in steepest],
            "mean_time": float(self.mean_time[chosen].mean()) if chosen.any() else float("nan"),
            "mean_distance": float(self.mean_distance[chosen].mean()) if chosen.any() else float("nan"),
            "uncertain": float(self.uncertain.mean()) if self.checked else None,
            "lost": int(np.sum(self.outcome == Outcome.LOST)),
        }


def cell_edges(centres: FloatArray) -> FloatArray:
    """Return the edges (n + 1,) of cells around their centres (n,): half-way, also on an uneven grid.

    The outermost cells are as wide outward as inward; a single cell is 1 wide.
    """
    centres = np.asarray(centres, dtype=float)
    if len(centres) < 2:
        return np.array([centres[0] - 0.5, centres[0] + 0.5])
    half = 0.5 * np.diff(centres)
    return np.concatenate([[centres[0] - half[0]], centres[:-1] + half, [centres[-1] + half[-1]]])


def nearest_cell(centres: FloatArray, value: float) -> int | None:
    """Return which cell of centres (n,) is around a value, on an edge the lower one; None outside."""
    edges = cell_edges(centres)
    if len(centres) < 2:
        return 0 if value == centres[0] else None
    slack = 1e-9 * (edges[-1] - edges[0])
    if not edges[0] - slack <= value <= edges[-1] + slack:
        return None
    return int(np.clip(np.searchsorted(edges, value - slack) - 1, 0, len(centres) - 1))


def numbers_of(fleet: Sequence[Drone]) -> dict[str, FloatArray]:
    """Return what differs between the drones of draws (S,) [SI] by parameter; nothing where they are runs."""
    if not fleet[0].drawn:
        return {}
    rows = {name: np.array([drone.gear[name] for drone in fleet]) for name in fleet[0].gear}
    rows |= {name: np.array([drone.motor[name] for drone in fleet]) for name in fleet[0].motor}
    return {name: values for name, values in rows.items() if np.ptp(values) > 0}


def _mean(values: FloatArray) -> FloatArray:
    """Mean over the first axis of what is finite."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.asarray(np.where(count, total / np.maximum(count, 1), np.nan))


def judged(land: Callable[[float], Landings], settings: MapSettings) -> Columns:
    """Return outcome, distance [m], time to rest [s] of landings, and whether half the tolerance changes it.

    `land` simulates them with a tolerance. Without `MapSettings.check` nothing is simulated again.
    """
    landings = land(settings.tolerance)
    again = land(settings.tolerance / 2) if settings.check else landings
    distance = np.where(np.isfinite(landings.time), landings.distance, np.nan)
    return landings.outcome, distance, landings.time, again.outcome != landings.outcome


@dataclass(frozen=True, eq=False)
class LandingWork:
    """Rows (P, 4) of drone, controller (both by number), slope [rad] and speed [m/s] to `judged`.

    All rows have one drone and one controller.
    """

    drones: tuple[Drone, ...]
    controllers: tuple[Controller, ...]
    settings: MapSettings
    threads: int | None = None
    _motors: dict[tuple[int, bool], Motors] = field(default_factory=dict, init=False, repr=False)

    def __call__(self, rows: FloatArray) -> Columns:
        number, law = rows[0, :2].astype(int).tolist()
        drone, controller, settings = self.drones[number], self.controllers[law], self.settings
        ideal = controller.ideal_reversal
        motors = self._motors.setdefault((number, ideal), Motors(drone, ideal))
        more = {"pitch": settings.pitch, "horizontal_speed": settings.horizontal_speed}
        cells = [Scenario(slope, speed, **more) for slope, speed in rows[:, 2:].tolist()]

        def land(tolerance: float) -> Landings:
            return land_many(
                drone, cells, controller,
                rules=settings.rules, tolerance=tolerance, threads=self.threads, motors=motors,
            )  # fmt: skip

        return judged(land, settings)


def columns_of_fleets(
    work: Work, fleets: Fleets, parts: Mapping[str, FloatArray], how: Computing
) -> list[dict[str, list[NDArray[Any]]]]:
    """Compute parts for every set: rows (k, p) of each part, behind the number of the drone.

    Returns the columns (S, k) of each part by fleet; nothing where the work was stopped.
    """
    first = np.cumsum([1, *map(len, fleets)]).tolist()
    blocks = {
        f"set-{d}-{part}": np.insert(rows, 0, d - 1, axis=1)
        for d in range(1, first[-1])
        for part, rows in parts.items()
    }
    done = how.blocks(work, blocks)
    if len(done) < len(blocks):
        return []
    return [
        {
            part: [
                np.array(sets) for sets in zip(*(done[f"set-{d}-{part}"] for d in range(a, b)), strict=True)
            ]
            for part in parts
        }
        for a, b in pairwise(first)
    ]


def map_identity(
    fleets: Fleets, controllers: Sequence[Controller], *settings: MapSettings
) -> dict[str, object]:
    """Return what must be equal for unfinished maps to be continued."""
    return {
        "version_of_sysid": __version__,
        "parameter_set": digest([[dict(d.gear), dict(d.motor), d.surface] for f in fleets for d in f]),
        "controller": [asdict(controller) for controller in controllers],
        "grid_or_rule": [asdict(grid) for grid in settings],
    }


def landing_maps(
    fleets: Fleets,
    controllers: Sequence[Controller],
    settings: MapSettings | None = None,
    how: Computing | None = None,
) -> tuple[LandingMap, ...]:
    """Compute the map of every surface under every controller: fleet by fleet, controller by controller.

    `fleets` are the sets of each surface. The paper's grid is the default. `how` says where the maps are
    computed and what is kept: this process and nothing by default. Where the work was stopped there are none.
    """
    settings, how = settings or MapSettings(), how or Computing()
    cells = np.array([(cell.slope, cell.speed) for cell in settings.cells()])
    work = LandingWork(
        tuple(drone for fleet in fleets for drone in fleet), tuple(controllers), settings, how.threads
    )
    axes = np.array(settings.slopes_deg), np.array(settings.speeds)
    parts = {f"controller-{c + 1}": np.insert(cells, 0, c, axis=1) for c in range(len(controllers))}
    out = []
    for fleet, columns in zip(fleets, columns_of_fleets(work, fleets, parts, how), strict=False):
        names, shape = tuple(drone.name for drone in fleet), (len(fleet), len(axes[0]), -1)
        for controller, part in zip(controllers, parts, strict=True):
            arrays = [column.reshape(shape) for column in columns[part]]
            head = (fleet[0].surface, controller.label, names, *axes)
            more: dict[str, Any] = {"law": controller.name, "numbers": numbers_of(fleet)}
            out.append(LandingMap(*head, *arrays, checked=settings.check, **more))
    return tuple(out)
