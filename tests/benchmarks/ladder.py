"""Does the ladder name what is missing? LF campaigns whose truth has terms that the paper's model lacks.

    python tests/benchmarks/ladder.py [--campaigns 20] [--first-seed 101] [--terms 0|1|3]

Every campaign is fitted by one run of the default search, and the ladder starts where the run ends. Printed
for each campaign: the terms of its truth, the terms that the ladder keeps, NRMSE over noise before and after,
the errors of the parameters with the terms kept, the verdict on the base model, how many of its 95 %
intervals contain the truth or are declared not interpretable, and by how much misfit widens them (1 where
noise explains the drops). Without foreign terms the model is right. Foreign terms come from
`fakes.foreign_gear`, which has no code of the kernel and smooths dry friction in another way.

Measured on low friction, 11 to 15 s of processor time a ladder, another one on the other core (2026-11-28):

| truth | seeds | first term right | NRMSE within 1.15 x noise | parameters within 3 and 8 % |
|---|---|---:|---:|---:|
| one foreign term | 101 to 120 | 16 of 20 | 20 | 19 |
| three foreign terms | 301 to 320 | 20 of 20 | 20 | 17 |

The four misses are a ground that stiffens with speed, which these drops hardly show: the base is
"explained" there, and no term is kept. Under one term one campaign misses the limits of the parameters,
under three terms three: k_h by 3.3 and k_t by 3.4 % (a wrong third term), k_t by 3.5 % (all terms right),
k_h by 5.5 and k_t by 8.2 % (two of three terms not kept). "Explained" is said of no other campaign with a
foreign term. Of ten right models (seeds 401 to 410) none keeps a term. Of the 160 intervals of the base
model under one term 156 contain the truth or are declared not interpretable (26), under three terms all
(69).

Before the fit with all terms began at the best single term, and again where fewer terms fit better, it
could end 25 % above the fit with two of them. Which terms were kept then depended on the last digits of the
start.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fakes.foreign_gear import NAMES, NONE, TERMS, simulator
from interval_coverage import Covered, judged
from paired import flags
from sysid.campaign import read_campaign
from sysid.fit.adequacy import adequacy
from sysid.fit.search import run_one
from sysid.fit.settings import SearchSettings
from sysid.synthetic import read_truth, synthesize_gear
from sysid.trust.assessment import linearize
from sysid.trust.ladder import Climber, Ladder
from sysid.trust.terms import freed
from sysid.workflows.kinds import find_kind

# Largest error that is asked for with the terms adopted [1].
WANTED = {
    "leg_axial_stiffness": 0.03, "leg_bending_stiffness": 0.03, "joint_dx": 0.03, "leg_axial_damping": 0.08,
    "leg_bending_damping": 0.08,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Climbed:
    """A ladder, the parameters that its truth adds to the model, and the errors of the best rung [1].

    `model` is the verdict on the base model, `worst` its residual over noise in the worst channel or in the
    mean [1]. `intervals` are those of its parameters, `widening` the deviations over those that noise alone
    leaves, the median and the largest [1]. `seconds` is processor time of the ladder.
    """

    ladder: Ladder
    missing: tuple[str, ...]
    errors: dict[str, float]
    model: str
    worst: float
    intervals: list[Covered]
    widening: tuple[float, float]
    seconds: float

    @property
    def kept(self) -> list[str]:
        return [name for term in self.ladder.best.terms for name in term.parameters]

    @property
    def missed(self) -> list[str]:
        return [row.name for row in self.intervals if not row.inside]


def climbed(seed: int, count: int, folder: Path, intervals: bool = True) -> Climbed:
    """Synthesize drops with `count` foreign terms of at least half of their size, assess the fit, climb."""
    source = np.random.default_rng(seed)
    drawn = source.choice(sorted(set(NAMES) - {"front_friction"}), count, replace=False)
    foreign = {name: NONE[name] + (TERMS[name] - NONE[name]) * source.uniform(0.5, 1.0) for name in drawn}
    out = folder / f"lf-{seed}"
    synthesize_gear(out, seed=seed, surface="lf", simulate=simulator(**foreign))
    path, true, kind = out / "campaign.toml", read_truth(out)["parameters"], find_kind("gear")
    fitted = kind.open(read_campaign(path, "gear"), path, None).fitted
    start = run_one(fitted, SearchSettings(runs=1, seed=seed)).best_point
    began = time.process_time()
    ladder = Climber(fitted, start).climb(kind.terms)
    spent = time.process_time() - began
    errors = {name: ladder.best.values[name] / true[name] - 1 for name in WANTED}
    covered, wider = [], np.ones(1)
    if intervals:
        assessed, covered = judged(fitted.exact, true, start, freed(fitted, kind.terms))
        wider = assessed.linear.information.sigma / assessed.noise.information.sigma
        judgement = assessed.adequacy
    else:
        judgement = adequacy(fitted, fitted.space.full(linearize(fitted, start).point[None])[0])
    return Climbed(
        ladder, tuple(NAMES[name] for name in drawn), errors, judgement.verdict,
        max(judgement.ratio, judgement.misfit.channel_ratio), covered,
        (float(np.median(wider)), float(wider.max())), spent,
    )  # fmt: skip


def main() -> None:
    """Print a line per campaign, then how often the first term was right."""
    options = flags(__doc__, json=False, campaigns=20, first_seed=101)
    options.add_argument("--terms", "--foreign", type=int, choices=(0, 1, 3), default=1)
    options.add_argument("--no-intervals", dest="intervals", action="store_false", help="the ladder alone")
    chosen = options.parse_args()
    first = near = explained = kept_none = inside = total = uninterpretable = 0
    words: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(chosen.first_seed, chosen.first_seed + chosen.campaigns):
            result = climbed(seed, chosen.terms, Path(folder), chosen.intervals)
            kept, errors, best = result.kept, result.errors, result.ladder.best
            first += bool(kept) and kept[0] in result.missing
            kept_none += not kept
            near += all(abs(errors[name]) <= limit for name, limit in WANTED.items())
            explained += best.ratio <= 1.15
            words.append(result.model)
            inside += len(result.intervals) - len(result.missed)
            total += len(result.intervals)
            uninterpretable += sum(row.verdict == "not_interpretable" for row in result.intervals)
            off = ", ".join(f"{name} {100 * error:+.1f} %" for name, error in errors.items())
            unread = sum(row.verdict == "not_interpretable" for row in result.intervals)
            print(
                f"seed {seed}: missing {_listed(result.missing)}; kept {_listed(kept)}; over noise "
                f"{result.ladder.base.ratio:.2f} -> {best.ratio:.2f}; {off}; base {result.model} "
                f"({result.worst:.2f} x noise), covers {len(result.intervals) - len(result.missed)} of "
                f"{len(result.intervals)} (missed {_listed(result.missed)}; {unread} not interpretable; "
                f"widths x {result.widening[0]:.2f}, at most {result.widening[1]:.2f}); "
                f"ladder {result.seconds:.0f} s",
                flush=True,
            )
    verdicts = _listed([f"{words.count(word)} {word}" for word in dict.fromkeys(words)])
    print(
        f"first term right in {first} of {chosen.campaigns}, none kept in {kept_none}, NRMSE within 1.15 x "
        f"noise in {explained}, parameters within 3 and 8 % in {near}; intervals of the base model: {inside} "
        f"of {total}, {uninterpretable} of them not interpretable; verdicts: {verdicts}"
    )


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"


if __name__ == "__main__":
    main()
