"""What became of a landing: at rest near by, at rest further off, flipped, or otherwise.

The paper prints no rule for "at rest" and "flipped"; these are options, with the defaults below, and travel
with every result.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sysid.errors import CampaignError
from sysid.gear.model import Ending
from sysid.types import BoolArray, FloatArray


class Outcome(IntEnum):
    """Classes of a landing, as Fig. 8 colours them."""

    SHORT = 0
    NEAR = 1
    FLIPPED = 2
    OTHER = 3
    LOST = 4

    @property
    def text(self) -> str:
        """Say what it means."""
        return _MEANINGS[self]


_MEANINGS = (
    "at rest within the short distance",
    "at rest within the long distance",
    "flipped within the long distance (A)",
    "neither: still moving, or beyond the long distance (B)",
    "the simulation failed",
)


# The classes that a landing can have; LOST is a failure of the simulator.
OUTCOMES = (Outcome.SHORT, Outcome.NEAR, Outcome.FLIPPED, Outcome.OTHER)
LANDED = (Outcome.SHORT, Outcome.NEAR)
# Simulated time of a landing [s]; more is a slip of the pen.
LONGEST_HORIZON = 100.0


@dataclass(frozen=True)
class Rules:
    """When a landing is over, and what it is called.

    Parameters
    ----------
    horizon : float
        Simulated time from touchdown [s].
    short, long : float
        Distances along the slope that divide the classes [m]: the paper's board and its 1 m.
    rest_speed : float
        At rest while the body's speed stays below this [m/s] ...
    rest_turn : float
        ... and its turn rate below this [rad/s] ...
    rest_time : float
        ... for this long [s], after the controller's last command.
    flip_angle : float
        Flipped when the body's pitch differs from the slope by more [rad].

    Notes
    -----
    On low friction a drone at rest creeps, at 0.016 m/s on 15 deg and 0.11 m/s on 22 deg (the friction law
    has no stiction), hence a `rest_speed` well above numerical noise.
    """

    horizon: float = 3.0
    short: float = 0.45
    long: float = 1.0
    rest_speed: float = 0.05
    rest_turn: float = 0.2
    rest_time: float = 0.2
    flip_angle: float = math.radians(80.0)

    def __post_init__(self) -> None:
        numbers = asdict(self)
        wrong = [name for name, value in numbers.items() if not 0 < value < math.inf]
        if wrong:
            raise CampaignError(f"landing rules: {wrong[0]} is {numbers[wrong[0]]:g}; give a number above 0")
        if self.horizon > LONGEST_HORIZON:
            raise CampaignError(
                f"landing rules: a horizon of {self.horizon:g} s; landings are over within seconds, so give "
                f"at most {LONGEST_HORIZON:g} s"
            )
        if not self.short <= self.long:
            raise CampaignError(
                f"landing rules: the short distance {self.short:g} m exceeds the long one {self.long:g} m; "
                "swap them"
            )

    def ending(self, at: Literal["clock", "rest", "both feet"]) -> Ending:
        """Return the rules in the form that the kernel takes."""
        return Ending(at, self.rest_speed, self.rest_turn, self.rest_time, self.flip_angle)

    def classes(
        self, distance: FloatArray, rest: FloatArray, flip: FloatArray, lost: BoolArray
    ) -> NDArray[np.int8]:
        """Return the `Outcome` codes (...) of landings.

        `distance` is the displacement of the body's centre of mass down the slope when the landing was over
        [m]. `rest` and `flip` are the times when it came to rest and flipped [s], NaN where it did not; the
        earlier one counts. `lost` is whether the simulation failed.
        """
        far = np.abs(distance)
        flipped = np.isfinite(flip) & ~(rest < flip)
        rested = np.isfinite(rest) & ~flipped
        out = np.full(np.shape(distance), Outcome.OTHER, dtype=np.int8)
        out[rested & (far <= self.long)] = Outcome.NEAR
        out[rested & (far <= self.short)] = Outcome.SHORT
        out[flipped & (far <= self.long)] = Outcome.FLIPPED
        out[np.asarray(lost)] = Outcome.LOST
        return out
