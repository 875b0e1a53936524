"""NRMSE over one parameter that hardly moves it, all others fitted again at every value.

k_d (9.2e-9 N·m·s/rad in Table I) drags by 5 µN·m at 500 rad/s, the air by 40 mN·m: any small value
serves, and a result must say so instead of printing three digits. The limit is a share of the NRMSE, as
everywhere in a result; the intervals of `sysid trust` follow the noise instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.fit.least_squares import Fronts, MeanNrmse, comparable, descend, drive
from sysid.journal import Finding
from sysid.motor.problem import MotorProblem
from sysid.parameters import Parameter, about, in_words
from sysid.types import BoolArray, FloatArray

# Values that move the NRMSE by less than this share of itself are equally good.
LIMIT = 0.01
_POINTS = 9
# Of the refits: share of the NRMSE that is not worth another step, steps at most.
_TOLERANCE, _ITERATIONS = 1e-4, 12


@dataclass(frozen=True, eq=False)
class CostProfile:
    """NRMSE over one parameter, the others fitted at each of its values.

    `values` (n,) ascend [SI], `nrmse` (n,) the best refit's, `best` the lowest, the fit's included. A
    parameter below `resolution` [SI], the standard error of the static curves, cannot be seen.
    """

    row: Parameter
    values: FloatArray
    nrmse: FloatArray
    best: float
    resolution: float

    @property
    def below(self) -> float | None:
        """The bound under which any value serves; None where the data bound the parameter from both sides."""
        # True where a value is as good as the best.
        within = self.nrmse <= (1.0 + LIMIT) * self.best
        first = int(np.argmax(within))
        if first > 0 and self.values[first - 1] >= self.resolution:
            return None
        outside = first + np.flatnonzero(~within[first:])
        if not outside.size:
            return float(self.values[-1])
        # Between the last value within and the first one outside, at the limit itself.
        i = int(outside[0])
        share = ((1.0 + LIMIT) * self.best - self.nrmse[i - 1]) / (self.nrmse[i] - self.nrmse[i - 1])
        low, high = np.log(self.values[i - 1]), np.log(self.values[i])
        return max(float(np.exp(low + share * (high - low))), self.resolution)

    @property
    def doubt(self) -> Finding | None:
        """That the parameter is not identifiable; None where the data bound it from both sides."""
        if self.below is None:
            return None
        sentence = (
            f"{in_words(self.row)} is not identifiable: below {self.below:.1g} {self.row.unit} it changes "
            f"the NRMSE by less than {100 * LIMIT:g} % of itself, or is lost in the error of the torque "
            "curve; its digits mean nothing"
        )
        return about(self.row, "not-identifiable", sentence)

    def document(self) -> dict[str, Any]:
        """Return the profile as a result states it."""
        return {
            "values": self.values.tolist(), "nrmse": self.nrmse.tolist(), "best_nrmse": self.best,
            "limit": LIMIT, "resolution": self.resolution, "below": self.below,
            "identified": self.below is None,
        }  # fmt: skip


def profile(
    objective: MotorProblem, name: str, best: FloatArray, resolution: float, should_stop: Callable[[], bool]
) -> CostProfile:
    """Walk a free parameter through its bounds and fit the others at every step, by least squares.

    `best` (n_free,) is the best set in the unit cube, `resolution` the static curves' [SI].
    `should_stop` is asked before every population, and raises where the fit must end.
    """
    space = objective.space
    column = space.names.index(name)
    fronts = Fronts.at(np.repeat(best[None], _POINTS, axis=0))
    fronts.points[:, column] = np.linspace(0.0, 1.0, _POINTS)
    fixed = np.zeros(fronts.points.shape, dtype=np.bool_)
    fixed[:, column] = True

    def residuals(points: FloatArray) -> tuple[FloatArray, BoolArray]:
        should_stop()
        return comparable(objective.examine(points)[1])

    walk = descend(fronts, MeanNrmse(objective), fixed=fixed, tolerance=_TOLERANCE, iterations=_ITERATIONS)
    drive(walk, residuals)
    costs = objective.evaluate(np.vstack([fronts.points, best])).cost
    values = space.decode(fronts.points)[:, column]
    return CostProfile(space.free[column], values, costs[:-1], float(costs.min()), resolution)
