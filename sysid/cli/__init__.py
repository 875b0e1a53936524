"""The command line: options in, one call, one table out.

A refusal is one sentence on standard error and exit code 2, of a wrong option too. An exception that nobody
foresaw is one as well, with exit code 1, and its trace is in a file. ``--debug`` shows the traceback instead.
A reader that closes the pipe, as ``head`` does, ends a command in silence.
"""

import gc
import os
import shlex
import sys
import tempfile
import traceback
from contextlib import suppress
from copy import copy
from typing import Any

import typer

from sysid.cli.root import CLOSED_PIPE, app, say
from sysid.errors import SysidError, printable
from sysid.journal import heard_warnings

# The modules register their commands when they are imported, in the order of `sysid --help`.
from sysid.cli import logs, fits, landing  # noqa: F401  # isort: skip


# Class of the exceptions for a wrong command line; newer versions of typer bring their own click.
_UsageError: Any = typer.BadParameter.__mro__[1]


def main() -> None:
    """Run the command line; the entry point of ``sysid``."""
    # Modules that load make no garbage, and looking for it among them takes a tenth of a start.
    gc.set_threshold(20_000)
    # Plugins of pydantic are none of ours; it would look for them in every installed package.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    out = sys.stdout
    for stream in (out, sys.stderr):
        # A Windows console may not be able to write Ω or ²: better a question mark than a traceback.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    debug = "--debug" in sys.argv
    if debug:  # anywhere on the line
        sys.argv = [argument for argument in sys.argv if argument != "--debug"]
    code: int | str | None = 0
    refusal = ""
    try:
        with heard_warnings(lambda sentence: say(f"warning: {sentence}")):
            # typer builds every command with all its options: only the one that is asked for, where one is.
            program = copy(app)
            if asked := [one for one in app.registered_commands if [one.name] == sys.argv[1:2]]:
                program.registered_commands, program.registered_groups = asked, []
            code = program(prog_name="sysid", standalone_mode=False) or 0
    except SystemExit as stop:
        # click answers a closed pipe with code 1.
        code = CLOSED_PIPE if isinstance(stop.__context__, BrokenPipeError) else stop.code
    except _UsageError as error:
        code, refusal = 2, _misused(error)
    except SysidError as error:
        if debug:
            raise
        code, refusal = 2, str(error)
    except Exception as error:
        if debug:
            raise
        try:
            if isinstance(error, OSError):
                # Was it the output? Its buffer does not say so again.
                print(file=out, flush=True)
        except OSError:
            code, refusal = 2, _unwritten(error)
        else:
            code, refusal = 1, _bug(error)
    try:
        out.flush()
    except OSError as error:
        # Python itself would flush again when it ends, and complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), out.fileno())
        closed = isinstance(error, BrokenPipeError)
        code, refusal = (CLOSED_PIPE, "") if closed else (2, _unwritten(error))
    if refusal:
        with suppress(OSError):
            say(f"error: {' '.join(refusal.split())}")
    sys.exit(code)


def _misused(error: Any) -> str:
    """Return what is wrong with a command line; a program without arguments shows its help."""
    if "\n" in error.message:
        error.show()
        return ""
    words = error.format_message().replace(". Did you mean", ", did you mean").rstrip(".?")
    if hasattr(error.__cause__, "errors"):
        from sysid.documents import mistake

        wrong = error.__cause__.errors()[0]
        # A number that pydantic refuses; the choices of a word are typer's own sentence.
        if wrong["type"] != "value_error":
            words = f"{max(error.param.opts, key=len)} {wrong['input']!r}: {mistake(wrong)}"
    asked = sys.argv[1:2]
    if not any(asked == [one.name] for one in app.registered_commands):
        asked = sys.argv[1:3] if any(asked == [one.name] for one in app.registered_groups) else []
    where = error.ctx.command_path if error.ctx else " ".join(["sysid", *asked])
    return f"{words[0].lower()}{words[1:]}; {where} -h says more"


def _unwritten(error: Exception) -> str:
    return f"the output cannot be written ({error}); name another place for it"


def _bug(error: Exception) -> str:
    """Return a sentence about an exception that nobody foresaw; its trace goes to a file."""
    doing = " ".join(["sysid", *map(shlex.quote, sys.argv[1:])])
    trace = "".join(traceback.format_exception(error))
    try:
        handle, name = tempfile.mkstemp(prefix="sysid-", suffix=".txt")
        with open(handle, "w", encoding="utf-8", errors="backslashreplace") as stream:
            stream.write(f"{doing}\n\n{trace}")
        where = f"the trace is in {name}; please report it with that file"
    except OSError:
        where = "please report it with what --debug prints"
    words = " ".join(f"{type(error).__name__}: {error}".split())[:200]
    return printable(f"{doing} ended in a bug of sysid, not in a mistake of yours ({words}); {where}")
