"""Six-axis load-cell HDF5, for example at 10 kHz: one dataset per quantity, named like the CSV's columns.

There is no common layout, so this one is ours; everything but Fz or Mz may be missing::

    /                  attributes: rate [Hz], start [s] (0 when absent), device (text)
    /Command     (n,)  attribute unit = "us", "dshot" or "1"
    /Speed       (n,)  attribute unit = "rad/s"
    /Fx ... /Fz  (n,)  attribute unit = "N"
    /Mx ... /Mz  (n,)  attribute unit = "N·m"
    /time        (n,)  attribute unit = "s"; in place of rate
    /FT        (n, k)  is k datasets /FT[1] ... /FT[k], named with the option ``datasets``

Datasets may lie in a group; ``rate`` and ``start`` may be attributes of the dataset, of its group or of the
file, the nearest wins, and a dataset with another rate has another clock. NaN marks a sample that was not
delivered. Names are those that `load_cell_csv` knows, in any case; other names are given by the option
``datasets``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import LogError
from sysid.loaders.binary import check_heaps, reading
from sysid.loaders.columns import split_label
from sysid.loaders.load_cell import CELL_AXES
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO, POSSIBLE
from sysid.loaders.signal_log import SIGNAL_OPTIONS, RawSignals, Signal, signal_format
from sysid.loaders.source import Source
from sysid.types import FloatArray

# The attribute that marks a file in the layout of `sysid_hdf5`.
LAYOUT_ATTRIBUTE = "sysid_recording"
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
# Compression gains less than this on measured signals: a dataset that claims more is damaged.
_LARGEST_GAIN = 1000
# A matrix with more columns than this is no set of signals.
_MOST_COLUMNS = 64
_RATES = ("rate", "sample_rate", "sampling_rate")


def is_hdf5(source: Source) -> bool:
    """Return whether a file begins as HDF5 does."""
    # A user block (MATLAB writes one) moves the signature to 512 bytes or a power of two beyond.
    return any(source.head.startswith(_SIGNATURE, start) for start in (0, *(512 << k for k in range(7))))


@contextmanager
def open_hdf5(source: Source, remedy: str) -> Iterator[Any]:
    """Open an HDF5 log, refusing one that is none or is damaged, also while it is read."""
    import h5py

    if not is_hdf5(source):
        raise LogError(f"{source.path}: not an HDF5 file (its signature is missing); check the format")
    check_heaps(source.path)
    with reading(source.path, "HDF5 file", remedy), h5py.File(source.path, "r") as file:
        yield file


def hdf5_datasets(file: Any) -> dict[str, Any]:
    """Return path -> dataset of a file or a group, links to other files not followed."""
    import h5py

    datasets: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            datasets["/" + name] = item

    file.visititems(visit)
    return datasets


def _recognize(source: Source) -> int:
    if not is_hdf5(source) or source.head.startswith(b"MATLAB"):
        return NO
    try:
        with open_hdf5(source, "") as file:
            if LAYOUT_ATTRIBUTE in file.attrs:
                return NO
            stems = {split_label(name.rsplit("/", 1)[-1])[0] for name in hdf5_datasets(file)}
            return CERTAIN if stems & CELL_AXES else POSSIBLE
    except LogError:
        return POSSIBLE  # the reader refuses it


def attribute_value(value: Any) -> Any:
    """Return an attribute as a number or as text, whatever of the two HDF5 wrapped."""
    value = value.item() if isinstance(value, np.ndarray | np.generic) and value.size == 1 else value
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _attribute(dataset: Any, names: tuple[str, ...]) -> Any:
    """Return the first attribute of one of these names on a dataset, its groups or the file; None if none."""
    node = dataset
    while True:
        for name in names:
            if name in node.attrs:
                return attribute_value(node.attrs[name])
        if node.name == "/":
            return None
        node = node.parent


def _values(path: str, name: str, dataset: Any, file_bytes: int, column: int | None = None) -> FloatArray:
    """Return a dataset, or a column of it, as one row of numbers."""
    shape = dataset.shape or ()
    wide = column is None and sum(size != 1 for size in shape) > 1
    if dataset.dtype.kind not in "iuf" or wide or dataset.size is None:
        raise LogError(
            f"{path}: dataset {name} is {dataset.dtype} of shape {shape}; expected one row of numbers"
        )
    if dataset.size * dataset.dtype.itemsize > _LARGEST_GAIN * file_bytes:
        raise LogError(
            f"{path}: dataset {name} claims {dataset.size} samples, more than its file has; it is damaged"
        )
    samples = dataset[()] if column is None else dataset[:, column]
    return np.asarray(samples, dtype=np.float64).reshape(-1)


def _columns(dataset: Any) -> Sequence[int | None]:
    """Return the columns of a matrix of signals, or None alone for a dataset that is one signal."""
    shape: tuple[int, ...] = dataset.shape or ()
    matrix = len(shape) == 2 and 1 < shape[1] <= _MOST_COLUMNS and shape[0] >= 2
    return range(shape[1]) if matrix and dataset.dtype.kind in "iuf" else (None,)


def _signal(path: str, name: str, dataset: Any, file_bytes: int, column: int | None) -> Signal:
    """Return a dataset as a signal, whose samples are read and checked only on demand."""
    unit = attribute_value(dataset.attrs.get("unit", dataset.attrs.get("units")))
    start = _attribute(dataset, ("start",))
    if start is not None and not (isinstance(start, int | float) and np.isfinite(start)):
        raise LogError(f"{path}: attribute start of {name} is {start!r}; expected seconds")
    return Signal(
        name if column is None else f"{name}[{column + 1}]",
        None if unit is None else str(unit),
        lambda: _values(path, name, dataset, file_bytes, column),
        _attribute(dataset, _RATES),
        float(start or 0.0),
        inherited=not any(key in dataset.attrs for key in _RATES),
        numbered=column is not None,
    )


@contextmanager
def _parse(source: Source, options: BenchOptions) -> Iterator[RawSignals]:
    path = source.path
    with open_hdf5(source, "copy or export it again") as file:
        file_bytes = Path(path).stat().st_size
        signals = [
            _signal(path, name, dataset, file_bytes, column)
            for name, dataset in hdf5_datasets(file).items()
            for column in _columns(dataset)
        ]
        yield RawSignals(signals, str(attribute_value(file.attrs.get("device", ""))))


FORMAT = signal_format(
    "load-cell-hdf5", "six-axis load cell HDF5 (datasets by name, attribute unit, rate)", _recognize, _parse,
    SIGNAL_OPTIONS,
)  # fmt: skip
