"""The first-order lag of `sysid.motor.simpler`, exact between commands, for a whole population."""

from math import exp, log

from numba import njit

# Parameters that the equation reads, by name: the layout of a kernel's row.
READS = (
    "rise_time_constant",
    "fall_time_constant",
    "command_delay",
    *(f"steady_speed_{power}_{way}" for way in ("forward", "reverse") for power in range(3)),
    *(f"torque_{name}_{way}" for way in ("forward", "reverse") for name in ("quadratic", "linear")),
)
_RISE, _FALL = READS.index("rise_time_constant"), READS.index("fall_time_constant")
_DELAY = READS.index("command_delay")
# Column of p0 of Ω_ss(u) = s (p0 + p1 |u| + p2 u²), s = sign u, in either direction.
_STEADY, _STEADY_REVERSE = READS.index("steady_speed_0_forward"), READS.index("steady_speed_0_reverse")
# Column of c2 of either direction; c1 follows.
_TORQUE = READS.index("torque_quadratic_forward")
_TORQUE_REVERSE = READS.index("torque_quadratic_reverse")


@njit(cache=True, error_model="numpy")
def _steady(u, row):
    if u == 0.0:
        return 0.0
    k = _STEADY if u > 0.0 else _STEADY_REVERSE
    size = abs(u)
    speed = max(0.0, row[k] + row[k + 1] * size + row[k + 2] * size * size)
    return speed if u > 0.0 else -speed


@njit(cache=True, error_model="numpy")
def _advance(speed, target, duration, rise, fall, step, rise_kept, fall_kept):
    """Return the speed after `duration` under a constant target, exactly, through zero if need be.

    `rise_kept`, `fall_kept`: what is left of a distance to the target after one `step` of a uniform grid. A
    grid's differences are rounded, so a duration within 1e-9 of the step is the step.
    """
    if speed * target < 0.0:
        # The fall ends where the speed passes zero.
        until = fall * log((speed - target) / (-target))
        if duration <= until:
            return target + (speed - target) * exp(-duration / fall)
        duration -= until
        speed = 0.0
    rising = abs(target) > abs(speed)
    if abs(duration - step) <= 1e-9 * step:
        kept = rise_kept if rising else fall_kept
    else:
        kept = exp(-duration / (rise if rising else fall))
    return target + (speed - target) * kept


@njit(cache=True, error_model="numpy", nogil=True)
def lag_population(
    first_job, last_job, rows, delays, command_time, command, command_first, supply_time, supply_ratio,
    supply_first, time, first, out,
):  # fmt: skip
    n_trials = first.size - 1
    for job in range(first_job, last_job):
        i = job // n_trials
        j = job % n_trials
        row = rows[i]
        rise, fall, delay = row[_RISE], row[_FALL], row[_DELAY] + delays[i, j]
        instants = command_time[command_first[j] : command_first[j + 1]]
        levels = command[command_first[j] : command_first[j + 1]]
        knots = supply_time[supply_first[j] : supply_first[j + 1]]
        ratios = supply_ratio[supply_first[j] : supply_first[j + 1]]
        at, near = 0, 0
        t = time[first[j]]
        step = time[min(first[j] + 1, first[j + 1] - 1)] - t
        rise_kept, fall_kept = exp(-step / rise), exp(-step / fall)
        speed = 0.0
        for m in range(first[j], first[j + 1]):
            end = time[m]
            while near + 1 < knots.size and knots[near + 1] <= end:
                near += 1
            ratio = ratios[near]
            while at + 1 < instants.size and instants[at + 1] + delay <= end:
                turn = max(t, instants[at + 1] + delay)
                if m > first[j]:
                    speed = _advance(
                        speed, _steady(levels[at], row) * ratio, turn - t, rise, fall, step, rise_kept,
                        fall_kept,
                    )  # fmt: skip
                    t = turn
                at += 1
            target = _steady(levels[at], row) * ratio
            if m == first[j]:
                # The trial begins at a steady state, as the motor's equations do.
                speed = target
            else:
                speed = _advance(speed, target, end - t, rise, fall, step, rise_kept, fall_kept)
            t = end
            k = _TORQUE if speed >= 0.0 else _TORQUE_REVERSE
            out[i, m, 0] = (row[k] * abs(speed) + row[k + 1]) * speed
            out[i, m, 1] = speed
