"""Steady points of a bench log, tare and sign of a channel from them, and starts from rest.

Knows no motor model, only that thrust and drag torque grow with the square of the propeller's speed and have
the sign of the speed by the sign convention of `sysid.trials.bench_log`.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.ndimage import median_filter

from sysid.errors import LogError
from sysid.trials.bench_log import AT_REST, LEVEL_SPAN, STANDS, CommandSteps, Tare, outside
from sysid.types import BoolArray, FloatArray, IntArray

# Time from a command to the first sample of its steady point [s].
SETTLE = 0.4
# Least share of a log's top speed at which a rotor turns, and least step between two levels of its speed [1].
_TURNING, _LEVEL_STEP = 0.05, 0.01
# Largest relative difference between the mean speeds in the two halves of a steady point [1].
_DRIFT = 0.02
# Largest range of the command over a window of a slow ramp and the `SETTLE` before the window [1].
_RAMP_TRAVEL = 0.05
# Largest relative difference between the mean speeds in the halves of a ramp's window [1]: a rotor with a
# time constant of 0.1 s then trails its steady speed by at most 0.5 %.
_RAMP_DRIFT = 0.01
# Least number of different speeds for an estimate of a tare, one more where the rotor turns both ways.
_SPEEDS = 3
# Least ratio of the fastest to the slowest speed in one direction for an estimate of a tare [1].
_SPAN = 1.3
# Largest speed at which a rotor may still be in a dead band, as a share of the log's top speed [1].
_SLOW = 0.25


@dataclass(frozen=True, eq=False)
class SteadyPoints:
    """Averages over stretches at one command, or rows of an averaged log; all arrays (n,), NaN where unknown.

    Command [1], signed speed [rad/s], thrust [N] and torque [N·m] with the tare and sign of the channels that
    the caller gave, supply [V], current [A], number of samples in each point, number of rows at rest from
    which the tares of thrust and torque come.
    """

    u: FloatArray
    speed: FloatArray
    thrust: FloatArray
    torque: FloatArray
    voltage: FloatArray
    current: FloatArray
    samples: IntArray
    thrust_zero: IntArray
    torque_zero: IntArray

    def __len__(self) -> int:
        return self.u.size

    @staticmethod
    def join(parts: Sequence[SteadyPoints]) -> SteadyPoints:
        """Return the points of several logs as one."""
        names = [field.name for field in fields(SteadyPoints)]
        return SteadyPoints(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def steady_points(
    time: FloatArray,
    steps: CommandSteps,
    channels: dict[str, tuple[FloatArray, FloatArray]],
    skip: Sequence[tuple[float, float]] = (),
    zero_rows: Mapping[str, int] | None = None,
    *,
    ramp: bool = False,
) -> SteadyPoints:
    """Average every stretch at one command, without its first third and at least its first 0.4 s.

    A stretch counts if it has at least 6 samples of the speed, the rotor turns at 1 rad/s or faster, and the
    mean speeds of the stretch's halves differ by at most 2 % (1 % with `ramp`). `time` (n,) are rows of the
    log [s]. Channels are (times, values) of samples that a sensor took, none interpolated: ``speed`` and,
    where the log has them, ``thrust``, ``torque``, ``voltage`` and ``current``. Intervals (start, end) [s] of
    `skip` do not count; `zero_rows` is the number of rows at rest from which the tares of ``thrust`` and
    ``torque`` come.

    With `ramp`, average windows of 0.4 s of a command that creeps. Valid for ramps of 20 s or more from rest
    to full command; ignores the rotor's lag behind its steady speed (at most 0.5 % of that speed).
    """
    names, rows = ("speed", "thrust", "torque", "voltage", "current"), []
    if ramp:
        windows = _ramp_windows(time, steps)
    else:
        ends = np.append(steps.time[1:], time[-1] + 1e-9)
        begins = np.maximum(steps.time, time[0])
        # A stand's own averaging, and its supply, settle more slowly than the rotor.
        begins = begins + np.maximum(SETTLE, (ends - begins) / 3.0)
        windows = list(zip(begins.tolist(), ends.tolist(), steps.level.tolist(), strict=True))
    for first, end, level in windows:
        cut = {}
        for name in names:
            if name in channels:
                t, values = channels[name]
                inside = (t >= first) & (t < end) & np.isfinite(values) & outside(t, skip)
                cut[name] = values[inside]
        speed = cut["speed"]
        if speed.size < 6 or abs(level) < AT_REST:
            continue
        half = speed.size // 2
        early, late = float(speed[:half].mean()), float(speed[half:].mean())
        if abs(late) < 1.0 or abs(late - early) > (_RAMP_DRIFT if ramp else _DRIFT) * abs(late):
            continue
        mean = [float(cut[n].mean()) if n in cut and cut[n].size else float("nan") for n in names]
        rows.append([level, *mean, float(speed.size)])
    u, *means, count = np.array(rows, dtype=np.float64).reshape(len(rows), 7).T
    at_rest = zero_rows or {}
    zeros = [np.full(len(rows), at_rest.get(name, 0), dtype=np.int64) for name in ("thrust", "torque")]
    turning, thrust, torque, voltage, current = means
    samples = count.astype(np.int64)
    return SteadyPoints(u, turning, thrust, torque, voltage, current, samples, *zeros)


def _ramp_windows(time: FloatArray, steps: CommandSteps) -> list[tuple[float, float, float]]:
    """Return (start, end, mean u) of windows of 0.4 s in which a command creeps."""
    windows = []
    for start in np.arange(float(time[0]) + SETTLE, float(time[-1]) - SETTLE, SETTLE):
        end = start + SETTLE
        first, last = np.searchsorted(steps.time, [start - SETTLE, end], side="right")
        levels = steps.level[max(first - 1, 0) : last]
        if levels.size < 2 or np.ptp(levels) > _RAMP_TRAVEL or np.min(np.abs(levels)) < AT_REST:
            continue
        rows = time[(time >= start) & (time < end)]
        u = steps.level[np.maximum(np.searchsorted(steps.time, rows, side="right") - 1, 0)]
        if u.size:
            windows.append((float(start), float(end), float(u.mean())))
    return windows


def turning_steps(steps: CommandSteps, time: FloatArray, speed: FloatArray) -> BoolArray:
    """Return (m,) whether the rotor turns under each command: fast, in the median of its stretch.

    A controller that stutters below the throttle at which it starts does not turn its rotor. `time` and
    `speed` (n,) are samples that the sensor took [s], [rad/s].
    """
    size, edges = np.abs(speed), np.append(np.searchsorted(time, steps.time), time.size)
    limit = _TURNING * float(size.max(initial=0.0))
    parts = [size[a:b] for a, b in itertools.pairwise(edges.tolist())]
    return np.array([part.size > 0 and float(np.median(part)) > limit for part in parts], dtype=np.bool_)


def speed_steps(time: FloatArray, speed: FloatArray) -> CommandSteps:
    """Return the steady levels of a speed (n,) [rad/s] as commands: u is the level over the top speed.

    For logs without a command. A level begins where the speed leaves the one before it, so that nothing
    shows how long before the command came. Valid for steps of over 1 % of the top speed, each held for 0.4 s
    or more. LogError where the speed has no such step.
    """
    size = np.abs(speed)
    top, near = float(size.max()), max(1, round(0.5 * LEVEL_SPAN / float(np.median(np.diff(time)))))
    smooth = median_filter(size, 2 * near + 1, mode="nearest")
    padded = np.pad(smooth, near, mode="edge")
    moving = np.abs(padded[2 * near :] - padded[: -2 * near]) > _LEVEL_STEP * top
    begins, ends = (np.flatnonzero(np.diff(np.pad(moving, 1).astype(np.int8)) == sign) for sign in (1, -1))
    if not begins.size:
        raise LogError("the speed has no steady levels to tell commands from")
    # Two transitions that lie closer than a level settles are one.
    apart = np.flatnonzero(time[begins[1:]] - time[ends[:-1] - 1] > 0.5 * SETTLE)
    begins, ends = begins[np.append(0, apart + 1)], ends[np.append(apart, ends.size - 1)]
    stretches = zip(np.append(0, ends).tolist(), np.append(begins, size.size).tolist(), strict=True)
    levels = [float(np.median(size[a:b])) for a, b in stretches if b > a]
    if len(levels) != begins.size + 1:
        raise LogError("the speed begins or ends between two steady levels; cut the trial with start and end")
    instants = [float(time[0])]
    for first, last, before, after in zip(begins, ends, levels[:-1], levels[1:], strict=True):
        left = np.abs(size[first:last] - before) > 0.1 * abs(after - before)
        instants.append(float(time[max(int(first) + int(np.argmax(left)) - 1, 0)]))
    u = np.array(levels) / top
    return CommandSteps(np.array(instants), np.where(u < STANDS, 0.0, np.minimum(u, 1.0)))


def zero_of_steady(values: FloatArray, speed: FloatArray) -> Tare | None:
    """Return the value at standstill of steady values (n,) against their speeds (n,), or None.

    Valid where the values grow with Ω|Ω|, with one factor per direction: a propeller thrusts twice
    as hard forward. Ignores a linear term, whose share passes into the zero. None where the speeds are too
    few, or in each direction too close to each other.
    """
    known = np.isfinite(values) & np.isfinite(speed) & (speed != 0)
    y, omega = values[known], speed[known]
    sides = [side for side in (omega > 0, omega < 0) if side.any()]
    size = np.abs(omega)
    if np.unique(omega).size < _SPEEDS - 1 + len(sides) or not any(
        size[side].max() >= _SPAN * size[side].min() for side in sides
    ):
        return None
    square = omega * size / float(size.max()) ** 2
    columns = np.column_stack([*(square * side for side in sides), np.ones(omega.size)])
    solution = np.linalg.lstsq(columns, y, rcond=None)[0]
    residual = y - columns @ solution
    spread = float(residual @ residual) / max(y.size - len(solution), 1)
    error = float(np.sqrt(spread * np.linalg.inv(columns.T @ columns)[-1, -1]))
    return Tare(float(solution[-1]), error, 0, "steady_points")


def sign_against_speed(values: FloatArray, speed: FloatArray) -> int:
    """Return -1 where values (n,) oppose their speeds (n,) on balance, else +1; 0 where nothing shows it.

    A propeller's drag torque has the sign of its speed by the convention here; the caller turns the torque of
    a stand with the opposite convention.
    """
    known = np.isfinite(values) & np.isfinite(speed) & (speed != 0)
    total = float(np.sum(values[known] * speed[known]))
    return int(np.sign(total))


def sign_of_log(values: tuple[FloatArray, FloatArray], speed: tuple[FloatArray, FloatArray]) -> int:
    """Return the sign of a channel (times, values) against a speed over a log; 0 where nothing shows it.

    Serves logs without a steady stretch: over a whole log the rotor gives more energy to the air than its
    inertia gives back, so the sum of torque times speed keeps the sign of the drag.
    """
    if not values[0].size or not speed[0].size:
        return 0
    return sign_against_speed(values[1], np.interp(values[0], *speed))


def find_starts(
    time: FloatArray, speed: FloatArray, steps: CommandSteps, edge: float, end: float
) -> tuple[tuple[float, float], ...]:
    """Return (start, end) [s] of the spin-ups that begin inside a dead band.

    Each runs from the command that finds the rotor inside the band until `SETTLE` after the rotor has left
    it, at most to the `end` of the log [s]; spin-ups that overlap are one. `time` and `speed` (n,) are
    samples that the sensor took [s], [rad/s]; the sign of the speed does not matter. `edge` is the largest
    speed of the dead band [rad/s]; at most the share `_SLOW` of the log's top speed counts.
    """
    size = np.abs(speed)
    if not size.size:
        return ()
    edge = min(edge, _SLOW * float(size.max()))
    intervals: list[tuple[float, float]] = []
    for i in range(steps.time.size):
        start = float(steps.time[i])
        # For a command before the first sample, that sample shows the state of the rotor.
        at = max(int(np.searchsorted(time, start, side="right")) - 1, 0)
        if abs(steps.level[i]) < AT_REST or size[at] >= edge:
            continue
        after = np.flatnonzero(size[at:] >= edge)
        until = min(float(time[at + after[0]]) + SETTLE, end) if after.size else end
        if intervals and start <= intervals[-1][1]:
            intervals[-1] = (intervals[-1][0], max(until, intervals[-1][1]))
        else:
            intervals.append((start, until))
    return tuple(intervals)
