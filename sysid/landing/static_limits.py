"""The steepest slope on which a drone stays: closed forms for rigid legs, and a slow ramp with bending legs.

A drone that stands with both feet on a slope leaves it in one of two ways. It slides when friction is used
up, or it tips over its front feet when the rear ones lose their load. Reverse thrust presses it on: it acts
against the body's z axis, which stands normal to the slope while the legs are rigid.

Rigid legs
----------
With the weight ``W = M g`` of body and legs, reverse thrust ``T > 0`` at the body's centre, friction
coefficient ``mu``, and ``a`` and ``d`` the distances of the whole's centre of mass from the front feet along
and normal to the slope::

    slides:  W sin φ = mu (W cos φ + T)               φ = atan mu + asin(mu (T/W)/sqrt(1 + mu²))
    tips:    W d sin φ = W a cos φ + T dx_f           φ = atan(a/d) + asin((T/W) dx_f/sqrt(a² + d²))

Without thrust and with massless legs these are ``atan mu`` and ``atan(dx_f/dz_f)``. Where an arcsine has no
value the drone stays on any slope. The low-friction law (8) never holds a drone still: below ``atan mu`` it
creeps at ``eps_v r/(1 - r)``, ``r = tan φ/mu``, and reaches a given speed earlier than it slides.

Bending legs
------------
Legs that bend lower the front and shift the centre of mass over its feet, so the drone tips earlier. There
is no closed form: the gear's kernel is taken up a slow ramp. Both legs bend alike and share the force
along the slope about equally, while the rear one carries ever less weight: its feet slip first. Without
thrust the drone then settles further until the rear feet lift, whatever the friction; pressed on by thrust it
goes over as soon as they slip, so there friction decides as well.

A drone that is set down on the slope at once swings through its equilibrium and tips earlier still. With
Table II's high friction, deg::

    reverse thrust   rigid   slow ramp   ramp, feet that creep (8)   set down at once
    0                35.2    28.6        28.6                        25.5
    12 N             68.3    44.8        42.0                        39.5

The "about 38" reported for a drone with bending legs under 12 N is no equilibrium: no friction makes a slow
ramp end below 42 deg, and the ramp of another simulator (MuJoCo) ends at the same slope. A drone that is set
down at once holds about that slope.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sysid.errors import CampaignError
from sysid.gear.model import (
    PARAMETERS,
    Drops,
    GearTrajectory,
    Status,
    pack,
    simulate,
    simulate_population,
)
from sysid.gear.propulsion import Propulsion
from sysid.gear.surfaces import Surface, find_surface
from sysid.integrate.piecewise import PiecewiseCubic
from sysid.landing.outcomes import Rules
from sysid.landing.settings import LANDING_TOLERANCE
from sysid.landing.simulate import ending_of
from sysid.types import FloatArray

How = Literal["slides", "tips", "stays"]

VERTICAL = math.pi / 2

# A stair of the ramp, and the width to which the last one is halved [rad].
_STAIR = math.radians(1.0)
_WIDTH = math.radians(0.02)
# On a stair the drone settles in pieces of this length [s] until it stands, at most this number of them.
_PIECE = 0.25
_PIECES = 40
# It stands when the body is slower than this [m/s, rad/s], and not faster than a piece before ...
_STILL = 1e-4
_STILL_TURN = 1e-3
# ... and has fallen when it has turned, from the slope, by more than this [rad].
_FALLEN = math.radians(60.0)
# Slip at which the law (8) has reached 99.8 % of its limit, over eps_v [1].
_FULL_SLIP = 500.0
# Above this much slip a drone on the ramp has run away [m/s].
_RUNS = 0.5
# The kernel's bound per step: stiff legs ring, and near the limit a small force decides.
_TOLERANCE = 1e-6
# Between the slopes on which a drone is set down at once [rad].
_PUT = math.radians(0.5)


@dataclass(frozen=True)
class StaticLimit:
    """The steepest slope on which a drone stays [rad], and what happens beyond it: nothing from 90 deg on."""

    slope: float
    how: How


@dataclass(frozen=True)
class RigidLimits:
    """Closed forms for rigid legs: slopes [rad] at which the drone slides and tips, 90 deg if it never does.

    On a surface that never sticks, `creep` is the slope at which it creeps at a given speed; elsewhere it is
    the slide limit.
    """

    slide: float
    tip: float
    creep: float

    @property
    def first(self) -> StaticLimit:
        """The lower of the two."""
        if min(self.slide, self.tip) >= VERTICAL:
            return StaticLimit(VERTICAL, "stays")
        return StaticLimit(self.slide, "slides") if self.slide < self.tip else StaticLimit(self.tip, "tips")


def slide_limit(friction: float, thrust_ratio: float = 0.0) -> float:
    """Return the slope [rad] at which a rigid drone slides, 0 to 90 deg.

    `friction` is the coefficient mu [1], `thrust_ratio` reverse thrust over weight [1]; negative lifts.
    """
    return _limit(friction, 1.0, friction * thrust_ratio)


def tip_limit(distance: float, height: float, thrust_ratio: float = 0.0, lever: float | None = None) -> float:
    """Return the slope [rad] at which a rigid drone tips over its front feet, 0 to 90 deg.

    `distance` and `height` place the whole's centre of mass from the front feet, along and normal to the
    slope [m]; `thrust_ratio` is reverse thrust over weight [1], negative lifts; `lever` is the distance of
    the thrust from the front feet along the slope [m], by default `distance`.
    """
    return _limit(distance, height, thrust_ratio * (distance if lever is None else lever))


def _limit(along: float, normal: float, pressed: float) -> float:
    """Return the root of ``normal sin φ = along cos φ + pressed`` in 0 to 90 deg."""
    ratio = pressed / math.hypot(along, normal)
    if ratio >= 1.0:
        return VERTICAL
    if ratio <= -1.0:
        return 0.0
    return min(max(math.atan2(along, normal) + math.asin(ratio), 0.0), VERTICAL)


def rigid_limits(
    gear: Mapping[str, float],
    surface: str | Surface,
    reverse_thrust: float = 0.0,
    *,
    creep_speed: float = 0.05,
) -> RigidLimits:
    """Return the closed forms for a set of the gear, by name as in `sysid.gear.model.PARAMETERS` [SI].

    The surface's static coefficient counts where feet stick, the kinetic one elsewhere. `reverse_thrust` is
    the sum over all motors [N]; negative lifts. `creep_speed` is for `RigidLimits.creep` [m/s]: below
    0.05 m/s a landing is at rest.
    """
    law = find_surface(surface)
    p = _Rig.of(gear, law, reverse_thrust)
    kinetic, static = _friction(p.values, law)
    creep = slide = slide_limit(static, p.ratio)
    if not law.switching and "slip_regularization" in law.reads:
        share = creep_speed / (creep_speed + p.values["slip_regularization"])
        creep = slide_limit(kinetic * share, p.ratio)
    return RigidLimits(slide, tip_limit(p.distance, p.height, p.ratio, p.values["foot_dx"]), creep)


def ramp_limit(gear: Mapping[str, float], surface: str | Surface, reverse_thrust: float = 0.0) -> StaticLimit:
    """Take a drone with its bending legs up a slow ramp until it slides or tips; see `rigid_limits`.

    Within 0.1 deg for this path: set down on level ground under the thrust, then tilted. Refused when the
    drone does not even stand on level ground, or the thrust lifts it.

    Notes
    -----
    The ramp climbs in stairs of 1 deg; on each the drone settles, and the stair on which it leaves is halved
    down to 0.02 deg. Dampers do not move an equilibrium, so they are raised to about critical: the drone
    settles within a fraction of a second instead of ringing. Feet are slipping when a stair begins, so the
    kinetic coefficient decides whether they stick. A drone that is put on a slope at once (`set_down_limit`),
    or lands on it, overshoots and tips earlier. On a surface that never sticks the drone creeps on every
    stair; there the slide limit is the slope on which a drone that slides, fast enough for the whole
    friction, no longer slows down.
    """
    ramp = _Ramp(gear, find_surface(surface), reverse_thrust)
    below, above, how = ramp.climb()
    if not ramp.surface.switching:
        if how == "slides":
            above = min(above + 5 * _STAIR, VERTICAL - _WIDTH)
        if ramp.runs(above if how == "slides" else below):
            return StaticLimit(ramp.slide(0.0, above if how == "slides" else below), "slides")
    if how == "stays":
        return StaticLimit(VERTICAL, "stays")
    return StaticLimit(0.5 * (below + above), how)


def set_down_limit(
    gear: Mapping[str, float],
    surface: str | Surface,
    reverse_thrust: float = 0.0,
) -> StaticLimit:
    """Put a drone with its bending legs on slopes at once and see on which it comes to rest.

    Within 0.25 deg: half-way to the first slope of whole and half degrees on which it does not rest by the
    rules of a landing. It starts at rest, level with the slope, the legs unloaded and the thrust settled, and
    swings as its dampers let it. With legs as lightly damped as the paper's the limit lies below the one of
    `ramp_limit`.
    """
    law, rules = find_surface(surface), Rules()
    rig = _Rig.of(gear, law, reverse_thrust)
    slopes = np.arange(0.0, VERTICAL, _PUT)
    starts = np.zeros((len(slopes), 6))
    starts[:, :2] = rig.values["foot_dz"] * np.column_stack([np.sin(slopes), np.cos(slopes)])
    starts[:, 2] = slopes
    half = PiecewiseCubic.constant(-0.5 * reverse_thrust)
    drops = Drops(slopes, starts, [np.array([0.0, rules.horizon])] * len(slopes), Propulsion(half, half))
    flown = simulate_population(
        pack(rig.values, law),
        drops,
        surface=law,
        tolerance=LANDING_TOLERANCE,
        ending=ending_of(rules, "rest"),
    )
    rests = np.isfinite(flown.rest[0]) & ~(flown.flip[0] < flown.rest[0])
    if rests.all():
        return StaticLimit(VERTICAL, "stays")
    first = int(np.argmin(rests))
    leaves: How = "tips" if np.isfinite(flown.flip[0][first]) else "slides"
    return StaticLimit(max(float(slopes[first]) - 0.5 * _PUT, 0.0), leaves)


def _friction(values: Mapping[str, float], surface: Surface) -> tuple[float, float]:
    """Kinetic and static coefficient of a surface, from the rows that its law declares."""
    kinetic = values[surface.reads[0]]
    return kinetic, kinetic + values[surface.reads[1]] if surface.switching else kinetic


@dataclass(frozen=True)
class _Rig:
    """What the closed forms need of a set."""

    values: dict[str, float]
    weight: float
    ratio: float
    distance: float
    height: float

    @classmethod
    def of(cls, gear: Mapping[str, float], surface: Surface, reverse_thrust: float) -> _Rig:
        row = pack({name: value for name, value in gear.items() if name in PARAMETERS}, surface)
        values = dict(zip(PARAMETERS, row.tolist(), strict=True))
        up, down = values["leg_mass_fraction"], 1.0 - values["leg_mass_fraction"]
        # A leg's centre of mass at rest: `leg_mass_fraction` of the way from its foot to its joint.
        out = up * values["joint_dx"] + down * values["foot_dx"]
        deep = up * values["joint_dz"] + down * values["foot_dz"]
        rear = values["leg_mass"]
        front = rear * values["front_leg_mass_ratio"]
        mass = values["body_mass"] + rear + front
        weight = mass * values["gravity"]
        if not (math.isfinite(reverse_thrust) and reverse_thrust > -weight):
            raise CampaignError(
                f"static limits: a reverse thrust of {reverse_thrust:g} N on a weight of {weight:.2f} N; "
                "give a finite thrust that does not lift the drone, positive pressing it down"
            )
        return cls(
            values,
            weight,
            reverse_thrust / weight,
            values["foot_dx"] - (front - rear) * out / mass,
            values["foot_dz"] - (front + rear) * deep / mass,
        )


class _Ramp:
    """A drone on a slope that grows slowly; states are (14,), frame N of the slope at hand."""

    def __init__(self, gear: Mapping[str, float], surface: Surface, reverse_thrust: float) -> None:
        self.surface = surface
        rig = _Rig.of(gear, surface, reverse_thrust)
        self.row = pack(_settling(rig.values), surface)
        half = PiecewiseCubic.constant(-0.5 * reverse_thrust)
        self.thrust = Propulsion(half, half)
        self.slip = _FULL_SLIP * rig.values["slip_regularization"]
        self.stairs: list[tuple[float, FloatArray]] = []
        level = np.zeros(14)
        level[1] = rig.values["foot_dz"]
        span, depth = (rig.values[f"foot_d{a}"] - rig.values[f"joint_d{a}"] for a in "xz")
        level[[4, 6]] = math.atan2(span, depth)
        self.level = level

    def climb(self) -> tuple[float, float, How]:
        """Return a slope on which the drone stands, one on which it does not, and what happens there."""
        state, how = self._settle(self.level, 0.0)
        if state is None:
            raise CampaignError(
                "static limits: the drone does not stand on level ground; check the stiffness of its legs "
                "and the thrust"
            )
        self.stairs = [(0.0, state)]
        step, slope = _STAIR, 0.0
        failed: How = "stays"
        while step > _WIDTH / 2 and slope + step < VERTICAL:
            state, how = self._settle(_turned(self.stairs[-1][1], step), slope + step)
            if state is None:
                failed = how
                step *= 0.5
            else:
                slope += step
                self.stairs.append((slope, state))
                # After the first failure every stair is tried once: this is a bisection.
                step = step if failed == "stays" else 0.5 * step
        return slope, slope + 2 * step, failed

    def _run(self, state: FloatArray, slope: float, pieces: int) -> GearTrajectory:
        return simulate(
            self.row, slope, None, _PIECE * np.arange(pieces + 1.0), state=state, surface=self.surface,
            propulsion=self.thrust, tolerance=_TOLERANCE,
        )  # fmt: skip

    def _settle(self, state: FloatArray, slope: float) -> tuple[FloatArray | None, How]:
        """Let the drone come to rest on a slope; None and what it did where it does not."""
        begin = state
        for _ in range(_PIECES):
            run = self._run(state, slope, 1)
            if run.status != Status.OK:
                return None, "tips"
            before, state = state, run.state[-1]
            if abs(state[2] - slope) > _FALLEN:
                return None, "tips"
            if abs(_along(state[:2] - begin[:2], slope)) > 0.5:
                return None, "slides"
            speed = abs(_along(state[7:9], slope))
            # At the limit motion grows from nothing, slowly at first.
            turns = abs(state[9]) <= abs(before[9]) + 0.01 * _STILL_TURN
            calm = math.hypot(state[7], state[8]) < _STILL and abs(state[9]) < _STILL_TURN and turns
            calm = calm and before is not begin
            # Creep is no motion that settles, but its speed does.
            slower = speed <= abs(_along(before[7:9], slope)) + _STILL and speed < _RUNS
            creeps = not self.surface.switching and slower and abs(state[9]) < _STILL_TURN
            if calm or creeps:
                still = state.copy()
                still[7:] = 0.0
                return still, "stays"
        return None, "slides" if speed > _RUNS / 10 else "tips"

    def runs(self, slope: float) -> bool:
        """Whether a drone that slides down a slope fast enough for the whole friction gets faster."""
        near, state = min(self.stairs, key=lambda stair: abs(stair[0] - slope))
        state = _turned(state, slope - near)
        state[7:9] = self.slip * math.cos(slope), -self.slip * math.sin(slope)
        run = self._run(state, slope, 2)
        gained = _along((run.state[2] - run.state[1])[7:9], slope)
        return bool(gained > 0.0)

    def slide(self, below: float, above: float) -> float:
        """Return the slope [rad] at which `runs` changes."""
        while above - below > _WIDTH:
            middle = 0.5 * (below + above)
            below, above = (below, middle) if self.runs(middle) else (middle, above)
        return 0.5 * (below + above)


def _settling(values: Mapping[str, float]) -> dict[str, float]:
    """Return a set with the same equilibria, whose dampers are about critical for the body on its legs."""
    mass, inertia = 0.5 * values["body_mass"], 0.5 * values["body_inertia"]
    inertia += mass * values["foot_dz"] ** 2
    damper = {
        "leg_axial_damping": math.sqrt(values["leg_axial_stiffness"] * mass),
        "leg_bending_damping": math.sqrt(values["leg_bending_stiffness"] * inertia),
        # Of the foot alone, which bounces on the ground without the body.
        "ground_damping": math.sqrt(values["ground_stiffness"] * values["leg_mass"]),
    }
    return dict(values) | {name: max(values[name], value) for name, value in damper.items()}


def _along(vector: FloatArray, slope: float) -> float:
    """Component of (x, z) down the slope."""
    return float(vector[0] * math.cos(slope) - vector[1] * math.sin(slope))


def _turned(state: FloatArray, angle: float) -> FloatArray:
    """Return a state turned about the origin together with its slope."""
    turned = state.copy()
    c, s = math.cos(angle), math.sin(angle)
    for k in (0, 7):
        turned[k : k + 2] = c * state[k] + s * state[k + 1], c * state[k + 1] - s * state[k]
    turned[2] += angle
    return turned
