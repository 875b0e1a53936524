"""A gear with physics that the model lacks, written without its kernels: truths that no fit can reach.

The equations are section 3 of the model's notes (two legs eliminated by hand), stepped by Runge-Kutta in
fixed steps. Without foreign terms the drops are the model's; the tests compare them.
"""

import math
from types import SimpleNamespace

import numpy as np
from numba import njit

from sysid.gear import model

# Step [s]: contacts of 1e5 N/m need 2e-5 s for 1e-5 of the trajectory.
_STEP = 1e-5
# Foreign terms with a size that doubles the noise floor or so, by name; 0 or 1: none.
TERMS = {
    "spring_hardening": 0.6,      # rise of k_h at 10 mm of slide [1]
    "bending_hardening": 1.5,     # rise of k_t at 0.2 rad of bend [1]
    "slide_friction": 3.0,        # dry friction of the leg's slide [N]
    "joint_friction": 0.08,       # dry friction of the joint [N·m]
    "front_stiffness": 1.08,      # front legs' k_h over the rear ones' [1]
    "front_bending": 1.08,        # the same of k_t [1]
    "ground_rate": 0.4,           # Hunt-Crossley: rise of k_s per 1 m/s of approach [s/m]
    "pitch_drag": 0.004,          # moment against pitch [N·m·s²]
    "front_friction": 1.15,       # front feet's friction over the rear ones' [1]
}  # fmt: skip
# What they are called among the gear's parameters.
NAMES = {
    "spring_hardening": "leg_axial_hardening",
    "bending_hardening": "leg_bending_hardening",
    "slide_friction": "leg_slide_friction",
    "joint_friction": "leg_joint_friction",
    "front_stiffness": "front_leg_axial_stiffness_ratio",
    "front_bending": "front_leg_bending_stiffness_ratio",
    "ground_rate": "ground_rate_stiffening",
    "pitch_drag": "pitch_drag",
    "front_friction": "front_friction_excess",
}
_NAMES = tuple(TERMS)
NONE = {name: 1.0 if name.startswith("front") else 0.0 for name in _NAMES}
_ROWS = (
    "body_mass", "body_inertia", "foot_dx", "foot_dz", "joint_dx", "joint_dz", "leg_axial_stiffness",
    "leg_axial_damping", "leg_bending_stiffness", "leg_bending_damping", "leg_mass", "leg_inertia",
    "leg_mass_fraction", "gravity", "ground_stiffness", "ground_damping", "kinetic_friction",
    "slip_regularization",
)  # fmt: skip


def drawn_terms(seed, count):
    """Draw terms that the model lacks, with half to all of the size in `TERMS`."""
    source = np.random.default_rng(seed)
    drawn = map(str, source.choice(sorted(TERMS), count, replace=False))
    return {name: NONE[name] + (TERMS[name] - NONE[name]) * source.uniform(0.5, 1.0) for name in drawn}


def simulator(**terms):
    """Return what takes the place of `sysid.gear.model.simulate` on LF, with these foreign terms."""
    foreign = np.array(list(NONE.values()))
    for name, size in terms.items():
        foreign[_NAMES.index(name)] = size

    def simulate(true, slope, start, clock, *, surface, tolerance):
        assert surface == "lf"
        row = np.array([true[name] for name in _ROWS])
        span, drop = true["foot_dx"] - true["joint_dx"], true["foot_dz"] - true["joint_dz"]
        rest = math.atan2(span, drop)
        state = np.zeros(14)
        state[:3], state[7:10] = start[:3], start[3:]
        state[4] = state[6] = rest
        states = _walk(state, np.asarray(clock), row, foreign, slope)
        finite = np.isfinite(states).all()
        status = model.Status.OK if finite else model.Status.BLEW_UP
        return SimpleNamespace(status=status, state=states)

    return simulate


@njit(cache=True)
def _walk(state, clock, row, foreign, slope):
    out = np.empty((len(clock), 14))
    out[0] = state
    for k in range(1, len(clock)):
        count = max(1, int(np.ceil((clock[k] - clock[k - 1]) / _STEP)))
        h = (clock[k] - clock[k - 1]) / count
        for _ in range(count):
            a = _rates(state, row, foreign, slope)
            b = _rates(state + h / 2 * a, row, foreign, slope)
            c = _rates(state + h / 2 * b, row, foreign, slope)
            d = _rates(state + h * c, row, foreign, slope)
            state = state + h / 6 * (a + 2 * b + 2 * c + d)
        out[k] = state
    return out


@njit(cache=True)
def _rates(y, row, foreign, slope):
    (m_b, i_b, dx_f, dz_f, dx_j, dz_j, k_h, b_h, k_t, b_t, m, i_leg, share, g, k_s, b_s, mu, eps) = row
    harden, bend_harden, slide, dry, front_k, front_t, rate_law, drag, front_mu = foreign
    l = np.hypot(dx_f - dx_j, dz_f - dz_j)  # noqa: E741
    q_n = np.arctan2(dx_f - dx_j, dz_f - dz_j)
    q, w = y[2], y[9]
    tx, tz, nx, nz = np.cos(slope), -np.sin(slope), np.sin(slope), np.cos(slope)
    matrix = np.zeros((3, 3))
    matrix[0, 0] = matrix[1, 1] = m_b
    matrix[2, 2] = i_b
    known = np.array([0.0, -m_b * g, -drag * abs(w) * w])
    legs = np.zeros((2, 12))
    for k in range(2):
        side = 1.0 if k == 0 else -1.0
        h, a, dh, da = y[3 + 2 * k], y[4 + 2 * k], y[10 + 2 * k], y[11 + 2 * k]
        theta, dtheta = q + side * a, w + side * da
        ex, ez = np.array([np.cos(theta), -np.sin(theta)]), np.array([np.sin(theta), np.cos(theta)])
        rx = -side * dx_j * np.cos(q) - dz_j * np.sin(q)
        rz = side * dx_j * np.sin(q) - dz_j * np.cos(q)
        foot_z = (y[0] + rx - (l + h) * ez[0]) * nx + (y[1] + rz - (l + h) * ez[1]) * nz
        vx = y[7] + w * rz - dh * ez[0] - (l + h) * dtheta * ex[0]
        vz = y[8] - w * rx - dh * ez[1] - (l + h) * dtheta * ex[1]
        p, dp, slip = -foot_z, -(vx * nx + vz * nz), vx * tx + vz * tz
        normal = 0.0
        if p > 0.0:
            normal = k_s * p * (1.0 + rate_law * max(dp, 0.0)) + (b_s * dp if dp > 0.0 else 0.0)
        friction = -mu * (front_mu if k else 1.0) * abs(normal) * slip / (abs(slip) + eps)
        fx, fz = normal * nx + friction * tx, normal * nz + friction * tz
        along, across = fx * ez[0] + fz * ez[1], fx * ex[0] + fz * ex[1]
        stiff = k_h * (front_k if k else 1.0) * (1.0 + harden * (h / 0.01) ** 2)
        s = stiff * h + b_h * dh + slide * np.tanh(dh / 0.01)
        bend = a - q_n
        turn = k_t * (front_t if k else 1.0) * (1.0 + bend_harden * (bend / 0.2) ** 2) * bend
        moment = -side * (turn + b_t * da + dry * np.tanh(da / 0.1))
        rho = (1.0 - share) * l + h
        # With the centre of mass a share from the foot, the contact's lever is that share of the length.
        arm = share * l
        inertia = i_leg + m * rho**2
        push = -2.0 * m * dh * dtheta - across - m * g * np.sin(theta)
        turned = (moment - arm * across + rho * push) / inertia
        mass, c = m * i_leg / inertia, push - m * rho * turned
        lever = rz * ex[0] - rx * ex[1]
        pull = -(w**2) * (rx * ex[0] + rz * ex[1])
        direction = np.array([ex[0], ex[1], lever])
        for i in range(3):
            for j in range(3):
                matrix[i, j] += mass * direction[i] * direction[j]
        known -= (c + mass * pull) * direction + s * np.array([ez[0], ez[1], rz * ez[0] - rx * ez[1]])
        known[2] -= moment
        legs[k] = np.array(
            [ex[0], ex[1], lever, pull, turned, rho * m / inertia, rho * dtheta**2, along, s, theta, rx, rz]
        )
    body = np.linalg.solve(matrix, known)
    out = np.empty(14)
    out[:7], out[7:10] = y[7:], body
    for k in range(2):
        side = 1.0 if k == 0 else -1.0
        ex0, ex1, lever, pull, turned, gain, spin, along, s, theta, rx, rz = legs[k]
        joint = body[0] * ex0 + body[1] * ex1 + body[2] * lever + pull
        # Along ez = (-ex1, ex0).
        lift = body[0] * -ex1 + body[1] * ex0 + body[2] * (rz * -ex1 - rx * ex0)
        lift -= w**2 * (rx * -ex1 + rz * ex0)
        out[10 + 2 * k] = lift + spin - (along - m * g * np.cos(theta) + s) / m
        out[11 + 2 * k] = side * (turned + gain * joint - body[2])
    return out
