"""Plots that a reader can touch: hover, zoom, pan, toggle, export; drawn in the page by uPlot (MIT).

`interactive` makes one from `View`s, which a reader chooses between, such as the drops of a campaign. Each
view has panels above each other on one axis, and each panel has curves. All plots and animations of a page
share a time cursor: views with the same `key` show the same moment. Where no script runs, and on paper, the
static figure that is passed beside the views is shown instead.

    view = View("drop-1", "drop-1: 12°", time, [Panel("z_B", "m", [Curve("measured", z, "ink", "dots")])])
    html = interactive([view], "measured and simulated", picture(figure, "z_B over time"))
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from sysid.report.html import NOTHING, Html, filled
from sysid.types import FloatArray, IntArray

# Colours by name; page.css gives each one a value on light and on dark paper.
Colour = Literal["ink", "best", "others", "band", "blue", "green", "pink", "amber", "faint"]
Look = Literal["line", "thin", "dashed", "dots", "steps"]
# The colours of fits and groups that are drawn over each other.
SERIES: tuple[Colour, ...] = ("best", "blue", "green", "pink", "amber", "others")
# Samples of a view beyond which only the least and largest of every stretch are drawn.
_MOST = 3000


@dataclass(frozen=True, eq=False)
class Curve:
    """Values (n,) in the panel's unit; NaN is a gap. Curves of one label are shown and hidden together.

    With `upto` (n,) the area between both is a band. `x` (n,) are its own places where they are not the
    view's. A curve that is not `scaled` may leave the panel: it does not choose the panel's range.
    """

    label: str
    values: FloatArray
    colour: Colour = "best"
    look: Look = "line"
    upto: FloatArray | None = None
    x: FloatArray | None = None
    scaled: bool = True


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes; `shade` are two values between which the ground is grey, a `low` one is a strip."""

    label: str
    unit: str
    curves: Sequence[Curve]
    low: bool = False
    shade: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class View:
    """What is seen at a time: panels above each other over `x` (n,).

    `key` ties it to an animation, `title` is what a reader chooses. `bars` are intervals (start, end) to mark
    at the bottom of each panel, by what happens in them.
    """

    key: str
    title: str
    x: FloatArray
    panels: Sequence[Panel]
    bars: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)


def interactive(
    views: Sequence[View], title: str, static: Html = NOTHING, *, x: tuple[str, str] = ("time", "s"),
    chosen: int = 0, noun: str = "plot",
) -> Html:  # fmt: skip
    """Return a plot of views with the same axis `x` (label, unit); `static` is what paper shows instead.

    `chosen` is the view that is shown first, `noun` what a view is called ("drop"). Raises a ValueError
    without views.
    """
    if not views:
        raise ValueError("a plot needs at least one view")
    document = {"x": list(x), "chosen": chosen, "views": [_view(view) for view in views]}
    return filled(
        "plot.html.j2", title=title, titles=[view.title for view in views], chosen=chosen,
        data=embedded(document), static=static, noun=noun,
    )  # fmt: skip


def embedded(document: Any) -> Html:
    """Return JSON for a script of a page, which ends at the first ``</script``: ``<`` is escaped."""
    text = json.dumps(document, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return Html(text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"))


def packed(values: FloatArray) -> str:
    """Return values as the base64 of little-endian 32-bit floats: seven digits in five letters."""
    return base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")


def _view(view: View) -> dict[str, Any]:
    x, kept = _places(view)
    panels = []
    for panel in view.panels:
        curves = []
        for curve in panel.curves:
            row: dict[str, Any] = {"label": curve.label, "colour": curve.colour, "look": curve.look}
            row["y"] = packed(_at(x, curve, view.x, kept, curve.values))
            if curve.upto is not None:
                row["upto"] = packed(_at(x, curve, view.x, kept, curve.upto))
            if curve.x is not None:
                row["spans"] = True
            if not curve.scaled:
                row["loose"] = True
            curves.append(row)
        shade = list(panel.shade) if panel.shade else None
        panels.append(
            {"label": panel.label, "unit": panel.unit, "low": panel.low, "shade": shade, "curves": curves}
        )
    bars = [
        {"label": name, "spans": [[round(float(t), 5) for t in each] for each in every]}
        for name, every in view.bars.items()
    ]
    return {"key": view.key, "title": view.title, "x": packed(x), "panels": panels, "bars": bars}


def _places(view: View) -> tuple[FloatArray, IntArray]:
    """Return the places of all curves in order, and which of the view's samples are among them."""
    shared = [c.values for panel in view.panels for c in panel.curves if c.x is None and c.scaled]
    kept = np.arange(len(view.x))
    if len(view.x) > _MOST and shared:
        # Peaks survive: the least and the largest value of every curve in every stretch.
        edges = np.linspace(0, len(view.x), max(2, _MOST // (2 * len(shared))) + 1).astype(int)[:-1]
        picks: list[Any] = [edges, [len(view.x) - 1]]
        for values in shared:
            for worst, extreme in ((np.inf, np.argmin), (-np.inf, np.argmax)):
                finite = np.where(np.isfinite(values), values, worst)
                parts = np.split(finite, edges[1:])
                picks.append([int(e + extreme(p)) for e, p in zip(edges, parts, strict=True) if len(p)])
        kept = np.unique(np.concatenate(picks))
    own = [np.asarray(c.x, dtype=float) for panel in view.panels for c in panel.curves if c.x is not None]
    return np.unique(np.concatenate([np.asarray(view.x, dtype=float)[kept], *own])), kept


def _at(x: FloatArray, curve: Curve, shared: FloatArray, kept: IntArray, values: FloatArray) -> FloatArray:
    """Return a curve's values at the places of the view; NaN where it has none."""
    places, values = (shared[kept], values[kept]) if curve.x is None else (curve.x, values)
    out = np.full(len(x), np.nan)
    out[np.searchsorted(x, places)] = values
    return out
