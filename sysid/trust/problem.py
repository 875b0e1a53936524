"""A fit as residuals, and the least-squares cost which is least where the mean NRMSE is.

The search minimizes ``C = sum_k w_k NRMSE_k`` over blocks k (a channel of a trial; the weights sum to 1).
With residuals ``r`` in units of the channel's own deviation, ``NRMSE_k = sqrt(mean(r_k²))``, and near a point
that scores ``s_k``

    NRMSE_k <= s_k/2 + mean(r_k²)/(2 s_k),

equal there with equal gradient. So the sum of squares of ``rho_ki = r_ki sqrt(w_k/(n_k s_k))`` with the s_k
of the best point kept constant has its minimum where C has. That sum is Gaussian with one noise level s_k
per block, each block weighted by w_k s_k/n_k: it is *not* minus twice a log-likelihood, because blocks are
weighted unlike independent data, neighbouring samples are correlated and rates are derived from positions.
`sysid.trust.linearized` corrects for all three.

Derivatives are central differences whose step is checked by halving it. Contact makes the cost rough: a foot
that touches a sample earlier, or slips where it stuck, makes residuals jump. A derivative that changes with
the step describes the step, not the model; such parameters are named.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.errors import FitError
from sysid.fit.derivatives import displaced
from sysid.fit.least_squares import LEAST_NRMSE
from sysid.fit.problem import Problem
from sysid.fit.trial import Block, nrmse_of
from sysid.types import BoolArray, FloatArray

# Displacement of a difference quotient, over the distance at which the cost rises by one deviation [1].
_SHARE = 2.0
# Largest relative change of a derivative when its step is halved with which the derivative is trusted [1].
TRUSTED = 0.1


def scales(problem: Problem, blocks: Sequence[Block], levels: FloatArray) -> FloatArray:
    """Return what turns residuals r (m,) into rho, for blocks at NRMSE `levels` (B,) [1].

    With N independent samples a distance of one standard error from a stated value weighs as much as one.
    """
    stop = blocks[-1].stop
    out = np.zeros(stop + len(problem.space.stated))
    if problem.space.stated:
        weights = np.array([block.weight for block in blocks])
        out[stop:] = np.sqrt(weights @ np.maximum(levels, LEAST_NRMSE) / problem.independent)
    for block, level in zip(blocks, levels, strict=True):
        # A block of unknown noise (NaN) weighs nothing.
        scale = np.sqrt(block.weight / (block.count * max(level, LEAST_NRMSE)))
        out[block.start : block.stop] = np.nan_to_num(scale)
    return out


def trial_rows(blocks: Sequence[Block], weights: FloatArray, size: int) -> FloatArray:
    """Spread weights of trials (..., T) [1] over the residuals (..., m); stated values have weight 1."""
    out = np.ones((*weights.shape[:-1], size))
    for block in blocks:
        out[..., block.start : block.stop] = weights[..., block.trial, None]
    return out


@dataclass(frozen=True, eq=False)
class Jacobian:
    """Derivatives of weighted residuals at one point.

    `values` (m, n) are extrapolated to step 0 (Richardson) where both steps agree [1/unit cube]. The cost
    rises by about `rise` along the larger ones [1]. `doubt` (n,) is the change of the derivative when the
    step is halved [1].
    """

    values: FloatArray
    rise: float
    doubt: FloatArray

    @property
    def trusted(self) -> BoolArray:
        """(n,) True where halving the step changes the derivative by less than a tenth."""
        return np.asarray(self.doubt < TRUSTED, dtype=np.bool_)


def jacobian(
    problem: Problem, point: FloatArray, scale: FloatArray, noise: float = 1.0, kept: FloatArray | None = None
) -> Jacobian:
    """Return the derivatives at a point (n,) of the unit cube, ``J = (4 J(h/2) - J(h))/3``.

    `scale` (m,) weights the residuals, see `scales`. The steps follow from `noise`, the standard deviation
    of a weighted residual [1]: smaller differences are lost in the integration's error. They go along the
    principal axes of the curvature, see `sysid.fit.derivatives`. `kept` (S, m) are the derivatives of the
    residuals by the stated values, where they are known.
    """
    rise = (_SHARE * noise) ** 2
    first = _differences(problem, point, scale, np.zeros((len(point), len(point))), rise, kept)
    coarse = _differences(problem, point, scale, first.T @ first, rise, kept)
    curvature = coarse.T @ coarse
    coarse, fine = (_differences(problem, point, scale, curvature, rise, kept, share) for share in (1.0, 0.5))
    # The error of a central difference goes with h²: halving the step takes three quarters of it away.
    doubt = np.linalg.norm(fine - coarse, axis=0) / np.maximum(np.linalg.norm(fine, axis=0), 1e-30)
    return Jacobian(np.where(doubt < 3 * TRUSTED, (4 * fine - coarse) / 3, fine), rise, doubt)


def derivatives(problem: Problem, point: FloatArray, kept: FloatArray | None = None) -> FloatArray:
    """Return the derivatives (n, m) of the residuals at a point (n,); `kept` as for `jacobian`."""
    blocks = problem.blocks
    levels = nrmse_of(blocks, problem.residuals(point[None])[0][0])
    scale = scales(problem, blocks, levels)
    sample = np.sqrt(sum(b.weight for b in blocks) * levels.mean() / sum(b.count for b in blocks))
    columns = jacobian(problem, point, scale, float(sample), kept).values.T
    return np.asarray(columns / np.where(scale > 0, scale, 1.0))


def _differences(
    problem: Problem,
    point: FloatArray,
    scale: FloatArray,
    curvature: FloatArray,
    rise: float,
    kept: FloatArray | None,
    share: float = 1.0,
) -> FloatArray:
    """Return central differences (m, n) of the weighted residuals; one-sided at the cube's faces."""
    n = len(point)
    every = np.ones(n, dtype=np.bool_)
    known = np.zeros((n, len(scale)))
    asked = every.copy()
    if kept is not None:
        asked[n - len(kept) :] = False
        known[n - len(kept) :] = kept
    moves = displaced(
        point, curvature, problem.layout, asked=asked, still=~every, rise=rise, central=True, share=share
    )
    values, failed = problem.residuals(np.concatenate([point[None], moves.points]))
    if failed[0]:
        causes = problem.score(problem.space.full(point[None])).cause[0]
        lost = [
            f"{problem.names[t]} ({problem.causes[c - 1].replace('_', ' ')})"
            for t, c in enumerate(causes)
            if c
        ]
        where = f"{', '.join(lost)}: cannot be simulated at the values that are judged"
        raise FitError(f"{where}; {problem.lost_advice}")
    columns, _ = moves.columns(values[0], values[1:], failed[1:], known)
    return (columns * scale).T
