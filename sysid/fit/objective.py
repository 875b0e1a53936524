"""What a search needs to know of a problem: its free parameters, and what a population costs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

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
