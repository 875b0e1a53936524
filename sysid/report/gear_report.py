"""What the report of a landing gear adds: geometry, drops in motion, contacts of the feet, friction."""

import math
from contextlib import suppress
from functools import cached_property

from matplotlib.figure import Figure

from sysid.errors import ExportError
from sysid.fit.result import FitResult, TrialResult
from sysid.gear.surfaces import SURFACES, Surface
from sysid.report.diagrams import figure_geometry, figure_modes, gear_sketch, mode_shares
from sysid.report.drop_replay import FEET, DropReplay, animation, replay_drop, steepest
from sysid.report.fit_figures import Bars
from sysid.report.fit_report import FitReport, titled
from sysid.report.html import NOTHING, Html, paragraph, picture
from sysid.report.snapshots import figure_snapshots

_LENGTHS = (
    ("dx_j", "joint_dx"), ("dz_j", "joint_dz"), ("dx_f", "foot_dx"), ("dz_f", "foot_dz"),
    ("dx_m", "thrust_point_dx"),
)  # fmt: skip
# Slope of the diagram where no drop can be repeated [deg].
_SLOPE = 15.0


class GearReport(FitReport):
    """The report of a landing gear."""

    title = "Landing gear: what the drops say"
    noun = "drop"
    about_signals = (
        "Simulated signals have passed through the same filter as the measured ones. Bars at the bottom: the "
        "rear and the front foot of the best set's simulation are on the ground."
    )
    sections = (
        ("parameters",), ("measured_against_simulated", "animation"), ("trial_errors", "convergence"),
        ("spread", "correlation"), ("profiles",), ("ladder",), ("validation", "diagram"),
        ("filter_response",), ("modes", "provenance"),
    )  # fmt: skip

    @property
    def model(self) -> str:
        """Landing gear and friction law."""
        # A law that this installation does not have keeps its name.
        title = (self._law.title if self._law else "") or str(self.fit.settings.get("surface", ""))
        return f"landing gear with the {title} law" if title else "landing gear"

    @property
    def _law(self) -> Surface | None:
        return SURFACES.get(str(self.fit.settings.get("surface", "")))

    def bars(self, fit: FitResult, trial: TrialResult) -> Bars:
        """Return when each foot of the best set's simulation is on the ground."""
        drop = self.replay(fit, trial)
        contacts = drop.contacts if drop else ()
        return {
            f"{name} foot down": [(each.start, each.end) for each in contacts if each.foot == foot]
            for foot, name in enumerate(FEET if contacts else ())
        }

    def conditions(self, fit: FitResult, trial: TrialResult) -> str:
        """Return slope and speed of impact."""
        log = fit.provenance.get("logs", {}).get(trial.name, {})
        slope = f", {log['slope_deg']:.0f}°" if "slope_deg" in log else ""
        return slope + (f", {log['impact_speed']:.2f} m/s" if "impact_speed" in log else "")

    def film(self, name: str | None) -> DropReplay:
        """Return the replay of a drop by name, of the steepest one by default."""
        logs = self.fit.provenance.get("logs", {})
        known = [trial for trial in self.fit.trials if name in (None, trial.name)]
        if not known:
            names = ", ".join(trial.name for trial in self.fit.trials)
            raise ExportError(f"{self.fit.name}: no drop {name!r}; found {names}")
        steepest = max(known, key=lambda trial: logs.get(trial.name, {}).get("slope_deg", 0.0))
        return replay_drop(self.fit, steepest)

    @titled(
        "Geometry",
        "The lengths that the model needs and the forces that it knows. Measure the masses, the moment of "
        "inertia and where the feet are; the joints come from the fit. Each leg represents the pair of legs"
        " at its end.",
    )
    def diagram(self) -> Html:
        """Return the labelled diagram of frames, lengths and forces (Fig. 2), from the best set's values."""
        values = self.fit.parameter_sets().set_values()
        words = (
            "side view of the drone on a slope: body, two legs, frames N, A, B, C and D, the lengths "
            + ", ".join(f"{symbol} {1e3 * values[name]:.0f} mm" for symbol, name in _LENGTHS)
            + " and the forces of weight, thrust, ground and leg joints"
        )
        caption = "Frames, lengths and forces (Fig. 2), drawn to scale from the best set."
        return picture(figure_geometry(values, self._steepest), words, caption)

    @titled(
        "Animation",
        "One drop at a time, slowed down. The numbered buttons go to the instants of the paper's Fig. 7.",
    )
    def animation(self) -> Html:
        """Return the drops in motion, with forces and ghost, and the instants of Fig. 7."""
        if not self.replays:
            return paragraph(
                "No animation: the fit lacks the states in which its drops start; fit again.", "note"
            )
        scenes = {}
        for fit, trial in self._each():
            if drop := self.replay(fit, trial):
                replays = {fit.name: drop}
                beside = self.beside if fit is self.fit else None
                if isinstance(beside, GearReport) and (False, trial.name) in beside.replays:
                    name = beside.fit.name
                    name += " (second)" if name == fit.name else ""
                    replays[name] = beside.replays[False, trial.name]
                scenes[self.key(fit, trial)] = replays
        return animation(scenes, self.snapshots())

    def _first(self) -> int:
        drops = self.drops()
        if not drops:
            return 0
        key = list(self.replays)[steepest(drops)]
        return [(fit is self.against, trial.name) for fit, trial in self._each()].index(key)

    def sketch(self) -> Html:
        """Return the drone on its steepest slope."""
        return gear_sketch(self.fit.parameter_sets().set_values(), self._steepest)

    def snapshots(self) -> Html:
        """Return the instants (1) to (4) of Fig. 7 of the steepest drop."""
        drops = [drop for drop in self.drops() if len(drop.first_contacts()) == 4] or self.drops()
        if not drops:
            return NOTHING
        drop = max(drops, key=lambda drop: drop.slope)
        instants = "; ".join(
            f"({k}) at {1e3 * time:.0f} ms {what}" for k, (time, what) in enumerate(drop.first_contacts(), 1)
        )
        caption = (
            f"{drop.name}, {math.degrees(drop.slope):.0f}°: {instants}. Normal force blue, friction red "
            "(drawn at the largest force within 8 ms)."
        )
        return picture(figure_snapshots(drop), f"simulated snapshots of {drop.name}: {instants}", caption)

    @titled("Friction")
    def modes(self) -> Html:
        """Return the modes of the high-friction hybrid with the transitions that happen (Fig. 5)."""
        if self._law is None or not self._law.switching:
            return paragraph("The low-friction law has no modes: both feet slip and creep.", "note")
        words = (
            "four modes: both feet slip, rear sticks, front sticks, both stick; arrows between them with "
            "the conditions of slipping and sticking"
        )
        caption = (
            "On high friction each foot slips or sticks by itself; the simulation switches where one of the "
            "conditions comes true. Modes of the hybrid (Fig. 5) as the code switches them; percentages: of "
            "the time in which a foot is down, over all drops. In flight both feet count as slipping; that "
            "time is left out."
        )
        return picture(figure_modes(mode_shares(self.drops())), words, caption)

    def figures(self) -> dict[str, Figure]:
        """Return the figures for a paper, with the diagrams of the model."""
        values = self.fit.parameter_sets().set_values()
        out = super().figures() | {"geometry": figure_geometry(values, self._steepest)}
        if self._law is not None and self._law.switching:
            out["modes"] = figure_modes(mode_shares(self.drops()))
        return out

    def trial_figures(self, fit: FitResult, trial: TrialResult) -> dict[str, Figure]:
        """Return the figures of one drop, with its snapshots."""
        out, drop = super().trial_figures(fit, trial), self.replay(fit, trial)
        if drop is not None:
            out[f"snapshots-{self.trial_name(fit, trial)}"] = figure_snapshots(drop, legend=True)
        return out

    @cached_property
    def replays(self) -> dict[tuple[bool, str], DropReplay]:
        """Replays of the drops that can be repeated, with the best set; a key tells both campaigns apart."""
        out = {}
        for fit, trial in self._each():
            with suppress(ExportError):
                out[fit is self.against, trial.name] = replay_drop(fit, trial)
        return out

    def drops(self) -> list[DropReplay]:
        """Return the replays of all drops that can be repeated."""
        return list(self.replays.values())

    def replay(self, fit: FitResult, trial: TrialResult) -> DropReplay | None:
        """Return the replay of a drop with the best set; None where it cannot be repeated."""
        return self.replays.get((fit is self.against, trial.name))

    @property
    def _steepest(self) -> float:
        return max((drop.slope for drop in self.drops()), default=math.radians(_SLOPE))
