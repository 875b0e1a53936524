"""Motive and Tracking Tools CSV of version 1.1: one row per frame, of as many cells as it has markers.

    info,version,1.1
    frame,INDEX,TIME,BODIES,(ID,x,y,z,qx,qy,qz,qw,yaw,pitch,roll)...,MARKERS,(x,y,z,ID,NAME)...

Lengths are metres unless declared, axes right-handed as the file must say; a missing point is written
``NAN`` or left out. Ignores yaw, pitch and roll, which repeat the quaternion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.capture_log import Body, RawCapture, capture_format, declared_length, wanted_bodies
from sysid.loaders.clock import order_rows
from sysid.loaders.options import CaptureOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.source import Source, Text, read_text, split_line
from sysid.loaders.table import Numbers, parse_number, promised_note
from sysid.types import FloatArray

_BODY_CELLS, _MARKER_CELLS = 11, 5
# What a line may begin with besides frame.
_WORDS = frozenset({"comment", "info", "rigidbody", "righthanded", "lefthanded"})
# More bodies or markers than this in one row is a damaged count.
_MOST = 10_000


def _recognize(source: Source) -> int:
    lines = [line.strip().casefold() for line in source.head_lines[:60]]
    return CERTAIN if any(line.startswith("info,version,1.") for line in lines) else NO


@dataclass
class _Frames:
    """Rows gathered while reading: times, and numbers by row of each ``("body" or "marker", name)``."""

    lines: list[int] = field(default_factory=list)
    time: list[float] = field(default_factory=list)
    tracks: dict[tuple[str, str], dict[int, list[float]]] = field(default_factory=dict)


def _parts(cells: Sequence[str], place: int, width: int) -> tuple[list[Sequence[str]], int]:
    """Return the cells of each body or marker that the count at `place` promises, and where they end."""
    count = int(cells[place])
    if not 0 <= count <= _MOST:
        raise ValueError(cells[place])
    end = place + 1 + count * width
    if end > len(cells):
        raise IndexError
    return [cells[start : start + width] for start in range(place + 1, end, width)], end


def _add_frame(frames: _Frames, names: dict[str, str], number: int, cells: Sequence[str]) -> None:
    """Add one row; ValueError or IndexError where its counts and its cells do not agree."""
    numbers: dict[tuple[str, str], list[float]] = {}
    parse_number(cells[1])  # refuses an index that is no number
    time = parse_number(cells[2])
    parts, place = _parts(cells, 3, _BODY_CELLS)
    for part in parts:
        name = names.get(part[0].strip(), f"body {part[0].strip()}")
        if ("body", name) in numbers:
            raise ValueError(f"{name} twice")
        numbers["body", name] = [parse_number(cell) for cell in part[1:8]]
    parts, place = _parts(cells, place, _MARKER_CELLS)
    for part in parts:
        name = part[4].strip() or f"marker {part[3].strip()}"
        if ("marker", name) in numbers:
            name = f"{name} {part[3].strip()}"
        numbers["marker", name] = [parse_number(cell) for cell in part[:3]]
    if any(cell.strip() for cell in cells[place:]):
        raise ValueError("cells left over")
    row = len(frames.lines)
    frames.lines.append(number)
    frames.time.append(time)
    for key, values in numbers.items():
        frames.tracks.setdefault(key, {})[row] = values


def _frames(text: Text, notes: list[Finding]) -> _Frames:
    frames = _Frames()
    names: dict[str, str] = {}
    handed = promised = ""
    strange: list[int] = []
    closed = text.data.endswith(b"\n")
    for number, behind, line in text.lines():
        cells = split_line(line, ",")
        word = cells[0].strip().casefold()
        if word in ("righthanded", "lefthanded"):
            handed = word
        elif word == "rigidbody" and len(cells) > 2 and cells[2].strip().isdigit():
            names[cells[2].strip()] = cells[1].strip().strip('"')
        elif word == "frame":
            try:
                _add_frame(frames, names, number, cells)
            except (ValueError, IndexError) as error:
                if behind >= len(text.data) and not closed:
                    notes.append(note("last-line-cut", f"line {number}, the last, is cut and was left out"))
                    break
                raise LogError(
                    f"{text.path}, line {number}: the counts of bodies and markers and the {len(cells)} "
                    f"cells of this frame do not agree ({str(error)[:60] or 'the row is cut'}); "
                    "repair or remove the row"
                ) from None
        elif word == "info" and len(cells) > 2 and cells[1].strip().casefold() == "framecount":
            promised = cells[2]
        elif word and word not in _WORDS and frames.lines:
            strange.append(number)
    if strange:
        sentence = f"lines that begin with no known word, left out: {len(strange)} (first: line {strange[0]})"
        notes.append(note("unknown-lines", sentence))
    notes += promised_note("framecount", promised, len(frames.lines))
    if handed == "lefthanded":
        raise LogError(f"{text.path}: axes are left-handed; export again with right-handed axes")
    if not frames.lines:
        raise LogError(f"{text.path}: has no row that begins with frame; the capture is empty")
    return frames


def _parse(source: Source, options: CaptureOptions) -> RawCapture:
    path = source.path
    scale = declared_length(path, options.length_unit)
    text = read_text(source)
    notes = list(text.notes)
    if not _recognize(source):
        raise LogError(f'{path}: not of version 1.1 (no line "info,version,1.1"); check the format')
    frames = _frames(text, notes)
    del text  # the file's bytes are not needed any more
    columns: dict[int, FloatArray] = {0: np.array(frames.time)}
    places: dict[tuple[str, str], range] = {}
    for key, rows in frames.tracks.items():
        table = np.full((len(frames.lines), 7 if key[0] == "body" else 3), np.nan)
        for row, cells in rows.items():
            table[row] = cells
        places[key] = range(len(columns), len(columns) + table.shape[1])
        columns |= zip(places[key], np.where(np.isinf(table), np.nan, table).T, strict=True)
    numbers = Numbers(columns, np.array(frames.lines, dtype=np.int64))
    kept = wanted_bodies(path, [name for kind, name in places if kind == "body"], options.rigid_body)
    time, ordered = order_rows(path, numbers, 0, 1.0)
    raw = RawCapture("OptiTrack Motive CSV 1.1", [*notes, *ordered], marks_lost=True)
    for (kind, name), place in places.items():
        values = numbers.stacked(place)
        if kind == "marker":
            raw.markers[name] = time, values * scale
        elif name in kept:
            raw.bodies.append(Body(name, time, values[:, :3] * scale, values[:, [6, 3, 4, 5]], numbers))
    return raw


FORMAT = capture_format(
    "motive-legacy", "OptiTrack CSV 1.1 (one row per frame)", _recognize, _parse,
    {"rigid_body": (), "length_unit": ()},
)  # fmt: skip
