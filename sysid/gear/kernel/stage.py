"""One stage of a step: from the rows of a lane to its accelerations. Inlined into loops over lanes."""

from sysid.gear.kernel import work_buffer as at
from sysid.gear.kernel.dynamics import Coefficients, feet, pose, ringing
from sysid.gear.kernel.geometry import normal_force
from sysid.integrate.fused import fused, rewritten
from sysid.integrate.tableau import A_TWICE, REAL_LIMIT, RING_GAIN, RING_LIMIT, RING_MOST, STAGES, A, C
from sysid.types import Compiled

# Share of the method's real stability limit that a step may use [1]: the slip's decay rate can grow within
# the step.
STABLE = 0.9

# Names that a driver binds: to the motion below, a surface's functions, and `sysid.gear.kernel.terms`.
motion: Compiled = None  # type: ignore[assignment]
solve: Compiled = None  # type: ignore[assignment]
modes = False
added: Compiled = None  # type: ignore[assignment]
approach: Compiled = None  # type: ignore[assignment]


@fused
def advanced(work, stage, i, lane, lanes):
    """Coordinate `i` of one lane and its rate at the start of a stage.

    A coordinate's derivative is its rate, so stages of coordinates are sums over accelerations alone (Nystrom
    form).
    """
    h = work[at.STEP * lanes + lane]
    rate = work[(at.START + at.COORDINATES + i) * lanes + lane]
    along = 0.0
    twice = 0.0
    for j in range(stage):
        k = work[(at.RATES + at.COORDINATES * j + i) * lanes + lane]
        along += A[stage, j] * k
        twice += A_TWICE[stage, j] * k
    return work[(at.START + i) * lanes + lane] + h * (C[stage] * rate + h * twice), rate + h * along


@fused
def cubic(work, row, elapsed, lane, lanes):
    """Value of a cubic whose four coefficients start at `row`."""
    value = work[(row + 3) * lanes + lane]
    value = value * elapsed + work[(row + 2) * lanes + lane]
    value = value * elapsed + work[(row + 1) * lanes + lane]
    return value * elapsed + work[row * lanes + lane]


@fused
def coefficients_at(work, p, n):
    """The coefficients that a lane keeps from place `p` on, `n` apart."""
    return Coefficients(
        work[p], work[p + n], work[p + 2 * n], work[p + 3 * n], work[p + 4 * n], work[p + 5 * n],
        work[p + 6 * n], work[p + 7 * n], work[p + 8 * n], work[p + 9 * n], work[p + 10 * n],
        work[p + 11 * n], work[p + 12 * n], work[p + 13 * n], work[p + 14 * n], work[p + 15 * n],
        work[p + 16 * n], work[p + 17 * n], work[p + 18 * n], work[p + 19 * n], work[p + 20 * n],
        work[p + 21 * n],
    )  # fmt: skip


@fused
def law_at(work, p, n):
    """The numbers that the friction law reads, from place `p` on, `n` apart."""
    return work[p], work[p + n], work[p + 2 * n], work[p + 3 * n], work[p + 4 * n], work[p + 5 * n]


@fused
def put(work, row, numbers, lane, lanes):
    """Write numbers into rows of a lane from `row` on."""
    for i in range(len(numbers)):
        work[(row + i) * lanes + lane] = numbers[i]


@rewritten
def motion_at(state, rates, share, work, lane, lanes):
    """Accelerations of one lane in a state, `share` of the step after its start, and what its feet do.

    That is (normal forces, slips, required frictions) of rear and front, their frictions, and the inverse of
    the longest stable step [1/s], for a stage that needs them. A text, compiled once per surface and inlined
    in every stage: `solve` belongs to the friction law.
    """
    _, w, phi, h_c, theta_c, h_d, theta_d = state
    coefficients = coefficients_at(work, at.COEFFICIENTS * lanes + lane, lanes)
    law = law_at(work, at.LAW * lanes + lane, lanes)
    mode = (
        work[at.STUCK * lanes + lane], work[(at.STUCK + 1) * lanes + lane],
        work[at.WAY * lanes + lane], work[(at.WAY + 1) * lanes + lane],
    )  # fmt: skip
    time, step = work[at.TIME * lanes + lane], work[at.STEP * lanes + lane]
    elapsed = time + share * step - work[at.ORIGIN * lanes + lane]
    lift, tilt = cubic(work, at.LIFT, elapsed, lane, lanes), cubic(work, at.TILT, elapsed, lane, lanes)
    joints = pose(phi, theta_c, theta_d, coefficients.dx_j, coefficients.dz_j)
    p_c, dp_c, v_c, p_d, dp_d, v_d = feet(joints, w, h_c, h_d, rates, coefficients.length)
    k_s = work[at.GROUND_SPRING * lanes + lane]
    b_s = work[at.GROUND_DAMPER * lanes + lane]
    n_c = normal_force(p_c, dp_c, k_s, b_s + approach(p_c, k_s, work, lane, lanes))
    n_d = normal_force(p_d, dp_d, k_s, b_s + approach(p_d, k_s, work, lane, lanes))
    angles = (phi, h_c, theta_c, h_d, theta_d)
    axial_c, axial_d, moment_c, moment_d, drag, decay = added(angles, rates, coefficients, work, lane, lanes)
    loads = (lift, tilt + drag, axial_c, axial_d, moment_c, moment_d)
    acceleration, frictions, required, stiff = solve(
        joints, angles, rates, loads, (n_c, n_d), (v_c, v_d), mode, law, coefficients
    )
    rate, damping = ringing(joints, h_c, h_d, (n_c, n_d), k_s, coefficients)
    reach = RING_LIMIT + RING_GAIN * damping
    rate = rate / (reach if reach < RING_MOST else RING_MOST)
    stiff = (stiff if stiff > decay else decay) * (1.0 / (STABLE * REAL_LIMIT))
    stiff = stiff if stiff > rate else rate
    return acceleration, (n_c, n_d, v_c, v_d, required[0], required[1]), frictions, stiff


def evaluate(work, stage, lane, lanes):
    """Write accelerations of one lane at a stage; stage 0 is never evaluated (first same as last).

    A text: `modes` says whether the friction law has modes, which look at the stages within the step.
    """
    s, s_rate = advanced(work, stage, at.S, lane, lanes)
    w, w_rate = advanced(work, stage, at.W, lane, lanes)
    phi, omega = advanced(work, stage, at.PHI, lane, lanes)
    h_c, h_c_rate = advanced(work, stage, at.H_C, lane, lanes)
    theta_c, theta_c_rate = advanced(work, stage, at.THETA_C, lane, lanes)
    h_d, h_d_rate = advanced(work, stage, at.H_D, lane, lanes)
    theta_d, theta_d_rate = advanced(work, stage, at.THETA_D, lane, lanes)
    state = (s, w, phi, h_c, theta_c, h_d, theta_d)
    rates = (s_rate, w_rate, omega, h_c_rate, theta_c_rate, h_d_rate, theta_d_rate)
    acceleration, contact, frictions, stiff = motion(state, rates, C[stage], work, lane, lanes)
    put(work, at.RATES + at.COORDINATES * stage, acceleration, lane, lanes)
    if stage == STAGES:
        put(work, at.END, state, lane, lanes)
        put(work, at.END + at.COORDINATES, rates, lane, lanes)
        put(work, at.NORMAL, contact, lane, lanes)
        put(work, at.FRICTION, frictions, lane, lanes)
        work[at.STIFF * lanes + lane] = stiff
    elif modes:
        put(work, at.INNER + at.INNER_ROWS * (stage - 1), contact, lane, lanes)
