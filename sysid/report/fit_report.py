"""The report of a fit: a verdict, then sections in the order in which a reader needs them.

`FitReport` needs nothing of a model but its fit and the documents of trust, so it serves every kind. A kind
adds sections, panels and figures in a subclass that `sysid.workflows.kinds` finds. Each method returns a
piece of the page, in a notebook as well; a piece that needs what has not been computed names the command.
"""

from __future__ import annotations

import html
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeVar

import numpy as np
from matplotlib.figure import Figure

from sysid.errors import ExportError, shell
from sysid.fit.adequacy import NOT_BY, Bias
from sysid.fit.optima import unfixed
from sysid.fit.result import FitResult, TrialResult
from sysid.fit.summary import record_lines, run_record
from sysid.parameter_sets import KNOWN_ANYHOW
from sysid.parameters import in_words
from sysid.report.answer import (
    IN_A_WORD,
    NOT_JUDGED,
    OF_USE,
    Reopened,
    answer_box,
    counts,
    grouped_warnings,
    next_step,
    over_noise,
    parameter_table,
    predicted_over_noise,
    use_tile,
)
from sysid.report.drawing import USES, percent_text
from sysid.report.explain import conclusion, figure_rungs, moves_table, rungs_table
from sysid.report.fit_figures import (
    Bars,
    figure_convergence,
    figure_correlation,
    figure_measured_against_simulated,
    figure_profile,
    figure_spread,
    figure_waterfall,
    spectrum_figures,
    trial_view,
)
from sysid.report.html import (
    NOTHING,
    Html,
    bullets,
    columns,
    definitions,
    heading,
    joined,
    markup_table,
    page,
    paragraph,
    picture,
    preformatted,
    side_by_side,
    unfoldable,
)
from sysid.report.plots import Panel, View, figure_of, interactive
from sysid.report.set_tables import adequacy_table, mean_sigma_table, ranked_table, trial_table
from sysid.report.table import Cell
from sysid.report.trust_tables import narrow_table, stated_table, use_tables, validation_table
from sysid.trust import documents
from sysid.trust.documents import (
    CrossValidationDocument,
    ExplainDocument,
    FreeParameter,
    TrustDocument,
    ValidationDocument,
)
from sysid.types import FloatArray

if TYPE_CHECKING:
    from sysid.report.drop_replay import DropReplay

# Sections without a link above the page.
_UNLINKED = {
    "animation", "convergence", "correlation", "filter_response", "ladder", "modes", "profiles", "spikes",
    "spread", "supply_law",
}  # fmt: skip
# A section that has nothing to show but the reason.
_ONLY_A_NOTE = re.compile(r'<h2[^>]*>[^<]*</h2>(?:<p>[^<]*</p>)?<p class="note">([^<]*)</p>')
Content = TypeVar("Content", bound=Callable[..., Html])
_COUNTS = (
    "no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve",
)  # fmt: skip


def titled(title: str, text: str = "") -> Callable[[Content], Content]:
    """Give a method of a report, which returns the content of a section, the heading and text above it."""

    def title_of(method: Content) -> Content:
        vars(method).update(title=title, text=text)
        return method

    return title_of


@dataclass(frozen=True, eq=False)
class FitReport:
    """A fit and its folder, ready to be shown.

    `against` are perhaps the same sets on trials of another campaign, `known` is what the fit's own campaign
    tells, and `beside` is the report of a second fit whose simulations are drawn beside the first one's.
    """

    folder: Path
    fit: FitResult
    against: FitResult | None = None
    known: Reopened = field(default_factory=Reopened)
    beside: FitReport | None = None

    title: ClassVar[str] = "What the trials say"
    noun: ClassVar[str] = "trial"
    # Sentence on further content of the figures of measured and simulated signals.
    about_signals: ClassVar[str] = ""
    # Methods in the order of the page; two of them side by side in a wide window.
    sections: ClassVar[tuple[tuple[str, ...], ...]] = (
        ("parameters",), ("measured_against_simulated",), ("trial_errors", "convergence"),
        ("spread", "correlation"), ("profiles",), ("ladder",), ("filter_response",),
        ("validation", "provenance"),
    )  # fmt: skip

    # Members that a kind may replace.

    @property
    def model(self) -> str:
        """What was fitted, for the verdict."""
        return f"{self.fit.kind} model"

    def bars(self, fit: FitResult, trial: TrialResult) -> Bars:
        """Return intervals to mark below a trial's signals."""
        return {}

    def more_panels(self, fit: FitResult, trial: TrialResult) -> list[Panel]:
        """Return panels over the trial's time (n,) that follow its compared channels."""
        return []

    def conditions(self, fit: FitResult, trial: TrialResult) -> str:
        """Return under which conditions a trial was recorded, for its title."""
        return ""

    def film(self, name: str | None) -> DropReplay:
        """Return the motion that a film shows; raise an ExportError where there is none."""
        raise ExportError(f"{self.fit.name}: a {self.fit.kind} makes no drops; films show landing gears")

    def sketch(self) -> Html:
        """Return the model drawn small; nothing where there is no picture of it."""
        return NOTHING

    # The page.

    def page(self) -> str:
        """Return the report as one page of HTML."""
        out, more = self.answer(), []
        for row in self.sections:
            pieces = []
            for name in row:
                section = self._section(name)
                empty = _ONLY_A_NOTE.fullmatch(section.text)
                more += [f"{getattr(self, name).title}: {html.unescape(empty[1])}"] if empty else []
                pieces += [] if empty else [section]
            out += columns(*pieces) if len(pieces) == 2 else joined(pieces)
        if more:
            out += paragraph(f"More. {' '.join(more)}", "note")
        return page(f"sysid: {self.fit.name}", out)

    @classmethod
    def section_titles(cls) -> dict[str, str]:
        """Return the headings in their order, each with the name of its method."""
        return {getattr(cls, name).title: name for row in cls.sections for name in row}

    def section(self, title: str) -> Html:
        """Return a section by its title: heading, text and content."""
        return self._section(self.section_titles()[title])

    def _section(self, name: str) -> Html:
        content = getattr(self, name)
        above = heading(content.title, linked=name not in _UNLINKED)
        return above + (paragraph(content.text) if content.text else NOTHING) + content()

    # The content of the fit and its folder.

    @cached_property
    def trust(self) -> TrustDocument | None:
        """Intervals and verdicts; None where they have not been computed for this fit."""
        return TrustDocument.read(self.folder)

    @cached_property
    def climbed(self) -> ExplainDocument | None:
        """What terms on trial buy; None where `sysid explain` has not been run for this fit."""
        return ExplainDocument.read(self.folder)

    @cached_property
    def validations(self) -> dict[str, ValidationDocument | CrossValidationDocument]:
        """Validations and the cross-validation of this fit, by name."""
        out: dict[str, ValidationDocument | CrossValidationDocument] = {}
        if cross := CrossValidationDocument.read(self.folder):
            out["leave-one-trial-out"] = cross
        for part in documents.parts(self.folder):
            if not part.startswith(documents.VALIDATION):
                continue
            if document := ValidationDocument.read(self.folder, part):
                out[part.removeprefix(documents.VALIDATION)] = document
        return out

    @cached_property
    def likelihood_profiles(self) -> list[tuple[FreeParameter, FloatArray, FloatArray]]:
        """Every profile: row of the document of trust, values (n,) [SI], deviance (n,) [1]."""
        if self.trust is None:
            return []
        arrays = documents.read_arrays(self.folder, documents.TRUST)
        paths = ((row, f"profiles/{row.name}") for row in self.trust.parameters)
        return [
            (row, arrays[f"{path}/value"], arrays[f"{path}/deviance"])
            for row, path in paths
            if f"{path}/value" in arrays
        ]

    @property
    def fits(self) -> tuple[FitResult, ...]:
        """The fit, and its sets on another campaign."""
        return (self.fit, self.against) if self.against is not None else (self.fit,)

    # The sections' contents.

    def answer(self) -> Html:
        """Return what a reader wants first: one word, three figures, the next step; warnings by finding."""
        predicted = predicted_over_noise(
            self.validations, self.known.held_out, shell("sysid", "validate", self.folder)
        )
        use = documents.use_of(self.folder) or self.known.use
        tiles = (
            over_noise(self.fit),
            predicted,
            *use_tile(use),
            counts(self.fit.judged.values() if self.trust else None, shell("sysid", "trust", self.folder)),
        )
        found = [IN_A_WORD.get(self.fit.provenance.get("adequacy", {}).get("verdict"), NOT_JUDGED)]
        found += [OF_USE[use.word]] if use is not None and use.word else []
        flagged = [name for name, document in self.validations.items() if document.flagged]
        found += [Cell(f"validation flagged: {', '.join(flagged)}", "bad")] if flagged else []
        known = predicted[0] != "not known"
        following = next_step(self.fit, self.trust, known, str(self.folder), self.noun, use)
        return answer_box(self.title, found, self.fit.name, tiles, following, self.sketch()) + self.verdict()

    def verdict(self) -> Html:
        """Return the verdict in sentences, and the warnings by what was found."""
        out = unfoldable("The verdict in sentences", paragraph(" ".join(self.sentences())))
        trust = self.trust.warnings if self.trust else ()
        against = self.against.warnings if self.against is not None else ()
        if warnings := list(dict.fromkeys([*self.fit.warnings, *trust, *against])):
            findings = [each for fit in self.fits for each in fit.provenance.get("findings", ())]
            count = f"{len(warnings)} warning{'s' if len(warnings) > 1 else ''}"
            out += unfoldable(count, grouped_warnings(warnings, findings))
        return columns(out, NOTHING)

    def sentences(self) -> list[str]:
        """Return the verdict: how well the sets fit and predict, and what the data determine."""
        fit, trials = self.fit, sum(trial.use == "fit" for trial in self.fit.trials)
        low, high = percent_text(float(fit.nrmse.min())), percent_text(float(fit.nrmse.max()))
        judged, out = fit.provenance.get("adequacy"), []
        noise = f", where noise alone costs {percent_text(judged['floor'])}" if judged else ""
        # The first sentence is one that a person can act on.
        if judged and judged["verdict"] == NOT_BY and (anyhow := fit.settings.get(KNOWN_ANYHOW)):
            out.append(f"Without any model the trials give {anyhow}: use those.")
        if judged and (sentence := judged["sentence"]):
            out.append(f"{sentence[:1].upper()}{sentence[1:]}.")
        out.append(
            f"{fit.name}, {self.model}: the {_counted(len(fit.nrmse), 'set')} "
            f"fit{'s' if len(fit.nrmse) == 1 else ''} {_counted(trials, self.noun)} with an NRMSE of "
            f"{low if low == high else f'{low} to {high}'}{noise} "
            f"(rms error over {fit.provenance.get('nrmse_denominator', 'std')} of the measurement)."
        )
        out += [*self._predicted(), *self._determined()]
        agreement, total = fit.agreement, len(fit.runs)
        # A run that was cut ends in no optimum, so none is the best one.
        if agreement.unfinished:
            out.append(f"{agreement.sentence()}.")
        elif total == 1:
            out.append("A single run cannot say whether its optimum is the best one.")
        else:
            out.append(f"{agreement.reached} of {total} independent runs ended in the best optimum.")
        if fit.state != "done":
            out.append("It was stopped early: these are the sets that it had until then.")
        return out

    def _predicted(self) -> list[str]:
        out = []
        for fit in self.fits:
            if trials := sum(trial.use == "validate" for trial in fit.trials):
                mean = percent_text(float(fit.mean_nrmse("validate")[0]))
                where = "" if fit is self.fit else f" of {fit.name}"
                out.append(f"It predicts {_counted(trials, 'trial')}{where} that it never saw with {mean}.")
        for name, document in self.validations.items():
            verdict = "is doubtful" if document.flagged else "shows no doubt"
            mean = percent_text(document.nrmse)
            out.append(f"The validation on {name} {verdict} ({mean}).")
        return out or ["No trial was kept out of the fit (use = 'validate'), so none tests its prediction."]

    def _determined(self) -> list[str]:
        fit, out = self.fit, []
        if fit.agreement.unfinished:
            out.append("The search was not finished: nothing is known about what the data identify.")
            if self.trust is None:
                return out
        named = {record.name: in_words(record) for record in fit.parameters}
        if self.trust is not None:
            groups: dict[str, list[str]] = {}
            for row in self.trust.parameters:
                groups.setdefault(row.words, []).append(named[row.name])
            parts = [f"{verdict}: {', '.join(names)}" for verdict, names in groups.items()]
            where = "around the unfinished best set" if out else "by profile"
            return [*out, f"What the data identify, {where}: {'; '.join(parts)}."]
        opened = [named[name] for name in self.open_parameters]
        closed = [named[r.name] for r in fit.parameters if r.status == "free" and named[r.name] not in opened]
        if closed and fit.provenance.get("adequacy", {}).get("verdict") != NOT_BY:
            out.append(f"The data identify {', '.join(closed)}.")
        if opened:
            out.append(f"They do not identify {', '.join(opened)}: digits of that mean nothing.")
        flagged = sorted({fit.parameters[i].name for i in np.flatnonzero((fit.at_bound != 0).any(axis=0))})
        if flagged:
            out.append(f"Sets end at a bound in {', '.join(named[name] for name in flagged)}.")
        out.append("Intervals have not been computed: this judges by the spread of the search alone.")
        return out

    @cached_property
    def open_parameters(self) -> tuple[str, ...]:
        """Free parameters that the data do not determine: by the candidates, or by a profile.

        See `sysid.fit.optima.unfixed`, a lower bound on what is open. An unfinished search knows of none.
        """
        fit = self.fit
        if fit.agreement.unfinished:
            return ()
        flags = unfixed(fit.runs, fit.searched) if fit.searched else ()
        wide = {record.name for record, flag in zip(fit.searched, flags, strict=True) if flag}
        free = [(name, row) for name, row in fit.known.items() if row.record.status == "free"]
        return tuple(name for name, row in free if name in wide or row.instead)

    @titled("Parameters")
    def parameters(self) -> Html:
        """Return the table of parameters, and folded the five sets and the layout of Tables I and II."""
        sets, opened = self.fit.parameter_sets(), self.open_parameters
        out = markup_table(parameter_table(self.fit, self.trust, self.known.truth))
        if self.trust is None:
            out += self.missing("intervals and verdicts", "sysid trust")
        else:
            if (stated := stated_table(self.trust)) is not None:
                out += unfoldable("Stated values, and what the fit made of them", markup_table(stated))
            out += unfoldable("Narrower intervals", markup_table(narrow_table(self.trust)), printed=False)
        tables = markup_table(mean_sigma_table(sets, unfixed=opened))
        out += unfoldable("Mean and spread of the runs (Tables I and II)", tables, printed=False)
        return out + unfoldable("The sets", markup_table(ranked_table(sets, opened)), printed=False)

    @titled("Errors", "rms error over the spread of the measurement, by channel.")
    def trial_errors(self) -> Html:
        """Return NRMSE per trial and channel."""
        judged = [adequacy_table(f.parameter_sets()) for f in self.fits if "adequacy" in f.provenance]
        scored = [trial_table(f.parameter_sets()) for f in self.fits if f.trials]
        return joined([markup_table(each) for each in (*scored, *judged)])

    @titled("Measured and simulated")
    def measured_against_simulated(self) -> Html:
        """Return every trial's channels: to be touched, and as figures for paper."""
        views = [self.view(fit, trial) for fit, trial in self._each()]
        if not views:
            return paragraph("No trials are in this fit.", "note")
        out = interactive(views, "measured and simulated", noun=self.noun, chosen=self._first())
        about = paragraph(self.about_signals, "note") if self.about_signals else NOTHING
        judged = self.fit.provenance.get("adequacy", {})
        biases = map(Bias.model_validate, judged.get("biases", ()))
        unexplained = [bias.sentence for bias in biases if not bias.assumed_explains]
        return out + about + bullets(unexplained, "warnings")

    def view(self, fit: FitResult, trial: TrialResult) -> View:
        """Return a trial's channels with what the kind adds, to be touched or as a figure."""
        mean = percent_text(float(fit.over_channels(trial.nrmse)[0]))
        name = f"{fit.name}, {trial.name}" if fit is self.against else trial.name
        title = f"{name} ({USES[trial.use]}{self.conditions(fit, trial)}): NRMSE {mean}"
        other = self.beside.fit if self.beside is not None and fit is self.fit else None
        known = self.known if fit is self.fit else Reopened()
        view = trial_view(fit, trial, (self.key(fit, trial), title), self.bars(fit, trial), known, other)
        return replace(view, panels=[*view.panels, *self.more_panels(fit, trial)])

    def _each(self) -> list[tuple[FitResult, TrialResult]]:
        return [(fit, trial) for fit in self.fits for trial in fit.trials]

    def key(self, fit: FitResult, trial: TrialResult) -> str:
        """Return what ties the traces of a trial to its animation."""
        return f"{'against ' if fit is self.against else ''}{fit.name}: {trial.name}"

    def _first(self) -> int:
        """Return which trial a page shows first."""
        return 0

    @titled(
        "Convergence",
        "Every run starts from its own random seed. Runs that end in the same optimum are a good sign, not a "
        "proof.",
    )
    def convergence(self) -> Html:
        """Return how the runs went, and where they ended."""
        agreement = self.fit.agreement
        runs = len(self.fit.runs)
        ended = f"{agreement.reached} of {runs} share the best optimum"
        caption = "Waterfall: one colour and marker per optimum."
        if agreement.unfinished:
            ended = "the search was not finished, so no optimum is known"
            caption = "Waterfall: runs that were not finished (open circles) reached no optimum."
        least, most = (percent_text(float(end(agreement.cost))) for end in (np.min, np.max))
        words = f"best NRMSE over the generations of {runs} runs; it ends between {least} and {most}"
        curves = picture(figure_convergence(self.fit), words, "Convergence of the runs.")
        words = f"final NRMSE of {runs} runs over the best one, by rank; {ended}"
        sentence = agreement.sentence()
        # Runs that agree are one point.
        apart = [] if agreement.agrees else [picture(figure_waterfall(self.fit), words, caption)]
        return side_by_side([curves, *apart]) + paragraph(f"{sentence[:1].upper()}{sentence[1:]}.")

    @titled("Spread")
    def spread(self) -> Html:
        """Return where the sets lie between the bounds."""
        if self.fit.agreement.agrees:
            return paragraph("no two runs ended apart.", "note")
        return picture(
            figure_spread(self.fit),
            "place of every set between the bounds of the search, a row per free parameter; the best set is "
            "a diamond",
            "Parameters in the unit cube: best set (diamond) and the others between their bounds [SI].",
        )

    @titled(
        "Profiles",
        "One parameter is kept at each value of the axis while all others are fitted again. Where the curve"
        " stays low, the data fit these values alike.",
    )
    def profiles(self) -> Html:
        """Return the profiles of the likelihood."""
        if self.trust is None:
            return self.missing("profiles of the likelihood", "sysid trust")
        pieces = []
        for row, *curve in self.likelihood_profiles:
            words = f"deviance over {row.name}, all others fitted again: {row.words}"
            pieces.append(picture(figure_profile(row, *curve), words))
        return side_by_side(pieces)

    @titled(
        "Correlation", "Of two strongly correlated parameters these trials show one combination, not each."
    )
    def correlation(self) -> Html:
        """Return how the estimates go together."""
        if self.trust is None:
            return self.missing("correlation of the estimates", "sysid trust")
        strong = [
            f"{row.name} with {partner.name} ({partner.correlation:+.2f})"
            for row in self.trust.parameters
            for partner in row.partners
        ]
        words = "correlation of the estimates" + (f"; strongest: {'; '.join(strong[:6])}" if strong else "")
        return picture(figure_correlation(self.trust), words, "Correlation of the estimates.")

    @titled("Validation", "The same sets on trials that the search never saw.")
    def validation(self) -> Html:
        """Return how trials that were not fitted are predicted."""
        out = NOTHING
        for name, document in self.validations.items():
            out += markup_table(validation_table(name, document))
            out += bullets(document.reasons, "warnings")
            if document.use is not None and document.use.sentence:
                out += paragraph(f"{document.use.sentence[:1].upper()}{document.use.sentence[1:]}.")
            if tables := use_tables(document):
                single, total = tables
                out += markup_table(total) + unfoldable("Number by number", markup_table(single))
        if self.against is not None:
            out += markup_table(trial_table(self.against.parameter_sets()))
        if not self.validations:
            nrmse = float(self.fit.mean_nrmse("validate")[0])
            if math.isfinite(nrmse):
                mean = percent_text(nrmse)
                out += paragraph(f"The best set predicts the trials held back with an NRMSE of {mean}.")
            out += self.missing("validation on other trials", "sysid validate", " CAMPAIGN")
        return out

    @titled(
        "What the model lacks",
        "Further physics, and simpler models, judged on what the fit was made without.",
    )
    def ladder(self) -> Html:
        """Return what each term on trial buys."""
        if self.climbed is not None:
            what = "misfit over noise of every model on what was left out, and NRMSE of what was fitted"
            drawn = picture(figure_rungs(self.climbed), what, "What each term buys.")
            moves = markup_table(moves_table(self.climbed, self.trust)) if self.climbed.together else NOTHING
            found = bullets(conclusion(self.climbed)) + markup_table(rungs_table(self.climbed))
            return found + moves + drawn
        return self.missing("further physics", "sysid explain")

    @titled(
        "Filter",
        "What was measured, over frequency, and what the filter leaves of it. Signal that the filter takes "
        "away is not compared.",
    )
    def filter_response(self) -> Html:
        """Return the filter's gain over the spectrum of what was measured."""
        kind = str(self.fit.provenance.get("filter", {}).get("kind", "none"))
        pieces = []
        trials = [trial for _, trial in self._each()]
        for name, figure in spectrum_figures(self.fit, trials).items():
            words = f"amplitude spectrum of {name} before the filter, and the gain of the filter ({kind})"
            pieces.append(picture(figure, words))
        missing = "The signals were not filtered, or the fit lacks their spectra."
        if not pieces:
            return paragraph(missing, "note")
        return unfoldable("Spectra and the gain of the filter", side_by_side(pieces), printed=False)

    @titled("Provenance")
    def provenance(self) -> Html:
        """Return what a reader needs to repeat the fit, or to doubt it."""
        record = run_record(self.fit)
        totals, search = record["totals"], record.get("search", {})
        every = (str(search.get("algorithm")), str(search.get("finish") or "none"))
        steps = [step for step in dict.fromkeys(every) if step != "none"]
        rows = [
            ("sysid", f"{record.get('sysid')}, revision {(record.get('git_revision') or 'unknown')[:12]}"),
            ("written", str(record.get("written"))),
            ("campaign", f"{record.get('campaign', {}).get('file')}"),
            ("search", f"{', then '.join(steps)}, {len(self.fit.runs)} runs"),
            ("NRMSE", f"rms error over {record.get('nrmse_denominator')} of the measurement"),
            ("candidates", f"{totals['candidates']}, {totals['failed']} failed"),
            ("computed in", f"{totals['wall_time']:.0f} s of runs"),
        ]
        lines = preformatted("\n".join(record_lines(record)))
        whole = unfoldable("the whole record", lines, printed=False)
        return definitions(rows, "where it comes from") + whole

    def figures(self) -> dict[str, Figure]:
        """Return the figures for a paper by file name: vectors, in the larger layouts."""
        out = {"measured-against-simulated": figure_measured_against_simulated(self.fit)}
        for fit, trial in self._each():
            out |= self.trial_figures(fit, trial)
        out["convergence"] = figure_convergence(self.fit, wide=True)
        out["waterfall"] = figure_waterfall(self.fit)
        out["spread"] = figure_spread(self.fit)
        trials = [trial for _, trial in self._each()]
        for name, figure in spectrum_figures(self.fit, trials).items():
            out[f"spectrum-{name}"] = figure
        if self.trust is not None:
            out["correlation"] = figure_correlation(self.trust)
        if self.climbed is not None:
            out["ladder"] = figure_rungs(self.climbed)
        profiles = self.likelihood_profiles
        names = file_names([f"profile-{row.name}" for row, *_ in profiles])
        for name, (row, *curve) in zip(names, profiles, strict=True):
            out[name] = figure_profile(row, *curve)
        return out

    def trial_figures(self, fit: FitResult, trial: TrialResult) -> dict[str, Figure]:
        """Return the figures of one trial for a paper by file name."""
        return {f"trial-{self.trial_name(fit, trial)}": figure_of([self.view(fit, trial)])}

    def trial_name(self, fit: FitResult, trial: TrialResult) -> str:
        """Return a trial's name in the names of files."""
        each = self._each()
        names = [t.name if f is self.fit else f"against-{f.name}-{t.name}" for f, t in each]
        return file_names(names)[each.index((fit, trial))]

    def missing(self, what: str, command: str, arguments: str = "") -> Html:
        """Return the line that names the command which computes a missing part."""
        what = f"{what[:1].upper()}{what[1:]}"
        return paragraph(f"{what}: not computed; run {command} {self.folder}{arguments}.", "note")


def _counted(number: int, noun: str) -> str:
    count = _COUNTS[number] if number < len(_COUNTS) else str(number)
    return f"{count} {noun}{'' if number == 1 else 's'}"


def file_names(texts: Iterable[str]) -> list[str]:
    """Return texts as parts of files' names; a number is added to one that differs from none but in case."""
    names: dict[str, str] = {}
    for text in texts:
        name = plain = re.sub(r"[^A-Za-z0-9._-]+", "-", text)
        for number in count(2):
            if name.casefold() not in names:
                break
            name = f"{plain}-{number}"
        names[name.casefold()] = name
    return list(names.values())
