"""Figures of a design study: what the drone lands on over each change, or over two together."""

import math

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, NullLocator

from sysid.landing.design_study import DesignStudy
from sysid.report.drawing import BEST, WIDTH, as_words, panels
from sysid.types import FloatArray

_COLOURS = ("#0072B2", "#009E73", "#E69F00", "#D55E00", "#CC79A7", "#56B4E9", "#000000")
_STEEPEST = "largest safe slope"


def figure_design_study(study: DesignStudy) -> Figure:
    """Draw a study: a curve per change and touchdown speed, or a map per speed for two changes together.

    Lines (colours) show the width of the slopes that the sets land on, dots (numbers) the steepest slope up
    to which all are safe; where a dot lies below its line, a flatter slope is unsafe. A triangle (≥) is a
    lower bound: all slopes tried are safe.
    """
    return _map(study) if study.settings.together else _curves(study)


def narrow_figures(study: DesignStudy) -> dict[str, Figure]:
    """Return the panels of `figure_design_study` one by one, for a narrow page, by what each shows."""
    if study.settings.together:
        return {f"{speed:g} m/s": _map(study, m) for m, speed in enumerate(study.settings.speeds)}
    return {change.label: _curves(study, c) for c, change in enumerate(study.changes)}


def _curves(study: DesignStudy, only: int | None = None) -> Figure:
    shown = [c for c in range(len(study.changes)) if only in (None, c)]
    count, alone = len(shown), only is not None
    cell, around = ((WIDTH, 2.9), (0.0, 1.3)) if alone else ((3.4, 2.9), (1.9, 0.7))
    figure, every = panels(count, min(count, 3), cell, around, sharey=True)
    landable, steepest = study.landable, study.steepest
    top = max(1.0, float(np.max(landable)), float(np.nanmax(steepest)))
    half = float(np.max(np.diff(study.settings.slopes_deg))) / 2
    for k, (c, panel) in enumerate(zip(shown, every, strict=True)):
        change, chosen = study.changes[c], study.along(c)
        values = study.points[chosen, c]
        panel.axvline(change.neutral, color="0.6", linewidth=0.8, linestyle=":")
        for m, _ in enumerate(study.settings.speeds):
            colour = _COLOURS[m % len(_COLOURS)]
            panel.plot(values, landable[chosen, m], color=colour, linewidth=1.6)
            # A dip within half a step of the slopes is none.
            ends = landable[chosen, m] - half, landable[chosen, m] + half
            panel.fill_between(values, *ends, color=colour, alpha=0.15, linewidth=0)
            edge = study.at_edge[chosen, m]
            for which, marker in ((~edge, "o"), (edge, "^")):
                if which.any():
                    x, y = values[which], steepest[chosen, m][which]
                    panel.plot(x, y, color=colour, marker=marker, markersize=4, linestyle="none")
        panel.set_xlabel(change.label)
        if change.kind != "reversal":
            panel.set_xscale("log")
            panel.set_xticks(_apart(values, change.neutral))
            panel.xaxis.set_minor_locator(NullLocator())
            panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
        if k % min(count, 3) == 0:
            panel.set_ylabel("slope [deg]")
        panel.set_ylim(0, 1.05 * top)
    handles = [
        Line2D([], [], color=_COLOURS[m % len(_COLOURS)], label=f"{speed:g} m/s")
        for m, speed in enumerate(study.settings.speeds)
    ]
    handles.append(
        Line2D([], [], color="0.3", label=f"width of slopes landed\non, ± {half:g} deg by their grid")
    )
    markers = {"o": _STEEPEST} | ({"^": "or more: no\nsteeper one tried"} if study.at_edge.any() else {})
    for marker, words in markers.items():
        handles.append(
            Line2D([], [], color="0.3", marker=marker, markersize=4, linestyle="none", label=words)
        )
    if alone:
        figure.legend(
            handles=handles,
            frameon=False,
            title="touchdown at",
            loc="outside lower center",
            ncols=3,
            fontsize=8,
        )
    else:
        figure.legend(handles=handles, frameon=False, title="touchdown at", loc="outside right upper")
        figure.suptitle(_title(study), fontsize="medium")
    return figure


def _map(study: DesignStudy, only: int | None = None) -> Figure:
    first, second = study.changes
    x, y = np.array(first.axis), np.array(second.axis)
    place = {tuple(point): p for p, point in enumerate(study.points.tolist())}
    grid = np.array([[place[(a, b)] for a in x.tolist()] for b in y.tolist()])
    shown = [m for m in range(len(study.settings.speeds)) if only in (None, m)]
    columns = min(len(shown), 4)
    figure, every = panels(len(shown), columns, (3.1, 3.0), (1.2, 0.6), grid=False, sharex=True, sharey=True)
    top = float(np.max(study.landable[grid]))
    for k, (m, panel) in enumerate(zip(shown, every, strict=True)):
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
        panel.plot(at[0] + across, at[1] + up, color=BEST, linewidth=1.8)
        panel.set_xticks(range(len(x)), [f"{value:.3g}" for value in x])
        panel.set_yticks(range(len(y)), [f"{value:.3g}" for value in y])
        panel.set_title(f"{study.settings.speeds[m]:g} m/s", fontsize="medium")
        if k // columns == (len(shown) - 1) // columns:
            panel.set_xlabel(first.label)
        if k % columns == 0:
            panel.set_ylabel(second.label)
    figure.colorbar(mesh, ax=every, label="width of slopes landed on [deg]")
    if only is None:
        below = f"numbers: {_STEEPEST} [deg]; frame: the sets as they are"
        figure.suptitle(f"{_title(study)}\n{below}", fontsize="medium")
    return figure


def _apart(values: FloatArray, neutral: float) -> list[float]:
    """Return the values whose labels do not overlap on a logarithmic axis, the neutral one among them."""
    near = 0.12 * math.log(values[-1] / values[0])
    kept: list[float] = []
    for value in sorted(values.tolist(), key=lambda v: (v != neutral, v)):
        if all(abs(math.log(value / other)) > near for other in kept):
            kept.append(value)
    return sorted(kept)


def _title(study: DesignStudy) -> str:
    need = f"at least {100 * study.settings.share:.0f} % of the sets within {study.settings.rules.long:g} m"
    return f"{as_words(study.name)}, {study.controller}: slopes landed on ({need})"
