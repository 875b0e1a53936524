"""Tables of ranked parameter sets: the sets, the layout of Table II, NRMSE per trial."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from sysid.documents import channel_symbol, rounded
from sysid.parameter_sets import DRAWS, NEAR_BEST, Judged, Known, ParameterRecord, ParameterSets
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
_DRAWN = "σ is the spread of the draws: what the data leave open"
PARAMETER = words("parameter", lambda row: name_and_unit(row.record.symbol, row.record.unit))
INTERVAL = numbers("95 % interval", lambda row: row.judged.interval if row.judged else NONE)
_NOISE = "the NRMSE of a velocity (ẋ_B, ż_B) is mostly noise: velocities are differentiated positions"


def ranked_table(sets: ParameterSets, unfixed: Sequence[str] = ()) -> Table:
    """Return the ranked sets side by side, best first: NRMSE, run, and every free parameter [SI].

    The values of `unfixed` parameters, which the data do not determine, have one digit and a mark.
    """
    known = sets.known.values()
    shown = [row for row in known if row.found] or [row for row in known if row.record.status == "measured"]
    rows = [_scores("NRMSE fitted", sets.nrmse, "strong")]
    if judged := sets.provenance.get("adequacy"):
        rows.append(_scores("noise alone", np.full(len(sets), judged["floor"])))
    held_out = [t for t, use in enumerate(sets.uses) if use == "validate"]
    means = sets.over_channels(sets.nrmse_by_trial[:, held_out])
    if held_out and np.any(np.isfinite(validated := means.mean(axis=1))):
        rows.append(_scores("NRMSE validated", validated))
    if any(sets.runs):
        rows.append([Cell("run"), *(Cell(str(run) if run else NONE) for run in sets.runs)])
    above = len(rows)
    for row in shown:
        loose = row.record.name in unfixed
        heading = name_and_unit(row.record.symbol, row.record.unit) + (f" {_UNFIXED}" if loose else "")
        values = (
            Cell(row.instead or row.text(s, 1 if loose else 4), _tone(bound))
            for s, bound in enumerate(row.at_bound)
        )
        rows.append([Cell(heading), *values])
    notes = [_FLAG] if any(np.any(row.at_bound) and not row.instead for row in shown) else []
    if any(row.record.name in unfixed for row in shown):
        notes.append(f"{_UNFIXED} not identifiable: no digits")
    count = "one set" if len(sets) == 1 else f"{len(sets)} sets, best first"
    heads = ("parameter", *(f"set {rank}" for rank in range(1, len(sets) + 1)))
    return listed(f"{sets.name}: {count}", rows, heads, "\n".join(notes), {above})


def _scores(what: str, values: FloatArray, tone: Tone = "") -> list[Cell]:
    shares = (percent(value) + (" %" if np.isfinite(value) else "") for value in values)
    return [Cell(text, tone) for text in (what, *shares)]


def _tone(at_bound: object) -> Tone:
    return "doubtful" if at_bound else ""


@dataclass(frozen=True)
class MeanRow:
    """One row of Table II: what was measured (nothing, one value, or a range) [unit], what each fit found.

    A fit that did not search the parameter has None.
    """

    record: ParameterRecord
    measured: tuple[float, ...]
    fitted: tuple[Known | None, ...]

    @property
    def judged(self) -> Judged | None:
        """Interval and verdict in the first fit."""
        return self.fitted[0].judged if self.fitted[0] else None


def mean_table(*fits: ParameterSets) -> list[MeanRow]:
    """Return the rows of Table II for fits of one kind: what at least one of them found or measured."""
    known = [sets.known for sets in fits]
    rows: list[MeanRow] = []
    for name in dict.fromkeys(name for of_fit in known for name in of_fit):
        each = [of_fit.get(name) for of_fit in known]
        stated = [row for row in each if row and (row.found or row.record.status == "measured")]
        measured: tuple[float, ...] = ()
        for row in stated:
            measured = measured or (row.record.measured_range or ()) if row.found else (row.mean,)
        if stated:
            fitted = tuple(row if row and row.found else None for row in each)
            rows.append(MeanRow(stated[0].record, measured, fitted))
    return rows


def mean_sigma_table(*fits: ParameterSets, unfixed: Sequence[str] = ()) -> Table:
    """Return mean ± σ over the sets of fits of one kind, in the layout of the paper's Table II.

    Each fit has a column; further columns are measured values, independent ranges and bounds. "Not
    identifiable" replaces the digits of `unfixed` parameters. A parameter of which any set ends at a bound is
    flagged.
    """
    # Known values of several fits differ, and stand beside each other in a table of their own.
    one = len(fits) == 1
    rows = [row for row in mean_table(*fits) if one or any(row.fitted)]
    same = [sets.one_optimum for sets in fits]
    spread = any(np.any(np.nan_to_num(sets.sigma, posinf=0.0) > 0) for sets in fits)
    drawn = any(DRAWS in sets.provenance for sets in fits)
    notes = [_DRAWN if drawn else _SPREAD] if spread and not all(same) else []
    of = "draws" if drawn else "runs"
    title = f"{len(fits[0])} runs, one optimum" if all(same) else f"mean ± σ of the {of}"
    left_out = sum(int(np.count_nonzero(~sets.counted)) for sets in fits)
    if left_out:
        notes.append(f"{left_out} of the sets left out: cut short above {NEAR_BEST:g} × best NRMSE")

    def fitted(k: int, row: MeanRow) -> str | Cell:
        known = row.fitted[k]
        if known is None:
            return NONE
        # One fit has its interval beside it.
        instead = known.text() if one and known.instead else known.instead
        text = instead or ("not identifiable" if row.record.name in unfixed else "")
        bound = np.any(known.at_bound)
        # Words in place of digits carry no mark.
        of_runs = mean_sigma((known.mean, known.sigma))
        digits = (rounded(known.mean) if same[k] else of_runs) + (_AT_BOUND if bound else "")
        return Cell(text or digits, _tone(bound))

    def bounds(row: MeanRow) -> str:
        every = (known.record for known in row.fitted if known)
        free = next((record for record in every if record.status == "free"), None)
        if free is None or free.lower is None or free.upper is None:
            return NONE
        return f"{rounded(free.lower)} to {rounded(free.upper)}"

    verdict = words("verdict", lambda row: row.judged.verdict.replace("_", " ") if row.judged else NONE)
    filled = table(
        f"measured and identified parameters ({title})",
        rows,
        (
            PARAMETER,
            # The fits first: a phone shows the left of a table.
            *(numbers(sets.name, partial(fitted, k)) for k, sets in enumerate(fits)),
            *((INTERVAL, verdict) if one and fits[0].judged else ()),
            # A range of no width is one value.
            words("measured", lambda row: " to ".join(dict.fromkeys(map(rounded, row.measured))) or NONE)
            if one
            else None,
            words("bounds", bounds),
        ),
    )
    if any(_AT_BOUND in cell.text for row in filled.rows for cell in row[1 : 1 + len(fits)]):
        notes.append(f"{_FLAG} in at least one set")
    return replace(filled, caption="\n".join(notes))


def trial_table(sets: ParameterSets) -> Table:
    """Return the NRMSE [%] of the best set per trial and channel, and the mean of the worst set on each."""
    scores = zip(sets.nrmse_by_trial[0], sets.over_channels(sets.nrmse_by_trial).T, strict=True)
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
        "1: noise alone, after what errors of the measured inputs explain; "
        "autocorrelation: of one residual with the next, 0 for noise",
        {len(rows) - 2},
    )


def truth_table(sets: ParameterSets, truth: Mapping[str, float]) -> Table:
    """Return what the best set of a synthetic campaign found, and its interval, beside the `truth` [SI]."""

    def off(row: Known) -> str:
        true = truth[row.record.name]
        return percent(row.values[0] / true - 1, 1) if true and not row.instead else NONE

    def inside(row: Known) -> str | Cell:
        if row.judged is None:
            return NONE
        return "yes" if row.judged.contains(truth[row.record.name]) else Cell("no", "doubtful")

    return table(
        f"{sets.name}: found against true",
        [row for name, row in sets.known.items() if row.found and name in truth],
        (
            PARAMETER,
            numbers("true", lambda row: rounded(truth[row.record.name])),
            numbers("found", lambda row: NONE if row.instead else rounded(row.values[0])),
            numbers("off", off, "%"),
            INTERVAL,
            words("inside", inside),
        ),
    )
