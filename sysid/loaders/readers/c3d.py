"""C3D: markers, analog channels and, where the file has them, rotations of rigid bodies.

C3D carries points, not poses: a body's pose is fitted to its markers (`rigid_pose`) when the file has no
``ROTATION`` group. A point is missing where it is NaN or its residual is negative. Time is the frame number
over the rate, from the first frame that the header names. Axes are the file's; ``X_SCREEN`` and
``Y_SCREEN`` are for display and turn nothing.

The file is read here (https://www.c3d.org, user guide): a parser in C++ ended the process on some damaged
files and took gigabytes on others. Numbers are of Intel, DEC or SGI/MIPS processors, real or scaled integers.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
# Frames per second: a number beyond these is in another byte order than the file states.
_RATES = (0.1, 1e5)
# Share by which two statements of one rate differ at most.
_ROUNDED = 0.01
# Numbers of a pose: a matrix, columns first, and how reliable it is.
_POSE = 17
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


@dataclass
class _C3d:
    """Header, parameters by group and name, and data of a C3D file.

    `points` (frames, n, 4) are x, y, z and the residual, negative where missing; `analogs` (samples, k) are
    scaled; `poses` (frames, n, 4, 4). Frames count from 1; of them the file
    contains `least` or more, and by its header their bytes `end` there.
    """

    path: str
    data: bytes
    processor: int

    def __post_init__(self) -> None:
        whole = self._numbers("u2", 0, 11).tolist()
        self.width, self.first, self.last, self.begin = whole[2], whole[3], whole[4], (whole[8] - 1) * _BLOCK
        self.count, self.ratio = whole[1], max(whole[9], 1)
        self.rate = float(self._numbers("f4", 20, 1)[0])
        if self.rate and not _RATES[0] <= self.rate <= _RATES[1]:
            self._damaged(
                f"{self.rate:.3g} frames per second, which no camera takes: the processor that the file "
                f"names ({self.processor}) did not write its numbers"
            )
        self.parameters = self._parameters()
        for group, header, stated in (
            ("POINT", "points", self.count), ("ANALOG", "analog channels", self.width // self.ratio),
        ):  # fmt: skip
            used = self.values(group, "USED")
            if used and (int(used[0]) & 0xFFFF) != stated:
                self._damaged(f"{stated} {header} in its header and {int(used[0])} in {group}:USED")
        rate = self.values("POINT", "RATE")
        if rate and self.rate and rate[0] > 0 and abs(float(rate[0]) / self.rate - 1.0) > _ROUNDED:
            self._damaged(f"{self.rate:g} frames per second in its header and {rate[0]:g} in POINT:RATE")
        self._read()

    def _damaged(self, states: str) -> None:
        raise LogError(f"{self.path}: states {states}, or the file is damaged; export it again")

    def _numbers(self, kind: str, at: int, count: int) -> NDArray[Any]:
        """Return numbers that begin at a byte; ValueError where the file ends before them."""
        if self.processor != _DEC or kind != "f4":
            order = ">" if self.processor == _MIPS else "<"
            return np.frombuffer(self.data, order + kind, count, at).astype(
                np.float64 if kind == "f4" else int
            )
        # A DEC real, its two words exchanged, reads as four times its value.
        words = np.frombuffer(self.data, "<u2", 2 * count, at).reshape(-1, 2)[:, ::-1]
        return np.ascontiguousarray(words).view("<f4").ravel().astype(np.float64) / 4.0

    def _parameters(self) -> dict[str, dict[str, list[Any]]]:
        names: dict[int, str] = {}
        found: list[tuple[int, str, list[Any]]] = []
        at = (self.data[0] - 1) * _BLOCK + 4
        while at + 2 < len(self.data) and self.data[at]:
            length, number = struct.unpack_from("bb", self.data, at)
            here = at + 2 + abs(length)
            name = self.data[at + 2 : here].decode("latin-1").upper()
            step = int(self._numbers("u2", here, 1)[0])
            if number < 0:
                names[-number] = name
            else:
                found.append((number, name, self._parameter(here + 2)))
            if not step:
                break
            at = here + step
        groups: dict[str, dict[str, list[Any]]] = {name: {} for name in names.values()}
        for number, name, content in found:
            groups.setdefault(names.get(number, ""), {})[name] = content
        return groups

    def _parameter(self, at: int) -> list[Any]:
        size, dimensions = struct.unpack_from("bB", self.data, at)
        shape = list(self.data[at + 2 : at + 2 + dimensions])
        count, at = int(np.prod(shape, dtype=np.int64)), at + 2 + dimensions
        if size != -1:
            return self._numbers({1: "u1", 2: "i2", 4: "f4"}[size], at, count).tolist()
        text = self.data[at : at + count].decode("utf-8", "replace")
        width = shape[0] if shape else 1
        return [text[i : i + width] for i in range(0, len(text), width)] if width else []

    def values(self, group: str, key: str) -> list[Any]:
        """Return a parameter, its numbered continuations (LABELS2, ...) appended."""
        parameter = self.parameters.get(group, {})
        keys = takewhile(parameter.__contains__, [key, *(f"{key}{number}" for number in range(2, 20))])
        return [value for name in keys for value in parameter[name]]

    def texts(self, group: str, key: str) -> list[str]:
        """Return the texts of a parameter without blanks around them."""
        return [str(text).strip(" \0") for text in self.values(group, key)]

    def _read(self) -> None:
        scale = float((self.values("POINT", "SCALE") or [-1.0])[0])
        kind, size = ("i2", 2) if scale > 0 else ("f4", 4)
        frame = 4 * self.count + self.width
        there, whole = max(len(self.data) - self.begin, 0), max(frame * size, 1)
        self.least = -(-(there - _BLOCK + 1) // whole)  # the last block may be filled up
        named = max(self.last - self.first + 1, 0)
        self.end = self.begin + named * whole
        frames = min(named, there // whole) if frame else 0
        table = self._numbers(kind, self.begin, frames * frame).reshape(frames, frame)
        self.points = table[:, : 4 * self.count].reshape(frames, self.count, 4).astype(np.float64)
        if scale > 0:
            self.points[..., :3] *= scale
        channels = self.width // self.ratio
        analogs = table[:, 4 * self.count :].reshape(frames * self.ratio, channels)
        if scale > 0 and "UNSIGNED" in self.texts("ANALOG", "FORMAT"):
            analogs = analogs.astype(np.int64) & 0xFFFF

        def each(key: str, default: float) -> FloatArray:
            stated = [float(value) for value in self.values("ANALOG", key)][:channels]
            return np.array(stated + [default] * (channels - len(stated)))

        general = float((self.values("ANALOG", "GEN_SCALE") or [1.0])[0])
        self.analogs = (analogs - each("OFFSET", 0.0)) * each("SCALE", 1.0) * general
        self.poses = np.empty((0, 0, 4, 4))
        used, block = (self.values("ROTATION", key) for key in ("USED", "DATA_START"))
        if used and block and int(used[0]) > 0:
            bodies, start = int(used[0]), ((int(block[0]) & 0xFFFF) - 1) * _BLOCK
            ratio = int((self.values("ROTATION", "RATIO") or [1])[0])
            there = max(len(self.data) - start, 0) // (4 * _POSE * bodies)
            taken = min(named * max(ratio, 1), there)
            rows = self._numbers("f4", start, taken * bodies * _POSE).reshape(taken, bodies, _POSE)
            self.poses = np.swapaxes(rows[..., :16].reshape(taken, bodies, 4, 4), 2, 3)


def _open(source: Source) -> _C3d:
    processor = _processor(source)
    if not processor:
        raise LogError(f"{source.path}: not a C3D file (no parameter section where its first byte points)")
    return _C3d(source.path, source.read_bytes(), processor)


def _frame_notes(file: _C3d) -> list[Finding]:
    """Return notes where the header names more frames than are there, or cannot name all that are."""
    frames, named = len(file.points), file.last - file.first + 1
    cut = promised_note("the header's number of frames", named, frames) if file.count else []
    if file.last != _LAST_FRAME:
        # Whole blocks are written, or nothing behind the last frame.
        size = len(file.data)
        return cut or (length_note(file.end, size) if size % _BLOCK and not len(file.poses) else [])
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


def _rate(path: str, stated: Any) -> float:
    try:
        return known_rate(float(stated))
    except ValueError:
        raise LogError(f"{path}: states {stated!r} frames per second; export it again") from None


def _labels(file: _C3d, group: str, count: int, default: str) -> list[str]:
    stated = file.texts(group, "LABELS")[:count]
    stated += [""] * (count - len(stated))
    return unique_names([label or f"{default}{i + 1}" for i, label in enumerate(stated)])


def _add_markers(file: _C3d, length_unit: str | None, raw: RawCapture) -> None:
    frames, count, _ = file.points.shape
    if not count or not frames:
        return
    rate = _rate(file.path, file.rate)
    scale = length_factor(file.path, file.texts("POINT", "UNITS"), length_unit)
    time = (file.first - 1 + np.arange(frames)) / rate
    for i, name in enumerate(_labels(file, "POINT", count, "point ")):
        position = file.points[:, i, :3] * scale
        position[~np.isfinite(position).all(axis=1) | (file.points[:, i, 3] < 0.0)] = np.nan
        raw.markers[name] = time, position


def _add_rotations(file: _C3d, length_unit: str | None, raw: RawCapture) -> None:
    frames, count = file.poses.shape[:2]
    if not count or not frames:
        return
    rate = _rate(file.path, (file.values("ROTATION", "RATE") or [file.rate])[0])
    scale = length_factor(file.path, file.texts("POINT", "UNITS"), length_unit)
    time = (file.first - 1) / (file.rate or rate) + np.arange(frames) / rate
    for i, name in enumerate(_labels(file, "ROTATION", count, "body ")):
        matrix = file.poses[:, i, :3, :3]
        whole = np.isfinite(matrix).all(axis=(1, 2))
        square = np.einsum("nij,nik->njk", matrix, matrix)
        good = whole & (np.abs(np.nan_to_num(square) - np.eye(3)).max(axis=(1, 2)) < 0.02)
        position: FloatArray = np.where(good[:, None], file.poses[:, i, :3, 3] * scale, np.nan)
        raw.bodies.append(Body(name, time, position, matrix_quaternions(matrix, good)))
    raw.notes.append(note("poses-from-file", "poses from the file's ROTATION group"))


def _add_analogs(file: _C3d, raw: RawCapture) -> None:
    samples, count = file.analogs.shape
    rate = file.rate * file.ratio
    if not count or not samples or not rate > 0:
        return
    units = file.texts("ANALOG", "UNITS")
    time = (file.first - 1) / file.rate + np.arange(samples) / rate
    for i, label in enumerate(_labels(file, "ANALOG", count, "")):
        stated = units[i] if i < len(units) else ""
        stated = _ANALOG_UNITS.get(stated.casefold(), stated)
        raw.add_signal(f"analog/{label}", stated, time, file.analogs[:, i])


def _parse(source: Source, options: CaptureOptions) -> RawCapture:
    path = source.path
    file = _open(source)
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
