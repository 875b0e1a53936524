"""The campaign file that goes with synthesized drops: what the lab that recorded them would have written."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

BODY = "F450"
BOARD_MARKERS = ("board-1", "board-2", "board-3")
MARKER_HEIGHT = 7e-3
# From the rigid body's origin to the centre of mass, along the body's axes (capture axes when level) [m].
CENTRE_OF_MASS = (0.004, -0.022, 0.003)


def quantity(value: float, unit: str, scale: float = 1.0) -> str:
    """Return a TOML string of an SI value in a unit that is `scale` times smaller."""
    return f'"{scale * value:.10g} {unit}"'


def _point(values: Sequence[float]) -> str:
    return "[" + ", ".join(quantity(value, "mm", 1e3) for value in values) + "]"


def trial_text(
    number: int, slope: float, impact_speed: float, use: str, log: str, point: Sequence[float] | None = None
) -> str:
    """Return one ``[[trials]]`` table, with a `point` of the surface where its log has no markers."""
    text = (
        "[[trials]]\n"
        f'name = "drop-{number}"\n'
        f'log = "{log}"\n'
        f"slope = {quantity(math.degrees(slope), 'deg')}  # inclinometer; impact near {impact_speed:g} m/s\n"
        f'use = "{use}"\n'
    )
    if point is not None:
        text += f"point = {_point(point)}  # no board markers in this log\n"
    return text


def campaign_text(
    name: str,
    values: Mapping[str, float],
    trials: Sequence[str],
    *,
    surface: str,
    up: str,
    down_slope: str,
    point: Sequence[float] | None,
    seed: int,
) -> str:
    """Return the campaign file; measured values are exact, what is to be identified is not in it."""
    if point is not None:
        where = f"point = {_point(point)}  # on the board's hinge line: on the surface at every slope"
    else:
        named = ", ".join(f'"{marker}"' for marker in BOARD_MARKERS)
        where = (
            f"markers = [{named}]  # on the board\n"
            f"marker_height = {quantity(MARKER_HEIGHT, 'mm', 1e3)}  # of a marker's centre above the surface"
        )
    legs = (
        f"leg_mass = {quantity(values['leg_mass'], 'kg')}  # of the pair of legs at one end\n"
        f"leg_inertia = {quantity(values['leg_inertia'], 'kg·m²')}  # about its own centre of mass\n"
        f"leg_mass_fraction = {values['leg_mass_fraction']:.10g}  # centre of mass, from the foot\n"
    )
    friction = f"kinetic_friction = {values['kinetic_friction']:.10g}  # tilted board: tan(angle)\n"
    if surface != "lf":  # identified there, not measured
        legs = f"leg_mass_fraction = {values['leg_mass_fraction']:.10g}\n"
        friction = ""
    else:
        friction += f"slip_regularization = {quantity(values['slip_regularization'], 'm/s')}\n"
    return f"""\
# Synthesized drops with known truth (truth.json, which no fit reads). Logs as a motion capture exports them.
kind = "gear"
name = "{name}"

[vehicle]
body_mass = {quantity(values["body_mass"], "kg")}  # scale, without the legs
body_inertia = {quantity(values["body_inertia"], "kg·m²")}  # bifilar pendulum, pitch axis
foot_dx = {quantity(values["foot_dx"], "mm", 1e3)}  # centre of mass to foot, legs unloaded
foot_dz = {quantity(values["foot_dz"], "mm", 1e3)}
thrust_point_dx = {quantity(values["thrust_point_dx"], "mm", 1e3)}
{legs}gravity = {quantity(values["gravity"], "m/s²")}

[capture]
rigid_body = "{BODY}"
up = "{up}"
down_slope = "{down_slope}"
centre_of_mass_offset = {_point(CENTRE_OF_MASS)}  # balanced on an edge, from the body's pivot
level = "release"  # the magnet holds it level

[surface]
law = "{surface}"
{friction}{where}
board_length = "1.2 m"

[fit]
runs = 5
seed = {seed}

""" + "\n".join(trials)
