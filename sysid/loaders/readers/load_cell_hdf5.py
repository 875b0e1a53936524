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
file, the nearest wins, and a dataset of its own rate has its own clock. NaN marks a sample that was not
delivered. Names are those that `load_cell_csv` knows, in any case; other names are given by the option
``datasets``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import LogError
from sysid.loaders.columns import split_label
from sysid.loaders.hdf5_damage import check_heaps
from sysid.loaders.load_cell import CELL_AXES
from sysid.loaders.registry import CERTAIN, NO, POSSIBLE, LogFormat
from sysid.loaders.signals import Signal, SignalOptions, signal_channels
from sysid.loaders.source import Source
from sysid.recording import FloatArray, Recording

_NAME = "load-cell-hdf5"
# A file of the layout of `sysid_hdf5` says so in this attribute.
LAYOUT_ATTRIBUTE = "sysid_recording"
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
# What h5py raises on a damaged file; it has no exception of its own.
_DAMAGE = (OSError, RuntimeError, ValueError, KeyError, TypeError, OverflowError, MemoryError, AttributeError)
# Compression gains less than this on measured signals: a dataset that claims more is damaged.
_LARGEST_GAIN = 1000
# A matrix with more columns than this is no set of signals.
_MOST_COLUMNS = 64
_RATES = ("rate", "sample_rate", "sampling_rate")


def is_hdf5(source: Source) -> bool:
    """Return whether a file begins as HDF5 does."""
    # A user block (MATLAB writes one) moves the signature to 512 bytes or a power of two beyond.
    return any(source.head.startswith(_SIGNATURE, start) for start in (0, *(512 << k for k in range(7))))


def _datasets(file: Any) -> dict[str, Any]:
    """Return path -> dataset of a file, links to other files not followed."""
    import h5py

    found: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            found["/" + name] = item

    file.visititems(visit)
    return found


def _recognize(source: Source) -> int:
    if not is_hdf5(source) or source.head.startswith(b"MATLAB"):
        return NO
    import h5py

    try:
        with h5py.File(source.path, "r") as file:
            if LAYOUT_ATTRIBUTE in file.attrs:
                return NO
            names = _datasets(file)
            return (
                CERTAIN
                if any(split_label(name.rsplit("/", 1)[-1])[0] in CELL_AXES for name in names)
                else POSSIBLE
            )
    except _DAMAGE:
        return POSSIBLE  # the reader says what is wrong with it


def _attribute(dataset: Any, names: tuple[str, ...]) -> Any:
    """Return the first attribute of one of these names on a dataset, its groups or the file; None if none."""
    node = dataset
    while True:
        for name in names:
            if name in node.attrs:
                value = node.attrs[name]
                value = (
                    value.item() if isinstance(value, np.ndarray | np.generic) and value.size == 1 else value
                )
                return value.decode("utf-8", "replace") if isinstance(value, bytes) else value
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
            f"{path}: dataset {name} claims {dataset.size} samples, more than the file holds; it is damaged"
        )
    found = dataset[()] if column is None else dataset[:, column]
    return np.asarray(found, dtype=np.float64).reshape(-1)


def read(
    source: Source,
    *,
    rate: float | None = None,
    units: Mapping[str, str] | None = None,
    datasets: Mapping[str, str] | None = None,
    pulses_per_revolution: float | None = None,
    time_back: str = "refuse",
) -> Recording:
    """Read a load-cell HDF5.

    Parameters
    ----------
    source : Source
        The log.
    rate : float, optional
        Sample rate [Hz] of every dataset; it wins over attributes and time datasets.
    units : mapping of str to str, optional
        Units by channel or dataset name where the attribute ``unit`` is missing or wrong.
    datasets : mapping of str to str, optional
        Dataset paths by channel (``time command speed thrust torque force_x ...``); exactly these are read.
    pulses_per_revolution : float, optional
        Of a dataset ``Tachometer`` that holds pulses, from which ``speed`` is then found.
    time_back : str
        ``"refuse"`` a log whose time goes back, or ``"drop"`` the samples that do not pass the latest time.

    Returns
    -------
    Recording
        As `load_cell_csv.read`; datasets of another rate are channels on their own clock.

    Raises
    ------
    LogError, UnitError
        One sentence with file, dataset and cause.
    """
    import h5py

    path = source.path
    if not is_hdf5(source):
        raise LogError(f"{path}: not an HDF5 file (its signature is missing); check the format")
    check_heaps(path)
    options = SignalOptions(rate, units, datasets, pulses_per_revolution, time_back)
    try:
        with h5py.File(path, "r") as file:
            return _read_open(source, file, options)
    except _DAMAGE as error:
        raise LogError(f"{path}: HDF5 file is damaged or cut ({error}); copy or export it again") from error


def _signals(path: str, name: str, dataset: Any, file_bytes: int) -> list[Signal]:
    """Return a dataset as signals, a matrix as one by column."""
    shape: tuple[int, ...] = dataset.shape or ()
    if (
        len(shape) != 2
        or not 1 < shape[1] <= _MOST_COLUMNS
        or shape[0] < 2
        or dataset.dtype.kind not in "iuf"
    ):
        return [_signal(path, name, dataset, file_bytes, None)]
    return [_signal(path, name, dataset, file_bytes, column) for column in range(shape[1])]


def _signal(path: str, name: str, dataset: Any, file_bytes: int, column: int | None) -> Signal:
    """Return a dataset as a signal; what it holds is read and checked only when it is asked for."""
    unit = dataset.attrs.get("unit", dataset.attrs.get("units"))
    unit = unit.item() if isinstance(unit, np.ndarray) and unit.size == 1 else unit
    unit = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
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


def _read_open(source: Source, file: Any, options: SignalOptions) -> Recording:
    path, file_bytes = source.path, Path(source.path).stat().st_size
    channels, notes = signal_channels(
        path,
        [
            signal
            for name, dataset in _datasets(file).items()
            for signal in _signals(path, name, dataset, file_bytes)
        ],
        options,
        measured=True,
    )
    device = file.attrs.get("device", "")
    device = device.decode("utf-8", "replace") if isinstance(device, bytes) else str(device)
    return Recording(
        "load-cell", channels, source.provenance(_NAME, device=device, options=options.recorded, notes=notes)
    )


FORMAT = LogFormat(
    _NAME, "six-axis load cell HDF5 (datasets by name, attribute unit, rate)", _recognize, read
)
