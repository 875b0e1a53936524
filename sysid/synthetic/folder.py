"""A synthesized campaign on disk: all of it, or nothing."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from sysid import exact_json
from sysid.errors import ExportError
from sysid.parameters import ParameterTable
from sysid.storage import replaced_folder

TRUTH_FILE = "truth.json"
SCHEMA = "sysid-truth/2"

# A file is its text, or a function that writes it at the path it is given (HDF5).
Content = str | Callable[[Path], None]


def write_campaign(
    folder: str | Path, campaign: str, logs: Mapping[str, Content], truth: str, *, force: bool = False
) -> Path:
    """Write a campaign, its logs and its truth into a folder, which appears only once all are complete.

    Text is written as UTF-8 with its line ends as they are. `force` replaces an existing synthesized folder
    as a whole; ExportError when it may not be replaced, or the disk refuses.
    """
    with replaced_folder(folder, force=force, marker=TRUTH_FILE, error_type=ExportError) as new:
        for name, content in {**logs, "campaign.toml": campaign, TRUTH_FILE: truth}.items():
            if callable(content):
                content(new / name)
            else:
                (new / name).write_bytes(content.encode("utf-8"))
    return Path(folder)


def truth_text(
    kind: str,
    table: ParameterTable,
    values: Mapping[str, float],
    facts: Mapping[str, object],
    fact_units: Mapping[str, str],
) -> str:
    """Return the truth file: the facts of the trials, then every parameter [SI], then units by key.

    `fact_units` lists the keys of the facts under their unit.
    """
    units = {key: unit for unit, keys in fact_units.items() for key in keys.split()}
    document = {
        "schema": SCHEMA,
        "kind": kind,
        **facts,
        "parameters": {name: float(values[name]) for name in table},
        "units": units | {name: row.unit for name, row in table.items()},
    }
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def read_truth(folder: str | Path) -> dict[str, Any]:
    """Return the truth of a synthesized campaign; ``parameters`` maps names to SI values.

    `folder` may also be the campaign file or the truth file. ExportError when there is no truth, or it has
    another schema.
    """
    path = Path(folder)
    if path.name != TRUTH_FILE:
        path = (path if path.is_dir() else path.parent) / TRUTH_FILE
    try:
        document = exact_json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ExportError(
            f"{path}: no readable truth ({error}); only folders made by 'sysid synthesize' have one"
        ) from error
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise ExportError(f"{path}: schema is not {SCHEMA!r}; synthesize the campaign again")
    return document
