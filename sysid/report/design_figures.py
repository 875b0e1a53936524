"""Figures of a design study: what the drone lands on over each change, or over two together."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullLocator

from sysid.landing.design_study import Change, DesignStudy
from sysid.types import FloatArray

_COLOURS = ("#0072B2", "#009E73", "#E69F00", "#D55E00", "#CC79A7", "#56B4E9", "#000000")
_STEEPEST = "largest safe slope"


def figure_design_study(study: DesignStudy) -> Figure:
    """Draw a study: a curve per change and touchdown speed, or a map per speed for two changes together.

    Parameters
    ----------
    study : DesignStudy

    Notes
    -----
    Lines (colours) show the width of the slopes that the sets land on, dots (numbers) the steepest slope up
    to which all are safe; where a dot lies below its line, a flatter slope is unsafe. A triangle (≥) is a
    lower bound: all slopes tried are safe.
    """
    return _map(study) if study.settings.together else _curves(study)


def _curves(study: DesignStudy) -> Figure:
    count = len(study.changes)
    columns = min(count, 3)
    rows = math.ceil(count / columns)
    figure = Figure(figsize=(3.4 * columns + 1.9, 2.9 * rows + 0.7), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel()
    landable, steepest = study.landable, study.steepest
    top = max(1.0, float(np.max(landable)), float(np.nanmax(steepest)))
    for c, (change, panel) in enumerate(zip(study.changes, panels, strict=False)):
        chosen = study.along(c)
        values = study.points[chosen, c]
        panel.axvline(change.neutral, color="0.6", linewidth=0.8, linestyle=":")
        for m, _ in enumerate(study.settings.speeds):
            colour = _COLOURS[m % len(_COLOURS)]
            panel.plot(values, landable[chosen, m], color=colour, linewidth=1.6)
            edge = study.at_edge[chosen, m]
            for which, marker in ((~edge, "o"), (edge, "^")):
                if which.any():
                    x, y = values[which], steepest[chosen, m][which]
                    panel.plot(x, y, color=colour, marker=marker, markersize=4, linestyle="none")
        _axis(panel, change, values)
        if c % columns == 0:
            panel.set_ylabel("slope [deg]")
        panel.set_ylim(0, 1.05 * top)
        panel.grid(True, color="0.92")
        panel.set_axisbelow(True)
    for panel in panels[count:]:
        panel.set_visible(False)
    handles = [
        Line2D([], [], color=_COLOURS[m % len(_COLOURS)], label=f"{speed:g} m/s")
        for m, speed in enumerate(study.settings.speeds)
    ]
    handles += [
        Line2D([], [], color="0.3", label="width of slopes\nlanded on"),
        Line2D([], [], color="0.3", marker="o", markersize=4, linestyle="none", label=_STEEPEST),
    ]
    if study.at_edge.any():
        words = "or more: no\nsteeper one tried"
        handles.append(Line2D([], [], color="0.3", marker="^", markersize=4, linestyle="none", label=words))
    figure.legend(handles=handles, loc="outside right upper", frameon=False, title="touchdown at")
    figure.suptitle(_title(study), fontsize="medium")
    return figure


def _map(study: DesignStudy) -> Figure:
    first, second = study.changes
    x, y = np.array(first.axis), np.array(second.axis)
    place = {tuple(point): p for p, point in enumerate(study.points.tolist())}
    grid = np.array([[place[(a, b)] for a in x.tolist()] for b in y.tolist()])
    speeds = study.settings.speeds
    columns = min(len(speeds), 4)
    rows = math.ceil(len(speeds) / columns)
    figure = Figure(figsize=(3.1 * columns + 1.2, 3.0 * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    top = float(np.max(study.landable[grid]))
    for m, (speed, panel) in enumerate(zip(speeds, panels, strict=False)):
        values, safe = study.landable[grid, m], study.steepest[grid, m]
        # Cells, not contours: neighbours differ by chance where landings are chaotic.
        mesh = panel.pcolormesh(
            np.arange(len(x) + 1) - 0.5, np.arange(len(y) + 1) - 0.5, values, vmin=0, vmax=top, cmap="viridis"
        )
        for i in range(len(y)):
            for j in range(len(x)):
                more = "≥" if study.at_edge[grid[i, j], m] else ""
                text = f"{more}{safe[i, j]:.0f}" if np.isfinite(safe[i, j]) else "–"
                colour = "white" if values[i, j] < 0.6 * top else "black"
                panel.text(j, i, text, ha="center", va="center", color=colour, fontsize="small")
        at = (int(np.searchsorted(x, first.neutral)), int(np.searchsorted(y, second.neutral)))
        across, up = 0.48 * np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]])
        panel.plot(at[0] + across, at[1] + up, color="#D55E00", linewidth=1.8)
        panel.set_xticks(range(len(x)), [f"{value:.3g}" for value in x])
        panel.set_yticks(range(len(y)), [f"{value:.3g}" for value in y])
        panel.set_title(f"{speed:g} m/s", fontsize="medium")
        if m // columns == rows - 1:
            panel.set_xlabel(first.label)
        if m % columns == 0:
            panel.set_ylabel(second.label)
    for panel in panels[len(speeds) :]:
        panel.set_visible(False)
    figure.colorbar(mesh, ax=panels[: len(speeds)].tolist(), label="width of slopes landed on [deg]")
    figure.suptitle(
        f"{_title(study)}\nnumbers: {_STEEPEST} [deg]; frame: the sets as they are", fontsize="medium"
    )
    return figure


def _axis(panel: Axes, change: Change, values: FloatArray) -> None:
    panel.set_xlabel(change.label)
    if change.kind != "reversal":
        panel.set_xscale("log")
        panel.set_xticks(_apart(values, change.neutral))
        panel.xaxis.set_minor_locator(NullLocator())
        panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))


def _apart(values: FloatArray, neutral: float) -> list[float]:
    """Return the values that fit beside each other on a logarithmic axis, the neutral one among them."""
    near = 0.12 * math.log(values[-1] / values[0])
    kept: list[float] = []
    for value in sorted(values.tolist(), key=lambda v: (v != neutral, v)):
        if all(abs(math.log(value / other)) > near for other in kept):
            kept.append(value)
    return sorted(kept)


def _title(study: DesignStudy) -> str:
    need = (
        f"at least {100 * study.settings.share:.0f} % of the sets within {study.settings.maps.rules.long:g} m"
    )
    return f"{study.name}, {study.controller}: slopes landed on ({need})"
