"""Equations of motion (11, 12) of body and two legs, solved for the accelerations.

Notes
-----
Everything is relative to free fall: without weights the legs obey the same equations, and gravity is added to
the body at the end. With ``rho`` the distance of a leg's centre of mass from its joint, ``F`` the ground's
force on the foot at distance ``arm`` below that centre, ``S = k_h h + b_h h'`` the axial joint force (5),
``M`` the joint moment on the leg (6) and ``lam`` the constraint force of the joint on the leg along ``ex``:

    m_leg (a_j.ex - 2 h' theta' - rho theta'') = F.ex + lam
    I_leg theta'' = M - arm F.ex + rho lam
    h''  = a_j.ez + rho theta'^2 - (F.ez + S)/m_leg
    a_B  = -sum(lam ex + S ez)/m_B,   alpha = sum(-M - lam p - S n)/I_B
    a_j.ex = a_B.ex + alpha p + omega^2 n,   a_j.ez = a_B.ez + alpha n - omega^2 p

where ``p = ex.r'``, ``n = ez.r'`` and ``r' = (r_w, -r_s)`` is the joint's offset turned a quarter.
Eliminating all but the two ``lam`` leaves one symmetric, positive definite 2 x 2 system: a single division.
"""

from numba import njit

from sysid.gear.geometry import foot_motion, joint_position, sine_cosine


@njit(error_model="numpy", forceinline=True)
def pose(phi, theta_c, theta_d, dx_j, dz_j):
    """Cosines and sines of both legs' angles from the slope, and the joints' offsets from the body [m]."""
    sin_phi, cos_phi = sine_cosine(phi)
    sin_c, cos_c = sine_cosine(theta_c)
    sin_d, cos_d = sine_cosine(theta_d)
    c_s, c_w = joint_position(cos_phi, sin_phi, 1.0, dx_j, dz_j)
    d_s, d_w = joint_position(cos_phi, sin_phi, -1.0, dx_j, dz_j)
    return cos_c, sin_c, cos_d, sin_d, c_s, c_w, d_s, d_w


@njit(error_model="numpy", forceinline=True)
def feet(joints, w, h_c, h_d, rates, l):  # noqa: E741
    """Penetration, its rate and slip speed of the rear foot, then of the front foot [m, m/s, m/s]."""
    cos_c, sin_c, cos_d, sin_d, c_s, c_w, d_s, d_w = joints
    s_rate, w_rate, omega, h_c_rate, theta_c_rate, h_d_rate, theta_d_rate = rates
    rear = foot_motion(w, s_rate, w_rate, omega, c_s, c_w, l + h_c, h_c_rate, cos_c, sin_c, theta_c_rate)
    front = foot_motion(w, s_rate, w_rate, omega, d_s, d_w, l + h_d, h_d_rate, cos_d, sin_d, theta_d_rate)
    return rear[0], rear[1], rear[2], front[0], front[1], front[2]


@njit(error_model="numpy", forceinline=True)
def foot_looseness(joints, h_c, h_d, coefficients):
    """Tangential acceleration of each foot per newton of friction on it [1/kg], estimated from above.

    The leg turns about a joint held still, slides along its axis, and the body moves as if it had no legs.
    """
    cos_c, sin_c, cos_d, sin_d, _, c_w, _, d_w = joints
    l, rho_0 = coefficients[6], coefficients[9]  # noqa: E741
    per_m, per_i, per_ml, per_il = coefficients[10], coefficients[11], coefficients[12], coefficients[13]
    rho_c = rho_0 + h_c
    rho_d = rho_0 + h_d
    lever_c = cos_c * (l + h_c)
    lever_d = cos_d * (l + h_d)
    ratio = per_il * per_ml
    loose_c = per_m + c_w * c_w * per_i + sin_c * sin_c * per_ml
    loose_c = loose_c + lever_c * lever_c * ratio / (per_ml + rho_c * rho_c * per_il)
    loose_d = per_m + d_w * d_w * per_i + sin_d * sin_d * per_ml
    loose_d = loose_d + lever_d * lever_d * ratio / (per_ml + rho_d * rho_d * per_il)
    return loose_c, loose_d


@njit(error_model="numpy", forceinline=True)
def accelerations(
    joints, phi, h_c, theta_c, h_d, theta_d, rates, normal_c, normal_d, friction_c, friction_d, coefficients
):
    """Second time derivatives of (s, w, phi, h_C, theta_C, h_D, theta_D) under given forces on the feet.

    Parameters
    ----------
    joints : tuple
        From `pose`.
    phi, theta_c, theta_d : float
        Angles of body and legs from the slope [rad].
    h_c, h_d : float
        Extension of the legs [m].
    rates : tuple of 7 float
        Rates of the coordinates.
    normal_c, normal_d, friction_c, friction_d : float
        Forces on the feet along the slope's normal and down-slope tangent [N].
    coefficients : tuple of 16 float
        k_h, b_h, k_t, b_t, dx_j, dz_j, l, q_n, arm, rho_0, 1/m_B, 1/I_B, 1/m_leg, 1/I_leg, gravity along the
        tangent and along the normal.
    """
    cos_c, sin_c, cos_d, sin_d, c_s, c_w, d_s, d_w = joints
    _, _, omega, h_c_rate, theta_c_rate, h_d_rate, theta_d_rate = rates
    k_h, b_h, k_t, b_t, _, _, _, q_n, arm, rho_0, per_m, per_i, per_ml, per_il, g_s, g_w = coefficients
    spin = omega * omega
    rho_c = rho_0 + h_c
    rho_d = rho_0 + h_d
    # Joint's quarter-turned offset r' = (r_w, -r_s) in each leg's axes.
    p_c = cos_c * c_w + sin_c * c_s
    n_c = sin_c * c_w - cos_c * c_s
    p_d = cos_d * d_w + sin_d * d_s
    n_d = sin_d * d_w - cos_d * d_s
    # Axial joint forces (5) and joint moments on the legs (6).
    axial_c = k_h * h_c + b_h * h_c_rate
    axial_d = k_h * h_d + b_h * h_d_rate
    moment_c = -k_t * (theta_c - phi - q_n) - b_t * (theta_c_rate - omega)
    moment_d = -k_t * (theta_d - phi + q_n) - b_t * (theta_d_rate - omega)
    # Ground forces in each leg's axes.
    across_c = friction_c * cos_c - normal_c * sin_c
    along_c = friction_c * sin_c + normal_c * cos_c
    across_d = friction_d * cos_d - normal_d * sin_d
    along_d = friction_d * sin_d + normal_d * cos_d
    # What is known of the body's accelerations before the constraint forces.
    a_s = -(axial_c * sin_c + axial_d * sin_d) * per_m
    a_w = -(axial_c * cos_c + axial_d * cos_d) * per_m
    alpha = -(moment_c + moment_d + axial_c * n_c + axial_d * n_d) * per_i
    # 2 x 2 system of the constraint forces.
    turn_c = (moment_c - arm * across_c) * per_il
    turn_d = (moment_d - arm * across_d) * per_il
    ratio_c = rho_c * per_il
    ratio_d = rho_d * per_il
    right_c = a_s * cos_c - a_w * sin_c + alpha * p_c + spin * n_c
    right_c = right_c - 2.0 * h_c_rate * theta_c_rate - across_c * per_ml - rho_c * turn_c
    right_d = a_s * cos_d - a_w * sin_d + alpha * p_d + spin * n_d
    right_d = right_d - 2.0 * h_d_rate * theta_d_rate - across_d * per_ml - rho_d * turn_d
    m_cc = per_ml + rho_c * ratio_c + per_m + p_c * p_c * per_i
    m_dd = per_ml + rho_d * ratio_d + per_m + p_d * p_d * per_i
    m_cd = (cos_c * cos_d + sin_c * sin_d) * per_m + p_c * p_d * per_i
    scale = 1.0 / (m_cc * m_dd - m_cd * m_cd)
    lam_c = (m_dd * right_c - m_cd * right_d) * scale
    lam_d = (m_cc * right_d - m_cd * right_c) * scale
    a_s = a_s - (lam_c * cos_c + lam_d * cos_d) * per_m
    a_w = a_w + (lam_c * sin_c + lam_d * sin_d) * per_m
    alpha = alpha - (lam_c * p_c + lam_d * p_d) * per_i
    theta_c_acc = turn_c + ratio_c * lam_c
    theta_d_acc = turn_d + ratio_d * lam_d
    h_c_acc = a_s * sin_c + a_w * cos_c + alpha * n_c - spin * p_c
    h_c_acc = h_c_acc + rho_c * theta_c_rate * theta_c_rate - (along_c + axial_c) * per_ml
    h_d_acc = a_s * sin_d + a_w * cos_d + alpha * n_d - spin * p_d
    h_d_acc = h_d_acc + rho_d * theta_d_rate * theta_d_rate - (along_d + axial_d) * per_ml
    return a_s + g_s, a_w + g_w, alpha, h_c_acc, theta_c_acc, h_d_acc, theta_d_acc
