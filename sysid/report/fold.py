"""Results on a terminal of any width: tables whose columns fold below each other, lines, JSON.

No number is ever cut.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.measure import Measurement
from rich.table import Column
from rich.table import Table as RichTable
from rich.text import Text

from sysid import exact_json
from sysid.report.table import Table

# Wider than any table.
_FREE = 10_000
_STYLES = {"": "", "strong": "bold", "good": "green", "doubtful": "yellow", "bad": "red"}


def print_result(document: object, json: bool) -> bool:
    """Print a document as JSON where that is wanted; return whether it was."""
    if json:
        print(exact_json.dumps(document))
    return json


def print_lines(lines: Iterable[str], style: str = "") -> None:
    """Print plain sentences; the terminal breaks them."""
    console = Console(soft_wrap=True)
    for line in lines:
        console.print(Text(line, style=style))


def print_table(table: Table, console: Console | None = None) -> None:
    """Print a table; where it is wider than the terminal, its columns follow below each other.

    The first column, which names the rows, is repeated. A column of numbers and one that must not wrap are
    shown whole; a column of words may wrap between two of them.
    """
    console = console or Console()
    for part in folded(rich_table(table), console.width):
        needed = _whole_width(part)
        if needed <= console.width:
            console.print(part)
        else:  # one column is too wide by itself: the terminal may break the line, but it stays whole
            wide = Console(file=console.file, width=needed, force_terminal=console.is_terminal or None)
            wide.print(part)


def rich_table(table: Table) -> RichTable:
    """Return a table for rich; brackets of units are text, not markup."""
    out = RichTable(
        title=Text(table.title) if table.title else None,
        caption=Text(table.caption) if table.caption else None,
        title_justify="left",
        caption_justify="left",
        header_style="bold",
        # No vertical rules: five sets of eight parameters fit into 80 columns.
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    for column in table.columns:
        out.add_column(Text(column.title), justify="right" if column.number else "left")
    for r, row in enumerate(table.rows):
        if r in table.rules:
            out.add_section()
        out.add_row(*(Text(cell.text, style=_STYLES[cell.tone]) for cell in row))
    return out


def folded(table: RichTable, width: int) -> list[RichTable]:
    """Return tables of `table`'s columns, each no wider than `width` where that is possible."""
    if not table.columns or _whole_width(table) <= width:
        return [table]
    widest = [_widest(column) for column in table.columns]
    needed = [_needed(column) for column in table.columns]
    # What rich puts around the cells of one column, and around all of them.
    around = (_whole_width(table) - sum(widest)) / len(table.columns)
    groups: list[list[int]] = []
    for index in range(1, len(table.columns)):
        last = groups[-1] if groups else []
        taken = sum(needed[k] + around for k in (0, *last, index))
        if last and taken <= width:
            last.append(index)
        else:
            groups.append([index])
    parts = []
    for group in groups or [[]]:
        chosen = [0, *group]
        spare = int(width - sum(needed[k] + around for k in chosen))
        part = _of_columns(table, chosen)
        for column, index in zip(part.columns, chosen, strict=True):
            extra = max(0, min(spare, widest[index] - needed[index]))
            column.width, spare = needed[index] + extra, spare - extra
        if group is not (groups or [[]])[0]:
            part.title = None
        if group is not (groups or [[]])[-1]:
            part.caption = None
        parts.append(part)
    return parts


def _lines(column: Column) -> list[str]:
    cells = [column.header, *column.cells]
    return [
        line for cell in cells for line in (cell.plain if isinstance(cell, Text) else str(cell)).split("\n")
    ]


def _widest(column: Column) -> int:
    return max(map(cell_len, _lines(column)))


def _needed(column: Column) -> int:
    """Return the least width at which nothing of a column is cut."""
    if column.justify == "right" or column.no_wrap:
        return _widest(column)
    return max((cell_len(word) for line in _lines(column) for word in line.split()), default=1)


def _whole_width(table: RichTable) -> int:
    bare = copy.copy(table)
    bare.title = bare.caption = None  # which wrap by themselves
    console = Console(width=_FREE)
    return Measurement.get(console, console.options, bare).maximum


def _of_columns(table: RichTable, chosen: list[int]) -> RichTable:
    part = copy.copy(table)
    part.columns = []
    for place, index in enumerate(chosen):
        column = copy.copy(table.columns[index])
        column._index = place
        part.columns.append(column)
    return part
