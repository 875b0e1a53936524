"""Wall and processor time of whole fits, from logs to the written folder.

Run ``python tests/benchmarks/whole_fit.py [lf hf motor] [--algorithm NAME] [--finish NAME] [--population N]
[--json PATH] [--threads N]``. `lf` and `hf` are the sample campaigns; `motor` is the paper's fit of 5 runs of
population 200 on eight 2-s trials at 10 kHz. With other programs on the machine the
wall clock says little.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from paired import flags, measured, report
from sysid.gear.model import SURFACES, prepare
from sysid.synthetic.motor import TRUE_MOTOR, TrialPlan, synthesize_motor
from sysid.workflows.fit import fit_gear, fit_motor
from sysid.workflows.options import FitOptions

SAMPLES = Path(__file__).parents[2] / "data_samples"


def paper_bench(folder):
    """Eight trials of four commands each, forward and reverse in turn."""
    source, plans = np.random.default_rng(0), []
    for number in range(8):
        sign, direction = ((1, "forward"), (-1, "reverse"))[number % 2]
        levels = tuple(float(u) for u in np.round(sign * source.uniform(0.3, 1.0, 4), 2))
        plans.append(TrialPlan(f"trial-{number}", direction, "fit", 0.25 * sign, levels, 0.5, "hdf5"))
    return synthesize_motor(folder, seed=1, trials=plans) / "campaign.toml"


def whole_fit(problem, options, folder):
    """Times [s], simulations and scores of one fit; of a motor also how far R and L are off [%]."""
    options = replace(options, out=folder / "fit")
    if problem == "motor":
        campaign = paper_bench(folder / "bench")
        options = replace(options, population=options.population or 200, runs=5)
        wall, spent, (result, _) = measured(lambda: fit_motor(campaign, options))
    else:
        prepare(problem)
        campaign = SAMPLES / f"gear-{problem}" / "campaign.toml"
        wall, spent, (result, _) = measured(lambda: fit_gear(campaign, options))
    simulations = sum(run.simulations for run in result.runs)
    summary = {
        "wall_seconds": wall,
        "cpu_seconds": spent,
        "simulations": simulations,
        "simulations_per_second": simulations / wall,
        "simulations_per_cpu_second": simulations / spent,
        "generations": [int(sum(len(stage.cost) for stage in run.stages)) for run in result.runs],
        "nrmse": result.nrmse.tolist(),
    }
    if problem == "motor":
        values = result.parameter_sets().set_values(1)
        for name in ("winding_resistance", "winding_inductance"):
            summary[f"{name}_off_percent"] = 100 * (values[name] / TRUE_MOTOR[name] - 1)
    return summary


def main():
    """Measure, print, write the JSON."""
    parser = flags(__doc__, threads=None, population=None)
    parser.add_argument("problems", nargs="*", choices=[*SURFACES, "motor"], default=[*SURFACES, "motor"])
    parser.add_argument("--algorithm")
    parser.add_argument("--finish")
    chosen = vars(parser.parse_args())
    problems, path = chosen.pop("problems"), chosen.pop("json")
    options = FitOptions(
        quiet=True, **{name: value for name, value in chosen.items() if value is not None}, trust=False
    )
    results = {}
    for problem in problems:
        with tempfile.TemporaryDirectory() as folder:
            results[problem] = whole_fit(problem, options, Path(folder))
    report({"fits": results}, path)


if __name__ == "__main__":
    main()
