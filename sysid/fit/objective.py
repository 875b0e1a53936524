"""What a search needs to know of a problem: its free parameters, and what a population costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from sysid.fit.trial import UNNAMED_CAUSE, Block, Evaluation, Trial
from sysid.parallel import Executor
from sysid.parameters import SearchSpace
from sysid.types import FloatArray


def causes_of(objective: object) -> tuple[str, ...]:
    """Return the causes of failure that an objective tells apart."""
    return tuple(getattr(objective, "causes", UNNAMED_CAUSE))


class Objective(Protocol):
    """A fit problem as the optimiser sees it.

    `evaluate` must be a pure function of the points: equal rows give equal costs whatever their order,
    their neighbours or the number of threads. An objective that tells causes of failure apart names them in
    an attribute `causes`. Trials, blocks and residuals are what the finisher by least squares needs.
    """

    @property
    def space(self) -> SearchSpace:
        """The free parameters."""
        ...

    @property
    def trials(self) -> Sequence[Trial]:
        """The trials, in the order of every array."""
        ...

    @property
    def blocks(self) -> Sequence[Block]:
        """Where the residuals of each trial's channels lie."""
        ...

    def evaluate(self, cube: FloatArray) -> Evaluation:
        """Simulate and score points (P, n_free) [unit cube]."""
        ...

    def examine(self, cube: FloatArray) -> tuple[Evaluation, FloatArray]:
        """Return what `evaluate` returns, and the residuals (P, m) [1]; NaN where a simulation failed."""
        ...


@dataclass(frozen=True, eq=False)
class Scored:
    """An objective as work for an executor: cost, failure, simulations, and residuals if asked for."""

    objective: Objective
    residuals: bool = False

    def __call__(self, rows: FloatArray) -> tuple[NDArray[Any], ...]:
        """Simulate and score points (P, n_free) [unit cube]."""
        further: list[FloatArray] = []
        if self.residuals:
            scored, *further = self.objective.examine(rows)
        else:
            scored = self.objective.evaluate(rows)
        each, rest = divmod(scored.simulations, len(rows))
        simulations = np.full(len(rows), each, dtype=np.int64)
        simulations[:rest] += 1
        return scored.cost, scored.failed, simulations, *further


class SpreadObjective:
    """An objective, which travels once, whose candidates an executor computes."""

    def __init__(self, objective: Any, executor: Executor) -> None:
        self._objective = objective
        self._work = {residuals: executor.share(Scored(objective, residuals)) for residuals in (False, True)}

    def __getattr__(self, name: str) -> Any:
        return getattr(self._objective, name)

    def evaluate(self, cube: FloatArray) -> Evaluation:
        """Simulate and score points (P, n_free) [unit cube]."""
        cost, failed, simulations = self._work[False](cube)
        return Evaluation(cost, failed, int(simulations.sum()))

    def examine(self, cube: FloatArray) -> tuple[Evaluation, FloatArray]:
        """Return the same, and the residuals (P, m) [1]; NaN where a simulation failed."""
        cost, failed, simulations, residuals = self._work[True](cube)
        return Evaluation(cost, failed, int(simulations.sum())), residuals
