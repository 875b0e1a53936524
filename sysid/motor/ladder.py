"""The ladder: what each step of the model buys, on trials that the search has not seen.

    first-order lag → equations (1-3) without L → full → full with saturation

The same search fits every rung to the same forward and reverse trials: CMA-ES with one population, stop rule
and seed, once from near the fit's best set, as far as the rung has its parameters, and once from all around
it. The better run counts, so that no rung is worse for a search that did not find its optimum. Rungs below
the last are scored without a dead band, which only starts from rest and reversals show. Judge a step by its
held-out columns: an inductance is not real because a search returned one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.fit.breeders.algorithms import Start, breeder
from sysid.fit.breeders.breeder import Breeder
from sysid.fit.history import RunHistory
from sysid.fit.objective import SpreadObjective
from sysid.fit.search import Hooks, SearchSettings, run_many
from sysid.motor import first_order_lag as lag
from sysid.motor.cost import CHANNELS, MotorTarget
from sysid.motor.curves import supply_ratio
from sysid.motor.known_values import SATURATION, Bench
from sysid.motor.log_delays import averaged, own_rows, shifts
from sysid.motor.parameters import SENSORS
from sysid.motor.problem import MotorProblem
from sysid.motor.static_curves import turns
from sysid.motor.targets import PreparedTrial
from sysid.parallel import LocalThreads
from sysid.parameters import ParameterTable, SearchSpace
from sysid.types import FloatArray

# Every rung's search, of two to some ten parameters. From the best set a search keeps to the valley of the
# full model; 0.3 of the cube's edge, cma's own advice for a bounded one, leaves it where a better one is.
_POPULATION, _SPREADS = 24, (0.1, 0.3)
# Compared instants below which a group of samples has no NRMSE, and their least standard deviation as a share
# of the trial's: a start that a stall cuts down to a rotor at rest has none.
_LEAST, _LEAST_SPREAD = 10, 0.1
# Rises within a thousandth of any step that a log shows.
_NO_INDUCTANCE = 1e-8
# What is scored, in the order of the table: (use, part of a trial) and its name.
GROUPS = {
    ("fit", "running"): "fitted",
    ("validate", "running"): "held out",
    ("fit", "start"): "starts, fitted",
    ("validate", "start"): "starts, held out",
    ("fit", "reversal"): "reversals, fitted",
    ("validate", "reversal"): "reversals, held out",
}
_Part = tuple[PreparedTrial, MotorTarget, str]


@dataclass(frozen=True, eq=False)
class Rung:
    """One model of the ladder.

    `values` are the free parameters by name [SI], `nrmse` the means (torque, speed) over the parts of trials
    of each group [1], `evaluations` the candidates that its search scored.
    """

    name: str
    values: dict[str, float]
    nrmse: dict[str, tuple[float, float]]
    evaluations: int

    def document(self, below: Rung | None) -> dict[str, Any]:
        """Return the rung as a result states it, with what it takes off the NRMSE of the rung below."""
        less: dict[str, tuple[float, float]] = {}
        if below is not None:
            less = {g: (below.nrmse[g][0] - t, below.nrmse[g][1] - s) for g, (t, s) in self.nrmse.items()}
        nrmse, buys = (
            {group: dict(zip(CHANNELS, pair, strict=True)) for group, pair in pairs.items()}
            for pairs in (self.nrmse, less)
        )
        names = ("rung", "values", "evaluations", "nrmse", "buys")
        return dict(zip(names, (self.name, self.values, self.evaluations, nrmse, buys), strict=True))


def _parts(bench: Bench, weights: tuple[float, float]) -> list[_Part]:
    """Return what the rungs are scored on: parts of the bench's trials, each with its group."""
    out = []
    for trial in bench.trials:
        use, whole = trial.entry.use, trial.target
        if trial.entry.direction == "reversal":
            out.append((trial, whole, GROUPS[use, "reversal"]))
            continue
        out.append((trial, trial.dynamic_target, GROUPS[use, "running"]))
        starts = replace(whole, valid=whole.valid & trial.started[:, None])
        if all(_scorable(whole, starts, c) for c in range(2) if weights[c] > 0):
            out.append((trial, starts, GROUPS[use, "start"]))
    return out


def _scorable(whole: MotorTarget, part: MotorTarget, channel: int) -> bool:
    inside, values = part.valid[:, channel], whole.measured[:, channel]
    if np.count_nonzero(inside) < _LEAST:
        return False
    return bool(np.std(values[inside]) >= _LEAST_SPREAD * np.std(values[whole.valid[:, channel]]))


class LagProblem(MotorProblem):
    """First-order lags on the same trials: rows of the lag's table and the delays of logs."""

    def complete(self, rows: FloatArray) -> FloatArray:
        """Return the rows: nothing of a lag follows from the others."""
        return rows

    def simulate(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return samples (P, n_total, 2) on the trials' grids; every lag reaches the end of every trial."""
        delays = shifts(self.space.table, rows, self.prepared)
        return lag.simulate_lag(rows, self.jobs, delays), np.ones((len(rows), len(self.jobs)))


def lag_space(space: SearchSpace, bench: Bench) -> SearchSpace:
    """Return what the first rung frees.

    Its delays are free where those of the motor are; its steady speeds come from the loaded steady points.
    """
    delays = own_rows(space)
    free = ["rise_time_constant", "fall_time_constant"]
    free += [name for name in ("command_delay", *SENSORS, *delays) if name in space.names]
    table = ParameterTable([*lag.PARAMETERS.values(), *(space.table[name] for name in delays)])
    values = {name: value for name, value in space.fixed.items() if name in table}
    values |= {name: value for name, value in bench.curves.parameters.items() if name in table}
    for direction, points in bench.curves.loaded.items():
        turning = turns(points.u, direction)
        ratio = supply_ratio(points, bench.curves.reference_voltage)
        powers = lag.steady_speed_map(points.u[turning], points.speed[turning], ratio[turning])
        values |= {f"steady_speed_{power}_{direction}": float(p) for power, p in enumerate(powers)}
    bounds = {row.name: (row.lower, row.upper) for row in space.free if row.name in free}
    return SearchSpace.build(table, free, values, bounds)


@dataclass(frozen=True, eq=False)
class _Climb:
    """What every rung is fitted and scored with."""

    problem: MotorProblem
    parts: list[_Part]
    best: Mapping[str, float]
    budget: SearchSettings
    hooks: Hooks

    def build(
        self, model: type[MotorProblem], space: SearchSpace, trials: tuple[PreparedTrial, ...]
    ) -> MotorProblem:
        """Return a model on some trials, without their starts from rest."""
        p = self.problem
        return model.build(p.campaign, space, p.bench, trials, p.threads, dynamic=True)

    def search(self, problem: MotorProblem) -> tuple[FloatArray, dict[str, float], int]:
        """Return the best row (1, n_table), its free values by name, and how many candidates were scored."""
        space = problem.space
        begin = np.array([self.best.get(row.name, row.nominal) for row in space.free])
        point = space.encode(begin).clip(0.0, 1.0)
        spreads = dict(zip(self.budget.run_seeds(), _SPREADS, strict=True))

        def near(name: str, n_free: int, population: int, seed: int, start: Start | None) -> Breeder:
            return breeder(name, n_free, population, seed, Start(point, np.full(n_free, spreads[seed])))

        with LocalThreads() as where:
            spread = SpreadObjective(problem, where)
            runs = run_many(spread, self.budget, hooks=self.hooks, at_once=where.at_once, breeds=near)
        run: RunHistory = min(runs, key=lambda history: float(history.best[-1]))
        values = dict(zip(space.names, space.decode(run.best_point).tolist(), strict=True))
        row = averaged(space, space.full(run.best_point))
        # A log that only the stage of the dead band saw has its delay from there.
        for name in own_rows(space):
            if name in self.best:
                row[:, space.table.index[name]] = self.best[name]
        return row, values, sum(history.evaluations for history in runs)

    def rung(self, model: type[MotorProblem], name: str, space: SearchSpace) -> tuple[Rung, FloatArray]:
        """Fit and score a model without a dead band; return the rung and its row (1, n_table)."""
        row, values, spent = self.search(self.build(model, space, self.problem.bench.fitted))
        return Rung(name, values, self.scored(model, space, row, ideal=True), spent), row

    def scored(
        self, model: type[MotorProblem], space: SearchSpace, row: FloatArray, *, ideal: bool
    ) -> dict[str, tuple[float, float]]:
        """Return the means of every group of a row (1, n_table), without a dead band where `ideal`."""
        trials, targets, groups = zip(*self.parts, strict=True)
        every = replace(self.build(model, space, trials), targets=targets, ideal_reversal=ideal)
        nrmse = every.score(row).by_channel[0]
        out = {}
        for title in GROUPS.values():
            rows = [i for i, group in enumerate(groups) if group == title]
            if rows:
                torque, speed = nrmse[rows].mean(axis=0)
                out[title] = (float(torque), float(speed))
        return out


def climb(
    problem: MotorProblem,
    best: Mapping[str, float],
    saturated: bool,
    settings: SearchSettings,
    seed: int,
    should_stop: Callable[[], bool] = lambda: False,
) -> tuple[Rung, ...]:
    """Fit every rung to the fitted trials, score it on every trial.

    The searches begin at `best`, the fit's best set by name [SI]; names left out begin at their nominal
    values. The last rung takes its dead band, which was fitted or given where `saturated`, and every rung its
    delays of the logs that only the stage of the dead band saw. The stop rule of `settings` counts;
    `should_stop` is asked after every generation, and raises where the fit must end.
    """
    # An eighth of the paper's population may take eight times the generations of a run.
    generations = 8 * settings.stop.max_generations
    stop = replace(settings.stop, max_generations=generations, time_limit=None, max_evaluations=None)
    budget = SearchSettings(_POPULATION, len(_SPREADS), seed, stop, "cmaes", "none")
    space, weights = problem.space, problem.campaign.cost.weights
    parts = _parts(problem.bench, (weights.torque, weights.speed))
    up = _Climb(problem, parts, best, budget, Hooks(should_stop=should_stop))
    rungs = [up.rung(LagProblem, "first-order lag", lag_space(space, problem.bench))[0]]
    if "winding_inductance" in space.names:
        fixed = {**space.fixed, "winding_inductance": _NO_INDUCTANCE}
        free = tuple(row for row in space.free if row.name != "winding_inductance")
        rungs.append(up.rung(MotorProblem, "without L", SearchSpace(space.table, free, fixed))[0])
    full, row = up.rung(MotorProblem, "full", space)
    rungs.append(full)
    for name in SATURATION:
        row[:, space.table.index[name]] = best[name]
    last = up.scored(MotorProblem, space, row, ideal=False)
    # A log that starts from rest passes the dead band as well, and a dead band that was not fitted must show.
    if saturated or any(not np.allclose(last[g], full.nrmse[g], rtol=1e-3, equal_nan=True) for g in last):
        values = full.values | {name: float(best[name]) for name in SATURATION}
        name = "full with saturation" if saturated else "full, saturation as in Table I"
        rungs.append(Rung(name, values, last, full.evaluations))
    return tuple(rungs)


def ladder_sentences(ladder: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return what the held-out trials say about L, in sentences for the warnings of a result."""
    by_name = {rung["rung"]: rung["nrmse"] for rung in ladder}
    if "full" not in by_name:
        return ()
    if "held out" not in by_name["full"]:
        return (
            "no forward or reverse trial is held out (use = 'validate'): the ladder cannot say what a fitted "
            "parameter is worth",
        )
    if "without L" not in by_name:
        return ()
    without, full = (float(np.nanmean(list(by_name[n]["held out"].values()))) for n in ("without L", "full"))
    # Below a twentieth of the error itself a step is within what another day's log would change.
    if full < 0.95 * without:
        return ()
    return (
        f"the inductance buys nothing on held-out trials: NRMSE {100 * without:.2f} % without L, "
        f"{100 * full:.2f} % with it; do not believe the fitted L",
    )
