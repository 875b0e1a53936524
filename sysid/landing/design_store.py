"""Design studies on disk: one HDF5 file with every design's share of landings, and how it came about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import ExportError
from sysid.landing.design_study import Change, DesignStudy, StudySettings
from sysid.landing.maps import MapSettings
from sysid.landing.outcomes import Rules
from sysid.storage import FileKind, get_json, put, put_json, write_file

STUDY = FileKind("sysid-design-study", 1, "a design study", "compute the study again", ExportError)


def write_study(path: Path, study: DesignStudy, provenance: Mapping[str, Any]) -> Path:
    """Write the file whole or not at all."""
    write_file(path, STUDY.content(lambda file: _write(file, study, provenance)), ExportError)
    return path


def _write(file: Any, study: DesignStudy, provenance: Mapping[str, Any]) -> None:
    settings = study.settings
    file.attrs["name"], file.attrs["controller"] = study.name, study.controller
    document = {
        "changes": [asdict(change) for change in study.changes],
        "share": settings.share,
        "spread_deg": settings.spread_deg,
        "together": settings.together,
        "tolerance": settings.maps.tolerance,
        "rules": settings.maps.rules.document(),
    }
    put_json(file, "settings_json", document)
    put_json(file, "provenance_json", provenance)
    labels = ", ".join(change.label for change in study.changes)
    put(file, "slope", settings.slopes_deg, "slope", "deg")
    put(file, "speed", settings.speeds, "speed", "m/s")
    put(file, "designs", study.points, "design, change", f"columns: {labels}")
    put(file, "landed", study.landed, "design, slope, speed")
    put(file, "largest_safe_slope", study.steepest, "design, speed", "deg")
    put(file, "landable", study.landable, "design, speed", "deg")
    put(file, "at_edge", study.at_edge, "design, speed")
    put(file, "lost", study.lost, "design", "landings")


def read_study(path: str | Path) -> tuple[DesignStudy, dict[str, Any]]:
    """Return the study that a file of `write_study` holds, and its provenance; refuse any other file."""
    with STUDY.opened(path) as file:
        document, provenance = (get_json(file, f"{name}_json") for name in ("settings", "provenance"))
        rules = Rules.of(document["rules"])
        settings = StudySettings(
            slopes_deg=tuple(file["slope"][()].tolist()),
            speeds=tuple(file["speed"][()].tolist()),
            maps=MapSettings(rules=rules, tolerance=document["tolerance"], check=False),
            **{name: document[name] for name in ("share", "spread_deg", "together")},
        )
        changes = tuple(Change(**row | {"values": tuple(row["values"])}) for row in document["changes"])
        arrays = (np.asarray(file[name][()]) for name in ("designs", "landed", "lost"))
        study = DesignStudy(
            str(file.attrs["name"]), str(file.attrs["controller"]), changes, settings, *arrays
        )
        return study, provenance
