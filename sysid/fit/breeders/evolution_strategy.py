"""CMA-ES of the package `cma` (which pymoo's own CMA-ES wraps) on whole arrays.

The cube's faces are kept by cma's own mapping of unbounded coordinates into a box, computed for a generation
at once rather than for one candidate after the other, which takes most of cma's time. The candidates equal,
bit for bit, the candidates of `pymoo.algorithms.soo.nonconvex.cmaes.CMAES` with the same options.
"""

import sys
from types import ModuleType

import numpy as np

from sysid.fit.breeders.breeder import Breeder, Start
from sysid.types import FloatArray

# Cma's shortcuts for interactive shells: they import matplotlib, which takes 30 MB. An empty module stands in
# their place only while cma is imported, so a later ``import cma.s`` finds the real one.
_SHORTCUTS = "cma.s"
if "cma" not in sys.modules:
    sys.modules[_SHORTCUTS] = ModuleType(_SHORTCUTS)
    try:
        import cma
    finally:
        del sys.modules[_SHORTCUTS]
    vars(cma).pop("s", None)
else:
    import cma
from cma.transformations import BoxConstraintsLinQuadTransformation  # noqa: E402

# Largest standard deviation [1]: cma's default for a bounded range.
_LARGEST_STD = 1 / 3


class EvolutionStrategy(Breeder):
    """CMA-ES as ask and tell over the unit cube.

    It draws from `random`; cma itself would draw from numpy's global generator.
    """

    def __init__(self, start: Start, population: int, random: np.random.Generator) -> None:
        largest = float(start.spread.max())
        self._box = BoxConstraintsLinQuadTransformation([[0.0, 1.0]])
        origin = np.asarray(self._box.inverse(start.mean))
        # With other axes, candidates are drawn around 0 along these axes and then turned into the cube.
        self._origin, self._axes = origin, start.axes
        options = {
            "popsize": population,
            "CMA_stds": start.spread / largest,
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
        first = origin if start.axes is None else np.zeros(len(origin))
        self._strategy = cma.CMAEvolutionStrategy(first, largest, options)
        self._drawn: list[FloatArray] = []
        self._points = np.empty((0, len(origin)))
        self._cost = np.empty(0)

    def ask(self) -> FloatArray | None:
        """Return the candidates (P, n_free) to score next, or None when cma has given up (a flat cost)."""
        if self._strategy.stop():
            return None
        self._drawn = self._strategy.ask()
        drawn = np.array(self._drawn)
        if self._axes is not None:
            drawn = self._origin + drawn @ self._axes.T
        # The box is the same for every coordinate, so all candidates are mapped as one long vector.
        self._points = np.reshape(self._box(drawn.ravel()), drawn.shape)
        return self._points

    def tell(self, cost: FloatArray, residuals: FloatArray | None = None) -> None:
        self._cost = np.array(cost, dtype=np.float64)
        self._strategy.tell(self._drawn, self._cost.tolist())

    def population(self) -> tuple[FloatArray, FloatArray]:
        order = np.argsort(self._cost, kind="stable")
        return self._points[order], self._cost[order]
