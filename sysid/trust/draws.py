"""Joint draws of what a fit leaves open: a distribution over all free parameters, not five copies of one.

A draw is a point of the search's coordinates, made in three steps.

1. Normal numbers with the correlation of `sysid.trust.linearized` (widened where the model does not explain
   the trials), stratified, so that their sample has exactly that correlation.
2. A parameter whose profile leaves an end open is uniform over what the profile leaves open, inside the
   bounds, on the scale on which its effect is even (`_even`). The others follow it along the valley of the
   cost, which its profile has walked, and scatter around the valley as linearized.
3. Every other free parameter is mapped, rank by rank, so that its draws have the ends of its profile's
   intervals: 68 % and 95 % of them lie inside, whatever the shape of the cost.

The true cost enters by the profiles alone, without weights of importance and without a chain, because the
cost is no likelihood: a channel counts by its NRMSE. Over the directions of the closed parameters of the
high-friction samples, the rise of the cost at one standard deviation differs by a factor of 37, so no single
temperature turns the cost into the distribution of the estimates. There is little to correct, either: the
rise of the cost over its quadratic form has the median 1.04 (quartiles 0.97 and 1.27) over 200 draws with the
open parameters at their best values. Open parameters that move without step 2 raise the median cost of a draw
by 2.7; with step 2 they do not change it (1.01).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any
from zlib import crc32

import numpy as np
from scipy.special import ndtr, ndtri

from sysid.parameters import SearchSpace
from sysid.trust.documents import FreeParameter, TrustDocument
from sysid.trust.linearized import CHI2, NORMAL_95
from sysid.types import FloatArray

Scaling = Callable[[Any], FloatArray]

# Number of draws that a fit stores.
STORED = 200
# Seed of the random numbers [1], beside the names of what is drawn: every command draws alike from one fit,
# and a gear and its motor, or an interval alone, independently.
_SEED = 27
# Normal numbers at the ends of the intervals and, by extrapolation, beyond any draw.
_KNOTS = np.array([-NORMAL_95, -np.sqrt(CHI2[0.68]), 0.0, np.sqrt(CHI2[0.68]), NORMAL_95])
_BEYOND = 6.0


def joint_draws(
    space: SearchSpace, document: TrustDocument, arrays: Mapping[str, FloatArray], count: int
) -> FloatArray:
    """Return draws (count, n_free) [unit cube] of a fit, from its document of trust and the arrays of that.

    Of fewer than `STORED` draws, the first ones are returned.
    """
    found, n = document.parameters, len(space.free)
    stated = {row.name: row for row in document.stated}
    deviation = np.sqrt(np.diag(arrays["covariance"]))
    values = [row.refined for row in found] + [stated[name].fitted for name in space.names[len(found) :]]
    centre = np.clip(space.encode(np.array(values)), 0.0, 1.0)
    knots = centre + deviation * _KNOTS[:, None]
    for i, row in enumerate(found):
        rows = np.tile(values, (4, 1))
        rows[:, i] = row.interval_95[0], row.interval_68[0], row.interval_68[1], row.interval_95[1]
        knots[[0, 1, 3, 4], i] = space.encode(rows)[:, i]
    normal = _normal(max(count, STORED), arrays["correlation"], space.names)
    loose = np.array([i < len(found) and any(found[i].open_95) for i in range(n)])
    tied = ~loose
    points = centre + deviation * normal
    if loose.any():
        between = arrays["correlation"][np.ix_(loose, loose)]
        slope = np.linalg.solve(between, arrays["correlation"][np.ix_(loose, tied)])
        points[:, tied] -= deviation[tied] * (normal[:, loose] @ slope)
        for i in np.flatnonzero(loose).tolist():
            walked = arrays[f"profiles/{found[i].name}/others"]
            to, back = _even(found[i])
            low, high = sorted(map(float, to(np.array(found[i].interval_95))))
            level = ndtr(normal[:, i])
            at = low + (level if to(2.0) > to(1.0) else 1.0 - level) * (high - low)
            rows = np.tile(values, (len(points), 1))
            rows[:, i] = back(at)
            points[:, i] = space.encode(rows)[:, i]
            order = np.argsort(to(walked[:, i]), kind="stable")
            along, valley = to(walked[:, i])[order], space.encode(walked)[order]
            for j in np.flatnonzero(tied).tolist():
                points[:, j] += np.interp(at, along, valley[:, j]) - centre[j]
    ranks = np.argsort(np.argsort(points, axis=0, kind="stable"), axis=0)
    level = ndtri((ranks + 0.5) / len(points))
    for j in np.flatnonzero(tied[: len(found)]).tolist():
        ends = (knots[[0, -1], j] - knots[[1, -2], j]) / (_KNOTS[-1] - _KNOTS[-2]) * (_BEYOND - NORMAL_95)
        places = [knots[0, j] + ends[0], *knots[:, j], knots[-1, j] + ends[1]]
        points[:, j] = np.interp(level[:, j], [-_BEYOND, *_KNOTS, _BEYOND], places)
    return np.asarray(np.clip(points[:count], 0.0, 1.0))


def _even(row: FreeParameter) -> tuple[Scaling, Scaling]:
    """Return the scale on which a parameter with open ends is drawn evenly, and the way back.

    That is where its effect is even: a damping that may vanish on its value, a stiffness that may be
    infinite on its inverse, and what is open at both ends on its logarithm.
    """
    at_low, at_high = row.open_95
    if row.interval_95[0] <= 0 or (at_low and not at_high):
        return np.asarray, np.asarray
    return (np.log, np.exp) if at_low else (np.reciprocal, np.reciprocal)


def evenly(intervals: Mapping[str, Sequence[float]], count: int) -> FloatArray:
    """Return independent draws (count, n), uniform over the intervals of n numbers by name."""
    ends = np.array(list(intervals.values()), dtype=np.float64).reshape(-1, 2)
    levels = ndtr(_normal(max(count, STORED), np.eye(len(ends)), intervals)[:count])
    return np.asarray(ends[:, 0] + levels * (ends[:, 1] - ends[:, 0]))


def normally(names: tuple[str, ...], covariance: FloatArray, count: int) -> FloatArray:
    """Return draws (count, n) about zero of n numbers by name with a covariance (n, n)."""
    sizes = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sizes, sizes)
    return np.asarray(_normal(max(count, STORED), correlation, names)[:count] * sizes)


def _normal(count: int, correlation: FloatArray, names: Iterable[str]) -> FloatArray:
    """Return stratified normal numbers (count, n) of n names whose sample has a correlation (n, n)."""
    n = len(correlation)
    grid = ndtri((np.arange(count) + 0.5) / count)
    raw = (
        np.random.default_rng([_SEED, crc32(" ".join(names).encode("utf-8"))])
        .permuted(np.tile(grid, (n, 1)), axis=1)
        .T
    )
    white = np.linalg.solve(np.linalg.cholesky(np.cov(raw.T, ddof=0).reshape(n, n)), raw.T).T
    values, vectors = np.linalg.eigh(correlation)
    return np.asarray(white @ (vectors * np.sqrt(np.maximum(values, 0.0))).T)
