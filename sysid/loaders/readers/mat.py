"""MATLAB files, version 5 (scipy) and 7.3 (HDF5): variables and struct fields by name.

    Fz, Mz, Speed, Command          vectors, or structs with the fields data (or values), unit, rate
    time  or  rate (fs)             beside them: in the same struct, or at the top
    FT                              an (n, k) matrix is k signals FT[1] ... FT[k]

Units that no struct states, also of time, must be declared. Ignores objects (timeseries, tables), which
have no plain arrays.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from sysid.errors import LogError
from sysid.loaders.binary import check_heaps, reading
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.signal_log import SIGNAL_OPTIONS, RawSignals, Signal, signal_format, written_unit
from sysid.loaders.source import Source

_V5, _V73 = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"
_RATES = frozenset({"rate", "fs", "sample_rate", "sampling_rate", "samplerate"})
_VALUES = ("data", "values")
# A matrix with more columns than this is no set of signals.
_MOST_COLUMNS = 64
Tree = dict[str, Any]


def _recognize(source: Source) -> int:
    return CERTAIN if source.head.startswith((_V5, _V73)) else NO


def _tree_v73(path: str) -> Tree:
    import h5py

    check_heaps(path)

    def branch(group: Any) -> Tree:
        out: Tree = {}
        for name, item in group.items():
            if name.startswith("#"):
                continue
            if isinstance(item, h5py.Group):
                out[name] = branch(item)
            elif item.attrs.get("MATLAB_class", b"") == b"char":
                out[name] = "".join(chr(code) for code in np.asarray(item[()]).T.ravel())
            elif item.dtype.kind in "iuf" and not item.attrs.get("MATLAB_empty", 0):
                out[name] = np.asarray(item[()]).T  # MATLAB writes columns first
        return out

    with h5py.File(path, "r") as file:
        return branch(file)


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
    from scipy.io import loadmat  # takes long to import

    passed_over: list[str] = []
    with reading(path, "MATLAB file", "save it again"):
        if source.head.startswith(_V5):
            loaded = loadmat(path, simplify_cells=True)
            tree = {name: value for name, value in loaded.items() if not name.startswith("__")}
        else:
            tree = _tree_v73(path)
        yield RawSignals(list(_walk(tree, "", None, passed_over)), passed_over=passed_over)


FORMAT = signal_format(
    "mat", "MATLAB file 5 or 7.3 (variables by name, rate)", _recognize, _parse, SIGNAL_OPTIONS
)
