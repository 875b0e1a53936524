"""The figures of a fit for a paper: vectors in the larger layouts, by file name."""

from __future__ import annotations

import math
import re

from matplotlib.figure import Figure

from sysid.report.diagrams import figure_geometry, figure_modes, mode_shares
from sysid.report.fit_figures import (
    figure_spectrum,
    figure_spread,
    figure_thrust,
    figure_waterfall,
    filter_gain,
)
from sysid.report.fit_plots import figure_convergence, figure_measured_against_simulated
from sysid.report.fit_report import FitReport
from sysid.report.motor_figures import figure_reversal, reversal_commands
from sysid.report.snapshots import figure_snapshots
from sysid.report.trust_panels import (
    figure_correlation,
    figure_nrmse_profile,
    figure_profile,
    read_profiles,
)


def paper_figures(report: FitReport) -> dict[str, Figure]:
    """Return the figures of a fit by file name."""
    fit, drops = report.fit, report.drops()
    out = {"measured-against-simulated": figure_measured_against_simulated(fit)}
    for one in report.fits:
        for trial in one.trials:
            drop = report.replay(one, trial)
            down = [trial.time[0] + contact.start for contact in drop.contacts] if drop else ()
            name = _file_name(trial.name if one is fit else f"against-{one.name}-{trial.name}")
            out[f"trial-{name}"] = figure_measured_against_simulated(one, trial.name, contacts=down)
            if trial.thrust is not None:
                thrust = report.simulated_thrust(one, trial)
                out[f"thrust-{name}"] = figure_thrust(trial, thrust, legend=True)
                for number, (time, _, _) in enumerate(reversal_commands(trial), start=1):
                    figure = figure_reversal(trial, thrust, time, legend=True)
                    out[f"reversal-{name}-{number}"] = figure
            if drop is not None:
                out[f"snapshots-{name}"] = figure_snapshots(drop, legend=True)
    if fit.runs:
        out |= {"convergence": figure_convergence(fit), "waterfall": figure_waterfall(fit)}
    out["spread"] = figure_spread(fit)
    if fit.kind == "gear":
        steepest = max((drop.slope for drop in drops), default=math.radians(15.0))
        out["geometry"] = figure_geometry(report.values(), steepest)
    if fit.settings.get("surface") == "hf":
        out["modes"] = figure_modes(mode_shares(drops))
    spectra = [(t.name, t.spectrum) for t in report.trials if t.spectrum is not None]
    if spectra:
        gain = filter_gain(fit.provenance.get("filter", {}), max(float(s.frequency[-1]) for _, s in spectra))
        for c, channel in enumerate(fit.channels):
            out[f"spectrum-{channel}"] = figure_spectrum(fit, spectra, c, gain)
    known = {record.name: record for record in fit.parameters}
    for name, profile in (fit.settings.get("profiles") or {}).items():
        record = known[name]
        out[_file_name(f"profile-nrmse-{name}")] = figure_nrmse_profile(record.symbol, record.unit, profile)
    if report.trust is not None:
        out["correlation"] = figure_correlation(report.trust)
        curves = read_profiles(report.folder)
        for row in report.trust["parameters"]:
            if row["name"] in curves:
                name = _file_name(f"profile-{row['name']}")
                out[name] = figure_profile(row, *curves[row["name"]])
    return out


def _file_name(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "-", text)
