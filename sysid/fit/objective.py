"""What a search needs to know of a problem: its free parameters, and what a population costs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sysid.parallel import Executor
from sysid.parameters import SearchSpace
from sysid.types import BoolArray, FloatArray, IntArray

Failed = BoolArray | NDArray[np.int8]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Cost of one population.

    Parameters
    ----------
    cost : (P,) array
        NRMSE of each candidate [1]; finite, a failed candidate carries its graded penalty.
    failed : (P,) bool or int8 array
        Candidates of which at least one simulation failed: True, or the number (from 1) of its cause among
        the objective's `causes`.
    simulations : int
        Simulations that were run (candidates × trials).
    """

    cost: FloatArray
    failed: Failed
    simulations: int


# What a failed candidate counts under where its objective names no causes.
UNNAMED_CAUSE = ("simulation failed",)


def causes_of(objective: object) -> tuple[str, ...]:
    """Return the causes of failure that an objective tells apart."""
    return tuple(getattr(objective, "causes", UNNAMED_CAUSE))


def count_causes(failed: Failed, causes: tuple[str, ...]) -> dict[str, int]:
    """Return how many candidates failed, by cause; causes that did not occur are left out."""
    counts = np.bincount(np.asarray(failed, dtype=np.int64), minlength=len(causes) + 1)
    return {cause: int(count) for cause, count in zip(causes, counts[1:], strict=True) if count}


class Objective(Protocol):
    """A fit problem as the optimiser sees it.

    `evaluate` must be a pure function of the points: equal rows give equal costs whatever their order,
    their neighbours or the number of threads. An objective that tells causes of failure apart names them in
    an attribute `causes`.
    """

    @property
    def space(self) -> SearchSpace:
        """The free parameters."""
        ...

    def evaluate(self, cube: FloatArray) -> Evaluation:
        """Simulate and score unit-cube points (P, n_free)."""
        ...


@dataclass(frozen=True, eq=False)
class Scored:
    """An objective as work for an executor: cost, failure and simulations of every row."""

    objective: Objective

    def __call__(self, rows: FloatArray) -> tuple[FloatArray, Failed, IntArray]:
        """Simulate and score unit-cube points (P, n_free)."""
        scored = self.objective.evaluate(rows)
        each, rest = divmod(scored.simulations, len(rows))
        simulations = np.full(len(rows), each, dtype=np.int64)
        simulations[:rest] += 1
        return scored.cost, scored.failed, simulations


class SpreadObjective:
    """An objective, which travels once, whose candidates an executor computes."""

    def __init__(self, objective: Objective, executor: Executor) -> None:
        self._objective = objective
        self._work = executor.share(Scored(objective))

    @property
    def space(self) -> SearchSpace:
        """The free parameters."""
        return self._objective.space

    @property
    def causes(self) -> tuple[str, ...]:
        """The causes of failure that the objective tells apart."""
        return causes_of(self._objective)

    def evaluate(self, cube: FloatArray) -> Evaluation:
        """Simulate and score unit-cube points (P, n_free)."""
        cost, failed, simulations = self._work(cube)
        return Evaluation(cost, failed, int(simulations.sum()))
