"""Maps on disk: one HDF5 file with every set's outcome, the shares, the means, and how it all came about."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from sysid import exact_json
from sysid.errors import ExportError
from sysid.landing.impulse_maps import UNITS, ImpulseMap
from sysid.landing.maps import CellMap, LandingMap
from sysid.landing.outcomes import OUTCOMES, Outcome
from sysid.storage import write_file

SCHEMA = "sysid-landing-maps"
VERSION = 1
# Touchdown speeds of a summary [m/s].
_USUAL_SPEEDS = (0.3, 0.6, 1.0, 1.5)


@dataclass(frozen=True, eq=False)
class MapFile:
    """What a file holds.

    Parameters
    ----------
    maps : tuple of LandingMap
    impulses : tuple of ImpulseMap
        Empty but for impulse control.
    settings, provenance : mapping
        Grid, rules, tolerance, controllers; parameter sets, versions.
    """

    maps: tuple[LandingMap, ...]
    impulses: tuple[ImpulseMap, ...]
    settings: Mapping[str, Any]
    provenance: Mapping[str, Any]


def map_bytes(content: MapFile) -> bytes:
    """Return the file."""
    buffer = io.BytesIO()
    text = h5py.string_dtype()
    with h5py.File(buffer, "w") as file:
        file.attrs["schema"], file.attrs["version"] = SCHEMA, VERSION
        file.create_dataset("settings_json", data=exact_json.dumps(dict(content.settings)), dtype=text)
        file.create_dataset("provenance_json", data=exact_json.dumps(dict(content.provenance)), dtype=text)
        for number, one in enumerate(content.maps, start=1):
            group = _group(file, f"maps/{number}", one)
            codes = ", ".join(f"{outcome.value}: {outcome.text}" for outcome in Outcome)
            _array(group, "outcome", one.outcome, codes, "set, slope, speed")
            _array(group, "distance", one.distance, "m", "set, slope, speed")
            _array(group, "time", one.time, "s", "set, slope, speed")
            group.attrs["checked"] = one.checked
            if one.checked:
                _array(group, "uncertain", one.uncertain, "1", "set, slope, speed")
            shares = np.array([one.share(outcome) for outcome in OUTCOMES])
            _array(group, "probability", shares, "1", "outcome 0 to 3, slope, speed")
            _array(group, "mean_distance", one.mean_distance, "m", "slope, speed")
            _array(group, "mean_time", one.mean_time, "s", "slope, speed")
        for number, best in enumerate(content.impulses, start=1):
            group = _group(file, f"impulses/{number}", best)
            for name, values in best.optimum.items():
                _array(group, name, values, UNITS[name], "set, slope, speed")
                _array(group, f"mean_{name}", best.mean(name), UNITS[name], "slope, speed")
                _array(group, f"sigma_{name}", best.sigma(name), UNITS[name], "slope, speed")
    return buffer.getvalue()


def _group(file: h5py.File, name: str, one: CellMap) -> Any:
    group = file.create_group(name)
    group.attrs["surface"], group.attrs["controller"] = one.surface, one.controller
    group.create_dataset("sets", data=list(one.sets), dtype=h5py.string_dtype())
    _array(group, "slope", one.slopes_deg, "deg", "slope")
    _array(group, "speed", one.speeds, "m/s", "speed")
    return group


def _array(group: Any, name: str, values: Any, unit: str, axes: str) -> None:
    data = group.create_dataset(name, data=values)
    data.attrs["unit"], data.attrs["axes"] = unit, axes


def write_maps(path: Path, content: MapFile) -> Path:
    """Write the file whole or not at all.

    Raises
    ------
    ExportError
        When it cannot be written.
    """
    write_file(path, map_bytes(content), ExportError)
    return path


def read_maps(path: str | Path) -> MapFile:
    """Return what a file of `write_maps` holds.

    Raises
    ------
    ExportError
        When it is missing, foreign, damaged or of an unknown version.
    """
    path = Path(path)
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("schema") != SCHEMA:
                raise ExportError(f"{path}: holds no landing maps; give a file that sysid landing-map wrote")
            if file.attrs["version"] != VERSION:
                raise ExportError(
                    f"{path}: maps of version {file.attrs['version']}, expected {VERSION}; read it with the "
                    "version of sysid that wrote it"
                )
            maps = [_read_map(file[f"maps/{i + 1}"]) for i in range(len(file.get("maps", ())))]
            best = [_read_impulse(file[f"impulses/{i + 1}"]) for i in range(len(file.get("impulses", ())))]
            texts = [
                exact_json.loads(file[f"{name}_json"].asstr()[()]) for name in ("settings", "provenance")
            ]
    except (OSError, KeyError, ValueError, RuntimeError) as error:
        first = next(iter(str(error).splitlines()), type(error).__name__)
        raise ExportError(f"{path}: cannot be read ({first}); compute the map again") from error
    return MapFile(tuple(maps), tuple(best), *texts)


def _head(group: Any) -> tuple[str, str, tuple[str, ...], Any, Any]:
    names = tuple(group["sets"].asstr()[()])
    return (
        str(group.attrs["surface"]), str(group.attrs["controller"]), names, group["slope"][()],
        group["speed"][()],
    )  # fmt: skip


def _read_map(group: Any) -> LandingMap:
    arrays = [group[name][()] for name in ("outcome", "distance", "time")]
    checked = bool(group.attrs.get("checked", True))
    uncertain = group["uncertain"][()] if checked else np.zeros(arrays[0].shape, dtype=bool)
    return LandingMap(*_head(group), *[*arrays, uncertain], checked=checked)


def _read_impulse(group: Any) -> ImpulseMap:
    return ImpulseMap(*_head(group), {name: group[name][()] for name in UNITS})


def summary(maps: Sequence[LandingMap]) -> list[dict[str, Any]]:
    """Return per map what a table or JSON shows: cells by likeliest class, steepest slopes, doubts.

    A steepest slope is told for speeds that the map has; where it is the map's own steepest one, landings may
    go on beyond it, and it is told as a lower bound. Doubts are None where they were not looked for.
    """
    out = []
    for one in maps:
        slopes = {f"{speed:g} m/s": one.steepest(speed) for speed in _told_speeds(one)}
        found, counts = np.unique(one.likeliest, return_counts=True)
        cells = {Outcome(int(code)).name.lower(): int(n) for code, n in zip(found, counts, strict=True)}
        out.append(
            {
                "surface": one.surface,
                "controller": one.controller,
                "sets": len(one.sets),
                "cells": cells,
                "steepest slope that half of the sets land on [deg]": slopes,
                "lower bounds, at the map's edge": [
                    name for name, slope in slopes.items() if slope == one.slopes_deg[-1]
                ],
                "mean time to rest where landed [s]": _where_landed(one, one.mean_time),
                "mean distance where landed [m]": _where_landed(one, one.mean_distance),
                "uncertain [%]": 100.0 * float(one.uncertain.mean()) if one.checked else None,
                "lost": int(np.sum(one.outcome == Outcome.LOST)),
            }
        )
    return out


def _told_speeds(one: LandingMap) -> list[float]:
    """Speeds [m/s] whose steepest slope is told: all of up to four, else the usual ones it has, else four."""
    if len(one.speeds) <= 4:
        return [float(speed) for speed in one.speeds]
    usual = [speed for speed in _USUAL_SPEEDS if (abs(one.speeds - speed) < 1e-9).any()]
    if usual:
        return usual
    chosen = np.unique(np.linspace(0, len(one.speeds) - 1, 4).round().astype(int))
    return [float(one.speeds[k]) for k in chosen]


def _where_landed(one: LandingMap, values: Any) -> float:
    """Mean over the cells where at least half of the sets land, NaN without any."""
    chosen = (one.landed >= 0.5) & np.isfinite(values)
    return float(values[chosen].mean()) if chosen.any() else float("nan")
