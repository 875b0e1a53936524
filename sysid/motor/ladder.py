"""The ladder of a motor fit: what each step of the model buys, on trials that the search has not seen.

    first-order lag → equations (1-3) without L → full → full with saturation

Least squares fits every rung to the same forward and reverse trials from starts around the fit's best set, as
far as the rung has its parameters. Rungs below the last are scored without a dead band, which only
starts from rest and reversals show. `sysid ladder` judges the same simpler models, and terms that the motor
lacks, on parts of trials left out. An inductance is not real because a search returned one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sysid.journal import Finding
from sysid.motor import first_order_lag as lag
from sysid.motor.cost import CHANNELS, MotorTarget
from sysid.motor.curves import supply_ratio
from sysid.motor.known_values import SATURATION, Bench
from sysid.motor.log_delays import averaged, log_rows, shifts
from sysid.motor.parameters import SENSORS
from sysid.motor.problem import MotorProblem
from sysid.motor.static_curves import turns
from sysid.motor.targets import PreparedTrial
from sysid.parameters import ParameterTable, SearchSpace
from sysid.trust.ladder import starts_near
from sysid.trust.terms import downhill
from sysid.types import BoolArray, FloatArray, IntArray

# Compared instants below which a group of samples has no NRMSE, and their least standard deviation as a share
# of the trial's: a start that a stall cuts down to a rotor at rest has none.
_LEAST, _LEAST_SPREAD = 10, 0.1
# Rises within a thousandth of any step that a log shows.
_NO_INDUCTANCE = 1e-8
# What is scored, in the order of the table: a use of trials, and which part of them.
_USES = {"fit": "fitted", "validate": "held_out"}
_PARTS = ("{}", "starts_{}", "reversals_{}")
# What people call the rungs.
_TITLES = {
    "lag": "first-order lag",
    "without_inductance": "without L",
    "full": "full",
    "saturation": "full with saturation",
    "saturation_given": "full, saturation as in Table I",
}
# A trial, what it compares, and its group.
_Part = tuple[PreparedTrial, MotorTarget, str]


@dataclass(frozen=True, eq=False)
class Rung:
    """One model of the ladder; `name` is a code.

    `values` are the free parameters by name [SI], `nrmse` the means (torque, speed) over the parts of trials
    of each group [1], `evaluations` the number of scored candidates.
    """

    name: str
    values: dict[str, float]
    nrmse: dict[str, tuple[float, float]]
    evaluations: int

    def document(self, below: Rung | None) -> dict[str, Any]:
        """Return the rung as a result states it, with what it takes off the NRMSE of the rung below."""
        nrmse = {group: dict(zip(CHANNELS, pair, strict=True)) for group, pair in self.nrmse.items()}
        buys = {} if below is None else {
            group: {c: worse - pair[c] for c, worse in zip(CHANNELS, below.nrmse[group], strict=True)}
            for group, pair in nrmse.items()
        }  # fmt: skip
        return {
            "rung": self.name, "title": _TITLES[self.name], "values": self.values,
            "evaluations": self.evaluations, "nrmse": nrmse, "buys": buys,
        }  # fmt: skip


def _parts(problem: MotorProblem) -> list[_Part]:
    """Return what the rungs are scored on: parts of the bench's trials, each with its group."""
    weights = problem.campaign.cost.weights
    weighted = [c for c, weight in enumerate((weights.torque, weights.speed)) if weight > 0]
    out = []
    for trial in problem.bench.trials:
        whole = trial.target
        running, start, reversal = (part.format(_USES[trial.entry.use]) for part in _PARTS)
        if trial.entry.direction == "reversal":
            out.append((trial, whole, reversal))
            continue
        out.append((trial, trial.dynamic_target, running))
        starts = replace(whole, valid=whole.valid & trial.started[:, None])
        if all(_shows(starts, c, whole.measured[whole.valid[:, c], c]) for c in weighted):
            out.append((trial, starts, start))
    return out


def _shows(part: MotorTarget, channel: int, whole: FloatArray) -> bool:
    """Return whether a part of a trial has enough samples, and enough of the whole trial's spread."""
    values = part.measured[part.valid[:, channel], channel]
    return values.size >= _LEAST and bool(np.std(values) >= _LEAST_SPREAD * np.std(whole))


class LagProblem(MotorProblem):
    """First-order lags on the same trials: rows of the lag's table and the delays of logs."""

    def complete(self, rows: FloatArray) -> FloatArray:
        """Return the rows (P, n): nothing of a lag follows from the others."""
        return rows

    def simulate(self, rows: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Return samples (P, n_total, 2) [SI] on the trials' grids; every lag reaches the end of all."""
        delays, shape = shifts(self.space.table, rows, self.prepared), (len(rows), len(self.jobs))
        return lag.simulate_lag(rows, self.jobs, delays), np.ones(shape), np.zeros(shape, dtype=np.int64)


def lag_space(space: SearchSpace, bench: Bench) -> SearchSpace:
    """Return what the first rung frees.

    Its delays are free where the motor's are; its steady speeds come from the loaded steady points.
    """
    delays = log_rows(space)
    free = ["rise_time_constant", "fall_time_constant"]
    free += [name for name in ("command_delay", *SENSORS, *delays) if name in space.names]
    table = ParameterTable([*lag.PARAMETERS.values(), *(space.table[name] for name in delays)])
    values = {n: value for n, value in {**space.fixed, **bench.curves.parameters}.items() if n in table}
    for direction, points in bench.curves.loaded.items():
        turning = turns(points.u, direction)
        ratio = supply_ratio(points, bench.curves.reference_voltage)
        powers = lag.steady_speed_map(points.u[turning], points.speed[turning], ratio[turning])
        values |= {f"steady_speed_{power}_{direction}": float(p) for power, p in enumerate(powers)}
    bounds = {row.name: (row.lower, row.upper) for row in space.free if row.name in free}
    return SearchSpace.build(table, free, values, bounds)


def _simpler(problem: MotorProblem) -> Iterator[tuple[str, MotorProblem]]:
    """Yield the codes of simpler models, and each on the same trials."""
    space = problem.space
    yield "lag", LagProblem(
        problem.campaign, problem.bench, lag_space(space, problem.bench), problem.prepared, problem.targets,
        {}, problem.threads,
    )  # fmt: skip
    if "winding_inductance" in space.names:
        fixed = {**space.fixed, "winding_inductance": _NO_INDUCTANCE}
        free = tuple(row for row in space.free if row.name != "winding_inductance")
        yield "without_inductance", replace(problem, space=SearchSpace(space.table, free, fixed))


def simpler(problem: MotorProblem) -> list[tuple[str, MotorProblem]]:
    """Return the simpler models of a problem of fitted trials with their titles."""
    return [(_TITLES[code], less) for code, less in _simpler(problem)]


def climb(
    problem: MotorProblem,
    best: Mapping[str, float],
    saturated: bool,
    should_stop: Callable[[], bool] = lambda: False,
) -> tuple[Rung, ...]:
    """Fit every rung to the fitted trials, score it on every trial.

    `best` is the fit's best set by name [SI]; names left out begin at their nominal values. The last rung
    takes its dead band, which was fitted or given where `saturated`, and every rung its delays of the logs
    that only the stage of the dead band saw. `should_stop` is asked before every step, and raises where the
    fit must end.
    """
    trials, targets, groups = zip(*_parts(problem), strict=True)

    def scored(model: MotorProblem, row: FloatArray, *, ideal: bool) -> dict[str, tuple[float, float]]:
        """Return the means of every group of a row (1, n_table), without a dead band where `ideal`."""
        every = replace(model, prepared=trials, targets=targets, ideal_reversal=ideal)
        nrmse = every.score(row).by_channel[0]
        out = {}
        for name in (part.format(use) for part in _PARTS for use in _USES.values()):
            rows = [i for i, group in enumerate(groups) if group == name]
            if rows:
                torque, speed = nrmse[rows].mean(axis=0)
                out[name] = (float(torque), float(speed))
        return out

    def fitted(name: str, model: MotorProblem) -> tuple[Rung, FloatArray]:
        """Fit and score a model without a dead band; return the rung and its row (1, n_table)."""

        def residuals(cube: FloatArray) -> tuple[FloatArray, BoolArray]:
            should_stop()
            return model.residuals(cube)

        space = model.space
        cube, spent = downhill(model, starts_near(space, best), residuals)
        values = dict(zip(space.names, space.decode(cube).tolist(), strict=True))
        row = averaged(space, space.full(cube))
        # A log that only the stage of the dead band saw has its delay from there.
        for delay in log_rows(space):
            if delay in best:
                row[:, space.table.index[delay]] = best[delay]
        return Rung(name, values, scored(model, row, ideal=True), spent), row

    searched = problem.fitted
    rungs = [fitted(name, less)[0] for name, less in _simpler(searched)]
    full, row = fitted("full", searched)
    rungs.append(full)
    for name in SATURATION:
        row[:, problem.space.table.index[name]] = best[name]
    last = scored(searched, row, ideal=False)
    # A log that starts from rest passes the dead band as well, and a dead band that was not fitted must show.
    if saturated or any(not np.allclose(last[g], full.nrmse[g], rtol=1e-3, equal_nan=True) for g in last):
        values = full.values | {name: float(best[name]) for name in SATURATION}
        name = "saturation" if saturated else "saturation_given"
        rungs.append(Rung(name, values, last, full.evaluations))
    return tuple(rungs)


def ladder_doubt(rungs: Sequence[Rung]) -> Finding | None:
    """Return what the held-out trials say against L, or that no trial is held out; None where L pays."""
    nrmse = {rung.name: rung.nrmse for rung in rungs}
    if "held_out" not in nrmse["full"]:
        return Finding(
            "ladder",
            "no forward or reverse trial is held out (use = 'validate'): the ladder cannot say what a fitted "
            "parameter is worth",
        )
    if "without_inductance" not in nrmse:
        return None
    without, full = (float(np.nanmean(nrmse[name]["held_out"])) for name in ("without_inductance", "full"))
    # Below a twentieth of the error itself a step is within what another day's log would change.
    if full < 0.95 * without:
        return None
    return Finding(
        "ladder",
        f"the inductance buys nothing on held-out trials: NRMSE {100 * without:.2f} % without L, "
        f"{100 * full:.2f} % with it; do not believe the fitted L",
    )
