"""One description of curves for the screen, paper and files: views of panels of curves.

`interactive` shows `View`s in a page, drawn by uPlot (MIT): hover, zoom, pan, toggle, export. A reader
chooses between views, such as the drops of a campaign. `figure_of` draws the same views with matplotlib, for
paper, files, notebooks and pages without scripts. All plots and animations of a page share a time cursor:
views with the same `key` show the same moment.

    view = View("drop-1", "drop-1: 12°", time, [Panel("z_B", "m", [Curve("measured", z, "ink", "dots")])])
    html, figure = interactive([view], "measured and simulated"), figure_of([view])
"""

import base64
import itertools
import json
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sysid.report.drawing import (
    BEST,
    LOOKS,
    MASKED,
    MEASURED,
    OTHERS,
    RUNS,
    as_math,
    as_words,
    axis_label,
    draw_grid,
    draw_legend,
    peaks,
    thinned,
)
from sysid.report.html import Html, filled, joined, legend, picture
from sysid.types import FloatArray

# Colours by name; page.css gives each one a value on light and on dark paper.
Colour = Literal["ink", "best", "others", "band", "blue", "green", "pink", "amber", "faint"]
Look = Literal["line", "thin", "thick", "dashed", "dots", "steps"]
# Colours of fits, or groups, whose curves share a panel, in their order.
SERIES: tuple[Colour, ...] = ("best", "blue", "green", "pink", "amber", "others")
# Colours of the rows of bars, in their order.
BARS: tuple[Colour, ...] = ("green", "pink", "amber")
# Colours in figures of matplotlib by their name on a page.
_INKS: dict[str, str] = {
    "ink": MEASURED, "best": BEST, "others": OTHERS, "band": BEST, "blue": RUNS[0], "green": "#009E73",
    "pink": "#CC79A7", "amber": "#E69F00", "faint": "#8A8D95",
}  # fmt: skip
# Greatest number of samples of a view in a page; of more the least and largest of every stretch are kept.
_MOST = 3000
# Distance that an unscaled curve may be drawn beyond the scaled ones, in shares of their range [1].
_MARGIN = 0.25
# Least length of a drawn bar, in shares of the drawn time [1]: shorter bars could not be seen.
_SHORTEST_BAR = 3e-3


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
    """One pair of axes; `shade` are two values between which the ground is grey, a `low` one is a strip.

    A figure in a file writes the `note` beside the label.
    """

    label: str
    unit: str
    curves: Sequence[Curve]
    low: bool = False
    shade: tuple[float, float] | None = None
    note: str = ""


@dataclass(frozen=True, eq=False)
class View:
    """Panels that are seen together, above each other over `x` (n,), whose label and unit are the `axis`.

    `key` ties it to an animation, `title` is what a reader chooses. `bars` are intervals (start, end) to mark
    at the bottom of each panel, by what happens in them. A figure is grey in the intervals that are `lost`.
    """

    key: str
    title: str
    x: FloatArray
    panels: Sequence[Panel]
    bars: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)
    lost: Sequence[tuple[float, float]] = ()
    axis: tuple[str, str] = ("time", "s")


def interactive(
    views: Sequence[View], title: str, static: Html | None = None, *, chosen: int = 0, noun: str = "plot"
) -> Html:
    """Return a plot of views with the same axis.

    `chosen` is the view that is shown first, `noun` what a view is called ("drop"). Without scripts and on
    paper `static` is shown, by default all views as they are `printed`. Raises a ValueError without views.
    """
    if not views:
        raise ValueError("a plot needs at least one view")
    document = {"x": list(views[0].axis), "chosen": chosen, "views": [_document(view) for view in views]}
    return filled(
        "plot.html.j2", title=title, titles=[view.title for view in views], chosen=chosen,
        data=embedded(document), noun=noun, static=printed(views) if static is None else static,
    )  # fmt: skip


def embedded(document: object) -> Html:
    """Return JSON for a script of a page, which ends at the first ``</script``: ``<`` is escaped."""
    text = json.dumps(document, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return Html(text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"))


def packed(values: FloatArray) -> str:
    """Return values as the base64 of little-endian 32-bit floats: seven digits in five letters."""
    return base64.b64encode(np.asarray(values, dtype="<f4").tobytes()).decode("ascii")


def _document(view: View) -> dict[str, object]:
    """Return what the page's script reads of a view: all curves over the places of all of them, with NaN."""
    every = [curve for panel in view.panels for curve in panel.curves]
    shared = [curve.values for curve in every if curve.x is None and curve.scaled]
    kept = peaks(shared, _MOST) if shared else np.arange(len(view.x))
    x = np.unique(np.concatenate([view.x[kept], *(curve.x for curve in every if curve.x is not None)]))

    def spread(curve: Curve, values: FloatArray) -> str:
        places, values = (view.x[kept], values[kept]) if curve.x is None else (curve.x, values)
        out = np.full(len(x), np.nan)
        out[np.searchsorted(x, places)] = values
        return packed(out)

    panels = []
    for panel in view.panels:
        curves = []
        for curve in panel.curves:
            row: dict[str, object] = {"label": curve.label, "colour": curve.colour, "look": curve.look}
            row["y"] = spread(curve, curve.values)
            if curve.upto is not None:
                row["upto"] = spread(curve, curve.upto)
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


def printed(views: Sequence[View]) -> Html:
    """Return views as pictures under one legend."""
    entries = [(f"var(--c-{colour})", look, words) for colour, look, words in _meanings(views)]
    pieces = []
    for view in views:
        words = f"{view.title}: {', '.join(panel.label for panel in view.panels)}"
        pieces.append(picture(figure_of([view], across=True), words, view.title))
    return legend(entries) + Html(f'<div class="printed">{joined(pieces).text}</div>')


def figure_of(views: Sequence[View], title: str = "", *, across: bool = False) -> Figure:
    """Draw views for paper, a file or a notebook: a column per view, under a legend.

    With `across`, for a page that has one legend for many figures, the panels of the only view stand two
    beside each other, each above its low ones.
    """
    groups: list[list[list[Panel]]] = []
    for view in views:
        groups.append([])
        for panel in view.panels:
            if panel.low and groups[-1]:
                groups[-1][-1].append(panel)
            else:
                groups[-1].append([panel])
    most = max(1, *map(len, groups))
    rows, columns = (-(-most // 2), min(most, 2)) if across else (most, len(views))
    # Across: 85 mm on paper, three figures of six panels on a page.
    wide, high = (3.5, 0.88) if across else (6.6 if columns == 1 else 3.2, 2.4)
    entries = [] if across else [(_INKS[colour], look, words) for colour, look, words in _meanings(views)]
    if any(view.lost for view in views) and not across:
        entries.append((MASKED, "area", "no sample counts"))
    width = wide * columns + 0.2
    beside = max(1, int(width / 1.7))
    below = 0.5 + 0.22 * -(-len(entries) // beside)
    above = 0.3 if across else 0.65 + (0.3 if len(views) > 1 else 0.0)
    height = high * rows + below + above - 0.4
    figure = Figure(figsize=(width, height))
    # Fixed margins: laying out eighty axes automatically takes longer than drawing them.
    grid = figure.add_gridspec(
        rows, columns, left=0.55 / width, right=1 - 0.1 / width, bottom=below / height,
        top=1 - above / height, hspace=0.28, wspace=0.2 if across else 0.24,
    )  # fmt: skip
    for v, view in enumerate(views):
        shared: Axes | None = None
        for g, group in enumerate(groups[v]):
            ratios = [1.0 if panel.low else 2.2 for panel in group]
            cell = grid[divmod(g, columns) if across else (g, v)].subgridspec(
                len(group), 1, height_ratios=ratios, hspace=0.55
            )
            for k, panel in enumerate(group):
                axes = shared = figure.add_subplot(cell[k], sharex=shared)
                _draw(axes, view, panel)
                if across:
                    axes.yaxis.set_major_locator(MaxNLocator(1 if panel.low else 3))
                    lowest, highest = axes.get_ylim()
                    inside = [y for y in axes.get_yticks() if lowest <= y <= highest]
                    # A low panel has room for two labels that are far apart, or for one.
                    ends = [inside[0], inside[-1]] if inside else []
                    far = bool(ends) and ends[1] - ends[0] > 0.6 * (highest - lowest)
                    axes.set_yticks((ends if far else ends[:1]) if panel.low else inside)
                last = panel is group[-1] and g >= len(groups[v]) - (columns if across else 1)
                axes.tick_params(labelbottom=last)
                if not across:
                    axes.set_title(panel.note, fontsize=8, loc="right", pad=3)
                if last:
                    axes.set_xlabel(axis_label(*view.axis), fontsize=8)
        if len(views) > 1 and view.panels:
            top = figure.axes[-len(view.panels)]
            top.annotate(
                as_words(textwrap.fill(view.title, 45)), (0.5, 1), (0, 16), xycoords="axes fraction",
                textcoords="offset points", ha="center", fontsize=9,
            )  # fmt: skip
    if not across:
        figure.suptitle(as_words(title or views[0].title), y=1 - 0.12 / height, va="top", fontsize=11)
        draw_legend(figure, entries, "lower center", beside, fontsize=8)
    return figure


def _draw(axes: Axes, view: View, panel: Panel) -> None:
    """Draw a panel with its label as its title."""
    for curve in panel.curves:
        x = view.x if curve.x is None else curve.x
        look = {"color": _INKS[curve.colour], **LOOKS[curve.look]}
        if curve.upto is not None:
            axes.fill_between(x, curve.values, curve.upto, color=_INKS[curve.colour], alpha=0.22, linewidth=0)
        elif curve.look == "dots":
            axes.plot(x, curve.values, **look)
        else:
            axes.plot(*thinned(x, curve.values), **look)
    # A set that went astray must not flatten the measurement it is compared with.
    scaled = np.concatenate([panel.shade or (), *(c.values for c in panel.curves if c.scaled)])
    if np.isfinite(scaled).any():
        low, high = float(np.nanmin(scaled)), float(np.nanmax(scaled))
        margin = _MARGIN * (high - low) or 1.0
        bottom, top = axes.get_ylim()
        axes.set_ylim(max(bottom, low - margin), min(top, high + margin))
    if len(view.x):
        axes.set_xlim(view.x[0], view.x[-1])
    if panel.shade:
        axes.axhspan(*panel.shade, color="0.9", linewidth=0, zorder=0)
    elif panel.low:
        axes.axhline(0.0, color="0.6", linewidth=0.8)
    elif any(view.bars.values()):
        low, high = axes.get_ylim()
        row = 0.05 * (high - low)
        axes.set_ylim(low - row * (len(view.bars) + 0.5), high)
        for k, (spans, colour) in enumerate(zip(view.bars.values(), itertools.cycle(BARS), strict=False)):
            y, shortest = low - row * (len(view.bars) - k - 0.3), _SHORTEST_BAR * (view.x[-1] - view.x[0])
            ends = [max(end, start + shortest) for start, end in spans]
            axes.hlines(
                [y] * len(ends), [a for a, _ in spans], ends, color=_INKS[colour], linewidth=2.5, zorder=5
            )
    for start, end in view.lost:
        axes.axvspan(start, end, color=MASKED, linewidth=0, zorder=0)
    if axes.get_xlim()[0] < 0:
        axes.axvline(0.0, color="0.6", linewidth=0.8, linestyle=":")
    size = 7 if panel.low else 8
    axes.set_title(as_math(axis_label(panel.label, panel.unit)), fontsize=size, loc="left", pad=3)
    axes.tick_params(labelsize=7)
    draw_grid(axes)
    axes.yaxis.set_major_locator(MaxNLocator(2 if panel.low else 4))


def _meanings(views: Sequence[View]) -> list[tuple[Colour, str, str]]:
    """Return (colour, look, words) of all curves and bars."""
    every = [curve for view in views for panel in view.panels for curve in panel.curves]
    looks = {c.label: (c.colour, "area" if c.upto is not None else str(c.look)) for c in every}
    names = dict.fromkeys(name for view in views for name in view.bars)
    looks |= {name: (BARS[k % len(BARS)], "bar") for k, name in enumerate(names)}
    return [(colour, look, words) for words, (colour, look) in looks.items()]
