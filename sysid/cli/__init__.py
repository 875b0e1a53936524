"""The command line: options in, one call, one table out.

A refusal is one sentence on standard error and exit code 2; ``--debug`` shows the traceback instead.
"""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from sysid.cli import design as cli_design
from sysid.cli import landing as cli_landing
from sysid.cli import report as cli_report
from sysid.cli import trust as cli_trust
from sysid.cli.options import Dask, Force, Json, Quiet, Resume, Surface, Threads
from sysid.errors import SysidError

app = typer.Typer(
    name="sysid",
    help="Physical parameters of multirotor motors and landing gears from the logs of a lab.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # takes units in brackets for markup and drops them
)
synthesize = typer.Typer(
    help="Write a campaign with known truth in real log formats.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
app.add_typer(synthesize, name="synthesize")
OWN = cli_landing.COMMANDS | cli_design.COMMANDS | cli_trust.COMMANDS | cli_report.COMMANDS
for name, command in OWN.items():
    app.command(name)(command)


class Kind(StrEnum):
    """Kinds of campaign."""

    motor = "motor"
    gear = "gear"


class Algorithm(StrEnum):
    """Search algorithms."""

    ga = "ga"
    matlab_ga = "matlab-ga"
    cmaes = "cmaes"
    de = "de"
    pso = "pso"


class Finish(StrEnum):
    """What follows the search in every run."""

    cmaes = "cmaes"
    none = "none"


class Sense(StrEnum):
    """Which reversals of a log."""

    to_reverse = "to-reverse"
    to_forward = "to-forward"
    both = "both"


class Half(StrEnum):
    """The half of bidirectional DShot that turns forward: 48 to 1047, or 1048 to 2047."""

    low = "low"
    high = "high"


CampaignFile = Annotated[Path, typer.Argument(help="Campaign file (TOML).", show_default=False)]
Out = Annotated[Path | None, typer.Option(help="Result folder.", show_default="fits/NAME")]
Population = Annotated[
    int | None, typer.Option(help="Individuals per generation; default: the algorithm's own.", min=8)
]
Runs = Annotated[int | None, typer.Option(help="Independent runs.", min=1)]
Seed = Annotated[int | None, typer.Option(help="Seed of the search.", min=0)]
Generations = Annotated[int | None, typer.Option(help="End a run after so many generations.", min=1)]
TimeLimit = Annotated[
    str | None, typer.Option(help="End the whole fit after this time (20min); keep what was found.")
]
Algo = Annotated[
    Algorithm | None, typer.Option("--algorithm", help="Search algorithm; overrides the campaign.")
]
Finisher = Annotated[
    Finish | None, typer.Option("--finish", help="CMA-ES after every run, or none: the paper's method.")
]
Check = Annotated[
    bool, typer.Option("--check/--no-check", help="Say first what the trials are expected to fix.")
]
Evaluations = Annotated[int | None, typer.Option(help="Candidates that the whole fit may score.", min=1)]


def say(sentence: str) -> None:
    """Print a sentence on standard error, where it does not mix with results."""
    typer.echo(sentence, err=True)


@app.command("fit-motor")
def fit_motor(
    campaign: CampaignFile,
    out: Out = None,
    force: Force = False,
    population: Population = None,
    runs: Runs = None,
    seed: Seed = None,
    max_generations: Generations = None,
    time_limit: TimeLimit = None,
    threads: Threads = None,
    algorithm: Algo = None,
    finish: Finisher = None,
    max_evaluations: Evaluations = None,
    resume: Resume = False,
    dask: Dask = None,
    check: Check = True,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Fit a motor to thrust-stand and load-cell logs: five ranked parameter sets."""
    from sysid.motor.problem import fit_motor as fit
    from sysid.workflows.search import FitOptions

    options = FitOptions(
        out, force, population, runs, seed, max_generations, _seconds(time_limit), threads, quiet or json,
        algorithm and algorithm.value, finish and finish.value, max_evaluations, resume, dask, check,
    )  # fmt: skip
    _print_fit(*fit(campaign, options, say=None if quiet else say), quiet, json)


@app.command("fit-gear")
def fit_gear(
    campaign: CampaignFile,
    surface: Surface = None,
    out: Out = None,
    force: Force = False,
    population: Population = None,
    runs: Runs = None,
    seed: Seed = None,
    max_generations: Generations = None,
    time_limit: TimeLimit = None,
    threads: Threads = None,
    algorithm: Algo = None,
    finish: Finisher = None,
    max_evaluations: Evaluations = None,
    resume: Resume = False,
    dask: Dask = None,
    check: Check = True,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Fit the landing gear to motion-capture logs of drops: five ranked parameter sets."""
    from sysid.gear.problem import fit_gear as fit
    from sysid.workflows.search import FitOptions

    options = FitOptions(
        out, force, population, runs, seed, max_generations, _seconds(time_limit), threads, quiet or json,
        algorithm and algorithm.value, finish and finish.value, max_evaluations, resume, dask, check,
    )  # fmt: skip
    _print_fit(*fit(campaign, options, surface=surface, say=None if quiet else say), quiet, json)


@app.command("export")
def export_fit(
    fit: Annotated[Path, typer.Argument(help="Fit folder, or a parameter-set file.", show_default=False)],
    to: Annotated[Path, typer.Option(help=".json, .csv, .h5, .mat; .xml, .sdf.", show_default=False)],
    set: Annotated[int | None, typer.Option(help=".xml, .sdf: only the set of this rank.", min=1)] = None,
    slope_deg: Annotated[float, typer.Option(help=".xml: slope of the ground in degrees.")] = 0.0,
    per_leg: Annotated[bool, typer.Option("--per-leg", help=".xml: four single legs in space.")] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write the ranked sets for a simulator, or each as a MuJoCo (.xml) or Gazebo motor (.sdf) model."""
    from sysid.workflows.show import export_sets

    files = export_sets(fit, to, force, rank=set, slope_deg=slope_deg, per_leg=per_leg)
    for file in () if json else files:
        typer.echo(f"wrote {file}")
    if json:
        _print_json({"written": [str(file) for file in files]})


@app.command("show")
def show(
    fit: Annotated[Path, typer.Argument(help="Fit folder, or a parameter-set file.", show_default=False)],
    json: Json = False,
) -> None:
    """Print the ranked sets of a fit: values, spread, bounds, NRMSE."""
    from sysid.workflows.show import print_sets

    print_sets(fit, json)


@app.command("reversal-time")
def reversal_time(
    logs: Annotated[list[Path], typer.Argument(help="Bench logs with reversals.", show_default=False)],
    command_unit: Annotated[str | None, typer.Option(help="us, dshot or 1; the log says.")] = None,
    minimum: Annotated[float | None, typer.Option(help="Full reverse, in that unit.")] = None,
    neutral: Annotated[float | None, typer.Option(help="Rest, in that unit; 1500 us by default.")] = None,
    maximum: Annotated[float | None, typer.Option(help="Full forward, in that unit.")] = None,
    sense: Annotated[Sense, typer.Option(help="Which reversals.")] = Sense.to_reverse,
    slow: Annotated[float, typer.Option(help="Outlier: over so many times the quickest.")] = 1.5,
    thrust_sign: Annotated[float, typer.Option(help="1, or -1: the log's thrust points back.")] = 1.0,
    forward_half: Annotated[Half | None, typer.Option(help="Of bidirectional DShot.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Figure to write: .png, .pdf or .svg.")] = None,
    json: Json = False,
) -> None:
    """Compare speed controllers: time from a reversal command to 90 % of the final thrust."""
    from sysid.workflows.reversal import ReversalOptions, reversal_times

    options = ReversalOptions(
        command_unit, minimum, neutral, maximum, sense.value, slow=slow, thrust_sign=thrust_sign,
        forward_half=forward_half.value if forward_half else None,
    )  # fmt: skip
    reversal_times(logs, options, figure=figure, json=json)


@app.command("fits")
def fits(
    folder: Annotated[Path, typer.Argument(help="Folder of fits.")] = Path("fits"),
    json: Json = False,
) -> None:
    """List the fits of a folder: running, stopped or done, NRMSE, age."""
    from sysid.workflows.fits import print_fits

    print_fits(folder, json)


LoaderFormat = Annotated[
    str, typer.Option("--format", help="Format of the log; judged by content by default.")
]
LoaderOptions = Annotated[
    list[str] | None, typer.Option("--option", "-o", help="Loader option, for example rate=10000.")
]


@app.command("formats")
def list_formats(json: Json = False) -> None:
    """List the log formats that are read, with the options of each."""
    from sysid.workflows.inspect import print_formats

    print_formats(json)


@app.command("inspect")
def inspect(
    files: Annotated[list[Path], typer.Argument(help="Logs.", show_default=False)],
    format: LoaderFormat = "auto",
    option: LoaderOptions = None,
    plot: Annotated[Path | None, typer.Option(help="Figure to write: .png, .pdf or .svg.")] = None,
    json: Json = False,
) -> None:
    """Say what logs hold: device, channels, rates, gaps, drops, and what looks wrong."""
    from sysid.workflows.inspect import inspect_files, parse_options

    inspect_files(files, format_name=format, options=parse_options(option or []), plot=plot, as_json=json)


@app.command("convert")
def convert(
    file: Annotated[Path, typer.Argument(help="Log.", show_default=False)],
    to: Annotated[Path, typer.Argument(help="HDF5 file to write.", show_default=False)],
    format: LoaderFormat = "auto",
    option: LoaderOptions = None,
    add: Annotated[
        Path | None, typer.Option(help="A second log of the same run, with its own clock.")
    ] = None,
    add_format: Annotated[str, typer.Option(help="Format of the second log.")] = "auto",
    add_option: Annotated[
        list[str] | None, typer.Option(help="Loader option of the second log, as --option.")
    ] = None,
    align_by: Annotated[str, typer.Option(help="Channel that both show, or FIRST:SECOND.")] = "speed",
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a log in SI as HDF5, joined with a second one if asked."""
    from sysid.workflows.inspect import SecondFile, convert_file, parse_options

    second = SecondFile(add, add_format, parse_options(add_option or []), align_by) if add else None
    options = parse_options(option or [])
    said = convert_file(file, to, format_name=format, options=options, second=second, force=force)
    _print_json({"written": [str(to)], "said": said}) if json else typer.echo(said)


@app.command("new-campaign")
def new_campaign(
    kind: Annotated[Kind, typer.Argument(help="What was recorded.")],
    path: Annotated[Path, typer.Argument(help="File to write.")] = Path("campaign.toml"),
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a commented campaign file that says how each value is measured."""
    from sysid.workflows.show import write_template

    _wrote(write_template(kind.value, path, force), f"edit it, then: sysid fit-{kind.value} {path}", json)


@synthesize.command("gear")
def synthesize_gear(
    out: Annotated[Path, typer.Argument(help="Folder to write.", show_default=False)],
    surface: Annotated[str, typer.Option(help="Friction law, such as lf or hf.")] = "lf",
    seed: Annotated[int, typer.Option(help="Seed of the noise.", min=0)] = 1,
    noise_mm: Annotated[float, typer.Option(help="Position noise [mm].", min=0)] = 0.3,
    noise_deg: Annotated[float, typer.Option(help="Angle noise [deg].", min=0)] = 0.2,
    rate: Annotated[float, typer.Option(help="Capture rate [Hz].", min=140)] = 200.0,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write drops with known truth as motion-capture logs."""
    from math import radians

    from sysid.synthetic import synthesize_gear as write

    folder = write(
        out, seed=seed, surface=surface, noise_position=noise_mm / 1000,
        noise_angle=radians(noise_deg), rate=rate, force=force,
    )  # fmt: skip
    _wrote(folder, f"next: sysid fit-gear {folder / 'campaign.toml'}", json)


@synthesize.command("motor")
def synthesize_motor(
    out: Annotated[Path, typer.Argument(help="Folder to write.", show_default=False)],
    seed: Annotated[int, typer.Option(help="Seed of the noise.", min=0)] = 1,
    ideal_reversal: Annotated[
        bool, typer.Option("--ideal-reversal", help="A motor without a dead band, as in Fig. 11.")
    ] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write motor tests with known truth as load-cell and thrust-stand logs."""
    from sysid.synthetic import synthesize_motor as write

    folder = write(out, seed=seed, ideal_reversal=ideal_reversal, force=force)
    _wrote(folder, f"next: sysid fit-motor {folder / 'campaign.toml'}", json)


@app.command("demo")
def demo(
    data: Annotated[Path | None, typer.Option(help="The data_samples folder.", show_default="found")] = None,
    out: Annotated[Path, typer.Option(help="Where the results go.")] = Path("fits") / "demo",
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Run the whole job on data_samples: load, filter, fits, exports, figures, reports."""
    from sysid.workflows.demo import run_demo

    run_demo(data, out, quiet, None if quiet else say, json)


@app.command("schema")
def schema(
    name: Annotated[str | None, typer.Argument(help="Of the document; without it, all names.")] = None,
) -> None:
    """Print the JSON Schema of a document that sysid writes: fit, trust, validation, …"""
    from sysid.workflows.schema import print_schema

    print_schema(name)


def _version(value: bool) -> None:
    if value:
        from sysid import __version__

        typer.echo(f"sysid {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of a refusal.")] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


def _seconds(text: str | None) -> float | None:
    from sysid.units import parse_quantity

    if text is None:
        return None
    seconds = parse_quantity(text.replace("m", "min") if text[-1:] == "m" else text, "s")
    if not seconds > 0:
        raise SysidError(f"--time-limit {text}: expected a time above 0, for example 20min")
    return seconds


def _print_json(document: object) -> None:
    from sysid import exact_json

    typer.echo(exact_json.dumps(document))


def _wrote(path: Path, next_step: str, json: bool) -> None:
    if json:
        _print_json({"written": [str(path)], "next": next_step.removeprefix("next: ")})
    else:
        typer.echo(f"wrote {path}; {next_step}")


def _print_fit(result: object, folder: Path, quiet: bool, json: bool) -> None:
    from sysid.workflows.show import print_fit, stopped_by_user

    if json or not quiet:
        print_fit(result, folder, json)
    if stopped_by_user(result):
        raise typer.Exit(130)


def main() -> None:
    """Run the command line; the entry point of ``sysid``."""
    for stream in (sys.stdout, sys.stderr):
        # A Windows console may not be able to write Ω or ²: better a question mark than a traceback.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    debug = "--debug" in sys.argv
    if debug:  # wherever it stands on the line
        sys.argv = [argument for argument in sys.argv if argument != "--debug"]
    try:
        app()
    except SysidError as error:
        if debug:
            raise
        sys.exit(_refuse(str(error)))
    except KeyboardInterrupt:
        typer.echo("stopped by the user", err=True)
        sys.exit(130)


def _refuse(sentence: str) -> int:
    typer.echo(f"error: {' '.join(sentence.split())}", err=True)
    return 2


if __name__ == "__main__":
    main()
