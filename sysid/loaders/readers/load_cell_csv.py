"""Six-axis load-cell CSV, for example at 10 kHz: columns by name stem and unit.

    Time (s),Command (us),Speed (rad/s),Fx (N),Fy (N),Fz (N),Mx (N·m),My (N·m),Mz (N·m)

Any of the columns may be missing but Fz or Mz (a log beside the cell's may have speed, voltage or current
alone and is of kind ``signals``); the order is free, and the delimiter comma, semicolon or TAB.
Thrust is Fz and torque Mz with the sign of the file: the mounting of the cell is not the log's to know.
Ignores cross-talk and temperature: the writer's calibration is taken as it is.
"""

from sysid.errors import LogError
from sysid.loaders.clock import declared_rate, row_clock
from sysid.loaders.columns import NamedTable, listing, parse_header, unread_note
from sysid.loaders.load_cell import (
    BESIDE,
    CELL_AXES,
    COMMAND,
    MEASURED,
    STEMS,
    TACHOMETER,
    TIME,
    UNITS,
    check_tachometer,
    speed_channel,
)
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO, POSSIBLE
from sysid.loaders.source import Source
from sysid.loaders.table import find_header
from sysid.loaders.table_log import NAMED_TABLE, RawTable, table_format
from sysid.recording import Channel

# Words above or in the header of ATI's logs, which other loaders read.
_OTHERS = ("rdt sequence", "sampling freq")


def _recognize(source: Source) -> int:
    header = find_header(source.head_lines)
    if header is None:
        return NO
    stems = {column.stem for column in parse_header(header[2])}
    if any(mark in line.casefold() for line in source.head_lines[: header[0] + 1] for mark in _OTHERS):
        return NO
    if stems & CELL_AXES:
        return CERTAIN
    measured = stems & COMMAND and any(stems & STEMS[name] for name in MEASURED)
    return POSSIBLE if measured or (stems & TIME and stems & BESIDE) else NO


def _parse(source: Source, options: BenchOptions) -> RawTable:
    path, per_revolution = source.path, options.pulses_per_revolution
    rate = declared_rate(path, options.rate)
    table = NamedTable(source, options)
    header, declared = table.columns, table.declared
    matches = {name: table.find(STEMS[name]) for name in UNITS}
    columns = {name: (column, UNITS[name]) for name, column in matches.items() if column is not None}
    if not any(name in columns for name in MEASURED) and not {column.stem for column in header} & BESIDE:
        raise table.missing('"Fz" or "Mz"')
    command = table.find(COMMAND)
    pulses = table.find(TACHOMETER)
    check_tachometer(path, {*columns, *(["tachometer"] if pulses is not None else [])}, per_revolution)
    clock = table.find(TIME)
    if clock is None and rate is None:
        raise LogError(
            f"{path}: no time column among {listing(column.label for column in header)}; name it with "
            'columns = {time = "..."}, or declare the sample rate [Hz] with rate = ...'
        ).asking(rate=None)
    seconds = declared.factor(clock, "time", "s") if clock else 1.0
    factors = {
        name: declared.factor(column, name, unit, "rpm" if column.stem == "rpm" else None)
        for name, (column, unit) in columns.items()
    }
    protocol = declared.command(command) if command else ""
    declared.check_used(header)

    wanted = [column for column, _ in columns.values()]
    wanted += [column for column in (clock, command) if column is not None]
    wanted += [pulses] if pulses is not None and per_revolution is not None else []
    numbers = table.read(wanted)
    notes = numbers.notes
    time, timed = row_clock(path, numbers, clock.index if clock else None, seconds, rate, options)
    notes += timed
    raw = RawTable("signals", "", time, [*notes, *declared.notes])
    if command:
        raw.channels["command"] = Channel("command", protocol, time, numbers.columns.pop(command.index))
    raw.add(numbers.columns, columns, factors)
    if pulses is not None:
        train = None if per_revolution is None else numbers.columns.pop(pulses.index)
        raw.channels |= speed_channel(path, pulses.label, time, train, per_revolution, raw.notes)
    raw.notes += unread_note(header, [*wanted, *([pulses] if pulses is not None else [])])
    if any(name in raw.channels for name in MEASURED):
        raw.kind = "load-cell"
    return raw


FORMAT = table_format(
    "load-cell-csv", "six-axis load cell CSV (time or rate, command, speed, Fz, Mz)", _recognize, _parse,
    {**NAMED_TABLE, "pulses_per_revolution": ()},
)  # fmt: skip
