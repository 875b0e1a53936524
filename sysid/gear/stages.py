"""The work buffer of the drivers, and one stage of a step: from the rows of a lane to its accelerations.

Element `row * lanes + lane` of the flat buffer belongs to a lane; the functions are inlined into loops over
lanes.
"""

from numba import njit

from sysid.gear.contact import low_friction, low_friction_damping, normal_force
from sysid.gear.dynamics import accelerations, feet, foot_looseness, pose
from sysid.gear.hybrid import event, foot_accelerations, high_friction, next_mode, settle
from sysid.integrate.tableau import A_TWICE, STAGES, A, C

START = 0  # coordinates 7, rates 7
END = 14  # the same at the step's end
RATES = 28  # accelerations at the stages, 7 rows each; the last stage is the step's end
COEFFICIENTS = RATES + 7 * (STAGES + 1)  # derived coefficients
TIME = COEFFICIENTS + 20  # time since the drop's start
STEP = TIME + 1  # step
NEW_STEP = TIME + 2
TAKEN = TIME + 3  # 1 if the step is accepted
NEXT = TIME + 4  # time of the lane's next sample
FRESH = (
    TIME + 5
)  # 1 while a new job waits for its first accelerations (a step of length 0), 2 in an idle lane
COUNT = TIME + 6  # right-hand sides spent
LIMIT = TIME + 7  # right-hand sides that the job may spend
STIFF = TIME + 8  # fastest decay rate of a foot's slip at the step's end [1/s]
# Rows of the high-friction modes, two each: rear, front.
STUCK = TIME + 9
WAY = TIME + 11
MARGIN = TIME + 13
SWITCH = TIME + 15  # 1 for a foot whose mode switches at the step's end
MU_S = TIME + 17
# Contact at the step's end, two rows each; friction at its start.
NORMAL = TIME + 18
SLIP = TIME + 20
FRICTION = TIME + 22
REQUIRED = TIME + 24
FRICTION_0 = TIME + 26
ROWS = TIME + 28


@njit(error_model="numpy", inline="always")
def advanced(work, stage, i, lane, lanes):
    """Coordinate `i` of one lane and its rate at the start of a stage.

    A coordinate's derivative is its rate, so stages of coordinates are sums over accelerations alone (Nystrom
    form).
    """
    h = work[STEP * lanes + lane]
    rate = work[(START + 7 + i) * lanes + lane]
    along = 0.0
    twice = 0.0
    for j in range(stage):
        k = work[(RATES + 7 * j + i) * lanes + lane]
        along += A[stage, j] * k
        twice += A_TWICE[stage, j] * k
    return work[(START + i) * lanes + lane] + h * (C[stage] * rate + h * twice), rate + h * along


@njit(error_model="numpy", inline="always")
def evaluate(work, stage, lane, lanes, high):
    """Accelerations of one lane at a stage; stage 0 is never evaluated (first same as last)."""
    s, s_rate = advanced(work, stage, 0, lane, lanes)
    w, w_rate = advanced(work, stage, 1, lane, lanes)
    phi, omega = advanced(work, stage, 2, lane, lanes)
    h_c, h_c_rate = advanced(work, stage, 3, lane, lanes)
    theta_c, theta_c_rate = advanced(work, stage, 4, lane, lanes)
    h_d, h_d_rate = advanced(work, stage, 5, lane, lanes)
    theta_d, theta_d_rate = advanced(work, stage, 6, lane, lanes)
    rates = (s_rate, w_rate, omega, h_c_rate, theta_c_rate, h_d_rate, theta_d_rate)
    if stage == STAGES:
        state = (s, w, phi, h_c, theta_c, h_d, theta_d)
        for i in range(7):
            work[(END + i) * lanes + lane] = state[i]
            work[(END + 7 + i) * lanes + lane] = rates[i]
    p = COEFFICIENTS * lanes + lane
    coefficients = (
        work[p],
        work[p + 1 * lanes],
        work[p + 2 * lanes],
        work[p + 3 * lanes],
        work[p + 4 * lanes],
        work[p + 5 * lanes],
        work[p + 6 * lanes],
        work[p + 7 * lanes],
        work[p + 8 * lanes],
        work[p + 9 * lanes],
        work[p + 10 * lanes],
        work[p + 11 * lanes],
        work[p + 12 * lanes],
        work[p + 13 * lanes],
        work[p + 14 * lanes],
        work[p + 15 * lanes],
    )
    k_s = work[p + 16 * lanes]
    b_s = work[p + 17 * lanes]
    mu_k = work[p + 18 * lanes]
    eps_v = work[p + 19 * lanes]
    joints = pose(phi, theta_c, theta_d, coefficients[4], coefficients[5])
    p_c, dp_c, v_c, p_d, dp_d, v_d = feet(joints, w, h_c, h_d, rates, coefficients[6])
    n_c = normal_force(p_c, dp_c, k_s, b_s)
    n_d = normal_force(p_d, dp_d, k_s, b_s)
    if high:
        move = (phi, h_c, theta_c, h_d, theta_d, rates, n_c, n_d)
        free = accelerations(joints, *move, 0.0, 0.0, coefficients)
        rear = accelerations(joints, *move, 1.0, 0.0, coefficients)
        front = accelerations(joints, *move, 0.0, 1.0, coefficients)
        t_free = foot_accelerations(joints, h_c, h_d, coefficients[6], rates, free)
        t_rear = foot_accelerations(joints, h_c, h_d, coefficients[6], rates, rear)
        t_front = foot_accelerations(joints, h_c, h_d, coefficients[6], rates, front)
        response = (t_rear[0] - t_free[0], t_front[0] - t_free[0], t_front[1] - t_free[1])
        f_c, f_d, r_c, r_d = high_friction(
            t_free,
            response,
            (n_c, n_d),
            (v_c, v_d),
            work[STUCK * lanes + lane],
            work[(STUCK + 1) * lanes + lane],
            work[WAY * lanes + lane],
            work[(WAY + 1) * lanes + lane],
            mu_k,
        )
        acc = (
            free[0] + f_c * (rear[0] - free[0]) + f_d * (front[0] - free[0]),
            free[1] + f_c * (rear[1] - free[1]) + f_d * (front[1] - free[1]),
            free[2] + f_c * (rear[2] - free[2]) + f_d * (front[2] - free[2]),
            free[3] + f_c * (rear[3] - free[3]) + f_d * (front[3] - free[3]),
            free[4] + f_c * (rear[4] - free[4]) + f_d * (front[4] - free[4]),
            free[5] + f_c * (rear[5] - free[5]) + f_d * (front[5] - free[5]),
            free[6] + f_c * (rear[6] - free[6]) + f_d * (front[6] - free[6]),
        )
        if stage == STAGES:
            work[STIFF * lanes + lane] = 0.0
            work[NORMAL * lanes + lane] = n_c
            work[(NORMAL + 1) * lanes + lane] = n_d
            work[SLIP * lanes + lane] = v_c
            work[(SLIP + 1) * lanes + lane] = v_d
            work[FRICTION * lanes + lane] = f_c
            work[(FRICTION + 1) * lanes + lane] = f_d
            work[REQUIRED * lanes + lane] = r_c
            work[(REQUIRED + 1) * lanes + lane] = r_d
    else:
        f_c, f_d = low_friction(n_c, n_d, v_c, v_d, mu_k, eps_v)
        if stage == STAGES:
            loose_c, loose_d = foot_looseness(joints, h_c, h_d, coefficients)
            stiff_c = loose_c * low_friction_damping(n_c, v_c, mu_k, eps_v)
            stiff_d = loose_d * low_friction_damping(n_d, v_d, mu_k, eps_v)
            work[STIFF * lanes + lane] = stiff_c if stiff_c > stiff_d else stiff_d
        acc = accelerations(joints, phi, h_c, theta_c, h_d, theta_d, rates, n_c, n_d, f_c, f_d, coefficients)
    k = (RATES + 7 * stage) * lanes + lane
    work[k] = acc[0]
    work[k + 1 * lanes] = acc[1]
    work[k + 2 * lanes] = acc[2]
    work[k + 3 * lanes] = acc[3]
    work[k + 4 * lanes] = acc[4]
    work[k + 5 * lanes] = acc[5]
    work[k + 6 * lanes] = acc[6]


@njit(error_model="numpy", inline="always")
def switch(work, lane, lanes, h, taken, new_h):
    """Cut a step at the first loss of a foot's mode and switch modes there; returns taken and next step."""
    mu_k = work[(COEFFICIENTS + 18) * lanes + lane]
    mu_s = work[MU_S * lanes + lane]
    c = lane
    d = lanes + lane
    stuck_c, way_c, margin_c = work[STUCK * lanes + c], work[WAY * lanes + c], work[MARGIN * lanes + c]
    stuck_d, way_d, margin_d = work[STUCK * lanes + d], work[WAY * lanes + d], work[MARGIN * lanes + d]
    n_c, v_c, r_c = work[NORMAL * lanes + c], work[SLIP * lanes + c], work[REQUIRED * lanes + c]
    n_d, v_d, r_d = work[NORMAL * lanes + d], work[SLIP * lanes + d], work[REQUIRED * lanes + d]
    now_c, lost_c, share_c = event(stuck_c, way_c, n_c, v_c, r_c, margin_c, mu_s)
    now_d, lost_d, share_d = event(stuck_d, way_d, n_d, v_d, r_d, margin_d, mu_s)
    taken, new_h, hit = settle(share_c, share_d, h, taken, new_h)
    switch_c = hit * lost_c
    switch_d = hit * lost_d
    stuck_c, way_c, margin_c = next_mode(
        switch_c, stuck_c, way_c, n_c, v_c, r_c, margin_c, now_c, taken, mu_k
    )
    stuck_d, way_d, margin_d = next_mode(
        switch_d, stuck_d, way_d, n_d, v_d, r_d, margin_d, now_d, taken, mu_k
    )
    work[STUCK * lanes + c] = stuck_c
    work[STUCK * lanes + d] = stuck_d
    work[WAY * lanes + c] = way_c
    work[WAY * lanes + d] = way_d
    work[MARGIN * lanes + c] = margin_c
    work[MARGIN * lanes + d] = margin_d
    work[SWITCH * lanes + c] = switch_c
    work[SWITCH * lanes + d] = switch_d
    return taken, new_h
