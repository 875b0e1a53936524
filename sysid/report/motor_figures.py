"""Figures of motors: thrust after a reversal command, in the manner of the paper's Fig. 3.

`reversal_commands` and `figure_reversal` are of a fit's trials, `figure_reversals` of logs by themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from sysid.fit.result import TrialResult
from sysid.report.fit_figures import figure_thrust
from sysid.report.fit_plots import RUNS
from sysid.trials.reversal import LEVEL, Repetitions
from sysid.types import FloatArray

# Drawn before the command, and beyond the slowest repetition's 90 % [s].
_BEFORE, _BEYOND = 0.1, 0.2
# Drawn after a command of a fit's trial, at least where its end comes earlier [s].
_AFTER, _LEAST = 0.5, 0.3


@dataclass(frozen=True, eq=False)
class ReversalCurves:
    """Thrust of one log around its reversals.

    Parameters
    ----------
    name : str
        Of the log.
    groups : tuple of Repetitions
        By pair of commands.
    thrust : (times [s], values [N])
    """

    name: str
    groups: tuple[Repetitions, ...]
    thrust: tuple[FloatArray, FloatArray]


def figure_reversals(logs: Sequence[ReversalCurves]) -> Figure:
    """Draw the thrust after each reversal command: a panel per pair of commands, a colour per log.

    Parameters
    ----------
    logs : sequence of ReversalCurves
        At least one with a reversal.

    Notes
    -----
    Repetitions are thin, the one of median time is thick; a dot marks 90 % of the final thrust.
    """
    pairs = list(dict.fromkeys((g.before, g.after) for log in logs for g in log.groups))
    columns = min(len(pairs), 3)
    rows = -(-len(pairs) // columns)
    figure = Figure(figsize=(4.2 * columns + 2.2, 3.2 * rows + 0.6), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for panel in panels[len(pairs) :]:
        panel.set_visible(False)
    handles: dict[str, Line2D] = {}
    for panel, pair in zip(panels, pairs, strict=False):
        panel.axhline(0.0, color="0.6", linewidth=0.8)
        panel.axvline(0.0, color="0.6", linewidth=0.8, linestyle=":")
        latest = 0.0
        for number, log in enumerate(logs):
            colour = RUNS[number % len(RUNS)]
            for group in (g for g in log.groups if (g.before, g.after) == pair):
                # One log may hold many pairs; within one, the repetition of median time stands for all.
                reached = [r for r in group.reversals if np.isfinite(r.to_level)]
                ranked = sorted(reached, key=lambda r: r.to_level)
                middle = ranked[len(ranked) // 2] if ranked else group.reversals[0]
                for reversal in group.reversals:
                    time, values = log.thrust
                    inside = (time >= reversal.time - _BEFORE) & (time < reversal.time + reversal.hold)
                    (line,) = panel.plot(
                        time[inside] - reversal.time, values[inside], color=colour,
                        linewidth=2.0 if reversal is middle else 0.6,
                        alpha=1.0 if reversal is middle else 0.5,
                    )  # fmt: skip
                    if reversal is middle:
                        handles.setdefault(log.name, line)
                if ranked:
                    panel.plot(
                        [middle.to_level], [LEVEL * middle.final_thrust], marker="o", color=colour, zorder=5
                    )
                    latest = max(latest, ranked[-1].to_level)
                else:
                    latest = max(latest, group.reversals[0].hold)
        panel.set_xlim(-_BEFORE, latest + _BEYOND)
        panel.set_title(f"u {pair[0]:+.2f} → {pair[1]:+.2f}", fontsize="medium")
        panel.set_xlabel("time after the command [s]")
        panel.set_ylabel("thrust [N]")
        panel.grid(True, color="0.92")
        panel.set_axisbelow(True)
    figure.suptitle("thrust after a reversal command; dot: 90 % of the final thrust")
    figure.legend(list(handles.values()), list(handles), loc="outside right upper", frameon=False)
    return figure


def reversal_commands(trial: TrialResult) -> list[tuple[float, float, float]]:
    """Return (time [s], command before, after) of the commands that reverse the motor in a trial.

    Only those that a figure of one fits around.
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


def figure_reversal(
    trial: TrialResult, simulated: FloatArray, time: float, *, legend: bool = False
) -> Figure:
    """Draw measured and simulated thrust (S, n) [N] around a reversal command at `time` [s]."""
    window = (time - _BEFORE, time + _AFTER)
    return figure_thrust(trial, simulated, window=window, zero=time, legend=legend)
