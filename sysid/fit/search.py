"""The search: independent runs, each a stage of one algorithm and a finisher, ended by declared rules.

sysid scores a whole population at once and decides when to end; one generation is one ask-and-tell of a
`sysid.fit.breeders.algorithms.Breeder`.

Same objective, settings and version give identical numbers: run ``i`` draws from the ``i``-th child of the
seed (`numpy.random.SeedSequence`), so it is reproducible without the runs before it, and every stage of it
from a child of that. The order and the interleaving of runs change nothing.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass, field, replace
from math import ceil
from typing import Protocol

import numpy as np

from sysid.errors import FitError
from sysid.fit.breeders.algorithms import breeder
from sysid.fit.breeders.breeder import Breeder, Start
from sysid.fit.history import Generation, RunHistory, StageHistory
from sysid.fit.least_squares import LeastSquares
from sysid.fit.objective import Objective, causes_of
from sysid.fit.run_log import RunMemory, StageMemory
from sysid.fit.settings import SearchSettings, StopRule
from sysid.fit.stopping import StopReason
from sysid.fit.trial import Evaluation
from sysid.types import FloatArray

# CMA-ES is not elitist and learns its shape over tens of generations, so its best cost stands still longer
# than a GA's: its window is cma's default of 10 + 30 n/P generations, its tolerance a tenth of the paper's.
CMAES_TOLERANCE = 1e-5
# Of half a generation; at the bottom of a valley it is 1e-5 to 1e-4, of a start anywhere 0.1 and above.
CMAES_SPREAD = 0.01
# Of a finisher; chosen by tests/benchmarks/engine.py.
FINISH_POPULATION = 64
# Of CMA-ES after least squares: the axes of the cost are known, so a small population has to learn no others;
# and of a search of few parameters.
ROUGH_POPULATION = 16
# Generations of the first stage that least squares needs to find its starts.
FIRST_GENERATIONS = 3
# What may be used of a budget until the end of each stage that another one may follow.
_SHARES, _FAST_SHARES = (0.6,), (0.3, 0.5, 0.8)
# A generation that takes longer is scored in parts of about this [s], so that a kill costs no more.
PART_TIME = 1.0
# Between two looks at what the user wants [s].
_HEARING = 0.2


def _ignore(*_: object) -> None:
    return


@dataclass(frozen=True)
class Hooks:
    """What a search calls, and what may end it.

    Parameters
    ----------
    on_generation : callable
        Called with the run (from 0) and every new `Generation`.
    on_run : callable
        Called with the run (from 0) and its history when it ends.
    keep : callable
        Called with the run (from 0), its memory, and whether a stage has just ended.
    should_stop : callable
        Asked after every generation; True ends the fit and keeps what was found.
    """

    on_generation: Callable[[int, Generation], None] = _ignore
    on_run: Callable[[int, RunHistory], None] = _ignore
    keep: Callable[[int, RunMemory, bool], None] = _ignore
    should_stop: Callable[[], bool] = lambda: False


_NO_HOOKS = Hooks()


class _Breeds(Protocol):
    def __call__(
        self, name: str, n_free: int, population: int, seed: int, start: Start | None
    ) -> Breeder: ...


def run_one(
    objective: Objective,
    settings: SearchSettings,
    run: int = 0,
    *,
    time_limit: float | None = None,
    memory: RunMemory | None = None,
    hooks: Hooks = _NO_HOOKS,
    breeds: _Breeds = breeder,
    candidate_time: float | None = None,
) -> RunHistory:
    """Run one of the independent runs of a fit.

    Parameters
    ----------
    run : int
        Which one, from 0.
    time_limit : float, optional
        Of this run, from now [s].
    memory : RunMemory, optional
        What was scored before the run was cut off; it is continued, and the memory grows.
    breeds : callable
        `breeder`, or `BreederApart` to breed in another process.
    candidate_time : float, optional
        What a candidate takes to score [s], until it was measured; a first generation that would take over
        a second is then scored in parts.

    Raises
    ------
    FitError
        When there is no free parameter, a cost is not finite, or the memory is of another search.
    """
    if not objective.space.free:
        raise FitError("no parameter is free, so there is nothing to fit; name the free ones in the campaign")
    seed = settings.run_seeds()[run]
    memory = RunMemory(seed) if memory is None else memory
    memory.reopen()
    return _Run(objective, settings, run, seed, time_limit, memory, hooks, breeds, candidate_time).history()


@dataclass
class _Run:
    objective: Objective
    settings: SearchSettings
    run: int
    seed: int
    time_limit: float | None
    memory: RunMemory
    hooks: Hooks
    breeds: _Breeds
    candidate_time: float | None
    started: float = field(default_factory=lambda: time.perf_counter())
    evaluations: int = 0
    simulations: int = 0
    before: float = 0.0  # wall time of the stages that have ended [s]
    lowest: float = float("inf")

    def history(self) -> RunHistory:
        stages: list[StageHistory] = []
        start: Start | None = None
        left = list(self.settings.stages)
        while left:
            number, name = len(stages), left.pop(0)
            memory = self.memory.stage(number, name)
            if name == "least-squares":
                population = 0
                bred: Breeder = LeastSquares(self.objective, stages[-1].cube[-1], stages[-1].cost[-1])
            else:
                small = self.settings.first_generations or (start is not None and start.axes is not None)
                finishing = ROUGH_POPULATION if small else FINISH_POPULATION
                searching = name == self.settings.algorithm
                population = self.settings.population if searching else finishing
                seed = self.seed if searching else _child_seed(self.seed, number)
                bred = self.breeds(name, len(self.objective.space.free), population, seed, start)
            with closing(bred):
                stages.append(self._bred(name, bred, self._rule(name, number, population), memory))
                start = bred.start()
            self.before += stages[-1].wall_time
            reason = stages[-1].stop_reason
            if reason == "interrupted":
                break
            if name == "least-squares":
                # Where more is left than noise, the search goes on as if least squares had not been tried.
                left += [self.settings.algorithm] * (reason == "unexplained") + ["cmaes"]
        return RunHistory(self.seed, tuple(stages))

    def _rule(self, name: str, number: int, population: int) -> StopRule:
        """Return the rule of a stage; of the run's budgets all stages but the last get a share."""
        fast = self.settings.finish == "least-squares"
        last = name == "cmaes" or len(self.settings.stages) == 1
        share = 1.0 if last else (_FAST_SHARES if fast else _SHARES)[number]
        rule = replace(self.settings.stop.share(self.settings.runs), time_limit=None)
        if rule.max_evaluations is not None:
            rule = replace(rule, max_evaluations=int(share * rule.max_evaluations))
        if self.time_limit is not None:
            rule = replace(rule, time_limit=share * self.time_limit)
        if name == "least-squares":
            rule = replace(rule, tolerance=0.0)
        elif name == "cmaes":
            window = 10 + ceil(30 * len(self.objective.space.free) / population)
            rule = replace(
                rule, reading="relative", window=window, tolerance=CMAES_TOLERANCE, spread=CMAES_SPREAD
            )
        elif number == 0 and (first := self.settings.first_generations or FIRST_GENERATIONS * fast):
            rule = replace(rule, max_generations=min(rule.max_generations, first))
        return rule

    def _bred(self, name: str, bred: Breeder, rule: StopRule, memory: StageMemory) -> StageHistory:
        remembered, already = len(memory.cost), memory.spent
        # While a checkpoint is replayed, Ctrl-C and the clock do not end a stage that had ended already: the
        # next stage starts from its last generation.
        open_end = memory.ended is None
        began = time.perf_counter()
        generations: list[Generation] = []
        best: list[float] = []
        evaluations_before, simulations_before = self.evaluations, self.simulations
        reason: StopReason | None = None
        residuals: FloatArray | None = None
        while reason is None:
            points = bred.ask()
            if points is None:
                reason = bred.ended
                break
            new = len(generations) >= remembered
            if not new and not memory.recalls(len(generations), points, self.memory.elsewhere):
                self.memory.forget_from(memory, len(generations))
                new, remembered = True, len(generations)
            if new:
                scored, residuals = self._scored(points, memory, already - began, bred.needs_residuals)
                elapsed = already + time.perf_counter() - began
                memory.append(points, scored, elapsed, causes_of(self.objective))
            elif bred.needs_residuals:
                # What is remembered are costs: the finisher takes seconds, so it is simulated again.
                residuals = self.objective.examine(points)[1]
            bred.tell(memory.cost[len(generations)], residuals)
            generation = self._generation(memory, len(generations), name, bred.population())
            generations.append(generation)
            best.append(min([*best[-1:], float(generation.cost.min())]))
            if new:
                self.hooks.on_generation(self.run, generation)
            # What was remembered was not ended by clock or user then.
            live = new or (open_end and len(generations) == remembered)
            if live and self.hooks.should_stop():
                reason = "interrupted"
            else:
                elapsed = time.perf_counter() - self.started if live else 0.0
                spread = _spread(memory.cost[len(generations) - 1])
                reason = rule.reason(best, self.evaluations, len(points), elapsed, spread)
            if new and reason is None:
                self.hooks.keep(self.run, self.memory, False)
        if not generations:
            raise FitError(f"{name} bred no candidate at all; widen the bounds or enlarge the population")
        memory.ended = reason
        self.hooks.keep(self.run, self.memory, True)
        return StageHistory(
            algorithm=name,
            cube=np.stack([g.cube for g in generations]),
            cost=np.stack([g.cost for g in generations]),
            failed=np.array([g.failed for g in generations], dtype=np.int64),
            causes=tuple(memory.causes[: len(generations)]),
            evaluations=self.evaluations - evaluations_before,
            simulations=self.simulations - simulations_before,
            wall_time=already + time.perf_counter() - began,
            stop_reason=reason,
        )

    def _scored(
        self, points: FloatArray, memory: StageMemory, offset: float, residuals: bool
    ) -> tuple[Evaluation, FloatArray | None]:
        """Score a generation; one that takes long in parts, each of which is kept.

        Rows do not know each other, so the cut changes no bit. `offset` brings the clock to the stage's [s].
        With `residuals` they are returned as well, and there are no parts.
        """
        if residuals:
            return self.objective.examine(points)
        done = memory.recalls_begun(points, self.memory.elsewhere)
        while True:
            size = self._part(len(points) - done)
            began = time.perf_counter()
            scored = _scored(self.objective, points[done : done + size])
            now = time.perf_counter()
            self.candidate_time = (now - began) / size
            if size == len(points):
                return scored, None
            begun = memory.begin(points, scored, offset + now)
            done += size
            if done == len(points):
                return Evaluation(begun.cost, begun.failed, begun.simulations), None
            self.hooks.keep(self.run, self.memory, False)

    def _part(self, left: int) -> int:
        """Return how many of the candidates that are left make a part."""
        parts = 1 if self.candidate_time is None else ceil(left * self.candidate_time / PART_TIME)
        return ceil(left / max(parts, 1))

    def _generation(
        self, memory: StageMemory, index: int, name: str, population: tuple[FloatArray, FloatArray]
    ) -> Generation:
        cube, cost = population
        self.evaluations += len(memory.cost[index])
        self.simulations += memory.simulations[index]
        self.lowest = min(self.lowest, float(cost.min()))
        return Generation(
            number=index + 1,
            cube=cube,
            cost=cost,
            failed=memory.failed[index],
            evaluations=self.evaluations,
            simulations=self.simulations,
            elapsed=self.before + memory.elapsed[index],
            algorithm=name,
            lowest=self.lowest,
        )


def _spread(cost: FloatArray) -> float:
    """Return how far the median lies above the lowest, as a share of that [1]."""
    low, middle = float(cost.min()), float(np.median(cost))
    return (middle - low) / low if low > 0 else float("inf") if middle > low else 0.0


def _child_seed(seed: int, stage: int) -> int:
    return int(np.random.SeedSequence(seed, spawn_key=(stage,)).generate_state(1, np.uint32)[0])


def _scored(objective: Objective, points: FloatArray) -> Evaluation:
    scored = objective.evaluate(points)
    if scored.cost.shape != (len(points),) or not np.all(np.isfinite(scored.cost)):
        bad = int(np.count_nonzero(~np.isfinite(scored.cost)))
        raise FitError(
            f"{bad} of {len(points)} candidates have no finite NRMSE; a failed simulation must score its "
            "penalty, so please report this campaign"
        )
    return scored


def run_many(
    objective: Objective,
    settings: SearchSettings,
    *,
    memories: Sequence[RunMemory] = (),
    hooks: Hooks = _NO_HOOKS,
    at_once: int = 1,
    breeds: _Breeds = breeder,
    candidate_time: float | None = None,
) -> tuple[RunHistory, ...]:
    """Run the independent runs of a fit.

    Parameters
    ----------
    objective : Objective
        Scores from several threads when `at_once` is above 1.
    memories : sequence of RunMemory
        What runs had scored before they were cut off, by seed.
    hooks : Hooks
        Never called from two threads at a time.
    at_once : int
        Runs that are searched at the same time, so that machines do not idle at a generation's end. The
        numbers do not depend on it.
    breeds, candidate_time
        As of `run_one`.

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
    known = {memory.seed: memory for memory in memories}
    hooks = _one_at_a_time(hooks)
    failed = threading.Event()

    def stop() -> bool:
        return failed.is_set() or hooks.should_stop()

    def search_run(run: int) -> RunHistory | None:
        if run and stop():
            return None
        limit = settings.stop.time_limit
        if limit is not None:
            rounds = ceil((settings.runs - run) / at_once)
            limit = max(0.0, limit - (time.perf_counter() - started)) / rounds
        history = run_one(
            objective,
            settings,
            run,
            time_limit=limit,
            memory=known.get(settings.run_seeds()[run]),
            hooks=replace(hooks, should_stop=stop),
            breeds=breeds,
            candidate_time=candidate_time,
        )
        hooks.on_run(run, history)
        return history

    if at_once <= 1:
        histories = [search_run(run) for run in range(settings.runs)]
    else:
        pool = ThreadPoolExecutor(at_once, thread_name_prefix="run")
        futures = [pool.submit(search_run, run) for run in range(settings.runs)]
        try:
            # With a timeout, so that Ctrl-C is heard on every system while this thread waits.
            while wait(futures, _HEARING, FIRST_EXCEPTION).not_done and not _one_failed(futures):
                pass
            if _one_failed(futures):
                failed.set()
            histories = [future.result() for future in futures]
        finally:
            # A run that waits for a cluster ends when the cluster is closed.
            failed.set()
            pool.shutdown(wait=False, cancel_futures=True)
    return tuple(history for history in histories if history is not None)


def _one_failed(futures: Sequence[Future[RunHistory | None]]) -> bool:
    return any(future.done() and future.exception() is not None for future in futures)


def _one_at_a_time(hooks: Hooks) -> Hooks:
    """Return hooks that never run in two threads at once."""
    lock = threading.Lock()

    def guarded(call: Callable[..., None]) -> Callable[..., None]:
        def locked(*arguments: object) -> None:
            with lock:
                call(*arguments)

        return locked

    return Hooks(guarded(hooks.on_generation), guarded(hooks.on_run), guarded(hooks.keep), hooks.should_stop)
