"""What `the-model.ipynb` shows in numbers: where the paper's print cannot be meant, and what shows it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from sysid.gear.model import PARAMETERS as GEAR
from sysid.gear.surfaces.low_friction import low_friction
from sysid.landing.static_limits import slide_limit, tip_limit
from sysid.motor.model import PARAMETERS as MOTOR
from sysid.motor.model import no_load_speed, simulate
from sysid.parameter_sets import ParameterSets
from sysid.report.diagrams import figure_geometry, figure_modes
from sysid.report.html import Html, markup_table
from sysid.report.table import listed

# Constant k_v = k_t as printed in Table I [V·s/rad, N·m/A].
_PRINTED_CONSTANT = 0.099
# Rating of the same motor, which the printed constant contradicts [rpm/V].
_RATING_RPM_PER_VOLT = 960.0
# Reverse thrust that both limits of the paper's text imply [N].
_REVERSE_THRUST = 12.0
# Slope on which the paper's drone slides from rest on low friction [deg].
_PAPER_SLIDES = 22.0
# Symbols of the equations that are no parameters: symbol, unit, meaning.
_VARIABLES = (
    ("u", "1", "command of a motor, −1 (full reverse) to 1"),
    ("V_c", "V", "voltage that the command sets"),
    ("I, I_eff", "A", "current of the winding, and what the controller lets through"),
    ("Ω, Ω_0", "rad/s", "speed of the rotor, and without load"),
    ("T, τ_aero", "N, N·m", "thrust and drag torque of the propeller"),
    ("h", "m", "extension of a leg along itself, 0 at rest"),
    ("q_C, q_D", "rad", "angle of the rear, front leg from the body's z axis"),
    ("q_n", "rad", "that angle at rest, from joints and feet"),
    ("F, M", "N, N·m", "force of a leg on the body along the leg, and moment in its joint"),
    ("p", "m", "depth of a foot below the surface"),
    ("v_t", "m/s", "speed of a foot along the surface, down-slope positive"),
    ("F_n, F_t", "N", "force of the surface on a foot, normal and along it"),
    ("f_req", "N", "friction that would hold a foot where it is"),
    ("x_B, z_B, q_B", "m, m, rad", "place and pitch of the body in frame N"),
)


def misprints(motor_sets: ParameterSets, gear_sets: ParameterSets) -> Html:
    """Return what the paper prints, what must be meant, and the number that decides, computed from sets."""
    motor, gear = motor_sets.set_values(1), gear_sets.set_values(1)
    rating = 60.0 / (2 * math.pi * _RATING_RPM_PER_VOLT)
    inertia = 1e3 * motor["rotor_inertia"] * motor["winding_resistance"]
    full, back_emf = float(no_load_speed(1.0, motor)), motor["back_emf_constant"]
    mu, gravity, regular = gear["kinetic_friction"], gear["gravity"], gear["slip_regularization"]
    force = float(low_friction(gravity, 0.0, 1.0, 0.0, (mu, regular, 0.0, 0.0, 0.0, 0.0))[0])
    rows = [
        (
            f"k_v = k_t = {_PRINTED_CONSTANT:g} (Table I)",
            f"{rating:.5f} V·s/rad, from the rating of {_RATING_RPM_PER_VOLT:g} rpm/V",
            f"time constant I^r R/k²: {inertia / _PRINTED_CONSTANT**2:.1f} ms as printed, "
            f"{inertia / rating**2:.0f} ms as meant; the paper reports about 100 ms",
        ),
        (
            "V_c = Ω_0(u)/K_v (4)",
            "V_c = k_v Ω_0(u)",
            f"at full command {1e-3 * full / back_emf:.0f} kV as printed, with the constant "
            f"of (1), {full * back_emf:.1f} V as meant",
        ),
        (
            "L in kg (Table I)",
            "henry",
            f"L/R = {1e3 * motor['winding_inductance'] / motor['winding_resistance']:.1f} ms, a time",
        ),
        (
            "friction along the slip (8)",
            "against it",
            f"a body that slides level with 1 m/s changes its speed by {force:+.2f} m/s per second; as "
            f"printed by {-force:+.2f}",
        ),
        (
            "ε_v not printed (8)",
            f"{regular:g} m/s, a parameter of the surface",
            f"the law never sticks: at 15° it creeps with {1e3 * _creep(gear, 15.0):.0f} mm/s",
        ),
        (
            "e_v not printed (9)",
            "its limit 0: the end of the slip is located",
            f"below 1 mm/s friction alone, μ_k g = {mu * gravity:.1f} m/s², stops a level slip within "
            f"{1.0 / (mu * gravity):.1f} ms: no speed below which a foot may stick has to be chosen",
        ),
        (
            "k_t twice: Tables I and II",
            "torque constant and bending stiffness",
            f"{gear['leg_bending_stiffness']:g} N·m/rad here",
        ),
    ]
    heads = ("printed", "meant", "the number that decides")
    return markup_table(listed("where the print cannot be meant, and what is missing", rows, heads, texts=3))


def checks(motor: ParameterSets, gear: ParameterSets) -> Html:
    """Compare numbers of the paper with this code's."""
    values = gear.set_values(1)
    weight = (values["body_mass"] + 2 * values["leg_mass"]) * values["gravity"]
    ratio = _REVERSE_THRUST / weight
    slide = math.degrees(slide_limit(values["kinetic_friction"]))
    pressed = math.degrees(slide_limit(values["kinetic_friction"], ratio))
    tip = math.degrees(tip_limit(values["foot_dx"], values["foot_dz"]))
    pressed_tip = math.degrees(tip_limit(values["foot_dx"], values["foot_dz"], ratio))
    delays = [f"{1e3 * reversal_delay(motor, share=share):.0f} ms" for share in (0.9, 0.95, 0.98)]
    same = f"{1e3 * reversal_delay(motor, after=-0.62):.0f} ms"
    creep = 1e3 * _creep(values, _PAPER_SLIDES)
    thrust = f"the thrust is not printed; {_REVERSE_THRUST:g} N is what both limits imply"
    rows = (
        (
            "slides from rest, low friction", f"{_PAPER_SLIDES:g}°", f"{slide:.1f}°",
            "here the closed form atan μ_k; the law (8) itself never holds a drone, and at "
            f"{_PAPER_SLIDES:g}° it creeps with {creep:.0f} mm/s, which is no rest",
        ),
        (f"the same with {_REVERSE_THRUST:g} N of reverse thrust", "48°", f"{pressed:.1f}°", thrust),
        ("tips over, stiff legs", "35°", f"{tip:.1f}°", "rounding"),
        (f"the same with {_REVERSE_THRUST:g} N of reverse thrust", "67°", f"{pressed_tip:.1f}°", thrust),
        (
            "reversal, from 62 % forward to full reverse", "250 ms", delays[0],
            "here until 90 % of the final thrust; the paper prints neither the commands nor the share: until "
            f"95 % it is {delays[1]}, until 98 % {delays[2]}, and {same} from 62 % to −62 % until 90 %",
        ),
    )  # fmt: skip
    heads = ("what", "paper", "here", "why they differ")
    return markup_table(listed("numbers of the paper, and of this code", rows, heads, texts=4))


def reversal_delay(motor: ParameterSets, after: float = -1.0, share: float = 0.9) -> float:
    """Return the time from a reversal command, out of 62 % forward, to a share of the final thrust [s]."""
    # The start lies before the command: a steady start is one under the command that holds there.
    time = np.linspace(-0.1, 1.5, 3201)
    run = simulate(motor.set_values(1), [-1.0, 0.0], [0.62, after], time, initial="steady")
    final = float(run.thrust[-1])
    reached = np.flatnonzero(run.thrust * np.sign(final) >= share * abs(final))
    return float(time[reached[0]])


def diagram(gear: ParameterSets) -> Figure:
    """Return the labelled diagram of a set's drone (Fig. 2)."""
    return figure_geometry(gear.set_values(1), math.radians(18.0))


def modes() -> Figure:
    """Return the modes of the high-friction hybrid (Fig. 5), as the code switches them."""
    return figure_modes()


def symbols(motor: ParameterSets, gear: ParameterSets) -> Html:
    """Return every symbol of the equations with its unit and meaning: what moves, then the parameters."""
    rows = list(_VARIABLES)
    for title, parameters, sets in (("motor", MOTOR, motor), ("gear", GEAR, gear)):
        for parameter in (parameters[name] for name in sets.names if name in parameters):
            # The equations have neither the delays of instruments nor legs that differ.
            if parameter.unit != "s" and "/" not in parameter.symbol:
                meaning = parameter.meaning
                text = f"{title}: {meaning[:1].lower()}{meaning[1:].rstrip('.')}"
                rows.append((parameter.symbol, parameter.unit or "1", text))
    return markup_table(listed("symbols", rows, ("symbol", "unit", "meaning"), texts=3))


def _creep(values: Mapping[str, float], slope_deg: float) -> float:
    """Return the speed at which the low-friction law (8) creeps down a slope that it holds [m/s]."""
    ratio = math.tan(math.radians(slope_deg)) / values["kinetic_friction"]
    return values["slip_regularization"] * ratio / (1 - ratio)
