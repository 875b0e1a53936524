"""A landing gear as a MuJoCo model (MJCF): one set, planar, or with four single legs in space.

Body and legs are MuJoCo bodies, each leg on a hinge (bending) and a slide (its axis) with the set's springs
and dampers; equations (5, 6, 11, 12) of the gear's model hold exactly but for MuJoCo's time step. Values of a
set are of leg *pairs*: the planar model has one leg per pair, the model in space two legs of half the
stiffness, damping, mass and inertia each. The whole set stands in ``custom/numeric`` by name [SI] as well.

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
the standing drone's load ``N_0``; on high friction a foot sticks, but for some 0.05 mm/s of creep.
MuJoCo knows one coefficient: it gets the kinetic one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from sysid.errors import ExportError
from sysid.export.xml import add, comment, document, parse
from sysid.types import FloatArray

# Impedance of the contacts: the share of the free acceleration that leaks into the force.
_IMPEDANCE = 1e-3
# Time steps to choose from [s]; a foot alone on the ground's spring turns by at most this angle in one [rad].
_TIMESTEPS = (1e-4, 5e-5, 2e-5, 1e-5, 5e-6, 2e-6)
_TURN = 0.25
# Rate at which friction pulls a slip toward its reference [1/s]: slow enough for the time step, and that of
# stuck feet in `sysid.gear.surfaces.high_friction`.
_CREEPING_RATE, _STICKING_RATE = 2000.0, 200.0
# Regularization of friction that sticks, over A.
_STICKING = 1e-4
_FOOT_RADIUS = 1e-4
# A slender leg turns easily about its axis.
_SLENDER = 0.01

_NEEDED = (
    "body_mass", "body_inertia", "gravity", "foot_dx", "foot_dz", "thrust_point_dx", "joint_dx", "joint_dz",
    "leg_axial_stiffness", "leg_axial_damping", "leg_bending_stiffness", "leg_bending_damping",
    "ground_stiffness", "ground_damping", "leg_mass", "leg_inertia", "leg_mass_fraction", "kinetic_friction",
    "slip_regularization",
)  # fmt: skip


@dataclass(frozen=True)
class _Leg:
    """One leg of the MuJoCo model: a pair in the plane, or half of it."""

    name: str
    side: int  # +1 rear, -1 front
    y: float
    axial: tuple[float, float]
    bending: tuple[float, float]
    mass: float
    inertia: float
    ground: tuple[float, float]


def to_mjcf(
    values: Mapping[str, float],
    *,
    name: str = "drone",
    sticks: bool = False,
    slope: float = 0.0,
    per_leg: bool = False,
    timestep: float | None = None,
) -> bytes:
    """Return the MJCF document of one gear set.

    Parameters
    ----------
    values : mapping of str to float
        By name, as in `sysid.gear.model.PARAMETERS` [SI]; rows of leg pairs.
    sticks : bool
        Whether slow feet stick (high friction) or creep (low friction).
    slope : float
        Of the ground [rad], falling toward +x.
    per_leg : bool
        Four legs in space, each with half the values of its pair, instead of one planar leg per pair.
    timestep : float, optional
        [s]; by default short enough for the ringing of a foot on the ground, 0.1 ms or less.

    Raises
    ------
    ExportError
        When a value is missing or not finite, or the slope is not between -85 and 85 deg.
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
    inverse = foot_inverse_mass(values, per_leg)
    load = _weight(values) / len(legs)
    stiff = (1.0 - _IMPEDANCE) / _IMPEDANCE
    if sticks:
        rate, ratio = _STICKING_RATE, stiff / _STICKING
    else:
        rate = _CREEPING_RATE
        ratio = inverse[0] * stiff * values["kinetic_friction"] * load / values["slip_regularization"] / rate
    root = Element("mujoco", model=name)
    comment(root, _ABOUT_SPACE if per_leg else _ABOUT_PLANE)
    add(root, "compiler", angle="radian")
    add(
        root, "option", timestep=step, gravity=(0.0, 0.0, -values["gravity"]), integrator="implicitfast",
        cone="elliptic", impratio=ratio, solver="Newton", iterations=100, tolerance=1e-12,
    )  # fmt: skip
    comment(root, "the whole set, as identified (of leg pairs), SI")
    custom = add(root, "custom")
    for key, value in values.items():
        if math.isfinite(value):
            add(custom, "numeric", name=key, data=value)
    world = add(root, "worldbody")
    add(world, "light", pos=(0.0, -2.0, 3.0), dir=(0.0, 0.5, -1.0))
    comment(world, "the slope: its surface passes through the origin and falls toward +x; euler [rad]")
    add(
        world, "geom", name="slope", type="plane", size=(5.0, 5.0, 0.1), euler=(0.0, slope, 0.0), contype=0,
        conaffinity=0, rgba=(0.8, 0.8, 0.75, 1.0),
    )  # fmt: skip
    _body(world, values, legs, per_leg)
    contact = add(root, "contact")
    comment(contact, "solref = -(k_s A), -(b_s A) with the foot's inverse mass A = body_invweight0 [1/kg]")
    for leg, mobility in zip(legs, inverse, strict=True):
        add(
            contact, "pair", geom1="slope", geom2=f"{leg.name}_foot", condim=3,
            friction=(values["kinetic_friction"],) * 2 + (1e-4, 1e-5, 1e-5),
            solref=(-leg.ground[0] * mobility, -leg.ground[1] * mobility),
            solreffriction=(0.0, -rate * _IMPEDANCE),
            solimp=(_IMPEDANCE, _IMPEDANCE, 1e-3, 0.5, 2.0),
        )  # fmt: skip
    actuator = add(root, "actuator")
    per_site = "one of two motors" if per_leg else "a pair of motors"
    comment(actuator, f"thrust [N] of {per_site} along the body's z axis, negative presses down")
    for site in _thrust_points(values, per_leg):
        add(actuator, "general", name=f"{site}_thrust", site=site, gear=(0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    _keyframe(root, values, legs, slope, per_leg)
    return document(root)


def from_mjcf(data: bytes) -> dict[str, float]:
    """Return the set [SI] that `to_mjcf` wrote into a document; ExportError where there is none."""
    root = parse(data, "a MuJoCo model")
    values = {str(row.get("name")): float(str(row.get("data"))) for row in root.iterfind("custom/numeric")}
    if root.tag != "mujoco" or not values:
        raise ExportError("no MuJoCo model with a parameter set in custom/numeric; export the fit again")
    return values


def foot_inverse_mass(values: Mapping[str, float], per_leg: bool = False) -> FloatArray:
    """Return the inverse mass (n_legs,) [1/kg] that MuJoCo assumes at each leg: its ``body_invweight0``.

    Notes
    -----
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
    places = []
    for n, leg in enumerate(legs):
        turn = leg.side * _rest_angle(values)
        along = np.array([math.sin(turn), 0.0, math.cos(turn)])
        arm = -(1.0 - values["leg_mass_fraction"]) * _length(values) * along
        v, w = moves(_joint(values, leg) + arm)
        hinge, slide = base + 2 * n, base + 2 * n + 1
        v[:, hinge], w[:, hinge] = leg.side * np.cross(pitch, arm), leg.side * pitch
        v[:, slide] = -along
        across = np.array([math.cos(turn), 0.0, -math.sin(turn)])
        axes_of_leg = np.column_stack([across, pitch, along])
        tensor = axes_of_leg @ np.diag(_leg_inertia(leg)) @ axes_of_leg.T
        mass = mass + leg.mass * v.T @ v + w.T @ tensor @ w
        places.append(v)
    inverse = np.linalg.inv(mass)
    return np.array([np.trace(v @ inverse @ v.T) / 3.0 for v in places])


def _legs(values: Mapping[str, float], per_leg: bool) -> list[_Leg]:
    """Return the legs, rear first; one per pair, or two with half of the pair each."""

    def pair(side: int) -> _Leg:
        def of(row: str) -> float:
            ratio = 1.0 if side > 0 else values.get(f"front_leg_{row}_ratio", 1.0)
            return values[f"leg_{row}"] * ratio

        return _Leg(
            "rear" if side > 0 else "front", side, 0.0,
            (of("axial_stiffness"), of("axial_damping")), (of("bending_stiffness"), of("bending_damping")),
            of("mass"), of("inertia"), (values["ground_stiffness"], values["ground_damping"]),
        )  # fmt: skip

    pairs = [pair(1), pair(-1)]
    if not per_leg:
        return pairs
    return [
        _Leg(
            f"{leg.name}_{hand}",
            leg.side,
            y * values["foot_dx"],
            _halved(leg.axial),
            _halved(leg.bending),
            leg.mass / 2,
            leg.inertia / 2,
            _halved(leg.ground),
        )
        for leg in pairs
        for hand, y in (("left", 1.0), ("right", -1.0))
    ]


def _halved(pair: tuple[float, float]) -> tuple[float, float]:
    return pair[0] / 2, pair[1] / 2


def _length(values: Mapping[str, float]) -> float:
    return math.hypot(values["foot_dx"] - values["joint_dx"], values["foot_dz"] - values["joint_dz"])


def _rest_angle(values: Mapping[str, float]) -> float:
    return math.atan2(values["foot_dx"] - values["joint_dx"], values["foot_dz"] - values["joint_dz"])


def _joint(values: Mapping[str, float], leg: _Leg) -> FloatArray:
    return np.array([-leg.side * values["joint_dx"], leg.y, -values["joint_dz"]])


def _weight(values: Mapping[str, float]) -> float:
    return (values["body_mass"] + sum(leg.mass for leg in _legs(values, False))) * values["gravity"]


def _body_inertia(values: Mapping[str, float], per_leg: bool) -> tuple[float, float, float]:
    pitch = values["body_inertia"]
    return (pitch, pitch, 2.0 * pitch) if per_leg else (pitch, pitch, pitch)


def _leg_inertia(leg: _Leg) -> tuple[float, float, float]:
    return leg.inertia, leg.inertia, _SLENDER * leg.inertia


def _thrust_points(values: Mapping[str, float], per_leg: bool) -> dict[str, tuple[float, float, float]]:
    x = values["thrust_point_dx"]
    if not per_leg:
        return {"rear": (-x, 0.0, 0.0), "front": (x, 0.0, 0.0)}
    return {
        f"{end}_{hand}": (sign * x, y * x, 0.0)
        for end, sign in (("rear", -1.0), ("front", 1.0))
        for hand, y in (("left", 1.0), ("right", -1.0))
    }


def _body(world: Element, values: Mapping[str, float], legs: Sequence[_Leg], per_leg: bool) -> None:
    body = add(world, "body", name="body")
    if per_leg:
        add(body, "freejoint", name="free")
        comment(body, "inertia about roll [kg·m²]: a guess, equal to pitch; yaw: the sum, as of a flat body")
    else:
        comment(body, "x, z [m] of the body's centre of mass; pitch [rad], positive nose-down, down-slope")
        axes = (("x", "slide", (1, 0, 0)), ("z", "slide", (0, 0, 1)), ("pitch", "hinge", (0, 1, 0)))
        for key, kind, axis in axes:
            add(body, "joint", name=key, type=kind, axis=axis)
    add(
        body, "inertial", pos=(0.0, 0.0, 0.0), mass=values["body_mass"],
        diaginertia=_body_inertia(values, per_leg),
    )  # fmt: skip
    half = (values["joint_dx"], values["joint_dx"], 0.01)
    add(body, "geom", type="box", size=half, mass=0, contype=0, conaffinity=0, rgba=(0.2, 0.3, 0.5, 1.0))
    for site, place in _thrust_points(values, per_leg).items():
        add(body, "site", name=site, pos=place, size=(0.01,))
    length, rest = _length(values), _rest_angle(values)
    of = "leg" if per_leg else "pair of legs"
    for leg in legs:
        limb = add(
            body, "body", name=f"{leg.name}_leg", pos=tuple(_joint(values, leg)),
            euler=(0.0, leg.side * rest, 0.0),
        )  # fmt: skip
        comment(
            limb, f"bending: q - q_n of a {of} [rad], stiffness [N·m/rad], damping [N·m·s/rad]; 0 at rest"
        )
        add(
            limb, "joint", name=f"{leg.name}_bend", type="hinge", axis=(0, leg.side, 0), springref=0,
            stiffness=leg.bending[0], damping=leg.bending[1],
        )  # fmt: skip
        comment(limb, f"axis: extension h of a {of} [m], stiffness [N/m], damping [N·s/m]; 0 at rest")
        add(
            limb, "joint", name=f"{leg.name}_stretch", type="slide", axis=(0, 0, -1), springref=0,
            stiffness=leg.axial[0], damping=leg.axial[1],
        )  # fmt: skip
        add(
            limb, "inertial", pos=(0.0, 0.0, -(1.0 - values["leg_mass_fraction"]) * length), mass=leg.mass,
            diaginertia=_leg_inertia(leg),
        )  # fmt: skip
        add(
            limb, "geom", type="capsule", fromto=(0.0, 0.0, 0.0, 0.0, 0.0, -length + 0.004),
            size=(0.004,), mass=0, contype=0, conaffinity=0, rgba=(0.7, 0.7, 0.7, 1.0),
        )  # fmt: skip
        add(
            limb, "geom", name=f"{leg.name}_foot", type="sphere", size=(_FOOT_RADIUS,), mass=0, contype=0,
            conaffinity=0, pos=(0.0, 0.0, -length + _FOOT_RADIUS),
        )  # fmt: skip


def _keyframe(
    root: Element, values: Mapping[str, float], legs: Sequence[_Leg], slope: float, per_leg: bool
) -> None:
    depth = values["foot_dx"] * abs(math.sin(slope)) + values["foot_dz"] * math.cos(slope)
    height = depth / math.cos(slope)
    place = (0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0) if per_leg else (0.0, height, 0.0)
    key = add(root, "keyframe")
    comment(
        key, "level, legs at rest, the first foot on the slope, hovering; set a touchdown speed in qvel [m/s]"
    )
    sites = len(_thrust_points(values, per_leg))
    add(
        key, "key", name="touchdown", qpos=place + (0.0,) * (2 * len(legs)),
        ctrl=(_weight(values) / sites,) * sites,
    )  # fmt: skip


_ABOUT_PLANE = (
    "Planar drone on two sprung legs, written by sysid. SI units, angles in rad. x points right, down the "
    "slope, z up, y into the page. Every leg value is of the pair of legs at that end: halve it for one leg."
)
_ABOUT_SPACE = (
    "Drone on four sprung legs in space, written by sysid. SI units, angles in rad. x points down the slope, "
    "z up. Every leg value is of one leg, half of the identified pair. Not identified, so guessed: the width "
    "between the legs and the motors (as wide as long), and inertia about roll and yaw; legs bend in the "
    "pitch plane only."
)
