"""What is drawn of motors: reversals as in the paper's Figs. 3 and 4, static curves, torque spikes."""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from sysid.fit.result import FitResult, TrialResult
from sysid.report.drawing import RUNS, panels
from sysid.report.html import Html
from sysid.report.plots import Colour, Curve, Panel, View
from sysid.trials.reversal import LEVEL, Repetitions
from sysid.types import BoolArray, FloatArray

# Drawn time before a command, and after the slowest repetition has reached 90 % of its final thrust [s].
_BEFORE, _BEYOND = 0.1, 0.2
# Drawn time after a command of a trial, and the least time that must be left in the trial then [s].
_AFTER, _LEAST = 0.5, 0.3
# Places x and values y of a cloud of points, by its name.
Points = Mapping[str, tuple[FloatArray, FloatArray]]
# Unit of each static curve, and factor from SI.
_UNITS = {"thrust": ("N", 1.0), "torque": ("mN·m", 1e3), "no_load": ("rad/s", 1.0)}
_COLOURS: tuple[Colour, ...] = ("best", "blue")
# Number of places of a drawn curve, and greatest number of drawn points of a cloud.
_PLACES, _MOST = 60, 600


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
                # The thick line of a pair of commands is its repetition of median time.
                reached = [r for r in group.reversals if np.isfinite(r.to_level)]
                ranked = sorted(reached, key=lambda r: r.to_level)
                middle = ranked[len(ranked) // 2] if ranked else group.reversals[0]
                for reversal in group.reversals:
                    time, values = log.thrust
                    inside = (time >= reversal.time - _BEFORE) & (time < reversal.time + reversal.hold)
                    width, alpha = (2.0, 1.0) if reversal is middle else (0.6, 0.5)
                    (line,) = axes.plot(
                        time[inside] - reversal.time,
                        values[inside],
                        color=colour,
                        linewidth=width,
                        alpha=alpha,
                    )
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


def thrust_panel(
    trial: TrialResult, simulated: FloatArray, inside: BoolArray, label: str = "thrust"
) -> Panel:
    """Return measured and simulated thrust (S, n) [N] of the samples (n,) that are `inside`."""
    assert trial.thrust is not None
    curves = [Curve("other sets", each[inside], "others", "thin", scaled=False) for each in simulated[:0:-1]]
    curves.append(Curve("measured", trial.thrust[inside], "ink", "thick"))
    curves.append(Curve("best set", simulated[0, inside], "best", scaled=False))
    return Panel(label, "N", curves)


def command_panel(trial: TrialResult, inside: BoolArray) -> Panel:
    """Return the command of a trial at the samples (n,) that are `inside`."""
    assert trial.commands is not None
    instants, levels = trial.commands.T
    level = levels[np.clip(np.searchsorted(instants, trial.time[inside], side="right") - 1, 0, None)]
    return Panel("command", "%", [Curve("command", 100 * level, "blue", "steps")], low=True)


def curve_views(
    stated: Sequence[Mapping[str, Any]], points: Points, maps: Container[str] = ()
) -> tuple[list[View], list[View]]:
    """Return static curves with their points: over the speed [rad/s], and over the command [1].

    `stated` are documents of `sysid.motor.static_curves.CurveFit`. Each view has the curve of both directions
    and below what the points lie off it. In the directions of `maps` the fit follows the steady levels
    instead of the no-load line.
    """
    loaded: list[View] = []
    bare: list[View] = []
    for quantity, (unit, factor) in _UNITS.items():
        curves, errors = [], []
        rows = [row for row in stated if row["quantity"] == quantity]
        for row, colour in zip(rows, _COLOURS, strict=False):
            direction = row["direction"]
            x, y = points.get(f"{quantity}_{direction}", (np.array([]), np.array([])))
            known = np.isfinite(x) & np.isfinite(y)
            x, y = x[known], factor * y[known]
            end = 1.0 if quantity == "no_load" else float(np.max(np.abs(x), initial=1000.0))
            sign = 1.0 if direction == "forward" else -1.0
            place = sign * np.linspace(0.0 if quantity != "no_load" else 0.02, end, _PLACES)
            if len(x):
                # A page's curve has one value at a place: points of equal speed are moved apart by a trifle.
                x = x + 1e-9 * end * np.arange(len(x))
                curves.append(Curve(f"points, {direction}", y, "ink", "dots", x=x))
                off = y - factor * _value(quantity, row["coefficients"], x)
                errors.append(Curve(f"off, {direction}", off, colour, "dots", x=x))
            drawn = factor * _value(quantity, row["coefficients"], place)
            mapped = quantity == "no_load" and direction in maps
            label = f"{'straight line' if mapped else 'curve'}, {direction}"
            curves.append(Curve(label, drawn, "faint" if mapped else colour, x=place))
        if not curves:
            continue
        name = quantity.replace("_", "-") + (" speed" if quantity == "no_load" else "")
        panels = [Panel(name, unit, curves)]
        panels += [Panel(f"points off the {name} curve", unit, errors, low=True)] if errors else []
        axis = ("command u", "1") if quantity == "no_load" else ("speed", "rad/s")
        view = View(f"static {quantity}", name, np.array([]), panels, axis=axis)
        (bare if quantity == "no_load" else loaded).append(view)
    return loaded, bare


def supply_view(direction: str, law: Mapping[str, Any]) -> View:
    """Return the loaded speed of the steady levels over the command, and the straight line through them.

    `law` is the document of `sysid.motor.static_curves.NoLoadTie`, of levels that rise in |u|.
    """
    (u, speed, _), (slope, intercept) = np.array(law["levels"]).T, law["line"]
    line = Curve("straight line", slope * u + intercept, "faint", x=u, scaled=False)
    curves = [line, Curve("steady levels", speed, "ink", "dots", x=u)]
    if law["law"] == "map":
        curves.insert(1, Curve("map", speed, "best", x=u))
    panels = [Panel("loaded speed V_ref/V", "rad/s", curves)]
    off = Curve("off", speed[1:] - slope * u[1:] - intercept, "best", "dots", x=u[1:])
    panels.append(Panel("levels off the straight line", "rad/s", [off], low=True))
    title = f"supply law, {direction}"
    return View(title, title, np.array([]), panels, axis=("command |u|", "1"))


def _value(quantity: str, coefficients: Sequence[float], x: FloatArray) -> FloatArray:
    first, second = coefficients
    if quantity == "no_load":
        return np.asarray(first * x + second * np.sign(x))
    return np.asarray(first * x * np.abs(x) + second * x)


def reversal_view(
    fit: FitResult, trial: TrialResult, simulated: FloatArray, command: float, title: str, edge: float
) -> View:
    """Return thrust, speed and command around a reversal at an instant [s].

    The `simulated` thrust (S, n) is that of every set [N], `edge` the speed of the dead band [rad/s].
    """
    inside = np.asarray((trial.time >= command - _BEFORE) & (trial.time <= command + _AFTER))
    c = fit.channels.index("speed")
    measured = np.where(trial.valid[inside, c], trial.measured[inside, c], np.nan)
    curves = [
        Curve("measured", measured, "ink", "thick"),
        Curve("best set", trial.simulated[0, inside, c], "best", scaled=False),
    ]
    if np.isfinite(edge):
        band = np.full(int(inside.sum()), edge)
        curves.insert(0, Curve("dead band", -band, "faint", upto=band, scaled=False))
    panels = [thrust_panel(trial, simulated, inside)] if trial.thrust is not None else []
    panels += [Panel("speed", "rad/s", curves), command_panel(trial, inside)]
    axis = ("time after the command", "s")
    return View(f"{trial.name} at {command:g} s", title, trial.time[inside] - command, panels, axis=axis)


def spike_view(stated: Mapping[str, Mapping[str, Any]], points: Points, inertia: float) -> View | None:
    """Return torque above the static one over the acceleration; None without points.

    `stated` is the document of `sysid.motor.inertia.SpikeInertia`, `inertia` the best set's [kg·m²].
    """
    curves, far = [], 0.0
    for kind, colour in zip(("up", "down"), _COLOURS, strict=True):
        if f"spikes_{kind}" not in points:
            continue
        x, y = points[f"spikes_{kind}"]
        every = np.unique(np.linspace(0, len(x) - 1, min(len(x), _MOST)).astype(int))
        far = max(far, float(np.max(np.abs(x))))
        curves.append(Curve(f"{kind}-steps", 1e3 * y[every], colour, "dots", x=x[every]))
        ends = np.array([0.0, np.max(x) if kind == "up" else np.min(x)])
        slope = 1e3 * stated[kind]["inertia"] * ends
        curves.append(Curve(f"slope of {kind}-steps", slope, colour, "dashed", x=ends))
    if not curves:
        return None
    ends = np.array([-far, far])
    curves.append(Curve("best set", 1e3 * inertia * ends, "ink", x=ends, scaled=False))
    panel = Panel("torque above the static one", "mN·m", curves)
    return View("spikes", "torque spikes", np.array([]), [panel], axis=("acceleration", "rad/s²"))


def motor_sketch() -> Html:
    """Return the model of a motor: a voltage, winding resistance and inductance, back-emf and a propeller."""
    coil = "".join("a7 7 0 0 1 14 0" for _ in range(4))
    parts = [
        '<path d="M20 150V96M20 84V40H52"/><path d="M8 96H32M13 84H27" stroke-width="3"/>',
        '<path d="M52 40l5-9 9 18 9-18 9 18 9-18 5 9" stroke="var(--c-best)"/><path d="M98 40h14"/>',
        f'<path d="M112 40{coil}" stroke="var(--c-best)"/><path d="M168 40H196V68M196 122V150H20"/>',
        '<circle cx="196" cy="95" r="27" fill="var(--c-body)"/><path d="M223 95h37" stroke-width="4"/>',
        '<ellipse cx="264" cy="62" rx="7" ry="33"/><ellipse cx="264" cy="128" rx="7" ry="33"/>',
        '<path d="M286 95h26m-9-7l9 7l-9 7" stroke="var(--c-blue)"/>',
    ]
    for x, y, letter in ((75, 22, "R"), (140, 22, "L"), (196, 102, "e"), (48, 95, "u"), (300, 84, "T")):
        parts.append(f'<text x="{x}" y="{y}">{letter}</text>')
    words = "circuit of the motor: voltage, resistance, inductance, back-emf; propeller with its thrust"
    return Html(f'<svg role="img" aria-label="{words}" viewBox="0 8 322 152">{"".join(parts)}</svg>')
