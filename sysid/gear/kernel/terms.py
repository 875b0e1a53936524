"""Terms on trial: physics that the paper's gear lacks, added to its forces; zero by default.

A driver is made with or without all of them (`sysid.gear.kernel.driver.drop_driver`). Without, the compiler
drops the sums, so they cost nothing; with all values zero both give the same bits. `h` is the extension of a
leg and `q` its bend from rest; both feet and both legs have the same terms.

===================  ===========================================  ==========================================
column               added                                        source
===================  ===========================================  ==========================================
axial hardening      axial force k_h c h³                         a buckled leg stiffens (Duffing)
bending hardening    joint moment k_t c q³                        flexures and bolted joints (Duffing)
slide friction       axial force F h'/sqrt(h'² + v²)              Coulomb, smoothed below v = 0.01 m/s
joint friction       joint moment M q'/sqrt(q'² + w²)             Coulomb, smoothed below w = 0.1 rad/s
rate stiffening      normal force k_s c p p' while p' > 0         Hunt & Crossley 1975, loading branch
pitch drag           moment -c |omega| omega on the body          quadratic drag of a turning body
===================  ===========================================  ==========================================

Further terms need no column here: ratios of the front legs, and the front feet's excess of friction, which
both laws read (friction of polymers changes with load and wear; Bowden & Tabor 1950).
"""

import numpy as np

from sysid.gear.kernel import parameter_row as column
from sysid.gear.kernel import work_buffer as at
from sysid.integrate.fused import fused

# Largest speeds at which dry friction is smoothed [m/s, rad/s].
_SLIDE_SPEED, _JOINT_SPEED = 0.01, 0.1


@fused
def _value(name, work, lane, lanes):
    return work[(at.TERM_VALUES + name - column.FIRST_TERM) * lanes + lane]


@fused
def nothing_added(angles, rates, coefficients, work, lane, lanes):
    """The terms of the paper's model: none. Adding -0.0 changes no number, and the compiler drops it."""
    return -0.0, -0.0, -0.0, -0.0, -0.0, 0.0


@fused
def no_approach(penetration, k_s, work, lane, lanes):
    """What the paper's ground adds to its damper."""
    return -0.0


@fused
def approach(penetration, k_s, work, lane, lanes):
    """What the ground's rate stiffening adds to its damper at a penetration [N·s/m]."""
    return k_s * _value(column.GROUND_RATE_STIFFENING, work, lane, lanes) * penetration


@fused
def added(angles, rates, coefficients, work, lane, lanes):
    """Added axial forces of the rear and front joint [N], moments on the legs [N·m], pitch [rad/s²].

    Last the fastest decay rate of the frictions [1/s], which bounds the explicit step.
    """
    phi, h_c, theta_c, h_d, theta_d = angles
    _, _, omega, h_c_rate, theta_c_rate, h_d_rate, theta_d_rate = rates
    axial = _value(column.LEG_AXIAL_HARDENING, work, lane, lanes)
    bending = _value(column.LEG_BENDING_HARDENING, work, lane, lanes)
    slide = _value(column.LEG_SLIDE_FRICTION, work, lane, lanes)
    joint = _value(column.LEG_JOINT_FRICTION, work, lane, lanes)
    drag = _value(column.PITCH_DRAG, work, lane, lanes)
    bend_c = theta_c - phi - coefficients.q_n
    bend_d = theta_d - phi + coefficients.q_n
    turn_c = theta_c_rate - omega
    turn_d = theta_d_rate - omega
    slow_c = 1.0 / np.sqrt(h_c_rate * h_c_rate + _SLIDE_SPEED**2)
    slow_d = 1.0 / np.sqrt(h_d_rate * h_d_rate + _SLIDE_SPEED**2)
    still_c = 1.0 / np.sqrt(turn_c * turn_c + _JOINT_SPEED**2)
    still_d = 1.0 / np.sqrt(turn_d * turn_d + _JOINT_SPEED**2)
    axial_c = coefficients.k_h_c * axial * (h_c * h_c * h_c) + slide * (h_c_rate * slow_c)
    axial_d = coefficients.k_h_d * axial * (h_d * h_d * h_d) + slide * (h_d_rate * slow_d)
    moment_c = -(coefficients.k_t_c * bending * (bend_c * bend_c * bend_c) + joint * (turn_c * still_c))
    moment_d = -(coefficients.k_t_d * bending * (bend_d * bend_d * bend_d) + joint * (turn_d * still_d))
    spin = omega if omega > 0.0 else -omega
    slides = slide * (slow_c * coefficients.per_mc if slow_c > slow_d else slow_d * coefficients.per_md)
    turns = joint * (still_c * coefficients.per_ic if still_c > still_d else still_d * coefficients.per_id)
    decay = slides if slides > turns else turns
    return axial_c, axial_d, moment_c, moment_d, -drag * spin * omega * coefficients.per_i, decay
