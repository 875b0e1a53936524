"""Many small least-squares fits at once: each is a front, and one population has the candidates of all.

The fronts (points of profiles, resampled trials) walk as `sysid.fit.least_squares` says. A front whose cost
is too rough for derivatives is handed to CMA-ES around its point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.fit.breeders.algorithms import breeder
from sysid.fit.breeders.breeder import Start
from sysid.fit.least_squares import Fronts, descend, drive
from sysid.fit.problem import Problem
from sysid.types import BoolArray, FloatArray, IntArray

# Largest memory of the residuals at once [bytes].
_MEMORY = 256e6
# Population and generations of CMA-ES around a front.
_POPULATION, _GENERATIONS = 12, 16


@dataclass(frozen=True, eq=False)
class Solved:
    """Where the F fronts ended."""

    points: FloatArray  # (F, n) [unit cube]
    squares: FloatArray  # (F,) sums of squares of the weighted residuals
    converged: BoolArray  # (F,) False where the last step still took more off than the tolerance
    evaluations: int  # points that were simulated

    def walked_on(self, fronts: IntArray, more: Solved) -> Solved:
        """Put in place where some fronts ended after they had walked on, and count what that took."""
        for name in ("points", "squares", "converged"):
            getattr(self, name)[fronts] = getattr(more, name)
        return replace(self, evaluations=self.evaluations + more.evaluations)


def solve(
    problem: Problem,
    starts: FloatArray,
    scale: FloatArray,
    *,
    rise: float,
    curvature: FloatArray | None = None,
    fixed: BoolArray | None = None,
    known: FloatArray | None = None,
    weights: Callable[[slice], FloatArray] | None = None,
    tolerance: float = 1e-3,
    iterations: int = 12,
) -> Solved:
    """Minimize the sum of squares of residuals times `scale` (m,) from `starts` (F, n) [unit cube].

    `rise` and `fixed` (F, n) as for `descend`; `curvature` (n, n) of the sum at the starts and derivatives of
    the residuals, (n, m) there or (F, n, m) of each front, which the walk corrects, if they are `known`.
    `weights` returns, for a slice of the fronts, further factors (F', m) on the squares of residuals. A front
    has converged when a step takes less than the `tolerance` off its sum of squares.
    """
    n_fronts, n = starts.shape
    if fixed is None:
        fixed = np.zeros(starts.shape, dtype=np.bool_)
    share = max(1, int(_MEMORY / (8 * len(scale) * (4 * n + 4))))
    ended, evaluations = Fronts.at(starts, curvature), 0
    for first in range(0, n_fronts, share):
        part = slice(first, min(first + share, n_fronts))
        factor = np.ones((part.stop - part.start, 1)) if weights is None else weights(part)
        own = known
        if known is not None:
            own = known[part] if known.ndim == 3 else np.repeat(known[None], part.stop - part.start, axis=0)
        walk = descend(
            ended.part(part), _Squares(np.sqrt(factor) * scale), problem.layout, rise=rise,
            fixed=fixed[part], known=own, tolerance=tolerance, iterations=iterations,
        )  # fmt: skip
        evaluations += drive(walk, problem.residuals)
    return Solved(ended.points, ended.cost, ended.converged, evaluations)


@dataclass(frozen=True, eq=False)
class _Squares:
    """The weighted sum of squares; `root` (F or 1, m) multiplies the residuals."""

    root: FloatArray

    def cost(self, fronts: Any, residuals: FloatArray) -> FloatArray:
        root = self.root[fronts] if len(self.root) > 1 else self.root
        root = root.reshape(len(root), *[1] * (residuals.ndim - 2), -1)
        return np.asarray(np.sum((residuals * root) ** 2, axis=-1))

    def scale(self, front: int, residuals: FloatArray) -> FloatArray:
        return self.root[front if len(self.root) > 1 else 0]


def search_around(
    problem: Problem, start: FloatArray, spread: FloatArray, scale: FloatArray, fixed: BoolArray, seed: int
) -> tuple[FloatArray, float, int]:
    """Look for a lower sum of squares around a point with a small CMA-ES: rough costs have no derivatives.

    Returns the best point (n,), its sum of squares, and how many points were simulated.
    """
    free = np.flatnonzero(~fixed)
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
