"""`fit-motor`: bench logs in, five ranked parameter sets out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.campaign import MotorCampaign, read_campaign
from sysid.fit.agreement import loose_warnings
from sysid.fit.engine import SearchSettings
from sysid.fit.result import FitResult, RankedSets, TrialResult, bound_warnings, ranked_sets
from sysid.motor.model import PARAMETERS, invariants, unpack
from sysid.parameter_sets import ParameterRecord, parameter_records
from sysid.parameters import SearchSpace
from sysid.pipelines.bench_logs import filter_design
from sysid.pipelines.motor_bench import SATURATION, Bench, prepare_bench, search_space, untested_rows
from sysid.pipelines.motor_cost import CHANNEL_UNITS, CHANNELS
from sysid.pipelines.motor_inertia import spike_inertia
from sysid.pipelines.motor_ladder import climb, ladder_sentences
from sysid.pipelines.motor_objective import FIT_TOLERANCE, MotorObjective
from sysid.pipelines.motor_profile import profile
from sysid.pipelines.motor_saturation import (
    SaturationFit,
    fit_saturation,
    reversal_delays,
    saturation_space,
    with_saturation,
)
from sysid.pipelines.search import (
    FitOptions,
    Search,
    check_start,
    collected_warnings,
    fit_identity,
    naming,
    provenance,
    search,
)

FloatArray = NDArray[np.float64]

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
    options = options or FitOptions()
    tell = say or (lambda sentence: None)
    folder = options.folder(campaign.name)
    check_start(folder, options)
    with naming(path), collected_warnings(lambda text: tell(f"warning: {text}")) as doubts:
        ranges = campaign.parameters.measured_ranges(PARAMETERS)
        settings = options.settings(campaign.fit)
        bench = prepare_bench(campaign, path)
        space = search_space(campaign, bench)
        saturation_space(campaign, bench, PARAMETERS.nominal)  # refused before the search, not after it
        objective = MotorObjective.build(campaign, space, bench, bench.fitted, options.threads)
        _say_what_is_fitted(campaign, bench, space, tell)
        hashes = {trial.entry.name: str(trial.provenance["sha256"]) for trial in bench.trials}
        identity = fit_identity(path, settings, space, hashes)
        found = search(
            objective, settings, folder=folder, options=options, identity=identity,
            simulated="trials", tell=tell,
        )  # fmt: skip
        sets = ranked_sets(found.runs, space)
        after = _after_the_search(campaign, bench, objective, sets, found, settings, tell)
    every = MotorObjective.build(campaign, space, bench, bench.trials, options.threads)
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
    records = _records(table, tied, after.saturation)
    exported = rows.copy()
    exported[:, [_INDEX[name] for name in unknown]] = np.nan
    derived = np.array([list(invariants(unpack(row)).values()) for row in rows])
    at_bound = np.hstack([sets.at_bound, np.zeros(derived.shape, dtype=np.int8)])
    if after.saturation is not None:
        columns = [_INDEX[row.name] for row in after.saturation.free]
        at_bound[:, columns] = after.saturation.at_bound
    closing = (
        *bound_warnings(records, at_bound),
        *loose_warnings(found.runs, space),
        *_unresolved_inductance(bench, rows[0]),
    )
    for sentence in closing:
        tell(f"warning: {sentence}")
    result = FitResult(
        kind="motor",
        name=campaign.name,
        state=found.state,
        parameters=records,
        runs=found.runs,
        set_runs=sets.run,
        set_seeds=sets.seed,
        cube=sets.cube,
        values=np.hstack([exported, derived]),
        at_bound=at_bound,
        nrmse=sets.cost,
        trials=_trial_results(every, rows),
        channels=CHANNELS,
        channel_units=CHANNEL_UNITS,
        channel_weights=(campaign.cost.weights.torque, campaign.cost.weights.speed),
        settings={**_settings(campaign, bench), **after.settings},
        provenance=provenance(
            path,
            settings,
            campaign.cost.denominator,
            filter_design(campaign, [trial.log for trial in bench.trials]),
            {trial.entry.name: trial.provenance for trial in bench.trials},
        ),
        warnings=(
            *doubts,
            *found.warnings,
            *closing,
            *after.warnings,
        ),
    )
    return result, found.write(result, folder, options)


@dataclass(frozen=True, eq=False)
class _After:
    """What follows the search: the dead band, the ladder, the profile.

    Parameters
    ----------
    rows : (S, n_table) array
        Sets with the dead band [SI].
    saturation : SaturationFit, optional
    settings : dict
        For the result.
    warnings : tuple of str
    """

    rows: FloatArray
    saturation: SaturationFit | None
    settings: dict[str, Any]
    warnings: tuple[str, ...]


def _after_the_search(
    campaign: MotorCampaign,
    bench: Bench,
    objective: MotorObjective,
    sets: RankedSets,
    found: Search,
    settings: SearchSettings,
    tell: Callable[[str], None],
) -> _After:
    rows = objective.complete(sets.values)
    if any(run.stop_reason == "interrupted" for run in found.runs):
        why = "the fit was interrupted"
        return _After(rows, None, {"saturation": {"stage": "not fitted", "why": why}}, ())
    threads, space = objective.threads, objective.space
    warned: list[str] = []
    saturation = fit_saturation(campaign, bench, rows, settings, sets.seed, threads)
    rows = with_saturation(rows, saturation)
    best = unpack(rows[0])
    given = set(SATURATION) <= {*bench.measured, *campaign.parameters.fixed}
    out: dict[str, Any] = {"reversal delays": reversal_delays(bench, best)}
    if saturation is not None:
        out["saturation"] = saturation.document()
        tell(
            f"dead band from {', '.join(saturation.trials)}: I_sat {best['saturation_current']:.3g} A below "
            f"{best['saturation_speed']:.3g} rad/s; NRMSE there {100 * saturation.without[0]:.2f} % without, "
            f"{100 * saturation.nrmse[0]:.2f} % with it"
        )
    elif given:
        out["saturation"] = {"stage": "not fitted", "why": "given by the campaign"}
    else:
        why = "no trial of direction = 'reversal' has use = 'fit'"
        out["saturation"] = {"stage": "not fitted", "why": why}
        warned.append(
            f"saturation_current and saturation_speed are not fitted ({why}); they keep Table I's "
            f"{best['saturation_current']:g} A and {best['saturation_speed']:g} rad/s"
        )
    climbed = climb(
        campaign, bench, space, best, saturation is not None or given, settings, sets.seed[0], threads
    )
    out["ladder"] = [rung.document(bench.trials) for rung in climbed]
    warned += ladder_sentences(out["ladder"])
    if "viscous_damping" in space.names:
        # Of the torque curve's linear coefficient, which stands beside k_d in the equation of the rotor.
        errors = [fit.standard_errors[1] for fit in bench.curves.fits if fit.quantity == "torque"]
        damping = profile(objective, "viscous_damping", sets.cube[0], sets.seed[0], max(errors))
        out["profiles"] = {damping.name: damping.document()}
        if damping.sentence is not None:
            warned.append(damping.sentence)
    spikes = spike_inertia([trial.log for trial in bench.fitted], best)
    out["rotor inertia from torque spikes"] = spikes.document()
    warned += [] if spikes.sentence is None else [spikes.sentence]
    for sentence in warned:
        tell(f"warning: {sentence}")
    return _After(rows, saturation, out, tuple(warned))


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
        tares = ", ".join(
            f"{name} {1e3 * tare.value:.3g} m{unit}"
            for name, unit in (("torque", "N·m"), ("thrust", "N"))
            if (tare := trial.log.tares.get(name)) is not None and tare.rows > 0
        )
        if tares:
            turned = ", torque sign turned" if trial.log.torque_sign < 0 else ""
            tell(f"trial {trial.entry.name}: tare from its rows at rest: {tares}{turned}")
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
    if untested_rows(campaign, bench):
        tell("nothing was recorded in reverse: its curves and no-load speed are left out of the sets (NaN)")


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


def _records(
    records: tuple[ParameterRecord, ...], tied: list[str], saturation: SaturationFit | None
) -> tuple[ParameterRecord, ...]:
    """Return the table's records, those of the tie and the second stage marked, then the derived numbers."""
    if saturation is not None:
        late = {row.name: row for row in saturation.free}
        stage = f"second stage: reversals of {', '.join(saturation.trials)}, all else held"
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


def _trial_results(objective: MotorObjective, rows: FloatArray) -> tuple[TrialResult, ...]:
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
