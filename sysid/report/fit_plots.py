"""Figures of a fit: measured against simulated, residuals, and how the search went.

Every function returns a `matplotlib.figure.Figure` of its own: nothing goes through pyplot, so no window, no
backend and no state is shared. Colours are those of Okabe and Ito, which colour-blind readers tell apart.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from sysid.errors import ExportError
from sysid.fit.result import FitResult, TrialResult
from sysid.storage import write_file
from sysid.types import FloatArray

MEASURED = "#000000"
BEST = "#D55E00"
OTHERS = "#56B4E9"
MASKED = "#E6E6E6"
RUNS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#000000")

# More samples than this are drawn as a line instead of dots, and than that as pixels inside a vector file.
_DENSE, _RASTER = 400, 4000
# Display of a channel: label, unit, and the factor from SI.
_DISPLAY: dict[str, tuple[str, str, float]] = {
    "x_B": (r"$x_B$", "m", 1.0),
    "z_B": (r"$z_B$", "m", 1.0),
    "x_B_rate": (r"$\dot{x}_B$", "m/s", 1.0),
    "z_B_rate": (r"$\dot{z}_B$", "m/s", 1.0),
    "q_B": (r"$q_B$", "deg", 180.0 / np.pi),
    "torque": ("torque", "mN·m", 1e3),
    "stator_torque": ("stator torque", "mN·m", 1e3),
    "speed": (r"speed $\Omega$", "rad/s", 1.0),
    "thrust": ("thrust", "N", 1.0),
}
# Residuals of some units are easier to read in a smaller one.
_FINER = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3)}
_LINE = "\n"
# A trial's name above a column of its own; longer ones would reach into the next.
_LONGEST_NAME = 30
_FORMATS = (".png", ".pdf", ".svg")


def figure_measured_against_simulated(
    fit: FitResult, trial: str | None = None, *, contacts: Sequence[float] = ()
) -> Figure:
    """Draw what was measured and what each set simulates, with the residual of the best set.

    Parameters
    ----------
    fit : FitResult
        Finished fit.
    trial : str, optional
        One trial by name, in large: a row per channel, signals left, residual right. Without it all trials:
        a column per trial, a row per channel, the residual below each.
    contacts : sequence of float
        Times of foot contacts on the recording's clock [s], drawn as thin lines; one trial only.

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
    chosen = [one for one in fit.trials if one.name == trial]
    if not chosen:
        known = ", ".join(one.name for one in fit.trials) or "none"
        raise ExportError(f"{fit.name}: no trial {trial!r} to draw; found {known}")
    return _one_trial(fit, chosen[0], contacts)


def figure_convergence(fit: FitResult) -> Figure:
    """Draw the best NRMSE of every generation, one line per run; a dot where the run stopped."""
    figure = Figure(figsize=(9.5, 4.6), layout="constrained")
    axes = figure.add_subplot()
    for number, run in enumerate(fit.runs, start=1):
        colour = RUNS[(number - 1) % len(RUNS)]
        generations = np.arange(1, len(run.best) + 1)
        label = f"run {number}: {percent_text(float(run.best[-1]))} after {len(run.best)}"
        axes.plot(generations, run.best, color=colour, linewidth=1.6, label=label)
        axes.plot(generations[-1:], run.best[-1:], marker="o", color=colour)
    percent_axis(axes, np.concatenate([run.best for run in fit.runs]) if fit.runs else np.ones(1))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel("generation")
    axes.set_ylabel("best NRMSE [%]")
    axes.set_title(f"{fit.name}: convergence of {len(fit.runs)} runs ({fit.kind})")
    axes.grid(True, color="0.9")
    if fit.runs:
        figure.legend(
            loc="outside right upper", frameon=False, title="best NRMSE, generations", alignment="left"
        )
    return figure


def check_figure_name(path: Path) -> None:
    """Refuse a file that no figure can be written to.

    Raises
    ------
    ExportError
        For another suffix than ``.png``, ``.pdf`` or ``.svg``.
    """
    if path.suffix.lower() not in _FORMATS:
        raise ExportError(
            f"{path}: unknown figure format {path.suffix!r}; expected one of {', '.join(_FORMATS)}"
        )


def save_figure(figure: Figure, path: str | Path, *, dpi: float = 150.0) -> Path:
    """Write a figure as PNG, PDF or SVG; an existing file is replaced only by a complete one.

    Parameters
    ----------
    figure : Figure
        What to write.
    path : str or Path
        Ends in ``.png``, ``.pdf`` or ``.svg``; its folder exists.
    dpi : float
        Pixels per inch of a PNG, and of dense curves inside the others.

    Raises
    ------
    ExportError
        For another suffix or a file that cannot be written.
    """
    path = Path(path)
    check_figure_name(path)
    suffix = path.suffix.lower()
    buffer = io.BytesIO()
    # No date and no random names inside: the same figure gives the same bytes.
    metadata = {".png": {}, ".pdf": {"CreationDate": None}, ".svg": {"Date": None}}[suffix]
    with rc_context({"svg.hashsalt": "sysid"}):
        figure.savefig(buffer, format=suffix[1:], dpi=dpi, metadata=metadata)
    write_file(path, buffer.getvalue(), ExportError)
    return path


def _one_trial(fit: FitResult, trial: TrialResult, contacts: Sequence[float]) -> Figure:
    rows = len(fit.channels)
    figure = Figure(figsize=(11.0, 1.2 + 2.0 * rows), layout="constrained")
    grid = figure.subplots(rows, 2, sharex=True, squeeze=False, width_ratios=(2.2, 1.0))
    for c in range(rows):
        signal, residual = grid[c]
        _draw_signals(signal, fit, trial, c)
        _draw_residual(residual, fit, trial, c)
        for axes in (signal, residual):
            for time in contacts:
                axes.axvline(time - trial.time[0], color="#009E73", linewidth=0.8, linestyle=":", zorder=1)
        residual.set_title(f"NRMSE {percent_text(_best_nrmse(trial, c))}", fontsize="medium")
    grid[0, 0].set_title("signals", fontsize="medium")
    for axes in grid[-1]:
        axes.set_xlabel("time in the window [s]")
    figure.suptitle(_title(fit, trial))
    figure.legend(
        handles=_legend(fit, [trial], bool(contacts)), loc="outside lower center", ncols=5, frameon=False
    )
    figure.align_ylabels(grid[:, 0])
    figure.align_ylabels(grid[:, 1])
    return figure


def _all_trials(fit: FitResult) -> Figure:
    rows, columns = len(fit.channels), len(fit.trials)
    width, height = max(9.0, 1.2 + 3.1 * columns), 1.7 + 2.5 * rows
    # Fixed margins: laying out eighty axes automatically takes longer than drawing them.
    figure = Figure(figsize=(width, height))
    cells = figure.add_gridspec(
        rows,
        columns,
        left=1.0 / width,
        right=1.0 - 0.15 / width,
        bottom=0.95 / height,
        top=1.0 - 0.95 / height,
        hspace=0.2,
        wspace=0.3,
    )
    labelled = []
    for t, trial in enumerate(fit.trials):
        shared: Axes | None = None
        for c in range(rows):
            pair = cells[c, t].subgridspec(2, 1, height_ratios=(2.3, 1.0), hspace=0.09)
            signal = figure.add_subplot(pair[0], sharex=shared)
            shared = shared or signal
            residual = figure.add_subplot(pair[1], sharex=shared)
            _draw_signals(signal, fit, trial, c, label=t == 0)
            _draw_residual(residual, fit, trial, c, label=t == 0)
            signal.tick_params(labelbottom=False)
            residual.tick_params(labelbottom=c == rows - 1)
            signal.set_title(f"NRMSE {percent_text(_best_nrmse(trial, c))}", fontsize="small", loc="right")
            if c == 0:
                use = "fitted" if trial.use == "fit" else "validation"
                name = (
                    trial.name if len(trial.name) <= _LONGEST_NAME else f"{trial.name[: _LONGEST_NAME - 1]}…"
                )
                signal.set_title(f"{name}\n{use}", fontsize="medium", loc="left")
            if t == 0:
                labelled += [signal, residual]
        residual.set_xlabel("time in the window [s]")
    title = f"{fit.name}: measured against simulated ({fit.kind}); NRMSE of the best set"
    figure.suptitle(title, y=1.0 - 0.25 / height)
    figure.legend(handles=_legend(fit, fit.trials, False), loc="lower center", ncols=5, frameon=False)
    figure.align_ylabels(labelled)
    return figure


def _draw_signals(axes: Axes, fit: FitResult, trial: TrialResult, c: int, *, label: bool = True) -> None:
    name, unit, factor = display_of(fit, c)
    time = trial.time - trial.time[0]
    raster = len(time) > _RASTER
    valid = trial.valid[:, c]
    shown = np.where(valid, factor * trial.measured[:, c], np.nan)
    _shade(axes, trial)
    for s in range(len(trial.simulated) - 1, -1, -1):
        axes.plot(
            time,
            factor * trial.simulated[s, :, c],
            color=BEST if s == 0 else OTHERS,
            linewidth=1.3 if s == 0 else 0.8,
            zorder=4 if s == 0 else 3,
            rasterized=raster,
        )
    if len(time) > _DENSE:
        axes.plot(time, shown, color=MEASURED, linewidth=2.2, zorder=2, rasterized=raster)
    else:
        axes.plot(time, shown, color=MEASURED, linestyle="none", marker=".", markersize=3.2, zorder=2)
    # A set that went astray must not flatten the measurement it is compared with.
    if np.any(np.isfinite(shown)):
        low, high = float(np.nanmin(shown)), float(np.nanmax(shown))
        margin = 0.25 * (high - low) or 1.0
        bottom, top = axes.get_ylim()
        axes.set_ylim(max(bottom, low - margin), min(top, high + margin))
    if label:
        axes.set_ylabel(f"{name}{_LINE if len(name) > 11 and '$' not in name else ' '}[{unit}]")
    _tidy(axes, time)


def _draw_residual(axes: Axes, fit: FitResult, trial: TrialResult, c: int, *, label: bool = True) -> None:
    _, unit, factor = display_of(fit, c)
    unit, finer = finer_unit(unit)
    time = trial.time - trial.time[0]
    _shade(axes, trial)
    axes.axhline(0.0, color="0.6", linewidth=0.8)
    if len(trial.simulated):
        error = finer * factor * (trial.simulated[0, :, c] - trial.measured[:, c])
        axes.plot(
            time,
            np.where(trial.valid[:, c], error, np.nan),
            color=BEST,
            linewidth=0.8,
            rasterized=len(time) > _RASTER,
        )
    if label:
        axes.set_ylabel(f"residual\n[{unit}]")
    _tidy(axes, time)


def _tidy(axes: Axes, time: FloatArray) -> None:
    axes.set_xlim(float(time[0]), float(time[-1]))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    axes.grid(True, color="0.92")
    axes.set_axisbelow(True)


def _shade(axes: Axes, trial: TrialResult) -> None:
    """Shade the intervals in which no channel counts."""
    time = trial.time - trial.time[0]
    for first, last in masked_runs(trial):
        left = time[max(first - 1, 0)]
        right = time[min(last + 1, len(time) - 1)]
        axes.axvspan(float(left), float(right), color=MASKED, linewidth=0, zorder=0)


def masked_runs(trial: TrialResult) -> list[tuple[int, int]]:
    """Return (first, last) sample of every run that counts for no channel."""
    lost = np.concatenate([[False], ~trial.valid.any(axis=1), [False]])
    edges = np.flatnonzero(np.diff(lost.astype(np.int8)))
    return [(int(first), int(end) - 1) for first, end in zip(edges[::2], edges[1::2], strict=True)]


def _legend(fit: FitResult, trials: Sequence[TrialResult], contacts: bool) -> list[Line2D | Patch]:
    dense = all(len(trial.time) > _DENSE for trial in trials)
    measured = Line2D([], [], color=MEASURED, linewidth=2.2, label="measured")
    if not dense:
        measured = Line2D([], [], color=MEASURED, linestyle="none", marker=".", label="measured")
    handles: list[Line2D | Patch] = [measured]
    if len(fit.nrmse):
        handles.append(Line2D([], [], color=BEST, linewidth=1.3, label="best set, and its residual"))
    if len(fit.nrmse) > 1:
        others = "the other set" if len(fit.nrmse) == 2 else f"the other {len(fit.nrmse) - 1} sets"
        handles.append(Line2D([], [], color=OTHERS, linewidth=0.8, label=others))
    if any(masked_runs(trial) for trial in trials):
        handles.append(Patch(color=MASKED, label="no sample counts"))
    if contacts:
        handles.append(Line2D([], [], color="#009E73", linewidth=0.8, linestyle=":", label="foot contact"))
    return handles


def _title(fit: FitResult, trial: TrialResult) -> str:
    use = "fitted" if trial.use == "fit" else "validation, not fitted"
    weights = np.asarray(fit.channel_weights)
    used = weights > 0
    means = trial.nrmse[:, used] @ (weights[used] / weights[used].sum())
    text = f"{fit.name}, {trial.name} ({use})"
    if not len(means):
        return text
    text += f": NRMSE {percent_text(float(means[0]))}"
    if len(means) > 1:
        least, most = float(means.min()), float(means.max())
        low, high = percent_text(least), percent_text(most)
        # Sets that score alike to the printed digits need no span.
        every = "both" if len(means) == 2 else f"all {len(means)}"
        text += f", {every} sets {low} to {high}" if low != high else ""
    return text


def axis_label(name: str, unit: str) -> str:
    """Return ``name [unit]``; a number without unit is ``name [1]``."""
    return f"{name} [{unit or '1'}]"


def finer_unit(unit: str) -> tuple[str, float]:
    """Return the unit in which residuals are read, and its factor."""
    return _FINER.get(unit, (unit, 1.0))


def display_of(fit: FitResult, c: int) -> tuple[str, str, float]:
    """Return how channel number `c` is shown: label, unit, factor from SI."""
    known = _DISPLAY.get(fit.channels[c])
    return known if known else (fit.channels[c], fit.channel_units[c], 1.0)


def percent_axis(axes: Axes, values: FloatArray) -> None:
    """Label an axis of shares in percent: logarithmic where they span a factor of three or more."""
    if np.max(values) >= 3 * np.min(values) > 0:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0, 7.0), numticks=12))
        axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:.4g}"))


def _best_nrmse(trial: TrialResult, c: int) -> float:
    return float(trial.nrmse[0, c]) if len(trial.nrmse) else float("nan")


def percent_text(share: float) -> str:
    """Return a share [1] in percent; a dash where it is unknown."""
    if not np.isfinite(share):
        return "—"
    return f"{100 * share:.{1 if share >= 0.1 else 2}f} %"
