"""Kinematics of the legs, written without the kernels."""

import math

import numpy as np


def legs(p, state):
    """Per leg of states (n, 14), frame N: foot, mass centre and its velocity, angle rate, foot's velocity."""
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
