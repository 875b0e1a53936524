"""The landing gear in time: many drops side by side in lanes, one drop alone with a single lane.

`drop_driver(lanes)` makes the compiled driver; the scalar form is the same code with one lane. Each lane
integrates its own job (a parameter row on a drop) with its own adaptive step and takes the next job when its
drop ends; loops over lanes become packed instructions. Lanes never exchange numbers, so a result depends
neither on the number of lanes and threads nor on the order of jobs, and a lane that is lost leaves the others
alone.

The method is the explicit pair of `sysid.integrate.tableau`; samples between steps come from the cubic
Hermite polynomial of the step (order 3). On low friction a step never exceeds what the method's real
stability allows for the slip of a creeping foot; on high friction a step ends where a foot loses its mode
(`sysid.gear.hybrid`).

Status codes of a job: see `OK`, `STEP_COLLAPSED`, `TOO_EXPENSIVE`, `BLEW_UP`.
"""

import hashlib
from pathlib import Path

import numpy as np
from numba import njit

from sysid.gear.contact import low_friction, normal_force
from sysid.gear.dynamics import feet, pose
from sysid.gear.stages import (
    COEFFICIENTS,
    COUNT,
    END,
    FRESH,
    FRICTION,
    FRICTION_0,
    LIMIT,
    MARGIN,
    MU_S,
    NEW_STEP,
    NEXT,
    NORMAL,
    RATES,
    REQUIRED,
    ROWS,
    START,
    STEP,
    STIFF,
    STUCK,
    SWITCH,
    TAKEN,
    TIME,
    WAY,
    evaluate,
    switch,
)
from sysid.integrate.tableau import REAL_LIMIT, STAGES, E

OK = 0
STEP_COLLAPSED = 1
TOO_EXPENSIVE = 2
BLEW_UP = 3

# Error weights of the rates (s, w, phi, h_C, theta_C, h_D, theta_D): 1 / scale, scales 1 m/s and 10 rad/s for
# the legs; a light leg may err 30 times more than the body, whose motion is what is measured.
WEIGHTS = np.array([30.0, 30.0, 6.0, 1.0, 0.1, 1.0, 0.1])

# First step of a drop, and after a foot has switched its mode [s].
FIRST_STEP = 6e-5

# Part of the method's real stability limit that a step may use: the slip's decay rate can grow within the
# step.
STABLE = 0.9 * REAL_LIMIT


def _fingerprint() -> int:
    """Hash of the sources that are inlined here, so that a cached driver never outlives them."""
    here = Path(__file__).parent
    sources = [
        here / f"{name}.py" for name in ("geometry", "contact", "dynamics", "hybrid", "stages", "kernel")
    ]
    sources.append(here.parent / "integrate" / "tableau.py")
    text = b"".join(source.read_bytes() for source in sources)
    return int.from_bytes(hashlib.sha256(text).digest()[:6], "big")


@njit(error_model="numpy")
def _derive(parameters, slope, work, lane, lanes):
    """Coefficients of one lane from a parameter row (order of `sysid.gear.model.PARAMETERS`) and a slope."""
    span = parameters[3] - parameters[6]
    drop = parameters[4] - parameters[7]
    length = np.sqrt(span * span + drop * drop)
    base = COEFFICIENTS * lanes + lane
    work[base + 0 * lanes] = parameters[8]
    work[base + 1 * lanes] = parameters[9]
    work[base + 2 * lanes] = parameters[10]
    work[base + 3 * lanes] = parameters[11]
    work[base + 4 * lanes] = parameters[6]
    work[base + 5 * lanes] = parameters[7]
    work[base + 6 * lanes] = length
    work[base + 7 * lanes] = np.arctan2(span, drop)
    work[base + 8 * lanes] = parameters[16] * length
    work[base + 9 * lanes] = (1.0 - parameters[16]) * length
    work[base + 10 * lanes] = 1.0 / parameters[0]
    work[base + 11 * lanes] = 1.0 / parameters[1]
    work[base + 12 * lanes] = 1.0 / parameters[14]
    work[base + 13 * lanes] = 1.0 / parameters[15]
    work[base + 14 * lanes] = parameters[2] * np.sin(slope)
    work[base + 15 * lanes] = -parameters[2] * np.cos(slope)
    work[base + 16 * lanes] = parameters[12]
    work[base + 17 * lanes] = parameters[13]
    work[base + 18 * lanes] = parameters[17]
    work[base + 19 * lanes] = parameters[18]
    work[MU_S * lanes + lane] = parameters[17] + parameters[19]


@njit(error_model="numpy")
def _begin(parameters, slope, body, legs, work, lane, lanes):
    """Load a job into a lane: coefficients, state in the slope's frame, a first step of length 0."""
    _derive(parameters, slope, work, lane, lanes)
    c = np.cos(slope)
    s = np.sin(slope)
    y = START * lanes + lane
    for i in range(2):
        x = body[3 * i]
        z = body[3 * i + 1]
        work[y + (7 * i) * lanes] = c * x - s * z
        work[y + (7 * i + 1) * lanes] = s * x + c * z
    phi = body[2] - slope
    rest = work[(COEFFICIENTS + 7) * lanes + lane]
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
        work[(WAY + foot) * lanes + lane] = 1.0
        work[(MARGIN + foot) * lanes + lane] = -1e30
        work[(SWITCH + foot) * lanes + lane] = 0.0
        work[(FRICTION_0 + foot) * lanes + lane] = 0.0
    work[TIME * lanes + lane] = 0.0
    work[STEP * lanes + lane] = 0.0
    work[FRESH * lanes + lane] = 1.0
    work[COUNT * lanes + lane] = 0.0


@njit(error_model="numpy")
def _sample(work, lane, lanes, share, slope, columns, row):
    """Write the state at `share` (0..1) of the step of one lane into `row`, in frame N."""
    h = work[STEP * lanes + lane]
    one = 1.0 - share
    b00 = (1.0 + 2.0 * share) * one * one
    b01 = share * share * (3.0 - 2.0 * share)
    b10 = h * share * one * one
    b11 = -h * share * share * one
    c = np.cos(slope)
    s = np.sin(slope)
    half = 3 if columns == 6 else 7
    for i in range(half):
        x0 = work[(START + i) * lanes + lane]
        v0 = work[(START + 7 + i) * lanes + lane]
        x1 = work[(END + i) * lanes + lane]
        v1 = work[(END + 7 + i) * lanes + lane]
        a0 = work[(RATES + i) * lanes + lane]
        a1 = work[(RATES + 7 * STAGES + i) * lanes + lane]
        row[i] = b00 * x0 + b01 * x1 + b10 * v0 + b11 * v1
        row[half + i] = b00 * v0 + b01 * v1 + b10 * a0 + b11 * a1
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
            row[14 + foot] = one * before + share * work[(FRICTION + foot) * lanes + lane]


@njit(error_model="numpy")
def _assign(here, lane, job, cursor, clock, offset, cost, work):
    """Let a lane own a job whose start it holds."""
    lanes = len(job)
    drop = here % (len(offset) - 1)
    job[lane] = here
    cursor[lane] = offset[drop]
    work[NEXT * lanes + lane] = 0.0
    work[LIMIT * lanes + lane] = max(1000.0, cost * clock[offset[drop + 1] - 1])


@njit(error_model="numpy")
def _idle(lane, job, work):
    """Let a lane crawl from the start it holds: its numbers stay ordinary and nobody reads them."""
    lanes = len(job)
    job[lane] = -1
    work[NEXT * lanes + lane] = np.inf
    work[LIMIT * lanes + lane] = np.inf
    work[FRESH * lanes + lane] = 2.0


def drop_driver(lanes: int, high: bool):
    """Make the driver for a number of lanes (1: the scalar form) and a surface of high or low friction."""
    fingerprint = _fingerprint()

    @njit(cache=True, nogil=True, error_model="numpy")
    def drive(
        parameters,
        slope,
        body,
        legs,
        clock,
        offset,
        jobs,
        tolerance,
        h_max,
        cost,
        samples,
        reached,
        status,
        spent,
        switches,
        marks,
    ):
        """Integrate jobs (candidate * drops + drop) and sample them on their drop's clock.

        Parameters
        ----------
        parameters : (P, n_par)
        slope : (D,) [rad]
        body : (D, 6)
            x, z, q and rates at each drop's first sample, frame N [m, rad, s].
        legs : (8,) or (0,)
            h_C q_C h_D q_D and rates at the start, empty for legs at rest.
        clock : (n_total,)
            Sample times since each drop's start [s]; drop d owns offset[d]:offset[d + 1].
        jobs : (n,) int64
        tolerance : float
            Bound of the weighted rms error of the rates per step.
        h_max : float
            Longest step [s].
        cost : float
            Right-hand sides that a drop may spend per second of its length, at least 1000 in all.
        samples : (P, n_total, 6, 14 or 16)
            Written: state at each sample, frame N (16: friction on the feet too); NaN from the failure on.
        reached, status, spent, switches : (P, D)
            Written: share of the drop's time integrated, status code, right-hand sides, mode switches.
        marks : (n, 7)
            Written: time, foot, 1 if it sticks from then on, available and required friction of both feet,
            for the first n switches.
        """
        if fingerprint < 0:  # keeps the sources' hash in the key of the cached code
            return
        drops = len(slope)
        columns = samples.shape[2]
        work = np.ones(ROWS * lanes)
        job = np.full(lanes, -1, np.int64)
        cursor = np.zeros(lanes, np.int64)
        per_tolerance = 1.0 / (7.0 * tolerance * tolerance)
        waiting = 0
        active = 0
        marked = 0
        for lane in range(lanes):
            here = jobs[min(waiting, len(jobs) - 1)]
            drop = here % drops
            _begin(parameters[here // drops], slope[drop], body[drop], legs, work, lane, lanes)
            if waiting < len(jobs):
                _assign(here, lane, job, cursor, clock, offset, cost, work)
                waiting += 1
                active += 1
            else:
                _idle(lane, job, work)
        while active > 0:
            for lane in range(lanes):
                evaluate(work, 1, lane, lanes, high)
            for lane in range(lanes):
                evaluate(work, 2, lane, lanes, high)
            for lane in range(lanes):
                evaluate(work, 3, lane, lanes, high)
            for lane in range(lanes):
                evaluate(work, 4, lane, lanes, high)
            for lane in range(lanes):
                evaluate(work, 5, lane, lanes, high)
            attention = 0
            for lane in range(lanes):
                total = 0.0
                for i in range(7):
                    gap = 0.0
                    for j in range(STAGES + 1):
                        gap += E[j] * work[(RATES + 7 * j + i) * lanes + lane]
                    gap = gap * WEIGHTS[i]
                    total = total + gap * gap
                h = work[STEP * lanes + lane]
                total = total * h * h * per_tolerance
                # Fourth root of the error (of its square, the eighth): close to the cube root, and packed.
                root = np.sqrt(np.sqrt(np.sqrt(total + 1e-9)))
                factor = 0.85 / root
                factor = factor if factor < 4.0 else 4.0
                # A comparison with NaN is false: a lost step counts as rejected and shrinks fast.
                factor = factor if factor > 0.2 else 0.2
                taken = 1.0 if total <= 1.0 else 0.0
                new_h = h * factor
                new_h = new_h if new_h < h_max else h_max
                stable_h = STABLE / (work[STIFF * lanes + lane] + 1e-3)
                stable_h = stable_h if taken > 0.0 else new_h
                new_h = new_h if new_h < stable_h else stable_h
                fresh = work[FRESH * lanes + lane]
                new_h = FIRST_STEP * taken if fresh > 0.0 else new_h
                new_h = 1e-8 if fresh > 1.0 else new_h
                if high:
                    taken, new_h = switch(work, lane, lanes, h, taken, new_h)
                work[NEW_STEP * lanes + lane] = new_h
                work[TAKEN * lanes + lane] = taken
                count = work[COUNT * lanes + lane] + STAGES
                work[COUNT * lanes + lane] = count
                left = work[TIME * lanes + lane] + h - work[NEXT * lanes + lane]
                stretch_c = work[(END + 3) * lanes + lane] + work[(COEFFICIENTS + 6) * lanes + lane]
                stretch_d = work[(END + 5) * lanes + lane] + work[(COEFFICIENTS + 6) * lanes + lane]
                sound = stretch_c if stretch_c < stretch_d else stretch_d
                sound = sound if new_h > 1e-9 else -1.0
                sound = sound if count < work[LIMIT * lanes + lane] else -1.0
                due = left if taken > 0.0 else -1.0
                due = due if sound > 0.0 else 1.0
                attention += 1 if due >= 0.0 else 0
            if attention > 0:
                for lane in range(lanes):
                    if job[lane] < 0:
                        continue
                    here = job[lane]
                    candidate = here // drops
                    drop = here % drops
                    end = offset[drop + 1]
                    h = work[STEP * lanes + lane]
                    t = work[TIME * lanes + lane]
                    length = clock[end - 1]
                    code = OK
                    taken = work[TAKEN * lanes + lane] > 0.0
                    if taken:
                        for foot in range(2):
                            if high and work[(SWITCH + foot) * lanes + lane] > 0.0:
                                switches[candidate, drop] += 1
                                if marked < len(marks):
                                    stuck = work[(STUCK + foot) * lanes + lane]
                                    mu = work[(COEFFICIENTS + 18 if stuck > 0.0 else MU_S) * lanes + lane]
                                    marks[marked, 0] = t + h
                                    marks[marked, 1] = foot
                                    marks[marked, 2] = stuck
                                    for other in range(2):
                                        normal = work[(NORMAL + other) * lanes + lane]
                                        marks[marked, 3 + other] = mu * normal
                                        marks[marked, 5 + other] = work[(REQUIRED + other) * lanes + lane]
                                    marked += 1
                        while cursor[lane] < end and clock[cursor[lane]] <= t + h:
                            share = (clock[cursor[lane]] - t) / h if h > 0.0 else 0.0
                            row = samples[candidate, cursor[lane]]
                            _sample(work, lane, lanes, share, slope[drop], columns, row)
                            cursor[lane] += 1
                        stretch = min(work[(END + 3) * lanes + lane], work[(END + 5) * lanes + lane])
                        if not stretch + work[(COEFFICIENTS + 6) * lanes + lane] > 0.0:
                            code = BLEW_UP
                    elif not work[NEW_STEP * lanes + lane] > 1e-9:
                        code = STEP_COLLAPSED
                    if work[COUNT * lanes + lane] >= work[LIMIT * lanes + lane]:
                        code = TOO_EXPENSIVE
                    if cursor[lane] < end:
                        work[NEXT * lanes + lane] = clock[cursor[lane]]
                        if code == OK:
                            continue
                        reached[candidate, drop] = min(t / length, 1.0) if length > 0.0 else 0.0
                        samples[candidate, cursor[lane] : end] = np.nan
                    else:
                        code = OK
                        reached[candidate, drop] = 1.0
                    status[candidate, drop] = code
                    spent[candidate, drop] = np.int64(work[COUNT * lanes + lane])
                    if waiting < len(jobs):
                        here = jobs[waiting]
                    drop = here % drops
                    _begin(parameters[here // drops], slope[drop], body[drop], legs, work, lane, lanes)
                    work[TAKEN * lanes + lane] = -1.0
                    if waiting < len(jobs):
                        _assign(here, lane, job, cursor, clock, offset, cost, work)
                        waiting += 1
                    else:
                        _idle(lane, job, work)
                        active -= 1
            for lane in range(lanes):
                taken = work[TAKEN * lanes + lane]
                h = work[STEP * lanes + lane]
                work[TIME * lanes + lane] = work[TIME * lanes + lane] + (h if taken > 0.0 else 0.0)
                work[STEP * lanes + lane] = work[NEW_STEP * lanes + lane] if taken >= 0.0 else 0.0
                fresh = work[FRESH * lanes + lane]
                fresh = 0.0 if taken >= 0.0 and fresh == 1.0 else fresh
                if high:
                    switched = work[SWITCH * lanes + lane] + work[(SWITCH + 1) * lanes + lane]
                    fresh = 1.0 if switched > 0.0 and fresh == 0.0 else fresh
                    for foot in range(2):
                        before = work[(FRICTION_0 + foot) * lanes + lane]
                        now = work[(FRICTION + foot) * lanes + lane]
                        work[(FRICTION_0 + foot) * lanes + lane] = now if taken > 0.0 else before
                work[FRESH * lanes + lane] = fresh
            for i in range(14):
                for lane in range(lanes):
                    old = work[(START + i) * lanes + lane]
                    new = work[(END + i) * lanes + lane]
                    work[(START + i) * lanes + lane] = new if work[TAKEN * lanes + lane] > 0.0 else old
            for i in range(7):
                for lane in range(lanes):
                    old = work[(RATES + i) * lanes + lane]
                    new = work[(RATES + 7 * STAGES + i) * lanes + lane]
                    work[(RATES + i) * lanes + lane] = new if work[TAKEN * lanes + lane] > 0.0 else old

    return drive


@njit(cache=True, nogil=True, error_model="numpy")
def foot_forces(parameters, slope, states, forces):
    """Fill `forces` (n, 4) of states (n, 14), frame N: normal force rear, front, friction rear, front [N]."""
    work = np.ones(ROWS)
    for n in range(len(states)):
        state = states[n]
        legs = np.array([state[3], state[4], state[5], state[6], state[10], state[11], state[12], state[13]])
        body = np.array([state[0], state[1], state[2], state[7], state[8], state[9]])
        _begin(parameters, slope, body, legs, work, 0, 1)
        y = work[:14]
        p = work[COEFFICIENTS:]
        joints = pose(y[2], y[4], y[6], p[4], p[5])
        rates = (y[7], y[8], y[9], y[10], y[11], y[12], y[13])
        p_c, dp_c, v_c, p_d, dp_d, v_d = feet(joints, y[1], y[3], y[5], rates, p[6])
        n_c = normal_force(p_c, dp_c, p[16], p[17])
        n_d = normal_force(p_d, dp_d, p[16], p[17])
        f_c, f_d = low_friction(n_c, n_d, v_c, v_d, p[18], p[19])
        forces[n, 0] = n_c
        forces[n, 1] = n_d
        forces[n, 2] = f_c
        forces[n, 3] = f_d
