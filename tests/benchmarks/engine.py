"""The search engine in numbers: algorithms, cost of checkpoints, two workers against one, 64 simulated.

Run ``python tests/benchmarks/engine.py PART [--problem NAME] [--seeds 5] [--algorithms ga:400,cmaes]
[--json PATH]`` with PART one of

``finishers``
    On every campaign of ``--campaigns`` (see ``campaigns.py``): runs of the default search that end within
    1.002 × the lowest NRMSE of all runs, the worst run, candidates and processor time, with the finisher by
    least squares and with CMA-ES.
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
    in one process, which `sysid.fit.breeders.in_process` avoids.
``table``
    ``--from A.json B.json`` (what ``--json`` has written) as the tables of ``tests/benchmarks/engine.md``.

"""

import argparse
import contextlib
import heapq
import json
import os
import platform
import sys
import tempfile
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np

import campaigns
from sysid.fit.breeders.algorithms import breeder
from sysid.fit.checkpoint import Checkpoint
from sysid.fit.objective import SpreadObjective, causes_of
from sysid.fit.search import Hooks, SearchSettings, run_many, run_one
from sysid.fit.stopping import StopRule
from sysid.parallel import DaskCluster, LocalThreads, chunk_size
from sysid.workflows.provenance import processor

# Algorithm and population: the paper's 400 (200 for a motor), a quarter of it, CMA-ES of 64 as in a
# feasibility study.
DEFAULT = "ga:400,ga:100,matlab-ga:400,matlab-ga:100,cmaes:64,de:100,pso:100"
NUMBERS = {
    "overhead": "One run of the default search on one thread: what is spent outside its simulations.",
    "workers": "Two cores against one.",
}
TITLE = """# The search engine, measured

Tables in the layout of `tests/benchmarks/engine.py table`; that file says what the parts are. Medians over
the seeds; processor time is that of all threads. "alone" is the first stage by itself (for `matlab-ga`
the paper's way); "with finisher" counts the candidates of both stages.
"""


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
            run_one(
                objective, SearchSettings(16, 1, 99, StopRule(max_generations=2), finish=finish)
            )  # imports
            for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
                began = time.process_time()
                run = run_one(objective, SearchSettings(runs=1, seed=seed, finish=finish))
                spent = time.process_time() - began
                runs.setdefault(finish, []).append([float(run.best[-1]), run.evaluations, spent])
                print(name, finish, seed, [s.algorithm for s in run.stages], runs[finish][-1], flush=True)
        out[name] = {"floor": floor, "runs": runs}
    print("\n".join(finisher_lines([{"campaigns": out}])))
    return {"campaigns": out}


def finisher_lines(documents):
    """Return the table of both finishers: runs at the lowest NRMSE known, the worst one, what they cost."""
    lines = [
        "| campaign | what it is | lowest NRMSE | × noise | finisher | runs within 1.002 × | worst × | "
        "candidates | processor time [s] |",
        "|---|---|---:|---:|---|---:|---:|---:|---:|",
    ]
    for document in documents:
        for name, entry in document["campaigns"].items():
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


def algorithms(arguments, folder):
    """Return every run of every algorithm, generation by generation; `rows` makes the table of it."""
    objective = problem(arguments.problem, folder)
    runs = []
    for name in arguments.algorithms:
        algorithm, _, population = name.partition(":")
        for seed in range(arguments.first_seed, arguments.first_seed + arguments.seeds):
            settings = SearchSettings(int(population or 100), 1, seed, StopRule(), algorithm)
            clock, spent = time.process_time(), []

            def mark(run, generation, clock=clock, spent=spent):
                spent.append((generation.evaluations, time.process_time() - clock))

            run = run_one(objective, settings, hooks=Hooks(on_generation=mark))
            runs.append(
                {
                    "algorithm": name,
                    "seed": seed,
                    "generations": [len(stage.cost) for stage in run.stages],
                    # Of the end of every generation: candidates, processor time [s], best NRMSE.
                    "curve": [
                        [count, round(spent_s, 4), float(best)]
                        for (count, spent_s), best in zip(spent, run.best, strict=True)
                    ],
                }
            )
            print(
                f"{name} seed {seed}: "
                + ", ".join(f"{s.algorithm} {s.evaluations} -> {s.cost.min():.6f}" for s in run.stages),
                flush=True,
            )
    out = {"problem": arguments.problem, "runs": runs}
    print("\n".join(["", *algorithm_lines([out])]))
    return out


def algorithm_lines(documents):
    """Return the table of one problem: how soon and how often each comes within 1.01 x the best known."""
    name = documents[0]["problem"]
    runs = [run for document in documents for run in document["runs"]]
    best = min(run["curve"][-1][2] for run in runs)
    lines = [
        f"**{name}: {campaigns.CAMPAIGNS[name][0]}.** Lowest NRMSE known: {100 * best:.4f} %.",
        "",
        "| algorithm:population | | reached | candidates to 1.01 | processor time to 1.01 [s] | candidates "
        "in all | ends at × the lowest, seed by seed |",
        "|---|---|---:|---:|---:|---:|---|",
    ]
    for algorithm in dict.fromkeys(run["algorithm"] for run in runs):
        own = sorted((run for run in runs if run["algorithm"] == algorithm), key=lambda run: run["seed"])
        finished = len(own[0]["generations"]) > 1
        for way in ("alone", "with finisher") if finished else ("alone",):
            curves = [
                np.array(run["curve"][: run["generations"][0] if way == "alone" else None]) for run in own
            ]
            hits = [curve[curve[:, 2] <= 1.01 * best] for curve in curves]
            first = np.array([hit[0] for hit in hits if len(hit)])
            count, spent = np.median(first[:, :2], axis=0) if len(first) else (np.nan, np.nan)
            total = np.median([curve[-1, 0] for curve in curves])
            ends = ", ".join(f"{curve[-1, 2] / best:.3f}" for curve in curves)
            cells = (
                algorithm,
                way,
                f"{len(first)}/{len(own)}",
                f"{count:.0f}",
                f"{spent:.2g}",
                f"{total:.0f}",
                ends,
            )
            lines.append(f"| {' | '.join(cells).replace('nan', '–')} |")
    return lines


def table(arguments, folder):
    """Write the tables of what was measured (`--from`) into a file of the project (`--write`)."""
    documents = [json.loads(path.read_text(encoding="utf-8")) for path in arguments.sources]
    lines = [TITLE]
    both = [d for d in documents if d["part"] == "finishers"]
    if both:
        lines += [*finisher_lines(both), ""]
    for name in campaigns.CAMPAIGNS:
        own = [d for d in documents if d["part"] == "algorithms" and d["problem"] == name]
        if own:
            lines += [*algorithm_lines(own), ""]
    for part, words in NUMBERS.items():
        own = [d for d in documents if d["part"] == part]
        if own:
            lines += [f"{words} (`{part}`)", ""]
            names = [key for key in own[0] if key not in ("part", "problem", "measured")]
            # Wall time is of a quiet machine or of no use.
            names = [key for key in names if all(d[key] is not None for d in own)]
            lines += ["| | " + " | ".join(d["problem"] for d in own) + " |", "|---|" + "---:|" * len(own)]
            lines += [f"| {name} | " + " | ".join(f"{d[name]:.3g}" for d in own) + " |" for name in names]
            lines.append("")
    for machine in dict.fromkeys(_machine(document) for document in documents):
        own = [document for document in documents if _machine(document) == machine]
        lines += [f"Measured {machine}, by", "", "```sh"]
        lines += [f"python tests/benchmarks/engine.py {d['measured']['command']}" for d in own] + ["```", ""]
    lines.pop()
    arguments.write.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    print(f"wrote {arguments.write}")


def _machine(document):
    when = document["measured"]
    versions = ", ".join(f"{name} {number}" for name, number in when["versions"].items())
    return f"on {when['date']} with {when['processor']}, {when['cores']} cores, {versions}"


def measured(words):
    """Return when, on what and by which command something was measured."""
    # Where the numbers lie is nobody's business but of who measures.
    kept = [word for i, word in enumerate(words) if "--json" not in (word, *words[max(i - 1, 0) : i])]
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "processor": processor(),
        "cores": os.cpu_count(),
        "versions": {"python": platform.python_version()}
        | {name: version(name) for name in ("sysid", "numpy", "numba", "pymoo", "cma")},
        "command": " ".join(kept),
    }


def overhead(arguments, folder):
    """Return what a run spends outside its simulations, and what the checkpoints cost of that."""
    objective = problem(arguments.problem, folder, threads=1)
    simulating, computing = [0.0], [0.0]

    class Timed:
        space, causes = objective.space, causes_of(objective)

        def evaluate(self, cube):
            began, clock = time.perf_counter(), time.process_time()
            scored = objective.evaluate(cube)
            simulating[0] += time.perf_counter() - began
            computing[0] += time.process_time() - clock
            return scored

    settings, quiet = SearchSettings(runs=1, seed=1), os.getloadavg()[0] < 1.5
    for name in settings.stages:  # imports, once per process
        breeder(name, len(objective.space.free), 16, 1)
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
        "wall [s]": wall if quiet else None,
        "of it checkpoints [%]": 100 * writing[0] / wall if quiet else None,
        "of it breeding and the rest [%]": 100 * (wall - simulating[0] - writing[0]) / wall
        if quiet
        else None,
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
                spread = SpreadObjective(objective, where)
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
                spread = SpreadObjective(objective, local)
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
    objective = problem(arguments.problem, folder, threads=1)
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
    parser.add_argument(
        "part", choices=["finishers", "algorithms", "overhead", "workers", "schedule", "table"]
    )
    parser.add_argument("--problem", choices=list(campaigns.CAMPAIGNS), default="lf")
    parser.add_argument("--campaigns", type=lambda text: text.split(","), default=list(campaigns.CAMPAIGNS))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--algorithms", type=lambda text: text.split(","), default=DEFAULT.split(","))
    parser.add_argument("--generations", type=int, default=8, help="of part workers")
    parser.add_argument("--pairs", type=int, default=3, help="of part workers")
    parser.add_argument("--shared-breeding", action="store_true")
    parser.add_argument("--json", type=Path, help="where the numbers go")
    parser.add_argument("--from", dest="sources", type=Path, nargs="+", help="of part table: such numbers")
    parser.add_argument("--write", type=Path, default=Path(__file__).with_suffix(".md"))
    arguments = parser.parse_args()
    if arguments.part == "table" and not arguments.sources:
        parser.error("table needs --from and the files that --json has written")
    with tempfile.TemporaryDirectory() as folder:
        out = globals()[arguments.part](arguments, folder)
    if arguments.json and out is not None:
        out = {
            "part": arguments.part,
            "problem": arguments.problem,
            **out,
            "measured": measured(sys.argv[1:]),
        }
        arguments.json.write_text(json.dumps(out), encoding="utf-8")


if __name__ == "__main__":
    main()
