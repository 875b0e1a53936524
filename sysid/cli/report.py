"""The command that makes a fit readable: one page, figures for a paper, films."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.options import Force, Json, Quiet


def report(
    fit: Annotated[Path, typer.Argument(help="Fit folder.", show_default=False)],
    against: Annotated[
        Path | None, typer.Option(help="Campaign of other trials, for the sets to predict.")
    ] = None,
    pdf_figures: Annotated[Path | None, typer.Option(help="Folder for vector figures.")] = None,
    gif: Annotated[Path | None, typer.Option(help="Film of a drop to write, 10 × slow motion.")] = None,
    mp4: Annotated[Path | None, typer.Option(help="The same as MP4; needs ffmpeg.")] = None,
    drop: Annotated[str | None, typer.Option(help="Drop of the film.", show_default="the steepest")] = None,
    out: Annotated[Path | None, typer.Option(help="Page to write.", show_default="FIT/report.html")] = None,
    force: Force = False,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Write a fit's report: one HTML page that needs nothing else."""
    from sysid.errors import ExportError
    from sysid.workflows.report import ReportOptions, print_report

    for option, path in (("--gif", gif), ("--mp4", mp4)):
        if path is not None and path.suffix.lower() != f".{option[2:]}":
            raise ExportError(f"{path}: {option} writes a .{option[2:]} file; name it so")
    films = tuple(path for path in (gif, mp4) if path is not None)
    options = ReportOptions(out, against, pdf_figures, films, drop, force)
    print_report(fit, options, json, None if quiet or json else _say)


COMMANDS: dict[str, Callable[..., None]] = {"report": report}


def _say(sentence: str) -> None:
    typer.echo(sentence, err=True)
