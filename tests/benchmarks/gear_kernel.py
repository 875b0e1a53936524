"""Time and error of the gear's kernel beside scipy, SUNDIALS and MuJoCo, the latter two where installed.

Run ``python tests/benchmarks/gear_kernel.py [--json PATH] [--population N] [--lanes] [--cold] [--fits]``. Six
drops of 0.7 s sampled every 5 ms; error is the mean NRMSE over x, z, q, vx, vz against a converged run. Each
method of another library gets, per drop, its loosest relative tolerance that keeps 0.1 % there; MuJoCo, whose
contact law is another one, steps of 1 ms. Times are CPU time of the calling thread, best of several, so that
other work on the machine disturbs the ratios little; drops/s over all threads is wall-clock time. A library's
ratio is the geometric mean over the drops, beside the least. ``--cold`` compiles each surface in a process of
its own with an empty cache and prints the processor time and the peak memory of that. ``--fits`` measures
nothing but whole fits of both sample campaigns, from logs to the written folder, at the default settings and
with the paper's population of 400.
"""

import argparse
import json
import math
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from gear_rivals import LIMIT, best, installed, mujoco_drop, nrmse, scipy_drop, sundials_drop
from sysid.gear import model
from sysid.gear.kernel.driver import drop_driver
from sysid.gear.model import (
    HF_FREE,
    LF_FREE,
    SURFACES,
    Drops,
    pack,
    parameters_on,
    simulate,
    simulate_population,
)
from sysid.parameters import SearchSpace

CASES = [(5, 0.5), (10, 0.8), (15, 0.6), (20, 1.0), (27, 0.7), (35, 0.45)]


def make_drops():
    """Level drops with the rear foot 1 mm above the slope."""
    slopes, states = [], []
    for slope_deg, speed in CASES:
        q = math.radians(slope_deg)
        slopes.append(q)
        states.append([0.0, 0.151 + (1e-3 + 0.105 * math.sin(q)) / math.cos(q), 0.0, 0.0, -speed, 0.0])
    return Drops(np.array(slopes), np.array(states), [np.arange(0, 0.7001, 0.005)] * len(CASES))


def lane_widths(drops, population):
    """Drops per CPU second of other numbers of lanes than the one that is used."""
    out = {}
    rows = np.repeat(pack({})[None], population, axis=0)
    used = model._driver
    for lanes in (1, 4, 8, 16):
        driver = drop_driver(lanes, SURFACES["lf"])
        model._driver = lambda _lanes, _surface, driver=driver: driver
        simulate_population(rows[:1], drops, threads=1)
        spent, found = best(lambda: simulate_population(rows, drops, threads=1), 3)
        out[lanes] = found.status.size / spent
    model._driver = used
    return out


def throughput(surface, free, drops, population):
    """Drops per second of a surface: equal candidates and random ones, one core's CPU time and all cores."""
    table = parameters_on(surface)
    equal = np.repeat(pack({}, surface)[None], population, axis=0)
    space = SearchSpace.build(table, free, table.nominal)
    rows = {"equal": equal, "random": space.full(np.random.default_rng(1).random((population, len(free))))}
    out = {}
    for name, own in rows.items():
        simulate_population(own[:1], drops, surface=surface)
        spent, found = best(lambda own=own: simulate_population(own, drops, surface=surface, threads=1), 3)
        walls = {}
        for threads in sorted({1, os.cpu_count() or 1}):
            times = []
            for _ in range(3):
                start = time.perf_counter()
                simulate_population(own, drops, surface=surface, threads=threads)
                times.append(time.perf_counter() - start)
            walls[threads] = found.status.size / min(times)
        out[name] = {
            "drops_per_cpu_second": found.status.size / spent,
            "drops_per_second": walls,
            "rhs": float(found.rhs_evaluations.mean()),
            "most_rhs": int(found.rhs_evaluations.max()),
            "switches": float(found.switches.mean()),
            "failed": int((found.status != 0).sum()),
        }
    return out


GOALS = {"LSODA": 200, "MuJoCo": 30}
COLD = """
import json, sys, time
from pathlib import Path
sys.path.insert(0, {folder!r})
from gear_kernel import peak_memory
from sysid.gear.model import prepare
before, start = peak_memory(), time.process_time()
prepare({surface!r}, single=False)
print(json.dumps([time.process_time() - start, before, peak_memory()]))
"""


def peak_memory():
    """Peak resident memory of this program [MB], NaN where the system does not tell."""
    status = Path("/proc/self/status")
    if status.exists():
        # Not getrusage, whose peak begins with that of the process that started this one.
        lines = status.read_text(encoding="utf-8").splitlines()
        return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))
    try:
        import psutil
    except ImportError:
        return math.nan
    return getattr(psutil.Process().memory_info(), "peak_wset", math.nan * 1024**2) / 1024**2


def cold_compile(surface):
    """Processor time [s] and peak memory [MB] of the first start of a surface's population driver."""
    with tempfile.TemporaryDirectory() as cache:
        code = COLD.format(folder=str(Path(__file__).parent), surface=surface)
        own = {**os.environ, "NUMBA_CACHE_DIR": cache}
        command = [sys.executable, "-c", code]
        run = subprocess.run(command, env=own, capture_output=True, text=True, encoding="utf-8", check=True)
    seconds, before, peak = json.loads(run.stdout.splitlines()[-1])
    return {"cpu_seconds": seconds, "imported_mb": before, "peak_mb": peak}


def high_friction(drops, population):
    """The same drops on high friction: our time in lanes and its error, and MuJoCo's time over ours."""
    row, out = pack({}, "hf"), []
    rows = np.repeat(row[None], population, axis=0)
    exact = simulate_population(row, drops, surface="hf", tolerance=1e-8).samples[0]
    for d, (slope_deg, speed) in enumerate(CASES):
        own = exact[drops.offset[d] : drops.offset[d + 1]]
        only = Drops(drops.slope[d : d + 1], drops.body_state[d : d + 1], drops.time[d : d + 1])
        spent, many = best(lambda only=only: simulate_population(rows, only, surface="hf", threads=1), 3)
        entry = {"slope_deg": slope_deg, "speed": speed, "seconds": spent / population}
        entry["error"] = nrmse(many.samples[0], own)
        if installed("mujoco"):
            found = mujoco_drop(drops.slope[d], drops.body_state[d], drops.time[d], own, "hf")
            entry["mujoco_ratio"] = found["seconds"] / entry["seconds"]
        out.append(entry)
    return out


def whole_fits():
    """Wall-clock and processor time [s] of fits of each sample campaign."""
    from sysid.workflows.fit import fit_gear
    from sysid.workflows.options import FitOptions

    samples, out = Path(__file__).parents[2] / "data_samples", {}
    for surface in SURFACES:
        model.prepare(surface, single=False)
        for population in (None, 400):
            with tempfile.TemporaryDirectory() as folder:
                wall, spent = time.perf_counter(), time.process_time()
                options = FitOptions(out=Path(folder) / "fit", population=population, quiet=True)
                result, _ = fit_gear(samples / f"gear-{surface}" / "campaign.toml", options)
                part = {
                    "wall_seconds": time.perf_counter() - wall,
                    "cpu_seconds": time.process_time() - spent,
                    "drops": sum(run.simulations for run in result.runs),
                    "nrmse": result.nrmse.tolist(),
                }
            title = f"{surface}, population {population or 'by default'}"
            out[title] = part
            scores = ", ".join(f"{100 * value:.3f}" for value in part["nrmse"])
            print(
                f"{title}: {part['wall_seconds']:.1f} s ({part['cpu_seconds']:.1f} s of processor time) for "
                f"{part['drops']} drops; NRMSE of its sets {scores} %",
                flush=True,
            )
    return out


def mean_ratios(table):
    """Each library's time over ours, by library: geometric mean over the drops and the least."""
    out = {}
    for name in list(table[0])[2:]:
        if "ratio_lanes" in table[0][name]:
            out[name] = {}
            for kind in ("lanes", "scalar"):
                each = np.array([entry[name][f"ratio_{kind}"] for entry in table])
                out[name][kind] = float(np.exp(np.log(each).mean()))
                out[name][f"least {kind}"] = float(each.min())
    return out


def main():
    """Measure, print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--population", type=int, default=400)
    parser.add_argument("--lanes", action="store_true", help="also other numbers of lanes (compiles each)")
    parser.add_argument("--cold", action="store_true", help="also the first compilation (a minute or two)")
    parser.add_argument("--fits", action="store_true", help="only whole fits of the sample campaigns")
    arguments = parser.parse_args()
    if arguments.fits:
        fits = {"machine": platform.platform(), "cores": os.cpu_count(), "fits": whole_fits()}
        if arguments.json:
            arguments.json.write_text(json.dumps(fits, indent=1), encoding="utf-8")
        return
    drops, row = make_drops(), pack({})
    rows = np.repeat(row[None], arguments.population, axis=0)
    start = time.perf_counter()
    exact = simulate_population(row, drops, tolerance=1e-8).samples[0]
    simulate(row, drops.slope[0], drops.body_state[0], drops.time[0])
    print(f"compiled or loaded in {time.perf_counter() - start:.1f} s on {platform.machine()}")

    rates = {
        "lf": throughput("lf", LF_FREE, drops, arguments.population),
        "hf": throughput("hf", HF_FREE, drops, arguments.population),
    }
    widths = lane_widths(drops, arguments.population // 4) if arguments.lanes else {}

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
        others = {
            "LSODA": lambda *a: scipy_drop("LSODA", *a),
            "Radau": lambda *a: scipy_drop("Radau", *a),
        }
        if installed("sksundae"):
            others["CVODE"] = sundials_drop
        if installed("mujoco"):
            others["MuJoCo"] = mujoco_drop
        for name, measure in others.items():
            found = measure(drops.slope[d], drops.body_state[d], drops.time[d], exact[own])
            entry[name] = found | {
                "ratio_lanes": found["seconds"] / lane_time,
                "ratio_scalar": found["seconds"] / scalar_time,
            }
        table.append(entry)

    head = f"{'drop':>14} {'kernel':>8} {'ms':>9} {'error %':>8} {'rhs':>7} {'x lanes':>8} {'x scalar':>8}"
    print(head)
    for entry in table:
        label = f"{entry['slope_deg']} deg {entry['speed']} m/s"
        for kernel in list(entry)[2:]:
            part = entry[kernel]
            line = f"{label:>14} {kernel:>8} {1e3 * part['seconds']:9.4f} {100 * part['error']:8.3f}"
            line += f" {part['rhs']:7d}"
            if "ratio_lanes" in part:
                line += f" {part['ratio_lanes']:8.0f} {part['ratio_scalar']:8.0f}"
            print(line)
    ratios = mean_ratios(table)
    for name, part in ratios.items():
        goal = f", goal {GOALS[name]}" if name in GOALS else ""
        print(
            f"{name}: {part['lanes']:.0f} x lanes (least {part['least lanes']:.0f}){goal}; "
            f"{part['scalar']:.1f} x scalar (least {part['least scalar']:.1f}); geometric means"
        )
    high = high_friction(drops, arguments.population)
    for entry in high:
        beside = f", MuJoCo {entry['mujoco_ratio']:.0f} x" if "mujoco_ratio" in entry else ""
        print(
            f"hf {entry['slope_deg']} deg {entry['speed']} m/s: {1e3 * entry['seconds']:.4f} ms in lanes, "
            f"error {100 * entry['error']:.3f} %{beside}"
        )
    if "mujoco_ratio" in high[0]:
        ratio = float(np.exp(np.mean([math.log(entry["mujoco_ratio"]) for entry in high])))
        print(f"hf MuJoCo: {ratio:.0f} x lanes, goal {GOALS['MuJoCo']} (geometric mean)")
    peak = peak_memory()
    print(f"peak memory of this run: {peak:.0f} MB")
    cold = {surface: cold_compile(surface) for surface in SURFACES} if arguments.cold else {}
    for surface, part in cold.items():
        print(
            f"{surface} cold: {part['cpu_seconds']:.1f} s of processor time, peak {part['peak_mb']:.0f} MB "
            f"({part['imported_mb']:.0f} MB of it imports)"
        )
    for surface, kinds in rates.items():
        for kind, part in kinds.items():
            walls = ", ".join(f"{rate:.0f} on {n} thread(s)" for n, rate in part["drops_per_second"].items())
            print(
                f"{surface} {kind} candidates: {part['drops_per_cpu_second']:.0f} drops per CPU second; "
                f"{walls} of wall-clock time; {part['rhs']:.0f} right-hand sides, "
                f"at most {part['most_rhs']}; {part['failed']} failed"
            )
    for lanes, rate in widths.items():
        print(f"{lanes} lane(s): {rate:.0f} drops per CPU second")
    if arguments.json:
        result = {
            "machine": platform.platform(),
            "tolerance": {name: own.tolerance for name, own in SURFACES.items()},
            "limit": LIMIT,
            "drops": table,
            "throughput": rates,
            "mean_ratios": ratios,
            "high_friction": high,
            "peak_mb": peak,
            "cold": cold,
            "drops_per_cpu_second_by_lanes": widths,
        }
        arguments.json.write_text(json.dumps(result, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
