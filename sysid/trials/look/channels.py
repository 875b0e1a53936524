"""One channel in numbers: range, rate, jitter, holes, blanks, repeats, saturation."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sysid.filters import runs
from sysid.recording import Channel, FloatArray

# A step this many times the median is a hole in the clock.
_HOLE = 2.5
# A sensor at its limit repeats its largest value: at least this many samples in a row, and this share of all.
_FLAT_RUN, _FLAT_SHARE = 5, 0.005


@dataclass(frozen=True)
class ChannelReport:
    """Numbers of one channel.

    Parameters
    ----------
    samples, blank
        Rows on its clock, and the share of them without a value [1].
    lowest, highest
        Of all components [unit]; NaN without a value.
    rate, jitter
        Median sample rate [Hz], NaN below two samples; 90th percentile of the deviation of a step from the
        median one, as a share of it [1].
    holes, longest_hole
        Steps longer than 2.5 times the median; the longest step of the clock [s].
    longest_blank
        The longest time without a value, before the first and behind the last one too [s]. Rate, jitter,
        longest_hole and longest_blank are NaN where rows have no time.
    repeated, saturated
        Share of values equal to the one before, and in runs of five or more at either extreme [1].
    """

    name: str
    unit: str
    samples: int
    blank: float
    lowest: float
    highest: float
    rate: float
    jitter: float
    holes: int
    longest_hole: float
    longest_blank: float
    repeated: float
    saturated: float


def _saturated(values: FloatArray) -> float:
    """Return the share of samples that are stuck at a limit other than zero."""
    low, high = float(values.min()), float(values.max())
    if values.size < 10 * _FLAT_RUN or low == high:
        return 0.0
    lengths = [stop - start for limit in (low, high) if limit != 0.0 for start, stop in runs(values == limit)]
    stuck = sum(length for length in lengths if length >= _FLAT_RUN)
    # Half of the samples at one value is a plateau or a probe that is off, not a sensor at its limit.
    share = stuck / values.size
    return share if _FLAT_SHARE <= share <= 0.5 else 0.0


def _longest_blank(time: FloatArray, valid: NDArray[np.bool_]) -> float:
    """Return the longest time without a value [s]: between two values, or from one to an end of the log."""
    if valid.all():
        return 0.0
    known = np.flatnonzero(valid)
    if not known.size:
        return float(time[-1] - time[0])
    between = np.diff(known) > 1
    ends = [float(time[known[0]] - time[0]), float(time[-1] - time[known[-1]])]
    return max(*ends, float(np.diff(time[known])[between].max(initial=0.0)))


def inspect_channel(channel: Channel, clock: bool = True) -> ChannelReport:
    """Return the numbers of a channel; without a clock all is NaN that a clock would tell."""
    time, valid = channel.time, channel.valid
    steps = np.diff(time)
    median = float(np.median(steps)) if steps.size else float("nan")
    # Zero where steps are equal as far as times of this size can show.
    rounding = 4.0 * float(np.spacing(np.abs(time).max(initial=1.0)))
    deviation = float(np.percentile(np.abs(steps - median), 90)) if steps.size else float("nan")
    known = channel.values[valid]
    repeats = np.diff(known, axis=0) == 0
    equal = repeats if repeats.ndim == 1 else repeats.all(axis=1)
    discrete = channel.unit in ("us", "dshot", "rad/s") or channel.name in ("command", "log_time")
    report = ChannelReport(
        channel.name,
        channel.unit,
        int(time.size),
        float(1.0 - valid.mean()) if time.size else 0.0,
        float(known.min()) if known.size else float("nan"),
        float(known.max()) if known.size else float("nan"),
        channel.rate,
        0.0 if deviation <= rounding else deviation / median,
        int(np.count_nonzero(steps > _HOLE * median)) if steps.size else 0,
        float(steps.max()) if steps.size else 0.0,
        _longest_blank(time, valid),
        float(equal.mean()) if equal.size else 0.0,
        0.0 if discrete or known.ndim > 1 or not known.size else _saturated(known),
    )
    if clock:
        return report
    unknown = float("nan")
    return replace(report, rate=unknown, jitter=unknown, holes=0, longest_hole=unknown, longest_blank=unknown)
