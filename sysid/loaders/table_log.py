"""Tables of one instrument (thrust stands, load cells, force/torque transducers) become a `Recording`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from sysid.journal import Finding, note
from sysid.loaders.ati_calibration import Calibration, motor_transform, without_tare
from sysid.loaders.columns import Column, listing_note
from sysid.loaders.load_cell import quantity_channel
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import family_format
from sysid.loaders.source import Source
from sysid.recording import Channel, Recording
from sysid.types import FloatArray

# Channels of the loads Fx Fy Fz Tx Ty Tz.
_LOADS = ("force_x", "force_y", "thrust", "torque_x", "torque_y", "torque")
# Units as a channel shows them.
_SHOWN = {"N*m": "N·m", "m/s^2": "m/s²"}


@dataclass
class RawTable:
    """What a table of one instrument holds.

    `channels` are those that are ready. `loads` (n, 6) are Fx Fy Fz Tx Ty Tz before tare and transform, to
    be turned into N and N·m by `scale`: six factors, or a calibration of gauge voltages; None where they
    are.
    """

    kind: str
    device: str
    time: FloatArray
    notes: list[Finding]
    channels: dict[str, Channel] = field(default_factory=dict)
    loads: FloatArray | None = None
    scale: FloatArray | Calibration | None = None

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


def _loads(path: str, raw: RawTable, options: BenchOptions) -> dict[str, Channel]:
    """Return the six loads: tare off, scaled, at the motor's axes."""
    if raw.loads is None:
        return {}
    load, tared = without_tare(path, raw.loads, raw.time, options.tare)
    raw.notes += tared
    if isinstance(raw.scale, Calibration):
        load = load @ raw.scale.matrix.T
        if beyond := raw.scale.beyond(load):
            raw.notes.append(
                note("beyond-calibrated-range", f"beyond the calibrated range: {', '.join(beyond)}")
            )
    elif raw.scale is not None:
        load = load * raw.scale
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
    channels = raw.channels | _loads(source.path, raw, options)
    provenance = source.provenance(name, device=raw.device, options=options, notes=raw.notes)
    return Recording(raw.kind, channels, provenance)


table_format = partial(family_format, BenchOptions, _recording)
