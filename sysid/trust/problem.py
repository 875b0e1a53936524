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
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from sysid.fit.least_squares import LEAST_NRMSE
from sysid.fit.problem import Problem
from sysid.fit.trial import Block
from sysid.parallel import Executor
from sysid.types import FloatArray


def spread_over(problem: Problem, executor: Executor) -> Problem:
    """Return a problem whose residuals an executor computes."""
    spread = copy(problem)
    object.__setattr__(spread, "residuals", executor.share(problem.residuals))
    return spread


def nrmse_of(blocks: Sequence[Block], residuals: FloatArray) -> FloatArray:
    """Return the NRMSE (..., B) [1] of every block from residuals (..., m)."""
    return np.stack(
        [
            np.sqrt(np.sum(residuals[..., block.start : block.stop] ** 2, axis=-1) / block.count)
            for block in blocks
        ],
        axis=-1,
    )


def scales(blocks: Sequence[Block], levels: FloatArray, size: int) -> FloatArray:
    """Return what turns residuals r (m,) into rho, for blocks at NRMSE `levels` (B,) [1]."""
    out = np.zeros(size)
    for block, level in zip(blocks, levels, strict=True):
        out[block.start : block.stop] = np.sqrt(block.weight / (block.count * max(level, LEAST_NRMSE)))
    return out


def trial_rows(blocks: Sequence[Block], weights: FloatArray, size: int) -> FloatArray:
    """Spread weights of trials (..., T) [1] over the residuals (..., m)."""
    out = np.zeros((*weights.shape[:-1], size))
    for block in blocks:
        out[..., block.start : block.stop] = weights[..., block.trial, None]
    return out
