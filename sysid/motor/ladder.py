"""The ladder: what each step of the model buys, on trials that the search has not seen.

    first-order lag → equations (1-3) without L → full → full with saturation

Every rung is fitted to the same forward and reverse trials by the same search: CMA-ES with one population,
stop rule and seed, once from near the fit's best set, as far as the rung has its parameters, and once from
all around it; the better one counts. So no rung is worse for a search that did not find its optimum. Rungs
below the last are scored without a dead band, which only starts from rest and reversals show. Judge a step by
its held-out columns: an inductance is not real because a search returned one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.campaign import MotorCampaign
from sysid.fit.breeders.algorithms import Breeder, Start, breeder
from sysid.fit.history import RunHistory
from sysid.fit.objective import Evaluation, Objective, SpreadObjective
from sysid.fit.search import Hooks, SearchSettings, run_many
from sysid.motor import first_order_lag as lag
from sysid.motor.batch import MotorTrials
from sysid.motor.cost import CHANNELS, MotorCost, MotorTarget
from sysid.motor.curves import StaticCurves
from sysid.motor.known_values import SATURATION, Bench
from sysid.motor.log_delays import averaged, own_rows, shifts
from sysid.motor.objective import MotorObjective, ties_of
from sysid.motor.targets import PreparedTrial
from sysid.parallel import LocalThreads
from sysid.parameters import ParameterTable, SearchSpace
from sysid.types import BoolArray, FloatArray

# Every rung's search, of two to some ten parameters. From the best set a search keeps to the valley of the
# full model; 0.3 of the cube's edge, cma's own advice for a bounded one, leaves it where a better one is.
_POPULATION, _SPREADS = 24, (0.1, 0.3)
# Compared instants below which a group of samples has no NRMSE, and their least standard deviation as a share
# of the trial's: a start that a stall cuts down to a rotor at rest has none.
_LEAST, _LEAST_SPREAD = 10, 0.1
# Rises within a thousandth of any step that a log shows.
_NO_INDUCTANCE = 1e-8
_SENSORS = ("torque_sensor_delay", "torque_sensor_lag", "speed_sensor_lag")
# What is scored, in the order of the table: (use, part of a trial) and its name.
GROUPS = {
    ("fit", "running"): "fitted",
    ("validate", "running"): "held out",
    ("fit", "start"): "starts, fitted",
    ("validate", "start"): "starts, held out",
    ("fit", "reversal"): "reversals, fitted",
    ("validate", "reversal"): "reversals, held out",
}


@dataclass(frozen=True, eq=False)
class Rung:
    """One model of the ladder.

    Parameters
    ----------
    name : str
    values : dict
        Free parameters by name [SI].
    nrmse : dict of group to (torque, speed)
        Means over the parts of trials of each group [1].
    evaluations : int
        Candidates that its search scored.
    """

    name: str
    values: dict[str, float]
    nrmse: dict[str, tuple[float, float]]
    evaluations: int

    def document(self, below: Rung | None) -> dict[str, Any]:
        """Return the rung as a result states it, with what it takes off the NRMSE of the rung below."""
        return {
            "rung": self.name,
            "values": self.values,
            "evaluations": self.evaluations,
            "nrmse": {group: dict(zip(CHANNELS, pair, strict=True)) for group, pair in self.nrmse.items()},
            "buys": {}
            if below is None
            else {
                group: {c: below.nrmse[group][i] - pair[i] for i, c in enumerate(CHANNELS)}
                for group, pair in self.nrmse.items()
            },
        }


@dataclass(frozen=True, eq=False)
class _Parts:
    """What the rungs are scored on: parts of the bench's trials, each with its group."""

    trials: tuple[PreparedTrial, ...]
    targets: tuple[MotorTarget, ...]
    groups: tuple[str, ...]

    @classmethod
    def of(cls, bench: Bench, weights: tuple[float, float]) -> _Parts:
        trials, targets, groups = [], [], []
        for trial in bench.trials:
            use, whole = trial.entry.use, trial.target
            if trial.entry.direction == "reversal":
                parts = [("reversal", whole)]
            else:
                starts = replace(whole, valid=whole.valid & trial.started[:, None])
                parts = [("running", trial.dynamic_target)]
                if all(_scorable(whole, starts, c) for c in range(2) if weights[c] > 0):
                    parts.append(("start", starts))
            for part, target in parts:
                trials.append(trial)
                targets.append(target)
                groups.append(GROUPS[use, part])
        return cls(tuple(trials), tuple(targets), tuple(groups))

    def means(self, nrmse: FloatArray) -> dict[str, tuple[float, float]]:
        """Return the means of (n_parts, 2) NRMSE over each group, in the order of the table."""
        out = {}
        for title in GROUPS.values():
            rows = [i for i, group in enumerate(self.groups) if group == title]
            if rows:
                torque, speed = nrmse[rows].mean(axis=0)
                out[title] = (float(torque), float(speed))
        return out


def _scorable(whole: MotorTarget, part: MotorTarget, channel: int) -> bool:
    inside, values = part.valid[:, channel], whole.measured[:, channel]
    if np.count_nonzero(inside) < _LEAST:
        return False
    return bool(np.std(values[inside]) >= _LEAST_SPREAD * np.std(values[whole.valid[:, channel]]))


@dataclass(frozen=True, eq=False)
class _Near:
    """Breeds a rung's searches around a point of the unit cube, each with the spread of its seed."""

    mean: FloatArray
    spread: Mapping[int, float]

    def __call__(self, name: str, n_free: int, population: int, seed: int, start: Start | None) -> Breeder:
        own = Start(self.mean, np.full(n_free, self.spread[seed])) if start is None else start
        return breeder(name, n_free, population, seed, own)


@dataclass(frozen=True, eq=False)
class LagObjective:
    """Mean NRMSE of first-order lags over bench trials.

    Parameters
    ----------
    space : SearchSpace
        Over the lag's table and the delays of logs.
    trials : tuple of PreparedTrial
    cost : MotorCost
    jobs : MotorTrials
    """

    space: SearchSpace
    trials: tuple[PreparedTrial, ...]
    cost: MotorCost
    jobs: MotorTrials

    def evaluate(self, cube: FloatArray) -> Evaluation:
        """Simulate and score unit-cube points (P, n_free)."""
        by_channel, failed = self.score(self.space.full(cube))
        return Evaluation(self.cost.mean(by_channel), np.any(failed, axis=1), failed.size)

    def score(self, rows: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return NRMSE (P, T, 2) and failures (P, T) of rows of the lag's table [SI]."""
        index = [list(lag.PARAMETERS).index(name) for name in _SENSORS]
        sensors = np.ascontiguousarray(rows[:, index])
        delays = shifts(self.space.table, rows, self.trials)
        samples = lag.simulate_lag(rows[:, : len(lag.PARAMETERS)], self.jobs, delays)
        return self.cost(samples, np.ones((len(rows), len(self.jobs))), sensors)


def lag_space(space: SearchSpace, bench: Bench) -> SearchSpace:
    """Return what the first rung frees.

    Its delays are free where those of the motor are; its steady speeds come from the loaded steady points.
    """
    own = own_rows(space)
    free = ["rise_time_constant", "fall_time_constant"]
    free += [name for name in ("command_delay", *_SENSORS, *own) if name in space.names]
    table = ParameterTable([*lag.PARAMETERS.values(), *(space.table[name] for name in own)])
    values = {name: value for name, value in space.fixed.items() if name in table}
    values |= {name: value for name, value in bench.curves.parameters.items() if name in table}
    values |= _steady_maps(bench.curves)
    bounds = {row.name: (row.lower, row.upper) for row in space.free if row.name in free}
    return SearchSpace.build(table, free, values, bounds)


def _steady_maps(curves: StaticCurves) -> dict[str, float]:
    out: dict[str, float] = {}
    for direction, points in curves.loaded.items():
        turning = (points.u > 0) if direction == "forward" else (points.u < 0)
        ratio = np.where(np.isfinite(points.voltage), points.voltage / curves.reference_voltage, 1.0)
        found = lag.steady_speed_map(points.u[turning], points.speed[turning], ratio[turning])
        out |= {f"steady_speed_{power}_{direction}": float(value) for power, value in enumerate(found)}
    return out


def climb(
    campaign: MotorCampaign,
    bench: Bench,
    space: SearchSpace,
    best: Mapping[str, float],
    saturated: bool,
    settings: SearchSettings,
    seed: int,
    threads: int | None = None,
    should_stop: Callable[[], bool] | None = None,
) -> tuple[Rung, ...]:
    """Fit every rung to the fitted trials, score it on every trial.

    Parameters
    ----------
    campaign : MotorCampaign
    bench : Bench
    space : SearchSpace
        Of the dynamic fit.
    best : mapping
        The fit's best set by name [SI], where the searches begin; its dead band is that of the last rung, and
        so are the delays of the logs that only the stage of the dead band saw. Names left out begin at their
        nominal values.
    saturated : bool
        Whether the dead band was fitted or given.
    settings : SearchSettings
        Its stop rule.
    seed : int
    threads : int, optional
    should_stop : callable, optional
        Asked after every generation; raises where the fit must end.
    """
    # An eighth of the paper's population may take eight times the generations of a run.
    generations = 8 * settings.stop.max_generations
    stop = replace(settings.stop, max_generations=generations, time_limit=None, max_evaluations=None)
    budget = SearchSettings(_POPULATION, len(_SPREADS), seed, stop, "cmaes", "none")
    pair, denominator = (campaign.cost.weights.torque, campaign.cost.weights.speed), campaign.cost.denominator
    parts = _Parts.of(bench, pair)
    cost = MotorCost(parts.targets, pair, denominator)
    jobs = MotorTrials([trial.simulated for trial in parts.trials])

    def found(objective: Objective) -> tuple[FloatArray, dict[str, float], int]:
        own = objective.space
        begin = own.encode(np.array([best.get(row.name, row.nominal) for row in own.free])).clip(0.0, 1.0)
        near = _Near(begin, dict(zip(budget.run_seeds(), _SPREADS, strict=True)))
        with LocalThreads() as where:
            runs = run_many(
                SpreadObjective(objective, where), budget, hooks=Hooks(should_stop=should_stop),
                at_once=where.at_once, breeds=near,
            )  # fmt: skip
        run: RunHistory = min(runs, key=lambda one: float(one.best[-1]))
        values = own.decode(run.best_point)
        row = averaged(own, own.full(run.best_point))
        # A log that only the stage of the dead band saw has its delay from there.
        index = {name: i for i, name in enumerate(own.table)}
        for name in own_rows(own):
            if name in best:
                row[:, index[name]] = best[name]
        return row, dict(zip(own.names, values.tolist(), strict=True)), sum(one.evaluations for one in runs)

    lower = lag_space(space, bench)
    fitted = MotorTrials([trial.simulated for trial in bench.fitted])
    targets = tuple(trial.dynamic_target for trial in bench.fitted)
    row, values, spent = found(
        LagObjective(lower, bench.fitted, MotorCost(targets, pair, denominator), fitted)
    )
    scored = LagObjective(lower, parts.trials, cost, jobs).score(row)[0][0]
    rungs = [Rung("first-order lag", values, parts.means(scored), spent)]

    def motor(name: str, own: SearchSpace) -> tuple[FloatArray, MotorObjective]:
        row, values, spent = found(
            MotorObjective.build(campaign, own, bench, bench.fitted, threads, dynamic=True)
        )
        every = MotorObjective(own, parts.trials, ties_of(campaign, own, bench), cost, jobs, threads, True)
        rungs.append(Rung(name, values, parts.means(every.score(row)[0][0]), spent))
        return row, every

    if "winding_inductance" in space.names:
        fixed = {**space.fixed, "winding_inductance": _NO_INDUCTANCE}
        free = tuple(row for row in space.free if row.name != "winding_inductance")
        motor("without L", SearchSpace(space.table, free, fixed))
    row, every = motor("full", space)
    for name in SATURATION:
        row[:, list(space.table).index(name)] = best[name]
    last = parts.means(replace(every, ideal_reversal=False).score(row)[0][0])
    # A log that starts from rest passes the dead band as well, and a dead band that was not fitted must show.
    if saturated or any(
        not np.allclose(last[g], rungs[-1].nrmse[g], rtol=1e-3, equal_nan=True) for g in last
    ):
        values = rungs[-1].values | {name: float(best[name]) for name in SATURATION}
        name = "full with saturation" if saturated else "full, saturation as in Table I"
        rungs.append(Rung(name, values, last, rungs[-1].evaluations))
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
