"""CSV of the Bitcraze systemId deck, a load cell under a Crazyflie, as the scripts in its firmware write it.

    thrust[g],pwm,vbat[V],rpm1,rpm2,rpm3,rpm4
    time[ms],weight[g],pwm,vbat[V],rpm1,rpm2,rpm3,rpm4,v[V],i[A]

The cell carries all motors that turn: thrust, current and power are divided by their number, and the speed is
their mean. The command is the 16-bit pulse width, as a fraction. Without a column of times each row is a
steady point of a slow ramp, unless a ``rate`` is declared (the scripts ask for 100 rows a second).
"""

import re
from dataclasses import replace

import numpy as np

from sysid.errors import LogError
from sysid.journal import note
from sysid.loaders.clock import declared_rate, row_clock
from sysid.loaders.columns import NamedTable, header_columns, unread_note
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.source import Source
from sysid.loaders.table_log import RawTable, table_format
from sysid.recording import Channel

_STEMS = {"thrust": ("thrust", "weight"), "voltage": ("vbat",), "current": ("i",), "electrical_power": ("p",)}
_UNITS = {"thrust": "N", "voltage": "V", "current": "A", "electrical_power": "W"}


def _recognize(source: Source) -> int:
    stems = {column.stem for column in header_columns(source)}
    return CERTAIN if stems >= {"pwm", "vbat"} and stems & {*_STEMS["thrust"]} and _speeds(stems) else NO


def _speeds(stems: set[str]) -> list[str]:
    return sorted(stem for stem in stems if re.fullmatch("rpm[1-4]?", stem))


def _parse(source: Source, options: BenchOptions) -> RawTable:
    path, rate, table = source.path, declared_rate(source.path, options.rate), NamedTable(source, options)
    found = {name: table.find(stems) for name, stems in _STEMS.items()}
    probes = [table.find({stem}) for stem in _speeds({column.stem for column in table.columns})]
    clock, pwm = table.find({"time"}), table.find({"pwm"})
    if pwm is None or found["thrust"] is None or not probes:
        raise table.missing('"thrust", "pwm" or "rpm1"')
    if found["thrust"].unit == "g":  # a force in grams is in gram-force
        found["thrust"] = replace(found["thrust"], unit="gf")
    columns = {name: (column, _UNITS[name]) for name, column in found.items() if column is not None}
    factors = {name: table.declared.factor(column, name, unit) for name, (column, unit) in columns.items()}
    seconds = table.declared.factor(clock, "time", "s") if clock else 1.0
    table.declared.check_used(table.columns)
    wanted = [c for c in (clock, pwm, *probes, *(column for column, _ in columns.values())) if c is not None]
    numbers = table.read(wanted)
    timed = clock is not None or rate is not None
    time, notes = np.arange(numbers.lines.size, dtype=np.float64), table.declared.notes
    if timed:
        place = clock.index if clock else None
        time, notes = row_clock(path, numbers, place, seconds, rate, options)
    else:
        sentence = 'rows have no time: each is a steady point; for a running log declare rate = "100 Hz"'
        notes.append(note("static-map", sentence))
    speeds = numbers.stacked(probe.index for probe in probes if probe is not None)
    turning = np.nan_to_num(speeds).max(axis=0) > 0
    if not turning.any():
        raise LogError(f"{path}: no motor turns in any row; check the probes of the speed")
    motors = int(turning.sum())
    sentence = (
        f"motors that turn: {motors}; thrust, current and power are divided by it, the speed is the mean"
    )
    notes = [*numbers.notes, *notes, *unread_note(table.columns, wanted), note("mean-of-motors", sentence)]
    raw = RawTable("thrust-stand" if timed else "static-map", "Bitcraze systemId deck", time, notes)
    raw.channels["command"] = Channel("command", "1", time, numbers.columns[pwm.index] / 65535.0)
    raw.channels["speed"] = Channel("speed", "rad/s", time, speeds[:, turning].mean(axis=1) * np.pi / 30.0)
    raw.add(numbers.columns, columns, {n: f if n == "voltage" else f / motors for n, f in factors.items()})
    return raw


FORMAT = table_format(
    "bitcraze-csv", "Bitcraze systemId deck CSV (thrust, pwm, battery, speeds)", _recognize, _parse,
    {"rate": (), "units": (), "columns": (), "time_back": (), "segment": ()},
)  # fmt: skip
