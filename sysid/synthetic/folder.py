"""A synthesized campaign on disk: all of it, or nothing."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from sysid.errors import ExportError
from sysid.parameters import ParameterTable

TRUTH_FILE = "truth.json"
CAMPAIGN_FILE = "campaign.toml"
SCHEMA = "sysid-truth/1"

# A file is its text, or a function that writes it at the path it is given (HDF5).
Content = str | Callable[[Path], None]


def write_folder(folder: str | Path, files: Mapping[str, Content], *, force: bool = False) -> Path:
    """Write files into a folder, which appears only once every one of them is complete.

    Parameters
    ----------
    folder : str or Path
        Made with its parents; refused when it exists, unless `force`.
    files : mapping of str to text or function
        Content of each file by name; text is written as UTF-8 with its line ends as they are.
    force : bool
        Replace files of these names in an existing folder; others in it stay.

    Raises
    ------
    ExportError
        When the folder exists, or the disk refuses.
    """
    folder = Path(folder)
    refuse_existing(folder, force=force)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
        try:
            for name, content in files.items():
                if callable(content):
                    content(beside / name)
                else:
                    (beside / name).write_bytes(content.encode("utf-8"))
            folder.mkdir(exist_ok=True)
            for name in files:
                os.replace(beside / name, folder / name)
        finally:
            shutil.rmtree(beside, ignore_errors=True)
    except OSError as error:
        raise ExportError(
            f"{folder}: cannot be written ({error.strerror or error}); free space or choose another folder"
        ) from error
    return folder


def refuse_existing(folder: str | Path, *, force: bool) -> None:
    """Refuse a folder that holds something already, before any work is done for it."""
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise ExportError(f"{folder} is a file; choose the name of a folder that does not exist")
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise ExportError(f"{folder} exists and is not empty; choose a new name or pass --force")


def truth_text(kind: str, table: ParameterTable, values: Mapping[str, float], facts: Mapping[str, Any]) -> str:
    """Return the truth file: every parameter with its symbol and unit, then the facts of each trial."""
    parameters = {
        name: {"symbol": row.symbol, "unit": row.unit, "value": float(values[name])}
        for name, row in table.items()
    }
    document = {"schema": SCHEMA, "kind": kind, **facts, "parameters": parameters}
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def read_truth(folder: str | Path) -> dict[str, Any]:
    """Return the truth beside a synthesized campaign; ``parameters`` as a plain mapping of name to SI value.

    Parameters
    ----------
    folder : str or Path
        The campaign's folder, its campaign file, or the truth file itself.

    Raises
    ------
    ExportError
        When there is none, or it is of another schema.
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
    document["parameters"] = {name: row["value"] for name, row in document["parameters"].items()}
    return document
