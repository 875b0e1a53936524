"""The search engine in numbers: where runs end and what they cost, and two workers against one.

Run ``python tests/benchmarks/engine.py PART [--problem NAME] [--seeds 5] [--json PATH]`` with PART one of

``finishers``
    On every campaign of ``--campaigns`` (see ``campaigns.py``): runs of the default search that end within
    1.002 × the lowest NRMSE of all runs, the worst run, candidates and processor time, with the finisher by
    least squares and with CMA-ES.
``workers``
    The same search on one core and on two, with Dask worker processes and with threads; everything is pinned
    to the cores (Linux), so that with one of them breeding and scheduling run nowhere else.
``overhead``
    Time per simulation [µs] of a user's function by itself, in `predict` and in `evaluate`, by population.

``engine.md`` has the tables, and what former parts of this file have answered.
"""

import contextlib
import os
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

import campaigns
import sysid
from paired import best, flags, report
from sysid.fit.problem import computed_by
from sysid.fit.search import run_many, run_one
from sysid.fit.settings import SearchSettings
from sysid.parallel import DaskCluster, LocalThreads
from sysid.workflows.kinds import open_campaign


def problem(name, folder, threads=None):
    objective = campaigns.problem(name, Path(folder), threads)
    middle = np.full((8, len(objective.space.free)), 0.5)
    objective.evaluate(middle)  # compiles
    objective.examine(middle)
    return objective


def finishers(arguments, folder):
    """Return what every run of both finishers costs and where it ends, campaign by campaign."""
    out = {}
    for name in arguments.campaigns:
        objective = problem(name, folder)
        floor = sum(block.weight * block.noise for block in objective.blocks)
        runs = {}
        for finish in ("least-squares", "cmaes"):
            run_one(objective, SearchSettings(16, 1, 99, 2, finish=finish))  # imports
            for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
                began = time.process_time()
                run = run_one(objective, SearchSettings(runs=1, seed=seed, finish=finish))
                spent = time.process_time() - began
                runs.setdefault(finish, []).append([float(run.best[-1]), run.evaluations, spent])
                print(name, finish, seed, [s.algorithm for s in run.stages], runs[finish][-1], flush=True)
        out[name] = {"floor": floor, "runs": runs}
    print("\n".join(finisher_lines(out)))
    return {"campaigns": out}


def finisher_lines(campaigns_run):
    """Return the table of both finishers: runs at the lowest NRMSE known, the worst one, what they cost."""
    lines = [
        "| campaign | what it is | lowest NRMSE | × noise | finisher | runs within 1.002 × | worst × | "
        "candidates | processor time [s] |",
        "|---|---|---:|---:|---|---:|---:|---:|---:|",
    ]
    for name, entry in campaigns_run.items():
        runs = {finish: np.array(rows) for finish, rows in entry["runs"].items()}
        lowest = min(rows[:, 0].min() for rows in runs.values())
        for finish, rows in runs.items():
            ratio = rows[:, 0] / lowest
            near, count = np.count_nonzero(ratio <= 1.002), len(ratio)
            cells = (
                f"{name} | {campaigns.CAMPAIGNS[name][0]} | {100 * lowest:.3f} % | "
                f"{lowest / entry['floor']:.2f} | {finish} | {near}/{count} | {ratio.max():.4f} | "
                f"{np.median(rows[:, 1]):.0f} | {np.median(rows[:, 2]):.2g}"
            )
            lines.append(f"| {cells} |")
    return lines


def workers(arguments, folder):
    """Return the speed of two cores against one, with worker processes and with threads.

    The search, Dask's scheduler and the workers share the cores: with one, nothing runs elsewhere.
    """
    import distributed

    settings = SearchSettings(seed=1, max_generations=arguments.generations, finish="none")
    everywhere = os.sched_getaffinity(0)
    spent = {way: {1: [], 2: []} for way in ("processes", "threads")}
    got = {1: [], 2: []}
    # In turn, because the speed of a shared machine drifts.
    for _ in range(arguments.pairs):
        for count in (1, 2):
            objective = problem(arguments.problem, Path(tempfile.mkdtemp(dir=folder)), threads=1)
            _pin(sorted(everywhere)[:count])
            options = {"n_workers": count, "threads_per_worker": 1, "dashboard_address": None}
            with distributed.LocalCluster(**options) as pool:
                where = DaskCluster(pool.scheduler_address, at_once=5)
                spread = computed_by(objective, where)
                spread.evaluate(np.random.default_rng(0).random((64, len(objective.space.free))))  # compiles
                began, clock = time.perf_counter(), _processor_time(where)
                run_many(spread, settings, at_once=5)
                wall = time.perf_counter() - began
                spent["processes"][count].append(wall)
                got[count].append((_processor_time(where) - clock) / (count * wall))
                where.close()
            _pin(everywhere)
        for count in (1, 2):
            objective = problem(arguments.problem, Path(tempfile.mkdtemp(dir=folder)), threads=count)
            _pin(sorted(everywhere)[:count])
            with LocalThreads() as local:
                spread = computed_by(objective, local)
                began = time.perf_counter()
                run_many(spread, settings, at_once=local.at_once)
                spent["threads"][count].append(time.perf_counter() - began)
            _pin(everywhere)
    out = {}
    for way, times in spent.items():
        one, two = np.array(times[1]), np.array(times[2])
        out |= {f"{way}: one core [s]": one.tolist(), f"{way}: two cores [s]": two.tolist()}
        out[f"{way}: efficiency"] = float(np.median(one / (2 * two)))
    # What other work on the machine took of the cores, a ratio of wall times cannot tell from idling.
    out["processes: cores got, one"], out["processes: cores got, two"] = got[1], got[2]
    return out | {"load": os.getloadavg()[0]}


def overhead(arguments, folder):
    """Four logs of 200 samples, and a function that takes some 3 µs; one thread."""
    time, trials = np.arange(200) / 200, {}

    def decay(values, time, trial):
        return values["start"] * np.exp(-values["rate"] * time)

    parameters = {"rate": (0.1, 10.0, "1/s"), "start": (0.1, 5.0, "V")}
    owner = sysid.model("decay_timed", decay, parameters=parameters, channels={"level": "V"})
    for k in range(4):
        noise = 0.01 * np.random.default_rng(k).standard_normal(200)
        trials[str(k)] = pd.DataFrame({"level": 2 * np.exp(-3 * time) + noise}, index=time)
    kept = owner.campaign(trials)
    kind, content, _ = open_campaign(kept.path)
    one = kind.open(content, kept.path, 1)
    values, log = {"rate": 3.0, "start": 2.0}, one.records[0]
    out = {
        "bare": 1e6 * best(lambda: [decay(values, log.time, log.inputs) for _ in range(2000)], 9)[0] / 2000
    }
    for count in (1, 5, 100, 400):
        cube, calls = np.random.default_rng(0).random((count, 2)), 1 + 2000 // count
        for what, given in ((one.predict, one.space.full(cube)), (one.evaluate, cube)):
            spent, _ = best(lambda call=what, rows=given, n=calls: [call(rows) for _ in range(n)], 9)
            out[f"{what.__name__}: {count}"] = 1e6 * spent / calls / count / 4
    return out


def _pin(cores):
    """Keep all threads of this process on some cores; those that it starts inherit them."""
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(ProcessLookupError):  # it has ended
            os.sched_setaffinity(int(thread.name), set(cores))


def _processor_time(where):
    """Return the processor time of this process, which runs the scheduler too, and of the workers [s]."""
    return time.process_time() + sum(where._client.run(time.process_time).values())


def main():
    parser = flags(__doc__, seeds=5, first_seed=1, generations=8, pairs=3)
    parser.add_argument("part", choices=["finishers", "workers", "overhead"])
    parser.add_argument("--problem", choices=list(campaigns.CAMPAIGNS), default="lf")
    parser.add_argument("--campaigns", type=lambda text: text.split(","), default=list(campaigns.CAMPAIGNS))
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = globals()[arguments.part](arguments, folder)
    report(out, arguments.json)


if __name__ == "__main__":
    main()
