"""The gear in scipy's integrators, which get our compiled right-hand side: only the stepping is compared."""

import math

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from paired import loosest
from sysid.gear.kernel import parameter_row
from sysid.gear.kernel.dynamics import accelerations, derived, feet, pose
from sysid.gear.kernel.geometry import normal_force
from sysid.gear.model import PARAMETERS
from sysid.gear.surfaces.low_friction import low_friction


@njit(error_model="numpy")
def thrust_at(t, segments):
    """Thrust of the rear and front pair [N] from the kernel's own segments (`Propulsion.segments`)."""
    piece = segments[np.searchsorted(segments[1:, 0], t, side="right")]
    s = t - piece[0]
    rear = piece[2] + s * (piece[3] + s * (piece[4] + s * piece[5]))
    front = piece[6] + s * (piece[7] + s * (piece[8] + s * piece[9]))
    return rear, front


@njit(error_model="numpy")
def body_rates(y, push, coefficients, k_s, b_s, law):
    """Rates (14,) of the state in the slope's frame under low friction, and how deep the lower foot is [m].

    push: acceleration of the body alone by thrust, along its own axis and in turn [m/s², rad/s²].
    """
    joints = pose(y[2], y[4], y[6], coefficients.dx_j, coefficients.dz_j)
    rates = (y[7], y[8], y[9], y[10], y[11], y[12], y[13])
    p_c, dp_c, v_c, p_d, dp_d, v_d = feet(joints, y[1], y[3], y[5], rates, coefficients.length)
    n_c, n_d = normal_force(p_c, dp_c, k_s, b_s), normal_force(p_d, dp_d, k_s, b_s)
    f_c, f_d = low_friction(n_c, n_d, v_c, v_d, law)
    angles = (y[2], y[3], y[4], y[5], y[6])
    loads = (push[0], push[1], 0.0, 0.0, 0.0, 0.0)
    a = accelerations(joints, angles, rates, loads, (n_c, n_d), f_c, f_d, coefficients)
    out = np.empty(14)
    out[:7] = y[7:14]
    for i in range(7):
        out[7 + i] = a[i]
    return out, max(p_c, p_d)


@njit(error_model="numpy")
def derivative(t, y, coefficients, k_s, b_s, mu_k, eps_v, segments, lever):
    """Rates of the state in the slope's frame, for another library's integrator.

    Without segments the motors are off; lever: distance of the thrust points from the centre of mass [m].
    """
    rear, front = thrust_at(t, segments) if len(segments) else (0.0, 0.0)
    push = ((rear + front) * coefficients.per_m, (rear - front) * lever * coefficients.per_i)
    return body_rates(y, push, coefficients, k_s, b_s, (mu_k, eps_v, 0.0))[0]


def problem(slope, body, propulsion=None):
    """Right-hand side of t and y, start (14,) in the slope's frame, and the way back to x, z, q, vx, vz."""
    p = PARAMETERS.nominal
    coefficients = derived(np.array([p[name] for name in parameter_row.NAMES]), slope)
    c, s, rest = math.cos(slope), math.sin(slope), coefficients.q_n
    surface = (p["ground_stiffness"], p["ground_damping"], p["kinetic_friction"], p["slip_regularization"])
    x, z, q, dx, dz, dq = body
    phi = q - slope
    start = [c * x - s * z, s * x + c * z, phi, 0, phi + rest, 0, phi - rest]
    start = np.array([*start, c * dx - s * dz, s * dx + c * dz, dq, 0, dq, 0, dq], dtype=float)

    segments = np.zeros((0, 10)) if propulsion is None else propulsion.segments

    def right_hand_side(t, y):
        return derivative(t, y, coefficients, *surface, segments, p["thrust_point_dx"])

    def back(y):
        (x, z), (dx, dz) = ((c * a + s * b, c * b - s * a) for a, b in (y.T[:2], y.T[7:9]))
        return np.column_stack([x, z, y[:, 2] + slope, dx, dz])

    right_hand_side(0.0, start)
    return right_hand_side, start, back


def scipy_drop(method, slope, body, clock, exact):
    """Measure a scipy method on a drop."""
    right_hand_side, start, back = problem(slope, body)

    def attempt(rtol):
        run = solve_ivp(
            right_hand_side, (0, clock[-1]), start,
            method=method, t_eval=clock, rtol=rtol, atol=rtol * 1e-2,
        )  # fmt: skip
        return (back(run.y.T), int(run.nfev)) if run.y.shape[1] == len(clock) else None

    return loosest(attempt, exact, 2)
