"""The landing gear in time: many drops side by side in lanes, one drop alone with a single lane.

`drop_driver(lanes)` makes the compiled driver; the scalar form is the same code with one lane. Each lane integrates
its own job (a parameter row on a drop) with its own adaptive step and takes the next job when its drop ends; loops
over lanes become packed instructions. Lanes never exchange numbers, so a result depends neither on the number of
lanes and threads nor on the order of jobs, and a lane that is lost leaves the others alone.

The method is the explicit pair of Bogacki and Shampine, order 3(2), with local extrapolation and the last stage
reused; samples between steps come from the cubic Hermite polynomial of the step (order 3).

Status codes of a job: see `OK`, `STEP_COLLAPSED`, `TOO_EXPENSIVE`, `BLEW_UP`.
"""

import hashlib
from pathlib import Path

import numpy as np
from numba import njit

from sysid.gear.contact import low_friction, normal_force
from sysid.gear.dynamics import accelerations, feet, pose

OK = 0
STEP_COLLAPSED = 1
TOO_EXPENSIVE = 2
BLEW_UP = 3

# Rows of the work buffer; element `row * lanes + lane`.
_Y = 0  # coordinates 7, rates 7
_K1 = 14  # accelerations at the step's start
_K2 = 21
_K3 = 28
_K4 = 35  # accelerations at the step's end
_S = 42  # stage state 14, at last the step's end
_P = 56  # derived coefficients
_T = 76  # time since the drop's start
_H = 77  # step
_NEW_H = 78
_TAKEN = 79  # 1 if the step is accepted
_NEXT = 80  # time of the lane's next sample
_FRESH = 81  # 1 while a new job waits for its first accelerations (a step of length 0)
_COUNT = 82  # right-hand sides spent
_ROWS = 83

N_COEFFICIENTS = 20
_N_DYNAMIC = 16

# Error weights of the rates (s, w, phi, h_C, theta_C, h_D, theta_D): 1 / scale, scales 1 m/s, 5 rad/s, 1 m/s, 10 rad/s.
_WEIGHTS = (1.0, 1.0, 0.2, 1.0, 0.1, 1.0, 0.1)


def _fingerprint() -> int:
    """Hash of the sources that are inlined here, so that a cached driver never outlives them."""
    here = Path(__file__).parent
    text = b"".join((here / name).read_bytes() for name in ("geometry.py", "contact.py", "dynamics.py", "kernel.py"))
    return int.from_bytes(hashlib.sha256(text).digest()[:6], "big")


@njit(error_model="numpy", forceinline=True)
def _evaluate(work, state, out, lane, lanes):
    """Accelerations of one lane's state at row `state` into the rows from `out`."""
    w = work[(state + 1) * lanes + lane]
    phi = work[(state + 2) * lanes + lane]
    h_c = work[(state + 3) * lanes + lane]
    theta_c = work[(state + 4) * lanes + lane]
    h_d = work[(state + 5) * lanes + lane]
    theta_d = work[(state + 6) * lanes + lane]
    rates = (
        work[(state + 7) * lanes + lane],
        work[(state + 8) * lanes + lane],
        work[(state + 9) * lanes + lane],
        work[(state + 10) * lanes + lane],
        work[(state + 11) * lanes + lane],
        work[(state + 12) * lanes + lane],
        work[(state + 13) * lanes + lane],
    )
    coefficients = (
        work[(_P + 0) * lanes + lane],
        work[(_P + 1) * lanes + lane],
        work[(_P + 2) * lanes + lane],
        work[(_P + 3) * lanes + lane],
        work[(_P + 4) * lanes + lane],
        work[(_P + 5) * lanes + lane],
        work[(_P + 6) * lanes + lane],
        work[(_P + 7) * lanes + lane],
        work[(_P + 8) * lanes + lane],
        work[(_P + 9) * lanes + lane],
        work[(_P + 10) * lanes + lane],
        work[(_P + 11) * lanes + lane],
        work[(_P + 12) * lanes + lane],
        work[(_P + 13) * lanes + lane],
        work[(_P + 14) * lanes + lane],
        work[(_P + 15) * lanes + lane],
    )
    k_s = work[(_P + 16) * lanes + lane]
    b_s = work[(_P + 17) * lanes + lane]
    mu_k = work[(_P + 18) * lanes + lane]
    eps_v = work[(_P + 19) * lanes + lane]
    joints = pose(phi, theta_c, theta_d, coefficients[4], coefficients[5])
    p_c, dp_c, v_c, p_d, dp_d, v_d = feet(joints, w, h_c, h_d, rates, coefficients[6])
    n_c = normal_force(p_c, dp_c, k_s, b_s)
    n_d = normal_force(p_d, dp_d, k_s, b_s)
    f_c, f_d = low_friction(n_c, n_d, v_c, v_d, mu_k, eps_v)
    acc = accelerations(joints, phi, h_c, theta_c, h_d, theta_d, rates, n_c, n_d, f_c, f_d, coefficients)
    work[(out + 0) * lanes + lane] = acc[0]
    work[(out + 1) * lanes + lane] = acc[1]
    work[(out + 2) * lanes + lane] = acc[2]
    work[(out + 3) * lanes + lane] = acc[3]
    work[(out + 4) * lanes + lane] = acc[4]
    work[(out + 5) * lanes + lane] = acc[5]
    work[(out + 6) * lanes + lane] = acc[6]


@njit(error_model="numpy")
def _derive(parameters, slope, work, lane, lanes):
    """Coefficients of one lane from a parameter row (table order of `sysid.gear.model.PARAMETERS`) and a slope."""
    span = parameters[3] - parameters[6]
    drop = parameters[4] - parameters[7]
    length = np.sqrt(span * span + drop * drop)
    base = _P * lanes + lane
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


@njit(error_model="numpy")
def _begin(parameters, slope, body, legs, work, lane, lanes):
    """Load a job into a lane: coefficients, state in the slope's frame, a first step of length 0."""
    _derive(parameters, slope, work, lane, lanes)
    c = np.cos(slope)
    s = np.sin(slope)
    y = _Y * lanes + lane
    for i in range(2):
        x = body[3 * i]
        z = body[3 * i + 1]
        work[y + (7 * i) * lanes] = c * x - s * z
        work[y + (7 * i + 1) * lanes] = s * x + c * z
    phi = body[2] - slope
    rest = work[(_P + 7) * lanes + lane]
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
        work[(_K1 + i) * lanes + lane] = 0.0
    work[_T * lanes + lane] = 0.0
    work[_H * lanes + lane] = 0.0
    work[_FRESH * lanes + lane] = 1.0
    work[_COUNT * lanes + lane] = 0.0


@njit(error_model="numpy")
def _sample(work, lane, lanes, share, slope, columns, row):
    """Write the state at `share` (0..1) of the step of one lane into `row`, in frame N."""
    h = work[_H * lanes + lane]
    one = 1.0 - share
    b00 = (1.0 + 2.0 * share) * one * one
    b01 = share * share * (3.0 - 2.0 * share)
    b10 = h * share * one * one
    b11 = -h * share * share * one
    c = np.cos(slope)
    s = np.sin(slope)
    half = columns // 2
    for i in range(half):
        x0 = work[(_Y + i) * lanes + lane]
        v0 = work[(_Y + 7 + i) * lanes + lane]
        x1 = work[(_S + i) * lanes + lane]
        v1 = work[(_S + 7 + i) * lanes + lane]
        a0 = work[(_K1 + i) * lanes + lane]
        a1 = work[(_K4 + i) * lanes + lane]
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


def drop_driver(lanes: int):
    """Make the driver for a fixed number of lanes; 1 gives the scalar form."""
    fingerprint = _fingerprint()

    @njit(cache=True, nogil=True, error_model="numpy")
    def drive(parameters, slope, body, legs, clock, offset, jobs, tolerance, h_max, cost, samples, reached, status, spent):
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
        samples : (P, n_total, 6 or 14)
            Written: state at each sample, frame N; NaN from the failure on.
        reached, status, spent : (P, D)
            Written: share of the drop's time integrated, status code, right-hand sides.
        """
        if fingerprint < 0:  # keeps the sources' hash in the key of the cached code
            return
        drops = len(slope)
        columns = samples.shape[2]
        work = np.ones(_ROWS * lanes)
        job = np.full(lanes, -1, np.int64)
        cursor = np.zeros(lanes, np.int64)
        per_tolerance = 1.0 / (7.0 * tolerance * tolerance)
        waiting = 0
        active = 0
        for lane in range(lanes):
            first = jobs[min(waiting, len(jobs) - 1)]
            _begin(parameters[first // drops], slope[first % drops], body[first % drops], legs, work, lane, lanes)
            work[_NEXT * lanes + lane] = np.inf
            if waiting < len(jobs):
                job[lane] = first
                cursor[lane] = offset[first % drops]
                work[_NEXT * lanes + lane] = 0.0
                waiting += 1
                active += 1
        while active > 0:
            for i in range(7):
                for lane in range(lanes):
                    h = work[_H * lanes + lane]
                    k1 = work[(_K1 + i) * lanes + lane]
                    v = work[(_Y + 7 + i) * lanes + lane]
                    work[(_S + i) * lanes + lane] = work[(_Y + i) * lanes + lane] + 0.5 * h * v
                    work[(_S + 7 + i) * lanes + lane] = v + 0.5 * h * k1
            for lane in range(lanes):
                _evaluate(work, _S, _K2, lane, lanes)
            for i in range(7):
                for lane in range(lanes):
                    h = work[_H * lanes + lane]
                    v2 = work[(_S + 7 + i) * lanes + lane]
                    work[(_S + i) * lanes + lane] = work[(_Y + i) * lanes + lane] + 0.75 * h * v2
                    work[(_S + 7 + i) * lanes + lane] = (
                        work[(_Y + 7 + i) * lanes + lane] + 0.75 * h * work[(_K2 + i) * lanes + lane]
                    )
            for lane in range(lanes):
                _evaluate(work, _S, _K3, lane, lanes)
            for i in range(7):
                for lane in range(lanes):
                    h = work[_H * lanes + lane]
                    v = work[(_Y + 7 + i) * lanes + lane]
                    k1 = work[(_K1 + i) * lanes + lane]
                    k2 = work[(_K2 + i) * lanes + lane]
                    k3 = work[(_K3 + i) * lanes + lane]
                    work[(_S + i) * lanes + lane] = work[(_Y + i) * lanes + lane] + h * (
                        v + h * (1.0 / 6.0 * k1 + 1.0 / 3.0 * k2)
                    )
                    work[(_S + 7 + i) * lanes + lane] = v + h * (2.0 / 9.0 * k1 + 1.0 / 3.0 * k2 + 4.0 / 9.0 * k3)
            for lane in range(lanes):
                _evaluate(work, _S, _K4, lane, lanes)
            attention = 0.0
            for lane in range(lanes):
                total = 0.0
                for i in range(7):
                    gap = -5.0 / 72.0 * work[(_K1 + i) * lanes + lane] + 1.0 / 12.0 * work[(_K2 + i) * lanes + lane]
                    gap = gap + 1.0 / 9.0 * work[(_K3 + i) * lanes + lane] - 0.125 * work[(_K4 + i) * lanes + lane]
                    gap = gap * _WEIGHTS[i]
                    total = total + gap * gap
                h = work[_H * lanes + lane]
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
                fresh = work[_FRESH * lanes + lane]
                new_h = 1e-5 if fresh > 0.0 else new_h
                work[_NEW_H * lanes + lane] = new_h
                work[_TAKEN * lanes + lane] = taken
                count = work[_COUNT * lanes + lane] + 3.0
                work[_COUNT * lanes + lane] = count
                due = taken if work[_T * lanes + lane] + h >= work[_NEXT * lanes + lane] else 0.0
                stretch = work[(_S + 3) * lanes + lane] + work[(_P + 6) * lanes + lane]
                stretch_d = work[(_S + 5) * lanes + lane] + work[(_P + 6) * lanes + lane]
                stretch = stretch if stretch < stretch_d else stretch_d
                sound = 1.0 if stretch > 0.0 else 0.0
                sound = sound if new_h > 1e-9 else 0.0
                attention = attention + due + (1.0 - sound) + (1.0 if count > 1000.0 else 0.0)
            if attention > 0.0:
                for lane in range(lanes):
                    if job[lane] < 0:
                        continue
                    here = job[lane]
                    candidate = here // drops
                    drop = here % drops
                    end = offset[drop + 1]
                    h = work[_H * lanes + lane]
                    t = work[_T * lanes + lane]
                    length = clock[end - 1]
                    code = OK
                    taken = work[_TAKEN * lanes + lane] > 0.0
                    if taken:
                        while cursor[lane] < end and clock[cursor[lane]] <= t + h:
                            share = (clock[cursor[lane]] - t) / h if h > 0.0 else 0.0
                            _sample(work, lane, lanes, share, slope[drop], columns, samples[candidate, cursor[lane]])
                            cursor[lane] += 1
                        stretch = min(work[(_S + 3) * lanes + lane], work[(_S + 5) * lanes + lane])
                        if not stretch + work[(_P + 6) * lanes + lane] > 0.0:
                            code = BLEW_UP
                    elif not work[_NEW_H * lanes + lane] > 1e-9:
                        code = STEP_COLLAPSED
                    if work[_COUNT * lanes + lane] > max(1000.0, cost * length):
                        code = TOO_EXPENSIVE
                    if cursor[lane] < end:
                        work[_NEXT * lanes + lane] = clock[cursor[lane]]
                        if code == OK:
                            continue
                        reached[candidate, drop] = min(t / length, 1.0) if length > 0.0 else 0.0
                        samples[candidate, cursor[lane] : end] = np.nan
                    else:
                        code = OK
                        reached[candidate, drop] = 1.0
                    status[candidate, drop] = code
                    spent[candidate, drop] = np.int64(work[_COUNT * lanes + lane])
                    if waiting < len(jobs):
                        here = jobs[waiting]
                        waiting += 1
                    else:
                        job[lane] = -1
                        active -= 1
                    # An idle lane repeats its last start: it costs nothing and cannot make special numbers.
                    drop = here % drops
                    _begin(parameters[here // drops], slope[drop], body[drop], legs, work, lane, lanes)
                    work[_TAKEN * lanes + lane] = -1.0
                    if job[lane] >= 0:
                        job[lane] = here
                        cursor[lane] = offset[drop]
                        work[_NEXT * lanes + lane] = 0.0
                    else:
                        work[_NEXT * lanes + lane] = np.inf
            for lane in range(lanes):
                taken = work[_TAKEN * lanes + lane]
                h = work[_H * lanes + lane]
                work[_T * lanes + lane] = work[_T * lanes + lane] + (h if taken > 0.0 else 0.0)
                work[_H * lanes + lane] = work[_NEW_H * lanes + lane] if taken >= 0.0 else 0.0
                work[_FRESH * lanes + lane] = 0.0 if taken >= 0.0 else 1.0
            for i in range(14):
                for lane in range(lanes):
                    old = work[(_Y + i) * lanes + lane]
                    new = work[(_S + i) * lanes + lane]
                    work[(_Y + i) * lanes + lane] = new if work[_TAKEN * lanes + lane] > 0.0 else old
            for i in range(7):
                for lane in range(lanes):
                    old = work[(_K1 + i) * lanes + lane]
                    new = work[(_K4 + i) * lanes + lane]
                    work[(_K1 + i) * lanes + lane] = new if work[_TAKEN * lanes + lane] > 0.0 else old

    return drive


@njit(cache=True, nogil=True, error_model="numpy")
def foot_forces(parameters, slope, states, forces):
    """Fill `forces` (n, 4): normal force rear, front, friction rear, front [N] in the given states (n, 14), frame N."""
    work = np.ones(_ROWS)
    for n in range(len(states)):
        state = states[n]
        legs = np.array([state[3], state[4], state[5], state[6], state[10], state[11], state[12], state[13]])
        body = np.array([state[0], state[1], state[2], state[7], state[8], state[9]])
        _begin(parameters, slope, body, legs, work, 0, 1)
        y = work[:14]
        p = work[_P:]
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
