"""What trials say of the values that their campaign states: what each became, which are contradicted.

Near the best set a stated value lies p standard errors from what is stated, and the trials leave open the
share v of its stated variance. Were the value not stated, it would move on by ``p v/(1 - v)``, and the
deviance would fall by ``p²/(1 - v)``, which follows chi-square with one degree of freedom where the statement
is right (both exact for a linear model). A value whose fall no chance explains is taken out, and the others
are judged again without it: one wrong value pulls others along.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from sysid.journal import Finding
from sysid.parameters import SearchSpace, common_name, with_unit
from sysid.trust.documents import StatedValue
from sysid.trust.linearized import Linearized
from sysid.types import FloatArray

# Chance that any value of a right campaign is contradicted [1].
_CHANCE = 0.02
# Deviance by which another value may explain the trials worse and still be named beside the first one.
_AS_WELL = 6.0
# Largest share of a stated variance that trials leave open of a value that they can contradict [1].
_UNSEEN = 0.98


@dataclass(frozen=True, eq=False)
class _Judged:
    """Stated values in standard errors: their pulls (S,) and covariance (S, S) as fitted."""

    pulls: FloatArray
    covariance: FloatArray

    @property
    def gains(self) -> FloatArray:
        """(S,) falls of the deviance were the value not stated."""
        left = 1.0 - np.diag(self.covariance)
        return np.where(left > 1.0 - _UNSEEN, self.pulls**2 / np.maximum(left, 1.0 - _UNSEEN), 0.0)

    def without(self, i: int) -> _Judged:
        """Return the same were value i not stated."""
        column, left = self.covariance[:, i], 1.0 - self.covariance[i, i]
        return _Judged(
            self.pulls + column * self.pulls[i] / left, self.covariance + np.outer(column, column) / left
        )


def stated_values(space: SearchSpace, linear: Linearized) -> list[StatedValue]:
    """Return what became of every stated value, and which of them the trials contradict."""
    count = len(space.stated)
    if not count:
        return []
    rows = space.free[-count:]
    errors = np.array([value.error for value in space.stated.values()])
    reach = np.array([row.upper - row.lower for row in rows]) / errors
    pulls = space.pulls(space.full(linear.point[None]))[0]
    covariance = linear.information.covariance[-count:, -count:] * np.outer(reach, reach)
    # Nothing is known worse than it is stated.
    size = np.maximum(np.sqrt(np.diag(covariance)), 1.0)
    judged = _Judged(pulls, covariance / np.outer(size, size))
    first, limit = judged, float(chi2.isf(_CHANCE / count, 1))
    wrong: dict[int, list[int]] = {}
    while len(wrong) < count:
        gains = judged.gains
        gains[list(wrong)] = 0.0
        worst = int(np.argmax(gains))
        if gains[worst] <= limit:
            break
        near = np.flatnonzero((gains > gains[worst] - _AS_WELL) & (gains > limit))
        wrong[worst] = [int(j) for j in near if j != worst]
        judged = judged.without(worst)
    out = []
    for i, (row, (name, value)) in enumerate(zip(rows, space.stated.items(), strict=True)):
        free = judged if i in wrong else first
        asked = first.without(i) if i in {j for others in wrong.values() for j in others} - {*wrong} else free
        deviation = float(np.sqrt(free.covariance[i, i]) * value.error)
        out.append(
            StatedValue(
                name=name, symbol=row.symbol, unit=row.unit, stated=float(value), error=value.error,
                fitted=float(value + pulls[i] * value.error), sigma=deviation, pull=float(pulls[i]),
                gain=float(first.gains[i]), contradicted=i in wrong,
                asked=float(value + asked.pulls[i] * value.error),
                partners=[rows[j].name for j in wrong.get(i, ())],
            )
        )  # fmt: skip
    return out


def contradictions(rows: Sequence[StatedValue], space: SearchSpace) -> list[Finding]:
    """Return a finding for every value that the trials contradict, the worst first."""
    by_name, out = {row.name: row for row in rows}, []
    trials = {row.name: row.trial for row in space.free}
    for row in sorted(rows, key=lambda row: -row.gain):
        if not row.contradicted:
            continue
        others = [by_name[name] for name in row.partners]
        instead = ", ".join(f"{one.name} = {_shown(one, one.asked)}" for one in others)
        sentence = (
            f"the trials ask for {row.name} = {_shown(row, row.asked, row.sigma)}, the campaign states "
            f"{_shown(row, row.stated, row.error)} ({abs(row.asked - row.stated) / row.error:.0f} standard "
            "errors): measure it again" + (f" ({instead} would do the same)" if instead else "")
        )
        name = common_name(next(one for one in space.free if one.name == row.name))
        of = (trials[row.name],) if trials[row.name] else ()
        out.append(
            Finding("stated-value-contradicted", sentence, trials=of, size=row.gain, parameters=(name,))
        )
    return out


def _shown(row: StatedValue, value: float, error: float | None = None) -> str:
    """Return a value with as many digits as its error has, angles in degrees."""
    factor, unit = (180 / np.pi, "deg") if row.unit == "rad" else (1.0, row.unit)
    size = factor * (row.error if error is None else error)
    places = max(0, 1 - int(np.floor(np.log10(size)))) if size > 0 else 6
    text = f"{factor * value:.{places}f}" + ("" if error is None else f" ± {size:.{places}f}")
    return with_unit(text, unit)
