"""Rows of numbers as bytes: where they lie, and two exact ways of reading them.

A clean numeric body is parsed by the C engine of pandas, some megabytes at a time so that beside the file and
its numbers hardly anything is in memory; whatever that engine will not take (quotes, surplus cells, a cell
that is no number) is read line by line, where the first cell that is not a number is named with its line and
its column. Both ways give the same numbers, to the last bit.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import LogError
from sysid.loaders.text import SPACES, shortened, split_line
from sysid.recording import FloatArray

_MISSING = frozenset({"", "nan", "-nan", "+nan"})
# Bytes that are searched, or parsed, at once: what is made of them is small beside the numbers. Of a small
# table the pieces are smaller, as the engine holds several times a piece.
_SEARCHED, _PARSED = 1 << 18, (1 << 18, 1 << 20)
# A comma that may part thousands.
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+")
# Rows that are parted at once.
_BATCH = 4096
# More blank cells than this behind the last column of a row is no trailing delimiter.
_MOST_TRAILING = 64


def parse_number(cell: str, decimal: str = ".") -> float:
    """Return the number in a cell, NaN for a blank cell or a written nan; ValueError for anything else."""
    text = cell.strip().strip('"').strip()
    if text.lower() in _MISSING:
        return math.nan
    if decimal != ".":
        if "." in text:
            raise ValueError(cell)
        text = text.replace(decimal, ".", 1)
    if "_" in text or not text.isascii():
        raise ValueError(cell)
    return float(text)


def _quick_number(cell: str) -> float:
    """Return `parse_number` of a cell, most of them at a third of the time."""
    if cell.isascii() and "_" not in cell:
        try:
            return float(cell)
        except ValueError:
            pass
    return parse_number(cell)


@dataclass
class Body:
    """The lines of a table that are rows: where they lie in `data`, and how many cells each seems to have."""

    data: bytes
    delimiter: str
    lines: NDArray[np.int64]
    begins: NDArray[np.int64]
    lengths: NDArray[np.int64]
    fields: NDArray[np.int64]

    def cells(self, row: int) -> list[str]:
        """Return the cells of a row as text."""
        begin = int(self.begins[row])
        line = self.data[begin : begin + int(self.lengths[row])].decode("utf-8", errors="replace")
        return split_line(line, self.delimiter)

    def all_cells(self) -> Iterator[list[str]]:
        """Yield the cells of every row."""
        for start in range(0, self.lines.size, _BATCH):
            rows = range(start, min(start + _BATCH, self.lines.size))
            spans = [(int(self.begins[row]), int(self.lengths[row])) for row in rows]
            lines = [self.data[a : a + size].decode("utf-8", errors="replace") for a, size in spans]
            parted: list[list[str]] = []
            if self.delimiter != SPACES:
                try:
                    parted = list(csv.reader(lines, delimiter=self.delimiter))
                except csv.Error:
                    parted = []
            # A quote that is left open joins lines: then each is parted by itself, where it cannot.
            yield from parted if len(parted) == len(lines) else (split_line(x, self.delimiter) for x in lines)

    def part(self, rows: slice | NDArray[np.bool_]) -> Body:
        """Return some of the rows; `data` is shared."""
        chosen = (self.lines[rows], self.begins[rows], self.lengths[rows], self.fields[rows])
        return Body(self.data, self.delimiter, *chosen)

    def parts(self) -> Iterator[slice]:
        """Yield the rows in runs of some megabytes."""
        start = 0
        piece = min(max(int(self.begins[-1] - self.begins[0]) // 32, _PARSED[0]), _PARSED[1])
        while start < self.lines.size:
            stop = int(np.searchsorted(self.begins, self.begins[start] + piece))
            yield slice(start, max(stop, start + 1))
            start = max(stop, start + 1)

    def joined(self) -> bytes:
        """Return the rows as text, without what stands between them in `data`."""
        stops = self.begins + self.lengths
        edges = np.flatnonzero(self.begins[1:] != stops[:-1] + 1) + 1
        firsts, lasts = np.append(0, edges), np.append(edges, stops.size) - 1
        if firsts.size == 1:
            return self.data[self.begins[0] : stops[-1]]
        view = memoryview(self.data)
        return b"\n".join(view[self.begins[a] : stops[b]] for a, b in zip(firsts, lasts, strict=True))


def body_end(data: bytes, start: int, delimiter: str) -> tuple[int, bool]:
    """Return where the last row ends, comments and blank lines after it left out, and if it has a "
    "line end."""
    # A row of nothing but tabs is a row where tabs part the cells.
    blanks = b" \r\v\f" if delimiter == "\t" else b" \t\r\v\f"
    end = len(data)
    while end > start:
        while end > start and data[end - 1] == 10:
            end -= 1
        begin = max(data.rfind(b"\n", start, end) + 1, start)
        line = data[begin:end]
        if line.strip(blanks) and not line.lstrip().startswith(b"#"):
            break
        end = begin
    return end, end < len(data)


def measure(data: bytes, start: int, end: int, delimiter: str, first_line: int) -> Body:
    """Return the lines of `data` from `start` to `end`; blank ones and comments are not among them."""
    body = np.frombuffer(data, dtype=np.uint8, count=end - start, offset=start)
    ends, counts, carried, in_word = [], [], 0, False
    for begin in range(0, body.size, _SEARCHED):
        part = body[begin : begin + _SEARCHED]
        breaks = np.flatnonzero(part == 10)
        if delimiter == SPACES:  # the cells are the words
            word = part > ord(" ")
            marks = word.copy()
            marks[1:] &= ~word[:-1]
            marks[0] &= not in_word
            in_word = bool(word[-1])
        else:
            marks = part == ord(delimiter)
        seen = np.cumsum(marks, dtype=np.int32)
        ends.append(breaks + begin)
        counts.append(seen[breaks] + carried)
        carried += int(seen[-1])
    stops = np.append(np.concatenate(ends), body.size)
    lengths = np.diff(stops, prepend=-1) - 1
    fields = np.diff(np.append(np.concatenate(counts), carried), prepend=0)
    rows = Body(data, delimiter, first_line + np.arange(stops.size), start + stops - lengths, lengths, fields)
    filled = lengths > 0
    filled[filled] = np.frombuffer(data, dtype=np.uint8)[rows.begins[filled]] != ord("#")
    if delimiter == SPACES:
        filled &= fields > 0
    else:
        fields += 1
    return rows if filled.all() else rows.part(filled)


def decimal_mark(path: str, body: Body, wanted: Sequence[int]) -> str:
    """Return the decimal mark of a table: a comma where wanted cells hold commas and none holds a point.

    Judged from the first rows, or where those hold whole numbers alone (a stand at rest) from the first row
    with a mark. Commas that may all part thousands (``1,000``) tell nothing: the rows behind decide. A table
    in which every comma may be either is a LogError.
    """
    first = int(body.begins[0])
    if body.delimiter == "," or body.data.find(b",", first) < 0:
        return "."
    rows: Iterator[list[str]] = body.all_cells()
    start = [row[index] for row in islice(rows, 200) for index in wanted if index < len(row)]
    doubtful = ""
    for cells in chain([start], ([row[i] for i in wanted if i < len(row)] for row in rows)):
        commas = [cell for cell in cells if "," in cell]
        if any("." in cell for cell in cells):
            return "."
        if any(not _THOUSANDS.fullmatch(cell.strip().strip('"')) for cell in commas):
            return ","
        doubtful = doubtful or next(iter(commas), "")
    if doubtful:
        raise LogError(
            f"{path}: {shortened(doubtful)!r} may have three decimals or be one of thousands, and no other "
            "cell tells which; export the log with decimal points and without marks between thousands"
        )
    return "."


def _read_fast(body: Body, wanted: Sequence[int], decimal: str) -> dict[int, FloatArray] | None:
    """Parse rows with the C engine; None where the engine refuses or does not see every row."""
    import pandas as pd

    # Exact to the last bit: the default from pandas 3.1 on, an option before.
    version = tuple(int(part) for part in pd.__version__.split(".")[:2])
    exact: dict[str, Any] = {} if version >= (3, 1) else {"float_precision": "round_trip"}
    rows, text, delimiter = int(body.lines.size), body.joined(), body.delimiter
    if delimiter == SPACES:
        text, delimiter = _tabbed(text), "\t"
    try:
        frame = pd.read_csv(
            io.BytesIO(text), sep=delimiter, header=None, names=list(range(int(body.fields.max()))),
            usecols=list(wanted), nrows=rows, dtype=np.float64, engine="c", decimal=decimal,
            na_values=["", "nan", "NaN", "NAN"], keep_default_na=False, skip_blank_lines=False,
            encoding="utf-8", **exact,
        )  # fmt: skip
    except (ValueError, OverflowError, IndexError):
        return None
    if len(frame) != rows or not isinstance(frame.index, pd.RangeIndex):
        return None
    return {index: frame[index].to_numpy() for index in wanted}


def _tabbed(text: bytes) -> bytes:
    """Return lines parted by spaces as lines parted by tabs."""
    text = text.replace(b"\t", b" ")
    while b"  " in text:  # halves every run of spaces; a regular expression takes ten times as long
        text = text.replace(b"  ", b" ")
    return text.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ").replace(b" ", b"\t")


def _plain_rows(body: Body, width: int, surplus: bool) -> NDArray[np.bool_]:
    """Return which rows the C engine may see.

    They hold no quote, which may hide delimiters, and, unless `surplus`, nothing but delimiters beyond the
    header's columns.
    """
    data = np.frombuffer(body.data, dtype=np.uint8)
    plain = np.ones(body.lines.size, dtype=np.bool_)
    stops = body.begins + body.lengths
    end = int(stops[-1])
    at = body.data.find(b'"', int(body.begins[0]), end)
    while at >= 0:
        quotes = np.flatnonzero(data[at : min(at + _SEARCHED, end)] == ord('"')) + at
        plain[np.searchsorted(body.begins, quotes, side="right") - 1] = False
        at = body.data.find(b'"', at + _SEARCHED, end)
    if not surplus:
        excess = body.fields - width
        if body.delimiter != SPACES:  # between spaces there is no cell that is blank
            for place in range(1, min(int(excess.max()), _MOST_TRAILING) + 1):
                longer = np.flatnonzero(excess >= place)
                plain[longer] &= data[stops[longer] - place] == ord(body.delimiter)
        plain &= excess <= (0 if body.delimiter == SPACES else _MOST_TRAILING)
    return plain


def read_rows(
    path: str, body: Body, names: Mapping[int, str], width: int, decimal: str, surplus: bool
) -> dict[int, FloatArray]:
    """Return the numbers of the named columns; `body` keeps the lines that turn out to be rows.

    Some megabytes at a time, plain rows are read by the C engine and the others one by one; all of them where
    the engine refuses.
    """
    columns = {index: np.empty(body.lines.size) for index in names}
    kept = np.ones(body.lines.size, dtype=np.bool_)
    for place in body.parts():
        part = body.part(place)
        fast = _plain_rows(part, width, surplus)
        read = _read_fast(part.part(fast), list(names), decimal) if fast.mean() >= 0.5 else None
        if read is None:
            fast[:] = False
        else:
            for index, values in read.items():
                columns[index][place][fast] = values
        if not fast.all():
            few = part.part(~fast)
            rows, slow = _read_slow(path, few, names, width, decimal, surplus)
            part.fields[~fast] = few.fields
            kept[place][~fast] = rows
            for index, values in slow.items():
                columns[index][place][~fast] = values
    if not kept.all():
        body.lines, body.fields = body.lines[kept], body.fields[kept]
        columns = {index: values[kept] for index, values in columns.items()}
    return columns


def _read_slow(
    path: str, body: Body, names: Mapping[int, str], width: int, decimal: str, surplus: bool
) -> tuple[NDArray[np.bool_], dict[int, FloatArray]]:
    """Read row by row; return which lines turn out to be rows, and their numbers, NaN for the others.

    `body.fields` is set to the cells that each row really has.
    """
    rows = np.zeros(body.lines.size, dtype=np.bool_)
    values = {index: np.full(body.lines.size, np.nan) for index in names}
    for row, cells in enumerate(body.all_cells()):
        if not cells or cells[0].lstrip().startswith("#") or (len(cells) == 1 and not cells[0].strip()):
            continue
        rows[row], body.fields[row] = True, len(cells)
        if not surplus and any(cell.strip() for cell in cells[width:]):
            raise LogError(
                f"{path}, line {body.lines[row]}: {len(cells)} cells where the header names {width} columns; "
                "check the delimiter, or repair the line"
            )
        for index, into in values.items():
            cell = cells[index] if index < len(cells) else ""
            try:
                into[row] = _quick_number(cell) if decimal == "." else parse_number(cell, decimal)
            except ValueError:
                raise LogError(
                    f"{path}, line {body.lines[row]}: {shortened(cell)!r} in column "
                    f"{shortened(names[index], 80)!r} is not a number; repair the cell or leave it blank"
                ) from None
    return rows, values
