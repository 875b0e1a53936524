"""A ladder as a table, a picture, and on a terminal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sysid.documents import rounded
from sysid.report.drawing import panel, save_figure
from sysid.report.fold import print_lines, print_result, print_table
from sysid.report.table import Cell, Table, listed, number

Row = Mapping[str, Any]


def _rows(document: Row) -> list[tuple[str, Row]]:
    """Return every rung with its words: simpler models, the base, each term alone, then the best together."""
    rows = [(rung["terms"][0], rung) for rung in document["simpler"]]
    rows.append(("as fitted", document["base"]))
    rows += [
        (rung["terms"][0], rung) for rung in sorted(document["alone"], key=lambda r: np.mean(r["left_out"]))
    ]
    return rows + [(f"… and {rung['terms'][-1]}", rung) for rung in document["together"][1:]]


def _changes(document: Row, rung: Row) -> str:
    """Return the values of the terms and how far the other parameters go, the two farthest."""
    symbols, values, before = document["symbols"], rung["values"], document["base"]["values"]
    new = [f"{symbols[name]} {rounded(value, 3)}" for name, value in values.items() if name not in before]
    moved = {name: values[name] / value - 1 for name, value in before.items() if value and name in values}
    far = sorted(moved, key=lambda name: -abs(moved[name]))[:2]
    return ", ".join([*new, *(f"{symbols[name]} {100 * moved[name]:+.0f} %" for name in far)])


def _kept(document: Row, rung: Row) -> Cell:
    """Return whether a term is kept, or of a simpler model, whether what it lacks is needed."""
    if rung in document["simpler"]:
        return Cell("too simple" if rung["kept"] else "as good", "" if rung["kept"] else "doubtful")
    return Cell("yes", "good") if rung["kept"] else Cell("no")


def rungs_table(document: Row) -> Table:
    """Return what each term buys: NRMSE over noise, fitted and left out, and how the parameters move."""
    base = document["base"]
    body = [
        (
            words, number(rung["over_noise"], 3), number(float(np.mean(rung["left_out"])), 3),
            "" if rung is base else number(rung["chance"], 2),
            "" if rung is base else _kept(document, rung),
            "" if rung is base else _changes(document, rung),
        )
        for words, rung in _rows(document)
    ]  # fmt: skip
    heads = ("term", "over noise", "left out", "chance", "keep", "values, moves")
    return listed(
        "What is missing in the model", body, heads,
        "NRMSE over noise: fitted, and left out, each trial as the fit of the others predicts it; chance: "
        "that the gain there is luck, for all terms looked at; moves: of the parameters that move most",
    )  # fmt: skip


def figure_rungs(document: Row) -> Figure:
    """Draw NRMSE over noise of every rung: fitted, and each trial as the fit of the others predicts it."""
    rows = _rows(document)
    figure, axes = panel(0.8 + 0.32 * len(rows))
    place = np.arange(len(rows))[::-1]
    for y, (_, rung) in zip(place, rows, strict=True):
        axes.plot(rung["left_out"], np.full(len(rung["left_out"]), y), "|", color="0.6", markersize=8)
        axes.plot(np.mean(rung["left_out"]), y, "o", color="#0072B2")
        axes.plot(rung["over_noise"], y, "o", color="#D55E00", fillstyle="none")
    axes.axvline(1.0, color="0.3", linewidth=0.8, linestyle=":")
    axes.set_yticks(place, [words for words, _ in rows])
    axes.set_xlabel("NRMSE over noise: fitted (ring), left out (dot: mean, bars: trials)")
    return figure


def print_rungs(document: Row, json: bool, picture: Path | None, campaign: Path | None) -> None:
    """Print a ladder and what to keep; draw it where a picture is asked for."""
    if picture is not None:
        save_figure(figure_rungs(document), picture)
    if print_result(document, json):
        return
    print_table(rungs_table(document))
    keep = " and ".join(document["keep"])
    lines = [
        f"keep {keep}" if keep else "no term predicts the trials left out better than chance: keep the model"
    ]
    if keep and campaign is None:
        lines.append("--out writes a campaign with these terms")
    if campaign is not None:
        lines.append(f"wrote {campaign}; fit it next")
    print_lines([*lines, f"{document['evaluations']} simulations in {document['seconds']:.0f} s"])
