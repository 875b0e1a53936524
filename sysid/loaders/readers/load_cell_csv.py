"""Six-axis load-cell CSV, for example at 10 kHz: columns by name stem and unit.

    Time (s),Command (us),Speed (rad/s),Fx (N),Fy (N),Fz (N),Mx (N·m),My (N·m),Mz (N·m)

Any of the columns may be missing but Fz or Mz (a log beside the cell's own may hold speed, voltage or current
alone and is of kind ``signals``); the order is free, and the delimiter comma, semicolon or TAB.
Thrust is Fz and torque Mz with the sign of the file: the mounting of the cell is not the log's to know.
Ignores cross-talk and temperature: the writer's calibration is taken as it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sysid.errors import LogError
from sysid.journal import note
from sysid.loaders.clock import DECLARE_RATE, jitter_note, order_rows, positive_rate, rate_clock
from sysid.loaders.columns import (
    DeclaredUnits,
    find_column,
    listing,
    missing_column,
    parse_header,
    unread_note,
)  # fmt: skip
from sysid.loaders.load_cell import (
    BESIDE,
    CELL_AXES,
    COMMAND,
    MEASURED,
    QUANTITIES,
    TACHOMETER,
    TIME,
    quantity_channel,
)
from sysid.loaders.registry import CERTAIN, NO, POSSIBLE, LogFormat
from sysid.loaders.source import Source
from sysid.loaders.table import find_header, read_numbers, table_head
from sysid.loaders.tachometer import check_tachometer, pulse_speed
from sysid.loaders.text import read_text
from sysid.recording import Channel, Recording

_NAME = "load-cell-csv"
# What stands above or in the header of ATI's own logs, which have loaders of their own.
_OTHERS = ("rdt sequence", "sampling freq")


def _recognize(source: Source) -> int:
    found = find_header(source.head_lines)
    if found is None:
        return NO
    stems = {column.stem for column in parse_header(found[2])}
    if any(mark in line.casefold() for line in source.head_lines[: found[0] + 1] for mark in _OTHERS):
        return NO
    if stems & CELL_AXES:
        return CERTAIN
    measured = stems & COMMAND and any(stems & QUANTITIES[name].stems for name in MEASURED)
    return POSSIBLE if measured or (stems & TIME and stems & BESIDE) else NO


def read(
    source: Source,
    *,
    rate: float | None = None,
    units: Mapping[str, str] | None = None,
    columns: Sequence[str] | Mapping[str, object] | None = None,
    pulses_per_revolution: float | None = None,
    time_back: str = "refuse",
) -> Recording:
    """Read a load-cell CSV.

    Parameters
    ----------
    source : Source
        The log.
    rate : float, optional
        Sample rate [Hz], for a log without a time column or with one too coarse for its rate; the time
        column, where there is one, must then span the same duration.
    units : mapping of str to str, optional
        Units by channel or column name where the header states none or a wrong one.
    columns : sequence of str or mapping, optional
        Names of all columns in order, for a log without header; or, for one with other names, new name ->
        name in the header, for example ``{"speed": "tach"}``.
    pulses_per_revolution : float, optional
        Of a column ``Tachometer`` that holds pulses, from which ``speed`` is then found.
    time_back : str
        ``"refuse"`` a log whose time goes back, or ``"drop"`` the rows that do not pass the latest time.

    Returns
    -------
    Recording
        Kind ``load-cell``: ``command`` [us, dshot or 1], ``speed`` [rad/s], ``thrust`` [N] (Fz), ``torque``
        [N·m] (Mz), and ``force_x force_y torque_x torque_y voltage current`` where the log has them; signs as
        recorded.

    Raises
    ------
    LogError, UnitError
        One sentence with file, line and cause.
    """
    path = source.path
    if rate is not None:
        rate = positive_rate(path, rate)
    text = read_text(source)
    head = table_head(text, columns)
    header = parse_header(head.names)
    declared = DeclaredUnits(path, units)
    found = {name: find_column(path, header, quantity.stems) for name, quantity in QUANTITIES.items()}
    quantities = {name: column for name, column in found.items() if column is not None}
    if not any(name in quantities for name in MEASURED) and not {column.stem for column in header} & BESIDE:
        raise missing_column(path, '"Fz" or "Mz"', header)
    command = find_column(path, header, COMMAND)
    pulses = find_column(path, header, TACHOMETER)
    check_tachometer(
        path, {*quantities, *(["tachometer"] if pulses is not None else [])}, pulses_per_revolution
    )
    clock = find_column(path, header, TIME)
    if clock is None and rate is None:
        raise LogError(
            f"{path}: no time column among {listing(column.label for column in header)}; name it with "
            'columns = {time = "..."}, or declare the sample rate [Hz] with rate = ...'
        )
    seconds = declared.factor(clock, "time", "s") if clock else 1.0
    factors = {
        name: declared.factor(column, name, QUANTITIES[name].unit, "rpm" if column.stem == "rpm" else None)
        for name, column in quantities.items()
    }
    unit = declared.command(command) if command else ""
    declared.check_used(header)

    wanted = [*quantities.values(), *([clock] if clock else []), *([command] if command else [])]
    wanted += [pulses] if pulses is not None and pulses_per_revolution is not None else []
    numbers = read_numbers(text, head, [column.index for column in wanted])
    del text  # the file's bytes are not needed any more
    notes = numbers.notes
    if rate is not None:
        stated = numbers.columns[clock.index] * seconds if clock else None
        time = rate_clock(path, rate, numbers.lines.size, stated)
        notes.append(note("time-from-rate", f"time rebuilt from the declared rate of {rate:g} Hz"))
    else:
        assert clock is not None
        time, said = order_rows(path, numbers, clock.index, seconds, time_back=time_back, coarse=DECLARE_RATE)
        notes += [*said, *jitter_note(time)]
    channels = {}
    if command:
        channels["command"] = Channel("command", unit, time, numbers.columns.pop(command.index))
    for name, column in quantities.items():
        values = numbers.columns.pop(column.index)
        if np.isnan(values).all():
            notes.append(note("column-without-values", f"column {column.label!r} holds no value"))
            continue
        channels[name] = quantity_channel(
            name, time, values * factors[name] if factors[name] != 1.0 else values
        )
    if pulses is not None and pulses_per_revolution is not None:
        train = numbers.columns.pop(pulses.index)
        channels["speed"], said = pulse_speed(path, time, train, pulses_per_revolution)
        notes += said
    elif pulses is not None:
        notes.append(
            note(
                "tachometer-left-out",
                f"column {pulses.label!r} looks like the pulses of a tachometer and was left out; "
                "declare pulses_per_revolution to get the speed",
            )
        )
    notes += unread_note(header, [*wanted, *([pulses] if pulses is not None else [])])
    options: dict[str, Any] = {
        "rate": rate, "units": units, "columns": columns, "pulses_per_revolution": pulses_per_revolution,
    }  # fmt: skip
    return Recording(
        "load-cell" if any(name in channels for name in MEASURED) else "signals",
        channels,
        source.provenance(_NAME, options=options, notes=[*notes, *declared.notes]),
    )


FORMAT = LogFormat(_NAME, "six-axis load cell CSV (time or rate, command, speed, Fz, Mz)", _recognize, read)
