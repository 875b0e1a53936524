"""Simpler models of a motor on the same trials: a first-order lag, and the equations without L.

The lag is what simulators use today: one time constant up and one down,

    dΩ/dt = (Ω_ss(u) V/V_ref − Ω)/T        T = T_rise while |Ω| grows, T_fall while it falls

Its torque is the static one of the speed, τ_aero(Ω): such a model knows no inertia and no current. `sysid
ladder` shows what the motor's equations buy over it.

The lag is valid when nobody needs the torque of a step; it ignores everything that `sysid.motor.model` has
beyond it.
"""

from dataclasses import replace

import numpy as np

from sysid.motor.batch import SimulatedTrials
from sysid.motor.curves import supply_ratio
from sysid.motor.lag_kernel import READS, lag_population
from sysid.motor.log_delays import log_rows, shifts
from sysid.motor.parameters import SENSORS, WAYS, instrument_rows
from sysid.motor.problem import MotorProblem
from sysid.motor.static_curves import turns
from sysid.parallel import in_threads
from sysid.parameters import Parameter, ParameterTable, SearchSpace
from sysid.types import FloatArray, IntArray

# Inductance of the model without L [H]: its current rises within a thousandth of any step that a log shows.
_NO_INDUCTANCE = 1e-8
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
            for way, sign in WAYS
            for power in range(3)
        ),
        *(
            Parameter(f"torque_{name}_{way}", f"c_τ{sign}", unit, 0.0, -1.0, 1.0, "linear",
                      "Coefficient of the torque curve.", "static curves of the campaign", "torque curve")
            for way, sign in WAYS
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


class LagProblem(MotorProblem):
    """First-order lags on the same trials: rows of the lag's table and the delays of logs."""

    def complete(self, rows: FloatArray) -> FloatArray:
        """Return the rows (P, n): nothing of a lag follows from the others."""
        return rows

    def simulate(self, rows: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Return samples (P, n_total, 2) [SI] on the trials' grids; every lag reaches the end of all."""
        delays, shape = shifts(self.space.table, rows, self.prepared), (len(rows), len(self.jobs))
        return simulate_lag(rows, self.jobs, delays), np.ones(shape), np.zeros(shape, dtype=np.int64)


def simpler(problem: MotorProblem) -> list[tuple[str, MotorProblem]]:
    """Return the simpler models of a problem of fitted trials with their titles."""
    space, bench = problem.space, problem.bench
    # Delays of the lag are free where the motor's are; its steady speeds come from the loaded steady points.
    delays = log_rows(space)
    free = ["rise_time_constant", "fall_time_constant"]
    free += [name for name in ("command_delay", *SENSORS, *delays) if name in space.names]
    table = ParameterTable([*PARAMETERS.values(), *(space.table[name] for name in delays)])
    values = {
        n: value
        for n, value in {**space.fixed, **space.stated, **bench.curves.parameters}.items()
        if n in table
    }
    for direction, points in bench.curves.loaded.items():
        turning = turns(points.u, direction)
        ratio = supply_ratio(points, bench.curves.reference_voltage)
        powers = steady_speed_map(points.u[turning], points.speed[turning], ratio[turning])
        values |= {f"steady_speed_{power}_{direction}": float(p) for power, p in enumerate(powers)}
    bounds = {row.name: (row.lower, row.upper) for row in space.free if row.name in free}
    lag = LagProblem(
        problem.campaign, bench, SearchSpace.build(table, free, values, bounds), problem.prepared,
        problem.targets, {}, problem.threads,
    )  # fmt: skip
    out: list[tuple[str, MotorProblem]] = [("first-order lag", lag)]
    if "winding_inductance" in space.names:
        fixed = {**space.fixed, "winding_inductance": _NO_INDUCTANCE}
        others = tuple(row for row in space.free if row.name != "winding_inductance")
        out.append(
            ("without L", replace(problem, space=SearchSpace(space.table, others, fixed, space.stated)))
        )
    return out
