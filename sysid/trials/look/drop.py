"""A drop in motion capture: which way is down, release, touchdown, impact speed, slope.

Knows no gear and needs no surface (`sysid.trials.flight`). These numbers describe a log; a fit finds the
release and the touchdown with the campaign's feet and plane (`sysid.trials.fall`).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sysid.recording import Channel, Recording
from sysid.trials.capture import signed_axis
from sysid.trials.flight import (
    HALF_WINDOW,
    FreeFlight,
    contact_time,
    half_window,
    held_fall,
    lands,
    second_derivative,
    thrown,
)
from sysid.types import FloatArray

STANDARD_GRAVITY = 9.80665
# True unit of length by the factor that a wrong one puts on g; lengths in "m" were read as mm.
_SCALES = {1.0: "", 1e3: "mm", 1e2: "cm", 1 / 0.0254: "inch", 1 / 0.3048: "foot", 1e-3: "m"}
# Largest relative error of g that is left if a wrong unit is the cause [1]; beyond, the rate is wrong.
_NEAR_UNIT = 0.1
# Factors on g that a wrong rate or scale may cause, the nearest first, in steps that move the end of a fall
# of 60 ms by less than the half millimetre that shows it; and least length of a fall with such a g [s].
_ODD_GRAVITIES = tuple(1.06 ** (sign * power) for power in range(2, 26) for sign in (1, -1))
_LONG_ODD_FALL = 0.1
# Time before a release over which the rotation of a hanging body is averaged [s].
HANGING = 0.3
# Time from the touch of the feet until a body on soft legs visibly leaves its flight [s].
_YIELDING = 0.010
# Least slope of a board whose markers show a direction, and largest angle between a way and an axis [rad].
_SHALLOW, _OFF_AXIS = np.radians(2.0), np.radians(30.0)


@dataclass(frozen=True)
class DropReport:
    """A drop, on the recording's clock and axes."""

    # Rigid body or marker that falls.
    body: str
    # Capture axis nearest to up, such as ``"+z"``, and the angle between it and the fall [rad].
    up: str
    up_error: float
    # Acceleration of the fall itself [m/s²].
    gravity: float
    # Unit that the lengths seem to have, by its name as an option; empty if it is the one they were read in.
    length_unit: str
    # Release [s], None where the body was thrown or carried into the flight; touchdown [s].
    release: float | None
    touchdown: float
    # Downward speed at touchdown [m/s].
    impact_speed: float
    # Height lost between release (or the top of the flight) and touchdown [m].
    fall_height: float
    # Horizontal displacement from touchdown to the end of the log, capture axes [m].
    slide: tuple[float, float, float]
    # Capture axis nearest to the fall of the board's markers, else to a slide of over 20 mm; doubts of it.
    down_slope: str | None
    down_slope_doubt: str
    # Suggested slope [rad], from board markers or from the tilt between hold and rest, and what to check.
    slope: float | None
    slope_source: str
    slope_by_markers: bool
    # Largest error of the release [s], a sample period; NaN without one.
    release_error: float
    # Largest error of the touchdown [s]: 1.5 periods, and the 10 ms in which legs give way unseen.
    touchdown_error: float
    # Largest error of the impact speed [m/s], by that of the touchdown.
    impact_speed_error: float


def _axis_name(vector: FloatArray) -> str:
    axis = int(np.argmax(np.abs(vector)))
    return ("+" if vector[axis] > 0 else "-") + "xyz"[axis]


def inspect_drop(recording: Recording, gravity: float = STANDARD_GRAVITY) -> DropReport | None:
    """Return the drop in a recording, under a gravity [m/s²]; None where nothing falls."""
    for body in (*recording.rigid_bodies, *recording.markers):
        channel = recording.channels.get(f"{body}/position")
        if channel is None or channel.valid.sum() < 20 or channel.values.ndim != 2:
            continue
        report = _inspect_body(recording, body, channel, gravity)
        if report is None:
            continue
        # A marker on a moving limb may accelerate by one g too, but not as evenly as a falling body.
        even = (
            abs(report.gravity / gravity - 1.0) < 0.05 and report.up_error < 0.05 and not report.length_unit
        )
        falls = even and (report.release is not None or report.fall_height > 0.1)
        if falls or body in recording.rigid_bodies:
            return report
    return None


def _inspect_body(recording: Recording, body: str, channel: Channel, gravity: float) -> DropReport | None:
    seen, positions = channel.time[channel.valid], channel.values[channel.valid]
    step = float(np.median(np.diff(seen)))
    time = seen[0] + step * np.arange(int(np.floor((seen[-1] - seen[0]) / step + 1e-6)) + 1)
    position = np.column_stack([np.interp(time, seen, positions[:, i]) for i in range(3)])
    after = np.clip(np.searchsorted(seen, time), 1, seen.size - 1)
    sure = np.asarray(seen[after] - seen[after - 1] < 4.0 * step)  # between neighbours, not across a gap
    step = float(time[1] - time[0])
    half = half_window(HALF_WINDOW / step)
    if step > 0.02 or time.size < 4 * half + 4:
        return None
    acceleration = second_derivative(position, half, step)
    for scale, unit in _SCALES.items():
        place = position / scale
        flight = held_fall(time, place, acceleration / scale, sure, gravity)
        if flight is None and scale == 1.0:  # a slow motion in a wrong unit looks like a throw
            flight = thrown(time, place, acceleration, sure, gravity)
        if flight is None or not lands(time, place, *flight):
            continue
        measured = float(np.linalg.norm(flight[0].acceleration))
        if not unit or abs(measured / gravity - 1.0) < _NEAR_UNIT:
            return _report(recording, body, channel, time, place, *flight, unit)
    # A wrong rate changes g by its square: the fall is reported with the g that the log shows.
    for share in _ODD_GRAVITIES:
        flight = held_fall(time, position, acceleration, sure, share * gravity)
        if flight is None or time[flight[1]] - flight[0].start < _LONG_ODD_FALL:
            continue
        if lands(time, position, *flight, stops=True):
            return _report(recording, body, channel, time, position, *flight, "")
    return None


def _report(
    recording: Recording,
    body: str,
    channel: Channel,
    time: FloatArray,
    position: FloatArray,
    flight: FreeFlight,
    end: int,
    unit: str,
) -> DropReport:
    measured = float(np.linalg.norm(flight.acceleration))
    up_vector = -flight.acceleration / measured
    up = _axis_name(up_vector)
    axis = signed_axis(up)
    touchdown = contact_time(time, (position - flight.at(time)) @ axis, end)
    speed = -float(flight.velocity(touchdown) @ axis)
    # A thrown body falls from the top of its parabola, or from its place at the start of the log.
    top = max(float(flight.velocity(float(time[0])) @ axis), 0.0) if not flight.held else 0.0
    fall = speed**2 / (2.0 * measured)
    if not flight.held and top == 0.0:
        fall = float((flight.at(time[:1])[0] - flight.at(np.array([touchdown]))[0]) @ axis)
    way = position[-1] - position[end]
    way = way - axis * (way @ axis)
    release = flight.start if flight.held else None
    slope, source, marked, downhill = _slope(recording, body, channel, axis, release, touchdown)
    down_slope, doubts = None, []
    if downhill is not None or np.linalg.norm(way) > 0.02:
        direction = way if downhill is None else downhill
        down_slope = _axis_name(direction)
        off = float(np.arccos(np.clip(np.max(np.abs(direction)) / np.linalg.norm(direction), 0.0, 1.0)))
        if downhill is None and not flight.held:
            doubts.append("the body was thrown and moves on as it was thrown, downhill or not")
        if off > _OFF_AXIS:
            doubts.append(f"the way lies {np.degrees(off):.0f} deg off that axis")
    sample = float(time[1] - time[0])
    late = 1.5 * sample + _YIELDING  # the largest error of 16 known drops at 200 Hz was 15.5 ms of these 17.5
    return DropReport(
        body, up, float(np.arccos(np.clip(up_vector @ axis, -1.0, 1.0))), measured, unit, release, touchdown,
        speed, fall, (float(way[0]), float(way[1]), float(way[2])), down_slope, "; ".join(doubts),
        slope, source, marked, sample if flight.held else float("nan"), late, measured * late,
    )  # fmt: skip


def mean_turn(orientation: Channel, begin: float, end: float = np.inf) -> Rotation | None:
    """Return the mean rotation of a body between two times [s]; None with fewer than three samples."""
    part = orientation.valid & (orientation.time > begin) & (orientation.time < end)
    if part.sum() < 3:
        return None
    return Rotation.from_quat(np.roll(orientation.values[part], -1, axis=1)).mean()


def _slope(
    recording: Recording, body: str, channel: Channel, up: FloatArray, release: float | None, touchdown: float
) -> tuple[float | None, str, bool, FloatArray | None]:
    """Return a suggested slope [rad], its source, whether that is markers, and the way down they tell."""
    still = []
    for marker in recording.markers:
        points = recording[f"{marker}/position"]
        on_body = marker.startswith(body) or marker.endswith("(solved)")
        if on_body or points.valid.sum() < 5:
            continue
        seen = points.values[points.valid]
        if np.max(np.std(seen, axis=0)) < 2e-3:
            still.append(np.median(seen, axis=0))
    if len(still) >= 3:
        corners = np.array(still)
        _, spread, axes = np.linalg.svd(corners - corners.mean(axis=0))
        # A slope is measured over a board, not over a corner of it or over a pole.
        flat = spread[2] < 0.05 * spread[1] if spread.size == 3 else False
        if spread[0] > 0.1 and spread[1] > 0.1 * spread[0] and flat:
            normal = axes[2] * np.sign(axes[2] @ up)
            angle = float(np.arccos(np.clip(normal @ up, 0.0, 1.0)))
            off = 1e3 * spread[2] / np.sqrt(len(still))
            sure = f"{off:.2g} mm rms off it" if len(still) > 3 else "three markers always lie in one plane"
            source = (
                f"plane of {len(still)} markers that stand still, {sure}: check that they lie on the board"
            )
            return angle, source, True, normal - up * (normal @ up) if angle > _SHALLOW else None
    unknown = (None, "", False, None)
    orientation = recording.channels.get(f"{body}/orientation")
    if orientation is None or release is None:
        return unknown
    hanging = mean_turn(orientation, release - HANGING, release)
    rest = mean_turn(orientation, max(orientation.time[-1] - 0.15, touchdown + 0.2))
    if hanging is None or rest is None:
        return unknown
    seen = channel.values[channel.valid & (channel.time > channel.time[-1] - 0.15)]
    if np.max(np.ptp(seen, axis=0)) > 5e-3:
        return unknown  # the body still moves
    turned = (rest * hanging.inv()).apply(up)
    angle = float(np.arccos(np.clip(turned @ up, -1.0, 1.0)))
    return angle, "tilt between hold and rest: right only where it hung level and all feet stand", False, None
