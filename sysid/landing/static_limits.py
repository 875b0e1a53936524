"""The steepest slope on which a drone stays: closed forms for rigid legs, and bending legs set down at once.

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
Legs that bend lower the front and shift the centre of mass over its feet, so the drone tips earlier. Both
legs bend alike and share the force along the slope about equally, while the rear one carries ever less
weight: its feet slip first. Without thrust the drone then settles further until the rear feet lift, whatever
the friction; pressed on by thrust it goes over as soon as they slip, so there friction decides as well.

A drone that is set down on the slope at once swings through its equilibrium and tips earlier still. There is
no closed form: the gear's kernel is put on one slope after the other. With Table II's high friction, deg::

    reverse thrust   rigid   in balance   set down at once
    0                35.2    28.6         25.5
    12 N             68.3    44.8         39.5

The "about 38" reported for a drone with bending legs under 12 N is no equilibrium: no friction makes the
balance end below 42 deg, and a slow ramp in another simulator (MuJoCo, tests/physics/test_export_mujoco.py)
ends at the same slope. A drone that is set down at once holds about that slope.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sysid.errors import CampaignError
from sysid.gear.model import PARAMETERS, Drops, pack, simulate_population
from sysid.gear.propulsion import Propulsion
from sysid.gear.surfaces import Surface, find_surface
from sysid.integrate.piecewise import PiecewiseCubic
from sysid.landing.outcomes import Rules
from sysid.landing.settings import LANDING_TOLERANCE
from sysid.landing.simulate import ending_of

How = Literal["slides", "tips", "stays"]

# Slope of a wall [rad].
VERTICAL = math.pi / 2
# Difference between neighbouring slopes in the one simulation that sets a drone down on every slope [rad].
_PUT = math.radians(0.5)


@dataclass(frozen=True)
class StaticLimit:
    """The steepest slope on which a drone stays [rad], and what happens beyond it: nothing from 90 deg on."""

    slope: float
    how: How


@dataclass(frozen=True)
class RigidLimits:
    """Slopes [rad] at which a drone with rigid legs slides and tips, in closed form; 90 deg if never."""

    slide: float
    tip: float
    creep: float  # slope of creep at `Rules.rest_speed` on a surface that never sticks; elsewhere `slide`

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
    gear: Mapping[str, float], surface: str | Surface, reverse_thrust: float = 0.0
) -> RigidLimits:
    """Return the closed forms for a set of the gear, by name as in `sysid.gear.model.PARAMETERS` [SI].

    The surface's static coefficient counts where feet stick, the kinetic one elsewhere. `reverse_thrust` is
    the sum over all motors [N]; negative lifts.
    """
    law = find_surface(surface)
    values, ratio, distance, height = _rig(gear, law, reverse_thrust)
    kinetic = values[law.reads[0]]
    static = kinetic + values[law.reads[1]] if law.switching else kinetic
    creep = slide = slide_limit(static, ratio)
    if not law.switching and "slip_regularization" in law.reads:
        share = Rules.rest_speed / (Rules.rest_speed + values["slip_regularization"])
        creep = slide_limit(kinetic * share, ratio)
    return RigidLimits(slide, tip_limit(distance, height, ratio, values["foot_dx"]), creep)


def set_down_limit(
    gear: Mapping[str, float], surface: str | Surface, reverse_thrust: float = 0.0
) -> StaticLimit:
    """Put a drone with its bending legs on slopes at once and see on which it comes to rest.

    Within 0.25 deg: half-way to the first slope of whole and half degrees on which it does not rest by the
    rules of a landing. It starts at rest, level with the slope, the legs unloaded and the thrust settled, and
    swings as its dampers let it. Refused when the drone does not even stand on level ground, or the thrust
    lifts it.
    """
    law, rules = find_surface(surface), Rules()
    values, *_ = _rig(gear, law, reverse_thrust)
    slopes = np.arange(0.0, VERTICAL, _PUT)
    starts = np.zeros((len(slopes), 6))
    starts[:, :2] = values["foot_dz"] * np.column_stack([np.sin(slopes), np.cos(slopes)])
    starts[:, 2] = slopes
    half = PiecewiseCubic.constant(-0.5 * reverse_thrust)
    drops = Drops(slopes, starts, [np.array([0.0, rules.horizon])] * len(slopes), Propulsion(half, half))
    flown = simulate_population(
        pack(values, law), drops, surface=law, tolerance=LANDING_TOLERANCE, ending=ending_of(rules, "rest")
    )
    rests = np.isfinite(flown.rest[0]) & ~(flown.flip[0] < flown.rest[0])
    if rests.all():
        return StaticLimit(VERTICAL, "stays")
    first = int(np.argmin(rests))
    if first == 0:
        raise CampaignError(
            "static limits: the drone does not stand on level ground; check the stiffness of its legs "
            "and the thrust"
        )
    leaves: How = "tips" if np.isfinite(flown.flip[0][first]) else "slides"
    return StaticLimit(float(slopes[first]) - 0.5 * _PUT, leaves)


def _rig(
    gear: Mapping[str, float], surface: Surface, reverse_thrust: float
) -> tuple[dict[str, float], float, float, float]:
    """Return a whole set [SI], thrust over weight [1], and the centre of mass from the front feet [m]."""
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
    distance = values["foot_dx"] - (front - rear) * out / mass
    height = values["foot_dz"] - (front + rear) * deep / mass
    return values, reverse_thrust / weight, distance, height
