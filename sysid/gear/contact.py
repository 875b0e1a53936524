"""Forces between a foot and the surface: compliant normal force (7) and continuous low friction (8).

A friction law is one function of the contact's state; the equations of motion do not know which one acts.
"""

from numba import njit


@njit(error_model="numpy", forceinline=True)
def normal_force(penetration, penetration_rate, k_s, b_s):
    """Normal force on a foot [N], equation (7): spring always, damper only while the foot goes deeper."""
    damping = b_s * penetration_rate if penetration_rate > 0.0 else 0.0
    return k_s * penetration + damping if penetration > 0.0 else 0.0


@njit(error_model="numpy", forceinline=True)
def low_friction(force_c, force_d, slip_c, slip_d, mu_k, eps_v):
    """Friction on both feet along the slope [N], equation (8) with the sign that opposes the slip.

    Notes
    -----
    ``F_t = -mu_k F_n v / (|v| + eps_v)``; linear in v for |v| << eps_v, so it never sticks but creeps. The
    two quotients share one division.
    """
    below_c = (slip_c if slip_c > 0.0 else -slip_c) + eps_v
    below_d = (slip_d if slip_d > 0.0 else -slip_d) + eps_v
    common = -mu_k / (below_c * below_d)
    return common * below_d * force_c * slip_c, common * below_c * force_d * slip_d


@njit(error_model="numpy", forceinline=True)
def low_friction_damping(force, slip, mu_k, eps_v):
    """Slope ``-dF_t/dv`` of the law (8) at a slip speed [N·s/m]."""
    below = (slip if slip > 0.0 else -slip) + eps_v
    return mu_k * force * eps_v / (below * below)
