"""Time and error of the gear's kernel beside scipy's integrators on the same compiled right-hand side.

Run ``python tests/benchmarks/gear_kernel.py [--json PATH] [--population N]``. Six drops of 0.7 s sampled
every 5 ms; error is the mean NRMSE over x, z, q, vx, vz against a converged run. Each scipy method gets,
per drop, its loosest relative tolerance that keeps 0.1 % there. Times are CPU time of the calling thread,
best of several, so that other work on the machine disturbs the ratios little; drops/s over all threads is
wall-clock time.
"""

import argparse
import json
import math
import os
import platform
import time
from pathlib import Path

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from sysid.gear.contact import normal_force
from sysid.gear.dynamics import accelerations, feet, pose
from sysid.gear.model import FIT_TOLERANCE, PARAMETERS, Drops, pack, simulate, simulate_population
from sysid.gear.surfaces.low_friction import low_friction

CASES = [(5, 0.5), (10, 0.8), (15, 0.6), (20, 1.0), (27, 0.7), (35, 0.45)]
LIMIT = 1e-3
# Table II, high friction, mean of five fits.
HIGH = {
    "joint_dx": 0.067,
    "joint_dz": 0.019,
    "leg_axial_stiffness": 6670.0,
    "leg_axial_damping": 20.3,
    "leg_bending_stiffness": 3.44,
    "leg_bending_damping": 0.017,
    "ground_stiffness": 1.49e5,
    "ground_damping": 0.058,
    "leg_mass": 0.015,
    "leg_inertia": 2.1e-4,
    "kinetic_friction": 0.87,
    "static_friction_excess": 0.08,
}


@njit(error_model="numpy")
def derivative(y, coefficients, k_s, b_s, mu_k, eps_v):
    """Rates of the state in the slope's frame, for an integrator of somebody else."""
    joints = pose(y[2], y[4], y[6], coefficients[8], coefficients[9])
    rates = (y[7], y[8], y[9], y[10], y[11], y[12], y[13])
    p_c, dp_c, v_c, p_d, dp_d, v_d = feet(joints, y[1], y[3], y[5], rates, coefficients[10])
    n_c = normal_force(p_c, dp_c, k_s, b_s)
    n_d = normal_force(p_d, dp_d, k_s, b_s)
    f_c, f_d = low_friction(n_c, n_d, v_c, v_d, (mu_k, eps_v))
    angles = (y[2], y[3], y[4], y[5], y[6])
    a = accelerations(joints, angles, rates, (0.0, 0.0), (n_c, n_d), f_c, f_d, coefficients)
    out = np.empty(14)
    out[:7] = y[7:]
    for i in range(7):
        out[7 + i] = a[i]
    return out


def make_drops():
    """Level drops with the rear foot 1 mm above the slope."""
    slopes, states = [], []
    for slope_deg, speed in CASES:
        q = math.radians(slope_deg)
        slopes.append(q)
        states.append([0.0, 0.151 + (1e-3 + 0.105 * math.sin(q)) / math.cos(q), 0.0, 0.0, -speed, 0.0])
    return Drops(np.array(slopes), np.array(states), [np.arange(0, 0.7001, 0.005)] * len(CASES))


def nrmse(ours, exact):
    """Mean NRMSE over x, z, q, vx, vz."""
    error = np.sqrt(np.mean((ours[:, :5] - exact[:, :5]) ** 2, axis=0)) / exact[:, :5].std(axis=0)
    return float(error.mean())


def best(call, repeats):
    """Least CPU time of the thread [s] and the last result."""
    spent, result = math.inf, None
    for _ in range(repeats):
        start = time.thread_time()
        result = call()
        spent = min(spent, time.thread_time() - start)
    return spent, result


def scipy_drop(method, slope, body, clock, exact):
    """Time [s], error, tolerance, right-hand sides of a scipy method at its loosest sufficient tolerance."""
    p = PARAMETERS.nominal
    span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]
    length, rest = math.hypot(span, depth), math.atan2(span, depth)
    c, s = math.cos(slope), math.sin(slope)
    legs = ("axial_stiffness", "axial_damping", "bending_stiffness", "bending_damping")
    coefficients = (
        *(p[f"leg_{name}"] for name in legs),
        *(p[f"leg_{name}"] for name in legs),
        p["joint_dx"],
        p["joint_dz"],
        length,
        rest,
        p["leg_mass_fraction"] * length,
        (1 - p["leg_mass_fraction"]) * length,
        1 / p["body_mass"],
        1 / p["body_inertia"],
        1 / p["leg_mass"],
        1 / p["leg_inertia"],
        1 / p["leg_mass"],
        1 / p["leg_inertia"],
        p["gravity"] * s,
        -p["gravity"] * c,
    )
    surface = (p["ground_stiffness"], p["ground_damping"], p["kinetic_friction"], p["slip_regularization"])
    x, z, q, dx, dz, dq = body
    phi = q - slope
    start = [c * x - s * z, s * x + c * z, phi, 0, phi + rest, 0, phi - rest]
    start = np.array([*start, c * dx - s * dz, s * dx + c * dz, dq, 0, dq, 0, dq], dtype=float)

    def right_hand_side(_, y):
        return derivative(y, coefficients, *surface)

    right_hand_side(0.0, start)
    for rtol in (1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7):

        def call(rtol=rtol):
            return solve_ivp(
                right_hand_side,
                (0, clock[-1]),
                start,
                method=method,
                t_eval=clock,
                rtol=rtol,
                atol=rtol * 1e-2,
            )

        spent, found = best(call, 1)
        y = found.y.T
        if len(y) != len(clock):
            continue
        ours = np.column_stack(
            [
                c * y[:, 0] + s * y[:, 1],
                c * y[:, 1] - s * y[:, 0],
                y[:, 2] + slope,
                c * y[:, 7] + s * y[:, 8],
                c * y[:, 8] - s * y[:, 7],
            ]
        )
        error = nrmse(ours, exact)
        if error <= LIMIT:
            again, _ = best(call, 2)
            return min(spent, again), error, rtol, int(found.nfev)
    return math.nan, math.nan, math.nan, 0


def high_friction(drops, population):
    """Throughput of the hybrid on the same drops with the paper's high-friction parameters."""
    rows = np.repeat(pack(HIGH)[None], population, axis=0)
    spent, found = best(lambda: simulate_population(rows, drops, surface="hf", threads=1), 3)
    walls = []
    for _ in range(3):
        start = time.perf_counter()
        simulate_population(rows, drops, surface="hf")
        walls.append(time.perf_counter() - start)
    return {
        "drops_per_cpu_second": found.status.size / spent,
        "drops_per_second": found.status.size / min(walls),
        "rhs": float(found.rhs_evaluations.mean()),
        "switches": float(found.switches.mean()),
    }


def main():
    """Measure, print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--population", type=int, default=400)
    arguments = parser.parse_args()
    drops, row = make_drops(), pack({})
    rows = np.repeat(row[None], arguments.population, axis=0)
    start = time.perf_counter()
    exact = simulate_population(row, drops, tolerance=1e-8).samples[0]
    simulate(row, drops.slope[0], drops.body_state[0], drops.time[0])
    print(f"compiled or loaded in {time.perf_counter() - start:.1f} s on {platform.machine()}")

    lanes_time, lanes = best(lambda: simulate_population(rows, drops, threads=1), 3)
    per_drop = lanes_time / lanes.status.size
    throughput = {}
    for threads in sorted({1, os.cpu_count() or 1}):
        walls = []
        for _ in range(3):
            start = time.perf_counter()
            simulate_population(rows, drops, threads=threads)
            walls.append(time.perf_counter() - start)
        throughput[threads] = lanes.status.size / min(walls)

    high = high_friction(drops, arguments.population)

    table = []
    for d, (slope_deg, speed) in enumerate(CASES):
        own = slice(drops.offset[d], drops.offset[d + 1])
        only = Drops(drops.slope[d : d + 1], drops.body_state[d : d + 1], drops.time[d : d + 1])
        lane_time, many = best(lambda only=only: simulate_population(rows, only, threads=1), 3)
        lane_time /= len(rows)
        scalar_time, one = best(
            lambda d=d: simulate(row, drops.slope[d], drops.body_state[d], drops.time[d]), 20
        )
        entry = {
            "slope_deg": slope_deg,
            "speed": speed,
            "lanes": {
                "seconds": lane_time,
                "error": nrmse(many.samples[0], exact[own]),
                "rhs": int(many.rhs_evaluations[0, 0]),
            },
            "scalar": {
                "seconds": scalar_time,
                "error": nrmse(one.state[:, [0, 1, 2, 7, 8]], exact[own]),
                "rhs": one.rhs_evaluations,
            },
        }
        for method in ("LSODA", "Radau"):
            seconds, error, rtol, rhs = scipy_drop(
                method, drops.slope[d], drops.body_state[d], drops.time[d], exact[own]
            )
            entry[method] = {
                "seconds": seconds,
                "error": error,
                "rtol": rtol,
                "rhs": rhs,
                "ratio_lanes": seconds / lane_time,
                "ratio_scalar": seconds / scalar_time,
            }
        table.append(entry)

    head = f"{'drop':>14} {'kernel':>8} {'ms':>9} {'error %':>8} {'rhs':>7} {'x lanes':>8} {'x scalar':>8}"
    print(head)
    for entry in table:
        label = f"{entry['slope_deg']} deg {entry['speed']} m/s"
        for kernel in ("lanes", "scalar", "LSODA", "Radau"):
            part = entry[kernel]
            line = f"{label:>14} {kernel:>8} {1e3 * part['seconds']:9.4f} {100 * part['error']:8.3f}"
            line += f" {part['rhs']:7d}"
            if "ratio_lanes" in part:
                line += f" {part['ratio_lanes']:8.0f} {part['ratio_scalar']:8.0f}"
            print(line)
    print(f"one core, lanes: {1 / per_drop:.0f} drops/s of CPU time")
    print(
        f"high friction, one core, lanes: {high['drops_per_cpu_second']:.0f} drops/s of CPU time, "
        f"{high['drops_per_second']:.0f} drops/s on all cores, {high['rhs']:.0f} right-hand sides per drop"
    )
    for threads, rate in throughput.items():
        print(f"{threads} thread(s): {rate:.0f} drops/s of wall-clock time")
    if arguments.json:
        result = {
            "machine": platform.platform(),
            "tolerance": FIT_TOLERANCE,
            "limit": LIMIT,
            "drops": table,
            "lanes_drops_per_cpu_second": 1 / per_drop,
            "drops_per_second": throughput,
            "high_friction": high,
        }
        arguments.json.write_text(json.dumps(result, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
