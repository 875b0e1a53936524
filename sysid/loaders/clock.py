"""Clocks of logs: rows in order, declared rates, jitter in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.options import LogOptions, is_positive
from sysid.loaders.table import Numbers
from sysid.recording import BoolArray, FloatArray

# Largest number of samples that a logger leaves from an earlier run at the start of a file.
_STALE_ROWS = 2
# Advice about times that repeat: for every format, and for a format that takes a rate.
EXPORT_FINER = "export the log again with finer times"
DECLARE_RATE = "declare the sample rate with rate = ..."
# Fewest rows for a line through times and frame numbers, and largest median distance of times from it [s].
_FEWEST_FRAMES, _LONGEST_DELAY = 10, 0.1


def known_rate(rate: object) -> float:
    """Return a sample rate [Hz] that a file states; ValueError when it is not a positive, finite number."""
    if not is_positive(rate):
        raise ValueError(f"{rate!r} is no sample rate")
    return float(rate)  # type: ignore[arg-type]


def declared_rate(path: str, rate: object) -> float | None:
    """Return a declared sample rate [Hz], if any; LogError when it is not a positive, finite number."""
    if rate is not None and not is_positive(rate):
        raise LogError(
            f"{path}: rate = {rate!r} is no sample rate; expected samples per second, e.g. rate = 10000"
        )
    return None if rate is None else known_rate(rate)


def order_rows(
    path: str,
    numbers: Numbers,
    time_column: int,
    factor: float,
    *,
    options: LogOptions | None = None,
    stale_start: bool = False,
    coarse: str = EXPORT_FINER,
) -> tuple[FloatArray, list[Finding]]:
    """Return strictly increasing times [s] and notes; `numbers` keeps only the rows they belong to.

    A row without a time is left out; of rows that repeat one time the last is kept. `factor` turns the
    column `time_column` into seconds. With `stale_start`, one or two rows at the start whose time is beyond
    the next are dropped. A falling time is a LogError, as is a log without times; where the `options` of a
    format that takes ``time_back`` say ``"drop"``, rows that do not pass the latest time are left out.
    `coarse` is the advice where a clock repeats its times.
    """
    notes: list[Finding] = []
    timed = np.isfinite(numbers.columns[time_column])
    if not timed.all():
        sentence = numbers.counted("rows without a time, left out", ~timed)
        notes.append(note("rows-without-time", sentence))
        numbers.keep(timed)
    if not numbers.lines.size:
        raise LogError(f"{path}: no row has a time; the log is empty")
    time = numbers.columns[time_column] * factor

    # The clock falls once behind the rows of an earlier run and then rises.
    most = min(_STALE_ROWS, time.size - 1) if stale_start else 0
    falls = [k for k in range(1, most + 1) if time[k] < time[k - 1]]
    stale = next((k for k in falls if np.all(np.diff(time[k : k + 5]) >= 0)), 0)
    if stale:
        notes.append(
            note("stale-rows", f"stale rows at the start, left out: {stale} (at {time[stale - 1]:.6g} s)")
        )
        numbers.keep(np.arange(time.size) >= stale)
        time = time[stale:]
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    if back.size and (options is None or options.time_back != "drop"):
        row = int(back[0])
        raise LogError(
            f"{path}, {numbers.row_word} {numbers.lines[row + 1]}: time goes back from "
            f"{time[row]:.12g} s to {time[row + 1]:.12g} s; "
            "split the log there" + (' or set time_back = "drop"' if options else "")
        )
    if back.size:
        later = np.append(True, time[1:] > np.maximum.accumulate(time)[:-1])
        sentence = f"rows whose time does not pass the latest, left out: {int((~later).sum())}"
        notes.append(note("rows-out-of-order", sentence))
        numbers.keep(later)
        return time[later], notes
    repeats: BoolArray = np.append(False, steps == 0)
    if repeats.any():
        if repeats.sum() > 0.2 * time.size and time.size > 10:
            raise LogError(
                f"{path}, {numbers.row_word} {numbers.lines[np.argmax(repeats)]}: {int(repeats.sum())} of "
                f"{time.size} rows repeat the time of the row before, so the clock is too coarse; {coarse}"
            )
        sentence = numbers.counted("rows that repeat the time of the row before", repeats)
        notes.append(note("repeated-times", f"{sentence}; the last of each was kept"))
        last: BoolArray = np.append(~repeats[1:], True)
        numbers.keep(last)
        time = time[last]
    return time, notes


def stamp_clock(
    path: str,
    numbers: Numbers,
    time_column: int,
    factor: float,
    options: LogOptions,
    frame_column: int | None,
    *,
    coarse: str,
    other_clock: str = "time",
) -> tuple[FloatArray, list[Finding]]:
    """Return the written times [s] of poses, or times rebuilt from a column of frame numbers, and notes.

    Times are rebuilt where the written ones are times of arrival. They lie on the straight line that fits the
    written times best, so they have the log's rate, and a constant delay stays in it. `numbers`, `factor` and
    `coarse` as for `order_rows`; `other_clock` is what to choose where frames and times do not belong
    together (a LogError).
    """
    if frame_column is None:
        return order_rows(path, numbers, time_column, factor, options=options, coarse=coarse)
    _, notes = order_rows(path, numbers, frame_column, 1.0, options=options)
    frames, written = numbers.columns[frame_column], numbers.columns[time_column] * factor
    seen = np.isfinite(written)
    if seen.sum() < _FEWEST_FRAMES:
        raise LogError(f"{path}: {int(seen.sum())} rows have a frame number and a time; too few for a clock")
    first, start = frames[seen][0], written[seen][0]
    period, offset = np.polyfit(frames[seen] - first, written[seen] - start, 1)
    time: FloatArray = start + offset + period * (frames - first)
    off = np.where(seen, np.abs(written - time), 0.0)
    # A network delays most frames by milliseconds and a few by some tenths of a second.
    if period <= 0 or float(np.median(off[seen])) > _LONGEST_DELAY:
        row = int(off.argmax())
        raise LogError(
            f"{path}, {numbers.row_word} {numbers.lines[row]}: frame {frames[row]:.0f} should be at "
            f"{time[row]:.6g} s but the time column says {written[row]:.6g} s; the two columns do not belong "
            f'together, so choose clock = "{other_clock}"'
        )
    sentence = (
        f"time rebuilt from frame numbers at {1 / period:.6g} Hz: the written times lie "
        f"{1e3 * float(np.sqrt(np.mean(off[seen] ** 2))):.2g} ms rms and up to "
        f"{1e3 * float(off.max()):.3g} ms beside it"
    )
    notes.append(note("time-from-frames", sentence))
    return time, notes


def counted_clock(
    path: str,
    numbers: Numbers,
    columns: tuple[int, int],
    first: float,
    rates: Sequence[float],
    rounding: float,
    advice: str,
    *,
    check: bool = True,
) -> tuple[FloatArray, Finding]:
    """Return times [s], frame numbers over the first rate that the written times fit, and a note.

    `columns` are the columns of frame numbers (from `first`) and of times. Times are printed to `rounding`
    [s] and may begin later by a constant. With `check`, times that fit no rate are a LogError with `advice`.
    """
    counted, written = (numbers.columns[column] for column in columns)
    seen = np.isfinite(written)
    refusal = ""
    for rate in rates:
        time = (counted - first) / rate
        offset = float(np.median((written - time)[seen])) if seen.any() else 0.0
        offset = 0.0 if abs(offset) <= rounding else offset
        error = np.where(seen, np.abs(written - time - offset), 0.0)
        if not check or error.max() <= rounding:
            later = f", beginning {offset:.6g} s later" if offset else ""
            sentence = f"time rebuilt from frame numbers at {rate:g} Hz{later}"
            return time + offset, note("time-from-frames", sentence)
        row = int(error.argmax())
        refusal = refusal or (
            f"{path}, line {numbers.lines[row]}: frame {counted[row]:.0f} at {rate:g} Hz is at "
            f"{(time + offset)[row]:.6g} s but the Time column says {written[row]:.6g} s; {advice}"
        )
    raise LogError(refusal)


def rate_clock(path: str, rate: float, count: int, stated: FloatArray | None = None) -> FloatArray:
    """Return the times [s] of `count` samples at a declared rate [Hz].

    `stated` (count,) are the log's times [s], too coarse or too unsteady to use: they give the start, and a
    span that contradicts the rate is a LogError.
    """
    time: NDArray[np.float64] = np.arange(count, dtype=np.float64) / rate
    if stated is None:
        return time
    known = np.flatnonzero(np.isfinite(stated))
    if known.size > 1:
        span = float(stated[known[-1]] - stated[known[0]])
        declared = float(time[known[-1]] - time[known[0]])
        # 1 % tells a wrong rate from the rounding of coarse stamps (which is at most one stamp at each end).
        coarse = 2.0 * float(np.max(np.abs(np.diff(stated[known]))))
        if abs(span - declared) > 0.01 * declared + coarse:
            raise LogError(
                f"{path}: rate = {rate:g} makes the log {declared:.6g} s long but its time column spans "
                f"{span:.6g} s; correct the rate or leave it out"
            )
    return time + float(stated[known[0]]) if known.size else time


def jitter_note(time: FloatArray) -> list[Finding]:
    """Return a note when the steps of a clock (n,) [s] vary by more than a tenth of their median."""
    if time.size < 3:
        return []
    steps = np.diff(time)
    median = float(np.median(steps))
    if float(np.percentile(np.abs(steps - median), 90)) <= 0.1 * median:
        return []
    least, middle, most = (1e3 * float(step) for step in (steps.min(), median, steps.max()))
    sentence = (
        f"time steps vary from {least:.3g} to {most:.3g} ms (median {middle:.3g} ms): "
        "they look like times of arrival and are kept as recorded"
    )
    return [note("unsteady-clock", sentence)]


def began_note(what: str, when: str) -> list[Finding]:
    """Return a note of when a recording began, where the file states it."""
    sentence = f"{what} began at {when} by the {what} computer's clock"
    return [note("recording-began", sentence)] if when else []
