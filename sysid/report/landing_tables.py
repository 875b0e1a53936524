"""Tables of what sets mean for landings: static limits, and what a changed design buys."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from sysid.landing.design_study import LOWER_BOUNDS


def limits_table(name: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return static limits as a table, one row per set and thrust.

    Parameters
    ----------
    name : str
        Of the sets.
    rows : sequence of mapping
        As `sysid.workflows.static_limits.SetLimits.document` writes them.
    """
    creeps = any(row["rigid creep limit [deg]"] < row["rigid slide limit [deg]"] for row in rows)
    table = plain_table(
        f"{name}: steepest slope that holds the drone [deg]",
        "rigid: closed forms for stiff legs"
        + (" (creeps: at 0.05 m/s)" if creeps else "")
        + "; own legs: as fitted, on a slow ramp; set down: the same, put on the slope at once",
    )
    heads = ["set", "thrust [N]", "rigid: slides", "rigid: tips", "own legs", "", "set down"]
    for head in heads[:4] + (["rigid: creeps"] if creeps else []) + heads[4:]:
        table.add_column(Text(head), justify="left" if not head else "right")
    for row in rows:
        cells = [
            str(row["set"]),
            f"{row['reverse thrust [N]']:g}",
            f"{row['rigid slide limit [deg]']:.1f}",
            f"{row['rigid tip limit [deg]']:.1f}",
        ]
        if creeps:
            cells.append(f"{row['rigid creep limit [deg]']:.1f}")
        cells += [f"{row['own legs [deg]']:.1f}", row["own legs"]]
        cells.append(f"{row['own legs, set down at once [deg]']:.1f}")
        table.add_row(*(Text(cell) for cell in cells))
    return table


def plain_table(title: str, caption: str) -> Table:
    """Return an empty table in the manner of the other ones."""
    return Table(
        title=Text(title),
        caption=Text(caption),
        title_justify="left",
        caption_justify="left",
        header_style="bold",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )


def gains_table(
    name: str,
    base: Mapping[str, float],
    gains: Sequence[Mapping[str, Any]],
    bounds: Sequence[str],
) -> Table:
    """Return what each change of a design buys, most first.

    Parameters
    ----------
    name : str
        Of the sets.
    base : mapping of str to float
        Largest safe slope of the sets as they are [deg], by touchdown speed.
    gains : sequence of mapping
        As `sysid.landing.design_study.DesignStudy.gains` returns them.
    bounds : sequence of str
        Speeds at which the sets as they are are safe up to the grid's edge.
    """
    cut = bool(bounds) or any(row[LOWER_BOUNDS] for row in gains)
    table = plain_table(
        f"{name}: degrees of slope that a change buys",
        "gain: in width of slopes landed on, mean over the speeds; columns of speeds: the largest safe slope "
        "[deg] at the best value"
        + (
            "; ≥: safe up to the steepest slope tried, so gains are lower bounds; raise --slopes"
            if cut
            else ""
        ),
    )
    for head in ("change", "best", "gain [deg]", "worst", "loss [deg]", *base):
        table.add_column(Text(head), justify="left" if head == "change" else "right")
    first = ("as it is", "", "", "", "", *(_slope(v, speed in bounds) for speed, v in base.items()))
    table.add_row(*(Text(cell) for cell in first))
    table.add_section()
    for row in gains:
        cells = (
            row["change"],
            _values(row["best value"]),
            f"{row['gain [deg]']:+.1f}",
            _values(row["worst value"]),
            f"{row['loss [deg]']:+.1f}",
            *(_slope(v, at in row[LOWER_BOUNDS]) for at, v in row["largest safe slope [deg]"].items()),
        )
        table.add_row(*(Text(cell) for cell in cells))
    return table


def _values(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def _slope(value: float, at_edge: bool) -> str:
    return f"{'≥ ' if at_edge else ''}{value:.0f}" if math.isfinite(value) else "–"
