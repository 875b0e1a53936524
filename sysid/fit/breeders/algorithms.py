"""Every search algorithm behind one adapter: pymoo's, and cma's evolution strategy.

A `Breeder` says which candidates to score next and takes their costs; nothing of the libraries' own stop
rules, histories or evaluation budgets takes part. Its candidates are a pure function of seed and costs, so a
run that was cut off continues exactly where it was once it is given the stored costs.

CMA-ES maps whole generations into the cube (`evolution_strategy`); the others go through pymoo's objects.
"""

from typing import Any

import numpy as np

from sysid.errors import FitError
from sysid.fit.breeders.breeder import RANDOM_SPREAD, Breeder, Start
from sysid.search_options import ALGORITHMS
from sysid.types import FloatArray

# Pymoo's names for the values of a scored individual.
_SCORED = ("F", "G", "H")


class PymooBreeder(Breeder):
    """One of pymoo's algorithms, seeded and not yet set up, as ask and tell over the unit cube."""

    def __init__(self, algorithm: Any, n_free: int) -> None:
        from pymoo.core.problem import Problem
        from pymoo.core.termination import NoTermination

        self._problem = Problem(n_var=n_free, n_obj=1, xl=np.zeros(n_free), xu=np.ones(n_free))
        self._algorithm = algorithm
        algorithm.setup(self._problem, termination=NoTermination(), verbose=False)
        self._asked: Any = None

    def ask(self) -> FloatArray | None:
        """Return the candidates (P, n_free) to score next, or None when no new one can be bred."""
        if not self._algorithm.has_next():
            return None
        self._asked = self._algorithm.ask()
        if self._asked is None or len(self._asked) == 0:
            return None
        return np.asarray(self._asked.get("X"), dtype=np.float64)

    def tell(self, cost: FloatArray, residuals: FloatArray | None = None) -> None:
        # pymoo's evaluator would ask every individual several times for constraints that there are not.
        for individual, value in zip(self._asked, cost, strict=True):
            individual.F = np.array([value])
            individual.evaluated.update(_SCORED)
        self._algorithm.tell(infills=self._asked)

    def population(self) -> tuple[FloatArray, FloatArray]:
        population = self._algorithm.pop
        cost = np.array([individual.F[0] for individual in population], dtype=np.float64)
        order = np.argsort(cost, kind="stable")
        return np.array([population[i].X for i in order], dtype=np.float64), cost[order]


def breeder(name: str, n_free: int, population: int, seed: int, start: Start | None = None) -> Breeder:
    """Return a seeded breeder by name; FitError for an unknown one.

    ``ga`` is pymoo's GA (tournament selection, simulated binary crossover, polynomial mutation), ``de`` its
    differential evolution best/1/bin, ``pso`` its adaptive particle swarm; ``matlab-ga`` is
    `sysid.fit.breeders.matlab_genetic`, and ``cmaes`` cma's CMA-ES, which begins at `start`. Without it, and
    with other algorithms, a search begins anywhere.
    """
    if name not in ALGORITHMS:
        raise FitError(f"unknown algorithm {name!r}; expected one of {', '.join(ALGORITHMS)}")
    # pymoo takes long to import: commands that do not fit must not pay for it.
    from pymoo.config import Config

    # It would print a hint about its own compiled modules, which breeding does not use.
    Config.warnings["not_compiled"] = False
    if name == "cmaes":
        from sysid.fit.breeders.evolution_strategy import EvolutionStrategy

        random = np.random.default_rng(seed)
        if start is None:
            start = Start(random.random(n_free), np.full(n_free, RANDOM_SPREAD))
        return EvolutionStrategy(start, population, random)
    if name == "ga":
        from pymoo.algorithms.soo.nonconvex.ga import GA
        from pymoo.operators.crossover.sbx import SBX
        from pymoo.operators.mutation.pm import PM

        # pymoo's defaults, which all its instances would share.
        return PymooBreeder(GA(population, crossover=SBX(), mutation=PM(), seed=seed), n_free)
    if name == "matlab-ga":
        from sysid.fit.breeders.matlab_genetic import MatlabGA

        return PymooBreeder(MatlabGA(population, seed=seed), n_free)
    from pymoo.algorithms.soo.nonconvex.de import DE
    from pymoo.algorithms.soo.nonconvex.pso import PSO
    from pymoo.operators.sampling.lhs import LHS

    options = {"pop_size": population, "sampling": LHS(), "seed": seed}
    algorithm = DE(variant="DE/best/1/bin", **options) if name == "de" else PSO(**options)
    return PymooBreeder(algorithm, n_free)
