"""A fit with further terms of its kind: their parameters freed and walked downhill."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sysid.fit.kind import Term
from sysid.fit.least_squares import Fronts, MeanNrmse, descend, drive
from sysid.fit.problem import Problem
from sysid.types import FloatArray

TOLERANCE, _ITERATIONS = 1e-4, 15


def freed(problem: Problem, terms: Sequence[Term]) -> Problem:
    """Return a problem in which the parameters of terms are free as well, behind its own."""
    space = problem.space
    names = [name for term in terms for name in term.parameters]
    rows = [space.table[name] for name in names if name not in space.names]
    return replace(problem, space=space.freeing(rows))  # type: ignore[type-var]


def starting_point(problem: Problem, wider: Problem, values: Mapping[str, float]) -> FloatArray:
    """Return the point (n,) [unit cube] of `wider` at values by name [SI]; what they lack is off.

    `problem` lacks the terms, and says what off is.
    """
    space, known = wider.space, {**problem.space.fixed, **values}
    return np.clip(space.encode(np.array([known[name] for name in space.names])), 0.0, 1.0)


def downhill(problem: Problem, starts: FloatArray, kept: FloatArray | None = None) -> tuple[FloatArray, int]:
    """Walk from starts (F, n) [unit cube] to the least mean NRMSE; return where, and the simulated points.

    `kept` are derivatives by the stated values, see `descend`.
    """
    fronts, known = Fronts.at(np.unique(starts, axis=0)), None
    if kept is not None:
        known = np.full((*fronts.points.shape, kept.shape[1]), np.nan)
        known[:, -len(kept) :] = kept
    walk = descend(
        fronts, MeanNrmse(problem), problem.layout, known=known, central=False, tolerance=TOLERANCE,
        iterations=_ITERATIONS,
    )  # fmt: skip
    evaluations = drive(walk, problem.residuals)
    fronts.sort()
    return fronts.points[0].copy(), evaluations
