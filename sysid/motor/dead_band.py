"""The second stage of a motor fit: current and speed of the dead band, from trials that change direction.

The paper set both by hand. The values of the dynamic fit stay, so that the dead band cannot hide in R and L.
A reversal determines best the ratio Ω_min/I_sat, which is the time the rotor needs to leave the band. The
command delay of each reversal log is free as well: braking shows it before the rotor reaches the band.
Without a reversal to fit, starts from rest serve: they pass the same band once.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypedDict

import numpy as np
from numpy.typing import NDArray

from sysid.campaign import MotorCampaign
from sysid.errors import CampaignError
from sysid.fit.search import Hooks, run_one
from sysid.fit.settings import SearchSettings
from sysid.motor.known_values import SATURATION, Bench
from sysid.motor.log_delays import delay_name
from sysid.motor.model import PARAMETERS, simulate, unpack
from sysid.motor.problem import MotorProblem
from sysid.motor.targets import filtered
from sysid.parameters import Parameter, ParameterTable, SearchSpace
from sysid.search_options import DEFAULT_ALGORITHM
from sysid.trials.bench_log import CommandSteps
from sysid.trials.reversal import find_reversals
from sysid.trust.profiles import ends
from sysid.trust.verdicts import verdict
from sysid.types import FloatArray

# Population, and generations before the small CMA-ES at its end. The valley of equal Ω_min/I_sat is narrow:
# CMA-ES alone from a random start got stuck in it in two of five runs, the default search with its finisher
# in none, so the default search replaces a plain CMA-ES here. Five generations before a small CMA-ES found
# the minimum in all of 84 runs on six benches, three in 47 of 48.
_POPULATION, _GENERATIONS = 40, 5
# Number of random candidates that test for an effect of the dead band.
_PROBES = 32
# Largest relative difference of the candidates' costs that counts as no effect [1].
_FELT = 1e-6
# Numbers of values in a profile: of the profiled parameter over its bounds, and of the same parameter around
# its fitted value.
_EDGES, _NEAR = 25, 17
# Number of values of the other parameter at each of these values: around the one that keeps the fitted ratio
# of both parameters, and as many over the other parameter's bounds.
_CURRENTS = 31
# Largest relative difference of NRMSE of two dead bands that are equally good [1].
_LIMIT = 0.01
# Step of the simulated thrust whose reversal is timed [s].
_DELAY_GRID = 5e-4


@dataclass(frozen=True, eq=False)
class SaturationFit:
    """The fitted dead band, set by set.

    `free` are the n rows with the bounds that were searched, `shown_by` is "reversals" or "starts_from_rest".
    `values` (S, n) are in [SI]; `at_bound` is -1 within 1 % of the lower bound, +1 of the upper, else 0.
    `nrmse` and `without` (S,) are over the trials with the fitted dead band and with none (I_sat = ∞) [1].
    """

    free: tuple[Parameter, ...]
    trials: tuple[str, ...]
    shown_by: str
    values: FloatArray
    at_bound: NDArray[np.int8]
    nrmse: FloatArray
    without: FloatArray
    evaluations: int
    by_set: ClassVar = ("values", "at_bound", "nrmse", "without")

    @property
    def felt(self) -> bool:
        """Whether the dead band improves the best set's starts from rest; reversals are believed anyhow."""
        return self.shown_by == "reversals" or bool(self.nrmse[0] < (1.0 - _LIMIT) * self.without[0])

    def document(self) -> dict[str, object]:
        """Return what a result states of the stage."""
        return {
            "fitted": True, "free": [row.name for row in self.free], "trials": list(self.trials),
            "shown_by": self.shown_by, "nrmse": self.nrmse.tolist(),
            "nrmse_without_saturation": self.without.tolist(), "evaluations": self.evaluations,
        }  # fmt: skip


def fit_saturation(
    problem: MotorProblem,
    rows: FloatArray,
    settings: SearchSettings,
    seeds: tuple[int, ...],
    should_stop: Callable[[], bool] = lambda: False,
) -> SaturationFit | None:
    """Fit I_sat and Ω_min of every set to the reversal trials.

    `rows` (S, n_table) are the sets of the dynamic fit [SI], with one of the `seeds` each. Algorithm and stop
    rule of the first stage serve the second, but not CMA-ES alone. A small CMA-ES takes the place of least
    squares: a dead band has no derivatives. None where no trial shows the dead band, or both numbers are
    given. CampaignError as `saturation_space`.
    """
    campaign, bench, table = problem.campaign, problem.bench, problem.space.table
    trials = bench.banded
    spaces = [saturation_space(campaign, bench, table, unpack(row, table)) for row in rows]
    settings = replace(settings, time_limit=None, max_evaluations=None)
    first_generations = None
    if settings.finish == "least-squares":
        settings, first_generations = replace(settings, finish="cmaes"), _GENERATIONS
    if settings.algorithm == "cmaes":
        settings = replace(settings, algorithm=DEFAULT_ALGORITHM, finish="cmaes")
    values, costs, without, flags, count = [], [], [], [], 0
    for space, seed in zip(spaces, seeds, strict=True):
        if space is None:
            return None
        objective = MotorProblem.build(campaign, space, bench, trials, problem.threads)
        probes = objective.evaluate(np.random.default_rng(seed).random((_PROBES, len(space.free)))).cost
        if np.ptp(probes) <= _FELT * probes.min():
            return None
        one_run = replace(settings, population=_POPULATION, runs=1, seed=seed)
        hooks = Hooks(should_stop=should_stop)
        run = run_one(objective, one_run, hooks=hooks, first_generations=first_generations)
        values.append(space.decode(run.best_point))
        flags.append(space.at_bound(run.best_point))
        costs.append(float(run.best[-1]))
        ideal = replace(objective, ideal_reversal=True)
        without.append(float(ideal.evaluate(run.best_point[None]).cost[0]))
        count += run.evaluations
        shown_by = "reversals" if trials[0].entry.direction == "reversal" else "starts_from_rest"
        fit = SaturationFit(
            objective.space.free, tuple(t.entry.name for t in trials), shown_by, np.array(values),
            np.array(flags, dtype=np.int8), np.array(costs), np.array(without), count,
        )  # fmt: skip
        if not fit.felt:
            # The same values serve all sets, for none of which they count.
            every: dict[str, Any] = {
                name: np.repeat(getattr(fit, name), len(rows), axis=0) for name in fit.by_set
            }
            return replace(fit, **every | {"at_bound": 0 * every["at_bound"]})
    return fit


@dataclass(frozen=True, eq=False)
class BandProfile:
    """NRMSE (k,) [1] over ascending values (k,) of I_sat or Ω_min [SI], the other at its best at each.

    Within the `interval` [SI] it is at most 1 % above the lowest; an `opened` end is a bound of the search.
    """

    values: FloatArray
    nrmse: FloatArray
    interval: tuple[float, float]
    opened: tuple[bool, bool]
    verdict: str


def band_profiles(problem: MotorProblem, row: FloatArray, fit: SaturationFit) -> dict[str, BandProfile]:
    """Return the profiles of I_sat and Ω_min by name, as far as the stage freed them.

    `row` (n_table,) is a set with its dead band [SI]. The other number is tried around the fitted ratio
    Ω_min/I_sat, which a reversal determines best, and over all its bounds, for edges so low that no current
    matters. One that the stage did not free keeps its value. A dead band that is not felt is open.
    """
    free = {parameter.name: parameter for parameter in fit.free if parameter.name in SATURATION}
    table, bench = problem.space.table, problem.bench
    space = SearchSpace(table, (), unpack(row, table))
    objective = MotorProblem.build(problem.campaign, space, bench, bench.banded, problem.threads)
    out: dict[str, BandProfile] = {}
    for name, walked in free.items():
        if not fit.felt:
            ends_of = np.array([walked.lower, walked.upper])
            both = np.repeat(fit.without[:1], 2)
            out[name] = BandProfile(
                ends_of, both, (walked.lower, walked.upper), (True, True), verdict(np.inf)
            )
            continue
        best = float(row[table.index[name]])
        near = np.clip(best * np.geomspace(0.7, 1 / 0.7, _NEAR), walked.lower, walked.upper)
        values = np.unique(np.append(np.geomspace(walked.lower, walked.upper, _EDGES), near))
        (other,) = {*SATURATION} - {name}
        others = np.full((values.size, 1), row[table.index[other]])
        if other in free:
            low, high = free[other].lower, free[other].upper
            around = np.append(np.geomspace(0.5, 2.0, _CURRENTS), 1.0) * others * values[:, None] / best
            over = np.broadcast_to(np.geomspace(low, high, _CURRENTS), (values.size, _CURRENTS))
            others = np.clip(np.hstack([around, over]), low, high)
        tried = {name: np.repeat(values, others.shape[1]), other: others.ravel()}
        cost = objective.nrmse_with(row, **tried).reshape(others.shape).min(axis=1)
        below, above = ends(np.log(values), cost / cost.min() - 1.0, _LIMIT)
        interval = (
            float(values[0] if below is None else np.exp(below)),
            float(values[-1] if above is None else np.exp(above)),
        )
        opened = (below is None, above is None)
        half = np.inf if any(opened) else (interval[1] - interval[0]) / 2 / best
        out[name] = BandProfile(values, cost, interval, opened, verdict(half))
    return out


class ReversalDelay(TypedDict):
    """Time from a command that reverses to 90 % of the new thrust [s], measured and by the best set."""

    trial: str
    use: str
    command_before: float
    command_after: float
    measured: float
    simulated: float


def reversal_delays(campaign: MotorCampaign, bench: Bench, best: Mapping[str, float]) -> list[ReversalDelay]:
    """Return the time to 90 % of every reversal inside a trial's window.

    `best` is the best set with the delays of logs, by name [SI].
    """
    out: list[ReversalDelay] = []
    for trial in bench.trials:
        log, entry = trial.log, trial.entry
        if entry.direction != "reversal" or "thrust" not in log.channels:
            continue
        time, thrust = filtered(campaign, log, "thrust")
        known = np.isfinite(thrust)
        parameters = {name: best[name] for name in PARAMETERS}
        parameters["command_delay"] = best.get(delay_name(entry.log), best["command_delay"])
        start = float(trial.simulated.time[0])
        end = min(float(log.time[-1]), log.window[1])
        grid = np.arange(start, end, _DELAY_GRID)
        volts = trial.simulated.supply
        if volts is not None:
            volts = (volts[0], volts[1] * parameters["reference_voltage"])
        run = simulate(parameters, log.steps.time, log.steps.level, grid, initial="steady", voltage=volts)
        # The command in force when the trial begins is what its first reversal comes from.
        first = max(int(np.searchsorted(log.steps.time, start, side="right")) - 1, 0)
        last = int(np.searchsorted(log.steps.time, end))
        steps = CommandSteps(log.steps.time[first:last], log.steps.level[first:last])
        measured, simulated = (
            find_reversals(log.time[log.time <= end], steps, samples, skip=log.doubtful, sense="both")
            for samples in ((time[known], thrust[known]), (grid, run.thrust))
        )
        out += [
            ReversalDelay(
                trial=entry.name,
                use=entry.use,
                command_before=a.before,
                command_after=a.after,
                measured=a.to_level,
                simulated=b.to_level,
            )
            for a, b in zip(measured, simulated, strict=True)
        ]
    return out


def saturation_space(
    campaign: MotorCampaign, bench: Bench, table: ParameterTable, values: Mapping[str, float]
) -> SearchSpace | None:
    """Return what the second stage frees, all else fixed at `values` [SI]; None where it has nothing to do.

    CampaignError when the campaign frees I_sat or Ω_min and fixes it, or no trial shows the dead band.
    """
    choices = campaign.parameters
    asked = [name for name in SATURATION if name in (choices.free or ())]
    given = {*choices.fixed, *bench.measured}
    names = tuple(name for name in SATURATION if name in asked or name not in given)
    if not bench.banded:
        if asked:
            raise CampaignError(
                f"parameters.free names {', '.join(asked)}, but no reversal trial has use = 'fit', and none "
                "of the others starts from rest inside its window; set it for one trial of direction = "
                "'reversal'"
            )
        return None
    if not names:
        return None
    known = {n: value for n, value in values.items() if n not in names and n in PARAMETERS}
    bounds = {name: pair for name, pair in choices.bounds.items() if name in names}
    choices = choices.model_copy(update={"free": names, "bounds": bounds})
    space = choices.search_space(ParameterTable(table[n] for n in PARAMETERS), names, known)
    # Delays of logs that only this stage sees are free; the delays of the dynamic fit stay.
    seen = {delay_name(trial.entry.log) for trial in bench.fitted}
    late = {delay_name(trial.entry.log) for trial in bench.banded} - seen
    delays = [row for name, row in table.items() if name in late]
    fixed = {n: value for n, value in values.items() if n not in names and n not in late}
    return SearchSpace(table, (*space.free, *delays), {**space.fixed, **fixed})
