"""The normalised RMS error of a population's samples, compiled.

Law (MATLAB's ``goodnessOfFit``; the paper names the measure, not its denominator)::

    NRMSE = rms(simulated − measured) / std(measured)        denominator "std", the default
    NRMSE = rms(simulated − measured) / (max − min)(measured)             denominator "range"

rms, std (divided by n, not n − 1) and range are taken over the valid samples of one channel of one trial.
The cost of a candidate is the weighted mean over the channels of a trial, then the mean over trials.

The simulated signal is treated like the measured one: linear interpolation replaces samples inside the log's
gaps, the same symmetric FIR filter runs over it, and rates are central differences of the filtered signal. An
impact is broadband, so treating one side only biases the fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import FitError
from sysid.fit.nrmse_kernels import FAILED_NRMSE, prepare_trial, score_population
from sysid.fit.trial import ComparedChannel, Cost
from sysid.parallel import in_threads
from sysid.types import BoolArray, FloatArray

__all__ = ["FAILED_NRMSE", "CostChannel", "FilteredNrmse", "TrialTarget", "spread"]

Denominator = Literal["std", "range"]


def spread(measured: ArrayLike, valid: ArrayLike | None = None, denominator: Denominator = "std") -> float:
    """Return the NRMSE denominator of one measured channel [unit of the channel].

    Of the samples (n,) that are valid, by default all: their standard deviation (divided by n), or maximum
    minus minimum. Raises FitError when there is none, or `denominator` is neither.
    """
    values = np.asarray(measured, dtype=np.float64)
    if valid is not None:
        values = values[np.asarray(valid, dtype=np.bool_)]
    if values.size == 0:
        raise FitError("no valid sample to compare with; widen the window or drop the trial")
    if denominator == "std":
        return float(np.std(values))
    if denominator == "range":
        return float(np.ptp(values))
    raise FitError(f"unknown NRMSE denominator {denominator!r}; expected 'std' or 'range'")


@dataclass(frozen=True)
class CostChannel(ComparedChannel):
    """One compared channel: a column of the simulated samples; with `rate` its derivative after the filter.

    `weight` counts in the mean over channels, ≥ 0 [1].
    """

    column: int
    rate: bool = False
    weight: float = 1.0


@dataclass(frozen=True, eq=False)
class TrialTarget:
    """What one trial measured inside its fit window, and how a simulation must be prepared to compare."""

    name: str
    # (n_window, n_channels) filtered and differentiated measurement [channel units].
    measured: FloatArray
    # Samples that count. Default: where `measured` is finite.
    valid: BoolArray | None = None
    # Sample rate of the recording's uniform clock [Hz].
    rate: float = 1.0
    # (2 h + 1,) symmetric FIR filter [1]. Default: none, samples are compared as they are.
    taps: FloatArray | None = None
    # (n_window + 2 margin,) False inside a gap of the log; there the simulated samples are interpolated
    # linearly between their neighbours, as the log was before its filter (constant at the array's ends).
    # Default: no gap.
    delivered: BoolArray | None = None


def divisor(
    where: str, measured: FloatArray, valid: BoolArray, denominator: Denominator, weight: float
) -> float:
    """Return the `spread` of a channel; FitError, which names `where`, if its `weight` counts and it is 0."""
    try:
        scale = spread(measured, valid, denominator)
    except FitError as error:
        raise FitError(f"{where}: {error}") from None
    if scale == 0.0 and weight > 0:
        raise FitError(
            f"{where}: constant over the window, so its NRMSE is undefined; give the channel weight 0 or "
            "drop the trial"
        )
    return scale


class FilteredNrmse(Cost):
    """NRMSE of a population against several trials, compiled; parallel over candidates only.

    Simulated samples are laid out trial after trial along one axis: trial ``t`` occupies rows
    ``offsets[t]:offsets[t + 1]``, which are its ``n_window`` samples and ``margins[t]`` extra samples on
    either side (half the filter's length, and one more where a rate is compared). `channels` are the columns
    of every trial's `measured`. One thread sums each candidate in a fixed order, so numbers do not depend on
    the number of threads.

    Raises FitError when a weighted channel is constant or has no valid sample in a trial, ValueError when
    shapes contradict each other or taps are not odd and symmetric.
    """

    channels: tuple[CostChannel, ...]

    def __init__(
        self, trials: Sequence[TrialTarget], channels: Sequence[CostChannel], denominator: Denominator = "std"
    ) -> None:
        self.trials = tuple(trials)
        self.channels = tuple(channels)
        self.denominator: Denominator = denominator
        self.weights = np.array([channel.weight for channel in self.channels], dtype=np.float64)
        if not self.trials or not self.channels:
            raise ValueError("a cost needs at least one trial and one channel")
        if not np.all(self.weights >= 0) or not np.any(self.weights > 0):
            raise FitError(
                f"channel weights are {self.weights.tolist()}; expected none below 0 and at least one above"
            )
        self._reach = 1 if any(channel.rate for channel in self.channels) else 0
        self._column = np.array([channel.column for channel in self.channels], dtype=np.int64)
        self._is_rate = np.array([channel.rate for channel in self.channels], dtype=np.bool_)
        self._prepare_filters()
        self._prepare_measured()
        self._prepare_gaps()

    def _prepare_filters(self) -> None:
        taps = [np.ones(1) if t.taps is None else np.asarray(t.taps, dtype=np.float64) for t in self.trials]
        for trial, h in zip(self.trials, taps, strict=True):
            if h.ndim != 1 or h.size % 2 == 0 or not np.allclose(h, h[::-1], rtol=1e-12, atol=1e-15):
                raise ValueError(f"{trial.name}: filter taps must be odd in number and symmetric")
        self._half = np.array([h.size // 2 for h in taps], dtype=np.int64)
        # Centre tap first, then outwards: one row per trial.
        self._taps = np.zeros((len(taps), int(self._half.max()) + 1))
        for row, h in zip(self._taps, taps, strict=True):
            row[: h.size // 2 + 1] = h[h.size // 2 :]
        self._rate = np.array([trial.rate for trial in self.trials], dtype=np.float64)
        self.margins = self._half + self._reach

    def _prepare_measured(self) -> None:
        n_channels = len(self.channels)
        measured, valid = [], []
        self.denominators = np.empty((len(self.trials), n_channels))
        for t, trial in enumerate(self.trials):
            values = np.asarray(trial.measured, dtype=np.float64)
            if values.ndim != 2 or values.shape[1] != n_channels:
                raise ValueError(f"{trial.name}: measured {values.shape}, expected (n, {n_channels})")
            mask = np.isfinite(values)
            if trial.valid is not None:
                given = np.asarray(trial.valid, dtype=np.bool_)
                mask = mask & (given[:, None] if given.ndim == 1 else given)
            for c, channel in enumerate(self.channels):
                where = f"trial {trial.name}, {channel.name}"
                self.denominators[t, c] = divisor(
                    where, values[:, c], mask[:, c], self.denominator, channel.weight
                )
            measured.append(np.where(mask, values, 0.0))
            valid.append(mask)
        lengths = np.array([len(m) for m in measured])
        self._window = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        self.offsets = np.concatenate([[0], np.cumsum(lengths + 2 * self.margins)]).astype(np.int64)
        self._measured = np.concatenate(measured)
        self._valid = np.concatenate(valid)

    def _prepare_gaps(self) -> None:
        n_total = int(self.offsets[-1])
        self._left = np.arange(n_total, dtype=np.int64)
        self._right = self._left.copy()
        self._share = np.zeros(n_total)
        for trial, start, end in zip(self.trials, self.offsets[:-1], self.offsets[1:], strict=True):
            if trial.delivered is None:
                continue
            delivered = np.asarray(trial.delivered, dtype=np.bool_)
            if delivered.shape != (end - start,):
                raise ValueError(f"{trial.name}: delivered {delivered.shape}, expected ({end - start},)")
            known = np.flatnonzero(delivered)
            if known.size == 0:
                raise FitError(f"trial {trial.name}: no sample was delivered in its window; drop the trial")
            lost = np.flatnonzero(~delivered)
            after = np.searchsorted(known, lost)
            # Before the first and after the last delivered sample both neighbours are that sample.
            left = known[np.maximum(after - 1, 0)]
            right = known[np.minimum(after, known.size - 1)]
            width = np.maximum(right - left, 1)
            self._left[start + lost] = start + left
            self._right[start + lost] = start + right
            self._share[start + lost] = np.where(right > left, (lost - left) / width, 0.0)

    @property
    def n_total(self) -> int:
        """Rows that the simulated samples must have."""
        return int(self.offsets[-1])

    def _checked(self, samples: FloatArray) -> FloatArray:
        samples = np.ascontiguousarray(samples, dtype=np.float64)
        n_columns = int(self._column.max()) + 1
        if samples.ndim != 3 or samples.shape[1] != self.n_total or samples.shape[2] < n_columns:
            raise ValueError(
                f"samples {samples.shape}, expected (P, {self.n_total}, at least {n_columns}): "
                "each trial's window and its margins, one after the other"
            )
        return samples

    def __call__(
        self, samples: FloatArray, reached: FloatArray | None = None, threads: int | None = None
    ) -> tuple[FloatArray, BoolArray]:
        """Return NRMSE (P, T, C) [1] and failure (P, T) of simulated samples (P, n_total, n_columns) [SI].

        `reached` (P, T) is the share of the trial that was simulated [1], by default 1. A trial failed where
        that is below 1, or from its first sample on that is not finite; it scores
        ``FAILED_NRMSE · (2 − reached)`` in every channel. The numbers do not depend on `threads`.
        """
        samples = self._checked(samples)
        n_candidates, n_trials = len(samples), len(self.trials)
        share = np.ones((n_candidates, n_trials)) if reached is None else np.array(reached, dtype=np.float64)
        if share.shape != (n_candidates, n_trials):
            raise ValueError(f"reached {share.shape}, expected ({n_candidates}, {n_trials})")
        by_channel = np.empty((n_candidates, n_trials, len(self.channels)))
        failed = np.zeros((n_candidates, n_trials), dtype=np.bool_)
        in_threads(
            score_population, n_candidates, threads,
            samples, share, self.offsets, self._window, self._half, self._reach, self._taps, self._rate,
            self._left, self._right, self._share, self._column, self._is_rate,
            self._measured, self._valid, self.denominators, self.weights, by_channel, failed,
        )  # fmt: skip
        return by_channel, failed

    def prepared(self, samples: FloatArray) -> tuple[FloatArray, ...]:
        """Return, per trial, the signals that are compared: (P, n_window, C) [channel units]."""
        samples = self._checked(samples)
        out = []
        for t in range(len(self.trials)):
            block = np.empty((len(samples), int(self._window[t + 1] - self._window[t]), len(self.channels)))
            work = np.empty((2, int(self.offsets[t + 1] - self.offsets[t])))
            for candidate, signals in zip(samples, block, strict=True):
                prepare_trial(
                    candidate, self.offsets[t], self.offsets[t + 1], self._half[t], self._reach,
                    self._taps[t], self._rate[t], self._left, self._right, self._share,
                    self._column, self._is_rate, work, signals,
                )  # fmt: skip
            out.append(block)
        return tuple(out)
