"""Six-axis load-cell HDF5, for example at 10 kHz: one dataset per quantity, named like the CSV's columns.

There is no common layout, so this one is ours; everything but Fz or Mz may be missing::

    /                  attributes: rate [Hz], start [s] (0 when absent), device (text)
    /Command     (n,)  attribute unit = "us", "dshot" or "1"
    /Speed       (n,)  attribute unit = "rad/s"
    /Fx ... /Fz  (n,)  attribute unit = "N"
    /Mx ... /Mz  (n,)  attribute unit = "N·m"
    /time        (n,)  attribute unit = "s"; in place of rate

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
from sysid.loaders.clock import order_rows, positive_rate, rate_clock
from sysid.loaders.columns import Column, DeclaredUnits, listing, split_label
from sysid.loaders.load_cell import CELL_AXES, COMMAND, MEASURED, QUANTITIES, TIME, quantity_channel
from sysid.loaders.registry import CERTAIN, NO, POSSIBLE, LogFormat
from sysid.loaders.source import Source
from sysid.loaders.table import Numbers
from sysid.recording import Channel, FloatArray, Recording

_NAME = "load-cell-hdf5"
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
# What h5py raises on a damaged file; it has no exception of its own.
_DAMAGE = (OSError, RuntimeError, ValueError, KeyError, TypeError, OverflowError, MemoryError, AttributeError)
# Compression gains less than this on measured signals: a dataset that claims more is damaged.
_LARGEST_GAIN = 1000


def _is_hdf5(source: Source) -> bool:
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


def _stem(path: str) -> str:
    return split_label(path.rsplit("/", 1)[-1])[0]


def _recognize(source: Source) -> int:
    if not _is_hdf5(source):
        return NO
    import h5py

    try:
        with h5py.File(source.path, "r") as file:
            return CERTAIN if any(_stem(path) in CELL_AXES for path in _datasets(file)) else POSSIBLE
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


def _values(path: str, name: str, dataset: Any, file_bytes: int) -> FloatArray:
    """Return a dataset as one row of numbers."""
    shape = dataset.shape or ()
    if dataset.dtype.kind not in "iuf" or sum(size != 1 for size in shape) > 1 or dataset.size is None:
        raise LogError(
            f"{path}: dataset {name} is {dataset.dtype} of shape {shape}; expected one row of numbers"
        )
    if dataset.size * dataset.dtype.itemsize > _LARGEST_GAIN * file_bytes:
        raise LogError(
            f"{path}: dataset {name} claims {dataset.size} samples, more than the file holds; it is damaged"
        )
    return np.asarray(dataset[()], dtype=np.float64).reshape(-1)


def _choose(path: str, found: dict[str, Any], named: Mapping[str, str] | None) -> dict[str, str]:
    """Return channel -> dataset path, ``time`` and ``command`` included."""
    stems = {"time": TIME, "command": COMMAND, **{name: q.stems for name, q in QUANTITIES.items()}}
    if named is not None:
        if not isinstance(named, Mapping):
            raise LogError(
                f'{path}: datasets = {named!r} is no table; expected for example {{thrust = "/ft/Fz"}}'
            )
        chosen = {}
        for channel, where in named.items():
            if channel not in stems:
                raise LogError(f'{path}: datasets names "{channel}"; it can name {", ".join(stems)}')
            full = "/" + str(where).strip("/")
            if full not in found:
                raise LogError(f"{path}: no dataset {full}; found {listing(found)}")
            chosen[channel] = full
    else:
        chosen = {}
        for channel, known in stems.items():
            matches = [where for where in found if _stem(where) in known]
            if len(matches) > 1 and channel != "time":
                raise LogError(
                    f"{path}: datasets {matches[0]} and {matches[1]} both look like {channel}; "
                    f'choose with datasets = {{{channel} = "{matches[0]}", ...}}'
                )
            if len(matches) == 1:
                chosen[channel] = matches[0]
    if not any(channel in chosen for channel in MEASURED):
        raise LogError(
            f'{path}: no dataset "Fz" or "Mz"; found {listing(found)}; '
            'name them with datasets = {thrust = "...", torque = "..."}'
        )
    return chosen


def _time_of(found: dict[str, Any], chosen: dict[str, str], where: str) -> str | None:
    """Return the path of the time dataset beside a dataset, else of the only one there is, else None."""
    beside = [
        other
        for other in found
        if other.rsplit("/", 1)[0] == where.rsplit("/", 1)[0] and _stem(other) in TIME
    ]
    return beside[0] if len(beside) == 1 else chosen.get("time")


def read(
    source: Source,
    *,
    rate: float | None = None,
    units: Mapping[str, str] | None = None,
    datasets: Mapping[str, str] | None = None,
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
    if not _is_hdf5(source):
        raise LogError(f"{path}: not an HDF5 file (its signature is missing); check the format")
    if rate is not None:
        rate = positive_rate(path, rate)
    try:
        with h5py.File(path, "r") as file:
            return _read_open(source, file, rate, units, datasets, time_back)
    except _DAMAGE as error:
        raise LogError(f"{path}: HDF5 file is damaged or cut ({error}); copy or export it again") from error


def _read_open(
    source: Source,
    file: Any,
    rate: float | None,
    units: Mapping[str, str] | None,
    datasets: Mapping[str, str] | None,
    time_back: str,
) -> Recording:
    path, file_bytes = source.path, Path(source.path).stat().st_size
    found = _datasets(file)
    chosen = _choose(path, found, datasets)
    declared = DeclaredUnits(path, units)
    header = tuple(
        Column(index, where.rsplit("/", 1)[-1], *split_label(where.rsplit("/", 1)[-1]))
        for index, where in enumerate(found)
    )
    columns = {}
    for column, (where, dataset) in zip(header, found.items(), strict=True):
        stated = dataset.attrs.get("unit", dataset.attrs.get("units"))
        stated = stated.decode("utf-8", "replace") if isinstance(stated, bytes) else stated
        unit = column.unit if stated is None else str(stated)
        columns[where] = Column(column.index, column.label, column.stem, unit)

    notes: list[str] = []
    channels: dict[str, Channel] = {}
    clocks: dict[str, Numbers] = {}
    members: dict[str, list[str]] = {}
    for channel, where in chosen.items():
        if channel == "time":
            continue
        values = _values(path, where, found[where], file_bytes)
        values = np.where(np.isinf(values), np.nan, values)
        beside = _time_of(found, chosen, where)
        stated_rate = (
            _attribute(found[where], ("rate", "sample_rate", "sampling_rate")) if rate is None else rate
        )
        if beside is None or rate is not None:
            if stated_rate is None:
                raise LogError(
                    f"{path}: dataset {where} has no clock: no dataset time beside it and no attribute rate; "
                    "declare the sample rate [Hz] with rate = ..."
                )
            own_rate = positive_rate(path, stated_rate)
            start = _attribute(found[where], ("start",))
            if start is not None and not (isinstance(start, int | float) and np.isfinite(start)):
                raise LogError(f"{path}: attribute start of {where} is {start!r}; expected seconds")
            time = rate_clock(path, own_rate, values.size) + float(start or 0.0)
            key = f"{own_rate!r} {start!r} {values.size}"
        else:
            factor = declared.factor(columns[beside], "time", "s", "s")
            time, key = _values(path, beside, found[beside], file_bytes) * factor, beside
            if time.size != values.size:
                raise LogError(
                    f"{path}: dataset {where} has {values.size} samples but its clock {beside} has "
                    f"{time.size}; they must be of one length"
                )
        if not values.size:
            raise LogError(f"{path}: dataset {where} is empty; the log has no samples")
        group = clocks.setdefault(key, Numbers({0: time}, np.arange(1, time.size + 1), row_word="sample"))
        members.setdefault(key, []).append(channel)
        group.columns[len(members[key])] = values

    for key, names in members.items():
        time, said = order_rows(path, clocks[key], 0, 1.0, time_back=time_back)
        notes += said
        for index, channel in enumerate(names, start=1):
            column, values = columns[chosen[channel]], clocks[key].columns[index]
            if channel == "command":
                channels[channel] = Channel(channel, declared.command(column), time, values)
            else:
                default = "rpm" if column.stem == "rpm" else None
                factor = declared.factor(column, channel, QUANTITIES[channel].unit, default)
                channels[channel] = quantity_channel(channel, time, values * factor)
    declared.check_used(tuple(columns.values()))
    device = file.attrs.get("device", "")
    device = device.decode("utf-8", "replace") if isinstance(device, bytes) else str(device)
    options = {"rate": rate, "units": units, "datasets": datasets}
    return Recording(
        "load-cell",
        channels,
        source.provenance(_NAME, device=device, options=options, notes=[*notes, *declared.notes]),
    )


FORMAT = LogFormat(
    _NAME, "six-axis load cell HDF5 (datasets by name, attribute unit, rate)", _recognize, read
)
