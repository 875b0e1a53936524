"""What every search algorithm looks like to the search."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from sysid.types import FloatArray


class Breeder(Protocol):
    """One algorithm as ask and tell over the unit cube."""

    def ask(self) -> FloatArray | None:
        """Return the candidates (P, n_free) to score next, or None when no new one can be bred."""
        ...

    def tell(self, cost: FloatArray) -> None:
        """Take the costs (P,) of the candidates last asked for."""
        ...

    def population(self) -> tuple[FloatArray, FloatArray]:
        """Return points (P, n_free) and costs (P,) of the population, best first."""
        ...

    def close(self) -> None:
        """Release what was taken; by default nothing was."""
        return


class ArrayBreeder(Breeder, Protocol):
    """A breeder that holds its population as arrays."""

    _points: FloatArray
    _cost: FloatArray

    def population(self) -> tuple[FloatArray, FloatArray]:
        """Return points (P, n_free) and costs (P,) of the population, best first."""
        order = np.argsort(self._cost, kind="stable")
        return self._points[order], self._cost[order]
