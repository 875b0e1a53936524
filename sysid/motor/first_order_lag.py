"""A first-order lag of the speed with one time constant up and one down: what simulators use today.

    dΩ/dt = (Ω_ss(u) V/V_ref − Ω)/T        T = T_rise while |Ω| grows, T_fall while it falls

The torque is the static one of the speed, τ_aero(Ω): such a model knows no inertia and no current. It is
here to be beaten: the ladder of a fit shows what the motor's equations buy over it.

Valid when nobody needs the torque of a step; ignores everything that `sysid.motor.model` has beyond it.
"""

from __future__ import annotations

import numpy as np

from sysid.motor.batch import SimulatedTrials
from sysid.motor.lag_kernel import READS, lag_population
from sysid.motor.parameters import instrument_rows
from sysid.parallel import in_threads
from sysid.parameters import Parameter, ParameterTable
from sysid.types import FloatArray

_WAYS = (("forward", "+"), ("reverse", "−"))
PARAMETERS = ParameterTable(
    [
        *(
            Parameter(f"{name}_time_constant", f"T_{name}", "s", 0.1, 1e-3, 1.0, "log",
                      f"Time constant while the speed {when}.", "guess", "motor")
            for name, when in (("rise", "grows"), ("fall", "falls"))
        ),
        *instrument_rows(),
        *(
            Parameter(f"steady_speed_{power}_{way}", f"p{power}{sign}", "rad/s", 0.0, -1e4, 1e4, "linear",
                      f"Coefficient of |u|^{power} of the steady speed, {way}.",
                      "fitted to the steady loaded points", "steady-speed map")
            for way, sign in _WAYS
            for power in range(3)
        ),
        *(
            Parameter(f"torque_{name}_{way}", f"c_τ{sign}", unit, 0.0, -1.0, 1.0, "linear",
                      "Coefficient of the torque curve.", "static curves of the campaign", "torque curve")
            for way, sign in _WAYS
            for name, unit in (("quadratic", "N·m·s²/rad²"), ("linear", "N·m·s/rad"))
        ),
    ]
)  # fmt: skip


def steady_speed_map(command: FloatArray, speed: FloatArray, ratio: FloatArray) -> FloatArray:
    """Return p0, p1, p2 (3,) of |Ω| = V/V_ref (p0 + p1 |u| + p2 u²) through steady points of one direction.

    Commands u [1], speeds Ω [rad/s] and V/V_ref [1] are (n,) each. Below four different commands a straight
    line.
    """
    u = np.abs(command)
    degree = 2 if np.unique(u).size >= 4 else 1
    columns = np.column_stack([u**power for power in range(degree + 1)]) * ratio[:, None]
    solution = np.linalg.lstsq(columns, np.abs(speed), rcond=None)[0]
    return np.concatenate([solution, np.zeros(2 - degree)])


def simulate_lag(rows: FloatArray, trials: SimulatedTrials, delays: FloatArray | None = None) -> FloatArray:
    """Return torque [N·m] and speed [rad/s] (P, n_total, 2) of every candidate on the trials' samples.

    `rows` (P, n_table) have the order of `PARAMETERS` [SI]; `delays` (P, n_trials) are added to
    ``command_delay`` [s]. The supply is constant between two knots.
    """
    index = PARAMETERS.index
    reads = np.ascontiguousarray(rows[:, [index[name] for name in READS]], dtype=np.float64)
    out = np.empty((len(rows), trials.time.size, 2))
    shifts = trials.delays(len(rows), delays)
    excitation = trials.excitation
    in_threads(lag_population, shifts.size, None, reads, shifts, *excitation, trials.time, trials.first, out)
    return out
