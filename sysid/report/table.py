"""One model of a table: `sysid.report.fold` prints it on a terminal, `sysid.report.html` on a page."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from typing import Any, Literal

from sysid.documents import rounded

# Meaning of a cell's colour; a reader who sees no colours loses nothing.
Tone = Literal["", "strong", "good", "doubtful", "bad"]
NONE = "—"


@dataclass(frozen=True)
class Cell:
    """One cell: plain text, never markup, and its tone."""

    text: str
    tone: Tone = ""


@dataclass(frozen=True)
class TableColumn:
    """One column and how a row of the data fills it.

    The unit is printed behind the header in brackets. Numbers are aligned to the right, never broken or cut.
    A `joined` column belongs to the one before it: a narrow terminal shows both beside each other.
    """

    header: str
    cell: Callable[[Any], str | Cell]
    unit: str = ""
    number: bool = False
    joined: bool = False

    @property
    def title(self) -> str:
        """Header and unit."""
        return name_and_unit(self.header, self.unit)


@dataclass(frozen=True)
class Table:
    """A table of text between a title and a caption; the first column names the rows.

    A line is drawn above the rows whose numbers are in `rules`.
    """

    title: str
    columns: tuple[TableColumn, ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""
    rules: frozenset[int] = frozenset()


def table(
    title: str, rows: Iterable[Any], columns: Sequence[TableColumn | None], caption: str = "",
    rules: Iterable[int] = (),
) -> Table:  # fmt: skip
    """Fill a table: every column that is not None, for every row of the data."""
    chosen = tuple(column for column in columns if column is not None)
    contents = (tuple(column.cell(row) for column in chosen) for row in rows)
    filled = tuple(tuple(c if isinstance(c, Cell) else Cell(c) for c in row) for row in contents)
    return Table(title, chosen, filled, caption, frozenset(rules))


def listed(
    title: str, rows: Iterable[Sequence[str | Cell]], heads: Sequence[str], caption: str = "",
    rules: Iterable[int] = (), *, texts: int = 1,
) -> Table:  # fmt: skip
    """Return a table of rows of cells; the first `texts` columns are words, all others numbers."""
    columns = [TableColumn(head, itemgetter(k), number=k >= texts) for k, head in enumerate(heads)]
    return table(title, rows, columns, caption, rules)


words, numbers = partial(TableColumn, number=False), partial(TableColumn, number=True)


def name_and_unit(name: str, unit: str) -> str:
    """Return ``name [unit]``; the name alone where the unit is 1."""
    return name if unit in ("", "1") else f"{name} [{unit}]"


def number(value: float | None, digits: int = 4) -> str:
    """Return a number, or a dash where there is none."""
    return NONE if value is None or not math.isfinite(value) else f"{value:.{digits}g}"


def percent(value: float | None, digits: int = 2) -> str:
    """Return a share in percent without the sign, or a dash."""
    return NONE if value is None or not math.isfinite(value) else f"{100 * value:.{digits}f}"


def half_width(value: float) -> str:
    """Return a relative half-width in percent; beyond ten times the value its digits mean nothing."""
    if not math.isfinite(value):
        return "open"
    return f"± {rounded(100 * value, 2)}" if value < 10 else "> 1000"


def mean_sigma(cell: tuple[float, float] | None) -> str:
    """Return `mean ± σ`, σ with two digits and the mean to the same place; a dash where there is no mean.

    The mean has decimals up to its fourth significant digit; a σ beyond them is printed with one digit.
    """
    if cell is None or None in cell or not math.isfinite(cell[0]):
        return NONE
    mean, sigma = cell
    if not math.isfinite(sigma) or sigma == 0:
        return rounded(mean)
    exponent = math.floor(math.log10(max(abs(mean), sigma)))
    scale = 10.0**exponent if exponent < -3 or exponent > 6 else 1.0
    power = "" if scale == 1.0 else f"e{exponent}"
    digits = 1 - math.floor(math.log10(sigma / scale))
    places = max(0, 3 - math.floor(math.log10(abs(mean / scale)))) if mean else digits
    if digits > places and sigma < abs(mean):
        # Runs that agree to six digits do not make the mean known to as many.
        value = f"{mean / scale:.{places}f}"
        if sigma / scale < 1e-6:
            return f"{value}{power} (σ < 1e{(exponent if power else 0) - 6})"
        text = f"{value} ± {sigma / scale:.1g}"
    else:
        text = " ± ".join(f"{round(value / scale, digits):.{max(digits, 0)}f}" for value in (mean, sigma))
    return f"({text}){power}" if power else text
