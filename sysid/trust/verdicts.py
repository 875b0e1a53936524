"""Verdicts in words: well, weakly, or not identifiable; and the sentences that go with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# Relative 95 % half-widths that part the verdicts.
WELL, WEAKLY = 0.1, 0.5
# Key of a fit's provenance: what its trials were expected to fix.
EXPECTED = "expected"
VERDICTS = ("well", "weakly", "not identifiable")


def verdict(half_width: float) -> str:
    """Return the verdict on a relative 95 % half-width [1]; infinite or unknown: not identifiable."""
    if half_width < WELL:
        return VERDICTS[0]
    return VERDICTS[1] if half_width < WEAKLY else VERDICTS[2]


@dataclass(frozen=True)
class Expected:
    """What the trials of a campaign are expected to fix of one parameter, before a fit.

    Parameters
    ----------
    value : float
        At which it is judged [unit].
    half_width : float
        Relative 95 % half-width there [1].
    half_width_over_bounds : float
        Median over points drawn from the bounds [1]; NaN where none could be simulated.
    effect, interaction : float
        Mean size of the elementary effects on the NRMSE over the bounds, and their standard deviation
        (Morris 1991) [1]; NaN where not computed.
    partners : tuple of (name, correlation)
        What it trades with.
    """

    name: str
    symbol: str
    unit: str
    value: float
    half_width: float
    half_width_over_bounds: float
    effect: float
    interaction: float
    partners: tuple[tuple[str, float], ...]

    @property
    def verdict(self) -> str:
        """The verdict at the value where it is judged."""
        return verdict(self.half_width)

    def document(self) -> dict[str, object]:
        """Return it for JSON."""
        partners = [{"name": name, "correlation": rho} for name, rho in self.partners]
        return vars(self) | {"partners": partners, "verdict": self.verdict}


def percent(share: float) -> str:
    """Return a relative half-width as a person says it."""
    if not np.isfinite(share) or share >= 10:
        return "more than its own size"
    return f"± {100 * share:.2g} %"


def sentences(expected: Sequence[Expected]) -> tuple[str, ...]:
    """Return one sentence per parameter that the trials do not fix well, and one on all others."""
    good = [row.symbol for row in expected if row.verdict == "well"]
    out = [f"well identifiable: {', '.join(good)}"] if good else ["nothing is well identifiable"]
    for row in expected:
        if row.verdict == "well":
            continue
        word = "weakly identifiable" if row.verdict == "weakly" else "not identifiable"
        partners = " and ".join(name for name, _ in row.partners[:2])
        trades = f"; trades with {partners}" if partners else ""
        out.append(f"{row.symbol} ({row.name}) is {word}: {percent(row.half_width)}{trades}")
    return tuple(out)
