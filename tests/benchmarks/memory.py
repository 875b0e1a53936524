"""Resident memory of whole fits, and what each further drop and run adds to it.

Run ``python tests/benchmarks/memory.py [--drops N] [--runs N] [--population N] [--finish NAME]
[--no-intervals]``. It writes a campaign of drawn drops on low friction, opens it, and fits it. It prints the
memory of imports and kernels, of the drops, after every run, and at most: until the search ended, and with
the intervals. The median difference of two runs is what a run adds. Linux only.

Measured with compiled kernels in the cache (2 cores, Python 3.11, November 2026): imports and kernels take
299 MB, of which 92 MB are LLVM's library; ``--drops 6 --runs 1`` 346 MB in the search and 395 MB with the
intervals. The process that compiles the kernels takes 125 MB more.
``--drops 60 --runs 100 --population 8 --finish none --max-generations 2 --no-intervals`` adds
0.00 MB per run (median; mean 0.09) to 391 MB, and takes 683 MB when the 60 drops are judged in the end. The
paper's method (``--finish none``) keeps some 60 generations of 400, which is 1.8 MB per run.
"""

import tempfile
from pathlib import Path

import numpy as np

from paired import flags, memory
from sysid.fit.progress import FitProgress
from sysid.gear.model import prepare
from sysid.synthetic import DropPlan, synthesize_gear
from sysid.workflows.fit import fit_gear
from sysid.workflows.kinds import open_campaign
from sysid.workflows.options import FitOptions

MB = 1e6


def resident(peak=False):
    """Memory of this process that lies in RAM now, or at most until now [MB]."""
    return memory(peak) / MB


def drawn(folder, count):
    """Write a campaign of drops that all fit into the window of a log; return its file."""
    source = np.random.default_rng(1)
    pairs = [(source.uniform(4, 28), source.uniform(0.4, 0.85)) for _ in range(count)]
    plans = [DropPlan(float(np.radians(round(slope, 1))), round(speed, 2)) for slope, speed in pairs]
    return synthesize_gear(folder, seed=1, surface="lf", drops=plans) / "campaign.toml"


def main():
    """Measure and print."""
    parser = flags(
        __doc__, json=False, drops=60, runs=100, population=400, max_generations=None,
        finish="least-squares", no_intervals=False,
    )  # fmt: skip
    chosen = parser.parse_args()
    after = []

    def on_run(progress, run, history):
        cells = sum(stage.cube.nbytes + stage.cost.nbytes for stage in history.stages)
        after.append((resident(), cells / MB, resident(peak=True)))
        print(
            f"run {run + 1}: {after[-1][0]:.0f} MB, {after[-1][1]:.2f} MB of it are its populations",
            flush=True,
        )

    FitProgress.on_run = on_run
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare("lf")
        print(f"imports and kernels: {resident():.0f} MB")
        for count in (2, chosen.drops):
            path = drawn(folder / str(count), count)
            before = resident()
            kind, campaign, _ = open_campaign(path)
            problem = kind.open(campaign, path, None)
            print(f"{count} drops: {before:.0f} MB before, {resident():.0f} MB after they are opened")
            del problem
        options = FitOptions(
            out=folder / "fit", quiet=True, runs=chosen.runs, population=chosen.population,
            finish=chosen.finish, max_generations=chosen.max_generations, check=False,
            trust=not chosen.no_intervals,
        )  # fmt: skip
        fit_gear(path, options)
    rises = np.diff([now for now, *_ in after])
    if rises.size:
        print(f"each run adds {np.median(rises):.2f} MB (median), {rises.mean():.2f} MB (mean)")
    print(f"at most {after[-1][2]:.0f} MB in the search, {resident(peak=True):.0f} MB in all")


if __name__ == "__main__":
    main()
