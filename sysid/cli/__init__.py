"""The command line: options in, one call, one table out.

A refusal is one sentence on standard error and exit code 2; ``--debug`` shows the traceback instead.
"""

from __future__ import annotations

import sys

import typer

from sysid.cli.root import app
from sysid.errors import SysidError

# The modules register their commands when they are imported, in the order of `sysid --help`.
from sysid.cli import logs, fits, landing  # noqa: F401  # isort: skip


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
        typer.echo(f"error: {' '.join(str(error).split())}", err=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
