"""Mean ± σ over the sets, in the layout of the paper's Table II."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sysid.parameter_sets import COMBINATIONS, ParameterRecord, ParameterSets


@dataclass(frozen=True)
class MeanRow:
    """One row of Table II.

    Parameters
    ----------
    measured : tuple of float
        Empty, one measured value, or the two ends of an independently measured range [unit].
    fitted : tuple
        Per fit: (mean, σ) [unit], or None where that fit did not search the parameter.
    """

    name: str
    symbol: str
    unit: str
    measured: tuple[float, ...]
    fitted: tuple[tuple[float, float] | None, ...]


def mean_table(*fits: ParameterSets) -> tuple[MeanRow, ...]:
    """Return the rows of Table II for one or more fits of one kind side by side.

    Rows are the parameters that at least one fit found or measured; σ is divided by S - 1.
    """
    order: dict[str, ParameterRecord] = {}
    for sets in fits:
        for record in sets.parameters:
            if record.status in ("free", "measured") or record.name in sets.settings.get(COMBINATIONS, ()):
                order.setdefault(record.name, record)
    return tuple(_row(name, record, fits) for name, record in order.items())


def _row(name: str, record: ParameterRecord, fits: Sequence[ParameterSets]) -> MeanRow:
    measured: tuple[float, ...] = ()
    fitted: list[tuple[float, float] | None] = []
    for sets in fits:
        cell = None
        if name in sets.names and len(sets):
            i = sets.names.index(name)
            column = sets.parameters[i]
            if column.status == "free" or name in sets.settings.get(COMBINATIONS, ()):
                cell = (float(sets.mean[i]), float(sets.sigma[i]))
                measured = measured or (column.measured_range or ())
            elif column.status == "measured":
                measured = (float(sets.mean[i]),)
        fitted.append(cell)
    return MeanRow(name, record.symbol, record.unit, measured, tuple(fitted))


def mean_sigma(cell: tuple[float, float] | None) -> str:
    """Return `mean ± σ` as text, σ with two digits and the mean to the same place; a dash for None.

    The mean has decimals up to its fourth significant digit; a σ beyond them is printed with one digit.
    """
    if cell is None:
        return "—"
    mean, sigma = cell
    if not math.isfinite(sigma) or sigma == 0 or not math.isfinite(mean):
        return plain(mean)
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


def plain(value: float, digits: int = 4) -> str:
    """Return a number as text with `digits` digits; an exponent only below 1e-4 and from 1e7 on."""
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < 1e7 else text
