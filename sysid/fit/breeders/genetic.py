"""pymoo's genetic algorithm on whole arrays.

pymoo keeps an object per individual and asks each for its values many times a generation, which costs more
than a motor's simulation. Here its operators (tournament, simulated binary crossover, polynomial mutation,
survival of the fittest) work on arrays and draw in pymoo's order: the candidates are, bit for bit, those of
`pymoo.algorithms.soo.nonconvex.ga.GA` with its defaults.
"""

from __future__ import annotations

from math import ceil
from typing import Any

import numpy as np
from pymoo.core.problem import Problem
from pymoo.operators.crossover.sbx import SBX
from pymoo.operators.mutation.pm import PM
from pymoo.operators.sampling.rnd import FloatRandomSampling
from pymoo.util.misc import random_permutations

from sysid.fit.breeders.breeder import ArrayBreeder
from sysid.types import FloatArray, IntArray

# pymoo's: matings that may be tried before a generation is left with fewer children.
_MATINGS = 100


class GeneticBreeder(ArrayBreeder):
    """pymoo's GA as ask and tell over the unit cube."""

    def __init__(self, n_free: int, population: int, seed: int) -> None:
        self._problem = Problem(n_var=n_free, n_obj=1, xl=np.zeros(n_free), xu=np.ones(n_free))
        self._random = np.random.default_rng(seed)
        self._size = population
        self._crossover, self._mutation = SBX(), PM()
        self._asked = np.empty((0, n_free))
        self._points = np.empty((0, n_free))
        self._cost = np.empty(0)

    def ask(self) -> FloatArray | None:
        """Return the candidates (P, n_free) to score next, or None when no new one can be bred."""
        if not len(self._points):
            first = FloatRandomSampling()._do(self._problem, self._size, random_state=self._random)
            self._asked = np.asarray(first, dtype=np.float64)
        else:
            self._asked = self._children()
        return self._asked if len(self._asked) else None

    def tell(self, cost: FloatArray) -> None:
        """Take the costs (P,) of the candidates last asked for."""
        if not len(self._points):
            # As pymoo does, which sorts no first generation.
            self._points, self._cost = self._asked, np.array(cost, dtype=np.float64)
            return
        points, costs = np.vstack([self._points, self._asked]), np.concatenate([self._cost, cost])
        best = np.lexsort([costs])[: self._size]
        self._points, self._cost = points[best], costs[best]

    def _children(self) -> FloatArray:
        children: list[FloatArray] = []
        known = {point.tobytes() for point in self._points}
        for _ in range(_MATINGS):
            bred = self._mated(self._size - len(children))
            # A child must differ from all who live and from its elder siblings.
            fresh = []
            for point in bred:
                key = point.tobytes()
                if key not in known:
                    known.add(key)
                    fresh.append(point)
            children.extend(fresh[: self._size - len(children)])
            if len(children) == self._size:
                break
        return np.array(children, dtype=np.float64).reshape(len(children), self._points.shape[1])

    def _mated(self, count: int) -> FloatArray:
        matings = ceil(count / self._crossover.n_offsprings)
        parents = self._points[self._parents(matings)]
        crossed = self._crossed(np.swapaxes(parents, 0, 1))
        mutated = self._mutation._do(self._problem, crossed, random_state=self._random)
        moved = self._random.random(len(crossed)) <= self._mutation.prob.get()
        return np.where(moved[:, None], mutated, crossed)

    def _parents(self, matings: int) -> IntArray:
        """Return the winners (matings, 2) of tournaments between two."""
        needed = 2 * matings * self._crossover.n_parents
        rounds = ceil(needed / len(self._points))
        drawn: Any = random_permutations(rounds, len(self._points), random_state=self._random)
        pairs = np.reshape(drawn[:needed], (-1, 2))
        first, second = self._cost[pairs[:, 0]], self._cost[pairs[:, 1]]
        winners = np.where(second < first, pairs[:, 1], pairs[:, 0])
        for tied in np.flatnonzero(first == second):
            winners[tied] = self._random.choice(pairs[tied])
        return winners.reshape(matings, self._crossover.n_parents)

    def _crossed(self, parents: FloatArray) -> FloatArray:
        """Return both children of every pair (2, matings, n_free) as rows; some pairs go on unchanged."""
        mates = self._random.random(parents.shape[1]) < self._crossover.prob.get()
        children = parents.copy()
        if np.any(mates):
            bred = self._crossover._do(self._problem, parents, random_state=self._random)
            children[:, mates] = bred[:, mates]
        return children.reshape(-1, parents.shape[2])
