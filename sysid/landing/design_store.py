"""Design studies on disk: one HDF5 file with every design's share of landings, and how it came about."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from sysid import exact_json
from sysid.errors import ExportError
from sysid.landing.design_study import Change, DesignStudy, StudySettings
from sysid.landing.maps import MapSettings
from sysid.landing.outcomes import Rules
from sysid.storage import write_file

SCHEMA = "sysid-design-study"
VERSION = 1


def study_bytes(study: DesignStudy, provenance: Mapping[str, Any]) -> bytes:
    """Return the file's content."""
    buffer = io.BytesIO()
    own = study.settings
    settings = {
        "changes": [asdict(one) for one in study.changes],
        "share": own.share,
        "spread_deg": own.spread_deg,
        "together": own.together,
        "tolerance": own.maps.tolerance,
        "rules": own.maps.rules.document(),
    }
    with h5py.File(buffer, "w") as file:
        file.attrs["schema"], file.attrs["version"] = SCHEMA, VERSION
        file.attrs["name"], file.attrs["controller"] = study.name, study.controller
        for name, document in (("settings", settings), ("provenance", dict(provenance))):
            text = exact_json.dumps(document)
            file.create_dataset(f"{name}_json", data=text, dtype=h5py.string_dtype())
        changes = ", ".join(one.label for one in study.changes)
        for name, values, unit, axes in (
            ("slope", np.array(own.slopes_deg), "deg", "slope"),
            ("speed", np.array(own.speeds), "m/s", "speed"),
            ("designs", study.points, f"columns: {changes}", "design, change"),
            ("landed", study.landed, "1", "design, slope, speed"),
            ("largest_safe_slope", study.steepest, "deg", "design, speed"),
            ("landable", study.landable, "deg", "design, speed"),
            ("at_edge", study.at_edge, "1", "design, speed"),
            ("lost", study.lost, "landings", "design"),
        ):
            data = file.create_dataset(name, data=values)
            data.attrs["unit"], data.attrs["axes"] = unit, axes
    return buffer.getvalue()


def write_study(path: Path, study: DesignStudy, provenance: Mapping[str, Any]) -> Path:
    """Write the file whole or not at all.

    Raises
    ------
    ExportError
        When it cannot be written.
    """
    write_file(path, study_bytes(study, provenance), ExportError)
    return path


def read_study(path: str | Path) -> tuple[DesignStudy, dict[str, Any]]:
    """Return the study that a file of `write_study` holds, and its provenance.

    Raises
    ------
    ExportError
        When it is missing, foreign, damaged or of an unknown version.
    """
    path = Path(path)
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("schema") != SCHEMA:
                raise ExportError(f"{path}: holds no design study; give a file of sysid design-study")
            if file.attrs["version"] != VERSION:
                raise ExportError(
                    f"{path}: a study of version {file.attrs['version']}, expected {VERSION}; read it with "
                    "the version of sysid that wrote it"
                )
            settings, provenance = (
                exact_json.loads(file[f"{name}_json"].asstr()[()]) for name in ("settings", "provenance")
            )
            arrays = {name: file[name][()] for name in ("slope", "speed", "designs", "landed")}
            lost = file["lost"][()] if "lost" in file else np.zeros(len(arrays["designs"]), dtype=np.int64)
            name, controller = str(file.attrs["name"]), str(file.attrs["controller"])
        rules = Rules.of(settings["rules"])
        own = StudySettings(
            slopes_deg=tuple(arrays["slope"].tolist()),
            speeds=tuple(arrays["speed"].tolist()),
            share=settings["share"],
            spread_deg=settings["spread_deg"],
            together=settings["together"],
            maps=MapSettings(rules=rules, tolerance=settings["tolerance"], check=False),
        )
        changes = tuple(Change(**{**row, "values": tuple(row["values"])}) for row in settings["changes"])
    except (OSError, KeyError, TypeError, ValueError, RuntimeError) as error:
        first = next(iter(str(error).splitlines()), type(error).__name__)
        raise ExportError(f"{path}: cannot be read ({first}); compute the study again") from error
    return DesignStudy(name, controller, changes, own, arrays["designs"], arrays["landed"], lost), provenance
