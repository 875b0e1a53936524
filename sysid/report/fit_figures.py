"""Figures of a fit: measured against simulated, how the search went, what the filter leaves.

A page shows one panel each, narrow, with letters that stay readable on a phone; files for paper and screens
put many panels side by side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from sysid.errors import ExportError
from sysid.filters import ChebyshevLowpass, KaiserLowpass, Spectrum, runs
from sysid.fit.optima import SAME_NRMSE
from sysid.fit.result import FitResult, TrialResult
from sysid.report.drawing import (
    BEST,
    MASKED,
    MEASURED,
    OTHERS,
    RUNS,
    WIDTH,
    as_math,
    axis_label,
    display_of,
    finer_unit,
    panel,
    percent_axis,
    percent_text,
    plain_powers,
    thinned,
    tidy,
)
from sysid.types import FloatArray

# More samples than this are drawn as a line instead of dots.
_DENSE = 400
# Colours of the rows of bars below a trial's signals.
_BARS = ("#009E73", "#CC79A7", "#E69F00")
# Shorter bars are widened to this, to be seen [s].
_SHORTEST_BAR = 2e-3
# A trial's name above a column; longer ones would reach into the next.
_LONGEST_NAME = 30
# Markers of optima, best first.
_MARKERS = "osD^vP*X"

# Filters, and the keys under which a result states their arguments.
_FILTERS: tuple[tuple[Any, ...], ...] = (
    (KaiserLowpass, "rate [Hz]", "cut-off [Hz]", "attenuation [dB]", "transition [Hz]"),
    (
        ChebyshevLowpass, "rate [Hz]", "stop-band edge [Hz]", "order of one pass",
        "attenuation of one pass [dB]",
    ),
)  # fmt: skip

# Intervals (start, end) [s] since the window's start by what happens in them, such as a foot on the ground.
Bars = Mapping[str, Sequence[tuple[float, float]]]
# A colour, the way it is drawn (``line``, ``thick``, ``dots``, ``bar`` or ``area``), and words.
Entry = tuple[str, str, str]


def figure_channel(fit: FitResult, trial: TrialResult, channel: int, *, bars: Bars | None = None) -> Figure:
    """Draw one channel of one trial for a page: measured, every set, the residual of the best below."""
    # Fixed margins: a page has dozens of these, and laying one out takes longer than drawing it.
    figure = Figure(figsize=(WIDTH, 3.1))
    margins = {"left": 0.235, "right": 0.965, "top": 0.92, "bottom": 0.15, "hspace": 0.12}
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.4, 1.0), gridspec_kw=margins)
    _draw_signals(top, fit, trial, channel, bars or {})
    _draw_residual(bottom, fit, trial, channel)
    name, _, _ = display_of(fit, channel)
    # Apart, because formulas are slow to set and this one is set once for all trials.
    top.set_title(name, fontsize=9.5, loc="left")
    top.set_title(f"NRMSE {percent_text(_best_nrmse(trial, channel))}", fontsize=9.5, loc="right")
    bottom.set_xlabel("time in the window [s]")
    figure.align_ylabels([top, bottom])
    return figure


def figure_measured_against_simulated(
    fit: FitResult, trial: str | None = None, *, bars: Bars | None = None
) -> Figure:
    """Draw what was measured and what each set simulates, with the residual of the best set.

    Parameters
    ----------
    fit : FitResult
    trial : str, optional
        One trial by name, in large: a row per channel, signals left, residual right. Without it all trials:
        a column per trial, a row per channel, the residual below each.
    bars : mapping, optional
        Intervals to mark below the signals of one trial.

    Raises
    ------
    ExportError
        When there is no such trial.

    Notes
    -----
    Samples that did not count are not drawn; where they were lost for every channel the time is shaded (an
    occlusion, a stall of the logger).
    """
    if trial is None:
        if not fit.trials:
            raise ExportError(f"{fit.name}: the fit holds no trial to draw; fit it again")
        return _all_trials(fit)
    chosen = [candidate for candidate in fit.trials if candidate.name == trial]
    if not chosen:
        known = ", ".join(candidate.name for candidate in fit.trials) or "none"
        raise ExportError(f"{fit.name}: no trial {trial!r} to draw; found {known}")
    return _one_trial(fit, chosen[0], bars or {})


def legend_of(fit: FitResult, trials: Sequence[TrialResult], bars: Sequence[str] = ()) -> list[Entry]:
    """Return what the lines of the trials' panels mean; `bars` names the rows of bars."""
    dense = all(len(trial.time) > _DENSE for trial in trials)
    out = [(MEASURED, "thick" if dense else "dots", "measured")]
    if len(fit.nrmse):
        out.append((BEST, "line", "best set, residual"))
    if len(fit.nrmse) > 1:
        others = "other set" if len(fit.nrmse) == 2 else f"other {len(fit.nrmse) - 1} sets"
        out.append((OTHERS, "line", others))
    out += [(_BARS[i % len(_BARS)], "bar", name) for i, name in enumerate(bars)]
    if any(masked_runs(trial) for trial in trials):
        out.append((MASKED, "area", "no sample counts"))
    return out


def _handle(entry: Entry) -> Line2D | Patch:
    colour, kind, label = entry
    if kind == "area":
        return Patch(color=colour, label=label)
    if kind == "dots":
        return Line2D([], [], color=colour, linestyle="none", marker=".", label=label)
    return Line2D([], [], color=colour, linewidth={"thick": 2.2, "bar": 3.0}.get(kind, 1.3), label=label)


def _one_trial(fit: FitResult, trial: TrialResult, bars: Bars) -> Figure:
    rows = len(fit.channels)
    figure = Figure(figsize=(11.0, 1.2 + 2.0 * rows), layout="constrained")
    grid = figure.subplots(rows, 2, sharex=True, squeeze=False, width_ratios=(2.2, 1.0))
    for c in range(rows):
        signal, residual = grid[c]
        _draw_signals(signal, fit, trial, c, bars)
        _draw_residual(residual, fit, trial, c)
        residual.set_title(f"NRMSE {percent_text(_best_nrmse(trial, c))}", fontsize="medium")
    grid[0, 0].set_title("signals", fontsize="medium")
    for axes in grid[-1]:
        axes.set_xlabel("time in the window [s]")
    figure.suptitle(_title(fit, trial))
    handles = [_handle(entry) for entry in legend_of(fit, [trial], list(bars))]
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    figure.align_ylabels(grid[:, 0])
    figure.align_ylabels(grid[:, 1])
    return figure


def _all_trials(fit: FitResult) -> Figure:
    rows, columns = len(fit.channels), len(fit.trials)
    width, height = max(9.0, 1.2 + 3.1 * columns), 1.7 + 2.5 * rows
    # Fixed margins: laying out eighty axes automatically takes longer than drawing them.
    figure = Figure(figsize=(width, height))
    cells = figure.add_gridspec(
        rows, columns, left=1.0 / width, right=1.0 - 0.15 / width, bottom=0.95 / height,
        top=1.0 - 0.95 / height, hspace=0.2, wspace=0.3,
    )  # fmt: skip
    first_column = []
    for t, trial in enumerate(fit.trials):
        shared: Axes | None = None
        for c in range(rows):
            pair = cells[c, t].subgridspec(2, 1, height_ratios=(2.3, 1.0), hspace=0.09)
            signal = figure.add_subplot(pair[0], sharex=shared)
            shared = shared or signal
            residual = figure.add_subplot(pair[1], sharex=shared)
            _draw_signals(signal, fit, trial, c, {})
            _draw_residual(residual, fit, trial, c)
            signal.tick_params(labelbottom=False)
            residual.tick_params(labelbottom=c == rows - 1)
            signal.set_title(f"NRMSE {percent_text(_best_nrmse(trial, c))}", fontsize="small", loc="right")
            if c == 0:
                use = "fitted" if trial.use == "fit" else "validation"
                name = trial.name
                name = name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}…"
                signal.set_title(f"{name}\n{use}", fontsize="medium", loc="left")
            if t == 0:
                first_column += [signal, residual]
            else:
                signal.set_ylabel("")
                residual.set_ylabel("")
        residual.set_xlabel("time in the window [s]")
    title = f"{fit.name}: measured against simulated ({fit.kind}); NRMSE of the best set"
    figure.suptitle(title, y=1.0 - 0.25 / height)
    handles = [_handle(entry) for entry in legend_of(fit, fit.trials)]
    figure.legend(handles=handles, loc="lower center", ncols=5, frameon=False)
    figure.align_ylabels(first_column)
    return figure


def _draw_signals(axes: Axes, fit: FitResult, trial: TrialResult, c: int, bars: Bars) -> None:
    name, unit, factor = display_of(fit, c)
    time = trial.time - trial.time[0]
    measured = np.where(trial.valid[:, c], factor * trial.measured[:, c], np.nan)
    _shade(axes, trial)
    for s in range(len(trial.simulated) - 1, -1, -1):
        colour, width, order = (BEST, 1.3, 4) if s == 0 else (OTHERS, 0.8, 3)
        curve = thinned(time, factor * trial.simulated[s, :, c])
        axes.plot(*curve, color=colour, linewidth=width, zorder=order)
    if len(time) > _DENSE:
        axes.plot(*thinned(time, measured), color=MEASURED, linewidth=2.0, zorder=2)
    else:
        axes.plot(time, measured, color=MEASURED, linestyle="none", marker=".", markersize=3.0, zorder=2)
    # A set that went astray must not flatten the measurement it is compared with.
    if np.any(np.isfinite(measured)):
        low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
        margin = 0.25 * (high - low) or 1.0
        bottom, top = axes.get_ylim()
        axes.set_ylim(max(bottom, low - margin), min(top, high + margin))
    _draw_bars(axes, bars)
    axes.set_ylabel(f"{name}{chr(10) if len(name) > 11 and '$' not in name else ' '}[{unit}]")
    axes.set_xlim(float(time[0]), float(time[-1]))
    tidy(axes)


def _draw_residual(axes: Axes, fit: FitResult, trial: TrialResult, c: int) -> None:
    _, unit, factor = display_of(fit, c)
    unit, finer = finer_unit(unit)
    time = trial.time - trial.time[0]
    _shade(axes, trial)
    axes.axhline(0.0, color="0.6", linewidth=0.8)
    if len(trial.simulated):
        error = finer * factor * (trial.simulated[0, :, c] - trial.measured[:, c])
        axes.plot(*thinned(time, np.where(trial.valid[:, c], error, np.nan)), color=BEST, linewidth=0.8)
    axes.set_ylabel(f"residual\n[{unit}]")
    axes.set_xlim(float(time[0]), float(time[-1]))
    tidy(axes)


def _draw_bars(axes: Axes, bars: Bars) -> None:
    """Draw intervals below the curves, a row per name."""
    if not any(bars.values()):
        return
    low, high = axes.get_ylim()
    row = 0.035 * (high - low)
    bottom = low - row * (len(bars) + 0.9)
    axes.set_ylim(bottom, high)
    for i, intervals in enumerate(bars.values()):
        y = bottom + row * (0.7 + i)
        starts = [start for start, _ in intervals]
        ends = [max(end, start + _SHORTEST_BAR) for start, end in intervals]
        axes.hlines([y] * len(starts), starts, ends, color=_BARS[i % len(_BARS)], linewidth=3, zorder=5)


def _shade(axes: Axes, trial: TrialResult) -> None:
    """Shade the intervals in which no channel counts."""
    time = trial.time - trial.time[0]
    for first, last in masked_runs(trial):
        left, right = time[max(first - 1, 0)], time[min(last + 1, len(time) - 1)]
        axes.axvspan(float(left), float(right), color=MASKED, linewidth=0, zorder=0)


def masked_runs(trial: TrialResult) -> list[tuple[int, int]]:
    """Return (first, last) sample of every run that counts for no channel."""
    return [(first, end - 1) for first, end in runs(np.asarray(~trial.valid.any(axis=1)))]


def _best_nrmse(trial: TrialResult, c: int) -> float:
    return float(trial.nrmse[0, c]) if len(trial.nrmse) else float("nan")


def _title(fit: FitResult, trial: TrialResult) -> str:
    use = "fitted" if trial.use == "fit" else "validation, not fitted"
    weights = np.asarray(fit.channel_weights)
    used = weights > 0
    means = trial.nrmse[:, used] @ (weights[used] / weights[used].sum())
    text = f"{fit.name}, {trial.name} ({use})"
    if not len(means):
        return text
    text += f": NRMSE {percent_text(float(means[0]))}"
    low, high = percent_text(float(means.min())), percent_text(float(means.max()))
    # Sets that score alike to the printed digits need no span.
    if low != high:
        text += f", {'both' if len(means) == 2 else f'all {len(means)}'} sets {low} to {high}"
    return text


def figure_convergence(fit: FitResult, *, wide: bool = False) -> Figure:
    """Draw the best NRMSE after every generation, a line per run; a dot where it ended.

    `wide`: for a file of its own, with a title and where every run ended.
    """
    figure, axes = panel(4.6, 9.5) if wide else panel(3.2)
    for number, run in enumerate(fit.runs, start=1):
        colour = RUNS[(number - 1) % len(RUNS)]
        style = "-" if number <= len(RUNS) else "--"
        generations = np.arange(1, len(run.best) + 1)
        label = f"run {number}"
        if wide:
            label += f": {percent_text(float(run.best[-1]))} after {len(run.best)}"
        axes.plot(generations, run.best, color=colour, linewidth=1.5, linestyle=style, label=label)
        axes.plot(generations[-1:], run.best[-1:], marker="o", markersize=4, color=colour)
    percent_axis(axes, np.concatenate([run.best for run in fit.runs]) if fit.runs else np.ones(1))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="generation", ylabel="best NRMSE [%]")
    axes.grid(True, color="0.92")
    if wide:
        axes.set_title(f"{fit.name}: convergence of {len(fit.runs)} runs ({fit.kind})")
    if wide and fit.runs:
        look = {"title": "best NRMSE, generations", "alignment": "left"}
        figure.legend(loc="outside right upper", frameon=False, **look)
    elif 0 < len(fit.runs) <= 10:
        axes.legend(frameon=False, fontsize=8, ncols=2)
    return figure


def figure_waterfall(fit: FitResult) -> Figure:
    """Draw the final NRMSE of every run, best first; runs that ended in the same optimum share a colour.

    A run that was cut short ended in none: an open circle without a letter.
    """
    figure, axes = panel(3.2)
    agreement = fit.agreement
    best = float(agreement.cost.min())
    drawn: dict[str, tuple[dict[str, Any], list[tuple[int, float]]]] = {}
    for rank, run in enumerate(agreement.order, start=1):
        optimum = int(agreement.optimum[run])
        look = {"marker": _MARKERS[optimum % len(_MARKERS)], "color": RUNS[optimum % len(RUNS)]}
        name = f"optimum {chr(ord('A') + optimum % 26)}"
        if agreement.cut[run]:
            name, look = "not finished", {"marker": "o", "color": "0.4", "markerfacecolor": "none"}
        drawn.setdefault(name, (look, []))[1].append((rank, float(agreement.cost[run]) / best))
    for name, (look, points) in sorted(drawn.items()):
        axes.plot(*zip(*points, strict=True), linestyle="none", markersize=7, label=name, **look)
    # Differences that tell no optima apart are not drawn large.
    span = max(float(agreement.cost.max()) / best - 1, 5 * SAME_NRMSE)
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axes.ticklabel_format(axis="y", useOffset=False)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlim=(0.5, len(fit.runs) + 0.5), ylim=(1 - 0.08 * span, 1 + 1.25 * span))
    axes.set(xlabel="rank of the run [1]", ylabel="final NRMSE / best [1]")
    axes.grid(True, color="0.92")
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    return figure


def figure_spread(fit: FitResult) -> Figure:
    """Draw where the sets lie between the bounds of every free parameter, scaled as the search walked."""
    free = [i for i, r in enumerate(fit.parameters) if r.status == "free" and None not in (r.lower, r.upper)]
    figure, axes = panel(0.9 + 0.36 * max(1, len(free)))
    labels = []
    for row, i in enumerate(free):
        record, values = fit.parameters[i], fit.values[:, i]
        low, high = float(record.lower or 0.0), float(record.upper or 0.0)
        logarithmic = record.scale == "log"
        place = np.log(values / low) / np.log(high / low) if logarithmic else (values - low) / (high - low)
        axes.plot([0, 1], [row, row], color="0.85", linewidth=4, solid_capstyle="butt", zorder=1)
        axes.plot(place[1:], [row] * (len(place) - 1), "o", markersize=5, color=OTHERS, zorder=3)
        axes.plot(place[:1], [row], "D", markersize=6, color=BEST, zorder=4)
        for x, bound, side in ((-0.08, low, "right"), (1.05, high, "left")):
            axes.text(x, row, f"{bound:g}", ha=side, va="center", fontsize=7.5)
        labels.append(axis_label(as_math(record.symbol), record.unit) + (" (log)" if logarithmic else ""))
    axes.set_yticks(range(len(free)), labels, fontsize=8)
    axes.tick_params(axis="y", length=0)
    axes.set_xticks([0, 0.5, 1])
    axes.set(xlim=(-0.26, 1.26), ylim=(len(free) - 0.4, -0.6))
    axes.set_xlabel("place between the bounds of the search [1]")
    axes.spines[["top", "right", "left"]].set_visible(False)
    return figure


def figure_spectrum(
    fit: FitResult, spectra: Sequence[Spectrum], channel: int, gain: tuple[FloatArray, FloatArray] | None
) -> Figure:
    """Draw the spectra of one channel before the filter, and the filter's gain [dB] over frequency [Hz]."""
    figure = Figure(figsize=(WIDTH, 3.2))
    axes = figure.add_axes((0.19, 0.15, 0.64, 0.81))
    name, unit, factor = display_of(fit, channel)
    for spectrum in spectra:
        density = factor * spectrum.density[:, channel]
        if np.any(np.isfinite(density)):
            axes.loglog(spectrum.frequency, density, color="0.6", linewidth=0.7)
    plain_powers(axes.xaxis, axes.yaxis)
    axes.set(xlabel="frequency [Hz]", ylabel=f"{name} [{unit}/√Hz]")
    axes.grid(True, color="0.92")
    handles = [Line2D([], [], color="0.6", linewidth=0.7, label="trials, unfiltered")]
    if gain is not None:
        right = axes.twinx()
        handles += right.plot(*gain, color=BEST, linewidth=1.5, label="filter")
        right.set_ylim(-90, 6)
        right.set_ylabel("gain of the filter [dB]", color=BEST)
        right.tick_params(axis="y", colors=BEST)
        axes.legend(handles=handles, frameon=False, fontsize=8, loc="lower left")
    return figure


def filter_gain(design: Mapping[str, Any], highest: float) -> tuple[FloatArray, FloatArray] | None:
    """Return the gain of a filter as it stands in a result: frequency [Hz] and gain [dB]."""
    for make, *keys in _FILTERS:
        if all(key in design for key in keys):
            frequency = np.geomspace(1.0, highest, 400)
            gain = np.abs(make(*(design[key] for key in keys)).gain(frequency))
            return frequency, 20 * np.log10(np.maximum(gain, 1e-6))
    return None
