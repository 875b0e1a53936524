"""Find a drop in planar motion: when it was released, when a foot first touched, and its state there.

A drone that an electromagnet releases follows ``z = z_0 - g/2 max(0, t - t_release)²`` until a foot touches:
two numbers that all samples of hold and fall share, so the state at the window's start is known far
better than differentiated positions would tell it (at 0.3 mm noise, 0.2 mm and 2 mm/s instead of 60 mm/s).
"""

from dataclasses import dataclass

import numpy as np
from scipy import optimize

from sysid.errors import LogError
from sysid.filters import bridge_gaps
from sysid.trials.capture import PlanarMotion, SpatialMotion, held_level
from sysid.trials.flight import (
    HALF_WINDOW,
    fall_onset,
    half_window,
    hold_before,
    release_time,
    second_derivative,
)
from sysid.types import FloatArray

# Largest distance [m] and turn [rad] of a body that hangs still from its mean pose, and longest time over
# which that pose is averaged [s]: every simulation starts from it.
_STILL = 2e-3
_STILL_TURN = np.radians(1.5)
_LONGEST_HOLD = 2.0
# Longest ballistic fit before a touchdown [s].
_LOOK_BACK = 0.6


@dataclass(frozen=True)
class Feet:
    """Feet at rest, `dx` to either side of the centre of mass and `dz` below it [m], over a sloped plane.

    The plane passes through the origin and falls toward +x by `slope` [rad].
    """

    dx: float
    dz: float
    slope: float

    @property
    def tangent(self) -> FloatArray:
        """(2,) unit vector down the slope, in x and z."""
        return np.array([np.cos(self.slope), -np.sin(self.slope)])

    def clearances(self, x: FloatArray, z: FloatArray, pitch: FloatArray) -> FloatArray:
        """Return (n, 2): distance of the rear and the front foot above the plane, legs unloaded [m]."""
        cos, sin = np.cos(pitch), np.sin(pitch)
        feet = [
            (x + side * self.dx * cos - self.dz * sin, z - side * self.dx * sin - self.dz * cos)
            for side in (-1.0, 1.0)
        ]
        return np.stack([x * np.sin(self.slope) + z * np.cos(self.slope) for x, z in feet], axis=-1)


@dataclass(frozen=True, eq=False)
class Flight:
    """Hold and free flight up to the first contact.

    `start` is the release [s], or the first sample of the ballistic fit where no hold was seen (`held`);
    `state` (6,) x, z, pitch [m, m, rad] and their rates there; `gravity` the model's and `measured_gravity`
    the fall's [m/s²], NaN where it is too short; `noise` (3,) the RMS of the residuals [m, m, rad].
    """

    start: float
    held: bool
    state: FloatArray
    gravity: float
    measured_gravity: float
    noise: FloatArray

    def at(self, time: FloatArray, *, free: bool = False) -> FloatArray:
        """Return (n, 6) states at `time` [s]: at rest before a release, ballistic before any other start.

        `free` continues the flight backward through the hold: a simulation that starts there, falling
        freely, is on the true flight from `start` on.
        """
        elapsed = np.atleast_1d(time) - self.start
        hangs = self.held and not free
        if hangs:
            elapsed = np.maximum(elapsed, 0.0)
        rates = np.tile(self.state[3:], (len(elapsed), 1))
        rates[:, 1] -= self.gravity * elapsed
        if hangs:
            rates[elapsed == 0.0] = 0.0
        out = self.state[:3] + elapsed[:, None] * self.state[3:]
        out[:, 1] -= 0.5 * self.gravity * elapsed**2
        return np.column_stack([out, rates])


def find_fall(motion: SpatialMotion, gravity: float, where: str, release: float | None = None) -> slice:
    """Return the samples during which the body hung still before its fall; empty where it did not.

    `where` names file and trial for messages; `release` is stated on the log's clock [s]. Raises LogError
    where nothing falls.
    """
    height = bridge_gaps(motion.position[:, 2], motion.valid)
    half = half_window(HALF_WINDOW * motion.rate)
    if len(height) < 4 * half:
        raise LogError(f"{where}: {len(height)} samples are too few for a drop; check the log")
    if release is not None:
        onset = int(np.searchsorted(motion.time, release))
    else:
        downward = -second_derivative(height, half, 1 / motion.rate)
        first = fall_onset(downward, gravity)
        if first is None:
            raise LogError(
                f"{where}: nothing falls in this log (largest downward acceleration "
                f"{downward.max():.1f} m/s², expected {gravity:.2f}); check capture.up, the clock "
                "and the unit of length"
            )
        onset = first
    hold = hold_before(onset, half, motion.rate, height)
    if hold is None or motion.valid[hold].sum() < 3:
        return slice(onset, onset)
    # The body may have hung still for longer than `hold_before` shows: more samples determine its pose
    # better.
    first = max(0, hold.stop - round(_LONGEST_HOLD * motion.rate))
    place = np.nanmean(np.where(motion.valid[hold, None], motion.position[hold], np.nan), axis=0)
    turn = held_level(motion, hold)
    before = slice(first, hold.start)
    away = np.abs(motion.position[before] - place).max(axis=1) > _STILL
    # The trace of the rotation between two attitudes is 1 + 2 cos(angle).
    trace = np.einsum("ij,nij->n", turn, motion.rotation[before])
    turned = trace < 1 + 2 * np.cos(_STILL_TURN)
    moved = np.flatnonzero(motion.valid[before] & (away | turned))
    return slice(first + int(moved[-1]) + 1 if len(moved) else first, hold.stop)


def fit_flight(
    motion: PlanarMotion,
    feet: Feet,
    hold: slice,
    gravity: float,
    where: str,
    level: bool = False,
    end: float = np.inf,
) -> tuple[Flight, float]:
    """Fit hold and free flight; return them and the first contact of a foot with the plane [s].

    `hold` are the samples before the release (`find_fall`); where they are empty, the flight is ballistic
    from there. `level`: the hold defines level, so a body that is released at rest has exactly no pitch. No
    sample from `end` on is in flight, wherever the feet are [s]. Raises LogError when a foot is below the
    surface before the fall, or never reaches it.
    """
    clearance = feet.clearances(motion.x, motion.z, motion.pitch).min(axis=1)
    before, after = clearance[: max(hold.stop, 1)], clearance[hold.stop :]
    lowest = float(np.nanmin(before[-max(1, round(0.1 * motion.rate)) :], initial=np.inf))
    if lowest < 0:
        raise LogError(
            f"{where}: a foot is {-1000 * lowest:.0f} mm below the surface before the drop falls; "
            "check the slope, the surface plane, capture.up, capture.down_slope and the feet"
        )
    contact = np.flatnonzero(after < 0)
    if not len(contact):
        raise LogError(
            f"{where}: no foot reaches the surface, the lowest stays {1000 * np.nanmin(after):.0f} mm above "
            "it, so the surface lies higher or the feet lower than stated, by more than that; check the "
            "slope, the surface plane, capture.up, capture.down_slope and the feet"
        )
    touchdown = float(motion.time[hold.stop + contact[0]])
    for _ in range(3):  # the samples that count depend on the touchdown, which they move by less than one
        flight = _fit(motion, hold, min(touchdown, end), gravity, where, level)
        refined = _contact_time(flight, feet, touchdown)
        if abs(refined - touchdown) < 1e-6:
            break
        touchdown = refined
    return flight, touchdown


def _fit(
    motion: PlanarMotion, hold: slice, touchdown: float, gravity: float, where: str, level: bool
) -> Flight:
    period = 1.0 / motion.rate
    hangs = hold.stop > hold.start
    earliest = motion.time[hold.start] if hangs else max(motion.time[hold.stop], touchdown - _LOOK_BACK)
    use = motion.valid & (motion.time >= earliest - 1e-9) & (motion.time < touchdown - 0.25 * period)
    if use.sum() < 4:
        raise LogError(
            f"{where}: only {use.sum()} samples before the touchdown at {touchdown:.3f} s; "
            f"record from before the release"
        )
    time, coordinates = motion.time[use], motion.coordinates()[use]
    if not hangs:
        elapsed = time - time[0]
        design = np.column_stack([np.ones_like(elapsed), elapsed])
        target = coordinates.copy()
        target[:, 1] += 0.5 * gravity * elapsed**2
        solution, *_ = np.linalg.lstsq(design, target, rcond=None)
        noise = np.std(target - design @ solution, axis=0)
        own = float(-2 * np.polyfit(elapsed, coordinates[:, 1], 2)[0]) if len(time) >= 5 else float("nan")
        state = np.concatenate([solution[0], solution[1]])
        return Flight(float(time[0]), False, state, gravity, own, noise)

    since = time - touchdown
    bounds = (motion.time[hold.stop - 1] - 0.02 - touchdown, -period)
    release = release_time(since, coordinates[:, 1], gravity, bounds, 1e-7)
    elapsed = np.maximum(0.0, since - release)
    origin, rates, noise = np.empty(3), np.zeros(3), np.empty(3)
    height_held = coordinates[:, 1] + 0.5 * gravity * elapsed**2
    origin[1] = np.mean(height_held)
    noise[1] = np.sqrt(np.mean((height_held - origin[1]) ** 2))
    design = np.column_stack([np.ones_like(elapsed), elapsed])
    for column in (0, 2):
        values = coordinates[:, column]
        solution, *_ = np.linalg.lstsq(design, values, rcond=None)
        noise[column] = np.std(values - design @ solution)
        sigma = noise[column] * np.sqrt(np.linalg.inv(design.T @ design)[1, 1])
        # A magnet releases a body at rest, so a rate counts only if it is three times its error.
        if abs(solution[1]) > 3 * sigma:
            origin[column], rates[column] = solution
            # Along axes that lean, a body at rest falls sideways with the square of the time.
            leaning = np.column_stack([np.ones_like(elapsed), elapsed**2])
            square, *_ = np.linalg.lstsq(leaning, values, rcond=None)
            spread = float(np.std(values - leaning @ square))
            if column == 0 and spread < noise[0]:
                origin[0], rates[0], noise[0] = square[0], 0.0, spread
        else:
            origin[column] = 0.0 if level and column == 2 else values.mean()
    measured = float("nan")
    if (elapsed > 0).sum() >= 5:
        height = coordinates[:, 1]

        def with_free_gravity(p: FloatArray) -> FloatArray:
            return np.asarray(p[0] - 0.5 * p[2] * np.maximum(0.0, since - p[1]) ** 2 - height)

        guess = np.array([origin[1], release, gravity])
        measured = float(optimize.least_squares(with_free_gravity, guess, x_scale=[1e-3, 1e-3, 1.0]).x[2])
    return Flight(touchdown + release, True, np.concatenate([origin, rates]), gravity, measured, noise)


def _contact_time(flight: Flight, feet: Feet, guess: float) -> float:
    """Return when the flight model brings a foot to the surface [s]."""

    def clearance(time: float) -> float:
        state = flight.at(np.array([time]))[0]
        return float(feet.clearances(state[:1], state[1:2], state[2:3]).min())

    low, high = flight.start, guess
    while clearance(high) > 0 and high < guess + 0.5:
        high += 0.01
    if clearance(low) <= 0 or clearance(high) > 0:
        return guess
    return float(optimize.brentq(clearance, low, high, xtol=1e-9))
