"""Results on a terminal of any width: tables whose columns fold below each other, lines, JSON.

No number is ever cut.
"""

from collections.abc import Iterable
from dataclasses import replace

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table as RichTable
from rich.text import Text

from sysid import exact_json
from sysid.errors import printable
from sysid.report.table import Table

_STYLES = {"": "", "strong": "bold", "good": "green", "doubtful": "yellow", "bad": "red"}
# Width that rich draws around every cell [characters].
_AROUND = 2


def print_result(document: object, json: bool) -> bool:
    """Print a document as JSON where that is wanted; return whether it was."""
    if json:
        print(exact_json.dumps(document))
    return json


def console_of_lines() -> Console:
    """Return a console that breaks lines between words where it is a terminal, and elsewhere not at all."""
    console = Console()
    console.soft_wrap = not console.is_terminal
    return console


def print_lines(lines: Iterable[str], style: str = "") -> None:
    """Print plain sentences."""
    console = console_of_lines()
    for line in lines:
        console.print(Text(printable(line), style=style))


def print_table(table: Table, console: Console | None = None) -> None:
    """Print a table; where it is wider than the terminal, its columns follow below each other.

    The first column, which names the rows, is repeated. A column of numbers is shown whole; a column of words
    may wrap between two of them.
    """
    console = console or Console()
    table = replace(
        table,
        title=printable(table.title),
        caption=printable(table.caption),
        columns=tuple(replace(column, header=printable(column.header)) for column in table.columns),
        rows=tuple(tuple(replace(cell, text=printable(cell.text)) for cell in row) for row in table.rows),
    )
    texts = [[column.title, *(row[k].text for row in table.rows)] for k, column in enumerate(table.columns)]
    # Width of the longest line of every column, and the least width at which nothing of it is cut.
    widest = [max(cell_len(line) for text in column for line in text.split("\n")) for column in texts]
    needed = [
        whole
        if column.number
        else max((cell_len(word) for text in words for word in text.split()), default=1)
        for whole, column, words in zip(widest, table.columns, texts, strict=True)
    ]

    def too_wide(columns: list[int]) -> bool:
        return sum(needed[k] + _AROUND for k in columns) > console.width

    bundles: list[list[int]] = []
    for k in range(1, len(table.columns)):
        if table.columns[k].joined and bundles:
            bundles[-1].append(k)
        else:
            bundles.append([k])
    groups: list[list[int]] = [[0]]
    for bundle in bundles:
        # A group that is too wide by itself is split like single columns.
        for piece in [[k] for k in bundle] if too_wide([0, *bundle]) else [bundle]:
            if len(groups[-1]) > 1 and too_wide([*groups[-1], *piece]):
                groups.append([0])
            groups[-1] += piece
    for group in groups:
        spare = console.width - sum(needed[k] + _AROUND for k in group)
        widths = {}
        for k in group:
            extra = max(0, min(spare, widest[k] - needed[k]))
            widths[k], spare = needed[k] + extra, spare - extra
        part = _part(table, widths, first=group is groups[0], whole=len(groups) == 1)
        if spare >= 0:
            console.print(part)
        else:  # one column is too wide by itself: the terminal may break the line, but it stays whole
            whole = console.width - spare
            Console(file=console.file, width=whole, force_terminal=console.is_terminal or None).print(part)
    # The last part of a folded table may be a narrow one.
    if len(groups) > 1 and table.caption:
        console.print(Text(table.caption, style="table.caption"))


def _part(table: Table, widths: dict[int, int], *, first: bool, whole: bool) -> RichTable:
    """Return some columns of a table with their widths; brackets of units are text, not markup."""
    out = RichTable(
        title=Text(table.title) if table.title and first else None,
        caption=Text(table.caption) if table.caption and whole else None,
        title_justify="left",
        caption_justify="left",
        header_style="bold",
        # No vertical rules: five sets of eight parameters fit into 80 columns.
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    for k, width in widths.items():
        column = table.columns[k]
        out.add_column(Text(column.title), justify="right" if column.number else "left", width=width)
    for r, row in enumerate(table.rows):
        if r in table.rules:
            out.add_section()
        out.add_row(*(Text(row[k].text, style=_STYLES[row[k].tone]) for k in widths))
    return out
