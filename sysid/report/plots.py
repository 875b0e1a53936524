"""Plots that a reader can touch: hover, zoom, pan, toggle, export; drawn in the page by uPlot (MIT).

`interactive` makes one from `View`s, which a reader chooses between, such as the drops of a campaign. Each
view has panels above each other on one axis, and each panel has curves. All plots and animations of a page
share a time cursor: views with the same `key` show the same moment. Where no script runs, and on paper, the
panels are drawn beside each other as vectors instead.

    view = View("drop-1", "drop-1: 12°", time, [Panel("z_B", "m", [Curve("measured", z, "ink", "dots")])])
    html = interactive([view], "measured and simulated")
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from matplotlib.ticker import MaxNLocator

from sysid.report.html import Html, filled, joined, legend
from sysid.types import FloatArray, IntArray

# Colours by name; page.css gives each one a value on light and on dark paper.
Colour = Literal["ink", "best", "others", "band", "blue", "green", "pink", "amber", "faint"]
Look = Literal["line", "thin", "dashed", "dots", "steps"]
# The colours of fits and groups that are drawn over each other.
SERIES: tuple[Colour, ...] = ("best", "blue", "green", "pink", "amber", "others")
# Samples of a view beyond which only the least and largest of every stretch are drawn, and on paper.
_MOST, _MOST_PRINTED = 3000, 240
# Colours of the rows of bars.
BARS: tuple[Colour, ...] = ("green", "pink", "amber")


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
    views: Sequence[View], title: str, static: Html | None = None, *, x: tuple[str, str] = ("time", "s"),
    chosen: int = 0, noun: str = "plot",
) -> Html:  # fmt: skip
    """Return a plot of views with the same axis `x` (label, unit).

    `chosen` is the view that is shown first, `noun` what a view is called ("drop"). Without scripts and on
    paper `static` is shown, or all views with a legend. Raises a ValueError without views.
    """
    if not views:
        raise ValueError("a plot needs at least one view")
    if static is None:
        static = _legend(views) + joined([_drawn(view, x) for view in views])
    document = {"x": list(x), "chosen": chosen, "views": [_view(view) for view in views]}
    return filled(
        "plot.html.j2", title=title, titles=[view.title for view in views], chosen=chosen,
        data=embedded(document), noun=noun, static=static,
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


def _legend(views: Sequence[View]) -> Html:
    every = (curve for view in views for panel in view.panels for curve in panel.curves)
    looks = {c.label: (c.colour, "area" if c.upto is not None else str(c.look)) for c in every}
    names = dict.fromkeys(name for view in views for name in view.bars)
    looks |= {name: (BARS[k % len(BARS)], "bar") for k, name in enumerate(names)}
    return legend([(f"var(--c-{colour})", look, label) for label, (colour, look) in looks.items()])


def _drawn(view: View, x: tuple[str, str]) -> Html:
    """Return a view as a figure for paper: a column per panel, with the low panels that follow it below."""
    groups: list[list[Panel]] = []
    for panel in view.panels:
        if panel.low and groups:
            groups[-1].append(panel)
        else:
            groups.append([panel])
    wide, out, deep = 204.0, [], 0.0
    for k, group in enumerate(groups):
        left, top = 36.0 + (wide + 42.0) * k, 16.0
        for panel in group:
            high = 38.0 if panel.low else 112.0
            out.append(_axes(view, panel, (left, top, wide, high)))
            top += high + 16.0
        deep = max(deep, top)
    width, words = (
        36.0 + (wide + 42.0) * len(groups) - 36.0,
        f"{view.title}: {', '.join(p.label for p in view.panels)}",
    )
    out.append(f'<text x="{width / 2:.0f}" y="{deep + 10:.0f}" text-anchor="middle">{html.escape(x[0])} '
               f"[{html.escape(x[1])}]</text>")  # fmt: skip
    return Html(
        f'<figure class="printed"><svg role="img" aria-label="{html.escape(words)}" '
        f'viewBox="0 0 {width:.0f} {deep + 14:.0f}" style="max-width: {width:.0f}px">{"".join(out)}</svg>'
        f"<figcaption>{html.escape(view.title)}</figcaption></figure>"
    )


def _axes(view: View, panel: Panel, box: tuple[float, float, float, float]) -> str:
    """Return the marks of a panel inside a box: left, top, width, height [px]."""
    left, top, wide, high = box
    start, end = float(view.x[0]), float(view.x[-1])
    scaled = [v[np.isfinite(v)] for c in panel.curves if c.scaled for v in (c.values,)]
    shown = np.concatenate([*scaled, panel.shade or ()]) if scaled or panel.shade else np.array([0.0, 1.0])
    low, high_end = (float(shown.min()), float(shown.max())) if len(shown) else (0.0, 1.0)
    margin = 0.06 * (high_end - low) or 1.0
    low, high_end = low - margin, high_end + margin

    def across(value: FloatArray | float) -> Any:
        return left + wide * (np.asarray(value) - start) / ((end - start) or 1.0)

    def up(value: FloatArray | float) -> Any:
        return top + high * (1 - (np.clip(value, low, high_end) - low) / (high_end - low))

    out = []
    if panel.shade:
        y, bottom = up(panel.shade[1]), up(panel.shade[0])
        out.append(f'<path class="shade" d="M{left} {y:.1f}h{wide}V{bottom:.1f}h{-wide}Z"/>')
    for curve in panel.curves:
        places = view.x if curve.x is None else curve.x
        every = max(1, -(-len(places) // _MOST_PRINTED))
        x = across(np.asarray(places)[::every])
        points = [
            f"{a:.1f} {b:.1f}" if np.isfinite(b) else ""
            for a, b in zip(x, up(curve.values[::every]), strict=True)
        ]
        if curve.upto is not None:
            back = [
                f"{a:.1f} {b:.1f}" for a, b in zip(x, up(curve.upto[::every]), strict=True) if np.isfinite(b)
            ]
            outline = "L".join([*filter(None, points), *reversed(back)])
            out.append(f'<path class="area" style="color: var(--c-{curve.colour})" d="M{outline}Z"/>')
            continue
        path, joint = "", "M"
        for point in points:
            path += f"{joint}{point}" if point else ""
            path += "h0" if point and curve.look == "dots" else ""
            joint = "L" if point and curve.look != "dots" else "M"
        out.append(
            f'<path class="{curve.look}" style="color: var(--c-{curve.colour})" d="{path}"/>' if path else ""
        )
    for k, spans in enumerate(view.bars.values() if not panel.low else ()):
        y = top + high - 3 - 4 * k
        marks = "".join(f"M{across(a):.1f} {y}H{max(across(b), across(a) + 1):.1f}" for a, b in spans)
        out.append(
            f'<path class="bar" style="color: var(--c-{BARS[k % len(BARS)]})" d="{marks}"/>' if marks else ""
        )
    out.append(f'<path class="frame" d="M{left} {top}h{wide}v{high}h{-wide}Z"/>')
    name = panel.label + (f" [{panel.unit}]" if panel.unit not in ("", "1") else "")
    out.append(f'<text x="{left}" y="{top - 4}" class="name">{html.escape(name)}</text>')
    for value in panel.shade or MaxNLocator(3).tick_values(low, high_end):
        if low <= value <= high_end:
            words = f"{value:.4g}".replace("-", "−")
            out.append(f'<text x="{left - 4}" y="{up(value) + 3:.1f}" text-anchor="end">{words}</text>')
    for value in MaxNLocator(4).tick_values(start, end) if panel is view.panels[-1] or panel.low else ():
        if start <= value <= end:
            out.append(
                f'<text x="{across(value):.1f}" y="{top + high + 10}" text-anchor="middle">{value:.4g}</text>'
            )
    return "".join(out)
