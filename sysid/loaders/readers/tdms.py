"""National Instruments TDMS (npTDMS): every channel that holds numbers, on the clock that the file states.

Valid for waveform channels: time = ``wf_start_offset`` + i · ``wf_increment``, counted from the earliest
``wf_start_time`` of the file, of which 1904-01-01 means not set. The number of samples is that of the data:
``wf_samples`` is the size of one block. Segments that begin after a pause are refused (`tdms_segments`),
because the samples of a channel are on one clock. Both count in ``wf_xunit_string``, seconds where it is not
set; a channel over another axis (a spectrum) is left out. Channels without ``wf_increment`` take a time
channel beside them or the declared rate. The thinned copies that SignalExpress adds
(``Decimated Data_Level1``) are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from sysid.errors import LogError, UnitError
from sysid.journal import Finding, note
from sysid.loaders.columns import listing
from sysid.loaders.optional import library, reading
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.signal_log import RawSignals, signal_format
from sysid.loaders.signals import Signal, written_unit
from sysid.loaders.source import Source
from sysid.loaders.tdms_segments import Starts, samples_before, waveform_starts
from sysid.types import FloatArray
from sysid.units import factor_to_si

_THINNED = re.compile(r"Decimated Data_Level\d+$")
# Clocks of a computer and a device drift apart by less than this.
_DRIFT = 1e-4


def _recognize(source: Source) -> int:
    return CERTAIN if source.head.startswith(b"TDSm") else NO


def _start(properties: Mapping[str, Any]) -> np.datetime64 | None:
    """Return when a waveform began, or None where the file does not say (LabVIEW's zero is the year 1904)."""
    start = properties.get("wf_start_time")
    return start if isinstance(start, np.datetime64) and start > np.datetime64("1905-01-01") else None


def _seconds(unit: str) -> float | None:
    """Return the factor from the unit of a waveform's axis to seconds; None where it is no time."""
    try:
        return factor_to_si(unit, "s")
    except UnitError:
        return None


def _samples(channel: Any) -> FloatArray:
    values = channel[:]
    if values.dtype.kind == "M":  # a channel of time stamps, usable as a clock
        return np.asarray((values - values[0]) / np.timedelta64(1, "ns"), dtype=np.float64) * 1e-9
    return np.asarray(values, dtype=np.float64)


def _check_segments(
    path: str, name: str, channel: str, stated: Starts, step: float, declared: float | None
) -> list[Finding]:
    """Refuse a channel with a segment that begins after a pause; return a note when `declared` joins them."""
    lasted = samples_before(path, stated.offset, channel) * step
    began = float((stated.last - stated.first) / np.timedelta64(1, "ns")) * 1e-9
    if abs(began - lasted) <= max(1.5 * step, _DRIFT * lasted):
        return []
    doubt = (
        f"{name} was recorded in parts: its last part began {began:.6g} s after the first, but the samples "
        f"before it last {lasted:.6g} s"
    )
    if declared is None:
        raise LogError(
            f"{path}: {doubt}; save each recording in a separate file, or take all samples as consecutive "
            f"with rate = {1.0 / step:g}"
        )
    return [note("parts-joined", f"{doubt}; all samples taken as consecutive, as declared by rate")]


def _number(value: object) -> float | None:
    """Return a property that is a number, whole or not."""
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return float(value) if number else None  # type: ignore[arg-type]


def _signals(path: str, file: Any, notes: list[Finding], declared: float | None) -> list[Signal]:
    restarts = waveform_starts(path)
    signals, thinned, other, spectra = [], [], [], []
    waves = [(group, channel) for group in file.groups() for channel in group.channels()]
    begins = {}
    for _, channel in waves:
        stated = restarts.get(channel.path)
        begins[channel.path] = _start(channel.properties) if stated is None else stated.first
    starts = [start for start in begins.values() if start is not None]
    first = min(starts) if starts else None
    for group, channel in waves:
        name = f"/{group.name}/{channel.name}"
        properties = channel.properties
        if _THINNED.search(group.name):
            thinned.append(name)
            continue
        if not len(channel):
            continue
        if channel.dtype is None or np.dtype(channel.dtype).kind not in "iufbM":
            other.append(name)
            continue
        unit = next(
            (str(properties[key]) for key in ("unit_string", "NI_UnitDescription") if properties.get(key)),
            None,
        )
        if np.dtype(channel.dtype).kind == "M":
            unit = "s"  # what `_samples` makes of time stamps
        step = _number(properties.get("wf_increment"))
        seconds = _seconds(str(properties.get("wf_xunit_string") or "s").strip())
        if seconds is None:
            spectra.append(name)
            continue
        start = begins[channel.path]
        begin = float(properties.get("wf_start_offset", 0.0) or 0.0) * seconds
        if start is not None and first is not None:
            begin += float((start - first) / np.timedelta64(1, "ns")) * 1e-9
        rate = 1.0 / (step * seconds) if step is not None and step > 0 else None
        stated = restarts.get(channel.path)
        if rate is not None and stated is not None and stated.last != stated.first:
            notes += _check_segments(path, name, channel.path, stated, 1.0 / rate, declared)
        signals.append(
            Signal(name, written_unit(unit), partial(_samples, channel), rate, begin, label=channel.name)
        )
    if first is not None:
        notes.append(note("recording-began", f"recording began at {first} UTC"))
    if thinned:
        notes.append(note("thinned-copies-left-out", f"thinned copies, left out: {len(thinned)}"))
    if spectra:
        sentence = f"channels over another axis than time, left out: {listing(spectra)}"
        notes.append(note("channels-not-over-time", sentence))
    if other:
        notes.append(
            note("channels-without-numbers", f"channels that hold no numbers, left out: {listing(other)}")
        )
    return signals


@contextmanager
def _parse(source: Source, options: BenchOptions) -> Iterator[RawSignals]:
    path = source.path
    nptdms = library(path, "nptdms", "npTDMS")
    if not source.head.startswith(b"TDSm"):
        raise LogError(f"{path}: not a TDMS file (it does not begin with TDSm); check the format")
    notes: list[Finding] = []
    with reading(path, "TDMS file", "copy or export it again"), nptdms.TdmsFile.open(path) as file:
        device = f"NI TDMS {file.properties.get('name', '')}".strip()
        yield RawSignals(_signals(path, file, notes, options.rate), device, measured=False, notes=notes)


FORMAT = signal_format("tdms", "National Instruments TDMS (channels by name)", _recognize, _parse)
