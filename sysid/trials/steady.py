"""Steady points of a bench log: plateaus of a step log, windows of a slow ramp, rows of an averaged log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from sysid.trials.bench_log import AT_REST, CommandSteps, outside
from sysid.types import FloatArray, IntArray

# A point is steady this long after a command [s], and when its two halves agree to this share.
SETTLE = 0.4
_DRIFT = 0.02
# A window of a slow ramp counts as steady when its command moves by less than this, jumps included, over the
# window and a settling time before it, and its halves agree twice as well: a rotor of 0.1 s then trails its
# steady speed by 0.5 %.
_RAMP_TRAVEL, _RAMP_DRIFT = 0.05, 0.01


@dataclass(frozen=True, eq=False)
class SteadyPoints:
    """Averages over stretches at one command, or rows of an averaged log; all arrays (n,), NaN where unknown.

    Command [1], signed speed [rad/s], thrust and torque with the tare subtracted and the sign of the speed
    [N], [N·m], supply [V], rows behind each point, rows at rest behind the two tares.
    """

    u: FloatArray
    speed: FloatArray
    thrust: FloatArray
    torque: FloatArray
    voltage: FloatArray
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
) -> SteadyPoints:
    """Average every stretch at one command, from 0.4 s after the command until the next.

    Only stretches that turn and whose speed is the same in both halves to 2 % count.

    Parameters
    ----------
    time : (n,) array
        Rows of the log [s]; their first and last bound the stretches.
    channels : dict of name to (times, values)
        ``speed`` and, where the log has them, ``thrust``, ``torque``, ``voltage``: real samples only.
    skip : sequence of (start, end)
        Intervals that do not count [s].
    zero_rows : mapping of str to int, optional
        Rows at rest behind the tare of ``thrust`` and ``torque``.
    """
    ends = np.append(steps.time[1:], time[-1] + 1e-9)
    stretches = [
        (max(start, float(time[0])) + SETTLE, end, level)
        for start, end, level in zip(steps.time, ends, steps.level, strict=True)
    ]
    return _averages(stretches, channels, skip, _DRIFT, zero_rows or {})


def ramp_points(
    time: FloatArray,
    steps: CommandSteps,
    channels: dict[str, tuple[FloatArray, FloatArray]],
    skip: Sequence[tuple[float, float]] = (),
    zero_rows: Mapping[str, int] | None = None,
) -> SteadyPoints:
    """Average windows of 0.4 s of a command that creeps, so slowly that the rotor keeps up with it.

    Valid for ramps of 20 s or more from rest to full; ignores what the rotor trails by (0.5 % of its speed).
    Arguments as of `steady_points`; `u` is the mean over the window.
    """
    windows = []
    for start in np.arange(float(time[0]) + SETTLE, float(time[-1]) - SETTLE, SETTLE):
        end = start + SETTLE
        first, last = np.searchsorted(steps.time, [start - SETTLE, end], side="right")
        held = steps.level[max(first - 1, 0) : last]
        if held.size < 2 or np.ptp(held) > _RAMP_TRAVEL or np.min(np.abs(held)) < AT_REST:
            continue
        rows = time[(time >= start) & (time < end)]
        u = steps.level[np.maximum(np.searchsorted(steps.time, rows, side="right") - 1, 0)]
        if u.size:
            windows.append((float(start), float(end), float(u.mean())))
    return _averages(windows, channels, skip, _RAMP_DRIFT, zero_rows or {})


def _averages(
    stretches: Sequence[tuple[float, float, float]],
    channels: dict[str, tuple[FloatArray, FloatArray]],
    skip: Sequence[tuple[float, float]],
    drift: float,
    zero_rows: Mapping[str, int],
) -> SteadyPoints:
    """Average (start, end, u) stretches that turn and whose speed is the same in both halves to `drift`."""
    names = ("speed", "thrust", "torque", "voltage")
    rows: list[list[float]] = []
    for first, end, level in stretches:
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
        if abs(late) < 1.0 or abs(late - early) > drift * abs(late):
            continue
        means = [float(cut[n].mean()) if n in cut and cut[n].size else float("nan") for n in names]
        rows.append([level, *means, float(speed.size)])
    table = np.array(rows, dtype=np.float64).reshape(len(rows), 6)
    u, turning, thrust, torque, voltage, samples = table.T
    zeros = [np.full(len(rows), zero_rows.get(name, 0), dtype=np.int64) for name in ("thrust", "torque")]
    return SteadyPoints(u, turning, thrust, torque, voltage, samples.astype(np.int64), *zeros)
