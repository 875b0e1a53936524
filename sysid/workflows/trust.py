"""`sysid trust FIT`: profiles, linearized uncertainty, bootstrap and spread of a fit, kept in its folder."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from sysid.errors import FitError
from sysid.fit.adequacy import NOT_BY, misfit_finding
from sysid.fit.kind import Words
from sysid.fit.problem import computed_by
from sysid.fit.result import FitResult
from sysid.fit.store import fit_texts
from sysid.journal import Finding, Journal, Say, notice
from sysid.parallel import executor
from sysid.parameters import Parameter, SearchSpace, about, in_words
from sysid.trust.assessment import FEWEST, Assessment, assess
from sysid.trust.documents import (
    Arrays,
    Bootstrap,
    ChannelNoise,
    FreeParameter,
    Noise,
    Spread,
    SpreadOfTrial,
    TrialInfluence,
    TrustDocument,
    stating_intervals,
    write_part,
)
from sysid.trust.draws import STORED
from sysid.trust.influence import Influence, influence
from sysid.trust.least_squares import Solved
from sysid.trust.stated import deciding
from sysid.trust.suspects import put_on_trial
from sysid.trust.terms import freed
from sysid.types import FloatArray
from sysid.workflows.draws import draw_values
from sysid.workflows.options import TrustOptions
from sysid.workflows.reopen import OpenedFit, open_fit

# Error of a stated value after the fit, over the stated one, from which on the trials say nothing of it [1].
_UNSEEN = 0.97
# Causes of single trials that stand out of a fit which noise does not explain, with the next step.
_MISSING_TERM = "a term that the model lacks does that: try sysid explain first"
_WRONG_STATEMENT = "what the campaign states wrongly does that: correct it first"
_STATEMENT = (
    "the mean NRMSE is minimized by a weighted sum of squares, one noise level per trial and channel "
    "(its NRMSE); the rise of that sum along a profile is divided by the parameter's inflation, which "
    "accounts for the correlation of the residuals in time and between channels and for the uncertainty of "
    "what the fit takes as known, so that it follows chi-square with one degree of freedom; where noise does "
    "not explain the trials, an interval also contains what misfit leaves open, and where the parameter goes "
    "in a search with all terms that the model may lack"
)
# Least distance of the best set from the minimum that is worth a word [standard deviations].
_MOVED = 2.0


def assess_fit(folder: Path, options: TrustOptions | None = None, say: Say = None) -> TrustDocument:
    """Assess a fit and store the result in its folder; return its document.

    Raises `SysidError` when the fit or its campaign cannot be used; nothing has been written then.
    """
    options = options or TrustOptions()
    with Journal(say) as journal:
        opened = open_fit(folder, options.campaign, 1 if options.dask else options.threads)
        document, arrays = assess_opened(opened, options, journal)
    # No value leaves without its interval.
    write_part(
        opened.folder, document, arrays, partial(fit_texts, stating_intervals(opened.result, document))
    )
    return document


def assess_opened(opened: OpenedFit, options: TrustOptions, journal: Journal) -> tuple[TrustDocument, Arrays]:
    """Assess a fit with its trials at hand; return the document and its arrays, and write nothing.

    The journal is open. It hears what is doubtful; the document has all that it has heard.
    """
    began = time.perf_counter()
    problem, space = opened.problem, opened.space
    journal.noun = opened.kind.words.trials
    journal.fold(len(opened.whole.trials))
    if not len(space.free):
        raise FitError(f"{opened.folder}: nothing is free")
    with executor(options.dask, 2) as where:
        spread = computed_by(problem, where)
        assessed = assess(
            spread,
            opened.result.cube[0],
            wider=freed(opened.whole.fitted, opened.terms),
            resamples=options.resamples,
            seed=options.seed,
            say=journal.tell,
            ended=opened.result.agreement.finished > 0,
        )
        floors = problem.floors(space.full(assessed.linear.point[None])[0])
        trials = influence(spread, assessed.noise, floors, assessed.without)
    judged, linear, boot = assessed.adequacy, assessed.linear, assessed.resampled
    lacks = judged.verdict == NOT_BY
    without = space.decode(trials.without)
    story = opened.kind.story(opened.problem)
    rows = _parameters(opened.result, space, assessed, story.keys)
    # Why the interval of a parameter may miss the truth, by its name.
    doubts: dict[str, list[str]] = {row.name: [] for row in rows}
    inquiry = put_on_trial(problem, assessed.noise, judged, assessed.without)
    for finding in inquiry.findings:
        journal.add(finding)
    for row in rows:
        if inquiry.freed and not row.contains(value := inquiry.freed[row.name]):
            doubts[row.name].append(f"{value:.4g} {inquiry.way}")
    bad = any(finding.code == "bad-trial" for finding in inquiry.findings)
    why = _WRONG_STATEMENT if inquiry.findings else _MISSING_TERM
    why = why if lacks and not bad else ""
    _notice_trials(problem.names, without, trials, rows, doubts, opened.kind.words, why)
    record = opened.result.provenance
    same_file = record.get("campaign", {}).get("sha256") == opened.stated["sha256"]
    findings = record.get("findings", ()) if same_file else ()
    said = {one["code"]: one["sentence"] for one in findings}
    for finding in misfit_finding(judged):
        # The sentence of the fit stays: its numbers are of the best set.
        same = said.get(finding.code) if not finding.trials else None
        journal.add(replace(finding, sentence=same or finding.sentence))
    for row in rows if lacks else ():
        doubts[row.name].append("the model does not explain the trials")
    for finding in _doubtful(space.found, rows, doubts, assessed, opened.result.cube[0]):
        journal.add(finding)
    boot_record = None
    evaluations = assessed.profiles.evaluations + trials.evaluations + inquiry.evaluations
    if boot is not None:
        boot_record = Bootstrap(resamples=len(boot.points), failed=int(np.count_nonzero(~boot.converged)))
        evaluations += boot.evaluations
    document = TrustDocument(
        fit=opened.result.name,
        kind=opened.result.kind,
        adequacy=judged,
        campaign=opened.stated,
        parameters=[_with_doubts(row, doubts[row.name]) for row in rows],
        stated=inquiry.stated,
        suspects=inquiry.suspects,
        correlation=linear.information.correlation[: len(rows), : len(rows)].tolist(),
        noise=Noise(statement=_STATEMENT, channels=_channels(opened, assessed, floors)),
        trials=[
            TrialInfluence(
                name=name,
                ratio=float(trials.ratio[t]),
                without=dict(zip(space.names, without[t].tolist(), strict=True)),
                shift=dict(zip(space.names, trials.shift[t].tolist(), strict=True)),
            )
            for name in opened.whole.names
            if name in problem.names
            for t in [problem.names.index(name)]
        ],
        notes=_notes(
            len(problem.trials),
            boot,
            opened.whole.campaign.fit.exact,
            [story.keys.get(row.name, row.name) for row in inquiry.stated if row.sigma > _UNSEEN * row.error],
        ),
        spread=_spread(opened.result),
        bootstrap=boot_record,
        evaluations=evaluations,
        warnings=journal.sentences(),
        seconds=time.perf_counter() - began,
    )
    arrays = _arrays(space, assessed)
    values = draw_values(opened, document, {path: array for path, (array, *_) in arrays.items()}, STORED)
    return document, {**arrays, "draws": (values, "draw, parameter", "SI")}


def _doubtful(
    free: Sequence[Parameter],
    rows: list[FreeParameter],
    doubts: dict[str, list[str]],
    assessed: Assessment,
    best: FloatArray,
) -> Iterator[Finding]:
    """Yield rough derivatives, and that the best set (n,) is not the minimum, which the rows then doubt."""
    linear = assessed.linear
    moves = np.abs(linear.point - best) / np.maximum(linear.information.sigma, 1e-12)
    for parameter, row, jump in zip(free, rows, moves, strict=False):
        name, rough = in_words(parameter, of_trial=False), row.derivative_doubt
        # A parameter that is not identifiable has a verdict that says more.
        if not (row.derivative_trusted or row.lost):
            sentence = (
                f"{name}: its derivative changes by {100 * rough:.0f} % when the step is halved (the cost is "
                "rough there, or hardly depends on it): read its profile, not its linearized sigma"
            )
            yield about(parameter, "rough-derivative", sentence, rough)
        if jump > _MOVED and row.verdict != "not_identifiable":
            sentence = (
                f"{name}: the best set is {jump:.1f} standard deviations from where the sum of squares is "
                "least; the search has not converged, or its simulations are too inexact (fit.tolerance)"
            )
            yield about(parameter, "not-converged", sentence, float(jump))
            doubts[row.name].append("the best set is not where the sum of squares is least")
    if assessed.profiles.lowered > 1.0:
        sentence = "a profile found a better set than the profiles' start: the fit has not converged"
        yield Finding("profile-lowered", sentence)


def _arrays(space: SearchSpace, assessed: Assessment) -> dict[str, tuple[FloatArray, str, str]]:
    information = assessed.linear.information
    arrays: dict[str, tuple[FloatArray, str, str]] = {
        "correlation": (information.correlation, "parameter, parameter", "1"),
        "covariance": (information.covariance, "parameter, parameter", "1, unit cube"),
    }
    for profile in assessed.profiles.profiles:
        root = f"profiles/{profile.name}"
        arrays[f"{root}/value"] = (profile.values, "point", profile.unit)
        arrays[f"{root}/deviance"] = (profile.deviance, "point", "1")
        arrays[f"{root}/others"] = (profile.others, "point, free parameter", "SI")
    if assessed.resampled is not None:
        points = space.decode(assessed.resampled.points)
        arrays["bootstrap/values"] = (points, "resample, free parameter", "SI")
    return arrays


def _with_doubts(row: FreeParameter, doubts: list[str]) -> FreeParameter:
    """Return a row with what speaks against its interval; such a parameter is not called well known."""
    if not doubts:
        return row
    verdict = "weakly" if row.verdict == "well" else row.verdict
    return row.model_copy(update={"doubt": "; ".join(doubts), "verdict": verdict})


def _notice_trials(
    names: tuple[str, ...],
    without: FloatArray,
    trials: Influence,
    rows: list[FreeParameter],
    doubts: dict[str, list[str]],
    words: Words,
    why: str,
) -> None:
    """Notice trials that stand out or decide the fit, which the parameters that they touch then doubt.

    `names` are the trials'; `without` (T, n) are the parameters of the fits without each [SI]. Of a model
    that lacks something the trials are the evidence, and none is to be dropped: `why` then names the likelier
    cause and the next step. It is empty otherwise.
    """
    look = 'look at it, and fit without it (use = "validate")'
    unlike, alone = f": {look}", f"; {words.misleads} does that: {look}"
    unlike += f" or {words.remedy}" if words.remedy else ""
    if why:
        unlike = alone = f"; {why}"
    for t in trials.outliers:
        others = float(np.median(np.delete(trials.ratio, t)))
        notice(
            "trial-stands-out",
            f"{names[t]}: {trials.ratio[t]:.1f} × what noise alone costs where the others have {others:.1f}; "
            f"it bends every parameter{unlike}",
        )
        for row in rows:
            doubts[row.name].append(f"{names[t]} fits unlike the other trials")
    for t, farthest in trials.held_by:
        # If noise explains the trials, a move inside the interval says no more than the interval does.
        far = [i for i in farthest if why or not rows[i].contains(without[t, i])]
        if not far:
            continue
        moved = ", ".join(
            f"{rows[i].symbol} {without[t, i]:.4g} instead of {rows[i].refined:.4g}" for i in far[:3]
        )
        notice(
            "hangs-on-one-trial",
            f"the fit hangs on {names[t]} alone: without it {moved}, {abs(trials.shift[t, far[0]]):.0f} × "
            f"what one trial less explains (standard deviations){alone}",
        )
        for i in far:
            doubts[rows[i].name].append(f"it goes elsewhere without {names[t]}")


def _notes(trials: int, boot: Solved | None, exact: bool, unseen: Sequence[str]) -> list[str]:
    """Return what the numbers leave out, one sentence each.

    With `exact` the fit takes all stated values as exact. The trials do not determine the stated values that
    `unseen` names.
    """
    out = []
    if boot is None and trials < FEWEST:
        count = {1: "a single trial", 2: "two trials"}[trials]
        out.append(
            f"no bootstrap and no fits without one trial: of {count} whole ones cannot be drawn or left out"
        )
    elif boot is not None and not boot.converged.all():
        lost = int(np.count_nonzero(~boot.converged))
        out.append(
            f"bootstrap: {lost} of {len(boot.points)} fits of resampled trials did not come to an end; "
            "its intervals take their values as they are"
        )
    if exact:
        out.append(
            "all intervals: what the campaign states is taken as exact; without --exact it moves within its "
            "errors"
        )
    if unseen:
        out.append(
            f"as stated, because the trials say nothing of it: {', '.join(dict.fromkeys(unseen))}; what "
            "scales with it is off as it is"
        )
    return out


def _parameters(
    result: FitResult, space: SearchSpace, assessed: Assessment, keys: Mapping[str, str]
) -> list[FreeParameter]:
    """Return what is known of every free parameter; no doubt is stated yet. `keys` as in `Story`."""
    linear = assessed.linear
    index = {record.name: i for i, record in enumerate(result.parameters)}
    sets = result.parameter_sets()
    refined, best = space.decode(linear.point), space.decode(result.cube[0])
    sigma = linear.information.sigma
    up = space.decode(np.minimum(linear.point + sigma, 1.0)) - refined
    down = refined - space.decode(np.maximum(linear.point - sigma, 0.0))
    partners, decided = linear.information.partners(space.names), deciding(space, linear)
    boot = None
    if assessed.resampled is not None:
        boot = space.decode(assessed.resampled.points[np.isfinite(assessed.resampled.squares)])
    out = []
    judged = zip(space.found, assessed.profiles.profiles, assessed.verdicts, strict=True)
    for i, (row, profile, word) in enumerate(judged):
        column = index[row.name]
        measured = result.parameters[column].measured_range
        quantiles = None
        if boot is not None and len(boot) >= 10:
            quantiles = np.quantile(boot[:, i], [0.025, 0.975]).tolist()
        out.append(
            FreeParameter(
                name=row.name,
                symbol=row.symbol,
                unit=row.unit,
                lower=row.lower,
                upper=row.upper,
                scale=row.scale,
                value=float(best[i]),
                refined=float(refined[i]),
                mean=float(sets.mean[column]),
                sigma=float(sets.sigma[column]),
                fisher_sigma=float(max(up[i], down[i])),
                derivative_doubt=float(linear.jacobian.doubt[i]),
                derivative_trusted=bool(linear.jacobian.trusted[i]),
                interval_68=list(profile.interval_68),
                interval_95=list(profile.interval_95),
                open_68=list(profile.open_68),
                open_95=list(profile.open_95),
                half_width=profile.half_width,
                verdict=word,
                decided_by=keys.get(decided[i] or "", decided[i]),
                expected_half_width=float(linear.half_widths[i]),
                partners=partners[i],
                at_bound=int(result.at_bound[0, column]),
                measured=None if measured is None else list(measured),
                bootstrap_95=quantiles,
                rough_points=profile.rough,
            )
        )
    return out


def _channels(opened: OpenedFit, assessed: Assessment, floors: FloatArray) -> list[ChannelNoise]:
    """Return, per channel over all trials, rms residual, noise floor and independent samples."""
    result, linear = opened.result, assessed.linear
    out = []
    for c, name in enumerate(result.channels):
        pairs = zip(opened.problem.blocks, linear.levels, floors, strict=True)
        levels = [(block, level, least) for block, level, least in pairs if block.channel == c]
        if not levels:
            continue
        count = sum(block.count for block, *_ in levels)
        residual = sum(block.count * (level * block.spread) ** 2 for block, level, _ in levels) / count
        floor = sum(block.count * (least * block.spread) ** 2 for block, _, least in levels) / count
        out.append(
            ChannelNoise(
                name=name,
                unit=result.channel_units[c],
                residual=float(np.sqrt(residual)),
                floor=float(np.sqrt(floor)),
                samples=count,
                independent_samples=float(count / linear.noise.inflation[linear.noise.channels.index(c)]),
            )
        )
    return out


def _spread(result: FitResult) -> Spread:
    """Return how far the predictions of the sets lie apart, per trial and channel [channel units]."""
    trials = []
    for trial in result.trials:
        apart = trial.simulated - trial.simulated.mean(axis=0)
        rms, largest = np.sqrt(np.mean(apart**2, axis=(0, 1))), np.max(np.abs(apart), axis=(0, 1))
        of_trial = SpreadOfTrial(name=trial.name, use=trial.use, rms=rms.tolist(), largest=largest.tolist())
        trials.append(of_trial)
    return Spread(channels=list(result.channels), units=list(result.channel_units), trials=trials)
