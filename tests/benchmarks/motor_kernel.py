"""Time and error of the motor's kernel beside scipy's LSODA on the same compiled right-hand side.

Run ``python tests/benchmarks/motor_kernel.py [--json PATH] [--population N]``. Eight trials of 2 s with four
commands each, sampled every 1 ms; error is the mean NRMSE of current and speed against a run at 1e-10. LSODA
is restarted at every command, which is kind to it, and gets its loosest relative tolerance that keeps 0.1 %.
Times are CPU time of the calling thread; trials/s over all threads is wall-clock time.
"""

import argparse
import json
import math
import os
import time
from pathlib import Path

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from sysid.motor import model
from sysid.motor.batch import SimulatedTrial, SimulatedTrials, simulate_population
from sysid.motor.kernel import INERTIA, K_D, K_M, K_V, REVERSE, TORQUE, L, R
from sysid.motor.problem import FIT_TOLERANCE

LIMIT = 1e-3
GRID = np.arange(0.0, 2.0, 1e-3)
INSTANTS = np.array([0.0, 0.5, 1.0, 1.5])


@njit(error_model="numpy")
def derivative(state, volts, row):
    """Rates of current and speed outside the dead band, for an integrator of somebody else."""
    out = np.empty(2)
    out[0] = (volts - row[K_V] * state[1] - row[R] * state[0]) / row[L]
    k = TORQUE if state[1] >= 0.0 else TORQUE + REVERSE
    drag = (row[k] * abs(state[1]) + row[k + 1]) * state[1] + row[K_D] * state[1]
    out[1] = (row[K_M] * state[0] - drag) / row[INERTIA]
    return out


def nrmse(ours, exact):
    """Mean NRMSE of current and speed."""
    return float(np.mean(np.sqrt(np.mean((ours - exact) ** 2, axis=0)) / exact.std(axis=0)))


def least(call, repeats):
    """Least CPU time of the thread [s] and the last result."""
    spent, result = math.inf, None
    for _ in range(repeats):
        start = time.thread_time()
        result = call()
        spent = min(spent, time.thread_time() - start)
    return spent, result


def lsoda(levels, row, rtol):
    """Current and speed (n, 2) on the grid, restarted at every command."""
    out = np.empty((GRID.size, 2))
    omega = model.no_load_speed(levels, {})
    current, speed = model.steady_state(levels[0], {})
    state = np.array([float(current), float(speed)])
    for start, end, target in zip(INSTANTS, [*INSTANTS[1:], GRID[-1] + 1e-3], omega, strict=True):
        rows = slice(*np.searchsorted(GRID, [start - 1e-9, end - 1e-9]))
        volts = row[K_V] * target
        found = solve_ivp(
            lambda _, y, volts=volts: derivative(y, volts, row),
            (start, end),
            state,
            method="LSODA",
            t_eval=np.append(GRID[rows], end),
            rtol=rtol,
            atol=rtol * 1e-1,
        )
        out[rows] = found.y[:, :-1].T
        state = found.y[:, -1]
    return out


def main():
    """Measure, print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--population", type=int, default=200)
    arguments = parser.parse_args()
    source = np.random.default_rng(0)
    levels = source.uniform(0.25, 1.0, (8, 4))
    row = model.kernel_rows(model.pack({}))
    trials = SimulatedTrials([SimulatedTrial(INSTANTS, u, GRID) for u in levels])
    rows = np.repeat(model.pack({})[None], arguments.population, axis=0)
    simulate_population(rows[:2], trials, tolerance=FIT_TOLERANCE)
    derivative(np.zeros(2), 1.0, row)

    spent, _ = least(lambda: simulate_population(rows, trials, tolerance=FIT_TOLERANCE, threads=1), 5)
    ours = spent / (arguments.population * len(levels))
    walls = []
    for _ in range(5):
        start = time.perf_counter()
        simulate_population(rows, trials, tolerance=FIT_TOLERANCE)
        walls.append(time.perf_counter() - start)
    per_second = arguments.population * len(levels) / min(walls)

    table = []
    for u in levels:
        exact = model.simulate({}, INSTANTS, u, GRID, initial="steady", tolerance=1e-10)
        exact = np.column_stack([exact.current, exact.speed])
        own = model.simulate({}, INSTANTS, u, GRID, initial="steady", tolerance=FIT_TOLERANCE)
        error = nrmse(np.column_stack([own.current, own.speed]), exact)
        for rtol in (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6):
            seconds, theirs = least(lambda u=u, rtol=rtol: lsoda(u, row, rtol), 1)
            if nrmse(theirs, exact) <= LIMIT:
                seconds = min(seconds, least(lambda u=u, rtol=rtol: lsoda(u, row, rtol), 3)[0])
                break
        off = nrmse(theirs, exact)
        table.append({"error": error, "lsoda_seconds": seconds, "lsoda_rtol": rtol, "lsoda_error": off})
        print(
            f"ours {1e6 * ours:6.1f} µs, {100 * error:.4f} %   LSODA {1e3 * seconds:6.2f} ms at "
            f"rtol {rtol:g}, {100 * off:.4f} %   ratio {seconds / ours:.0f}"
        )
    ratio = float(np.median([entry["lsoda_seconds"] for entry in table])) / ours
    print(
        f"median ratio {ratio:.0f} on one core; {per_second:.0f} trials/s on {os.cpu_count()} cores, "
        f"population {arguments.population}"
    )
    if arguments.json:
        summary = {"seconds": ours, "trials_per_second": per_second, "median_ratio": ratio, "trials": table}
        arguments.json.write_text(json.dumps(summary, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
