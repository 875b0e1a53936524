"""Who is wrong: stated values, exchanges of them and single trials, tried before any physics.

A value is accused where the trials contradict its statement (`sysid.trust.stated`); of a fit that noise does
not explain, where noise explains it once nothing is stated of the contradicted values, because missing
physics and a bad trial pull at right values, too. An exchange, or a lost sign, is accused where noise
explains the trials once it is undone, about as well as with nothing stated of the contradicted values. A
trial is accused where noise explains all others, which predict it badly, and no value is; then the others may
accuse values, because a wrong value spoils how a trial is read.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from sysid.documents import channel_symbol
from sysid.fit.adequacy import EXPLAINED_BY, NOT_BY, Adequacy, adequacy
from sysid.fit.problem import Problem
from sysid.journal import Finding
from sysid.trust.assessment import linearize
from sysid.trust.documents import StatedValue, Suspect
from sysid.trust.least_squares import Solved, solve
from sysid.trust.linearized import Linearized
from sysid.trust.stated import contradictions, stated_values
from sysid.types import FloatArray

# Number of stated values that are tried alone where noise does not explain the fit, by what each would gain.
_ALONE = 3
# Deviance by which a mistake may explain the trials worse than contradicted values of which nothing is stated
# and still be accused instead: the values are then stated elsewhere, with their errors.
_AS_WELL = 6.0
# Distance from which on a value is wrong besides another one, or in a bad trial [standard errors].
_OFF = 3.0
# Share of the misfit from which on it does not fall.
_NO_FALL = 0.99
# Number of iterations of a fit without a statement, which may walk on, and of one that shows whether a
# mistake is worth a fit.
_ITERATIONS, _FIRST = 15, 4
# Largest sum of squares after `_FIRST` iterations with which a mistake is worth a whole fit, as a multiple
# of the sum of squares of the fit as stated [1].
_HOPELESS = 2.0
# Least misfit of a bad trial as the fit of the others predicts it [noise].
_UNLIKE = 3.0


@dataclass(frozen=True, eq=False)
class Inquiry:
    """What was tried, what became of the stated values, and a finding for everybody who is accused.

    `freed` has the values by name [SI] of the fit without the contradicted statements, or without the
    mistake, and `way` says which fit that is; both are empty where nothing is wrong.
    """

    suspects: list[Suspect]
    stated: list[StatedValue]
    findings: list[Finding]
    freed: dict[str, float]
    way: str
    evaluations: int


def put_on_trial(problem: Problem, linear: Linearized, judged: Adequacy, without: Solved | None) -> Inquiry:
    """Try who may be wrong; `linear` is what noise leaves open, `without` are the fits without each trial."""
    space = problem.space
    rows, lacks = stated_values(space, linear), judged.verdict == NOT_BY
    wrong = [row.name for row in rows if row.contradicted]
    sets = [wrong] if wrong else []
    if lacks:
        largest = sorted(rows, key=lambda row: -row.gain)[:_ALONE]
        sets += [[row.name] for row in largest if [row.name] != wrong]
    suspects: list[Suspect] = []
    findings: list[Finding] = []
    freed: dict[str, float] = {}
    way, evaluations = "", 0
    if sets:
        values, least, evaluations = _freed(problem, linear, sets, rows)
        *tried, as_stated = [adequacy(problem, row) for row in values]
        if wrong and lacks and tried[0].verdict == NOT_BY:
            rows = [row.model_copy(update={"contradicted": False}) for row in rows]
        # The fit without the statements knows better than the derivatives at the fit with them.
        if any(row.contradicted for row in rows):
            freed = dict(zip(space.names, values[0, space.columns].tolist(), strict=True))
            way = f"without what is stated of {' and '.join(wrong)}"
        rows = _asking(rows, freed)
        exchange = _mistake(problem, linear, as_stated if wrong else judged, least if wrong else np.inf)
        evaluations += exchange.evaluations
        # A mistake outside of the campaign explains the trials as well as the value does: both are named.
        outside = exchange.names if not exchange.in_campaign else []
        findings = contradictions(rows, space, _falls(as_stated, tried[0]), outside)
        accused = [one.sentence for one in findings]
        suspects = [
            _suspect("value", names, one, accused if names == wrong else [])
            for names, one in zip(sets, tried, strict=True)
        ]
        if exchange.suspect is not None and not (outside and findings):
            findings = [Finding("contradicts-swapped", exchange.suspect.sentences[0])]
            suspects = _acquitted(suspects)
            suspects.insert(0, exchange.suspect)
            freed, way = exchange.values, f"with {exchange.suspect.names[0]}"
    if lacks and without is not None:
        others = _trials(problem, judged, without)
        bad = [one for one in others if one.sentences]
        if len(bad) == 1 and not findings:
            trial = Finding("bad-trial", bad[0].sentences[0], trials=tuple(bad[0].names), size=judged.ratio)
            point = without.points[problem.names.index(bad[0].names[0])]
            again = _of_trial(problem, linear, point, bad[0].names[0], rows, judged)
            if again is None:
                again = _without(problem, point, bad[0])
                # A wrong value is the likelier cause of both.
                findings = [*again.findings, trial]
            else:
                findings = again.findings
                others = _acquitted(others)
            accusing = {row.name: row for row in again.stated if row.contradicted}
            rows = [accusing.get(row.name, row) for row in rows]
            others = [*(one for one in again.suspects if one.sentences), *others]
            freed, way = again.freed, again.way
            evaluations += again.evaluations
        else:
            others = _acquitted(others)
        suspects += others
    if suspects:
        suspects.insert(0, _suspect("fit", [], judged, []))
    return Inquiry(suspects, rows, findings, freed, way, evaluations)


def _acquitted(suspects: Sequence[Suspect]) -> list[Suspect]:
    """Return suspects without an accusation."""
    return [one.model_copy(update={"sentences": []}) for one in suspects]


def _asking(rows: Sequence[StatedValue], freed: Mapping[str, float]) -> list[StatedValue]:
    """Return the rows, the contradicted ones with what the trials ask for.

    Beside the worst one, a value that is right after all is not accused.
    """
    off = {row.name: abs(freed[row.name] - row.stated) / row.error for row in rows if row.contradicted}
    worst = max(off, key=lambda name: off[name], default="")
    return [
        row.model_copy(
            update={"asked": freed[row.name], "contradicted": row.name == worst or off[row.name] > _OFF}
        )
        if row.name in off
        else row
        for row in rows
    ]


class _Mistake(NamedTuple):
    """A mistake in the campaign, if one is accused, and the values of the fit without it by name [SI]."""

    suspect: Suspect | None
    values: dict[str, float]
    evaluations: int
    # Whether keys of the campaign contain it.
    in_campaign: bool = True

    @property
    def names(self) -> list[str]:
        return self.suspect.names if self.suspect is not None else []


def _mistake(problem: Problem, linear: Linearized, before: Adequacy, least: float) -> _Mistake:
    """Return the mistake without which noise explains the trials best.

    `before` judges them as stated; `least` is the sum of squares where nothing is stated of the contradicted
    values, which a mistake explains about as well.
    """
    space = problem.space
    at = dict(zip(space.names, space.decode(linear.point[None])[0].tolist(), strict=True))
    pulls = space.pulls(space.full(linear.point[None]))[0]
    pulled = {name for name, pull in zip(space.stated, pulls, strict=True) if abs(pull) > 1.0}
    swaps, spaces, rows = [], [], []
    for swap, right in problem.mistakes:
        moved = {name: value for name, value in right.stated.items() if value != space.stated[name]}
        if moved.keys() & pulled:
            place = np.array([{**at, **moved}[name] for name in right.names])
            swaps.append(swap)
            spaces.append(right)
            rows.append(right.full(np.clip(right.encode(place), 0.0, 1.0)[None])[0])
    if not rows:
        return _Mistake(None, {}, 0)
    cost = problem.cost.mean(problem.score(np.array(rows)).by_channel)
    best, values, evaluations, in_campaign = None, dict[str, float](), len(rows) + 1, True
    least += _AS_WELL * float(linear.scale[-1]) ** 2
    residuals, _ = problem.residuals(linear.point[None])
    as_stated = float(np.sum((residuals[0] * linear.scale) ** 2))
    for k in np.argsort(cost)[:_ALONE]:
        other = replace(problem, space=spaces[k])  # type: ignore[type-var]
        points = np.clip(spaces[k].encode(rows[k][spaces[k].columns]), 0.0, 1.0)[None]
        for iterations in (_FIRST, _ITERATIONS):
            solved = solve(
                other, points, linear.scale, rise=linear.jacobian.rise, tolerance=linear.tolerance,
                iterations=iterations,
            )  # fmt: skip
            points = solved.points
            evaluations += solved.evaluations
            if solved.converged[0] or solved.squares[0] > _HOPELESS * as_stated:
                break
        if solved.squares[0] > _HOPELESS * as_stated:
            continue
        after = adequacy(other, spaces[k].full(solved.points)[0])
        if after.verdict == EXPLAINED_BY and solved.squares[0] < least:
            least = float(solved.squares[0])
            sentence = f"with {swaps[k].title} {_falls(before, after)}: correct {swaps[k].where}"
            best, in_campaign = _suspect("swap", [swaps[k].title], after, [sentence]), bool(swaps[k].keys)
            values = dict(zip(spaces[k].names, spaces[k].decode(solved.points)[0].tolist(), strict=True))
    return _Mistake(best, values, evaluations, in_campaign)


def _without(problem: Problem, point: FloatArray, bad: Suspect) -> Inquiry:
    """Try the stated values on all trials but a bad one, from their fit (n,) [unit cube]."""
    others = problem.only([name for name in problem.names if name not in bad.names])
    linear = linearize(others, point)
    judged = adequacy(others, others.space.full(linear.point[None])[0])
    return put_on_trial(others, linear, judged, None)


def without_accused(
    problem: Problem, point: FloatArray, suspects: Sequence[Suspect]
) -> tuple[Problem, FloatArray]:
    """Return what is left to explain, and the point (n,) [unit cube] in it: nobody accused has a say."""
    for one in suspects:
        if one.sentences and one.what == "trial":
            problem = problem.only([name for name in problem.names if name not in one.names])
        elif one.sentences and one.what == "swap":
            before = problem.space
            right = next(space for swap, space in problem.mistakes if swap.title in one.names)
            problem = replace(problem, space=right)  # type: ignore[type-var]
            values = before.decode(point[None])[0]
            for i, name in enumerate(before.names):
                if name in right.stated and right.stated[name] != before.stated[name]:
                    values[i] = right.stated[name]
            point = np.clip(right.encode(values), 0.0, 1.0)
        elif one.sentences:
            at = dict(zip(problem.space.names, problem.space.decode(point[None])[0].tolist(), strict=True))
            problem = replace(problem, space=problem.space.unstating(one.names))  # type: ignore[type-var]
            place = np.array([at[name] for name in problem.space.names])
            point = np.clip(problem.space.encode(place), 0.0, 1.0)
    return problem, point


def _freed(
    problem: Problem, linear: Linearized, sets: Sequence[Sequence[str]], rows: Sequence[StatedValue]
) -> tuple[FloatArray, float, int]:
    """Return where fits end, each without the statements of one set; in the last the wrong are as stated.

    Rows (F + 1, n_table) [SI], the sum of squares of the first, and how many were simulated. The first set
    walks from what its values are in the fit and from what the trials ask for: a statement that has not let
    go may lie beyond a ridge. Where its values are contradicted, they become advice: from the better end it
    walks on with new derivatives and wide bounds of its values. So does a set with a value at its bounds.
    """
    space, stop = problem.space, problem.blocks[-1].stop
    places = {name: i for i, name in enumerate(space.stated)}
    weights = np.ones((len(sets) + 2, len(linear.scale)))
    for f, names in enumerate([*sets, sets[0]]):
        weights[f, [stop + places[name] for name in names]] = 0.0
    starts = np.repeat(linear.point[None], len(weights), axis=0)
    fixed = np.zeros(starts.shape, bool)
    values = np.repeat(space.decode(starts[:1]), 2, axis=0)
    for row in rows:
        if row.contradicted:
            column = space.names.index(row.name)
            values[:, column], fixed[-1, column] = (row.asked, row.stated), True
    starts[-2:] = np.clip(space.encode(values), 0, 1)
    solved = solve(
        problem, starts, linear.scale, rise=linear.jacobian.rise, curvature=linear.information.curvature,
        fixed=fixed, known=linear.derivatives, weights=lambda part: weights[part], tolerance=linear.tolerance,
        iterations=_ITERATIONS,
    )  # fmt: skip
    points, evaluations = np.delete(solved.points, -2, axis=0), solved.evaluations
    if solved.squares[-2] < solved.squares[0]:
        points[0] = solved.points[-2]
    least, out = float(min(solved.squares[-2], solved.squares[0])), space.full(points)
    at_bound = space.at_bound(points)
    for f, names in enumerate(sets):
        advised = f == 0 and any(row.contradicted for row in rows)
        if advised or any(at_bound[f, space.names.index(name)] for name in names):
            out[f], squares, spent = _unstated(problem, linear, points[f], names)
            least, evaluations = squares if f == 0 else least, evaluations + spent
    return out, least, evaluations


def _unstated(
    problem: Problem, linear: Linearized, start: FloatArray, names: Sequence[str]
) -> tuple[FloatArray, float, int]:
    """Return where a fit ends that starts at a point (n,) [unit cube] with nothing stated of some values.

    They may be off by far. The row (n_table,) [SI], its sum of squares, and how many were simulated.
    """
    places = [problem.blocks[-1].stop + [*problem.space.stated].index(name) for name in names]
    wider, scale = problem.space.widened(names), linear.scale.copy()
    scale[places] = 0.0
    solved = solve(
        replace(problem, space=wider),  # type: ignore[type-var]
        np.clip(wider.encode(problem.space.decode(start[None])), 0.0, 1.0), scale,
        rise=linear.jacobian.rise, tolerance=linear.tolerance, iterations=2 * _ITERATIONS,
    )  # fmt: skip
    return wider.full(solved.points)[0], float(solved.squares[0]), solved.evaluations


def _of_trial(
    problem: Problem, linear: Linearized, others: FloatArray, trial: str, rows: Sequence[StatedValue],
    judged: Adequacy,
) -> Inquiry | None:  # fmt: skip
    """Try what is stated of a bad trial alone, from the fit of the `others` (n,) [unit cube].

    None where that is not what is wrong. A wrong slope hardly differs from a bad log.
    """
    space = problem.space
    own = [row.name for row in space.free if row.trial == trial and row.name in space.stated]
    if not own:
        return None
    start, places = others.copy(), [space.names.index(name) for name in own]
    start[places] = linear.point[places]
    full, _, evaluations = _unstated(problem, linear, start, own)
    freed = dict(zip(space.names, full[space.columns].tolist(), strict=True))
    after = adequacy(problem, full)
    off = {name for name in own if abs(freed[name] - space.stated[name]) > _OFF * space.stated[name].error}
    if after.misfit.channel_ratio > _UNLIKE or not off:
        return None
    rows = [
        row.model_copy(update={"contradicted": True, "asked": freed[row.name]}) if row.name in off else row
        for row in rows
    ]
    findings = contradictions(rows, space, _falls(judged, after))
    suspect = _suspect("value", own, after, [one.sentence for one in findings])
    return Inquiry([suspect], rows, findings, freed, f"without what is stated of {trial}", evaluations)


def _trials(problem: Problem, before: Adequacy, without: Solved) -> list[Suspect]:
    """Return every trial, with a sentence where noise explains the others, which predict it badly."""
    out = []
    for t, name in enumerate(problem.names):
        if not np.isfinite(without.squares[t]):
            continue
        row = problem.space.full(without.points[t][None])[0]
        left = adequacy(problem.only([other for other in problem.names if other != name]), row)
        own = adequacy(problem.only([name]), row)
        sentences = []
        if left.verdict == EXPLAINED_BY and own.misfit.channel_ratio > _UNLIKE:
            sentences = [
                f"noise explains the others without {name}: {_falls(before, left)}; look at that log, repeat "
                'it, or fit without it (use = "validate")'
            ]
        out.append(_suspect("trial", [name], left, sentences))
    return out


def _suspect(
    what: Literal["fit", "value", "swap", "trial"],
    names: Sequence[str],
    judged: Adequacy,
    sentences: list[str],
) -> Suspect:
    return Suspect(
        what=what, names=[*names], over_noise=judged.ratio, worst_channel=judged.misfit.channel_ratio,
        verdict=judged.verdict, sentences=sentences,
    )  # fmt: skip


def _falls(before: Adequacy, after: Adequacy) -> str:
    """Return how the misfit falls, in words; in the worst channel where the mean does not show it."""
    fall = after.misfit.channel_ratio / before.misfit.channel_ratio
    if max(after.ratio / before.ratio, fall) > _NO_FALL:
        return f"the misfit stays at {after.ratio:.2f} × the noise"
    if before.ratio > before.limits[EXPLAINED_BY]:
        return f"{before.ratio:.2f} × the noise falls to {after.ratio:.2f} ×"
    symbol, worst = channel_symbol(before.misfit.channel), before.misfit.channel_ratio
    return f"{worst:.2f} × the noise of {symbol} falls to {after.misfit.channel_ratio:.2f} ×"
