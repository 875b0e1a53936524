"""Intervals where the model is wrong: what is left is not noise, and more samples do not average it away.

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

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import t as student

from sysid.fit.problem import Problem
from sysid.parameters import SearchSpace
from sysid.trust.linearized import NORMAL_95, Linearized, gradient_noise, half_widths
from sysid.trust.profiles import Profiles
from sysid.types import FloatArray

# Degrees of freedom, at least: steps inside one log repeat as trials do.
_LEAST_FREEDOM = 2


def widened(problem: Problem, linear: Linearized, without: FloatArray) -> Linearized:
    """Return what misfit leaves open; `without` (T, n) are the fits without each trial, or (0, n)."""
    factor = np.maximum(misfit_factor(problem, linear, without), 1.0)
    known = linear.information
    # Beyond the range of the bounds there is nothing to be uncertain about.
    largest = 1.0 / (np.sqrt(12.0) * np.maximum(known.sigma, 1e-12))
    spread = np.minimum(factor, np.maximum(largest, 1.0))
    information = replace(
        known,
        inflation=known.inflation * factor**2,
        covariance=known.covariance * np.outer(spread, spread),
    )
    widths = half_widths(problem.space, linear.point, information.sigma)
    return replace(linear, information=information, half_widths=widths)


def not_narrower(profiles: Profiles, space: SearchSpace, others: Sequence[Linearized]) -> Profiles:
    """Return profiles whose intervals contain linearized ones, of these parameters and perhaps further ones.

    The cost of a wrong model is rough and rises in steps, so that a profile may end before the misfit does.
    """
    out, n = [], len(profiles.profiles)
    for i, profile in enumerate(profiles.profiles):
        ends: dict[str, Any] = {}
        for level, reach in ((68, 1.0), (95, NORMAL_95)):
            ways = [at.point[i] + side * at.information.sigma[i] for at in others for side in (-reach, reach)]
            cube = np.repeat(others[0].point[None, :n], 2, axis=0)
            cube[:, i] = np.clip([min(ways), max(ways)], 0.0, 1.0)
            low, high = space.decode(cube)[:, i].tolist()
            was, opened = getattr(profile, f"interval_{level}"), getattr(profile, f"open_{level}")
            ends[f"interval_{level}"] = min(was[0], low), max(was[1], high)
            ends[f"open_{level}"] = opened[0] or bool(cube[0, i] <= 0), opened[1] or bool(cube[1, i] >= 1)
        out.append(replace(profile, **ends))
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
