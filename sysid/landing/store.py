"""Maps and design studies on disk: HDF5 files with every landing's outcome, and how it came about."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from sysid.errors import ExportError
from sysid.landing.design_study import Change, DesignStudy
from sysid.landing.impulse import UNITS, ImpulseMap
from sysid.landing.maps import CellMap, LandingMap
from sysid.landing.outcomes import MEANINGS, OUTCOMES, Rules
from sysid.landing.settings import StudySettings
from sysid.parameter_sets import DRAWS
from sysid.storage import FileKind, get_json, get_texts, numbered, put, put_json, put_texts, write_file
from sysid.types import FloatArray

MAPS = FileKind("sysid-landing-maps", 2, "a file of landing maps", "compute the map again", ExportError)
STUDY = FileKind("sysid-design-study", 3, "a design study", "compute the study again", ExportError)
# Settings of a study that its file states by name.
_STATED = ("share", "spread_deg", "together", "tolerance")
_CODES = ", ".join(f"{code}: {meaning}" for code, meaning in enumerate(MEANINGS))


@dataclass(frozen=True, eq=False)
class MapFile:
    """Content of a file of maps."""

    maps: tuple[LandingMap, ...]
    impulses: tuple[ImpulseMap, ...]
    settings: Mapping[str, Any]  # grid, rules, tolerance, controllers
    provenance: Mapping[str, Any]  # sets, versions


def write_maps(path: Path, content: MapFile) -> Path:
    """Write the file whole or not at all; raises `ExportError` where it cannot be written."""
    write_file(path, MAPS.content(lambda file: _put_maps(file, content)), ExportError)
    return path


def _put_maps(file: h5py.File, content: MapFile) -> None:
    cells, means = "set, slope, speed", "slope, speed"
    put_json(file, "settings_json", content.settings)
    put_json(file, "provenance_json", content.provenance)
    for number, landings in enumerate(content.maps, start=1):
        group = _group(file, f"maps/{number}", landings)
        group.attrs["law"] = landings.law
        put(group, "outcome", landings.outcome, cells, _CODES)
        put(group, "distance", landings.distance, cells, "m")
        put(group, "time", landings.time, cells, "s")
        group.attrs["checked"] = landings.checked
        if landings.checked:
            put(group, "uncertain", landings.uncertain, cells)
        shares = np.array([landings.share(outcome) for outcome in OUTCOMES])
        put(group, "probability", shares, "outcome 0 to 3, slope, speed")
        if landings.numbers:
            errors = np.array([landings.error(share) for share in shares])
            put(group, "probability_error", errors, "outcome 0 to 3, slope, speed")
            names, correlation = landings.deciding()
            put_texts(group, "decided_by", names.tolist())
            put(group, "decided_by_correlation", correlation, means)
        put(group, "mean_distance", landings.mean_distance, means, "m")
        put(group, "mean_time", landings.mean_time, means, "s")
    for number, best in enumerate(content.impulses, start=1):
        group = _group(file, f"impulses/{number}", best)
        for name, values in best.optimum.items():
            put(group, name, values, cells, UNITS[name])
            put(group, f"mean_{name}", best.mean(name), means, UNITS[name])
            put(group, f"sigma_{name}", best.sigma(name), means, UNITS[name])


def _group(file: h5py.File, name: str, cells: CellMap) -> h5py.Group:
    group = file.create_group(name)
    group.attrs["surface"], group.attrs["controller"] = cells.surface, cells.controller
    put_texts(group, "sets", cells.sets)
    put(group, "slope", cells.slopes_deg, "slope", "deg")
    put(group, "speed", cells.speeds, "speed", "m/s")
    for name, values in cells.numbers.items():
        put(group, f"numbers/{name}", values, "draw", "SI")
    return group


def read_maps(path: Path) -> MapFile:
    """Return the content of a file of maps; raises `ExportError` for anything else."""
    with MAPS.opened(path) as file:
        settings, provenance = (get_json(file, f"{name}_json") for name in ("settings", "provenance"))
        maps = []
        for group in numbered(file, "maps"):
            outcome, distance, time = (group[name][()] for name in ("outcome", "distance", "time"))
            checked = bool(group.attrs["checked"])
            uncertain = group["uncertain"][()] if checked else outcome < 0
            arrays = (outcome, distance, time, uncertain)
            numbers = {name: values[()] for name, values in group.get("numbers", {}).items()}
            law = str(group.attrs["law"])
            maps.append(LandingMap(*_head(group), *arrays, checked=checked, law=law, numbers=numbers))
        impulses = tuple(
            ImpulseMap(*_head(group), {name: group[name][()] for name in UNITS})
            for group in numbered(file, "impulses")
        )
        return MapFile(tuple(maps), impulses, settings, provenance)


def _head(group: h5py.Group) -> tuple[str, str, tuple[str, ...], FloatArray, FloatArray]:
    surface, controller = str(group.attrs["surface"]), str(group.attrs["controller"])
    return surface, controller, tuple(get_texts(group, "sets")), group["slope"][()], group["speed"][()]


def write_study(path: Path, study: DesignStudy, provenance: Mapping[str, Any]) -> Path:
    """Write the file whole or not at all; raises `ExportError` where it cannot be written."""
    write_file(path, STUDY.content(lambda file: _put_study(file, study, provenance)), ExportError)
    return path


def _put_study(file: h5py.File, study: DesignStudy, provenance: Mapping[str, Any]) -> None:
    settings = study.settings
    file.attrs["name"], file.attrs["controller"] = study.name, study.controller
    document = {
        "changes": [asdict(change) for change in study.changes],
        **{name: getattr(settings, name) for name in _STATED},
        "rules": asdict(settings.rules),
    }
    put_json(file, "settings_json", document)
    put_json(file, "provenance_json", provenance)
    labels = ", ".join(change.label for change in study.changes)
    put(file, "slope", settings.slopes_deg, "slope", "deg")
    put(file, "speed", settings.speeds, "speed", "m/s")
    put(file, "designs", study.points, "design, change", f"columns: {labels}")
    put(file, "probability", study.shares, "design, outcome 0 to 3, slope, speed")
    if draws := provenance.get(DRAWS):
        error = np.sqrt(study.shares * (1 - study.shares) / draws)
        put(file, "probability_error", error, "design, outcome 0 to 3, slope, speed")
    put(file, "outcome", study.outcome, "design, slope, speed", _CODES)
    put(file, "mean_distance", study.distance, "design, slope, speed", "m")
    put(file, "mean_time", study.time, "design, slope, speed", "s")
    put(file, "largest_safe_slope", study.steepest, "design, speed", "deg")
    put(file, "landable", study.landable, "design, speed", "deg")
    put(file, "at_edge", study.at_edge, "design, speed")
    put(file, "lost", study.lost, "design", "landings")


def read_study(path: Path) -> tuple[DesignStudy, dict[str, Any]]:
    """Return a design study and its provenance; raises `ExportError` for anything else."""
    with STUDY.opened(path) as file:
        document, provenance = (get_json(file, f"{name}_json") for name in ("settings", "provenance"))
        stated = {name: document[name] for name in _STATED}
        slopes, speeds = (tuple(file[name][()].tolist()) for name in ("slope", "speed"))
        settings = StudySettings(slopes, speeds, **stated, rules=Rules(**document["rules"]))
        changes = tuple(Change(**row | {"values": tuple(row["values"])}) for row in document["changes"])
        arrays = ("designs", "probability", "lost", "outcome", "mean_distance", "mean_time")
        numbers = (file[name][()] for name in arrays)
        name, controller = (str(file.attrs[key]) for key in ("name", "controller"))
        return DesignStudy(name, controller, changes, settings, *numbers), provenance
