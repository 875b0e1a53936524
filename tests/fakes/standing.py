"""Statics of a drone that stands with bending legs on a slope, written out anew, and where it tips."""

import math

import numpy as np
from scipy.optimize import brentq, root


def energy(u, slope, p, feet):
    """Potential energy of body, legs (rear or both) and ground with the feet held where they stand.

    u: s, w, pitch of the body from the slope, penetration of each foot; feet: (side, place along the slope).
    """
    s, w, phi = u[:3]
    down = np.array([math.sin(slope), -math.cos(slope)]) * p["gravity"]
    ex, ez = np.array([math.cos(phi), -math.sin(phi)]), np.array([math.sin(phi), math.cos(phi)])
    span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]
    length, rest = math.hypot(span, depth), math.atan2(span, depth)
    total = -p["body_mass"] * down @ [s, w]
    for (side, place), sink in zip(feet, u[3:], strict=True):
        foot = np.array([place, -sink])
        leg = np.array([s, w]) - side * p["joint_dx"] * ex - p["joint_dz"] * ez - foot
        size = np.hypot(*leg)
        bend = math.atan2(leg[0], leg[1]) - phi - side * rest
        total += 0.5 * p["leg_axial_stiffness"] * (size - length) ** 2
        total += 0.5 * p["leg_bending_stiffness"] * bend**2 + 0.5 * p["ground_stiffness"] * sink**2
        total -= p["leg_mass"] * down @ (foot + leg / size * p["leg_mass_fraction"] * length)
    return total


def balance(u, slope, p, feet, thrust):
    """Generalized forces on u; zero in equilibrium."""
    out = np.zeros(len(u))
    for i in range(len(u)):
        h = np.zeros(len(u))
        h[i] = 1e-6
        out[i] = (energy(u + h, slope, p, feet) - energy(u - h, slope, p, feet)) / 2e-6
    return out + np.concatenate([[thrust * math.sin(u[2]), thrust * math.cos(u[2])], np.zeros(len(u) - 2)])


def tips_without_thrust(p):
    """Slope [rad] at which the front feet carry all, whatever the friction."""
    span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]

    def rear_gap(slope):
        """Height of the rear foot, its leg weightless, of a drone that balances on its front feet."""
        u = root(balance, [0.0, 0.14, 0.0, 1e-4], args=(slope, p, [(-1, 0.1)], 0.0), tol=1e-12).x
        _, w, phi = u[:3]
        theta = phi + math.atan2(span, depth)
        joint = w + p["joint_dx"] * math.sin(phi) - p["joint_dz"] * math.cos(phi)
        return joint - math.hypot(span, depth) * math.cos(theta)

    return brentq(rear_gap, math.radians(20), math.radians(34))


def tips_under_thrust(p, thrust):
    """Slope [rad] at which the rear feet, set down on level ground, need all the friction that there is."""
    feet = [(1, -p["foot_dx"]), (-1, p["foot_dx"])]
    u = np.array([0.0, p["foot_dz"] - 5e-3, 0.0, 1e-4, 1e-4])
    ratios, slopes = [], np.radians(np.arange(0.0, 50.0, 0.5))
    for slope in slopes:
        found = root(balance, u, args=(slope, p, feet, thrust), tol=1e-11)
        u = found.x
        assert np.abs(balance(u, slope, p, feet, thrust)).max() < 1e-5
        moved = [(side, place + (1e-6 if side > 0 else 0.0)) for side, place in feet]
        pull = (energy(u, slope, p, moved) - energy(u, slope, p, feet)) / 1e-6
        # The ground's force on the rear feet, positive up the slope, over its normal force.
        ratios.append(-pull / (p["ground_stiffness"] * u[3]))
    return np.interp(p["kinetic_friction"], ratios, slopes)
