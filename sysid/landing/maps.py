"""Landing maps (Fig. 8): what becomes of a landing, over slope and touchdown speed, for every set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid import __version__
from sysid.errors import CampaignError
from sysid.landing.controllers import Controller
from sysid.landing.drone import Drone
from sysid.landing.outcomes import LANDED, OUTCOMES, Outcome, Rules
from sysid.landing.scenario import Scenario, grid
from sysid.landing.simulate import LANDING_TOLERANCE, Landings, land_many
from sysid.landing.thrust import Motors
from sysid.parallel import Columns
from sysid.resume import Computing, digest
from sysid.types import BoolArray, FloatArray

# The paper's grid.
SLOPES_DEG = tuple(float(slope) for slope in range(46))
SPEEDS = tuple(round(0.05 * step, 2) for step in range(41))


@dataclass(frozen=True)
class MapSettings:
    """Cells of a map and how they are computed.

    Parameters
    ----------
    slopes_deg : tuple of float
        [deg], increasing.
    speeds : tuple of float
        Vertical touchdown speeds [m/s], increasing.
    rules : Rules
        When a landing is over.
    tolerance : float
        Bound of the weighted rms error of the rates per step.
    check : bool
        Repeat every landing with half the tolerance and mark those whose class changes.
    pitch : float
        Of the body at touchdown [rad].
    horizontal_speed : float
        At touchdown [m/s].
    """

    slopes_deg: tuple[float, ...] = SLOPES_DEG
    speeds: tuple[float, ...] = SPEEDS
    rules: Rules = field(default_factory=Rules)
    tolerance: float = LANDING_TOLERANCE
    check: bool = True
    pitch: float = 0.0
    horizontal_speed: float = 0.0

    def __post_init__(self) -> None:
        for name, values in (("slopes", self.slopes_deg), ("speeds", self.speeds)):
            if not values or any(b <= a for a, b in pairwise(values)):
                raise CampaignError(f"landing map: {name} {list(values)}; give increasing numbers")

    def cells(self) -> list[Scenario]:
        """Return the scenario of every cell, slopes outside, speeds inside."""
        more = {"pitch": self.pitch, "horizontal_speed": self.horizontal_speed}
        return grid(np.radians(self.slopes_deg), self.speeds, **more)

    def document(self) -> dict[str, Any]:
        """Return the settings by name, ready for JSON."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class CellMap:
    """What every map is of: S sets by name on a surface under a controller (its label).

    The cells lie over slope (n,) [deg] and touchdown speed (m,) [m/s].
    """

    surface: str
    controller: str
    sets: tuple[str, ...]
    slopes_deg: FloatArray
    speeds: FloatArray

    @property
    def title(self) -> str:
        """Surface and controller in words."""
        return f"{self.surface.upper()}, {self.controller}"


@dataclass(frozen=True, eq=False)
class LandingMap(CellMap):
    """How landings end in every cell of a `CellMap`.

    Parameters
    ----------
    outcome : (S, n, m) int8 array
        `Outcome` codes.
    distance, time : (S, n, m) arrays
        Displacement down the slope [m] and time to rest [s], NaN where it did not come to rest.
    uncertain : (S, n, m) bool array
        Whether half the tolerance changes the class.
    checked : bool
        Whether that was tried; `uncertain` says nothing otherwise.
    """

    outcome: NDArray[np.int8]
    distance: FloatArray
    time: FloatArray
    uncertain: BoolArray
    checked: bool = field(default=True, kw_only=True)

    def share(self, outcome: Outcome) -> FloatArray:
        """Return the share of the sets (n, m) that end so, of those that were not lost; NaN without any."""
        sound = np.sum(self.outcome != Outcome.LOST, axis=0)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sum(self.outcome == outcome, axis=0) / np.where(sound, sound, np.nan))

    @property
    def landed(self) -> FloatArray:
        """Share of the sets (n, m) that come to rest within the long distance."""
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

    def steepest(self, speed: float, share: float = 0.5) -> float:
        """Return the steepest slope [deg] up to which at least `share` of the sets land; NaN without one.

        NaN also where the map has no cell at that touchdown speed [m/s]. The map's steepest slope is a lower
        bound: the map does not show where landings end.
        """
        nearest = nearest_cell(self.speeds, speed)
        if nearest is None:
            return float("nan")
        column = self.landed[:, nearest]
        fails = np.flatnonzero(~(column >= share))
        last = (fails[0] if len(fails) else len(column)) - 1
        return float(self.slopes_deg[last]) if last >= 0 else float("nan")


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
    """Return the cell that holds a value; None outside. On an edge the lower cell does."""
    edges = cell_edges(centres)
    if len(centres) < 2:
        return 0 if value == centres[0] else None
    slack = 1e-9 * (edges[-1] - edges[0])
    if not edges[0] - slack <= value <= edges[-1] + slack:
        return None
    return int(np.clip(np.searchsorted(edges, value - slack) - 1, 0, len(centres) - 1))


def _mean(values: FloatArray) -> FloatArray:
    """Mean over the first axis of what is finite."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    return np.asarray(np.where(count, total / np.maximum(count, 1), np.nan))


@dataclass(frozen=True, eq=False)
class LandingWork:
    """Rows (P, 4) of drone, controller (both by number), slope [rad] and speed [m/s] to what becomes of them.

    Columns: outcome, distance [m], time to rest [s], whether half the tolerance changes the outcome.
    """

    drones: tuple[Drone, ...]
    controllers: tuple[Controller, ...]
    settings: MapSettings
    threads: int | None = None
    _motors: dict[tuple[int, bool], Motors] = field(default_factory=dict, init=False, repr=False)

    def __call__(self, rows: FloatArray) -> Columns:
        outcome = np.empty(len(rows), dtype=np.int8)
        distance, time = np.empty(len(rows)), np.empty(len(rows))
        uncertain = np.zeros(len(rows), dtype=bool)
        for drone, controller in np.unique(rows[:, :2], axis=0).astype(int).tolist():
            chosen = np.flatnonzero((rows[:, 0] == drone) & (rows[:, 1] == controller))
            landings = self._land(drone, controller, rows[chosen, 2:], self.settings.tolerance)
            outcome[chosen], time[chosen] = landings.outcome, landings.time
            distance[chosen] = np.where(np.isfinite(landings.time), landings.distance, np.nan)
            if self.settings.check:
                again = self._land(drone, controller, rows[chosen, 2:], self.settings.tolerance / 2)
                uncertain[chosen] = again.outcome != landings.outcome
        return outcome, distance, time, uncertain

    def _land(self, drone: int, controller: int, cells: FloatArray, tolerance: float) -> Landings:
        law = self.controllers[controller]
        key = (drone, law.ideal_reversal)
        if key not in self._motors:
            self._motors[key] = Motors(self.drones[drone], law.ideal_reversal)
        more = {"pitch": self.settings.pitch, "horizontal_speed": self.settings.horizontal_speed}
        return land_many(
            self.drones[drone],
            [Scenario(float(slope), float(speed), **more) for slope, speed in cells],
            law,
            rules=self.settings.rules,
            tolerance=tolerance,
            threads=self.threads,
            motors=self._motors[key],
        )


def map_identity(
    fleets: Sequence[Sequence[Drone]], controllers: Sequence[Controller], settings: MapSettings
) -> dict[str, Any]:
    """Return what must be equal for an unfinished map to be continued."""
    return {
        "version_of_sysid": __version__,
        "parameter_set": digest([[dict(d.gear), dict(d.motor), d.surface] for f in fleets for d in f]),
        "controller": [controller.document() for controller in controllers],
        "grid_or_rule": settings.document(),
    }


def landing_maps(
    fleets: Sequence[Sequence[Drone]],
    controllers: Sequence[Controller],
    settings: MapSettings | None = None,
    how: Computing | None = None,
) -> tuple[LandingMap, ...]:
    """Compute the map of every surface under every controller.

    Parameters
    ----------
    fleets : sequence of sequences of Drone
        The sets of each surface, for example five on low and five on high friction.
    settings : MapSettings, optional
        The paper's grid without.
    how : Computing, optional
        Where it is computed, and what is kept; this process and nothing by default.

    Returns
    -------
    tuple of LandingMap
        Fleet by fleet, controller by controller; empty where the work was stopped.
    """
    settings = settings or MapSettings()
    all_drones = tuple(drone for fleet in fleets for drone in fleet)
    cells = np.array([(cell.slope, cell.speed) for cell in settings.cells()])
    how = how or Computing()
    work = LandingWork(all_drones, tuple(controllers), settings, how.threads)
    blocks = {
        f"set-{d + 1}-controller-{c + 1}": np.column_stack(
            [np.full(len(cells), float(d)), np.full(len(cells), float(c)), cells]
        )
        for d in range(len(all_drones))
        for c in range(len(controllers))
    }
    done = how.blocks(work, blocks)
    if len(done) < len(blocks):
        return ()
    axes = np.array(settings.slopes_deg), np.array(settings.speeds)
    shape = (len(axes[0]), len(axes[1]))
    out = []
    first = 0
    for fleet in fleets:
        for c, controller in enumerate(controllers):
            parts = [done[f"set-{first + s + 1}-controller-{c + 1}"] for s in range(len(fleet))]
            columns = [np.array([part[k].reshape(shape) for part in parts]) for k in range(4)]
            out.append(
                LandingMap(
                    fleet[0].surface, controller.label, tuple(drone.name for drone in fleet),
                    *axes, *columns, checked=settings.check,
                )
            )  # fmt: skip
        first += len(fleet)
    return tuple(out)
