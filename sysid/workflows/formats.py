"""`sysid formats`: the log formats that are read."""

from __future__ import annotations

from sysid.loaders import formats
from sysid.report.fold import print_result, print_table
from sysid.report.table import listed


def print_formats(as_json: bool = False) -> None:
    """Print the formats that are read, with the options of each; installed packages may add formats."""
    kinds = formats().items()
    rows = [{"format": name, "reads": kind.describes, "options": list(kind.options)} for name, kind in kinds]
    if not print_result(rows, as_json):
        cells = [(name, kind.describes, ", ".join(kind.options) or "none") for name, kind in kinds]
        print_table(listed("", cells, ("format", "reads", "options"), texts=3))
