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

from sysid.fit.breeders.algorithms import Start, breeder
from sysid.fit.problem import Problem
from sysid.types import BoolArray, FloatArray

# Damping that is tried in every step, as multiples of the front's own.
_FACTORS = (0.1, 1.0, 10.0)
_DAMPING = (1e-8, 1e-3, 1e6)
# Residuals that are held at once [bytes].
_MEMORY = 256e6
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
    fixed = np.zeros(starts.shape, dtype=np.bool_) if held is None else held
    share = max(1, int(_MEMORY / (8 * len(scale) * (4 * n + 1 + len(_FACTORS)))))
    points, squares = np.array(starts, dtype=np.float64), np.empty(n_fronts)
    converged = np.zeros(n_fronts, dtype=np.bool_)
    evaluations = 0
    for first in range(0, n_fronts, share):
        part = slice(first, min(first + share, n_fronts))
        factor = np.ones((part.stop - part.start, 1)) if weights is None else weights(part)
        evaluations += _walk(
            problem, points[part], squares[part], converged[part], fixed[part], scale,
            factor, steps, tolerance, iterations,
        )  # fmt: skip
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
    little = np.zeros(len(points), dtype=np.int64)
    current, failed = problem.residuals(points)
    current = current * root
    squares[:] = np.where(failed, np.inf, np.sum(current**2, axis=1))
    evaluations = len(points)
    for _ in range(iterations):
        fronts = np.flatnonzero(active & np.isfinite(squares))
        if not len(fronts):
            break
        columns, usable = _columns(problem, points[fronts], fixed[fronts], steps)
        weighted = root[fronts if len(root) > 1 else [0]][:, None]
        evaluations += 2 * int(np.count_nonzero(~fixed[fronts]))
        at = points[fronts]
        columns *= weighted
        trials = np.empty((len(fronts), len(_FACTORS), n))
        promised = np.zeros(len(fronts))
        for f in range(len(fronts)):
            gradient = columns[f] @ current[fronts[f]]
            hessian = columns[f] @ columns[f].T
            # A coordinate at its bound whose descent leads out of the cube stays there.
            stuck = ((at[f] <= 0) & (gradient > 0)) | ((at[f] >= 1) & (gradient < 0)) | ~usable[f]
            free = np.flatnonzero(~stuck)
            for k, times in enumerate(_FACTORS):
                trials[f, k] = at[f]
                if len(free):
                    inner = hessian[np.ix_(free, free)]
                    # What the data hardly see must not be thrown across the cube by the noise of its
                    # derivative: a way of half the cube costs the tolerance.
                    damped = damping[fronts[f]] * times * np.diag(inner) + 4 * tolerance
                    step = _inside(inner + np.diag(damped), gradient[free], at[f, free])
                    trials[f, k, free] = at[f, free] + step
                    # Of the last, the most damped one: what the sum of squares should lose.
                    promised[f] = -(2 * gradient[free] @ step + step @ inner @ step)
        values, lost = problem.residuals(trials.reshape(-1, n))
        evaluations += len(values)
        values = values.reshape(len(fronts), len(_FACTORS), -1) * weighted
        reached = np.sum(values**2, axis=2)
        reached[lost.reshape(reached.shape)] = np.inf
        best = np.argmin(reached, axis=1)
        lowest = reached[np.arange(len(fronts)), best]
        for f, front in enumerate(fronts):
            gain = squares[front] - lowest[f]
            if gain > 0:
                points[front], squares[front] = trials[f, best[f]], lowest[f]
                current[front] = values[f, best[f]]
                damping[front] = np.clip(damping[front] * _FACTORS[best[f]], _DAMPING[0], _DAMPING[2])
            else:
                damping[front] = np.clip(damping[front] * 100.0, _DAMPING[0], _DAMPING[2])
            # A step that fails although it promises much was too long: damped more, it is tried again.
            if gain > 0 or promised[f] < tolerance:
                little[front] = little[front] + 1 if gain < tolerance else 0
            if little[front] == 2:
                active[front], converged[front] = False, True
    return evaluations


def _inside(matrix: FloatArray, gradient: FloatArray, at: FloatArray) -> FloatArray:
    """Return the step (k,) that solves ``matrix step = -gradient`` and stays in the cube.

    A coordinate that would leave it goes to its bound, and the others follow: a step that is merely cut
    there leads correlated parameters uphill, and a fit that ends at a bound would seem to have converged.
    """
    step = np.zeros(len(at))
    free = np.ones(len(at), dtype=np.bool_)
    for _ in range(len(at)):
        step[free] = np.linalg.solve(
            matrix[np.ix_(free, free)], -gradient[free] - matrix[np.ix_(free, ~free)] @ step[~free]
        )
        # One at a time, the farthest first: with it at its bound another may stay inside.
        excess = np.where(free, np.maximum(-(at + step), at + step - 1.0), 0.0)
        worst = int(np.argmax(excess))
        if excess[worst] <= 0.0:
            break
        step[worst] = np.clip(at[worst] + step[worst], 0.0, 1.0) - at[worst]
        free[worst] = False
        if not free.any():
            break
    return np.asarray(np.clip(at + step, 0.0, 1.0) - at)


def _columns(
    problem: Problem, at: FloatArray, fixed: BoolArray, steps: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Return central differences (F, n, m) of the residuals, and which coordinates (F, n) have one."""
    n_fronts, n = at.shape
    which = np.flatnonzero(~fixed.ravel())
    pair = []
    widths = np.zeros((n_fronts, n))
    for sign in (1.0, -1.0):
        moved = np.repeat(at[:, None], n, axis=1)
        moved[:, np.arange(n), np.arange(n)] = np.clip(at + sign * steps, 0.0, 1.0)
        widths += sign * moved[:, np.arange(n), np.arange(n)]
        pair.append(moved.reshape(-1, n)[which])
    values, lost = problem.residuals(np.concatenate(pair))
    half = len(which)
    out = np.zeros((n_fronts * n, values.shape[1]))
    usable = np.zeros(n_fronts * n, dtype=np.bool_)
    usable[which] = ~(lost[:half] | lost[half:])
    width = np.maximum(widths.ravel()[which, None], 1e-12)
    out[which] = np.where(usable[which, None], values[:half] - values[half:], 0.0) / width
    return out.reshape(n_fronts, n, -1), usable.reshape(n_fronts, n)


def search_around(
    problem: Problem, start: FloatArray, spread: FloatArray, scale: FloatArray, held: BoolArray, seed: int
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
