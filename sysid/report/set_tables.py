"""Tables of ranked parameter sets: the sets, the layout of Table II, NRMSE per trial."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from sysid.documents import channel_symbol, rounded
from sysid.parameter_sets import (
    COMBINATIONS,
    NEAR_BEST,
    Judged,
    ParameterRecord,
    ParameterSets,
    in_place_of_digits,
)
from sysid.report.table import (
    NONE,
    Cell,
    Table,
    Tone,
    listed,
    mean_sigma,
    name_and_unit,
    numbers,
    percent,
    table,
    words,
)
from sysid.types import FloatArray

_AT_BOUND, _UNFIXED = "*", "†"
_FLAG = f"{_AT_BOUND} ends within 1 % of a bound of the search"
_SPREAD = "σ is the spread of the runs, not the accuracy; it includes runs that ended elsewhere"
_NOISE = "the NRMSE of a velocity (ẋ_B, ż_B) is mostly noise: velocities are differentiated positions"
# Channels whose symbol is another than their name.


def ranked_table(sets: ParameterSets, unfixed: Sequence[str] = ()) -> Table:
    """Return the ranked sets side by side, best first: NRMSE, run, and every free parameter [SI].

    The values of `unfixed` parameters, which the data do not determine, have one digit and a mark.
    """
    searched = [i for i, record in enumerate(sets.parameters) if _is_found(sets, record)]
    shown = searched or [i for i, record in enumerate(sets.parameters) if record.status == "measured"]
    rows = [_scores("NRMSE fitted", sets.nrmse, "strong")]
    if judged := sets.provenance.get("adequacy"):
        rows.append(_scores("noise alone", np.full(len(sets), judged["floor"])))
    held_out = [t for t, use in enumerate(sets.uses) if use == "validate"]
    validated = _trial_means(sets)[:, held_out].mean(axis=1) if held_out else np.full(len(sets), np.nan)
    if np.any(np.isfinite(validated)):
        rows.append(_scores("NRMSE validated", validated))
    if any(sets.runs):
        rows.append([Cell("run"), *(Cell(str(run) if run else NONE) for run in sets.runs)])
    above = len(rows)
    for column in shown:
        loose = sets.names[column] in unfixed
        record = sets.parameters[column]
        heading = name_and_unit(record.symbol, record.unit) + (f" {_UNFIXED}" if loose else "")
        rows.append([Cell(heading), *(_value(sets, s, column, loose) for s in range(len(sets)))])
    digits = [i for i in shown if in_place_of_digits(sets.settings, sets.names[i]) is None]
    notes = [_FLAG] if np.any(sets.at_bound[:, digits]) else []
    if any(sets.names[column] in unfixed for column in shown):
        notes.append(f"{_UNFIXED} not identifiable: no digits")
    count = "one set" if len(sets) == 1 else f"{len(sets)} sets, best first"
    heads = ("parameter", *(f"set {rank}" for rank in range(1, len(sets) + 1)))
    return listed(f"{sets.name}: {count}", rows, heads, "\n".join(notes), {above})


def _scores(what: str, values: FloatArray, tone: Tone = "") -> list[Cell]:
    shares = (percent(value) + (" %" if np.isfinite(value) else "") for value in values)
    return [Cell(text, tone) for text in (what, *shares)]


def _value(sets: ParameterSets, s: int, column: int, loose: bool) -> Cell:
    bound = bool(sets.at_bound[s, column])
    text = in_place_of_digits(sets.settings, sets.names[column])
    if text is None:
        text = rounded(sets.values[s, column], 1 if loose else 4) + (_AT_BOUND if bound else "")
    return Cell(text, "doubtful" if bound else "")


@dataclass(frozen=True)
class MeanRow:
    """One row of Table II: what was measured (nothing, one value, or a range), and (mean, σ) by fit [unit].

    A fit that did not search the parameter has None.
    """

    record: ParameterRecord
    measured: tuple[float, ...]
    fitted: tuple[tuple[float, float] | None, ...]


def mean_table(*fits: ParameterSets) -> tuple[MeanRow, ...]:
    """Return the rows of Table II for fits of one kind: what at least one of them found or measured.

    σ is divided by S - 1.
    """
    records: dict[str, ParameterRecord] = {}
    for sets in fits:
        for record in sets.parameters:
            if record.status == "measured" or _is_found(sets, record):
                records.setdefault(record.name, record)
    return tuple(_mean_row(record, fits) for record in records.values())


def _mean_row(record: ParameterRecord, fits: Sequence[ParameterSets]) -> MeanRow:
    measured: tuple[float, ...] = ()
    fitted: list[tuple[float, float] | None] = [None] * len(fits)
    for k, sets in enumerate(fits):
        if record.name not in sets.names:
            continue
        i = sets.names.index(record.name)
        column, mean = sets.parameters[i], float(sets.mean[i])
        if _is_found(sets, column):
            fitted[k] = (mean, float(sets.sigma[i]))
            measured = measured or (column.measured_range or ())
        elif column.status == "measured":
            measured = (mean,)
    return MeanRow(record, measured, tuple(fitted))


def mean_sigma_table(*fits: ParameterSets, unfixed: Sequence[str] = ()) -> Table:
    """Return mean ± σ over the sets of fits of one kind, in the layout of the paper's Table II.

    Each fit has a column; further columns are measured values, independent ranges and bounds. "Not
    identifiable" replaces the digits of `unfixed` parameters. A parameter of which any set ends at a bound is
    flagged.
    """
    flags = [{sets.names[i] for i in np.flatnonzero(np.any(sets.at_bound != 0, axis=0))} for sets in fits]
    # Words in place of digits carry no mark.
    marked = any(
        name not in unfixed and in_place_of_digits(sets.settings, name) is None
        for sets, names in zip(fits, flags, strict=True)
        for name in names
    )
    notes = [_SPREAD] if any(np.any(np.nan_to_num(sets.sigma, posinf=0.0) > 0) for sets in fits) else []
    left_out = sum(int(np.count_nonzero(~sets.counted)) for sets in fits)
    notes += (
        [f"{left_out} of the sets left out: cut short above {NEAR_BEST:g} × best NRMSE"] if left_out else []
    )
    notes += [f"{_FLAG} in at least one set"] if marked else []

    def fitted(k: int, row: MeanRow) -> Cell:
        cell, name = row.fitted[k], row.record.name
        text = in_place_of_digits(fits[k].settings, name)
        if text is None and name in unfixed and cell is not None:
            text = "not identifiable"
        flagged = name in flags[k]
        return Cell(text or mean_sigma(cell) + (_AT_BOUND if flagged else ""), "doubtful" if flagged else "")

    def bounds(row: MeanRow) -> str:
        every = (r for sets in fits for r in sets.parameters if r.name == row.record.name)
        free = next((r for r in every if r.status == "free"), None)
        if free is None or free.lower is None or free.upper is None:
            return NONE
        return f"{rounded(free.lower)} to {rounded(free.upper)}"

    known = fits[0].judged if len(fits) == 1 else {}

    def certain(text: Callable[[Judged], str]) -> Callable[[MeanRow], str]:
        return lambda row: text(known[row.record.name]) if row.record.name in known else NONE

    judged = (
        numbers("95 % interval", certain(lambda found: found.interval)),
        words("verdict", certain(lambda found: found.verdict.replace("_", " "))),
    )
    return table(
        "measured and identified parameters (mean ± σ of the sets)",
        mean_table(*fits),
        (
            words("parameter", lambda row: name_and_unit(row.record.symbol, row.record.unit)),
            # The fits first: a phone shows the left of a table.
            *(numbers(sets.name, partial(fitted, k)) for k, sets in enumerate(fits)),
            *(judged if known else ()),
            # A range of no width is one value.
            words("measured", lambda row: " to ".join(dict.fromkeys(map(rounded, row.measured))) or NONE),
            words("bounds", bounds),
        ),
        "\n".join(notes),
    )


def trial_table(sets: ParameterSets) -> Table:
    """Return the NRMSE [%] of the best set per trial and channel, and the mean of the worst set on each."""
    scores = zip(sets.nrmse_by_trial[0], _trial_means(sets).T, strict=True)
    rows: list[tuple[str | Cell, ...]] = [
        (trial, use, *map(percent, best), Cell(percent(mean[0]), "strong"), percent(mean.max()))
        for trial, use, (best, mean) in zip(sets.trials, sets.uses, scores, strict=True)
    ]
    return listed(
        f"{sets.name}: NRMSE of the best set [%]",
        rows,
        ("trial", "use", *map(channel_symbol, sets.channels), "mean", "worst set, mean"),
        _NOISE if any(channel.endswith("_rate") for channel in sets.channels) else "",
        (t for t in range(1, len(sets.uses)) if sets.uses[t] != sets.uses[t - 1]),
        texts=2,
    )


def adequacy_table(sets: ParameterSets) -> Table:
    """Return the residuals of the best set over the noise floor, per trial and channel, and what lasts."""
    judged = sets.provenance["adequacy"]
    channels = judged["channels"]

    def ratio(value: float) -> Cell:
        low, high = judged["limits"].values()
        return Cell(f"{value:.2f}", "good" if value <= low else "doubtful" if value <= high else "bad")

    rows: list[tuple[str | Cell, ...]] = [
        (trial, *(ratio(row["by_trial"][trial]) for row in channels)) for trial in channels[0]["by_trial"]
    ]
    rows.append(("all", *(ratio(row["ratio"]) for row in channels)))
    rows.append(("autocorrelation", *(f"{row['autocorrelation']:.2f}" for row in channels)))
    return listed(
        f"{sets.name}: residual of the best set over the noise",
        rows,
        ("trial", *(channel_symbol(row["name"]) for row in channels)),
        "1: noise alone, after what errors of known values explain; autocorrelation: of the residuals, where "
        "the noise has none",
        {len(rows) - 2},
    )


def truth_table(sets: ParameterSets, truth: Mapping[str, float]) -> Table:
    """Return what the best set of a synthetic campaign found, and its interval, beside the `truth` [SI]."""
    intervals = sets.judged

    def found(i: int) -> str:
        return in_place_of_digits(sets.settings, sets.names[i]) or rounded(sets.values[0, i])

    def off(i: int) -> str:
        name = sets.names[i]
        known = truth[name] and in_place_of_digits(sets.settings, name) is None
        return percent(sets.values[0, i] / truth[name] - 1, 1) if known else NONE

    def inside(i: int) -> str | Cell:
        if sets.names[i] not in intervals:
            return NONE
        inside = intervals[sets.names[i]].contains(truth[sets.names[i]])
        return "yes" if inside else Cell("no", "doubtful")

    def within(i: int) -> str:
        return intervals[sets.names[i]].interval if sets.names[i] in intervals else NONE

    return table(
        f"{sets.name}: found against true",
        [i for i, record in enumerate(sets.parameters) if _is_found(sets, record) and record.name in truth],
        (
            words("parameter", lambda i: name_and_unit(sets.parameters[i].symbol, sets.parameters[i].unit)),
            numbers("true", lambda i: rounded(truth[sets.names[i]])),
            numbers("found", found),
            numbers("off", off, "%"),
            numbers("95 % interval", within),
            words("inside", inside),
        ),
    )


def _is_found(sets: ParameterSets, record: ParameterRecord) -> bool:
    """Whether the search found a number, by itself or as a combination of others."""
    return record.status == "free" or record.name in sets.settings.get(COMBINATIONS, ())


def _trial_means(sets: ParameterSets) -> FloatArray:
    """Return (S, T): weighted mean over the channels [1]."""
    weights = np.asarray(sets.channel_weights, dtype=np.float64)
    used = weights > 0
    if not used.any():
        return np.full((len(sets), len(sets.trials)), np.nan)
    return np.asarray(sets.nrmse_by_trial[:, :, used] @ (weights[used] / weights[used].sum()))
