"""NRMSE of simulated motor trials: the simulation walks the way of the log, then both are compared.

Two ways, one per kind of instrument. A *fast* log (load cell, 10 kHz) went through the zero-phase Chebyshev
filter; its impulse response, sampled once on the simulation's grid, filters the simulation, and both are
compared on a grid that still resolves the stop-band edge. A *slow* log (thrust stand, 8 to 27 ms) is not
filtered; the simulated torque and speed pass first-order lags of the sensors and are read at the rows of the
log, the torque later by its sensor's delay.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit

from sysid.fit.nrmse import FAILED_NRMSE, Denominator, divisor
from sysid.fit.trial import ComparedChannel, Cost
from sysid.parallel import in_threads
from sysid.types import BoolArray, FloatArray

CHANNELS = ("stator_torque", "speed")


@dataclass(frozen=True, eq=False)
class MotorTarget:
    """What one trial measured and how a simulation must be prepared to compare.

    Compared are stator torque [N·m] and speed [rad/s], `measured` (n, 2) at `time` (n,) [s], where `valid`
    (n, 2). The simulated grid has a first time and step [s] and a number of samples. `taps` (h + 1,) are the
    centre and one side of the symmetric filter of a fast log, empty for a slow one. With a filter, `time`
    takes every k-th sample of the grid, at least h samples from both ends.
    """

    name: str
    time: FloatArray
    measured: FloatArray
    valid: BoolArray
    grid_start: float
    grid_step: float
    grid_size: int
    taps: FloatArray


class BenchCost(Cost):
    """Compiled NRMSE of a population on several trials; the same numbers on any number of threads.

    `weights` of torque and speed count in the mean over channels; the `denominator`, "std" or "range" of the
    measured samples, is per trial and channel. A channel without samples or a constant one is a FitError; if
    it has no weight, its NRMSE is NaN.
    """

    channels = (ComparedChannel(CHANNELS[0], "N·m"), ComparedChannel(CHANNELS[1], "rad/s"))

    def __init__(
        self, targets: tuple[MotorTarget, ...], weights: tuple[float, float], denominator: Denominator
    ) -> None:
        self.targets = targets
        self.weights = np.asarray(weights, dtype=np.float64)
        self.denominators = np.full((len(targets), 2), np.nan)
        for t, target in enumerate(targets):
            for c, channel in enumerate(CHANNELS):
                values, seen, weight = target.measured[:, c], target.valid[:, c], weights[c]
                if weight > 0 or seen.any():
                    scale = divisor(f"{target.name}, {channel}", values, seen, denominator, weight)
                    self.denominators[t, c] = scale or np.nan
        self.grid = np.cumsum([0, *(target.grid_size for target in targets)], dtype=np.int64)
        taps, time, valid, measured = (
            [getattr(target, name) for target in targets] for name in ("taps", "time", "valid", "measured")
        )
        rows, tap_first = (np.cumsum([0, *map(len, each)], dtype=np.int64) for each in (time, taps))
        valid_rows = np.concatenate(valid)
        # `_score` takes them in this order.
        self._prepared = (
            (int(np.diff(self.grid).max()), int(np.diff(rows).max())), rows, self.grid, tap_first,
            np.concatenate(taps), np.concatenate(time),
            np.where(valid_rows, np.concatenate(measured), 0.0), valid_rows,
            np.array([target.grid_start for target in targets]),
            np.array([target.grid_step for target in targets]), self.denominators, self.weights,
        )  # fmt: skip

    def __call__(
        self,
        samples: FloatArray,
        reached: FloatArray,
        sensors: FloatArray,
        threads: int | None = None,
        signals: FloatArray | None = None,
    ) -> tuple[FloatArray, BoolArray]:
        """Return NRMSE (P, T, 2) and failure (P, T) of a population; fill `signals`, see `compared`.

        `samples` (P, n_total, 2) are simulated stator torque [N·m] and speed [rad/s] on the trials' grids,
        end to end, `sensors` (P, 3) torque delay, torque lag, speed lag [s] of slow logs. A trial of which
        less than all is `reached` (P, T) failed and scores ``FAILED_NRMSE · (2 − reached)``.
        """
        by_channel = np.empty((len(samples), len(self.targets), 2))
        failed = np.zeros(by_channel.shape[:2], dtype=np.bool_)
        in_threads(
            _score, failed.size, threads,
            samples, reached, sensors, *self._prepared, by_channel, failed,
            np.empty((0, 0, 2)) if signals is None else signals,
        )  # fmt: skip
        return by_channel, failed

    def compared(
        self, samples: FloatArray, reached: FloatArray, sensors: FloatArray, threads: int | None = None
    ) -> tuple[FloatArray, BoolArray, tuple[FloatArray, ...]]:
        """Return the same, and per trial the simulated signals as compared: (P, n, 2) [N·m], [rad/s]."""
        first = self._prepared[1]
        signals = np.empty((len(samples), first[-1], 2))
        by_channel, failed = self(samples, reached, sensors, threads, signals)
        return by_channel, failed, tuple(np.split(signals, first[1:-1], axis=1))


@njit(cache=True, error_model="numpy")
def _place(sample, stride, width):
    """Return the place of a sample after sorting by its remainder."""
    whole = sample // stride
    return (sample - whole * stride) * width + whole


@njit(cache=True, error_model="numpy")
def _compared(part, sensors, taps, time, start, step, valid, every, out, signal):
    """Fill out (n, 2) with the simulated signals at the compared times; `signal` (n_grid,) is for work.

    Of a slow log only what is `valid` (n, 2) is filled, unless `every` sample is wanted: torque comes at one
    in twenty of the speed's rows.
    """
    n_grid = part.shape[0]
    if taps.size > 0:
        # Compared instants are every stride-th sample. Sorted by their remainder, the samples that one tap
        # touches lie side by side, and the sum over instants runs in vector registers, two taps at a time.
        first = int((time[0] - start) / step + 0.5)
        stride = int((time[1] - time[0]) / step + 0.5)
        width = n_grid // stride + 1
        sorted_samples = np.zeros(stride * width)
        total = np.empty(time.size)
        for c in range(2):
            for r in range(stride):
                for q in range((n_grid - r + stride - 1) // stride):
                    sorted_samples[r * width + q] = part[q * stride + r, c]
            at = _place(first, stride, width)
            centre = sorted_samples[at : at + time.size]
            for i in range(time.size):
                total[i] = taps[0] * centre[i]
            for k in range(1, taps.size, 2):
                tap, other = taps[k], taps[k + 1] if k + 1 < taps.size else 0.0
                # An odd last tap reads the samples of `k` twice; the second reading has weight 0.
                further = k + 1 if k + 1 < taps.size else k
                places = (first - k, first + k, first - further, first + further)
                before = sorted_samples[_place(places[0], stride, width) :]
                after = sorted_samples[_place(places[1], stride, width) :]
                further_before = sorted_samples[_place(places[2], stride, width) :]
                further_after = sorted_samples[_place(places[3], stride, width) :]
                for i in range(time.size):
                    total[i] += tap * (before[i] + after[i]) + other * (further_before[i] + further_after[i])
            for i in range(time.size):  # as a column: two seconds more of compilation, for an error message
                out[i, c] = total[i]
        return
    for c in range(2):
        delay = sensors[0] if c == 0 else 0.0
        lag = sensors[1] if c == 0 else sensors[2]
        sensed = part[:, c]
        if lag > 0.0:
            # Exact for a signal that is linear over each grid step.
            keep = np.exp(-step / lag)
            signal[0] = part[0, c]
            for m in range(1, n_grid):
                trail = lag * (part[m, c] - part[m - 1, c]) / step
                signal[m] = part[m, c] - trail + keep * (signal[m - 1] - part[m - 1, c] + trail)
            sensed = signal[:n_grid]
        for i in range(time.size):
            if not (every or valid[i, c]):
                continue
            x = (time[i] - delay - start) / step
            m = min(max(int(x), 0), n_grid - 2)
            share = min(max(x - m, 0.0), 1.0)
            out[i, c] = sensed[m] + share * (sensed[m + 1] - sensed[m])


@njit(cache=True, error_model="numpy", nogil=True)
def _score(
    first_job, last_job, samples, reached, sensors, longest, rows, grid, tap_first, taps, time, measured,
    valid, start, step, denominators, weights, by_channel, failed, signals,
):  # fmt: skip
    n_trials, wanted = start.size, signals.shape[0] > 0
    # Fresh memory for every job would cost as much as the comparison.
    work, compared = np.empty(longest[0]), np.empty((longest[1], 2))
    for job in range(first_job, last_job):
        p = job // n_trials
        t = job % n_trials
        complete = reached[p, t] >= 1.0
        if complete or wanted:
            first = rows[t]
            n = rows[t + 1] - first
            out = signals[p, first : first + n] if wanted else compared[:n]
            _compared(
                samples[p, grid[t] : grid[t + 1]], sensors[p], taps[tap_first[t] : tap_first[t + 1]],
                time[first : first + n], start[t], step[t],
                valid[first : first + n], wanted, out, work,
            )  # fmt: skip
            for c in range(2):
                total = 0.0
                count = 0
                for i in range(n):
                    if valid[first + i, c]:
                        error = out[i, c] - measured[first + i, c]
                        total += error * error
                        count += 1
                by_channel[p, t, c] = np.sqrt(total / max(count, 1)) / denominators[t, c]
                if not np.isfinite(by_channel[p, t, c]) and weights[c] > 0.0:
                    complete = False
        if not complete:
            failed[p, t] = True
            share = min(max(reached[p, t], 0.0), 1.0) if np.isfinite(reached[p, t]) else 0.0
            by_channel[p, t, 0] = FAILED_NRMSE * (2.0 - share)
            by_channel[p, t, 1] = FAILED_NRMSE * (2.0 - share)
