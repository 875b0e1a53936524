"""The traces of a fit's trials for the screen, paper and files: measured, simulated, residual over noise."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from sysid.documents import channel_symbol
from sysid.filters import runs
from sysid.fit.result import FitResult, TrialResult
from sysid.report.answer import Reopened
from sysid.report.drawing import USES, display_of, percent_text
from sysid.report.fit_figures import Bars, trial_means
from sysid.report.plots import Curve, Panel, View, figure_of

# Smaller unit of the residuals of a unit, and its factor.
_FINER = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3)}
# Two deviations of the noise, within which residuals of noise alone are 95 % of the time [1].
_NOISE = (-2.0, 2.0)
# Number of samples beyond which the measurement is a line instead of dots.
_DENSE = 400


def figure_measured_against_simulated(fit: FitResult) -> Figure:
    """Draw all trials of a fit: a column per trial, each channel with its residual below."""
    views = []
    for trial in fit.trials:
        mean = percent_text(float(trial_means(fit, trial)[0]))
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
        curves.append(Curve("measured", factor * measured, "ink", "dots" if len(time) <= _DENSE else "line"))
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
        if noise is not None and np.isfinite(noise[c]) and noise[c] > 0:
            curve = Curve("residual", error / noise[c], "best", "thin")
            panels.append(Panel(f"residual of {name} over its noise", "1", [curve], low=True, shade=_NOISE))
        else:
            unit, finer = _FINER.get(unit, (unit, 1.0))
            curve = Curve("residual", finer * factor * error, "best", "thin")
            panels.append(Panel(f"residual of {name}", unit, [curve], low=True))
    # A stretch without any sample that counts: an occlusion, a stall of the logger.
    lost = [
        (float(time[max(first - 1, 0)]), float(time[min(end, len(time) - 1)]))
        for first, end in runs(np.asarray(~trial.valid.any(axis=1)))
    ]
    return View(*names, time, panels, bars or {}, lost)
