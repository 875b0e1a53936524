"""C3D: markers, analog channels and, where the file has them, rotations of rigid bodies.

C3D carries points, not poses: a body's pose is fitted to its markers (`rigid_pose`) when the file has no
``ROTATION`` group. A point is missing where it is NaN or its residual is negative. Time is the frame number
over the rate, from the first frame that the header names. Axes are the file's; ``X_SCREEN`` and
``Y_SCREEN`` are for display and turn nothing.

ezc3d reads the file: real numbers or scaled integers, of Intel or DEC processors.
"""

import os
import struct
from itertools import takewhile
from typing import Any

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.capture_log import (
    Body,
    RawCapture,
    capture_format,
    length_factor,
    matrix_quaternions,
    wanted_bodies,
)
from sysid.loaders.clock import known_rate
from sysid.loaders.isolation import library
from sysid.loaders.options import CaptureOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.signal_log import unique_names
from sysid.loaders.source import Source, length_note
from sysid.loaders.table import promised_note
from sysid.types import FloatArray

_BLOCK = 512
# The last frame that a header can number.
_LAST_FRAME = 0xFFFF
# Processor types: who wrote the numbers decides their byte order.
_INTEL, _DEC, _MIPS = 84, 85, 86
# Least and greatest rate of a camera [Hz]: a number beyond is in another byte order than the file states.
_RATES = (0.1, 1e5)
# Share by which two statements of one rate differ at most.
_ROUNDED = 0.01
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


class _C3d:
    """A C3D file: the header as it is written, and what ezc3d reads.

    ezc3d corrects the header by the parameters, so the header is read here and both must agree. `points`
    (n, frames, 3) are NaN where missing; `analogs` (k, samples) are scaled; `poses` (n, frames, 4, 4). Frames
    count from 1; of them the file contains `least` or more, and by its header their bytes `end` there.
    """

    def __init__(self, source: Source) -> None:
        self.path, self.size = source.path, os.path.getsize(source.path)
        processor = _processor(source)
        if not processor:
            raise LogError(f"{self.path}: not a C3D file (no parameter section where its first byte points)")
        if processor == _MIPS:
            raise LogError(
                f"{self.path}: a C3D file in the number format of SGI/MIPS processors, which ezc3d does not "
                "read; export it again in Intel's number format"
            )
        whole = struct.unpack_from("<12H", source.head)
        self.first, self.last, self.ratio = whole[3], whole[4], max(whole[9], 1)
        # A DEC real, its two words exchanged, reads as four times its value.
        exchanged, share = (whole[:9:-1], 0.25) if processor == _DEC else (whole[10:], 1.0)
        self.rate = share * float(struct.unpack("<f", struct.pack("<2H", *exchanged))[0])
        if self.rate and not _RATES[0] <= self.rate <= _RATES[1]:
            self._damaged(
                f"{self.rate:.3g} frames per second, which no camera takes: the processor that the file "
                f"names ({processor}) did not write its numbers"
            )
        file = library(self.path, "ezc3d", "ezc3d").c3d(self.path)
        self.parameters = file["parameters"]
        for group, header, stated in (
            ("POINT", "points", whole[1]), ("ANALOG", "analog channels", whole[2] // self.ratio),
        ):  # fmt: skip
            used = self.values(group, "USED")
            if used and (int(used[0]) & 0xFFFF) != stated:
                self._damaged(f"{stated} {header} in its header and {int(used[0])} in {group}:USED")
        rate = self.values("POINT", "RATE")
        if rate and self.rate and rate[0] > 0 and abs(float(rate[0]) / self.rate - 1.0) > _ROUNDED:
            self._damaged(f"{self.rate:g} frames per second in its header and {rate[0]:g} in POINT:RATE")
        # A positive scale is of points in whole numbers, a negative one of real points.
        data, scale = file["data"], float((self.values("POINT", "SCALE") or [-1.0])[0])
        self.points: FloatArray = data["points"][:3].transpose(1, 2, 0)
        self.analogs = self._analogs(data["analogs"][0], scale > 0)
        self.poses: FloatArray = data["rotations"].transpose(2, 3, 0, 1)
        frame = max(4 * whole[1] + whole[2], 1) * (2 if scale > 0 else 4)
        begin = (whole[8] - 1) * _BLOCK
        self.end = begin + max(self.last - self.first + 1, 0) * frame
        self.least = -(-(max(self.size - begin, 0) - _BLOCK + 1) // frame)  # the last block may be filled up

    def _damaged(self, states: str) -> None:
        raise LogError(f"{self.path}: states {states}, or the file is damaged; export it again")

    def _analogs(self, analogs: FloatArray, whole: bool) -> FloatArray:
        """Return analog channels (k, samples) with whole numbers above 32767 where the file says UNSIGNED.

        ezc3d reads every whole number as signed: (number - OFFSET) · SCALE · GEN_SCALE.
        """
        if not whole or "UNSIGNED" not in self.texts("ANALOG", "FORMAT"):
            return analogs

        def each(key: str, default: float) -> FloatArray:
            stated = [float(value) for value in self.values("ANALOG", key)][: len(analogs)]
            return np.array(stated + [default] * (len(analogs) - len(stated)))[:, None]

        step = each("SCALE", 1.0) * float((self.values("ANALOG", "GEN_SCALE") or [1.0])[0])
        numbers = np.round(analogs / np.where(step == 0.0, 1.0, step) + each("OFFSET", 0.0))
        return np.where(numbers < 0, analogs + (1 << 16) * step, analogs)

    def values(self, group: str, key: str) -> list[Any]:
        """Return a parameter, its numbered continuations (LABELS2, ...) appended."""
        parameters = self.parameters.get(group, {})
        keys = takewhile(parameters.__contains__, [key, *(f"{key}{number}" for number in range(2, 20))])
        return [value for name in keys for value in parameters[name]["value"]]

    def texts(self, group: str, key: str) -> list[str]:
        """Return the texts of a parameter without blanks around them."""
        return [str(text).strip(" \0") for text in self.values(group, key)]


def _frame_notes(file: _C3d) -> list[Finding]:
    """Return notes where the header names more frames than are there, or cannot name all that are."""
    count, frames, named = *file.points.shape[:2], file.last - file.first + 1
    cut = promised_note("the header's number of frames", named, frames) if count else []
    if file.last != _LAST_FRAME:
        # Whole blocks are written, or nothing behind the last frame.
        whole = not file.size % _BLOCK or len(file.poses)
        return cut or ([] if whole else length_note(file.end, file.size))
    frames = frames or named
    stated = _actual_frames(file)
    if max(file.least, stated or 0) > frames:
        count = f"{file.least} or more" if stated is None or file.least > stated else f"{stated}"
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


def _actual_frames(file: _C3d) -> int | None:
    """Return the number of frames that the group TRIAL states, None where it does not."""
    ends = []
    for key in ("ACTUAL_START_FIELD", "ACTUAL_END_FIELD"):
        words = file.values("TRIAL", key)
        if len(words) != 2:
            return None
        low, high = (int(word) & 0xFFFF for word in words)
        ends.append(low + (high << 16))
    return ends[1] - ends[0] + 1


def _rate(path: str, stated: float) -> float:
    try:
        return known_rate(float(stated))
    except ValueError:
        raise LogError(f"{path}: states {float(stated)!r} frames per second; export it again") from None


def _labels(file: _C3d, group: str, count: int, default: str) -> list[str]:
    stated = file.texts(group, "LABELS")[:count]
    stated += [""] * (count - len(stated))
    return unique_names([label or f"{default}{i + 1}" for i, label in enumerate(stated)])


def _add_markers(file: _C3d, length_unit: str | None, raw: RawCapture) -> None:
    count, frames, _ = file.points.shape
    if not count or not frames:
        return
    rate = _rate(file.path, file.rate)
    scale = length_factor(file.path, file.texts("POINT", "UNITS"), length_unit)
    time = (file.first - 1 + np.arange(frames)) / rate
    for i, name in enumerate(_labels(file, "POINT", count, "point ")):
        position = file.points[i] * scale
        position[~np.isfinite(position).all(axis=1)] = np.nan
        raw.markers[name] = time, position


def _add_rotations(file: _C3d, length_unit: str | None, raw: RawCapture) -> None:
    count, frames = file.poses.shape[:2]
    if not count or not frames:
        return
    rate = _rate(file.path, (file.values("ROTATION", "RATE") or [file.rate])[0])
    scale = length_factor(file.path, file.texts("POINT", "UNITS"), length_unit)
    time = (file.first - 1) / (file.rate or rate) + np.arange(frames) / rate
    for i, name in enumerate(_labels(file, "ROTATION", count, "body ")):
        matrix = file.poses[i, :, :3, :3]
        whole = np.isfinite(matrix).all(axis=(1, 2))
        square = np.einsum("nij,nik->njk", matrix, matrix)
        good = whole & (np.abs(np.nan_to_num(square) - np.eye(3)).max(axis=(1, 2)) < 0.02)
        position: FloatArray = np.where(good[:, None], file.poses[i, :, :3, 3] * scale, np.nan)
        raw.bodies.append(Body(name, time, position, matrix_quaternions(matrix, good)))
    raw.notes.append(note("poses-from-file", "poses from the file's ROTATION group"))


def _add_analogs(file: _C3d, raw: RawCapture) -> None:
    count, samples = file.analogs.shape
    rate = file.rate * file.ratio
    if not count or not samples or not rate > 0:
        return
    units = file.texts("ANALOG", "UNITS")
    time = (file.first - 1) / file.rate + np.arange(samples) / rate
    for i, label in enumerate(_labels(file, "ANALOG", count, "")):
        stated = units[i] if i < len(units) else ""
        stated = _ANALOG_UNITS.get(stated.casefold(), stated)
        raw.add_signal(f"analog/{label}", stated, time, file.analogs[i])


def _parse(source: Source, options: CaptureOptions) -> RawCapture:
    path = source.path
    file = _C3d(source)
    raw = RawCapture(" ".join(["C3D", *file.texts("MANUFACTURER", "COMPANY")]), [], chosen=False)
    _add_rotations(file, options.length_unit, raw)
    _add_markers(file, options.length_unit, raw)
    _add_analogs(file, raw)
    if raw.bodies and options.rigid_body is not None and options.bodies is None:
        kept = wanted_bodies(path, [body.name for body in raw.bodies], options.rigid_body)
        raw.bodies = [body for body in raw.bodies if body.name in kept]
        raw.chosen = True
    raw.states_length = any(file.texts("POINT", "UNITS"))
    raw.notes += _frame_notes(file)
    return raw


FORMAT = capture_format(
    "c3d", "C3D (markers, rotations, analog channels)", _recognize, _parse,
    {"rigid_body": (), "bodies": (), "length_unit": ()}, foreign=True,
)  # fmt: skip
