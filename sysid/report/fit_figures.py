"""Figures of a fit: measured against simulated, how the search went, what the filter leaves, trust.

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
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from sysid.errors import ExportError
from sysid.filters import Spectrum, runs, stated_filter
from sysid.fit.optima import SAME_NRMSE
from sysid.fit.result import FitResult, TrialResult
from sysid.report.drawing import (
    BEST,
    MASKED,
    MEASURED,
    OTHERS,
    RUNS,
    USES,
    WIDTH,
    Entry,
    as_math,
    axis_label,
    cut_to,
    display_of,
    draw_legend,
    panel,
    paper,
    percent_text,
    plain_powers,
    thinned,
    tidy,
)
from sysid.trust.documents import FreeParameter, TrustDocument
from sysid.types import FloatArray

# More samples than this are drawn as a line instead of dots.
_DENSE = 400
# Colours of the rows of bars below a trial's signals.
_BARS = ("#009E73", "#CC79A7", "#E69F00")
# Shorter bars are widened to this, to be seen [s].
_SHORTEST_BAR = 2e-3
# Markers of optima, best first.
_MARKERS = "osD^vP*X"

# Deviance beyond which a value lies outside the 68 % and the 95 % interval (chi-square, one freedom).
_LIMITS = ((0.988946, "68 %"), (3.841459, "95 %"))

# Intervals (start, end) [s] since the window's start by what happens in them, such as a foot on the ground.
Bars = Mapping[str, Sequence[tuple[float, float]]]


def figure_measured_against_simulated(
    fit: FitResult, trial: str | None = None, *, bars: Bars | None = None
) -> Figure:
    """Draw what was measured and what each set simulates: a column per trial, a row per channel.

    The residual of the best set is drawn below each channel. Samples that did not count are not drawn; where
    they were lost for every channel the time is shaded (an occlusion, a stall of the logger). A `trial` by
    name is drawn alone, `bars` are drawn below the signals; an ExportError names an unknown trial.
    """
    trials = [candidate for candidate in fit.trials if trial in (None, candidate.name)]
    if not trials:
        known = ", ".join(candidate.name for candidate in fit.trials) or "none; fit again"
        which = "" if trial is None else f" {trial!r}"
        raise ExportError(f"{fit.name}: no trial{which} to draw; found {known}")
    rows, columns = len(fit.channels), len(trials)
    # At least as wide as a legend with rows of bars.
    width, height = max(11.0, 1.2 + 3.1 * columns), 1.7 + 2.5 * rows
    # Fixed margins: laying out eighty axes automatically takes longer than drawing them.
    figure = Figure(figsize=(width, height))
    cells = figure.add_gridspec(
        rows, columns, left=1.0 / width, right=1.0 - 0.15 / width, bottom=0.95 / height,
        top=1.0 - 0.95 / height, hspace=0.2, wspace=0.3,
    )  # fmt: skip
    first_column: list[Axes] = []
    for t, shown in enumerate(trials):
        shared: Axes | None = None
        for c in range(rows):
            pair = cells[c, t].subgridspec(2, 1, height_ratios=(2.3, 1.0), hspace=0.09)
            signal = figure.add_subplot(pair[0], sharex=shared)
            shared = shared or signal
            residual = figure.add_subplot(pair[1], sharex=shared)
            _draw_pair(signal, residual, fit, shown, c, bars or {})
            signal.tick_params(labelbottom=False)
            residual.tick_params(labelbottom=c == rows - 1)
            if c == 0 and trial is None:
                signal.set_title(
                    f"{cut_to(shown.name, 30)}\n{USES[shown.use]}", fontsize="medium", loc="left"
                )
            if t == 0:
                first_column += [signal, residual]
            else:
                signal.set_ylabel("")
                residual.set_ylabel("")
        residual.set_xlabel("time in the window [s]")
    title = f"{fit.name}: measured against simulated ({fit.kind}); NRMSE of the best set"
    figure.suptitle(_title(fit, trials[0]) if trial else title, y=1.0 - 0.25 / height)
    entries = legend_of(fit, trials, list(bars or ()))
    draw_legend(figure, entries, "lower center", 6)
    figure.align_ylabels(first_column)
    return figure


def legend_of(fit: FitResult, trials: Sequence[TrialResult], bars: Sequence[str] = ()) -> list[Entry]:
    """Return what the lines of the trials' panels mean; `bars` names the rows of bars."""
    dense = all(len(trial.time) > _DENSE for trial in trials)
    out = [(MEASURED, "thick" if dense else "dots", "measured"), (BEST, "line", "best set, residual")]
    if len(fit.nrmse) > 1:
        others = "other set" if len(fit.nrmse) == 2 else f"other {len(fit.nrmse) - 1} sets"
        out.append((OTHERS, "line", others))
    out += [(_BARS[i % len(_BARS)], "bar", name) for i, name in enumerate(bars)]
    if any(_masked_runs(trial) for trial in trials):
        out.append((MASKED, "area", "no sample counts"))
    return out


def _draw_pair(signal: Axes, residual: Axes, fit: FitResult, trial: TrialResult, c: int, bars: Bars) -> None:
    """Draw a channel of a trial, and below it the residual of the best set."""
    name, unit, factor = display_of(fit, c)
    time, valid = trial.time - trial.time[0], trial.valid[:, c]
    measured = np.where(valid, factor * trial.measured[:, c], np.nan)
    for s in range(len(trial.simulated) - 1, -1, -1):
        colour, width, order = (BEST, 1.3, 4) if s == 0 else (OTHERS, 0.8, 3)
        curve = thinned(time, factor * trial.simulated[s, :, c])
        signal.plot(*curve, color=colour, linewidth=width, zorder=order)
    if len(time) > _DENSE:
        signal.plot(*thinned(time, measured), color=MEASURED, linewidth=2.0, zorder=2)
    else:
        signal.plot(time, measured, color=MEASURED, linestyle="none", marker=".", markersize=3.0, zorder=2)
    # A set that went astray must not flatten the measurement it is compared with.
    if np.any(np.isfinite(measured)):
        low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
        margin = 0.25 * (high - low) or 1.0
        bottom, top = signal.get_ylim()
        signal.set_ylim(max(bottom, low - margin), min(top, high + margin))
    _draw_bars(signal, bars)
    signal.set_ylabel(f"{name}{chr(10) if len(name) > 11 and '$' not in name else ' '}[{unit}]")
    signal.set_title(f"NRMSE {percent_text(float(trial.nrmse[0, c]))}", fontsize=9.5, loc="right")
    # Residuals of some units are easier to read in a smaller one.
    unit, finer = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3)}.get(unit, (unit, 1.0))
    error = finer * factor * (trial.simulated[0, :, c] - trial.measured[:, c])
    residual.axhline(0.0, color="0.6", linewidth=0.8)
    residual.plot(*thinned(time, np.where(valid, error, np.nan)), color=BEST, linewidth=0.8)
    residual.set_ylabel(f"residual\n[{unit}]")
    tidy(signal, residual)
    for axes in (signal, residual):
        axes.set_xlim(float(time[0]), float(time[-1]))
        for first, last in _masked_runs(trial):
            left, right = time[max(first - 1, 0)], time[min(last + 1, len(time) - 1)]
            axes.axvspan(float(left), float(right), color=MASKED, linewidth=0, zorder=0)


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


def _masked_runs(trial: TrialResult) -> list[tuple[int, int]]:
    """Return (first, last) sample of every run that counts for no channel."""
    return [(first, end - 1) for first, end in runs(np.asarray(~trial.valid.any(axis=1)))]


def trial_means(fit: FitResult, trial: TrialResult) -> FloatArray:
    """Return the NRMSE (S,) of every set on a trial, the weighted mean over the channels [1]."""
    weights = np.asarray(fit.channel_weights)
    used = weights > 0
    return np.asarray(trial.nrmse[:, used] @ (weights[used] / weights[used].sum()))


def _title(fit: FitResult, trial: TrialResult) -> str:
    means = trial_means(fit, trial)
    best, low, high = (percent_text(float(mean)) for mean in (means[0], means.min(), means.max()))
    text = f"{fit.name}, {trial.name} ({USES[trial.use]}): NRMSE {best}"
    # Sets that score alike to the printed digits need no span.
    if low != high:
        text += f", {'both' if len(means) == 2 else f'all {len(means)}'} sets {low} to {high}"
    return text


def figure_convergence(fit: FitResult, *, wide: bool = False) -> Figure:
    """Draw the best NRMSE after every generation, a line per run; a dot where it ended.

    A `wide` one is for a file: it has a title, and says where every run ended.
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
    every = np.concatenate([run.best for run in fit.runs])
    if np.max(every) >= 3 * np.min(every) > 0:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0), numticks=12))
        axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda share, _: f"{100 * share:.4g}"))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set(xlabel="generation", ylabel="best NRMSE [%]")
    if wide:
        axes.set_title(f"{fit.name}: convergence of {len(fit.runs)} runs ({fit.kind})")
        look = {"title": "best NRMSE, generations", "alignment": "left"}
        figure.legend(loc="outside right upper", frameon=False, **look)
    elif len(fit.runs) <= 10:
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
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    return figure


def figure_spread(fit: FitResult) -> Figure:
    """Draw where the sets lie between the bounds of every free parameter, scaled as the search walked."""
    free = [i for i, r in enumerate(fit.parameters) if r.status == "free" and None not in (r.lower, r.upper)]
    figure, axes = panel(0.9 + 0.36 * max(1, len(free)), grid=False)
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
    """Return the gain of a filter that a result states: frequency (n,) [Hz] and gain (n,) [dB]."""
    lowpass = stated_filter(design)
    if lowpass is None:
        return None
    frequency = np.geomspace(1.0, highest, 400)
    return frequency, 20 * np.log10(np.maximum(np.abs(lowpass.gain(frequency)), 1e-6))


def figure_profile(row: FreeParameter, values: FloatArray, deviance: FloatArray) -> Figure:
    """Draw the deviance (n,) [1] over values (n,) [SI] of one parameter, with its 68 % and 95 % limits."""
    figure, axes = panel(2.8)
    axes.plot(values, deviance, color=BEST, marker="o", markersize=3.5, linewidth=1.3)
    for limit, word in _LIMITS:
        axes.axhline(limit, color="0.5", linewidth=0.8, linestyle="--")
        axes.text(
            0.99, limit, word, ha="right", va="bottom", fontsize=7.5, transform=axes.get_yaxis_transform(),
            # The curve passes behind the word.
            bbox=paper(0.5),
        )  # fmt: skip
    axes.axvline(row.value, color=MEASURED, linewidth=0.8)
    if row.scale == "log" and np.max(values) > 3 * np.min(values) > 0:
        axes.set_xscale("log")
    else:
        axes.xaxis.set_major_locator(MaxNLocator(4))
    symbol = as_math(row.symbol)
    axes.set(ylim=(-0.2, 6.0), xlabel=axis_label(symbol, row.unit), ylabel="deviance [1]")
    axes.set_title(f"{symbol}: {row.words}", fontsize=9.5, loc="left")
    return figure


def figure_correlation(document: TrustDocument) -> Figure:
    """Draw how the estimates of the parameters go together, -1 to 1."""
    matrix = np.array(document.correlation, dtype=np.float64)
    names = [as_math(row.symbol) for row in document.parameters]
    figure, axes = panel(1.0 + 0.33 * len(names), grid=False)
    drawn = axes.imshow(matrix, cmap="PuOr", vmin=-1, vmax=1)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    for i, j in np.argwhere((np.abs(matrix) >= 0.5) & ~np.eye(len(names), dtype=bool)):
        words = f"{matrix[i, j]:.1f}".replace("0.", ".").replace("-", "−")
        colour = "white" if abs(matrix[i, j]) > 0.75 else "black"
        axes.text(j, i, words, ha="center", va="center", fontsize=6.5, color=colour)
    figure.colorbar(drawn, ax=axes, shrink=0.8, label="correlation [1]")
    return figure
