"""Load a campaign's logs: each is told what its own format can be told."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sysid.loaders import detect, formats, load
from sysid.recording import Recording


def load_stated(path: Path, format_name: str, stated: Mapping[str, Any]) -> Recording:
    """Load a log with those of the campaign's statements that its format takes.

    A campaign may mix formats: a quaternion order is for its pose tables, not for its Motive exports.

    Parameters
    ----------
    path : Path
        The log.
    format_name : str
        Name of the format, or ``"auto"``.
    stated : mapping
        Loader options by name; None counts as not stated.

    Raises
    ------
    LogError, UnitError
        One sentence with file, line and cause.
    """
    if format_name == "auto":
        format_name = detect(path)
    known = formats()
    takes = known[format_name].options if format_name in known else ()
    return load(path, format=format_name, **{name: stated[name] for name in takes if name in stated})
