"""Figures of landings: maps in the manner of Figs. 8, 9 and 11, and the best impulse as in Fig. 10."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.patheffects import Normal, withStroke

from sysid.landing.impulse import ImpulseMap
from sysid.landing.maps import LandingMap, cell_edges
from sysid.landing.outcomes import OUTCOMES, Outcome
from sysid.landing.real_landings import Experiment, of_map
from sysid.landing.store import MapFile
from sysid.report.drawing import BEST, OTHERS, WIDTH, Style, as_words, paper
from sysid.types import FloatArray

# Colours of the classes, by Okabe and Ito as in all figures; class B is white as in the paper.
COLOURS: dict[Outcome, str] = {
    Outcome.SHORT: "#009E73",
    Outcome.NEAR: "#E69F00",
    Outcome.FLIPPED: "#999999",
    Outcome.OTHER: "#FFFFFF",
    Outcome.LOST: "#CC79A7",
}
# Contour levels of the mean distance [m] and of the mean time [s].
_DISTANCES = (0.1, 0.2, 0.45, 1.0)
_TIMES = (0.5, 1.0, 2.0)
# Line styles of static limits by the legs; no contour has them.
_LIMIT_STYLES: dict[str, Style] = {"rigid": {"linestyle": "dashdot"}, "bending": {"linestyle": "dotted"}}
# Look of the slopes above a map.
_BEYOND: Style = {"facecolor": "#F2F2F2", "hatch": "////", "edgecolor": "#BBBBBB", "linewidth": 0.0}
# Greatest distance above a map at which a static limit still extends the axis [deg].
_ROOM = 6.0
# Least distance of a contour's label from other labels, and from the edges, in widths of the axes [1].
_APART, _INSIDE = 0.11, 0.05
# Least number of speeds, and of slopes, between which contours are smooth [1].
_FINE = 6
# Longest list of controllers and their thrusts in the legend [characters].
_LONGEST = 40
# Real landings by their outcome: word in the table of landings, marker, colour, name in the legend.
_MARKERS = (
    ("short", "o", COLOURS[Outcome.SHORT], "at rest nearby"),
    ("landed", "o", OTHERS, "landed"),
    ("near", "s", COLOURS[Outcome.NEAR], "at rest further off"),
    ("flipped", "^", COLOURS[Outcome.FLIPPED], "flipped"),
    ("other", "D", COLOURS[Outcome.OTHER], "neither"),
    ("failed", "X", BEST, "failed"),
)
# White outline within a black one, to be seen on every colour of a map.
_OUTLINE = (withStroke(linewidth=2.8, foreground="black"), Normal())


@dataclass(frozen=True)
class DrawnLimits:
    """Static limits of a map: steepest slopes with stiff legs and with the set's legs, set down [deg].

    The thrust presses the drone to the ground once the motors have settled [N].
    """

    thrust: float
    rigid: float
    bending: float

    @property
    def slopes(self) -> dict[str, float]:
        """Steepest slope by the legs [deg]."""
        return {"rigid": self.rigid, "bending": self.bending}


Limits = Mapping[tuple[str, str], DrawnLimits]
# Samples of the drawn things by their words, in the order of drawing; a legend lists these and nothing else.
MapLegend = dict[str, Patch | Line2D]


def legend_entries(legend: MapLegend) -> list[tuple[str, str, str]]:
    """Return (colour, kind, words) of each entry, areas first, as `sysid.report.html.legend` takes them."""
    out = []
    for words, handle in legend.items():
        if isinstance(handle, Patch):
            out.append((to_hex(handle.get_facecolor()), "area", words))
            continue
        kind = {"-": "line", ":": "dotted", "None": "dots"}.get(str(handle.get_linestyle()), "dashed")
        out.append((to_hex(handle.get_color()), kind, words))
    return sorted(out, key=lambda entry: entry[1] != "area")


def class_words(short: float, long: float) -> dict[Outcome, str]:
    """Return what each class means, with the distances that divide the classes [m]."""
    return {
        Outcome.SHORT: f"at rest within {100 * short:g} cm",
        Outcome.NEAR: f"at rest within {long:g} m",
        Outcome.FLIPPED: f"A: flipped within {long:g} m",
        Outcome.OTHER: f"B: still moving, or beyond {long:g} m",
        Outcome.LOST: "the simulation failed",
    }


def figure_of_file(
    content: MapFile, legend: MapLegend | None = None, only: LandingMap | None = None
) -> Figure:
    """Draw the maps of a file, or one of them, with limits and real landings; see `figure_landing_maps`."""
    settings = content.settings
    # Best impulses have three maps of each surface; the third, of the impulse alone, bounds the others.
    alone = {each.surface: each for each in content.maps[2::3]} if len(content.impulses) else {}
    alone_by_map = {
        (each.surface, each.controller): alone[each.surface]
        for each in content.maps
        if each is not alone.get(each.surface, each)
    }
    return figure_landing_maps(
        content.maps if only is None else (only,),
        limits={
            (row.pop("surface"), row.pop("controller")): DrawnLimits(**row)
            for row in map(dict, settings["static_limits"])
        },
        experiments=[Experiment(**row) for row in settings.get("real_landings", ())],
        short=settings["rules"]["short"],
        long=settings["rules"]["long"],
        legend=legend,
        edges=alone_by_map,
    )


def figure_landing_maps(
    maps: Sequence[LandingMap],
    *,
    limits: Limits | None = None,
    experiments: Sequence[Experiment] = (),
    short: float = 0.45,
    long: float = 1.0,
    legend: MapLegend | None = None,
    edges: Mapping[tuple[str, str], LandingMap] | None = None,
) -> Figure:
    """Draw maps: a row per surface, a column per controller.

    The colour is the mean of the classes' colours, weighted with the share of the sets. Dots mark cells in
    which half the tolerance changes the class of a set. Contours are drawn where enough of the sets land.
    For draws, the edge of where 95 % of them land is drawn. Slopes above a map, for limits a little higher,
    are hatched.

    `limits` are the static ones of the surface's first set by surface and controller. `experiments` are drawn
    where both agree. `short` and `long` divide the classes [m]. A given `legend` takes what is drawn, and the
    figure bears none: a page has one for many figures. `edges` are maps of the impulse alone by surface and
    controller, whose edge is drawn as in Fig. 9.
    """
    surfaces = list(dict.fromkeys(chart.surface for chart in maps))
    columns = list(dict.fromkeys(chart.controller for chart in maps))
    figure = Figure(layout="constrained")
    grid = figure.subplots(len(surfaces), len(columns), sharex=True, squeeze=False)
    for axes in grid.flat:
        axes.set_visible(False)
    limits = limits or {}
    # Upper end of all axes: the highest edge of a map, or a little above a limit near the edge.
    highest = max(float(cell_edges(chart.slopes_deg)[-1]) for chart in maps)
    drawn = [limits[key] for chart in maps if (key := (chart.surface, chart.controller)) in limits]
    near = [slope + 1.0 for limit in drawn for slope in limit.slopes.values() if slope <= highest + _ROOM]
    highest = max([highest, *near])
    alone = legend is None
    legend = {} if legend is None else legend
    outcomes = {int(code) for chart in maps for code in np.unique(chart.outcome)} & set(OUTCOMES)
    outcomes |= {Outcome.LOST for chart in maps if np.any(chart.likeliest == Outcome.LOST)}
    for outcome, words in class_words(short, long).items():
        if outcome in outcomes:
            legend[words] = Patch(facecolor=COLOURS[outcome], edgecolor="black", linewidth=0.5)
    for chart in maps:
        axes = grid[surfaces.index(chart.surface), columns.index(chart.controller)]
        axes.set_visible(True)
        blend = np.zeros((*chart.landed.shape, 3))
        for outcome in OUTCOMES:
            blend += np.nan_to_num(chart.share(outcome))[..., None] * np.array(to_rgb(COLOURS[outcome]))
        blend[chart.likeliest == Outcome.LOST] = to_rgb(COLOURS[Outcome.LOST])
        lowest, edge = _mesh(axes, chart, np.clip(blend, 0.0, 1.0))
        axes.set_ylim(lowest, highest)
        if highest > edge + 1e-9:
            axes.axhspan(edge, highest, **_BEYOND)
            legend["not simulated"] = Patch(**_BEYOND)
        _draw_uncertain(axes, chart, legend)
        limit = limits.get((chart.surface, chart.controller))
        taken = _draw_letters(axes, chart, list(limit.slopes.values()) if limit else [])
        beyond = _draw_limits(axes, limit) if limit is not None else ""
        axes.set_title(as_words(chart.title) + (f"\n{beyond}" if beyond else ""), fontsize=10)
        real = of_map(experiments, chart)
        if real:
            taken += list(_relative(axes, np.array([(e.speed, e.slope_deg) for e in real])))
        if min(chart.landed.shape) >= _FINE:
            _draw_contours(axes, chart, taken, legend)
        if min(chart.landed.shape) > 1 and chart.numbers and not edges:
            _draw_bound(axes, chart, legend)
        bound = (edges or {}).get((chart.surface, chart.controller))
        if bound is not None and min(bound.landed.shape) > 1:
            _draw_bound(axes, bound, legend, " with the impulse alone")
        _draw_experiments(axes, real, legend)
    if limits:
        _name_limits(legend, maps, limits, highest)
    for axes in grid[-1]:
        axes.set_xlabel("touchdown speed [m/s]")
    for axes in grid[:, 0]:
        axes.set_ylabel("slope [deg]")
    if not alone:
        figure.set_size_inches(WIDTH * len(columns), 3.4 * len(surfaces))
        return figure
    ncols = min(len(columns), 3)
    rows = -(-len(legend) // ncols)
    figure.set_size_inches(1.2 + 4.1 * len(columns), 0.8 + 3.5 * len(surfaces) + 0.18 * rows)
    counts = sorted({len(chart.sets) for chart in maps})
    many = " to ".join(dict.fromkeys(map(str, (counts[0], counts[-1]))))
    blended = f"{many} {maps[0].of} per map; blended colours are shares of the {maps[0].of}"
    figure.legend(
        list(legend.values()), list(legend), loc="outside lower center", ncols=ncols, frameon=False,
        title="one set per map" if counts == [1] else blended, fontsize=8, title_fontsize=8,
    )  # fmt: skip
    return figure


def _mesh(
    axes: Axes, chart: LandingMap | ImpulseMap, values: FloatArray, **look: object
) -> tuple[float, float]:
    """Draw the cells between their edges, which need not be even; return the outer slopes [deg]."""
    across, up = cell_edges(chart.speeds), cell_edges(chart.slopes_deg)
    drawn = axes.pcolormesh(across, up, values, rasterized=True, **look)  # type: ignore[arg-type]
    if values.ndim == 2:
        beyond = "max" if np.nanmax(values, initial=0.0) > float(look["vmax"]) else "neither"  # type: ignore[arg-type]
        axes.figure.colorbar(drawn, ax=axes, extend=beyond)
    axes.set_xlim(across[0], across[-1])
    axes.set_ylim(up[0], up[-1])
    # A single cell's width and height mean nothing; only its middle does.
    if len(chart.speeds) == 1:
        axes.set_xticks(chart.speeds)
    if len(chart.slopes_deg) == 1:
        axes.set_yticks(chart.slopes_deg)
    return float(up[0]), float(up[-1])


def _draw_uncertain(axes: Axes, chart: LandingMap, legend: MapLegend) -> None:
    rows, columns = np.nonzero(chart.uncertain.any(axis=0))
    if len(rows):
        label = "class of a set changes with half the tolerance"
        axes.scatter(
            chart.speeds[columns], chart.slopes_deg[rows], s=5, zorder=3, label=label, color="black",
            edgecolors="white", linewidths=0.4,
        )  # fmt: skip
        legend[label] = Line2D([], [], color="black", marker=".", linestyle="none")


def _draw_letters(axes: Axes, chart: LandingMap, lines: Sequence[float]) -> list[FloatArray]:
    """Name the zones A and B, clear of level lines [deg]; return where, in widths of the axes."""
    from scipy.ndimage import distance_transform_edt

    taken = []
    low, high = axes.get_ylim()
    clear = np.all([np.abs(chart.slopes_deg - line) > _APART * (high - low) / 2 for line in lines], axis=0)
    for outcome, letter in ((Outcome.FLIPPED, "A"), (Outcome.OTHER, "B")):
        cells = chart.likeliest == outcome
        # A letter stands in the deepest cell of its zone, and a small zone has none.
        if cells.sum() >= 0.02 * cells.size:
            depth = distance_transform_edt(np.pad(cells, 1))[1:-1, 1:-1]
            away = np.where(np.broadcast_to(clear, chart.slopes_deg.shape)[:, None], depth, 0.0)
            deepest = int(np.argmax(away if away.any() else depth))
            row, column = np.unravel_index(deepest, cells.shape)
            spot = np.array([chart.speeds[column], chart.slopes_deg[row]])
            around = [withStroke(linewidth=5, foreground=COLOURS[outcome])]
            axes.text(
                spot[0], spot[1], letter, fontsize=13, ha="center", va="center", zorder=5, path_effects=around
            )
            taken.append(_relative(axes, spot[None])[0])
    return taken


def _relative(axes: Axes, points: FloatArray) -> FloatArray:
    """Return points (n, 2) in widths of the axes."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    return np.asarray((points - [left, low]) / [right - left, high - low])


def _draw_contours(axes: Axes, chart: LandingMap, taken: list[FloatArray], legend: MapLegend) -> None:
    """Draw mean distance and time; one label per level, where it is clear of all others, or none."""
    landed = chart.landed >= chart.enough
    for values, levels, colour, style, unit, name in (
        (chart.mean_distance, _DISTANCES, "#000000", "solid", "m", "mean distance to rest"),
        (chart.mean_time, _TIMES, "#00224E", (0, (4, 2)), "s", "mean time to rest"),
    ):
        # Means over cells in which few sets land say little, and their contours are a tangle.
        known = np.where(landed & np.isfinite(values), values, np.nan)
        low, high = np.nanmin(known, initial=np.inf), np.nanmax(known, initial=0.0)
        inside = [level for level in levels if low < level < high]
        if not inside:
            continue
        drawn = axes.contour(
            chart.speeds, chart.slopes_deg, np.ma.masked_invalid(known), levels=inside,
            colors=colour, linestyles=[style], linewidths=1.1,
        )  # fmt: skip
        drawn.set_label(name)
        look: Style = {"color": colour, "linestyle": style}
        legend[name] = Line2D([], [], **look)
        # Loops around single cells are noise: a piece must span enough to be read.
        levels_pieces = [
            [p for p in pieces if len(p) > 1 and np.max(np.ptp(_relative(axes, p), axis=0)) >= _INSIDE]
            for pieces in drawn.allsegs
        ]
        drawn.set_paths(
            [Path.make_compound_path(*(Path(piece) for piece in pieces)) for pieces in levels_pieces]
        )
        for level, pieces in zip(inside, levels_pieces, strict=True):
            spot = _clear_spot(axes, pieces, taken)
            if spot is not None:
                taken.append(_relative(axes, spot[None])[0])
                axes.text(
                    spot[0], spot[1], f"{level:g} {unit}", fontsize=7, color=colour, zorder=5,
                    ha="center", va="center", bbox=paper(0.6, alpha=0.75),
                )  # fmt: skip


def _draw_bound(axes: Axes, chart: LandingMap, legend: MapLegend, how: str = "") -> None:
    """Draw the edge of where enough of the sets land, around cells: neighbours may differ by chance."""
    landed = np.nan_to_num(chart.landed) >= chart.enough
    across, up = cell_edges(chart.speeds), cell_edges(chart.slopes_deg)
    look: Style = {"color": "black", "linestyle": (0, (5, 2)), "linewidth": 2.0}
    for row, column in np.argwhere(landed[1:] != landed[:-1]).tolist():
        axes.plot(across[column : column + 2], [up[row + 1]] * 2, **look)
    for row, column in np.argwhere(landed[:, 1:] != landed[:, :-1]).tolist():
        axes.plot([across[column + 1]] * 2, up[row : row + 2], **look)
    legend[f"{chart.quorum} land{how} up to here"] = Line2D([], [], **look)


def _clear_spot(axes: Axes, pieces: Sequence[FloatArray], taken: Sequence[FloatArray]) -> FloatArray | None:
    """Return the point of a level's longest piece that is furthest from other labels; None if too near."""
    # A level that only masked cells cross leaves no piece, or an empty one.
    piece = max(pieces, key=len, default=np.empty((0, 2)))
    if not len(piece):
        return None
    spots = _relative(axes, piece)
    clear = np.min([spots[:, 0], 1 - spots[:, 0], spots[:, 1], 1 - spots[:, 1]], axis=0) >= _INSIDE
    if taken:
        away = np.min([np.hypot(*(spots - other).T) for other in taken], axis=0)
    else:
        away = -np.hypot(*(spots - 0.5).T) + 1.0
    away = np.where(clear, away, -np.inf)
    best = int(np.argmax(away))
    return np.asarray(piece[best]) if away[best] >= _APART else None


def _draw_limits(axes: Axes, limit: DrawnLimits) -> str:
    """Draw the limits within the axes as lines; return words on the others."""
    low, high = axes.get_ylim()
    outside: dict[str, list[str]] = {}
    for legs, slope in limit.slopes.items():
        if low <= slope <= high:
            axes.axhline(slope, color=BEST, linewidth=1.6, **_LIMIT_STYLES[legs])
        else:
            outside.setdefault("above" if slope > high else "below", []).append(f"{slope:.0f}° ({legs} legs)")
    words = "; ".join(f"{where}: {', '.join(names)}" for where, names in outside.items())
    return f"static limit {words}" if words else ""


def _name_limits(legend: MapLegend, maps: Sequence[LandingMap], limits: Limits, highest: float) -> None:
    """Name the drawn limits with their thrust, which differs between controllers, hardly between surfaces."""
    drawn: set[str] = set()
    thrusts: dict[str, dict[str, None]] = {}
    for chart in maps:
        limit = limits.get((chart.surface, chart.controller))
        if limit is not None:
            low = float(cell_edges(chart.slopes_deg)[0])
            drawn |= {legs for legs, slope in limit.slopes.items() if low <= slope <= highest}
            # Idle motors leave some -1e-12 N, which is 0, not -0.
            thrusts.setdefault(f"{round(limit.thrust, 1) + 0.0:g} N", {})[chart.controller] = None
    together = "; ".join(f"{' / '.join(names)}: {thrust}" for thrust, names in thrusts.items())
    # Three long names with the same thrust would make the legend wider than the figure.
    thrust = together if len(together) <= _LONGEST else " or ".join(thrusts)
    for legs in _LIMIT_STYLES:
        if legs in drawn:
            label = f"static limit of the first set, {legs} legs ({thrust})"
            legend[label] = Line2D([], [], color=BEST, **_LIMIT_STYLES[legs])


def _draw_experiments(axes: Axes, chosen: Sequence[Experiment], legend: MapLegend) -> None:
    for word, marker, colour, name in _MARKERS:
        points = [(e.speed, e.slope_deg) for e in chosen if e.outcome == word]
        if not points:
            continue
        label = f"real landing: {name}"
        look: Style = {"marker": marker, "color": colour, "path_effects": list(_OUTLINE)}
        speed, slope = np.array(points).T
        axes.scatter(speed, slope, s=46, zorder=6, label=label, edgecolors="white", linewidths=1.2, **look)
        legend[label] = Line2D([], [], linestyle="none", markeredgecolor="white", **look)


def figure_impulse(best: Sequence[ImpulseMap], *, stacked: bool = False) -> Figure:
    """Draw the best impulse: a row per surface; mean, σ over the sets of delay and duration on the grid.

    With `stacked`, for a narrow page, they are drawn below each other; then `best` has one surface.
    """
    shown = ("mean", "sigma") if any(len(chart.sets) > 1 for chart in best) else ("mean",)
    columns = [(which, name) for name in ("delay", "duration") for which in shown]
    across, down = (1, len(columns)) if stacked else (len(columns), len(best))
    size = (WIDTH, 0.4 + 2.9 * down) if stacked else (0.5 + 3.5 * across, 0.9 + 3.1 * down)
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
    grid = grid.reshape(len(best), len(columns))
    for row, chart in zip(grid, best, strict=True):
        for axes, (which, name) in zip(row, columns, strict=True):
            values = 1e3 * (chart.mean(name) if which == "mean" else chart.sigma(name))
            top = (260.0 if name == "delay" else 160.0) if which == "mean" else 100.0
            _mesh(axes, chart, values, cmap="viridis", vmin=0.0, vmax=top)
            what = f"{name}, {'mean' if which == 'mean' else 'σ'} [ms]"
            axes.set_title(f"{chart.surface.upper()}: {what}", fontsize=10)
        for axes in row if stacked else row[:1]:
            axes.set_ylabel("slope [deg]")
    for axes in grid[-1, -1:] if stacked else grid[-1]:
        axes.set_xlabel("touchdown speed [m/s]")
    return figure
