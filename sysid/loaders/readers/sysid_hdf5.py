"""The layout in which sysid itself writes a recording, and reads it back to the same bits.

    /                       attributes: sysid_recording = 1 (version of this layout), kind, format, device,
                            source (name of the original file), source_sha256, options and notes (JSON text)
    /clocks/0, 1, ...       (n,) sample times [s], one per clock that channels share; attribute unit = "s",
                            or "1" where rows are points of a static map
    /channels/NAME          (n,) or (n, k) samples in SI, NaN where nothing was recorded; attributes: name,
                            index (order), unit, clock (number of its clock)

A name with a slash lies in groups (``/channels/F450/position``); where that cannot be, under its number, and
the attribute ``name`` is its name.
"""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.hdf5 import attribute_value, is_hdf5, open_hdf5
from sysid.loaders.readers.load_cell_hdf5 import LAYOUT_ATTRIBUTE
from sysid.loaders.registry import CERTAIN, NO, LogFormat
from sysid.loaders.source import Source
from sysid.recording import Channel, FloatArray, Provenance, Recording
from sysid.storage import write_file

if TYPE_CHECKING:
    import h5py

_NAME = "sysid-hdf5"
_VERSION = 1


def _recognize(source: Source) -> int:
    if not is_hdf5(source) or source.head.startswith(b"MATLAB"):
        return NO
    try:
        with open_hdf5(source, "") as log:
            return CERTAIN if LAYOUT_ATTRIBUTE in log.file.attrs else NO
    except LogError:
        return NO  # the reader of other HDF5 files refuses it


def write_recording(recording: Recording, path: str | Path) -> Path:
    """Write a recording as HDF5 in the layout above; an existing file is replaced only by a complete one.

    A file that cannot be written is a LogError.
    """
    import h5py

    provenance = recording.provenance
    stream = io.BytesIO()
    with h5py.File(stream, "w") as file:
        notes = [
            {key: getattr(finding, key) for key in ("code", "severity", "sentence")}
            for finding in provenance.notes
        ]
        file.attrs.update({
            LAYOUT_ATTRIBUTE: _VERSION,
            "kind": recording.kind, "format": provenance.format, "device": provenance.device,
            "source": Path(provenance.path).name, "source_sha256": provenance.sha256,
            "options": json.dumps(dict(provenance.options), ensure_ascii=False),
            "notes": json.dumps(notes, ensure_ascii=False),
        })  # fmt: skip
        clocks: list[FloatArray] = []
        group = file.create_group("channels")
        for index, (name, channel) in enumerate(recording.channels.items()):
            clock = next((i for i, time in enumerate(clocks) if np.array_equal(time, channel.time)), None)
            if clock is None:
                clock = len(clocks)
                clocks.append(channel.time)
                # A static map's rows are counted: its clock is the point's number.
                unit = "1" if recording.kind == "static-map" else "s"
                _dataset(file, f"clocks/{clock}", channel.time).attrs["unit"] = unit
            data = _dataset(group, _place(group, name, index), channel.values)
            data.attrs["name"], data.attrs["index"] = name, index
            data.attrs["unit"], data.attrs["clock"] = channel.unit, clock
    write_file(path, stream.getvalue(), LogError)
    return Path(path)


def _place(group: h5py.Group, name: str, index: int) -> str:
    """Return where a channel goes: its name, or its number where the name is no path or is taken."""
    import h5py

    parts = name.split("/")
    if not name.isprintable() or any(part in ("", ".", "..") or part != part.strip() for part in parts):
        return f"#{index}"
    for end in range(1, len(parts) + 1):
        there = group.get("/".join(parts[:end]))
        if there is not None and (end == len(parts) or isinstance(there, h5py.Dataset)):
            return f"#{index}"
    return name


def _dataset(group: h5py.Group, name: str, values: FloatArray) -> h5py.Dataset:
    packed = {"compression": "gzip", "shuffle": True} if values.size else {}
    return group.create_dataset(name, data=values, **packed)


def _text(attributes: h5py.AttributeManager, key: str) -> str:
    return str(attribute_value(attributes.get(key, "")))


def _read(source: Source) -> Recording:
    """Return the recording as it was written, with a note that names the original file."""
    channels, clocks = {}, {}
    with open_hdf5(source, "convert the log again") as log:
        attributes = log.file.attrs
        if LAYOUT_ATTRIBUTE not in attributes:
            raise LogError(
                f"{source.path}: was not written by sysid (no attribute {LAYOUT_ATTRIBUTE}); check the format"
            )
        version = int(attributes[LAYOUT_ATTRIBUTE])
        if version > _VERSION:
            raise LogError(
                f"{source.path}: layout version {version}, this sysid reads {_VERSION}; update sysid"
            )
        items = {name: item for name, item in log.datasets.items() if name.startswith("/channels/")}
        for where, item in sorted(items.items(), key=lambda entry: int(entry[1].attrs["index"])):
            name, clock = _text(item.attrs, "name"), int(item.attrs["clock"])
            if not name:
                raise LogError(
                    f"{source.path}: the channel at {where} has no name, so the file is damaged; convert the "
                    "log again"
                )
            if clock not in clocks:
                clocks[clock] = log.numbers(f"/clocks/{clock}", log.datasets[f"/clocks/{clock}"])
            channels[name] = Channel(name, _text(item.attrs, "unit"), clocks[clock], log.numbers(where, item))
        kind, origin, origin_sha256, form, device, stated, options = (
            _text(attributes, key)
            for key in ("kind", "source", "source_sha256", "format", "device", "notes", "options")
        )
        converted = note("converted", f"converted from {origin} (SHA-256 {origin_sha256})")
        # Files of older versions have the sentence of a note alone.
        notes = [
            Finding(str(one["code"]), str(one["sentence"]), one.get("severity", "note"))
            if isinstance(one, dict)
            else note("stated", str(one))
            for one in json.loads(stated or "[]")
        ]
        notes += [converted, *log.notes]
        given = {str(key): str(value) for key, value in json.loads(options or "{}").items()}
        provenance = Provenance(source.path, source.sha256, form, device, given, tuple(notes))
        return Recording(kind, channels, provenance)


FORMAT = LogFormat(_NAME, "HDF5 written by sysid convert", _recognize, _read, {})
