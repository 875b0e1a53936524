"""Tables of numbers inside text logs: the header line, and a fast, exact reading of the rows.

Which rows are cut, short or blank is decided here; how their cells become numbers is
`sysid.loaders.table_rows`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.columns import listing, split_label
from sysid.loaders.table_rows import Body, body_end, decimal_mark, measure, parse_number, read_rows
from sysid.loaders.text import SPACES, Text, sniff_delimiter, split_line
from sysid.recording import FloatArray

# Where a header line may stand: vendors put a few lines before it, nobody puts a hundred.
_HEADER_SEARCH = 100


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
    begin = _behind_titles(lines[:_HEADER_SEARCH])
    for index, line in enumerate(lines[:_HEADER_SEARCH]):
        if index < begin or not line.strip():
            continue
        names = _header_cells(line, delimiter := sniff_delimiter(line))
        if line.lstrip().startswith("#"):
            below = next((text for text in lines[index + 1 :] if text.strip()), "")
            if delimiter == SPACES:
                names = _header_cells(line.lstrip().lstrip("#"), delimiter)
            cells = split_line(below, delimiter)
            if len(names) < 2 or len(cells) != len(names) or not _all_numeric(cells):
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
        if len(filled) == 1 and not _all_numeric(filled):
            continue
        below = next((text for text in lines[index + 1 :] if text.strip()), "")
        cells, names = split_line(below, delimiter), split_line(line, delimiter)
        named = len(filled) > 1 and not any(_all_numeric([cell]) for cell in filled)
        first = cells[0] if delimiter == "," else cells[0].replace(",", ".", 1)
        return index if named and len(cells) == len(names) and _all_numeric([first]) else 0
    return 0


def _header_cells(line: str, delimiter: str) -> list[str]:
    """Return the names in a header line; between spaces a unit in brackets belongs to the name before it."""
    names = split_line(line, delimiter)
    if delimiter != SPACES:
        return names
    joined: list[str] = []
    for name in names:
        if joined and name[:1] in "([":
            joined[-1] += f" {name}"
        else:
            joined.append(name)
    return joined


def _renamed(path: str, names: Sequence[str], columns: Mapping[str, object]) -> list[str]:
    """Return the names of a header with some replaced; a unit in brackets stays with its column."""
    out = list(names)
    for new, stated in columns.items():
        place = names.index(stated) if isinstance(stated, str) and stated in names else -1
        if isinstance(stated, int) and not isinstance(stated, bool) and 1 <= stated <= len(names):
            place = stated - 1
        stems = [split_label(name)[0] for name in names]
        if place < 0 and isinstance(stated, str) and stems.count(split_label(stated)[0]) == 1:
            place = stems.index(split_label(stated)[0])
        if place < 0:
            raise LogError(
                f"{path}: columns says that {new} is {stated!r}, which is neither a column nor its number "
                f"from 1; found {listing(names)}"
            )
        unit = split_label(names[place])[1]
        out[place] = str(new) if unit is None else f"{new} ({unit})"
    return out


def table_head(
    text: Text, columns: Sequence[str] | Mapping[str, object] | None = None, *, renames: bool = True
) -> TableHead:
    """Return the header of a table.

    `columns` are names that the user declares for a log without header or with a wrong one: all of them in
    order, or new name -> name in the header (or its number from 1). `renames`: the format has an option for
    them, which a message may advise. A missing header and a wrong number of names are a LogError.
    """
    lines = list(text.lines(_HEADER_SEARCH))
    header = find_header([line for _, _, line in lines])
    if header is None:
        raise LogError(
            f"{text.path}: only blank or comment lines; expected a header line and rows of numbers"
        )
    index, delimiter, names = header
    number, offset, _ = lines[index]
    headless = _all_numeric(names)
    if headless:
        number, offset = number - 1, lines[index - 1][1] if index else 0
    if headless and (columns is None or isinstance(columns, Mapping)):
        advice = (
            "declare all of them in order, columns = [...]"
            if renames
            else "put the instrument's header line back"
        )
        raise LogError(
            f"{text.path}, line {lines[index][0]}: found numbers where the header line should name the "
            f"columns; {advice}"
        )
    if isinstance(columns, Mapping):
        names = _renamed(text.path, names, columns)
    elif columns is not None:
        if isinstance(columns, str) or not isinstance(columns, Sequence):
            raise LogError(f"{text.path}: columns = {columns!r} is no list of names")
        if len(columns) != len(names):
            raise LogError(
                f"{text.path}: columns declares {len(columns)} names but line {lines[index][0]} has "
                f"{len(names)} cells; name every column, in order"
            )
        names = [str(name) for name in columns]
    trailing = 0 if delimiter == SPACES else len(split_line(lines[index][2], delimiter)) - len(names)
    return TableHead(tuple(names), delimiter, number, offset, trailing)


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

    def keep(self, mask: NDArray[np.bool_]) -> None:
        """Keep only the rows where `mask` is true."""
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
) -> Numbers:
    """Parse the wanted columns of a table.

    A blank cell or a written ``nan`` is NaN. A last line that was cut is left out; a row that lacks wanted
    cells keeps its place with NaN in all of them, because the last number of a cut row is not to be trusted,
    and so does one with more cells than the header and most rows have, whose numbers are not below their
    names.

    Parameters
    ----------
    text, head, wanted
        The log, its header, and column numbers from 0.
    least : int, optional
        Cells that a row must have to be trusted; by default as many as the header names.
    surplus : bool
        Rows may have filled cells beyond the header, behind words in column `free_text`.
    free_text : int, optional
        Column of words, which may hold delimiters.
    decimal : str, optional
        Decimal mark; judged from the first cells that hold one by default.
    ends : sequence of int
        Numbers of cells after which a row may end, with a delimiter: what it holds is trusted.

    Raises
    ------
    LogError
        When there are no rows, a cell is not a number, or most rows do not fit the header.
    """
    path = text.path
    empty = LogError(f"{path}: no rows of numbers after line {max(head.line, 1)}; the log is empty")
    wanted = sorted(set(wanted))
    least = len(head.names) if least is None else least
    end, closed = body_end(text.data, head.offset, head.delimiter)
    if end <= head.offset:
        raise empty
    body = measure(text.data, head.offset, end, head.delimiter, head.line + 1)
    if not body.lines.size:
        raise empty
    notes = list(text.notes)
    if decimal is None:
        decimal = decimal_mark(path, body, wanted)
    open_end = not closed
    if open_end and not _is_whole(body.cells(-1), wanted, least, decimal):
        notes.append(note("last-line-cut", f"line {body.lines[-1]}, the last, is cut and was left out"))
        if body.lines.size == 1:
            raise empty
        body = body.part(slice(0, -1))
        open_end = False
    elif open_end:
        sentence = f"line {body.lines[-1]}, the last, has no line end: its last number may be cut"
        notes.append(note("last-line-open", sentence))

    names = {index: head.names[index] for index in wanted}
    columns = read_rows(path, body, names, len(head.names), decimal, surplus)
    if not body.lines.size:
        raise empty
    notes += _blank_short(path, body, columns, least, free_text, ends)
    shifted = _shifted(path, body, head, wanted, surplus, free_text)
    if shifted.size:
        for values in columns.values():
            values[shifted] = np.nan
        sentence = (
            f"rows with a cell too many, whose numbers are not below their names: {shifted.size} (first: "
            f"line {body.lines[shifted[0]]}); taken as missing"
        )
        notes.append(note("shifted-rows", sentence))
    infinite = sum(int(np.count_nonzero(np.isinf(values))) for values in columns.values())
    if infinite:
        for values in columns.values():
            values[np.isinf(values)] = np.nan
        sentence = f"cells that hold an infinite number: {infinite}; taken as missing"
        notes.append(note("infinite-cells", sentence))
    return Numbers(columns, body.lines, notes, open_end=open_end)


def _blank_short(
    path: str,
    body: Body,
    columns: Mapping[int, FloatArray],
    least: int,
    free_text: int | None,
    ends: Sequence[int],
) -> list[Finding]:
    """Blank rows with too few cells, and return a note; refuse a table where most are."""
    lines, fields = body.lines, body.fields
    short = fields < least
    if free_text is not None:
        for row in np.flatnonzero(short & (fields == free_text + 1)).tolist():
            short[row] = not _is_words(body.cells(row), free_text)
    for row in np.flatnonzero(short & np.isin(fields - 1, np.asarray(ends, dtype=np.int64))).tolist():
        cells = body.cells(row)
        short[row] = bool(cells[-1].strip()) or not all(cell.strip() for cell in cells[:-1])
    if not short.any():
        return []
    first = int(np.argmax(short))
    if short.sum() * 2 > short.size:
        raise LogError(
            f"{path}, line {lines[first]}: {fields[first]} cells where {least} are expected, as in "
            "most rows; check the delimiter and the header"
        )
    for values in columns.values():
        values[short] = np.nan
    sentence = (
        f"rows with fewer than {least} cells: {int(short.sum())} (first: line {lines[first]}); "
        "taken as missing"
    )
    return [note("short-rows", sentence)]


def promised_note(header: str, stated: object, rows: int) -> list[Finding]:
    """Return a note where a header promises more rows (`stated`, by the name `header`) than there are.

    A log cut at the end of a row shows no other trace. What is no count promises nothing.
    """
    try:
        promised = int(str(stated).strip())
    except ValueError:
        return []
    if promised <= rows:
        return []
    sentence = f"{header} is {promised} but {rows} rows are there: the log was cut, or rows were left out"
    return [note("fewer-rows-than-stated", sentence)]


def _is_words(cells: Sequence[str], column: int | None) -> bool:
    return column is not None and column < len(cells) and not _all_numeric([cells[column].strip() or "0"])


def _appended(cells: Sequence[str], free_text: int | None) -> bool:
    """Return whether the cells too many are behind those that are read: words, or what a script added.

    With a delimiter too many in front, the number that belongs before the words stands in their place.
    """
    if free_text is None or _is_words(cells, free_text):
        return free_text is not None
    return not cells[free_text].strip() and any(cell.strip() for cell in cells[free_text + 1 :])


def _shifted(
    path: str, body: Body, head: TableHead, wanted: Sequence[int], surplus: bool, free_text: int | None
) -> NDArray[np.int64]:
    """Return the rows with more cells than there should be, by a delimiter too many."""
    width, fields = len(head.names), body.fields
    if head.delimiter == SPACES:
        return np.empty(0, dtype=np.int64)
    # Many programs end each row, but not the header, with a delimiter; a lost body may leave short rows.
    full = fields[fields >= width]
    usual = int(np.bincount(full).argmax()) if full.size else width
    most = max(width + head.trailing, min(usual, width + 1) if surplus else usual)
    long = [(row, body.cells(row)) for row in np.flatnonzero(fields > most).tolist()]
    if sum(not _is_words(cells, free_text) for _, cells in long) * 2 > fields.size:
        row, cells = long[0]
        raise LogError(
            f"{path}, line {body.lines[row]}: {len(cells)} cells where the header has "
            f"{width + head.trailing}, as in most rows; check the header for a name that is lost"
        )
    shifted = [row for row, cells in long if not _appended(cells, free_text)]
    if free_text is not None and width == free_text + 1 and full.size * 2 < fields.size:
        # Most rows end before the words; in some a number stands there and a blank in front of it.
        for row in np.flatnonzero(fields == width).tolist():
            cells = body.cells(row)
            blank = any(not cells[column].strip() for column in wanted if column)  # 0 may be an unused clock
            if blank and cells[free_text].strip() and not _is_words(cells, free_text):
                shifted.append(row)
    return np.array(sorted(shifted), dtype=np.int64)


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
