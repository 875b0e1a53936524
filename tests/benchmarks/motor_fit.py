"""Wall time of the paper's motor fit: 5 runs of population 200 on eight 2-s trials at 10 kHz.

Run ``python tests/benchmarks/motor_fit.py [--algorithm NAME] [--finish NAME] [--json PATH] [--threads N]``.
It is the whole command: logs are read and filtered, and after the runs with their finisher come ladder and
profile. With others on the machine the wall clock says little; CPU time is printed beside it.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

from sysid.synthetic.motor import TrialPlan, synthesize_motor
from sysid.workflows.fit import fit_motor
from sysid.workflows.options import FitOptions


def main():
    """Measure, print, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--algorithm", default="ga", choices=("ga", "matlab-ga", "cmaes", "de", "pso"))
    parser.add_argument("--finish", default="cmaes")
    arguments = parser.parse_args()
    source = np.random.default_rng(0)
    plans = []
    for number in range(8):
        sign = 1 if number % 2 == 0 else -1
        levels = tuple(float(u) for u in np.round(sign * source.uniform(0.3, 1.0, 4), 2))
        direction = "forward" if sign > 0 else "reverse"
        plans.append(TrialPlan(f"trial-{number}", direction, "fit", 0.25 * sign, levels, 0.5, "hdf5"))
    with tempfile.TemporaryDirectory() as folder:
        campaign = synthesize_motor(Path(folder) / "bench", seed=1, trials=plans) / "campaign.toml"
        options = FitOptions(
            Path(folder) / "fit", quiet=True, threads=arguments.threads, population=200, runs=5,
            algorithm=arguments.algorithm, finish=arguments.finish,
        )  # fmt: skip
        wall, spent = time.perf_counter(), time.process_time()
        result, _ = fit_motor(campaign, options)
        wall, spent = time.perf_counter() - wall, time.process_time() - spent
    values = result.parameter_sets().set_values(1)
    simulations = sum(run.simulations for run in result.runs)
    summary = {
        "algorithm": f"{arguments.algorithm}, finished by {arguments.finish}",
        "wall time [s]": wall,
        "CPU time [s]": spent,
        "trial simulations of the search": simulations,
        "trial simulations per second, all of the command's time": simulations / wall,
        "trial simulations per second of CPU time": simulations / spent,
        "generations": [int(sum(len(stage.cost) for stage in run.stages)) for run in result.runs],
        "NRMSE": result.nrmse.tolist(),
        "R off by [%]": 100 * (values["winding_resistance"] / 0.299 - 1),
        "L off by [%]": 100 * (values["winding_inductance"] / 0.0038 - 1),
    }
    for name, value in summary.items():
        print(f"{name}: {value:.4g}" if isinstance(value, float) else f"{name}: {value}")
    if arguments.json:
        arguments.json.write_text(json.dumps(summary, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
