"""`sysid fit-gear`, `sysid fit-motor`: a campaign in, ranked parameter sets out."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from sysid.campaign import read_campaign
from sysid.errors import FitError, SysidError, shell
from sysid.fit.adequacy import EXPLAINED_BY, NOT_BY, Adequacy, adequacy, misfit_finding
from sysid.fit.checkpoint import PROBES, PROCESSOR, Checkpoint
from sysid.fit.history import RunHistory, summed
from sysid.fit.kind import Course, FitOutcome
from sysid.fit.optima import agreement, loose_findings, waterfall
from sysid.fit.problem import Problem, computed_by
from sysid.fit.progress import FitProgress
from sysid.fit.result import FitResult, bound_findings, ranked_sets
from sysid.fit.search import Hooks, run_many
from sysid.fit.settings import SearchSettings
from sysid.fit.stopping import CutReason, CutShort, Deadline, cut_short_by, stop_on_interrupt
from sysid.fit.store import check_new_fit, write_fit
from sysid.fit.story import Story
from sysid.fit.trial import noise_floor
from sysid.journal import Finding, Journal, Say, notice, tell
from sysid.parallel import executor
from sysid.parameter_sets import INTERVALS, NOT_ASSESSED
from sysid.parameters import about, in_words
from sysid.trust.documents import part_files, stating_intervals
from sysid.trust.sensitivity import quick_expectations
from sysid.trust.verdicts import sentences
from sysid.workflows.kinds import naming_campaign, open_campaign
from sysid.workflows.options import FitOptions, TrustOptions
from sysid.workflows.provenance import fit_identity, processor, provenance
from sysid.workflows.reopen import OpenedFit
from sysid.workflows.trust import assess_opened

# Runs that share a cluster at the same time: while one breeds, the others keep its workers busy.
_RUNS_AT_ONCE = 8
# Candidates that are scored to recognise an objective.
_PROBES = 4


def fit_gear(
    path: str | Path, options: FitOptions | None = None, *, surface: str | None = None, say: Say = None
) -> tuple[FitResult, Path]:
    """Fit the landing gear to the drops of a campaign of kind ``gear``; see `fit_campaign`.

    `surface` fits another friction law than the campaign's. Friction that the campaign states belongs to its
    own law and is ignored, with a warning.
    """
    law = {} if surface is None else {"surface": surface}
    return fit_campaign(path, options, kind="gear", law=law, say=say)


def fit_motor(
    path: str | Path, options: FitOptions | None = None, *, say: Say = None
) -> tuple[FitResult, Path]:
    """Fit the motor to the bench logs of a campaign of kind ``motor``; see `fit_campaign`."""
    return fit_campaign(path, options, kind="motor", say=say)


def fit_campaign(
    path: str | Path,
    options: FitOptions | None = None,
    *,
    kind: str | None = None,
    law: Mapping[str, Any] | None = None,
    say: Say = None,
    hear: Say = None,
) -> tuple[FitResult, Path]:
    """Fit a model to the trials of a campaign; return the ranked sets, what led to them, and the folder.

    The campaign must be of the `kind`, if one is named. `law` replaces the campaign's, see
    `sysid.workflows.kinds.open_campaign`. `hear` gets the lines of progress that a terminal shows else.
    Raises `SysidError` when an input cannot be used; nothing has been written then.
    """
    path, options = Path(path), options or FitOptions()
    folder = options.folder(read_campaign(path, kind).name)
    begun = Checkpoint.options(folder) if options.resume else {}
    exact = {"exact": True} if getattr(options, "exact", None) or begun.get("exact") else {}
    model, campaign, ignored = open_campaign(path, kind, law={**(law or {}), **exact})
    search = options.search(campaign.fit, begun)
    deadline = Deadline(search.time_limit)
    if options.resume and options.force:
        raise FitError("--resume continues a fit and --force discards it; choose one")
    # Before the hours of a fit are spent.
    Checkpoint.check_start(folder, resume=options.resume, force=options.force)
    replaces = options.force or options.resume
    check_new_fit(folder, replaces)
    missing = ""
    with naming_campaign(path), ExitStack() as until_done, ExitStack() as until_written:
        progress = FitProgress(search, model.words.trials, options.quiet, hear=hear)
        journal = until_done.enter_context(Journal(say, model.words.trials, details=options.details))
        try:
            with journal.blaming():
                for finding in ignored:
                    journal.add(finding)
                problem = model.open(campaign, path, options.threads)
                story = model.story(problem)
                story.quality()
                journal.fold(len(problem.trials))
                story.about()
                model.begin(problem)
                story.tell_stated()
            journal.fold(len(problem.trials))
            fitted = problem.fitted
            with journal.blaming():
                expected = _expected(fitted) if options.check else {}
            limited = replace(search, time_limit=deadline.left)
            identity, candidate_time = _identity(search, story, fitted)
            checkpoint = Checkpoint(folder, identity, resume=options.resume, force=options.force)
            until_done.callback(checkpoint.close)
            # Ctrl-C is a flag from here on: what was found so far is kept.
            deadline.flag = until_written.enter_context(stop_on_interrupt(progress.on_stop))
            should_stop = deadline.flag.is_set
            runs, cut = _search(fitted, limited, options, checkpoint, progress, should_stop, candidate_time)
            sets = ranked_sets(runs, problem.space)
            outcome = model.follow_up(problem, Course(sets, search, cut, deadline.check))
            judged = _judged(problem.fitted.exact, outcome, ended=agreement(runs).finished > 0)
            record = {**provenance(search, story, folder), **expected, "adequacy": judged.model_dump()}
            follows = options.trust and outcome.cut is None
            # A spread of the sets beside an interval is a second claim; of a wrong model it is none.
            loose = loose_findings(runs, problem.space, not follows and judged.verdict != NOT_BY)
            bounds = bound_findings(outcome.records, outcome.at_bound)
            doubts = chain(misfit_finding(judged), loose, _not_assessed(outcome, follows, folder), bounds)
            result = _result(model.name, problem, runs, outcome, judged, record)
            _add_doubts(journal, doubts)
            noticed = [finding.document() for finding in journal.findings]
            result = replace(
                result,
                provenance={**result.provenance, "findings": noticed},
                warnings=tuple(journal.sentences()),
            )
            shown, beside = result, None
            until_written.close()
            if follows:
                try:
                    opened = OpenedFit(folder, result, path, model, problem)
                    with (
                        Journal(say, heard=result.warnings, details=options.details) as inner,
                        cut_short_by(deadline),
                    ):
                        # Resamples would take longer than all else, and no interval rests on them.
                        trust = TrustOptions(resamples=0, threads=options.threads, dask=options.dask)
                        document, arrays = assess_opened(opened, trust, inner)
                    shown, beside = stating_intervals(result, document), partial(part_files, document, arrays)
                except (SysidError, CutShort) as error:
                    # The fit is whole without its intervals.
                    missing = f"no intervals ({error}); run sysid trust {shell(folder)}"
                except BaseException:
                    # Neither Ctrl-C nor a fault in the intervals loses the sets; --resume makes them.
                    write_fit(result, folder, replaces)
                    tell(f"{folder}: the sets are written; their intervals are missing")
                    raise
            written = write_fit(result, folder, replaces, shown=shown, beside=beside)
            if outcome.cut is None:
                # A finished fit needs no checkpoint; until here --resume goes on with the intervals.
                checkpoint.discard()
        except KeyboardInterrupt:
            # Aborted by a second Ctrl-C, or by the first one before or after the search.
            if Checkpoint.kept(Checkpoint.folder_of(folder)):
                tell(f"{folder}: aborted; finished stages are kept, continue with --resume")
            raise
    if missing:
        say(f"warning: {missing} [no-intervals]") if say else notice("no-intervals", missing)
    return shown, written


def _add_doubts(journal: Journal, doubts: Iterable[Finding]) -> None:
    """Add what is doubtful about parameters; one that is not identifiable is named once."""
    for finding in doubts:
        lost = {name for old in journal.findings if old.code == "not-identifiable" for name in old.parameters}
        if not finding.parameters or not lost.issuperset(finding.parameters):
            journal.add(finding)


def _not_assessed(outcome: FitOutcome, follows: bool, folder: Path) -> Iterator[Finding]:
    """Yield which parameters have no digits without the intervals, unless these follow."""
    for row in outcome.records:
        if not follows and row.name in outcome.settings.get(NOT_ASSESSED, ()):
            sentence = (
                f"{in_words(row, of_trial=False)} was not assessed, and the data may give it no more than a "
                f"bound: no digits are printed until sysid trust {shell(folder)} finds its interval"
            )
            yield about(row, "not-assessed", sentence)


def _judged(fitted: Problem, outcome: FitOutcome, *, ended: bool) -> Adequacy:
    """Return whether noise explains what the best set leaves; tell so if it does."""
    sides = zip(outcome.records, outcome.at_bound[0].tolist(), strict=True)
    at_bound = {record.name: side for record, side in sides if record.status == "free"}
    row, nrmse = outcome.rows[0], float(outcome.nrmse[0])
    judged = adequacy(fitted, row, at_bound, nrmse, ended=ended)
    if judged.verdict == EXPLAINED_BY:
        tell(judged.sentence, detail=True)
    return judged


def _cut_by_bounds(outcome: FitOutcome, judged: Adequacy) -> dict[str, Any]:
    """Return settings with the verdict on what a bound cuts where the model does not explain the trials.

    Without intervals, no digits of such a parameter are printed.
    """
    cut = {
        row.name: {
            "interval_95": [row.lower, row.upper],
            "open_95": [True, True],
            "verdict": "not_interpretable",
            "doubt": "the model does not explain the trials, and a bound cuts it",
        }
        for row in outcome.records
        if row.name in judged.symptoms
    }
    return {
        **outcome.settings,
        **({INTERVALS: {**outcome.settings.get(INTERVALS, {}), **cut}} if cut else {}),
    }


def _expected(fitted: Problem) -> dict[str, Any]:
    """Tell what the trials are expected to determine, and return it for the provenance."""
    try:
        rows = quick_expectations(fitted)
    except FitError as error:
        raise FitError(f"{error}, or leave the check before a fit out with --no-check") from error
    for sentence in sentences(rows):
        tell(f"expected: {sentence}", detail=True)
    return {"expected": [parameter.model_dump() for parameter in rows]}


def _identity(settings: SearchSettings, story: Story, fitted: Problem) -> tuple[dict[str, Any], float]:
    """Return what must be equal for the fit to be continued, and the time that a candidate takes [s]."""
    # Inputs that no hash of a log or a table covers (a static log, a kernel) show in the costs of some
    # candidates.
    points = np.random.default_rng(0).random((_PROBES, len(fitted.space.free)))
    costs = [float(cost).hex() for cost in fitted.evaluate(points).cost]
    # Again, now that everything is loaded and compiled: the time left is estimated from it.
    began = time.perf_counter()
    fitted.evaluate(points)
    candidate_time = (time.perf_counter() - began) / _PROBES
    identity = fit_identity(settings, story)
    return {**identity, PROBES: costs, PROCESSOR: processor()}, candidate_time


def _search(
    fitted: Problem,
    settings: SearchSettings,
    options: FitOptions,
    checkpoint: Checkpoint,
    progress: FitProgress,
    should_stop: Callable[[], bool],
    candidate_time: float,
) -> tuple[tuple[RunHistory, ...], CutReason | None]:
    """Search with live progress and checkpoints; return the runs that were begun, and what cut them short.

    `should_stop` ends the search and keeps what was scored.
    """
    if options.resume:
        begun, stages = checkpoint.state()
        tell(f"continuing {begun} runs after {stages} finished stages")
    progress.expect(
        noise_floor(fitted.blocks),
        candidate_time,
        lambda point: float(fitted.of_stated(fitted.space.full(point[None]))[0]),
    )
    with executor(options.dask, min(settings.runs, _RUNS_AT_ONCE), options.threads) as where, progress:
        hooks = Hooks(progress.on_generation, progress.on_run, should_stop)
        runs = run_many(
            computed_by(fitted, where), settings, checkpoint=checkpoint, hooks=hooks, at_once=where.at_once
        )
    for note in checkpoint.notes:
        notice("checkpoint", note)
    ended = {stage.stop_reason for run in runs for stage in run.stages}
    # Runs that were not begun have been called off.
    called_off = "interrupted" in ended or len(runs) < settings.runs
    cut: CutReason | None = "interrupted" if called_off else "time" if "time" in ended else None
    agreed = agreement(runs, settings.runs, fitted.space.free, noise_floor(fitted.blocks))
    if len(runs) > 1:
        for line in waterfall(runs, fitted.space.free):
            tell(line, detail=True)
    if agreed.agrees and len(runs) > 1:
        tell(agreed.sentence(), detail=True)
    else:
        notice("runs-apart", agreed.sentence())
    return runs, cut


def _result(
    kind: str,
    problem: Problem,
    runs: tuple[RunHistory, ...],
    outcome: FitOutcome,
    judged: Adequacy,
    record: Mapping[str, Any],
) -> FitResult:
    """Return what a fit has found; notice which simulations are lost."""
    trials = problem.results(outcome.rows)
    failures = summed(run.failures for run in runs)
    cut = {} if outcome.cut is None else {"cut_short": outcome.cut}
    counted = {"failures": failures} if len(problem.causes) > 1 else {}
    return FitResult(
        kind=kind,
        name=problem.campaign.name,
        state="done" if outcome.cut is None else "stopped",
        parameters=outcome.records,
        runs=runs,
        set_runs=outcome.sets.run,
        set_seeds=outcome.sets.seed,
        cube=outcome.sets.cube,
        **{name: getattr(outcome, name) for name in ("values", "at_bound", "nrmse")},
        settings=_cut_by_bounds(outcome, judged),
        trials=trials,
        channels=problem.channels,
        channel_units=problem.units,
        channel_weights=tuple(float(weight) for weight in problem.cost.weights),
        provenance={**record, **cut, **counted, **outcome.provenance},
    )
