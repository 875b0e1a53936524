"""What a lab measures around a drop: values that its campaign states with an error, and which a fit moves.

Besides masses, lengths and friction, which are rows of the model's table, these are slope and release of each
drop, the body's centre of mass, the place of the surface and the tilt of the capture's axes. The log is
prepared once, with the values as stated. A candidate with other values is simulated from where they put the
body at the start, and its signals are brought back to where the capture would have seen them.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from sysid.campaign import GearCampaign
from sysid.campaign.gear import Point
from sysid.campaign.swaps import Swap
from sysid.fit.trial import name_order
from sysid.gear.drops import PreparedDrop
from sysid.gear.parameters import CAPTURED, PARAMETERS
from sysid.gear.swaps import OF_LOG
from sysid.parameters import FROM_STATED, Parameter, ParameterTable, SearchSpace
from sysid.stated import Stated, error_of, typical_error
from sysid.trials.capture import CaptureFrame
from sysid.types import BoolArray, FloatArray


def _captured(name: str, symbol: str, unit: str, meaning: str, group: str = FROM_STATED) -> Parameter:
    return Parameter(name, symbol, unit, 0.0, -1.0, 1.0, "linear", meaning, "campaign", group)


SLOPE = _captured("slope", "α", "rad", "Angle of the surface.", "capture")
RELEASE = _captured("release_delay", "δt", "s", "Delay of the release behind its stated instant.")
CENTRE = (
    _captured("centre_of_mass_dx", "δx_c", "m", "Centre of mass in front of its stated place, down-slope."),
    _captured("centre_of_mass_dz", "δz_c", "m", "Centre of mass above its stated place."),
)
SURFACE = (
    _captured("surface_dx", "δx_s", "m", "Surface's point beyond its stated place, down-slope."),
    _captured("surface_dz", "δz_s", "m", "Surface's point above its stated place."),
)
TILT = _captured("capture_tilt", "δτ", "rad", "Lean of the capture's up beyond the stated one, down-slope.")
# Errors of a slope that board markers show, and of the sag of the legs in a rest log.
_BOARD_ERROR, _SAG_ERROR = "0.1 deg", "1 mm"


def with_stated(
    space: SearchSpace, campaign: GearCampaign, drops: Sequence[PreparedDrop] = ()
) -> SearchSpace:
    """Return a space in which what the campaign states with an error moves, with a row for each.

    What is free or fixed by `[parameters]` is not stated twice. Of `drops` come slopes that markers show.
    """
    stated = {name: value for name, value in _of_the_model(campaign, space.table) if name in space.fixed}
    rows = []
    for row, value in _of_the_capture(campaign, {drop.name: drop.slope for drop in drops}):
        rows.append(row)
        stated[row.name] = value
    stated = {name: value for name, value in stated.items() if error_of(value) > 0}
    # A drop with an exact point of its own does not follow the point of the others.
    rows = [row for row in rows if row.name in stated or row.common_name in stated]
    return space.with_stated(stated, rows) if stated else space


def without_mistake(space: SearchSpace, campaign: GearCampaign, swap: Swap) -> SearchSpace:
    """Return the space with the stated values of a campaign in which a mistake was corrected.

    It is the same space if a part of the mistake is exact, moves nothing, or leaves other rows. A drop keeps
    the name of its log, because logs may have been exchanged.
    """
    names = {trial.model_dump_json(include=OF_LOG): trial.name for trial in campaign.trials}
    right = swap.undone(campaign)
    trials = tuple(
        trial.model_copy(update={"name": names[trial.model_dump_json(include=OF_LOG)]})
        for trial in right.trials
    )
    before, after = (
        dict(_of_the_model(one, space.table))
        | {row.name: value for row, value in _of_the_capture(one, {}, campaign)}
        for one in (campaign, right.model_copy(update={"trials": trials}))
    )
    if before.keys() != after.keys():
        return space
    moved = {name: value for name, value in after.items() if value != before[name]}
    # If one of two exchanged values is exact, a fit could move the other one only.
    if not all(error_of(value) > 0 < error_of(before[name]) for name, value in moved.items()):
        return space
    return space.restating({name: value for name, value in moved.items() if name in space.stated})


def places_apart(campaign: GearCampaign, other: GearCampaign) -> dict[str, float]:
    """Return how far a campaign states places and tilt from where another one does, by row [SI]."""
    names = {row.name for row in (*CENTRE, *SURFACE, TILT)}
    rows = _of_the_capture(campaign, {}, other)
    return {row.name: float(value) for row, value in rows if row.common_name in names}


def _of_the_model(campaign: GearCampaign, table: ParameterTable) -> Iterator[tuple[str, Stated]]:
    """Yield names of the model's rows, and what is stated of each [SI]."""
    fixed = campaign.parameters.fixed_values(table)
    for part in (campaign.vehicle, campaign.surface):
        for name in type(part).model_fields:
            if name in table and name not in fixed and getattr(part, name) is not None:
                yield name, getattr(part, name)
    yield from fixed.items()


def _of_the_capture(
    campaign: GearCampaign, slopes: Mapping[str, float], prepared: GearCampaign | None = None
) -> Iterator[tuple[Parameter, Stated]]:
    """Yield the rows of slopes, releases, centre of mass, surface and tilt, and what is stated of each [SI].

    `slopes` are those that markers show where none is stated. Places count from those of the campaign with
    which the drops were `prepared`, by default the same.
    """
    surface, exact = campaign.surface, campaign.fit.exact
    prepared = prepared or campaign
    before = {trial.name: trial.point for trial in prepared.trials}
    tilt = float(campaign.capture.tilt - prepared.capture.tilt)
    fitted = [trial for trial in campaign.trials if trial.use == "fit"]
    fitted.sort(key=lambda trial: name_order(trial.name))
    for trial in fitted:
        slope = trial.slope
        if slope is None and trial.name in slopes and not exact:
            # Markers show it along the capture's axes.
            error = float(np.hypot(typical_error(_BOARD_ERROR, 0.0, "rad"), error_of(campaign.capture.tilt)))
            slope = Stated(slopes[trial.name], error, _BOARD_ERROR)
        if slope is not None:
            row = replace(SLOPE.of_trial(trial.name), nominal=float(slope))
            yield row, _with_error(slope, of=slope)
        if trial.release is not None:
            yield RELEASE.of_trial(trial.name), _with_error(0.0, of=trial.release)
    directions = {trial.down_slope or campaign.capture.down_slope for trial in fitted}
    # Bodies that were turned between the drops show their centre of mass along other axes.
    if len(directions) == 1:
        frame = CaptureFrame(campaign.capture.up, directions.pop())
        centre, from_there = (one.capture.centre_of_mass_offset for one in (campaign, prepared))
        yield from zip(CENTRE, _in_plane(centre, frame, from_there), strict=True)
        yield TILT, _with_error(tilt, of=campaign.capture.tilt)
        if surface.point is not None and any(trial.point is None for trial in fitted):
            yield from zip(SURFACE, _in_plane(surface.point, frame, prepared.surface.point), strict=True)
    if surface.markers is not None and any(trial.point is None for trial in fitted):
        yield SURFACE[1], _with_error(0.0, of=surface.marker_height)
    if surface.rest_log is not None and not exact:
        # The surface is where the feet of the body at rest are, on legs that sag.
        error = float(np.hypot(typical_error(_SAG_ERROR, 0.0, "m"), error_of(campaign.vehicle.foot_dz)))
        yield SURFACE[1], Stated(0.0, error)
    for trial in fitted:
        if trial.point is not None:
            frame = CaptureFrame(campaign.capture.up, trial.down_slope or campaign.capture.down_slope)
            rows = [row.of_trial(trial.name) for row in SURFACE]
            yield from zip(rows, _in_plane(trial.point, frame, before.get(trial.name)), strict=True)


def _in_plane(point: Point, frame: CaptureFrame, origin: Point | None) -> tuple[Stated, Stated]:
    """Return a point in capture axes from another one along x and z of the plane of motion [m]."""
    moved = frame.matrix @ np.subtract(point, point if origin is None else origin)
    along, _, up = (point[int(np.argmax(np.abs(axis)))] for axis in frame.matrix)
    return _with_error(float(moved[0]), of=along), _with_error(float(moved[2]), of=up)


def _with_error(value: float, of: float) -> Stated:
    return Stated(value, error_of(of), of.assumed if isinstance(of, Stated) else "")


@dataclass(frozen=True, eq=False)
class Moved:
    """Where P candidates put the surfaces and the body of D drops."""

    # (P, D) [rad].
    slopes: FloatArray
    # (P, D) from the stated releases, NaN where none has an error [s].
    delays: FloatArray
    # (P, 2) centre of mass from its stated place, in the body's axes x and z [m].
    centre: FloatArray
    # (P, D, 2) surface's point from its stated place, x and z [m].
    surface: FloatArray
    # (P,) lean of the capture's up down-slope beyond the stated one [rad], and gravity [m/s²].
    tilt: FloatArray
    gravity: FloatArray
    # (D,) whether a drop was held before it fell, and whether its pitch counts from the hold.
    held: BoolArray
    levelled: BoolArray

    @classmethod
    def of(cls, table: ParameterTable, rows: FloatArray, drops: Sequence[PreparedDrop]) -> Self | None:
        """Return what rows of a table (P, n) [SI] say; None where the table has no such row."""
        if not any(row.common_name in CAPTURED for row in table.values()):
            return None
        index = table.index

        def column(name: str, default: FloatArray | float) -> FloatArray:
            return rows[:, index[name]] if name in index else np.full(len(rows), default)

        return cls._read(
            column, {drop.name: drop.slope for drop in drops},
            [drop.flight.held for drop in drops], [drop.levelled for drop in drops],
        )  # fmt: skip

    @classmethod
    def in_set(cls, values: Mapping[str, float], drop: str, slope: float, held: bool) -> Self:
        """Return what the values of a set by name [SI] say of one drop on a slope as stated [rad].

        Pitch counts from the hold of a drop that was `held`.
        """

        def column(name: str, default: FloatArray | float) -> FloatArray:
            return np.array([values.get(name, default)]).ravel()

        return cls._read(column, {drop: slope}, [held], [held])

    @classmethod
    def _read(
        cls,
        column: Callable[[str, FloatArray | float], FloatArray],
        slopes: Mapping[str, float],
        held: Sequence[bool],
        levelled: Sequence[bool],
    ) -> Self:
        common = {row.name: column(row.name, 0.0) for row in (*CENTRE, *SURFACE)}
        surface = [[column(f"{row.name}[{drop}]", common[row.name]) for row in SURFACE] for drop in slopes]
        return cls(
            np.stack([column(f"slope[{drop}]", slope) for drop, slope in slopes.items()], axis=1),
            np.stack([column(f"{RELEASE.name}[{drop}]", np.nan) for drop in slopes], axis=1),
            np.stack([common[row.name] for row in CENTRE], axis=1),
            np.moveaxis(np.array(surface), 2, 0),
            column(TILT.name, 0.0),
            column("gravity", PARAMETERS["gravity"].nominal),
            np.array(held, dtype=np.bool_),
            np.array(levelled, dtype=np.bool_),
        )

    def released(self, drops: Sequence[PreparedDrop]) -> FloatArray:
        """Return the captured states (P, D, 6) [SI] at the first samples, the falls as late as here."""
        out = np.repeat(np.array([[drop.initial_state for drop in drops]]), len(self.delays), axis=0)
        for d, drop in enumerate(drops):
            if np.isfinite(self.delays[:, d]).all():
                out[:, d] = drop.flight.at(drop.time[0] - self.delays[:, d], free=True)
        return out

    def before(self, drop: PreparedDrop, d: int) -> FloatArray:
        """Return x, z, pitch [m, rad] at the samples before the window of drop d, (n, 3) or (P, n, 3)."""
        lead, delay = len(drop.before), np.nan_to_num(self.delays[:, d])
        time = drop.time[0] - np.arange(lead, 0, -1) / drop.motion.rate
        if np.isnan(self.delays[:, d]).any():
            # Rows without a tilt keep their bits, whatever their neighbours.
            states = np.repeat(np.pad(drop.before, ((0, 0), (0, 3)))[None], len(delay), axis=0)
            states[:, :, 4] = drop.flight.at(time)[:, 4]
            self._fall(states, drop.flight.held)
            return states[:, :, :3]
        states = drop.flight.at((time - delay[:, None]).ravel()).reshape(len(delay), lead, 6)
        self._fall(states, drop.flight.held)
        return states[:, :, :3]

    def _fall(self, states: FloatArray, held: bool | BoolArray) -> None:
        """Let bodies that fall from rest fall along gravity in captured states (P, ..., 6), `held` (...)."""
        lean = np.where(held, np.tan(self.tilt)[:, None], 0.0)
        states[..., 0] += lean * states[..., 4] ** 2 / (2 * self.gravity[:, None])
        states[..., 3] -= lean * states[..., 4]

    def _turned(self, pitch: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the shift of the centre of mass along x and z at pitches (P, ...) [rad]."""
        x, z = (part.reshape(-1, *[1] * (pitch.ndim - 1)) for part in self.centre.T)
        return _rotated(x, z, pitch)

    def starts(self, states: FloatArray) -> FloatArray:
        """Return states (P, D, 6) [SI] of the body's centre over the surface, from what was captured."""
        out = np.array(states)
        self._fall(out, self.held)
        x, z = self._turned(states[:, :, 2])
        out[:, :, 0] += x - self.surface[:, :, 0]
        out[:, :, 1] += z - self.surface[:, :, 1]
        out[:, :, 3] += states[:, :, 5] * z
        out[:, :, 4] -= states[:, :, 5] * x
        for k in (0, 3):
            out[:, :, k], out[:, :, k + 1] = _rotated(out[:, :, k], out[:, :, k + 1], self.tilt[:, None])
        out[:, :, 2] += np.where(self.levelled, 0.0, self.tilt[:, None])
        return out

    def seen(self, points: FloatArray, drop: int) -> FloatArray:
        """Return points (P, ..., 2) of a drop's simulation as the capture would have seen them [m]."""
        place = self.surface[:, drop].reshape(-1, *[1] * (points.ndim - 2), 2)
        tilt = self.tilt.reshape(-1, *[1] * (points.ndim - 2))
        return np.stack(_rotated(points[..., 0], points[..., 1], -tilt), axis=-1) + place

    def as_captured(self, samples: FloatArray, drop: int) -> None:
        """Change simulated samples (P, n, 6) [SI] of a drop to what the capture would have seen."""
        if not self.levelled[drop]:
            samples[:, :, 2] -= self.tilt[:, None]
        # Rows without a tilt keep their bits.
        tilted = np.flatnonzero(self.tilt)
        for k in (0, 3):
            turned = _rotated(samples[tilted, :, k], samples[tilted, :, k + 1], -self.tilt[tilted, None])
            samples[tilted, :, k], samples[tilted, :, k + 1] = turned
        x, z = self._turned(samples[:, :, 2])
        samples[:, :, 0] -= x - self.surface[:, drop, None, 0]
        samples[:, :, 1] -= z - self.surface[:, drop, None, 1]
        samples[:, :, 3] -= samples[:, :, 5] * z
        samples[:, :, 4] += samples[:, :, 5] * x


def _rotated(x: FloatArray, z: FloatArray, angle: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Return components x, z of a vector that is turned by an angle [rad], as a body by its pitch."""
    cos, sin = np.cos(angle), np.sin(angle)
    return x * cos + z * sin, z * cos - x * sin
