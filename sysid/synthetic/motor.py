"""Bench tests of one motor, simulated and written as a load cell and a thrust stand would have recorded them.

Forward and reverse trials at 10 kHz are separate, as in the paper, and others change direction. Each begins
with the motor at rest (for the tare), spins up to an idle command and then walks through its steps. The
static curves come from averaged points of a thrust stand on a battery, with the propeller and without.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np

from sysid.campaign import TrialUse
from sysid.errors import CampaignError, ExportError
from sysid.motor import model
from sysid.storage import check_folder
from sysid.synthetic import bench
from sysid.synthetic.folder import TRUTH_FILE, Content, truth_text, write_campaign
from sysid.types import Direction

MINIMUM, NEUTRAL, MAXIMUM = 1000.0, 1500.0, 2000.0
_REST, _IDLE = 0.5, 1.0
# The window of a trial starts this long before the first step, at a steady idle.
_STEADY = 0.2
# Supply of the thrust stand: open voltage above the reference [V] and resistance of battery and wires [Ω].
_OPEN_ABOVE, _SUPPLY_RESISTANCE = 0.03, 0.012

# The motor of the converged reference trajectories; what it leaves out is the model's nominal value.
TRUE_MOTOR = {
    "winding_resistance": 0.299, "winding_inductance": 0.0038, "viscous_damping": 9.2e-9,
    "back_emf_constant": 0.00995, "torque_constant": 0.00995, "rotor_inertia": 2.7e-5,
    "saturation_current": 0.35, "saturation_speed": 6.3, "reference_voltage": 11.1,
    "no_load_slope_forward": 1030.0, "no_load_slope_reverse": 1030.0,
    "thrust_quadratic_forward": 1.2e-5, "thrust_quadratic_reverse": 0.62e-5,
    "torque_quadratic_forward": 1.65e-7, "torque_quadratic_reverse": 1.7e-7, "command_delay": 0.008,
}  # fmt: skip


# Units of the keys in the truth file. Command steps are pairs of time [s] and command [1].
_FACT_UNITS = {
    "Hz": "rate",
    "N": "force tare_force tare_thrust",
    "N·m": "torque tare_torque",
    "rad/s": "speed",
    "s": "log_start window_start",
}


@dataclass(frozen=True)
class TrialPlan:
    """One load-cell trial: idle command, then levels of u, each held for `hold` [s]."""

    name: str
    direction: Direction
    use: TrialUse
    idle: float
    levels: tuple[float, ...]
    hold: float
    export: Literal["csv", "hdf5"]


TRIALS = (
    TrialPlan("forward-1", "forward", "fit", 0.25, (0.62, 0.35, 0.80, 0.50, 0.95, 0.40, 0.70), 0.5, "csv"),
    TrialPlan(
        "reverse-1", "reverse", "fit", -0.25, (-0.60, -0.35, -0.80, -0.45, -0.95, -0.50, -0.70), 0.5, "hdf5"
    ),
    TrialPlan("forward-2", "forward", "validate", 0.30, (0.90, 0.45, 0.55, 0.75, 0.35, 0.65), 0.5, "hdf5"),
    TrialPlan("reversal-1", "reversal", "fit", 0.30, (0.62, -1.0, 0.62, -0.5, 0.4, -0.8, 0.8), 0.6, "hdf5"),
    TrialPlan("reversal-2", "reversal", "validate", -0.30, (0.62, -1.0, 0.30, -0.62, 0.80), 0.8, "hdf5"),
)


def synthesize_motor(
    folder: str | Path,
    *,
    seed: int,
    parameters: Mapping[str, float] | None = None,
    noise: bool = True,
    rate: float = 10_000.0,
    name: str = "synthetic-motor",
    trials: Sequence[TrialPlan] = TRIALS,
    ideal_reversal: bool = False,
    force: bool = False,
) -> Path:
    """Write a campaign of motor tests with known truth: ``campaign.toml``, logs and ``truth.json``.

    The load cell feels thrust and the *stator's* reaction ``k_m I_eff − k_d Ω``, not the aerodynamic torque.
    CampaignError or FitError when the parameters cannot be simulated, ExportError when the folder exists,
    unless `force` replaces it, or cannot be written; nothing is written then.

    Same `seed`, same arguments: the same numbers. `parameters` are true values that differ from `TRUE_MOTOR`
    [SI]. Without `noise` there are quantization and tare only. `rate` is the load cell's [Hz]. A motor of an
    `ideal_reversal` has no saturation, as in Fig. 11.
    """
    check_folder(folder, force=force, marker=TRUTH_FILE, error_type=ExportError)
    if not rate >= 1000.0:
        raise CampaignError(f"rate: {rate:g} Hz is no load-cell log; expected 1 kHz or more")
    true = {**model.PARAMETERS.nominal, **TRUE_MOTOR, **(parameters or {})}
    spread = bench.NOISE if noise else bench.Sizes(0.0, 0.0, 0.0)
    logs: dict[str, Content] = {}
    facts, entries = [], []
    for number, plan in enumerate(trials, start=1):
        source = np.random.default_rng([seed, number])
        log, window, fact = _trial(plan, true, rate, spread, source, ideal_reversal)
        file = f"{plan.name}.{'csv' if plan.export == 'csv' else 'h5'}"
        logs[file] = bench.load_cell_csv(log) if plan.export == "csv" else bench.load_cell_hdf5(log)
        facts.append({"name": plan.name, "log": file, "direction": plan.direction, "use": plan.use, **fact})
        entries.append(_trial_text(plan, file, window))
    stands = {}
    for number, (kind, direction) in enumerate(product(("static", "no-load"), ("forward", "reverse")), 101):
        source = np.random.default_rng([seed, number])
        points, tare = _stand_points(direction == "forward", kind == "static", true, noise, source)
        file = f"{kind}-{direction}.csv"
        logs[file] = bench.stand_csv(points, source, thrust_unit="gf" if direction == "forward" else "N")
        stands[file] = tare
    circumstances = {
        "seed": seed,
        "rate": rate,
        # I_sat and Ω_min are no truth then.
        **({"ideal_reversal": True} if ideal_reversal else {}),
        "noise": {"force": spread.force, "torque": spread.torque, "speed": spread.speed},
        "free": list(model.FREE_DEFAULT),
        "trials": facts,
        "thrust_stand": stands,
    }
    campaign = _campaign_text(name, true, seed) + "\n".join(entries)
    truth = truth_text("motor", model.PARAMETERS, true, circumstances, _FACT_UNITS)
    return write_campaign(folder, campaign, logs, truth, force=force)


def _trial(
    plan: TrialPlan,
    true: Mapping[str, float],
    rate: float,
    noise: bench.Sizes,
    source: np.random.Generator,
    ideal_reversal: bool,
) -> tuple[bench.LoadCellLog, float, dict[str, object]]:
    """Simulate a trial, record it with tare, noise and quantization; return log, window start [s], facts."""
    first = round(float(source.uniform(3.0, 40.0)), 4)
    count = round((_REST + _IDLE + plan.hold * len(plan.levels)) * rate)
    time = first + np.arange(count) / rate
    instants = first + np.concatenate([[0.0, _REST], _REST + _IDLE + plan.hold * np.arange(len(plan.levels))])
    levels = np.array([0.0, plan.idle, *plan.levels])
    run = model.simulate(true, instants, levels, time, ideal_reversal=ideal_reversal)
    # Half a sample early, so that rounding of the clock cannot move a step by one row.
    step = np.searchsorted(instants, time + 0.5 / rate, side="right") - 1
    command = NEUTRAL + (MAXIMUM - NEUTRAL) * levels[step]
    tare_force, tare_torque = float(source.uniform(-0.6, 0.6)), float(source.uniform(-0.02, 0.02))
    shake = source.standard_normal((3, count))
    log = bench.LoadCellLog(
        time,
        command,
        # A tachometer that sees nothing pass reads zero, without noise.
        bench.quantized(run.speed + noise.speed * shake[0] * (run.speed != 0), bench.RESOLUTION.speed),
        bench.quantized(run.thrust + tare_force + noise.force * shake[1], bench.RESOLUTION.force),
        bench.quantized(run.stator_torque + tare_torque + noise.torque * shake[2], bench.RESOLUTION.torque),
    )
    window = round(first + _REST + _IDLE - _STEADY, 4)
    fact = {
        "log_start": first,
        "window_start": window,
        "tare_force": tare_force,
        "tare_torque": tare_torque,
        "command_steps": [[round(float(t), 4), float(u)] for t, u in zip(instants, levels, strict=True)],
    }
    return log, window, fact


def _stand_points(
    forward: bool, loaded: bool, true: Mapping[str, float], noise: bool, source: np.random.Generator
) -> tuple[bench.StandPoints, dict[str, float]]:
    """Walk up and down the commands on a battery that sags, one averaged point per step."""
    rise = np.linspace(0.0, 1.0, 11)
    u = np.concatenate([rise, rise[-2::-1]]) * (1.0 if forward else -1.0)
    bare = () if loaded else model.PARAMETERS.group("thrust curve", "torque curve")
    row = {**true, **dict.fromkeys(bare, 0.0)}
    voltage = np.full_like(u, row["reference_voltage"] + _OPEN_ABOVE)
    for _ in range(5):  # the sag is small: this contracts by a factor of a hundred each time
        current, speed = model.steady_state(u, row, voltage)
        drawn = np.abs(u * current) + 0.02
        voltage = row["reference_voltage"] + _OPEN_ABOVE - _SUPPLY_RESISTANCE * drawn
    shake = source.standard_normal((5, len(u))) * (1.0 if noise else 0.0)
    tare_thrust, tare_torque = float(source.uniform(-0.03, 0.03)), float(source.uniform(-8e-4, 8e-4))
    thrust = model.thrust(speed, row) + tare_thrust + 0.004 * shake[0]
    # At a steady speed the stator feels what the air takes: the motor's friction stays inside the motor.
    torque = model.aerodynamic_torque(speed, row) + tare_torque + 1e-4 * shake[1]
    blank = source.integers(2, len(u), size=2)
    thrust[blank[0]] = math.nan
    torque[blank[1]] = math.nan
    points = bench.StandPoints(
        2.1 + 4.4 * np.arange(len(u)) + 0.02 * shake[4],
        NEUTRAL + (MAXIMUM - NEUTRAL) * u,
        np.abs(speed) + 0.2 * shake[2] * (speed != 0),
        thrust,
        torque,
        voltage + 0.002 * shake[3],
        drawn,
    )
    return points, {"tare_thrust": tare_thrust, "tare_torque": tare_torque}


def _trial_text(plan: TrialPlan, file: str, start: float) -> str:
    return (
        "[[trials]]\n"
        f'name = "{plan.name}"\n'
        f'log = "{file}"\n'
        f'direction = "{plan.direction}"\n'
        f'use = "{plan.use}"\n'
        f'start = "{start:.10g} s"  # at a steady idle; the rows before it, motor at rest, give the tare\n'
    )


def _campaign_text(name: str, true: Mapping[str, float], seed: int) -> str:
    return f"""\
# Synthesized motor tests with known truth (truth.json, which no fit reads); logs as instruments write them.
kind = "motor"
name = "{name}"

[motor]
kv = "{30.0 / math.pi / true["back_emf_constant"]:.10g} rpm/V"  # measured: a rating is good to percents
rotor_inertia = "{true["rotor_inertia"]:.10g} kg·m²"  # bell and propeller, trifilar pendulum
reference_voltage = "{true["reference_voltage"]:.10g} V"  # bench supply of the load-cell trials

[command]
unit = "us"
minimum = {MINIMUM:.0f}
neutral = {NEUTRAL:.0f}
maximum = {MAXIMUM:.0f}

[curves]
static = [
    {{ log = "static-forward.csv", direction = "forward" }},
    {{ log = "static-reverse.csv", direction = "reverse" }},
]
no_load = [  # without propeller
    {{ log = "no-load-forward.csv", direction = "forward" }},
    {{ log = "no-load-reverse.csv", direction = "reverse" }},
]

[fit]
runs = 5
seed = {seed}
exact = true  # the values above are the truth, not measurements

"""
