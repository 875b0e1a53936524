"""A synthesized campaign on disk: all of it, or nothing."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from sysid.errors import ExportError
from sysid.parameters import ParameterTable
from sysid.storage import check_folder, replaced_folder

TRUTH_FILE = "truth.json"
CAMPAIGN_FILE = "campaign.toml"
SCHEMA = "sysid-truth/1"

# A file is its text, or a function that writes it at the path it is given (HDF5).
Content = str | Callable[[Path], None]


def write_folder(folder: str | Path, files: Mapping[str, Content], *, force: bool = False) -> Path:
    """Write files into a folder, which appears only once every one of them is complete.

    Text is written as UTF-8 with its line ends as they are. `force` replaces an existing synthesized folder
    as a whole; ExportError when it may not be replaced, or the disk refuses.
    """
    with replaced_folder(folder, force=force, marker=TRUTH_FILE, error_type=ExportError) as new:
        for name, content in files.items():
            if callable(content):
                content(new / name)
            else:
                (new / name).write_bytes(content.encode("utf-8"))
    return Path(folder)


def refuse_existing(folder: str | Path, *, force: bool) -> None:
    """Refuse a folder that is there already, before any work is done for it."""
    check_folder(folder, force=force, marker=TRUTH_FILE, error_type=ExportError)


def truth_text(
    kind: str, table: ParameterTable, values: Mapping[str, float], facts: Mapping[str, Any]
) -> str:
    """Return the truth file: the facts of the trials, then every parameter [SI] and its unit."""
    document = {
        "schema": SCHEMA,
        "kind": kind,
        **facts,
        "parameters": {name: float(values[name]) for name in table},
        "units": {name: row.unit for name, row in table.items()},
    }
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def read_truth(folder: str | Path) -> dict[str, Any]:
    """Return the truth beside a synthesized campaign; ``parameters`` maps names to SI values.

    `folder` may be the campaign's folder, its campaign file, or the truth file itself. ExportError when there
    is no truth, or it is of another schema.
    """
    path = Path(folder)
    if path.name != TRUTH_FILE:
        path = (path if path.is_dir() else path.parent) / TRUTH_FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ExportError(
            f"{path}: no readable truth ({error}); only folders made by 'sysid synthesize' have one"
        ) from error
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise ExportError(f"{path}: schema is not {SCHEMA!r}; synthesize the campaign again")
    return document
