"""Clocks of logs: rows in order, declared rates, jitter in words."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sysid.errors import LogError, SegmentError
from sysid.journal import Finding, note
from sysid.loaders.options import LogOptions, is_positive
from sysid.loaders.table import Numbers
from sysid.recording import BoolArray, FloatArray

# Largest number of samples that a logger leaves from an earlier run at the start of a file.
_STALE_ROWS = 2
# Largest time by which a row is only late, and no other run of the clock [median steps]; the largest share of
# rows that are late or repeat a time [1]; the largest number of runs in one file.
_LATEST, _MOST_DOUBTFUL, _MOST_SEGMENTS = 4.0, 0.2, 20
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
    segmented: bool = False,
    coarse: str = EXPORT_FINER,
) -> tuple[FloatArray, list[Finding]]:
    """Return strictly increasing times [s] and notes; `numbers` keeps only the rows they belong to.

    A row without a time is left out; of rows that repeat one time the last is kept. `factor` turns the
    column `time_column` into seconds. With `stale_start`, one or two rows at the start whose time is beyond
    the next are dropped. A few rows that come late by some sample periods are left out, because a logger
    writes them out of order. A time that falls farther is a LogError, as is a log without times. The
    `options` of a format that takes ``time_back`` may say ``"drop"``, which leaves out all late rows, or
    ``"refuse"``, which leaves out none. Where a `segmented` format has a clock that starts again, only the
    rows of the declared ``segment`` stay, and without one a SegmentError counts the segments. `coarse` is the
    advice where a clock repeats its times.
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
    time = _rising(path, numbers, time, options, segmented, notes)
    repeats: BoolArray = np.append(False, np.diff(time) == 0)
    if repeats.any():
        if repeats.sum() > _MOST_DOUBTFUL * time.size and time.size > 10:
            raise LogError(
                f"{path}, {numbers.row_word} {numbers.lines[np.argmax(repeats)]}: {int(repeats.sum())} of "
                f"{time.size} rows repeat the time of the row before, so the clock is too coarse; {coarse}"
            ).asking(**({"rate": _rate_of(time)} if coarse == DECLARE_RATE else {}))
        sentence = numbers.counted("rows that repeat the time of the row before", repeats)
        notes.append(note("repeated-times", f"{sentence}; the last of each was kept"))
        last: BoolArray = np.append(~repeats[1:], True)
        numbers.keep(last)
        time = time[last]
    return time, notes


def _rate_of(time: FloatArray) -> str | None:
    return f"{(time.size - 1) / np.ptp(time):.4g}" if np.ptp(time) > 0 else None


def _rising(
    path: str,
    numbers: Numbers,
    time: FloatArray,
    options: LogOptions | None,
    segmented: bool,
    notes: list[Finding],
) -> FloatArray:
    """Return the times [s] that do not fall below an earlier one, of the chosen segment; see `order_rows`."""
    steps = np.diff(time)
    rises, stated = steps[steps > 0], None if options is None else options.time_back
    period = float(np.median(rises)) if rises.size else 0.0
    if segmented and options is not None and (options.segment is not None or stated is None):
        begins = np.flatnonzero(np.append(True, steps < -_LATEST * period))
        if options.segment is not None or (rises.size and 1 < begins.size <= _MOST_SEGMENTS):
            ends = np.append(begins[1:], time.size)
            spans = [f"{time[a]:.6g} to {time[b - 1]:.6g} s" for a, b in zip(begins, ends, strict=True)]
            lines = ", ".join(map(str, numbers.lines[begins[1:]]))
            why = f"its clock starts again in {numbers.row_word} {lines} ({', '.join(spans)})"
            number, said = chosen_segment(path, options.segment, begins.size, why)
            notes += said
            begin, end = begins[number], ends[number]
            numbers.keep((np.arange(time.size) >= begin) & (np.arange(time.size) < end))
            time = time[begin:end]
    late = np.maximum.accumulate(time) - time
    if not late.any():
        return time
    few = np.count_nonzero(late) <= _MOST_DOUBTFUL * time.size and late.max() <= _LATEST * period
    if stated == "refuse" or (stated is None and not few):
        row = int(np.argmax(np.diff(time) < 0))
        raise LogError(
            f"{path}, {numbers.row_word} {numbers.lines[row + 1]}: time goes back from "
            f"{time[row]:.12g} s to {time[row + 1]:.12g} s; "
            "split the log there" + (' or set time_back = "drop"' if options else "")
        )
    sentence = numbers.counted("rows whose time goes back, left out", late > 0)
    by = f", by up to {late.max() / period:.2g} sample periods" if period else ""
    notes.append(note("rows-out-of-order", f"{sentence}{by}"))
    numbers.keep(late == 0)
    return time[late == 0]


def chosen_segment(path: str, segment: int | None, count: int, why: str) -> tuple[int, list[Finding]]:
    """Return the place from 0 of the declared segment of a log of `count`, and a note of it.

    Several segments, of which none is declared, are a SegmentError.
    """
    if segment is None and count > 1:
        choose = f"choose one with segment = 1 to {count}"
        raise SegmentError(f"{path}: has {count} segments: {why}; {choose}", count)
    number = 1 if segment is None else segment
    if isinstance(number, bool) or not isinstance(number, int) or not 1 <= number <= count:
        raise LogError(f"{path}: segment = {segment!r}; the file has segments 1 to {count}")
    return number - 1, [note("segment", f"segment {number} of {count}: {why}")] if count > 1 else []


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
        return order_rows(path, numbers, time_column, factor, options=options, segmented=True, coarse=coarse)
    _, notes = order_rows(path, numbers, frame_column, 1.0, options=options, segmented=True)
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


def row_clock(
    path: str, numbers: Numbers, column: int | None, factor: float, rate: float | None, options: LogOptions
) -> tuple[FloatArray, list[Finding]]:
    """Return the times [s] of the rows of a table by a declared rate [Hz], else by their column, and notes.

    The `column` is None in a table without times, which has a rate; `factor` as for `order_rows`.
    """
    if rate is not None or column is None:
        assert rate is not None
        stated = None if column is None else numbers.columns[column] * factor
        time = rate_clock(path, rate, numbers.lines.size, stated)
        return time, [note("time-from-rate", f"time rebuilt from the declared rate of {rate:g} Hz")]
    time, notes = order_rows(
        path, numbers, column, factor, options=options, segmented=True, coarse=DECLARE_RATE
    )
    return time, [*notes, *jitter_note(time)]


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
