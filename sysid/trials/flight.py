"""Hanging, falling, landing: what every reader of a drop shares, without a gear and without a surface.

A flight is where positions accelerate at one g in one direction. The release is where its parabola begins, if
the body hung still; the touchdown is where positions leave the parabola. Valid for flights of 50 ms or more
sampled at 50 Hz or more.
"""

from dataclasses import dataclass

import numpy as np
from scipy import optimize, signal

from sysid.filters import runs
from sysid.types import BoolArray, FloatArray

# Half of the window over which positions become accelerations [s].
HALF_WINDOW = 0.0225
# Share of g that counts as falling when judged on 45 ms of positions.
_FALLING = 0.6
# Time before a fall in which a body must hang still [s], and its largest movement in that time [m]: a hand
# moves by more, a magnet does not.
_SEEN_HANGING, _HANDS_MOVE = 0.3, 0.004
# Least length of a fall that determines g to some percent [s].
_LONG_FALL = 0.06
# Tolerance on |a|/g [1], and shortest flight of a body in motion and of a body that hung still [s].
_NEAR, _SHORTEST, _SHORTEST_FALL = 0.25, 0.05, 0.03
# Ratio of the speed after an apparent landing to the speed at the landing [1], and time in which a body
# reaches that ratio [s] only if the body still falls.
_FASTER, _SOON = 1.5, 0.1
# Least distance of positions that have left the flight from it [m], if four standard deviations are less.
_OFF = 5e-4


def half_window(samples: float) -> int:
    """Return the half window over which positions become accelerations, at least two samples."""
    return max(2, round(samples))


def second_derivative(position: FloatArray, half: int, step: float) -> FloatArray:
    """Return the second derivative of (n,) or (n, k) positions on a uniform clock [m/s²]."""
    return np.asarray(signal.savgol_filter(position, 2 * half + 1, 2, deriv=2, delta=step, axis=0))


def fall_onset(downward: FloatArray, gravity: float, sure: BoolArray | None = None) -> int | None:
    """Return the first of three samples running whose downward acceleration (n,) [m/s²] is a fall's."""
    falling = downward > _FALLING * gravity
    if sure is not None:
        falling &= sure
    sustained = np.flatnonzero(np.convolve(falling, np.ones(3), "valid") == 3)
    return int(sustained[0]) if sustained.size else None


def hold_before(onset: int, half: int, rate: float, position: FloatArray) -> slice | None:
    """Return the samples before a fall at which (n,) or (n, k) positions [m] hung still, or None."""
    last = max(0, onset - half)
    first = max(0, last - round(_SEEN_HANGING * rate))
    hung = last - first >= 5 and np.max(np.ptp(position[first:last], axis=0)) <= _HANDS_MOVE
    return slice(first, last) if hung else None


def release_time(
    since: FloatArray, height: FloatArray, gravity: float, bounds: tuple[float, float], tolerance: float
) -> float:
    """Return when a body that hung still was released [s], from heights (n,) of hold and fall [m].

    Times count from any instant near the release, because the solver steps in shares of the number itself,
    which may be Unix seconds. The release is searched within `bounds` to a tolerance [s].
    """

    def misfit(start: float) -> float:
        level = height + 0.5 * gravity * np.maximum(0.0, since - start) ** 2
        return float(np.sum((level - np.mean(level)) ** 2))

    least = optimize.minimize_scalar(misfit, bounds=bounds, method="bounded", options={"xatol": tolerance})
    return float(least.x)


def _leaves(error: FloatArray, first: int, limit: float) -> int:
    """Return the first of two samples running, from `first` on, whose error (n,) is beyond a limit."""
    off = error[first:] > limit
    both = np.flatnonzero(off[:-1] & off[1:])
    return first + int(both[0]) if both.size else error.size - 1


@dataclass(frozen=True, eq=False)
class FreeFlight:
    """Positions p(t) = origin + rate·τ + acceleration·τ²/2 with τ = t - start, 0 before a release."""

    start: float
    held: bool
    origin: FloatArray
    rate: FloatArray
    acceleration: FloatArray

    def at(self, time: FloatArray) -> FloatArray:
        """Return positions (n, 3) at `time` (n,) [s]."""
        since = np.atleast_1d(time) - self.start
        if self.held:
            since = np.maximum(since, 0.0)
        return np.asarray(
            self.origin + since[:, None] * self.rate + 0.5 * since[:, None] ** 2 * self.acceleration
        )

    def velocity(self, time: float) -> FloatArray:
        """Return the velocity (3,) at `time` [s]."""
        return np.asarray(self.rate + (time - self.start) * self.acceleration)


def _parabola(elapsed: FloatArray, position: FloatArray) -> FloatArray:
    """Return place and acceleration (2, ...) of hold and fall, `elapsed` (n,) since the release [s]."""
    shape = 0.5 * np.maximum(0.0, elapsed) ** 2
    design = np.column_stack([np.ones_like(shape), shape])
    return np.asarray(np.linalg.lstsq(design, position, rcond=None)[0], dtype=np.float64)


def held_fall(
    time: FloatArray, position: FloatArray, acceleration: FloatArray, sure: BoolArray, gravity: float
) -> tuple[FreeFlight, int] | None:
    """Return the first fall of a body that hung still, and the sample that ends it; None without one.

    Positions (n, 3) [m] and accelerations (n, 3) [m/s²] on a uniform clock (n,) [s]; `sure` (n,) ones count.
    """
    step = float(time[1] - time[0])
    half = half_window(HALF_WINDOW / step)
    # The impact accelerates along an axis too, but later: the axis of the first onset is the way down.
    onsets = [fall_onset(np.abs(acceleration[:, axis]), gravity, sure) for axis in range(3)]
    for onset, axis in sorted((onset, axis) for axis, onset in enumerate(onsets) if onset is not None):
        hold = hold_before(onset, half, 1.0 / step, position)
        if hold is None:
            continue
        height = -np.sign(acceleration[onset, axis]) * position[:, axis]
        end, release = min(time.size - 1, onset + half), float(time[onset])
        for _ in range(40):  # the fit shows how far the fall reaches, which lets in more of it
            near = slice(hold.start, end)
            bounds = (-(half + 4) * step, float(time[end - 1] - time[onset]))
            release = time[onset] + release_time(
                time[near] - time[onset], height[near], gravity, bounds, 1e-6
            )
            fall = height + 0.5 * gravity * np.maximum(0.0, time - release) ** 2
            error = np.abs(fall - fall[hold].mean())
            away = _leaves(error, hold.stop, max(4.0 * float(np.std(fall[hold])), _OFF))
            if away == end:
                break
            end = min(away, end + max(2, (end - hold.stop) // 4))
        if time[end] - release > _LONG_FALL:  # long enough to determine g, which a wrong rate changes
            end, release = _longer(time, height, hold, end, release)
        # The positions determine the acceleration, in size and direction.
        place, fall = _parabola(time[hold.start : end] - release, position[hold.start : end])
        flight = FreeFlight(release, True, place, np.zeros(3), fall)
        size = float(np.linalg.norm(flight.acceleration))
        if abs(size / gravity - 1.0) < _NEAR and time[end] - release > _SHORTEST_FALL:
            return flight, end
    return None


def _longer(time: FloatArray, height: FloatArray, hold: slice, end: int, release: float) -> tuple[int, float]:
    """Return the end of a fall and its release when g is fitted too, however much that is."""
    step = float(time[1] - time[0])
    limit = max(4.0 * float(np.std(height[hold])), _OFF)
    for _ in range(40):
        since, known = time[hold.start : end] - release, height[hold.start : end]

        def misfit(start: float, since: FloatArray = since, known: FloatArray = known) -> float:
            place, fall = _parabola(since - start, known)
            return float(np.sum((known - place - 0.5 * fall * np.maximum(0.0, since - start) ** 2) ** 2))

        least = optimize.minimize_scalar(
            misfit, bounds=(-4.0 * step, 4.0 * step), method="bounded", options={"xatol": 1e-6}
        )
        place, fall = _parabola(since - float(least.x), known)
        release += float(least.x)
        error = height - place - 0.5 * fall * np.maximum(0.0, time - release) ** 2
        away = _leaves(np.abs(error), hold.stop, limit)
        if away <= end:
            break
        end = min(away, end + max(2, (end - hold.stop) // 4))
    return end, release


def _longest(mask: BoolArray) -> tuple[int, int]:
    """Return start and stop of the longest run of True; the first of equals."""
    return max(runs(mask), key=lambda run: run[1] - run[0], default=(0, 0))


def thrown(
    time: FloatArray, position: FloatArray, acceleration: FloatArray, sure: BoolArray, gravity: float
) -> tuple[FreeFlight, int] | None:
    """Return the longest free flight of a body in motion, and the sample that ends it; None without one.

    Arguments as for `held_fall`.
    """
    step = float(time[1] - time[0])
    half = half_window(HALF_WINDOW / step)
    near = sure & (np.abs(np.linalg.norm(acceleration, axis=1) - gravity) < _NEAR * gravity)
    first, last = _longest(near)
    if last - first < 4:
        return None
    # One direction throughout: a swung body accelerates as much, but not one way.
    direction = acceleration[first:last].mean(axis=0)
    along = acceleration @ direction / np.linalg.norm(direction)
    first, last = _longest(near & (along > (1 - _NEAR) * gravity))
    if last - first < 4 or (last - first) * step < _SHORTEST:
        return None
    middle = (first + last) // 2
    inner = slice(min(first + half, middle - 2), max(last - half, middle + 3))
    since = time[inner] - time[middle]
    curve = np.polyfit(since, position[inner], 2)
    flight = FreeFlight(float(time[middle]), False, curve[2], curve[1], 2.0 * curve[0])
    if abs(float(np.linalg.norm(flight.acceleration)) / gravity - 1.0) > _NEAR:
        return None
    error = np.linalg.norm(position - flight.at(time), axis=1)
    return flight, _leaves(error, middle, max(4.0 * float(np.sqrt(np.mean(error[inner] ** 2))), _OFF))


def lands(time: FloatArray, position: FloatArray, flight: FreeFlight, end: int, stops: bool = False) -> bool:
    """Return whether a body at (n, 3) [m] stops falling (or halves its speed) where its flight ends."""
    step = float(time[1] - time[0])
    size = float(np.linalg.norm(flight.acceleration))
    depth = position @ (flight.acceleration / size)
    impact = float(flight.velocity(float(time[end])) @ flight.acceleration) / size
    window = half_window(HALF_WINDOW / step)
    after = depth[end : min(time.size, end + max(2 * window, round(_SOON / step)) + 1)]
    if after.size <= window:
        return not stops  # the log ends there
    speeds = (after[window:] - after[:-window]) / (window * step)
    return bool(speeds.min() < 0.5 * impact) if stops else bool(speeds.max() < _FASTER * max(impact, 0.1))


def contact_time(time: FloatArray, error: FloatArray, end: int) -> float:
    """Return when a surface began to push [s], from the error (n,) [m] of a ballistic path.

    Legs give way softly, so a body on legs leaves the flight like (t - t0) cubed; a stiff body leaves it like
    t - t0. The law that fits the next samples better is followed back to zero.
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
