"""The genetic algorithm on functions with a known minimum: reproducible, stoppable, complete histories."""

import subprocess
import sys

import numpy as np
import pytest

from sysid.errors import FitError
from sysid.fit.genetic import GeneticSettings, run_genetic, run_many
from sysid.fit.objective import Evaluation
from sysid.fit.result import bound_warnings, ranked_sets
from sysid.fit.stopping import StopFlag, StopRule
from sysid.parameter_sets import parameter_records
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


SHORT = StopRule(max_generations=12)


def test_finds_the_minimum():
    run = run_genetic(Bowl(), population=60, seed=1, stop=StopRule(tolerance=1e-6, max_generations=60))
    # 60 generations of 60 in three dimensions come within 1e-3 of the cube's edge length with ease.
    assert run.best[-1] - 0.01 < 1e-3
    np.testing.assert_allclose(run.best_point, Bowl().target, atol=3e-3)
    assert np.all(np.diff(run.best) <= 0)


def test_history_is_complete_and_sorted():
    run = run_genetic(Bowl(), population=40, seed=3, stop=SHORT)
    assert run.cube.shape == (12, 40, 3)
    assert run.cost.shape == (12, 40)
    assert run.failed.shape == (12,)
    assert run.failed[0] > 0
    assert run.evaluations == 12 * 40
    assert run.simulations == 6 * run.evaluations
    assert run.stop_reason == "generations"
    assert np.all(np.diff(run.cost, axis=1) >= 0)
    assert np.all((run.cube >= 0) & (run.cube <= 1))
    np.testing.assert_array_equal(run.cost[-1], Bowl().evaluate(run.cube[-1]).cost)
    np.testing.assert_array_equal(run.median, np.median(run.cost, axis=1))


def test_same_seed_same_numbers_other_seed_other_numbers():
    settings = GeneticSettings(population=40, runs=2, seed=5, stop=SHORT)
    first, second = run_many(Bowl(), settings), run_many(Bowl(), settings)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.cube, b.cube)
        np.testing.assert_array_equal(a.cost, b.cost)
    other = run_many(Bowl(), GeneticSettings(population=40, runs=2, seed=6, stop=SHORT))
    assert not np.array_equal(first[0].cube, other[0].cube)
    assert not np.array_equal(first[0].cube, first[1].cube)


def test_neither_numpys_global_state_nor_interleaved_runs_disturb():
    alone = run_genetic(Bowl(), population=40, seed=9, stop=SHORT)

    class Noisy(Bowl):
        def evaluate(self, cube):
            np.random.seed(self.calls)  # noqa: NPY002  what a careless library would do
            if self.calls == 3:
                run_genetic(Bowl(), population=30, seed=1, stop=StopRule(max_generations=2))
            return super().evaluate(cube)

    np.testing.assert_array_equal(run_genetic(Noisy(), population=40, seed=9, stop=SHORT).cube, alone.cube)


def test_a_run_is_reproducible_without_those_before_it():
    settings = GeneticSettings(population=40, runs=3, seed=5, stop=SHORT)
    together = run_many(Bowl(), settings)
    assert settings.run_seeds() == tuple(run.seed for run in together)
    alone = run_genetic(Bowl(), population=40, seed=settings.run_seeds()[2], stop=SHORT)
    np.testing.assert_array_equal(alone.cube, together[2].cube)
    # More runs on request keep the first ones.
    assert GeneticSettings(runs=20, seed=5).run_seeds()[:3] == settings.run_seeds()


def test_another_process_gets_the_same_numbers():
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]);"
        "from test_fit_genetic import *;"
        "print(run_genetic(Bowl(), population=40, seed=9, stop=SHORT).cost.tobytes().hex()[-4000:])"
    )
    here = str(__import__("pathlib").Path(__file__).parent)
    out = subprocess.run([sys.executable, "-c", code, here], capture_output=True, text=True, check=True)
    run = run_genetic(Bowl(), population=40, seed=9, stop=SHORT)
    assert out.stdout.strip() == run.cost.tobytes().hex()[-4000:]


def test_converges_by_the_declared_rule():
    rule = StopRule(reading="matlab", max_generations=500)
    run = run_genetic(Bowl(), population=40, seed=2, stop=rule)
    assert run.stop_reason == "converged"
    assert rule.change(run.best) < 1e-4
    assert all(rule.change(run.best[:g]) >= 1e-4 for g in range(1, len(run.best)))


def test_stop_flag_keeps_what_was_found():
    flag, seen = StopFlag(), []

    def on_generation(run, generation):
        seen.append((run, generation.number))
        if (run, generation.number) == (1, 4):
            flag.set()

    runs = run_many(
        Bowl(),
        GeneticSettings(population=40, runs=5, seed=5, stop=SHORT),
        on_generation=on_generation,
        should_stop=flag,
    )
    assert [run.stop_reason for run in runs] == ["generations", "interrupted"]
    assert len(runs[1].cost) == 4
    assert seen[-1] == (1, 4)
    ranked = ranked_sets(runs, Bowl().space)
    assert len(ranked.cost) == 2


def test_evaluation_budget_is_shared_and_never_exceeded():
    stop = StopRule(max_generations=50, max_evaluations=1000)
    runs = run_many(Bowl(), GeneticSettings(population=40, runs=2, seed=5, stop=stop))
    assert [run.evaluations for run in runs] == [480, 480]
    assert {run.stop_reason for run in runs} == {"evaluations"}


def test_time_limit_leaves_one_set_per_run():
    stop = StopRule(max_generations=50, time_limit=0.0)
    runs = run_many(Bowl(), GeneticSettings(population=40, runs=3, seed=5, stop=stop))
    assert [(run.stop_reason, len(run.cost)) for run in runs] == [("time", 1)] * 3


def test_ranked_sets_are_the_best_of_each_last_generation():
    objective = Bowl((0.001, 0.5, 0.999))
    runs = run_many(
        objective, GeneticSettings(population=60, runs=3, seed=5, stop=StopRule(max_generations=40))
    )
    ranked = ranked_sets(runs, objective.space)
    best = [run.cost[-1].min() for run in runs]
    assert ranked.cost.tolist() == sorted(best)
    for i, run in enumerate(ranked.run):
        np.testing.assert_array_equal(ranked.cube[i], runs[run - 1].best_point)
        assert ranked.seed[i] == runs[run - 1].seed
    np.testing.assert_array_equal(ranked.values[:, 3], 7.0)
    np.testing.assert_array_equal(ranked.values[:, :3], objective.space.decode(ranked.cube))
    assert ranked.at_bound.tolist() == [[-1, 0, 1, 0]] * 3
    warnings = bound_warnings(parameter_records(objective.space), ranked.at_bound)
    assert len(warnings) == 2
    assert warnings[0].startswith("3 of 3 sets end at the lower bound of p0 (1 N/m)")
    assert "upper bound of p2 (100 N/m)" in warnings[1]


def test_a_flat_cost_ends():
    class Flat(Bowl):
        def evaluate(self, cube):
            return Evaluation(np.full(len(cube), 0.5), np.zeros(len(cube), bool), len(cube))

    run = run_genetic(Flat(), population=20, seed=1, stop=StopRule())
    assert (run.stop_reason, len(run.cost)) == ("converged", 5)


def test_refusals():
    class Broken(Bowl):
        def evaluate(self, cube):
            return Evaluation(np.full(len(cube), np.nan), np.zeros(len(cube), bool), len(cube))

    with pytest.raises(FitError, match="20 of 20 candidates have no finite NRMSE"):
        run_genetic(Broken(), population=20, seed=1, stop=SHORT)
    empty = Bowl()
    empty.space = SearchSpace.build(table(), [], {})
    with pytest.raises(FitError, match="no parameter is free"):
        run_genetic(empty, population=20, seed=1, stop=SHORT)
    with pytest.raises(FitError, match="population"):
        GeneticSettings(population=2)
    with pytest.raises(FitError, match="no run"):
        ranked_sets([], Bowl().space)
