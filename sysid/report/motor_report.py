"""What the report of a motor adds: thrust, reversals, and what each step of the model buys."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

from sysid.fit.result import FitResult, TrialResult
from sysid.motor.model import PARAMETERS as MOTOR
from sysid.motor.model import thrust as static_thrust
from sysid.report.drawing import USES
from sysid.report.fit_report import FitReport, titled
from sysid.report.html import Html, definitions, markup_table, paragraph, picture, side_by_side
from sysid.report.motor_figures import figure_thrust, reversal_commands
from sysid.report.set_tables import ladder_table
from sysid.report.sketches import motor_sketch
from sysid.types import FloatArray

# Reversals that a page draws.
_MOST_REVERSALS = 6


class MotorReport(FitReport):
    """The report of a motor."""

    title = "Motor: what the bench logs say"
    about_signals = (
        "The thrust is not compared in the fit: it follows from the speed and the static curve, and so tells "
        "whether both are right."
    )
    sections = (
        "parameters", "measured_against_simulated", "reversals", "trial_errors", "ladder", "convergence",
        "spread", "profiles", "correlation", "validation", "filter_response", "provenance",
    )  # fmt: skip
    model = "motor"

    def sketch(self) -> Html:
        """Return the circuit and the propeller."""
        return motor_sketch()

    def more_panels(self, fit: FitResult, trial: TrialResult) -> list[Html]:
        """Return the thrust, which the fit does not compare."""
        if trial.thrust is None or not np.isfinite(trial.thrust).any():
            return []
        figure = figure_thrust(trial, self.simulated_thrust(fit, trial))
        words = f"{trial.name}: thrust in newton, measured and simulated, and the command over time"
        return [picture(figure, words, "Thrust (Fig. 4); it is not compared in the fit.")]

    @titled(
        "Reversals",
        "Thrust around commands that turn the motor round, and the time until 90 % of the final thrust.",
    )
    def reversals(self) -> Html:
        """Return thrust after reversal commands, in the manner of Fig. 3, and the delays."""
        commands = [(trial, *each) for trial in self.fit.trials for each in reversal_commands(trial)]
        # Evenly spread, so that fitted trials and held-out trials are among them.
        count = min(len(commands), _MOST_REVERSALS)
        shown = np.unique(np.linspace(0, len(commands) - 1, count).round().astype(int))
        pieces = []
        for trial, time, before, after in (commands[k] for k in shown):
            figure = figure_thrust(trial, self.simulated_thrust(self.fit, trial), command=time)
            what = f"{trial.name} ({USES[trial.use]}): from {_signed(before)} % to {_signed(after)} %"
            words = f"thrust after a reversal command, measured and simulated; {what}"
            pieces.append(picture(figure, words, what))
        out = side_by_side(pieces)
        if len(shown) < len(commands):
            drawn = f"{len(shown)} of {len(commands)} reversals are drawn"
            out += paragraph(f"{drawn}; sysid report --figure FOLDER draws all.", "note")
        rows = [
            (
                f"{row['trial']} ({row['use']}): "
                + " to ".join(f"{_signed(row[f'command_{when}'])} %" for when in ("before", "after")),
                ", ".join(f"{_milliseconds(row[what])} {what}" for what in ("measured", "simulated")),
            )
            for row in self.fit.settings.get("reversal_delays", ())
        ]
        if rows:
            out += definitions(rows, "from the command to 90 % of the final thrust")
        return out if out.text else paragraph("No trial reverses the motor.", "note")

    @titled(
        "Steps of the model",
        "What each part of the model buys on trials that were fitted and on trials that were held back.",
    )
    def ladder(self) -> Html:
        """Return what each step of the model buys."""
        sets = self.fit.parameter_sets()
        if "ladder" not in sets.settings:
            return paragraph("No ladder of simpler models was climbed in this fit.", "note")
        return markup_table(ladder_table(sets))

    def trial_figures(self, fit: FitResult, trial: TrialResult) -> dict[str, Figure]:
        """Return the figures of one trial, with its thrust and reversals."""
        out = super().trial_figures(fit, trial)
        if trial.thrust is not None:
            name, thrust = self.trial_name(fit, trial), self.simulated_thrust(fit, trial)
            out[f"thrust-{name}"] = figure_thrust(trial, thrust, legend=True)
            for number, (time, _, _) in enumerate(reversal_commands(trial), start=1):
                out[f"reversal-{name}-{number}"] = figure_thrust(trial, thrust, command=time, legend=True)
        return out

    @staticmethod
    def simulated_thrust(fit: FitResult, trial: TrialResult) -> FloatArray:
        """Return the thrust (S, n) of every set on a trial [N]."""
        names = [record.name for record in fit.parameters]
        curve = {name: names.index(name) for name in names if name in MOTOR.group("thrust curve")}
        speed = trial.simulated[:, :, fit.channels.index("speed")]
        sets = ({name: float(row[i]) for name, i in curve.items()} for row in fit.values)
        return np.stack([static_thrust(speed[s], values) for s, values in enumerate(sets)])


def _signed(share: float) -> str:
    """Return a share in percent with its sign, a minus in print."""
    return f"{100 * share:+.0f}".replace("-", "−")


def _milliseconds(value: float | None) -> str:
    return "—" if value is None or not math.isfinite(value) else f"{1e3 * value:.0f} ms"
