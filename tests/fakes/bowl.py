"""Cheap objectives with a known minimum, and how two runs are compared."""

import numpy as np

from sysid.fit.problem import Problem
from sysid.fit.search import run_one
from sysid.fit.settings import SearchSettings
from sysid.fit.trial import UNNAMED_CAUSE, Block, Evaluation, Trial
from sysid.parameters import Parameter, ParameterTable, SearchSpace

SHORT = {"max_generations": 12}


def table(n=3):
    rows = [
        Parameter(f"p{i}", f"p_{i}", "N/m", 3.0, 1.0, 100.0, "log" if i % 2 else "linear", "Test.", "guess")
        for i in range(n + 1)
    ]
    return ParameterTable(rows)


class Bowl:
    """Distance to a point of the unit cube: minimum 0.01 there."""

    causes = UNNAMED_CAUSE

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

    def residuals(self, cube):
        return cube - self.target, np.zeros(len(cube), bool)


def run_genetic(objective, *, finish="none", **search):
    """One run of one stage; the seed is the fit's."""
    return run_one(objective, SearchSettings(runs=1, finish=finish, **search))


def assert_same_run(a, b):
    assert (a.seed, a.evaluations, a.simulations) == (b.seed, b.evaluations, b.simulations)
    for x, y in zip(a.stages, b.stages, strict=True):
        assert (x.algorithm, x.stop_reason, [*x.causes]) == (y.algorithm, y.stop_reason, [*y.causes])
        for name in ("cube", "cost", "failed"):
            np.testing.assert_array_equal(getattr(x, name), getattr(y, name))


def assert_same_runs(found, whole):
    for a, b in zip(found, whole, strict=True):
        assert_same_run(a, b)


class Decay(Bowl):
    """Three numbers of a decay that two trials measured with noise, as residuals.

    `rough` adds dents to the residuals in which derivatives mean nothing. The point (0.2, 0.5, 0.8) is right.
    `wrong` adds a ripple to the measurement that no parameter makes.
    """

    layout = Problem.layout

    def __init__(self, rough=0.0, wrong=0.0):
        super().__init__(trials=())
        self.rough = rough
        time = np.linspace(0.0, 2.0, 80)
        noise = np.random.default_rng(5).normal(0.0, 0.02, (2, 80))
        self.measured = self._signals(self.target[None], 0.0)[0] + noise + wrong * np.sin(9 * time)
        ones = np.ones((80, 1), bool)
        self.trials = [
            Trial(f"t{t}", "fit", time, self.measured[t, :, None], ones, {}, 0.0) for t in range(2)
        ]
        self.blocks = [Block(t, 0, 80 * t, 80 * t + 80, 80, 0.5, 1.0, 0.02) for t in range(2)]

    def _signals(self, cube, rough):
        time = np.linspace(0.0, 2.0, 80)
        a, rate, offset = (cube[:, i, None] for i in range(3))
        one = (1 + a) * np.exp(-4 * rate * time) + offset
        two = offset * np.cos(6 * rate * time) - a
        dents = rough * np.sin(900 * cube.sum(axis=1))[:, None]
        return np.stack([one + dents, two + dents], axis=1)

    def examine(self, cube):
        self.calls += 1
        error = self._signals(cube, self.rough) - self.measured
        failed = cube[:, 0] > 0.95
        cost = np.where(failed, 15.0, np.sqrt(np.mean(error**2, axis=2)).mean(axis=1))
        residuals = error.reshape(len(cube), -1)
        residuals[failed] = np.nan
        return Evaluation(cost, failed, 2 * len(cube)), residuals

    def evaluate(self, cube):
        return self.examine(cube)[0]
