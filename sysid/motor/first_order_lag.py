"""A first-order lag of the speed with one time constant up and one down: what simulators use today.

    dΩ/dt = (Ω_ss(u) V/V_ref − Ω)/T        T = T_rise while |Ω| grows, T_fall while it falls

The torque is the static one of the speed, τ_aero(Ω): such a model knows no inertia and no current. It is
here to be beaten: the ladder of a fit shows what the motor's equations buy over it.

Valid when nobody needs the torque of a step; ignores everything that `sysid.motor.model` has beyond it.
"""

from __future__ import annotations

from math import exp, log

import numpy as np
from numba import njit, prange

from sysid.motor.batch import SimulatedTrials
from sysid.motor.parameters import instrument_rows
from sysid.parameters import Parameter, ParameterTable
from sysid.types import FloatArray

# What the equation reads of the table, by name: the layout of a kernel's row.
_READS = (
    "rise_time_constant",
    "fall_time_constant",
    "command_delay",
    *(f"steady_speed_{power}_{way}" for way in ("forward", "reverse") for power in range(3)),
    *(f"torque_{name}_{way}" for way in ("forward", "reverse") for name in ("quadratic", "linear")),
)
_RISE, _FALL = _READS.index("rise_time_constant"), _READS.index("fall_time_constant")
_DELAY = _READS.index("command_delay")
# Ω_ss(u) = s (p0 + p1 |u| + p2 u²), s = sign u: first coefficient of either direction.
_STEADY, _STEADY_REVERSE = _READS.index("steady_speed_0_forward"), _READS.index("steady_speed_0_reverse")
# c2, then c1 of either direction.
_TORQUE = _READS.index("torque_quadratic_forward")
_TORQUE_REVERSE = _READS.index("torque_quadratic_reverse")


def _time_constant(name: str, symbol: str, when: str) -> Parameter:
    return Parameter(
        f"{name}_time_constant", symbol, "s", 0.1, 1e-3, 1.0, "log",
        f"Time constant while the speed {when}.", "guess", "motor",
    )  # fmt: skip


def _curve_rows() -> list[Parameter]:
    ways = (("forward", "+"), ("reverse", "−"))
    steady = [
        Parameter(
            f"steady_speed_{power}_{way}", f"p{power}{sign}", "rad/s", 0.0, -1e4, 1e4, "linear",
            f"Coefficient of |u|^{power} of the steady speed, {way}.", "fitted to the steady loaded points",
            "steady-speed map",
        )
        for way, sign in ways
        for power in range(3)
    ]  # fmt: skip
    torque = [
        Parameter(
            f"torque_{name}_{way}", f"c_τ{sign}", unit, 0.0, -1.0, 1.0, "linear",
            "Coefficient of the torque curve.", "static curves of the campaign", "torque curve",
        )
        for way, sign in ways
        for name, unit in (("quadratic", "N·m·s²/rad²"), ("linear", "N·m·s/rad"))
    ]  # fmt: skip
    return [*steady, *torque]


PARAMETERS = ParameterTable(
    [
        _time_constant("rise", "T_rise", "grows"),
        _time_constant("fall", "T_fall", "falls"),
        *instrument_rows(),
        *_curve_rows(),
    ]
)


def steady_speed_map(command: FloatArray, speed: FloatArray, ratio: FloatArray) -> FloatArray:
    """Return p0, p1, p2 (3,) of |Ω| = V/V_ref (p0 + p1 |u| + p2 u²) through steady points of one direction.

    Parameters
    ----------
    command, speed, ratio : (n,) arrays
        u [1], Ω [rad/s] and V/V_ref [1]. Below four different commands a straight line.
    """
    u = np.abs(command)
    degree = 2 if np.unique(u).size >= 4 else 1
    columns = np.column_stack([u**power for power in range(degree + 1)]) * ratio[:, None]
    solution = np.linalg.lstsq(columns, np.abs(speed), rcond=None)[0]
    return np.concatenate([solution, np.zeros(2 - degree)])


@njit(cache=True, error_model="numpy")
def _steady(u, row):
    if u == 0.0:
        return 0.0
    k = _STEADY if u > 0.0 else _STEADY_REVERSE
    size = abs(u)
    speed = max(0.0, row[k] + row[k + 1] * size + row[k + 2] * size * size)
    return speed if u > 0.0 else -speed


@njit(cache=True, error_model="numpy")
def _advance(speed, target, duration, rise, fall, step, rise_kept, fall_kept):
    """Return the speed after `duration` under a constant target, exactly, through zero if need be.

    `rise_kept`, `fall_kept`: what is left of a distance to the target after one `step` of a uniform grid. A
    grid's differences are rounded, so a duration within 1e-9 of the step is the step.
    """
    if speed * target < 0.0:
        # The fall ends where the speed passes zero.
        until = fall * log((speed - target) / (-target))
        if duration <= until:
            return target + (speed - target) * exp(-duration / fall)
        duration -= until
        speed = 0.0
    rising = abs(target) > abs(speed)
    if abs(duration - step) <= 1e-9 * step:
        kept = rise_kept if rising else fall_kept
    else:
        kept = exp(-duration / (rise if rising else fall))
    return target + (speed - target) * kept


@njit(cache=True, error_model="numpy", parallel=True, nogil=True)
def _population(
    rows, delays, command_time, command, command_first, supply_time, supply_ratio, supply_first, time, first,
    out,
):  # fmt: skip
    n_trials = first.size - 1
    for job in prange(rows.shape[0] * n_trials):
        i = job // n_trials
        j = job % n_trials
        row = rows[i]
        rise, fall, delay = row[_RISE], row[_FALL], row[_DELAY] + delays[i, j]
        instants = command_time[command_first[j] : command_first[j + 1]]
        levels = command[command_first[j] : command_first[j + 1]]
        knots = supply_time[supply_first[j] : supply_first[j + 1]]
        ratios = supply_ratio[supply_first[j] : supply_first[j + 1]]
        at, near = 0, 0
        t = time[first[j]]
        step = time[min(first[j] + 1, first[j + 1] - 1)] - t
        rise_kept, fall_kept = exp(-step / rise), exp(-step / fall)
        speed = 0.0
        for m in range(first[j], first[j + 1]):
            end = time[m]
            while near + 1 < knots.size and knots[near + 1] <= end:
                near += 1
            ratio = ratios[near]
            while at + 1 < instants.size and instants[at + 1] + delay <= end:
                turn = max(t, instants[at + 1] + delay)
                if m > first[j]:
                    speed = _advance(
                        speed, _steady(levels[at], row) * ratio, turn - t, rise, fall, step, rise_kept,
                        fall_kept,
                    )  # fmt: skip
                    t = turn
                at += 1
            target = _steady(levels[at], row) * ratio
            if m == first[j]:
                # The trial begins at a steady state, as the motor's equations do.
                speed = target
            else:
                speed = _advance(speed, target, end - t, rise, fall, step, rise_kept, fall_kept)
            t = end
            k = _TORQUE if speed >= 0.0 else _TORQUE_REVERSE
            out[i, m, 0] = (row[k] * abs(speed) + row[k + 1]) * speed
            out[i, m, 1] = speed


def simulate_lag(rows: FloatArray, trials: SimulatedTrials, delays: FloatArray | None = None) -> FloatArray:
    """Simulate every candidate on every trial.

    Parameters
    ----------
    rows : (P, n_table) array
        In the order of `PARAMETERS` [SI].
    trials : SimulatedTrials
        What drives the rotor, and when its outputs are wanted.
    delays : (P, n_trials) array, optional
        Added to ``command_delay`` per candidate and trial [s].

    Returns
    -------
    (P, n_total, 2) array
        Torque [N·m] and speed [rad/s] on the trials' samples. The supply is constant between two knots.
    """
    index = PARAMETERS.index
    reads = np.ascontiguousarray(rows[:, [index[name] for name in _READS]], dtype=np.float64)
    out = np.empty((len(rows), trials.time.size, 2))
    _population(reads, trials.delays(len(rows), delays), *trials.excitation, trials.time, trials.first, out)
    return out
