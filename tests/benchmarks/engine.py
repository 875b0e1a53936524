"""The search engine in numbers: algorithms, cost of checkpoints, two workers against one, 64 simulated.

Run ``python tests/benchmarks/engine.py PART [--problem lf|hf|motor] [--seeds 5] [--algorithms ga:400,cmaes]
[--json PATH]`` with PART one of

``algorithms``
    Candidates and processor time (of all threads) until the best NRMSE is within 1.01 × the best that any of
    the runs found, for every algorithm alone and with its finisher; how many seeds get there; where they end.
``overhead``
    Wall time of one run of the default search with checkpoints on one thread, and the shares of it, and of
    its processor time, that are spent outside the simulations.
``workers``
    The same search on one core and on two, with Dask worker processes and with threads; everything is pinned
    to the cores (Linux), so that with one of them breeding and scheduling run nowhere else.
``schedule``
    A simulated cluster of 64 workers for five runs of population 800: measured time of a candidate, measured
    time of breeding, 1 ms of scheduler per chunk; no real machines. ``--shared-breeding`` lets all runs breed
    in one process, which `sysid.fit.apart` avoids.

The problems are synthetic campaigns of seed 1 (six drops with 0.3 mm and 0.2° of noise) and the sample
motor logs.
"""

import argparse
import contextlib
import heapq
import json
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from sysid.campaign import read_campaign
from sysid.executor import DaskCluster, LocalThreads, chunk_size
from sysid.fit.algorithms import breeder
from sysid.fit.checkpoint import Checkpoint
from sysid.fit.engine import Hooks, SearchSettings, run_many, run_one
from sysid.fit.objective import SpreadObjective, causes_of
from sysid.fit.stopping import StopRule
from sysid.synthetic import read_truth, synthesize_gear

SAMPLES = Path(__file__).resolve().parents[2] / "data_samples"
# Algorithm and population: the paper's 400 (200 for a motor), a quarter of it, CMA-ES of 64 as in a
# feasibility study.
DEFAULT = "ga:400,ga:100,matlab-ga:400,matlab-ga:100,cmaes:64,de:100,pso:100"


def gear(folder, surface, threads=None):
    from sysid.pipelines.drops import prepare_drops
    from sysid.pipelines.gear import GearObjective, score_values, search_space

    source = synthesize_gear(Path(folder) / surface, seed=1, surface=surface)
    path = source / "campaign.toml"
    campaign = read_campaign(path, "gear")
    drops = tuple(drop for drop in prepare_drops(campaign, path) if drop.use == "fit")
    objective = GearObjective.build(campaign, search_space(campaign), drops, threads)
    truth = float(score_values(campaign, drops, read_truth(source)["parameters"]).cost[0])
    return objective, truth


def motor(threads=None):
    from sysid.pipelines.motor_bench import prepare_bench, search_space
    from sysid.pipelines.motor_objective import MotorObjective

    path = SAMPLES / "motor" / "campaign.toml"
    campaign = read_campaign(path, "motor")
    bench = prepare_bench(campaign, path)
    space = search_space(campaign, bench)
    return MotorObjective.build(campaign, space, bench, bench.fitted, threads), None


def problem(name, folder, threads=None):
    objective, truth = motor(threads) if name == "motor" else gear(folder, name, threads)
    objective.evaluate(np.full((8, len(objective.space.free)), 0.5))  # compiles
    return objective, truth


def algorithms(arguments, folder):
    """Return a row per algorithm: how soon and how often it comes within 1.01 × the best known."""
    objective, truth = problem(arguments.problem, folder)
    found = {}
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    for name in arguments.algorithms:
        algorithm, _, population = name.partition(":")
        for seed in seeds:
            settings = SearchSettings(int(population or 100), 1, seed, StopRule(), algorithm)
            clock, spent, lowest = time.process_time(), [], [np.inf]

            def mark(run, generation, clock=clock, spent=spent, lowest=lowest):
                spent.append((generation.evaluations, time.process_time() - clock))
                lowest[0] = generation.best

            def enough(lowest=lowest):
                return arguments.best is not None and lowest[0] <= 1.01 * arguments.best

            run = run_one(objective, settings, hooks=Hooks(on_generation=mark, should_stop=enough))
            found[name, seed] = run, np.array(spent)
            print(
                f"{name} seed {seed}: "
                + ", ".join(f"{s.algorithm} {s.evaluations} -> {s.cost.min():.6f}" for s in run.stages),
                flush=True,
            )
    best = arguments.best or min(float(run.best[-1]) for run, _ in found.values())
    rows = []
    for name in arguments.algorithms:
        runs = [found[name, seed] for seed in seeds]
        ways = ["alone"] if len(runs[0][0].stages) == 1 else ["alone", "with finisher"]
        for way in ways:
            reached, ends, total = [], [], []
            for run, spent in runs:
                count = len(run.stages[0].cost) if way == "alone" else len(run.best)
                curve = run.best[:count]
                ends.append(float(curve[-1]) / (truth or best))
                total.append(int(spent[count - 1, 0]))
                hits = np.flatnonzero(curve <= 1.01 * best)
                if len(hits):
                    reached.append(spent[hits[0]])
            rows.append(
                {
                    "algorithm": f"{name} {way}",
                    "reached": f"{len(reached)}/{len(runs)}",
                    "candidates to 1.01": float(np.median([r[0] for r in reached])) if reached else None,
                    "processor time to 1.01 [s]": float(np.median([r[1] for r in reached]))
                    if reached
                    else None,
                    "candidates in all": float(np.median(total)),
                    # Of the truth's NRMSE where there is a truth.
                    "ends at x": [round(end, 4) for end in sorted(ends)],
                }
            )
    print(
        f"\n{arguments.problem}: best known {best:.6f}" + (f", {best / truth:.4f} x truth's" if truth else "")
    )
    for row in rows:
        print("  ".join(f"{value}" for value in row.values()))
    return {"problem": arguments.problem, "best": best, "truth": truth, "rows": rows}


def overhead(arguments, folder):
    """Return what a run spends outside its simulations, and what the checkpoints cost of that."""
    objective, _ = problem(arguments.problem, folder, threads=1)
    simulating, computing = [0.0], [0.0]

    class Timed:
        space, causes = objective.space, causes_of(objective)

        def evaluate(self, cube):
            began, clock = time.perf_counter(), time.process_time()
            scored = objective.evaluate(cube)
            simulating[0] += time.perf_counter() - began
            computing[0] += time.process_time() - clock
            return scored

    settings = SearchSettings(runs=1, seed=1)
    hold = Checkpoint(Path(folder) / "fit", {"benchmark": 1})
    writing = [0.0]

    def keep(run, memory, ended):
        began = time.perf_counter()
        hold.keep(run, memory, ended)
        writing[0] += time.perf_counter() - began

    began, clock = time.perf_counter(), time.process_time()
    run_one(Timed(), settings, hooks=Hooks(keep=keep))
    wall, processor = time.perf_counter() - began, time.process_time() - clock
    hold.discard()
    out = {
        "wall [s]": wall,
        "checkpoints [%]": 100 * writing[0] / wall,
        "breeding and the rest [%]": 100 * (wall - simulating[0] - writing[0]) / wall,
        "processor time [s]": processor,
        "of it outside the simulations [%]": 100 * (processor - computing[0]) / processor,
    }
    print(out)
    return out


def workers(arguments, folder):
    """Return the speed of two cores against one, with worker processes and with threads.

    The search, Dask's scheduler and the workers share the cores: with one, nothing runs elsewhere.
    """
    import distributed

    settings = SearchSettings(seed=1, stop=StopRule(max_generations=arguments.generations), finish="none")
    everywhere = os.sched_getaffinity(0)
    spent = {"processes": {}, "threads": {}}
    busy = {}
    for count in (1, 2):
        objective, _ = gear(Path(folder) / str(count), arguments.problem, threads=1)
        _pin(sorted(everywhere)[:count])
        options = {"n_workers": count, "threads_per_worker": 1, "dashboard_address": None}
        with distributed.LocalCluster(**options) as pool:
            where = DaskCluster(pool.scheduler_address, at_once=5)
            spread = SpreadObjective(objective, where)
            spread.evaluate(np.random.default_rng(0).random((64, len(objective.space.free))))  # compiles
            began, clock = time.perf_counter(), _processor_time(where)
            run_many(spread, settings, at_once=5)
            spent["processes"][count] = time.perf_counter() - began
            busy[count] = (_processor_time(where) - clock) / (count * spent["processes"][count])
            where.close()
        _pin(everywhere)
    for count in (1, 2):
        objective, _ = gear(Path(folder) / f"threads-{count}", arguments.problem, threads=count)
        objective.evaluate(np.full((8, len(objective.space.free)), 0.5))
        _pin(sorted(everywhere)[:count])
        with LocalThreads() as local:
            spread = SpreadObjective(objective, local)
            began = time.perf_counter()
            run_many(spread, settings, at_once=local.at_once)
            spent["threads"][count] = time.perf_counter() - began
        _pin(everywhere)
    out = {
        f"{way}: {what}": value
        for way, times in spent.items()
        for what, value in (
            ("one core [s]", times[1]),
            ("two cores [s]", times[2]),
            ("efficiency", times[1] / (2 * times[2])),
        )
    }
    # What other work on the machine took of the cores, a ratio of wall times cannot tell from idling.
    out["processes: cores got, one"], out["processes: cores got, two"] = busy[1], busy[2]
    print(out, f"load {os.getloadavg()}")
    return out


def _pin(cores):
    """Keep all threads of this process on some cores; those that it starts inherit them."""
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(ProcessLookupError):  # it has ended
            os.sched_setaffinity(int(thread.name), set(cores))


def _processor_time(where):
    """Return the processor time of this process, which runs the scheduler too, and of the workers [s]."""
    return time.process_time() + sum(where._client.run(time.process_time).values())


def schedule(arguments, folder):
    """Return how busy simulated workers are; a chunk goes to the first free worker, in order of arrival."""
    objective, _ = gear(folder, arguments.problem, threads=1)
    rng = np.random.default_rng(0)
    points = 0.5 + 0.1 * rng.standard_normal((64, len(objective.space.free)))  # near an optimum, none fails
    objective.evaluate(points[:8])
    chunks = []
    for first in range(0, 64, 16):
        began = time.process_time()
        objective.evaluate(points[first : first + 16])
        chunks.append((time.process_time() - began) / 16)
    bred = breeder("ga", len(objective.space.free), 800, 1)
    breeding = []
    for _ in range(12):
        began = time.process_time()
        candidates = bred.ask()
        half = time.process_time() - began
        cost = np.sqrt(np.mean((candidates - 0.4) ** 2, axis=1))
        began = time.process_time()
        bred.tell(cost)
        breeding.append(half + time.process_time() - began)
    measured, breed = float(np.median(chunks)), float(np.median(breeding))
    busy = _simulated(64, 5, 800, measured, np.array(chunks), breed, arguments.shared_breeding, rng)
    out = {"candidate [ms]": 1e3 * measured, "breeding of 800 [ms]": 1e3 * breed, "busy": busy}
    print(out)
    return out


def _simulated(n_workers, runs, population, candidate, spread, breed, shared, rng, generations=30):
    size = chunk_size(population, runs, n_workers, candidate)
    free = [0.0] * n_workers
    heapq.heapify(free)
    scheduler = client = worked = end = 0.0
    ready = [(0.0, run, 0) for run in range(runs)]
    heapq.heapify(ready)
    while ready:
        now, run, generation = heapq.heappop(ready)
        if shared:
            now = client = max(now, client) + breed
        else:
            now += breed
        last = now
        for first in range(0, population, size):
            scheduler = max(now, scheduler) + 1e-3
            spent = min(size, population - first) * rng.choice(spread)
            begin = max(scheduler, heapq.heappop(free))
            heapq.heappush(free, begin + spent)
            worked += spent
            last = max(last, begin + spent)
        end = max(end, last)
        if generation + 1 < generations:
            heapq.heappush(ready, (last, run, generation + 1))
    return worked / (n_workers * end)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("part", choices=["algorithms", "overhead", "workers", "schedule"])
    parser.add_argument("--problem", choices=["lf", "hf", "motor"], default="lf")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--best", type=float, help="best NRMSE known; a run ends within 1.01 of it")
    parser.add_argument("--algorithms", type=lambda text: text.split(","), default=DEFAULT.split(","))
    parser.add_argument("--generations", type=int, default=8, help="of part workers")
    parser.add_argument("--shared-breeding", action="store_true")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = globals()[arguments.part](arguments, folder)
    if arguments.json:
        arguments.json.write_text(json.dumps(out, indent=2), encoding="utf-8")


if __name__ == "__main__":
    main()
