"""`sysid validate`: a fit against trials that it has not seen. The one predictor.

Every prediction of a campaign by a fit is `predict` on the campaign opened under the law of the fit; see
`sysid.fit.problem.Problem.adopt` for what the fit brings and what is the campaign's.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from sysid.errors import FitError
from sysid.export import read_judged_fit
from sysid.fit.kind import Kind, Words
from sysid.fit.problem import Problem, computed_by
from sysid.fit.result import FitResult
from sysid.fit.store import fit_folder
from sysid.fit.story import Story
from sysid.fit.trial import Prediction
from sysid.journal import Journal, Say, notice
from sysid.parallel import executor
from sysid.parameters import common_name
from sysid.trust.assessment import leave_one_out, linearize
from sysid.trust.documents import (
    Arrays,
    CrossValidationDocument,
    JudgedTrial,
    LeftOutTrial,
    ValidationDocument,
    free_part,
    validation_part,
    write_part,
)
from sysid.trust.draws import STORED
from sysid.trust.influence import standing_out
from sysid.trust.use import ClassOfUse, NumberOfUse, class_of_use, numbers_of_use
from sysid.trust.validation import judge, judgement
from sysid.types import BoolArray, FloatArray
from sysid.workflows.draws import stored_draws
from sysid.workflows.kinds import naming_campaign, open_campaign
from sysid.workflows.provenance import stated_campaign
from sysid.workflows.reopen import open_fit

OfUse = tuple[list[NumberOfUse], ClassOfUse | None]


@dataclass(frozen=True, eq=False)
class Predicted:
    """Trials of a campaign, predicted by the sets of a fit.

    `rows` (S, n_table) are as `Problem.adopt` returns them [SI].
    """

    problem: Problem
    story: Story
    rows: FloatArray
    scored: Prediction

    @property
    def nrmse(self) -> FloatArray:
        """(S, T) weighted mean over channels [1]."""
        mean, by_channel = self.problem.cost.mean, self.scored.by_channel
        return np.stack([mean(by_channel[:, [t]]) for t in range(by_channel.shape[1])], axis=1)

    @cached_property
    def floor(self) -> FloatArray:
        """(T, C) noise of the measurement as compared, at the best set [channel units]; NaN where unknown."""
        return self.story.floor(self.rows[0])

    @property
    def evidence(self) -> Mapping[str, tuple[FloatArray, FloatArray]]:
        """Points behind what the fit takes as known, at the best set, see `Story.evidence`."""
        return self.story.evidence(self.rows[0])

    def judge(self, t: int, sets: slice, floor: FloatArray) -> JudgedTrial:
        """Judge a trial as some sets predict it, the first of them best; `floor` (T, C) [channel units]."""
        problem, best = self.problem, sets.start or 0
        contacts = self.story.contacts(t, self.rows[best])
        return judge(
            problem.trials[t],
            self.nrmse[sets, t],
            self.scored.by_channel[best, t],
            self.scored.signals[t][best],
            spread=problem.cost.denominators[t],
            noise=floor[t],
            weights=problem.cost.weights,
            channels=problem.channels,
            contacts=contacts,
        )


def predict(fit: FitResult, kind: Kind, problem: Problem, values: FloatArray | None = None) -> Predicted:
    """Predict the trials of a problem by a fit, or by other `values` (S, n) [SI] of its parameters."""
    problem = problem.exact
    rows = problem.adopt(fit, values)
    return Predicted(problem, kind.story(problem), rows, problem.predict(rows))


def open_under(fit: FitResult, path: Path, threads: int | None = None) -> tuple[Kind, Problem]:
    """Return the trials of a campaign under the law of a fit.

    Raises `SysidError` when the campaign has another kind or cannot be used.
    """
    with naming_campaign(path):
        kind, campaign, _ = open_campaign(path, fit.kind, fit.law)
        return kind, kind.open(campaign, path, threads)


def unseen(fit: FitResult, problem: Problem, path: Path) -> list[str]:
    """Return the names of the trials whose logs the fit was not made from.

    Raises `FitError` when there are none.
    """
    fitted = {trial.name for trial in fit.trials if trial.use == "fit"}
    left = _without_logs(fit, problem, fitted)
    if not left:
        raise FitError(
            f"{path}: the fit was made from every trial in it, so they validate nothing; keep trials out of "
            "the fit with use = 'validate', or name no campaign (in Python: sysid.cross_validate): each "
            "trial is then predicted by the others"
        )
    return left


def _without_logs(fit: FitResult, problem: Problem, names: Collection[str]) -> list[str]:
    logs = fit.provenance.get("logs", {})
    seen = {str(log.get("sha256")) for name, log in logs.items() if name in names}
    return [trial.name for trial in problem.trials if trial.digest not in seen]


def predicted_fit(fit: FitResult, path: Path) -> FitResult:
    """Return the sets of a fit on the trials of a campaign whose logs are not in the fit.

    Trials that the fit held back are in its report already. Raises `SysidError` when the campaign has another
    kind, cannot be used, or has no other trials than the fit.
    """
    with Journal() as journal:
        kind, whole = open_under(fit, path)
        fresh = set(_without_logs(fit, whole, {trial.name for trial in fit.trials}))
        names = [name for name in unseen(fit, whole, path) if name in fresh]
        if not names:
            raise FitError(
                f"{path}: every trial in it is one of {fit.name}, whose report shows the ones held back "
                "anyway; leave --against out, or name a campaign with other logs"
            )
        predicted = predict(fit, kind, whole.only(names))
        problem = predicted.problem
        trials = problem.results(predicted.rows)
    logs = {name: log for name, log in predicted.story.logs.items() if name in names}
    return replace(
        fit,
        name=problem.campaign.name,
        runs=(),
        trials=tuple(replace(trial, use="validate") for trial in trials),
        provenance={**fit.provenance, "logs": logs},
        warnings=tuple(journal.sentences()),
    )


def validate_fit(
    folder: Path, campaign_path: Path, *, threads: int | None = None, say: Say = None
) -> ValidationDocument:
    """Score a fit on the trials of a campaign that it was not fitted to, and store that in its folder.

    The campaign is any of the same kind; of the one that was fitted, the trials of use "validate" serve.
    Raises `SysidError` when nothing is left to validate with, or an input cannot be used; nothing has been
    written then.
    """
    folder, campaign_path = fit_folder(folder), Path(campaign_path)
    result = read_judged_fit(folder)
    with Journal(say) as journal:
        kind, whole = open_under(result, campaign_path, threads)
        journal.noun = kind.words.trials
        # Findings so far are about all trials of the campaign, not only those that the fit has not seen.
        journal.fold(len(whole.trials))
        predicted = predict(result, kind, whole.only(unseen(result, whole, campaign_path)))
        problem = predicted.problem
        _notice_unjudged(problem)
        judged = [predicted.judge(t, slice(None), predicted.floor) for t in range(len(problem.trials))]
        _notice_unlike(judged, kind.words)
        stated = stated_campaign(problem.campaign.source, folder)
        draws = stored_draws(folder, result)
        read = foreseen(predicted.story, result, result.values[:1], draws)
        trials = [
            trial.model_copy(update={"numbers": numbers, "ends": ends})
            for trial, (numbers, ends) in zip(judged, read, strict=True)
        ]
        document = ValidationDocument(
            part=free_part(folder, validation_part(problem.campaign.name), stated),
            fit=result.name,
            kind=result.kind,
            campaign=stated,
            **vars(judgement(trials, result, drawn=draws is not None)),
            trials=trials,
            warnings=journal.sentences(),
        )
    units = ", ".join(result.channel_units)
    arrays: dict[str, tuple[FloatArray | BoolArray, str, str]] = {}
    for number, (trial, signals) in enumerate(zip(problem.trials, predicted.scored.signals, strict=True), 1):
        root = f"trials/{number}"
        arrays[f"{root}/time"] = (trial.time, "sample", "s")
        arrays[f"{root}/measured"] = (trial.measured, "sample, channel", units)
        arrays[f"{root}/valid"] = (trial.valid, "sample, channel", "1")
        arrays[f"{root}/simulated"] = (signals, "set, sample, channel", units)
    write_part(folder, document, arrays)
    return document


def foreseen(story: Story, fit: FitResult, best: FloatArray, draws: FloatArray | None) -> list[OfUse]:
    """Return numbers of use and ends of every trial, as `best` (1, n) and draws (k, n) [SI] predict them."""
    draws = np.repeat(best, STORED, axis=0) if draws is None else draws
    return [
        (numbers_of_use(read.numbers), None if read.ends is None else class_of_use(read.ends))
        for read in story.read(fit, np.concatenate([best, draws]))
    ]


def _notice_unlike(judged: list[JudgedTrial], words: Words) -> None:
    """Name every trial that is predicted far worse than the others are."""
    ratios = np.array([trial.ratio for trial in judged])
    for t in standing_out(ratios):
        notice(
            "unlike-the-others",
            f"{judged[t].name}: {ratios[t]:.1f} × what noise alone costs where the trials have "
            f"{np.median(ratios):.1f} (median): {words.unlike}",
        )


def _notice_unjudged(problem: Problem) -> None:
    noise = problem.noise
    silent = [
        f"{problem.trials[block.trial].name} ({problem.channels[block.channel]})"
        for block in problem.blocks
        if not np.isfinite(noise[block.trial, block.channel])
    ]
    if silent:
        notice(
            "no-noise-shown",
            f"{', '.join(silent)}: the noise is not known, so the predictions of these are not judged",
        )


def cross_validate(
    folder: Path,
    campaign: Path | None = None,
    *,
    threads: int | None = None,
    dask: str | None = None,
    say: Say = None,
) -> CrossValidationDocument:
    """Leave out each fitted trial in turn, fit the rest from the best set on, predict the trial left out.

    Raises `FitError` when fewer than two trials were fitted.
    """
    with Journal(say) as journal:
        opened = open_fit(folder, campaign, 1 if dask else threads)
        result, problem = opened.result, opened.problem
        journal.noun = opened.kind.words.trials
        journal.fold(len(opened.whole.trials))
        _notice_unjudged(problem)
        if len(problem.trials) < 2:
            raise FitError(f"{folder}: a single trial was fitted; leaving it out leaves nothing")
        with executor(dask, 2) as where:
            spread = computed_by(problem, where)
            linear = linearize(spread, result.cube[0])
            journal.tell(f"{len(problem.trials)} fits, each without one trial")
            refits = leave_one_out(spread, linear)
        space, names = problem.space, [record.name for record in result.parameters]
        trials = [name for name in opened.whole.names if name in problem.names]
        decoded = space.decode(refits.points[[problem.names.index(name) for name in trials]])
        place = {
            trial.digest: trials.index(trial.name) for trial in opened.whole.trials if trial.name in trials
        }
        for i, row in enumerate(space.free):
            # No fit without a trial knows more of it than what is stated, or found of the others.
            out = place.get(opened.whole.row_logs.get(row.name, ""))
            if out is None:
                continue
            alike = [k for k, one in enumerate(space.free) if common_name(one) == common_name(row) and k != i]
            if row.name in space.stated:
                decoded[out, i] = space.stated[row.name]
            elif alike:
                decoded[out, i] = decoded[out, alike].mean()
        values = np.repeat(result.values[:1], len(decoded), axis=0)
        values[:, [names.index(name) for name in space.names]] = decoded
        predicted = predict(result, opened.kind, opened.whole.only(trials), values)
        floor = predicted.story.floor(space.full(linear.point[None])[0])
        judged = [predicted.judge(t, slice(t, t + 1), floor) for t in range(len(problem.trials))]
        draws, shifts = stored_draws(opened.folder, result), space.encode(decoded) - linear.point
        columns = [names.index(name) for name in space.names]
        for t, trial in enumerate(judged):
            behind = None
            if draws is not None:
                # The draws of the fit, moved to where the fit without this trial ends.
                behind = np.array(draws)
                moved = space.decode(np.clip(space.encode(draws[:, columns]) + shifts[t], 0.0, 1.0))
                own = [place.get(opened.whole.row_logs.get(row.name, "")) == t for row in space.free]
                behind[:, columns] = np.where(own, decoded[t], moved)
            story = opened.kind.story(opened.whole.only([trial.name]).exact)
            ((numbers, ends),) = foreseen(story, result, values[t : t + 1], behind)
            judged[t] = trial.model_copy(update={"numbers": numbers, "ends": ends})
        document = CrossValidationDocument(
            fit=result.name,
            kind=result.kind,
            campaign=opened.stated,
            **vars(judgement(judged, result, drawn=draws is not None)),
            trials=[
                LeftOutTrial(**vars(trial), refit=dict(zip(space.names, refit, strict=True)))
                for trial, refit in zip(judged, decoded.tolist(), strict=True)
            ],
            warnings=journal.sentences(),
        )
    arrays: Arrays = {"values": (decoded, "trial left out, free parameter", "SI")}
    write_part(opened.folder, document, arrays)
    return document
