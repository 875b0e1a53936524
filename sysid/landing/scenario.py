"""How a landing begins: at touchdown, level and hovering as in the paper, or tilted and drifting."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import CampaignError
from sysid.landing.drone import Drone
from sysid.types import FloatArray


@dataclass(frozen=True)
class Scenario:
    """One touchdown: the lowest foot on the surface, legs at rest, motors at the hover command.

    Valid without wind; the approach itself is not simulated (see `sysid.landing.approach`).

    Parameters
    ----------
    slope : float
        Of the surface [rad], falling toward +x.
    speed : float
        Vertical touchdown speed [m/s], positive downward.
    pitch : float
        Of the body at touchdown [rad], positive nose-down, which is down-slope.
    pitch_rate : float
        [rad/s].
    horizontal_speed : float
        At touchdown [m/s], positive down-slope.
    """

    slope: float
    speed: float
    pitch: float = 0.0
    pitch_rate: float = 0.0
    horizontal_speed: float = 0.0

    def __post_init__(self) -> None:
        within = abs(self.slope) < 1.5 and abs(self.pitch - self.slope) < 1.3
        if not (all(map(math.isfinite, vars(self).values())) and within and self.speed >= 0):
            raise CampaignError(
                f"landing: slope {math.degrees(self.slope):g} deg, speed {self.speed:g} m/s, pitch "
                f"{math.degrees(self.pitch):g} deg; expected a slope within 85 deg, a downward speed of 0 or "
                "more, and a body within 74 deg of the slope"
            )

    def start(self, drone: Drone) -> FloatArray:
        """Return x_B, z_B, q_B and rates (6,) at touchdown, frame N [m, rad, s]; x_B is 0."""
        turn = self.slope - self.pitch
        depth = drone.value("foot_dx") * abs(math.sin(turn)) + drone.value("foot_dz") * math.cos(turn)
        height = depth / math.cos(self.slope)
        return np.array([0.0, height, self.pitch, self.horizontal_speed, -self.speed, self.pitch_rate])


def grid(slopes: ArrayLike, speeds: ArrayLike, **others: float) -> list[Scenario]:
    """Return the scenario of every cell, slopes (n,) [rad] outside, speeds (m,) [m/s] inside."""
    rows = np.atleast_1d(np.asarray(slopes, dtype=np.float64))
    columns = np.atleast_1d(np.asarray(speeds, dtype=np.float64))
    return [Scenario(float(slope), float(speed), **others) for slope in rows for speed in columns]


def down_slope(position: FloatArray, slope: ArrayLike) -> FloatArray:
    """Return the coordinate down the slope (...) [m] of x and z, the first two entries of (..., >= 2)."""
    angle = np.asarray(slope, dtype=np.float64)
    return np.asarray(position[..., 0] * np.cos(angle) - position[..., 1] * np.sin(angle))
