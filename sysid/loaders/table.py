"""Tables of numbers inside text logs: the header line, and a fast, exact reading of the rows.

A clean numeric body is parsed by the C engine of pandas; whatever that engine will not take (quotes, comment
or blank lines between the rows, surplus cells) is read line by line, where the first cell that is not a
number is named with its line and its column. Both ways give the same numbers, to the last bit.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import LogError
from sysid.loaders.text import Text, sniff_delimiter, split_line
from sysid.recording import FloatArray

_MISSING = frozenset({"", "nan", "-nan", "+nan"})
# Where a header line may stand: vendors put a few lines before it, nobody puts a hundred.
_HEADER_SEARCH = 100


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


def _all_numeric(cells: Sequence[str]) -> bool:
    filled = [cell for cell in cells if cell.strip()]
    for cell in filled:
        try:
            parse_number(cell)
        except ValueError:
            return False
    return bool(filled)


@dataclass(frozen=True)
class TableHead:
    """Header of a table: `names` without the empty ones at the end, and where the rows begin."""

    names: tuple[str, ...]
    delimiter: str
    line: int
    offset: int


def find_header(lines: Sequence[str]) -> tuple[int, str, list[str]] | None:
    """Return (index, delimiter, names) of the header line among the first lines of a log, if there is one.

    Blank lines are passed over, and lines that begin with ``#`` unless they name as many columns as the row
    of numbers below them has.
    """
    for index, line in enumerate(lines[:_HEADER_SEARCH]):
        if not line.strip():
            continue
        names = split_line(line, delimiter := sniff_delimiter(line))
        if line.lstrip().startswith("#"):
            below = next((text for text in lines[index + 1 :] if text.strip()), "")
            cells = split_line(below, delimiter)
            if len(names) < 2 or len(cells) != len(names) or not _all_numeric(cells):
                continue
            names[0] = names[0].lstrip().lstrip("#")
        while names and not names[-1].strip():
            names.pop()
        return index, delimiter, [name.strip() for name in names]
    return None


def table_head(text: Text, columns: Sequence[str] | None = None) -> TableHead:
    """Return the header of a table.

    Parameters
    ----------
    text : Text
        The log.
    columns : sequence of str, optional
        Names that the user declares, for a log without header or with a wrong one.

    Raises
    ------
    LogError
        When there is no header, or as many names were declared as the table has not.
    """
    lines = list(text.lines(_HEADER_SEARCH))
    found = find_header([line for _, _, line in lines])
    if found is None:
        raise LogError(
            f"{text.path}: only blank or comment lines; expected a header line and rows of numbers"
        )
    index, delimiter, names = found
    number, offset, _ = lines[index]
    headless = _all_numeric(names)
    if headless:
        number, offset = number - 1, lines[index - 1][1] if index else 0
    if columns is not None:
        if isinstance(columns, str) or not isinstance(columns, Sequence):
            raise LogError(f"{text.path}: columns = {columns!r} is no list of names")
        if len(columns) != len(names):
            raise LogError(
                f"{text.path}: columns declares {len(columns)} names but line {lines[index][0]} has "
                f"{len(names)} cells; name every column, in order"
            )
        names = [str(name) for name in columns]
    elif headless:
        raise LogError(
            f"{text.path}, line {lines[index][0]}: found numbers where the header line should name "
            "the columns; declare them with columns = [...]"
        )
    return TableHead(tuple(names), delimiter, number, offset)


@dataclass
class Numbers:
    """Rows of numbers.

    Parameters
    ----------
    columns : dict
        One array per wanted column.
    lines : (n,) array
        Where each row stands in the file, counted from 1, for messages.
    notes : list of str
        What was noticed.
    row_word : str
        What `lines` counts: ``line`` or ``sample``.
    open_end : bool
        The last row is that of a last line without line end, which may be cut inside a number.
    """

    columns: dict[int, FloatArray]
    lines: NDArray[np.int64]
    notes: list[str] = field(default_factory=list)
    row_word: str = "line"
    open_end: bool = False

    def keep(self, mask: NDArray[np.bool_]) -> None:
        """Keep only the rows where `mask` is true."""
        if not mask.all():
            self.columns = {index: values[mask] for index, values in self.columns.items()}
            self.lines = self.lines[mask]
            self.open_end = self.open_end and bool(mask[-1])


@dataclass
class _Body:
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


def _body_end(data: bytes, start: int) -> tuple[int, bool]:
    """Return where the last row ends, comments and blank lines after it left out, and if it has a "
    "line end."""
    end = len(data)
    while end > start:
        while end > start and data[end - 1] == 10:
            end -= 1
        begin = max(data.rfind(b"\n", start, end) + 1, start)
        line = data[begin:end]
        if line.strip() and not line.lstrip().startswith(b"#"):
            break
        end = begin
    return end, end < len(data)


def _measure(data: bytes, start: int, end: int, delimiter: str, first_line: int) -> _Body:
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
    rows = _Body(data, delimiter, first_line + np.arange(stops.size), begins, lengths, fields)
    filled = lengths > 0
    filled[filled] = np.frombuffer(data, dtype=np.uint8)[begins[filled]] != ord("#")
    if not filled.all():
        rows.select(filled)
    return rows


def _decimal_mark(rows: Sequence[Sequence[str]], wanted: Sequence[int], delimiter: str) -> str:
    """Return the decimal mark of a table: a comma where wanted cells hold commas and none holds a point."""
    if delimiter == ",":
        return "."
    cells = [row[index] for row in rows for index in wanted if index < len(row)]
    return "," if any("," in cell for cell in cells) and not any("." in cell for cell in cells) else "."


def _read_fast(body: _Body, wanted: Sequence[int], decimal: str) -> dict[int, FloatArray] | None:
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


def read_numbers(
    text: Text,
    head: TableHead,
    wanted: Sequence[int],
    *,
    least: int | None = None,
    surplus: bool = False,
) -> Numbers:
    """Parse the wanted columns of a table.

    A blank cell or a written ``nan`` is NaN. A last line that was cut is left out; a row that lacks wanted
    cells keeps its place with NaN in all of them, because the last number of a cut row is not to be trusted.

    Parameters
    ----------
    text : Text
        The log.
    head : TableHead
        Where the rows begin, and the names of the columns.
    wanted : sequence of int
        Column numbers from 0.
    least : int, optional
        Cells that a row must have to be trusted; by default as many as the header names.
    surplus : bool
        Rows may have filled cells beyond the header.

    Raises
    ------
    LogError
        When there are no rows, a cell is not a number, or most rows do not fit the header.
    """
    path = text.path
    empty = LogError(f"{path}: no rows of numbers after line {max(head.line, 1)}; the log is empty")
    wanted = sorted(set(wanted))
    least = len(head.names) if least is None else least
    end, closed = _body_end(text.data, head.offset)
    if end <= head.offset:
        raise empty
    body = _measure(text.data, head.offset, end, head.delimiter, head.line + 1)
    notes = list(text.notes)
    decimal = _decimal_mark(
        [body.cells(row) for row in range(min(body.lines.size, 200))], wanted, head.delimiter
    )
    open_end = not closed
    if open_end and not _is_whole(body.cells(-1), wanted, least, decimal):
        notes.append(f"line {body.lines[-1]}, the last, is cut and was left out")
        if body.lines.size == 1:
            raise empty
        body.drop_last()
        open_end = False
    elif open_end:
        notes.append(f"line {body.lines[-1]}, the last, has no line end: its last number may be cut")

    # Quotes may hide delimiters, and cells beyond the header must be blank: only the slow reader looks at
    # them.
    plain = body.data.find(b'"', int(body.begins[0])) < 0
    plain = plain and (surplus or bool(np.all(body.fields <= len(head.names))))
    columns = _read_fast(body, wanted, decimal) if plain else None
    if columns is None:
        columns = _read_slow(
            path, body, {index: head.names[index] for index in wanted}, len(head.names), decimal, surplus
        )
        if not body.lines.size:
            raise empty
    lines, fields = body.lines, body.fields
    short = fields < least
    if short.any():
        if short.sum() * 2 > short.size:
            row = int(np.argmax(short))
            raise LogError(
                f"{path}, line {lines[row]}: {fields[row]} cells where {least} are expected, as in "
                "most rows; check the delimiter and the header"
            )
        columns = {index: np.where(short, np.nan, values) for index, values in columns.items()}
        notes.append(
            f"rows with fewer than {least} cells: {int(short.sum())} (first: line "
            f"{lines[np.argmax(short)]}); taken as missing"
        )
    infinite = 0
    for index, values in columns.items():
        wild = np.isinf(values)
        if wild.any():
            infinite += int(wild.sum())
            columns[index] = np.where(wild, np.nan, values)
    if infinite:
        notes.append(f"cells that hold an infinite number: {infinite}; taken as missing")
    return Numbers(columns, lines, notes, open_end=open_end)


def _is_whole(cells: Sequence[str], wanted: Sequence[int], least: int, decimal: str) -> bool:
    """Return whether a last line without line end holds every wanted number."""
    if len(cells) < least or len(cells) <= wanted[-1]:
        return False
    try:
        for index in wanted:
            parse_number(cells[index], decimal)
    except ValueError:
        return False
    return True


def _read_slow(
    path: str, body: _Body, names: Mapping[int, str], width: int, decimal: str, surplus: bool
) -> dict[int, FloatArray]:
    """Read row by row; `body` keeps the lines that turn out to be rows, with the cells that each "
    "really has."""
    rows = np.zeros(body.lines.size, dtype=np.bool_)
    values: dict[int, list[float]] = {index: [] for index in names}
    for row in range(body.lines.size):
        cells = body.cells(row)
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
                into.append(parse_number(cell, decimal))
            except ValueError:
                found = cell.strip() if len(cell) <= 40 else cell.strip()[:37] + "..."
                raise LogError(
                    f"{path}, line {body.lines[row]}: {found!r} in column {names[index]!r} is not a number; "
                    "repair the cell or leave it blank"
                ) from None
    body.lines, body.fields = body.lines[rows], body.fields[rows]
    return {index: np.array(numbers, dtype=np.float64) for index, numbers in values.items()}
