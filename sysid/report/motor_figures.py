"""Figures of motors: thrust over time, and after a reversal command as in the paper's Figs. 4 and 3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from sysid.fit.result import TrialResult
from sysid.report.drawing import (
    BEST,
    MEASURED,
    OTHERS,
    RUNS,
    axis_label,
    draw_legend,
    panel,
    panels,
    thinned,
    tidy,
)
from sysid.report.plots import Panel
from sysid.trials.reversal import LEVEL, Repetitions
from sysid.types import BoolArray, FloatArray

# Drawn before the command, and beyond the slowest repetition's 90 % [s].
_BEFORE, _BEYOND = 0.1, 0.2
# Drawn after a command of a fit's trial, at least where its end comes earlier [s].
_AFTER, _LEAST = 0.5, 0.3
# What paper shows of the colours of a page.
_COLOURS = {"ink": MEASURED, "best": BEST, "blue": RUNS[0]}


@dataclass(frozen=True, eq=False)
class ReversalCurves:
    """Thrust of one log around its reversals: times [s] and values [N], and a group per pair of commands."""

    name: str
    groups: tuple[Repetitions, ...]
    thrust: tuple[FloatArray, FloatArray]


def figure_reversals(logs: Sequence[ReversalCurves]) -> Figure:
    """Draw the thrust after each reversal command: a panel per pair of commands, a colour per log.

    At least one log has a reversal. Repetitions are thin lines, and the repetition of median time is thick; a
    dot marks 90 % of the final thrust.
    """
    pairs = list(dict.fromkeys((g.before, g.after) for log in logs for g in log.groups))
    figure, every = panels(len(pairs), min(len(pairs), 3), (4.2, 3.2), (2.2, 0.6))
    lines: dict[str, Line2D] = {}
    for axes, pair in zip(every, pairs, strict=True):
        axes.axhline(0.0, color="0.6", linewidth=0.8)
        axes.axvline(0.0, color="0.6", linewidth=0.8, linestyle=":")
        latest = 0.0
        for number, log in enumerate(logs):
            colour = RUNS[number % len(RUNS)]
            for group in (g for g in log.groups if (g.before, g.after) == pair):
                # Of each pair of commands, the repetition of median time is drawn.
                reached = [r for r in group.reversals if np.isfinite(r.to_level)]
                ranked = sorted(reached, key=lambda r: r.to_level)
                middle = ranked[len(ranked) // 2] if ranked else group.reversals[0]
                for reversal in group.reversals:
                    time, values = log.thrust
                    inside = (time >= reversal.time - _BEFORE) & (time < reversal.time + reversal.hold)
                    width, alpha = (2.0, 1.0) if reversal is middle else (0.6, 0.5)
                    look: dict[str, Any] = {"color": colour, "linewidth": width, "alpha": alpha}
                    (line,) = axes.plot(time[inside] - reversal.time, values[inside], **look)
                    if reversal is middle:
                        lines.setdefault(log.name, line)
                if ranked:
                    spot = [middle.to_level], [LEVEL * middle.final_thrust]
                    axes.plot(*spot, marker="o", color=colour, zorder=5)
                latest = max(latest, ranked[-1].to_level if ranked else group.reversals[0].hold)
        axes.set_xlim(-_BEFORE, latest + _BEYOND)
        axes.set_title(f"u {pair[0]:+.2f} → {pair[1]:+.2f}", fontsize="medium")
        axes.set(xlabel="time after the command [s]", ylabel="thrust [N]")
    figure.suptitle("thrust after a reversal command; dot: 90 % of the final thrust")
    figure.legend(list(lines.values()), list(lines), loc="outside right upper", frameon=False)
    return figure


def reversal_commands(trial: TrialResult) -> list[tuple[float, float, float]]:
    """Return (time [s], command before, after) of the commands that reverse the motor in a trial.

    Commands too near to an end of the trial are left out.
    """
    if trial.thrust is None or trial.commands is None:
        return []
    time, level = trial.commands.T
    out = []
    for k in range(1, len(time)):
        inside = trial.time[0] + _BEFORE < time[k] < trial.time[-1] - _LEAST
        if inside and level[k] * level[k - 1] < 0:
            out.append((float(time[k]), float(level[k - 1]), float(level[k])))
    return out


def around(trial: TrialResult, command: float) -> BoolArray:
    """Return which samples (n,) of a trial lie around a reversal command at an instant [s]."""
    return np.asarray((trial.time >= command - _BEFORE) & (trial.time <= command + _AFTER))


def figure_panel(shown: Panel, x: tuple[str, str]) -> Figure:
    """Draw a panel that a page lets touch, for paper; `x` is the label and unit of its curves' places."""
    figure, axes = panel(3.0)
    for curve in shown.curves:
        look: dict[str, Any] = {"marker": ".", "linestyle": "none", "markersize": 3}
        if curve.look != "dots":
            look = {"linewidth": 1.2, "linestyle": "--" if curve.look == "dashed" else "-"}
        colour = _COLOURS.get(curve.colour, OTHERS)
        axes.plot(curve.x, curve.values, color=colour, label=curve.label, **look)
    axes.set(xlabel=axis_label(*x), ylabel=axis_label(shown.label, shown.unit))
    axes.legend(fontsize=7, frameon=False)
    tidy(axes)
    return figure


def figure_thrust(
    trial: TrialResult,
    simulated: FloatArray,
    *,
    command: float | None = None,
    legend: bool = False,
) -> Figure:
    """Draw measured and simulated thrust (S, n) [N], as in the paper's Fig. 4; commands as steps.

    With `command`, an instant [s], only what lies around it is drawn, and the axis counts from there. The
    `legend` is for a single figure.
    """
    assert trial.thrust is not None
    figure, (top, bottom) = panel(3.4, nrows=2, sharex=True, height_ratios=(2.6, 1.0))
    inside = np.ones(len(trial.time), dtype=bool)
    if command is not None:
        inside = around(trial, command)
    origin = float(trial.time[0]) if command is None else command
    time = trial.time[inside] - origin
    top.plot(*thinned(time, trial.thrust[inside]), color=MEASURED, linewidth=2.0)
    for s in range(len(simulated) - 1, -1, -1):
        colour, width = (BEST, 1.2) if s == 0 else (OTHERS, 0.8)
        top.plot(*thinned(time, simulated[s][inside]), color=colour, linewidth=width)
    top.set_ylabel("thrust [N]")
    if trial.commands is not None:
        # The last command holds to the end.
        instants = np.append(trial.commands[:, 0] - origin, max(time[-1], trial.commands[-1, 0] - origin))
        levels = 100 * np.append(trial.commands[:, 1], trial.commands[-1, 1])
        bottom.step(instants, levels, where="post", color=RUNS[0])
    reverses = trial.commands is not None and trial.commands[:, 1].min() < 0 < trial.commands[:, 1].max()
    forward = trial.commands is None or trial.commands[:, 1].max() > 0
    bottom.set(ylim=(-115, 115) if reverses else (-10, 115) if forward else (-115, 10))
    bottom.set_ylabel("command\n[%]")
    bottom.set_xlabel("time [s]" if command is None else "time after the command [s]")
    if command is not None:
        for axes in (top, bottom):
            axes.axvline(0.0, color="0.6", linewidth=0.8, linestyle=":")
    if legend:
        entries = [(MEASURED, "thick", "measured"), (BEST, "line", "best set")]
        entries += [(OTHERS, "line", "other sets")] if len(simulated) > 1 else []
        entries += [(RUNS[0], "line", "command")] if trial.commands is not None else []
        draw_legend(figure, entries, "outside upper center", 4, fontsize=8)
    top.set_xlim(float(time[0]), float(time[-1]))
    tidy(top, bottom)
    figure.align_ylabels([top, bottom])
    return figure
