"""Telemetry of an AutoQuad ESC32 as its program writes it: a row per message, some 100 a second.

    Timestamp,Amps,Batt. Volts,Motor Volts,RPM,Duty,Comm. Period,...
    2019-11-05 17:14:08:947,0.00432758,15.7827,0,0,0,34,...

The command is the duty, here a fraction; ``motor_voltage`` is the duty times the battery voltage. Stamps are
times of arrival: several rows may share one, and a declared ``rate`` gives all rows an even clock instead.
Valid beside the log of a stand, with which `sysid convert --add` joins it by the speed.
"""

from sysid.loaders.columns import NamedTable, header_columns
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.source import Source
from sysid.loaders.table_log import NAMED_TABLE, RawTable, named_table, table_format
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
    table = NamedTable(source, options)
    clock, duty = table.find({_TIME}), table.find({_DUTY})
    if clock is None or duty is None:
        raise table.missing('"Timestamp" or "Duty"')
    found = {name: (table.find({stem}), unit, own) for name, (stem, unit, own) in _COLUMNS.items()}
    raw, numbers = named_table(table, options, "AutoQuad ESC32", found, clock, duty)
    raw.channels["command"] = Channel("command", "1", raw.time, numbers.columns[duty.index] / 100.0)
    return raw


FORMAT = table_format(
    "esc32-csv", "AutoQuad ESC32 telemetry CSV (duty, volts, amps, speed)", _recognize, _parse, NAMED_TABLE
)  # fmt: skip
