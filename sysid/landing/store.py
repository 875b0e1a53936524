"""Maps and design studies on disk: HDF5 files with every landing's outcome, and how it came about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import ExportError
from sysid.landing.design_study import DesignStudy
from sysid.landing.impulse_maps import UNITS, ImpulseMap
from sysid.landing.maps import CellMap, LandingMap
from sysid.landing.outcomes import OUTCOMES, Outcome
from sysid.storage import FileKind, put, put_json, put_texts, write_file

MAPS = FileKind("sysid-landing-maps", 1, "a file of landing maps", "compute the map again", ExportError)
STUDY = FileKind("sysid-design-study", 1, "a design study", "compute the study again", ExportError)
# Touchdown speeds of a summary [m/s].
_USUAL_SPEEDS = (0.3, 0.6, 1.0, 1.5)


@dataclass(frozen=True, eq=False)
class MapFile:
    """What a file holds: settings are grid, rules, tolerance, controllers; provenance is sets, versions."""

    maps: tuple[LandingMap, ...]
    impulses: tuple[ImpulseMap, ...]
    settings: Mapping[str, Any]
    provenance: Mapping[str, Any]


def write_maps(path: Path, content: MapFile) -> Path:
    """Write the file whole or not at all."""
    write_file(path, MAPS.content(lambda file: _put_maps(file, content)), ExportError)
    return path


def _put_maps(file: Any, content: MapFile) -> None:
    cells, means = "set, slope, speed", "slope, speed"
    put_json(file, "settings_json", content.settings)
    put_json(file, "provenance_json", content.provenance)
    for number, landings in enumerate(content.maps, start=1):
        group = _group(file, f"maps/{number}", landings)
        codes = ", ".join(f"{outcome.value}: {outcome.text}" for outcome in Outcome)
        put(group, "outcome", landings.outcome, cells, codes)
        put(group, "distance", landings.distance, cells, "m")
        put(group, "time", landings.time, cells, "s")
        group.attrs["checked"] = landings.checked
        if landings.checked:
            put(group, "uncertain", landings.uncertain, cells)
        shares = np.array([landings.share(outcome) for outcome in OUTCOMES])
        put(group, "probability", shares, "outcome 0 to 3, slope, speed")
        put(group, "mean_distance", landings.mean_distance, means, "m")
        put(group, "mean_time", landings.mean_time, means, "s")
    for number, best in enumerate(content.impulses, start=1):
        group = _group(file, f"impulses/{number}", best)
        for name, values in best.optimum.items():
            put(group, name, values, cells, UNITS[name])
            put(group, f"mean_{name}", best.mean(name), means, UNITS[name])
            put(group, f"sigma_{name}", best.sigma(name), means, UNITS[name])


def _group(file: Any, name: str, cells: CellMap) -> Any:
    group = file.create_group(name)
    group.attrs["surface"], group.attrs["controller"] = cells.surface, cells.controller
    put_texts(group, "sets", cells.sets)
    put(group, "slope", cells.slopes_deg, "slope", "deg")
    put(group, "speed", cells.speeds, "speed", "m/s")
    return group


def write_study(path: Path, study: DesignStudy, provenance: Mapping[str, Any]) -> Path:
    """Write the file whole or not at all."""
    write_file(path, STUDY.content(lambda file: _put_study(file, study, provenance)), ExportError)
    return path


def _put_study(file: Any, study: DesignStudy, provenance: Mapping[str, Any]) -> None:
    settings = study.settings
    file.attrs["name"], file.attrs["controller"] = study.name, study.controller
    document = {
        "changes": [asdict(change) for change in study.changes],
        "share": settings.share,
        "spread_deg": settings.spread_deg,
        "together": settings.together,
        "tolerance": settings.maps.tolerance,
        "rules": asdict(settings.maps.rules),
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


def summary(maps: Sequence[LandingMap]) -> list[dict[str, Any]]:
    """Return per map what a table or JSON shows: cells by likeliest class, steepest slopes, doubts.

    Steepest slopes are stated for speeds that the map has. The map's last slope is a lower bound: steeper
    landings may succeed. Doubts are None where they were not looked for.
    """
    out = []
    for landings in maps:
        slopes = {f"{speed:g} m/s": landings.steepest(speed) for speed in _summary_speeds(landings)}
        classes, counts = np.unique(landings.likeliest, return_counts=True)
        cells = {Outcome(int(code)).name.lower(): int(n) for code, n in zip(classes, counts, strict=True)}
        out.append(
            {
                "surface": landings.surface,
                "controller": landings.controller,
                "sets": len(landings.sets),
                "cells": cells,
                "steepest slope that half of the sets land on [deg]": slopes,
                "lower bounds, at the map's edge": [
                    name for name, slope in slopes.items() if slope == landings.slopes_deg[-1]
                ],
                "mean time to rest where landed [s]": _where_landed(landings, landings.mean_time),
                "mean distance where landed [m]": _where_landed(landings, landings.mean_distance),
                "uncertain [%]": 100.0 * float(landings.uncertain.mean()) if landings.checked else None,
                "lost": int(np.sum(landings.outcome == Outcome.LOST)),
            }
        )
    return out


def _summary_speeds(landings: LandingMap) -> list[float]:
    """Speeds [m/s] of a summary: all of up to four, else the usual speeds that it has, else four."""
    if len(landings.speeds) <= 4:
        return [float(speed) for speed in landings.speeds]
    usual = [speed for speed in _USUAL_SPEEDS if (abs(landings.speeds - speed) < 1e-9).any()]
    if usual:
        return usual
    chosen = np.unique(np.linspace(0, len(landings.speeds) - 1, 4).round().astype(int))
    return [float(landings.speeds[k]) for k in chosen]


def _where_landed(landings: LandingMap, values: Any) -> float:
    """Mean over the cells where at least half of the sets land, NaN without any."""
    chosen = (landings.landed >= 0.5) & np.isfinite(values)
    return float(values[chosen].mean()) if chosen.any() else float("nan")
