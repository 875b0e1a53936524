"""Does the ladder name what a motor lacks? Bench campaigns whose truth has one term, or none.

    python tests/benchmarks/motor_ladder.py [--campaigns 4] [--first-seed 301]

The term of a seed is drawn, none included, with half to all of a size that tests/physics/test_motor_terms.py
checks against a slow solver. The ladder starts at the true parameters of the paper's model. Printed per
campaign: the term of its truth, what the ladder keeps, NRMSE over noise before and after, the errors of R and
L with the terms kept, and which simpler models it calls too simple. R of a warming winding is that of the
window's start, which the spin-up before it has warmed by a percent.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from sysid.campaign import read_campaign
from sysid.synthetic import read_truth, synthesize_motor
from sysid.synthetic.motor import TRIALS
from sysid.trust.ladder import Climber, starts_near
from sysid.workflows.kinds import find_kind

SIZES = {"supply_resistance": 0.1, "dead_time_voltage": 0.4, "winding_warming": 4e-3, "": 0.0}


def main() -> None:
    """Print a line per campaign."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--campaigns", type=int, default=4)
    options.add_argument("--first-seed", type=int, default=301)
    chosen = options.parse_args()
    right = 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(chosen.first_seed, chosen.first_seed + chosen.campaigns):
            began = time.process_time()
            # Every four seeds have each term and none.
            source, name = np.random.default_rng(seed), list(SIZES)[(seed - 1) % len(SIZES)]
            foreign = {name: SIZES[name] * source.uniform(0.5, 1.0)} if name else {}
            out = Path(folder) / str(seed)
            synthesize_motor(out, seed=seed, parameters=foreign, trials=TRIALS[:2])
            path, true, kind = out / "campaign.toml", read_truth(out)["parameters"], find_kind("motor")
            problem = kind.open(read_campaign(path, "motor"), path, None).fitted
            known = {row.name: true[row.common_name] for row in problem.space.free}
            ladder = Climber(problem, starts_near(problem.space, known)[0]).climb(
                kind.terms, kind.simpler(problem)
            )
            best = ladder.best
            kept = [one for term in best.terms for one in term.parameters]
            right += kept == list(foreign)
            errors = ", ".join(
                f"{one} {100 * (best.values[one] / true[one] - 1):+.1f} %"
                for one in ("winding_resistance", "winding_inductance")
            )
            simple = ", ".join(rung.terms[0].title for rung in ladder.simpler if rung.kept)
            print(
                f"seed {seed}: missing {name or 'none'}; kept {', '.join(kept) or 'none'}; over noise "
                f"{ladder.base.ratio:.2f} -> {best.ratio:.2f}; {errors}; too simple: {simple or 'none'}; "
                f"{time.process_time() - began:.0f} s",
                flush=True,
            )
    print(f"the ladder keeps the term of the truth and no other in {right} of {chosen.campaigns}")


if __name__ == "__main__":
    main()
