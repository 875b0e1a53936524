"""The landing gear in time: many drops side by side in lanes.

`drop_driver(lanes, surface)` makes the compiled driver. Each lane integrates one job (a parameter row on a
drop) with an adaptive step and takes the next job when its drop ends; loops over lanes become packed
instructions. Lanes never exchange numbers. A result therefore depends neither on the number of lanes and
threads nor on the order of jobs, and a lost lane does not disturb others. One drop alone takes a lane while
the others idle: with AVX-512 that takes as long as a driver of one lane, which would be compiled as well.

The method is the explicit pair of `sysid.integrate.tableau`; samples between steps come from the cubic
Hermite polynomial of the step (order 3), and so do the times of touchdown, lift-off, flip and rest. A step
stays within the stability limit of the method for the slip of a creeping foot and for a leg that rings on the
ground; without that limit every fourth step there grows unstable and is repeated. On a surface with modes a
step ends where a foot loses its mode (`sysid.gear.surfaces.high_friction`). Under thrust it ends where a
segment of the thrust history ends.

Status codes of a job: see `OK` ... `BOTH_TOUCHED`.
"""

import hashlib
from pathlib import Path

import numpy as np
from numba import njit

from sysid.gear.kernel import stage as stages
from sysid.gear.kernel import terms
from sysid.gear.kernel import work_buffer as at
from sysid.gear.kernel.geometry import normal_force
from sysid.gear.kernel.lane import (
    FREE,
    MOTION,
    TURN,
    assign,
    available,
    begin,
    feet_at_start,
    hold_rest,
    idle,
    load,
    locate,
    next_in_line,
    sample,
    thrust_segment,
)
from sysid.gear.kernel.parameter_row import THRUST_POINT_DX
from sysid.gear.kernel.stage import law_at
from sysid.gear.surfaces.surface import Surface, law_text, specialized
from sysid.integrate.fused import INSIDE, chosen, fused, part, whole_vectors
from sysid.integrate.tableau import STAGES, E
from sysid.types import Compiled

# Names that a driver or a reader binds to a surface's functions.
evaluate: Compiled = None  # type: ignore[assignment]
after_step: Compiled = None  # type: ignore[assignment]
friction: Compiled = None  # type: ignore[assignment]

OK = 0
STEP_COLLAPSED = 1
TOO_EXPENSIVE = 2
BLEW_UP = 3
CAME_TO_REST = 4
FLIPPED_OVER = 5
BOTH_TOUCHED = 6

# Kinds of events in `marks`, and the part that an event happens to.
TOUCHDOWN, LIFT_OFF, SLIP, STICK, FLIP, REST = range(6)
REAR, FRONT, BODY = range(3)
# Columns of `moments` behind the first touchdowns of the rear and the front foot.
FLIP_AT, REST_AT = 2, 3
# Row of `states` behind the states at the two touchdowns.
AT_END = 2
# Weights of the errors of the rates (s, w, phi, h_C, theta_C, h_D, theta_D) [s/m for s, w, h; s/rad for
# angles]: 1 / (1 m/s) and 1 / (10 rad/s) for the light legs. Errors of the body weigh 30 times (s, w) and 60
# times (phi) as much, because the body's motion is measured.
WEIGHTS = np.array([30.0, 30.0, 6.0, 1.0, 0.1, 1.0, 0.1])

# Length of the first step of a drop, and of the first one after a foot has switched its mode [s].
FIRST_STEP = 6e-5
# Largest distance of two instants that are one [s].
_SAME = 1e-10


@fused
def _error(work, lane, lanes):
    """Sum of the squared, weighted errors of a step's rates over its length squared."""
    total = 0.0
    for i in range(at.COORDINATES):
        gap = 0.0
        for j in range(STAGES + 1):
            gap += E[j] * work[(at.RATES + at.COORDINATES * j + i) * lanes + lane]
        gap = gap * WEIGHTS[i]
        total += gap * gap
    return total


@njit(error_model="numpy", inline="always")
def _advance(work, taken, lane, lanes):
    """Make the end of a taken step the start of the next one."""
    for i in range(2 * at.COORDINATES):
        start, end = (at.START + i) * lanes + lane, (at.END + i) * lanes + lane
        work[start] = chosen(taken, work[end], work[start])
    for i in range(at.COORDINATES):
        start, end = (at.RATES + i) * lanes + lane, (at.RATES + at.COORDINATES * STAGES + i) * lanes + lane
        work[start] = chosen(taken, work[end], work[start])
    for foot in range(2):
        start, end = (at.FRICTION_0 + foot) * lanes + lane, (at.FRICTION + foot) * lanes + lane
        work[start] = chosen(taken, work[end], work[start])


@part
def _mark(marks, marked, time, kind, foot):
    """Write an event without friction into the next free row of `marks`; returns how many rows are used."""
    if marked < len(marks):
        marks[marked, 0] = time
        marks[marked, 1] = kind
        marks[marked, 2] = foot
        marks[marked, 3:] = np.nan
        marked += 1
    return marked


def fingerprint(surface: Surface) -> int:
    """Hash of the sources that are inlined in a driver, so that a cached driver never outlives them."""
    folder = Path(__file__).parent
    sources = sorted(folder.glob("*.py"))
    sources += [folder.parent / "surfaces" / "surface.py"]
    sources += [folder.parent.parent / "integrate" / f"{name}.py" for name in ("fused", "tableau")]
    text = surface.name.encode() + b"".join(source.read_bytes() for source in sources) + law_text(surface)
    return int.from_bytes(hashlib.sha256(text).digest()[:6], "big")


def drop_driver(lanes: int, surface: Surface, extended: bool = False):
    """Make the driver for a number of lanes, a surface, and all terms if `extended`."""
    sources = fingerprint(surface) + extended
    modes = surface.switching

    def drive(
        parameters, slope, body, legs, clock, offset, segments, plans, jobs, handed, tolerance, h_max, cost,
        ending, samples, reached, status, spent, switches, moments, states, marks,
    ):  # fmt: skip
        """Integrate jobs (n,) (candidate * drops + drop) and sample them on their drop's clock.

        Calls from several threads share the jobs through `handed` (1,), the next place in `jobs`, which runs
        on behind their end.

        Parameters
        ----------
        parameters : (P, n)
            Rows of `sysid.gear.kernel.parameter_row`.
        slope, body : (P or 1, D) and (P or 1, D, 6)
            Angle of each surface; x, z, q and rates at each drop's first sample, frame N [m, rad, s].
        legs : (8,) or (0,)
            h_C q_C h_D q_D and rates at the start, empty for legs at rest.
        clock : (n_total,)
            Sample times since each drop's start [s]; drop d has offset[d]:offset[d + 1].
        segments : (n, SEGMENT_COLUMNS), plans : (D, PLAN_COLUMNS)
            Thrust histories and what each drop does with them.
        tolerance, h_max, cost : float
            Bound of the weighted rms error of the rates per step; longest step [s]; right-hand sides that a
            drop may spend per second of its length, at least 1000 in all.
        ending : 5 float
            0: run on, 1: end a drop that has come to rest or flipped, 2: or whose feet have both touched;
            then speed [m/s], turn rate [rad/s] and time [s] of rest, and the angle of a flip [rad].
        samples : (P, n_total, 6 or 16)
            Written: state at each sample, frame N (16: friction on the feet too); NaN from the end on.
        reached, status, spent, switches : (P, D)
            Written: share of the drop's time integrated, status code, right-hand sides, mode switches.
        moments : (P, D, 4)
            Written: first touchdown of the rear and the front foot, flip, rest [s]; NaN where there is none.
        states : (P, D, 3, 6)
            Written: the body at the two touchdowns and at the end, frame N.
        marks : (n, 7)
            Written: time, kind, foot (2: body), available and required friction of both feet, for the first
            n events; without rows only the first touchdowns are looked for.
        """
        if sources < 0:  # keeps the sources' hash in the key of the cached code
            return
        whole_vectors()  # type: ignore[call-arg]
        ends_at, rest_speed, rest_turn, rest_time, flip_angle = ending
        ends = ends_at > 0.0
        logs = 1.0 if len(marks) > 0 else 0.0
        drops = slope.shape[1]
        work, origin = np.empty(at.ROWS * lanes), np.empty(lanes)
        job, cursor = np.empty(lanes, np.int64), np.empty(lanes, np.int64)
        segment = np.empty(lanes, np.int64)
        per_tolerance = 1.0 / (7.0 * tolerance * tolerance)
        # Arguments that are constants would have numba compile what takes them once for every value.
        to_turn, to_rest = np.int64(TURN), np.int64(MOTION)
        flip, rest, whole = np.int64(FLIP), np.int64(REST), np.int64(BODY)
        marked = np.int64(0)
        job[:] = FREE
        active = free = lanes
        while True:
            if free > 0:
                for lane in range(lanes):
                    if job[lane] != FREE:
                        continue
                    place = next_in_line(handed)
                    number = jobs[min(place, len(jobs) - 1)]
                    load(
                        number, parameters, slope, body, legs, segments, plans, segment, origin,
                        work, lane, lanes,
                    )  # fmt: skip
                    if place < len(jobs):
                        assign(number, lane, job, cursor, clock, offset, cost, work)
                    else:
                        idle(lane, job, work)
                        active -= 1
                free = 0
                if active == 0:
                    break
            for lane in range(lanes):
                evaluate(work, 1, lane, lanes)
            for lane in range(lanes):
                evaluate(work, 2, lane, lanes)
            for lane in range(lanes):
                evaluate(work, 3, lane, lanes)
            for lane in range(lanes):
                evaluate(work, 4, lane, lanes)
            for lane in range(lanes):
                evaluate(work, 5, lane, lanes)
            attention = 0
            for lane in range(lanes):
                total = _error(work, lane, lanes)
                h = work[at.STEP * lanes + lane]
                total = total * h * h * per_tolerance
                # Fourth root of the error (of its square, the eighth): close to the cube root, and packed.
                root = np.sqrt(np.sqrt(np.sqrt(total + 1e-9)))
                factor = 0.85 / root
                # In this order: a comparison with NaN is false, so a lost step is rejected and shrinks.
                factor = factor if factor > 0.2 else 0.2
                factor = factor if factor < 4.0 else 4.0
                taken = 1.0 if total <= 1.0 else 0.0
                new_h = h * factor
                new_h = new_h if new_h < h_max else h_max
                stable_h = 1.0 / (work[at.STIFF * lanes + lane] + 1e-3)
                stable_h = stable_h if taken > 0.0 else new_h
                new_h = new_h if new_h < stable_h else stable_h
                fresh = work[at.FRESH * lanes + lane]
                new_h = FIRST_STEP * taken if fresh > 0.0 else new_h
                new_h = 1e-8 if fresh > 1.0 else new_h
                if modes:
                    taken, new_h = after_step(work, lane, lanes, h, taken, new_h)
                t = work[at.TIME * lanes + lane]
                now = t + h * taken
                left = work[at.SEGMENT_END * lanes + lane] - now
                over = 1.0 if left <= _SAME else 0.0
                new_h = new_h if new_h < left or over > 0.0 else left
                work[at.NEW_STEP * lanes + lane] = new_h
                work[at.TAKEN * lanes + lane] = taken
                count = work[at.COUNT * lanes + lane] + STAGES
                work[at.COUNT * lanes + lane] = count
                # News of the step: contact, turning over, coming to rest.
                touch_c = 1.0 if work[at.NORMAL * lanes + lane] > 0.0 else 0.0
                touch_d = 1.0 if work[(at.NORMAL + 1) * lanes + lane] > 0.0 else 0.0
                change_c = touch_c - work[at.TOUCHED * lanes + lane]
                change_d = touch_d - work[(at.TOUCHED + 1) * lanes + lane]
                news = change_c if change_c > change_d else change_d
                # With a log a foot that lifts off is news too.
                lift = change_c if change_c < change_d else change_d
                lift = -lift * logs
                news = news if news > lift else lift
                turn = work[(at.END + at.PHI) * lanes + lane]
                turn = turn if turn > 0.0 else -turn
                turned = 1.0 if turn > flip_angle else 0.0
                turned = turned - work[at.FLIPPED * lanes + lane]
                news = news if news > turned else turned
                s_rate = work[(at.END + at.COORDINATES + at.S) * lanes + lane]
                w_rate = work[(at.END + at.COORDINATES + at.W) * lanes + lane]
                omega = work[(at.END + at.COORDINATES + at.PHI) * lanes + lane]
                speed = s_rate * s_rate + w_rate * w_rate - rest_speed * rest_speed
                spin = omega * omega - rest_turn * rest_turn
                motion = speed if speed > spin else spin
                motion = motion if now >= work[at.HOLD * lanes + lane] else 1.0
                moved = work[at.MOVED * lanes + lane]
                calm = logs if moved >= t else 0.0
                calm = calm if motion < 0.0 else 0.0
                news = news if news > calm else calm
                moved = now if motion >= 0.0 else moved
                moved = moved if taken > 0.0 else work[at.MOVED * lanes + lane]
                work[at.MOVED * lanes + lane] = moved
                rested = 1.0 if now - moved >= rest_time else 0.0
                rested = rested - work[at.RESTED * lanes + lane]
                news = news if news > rested else rested
                news = news * taken
                news = news if news > over else over
                due = t + h - work[at.NEXT * lanes + lane]
                stretch_c = work[(at.END + at.H_C) * lanes + lane] + work[at.LENGTH * lanes + lane]
                stretch_d = work[(at.END + at.H_D) * lanes + lane] + work[at.LENGTH * lanes + lane]
                sound = stretch_c if stretch_c < stretch_d else stretch_d
                sound = sound if new_h > 1e-9 else -1.0
                sound = sound if count < work[at.LIMIT * lanes + lane] else -1.0
                due = due if taken > 0.0 else -1.0
                due = due if sound > 0.0 else 1.0
                due = due if news <= 0.0 else 1.0
                work[at.DUE * lanes + lane] = due
                attention += 1 if due >= 0.0 else 0
            if attention > 0:
                for lane in range(lanes):
                    if job[lane] < 0 or work[at.DUE * lanes + lane] < 0.0:
                        continue
                    number = job[lane]
                    candidate = number // drops
                    drop = number % drops
                    end = offset[drop + 1]
                    h = work[at.STEP * lanes + lane]
                    t = work[at.TIME * lanes + lane]
                    length = clock[end - 1]
                    code = OK
                    taken = work[at.TAKEN * lanes + lane] > 0.0
                    if taken:
                        for foot in range(2):
                            touch = 1.0 if work[(at.NORMAL + foot) * lanes + lane] > 0.0 else 0.0
                            before = work[(at.TOUCHED + foot) * lanes + lane]
                            if touch > before or (logs > 0.0 and touch < before):
                                share = locate(work, lane, lanes, foot, ending) if h > 0.0 else 0.0
                                work[(at.TOUCHED + foot) * lanes + lane] = touch
                                if touch > 0.0 and np.isnan(moments[candidate, drop, foot]):
                                    moments[candidate, drop, foot] = t + share * h
                                    row = states[candidate, drop, foot]
                                    sample(work, lane, lanes, share, row)
                                    begins = t + share * h + plans[drop, at.PLAN_START]
                                    waits = plans[drop, at.PLAN_WAITS] > 0.0
                                    waits = waits and segment[lane] == plans[drop, at.PLAN_FIRST]
                                    if waits and begins < work[at.SEGMENT_END * lanes + lane]:
                                        origin[lane] = begins
                                        work[at.SEGMENT_END * lanes + lane] = begins
                                        hold_rest(plans[drop, at.PLAN_SETTLED], begins, work, lane, lanes)
                                    if ends_at > 1.0 and moments[candidate, drop, 1 - foot] >= 0.0:
                                        code = BOTH_TOUCHED
                                kind = TOUCHDOWN if touch > 0.0 else LIFT_OFF
                                marked = _mark(marks, marked, t + share * h, kind, foot)
                            if modes and work[(at.SWITCH + foot) * lanes + lane] > 0.0:
                                switches[candidate, drop] += 1
                                if marked < len(marks):
                                    kind = STICK if work[(at.STUCK + foot) * lanes + lane] > 0.0 else SLIP
                                    marked = _mark(marks, marked, t + h, kind, foot)
                                    for other in range(2):
                                        marks[marked - 1, 3 + other] = available(work, lane, lanes, other)
                                        needed = work[(at.REQUIRED + other) * lanes + lane]
                                        marks[marked - 1, 5 + other] = needed
                        if abs(work[(at.END + at.PHI) * lanes + lane]) > flip_angle and h > 0.0:
                            if work[at.FLIPPED * lanes + lane] == 0.0:
                                work[at.FLIPPED * lanes + lane] = 1.0
                                turned_at = t + h * locate(work, lane, lanes, to_turn, ending)
                                moments[candidate, drop, FLIP_AT] = turned_at
                                marked = _mark(marks, marked, turned_at, flip, whole)
                            code = FLIPPED_OVER if ends else code
                        if logs > 0.0 and h > 0.0 and work[at.MOVED * lanes + lane] == t:
                            work[at.MOVED * lanes + lane] = t + h * locate(work, lane, lanes, to_rest, ending)
                        if t + h - work[at.MOVED * lanes + lane] >= rest_time:
                            if work[at.RESTED * lanes + lane] == 0.0:
                                work[at.RESTED * lanes + lane] = 1.0
                                moments[candidate, drop, REST_AT] = work[at.MOVED * lanes + lane]
                                marked = _mark(marks, marked, work[at.MOVED * lanes + lane], rest, whole)
                            code = CAME_TO_REST if ends and code == OK else code
                        while cursor[lane] < end and clock[cursor[lane]] <= t + h:
                            share = (clock[cursor[lane]] - t) / h if h > 0.0 else 1.0
                            row = samples[candidate, cursor[lane]]
                            sample(work, lane, lanes, share, row)
                            cursor[lane] += 1
                        stretch = min(
                            work[(at.END + at.H_C) * lanes + lane], work[(at.END + at.H_D) * lanes + lane]
                        )
                        if not stretch + work[at.LENGTH * lanes + lane] > 0.0:
                            code = BLEW_UP
                        now = t + h
                        while work[at.SEGMENT_END * lanes + lane] - now <= _SAME:
                            segment[lane] += 1
                            until = np.inf
                            if segment[lane] < plans[drop, at.PLAN_STOP]:
                                until = origin[lane] + segments[segment[lane], at.SEGMENT_TO]
                            lever, begun = parameters[candidate, THRUST_POINT_DX], origin[lane]
                            thrust_segment(segments, segment[lane], begun, until, lever, work, lane, lanes)
                        work[at.NEW_STEP * lanes + lane] = min(
                            work[at.NEW_STEP * lanes + lane], work[at.SEGMENT_END * lanes + lane] - now
                        )
                    elif not work[at.NEW_STEP * lanes + lane] > 1e-9:
                        code = STEP_COLLAPSED
                    if work[at.COUNT * lanes + lane] >= work[at.LIMIT * lanes + lane]:
                        code = TOO_EXPENSIVE
                    if cursor[lane] < end:
                        work[at.NEXT * lanes + lane] = clock[cursor[lane]]
                        if code == OK:
                            continue
                        reached[candidate, drop] = min(t / length, 1.0) if length > 0.0 else 0.0
                        samples[candidate, cursor[lane] : end] = np.nan
                    else:
                        code = code if code >= CAME_TO_REST else OK
                        reached[candidate, drop] = 1.0
                    share = 1.0 if taken else 0.0
                    if taken and cursor[lane] == end and code == OK:
                        share = (length - t) / h if h > 0.0 else 0.0
                    sample(work, lane, lanes, share, states[candidate, drop, AT_END])
                    status[candidate, drop] = code
                    spent[candidate, drop] = np.int64(work[at.COUNT * lanes + lane])
                    job[lane] = FREE
                    free += 1
            for lane in range(lanes):
                taken = work[at.TAKEN * lanes + lane]
                h = work[at.STEP * lanes + lane]
                work[at.TIME * lanes + lane] = work[at.TIME * lanes + lane] + (h if taken > 0.0 else 0.0)
                work[at.STEP * lanes + lane] = work[at.NEW_STEP * lanes + lane]
                fresh = work[at.FRESH * lanes + lane]
                fresh = 0.0 if fresh == 1.0 else fresh
                if modes:
                    switched = work[at.SWITCH * lanes + lane] + work[(at.SWITCH + 1) * lanes + lane]
                    fresh = 1.0 if switched > 0.0 and fresh == 0.0 else fresh
                _advance(work, taken > 0.0, lane, lanes)
                work[at.FRESH * lanes + lane] = fresh

    added, approach = (terms.added, terms.approach) if extended else (terms.nothing_added, terms.no_approach)
    text = specialized(stages.motion_at, solve=surface.solve, added=added, approach=approach)
    motion = njit(forceinline=True, **INSIDE)(text)
    text = specialized(stages.evaluate, motion=motion, modes=modes)
    stage = njit(error_model="numpy", inline="always")(text)
    bound = specialized(drive, evaluate=stage, after_step=surface.after_step)
    return njit(cache=True, nogil=True, error_model="numpy")(bound)


def force_reader(surface: Surface):
    """Make the function that reads the forces on the feet from states."""
    sources = fingerprint(surface)
    continuous = not surface.switching

    def foot_forces(parameters, slope, states, forces):
        """Fill `forces` (n, 4) of states (n, 14), frame N: normal rear, front, friction rear, front [N].

        Friction only where the law is a function of the state.
        """
        if sources < 0:  # keeps the sources' hash in the key of the cached code
            return
        work = np.empty(at.ROWS)
        for n in range(len(states)):
            coordinates, rates = states[n, :7], states[n, 7:]
            legs = np.concatenate((coordinates[3:], rates[3:]))
            body = np.concatenate((coordinates[:3], rates[:3]))
            begin(parameters, slope, body, legs, work, 0, 1)
            p_c, dp_c, v_c, p_d, dp_d, v_d = feet_at_start(work, 0, 1)
            k_s, b_s = work[at.GROUND_SPRING], work[at.GROUND_DAMPER]
            n_c = normal_force(p_c, dp_c, k_s, b_s + terms.approach(p_c, k_s, work, 0, 1))
            n_d = normal_force(p_d, dp_d, k_s, b_s + terms.approach(p_d, k_s, work, 0, 1))
            forces[n, 0] = n_c
            forces[n, 1] = n_d
            if continuous:
                forces[n, 2], forces[n, 3] = friction(n_c, n_d, v_c, v_d, law_at(work, at.LAW, 1))

    return njit(cache=True, nogil=True, error_model="numpy")(
        specialized(foot_forces, friction=surface.friction)
    )
