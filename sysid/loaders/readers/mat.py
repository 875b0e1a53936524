"""MATLAB files, version 5 and 7.3 (HDF5): variables and struct fields by name.

    Fz, Mz, Speed, Command          vectors, or structs with the fields data (or values), unit, rate
    time  or  rate (fs)             beside them: in the same struct, or at the top
    FT                              an (n, k) matrix is k signals FT[1] ... FT[k]

Units that no struct states, also of time, must be declared. Ignores objects (timeseries, tables) and sparse
matrices, which have no plain arrays. Version 5 is read here (MathWorks, MAT-File Format): the parser of scipy
ends the process on some damaged files.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import LogError
from sysid.journal import Finding
from sysid.loaders.binary import check_claim, most_bytes, reading
from sysid.loaders.hdf5 import open_hdf5
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.signal_log import SIGNAL_OPTIONS, RawSignals, Signal, signal_format, written_unit
from sysid.loaders.source import Source, shortened

_V5, _V73 = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"
_RATES = frozenset({"rate", "fs", "sample_rate", "sampling_rate", "samplerate"})
_VALUES = ("data", "values")
# A matrix with more columns than this is no set of signals.
_MOST_COLUMNS = 64
Tree = dict[str, Any]


def _recognize(source: Source) -> int:
    return CERTAIN if source.head.startswith((_V5, _V73)) else NO


# Types of stored numbers and texts; the classes of arrays of them, of cells, structs and texts.
_STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _CHAR, _NUMBERS = 1, 2, 4, range(6, 16)
_LOGICAL, _COMPLEX = 0x200, 0x800


class _Elements:
    """Elements of a version 5 file, one after the other: a type, a length, and as many bytes."""

    def __init__(self, data: memoryview, big: bool) -> None:
        self.data, self.big, self.at = data, big, 0

    def __iter__(self) -> Iterator[tuple[int, memoryview]]:
        while self.at < len(self.data):
            yield self.next()

    def next(self) -> tuple[int, memoryview]:
        """Return type and content of the next element; ValueError where the data end before it does."""
        order = ">" if self.big else "<"
        (kind,) = struct.unpack_from(order + "I", self.data, self.at)
        if kind >> 16:  # up to four bytes beside the type
            kind, length, begin, step = kind & 0xFFFF, kind >> 16, self.at + 4, 8
        else:
            (length,) = struct.unpack_from(order + "I", self.data, self.at + 4)
            begin, step = self.at + 8, 8 + (length if kind == _COMPRESSED else (length + 7) // 8 * 8)
        if begin + length > len(self.data):
            raise ValueError(f"an element of {length} bytes at byte {self.at} of {len(self.data)}")
        self.at += step
        return kind, self.data[begin : begin + length]

    def numbers(self) -> NDArray[Any]:
        """Return the numbers of the next element."""
        kind, content = self.next()
        return np.frombuffer(content, (">" if self.big else "<") + _STORED[kind])

    def text(self) -> str:
        """Return the text of the next element."""
        kind, content = self.next()
        coding = _TEXTS[kind]
        coding += ("-be" if self.big else "-le") if coding in ("utf-16", "utf-32") else ""
        return bytes(content).decode(coding, "replace")


def _matrix(data: memoryview, big: bool) -> tuple[str, Any]:
    """Return name and value of an array; None for objects and other arrays that are no numbers."""
    if not len(data):
        return "", np.empty(0)
    parts = _Elements(data, big)
    flags = int(parts.numbers()[0])
    shape = [int(size) for size in parts.numbers()]
    name, kind, count = parts.text(), flags & 0xFF, math.prod(shape)
    if min(shape) < 0 or (kind != _CHAR and count > 8 * len(data)):  # more than the bytes of the element
        raise ValueError(f"array {shortened(name)!r} claims {' × '.join(map(str, shape))} numbers")
    if kind in _NUMBERS and not count:
        return name, np.empty(0)
    if kind in _NUMBERS:
        array = parts.numbers()
        if flags & _COMPLEX:
            array = array + 1j * parts.numbers()
        array = array.astype(bool) if flags & _LOGICAL else array
        return name, array.reshape(shape, order="F").squeeze()
    if kind == _CHAR:
        return name, parts.text() if count else ""
    if kind == _CELL:
        cells = np.empty(count, dtype=object)
        for i in range(count):
            cells[i] = _matrix(parts.next()[1], big)[1]
        return name, cells.reshape(shape, order="F").squeeze()
    if kind == _STRUCT:
        width = int(parts.numbers()[0])
        joined = bytes(parts.next()[1])
        keys = [joined[i : i + width].split(b"\0")[0].decode() for i in range(0, len(joined), max(width, 1))]
        structs = [{key: _matrix(parts.next()[1], big)[1] for key in keys} for _ in range(count)]
        return name, structs[0] if count == 1 else structs
    return name, None


def _tree_v5(source: Source) -> Tree:
    data = memoryview(source.read_bytes())
    big = bytes(data[126:128]) == b"MI"
    most = most_bytes(len(data))
    tree: Tree = {}
    for kind, content in _Elements(data[128:], big):
        if kind == _COMPRESSED:
            unpacked = zlib.decompressobj()
            whole = memoryview(unpacked.decompress(content, int(most) + 1))
            check_claim(source.path, "a compressed variable", len(whole), most)
            if not unpacked.eof:
                raise ValueError("a compressed variable is cut")
            most -= len(whole)
            kind, content = next(iter(_Elements(whole, big)))
        if kind == _MATRIX:
            name, value = _matrix(content, big)
            tree |= {name: value} if name else {}  # without a name: what objects refer to
    return tree


def _tree_v73(source: Source, notes: list[Finding]) -> Tree:
    tree: Tree = {}
    with open_hdf5(source, "save it again") as log:
        notes += log.notes
        for name, item in log.datasets.items():
            *groups, last = name.strip("/").split("/")
            branch = tree
            if groups and groups[0].startswith("#"):
                continue
            for group in groups:
                branch = branch.setdefault(group, {})
            if item.attrs.get("MATLAB_class", b"") == b"char" and item.dtype.kind == "u":
                branch[last] = "".join(chr(int(code)) for code in log.numbers(name, item).T.ravel())
            elif item.dtype.kind in "iuf" and not item.attrs.get("MATLAB_empty", 0):
                branch[last] = log.numbers(name, item).T  # MATLAB writes columns first
    return tree


def _rate_in(branch: Tree) -> float | None:
    array = np.asarray(next((value for name, value in branch.items() if name.casefold() in _RATES), None))
    return float(array.reshape(-1)[0]) if array.size == 1 and array.dtype.kind in "iuf" else None


def _described(name: str, value: object) -> str:
    """Return a variable that is no signal with its shape, for messages: ``FT (6 × 2000 matrix)``."""
    if isinstance(value, list):
        return f"{name.lstrip('/')} (array of {len(value)} structs)"
    array = np.asarray(value)
    shape = " × ".join(str(size) for size in array.shape)
    kind = {"O": "cells or structs", "c": "complex numbers", "b": "logicals"}.get(array.dtype.kind, "")
    return f"{name.lstrip('/')} ({shape} {kind or ('matrix' if array.ndim == 2 else 'array')})"


def _walk(branch: Tree, where: str, rate: float | None, passed_over: list[str]) -> Iterator[Signal]:
    stated = _rate_in(branch)
    rate = rate if stated is None else stated
    for name, value in branch.items():
        full = f"{where}/{name}"
        if isinstance(value, dict):
            inner = next((value[key] for key in _VALUES if key in value), None)
            if isinstance(inner, np.ndarray):
                unit = next(
                    (text for text in map(value.get, ("unit", "units")) if isinstance(text, str)), None
                )
                inner_rate = _rate_in(value)
                array_rate = rate if inner_rate is None else inner_rate
                yield from _arrays(full, inner, unit, array_rate, inner_rate is None, passed_over)
            else:
                yield from _walk(value, full, rate, passed_over)
        elif isinstance(value, np.ndarray):
            yield from _arrays(full, value, None, rate, True, passed_over)
        elif isinstance(value, list):
            passed_over.append(_described(full, value))


def _arrays(
    name: str, array: Any, unit: str | None, rate: float | None, inherited: bool, passed_over: list[str]
) -> Iterator[Signal]:
    if array.size < 2 or array.dtype.kind in "USV":  # settings and words
        return
    if array.dtype.kind not in "iuf":
        passed_over.append(_described(name, array))
        return
    if sum(size != 1 for size in array.shape) == 1:
        columns = {name: array.reshape(-1)}
    elif array.ndim == 2 and array.shape[1] <= _MOST_COLUMNS:
        columns = {f"{name}[{k + 1}]": array[:, k] for k in range(array.shape[1])}
    else:
        passed_over.append(_described(name, array))
        return
    for label, values in columns.items():
        read = partial(np.asarray, values, dtype=np.float64)
        yield Signal(label, written_unit(unit), read, rate, inherited=inherited, numbered=label != name)


@contextmanager
def _parse(source: Source, options: BenchOptions) -> Iterator[RawSignals]:
    path = source.path
    if not source.head.startswith((_V5, _V73)):
        raise LogError(
            f"{path}: not a MATLAB file of version 5 or 7.3 (its first line does not say so); "
            "save it again, for example with save(name, '-v7')"
        )
    passed_over: list[str] = []
    notes: list[Finding] = []
    with reading(path, "MATLAB file", "save it again"):
        tree = _tree_v5(source) if source.head.startswith(_V5) else _tree_v73(source, notes)
        yield RawSignals(list(_walk(tree, "", None, passed_over)), passed_over=passed_over, notes=notes)


FORMAT = signal_format(
    "mat", "MATLAB file 5 or 7.3 (variables by name, rate)", _recognize, _parse, SIGNAL_OPTIONS,
    foreign=True,
)  # fmt: skip
