"""Six-axis load-cell HDF5, for example at 10 kHz: one dataset per quantity, named like the CSV's columns.

There is no common layout, so this one is ours; everything but Fz or Mz may be missing::

    /                  attributes: rate [Hz], start [s] (0 when absent), device (text)
    /Command     (n,)  attribute unit = "us", "dshot", "1" or "%"
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

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from sysid.errors import LogError
from sysid.loaders.columns import split_label
from sysid.loaders.hdf5 import Hdf5Log, attribute_value, is_hdf5, open_hdf5
from sysid.loaders.load_cell import CELL_AXES
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO, POSSIBLE
from sysid.loaders.signal_log import SIGNAL_OPTIONS, RawSignals, Signal, signal_format
from sysid.loaders.source import Source
from sysid.types import FloatArray

if TYPE_CHECKING:
    import h5py

# The attribute that marks a file in the layout of `sysid_hdf5`.
LAYOUT_ATTRIBUTE = "sysid_recording"
# A matrix with more columns than this is no set of signals.
_MOST_COLUMNS = 64
_RATES = ("rate", "sample_rate", "sampling_rate")


def _recognize(source: Source) -> int:
    if not is_hdf5(source) or source.head.startswith(b"MATLAB"):
        return NO
    try:
        with open_hdf5(source, "") as log:
            if LAYOUT_ATTRIBUTE in log.file.attrs:
                return NO
            stems = {split_label(name.rsplit("/", 1)[-1])[0] for name in log.datasets}
            return CERTAIN if stems & CELL_AXES else POSSIBLE
    except LogError:
        return POSSIBLE  # the reader refuses it


def _attribute(dataset: h5py.Dataset, names: tuple[str, ...]) -> object:
    """Return the first attribute of one of these names on a dataset, its groups or the file; None if none."""
    node = dataset
    while True:
        for name in names:
            if name in node.attrs:
                return attribute_value(node.attrs[name])
        if node.name == "/":
            return None
        node = node.parent


def _values(log: Hdf5Log, name: str, dataset: h5py.Dataset, column: int | None) -> FloatArray:
    """Return a dataset, or a column of it, as one row of numbers."""
    shape = dataset.shape or ()
    if column is None and sum(size != 1 for size in shape) > 1:
        raise LogError(
            f"{log.path}: dataset {name} is {dataset.dtype} of shape {shape}; expected one row of numbers"
        )
    return log.numbers(name, dataset, column).reshape(-1)


@contextmanager
def _parse(source: Source, options: BenchOptions) -> Iterator[RawSignals]:
    with open_hdf5(source, "copy or export it again") as log:
        signals = []
        for name, dataset in log.datasets.items():
            unit = attribute_value(dataset.attrs.get("unit", dataset.attrs.get("units")))
            start = _attribute(dataset, ("start",))
            if start is not None and not (isinstance(start, int | float) and np.isfinite(start)):
                raise LogError(f"{log.path}: attribute start of {name} is {start!r}; expected seconds")
            rate, inherited = _attribute(dataset, _RATES), not any(key in dataset.attrs for key in _RATES)
            shape: tuple[int, ...] = dataset.shape or ()
            matrix = len(shape) == 2 and 1 < shape[1] <= _MOST_COLUMNS and shape[0] >= 2
            numbers = dataset.dtype.kind in "iuf"
            for column in range(shape[1]) if matrix and numbers else (None,):
                label = name if column is None else f"{name}[{column + 1}]"
                read = partial(_values, log, name, dataset, column)  # the samples are checked on demand
                signals.append(
                    Signal(
                        label, None if unit is None else str(unit), read, rate, float(start or 0.0),
                        inherited=inherited, numbered=column is not None,
                    )
                )  # fmt: skip
        yield RawSignals(signals, str(attribute_value(log.file.attrs.get("device", ""))), notes=log.notes)


FORMAT = signal_format(
    "load-cell-hdf5", "six-axis load cell HDF5 (datasets by name, attribute unit, rate)", _recognize, _parse,
    SIGNAL_OPTIONS,
)  # fmt: skip
