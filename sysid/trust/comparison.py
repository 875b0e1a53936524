"""Two fits' parameters: do they differ by more than their intervals allow?"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

from sysid.parameter_sets import ParameterSets
from sysid.parameters import with_unit
from sysid.trust.linearized import NORMAL_95


def compare_values(
    names: Sequence[str], sets: Sequence[ParameterSets], documents: Sequence[Mapping[str, Any] | None]
) -> list[dict[str, Any]]:
    """Return the difference of every free parameter that two fits share.

    Parameters
    ----------
    names : sequence of str
        Of the fits.
    documents : sequence of mapping or None
        ``trust`` of each (`sysid.trust.documents`): intervals; None: only the spread of the sets is known,
        which judges nothing (runs that reach one optimum agree whatever the data leave open).

    Returns
    -------
    list of dict
        ``parameter``, ``symbol``, ``unit``, ``fits`` (two names), ``values`` (where the sum of squares is
        least, which the intervals lie around; else of the best set), ``difference`` (relative to the first),
        ``allowed`` (half-width of the difference's 95 % interval [unit]), ``by`` ("profile intervals" or
        "spread of the sets"), ``differs`` (true, false; null where an interval is open or doubtful, or there
        is none), ``doubt`` (why null, or null), ``sentence``.

    Notes
    -----
    The half-widths of the two intervals, on the sides that face each other, add as the root of their squares:
    the fits' errors are independent. Values that neither fit has found are not compared.
    """
    out = []
    for pair in combinations(range(len(sets)), 2):
        fits = [names[k] for k in pair]
        # A parameter of a single trial is not compared.
        first, second = (
            {r.name: i for i, r in enumerate(sets[k].parameters) if r.status == "free" and not r.trial}
            for k in pair
        )
        for name in [name for name in first if name in second]:
            record = sets[pair[0]].parameters[first[name]]
            rows = [_row(documents[k], name) for k in pair]
            if all(rows):
                by, values = "profile intervals", [float(row["refined"]) for row in rows if row]
            else:
                columns = zip(pair, (first[name], second[name]), strict=True)
                by, values = "spread of the sets", [float(sets[k].values[0, i]) for k, i in columns]
            reach = [
                _reach(sets[k], row if all(rows) else None, name, value < other)
                for k, row, value, other in zip(pair, rows, values, values[::-1], strict=True)
            ]
            allowed, distance = math.hypot(*reach), values[1] - values[0]
            doubt = _doubt(fits, rows, reach)
            share = distance / values[0] if values[0] else math.nan
            texts = [with_unit(f"{value:.4g}", record.unit) for value in values]
            sentence = (
                f"{record.symbol} differs: {texts[0]} in {fits[0]}, {texts[1]} in {fits[1]} "
                f"({100 * share:+.1f} %; {by} allow ± {with_unit(f'{allowed:.2g}', record.unit)})"
            )
            out.append({
                "parameter": name, "symbol": record.symbol, "unit": record.unit, "fits": fits,
                "values": values, "difference": share, "allowed": allowed, "by": by,
                "differs": abs(distance) > allowed if doubt is None else None, "doubt": doubt,
                "sentence": sentence,
            })  # fmt: skip
    return out


def _row(document: Mapping[str, Any] | None, name: str) -> Mapping[str, Any] | None:
    if document is None:
        return None
    return next((row for row in document["parameters"] if row["name"] == name), None)


def _doubt(
    names: Sequence[str], rows: Sequence[Mapping[str, Any] | None], reach: Sequence[float]
) -> str | None:
    """Return why a difference cannot be judged; None where it can."""
    lacking = [name for name, row in zip(names, rows, strict=True) if row is None]
    if lacking:
        return f"no intervals: run sysid trust on {' and '.join(dict.fromkeys(lacking))}"
    for name, row in zip(names, rows, strict=True):
        if row is not None and row.get("doubt"):
            return f"{name}: {row['doubt']}"
    opened = [name for name, far in zip(names, reach, strict=True) if not math.isfinite(far)]
    return f"the interval is open in {' and '.join(opened)}" if opened else None


def unjudged(differences: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return one sentence per reason why differences are not judged, with the parameters concerned."""
    why: dict[str, list[str]] = {}
    for row in differences:
        if row["doubt"]:
            why.setdefault(row["doubt"], []).append(row["symbol"])
    return [f"not judged: {', '.join(dict.fromkeys(of))} ({reason})" for reason, of in why.items()]


def _reach(sets: ParameterSets, row: Mapping[str, Any] | None, name: str, up: bool) -> float:
    """Return how far a value may be off on one side, at 95 %."""
    if row is None:
        sigma = float(sets.sigma[sets.names.index(name)])
        return NORMAL_95 * sigma if math.isfinite(sigma) else math.inf
    side = 1 if up else 0
    if row["open_95"][side]:
        return math.inf
    away = row["interval_95"][side] - row["refined"]
    return max(0.0, away if up else -away)
