"""Two fits' parameters: do they differ by more than their intervals allow?"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

from sysid.parameter_sets import ParameterSets

# Standard normal beyond which 5 % lie.
_NORMAL_95 = 1.959964


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
    the fits' errors are independent. Values that both hold fixed are not compared.
    """
    out = []
    for a, b in combinations(range(len(sets)), 2):
        # What belongs to a trial alone is not compared.
        first, second = (
            {r.name: i for i, r in enumerate(sets[k].parameters) if r.status == "free" and not r.trial}
            for k in (a, b)
        )
        for name in [name for name in first if name in second]:
            record = sets[a].parameters[first[name]]
            rows = [_row(documents[k], name) for k in (a, b)]
            pair = [float(sets[a].values[0, first[name]]), float(sets[b].values[0, second[name]])]
            by = "spread of the sets"
            if all(row is not None for row in rows):
                by = "profile intervals"
                pair = [float(row["refined"]) for row in rows if row is not None]
            reach = [
                _reach(sets[k], row if by == "profile intervals" else None, name, facing)
                for k, row, facing in ((a, rows[0], pair[1] > pair[0]), (b, rows[1], pair[0] > pair[1]))
            ]
            allowed = math.hypot(*reach)
            distance = abs(pair[1] - pair[0])
            doubt = _doubt((names[a], names[b]), rows, reach)
            differs = bool(distance > allowed) if doubt is None else None
            share = (pair[1] - pair[0]) / pair[0] if pair[0] else math.nan
            unit = "" if record.unit == "1" else f" {record.unit}"
            sentence = (
                f"{record.symbol} differs: {pair[0]:.4g}{unit} in {names[a]}, {pair[1]:.4g}{unit} in "
                f"{names[b]} ({100 * share:+.1f} %; {by} allow ± {allowed:.2g}{unit})"
            )
            out.append({
                "parameter": name, "symbol": record.symbol, "unit": record.unit, "fits": [names[a], names[b]],
                "values": pair, "difference": float(share), "allowed": float(allowed), "by": by,
                "differs": differs, "doubt": doubt, "sentence": sentence,
            })  # fmt: skip
    return out


def _row(document: Mapping[str, Any] | None, name: str) -> Mapping[str, Any] | None:
    if document is None:
        return None
    return next((row for row in document["parameters"] if row["name"] == name), None)


def _doubt(
    names: Sequence[str], rows: Sequence[Mapping[str, Any] | None], reach: Sequence[float]
) -> str | None:
    """Return why nothing can be said of a difference; None where it can."""
    lacking = [name for name, row in zip(names, rows, strict=True) if row is None]
    if lacking:
        return f"no intervals: run sysid trust on {' and '.join(dict.fromkeys(lacking))}"
    for name, row in zip(names, rows, strict=True):
        if row is not None and row.get("doubt"):
            return f"{name}: {row['doubt']}"
    opened = [name for name, far in zip(names, reach, strict=True) if not math.isfinite(far)]
    return f"the interval is open in {' and '.join(opened)}" if opened else None


def unjudged(differences: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return one sentence per reason why differences are not judged, with the parameters it holds for."""
    why: dict[str, list[str]] = {}
    for row in differences:
        if row["doubt"]:
            why.setdefault(row["doubt"], []).append(row["symbol"])
    return [f"not judged: {', '.join(dict.fromkeys(of))} ({reason})" for reason, of in why.items()]


def _reach(sets: ParameterSets, row: Mapping[str, Any] | None, name: str, up: bool) -> float:
    """Return how far a value may be off on one side, at 95 %."""
    if row is None:
        sigma = float(sets.sigma[sets.names.index(name)])
        return _NORMAL_95 * sigma if math.isfinite(sigma) else math.inf
    side = 1 if up else 0
    if row["open_95"][side]:
        return math.inf
    away = row["interval_95"][side] - row["refined"]
    return max(0.0, away if up else -away)
