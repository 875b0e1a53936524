"""MATLAB files, version 5 and 7.3 (HDF5): variables and struct fields by name.

    Fz, Mz, Speed, Command          vectors, or structs with the fields data (or values), unit, rate
    time  or  rate (fs)             beside them: in the same struct, or at the top
    FT                              an (n, k) matrix is k signals FT[1] ... FT[k]

Units that no struct states, also of time, must be declared. Ignores objects (timeseries, tables) and sparse
matrices, which have no plain arrays.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding
from sysid.loaders.hdf5 import open_hdf5
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


def _tree_v5(source: Source) -> Tree:
    from scipy.io import loadmat, whosmat

    logical = {name for name, _, kind in whosmat(source.path) if kind == "logical"}
    # Three names of the file itself begin with two underscores, which no variable of MATLAB may.
    tree: Tree = loadmat(source.path, simplify_cells=True)
    return {
        name: np.asarray(value, dtype=bool) if name in logical else value  # loadmat returns uint8
        for name, value in tree.items()
        if not name.startswith("__")
    }


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
    tree = _tree_v5(source) if source.head.startswith(_V5) else _tree_v73(source, notes)
    yield RawSignals(list(_walk(tree, "", None, passed_over)), passed_over=passed_over, notes=notes)


FORMAT = signal_format(
    "mat", "MATLAB file 5 or 7.3 (variables by name, rate)", _recognize, _parse, SIGNAL_OPTIONS,
    foreign=True,
)  # fmt: skip
