"""Errors of a drop's start, and of what is compared, by the capture's noise."""

import numpy as np

from sysid.filters import differentiate
from sysid.gear.drops import PreparedDrop, as_compared
from sysid.types import FloatArray

# Number of samples of noise that pass the filter to show what becomes of noise.
_NOISE_SAMPLES = 20_000
# Longest time before the release over which the hanging body's poses enter the fit of the fall [s].
_HOLD = 2.0


def start_roots(drop: PreparedDrop) -> FloatArray:
    """Return a square root (6, 6) of the covariance of a drop's state at the start of its window [SI].

    Rows are independent changes of one standard deviation: height, instant of the release (or downward speed
    of a body that was thrown), place along x, pitch, and pitch rate; the last row is empty, kept for the
    error of the measured level (`level_error`). From the noise of the flight and the samples that its fit
    saw. A body that was held has no speed, and one that was held level has exactly no pitch.
    """
    flight, motion = drop.flight, drop.motion
    before = motion.valid & (motion.time < drop.touchdown) & np.isfinite(motion.z)
    out = np.zeros((6, 6))
    noise_x, noise_z, noise_q = flight.noise
    if flight.held:
        seen = motion.time[before & (motion.time > flight.start - _HOLD)]
        still = max(1, int(np.count_nonzero(seen < flight.start)))
        fall = np.maximum(0.0, seen - flight.start)
        design = np.column_stack([np.ones_like(fall), flight.gravity * fall])
        covariance = noise_z**2 * np.linalg.inv(design.T @ design + 1e-9 * np.eye(2))
        root = np.linalg.cholesky(covariance).T
        height, late = root.T
        out[:2, 1] = height + late * flight.gravity * max(float(drop.time[0] - flight.start), 0.0)
        out[:2, 4] = late * flight.gravity
        out[2, 0] = noise_x / np.sqrt(len(seen))
        if drop.initial_state[2] != 0.0:
            out[3, 2] = noise_q / np.sqrt(still)
        return out
    seen = motion.time[before & (motion.time >= flight.start - 1e-9)] - flight.start
    design = np.column_stack([np.ones_like(seen), seen])
    root = np.linalg.cholesky(np.linalg.inv(design.T @ design)).T
    out[:2, [1, 4]] = noise_z * root
    out[2, [0, 3]] = noise_x * root[0]
    out[3:5, [2, 5]] = noise_q * root
    return out


def level_error(drop: PreparedDrop) -> float:
    """Return the error of the level from which pitch is measured [rad], which is the mean of the hold."""
    motion, flight = drop.motion, drop.flight
    if not flight.held or drop.initial_state[2] != 0.0:
        return 0.0
    hold = motion.valid & (motion.time < flight.start) & (motion.time > flight.start - _HOLD)
    return float(flight.noise[2]) / float(np.sqrt(max(1, int(np.count_nonzero(hold)))))


def compared_noise(drop: PreparedDrop) -> FloatArray:
    """Return the standard deviation (5,) of the capture's noise in every compared channel [channel units]."""
    return np.sqrt(np.mean(noise_signals(drop) ** 2, axis=0))


def noise_signals(drop: PreparedDrop) -> FloatArray:
    """Return (n, 5) samples [SI] of the capture's noise, filtered and differentiated as the log was."""
    white = np.random.default_rng(0).standard_normal((_NOISE_SAMPLES, 3)) * drop.flight.noise
    taps = drop.target.taps
    if taps is not None:
        white = np.column_stack([np.convolve(white[:, c], taps, "valid") for c in range(3)])
    return as_compared(white, differentiate(white, drop.target.rate))[1:-1]
