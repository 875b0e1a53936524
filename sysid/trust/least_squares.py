"""Many small least-squares fits at once: each a front of its own, all their candidates in one population.

Levenberg-Marquardt with projected bounds. A population's kernel is fastest with hundreds of candidates, so
the fronts (points of profiles, resampled trials) walk side by side: one call scores every column of every
front's difference Jacobian, a second one several damping factors of every front's step. A front whose cost is
too rough for derivatives is handed to CMA-ES around where it stands.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sysid.fit.algorithms import Start, breeder
from sysid.trust.problem import Problem

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# Damping that is tried in every step, as multiples of the front's own.
_FACTORS = (0.1, 1.0, 10.0)
_DAMPING = (1e-8, 1e-3, 1e6)
# Residuals that are held at once [bytes].
_MEMORY = 128e6
# A front in CMA-ES: population, generations.
_POPULATION, _GENERATIONS = 12, 16


@dataclass(frozen=True, eq=False)
class Solved:
    """Where the fronts ended.

    Parameters
    ----------
    points : (F, n) array
        In the unit cube.
    squares : (F,) array
        Sum of squares of the weighted residuals.
    converged : (F,) bool array
        False where the last step still took more off than the tolerance.
    evaluations : int
        Points that were simulated.
    """

    points: FloatArray
    squares: FloatArray
    converged: BoolArray
    evaluations: int


def solve(
    problem: Problem,
    starts: FloatArray,
    scale: FloatArray,
    steps: FloatArray,
    *,
    held: BoolArray | None = None,
    weights: Callable[[slice], FloatArray] | None = None,
    tolerance: float = 1e-3,
    iterations: int = 12,
) -> Solved:
    """Minimize the weighted sum of squares of every front.

    Parameters
    ----------
    problem : Problem
    starts : (F, n) array
        In the unit cube.
    scale : (m,) array
        What weights the residuals.
    steps : (n,) array
        Of the difference Jacobian [unit cube].
    held : (F, n) bool array, optional
        Coordinates that keep their value.
    weights : callable, optional
        Gives, for a slice of the fronts, further factors (F', m) on the squares of residuals.
    tolerance : float
        A front has converged when a step takes less than this off its sum of squares.
    iterations : int
        At most.
    """
    n_fronts, n = starts.shape
    fixed = np.zeros(starts.shape, dtype=np.bool_) if held is None else np.asarray(held, dtype=np.bool_)
    share = max(1, int(_MEMORY / (8 * len(scale) * (n + 1 + len(_FACTORS)))))
    points, squares = np.array(starts, dtype=np.float64), np.empty(n_fronts)
    converged = np.zeros(n_fronts, dtype=np.bool_)
    evaluations = 0
    for first in range(0, n_fronts, share):
        part = slice(first, min(first + share, n_fronts))
        factor = np.ones((part.stop - part.start, 1)) if weights is None else weights(part)
        spent = _walk(
            problem, points[part], squares[part], converged[part], fixed[part], scale,
            factor, steps, tolerance, iterations,
        )  # fmt: skip
        evaluations += spent
    return Solved(points, squares, converged, evaluations)


def _walk(
    problem: Problem,
    points: FloatArray,
    squares: FloatArray,
    converged: BoolArray,
    fixed: BoolArray,
    scale: FloatArray,
    factor: FloatArray,
    steps: FloatArray,
    tolerance: float,
    iterations: int,
) -> int:
    """Improve points, squares and converged (views) in place; return the points simulated."""
    n = points.shape[1]
    root = np.sqrt(factor) * scale
    damping = np.full(len(points), _DAMPING[1])
    active = np.ones(len(points), dtype=np.bool_)
    here, failed = problem.residuals(points)
    here = here * root
    squares[:] = np.where(failed, np.inf, np.sum(here**2, axis=1))
    evaluations = len(points)
    for _ in range(iterations):
        fronts = np.flatnonzero(active & np.isfinite(squares))
        if not len(fronts):
            break
        at = points[fronts]
        side = np.where(at + steps > 1.0, -1.0, 1.0) * steps
        ahead = np.repeat(at[:, None], n, axis=1)
        ahead[:, np.arange(n), np.arange(n)] += side
        moving = ~fixed[fronts]
        which = np.flatnonzero(moving.ravel())
        values, lost = problem.residuals(ahead.reshape(-1, n)[which])
        evaluations += len(which)
        columns = np.zeros((len(fronts) * n, len(scale)))
        columns[which] = np.where(lost[:, None], 0.0, 1.0) * values
        columns = columns.reshape(len(fronts), n, -1) * root[fronts if len(root) > 1 else [0]][:, None]
        usable = np.zeros(len(fronts) * n, dtype=np.bool_)
        usable[which] = ~lost
        usable = usable.reshape(len(fronts), n)
        columns = np.where(usable[:, :, None], columns - here[fronts][:, None], 0.0) / side[:, :, None]
        trials = np.empty((len(fronts), len(_FACTORS), n))
        for f in range(len(fronts)):
            gradient = columns[f] @ here[fronts[f]]
            hessian = columns[f] @ columns[f].T
            # A coordinate at its bound whose descent leads out of the cube stays there.
            stuck = ((at[f] <= 0) & (gradient > 0)) | ((at[f] >= 1) & (gradient < 0)) | ~usable[f]
            free = np.flatnonzero(~stuck)
            for k, times in enumerate(_FACTORS):
                trials[f, k] = at[f]
                if len(free):
                    inner = hessian[np.ix_(free, free)]
                    own = damping[fronts[f]] * times * np.diag(inner) + 1e-12 * (np.trace(inner) + 1e-300)
                    step = np.linalg.solve(inner + np.diag(own), -gradient[free])
                    trials[f, k, free] = np.clip(at[f, free] + step, 0.0, 1.0)
        values, lost = problem.residuals(trials.reshape(-1, n))
        evaluations += len(values)
        values = (
            values.reshape(len(fronts), len(_FACTORS), -1) * root[fronts if len(root) > 1 else [0]][:, None]
        )
        reached = np.sum(values**2, axis=2)
        reached[lost.reshape(reached.shape)] = np.inf
        best = np.argmin(reached, axis=1)
        lowest = reached[np.arange(len(fronts)), best]
        for f, front in enumerate(fronts):
            gain = squares[front] - lowest[f]
            if gain > 0:
                points[front], squares[front] = trials[f, best[f]], lowest[f]
                here[front] = values[f, best[f]]
                damping[front] = np.clip(damping[front] * _FACTORS[best[f]], _DAMPING[0], _DAMPING[2])
            else:
                damping[front] = np.clip(damping[front] * 100.0, _DAMPING[0], _DAMPING[2])
            if gain < tolerance and (gain > 0 or damping[front] >= 10.0):
                active[front], converged[front] = False, True
    return evaluations


def search_around(
    problem: Problem,
    start: FloatArray,
    spread: FloatArray,
    scale: FloatArray,
    held: BoolArray,
    seed: int,
) -> tuple[FloatArray, float, int]:
    """Look for a lower sum of squares around a point with a small CMA-ES: rough costs have no derivatives.

    Returns the best point (n,), its sum of squares, and how many points were simulated.
    """
    free = np.flatnonzero(~held)
    bred = breeder("cmaes", len(free), _POPULATION, seed, Start(start[free], spread[free]))
    values, _ = problem.residuals(start[None])
    best, lowest, evaluations = start, float(np.sum((values[0] * scale) ** 2)), 1
    for _ in range(_GENERATIONS):
        asked = bred.ask()
        if asked is None:
            break
        points = np.tile(start, (len(asked), 1))
        points[:, free] = asked
        values, failed = problem.residuals(points)
        evaluations += len(points)
        squares = np.where(failed, np.inf, np.sum((values * scale) ** 2, axis=1))
        # A finite penalty for what cannot be simulated: an evolution strategy ranks only.
        bred.tell(np.where(np.isfinite(squares), squares, 1e30))
        if squares.min() < lowest:
            lowest, best = float(squares.min()), points[int(np.argmin(squares))]
    return best, lowest, evaluations
