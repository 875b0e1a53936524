"""The parts of a fit's report, in the order in which a reader needs them; the notebooks call nothing else.

Each method of `FitReport` returns a piece of the page. A part that needs what has not been computed says in
one line which command computes it.
"""

from __future__ import annotations

import html
import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import ExportError
from sysid.fit.result import FitResult, TrialResult
from sysid.fit.store import read_fit
from sysid.fit.summary import record_lines, run_record
from sysid.motor.model import PARAMETERS
from sysid.motor.model import thrust as static_thrust
from sysid.report.animation import animation
from sysid.report.diagrams import figure_geometry, figure_modes, mode_shares
from sysid.report.drop_replay import DropReplay, replay_drop
from sysid.report.fit_figures import (
    figure_channel,
    figure_runs,
    figure_spectrum,
    figure_spread,
    figure_thrust,
    figure_waterfall,
    filter_gain,
    legend_of,
)
from sysid.report.fit_plots import display_of, percent_text
from sysid.report.html import (
    NOTHING,
    Html,
    box,
    bullets,
    definitions,
    folded,
    grid,
    legend,
    markup_table,
    paragraph,
    picture,
)
from sysid.report.motor_figures import figure_reversal, reversal_commands
from sysid.report.snapshots import figure_snapshots
from sysid.report.tables import ladder_table, mean_sigma_table, ranked_table, trial_table
from sysid.report.trust_panels import (
    figure_correlation,
    figure_nrmse_profile,
    figure_profile,
    interval_table,
    read_document,
    read_profiles,
    stop_table,
    validation_table,
    validations,
    verdict_words,
)
from sysid.report.verdict import open_parameters, verdict_sentences
from sysid.types import FloatArray

_MOST_REVERSALS = 6
# Panels of channels beyond which a page holds them as pixels: vectors of 40 take 2 MB.
_MOST_VECTORS = 60


@dataclass(frozen=True, eq=False)
class FitReport:
    """A fit and what belongs to it, ready to be shown.

    Parameters
    ----------
    folder : Path
        Of the fit.
    fit : FitResult
    against : FitResult, optional
        The same sets on trials of another campaign.
    """

    folder: Path
    fit: FitResult
    against: FitResult | None = None
    _replays: dict[tuple[bool, str], DropReplay] = field(default_factory=dict, repr=False)

    @cached_property
    def trust(self) -> dict[str, Any] | None:
        """Intervals and verdicts, None where they have not been computed."""
        return read_document(self.folder, "trust")

    @property
    def trials(self) -> tuple[TrialResult, ...]:
        """All trials: of the fit, then those of another campaign."""
        return (*self.fit.trials, *(self.against.trials if self.against else ()))

    @property
    def fits(self) -> tuple[FitResult, ...]:
        """The fit, and its sets on another campaign."""
        return (self.fit, self.against) if self.against is not None else (self.fit,)

    def verdict(self) -> Html:
        """Return the verdict in one paragraph, and the warnings."""
        warnings = self.warnings()
        sentences = verdict_sentences(
            self.fit, self.against, self.trust, validations(self.folder), len(warnings)
        )
        out = box(paragraph(" ".join(sentences)), "verdict")
        if warnings:
            count = f"{len(warnings)} warning{'s' if len(warnings) > 1 else ''}"
            out += folded(count, bullets(warnings, "warnings"), opened=len(warnings) <= 4)
        return out

    def warnings(self) -> list[str]:
        """Return the sentences to be read before the digits: of the fit, its intervals, other trials."""
        trust = (self.trust or {}).get("warnings") or ()
        against = self.against.warnings if self.against is not None else ()
        return list(dict.fromkeys([*self.fit.warnings, *trust, *against]))

    def parameters(self) -> Html:
        """Return the tables of parameters: sets, the layout of Tables I and II, intervals."""
        sets = self.fit.parameter_sets()
        # Of a search that was not finished it is not known what the data fix.
        opened = () if self.fit.runs and self.fit.agreement.unfinished else open_parameters(self.fit)
        out = markup_table(ranked_table(sets, opened)) + markup_table(mean_sigma_table(sets, unfixed=opened))
        if self.trust is None:
            return out + _missing("profile intervals and verdicts", "sysid trust", self.folder)
        return out + markup_table(interval_table(self.trust))

    def trial_errors(self) -> Html:
        """Return NRMSE per trial and channel."""
        out = NOTHING
        for fit in self.fits:
            if fit.trials:
                out += markup_table(trial_table(fit.parameter_sets()))
        return out

    def measured_against_simulated(self) -> Html:
        """Return every trial's channels, folded but for the first of each use."""
        gear = self.fit.kind == "gear" and bool(self.drops())
        out = legend(legend_of(self.fit, contacts=gear))
        seen = set()
        vector = len(self.trials) * len(self.fit.channels) <= _MOST_VECTORS
        for fit in self.fits:
            for trial in fit.trials:
                shown = [c for c in range(len(fit.channels)) if trial.valid[:, c].any()]
                panels = [self._channel(fit, trial, c, vector) for c in shown]
                if trial.thrust is not None and np.isfinite(trial.thrust).any():
                    panels.append(self._thrust(fit, trial))
                opened = trial.use not in seen
                seen.add(trial.use)
                out += folded(self._title(fit, trial), grid(panels), opened=opened)
        return out

    def reversals(self) -> Html:
        """Return thrust after reversal commands, in the manner of Fig. 3, and the delays; motors only."""
        found = [(trial, *one) for trial in self.fit.trials for one in reversal_commands(trial)]
        # Of many those that lie evenly among them: fitted ones and ones held back.
        shown = np.unique(
            np.linspace(0, len(found) - 1, min(len(found), _MOST_REVERSALS)).round().astype(int)
        )
        pieces = []
        for trial, time, before, after in (found[k] for k in shown):
            figure = figure_reversal(trial, self.simulated_thrust(self.fit, trial), time)
            use = "fitted" if trial.use == "fit" else "not fitted"
            what = f"{trial.name} ({use}): from {signed(before)} % to {signed(after)} %"
            pieces.append(
                picture(figure, f"thrust after a reversal command, measured and simulated; {what}", what)
            )
        out = grid(pieces)
        if len(shown) < len(found):
            out += paragraph(
                f"{len(shown)} of {len(found)} reversals are drawn; sysid report --pdf-figures draws all.",
                "note",
            )
        rows = [
            (
                f"{one['trial']} ({one['use']}): {signed(one['command before'])} % to "
                f"{signed(one['command after'])} %",
                f"{_milliseconds(one['measured [s]'])} measured, "
                f"{_milliseconds(one['simulated [s]'])} simulated",
            )
            for one in self.fit.settings.get("reversal delays", ())
        ]
        if rows:
            out += definitions(rows, "from the command to 90 % of the final thrust")
        return out if out.text else paragraph("No trial reverses the motor.", "note")

    def ladder(self) -> Html:
        """Return what each step of the model buys; motors only."""
        sets = self.fit.parameter_sets()
        if "ladder" not in sets.settings:
            return paragraph("No ladder of simpler models was climbed in this fit.", "note")
        return markup_table(ladder_table(sets))

    def diagram(self) -> Html:
        """Return the labelled diagram of frames, lengths and forces (Fig. 2), from the best set's values."""
        values = self.values()
        slope = max((drop.slope for drop in self.drops()), default=math.radians(15.0))
        figure = figure_geometry(values, slope)
        words = (
            "side view of the drone on a slope: body, two legs, frames N, A, B, C and D, the lengths "
            + ", ".join(f"{s} {1e3 * values[n]:.0f} mm" for s, n in _LENGTHS)
            + " and the forces of weight, thrust, ground and leg joints"
        )
        return picture(
            figure, words, "Frames, lengths and forces (Fig. 2), drawn to scale from the best set."
        )

    def modes(self) -> Html:
        """Return the modes of the high-friction hybrid with the transitions that happen (Fig. 5)."""
        if self.fit.settings.get("surface") != "hf":
            return paragraph("The low-friction law has no modes: both feet slip and creep.", "note")
        words = (
            "four modes: both feet slip, rear sticks, front sticks, both stick; arrows between them with "
            "the conditions of slipping and sticking"
        )
        caption = (
            "Modes of the hybrid (Fig. 5) as the code switches them; percentages: of the time in which a "
            "foot is down, over all drops. In flight both feet count as slipping; that time is left out."
        )
        return picture(figure_modes(mode_shares(self.drops())), words, caption)

    def animation(self) -> Html:
        """Return the drops in motion, slowed down, with forces, ghost and the instants of Fig. 7."""
        drops = self.drops()
        if not drops:
            return paragraph(
                "No animation: the fit does not hold the states in which its drops start; fit again.", "note"
            )
        if self.against is None:
            return animation(drops)
        return animation(drops, [fit.name for fit, _ in self._replayed()])

    def snapshots(self, name: str | None = None) -> Html:
        """Return the instants (1) to (4) of Fig. 7 of one drop, of the steepest one by default."""
        drops = self.drops()
        chosen = [drop for drop in drops if drop.name == name] if name else drops
        chosen = [drop for drop in chosen if len(drop.first_contacts()) == 4] or chosen
        if not chosen:
            return NOTHING
        drop = max(chosen, key=lambda one: one.slope)
        said = [f"({k}) at {1e3 * t:.0f} ms {what}" for k, (t, what) in enumerate(drop.first_contacts(), 1)]
        words = f"simulated snapshots of {drop.name}: {'; '.join(said)}"
        where = f"{drop.name}, {math.degrees(drop.slope):.0f}°"
        caption = f"{where}: {'; '.join(said)}. Normal force blue, friction red "
        caption += "(drawn at the largest force within 8 ms)."
        return picture(figure_snapshots(drop), words, caption)

    def convergence(self) -> Html:
        """Return how the runs went, and where they ended."""
        found = self.fit.agreement
        runs = len(self.fit.runs)
        ended = f"{found.reached} of {runs} share the best optimum"
        caption = "Waterfall: one colour and marker per optimum."
        if found.unfinished:
            ended = "the search was not finished, so no optimum is known"
            caption = "Waterfall: runs that were not finished (open circles) reached no optimum."
        return grid(
            [
                picture(
                    figure_runs(self.fit),
                    f"best NRMSE over the generations of {runs} runs; it ends between "
                    f"{percent_text(float(found.cost.min()))} and {percent_text(float(found.cost.max()))}",
                    "Convergence of the runs.",
                ),
                picture(
                    figure_waterfall(self.fit),
                    f"final NRMSE of {runs} runs over the best one, by rank; {ended}",
                    caption,
                ),
            ]
        ) + paragraph(f"{found.sentence()[:1].upper()}{found.sentence()[1:]}.")

    def spread(self) -> Html:
        """Return where the sets lie between the bounds."""
        return picture(
            figure_spread(self.fit),
            "place of every set between the bounds of the search, a row per free parameter; the best set is "
            "a diamond",
            "Parameters in the unit cube: best set (diamond) and the others between their bounds [SI].",
        )

    def profiles(self) -> Html:
        """Return the likelihood profiles of the parameters."""
        pieces = []
        known = {record.name: record for record in self.fit.parameters}
        for name, profile in (self.fit.settings.get("profiles") or {}).items():
            record = known[name]
            words = f"NRMSE over {name}, all others fitted anew"
            more = f"Dashed: {100 * profile['limit']:g} % above the best NRMSE."
            if not profile["identified"]:
                more += (
                    f" Blue: below {profile['below']:.0e} {record.unit} the data tell no value from another."
                )
            figure = figure_nrmse_profile(record.symbol, record.unit, profile)
            pieces.append(picture(figure, words, f"{words}. {more}"))
        if self.trust is None:
            return grid(pieces) + _missing("profiles of the likelihood", "sysid trust", self.folder)
        curves = read_profiles(self.folder)
        for row in self.trust["parameters"]:
            if row["name"] in curves:
                words = (
                    f"deviance over {row['name']}, all others fitted anew: {verdict_words(row['verdict'])}"
                )
                pieces.append(picture(figure_profile(row, *curves[row["name"]]), words))
        return grid(pieces)

    def correlation(self) -> Html:
        """Return how the estimates go together."""
        if self.trust is None:
            return _missing("correlation of the estimates", "sysid trust", self.folder)
        strong = [
            f"{row['name']} with {one['name']} ({one['correlation']:+.2f})"
            for row in self.trust["parameters"]
            for one in row.get("partners", ())
        ]
        words = "correlation of the estimates" + (f"; strongest: {'; '.join(strong[:6])}" if strong else "")
        return picture(figure_correlation(self.trust), words, "Correlation of the estimates.")

    def validation(self) -> Html:
        """Return how trials that were not fitted are predicted."""
        found = validations(self.folder)
        out = NOTHING
        for name, document in found.items():
            out += markup_table(validation_table(name, document))
            stops = stop_table(name, document)
            if stops is not None:
                out += markup_table(stops)
            out += bullets(list(document.get("reasons") or ()), "warnings")
        if self.against is not None:
            out += markup_table(trial_table(self.against.parameter_sets()))
        if not found:
            held = float(self.fit.mean_nrmse("validate")[0])
            if math.isfinite(held):
                out += paragraph(
                    f"The best set predicts the trials held back with an NRMSE of {percent_text(held)}."
                )
            out += _missing("validation on other trials", "sysid validate", self.folder, " CAMPAIGN")
        return out

    def filter_response(self) -> Html:
        """Return the filter's gain over the spectrum of what was measured."""
        spectra = [(t.name, t.spectrum) for t in self.trials if t.spectrum is not None]
        if not spectra:
            return paragraph("The signals were not filtered, or the fit does not hold their spectra.", "note")
        gain = filter_gain(
            self.fit.provenance.get("filter", {}), max(float(s.frequency[-1]) for _, s in spectra)
        )
        kind = str(self.fit.provenance.get("filter", {}).get("kind", "none"))
        pieces = []
        for c in range(len(self.fit.channels)):
            name = self.fit.channels[c]
            words = f"amplitude spectrum of {name} before the filter, and the gain of the filter ({kind})"
            pieces.append(picture(figure_spectrum(self.fit, spectra, c, gain), words))
        return grid(pieces)

    def provenance(self) -> Html:
        """Return what a reader needs to repeat the fit, or to doubt it."""
        record = run_record(self.fit)
        brief = definitions(
            [
                (
                    "sysid",
                    f"{record.get('sysid')}, revision {(record.get('git_revision') or 'unknown')[:12]}",
                ),
                ("written", str(record.get("written"))),
                ("campaign", f"{record.get('campaign', {}).get('file')}"),
                ("search", f"{_search_words(record.get('search', {}))}, {len(self.fit.runs)} runs"),
                ("NRMSE", f"rms error over {record.get('nrmse_denominator')} of the measurement"),
                (
                    "candidates",
                    f"{record['totals']['candidates']}, {record['totals']['failed']} failed",
                ),
                ("computed in", f"{record['totals']['wall_time']:.0f} s of runs"),
            ],
            "where it comes from",
        )
        lines = "\n".join(record_lines(record))
        return brief + folded("the whole record", Html(f'<pre tabindex="0">{html.escape(lines)}</pre>'))

    def _channel(self, fit: FitResult, trial: TrialResult, c: int, vector: bool) -> Html:
        drop = self.replay(fit, trial)
        figure = figure_channel(fit, trial, c, contacts=drop.contacts if drop else ())
        name, unit, _ = display_of(fit, c)
        own = percent_text(float(trial.nrmse[0, c])) if len(trial.nrmse) else "unknown"
        down = f"; {len(drop.contacts)} contacts of the feet" if drop else ""
        words = (
            f"{trial.name}, {name.strip('$')} in {unit}: measured and simulated over time, NRMSE {own}{down}"
        )
        return picture(figure, words, vector=vector)

    def _thrust(self, fit: FitResult, trial: TrialResult) -> Html:
        figure = figure_thrust(trial, self.simulated_thrust(fit, trial))
        words = f"{trial.name}: thrust in newton, measured and simulated, and the command over time"
        return picture(figure, words, "Thrust (Fig. 4); it is not compared in the fit.")

    @staticmethod
    def simulated_thrust(fit: FitResult, trial: TrialResult) -> FloatArray:
        """Return the thrust (S, n) of every set of a motor on a trial [N]."""
        names = [record.name for record in fit.parameters]
        c = fit.channels.index("speed")
        keep = [name for name in names if name in PARAMETERS.group("thrust curve")]
        return np.stack(
            [
                static_thrust(
                    trial.simulated[s, :, c], {name: float(fit.values[s, names.index(name)]) for name in keep}
                )
                for s in range(len(fit.values))
            ]
        )

    def _title(self, fit: FitResult, trial: TrialResult) -> str:
        use = "fitted" if trial.use == "fit" else "not fitted"
        weights = np.asarray(fit.channel_weights)
        mean = float(trial.nrmse[0] @ (weights / weights.sum())) if len(trial.nrmse) else float("nan")
        log = fit.provenance.get("logs", {}).get(trial.name, {})
        slope = f", {log['slope [deg]']:.0f}°" if "slope [deg]" in log else ""
        speed = f", {log['impact speed [m/s]']:.2f} m/s" if "impact speed [m/s]" in log else ""
        name = f"{fit.name}, {trial.name}" if fit is self.against else trial.name
        return f"{name} ({use}{slope}{speed}): NRMSE {percent_text(mean)}"

    def drops(self) -> list[DropReplay]:
        """Return the replays of all drops that can be repeated, with the best set."""
        return [drop for _, drop in self._replayed()]

    def _replayed(self) -> list[tuple[FitResult, DropReplay]]:
        found = ((fit, self.replay(fit, trial)) for fit in self.fits for trial in fit.trials)
        return [(fit, drop) for fit, drop in found if drop is not None]

    def replay(self, fit: FitResult, trial: TrialResult) -> DropReplay | None:
        """Return the replay of a drop with the best set; None where it cannot be repeated."""
        # Two campaigns may bear one name, and so may their drops.
        key = (fit is self.against, trial.name)
        if key not in self._replays:
            try:
                self._replays[key] = replay_drop(fit, trial)
            except ExportError:
                return None
        return self._replays[key]

    def values(self) -> dict[str, float]:
        """Return the best set by name [SI]."""
        names = (record.name for record in self.fit.parameters)
        return dict(zip(names, map(float, self.fit.values[0]), strict=True))


_LENGTHS = (
    ("dx_j", "joint_dx"), ("dz_j", "joint_dz"), ("dx_f", "foot_dx"), ("dz_f", "foot_dz"),
    ("dx_m", "thrust_point_dx"),
)  # fmt: skip


def open_fit(fit: str | Path, against: str | Path | None = None) -> FitReport:
    """Read a fit for its report.

    Parameters
    ----------
    fit : str or Path
        Fit folder.
    against : str or Path, optional
        Folder with the same sets on trials of another campaign, as `sysid report --against` prepares it.

    Raises
    ------
    FitError
        When there is no fit.
    """
    return FitReport(Path(fit), read_fit(fit), read_fit(against) if against else None)


def _missing(what: str, command: str, folder: Path, more: str = "") -> Html:
    return paragraph(f"{what[:1].upper()}{what[1:]}: not computed; run {command} {folder}{more}", "note")


def _search_words(search: dict[str, Any]) -> str:
    algorithm, finish = str(search.get("algorithm")), str(search.get("finish") or "none")
    return algorithm if finish in ("none", algorithm) else f"{algorithm}, then {finish}"


def signed(share: float) -> str:
    """Return a share in percent with its sign, a minus in print."""
    return f"{100 * share:+.0f}".replace("-", "−")


def _milliseconds(value: float | None) -> str:
    return "—" if value is None or not math.isfinite(value) else f"{1e3 * value:.0f} ms"
