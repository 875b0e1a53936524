"""MATLAB's ``ga`` with its documented defaults, as a pymoo algorithm: for fidelity to the paper.

Per generation of P individuals: ``ceil(0.05 P)`` elites survive unchanged; of the others 80 % come from
scattered crossover (each gene from either parent by a coin) and the rest from Gaussian mutation, whose
standard deviation shrinks linearly from the cube's edge to 0 over the generation limit (100 per free
parameter) and whose children are clipped to the bounds. Parents are drawn by stochastic uniform selection
on fitness scaled as ``1/sqrt(rank)``.
"""

from typing import Any

import numpy as np
from pymoo.core.algorithm import Algorithm
from pymoo.core.initialization import Initialization
from pymoo.core.population import Population
from pymoo.operators.sampling.rnd import FloatRandomSampling

ELITE_SHARE = 0.05
CROSSOVER_SHARE = 0.8
GENERATIONS_PER_PARAMETER = 100


class MatlabGA(Algorithm):
    """MATLAB's ``ga``; elites are not scored again."""

    def __init__(self, pop_size: int, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.pop_size = pop_size
        self.elites = int(np.ceil(ELITE_SHARE * pop_size))
        self.crossed = round(CROSSOVER_SHARE * (pop_size - self.elites))
        self.mutated = pop_size - self.elites - self.crossed
        self.initialization = Initialization(FloatRandomSampling())

    def _initialize_infill(self) -> Any:
        return self.initialization.do(
            self.problem, self.pop_size, algorithm=self, random_state=self.random_state
        )

    def _infill(self) -> Any:
        random = self.random_state
        points = self._ranked().get("X")
        parents = points[self._parents(2 * self.crossed + self.mutated)]
        first, second = parents[: self.crossed], parents[self.crossed : 2 * self.crossed]
        crossed = np.where(random.random(first.shape) < 0.5, first, second)
        limit = GENERATIONS_PER_PARAMETER * points.shape[1]
        scale = max(0.0, 1.0 - self.n_iter / limit)
        moved = parents[2 * self.crossed :]
        mutated = np.clip(moved + scale * random.standard_normal(moved.shape), 0.0, 1.0)
        return Population.new("X", np.vstack([crossed, mutated]))

    def _parents(self, count: int) -> Any:
        """Return ranks (from 0) of `count` parents: equal steps along a line of scaled fitness, shuffled."""
        share = 1.0 / np.sqrt(np.arange(1, self.pop_size + 1))
        edges = np.cumsum(share / share.sum())
        steps = (np.arange(count) + self.random_state.random()) / count
        chosen = np.minimum(np.searchsorted(edges, steps, side="right"), self.pop_size - 1)
        return self.random_state.permutation(chosen)

    def _ranked(self) -> Any:
        return self.pop[np.argsort(self.pop.get("F")[:, 0], kind="stable")]

    def _advance(self, infills: Any = None, **kwargs: Any) -> None:
        self.pop = Population.merge(self._ranked()[: self.elites], infills)
