"""The assessment of one fit: refine, derive, linearize, profile, resample.

The bootstrap draws whole trials with replacement, because samples of one trial are not independent. With few
trials some resamples consist of two or three different ones, so it tends to be wider than the profile. It
also sees what the model does not describe, if that differs from trial to trial.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sysid.fit.problem import Problem
from sysid.journal import Say
from sysid.trust.least_squares import Solved, solve
from sysid.trust.linearized import Linearized, linearized, noise_model, undisturbed
from sysid.trust.problem import nrmse_of, scales, trial_rows
from sysid.trust.profiles import Profiles, walk_profiles
from sysid.types import FloatArray, IntArray

# Rounds of fitting and weighting; the weights follow the NRMSE, which hardly moves.
_ROUNDS = 3


def linearize(problem: Problem, start: FloatArray) -> Linearized:
    """Go from the best set (n,) [unit cube] to the minimum near it, and find what noise leaves open there."""
    linear = _linearized(problem, np.clip(np.asarray(start, dtype=np.float64), 0.0, 1.0))
    for _ in range(_ROUNDS):
        before = linear
        solved = solve(
            problem, linear.point[None], linear.scale, linear.jacobian.steps,
            tolerance=linear.tolerance, iterations=20,
        )  # fmt: skip
        linear = _linearized(problem, solved.points[0])
        moved = np.abs(linear.point - before.point) / np.maximum(before.information.sigma, 1e-12)
        if np.max(moved) < 0.1:
            break
    return linear


def _linearized(problem: Problem, point: FloatArray) -> Linearized:
    blocks, residuals = problem.blocks, problem.residuals(point[None])[0][0]
    levels = nrmse_of(blocks, residuals)
    scale = scales(blocks, levels, len(residuals))
    # One standard deviation of a sum of squares is about a sample's share of it.
    sample = float(np.sqrt(np.sum((residuals * scale) ** 2) / sum(block.count for block in blocks)))
    changes = problem.disturbances(point)
    noise = noise_model(blocks, undisturbed(blocks, residuals, changes))
    linear = linearized(problem, point, levels, scale, max(sample, 1e-12), noise, changes)
    # Where a derivative depends on the step, its inflation is worth nothing; the largest one replaces it.
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
    """Fit the trials under each row of `weights` (F, T) [1], from the minimum on."""
    scale, weights = linear.scale, np.asarray(weights, dtype=np.float64)
    return solve(
        problem, np.tile(linear.point, (len(weights), 1)), scale, linear.jacobian.steps,
        weights=lambda part: trial_rows(problem.blocks, weights[part], len(scale)),
        tolerance=linear.tolerance if tolerance is None else tolerance, iterations=8,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Assessment:
    """What is known about the uncertainty of a fit."""

    linear: Linearized
    profiles: Profiles
    resampled: Solved | None


def assess(
    problem: Problem, start: FloatArray, *, resamples: int = 100, seed: int = 0, say: Say = None
) -> Assessment:
    """Assess a fit: linearized uncertainty, profiles of all free parameters, bootstrap over whole trials.

    `start` (n,) is the best set [unit cube]. There is no bootstrap without `resamples` or with fewer than
    three trials.
    """
    tell = say or (lambda sentence: None)
    tell("derivatives at the best set")
    linear = linearize(problem, start)
    tell(f"profiles of {len(start)} parameters")
    walked = walk_profiles(problem, linear, seed)
    if walked.lowered > 1.0:
        # A profile has found a better place, from which everything is judged.
        linear = linearize(problem, walked.best)
        again = walk_profiles(problem, linear, seed)
        walked = replace(again, evaluations=walked.evaluations + again.evaluations)
    resampled = None
    if resamples > 0 and len(problem.trials) >= 3:
        tell(f"{resamples} fits of resampled trials")
        resampled = bootstrap(problem, linear, resamples, seed)
    return Assessment(linear, walked, resampled)
