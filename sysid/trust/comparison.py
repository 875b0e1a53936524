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
    names: Sequence[str],
    sets: Sequence[ParameterSets],
    documents: Sequence[Mapping[str, Any] | None],
) -> list[dict[str, Any]]:
    """Return the difference of every free parameter that two fits share.

    Parameters
    ----------
    names : sequence of str
        Of the fits.
    sets : sequence of ParameterSets
    documents : sequence of mapping or None
        ``trust`` of each (`sysid.trust.store`): intervals; None: the spread of the sets stands in.

    Returns
    -------
    list of dict
        ``parameter``, ``symbol``, ``unit``, ``fits`` (two names), ``values``, ``difference`` (relative to the
        first), ``allowed`` (half-width of the difference's 95 % interval [unit]), ``by`` ("profile intervals"
        or "spread of the sets"), ``differs`` (true, false; null where an interval is open or nothing is
        known), ``sentence``.

    Notes
    -----
    The half-widths of the two intervals, on the sides that face each other, add as the root of their squares:
    the fits' errors are independent. Values that both hold fixed are not compared.
    """
    out = []
    for a, b in combinations(range(len(sets)), 2):
        first = {r.name: i for i, r in enumerate(sets[a].parameters) if r.status == "free"}
        second = {r.name: i for i, r in enumerate(sets[b].parameters) if r.status == "free"}
        for name in [name for name in first if name in second and "[" not in name]:
            record = sets[a].parameters[first[name]]
            pair = (sets[a].values[0, first[name]], sets[b].values[0, second[name]])
            reach = [
                _reach(sets[k], documents[k], name, facing)
                for k, facing in ((a, pair[1] > pair[0]), (b, pair[0] > pair[1]))
            ]
            allowed = math.hypot(*(one[0] for one in reach))
            by = "profile intervals" if all(one[1] for one in reach) else "spread of the sets"
            distance = abs(pair[1] - pair[0])
            known = math.isfinite(allowed)
            differs = bool(distance > allowed) if known else None
            share = (pair[1] - pair[0]) / pair[0] if pair[0] else math.nan
            unit = "" if record.unit == "1" else f" {record.unit}"
            sentence = (
                f"{record.symbol} differs: {pair[0]:.4g}{unit} in {names[a]}, {pair[1]:.4g}{unit} in "
                f"{names[b]} "
                f"({100 * share:+.1f} %; {by} allow ± {allowed:.2g}{unit})"
            )
            out.append(
                {
                    "parameter": name,
                    "symbol": record.symbol,
                    "unit": record.unit,
                    "fits": [names[a], names[b]],
                    "values": [float(pair[0]), float(pair[1])],
                    "difference": float(share),
                    "allowed": float(allowed),
                    "by": by,
                    "differs": differs,
                    "sentence": sentence,
                }
            )
    return out


def _reach(
    sets: ParameterSets, document: Mapping[str, Any] | None, name: str, up: bool
) -> tuple[float, bool]:
    """Return how far a value may be off on one side, at 95 %, and whether a profile says so."""
    if document is not None:
        row = next((one for one in document["parameters"] if one["name"] == name), None)
        if row is not None:
            side = 1 if up else 0
            if row["open_95"][side]:
                return math.inf, True
            return abs(row["interval_95"][side] - row["value"]), True
    sigma = float(sets.sigma[sets.names.index(name)])
    return (_NORMAL_95 * sigma if math.isfinite(sigma) else math.inf), False
