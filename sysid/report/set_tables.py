"""Tables of ranked parameter sets: the sets, the layout of Table II, NRMSE per trial, the model ladder."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np

from sysid.export.mean_table import MeanRow, mean_sigma, mean_table, plain
from sysid.parameter_sets import COMBINATIONS, ParameterRecord, ParameterSets, in_place_of_digits
from sysid.report.table import NONE, Cell, Table, Tone, numbers, percent, table, with_unit, words
from sysid.types import FloatArray

_AT_BOUND, _UNFIXED = "*", "†"
_FLAG = f"{_AT_BOUND} ends within 1 % of a bound of the search"
_SPREAD = "σ is the spread of the runs, not the accuracy; it includes runs that ended elsewhere"
_NOISE = "the NRMSE of a velocity (ẋ_B, ż_B) is mostly noise: velocities are differentiated positions"
# Channels whose symbol is another than their name.
_SYMBOLS = {"x_B_rate": "ẋ_B", "z_B_rate": "ż_B", "stator_torque": "stator torque"}


def ranked_table(sets: ParameterSets, unfixed: Sequence[str] = ()) -> Table:
    """Return the ranked sets side by side, best first: NRMSE, run, and every free parameter [SI].

    The values of `unfixed` parameters, which the data do not fix, are printed with one digit, and marked.
    """
    shown = _shown(sets)
    rows = [_scores("NRMSE fitted", sets.nrmse, "strong")]
    validated = _mean_over(sets, "validate")
    if np.any(np.isfinite(validated)):
        rows.append(_scores("NRMSE validated", validated))
    if any(sets.runs):
        rows.append([Cell("run"), *(Cell(str(run) if run else NONE) for run in sets.runs)])
    above = len(rows)
    for column in shown:
        loose = sets.names[column] in unfixed
        heading = _heading(sets.parameters[column]) + (f" {_UNFIXED}" if loose else "")
        rows.append([Cell(heading), *(_value(sets, s, column, loose) for s in range(len(sets)))])
    notes = [_FLAG] if np.any(sets.at_bound[:, shown]) else []
    if any(sets.names[column] in unfixed for column in shown):
        notes.append(f"{_UNFIXED} not fixed by the data: no digits")
    count = "one set" if len(sets) == 1 else f"{len(sets)} sets, best first"
    columns = [numbers(f"set {rank}", itemgetter(rank)) for rank in range(1, len(sets) + 1)]
    columns.insert(0, words("parameter", itemgetter(0)))
    return table(f"{sets.name}: {count}", rows, columns, "\n".join(notes), {above})


def _scores(what: str, values: FloatArray, tone: Tone = "") -> list[Cell]:
    shares = (percent(value) + (" %" if np.isfinite(value) else "") for value in values)
    return [Cell(text, tone) for text in (what, *shares)]


def _value(sets: ParameterSets, s: int, column: int, loose: bool) -> Cell:
    bound = bool(sets.at_bound[s, column])
    text = in_place_of_digits(sets.settings, sets.names[column])
    if text is None:
        text = plain(sets.values[s, column], 1 if loose else 4) + (_AT_BOUND if bound else "")
    return Cell(text, "doubtful" if bound else "")


def mean_sigma_table(*fits: ParameterSets, unfixed: Sequence[str] = ()) -> Table:
    """Return mean ± σ over the sets of fits of one kind, in the layout of the paper's Table II.

    Each fit has a column; measured values, independent ranges and bounds stand beside them. "Not fixed"
    replaces the digits of `unfixed` parameters, which the data do not fix. σ is divided by S − 1. A parameter
    of which any set ends at a bound is flagged.
    """
    flags = [{sets.names[i] for i in np.flatnonzero(np.any(sets.at_bound != 0, axis=0))} for sets in fits]

    def record(row: MeanRow, *status: str) -> ParameterRecord | None:
        every = (r for sets in fits for r in sets.parameters if r.name == row.name)
        return next((r for r in every if not status or r.status in status), None)

    def fitted(k: int, row: MeanRow) -> Cell:
        cell, flagged = row.fitted[k], row.name in flags[k]
        text = in_place_of_digits(fits[k].settings, row.name)
        if text is None and row.name in unfixed and cell is not None:
            text = "not fixed"
        return Cell(text or mean_sigma(cell) + (_AT_BOUND if flagged else ""), "doubtful" if flagged else "")

    def bounds(row: MeanRow) -> str:
        free = record(row, "free")
        if free is None or free.lower is None or free.upper is None:
            return NONE
        return f"{plain(free.lower)} to {plain(free.upper)}"

    return table(
        "measured and identified parameters (mean ± σ of the sets)",
        mean_table(*fits),
        (
            words("parameter", lambda row: _heading(record(row))),
            # The fits first: a phone shows the left of a table.
            *(numbers(sets.name, partial(fitted, k)) for k, sets in enumerate(fits)),
            # A range of no width is one value.
            words("measured", lambda row: " to ".join(dict.fromkeys(map(plain, row.measured))) or NONE),
            words("bounds", bounds),
        ),
        _SPREAD + (f"\n{_FLAG} in at least one set" if any(flags) else ""),
    )


def trial_table(sets: ParameterSets) -> Table:
    """Return the NRMSE [%] of the best set per trial and channel, and the mean of the worst set on each."""
    means = _trial_means(sets)
    best = sets.nrmse_by_trial[0] if len(sets) else np.full((len(sets.trials), len(sets.channels)), np.nan)
    worst = means.max(axis=0) if len(sets) else np.full(len(sets.trials), np.nan)
    mean = means[0] if len(sets) else worst

    def score(c: int, t: int) -> str:
        return percent(float(best[t, c]))

    velocities = any(channel.endswith("_rate") for channel in sets.channels)
    return table(
        f"{sets.name}: NRMSE of the best set [%]",
        range(len(sets.trials)),
        (
            words("trial", lambda t: sets.trials[t]),
            words("use", lambda t: sets.uses[t]),
            *(numbers(channel_symbol(channel), partial(score, c)) for c, channel in enumerate(sets.channels)),
            numbers("mean", lambda t: Cell(percent(mean[t]), "strong")),
            numbers("worst set, mean", lambda t: percent(worst[t])),
        ),
        _NOISE if velocities else "",
        (t for t in range(1, len(sets.uses)) if sets.uses[t] != sets.uses[t - 1]),
    )


def ladder_table(sets: ParameterSets) -> Table:
    """Return what each step of the model buys, from the ``ladder`` of a fit: NRMSE by group and rung."""
    rungs = sets.settings["ladder"]

    def score(rung: dict[str, Any], group: str) -> str:
        nrmse = rung["nrmse"].get(group)
        return " / ".join(percent(nrmse[c]) for c in sets.channels) if nrmse else NONE

    return table(
        f"{sets.name}: what each step of the model buys, NRMSE [%] of "
        f"{' / '.join(map(channel_symbol, sets.channels))}",
        dict.fromkeys(group for rung in rungs for group in rung["nrmse"]),
        (words("trials", str), *(numbers(rung["rung"], partial(score, rung)) for rung in rungs)),
        "judge by the held-out rows: a parameter is not real because a search returned it",
    )


def channel_symbol(channel: str) -> str:
    """Return what tables call a compared channel: ``ẋ_B`` for ``x_B_rate``."""
    return _SYMBOLS.get(channel, channel)


def _shown(sets: ParameterSets) -> list[int]:
    """Return the columns of the free parameters and of what they fix together; else of all measured ones."""
    combined = sets.settings.get(COMBINATIONS, ())
    free = [i for i, r in enumerate(sets.parameters) if r.status == "free" or r.name in combined]
    return free or [i for i, record in enumerate(sets.parameters) if record.status == "measured"]


def _trial_means(sets: ParameterSets) -> FloatArray:
    """Return (S, T): weighted mean over the channels [1]."""
    weights = np.asarray(sets.channel_weights, dtype=np.float64)
    used = weights > 0
    if not used.any():
        return np.full((len(sets), len(sets.trials)), np.nan)
    return np.asarray(sets.nrmse_by_trial[:, :, used] @ (weights[used] / weights[used].sum()))


def _mean_over(sets: ParameterSets, use: str) -> FloatArray:
    chosen = [t for t, trial_use in enumerate(sets.uses) if trial_use == use]
    if not chosen:
        return np.full(len(sets), np.nan)
    return np.asarray(_trial_means(sets)[:, chosen].mean(axis=1))


def _heading(record: ParameterRecord | None) -> str:
    assert record is not None
    return with_unit(record.symbol, record.unit)
