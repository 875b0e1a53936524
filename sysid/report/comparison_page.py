"""A page of two or more fits: parameters side by side, who predicts whom, traces overlaid."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain

import numpy as np
from matplotlib.figure import Figure

from sysid.documents import channel_symbol, rounded
from sysid.fit.result import FitResult
from sysid.parameter_sets import ParameterSets
from sysid.report.answer import answer_box
from sysid.report.drawing import RUNS, as_math, as_words, panel, percent_text, unit_of
from sysid.report.html import (
    NOTHING,
    Html,
    bullets,
    columns,
    heading,
    markup_table,
    page,
    paragraph,
    picture,
    unfoldable,
)
from sysid.report.plots import SERIES, Curve, Panel, View, interactive, printed
from sysid.report.table import NONE, Cell, Table, name_and_unit, numbers, table, words
from sysid.report.trust_tables import comparison_table, cross_table, judged_cell, known_table
from sysid.trust.comparison import Comparison
from sysid.trust.documents import TrustDocument
from sysid.types import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class OverlaidTrial:
    """A trial as compared, (n, C) over (n,) [s], and what each fit's best set predicts.

    `predicted` are (m,) [s] and (m, C) by fit: a fit of another law may have other instants.
    """

    name: str
    time: FloatArray
    measured: FloatArray
    valid: BoolArray
    predicted: dict[str, tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, eq=False)
class ComparedFit:
    """A fit that is compared: its sets under the name of the comparison, its intervals, its trials."""

    sets: ParameterSets
    trust: TrustDocument | None
    fit: FitResult
    trials: Sequence[OverlaidTrial]


def comparison_page(document: Comparison, fits: Sequence[ComparedFit]) -> str:
    """Return the page of a comparison, `document` as from `sysid.workflows.compare`."""
    names = document.fits
    table = markup_table(_parameter_table(document, fits))
    scattered = _intervals_figure(document, fits)
    drawn = NOTHING
    if scattered is not None:
        alternative = f"95 % intervals of {', '.join(names)}, parameter by parameter, off the first value"
        drawn = picture(scattered, alternative, "95 % intervals; 0: the value of the first fit.")
    out = _answer(document, names)
    if document.warnings:
        count = len(document.warnings)
        out += unfoldable(f"{count} warning{'s' * (count > 1)}", bullets(document.warnings, "warnings"))
    if (known := known_table(document)) is not None:
        out += heading("Known values") + markup_table(known)
    out += heading("Parameters") + table
    every = markup_table(comparison_table(document))
    out += unfoldable("Every difference and what the intervals allow", every, printed=False)
    crossed = heading("Who predicts whom") + markup_table(cross_table(document))
    out += columns(crossed, heading("Intervals") + drawn if drawn.text else drawn)
    out += heading("Traces")
    views = [[_view(fit, trial) for trial in fit.trials] for fit in fits]
    if overlaid := list(chain.from_iterable(views)):
        # Paper has one trial of each fit.
        static = printed([each[0] for each in views if each])
        out += interactive(overlaid, "traces of all fits", static, noun="trial")
    else:
        out += paragraph("No trials are in these fits.", "note")
    return page(f"sysid: {' and '.join(names)}", out)


def _answer(document: Comparison, names: Sequence[str]) -> Html:
    rows = document.differences
    differ = [row for row in rows if row.differs]
    judged = [row for row in rows if row.differs is not None]
    word = Cell("they differ", "bad") if differ else Cell("no difference shown", "good")
    following = "one value may serve for all fits where their intervals agree: see the table."
    if not judged:
        word = Cell("not judged", "doubtful")
        following = "run `sysid trust` on every fit: without intervals no difference is judged."
    elif differ:
        symbols = ", ".join(dict.fromkeys(row.symbol for row in differ))
        following = f"ask why {symbols} changed: another drone, surface or supply, or a model that lacks it."
        if document.known:
            following = (
                f"the fits take different values as known, listed below, which may be why {symbols} differ."
            )
    tiles = [
        (f"{len(differ)} of {len(judged)}", "differences are more than the 95 % intervals explain"),
        (str(len(rows) - len(judged)), "differences cannot be judged: an interval is open or missing"),
    ]
    cross = np.asarray(document.cross)
    for j, name in enumerate(names):
        best = int(np.argmin(cross[:, j]))
        tiles.append(
            (percent_text(float(cross[best, j])), f"trials of {name}, best predicted by {names[best]}")
        )
    box = answer_box("Fits compared", word, " · ".join(names), tiles, following, NOTHING)
    return box + unfoldable("In sentences", bullets(document.sentences))


def _parameter_table(document: Comparison, fits: Sequence[ComparedFit]) -> Table:
    """Return value, interval and verdict of every fit side by side, and what the intervals do not explain."""
    assessed = [fit.trust.by_name if fit.trust else {} for fit in fits]
    known = [fit.sets.known for fit in fits]
    free = [{name: row for name, row in rows.items() if row.record.status == "free"} for rows in known]
    records = {name: row.record for rows in free for name, row in rows.items() if not row.record.trial}

    def value(k: int, name: str) -> str:
        row, found = assessed[k].get(name), known[k].get(name)
        if found is None or found.instead:
            return NONE
        return rounded(row.refined if row else found.values[0])

    def span(k: int, name: str) -> Cell:
        if name not in free[k]:
            return Cell("not free")
        row = free[k][name].judged
        short = "not" if row and row.lost else row and row.verdict
        return Cell(f"{row.interval}, {short}", judged_cell(row).tone) if row else Cell(NONE)

    def differs(name: str) -> Cell:
        rows = [row for row in document.differences if row.parameter == name]
        real = [row for row in rows if row.differs]
        if real:
            pairs = (f"{' / '.join(row.fits)} {100 * row.difference:+.1f} %" for row in real)
            return Cell(f"differs: {'; '.join(pairs)}", "bad")
        return Cell("not judged" if any(row.differs is None for row in rows) else "no" if rows else NONE)

    shown = [
        words("symbol", lambda name: name_and_unit(records[name].symbol or name, records[name].unit)),
        words("name", lambda name: name.replace("_", " ")),
        # Differences are the purpose of the page: their column comes first, where no width cuts it off.
        words("difference", differs),
    ]
    for k, fit in enumerate(fits):
        shown.append(numbers(fit.sets.name, partial(value, k)))
        shown.append(words("95 %, identifiable", partial(span, k)))
    note = "values: where the sum of squares is least; differs: by more than the 95 % intervals explain"
    return table("", list(records), shown, note)


def _intervals_figure(document: Comparison, fits: Sequence[ComparedFit]) -> Figure | None:
    """Draw every interval off the first fit's value [%]; None where fewer than two fits have intervals."""
    known = [fit.trust.by_name if fit.trust else {} for fit in fits]
    names = [
        name for name, row in known[0].items() if row.refined and any(name in other for other in known[1:])
    ]
    if not names:
        return None
    figure, axes = panel(0.9 + 0.17 * len(names) * (len(fits) + 0.6))
    # Open intervals end at the picture's edge; a parameter off by factors may not squeeze the others.
    reach = 1.0
    for r, name in enumerate(names):
        base = known[0][name].refined
        for k, rows in enumerate(known):
            if name not in rows:
                continue
            row, colour = rows[name], RUNS[k % len(RUNS)]
            ends = [100 * (end / base - 1) for end in row.interval_95]
            middle, y = 100 * (row.refined / base - 1), -r + 0.25 - 0.5 * k / max(len(fits) - 1, 1)
            closed = not any(row.open_95)
            axes.plot(ends, [y, y], color=colour, linewidth=2.0, linestyle="-" if closed else ":")
            axes.plot([middle], [y], "o", color=colour, markersize=4)
            if closed:
                reach = max(reach, min(100.0, max(map(abs, (*ends, middle)))))
    axes.axvline(0.0, color="0.6", linewidth=0.8)
    axes.set_xlim(-1.1 * reach, 1.1 * reach)
    axes.set_yticks(-np.arange(len(names)), [as_math(known[0][name].symbol) for name in names])
    axes.set_xlabel(f"off the value of {as_words(document.fits[0])} [%] (dotted: open)")
    for k, fit in enumerate(fits):
        axes.plot([], [], "o-", color=RUNS[k % len(RUNS)], label=as_words(fit.sets.name), markersize=4)
    figure.legend(fontsize=8, frameon=False, loc="outside upper center", ncols=min(len(fits), 3))
    axes.grid(True, axis="x", color="0.92")
    return figure


def _view(fit: ComparedFit, trial: OverlaidTrial) -> View:
    """Return the channels of a trial with every fit's prediction, and what each leaves."""
    time, panels = trial.time - trial.time[0], []
    for c in (c for c in range(trial.measured.shape[1]) if trial.valid[:, c].any()):
        unit, factor = unit_of(fit.fit, c)
        measured = factor * np.where(trial.valid[:, c], trial.measured[:, c], np.nan)
        curves = [Curve("measured", measured, "ink", "dots" if len(time) <= 400 else "line")]
        errors = []
        for k, (name, (instants, signals)) in enumerate(trial.predicted.items()):
            values = factor * signals[:, c]
            if len(instants) != len(time):
                values = np.interp(time, instants - instants[0], values, left=math.nan, right=math.nan)
            colour = SERIES[k % len(SERIES)]
            curves.append(Curve(f"best set of {name}", values, colour))
            errors.append(Curve(f"residual of {name}", values - measured, colour, "thin"))
        name = channel_symbol(fit.fit.channels[c])
        panels += [Panel(name, unit, curves), Panel(f"residuals of {name}", unit, errors, low=True)]
    return View(f"{fit.sets.name}: {trial.name}", f"{trial.name} of {fit.sets.name}", time, panels)
