"""The ladder: what each step of the model buys, on trials that the search has not seen.

    first-order lag → equations (1-3) without L → full → full with saturation

Every rung is fitted to the same forward and reverse trials. The lower rungs take one short search of their
own, the full model comes from the fit's runs; rungs below the last are scored without a dead band. Judge a
step by its held-out columns: an inductance is not real because a search returned one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.campaign import MotorCampaign
from sysid.fit.engine import SearchSettings, run_one
from sysid.fit.history import RunHistory
from sysid.fit.objective import Evaluation, Objective
from sysid.motor import lag
from sysid.motor.model import PARAMETERS
from sysid.motor.population import MotorTrials
from sysid.parameters import SearchSpace
from sysid.pipelines.bench_curves import StaticCurves
from sysid.pipelines.bench_logs import PreparedTrial
from sysid.pipelines.motor_bench import Bench
from sysid.pipelines.motor_cost import CHANNELS, MotorCost
from sysid.pipelines.motor_objective import MotorObjective

FloatArray = NDArray[np.float64]

# The rungs below the full model have three to six parameters.
_POPULATION = 40
# Rises within a thousandth of any step that a log shows.
_NO_INDUCTANCE = 1e-8
_SENSORS = ("torque_sensor_delay", "torque_sensor_lag", "speed_sensor_lag")
# Groups of trials, in the order of the table: (use, reversal) and its name.
GROUPS = {
    ("fit", False): "fitted",
    ("validate", False): "held out",
    ("fit", True): "reversals, fitted",
    ("validate", True): "reversals, held out",
}


@dataclass(frozen=True, eq=False)
class Rung:
    """One model of the ladder.

    Parameters
    ----------
    name : str
    values : dict
        Free parameters by name [SI].
    nrmse : (T, 2) array
        Per trial of the bench: stator torque, speed [1].
    """

    name: str
    values: dict[str, float]
    nrmse: FloatArray

    def document(self, trials: Sequence[PreparedTrial]) -> dict[str, Any]:
        """Return the rung as a result states it: means over the trials of each group."""
        return {
            "rung": self.name,
            "values": self.values,
            "nrmse": {
                title: dict(zip(CHANNELS, self.nrmse[rows].mean(axis=0).tolist(), strict=True))
                for group, title in GROUPS.items()
                if (rows := [t for t, trial in enumerate(trials) if _group(trial) == group])
            },
        }


def _group(trial: PreparedTrial) -> tuple[str, bool]:
    return trial.entry.use, trial.entry.direction == "reversal"


@dataclass(frozen=True, eq=False)
class LagObjective:
    """Mean NRMSE of first-order lags over bench trials.

    Parameters
    ----------
    space : SearchSpace
        Over the lag's table.
    cost : MotorCost
    jobs : MotorTrials
    """

    space: SearchSpace
    cost: MotorCost
    jobs: MotorTrials

    def evaluate(self, cube: FloatArray) -> Evaluation:
        """Simulate and score unit-cube points (P, n_free)."""
        by_channel, failed = self.score(self.space.full(cube))
        return Evaluation(self.cost.mean(by_channel), np.any(failed, axis=1), failed.size)

    def score(self, rows: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return NRMSE (P, T, 2) and failures (P, T) of rows of the lag's table [SI]."""
        index = [list(lag.PARAMETERS).index(name) for name in _SENSORS]
        sensors = np.ascontiguousarray(rows[:, index])
        return self.cost(lag.simulate_lag(rows, self.jobs), np.ones((len(rows), len(self.jobs))), sensors)


def lag_objective(campaign: MotorCampaign, space: SearchSpace, bench: Bench, every: bool) -> LagObjective:
    """Return the objective of the first rung, over the fitted trials or over every one.

    Its delays are free where those of the motor are; its steady speeds come from the loaded steady points.
    """
    free = ["rise_time_constant", "fall_time_constant"]
    free += [name for name in ("command_delay", *_SENSORS) if name in space.names]
    values = {name: value for name, value in space.fixed.items() if name in lag.PARAMETERS}
    values |= {name: value for name, value in bench.curves.parameters.items() if name in lag.PARAMETERS}
    values |= _steady_maps(bench.curves)
    bounds = {row.name: (row.lower, row.upper) for row in space.free if row.name in free}
    trials = bench.trials if every else bench.fitted
    weights = campaign.cost.weights
    return LagObjective(
        SearchSpace.build(lag.PARAMETERS, free, values, bounds),
        MotorCost(
            tuple(t.target for t in trials), (weights.torque, weights.speed), campaign.cost.denominator
        ),
        MotorTrials([t.simulated for t in trials]),
    )


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
) -> tuple[Rung, ...]:
    """Fit the lower rungs, score all of them on every trial.

    Parameters
    ----------
    campaign : MotorCampaign
    bench : Bench
    space : SearchSpace
        Of the dynamic fit.
    best : mapping
        Its best set with the second stage's dead band, by name [SI].
    saturated : bool
        Whether the dead band was fitted or given.
    settings : SearchSettings
        Algorithm, finisher and stop rule.
    seed : int
    threads : int, optional
    """
    stop = replace(settings.stop, time_limit=None, max_evaluations=None)
    small = replace(settings, population=_POPULATION, runs=1, seed=seed, stop=stop)

    def found(objective: Objective) -> tuple[FloatArray, dict[str, float]]:
        run: RunHistory = run_one(objective, small)
        names = objective.space.names
        values = objective.space.decode(run.best_point)
        return objective.space.full(run.best_point), dict(zip(names, values.tolist(), strict=True))

    row, values = found(lag_objective(campaign, space, bench, every=False))
    scored, _ = lag_objective(campaign, space, bench, every=True).score(row)
    rungs = [Rung("first-order lag", values, scored[0])]

    ideal = replace(MotorObjective.build(campaign, space, bench, bench.trials, threads), ideal_reversal=True)
    if "winding_inductance" in space.names:
        fixed = {**space.fixed, "winding_inductance": _NO_INDUCTANCE}
        without = SearchSpace(
            PARAMETERS, tuple(row for row in space.free if row.name != "winding_inductance"), fixed
        )
        row, values = found(MotorObjective.build(campaign, without, bench, bench.fitted, threads))
        rungs.append(Rung("without L", values, ideal.score(row)[0][0]))
    full = np.array([[best[name] for name in PARAMETERS]])
    values = {name: best[name] for name in space.names}
    rungs.append(Rung("full", values, ideal.score(full)[0][0]))
    scored = replace(ideal, ideal_reversal=False).score(full)[0]
    # A log that starts from rest passes the dead band as well, and a dead band that was not fitted must show.
    if saturated or not np.allclose(scored[0], rungs[-1].nrmse, rtol=1e-3):
        values = values | {name: best[name] for name in ("saturation_current", "saturation_speed")}
        name = "full with saturation" if saturated else "full, saturation as in Table I"
        rungs.append(Rung(name, values, scored[0]))
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
    without, full = (float(np.mean(list(by_name[n]["held out"].values()))) for n in ("without L", "full"))
    # Below a twentieth of the error itself a step is within what another day's log would change.
    if full < 0.95 * without:
        return ()
    return (
        f"the inductance buys nothing on held-out trials: NRMSE {100 * without:.2f} % without L, "
        f"{100 * full:.2f} % with it; do not believe the fitted L",
    )
