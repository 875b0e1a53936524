"""Signs and zeros that a bench log does not state: of torque and thrust against the rotation.

Knows no motor model, only that a propeller's drag and thrust have the sign of its speed and grow with its
square. Used where the sign convention of an instrument is unknown and nothing was recorded at rest.
"""

from __future__ import annotations

import numpy as np

from sysid.trials.bench_log import Tare
from sysid.types import FloatArray

# A zero is read from steady points at this many different speeds (one more where both directions turn), if in
# one direction the fastest is this many times the slowest.
_SPEEDS, _SPAN = 3, 1.3


def zero_of_steady(values: FloatArray, speed: FloatArray) -> Tare | None:
    """Return the value at standstill of steady values (n,) against their speeds (n,), or None.

    Valid where the values grow with Ω|Ω|, with one factor per direction: a propeller thrusts twice
    as hard forward. Ignores a linear term, whose share passes into the zero. None where the speeds are too
    few, or in each direction too close to each other.
    """
    known = np.isfinite(values) & np.isfinite(speed) & (speed != 0)
    y, omega = values[known], speed[known]
    sides = [side for side in (omega > 0, omega < 0) if side.any()]
    size = np.abs(omega)
    if np.unique(omega).size < _SPEEDS - 1 + len(sides) or not any(
        size[side].max() >= _SPAN * size[side].min() for side in sides
    ):
        return None
    square = omega * size / float(size.max()) ** 2
    columns = np.column_stack([*(square * side for side in sides), np.ones(omega.size)])
    solution = np.linalg.lstsq(columns, y, rcond=None)[0]
    residual = y - columns @ solution
    spread = float(residual @ residual) / max(y.size - len(solution), 1)
    error = float(np.sqrt(spread * np.linalg.inv(columns.T @ columns)[-1, -1]))
    return Tare(float(solution[-1]), error, 0, "steady points over Ω|Ω|")


def sign_against_speed(values: FloatArray, speed: FloatArray) -> int:
    """Return -1 where values (n,) oppose their speeds (n,) on balance, else +1; 0: nothing tells.

    A propeller's drag has the sign of its speed, so the torque of a stand that reads it otherwise is flipped.
    """
    known = np.isfinite(values) & np.isfinite(speed) & (speed != 0)
    total = float(np.sum(values[known] * speed[known]))
    return int(np.sign(total))


def sign_of_log(values: tuple[FloatArray, FloatArray], speed: tuple[FloatArray, FloatArray]) -> int:
    """Return the sign of a channel (times, values) against a speed, transients included; 0: nothing tells.

    Serves logs without a steady stretch. Over a whole log the air takes more than the rotor gives back.
    """
    if not values[0].size or not speed[0].size:
        return 0
    return sign_against_speed(values[1], np.interp(values[0], *speed))
