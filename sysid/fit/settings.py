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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import get_args

from sysid.errors import FitError
from sysid.fit.stopping import StopReason
from sysid.search_options import ALGORITHMS, POPULATION, Finisher, Reading, SearchOptions


@dataclass(frozen=True)
class SearchSettings(SearchOptions):
    """How a fit searches, and when a stage of it ends."""

    def __post_init__(self) -> None:
        if self.algorithm not in ALGORITHMS:
            raise FitError(f"unknown algorithm {self.algorithm!r}; expected one of {', '.join(ALGORITHMS)}")
        if self.finish not in get_args(Finisher):
            expected = ", ".join(get_args(Finisher))
            raise FitError(f"unknown finisher {self.finish!r}; expected one of {expected}")
        if not self.population:
            object.__setattr__(self, "population", POPULATION[self.algorithm])
        if self.population < 4 or self.runs < 1 or self.seed < 0:
            raise FitError(
                f"population {self.population}, runs {self.runs}, seed {self.seed}: expected a population "
                "of at least 4, at least 1 run and a seed of at least 0"
            )
        if self.stop_reading not in get_args(Reading):
            raise FitError(f"unknown stop rule {self.stop_reading!r}; expected 'relative' or 'matlab'")
        if self.stop_window < 1 or self.max_generations < 1:
            raise FitError(
                f"stop rule: window {self.stop_window} and generation limit {self.max_generations} "
                "must be at least 1"
            )
        if not self.stop_tolerance >= 0:
            raise FitError(f"stop rule: tolerance {self.stop_tolerance:g} must be 0 or above")

    @property
    def stages(self) -> tuple[str, ...]:
        """Algorithms of a run, in order; CMA-ES needs no finisher, and more follows least squares."""
        if self.finish == "none" or self.algorithm == "cmaes":
            return (self.algorithm,)
        return (self.algorithm, self.finish)

    def of_a_run(self) -> SearchSettings:
        """Return the settings with one run's equal, fixed share of the evaluation budget."""
        if self.max_evaluations is None:
            return self
        return replace(self, max_evaluations=self.max_evaluations // self.runs)

    def continued_by(self) -> dict[str, object]:
        """Return the options that must be equal for a fit to be continued: not its runs or its time limit."""
        equal = {**vars(self.of_a_run())}
        del equal["runs"], equal["time_limit"]
        equal["max_evaluations_of_a_run"] = equal.pop("max_evaluations")
        return equal

    def change(self, best: Sequence[float], windows: int = 1) -> float:
        """Return the change of the best costs over the last `windows` windows [1]; inf while too few."""
        window = windows * self.stop_window
        if len(best) <= window:
            return float("inf")
        first, last = best[-1 - window], best[-1]
        if first == last:
            return 0.0
        if self.stop_reading == "matlab":
            return abs(first - last) / (window * max(1.0, abs(last)))
        return abs(first - last) / abs(last) if last != 0 else float("inf")

    def stop_reason(
        self,
        best: Sequence[float],
        evaluations: int,
        next_evaluations: int,
        elapsed: float,
        settled: bool = True,
    ) -> StopReason | None:
        """Return why a stage with these limits ends after this generation, or None.

        `best` are the best costs of every generation so far [1], `evaluations` and `next_evaluations` the
        candidates that were scored so far and that another generation would score [1], `elapsed` the wall
        time of the run [s]. Before a search is `settled` in its valley it stands still as one at the bottom
        does; three windows without a change end it anyhow.
        """
        if self.change(best) < self.stop_tolerance and (
            settled or self.change(best, 3) < self.stop_tolerance
        ):
            return "converged"
        if len(best) >= self.max_generations:
            return "generations"
        if self.max_evaluations is not None and evaluations + next_evaluations > self.max_evaluations:
            return "evaluations"
        if self.time_limit is not None and elapsed >= self.time_limit:
            return "time"
        return None
