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
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from sysid.errors import LogError, UnitError
from sysid.journal import Finding, note
from sysid.loaders.columns import listing_note
from sysid.loaders.optional import library, reading
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.signal_log import SIGNAL_OPTIONS, RawSignals, signal_format
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


def _signals(path: str, file: Any, notes: list[Finding], declared: float | None) -> list[Signal]:
    restarts = waveform_starts(path)
    signals, thinned, other, spectra = [], [], [], []
    waves = [(group, channel) for group in file.groups() for channel in group.channels()]
    begins = {}
    for _, channel in waves:
        start = channel.properties.get("wf_start_time")
        if channel.path in restarts:
            begins[channel.path] = restarts[channel.path].first
        elif isinstance(start, np.datetime64) and start > np.datetime64("1905-01-01"):
            begins[channel.path] = start  # LabVIEW's zero, the year 1904, is no start
    first: Any = min(begins.values(), default=None)
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
        step = properties.get("wf_increment")
        if isinstance(step, bool) or not isinstance(step, int | float | np.integer | np.floating):
            step = 0.0
        seconds = _seconds(str(properties.get("wf_xunit_string") or "s").strip())
        if seconds is None:
            spectra.append(name)
            continue
        begin = float(properties.get("wf_start_offset", 0.0) or 0.0) * seconds
        if channel.path in begins:
            begin += float((begins[channel.path] - first) / np.timedelta64(1, "ns")) * 1e-9
        rate = 1.0 / (float(step) * seconds) if step > 0 else None
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
    notes += listing_note("channels-not-over-time", "channels over another axis than time, left out", spectra)
    notes += listing_note("channels-without-numbers", "channels that hold no numbers, left out", other)
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


FORMAT = signal_format(
    "tdms", "National Instruments TDMS (channels by name)", _recognize, _parse, SIGNAL_OPTIONS
)
