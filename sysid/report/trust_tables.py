"""Tables of verdicts, intervals, validations and comparisons for a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

_NONE = "—"
_COLOUR = {"well": "green", "weakly": "yellow", "not identifiable": "red"}


def table(title: str, caption: str | None, columns: Sequence[tuple[str, bool]]) -> Table:
    """Return an empty table; columns are (title, is a number)."""
    out = Table(
        title=Text(title),
        caption=Text(caption) if caption else None,
        title_justify="left",
        caption_justify="left",
        header_style="bold",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    for name, number in columns:
        out.add_column(name, justify="right" if number else "left")
    return out


def number(value: float | None, digits: int = 4) -> str:
    """Return a number, or a dash where there is none."""
    return _NONE if value is None or not math.isfinite(value) else f"{value:.{digits}g}"


def percent(value: float | None, digits: int = 2) -> str:
    """Return a share in percent without the sign, or a dash."""
    return _NONE if value is None or not math.isfinite(value) else f"{100 * value:.{digits}f}"


def half_width(value: float) -> str:
    """Return a relative half-width; beyond ten times the value its digits mean nothing."""
    if not math.isfinite(value):
        return "open"
    return f"± {100 * value:.2g} %" if value < 10 else "> 1000 %"


def interval(low: float, high: float, opened: Sequence[bool]) -> str:
    """Return an interval; an end that the data leave open is marked."""
    left = f"(≤ {low:.4g}" if opened[0] else f"{low:.4g}"
    right = f"≥ {high:.4g})" if opened[1] else f"{high:.4g}"
    return f"{left} … {right}"


def _heading(row: Mapping[str, Any]) -> str:
    unit = row["unit"]
    return row["symbol"] if unit in ("", "1") else f"{row['symbol']} [{unit}]"


def _partners(row: Mapping[str, Any]) -> str:
    return ", ".join(f"{one['name']} {one['correlation']:+.2f}" for one in row["partners"][:2]) or _NONE


def verdict_text(word: str) -> Text:
    """Return a verdict in its colour."""
    return Text(word, style=_COLOUR.get(word, ""))


def uncertainty_table(document: Mapping[str, Any]) -> Table:
    """Return Table II with what the data leave open: value, mean ± σ of the sets, interval, verdict.

    Parameters
    ----------
    document : mapping
        ``trust`` of `sysid.trust.documents`.
    """
    measured = any(row["measured"] for row in document["parameters"])
    columns = [("parameter", False), ("value", True), ("sets: mean ± σ", True), ("95 % interval", True)]
    columns += [("half-width", True), ("verdict", False), ("trades with", False)]
    drawn = any(row["bootstrap_95"] for row in document["parameters"])
    columns += [("bootstrap 95 %", True)] if drawn else []
    columns += [("measured", True)] if measured else []
    out = table(
        f"{document['fit']}: what the data leave open",
        "(≤ or ≥): open, the data do not end the interval inside the bounds; * the best set ends at a bound",
        columns,
    )
    for row in document["parameters"]:
        boot = row["bootstrap_95"]
        cells: list[str | Text] = [
            Text(_heading(row)),
            Text(number(row["value"]) + ("*" if row["at_bound"] else "")),
            Text(f"{number(row['mean'])} ± {number(row['sigma'], 2)}"),
            Text(interval(row["interval_95"][0], row["interval_95"][1], row["open_95"])),
            Text(half_width(row["half_width"])),
            verdict_text(row["verdict"]),
            Text(_partners(row)),
        ]
        if drawn:
            cells.append(Text(_NONE if boot is None else f"{boot[0]:.4g} … {boot[1]:.4g}"))
        if measured:
            own = row["measured"]
            cells.append(Text(_NONE if own is None else f"{own[0]:.4g} to {own[1]:.4g}"))
        out.add_row(*cells)
    return out


def narrow_table(document: Mapping[str, Any]) -> Table:
    """Return the 68 % intervals, the linearized deviation, and why an interval is doubtful."""
    out = table(
        f"{document['fit']}: 68 % intervals", None,
        [("parameter", False), ("refined", True), ("68 % interval", True), ("linearized σ", True),
         ("doubt", False)],
    )  # fmt: skip
    for row in document["parameters"]:
        out.add_row(
            Text(_heading(row)), number(row["refined"]),
            Text(interval(row["interval_68"][0], row["interval_68"][1], row["open_68"])),
            number(row["fisher_sigma"], 2), Text(row["doubt"] or _NONE),
        )  # fmt: skip
    return out


def spread_table(document: Mapping[str, Any]) -> Table:
    """Return how far the predictions of the sets lie apart, rms and largest per trial and channel."""
    spread = document["spread"]
    heads = [
        (name if unit in ("", "1") else f"{name} [{unit}]", True)
        for name, unit in zip(spread["channels"], spread["units"], strict=True)
    ]
    out = table(
        f"{document['fit']}: predictions of the sets around their mean", "rms, largest",
        [("trial", False), ("use", False), *heads],
    )  # fmt: skip
    for row in spread["trials"]:
        pairs = zip(row["rms"], row["largest"], strict=True)
        cells = [f"{number(float(a), 2)}, {number(float(b), 2)}" for a, b in pairs]
        out.add_row(Text(row["name"]), Text(row["use"]), *(Text(cell) for cell in cells))
    return out


def noise_table(document: Mapping[str, Any]) -> Table:
    """Return the residuals per channel beside the noise floor, and how many samples are independent."""
    out = table(
        f"{document['fit']}: residuals", None,
        [("channel", False), ("unit", False), ("rms residual", True), ("noise floor", True), ("ratio", True),
         ("samples", True), ("independent", True)],
    )  # fmt: skip
    for row in document["noise"]["channels"]:
        out.add_row(
            Text(row["name"]), Text(row["unit"]), number(row["residual"], 3), number(row["floor"], 3),
            number(row["residual"] / row["floor"] if row["floor"] else math.nan, 3), str(row["samples"]),
            f"{row['independent_samples']:.0f}",
        )  # fmt: skip
    return out


def expected_table(document: Mapping[str, Any]) -> Table:
    """Return the verdicts of a check, before a fit."""
    out = table(
        f"{document['campaign']['name']}: what these trials are expected to fix",
        "95 % half-width of the value from noise alone, at the defaults and (median) over the bounds; "
        "effect: "
        "mean size of the elementary effects on the NRMSE over the bounds (Morris), ± its standard deviation",
        [("parameter", False), ("at", True), ("half-width", True), ("over bounds", True), ("effect", True),
         ("verdict", False), ("trades with", False)],
    )  # fmt: skip
    for row in document["parameters"]:
        effect = f"{number(row['effect'], 2)} ± {number(row['interaction'], 2)}"
        out.add_row(
            Text(_heading(row)), number(row["value"]), half_width(row["half_width"]),
            half_width(row["half_width_over_bounds"]), Text(effect), verdict_text(row["verdict"]),
            Text(_partners(row)),
        )  # fmt: skip
    return out


def quality_table(document: Mapping[str, Any]) -> Table:
    """Return what the logs of a campaign look like, one row each."""
    drops = document["kind"] == "gear"
    columns = [("trial", False), ("use", False), ("rate [Hz]", True), ("jitter [%]", True), ("holes", True)]
    if drops:
        columns += [("lost", True), ("noise x, z [mm]", True), ("pitch [deg]", True), ("fall g [m/s²]", True)]
        columns += [("slope [deg]", True), ("impact [m/s]", True), ("out of plane [deg]", True)]
    else:
        columns += [("at its limit [%]", True)]
    out = table(f"{document['campaign']['name']}: logs", None, columns)
    for row in document["quality"]:
        cells: list[str | Text] = [Text(row["name"]), Text(row["use"]), number(row["rate"])]
        cells.append(percent(row["jitter"], 1))
        cells += [str(row["holes"])]
        if drops:
            noise = row["noise"]
            cells += [
                str(row["lost_in_window"]),
                f"{1000 * noise['x [m]']:.2f}, {1000 * noise['z [m]']:.2f}",
                f"{math.degrees(noise['pitch [rad]']):.2f}",
                f"{number(row['gravity'], 3)} ± {number(row['gravity_error'], 1)}",
                number(row["slope_deg"], 3),
                number(row["impact_speed"], 3),
                number(row["out_of_plane_deg"], 2),
            ]
        else:
            cells.append(percent(row["saturated"], 1))
        out.add_row(*cells)
    return out


def validation_table(document: Mapping[str, Any]) -> Table:
    """Return the score of a validation or cross-validation, one row per trial."""
    early = any(row["nrmse_third_contact"] is not None for row in document["trials"])
    stops = any(row.get("stop") for row in document["trials"])
    columns = [("trial", False), ("NRMSE [%]", True), ("noise alone", True), ("ratio", True)]
    if early:
        columns += [("to 3rd contact [%]", True), ("ratio there", True)]
    # Cross-validation keeps no samples of the trial that it leaves out.
    leaving = not any("refit" in row for row in document["trials"])
    if leaving:
        columns += [("leaves at [s]", True)]
    if stops:
        columns += [("place: measured", True), ("predicted [m]", True), ("time: measured", True)]
        columns += [("predicted [s]", True)]
    word = "FLAGGED" if document["flagged"] else "not flagged"
    out = table(f"{document['fit']}, {document['part']}: {word}", None, columns)
    for row in document["trials"]:
        cells = [row["name"], percent(row["nrmse"][0]), percent(row["floor"]), number(row["ratio"], 3)]
        if early:
            cells += [percent(row["nrmse_third_contact"]), number(row["ratio_third_contact"], 3)]
        if leaving:
            leaves = row["leaves"]
            cells.append(_NONE if leaves is None else f"{leaves['time']:.3f} ({leaves['channel']})")
        if stops:
            for key in ("place", "time"):
                one = row["stop"][key]
                cells += [number(one["measured"], 3), f"{number(one['mean'], 3)} ± {number(one['sigma'], 2)}"]
        out.add_row(*(Text(cell) for cell in cells))
    return out


def comparison_table(document: Mapping[str, Any]) -> Table:
    """Return which parameters differ between fits by more than their intervals allow."""
    out = table(
        "differences between the fits",
        "values: minima of the profiles (best sets where there are none); allowed: 95 % of the difference; "
        "open: an interval has no end",
        [("parameter", False), ("fits", False), ("values", True), ("difference [%]", True), ("allowed", True),
         ("by", False), ("differs", False)],
    )  # fmt: skip
    for row in document["differences"]:
        word = {True: "yes", False: "no", None: "not known"}[row["differs"]]
        out.add_row(
            Text(_heading(row)), Text(" / ".join(row["fits"])),
            f"{number(row['values'][0])} / {number(row['values'][1])}", percent(row["difference"], 1),
            "open" if not math.isfinite(row["allowed"]) else f"± {row['allowed']:.2g}", Text(row["by"]),
            Text(word, style="red" if row["differs"] else ""),
        )  # fmt: skip
    return out


def cross_table(document: Mapping[str, Any]) -> Table:
    """Return the NRMSE of every fit's best set on every fit's trials."""
    names = document["fits"]
    out = table(
        "NRMSE [%] of the best set of a fit (row) on the fitted trials of another (column)",
        "a set brings what it found, and what it held where the campaign is silent; clocks stay its own",
        [("best set of", False), *((name, True) for name in names)],
    )
    for name, row in zip(names, document["cross"], strict=True):
        out.add_row(Text(name), *(percent(float(value)) for value in row))
    return out
