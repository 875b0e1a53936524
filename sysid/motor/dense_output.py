"""What a step of the motor's integration leaves behind: states, speeds and charges between its two ends.

The continuous extension of RODAS at the share s of a step is a cubic, its integral a quartic. Where a trial
is sampled ten times per step, as in a search, the samples cost more than the step: they are evaluated as
polynomials in s over all samples of the step at once, which compiles to vector registers.
"""

from numba import njit


@njit(cache=True, error_model="numpy")
def between(s, start, end, c3, c4):
    """Continuous extension at the share s of a step."""
    return (1.0 - s) * start + s * (end + (1.0 - s) * (c3 + s * c4))


@njit(cache=True, error_model="numpy")
def integral(s, start, end, c3, c4):
    """Integral of `between` from 0 to s."""
    q = s * s
    mean = start * (s - 0.5 * q) + 0.5 * end * q
    return mean + c3 * q * (0.5 - s / 3.0) + c4 * q * s * (1.0 / 3.0 - 0.25 * s)


@njit(cache=True, error_model="numpy")
def past(times, first, end):
    """Return the index of the first of `times`, from `first` on, that lies after `end`."""
    while first < times.size and times[first] <= end:
        first += 1
    return first


@njit(cache=True, error_model="numpy")
def write_states(times, first, t, t_next, step, charge, limit, clip, current, speed, out):
    """Fill `out` (n, 4) at the times of one step: current, effective current, speed, charge; return the next.

    `current` and `speed` are (start, end, c3, c4) of the step.
    """
    last = write_cubic(times, first, t, t_next, step, current, out[:, 0])
    write_cubic(times, first, t, t_next, step, speed, out[:, 2])
    write_charge(times, first, t, t_next, step, charge, limit, clip, current, out[:, 3])
    for i in range(first, last):
        out[i, 1] = limit if clip else out[i, 0]
    return last


@njit(cache=True, error_model="numpy")
def write_cubic(times, first, t, t_next, step, state, out):
    """Fill `out` (n,) with one state at the times of one step; return the index of the next time."""
    last = past(times, first, t_next)
    a = state[0]
    b = state[1] - state[0] + state[2]
    c = state[3] - state[2]
    d = -state[3]
    inverse, shift = (1.0 / step, 0.0) if t_next > t else (0.0, 1.0)
    for i in range(first, last):
        s = (times[i] - t) * inverse + shift
        out[i] = a + s * (b + s * (c + s * d))
    return last


@njit(cache=True, error_model="numpy")
def write_charge(times, first, t, t_next, step, charge, limit, clip, current, out):
    """Fill `out` (n,) with the charge since the first time at the times of a step; return the next index."""
    last = past(times, first, t_next)
    a = current[0]
    b = 0.5 * (current[1] - current[0] + current[2])
    c = (current[3] - current[2]) / 3.0
    d = -0.25 * current[3]
    if clip:
        a, b, c, d = limit, 0.0, 0.0, 0.0
    inverse, shift = (1.0 / step, 0.0) if t_next > t else (0.0, 1.0)
    for i in range(first, last):
        s = (times[i] - t) * inverse + shift
        out[i] = charge + step * s * (a + s * (b + s * (c + s * d)))
    return last
