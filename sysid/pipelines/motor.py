"""`fit-motor`: bench logs in, five ranked parameter sets out."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.campaign import MotorCampaign, read_campaign
from sysid.errors import CampaignError, SysidWarning
from sysid.fit.objective import Evaluation
from sysid.fit.result import FitResult, TrialResult, bound_warnings, ranked_sets
from sysid.fit.store import check_new_fit, write_fit
from sysid.motor.model import FREE_DEFAULT, PARAMETERS, invariants, pack, unpack
from sysid.motor.population import MotorTrials, simulate_population
from sysid.parameter_sets import ParameterRecord, parameter_records
from sysid.parameters import SearchSpace
from sysid.pipelines.bench_curves import NoLoadTie, StaticCurves, static_curves
from sysid.pipelines.bench_logs import BenchLog, PreparedTrial, bench_log, filter_design, prepare_trial
from sysid.pipelines.motor_cost import CHANNEL_UNITS, CHANNELS, MotorCost
from sysid.pipelines.search import FitOptions, collected_warnings, naming, provenance, search
from sysid.units import parse_quantity

FloatArray = NDArray[np.float64]

# Local error of the simulations of a search: 1e-5 keeps the worst candidate within 0.01 % NRMSE.
FIT_TOLERANCE = 1e-5
# Simulated samples that are held at once [bytes].
_MEMORY = 64e6
_INDEX = {name: i for i, name in enumerate(PARAMETERS)}
# Full duty of an unloaded motor turns at V_ref/k_v; steady loaded speed extrapolated to u = 1 falls short of
# that by about this factor. Only a start for motors of unknown Kv: no result depends on it but the scale.
_LOADED_SHARE = 0.8

_DERIVED = (
    ("k²/R", "k2_over_R", "N·m·s/rad", "Torque per slip speed; fixed even without a known Kv."),
    ("R/L", "R_over_L", "1/s", "Rate of the current; fixed even without a known Kv."),
    ("k·I_sat", "k_I_sat", "N·m", "Torque in the dead band; fixed even without a known Kv."),
    ("I^r R/k²", "electromechanical_time_constant", "s", "Time constant of the unloaded rotor as L → 0."),
)


@dataclass(frozen=True, eq=False)
class Bench:
    """A motor campaign after its logs were read.

    Parameters
    ----------
    trials : tuple of PreparedTrial
    curves : StaticCurves
    values : dict
        Parameters that the campaign or its static logs fix, by name [SI].
    measured : tuple of str
        Those of them that were measured.
    """

    trials: tuple[PreparedTrial, ...]
    curves: StaticCurves
    values: dict[str, float]
    measured: tuple[str, ...]

    @property
    def fitted(self) -> tuple[PreparedTrial, ...]:
        """Trials of the search: use "fit", and no reversal."""
        return tuple(t for t in self.trials if in_search(t))


def in_search(trial: PreparedTrial) -> bool:
    """Return whether the search sees a trial; reversals are scored only, as in the paper."""
    return trial.entry.use == "fit" and trial.entry.direction != "reversal"


def prepare_bench(campaign: MotorCampaign, path: str | Path) -> Bench:
    """Read every log of a campaign, fit the static curves and prepare the trials.

    Raises
    ------
    SysidError
        For the first log that cannot be used, or a campaign that has nothing to fit.
    """
    logs = [bench_log(campaign, path, entry) for entry in campaign.trials]
    fitted = [
        log
        for log, entry in zip(logs, campaign.trials, strict=True)
        if entry.use == "fit" and entry.direction != "reversal"
    ]
    if not fitted:
        raise CampaignError(
            "no forward or reverse trial has use = 'fit'; reversals are scored only, because the dead band "
            "would hide in R and L"
        )
    reference = campaign.motor.reference_voltage or _median_supply(fitted)
    curves = static_curves(campaign, path, fitted, reference)
    values, measured = _known_values(campaign, curves, reference)
    trials = tuple(
        prepare_trial(campaign, entry, log, reference)
        for entry, log in zip(campaign.trials, logs, strict=True)
    )
    return Bench(trials, curves, values, measured)


def _median_supply(logs: list[BenchLog]) -> float:
    volts = [log.channels["voltage"][1] for log in logs if "voltage" in log.channels]
    return float(np.median(np.concatenate(volts))) if volts else PARAMETERS.nominal["reference_voltage"]


def _known_values(
    campaign: MotorCampaign, curves: StaticCurves, reference: float
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Return the values that the campaign states or its static logs give, and which were measured."""
    motor = campaign.motor
    values = {**curves.parameters, "reference_voltage": reference}
    measured = [*curves.parameters]
    if motor.kv is not None:
        values |= {"back_emf_constant": 1.0 / motor.kv, "torque_constant": 1.0 / motor.kv}
    elif curves.ties:
        top = max(float(np.sum(tie.speed)) for tie in curves.ties.values())
        constant = _LOADED_SHARE * reference / top
        values |= {"back_emf_constant": constant, "torque_constant": constant}
    if motor.kv is None and not {"back_emf_constant", "torque_constant"} <= set(campaign.parameters.fixed):
        warnings.warn(
            "no Kv in the campaign: R, L and I_sat rest on a guessed motor constant of "
            f"{values.get('torque_constant', PARAMETERS.nominal['torque_constant']):.4g} N·m/A; torque and "
            "speed fix only k²/R, R/L and k·I_sat, which the result lists",
            SysidWarning,
            stacklevel=2,
        )
    if motor.rotor_inertia is not None:
        values["rotor_inertia"] = motor.rotor_inertia
        measured.append("rotor_inertia")
    for name, text, unit in (
        ("saturation_current", motor.saturation_current, "A"),
        ("saturation_speed", motor.saturation_speed, "rad/s"),
    ):
        if text is not None:
            values[name] = parse_quantity(text, unit)
            measured.append(name)
    return values, tuple(measured)


def search_space(campaign: MotorCampaign, bench: Bench) -> SearchSpace:
    """Return the free parameters: the campaign's, or R, L and k_d, and what its logs need beside them.

    The rotor's inertia is free where it was not measured; the command delay always, and the torque sensor's
    delay and lag where a trial is a slow log, unless the campaign fixes them. k_d is free by default only
    where a log without propeller gives Ω_0: with Ω_0 from loaded points,
    (k²/R, k_d, Ω_0) → (k²/R + c, k_d − c, Ω_0 (k²/R)/(k²/R + c)) changes nothing as L → 0.

    Raises
    ------
    CampaignError
        For an unknown parameter, a wrong unit, crossed bounds, bounds that exclude a measured value.
    """
    needed = ["command_delay"]
    if any(not trial.log.fast for trial in bench.fitted):
        needed += ["torque_sensor_delay", "torque_sensor_lag"]
    choices = campaign.parameters
    default = [name for name in FREE_DEFAULT if name != "viscous_damping" or not bench.curves.ties]
    free = list(default if choices.free is None else choices.free)
    if campaign.motor.rotor_inertia is None and choices.free is None:
        needed.append("rotor_inertia")
    free += [name for name in needed if name not in free]
    # A name that the campaign both frees and fixes stays in the list, to be refused.
    asked = set(choices.free or ())
    chosen = tuple(name for name in free if name not in choices.fixed or name in asked)
    choices = choices.model_copy(update={"free": chosen})
    values = {name: value for name, value in bench.values.items() if name not in chosen}
    return choices.search_space(PARAMETERS, FREE_DEFAULT, values)


@dataclass(frozen=True, eq=False)
class MotorObjective:
    """Mean NRMSE of a population over bench trials.

    Parameters
    ----------
    space : SearchSpace
    trials : tuple of PreparedTrial
    ties : dict of direction to NoLoadTie
        No-load lines that follow R and k_d.
    cost : MotorCost
    threads : int, optional
        Cores to use; the numbers do not depend on it.
    """

    space: SearchSpace
    trials: tuple[PreparedTrial, ...]
    ties: dict[str, NoLoadTie]
    cost: MotorCost
    jobs: MotorTrials
    threads: int | None = None

    @classmethod
    def build(
        cls,
        campaign: MotorCampaign,
        space: SearchSpace,
        bench: Bench,
        trials: tuple[PreparedTrial, ...],
        threads: int | None = None,
    ) -> MotorObjective:
        """Join prepared trials with the campaign's cost."""
        weights = campaign.cost.weights
        cost = MotorCost(
            tuple(t.target for t in trials), (weights.torque, weights.speed), campaign.cost.denominator
        )
        ties = {
            direction: tie
            for direction, tie in bench.curves.ties.items()
            if not {f"no_load_slope_{direction}", f"no_load_intercept_{direction}"}
            & ({*space.names} | {*campaign.parameters.fixed})
        }
        return cls(space, trials, ties, cost, MotorTrials([t.simulated for t in trials]), threads)

    def complete(self, rows: FloatArray) -> FloatArray:
        """Return rows (P, n_table) with the no-load lines that belong to their R and k_d."""
        rows = np.array(rows, dtype=np.float64)
        drop = rows[:, _INDEX["winding_resistance"]] / (
            rows[:, _INDEX["torque_constant"]] * rows[:, _INDEX["back_emf_constant"]]
        )
        for direction, tie in self.ties.items():
            line = tie.line(drop, rows[:, _INDEX["viscous_damping"]])
            rows[:, _INDEX[f"no_load_slope_{direction}"]] = line[:, 0]
            rows[:, _INDEX[f"no_load_intercept_{direction}"]] = line[:, 1]
        return rows

    def evaluate(self, cube: FloatArray) -> Evaluation:
        """Simulate and score unit-cube points (P, n_free)."""
        by_channel, failed = self.score(self.space.full(cube))
        return Evaluation(self.cost.mean(by_channel), np.any(failed, axis=1), failed.size)

    def score(self, rows: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return NRMSE (P, T, 2) and failures (P, T) of rows of the parameter table (P, n_table) [SI]."""
        rows = self.complete(rows)
        share = max(1, int(_MEMORY / (16 * self.jobs.time.size)))
        scored = [self._score(rows[first : first + share]) for first in range(0, len(rows), share)]
        return np.concatenate([s[0] for s in scored]), np.concatenate([s[1] for s in scored])

    def _score(self, rows: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        samples, reached = self.simulate(rows)
        return self.cost(samples, reached, self.sensors(rows), self.threads)

    def simulate(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return samples (P, n_total, 2) on the trials' grids, and the share reached (P, T), of full rows."""
        found = simulate_population(rows, self.jobs, tolerance=FIT_TOLERANCE, threads=self.threads)
        # Success is a status, not a share that rounding could leave at 1 - 1e-16.
        return found.outputs, np.where(found.status == 0, 1.0, np.minimum(found.reached, 1.0 - 1e-9))

    @staticmethod
    def sensors(rows: FloatArray) -> FloatArray:
        """Return torque delay, torque lag and speed lag (P, 3) [s] of rows."""
        names = ("torque_sensor_delay", "torque_sensor_lag", "speed_sensor_lag")
        return np.ascontiguousarray(rows[:, [_INDEX[name] for name in names]])


def fit_motor(
    path: str | Path,
    options: FitOptions | None = None,
    *,
    say: Callable[[str], None] | None = None,
) -> tuple[FitResult, Path]:
    """Fit the motor to the bench logs of a campaign and write the fit folder.

    Parameters
    ----------
    path : str or Path
        Campaign file of kind ``motor``.
    options : FitOptions
        Overrides of the command line.
    say : callable, optional
        Told, one sentence at a time, what is going on and what is doubtful.

    Returns
    -------
    result : FitResult
        Ranked sets and all that led to them.
    folder : Path
        Where it was written.

    Raises
    ------
    SysidError
        When an input cannot be used; nothing has been written then.
    """
    campaign = read_campaign(path, "motor")
    assert isinstance(campaign, MotorCampaign)
    options = options or FitOptions()
    tell = say or (lambda sentence: None)
    folder = options.folder(campaign.name)
    check_new_fit(folder, options.force)
    with naming(path), collected_warnings(lambda text: tell(f"warning: {text}")) as doubts:
        ranges = campaign.parameters.measured_ranges(PARAMETERS)
        settings = options.settings(campaign.fit)
        bench = prepare_bench(campaign, path)
        space = search_space(campaign, bench)
        objective = MotorObjective.build(campaign, space, bench, bench.fitted, options.threads)
        _say_what_is_fitted(campaign, bench, space, tell)
        runs, interrupted = search(objective, settings, simulated="trials", quiet=options.quiet)
    sets = ranked_sets(runs, space)
    every = MotorObjective.build(campaign, space, bench, bench.trials, options.threads)
    rows = every.complete(sets.values)
    tied = [f"no_load_{what}_{d}" for d in every.ties for what in ("slope", "intercept")]
    records = _records(parameter_records(space, _measured(bench, tied), ranges), tied)
    derived = np.array([list(invariants(unpack(row)).values()) for row in rows])
    at_bound = np.hstack([sets.at_bound, np.zeros(derived.shape, dtype=np.int8)])
    result = FitResult(
        kind="motor",
        name=campaign.name,
        state="stopped" if interrupted else "done",
        parameters=records,
        runs=runs,
        set_runs=sets.run,
        set_seeds=sets.seed,
        cube=sets.cube,
        values=np.hstack([rows, derived]),
        at_bound=at_bound,
        nrmse=sets.cost,
        trials=_trial_results(every, rows),
        channels=CHANNELS,
        channel_units=CHANNEL_UNITS,
        channel_weights=(campaign.cost.weights.torque, campaign.cost.weights.speed),
        settings=_settings(campaign, bench),
        provenance=provenance(
            path,
            settings,
            campaign.cost.denominator,
            filter_design(campaign, [trial.log for trial in bench.trials]),
            {trial.entry.name: trial.provenance for trial in bench.trials},
        ),
        warnings=(*doubts, *bound_warnings(records, at_bound), *_unresolved_inductance(bench, rows[0])),
    )
    return result, write_fit(result, folder, options.force)


def _say_what_is_fitted(
    campaign: MotorCampaign, bench: Bench, space: SearchSpace, tell: Callable[[str], None]
) -> None:
    scored = len(bench.trials) - len(bench.fitted)
    tell(f"{len(bench.fitted)} trials to fit, {scored} to validate; free: {', '.join(space.names)}")
    for fit in bench.curves.fits:
        tell(
            f"{fit.quantity}, {fit.direction}: R² {fit.r_squared:.5f} over {fit.points} points"
            + (f", {fit.outliers} of them outliers" if fit.outliers else "")
        )
    for trial in bench.trials:
        lost = sum(end - start for start, end in trial.log.doubtful)
        if lost:
            tell(
                f"trial {trial.entry.name}: {len(trial.log.doubtful)} stalls of the logger around commands, "
                f"{lost:.1f} s left out of the cost"
            )
    if bench.curves.ties and "viscous_damping" not in space.names:
        tell(
            "no log without propeller: the no-load speed follows R from loaded points, and k_d, which cannot "
            f"be told from k²/R then, stays at {space.fixed['viscous_damping']:.2g} N·m·s/rad"
        )
    turned = [t.entry.name for t in bench.trials if t.entry.use == "fit" and not in_search(t)]
    if turned:
        warnings.warn(
            f"reversal trials {', '.join(turned)} are scored only: none may be in the dynamic fit",
            SysidWarning,
            stacklevel=2,
        )
    given = campaign.motor.saturation_current is not None and campaign.motor.saturation_speed is not None
    held = {"saturation_current", "saturation_speed"} <= {*space.names} | {*campaign.parameters.fixed}
    if not given and not held:
        tell("saturation_current and saturation_speed are not fitted; they keep Table I's values")


def _unresolved_inductance(bench: Bench, row: FloatArray) -> tuple[str, ...]:
    """Return a sentence where L/R of the best set is shorter than the logs can show."""
    rise = float(row[_INDEX["winding_inductance"]] / row[_INDEX["winding_resistance"]])
    # A rise within one step of the finest grid that any fitted log is compared on leaves no sample inside it.
    finest = min(float(np.median(np.diff(trial.target.time))) for trial in bench.fitted)
    if rise > finest:
        return ()
    return (
        f"L/R of the best set is {1e3 * rise:.3g} ms and the finest fitted log is compared every "
        f"{1e3 * finest:.3g} ms: the logs only say that L is small, not how small",
    )


def _measured(bench: Bench, tied: list[str]) -> list[str]:
    return [name for name in bench.measured if name not in tied]


def _records(records: tuple[ParameterRecord, ...], tied: list[str]) -> tuple[ParameterRecord, ...]:
    """Return the table's records with the tied ones marked, and the derived numbers after them."""
    source = "loaded steady points and the fitted R: Ω_0 = Ω + R (τ_aero + k_d Ω)/(k_m k_v)"
    table = tuple(
        ParameterRecord(r.name, r.symbol, r.unit, "derived", r.meaning, source) if r.name in tied else r
        for r in records
    )
    scale = tuple(
        ParameterRecord(name, symbol, unit, "derived", meaning, "computed from the set")
        for symbol, name, unit, meaning in _DERIVED
    )
    return (*table, *scale)


def _trial_results(objective: MotorObjective, rows: FloatArray) -> tuple[TrialResult, ...]:
    samples, reached = objective.simulate(rows)
    sensors = objective.sensors(rows)
    by_channel, _ = objective.cost(samples, reached, sensors, objective.threads)
    simulated = objective.cost.prepared(samples, sensors)
    return tuple(
        TrialResult(
            name=trial.entry.name,
            use="fit" if in_search(trial) else "validate",
            time=trial.target.time,
            measured=trial.target.measured,
            valid=trial.target.valid,
            simulated=simulated[t],
            nrmse=by_channel[:, t],
        )
        for t, trial in enumerate(objective.trials)
    )


def _settings(campaign: MotorCampaign, bench: Bench) -> dict[str, Any]:
    """Return what a simulator must know beside the numbers."""
    command = campaign.command
    return {
        "command": {
            "unit": command.unit,
            "minimum": command.minimum,
            "neutral": command.minimum if command.neutral is None else command.neutral,
            "maximum": command.maximum,
            "bidirectional": command.neutral is not None and command.neutral > command.minimum,
        },
        "voltage": "V_c = k_v Ω_0(u) V/V_ref; Ω_0(u) = a u + b sign(u) per direction",
        "curves": "c2 Ω|Ω| + c1 Ω, one pair of coefficients per direction",
        "stator torque": "k_m I_eff - k_d Ω, positive when it drives the rotor forward",
        "static curves": [
            {
                "quantity": fit.quantity,
                "direction": fit.direction,
                "coefficients": list(fit.coefficients),
                "standard errors": list(fit.standard_errors),
                "units": list(fit.units),
                "R²": fit.r_squared,
                "points": fit.points,
                "outliers": fit.outliers,
            }
            for fit in bench.curves.fits
        ],
        "tolerance": FIT_TOLERANCE,
    }


def score_values(
    campaign: MotorCampaign, bench: Bench, values: Mapping[str, float], threads: int | None = None
) -> FloatArray:
    """Return the NRMSE (T, 2) of one set of parameter values [SI] on every trial of a prepared bench.

    Names left out take what the campaign fixes. The way to ask what the truth of a synthetic campaign scores.
    """
    space = search_space(campaign, bench)
    every = MotorObjective.build(campaign, space, bench, bench.trials, threads)
    own = {d: tie for d, tie in every.ties.items() if f"no_load_slope_{d}" not in values}
    objective = MotorObjective(space, bench.trials, own, every.cost, every.jobs, threads)
    return objective.score(pack({**bench.values, **space.fixed, **values})[None])[0][0]
