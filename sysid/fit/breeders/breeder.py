"""What every search algorithm looks like to the search."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sysid.fit.stopping import StopReason
from sysid.types import FloatArray

# Standard deviation of a CMA-ES that starts anywhere [edges of the cube]: cma's own advice.
RANDOM_SPREAD = 0.3
# Least standard deviation with which CMA-ES starts in a coordinate [unit cube]: a converged population spans
# almost nothing in some directions; CMA-ES needs room to measure them, and to leave a valley that the
# population has settled in too soon.
_LEAST_SPREAD = 0.05


@dataclass(frozen=True, eq=False)
class Start:
    """Where CMA-ES begins."""

    # (n_free,) centre in the unit cube [1].
    mean: FloatArray
    # (n_free,) standard deviation along every axis [1].
    spread: FloatArray
    # (n_free, n_free) unit vectors of the axes as columns; by default the coordinates.
    axes: FloatArray | None = None

    @classmethod
    def of_population(cls, cube: FloatArray) -> Start:
        """Return mean and spread of a population (P, n_free); the spread is kept between 0.05 and 0.3."""
        return cls(cube.mean(axis=0), np.clip(cube.std(axis=0), _LEAST_SPREAD, RANDOM_SPREAD))


class Breeder(Protocol):
    """One algorithm as ask and tell over the unit cube.

    One with `needs_residuals` takes residuals (P, m) with the costs, NaN where a simulation failed.
    """

    needs_residuals: bool = False

    def ask(self) -> FloatArray | None:
        """Return the candidates (P, n_free) [unit cube] to score next; None when no new one can be bred."""
        ...

    def tell(self, cost: FloatArray, residuals: FloatArray | None = None) -> None:
        """Take the costs (P,) [1] of the candidates last asked for."""
        ...

    def population(self) -> tuple[FloatArray, FloatArray]:
        """Return points (P, n_free) [unit cube] and costs (P,) [1] of the population, best first."""
        ...

    @property
    def ended(self) -> StopReason:
        """Why there is nothing to ask for."""
        return "exhausted"

    def start(self) -> Start:
        """Return where a finisher begins."""
        return Start.of_population(self.population()[0])


class Keeping(Breeder):
    """A breeder whose candidates end with values (S,) [unit cube] that it keeps."""

    def __init__(self, bred: Breeder, kept: FloatArray) -> None:
        self._bred, self._kept = bred, kept
        self.needs_residuals = bred.needs_residuals

    def _with_kept(self, cube: FloatArray) -> FloatArray:
        return np.column_stack([cube, np.tile(self._kept, (len(cube), 1))])

    def ask(self) -> FloatArray | None:
        asked = self._bred.ask()
        return None if asked is None else self._with_kept(asked)

    def tell(self, cost: FloatArray, residuals: FloatArray | None = None) -> None:
        self._bred.tell(cost, residuals)

    def population(self) -> tuple[FloatArray, FloatArray]:
        cube, cost = self._bred.population()
        return self._with_kept(cube), cost

    @property
    def ended(self) -> StopReason:
        return self._bred.ended

    def start(self) -> Start:
        start, none = self._bred.start(), np.zeros_like(self._kept)
        return Start(np.append(start.mean, self._kept), np.append(start.spread, none), start.axes)
