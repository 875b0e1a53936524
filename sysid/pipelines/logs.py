"""Load a campaign's logs: each is told what its own format can be told."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sysid.loaders import detect, formats, load
from sysid.recording import Recording


def load_stated(
    path: Path, format_name: str | None, stated: Mapping[str, Any], own: Mapping[str, Any] | None = None
) -> Recording:
    """Load a log with those of the campaign's statements that its format takes.

    A campaign may mix formats: a quaternion order is for its pose tables, not for its Motive exports. What is
    stated for one log must fit its format.

    Parameters
    ----------
    path : Path
        The log.
    format_name : str, optional
        Name of the format; judged by content where it is None or ``"auto"``.
    stated : mapping
        Loader options of the whole campaign, by name; None counts as not stated.
    own : mapping, optional
        Of this log alone; they win, and None takes a statement of the campaign back.

    Raises
    ------
    LogError, UnitError
        One sentence with file, line and cause.
    """
    if format_name is None or format_name == "auto":
        format_name = detect(path)
    known = formats()
    takes = known[format_name].options if format_name in known else ()
    options = {name: stated[name] for name in takes if name in stated} | dict(own or {})
    return load(path, format=format_name, **options)
