"""What a user may state of landings: how one begins, the cells of a map, impulses, the grid of a study.

Every field is declared here once, for Python and for the command line (`sysid.marks`); when a landing is over
stands in `sysid.landing.outcomes`. The program's help needs these modules, so they import nothing heavy.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Annotated, ClassVar

from sysid.errors import CampaignError
from sysid.landing.outcomes import Rules
from sysid.marks import MORE, Flag, degrees, grid_flag

# Bound of the weighted rms error per step. Landings bounce and are chaotic near the borders between classes:
# `sysid.landing.maps` repeats a map with half of it and marks the cells that change.
LANDING_TOLERANCE = 1e-4
# Slopes [deg] and touchdown speeds [m/s] of the paper's maps.
SLOPES_DEG = tuple(float(slope) for slope in range(46))
SPEEDS = tuple(round(0.05 * step, 2) for step in range(41))
# Commands of the paper's impulse [1]: thrust is cut but not reversed, because a reversal takes too long.
IDLE_COMMAND = 0.1
IMPULSE_COMMAND = 0.8

Pitch = Annotated[float, Flag("Pitch at touchdown, positive down-slope.", unit="deg", panel=MORE)]
Drift = Annotated[float, Flag("Horizontal speed at touchdown, positive down-slope.", unit="m/s", panel=MORE)]


@dataclass(frozen=True)
class Scenario:
    """One touchdown: the lowest foot on the surface, legs at rest, motors at the hover command.

    The surface falls toward +x. Pitch and pitch rate are positive nose-down. Valid without wind; the approach
    itself is not simulated (see `sysid.landing.approach`).
    """

    slope: Annotated[float, Flag("Slope of the surface.", unit="deg")]
    speed: Annotated[float, Flag("Vertical touchdown speed.", unit="m/s", least=0)]
    pitch: Pitch = 0.0
    pitch_rate: Annotated[float, Flag("Pitch rate at touchdown.", unit="rad/s", panel=MORE)] = 0.0
    horizontal_speed: Drift = 0.0

    def __post_init__(self) -> None:
        within = abs(self.slope) < 1.5 and abs(self.pitch - self.slope) < 1.3
        within &= max(self.speed, abs(self.horizontal_speed), abs(self.pitch_rate)) <= 100.0
        if not (all(map(math.isfinite, vars(self).values())) and within and self.speed >= 0):
            raise CampaignError(
                f"landing: slope {math.degrees(self.slope):g} deg, speed {self.speed:g} m/s, pitch "
                f"{math.degrees(self.pitch):g} deg; expected a slope within 85 deg, a downward speed of 0 or "
                "more, no speed above 100 m/s or 100 rad/s, and a body within 74 deg of the slope"
            )


def grid(slopes: Iterable[float], speeds: Iterable[float], **others: float) -> list[Scenario]:
    """Return the scenario of every cell, slopes (n,) [rad] outside, speeds (m,) [m/s] inside."""
    columns = [float(speed) for speed in speeds]
    return [Scenario(float(slope), speed, **others) for slope in slopes for speed in columns]


@dataclass(frozen=True)
class MapSettings:
    """Cells of a map, over increasing slopes [deg] and touchdown speeds [m/s], and how they are computed.

    `tolerance` bounds the weighted rms error of the rates per step; with `check` every landing is repeated
    with half of it, to mark those whose class changes. Pitch [rad] and horizontal speed [m/s] are at
    touchdown.
    """

    slopes_deg: Annotated[tuple[float, ...], grid_flag("--slopes", "0:45:1 deg", "Slopes", "deg")] = (
        SLOPES_DEG
    )
    speeds: Annotated[tuple[float, ...], grid_flag("--speeds", "0:2:0.05", "Touchdown speeds", "m/s")] = (
        SPEEDS
    )
    rules: Rules = field(default_factory=Rules)
    tolerance: float = LANDING_TOLERANCE
    check: Annotated[
        bool,
        Flag(
            "Repeat landings at half the tolerance to mark uncertain cells.",
            "--repeat/--no-repeat",
            panel=MORE,
        ),
    ] = True
    pitch: float = 0.0
    horizontal_speed: float = 0.0

    def __post_init__(self) -> None:
        for name, values in (("slopes", self.slopes_deg), ("speeds", self.speeds)):
            if not values or any(b <= a for a, b in pairwise(values)):
                raise CampaignError(f"landing map: {name} {list(values)}; give increasing numbers")

    def cells(self) -> list[Scenario]:
        """Return the scenario of every cell, slopes outside, speeds inside."""
        slopes = [math.radians(slope) for slope in self.slopes_deg]
        return grid(slopes, self.speeds, pitch=self.pitch, horizontal_speed=self.horizontal_speed)


@dataclass(frozen=True)
class ImpulseSettings:
    """Which impulses are tried, by default as in Figs. 9 and 10.

    A `rear` of None is the paper's, see `rear_pair`. Motors of an `ideal_reversal` have no saturation. A
    second impact is looked for until the `horizon` after the first [s], or as long as landings are simulated.
    The optimum is refined to the step `finest` [s]; 0 keeps the grid's.

    An impulse that takes away less than `worth` of the turn rate is omitted, and all motors reverse at once.
    Low and fast the second impact comes within some 30 ms, and the impulse takes a few per cent away; the
    paper omits it there. A `worth` of 0 takes the smallest turn rate whatever the gain.
    """

    panel: ClassVar[str] = "Impulses"
    delays: Annotated[
        tuple[float, ...], grid_flag("--delays", "0:0.26:0.01", "Delays of the impulse", "s")
    ] = tuple(round(0.01 * k, 2) for k in range(27))
    durations: Annotated[
        tuple[float, ...], grid_flag("--durations", "0:0.16:0.01", "Durations of the impulse", "s")
    ] = tuple(round(0.01 * k, 2) for k in range(17))
    front: Annotated[float, Flag("Command of the front pair in the impulse.")] = IMPULSE_COMMAND
    rear: Annotated[
        float | None,
        Flag(
            "Command of the rear pair in the impulse.",
            default="0.1; with --ideal-reversal the opposite of the front pair's",
        ),
    ] = None
    idle: Annotated[float, Flag("Command of all motors before the impulse.")] = IDLE_COMMAND
    after: Annotated[float, Flag("Command of all motors after the impulse.")] = -1.0
    ideal_reversal: bool = False
    horizon: float = 1.0
    finest: float = 2.5e-3
    worth: Annotated[
        float, Flag("Leave out an impulse that takes less than this share of the turn rate.")
    ] = 0.05
    equal: Annotated[float, Flag("Below this turn rate the attitude decides what is best.", unit="rad/s")] = (
        0.0
    )

    def __post_init__(self) -> None:
        for name, values in (("delays", self.delays), ("durations", self.durations)):
            rising = all(b > a for a, b in pairwise(values))
            if not values or not rising or values[0] < 0:
                raise CampaignError(f"impulse: {name} {list(values)} s; give increasing times from 0 on")
        commands = {"front": self.front, "rear": self.rear_pair, "idle": self.idle, "after": self.after}
        for name, command in commands.items():
            if not abs(command) <= 1.0:
                raise CampaignError(
                    f"impulse: the command {name!r} is {command:g}; give -1 to 1, 1 being full forward"
                )
        if not (self.horizon > 0 and self.finest >= 0 and 0 <= self.worth < 1 and self.equal >= 0):
            raise CampaignError(
                f"impulse: horizon {self.horizon:g} s, finest step {self.finest:g} s, worth {self.worth:g}, "
                f"equal {self.equal:g} rad/s; give a horizon above 0, a worth below 1, nothing negative"
            )

    @property
    def rear_pair(self) -> float:
        """Command of the rear pair while the front pair pushes [1]; by default one of the paper's two ways.

        A reversal takes too long for an impulse, so the rear pair idles (Figs. 9, 10), and the push of the
        front pair also drives the drone off the slope. Motors that reverse at once can pull behind as they
        push in front, "a pure angular impulse" (Fig. 11). The difference is what Fig. 11 shows: with Table
        II's high friction, on every third degree at eight speeds, faster motors land 65 -> 70 cells and flip
        in 35 -> 39 with the rear pair idle, but 65 -> 83 and 35 -> 23 with it at -0.8.
        """
        if self.rear is not None:
            return self.rear
        return -self.front if self.ideal_reversal else IDLE_COMMAND

    @property
    def has_none(self) -> bool:
        """Whether no impulse at all is a pair of the grid; else it is tried besides."""
        return self.delays[0] == self.durations[0] == 0.0

    @property
    def combinations(self) -> int:
        """Pairs of the grid, and no impulse at all."""
        return len(self.delays) * len(self.durations) + (not self.has_none)

    def check_within(self, horizon: float) -> None:
        """Refuse impulses that end when the simulated time [s] is over: often milliseconds were meant."""
        if self.delays[-1] + self.durations[-1] >= horizon:
            raise CampaignError(
                f"impulse: delays up to {self.delays[-1]:g} s and durations up to {self.durations[-1]:g} s, "
                f"but only {horizon:g} s are simulated; both are in seconds: write 0.05 for 50 ms, or raise "
                "--horizon"
            )


@dataclass(frozen=True)
class StudySettings:
    """Grid of a design study, over slopes [deg] and touchdown speeds [m/s], and when a slope is safe.

    Every set also lands with its nose `spread_deg` up and down [deg]; 0: level only. `together` is the two
    changes on a grid instead of one at a time.
    """

    slopes_deg: Annotated[tuple[float, ...], grid_flag("--slopes", "0:60:1 deg", "Slopes", "deg")] = tuple(
        float(slope) for slope in range(61)
    )
    speeds: Annotated[
        tuple[float, ...], grid_flag("--speeds", "0.3,0.6,0.9,1.2", "Touchdown speeds", "m/s")
    ] = (0.3, 0.6, 0.9, 1.2)
    share: Annotated[
        float, Flag("A slope is safe where this share of landings rests within --long.", panel=MORE)
    ] = 0.5
    spread_deg: Annotated[
        float,
        Flag(
            "Land every set also with its nose this much up and down [deg].",
            "--spread",
            read=degrees,
            default="0",
            panel=MORE,
        ),
    ] = 0.0
    together: Annotated[bool, Flag("Vary two parameters on a grid and draw a map.", panel=MORE)] = False
    rules: Rules = field(default_factory=Rules)
    tolerance: float = LANDING_TOLERANCE

    def __post_init__(self) -> None:
        if len(self.slopes_deg) < 2:
            raise CampaignError(
                f"slopes {list(self.slopes_deg)} deg; give two or more, for example 0:60:1deg"
            )
        if not 0.0 < self.share <= 1.0:
            raise CampaignError(f"share of {self.share:g}; give a number above 0, up to 1")
        if not 0.0 <= self.spread_deg <= 20.0:
            raise CampaignError(f"spread of {self.spread_deg:g} deg; give 0 to 20 deg")

    def grids(self) -> list[MapSettings]:
        """Return the landing map of every attitude at touchdown."""
        tilts = [0.0] if self.spread_deg == 0 else [0.0, -self.spread_deg, self.spread_deg]
        level = MapSettings(self.slopes_deg, self.speeds, self.rules, self.tolerance, check=False)
        return [replace(level, pitch=math.radians(tilt)) for tilt in tilts]
