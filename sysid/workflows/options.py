"""Options of the commands: what each one takes, declared once for the command line and for Python.

`sysid.marks` says how a field is declared, and `sysid.cli.adapter` builds the commands from it. What belongs
to landings or to a search is declared with them (`sysid.landing.settings`, `sysid.landing.outcomes`,
`sysid.search_options`). The module imports nothing heavy.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args

from sysid.errors import CampaignError, ExportError, LogError, shell
from sysid.fit.settings import SearchSettings
from sysid.journal import notice
from sysid.landing.outcomes import Rules
from sysid.landing.settings import Drift, ImpulseSettings, MapSettings, Pitch, Scenario, StudySettings
from sysid.marks import MORE, Argument, Flag, field_hints, mark_of
from sysid.search_options import CampaignSearch, SearchOptions

# Suffixes of files in a log folder that are not logs.
_NO_LOGS = {".toml", ".json", ".md", ".html", ".pdf", ".png", ".svg", ".py", ".cal"}
# Names of files that speak about logs.
_ABOUT = {"readme", "license", "licence", "copying", "notice", "changelog"}


def campaign_file(path: Path) -> Path:
    """Return a campaign file from its path, or from the folder in which it is ``campaign.toml`` or alone."""
    if not path.is_dir() or (path / "campaign.toml").is_file():
        return path / "campaign.toml" if path.is_dir() else path
    files = sorted(path.glob("*.toml"))
    if len(files) != 1:
        found, then = ", ".join(file.name for file in files) or "no .toml file", "name the file"
        if not files and any(file.is_file() and not _no_log(file) for file in path.iterdir()):
            command = f"sysid new-campaign gear (or motor) --minimal --from {shell(path)}"
            then = f"write one for the logs in it: {command}"
        raise CampaignError(f"{path}: expected one campaign in this folder, found {found}; {then}")
    return files[0]


def _campaign_named(text: str, name: str) -> Path:
    return campaign_file(Path(text))


def _no_log(path: Path) -> bool:
    suffix = path.suffix.lower()
    return suffix in _NO_LOGS or (suffix in ("", ".txt") and path.stem.lower() in _ABOUT)


def log_files(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    """Return logs, and those in folders by name: every file but hidden ones, campaigns, JSON,
    pictures, licences and files to read.

    Of several files, as ``drops/*`` names them, these are left out as well, and noticed.
    """
    out: list[Path] = []
    for path in paths:
        inside = [path]
        if len(paths) > 1 and _no_log(path) and not path.is_dir():
            notice("no-log", f"{path}: is no log; left out")
            continue
        if path.is_dir():
            inside = sorted(
                file for file in path.iterdir()
                if file.is_file() and not _no_log(file) and not file.name.startswith(".")
            )  # fmt: skip
            if not inside:
                raise LogError(f"{path}: no log in this folder; name the logs, or the folder that holds them")
        out += inside
    if paths and not out:
        raise LogError(f"{paths[0]}: is no log, nor are the other files; name the logs, or their folder")
    return tuple(out)


_OUTPUT, _COMPUTING = "Output", "Computing"
CampaignPath = Annotated[Path, Argument("Campaign file (TOML), or the folder that holds it.", campaign_file)]
OtherCampaign = Annotated[
    Path | None, Argument("Campaign with other trials, or the folder that holds it.", campaign_file)
]
Logs = Annotated[tuple[Path, ...], Argument("Logs, or folders of logs.", log_files)]
FitFolder = Annotated[Path, Argument("Fit folder, or its fit.h5.")]
Sets = Annotated[Path, Argument("Fit folder, or file of parameter sets.")]
GearSets = Annotated[Path, Argument("Fit folder or file with the gear sets.")]
Draws = Annotated[
    int | None,
    Flag("Take this many joint draws of what the data leave open, not the sets.", least=1, panel=MORE),
]
Force = Annotated[bool, Flag("Replace what exists.", panel=_OUTPUT)]
Quiet = Annotated[bool, Flag("Print neither progress nor tables.", panel=_OUTPUT)]
Details = Annotated[bool, Flag("Print every table and what the logs showed.", panel=_OUTPUT)]
Json = Annotated[bool, Flag("Print the result as JSON.", panel=_OUTPUT)]
Strict = Annotated[bool, Flag("End with exit code 3 where the fit is unfinished.", panel=MORE)]
Resume = Annotated[bool, Flag("Continue a computation that was stopped or killed.", panel=_COMPUTING)]
Dask = Annotated[
    str | None, Flag("Compute on a Dask cluster: an address, tcp://host:8786, or the word local.", panel=MORE)
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


Options = TypeVar("Options")


def _overriding(settings: type) -> Callable[[type[Options]], type[Options]]:
    """Return a decorator: a class takes every flag of `settings`, None where the user leaves it out."""

    def extended(cls: type[Options]) -> type[Options]:
        for name, hint in field_hints(settings).items():
            cls.__annotations__[name] = Annotated[get_args(hint)[0] | None, mark_of(hint)]
            setattr(cls, name, None)
        return cls

    return extended


@dataclass(frozen=True)
@_overriding(SearchOptions)
class FitOptions:
    """What a user may state about a fit; options of the search override the campaign's `[fit]`.

    `time_limit` [s] counts from the reading of the campaign on. On a Dask cluster every worker process uses
    one core.
    """

    out: Annotated[
        Path | None, Flag("Write the result to this folder.", default="fits/NAME", panel=_OUTPUT)
    ] = None
    force: Force = False
    threads: Threads = None
    quiet: Quiet = False
    details: Details = False
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

    def search(self, table: CampaignSearch, begun: Mapping[str, Any] | None = None) -> SearchSettings:
        """Return the campaign's search settings with those that the user states instead.

        A fit that goes on keeps the options with which it was `begun`.
        """
        stated = {name: getattr(self, name) for name in field_hints(SearchOptions)}
        return SearchSettings(**{
            **{field.name: getattr(table, field.name) for field in fields(CampaignSearch)},
            **{name: value for name, value in (begun or {}).items() if name in field_hints(CampaignSearch)},
            **{name: value for name, value in stated.items() if value is not None},
        })  # fmt: skip


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
    DShot.
    """

    command_unit: Annotated[str | None, Flag("Unit of the command, if not the log's: us, dshot, 1 or %.")] = (
        None
    )
    minimum: Annotated[float | None, Flag("Command of full reverse, in that unit.")] = None
    neutral: Annotated[float | None, Flag("Command of rest, in that unit. Default for us: 1500.")] = None
    maximum: Annotated[float | None, Flag("Command of full forward, in that unit.")] = None
    sense: Annotated[
        Literal["to-reverse", "to-forward", "both"], Flag("Time the reversals in this direction.")
    ] = "to-reverse"
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
        Flag("Give every gear set the best motor set, or gear set i the motor set i.", panel=MORE),
    ] = "best"
    ideal_reversal: Annotated[bool, Flag("Let the motors reverse without delay.", panel=MORE)] = False
    draws: Draws = None
    anyway: Annotated[bool, Flag("Take sets of a fit that does not predict.", panel=MORE)] = False


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
ControllerFile = Annotated[Path | None, Flag("Python file with further controllers.", panel=MORE)]
Trigger = Annotated[
    Literal["contact", "imu"],
    Flag(
        "The controller starts at the first contact, or when the accelerometer feels it (2 g, 30 Hz).",
        panel=MORE,
    ),
]
ResultFile = Annotated[Path, Flag("Write the result to this HDF5 file.", panel=_OUTPUT)]


@dataclass(frozen=True, kw_only=True)
class TouchdownOptions:
    """How one landing begins and goes on."""

    begin: Scenario
    controller: OneController = "reverse"
    controller_file: ControllerFile = None
    trigger: Trigger = "contact"
    height: Annotated[
        float | None, Flag("First descend from this height with attitude control.", unit="m")
    ] = None
    change: Annotated[
        str | None,
        Flag("Fly a changed design, as in k_t=1.5,dx_f=0.8: factors; reversal_delay=50ms adds.", panel=MORE),
    ] = None
    rate: Annotated[float, Flag("Write this many samples per second.", unit="Hz", least=10, panel=MORE)] = (
        1000.0
    )
    rules: Rules = field(default_factory=Rules)


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
    grid: MapSettings = field(default_factory=MapSettings)
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
    experiments: Annotated[Path | None, Flag("Draw the real landings of this CSV file too.", panel=MORE)] = (
        None
    )
    pitch: Pitch = 0.0
    horizontal_speed: Drift = 0.0


@dataclass(frozen=True)
class ImpulseMapOptions(MapOptions):
    """``sysid impulse-map``."""

    impulses: ImpulseSettings = field(default_factory=ImpulseSettings)


@dataclass(frozen=True)
class DesignStudyOptions:
    """``sysid design-study``."""

    sets: GearSets
    motors: MotorOptions
    vary: Annotated[
        str,
        Flag(
            "Factors first:last:count in equal ratios, as in k_t=0.5:2:5,dx_f=0.8:1.4:4; "
            "reversal_delay=0ms:200ms:5 adds, in equal steps."
        ),
    ]
    out: ResultFile
    controller: OneController = "reverse"
    controller_file: ControllerFile = None
    study: StudySettings = field(default_factory=StudySettings)
    compute: ComputeOptions = field(default_factory=ComputeOptions)
