"""All of it for one fit: refine, derive, linearize, profile, resample."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sysid.fit.problem import Block, NoiseModel, Problem
from sysid.trust.jacobian import Jacobian, jacobian
from sysid.trust.least_squares import solve
from sysid.trust.linearized import (
    Information,
    gradient_noise,
    half_widths,
    information,
    noise_model,
    undisturbed,
    with_bounds,
)
from sysid.trust.problem import nrmse_of, scales
from sysid.trust.profiles import Profiles, walk_profiles
from sysid.trust.resampling import Resampled, bootstrap
from sysid.types import FloatArray

# Rounds of fitting and weighting anew; the weights follow the NRMSE, which hardly moves.
_ROUNDS = 3
# Of the deviance.
_TOLERANCE = 0.02


@dataclass(frozen=True, eq=False)
class Linearized:
    """A problem at its minimum.

    Parameters
    ----------
    point : (n,) array
        Where the sum of squares is least [unit cube].
    scale : (m,) array
        Weights of the residuals.
    residuals : (m,) array
        Unweighted [1].
    levels : (B,) array
        NRMSE of every block [1].
    noise : NoiseModel
        Of the residuals.
    """

    point: FloatArray
    scale: FloatArray
    residuals: FloatArray
    levels: FloatArray
    jacobian: Jacobian
    noise: NoiseModel
    information: Information

    @property
    def tolerance(self) -> float:
        """What a fit's sum of squares is found to: a small share of any parameter's deviance 1."""
        return _TOLERANCE * float(np.min(self.information.inflation))


def linearize(problem: Problem, start: FloatArray, *, refine: bool = True) -> Linearized:
    """Go to the minimum near a point and find what noise leaves open there.

    Parameters
    ----------
    start : (n,) array
        The best set [unit cube].
    refine : bool
        False: stay there.
    """
    point = np.clip(np.asarray(start, dtype=np.float64), 0.0, 1.0)
    linear = _linearized(problem, point)
    for _ in range(_ROUNDS if refine else 0):
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
    values, _ = problem.residuals(point[None])
    residuals = values[0]
    levels = nrmse_of(problem.blocks, residuals)
    scale = scales(problem.blocks, levels, len(residuals))
    # One standard deviation of a sum of squares is of the size of a sample's share of it.
    samples = sum(block.count for block in problem.blocks)
    sample = float(np.sqrt(np.sum((residuals * scale) ** 2) / samples))
    derived = jacobian(problem, point, scale, max(sample, 1e-12))
    changes = problem.disturbances(point)
    noise = noise_model(problem.blocks, undisturbed(problem.blocks, residuals, changes))
    spread = gradient_noise(problem.blocks, derived.values, scale, levels, noise, changes)
    known = with_bounds(information(derived.values, spread), derived.values, spread, point)
    # An inflation that rests on a derivative which depends on the step is worth nothing: the largest serves.
    rise = np.where(derived.trusted, known.inflation, known.inflation.max())
    known = replace(known, inflation=rise)
    return Linearized(point, scale, residuals, levels, derived, noise, known)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Assessment:
    """What is known about the uncertainty of a fit.

    Parameters
    ----------
    expected : (n,) array
        Relative 95 % half-widths of the linearization [1].
    """

    linear: Linearized
    expected: FloatArray
    profiles: Profiles
    resampled: Resampled | None


def assess(
    problem: Problem,
    start: FloatArray,
    *,
    resamples: int = 100,
    seed: int = 0,
    say: Callable[[str], None] | None = None,
) -> Assessment:
    """Assess a fit: linearized uncertainty, profiles of all free parameters, bootstrap over whole trials.

    Parameters
    ----------
    start : (n,) array
        The best set [unit cube].
    resamples : int
        Of the bootstrap; 0: none. With fewer than three trials there is none either.
    say : callable, optional
        Told what is going on.
    """
    tell = say or (lambda sentence: None)
    tell("derivatives at the best set")
    linear = linearize(problem, start)
    tell(f"profiles of {len(start)} parameters")
    walked = walk_profiles(
        problem, linear.point, linear.scale, linear.jacobian.steps, linear.information, seed=seed
    )
    if walked.lowered > 1.0:
        # A profile has found a better place: everything is judged from there.
        linear = linearize(problem, walked.best)
        again = walk_profiles(
            problem, linear.point, linear.scale, linear.jacobian.steps, linear.information, seed=seed
        )
        walked = replace(again, evaluations=walked.evaluations + again.evaluations)
    resampled = None
    if resamples > 0 and len(problem.trials) >= 3:
        tell(f"{resamples} fits of resampled trials")
        resampled = bootstrap(
            problem, linear.point, linear.scale, linear.jacobian.steps, resamples, seed, linear.tolerance
        )
    expected = half_widths(problem.space, linear.point, linear.information.sigma)
    return Assessment(linear, expected, walked, resampled)


def floors(blocks: tuple[Block, ...], trial: int) -> FloatArray:
    """Return the NRMSE that noise alone costs in every block of a trial [1]."""
    return np.array([block.noise for block in blocks if block.trial == trial])
