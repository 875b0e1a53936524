"""Motors as a kind of model: how a bench is opened, and what its fit leaves behind."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.campaign import MotorCampaign
from sysid.fit.problem import Course, Kind, Outcome, Words
from sysid.motor.bench_logs import command_range
from sysid.motor.candidates import candidate_trials
from sysid.motor.dead_band import SaturationFit
from sysid.motor.follow_up import after_the_search, begin, notice_unresolved_inductance
from sysid.motor.known_values import Bench, prepare_bench, search_space, untested_rows
from sysid.motor.log_delays import MEAN_SOURCE, own_rows
from sysid.motor.model import PARAMETERS, invariants, unpack
from sysid.motor.problem import FIT_TOLERANCE, MotorProblem
from sysid.parameter_sets import ParameterRecord, parameter_records

_DERIVED = (
    ("k²/R", "k2_over_R", "N·m·s/rad", "Torque per slip speed; fixed even without a known Kv."),
    ("R/L", "R_over_L", "1/s", "Rate of the current; fixed even without a known Kv."),
    ("k·I_sat", "k_I_sat", "N·m", "Torque in the dead band; fixed even without a known Kv."),
    ("I^r R/k²", "electromechanical_time_constant", "s", "Time constant of the unloaded rotor as L → 0."),
)


def _open(campaign: MotorCampaign, path: Path, threads: int | None) -> MotorProblem:
    # Refused before the logs are read.
    campaign.parameters.measured_ranges(PARAMETERS)
    bench = prepare_bench(campaign, path)
    return MotorProblem.build(campaign, search_space(campaign, bench), bench, bench.trials, threads)


def _follow_up(problem: MotorProblem, course: Course) -> Outcome:
    """Return the final sets with what follows the search."""
    campaign, bench, space = problem.campaign, problem.bench, problem.space
    after = after_the_search(problem, course)
    rows = after.rows
    tied = [f"no_load_{what}_{d}" for d in problem.ties for what in ("slope", "intercept")]
    unknown = untested_rows(campaign, bench)
    table = parameter_records(
        space,
        {name: source for name, source in bench.measured.items() if name not in tied},
        campaign.parameters.measured_ranges(PARAMETERS),
        stated={**bench.stated, **dict.fromkeys(campaign.parameters.fixed, "campaign: parameters.fixed")},
        unknown=unknown,
    )
    exported = rows.copy()
    exported[:, [PARAMETERS.index[name] for name in unknown]] = np.nan
    derived = np.array([list(invariants(unpack(row)).values()) for row in rows[:, : len(PARAMETERS)]])
    at_bound = np.hstack([after.sets.at_bound, np.zeros(derived.shape, dtype=np.int8)])
    if after.saturation is not None:
        columns = [space.table.index[row.name] for row in after.saturation.free]
        at_bound[:, columns] = after.saturation.at_bound
    notice_unresolved_inductance(bench, rows[0])
    return Outcome(
        sets=after.sets,
        rows=rows,
        records=_records(table, tied, after.saturation, bool(own_rows(space))),
        values=np.hstack([exported, derived]),
        at_bound=at_bound,
        nrmse=after.nrmse,
        settings={**_settings(campaign, bench), **after.settings},
        cut=after.cut,
    )


def _records(
    records: tuple[ParameterRecord, ...],
    tied: list[str],
    saturation: SaturationFit | None,
    delays_of_logs: bool,
) -> tuple[ParameterRecord, ...]:
    """Return the table's records, those of the tie and the second stage marked, then the derived numbers."""
    source = "loaded steady points and the fitted R: Ω_0 = Ω + R (τ_aero + k_d Ω)/(k_m k_v)"
    derived = dict.fromkeys(tied, source) | ({"command_delay": MEAN_SOURCE} if delays_of_logs else {})
    late, stage = {}, ""
    if saturation is not None:
        late = {row.name: row for row in saturation.free}
        stage = f"second stage: {saturation.shown_by} of {', '.join(saturation.trials)}, all else held"
    table = []
    for r in records:
        if r.name in derived:
            r = r.computed(derived[r.name])
        elif r.name in late:
            r = replace(ParameterRecord.of(late[r.name], "free", r.measured_range), source=stage)
        table.append(r)
    scale = (
        ParameterRecord(name, symbol, unit, "derived", meaning, "computed from the set")
        for symbol, name, unit, meaning in _DERIVED
    )
    return (*table, *scale)


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


MOTOR = Kind(
    name="motor",
    campaign=MotorCampaign,
    open=_open,
    begin=begin,
    follow_up=_follow_up,
    candidates=candidate_trials,
    words=Words(
        single="trial of its kind",
        misleads="another supply, tare or state of the motor",
        unlike="another supply or tare, or a misread unit, clock or log",
    ),
)
