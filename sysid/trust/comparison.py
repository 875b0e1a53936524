"""Two fits' parameters: do they differ by more than their intervals allow?"""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

from sysid.documents import Part
from sysid.parameter_sets import ParameterSets
from sysid.parameters import SearchSpace, with_unit
from sysid.trust.documents import FreeParameter, TrustDocument
from sysid.trust.linearized import NORMAL_95
from sysid.types import FloatArray


class Difference(Part):
    """A free parameter that two fits share, and whether it differs."""

    parameter: str
    symbol: str
    unit: str
    # Names of the two fits.
    fits: list[str]
    # Least sums of squares, which the intervals lie around; else the best sets' [unit].
    values: list[float]
    # Second value over the first, less 1.
    difference: float
    # Half-width of the difference's 95 % interval [unit].
    allowed: float
    # "profile intervals" or "spread of the sets".
    by: str
    # None where an interval is open or doubtful, or there is none; `doubt` says why.
    differs: bool | None
    doubt: str | None
    sentence: str


class KnownValue(Part):
    """A value that fits take as known, each its own, because their campaigns state it differently."""

    parameter: str
    unit: str
    # Value in each campaign [unit]; None where the fit searched it.
    values: list[float | None]


class Comparison(Part):
    """What `sysid compare` prints as JSON."""

    # Names of the fits.
    fits: list[str]
    kind: str
    # Friction law of each fit, or what else its kind is fitted under; empty where all are alike.
    laws: list[str]
    known: list[KnownValue]
    differences: list[Difference]
    # NRMSE of every fit's best set (row) on every fit's trials (column) [1]; None where not asked.
    cross: list[list[float]] | None
    sentences: list[str]
    warnings: list[str]


def known_values(
    spaces: Sequence[SearchSpace], shifts: Sequence[Mapping[str, float]] = ()
) -> list[KnownValue]:
    """Return the known values that differ between the search spaces of fits; of single trials none.

    `shifts` are added: how far places are stated from where the first fit's campaign states them, by name.
    """
    known: list[dict[str, float]] = [{**space.fixed, **space.stated} for space in spaces]
    for each, moved in zip(known, shifts, strict=False):
        each |= {name: each[name] + way for name, way in moved.items() if name in each}
    out = []
    for name in dict.fromkeys(name for values in known for name in values if "[" not in name):
        values = [each.get(name) for each in known]
        there = [value for value in values if value is not None]
        stated = any(name in space.stated for space in spaces)
        if not all(math.isclose(value, there[0], rel_tol=1e-9) for value in there) or (
            stated and len(there) < len(values)
        ):
            unit = next(space.table[name].unit for space in spaces if name in space.table)
            out.append(KnownValue(parameter=name, unit=unit, values=[v and float(v) for v in values]))
    return out


def compare_values(
    names: Sequence[str],
    sets: Sequence[ParameterSets],
    documents: Sequence[TrustDocument | None],
    correlations: Sequence[FloatArray | None],
    shifts: Sequence[Mapping[str, float]] = (),
) -> list[Difference]:
    """Return the difference of every free parameter that two fits share; `names` are the fits'.

    The half-widths of the two intervals, on the sides that face each other, add as the root of their squares,
    less what both errors have in common: the error of a value that both campaigns state alike moves both
    fits. `correlations` (n, n) are of the free parameters and stated values of each document, `shifts` as for
    `known_values`. Without a document of intervals only the spread of the sets is known, which judges
    nothing: runs that reach one optimum agree whatever the data leave open. Values that neither fit has found
    are not compared.
    """
    known = [document.by_name if document else {} for document in documents]
    out = []
    parts = [
        _parts(document, rho, moved) if document and rho is not None else {}
        for document, rho, moved in zip(documents, correlations, shifts or [{}] * len(names), strict=True)
    ]
    for pair in combinations(range(len(sets)), 2):
        fits = [names[k] for k in pair]
        # A parameter of a single trial is not compared.
        first, second = (
            {r.name: i for i, r in enumerate(sets[k].parameters) if r.status == "free" and not r.trial}
            for k in pair
        )
        for name in [name for name in first if name in second]:
            record = sets[pair[0]].parameters[first[name]]
            rows = [known[k].get(name) for k in pair]
            judged = [row for row in rows if row is not None]
            if len(judged) == 2:
                by, values = "profile intervals", [row.refined for row in judged]
                reach = [
                    max(0.0, row.high - row.refined if value < other else row.refined - row.low)
                    for row, value, other in zip(judged, values, values[::-1], strict=True)
                ]
            else:
                columns = tuple(zip(pair, (first[name], second[name]), strict=True))
                by, values = "spread of the sets", [float(sets[k].values[0, i]) for k, i in columns]
                sigmas = [float(sets[k].sigma[i]) for k, i in columns]
                reach = [NORMAL_95 * sigma if math.isfinite(sigma) else math.inf for sigma in sigmas]
            one, other = (parts[k].get(name, {}) for k in pair)
            common = min(1.0, sum(one[value] * other[value] for value in one.keys() & other.keys()))
            allowed, distance = math.hypot(*reach), values[1] - values[0]
            if math.isfinite(allowed):
                allowed = math.sqrt(allowed**2 - 2 * common * math.prod(reach))
            doubt = _doubt(fits, rows, reach)
            # The dead band's is no interval of 95 %.
            ranges = [sets[k].judged.get(name) for k, row in zip(pair, rows, strict=True) if row is None]
            if ranges and all(documents[k] is not None for k in pair) and ranges[0] is not None:
                doubt = f"its interval is {ranges[0].doubt}, by which no difference is judged"
            share = distance / values[0] if values[0] else math.nan
            texts = [with_unit(f"{value:.4g}", record.unit) for value in values]
            sentence = (
                f"{record.symbol} differs: {texts[0]} in {fits[0]}, {texts[1]} in {fits[1]} "
                f"({100 * share:+.1f} %; {by} allow ± {with_unit(f'{allowed:.2g}', record.unit)})"
            )
            out.append(
                Difference(
                    parameter=name, symbol=record.symbol, unit=record.unit, fits=fits, values=values,
                    difference=share, allowed=allowed, by=by,
                    differs=abs(distance) > allowed if doubt is None else None, doubt=doubt,
                    sentence=sentence,
                )
            )  # fmt: skip
    return out


def _parts(
    document: TrustDocument, correlation: FloatArray, moved: Mapping[str, float]
) -> dict[str, dict[tuple[str, float, float], float]]:
    """Return the part of every parameter's error that each stated value's error makes up [1].

    A statement of one trial is of no other campaign's trial, and one that the trials contradict has let go.
    """
    count = len(document.parameters)
    return {
        row.name: {
            (value.name, value.stated + moved.get(value.name, 0.0), value.error): float(rho)
            * value.sigma
            / value.error
            for rho, value in zip(across[count:], document.stated, strict=True)
            if not (value.contradicted or value.name.endswith("]"))
        }
        for row, across in zip(document.parameters, correlation, strict=False)
    }


def _doubt(names: Sequence[str], rows: Sequence[FreeParameter | None], reach: Sequence[float]) -> str | None:
    """Return why a difference cannot be judged; None where it can."""
    lacking = [name for name, row in zip(names, rows, strict=True) if row is None]
    if lacking:
        return f"no intervals: run sysid trust on {' and '.join(dict.fromkeys(lacking))}"
    for name, row in zip(names, rows, strict=True):
        if row is not None and row.doubt:
            return f"{name}: {row.doubt}"
    opened = [name for name, far in zip(names, reach, strict=True) if not math.isfinite(far)]
    return f"the interval is open in {' and '.join(opened)}" if opened else None


def unjudged(differences: Sequence[Difference]) -> list[str]:
    """Return one sentence per reason why differences are not judged, with the parameters concerned."""
    why: dict[str, list[str]] = {}
    for row in differences:
        if row.doubt:
            why.setdefault(row.doubt, []).append(row.symbol)
    return [f"not judged: {', '.join(dict.fromkeys(of))} ({reason})" for reason, of in why.items()]
