"""The model drawn small beside the verdict: a few lines of SVG in the colours of the page."""

from __future__ import annotations

import math
from collections.abc import Mapping

from sysid.report.html import Html

_STYLE = 'fill="none" stroke="currentColor" stroke-width="2.4" stroke-linecap="round" stroke-linejoin="round"'

_LETTER = 'stroke="none" fill="currentColor"'


def gear_sketch(values: Mapping[str, float], slope: float) -> Html:
    """Return the drone on its slope [rad], to scale: body, legs with springs at their joints, values [SI]."""
    v = {
        name: 1e3 * values[name] for name in ("joint_dx", "joint_dz", "foot_dx", "foot_dz", "thrust_point_dx")
    }
    arm, foot = v["thrust_point_dx"], v["foot_dz"]
    wide, high = 3.1 * arm, foot + 1.45 * arm
    angle = math.degrees(min(max(slope, 0.14), 0.38))
    parts = [f'<path d="M{-1.5 * arm:.0f} {foot:.0f}H{1.5 * arm:.0f}" stroke="var(--c-soil-edge)"/>']
    # A soil of short strokes below the surface.
    for k in range(-12, 13, 2):
        parts.append(
            f'<path d="M{k * arm / 9:.0f} {foot:.0f}l{-arm / 18:.0f} {arm / 14:.0f}" '
            'stroke="var(--c-soil-edge)" stroke-width="1.2"/>'
        )
    for side in (-1, 1):
        jx, jz, fx = side * v["joint_dx"], v["joint_dz"], side * v["foot_dx"]
        parts.append(f'<path d="{_spring(jx, jz, fx, foot)}" stroke="var(--c-best)"/>')
        parts.append(f'<circle cx="{jx:.0f}" cy="{jz:.0f}" r="6" fill="var(--paper)"/>')
        parts.append(f'<circle cx="{fx:.0f}" cy="{foot:.0f}" r="5" fill="currentColor"/>')
        x, top = side * arm, -0.16 * arm
        parts.append(f'<path d="M{x:.0f} 0V{top:.0f}M{x - 0.42 * arm:.0f} {top:.0f}h{0.84 * arm:.0f}"/>')
    parts.append(f'<path d="M{-arm:.0f} 0H{arm:.0f}" stroke-width="4"/>')
    parts.append(
        f'<path d="M{-v["joint_dx"]:.0f} {v["joint_dz"]:.0f}L{-0.35 * arm:.0f} {-0.12 * arm:.0f}'
        f'H{0.35 * arm:.0f}L{v["joint_dx"]:.0f} {v["joint_dz"]:.0f}Z" fill="var(--c-body)"/>'
    )
    parts.append('<circle r="4.5" fill="currentColor"/>')
    words = f"side view of the landing gear on a slope of {math.degrees(slope):.0f} degrees: two sprung legs"
    return _svg(words, (-wide / 2, -0.75 * arm, wide, high), f'<g transform="rotate({angle:.1f})">', parts)


def motor_sketch() -> Html:
    """Return the model of a motor: a voltage, winding resistance and inductance, back-emf and a propeller."""
    coil = "".join("a7 7 0 0 1 14 0" for _ in range(4))
    parts = [
        '<path d="M20 150V96M20 84V40H52"/><path d="M8 96H32M13 84H27" stroke-width="3"/>',
        '<path d="M52 40l5-9 9 18 9-18 9 18 9-18 5 9" stroke="var(--c-best)"/><path d="M98 40h14"/>',
        f'<path d="M112 40{coil}" stroke="var(--c-best)"/><path d="M168 40H196V68M196 122V150H20"/>',
        '<circle cx="196" cy="95" r="27" fill="var(--c-body)"/><path d="M223 95h37" stroke-width="4"/>',
        '<ellipse cx="264" cy="62" rx="7" ry="33"/><ellipse cx="264" cy="128" rx="7" ry="33"/>',
        '<path d="M286 95h26m-9-7l9 7l-9 7" stroke="var(--c-blue)"/>',
    ]
    for x, y, letter in ((75, 22, "R"), (140, 22, "L"), (196, 102, "e"), (48, 95, "u"), (300, 84, "T")):
        parts.append(f'<text x="{x}" y="{y}" text-anchor="middle" {_LETTER}>{letter}</text>')
    words = "circuit of the motor: voltage, resistance, inductance, back-emf; propeller with its thrust"
    return _svg(words, (0, 8, 322, 152), '<g font-size="19" font-style="italic">', parts)


def _spring(x0: float, y0: float, x1: float, y1: float) -> str:
    """Return the path of a zigzag between two points."""
    length = math.hypot(x1 - x0, y1 - y0)
    along = ((x1 - x0) / length, (y1 - y0) / length)
    marks = [
        (0.0, 0),
        (0.25, 0),
        *((0.3 + 0.075 * k, 7 if k % 2 else -7) for k in range(6)),
        (0.75, 0),
        (1.0, 0),
    ]
    points = (
        f"{x0 + share * (x1 - x0) - off * along[1]:.1f} {y0 + share * (y1 - y0) + off * along[0]:.1f}"
        for share, off in marks
    )
    return "M" + "L".join(points)


def _svg(words: str, box: tuple[float, float, float, float], group: str, parts: list[str]) -> Html:
    view = " ".join(f"{side:.0f}" for side in box)
    return Html(
        f'<svg role="img" aria-label="{words}" viewBox="{view}" {_STYLE}>{group}{"".join(parts)}</g></svg>'
    )
