"""CMA-ES of the package `cma` (which pymoo's own CMA-ES wraps) on whole arrays.

The cube's faces are kept by cma's own mapping of unbounded coordinates into a box, computed for a generation
at once rather than for one candidate after the other, which takes most of cma's time. The candidates are, bit
for bit, those of `pymoo.algorithms.soo.nonconvex.cmaes.CMAES` with the same options.
"""

from __future__ import annotations

from typing import Any

import cma
import numpy as np
from cma.transformations import BoxConstraintsLinQuadTransformation

from sysid.fit.breeders.breeder import ArrayBreeder
from sysid.types import FloatArray

# Largest standard deviation [1]: cma's default for a bounded range.
_LARGEST_STD = 1 / 3


class _Drawn:
    """In the place of cma's archive of what it has drawn, which takes a third of its time.

    cma looks up how a candidate was drawn, in case its user has moved it; no candidate is moved in a fit.
    """

    last_iteration = 0

    def __getitem__(self, point: FloatArray) -> dict[str, Any]:
        return {"geno": point, "iteration": self.last_iteration}

    def get(self, point: FloatArray, default: Any = None) -> dict[str, Any]:
        return self[point]

    def insert(self, point: FloatArray, **facts: Any) -> None:
        """Remember nothing."""

    def pop(self, point: FloatArray, default: Any = None) -> Any:
        return default

    def truncate_to(self, size: int) -> None:
        """Forget nothing."""


class EvolutionStrategy(ArrayBreeder):
    """CMA-ES as ask and tell over the unit cube.

    It begins at `mean` with a standard deviation `spread` along every axis (n_free,) [1], and draws from
    `random`; cma itself would draw from numpy's global generator.
    """

    def __init__(
        self, mean: FloatArray, spread: FloatArray, population: int, random: np.random.Generator
    ) -> None:
        largest = float(spread.max())
        self._box = BoxConstraintsLinQuadTransformation([[0.0, 1.0]])
        options = {
            "popsize": population,
            "CMA_stds": spread / largest,
            "maxstd": _LARGEST_STD,
            # The search's own rule ends it: cma's tolerances are far below what a cost resolves.
            "tolfun": 0.0,
            "tolx": 0.0,
            "randn": lambda *shape: random.standard_normal(shape),
            "seed": np.nan,
            "verbose": -9,
            "verb_log": 0,
            # No file of the working folder takes part.
            "signals_filename": "",
        }
        self._strategy = cma.CMAEvolutionStrategy(self._box.inverse(mean), largest, options)
        self._strategy.sent_solutions = _Drawn()
        self._drawn: list[FloatArray] = []
        self._points = np.empty((0, len(mean)))
        self._cost = np.empty(0)

    def ask(self) -> FloatArray | None:
        """Return the candidates (P, n_free) to score next, or None when cma has given up (a flat cost)."""
        if self._strategy.stop():
            return None
        self._drawn = self._strategy.ask()
        drawn = np.array(self._drawn)
        # The box is the same for every coordinate, so all candidates are mapped as one long vector.
        self._points = np.reshape(self._box(drawn.ravel()), drawn.shape)
        return self._points

    def tell(self, cost: FloatArray) -> None:
        """Take the costs (P,) of the candidates last asked for."""
        self._cost = np.array(cost, dtype=np.float64)
        self._strategy.tell(self._drawn, self._cost.tolist())
