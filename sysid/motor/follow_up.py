"""What follows the search of a motor fit: the dead band, and what is noticed about it and the logs."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import NotRequired, TypedDict

import numpy as np

from sysid.campaign import MotorCampaign
from sysid.fit.kind import Course, FitOutcome
from sysid.fit.result import RankedSets
from sysid.fit.stopping import CutReason, CutShort
from sysid.journal import Finding, folded, note, notice, spoken, tell
from sysid.motor.bench_logs import campaign_range
from sysid.motor.dead_band import (
    BandProfile,
    SaturationFit,
    band_profiles,
    fit_saturation,
    reversal_delays,
    saturation_space,
)
from sysid.motor.inertia import spike_inertia
from sysid.motor.known_values import CONSTANTS, NO_INDUCTANCE, SATURATION, Bench, untested_rows
from sysid.motor.log_delays import MEAN_SOURCE, averaged, delay_name, log_rows
from sysid.motor.model import PARAMETERS, invariants, unpack
from sysid.motor.problem import FIT_TOLERANCE, MotorProblem
from sysid.motor.stand import StandValues, stand_values
from sysid.motor.static_curves import CurveFit, no_load_line
from sysid.motor.targets import PreparedTrial
from sysid.parameter_sets import (
    COMBINATIONS,
    INTERVALS,
    KNOWN_ANYHOW,
    NOT_ALONE,
    NOT_ASSESSED,
    ParameterRecord,
    parameter_records,
)
from sysid.types import FloatArray

# Steps of the delays of a held-out log that are tried, one after the other [s].
_DELAY_STEPS = (4e-3, 4e-4, 1e-4)
# Number of those steps to either side.
_DELAY_REACH = 20
# Ratio of the ends of a range of equally good edges of the dead band from which a fit warns of the range.
_WIDE = 1.5
_WHY: dict[CutReason, str] = {
    "interrupted": "the fit was interrupted",
    "time": "the time limit ended the fit",
}
_DERIVED = tuple(
    ParameterRecord(name, symbol, unit, "derived", meaning, "computed from the set")
    for symbol, name, unit, meaning in (
        ("k²/R", "k2_over_R", "N·m·s/rad", "Torque per slip speed; known even without a Kv."),
        ("R/L", "R_over_L", "1/s", "Rate of the current; known even without a Kv."),
        ("k·I_sat", "k_I_sat", "N·m", "Torque in the dead band; known even without a Kv."),
        (
            "I^r R/k²", "electromechanical_time_constant", "s",
            "Time constant of the unloaded rotor as L → 0.",
        ),
    )
)  # fmt: skip


def _treatment(trial: PreparedTrial) -> Iterator[Finding]:
    """Yield what was done to the log of a trial: tare, turned signs, stalls of the logger."""
    log, trials = trial.log, (trial.entry.name,)
    tares = {name: tare for name, tare in log.tares.items() if np.isfinite(tare.error)}
    shown = [
        f"{name} {1e3 * tares[name].value:.3g} m{unit}"
        for name, unit in (("torque", "N·m"), ("thrust", "N"))
        if name in tares
    ]
    if shown:
        source = log.tares["torque" if "torque" in log.tares else "thrust"].source
        largest = max(abs(tare.value) for tare in tares.values())
        sentence = f"tare from its {source.replace('_', ' ')}: {', '.join(shown)}"
        yield replace(note(f"tare-{source}", sentence), trials=trials, size=largest)
    turned = " and ".join(name for name, sign in log.signs.items() if sign < 0)
    if turned:
        yield replace(note(f"turned-{turned}", f"sign of {turned} reversed"), trials=trials)
    lost = sum(end - start for start, end in log.doubtful)
    if lost:
        sentence = f"{len(log.doubtful)} stalls of the logger around commands: {lost:.1f} s are not compared"
        yield replace(note("logger-stalls", sentence), trials=trials, size=lost)


def shown_by_stand(campaign: MotorCampaign, bench: Bench) -> StandValues:
    """Return what the fitted logs give without a winding."""
    constant = bench.values.get("torque_constant", PARAMETERS.nominal["torque_constant"])
    logs = [trial.log for trial in bench.fitted]
    return stand_values(logs, bench.curves, constant, campaign.log.calibration_error)


def begin_fit(problem: MotorProblem) -> None:
    """Refuse a dead band that cannot be fitted, and tell what is free and what the logs showed."""
    campaign, bench, space = problem.campaign, problem.bench, problem.space
    band = saturation_space(campaign, bench, space.table, PARAMETERS.nominal)
    searched = len(bench.fitted)
    late = sum(trial not in bench.fitted for trial in bench.banded) if band is not None else 0
    free = ", ".join(row.name for row in space.found)
    tell(
        f"{searched} trial{'s' * (searched != 1)} to fit, {f'{late} for the dead band, ' if late else ''}"
        f"{len(bench.trials) - searched - late} to validate; free: {free}"
    )
    for fit in bench.curves.fits:
        tell(curve_sentence(fit), detail=True)
    for way, tie in bench.laws.items():
        law = f"so the fit follows {'the levels' if way in bench.curves.maps else 'the line'}"
        tell(
            f"supply law, {way}: V_c = k_v Ω_0(u) V/V_ref; a straight line of speed over command misses the "
            f"{len(tie.levels) - 1} steady levels by {100 * tie.misfit:.2g} % of the top speed, {law}",
            detail=True,
        )
        if way in bench.curves.maps:
            notice(
                "supply-law-is-a-map",
                f"the {way} speed is no straight line of the command: the fit follows the measured steady "
                "levels (the report shows them), but exported sets have the straight line alone, which "
                f"misses the levels by {100 * tie.misfit:.2g} % of the top speed (rms)",
            )
    shown = shown_by_stand(campaign, bench)
    for sentence in shown.sentences():
        tell(sentence, detail=True)
    for found in shown.findings():
        notice(found.code, found.sentence)
    for finding in folded(finding for trial in bench.trials for finding in _treatment(trial)):
        tell(spoken(finding, len(bench.trials)), detail=True)
    if bench.curves.ties and "viscous_damping" not in space.names:
        tell(
            "no log without propeller: the no-load speed is computed from loaded points and R, and k_d, "
            f"which then cannot be told from k²/R, stays at {space.fixed['viscous_damping']:.2g} N·m·s/rad",
            detail=True,
        )
    if "winding_inductance" in bench.guessed & {*space.fixed}:
        tell(NO_INDUCTANCE, detail=True)
    if untested_rows(campaign, bench):
        tell("nothing was recorded in reverse: its curves and no-load speed are left out of the sets (NaN)")


def curve_sentence(fit: CurveFit) -> str:
    """Return a static curve in a sentence: coefficients, standard errors, how well the points lie on it."""
    names = ("a", "b") if fit.quantity == "no_load" else ("c2", "c1")
    each = zip(names, fit.coefficients, fit.standard_errors, fit.units, strict=True)
    numbers = ", ".join(f"{name} = {value:.5g} ± {error:.2g} {unit}" for name, value, error, unit in each)
    outliers = f", outliers: {fit.outliers}" if fit.outliers else ""
    quality = f"R² {fit.r_squared:.5f} over {fit.points} points{outliers}"
    return f"{fit.quantity}, {fit.direction}: {numbers}; {quality}"


def follow_up(problem: MotorProblem, course: Course) -> FitOutcome:
    """Fit the dead band, rank the final sets, notice what is doubtful.

    The sets are ranked by the NRMSE of their final values over the fitted forward and reverse trials, which
    is without starts from rest, as in the search. Where the fit is cut short, the dead band is left to
    ``--resume``. Values of a direction that was not recorded are NaN.
    """
    campaign, bench, space = problem.campaign, problem.bench, problem.space
    # A search that ends early may leave the scale anywhere.
    cube, at_bound = problem.at_stated_scale(course.sets.cube), course.sets.at_bound.copy()
    at_bound[:, space.columns] = space.at_bound(cube)
    course = replace(course, sets=replace(course.sets, cube=cube, values=space.full(cube), at_bound=at_bound))
    rows = averaged(space, problem.complete(course.sets.values))
    cut, band = course.cut, None
    if cut is None:
        try:
            band = fit_saturation(problem, rows, course.settings, course.sets.seed, course.go_on)
        except CutShort as error:
            cut = error.reason
    searched = [] if band is None else [space.table.index[row.name] for row in band.free]
    if band is not None:
        rows[:, searched] = band.values
    nrmse = problem.fitted.nrmse(rows)
    # The search has not seen the final values.
    order = np.argsort(nrmse, kind="stable")
    rows, nrmse, found = rows[order], nrmse[order], course.sets
    sets = RankedSets(
        tuple(found.run[i] for i in order), tuple(found.seed[i] for i in order), found.cube[order],
        found.cost[order], found.values[order], found.at_bound[order],
    )  # fmt: skip
    if band is not None:
        band = replace(band, **{name: getattr(band, name)[order] for name in band.by_set})
    given = set(SATURATION) <= {*bench.measured, *campaign.parameters.fixed}
    if cut is None:
        settings = _findings(problem, rows[0], band, given)
    else:
        settings = {"saturation": {"fitted": False, "why": _WHY[cut]}}
        notice("cut-short", f"{_WHY[cut]}: the dead band was not fitted; continue it with --resume")
    # k_d drags by 5 µN·m at 500 rad/s, the air by 40 mN·m: any small value serves.
    settings[NOT_ASSESSED] = [name for name in ("viscous_damping",) if name in space.names]
    if not bench.scale_known:
        banded = ["k_I_sat"] if band is not None or given else []
        settings |= {
            NOT_ALONE: ["winding_resistance", "winding_inductance", SATURATION[0], *CONSTANTS],
            COMBINATIONS: ["k2_over_R", "R_over_L", *banded, "electromechanical_time_constant"],
        }
    best = unpack(rows[0], space.table)
    rise = best["winding_inductance"] / best["winding_resistance"]
    # A rise within one step of the finest grid that any fitted log is compared on leaves no sample inside it.
    finest = min(float(np.median(np.diff(trial.target.time))) for trial in bench.fitted)
    if "winding_inductance" in space.names and rise <= finest:
        fast = any(trial.log.fast for trial in bench.fitted)
        step = "raise filter.stop_edge, if the noise allows it" if fast else "record at 1 kHz"
        notice(
            "inductance-unresolved",
            f"L/R of the best set is {1e3 * rise:.3g} ms, but the fastest fitted log is compared every "
            f"{1e3 * finest:.3g} ms: the logs only say that L is small, not how small; {step}",
        )

    unknown = untested_rows(campaign, bench)
    at_bound = np.pad(sets.at_bound, ((0, 0), (0, len(_DERIVED))))
    if band is not None:
        at_bound[:, searched] = band.at_bound
    u_of = campaign_range(campaign)
    shown = shown_by_stand(campaign, bench)
    stated = shown.document()
    free = best["winding_resistance"] if "winding_resistance" in space.names else None
    # Further facts that a simulator must know.
    circumstances: dict[str, object] = {
        "command": {
            **{name: getattr(u_of, name) for name in ("unit", "minimum", "neutral", "maximum")},
            "bidirectional": u_of.forward_half is not None or u_of.neutral > u_of.minimum,
            "forward_half": u_of.forward_half,
        },
        "voltage": "V_c = k_v Ω_0(u) V/V_ref; Ω_0(u) = a u + b sign(u) per direction",
        "curves": "c2 Ω|Ω| + c1 Ω, one pair of coefficients per direction",
        "stator_torque": "k_m I_eff - k_d Ω, positive when it drives the rotor forward",
        "static_curves": [fit.document() for fit in bench.curves.fits],
        "supply_law": {way: tie.document(way in bench.curves.maps) for way, tie in bench.laws.items()},
        "stand": stated | {"sentences": [*stated["sentences"], *shown.beside(best["command_delay"], free)]},
        KNOWN_ANYHOW: shown.in_short,
        "tolerance": FIT_TOLERANCE,
    }
    return FitOutcome(
        sets=sets,
        rows=rows,
        records=_records(problem, unknown, band),
        values=numbers(problem, rows),
        at_bound=at_bound,
        nrmse=nrmse,
        settings={**circumstances, **settings},
        cut=cut,
    )


def numbers(problem: MotorProblem, rows: FloatArray) -> FloatArray:
    """Return rows (S, n_table) [SI] with their no-load lines, and behind them the numbers that follow.

    NaN replaces what nothing recorded determines.
    """
    rows = problem.complete(rows)
    derived = np.array([list(invariants(unpack(row)).values()) for row in rows[:, : len(PARAMETERS)]])
    unknown = untested_rows(problem.campaign, problem.bench)
    rows[:, [PARAMETERS.index[name] for name in unknown]] = np.nan
    return np.hstack([rows, derived])


def _findings(
    problem: MotorProblem, row: FloatArray, band: SaturationFit | None, given: bool
) -> dict[str, object]:
    """Return what a result states of the best set `row` (n_table,) [SI]; notice what is doubtful."""
    campaign, bench, best = problem.campaign, problem.bench, unpack(row, problem.space.table)
    profiles = {} if band is None else band_profiles(problem, row, band)
    saturation = _about_saturation(problem, band, profiles, best, given)
    drop = best["winding_resistance"] / (best["torque_constant"] * best["back_emf_constant"])
    curve = {name: best[name] for name in PARAMETERS}
    inertia = spike_inertia(campaign, [trial.log for trial in bench.fitted], curve)
    if inertia.doubt is not None:
        notice(inertia.doubt.code, inertia.doubt.sentence)
    return {
        "reversal_delays": reversal_delays(campaign, bench, best),
        "command_delays": log_delays(problem, row),
        "saturation": saturation,
        INTERVALS: {
            name: {
                "interval_95": list(one.interval), "open_95": list(one.opened), "verdict": one.verdict,
                "doubt": "the range over which the NRMSE of its trials is within 1 % of the lowest",
            }
            for name, one in profiles.items()
            # Without Kv or a motor current the scale of the current is arbitrary.
            if bench.scale_known or name != SATURATION[0]
        },
        "static_curves_of_best_set": [
            tie.fit(direction, drop, best["viscous_damping"]).document()
            for direction, tie in bench.curves.ties.items()
            if direction in problem.ties
        ],
        "rotor_inertia_from_torque_spikes": inertia.document(),
    }  # fmt: skip


def _about_saturation(
    problem: MotorProblem,
    band: SaturationFit | None,
    profiles: Mapping[str, BandProfile],
    best: Mapping[str, float],
    given: bool,
) -> dict[str, object]:
    """Return what the result states of the second stage; notice what is doubtful about it."""
    if band is None:
        why = "given by the campaign"
        if not given:
            why = "no trial of use = 'fit' shows them by a reversal or by a start from rest inside its window"
            notice(
                "dead-band-not-fitted",
                f"saturation_current and saturation_speed are not fitted ({why}); they stay at "
                f"{best['saturation_current']:g} A and {best['saturation_speed']:g} rad/s, which the paper's "
                "Table I states of another motor: do not simulate reversals or starts from rest with them",
            )
        return {"fitted": False, "why": why}
    trials, parts = ", ".join(band.trials), band.shown_by.replace("_", " ")
    tell(
        f"dead band from {parts} of {trials}: I_sat {best['saturation_current']:.3g} A below "
        f"{best['saturation_speed']:.3g} rad/s; NRMSE there {100 * band.without[0]:.2f} % without, "
        f"{100 * band.nrmse[0]:.2f} % with it"
        + "; the NRMSE of the fit leaves the starts out"
        * ("starts" in parts),
        detail=True,
    )
    if not band.felt:
        notice(
            "dead-band-not-felt",
            f"{parts} of {trials} are as good without a dead band: nothing shows {' and '.join(SATURATION)}; "
            "add a reversal trial of use = 'fit' where the controller reverses",
        )
    elif band.shown_by != "reversals":
        notice(
            "dead-band-from-starts",
            "only starts from rest show the dead band, so it does not describe a controller that reverses in "
            "another way; add a reversal trial of use = 'fit'",
        )
    if band.felt and {*SATURATION} <= {*profiles}:
        low, high = profiles[SATURATION[1]].interval
        if high > _WIDE * low:
            notice(
                "dead-band-edge-open",
                f"{parts} of {trials} do not determine saturation_speed: from {low:.2g} to {high:.2g} rad/s, "
                "each with the saturation_current that fits best, the NRMSE is within 1 % of the lowest; do "
                "not use its value",
            )
    walked = {
        name: {"values": one.values.tolist(), "nrmse": one.nrmse.tolist()} for name, one in profiles.items()
    }
    return band.document() | {"profiles": walked}


class LogDelay(TypedDict):
    """Command delay of a log [s]; its own one and both NRMSE [1] where no stage has `estimated` it."""

    log: str
    delay: float
    estimated: bool
    own_delay: NotRequired[float]
    nrmse: NotRequired[float]
    nrmse_with_own_delay: NotRequired[float]


def log_delays(problem: MotorProblem, row: FloatArray) -> list[LogDelay]:
    """Return the command delay of every log: as fitted, or as a log shows it that no stage has seen.

    `problem` has all trials. A delay of the second kind is looked for on the log itself with all other
    values of the row (n_table,) fixed; the scores of that log do not use it.
    """
    bench = problem.bench
    values = unpack(row, problem.space.table)
    seen = {trial.entry.log for trial in (*bench.fitted, *bench.banded)}
    out: list[LogDelay] = []
    for log in dict.fromkeys(trial.entry.log for trial in bench.trials):
        used = values.get(delay_name(log), values["command_delay"])
        fact: LogDelay = {"log": log, "delay": used, "estimated": log in seen}
        if log not in seen:
            alone = problem.only([trial.entry.name for trial in bench.trials if trial.entry.log == log])
            best, costs = used, np.zeros(1)
            for step in _DELAY_STEPS:
                steps = best + step * np.arange(-_DELAY_REACH, _DELAY_REACH + 1)
                steps = np.clip(steps, 0.0, PARAMETERS["command_delay"].upper)
                around = np.concatenate([[used], steps]).astype(np.float64)
                costs = alone.nrmse_with(row, command_delay=around)
                best = float(around[np.argmin(costs)])
            fact["own_delay"] = best
            fact["nrmse"], fact["nrmse_with_own_delay"] = float(costs[0]), float(costs.min())
        out.append(fact)
    return out


def _records(
    problem: MotorProblem, unknown: tuple[str, ...], band: SaturationFit | None
) -> tuple[ParameterRecord, ...]:
    """Return the table's records, with the sources of tie and second stage, then the derived ones."""
    choices, bench, space = problem.campaign.parameters, problem.bench, problem.space
    tie = "loaded steady points and the fitted R: Ω_0 = Ω + R (τ_aero + k_d Ω)/(k_m k_v)"
    computed = {name: tie for direction in problem.ties for name in no_load_line(direction)}
    if log_rows(space):
        computed["command_delay"] = MEAN_SOURCE
    late, stage = {}, ""
    if band is not None:
        late = {row.name: row for row in band.free}
        parts = band.shown_by.replace("_", " ")
        stage = f"second stage: {parts} of {', '.join(band.trials)}, all other values fixed"
    out = []
    for record in parameter_records(
        space,
        bench.measured,
        choices.measured_ranges(PARAMETERS),
        _DERIVED,
        stated={**bench.stated, **dict.fromkeys(choices.fixed, "campaign: parameters.fixed")},
        unknown=unknown,
    ):
        if record.name in computed:
            record = record.computed(computed[record.name])
        elif record.name in late:
            free = ParameterRecord.of(late[record.name], "free", record.measured_range)
            record = replace(free, source=stage)
        out.append(record)
    return tuple(out)
