"""How a fit searches, and when a search ends: the paper's rule in both readings, and budgets.

"Stop after the NRMSE change over 4 generations was less than 0.01 %" can be read in two ways; with ``f``
the best cost of a generation, ``w`` the window of 4 generations and ``ε`` = 1e-4:

* ``relative``: ``|f[g − w] − f[g]| / |f[g]| < ε``;
* ``matlab`` (what MATLAB's ``ga`` computes): ``|f[g − w] − f[g]| / (w · max(1, |f[g]|)) < ε``, which is
  absolute for an NRMSE below 1.

Both are first tested at generation ``w + 1`` and both stop too early on some seeds, which is why a fit is
several runs. The rule is a pure function of what happened; `sysid.fit.search` asks it after every generation.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from sysid.errors import FitError
from sysid.fit.breeders.algorithms import ALGORITHMS, DEFAULT_ALGORITHM, POPULATION
from sysid.fit.stopping import StopReason

Reading = Literal["relative", "matlab"]
FINISHERS = ("least-squares", "cmaes", "none")
# Chosen by tests/benchmarks/engine.py.
DEFAULT_FINISH = "least-squares"


@dataclass(frozen=True)
class StopRule:
    """When a run ends, whichever comes first.

    Parameters
    ----------
    reading : {"relative", "matlab"}
        How "NRMSE change over 4 generations" is computed.
    window : int
        Generations over which the change is taken [1].
    tolerance : float
        Change below which the run has converged [1]; 0 never converges.
    spread : float
        Half of a generation must lie within this share of its best, too [1]; any spread by default. A search
        that has not found its valley yet stands still as one that has reached the bottom does. Three windows
        without a change end it anyhow.
    max_generations : int
        Generation limit [1].
    max_evaluations : int or None
        Candidates that may be scored [1]; a generation that would exceed it is not begun (the first always
        is).
    time_limit : float or None
        Wall time [s], looked at after each generation.
    """

    reading: Reading = "relative"
    window: int = 4
    tolerance: float = 1e-4
    spread: float = math.inf
    max_generations: int = 1000
    max_evaluations: int | None = None
    time_limit: float | None = None

    def __post_init__(self) -> None:
        if self.reading not in ("relative", "matlab"):
            raise FitError(f"unknown stop rule {self.reading!r}; expected 'relative' or 'matlab'")
        if self.window < 1 or self.max_generations < 1:
            raise FitError(
                f"stop rule: window {self.window} and generation limit {self.max_generations} "
                "must be at least 1"
            )
        if not (self.tolerance >= 0 and self.spread >= 0):
            raise FitError(
                f"stop rule: tolerance {self.tolerance:g} and spread {self.spread:g} must be 0 or above"
            )

    def change(self, best: Sequence[float], windows: int = 1) -> float:
        """Return the change of the best costs over the last `windows` windows [1]; inf while too few."""
        window = windows * self.window
        if len(best) <= window:
            return float("inf")
        first, last = best[-1 - window], best[-1]
        if first == last:
            return 0.0
        if self.reading == "matlab":
            return abs(first - last) / (window * max(1.0, abs(last)))
        return abs(first - last) / abs(last) if last != 0 else float("inf")

    def reason(
        self,
        best: Sequence[float],
        evaluations: int,
        next_evaluations: int,
        elapsed: float,
        spread: float = 0.0,
    ) -> StopReason | None:
        """Return why the run ends after this generation, or None.

        Parameters
        ----------
        best : sequence of float
            Best cost of every generation so far [1].
        evaluations, next_evaluations : int
            Candidates scored so far, and those that another generation would score [1].
        elapsed : float
            Wall time of the run [s].
        spread : float
            How far the median of the last generation lies above its best, as a share of that [1].
        """
        if self.change(best) < self.tolerance and (
            spread <= self.spread or self.change(best, 3) < self.tolerance
        ):
            return "converged"
        if len(best) >= self.max_generations:
            return "generations"
        if self.max_evaluations is not None and evaluations + next_evaluations > self.max_evaluations:
            return "evaluations"
        if self.time_limit is not None and elapsed >= self.time_limit:
            return "time"
        return None

    def share(self, runs: int) -> StopRule:
        """Return the rule of one of `runs` runs: an equal, fixed share of the evaluation budget."""
        if self.max_evaluations is None:
            return self
        return replace(self, max_evaluations=self.max_evaluations // runs)


@dataclass(frozen=True)
class SearchSettings:
    """How a fit searches.

    Parameters
    ----------
    population : int
        Individuals per generation of the first stage [1]; the paper uses 200 (motor) and 400 to 800 (gear).
    runs : int
        Independent runs [1]; the paper uses 5.
    seed : int
        Seed of the fit; every run draws from another child of it.
    stop : StopRule
        When the first stage ends. `time_limit` and `max_evaluations` count for the whole fit,
        `max_generations` for every stage.
    algorithm : str
        A key of `sysid.fit.breeders.algorithms.ALGORITHMS`.
    finish : {"least-squares", "cmaes", "none"}
        Least squares from the best of a few generations, then CMA-ES along the axes of the cost's curvature,
        because the cost is too rough for derivatives to find the last digits; where more is left than noise,
        the whole search and CMA-ES follow instead. CMA-ES from mean and spread of each run's last generation.
        ``none`` is the paper's method.
    first_generations : int, optional
        Of the first stage at most, and CMA-ES after it is a small one; by default the stop rule says it, and
        before least squares there are three.
    """

    population: int = POPULATION[DEFAULT_ALGORITHM]
    runs: int = 5
    seed: int = 1
    stop: StopRule = field(default_factory=StopRule)
    algorithm: str = DEFAULT_ALGORITHM
    finish: str = DEFAULT_FINISH
    first_generations: int | None = None

    def __post_init__(self) -> None:
        if self.population < 4 or self.runs < 1 or self.seed < 0:
            raise FitError(
                f"population {self.population}, runs {self.runs}, seed {self.seed}: expected a population "
                "of at least 4, at least 1 run and a seed of at least 0"
            )
        if self.algorithm not in ALGORITHMS:
            raise FitError(f"unknown algorithm {self.algorithm!r}; expected one of {', '.join(ALGORITHMS)}")
        if self.finish not in FINISHERS:
            raise FitError(f"unknown finisher {self.finish!r}; expected one of {', '.join(FINISHERS)}")

    def run_seeds(self) -> tuple[int, ...]:
        """Return the seed of every run; more runs keep the first ones."""
        children = np.random.SeedSequence(self.seed).spawn(self.runs)
        return tuple(int(child.generate_state(1, np.uint32)[0]) for child in children)

    @property
    def stages(self) -> tuple[str, ...]:
        """Algorithms of a run, in order; CMA-ES needs no finisher, and more follows least squares."""
        if self.finish == "none" or self.algorithm == "cmaes":
            return (self.algorithm,)
        return (self.algorithm, self.finish)
