"""The gear's table of parameters: every number of the planar model, once, with its unit and source."""

import math

from sysid.parameters import Parameter, ParameterTable

_MEASURED = "Table II, measured"
_LF = "Table II, low friction, mean of five fits; bounds guessed"
# Numbers of the capture that a fit may move (`sysid.gear.stated`), without the drop.
CAPTURED = (
    "slope", "release_delay", "centre_of_mass_dx", "centre_of_mass_dz", "surface_dx", "surface_dz",
    "capture_tilt",
)  # fmt: skip


# fmt: off
def _front(what: str, symbol: str, meaning: str) -> Parameter:
    """Ratio that lets the front legs differ from the rear ones, which the table's other rows describe."""
    return Parameter(f"front_leg_{what}_ratio", f"{symbol},D/{symbol},C", "1", 1.0, 0.5, 2.0, "log",
                     f"Front over rear pair of legs: {meaning}.",
                     "1: equal legs, as in the paper; bounds guessed", "front leg")


def _term(name: str, symbol: str, unit: str, upper: float, meaning: str) -> Parameter:
    """Size of a term that the paper's gear lacks (`sysid.gear.kernel.terms`), zero by default."""
    return Parameter(name, symbol, unit, 0.0, 0.0, upper, "linear", meaning,
                     "0: none, as in the paper; bounds guessed", "term")


PARAMETERS = ParameterTable(
    [
        Parameter("body_mass", "m_B", "kg", 1.242, 0.1, 10.0, "log",
                  "Mass without legs.", _MEASURED, "vehicle"),
        Parameter("body_inertia", "I_B", "kg·m²", 0.0137, 1e-4, 1.0, "log",
                  "Moment of inertia of the body about its pitch axis.", _MEASURED, "vehicle"),
        Parameter("gravity", "g", "m/s²", 9.81, 9.7, 9.9, "linear", "Gravity.", "standard value", "gravity"),
        Parameter("foot_dx", "dx_f", "m", 0.105, 0.02, 0.5, "linear",
                  "Horizontal distance of the feet at rest from the centre of mass.", _MEASURED, "vehicle"),
        Parameter("foot_dz", "dz_f", "m", 0.151, 0.02, 0.5, "linear",
                  "Depth of the feet at rest below the centre of mass.", _MEASURED, "vehicle"),
        Parameter("thrust_point_dx", "dx_m", "m", 0.225 * math.cos(math.pi / 4), 0.02, 1.0, "linear",
                  "Horizontal distance of the motor pairs from the centre of mass.",
                  "F450 in X configuration, arms of 0.225 m", "vehicle"),
        Parameter("joint_dx", "dx_j", "m", 0.088, 0.040, 0.100, "linear",
                  "Horizontal distance of the leg joints from the centre of mass.", _LF, "leg"),
        Parameter("joint_dz", "dz_j", "m", 0.024, 0.0, 0.060, "linear",
                  "Depth of the leg joints below the centre of mass.", _LF, "leg"),
        Parameter("leg_axial_stiffness", "k_h", "N/m", 6440.0, 2000.0, 12000.0, "log",
                  "Axial spring of a pair of legs (buckling).", _LF, "leg"),
        Parameter("leg_axial_damping", "b_h", "N·s/m", 14.3, 1.0, 40.0, "log",
                  "Axial damper of a pair of legs.", _LF, "leg"),
        Parameter("leg_bending_stiffness", "k_t", "N·m/rad", 10.5, 1.0, 25.0, "log",
                  "Bending spring of a pair of legs.", _LF, "leg"),
        Parameter("leg_bending_damping", "b_t", "N·m·s/rad", 0.056, 0.001, 0.2, "log",
                  "Bending damper of a pair of legs.", _LF, "leg"),
        Parameter("ground_stiffness", "k_s", "N/m", 1.10e5, 2e4, 4e5, "log",
                  "Contact spring of a pair of feet.", _LF, "ground"),
        Parameter("ground_damping", "b_s", "N·s/m", 0.042, 0.001, 10.0, "log",
                  "Contact damper of a pair of feet, active while they go deeper.", _LF, "ground"),
        Parameter("leg_mass", "m_leg", "kg", 0.02, 0.005, 0.05, "log",
                  "Mass of a pair of legs.", f"{_MEASURED}; bounds guessed", "leg"),
        Parameter("leg_inertia", "I_leg", "kg·m²", 2.0e-4, 2e-5, 1e-3, "log",
                  "Moment of inertia of a pair of legs about their centre.",
                  "Table II, calculated; bounds guessed", "leg"),
        Parameter("leg_mass_fraction", "f_leg", "1", 0.5, 0.1, 0.9, "linear",
                  "Distance of a leg's centre of mass from its foot over the leg's length, at rest.",
                  "guess: the middle of the leg", "leg"),
        Parameter("kinetic_friction", "μ_k", "1", 0.44, 0.1, 1.2, "linear",
                  "Kinetic friction coefficient of the feet.",
                  "Table II, measured on UHMW PE; bounds guessed", "friction"),
        Parameter("slip_regularization", "ε_v", "m/s", 0.01, 1e-3, 0.1, "log",
                  "Slip speed at which low friction (8) reaches half of its limit.",
                  "guess: the paper prints none", "friction"),
        Parameter("static_friction_excess", "μ_s − μ_k", "1", 0.08, 0.0, 0.3, "linear",
                  "Static minus kinetic friction coefficient (high friction only).",
                  "Table II, high friction, mean of five fits; bounds guessed", "friction"),
        _front("axial_stiffness", "k_h", "axial spring"),
        _front("axial_damping", "b_h", "axial damper"),
        _front("bending_stiffness", "k_t", "bending spring"),
        _front("bending_damping", "b_t", "bending damper"),
        _front("mass", "m_leg", "mass"),
        _front("inertia", "I_leg", "moment of inertia"),
        Parameter("front_friction_excess", "e_μ", "1", 0.0, -0.5, 0.5, "linear",
                  "Friction of the front feet over the rear ones', less 1.",
                  "0: equal feet, as in the paper; bounds guessed", "front leg"),
        _term("leg_axial_hardening", "κ_h", "1/m²", 3e4, "Rise of the axial spring's stiffness, κ_h h²."),
        _term("leg_bending_hardening", "κ_t", "1/rad²", 150.0, "Rise of the bending spring's."),
        _term("leg_slide_friction", "F_h", "N", 10.0, "Dry friction along a pair of legs."),
        _term("leg_joint_friction", "M_t", "N·m", 0.5, "Dry friction in the joints of a pair of legs."),
        _term("ground_rate_stiffening", "χ_s", "s/m", 3.0, "Rise of the contact force per approach."),
        _term("pitch_drag", "c_q", "N·m·s²", 0.02, "Moment against the body's turning, c_q |q'| q'."),
    ],
    derived=("leg_length", "leg_rest_angle", *CAPTURED),
)
# fmt: on
