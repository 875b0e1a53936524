"""One lane's job: loading its start, its thrust, and what is read from a step that it has taken."""

import numpy as np
from numba import njit

from sysid.gear.kernel.dynamics import feet, pose
from sysid.gear.kernel.work_buffer import (
    COEFFICIENTS,
    COUNT,
    END,
    FLIPPED,
    FRESH,
    FRICTION,
    FRICTION_0,
    GROUND,
    HOLD,
    LAW,
    LENGTH,
    LIFT,
    LIMIT,
    MARGIN,
    MOVED,
    NEXT,
    NORMAL,
    ORIGIN,
    RATES,
    REST,
    RESTED,
    SEGMENT_END,
    START,
    STEP,
    STUCK,
    SWITCH,
    TILT,
    TIME,
    TOUCHED,
    WAY,
)
from sysid.integrate.tableau import STAGES


@njit(error_model="numpy")
def _derive(parameters, reads, slope, work, lane, lanes):
    """Coefficients of one lane from a parameter row (order of `sysid.gear.parameters`) and a slope."""
    span = parameters[3] - parameters[6]
    drop = parameters[4] - parameters[7]
    length = np.sqrt(span * span + drop * drop)
    base = COEFFICIENTS * lanes + lane
    for i in range(4):
        work[base + i * lanes] = parameters[8 + i]
        work[base + (4 + i) * lanes] = parameters[8 + i] * parameters[20 + i]
    work[base + 8 * lanes] = parameters[6]
    work[base + 9 * lanes] = parameters[7]
    work[LENGTH * lanes + lane] = length
    work[REST * lanes + lane] = np.arctan2(span, drop)
    work[base + 12 * lanes] = parameters[16] * length
    work[base + 13 * lanes] = (1.0 - parameters[16]) * length
    work[base + 14 * lanes] = 1.0 / parameters[0]
    work[base + 15 * lanes] = 1.0 / parameters[1]
    for i in range(2):
        work[base + (16 + i) * lanes] = 1.0 / parameters[14 + i]
        work[base + (18 + i) * lanes] = 1.0 / (parameters[14 + i] * parameters[24 + i])
    work[base + 20 * lanes] = parameters[2] * np.sin(slope)
    work[base + 21 * lanes] = -parameters[2] * np.cos(slope)
    work[GROUND * lanes + lane] = parameters[12]
    work[(GROUND + 1) * lanes + lane] = parameters[13]
    for i in range(6):
        work[(LAW + i) * lanes + lane] = parameters[reads[i]] if i < len(reads) else 0.0


@njit(error_model="numpy")
def _first_way(work, lane, lanes, foot):
    """Direction of slip of a foot at its start: that of its motion where it touches, +1 in the air."""
    y = START * lanes + lane
    base = COEFFICIENTS * lanes + lane
    joints = pose(
        work[y + 2 * lanes],
        work[y + 4 * lanes],
        work[y + 6 * lanes],
        work[base + 8 * lanes],
        work[base + 9 * lanes],
    )
    rates = (
        work[y + 7 * lanes],
        work[y + 8 * lanes],
        work[y + 9 * lanes],
        work[y + 10 * lanes],
        work[y + 11 * lanes],
        work[y + 12 * lanes],
        work[y + 13 * lanes],
    )
    length = work[LENGTH * lanes + lane]
    found = feet(joints, work[y + lanes], work[y + 3 * lanes], work[y + 5 * lanes], rates, length)
    return -1.0 if found[3 * foot] > 0.0 and found[3 * foot + 2] < 0.0 else 1.0


@njit(error_model="numpy")
def begin(parameters, reads, slope, body, legs, work, lane, lanes):
    """Load a job into a lane: coefficients, state in the slope's frame, a first step of length 0."""
    _derive(parameters, reads, slope, work, lane, lanes)
    c = np.cos(slope)
    s = np.sin(slope)
    y = START * lanes + lane
    for i in range(2):
        x = body[3 * i]
        z = body[3 * i + 1]
        work[y + (7 * i) * lanes] = c * x - s * z
        work[y + (7 * i + 1) * lanes] = s * x + c * z
    phi = body[2] - slope
    rest = work[REST * lanes + lane]
    work[y + 2 * lanes] = phi
    work[y + 9 * lanes] = body[5]
    if len(legs) == 8:
        work[y + 3 * lanes] = legs[0]
        work[y + 4 * lanes] = phi + legs[1]
        work[y + 5 * lanes] = legs[2]
        work[y + 6 * lanes] = phi - legs[3]
        work[y + 10 * lanes] = legs[4]
        work[y + 11 * lanes] = body[5] + legs[5]
        work[y + 12 * lanes] = legs[6]
        work[y + 13 * lanes] = body[5] - legs[7]
    else:
        work[y + 3 * lanes] = 0.0
        work[y + 4 * lanes] = phi + rest
        work[y + 5 * lanes] = 0.0
        work[y + 6 * lanes] = phi - rest
        work[y + 10 * lanes] = 0.0
        work[y + 11 * lanes] = body[5]
        work[y + 12 * lanes] = 0.0
        work[y + 13 * lanes] = body[5]
    for i in range(7):
        work[(RATES + i) * lanes + lane] = 0.0
    for foot in range(2):
        work[(STUCK + foot) * lanes + lane] = 0.0
        work[(WAY + foot) * lanes + lane] = _first_way(work, lane, lanes, foot)
        work[(MARGIN + foot) * lanes + lane] = -1e30
        work[(SWITCH + foot) * lanes + lane] = 0.0
        work[(FRICTION_0 + foot) * lanes + lane] = 0.0
        work[(TOUCHED + foot) * lanes + lane] = 0.0
    for i in range(4):
        work[(LIFT + i) * lanes + lane] = 0.0
        work[(TILT + i) * lanes + lane] = 0.0
    work[ORIGIN * lanes + lane] = 0.0
    work[SEGMENT_END * lanes + lane] = np.inf
    work[FLIPPED * lanes + lane] = 0.0
    work[RESTED * lanes + lane] = 0.0
    work[MOVED * lanes + lane] = 0.0
    work[TIME * lanes + lane] = 0.0
    work[STEP * lanes + lane] = 0.0
    work[FRESH * lanes + lane] = 1.0
    work[COUNT * lanes + lane] = 0.0


@njit(error_model="numpy")
def assign(here, lane, job, cursor, clock, offset, cost, work):
    """Let a lane own a job whose start it holds."""
    lanes = len(job)
    drop = here % (len(offset) - 1)
    job[lane] = here
    cursor[lane] = offset[drop]
    work[NEXT * lanes + lane] = 0.0
    work[LIMIT * lanes + lane] = max(1000.0, cost * clock[offset[drop + 1] - 1])


@njit(error_model="numpy")
def idle(lane, job, work):
    """Let a lane crawl from the start it holds: its numbers stay ordinary and nobody reads them."""
    lanes = len(job)
    job[lane] = -1
    work[NEXT * lanes + lane] = np.inf
    work[LIMIT * lanes + lane] = np.inf
    work[FRESH * lanes + lane] = 2.0


@njit(error_model="numpy")
def thrust_segment(segments, at, origin, until, thrust_dx, work, lane, lanes):
    """Load segment `at` of a thrust history whose clock started at lane time `origin`; it ends at `until`."""
    per_m = work[(COEFFICIENTS + 14) * lanes + lane]
    per_i = work[(COEFFICIENTS + 15) * lanes + lane]
    for i in range(4):
        rear = segments[at, 2 + i]
        front = segments[at, 6 + i]
        work[(LIFT + i) * lanes + lane] = (rear + front) * per_m
        work[(TILT + i) * lanes + lane] = thrust_dx * (rear - front) * per_i
    work[ORIGIN * lanes + lane] = origin + segments[at, 0]
    work[SEGMENT_END * lanes + lane] = until


@njit(error_model="numpy")
def hold_rest(settled, origin, work, lane, lanes):
    """Count no rest until a history whose clock starts at `origin` shows `settled`, if not negative."""
    work[HOLD * lanes + lane] = origin + settled if settled >= 0.0 else 0.0


@njit(error_model="numpy")
def interpolated(work, lane, lanes, share, i):
    """Coordinate `i` and its rate at `share` (0..1) of the lane's step, from cubic Hermite polynomials."""
    h = work[STEP * lanes + lane]
    one = 1.0 - share
    b00 = (1.0 + 2.0 * share) * one * one
    b01 = share * share * (3.0 - 2.0 * share)
    b10 = h * share * one * one
    b11 = -h * share * share * one
    x0 = work[(START + i) * lanes + lane]
    v0 = work[(START + 7 + i) * lanes + lane]
    x1 = work[(END + i) * lanes + lane]
    v1 = work[(END + 7 + i) * lanes + lane]
    a0 = work[(RATES + i) * lanes + lane]
    a1 = work[(RATES + 7 * STAGES + i) * lanes + lane]
    return b00 * x0 + b01 * x1 + b10 * v0 + b11 * v1, b00 * v0 + b01 * v1 + b10 * a0 + b11 * a1


@njit(error_model="numpy")
def sample(work, lane, lanes, share, slope, row):
    """Write the state at `share` (0..1) of the step of one lane into `row`, in frame N.

    6 columns: the body; 16: all coordinates, their rates, and friction on the feet, linear over the step.
    """
    columns = len(row)
    c = np.cos(slope)
    s = np.sin(slope)
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
    row[2] = row[2] + slope
    if columns == 16:
        for foot in range(2):
            before = work[(FRICTION_0 + foot) * lanes + lane]
            row[14 + foot] = (1.0 - share) * before + share * work[(FRICTION + foot) * lanes + lane]


@njit(error_model="numpy")
def _gap(work, lane, lanes, share, kind, ending):
    """What an event looks for: 0, 1 penetration of a foot; 2 turn beyond the flip; 3 excess of motion."""
    if kind == 2:
        phi, _ = interpolated(work, lane, lanes, share, 2)
        return abs(phi) - ending[4]
    if kind == 3:
        _, s_rate = interpolated(work, lane, lanes, share, 0)
        _, w_rate = interpolated(work, lane, lanes, share, 1)
        _, omega = interpolated(work, lane, lanes, share, 2)
        speed = np.sqrt(s_rate * s_rate + w_rate * w_rate)
        return max(speed / ending[1], abs(omega) / ending[2]) - 1.0
    w, _ = interpolated(work, lane, lanes, share, 1)
    phi, _ = interpolated(work, lane, lanes, share, 2)
    h_c, _ = interpolated(work, lane, lanes, share, 3)
    theta_c, _ = interpolated(work, lane, lanes, share, 4)
    h_d, _ = interpolated(work, lane, lanes, share, 5)
    theta_d, _ = interpolated(work, lane, lanes, share, 6)
    base = COEFFICIENTS * lanes + lane
    joints = pose(phi, theta_c, theta_d, work[base + 8 * lanes], work[base + 9 * lanes])
    still = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    found = feet(joints, w, h_c, h_d, still, work[LENGTH * lanes + lane])
    return found[0] if kind == 0 else found[3]


@njit(error_model="numpy")
def locate(work, lane, lanes, kind, ending):
    """Share of the lane's step at which the gap of a kind changes its sign (regula falsi, Illinois)."""
    low, high = 0.0, 1.0
    at_low = _gap(work, lane, lanes, 0.0, kind, ending)
    at_high = _gap(work, lane, lanes, 1.0, kind, ending)
    if at_low * at_high >= 0.0:
        return 0.0 if abs(at_low) < abs(at_high) else 1.0
    side = 0
    for _ in range(40):
        share = (low * at_high - high * at_low) / (at_high - at_low)
        here = _gap(work, lane, lanes, share, kind, ending)
        if (high - low) * work[STEP * lanes + lane] < 1e-9 or abs(here) < 1e-12:
            return share
        if here * at_high > 0.0:
            high, at_high = share, here
            at_low = 0.5 * at_low if side == 1 else at_low
            side = 1
        else:
            low, at_low = share, here
            at_high = 0.5 * at_high if side == -1 else at_high
            side = -1
    return 0.5 * (low + high)


@njit(error_model="numpy")
def available(work, lane, lanes, foot):
    """Friction that a foot's own mode is judged by at the step's end (9) [N].

    That of the mode which it has, or which it has just lost: a foot whose slip has come to zero is judged by
    mu_k, whether it sticks then or slips back, a foot that is released by mu_s.
    """
    lost = work[(SWITCH + foot) * lanes + lane]
    sticks = work[(STUCK + foot) * lanes + lane]
    sticks = lost - 1.0 if lost > 0.0 else sticks
    mu = work[LAW * lanes + lane]
    mu = mu + work[(LAW + 1) * lanes + lane] if sticks > 0.0 else mu
    return mu * work[(NORMAL + foot) * lanes + lane]
