"""What the report of a motor adds: thrust, static curves, reversals, spikes, steps of the model."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sysid.documents import interval
from sysid.fit.result import FitResult, TrialResult
from sysid.motor.model import PARAMETERS as MOTOR
from sysid.motor.model import thrust as static_thrust
from sysid.report.drawing import USES
from sysid.report.fit_report import FitReport, titled
from sysid.report.html import NOTHING, Html, bullets, columns, definitions, markup_table, paragraph
from sysid.report.motor_figures import (
    command_panel,
    curve_views,
    motor_sketch,
    reversal_commands,
    reversal_view,
    spike_view,
    supply_view,
    thrust_panel,
)
from sysid.report.plots import Curve, Panel, View, figure_of, interactive, printed
from sysid.report.table import NONE, Table, listed, number
from sysid.types import FloatArray

# Number of reversals on a printed page.
_MOST_REVERSALS = 6


class MotorReport(FitReport):
    """The report of a motor."""

    title = "Motor: what the bench logs say"
    about_signals = (
        "The thrust is not compared in the fit: it follows from the speed and the static curve, and so tells "
        "whether both are right."
    )
    sections = (
        ("parameters",), ("stand", "supply_law"), ("measured_against_simulated",), ("static_curves",),
        ("reversals",),
        ("spikes", "trial_errors"), ("ladder",), ("convergence", "spread"), ("profiles", "correlation"),
        ("validation", "filter_response"), ("provenance",),
    )  # fmt: skip
    model = "motor"

    def sketch(self) -> Html:
        """Return the circuit and the propeller."""
        return motor_sketch()

    def more_panels(self, fit: FitResult, trial: TrialResult) -> list[Panel]:
        """Return the speed with what is left out of it, the thrust that is not compared, and the command."""
        every, out = np.ones(len(trial.time), dtype=bool), []
        c = fit.channels.index("speed")
        dropped = np.isfinite(trial.measured[:, c]) & ~trial.valid[:, c]
        if dropped.any():
            speed = trial.measured[:, c]
            curves = [Curve("measured", np.where(dropped, np.nan, speed), "ink")]
            curves.append(Curve("left out", np.where(dropped, speed, np.nan), "best", "dots"))
            out.append(Panel("speed with what is left out", "rad/s", curves))
        if trial.thrust is not None and np.isfinite(trial.thrust).any():
            out.append(thrust_panel(trial, self.simulated_thrust(fit, trial), every, "thrust, not compared"))
        if trial.commands is not None:
            out.append(command_panel(trial, every))
        return out

    @titled(
        "From the stand alone",
        "What steady levels and steps of the speed show without a model of the winding: curves, time "
        "constants, lost power.",
    )
    def stand(self) -> Html:
        """Return what the logs give without R and L."""
        stand = self.fit.settings.get("stand", {})
        said = stand.get("sentences", ())
        if not said:
            return paragraph("This fit states none: it is of an older version.", "note")
        curves = stand.get("curves", ())
        # The first sentences have the numbers of the table.
        rest = said[len({(row["quantity"], row["direction"]) for row in curves}) :]
        out = markup_table(_curve_table(curves, stand.get("calibration", 0.0))) if curves else NOTHING
        return out + bullets(rest) if rest else out

    @titled(
        "Supply law",
        "Loaded speed of the steady levels over the command, times V_ref over the measured voltage V. Where "
        "a straight line misses them, the levels are the law: V_c = k_v Ω_0(u) V/V_ref.",
    )
    def supply_law(self) -> Html:
        """Return the map from command to speed."""
        laws = self.fit.settings.get("supply_law", {})
        views = [supply_view(direction, law) for direction, law in laws.items()]
        if not views:
            return paragraph(
                "No command is logged, or the campaign or a log without propeller gives the no-load speed.",
                "note",
            )
        words = {"map": "the levels themselves", "line": "a straight line"}
        rows = [
            (way, f"{words[law['law']]}; a line misses the levels by {100 * law['misfit_of_line']:.2g} %")
            for way, law in laws.items()
        ]
        return interactive(views, "supply law") + definitions(rows, "which law explains the steady levels")

    @titled(
        "Static curves",
        "Steady points of the bench and the curves that the fit takes as known: thrust and torque over the "
        "speed, the speed without load over the command, both directions.",
    )
    def static_curves(self) -> Html:
        """Return the static curves with their points."""
        stated = [
            *self.fit.settings.get("static_curves", ()),
            *self.fit.settings.get("static_curves_of_best_set", ()),
        ]
        if not stated:
            return paragraph("No static curve was fitted: the campaign states them.", "note")
        laws = self.fit.settings.get("supply_law", {})
        maps = {way for way, law in laws.items() if law["law"] == "map"}
        loaded, bare = curve_views(stated, self.known.evidence, maps)
        left, right = (interactive(views, "static curves") if views else NOTHING for views in (loaded, bare))
        rows = [
            (
                f"{row['quantity'].replace('_', '-')}, {row['direction']}",
                f"R² {row['r_squared']:.5f}, {row['points']} points"
                + (f", outliers: {row['outliers']}" if row["outliers"] else ""),
            )
            for row in stated
        ]
        out = columns(left, right) + definitions(rows, "how well the points lie on the curves")
        if maps:
            out += paragraph(
                f"No-load, {' and '.join(sorted(maps))}: the fit does not take the grey straight line. It "
                "follows the steady levels (Supply law); exported sets have the line.",
                "note",
            )
        return out if self.known.evidence else out + self._no_points

    @titled(
        "Reversals",
        "Thrust and speed around commands that turn the motor round; grey: the dead band, where the "
        "current saturates. Below: the time until 90 % of the final thrust.",
    )
    def reversals(self) -> Html:
        """Return thrust and speed after reversal commands, in the manner of Fig. 3, and the delays."""
        views = [view for trial in self.fit.trials for view in self._reversals(self.fit, trial)]
        if not views:
            return paragraph("No trial reverses the motor.", "note")
        # Paper has a few, evenly spread, so that fitted trials and held-out trials are among them.
        count = min(len(views), _MOST_REVERSALS)
        shown = np.unique(np.linspace(0, len(views) - 1, count).round().astype(int))
        static = printed([views[k] for k in shown])
        if len(shown) < len(views):
            drawn = f"{len(shown)} of {len(views)} reversals are drawn"
            static += paragraph(f"{drawn}; sysid report --figure FOLDER draws all.", "note")
        out = interactive(views, "reversals", static, noun="reversal")
        rows = [
            (
                f"{row['trial']} ({row['use']}): "
                + " to ".join(f"{_signed(row[f'command_{when}'])} %" for when in ("before", "after")),
                ", ".join(f"{_milliseconds(row[what])} {what}" for what in ("measured", "simulated")),
            )
            for row in self.fit.settings.get("reversal_delays", ())
        ]
        return out + definitions(rows, "from the command to 90 % of the final thrust") if rows else out

    @titled(
        "Torque spikes",
        "At a step the load cell feels the rotor's inertia: torque above the static one over the "
        "acceleration of the measured speed. The slope is the inertia, whatever the winding does.",
    )
    def spikes(self) -> Html:
        """Return the inertia that up-steps and down-steps show."""
        stated = self.fit.settings.get("rotor_inertia_from_torque_spikes")
        if not stated:
            return paragraph("The torque spikes were not looked at in this fit.", "note")
        inertia = self._best("rotor_inertia")
        view = spike_view(stated, self.known.evidence, inertia)
        if view:
            out = interactive([view], "torque spikes")
        elif any(row["steps"] for row in stated.values()):
            out = self._no_points
        else:
            words = "No step shows a whole spike: record two steps up and two down, each for 0.4 s or longer."
            out = paragraph(words, "note")
        rows = [
            (
                f"{row['steps']} {kind}-steps",
                f"{row['inertia']:.4g} ± {row['standard_error']:.1g} kg·m²" if row["steps"] else "—",
            )
            for kind, row in stated.items()
        ]
        return out + definitions([*rows, ("best set", f"{inertia:.4g} kg·m²")], "rotor inertia")

    @property
    def _no_points(self) -> Html:
        return paragraph(f"The points are not shown: {self.known.why_not}.", "note")

    def _reversals(self, fit: FitResult, trial: TrialResult) -> list[View]:
        """Return what is drawn of each reversal command in a trial."""
        commands, views = reversal_commands(trial), []
        thrust = self.simulated_thrust(fit, trial) if commands else np.empty((0, 0))
        for time, before, after in commands:
            title = f"{trial.name} ({USES[trial.use]}): from {_signed(before)} % to {_signed(after)} %"
            views.append(reversal_view(fit, trial, thrust, time, title, self._best("saturation_speed")))
        return views

    def trial_figures(self, fit: FitResult, trial: TrialResult) -> dict[str, Figure]:
        """Return the figures of one trial, with its reversals."""
        out, name = super().trial_figures(fit, trial), self.trial_name(fit, trial)
        for count, view in enumerate(self._reversals(fit, trial), start=1):
            out[f"reversal-{name}-{count}"] = figure_of([view])
        return out

    def _best(self, name: str) -> float:
        """Return a value of the best set [SI]; NaN where a fit of another table lacks it."""
        names = [record.name for record in self.fit.parameters]
        return float(self.fit.values[0, names.index(name)]) if name in names else math.nan

    @staticmethod
    def simulated_thrust(fit: FitResult, trial: TrialResult) -> FloatArray:
        """Return the thrust (S, n) of every set on a trial [N]."""
        names = [record.name for record in fit.parameters]
        curve = {name: names.index(name) for name in names if name in MOTOR.group("thrust curve")}
        speed = trial.simulated[:, :, fit.channels.index("speed")]
        sets = ({name: float(row[i]) for name, i in curve.items()} for row in fit.values)
        return np.stack([static_thrust(speed[s], values) for s, values in enumerate(sets)])


def _curve_table(curves: Sequence[Mapping[str, Any]], calibration: float) -> Table:
    """Return torque and thrust of steady levels with their intervals, a row per direction and speed."""
    tops = {row["direction"]: abs(row["speed"]) for row in curves if not row["common"]}
    places = dict.fromkeys((row["direction"], row["speed"]) for row in curves)
    by_place = {(row["quantity"], row["direction"], row["speed"]): row for row in curves}

    def cells(quantity: str, place: tuple[str, float]) -> tuple[str, str]:
        row = by_place.get((quantity, *place))
        return (number(row["value"]), interval(row["interval_95"], (False, False))) if row else (NONE, NONE)

    rows = [
        (
            f"{way}{'' if abs(speed) <= tops[way] else ', extrapolated'}", number(abs(speed)),
            *cells("torque", (way, speed)), *cells("thrust", (way, speed)),
        )
        for way, speed in places
    ]  # fmt: skip
    heads = ("direction", "speed [rad/s]", "torque [N·m]", "95 % interval", "thrust [N]", "95 % interval")
    caption = f"the intervals contain {100 * calibration:g} % for the calibration of the load cells"
    return listed("torque and thrust of the steady levels", rows, heads, caption)


def _signed(share: float) -> str:
    """Return a share in percent with its sign, a minus in print."""
    return f"{100 * share:+.0f}".replace("-", "−")


def _milliseconds(value: float | None) -> str:
    return "—" if value is None or not math.isfinite(value) else f"{1e3 * value:.0f} ms"
