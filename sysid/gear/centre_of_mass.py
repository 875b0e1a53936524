"""Where a body's centre of mass lies, from how it turns in flight between two contacts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.campaign import GearCampaign
from sysid.filters import runs
from sysid.gear.drops import PreparedDrop
from sysid.journal import notice
from sysid.trials.fall import Feet, SlopedPlane
from sysid.types import FloatArray

# A flight phase tells the centre of mass from this number of samples on, feet this far above the surface [m].
_LEAST_FLIGHT, _CLEAR = 8, 4e-3
# An offset is worth a word beyond this number of standard errors and this length [m].
_SURE, _FAR = 4.0, 3e-3

FlightPhase = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def centre_of_mass(drops: tuple[PreparedDrop, ...], campaign: GearCampaign) -> dict[str, float] | None:
    """Return how far from the stated centre of mass the body turns in flight [m], with errors; warn where
    sure.

    Down-slope and up in the body while it hangs level. None where it flew too little after a contact. Flights
    of some 50 ms tell it to centimetres only: what they look like is then mostly a start's velocity.
    """
    feet = Feet(campaign.vehicle.foot_dx, campaign.vehicle.foot_dz)
    flights = [part for drop in drops for part in _flights(drop, feet)]
    noise = max(float(np.max(drop.flight.noise[:2])) for drop in drops)
    if sum(len(part[0]) for part in flights) < 4 * _LEAST_FLIGHT:
        return None
    offset, error = turning_point(flights, campaign.vehicle.gravity, noise)
    for name, value, sigma in zip(("down-slope", "up"), offset, error, strict=True):
        if abs(value) > max(_SURE * sigma, _FAR):
            notice(
                "centre-of-mass-off",
                f"in free flight the body turns about a point {1000 * value:.1f} ± {1000 * sigma:.1f} mm off "
                f"the stated centre of mass ({name}); check capture.centre_of_mass_offset",
            )
    return {
        "down_slope [m]": float(offset[0]), "down_slope error [m]": float(error[0]),
        "up [m]": float(offset[1]), "up error [m]": float(error[1]),
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
        for signal, columns in (
            (x, np.column_stack([np.cos(q), np.sin(q)])),
            (z + gravity * since**2 / 2, np.column_stack([-np.sin(q), np.cos(q)])),
        ):
            both = np.column_stack([columns, signal])
            left = both - basis @ (basis.T @ both)
            rows.append(left[:, :2])
            values.append(left[:, 2])
    design, target = np.concatenate(rows), np.concatenate(values)
    offset, *_ = np.linalg.lstsq(design, target, rcond=None)
    rest = float(np.sqrt(np.mean((target - design @ offset) ** 2)))
    error = max(noise, rest) * np.sqrt(np.diag(np.linalg.pinv(design.T @ design)))
    return -offset, np.asarray(error)


def _flights(drop: PreparedDrop, feet: Feet) -> list[FlightPhase]:
    """Return (time, x, z, pitch) of the flights after the first contact in which the body turns."""
    motion = drop.motion
    inside = (motion.time > drop.touchdown + 0.02) & (motion.time < drop.time[-1]) & motion.valid
    clear = feet.clearances(SlopedPlane(drop.slope), motion.x, motion.z, motion.pitch).min(axis=1)
    free = inside & (np.nan_to_num(clear, nan=-1.0) > _CLEAR)
    return [
        (motion.time[first:last], motion.x[first:last], motion.z[first:last], motion.pitch[first:last])
        for first, last in runs(free)
        if last - first >= _LEAST_FLIGHT
    ]
