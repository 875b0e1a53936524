"""Tables of numbers inside text logs: the header line, and a fast, exact reading of the rows.

The C engine of pandas parses a large table whose rows are plain numbers, some megabytes at a time, so that
beside the file and its numbers hardly anything is in memory. A small table, and one that the engine will not
take (quotes, surplus cells, a cell that is no number), is read line by line; there the first cell that is not
a number is named with its line and its column. Both ways give the same numbers, to the last bit.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from itertools import chain, islice
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.source import SPACES, Text, shortened, sniff_delimiter, split_line
from sysid.recording import FloatArray

# Number of lines among which a header is looked for: vendors put a few lines before it.
HEADER_SEARCH = 100
_MISSING = frozenset({"", "nan", "-nan", "+nan"})
# Least and largest size of the pieces that the engine parses [B]; it needs several times their size.
_PARSED = (1 << 18, 1 << 20)
# Largest table that is read line by line for its size alone [B]: reading it so takes as long as the engine
# does and spares the import of pandas (0.3 s, 30 MB).
_SMALL = 1 << 17
# A number whose commas may separate thousands.
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:,\d{3})+")
# Unit in the header of a column of clock times, which `stamped` has turned into microseconds: dates by ISO
# 8601 with a time, and times of day behind any other date or none. A colon may stand before the decimals.
STAMPS = "ISO 8601"
_DATED = r"\d{4}-\d\d-\d\d[Tt ]\d\d:\d\d(?::\d\d(?:[.,:]\d+)?)?(?:[Zz]|[+-]\d\d(?::?\d\d)?)?"
_OF_DAY = r"(?:\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4} +)?(\d{1,2}):(\d\d):(\d\d(?:[.,:]\d+)?)(?: *([AaPp])[Mm])?"
_STAMP = f"{_DATED}|{_OF_DAY}"
_DAY = timedelta(days=1)
# Largest share of rows that have lost a cell, and do not leave out blank ones by habit [1].
_FEW_SHORT = 0.05
# Largest number of blank cells behind the last column of a row that count as trailing delimiters.
_MOST_TRAILING = 64


def all_numeric(cells: Sequence[str]) -> bool:
    """Return whether all cells that are not blank are numbers, and one is."""
    filled = [cell for cell in cells if cell.strip()]
    return bool(filled) and all(map(is_number, filled))


@dataclass(frozen=True)
class TableHead:
    """Header of a table: `names` without the `trailing` empty ones at the end, and where the rows begin."""

    names: tuple[str, ...]
    delimiter: str
    line: int
    offset: int
    trailing: int = 0


def find_header(lines: Sequence[str]) -> tuple[int, str, list[str]] | None:
    """Return (index, delimiter, names) of the header line among the first lines of a log, if there is one.

    Blank lines are passed over, and lines that begin with ``#`` unless they name as many columns as the row
    of numbers below them has; so are titles, lines of one cell above such a header.
    """
    begin = _behind_titles(lines[:HEADER_SEARCH])
    for index, line in enumerate(lines[:HEADER_SEARCH]):
        if index < begin or not line.strip():
            continue
        marked, delimiter = line.lstrip().startswith("#"), sniff_delimiter(line)
        names = split_line(line, delimiter)
        if delimiter == SPACES:  # a unit in brackets belongs to the name before it
            text = line.lstrip().lstrip("#") if marked else line
            names = [" ".join(name.split()) for name in re.split(r"\s+(?![(\[])", text.strip())]
        if marked:
            below = next((text for text in lines[index + 1 :] if text.strip()), "")
            cells = split_line(below, delimiter)
            if len(names) < 2 or len(cells) != len(names) or not all_numeric(cells):
                continue
            names[0] = names[0].lstrip().lstrip("#")
        while names and not names[-1].strip():
            names.pop()
        return index, delimiter, [name.strip() for name in names]
    return None


def _behind_titles(lines: Sequence[str]) -> int:
    """Return the index of the header below lines of one cell (who recorded the log); 0 without them."""
    for index, line in enumerate(lines):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        delimiter = sniff_delimiter(line, spaces=False)
        filled = [cell for cell in split_line(line, delimiter) if cell.strip()]
        if len(filled) == 1 and not all_numeric(filled):
            continue
        below = next((text for text in lines[index + 1 :] if text.strip()), "")
        cells, names = split_line(below, delimiter), split_line(line, delimiter)
        named = len(filled) > 1 and not any(all_numeric([cell]) for cell in filled)
        first = cells[0] if delimiter == "," else cells[0].replace(",", ".", 1)
        return index if named and len(cells) == len(names) and all_numeric([first]) else 0
    return 0


@dataclass
class Numbers:
    """Rows of numbers: one array per wanted column.

    `lines` (n,) is where each row stands in the file, counted from 1 in `row_word`, for messages.
    `open_end`: the last row is of a line without line end, which may be cut inside a number.
    """

    columns: dict[int, FloatArray]
    lines: NDArray[np.int64]
    notes: list[Finding] = field(default_factory=list)
    row_word: str = "line"
    open_end: bool = False

    def stacked(self, columns: Iterable[int]) -> FloatArray:
        """Return columns side by side, (n, k)."""
        return np.column_stack([self.columns[index] for index in columns])

    def blank(self, rows: NDArray[np.bool_]) -> None:
        """Make all numbers of some rows (n,) missing."""
        for values in self.columns.values():
            values[rows] = np.nan

    def counted(self, what: str, rows: NDArray[np.bool_]) -> str:
        """Return how many rows (n,) are `what`, and where the first is, for a note."""
        return f"{what}: {int(rows.sum())} (first: {self.row_word} {self.lines[np.argmax(rows)]})"

    def keep(self, mask: NDArray[np.bool_]) -> None:
        """Keep only the rows where `mask` (n,) is true."""
        if not mask.all():
            self.columns = {index: values[mask] for index, values in self.columns.items()}
            self.lines = self.lines[mask]
            self.open_end = self.open_end and bool(mask[-1])


def read_numbers(
    text: Text,
    head: TableHead,
    wanted: Sequence[int],
    *,
    least: int | None = None,
    surplus: bool = False,
    free_text: int | None = None,
    decimal: str | None = None,
    ends: Sequence[int] = (),
    again: bool = False,
) -> Numbers:
    """Parse the wanted columns of a table, counted from 0.

    A blank cell or a written ``nan`` is NaN. A last line that was cut is left out. A row with fewer than
    `least` cells (by default as many as the header names) keeps its place with NaN in all columns, because
    the last number of a cut row is not to be trusted. So does a row with more cells than the header and most
    rows have, whose numbers are not below their names. A row may end, with a delimiter, after one of the
    numbers of cells in `ends`. With `surplus`, rows may have filled cells beyond the header, behind the words
    in column `free_text`, which may contain delimiters. The `decimal` mark is judged from the first cells
    that have one. With `again`, the header may stand again between rows. A table without rows, a cell that is
    no number and most rows out of place are a LogError.
    """
    path = text.path
    empty = LogError(f"{path}: no rows of numbers after line {max(head.line, 1)}; the log is empty")
    wanted = sorted(set(wanted))
    least = len(head.names) if least is None else least
    end, closed = _body_end(text.data, head.offset, head.delimiter)
    if end <= head.offset:
        raise empty
    body = _measure(text.data, head.offset, end, head.delimiter, head.line + 1)
    notes = list(text.notes)
    if again:
        header = text.data[text.data.rfind(b"\n", 0, head.offset - 1) + 1 : head.offset - 1]
        alike = np.flatnonzero(body.lengths == len(header)).tolist()
        copies = [row for row in alike if text.data.startswith(header, int(body.begins[row]))]
        if copies:
            sentence = (
                f"the header stands again in line {body.lines[copies[0]]}: logs may be joined in this file"
            )
            notes.append(Finding("header-again", sentence))
            body = body.part(~np.isin(np.arange(body.lines.size), copies))
    if not body.lines.size:
        raise empty
    if decimal is None:
        decimal = _decimal_mark(path, body, wanted)
    open_end = not closed
    if open_end:
        last = body.cells(-1)
        whole = len(last) >= max(least, wanted[-1] + 1) and all(is_number(last[i], decimal) for i in wanted)
        if whole:
            sentence = f"line {body.lines[-1]}, the last, has no line end: its last number may be cut"
            notes.append(note("last-line-open", sentence))
        else:
            notes.append(note("last-line-cut", f"line {body.lines[-1]}, the last, is cut and was left out"))
            if body.lines.size == 1:
                raise empty
            body, open_end = body.part(slice(0, -1)), False

    columns = _read_fast(body, wanted, len(head.names), decimal, surplus)
    if columns is None:
        names = {index: head.names[index] for index in wanted}
        body, columns = _read_slow(path, body, names, len(head.names), decimal, surplus)
    if not body.lines.size:
        raise empty
    numbers = Numbers(columns, body.lines, notes, open_end=open_end)
    short, fewest = _short(path, body, least, len(head.names), free_text, ends)
    if short.any():
        numbers.blank(short)
        sentence = numbers.counted(f"rows with fewer than {fewest} cells", short)
        notes.append(note("short-rows", f"{sentence}; taken as missing"))
    shifted = np.isin(np.arange(short.size), _shifted(path, body, head, wanted, surplus, free_text))
    if shifted.any():
        numbers.blank(shifted)
        what = "rows with a cell too many, whose numbers are not below their names"
        notes.append(note("shifted-rows", f"{numbers.counted(what, shifted)}; taken as missing"))
    infinite = sum(int(np.count_nonzero(np.isinf(values))) for values in columns.values())
    if infinite:
        for values in columns.values():
            values[np.isinf(values)] = np.nan
        sentence = f"cells with an infinite number: {infinite}; taken as missing"
        notes.append(note("infinite-cells", sentence))
    return numbers


def stamped(text: Text, head: TableHead) -> tuple[Text, TableHead]:
    """Return a table whose clock times are microseconds since the first, and its column says so.

    A time of day that falls by more than half a day is of the next day.
    """
    lines = (line for _, _, line in text.lines(HEADER_SEARCH, head.offset) if line.strip())
    cells = split_line(next((line for line in lines if not line.startswith("#")), ""), head.delimiter)
    stamps = [cell.strip().strip('"') for cell in cells]
    place = next((i for i, stamp in enumerate(stamps) if re.fullmatch(_STAMP, stamp)), None)
    if place is None or place >= len(head.names):
        return text, head
    mark = r"\s+" if head.delimiter == SPACES else head.delimiter
    cell = rf"[^{head.delimiter}\n]*{mark}"
    pattern = re.compile(rf'^((?:{cell}){{{place}}})\s*"?({_STAMP})"?\s*?(?={mark}|$)'.encode(), re.MULTILINE)
    kind = "ISO 8601" if re.fullmatch(_DATED, stamps[place]) else "times of day"
    latest = timedelta(0)

    def read(stamp: str) -> datetime:
        nonlocal latest
        stamp = re.sub(r"(:\d\d:\d\d)[:,]", r"\1.", stamp)
        if kind == "ISO 8601":
            return datetime.fromisoformat(stamp)
        if not (parts := re.fullmatch(_OF_DAY, stamp)):
            raise ValueError(f"found {stamp!r}")
        hour, minute, second, half = parts.groups()
        hours = int(hour) if half is None else int(hour) % 12 + 12 * (half in "Pp")
        time = timedelta(hours=hours, minutes=int(minute), seconds=float(second))
        if time >= _DAY or int(minute) > 59:
            raise ValueError(f"found {stamp!r}")
        latest = time + round((latest - time) / _DAY) * _DAY
        return datetime.min + _DAY + latest

    def count(match: re.Match[bytes]) -> bytes:
        return b"%s%d" % (match[1], (read(match[2].decode()) - first) // timedelta(microseconds=1))

    try:
        first = read(stamps[place])
        body = pattern.sub(count, text.data[head.offset :])
    except (ValueError, TypeError, OverflowError) as error:
        raise LogError(
            f"{text.path}: the times in column {shortened(head.names[place])!r} are not all {kind} of one "
            f"kind ({error}); write all alike, with an offset from UTC or without"
        ) from error
    name = f"{re.sub(r' *[([].*', '', head.names[place])} ({STAMPS})"
    names = (*head.names[:place], name, *head.names[place + 1 :])
    times = kind if kind == "times of day" else f"{kind} times"
    sentence = f"column {shortened(head.names[place])!r} has {times}: counted from {stamps[place]}"
    said = (*text.notes, note("times-are-stamps", sentence))
    return Text(text.path, text.data[: head.offset] + body, said), replace(head, names=names)


def _short(
    path: str, body: _Rows, least: int, width: int, free_text: int | None, ends: Sequence[int]
) -> tuple[NDArray[np.bool_], int]:
    """Return which rows have too few cells, and fewer than how many these are.

    A table where most rows have fewer than `least` is a LogError. A row that has as many, and fewer than its
    table's rows usually have, lost a cell somewhere: unless many end early, as a program may leave out blank
    cells, its numbers may not be below their names.
    """
    lines, fields = body.lines, body.fields
    short = fields < least
    if free_text is not None:
        for row in np.flatnonzero(short & (fields == free_text + 1)).tolist():
            short[row] = not _is_words(body.cells(row), free_text)
    for row in np.flatnonzero(short & np.isin(fields - 1, np.asarray(ends, dtype=np.int64))).tolist():
        cells = body.cells(row)
        short[row] = bool(cells[-1].strip()) or not all(cell.strip() for cell in cells[:-1])
    if short.sum() * 2 > short.size:
        first = int(np.argmax(short))
        raise LogError(
            f"{path}, line {lines[first]}: {fields[first]} cells where {least} are expected, as in "
            "most rows; check the delimiter and the header"
        )
    usual = int(np.bincount(fields).argmax())
    lost = (fields >= least) & (fields < usual)
    if free_text in (None, width - 1) and 0 < lost.sum() <= max(_FEW_SHORT * lost.size, 1):
        return short | lost, usual
    return short, least


def promised_note(header: str, stated: object, rows: int) -> list[Finding]:
    """Return a note where a header promises more rows (`stated`, by the name `header`) than there are."""
    try:
        promised = int(str(stated).strip())
    except ValueError:
        return []
    if promised <= rows:
        return []
    sentence = f"{header} is {promised} but {rows} rows are there: the log was cut, or rows were left out"
    return [note("fewer-rows-than-stated", sentence)]


def _is_words(cells: Sequence[str], column: int | None) -> bool:
    return column is not None and column < len(cells) and not all_numeric([cells[column].strip() or "0"])


def _shifted(
    path: str, body: _Rows, head: TableHead, wanted: Sequence[int], surplus: bool, free_text: int | None
) -> list[int]:
    """Return the rows with more cells than there should be, by a delimiter too many."""
    width, fields = len(head.names), body.fields
    if head.delimiter == SPACES:
        return []
    # Many programs end each row, but not the header, with a delimiter; a lost body may leave short rows.
    full = fields[fields >= width]
    usual = int(np.bincount(full).argmax()) if full.size else width
    most = max(width + head.trailing, min(usual, width + 1) if surplus else usual)
    long = [(row, body.cells(row)) for row in np.flatnonzero(fields > most).tolist()]
    wordless = [(row, cells) for row, cells in long if not _is_words(cells, free_text)]
    if len(wordless) * 2 > fields.size:
        row, cells = long[0]
        raise LogError(
            f"{path}, line {body.lines[row]}: {len(cells)} cells where the header has "
            f"{width + head.trailing}, as in most rows; check the header for a name that is lost"
        )
    if free_text is None:
        return [row for row, _ in wordless]
    # Cells behind the words are appended by a script. With a delimiter too many in front of the words, a
    # number stands in their place.
    shifted = [
        row
        for row, cells in wordless
        if cells[free_text].strip() or not any(cell.strip() for cell in cells[free_text + 1 :])
    ]
    if width == free_text + 1 and full.size * 2 < fields.size:
        # Most rows end before the words; in some a number stands there and a blank in front of it.
        for row in np.flatnonzero(fields == width).tolist():
            cells = body.cells(row)
            blank = any(not cells[column].strip() for column in wanted if column)  # 0 may be an unused clock
            if blank and cells[free_text].strip() and not _is_words(cells, free_text):
                shifted.append(row)
    return shifted


def parse_number(cell: str, decimal: str = ".") -> float:
    """Return the number in a cell, NaN for a blank cell or a written nan; ValueError for anything else."""
    if decimal == "." and cell.isascii() and "_" not in cell:
        try:
            return float(cell)  # enough for most cells, in a third of the time
        except ValueError:
            pass
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


def is_number(cell: str, decimal: str = ".") -> bool:
    """Return whether `parse_number` takes a cell."""
    try:
        parse_number(cell, decimal)
    except ValueError:
        return False
    return True


@dataclass
class _Rows:
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

    def part(self, rows: slice | NDArray[np.bool_]) -> _Rows:
        """Return some of the rows; `data` is shared."""
        chosen = (self.lines[rows], self.begins[rows], self.lengths[rows], self.fields[rows])
        return _Rows(self.data, self.delimiter, *chosen)


def _body_end(data: bytes, start: int, delimiter: str) -> tuple[int, bool]:
    """Return where the last row ends, before comments and blank lines, and whether it has a line end."""
    # A line of tabs alone is a row of blank cells where tabs delimit cells.
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


def _measure(data: bytes, start: int, end: int, delimiter: str, first_line: int) -> _Rows:
    """Return the lines of `data` from `start` to `end`; blank ones and comments are not among them."""
    body = np.frombuffer(data, dtype=np.uint8, count=end - start, offset=start)
    stops = np.append(np.flatnonzero(body == 10), body.size)
    lengths = np.diff(stops, prepend=-1) - 1
    if delimiter == SPACES:  # the cells are the words, counted where they begin
        marks = body > ord(" ")
        marks[1:] &= ~marks[:-1]
    else:
        marks = body == ord(delimiter)
    fields = np.diff(np.searchsorted(np.flatnonzero(marks), stops), prepend=0)
    rows = _Rows(
        data, delimiter, first_line + np.arange(stops.size), start + stops - lengths, lengths, fields
    )
    filled = lengths > 0
    filled[filled] = np.frombuffer(data, dtype=np.uint8)[rows.begins[filled]] != ord("#")
    if delimiter == SPACES:
        filled &= fields > 0
    else:
        fields += 1
    return rows if filled.all() else rows.part(filled)


def _decimal_mark(path: str, body: _Rows, wanted: Sequence[int]) -> str:
    """Return the decimal mark of a table: a comma where wanted cells have commas and none has a point.

    The first rows decide, or the first row with a mark where those are whole numbers alone (a stand at rest).
    Commas that may all part thousands (``1,000``) decide nothing. A table with no others is a LogError.
    """
    first = int(body.begins[0])
    if body.delimiter == "," or body.data.find(b",", first) < 0:
        return "."
    rows = map(body.cells, range(body.lines.size))
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


def _read_fast(
    body: _Rows, wanted: Sequence[int], width: int, decimal: str, surplus: bool
) -> dict[int, FloatArray] | None:
    """Parse a large table with the C engine; None for a small one, and for what the engine would misread.

    A quote may hide delimiters. Unless `surplus`, cells beyond the header must be blank.
    """
    stops = body.begins + body.lengths
    begin, end = int(body.begins[0]), int(stops[-1])
    if int(body.begins[-1]) - begin <= _SMALL or body.data.find(b'"', begin, end) >= 0:
        return None
    excess = 0 if surplus else int(body.fields.max()) - width
    if excess > (0 if body.delimiter == SPACES else _MOST_TRAILING):
        return None
    data = np.frombuffer(body.data, dtype=np.uint8)
    for place in range(1, excess + 1):
        if np.any(data[stops[body.fields - width >= place] - place] != ord(body.delimiter)):
            return None
    import pandas as pd

    # Exact to the last bit: the default from pandas 3.1 on, an option before.
    version = tuple(int(part) for part in pd.__version__.split(".")[:2])
    precision: Literal["round_trip"] | None = None if version >= (3, 1) else "round_trip"
    columns = {index: np.empty(body.lines.size) for index in wanted}
    piece = min(max((end - begin) // 32, _PARSED[0]), _PARSED[1])
    separator = r"\s+" if body.delimiter == SPACES else body.delimiter
    start = 0
    while start < body.lines.size:
        stop = max(int(np.searchsorted(body.begins, body.begins[start] + piece)), start + 1)
        rows = zip(body.begins[start:stop].tolist(), stops[start:stop].tolist(), strict=True)
        text = b"\n".join(body.data[first:last] for first, last in rows)
        try:
            frame = pd.read_csv(
                io.BytesIO(text), sep=separator, header=None, names=list(range(int(body.fields.max()))),
                usecols=list(wanted), nrows=stop - start, dtype=np.float64, engine="c", decimal=decimal,
                na_values=["", "nan", "NaN", "NAN"], keep_default_na=False, skip_blank_lines=False,
                encoding="utf-8", float_precision=precision,
            )  # fmt: skip
        except (ValueError, OverflowError, IndexError):
            return None
        if len(frame) != stop - start or not isinstance(frame.index, pd.RangeIndex):
            return None
        for index, values in columns.items():
            values[start:stop] = frame[index]
        start = stop
    return columns


def _read_slow(
    path: str, body: _Rows, names: Mapping[int, str], width: int, decimal: str, surplus: bool
) -> tuple[_Rows, dict[int, FloatArray]]:
    """Read row by row; return the lines that are rows, with their counts of cells, and their numbers."""
    rows = np.zeros(body.lines.size, dtype=np.bool_)
    columns = {index: np.full(body.lines.size, np.nan) for index in names}
    for row in range(body.lines.size):
        cells = body.cells(row)
        if not cells or cells[0].lstrip().startswith("#") or (len(cells) == 1 and not cells[0].strip()):
            continue
        rows[row], body.fields[row] = True, len(cells)
        if not surplus and any(cell.strip() for cell in cells[width:]):
            raise LogError(
                f"{path}, line {body.lines[row]}: {len(cells)} cells where the header names {width} columns; "
                "check the delimiter, or repair the line"
            )
        for index, into in columns.items():
            cell = cells[index] if index < len(cells) else ""
            try:
                into[row] = parse_number(cell, decimal)
            except ValueError:
                raise LogError(
                    f"{path}, line {body.lines[row]}: {shortened(cell)!r} in column "
                    f"{shortened(names[index], 80)!r} is not a number; repair the cell or leave it blank"
                ) from None
    if rows.all():
        return body, columns
    return body.part(rows), {index: values[rows] for index, values in columns.items()}
