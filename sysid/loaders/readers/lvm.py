"""LabVIEW text measurements (LVM): segments of channels with one, several or no columns of times.

Layout: ``LabVIEW Measurement``, a file header, then a header for every segment (``Channels``,
``Samples``, units, ``X0``, ``Delta_X``), the row ``X_Value name ... Comment`` and the samples. Times are the
written ones where there are any (``X_Columns One`` or ``Multi``), else X0 + i · Delta_X; both are seconds
unless ``X_Unit_Label`` states another unit of time, and an ``X_Dimension`` that is no time is refused. A
``Delta_X`` of a few digits is noted, because the clock is then no better than them. The decimal mark is the
declared one, else the one that the samples show. Comments are text and are left out.

The body is read as every other text log is, so that a cell that is no number is named with its line; the
reader that the field uses (lvm_read) turns such cells into gaps and loads pickles that lie beside the file.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.clock import began_note, chosen_segment
from sysid.loaders.columns import factor_or_none
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.signal_log import (
    SIGNAL_OPTIONS,
    RawSignals,
    Signal,
    signal_format,
    unique_names,
    written_unit,
)
from sysid.loaders.source import Source, Text, read_text
from sysid.loaders.table import TableHead, promised_note, read_numbers
from sysid.types import FloatArray

_FIRST = "LabVIEW Measurement"
_END = "***End_of_Header***"
_SEPARATORS = {"tab": "\t", "comma": ",", "": "\t"}
_KEYS = frozenset(
    {"channels", "samples", "date", "time", "x_dimension", "x0", "delta_x", "x_unit_label", "y_unit_label",
     "y_dimension", "notes", "test_name", "test_numbers", "test_series", "uut_s/n", "uut_name", "uut_m/n",
     "model_number", "serial_number", "operator", "description", "project"}
)  # fmt: skip
_BLANK = re.compile(rb"\n[ \t,]*(?=\n)")
# Longest header of a file or a segment [lines].
_HEADER_LINES = 100
# Largest number of significant digits with which a written time step is exact (0.001). A step with more
# digits and fewer than `_DIGITS` is rounded (0.000977 for 1/1024).
_EXACT = 2
# Digits of the largest count of samples that a header may state.
_MOST_DIGITS = 18
# Least number of significant digits with which a written time step is precise enough.
_DIGITS = 5


def _recognize(source: Source) -> int:
    return CERTAIN if source.head_lines and source.head_lines[0].startswith(_FIRST) else NO


@dataclass(frozen=True)
class _Segment:
    """Header of one segment; `rows` is where its samples begin and end in the file."""

    line: int
    names: list[str]
    header: dict[str, list[str]]
    rows: tuple[int, int]

    def stated(self, key: str, column: int) -> str:
        """Return what the header row `key` states for a column.

        With several columns of times a row has one cell per column, else one per channel behind X_Value.
        """
        place = column - (0 if self.names.count("X_Value") > 1 else 1)
        cells = self.header.get(key, [])
        return cells[place] if 0 <= place < len(cells) else ""


def _segments(text: Text) -> tuple[dict[str, str], str, list[_Segment]]:
    """Return the file header, the delimiter and the segments."""
    settings: dict[str, str] = {}
    ends = (0, 0)
    for number, offset, line in text.lines(_HEADER_LINES):
        if line.startswith(_END):
            ends = (offset, number)
            break
        key, _, value = line.partition("\t") if "\t" in line else line.partition(",")
        settings[key.strip().casefold()] = value.strip()
    else:
        raise LogError(f"{text.path}: no line {_END} in the first {_HEADER_LINES} lines; the header is cut")
    separator = settings.get("separator", "Tab").strip().casefold()
    if separator not in _SEPARATORS:
        raise LogError(f'{text.path}: the header\'s Separator is {separator!r}; expected "Tab" or "Comma"')
    delimiter = _SEPARATORS[separator]
    segments: list[_Segment] = []
    while True:
        header: dict[str, list[str]] = {}
        names: list[str] = []
        for number, offset, line in text.lines(_HEADER_LINES, *ends):
            cells = [cell.strip() for cell in line.split(delimiter)]
            if cells[0] == "X_Value":
                names, ends = cells, (offset, number)
                break
            if line.strip() and cells[0].casefold() not in _KEYS and not cells[0].startswith(_END):
                raise LogError(
                    f"{text.path}, line {number}: {line.strip()[:40]!r} is neither a sample nor part of the "
                    "header of a segment; remove the blank line before it, or the line"
                )
            header[cells[0].casefold()] = cells[1:]
        if not names:
            return settings, delimiter, segments
        begin, line_of_names = ends
        blank = _BLANK.search(text.data, begin - 1)
        end = len(text.data) if blank is None else blank.start() + 1
        segments.append(_Segment(line_of_names, names, header, (begin, end)))
        ends = (end, line_of_names + text.data.count(b"\n", begin, end))


def _number(path: str, segment: _Segment, what: str, column: int) -> float:
    cell = segment.stated(what.casefold(), column)
    try:
        return float(cell.replace(",", ".")) if cell else 0.0
    except ValueError:
        raise LogError(
            f"{path}: the header above line {segment.line} states {what} as {cell[:40]!r}; expected a number"
        ) from None


def _segment_signals(
    text: Text, segment: _Segment, delimiter: str, decimal: str | None, rated: bool, notes: list[Finding]
) -> list[Signal]:
    """Return the signals of one segment; `text` ends with its rows.

    With `rated` the user has declared the clock, and the header's is ignored.
    """
    path = text.path
    names = segment.names.copy()
    while names and not names[-1]:
        names.pop()
    text_columns = {i for i, name in enumerate(names) if name == "Comment" and i == len(names) - 1}
    times = [i for i, name in enumerate(names) if name == "X_Value"]
    wanted = [i for i, name in enumerate(names) if name and i not in times and i not in text_columns]
    if not wanted:
        raise LogError(f"{path}, line {segment.line}: names no channel after X_Value; export the file again")
    head = TableHead(tuple(names), delimiter, segment.line, segment.rows[0])
    numbers = read_numbers(
        text, head, [*times, *wanted], least=max(wanted) + 1, surplus=True,
        free_text=max(text_columns, default=None), decimal=decimal,
    )  # fmt: skip
    labels = dict(zip(wanted, unique_names([names[i] for i in wanted]), strict=True))
    signals = []
    clocks = {place: numbers.columns[place] for place in times if np.isfinite(numbers.columns[place]).any()}
    scaled: dict[tuple[int | None, float], FloatArray] = {}  # one array for all signals that share it
    for column in wanted:
        values = numbers.columns[column]
        if np.isnan(values).all():
            continue
        clock_column = max((place for place in times if place < column), default=None)
        place = clock_column if len(times) > 1 and clock_column is not None else column
        label = labels[column]
        seconds = 1.0 if rated else _seconds(path, segment, label, place)
        step = seconds * _number(path, segment, "Delta_X", place)
        start = seconds * _number(path, segment, "X0", place)
        rate = 1.0 / step if step > 0 else None
        unit = segment.stated("y_unit_label", place)
        time = None if clock_column is None else clocks.get(clock_column)
        if time is not None and seconds != 1.0:
            time = scaled.setdefault((clock_column, seconds), time * seconds)
        signals.append(
            Signal(f"/{label}", written_unit(unit), partial(np.asarray, values), rate, start, time, label)
        )
    notes += numbers.notes
    counts = [
        cell
        for cell in segment.header.get("samples", [])
        if cell.isascii() and cell.isdigit() and len(cell) < _MOST_DIGITS
    ]
    notes += promised_note("Samples", max(map(int, counts), default=0), numbers.lines.size)
    steps = {cell: re.split("[eE]", cell)[0] for cell in segment.header.get("delta_x", [])}
    digits = {cell: len(re.sub("[.,]", "", step.lstrip("+-0.,")).rstrip("0")) for cell, step in steps.items()}
    rounded = sorted(cell for cell, count in digits.items() if _EXACT < count < _DIGITS)
    if rounded and not clocks:
        sentence = (
            f"Delta_X is written as {', '.join(rounded)}: the clock is no better than these digits; "
            "declare the true rate if it is known"
        )
        notes.append(note("rounded-clock-step", sentence))
    return signals


def _seconds(path: str, segment: _Segment, label: str, place: int) -> float:
    """Return the factor from the X axis of a channel to seconds.

    Without ``X_Dimension`` the axis is time, and without ``X_Unit_Label`` it is in seconds: so the format
    defines it.
    """
    axis = segment.stated("x_dimension", place) or "Time"
    unit = segment.stated("x_unit_label", place) or "s"
    factor = factor_or_none(str(written_unit(unit)), "s")
    if axis.casefold() != "time" or factor is None:
        raise LogError(
            f"{path}: the header above line {segment.line} gives {label!r} over {axis} in {unit}, not over "
            "time; export the signal itself, or declare its rate"
        )
    return factor


@contextmanager
def _parse(source: Source, options: BenchOptions) -> Iterator[RawSignals]:
    path = source.path
    if not _recognize(source):
        raise LogError(f"{path}: not an LVM file (its first line is not {_FIRST!r}); check the format")
    text = read_text(source)
    settings, delimiter, segments = _segments(text)
    if not segments:
        raise LogError(f"{path}: no row X_Value with the names of channels; the log is empty")
    place, notes = chosen_segment(path, options.segment, len(segments), "each is on another clock")
    chosen = segments[place]
    decimal = settings.get("decimal_separator") or None
    if decimal not in (None, ".", ","):
        raise LogError(f"{path}: the header's Decimal_Separator is {decimal!r}; expected . or ,")
    signals = _segment_signals(
        text.up_to(chosen.rows[1]), chosen, delimiter, decimal, options.rate is not None, notes
    )
    del text  # the file's bytes are not needed any more
    began = " ".join(settings.get(key, "") for key in ("date", "time")).strip()
    notes += began_note("recording", began)
    yield RawSignals(signals, "LabVIEW", measured=False, notes=notes)


FORMAT = signal_format(
    "lvm", "LabVIEW text measurement LVM (channels by name)", _recognize, _parse,
    SIGNAL_OPTIONS | {"segment": ()},
)  # fmt: skip
