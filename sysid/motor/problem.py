"""`fit-motor`: bench logs in, five ranked parameter sets out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.campaign import MotorCampaign, read_campaign
from sysid.fit.result import FitResult, TrialResult, ranked_sets
from sysid.motor.bench_logs import command_range
from sysid.motor.cost import CHANNEL_UNITS, CHANNELS
from sysid.motor.dead_band import (
    SaturationFit,
    saturation_space,
)
from sysid.motor.follow_up import after_the_search, say_what_is_fitted, unresolved_inductance
from sysid.motor.known_values import Bench, prepare_bench, search_space, untested_rows
from sysid.motor.log_delays import MEAN_SOURCE, own_rows
from sysid.motor.model import PARAMETERS, invariants, unpack
from sysid.motor.objective import FIT_TOLERANCE, MotorObjective
from sysid.motor.targets import filter_design, measured_spectrum
from sysid.parameter_sets import ParameterRecord, parameter_records
from sysid.types import FloatArray
from sysid.workflows.fit import FitWalk, Outcome
from sysid.workflows.search import FitOptions

_INDEX = {name: i for i, name in enumerate(PARAMETERS)}
_DERIVED = (
    ("k²/R", "k2_over_R", "N·m·s/rad", "Torque per slip speed; fixed even without a known Kv."),
    ("R/L", "R_over_L", "1/s", "Rate of the current; fixed even without a known Kv."),
    ("k·I_sat", "k_I_sat", "N·m", "Torque in the dead band; fixed even without a known Kv."),
    ("I^r R/k²", "electromechanical_time_constant", "s", "Time constant of the unloaded rotor as L → 0."),
)


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
    with FitWalk(path, campaign, options, say) as walk:
        return _walked(walk, campaign)


def _walked(walk: FitWalk, campaign: MotorCampaign) -> tuple[FitResult, Path]:
    """Walk a fit to its end."""
    path, threads = walk.path, walk.options.threads
    with walk.prepared():
        ranges = campaign.parameters.measured_ranges(PARAMETERS)
        bench = prepare_bench(campaign, path)
        space = search_space(campaign, bench)
        # Refused before the search, not after it.
        saturation_space(campaign, bench, space.table, PARAMETERS.nominal)
        objective = MotorObjective.build(campaign, space, bench, bench.fitted, threads, dynamic=True)
        say_what_is_fitted(campaign, bench, space, walk.tell)
        expected = _expected(campaign, bench, objective, walk.tell) if walk.options.check else {}
        found = walk.search(objective, bench.hashes, "trials")
        sets = ranked_sets(found.runs, space)
        after = after_the_search(campaign, bench, objective, sets, found, walk)
    sets = after.sets
    every = MotorObjective.build(campaign, space, bench, bench.trials, threads)
    rows = after.rows
    tied = [f"no_load_{what}_{d}" for d in every.ties for what in ("slope", "intercept")]
    unknown = untested_rows(campaign, bench)
    table = parameter_records(
        space,
        {name: source for name, source in bench.measured.items() if name not in tied},
        ranges,
        stated={**bench.stated, **dict.fromkeys(campaign.parameters.fixed, "campaign: parameters.fixed")},
        unknown=unknown,
    )
    records = _records(table, tied, after.saturation, bool(own_rows(space)))
    exported = rows.copy()
    exported[:, [_INDEX[name] for name in unknown]] = np.nan
    derived = np.array([list(invariants(unpack(row)).values()) for row in rows[:, : len(PARAMETERS)]])
    at_bound = np.hstack([sets.at_bound, np.zeros(derived.shape, dtype=np.int8)])
    if after.saturation is not None:
        index = {name: i for i, name in enumerate(space.table)}
        columns = [index[row.name] for row in after.saturation.free]
        at_bound[:, columns] = after.saturation.at_bound
    weights = campaign.cost.weights
    outcome = Outcome(
        records=records,
        values=np.hstack([exported, derived]),
        at_bound=at_bound,
        nrmse=after.nrmse,
        trials=motor_trial_results(every, rows),
        channels=list(zip(CHANNELS, CHANNEL_UNITS, (weights.torque, weights.speed), strict=True)),
        settings={**_settings(campaign, bench), **after.settings},
        filters=filter_design(campaign, [trial.log for trial in bench.trials]),
        logs=bench.log_provenance,
        warnings=unresolved_inductance(bench, rows[0]),
        told=after.warnings,
        more=expected,
    )
    return walk.finish(space, found, sets, outcome)


def _expected(
    campaign: MotorCampaign, bench: Bench, objective: MotorObjective, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Say what the trials are expected to fix, and return it for the provenance."""
    # What judges an objective stands above it.
    from sysid.trust.verdicts import EXPECTED, sentences
    from sysid.workflows.check import quick_motor
    from sysid.workflows.reopen import bench_problem

    found = quick_motor(bench_problem(campaign, bench, objective))
    for sentence in sentences(found):
        tell(f"expected: {sentence}")
    return {EXPECTED: [one.document() for one in found]}


def _records(
    records: tuple[ParameterRecord, ...],
    tied: list[str],
    saturation: SaturationFit | None,
    own_delays: bool,
) -> tuple[ParameterRecord, ...]:
    """Return the table's records, those of the tie and the second stage marked, then the derived numbers."""
    if own_delays:
        records = tuple(
            ParameterRecord(r.name, r.symbol, r.unit, "derived", r.meaning, MEAN_SOURCE)
            if r.name == "command_delay"
            else r
            for r in records
        )
    if saturation is not None:
        late = {row.name: row for row in saturation.free}
        stage = f"second stage: {saturation.shown_by} of {', '.join(saturation.trials)}, all else held"
        records = tuple(
            replace(ParameterRecord.of(late[r.name], "free", r.measured_range), source=stage)
            if r.name in late
            else r
            for r in records
        )
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


def motor_trial_results(objective: MotorObjective, rows: FloatArray) -> tuple[TrialResult, ...]:
    """Return every trial of an objective, measured and simulated with full rows (S, n_table) [SI]."""
    samples, reached = objective.simulate(rows)
    sensors = objective.sensors(rows)
    by_channel, _ = objective.cost(samples, reached, sensors, objective.threads)
    simulated = objective.cost.prepared(samples, sensors)
    return tuple(
        TrialResult(
            name=trial.entry.name,
            use=trial.entry.use,
            time=trial.target.time,
            measured=trial.target.measured,
            valid=trial.target.valid,
            simulated=simulated[t],
            nrmse=by_channel[:, t],
            spectrum=measured_spectrum(trial.log, trial.target.time) if trial.log.fast else None,
            thrust=trial.thrust,
            commands=np.column_stack([trial.log.steps.time, trial.log.steps.level]),
        )
        for t, trial in enumerate(objective.trials)
    )


def _settings(campaign: MotorCampaign, bench: Bench) -> dict[str, Any]:
    """Return what a simulator must know beside the numbers."""
    u_of = command_range(campaign)
    return {
        "command": {
            "unit": u_of.unit,
            "minimum": u_of.minimum,
            "neutral": u_of.neutral,
            "maximum": u_of.maximum,
            "bidirectional": u_of.forward_half is not None or u_of.neutral > u_of.minimum,
            "forward half": u_of.forward_half,
        },
        "voltage": "V_c = k_v Ω_0(u) V/V_ref; Ω_0(u) = a u + b sign(u) per direction",
        "curves": "c2 Ω|Ω| + c1 Ω, one pair of coefficients per direction",
        "stator torque": "k_m I_eff - k_d Ω, positive when it drives the rotor forward",
        "static curves": [fit.document() for fit in bench.curves.fits],
        "tolerance": FIT_TOLERANCE,
    }
