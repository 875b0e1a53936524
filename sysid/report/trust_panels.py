"""How far a fit can be trusted, for the page: intervals, verdicts, profiles, correlation, validation.

The documents are those of the fit folder (``trust.json``, ``validation-NAME.json``, ``cross-validation.json``
and the HDF5 files beside them); where one is missing the page says which command makes it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from rich.table import Table
from rich.text import Text

from sysid.export.mean_table import mean_sigma, plain
from sysid.report.fit_figures import as_math, panel
from sysid.report.fit_plots import BEST, MEASURED, OTHERS, axis_label
from sysid.report.tables import channel_symbol
from sysid.trust import documents as store
from sysid.types import FloatArray

# Deviance beyond which a value lies outside the 68 % and the 95 % interval (chi-square, one freedom).
LIMITS = ((0.988946, "68 %"), (3.841459, "95 %"))
_NONE = "—"


def read_document(folder: Path, part: str) -> dict[str, Any] | None:
    """Return a document of a fit folder; None where there is none that speaks of this very fit."""
    return store.read_part(folder, part) if folder.is_dir() else None


def validations(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the validations of a fit folder, and its cross-validation, by name."""
    found = {}
    for part in store.parts(folder) if folder.is_dir() else ():
        if part == store.TRUST:
            continue
        document = store.read_part(folder, part)
        if document is not None:
            cross = part == store.CROSS_VALIDATION
            found["leave-one-trial-out" if cross else part.removeprefix(store.VALIDATION)] = document
    return found


def read_profiles(folder: Path) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return (values [SI], deviance [1]) of every profile of a fit folder."""
    arrays = store.read_arrays(folder, store.TRUST)
    names = [
        path.split("/")[1] for path in arrays if path.startswith("profiles/") and path.endswith("/value")
    ]
    return {name: (arrays[f"profiles/{name}/value"], arrays[f"profiles/{name}/deviance"]) for name in names}


def interval_table(document: Mapping[str, Any]) -> Table:
    """Return value, spread, profile interval and verdict of every free parameter."""
    table = Table(
        title=Text("what the data fix: profile intervals and verdicts"),
        caption=Text("≤ or ≥: open, the data do not end the interval inside the bounds of the search"),
    )
    table.add_column("parameter")
    for head in ("best set", "mean ± σ", "68 %", "95 %"):
        table.add_column(head, justify="right")
    table.add_column("verdict")
    table.add_column("measured apart", justify="right")
    for row in document["parameters"]:
        flag = " (at a bound)" if row.get("at_bound") else ""
        measured = row.get("measured")
        table.add_row(
            Text(axis_label(row["symbol"], row["unit"])),
            Text(plain(row["value"])),
            Text(mean_sigma((row["mean"], row["sigma"]))),
            Text(_interval(row["interval_68"], row["open_68"])),
            Text(_interval(row["interval_95"], row["open_95"])),
            Text(f"{verdict_words(row['verdict'])}{flag}"),
            Text(" to ".join(map(plain, measured)) if measured else _NONE),
        )
    return table


def _interval(ends: Any, opened: Any) -> str:
    low, high = map(plain, ends)
    if all(opened):
        return "open"
    if opened[0]:
        return f"≤ {high}"
    if opened[1]:
        return f"≥ {low}"
    return f"{low} to {high}"


def validation_table(name: str, document: Mapping[str, Any]) -> Table:
    """Return how well trials that were not fitted are predicted."""
    table = Table(title=Text(f"prediction of trials that were not fitted: {name}"))
    table.add_column("trial")
    for head in ("NRMSE, best set", "over the noise alone", "to the third contact", "leaves at [s]"):
        table.add_column(head, justify="right")
    table.add_column("first in")
    for trial in document["trials"]:
        leaves = trial.get("leaves") or {}
        table.add_row(
            Text(str(trial["name"])),
            Text(_percent(_first(trial.get("nrmse")))),
            Text(_times(trial.get("ratio"))),
            Text(_percent(trial.get("nrmse_third_contact"))),
            Text(f"{leaves['time']:.3g}" if leaves else "never"),
            Text(channel_symbol(str(leaves.get("channel", _NONE)))),
        )
    return table


def stop_table(name: str, document: Mapping[str, Any]) -> Table | None:
    """Return where and when the drone stops, measured and predicted; None where no trial says so."""
    rows = [trial for trial in document["trials"] if trial.get("stop")]
    if not rows:
        return None
    table = Table(title=Text(f"where and when it stops: {name}"))
    table.add_column("trial")
    for head in ("place [m], measured", "predicted", "time [s], measured", "predicted"):
        table.add_column(head, justify="right")
    for trial in rows:
        cells = []
        for what in ("place", "time"):
            one = trial["stop"][what]
            cells += [_number(one["measured"]), f"{_number(one['mean'])} ± {_number(one['sigma'])}"]
        table.add_row(Text(str(trial["name"])), *(Text(cell) for cell in cells))
    return table


def verdict_words(verdict: str) -> str:
    """Return a verdict of `sysid.trust.verdicts` as it reads after a parameter."""
    return {"well": "well determined", "weakly": "weakly determined"}.get(verdict, verdict)


def figure_profile(row: Mapping[str, Any], values: FloatArray, deviance: FloatArray) -> Figure:
    """Draw the deviance over one parameter, all others fitted anew, with its 68 % and 95 % limits."""
    figure = panel(2.8)
    axes = figure.add_subplot()
    axes.plot(values, deviance, color=BEST, marker="o", markersize=3.5, linewidth=1.3)
    for limit, word in LIMITS:
        axes.axhline(limit, color="0.5", linewidth=0.8, linestyle="--")
        axes.text(
            0.99, limit, word, ha="right", va="bottom", fontsize=7.5, transform=axes.get_yaxis_transform(),
            # The curve passes behind the word.
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.5},
        )  # fmt: skip
    axes.axvline(float(row["value"]), color=MEASURED, linewidth=0.8)
    if row.get("scale") == "log" and np.max(values) > 3 * np.min(values) > 0:
        axes.set_xscale("log")
    else:
        axes.xaxis.set_major_locator(MaxNLocator(4))
    axes.set_ylim(-0.2, 6.0)
    axes.set_title(f"{as_math(row['symbol'])}: {verdict_words(row['verdict'])}", fontsize=9.5, loc="left")
    axes.set_xlabel(axis_label(as_math(row["symbol"]), row["unit"]))
    axes.set_ylabel("deviance [1]")
    axes.grid(True, color="0.92")
    return figure


def figure_correlation(document: Mapping[str, Any]) -> Figure:
    """Draw how the estimates of the parameters go together, -1 to 1."""
    matrix = np.array(document["correlation"], dtype=np.float64)
    names = [as_math(row["symbol"]) for row in document["parameters"]]
    figure = panel(1.0 + 0.33 * len(names))
    axes = figure.add_subplot()
    drawn = axes.imshow(matrix, cmap="PuOr", vmin=-1, vmax=1)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    for i in range(len(names)):
        for j in range(len(names)):
            if i != j and abs(matrix[i, j]) >= 0.5:
                dark = abs(matrix[i, j]) > 0.75
                axes.text(
                    j, i, f"{matrix[i, j]:.1f}".replace("0.", ".").replace("-", "−"),
                    ha="center", va="center", fontsize=6.5, color="white" if dark else "black",
                )  # fmt: skip
    bar = figure.colorbar(drawn, ax=axes, shrink=0.8)
    bar.set_label("correlation [1]")
    return figure


def figure_nrmse_profile(symbol: str, unit: str, profile: Mapping[str, Any]) -> Figure:
    """Draw a profile of the cost itself, as `fit-motor` walks for the damping."""
    figure = panel(2.8)
    axes = figure.add_subplot()
    best = float(profile["best nrmse"])
    values, cost = np.array(profile["values"]), np.array(profile["nrmse"])
    axes.loglog(values, cost / best, color=BEST, marker="o", markersize=3.5, linewidth=1.3)
    limit = float(profile["limit"])
    axes.axhline(
        1 + limit, color="0.5", linewidth=0.8, linestyle="--", label=f"{100 * limit:g} % above the best"
    )
    if not profile["identified"]:
        axes.axvspan(
            values.min(), float(profile["below"]), color=OTHERS, alpha=0.3, linewidth=0,
            label="values not told apart",
        )  # fmt: skip
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    axes.set_xlabel(axis_label(as_math(symbol), unit))
    axes.set_ylabel("NRMSE / best [1]")
    axes.grid(True, color="0.92")
    return figure


def _first(values: Any) -> float | None:
    if isinstance(values, list):
        return float(values[0]) if values else None
    return None if values is None else float(values)


def _percent(value: float | None) -> str:
    return _NONE if value is None or not math.isfinite(float(value)) else f"{100 * float(value):.2f} %"


def _times(value: float | None) -> str:
    return _NONE if value is None or not math.isfinite(float(value)) else f"{float(value):.2f} ×"


def _number(value: Any) -> str:
    return _NONE if value is None or not math.isfinite(float(value)) else f"{float(value):.3g}"
