"""RCbenchmark / Tyto Robotics CSV: Series 1580 and 1585, and the headers of 1520 and 1780.

Columns are matched by name and unit, both of which depend on the stand and on the user's settings: command in
µs or (no unit) DShot 0 to 2047, thrust in N, gf or kgf, speed in RPM or rad/s.

Valid for running logs (kind ``thrust-stand``) and for averaged points (kind ``static-map``, whose channels
are on the clock of the point number because their times need not increase). Values that the stand repeats
between two readings of a sensor are kept as recorded.
"""

import re
from collections.abc import Mapping

import numpy as np

from sysid.errors import LogError, UnitError
from sysid.journal import Finding, note
from sysid.loaders.clock import order_rows
from sysid.loaders.columns import Column, DeclaredUnits, NamedTable, declare_unit, header_columns, unread_note
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.source import Source, split_line
from sysid.loaders.table import Numbers, read_numbers
from sysid.loaders.table_log import RawTable, table_format
from sysid.recording import Channel, FloatArray

_COMMAND = frozenset({"esc signal", "esc"})
# Stem in the header and unit of the channel, by channel.
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
_SPEEDS = ("speed_optical", "speed_electrical")
_MOST_MESSAGES = 5
_LARGEST_DSHOT = 2047.0
# Least and largest pulse width of any speed controller [µs].
_PULSE = (700.0, 2300.0)
# Least step of averaged points [s]: running logs of these stands step by 8 to 50 ms, points by 0.45 to 5 s.
_STATIC_STEP = 0.2


def _point_notes(numbers: Numbers, time: FloatArray | None) -> list[Finding]:
    """Return notes on averaged points: what the table is, rows that stand twice, a clock that restarts."""
    sentence = "static map: each row is one averaged point, and every clock is the point number, not seconds"
    notes = [note("static-map", sentence)]
    rows = [row.tobytes() for row in numbers.stacked(numbers.columns)]
    first = {row: place for place, row in reversed(list(enumerate(rows)))}
    twice = np.array([first[row] != place for place, row in enumerate(rows)])
    if twice.any():
        sentence = numbers.counted("rows that stand twice", twice)
        notes.append(Finding("repeated-points", f"{sentence}; each counts as a point"))
    # A row or two at the start may be left over from an earlier run.
    back = numbers.lines[3:][np.diff(time[2:]) < 0] if time is not None else numbers.lines[:0]
    if back.size:
        sentence = f"the clock starts again {back.size} times (first: line {back[0]})"
        notes.append(Finding("clock-restarts", f"{sentence}: several tables may be joined in this file"))
    return notes


def _choose_speed(
    optical: FloatArray | None, electrical: FloatArray | None
) -> tuple[FloatArray | None, list[Finding]]:
    """Return the speed to use [rad/s] and notes: the optical one unless it is off, which writes zeros."""
    seen_optical, seen_electrical = (
        0 if speed is None else int(np.count_nonzero(np.nan_to_num(speed))) for speed in (optical, electrical)
    )
    if optical is None or seen_optical < 0.5 * seen_electrical:
        if electrical is None:
            return None, []
        off = "" if optical is None else "; the optical probe reads zero"
        return electrical, [note("electrical-speed", f"speed is the electrical one{off}")]
    if electrical is None or not seen_electrical:
        off = "; the electrical probe reads zero" if seen_optical and electrical is not None else ""
        return optical, [note("optical-speed", f"speed is the optical one{off}")]
    notes = [note("optical-speed", "speed is the optical one")]
    both = (np.nan_to_num(optical) != 0) & (np.nan_to_num(electrical) != 0)
    if both.sum() >= 3:
        ratio = electrical[both] / optical[both]
        middle = float(np.median(ratio))
        low, high = np.percentile(ratio, [25, 75])
        # A constant ratio shows a wrong pole count: one pole pair changes it by 7 % or more (of fourteen),
        # and probes that agree differ by well under 2 %.
        if abs(middle - 1.0) > 0.02 and high - low < 0.02 * abs(middle):
            notes.append(Finding("pole-count", wrong_poles(middle)))
    return optical, notes


def wrong_poles(ratio: float) -> str:
    """Return the sentence about an electrical speed that is `ratio` times the optical one [1]."""
    pairs = [
        (actual, entered)
        for entered in range(2, 43, 2)
        for actual in range(2, 43, 2)
        if abs(actual / entered - ratio) < 0.005 * ratio
    ]
    # Most multirotor motors have 14 or 12 poles.
    likely = min(pairs, key=lambda pair: (pair[0] not in (12, 14), sum(pair)), default=None)
    guess = "" if likely is None else f", likely {likely[1]} entered for a motor of {likely[0]}"
    # A propeller of two blades passes twice a turn.
    ratio_of_marks = min(abs(ratio - 2.0), abs(ratio - 0.5)) < 0.005 * ratio
    probe = ", or the optical probe counts the wrong number of marks" if ratio_of_marks else ""
    return (
        f"electrical speed is {ratio:.4g} times the optical one throughout: the pole count in the stand's "
        f"program is wrong{guess}{probe}; the optical speed is used"
    )


def _recognize(source: Source) -> int:
    stems = {column.stem for column in header_columns(source)}
    measured = {_QUANTITIES[name][0] for name in _MEASURED}
    return CERTAIN if stems & _COMMAND and stems & measured else NO


def _command_unit(
    path: str, column: Column, declared: DeclaredUnits, values: FloatArray, notes: list[Finding]
) -> str:
    stated = declared.unit_of(column, "command")
    if stated is not None:
        return declared.command(column)
    known = values[np.isfinite(values)]
    smallest, largest = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    fault = (
        f'{path}: command column "{column.label}" states no unit and runs from {smallest:g} to {largest:g}, '
    )
    if largest > _LARGEST_DSHOT or smallest < 0.0:
        raise UnitError(f"{fault}beyond DShot 0 to 2047; {declare_unit('command', 'us')}").asking(
            units={column.label: "command"}
        )
    if smallest >= _PULSE[0] and largest <= _PULSE[1]:
        raise UnitError(
            f"{fault}as pulse widths in us do and DShot from rest does not; "
            f'{declare_unit("command", "us")} or {{command = "dshot"}} (in a campaign, log.command_unit)'
        ).asking(units={column.label: "command"})
    if 1.0 < largest <= 100.0:
        raise UnitError(f'{fault}as percent do; {declare_unit("command", "%")}, or "dshot"').asking(
            units={column.label: "command"}
        )
    notes.append(note("command-unit-assumed", "the command column states no unit: read as DShot 0 to 2047"))
    return "dshot"


def _messages(table: NamedTable, column: Column) -> list[Finding]:
    """Return a note with the messages of the stand's program, each once with its line."""
    messages: dict[str, int] = {}
    for number, _, line in table.text.lines(-1, table.head.offset, table.head.line):
        # Most messages are blank: a row without a letter or a quote cannot contain one.
        if line.startswith("#") or not any(letter.isalpha() and letter not in "eE" for letter in line):
            continue
        cells = split_line(line, table.head.delimiter)
        message = cells[column.index].strip() if column.index < len(cells) else ""
        if message not in ("", column.label) and len(messages) < _MOST_MESSAGES:
            messages.setdefault(message[:80], number)
    shown = "; ".join(f"{message!r} (line {number})" for message, number in messages.items())
    return [note("stand-messages", f"messages of the stand's program: {shown}")] if shown else []


def _clock(
    table: NamedTable, numbers: Numbers, column: Column | None, command: Column, options: BenchOptions
) -> tuple[FloatArray, FloatArray | None, list[Finding]]:
    """Return the clock [s], and instead of it point numbers and the stand's times where rows are averaged."""
    seconds = table.declared.factor(column, "time", "s") if column else 1.0
    again = np.ones(numbers.lines.size, dtype=np.bool_)
    again[0] = False
    for values in numbers.columns.values():
        again[1:] &= (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    written = None if column is None else numbers.columns[column.index] * seconds
    # Rows are averaged points if half of them or more, copies left out, lie far from the next in time.
    known = np.empty(0) if written is None else written[np.isfinite(written) & ~again]
    apart = known.size > 1 and float(np.median(np.abs(np.diff(known)))) >= _STATIC_STEP
    static = options.static
    if written is None and not static:
        # A column may be a clock by another name.
        named = any(re.search("time|clock", other.label, re.IGNORECASE) for other in table.columns)
        levels = numbers.columns[command.index]
        changes = np.count_nonzero(np.diff(levels)) * 2 >= levels.size - 1 > 0
        if static is False or named or not changes:
            raise LogError(
                f'{table.path}: no column "Time", so rows have no clock; if each row is one averaged point, '
                "say so with static = true"
            ).asking(static=True)
        static = True
    elif static is None:
        static = apart
    elif static is False and written is not None and apart:
        raise LogError(
            f"{table.path}: rows lie {float(np.nanmedian(np.abs(np.diff(written)))):.3g} s apart (median): "
            "averaged points, not a running log; leave static out, or record the log at the stand's full rate"
        )
    if static or column is None:
        points = np.arange(numbers.lines.size, dtype=np.float64)
        notes = _point_notes(numbers, written)
        return points, points if written is None else written, notes
    time, ordered = order_rows(
        table.path, numbers, column.index, seconds, options=options, stale_start=True, segmented=True
    )
    return time, None, ordered


def _parse(source: Source, options: BenchOptions) -> RawTable:
    table = NamedTable(source, options, renames=False)
    path, header = table.path, table.columns
    units = options.units
    if isinstance(units, Mapping) and "speed" in units:  # "speed" stands for both probes
        probes = {_QUANTITIES[name][0] for name in _SPEEDS} & {column.stem for column in header}
        others = {name: unit for name, unit in units.items() if name != "speed"}
        units = dict.fromkeys(sorted(probes), units["speed"]) | others if probes else units
    table.declared = declared = DeclaredUnits(path, units)
    command = table.find(_COMMAND)
    if command is None:
        raise table.missing('"ESC signal" or "ESC"')
    matches = {name: (table.find({stem}), unit) for name, (stem, unit) in _QUANTITIES.items()}
    columns = {name: (column, unit) for name, (column, unit) in matches.items() if column is not None}
    if not any(name in columns for name in _MEASURED):
        raise table.missing('"Thrust", "Torque" or "Motor Optical Speed"')
    clock = table.find({"time"})
    temperatures = [column for column in header if (column.unit or "") in ("ºC", "°C", "degC")]

    wanted = [command, *(column for column, _ in columns.values()), *temperatures]
    wanted += [clock] if clock else []
    message = table.find({"app message"})
    words = message.index if message is not None and message.index > max(c.index for c in wanted) else None
    # Rows are ragged: a vendor script appends cells to some, behind the message, and a message may contain
    # commas. A row that ends before it, or before the delimiter behind it, has lost cells somewhere.
    least = len(header) if words is None else words + 1 + min(table.head.trailing, 1)
    messages = [] if message is None else _messages(table, message)
    places = [column.index for column in wanted]
    numbers = read_numbers(
        table.text, table.head, places, least=least, surplus=True, free_text=words, again=True
    )
    del table.text  # the file's bytes are not needed any more
    time, points, ordered = _clock(table, numbers, clock, command, options)
    stems = {column.stem for column in header}
    series = " Series 1580/1585" if "accx" in stems else " Series 1780" if "esc" in stems else ""
    series = series or ("" if "torque" in stems else " Series 1520")
    raw = RawTable("thrust-stand", f"RCbenchmark{series}", time, [*numbers.notes, *messages, *ordered])
    protocol = _command_unit(path, command, declared, numbers.columns[command.index], raw.notes)
    raw.channels["command"] = Channel("command", protocol, time, numbers.columns[command.index])
    factors = {name: declared.factor(column, name, unit) for name, (column, unit) in columns.items()}
    speeds = {
        name: numbers.columns[columns[name][0].index] * factors[name] for name in _SPEEDS if name in columns
    }
    raw.add(numbers.columns, columns, factors)
    speed, chosen = _choose_speed(speeds.get("speed_optical"), speeds.get("speed_electrical"))
    raw.notes += chosen
    if speed is not None and not np.isnan(speed).all():
        raw.channels["speed"] = Channel("speed", "rad/s", time, speed)
    for column in temperatures:
        name = f"temperature/{column.stem}"
        raw.channels[name] = Channel(name, "K", time, numbers.columns[column.index] + 273.15)
    declared.check_used(header)
    raw.notes += [*declared.notes, *unread_note(header, [*wanted, *([message] if message else [])])]
    if points is not None:
        raw.kind = "static-map"
        if clock is not None:
            raw.channels["log_time"] = Channel("log_time", "s", time, points)
    return raw


FORMAT = table_format(
    "rcbenchmark-csv", "RCbenchmark / Tyto thrust stand CSV (Series 1520, 1580, 1585, 1780)", _recognize,
    _parse, {"units": (), "static": (), "time_back": (), "segment": ()},
)  # fmt: skip
