"""The search on functions with a known minimum: reproducible, stoppable, complete histories."""

import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from fakes.bowl import SHORT, Bowl, Decay, assert_same_run, assert_same_runs, run_genetic, table
from sysid.errors import FitError
from sysid.fit.breeders.algorithms import Start, breeder
from sysid.fit.least_squares import LeastSquares
from sysid.fit.result import bound_findings, ranked_sets
from sysid.fit.search import CMAES_TOLERANCE, ROUGH_TOLERANCE, Hooks, _Run, run_many, run_one, run_seeds
from sysid.fit.settings import SearchSettings
from sysid.fit.trial import Evaluation
from sysid.parameter_sets import parameter_records
from sysid.parameters import SearchSpace
from sysid.search_options import ALGORITHMS

PAPER = {"algorithm": "ga", "finish": "none"}


class Torn(Bowl):
    """A bowl that tells why a candidate failed."""

    causes = ("fell over", "ran away")

    def evaluate(self, cube):
        scored = super().evaluate(cube)
        codes = np.where(scored.failed, 1 + (cube[:, 0] > 0.975), 0).astype(np.int8)
        return Evaluation(scored.cost, codes, scored.simulations)


def test_failures_are_counted_by_cause():
    torn = run_genetic(Torn(), population=40, seed=1, **SHORT)
    plain = run_genetic(Bowl(), population=40, seed=1, **SHORT)
    np.testing.assert_array_equal(torn.failed, plain.failed)
    assert set(torn.failures) == {"fell over", "ran away"}
    assert sum(torn.failures.values()) == torn.failed.sum()
    assert [sum(one.values()) for one in torn.stages[0].causes] == list(torn.failed)
    assert plain.failures == {"simulation failed": int(plain.failed.sum())}


def test_history_is_complete_and_sorted():
    run = run_genetic(Bowl(), population=40, seed=3, **SHORT)
    assert run.stages[0].cube.shape == (12, 40, 3)
    assert run.stages[0].cost.shape == (12, 40)
    assert run.failed.shape == (12,)
    assert run.failed[0] > 0
    assert run.evaluations == 12 * 40
    assert run.simulations == 6 * run.evaluations
    assert run.stop_reason == "generations"
    assert np.all(np.diff(run.stages[0].cost, axis=1) >= 0)
    assert np.all((run.stages[0].cube >= 0) & (run.stages[0].cube <= 1))
    np.testing.assert_array_equal(run.stages[0].cost[-1], Bowl().evaluate(run.stages[0].cube[-1]).cost)
    np.testing.assert_array_equal(run.median, np.median(run.stages[0].cost, axis=1))


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_neither_numpys_global_state_nor_interleaved_runs_disturb(algorithm):
    options = {"population": 40, "seed": 9, **SHORT, "algorithm": algorithm}
    alone = run_genetic(Bowl(), **options)
    state = np.random.get_state()[1].copy()  # noqa: NPY002  the generator that must stay untouched
    run_genetic(Bowl(), **options)
    np.testing.assert_array_equal(np.random.get_state()[1], state)  # noqa: NPY002

    class Noisy(Bowl):
        def evaluate(self, cube):
            np.random.seed(self.calls)  # noqa: NPY002  what a careless library would do
            if self.calls == 3:
                run_genetic(Bowl(), population=30, seed=1, max_generations=2, algorithm=algorithm)
            return super().evaluate(cube)

    np.testing.assert_array_equal(run_genetic(Noisy(), **options).stages[0].cube, alone.stages[0].cube)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_every_algorithm_stays_in_the_cube_and_improves(algorithm):
    class Watched(Bowl):
        def evaluate(self, cube):
            assert np.all((cube >= 0) & (cube <= 1))
            return super().evaluate(cube)

    stop = {"stop_tolerance": 1e-9, "max_generations": 60}
    run = run_genetic(Watched(), population=60, seed=1, algorithm=algorithm, **stop)
    # 3600 candidates in three dimensions: MATLAB's mutation is still at 80 % of its scale, others are near.
    assert run.best[-1] - 0.01 < (0.02 if algorithm == "matlab-ga" else 1e-3)
    assert run.stages[0].cube.shape[1:] == (60, 3)
    assert np.all(np.diff(run.best) <= 0)
    np.testing.assert_array_equal(Watched().evaluate(run.best_point[None]).cost, run.best[-1:])


def test_matlab_ga_keeps_its_elites_and_scores_only_children():
    run = run_genetic(Bowl(), population=40, seed=1, algorithm="matlab-ga", stop_tolerance=0, **SHORT)
    # ceil(0.05 * 40) = 2 elites are not scored again.
    assert run.evaluations == 40 + 11 * 38
    for before, after in zip(run.stages[0].cube[:-1], run.stages[0].cube[1:], strict=True):
        assert {tuple(row) for row in before[:2]} <= {tuple(row) for row in after}


def test_matlab_ga_breeds_as_documented():
    from sysid.fit.breeders.matlab_genetic import MatlabGA

    bred = breeder("matlab-ga", 3, 200, 5)
    assert isinstance(bred._algorithm, MatlabGA)
    parents_before = bred.ask()
    bred.tell(Bowl().evaluate(parents_before).cost)
    children = bred.ask()
    # 10 elites of 200, 0.8 * 190 = 152 crossed, 38 mutated.
    assert len(children) == 190
    genes = [set(parents_before[:, i]) for i in range(3)]
    whole = {tuple(row) for row in parents_before}
    crossed, mutated = children[:152], children[152:]
    assert all(child[i] in genes[i] for child in crossed for i in range(3))
    # Scattered: most children take genes of both parents (1 - 2 * 0.5**3 = 75 % of those with two parents).
    assert np.mean([tuple(child) not in whole for child in crossed]) > 0.5
    # A step of about the cube's edge leaves it often, and is clipped to its faces.
    assert np.mean((mutated == 0) | (mutated == 1)) > 0.3
    ranks = bred._algorithm._parents(3000)
    share = 1 / np.sqrt(np.arange(1, 201))
    # Equal steps: every rank gets its expectation, rounded up or down.
    assert np.all(np.abs(np.bincount(ranks, minlength=200) - 3000 * share / share.sum()) <= 1)


def test_finisher_starts_from_mean_and_spread_and_reaches_the_bottom():
    settings = SearchSettings(population=40, runs=1, seed=3, **SHORT, algorithm="ga", finish="cmaes")
    assert settings.stages == ("ga", "cmaes")
    assert SearchSettings(algorithm="cmaes").stages == ("cmaes",)
    short = replace(settings, max_generations=200)
    run = run_one(Bowl(), short)
    first, second = run.stages
    assert (first.algorithm, second.algorithm) == ("ga", "cmaes")
    start = Start.of_population(first.cube[-1])
    # Sixty-four draws around the mean: their centre lies within a few spreads / sqrt(64) of it.
    assert np.all(np.abs(second.cube[0].mean(axis=0) - start.mean) < 4 * start.spread / np.sqrt(64))
    assert second.cost.min() < first.cost.min()
    # The bowl has a kink at its bottom: CMA-ES closes in until its rule of 1e-5 ends it.
    assert run.best[-1] - 0.01 < 1e-5
    assert run.best_point is not None
    np.testing.assert_array_equal(Bowl().evaluate(run.best_point[None]).cost, run.best[-1:])
    assert run.evaluations == first.evaluations + second.evaluations
    paper = run_one(Bowl(), replace(short, finish="none"))
    np.testing.assert_array_equal(paper.stages[0].cube, first.cube)
    assert len(paper.stages) == 1


def test_least_squares_reaches_the_bottom():
    settings = SearchSettings(population=40, runs=1, seed=3)
    run = run_one(Decay(), settings)
    first, second = run.stages
    assert (first.algorithm, first.stop_reason, len(first.cost)) == ("ga", "generations", 3)
    assert (second.algorithm, second.stop_reason) == ("least-squares", "converged")
    assert np.all(np.abs(run.best_point - Decay().target) < 0.02)
    # The bottom: no neighbour scores less, and every run ends in the same place.
    around = run.best_point + 1e-3 * np.vstack([np.eye(3), -np.eye(3)])
    assert np.all(Decay().evaluate(around).cost > run.best[-1])
    for seed in (4, 5, 6):
        other = run_one(Decay(), replace(settings, seed=seed))
        assert abs(other.best[-1] / run.best[-1] - 1) < 1e-5
    # What a candidate cost is what the objective says, also in the first part of the window.
    np.testing.assert_array_equal(Decay().evaluate(second.cube[4]).cost, second.cost[4])
    assert run.evaluations < 700


def test_a_short_cmaes_follows_where_more_than_noise_is_left():
    rough = Decay(0.01, 0.017)
    run = run_one(rough, SearchSettings(population=40, runs=1, seed=3))
    assert [stage.algorithm for stage in run.stages] == ["ga", "least-squares", "cmaes"]
    assert run.stages[2].cube.shape[1] == 16
    assert run.stages[2].cost.min() <= run.stages[1].cost.min()
    # Among the dents, it is as good as the smooth bottom.
    smooth = run_one(Decay(0.0, 0.017), SearchSettings(population=40, runs=1, seed=3))
    assert run.best[-1] < rough.evaluate(smooth.best_point[None]).cost[0]
    assert run.best[-1] < 1.05 * smooth.best[-1]


@pytest.mark.parametrize(
    ("finish", "number", "tolerance"),
    [("least-squares", 2, ROUGH_TOLERANCE), ("cmaes", 1, CMAES_TOLERANCE), ("none", 0, CMAES_TOLERANCE)],
)
def test_cmaes_is_loose_only_after_least_squares(finish, number, tolerance):
    settings = SearchSettings(population=16, runs=1, finish=finish)
    run = _Run(Decay(), settings, 0, None, None, Hooks(), None)
    assert run._limits("cmaes", number, 16, last=True).stop_tolerance == tolerance


@pytest.mark.parametrize("wrong", [0.0, 0.2])
def test_whole_windows_are_polished_where_nothing_follows(wrong):
    # A single front has no other to agree with; the last stage takes central differences, which cost twice.
    decay = Decay(0.0, wrong)
    start = np.array([[0.4, 0.4, 0.6]])
    walk = LeastSquares(decay, start, decay.evaluate(start).cost, whole=True)
    asked = []
    while (points := walk.ask()) is not None:
        asked.append(len(points))
        scored, residuals = decay.examine(points)
        walk.tell(scored.cost, residuals)
    assert walk.ended == ("unexplained" if wrong else "converged")
    # Three coordinates, two sides.
    assert (6 in asked) == (wrong == 0.0)


def test_least_squares_leaves_fronts_that_fail_and_bounds_that_hold():
    class Fails(Decay):
        def examine(self, cube):
            _, residuals = super().examine(cube)
            residuals[:] = np.nan
            return Evaluation(np.full(len(cube), 15.0), np.ones(len(cube), bool), len(cube)), residuals

    run = run_one(Fails(), SearchSettings(population=16, runs=1, seed=1, max_generations=30))
    assert [stage.algorithm for stage in run.stages] == ["ga", "least-squares"] * 2 + ["cmaes"]
    assert run.stages[1].stop_reason == "unexplained"
    assert run.best[-1] == 15.0
    outside = Decay()
    outside.measured = outside._signals(np.array([[0.2, 1.1, 0.8]]), 0.0)[0]
    run = run_one(outside, SearchSettings(population=40, runs=1, seed=3))
    assert run.best_point[1] == 1.0


def test_a_wrong_model_is_fitted_over_whole_windows_as_well():
    wrong = Decay(0.0, 0.2)
    settings = SearchSettings(population=40, runs=1, seed=3)
    run, plain = run_one(wrong, settings), run_one(wrong, replace(settings, finish="cmaes"))
    # Two fronts end in one optimum, so that no CMA-ES follows.
    assert [stage.algorithm for stage in run.stages] == ["ga", "least-squares"] * 2
    assert [stage.stop_reason for stage in run.stages[1::2]] == ["unexplained", "converged"]
    np.testing.assert_array_equal(run.stages[2].cube, plain.stages[0].cube[3:10])
    assert run.best[-1] <= plain.best[-1] * (1 + 1e-6)


def test_runs_at_once_give_the_same_numbers():
    settings = SearchSettings(40, 5, 5, 14, "ga", "cmaes")
    assert_same_runs(run_many(Bowl(), settings), run_many(Bowl(), settings, at_once=3))

    class Broken(Bowl):
        def evaluate(self, cube):
            if threading.current_thread().name == "run_1":
                raise FitError("this one breaks")
            time.sleep(0.001)
            return super().evaluate(cube)

    with pytest.raises(FitError, match="this one breaks"):
        run_many(Broken(), settings, at_once=3)


def test_budgets_are_shared_between_search_and_finisher():
    endless = SearchSettings(40, 1, 5, 1000, "ga", "cmaes", stop_tolerance=0)
    run = run_one(Bowl(), replace(endless, max_evaluations=2000))
    assert run.stages[0].stop_reason == "evaluations"
    assert run.stages[0].evaluations == 1200
    assert 1200 < run.evaluations <= 2000
    timed = run_one(Bowl(), endless, time_limit=0.5)
    assert timed.stages[0].stop_reason == "time"
    # A generation here takes a few milliseconds; half a second is left for a loaded machine.
    assert timed.wall_time < 1.0


def test_a_run_is_reproducible_without_those_before_it():
    settings = SearchSettings(population=40, runs=3, seed=5, **SHORT, **PAPER)
    together = run_many(Bowl(), settings)
    other = run_one(Bowl(), replace(settings, seed=6))
    for differs in (other, together[1]):
        assert not np.array_equal(together[0].stages[0].cube, differs.stages[0].cube)
    assert run_seeds(settings) == tuple(run.seed for run in together)
    assert_same_run(run_one(Bowl(), settings, 2), together[2])
    # More runs on request keep the first ones.
    assert run_seeds(SearchSettings(runs=20, seed=5))[:3] == run_seeds(settings)


def test_another_process_gets_the_same_numbers():
    code = (
        "from fakes.bowl import SHORT, Bowl, run_genetic;"
        "print(run_genetic(Bowl(), population=40, seed=9, **SHORT).stages[0].cost.tobytes().hex()[-4000:])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    run = run_genetic(Bowl(), population=40, seed=9, **SHORT)
    assert out.stdout.strip() == run.stages[0].cost.tobytes().hex()[-4000:]


def test_converges_by_the_declared_rule():
    rule = SearchSettings(40, 1, 2, 500, stop_reading="matlab", finish="none")
    run = run_one(Bowl(), rule)
    assert run.stop_reason == "converged"
    assert rule.change(run.best) < 1e-4
    assert all(rule.change(run.best[:g]) >= 1e-4 for g in range(1, len(run.best)))


def test_stop_flag_keeps_what_was_found():
    flag, seen = threading.Event(), []

    def on_generation(run, generation):
        seen.append((run, generation.number))
        if (run, generation.number) == (1, 4):
            flag.set()

    hooks = Hooks(on_generation=on_generation, should_stop=flag.is_set)
    runs = run_many(Bowl(), SearchSettings(40, 5, 5, **SHORT, **PAPER), hooks=hooks)
    assert [run.stop_reason for run in runs] == ["generations", "interrupted"]
    assert len(runs[1].stages[0].cost) == 4
    assert seen[-1] == (1, 4)
    ranked = ranked_sets(runs, Bowl().space)
    assert len(ranked.cost) == 2


def test_limits_are_shared_by_the_runs_and_leave_a_set_of_each():
    settings = SearchSettings(40, 2, 5, 50, max_evaluations=1000, **PAPER)
    runs = run_many(Bowl(), settings)
    assert [(run.stop_reason, run.evaluations) for run in runs] == [("evaluations", 480)] * 2
    runs = run_many(Bowl(), replace(settings, max_evaluations=None, time_limit=0.0))
    assert [(run.stop_reason, len(run.best)) for run in runs] == [("time", 1)] * 2


def test_ranked_sets_are_the_best_of_each_last_generation():
    objective = Bowl((0.001, 0.5, 0.999))
    runs = run_many(objective, SearchSettings(60, 3, 5, 40, **PAPER))
    ranked = ranked_sets(runs, objective.space)
    best = [run.stages[0].cost[-1].min() for run in runs]
    assert ranked.cost.tolist() == sorted(best)
    for i, run in enumerate(ranked.run):
        np.testing.assert_array_equal(ranked.cube[i], runs[run - 1].best_point)
        assert ranked.seed[i] == runs[run - 1].seed
    np.testing.assert_array_equal(ranked.values[:, 3], 7.0)
    np.testing.assert_array_equal(ranked.values[:, :3], objective.space.decode(ranked.cube))
    assert ranked.at_bound.tolist() == [[-1, 0, 1, 0]] * 3
    low, high = bound_findings(parameter_records(objective.space), ranked.at_bound)
    assert (low.code, low.parameters, high.code) == ("at-lower-bound", ("p0",), "at-upper-bound")
    assert low.sentence.startswith("3 of 3 sets end at the lower bound of p0 (p_0), 1 N/m")
    assert "upper bound of p2 (p_2), 100 N/m" in high.sentence


def test_a_flat_cost_ends():
    class Flat(Bowl):
        def evaluate(self, cube):
            return Evaluation(np.full(len(cube), 0.5), np.zeros(len(cube), bool), len(cube))

    run = run_genetic(Flat(), population=20, seed=1)
    assert (run.stop_reason, len(run.best)) == ("converged", 5)
    # cma gives up after three generations, before this rule does; what it bred is kept.
    for algorithm, finish in (("cmaes", "none"), ("ga", "cmaes")):
        run = run_genetic(Flat(), population=20, seed=1, stop_window=30, algorithm=algorithm, finish=finish)
        assert run.best[-1] == 0.5
        assert run.best_point.shape == (3,)


def test_refusals():
    class Broken(Bowl):
        def evaluate(self, cube):
            return Evaluation(np.full(len(cube), np.nan), np.zeros(len(cube), bool), len(cube))

    with pytest.raises(FitError, match="20 of 20 candidates have no finite NRMSE"):
        run_genetic(Broken(), population=20, seed=1, **SHORT)
    empty = Bowl()
    empty.space = SearchSpace.build(table(), [], {})
    with pytest.raises(FitError, match="no parameter is free"):
        run_genetic(empty, population=20, seed=1, **SHORT)
    with pytest.raises(FitError, match="population"):
        SearchSettings(population=2)
    with pytest.raises(FitError, match="unknown algorithm 'simplex'; expected one of ga, matlab-ga"):
        SearchSettings(algorithm="simplex")
    with pytest.raises(FitError, match="no run"):
        ranked_sets([], Bowl().space)
