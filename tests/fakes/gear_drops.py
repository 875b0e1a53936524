"""Level drops onto a slope, and what tests read from their trajectories."""

import math

import numpy as np

from sysid.gear.model import PARAMETERS, Drops, EventKind

# Slope [deg] and speed [m/s].
SIX = [(5, 0.5), (10, 0.8), (15, 0.6), (20, 1.0), (27, 0.7), (35, 0.45)]


def level_start(slope, speed, height=1e-3, p=PARAMETERS.nominal):
    """Body's state, level, the upper foot `height` above the slope along its normal, falling."""
    q = abs(slope)
    return [0.0, p["foot_dz"] + (height + p["foot_dx"] * math.sin(q)) / math.cos(q), 0.0, 0.0, -speed, 0.0]


def level_drops(cases=SIX, length=0.7):
    slopes = [math.radians(slope_deg) for slope_deg, _ in cases]
    states = [level_start(q, speed) for q, (_, speed) in zip(slopes, cases, strict=True)]
    return Drops(np.array(slopes), np.array(states), [np.arange(0, length + 1e-9, 0.005)] * len(cases))


def nrmse(ours, exact):
    """RMS error of every channel over its deviation."""
    return np.sqrt(np.mean((ours - exact) ** 2, axis=0)) / exact.std(axis=0)


def legs(p, state):
    """Kinematics without the kernels, per leg of states (n, 14), frame N.

    Foot, mass centre and its velocity, angle rate, foot's velocity.
    """
    x, z, q, h_c, q_c, h_d, q_d, dx, dz, dq, dh_c, dq_c, dh_d, dq_d = state.T
    span, depth = p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"]
    length = math.hypot(span, depth)
    for side, h, a, dh, da in ((1, h_c, q_c, dh_c, dq_c), (-1, h_d, q_d, dh_d, dq_d)):
        theta, dtheta = q + side * a, dq + side * da
        joint = np.array([-side * p["joint_dx"] * np.cos(q) - p["joint_dz"] * np.sin(q),
                          side * p["joint_dx"] * np.sin(q) - p["joint_dz"] * np.cos(q)])  # fmt: skip
        axis, across = np.array([np.sin(theta), np.cos(theta)]), np.array([np.cos(theta), -np.sin(theta)])
        rho = (1 - p["leg_mass_fraction"]) * length + h
        along = np.array([dx, dz]) + dq * np.array([joint[1], -joint[0]]) - dh * axis
        base, turning = np.array([x, z]) + joint, dtheta * across
        foot, middle = base - (length + h) * axis, base - rho * axis
        yield foot, middle, along - rho * turning, dtheta, along - (length + h) * turning


def foot_depths(p, slope, state):
    """Penetration of both feet (n, 2) from states (n, 14) [m]."""
    feet = [foot for foot, *_ in legs(p, state)]
    return np.stack([-(foot[0] * math.sin(slope) + foot[1] * math.cos(slope)) for foot in feet], 1)


def touchdowns(trajectory):
    """Times [s] and feet of touchdowns; one within 5 ms of the foot's last contact is not a new one."""
    out, last = [], {}
    for event in trajectory.events:
        if event.kind in (EventKind.TOUCHDOWN, EventKind.LIFT_OFF):
            if event.kind is EventKind.TOUCHDOWN and event.time - last.get(event.foot, -1.0) > 5e-3:
                out.append((event.time, event.foot))
            last[event.foot] = event.time
    return out
