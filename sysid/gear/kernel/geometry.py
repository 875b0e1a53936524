"""Where the joints, legs and feet are and how fast, in the frame of the slope, and the force on a foot.

The kernel works in the frame of the slope: ``s`` along the surface (down-slope), ``w`` along its normal, and
every angle measured from the surface. With ``ex(a) = (cos a, -sin a)`` and ``ez(a) = (sin a, cos a)`` the
body has the axes ``ex(phi), ez(phi)``, a leg the axes ``ex(theta), ez(theta)``. Both legs obey the same
formulas; only the sign ``side`` of the joint's offset differs (+1 rear leg C, -1 front leg D).

All functions are scalar, branch-free and inlined, so that a loop over lanes around them becomes packed
instructions.
"""

from sysid.integrate.fused import fused

# Adding and subtracting 1.5 * 2**52 rounds a double to the nearest integer with plain additions, on any CPU.
_ROUND = 6755399441055744.0
_INVERSE_PI = 0.3183098861837907
# pi in two parts, the first with 27 trailing zero bits: k * _PI_HIGH is exact for |k| < 2**27.
_PI_HIGH = 3.1415926218032837
_PI_LOW = 3.178650954705639e-08


@fused
def sine_cosine(angle):
    """Sine and cosine of an angle [rad], absolute error below 5e-16 for |angle| < 1e4 rad.

    Reduced to [-pi/2, pi/2]; polynomials interpolate sin(r)/r and cos(r) at Chebyshev points of r**2.
    """
    turns = (angle * _INVERSE_PI + _ROUND) - _ROUND
    r = (angle - turns * _PI_HIGH) - turns * _PI_LOW
    half = 0.5 * turns
    odd = half - ((half + _ROUND) - _ROUND)
    sign = 1.0 - 4.0 * (odd if odd > 0.0 else -odd)
    z = r * r
    sine = -7.374387503521372e-13
    sine = sine * z + 1.6048168318138263e-10
    sine = sine * z - 2.505188194671173e-08
    sine = sine * z + 2.755731660907366e-06
    sine = sine * z - 0.00019841269824861894
    sine = sine * z + 0.008333333333282756
    sine = sine * z - 0.16666666666666072
    cosine = 4.608977002788393e-14
    cosine = cosine * z - 1.1462901901737527e-11
    cosine = cosine * z + 2.0876561839932423e-09
    cosine = cosine * z - 2.7557316391025735e-07
    cosine = cosine * z + 2.4801587277414923e-05
    cosine = cosine * z - 0.001388888888877299
    cosine = cosine * z + 0.04166666666666388
    cosine = cosine * z - 0.4999999999999997
    return sign * (r + r * z * sine), sign * (1.0 + z * cosine)


@fused
def joint_position(cos_phi, sin_phi, side, dx_j, dz_j):
    """Joint from the body's centre of mass in the slope frame (along, normal) [m].

    Notes
    -----
    ``r = -side dx_j ex(phi) - dz_j ez(phi)``. Turning with rate ``omega`` it moves at ``omega (r_w, -r_s)``.
    """
    along = -side * dx_j * cos_phi - dz_j * sin_phi
    normal = side * dx_j * sin_phi - dz_j * cos_phi
    return along, normal


@fused
def foot_motion(w, s_rate, w_rate, omega, joint_s, joint_w, length, h_rate, cos_theta, sin_theta, theta_rate):
    """Penetration [m] of a foot into the surface, its rate [m/s] and the foot's slip speed down-slope [m/s].

    `length` is the length of the deflected leg, l + h [m]; foot = joint - length ez(theta).
    """
    penetration = -(w + joint_w - length * cos_theta)
    penetration_rate = -(w_rate - omega * joint_s - h_rate * cos_theta + length * theta_rate * sin_theta)
    slip = s_rate + omega * joint_w - h_rate * sin_theta - length * theta_rate * cos_theta
    return penetration, penetration_rate, slip


@fused
def normal_force(penetration, penetration_rate, k_s, b_s):
    """Normal force on a foot [N], equation (7): spring always, damper only while the foot goes deeper."""
    damping = b_s * penetration_rate if penetration_rate > 0.0 else 0.0
    return k_s * penetration + damping if penetration > 0.0 else 0.0
