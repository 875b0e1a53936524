"""Equations of motion (11, 12) of body and two legs, solved for the accelerations.

Notes
-----
Everything is relative to free fall: without weights the legs obey the same equations, and gravity is added to
the body at the end. Thrust acts on the body along ``ez(phi)``: ``lift`` is its sum over m_B, ``tilt`` its
moment over I_B (the rear pair of motors pitches toward +). With ``rho`` the distance of a leg's centre of
mass from its joint, ``F`` the ground's force on the foot at distance ``arm`` below that centre, ``S = k_h h +
b_h h'`` the axial joint force (5), ``M`` the joint moment on the leg (6) and ``lam`` the constraint force of
the joint on the leg along ``ex``:

    m_leg (a_j.ex - 2 h' theta' - rho theta'') = F.ex + lam
    I_leg theta'' = M - arm F.ex + rho lam
    h''  = a_j.ez + rho theta'^2 - (F.ez + S)/m_leg
    a_B  = -sum(lam ex + S ez)/m_B,   alpha = sum(-M - lam p - S n)/I_B
    a_j.ex = a_B.ex + alpha p + omega^2 n,   a_j.ez = a_B.ez + alpha n - omega^2 p

where ``p = ex.r'``, ``n = ez.r'`` and ``r' = (r_w, -r_s)`` is the joint's offset turned a quarter.
Eliminating all but the two ``lam`` leaves one symmetric, positive definite 2 x 2 system: a single division.
"""

from collections import namedtuple

import numpy as np

from sysid.gear.kernel import parameter_row as column
from sysid.gear.kernel.geometry import foot_motion, joint_position, sine_cosine
from sysid.integrate.fused import fused, part

# Numbers of the equations of motion; C is the rear leg, D the front leg. k_h, b_h: axial spring and damper;
# k_t, b_t: bending; dx_j, dz_j: joints; length, q_n: length and angle of a leg at rest; arm, rho_0:
# distance of its centre of mass from the foot and, at rest, from the joint; per_m, per_i: 1/m_B, 1/I_B;
# per_mc, per_ic, per_md, per_id: 1/m_leg, 1/I_leg; g_s, g_w: gravity along the slope's tangent and normal.
Coefficients = namedtuple(
    "Coefficients",
    "k_h_c b_h_c k_t_c b_t_c k_h_d b_h_d k_t_d b_t_d dx_j dz_j length q_n arm rho_0 "
    "per_m per_i per_mc per_ic per_md per_id g_s g_w",
)


@part
def derived(p, slope):
    """`Coefficients` of a row of `sysid.gear.kernel.parameter_row` on a slope [rad]."""
    k_h, b_h = p[column.LEG_AXIAL_STIFFNESS], p[column.LEG_AXIAL_DAMPING]
    k_t, b_t = p[column.LEG_BENDING_STIFFNESS], p[column.LEG_BENDING_DAMPING]
    mass, inertia, fraction = p[column.LEG_MASS], p[column.LEG_INERTIA], p[column.LEG_MASS_FRACTION]
    front_mass = mass * p[column.FRONT_LEG_MASS_RATIO]
    front_inertia = inertia * p[column.FRONT_LEG_INERTIA_RATIO]
    dx_j, dz_j = p[column.JOINT_DX], p[column.JOINT_DZ]
    span, drop = p[column.FOOT_DX] - dx_j, p[column.FOOT_DZ] - dz_j
    length = np.sqrt(span * span + drop * drop)
    g = p[column.GRAVITY]
    return Coefficients(
        k_h, b_h, k_t, b_t,
        k_h * p[column.FRONT_LEG_AXIAL_STIFFNESS_RATIO], b_h * p[column.FRONT_LEG_AXIAL_DAMPING_RATIO],
        k_t * p[column.FRONT_LEG_BENDING_STIFFNESS_RATIO], b_t * p[column.FRONT_LEG_BENDING_DAMPING_RATIO],
        dx_j, dz_j, length, np.arctan2(span, drop), fraction * length, (1.0 - fraction) * length,
        1.0 / p[column.BODY_MASS], 1.0 / p[column.BODY_INERTIA],
        1.0 / mass, 1.0 / inertia, 1.0 / front_mass, 1.0 / front_inertia,
        g * np.sin(slope), -g * np.cos(slope),
    )  # fmt: skip


@fused
def pose(phi, theta_c, theta_d, dx_j, dz_j):
    """Cosines and sines of both legs' and the body's angles from the slope, and the joints' offsets [m].

    Returned as cos, sin of leg C; of leg D; offset of joint C (along, normal); of joint D; cos, sin of phi.
    """
    sin_phi, cos_phi = sine_cosine(phi)
    sin_c, cos_c = sine_cosine(theta_c)
    sin_d, cos_d = sine_cosine(theta_d)
    c_s, c_w = joint_position(cos_phi, sin_phi, 1.0, dx_j, dz_j)
    d_s, d_w = joint_position(cos_phi, sin_phi, -1.0, dx_j, dz_j)
    return cos_c, sin_c, cos_d, sin_d, c_s, c_w, d_s, d_w, cos_phi, sin_phi


@fused
def feet(joints, w, h_c, h_d, rates, l):  # noqa: E741
    """Penetration, its rate and slip speed of the rear foot, then of the front foot [m, m/s, m/s]."""
    cos_c, sin_c, cos_d, sin_d, c_s, c_w, d_s, d_w, _, _ = joints
    s_rate, w_rate, omega, h_c_rate, theta_c_rate, h_d_rate, theta_d_rate = rates
    rear = foot_motion(w, s_rate, w_rate, omega, c_s, c_w, l + h_c, h_c_rate, cos_c, sin_c, theta_c_rate)
    front = foot_motion(w, s_rate, w_rate, omega, d_s, d_w, l + h_d, h_d_rate, cos_d, sin_d, theta_d_rate)
    return rear[0], rear[1], rear[2], front[0], front[1], front[2]


@fused
def foot_looseness(joints, h_c, h_d, coefficients):
    """Tangential acceleration of each foot per newton of friction on it [1/kg], estimated from above.

    The leg turns about a joint held still, slides along its axis, and the body moves as if it had no legs.
    """
    cos_c, sin_c, cos_d, sin_d, _, c_w, _, d_w, _, _ = joints
    return _looseness(cos_c, sin_c, c_w, cos_d, sin_d, d_w, h_c, h_d, coefficients)


@fused
def _looseness(lever_c, slide_c, arm_c, lever_d, slide_d, arm_d, h_c, h_d, coefficients):
    """Acceleration of each foot per newton on it along a direction [1/kg].

    Of each leg: the direction's share across the leg and along it, and the lever of the joint about the
    body's centre of mass [m].
    """
    l = coefficients.length  # noqa: E741
    per_m, per_i = coefficients.per_m, coefficients.per_i
    per_mc, per_ic = coefficients.per_mc, coefficients.per_ic
    per_md, per_id = coefficients.per_md, coefficients.per_id
    rho_c = coefficients.rho_0 + h_c
    rho_d = coefficients.rho_0 + h_d
    lever_c = lever_c * (l + h_c)
    lever_d = lever_d * (l + h_d)
    loose_c = per_m + arm_c * arm_c * per_i + slide_c * slide_c * per_mc
    loose_c = loose_c + lever_c * lever_c * per_ic * per_mc / (per_mc + rho_c * rho_c * per_ic)
    loose_d = per_m + arm_d * arm_d * per_i + slide_d * slide_d * per_md
    loose_d = loose_d + lever_d * lever_d * per_id * per_md / (per_md + rho_d * rho_d * per_id)
    return loose_c, loose_d


@fused
def ringing(joints, h_c, h_d, normals, k_s, coefficients):
    """Fastest frequency at which a leg rings between body and ground [rad/s], and its damping ratio.

    Estimated from above, like `foot_looseness`: along the slope's normal, the ground's and the leg's spring
    in parallel. Zero while no foot touches.
    """
    cos_c, sin_c, cos_d, sin_d, c_s, _, d_s, _, _, _ = joints
    loose_c, loose_d = _looseness(sin_c, cos_c, c_s, sin_d, cos_d, d_s, h_c, h_d, coefficients)
    normal_c, normal_d = normals
    square_c = (k_s + coefficients.k_h_c) * loose_c if normal_c > 0.0 else 0.0
    square_d = (k_s + coefficients.k_h_d) * loose_d if normal_d > 0.0 else 0.0
    rear = square_c > square_d
    rate = np.sqrt(square_c if rear else square_d)
    decay = coefficients.b_h_c * coefficients.per_mc if rear else coefficients.b_h_d * coefficients.per_md
    return rate, 0.5 * decay / (rate + 1e-3)


@fused
def accelerations(joints, angles, rates, loads, normals, friction_c, friction_d, coefficients):
    """Second time derivatives of (s, w, phi, h_C, theta_C, h_D, theta_D) under given forces on the feet.

    Parameters
    ----------
    joints : tuple
        From `pose`.
    angles : tuple of 5 float
        phi, h_C, theta_C, h_D, theta_D: angles of body and legs from the slope [rad], extensions [m].
    rates : tuple of 7 float
        Rates of the coordinates.
    loads : tuple of 6 float
        lift [m/s²] and tilt [rad/s²]; what `sysid.gear.kernel.terms` add to the axial forces of the rear and
        the front joint [N] and to their moments on the legs [N·m].
    normals : tuple of 2 float
        Forces on the rear and front foot along the slope's normal [N].
    friction_c, friction_d : float
        Forces on the feet along the down-slope tangent [N].
    coefficients : Coefficients
    """
    cos_c, sin_c, cos_d, sin_d, c_s, c_w, d_s, d_w, cos_phi, sin_phi = joints
    phi, h_c, theta_c, h_d, theta_d = angles
    lift, tilt, more_axial_c, more_axial_d, more_moment_c, more_moment_d = loads
    normal_c, normal_d = normals
    _, _, omega, h_c_rate, theta_c_rate, h_d_rate, theta_d_rate = rates
    q_n, arm = coefficients.q_n, coefficients.arm
    per_m, per_i = coefficients.per_m, coefficients.per_i
    per_mc, per_ic = coefficients.per_mc, coefficients.per_ic
    per_md, per_id = coefficients.per_md, coefficients.per_id
    spin = omega * omega
    rho_c = coefficients.rho_0 + h_c
    rho_d = coefficients.rho_0 + h_d
    p_c, n_c, p_d, n_d = _quarter_turned(cos_c, sin_c, cos_d, sin_d, c_s, c_w, d_s, d_w)
    # Axial joint forces (5) and joint moments on the legs (6).
    axial_c = coefficients.k_h_c * h_c + coefficients.b_h_c * h_c_rate
    axial_d = coefficients.k_h_d * h_d + coefficients.b_h_d * h_d_rate
    moment_c = -coefficients.k_t_c * (theta_c - phi - q_n) - coefficients.b_t_c * (theta_c_rate - omega)
    moment_d = -coefficients.k_t_d * (theta_d - phi + q_n) - coefficients.b_t_d * (theta_d_rate - omega)
    axial_c = axial_c + more_axial_c
    axial_d = axial_d + more_axial_d
    moment_c = moment_c + more_moment_c
    moment_d = moment_d + more_moment_d
    # Ground forces in each leg's axes.
    across_c = friction_c * cos_c - normal_c * sin_c
    along_c = friction_c * sin_c + normal_c * cos_c
    across_d = friction_d * cos_d - normal_d * sin_d
    along_d = friction_d * sin_d + normal_d * cos_d
    # The body's accelerations without the constraint forces.
    a_s = lift * sin_phi - (axial_c * sin_c + axial_d * sin_d) * per_m
    a_w = lift * cos_phi - (axial_c * cos_c + axial_d * cos_d) * per_m
    alpha = tilt - (moment_c + moment_d + (axial_c * n_c + axial_d * n_d)) * per_i
    turns = ((moment_c - arm * across_c) * per_ic, (moment_d - arm * across_d) * per_id)
    # Across each leg at its joint, and along its axis.
    gap_c = spin * n_c - 2.0 * h_c_rate * theta_c_rate - across_c * per_mc
    gap_d = spin * n_d - 2.0 * h_d_rate * theta_d_rate - across_d * per_md
    slide_c = rho_c * theta_c_rate * theta_c_rate - spin * p_c - (along_c + axial_c) * per_mc
    slide_d = rho_d * theta_d_rate * theta_d_rate - spin * p_d - (along_d + axial_d) * per_md
    known = (a_s, a_w, alpha)
    a_s, a_w, alpha, h_c_acc, theta_c_acc, h_d_acc, theta_d_acc = _joined(
        joints, h_c, h_d, coefficients, known, turns, (gap_c, gap_d), (slide_c, slide_d)
    )
    a_s = a_s + coefficients.g_s
    a_w = a_w + coefficients.g_w
    return a_s, a_w, alpha, h_c_acc, theta_c_acc, h_d_acc, theta_d_acc


@fused
def friction_responses(joints, h_c, h_d, coefficients):
    """Accelerations per newton of friction on the rear foot, and per newton on the front foot [1/kg, ...].

    The motion is linear in the forces on the feet: these are its derivatives, `accelerations` with nothing
    but that newton.
    """
    cos_c, sin_c, cos_d, sin_d = joints[:4]
    arm = coefficients.arm
    per_mc, per_ic = coefficients.per_mc, coefficients.per_ic
    per_md, per_id = coefficients.per_md, coefficients.per_id
    still = (0.0, 0.0, 0.0)
    turns = (-arm * cos_c * per_ic, 0.0)
    gaps, slides = (-cos_c * per_mc, 0.0), (-sin_c * per_mc, 0.0)
    rear = _joined(joints, h_c, h_d, coefficients, still, turns, gaps, slides)
    turns = (0.0, -arm * cos_d * per_id)
    gaps, slides = (0.0, -cos_d * per_md), (0.0, -sin_d * per_md)
    front = _joined(joints, h_c, h_d, coefficients, still, turns, gaps, slides)
    return rear, front


@fused
def _joined(joints, h_c, h_d, coefficients, known, turns, gaps, slides):
    """Accelerations when the joints hold body and legs together, gravity apart.

    Parameters
    ----------
    known : tuple of 3 float
        Body's accelerations before the constraint forces.
    turns, gaps, slides : tuples of 2 float
        What each leg does before them: angular acceleration, acceleration across the leg at its joint beyond
        what body and turn give, second derivative of its extension beyond what the body gives.
    """
    cos_c, sin_c, cos_d, sin_d, c_s, c_w, d_s, d_w, _, _ = joints
    a_s, a_w, alpha = known
    turn_c, turn_d = turns
    gap_c, gap_d = gaps
    slide_c, slide_d = slides
    per_m, per_i = coefficients.per_m, coefficients.per_i
    per_mc, per_ic = coefficients.per_mc, coefficients.per_ic
    per_md, per_id = coefficients.per_md, coefficients.per_id
    rho_c = coefficients.rho_0 + h_c
    rho_d = coefficients.rho_0 + h_d
    p_c, n_c, p_d, n_d = _quarter_turned(cos_c, sin_c, cos_d, sin_d, c_s, c_w, d_s, d_w)
    ratio_c = rho_c * per_ic
    ratio_d = rho_d * per_id
    right_c = a_s * cos_c - a_w * sin_c + alpha * p_c + gap_c - rho_c * turn_c
    right_d = a_s * cos_d - a_w * sin_d + alpha * p_d + gap_d - rho_d * turn_d
    # 2 x 2 system of the constraint forces.
    m_cc = per_mc + rho_c * ratio_c + per_m + p_c * p_c * per_i
    m_dd = per_md + rho_d * ratio_d + per_m + p_d * p_d * per_i
    m_cd = (cos_c * cos_d + sin_c * sin_d) * per_m + p_c * p_d * per_i
    scale = 1.0 / (m_cc * m_dd - m_cd * m_cd)
    lam_c = (m_dd * right_c - m_cd * right_d) * scale
    lam_d = (m_cc * right_d - m_cd * right_c) * scale
    a_s = a_s - (lam_c * cos_c + lam_d * cos_d) * per_m
    a_w = a_w + (lam_c * sin_c + lam_d * sin_d) * per_m
    alpha = alpha - (lam_c * p_c + lam_d * p_d) * per_i
    theta_c_acc = turn_c + ratio_c * lam_c
    theta_d_acc = turn_d + ratio_d * lam_d
    h_c_acc = a_s * sin_c + a_w * cos_c + alpha * n_c + slide_c
    h_d_acc = a_s * sin_d + a_w * cos_d + alpha * n_d + slide_d
    return a_s, a_w, alpha, h_c_acc, theta_c_acc, h_d_acc, theta_d_acc


@fused
def _quarter_turned(cos_c, sin_c, cos_d, sin_d, c_s, c_w, d_s, d_w):
    """Each joint's quarter-turned offset r' = (r_w, -r_s) in its leg's axes: across, along."""
    p_c = cos_c * c_w + sin_c * c_s
    n_c = sin_c * c_w - cos_c * c_s
    p_d = cos_d * d_w + sin_d * d_s
    n_d = sin_d * d_w - cos_d * d_s
    return p_c, n_c, p_d, n_d
