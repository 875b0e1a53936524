"""Options of the commands, declared once for the command line and for Python.

`Annotated` gives a field its place on the command line: `Argument` by position, `Flag` by name. A field that
is a dataclass itself contributes its fields. A field with neither is for Python only. `sysid.cli.adapter`
builds the commands from this, so the module imports nothing heavy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

from sysid.errors import CampaignError, ExportError, LogError, SysidError, UnitError
from sysid.units import parse_quantity

# More values than any grid on the command line needs; a slip of the pen asks for billions.
_MOST_VALUES = 100_000


@dataclass(frozen=True)
class Argument:
    """A field that the command line takes by its position; `help` is what the user reads."""

    help: str


class Flag:
    """A field that the command line takes by its name, ``--name`` of the field or one of `names`.

    The user reads `help`. `least` is the smallest number that is accepted. `read` makes the field's value
    from what the user gives, which is of the type `given`. The help shows `default`, or the field's default.
    """

    def __init__(
        self,
        help: str,
        *names: str,
        least: float | None = None,
        read: Callable[[Any], Any] | None = None,
        given: type = float,
        default: str = "",
    ) -> None:
        self.help, self.names, self.least = help, names, least
        self.read, self.given, self.default = read, given, default


def seconds(text: str) -> float:
    """Return a time limit [s] above 0 from a text such as ``20min``; a lone ``m`` means minutes."""
    try:
        value = parse_quantity(text.replace("m", "min") if text[-1:] == "m" else text, "s")
    except UnitError as error:
        raise SysidError(f"--time-limit {text}: {error}") from error
    if not value > 0:
        raise SysidError(f"--time-limit {text}: expected a time above 0, for example 20min")
    return value


def span(text: str, what: str) -> tuple[float, ...]:
    """Return ``first:last:step`` or a list ``a,b,c`` as increasing numbers; `what` is named in a refusal."""
    values: list[float] = []
    try:
        if ":" in text:
            first, last, step = (float(part) for part in text.split(":"))
            # Never past `last`; the excess keeps 0:0.3:0.1 whole, whose quotient falls short of 3.
            count = math.floor((last - first) / step + 1e-9) + 1
            values = [first + step * i for i in range(count if count <= _MOST_VALUES else 0)]
        else:
            values = [float(part) for part in text.split(",")]
    except (ValueError, ZeroDivisionError, OverflowError):
        pass
    rising = all(b > a for a, b in pairwise(values))
    if not values or not rising or not all(math.isfinite(value) for value in values):
        raise CampaignError(f"{what} {text!r}: expected first:last:step or increasing numbers, as in 0:45:1")
    return tuple(round(value, 9) for value in values)


def _span(name: str, default: str, help: str) -> Flag:
    return Flag(help, name, read=partial(span, what=name), given=str, default=default)


def _degrees(name: str, help: str, default: str = "") -> Flag:
    return Flag(help, name, read=math.radians, default=default)


CampaignPath = Annotated[Path, Argument("Campaign file (TOML).")]
FitFolder = Annotated[Path, Argument("Fit folder.")]
Sets = Annotated[Path, Argument("Fit folder, or file of parameter sets.")]
GearSets = Annotated[Path, Argument("Fit folder or file with the gear sets.")]
Force = Annotated[bool, Flag("Replace what exists.")]
Quiet = Annotated[bool, Flag("Print neither progress nor tables.")]
Json = Annotated[bool, Flag("Print the result as JSON.")]
Resume = Annotated[bool, Flag("Continue a computation that was stopped or killed.")]
Dask = Annotated[
    str | None, Flag("Compute on a Dask cluster: an address, tcp://host:8786, or the word local.")
]
Threads = Annotated[int | None, Flag("Use this many cores. The result does not depend on it.", least=1)]
Surface = Annotated[
    str | None, Flag("Use this friction law instead of the campaign's, for example lf or hf.")
]
FitCampaign = Annotated[Path | None, Flag("Campaign of the fit, if it has moved since.", "--campaign")]
SlopeOfGround = Annotated[float, _degrees("--slope-deg", "Slope of the ground [deg] (.xml).", "0")]
Figure = Annotated[Path | None, Flag("Write a figure to this .png, .pdf or .svg file.")]
LogFormat = Annotated[str, Flag("Read the log as this format. By default the content decides.", "--format")]
LoaderOption = Annotated[tuple[str, ...], Flag("Loader option, for example rate=10000.", "--option", "-o")]


@dataclass(frozen=True)
class FitOptions:
    """What a user may state about a fit beside the campaign; it overrides the campaign's `[fit]`.

    `time_limit` [s] counts from the reading of the campaign on. On a Dask cluster every worker process uses
    one core.
    """

    out: Annotated[Path | None, Flag("Write the result to this folder.", default="fits/NAME")] = None
    force: Force = False
    population: Annotated[
        int | None, Flag("Individuals per generation. The algorithm has a default.", least=8)
    ] = None
    runs: Annotated[int | None, Flag("Number of independent runs.", least=1)] = None
    seed: Annotated[int | None, Flag("Seed of the random numbers.", least=0)] = None
    max_generations: Annotated[int | None, Flag("End every run after this many generations.", least=1)] = None
    time_limit: Annotated[
        float | None,
        Flag("End the fit after this time, for example 20min, and keep its result.", read=seconds, given=str),
    ] = None
    threads: Threads = None
    quiet: Quiet = False
    algorithm: Annotated[
        Literal["ga", "matlab-ga", "cmaes", "de", "pso"] | None,
        Flag("Use this search algorithm instead of the campaign's."),
    ] = None
    finish: Annotated[
        Literal["least-squares", "cmaes", "none"] | None,
        Flag("Let this follow every run. 'none' is the paper's method."),
    ] = None
    max_evaluations: Annotated[int | None, Flag("End the fit after this many candidates.", least=1)] = None
    resume: Resume = False
    dask: Dask = None
    check: Annotated[bool, Flag("First say what the trials should determine.", "--check/--no-check")] = True

    def __post_init__(self) -> None:
        if self.dask is not None:
            object.__setattr__(self, "threads", 1)

    def folder(self, name: str) -> Path:
        """Return where a fit called `name` goes."""
        return self.out if self.out is not None else Path("fits") / name


@dataclass(frozen=True)
class TrustOptions:
    """How a fit is assessed: its campaign, the bootstrap over trials, where it is computed."""

    campaign: FitCampaign = None
    resamples: Annotated[int, Flag("Resamples of the bootstrap over trials. 0 leaves it out.", least=0)] = 100
    seed: Annotated[int, Flag("Seed of the bootstrap.", least=0)] = 1
    threads: Threads = None
    dask: Dask = None


@dataclass(frozen=True)
class ReportOptions:
    """What a report shows and which files are written beside it."""

    out: Annotated[Path | None, Flag("Write the page to this file.", default="FIT/report.html")] = None
    against: Annotated[Path | None, Flag("Campaign with other trials, which the sets predict.")] = None
    pdf_figures: Annotated[Path | None, Flag("Write vector figures to this folder.")] = None
    gif: Annotated[Path | None, Flag("Write a film of a drop, in 10 × slow motion, as GIF.")] = None
    mp4: Annotated[Path | None, Flag("Write the same film as MP4, which needs ffmpeg.")] = None
    drop: Annotated[str | None, Flag("Show this drop in the film.", default="the steepest")] = None
    force: Force = False

    def __post_init__(self) -> None:
        for name, path in (("gif", self.gif), ("mp4", self.mp4)):
            if path is not None and path.suffix.lower() != f".{name}":
                raise ExportError(f"{path}: --{name} writes a .{name} file; name it so")

    @property
    def films(self) -> tuple[Path, ...]:
        """The films to write."""
        return tuple(path for path in (self.gif, self.mp4) if path is not None)


@dataclass(frozen=True)
class ReversalOptions:
    """How logs with reversals are read.

    `minimum`, `neutral` and `maximum` are full reverse, rest and full forward in the log's command unit.
    Their defaults are 1000, 1500 and 2000 µs, or -1, 0 and 1. `forward_half` replaces them for bidirectional
    DShot. Fast logs are low-passed with the stop-band edge `stop_edge` [Hz].
    """

    command_unit: Annotated[str | None, Flag("Unit of the command, if not the log's: us, dshot or 1.")] = None
    minimum: Annotated[float | None, Flag("Command of full reverse, in that unit.")] = None
    neutral: Annotated[float | None, Flag("Command of rest, in that unit. Default for us: 1500.")] = None
    maximum: Annotated[float | None, Flag("Command of full forward, in that unit.")] = None
    sense: Annotated[
        Literal["to-reverse", "to-forward", "both"], Flag("Time the reversals in this direction.")
    ] = "to-reverse"
    stop_edge: float = 100.0
    slow: Annotated[float, Flag("A reversal slower than this multiple of the fastest is an outlier.")] = 1.5
    thrust_sign: Annotated[float, Flag("1, or -1 where the log's thrust is positive in reverse.")] = 1.0
    forward_half: Annotated[
        Literal["low", "high"] | None,
        Flag("Half of bidirectional DShot that turns forward: low is 48 to 1047, high is 1048 to 2047."),
    ] = None

    def __post_init__(self) -> None:
        if abs(self.thrust_sign) != 1.0:
            raise LogError(
                f"--thrust-sign {self.thrust_sign:g}: it turns thrust and does not scale it; expected 1 or -1"
            )
        if not 1.0 < self.slow < math.inf:
            raise LogError(
                f"--slow {self.slow:g}: how many times slower than the quickest an outlier is; expected more "
                "than 1, for example 1.5"
            )


@dataclass(frozen=True)
class MotorOptions:
    """The motors of a drone that lands."""

    motor: Annotated[Path, Flag("Fit folder or file with the motor sets.")]
    pair: Annotated[
        Literal["best", "each"],
        Flag("Give every gear set the best motor set, or gear set i the motor set i."),
    ] = "best"
    ideal_reversal: Annotated[bool, Flag("Let the motors reverse without delay.")] = False


@dataclass(frozen=True)
class RulesOptions:
    """When a landing is over; the fields of `sysid.landing.outcomes.Rules`."""

    horizon: Annotated[float, Flag("Simulate this time from the touchdown on [s].")] = 3.0
    short: Annotated[float, Flag("Short distance that divides the classes [m].")] = 0.45
    long: Annotated[float, Flag("Long distance that divides the classes [m].")] = 1.0
    rest_speed: Annotated[float, Flag("A drone at rest is slower than this [m/s].")] = 0.05
    rest_turn: Annotated[float, Flag("A drone at rest turns more slowly than this [rad/s].")] = 0.2
    rest_time: Annotated[float, Flag("A drone is at rest when it stays slow for this time [s].")] = 0.2
    flip_angle: Annotated[
        float, _degrees("--flip-deg", "A drone that leans further from the slope has flipped [deg].", "80")
    ] = math.radians(80.0)


@dataclass(frozen=True)
class ComputeOptions:
    """How a long computation runs, and what is printed of it."""

    force: Force = False
    resume: Resume = False
    dask: Dask = None
    threads: Threads = None
    quiet: Quiet = False
    json: Json = False


OneController = Annotated[
    str, Flag("off, reverse, command:U, impulse:delay=50ms,duration=0.1, or the name of another controller.")
]
ControllerFile = Annotated[Path | None, Flag("Python file with further controllers.", "--controllers")]
Trigger = Annotated[
    Literal["contact", "imu"],
    Flag("The controller starts at the first contact, or when the accelerometer feels it (2 g, 30 Hz)."),
]
Pitch = Annotated[float, _degrees("--pitch-deg", "Pitch at touchdown, positive down-slope [deg].", "0")]
Drift = Annotated[float, Flag("Horizontal speed at touchdown, positive down-slope [m/s].")]
ResultFile = Annotated[Path, Flag("Write the result to this HDF5 file.")]
_SLOPES, _SPEEDS = "Slopes [deg]: first:last:step, or a list.", "Touchdown speeds [m/s], in the same way."


@dataclass(frozen=True)
class SimulateOptions:
    """``sysid simulate``."""

    sets: GearSets
    motors: MotorOptions
    slope: Annotated[float, _degrees("--slope-deg", "Slope of the surface [deg].")]
    speed: Annotated[float, Flag("Vertical touchdown speed [m/s].", least=0)]
    controller: OneController = "reverse"
    controller_file: ControllerFile = None
    trigger: Trigger = "contact"
    pitch: Pitch = 0.0
    pitch_rate: Annotated[float, Flag("Pitch rate at touchdown [rad/s].")] = 0.0
    horizontal_speed: Drift = 0.0
    height: Annotated[float | None, Flag("First descend from this height with attitude control [m].")] = None
    rate: Annotated[float, Flag("Write this many samples per second [Hz].", least=10)] = 1000.0
    out: Annotated[Path | None, Flag("Write the histories to this .csv or .h5 file.")] = None
    force: Force = False
    json: Json = False
    rules: RulesOptions = field(default_factory=RulesOptions)


@dataclass(frozen=True)
class MapOptions:
    """What the commands on maps share."""

    sets: Annotated[tuple[Path, ...], Argument("Fit folders or files with gear sets, one a surface.")]
    motors: MotorOptions
    out: ResultFile
    figure: Annotated[Path | None, Flag("Write the figure to this file.", default="beside the HDF5 file")] = (
        None
    )
    slopes_deg: Annotated[tuple[float, ...], _span("--slopes", "0:45:1", _SLOPES)] = span("0:45:1", "slopes")
    speeds: Annotated[tuple[float, ...], _span("--speeds", "0:2:0.05", _SPEEDS)] = span("0:2:0.05", "speeds")
    no_check: Annotated[
        bool, Flag("Do not repeat landings at half the tolerance to mark uncertain cells.")
    ] = False
    rules: RulesOptions = field(default_factory=RulesOptions)
    compute: ComputeOptions = field(default_factory=ComputeOptions)

    @property
    def picture(self) -> Path:
        """Where the figure goes."""
        return self.figure or self.out.with_suffix(".png")


@dataclass(frozen=True)
class LandingMapOptions(MapOptions):
    """``sysid landing-map``."""

    controllers: Annotated[
        tuple[str, ...],
        Flag(
            "off, reverse, command:U, impulse:delay=50ms,duration=0.1, or the name of another controller. "
            "Repeat it for several.",
            "--controller",
            default="off and reverse",
        ),
    ] = ("off", "reverse")
    controller_file: ControllerFile = None
    trigger: Trigger = "contact"
    experiments: Annotated[Path | None, Flag("Draw the real landings of this CSV file too.")] = None
    pitch: Pitch = 0.0
    horizontal_speed: Drift = 0.0


@dataclass(frozen=True)
class ImpulseOptions:
    """Which impulses are tried; fields of `sysid.landing.impulse.ImpulseSettings`."""

    delays: Annotated[tuple[float, ...], _span("--delays", "0:0.26:0.01", "Delays of the impulse [s].")] = (
        span("0:0.26:0.01", "delays")
    )
    durations: Annotated[
        tuple[float, ...], _span("--durations", "0:0.16:0.01", "Durations of the impulse [s].")
    ] = span("0:0.16:0.01", "durations")
    front: Annotated[float, Flag("Command of the front pair in the impulse.")] = 0.8
    rear: Annotated[
        float | None,
        Flag(
            "Command of the rear pair in the impulse.",
            default="0.1; with --ideal-reversal the opposite of the front pair's",
        ),
    ] = None
    idle: Annotated[float, Flag("Command of all motors before the impulse.")] = 0.1
    after: Annotated[float, Flag("Command of all motors after the impulse.")] = -1.0
    worth: Annotated[
        float, Flag("Leave out an impulse that takes less than this share of the turn rate.")
    ] = 0.05
    equal: Annotated[float, Flag("Below this turn rate the attitude decides what is best [rad/s].")] = 0.0


@dataclass(frozen=True)
class ImpulseMapOptions(MapOptions):
    """``sysid impulse-map``."""

    impulses: ImpulseOptions = field(default_factory=ImpulseOptions)


@dataclass(frozen=True)
class DesignStudyOptions:
    """``sysid design-study``."""

    sets: GearSets
    motors: MotorOptions
    vary: Annotated[
        str,
        Flag("Factors first:last:count, as in k_t=0.5:2:5,dx_f=0.8:1.4:4; reversal_delay=0ms:200ms:5 adds."),
    ]
    out: ResultFile
    controller: OneController = "reverse"
    controller_file: ControllerFile = None
    slopes_deg: Annotated[tuple[float, ...], _span("--slopes", "0:60:1", _SLOPES)] = span("0:60:1", "slopes")
    speeds: Annotated[tuple[float, ...], _span("--speeds", "0.3,0.6,0.9,1.2", _SPEEDS)] = (0.3, 0.6, 0.9, 1.2)
    share: Annotated[float, Flag("A slope is safe where this share of landings rests within --long.")] = 0.5
    spread_deg: Annotated[float, Flag("Land every set also with its nose this much up and down [deg].")] = 0.0
    together: Annotated[bool, Flag("Vary two parameters on a grid and draw a map.")] = False
    rules: RulesOptions = field(default_factory=RulesOptions)
    compute: ComputeOptions = field(default_factory=ComputeOptions)
