"""Tables of one instrument (thrust stands, load cells, force/torque transducers) become a `Recording`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sysid.journal import Finding, note
from sysid.loaders.ati_calibration import Calibration, load_channels, motor_transform, without_tare
from sysid.loaders.columns import Column, listing
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import LogFormat
from sysid.loaders.source import Source
from sysid.recording import Channel, Recording
from sysid.types import FloatArray

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
        if blank:
            self.notes.append(
                note("columns-without-values", f"columns without a single value: {listing(blank)}")
            )


def _add_loads(path: str, raw: RawTable, options: BenchOptions) -> None:
    """Add the six loads: tare off, scaled, at the motor's axes."""
    assert raw.loads is not None
    load, tared = without_tare(path, raw.loads, raw.time, options.tare)
    raw.notes += tared
    if isinstance(raw.scale, Calibration):
        load = load @ raw.scale.matrix.T
        beyond = raw.scale.beyond(load)
        if beyond:
            raw.notes.append(
                note("beyond-calibrated-range", f"beyond the calibrated range: {', '.join(beyond)}")
            )
    elif raw.scale is not None:
        load = load * raw.scale
    if options.transform:
        load = load @ motor_transform(path, options.transform).T  # a blank cell blanks all that it counts in
        raw.notes.append(note("loads-transformed", "loads are at the motor's axes, as declared by transform"))
    raw.channels |= load_channels(raw.time, load)


def table_format(
    name: str,
    describes: str,
    recognize: Callable[[Source], int],
    parse: Callable[[Source, BenchOptions], RawTable],
    takes: Mapping[str, tuple[str, ...]],
) -> LogFormat:
    """Return a `LogFormat` of tables, which `parse` reads."""

    def read(source: Source, **given: Any) -> Recording:
        options = BenchOptions(**given)
        if options.transform is not None:
            motor_transform(source.path, options.transform)  # refused before the file is read
        raw = parse(source, options)
        if raw.loads is not None:
            _add_loads(source.path, raw, options)
        return Recording(
            raw.kind,
            raw.channels,
            source.provenance(name, device=raw.device, options=options, notes=raw.notes),
        )

    read.__module__ = parse.__module__
    return LogFormat(name, describes, recognize, read, takes)
