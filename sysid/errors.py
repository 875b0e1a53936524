"""What sysid says when an input or a request cannot be used.

Every message is one sentence that names what, where, what was found, what was expected and the next step.
The command line prints it on one line and exits with 2.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Mapping
from types import MappingProxyType
from typing import Self

# Control characters, line separators, and marks that turn the direction of text.
_UNSEEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
_LONG = re.compile(r"\S{400,}")
# Longest refusal [characters]: a hostile file is not quoted whole.
_LONGEST = 4000


def printable(text: str) -> str:
    """Return text as a terminal may show it: what would move its cursor or turn its lines is written out.

    Names in files may be anything. A word of over 400 characters is cut.
    """
    text = _UNSEEN.sub(lambda match: f"\\u{ord(match[0]):04x}", text)
    return _LONG.sub(lambda match: f"{match[0][:200]}…", text)


def shell(*words: object) -> str:
    """Return a command as this system's shell takes it: a path with a space is quoted."""
    texts = [str(word) for word in words]
    if os.name != "nt":
        return shlex.join(texts)
    from subprocess import list2cmdline

    return list2cmdline(texts)


class SysidError(Exception):
    """Base of every refusal that sysid makes on purpose.

    `needs` are the loader options that a log lacks, by name, with the expected unit or a value that may fit.

    Examples
    --------
    Where Python has an exception for the mistake, the refusal is that one as well:

    >>> import sysid
    >>> try:
    ...     sysid.load_log("none.csv")
    ... except FileNotFoundError as error:
    ...     isinstance(error, sysid.SysidError)
    True
    """

    needs: Mapping[str, object] = MappingProxyType({})

    def __str__(self) -> str:
        # A KeyError among the bases would put quotes around its text.
        text = printable(str(self.args[0]) if self.args else "")
        return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"

    def also(self, builtin: type[Exception]) -> SysidError:
        """Return the refusal as an exception that is a `builtin` one as well, such as KeyError."""
        kind = type(self)
        return type(kind.__name__, (kind, builtin), {"__module__": kind.__module__})(*self.args)

    def asking(self, **needs: object) -> Self:
        """Return the refusal, which asks for loader options."""
        self.needs = needs
        return self


class LogError(SysidError):
    """A log file cannot be read, or lacks what the campaign says is in it."""


class SegmentError(LogError):
    """A log has several segments, each on another clock, and none is chosen; `count` is how many."""

    def __init__(self, message: str, count: int = 0) -> None:
        super().__init__(message)
        self.count = count


class CampaignError(SysidError):
    """A campaign file is malformed, incomplete or contradicts itself."""


class CampaignFileError(CampaignError):
    """A campaign cannot be used; the message begins with the path of its file."""


class UnitError(SysidError):
    """A quantity has no unit, an unknown unit or a unit of the wrong dimension."""


class FitError(SysidError):
    """A fit cannot start, continue or be written."""


class ExportError(SysidError):
    """A parameter-set file cannot be written or read."""


class SysidWarning(UserWarning):
    """A result is usable but something about it should be known; printed as one sentence."""
