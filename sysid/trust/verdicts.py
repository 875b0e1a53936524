"""Verdicts: well, weakly or not identifiable; and what the trials of a campaign determine, in sentences."""

from collections.abc import Sequence

import numpy as np

from sysid.trust.documents import Expected

# Relative 95 % half-widths that part the verdicts.
WELL, WEAKLY = 0.1, 0.5
# The last one: under a wrong model a bound cuts the parameter or a partner, so no interval can be read.
VERDICTS = ("well", "weakly", "not_identifiable", "not_interpretable")


def verdict(half_width: float) -> str:
    """Return the verdict on a relative 95 % half-width [1]; infinite or unknown: not identifiable."""
    if half_width < WELL:
        return VERDICTS[0]
    return VERDICTS[1] if half_width < WEAKLY else VERDICTS[2]


def as_half_width(share: float) -> str:
    """Return a relative half-width as a person says it."""
    if not np.isfinite(share) or share >= 10:
        return "more than its own size"
    return f"± {100 * share:.{2 if share < 1 else 3}g} %"


def sentences(expected: Sequence[Expected]) -> tuple[str, ...]:
    """Return one sentence per parameter that is not well identifiable, and one on all others."""
    good = [row.symbol for row in expected if row.verdict == "well"]
    out = [f"well identifiable: {', '.join(good)}"] if good else ["nothing is well identifiable"]
    symbols = {row.name: row.symbol for row in expected}
    for row in expected:
        if row.verdict != "well":
            word = "weakly identifiable" if row.verdict == "weakly" else "not identifiable"
            partners = " and ".join(symbols.get(partner.name, partner.name) for partner in row.partners[:2])
            correlated = f"; it correlates with {partners}" if partners else ""
            name = row.name.partition("[")[0].replace("_", " ")
            out.append(f"{name} ({row.symbol}) is {word}: {as_half_width(row.worse)}{correlated}")
    return tuple(out)
