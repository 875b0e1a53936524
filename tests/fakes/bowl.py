"""A cheap objective with a known minimum, and how two runs are compared."""

import numpy as np

from sysid.fit.objective import Evaluation
from sysid.parameters import Parameter, ParameterTable, SearchSpace


def table(n=3):
    rows = [
        Parameter(f"p{i}", f"p_{i}", "N/m", 3.0, 1.0, 100.0, "log" if i % 2 else "linear", "Test.", "guess")
        for i in range(n + 1)
    ]
    return ParameterTable(rows)


class Bowl:
    """Distance to a point of the unit cube: minimum 0.01 there."""

    def __init__(self, target=(0.2, 0.5, 0.8), trials=6):
        self.target = np.array(target)
        n = len(target)
        self.space = SearchSpace.build(table(n), [f"p{i}" for i in range(n)], {f"p{n}": 7.0})
        self.trials = trials
        self.calls = 0

    def evaluate(self, cube):
        self.calls += 1
        distance = np.sqrt(np.mean((cube - self.target) ** 2, axis=1))
        failed = cube[:, 0] > 0.95
        return Evaluation(np.where(failed, 15.0, 0.01 + distance), failed, self.trials * len(cube))


def assert_same_run(a, b):
    assert (a.seed, a.evaluations, a.simulations) == (b.seed, b.evaluations, b.simulations)
    assert [s.stop_reason for s in a.stages] == [s.stop_reason for s in b.stages]
    for x, y in zip(a.stages, b.stages, strict=True):
        for name in ("cube", "cost", "failed"):
            np.testing.assert_array_equal(getattr(x, name), getattr(y, name))
