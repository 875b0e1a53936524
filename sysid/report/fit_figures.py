"""Figures of a fit: measured against simulated, how the search went, what the filter leaves, trust.

A page shows one panel each, narrow, with letters that stay readable on a phone; files for paper and screens
put many panels side by side.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from sysid.documents import channel_symbol
from sysid.filters import runs, stated_filter
from sysid.fit.optima import SAME_NRMSE
from sysid.fit.result import FitResult, TrialResult
from sysid.report.answer import Reopened
from sysid.report.drawing import (
    BEST,
    MEASURED,
    OTHERS,
    RUNS,
    USES,
    WIDTH,
    Style,
    as_math,
    as_words,
    axis_label,
    panel,
    paper,
    percent_text,
    unit_of,
)
from sysid.report.plots import Curve, Look, Panel, View, figure_of
from sysid.trust.documents import FreeParameter, TrustDocument
from sysid.types import FloatArray

# Markers of optima, the best optimum first.
_MARKERS = "osD^vP*X"
# Finer unit of the residuals of a unit, and the factor to it.
_FINER = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3)}
# Two deviations of the noise to both sides, within which residuals of noise alone are 95 % of the time [1].
_NOISE = (-2.0, 2.0)
# Number of samples beyond which the measurement is a line instead of dots, and share of the samples without a
# neighbour from which it is dots for all that: no line joins the samples of a slow sensor beside a fast one.
_DENSE, _ALONE = 400, 0.5
# Deviance at the ends of the 68 % and the 95 % interval (chi-square, one degree of freedom) [1].
_LIMITS = ((0.988946, "68 %"), (3.841459, "95 %"))

# Intervals (start, end) [s] since the window's start by what happens in them, such as a foot on the ground.
Bars = Mapping[str, Sequence[tuple[float, float]]]


def figure_measured_against_simulated(fit: FitResult) -> Figure:
    """Draw all trials of a fit: a column per trial, each channel with its residual below."""
    views = []
    for trial in fit.trials:
        mean = percent_text(float(fit.over_channels(trial.nrmse)[0]))
        views.append(trial_view(fit, trial, (trial.name, f"{trial.name} ({USES[trial.use]}): NRMSE {mean}")))
    return figure_of(views, f"{fit.name}: measured against simulated ({fit.kind}); NRMSE of the best set")


def trial_view(
    fit: FitResult, trial: TrialResult, names: tuple[str, str], bars: Bars | None = None,
    known: Reopened | None = None, other: FitResult | None = None,
) -> View:  # fmt: skip
    """Return measured and simulated channels of a trial, each with its residual below.

    `names` are the key of the view and its title. Residuals are over the noise where it is known. `other` is
    a fit whose best set is drawn as well.
    """
    time, panels = trial.time - trial.time[0], []
    known = known or Reopened()
    band, noise = known.band.get(trial.name), known.noise.get(trial.name)
    beside = next((each for each in other.trials if each.name == trial.name), None) if other else None
    for c in (c for c in range(len(fit.channels)) if trial.valid[:, c].any()):
        unit, factor = unit_of(fit, c)
        valid, curves = trial.valid[:, c], []
        measured = np.where(valid, trial.measured[:, c], np.nan)
        beside_none = valid & ~np.append(valid[1:], False) & ~np.append(False, valid[:-1])
        alone = np.count_nonzero(beside_none) > _ALONE * np.count_nonzero(valid)
        if band is not None:
            low, high = (factor * end[:, c] for end in band)
            curves.append(Curve("95 % prediction", low, "band", upto=high, scaled=False))
        curves += [
            Curve("other sets", factor * simulated[:, c], "others", "thin", scaled=False)
            for simulated in trial.simulated[:0:-1]
        ]
        curves.append(
            Curve("measured", factor * measured, "ink", "dots" if alone or len(time) <= _DENSE else "thick")
        )
        if beside is not None and other is not None and fit.channels[c] in other.channels:
            at = beside.time - beside.time[0]
            values = factor * beside.simulated[0, :, other.channels.index(fit.channels[c])]
            values = np.interp(time, at, values, left=np.nan, right=np.nan)
            curves.append(Curve(f"best set of {other.name}", values, "blue", scaled=False))
        curves.append(Curve("best set", factor * trial.simulated[0, :, c], "best", scaled=False))
        name = channel_symbol(fit.channels[c])
        note = f"NRMSE {percent_text(float(trial.nrmse[0, c]))}"
        panels.append(Panel(name, unit, curves, note=note))
        error = trial.simulated[0, :, c] - measured
        look: Look = "dots" if alone else "thin"
        if noise is not None and np.isfinite(noise[c]) and noise[c] > 0:
            curve = Curve("residual", error / noise[c], "best", look)
            panels.append(Panel(f"residual of {name} over its noise", "1", [curve], low=True, shade=_NOISE))
        else:
            unit, finer = _FINER.get(unit, (unit, 1.0))
            curve = Curve("residual", finer * factor * error, "best", look)
            panels.append(Panel(f"residual of {name}", unit, [curve], low=True))
    # Stretches without any valid sample, such as an occlusion or a stall of the logger.
    lost = [
        (float(time[max(first - 1, 0)]), float(time[min(end, len(time) - 1)]))
        for first, end in runs(np.asarray(~trial.valid.any(axis=1)))
    ]
    return View(*names, time, panels, bars or {}, lost)


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
        axes.set_title(f"{as_words(fit.name)}: convergence of {len(fit.runs)} runs ({fit.kind})")
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
    drawn: dict[str, tuple[Style, list[tuple[int, float]]]] = {}
    for rank, run in enumerate(agreement.order, start=1):
        optimum = int(agreement.optimum[run])
        look = {"marker": _MARKERS[optimum % len(_MARKERS)], "color": RUNS[optimum % len(RUNS)]}
        name = f"optimum {chr(ord('A') + optimum % 26)}"
        if agreement.cut[run]:
            name, look = "not finished", {"marker": "o", "color": "0.4", "markerfacecolor": "none"}
        drawn.setdefault(name, (look, []))[1].append((rank, float(agreement.cost[run]) / best))
    for name, (look, points) in sorted(drawn.items()):
        axes.plot(*zip(*points, strict=True), linestyle="none", markersize=7, label=name, **look)
    # Differences within one optimum would look large on an axis of their own span.
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


def spectrum_figures(fit: FitResult, trials: Sequence[TrialResult]) -> dict[str, Figure]:
    """Draw the spectra of each channel before the filter, and the filter's gain [dB] over frequency [Hz]."""
    spectra = [trial.spectrum for trial in trials if trial.spectrum is not None]
    lowpass = stated_filter(fit.provenance.get("filter", {}))
    out = {}
    for c, channel in enumerate(fit.channels if spectra else ()):
        figure = Figure(figsize=(WIDTH, 3.2))
        axes = figure.add_axes((0.19, 0.15, 0.64, 0.81))
        unit, factor = unit_of(fit, c)
        for spectrum in spectra:
            density = factor * spectrum.density[:, c]
            if np.any(np.isfinite(density)):
                axes.loglog(spectrum.frequency, density, color="0.6", linewidth=0.7)
        axes.set(xlabel="frequency [Hz]", ylabel=f"{as_math(channel_symbol(channel))} [{unit}/√Hz]")
        axes.grid(True, color="0.92")
        if lowpass is not None:
            frequency = np.geomspace(1.0, max(float(spectrum.frequency[-1]) for spectrum in spectra), 400)
            gain = 20 * np.log10(np.maximum(np.abs(lowpass.gain(frequency)), 1e-6))
            right = axes.twinx()
            handles = [Line2D([], [], color="0.6", linewidth=0.7, label="trials, unfiltered")]
            handles += right.plot(frequency, gain, color=BEST, linewidth=1.5, label="filter")
            right.set_ylim(-90, 6)
            right.set_ylabel("gain of the filter [dB]", color=BEST)
            right.tick_params(axis="y", colors=BEST)
            axes.legend(handles=handles, frameon=False, fontsize=8, loc="lower left")
        out[channel] = figure
    return out


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
