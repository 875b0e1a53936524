"""The traces of a fit's trials as plots that a reader can touch: measured, simulated, residual over noise."""

from __future__ import annotations

import numpy as np

from sysid.documents import channel_symbol
from sysid.fit.result import FitResult, TrialResult
from sysid.report.answer import Reopened
from sysid.report.drawing import display_of
from sysid.report.fit_figures import Bars
from sysid.report.plots import Curve, Panel, View

_FINER = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3)}
# Residuals of noise alone are within two of its deviations 95 % of the time.
_NOISE = (-2.0, 2.0)


def trial_view(
    fit: FitResult, trial: TrialResult, names: tuple[str, str], bars: Bars, known: Reopened,
    other: FitResult | None = None,
) -> View:  # fmt: skip
    """Return measured and simulated channels of a trial, each with its residual below.

    `names` are the key of the view and its title. Residuals are over the noise where it is known. `other` is
    a fit whose best set is drawn as well.
    """
    time, panels = trial.time - trial.time[0], []
    band, noise = known.band.get(trial.name), known.noise.get(trial.name)
    beside = next((each for each in other.trials if each.name == trial.name), None) if other else None
    for c in (c for c in range(len(fit.channels)) if trial.valid[:, c].any()):
        _, unit, factor = display_of(fit, c)
        measured = np.where(trial.valid[:, c], trial.measured[:, c], np.nan)
        curves = []
        if band is not None:
            low, high = (factor * end[:, c] for end in band)
            curves.append(Curve("95 % prediction", low, "band", upto=high, scaled=False))
        curves += [
            Curve("other sets", factor * simulated[:, c], "others", "thin", scaled=False)
            for simulated in trial.simulated[:0:-1]
        ]
        curves.append(Curve("measured", factor * measured, "ink", "dots" if len(time) <= 400 else "line"))
        if beside is not None and other is not None and fit.channels[c] in other.channels:
            at = beside.time - beside.time[0]
            values = factor * beside.simulated[0, :, other.channels.index(fit.channels[c])]
            values = np.interp(time, at, values, left=np.nan, right=np.nan)
            curves.append(Curve(f"best set of {other.name}", values, "blue", scaled=False))
        curves.append(Curve("best set", factor * trial.simulated[0, :, c], "best", scaled=False))
        name = channel_symbol(fit.channels[c])
        panels.append(Panel(name, unit, curves))
        error = trial.simulated[0, :, c] - measured
        if noise is not None and np.isfinite(noise[c]) and noise[c] > 0:
            curve = Curve("residual", error / noise[c], "best", "thin")
            panels.append(Panel(f"residual of {name} over its noise", "1", [curve], low=True, shade=_NOISE))
        else:
            unit, finer = _FINER.get(unit, (unit, 1.0))
            curve = Curve("residual", finer * factor * error, "best", "thin")
            panels.append(Panel(f"residual of {name}", unit, [curve], low=True))
    return View(*names, time, panels, bars)
