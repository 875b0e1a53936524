"""Profile of a parameter that hardly moves the cost: hold it, refit the others, look at the NRMSE.

k_d (9.2e-9 N·m·s/rad in Table I) drags by 5 µN·m at 500 rad/s, beside 40 mN·m of the air: any small value
serves, and a result must say so instead of printing three digits.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.fit.breeders.algorithms import Start, breeder
from sysid.motor.objective import MotorObjective
from sysid.parameters import SearchSpace
from sysid.types import BoolArray, FloatArray

# Values that move the NRMSE by less than this share of itself cannot be told apart.
LIMIT = 0.01
_POINTS = 9
# Others are refitted near where the last point left them: population, generations, spread in the unit cube.
_REFIT = (12, 16, 0.02)


@dataclass(frozen=True, eq=False)
class Profile:
    """NRMSE over one parameter, the others refitted.

    Parameters
    ----------
    name, unit : str
    values : (n,) array
        Held values [SI], ascending.
    nrmse : (n,) array
        Of the best refit [1].
    best : float
        Lowest NRMSE, the fit's own included [1].
    resolution : float
        What the static curves hide [SI]: a linear drag below the standard error of theirs is theirs.
    """

    name: str
    unit: str
    values: FloatArray
    nrmse: FloatArray
    best: float
    resolution: float = 0.0

    @property
    def within(self) -> BoolArray:
        """(n,) True where a value cannot be told from the best."""
        return np.asarray(self.nrmse <= (1.0 + LIMIT) * self.best, dtype=np.bool_)

    @property
    def below(self) -> float | None:
        """The bound under which any value serves; None where the data hold the parameter from both sides."""
        first = int(np.argmax(self.within))
        if first > 0 and self.values[first - 1] >= self.resolution:
            return None
        outside = first + np.flatnonzero(~self.within[first:])
        if not outside.size:
            return float(self.values[-1])
        # Between the last value within and the first one outside, at the limit itself.
        i = int(outside[0])
        share = ((1.0 + LIMIT) * self.best - self.nrmse[i - 1]) / (self.nrmse[i] - self.nrmse[i - 1])
        low, high = np.log(self.values[i - 1]), np.log(self.values[i])
        return max(float(np.exp(low + share * (high - low))), self.resolution)

    @property
    def sentence(self) -> str | None:
        """What a result says about it; None where the data hold it."""
        below = self.below
        if below is None:
            return None
        return (
            f"{self.name} is not identifiable: below {below:.1g} {self.unit} it changes the NRMSE by less "
            f"than {100 * LIMIT:g} % of itself, or is lost in the error of the torque curve; its digits mean "
            "nothing"
        )

    def document(self) -> dict[str, Any]:
        """Return the profile as a result states it."""
        return {
            "values": self.values.tolist(),
            "nrmse": self.nrmse.tolist(),
            "best nrmse": self.best,
            "limit": LIMIT,
            "resolution of the static curves": self.resolution,
            "below": self.below,
            "identified": self.below is None,
        }


def profile(
    objective: MotorObjective,
    name: str,
    best: FloatArray,
    seed: int,
    resolution: float = 0.0,
    should_stop: Callable[[], bool] = lambda: False,
) -> Profile:
    """Walk a free parameter through its bounds and refit the others at every step.

    Parameters
    ----------
    objective : MotorObjective
        Of the fit.
    name : str
        A free parameter.
    best : (n_free,) array
        The best set in the unit cube.
    seed : int
    resolution : float
        Of the static curves [SI].
    should_stop : callable
        Asked before every refit; raises where the fit must end.
    """
    space = objective.space
    column = space.names.index(name)
    rest = tuple(row for row in space.free if row.name != name)
    own = space.free[column]
    positions = np.linspace(0.0, 1.0, _POINTS)
    values = space.decode(np.where(np.arange(len(space.free)) == column, positions[:, None], 0.5))[:, column]
    costs = np.empty(_POINTS)
    lowest = float(objective.evaluate(best[None]).cost[0])
    nearest = int(np.argmin(np.abs(positions - best[column])))
    # Outward from the best set, so that every refit starts beside an optimum.
    for order in (range(nearest, _POINTS), range(nearest - 1, -1, -1)):
        at = np.delete(best, column)
        for i in order:
            should_stop()
            held = replace(
                objective, space=SearchSpace(space.table, rest, {**space.fixed, name: float(values[i])})
            )
            costs[i], at = _refit(held, at, seed + i)
    return Profile(name, own.unit, values, costs, min(lowest, float(costs.min())), resolution)


def _refit(objective: MotorObjective, at: FloatArray, seed: int) -> tuple[float, FloatArray]:
    population, generations, spread = _REFIT
    lowest, point = float(objective.evaluate(at[None]).cost[0]), at
    bred = breeder("cmaes", at.size, population, seed, Start(at, np.full(at.size, spread)))
    for _ in range(generations):
        points = bred.ask()
        if points is None:
            break
        cost = objective.evaluate(points).cost
        bred.tell(cost)
        if float(cost.min()) < lowest:
            lowest, point = float(cost.min()), points[int(np.argmin(cost))]
    return lowest, point
