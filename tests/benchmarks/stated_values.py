"""Campaigns whose values are drawn from the errors that they state: what fits find, and whom they accuse.

    python tests/benchmarks/stated_values.py good --seeds 1-20 [--law hf] [--exact] [--times 3]
    python tests/benchmarks/stated_values.py gross --seeds 101-140 [--law hf | motor] [--keys 2]
    python tests/benchmarks/stated_values.py foreign --seeds 101-120

Every campaign is of another drone or motor. `good` draws every value from its error; `gross` moves one key,
or two, by 5 to 15 standard errors on top of that; `foreign` drops have a physical term that the model lacks.
Printed for each campaign: verdict, errors of k_h, k_t, dx_j or of R, L, intervals that contain the truth,
accused values, processor time; then the counts. Of a motor, torque and speed never show an error of Kv, so no
gross one is of Kv. Measured on 2026-11-28, one run of the search in every fit:

| case | seeds | explained | intervals with the truth | median errors [%] | a stated value accused |
|---|---|---:|---:|---|---:|
| good | 1-20 | 19 | 151 of 160 | k_h 1.4, k_t 2.1, dx_j 0.3 | 1 |
| good --exact | 1-10 | 0 | 76 of 80 | k_h 22, k_t 5.9, dx_j 2.9 | |
| good --times 3 | 1-10 | 8 | 72 of 80 | k_h 2.3, k_t 3.4, dx_j 0.6 | 10 |
| good --law hf | 1-10 | 9 | 116 of 120 | k_h 1.4, k_t 1.0, dx_j 0.4 | 1 |
| good --law motor | 201-220 | 20 | 92 of 100 | R 2.4, L 2.4 | 0 |
| good --law motor --exact | 201-210 | 1 | 33 of 50 | R 2.5, L 3.4 | |
| foreign | 101-120 | 5 | 156 of 160 | k_h 3.0, k_t 3.9, dx_j 0.4 | 1 |

| gross errors | seeds | named | all named | the truth in printed intervals | intervals with the truth |
|---|---|---:|---:|---:|---:|
| one | 101-140 | 36 of 40 | 36 | 25 of 25 | 317 of 320 |
| one, --law hf | 301-320 | 18 of 20 | 18 | 9 of 10 | 232 of 240 |
| one, --law motor | 201-220 | 18 of 20 | 18 | 10 of 10 | 91 of 100 |
| two | 401-420 | 19 of 20 | 14 | 21 of 21 | 152 of 160 |

The four gross errors of 101-140 that are not named are masses by 5 to 11 g, which an inertia explains as
well; intervals of `--exact` are wide because the model does not explain the drops, and are declared so.
"""

import argparse
import re
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

from fakes.foreign_gear import drawn_terms, simulator
from fakes.lab import GOOD_LAB, MOTOR_LAB, misstated, scaled
from sysid.errors import LogError
from sysid.gear.model import parameters_on
from sysid.synthetic import read_truth, synthesize_gear, synthesize_motor
from sysid.synthetic.motor import TRUE_MOTOR
from sysid.trust.documents import TrustDocument
from sysid.workflows.fit import fit_gear, fit_motor
from sysid.workflows.options import FitOptions

# Parameters of a drone that are drawn by 15 %, masses, lengths and friction of the campaign included.
DRAWN = (
    "body_mass", "body_inertia", "foot_dx", "foot_dz", "leg_axial_stiffness", "leg_axial_damping",
    "leg_bending_stiffness", "leg_bending_damping", "ground_stiffness", "kinetic_friction",
)  # fmt: skip
SHOWN = {"k_h": "leg_axial_stiffness", "k_t": "leg_bending_stiffness", "dx_j": "joint_dx"}
# The same of a motor; k_m is k_v.
DRAWN_MOTOR = (
    "winding_resistance", "winding_inductance", "rotor_inertia", "back_emf_constant",
    "no_load_slope_forward", "no_load_slope_reverse", "torque_quadratic_forward", "torque_quadratic_reverse",
)  # fmt: skip
SHOWN_MOTOR = {"R": "winding_resistance", "L": "winding_inductance"}
# Column of the static log that a gross error of a curve scales, and what it is worth [standard errors].
CURVES = {
    f"{curve}_{way}": (f"{log}-{way}.csv", column, 1e-3 if log == "static" else 1e-4)
    for curve, log, column in (
        ("torque_curve", "static", "Torque"), ("no_load_line", "no-load", "Motor Optical")
    )
    for way in ("forward", "reverse")
}  # fmt: skip
# Names of the fit's rows for keys of the campaign; x, y, z of the capture are across, up and up-slope.
ROWS = {
    "slope[3]": "slope[drop-3]", "centre_of_mass_offset[1]": "centre_of_mass_dz",
    "centre_of_mass_offset[2]": "centre_of_mass_dx", "point[1]": "surface_dz", "point[2]": "surface_dx",
    "tilt": "capture_tilt",
}  # fmt: skip


def synthesized(folder, law, seed, foreign):
    """Write the campaign of another drone, with a `foreign` term, or motor; return its folder."""
    random, motor = np.random.default_rng(seed), law == "motor"
    nominal, names = (TRUE_MOTOR, DRAWN_MOTOR) if motor else (parameters_on(law).nominal, DRAWN)
    true = {name: nominal[name] * (1 + 0.15 * random.uniform(-1, 1)) for name in names}
    if motor:
        return synthesize_motor(
            folder, seed=seed, parameters=true | {"torque_constant": true["back_emf_constant"]}
        )
    # A joint close to the foot's place is beyond the default bounds of a search.
    true["joint_dx"] = min(nominal["joint_dx"], 0.92 * true["foot_dx"])
    more = {"simulate": simulator(**drawn_terms(seed, 1))} if foreign else {}
    return synthesize_gear(folder, seed=seed, surface=law, parameters=true, **more)


def gross_keys(law):
    """Keys of which one is off by far."""
    if law == "motor":
        return ["rotor_inertia", "reference_voltage", *CURVES]
    keys = [*(k for k in GOOD_LAB if k not in ("slope", "point", "centre_of_mass_offset", "tilt")), *ROWS]
    return [k for k in keys if law == "lf" or not k.startswith(("leg_", "kinetic"))]


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("case", choices=["good", "gross", "foreign"])
    parser.add_argument("--seeds", default="1-3")
    parser.add_argument("--law", default="lf", choices=["lf", "hf", "motor"])
    parser.add_argument("--times", type=float, default=1.0, help="the lab's errors over what it states")
    parser.add_argument("--keys", type=int, default=1, help="how many are off by far")
    parser.add_argument("--exact", action="store_true")
    parser.add_argument("--runs", type=int, default=1)
    arguments = parser.parse_args()
    first, last = map(int, arguments.seeds.split("-"))
    motor = arguments.law == "motor"
    fit, errors_of = (fit_motor, MOTOR_LAB) if motor else (fit_gear, GOOD_LAB)
    judged = SHOWN_MOTOR if motor else SHOWN
    errors, held = [], []
    count = refused = explained = accused = named = all_named = asked_in = with_truth = 0
    for seed in range(first, last + 1):
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            source = synthesized(Path(folder) / "logs", arguments.law, seed, arguments.case == "foreign")
            gross = {}
            if arguments.case == "gross":
                random = np.random.default_rng(seed)
                keys = map(str, random.choice(gross_keys(arguments.law), arguments.keys, replace=False))
                gross = {key: float(random.uniform(5, 15) * random.choice([-1, 1])) for key in keys}
                if "leg_inertia" in gross:  # ten errors of 10 % less are no inertia
                    gross["leg_inertia"] = abs(gross["leg_inertia"])
                for key in gross.keys() & CURVES.keys():
                    log, column, size = CURVES[key]
                    scaled(source / log, column, 1 + size * gross[key])
            path = misstated(
                source / "campaign.toml", seed, name="misstated.toml", errors=errors_of,
                gross={key: size for key, size in gross.items() if key not in CURVES}, times=arguments.times,
            )  # fmt: skip
            began = time.process_time()
            options = FitOptions(
                out=Path(folder) / "fit", runs=arguments.runs, quiet=True, check=False, exact=arguments.exact
            )
            moved = ", ".join(f"{key} by {size:+.1f}" for key, size in gross.items())
            try:
                result, where = fit(path, options)
            except LogError as error:
                # A value that is off so far that no drop can be read is an answer as well.
                refused += 1
                print(f"{seed:4d} refused: {moved}: {error}", flush=True)
                continue
            spent = time.process_time() - began
            trust = TrustDocument.parse((where / "trust.json").read_text("utf-8"), where, ValueError)
            true = read_truth(source)["parameters"]
        values = {name: float(known.values[0]) for name, known in result.known.items()}
        errors.append([values[name] / true[name] - 1 for name in judged.values()])
        holds = [row.contains(true[name.partition("[")[0]]) for name, row in trust.by_name.items()]
        held += holds
        wrong = [row for row in trust.stated if row.contradicted]
        count += 1
        explained += trust.adequacy.verdict == "explained"
        accused += bool(wrong)
        text = ", ".join(f"{row.name} ({', '.join(row.partners)})" for row in wrong)
        seen = []
        for key in gross:
            row_name = ROWS.get(key, key)
            # The rows of a curve are at its top and in its middle.
            own = [
                row for row in trust.stated if {row.name, re.sub("_(top|middle)", "", row.name)} & {row_name}
            ]
            seen.append(any({row.name for row in own} & {row.name, *row.partners} for row in wrong))
            truth = {**true, "slope[drop-3]": np.radians(15)}.get(row_name, np.nan)
            # Of a value that is not named no interval is printed.
            asked_in += seen[-1] and abs(own[0].asked - truth) < 1.96 * own[0].sigma
            with_truth += seen[-1] and bool(np.isfinite(truth))
        named += any(seen)
        all_named += bool(seen) and all(seen)
        shown = " ".join(f"{100 * value:+6.1f}" for value in errors[-1])
        print(
            f"{seed:4d} {trust.adequacy.verdict:17s} {trust.adequacy.ratio:5.2f} x  "
            f"{' '.join(judged)} {shown} %  "
            f"{sum(holds)}/{len(holds)}  {spent:5.1f} s  {moved and moved + ': '}{text or 'nobody'}",
            flush=True,
        )
    middle = zip(judged, 100 * np.median(np.abs(errors).reshape(-1, len(judged)), axis=0), strict=True)
    print(
        f"{explained} of {count} explained, {sum(held)} of {len(held)} intervals contain the truth, median "
        f"errors of {', '.join(f'{name} {size:.1f} %' for name, size in middle)}"
    )
    if refused:
        print(f"{refused} refused before a fit")
    if arguments.case == "gross":
        print(
            f"a wrong value named in {named}, all in {all_named}; the truth in {asked_in} of {with_truth} "
            "printed intervals"
        )
    else:
        print(f"{accused} campaigns with an accused value")


if __name__ == "__main__":
    main()
