"""What a log says beyond the compared window: where the body comes to rest, about which point it turns.

A start that noise has moved by a tenth of a millimetre ends elsewhere after five bounces, so one simulated
resting place proves nothing. The spread over starts drawn from their uncertainty says what can be known.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict, Unpack

import numpy as np
from scipy import signal

from sysid.campaign import GearCampaign
from sysid.filters import bridge_gaps, runs
from sysid.gear.drops import PreparedDrop
from sysid.gear.model import PARAMETERS, Drops, Ending, Simulation, find_surface, simulate_population
from sysid.gear.starts import start_roots
from sysid.journal import notice
from sysid.types import FloatArray

# Number of starts that are drawn per set.
_STARTS = 20
# The rules of rest.
_REST = Ending()
# Time over which rates of the measurement are taken [s]: differences of single samples are noise.
_SMOOTH = 0.11
# Least number of samples of a flight phase that shows the centre of mass.
_LEAST_FLIGHT = 8
# Least height of the feet in a flight phase [m].
_CLEAR = 4e-3
# Least number of standard errors, and least length [m], of an offset that is noticed.
_SURE, _FAR = 4.0, 3e-3

FlightPhase = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


class StopSpread(TypedDict):
    """A measured number beside the mean and deviation of simulated ones."""

    measured: float
    mean: float
    sigma: float


class Stop(TypedDict):
    """Place [m, down-slope] and time [s] of a drop's end since its first touchdown."""

    place: StopSpread
    time: StopSpread
    # Whether the measured body came to rest, and which share of the simulated ones did [1].
    measured_stops: bool
    share_stops: float


def stopping(
    drop: PreparedDrop, rows: FloatArray, board_length: float | None, **simulation: Unpack[Simulation]
) -> Stop:
    """Return place [m, down-slope] and time [s] of the end of a drop since its first touchdown.

    The end is the beginning of rest (`Ending`), else the end of the log, or where the body leaves the board.
    `rows` (S, n_table) are the sets [SI]; `board_length` counts down-slope from the touchdown [m].
    """
    motion, tangent = drop.motion, drop.feet.tangent
    touch = float(drop.flight.at(np.array([drop.touchdown]))[0, :2] @ tangent)
    last = motion.time[-1]
    if board_length is not None:
        along = np.column_stack([motion.x, motion.z]) @ tangent
        gone = np.flatnonzero((motion.time > drop.touchdown) & (along - touch > board_length))
        last = motion.time[gone[0]] if gone.size else last
    after = motion.time[(motion.time >= drop.time[0]) & (motion.time <= last)]
    measured_time, measured_place, stops = _measured(drop, after)
    roots = start_roots(drop)
    normal = np.random.default_rng(0).standard_normal((len(rows) * _STARTS, len(roots)))
    starts = drop.initial_state + normal @ roots
    many = np.repeat(rows[:, : len(PARAMETERS)], _STARTS, axis=0)
    # Rest is seen once it has lasted: simulated on, it shows up to the end of the log.
    beyond = after[-1] + np.arange(1, round(1.5 * _REST.rest_time * motion.rate) + 1) / motion.rate
    clock = np.concatenate([after, beyond])
    jobs = Drops(np.array([drop.slope]), drop.initial_state[None], (clock,))
    flown = simulate_population(many, jobs, body_states=starts[:, None], **simulation)
    good = flown.status[:, 0] == 0
    length = float(after[-1] - after[0])
    rests = np.nan_to_num(flown.rest[:, 0], nan=np.inf) < length
    end = np.where(rests, flown.rest[:, 0], length)
    since = drop.touchdown - after[0]
    index = np.minimum(np.searchsorted(after - after[0], end), len(after) - 1)
    at = flown.samples[np.arange(len(many)), index, :2] @ tangent

    def spread(measured: float, simulated: FloatArray) -> StopSpread:
        mean, sigma = (simulated.mean(), simulated.std()) if good.any() else (np.nan, np.nan)
        return {"measured": float(measured), "mean": float(mean), "sigma": float(sigma)}

    return {
        "place": spread(measured_place - touch, (at - touch)[good]),
        "time": spread(measured_time - drop.touchdown, (end - since)[good]),
        "measured_stops": stops,
        "share_stops": float(np.mean(rests[good])) if good.any() else float("nan"),
    }


def _measured(drop: PreparedDrop, after: FloatArray) -> tuple[float, float, bool]:
    """Return when [s] and where along the slope [m] the measured body came to rest, and whether it did."""
    motion = drop.motion
    rows = (motion.time >= after[0]) & (motion.time <= after[-1])
    filled = bridge_gaps(motion.coordinates(), motion.valid)[rows]
    width = min(2 * int(_SMOOTH * motion.rate / 2) + 1, len(filled) - 1 + len(filled) % 2)
    smooth, rates = (
        signal.savgol_filter(filled, width, 2, deriv=order, delta=1 / motion.rate, axis=0) for order in (0, 1)
    )
    still = (np.hypot(rates[:, 0], rates[:, 1]) < _REST.rest_speed) & (np.abs(rates[:, 2]) < _REST.rest_turn)
    still &= after > drop.touchdown
    moving = np.flatnonzero(~still)
    first = int(moving[-1]) + 1 if len(moving) else 0
    stops = first < len(after) and after[-1] - after[first] >= _REST.rest_time
    at = first if stops else len(after) - 1
    return float(after[at]), float(smooth[at, :2] @ drop.feet.tangent), bool(stops)


def centre_of_mass(drops: tuple[PreparedDrop, ...], campaign: GearCampaign) -> dict[str, float] | None:
    """Return the point about which the body turns in flight, seen from the stated centre of mass [m].

    Down-slope and up in the body while it hangs level, with errors; an offset that is sure is noticed. None
    where the body flew too little after a contact. Flights of some 50 ms determine the point to centimetres
    only: they mostly show the velocity at their start. Legs with a mass swing on after a contact and take the
    body off its parabola: such a model makes no offset sure.
    """
    flights: list[FlightPhase] = []
    for drop in drops:
        motion = drop.motion
        inside = (motion.time > drop.touchdown + 0.02) & (motion.time < drop.time[-1]) & motion.valid
        clear = drop.feet.clearances(motion.x, motion.z, motion.pitch).min(axis=1)
        free = inside & (np.nan_to_num(clear, nan=-1.0) > _CLEAR)
        tracks = (motion.time, motion.x, motion.z, motion.pitch)
        for first, last in runs(free):
            if last - first >= _LEAST_FLIGHT:
                time, x, z, pitch = (track[first:last] for track in tracks)
                flights.append((time, x, z, pitch))
    noise = max(float(np.max(drop.flight.noise[:2])) for drop in drops)
    if sum(len(part[0]) for part in flights) < 4 * _LEAST_FLIGHT:
        return None
    offset, error = turning_point(flights, campaign.vehicle.gravity, noise)
    massless = "leg_mass" not in find_surface(campaign.surface.law).free
    for name, value, sigma in zip(("down-slope", "up"), offset, error, strict=True):
        if massless and abs(value) > max(_SURE * sigma, _FAR):
            notice(
                "centre-of-mass-off",
                f"in free flight the body turns about a point {1000 * value:.1f} ± {1000 * sigma:.1f} mm off "
                f"the stated centre of mass ({name}); check capture.centre_of_mass_offset and the slope",
            )
    return {
        "down_slope": float(offset[0]), "down_slope_error": float(error[0]),
        "up": float(offset[1]), "up_error": float(error[1]),
    }  # fmt: skip


def turning_point(
    flights: Sequence[FlightPhase], gravity: float, noise: float
) -> tuple[FloatArray, FloatArray]:
    """Return where in the body the point lies that moves on parabolas (2,), and the standard errors (2,) [m].

    Flights are (time, x, z, pitch) of a point of the body [s, m, m, rad], whose positions have a noise [m].

    Notes
    -----
    A point at d from the centre of mass moves as ``c(t) + d_x ex(q) + d_z ez(q)``; c is linear in time but
    for the fall. What is linear in time is taken out of both sides first. The result points from the tracked
    point to the centre of mass.
    """
    rows, values = [], []
    for time, x, z, q in flights:
        since = time - time.mean()
        basis, _ = np.linalg.qr(np.vander(since, 2, increasing=True))
        for track, columns in (
            (x, np.column_stack([np.cos(q), np.sin(q)])),
            (z + gravity * since**2 / 2, np.column_stack([-np.sin(q), np.cos(q)])),
        ):
            both = np.column_stack([columns, track])
            left = both - basis @ (basis.T @ both)
            rows.append(left[:, :2])
            values.append(left[:, 2])
    design, target = np.concatenate(rows), np.concatenate(values)
    offset, *_ = np.linalg.lstsq(design, target, rcond=None)
    rest = float(np.sqrt(np.mean((target - design @ offset) ** 2)))
    error = max(noise, rest) * np.sqrt(np.diag(np.linalg.pinv(design.T @ design)))
    return -offset, np.asarray(error)
