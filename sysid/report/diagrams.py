"""Diagrams of the model: what a lab must measure (Fig. 2), how feet stick and slip (Fig. 5), a sketch."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, FancyBboxPatch

from sysid.gear.surfaces import high_friction
from sysid.report.drawing import Point, Style, arrow, directions, draw_line, panel
from sysid.report.drop_replay import DroneShape, DropReplay, drone_of
from sysid.report.html import Html
from sysid.report.snapshots import BODY, FRICTION, NORMAL, draw_drone, draw_slope
from sysid.types import FloatArray

_DIMENSION, _WEIGHT, _THRUST, _AXES = "#009E73", "#7A5195", "#E69F00", "#555555"
# States of the rear and the front foot, by the mode of the drone on high friction.
_FEET = {
    "both slip": ("slips", "slips"),
    "rear sticks": ("sticks", "slips"),
    "front sticks": ("slips", "sticks"),
    "both stick": ("sticks", "sticks"),
}


def gear_sketch(values: Mapping[str, float], slope: float) -> Html:
    """Return the drone on its slope [rad], to scale, in the colours of a page: values [SI]."""
    drone = drone_of(values, 1e3)
    arm, foot = drone.rods[0, 1, 0], -drone.feet[1, 1]

    def path(points: FloatArray, look: str = "") -> str:
        return f'<path d="M{"L".join(f"{x:.0f} {-z:.0f}" for x, z in points)}{look}"/>'

    far = 3 * arm
    soil = np.array([[-far, -foot], [far, -foot], [far, -foot - far], [-far, -foot - far]])
    parts = [path(soil, 'Z" fill="var(--c-soil)" stroke="var(--c-soil-edge)')]
    for leg in np.stack([drone.joints, drone.feet], axis=1):
        parts.append(path(leg, '" stroke="var(--c-best)'))
        parts.append(f'<circle cx="{leg[1, 0]:.0f}" cy="{foot:.0f}" r="5" fill="currentColor"/>')
    parts += [path(rod) for rod in drone.rods]
    parts += [path(drone.hull, 'Z" fill="var(--c-body)'), '<circle r="4.5" fill="currentColor"/>']
    words = f"side view of the landing gear on a slope of {math.degrees(slope):.0f} degrees: two sprung legs"
    box = f"{-1.55 * arm:.0f} {-0.75 * arm:.0f} {3.1 * arm:.0f} {foot + 1.45 * arm:.0f}"
    drawn = math.degrees(min(max(slope, 0.14), 0.38))
    return Html(
        f'<svg role="img" aria-label="{words}" viewBox="{box}">'
        f'<g stroke-width="4" transform="rotate({drawn:.1f})">{"".join(parts)}</g></svg>'
    )


def figure_geometry(values: Mapping[str, float], slope: float) -> Figure:
    """Draw frames, lengths and forces of the planar model (Fig. 2), to scale: values [SI], slope [rad]."""
    drone = drone_of(values, 1e3)
    # The figure is no wider than a phone shows it, so letters keep their size.
    figure, axes = panel(4.1)
    axes.set_aspect("equal")
    axes.set_axis_off()
    angle = float(np.clip(slope, np.radians(8.0), np.radians(22.0)))
    along, normal = directions(angle)
    unit, arm = -drone.feet[1, 1], drone.rods[0, 1, 0]
    draw_slope(axes, angle, 4 * unit, drone.feet[0])
    draw_drone(axes, drone, np.zeros(3), drone.feet, BODY, "#DDDDDD", 2.0, zorder=3)
    axes.plot(*drone.joints.T, "o", markersize=6, color="white", markeredgecolor=BODY, zorder=4)
    axes.plot(0, 0, marker="o", markersize=6, color="black", zorder=5)
    for (x, top), name, way in zip(drone.rods[1:3, 1], (r"$T_r$", r"$T_f$"), ("right", "left"), strict=True):
        arrow(axes, (x, top), (x, top + 0.42 * unit), _THRUST)
        _write(axes, (x + math.copysign(8, x), 0.5 * unit), name, _THRUST, ha=way, va="baseline")
    _lengths(axes, drone, unit, arm)
    _forces(axes, drone, unit, along, normal)
    _frames(axes, drone, unit, along, normal)
    axes.set_xlim(-arm - 0.62 * unit, arm + 0.82 * unit)
    axes.set_ylim(-1.85 * unit, 1.35 * unit)
    return figure


def _lengths(axes: Axes, drone: DroneShape, unit: float, arm: float) -> None:
    def dimension(start: tuple[float, float], end: tuple[float, float]) -> None:
        arrow(axes, start, end, _DIMENSION, 0.9, zorder=5, arrowstyle="<|-|>", mutation_scale=7)

    joint, foot = drone.joints[1], drone.feet[1]
    draw_line(axes, [(0, 0.55 * unit), (0, 1.17 * unit)], _DIMENSION, 0.6)
    for level, (x, low), symbol in ((0.72, joint, "dx_j"), (0.92, foot, "dx_f"), (1.12, (arm, 0.0), "dx_m")):
        z = level * unit
        draw_line(axes, [(x, low), (x, z + 0.05 * unit)], _DIMENSION, 0.6, zorder=1)
        dimension((0, z), (x, z))
        _write(axes, (-6, z), f"${symbol}$ = {x:.0f} mm", _DIMENSION, fontsize=8)
    # The depth of the feet on the left, of the joints on the right.
    left: Style = {"rotation": 90}
    for side, x, (start, z), symbol, height, look in (
        (-1, -arm - 0.3 * unit, drone.feet[0], "dz_f", 0.3, left),
        (1, arm + 0.12 * unit, joint, "dz_j", 0.5, {"ha": "left"}),
    ):
        draw_line(axes, [(x, 0), (side * arm, 0)], _DIMENSION, 0.6, zorder=1)
        draw_line(axes, [(x, z), (start, z)], _DIMENSION, 0.6, zorder=1)
        dimension((x, 0), (x, z))
        _write(axes, (x + 5 * side, height * z), f"${symbol}$ = {-z:.0f} mm", _DIMENSION, fontsize=8, **look)


def _forces(axes: Axes, drone: DroneShape, unit: float, along: FloatArray, normal: FloatArray) -> None:
    arrow(axes, (0, 0), (0, -0.5 * unit), _WEIGHT)
    # The words stand left of the arrow, because the angle of the leg is written on its right.
    _write(axes, (-6, -0.5 * unit), r"$m_B\,g$", _WEIGHT)
    joint, rear = drone.joints[1], drone.feet[0]
    middle = 0.5 * (joint + drone.feet[1])
    arrow(axes, middle, (middle[0], middle[1] - 0.34 * unit), _WEIGHT)
    _write(axes, (middle[0] - 5, middle[1] - 0.32 * unit), r"$m_{leg}\,g$", _WEIGHT)
    arrow(axes, rear, rear + 0.5 * unit * normal, NORMAL)
    tip = rear + 0.52 * unit * normal
    _write(axes, (tip[0] + 2, tip[1]), r"$F_n$", NORMAL, ha="left")
    arrow(axes, rear, rear - 0.42 * unit * along, FRICTION)
    tip = rear - 0.46 * unit * along
    _write(axes, (tip[0], tip[1] + 0.07 * unit), r"$F_t$", FRICTION, va="bottom")
    thin = {"arrowstyle": "-", "color": "0.5", "linewidth": 0.7, "shrinkB": 4}
    beside = (drone.rods[0, 1, 0] + 0.12 * unit, -0.42 * unit)
    for words, what, place in (
        ("axial: $k_h$, $b_h$\nbending: $k_t$, $b_t$", joint, beside),
        ("ground: $k_s$, $b_s$, $\\mu$", rear, (rear[0] + 0.3 * unit, rear[1] - 0.55 * unit)),
    ):
        axes.annotate(words, tuple(what), place, fontsize=8, va="center", ha="left", arrowprops=thin)


def _write(axes: Axes, place: Point, words: str, colour: str, **look: Any) -> None:
    """Write words at a place, by default to its left."""
    chosen: Style = {"fontsize": 9, "ha": "right", "va": "center"} | look
    axes.text(float(place[0]), float(place[1]), words, color=colour, **chosen)


def _frames(axes: Axes, drone: DroneShape, unit: float, along: FloatArray, normal: FloatArray) -> None:
    size = 0.3 * unit
    up, right = np.array([0.0, 1.0]), np.array([1.0, 0.0])
    rear, foot = drone.feet
    _axes(axes, rear + (2 * foot[0] + 0.12 * unit) * along, along, normal, size, "A")
    corner = drone.rods[0, 0] + [-0.5 * unit, rear[1] - 0.6 * unit]
    _axes(axes, corner, right, up, size, "N")
    _axes(axes, np.zeros(2), right, up, size, "B")
    for joint, end, aside, name in (
        (drone.joints[0], rear, np.array([-0.62, 0.12]), "C"),
        (drone.joints[1], foot, np.array([0.3, -0.08]), "D"),
    ):
        # Along the leg and across it, drawn beside the leg on its outer side.
        z = (joint - end) / np.hypot(*(joint - end))
        middle = 0.5 * (joint + end) + unit * aside
        _axes(axes, middle, np.array([z[1], -z[0]]), z, 0.8 * size, name)
    # The angle at rest, from straight down to the leg, at the front joint.
    angle = float(np.degrees(np.arctan2(foot[0] - joint[0], joint[1] - foot[1])))
    x, z = map(float, joint)
    draw_line(axes, [(x, z), (x, z - 0.5 * unit)], _DIMENSION, 0.6, linestyle="--")
    size = 0.8 * unit
    axes.add_patch(Arc((x, z), size, size, theta1=-90, theta2=-90 + angle, color=_DIMENSION))
    _write(axes, (x - 3, z - 0.62 * unit), f"$q_n$ = {angle:.0f}°", _DIMENSION, fontsize=8)


def _axes(axes: Axes, origin: FloatArray, x: FloatArray, z: FloatArray, size: float, name: str) -> None:
    for way, symbol in ((x, "x"), (z, "z")):
        arrow(axes, origin, origin + size * way, _AXES, 1.2)
        place = origin + 1.22 * size * way
        if way is x and name in "AB":  # below the slope's line and the arms, not on them
            place = place - 0.3 * size * z
        words = rf"$\hat{{{symbol}}}_{name}$"
        _write(axes, place, words, _AXES, fontsize=8.5, ha="center")


def foot_transitions() -> tuple[tuple[str, str, str], ...]:
    """Ask the compiled law what a foot does at its events: (mode before, condition, mode after).

    The functions that switch modes in every simulation are called with a foot in each situation.
    """
    mu_k, mu_s, normal = 0.8, 0.9, 10.0
    names, out = ("slips", "sticks"), []
    # Two feet whose slip has just passed zero, then two stuck ones, on both sides of each condition.
    for stuck, slip, margin, required, condition in (
        (0.0, -1e-3, 0.1, 0.5 * mu_k * normal, r"$v_t \to 0$ and $\mu_k F_n > |f_{req}|$"),
        (0.0, -1e-3, 0.1, 1.5 * mu_k * normal, r"$v_t \to 0$ but $\mu_k F_n \leq |f_{req}|$"),
        (1.0, 0.0, 0.5, 1.1 * mu_s * normal, r"$\mu_s F_n < |f_{req}|$"),
        (1.0, 0.0, 0.5, 0.9 * mu_s * normal, r"$\mu_s F_n \geq |f_{req}|$"),
    ):
        foot = (stuck, 1.0, normal, slip, required, margin)
        now, lost, _ = high_friction.event(*foot, mu_s)
        after, _, _ = high_friction.next_mode(lost, *foot, now, 1.0, mu_k)
        out.append((names[int(stuck)], condition, names[int(after)]))
    return tuple(out)


def mode_shares(drops: Sequence[DropReplay]) -> dict[str, float]:
    """Return the share of time in each mode while a foot is down, from samples of a millisecond."""
    counts = dict.fromkeys(_FEET, 0)
    for drop in drops:
        grounded = (np.nan_to_num(drop.normal_force) > 0.0).any(axis=1)
        for mode, feet in _FEET.items():
            stuck = np.array([foot == "sticks" for foot in feet])
            counts[mode] += int(np.sum(grounded & (drop.sticks == stuck).all(axis=1)))
    total = sum(counts.values())
    return {mode: count / total for mode, count in counts.items()} if total else {}


def figure_modes(shares: Mapping[str, float] | None = None) -> Figure:
    """Draw the four modes of a pair of feet and the transitions that the code makes (Fig. 5).

    `shares` of the time in each mode are written into it.
    """
    figure, axes = panel(4.4, 4.9)
    axes.set_axis_off()
    places = dict(zip(_FEET, ((0.0, 0.0), (1.0, 1.0), (1.0, -1.0), (2.0, 0.0)), strict=True))
    for mode, (x, y) in places.items():
        look: Style = {"facecolor": "white", "edgecolor": BODY, "linewidth": 1.4, "zorder": 3}
        style = "round,pad=0.02,rounding_size=0.1"
        axes.add_patch(FancyBboxPatch((x - 0.36, y - 0.2), 0.72, 0.4, boxstyle=style, **look))
        flight = "\n(also in flight)" if mode == "both slip" and not shares else ""
        share = f"\n{100 * shares[mode]:.0f} % on the ground" if shares else ""
        _write(axes, (x, y), f"{mode}{flight}{share}", "black", ha="center", fontsize=8, zorder=4)
    colours = {("slips", "sticks"): NORMAL, ("sticks", "slips"): FRICTION}
    conditions: dict[str, str] = {}
    for before, condition, after in foot_transitions():
        if before == after:
            continue
        colour = colours[before, after]
        conditions[colour] = f"{before} to {after}: {condition}"
        for start, feet in _FEET.items():
            for foot in (0, 1):
                if feet[foot] != before:
                    continue
                changed = tuple(after if k == foot else feet[k] for k in (0, 1))
                end = next(mode for mode, other in _FEET.items() if other == changed)
                a, b = np.array(places[start]), np.array(places[end])
                way = (b - a) / np.hypot(*(b - a))
                aside = 0.07 * np.array([-way[1], way[0]])
                arrow(axes, a + 0.42 * way + aside, b - 0.42 * way + aside, colour, 1.6, zorder=2)
    for row, (colour, text) in enumerate(conditions.items()):
        _write(axes, (1.0, -1.55 - 0.22 * row), text, colour, ha="center", fontsize=9.5)
    for x, y in ((0.22, 0.74), (1.78, 0.74), (0.22, -0.74), (1.78, -0.74)):
        mover = "rear" if (x < 1) == (y > 0) else "front"
        _write(axes, (x, y), f"{mover} foot", "0.35", ha="center", fontsize=8)
    axes.set(xlim=(-0.5, 2.5), ylim=(-2.0, 1.3))
    return figure
