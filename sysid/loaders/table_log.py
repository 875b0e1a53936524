"""Tables of one instrument (thrust stands, load cells, force/torque transducers) become a `Recording`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.columns import Column, listing_note, naming
from sysid.loaders.load_cell import quantity_channel
from sysid.loaders.options import BenchOptions, is_positive
from sysid.loaders.registry import family_format
from sysid.loaders.source import Source
from sysid.recording import Channel, Recording
from sysid.types import FloatArray
from sysid.units import parse_quantity

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
# Channels of the loads on these axes.
_LOADS = ("force_x", "force_y", "thrust", "torque_x", "torque_y", "torque")
# Units as a channel shows them.
_SHOWN = {"N*m": "N·m", "m/s^2": "m/s²"}


@dataclass
class RawTable:
    """Content of a table of one instrument.

    `channels` are those that are ready. `loads` (n, 6) are Fx Fy Fz Tx Ty Tz before tare and transform.
    `scale`, six factors or a (6, 6) matrix, turns them into N and N·m; None where they are. `limits` (6,) are
    the largest calibrated loads, NaN where not stated.
    """

    kind: str
    device: str
    time: FloatArray
    notes: list[Finding]
    channels: dict[str, Channel] = field(default_factory=dict)
    loads: FloatArray | None = None
    scale: FloatArray | None = None
    limits: FloatArray | None = None

    def add(
        self,
        values: dict[int, FloatArray],
        columns: Mapping[str, tuple[Column, str]],
        factors: Mapping[str, float],
    ) -> None:
        """Add a channel per column with any value: `columns` has its SI unit, `factors` what makes it SI."""
        blank = []
        for name, (column, unit) in columns.items():
            column_values = values.pop(column.index)
            if np.isnan(column_values).all():
                blank.append(column.label)
                continue
            scaled = column_values * factors[name] if factors[name] != 1.0 else column_values
            self.channels[name] = Channel(name, _SHOWN.get(unit, unit), self.time, scaled)
        self.notes += listing_note("columns-without-values", "columns without a single value", blank)


def motor_transform(path: str, transform: Mapping[str, Any]) -> FloatArray:
    """Return the (6, 6) matrix that turns a load at the transducer into one at the motor's axes.

    `transform` has ``dx dy dz``, from the transducer's origin to the motor's in the transducer's axes (``"10
    mm"``), and ``rx ry rz``, then turns of the axes about x, the new y, the new z (``"90 deg"``); 0 where
    not named. F' = Rᵀ F and T' = Rᵀ (T − d × F), with the columns of R the new axes. A key or a quantity
    that is not understood is a LogError or a UnitError.
    """
    if not isinstance(transform, Mapping):
        raise LogError(
            f'{path}: transform = {transform!r} is no table; expected for example {{dz = "20 mm"}}'
        )
    unknown = sorted(set(transform) - {"dx", "dy", "dz", "rx", "ry", "rz"})
    if unknown:
        raise LogError(f'{path}: transform names "{unknown[0]}"; it can name dx, dy, dz, rx, ry, rz')
    with naming(f"{path}: transform"):
        d = np.array([parse_quantity(str(transform.get(key, "0 m")), "m") for key in ("dx", "dy", "dz")])
        angles = [parse_quantity(str(transform.get(key, "0 rad")), "rad") for key in ("rx", "ry", "rz")]
    back = Rotation.from_euler("XYZ", angles).as_matrix().T
    cross = np.array([[0.0, -d[2], d[1]], [d[2], 0.0, -d[0]], [-d[1], d[0], 0.0]])
    out = np.zeros((6, 6))
    out[:3, :3], out[3:, 3:], out[3:, :3] = back, back, -back @ cross
    return out


def _without_tare(path: str, values: FloatArray, time: FloatArray, tare: Any) -> tuple[FloatArray, Finding]:
    """Return values less the mean of the first `tare` seconds of each column, and a note.

    A `tare` that is no positive time or covers no sample is a LogError.
    """
    if not is_positive(tare):
        raise LogError(
            f"{path}: tare = {tare!r}; expected seconds at the start of the log without load, or with their "
            'unit: tare = "1 s"'
        )
    first = time < time[0] + float(tare)
    seen = np.isfinite(values[first])
    if not seen.any(axis=0).all():
        raise LogError(f"{path}: the first {float(tare):g} s have no sample to take the tare from")
    offset = np.asarray(np.nanmean(values[first], axis=0))
    sentence = f"tare: the mean of the first {tare:g} s was subtracted"
    return values - offset, note("tare-subtracted", sentence)


def _load_channels(path: str, raw: RawTable, loads: FloatArray, options: BenchOptions) -> dict[str, Channel]:
    """Return the six loads: tare off, scaled, at the motor's axes."""
    load = loads
    if options.tare is not None:
        load, tared = _without_tare(path, load, raw.time, options.tare)
        raw.notes.append(tared)
    if raw.scale is not None:
        load = load @ raw.scale.T if raw.scale.ndim == 2 else load * raw.scale
    if raw.limits is not None and (over := np.any(np.abs(load) > raw.limits, axis=0)).any():
        beyond = ", ".join(AXES[i] for i in np.flatnonzero(over))
        raw.notes.append(note("beyond-calibrated-range", f"beyond the calibrated range: {beyond}"))
    if options.transform:
        load = load @ motor_transform(path, options.transform).T  # a blank cell blanks all that it counts in
        raw.notes.append(note("loads-transformed", "loads are at the motor's axes, as declared by transform"))
    return {name: quantity_channel(name, raw.time, load[:, i].copy()) for i, name in enumerate(_LOADS)}


def _recording(
    source: Source, name: str, parse: Callable[[Source, BenchOptions], RawTable], options: BenchOptions
) -> Recording:
    if options.transform is not None:
        motor_transform(source.path, options.transform)  # refused before the file is read
    raw = parse(source, options)
    channels = raw.channels
    if raw.loads is not None:
        channels |= _load_channels(source.path, raw, raw.loads, options)
    provenance = source.provenance(name, device=raw.device, options=options, notes=raw.notes)
    return Recording(raw.kind, channels, provenance)


table_format = partial(family_format, BenchOptions, _recording)
