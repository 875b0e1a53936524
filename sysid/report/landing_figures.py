"""Figures of landings: maps in the manner of Figs. 8, 9 and 11, and the best impulse as in Fig. 10."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from sysid.landing.experiments import Experiment, of_map
from sysid.landing.impulse_maps import ImpulseMap
from sysid.landing.maps import LandingMap
from sysid.landing.outcomes import OUTCOMES, Outcome

FloatArray = NDArray[np.float64]

# Okabe and Ito, as everywhere; B is white as in the paper.
COLOURS: dict[Outcome, str] = {
    Outcome.SHORT: "#009E73",
    Outcome.NEAR: "#E69F00",
    Outcome.FLIPPED: "#999999",
    Outcome.OTHER: "#FFFFFF",
}
_DISTANCES = (0.1, 0.2, 0.45, 1.0)
_TIMES = (0.5, 1.0, 2.0)
_DISTANCE_COLOUR, _TIME_COLOUR, _LIMIT_COLOUR = "#000000", "#00224E", "#D55E00"
# Room above the steepest slope of a map, for static limits that lie a little higher [deg].
_ROOM = 6.0

Limits = Mapping[tuple[str, str], Sequence[tuple[float, str]]]


def figure_landing_maps(
    maps: Sequence[LandingMap],
    *,
    limits: Limits | None = None,
    experiments: Sequence[Experiment] = (),
    lines: bool = True,
    short: float = 0.45,
    long: float = 1.0,
) -> Figure:
    """Draw maps: a row per surface, a column per controller.

    Parameters
    ----------
    maps : sequence of LandingMap
    limits : mapping, optional
        Static limits by surface and controller: slope [deg] and line style of each.
    experiments : sequence of Experiment
        Real landings, drawn where surface and controller agree.
    lines : bool
        Contours of mean distance and mean time, where at least half of the sets land.
    short, long : float
        Distances of the classes [m], for the legend.

    Notes
    -----
    The colour is the mean of the classes' colours, weighted with the share of the sets.
    """
    surfaces = list(dict.fromkeys(one.surface for one in maps))
    columns = list(dict.fromkeys(one.controller for one in maps))
    size = (1.2 + 4.1 * len(columns), 1.7 + 3.5 * len(surfaces))
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(surfaces), len(columns), sharex=True, squeeze=False)
    for axes in grid.ravel():
        axes.set_visible(False)
    for one in maps:
        axes = grid[surfaces.index(one.surface), columns.index(one.controller)]
        axes.set_visible(True)
        _draw_map(axes, one, lines)
        _draw_limits(axes, one, (limits or {}).get((one.surface, one.controller), ()))
        _draw_experiments(axes, of_map(experiments, one))
        axes.set_title(one.title, fontsize=10)
    highest = max(axes.get_ylim()[1] for axes in grid.ravel() if axes.get_visible())
    for axes in grid.ravel():
        axes.set_ylim(top=highest)
    for axes in grid[-1]:
        axes.set_xlabel("touchdown speed [m/s]")
    for axes in grid[:, 0]:
        axes.set_ylabel("slope [deg]")
    handles = _handles(maps, short, long, lines, bool(limits), bool(experiments))
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=2 if len(columns) < 3 else 3,
        fontsize=8,
        frameon=False,
    )
    return figure


def _extent(one: LandingMap | ImpulseMap) -> tuple[float, float, float, float]:
    """Edges of the cells: speed, slope."""
    edges = []
    for axis in (one.speeds, one.slopes_deg):
        half = 0.5 * (axis[1] - axis[0]) if len(axis) > 1 else 0.5
        edges += [float(axis[0] - half), float(axis[-1] + half)]
    return edges[0], edges[1], edges[2], edges[3]


def _draw_map(axes: Axes, one: LandingMap, lines: bool) -> None:
    image = np.zeros((len(one.slopes_deg), len(one.speeds), 3))
    for outcome in OUTCOMES:
        image += np.nan_to_num(one.share(outcome))[..., None] * np.array(to_rgb(COLOURS[outcome]))
    axes.imshow(image, origin="lower", aspect="auto", extent=_extent(one), interpolation="nearest")
    for outcome, letter in ((Outcome.FLIPPED, "A"), (Outcome.OTHER, "B")):
        place = _middle(one.likeliest == outcome)
        if place is not None:
            axes.text(
                one.speeds[place[1]], one.slopes_deg[place[0]], letter, fontsize=13, ha="center", va="center"
            )
    if not lines or min(image.shape[:2]) < 2:
        return
    shown = one.landed >= 0.5
    for values, levels, colour, style, unit in (
        (one.mean_distance, _DISTANCES, _DISTANCE_COLOUR, "solid", "m"),
        (one.mean_time, _TIMES, _TIME_COLOUR, (0, (4, 2)), "s"),
    ):
        # Where hardly anything lands a mean says little, and its contours are a tangle.
        known = np.where(shown & np.isfinite(values), values, np.nan)
        inside = [
            level
            for level in levels
            if np.nanmin(known, initial=np.inf) < level < np.nanmax(known, initial=0)
        ]
        if not inside:
            continue
        drawn = axes.contour(
            one.speeds, one.slopes_deg, np.ma.masked_invalid(known), levels=inside,
            colors=colour, linestyles=[style], linewidths=1.1,
        )  # fmt: skip
        axes.clabel(drawn, fmt=lambda level, unit=unit: f"{level:g} {unit}", fontsize=7)


def _draw_limits(axes: Axes, one: LandingMap, limits: Sequence[tuple[float, str]]) -> None:
    """Draw the limits within reach as lines; name those above at the upper edge."""
    low, high = _extent(one)[2:]
    axes.set_ylim(low, high)
    above = []
    for slope, style in limits:
        if slope <= high + _ROOM:
            axes.axhline(slope, color=_LIMIT_COLOUR, linestyle=style, linewidth=1.6)
            axes.set_ylim(low, max(axes.get_ylim()[1], slope + 1.0))
        else:
            above.append(f"{slope:.0f}° ({'rigid' if style == 'dashed' else 'bending'} legs)")
    if above:
        axes.text(
            0.98, 0.91, f"static limit above: {', '.join(above)}", transform=axes.transAxes,
            ha="right", va="top", fontsize=8, color=_LIMIT_COLOUR,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )  # fmt: skip


def _middle(cells: NDArray[np.bool_]) -> tuple[int, int] | None:
    """The cell of a zone that lies deepest in it, None where the zone is too small for a letter."""
    from scipy.ndimage import distance_transform_edt

    if cells.sum() < 0.02 * cells.size:
        return None
    depth = distance_transform_edt(np.pad(cells, 1))[1:-1, 1:-1]
    row, column = np.unravel_index(int(np.argmax(depth)), cells.shape)
    return int(row), int(column)


def _draw_experiments(axes: Axes, chosen: Sequence[Experiment]) -> None:
    for words, marker, colour in (
        (("short", "landed"), "o", COLOURS[Outcome.SHORT]),
        (("near",), "s", COLOURS[Outcome.NEAR]),
        (("flipped",), "^", COLOURS[Outcome.FLIPPED]),
        (("other",), "D", COLOURS[Outcome.OTHER]),
        (("failed",), "X", "#D55E00"),
    ):
        points = np.array([(e.speed, e.slope_deg) for e in chosen if e.outcome in words]).reshape(-1, 2)
        axes.scatter(
            points[:, 0], points[:, 1], marker=marker, color=colour, edgecolors="black", linewidths=0.8, s=28,
            zorder=4,
        )  # fmt: skip


def _handles(
    maps: Sequence[LandingMap], short: float, long: float, lines: bool, limits: bool, experiments: bool
) -> list[Patch | Line2D]:
    names = {
        Outcome.SHORT: f"at rest within {100 * short:g} cm",
        Outcome.NEAR: f"at rest within {long:g} m",
        Outcome.FLIPPED: f"A: flipped within {long:g} m",
        Outcome.OTHER: "B: neither",
    }
    handles: list[Patch | Line2D] = [
        Patch(facecolor=COLOURS[outcome], edgecolor="black", linewidth=0.5, label=name)
        for outcome, name in names.items()
    ]
    if lines:
        handles.append(Line2D([], [], color=_DISTANCE_COLOUR, label="mean distance to rest"))
        handles.append(Line2D([], [], color=_TIME_COLOUR, linestyle=(0, (4, 2)), label="mean time to rest"))
    if limits:
        handles.append(
            Line2D([], [], color=_LIMIT_COLOUR, linestyle="dashed", label="static limit, rigid legs")
        )
        handles.append(
            Line2D([], [], color=_LIMIT_COLOUR, linestyle="dotted", label="static limit, bending legs")
        )
    if experiments:
        handles.append(
            Line2D(
                [], [], color="white", marker="o", markeredgecolor="black", label="real landings, by outcome"
            )
        )
    count = max((len(one.sets) for one in maps), default=0)
    handles.append(Line2D([], [], linestyle="none", label=f"{count} set{'s' if count != 1 else ''} per map"))
    return handles


def figure_impulse(best: Sequence[ImpulseMap], *, refined: bool = False) -> Figure:
    """Draw the best impulse: a row per surface; mean and σ over the sets of delay and duration."""
    shown = ("mean", "sigma") if any(len(one.sets) > 1 for one in best) else ("mean",)
    columns = [(which, name) for name in ("delay", "duration") for which in shown]
    figure = Figure(figsize=(0.5 + 3.5 * len(columns), 0.9 + 3.1 * len(best)), layout="constrained")
    grid = figure.subplots(len(best), len(columns), sharex=True, sharey=True, squeeze=False)
    for row, one in zip(grid, best, strict=True):
        for axes, (which, name) in zip(row, columns, strict=True):
            full = f"refined_{name}" if refined else name
            values = 1e3 * (one.mean(full) if which == "mean" else one.sigma(full))
            top = (260.0 if name == "delay" else 160.0) if which == "mean" else 100.0
            drawn = axes.imshow(
                values, origin="lower", aspect="auto", extent=_extent(one), interpolation="nearest",
                cmap="viridis", vmin=0.0, vmax=top,
            )  # fmt: skip
            beyond = "max" if values.max() > top else "neither"
            axes.figure.colorbar(drawn, ax=axes, extend=beyond)
            what = f"{name}, {'mean' if which == 'mean' else 'σ'} [ms]"
            axes.set_title(f"{one.surface.upper()}: {what}", fontsize=10)
            axes.set_xlabel("touchdown speed [m/s]")
        row[0].set_ylabel("slope [deg]")
    return figure
