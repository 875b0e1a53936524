"""CSV of the Bitcraze systemId deck, a load cell under a Crazyflie, as the scripts in its firmware write it.

    thrust[g],pwm,vbat[V],rpm1,rpm2,rpm3,rpm4
    time[ms],weight[g],pwm,vbat[V],rpm1,rpm2,rpm3,rpm4,v[V],i[A]

The cell carries all motors that turn: thrust, current and power are divided by their number, the speed is
their mean. The command is the 16-bit pulse width. Rows without times are points, unless ``rate`` is declared.
"""

import re
from dataclasses import replace

import numpy as np

from sysid.errors import LogError
from sysid.journal import note
from sysid.loaders.columns import NamedTable, header_columns
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.source import Source
from sysid.loaders.table_log import NAMED_TABLE, RawTable, named_table, table_format
from sysid.recording import Channel

# Stems in the header and SI unit, by channel.
_LOADS = {"thrust": ({"thrust", "weight"}, "N"), "current": ({"i"}, "A"), "electrical_power": ({"p"}, "W")}
_SPEED = re.compile("rpm[1-4]?").fullmatch


def _recognize(source: Source) -> int:
    stems = {column.stem for column in header_columns(source)}
    known = stems >= {"pwm", "vbat"} and stems & _LOADS["thrust"][0] and any(map(_SPEED, stems))
    return CERTAIN if known else NO


def _parse(source: Source, options: BenchOptions) -> RawTable:
    table = NamedTable(source, options)
    found = {name: (table.find(stems), unit, None) for name, (stems, unit) in _LOADS.items()}
    found["voltage"] = (table.find({"vbat"}), "V", None)
    probes = [table.find({column.stem}) or column for column in table.columns if _SPEED(column.stem)]
    clock, pwm, force = table.find({"time"}), table.find({"pwm"}), found["thrust"][0]
    if pwm is None or force is None or not probes:
        raise table.missing('"thrust", "pwm" or "rpm1"')
    if force.unit == "g":  # of a force
        found["thrust"] = (replace(force, unit="gf"), "N", None)
    raw, numbers = named_table(table, options, "Bitcraze systemId deck", found, clock, pwm, *probes)
    raw.kind = "thrust-stand" if raw.kind == "signals" else raw.kind
    speeds = numbers.stacked(probe.index for probe in probes)
    turning = np.nan_to_num(speeds).max(axis=0) > 0
    if not (motors := int(turning.sum())):
        raise LogError(f"{source.path}: no motor turns in any row; check the probes of the speed")
    words = f"motors that turn: {motors}; thrust, current and power are divided by it, the speed is the mean"
    raw.notes.append(note("mean-of-motors", words))
    for name in _LOADS.keys() & raw.channels:
        raw.channels[name] = replace(raw.channels[name], values=raw.channels[name].values / motors)
    raw.channels["command"] = Channel("command", "1", raw.time, numbers.columns[pwm.index] / 65535.0)
    raw.channels["speed"] = Channel("speed", "rad/s", raw.time, speeds[:, turning].mean(axis=1) * np.pi / 30)
    return raw


FORMAT = table_format("bitcraze-csv", "Bitcraze systemId deck CSV", _recognize, _parse, NAMED_TABLE)
