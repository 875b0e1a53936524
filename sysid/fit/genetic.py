"""The paper's genetic algorithm through pymoo; the only importer of pymoo.

pymoo breeds (tournament selection, simulated binary crossover, polynomial mutation, its defaults) over the
unit cube; sysid scores a whole population at once and decides when to end. One generation is one
ask-and-tell, so nothing of pymoo's own stop rules, histories or evaluation budgets takes part.

Same objective, settings and version give identical numbers: run ``i`` draws from the ``i``-th child of the
seed (`numpy.random.SeedSequence`), so it is reproducible without the runs before it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import FitError
from sysid.fit.objective import Evaluation, Objective
from sysid.fit.stopping import StopReason, StopRule

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class GeneticSettings:
    """How a fit searches.

    Parameters
    ----------
    population : int
        Individuals per generation [1]; the paper uses 200 (motor) and 400 to 800 (gear).
    runs : int
        Independent runs [1]; the paper uses 5.
    seed : int
        Seed of the fit; every run draws from its own child of it.
    stop : StopRule
        When a run ends. `time_limit` and `max_evaluations` are those of the whole fit.
    """

    population: int = 400
    runs: int = 5
    seed: int = 1
    stop: StopRule = field(default_factory=StopRule)

    def __post_init__(self) -> None:
        if self.population < 4 or self.runs < 1 or self.seed < 0:
            raise FitError(
                f"population {self.population}, runs {self.runs}, seed {self.seed}: expected a population "
                "of at least 4, at least 1 run and a seed of at least 0"
            )

    def run_seeds(self) -> tuple[int, ...]:
        """Return the seed of every run."""
        children = np.random.SeedSequence(self.seed).spawn(self.runs)
        return tuple(int(child.generate_state(1, np.uint32)[0]) for child in children)


@dataclass(frozen=True, eq=False)
class Generation:
    """What one generation left behind.

    Parameters
    ----------
    number : int
        From 1.
    cube : (P, n_free) array
        Surviving population in the unit cube, best first [1].
    cost : (P,) array
        Its NRMSE [1].
    failed : int
        Candidates of this generation of which a simulation failed [1].
    evaluations, simulations : int
        Since the run began [1].
    elapsed : float
        Wall time since the run began [s].
    """

    number: int
    cube: FloatArray
    cost: FloatArray
    failed: int
    evaluations: int
    simulations: int
    elapsed: float

    @property
    def best(self) -> float:
        """Lowest NRMSE [1]."""
        return float(np.min(self.cost))

    @property
    def median(self) -> float:
        """Median NRMSE [1]."""
        return float(np.median(self.cost))


@dataclass(frozen=True, eq=False)
class RunHistory:
    """Everything one run did.

    Parameters
    ----------
    seed : int
        Of this run.
    cube : (G, P, n_free) array
        Population of every generation in the unit cube, best first [1].
    cost : (G, P) array
        NRMSE [1].
    failed : (G,) int array
        Candidates scored in the generation of which a simulation failed [1].
    evaluations, simulations : int
        Candidates scored and simulations run [1].
    wall_time : float
        [s].
    stop_reason : str
        A key of `sysid.fit.stopping.REASONS`.
    """

    seed: int
    cube: FloatArray
    cost: FloatArray
    failed: NDArray[np.int64]
    evaluations: int
    simulations: int
    wall_time: float
    stop_reason: StopReason

    @property
    def best(self) -> FloatArray:
        """(G,) lowest NRMSE of every generation [1]."""
        return self.cost.min(axis=1)

    @property
    def median(self) -> FloatArray:
        """(G,) median NRMSE of every generation [1]."""
        return np.median(self.cost, axis=1)

    @property
    def best_point(self) -> FloatArray:
        """(n_free,) best individual of the last generation in the unit cube [1]."""
        return self.cube[-1, int(np.argmin(self.cost[-1]))]


def run_genetic(
    objective: Objective,
    *,
    population: int,
    seed: int,
    stop: StopRule,
    on_generation: Callable[[Generation], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> RunHistory:
    """Run one genetic algorithm until `stop` says so.

    Parameters
    ----------
    objective : Objective
        Scores points of the unit cube.
    population : int
        Individuals per generation [1].
    seed : int
        Of this run.
    stop : StopRule
        When to end.
    on_generation : callable, optional
        Called with every `Generation`.
    should_stop : callable, optional
        Asked after every generation; True ends the run and keeps what it found.

    Raises
    ------
    FitError
        When there is no free parameter, or a cost is not finite.
    """
    if not objective.space.free:
        raise FitError("no parameter is free, so there is nothing to fit; name the free ones in the campaign")
    started = time.perf_counter()
    generations: list[Generation] = []
    best: list[float] = []
    scored: list[Evaluation] = []

    def score(points: FloatArray) -> FloatArray:
        scored.append(_scored(objective, points))
        return scored[-1].cost

    def decide() -> StopReason | None:
        evaluations = sum(len(s.cost) for s in scored)
        return stop.reason(best, evaluations, population, time.perf_counter() - started)

    def record(cube: FloatArray, cost: FloatArray) -> None:
        order = np.argsort(cost, kind="stable")
        generation = Generation(
            number=len(generations) + 1,
            cube=cube[order],
            cost=cost[order],
            failed=int(np.count_nonzero(scored[-1].failed)),
            evaluations=sum(len(s.cost) for s in scored),
            simulations=sum(s.simulations for s in scored),
            elapsed=time.perf_counter() - started,
        )
        generations.append(generation)
        best.append(generation.best)
        if on_generation is not None:
            on_generation(generation)

    reason = _evolve(len(objective.space.free), population, seed, score, record, decide, should_stop)
    return RunHistory(
        seed=seed,
        cube=np.stack([g.cube for g in generations]),
        cost=np.stack([g.cost for g in generations]),
        failed=np.array([g.failed for g in generations], dtype=np.int64),
        evaluations=generations[-1].evaluations,
        simulations=generations[-1].simulations,
        wall_time=time.perf_counter() - started,
        stop_reason=reason,
    )


def run_many(
    objective: Objective,
    settings: GeneticSettings,
    *,
    on_generation: Callable[[int, Generation], None] | None = None,
    on_run: Callable[[int, RunHistory], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> tuple[RunHistory, ...]:
    """Run the independent runs of a fit, one after the other.

    Parameters
    ----------
    objective : Objective
        Scores points of the unit cube.
    settings : GeneticSettings
        Population, runs, seed, stop rule.
    on_generation : callable, optional
        Called with the run (from 0) and every `Generation`.
    on_run : callable, optional
        Called with the run (from 0) and its history when it ends.
    should_stop : callable, optional
        Asked after every generation; True ends the fit after this generation.

    Returns
    -------
    tuple of RunHistory
        One per run that was begun; fewer than `settings.runs` only when the fit was interrupted.

    Notes
    -----
    The evaluation budget is divided equally; of the time that is left each run gets an equal share, so
    that a fit cut by its time limit still has one set per run.
    """
    started = time.perf_counter()
    histories: list[RunHistory] = []
    rule = settings.stop.share(settings.runs)
    for run, seed in enumerate(settings.run_seeds()):
        if settings.stop.time_limit is not None:
            left = settings.stop.time_limit - (time.perf_counter() - started)
            rule = replace(rule, time_limit=max(0.0, left / (settings.runs - run)))
        report = None if on_generation is None else _for_run(on_generation, run)
        history = run_genetic(
            objective,
            population=settings.population,
            seed=seed,
            stop=rule,
            on_generation=report,
            should_stop=should_stop,
        )
        histories.append(history)
        if on_run is not None:
            on_run(run, history)
        if history.stop_reason == "interrupted":
            break
    return tuple(histories)


def _for_run(on_generation: Callable[[int, Generation], None], run: int) -> Callable[[Generation], None]:
    return lambda generation: on_generation(run, generation)


def _scored(objective: Objective, points: FloatArray) -> Evaluation:
    scored = objective.evaluate(points)
    if scored.cost.shape != (len(points),) or not np.all(np.isfinite(scored.cost)):
        bad = int(np.count_nonzero(~np.isfinite(scored.cost)))
        raise FitError(
            f"{bad} of {len(points)} candidates have no finite NRMSE; a failed simulation must score its "
            "penalty, so please report this campaign"
        )
    return scored


def _evolve(
    n_free: int,
    population: int,
    seed: int,
    score: Callable[[FloatArray], FloatArray],
    record: Callable[[FloatArray, FloatArray], None],
    decide: Callable[[], StopReason | None],
    should_stop: Callable[[], bool] | None,
) -> StopReason:
    # pymoo takes long to import: commands that do not fit must not pay for it.
    from pymoo.algorithms.soo.nonconvex.ga import GA
    from pymoo.config import Config
    from pymoo.core.problem import Problem
    from pymoo.core.termination import Termination
    from pymoo.operators.crossover.sbx import SBX
    from pymoo.operators.mutation.pm import PM
    from pymoo.operators.sampling.rnd import FloatRandomSampling

    # It would print a hint about its own compiled modules, which breeding does not use.
    Config.warnings["not_compiled"] = False

    class UnitCube(Problem):
        def __init__(self) -> None:
            super().__init__(n_var=n_free, n_obj=1, xl=np.zeros(n_free), xu=np.ones(n_free))

        def _evaluate(self, x: FloatArray, out: dict[str, Any], *args: Any, **kwargs: Any) -> None:
            out["F"] = score(np.asarray(x, dtype=np.float64))[:, None]

    class DeclaredRule(Termination):
        reason: StopReason | None = None

        def _update(self, algorithm: Any) -> float:
            survivors = algorithm.pop
            record(survivors.get("X").astype(np.float64), survivors.get("F")[:, 0].astype(np.float64))
            interrupted = should_stop is not None and should_stop()
            self.reason = "interrupted" if interrupted else decide()
            return 0.0 if self.reason is None else 1.0

    rule = DeclaredRule()
    # Operators are built anew: pymoo's defaults are objects shared by every instance.
    algorithm = GA(
        pop_size=population,
        sampling=FloatRandomSampling(),
        crossover=SBX(),
        mutation=PM(),
        eliminate_duplicates=True,
        save_history=False,
        seed=seed,
    )
    algorithm.termination = rule
    algorithm.setup(UnitCube(), verbose=False)
    while algorithm.has_next():
        offspring = algorithm.ask()
        if offspring is None:
            break
        algorithm.evaluator.eval(algorithm.problem, offspring)
        algorithm.tell(infills=offspring)
    # Breeding that finds no new point ends the loop without asking the rule.
    return rule.reason if rule.reason is not None else "exhausted"
