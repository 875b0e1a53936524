"""Which cell of each text format is which channel, in which unit, for the slow reader of `log_oracle`.

The layouts are those that the instruments' makers and users write; nothing here comes from the package.
A reader may raise anything on a log so damaged that it says nothing: then nothing may be loaded from it.
"""

import math
import re

from fakes.log_oracle import (
    COMMANDS,
    Row,
    SaysNothing,
    Table,
    cells_of,
    delimiter_of,
    factor_of,
    fill,
    header_of,
    label_of,
    lines_of,
    number,
    of_vector,
    quaternion,
    turned,
)


def need(value, what):
    if value is None:
        raise SaysNothing(what)
    return value


def only(cells, names):
    matches = [i for i, cell in enumerate(cells) if label_of(cell)[0] in names]
    if len(matches) > 1:
        raise SaysNothing(f"which of two columns {names} is")
    return matches[0] if matches else None


def by_name(data, quantities, command, clock, *, message=None, stale, plain_seconds=False, points=False):
    """Return the table of a log whose first line names columns: channel -> (names, quantity)."""
    lines, closed = lines_of(data)
    first, delimiter, cells = header_of(lines)
    if message:  # a header that stands again is no row
        lines = [*lines[: first + 1], *("#" if line == lines[first] else line for line in lines[first + 1 :])]
    columns = {}
    for channel, (names, quantity) in quantities.items():
        column = only(cells, names)
        if column is None:
            continue
        unit = label_of(cells[column])[1]
        columns[channel, 0] = (column, factor_of("" if unit is None else unit, quantity))
    column = only(cells, command)
    if column is not None:
        unit = label_of(cells[column])[1]
        columns["command", 0] = (column, 1.0 if (unit or "").casefold() in COMMANDS else None)
    time = only(cells, clock) if points else need(only(cells, clock), "the clock")
    unit = None if time is None else label_of(cells[time])[1]
    seconds = need(1.0 if unit is None and plain_seconds else factor_of(unit or "", "time"), "a unit of time")
    # A column of unknown unit must not be read.
    columns = {key: (column, math.inf if f is None else f) for key, (column, f) in columns.items()}
    table = Table(stale=stale)
    timed = () if time is None else (time,)
    wanted = [*timed, *(column for column, _ in columns.values())]
    # Words may hold delimiters, and rows may end behind them.
    words = only(cells, message or ())
    words = None if words is None or words < max(wanted) else words
    raw = len(cells_of(lines[first], delimiter))
    least = len(cells) if words is None else words + 1 + (raw > len(cells))
    fill(table, lines, closed, first + 1, len(lines), delimiter, columns,
         lambda at: tuple(at(column) * seconds for column in timed) or (0.0,), least=least, most=raw,
         words=words, width=len(cells) if message else None, skip=timed)  # fmt: skip
    return table


STAND = {
    "torque": ({"torque"}, "torque"), "thrust": ({"thrust"}, "force"),
    "speed_optical": ({"motor optical speed"}, "angular speed"), "voltage": ({"voltage"}, "voltage"),
    "current": ({"current"}, "current"),
}  # fmt: skip


def rcbenchmark_csv(data, recording):
    table = by_name(data, STAND, {"esc signal", "esc"}, {"time"}, message={"app message"}, stale=2,
                    plain_seconds=True, points=recording.kind == "static-map")  # fmt: skip
    if "log_time" in recording.channels:
        table.widths["log_time"] = 1
        for row in table.rows:
            row.numbers["log_time", 0] = row.times[0]
    # The speed is that of the one probe that there is.
    table.widths["speed"] = 1
    for row in table.rows:
        row.numbers["speed", 0] = row.numbers.get(("speed_optical", 0), math.nan)
    return [table]


def axis(letters, word, axis):
    return {f"{item}{axis}" for item in letters} | {f"{word} {axis}", f"{letters[0]} {axis}"}


CELL = {
    "speed": ({"speed", "motor speed", "rotor speed", "omega", "ω", "rpm"}, "angular speed"),
    "thrust": (axis("f", "force", "z") | {"thrust"}, "force"),
    "force_x": (axis("f", "force", "x"), "force"),
    "force_y": (axis("f", "force", "y"), "force"),
    "torque": (axis("mt", "torque", "z") | {"moment z", "torque"}, "torque"),
    "torque_x": (axis("mt", "torque", "x") | {"moment x"}, "torque"),
    "torque_y": (axis("mt", "torque", "y") | {"moment y"}, "torque"),
    "voltage": ({"voltage", "supply voltage", "battery voltage"}, "voltage"),
    "current": ({"current", "supply current", "motor current"}, "current"),
}
CELL_COMMAND = {"command", "cmd", "throttle", "esc", "esc signal", "pwm"}
CELL_TIME = {"time", "t", "timestamp", "time stamp"}


def load_cell_csv(data, recording):
    return [by_name(data, CELL, CELL_COMMAND, CELL_TIME, stale=0)]


def poses(lines, closed, first, delimiter, cells, places, time, factors, seconds):
    """Return the table of one body; `places` are the columns of x, y, z and of w, x, y, z of its turn."""
    columns = {("body/position", k): (places[k], factors[k]) for k in range(3)}
    columns |= {("body/orientation", k): (places[3 + k], 1.0) for k in range(4)}
    table = Table(turns={"body/orientation": quaternion})
    fill(table, lines, closed, first + 1, len(lines), delimiter, columns, lambda at: (at(time) * seconds,),
         least=len(cells), most=len(cells_of(lines[first], delimiter)), skip=(time,))  # fmt: skip
    return [table]


def single(columns, what):
    return need(columns[0] if len(columns) == 1 else None, what)


def pose_table(data, recording):
    lines, closed = lines_of(data)
    first, delimiter, cells = header_of(lines)
    labels = [label_of(cell) for cell in cells]

    def named(*names):
        return [i for i, (name, _) in enumerate(labels) if name in names]

    places = [need(next(iter(named(a, f"p{a}", f"t{a}")), None), a) for a in "xyz"]
    factors = [need(factor_of(labels[i][1] or "", "length"), "a length") for i in places]
    places += [single(named(f"q{a}", f"q {a}"), a) for a in "wxyz"]
    time = need(only(cells, {"t", "time", "timestamp", "time stamp", "stamp"}), "the clock")
    unit = labels[time][1]
    seconds = need(1.0 if unit is None else factor_of(unit, "time"), "a unit of time")
    return poses(lines, closed, first, delimiter, cells, places, time, factors, seconds)


def ros_csv(data, recording):
    lines, closed = lines_of(data)
    first, delimiter, cells = header_of(lines)
    names = [label_of(cell)[0].split() for cell in cells]
    places = [
        single([i for i, name in enumerate(names) if name[2:] and name[-1] == a and name[-2] in words], a)
        for words, axes in ((("position", "translation"), "xyz"), (("orientation", "rotation"), "wxyz"))
        for a in axes
    ]
    stamp = need(only(cells, {"field header stamp"}), "the stamp")
    return poses(lines, closed, first, delimiter, cells, places, stamp, (1.0,) * 3, 1e-9)


def motive_csv(data, recording):
    lines, closed = lines_of(data)
    top = next(line for line in lines if line.strip())
    delimiter = delimiter_of(top, spaces=False)
    rows = [[c.strip().strip('"').strip() for c in cells_of(line, delimiter)] for line in lines[:40]]
    last = next(i for i, row in enumerate(rows) if row[0].casefold() == "frame" or
                row[0].casefold().startswith("time"))  # fmt: skip
    head, axes = [row for row in rows[:last] if any(row)], rows[last]
    settings = dict(zip(head[0], head[0][1:], strict=False))
    # Rows above the axes are known by their words, as the version may have a row of parents more.
    kinds = next(row for row in head[1:] if {"rigid body", "marker"} & {c.casefold() for c in row[2:]})
    parts = next(row for row in head[1:] if {"Position", "Rotation"} & set(row))
    below = head[head.index(kinds) + 1 :]
    names = next((row for row in head[1:] if len(row) > 1 and row[1].casefold() == "name"), below[0])
    length = need(factor_of(settings["Length Units"], "length") or
                  factor_of(settings["Length Units"].title(), "length"), "a length")  # fmt: skip
    places = {"frame" if cell.casefold() == "frame" else "time": i for i, cell in enumerate(axes[:2])
              if cell.casefold() == "frame" or cell.casefold().startswith("time")}  # fmt: skip
    columns, turns = {}, {}
    for i in range(len(places), len(axes)):
        where = [row[i] if i < len(row) else "" for row in (kinds, names, parts)]
        kind, name, part = where[0].casefold(), where[1], where[2]
        if part == "Position" and kind in ("rigid body", "marker") and axes[i].upper() in "XYZ" and axes[i]:
            columns[f"{name}/position", "XYZ".index(axes[i].upper())] = (i, length)
        if part == "Rotation" and kind == "rigid body" and axes[i].upper() in "WXYZ" and axes[i]:
            columns[f"{name}/orientation", "WXYZ".index(axes[i].upper())] = (i, 1.0)
            turns[f"{name}/orientation"] = quaternion
    rate = None
    for key in ("Export Frame Rate", "Capture Frame Rate"):
        stated = number(settings.get(key, ""))
        rate = rate or (stated if stated > 0 and math.isfinite(stated) else None)
    other = number(settings.get("Capture Frame Rate", ""))

    sentences = " ".join(recording.provenance.sentences)
    if (
        math.isfinite(other)
        and other > 0
        and f"at {other:g} Hz" in sentences
        and f"at {rate:g} Hz" not in sentences
    ):
        rate = other  # frames are numbered at the rate of the capture where that is what Time says

    def time(at):
        if "frame" in places and rate is not None:
            counted = at(places["frame"]) / rate
            written = at(places["time"]) if "time" in places else math.nan
            return (counted, written) if math.isfinite(written) else (counted,)
        return (at(need(places.get("time"), "a clock")),)

    table = Table(turns=turns, offset=rate is not None)
    wanted = [*places.values(), *(column for column, _ in columns.values())]
    fill(
        table, lines, closed, last + 1, len(lines), delimiter, columns, time, least=max(wanted) + 1,
        most=len(axes), skip=tuple(places.values()),
    )  # fmt: skip
    return [table]


def vicon_csv(data, recording):
    lines, closed = lines_of(data)
    tables, i = [], 0
    while i < len(lines):
        if not lines[i].strip(",;\t "):
            i += 1
            continue
        title = lines[i].strip(',;\t "').casefold()
        delimiter = delimiter_of(lines[i + 3], spaces=False)
        rate, names, fields, units = (
            [c.strip() for c in cells_of(x, delimiter)] for x in lines[i + 1 : i + 5]
        )
        rate = number(rate[0].replace(",", "."))
        end = next((k for k in range(i + 5, len(lines)) if not lines[k].strip(",;\t ")), len(lines))
        while fields and not fields[-1]:
            fields.pop()
        table, columns = Table(), {}

        def add(channel, k, column, factor, columns=columns):
            need(None if (channel, k) in columns else 0, "one column of a kind")
            columns[channel, k] = (column, factor)

        name = ""
        for column in range(2, len(fields)):
            name = (names[column] if column < len(names) else "") or name
            unit = units[column] if column < len(units) else ""
            body = re.sub(r"^Global Angle *(\(Quaternion\))? *", "", name)
            body = body.split(":")[0] if len(set(body.split(":", 1))) == 1 else body
            part = fields[column].upper()
            if title == "trajectories" and part in ("X", "Y", "Z"):
                add(f"{name}/position", "XYZ".index(part), column, unit)
            elif title in ("objects", "segments") and part in ("TX", "TY", "TZ"):
                add(f"{body}/position", "XYZ".index(part[1]), column, unit)
            elif title in ("objects", "segments") and part in ("RW", "RX", "RY", "RZ"):
                whole = "RW" in fields or "(Quaternion)" in name
                add(f"{body}/orientation", ("WXYZ" if whole else "XYZ").index(part[1]), column, 1.0)
                table.turns[f"{body}/orientation"] = quaternion if whole else of_vector
        stated = {unit for _, unit in columns.values() if unit not in ("", 1.0)}
        factors = {factor_of(unit, "length") for unit in stated}
        scale = factors.pop() if len(factors) == 1 else None
        columns = {
            key: (k, 1.0 if unit == 1.0 else math.inf if scale is None else scale)
            for key, (k, unit) in columns.items()
        }
        fill(table, lines, closed, i + 5, end, delimiter, columns, lambda at, r=rate: (at(0) / r, at(1)),
             least=len(fields), most=len(fields), skip=(0, 1))  # fmt: skip
        for row in table.rows:
            # One row per frame and no sub frames: another number than 0 there is a damaged one.
            row.times = row.times[:1] if row.times[1] == 0 or not math.isfinite(row.times[1]) else ()
        tables.append(table)
        i = end
    return tables


def qualisys_tsv(data, recording):
    lines, closed = lines_of(data)
    keys, first, lead = {}, None, 0
    for i, line in enumerate(lines[:40]):
        cells = [cell.strip() for cell in line.split("\t")]
        if cells[0] == "Frame":
            first, lead = i + 1, 2
            break
        if cells[0][:1].isalpha() and cells[0].upper() == cells[0]:
            keys[cells[0]] = cells[1:]
        elif line.strip():
            first = i if not math.isnan(number(cells[0])) or not cells[0] else i + 1
            lead = 2 if len(lines[first].rstrip("\t").split("\t")) % 16 == 2 else 0
            break
    rate, names = number(keys["FREQUENCY"][0]), [name for name in keys["BODY_NAMES"] if name]
    columns, turns = {}, {}
    for place, name in enumerate(names):
        start = lead + 16 * place
        columns |= {(f"{name}/position", k): (start + k, 1e-3) for k in range(3)}
        columns[f"{name}/residual", 0] = (start + 6, 1e-3)
        columns |= {(f"{name}/orientation", k): (start + 7 + k, 1.0) for k in range(9)}
        turns[f"{name}/orientation"] = turned
    table = Table(turns=turns, offset=bool(lead))
    count = iter(range(10**6))

    def time(at):
        if not lead:
            return (next(count) / rate,)
        counted, written = (at(0) - 1) / rate, at(1)
        return (counted, written) if math.isfinite(written) else (counted,)

    fill(table, lines, closed, need(first, "rows"), len(lines), "\t", columns, time,
         least=lead + 16 * len(names), most=lead + 16 * len(names), skip=(0, 1) if lead else ())  # fmt: skip
    for row in table.rows:
        for name in names:
            matrix = [row.numbers[f"{name}/orientation", k] for k in range(9)]
            place = [row.numbers[f"{name}/position", k] for k in range(3)]
            lost = not any(matrix) or not all(map(math.isfinite, matrix))
            for k in range(3):
                if lost or not any(place):
                    row.numbers[f"{name}/position", k] = math.nan
            if lost:
                row.numbers[f"{name}/residual", 0] = math.nan
    return [table]


def motive_legacy(data, recording):
    lines, closed = lines_of(data)
    table, names = Table(), {}
    for i, line in enumerate(lines):
        cells = cells_of(line, ",")
        word = cells[0].strip().casefold()
        if word == "rigidbody" and len(cells) > 2:
            names[cells[2].strip()] = cells[1].strip().strip('"')
        if word == "lefthanded":
            raise SaysNothing("axes of the right hand")
        if word != "frame":
            continue
        try:
            numbers, at = {}, 4
            for _ in range(int(cells[3])):
                name = names.get(cells[at].strip(), f"body {cells[at].strip()}")
                x, y, z, qx, qy, qz, qw = (number(cell) for cell in cells[at + 1 : at + 8])
                numbers |= {(f"{name}/position", k): v for k, v in enumerate((x, y, z))}
                numbers |= {(f"{name}/orientation", k): v for k, v in enumerate((qw, qx, qy, qz))}
                table.turns[f"{name}/orientation"] = quaternion
                at += 11
            count, at = int(cells[at]), at + 1
            for _ in range(count):
                name = cells[at + 4].strip() or f"marker {cells[at + 3].strip()}"
                if (f"{name}/position", 0) in numbers:
                    name = f"{name} {cells[at + 3].strip()}"
                numbers |= {(f"{name}/position", k): number(cells[at + k]) for k in range(3)}
                at += 5
            when = number(cells[2])
        except (IndexError, ValueError):
            numbers, when = {}, math.nan  # only the last line may be so
            if i < len(lines) - 1 or closed:
                raise SaysNothing(f"line {i + 1}") from None
        for channel, k in numbers:
            table.widths[channel] = max(table.widths.get(channel, 0), k + 1)
        table.rows.append(Row(i + 1, (when,), numbers, True, i == len(lines) - 1 and not closed))
    return [table]


SIX = ("force_x", "force_y", "thrust", "torque_x", "torque_y", "torque")


def net_ft_csv(data, recording):
    lines, closed = lines_of(data)
    stated = {}
    first, names = 0, []
    for line in lines[:15]:
        first, names = first + 1, [cell.strip().casefold() for cell in cells_of(line, ",")]
        if "rdt sequence" in names:
            break
        key, _, value = line.strip(' ",').partition(":")
        if not value:
            key, _, value = line.strip(' ",').partition(",")
        stated[key.strip(' "').casefold()] = value.strip(' ",')
    rate = number(stated["rdt sample rate"])
    force = factor_of(stated["force units"], "force") / number(stated["counts per unit force"])
    torque = factor_of(stated["torque units"], "torque") / number(stated["counts per unit torque"])
    columns = {}
    for channel, name in zip(SIX, ("fx", "fy", "fz", "tx", "ty", "tz"), strict=True):
        need(0 if names.count(name) == 1 else None, name)
        columns[channel, 0] = (names.index(name), force if name[0] == "f" else torque)
    counter = names.index("rdt sequence")
    table = Table()
    wanted = [counter, *(column for column, _ in columns.values())]
    fill(table, lines, closed, first, len(lines), ",", columns, lambda at: (at(counter),),
         least=max(wanted) + 1, most=len(names))  # fmt: skip
    need(None if "rdt sequence" not in names else 0, "the counter")
    zero = next(row.times[0] for row in table.rows if row.whole and math.isfinite(row.times[0]))
    for row in table.rows:
        row.times = ((row.times[0] - zero) / rate,)
    return [table]


def ati_text(data, recording):
    lines, closed = lines_of(data)
    if "sampling freq" not in lines[0].casefold():
        raise SaysNothing("a rate")

    def mark_of(line):  # where there is another mark, commas are decimal
        return ";" if ";" in line else "\t" if "\t" in line else delimiter_of(line)

    rate, first = None, 0
    for i in range(1, 20):
        cells = cells_of(lines[i].strip("[] "), mark_of(lines[i]))
        numbers = [number(cell, "," if "," in cell else ".") for cell in cells]
        filled = [x for x in numbers if not math.isnan(x)]
        if len(filled) in (6, 7):  # six numbers are a row, which states no rate
            need(rate, "a rate")
            first = first or i
            break
        if rate is None:
            rate = numbers[0] if len(cells) > 1 and numbers[0] > 0 else None
            if rate is not None and len(filled) < sum(bool(cell.strip()) for cell in cells):
                raise SaysNothing("a rate: words among the settings")
        elif lines[i].strip() and (filled or not any(cell.strip() for cell in cells)):
            first = first or i
    need(first or None, "a row")
    delimiter = mark_of(lines[first])
    columns = {(channel, 0): (k, 1.0) for k, channel in enumerate(SIX)}
    count = iter(range(10**6))
    table = Table(counted=True)
    fill(table, lines, closed, first, len(lines), delimiter, columns, lambda at: (next(count) / rate,),
         least=6, most=6)  # fmt: skip
    return [table]


LVM_KNOWN = {**CELL, "command": (CELL_COMMAND, "command")}


def lvm(data, recording):
    lines, closed = lines_of(data)
    settings = {}
    k = 0
    for line in lines:
        k += 1
        if line.startswith("***End_of_Header***"):
            break
        key, _, value = line.partition("\t") if "\t" in line else line.partition(",")
        settings[key.strip().casefold()] = value.strip()
    mark = settings.get("separator", "Tab").strip().casefold()
    delimiter = {"tab": "\t", "comma": ",", "": "\t"}[mark]
    header = {}
    while (cells := [c.strip() for c in lines[k].split(delimiter)])[0] != "X_Value":
        header[cells[0].casefold()] = cells[1:]
        k += 1
    names = [c.strip() for c in lines[k].split(delimiter)]
    while not names[-1]:
        names.pop()
    units = header.get("y_unit_label", [])
    columns = {}
    for column in range(1, len(names)):
        if not names[column] or (names[column] == "Comment" and column == len(names) - 1):
            continue
        unit = units[column - 1] if column - 1 < len(units) else ""
        unit = unit.lower() if unit.isalpha() and len(unit) > 3 else unit
        name, printed = label_of(names[column])
        unit = unit.removesuffix("s") if unit in ("newtons", "volts") else unit
        unit = unit or printed or ""
        channel = next((c for c, (known, _) in LVM_KNOWN.items() if name in known), None)
        quantity = LVM_KNOWN[channel][1] if channel else None
        if channel is None:
            channel = " ".join(names[column].split())
            shown = recording[channel].unit if channel in recording.channels else ""
            quantity = {
                "N": "force", "N·m": "torque", "rad/s": "angular speed", "V": "voltage", "s": "time",
                "A": "current", "m": "length", "rad": "angle",
            }.get(shown)  # fmt: skip
        if quantity == "command":
            factor = 1.0 if unit.casefold() in COMMANDS else math.inf
        else:
            factor = 1.0 if quantity is None else factor_of(unit, quantity)
        columns[channel, 0] = (column, math.inf if factor is None else factor)
    end = next((j for j in range(k + 1, len(lines)) if not lines[j].strip(" \t,")), len(lines))
    decimal = settings.get("decimal_separator") or None
    table = Table()
    fill(table, lines, closed, k + 1, end, delimiter, columns, lambda at: (at(0),),
         least=max(column for column, _ in columns.values()) + 1, most=len(names),
         width=len(names), words=len(names) - 1 if names[-1] == "Comment" else None, decimal=decimal,
         skip=(0,))  # fmt: skip
    return [table]


READERS = {
    "rcbenchmark-csv": rcbenchmark_csv, "load-cell-csv": load_cell_csv, "motive-csv": motive_csv,
    "pose-table": pose_table, "lvm": lvm, "vicon-csv": vicon_csv, "qualisys-tsv": qualisys_tsv,
    "motive-legacy": motive_legacy, "ros-csv": ros_csv, "net-ft-csv": net_ft_csv, "ati-text": ati_text,
}  # fmt: skip
