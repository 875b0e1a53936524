"""One model of a table: `sysid.report.fold` prints it on a terminal, `sysid.report.html` on a page."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

# What a cell says beside its text; a reader who sees no colours loses nothing.
Tone = Literal["", "strong", "good", "doubtful", "bad"]
NONE = "—"


@dataclass(frozen=True)
class Cell:
    """One cell: plain text, never markup, and its tone."""

    text: str
    tone: Tone = ""


@dataclass(frozen=True)
class Column:
    """One column and how a row of the data fills it.

    The unit is printed behind the header in brackets. Numbers are aligned to the right, never broken or cut.
    """

    header: str
    cell: Callable[[Any], str | Cell]
    unit: str = ""
    number: bool = False

    @property
    def title(self) -> str:
        """Header and unit."""
        return with_unit(self.header, self.unit)


@dataclass(frozen=True)
class Table:
    """A table of text between a title and a caption; the first column names the rows.

    A line is drawn above the rows whose numbers are in `rules`.
    """

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""
    rules: frozenset[int] = frozenset()


def table(
    title: str, rows: Iterable[Any], columns: Sequence[Column | None], caption: str = "",
    rules: Iterable[int] = (),
) -> Table:  # fmt: skip
    """Fill a table: every column that is not None, for every row of the data."""
    chosen = tuple(column for column in columns if column is not None)
    contents = (tuple(column.cell(row) for column in chosen) for row in rows)
    filled = tuple(tuple(c if isinstance(c, Cell) else Cell(c) for c in row) for row in contents)
    return Table(title, chosen, filled, caption, frozenset(rules))


def words(header: str, cell: Callable[[Any], str | Cell], unit: str = "") -> Column:
    """Return a column of words."""
    return Column(header, cell, unit)


def numbers(header: str, cell: Callable[[Any], str | Cell], unit: str = "") -> Column:
    """Return a column of numbers."""
    return Column(header, cell, unit, number=True)


def with_unit(name: str, unit: str) -> str:
    """Return ``name [unit]``; a number without unit stands alone."""
    return name if unit in ("", "1") else f"{name} [{unit}]"


def number(value: float | None, digits: int = 4) -> str:
    """Return a number, or a dash where there is none."""
    return NONE if value is None or not math.isfinite(value) else f"{value:.{digits}g}"


def percent(value: float | None, digits: int = 2) -> str:
    """Return a share in percent without the sign, or a dash."""
    return NONE if value is None or not math.isfinite(value) else f"{100 * value:.{digits}f}"
