"""Fits of resampled trials: bootstrap over whole trials, and leaving one trial out.

Trials are drawn with replacement as a whole, because samples of one trial are not independent. Every resample
starts from the best set; all resamples walk side by side. With few trials some resamples hold two or
three different ones only, so the bootstrap tends to be wider than the profile: it also sees what the model
does not describe, if that differs from trial to trial.
"""

from __future__ import annotations

import numpy as np

from sysid.fit.problem import Problem
from sysid.trust.least_squares import Solved, solve
from sysid.trust.linearized import Linearized
from sysid.trust.problem import trial_rows
from sysid.types import FloatArray, IntArray


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
    """Fit the trials under each row of `weights` (F, T), from the minimum on."""
    scale, weights = linear.scale, np.asarray(weights, dtype=np.float64)
    return solve(
        problem, np.tile(linear.point, (len(weights), 1)), scale, linear.jacobian.steps,
        weights=lambda part: trial_rows(problem.blocks, weights[part], len(scale)),
        tolerance=linear.tolerance if tolerance is None else tolerance, iterations=8,
    )  # fmt: skip
