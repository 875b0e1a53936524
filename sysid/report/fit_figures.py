"""Figures for a page that a phone shows too: one panel each, narrow, with letters that stay readable.

The larger figures of `sysid.report.fit_plots` put many panels side by side for paper and screens.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from sysid.filters import ChebyshevLowpass, KaiserLowpass, Spectrum
from sysid.fit.optima import SAME_NRMSE
from sysid.fit.result import FitResult, TrialResult
from sysid.report.drop_replay import FEET, Contact
from sysid.report.fit_plots import (
    BEST,
    MASKED,
    MEASURED,
    OTHERS,
    RUNS,
    axis_label,
    display_of,
    finer_unit,
    masked_runs,
    percent_axis,
    percent_text,
)
from sysid.types import FloatArray

WIDTH = 4.3
# Points of a curve beyond which only least and largest value of every stretch are drawn.
_POINTS = 900
FOOT_COLOURS = ("#009E73", "#CC79A7")
# Markers of optima, best first.
_MARKERS = "osD^vP*X"
_INDEXED = re.compile(r"(\w[^\W_]*)_([^\W_]+)")


def panel(height: float = 3.0, width: float = WIDTH) -> Figure:
    """Return an empty figure of the page's width [in]."""
    return Figure(figsize=(width, height), layout="constrained")


def figure_channel(
    fit: FitResult, trial: TrialResult, channel: int, *, contacts: Sequence[Contact] = ()
) -> Figure:
    """Draw one channel of one trial: measured, every set, the residual of the best below.

    Parameters
    ----------
    fit, trial
    channel : int
        Its number in the fit.
    contacts : sequence of Contact
        Of the best set's simulation; drawn as bars at the bottom, a row per foot.
    """
    # Fixed margins: a page has dozens of these, and laying one out takes longer than drawing it.
    figure = Figure(figsize=(WIDTH, 3.1))
    rows = {"left": 0.235, "right": 0.965, "top": 0.92, "bottom": 0.15, "hspace": 0.12}
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.4, 1.0), gridspec_kw=rows)
    name, unit, factor = display_of(fit, channel)
    time = trial.time - trial.time[0]
    valid = trial.valid[:, channel]
    measured = np.where(valid, factor * trial.measured[:, channel], np.nan)
    _shade(top, trial)
    _shade(bottom, trial)
    for s in range(len(trial.simulated) - 1, -1, -1):
        look = {"color": BEST, "linewidth": 1.3, "zorder": 4} if s == 0 else {
            "color": OTHERS, "linewidth": 0.8, "zorder": 3,
        }  # fmt: skip
        top.plot(*thinned(time, factor * trial.simulated[s, :, channel]), **look)
    if len(time) > 400:
        top.plot(*thinned(time, measured), color=MEASURED, linewidth=2.0, zorder=2)
    else:
        top.plot(time, measured, color=MEASURED, linestyle="none", marker=".", markersize=3.0, zorder=2)
    if np.any(np.isfinite(measured)):
        low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
        room = 0.25 * (high - low) or 1.0
        least, most = top.get_ylim()
        top.set_ylim(max(least, low - room), min(most, high + room))
    _mark_contacts(top, contacts)
    small, finer = finer_unit(unit)
    bottom.axhline(0.0, color="0.6", linewidth=0.8)
    if len(trial.simulated):
        error = finer * factor * (trial.simulated[0, :, channel] - trial.measured[:, channel])
        bottom.plot(*thinned(time, np.where(valid, error, np.nan)), color=BEST, linewidth=0.8)
    own = float(trial.nrmse[0, channel]) if len(trial.nrmse) else float("nan")
    top.set_title(f"{name}: NRMSE {percent_text(own)}", fontsize=9.5, loc="left")
    top.set_ylabel(axis_label(name, unit))
    bottom.set_ylabel(f"residual\n[{small}]")
    bottom.set_xlabel("time in the window [s]")
    _finish(top, bottom)
    top.set_xlim(float(time[0]), float(time[-1]))
    figure.align_ylabels([top, bottom])
    return figure


def legend_of(fit: FitResult, *, contacts: bool) -> list[tuple[str, str, str]]:
    """Return what the lines of the channels' panels mean: (colour, how it is drawn, words) each."""
    dense = all(len(trial.time) > 400 for trial in fit.trials)
    out = [(MEASURED, "thick" if dense else "dots", "measured"), (BEST, "line", "best set, residual")]
    if len(fit.nrmse) > 1:
        others = "other set" if len(fit.nrmse) == 2 else f"other {len(fit.nrmse) - 1} sets"
        out.append((OTHERS, "line", others))
    if contacts:
        out += [(FOOT_COLOURS[i], "bar", f"{foot} foot down") for i, foot in enumerate(FEET)]
    if any(masked_runs(trial) for trial in fit.trials):
        out.append((MASKED, "area", "no sample counts"))
    return out


def figure_thrust(
    trial: TrialResult,
    simulated: FloatArray,
    *,
    window: tuple[float, float] | None = None,
    zero: float | None = None,
    legend: bool = False,
) -> Figure:
    """Draw measured thrust and that of every set, in the manner of the paper's Fig. 4; commands as steps.

    Parameters
    ----------
    trial : TrialResult
        Of a motor, with its thrust.
    simulated : (S, n) array
        Thrust of every set [N].
    window : (float, float), optional
        Only this part of the trial's time [s].
    zero : float, optional
        Where the drawn time begins to count, such as a command [s]; the window's start by default.
    legend : bool
        Say in the figure what the lines are, for a figure that stands alone.
    """
    assert trial.thrust is not None
    figure = panel(3.4)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.6, 1.0))
    inside = np.ones(len(trial.time), dtype=bool)
    if window is not None:
        inside = (trial.time >= window[0]) & (trial.time <= window[1])
    origin = float(trial.time[inside][0]) if zero is None else zero
    time = trial.time[inside] - origin
    top.plot(*thinned(time, trial.thrust[inside]), color=MEASURED, linewidth=2.0)
    for s in range(len(simulated) - 1, -1, -1):
        top.plot(
            *thinned(time, simulated[s][inside]),
            color=BEST if s == 0 else OTHERS,
            linewidth=1.2 if s == 0 else 0.8,
        )
    top.set_ylabel("thrust [N]")
    if trial.commands is not None:
        # The last command holds to the end.
        instants = np.append(trial.commands[:, 0] - origin, max(time[-1], trial.commands[-1, 0] - origin))
        levels = 100 * np.append(trial.commands[:, 1], trial.commands[-1, 1])
        bottom.step(instants, levels, where="post", color="#0072B2")
    bottom.set_ylim(-115, 115)
    bottom.set_ylabel("command\n[%]")
    bottom.set_xlabel("time [s]" if zero is None else "time after the command [s]")
    if zero is not None:
        for axes in (top, bottom):
            axes.axvline(0.0, color="0.6", linewidth=0.8, linestyle=":")
    if legend:
        names = [("measured", MEASURED, 2.0), ("best set", BEST, 1.2)]
        names += [("other sets", OTHERS, 0.8)] if len(simulated) > 1 else []
        names += [("command", "#0072B2", 1.5)] if trial.commands is not None else []
        handles = [Line2D([], [], label=label, color=colour, linewidth=wide) for label, colour, wide in names]
        figure.legend(handles=handles, loc="outside upper center", ncols=4, fontsize=8, frameon=False)
    top.set_xlim(float(time[0]), float(time[-1]))
    _finish(top, bottom)
    figure.align_ylabels([top, bottom])
    return figure


def figure_runs(fit: FitResult) -> Figure:
    """Draw the best NRMSE after every generation, a line per run; a dot where it ended."""
    figure = panel(3.2)
    axes = figure.add_subplot()
    for number, run in enumerate(fit.runs, start=1):
        colour = RUNS[(number - 1) % len(RUNS)]
        style = "-" if number <= len(RUNS) else "--"
        axes.plot(
            np.arange(1, len(run.best) + 1),
            run.best,
            color=colour,
            linewidth=1.4,
            linestyle=style,
            label=f"run {number}",
        )
        axes.plot([len(run.best)], run.best[-1:], marker="o", markersize=4, color=colour)
    percent_axis(axes, np.concatenate([run.best for run in fit.runs]) if fit.runs else np.ones(1))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("generation")
    axes.set_ylabel("best NRMSE [%]")
    axes.grid(True, color="0.92")
    if 0 < len(fit.runs) <= 10:
        axes.legend(frameon=False, fontsize=8, ncols=2)
    return figure


def figure_waterfall(fit: FitResult) -> Figure:
    """Draw the final NRMSE of every run, best first; runs that ended in the same optimum share a colour.

    A run that was cut short ended in none: an open circle without a letter.
    """
    figure = panel(3.2)
    axes = figure.add_subplot()
    found = fit.agreement
    best = float(found.cost.min())
    looks: dict[str, dict[str, Any]] = {}
    points: dict[str, list[tuple[int, float]]] = {}
    for rank, run in enumerate(found.order, start=1):
        optimum = int(found.optimum[run])
        look = {"marker": _MARKERS[optimum % len(_MARKERS)], "color": RUNS[optimum % len(RUNS)]}
        name = f"optimum {chr(ord('A') + optimum % 26)}"
        if found.cut[run]:
            name, look = "not finished", {"marker": "o", "color": "0.4", "markerfacecolor": "none"}
        looks[name] = look
        points.setdefault(name, []).append((rank, float(found.cost[run]) / best))
    for name in sorted(points):
        axes.plot(*zip(*points[name], strict=True), linestyle="none", markersize=7, label=name, **looks[name])
    # Differences that tell no optima apart are not drawn large.
    span = max(float(found.cost.max()) / best - 1, 5 * SAME_NRMSE)
    axes.set_ylim(1 - 0.08 * span, 1 + 1.25 * span)
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlim(0.5, len(fit.runs) + 0.5)
    axes.set_xlabel("rank of the run [1]")
    axes.set_ylabel("final NRMSE / best [1]")
    axes.grid(True, color="0.92")
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    return figure


def figure_spread(fit: FitResult) -> Figure:
    """Draw where the sets lie between the bounds of every free parameter, scaled as the search walked."""
    free = [i for i, r in enumerate(fit.parameters) if r.status == "free" and None not in (r.lower, r.upper)]
    figure = panel(0.9 + 0.36 * max(1, len(free)), WIDTH)
    axes = figure.add_subplot()
    for row, i in enumerate(free):
        record = fit.parameters[i]
        assert record.lower is not None
        assert record.upper is not None
        low, high, values = record.lower, record.upper, fit.values[:, i]
        if record.scale == "log":
            place = np.log(values / low) / np.log(high / low)
        else:
            place = (values - low) / (high - low)
        axes.plot([0, 1], [row, row], color="0.85", linewidth=4, solid_capstyle="butt", zorder=1)
        axes.plot(
            place[1:],
            np.full(len(place) - 1, row),
            linestyle="none",
            marker="o",
            markersize=5,
            color=OTHERS,
            zorder=3,
        )
        axes.plot(place[:1], [row], linestyle="none", marker="D", markersize=6, color=BEST, zorder=4)
        axes.text(-0.08, row, f"{low:g}", ha="right", va="center", fontsize=7.5)
        axes.text(1.05, row, f"{high:g}", ha="left", va="center", fontsize=7.5)
    axes.set_yticks(range(len(free)))
    axes.set_yticklabels(
        [
            axis_label(as_math(fit.parameters[i].symbol), fit.parameters[i].unit)
            + (" (log)" if fit.parameters[i].scale == "log" else "")
            for i in free
        ],
        fontsize=8,
    )
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(free) - 0.4, -0.6)
    axes.set_xlim(-0.26, 1.26)
    axes.set_xticks([0, 0.5, 1])
    axes.set_xlabel("place between the bounds of the search [1]")
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    return figure


def figure_spectrum(
    fit: FitResult,
    spectra: Sequence[tuple[str, Spectrum]],
    channel: int,
    gain: tuple[FloatArray, FloatArray] | None,
) -> Figure:
    """Draw the spectra of one channel before the filter, and the filter's gain over them.

    Parameters
    ----------
    fit : FitResult
    spectra : sequence of (trial, Spectrum)
    channel : int
    gain : (frequency [Hz], gain [dB]), optional
        Of the filter.
    """
    figure = panel(3.2)
    axes = figure.add_subplot()
    name, unit, factor = display_of(fit, channel)
    for number, (_, spectrum) in enumerate(spectra):
        density = factor * spectrum.density[:, channel]
        if np.any(np.isfinite(density)):
            axes.loglog(
                spectrum.frequency,
                density,
                color="0.6",
                linewidth=0.7,
                label="trials, unfiltered" if number == 0 else None,
            )
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel(f"{name} [{unit}/√Hz]")
    axes.grid(True, color="0.92")
    if gain is not None:
        right = axes.twinx()
        right.plot(*gain, color=BEST, linewidth=1.5, label="filter")
        right.set_ylim(-90, 6)
        right.set_ylabel("gain of the filter [dB]", color=BEST)
        right.tick_params(axis="y", colors=BEST)
        handles = [*axes.get_legend_handles_labels()[0], *right.get_legend_handles_labels()[0]]
        axes.legend(handles=handles, frameon=False, fontsize=8, loc="lower left")
        axes.set_zorder(0)
    return figure


def filter_gain(design: dict[str, Any], highest: float) -> tuple[FloatArray, FloatArray] | None:
    """Return the gain of a filter as it stands in a result: frequency [Hz] and gain [dB]."""
    kind = str(design.get("kind", "none"))
    frequency = np.geomspace(1.0, highest, 400)
    if kind.startswith("kaiser"):
        kaiser = KaiserLowpass(
            design["rate [Hz]"], design["cut-off [Hz]"], design["attenuation [dB]"], design["transition [Hz]"]
        )
        gain = np.abs(kaiser.gain(frequency))
    elif kind.startswith("chebyshev"):
        cheby = ChebyshevLowpass(
            design["rate [Hz]"],
            design["stop-band edge [Hz]"],
            design["order of one pass"],
            design["attenuation of one pass [dB]"],
        )
        gain = cheby.gain(frequency)
    else:
        return None
    return frequency, 20 * np.log10(np.maximum(gain, 1e-6))


def as_math(symbol: str) -> str:
    """Return a symbol of the tables, as ``k_h``, for a figure, its indices set lower."""
    return _INDEXED.sub(r"$\1_{\2}$", symbol)


def thinned(time: FloatArray, values: FloatArray, points: int = _POINTS) -> tuple[FloatArray, FloatArray]:
    """Return a curve that looks the same with few points: least and largest value of every stretch."""
    if len(time) <= points:
        return time, values
    edges = np.linspace(0, len(time), points // 2 + 1).astype(int)
    kept: list[int] = []
    for first, end in pairwise(edges):
        part = values[first:end]
        if not np.any(np.isfinite(part)):
            kept.append(int(first))
            continue
        kept += sorted({int(first) + int(np.nanargmin(part)), int(first) + int(np.nanargmax(part))})
    return time[kept], values[kept]


def _mark_contacts(axes: Axes, contacts: Sequence[Contact]) -> None:
    if not contacts:
        return
    low, high = axes.get_ylim()
    room = 0.1 * (high - low)
    axes.set_ylim(low - room, high)
    for contact in contacts:
        y = low - room * (0.35 + 0.35 * contact.foot) + 0.1 * room
        # A stay too short to be seen at this scale is widened to 2 ms.
        end = max(contact.end, contact.start + 2e-3)
        axes.plot(
            [contact.start, end],
            [y, y],
            color=FOOT_COLOURS[contact.foot],
            linewidth=3,
            solid_capstyle="butt",
            zorder=5,
        )


def _finish(*panels: Axes) -> None:
    for axes in panels:
        axes.yaxis.set_major_locator(MaxNLocator(4))
        axes.grid(True, color="0.92")
        axes.set_axisbelow(True)


def _shade(axes: Axes, trial: TrialResult) -> None:
    time = trial.time - trial.time[0]
    for first, last in masked_runs(trial):
        left, right = time[max(first - 1, 0)], time[min(last + 1, len(time) - 1)]
        axes.axvspan(float(left), float(right), color=MASKED, linewidth=0, zorder=0)
