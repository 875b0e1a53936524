"""Time and error of the motor's kernel beside scipy's LSODA on the same compiled right-hand side.

Run ``python tests/benchmarks/motor_kernel.py [--json PATH] [--population N]``. Eight trials of 2 s with four
commands each, sampled every 1 ms; error is the mean NRMSE of current and speed against a run at 1e-10. LSODA
is restarted at every command, which is kind to it, and gets its loosest relative tolerance that keeps 0.1 %.
Times are CPU time of the calling thread; trials/s over all threads is wall-clock time.
"""

import os
import time

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from paired import best, flags, loosest, mean_nrmse, report
from sysid.motor import model
from sysid.motor.batch import SimulatedTrial, SimulatedTrials, simulate_population
from sysid.motor.kernel import INERTIA, K_D, K_M, K_V, REVERSE, TORQUE, L, R
from sysid.motor.problem import FIT_TOLERANCE

GRID = np.arange(0.0, 2.0, 1e-3)
INSTANTS = np.array([0.0, 0.5, 1.0, 1.5])


@njit(error_model="numpy")
def derivative(state, volts, row):
    """Rates of current and speed outside the dead band, for another library's integrator."""
    out = np.empty(2)
    out[0] = (volts - row[K_V] * state[1] - row[R] * state[0]) / row[L]
    k = TORQUE if state[1] >= 0.0 else TORQUE + REVERSE
    drag = (row[k] * abs(state[1]) + row[k + 1]) * state[1] + row[K_D] * state[1]
    out[1] = (row[K_M] * state[0] - drag) / row[INERTIA]
    return out


def lsoda(levels, row, rtol):
    """Current and speed (n, 2) on the grid, restarted at every command, and calls of the derivative."""
    out, count = np.empty((GRID.size, 2)), 0
    omega = model.no_load_speed(levels, {})
    current, speed = model.steady_state(levels[0], {})
    state = np.array([float(current), float(speed)])
    for start, end, target in zip(INSTANTS, [*INSTANTS[1:], GRID[-1] + 1e-3], omega, strict=True):
        rows = slice(*np.searchsorted(GRID, [start - 1e-9, end - 1e-9]))
        volts = row[K_V] * target
        run = solve_ivp(
            lambda _, y, volts=volts: derivative(y, volts, row), (start, end), state,
            method="LSODA", t_eval=np.append(GRID[rows], end), rtol=rtol, atol=rtol * 1e-1,
        )  # fmt: skip
        count += int(run.nfev)
        out[rows] = run.y[:, :-1].T
        state = run.y[:, -1]
    return out, count


def main():
    """Measure, print, write the JSON."""
    arguments = flags(__doc__, population=200).parse_args()
    source = np.random.default_rng(0)
    levels = source.uniform(0.25, 1.0, (8, 4))
    row = model.kernel_rows(model.pack({}))
    trials = SimulatedTrials([SimulatedTrial(INSTANTS, u, GRID) for u in levels])
    rows = np.repeat(model.pack({})[None], arguments.population, axis=0)
    simulate_population(rows[:2], trials, tolerance=FIT_TOLERANCE)
    derivative(np.zeros(2), 1.0, row)

    count = arguments.population * len(levels)
    ours = best(lambda: simulate_population(rows, trials, tolerance=FIT_TOLERANCE, threads=1), 5)[0] / count
    wall, _ = best(lambda: simulate_population(rows, trials, tolerance=FIT_TOLERANCE), 5, time.perf_counter)

    table = []
    for u in levels:
        exact, fitted = (
            np.column_stack([run.current, run.speed])
            for tolerance in (1e-10, FIT_TOLERANCE)
            for run in [model.simulate({}, INSTANTS, u, GRID, initial="steady", tolerance=tolerance)]
        )
        error, rival = mean_nrmse(fitted, exact), loosest(lambda rtol, u=u: lsoda(u, row, rtol), exact, 3)
        ratio = rival["seconds"] / ours
        table.append({"error": error, "ratio": ratio, **{f"lsoda_{name}": v for name, v in rival.items()}})
    result = {
        "seconds": ours,
        "cores": os.cpu_count(),
        "trials_per_second": count / wall,
        "median_ratio": float(np.median([entry["ratio"] for entry in table])),
        "trials": table,
    }
    report(result, arguments.json)


if __name__ == "__main__":
    main()
