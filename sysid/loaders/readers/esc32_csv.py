"""Telemetry of an AutoQuad ESC32 as its program writes it: a row per message, some 100 a second.

    Timestamp,Amps,Batt. Volts,Motor Volts,RPM,Duty,Comm. Period,...
    2019-11-05 17:14:08:947,0.00432758,15.7827,0,0,0,34,...

The command is the duty, here a fraction; ``motor_voltage`` is the duty times the battery voltage. Stamps are
times of arrival: several rows may share one, and a declared ``rate`` gives all rows an even clock instead.
Valid beside the log of a stand, with which `sysid convert --add` joins it by the speed.
"""

from __future__ import annotations

from sysid.loaders.clock import declared_rate, row_clock
from sysid.loaders.columns import NamedTable, header_columns, unread_note
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.source import Source
from sysid.loaders.table_log import RawTable, table_format
from sysid.recording import Channel

# Stem in the header, unit of the channel and unit of the column, by channel.
_COLUMNS = {
    "speed": ("rpm", "rad/s", "rpm"),
    "voltage": ("batt volts", "V", "V"),
    "motor_voltage": ("motor volts", "V", "V"),
    "current": ("amps", "A", "A"),
}
_TIME, _DUTY = "timestamp", "duty"


def _recognize(source: Source) -> int:
    stems = {column.stem for column in header_columns(source)}
    return CERTAIN if stems >= {_TIME, _DUTY, "rpm", "batt volts", "motor volts"} else NO


def _parse(source: Source, options: BenchOptions) -> RawTable:
    rate, table = declared_rate(source.path, options.rate), NamedTable(source, options)
    clock, duty = table.find({_TIME}), table.find({_DUTY})
    if clock is None or duty is None:
        raise table.missing('"Timestamp" or "Duty"')
    found = {name: table.find({stem}) for name, (stem, _, _) in _COLUMNS.items()}
    columns = {name: (column, _COLUMNS[name][1]) for name, column in found.items() if column is not None}
    factors = {
        name: table.declared.factor(column, name, unit, _COLUMNS[name][2])
        for name, (column, unit) in columns.items()
    }
    seconds = table.declared.factor(clock, "time", "s")
    table.declared.check_used(table.columns)
    wanted = [clock, duty, *(column for column, _ in columns.values())]
    numbers = table.read(wanted)
    time, notes = row_clock(source.path, numbers, clock.index, seconds, rate, options)
    notes = [*numbers.notes, *notes, *table.declared.notes, *unread_note(table.columns, wanted)]
    raw = RawTable("signals", "AutoQuad ESC32", time, notes)
    raw.channels["command"] = Channel("command", "1", time, numbers.columns[duty.index] / 100.0)
    raw.add(numbers.columns, columns, factors)
    return raw


FORMAT = table_format(
    "esc32-csv", "AutoQuad ESC32 telemetry CSV (duty, volts, amps, speed)", _recognize, _parse,
    {"rate": (), "units": (), "columns": (), "time_back": (), "segment": ()},
)  # fmt: skip
