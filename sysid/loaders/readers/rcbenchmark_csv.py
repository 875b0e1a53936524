"""RCbenchmark / Tyto Robotics CSV: Series 1580 and 1585, and the headers of 1520 and 1780.

Columns are matched by name and unit, both of which depend on the stand and on the user's settings: command in
µs or (no unit) DShot 0 to 2047, thrust in N, gf or kgf, speed in RPM or rad/s.

Valid for running logs (kind ``thrust-stand``) and for averaged points (kind ``static-map``, whose channels
are on the clock of the point number because their times need not increase). Values that the stand repeats
between two readings of a sensor are kept as recorded.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sysid.errors import LogError, UnitError
from sysid.journal import Finding, note
from sysid.loaders.clock import order_rows
from sysid.loaders.columns import (
    Column,
    DeclaredUnits,
    find_column,
    missing_column,
    parse_header,
    unread_note,
)
from sysid.loaders.registry import CERTAIN, NO, LogFormat
from sysid.loaders.source import Source
from sysid.loaders.table import TableHead, find_header, read_numbers, table_head
from sysid.loaders.text import Text, read_text, split_line
from sysid.loaders.thrust_stand import choose_speed, is_static, point_channels
from sysid.recording import Channel, FloatArray, Recording

_NAME = "rcbenchmark-csv"
_COMMAND = frozenset({"esc signal", "esc"})
# channel: (stem in the header, unit that its own is converted to)
_QUANTITIES = {
    "torque": ("torque", "N*m"),
    "thrust": ("thrust", "N"),
    "voltage": ("voltage", "V"),
    "current": ("current", "A"),
    "speed_electrical": ("motor electrical speed", "rad/s"),
    "speed_optical": ("motor optical speed", "rad/s"),
    "electrical_power": ("electrical power", "W"),
    "mechanical_power": ("mechanical power", "W"),
    "acceleration_x": ("accx", "m/s^2"),
    "acceleration_y": ("accy", "m/s^2"),
    "acceleration_z": ("accz", "m/s^2"),
    "vibration": ("vibration", "m/s^2"),
}
_MEASURED = ("torque", "thrust", "speed_electrical", "speed_optical")
_SPEEDS = (_QUANTITIES["speed_optical"][0], _QUANTITIES["speed_electrical"][0])
_UNIT_NAMES = {"N*m": "N·m", "m/s^2": "m/s²"}
_MOST_MESSAGES = 5
_LARGEST_DSHOT = 2047.0
# Pulse widths of every speed controller lie within these [µs].
_PULSE = (700.0, 2300.0)


def _recognize(source: Source) -> int:
    found = find_header(source.head_lines)
    if found is None:
        return NO
    stems = {column.stem for column in parse_header(found[2])}
    measured = {_QUANTITIES[name][0] for name in _MEASURED}
    return CERTAIN if stems & _COMMAND and stems & measured else NO


def _device(columns: tuple[Column, ...]) -> str:
    stems = {column.stem for column in columns}
    if "accx" in stems:
        return "RCbenchmark Series 1580/1585"
    if "esc" in stems:
        return "RCbenchmark Series 1780"
    return "RCbenchmark Series 1520" if "torque" not in stems else "RCbenchmark"


def _command_unit(
    path: str, column: Column, declared: DeclaredUnits, values: FloatArray, notes: list[Finding]
) -> str:
    stated = declared.unit_of(column, "command")
    if stated is not None:
        return declared.command(column)
    known = values[np.isfinite(values)]
    smallest, largest = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    if largest > _LARGEST_DSHOT or smallest < 0.0:
        raise UnitError(
            f'{path}: command column "{column.label}" states no unit and runs from {smallest:g} '
            f'to {largest:g}, beyond DShot 0 to 2047; declare it, for example units = {{command = "us"}}'
        )
    if smallest >= _PULSE[0] and largest <= _PULSE[1]:
        raise UnitError(
            f'{path}: command column "{column.label}" states no unit and runs from {smallest:g} '
            f"to {largest:g}, as pulse widths in us do and DShot from rest does not; declare it, for example "
            'units = {command = "us"} or {command = "dshot"} (in a campaign, log.command_unit)'
        )
    notes.append(note("command-unit-assumed", "the command column states no unit: read as DShot 0 to 2047"))
    return "dshot"


def _both_speeds(units: Mapping[str, str] | None, columns: tuple[Column, ...]) -> Mapping[str, str] | None:
    """Return declared units in which that of ``speed`` is said of both probes, which it is chosen from."""
    if not isinstance(units, Mapping) or "speed" not in units:
        return units
    probes = {stem for stem in _SPEEDS if any(column.stem == stem for column in columns)}
    others = {name: unit for name, unit in units.items() if name != "speed"}
    return {**dict.fromkeys(sorted(probes), units["speed"]), **others} if probes else units


def _messages(text: Text, head: TableHead, column: Column) -> list[Finding]:
    """Return a note with what the stand's program said during the log, each message once with its line."""
    said: dict[str, int] = {}
    for number, _, line in text.lines(-1, head.offset, head.line):
        # Of most rows the message is blank: a row without a letter or a quote cannot hold one.
        if line.startswith("#") or not any(letter.isalpha() and letter not in "eE" for letter in line):
            continue
        cells = split_line(line, head.delimiter)
        message = cells[column.index].strip() if column.index < len(cells) else ""
        if message and len(said) < _MOST_MESSAGES:
            said.setdefault(message[:80], number)
    shown = "; ".join(f"{message!r} (line {number})" for message, number in said.items())
    return [note("stand-messages", f"messages of the stand's program: {shown}")] if shown else []


def read(
    source: Source,
    *,
    units: Mapping[str, str] | None = None,
    static: bool | None = None,
    time_back: str = "refuse",
) -> Recording:
    """Read an RCbenchmark CSV.

    Parameters
    ----------
    source : Source
        The log.
    units : mapping of str to str, optional
        Units by channel or column name where the header states none or a wrong one; ``speed`` is that of both
        probes.
    static : bool, optional
        True: rows are averaged points; False: they must be a running log. By default the row spacing decides.
    time_back : str
        ``"refuse"`` a log whose time goes back, or ``"drop"`` the rows that do not pass the latest time.

    Returns
    -------
    Recording
        ``command`` [us or dshot], ``speed`` (optical unless that probe is off), ``speed_optical``,
        ``speed_electrical`` [rad/s], ``thrust`` [N], ``torque`` [N·m], ``voltage`` [V], ``current`` [A] and
        what else the stand wrote, signs as recorded; ``log_time`` [s] on static maps.

    Raises
    ------
    LogError, UnitError
        One sentence with file, line and cause.
    """
    path = source.path
    text = read_text(source)
    head = table_head(text, renames=False)
    columns = parse_header(head.names)
    declared = DeclaredUnits(path, _both_speeds(units, columns))
    command = find_column(path, columns, _COMMAND)
    if command is None:
        raise missing_column(path, '"ESC signal" or "ESC"', columns)
    found = {name: find_column(path, columns, {stem}) for name, (stem, _) in _QUANTITIES.items()}
    quantities = {name: column for name, column in found.items() if column is not None}
    if not any(name in quantities for name in _MEASURED):
        raise missing_column(path, '"Thrust", "Torque" or "Motor Optical Speed"', columns)
    clock = find_column(path, columns, {"time"})
    if clock is None and not static:
        raise LogError(
            f'{path}: no column "Time", so rows have no clock; '
            "if each row is one averaged point, say so with static = true"
        )
    temperatures = [column for column in columns if (column.unit or "") in ("ºC", "°C", "degC")]

    wanted = [command, *quantities.values(), *temperatures, *([clock] if clock else [])]
    indices = [column.index for column in wanted]
    message = find_column(path, columns, {"app message"})
    words = message.index if message is not None and message.index > max(indices) else None
    # Rows are ragged: a vendor script appends cells to some, behind the message, and a message may hold
    # commas. A row that ends before it, or before the delimiter behind it, has lost cells somewhere.
    least = len(head.names) if words is None else words + 1 + min(head.trailing, 1)
    numbers = read_numbers(text, head, indices, least=least, surplus=True, free_text=words)
    notes = numbers.notes
    if message is not None:
        notes += _messages(text, head, message)
    del text  # the file's bytes are not needed any more

    time = np.arange(numbers.lines.size, dtype=np.float64)
    seconds = declared.factor(clock, "time", "s") if clock else 1.0
    if static is None:
        static = clock is not None and is_static(numbers.columns[clock.index] * seconds)
    log_time = numbers.columns[clock.index] * seconds if clock else None
    if static is False and log_time is not None and is_static(log_time):
        raise LogError(
            f"{path}: rows lie {float(np.nanmedian(np.abs(np.diff(log_time)))):.3g} s apart (median): "
            "averaged points, not a running log; leave static out, or record the log at the stand's full rate"
        )
    if not static and clock is not None:
        time, said = order_rows(path, numbers, clock.index, seconds, stale_start=True, time_back=time_back)
        notes += said

    values = {name: numbers.columns[column.index] for name, column in quantities.items()}
    unit = _command_unit(path, command, declared, numbers.columns[command.index], notes)
    channels = {"command": Channel("command", unit, time, numbers.columns[command.index])}
    blank = []
    for name, column in quantities.items():
        wanted_unit = _QUANTITIES[name][1]
        values[name] = values[name] * declared.factor(column, name, wanted_unit)
        if np.isnan(values[name]).all():
            blank.append(column.label)
            continue
        channels[name] = Channel(name, _UNIT_NAMES.get(wanted_unit, wanted_unit), time, values[name])
    speed, said = choose_speed(values.get("speed_optical"), values.get("speed_electrical"))
    notes += said
    if speed is not None and not np.isnan(speed).all():
        channels["speed"] = Channel("speed", "rad/s", time, speed)
    for column in temperatures:
        name = f"temperature/{column.stem}"
        channels[name] = Channel(name, "K", time, numbers.columns[column.index] + 273.15)
    declared.check_used(columns)
    notes += [*declared.notes, *unread_note(columns, [*wanted, *([message] if message else [])])]
    if blank:
        notes.append(note("columns-without-values", f"columns without a single value: {', '.join(blank)}"))
    if static:
        if log_time is not None:
            channels["log_time"] = Channel("log_time", "s", time, log_time)
        channels = point_channels(channels)
        notes.append(
            note(
                "static-map",
                "static map: each row is an averaged point, and every clock is the point number, not seconds",
            )
        )
    options: dict[str, Any] = {"units": units, "static": static, "time_back": time_back}
    return Recording(
        "static-map" if static else "thrust-stand",
        channels,
        source.provenance(_NAME, device=_device(columns), options=options, notes=notes),
    )


FORMAT = LogFormat(
    _NAME, "RCbenchmark / Tyto thrust stand CSV (Series 1520, 1580, 1585, 1780)", _recognize, read
)
