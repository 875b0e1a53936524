"""NRMSE over one parameter that hardly moves it, all others fitted again at every value.

k_d (9.2e-9 N·m·s/rad in Table I) drags by 5 µN·m at 500 rad/s, beside 40 mN·m of the air: any small value
serves, and a result must say so instead of printing three digits. The limit is a share of the NRMSE, as
everywhere in a result; the intervals of `sysid trust` follow the noise instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.fit.breeders.algorithms import Start, breeder
from sysid.fit.breeders.breeder import Breeder
from sysid.fit.search import Hooks, SearchSettings, run_one
from sysid.fit.stopping import StopRule
from sysid.journal import Finding
from sysid.motor.problem import MotorProblem
from sysid.parameters import SearchSpace
from sysid.types import FloatArray

# Values that move the NRMSE by less than this share of itself are equally good.
LIMIT = 0.01
_POINTS = 9
# Others are refitted near where the last point left them: population, generations, spread in the unit cube.
_REFIT = (12, 16, 0.02)


@dataclass(frozen=True, eq=False)
class CostProfile:
    """NRMSE over one parameter, the others fitted at each of its values.

    `values` (n,) ascend [SI], `nrmse` (n,) is of the best refit, `best` the lowest, the fit's included. A
    parameter below `resolution` [SI], the standard error of the static curves, cannot be seen.
    """

    name: str
    unit: str
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
        return Finding(
            "not-identifiable",
            f"{self.name} is not identifiable: below {self.below:.1g} {self.unit} it changes the NRMSE by "
            f"less than {100 * LIMIT:g} % of itself, or is lost in the error of the torque curve; its digits "
            "mean nothing",
        )

    def document(self) -> dict[str, Any]:
        """Return the profile as a result states it."""
        return {
            "values": self.values.tolist(), "nrmse": self.nrmse.tolist(), "best_nrmse": self.best,
            "limit": LIMIT, "resolution": self.resolution, "below": self.below,
            "identified": self.below is None,
        }  # fmt: skip


def profile(
    objective: MotorProblem,
    name: str,
    best: FloatArray,
    seed: int,
    resolution: float,
    should_stop: Callable[[], bool],
) -> CostProfile:
    """Walk a free parameter through its bounds and fit the others at every step.

    `best` (n_free,) is the best set in the unit cube, `resolution` is of the static curves [SI]. Value i is
    searched with seed + i. `should_stop` is asked after every generation, and raises where the fit must end.
    """
    space = objective.space
    column = space.names.index(name)
    others = tuple(row for row in space.free if row.name != name)
    places = np.linspace(0.0, 1.0, _POINTS)
    values = space.decode(np.where(np.arange(len(space.free)) == column, places[:, None], 0.5))[:, column]
    costs = np.empty(_POINTS)
    lowest = float(objective.evaluate(best[None]).cost[0])
    nearest = int(np.argmin(np.abs(places - best[column])))
    # Outward from the best set, so that every search starts beside an optimum.
    for order in (range(nearest, _POINTS), range(nearest - 1, -1, -1)):
        at = np.delete(best, column)
        for i in order:
            fixed = {**space.fixed, name: float(values[i])}
            beside = replace(objective, space=SearchSpace(space.table, others, fixed))
            costs[i], at = _refit(beside, at, seed + i, should_stop)
    lowest = min(lowest, float(costs.min()))
    return CostProfile(name, space.free[column].unit, values, costs, lowest, resolution)


def _refit(
    objective: MotorProblem, at: FloatArray, seed_of_value: int, should_stop: Callable[[], bool]
) -> tuple[float, FloatArray]:
    """Return the lowest NRMSE near a point of the unit cube, and where it is."""
    many, generations, spread = _REFIT

    def near(name: str, n_free: int, population: int, seed: int, start: Start | None) -> Breeder:
        return breeder(name, n_free, population, seed_of_value, Start(at, np.full(n_free, spread)))

    settings = SearchSettings(many, 1, seed_of_value, StopRule(max_generations=generations), "cmaes", "none")
    run = run_one(objective, settings, hooks=Hooks(should_stop=should_stop), breeds=near)
    before = float(objective.evaluate(at[None]).cost[0])
    after = float(run.best[-1])
    return (after, run.best_point) if after < before else (before, at)
