"""The search: independent runs, each a stage of one algorithm and a finisher, ended by declared rules.

Where the campaign states no value with an error and least squares leaves more than noise explains, the search
goes on, least squares begins again, now with whole windows, and CMA-ES follows unless two fronts agree.

sysid scores a whole population at once and decides when to end; one generation is one ask-and-tell of a
`sysid.fit.breeders.algorithms.Breeder`.

Same objective, settings and version give identical numbers: run ``i`` draws from the ``i``-th child of the
seed (`numpy.random.SeedSequence`), so it is reproducible without the runs before it, and every stage of it
from a child of that. The order and the interleaving of runs change nothing, nor does the order in which a
campaign names its trials (`sysid.fit.trial.name_order`).
"""

import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from math import ceil
from typing import get_args

import numpy as np

from sysid.errors import FitError
from sysid.fit.breeders.algorithms import breeder
from sysid.fit.breeders.breeder import Breeder, Keeping, Start
from sysid.fit.checkpoint import Checkpoint
from sysid.fit.history import Generation, RunHistory, StageHistory
from sysid.fit.least_squares import LeastSquares
from sysid.fit.problem import Problem
from sysid.fit.settings import SearchSettings
from sysid.fit.stopping import CutReason, StopReason
from sysid.fit.trial import EXPLAINED, count_causes, noise_floor
from sysid.types import FloatArray

# CMA-ES is not elitist and learns its shape over tens of generations, so its best cost stands still longer
# than a GA's: its window is cma's default of 10 + 30 n/P generations, its tolerance a tenth of the paper's.
CMAES_TOLERANCE = 1e-5
# The tolerance after least squares, which has found the valley: more digits would say nothing of a model that
# leaves more than noise.
ROUGH_TOLERANCE = 2e-4
# Stop CMA-ES only when the median cost lies within 1 % of the best; at the bottom of a valley this spread is
# 1e-5 to 1e-4, at a random start 0.1 and above.
CMAES_SPREAD = 0.01
# Population of CMA-ES as a finisher; chosen by tests/benchmarks/engine.py.
FINISH_POPULATION = 64
# Population of CMA-ES after least squares, and of a search of few parameters: the axes of the cost are known,
# so a small population has to learn no others.
ROUGH_POPULATION = 16
# Generations that least squares needs to find its starts, and as many more as it needs for whole windows.
_FIRST_GENERATIONS, _MORE_GENERATIONS = 3, 7
# Cumulative share of the budget that each non-final stage may use [1], without and with least squares.
_SHARES, _FAST_SHARES = (0.6, 0.8), (0.3, 0.5, 0.6, 0.8)
# NRMSE over noise up to which nothing but noise is left [1]: CMA-ES after least squares takes 1e-5 off such a
# fit, and up to 0.3 % off one at 1.1.
_ALL_BUT_NOISE = 1.05
# Reasons that end a stage before its time: resumed, it starts again.
_CUT = get_args(CutReason)
# Polling interval for Ctrl-C [s].
_HEARING = 0.2


@dataclass(frozen=True)
class Hooks:
    """What a search calls, and what may end it."""

    # Called with the run (from 0) and every new `Generation`.
    on_generation: Callable[[int, Generation], None] = lambda run, generation: None
    # Called with the run (from 0) and its history when it ends.
    on_run: Callable[[int, RunHistory], None] = lambda run, history: None
    # Asked after every generation; True ends the fit and keeps what was found.
    should_stop: Callable[[], bool] = lambda: False
    # Taken around the other calls: they are never made from two threads at a time.
    lock: threading.Lock = field(default_factory=threading.Lock)


_NO_HOOKS = Hooks()


def run_one(
    objective: Problem,
    settings: SearchSettings,
    run: int = 0,
    *,
    time_limit: float | None = None,
    checkpoint: Checkpoint | None = None,
    hooks: Hooks = _NO_HOOKS,
    first_generations: int | None = None,
) -> RunHistory:
    """Run one of the independent runs of a fit, numbered from 0; the `time_limit` counts from now [s].

    Finished stages of the `checkpoint` are taken as they are; those that finish now are kept there.
    `first_generations` limits the stages before least squares [1], by default to three, and to seven more
    where a second pair follows; CMA-ES after it is a small one then. Raises FitError when there is no free
    parameter, a cost is not finite, or the checkpoint cannot be used.
    """
    if not objective.space.free:
        raise FitError("no parameter is free, so there is nothing to fit; name the free ones in the campaign")
    return _Run(objective, settings, run, time_limit, checkpoint, hooks, first_generations).history()


@dataclass
class _Run:
    objective: Problem
    settings: SearchSettings
    run: int
    time_limit: float | None
    checkpoint: Checkpoint | None
    hooks: Hooks
    first_generations: int | None
    started: float = field(default_factory=lambda: time.perf_counter())
    evaluations: int = 0
    simulations: int = 0
    before: float = 0.0  # wall time of the stages that have ended [s]
    # Generation of the lowest cost, in the form of a one-generation stage.
    best: StageHistory | None = None

    def history(self) -> RunHistory:
        seed = run_seeds(self.settings)[self.run]
        space = self.objective.space
        n_free, n_found = len(space.free), len(space.found)
        # Only least squares moves what the campaign states; a search without a finisher moves nothing of it.
        kept_values = space.encode(np.array([row.nominal for row in space.free]))[n_found:]
        if self.checkpoint is not None:
            self.best = self.checkpoint.best(self.run, n_free)
        stages: list[StageHistory] = []
        start: Start | None = None
        # Lowest NRMSE [1] of every stage of least squares, and where CMA-ES would go on from it.
        ends: list[tuple[float, Start]] = []
        cut: StopReason | None = None
        # The search of the first stage, which a second pair of stages goes on with.
        searched: Breeder | None = None
        left = list(self.settings.stages)
        if space.stated and "least-squares" not in left and self.settings.finish != "none":
            left.append("least-squares")
        while left:
            number, name = len(stages), left.pop(0)
            kept = None
            if self.checkpoint is not None:
                kept = self.checkpoint.finished(self.run, number, name, n_free)
            if kept is not None:
                stage, start = kept
                self.evaluations += stage.evaluations
                self.simulations += stage.simulations
            else:
                if name == "least-squares":
                    population = 0
                    before = stages[-1]
                    bred: Breeder = LeastSquares(
                        self.objective, before.cube[-1], before.cost[-1], whole=bool(ends)
                    )
                else:
                    small = self.first_generations or (start is not None and start.axes is not None)
                    finishing = ROUGH_POPULATION if small else FINISH_POPULATION
                    searching = name == self.settings.algorithm
                    population = self.settings.population if searching else finishing
                    child = np.random.SeedSequence(seed, spawn_key=(number,))
                    own = seed if searching else int(child.generate_state(1, np.uint32)[0])
                    if start is not None:
                        start = replace(start, mean=start.mean[:n_found], spread=start.spread[:n_found])
                    bred = Keeping(breeder(name, n_found, population, own, start), kept_values)
                    if ends and left:
                        bred = searched or self._again(bred, len(stages[0].cost))
                    searched = bred
                stage = self._bred(name, bred, self._limits(name, number, population, last=not left))
                start = bred.start()
                if stage.stop_reason in _CUT:
                    cut = stage.stop_reason
                # A stage after one that was cut short is not that of an uninterrupted run.
                if self.checkpoint is not None and cut is None:
                    self.checkpoint.keep(self.run, number, stage, start)
            stages.append(stage)
            self.before += stage.wall_time
            if stage.stop_reason == "interrupted":
                break
            if name == "least-squares" and not space.stated:
                ends.append((float(stage.cost.min()), start))
                least, start = min(ends, key=lambda end: end[0])
                floor = noise_floor(self.objective.blocks)
                # Two fronts over whole windows agree on what noise does not explain.
                agreed = stage.stop_reason == "converged" and EXPLAINED * floor < least == ends[-1][0]
                if stage.stop_reason == "unexplained" and len(ends) == 1:
                    # A wrong model that fits the first part of a window may not fit the whole window.
                    left += [self.settings.algorithm, name]
                elif least > _ALL_BUT_NOISE * floor and not agreed:
                    # The cost is rough: CMA-ES goes on from there.
                    left.append("cmaes")
        # The run was farther when it was killed or stopped before.
        if cut and self.best is not None and self.best.cost.min() < min(stage.cost.min() for stage in stages):
            stages.append(replace(self.best, stop_reason=cut))
        return RunHistory(seed, tuple(stages))

    def _again(self, bred: Breeder, generations: int) -> Breeder:
        """Return a breeder after its first generations, which were scored before the run was killed."""
        for _ in range(generations):
            asked = bred.ask()
            assert asked is not None, "it was asked as often before"
            bred.tell(self.objective.evaluate(asked).cost)
        return bred

    def _limits(self, name: str, number: int, population: int, last: bool) -> SearchSettings:
        """Return when a stage ends; of the run's budgets all stages but the last get a share."""
        fast = "least-squares" in self.settings.stages
        # Another search may follow least squares.
        last &= name != "least-squares" or bool(self.objective.space.stated)
        share = 1.0 if last else (_FAST_SHARES if fast else _SHARES)[number]
        limits = replace(self.settings.of_a_run(), time_limit=None)
        if limits.max_evaluations is not None:
            limits = replace(limits, max_evaluations=int(share * limits.max_evaluations))
        if self.time_limit is not None:
            limits = replace(limits, time_limit=share * self.time_limit)
        if name == "least-squares":
            # A walk breeds no generations, and its iterations are limited.
            limits = replace(limits, stop_tolerance=0.0, max_generations=sys.maxsize)
        elif name == "cmaes":
            window = 10 + ceil(30 * len(self.objective.space.free) / population)
            tolerance = ROUGH_TOLERANCE if fast and number else CMAES_TOLERANCE
            limits = replace(limits, stop_reading="relative", stop_window=window, stop_tolerance=tolerance)
        elif few := self.first_generations or fast * (_MORE_GENERATIONS if number else _FIRST_GENERATIONS):
            limits = replace(limits, max_generations=min(limits.max_generations, few))
        return limits

    def _bred(self, name: str, bred: Breeder, limits: SearchSettings) -> StageHistory:
        began, causes = time.perf_counter(), self.objective.causes
        evaluations_before, simulations_before = self.evaluations, self.simulations
        generations: list[Generation] = []
        failures: list[dict[str, int]] = []
        best: list[float] = []
        reason: StopReason | None = None

        def history(reason: StopReason, part: slice) -> StageHistory:
            return StageHistory(
                algorithm=name,
                cube=np.stack([g.cube for g in generations[part]]),
                cost=np.stack([g.cost for g in generations[part]]),
                failed=np.array([g.failed for g in generations[part]], dtype=np.int64),
                causes=tuple(failures[part]),
                evaluations=self.evaluations - evaluations_before,
                simulations=self.simulations - simulations_before,
                wall_time=time.perf_counter() - began,
                stop_reason=reason,
            )

        while reason is None:
            points = bred.ask()
            if points is None:
                reason = bred.ended
                break
            if bred.needs_residuals:
                scored, residuals = self.objective.examine(points)
            else:
                scored, residuals = self.objective.evaluate(points), None
                bad = int(np.count_nonzero(~np.isfinite(scored.cost)))
                if bad or scored.cost.shape != (len(points),):
                    raise FitError(
                        f"{bad} of {len(points)} candidates have no finite NRMSE; a failed simulation must "
                        "score its penalty, so please report this campaign"
                    )
            bred.tell(scored.cost, residuals)
            self.evaluations += len(points)
            self.simulations += scored.simulations
            cube, cost = bred.population()
            lowest = float("inf") if self.best is None else float(self.best.cost.min())
            generation = Generation(
                number=len(generations) + 1,
                cube=cube,
                cost=cost,
                failed=int(np.count_nonzero(scored.failed)),
                evaluations=self.evaluations,
                simulations=self.simulations,
                elapsed=self.before + time.perf_counter() - began,
                algorithm=name,
                lowest=min(lowest, float(cost.min())),
            )
            generations.append(generation)
            failures.append(count_causes(scored.failed, causes))
            best.append(min([*best[-1:], float(cost.min())]))
            if cost.min() < lowest:
                self.best = history("interrupted", slice(-1, None))
            with self.hooks.lock:
                self.hooks.on_generation(self.run, generation)
            if self.hooks.should_stop():
                reason = "interrupted"
            else:
                elapsed = time.perf_counter() - self.started
                settled = name != "cmaes" or _spread(scored.cost) <= CMAES_SPREAD
                reason = limits.stop_reason(best, self.evaluations, len(points), elapsed, settled)
            if self.checkpoint is not None and self.best is not None:
                self.checkpoint.keep_best(self.run, self.best, now=reason is not None)
        if not generations:
            raise FitError(f"{name} bred no candidate at all; widen the bounds or enlarge the population")
        return history(reason, slice(None))


def _spread(cost: FloatArray) -> float:
    """Return how far the median lies above the lowest, as a share of that [1]."""
    low, middle = float(cost.min()), float(np.median(cost))
    return (middle - low) / low if low > 0 else float("inf") if middle > low else 0.0


def run_seeds(settings: SearchSettings) -> tuple[int, ...]:
    """Return the seed of every run; more runs keep the first ones."""
    children = np.random.SeedSequence(settings.seed).spawn(settings.runs)
    return tuple(int(child.generate_state(1, np.uint32)[0]) for child in children)


def run_many(
    objective: Problem,
    settings: SearchSettings,
    *,
    checkpoint: Checkpoint | None = None,
    hooks: Hooks = _NO_HOOKS,
    at_once: int = 1,
) -> tuple[RunHistory, ...]:
    """Run the independent runs of a fit, see `run_one`; return those that were begun.

    Fewer than `settings.runs` are begun only when the fit is interrupted. Several runs `at_once` keep
    machines from idling at a generation's end and change no number; the objective then scores from several
    threads. The evaluation budget is divided equally; of the time that is left each run gets an equal share,
    so that a fit cut by its time limit still has one set per run.
    """
    started = time.perf_counter()
    failed = threading.Event()

    def stop() -> bool:
        return failed.is_set() or hooks.should_stop()

    def search_run(run: int) -> RunHistory | None:
        if run and stop() and not (checkpoint is not None and checkpoint.begun(run)):
            return None
        limit = settings.time_limit
        if limit is not None:
            rounds = ceil((settings.runs - run) / at_once)
            limit = max(0.0, limit - (time.perf_counter() - started)) / rounds
        history = run_one(
            objective,
            settings,
            run,
            time_limit=limit,
            checkpoint=checkpoint,
            hooks=replace(hooks, should_stop=stop),
        )
        with hooks.lock:
            hooks.on_run(run, history)
        return history

    if at_once <= 1:
        histories = [search_run(run) for run in range(settings.runs)]
    else:
        pool = ThreadPoolExecutor(at_once, thread_name_prefix="run")
        futures = [pool.submit(search_run, run) for run in range(settings.runs)]
        try:
            left = {*futures}
            while left and not failed.is_set():
                # A wait without an end keeps Ctrl-C from this thread on Windows.
                ended, left = wait(left, _HEARING, FIRST_EXCEPTION)
                if any(future.exception() for future in ended):
                    failed.set()
            histories = [future.result() for future in futures]
        finally:
            # A run that waits for a cluster ends when the cluster is closed.
            failed.set()
            pool.shutdown(wait=False, cancel_futures=True)
    return tuple(history for history in histories if history is not None)
