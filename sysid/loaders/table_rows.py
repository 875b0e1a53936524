"""Rows of numbers as bytes: where they lie, and two exact ways of reading them.

A clean numeric body is parsed by the C engine of pandas; whatever that engine will not take (quotes, surplus
cells, a cell that is no number) is read line by line, where the first cell that is not a number is named
with its line and its column. Both ways give the same numbers, to the last bit.
"""

from __future__ import annotations

import csv
import io
import math
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import LogError
from sysid.loaders.text import split_line
from sysid.recording import FloatArray

_MISSING = frozenset({"", "nan", "-nan", "+nan"})
# Bytes that are searched for quotes at once.
_CHUNK = 1 << 22
# Rows that are parted at once.
_BATCH = 4096
# More blank cells than this behind the last column of a row is no trailing delimiter.
_MOST_TRAILING = 64


def parse_number(cell: str, decimal: str = ".") -> float:
    """Return the number in a cell, NaN for a blank cell or a written nan.

    Raises
    ------
    ValueError
        When the cell holds anything else.
    """
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
            try:
                parted = list(csv.reader(lines, delimiter=self.delimiter))
            except csv.Error:
                parted = []
            # A quote that is left open joins lines: then each is parted by itself, where it cannot.
            yield from parted if len(parted) == len(lines) else (split_line(x, self.delimiter) for x in lines)

    def select(self, rows: NDArray[np.bool_]) -> None:
        """Keep only some rows, and the bytes of only those."""
        edges = np.flatnonzero(np.diff(np.concatenate(([0], rows.astype(np.int8), [0]))))
        view = memoryview(self.data)
        stops = self.begins + self.lengths
        runs = [view[self.begins[a] : stops[b - 1]] for a, b in zip(edges[::2], edges[1::2], strict=True)]
        self.data = b"\n".join(runs)
        self.lines, self.lengths, self.fields = self.lines[rows], self.lengths[rows], self.fields[rows]
        self.begins = np.cumsum(self.lengths + 1) - (self.lengths + 1)

    def drop_last(self) -> None:
        """Leave out the last row."""
        self.lines, self.begins = self.lines[:-1], self.begins[:-1]
        self.lengths, self.fields = self.lengths[:-1], self.fields[:-1]


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
    ends, counts, carried = [], [], 0
    for begin in range(0, body.size, chunk := 1 << 22):
        part = body[begin : begin + chunk]
        breaks = np.flatnonzero(part == 10)
        seen = np.cumsum(part == ord(delimiter), dtype=np.int32)
        ends.append(breaks + begin)
        counts.append(seen[breaks] + carried)
        carried += int(seen[-1])
    stops = np.append(np.concatenate(ends), body.size)
    lengths = np.diff(stops, prepend=-1) - 1
    totals = np.append(np.concatenate(counts), carried)
    begins = start + stops - lengths
    fields = np.diff(totals, prepend=0) + 1
    rows = Body(data, delimiter, first_line + np.arange(stops.size), begins, lengths, fields)
    filled = lengths > 0
    filled[filled] = np.frombuffer(data, dtype=np.uint8)[begins[filled]] != ord("#")
    if not filled.all():
        rows.select(filled)
    return rows


def decimal_mark(rows: Sequence[Sequence[str]], wanted: Sequence[int], delimiter: str) -> str:
    """Return the decimal mark of a table: a comma where wanted cells hold commas and none holds a point."""
    if delimiter == ",":
        return "."
    cells = [row[index] for row in rows for index in wanted if index < len(row)]
    return "," if any("," in cell for cell in cells) and not any("." in cell for cell in cells) else "."


def _read_fast(body: Body, wanted: Sequence[int], decimal: str) -> dict[int, FloatArray] | None:
    """Parse a body with the C engine; None where the engine refuses or does not see every row."""
    import pandas as pd

    # Exact to the last bit: the default from pandas 3.1 on, an option before.
    version = tuple(int(part) for part in pd.__version__.split(".")[:2])
    exact: dict[str, Any] = {} if version >= (3, 1) else {"float_precision": "round_trip"}
    rows = int(body.lines.size)
    stream = io.BytesIO(body.data)
    stream.seek(int(body.begins[0]))
    try:
        frame = pd.read_csv(
            stream,
            sep=body.delimiter,
            header=None,
            names=list(range(int(body.fields.max()))),
            usecols=list(wanted),
            nrows=rows,
            dtype=np.float64,
            engine="c",
            decimal=decimal,
            na_values=["", "nan", "NaN", "NAN"],
            keep_default_na=False,
            skip_blank_lines=False,
            encoding="utf-8",
            **exact,
        )
    except (ValueError, OverflowError, IndexError):
        return None
    if len(frame) != rows or not isinstance(frame.index, pd.RangeIndex):
        return None
    return {index: frame[index].to_numpy() for index in wanted}


def _plain_rows(body: Body, width: int, surplus: bool) -> NDArray[np.bool_]:
    """Return which rows the C engine may see.

    They hold no quote, which may hide delimiters, and, unless `surplus`, nothing but delimiters beyond the
    header's columns.
    """
    data = np.frombuffer(body.data, dtype=np.uint8)
    plain = np.ones(body.lines.size, dtype=np.bool_)
    at = body.data.find(b'"', int(body.begins[0]))
    while at >= 0:
        quotes = np.flatnonzero(data[at : at + _CHUNK] == ord('"')) + at
        plain[np.searchsorted(body.begins, quotes, side="right") - 1] = False
        at = body.data.find(b'"', at + _CHUNK)
    if not surplus:
        excess = body.fields - width
        stops = body.begins + body.lengths
        for place in range(1, min(int(excess.max()), _MOST_TRAILING) + 1):
            longer = np.flatnonzero(excess >= place)
            plain[longer] &= data[stops[longer] - place] == ord(body.delimiter)
        plain &= excess <= _MOST_TRAILING
    return plain


def read_rows(
    path: str, body: Body, names: Mapping[int, str], width: int, decimal: str, surplus: bool
) -> dict[int, FloatArray]:
    """Read plain rows with the C engine and the others one by one; all of them where the engine refuses."""
    wanted = list(names)
    plain = _plain_rows(body, width, surplus)
    if plain.all():
        columns = _read_fast(body, wanted, decimal)
    elif plain.mean() < 0.5:
        columns = None
    else:
        # Only the places of the odd rows are cut out of the bytes; all rows keep their numbers.
        rest = Body(body.data, body.delimiter, body.lines, body.begins, body.lengths, body.fields)
        rest.select(plain)
        columns = _read_fast(rest, wanted, decimal)
        del rest
    if columns is None:
        return _read_slow(path, body, names, width, decimal, surplus)
    if plain.all():
        return columns
    odd = np.flatnonzero(~plain)
    few = Body(
        body.data, body.delimiter, body.lines[odd], body.begins[odd], body.lengths[odd], body.fields[odd]
    )
    slow = _read_slow(path, few, names, width, decimal, surplus)
    kept = np.ones(plain.size, dtype=np.bool_)
    kept[odd] = np.isin(body.lines[odd], few.lines)
    out = {}
    for index in wanted:
        values = np.empty(plain.size)
        values[plain] = columns[index]
        values[~plain & kept] = slow[index]
        out[index] = values[kept]
    body.fields[~plain & kept] = few.fields
    body.lines, body.fields = body.lines[kept], body.fields[kept]
    return out


def _read_slow(
    path: str, body: Body, names: Mapping[int, str], width: int, decimal: str, surplus: bool
) -> dict[int, FloatArray]:
    """Read row by row; `body` keeps the lines that turn out to be rows, with the cells that each "
    "really has."""
    rows = np.zeros(body.lines.size, dtype=np.bool_)
    values: dict[int, array[float]] = {index: array("d") for index in names}
    for row, cells in enumerate(body.all_cells()):
        if cells[0].lstrip().startswith("#") or (len(cells) == 1 and not cells[0].strip()):
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
                into.append(_quick_number(cell) if decimal == "." else parse_number(cell, decimal))
            except ValueError:
                found = cell.strip() if len(cell) <= 40 else cell.strip()[:37] + "..."
                raise LogError(
                    f"{path}, line {body.lines[row]}: {found!r} in column {names[index]!r} is not a number; "
                    "repair the cell or leave it blank"
                ) from None
    body.lines, body.fields = body.lines[rows], body.fields[rows]
    return {index: np.array(numbers, dtype=np.float64) for index, numbers in values.items()}
