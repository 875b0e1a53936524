"""The program `sysid` itself, before any command registers with it, and what the commands print alike."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

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


def say(sentence: str) -> None:
    """Print a sentence on standard error, where it does not mix with results."""
    typer.echo(sentence, err=True)


def unless(silent: bool) -> Callable[[str], None] | None:
    """Return `say`, or None where nothing is to be printed."""
    return None if silent else say


def print_json(document: object) -> None:
    """Print a result as JSON."""
    from sysid import exact_json

    typer.echo(exact_json.dumps(document))


def print_next(path: Path, next_step: str, json: bool) -> None:
    """Print where a campaign was written and what comes next."""
    if json:
        print_json({"written": [str(path)], "next": next_step})
    else:
        typer.echo(f"wrote {path}; next: {next_step}")
