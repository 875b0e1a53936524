"""Time and error of the gear's kernel beside scipy's LSODA and Radau.

Run ``python tests/benchmarks/gear_kernel.py [--json PATH] [--population N] [--lanes] [--cold]``. Six
drops of 0.7 s sampled every 5 ms; error is the mean NRMSE over x, z, q, vx, vz against a converged run. Each
method of scipy gets, per drop, its loosest relative tolerance that keeps 0.1 % there. Times are CPU time of
the calling thread, best of several, so that other work on the machine disturbs the ratios little; drops/s
over all threads is wall-clock time. A method's ratio is the geometric mean over the drops, beside the least.
``--cold`` compiles each surface in a process of its own with an empty cache and prints the processor time and
the peak memory of that.

What bounds a random population (100 candidates on the six drops, AMD of family 26, one thread, against the
kernel at ac9ff87): 12.1 instead of 9.3 thousand drops per processor second on low friction, 9.5 instead of
7.4 on high friction, 1.3 times, with as many right-hand sides, 8,389 and 6,621 a drop. One of them takes
9.8 and 15.9 ns a lane. Lanes that wait for slower ones cost 1 % of 100 candidates on one thread. With 16
lanes, two vectors side by side, a drop takes 0.94 to 1.1 times as long: the number of instructions bounds it,
not their latency (``engine.md``).
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from fakes.gear_drops import SIX, level_drops
from gear_rivals import scipy_drop
from paired import LIMIT, best, flags, mean_nrmse, measured, memory, report
from sysid.gear import model
from sysid.gear.kernel.driver import drop_driver
from sysid.gear.model import SURFACES, Drops, pack, parameters_on, simulate, simulate_population
from sysid.parameters import SearchSpace


def lane_widths(drops, population):
    """Drops per CPU second of other numbers of lanes than the one that is used."""
    out = {}
    rows = np.repeat(pack({})[None], population, axis=0)
    used = model._driver
    for lanes in (1, 4, 8, 16):
        driver = drop_driver(lanes, SURFACES["lf"])
        model._driver = lambda _lanes, _surface, driver=driver: driver
        simulate_population(rows[:1], drops, threads=1)
        spent, run = best(lambda: simulate_population(rows, drops, threads=1), 3)
        out[lanes] = run.status.size / spent
    model._driver = used
    return out


def throughput(surface, drops, population):
    """Drops per second of a surface: equal candidates and random ones, one core's CPU time and all cores."""
    table, free = parameters_on(surface), SURFACES[surface].free
    equal = np.repeat(pack({}, surface)[None], population, axis=0)
    space = SearchSpace.build(table, free, table.nominal)
    rows = {"equal": equal, "random": space.full(np.random.default_rng(1).random((population, len(free))))}
    out = {}
    for name, candidates in rows.items():
        simulate_population(candidates[:1], drops, surface=surface)

        def score(threads=1, candidates=candidates):
            return simulate_population(candidates, drops, surface=surface, threads=threads)

        spent, run = best(score, 3)
        out[name] = {
            "drops_per_cpu_second": run.status.size / spent,
            "drops_per_second": {
                threads: run.status.size / best(lambda n=threads: score(n), 3, time.perf_counter)[0]
                for threads in sorted({1, os.cpu_count() or 1})
            },
            "rhs": float(run.rhs_evaluations.mean()),
            "most_rhs": int(run.rhs_evaluations.max()),
            "switches": float(run.switches.mean()),
            "failed": int((run.status != 0).sum()),
        }
    return out


GOALS = {"LSODA": 700}
COLD = """
import json, sys, time
from pathlib import Path
sys.path.insert(0, {folder!r})
from paired import memory
from sysid.gear.model import prepare
before, start = memory() / 2**20, time.process_time()
prepare({surface!r})
print(json.dumps([time.process_time() - start, before, memory() / 2**20]))
"""


def cold_compile(surface):
    """Processor time [s] and peak memory [MB] of the first start of a surface's population driver."""
    with tempfile.TemporaryDirectory() as cache:
        code = COLD.format(folder=str(Path(__file__).parent), surface=surface)
        environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
        command = [sys.executable, "-c", code]
        run = subprocess.run(command, env=environment, capture_output=True, encoding="utf-8", check=True)
    seconds, before, peak = json.loads(run.stdout.splitlines()[-1])
    return {"cpu_seconds": seconds, "imported_mb": before, "peak_mb": peak}


def each_drop(drops, population, surface):
    """Per drop: its arguments for a rival, the exact channels, and an entry with the time in lanes."""
    row = pack({}, surface)
    rows = np.repeat(row[None], population, axis=0)
    # x, z, q, vx, vz, as the rivals have them.
    exact = simulate_population(row, drops, surface=surface, tolerance=1e-8).samples[0, :, :5]
    for d, (slope_deg, speed) in enumerate(SIX):
        part = exact[drops.offset[d] : drops.offset[d + 1]]
        only = Drops(drops.slope[d : d + 1], drops.body_state[d : d + 1], drops.time[d : d + 1])
        spent, many = best(lambda only=only: simulate_population(rows, only, surface=surface, threads=1), 3)
        lanes = {
            "seconds": spent / population,
            "error": mean_nrmse(many.samples[0, :, :5], part),
            "rhs": int(many.rhs_evaluations[0, 0]),
        }
        entry = {"slope_deg": slope_deg, "speed": speed, "lanes": lanes}
        yield (drops.slope[d], drops.body_state[d], drops.time[d]), part, entry


def low_friction(drops, population):
    """Our times and errors in lanes and alone, and each library's, over ours."""
    rivals = {name: lambda *a, n=name: scipy_drop(n, *a) for name in ("LSODA", "Radau")}
    out, row = [], pack({})
    for start, exact, entry in each_drop(drops, population, "lf"):
        spent, alone = best(lambda start=start: simulate(row, *start), 20)
        error = mean_nrmse(alone.state[:, [0, 1, 2, 7, 8]], exact)
        entry["scalar"] = {"seconds": spent, "error": error, "rhs": alone.rhs_evaluations}
        for name, measure in rivals.items():
            rival = measure(*start, exact)
            ratios = {
                f"ratio_{ours}": rival["seconds"] / entry[ours]["seconds"] for ours in ("lanes", "scalar")
            }
            entry[name] = rival | ratios
        out.append(entry)
    return out


def mean_ratios(table):
    """Each method's time over ours, by name: geometric mean over the drops and the least."""
    out = {}
    for name in list(table[0])[2:]:
        if "ratio_lanes" in table[0][name]:
            out[name] = {"goal": GOALS[name]} if name in GOALS else {}
            for kind in ("lanes", "scalar"):
                each = np.array([entry[name][f"ratio_{kind}"] for entry in table])
                out[name][kind] = float(np.exp(np.log(each).mean()))
                out[name][f"least {kind}"] = float(each.min())
    return out


def main():
    """Measure, print, write the JSON."""
    parser = flags(__doc__, population=400)
    parser.add_argument("--lanes", action="store_true", help="also other numbers of lanes (compiles each)")
    parser.add_argument("--cold", action="store_true", help="also the first compilation (a minute or two)")
    arguments = parser.parse_args()
    drops = level_drops()

    def load():
        simulate(pack({}), drops.slope[0], drops.body_state[0], drops.time[0])
        simulate_population(pack({}), drops)

    loaded = measured(load)[0]
    rates = {surface: throughput(surface, drops, arguments.population) for surface in ("lf", "hf")}
    widths = lane_widths(drops, arguments.population // 4) if arguments.lanes else {}
    table = low_friction(drops, arguments.population)
    result = {
        "compiled or loaded [s]": loaded,
        "tolerance": {name: surface.tolerance for name, surface in SURFACES.items()},
        "limit": LIMIT,
        "drops": table,
        "throughput": rates,
        "mean_ratios": mean_ratios(table),
        "high_friction": [entry for _, _, entry in each_drop(drops, arguments.population, "hf")],
        "peak_mb": memory() / 2**20,
        "cold": {surface: cold_compile(surface) for surface in SURFACES} if arguments.cold else {},
        "drops_per_cpu_second_by_lanes": widths,
    }
    report(result, arguments.json)


if __name__ == "__main__":
    main()
