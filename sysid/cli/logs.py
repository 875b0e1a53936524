"""Commands that read and write logs and campaigns."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from sysid.cli.adapter import command
from sysid.cli.root import app, print_json, print_next, synthesize
from sysid.workflows.options import (
    Argument,
    Figure,
    Flag,
    Force,
    Json,
    LoaderOption,
    LogFormat,
    ReversalOptions,
)

if TYPE_CHECKING:
    from sysid.workflows.inspect import Draw


@command(app, "formats")
def formats(json: Json = False) -> None:
    """List the log formats that are read, with the options of each."""
    from sysid.workflows.inspect import print_formats

    print_formats(json)


@command(app, "inspect")
def inspect(
    files: Annotated[tuple[Path, ...], Argument("Logs.")],
    format: LogFormat = "auto",
    option: LoaderOption = (),
    plot: Figure = None,
    json: Json = False,
) -> None:
    """Say what logs contain: device, channels, rates, gaps, drops, and what looks wrong."""
    from sysid.workflows.inspect import inspect_files, parse_options

    draw = None if plot is None else _drawing(plot)
    inspect_files(files, format_name=format, options=parse_options(option), draw=draw, as_json=json)


def _drawing(path: Path) -> Draw:
    """Return what draws logs to a file; matplotlib is imported only when something is drawn."""
    from sysid.report.drawing import save_figure
    from sysid.report.inspect_figures import figure_logs

    return lambda recordings, reports: save_figure(figure_logs(recordings, reports), path)


@command(app, "convert")
def convert(
    file: Annotated[Path, Argument("Log.")],
    to: Annotated[Path, Argument("HDF5 file to write.")],
    format: LogFormat = "auto",
    option: LoaderOption = (),
    add: Annotated[Path | None, Flag("Join a second log of the same run, which has another clock.")] = None,
    add_format: Annotated[str, Flag("Read the second log as this format.")] = "auto",
    add_option: Annotated[tuple[str, ...], Flag("Give the loader of the second log an option.")] = (),
    align_by: Annotated[str, Flag("Align by this channel of both logs, or by FIRST:SECOND.")] = "speed",
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a log in SI as HDF5, joined with a second one if asked."""
    from sysid.workflows.inspect import SecondFile, convert_file, parse_options

    second = SecondFile(add, add_format, parse_options(add_option), align_by) if add else None
    options = parse_options(option)
    sentence = convert_file(file, to, format_name=format, options=options, second=second, force=force)
    print_json({"written": [str(to)], "sentence": sentence}) if json else typer.echo(sentence)


@command(app, "reversal-time")
def reversal_time(
    logs: Annotated[tuple[Path, ...], Argument("Bench logs with reversals.")],
    options: ReversalOptions,
    figure: Figure = None,
    json: Json = False,
) -> None:
    """Compare speed controllers: time from a reversal command to 90 % of the final thrust."""
    from sysid.workflows.reversal import reversal_times

    reversal_times(logs, options, figure=figure, json=json)


@command(app, "new-campaign")
def new_campaign(
    kind: Annotated[Literal["motor", "gear"], Argument("What was recorded.")],
    path: Annotated[Path, Argument("File to write.")] = Path("campaign.toml"),
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a commented campaign file that says how each value is measured."""
    from sysid.workflows.show import write_template

    print_next(write_template(kind, path, force), f"edit it, then run sysid fit-{kind} {path}", json)


@command(synthesize, "gear")
def synthesize_gear(
    out: Annotated[Path, Argument("Folder to write.")],
    surface: Annotated[str, Flag("Friction law, for example lf or hf.")] = "lf",
    seed: Annotated[int, Flag("Seed of the noise.", least=0)] = 1,
    noise_mm: Annotated[float, Flag("Noise of positions [mm].", least=0)] = 0.3,
    noise_deg: Annotated[float, Flag("Noise of angles [deg].", least=0)] = 0.2,
    rate: Annotated[float, Flag("Rate of the motion capture [Hz].", least=140)] = 200.0,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write drops with known truth as motion-capture logs."""
    from math import radians

    from sysid.synthetic import synthesize_gear as write

    folder = write(
        out, seed=seed, surface=surface, noise_position=noise_mm / 1000, noise_angle=radians(noise_deg),
        rate=rate, force=force,
    )  # fmt: skip
    print_next(folder, f"sysid fit-gear {folder / 'campaign.toml'}", json)


@command(synthesize, "motor")
def synthesize_motor(
    out: Annotated[Path, Argument("Folder to write.")],
    seed: Annotated[int, Flag("Seed of the noise.", least=0)] = 1,
    ideal_reversal: Annotated[bool, Flag("Give the motor no dead band, as in Fig. 11.")] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write motor tests with known truth as load-cell and thrust-stand logs."""
    from sysid.synthetic import synthesize_motor as write

    folder = write(out, seed=seed, ideal_reversal=ideal_reversal, force=force)
    print_next(folder, f"sysid fit-motor {folder / 'campaign.toml'}", json)
