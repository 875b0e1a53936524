"""What the words predicts, predicts roughly and does not predict mean, on synthetic campaigns.

    python tests/benchmarks/use.py right --seeds 1-7 [--law hf | motor]
    python tests/benchmarks/use.py foreign --seeds 201-210 [--terms 3]
    python tests/benchmarks/use.py wrong --seeds 1-5

Campaigns of other drones and motors, as `stated_values.py` makes them: with values off by the errors that
they state (`right`), with true values and physics that the model lacks (`foreign`), and with one value that
is off by 15 % and believed exactly (`wrong`). The model is fitted in one run; its held-out trials are
predicted. Printed for each: verdict, misfit over noise, the word, numbers held, and which share of the
held-out samples the 95 % band of draws holds, where these come from a twin campaign without noise.
"""

import argparse
import tempfile
import warnings
from pathlib import Path

import numpy as np

from fakes.foreign_gear import drawn_terms, simulator
from fakes.lab import GOOD_LAB, MOTOR_LAB, misstated
from stated_values import DRAWN, DRAWN_MOTOR
from sysid.export import read_judged_fit
from sysid.gear.model import parameters_on
from sysid.synthetic import synthesize_gear, synthesize_motor
from sysid.synthetic.motor import TRUE_MOTOR
from sysid.trust.documents import TrustDocument
from sysid.workflows.draws import stored_draws
from sysid.workflows.fit import fit_gear, fit_motor
from sysid.workflows.options import FitOptions
from sysid.workflows.predict import open_under, validate_fit

# Values of a campaign, one of which is off.
WRONG = ("body_inertia", "body_mass", "kinetic_friction")


def campaign(folder, law, seed, foreign, quiet):
    """Write a campaign of another drone or motor, or its twin without noise; return its file."""
    random, motor = np.random.default_rng(seed), law == "motor"
    nominal, names = (TRUE_MOTOR, DRAWN_MOTOR) if motor else (parameters_on(law).nominal, DRAWN)
    true = {name: nominal[name] * (1 + 0.15 * random.uniform(-1, 1)) for name in names}
    if motor:
        more = {"torque_constant": true["back_emf_constant"]}
        return synthesize_motor(folder, seed=seed, parameters=true | more, noise=not quiet) / "campaign.toml"
    lab = {"simulate": simulator(**drawn_terms(seed, foreign))} if foreign else {}
    lab |= {"noise_position": 1e-9, "noise_angle": 1e-9} if quiet else {}
    return synthesize_gear(folder, seed=seed, surface=law, parameters=true, **lab) / "campaign.toml"


def covered(fit, path, quiet):
    """Return which share of the held-out samples without noise lies in the band of draws [1]."""
    result = read_judged_fit(fit)
    draws = stored_draws(fit, result)
    kind, whole = open_under(result, path)
    names = [trial.name for trial in whole.trials if trial.use == "validate"]
    story = kind.story(whole.only(names).exact)
    drawn = story.signals(result, np.concatenate([result.values[:1], draws]))
    _, clean = open_under(result, quiet)
    inside, count = 0, 0
    for trial, true, signals in zip(story.problem.trials, clean.only(names).trials, drawn, strict=True):
        low, high = np.quantile(signals[1:], [0.025, 0.975], axis=0)
        for c in np.flatnonzero(story.problem.cost.weights > 0):
            at = np.interp(trial.time, true.time, true.measured[:, c])
            seen = trial.valid[:, c] & (trial.time <= true.time[-1])
            inside += np.count_nonzero((low[:, c] <= at) & (at <= high[:, c]) & seen)
            count += np.count_nonzero(seen)
    return inside / count


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("case", choices=["right", "foreign", "wrong"])
    parser.add_argument("--seeds", default="1-3")
    parser.add_argument("--law", default="lf", choices=["lf", "hf", "motor"])
    parser.add_argument("--terms", type=int, default=1, help="foreign terms, of low friction")
    arguments = parser.parse_args()
    first, last = map(int, arguments.seeds.split("-"))
    terms = arguments.terms if arguments.case == "foreign" else 0
    for seed in range(first, last + 1):
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            path = campaign(Path(folder) / "logs", arguments.law, seed, terms, quiet=False)
            twin = campaign(Path(folder) / "twin", arguments.law, seed, terms, quiet=True)
            what = ""
            if arguments.case == "right":
                lab = MOTOR_LAB if arguments.law == "motor" else GOOD_LAB
                # The twin states the same, so that both are seen in one frame.
                path, twin = (misstated(one, seed, name="stated.toml", errors=lab) for one in (path, twin))
            if arguments.case == "wrong":
                what = WRONG[seed % len(WRONG)]
                path = misstated(
                    path, 0, name="wrong.toml", gross={what: 1.0}, errors={what: "15 %"}, written=False
                )
            fit = Path(folder) / "fit"
            begin = fit_motor if arguments.law == "motor" else fit_gear
            exact = {"exact": True} if what else {}
            begin(path, FitOptions(out=fit, runs=1, quiet=True, check=False, **exact))
            trust = TrustDocument.read(fit)
            document = validate_fit(fit, path)
            use, judged = document.use, trust.adequacy
            share = covered(fit, path, twin)
            widths = ", ".join(f"{each.what} {each.half_width:.2g} {each.unit}" for each in use.widths)
            parts = (
                f"{seed:4} {judged.verdict:13} {judged.ratio:5.2f} x  {use.word or 'too few':16}",
                f"{use.held + use.classes_right:2} of {use.count + use.classes:2}",
                f"classes {use.classes_right} of {use.classes}",
                f"band {100 * share:5.1f} %",
                widths,
                what,
            )
            print("  ".join(parts), flush=True)


if __name__ == "__main__":
    main()
