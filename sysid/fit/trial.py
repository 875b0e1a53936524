"""The trials of a problem as they are compared, and what a population of candidates scores on them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sysid.types import BoolArray, FloatArray, IntArray

# The one cause of failure where a problem names none.
UNNAMED_CAUSE = ("simulation failed",)
# A model explains the trials where its NRMSE is at most this multiple of what noise costs [1].
EXPLAINED = 1.2

Failed = BoolArray | NDArray[np.int8]


def name_order(name: str) -> tuple[str, str]:
    """Return the key by which fitted trials are sorted: drop-2 before drop-10.

    A search is chaotic: the last bit of a sum over trials may decide where it ends. So the order in which a
    campaign names its trials must not count. Results are in the campaign's order all the same.
    """
    return re.sub(r"[0-9]+", lambda number: number[0].zfill(9), name), name


@dataclass(frozen=True)
class ComparedChannel:
    """A compared channel and its SI unit."""

    name: str
    unit: str


class Cost:
    """The mean of NRMSE over channels, by weight, then over trials; no number depends on threads."""

    channels: Sequence[ComparedChannel]
    # (C,) weights in the mean over channels [1].
    weights: FloatArray
    # (T, C) divisors of the NRMSE [channel units].
    denominators: FloatArray

    def mean(self, by_channel: FloatArray) -> FloatArray:
        """Return the weighted mean (...) over channels, then over trials, of (..., T, C) NRMSE [1]."""
        used, shares = self._shares
        return np.asarray((by_channel[..., used] * shares).sum(axis=-1).mean(axis=-1))

    @cached_property
    def _shares(self) -> tuple[IntArray, FloatArray]:
        """Channels that count, and their shares in the mean [1]."""
        used = np.flatnonzero(self.weights > 0)
        return used, self.weights[used] / self.weights[used].sum()


@dataclass(frozen=True, eq=False)
class Trial:
    """One prepared trial as it is compared."""

    name: str
    use: Literal["fit", "validate"]
    # (n,) compared instants on the log's clock [s].
    time: FloatArray
    # (n, C) measurement as compared [channel units], and which samples count.
    measured: FloatArray
    valid: BoolArray
    # Log, hash (``sha256``), what was noticed.
    provenance: Mapping[str, Any]
    # Instant from which times are counted: the first touchdown, the window's start [s].
    zero: float
    # Further fields of `TrialResult`: spectrum, thrust, commands.
    shown: Mapping[str, Any] = field(default_factory=dict)

    @property
    def digest(self) -> str:
        """SHA-256 of the log."""
        return str(self.provenance["sha256"])


@dataclass(frozen=True)
class Block:
    """The samples of one channel of one trial, both numbered from 0."""

    trial: int
    channel: int
    # Its residuals are ``[start:stop]``, one per compared sample, 0 where a sample does not count.
    start: int
    stop: int
    # Samples that count.
    count: int
    # Weight in the mean NRMSE [1]; all blocks sum to 1.
    weight: float
    # Divisor of the NRMSE [unit of the channel].
    spread: float
    # NRMSE that measurement noise alone costs [1]; NaN where the noise is not known.
    noise: float


def nrmse_of(blocks: Sequence[Block], residuals: FloatArray) -> FloatArray:
    """Return the NRMSE (..., B) [1] of every block from residuals (..., m); 0 of a block without samples."""
    squares = [np.sum(residuals[..., block.start : block.stop] ** 2, axis=-1) for block in blocks]
    counts = [max(block.count, 1) for block in blocks]
    return np.sqrt(np.stack(squares, axis=-1) / counts)


def noise_floor(blocks: Sequence[Block]) -> float:
    """Return the mean NRMSE that noise alone costs [1]; NaN where the noise of a block is not known."""
    return sum(block.weight * block.noise for block in blocks)


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Correlations of residuals, each block scaled to unit variance.

    `covariance` (C, C, L + 1) pairs channel c at a sample with c' later by the lag [1], for `channels`
    in their order.
    """

    channels: tuple[int, ...]
    covariance: FloatArray

    @property
    def inflation(self) -> FloatArray:
        """(C,) samples of each channel that are worth one independent sample [1]."""
        auto = np.array([self.covariance[c, c] for c in range(len(self.channels))])
        return np.maximum(1.0, (auto[:, 0] + 2 * auto[:, 1:].sum(axis=1)) / np.maximum(auto[:, 0], 1e-300))


@dataclass(frozen=True, eq=False)
class Scores:
    """What a population scores."""

    # (P, T, C) NRMSE [1]; a penalty where the simulation is lost.
    by_channel: FloatArray
    # (P, T) reason of a lost simulation: a number from 1 among the problem's `causes`; 0 where it is not.
    cause: NDArray[np.int8]

    @staticmethod
    def joined(parts: Sequence[Scores]) -> Scores:
        """Return the scores of a population that was scored in parts."""
        by_channel, cause = zip(*((part.by_channel, part.cause) for part in parts), strict=True)
        return Scores(np.concatenate(by_channel), np.concatenate(cause))


@dataclass(frozen=True, eq=False)
class Prediction(Scores):
    """Scores, and the simulated signals as they are compared: (P, n, C) per trial [channel units]."""

    signals: tuple[FloatArray, ...]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Cost of one population."""

    # (P,) NRMSE of each candidate [1]; finite, a failed candidate carries its graded penalty.
    cost: FloatArray
    # Candidates of which at least one simulation failed: True, or the number (from 1) of its cause among the
    # problem's `causes`.
    failed: Failed
    # Simulations that were run (candidates × trials).
    simulations: int


def count_causes(failed: Failed, causes: tuple[str, ...]) -> dict[str, int]:
    """Return how many candidates failed, by cause; causes that did not occur are left out."""
    counts = np.bincount(np.asarray(failed, dtype=np.int64), minlength=len(causes) + 1)
    return {cause: int(count) for cause, count in zip(causes, counts[1:], strict=True) if count}


def first_cause(causes: NDArray[np.int8], count: int) -> NDArray[np.int8] | BoolArray:
    """Return the cause by which a candidate (P,) counts, of its trials' (P, T); of one cause: whether."""
    if count == 1:
        return np.any(causes > 0, axis=1)
    codes = np.where(causes > 0, causes, count + 1).min(axis=1)
    return np.where(codes > count, 0, codes).astype(np.int8)
