"""What became of a landing: at rest near by, at rest further off, flipped, or otherwise.

The paper prints no rule for "at rest" and "flipped"; these are options, with the defaults below, and travel
with every result.
"""

import math
from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import Annotated, ClassVar

from sysid.errors import CampaignError
from sysid.marks import Flag


class Outcome(IntEnum):
    """Classes of a landing, as Fig. 8 colours them."""

    SHORT = 0
    NEAR = 1
    FLIPPED = 2
    OTHER = 3
    LOST = 4


# Meanings of the classes in their order, in the words of a file.
MEANINGS = (
    "at rest within the short distance",
    "at rest within the long distance",
    "flipped within the long distance (A)",
    "neither: still moving, or beyond the long distance (B)",
    "the simulation failed",
)
# The classes that a landing can have; LOST is a failure of the simulator.
OUTCOMES = (Outcome.SHORT, Outcome.NEAR, Outcome.FLIPPED, Outcome.OTHER)
LANDED = (Outcome.SHORT, Outcome.NEAR)
# Longest simulated time of a landing [s]; more is a slip of the pen.
LONGEST_HORIZON = 100.0


@dataclass(frozen=True)
class Rules:
    """When a landing is over, and what it is called.

    On low friction a drone at rest creeps, at 0.016 m/s on 15 deg and 0.11 m/s on 22 deg (the friction law
    has no stiction), hence a `rest_speed` well above numerical noise. A drone rests only after the
    controller's last command. The distances are the paper's board and its 1 m.
    """

    panel: ClassVar[str] = "When a landing is over"
    horizon: Annotated[float, Flag("Simulate this time from the touchdown on.", unit="s")] = 3.0
    short: Annotated[float, Flag("Short distance that divides the classes.", unit="m")] = 0.45
    long: Annotated[float, Flag("Long distance that divides the classes.", unit="m")] = 1.0
    rest_speed: Annotated[float, Flag("A drone at rest is slower than this.", unit="m/s")] = 0.05
    rest_turn: Annotated[float, Flag("A drone at rest turns more slowly than this.", unit="rad/s")] = 0.2
    rest_time: Annotated[float, Flag("A drone is at rest when it stays slow this long.", unit="s")] = 0.2
    flip_angle: Annotated[
        float, Flag("A drone that leans further from the slope has flipped.", unit="deg")
    ] = math.radians(80.0)

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
