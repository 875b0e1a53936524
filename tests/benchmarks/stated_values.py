"""Campaigns whose values are drawn from the errors that they state: what fits find, and whom they accuse.

    python tests/benchmarks/stated_values.py good --seeds 1-20 [--law hf] [--exact] [--times 3]
    python tests/benchmarks/stated_values.py gross --seeds 101-140 [--law hf]

Every campaign is of another drone. `good` draws every value from its error; `gross` moves one key by 5 to 15
standard errors on top of that. Printed for each campaign: verdict, errors of k_h, k_t, dx_j, intervals that
contain the truth, accused values, processor time; then the counts.
"""

import argparse
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

from fakes.lab import GOOD_LAB, misstated
from sysid.gear.model import parameters_on
from sysid.synthetic import read_truth, synthesize_gear
from sysid.trust.documents import TrustDocument
from sysid.workflows.fit import fit_gear
from sysid.workflows.options import FitOptions

# Parameters of a drone that are drawn by 15 %, masses, lengths and friction of the campaign included.
DRAWN = (
    "body_mass", "body_inertia", "foot_dx", "foot_dz", "leg_axial_stiffness", "leg_axial_damping",
    "leg_bending_stiffness", "leg_bending_damping", "ground_stiffness", "kinetic_friction",
)  # fmt: skip
SHOWN = ("leg_axial_stiffness", "leg_bending_stiffness", "joint_dx")
# Names of the fit's rows for keys of the campaign; x, y, z of the capture are across, up and up-slope.
ROWS = {
    "slope[3]": "slope[drop-3]", "centre_of_mass_offset[1]": "centre_of_mass_dz",
    "centre_of_mass_offset[2]": "centre_of_mass_dx", "point[1]": "surface_dz", "point[2]": "surface_dx",
}  # fmt: skip


def drone(law, seed):
    """True values of a drone [SI]."""
    random, nominal = np.random.default_rng(seed), parameters_on(law).nominal
    return {name: nominal[name] * (1 + 0.15 * random.uniform(-1, 1)) for name in DRAWN}


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("case", choices=["good", "gross"])
    parser.add_argument("--seeds", default="1-3")
    parser.add_argument("--law", default="lf")
    parser.add_argument("--times", type=float, default=1.0, help="the lab's errors over what it states")
    parser.add_argument("--exact", action="store_true")
    parser.add_argument("--runs", type=int, default=1)
    arguments = parser.parse_args()
    first, last = map(int, arguments.seeds.split("-"))
    errors, held = [], []
    count = explained = accused = named = asked_in = with_truth = 0
    for seed in range(first, last + 1):
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            source = synthesize_gear(
                Path(folder) / "drops",
                seed=seed,
                surface=arguments.law,
                parameters=drone(arguments.law, seed),
            )
            gross, key = {}, ""
            if arguments.case == "gross":
                random = np.random.default_rng(seed)
                keys = [*(k for k in GOOD_LAB if k not in ("slope", "point", "centre_of_mass_offset")), *ROWS]
                keys = [k for k in keys if arguments.law == "lf" or not k.startswith(("leg_", "kinetic"))]
                key = str(random.choice(keys))
                gross = {key: float(random.uniform(5, 15) * random.choice([-1, 1]))}
            path = misstated(
                source / "campaign.toml", seed, name="misstated.toml", gross=gross, times=arguments.times
            )
            began = time.process_time()
            options = FitOptions(
                out=Path(folder) / "fit", runs=arguments.runs, quiet=True, check=False, exact=arguments.exact
            )
            result, where = fit_gear(path, options)
            spent = time.process_time() - began
            trust = TrustDocument.parse((where / "trust.json").read_text("utf-8"), where, ValueError)
            true = read_truth(source)["parameters"]
        values = {name: float(known.values[0]) for name, known in result.known.items()}
        errors.append([values[name] / true[name] - 1 for name in SHOWN])
        holds = [row.contains(true[name]) for name, row in trust.by_name.items()]
        held += holds
        wrong = [row for row in trust.stated if row.contradicted]
        count += 1
        explained += trust.adequacy.verdict == "explained"
        accused += bool(wrong)
        text = ", ".join(f"{row.name} ({', '.join(row.partners)})" for row in wrong)
        if gross:
            row_name = ROWS.get(key, key)
            named += any(row_name in (row.name, *row.partners) for row in wrong)
            truth = {**true, "slope[drop-3]": np.radians(15)}.get(row_name, np.nan)
            row = {row.name: row for row in trust.stated}[row_name]
            asked_in += abs(row.asked - truth) < 1.96 * row.sigma
            with_truth += bool(np.isfinite(truth))
            text = f"{key} by {gross[key]:+.1f}: {text or 'nobody'}"
        shown = " ".join(f"{100 * value:+6.1f}" for value in errors[-1])
        print(
            f"{seed:4d} {trust.adequacy.verdict:17s} {trust.adequacy.ratio:5.2f} x  k_h k_t dx_j {shown} %  "
            f"{sum(holds)}/{len(holds)}  {spent:5.1f} s  {text}",
            flush=True,
        )
    middle = 100 * np.median(np.abs(errors), axis=0)
    print(
        f"{explained} of {count} explained, {sum(held)} of {len(held)} intervals contain the truth, median "
        f"errors of k_h {middle[0]:.1f}, k_t {middle[1]:.1f}, dx_j {middle[2]:.1f} %"
    )
    if arguments.case == "gross":
        print(f"the right value named in {named}, its truth in {asked_in} of {with_truth} intervals")
    else:
        print(f"{accused} campaigns with an accused value")


if __name__ == "__main__":
    main()
