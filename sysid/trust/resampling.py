"""Fits of resampled trials: bootstrap over whole trials, and leaving one trial out.

Trials are drawn with replacement as a whole, because samples of one trial are not independent. Every resample
is fitted anew from the best set; all resamples walk side by side. With few trials some resamples hold two or
three different ones only, so the bootstrap tends to be wider than the profile: it also sees what the model
does not describe, if that differs from trial to trial.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid.fit.problem import Problem
from sysid.trust.least_squares import solve
from sysid.trust.problem import trial_rows
from sysid.types import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class Resampled:
    """Parameters of resampled fits.

    Parameters
    ----------
    points : (B, n) array
        In the unit cube.
    weights : (B, T) array
        How often each trial was drawn.
    converged : (B,) bool array
    squares : (B,) array
        Sum of squares that each was left with; infinite where it could not be simulated.
    """

    points: FloatArray
    weights: FloatArray
    converged: BoolArray
    squares: FloatArray
    evaluations: int


def bootstrap(
    problem: Problem,
    best: FloatArray,
    scale: FloatArray,
    steps: FloatArray,
    resamples: int,
    seed: int,
    tolerance: float,
) -> Resampled:
    """Fit resamples of whole trials, drawn with replacement.

    Parameters
    ----------
    best : (n,) array
        Where every fit starts [unit cube].
    scale : (m,) array
        Weights of the residuals.
    steps : (n,) array
        Of difference Jacobians.
    tolerance : float
        Of the sum of squares.
    """
    count = len(problem.trials)
    source = np.random.default_rng(seed)
    drawn = source.integers(count, size=(resamples, count))
    weights = np.stack([np.bincount(row, minlength=count) for row in drawn]).astype(np.float64)
    return _refit(problem, best, scale, steps, weights, tolerance)


def leave_one_out(
    problem: Problem, best: FloatArray, scale: FloatArray, steps: FloatArray, tolerance: float
) -> Resampled:
    """Fit all trials but one, for each; parameters as of `bootstrap`."""
    count = len(problem.trials)
    return _refit(problem, best, scale, steps, np.ones((count, count)) - np.eye(count), tolerance)


def _refit(
    problem: Problem,
    best: FloatArray,
    scale: FloatArray,
    steps: FloatArray,
    weights: FloatArray,
    tolerance: float,
) -> Resampled:
    solved = solve(
        problem, np.tile(best, (len(weights), 1)), scale, steps,
        weights=lambda part: trial_rows(problem.blocks, weights[part], len(scale)),
        tolerance=tolerance, iterations=8,
    )  # fmt: skip
    good = solved.converged & np.isfinite(solved.squares)
    return Resampled(solved.points, weights, good, solved.squares, solved.evaluations)
