"""Tables of what sets mean for landings: static limits, and what a changed design buys."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

from sysid.landing.design_study import LOWER_BOUNDS
from sysid.report.table import Column, Table, numbers, table, words


def limits_table(name: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return static limits, one row per set and thrust, as `workflows.static_limits` writes them."""
    creeps = any(row["rigid creep limit [deg]"] < row["rigid slide limit [deg]"] for row in rows)

    def degrees(header: str, key: str) -> Column:
        return numbers(header, lambda row: f"{row[key]:.1f}")

    return table(
        f"{name}: steepest slope that holds the drone [deg]",
        rows,
        (
            words("set", lambda row: str(row["set"])),
            numbers("thrust", lambda row: f"{row['reverse thrust [N]']:g}", "N"),
            degrees("rigid: slides", "rigid slide limit [deg]"),
            degrees("rigid: tips", "rigid tip limit [deg]"),
            degrees("rigid: creeps", "rigid creep limit [deg]") if creeps else None,
            degrees("own legs", "own legs [deg]"),
            words("", lambda row: row["own legs"]),
            degrees("set down", "own legs, set down at once [deg]"),
        ),
        "rigid: closed forms for stiff legs"
        + (" (creeps: at 0.05 m/s)" if creeps else "")
        + "; own legs: as fitted, on a slow ramp; set down: the same, put on the slope at once",
    )


def gains_table(
    name: str, base: Mapping[str, float], gains: Sequence[Mapping[str, Any]], bounds: Sequence[str]
) -> Table:
    """Return what each change of a design buys, most first.

    Parameters
    ----------
    base : mapping of str to float
        Largest safe slope of the sets as they are [deg], by touchdown speed.
    gains : sequence of mapping
        As `sysid.landing.design_study.DesignStudy.gains` returns them.
    bounds : sequence of str
        Speeds at which the sets as they are are safe up to the grid's edge.
    """
    rows = [("as it is", "", "", "", "", *(_slope(value, speed in bounds) for speed, value in base.items()))]
    for row in gains:
        slopes = row["largest safe slope [deg]"].items()
        rows.append(
            (
                row["change"], _values(row["best value"]), f"{row['gain [deg]']:+.1f}",
                _values(row["worst value"]), f"{row['loss [deg]']:+.1f}",
                *(_slope(value, speed in row[LOWER_BOUNDS]) for speed, value in slopes),
            )
        )  # fmt: skip
    heads = ("best", "gain [deg]", "worst", "loss [deg]", *base)
    note = "gain: in width of slopes landed on, mean over the speeds; columns of speeds: the largest safe "
    note += "slope [deg] at the best value"
    if bounds or any(row[LOWER_BOUNDS] for row in gains):
        note += "; ≥: safe up to the steepest slope tried, so gains are lower bounds; raise --slopes"
    return table(
        f"{name}: degrees of slope that a change buys",
        rows,
        (
            words("change", itemgetter(0)),
            *(numbers(head, itemgetter(i)) for i, head in enumerate(heads, start=1)),
        ),
        note,
        {1},
    )


def _values(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def _slope(value: float, at_edge: bool) -> str:
    return f"{'≥ ' if at_edge else ''}{value:.0f}" if math.isfinite(value) else "–"
