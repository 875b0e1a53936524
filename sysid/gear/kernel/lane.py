"""Work on one lane (one simulation's place in the buffer): loading start and thrust, reading a step."""

import numpy as np
from numba.core.types import int64
from numba.extending import intrinsic

from sysid.gear.kernel import work_buffer as at
from sysid.gear.kernel.dynamics import derived, feet, pose
from sysid.gear.kernel.parameter_row import (
    FIRST_TERM,
    GROUND_DAMPING,
    GROUND_STIFFNESS,
    LAW_READS,
    LAW_SLOTS,
    TERMS,
    THRUST_POINT_DX,
)
from sysid.gear.kernel.stage import coefficients_at
from sysid.integrate.fused import fused, part
from sysid.integrate.tableau import STAGES

# Quantities whose zero `locate` finds: penetration of the rear and of the front foot [m], angle between body
# and slope beyond the flip angle [rad], and speed or turn rate over its limit at rest, less 1 [1].
REAR_FOOT, FRONT_FOOT, TURN, MOTION = range(4)
# Entries in place of a job's number: the lane takes the next job, or no job is left for the lane.
FREE, IDLE = -1, -2


@intrinsic
def next_in_line(typing, counter):
    """The number that a counter (1,) shows before it is raised by one: no two threads get the same."""

    def generate(context, builder, signature, arguments):
        array = context.make_array(counter)(context, builder, arguments[0])
        return builder.atomic_rmw("add", array.data, context.get_constant(int64, 1), "monotonic")

    return int64(counter), generate


@fused
def _feet(coordinates, rates, work, lane, lanes):
    """Penetration, its rate and slip speed of the rear foot, then of the front foot, from a lane's state."""
    _, w, phi, h_c, theta_c, h_d, theta_d = coordinates
    coefficients = coefficients_at(work, at.COEFFICIENTS * lanes + lane, lanes)
    joints = pose(phi, theta_c, theta_d, coefficients.dx_j, coefficients.dz_j)
    return feet(joints, w, h_c, h_d, rates, coefficients.length)


@part
def _seven(work, row, lane, lanes):
    """Seven rows of a lane from `row` on: coordinates or their rates."""
    p = row * lanes + lane
    n = lanes
    return (
        work[p], work[p + n], work[p + 2 * n], work[p + 3 * n],
        work[p + 4 * n], work[p + 5 * n], work[p + 6 * n],
    )  # fmt: skip


@part
def feet_at_start(work, lane, lanes):
    """Penetration, its rate and slip speed of the rear foot, then of the front foot, at the step's start."""
    coordinates = _seven(work, at.START, lane, lanes)
    rates = _seven(work, at.START + at.COORDINATES, lane, lanes)
    return _feet(coordinates, rates, work, lane, lanes)


@part
def begin(parameters, slope, body, legs, work, lane, lanes):
    """Load a job into a lane: coefficients, state in the slope's frame, a first step of length 0."""
    for row in range(at.ROWS):
        work[row * lanes + lane] = 0.0
    coefficients = derived(parameters, slope)
    for i in range(len(coefficients)):
        work[(at.COEFFICIENTS + i) * lanes + lane] = coefficients[i]
    work[at.GROUND_SPRING * lanes + lane] = parameters[GROUND_STIFFNESS]
    work[at.GROUND_DAMPER * lanes + lane] = parameters[GROUND_DAMPING]
    for i in range(TERMS):
        work[(at.TERM_VALUES + i) * lanes + lane] = parameters[FIRST_TERM + i]
    for i in range(LAW_SLOTS):
        reads = LAW_READS + i
        work[(at.LAW + i) * lanes + lane] = parameters[reads] if reads < len(parameters) else 0.0
    c = np.cos(slope)
    s = np.sin(slope)
    work[at.SLOPE * lanes + lane] = slope
    work[at.COS_SLOPE * lanes + lane] = c
    work[at.SIN_SLOPE * lanes + lane] = s
    x, z, pitch, x_rate, z_rate, omega = body[0], body[1], body[2], body[3], body[4], body[5]
    phi = pitch - slope
    h_c, theta_c, h_d, theta_d = 0.0, phi + coefficients.q_n, 0.0, phi - coefficients.q_n
    h_c_rate, theta_c_rate, h_d_rate, theta_d_rate = 0.0, omega, 0.0, omega
    if len(legs) == 8:
        h_c, theta_c, h_d, theta_d = legs[0], phi + legs[1], legs[2], phi - legs[3]
        h_c_rate, theta_c_rate, h_d_rate, theta_d_rate = legs[4], omega + legs[5], legs[6], omega - legs[7]
    coordinates = (c * x - s * z, s * x + c * z, phi, h_c, theta_c, h_d, theta_d)
    along, normal = c * x_rate - s * z_rate, s * x_rate + c * z_rate
    rates = (along, normal, omega, h_c_rate, theta_c_rate, h_d_rate, theta_d_rate)
    for i in range(at.COORDINATES):
        work[(at.START + i) * lanes + lane] = coordinates[i]
        work[(at.START + at.COORDINATES + i) * lanes + lane] = rates[i]
    p_c, _, v_c, p_d, _, v_d = feet_at_start(work, lane, lanes)
    # Direction of slip: the direction of the motion of a foot that touches, +1 in the air.
    work[at.WAY * lanes + lane] = -1.0 if p_c > 0.0 and v_c < 0.0 else 1.0
    work[(at.WAY + 1) * lanes + lane] = -1.0 if p_d > 0.0 and v_d < 0.0 else 1.0
    # Margin of a foot that has just switched: see `_NEVER` in `sysid.gear.surfaces.high_friction`.
    for foot in range(2):
        work[(at.MARGIN + foot) * lanes + lane] = -1e30
    work[at.SEGMENT_END * lanes + lane] = np.inf
    work[at.FRESH * lanes + lane] = 1.0


@part
def load(number, parameters, slope, body, legs, segments, plans, segment, origin, work, lane, lanes):
    """Load the start of job number candidate * drops + drop, and the thrust of that drop, into a lane."""
    candidate = number // slope.shape[1]
    drop = number % slope.shape[1]
    start = body[candidate if len(body) > 1 else 0, drop]
    angle = slope[candidate if len(slope) > 1 else 0, drop]
    begin(parameters[candidate], angle, start, legs, work, lane, lanes)
    segment[lane] = np.int64(plans[drop, at.PLAN_FIRST])
    origin[lane] = plans[drop, at.PLAN_START]
    until = np.inf if plans[drop, at.PLAN_WAITS] > 0.0 else origin[lane]
    thrust_dx = parameters[candidate, THRUST_POINT_DX]
    thrust_segment(segments, segment[lane], 0.0, until, thrust_dx, work, lane, lanes)
    hold_rest(plans[drop, at.PLAN_SETTLED], until, work, lane, lanes)


@part
def assign(number, lane, job, cursor, clock, offset, cost, work):
    """Assign a job to the lane into which `load` has put the job's start."""
    lanes = len(job)
    drop = number % (len(offset) - 1)
    job[lane] = number
    cursor[lane] = offset[drop]
    work[at.NEXT * lanes + lane] = 0.0
    work[at.LIMIT * lanes + lane] = max(1000.0, cost * clock[offset[drop + 1] - 1])


@part
def idle(lane, job, work):
    """Let a lane without a job take tiny steps from its start: its numbers stay finite and are not used."""
    lanes = len(job)
    job[lane] = IDLE
    work[at.NEXT * lanes + lane] = np.inf
    work[at.LIMIT * lanes + lane] = np.inf
    work[at.FRESH * lanes + lane] = 2.0


@part
def thrust_segment(segments, number, origin, until, thrust_dx, work, lane, lanes):
    """Load a segment, which ends at lane time `until`, of a thrust history begun at lane time `origin`."""
    per_m, per_i = work[at.PER_M * lanes + lane], work[at.PER_I * lanes + lane]
    for i in range(4):
        rear = segments[number, at.SEGMENT_REAR + i]
        front = segments[number, at.SEGMENT_FRONT + i]
        work[(at.LIFT + i) * lanes + lane] = (rear + front) * per_m
        work[(at.TILT + i) * lanes + lane] = thrust_dx * (rear - front) * per_i
    work[at.ORIGIN * lanes + lane] = origin + segments[number, at.SEGMENT_FROM]
    work[at.SEGMENT_END * lanes + lane] = until


@part
def hold_rest(settled, origin, work, lane, lanes):
    """Count a drop as moving until `settled` [s] on the clock of a history begun at lane time `origin`.

    A negative `settled` lets the drop come to rest at any time.
    """
    work[at.HOLD * lanes + lane] = origin + settled if settled >= 0.0 else 0.0


@part
def interpolated(work, lane, lanes, share, i):
    """Coordinate `i` and its rate at `share` (0..1) of the lane's step, from cubic Hermite polynomials."""
    h = work[at.STEP * lanes + lane]
    rest = 1.0 - share
    b00 = (1.0 + 2.0 * share) * rest * rest
    b01 = share * share * (3.0 - 2.0 * share)
    b10 = h * share * rest * rest
    b11 = -h * share * share * rest
    x0 = work[(at.START + i) * lanes + lane]
    v0 = work[(at.START + at.COORDINATES + i) * lanes + lane]
    x1 = work[(at.END + i) * lanes + lane]
    v1 = work[(at.END + at.COORDINATES + i) * lanes + lane]
    a0 = work[(at.RATES + i) * lanes + lane]
    a1 = work[(at.RATES + at.COORDINATES * STAGES + i) * lanes + lane]
    return b00 * x0 + b01 * x1 + b10 * v0 + b11 * v1, b00 * v0 + b01 * v1 + b10 * a0 + b11 * a1


@part
def sample(work, lane, lanes, share, row):
    """Write the state at `share` (0..1) of a lane's step into `row`, in frame N of `sysid.gear.model` [SI].

    6 columns: x, z and pitch of the body and their rates. 16 columns: x, z, pitch, h_C, q_C, h_D, q_D, their
    rates, and the friction on the rear and front foot [N], which is interpolated linearly over the step.
    """
    columns = len(row)
    c = work[at.COS_SLOPE * lanes + lane]
    s = work[at.SIN_SLOPE * lanes + lane]
    half = 3 if columns == 6 else 7
    for i in range(half):
        row[i], row[half + i] = interpolated(work, lane, lanes, share, i)
    for i in range(2):
        along = row[half * i]
        normal = row[half * i + 1]
        row[half * i] = c * along + s * normal
        row[half * i + 1] = c * normal - s * along
    if half == 7:
        for i in range(2):
            turn = row[7 * i + 2]
            row[7 * i + 4] = row[7 * i + 4] - turn
            row[7 * i + 6] = turn - row[7 * i + 6]
    row[2] = row[2] + work[at.SLOPE * lanes + lane]
    if columns == 16:
        for foot in range(2):
            before = work[(at.FRICTION_0 + foot) * lanes + lane]
            row[14 + foot] = (1.0 - share) * before + share * work[(at.FRICTION + foot) * lanes + lane]


@part
def _gap(work, lane, lanes, share, kind, ending):
    """The number whose change of sign is the event: see `REAR_FOOT` ... `MOTION`."""
    _, rest_speed, rest_turn, _, flip_angle = ending
    if kind == TURN:
        phi, _ = interpolated(work, lane, lanes, share, at.PHI)
        return abs(phi) - flip_angle
    if kind == MOTION:
        _, s_rate = interpolated(work, lane, lanes, share, at.S)
        _, w_rate = interpolated(work, lane, lanes, share, at.W)
        _, omega = interpolated(work, lane, lanes, share, at.PHI)
        speed = np.sqrt(s_rate * s_rate + w_rate * w_rate)
        return max(speed / rest_speed, abs(omega) / rest_turn) - 1.0
    w, _ = interpolated(work, lane, lanes, share, at.W)
    phi, _ = interpolated(work, lane, lanes, share, at.PHI)
    h_c, _ = interpolated(work, lane, lanes, share, at.H_C)
    theta_c, _ = interpolated(work, lane, lanes, share, at.THETA_C)
    h_d, _ = interpolated(work, lane, lanes, share, at.H_D)
    theta_d, _ = interpolated(work, lane, lanes, share, at.THETA_D)
    still = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    p_c, _, _, p_d, _, _ = _feet((0.0, w, phi, h_c, theta_c, h_d, theta_d), still, work, lane, lanes)
    return p_c if kind == REAR_FOOT else p_d


@part
def locate(work, lane, lanes, kind, ending):
    """Share of the lane's step at which the quantity `kind` changes its sign (regula falsi, Illinois).

    Without a change of sign: the end of the step (0 or 1) at which the quantity is nearer to zero.
    """
    low, high = 0.0, 1.0
    at_low = _gap(work, lane, lanes, low, kind, ending)
    at_high = _gap(work, lane, lanes, high, kind, ending)
    if at_low * at_high >= 0.0:
        return 0.0 if abs(at_low) < abs(at_high) else 1.0
    side = 0
    for _ in range(40):
        share = (low * at_high - high * at_low) / (at_high - at_low)
        gap = _gap(work, lane, lanes, share, kind, ending)
        if (high - low) * work[at.STEP * lanes + lane] < 1e-9 or abs(gap) < 1e-12:
            return share
        if gap * at_high > 0.0:
            high, at_high = share, gap
            at_low = 0.5 * at_low if side == 1 else at_low
            side = 1
        else:
            low, at_low = share, gap
            at_high = 0.5 * at_high if side == -1 else at_high
            side = -1
    return 0.5 * (low + high)


@part
def available(work, lane, lanes, foot):
    """Largest friction of a foot in its mode at the step's end, equation (9) of the paper [N].

    The mode is the one that the foot has or has just lost: a foot whose slip has come to zero is judged by
    mu_k, whether it sticks then or slips back; a foot that is released is judged by mu_s.
    """
    lost = work[(at.SWITCH + foot) * lanes + lane]
    sticks = work[(at.STUCK + foot) * lanes + lane]
    sticks = lost - 1.0 if lost > 0.0 else sticks
    mu = work[at.LAW * lanes + lane]
    mu = mu + work[(at.LAW + 1) * lanes + lane] if sticks > 0.0 else mu
    mu = mu * (1.0 + work[(at.LAW + 2) * lanes + lane]) if foot == 1 else mu
    return mu * work[(at.NORMAL + foot) * lanes + lane]
