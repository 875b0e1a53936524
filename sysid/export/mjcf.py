"""A landing gear as a MuJoCo model (MJCF): one set, planar, or with four single legs in space.

Body and legs are MuJoCo bodies, each leg on a hinge (bending) and a slide (its axis) with the set's springs
and dampers; equations (5, 6, 11, 12) of the gear's model hold exactly but for MuJoCo's time step. Values of a
set are of leg *pairs*: the planar model has one leg per pair, the model in space two legs of half the
stiffness, damping, mass and inertia each. ``custom/numeric`` has the whole set by name [SI] as well.

Contact
-------
MuJoCo has no springs between feet and ground; it solves for forces that give the contact a reference
acceleration. With ``A`` the inverse mass that MuJoCo assumes for a foot (``body_invweight0`` of its leg),
``d`` the impedance (``solimp``), ``a_0`` the acceleration without contact, and solref = (-s, -c), its force
on a penetration ``p`` is::

    F_n = (s p + c p' - d a_0)/A        within d |A_contact - A|/A of it

so ``s = k_s A``, ``c = b_s A`` and a small constant ``d`` make it the spring and damper of equation (7),
except that the damper acts while the foot comes out as well. Friction has a reference
(``solreffriction``, rate ``B``) and regularization ``R = A (1 - d)/(d impratio)``: below the cone
``mu_k F_n`` a slipping foot feels ``B v/R``. Low friction (8) wants ``mu_k N_0/eps_v`` near zero slip, with
the standing drone's load ``N_0``; MuJoCo's slope cannot follow the load of a bounce. That is all that
separates a drop from the kernel's: with (8) as an applied force 0.1 to 0.2 % NRMSE is left
(tests/benchmarks/engine.md). On the six sample drops, whose noise costs 8.2 %, the truth scores
12.1 % in MuJoCo, 8.31 % there with (8) applied and 8.29 % in the kernel; a steeper slope helps four of the
drops and harms the others. On high friction a foot sticks, but for some 0.05 mm/s of creep.
MuJoCo knows one coefficient: it gets the kinetic one.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.errors import ExportError
from sysid.export.xml import document
from sysid.types import FloatArray

# Impedance of the contacts: the share of the free acceleration that leaks into the force.
_IMPEDANCE = 1e-3
# Time steps to choose from [s]; a foot alone on the ground's spring turns by at most this angle in one [rad].
_TIMESTEPS = (1e-4, 5e-5, 2e-5, 1e-5, 5e-6, 2e-6)
_TURN = 0.25
# Rate at which friction pulls a creeping slip toward its reference [1/s]: slow enough for the time step.
_CREEPING_RATE = 2000.0
# Decay rate of a stuck foot's slip [1/s], as in `sysid.gear.surfaces.high_friction`.
_STICKING_RATE = 200.0
# Regularization ``R`` of friction that sticks, over the inverse mass ``A`` of a foot [1].
_STICKING = 1e-4
_FOOT_RADIUS = 1e-4
# Moment of inertia of a leg along its axis, over the one across the leg [1].
_SLENDER = 0.01

_NEEDED = (
    "body_mass", "body_inertia", "gravity", "foot_dx", "foot_dz", "thrust_point_dx", "joint_dx", "joint_dz",
    "leg_axial_stiffness", "leg_axial_damping", "leg_bending_stiffness", "leg_bending_damping",
    "ground_stiffness", "ground_damping", "leg_mass", "leg_inertia", "leg_mass_fraction", "kinetic_friction",
    "slip_regularization",
)  # fmt: skip


@dataclass(frozen=True)
class _Leg:
    """One leg of the MuJoCo model: a pair in the plane, or half of it; pairs of numbers: spring, damper."""

    name: str
    side: int  # +1 rear, -1 front
    joint: tuple[float, float, float]
    axial: tuple[float, float]
    bending: tuple[float, float]
    ground: tuple[float, float]
    mass: float
    inertia: float

    @property
    def tensor(self) -> tuple[float, float, float]:
        """Moments of inertia across the leg, about pitch, along the leg [kg·m²]."""
        return self.inertia, self.inertia, _SLENDER * self.inertia


def to_mjcf(
    values: Mapping[str, float],
    *,
    name: str = "drone",
    sticks: bool = False,
    slope: float = 0.0,
    per_leg: bool = False,
    timestep: float | None = None,
    notes: Sequence[str] = (),
) -> bytes:
    """Return the MJCF document of one gear set, `values` by name as in `sysid.gear.model.PARAMETERS` [SI].

    Slow feet stick (high friction) or creep (low friction) on a ground of a `slope` [rad], which falls toward
    +x. With `per_leg` there are four legs in space, each with half the values of its pair, instead of one
    planar leg per pair. The `timestep` [s] is by default short enough for the ringing of a foot on the
    ground, 0.1 ms or less; `notes` become comments. ExportError when a value is missing or not finite, or
    the slope is not between -85 and 85 deg.
    """
    wrong = [key for key in _NEEDED if not math.isfinite(values.get(key, math.nan))]
    if wrong:
        raise ExportError(
            f"{name}: {', '.join(wrong)} missing or not finite; a MuJoCo model needs a complete gear set"
        )
    if not abs(slope) < math.radians(85):
        raise ExportError(f"{name}: a slope of {math.degrees(slope):g} deg; give one between -85 and 85 deg")
    legs = _legs(values, per_leg)
    longest = _TURN * min(math.sqrt(leg.mass / leg.ground[0]) for leg in legs)
    step = timestep or next((step for step in _TIMESTEPS if step <= longest), _TIMESTEPS[-1])
    inverse = foot_inverse_mass(values, per_leg).tolist()
    weight = (values["body_mass"] + sum(leg.mass for leg in legs)) * values["gravity"]
    stiff = (1.0 - _IMPEDANCE) / _IMPEDANCE
    if sticks:
        rate, ratio = _STICKING_RATE, stiff / _STICKING
    else:
        rate, standing = _CREEPING_RATE, values["kinetic_friction"] * weight / len(legs)
        ratio = inverse[0] * stiff * standing / values["slip_regularization"] / rate
    x, (length, angle) = values["thrust_point_dx"], _at_rest(values)
    # A motor is above every leg in space, a pair of motors at each end in the plane.
    thrust_points = {
        leg.name: (-leg.side * x, math.copysign(x, leg.joint[1]) if per_leg else 0.0, 0.0) for leg in legs
    }
    height = values["foot_dx"] * abs(math.tan(slope)) + values["foot_dz"]
    place = (0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0) if per_leg else (0.0, height, 0.0)
    return document(
        "mjcf.xml.j2",
        values={key: value for key, value in values.items() if math.isfinite(value)},
        name=name, notes=list(notes),
        slope=slope, per_leg=per_leg, timestep=step, impratio=ratio, friction_rate=rate,
        sticks=sticks,
        impedance=_IMPEDANCE, foot_radius=_FOOT_RADIUS, legs=legs, thrust_points=thrust_points,
        solref=[(-leg.ground[0] * a, -leg.ground[1] * a) for leg, a in zip(legs, inverse, strict=True)],
        body_inertia=_body_inertia(values, per_leg), rest_angle=angle,
        leg_length=length, leg_centre=-(1.0 - values["leg_mass_fraction"]) * length,
        start=place + (0.0,) * (2 * len(legs)), hover=(weight / len(legs),) * len(legs),
        sink=1e3 * weight / len(legs) / legs[0].ground[0],
    )  # fmt: skip


def foot_inverse_mass(values: Mapping[str, float], per_leg: bool = False) -> FloatArray:
    """Return the inverse mass (n_legs,) [1/kg] that MuJoCo assumes at each leg: its ``body_invweight0``.

    A third of the trace of ``J M⁻¹ Jᵀ`` in the rest pose, J being the Jacobian of the leg's centre of mass;
    in the planar model the direction y contributes nothing.
    """
    legs = _legs(values, per_leg)
    base = 6 if per_leg else 3
    count = base + 2 * len(legs)
    axes = np.eye(3)
    pitch = axes[1]

    def moves(point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Jacobians (3, count) of the velocity of a point of the body, and of its rotation."""
        v, w = np.zeros((3, count)), np.zeros((3, count))
        if per_leg:
            v[:, :3], w[:, 3:6] = axes, axes
            v[:, 3:6] = np.cross(axes, point).T
        else:
            v[:, 0], v[:, 1] = axes[0], axes[2]
            v[:, 2], w[:, 2] = np.cross(pitch, point), pitch
        return v, w

    v, w = moves(np.zeros(3))
    inertia = np.diag(_body_inertia(values, per_leg))
    mass = values["body_mass"] * v.T @ v + w.T @ inertia @ w
    length, angle = _at_rest(values)
    places = []
    for n, leg in enumerate(legs):
        turn = leg.side * angle
        along = np.array([math.sin(turn), 0.0, math.cos(turn)])
        arm = -(1.0 - values["leg_mass_fraction"]) * length * along
        v, w = moves(np.array(leg.joint) + arm)
        hinge, slide = base + 2 * n, base + 2 * n + 1
        v[:, hinge], w[:, hinge] = leg.side * np.cross(pitch, arm), leg.side * pitch
        v[:, slide] = -along
        across = np.array([math.cos(turn), 0.0, -math.sin(turn)])
        axes_of_leg = np.column_stack([across, pitch, along])
        tensor = axes_of_leg @ np.diag(leg.tensor) @ axes_of_leg.T
        mass = mass + leg.mass * v.T @ v + w.T @ tensor @ w
        places.append(v)
    inverse = np.linalg.inv(mass)
    return np.array([np.trace(v @ inverse @ v.T) / 3.0 for v in places])


def _legs(values: Mapping[str, float], per_leg: bool) -> list[_Leg]:
    """Return the legs, rear first; one per pair, or two with half of the pair each."""
    share = 0.5 if per_leg else 1.0
    hands = {"_left": values["foot_dx"], "_right": -values["foot_dx"]} if per_leg else {"": 0.0}

    def leg(end: str, side: int, hand: str) -> _Leg:
        def of(row: str) -> float:
            ratio = 1.0 if side > 0 else values.get(f"front_leg_{row}_ratio", 1.0)
            return share * values[f"leg_{row}"] * ratio

        return _Leg(
            end + hand, side, (-side * values["joint_dx"], hands[hand], -values["joint_dz"]),
            (of("axial_stiffness"), of("axial_damping")), (of("bending_stiffness"), of("bending_damping")),
            (share * values["ground_stiffness"], share * values["ground_damping"]), of("mass"), of("inertia"),
        )  # fmt: skip

    return [leg(end, side, hand) for end, side in (("rear", 1), ("front", -1)) for hand in hands]


def _at_rest(values: Mapping[str, float]) -> tuple[float, float]:
    """Return a leg's length [m] and its angle from the body [rad] at rest."""
    across, down = values["foot_dx"] - values["joint_dx"], values["foot_dz"] - values["joint_dz"]
    return math.hypot(across, down), math.atan2(across, down)


def _body_inertia(values: Mapping[str, float], per_leg: bool) -> tuple[float, float, float]:
    pitch = values["body_inertia"]
    return (pitch, pitch, 2.0 * pitch) if per_leg else (pitch, pitch, pitch)
