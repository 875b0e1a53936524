"""Load the logs of a campaign, each with the options that its format takes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from sysid.journal import notice
from sysid.loaders import detect, formats, load
from sysid.recording import Recording


def load_stated(
    path: Path, format_name: str | None, stated: Mapping[str, Any], for_log: Mapping[str, Any] | None = None
) -> Recording:
    """Load a log with those options `stated` in the campaign that its format takes; None is not stated.

    A campaign may mix formats: a quaternion order is for its pose tables, not for its Motive exports. What is
    stated `for_log` alone must fit its format; it wins, and None takes a statement of the campaign back. The
    format is judged by content where `format_name` is None or ``"auto"``.
    """
    if format_name is None or format_name == "auto":
        format_name = detect(path)
    known = formats()
    takes = known[format_name].options if format_name in known else ()
    options = {name: stated[name] for name in takes if name in stated} | dict(for_log or {})
    return load(path, format=format_name, **options)


def warn_of_idle_options(
    table: str, stated: Mapping[str, Any], logs: Iterable[tuple[Path, str | None]]
) -> None:
    """Warn of options of a campaign's `table` (all of them: `stated`) that no format of its `logs` takes."""
    named = {detect(path) if name in (None, "auto") else str(name) for path, name in logs}
    known = formats()
    taken = {option for name in named if name in known for option in known[name].options}
    for option in sorted({name for name, value in stated.items() if value is not None} - taken):
        near = ", ".join(name for name, format_of in known.items() if option in format_of.options)
        notice(
            "idle-log-option",
            f"{table}.{option} has no effect: the logs are {', '.join(sorted(named))}, and it is for {near}; "
            "leave it out, or name the format",
        )
