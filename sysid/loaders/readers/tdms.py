"""National Instruments TDMS (npTDMS): every channel of numbers, on the clock that the file states.

Valid for waveform channels: time = ``wf_start_offset`` + i · ``wf_increment``, counted from the earliest
``wf_start_time`` of the file, of which 1904-01-01 means not set. The data state the number of samples:
``wf_samples`` is the size of one block. Segments that begin after a pause are refused,
because the samples of a channel are on one clock. Both count in ``wf_xunit_string``, seconds where it is not
set; a channel over another axis (a spectrum) is left out. Channels without ``wf_increment`` take a time
channel beside them or the declared rate. The thinned copies that SignalExpress adds
(``Decimated Data_Level1``) are left out.
"""

from __future__ import annotations

import io
import mmap
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.columns import factor_or_none, listing_note
from sysid.loaders.isolation import library
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.signal_log import SIGNAL_OPTIONS, RawSignals, Signal, signal_format, written_unit
from sysid.loaders.source import Source, length_note
from sysid.types import FloatArray

if TYPE_CHECKING:
    import nptdms

_THINNED = re.compile(r"Decimated Data_Level\d+$")
# Largest relative drift between the clocks of a computer and a measuring device [1].
_DRIFT = 1e-4
_LEAD_IN = 28
_BIG_ENDIAN = 1 << 6
# Path of a channel, or type and value of its start, in what a segment states ahead of its samples.
_SAID = re.compile(
    rb"(?P<path>/'(?:[^']|'')*'/'(?:[^']|'')*')|wf_start_time(?:\x44\0\0\0|\0\0\0\x44)(?P<time>.{16})",
    re.DOTALL,
)
_EPOCH = np.datetime64("1904-01-01T00:00:00", "ns")


@dataclass
class _Starts:
    """First and last start that a file states of one channel, and where the segment of the last one is."""

    first: np.datetime64
    last: np.datetime64
    offset: int = 0


def _waveform_starts(path: str) -> tuple[dict[str, _Starts], int]:
    """Return the starts of the channels that state one, by path in the file, and where its segments end.

    A program that appends to a file states ``wf_start_time`` again in each segment. npTDMS keeps the last
    start and joins the samples, so that a pause between two recordings would not be seen. The lead-in of a
    segment is ``TDSm``, 32 flags, the version, the offset of the next segment and of the raw data (National
    Instruments, TDMS File Format Internal Structure).
    """
    starts: dict[str, _Starts] = {}
    with Path(path).open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        at = 0
        while data[at : at + 4] == b"TDSm" and at + _LEAD_IN <= len(data):
            (flags,) = struct.unpack_from("<I", data, at + 4)
            big = bool(flags & _BIG_ENDIAN)
            behind, raw = struct.unpack_from(">QQ" if big else "<QQ", data, at + 12)
            channel = ""
            for match in _SAID.finditer(data[at + _LEAD_IN : at + _LEAD_IN + raw]):
                if match["path"] is not None:
                    channel = match["path"].decode("utf-8", "replace")
                    continue
                stamp = struct.unpack(">qQ" if big else "<Qq", match["time"])
                seconds, fraction = stamp if big else stamp[::-1]
                if seconds <= 0 or seconds > 1 << 33:  # not set, or no time
                    continue
                passed = seconds * 10**9 + (fraction * 10**9 >> 64)
                start = _EPOCH + np.timedelta64(passed, "ns")
                known = starts.setdefault(channel, _Starts(start, start, at))
                if start != known.last:
                    known.last, known.offset = start, at
            at += _LEAD_IN + behind
    return starts, at


def _samples_before(path: str, offset: int, channel: str) -> int:
    """Return how many samples of a channel stand in the segments before `offset`."""
    from nptdms import TdmsFile

    with Path(path).open("rb") as stream, mmap.mmap(stream.fileno(), offset, access=mmap.ACCESS_READ) as data:
        groups = TdmsFile.read_metadata(data).groups()
        return sum(len(wave) for group in groups for wave in group.channels() if wave.path == channel)


def _recognize(source: Source) -> int:
    return CERTAIN if source.head.startswith(b"TDSm") else NO


def _samples(channel: nptdms.TdmsChannel) -> FloatArray:
    values = channel[:]
    if values.dtype.kind == "M":  # a channel of time stamps, usable as a clock
        return np.asarray((values - values[0]) / np.timedelta64(1, "ns"), dtype=np.float64) * 1e-9
    return np.asarray(values, dtype=np.float64)


def _check_segments(
    path: str, name: str, channel: str, stated: _Starts, step: float, declared: float | None
) -> list[Finding]:
    """Refuse a channel with a segment that begins after a pause; return a note when `declared` joins them."""
    lasted = _samples_before(path, stated.offset, channel) * step
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


def _signals(path: str, file: nptdms.TdmsFile, notes: list[Finding], declared: float | None) -> list[Signal]:
    restarts, end = _waveform_starts(path)
    notes += length_note(end, Path(path).stat().st_size)
    signals, thinned, other, spectra = [], [], [], []
    waves = [(group, channel) for group in file.groups() for channel in group.channels()]
    begins: dict[str, np.datetime64] = {}
    for _, channel in waves:
        start = channel.properties.get("wf_start_time")
        if channel.path in restarts:
            begins[channel.path] = restarts[channel.path].first
        elif isinstance(start, np.datetime64) and start > np.datetime64("1905-01-01"):
            begins[channel.path] = start  # LabVIEW's zero, the year 1904, is no start
    first = min(begins.values(), default=_EPOCH)
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
        unit = str(properties.get("unit_string") or properties.get("NI_UnitDescription") or "")
        if np.dtype(channel.dtype).kind == "M":
            unit = "s"  # what `_samples` makes of time stamps
        step = properties.get("wf_increment")
        if isinstance(step, bool) or not isinstance(step, int | float | np.integer | np.floating):
            step = 0.0
        seconds = factor_or_none(str(properties.get("wf_xunit_string") or "s").strip(), "s")
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
    if begins:
        notes.append(note("recording-began", f"recording began at {first} UTC"))
    if thinned:
        notes.append(note("thinned-copies-left-out", f"thinned copies, left out: {len(thinned)}"))
    notes += listing_note("channels-not-over-time", "channels over another axis than time, left out", spectra)
    notes += listing_note("channels-without-numbers", "channels without numbers, left out", other)
    return signals


@contextmanager
def _heard(module: ModuleType, notes: list[Finding]) -> Iterator[None]:
    """Make notes of what the library says of a file, once each, instead of lines on the terminal."""
    handler, said = module.log.log_manager.console_handler, io.StringIO()
    before = handler.setStream(said)
    try:
        yield
    finally:
        handler.setStream(before)
        lines = dict.fromkeys(line.partition("] ")[2] for line in said.getvalue().splitlines())
        notes += [Finding("library-warns", f"npTDMS: {line}") for line in lines]


@contextmanager
def _parse(source: Source, options: BenchOptions) -> Iterator[RawSignals]:
    path = source.path
    nptdms = library(path, "nptdms", "npTDMS")
    if not source.head.startswith(b"TDSm"):
        raise LogError(f"{path}: not a TDMS file (it does not begin with TDSm); check the format")
    notes: list[Finding] = []
    with _heard(nptdms, notes), nptdms.TdmsFile.open(path) as file:
        device = f"NI TDMS {file.properties.get('name', '')}".strip()
        yield RawSignals(_signals(path, file, notes, options.rate), device, measured=False, notes=notes)


FORMAT = signal_format(
    "tdms", "National Instruments TDMS (channels by name)", _recognize, _parse, SIGNAL_OPTIONS,
    foreign=True,
)  # fmt: skip
