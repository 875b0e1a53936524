"""What the benchmarks share: flags, times and errors of two ways of one computation, memory, results."""

import argparse
import json
import math
import os
import platform
import time
from pathlib import Path

import numpy as np

# Mean NRMSE that another method must keep, at the loosest of these relative tolerances that does.
LIMIT = 1e-3
TOLERANCES = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7)


def flags(doc, *, json=True, **defaults):
    """Read the flags of a benchmark, ``--json PATH`` among them: a default states its kind, None a number."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawTextHelpFormatter)
    for name, default in defaults.items():
        how = {"type": int if default is None else type(default)}
        if isinstance(default, bool):
            how = {"action": "store_true"}
        parser.add_argument(f"--{name.replace('_', '-')}", default=default, **how)
    if json:
        parser.add_argument("--json", type=Path, help="file that the numbers go into")
    return parser


def best(call, repeats, clock=time.thread_time):
    """Least time [s] by a clock, of this thread's processor unless told otherwise, and the last result."""
    spent, result = math.inf, None
    for _ in range(repeats):
        start = clock()
        result = call()
        spent = min(spent, clock() - start)
    return spent, result


def measured(call):
    """Wall time [s], processor time [s] and the result."""
    wall, spent = time.perf_counter(), time.process_time()
    result = call()
    return time.perf_counter() - wall, time.process_time() - spent, result


def mean_nrmse(ours, exact):
    """Mean NRMSE over the channels."""
    return float((np.sqrt(np.mean((ours - exact) ** 2, axis=0)) / exact.std(axis=0)).mean())


def loosest(attempt, exact, repeats):
    """Time [s], error, tolerance, right-hand sides of ``attempt(rtol)`` where it first keeps the limit."""
    for rtol in TOLERANCES:
        spent, result = best(lambda rtol=rtol: attempt(rtol), 1)
        if result is not None and (error := mean_nrmse(result[0], exact)) <= LIMIT:
            again, _ = best(lambda rtol=rtol: attempt(rtol), repeats)
            return {"seconds": min(spent, again), "error": error, "rtol": rtol, "rhs": result[1]}
    return {"seconds": math.nan, "error": math.nan, "rtol": math.nan, "rhs": 0}


def memory(peak=True):
    """Largest resident size of this process so far, or its size now [bytes]; NaN where no way to ask is."""
    status = Path("/proc/self/status")
    if status.exists():
        # Not getrusage, whose peak begins with the size of the process that started this one.
        lines = status.read_text(encoding="utf-8").splitlines()
        key = "VmHWM" if peak else "VmRSS"
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(key))
    try:
        import psutil
    except ImportError:
        return math.nan
    sizes = psutil.Process().memory_info()
    return getattr(sizes, "peak_wset", math.nan) if peak else sizes.rss


def numbers(result, place=""):
    """Yield a line for every number of a nested result, with its place in it."""
    if isinstance(result, (dict, list)):
        for key, part in result.items() if isinstance(result, dict) else enumerate(result):
            yield from numbers(part, f"{place}, {key}" if place else str(key))
    else:
        yield f"{place}: {f'{result:.4g}' if isinstance(result, float) else result}"


def report(result, path):
    """Print every number of a result; write it, with the machine it is of, if a path is given."""
    print("\n".join(numbers(result)), flush=True)
    if path is not None:
        result = {"machine": platform.platform(), "cores": os.cpu_count(), **result}
        path.write_text(json.dumps(result, indent=1), encoding="utf-8")
