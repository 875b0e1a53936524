"""When each waveform of a TDMS file began, segment by segment.

A program that appends to a TDMS file states ``wf_start_time`` again in each segment; npTDMS keeps the last
one and joins the samples. Here the first and the last statement are read off the segments, so that a pause
between two recordings is seen. Lead-in of a segment: ``TDSm``, 32 flags, version, offset of the next segment,
offset of the raw data (National Instruments, TDMS File Format Internal Structure).
"""

from __future__ import annotations

import mmap
import re
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_LEAD_IN = 28
_BIG_ENDIAN = 1 << 6
# The path of a channel, or the name, type and value of its property.
_SAID = re.compile(
    rb"(?P<path>/'(?:[^']|'')*'/'(?:[^']|'')*')|wf_start_time(?:\x44\0\0\0|\0\0\0\x44)(?P<time>.{16})",
    re.DOTALL,
)
_EPOCH = np.datetime64("1904-01-01T00:00:00", "ns")
_NANOSECONDS = 1_000_000_000


@dataclass
class Starts:
    """First and last start that a file states of one channel, and where the segment of the last one is."""

    first: np.datetime64
    last: np.datetime64
    offset: int = 0


def waveform_starts(path: str) -> dict[str, Starts]:
    """Return the starts of the channels that state one, by their path in the file, ``/'group'/'channel'``."""
    starts: dict[str, Starts] = {}
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
                seconds, fraction = (
                    struct.unpack(">qQ", match["time"]) if big else struct.unpack("<Qq", match["time"])[::-1]
                )
                if seconds <= 0 or seconds > 1 << 33:  # not set, or no time
                    continue
                passed = seconds * _NANOSECONDS + (fraction * _NANOSECONDS >> 64)
                start = _EPOCH + np.timedelta64(passed, "ns")
                known = starts.setdefault(channel, Starts(start, start, at))
                if start != known.last:
                    known.last, known.offset = start, at
            at += _LEAD_IN + behind
    return starts


def samples_before(path: str, offset: int, channel: str) -> int:
    """Return how many samples of a channel stand in the segments before `offset`."""
    from nptdms import TdmsFile

    with Path(path).open("rb") as stream, mmap.mmap(stream.fileno(), offset, access=mmap.ACCESS_READ) as data:
        groups = TdmsFile.read_metadata(data).groups()
        return sum(len(wave) for group in groups for wave in group.channels() if wave.path == channel)
