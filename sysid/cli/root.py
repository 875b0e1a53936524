"""The program `sysid` itself, before any command registers with it, and what the commands print alike."""

import re
import shutil
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from sysid.errors import printable

# The commands in the order of work; `sysid --help` lists them so.
GROUPS = {
    "Start": ("demo", "new-campaign", "synthesize"),
    "Look": ("inspect", "convert", "formats", "reversal-time", "codes"),
    "Fit": ("check", "fit", "fit-motor", "fit-gear", "show", "report"),
    "Trust": ("trust", "validate", "compare", "explain"),
    "Use": (
        "export", "simulate", "static-limits", "landing-map", "impulse-map", "design-study", "schema",
    ),
}  # fmt: skip
# The exit code of a result that calls for a look.
FLAGGED = 3
# The exit code after the reader of a pipe has closed it: that of programs which SIGPIPE ends.
CLOSED_PIPE = 141
EXIT_CODES = {
    0: "done",
    1: "a bug of sysid; the line names the file with its trace",
    2: "refused: one sentence says what, where, and what to do next",
    FLAGGED: "flagged by check or validate; an unfinished fit with --strict",
    130: "stopped with Ctrl-C or SIGTERM",
    CLOSED_PIPE: "the reader of a pipe closed it",
}
_CODES = "\n".join(f"  {code:<4} {meaning}" for code, meaning in EXIT_CODES.items())
_EPILOG = f"""Quantities carry a unit, as in --slope "20 deg" and --speed "0.5 m/s"; a bare number is in the
unit that the help names, but an angle needs its unit. --plugin FILE.py behind any command names a Python
file with a model of your own. COMMAND -h explains a command and ends with an example.

\b
Exit codes:
{_CODES}"""


class _Program(TyperGroup):
    """The program, whose help lists the commands in the order of work."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the groups of commands; typer calls this."""
        for group, names in GROUPS.items():
            known = {name: self.commands[name] for name in names if name in self.commands}
            with formatter.section(group):
                formatter.write_dl([(f"{n:<14}", str(c.help).partition("\n")[0]) for n, c in known.items()])


app = typer.Typer(
    name="sysid",
    cls=_Program,
    help="Physical parameters of multirotor motors and landing gears from the logs of a lab.",
    epilog=_EPILOG,
    context_settings={"help_option_names": ["-h", "--help"]},
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # takes units in brackets for markup and drops them
)
synthesize = typer.Typer(
    help="Write a campaign with known truth, to try everything on.",
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
    text = printable(sentence)
    if sys.stderr.isatty():
        text = textwrap.fill(text, shutil.get_terminal_size().columns, break_on_hyphens=False)
        # The code of a warning, which `sysid codes` explains, is dim.
        text = re.sub(r"\[[a-z0-9-]+\]$", lambda code: typer.style(code[0], dim=True), text)
    typer.echo(text, err=True)


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
