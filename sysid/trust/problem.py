"""A fit as residuals, and the least-squares cost whose minimum is that of the mean NRMSE.

The search minimizes ``C = sum_k w_k NRMSE_k`` over blocks k (a channel of a trial; the weights sum to 1).
With residuals ``r`` in units of the channel's own deviation, ``NRMSE_k = sqrt(mean(r_k²))``, and near a point
that scores ``s_k``

    NRMSE_k <= s_k/2 + mean(r_k²)/(2 s_k),

equal there with equal gradient. So the sum of squares of ``rho_ki = r_ki sqrt(w_k/(n_k s_k))`` with the s_k
of the best point held has its minimum where C has. That sum is Gaussian with one noise level s_k per block,
each block weighted by w_k s_k/n_k: it is *not* minus twice a log-likelihood, because blocks are weighted
unlike independent data, neighbouring samples are correlated and rates are derived from positions.
`sysid.trust.linearized` corrects for all three.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sysid.fit.problem import Block
from sysid.parallel import Executor
from sysid.parameters import SearchSpace
from sysid.types import BoolArray, FloatArray

# A channel that fits better than this is not weighted up any further: noise-free samples have no scale [1].
LEAST_NRMSE = 1e-5


class Residuals(Protocol):
    """A `sysid.fit.problem.Problem` as trust sees it. Equal points give equal residuals in any company."""

    @property
    def space(self) -> SearchSpace:
        """The free parameters."""
        ...

    @property
    def trials(self) -> Sequence[object]:
        """The fitted trials."""
        ...

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the compared channels."""
        ...

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Where the residuals of each trial's channels lie; those without weight are left out."""
        ...

    def residuals(self, cube: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return residuals (P, m) in units of each channel's spread [1], and which of the points failed (P,).

        The residuals of a failed point are finite and mean nothing.
        """
        ...

    def disturbances(self, cube: FloatArray) -> FloatArray:
        """Return how one standard deviation of each thing taken as known moves the residuals (K, m)."""
        ...


@dataclass(frozen=True, eq=False)
class ResidualWork:
    """A problem as work for an executor."""

    problem: Residuals

    def __call__(self, rows: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the residuals of unit-cube points (P, n_free), and which of them failed."""
        return self.problem.residuals(rows)


class SpreadProblem:
    """A problem whose residuals an executor computes; otherwise itself."""

    def __init__(self, problem: Residuals, executor: Executor) -> None:
        self._problem = problem
        self._work = executor.share(ResidualWork(problem))
        self.space = problem.space
        self.trials = problem.trials
        self.channels = problem.channels
        self.blocks = problem.blocks

    def residuals(self, cube: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return residuals (P, m) and failures (P,)."""
        values, failed = self._work(np.ascontiguousarray(cube, dtype=np.float64))
        return values, failed

    def disturbances(self, cube: FloatArray) -> FloatArray:
        """Return the residuals' changes (K, m), computed here."""
        return self._problem.disturbances(cube)


def nrmse_of(blocks: Sequence[Block], residuals: FloatArray) -> FloatArray:
    """Return the NRMSE (..., B) of every block."""
    return np.stack(
        [
            np.sqrt(np.sum(residuals[..., block.start : block.stop] ** 2, axis=-1) / block.count)
            for block in blocks
        ],
        axis=-1,
    )


def scales(blocks: Sequence[Block], levels: FloatArray, size: int) -> FloatArray:
    """Return what turns residuals r (m,) into rho, for blocks at NRMSE `levels` (B,)."""
    out = np.zeros(size)
    for block, level in zip(blocks, levels, strict=True):
        out[block.start : block.stop] = np.sqrt(block.weight / (block.count * max(level, LEAST_NRMSE)))
    return out


def trial_rows(blocks: Sequence[Block], weights: FloatArray, size: int) -> FloatArray:
    """Spread weights of trials (..., T) over the residuals (..., m)."""
    out = np.zeros((*weights.shape[:-1], size))
    for block in blocks:
        out[..., block.start : block.stop] = weights[..., block.trial, None]
    return out
