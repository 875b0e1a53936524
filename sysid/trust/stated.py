"""What trials say of the values that their campaign states: what each became, which are contradicted.

Were a value not stated, the trials would ask for one that lies q standard errors from what is stated, with
the variance c (both exact for a linear model, the second by the sandwich of `sysid.trust.linearized`, because
a fit weights its channels unlike their noise). The deviance would fall by ``q²/(1 + c)``, which follows
chi-square with one degree of freedom where the statement is right. A value whose fall no chance explains is
taken out, and the others are judged again without it: one wrong value pulls others along.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from sysid.journal import Finding
from sysid.parameters import FROM_STATED, SearchSpace, common_name, loosened, with_unit
from sysid.trust.documents import StatedValue
from sysid.trust.linearized import Linearized, bounded_information, half_widths
from sysid.trust.verdicts import WEAKLY, as_half_width
from sysid.types import FloatArray

# Chance that any value of a right campaign is contradicted [1].
_CHANCE = 0.02
# Deviance by which another value may explain the trials worse and still be named beside the first one.
_AS_WELL = 6.0
# Difference of two falls of the deviance that tells nothing.
_ALIKE = 1.0
# Least correlation with a stated value that makes up half of a variance, and least error of that value after
# the fit, over the stated one, with which the statement decides and not the trials [1].
_HALF, _AS_STATED = 0.707, 0.7
# Factor by which a better instrument may divide an error, the half-width over the former one from which on
# that is worth saying, and how many parameters are named [1].
_BETTER, _GAINS, _NAMED = 4.0, 0.9, 3
# Variance from which on trials cannot contradict a value [squared standard errors].
_UNSEEN = 50.0


@dataclass(frozen=True, eq=False)
class _Judged:
    """Stated values near the minimum of a fit, in standard errors: some of them, by place, are not stated."""

    # (S,) distances from what is stated.
    pulls: FloatArray
    # (n, n) curvature and noise of the gradient over all free parameters, in units of `size`.
    curvature: FloatArray
    noise: FloatArray
    # (n,) root of the curvature [1/unit cube]; (S,) range of the rows [standard errors].
    size: FloatArray
    reach: FloatArray
    # (S,) what the residual of each distance is multiplied by.
    weights: FloatArray

    @classmethod
    def of(cls, space: SearchSpace, linear: Linearized) -> _Judged:
        """Return what is stated in a space at its minimum; a parameter at a bound does not move.

        A statement beyond three standard errors hardly pulls (`SearchSpace.misses`). Here it first gets the
        pull of a square: only then do values that explain the trials equally well look alike.
        """
        count = len(space.stated)
        errors = np.array([value.error for value in space.stated.values()])
        reach = np.array([row.upper - row.lower for row in space.free[-count:]]) / errors
        moves = space.at_bound(linear.point) == 0
        moves[-count:] = True
        pulls, weights = space.pulls(space.full(linear.point[None]))[0], linear.scale[-count:]
        residuals, slopes = loosened(pulls)
        columns = linear.jacobian.values[:, moves].copy()
        columns[-count:, -count:] = np.diag(weights * reach)
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        columns /= size
        own = columns[-count:]
        noise = linear.information.gradient_noise[np.ix_(moves, moves)] / np.outer(size, size)
        noise = noise + own.T * (weights**2 * (1 - slopes**4)) @ own
        judged = cls(pulls, columns.T @ columns, noise, size, reach, weights)
        back = judged._inverse @ own.T @ (weights * (pulls - slopes * residuals))
        return replace(judged, pulls=pulls - back[-count:] * reach / size[-count:])

    @property
    def _inverse(self) -> FloatArray:
        return np.asarray(np.linalg.pinv(self.curvature, rcond=1e-12, hermitian=True))

    @property
    def sigma(self) -> FloatArray:
        """(S,) standard deviations of the values as fitted; nothing is known worse than it is stated."""
        return np.minimum(np.sqrt(self._variances), 1.0)

    @property
    def _variances(self) -> FloatArray:
        count, inverse = len(self.pulls), self._inverse
        spread = np.diag(inverse @ self.noise @ inverse)[-count:]
        return np.asarray(spread * (self.reach / self.size[-count:]) ** 2)

    @property
    def gains(self) -> FloatArray:
        """(S,) falls of the deviance were the value not stated."""
        out = np.zeros(len(self.pulls))
        for i in range(len(out)):
            free = self.without(i)
            spread = free._variances[i]
            if spread < _UNSEEN:
                out[i] = free.pulls[i] ** 2 / (1.0 + spread)
        return out

    def without(self, i: int) -> _Judged:
        """Return the same were value i not stated."""
        count = len(self.pulls)
        row = np.zeros(len(self.size))
        row[i - count] = self.weights[i] * self.reach[i] / self.size[i - count]
        outer = np.outer(row, row)
        free = replace(
            self, curvature=self.curvature - outer, noise=self.noise - outer * self.weights[i] ** 2
        )
        move = free._inverse @ row * (self.weights[i] * self.pulls[i])
        return replace(free, pulls=self.pulls + move[-count:] * self.reach / self.size[-count:])


def stated_values(space: SearchSpace, linear: Linearized) -> list[StatedValue]:
    """Return what became of every stated value, and which of them the trials contradict."""
    count = len(space.stated)
    if not count:
        return []
    rows = space.free[-count:]
    first = judged = _Judged.of(space, linear)
    pulls = space.pulls(space.full(linear.point[None]))[0]
    falls, limit = first.gains, float(chi2.isf(_CHANCE / count, 1))
    wrong: dict[int, list[int]] = {}
    while len(wrong) < count:
        gains = judged.gains
        gains[list(wrong)] = 0.0
        worst = int(np.argmax(gains))
        if gains[worst] <= limit:
            break
        near = np.flatnonzero((gains > gains[worst] - _AS_WELL) & (gains > limit))
        # Several values may explain the trials equally well: the one with the smallest error comes first.
        alike = near[gains[near] > gains[worst] - _ALIKE]
        worst = int(min(alike, key=lambda i: abs(judged.without(i).pulls[i])))
        wrong[worst] = [int(j) for j in near if j != worst]
        judged = judged.without(worst)
    out = []
    for i, (row, (name, value)) in enumerate(zip(rows, space.stated.items(), strict=True)):
        free = judged if i in wrong else first
        asked = first.without(i) if i in {j for others in wrong.values() for j in others} - {*wrong} else free
        deviation = float((free.sigma if i not in wrong else np.sqrt(free._variances))[i] * value.error)
        out.append(
            StatedValue(
                name=name, symbol=row.symbol, unit=row.unit, stated=float(value), error=value.error,
                fitted=float(value + pulls[i] * value.error), sigma=deviation, pull=float(pulls[i]),
                gain=float(falls[i]), contradicted=i in wrong,
                asked=float(value + asked.pulls[i] * value.error),
                partners=[rows[j].name for j in wrong.get(i, ())],
            )
        )  # fmt: skip
    return out


def deciding(space: SearchSpace, linear: Linearized) -> list[str | None]:
    """Return for every found parameter the stated value whose error makes up most of its variance."""
    count, found = len(space.stated), len(space.found)
    if not count:
        return [None] * found
    rows, size = space.free[found:], linear.information.sigma[found:]
    errors = np.array([value.error for value in space.stated.values()])
    rho = np.abs(linear.information.correlation[:found, found:])
    rho[:, size * [row.upper - row.lower for row in rows] < _AS_STATED * errors] = 0.0
    return [rows[int(np.argmax(row))].name if row.max() > _HALF else None for row in rho]


def better_measured(
    space: SearchSpace, linear: Linearized, keys: Mapping[str, str] | None = None
) -> list[str]:
    """Return sentences on whose error decides the half-widths of the found parameters, the worst first.

    `keys` are the campaign's names of rows by common name, where they differ.
    """
    groups: dict[str, list[int]] = {}
    count, found = len(space.stated), len(space.found)
    for i, row in enumerate(space.free[found:]):
        groups.setdefault((keys or {}).get(common_name(row), common_name(row)), []).append(i)
    before = linear.half_widths[:found]
    seen = [i for i in range(found) if before[i] < WEAKLY]
    gains: list[tuple[float, str]] = []
    idle: list[str] = []
    for key, rows in groups.items():
        jacobian, noise = linear.jacobian.values.copy(), linear.information.gradient_noise.copy()
        for i in rows:
            own = jacobian[i - count]
            noise += (_BETTER**2 - 1) * np.outer(own, own) * linear.scale[i - count] ** 2
            jacobian[i - count] = _BETTER * own
        sigma = bounded_information(jacobian, noise, linear.point).sigma
        ratios = half_widths(space, linear.point, sigma)[:found] / before
        best = sorted((float(ratios[i]), i) for i in seen if ratios[i] < _GAINS)
        if not best:
            idle.append(key)
            continue
        text = ", ".join(
            f"{space.found[i].symbol} {as_half_width(before[i])} -> {as_half_width(before[i] * ratio)}"
            for ratio, i in best[:_NAMED]
        )
        gains.append((best[0][0], f"{key} ({text})"))
    out = []
    if gains:
        worth = "; ".join(text for _, text in sorted(gains))
        out.append(f"measured four times better, these stated values tell more: {worth}")
    if idle and seen:
        out.append(f"measured better, these tell nothing more: {', '.join(idle)}")
    return out


def contradictions(
    rows: Sequence[StatedValue], space: SearchSpace, falls: str, instead: Sequence[str] = ()
) -> list[Finding]:
    """Return a finding for every value that the trials contradict, the worst first.

    `falls` says how the misfit falls once the values are what the trials ask for; what else would do that,
    `instead` of the first value, is outside of the campaign.
    """
    by_name, out = {row.name: row for row in rows}, list[Finding]()
    it = "it" if sum(row.contradicted for row in rows) == 1 else "all that they ask for"
    parameters = {row.name: row for row in space.free}
    for row in sorted(rows, key=lambda row: -row.gain):
        if not row.contradicted:
            continue
        others = (by_name[name] for name in row.partners)
        alike = [f"{one.name} = {_shown(one, one.asked)}" for one in others] + [*(instead if not out else ())]
        parameter = parameters[row.name]
        states = f", the campaign states {_shown(row, row.stated, row.error)}"
        if parameter.group == FROM_STATED:
            meaning = parameter.meaning[:1].lower() + parameter.meaning[1:].rstrip(".")
            states = f" ({meaning}), which is good to {_shown(row, row.error)}"
        sentence = (
            f"the trials ask for {row.name} = {_shown(row, row.asked, row.sigma)}{states} "
            f"({abs(row.asked - row.stated) / row.error:.0f} standard errors): with {it} {falls}"
            "; measure it again" + (f" ({', '.join(alike)} would do the same)" if alike else "")
        )
        of, names = (parameter.trial,) if parameter.trial else (), (common_name(parameter),)
        out.append(Finding("stated-value-contradicted", sentence, trials=of, size=row.gain, parameters=names))
    return out


def _shown(row: StatedValue, value: float, error: float | None = None) -> str:
    """Return a value with as many digits as its error has, angles in degrees."""
    factor, unit = (180 / np.pi, "deg") if row.unit == "rad" else (1.0, row.unit)
    size = factor * (row.error if error is None else error)
    places = max(0, 1 - int(np.floor(np.log10(size)))) if size > 0 else 6
    text = f"{factor * value:.{places}f}" + ("" if error is None else f" ± {size:.{places}f}")
    return with_unit(text, unit)
