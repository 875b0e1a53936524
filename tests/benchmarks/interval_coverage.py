"""Do the intervals contain the truth, and is a wrong model called wrong? Twenty fitted campaigns.

    python tests/benchmarks/interval_coverage.py [--replications 20] [--problem lf] [--foreign 0|1|3]

Prints how many of the 95 % profile intervals of each parameter contain the true value, over all replications,
how often each was called well, weakly or not identifiable, and how far outside the worst one lies; and for
each campaign the verdict on the model with the residual over noise. With ``--foreign`` each LF truth has that
number of terms that the model lacks (`fakes.foreign_gear.TERMS`), drawn with half to all of their size.

Measured from the truth on, right models, LF, seeds 1001 to 1019: 126 of 133 intervals of the seven parameters
other than b_s, which is not identifiable, contain the truth (95 %). Five of the seven misses are seed 1011's:
noise moves the start of its drop-5 past a fork of the bounces, and the fit bends the rest to that drop.
`sysid.trust.influence` names the drop: without it k_h moves by 6.4 times what one trial less explains, where
the farthest of the other campaigns moves by 4.1.

The verdict: of twenty right models 19 are "explained", with 1.03 to 1.13 times the noise in their worst
channel (seed 1011: 2.9 times in x). Of one foreign term, seeds 201 to 212, ten are "not explained" (1.8 to
27 times); two are "explained" with 1.04 and 1.05 times: a ground that stiffens with speed, which no channel
shows.

Motors, seeds 2001 to 2020: R is inside in 19 of 20 and L in 18, with errors of 0.85 and 1.06 times what is
stated; k_d is not identifiable in any.

Intervals of fits that end where a search leads them, under foreign terms: `tests/benchmarks/ladder.py`.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fakes.foreign_gear import drawn_terms, simulator
from paired import flags
from sysid.campaign import read_campaign
from sysid.fit.adequacy import Adequacy
from sysid.fit.problem import Problem
from sysid.synthetic import read_truth, synthesize_gear, synthesize_motor
from sysid.synthetic.motor import TRIALS
from sysid.trust.assessment import Assessment, assess
from sysid.types import FloatArray
from sysid.workflows.kinds import find_kind


@dataclass(frozen=True)
class Covered:
    """One parameter of one replication."""

    name: str
    truth: float
    best: float
    low: float
    high: float
    half_width: float
    verdict: str

    @property
    def inside(self) -> bool:
        return self.low <= self.truth <= self.high or self.verdict == "not_interpretable"

    @property
    def beyond(self) -> float:
        """How far outside its interval the truth lies, in half-widths [1]."""
        return max(self.low - self.truth, self.truth - self.high, 0.0) / ((self.high - self.low) / 2)


def replicate(seed: int, problem: str, folder: Path, foreign: int = 0) -> tuple[Adequacy, list[Covered]]:
    """Synthesize logs, fit from the truth (no search: a fit's best set lies there), profile.

    A motor has a forward and a reverse trial; command delays, of no motor, are left out.
    """
    kind, out = "motor" if problem == "motor" else "gear", folder / f"{problem}-{seed}"
    if kind == "motor":
        synthesize_motor(out, seed=seed, trials=TRIALS[:2])
    else:
        lab = {"simulate": simulator(**drawn_terms(seed, foreign))} if foreign else {}
        synthesize_gear(out, seed=seed, surface=problem, **lab)
    path, true = out / "campaign.toml", read_truth(out)["parameters"]
    fitted = find_kind(kind).open(read_campaign(path, kind), path, None).fitted
    fitted = fitted if kind == "motor" else fitted.exact
    assessed, intervals = judged(fitted, true)
    return assessed.adequacy, intervals


def judged(
    fitted: Problem, true: dict[str, float], start: FloatArray | None = None, wider: Problem | None = None
) -> tuple[Assessment, list[Covered]]:
    """Assess a problem of fitted trials from the place where a fit ended, by default from its truth."""
    free = fitted.space.free
    truth = np.array([true[row.common_name] for row in free])
    assessed = assess(
        fitted, fitted.space.encode(truth) if start is None else start, wider=wider, resamples=0
    )
    return assessed, [
        Covered(p.name, t, p.best, *p.interval_95, p.half_width, word)
        for p, t, row, word in zip(assessed.profiles.profiles, truth, free, assessed.verdicts, strict=True)
        if not row.trial
    ]


def main() -> None:
    """Print the coverage."""
    options = flags(__doc__, json=False, replications=20, first_seed=1001)
    options.add_argument("--problem", choices=("lf", "hf", "motor"), default="lf")
    options.add_argument("--foreign", type=int, choices=(0, 1, 3), default=0)
    chosen = options.parse_args()
    rows: dict[str, list[Covered]] = {}
    words: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(chosen.first_seed, chosen.first_seed + chosen.replications):
            began = time.perf_counter()
            judged, intervals = replicate(seed, chosen.problem, Path(folder), chosen.foreign)
            words.append(judged.verdict)
            for covered in intervals:
                rows.setdefault(covered.name, []).append(covered)
            missed = [covered.name for covered in intervals if not covered.inside]
            covered = f"{len(intervals) - len(missed)} of {len(intervals)} contain the truth {missed or ''}"
            print(f"seed {seed}: {covered}, {time.perf_counter() - began:.0f} s", flush=True)
            terms = ", ".join(drawn_terms(seed, chosen.foreign)) if chosen.foreign else "right model"
            print(f"    {terms}: {judged.sentence}", flush=True)
    inside = total = 0
    print(f"{'parameter':<26}{'covered':>9}{'worst':>7}{'half':>8}{'rms z':>7}  verdicts")
    for name, found in rows.items():
        inside_of = [one.inside for one in found]
        names = [one.verdict for one in found]
        counts = ", ".join(f"{names.count(word)} {word}" for word in dict.fromkeys(names))
        scatter = [1.96 * (one.best - one.truth) / max(one.half_width * one.best, 1e-300) for one in found]
        print(
            f"{name:<26}{sum(inside_of):>4}/{len(inside_of):<4}{max(one.beyond for one in found):>7.2f}"
            f"{100 * float(np.median([one.half_width for one in found])):>7.1f}%"
            f"{float(np.sqrt(np.mean(np.square(scatter)))):>7.2f}  {counts}"
        )
        if names.count("not_identifiable") < len(names):
            inside, total = inside + sum(inside_of), total + len(inside_of)
    share = 100 * inside / total
    print("verdicts on the model:", ", ".join(f"{words.count(w)} {w}" for w in dict.fromkeys(words)))
    print(f"identifiable parameters: {inside} of {total} intervals contain the truth ({share:.0f} %)")


if __name__ == "__main__":
    main()
