"""Figures of trust: profiles of the likelihood and of the cost, correlation of the estimates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sysid.report.drawing import BEST, MEASURED, OTHERS, as_math, axis_label, panel, paper
from sysid.report.trust_tables import verdict_words
from sysid.types import FloatArray

# Deviance beyond which a value lies outside the 68 % and the 95 % interval (chi-square, one freedom).
LIMITS = ((0.988946, "68 %"), (3.841459, "95 %"))


def figure_profile(row: Mapping[str, Any], values: FloatArray, deviance: FloatArray) -> Figure:
    """Draw the deviance over one parameter, all others fitted again, with its 68 % and 95 % limits."""
    figure, axes = panel(2.8)
    axes.plot(values, deviance, color=BEST, marker="o", markersize=3.5, linewidth=1.3)
    for limit, word in LIMITS:
        axes.axhline(limit, color="0.5", linewidth=0.8, linestyle="--")
        axes.text(
            0.99, limit, word, ha="right", va="bottom", fontsize=7.5, transform=axes.get_yaxis_transform(),
            # The curve passes behind the word.
            bbox=paper(0.5),
        )  # fmt: skip
    axes.axvline(float(row["value"]), color=MEASURED, linewidth=0.8)
    if row.get("scale") == "log" and np.max(values) > 3 * np.min(values) > 0:
        axes.set_xscale("log")
    else:
        axes.xaxis.set_major_locator(MaxNLocator(4))
    symbol = as_math(row["symbol"])
    axes.set(ylim=(-0.2, 6.0), xlabel=axis_label(symbol, row["unit"]), ylabel="deviance [1]")
    axes.set_title(f"{symbol}: {verdict_words(row['verdict'])}", fontsize=9.5, loc="left")
    axes.grid(True, color="0.92")
    return figure


def figure_correlation(document: Mapping[str, Any]) -> Figure:
    """Draw how the estimates of the parameters go together, -1 to 1."""
    matrix = np.array(document["correlation"], dtype=np.float64)
    names = [as_math(row["symbol"]) for row in document["parameters"]]
    figure, axes = panel(1.0 + 0.33 * len(names))
    drawn = axes.imshow(matrix, cmap="PuOr", vmin=-1, vmax=1)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    for i, j in np.argwhere((np.abs(matrix) >= 0.5) & ~np.eye(len(names), dtype=bool)):
        words = f"{matrix[i, j]:.1f}".replace("0.", ".").replace("-", "−")
        colour = "white" if abs(matrix[i, j]) > 0.75 else "black"
        axes.text(j, i, words, ha="center", va="center", fontsize=6.5, color=colour)
    figure.colorbar(drawn, ax=axes, shrink=0.8, label="correlation [1]")
    return figure


def figure_nrmse_profile(symbol: str, unit: str, profile: Mapping[str, Any]) -> Figure:
    """Draw a profile of the cost itself, as `fit-motor` walks for the damping."""
    figure, axes = panel(2.8)
    best = float(profile["best nrmse"])
    values, cost = np.array(profile["values"]), np.array(profile["nrmse"])
    axes.loglog(values, cost / best, color=BEST, marker="o", markersize=3.5, linewidth=1.3)
    limit = float(profile["limit"])
    words = f"{100 * limit:g} % above the best"
    axes.axhline(1 + limit, color="0.5", linewidth=0.8, linestyle="--", label=words)
    if not profile["identified"]:
        ends, words = (values.min(), float(profile["below"])), "values not told apart"
        axes.axvspan(*ends, color=OTHERS, alpha=0.3, linewidth=0, label=words)
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    axes.set(xlabel=axis_label(as_math(symbol), unit), ylabel="NRMSE / best [1]")
    axes.grid(True, color="0.92")
    return figure
