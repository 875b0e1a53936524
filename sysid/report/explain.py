"""An explanation as tables, a picture, and what to conclude of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from sysid.documents import rounded
from sysid.fit.adequacy import EXPLAINED_BY
from sysid.parameters import with_unit
from sysid.report.drawing import panel
from sysid.report.table import NONE, Cell, Table, number, numbers, percent, table, words
from sysid.trust.documents import ExplainDocument, LadderRung, Suspect, TrustDocument

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Least relative move of a parameter that the table of moves names [1].
_LEAST = 0.01
# Number of moves that the table names of one term, the largest first.
_MOST = 4


# A line of the table, with its words.
_Row = tuple[str, LadderRung | Suspect]


def _rows(document: ExplainDocument) -> list[tuple[str, LadderRung]]:
    """Return every rung with its words: simpler models, the base, each term alone, then those kept."""
    rows = [(rung.terms[0], rung) for rung in document.simpler]
    rows.append(("as fitted", document.base))
    rows += [(rung.terms[0], rung) for rung in sorted(document.alone, key=_misfit)]
    kept = [rung for rung in document.together if rung.kept]
    return rows + [(f"{'… and' if k else 'kept:'} {rung.terms[-1]}", rung) for k, rung in enumerate(kept)]


def _misfit(rung: LadderRung) -> float:
    """Return the mean misfit of what was left out, over noise [1]; a gain is the share that it falls."""
    return float(np.exp(np.mean(np.log(rung.misfit))))


def _gain(rung: LadderRung) -> str:
    """Return the share that a term takes off the misfit [%]."""
    return percent(float(-np.expm1(-rung.gain)), 1)


def _chance(rung: LadderRung) -> str:
    return "< 0.001" if rung.chance < 1e-3 else number(rung.chance, 2)


def _left_out(document: ExplainDocument, count: str = "each") -> str:
    """Return what was left out in turn, as in ``each trial`` or ``9 parts of trials``."""
    several = "" if count == "each" else "s"
    if document.parts:
        return f"{count} part{several} of {'trials' if several else 'a trial'}"
    return f"{count} trial{several}"


def _changes(document: ExplainDocument, rung: LadderRung, lost: set[str]) -> dict[str, str]:
    """Return the values of the terms and how far the parameters go that are not `lost`, by name."""
    symbols, values, before = document.symbols, rung.values, document.base.values
    new = {
        name: f"{symbols[name]} {with_unit(rounded(value, 3), document.units[name])}"
        for name, value in values.items()
        if name not in before
    }
    # A name that ends in brackets is a number of one trial alone.
    known = [name for name in before if before[name] and name in values and name not in lost]
    moved = {name: values[name] / before[name] - 1 for name in known if not name.endswith("]")}
    far = sorted((name for name in moved if abs(moved[name]) >= _LEAST), key=lambda name: -abs(moved[name]))
    return new | {name: f"{symbols[name]} {100 * moved[name]:+.0f} %" for name in far[:_MOST]}


def _in_words(one: Suspect) -> str:
    """Return what is changed: values of which nothing is stated, a mistake undone, a trial left out."""
    names = " and ".join(one.names)
    as_stated = "nothing: as stated, within its errors"
    changes = {"value": f"{names} not stated", "swap": f"with {names}", "trial": f"without {names}"}
    return changes.get(one.what, as_stated)


def rungs_table(document: ExplainDocument) -> Table:
    """Return what stated values and single trials explain, and what each term buys on what was left out."""
    base = document.base

    def left_out(row: _Row, text: Callable[[LadderRung], str]) -> str:
        return NONE if isinstance(row[1], Suspect) else text(row[1])

    def kept(row: _Row) -> Cell:
        rung = row[1]
        if isinstance(rung, Suspect):
            return Cell("accused", "bad") if rung.sentences else Cell("no" if rung.names else "")
        if rung is base:
            return Cell("")
        if rung in document.simpler:
            return Cell("too simple" if rung.kept else "as good", "" if rung.kept else "doubtful")
        return Cell("yes", "good") if rung.kept else Cell("no")

    chances = ["of a term alone, that its gain is luck"]
    # A term that is kept because of its gain alone has the chance of that gain.
    if document.keep and document.together[-1] not in document.alone:
        chances.append("of a kept one, that its value beside the others is none but for luck")
    simpler = "; of a simpler model: of the fit's model over it" if document.simpler else ""
    return table(
        "What is wrong in the campaign, and missing in the model",
        [*((_in_words(one), one) for one in document.suspects), *_rows(document)],
        (
            words("changed", lambda row: row[0]),
            numbers("NRMSE, fitted", lambda row: number(row[1].over_noise, 3)),
            numbers("misfit, left out", lambda row: left_out(row, lambda rung: number(_misfit(rung), 3))),
            numbers("gain", lambda row: left_out(row, _gain), "%"),
            numbers("chance", lambda row: left_out(row, _chance)),
            words("keep", kept),
        ),
        "NRMSE, misfit: over noise; misfit: root mean square over the channels, of "
        f"{_left_out(document)} as the fit of the others predicts it, and mean over all; gain: the share of "
        f"it that goes; chance: {'; '.join(chances)}, for all terms looked at{simpler}; "
        "keep: whether the term belongs into the model, and what is accused",
    )  # fmt: skip


def moves_table(document: ExplainDocument, trust: TrustDocument | None = None) -> Table:
    """Return the values of every term, and how the parameters move with it.

    Parameters that `trust`, the intervals of the fit, calls not identifiable may move as they like.
    """
    lost = {row.name for row in trust.parameters if row.lost} if trust else set()
    rows = [
        (what, _changes(document, rung, lost)) for what, rung in _rows(document) if rung is not document.base
    ]
    shown = dict.fromkeys(name for _, changes in rows for name in changes)
    meanings = (
        f"{document.symbols[name]}: {document.meanings[name].rstrip('.')}"
        for name in shown
        if name in document.meanings
    )
    return table(
        "Values of the terms, and how the parameters move with them",
        rows,
        (words("term", lambda row: row[0]), words("values, moves", lambda row: ", ".join(row[1].values()))),
        "; ".join(["moves: of identifiable parameters, 1 % and more; the four largest", *meanings]),
    )


def figure_rungs(document: ExplainDocument) -> Figure:
    """Draw misfit over noise of what was left out, each as the fit of the others predicts it, and NRMSE."""
    rows = _rows(document)
    figure, axes = panel(0.8 + 0.32 * len(rows))
    place = np.arange(len(rows))[::-1]
    for y, (_, rung) in zip(place, rows, strict=True):
        axes.plot(rung.misfit, np.full(len(rung.misfit), y), "|", color="0.6", markersize=8)
        axes.plot(_misfit(rung), y, "o", color="#0072B2")
        axes.plot(rung.over_noise, y, "o", color="#D55E00", fillstyle="none")
    axes.axvline(1.0, color="0.3", linewidth=0.8, linestyle=":")
    axes.set_yticks(place, [words for words, _ in rows])
    figure.supxlabel(
        f"over noise: misfit of {_left_out(document)} left out (bars),\n"
        "its mean (dot), and NRMSE of the fit (ring)",
        fontsize="medium",
    )
    return figure


def conclusion(document: ExplainDocument) -> list[str]:
    """Return what is accused, which terms to keep, or why none, and what the model still lacks."""
    accused = [sentence for one in document.suspects for sentence in one.sentences]
    if accused and not document.together:
        return [*accused, "noise explains the rest: no physics is missing"]
    return [*accused, *_of_physics(document)]


def _of_physics(document: ExplainDocument) -> list[str]:
    """Return which terms to keep, or why none, what the model still lacks, and what no trial needs."""
    keep, judged = document.keep, document.adequacy
    worst = judged.misfit
    lacks = (
        f"the model still lacks something: {judged.ratio:.2f} × the noise is left that no error of the "
        f"measured inputs explains, {worst.channel_ratio:.2f} × in {worst.channel}"
    )
    lacking = [] if judged.verdict == EXPLAINED_BY else [lacks]
    needless = [
        f"{rung.terms[0]} predicts what was left out as well: do not believe the fitted "
        + ", ".join(document.symbols[name] for name in document.base.values if name not in rung.values)
        for rung in document.simpler
        if not rung.kept
    ]
    if keep:
        return [f"keep {', '.join(keep)}", *lacking, *needless]
    if not lacking:
        return [
            "noise explains the fit, and no term is both certain beside the others and of use for what was "
            "left out: keep the model",
            *needless,
        ]
    nearest = document.together[0]
    return [
        f"{_left_out(document, str(len(document.trials)))} cannot show which term is missing; the nearest "
        f"is {nearest.terms[-1]}, with a chance of {_chance(nearest)} and a gain of "
        f"{_gain(nearest)} %",
        *lacking,
        "fit more trials, unlike these, and explain again",
        *needless,
    ]
