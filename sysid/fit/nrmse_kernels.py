"""Compiled part of the population cost: one trial's linear preparation, and the NRMSE of every candidate.

Shapes: samples (P, n_total, n_columns); offsets, window (T + 1,) first row of each trial with and without
its margins; half, rate, taps (T, ...) filter per trial, taps from the centre outwards; left, right, share
(n_total,) neighbours and weight that bridge gaps; column, is_rate (C,) where each channel comes from;
measured, valid (rows of all windows, C); denominators (T, C); weights (C,).
"""

import numpy as np
from numba import njit

# A trial that failed at its first sample scores twice this NRMSE, one that failed at its last sample
# just this: far above any useful fit (a constant signal scores 1), and graded for the search to climb.
FAILED_NRMSE = 10.0


@njit(cache=True, error_model="numpy")
def prepare_trial(
    samples, start, end, half, reach, taps, rate, left, right, share, column, is_rate, work, out
):  # fmt: skip
    """Interpolate gaps, filter and differentiate rows start:end of one candidate into out (n_window, C)."""
    filled, filtered = work[0], work[1]
    n_window = end - start - 2 * (half + reach)
    done = -1
    for c in range(column.size):
        if column[c] != done:
            done = column[c]
            for i in range(end - start):
                row = start + i
                if left[row] == row:
                    filled[i] = samples[row, done]
                else:
                    low = samples[left[row], done]
                    filled[i] = low + share[row] * (samples[right[row], done] - low)
            # Tap by tap over the whole window: the inner loop has no chain of sums and vectorizes.
            n_out = n_window + 2 * reach
            middle = filled[half : half + n_out]
            for j in range(n_out):
                filtered[j] = taps[0] * middle[j]
            for k in range(1, half + 1):
                tap = taps[k]
                before = filled[half - k : half - k + n_out]
                after = filled[half + k : half + k + n_out]
                for j in range(n_out):
                    filtered[j] += tap * (before[j] + after[j])
        if is_rate[c]:
            for i in range(n_window):
                out[i, c] = (filtered[i + reach + 1] - filtered[i + reach - 1]) * rate / 2.0
        else:
            for i in range(n_window):
                out[i, c] = filtered[i + reach]


@njit(cache=True, error_model="numpy", nogil=True)
def score_population(
    first, last, samples, reached, offsets, window, half, reach, taps, rate, left, right, share, column,
    is_rate, measured, valid, denominators, weights, by_channel, failed,
):  # fmt: skip
    """Fill by_channel (P, T, C) and failed (P, T) of candidates first:last; see `FilteredNrmse`."""
    n_trials = offsets.size - 1
    n_channels = column.size
    longest = 0
    for t in range(n_trials):
        longest = max(longest, offsets[t + 1] - offsets[t])
    work = np.empty((2, longest))
    signals = np.empty((longest, n_channels))
    for p in range(first, last):
        for t in range(n_trials):
            complete = reached[p, t] >= 1.0
            progress = min(max(reached[p, t], 0.0), 1.0)
            if complete:
                prepare_trial(
                    samples[p], offsets[t], offsets[t + 1], half[t], reach, taps[t], rate[t],
                    left, right, share, column, is_rate, work, signals,
                )  # fmt: skip
                for c in range(n_channels):
                    total = 0.0
                    count = 0
                    for i in range(window[t + 1] - window[t]):
                        if valid[window[t] + i, c]:
                            error = signals[i, c] - measured[window[t] + i, c]
                            total += error * error
                            count += 1
                    score = np.sqrt(total / count) / denominators[t, c]
                    by_channel[p, t, c] = score
                    if weights[c] > 0.0 and not np.isfinite(score):
                        complete = False
            if not complete:
                failed[p, t] = True
                n_rows = offsets[t + 1] - offsets[t]
                for i in range(n_rows):
                    finite = True
                    for c in range(n_channels):
                        finite = finite and np.isfinite(samples[p, offsets[t] + i, column[c]])
                    if not finite:
                        progress = min(progress, i / n_rows)
                        break
                # NaN would slip through min and max: a share that is not a number is no progress.
                if not np.isfinite(progress):
                    progress = 0.0
                for c in range(n_channels):
                    by_channel[p, t, c] = FAILED_NRMSE * (2.0 - progress)
