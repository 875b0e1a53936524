"""The assessment of one fit: refine, derive, linearize, profile, resample.

The bootstrap draws whole trials with replacement, because samples of one trial are not independent. With few
trials some resamples consist of two or three different ones, so it tends to be wider than the profile. It
also sees what the model does not describe, if that differs from trial to trial.

Where the model is wrong, what is left is not noise, and more samples do not average it away.
The sandwich covariance of `sysid.trust.linearized` takes the residuals of two trials as independent. What a
model lacks pushes every channel of every trial, and often the same way. Where noise does not explain the
trials, a parameter's deviation is therefore the largest of

* the sum, not the root of the sum of squares, of what the residuals of each channel of each trial, as long as
  they last, may move it by;
* the jackknife over trials (Efron & Stein 1981), which sees how trials disagree;
* what leaving any single trial out moves it by;

times Student's t of as many trials over the normal quantile. Bias that all trials share and that looks like a
change of the parameter stays unseen by any of these. The interval therefore reaches to where the parameter
goes when all terms that its kind declares are fitted as well, with what stays open there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from sysid.fit.adequacy import EXPLAINED_BY, NOT_BY, UNJUDGED, Adequacy, adequacy, undisturbed
from sysid.fit.problem import Problem
from sysid.fit.search import run_one
from sysid.fit.settings import SearchSettings
from sysid.fit.trial import nrmse_of
from sysid.journal import Say
from sysid.parameters import SearchSpace
from sysid.trust.least_squares import Solved, solve
from sysid.trust.linearized import NORMAL_95, Linearized, gradient_noise, half_widths, linearized, noise_model
from sysid.trust.problem import scales, trial_rows
from sysid.trust.profiles import Profiles, walk_profiles
from sysid.trust.terms import downhill, starting_point
from sysid.trust.verdicts import verdict
from sysid.types import FloatArray, IntArray

# Rounds of fitting and weighting; the weights follow the NRMSE, which hardly moves.
_ROUNDS = 3
# Number of iterations of a refit; a refit that has not converged gets twice as many more, once.
_ITERATIONS = 8
# Least number of trials of which one is left out: two that differ do not tell which is odd.
FEWEST = 3
# Degrees of freedom, at least: steps inside one log repeat as trials do.
_LEAST_FREEDOM = 2


def linearize(problem: Problem, start: FloatArray, kept: FloatArray | None = None) -> Linearized:
    """Go from the best set (n,) [unit cube] to the minimum near it, and find what noise leaves open there.

    `kept` (S, m) are the derivatives by the stated values, where they are known from a fit nearby.
    """
    start = problem.at_stated_scale(np.clip(np.asarray(start, dtype=np.float64), 0.0, 1.0)[None])[0]
    linear = _linearized(problem, start, kept)
    for _ in range(_ROUNDS):
        before = linear
        solved = solve(
            problem, linear.point[None], linear.scale, rise=linear.jacobian.rise,
            curvature=linear.information.curvature, tolerance=linear.tolerance, iterations=20,
            known=linear.derivatives,
        )  # fmt: skip
        linear = _linearized(problem, solved.points[0], kept)
        moved = np.abs(linear.point - before.point) / np.maximum(before.information.sigma, 1e-12)
        if np.max(moved) < 0.1:
            break
    return linear


def _linearized(problem: Problem, point: FloatArray, kept: FloatArray | None) -> Linearized:
    blocks, residuals = problem.blocks, problem.residuals(point[None])[0][0]
    levels = nrmse_of(blocks, residuals)
    scale = scales(problem, blocks, levels)
    # One standard deviation of a sum of squares is about a sample's share of it.
    sample = float(np.sqrt(np.sum((residuals * scale) ** 2) / sum(block.count for block in blocks)))
    changes = problem.disturbances(point)
    noise = noise_model(blocks, undisturbed(blocks, residuals, changes))
    linear = linearized(problem, point, levels, scale, max(sample, 1e-12), noise, changes, kept)
    # The inflation of a derivative that depends on the step is worth nothing; the largest one replaces it.
    rise = linear.information.inflation
    rise = np.where(linear.jacobian.trusted, rise, rise.max())
    return replace(linear, information=replace(linear.information, inflation=rise))


def bootstrap(problem: Problem, linear: Linearized, resamples: int, seed: int) -> Solved:
    """Fit resamples of whole trials, drawn with replacement."""
    count = len(problem.trials)
    drawn = np.random.default_rng(seed).integers(count, size=(resamples, count))
    return refit(problem, linear, np.stack([np.bincount(row, minlength=count) for row in drawn]))


def leave_one_out(problem: Problem, linear: Linearized) -> Solved:
    """Fit all trials but one, for each."""
    return refit(problem, linear, 1 - np.eye(len(problem.trials)))


def refit(
    problem: Problem, linear: Linearized, weights: FloatArray | IntArray, tolerance: float | None = None
) -> Solved:
    """Fit the trials under each row of `weights` (F, T), from the minimum on.

    Fits that have not come to an end go on once, from where they are.
    """
    weights = np.asarray(weights, dtype=np.float64)
    tolerance = linear.tolerance if tolerance is None else tolerance

    def walked(starts: FloatArray, weights: FloatArray, iterations: int) -> Solved:
        return solve(
            problem, starts, linear.scale, rise=linear.jacobian.rise,
            curvature=linear.information.curvature, tolerance=tolerance, iterations=iterations,
            known=linear.derivatives,
            weights=lambda part: trial_rows(problem.blocks, weights[part], len(linear.scale)),
        )  # fmt: skip

    first = walked(np.tile(linear.point, (len(weights), 1)), weights, _ITERATIONS)
    left = np.flatnonzero(~first.converged & np.isfinite(first.squares))
    if not len(left):
        return first
    more = walked(first.points[left], weights[left], 2 * _ITERATIONS)
    return first.walked_on(left, more)


@dataclass(frozen=True, eq=False)
class Assessment:
    """What is known about the uncertainty of a fit.

    `noise` is what noise alone leaves open; `linear` the same where noise explains the trials, else what
    misfit leaves open. `without` are the fits without each trial; None with fewer than three.
    """

    adequacy: Adequacy
    noise: Linearized
    linear: Linearized
    profiles: Profiles
    without: Solved | None
    resampled: Solved | None

    @property
    def verdicts(self) -> tuple[str, ...]:
        """The verdict on every parameter that the search has found.

        Where noise does not explain the trials, no parameter is well known. One that a bound cuts is not
        interpretable then, nor is one that trades with it: the bound shifts it as well.
        """
        words = [verdict(profile.half_width) for profile in self.profiles.profiles]
        if self.adequacy.verdict != NOT_BY:
            return tuple(words)
        names = [profile.name for profile in self.profiles.profiles]
        cut = {*self.adequacy.symptoms}
        partners = self.linear.information.partners(names)
        return tuple(
            "not_interpretable"
            if cut & {name, *(partner.name for partner in others)}
            else "weakly"
            if word == "well"
            else word
            for name, others, word in zip(names, partners, words, strict=True)
        )


def assess(
    problem: Problem,
    start: FloatArray,
    *,
    wider: Problem | None = None,
    resamples: int = 100,
    seed: int = 0,
    say: Say = None,
    ended: bool = True,
) -> Assessment:
    """Assess a fit: linearized uncertainty, profiles of all free parameters, bootstrap over whole trials.

    `start` (n,) is the best set [unit cube]. `wider` has the terms on trial free as well; it is looked at
    where noise does not explain the trials. There is no bootstrap without `resamples` or with fewer than
    three trials. Unless a run of the search has `ended` by itself, the model is not blamed.
    """
    tell = say or (lambda sentence: None)
    tell("derivatives at the best set")
    judged, noise, linear, without = judge_fit(problem, start, ended)
    tell(f"profiles of {len(problem.space.found)} parameters")
    walked = walk_profiles(problem, linear, seed)
    if walked.lowered > 1.0:
        # A profile has found a better place, from which everything is judged.
        judged, noise, linear, without = judge_fit(problem, walked.best, ended)
        again = walk_profiles(problem, linear, seed)
        walked = replace(again, evaluations=walked.evaluations + again.evaluations)
    if judged.verdict not in (EXPLAINED_BY, UNJUDGED):
        others = [linear]
        if wider is not None and len(wider.space.free) > len(start):
            tell("all terms that the model may lack, fitted together")
            values = dict(zip(problem.space.names, problem.space.decode(linear.point).tolist(), strict=True))
            # A search comes first: with all terms free the minimum near a fit is often not the least one.
            far = run_one(wider, SearchSettings(runs=1)).best_point
            far, _ = downhill(wider, np.stack([far, starting_point(problem, wider, values)]))
            others.append(linearize_widened(wider.exact, far))
        walked = not_narrower(walked, problem.space, others)
    resampled = None
    if resamples > 0 and len(problem.trials) >= FEWEST:
        tell(f"{resamples} fits of resampled trials")
        resampled = bootstrap(problem, noise, resamples, seed)
    return Assessment(judged, noise, linear, walked, without, resampled)


def judge_fit(
    problem: Problem, start: FloatArray, ended: bool = True
) -> tuple[Adequacy, Linearized, Linearized, Solved | None]:
    """Go to the minimum near a start; return how well noise explains it, and what it leaves open.

    What noise alone leaves open, what is left open with the misfit, and the fits without each trial.
    """
    noise = linearize(problem, start)
    judged = _adequacy(problem, noise.point, ended)
    without = leave_one_out(problem, noise) if len(problem.trials) >= FEWEST else None
    if judged.verdict in (EXPLAINED_BY, UNJUDGED):
        return judged, noise, noise, without
    points = np.zeros((0, len(start))) if without is None else without.points
    return judged, noise, widened(problem, noise, points), without


def linearize_widened(problem: Problem, start: FloatArray, kept: FloatArray | None = None) -> Linearized:
    """Go to the minimum near a start; return what noise leaves open there, or misfit if there is any.

    `kept` as for `linearize`.
    """
    linear = linearize(problem, start, kept)
    if _adequacy(problem, linear.point).verdict not in (EXPLAINED_BY, UNJUDGED):
        linear = widened(problem, linear, np.zeros((0, len(linear.point))))
    return linear


def _adequacy(problem: Problem, point: FloatArray, ended: bool = True) -> Adequacy:
    space = problem.space
    sides = dict(zip(space.names, space.at_bound(point[None])[0].tolist(), strict=True))
    return adequacy(problem, space.full(point[None])[0], sides, ended=ended)


def widened(problem: Problem, linear: Linearized, without: FloatArray) -> Linearized:
    """Return what misfit leaves open; `without` (T, n) are the fits without each trial, or (0, n)."""
    factor = np.maximum(misfit_factor(problem, linear, without), 1.0)
    known = linear.information
    # Beyond the range of the bounds there is nothing to be uncertain about.
    largest = 1.0 / (np.sqrt(12.0) * np.maximum(known.sigma, 1e-12))
    spread = np.minimum(factor, np.maximum(largest, 1.0))
    information = replace(
        known, inflation=known.inflation * factor**2, covariance=known.covariance * np.outer(spread, spread)
    )
    widths = half_widths(problem.space, linear.point, information.sigma)
    return replace(linear, information=information, half_widths=widths)


def not_narrower(profiles: Profiles, space: SearchSpace, others: Sequence[Linearized]) -> Profiles:
    """Return profiles whose intervals contain linearized ones, of these parameters and perhaps further ones.

    The cost of a wrong model is rough and rises in steps, so that a profile may end before the misfit does.
    """
    out = []
    for i, profile in enumerate(profiles.profiles):
        ends, opens = [], []
        for reach, was, opened in (
            (1.0, profile.interval_68, profile.open_68),
            (NORMAL_95, profile.interval_95, profile.open_95),
        ):
            ways = [at.point[i] + side * at.information.sigma[i] for at in others for side in (-reach, reach)]
            cube = np.repeat(others[0].point[None], 2, axis=0)
            cube[:, i] = np.clip([min(ways), max(ways)], 0.0, 1.0)
            low, high = space.decode(cube)[:, i].tolist()
            ends.append((min(was[0], low), max(was[1], high)))
            opens.append((opened[0] or bool(cube[0, i] <= 0), opened[1] or bool(cube[1, i] >= 1)))
        out.append(
            replace(profile, interval_68=ends[0], interval_95=ends[1], open_68=opens[0], open_95=opens[1])
        )
    return replace(profiles, profiles=tuple(out))


def misfit_factor(problem: Problem, linear: Linearized, without: FloatArray) -> FloatArray:
    """Return by what the deviation of every parameter (n,) grows where noise does not explain the trials."""
    count, known = len(problem.trials), linear.information
    inverse = np.linalg.pinv(known.curvature, rcond=1e-12, hermitian=True)
    moves = np.zeros(len(linear.point))
    changes, nothing = problem.disturbances(linear.point), np.zeros((0, len(linear.scale)))
    for block, level in zip(problem.blocks, linear.levels, strict=True):
        spread = gradient_noise(
            [block], linear.jacobian.values, linear.scale, [level], linear.noise, nothing
        )  # fmt: skip
        moves += np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0.0))
    pushed = inverse @ linear.jacobian.values.T @ (changes * linear.scale).T
    moves = np.hypot(moves, np.sqrt(np.sum(pushed**2, axis=1)))
    sandwich = np.sqrt(np.diag(inverse @ known.gradient_noise @ inverse))
    quantile = float(student.ppf(0.975, max(count - 1, _LEAST_FREEDOM))) / NORMAL_95
    together = quantile * moves / np.maximum(sandwich, 1e-300)
    if not len(without) or not np.isfinite(without).all():
        return np.asarray(together)
    scatter = np.sqrt((count - 1) / count * np.sum((without - without.mean(axis=0)) ** 2, axis=0))
    farthest = np.max(np.abs(without - linear.point), axis=0) / NORMAL_95
    sigma = np.maximum(known.sigma, 1e-12)
    return np.maximum(together, np.maximum(quantile * scatter, farthest) / sigma)
