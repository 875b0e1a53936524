"""C3D (ezc3d): markers, analog channels and, where the file has them, rotations of rigid bodies.

C3D carries points, not poses: a body's pose is fitted to its markers (`rigid_pose`) when the file has no
``ROTATION`` group. A point is missing where it is NaN or its residual is negative. Time is the frame number
over the rate, from the first frame that the header names. Axes are the file's; ``X_SCREEN`` and
``Y_SCREEN`` are for display and turn nothing.
"""

from __future__ import annotations

import struct
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.binary import library, reading
from sysid.loaders.capture_log import (
    Body,
    RawCapture,
    capture_format,
    length_factor,
    matrix_quaternions,
    wanted_bodies,
)
from sysid.loaders.clock import known_rate
from sysid.loaders.options import CaptureOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.signal_log import unique_names
from sysid.loaders.source import Source
from sysid.loaders.table import promised_note
from sysid.types import FloatArray

_BLOCK = 512
# Where the header counts points and analog samples and names the first and the last frame.
_COUNTS = 2
# Where the header states the block in which the data begin, and the last frame that it can number.
_DATA_START, _LAST_FRAME = 16, 0xFFFF
# Processor types: who wrote the numbers decides their byte order.
_INTEL, _DEC, _MIPS = 84, 85, 86
# Frames per second: a number beyond these is in another byte order than the file states.
_RATES = (0.1, 1e5)
_ANALOG_UNITS = {"nt": "N", "ntmm": "N*mm", "nmm": "N*mm", "nm": "N*m"}


def _processor(source: Source) -> int:
    """Return the processor type that the parameter section states, 0 where this is no C3D."""
    head = source.head
    if len(head) < 2 * _BLOCK or head[1] != 0x50 or not head[0] or b"\0" not in head[:_BLOCK]:
        return 0
    place = (head[0] - 1) * _BLOCK + 3
    return head[place] if place < len(head) and head[place] in (_INTEL, _DEC, _MIPS) else 0


def _recognize(source: Source) -> int:
    return CERTAIN if _processor(source) else NO


def _texts(file: Any, group: str, key: str) -> list[str]:
    return [str(text).strip() for text in _values(file, group, key)]


def _values(file: Any, group: str, key: str) -> list[Any]:
    """Return a parameter as a list, its numbered continuations (LABELS2, ...) appended."""
    try:
        parameter = file["parameters"][group]
    except KeyError:
        return []
    keys = takewhile(parameter.__contains__, [key, *(f"{key}{number}" for number in range(2, 20))])
    return [value for name in keys for value in np.ravel(parameter[name]["value"])]


def _open(source: Source) -> Any:
    path = source.path
    processor = _processor(source)
    if not processor:
        raise LogError(f"{path}: not a C3D file (no parameter section where its first byte points)")
    if processor == _MIPS:
        raise LogError(
            f"{path}: numbers are in the byte order of SGI/MIPS, which ezc3d does not read; convert the "
            "file to Intel byte order with the capture program or Mokka"
        )
    ezc3d = library(path, "ezc3d", "ezc3d")
    with reading(path, "C3D file", "export it again"):
        file = ezc3d.c3d(path)
        rate = float(file["header"]["points"]["frame_rate"])
    if rate and not _RATES[0] <= rate <= _RATES[1]:
        raise LogError(
            f"{path}: states {rate:.3g} frames per second, which no camera takes: the processor that the "
            f"file names ({processor}) did not write its numbers, or the file is damaged; export it again"
        )
    return file


def _frame_notes(source: Source, file: Any) -> list[Finding]:
    """Return notes where the header names more frames than are there, or cannot name all that are."""
    points, analogs, first, last = struct.unpack_from("<4H", source.head, _COUNTS)
    frames = file["data"]["points"].shape[2]
    # The library reads what is left of a file that is cut.
    cut = promised_note("the header's number of frames", last - first + 1, frames) if points else []
    if last != _LAST_FRAME:
        return cut
    scale = _values(file, "POINT", "SCALE")
    frame = (4 * points + analogs) * (2 if scale and float(scale[0]) > 0 else 4)
    (begin,) = struct.unpack_from("<H", source.head, _DATA_START)
    there = (Path(source.path).stat().st_size - (begin - 1) * _BLOCK - (_BLOCK - 1)) / max(frame, 1)
    frames = frames or last - first + 1
    stated = _actual_frames(file)
    if max(there, stated or 0) > frames:
        count = f"{np.ceil(there):.0f} or more" if stated is None or there > stated else f"{stated}"
        sentence = (
            f"only the first {frames} frames were read: a C3D header counts to {_LAST_FRAME}, and the "
            f"capture has {count}; export it in shorter pieces"
        )
    elif stated is not None:
        return cut
    else:
        sentence = (
            f"the last frame is number {_LAST_FRAME}, the last that a C3D header can name: the capture "
            "may have gone on, so check its duration"
        )
    return [*cut, note("frames-beyond-header", sentence)]


def _actual_frames(file: Any) -> int | None:
    """Return the number of frames that the group TRIAL states, None where it does not."""
    ends = []
    for key in ("ACTUAL_START_FIELD", "ACTUAL_END_FIELD"):
        words = _values(file, "TRIAL", key)
        if len(words) != 2:
            return None
        # Two words of 16 bits, low and high, which readers may take as signed.
        low, high = (int(word) & 0xFFFF for word in words)
        ends.append(low + (high << 16))
    return ends[1] - ends[0] + 1


def _rate(path: str, stated: Any) -> float:
    try:
        return known_rate(float(stated))
    except ValueError:
        raise LogError(f"{path}: states {stated!r} frames per second; export it again") from None


def _first_time(file: Any, rate: float) -> float:
    """Return the time of the first frame [s]; without points, frames count at `rate`."""
    points = file["header"]["points"]
    return float(points["first_frame"]) / (float(points["frame_rate"]) or rate)


def _labels(file: Any, group: str, count: int, default: str) -> list[str]:
    stated = _texts(file, group, "LABELS")[:count]
    stated += [""] * (count - len(stated))
    return unique_names([label or f"{default}{i + 1}" for i, label in enumerate(stated)])


def _add_markers(path: str, file: Any, length_unit: str | None, raw: RawCapture) -> None:
    points = file["data"]["points"]
    _, count, frames = points.shape
    if not count or not frames:
        return
    rate = _rate(path, file["header"]["points"]["frame_rate"])
    scale = length_factor(path, _texts(file, "POINT", "UNITS"), length_unit)
    residual = file["data"]["meta_points"]["residuals"][0]
    time = (float(file["header"]["points"]["first_frame"]) + np.arange(frames)) / rate
    for i, name in enumerate(_labels(file, "POINT", count, "point ")):
        position = np.asarray(points[:3, i].T, dtype=np.float64) * scale
        position[~np.isfinite(position).all(axis=1) | (residual[i] < 0.0)] = np.nan
        raw.markers[name] = time, position


def _add_rotations(path: str, file: Any, length_unit: str | None, raw: RawCapture) -> None:
    poses = file["data"]["rotations"]
    if poses.ndim != 4 or not poses.shape[2] or not poses.shape[3]:
        return
    rates = _values(file, "ROTATION", "RATE") or [file["header"]["points"]["frame_rate"]]
    rate = _rate(path, rates[0])
    scale = length_factor(path, _texts(file, "POINT", "UNITS"), length_unit)
    time = _first_time(file, rate) + np.arange(poses.shape[3]) / rate
    for i, name in enumerate(_labels(file, "ROTATION", poses.shape[2], "body ")):
        matrix = np.moveaxis(poses[:3, :3, i], 2, 0)
        whole = np.isfinite(matrix).all(axis=(1, 2))
        square = np.einsum("nij,nik->njk", matrix, matrix)
        good = whole & (np.abs(np.nan_to_num(square) - np.eye(3)).max(axis=(1, 2)) < 0.02)
        position: FloatArray = np.where(good[:, None], poses[:3, 3, i].T * scale, np.nan)
        raw.bodies.append(Body(name, time, position, matrix_quaternions(matrix, good)))
    raw.notes.append(note("poses-from-file", "poses from the file's ROTATION group"))


def _add_analogs(path: str, file: Any, raw: RawCapture) -> None:
    values = file["data"]["analogs"]
    _, count, samples = values.shape
    rate = float(file["header"]["analogs"]["frame_rate"])
    if not count or not samples or not rate > 0:
        return
    units = _texts(file, "ANALOG", "UNITS")
    time = _first_time(file, rate) + np.arange(samples) / rate
    for i, label in enumerate(_labels(file, "ANALOG", count, "")):
        stated = units[i] if i < len(units) else ""
        stated = _ANALOG_UNITS.get(stated.casefold(), stated)
        raw.add_signal(f"analog/{label}", stated, time, np.asarray(values[0, i], dtype=np.float64))


def _parse(source: Source, options: CaptureOptions) -> RawCapture:
    path = source.path
    file = _open(source)
    maker = map(str, _values(file, "MANUFACTURER", "COMPANY"))
    raw = RawCapture(" ".join(["C3D", *maker]), [], chosen=False)
    with reading(path, "C3D file", "export it again"):
        _add_rotations(path, file, options.length_unit, raw)
        _add_markers(path, file, options.length_unit, raw)
        _add_analogs(path, file, raw)
    if raw.bodies and options.rigid_body is not None and options.bodies is None:
        kept = wanted_bodies(path, [body.name for body in raw.bodies], options.rigid_body)
        raw.bodies = [body for body in raw.bodies if body.name in kept]
        raw.chosen = True
    raw.states_length = any(_texts(file, "POINT", "UNITS"))
    raw.notes += _frame_notes(source, file)
    return raw


FORMAT = capture_format(
    "c3d", "C3D (markers, rotations, analog channels)", _recognize, _parse,
    {"rigid_body": (), "bodies": (), "length_unit": ()},
)  # fmt: skip
