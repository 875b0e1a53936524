"""Tables of what sets mean for landings: static limits, and what a changed design buys."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from sysid.landing.design_study import DesignStudy
from sysid.report.table import Table, TableColumn, listed, numbers, table, words


def limits_table(name: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return static limits, as `workflows.static_limits` writes them; sets that read alike share a row."""
    alike: dict[tuple[object, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        read = (f"{v:.1f}" if key.endswith("deg") else v for key, v in row.items() if key != "set")
        alike.setdefault(tuple(read), []).append(row)
    count = len({row["set"] for row in rows})

    def sets(same: Sequence[Mapping[str, Any]]) -> str:
        return "all" if len(same) == count > 1 else ", ".join(str(row["set"]) for row in same)

    rows = [{**same[0], "set": sets(same)} for same in alike.values()]
    creeps = any(row["rigid_creep_deg"] < row["rigid_slide_deg"] for row in rows)

    def degrees(header: str, key: str) -> TableColumn:
        return numbers(header, lambda row: f"{row[key]:.1f}")

    return table(
        f"{name}: steepest slope that holds the drone [deg]",
        rows,
        (
            words("set", lambda row: row["set"]),
            numbers("thrust", lambda row: f"{row['reverse_thrust']:g}", "N"),
            degrees("rigid: slides", "rigid_slide_deg"),
            degrees("rigid: tips", "rigid_tip_deg"),
            degrees("rigid: creeps", "rigid_creep_deg") if creeps else None,
            degrees("bending legs", "set_down_deg"),
            words("", lambda row: row["set_down_how"]),
        ),
        "rigid: closed forms for stiff legs"
        + (" (creeps: at 0.05 m/s)" if creeps else "")
        + "; bending legs: as fitted, released on the slope at rest",
    )


def maps_table(counts: Sequence[Mapping[str, Any]]) -> Table:
    """Return maps in numbers, from `LandingMap.summary`."""
    rows = [
        (
            f"{entry['surface'].upper()}, {entry['controller']}",
            *(at_least(*slope, "g") for slope in zip(entry["steepest_deg"], entry["at_edge"], strict=True)),
            f"{entry['mean_time']:.2f}",
            f"{entry['mean_distance']:.2f}",
            "–" if entry["uncertain"] is None else f"{100 * entry['uncertain']:.2f}",
        )
        for entry in counts
    ]
    heads = (
        "map",
        *(f"{speed:g}" for speed in counts[0]["speeds"]),
        "time [s]",
        "distance [m]",
        "uncertain [%]",
    )
    return listed(
        f"Slope [deg] up to which {counts[0]['quorum']} land, by speed [m/s]",
        rows,
        heads,
        "time, distance: mean from touchdown to rest; uncertain: cells that half the tolerance changes",
    )


def gains_table(study: DesignStudy) -> Table:
    """Return what each change of a design buys, most first."""
    gains, steepest, edge = study.gains(), study.steepest[0].tolist(), study.at_edge[0].tolist()
    rows = [("as it is", "", "", "", "", *map(at_least, steepest, edge))]
    rows += [
        (
            row["change"], _values(row["best"]), f"{row['gain_deg']:+.1f}",
            _values(row["worst"]), f"{row['loss_deg']:+.1f}",
            *map(at_least, row["steepest_deg"], row["at_edge"]),
        )
        for row in gains
    ]  # fmt: skip
    speeds = (f"{speed:g} m/s" for speed in study.settings.speeds)
    heads = ("change", "best", "gain [deg]", "worst", "loss [deg]", *speeds)
    note = "gain: in width of slopes landed on, mean over the speeds; columns of speeds: the largest safe "
    step = max(b - a for a, b in pairwise(study.settings.slopes_deg))
    note += (
        f"slope [deg] at the best value; slopes are known to ± {step / 2:g} deg, half a step of their grid"
    )
    if any(any(bounds) for bounds in (edge, *(row["at_edge"] for row in gains))):
        note += "; ≥: safe up to the steepest slope tried, so gains are lower bounds; raise --slopes"
    return listed(f"{study.name}: degrees of slope that a change buys", rows, heads, note, {1})


def _values(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def at_least(value: float, at_edge: bool, form: str = ".0f") -> str:
    """Return the steepest slope [deg] of a row; at the edge of what was tried it is a lower bound."""
    return f"{'≥ ' if at_edge else ''}{value:{form}}" if math.isfinite(value) else "–"
