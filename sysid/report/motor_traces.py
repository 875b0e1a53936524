"""What a reader of a motor's report touches: static curves with their points, reversals, torque spikes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sysid.fit.result import FitResult, TrialResult
from sysid.report.motor_figures import around
from sysid.report.plots import Curve, Panel, View
from sysid.types import FloatArray

Points = Mapping[str, tuple[FloatArray, FloatArray]]
# Unit and factor from SI of each static curve.
_UNITS = {"thrust": ("N", 1.0), "torque": ("mN·m", 1e3), "no_load": ("rad/s", 1.0)}
_COLOURS: tuple[Any, ...] = ("best", "blue")
# Places of a drawn curve, and points of a cloud that are drawn.
_PLACES, _MOST = 60, 600


def command_panel(trial: TrialResult, time: FloatArray, inside: Any = slice(None)) -> Panel:
    """Return the command of a trial at times (n,) [s], of which those `inside` are drawn."""
    assert trial.commands is not None
    instants, levels = trial.commands.T
    level = levels[np.clip(np.searchsorted(instants, time, side="right") - 1, 0, None)]
    return Panel("command", "%", [Curve("command", 100 * level[inside], "blue", "steps")], low=True)


def curve_views(stated: Sequence[Mapping[str, Any]], points: Points) -> tuple[list[View], list[View]]:
    """Return static curves with their points: over the speed [rad/s], and over the command [1].

    `stated` are documents of `sysid.motor.static_curves.CurveFit`. Each view has the curve of both directions
    and below what the points lie off it.
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
            drawn = factor * _value(quantity, row["coefficients"], place)
            if len(x):
                # Two points of one speed are drawn beside each other: a curve has one value at a place.
                x = x + 1e-9 * end * np.arange(len(x))
                curves.append(Curve(f"points, {direction}", y, "ink", "dots", x=x))
                off = y - factor * _value(quantity, row["coefficients"], x)
                errors.append(Curve(f"off, {direction}", off, colour, "dots", x=x))
            curves.append(Curve(f"curve, {direction}", drawn, colour, x=place))
        if not curves:
            continue
        name = quantity.replace("_", "-") + (" speed" if quantity == "no_load" else "")
        panels = [Panel(name, unit, curves)]
        panels += [Panel(f"points off the {name} curve", unit, errors, low=True)] if errors else []
        view = View(f"static {quantity}", name, np.array([]), panels)
        (bare if quantity == "no_load" else loaded).append(view)
    return loaded, bare


def _value(quantity: str, coefficients: Sequence[float], x: FloatArray) -> FloatArray:
    first, second = coefficients
    if quantity == "no_load":
        return np.asarray(first * x + second * np.sign(x))
    return np.asarray(first * x * np.abs(x) + second * x)


def reversal_view(
    fit: FitResult, trial: TrialResult, thrust: FloatArray, command: float, title: str, edge: float
) -> View:
    """Return thrust, speed and command around a reversal at an instant [s].

    `thrust` (n,) is simulated with the best set [N], `edge` the speed of the dead band [rad/s].
    """
    inside = around(trial, command)
    panels = []
    if trial.thrust is not None:
        curves = [
            Curve("measured", trial.thrust[inside], "ink"),
            Curve("best set", thrust[inside], "best", scaled=False),
        ]
        panels.append(Panel("thrust", "N", curves))
    c = fit.channels.index("speed")
    measured = np.where(trial.valid[inside, c], trial.measured[inside, c], np.nan)
    curves = [
        Curve("measured", measured, "ink"),
        Curve("best set", trial.simulated[0, inside, c], "best", scaled=False),
    ]
    if np.isfinite(edge):
        band = np.full(len(measured), edge)
        curves.insert(0, Curve("dead band", -band, "faint", upto=band, scaled=False))
    panels.append(Panel("speed", "rad/s", curves))
    panels.append(command_panel(trial, trial.time, inside))
    return View(f"{trial.name} at {command:g} s", title, trial.time[inside] - command, panels)


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
    return View(
        "spikes", "torque spikes", np.array([]), [Panel("torque above the static one", "mN·m", curves)]
    )
