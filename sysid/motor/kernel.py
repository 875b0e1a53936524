"""Integration of the motor equations (1-3), event by event, for one trial or a whole population.

A row of numbers that the equations read has the order of `READS`; `R` ... `DELAY` are its columns. Symbols:

======  =====================  ==============  ==================================================
symbol  name                   unit            meaning
======  =====================  ==============  ==================================================
R       winding_resistance     Ω               of the equivalent direct-current circuit
L       winding_inductance     H
k_d     viscous_damping        N·m·s/rad
k_v     back_emf_constant      V·s/rad
k_m     torque_constant        N·m/A           the paper's K_t; k_t is the leg's stiffness here
I^r     rotor_inertia          kg·m²           rotor and propeller
I_sat   saturation_current     A
Ω_min   saturation_speed       rad/s           edge of the dead band
a, b    no_load_*              rad/s           Ω_0(u) = a u + b sign(u), per direction
c2, c1  torque_*                               c2 Ω|Ω| + c1 Ω, per direction
R_s     supply_resistance      Ω               terms on trial, see `sysid.motor.model`
V_dead  dead_time_voltage      V
w       winding_warming        1/(A²·s)
======  =====================  ==============  ==================================================

The right-hand side is smooth between events, and each event ends a step: a command change, a knot of the
supply voltage, Ω = 0, |Ω| = Ω_min, and inside the dead band |I| = I_sat and d|Ω|/dt = 0. Steps are those
of RODAS, an L-stable Rosenbrock method of order 4(3) with six stages and a continuous extension of order
3 (Hairer & Wanner, Solving Ordinary Differential Equations II, 2nd ed., section IV.7), because the search
bounds allow L/R of microseconds and rotor time constants of 0.1 s. On two states each stage is a 2 × 2
product. Resistance and dead-time voltage are constant in a step; without terms on trial they are constant
altogether, and every bit is as without.
"""

from math import exp, inf, sqrt

import numpy as np
from numba import njit

from sysid.motor.dense_output import between, integral, write_charge, write_cubic, write_states

# Parameters that the equations read, by name: the layout of every `row` in this file.
READS = (
    "winding_resistance",
    "winding_inductance",
    "viscous_damping",
    "back_emf_constant",
    "torque_constant",
    "rotor_inertia",
    "saturation_current",
    "saturation_speed",
    "command_delay",
    *(f"no_load_{name}_{way}" for way in ("forward", "reverse") for name in ("slope", "intercept")),
    *(f"torque_{name}_{way}" for way in ("forward", "reverse") for name in ("quadratic", "linear")),
    "supply_resistance",
    "dead_time_voltage",
    "winding_warming",
)
R, L = READS.index("winding_resistance"), READS.index("winding_inductance")
K_D = READS.index("viscous_damping")
K_V, K_M = READS.index("back_emf_constant"), READS.index("torque_constant")
INERTIA = READS.index("rotor_inertia")
I_SAT, OMEGA_MIN = READS.index("saturation_current"), READS.index("saturation_speed")
DELAY = READS.index("command_delay")
SAG, DEAD, WARMING = (READS.index(name) for name in READS[-3:])
# Column of the first of four coefficients: two of forward rotation, `REVERSE` columns further two of reverse.
NO_LOAD = READS.index("no_load_slope_forward")
TORQUE = READS.index("torque_quadratic_forward")
REVERSE = READS.index("torque_quadratic_reverse") - TORQUE

# Status of a simulated trial.
DONE, NO_STEADY_STATE, TOO_MANY_STEPS, NOT_FINITE, STUCK = 0, 1, 2, 3, 4
# How a trial starts.
AS_GIVEN, STEADY = 0, 1

# Largest number of steps of one trial, and of one candidate on all its trials: an ordinary one takes some 80
# per second and 300 to 450 ns each, so a candidate is cut before it takes 2 s. Equal shares need no clock and
# no order.
MAX_STEPS, CANDIDATE_STEPS = 400_000, 4_000_000
# Duration of the search for the event that ends a step [steps]: the search counts toward `MAX_STEPS` and
# `CANDIDATE_STEPS`.
_EVENT = 6
# Time of a spin-up [s]: inertia times the speed scale over this time is the torque scale, which sets the
# absolute tolerance of the current.
_SPIN_UP_TIME = 0.1
# Current below which the dead-time voltage fades [A].
_DEAD_CURRENT = 0.1
# Longest step with a term whose coefficient is constant within a step: right after a command [s], as a share
# of the time since then, and by the rise of a warming resistance within the step [1].
_TERM_STEP, _TERM_SHARE, _TERM_RISE = 5e-4, 0.1, 1e-2

_GAMMA = 0.25
_C2, _C3, _C4 = 0.386, 0.21, 0.63
_D1, _D2, _D3, _D4 = 0.25, -0.1043, 0.1035, -0.03620000000000023
_A21 = 1.544
_A31, _A32 = 0.9466785280815826, 0.2557011698983284
_A41, _A42, _A43 = 3.314825187068521, 2.896124015972201, 0.9986419139977817
_A51, _A52, _A53, _A54 = 1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950
_G21 = -5.6688
_G31, _G32 = -2.430093356833875, -0.2063599157091915
_G41, _G42, _G43 = -0.1073529058151375, -9.594562251023355, -20.47028614809616
_G51, _G52, _G53, _G54 = 7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160
_G61, _G62, _G63 = 8.083246795921522, -7.981132988064893, -31.52159432874371
_G64, _G65 = 16.31930543123136, -6.058818238834054
_H21, _H22, _H23 = 10.12623508344586, -7.487995877610167, -34.80091861555747
_H24, _H25 = -7.992771707568823, 1.025137723295662
_H31, _H32, _H33 = -0.6762803392801253, 6.087714651680015, 16.43084320892478
_H34, _H35 = 24.76722511418386, -6.594389125716872


@njit(cache=True, error_model="numpy")
def no_load_speed(command, row):
    """Return Ω_0(u) [rad/s] for u in [-1, 1]; the intercept never turns the direction round."""
    if command > 0.0:
        return max(0.0, row[NO_LOAD] * command + row[NO_LOAD + 1])
    if command < 0.0:
        return min(0.0, row[NO_LOAD + REVERSE] * command - row[NO_LOAD + REVERSE + 1])
    return 0.0


@njit(cache=True, error_model="numpy")
def _mapped_speed(command, mapped, row):
    """Return Ω_0(u) [rad/s]: what a steady level `mapped` (2,) [rad/s, N·m] shows, or the line where NaN."""
    if mapped[0] != mapped[0]:
        return no_load_speed(command, row)
    drag = mapped[1] + row[K_D] * mapped[0]
    return mapped[0] + resistance(command, row) * drag / (row[K_M] * row[K_V])


@njit(cache=True, error_model="numpy")
def resistance(command, row):
    """Return R + R_s u² [Ω] of a cold winding: the supply carries u I, and u of its sag R_s u I counts."""
    return row[R] + row[SAG] * (command * command)


@njit(cache=True, error_model="numpy")
def _dead_time(step, command, current, gap, res, ind, drop):
    """Return voltage [V] and resistance [Ω] that dead time adds in a step; `gap` is the voltage less k_v Ω.

    The drop V_dead I/√(I² + I_0²) is linear about the current half-way. Ω_0(u) is measured with a current
    that drives, so nothing is added there; against the command it is twice the drop.
    """
    side = 1.0 if command > 0.0 else -1.0 if command < 0.0 else 0.0
    half = current
    for _ in range(4):
        size = half * half + _DEAD_CURRENT * _DEAD_CURRENT
        slope = drop * _DEAD_CURRENT * _DEAD_CURRENT / (size * sqrt(size))
        volt = drop * side - (drop * half / sqrt(size) - slope * half)
        target = (gap + volt) / (res + slope)
        half = target + (current - target) * exp(-0.5 * step * (res + slope) / ind)
    return volt, slope


@njit(cache=True, error_model="numpy")
def steady_state(voltage, command, row):
    """Return current [A] and speed [rad/s] at rest under a constant voltage; NaN where there is none.

    With a cold winding, and a current that drives.
    """
    sign = 1.0 if voltage >= 0.0 else -1.0
    k = TORQUE if sign > 0.0 else TORQUE + REVERSE
    res = resistance(command, row)
    gain = row[K_M] / res
    linear = row[k + 1] + row[K_D] + gain * row[K_V]
    speed = 2.0 * gain * abs(voltage) / (linear + sqrt(linear * linear + 4.0 * row[k] * gain * abs(voltage)))
    return sign * (abs(voltage) - row[K_V] * speed) / res, sign * speed


@njit(cache=True, error_model="numpy")
def _drag(side, row):
    """Return the coefficients of the drag quad Ω² + lin Ω of a rotor that turns toward `side`."""
    k = TORQUE if side > 0.0 else TORQUE + REVERSE
    return side * row[k], row[k + 1] + row[K_D]


@njit(cache=True, error_model="numpy")
def _step(h, current, speed, volt, volt_rate, res, ind, k_v, k_eff, clipped, quad, lin, inertia):
    """One RODAS step of a smooth regime.

    The motor torque is k_eff I + clipped (one of the two is 0) and the drag quad Ω² + lin Ω. Returns the
    new state, its error estimate, and the two coefficients of the continuous extension per state.
    """
    j11 = -res / ind
    j12 = -k_v / ind
    j21 = k_eff / inertia
    j22 = -(2.0 * quad * speed + lin) / inertia
    w = 1.0 / (h * _GAMMA)
    w11 = w - j11
    w22 = w - j22
    det = 1.0 / (w11 * w22 - j12 * j21)
    n11 = w22 * det
    n12 = j12 * det
    n21 = j21 * det
    n22 = w11 * det
    r = 1.0 / h
    ft = h * volt_rate / ind

    f = (volt - k_v * speed - res * current) / ind + _D1 * ft
    g = (k_eff * current + clipped - (quad * speed + lin) * speed) / inertia
    a1 = n11 * f + n12 * g
    b1 = n21 * f + n22 * g

    x = current + _A21 * a1
    y = speed + _A21 * b1
    f = (volt + _C2 * h * volt_rate - k_v * y - res * x) / ind + _D2 * ft + r * _G21 * a1
    g = (k_eff * x + clipped - (quad * y + lin) * y) / inertia + r * _G21 * b1
    a2 = n11 * f + n12 * g
    b2 = n21 * f + n22 * g

    x = current + _A31 * a1 + _A32 * a2
    y = speed + _A31 * b1 + _A32 * b2
    f = (volt + _C3 * h * volt_rate - k_v * y - res * x) / ind + _D3 * ft + r * (_G31 * a1 + _G32 * a2)
    g = (k_eff * x + clipped - (quad * y + lin) * y) / inertia + r * (_G31 * b1 + _G32 * b2)
    a3 = n11 * f + n12 * g
    b3 = n21 * f + n22 * g

    x = current + _A41 * a1 + _A42 * a2 + _A43 * a3
    y = speed + _A41 * b1 + _A42 * b2 + _A43 * b3
    f = (volt + _C4 * h * volt_rate - k_v * y - res * x) / ind + _D4 * ft
    f += r * (_G41 * a1 + _G42 * a2 + _G43 * a3)
    g = (k_eff * x + clipped - (quad * y + lin) * y) / inertia + r * (_G41 * b1 + _G42 * b2 + _G43 * b3)
    a4 = n11 * f + n12 * g
    b4 = n21 * f + n22 * g

    volt_end = volt + h * volt_rate
    x = current + _A51 * a1 + _A52 * a2 + _A53 * a3 + _A54 * a4
    y = speed + _A51 * b1 + _A52 * b2 + _A53 * b3 + _A54 * b4
    f = (volt_end - k_v * y - res * x) / ind + r * (_G51 * a1 + _G52 * a2 + _G53 * a3 + _G54 * a4)
    g = (k_eff * x + clipped - (quad * y + lin) * y) / inertia
    g += r * (_G51 * b1 + _G52 * b2 + _G53 * b3 + _G54 * b4)
    a5 = n11 * f + n12 * g
    b5 = n21 * f + n22 * g

    x += a5
    y += b5
    f = (volt_end - k_v * y - res * x) / ind
    f += r * (_G61 * a1 + _G62 * a2 + _G63 * a3 + _G64 * a4 + _G65 * a5)
    g = (k_eff * x + clipped - (quad * y + lin) * y) / inertia
    g += r * (_G61 * b1 + _G62 * b2 + _G63 * b3 + _G64 * b4 + _G65 * b5)
    a6 = n11 * f + n12 * g
    b6 = n21 * f + n22 * g

    return (
        x + a6,
        y + b6,
        a6,
        b6,
        _H21 * a1 + _H22 * a2 + _H23 * a3 + _H24 * a4 + _H25 * a5,
        _H21 * b1 + _H22 * b2 + _H23 * b3 + _H24 * b4 + _H25 * b5,
        _H31 * a1 + _H32 * a2 + _H33 * a3 + _H34 * a4 + _H35 * a5,
        _H31 * b1 + _H32 * b2 + _H33 * b3 + _H34 * b4 + _H35 * b5,
    )


@njit(cache=True, error_model="numpy")
def _violation(current, speed, side, in_band, over, rising, i_sat, omega_min, k_m, quad, lin):
    """Return which event function left its declared side (0: none), the first of them by number.

    1: side Ω < 0; 2: |Ω| crossed Ω_min; and inside the dead band 3: |I| crossed I_sat, 4: d|Ω|/dt, judged
    with the unclipped current, changed sign.
    """
    if side * speed < 0.0:
        return 1
    if i_sat < inf:
        gap = side * speed - omega_min
        if (gap > 0.0 and in_band) or (gap < 0.0 and not in_band):
            return 2
        if in_band:
            gap = abs(current) - i_sat
            if (gap < 0.0 and over) or (gap > 0.0 and not over):
                return 3
            gap = side * (k_m * current - (quad * speed + lin) * speed)
            if (gap < 0.0 and rising) or (gap > 0.0 and not rising):
                return 4
    return 0


@njit(cache=True, error_model="numpy")
def integrate(
    row, command_time, command, mapped, supply_time, supply_ratio, begin, end, start, current, speed,
    tolerance, ideal, most_steps, times, out, samples, speeds, edges, charges,
):  # fmt: skip
    """Simulate one trial from `begin` to `end` [s] and fill the output arrays; an empty one asks for nothing.

    Parameters
    ----------
    row : (n_reads,) what `READS` names [SI]
    command_time, command : (m,) instants [s], not yet delayed, and u in [-1, 1] from each instant on
    mapped : (m, 2) loaded speed [rad/s] and drag [N·m] of the steady level of each command at V_ref, from
        which its Ω_0 follows; NaN: from the line a u + b sign(u)
    supply_time, supply_ratio : (k,) knots [s] of V/V_ref, linear between them, constant outside
    begin, end : first and last time of the trial [s]
    start : AS_GIVEN or STEADY; the former takes `current` [A] and `speed` [rad/s]
    tolerance : relative local error
    ideal : no saturation (I_sat = inf)
    most_steps : number of steps after which the trial is given up
    times : (n,) times [s] from `begin` to `end`, not decreasing
    out : (n, 4) receives current, effective current [A], speed [rad/s], and the charge since `begin`,
        that is the integral of the effective current [A·s]; NaN after a failure
    samples, speeds : (m,) times alike [s], receives the speed there alone
    edges, charges : (k,) times alike [s], receives the charge there alone

    Returns
    -------
    status, share of the time span that was reached, number of steps tried
    """
    n_command = command_time.size
    n_supply = supply_time.size
    res, ind, k_v, k_m, inertia = row[R], row[L], row[K_V], row[K_M], row[INERTIA]
    drop, warming, heat = row[DEAD], row[WARMING], 0.0
    i_sat = inf if ideal else row[I_SAT]
    omega_min = row[OMEGA_MIN]
    t = begin
    t_end = end
    # The current's transients follow commands; at a knot of the supply the voltage does not jump.
    t_changed = t
    span = max(t_end - t, 1e-300)

    at_command = 0
    while at_command + 1 < n_command and command_time[at_command + 1] + row[DELAY] <= t:
        at_command += 1
    at_supply = 0
    while at_supply + 1 < n_supply and supply_time[at_supply + 1] <= t:
        at_supply += 1

    speed_scale = 1e-3
    for i in range(n_command):
        speed_scale = max(speed_scale, abs(_mapped_speed(command[i], mapped[i], row)))
    torque_scale = inertia * speed_scale / _SPIN_UP_TIME
    speed_floor = 0.1 * speed_scale
    current_floor = 0.1 * min(torque_scale / k_m, k_v * speed_scale / res)

    charge = 0.0
    done = at_sample = at_edge = np.int64(0)  # a constant would compile all that takes it once more
    tried = 0
    idle = 0
    status = DONE
    fresh = True
    h = 0.1 * min(ind / res, 0.01)
    side, in_band, over, rising = 1.0, False, False, False

    while True:
        # The voltage is linear in time until the next command or the next knot of the supply.
        level = command[at_command]
        base = k_v * _mapped_speed(level, mapped[at_command], row)
        cold = resistance(level, row)
        t_break = t_end
        if at_command + 1 < n_command:
            t_break = min(t_break, command_time[at_command + 1] + row[DELAY])
        ratio, ratio_rate = supply_ratio[at_supply], 0.0
        if t < supply_time[0]:
            t_break = min(t_break, supply_time[0])
        elif at_supply + 1 < n_supply:
            t_break = min(t_break, supply_time[at_supply + 1])
            ratio_rate = (supply_ratio[at_supply + 1] - ratio) / (
                supply_time[at_supply + 1] - supply_time[at_supply]
            )
            ratio += ratio_rate * (t - supply_time[at_supply])
        t_segment = t
        volt_segment = base * ratio
        volt_rate = base * ratio_rate

        if fresh:
            if start == STEADY:
                current, speed = steady_state(volt_segment, level, row)
                if not (np.isfinite(current) and np.isfinite(speed)):
                    status = NO_STEADY_STATE
                    break
            fresh = False
            in_band = abs(speed) < omega_min
            still_current, still = (current, current, 0.0, 0.0), (speed, speed, 0.0, 0.0)
            clip = t < begin
            done = write_states(times, done, t, t, 0.0, charge, 0.0, clip, still_current, still, out)
            at_sample = write_cubic(samples, at_sample, t, t, 0.0, still, speeds)
            at_edge = write_charge(edges, at_edge, t, t, 0.0, charge, 0.0, clip, still_current, charges)
        if speed == 0.0:
            push = current if current != 0.0 else volt_segment
            side = -1.0 if push < 0.0 else 1.0
        elif side * speed < 0.0:
            side = -side
        quad, lin = _drag(side, row)
        over = abs(current) > i_sat
        drive = side * (k_m * current - (quad * speed + lin) * speed)
        rising = drive > 0.0 or (speed == 0.0 and drive >= 0.0)

        while t < t_break:
            tried += 1
            if tried > most_steps:
                status = TOO_MANY_STEPS
                break
            last = h >= t_break - t
            step = t_break - t if last else h
            volt = volt_segment + volt_rate * (t - t_segment)
            if drop != 0.0 or warming != 0.0:
                longest = max(_TERM_STEP, _TERM_SHARE * (t - t_changed))
                if warming * current * current * longest > _TERM_RISE:
                    longest = max(_TERM_STEP, _TERM_RISE / (warming * current * current))
                step = min(step, longest)
                last = last and step == t_break - t
            # The resistance at the middle of the step, constant in it: exact to the second order in time.
            res = cold * (1.0 + warming * (heat + 0.5 * step * current * current))
            if drop != 0.0:
                more, slope = _dead_time(step, level, current, volt - k_v * speed, res, ind, drop)
                volt, res = volt + more, res + slope
            clip = in_band and over and rising
            limit = i_sat if current > 0.0 else -i_sat
            k_eff = 0.0 if clip else k_m
            clipped = k_m * limit if clip else 0.0
            x, y, ex, ey, x3, y3, x4, y4 = _step(
                step, current, speed, volt, volt_rate, res, ind, k_v, k_eff, clipped, quad, lin, inertia
            )
            ex /= current_floor + max(abs(current), abs(x))
            ey /= speed_floor + max(abs(speed), abs(y))
            error = sqrt(0.5 * (ex * ex + ey * ey)) / tolerance
            if not np.isfinite(error):
                h = 0.1 * step
                if h < 1e-13 * span:
                    status = NOT_FINITE
                    break
                continue
            grow = 6.0 if error < 1e-4 else 0.9 / sqrt(sqrt(error))
            grow = min(6.0, max(0.2, grow))
            if error > 1.0:
                h = step * grow
                if t + h == t:
                    status = STUCK
                    break
                continue

            # An event ends the step: bracket it on the continuous extension, then step onto it for good.
            event = 0
            edge = 0.5
            while edge <= 1.0 and event == 0:
                xs, ys = between(edge, current, x, x3, x4), between(edge, speed, y, y3, y4)
                event = _violation(xs, ys, side, in_band, over, rising, i_sat, omega_min, k_m, quad, lin)
                edge += 0.5
            if event > 0:
                tried += _EVENT
                low, high = 0.0, edge - 0.5
                for _ in range(60):
                    middle = 0.5 * (low + high)
                    xs = between(middle, current, x, x3, x4)
                    ys = between(middle, speed, y, y3, y4)
                    first = _violation(xs, ys, side, in_band, over, rising, i_sat, omega_min, k_m, quad, lin)
                    if first > 0:
                        high = middle
                        event = first
                    else:
                        low = middle
                shorter = high * step
                for attempt in range(5):
                    x, y, ex, ey, x3, y3, x4, y4 = _step(
                        shorter, current, speed, volt, volt_rate, res, ind, k_v, k_eff, clipped, quad, lin,
                        inertia,
                    )  # fmt: skip
                    # One Newton correction at a time, with the exact slope of the event function.
                    dx = (volt + volt_rate * shorter - k_v * y - res * x) / ind
                    dy = (k_eff * x + clipped - (quad * y + lin) * y) / inertia
                    if event == 1:
                        gap, slope, size = y, dy, speed_scale
                    elif event == 2:
                        gap, slope, size = side * y - omega_min, side * dy, speed_scale
                    elif event == 3:
                        gap, slope, size = abs(x) - i_sat, dx if x > 0.0 else -dx, i_sat
                    else:
                        gap = k_m * x - (quad * y + lin) * y
                        slope, size = k_m * dx - (2.0 * quad * y + lin) * dy, torque_scale
                    if attempt == 4 or abs(gap) <= 1e-13 * size or slope == 0.0:
                        break
                    shift = -gap / slope
                    if not abs(shift) < 0.2 * shorter:
                        break
                    shorter += shift
                last = False
                # The regime changes here, the smoothness of the solution does not always: keep the step
                # size unless the event cut it to nothing.
                h = max(shorter, 0.1 * step)
                step = shorter
                idle = idle + 1 if t + step <= t else 0
                if idle > 20:
                    status = STUCK
                    break
            else:
                idle = 0
                h = step * grow if not last else max(h, step * grow)

            t_next = t_break if last else t + step
            flow, turn = (current, x, x3, x4), (speed, y, y3, y4)
            done = write_states(times, done, t, t_next, step, charge, limit, clip, flow, turn, out)
            at_sample = write_cubic(samples, at_sample, t, t_next, step, turn, speeds)
            at_edge = write_charge(edges, at_edge, t, t_next, step, charge, limit, clip, flow, charges)
            charge += step * (limit if clip else integral(1.0, current, x, x3, x4))
            heat += step * (current * current + current * x + x * x) / 3.0
            t, current, speed = t_next, x, y

            if event == 1:
                speed = 0.0
                side = -side
                quad, lin = _drag(side, row)
                rising = side * current > 0.0
            elif event == 2:
                speed = side * omega_min
                in_band = not in_band
                over = abs(current) > i_sat
                rising = side * (k_m * current - (quad * speed + lin) * speed) > 0.0
            elif event == 3:
                over = not over
            elif event == 4:
                rising = not rising

        if status != DONE or t >= t_end:
            break
        while at_command + 1 < n_command and command_time[at_command + 1] + row[DELAY] <= t:
            at_command += 1
            t_changed = t
            # A new command starts a transient of the current: do not begin it with a long step.
            h = min(h, 0.1 * max(ind / res, 1e-4))
        while at_supply + 1 < n_supply and supply_time[at_supply + 1] <= t:
            at_supply += 1

    out[done:, :] = np.nan
    speeds[at_sample:] = np.nan
    charges[at_edge:] = np.nan
    return status, (t - begin) / span, tried


@njit(cache=True, error_model="numpy", nogil=True)
def integrate_population(
    first_job, last_job, rows, delays, drags, mapped, command_time, command, command_first, supply_time,
    supply_ratio, supply_first, samples, edges, first, longest, starts, initial, tolerance, ideal, out,
    status, reached,
):  # fmt: skip
    """Simulate every candidate on every trial: stator torque averaged over each cell, speed at its sample.

    Ragged trials lie end to end; trial j owns ``x[first[j]:first[j + 1]]`` of the samples and of `out`,
    (P, n_total, 2). A trial of n samples, the `longest` at most, has n + 1 `edges`, of which sample i owns
    the cell from edge i to edge i + 1. Jobs, one per candidate and trial, know nothing of each other: the
    number of threads changes no bit of the result.
    """
    n_trials = starts.size
    most_steps = min(MAX_STEPS, CANDIDATE_STEPS // n_trials)
    # Fresh memory for every job would cost as much as the simulation.
    all_speeds, all_charges = np.empty(longest), np.empty(longest + 1)
    for job in range(first_job, last_job):
        i = job // n_trials
        j = job % n_trials
        row = rows[i].copy()
        row[DELAY] += delays[i, j]
        time = samples[first[j] : first[j + 1]]
        edge = edges[first[j] + j : first[j + 1] + j + 1]
        speeds, charges = all_speeds[: time.size], all_charges[: edge.size]
        levels = mapped[command_first[j] : command_first[j + 1]].copy()
        levels[:, 1] *= drags[i]
        code, share, _ = integrate(
            row,
            command_time[command_first[j] : command_first[j + 1]],
            command[command_first[j] : command_first[j + 1]],
            levels,
            supply_time[supply_first[j] : supply_first[j + 1]],
            supply_ratio[supply_first[j] : supply_first[j + 1]],
            time[0], time[time.size - 1], starts[j], initial[j, 0], initial[j, 1], tolerance, ideal,
            most_steps, speeds[:0], np.empty((0, 4)), time, speeds, edge, charges,
        )  # fmt: skip
        status[i, j] = code
        reached[i, j] = share
        k_m, k_d = row[K_M], row[K_D]
        of_trial = out[i, first[j] : first[j + 1]]
        for m in range(time.size):
            mean_current = (charges[m + 1] - charges[m]) / (edge[m + 1] - edge[m])
            of_trial[m, 0] = k_m * mean_current - k_d * speeds[m]
            of_trial[m, 1] = speeds[m]
