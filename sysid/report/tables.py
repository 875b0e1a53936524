"""Tables of ranked parameter sets for a terminal: the sets, the layout of Table II, NRMSE per trial.

Every cell is plain text to rich: a unit in brackets is no markup.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from rich import box
from rich.table import Table
from rich.text import Text

from sysid.export.mean_table import mean_sigma, mean_table, plain
from sysid.parameter_sets import COMBINATIONS, ParameterRecord, ParameterSets, in_place_of_digits

_AT_BOUND = "*"
_FLAG = "* ends within 1 % of a bound of the search"
_NONE = "—"
_SPREAD = "σ is the spread of the runs, not the accuracy; it includes runs that ended elsewhere"
_NOISE = "the NRMSE of a velocity (ẋ_B, ż_B) is mostly noise: velocities are differentiated positions"
_UNFIXED = "†"
# Channels whose symbol is another than their name.
_SYMBOLS = {"x_B_rate": "ẋ_B", "z_B_rate": "ż_B", "stator_torque": "stator torque"}


def ranked_table(sets: ParameterSets, unfixed: Sequence[str] = ()) -> Table:
    """Return the ranked sets side by side: NRMSE, run, and every free parameter [SI].

    Parameters
    ----------
    sets : ParameterSets
        Best first.
    unfixed : sequence of str
        Parameters that the data do not fix: their values are printed with one digit, and marked.
    """
    shown = _shown(sets)
    flagged = bool(np.any(sets.at_bound[:, shown]))
    count = "one set" if len(sets) == 1 else f"{len(sets)} sets, best first"
    notes = [_FLAG] if flagged else []
    if any(sets.names[column] in unfixed for column in shown):
        notes.append(f"{_UNFIXED} not fixed by the data: no digits")
    table = _table(f"{sets.name}: {count}", "\n".join(notes) or None)
    table.add_column("parameter")
    for rank in range(1, len(sets) + 1):
        table.add_column(f"set {rank}", justify="right")
    table.add_row(_cell("NRMSE fitted", bold=True), *(_cell(_percent(v), bold=True) for v in sets.nrmse))
    validated = _mean_over(sets, "validate")
    if np.any(np.isfinite(validated)):
        table.add_row(_cell("NRMSE validated"), *(_cell(_percent(value)) for value in validated))
    if any(sets.runs):
        table.add_row(_cell("run"), *(_cell(str(run) if run else _NONE) for run in sets.runs))
    table.add_section()
    for column in shown:
        loose = sets.names[column] in unfixed
        cells = []
        for s in range(len(sets)):
            bound = bool(sets.at_bound[s, column])
            text = in_place_of_digits(sets.settings, sets.names[column])
            if text is None:
                text = plain(sets.values[s, column], 1 if loose else 4) + (_AT_BOUND if bound else "")
            cells.append(_cell(text, style="yellow" if bound else ""))
        heading = _heading(sets.parameters[column]) + (f" {_UNFIXED}" if loose else "")
        table.add_row(_cell(heading), *cells)
    return table


def mean_sigma_table(*fits: ParameterSets, unfixed: Sequence[str] = ()) -> Table:
    """Return mean ± σ over the sets of one or more fits, in the layout of the paper's Table II.

    Parameters
    ----------
    *fits : ParameterSets
        One column each, of one kind; measured values, independent ranges and bounds stand beside them.
    unfixed : sequence of str
        Parameters that the data do not fix: said instead of digits.

    Notes
    -----
    σ is divided by S − 1. A parameter of which any set ends at a bound is flagged.
    """
    flags = [_flagged(sets) for sets in fits]
    caption = _SPREAD + (f"\n{_FLAG} in at least one set" if any(flags) else "")
    table = _table("measured and identified parameters (mean ± σ of the sets)", caption)
    table.add_column("parameter")
    # The fits first: a phone shows the left of a table.
    for sets in fits:
        table.add_column(_cell(sets.name), justify="right")
    for title in ("measured", "bounds"):
        table.add_column(title)
    for row in mean_table(*fits):
        record = next(r for sets in fits for r in sets.parameters if r.name == row.name)
        bounds = _NONE
        free = [r for sets in fits for r in sets.parameters if r.name == row.name and r.status == "free"]
        if free and free[0].lower is not None and free[0].upper is not None:
            bounds = f"{plain(free[0].lower)} to {plain(free[0].upper)}"
        # A range of no width is one value.
        ends = dict.fromkeys(map(plain, row.measured))
        measured = " to ".join(ends) or _NONE
        cells = [
            _cell(
                in_place_of_digits(own.settings, row.name)
                or ("not fixed" if row.name in unfixed and cell is not None else None)
                or mean_sigma(cell) + (_AT_BOUND if row.name in flag else ""),
                style="yellow" if row.name in flag else "",
            )
            for own, cell, flag in zip(fits, row.fitted, flags, strict=True)
        ]
        table.add_row(_cell(_heading(record)), *cells, _cell(measured), _cell(bounds))
    return table


def trial_table(sets: ParameterSets) -> Table:
    """Return the NRMSE of the best set per trial and channel, and the mean of the worst set on each.

    Parameters
    ----------
    sets : ParameterSets
        With trials; a row per trial.
    """
    velocities = any(channel.endswith("_rate") for channel in sets.channels)
    table = _table(f"{sets.name}: NRMSE of the best set [%]", _NOISE if velocities else None)
    table.add_column("trial")
    table.add_column("use")
    for channel in sets.channels:
        table.add_column(_cell(channel_symbol(channel)), justify="right")
    table.add_column("mean", justify="right")
    table.add_column("worst set, mean", justify="right")
    means = _trial_means(sets)
    for t, (trial, use) in enumerate(zip(sets.trials, sets.uses, strict=True)):
        if t and use != sets.uses[t - 1]:
            table.add_section()
        best = sets.nrmse_by_trial[0, t] if len(sets) else np.full(len(sets.channels), np.nan)
        mean, worst = (means[0, t], means[:, t].max()) if len(sets) else (math.nan, math.nan)
        table.add_row(
            _cell(trial),
            _cell(use),
            *(_cell(_number(value)) for value in best),
            _cell(_number(mean), bold=True),
            _cell(_number(worst)),
        )
    return table


def ladder_table(sets: ParameterSets) -> Table:
    """Return what each step of the model buys: NRMSE by group of trials and rung; a row per group.

    Parameters
    ----------
    sets : ParameterSets
        Whose settings hold a ``ladder``.
    """
    rungs = sets.settings["ladder"]
    groups = list(dict.fromkeys(group for rung in rungs for group in rung["nrmse"]))
    table = _table(
        f"{sets.name}: what each step of the model buys, NRMSE [%] of "
        f"{' / '.join(map(channel_symbol, sets.channels))}",
        "judge by the held-out rows: a parameter is not real because a search returned it",
    )
    table.add_column("trials")
    for rung in rungs:
        table.add_column(_cell(rung["rung"]), justify="right")
    for group in groups:
        cells = []
        for rung in rungs:
            found = rung["nrmse"].get(group)
            cells.append(_cell(" / ".join(_number(found[c]) for c in sets.channels) if found else _NONE))
        table.add_row(_cell(group), *cells)
    return table


def channel_symbol(channel: str) -> str:
    """Return how a compared channel is called in tables: ``ẋ_B`` for ``x_B_rate``."""
    return _SYMBOLS.get(channel, channel)


def _table(title: str, caption: str | None) -> Table:
    return Table(
        title=Text(title),
        caption=Text(caption) if caption else None,
        title_justify="left",
        caption_justify="left",
        header_style="bold",
        # No vertical rules: the five sets of eight parameters fit into 80 columns.
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )


def _shown(sets: ParameterSets) -> list[int]:
    """Return the columns of the free parameters and of what they fix together; else of all measured ones."""
    combined = sets.settings.get(COMBINATIONS, ())
    free = [i for i, r in enumerate(sets.parameters) if r.status == "free" or r.name in combined]
    return free or [i for i, record in enumerate(sets.parameters) if record.status == "measured"]


def _flagged(sets: ParameterSets) -> set[str]:
    return {sets.names[i] for i in np.flatnonzero(np.any(sets.at_bound != 0, axis=0))}


def _trial_means(sets: ParameterSets) -> np.ndarray:
    """Return (S, T): weighted mean over the channels [1]."""
    weights = np.asarray(sets.channel_weights, dtype=np.float64)
    used = weights > 0
    if not used.any():
        return np.full((len(sets), len(sets.trials)), np.nan)
    return np.asarray(sets.nrmse_by_trial[:, :, used] @ (weights[used] / weights[used].sum()))


def _mean_over(sets: ParameterSets, use: str) -> np.ndarray:
    chosen = [t for t, one in enumerate(sets.uses) if one == use]
    if not chosen:
        return np.full(len(sets), np.nan)
    return np.asarray(_trial_means(sets)[:, chosen].mean(axis=1))


def _heading(record: ParameterRecord) -> str:
    return record.symbol if record.unit in ("", "1") else f"{record.symbol} [{record.unit}]"


def _cell(text: str, *, bold: bool = False, style: str = "") -> Text:
    return Text(text, style="bold" if bold else style)


def _percent(value: float) -> str:
    return f"{100 * value:.2f} %" if math.isfinite(value) else _NONE


def _number(value: float) -> str:
    return f"{100 * value:.2f}" if math.isfinite(value) else _NONE
