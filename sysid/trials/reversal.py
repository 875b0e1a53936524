"""Thrust reversals in a bench log: from the command to 90 % of the final reverse thrust.

Knows no motor model. Thrust arrives tared, positive forward, and filtered where the log is fast enough.
A reversal is a command of the opposite sign to the one before it, held for over 0.2 s.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sysid.trials.bench_log import CommandSteps, command_steps, outside
from sysid.types import FloatArray

Sense = Literal["to-reverse", "to-forward", "both"]

# Share of the final thrust at which a reversal is done [1], as in Fig. 3 of the paper.
LEVEL = 0.9
# Half width of the dead band, as a share of the final speed of a signed probe, else of the final thrust [1].
# A thrust of 5 % is a speed of 22 %.
DEAD_BAND = 0.05
# Least ratio of an outlier's time to that of the quickest repetition.
SLOW = 1.5
# Last part of the time at one command over which the final value is averaged [1], and least such time [s].
_LAST, _LEAST_HOLD = 0.25, 0.2
# Largest difference between the halves of the averaged part in a settled repetition, over the mean of that
# part [1].
_DRIFT = 0.1
# Least mean of the averaged part in a settled repetition, over the largest one at the same command [1]: a
# battery that sags by a fifth leaves 0.64 of the thrust, a rotor that has not started leaves none.
_LEAST_FINAL = 0.6
# Percentile of the times against which outliers are measured [%]: a controller that fails four times of five
# still has its quick repetitions there.
_QUICK = 10.0
# Largest difference of logged u that are one command [1]: a receiver's pulses jitter by a microsecond.
JITTER = 0.005
# Longest neutral that is passed on the way from one command to the next [s]; a longer one is a rest.
_PASSING = 0.05


@dataclass(frozen=True)
class Reversal:
    """One reversal; times are counted from its command [s], NaN where the log does not show it."""

    # The command on the clock of the log [s].
    time: float
    # Commands u [1].
    before: float
    after: float
    # Time until the next command [s].
    hold: float
    # Time until the rotor stood still, or the thrust was zero, and time inside the dead band [s].
    zero_crossing: float
    dead_band: float
    # Time until the thrust was 90 % of its final value [s]; NaN if it never was before the next command.
    to_level: float
    # Final thrust of the repetition itself where it settled [N], signed as `after`; NaN where none did.
    final_thrust: float


def held_commands(steps: CommandSteps) -> CommandSteps:
    """Return the commands u that were meant: jitter taken out, a neutral in passing left out.

    Levels within 0.005 of each other become the one of them that was held longest, and 0 when they are that
    close to it; a neutral of less than 50 ms between two commands belongs to the first.
    """
    if steps.time.size < 2:
        return steps
    # The end of the last command is not in the log: it counts as lasting as long as the one before it.
    lasting = np.append(np.diff(steps.time), np.diff(steps.time[-2:]))
    values, which = np.unique(steps.level, return_inverse=True)
    weight = np.bincount(which, weights=lasting)
    meant = values.copy()
    first = 0
    for i in range(1, values.size + 1):
        if i == values.size or values[i] - values[first] > JITTER:
            meant[first:i] = values[first:i][np.argmax(weight[first:i])]
            first = i
    meant[np.abs(values) <= JITTER] = 0.0
    merged = command_steps(steps.time, meant[which])
    passing = (merged.level == 0) & (np.append(np.diff(merged.time), np.inf) < _PASSING)
    passing[0] = False
    return command_steps(merged.time[~passing], merged.level[~passing])


def find_reversals(
    time: FloatArray,
    steps: CommandSteps,
    thrust: tuple[FloatArray, FloatArray],
    speed: tuple[FloatArray, FloatArray] | None = None,
    *,
    skip: Sequence[tuple[float, float]] = (),
    sense: Sense = "to-reverse",
) -> tuple[Reversal, ...]:
    """Find the reversals of a log with rows at `time` (n,) [s] and commands u, and time them.

    Thrust [N] and speed [rad/s] are (times [s], values) of real samples; crossings between two are
    interpolated. Zero crossing and dead band are read from the speed where it is signed, else from the
    thrust. Reversals whose command lies in an interval (start, end) [s] of `skip` are left out.

    Notes
    -----
    The final thrust of a repetition is the mean over the last quarter of its hold: a supply that sags
    weakens later repetitions and does not make them fail. One that has not settled by then (its halves differ
    by over 10 %, or it has less than 60 % of the largest) must not be measured against itself; it takes the
    final thrust of the nearest repetition in time that has. Where none has, final thrust and time to 90 % of
    it are not known: both are NaN. Commands are read as `held_commands` gives them.
    """
    steps = held_commands(steps)
    ends = np.append(steps.time[1:], float(time[-1]))
    commands: list[tuple[float, float, float, float]] = []
    for i in range(1, steps.time.size):
        before, after = float(steps.level[i - 1]), float(steps.level[i])
        hold = float(ends[i] - steps.time[i])
        if before * after >= 0 or hold < _LEAST_HOLD or not outside(steps.time[i : i + 1], skip)[0]:
            continue
        if sense == "both" or (after < 0) == (sense == "to-reverse"):
            commands.append((float(steps.time[i]), before, after, hold))
    signed = speed is not None and speed[1].size > 0 and float(np.min(speed[1])) < 0 < float(np.max(speed[1]))
    signal = speed if signed and speed is not None else thrust
    finals, scales = _finals(commands, thrust), _finals(commands, signal)
    out = []
    for (start, before, after, hold), final, scale in zip(commands, finals, scales, strict=True):
        sign = 1.0 if after > 0 else -1.0
        t, values = _part(thrust, start, start + hold)
        reached = _first(t, sign * values, LEVEL * final) if final > 0 else float("nan")
        t, values = _part(signal, start, start + hold)
        band = DEAD_BAND * scale
        entered, zero, left = (
            _passed(t, sign * values, threshold, 0.5 * scale) for threshold in (-band, 0.0, band)
        )
        out.append(
            Reversal(start, before, after, hold, zero - start, left - entered, reached - start, sign * final)
        )
    return tuple(out)


def _part(signal: tuple[FloatArray, FloatArray], start: float, end: float) -> tuple[FloatArray, FloatArray]:
    inside = (signal[0] >= start) & (signal[0] < end)
    return signal[0][inside], signal[1][inside]


def _finals(
    commands: Sequence[tuple[float, float, float, float]], signal: tuple[FloatArray, FloatArray]
) -> list[float]:
    """Return the final value of every reversal, positive along its command; NaN where none is known."""
    last, drift = np.full(len(commands), np.nan), np.zeros(len(commands))
    for i, (start, _, after, hold) in enumerate(commands):
        _, values = _part(signal, start + (1.0 - _LAST) * hold, start + hold)
        if values.size:
            last[i] = np.sign(after) * float(np.mean(values))
            half = values.size // 2
            # Two samples of a slow sensor say nothing about a drift.
            if half > 1:
                drift[i] = abs(float(np.mean(values[half:])) - float(np.mean(values[:half])))
    times, levels = np.array([f[0] for f in commands]), np.array([f[2] for f in commands])
    out = [float("nan")] * len(commands)
    for i in range(len(commands)):
        same = np.flatnonzero((levels == levels[i]) & np.isfinite(last))
        largest = np.max(last[same], initial=-np.inf)
        settled = same[(last[same] >= _LEAST_FINAL * largest) & (drift[same] <= _DRIFT * last[same])]
        if settled.size:
            out[i] = float(last[settled[np.argmin(np.abs(times[settled] - times[i]))]])
    return out


def _first(time: FloatArray, values: FloatArray, threshold: float) -> float:
    """Return when `values` first reach `threshold` from below, between samples; NaN when they never do."""
    above = np.flatnonzero(values >= threshold)
    if not np.isfinite(threshold) or above.size == 0:
        return float("nan")
    i = int(above[0])
    if i == 0:
        return float(time[0])
    share = (threshold - values[i - 1]) / (values[i] - values[i - 1])
    return float(time[i - 1] + share * (time[i] - time[i - 1]))


def _passed(time: FloatArray, values: FloatArray, threshold: float, beyond: float) -> float:
    """Return when rising `values` pass `threshold` on their way to `beyond`; NaN when they never do.

    It is the time of the first sample plus the total time that the values lie below the threshold. Noise
    makes a slow signal cross the threshold many times, and lengthens the total as often as it shortens it.
    """
    if not np.isfinite(threshold) or values.size == 0 or not np.any(values >= threshold):
        return float("nan")
    on_the_way = np.flatnonzero(values >= beyond)
    last = int(on_the_way[0]) + 1 if np.isfinite(beyond) and on_the_way.size else values.size
    above = values[:last] - threshold
    step, rise = np.diff(time[:last]), np.diff(above)
    crossed = (above[:-1] < 0) != (above[1:] < 0)
    share = np.where(above[:-1] < 0, 1.0, 0.0)
    below = np.where(above[:-1] < 0, -above[:-1], -above[1:])
    share[crossed] = below[crossed] / np.abs(rise[crossed])
    return float(time[0] + np.sum(share * step))


@dataclass(frozen=True)
class Repetitions:
    """Reversals of one pair of commands u [1]."""

    before: float
    after: float
    reversals: tuple[Reversal, ...]

    def median(self, name: str) -> float:
        """Return the median of a time over the repetitions that show it [s]."""
        values = self._values(name)
        return float(np.median(values)) if values.size else float("nan")

    def quartiles(self, name: str) -> tuple[float, float]:
        """Return the quartiles of a time over the repetitions that show it [s]."""
        values = self._values(name)
        low, high = np.percentile(values, [25.0, 75.0]) if values.size else (np.nan, np.nan)
        return float(low), float(high)

    def outliers(self, slow: float = SLOW) -> int:
        """Return how many took over `slow` times the quickest's time to 90 %, or were not seen to get there.

        Measured against a low percentile, not the median: of a controller that fails half of the time the
        median is a failure. One that fails every time is only seen next to others.
        """
        values = np.array([r.to_level for r in self.reversals])
        reached = values[np.isfinite(values)]
        if not reached.size:
            return len(values)
        quick = float(np.percentile(reached, _QUICK, method="lower"))
        return int(np.count_nonzero(~(values <= slow * quick)))

    @property
    def unsettled(self) -> bool:
        """Whether no repetition settled: their final thrust, and the time to 90 % of it, are not known."""
        return not any(np.isfinite(r.final_thrust) for r in self.reversals)

    def _values(self, name: str) -> FloatArray:
        values = np.array([getattr(r, name) for r in self.reversals], dtype=np.float64)
        return values[np.isfinite(values)]


def repetitions(reversals: Sequence[Reversal]) -> tuple[Repetitions, ...]:
    """Group reversals by their pair of commands, in the order in which they first occur."""
    groups: dict[tuple[float, float], list[Reversal]] = {}
    for reversal in reversals:
        groups.setdefault((round(reversal.before, 3), round(reversal.after, 3)), []).append(reversal)
    return tuple(Repetitions(before, after, tuple(group)) for (before, after), group in groups.items())
