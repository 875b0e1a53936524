"""Commands that read and write logs and campaigns."""

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

from sysid.cli.adapter import command
from sysid.cli.root import app, print_json, print_next, synthesize
from sysid.errors import shell
from sysid.marks import Argument, Flag
from sysid.workflows.options import (
    Details,
    Figure,
    Force,
    Json,
    LoaderOption,
    LogFormat,
    Logs,
    ReversalOptions,
    log_files,
)

SynthesizedFolder = Annotated[Path, Flag("Folder to write.", "--out")]


@command(app, "formats", "sysid formats")
def formats(json: Json = False) -> None:
    """List the log formats that are read, with their options."""
    from sysid.workflows.inspect import print_formats

    print_formats(json)


@command(app, "inspect", "sysid inspect data_samples/motor/forward-1.csv")
def inspect(
    logs: Logs,
    format: LogFormat = "auto",
    option: LoaderOption = (),
    figure: Figure = None,
    details: Details = False,
    json: Json = False,
) -> None:
    """Say what logs contain, and what looks wrong in them.

    Device, channels, rates, gaps; of a drop its release, touchdown and slope.
    """
    from sysid.workflows.inspect import inspect_files, parse_options

    draw = None
    if figure is not None:
        # matplotlib is imported only when something is drawn.
        from sysid.report.drawing import save_figure
        from sysid.report.inspect_figures import figure_logs

        draw = lambda recordings, reports: save_figure(figure_logs(recordings, reports), figure)  # noqa: E731
    inspect_files(
        logs, format_name=format, options=parse_options(option), draw=draw, details=details, as_json=json
    )


@command(app, "convert", "sysid convert data_samples/motor/forward-1.csv --out forward-1.h5")
def convert(
    file: Annotated[Path, Argument("Log.")],
    out: Annotated[Path, Flag("HDF5 file to write.", panel="Output")],
    format: LogFormat = "auto",
    option: LoaderOption = (),
    add: Annotated[Path | None, Flag("Join a second log of the same run, which has another clock.")] = None,
    add_format: Annotated[str, Flag("Read the second log as this format.")] = "auto",
    add_option: Annotated[tuple[str, ...], Flag("Give the loader of the second log an option.")] = (),
    align_by: Annotated[str, Flag("Align by this channel of both logs, or by FIRST:SECOND.")] = "speed",
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a log in SI as HDF5, joined with a second one."""
    from sysid.workflows.inspect import SecondFile, convert_file, parse_options

    second = SecondFile(add, add_format, parse_options(add_option), align_by) if add else None
    options = parse_options(option)
    sentence = convert_file(file, out, format_name=format, options=options, second=second, force=force)
    print_json({"written": [str(out)], "sentence": sentence}) if json else typer.echo(sentence)


@command(app, "reversal-time", "sysid reversal-time data_samples/motor/reversal-1.h5")
def reversal_time(logs: Logs, options: ReversalOptions, figure: Figure = None, json: Json = False) -> None:
    """Time speed controllers from command to reverse thrust.

    Says the time to 90 % of the final thrust, and how often a reversal fails.
    """
    from sysid.workflows.reversal import print_reversal_times

    print_reversal_times(logs, options, figure=figure, json=json)


@command(
    app, "new-campaign", "sysid new-campaign gear --minimal --from data_samples/gear-lf --out drops.toml"
)
def new_campaign(
    kind: Annotated[Literal["motor", "gear"], Argument("What was recorded.")],
    logs: Annotated[tuple[Path, ...] | None, Argument("More logs after --from LOG.")] = None,
    out: Annotated[Path, Flag("File to write.")] = Path("campaign.toml"),
    minimal: Annotated[bool, Flag("Write only what a fit needs, as --from does.")] = False,
    source: Annotated[
        tuple[Path, ...], Flag("Fill in what these logs say: a log or a folder.", "--from")
    ] = (),
    format: LogFormat = "auto",
    option: LoaderOption = (),
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a campaign file that describes your recordings.

    The whole file says how each value is measured. The minimal one has what a fit needs, filled in from the
    logs where they say it; what only you can measure stands there as TODO, which is refused. A format and
    loader options that the logs need, as `sysid inspect` prints them, are written into it.
    """
    from sysid.workflows.inspect import parse_options
    from sysid.workflows.new_campaign import write_new_campaign

    given = log_files((*source, *(logs or ())))
    options = parse_options(option) | ({} if format == "auto" else {"format": format})
    written = write_new_campaign(kind, out, given, minimal=minimal, options=options, force=force)
    print_next(written, f"edit it, then run sysid check {shell(out)} and sysid fit-{kind} {shell(out)}", json)


@command(synthesize, "gear", "sysid synthesize gear --out my-drops")
def synthesize_gear(
    out: SynthesizedFolder,
    surface: Annotated[str, Flag("Friction law, for example lf or hf.")] = "lf",
    seed: Annotated[int, Flag("Seed of the noise.", least=0)] = 1,
    noise_position: Annotated[float, Flag("Noise of positions.", unit="mm", least=0)] = 0.3 / 1000,
    noise_angle: Annotated[float, Flag("Noise of angles.", unit="deg", least=0)] = math.radians(0.2),
    rate: Annotated[float, Flag("Rate of the motion capture.", unit="Hz", least=140)] = 200.0,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write drops with known truth as motion-capture logs."""
    from sysid.synthetic import synthesize_gear as write

    folder = write(
        out, seed=seed, surface=surface, noise_position=noise_position, noise_angle=noise_angle, rate=rate,
        force=force,
    )  # fmt: skip
    print_next(folder, shell("sysid", "fit-gear", folder / "campaign.toml"), json)


@command(synthesize, "motor", "sysid synthesize motor --out my-motor")
def synthesize_motor(
    out: SynthesizedFolder,
    seed: Annotated[int, Flag("Seed of the noise.", least=0)] = 1,
    ideal_reversal: Annotated[bool, Flag("Let the motors reverse without delay.")] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write motor tests with known truth as bench logs."""
    from sysid.synthetic import synthesize_motor as write

    folder = write(out, seed=seed, ideal_reversal=ideal_reversal, force=force)
    print_next(folder, shell("sysid", "fit-motor", folder / "campaign.toml"), json)
