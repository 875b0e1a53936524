"""A drop in motion capture: which way is down, release, touchdown, impact speed, slope.

Knows no gear and needs no surface: free flight is where positions accelerate at one g in one direction, the
release is where its parabola begins (if the body hung still), the touchdown is where positions leave the
parabola. Valid for flights of 50 ms or more sampled at 50 Hz or more. These numbers describe a log; the fit
finds its own with the campaign's feet and plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, signal
from scipy.spatial.transform import Rotation

from sysid.recording import Channel, FloatArray, Recording

STANDARD_GRAVITY = 9.80665
# Half of the window over which positions become accelerations [s].
_HALF_WINDOW = 0.0225
# Share of g that counts as falling when judged on 45 ms of positions.
_FALLING = 0.6
# From this on a fall tells g to some percent [s].
_LONG_FALL = 0.06
# Tolerance on |a|/g, and the shortest flight [s] of a body in motion and of one that hung still.
_NEAR, _SHORTEST, _SHORTEST_FALL = 0.25, 0.05, 0.03
# Units that a length may have been read in: its factor on g, and what it means.
_SCALES = {
    1.0: "",
    1e3: "mm",
    1e2: "cm",
    1 / 0.0254: "inches",
    1 / 0.3048: "feet",
    1e-3: "metres, read as mm",
}
# A unit is told apart from a wrong rate only by how well g fits; two readings of one long fall lie so near.
_NEAR_UNIT = 0.1
# What a wrong rate or scale may make of g, the nearest first, in steps that leave a fall of 60 ms within the
# half millimetre by which its end is told; and how long such a fall must be [s].
_ODD_GRAVITIES = tuple(1.06 ** (sign * power) for power in range(2, 26) for sign in (1, -1))
_LONG_ODD_FALL = 0.1
# Behind a touchdown no body gets so much faster within that time [s]: else the fall goes on.
_FASTER, _SOON = 1.5, 0.1
_STILL = 0.004
# Legs yield softly: a body leaves its flight visibly so long after the feet touch [s].
_YIELDING = 0.010
# A shallower board has no direction that its markers could tell; a way further off an axis lies between two.
_SHALLOW, _OFF_AXIS = np.radians(2.0), np.radians(30.0)


@dataclass(frozen=True)
class DropReport:
    """A drop, on the recording's clock and axes.

    Parameters
    ----------
    body : str
        Rigid body or marker that falls.
    up : str
        Capture axis nearest to up, such as ``"+z"``.
    up_error : float
        Angle between that axis and the fall [rad].
    gravity : float
        What the fall itself says [m/s²].
    length_unit : str
        Empty; else the unit that the lengths seem to be in although they were read in another.
    release : float or None
        [s]; None where the body was thrown or carried into the flight.
    touchdown : float
        [s]
    impact_speed : float
        Downward speed at touchdown [m/s].
    fall_height : float
        From release (or the top of the flight) to touchdown [m].
    slide : (3,) tuple
        Horizontal way from touchdown to the end of the log, capture axes [m].
    down_slope : str or None
        Capture axis nearest to where the board's markers fall, else to that way, where it is over 20 mm long.
    down_slope_doubt : str
        Why that axis may be wrong; empty where nothing speaks against it.
    slope : float or None
        Suggested slope [rad], from board markers or from the tilt between hold and rest.
    slope_source : str
        Where it comes from, and what to check.
    release_error, touchdown_error : float
        How far off the two times may be [s]: a sample period; one and a half, and the 10 ms in which legs
        give way before the body shows it. NaN without a release.
    impact_speed_error : float
        What that time makes of the speed [m/s].
    """

    body: str
    up: str
    up_error: float
    gravity: float
    length_unit: str
    release: float | None
    touchdown: float
    impact_speed: float
    fall_height: float
    slide: tuple[float, float, float]
    down_slope: str | None
    down_slope_doubt: str
    slope: float | None
    slope_source: str
    release_error: float
    touchdown_error: float
    impact_speed_error: float


def _axis_name(vector: FloatArray) -> str:
    axis = int(np.argmax(np.abs(vector)))
    return ("+" if vector[axis] > 0 else "-") + "xyz"[axis]


def _uniform(channel: Channel) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return a uniform clock, positions bridged over gaps, and which samples lie between seen neighbours."""
    valid = channel.valid
    seen, positions = channel.time[valid], channel.values[valid]
    step = float(np.median(np.diff(seen)))
    time = seen[0] + step * np.arange(int(np.floor((seen[-1] - seen[0]) / step + 1e-6)) + 1)
    bridged = np.column_stack([np.interp(time, seen, positions[:, i]) for i in range(3)])
    after = np.clip(np.searchsorted(seen, time), 1, seen.size - 1)
    return time, bridged, np.asarray(seen[after] - seen[after - 1] < 4.0 * step)


def _longest_run(mask: NDArray[np.bool_]) -> tuple[int, int]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    if not edges.size:
        return 0, 0
    lengths = edges[1::2] - edges[::2]
    longest = int(np.argmax(lengths))
    return int(edges[2 * longest]), int(edges[2 * longest + 1])


@dataclass(frozen=True, eq=False)
class _Flight:
    """Positions p(t) = origin + rate·τ + acceleration·τ²/2 with τ = t - start, 0 before a release."""

    start: float
    held: bool
    origin: FloatArray
    rate: FloatArray
    acceleration: FloatArray

    def at(self, time: FloatArray) -> FloatArray:
        since = np.atleast_1d(time) - self.start
        if self.held:
            since = np.maximum(since, 0.0)
        return np.asarray(
            self.origin + since[:, None] * self.rate + 0.5 * since[:, None] ** 2 * self.acceleration
        )

    def velocity(self, time: float) -> FloatArray:
        return np.asarray(self.rate + (time - self.start) * self.acceleration)


def _release_time(time: FloatArray, height: FloatArray, guess: float, early: float, gravity: float) -> float:
    """Return when a body that hung still was let go, from the heights of hold and fall [s]."""
    since = time - guess

    def misfit(start: float) -> float:
        return float(np.var(height + 0.5 * gravity * np.maximum(0.0, since - start) ** 2))

    bounds = (-early, float(since[-1]))
    found = optimize.minimize_scalar(misfit, bounds=bounds, method="bounded", options={"xatol": 1e-6})
    return guess + float(found.x)


def _free_fall(time: FloatArray, position: FloatArray, release: float) -> _Flight:
    """Return the flight whose acceleration the positions tell themselves, in size and direction."""
    shape = 0.5 * np.maximum(0.0, time - release) ** 2
    design = np.column_stack([np.ones_like(shape), shape])
    solution = np.asarray(np.linalg.lstsq(design, position, rcond=None)[0], dtype=np.float64)
    return _Flight(release, True, solution[0], np.zeros(3), solution[1])


def _held_fall(
    time: FloatArray, position: FloatArray, acceleration: FloatArray, sure: NDArray[np.bool_], gravity: float
) -> tuple[_Flight, int] | None:
    """Return the first fall of a body that hung still, and the sample at which it ends; None without one."""
    step = float(time[1] - time[0])
    half, reach = max(2, round(_HALF_WINDOW / step)), round(0.3 / step)
    # The impact accelerates the other way, but later: whichever axis comes first is the way down.
    falling = np.abs(acceleration) > _FALLING * gravity
    onsets = [np.flatnonzero(np.convolve(falling[:, i] & sure, np.ones(3), "valid") == 3) for i in range(3)]
    for onset, axis in sorted((int(one[0]), i) for i, one in enumerate(onsets) if one.size):
        begin, held_end = max(0, onset - half - reach), onset - half
        if held_end - begin < 5 or np.max(np.ptp(position[begin:held_end], axis=0)) > _STILL:
            continue
        height = -np.sign(acceleration[onset, axis]) * position[:, axis]
        end, release = min(time.size - 1, onset + half), float(time[onset])
        for _ in range(40):  # the fit tells how far the fall reaches, which lets in more of it
            early = (half + 4) * step
            release = _release_time(time[begin:end], height[begin:end], float(time[onset]), early, gravity)
            fall = height + 0.5 * gravity * np.maximum(0.0, time - release) ** 2
            error = np.abs(fall - fall[begin:held_end].mean())
            off = error[held_end:] > max(4.0 * float(np.std(fall[begin:held_end])), 5e-4)
            both = np.flatnonzero(off[:-1] & off[1:])
            away = held_end + int(both[0]) if both.size else time.size - 1
            if away == end:
                break
            end = min(away, end + max(2, (end - held_end) // 4))
        if time[end] - release > _LONG_FALL:  # long enough to tell g itself, which a wrong rate changes
            end, release = _longer(time, height, begin, held_end, end, release)
        flight = _free_fall(time[begin:end], position[begin:end], release)
        size = float(np.linalg.norm(flight.acceleration))
        if abs(size / gravity - 1.0) < _NEAR and time[end] - release > _SHORTEST_FALL:
            return flight, end
    return None


def _longer(
    time: FloatArray, height: FloatArray, begin: int, held_end: int, end: int, release: float
) -> tuple[int, float]:
    """Return the end of a fall and its release when g is fitted too, however much that is."""
    step = float(time[1] - time[0])
    limit = max(4.0 * float(np.std(height[begin:held_end])), 5e-4)
    for _ in range(40):
        since, known = time[begin:end] - release, height[begin:end]

        def parabola(start: float, since: FloatArray = since, known: FloatArray = known) -> FloatArray:
            shape = 0.5 * np.maximum(0.0, since - start) ** 2
            design = np.column_stack([np.ones_like(shape), shape])
            return np.asarray(np.linalg.lstsq(design, known, rcond=None)[0])

        def misfit(start: float, since: FloatArray = since, known: FloatArray = known) -> float:
            place, fall = parabola(start)
            return float(np.sum((known - place - 0.5 * fall * np.maximum(0.0, since - start) ** 2) ** 2))

        found = optimize.minimize_scalar(
            misfit, bounds=(-4.0 * step, 4.0 * step), method="bounded", options={"xatol": 1e-6}
        )
        place, fall = parabola(float(found.x))
        release += float(found.x)
        error = height - place - 0.5 * fall * np.maximum(0.0, time - release) ** 2
        off = np.abs(error[held_end:]) > limit
        both = np.flatnonzero(off[:-1] & off[1:])
        away = held_end + int(both[0]) if both.size else time.size - 1
        if away <= end:
            break
        end = min(away, end + max(2, (end - held_end) // 4))
    return end, release


def _leaves(time: FloatArray, position: FloatArray, flight: _Flight, inner: slice, first: int) -> int:
    """Return the first of two samples running that lie off the flight."""
    error = np.linalg.norm(position - flight.at(time), axis=1)
    off = error[first:] > max(4.0 * float(np.sqrt(np.mean(error[inner] ** 2))), 5e-4)
    both = np.flatnonzero(off[:-1] & off[1:])
    return first + int(both[0]) if both.size else time.size - 1


def _contact(time: FloatArray, error: FloatArray, end: int) -> float:
    """Return when a surface began to push [s].

    Legs give way softly, so the flight is left like (t - t0) cubed, a
    stiff body's like t - t0: whichever fits the next samples better is followed back to zero.
    """
    step = float(time[1] - time[0])
    beyond = np.flatnonzero(error[end:] > 0.015)
    stop = min(end + (int(beyond[0]) if beyond.size else 8), end + 8, time.size)
    latest = float(time[end]) - 0.5 * step
    if stop - end < 3:
        return latest
    best = (np.inf, latest)
    for power in (1, 3):
        root = np.maximum(error[end:stop], 0.0) ** (1.0 / power)
        slope, offset = np.polyfit(time[end:stop] - time[end], root, 1)
        if slope <= 0:
            continue
        misfit = np.maximum(slope * (time[end:stop] - time[end]) + offset, 0.0) ** power - error[end:stop]
        best = min(best, (float(np.sum(misfit**2)), float(time[end]) - float(offset / slope)))
    return float(np.clip(best[1], latest - 0.02, latest + step))


def _thrown(
    time: FloatArray, position: FloatArray, acceleration: FloatArray, sure: NDArray[np.bool_], gravity: float
) -> tuple[_Flight, int] | None:
    """Return the longest free flight of a body in motion, and the sample that ends it; None without one."""
    step = float(time[1] - time[0])
    half = max(2, round(_HALF_WINDOW / step))
    near = sure & (np.abs(np.linalg.norm(acceleration, axis=1) - gravity) < _NEAR * gravity)
    first, last = _longest_run(near)
    if last - first < 4:
        return None
    # One direction throughout: a swung body accelerates as much, but not one way.
    direction = acceleration[first:last].mean(axis=0)
    along = acceleration @ direction / np.linalg.norm(direction)
    first, last = _longest_run(near & (along > (1 - _NEAR) * gravity))
    if last - first < 4 or (last - first) * step < _SHORTEST:
        return None
    middle = (first + last) // 2
    inner = slice(min(first + half, middle - 2), max(last - half, middle + 3))
    since = time[inner] - time[middle]
    curve = np.polyfit(since, position[inner], 2)
    flight = _Flight(float(time[middle]), False, curve[2], curve[1], 2.0 * curve[0])
    if abs(float(np.linalg.norm(flight.acceleration)) / gravity - 1.0) > _NEAR:
        return None
    return flight, _leaves(time, position, flight, inner, middle)


def inspect_drop(recording: Recording, gravity: float = STANDARD_GRAVITY) -> DropReport | None:
    """Return the drop in a recording, None where nothing falls.

    Parameters
    ----------
    recording : Recording
        With rigid bodies or markers.
    gravity : float
        [m/s²]
    """
    for body in (*recording.rigid_bodies, *recording.markers):
        name = f"{body}/position"
        if name not in recording.channels:
            continue
        channel = recording[name]
        if channel.valid.sum() < 20 or channel.values.ndim != 2:
            continue
        report = _inspect_body(recording, body, channel, gravity)
        if report is not None and (body in recording.rigid_bodies or _falls_freely(report, gravity)):
            return report
    return None


def _falls_freely(report: DropReport, gravity: float) -> bool:
    """Return whether a lone marker falls: those on a person's limbs accelerate as much, but not as evenly."""
    even = abs(report.gravity / gravity - 1.0) < 0.05 and report.up_error < 0.05 and not report.length_unit
    return even and (report.release is not None or report.fall_height > 0.1)


def _inspect_body(recording: Recording, body: str, channel: Channel, gravity: float) -> DropReport | None:
    time, position, sure = _uniform(channel)
    step = float(time[1] - time[0])
    half = max(2, round(_HALF_WINDOW / step))
    if step > 0.02 or time.size < 4 * half + 4:
        return None
    acceleration = signal.savgol_filter(position, 2 * half + 1, 2, deriv=2, delta=step, axis=0)
    for scale, unit in _SCALES.items():
        place = position / scale
        found = _held_fall(time, place, acceleration / scale, sure, gravity)
        if found is None and scale == 1.0:  # a slow motion in a wrong unit looks like a throw
            found = _thrown(time, place, acceleration, sure, gravity)
        if found is None or not _lands(time, place, *found):
            continue
        own = float(np.linalg.norm(found[0].acceleration))
        if not unit or abs(own / gravity - 1.0) < _NEAR_UNIT:
            return _report(recording, body, channel, time, place, *found, unit)
    # A wrong rate changes g by its square: the fall is reported with the g that it has.
    for share in _ODD_GRAVITIES:
        found = _held_fall(time, position, acceleration, sure, share * gravity)
        if found is None or time[found[1]] - found[0].start < _LONG_ODD_FALL:
            continue
        if _lands(time, position, *found, stops=True):
            return _report(recording, body, channel, time, position, *found, "")
    return None


def _lands(time: FloatArray, position: FloatArray, flight: _Flight, end: int, stops: bool = False) -> bool:
    """Return whether a body stops falling (or comes to half its speed) where its flight is said to end."""
    step = float(time[1] - time[0])
    size = float(np.linalg.norm(flight.acceleration))
    depth = position @ (flight.acceleration / size)
    impact = float(flight.velocity(float(time[end])) @ flight.acceleration) / size
    window = max(2, round(_HALF_WINDOW / step))
    after = depth[end : min(time.size, end + max(2 * window, round(_SOON / step)) + 1)]
    if after.size <= window:
        return not stops  # the log ends there
    speeds = (after[window:] - after[:-window]) / (window * step)
    return bool(speeds.min() < 0.5 * impact) if stops else bool(speeds.max() < _FASTER * max(impact, 0.1))


def _report(
    recording: Recording,
    body: str,
    channel: Channel,
    time: FloatArray,
    position: FloatArray,
    flight: _Flight,
    end: int,
    unit: str,
) -> DropReport:
    measured = float(np.linalg.norm(flight.acceleration))
    up_vector = -flight.acceleration / measured
    up = _axis_name(up_vector)
    axis = np.zeros(3)
    axis["xyz".index(up[1])] = 1.0 if up[0] == "+" else -1.0
    touchdown = _contact(time, (position - flight.at(time)) @ axis, end)
    speed = -float(flight.velocity(touchdown) @ axis)
    # Of a throw, from the top of its parabola, or from where the log begins to show it.
    top = max(float(flight.velocity(float(time[0])) @ axis), 0.0) if not flight.held else 0.0
    fall = speed**2 / (2.0 * measured)
    if not flight.held and top == 0.0:
        fall = float((flight.at(time[:1])[0] - flight.at(np.array([touchdown]))[0]) @ axis)
    way = position[-1] - position[end]
    way = way - axis * (way @ axis)
    release = flight.start if flight.held else None
    slope, source, downhill = _slope(recording, body, channel, axis, release, touchdown)
    down_slope, doubt = _down_slope(way, downhill, flight.held)
    sample = float(time[1] - time[0])
    late = 1.5 * sample + _YIELDING  # the largest error of 16 known drops at 200 Hz was 15.5 ms of these 17.5
    return DropReport(
        body, up, float(np.arccos(np.clip(up_vector @ axis, -1.0, 1.0))), measured, unit, release, touchdown,
        speed, fall, (float(way[0]), float(way[1]), float(way[2])), down_slope, doubt, slope, source,
        sample if flight.held else float("nan"), late, measured * late,
    )  # fmt: skip


def _down_slope(way: FloatArray, downhill: FloatArray | None, held: bool) -> tuple[str | None, str]:
    """Return the capture axis that points down the slope, and why it may not."""
    if downhill is None and np.linalg.norm(way) <= 0.02:
        return None, ""
    direction = way if downhill is None else downhill
    off = float(np.arccos(np.clip(np.max(np.abs(direction)) / np.linalg.norm(direction), 0.0, 1.0)))
    doubts = []
    if downhill is None and not held:
        doubts.append("the body was thrown and moves on as it was thrown, downhill or not")
    if off > _OFF_AXIS:
        doubts.append(f"the way lies {np.degrees(off):.0f} deg off that axis")
    return _axis_name(direction), "; ".join(doubts)


def _slope(
    recording: Recording,
    body: str,
    channel: Channel,
    up: FloatArray,
    release: float | None,
    touchdown: float,
) -> tuple[float | None, str, FloatArray | None]:
    """Return a suggested slope [rad], where it comes from, and the way down where markers tell it."""
    still = []
    for marker in recording.markers:
        points = recording[f"{marker}/position"]
        own = marker.startswith(body) or marker.endswith("(solved)")
        if own or points.valid.sum() < 5:
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
            sure = f"{off:.2g} mm rms off it" if len(still) > 3 else "which three always share"
            source = (
                f"plane of {len(still)} markers that stand still, {sure}: check that they lie on the board"
            )
            return angle, source, normal - up * (normal @ up) if angle > _SHALLOW else None
    orientation = recording.channels.get(f"{body}/orientation")
    if orientation is None or release is None:
        return None, "", None
    valid = orientation.valid
    before = valid & (orientation.time < release) & (orientation.time > release - 0.3)
    rest = valid & (orientation.time > orientation.time[-1] - 0.15) & (orientation.time > touchdown + 0.2)
    if before.sum() < 3 or rest.sum() < 3:
        return None, "", None
    seen = channel.values[channel.valid & (channel.time > channel.time[-1] - 0.15)]
    if np.max(np.ptp(seen, axis=0)) > 5e-3:
        return None, "", None  # it still moves
    held, lying = (
        Rotation.from_quat(np.roll(orientation.values[part], -1, axis=1)).mean() for part in (before, rest)
    )
    turned = (lying * held.inv()).apply(up)
    angle = float(np.arccos(np.clip(turned @ up, -1.0, 1.0)))
    return angle, "tilt between hold and rest: right only where it hung level and all feet stand", None
