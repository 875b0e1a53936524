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

from sysid.parallel import Executor
from sysid.parameters import SearchSpace
from sysid.types import BoolArray, FloatArray

# A channel that fits better than this is not weighted up any further: noise-free samples have no scale [1].
LEAST_NRMSE = 1e-5


@dataclass(frozen=True)
class Block:
    """The samples of one channel of one trial.

    Parameters
    ----------
    trial, channel : int
        Numbers from 0.
    start, stop : int
        Its residuals are ``[start:stop]``, one per compared sample, 0 where a sample does not count.
    count : int
        Samples that count.
    weight : float
        In the mean NRMSE; all blocks sum to 1.
    spread : float
        What NRMSE divides by [unit of the channel].
    noise : float
        NRMSE that measurement noise alone costs [1]; NaN where it is not known.
    """

    trial: int
    channel: int
    start: int
    stop: int
    count: int
    weight: float
    spread: float
    noise: float


class Problem(Protocol):
    """A fit as trust sees it. Equal points give equal residuals whatever their neighbours."""

    @property
    def space(self) -> SearchSpace:
        """The free parameters."""
        ...

    @property
    def trials(self) -> tuple[str, ...]:
        """Names of the fitted trials."""
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
        """Return how one standard deviation of each thing that the fit takes as known moves the residuals (K,
        m).

        Such as a drop's initial state, which noise has moved as well. Independent of each other.
        """
        ...


@dataclass(frozen=True, eq=False)
class ResidualWork:
    """A problem as work for an executor."""

    problem: Problem

    def __call__(self, rows: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the residuals of unit-cube points (P, n_free), and which of them failed."""
        return self.problem.residuals(rows)


class SpreadProblem:
    """A problem whose residuals an executor computes; otherwise itself."""

    def __init__(self, problem: Problem, executor: Executor) -> None:
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
