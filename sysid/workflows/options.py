"""Options of the commands, declared once for the command line and for Python.

`Annotated` gives a field its place on the command line: `Argument` by position, `Flag` by name. A field that
is a dataclass itself contributes its fields. A field with neither is for Python only. `sysid.cli.adapter`
builds the commands from this, so the module imports nothing heavy.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import partial
from itertools import pairwise
from numbers import Integral, Real
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from sysid.errors import CampaignError, ExportError, LogError, SysidError, UnitError
from sysid.journal import notice
from sysid.units import parse_quantity

Options = TypeVar("Options")
# More values than any grid on the command line needs; a slip of the pen asks for billions.
_MOST_VALUES = 100_000


# What one of a unit is in SI, for bare numbers; every other unit in which they are read is an SI unit.
_SI = {"deg": math.pi / 180, "mm": 1e-3}


@dataclass(frozen=True)
class Argument:
    """A field that the command line takes by its position; `help` is what the user reads.

    `read` makes the field's value from what the user gives.
    """

    help: str
    read: Callable[[Any], Any] | None = None


class Flag:
    """A field that the command line takes by its name, ``--name`` of the field or one of `names`.

    The user reads `help`, under the heading `panel` where a command has many options. A field with a `unit`
    takes quantities such as ``"20 deg"``; a bare number is in that unit, and the field's value in SI. `least`
    is the smallest number that is accepted, in that unit. `read` makes the field's value from the text that
    the user gives and the name of the option. The help shows `default`, or the field's default.
    """

    def __init__(
        self,
        help: str,
        *names: str,
        least: float | None = None,
        unit: str = "",
        read: Callable[[str, str], Any] | None = None,
        default: str = "",
        panel: str = "",
    ) -> None:
        self.help, self.names, self.least, self.unit = help, names, least, unit
        self.read, self.default, self.panel = read, default, panel

    def quantity(self, text: str, name: str) -> float:
        """Return what the user gave for the option `name` in SI; `UnitError` where it cannot be used."""
        value = stated_quantity(text, self.unit, name)
        if self.least is not None and value < self.least * _SI.get(self.unit, 1.0):
            raise UnitError(f"{name} {text}: expected {self.least:g} {self.unit} or more")
        return value

    def bare(self, value: float) -> str:
        """Return a value, given in SI, as the bare number that the option reads."""
        return f"{value / _SI.get(self.unit, 1.0):.12g}"

    def shown(self, value: float) -> str:
        """Return a default, given in SI, in the unit of the option."""
        return f"{value / _SI.get(self.unit, 1.0):.6g} {self.unit}"


def stated_quantity(text: str, unit: str, name: str) -> float:
    """Return a quantity such as ``20 deg`` in SI, a bare number from `unit`; a refusal names `name`."""
    try:
        value = float(text) * _SI.get(unit, 1.0)
    except ValueError:
        try:
            value = parse_quantity(text, unit)
        except UnitError as error:
            raise UnitError(f"{name}: {error}; a bare number is in {unit}") from error
    if not math.isfinite(value):
        raise UnitError(f"{name} {text}: expected a finite number; a bare number is in {unit}")
    return value


def seconds(text: str, name: str) -> float:
    """Return a time [s] above 0 from a text such as ``20min``; a lone ``m`` means minutes."""
    try:
        value = parse_quantity(text.replace("m", "min") if text[-1:] == "m" else text, "s")
    except UnitError as error:
        raise SysidError(f"{name} {text}: {error}") from error
    if not value > 0:
        raise SysidError(f"{name} {text}: expected a time above 0, for example 20min")
    return value


def span(text: str, name: str, unit: str = "1") -> tuple[float, ...]:
    """Return ``first:last:step`` or a list ``a,b,c`` as increasing numbers in `unit`.

    A unit stands behind each number, or behind the last one for all: ``0:45:1 deg``. `name` stands in a
    refusal.
    """
    values: list[float] = []
    parts = re.split("[:,]", text)
    behind = parts[-1].strip().lstrip("+-.0123456789eE")
    if behind and len(parts) > 1 and all(_is_number(part) for part in parts[:-1]):
        parts = [*(f"{part} {behind}" for part in parts[:-1]), parts[-1]]
    try:
        # In `unit`, where bare numbers keep every digit.
        numbers = [
            float(part) if _is_number(part) else parse_quantity(part, unit) / _SI.get(unit, 1.0)
            for part in parts
        ]
        if ":" in text:
            first, last, step = numbers
            # Never past `last`; the excess keeps 0:0.3:0.1 whole, whose quotient falls short of 3.
            count = math.floor((last - first) / step + 1e-9) + 1
            values = [first + step * i for i in range(count if count <= _MOST_VALUES else 0)]
        else:
            values = numbers
    except UnitError as error:
        raise CampaignError(f"{name} {text!r}: {error}") from error
    except (ValueError, ZeroDivisionError, OverflowError):
        pass
    rising = all(b > a for a, b in pairwise(values))
    if not values or not rising or not all(math.isfinite(value) for value in values):
        raise CampaignError(f"{name} {text!r}: expected first:last:step or increasing numbers, as in 0:45:1")
    return tuple(round(value, 9) for value in values)


def python_options(cls: type[Options], given: Mapping[str, Any], **fixed: Any) -> Options:
    """Return the options `cls` of a call from Python: names are checked and texts read as on a command line.

    Fields that are option classes themselves take theirs by the same names. `fixed` are fields that the
    caller may not state. Raises `CampaignError` for an unknown name or a value of another kind.
    """
    left = dict(given)
    options: Options = _taken(cls, left, fixed)
    for name in left:
        known = sorted(_option_names(cls) - fixed.keys())
        near = difflib.get_close_matches(name, known, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
        raise CampaignError(f"no option {name!r}; {hint}")
    return options


def _option_names(cls: Any) -> set[str]:
    hints = get_type_hints(cls)
    parts = [(f.name, hints[f.name]) for f in fields(cls)]
    return {n for name, hint in parts for n in (_option_names(hint) if is_dataclass(hint) else {name})}


def _taken(cls: Any, given: dict[str, Any], fixed: Mapping[str, Any]) -> Any:
    """Return the options of a class; what they take of `given` is taken out of it."""
    values, hints = dict(fixed), get_type_hints(cls, include_extras=True)
    for part in fields(cls):
        hint = hints[part.name]
        if part.name in values:
            continue
        if is_dataclass(hint):
            values[part.name] = _taken(hint, given, {})
        elif part.name in given:
            values[part.name] = _read(part.name, given.pop(part.name), hint)
    return cls(**values)


def _read(name: str, value: Any, hint: Any) -> Any:
    """Return the value of an option as Python states it: a text where the command line takes one."""
    plain = get_args(hint)[0] if get_origin(hint) is Annotated else hint
    mark = next((m for m in get_args(hint)[1:] if isinstance(m, Flag)), Flag(""))
    kinds = get_args(plain) if get_origin(plain) in (UnionType, Union) else (plain,)
    choices = [word for kind in kinds if get_origin(kind) is Literal for word in get_args(kind)]
    if value is None and NoneType in kinds:
        return None
    if isinstance(value, str) and (mark.read or mark.unit):
        return mark.read(value, name) if mark.read else mark.quantity(value, name)
    if choices:
        fits, expected = value in choices, f"one of {', '.join(map(repr, choices))}"
    elif Path in kinds:
        value = Path(value) if isinstance(value, str) else value
        fits, expected = isinstance(value, Path), "a path"
    elif bool in kinds:
        fits, expected = isinstance(value, bool), "True or False"
    elif mark.unit == "deg" and isinstance(value, Real) and abs(float(value)) > math.tau:
        raise CampaignError(f"{name} = {value:g}: a bare number is in rad; write {name} = '{value:g} deg'")
    elif int in kinds or float in kinds:
        least = -math.inf if mark.least is None else mark.least * _SI.get(mark.unit, 1.0)
        fits = isinstance(value, Integral if int in kinds else Real) and not isinstance(value, bool)
        fits = fits and math.isfinite(value) and value >= least
        expected = "a whole number" if int in kinds else f"a number in SI, or a text such as '1 {mark.unit}'"
        expected += "" if mark.least is None else f", at least {mark.least:g} {mark.unit}".rstrip()
    else:
        fits, expected = isinstance(value, str), "a text"
    if not fits:
        raise CampaignError(f"{name} = {value!r}: expected {expected}")
    return value


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _span(name: str, default: str, help: str, unit: str) -> Flag:
    help = f"{help} [{unit}]: first:last:step, or a list."
    return Flag(help, name, read=partial(span, unit=unit), default=default)


def campaign_file(path: Path) -> Path:
    """Return a campaign file from its path, or from the folder in which it is ``campaign.toml`` or alone."""
    if not path.is_dir() or (path / "campaign.toml").is_file():
        return path / "campaign.toml" if path.is_dir() else path
    files = sorted(path.glob("*.toml"))
    if len(files) != 1:
        found = ", ".join(file.name for file in files) or "no .toml file"
        raise CampaignError(f"{path}: expected one campaign in this folder, found {found}; name the file")
    return files[0]


def _campaign_named(text: str, name: str) -> Path:
    return campaign_file(Path(text))


def _degrees(text: str, name: str) -> float:
    return round(math.degrees(stated_quantity(text, "deg", name)), 9)


# What lies beside logs and is none.
_NO_LOGS = {".toml", ".json", ".md", ".html", ".pdf", ".png", ".svg", ".py", ".cal"}


def log_files(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    """Return logs, and those in folders by name: every file but hidden ones, campaigns, JSON and pictures.

    Of several files, as ``drops/*`` names them, these are left out as well, and noticed.
    """
    out: list[Path] = []
    for path in paths:
        inside = [path]
        if len(paths) > 1 and path.suffix.lower() in _NO_LOGS and not path.is_dir():
            notice("no-log", f"{path}: a {path.suffix} file is no log; left out")
            continue
        if path.is_dir():
            inside = sorted(
                file for file in path.iterdir()
                if file.is_file() and file.suffix.lower() not in _NO_LOGS and not file.name.startswith(".")
            )  # fmt: skip
            if not inside:
                raise LogError(f"{path}: no log in this folder; name the logs, or the folder that holds them")
        out += inside
    if paths and not out:
        raise LogError(f"{paths[0]}: is no log, nor are the other files; name the logs, or their folder")
    return tuple(out)


_OUTPUT, _COMPUTING, _SEARCH = "Output", "Computing", "Search"
CampaignPath = Annotated[Path, Argument("Campaign file (TOML), or the folder that holds it.", campaign_file)]
Logs = Annotated[tuple[Path, ...], Argument("Logs, or folders of logs.", log_files)]
FitFolder = Annotated[Path, Argument("Fit folder, or its fit.h5.")]
Sets = Annotated[Path, Argument("Fit folder, or file of parameter sets.")]
GearSets = Annotated[Path, Argument("Fit folder or file with the gear sets.")]
Force = Annotated[bool, Flag("Replace what exists.", panel=_OUTPUT)]
Quiet = Annotated[bool, Flag("Print neither progress nor tables.", panel=_OUTPUT)]
Json = Annotated[bool, Flag("Print the result as JSON.", panel=_OUTPUT)]
Strict = Annotated[bool, Flag("End with exit code 3 where the fit is unfinished.", panel=_OUTPUT)]
Resume = Annotated[bool, Flag("Continue a computation that was stopped or killed.", panel=_COMPUTING)]
Dask = Annotated[
    str | None,
    Flag("Compute on a Dask cluster: an address, tcp://host:8786, or the word local.", panel=_COMPUTING),
]
Threads = Annotated[
    int | None,
    Flag("Use this many cores. The result does not depend on it.", least=1, default="all", panel=_COMPUTING),
]
Surface = Annotated[
    str | None, Flag("Use this friction law instead of the campaign's, for example lf or hf.")
]
FitCampaign = Annotated[
    Path | None, Flag("Campaign of the fit, if it has moved since.", "--campaign", read=_campaign_named)
]
SlopeOfGround = Annotated[float, Flag("Slope of the ground (.xml).", "--slope", unit="deg")]
Figure = Annotated[Path | None, Flag("Write a figure to this .png, .pdf or .svg file.", panel=_OUTPUT)]
LogFormat = Annotated[str, Flag("Read the log as this format. By default the content decides.", "--format")]
LoaderOption = Annotated[tuple[str, ...], Flag("Loader option, for example rate=10000.", "--option", "-o")]


@dataclass(frozen=True)
class FitOptions:
    """What a user may state about a fit; it overrides the campaign's `[fit]`.

    `time_limit` [s] counts from the reading of the campaign on. On a Dask cluster every worker process uses
    one core.
    """

    out: Annotated[
        Path | None, Flag("Write the result to this folder.", default="fits/NAME", panel=_OUTPUT)
    ] = None
    force: Force = False
    population: Annotated[
        int | None, Flag("Individuals per generation.", least=8, default="the algorithm's", panel=_SEARCH)
    ] = None
    runs: Annotated[
        int | None, Flag("Number of independent runs.", least=1, default="the campaign's", panel=_SEARCH)
    ] = None
    seed: Annotated[
        int | None, Flag("Seed of the random numbers.", least=0, default="the campaign's", panel=_SEARCH)
    ] = None
    max_generations: Annotated[
        int | None,
        Flag("End every run after this many generations.", least=1, default="the campaign's", panel=_SEARCH),
    ] = None
    time_limit: Annotated[
        float | None,
        Flag("End the fit after this time, as in 20min, and keep its result.", read=seconds, panel=_SEARCH),
    ] = None
    threads: Threads = None
    quiet: Quiet = False
    algorithm: Annotated[
        Literal["ga", "matlab-ga", "cmaes", "de", "pso"] | None,
        Flag("Search algorithm.", default="the campaign's", panel=_SEARCH),
    ] = None
    finish: Annotated[
        Literal["least-squares", "cmaes", "none"] | None,
        Flag(
            "Let this follow every run. 'none' is the paper's method.",
            default="the campaign's",
            panel=_SEARCH,
        ),
    ] = None
    max_evaluations: Annotated[
        int | None, Flag("End the fit after this many candidates.", least=1, panel=_SEARCH)
    ] = None
    resume: Resume = False
    dask: Dask = None
    check: Annotated[bool, Flag("First say what the trials should determine.", "--check/--no-check")] = True

    trust: Annotated[
        bool, Flag("Last find the interval of every parameter, as sysid trust does.", "--trust/--no-trust")
    ] = True

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
    """What a report shows and which further files are written."""

    out: Annotated[
        Path | None,
        Flag("Write the page to this file.", default="FIT/report.html, or beside the map", panel=_OUTPUT),
    ] = None
    against: Annotated[
        Path | None, Flag("Campaign with other trials, which the sets predict.", read=_campaign_named)
    ] = None
    compare: Annotated[Path | None, Flag("Second fit, drawn beside this one.")] = None
    figure: Annotated[Path | None, Flag("Write every figure as PDF to this folder.", panel=_OUTPUT)] = None
    gif: Annotated[
        Path | None, Flag("Write a film of a drop, in 10 × slow motion, as GIF.", panel=_OUTPUT)
    ] = None
    mp4: Annotated[Path | None, Flag("Write the same film as MP4, which needs ffmpeg.", panel=_OUTPUT)] = None
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

    panel: ClassVar[str] = "Motors"
    motor: Annotated[Path, Flag("Fit folder or file with the motor sets.")]
    pair: Annotated[
        Literal["best", "each"],
        Flag("Give every gear set the best motor set, or gear set i the motor set i."),
    ] = "best"
    ideal_reversal: Annotated[bool, Flag("Let the motors reverse without delay.")] = False


@dataclass(frozen=True)
class RulesOptions:
    """When a landing is over; the fields of `sysid.landing.outcomes.Rules`."""

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
ControllerFile = Annotated[Path | None, Flag("Python file with further controllers.")]
Trigger = Annotated[
    Literal["contact", "imu"],
    Flag("The controller starts at the first contact, or when the accelerometer feels it (2 g, 30 Hz)."),
]
Pitch = Annotated[float, Flag("Pitch at touchdown, positive down-slope.", unit="deg")]
Drift = Annotated[float, Flag("Horizontal speed at touchdown, positive down-slope.", unit="m/s")]
ResultFile = Annotated[Path, Flag("Write the result to this HDF5 file.", panel=_OUTPUT)]


@dataclass(frozen=True, kw_only=True)
class TouchdownOptions:
    """How one landing begins and goes on."""

    slope: Annotated[float, Flag("Slope of the surface.", unit="deg")]
    speed: Annotated[float, Flag("Vertical touchdown speed.", unit="m/s", least=0)]
    controller: OneController = "reverse"
    controller_file: ControllerFile = None
    trigger: Trigger = "contact"
    pitch: Pitch = 0.0
    pitch_rate: Annotated[float, Flag("Pitch rate at touchdown.", unit="rad/s")] = 0.0
    horizontal_speed: Drift = 0.0
    height: Annotated[
        float | None, Flag("First descend from this height with attitude control.", unit="m")
    ] = None
    change: Annotated[
        str | None, Flag("Fly a changed design, as in k_t=1.5,dx_f=0.8: factors; reversal_delay=50ms adds.")
    ] = None
    rate: Annotated[float, Flag("Write this many samples per second.", unit="Hz", least=10)] = 1000.0
    rules: RulesOptions = field(default_factory=RulesOptions)


@dataclass(frozen=True, kw_only=True)
class SimulateOptions(TouchdownOptions):
    """``sysid simulate``."""

    sets: GearSets
    motors: MotorOptions
    out: Annotated[Path | None, Flag("Write the histories to this .csv or .h5 file.", panel=_OUTPUT)] = None
    force: Force = False
    json: Json = False


@dataclass(frozen=True)
class MapOptions:
    """What the commands on maps share."""

    sets: Annotated[tuple[Path, ...], Argument("Fit folders or files with gear sets, one a surface.")]
    motors: MotorOptions
    out: ResultFile
    figure: Annotated[
        Path | None, Flag("Write the figure to this file.", default="beside the HDF5 file", panel=_OUTPUT)
    ] = None
    slopes_deg: Annotated[tuple[float, ...], _span("--slopes", "0:45:1", "Slopes", "deg")] = span(
        "0:45:1", "--slopes"
    )
    speeds: Annotated[tuple[float, ...], _span("--speeds", "0:2:0.05", "Touchdown speeds", "m/s")] = span(
        "0:2:0.05", "--speeds"
    )
    repeat: Annotated[
        bool,
        Flag("Repeat landings at half the tolerance to mark uncertain cells.", "--repeat/--no-repeat"),
    ] = True
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

    panel: ClassVar[str] = "Impulses"
    delays: Annotated[tuple[float, ...], _span("--delays", "0:0.26:0.01", "Delays of the impulse", "s")] = (
        span("0:0.26:0.01", "--delays")
    )
    durations: Annotated[
        tuple[float, ...], _span("--durations", "0:0.16:0.01", "Durations of the impulse", "s")
    ] = span("0:0.16:0.01", "--durations")
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
    equal: Annotated[float, Flag("Below this turn rate the attitude decides what is best.", unit="rad/s")] = (
        0.0
    )


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
    slopes_deg: Annotated[tuple[float, ...], _span("--slopes", "0:60:1", "Slopes", "deg")] = span(
        "0:60:1", "--slopes"
    )
    speeds: Annotated[tuple[float, ...], _span("--speeds", "0.3,0.6,0.9,1.2", "Touchdown speeds", "m/s")] = (
        0.3,
        0.6,
        0.9,
        1.2,
    )
    share: Annotated[float, Flag("A slope is safe where this share of landings rests within --long.")] = 0.5
    spread_deg: Annotated[
        float,
        Flag(
            "Land every set also with its nose this much up and down [deg].",
            "--spread",
            read=_degrees,
            default="0",
        ),
    ] = 0.0
    together: Annotated[bool, Flag("Vary two parameters on a grid and draw a map.")] = False
    rules: RulesOptions = field(default_factory=RulesOptions)
    compute: ComputeOptions = field(default_factory=ComputeOptions)
