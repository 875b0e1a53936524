"""What a search needs to know of a problem: its free parameters, and what a population costs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sysid.executor import Executor
from sysid.parameters import SearchSpace


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Cost of one population.

    Parameters
    ----------
    cost : (P,) array
        NRMSE of each candidate [1]; finite, a failed candidate carries its graded penalty.
    failed : (P,) bool array
        Candidates of which at least one simulation failed.
    simulations : int
        Simulations that were run (candidates × trials).
    """

    cost: NDArray[np.float64]
    failed: NDArray[np.bool_]
    simulations: int


class Objective(Protocol):
    """A fit problem as the optimiser sees it.

    `evaluate` must be a pure function of the points: equal rows give equal costs whatever their order,
    their neighbours or the number of threads.
    """

    @property
    def space(self) -> SearchSpace:
        """The free parameters."""
        ...

    def evaluate(self, cube: NDArray[np.float64]) -> Evaluation:
        """Simulate and score unit-cube points (P, n_free)."""
        ...


@dataclass(frozen=True, eq=False)
class Scored:
    """An objective as work for an executor: cost, failure and simulations of every row."""

    objective: Objective

    def __call__(
        self, rows: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.int64]]:
        """Simulate and score unit-cube points (P, n_free)."""
        scored = self.objective.evaluate(rows)
        each, rest = divmod(scored.simulations, len(rows))
        simulations = np.full(len(rows), each, dtype=np.int64)
        simulations[:rest] += 1
        return scored.cost, scored.failed, simulations


class SpreadObjective:
    """An objective whose candidates an executor computes.

    Parameters
    ----------
    objective : Objective
        What is computed; it travels once.
    executor : Executor
        Where.
    """

    def __init__(self, objective: Objective, executor: Executor) -> None:
        self._objective = objective
        self._work = executor.share(Scored(objective))

    @property
    def space(self) -> SearchSpace:
        """The free parameters."""
        return self._objective.space

    def evaluate(self, cube: NDArray[np.float64]) -> Evaluation:
        """Simulate and score unit-cube points (P, n_free)."""
        cost, failed, simulations = self._work(cube)
        return Evaluation(cost, failed, int(simulations.sum()))
