"""A second reader of text logs: slow, cell by cell, with none of the package's code.

The readers of `log_readers` turn the bytes of a log into tables of rows, each number in SI with the channel
that it belongs to; `assert_matches` then walks a recording row by row and finds each row in a line of the
file. A sample that is in no line, a sample from another line, a line that vanished without a reason, a number
that became a gap and a factor of another unit than the printed one are an assertion that names the line.
"""

import csv
import math
import re
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

# A number times a unit's factor, which may itself be a product of several rounded numbers.
FACTOR = 1e-12


def text_of(data):
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.removeprefix(b"\xef\xbb\xbf").decode("cp1252", errors="replace")
    return text.removeprefix("\ufeff")


def lines_of(data):
    text = text_of(data).replace("\r\r\n", "\n").replace("\r\n", "\n").replace("\r", "\n")
    lines = text.split("\n")
    return lines, lines[-1] == ""


def cells_of(line, delimiter):
    if delimiter == " ":
        return line.split()
    if '"' in line:
        try:
            return next(csv.reader([line], delimiter=delimiter))
        except (csv.Error, StopIteration):
            pass
    return line.split(delimiter)


def delimiter_of(line, spaces=True):
    best = max(",;\t", key=lambda mark: len(cells_of(line, mark)))
    return " " if spaces and best not in line and len(line.split()) >= 4 else best


PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


class Wrong(float):
    """A cell that is neither a number nor blank; it equals nothing."""


def number(cell, decimal="."):
    text = cell.strip().strip('"').strip()
    if text.lower() in ("", "nan", "+nan", "-nan"):
        return math.nan
    if decimal == ",":
        text = text.replace(".", "?").replace(",", ".", 1)
    if text.lstrip("+-").lower() in ("inf", "infinity") and len(text) - len(text.lstrip("+-")) < 2:
        return math.inf  # a number that no sensor gives: missing
    return float(text) if text.isascii() and PLAIN.fullmatch(text) else Wrong(math.nan)


class SaysNothing(Exception):
    """The log does not say what the channels would be."""


def is_title(lines, i):
    """Whether a line of one cell stands above names of columns, which stand above a number."""
    stated = [line for line in lines[i:100] if line.strip() and not line.lstrip().startswith("#")]
    for k, line in enumerate(stated[:-1]):
        mark = delimiter_of(line, spaces=False)
        words = [cell for cell in cells_of(line, mark) if cell.strip()]
        if len(words) == 1 and isinstance(number(words[0]), Wrong):
            continue
        below = cells_of(stated[k + 1], mark)
        plain = len(words) > 1 and all(isinstance(number(word), Wrong) for word in words)
        first = number(below[0], "," if mark != "," and "," in below[0] else ".")
        return bool(
            k and plain and len(below) == len(cells_of(line, mark)) and not isinstance(first, Wrong)
            and not math.isnan(first)
        )  # fmt: skip
    return False


def header_of(lines):
    """Return (index, delimiter, cells) of the first line that is neither blank nor a comment."""
    for i, line in enumerate(lines):
        if line.strip() and not line.lstrip().startswith("#"):
            if is_title(lines, i):
                continue
            delimiter = delimiter_of(line)
            cells = cells_of(line, delimiter)
            if delimiter == " ":  # a unit in brackets belongs to the name before it
                cells = re.sub(r" +(?=[(\[])", "\xa0", " ".join(cells)).split(" ")
            while cells and not cells[-1].strip():
                cells.pop()
            return i, delimiter, cells
    raise SaysNothing("a header")


PREFIXES = {"": 1.0, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "c": 1e-2, "d": 1e-1, "k": 1e3,
            "M": 1e6, "G": 1e9, "h": 1e2}  # fmt: skip
POUND = 4.4482216152605
BASES = {
    "force": {"N": 1.0, "Newton": 1.0, "newton": 1.0, "gf": 9.80665e-3, "lbf": POUND},
    "torque": {"N·m": 1.0, "lbf-in": POUND * 0.0254, "lbf-ft": POUND * 0.3048}
    | {f"N{mark}{x}m": PREFIXES[x] for mark in ("·", "*", ".", "", "-", " ") for x in ("", "m", "c", "µ")},
    "angular speed": {"rad/s": 1.0, "RPM": math.pi / 30, "rpm": math.pi / 30, "deg/s": math.pi / 180},
    "time": {"s": 1.0, "min": 60.0, "h": 3600.0},
    "length": {"m": 1.0, "inch": 0.0254, "foot": 0.3048, "Meters": 1.0, "Millimeters": 1e-3, "ft": 0.3048,
               "Centimeters": 1e-2, "Inches": 0.0254, "Feet": 0.3048, "in": 0.0254},
    "angle": {"rad": 1.0, "deg": math.pi / 180},
    "voltage": {"V": 1.0}, "current": {"A": 1.0},
}  # fmt: skip
COMMANDS = ("us", "µs", "μs", "dshot", "1", "-", "")


def factor_of(unit, quantity):
    """Return the factor of a printed unit to SI; None where it is no unit of that quantity."""
    match = BASES[quantity].get(unit)
    if match is not None:
        return match
    for prefix, factor in PREFIXES.items():
        base = BASES[quantity].get(unit.removeprefix(prefix)) if prefix and unit.startswith(prefix) else None
        if base is not None:
            return factor * base
    return None


BRACKETS = re.compile(r"(.*?)\s*[(\[]\s*([^()\[\]]*?)\s*[)\]]")
SUFFIX = re.compile(r"(.+?)_(rad_s|deg_s|m_s2|m_s|N_m|mm|cm|ms|us|ns|Nm|rpm|deg|rad|m|s|N|V|A)")


def label_of(cell):
    """Return (name in lower case, printed unit or None) of a column's label."""
    text = cell.strip().strip('"').strip()[:200]
    match = BRACKETS.fullmatch(text) or SUFFIX.fullmatch(text)
    unit = None
    if match:
        text, unit = match[1], {"rad_s": "rad/s", "N_m": "N*m", "deg_s": "deg/s"}.get(match[2], match[2])
    return re.sub(r"[\s_.:/]+", " ", text).strip().casefold(), unit


@dataclass
class Row:
    """One line: its times, its numbers by (channel, component), and whether it has all the header's cells."""

    line: int
    times: tuple
    numbers: dict
    whole: bool = True
    open_end: bool = False


@dataclass
class Table:
    """Rows on one clock. `widths` are the channels; `turns` those that are normalised, of free sign."""

    rows: list = field(default_factory=list)
    widths: dict = field(default_factory=dict)
    turns: dict = field(default_factory=dict)
    # The most rows that a stand may have left over from an earlier run.
    stale: int = 0
    # The clock may begin later than the times say, by one number for all rows.
    offset: bool = False
    # Rows have no times but their number, so no row may vanish.
    counted: bool = False


def fill(
    table, lines, closed, first, last, delimiter, columns, time, *, least, most=0, words=None, width=None,
    decimal=None, skip=(),
):  # fmt: skip
    """Add the rows of lines `first` to `last`.

    `columns` is (channel, component) -> (column, factor); `time` a function of the row's numbers by column.
    A row of more cells than `most`, and than most rows have, gives no number; but the words of column `words`
    may contain delimiters. `width`: columns with a name, where rows may have filled cells behind them.
    """
    wanted = sorted({column for column, _ in columns.values()})
    for channel, component in columns:
        table.widths[channel] = max(table.widths.get(channel, 0), component + 1)
    body = [
        (i, cells_of(lines[i], delimiter))
        for i in range(first, last)
        if lines[i].strip(" \r\v\f" if delimiter == "\t" else None) and not lines[i].lstrip().startswith("#")
    ]
    if decimal is None:
        cells = [row[c] for _, row in body[:200] for c in (*wanted, *skip) if c < len(row)]
        comma = any("," in cell for cell in cells) and not any("." in cell for cell in cells)
        decimal = "," if delimiter != "," and comma else "."
    counts = Counter(len(cells) for _, cells in body)
    full = {n: count for n, count in counts.items() if n >= most}
    usual = min((n for n in full if full[n] == max(full.values())), default=0)
    for i, cells in body:
        limit = max(most, usual if width is None else min(usual, width + 1))
        long = most and delimiter != " " and len(cells) > limit
        if words is not None and words + 1 == most == len(cells) and sum(full.values()) * 2 < len(body):
            # A number where words should be, and a gap before it.
            long = bool(cells[words].strip()) and any(not cells[c].strip() for c in wanted)
        if words is not None and words < len(cells) and isinstance(number(cells[words]), Wrong):
            long = False  # words with delimiters in them
        whole = len(cells) >= least or (
            words is not None and len(cells) == words + 1 and isinstance(number(cells[words]), Wrong)
        )
        if long and words is not None and not cells[words].strip() and len(cells) > most:
            long = not any(c.strip() for c in cells[words + 1 :])  # else cells that a script appended

        def at(column, cells=cells):
            return number(cells[column], decimal) if column < len(cells) else math.nan

        numbers = {key: at(column) * factor for key, (column, factor) in columns.items()}
        for key, (column, _) in columns.items():
            if isinstance(at(column), Wrong):
                numbers[key] = Wrong(math.nan)
        times = tuple(time(at))
        row = Row(i + 1, times, numbers, whole and not long, i == len(lines) - 1 and not closed)
        table.rows.append(row)


def assert_matches(recording, tables):
    """Assert that the recording holds the samples of these tables, and nothing else."""
    owner = {name: table for table in tables for name in table.widths}
    strangers = set(recording.channels) - set(owner)
    assert not strangers, f"channels that the file does not have: {strangers}"
    assert recording.channels
    for table in tables:
        channels = [recording[name] for name in table.widths if name in recording.channels]
        if channels:
            assert_rows(channels, table, recording.kind == "static-map")
        for name in set(table.widths) - set(recording.channels):
            lost = [row.line for row in table.rows if row.whole and known(row, name, table) and row.times]
            assert not lost, f"{name} stands in line {lost[0]} but is not in the recording"


def known(row, name, table):
    cells = [row.numbers.get((name, k), math.nan) for k in range(table.widths[name])]
    return all(math.isfinite(x) for x in cells) and (name not in table.turns or any(cells))


def assert_rows(channels, table, points):
    clock = channels[0].time
    assert len(clock) > 0
    for channel in channels:
        np.testing.assert_array_equal(channel.time, clock)
    rows = list(table.rows)
    shifts = [0.0]
    if table.offset:
        shifts = sorted({float(clock[0]) - t for row in rows[:3] for t in row.times[:1]}, key=abs)[:3] or [
            0.0
        ]
    failed = [walk(channels, clock, rows, table, points, shift) for shift in shifts]
    assert "" in failed, failed[0]
    for channel in channels:
        if channel.name in table.turns:
            seen = channel.values[np.isfinite(channel.values).all(axis=1)]
            assert np.all(np.sum(seen[1:] * seen[:-1], axis=1) >= 0), f"{channel.name} jumps in sign"


def walk(channels, clock, rows, table, points, shift):
    """Find each sample in the next line that holds it; return what does not fit, else nothing."""
    at = 0
    for i, time in enumerate(clock):
        passed = []
        while at < len(rows):
            row = rows[at]
            at += 1
            # Of lines that repeat one time the last is the sample.
            why = "" if points or not repeated(rows, at - 1) else "the next line has the same time"
            why = why or mismatch(channels, i, time, row, table, points, shift)
            if not why:
                break
            passed.append((row, why))
            if not vanishes(rows, at - 1, points, table):
                return f"sample {i} at {time!r} s, line {row.line}: {why}"
        else:
            reason = f"; line {passed[0][0].line}: {passed[0][1]}" if passed else ""
            return f"sample {i} at {time!r} s is in no line that is left{reason}"
    left = [rows[k].line for k in range(at, len(rows)) if not vanishes(rows, k, points, table)]
    return f"line {left[0]} is not in the recording" if left else ""


def timed(row):
    return bool(row.times) and row.whole and math.isfinite(row.times[0])


def repeated(rows, k):
    later = next((row for row in rows[k + 1 :] if timed(row)), None)
    return later is not None and not later.open_end and timed(rows[k]) and rows[k].times[0] == later.times[0]


def vanishes(rows, k, points, table):
    """Return whether there is a reason for which a line may be left out."""
    row = rows[k]
    if row.open_end or points:
        return row.open_end
    if not timed(row) or repeated(rows, k):
        return not table.counted
    later = next((r for r in rows[k + 1 :] if timed(r)), None)
    return later is not None and k < table.stale and row.times[0] > later.times[0]


def mismatch(channels, i, time, row, table, points, shift):
    if not points:
        if not row.times or not (row.whole or table.counted) or not same_time(time, row.times[0], shift):
            return f"the line's time is {row.times}"
        if any(abs(time - other) > 0.61e-3 for other in row.times[1:]):
            return f"the Time column says {row.times[1:]}"
    for channel in channels:
        got = np.atleast_1d(channel.values[i])
        if row.open_end and np.isnan(got).all():
            continue  # a cut number is not to be trusted
        stated = [row.numbers.get((channel.name, k), math.nan) for k in range(table.widths[channel.name])]
        if not row.whole:
            stated = [math.nan] * len(stated)
        if any(isinstance(x, Wrong) for x in stated):
            return f"{channel.name} is no number in the line"
        stated = np.array([x if math.isfinite(x) else math.nan for x in stated])
        if channel.name in table.turns:
            stated = table.turns[channel.name](stated, got)
            if stated is None and not row.open_end:
                return f"{channel.name} is no unit quaternion in the line"
            stated = np.full(len(got), np.nan) if stated is None else stated
            fits = len(stated) == len(got) and all(map(close_units, got.tolist(), stated.tolist()))
        else:
            fits = len(stated) == len(got) and all(map(close, got, stated))
        if not fits:
            return f"{channel.name} is {got}, the line says {stated}"
    return ""


def close_units(got, stated):
    # Numbers of size 1, normalised once.
    return abs(got - stated) <= 1e-12 or (math.isnan(got) and math.isnan(stated))


def close(got, stated):
    if math.isnan(stated) or math.isnan(got):
        return math.isnan(stated) and math.isnan(got)
    return abs(got - stated) <= FACTOR * abs(stated)


def same_time(got, stated, shift):
    # A shift is a difference of rounded times; without one, a product and a quotient are rounded.
    return abs(got - shift - stated) <= (1e-9 if shift else 4 * math.ulp(max(abs(stated), 1e-3)))


def matrix_of(unit):
    """Return the rotation matrix of a unit quaternion, w first, multiplied out by hand."""
    w, x, y, z = unit
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def quaternion(stated, got):
    """Return the unit quaternion of four printed numbers, of the sign that was recorded."""
    length = float(np.linalg.norm(stated))
    if math.isnan(length) or length == 0:
        return np.full(4, np.nan)
    if abs(length - 1) > 0.02:
        return None
    unit = stated / length
    return unit if not np.isfinite(got).all() or unit @ got >= 0 else -unit


def of_vector(stated, got):
    """Return the unit quaternion of a rotation vector [rad]."""
    angle = float(np.linalg.norm(stated))
    if math.isnan(angle):
        return np.full(4, np.nan)
    unit = np.append(math.cos(angle / 2), 0.5 * np.sinc(angle / (2 * math.pi)) * stated)
    return unit if not np.isfinite(got).all() or unit @ got >= 0 else -unit


def turned(stated, got):
    """Return the unit quaternion of nine printed numbers of a matrix, by columns."""
    if not np.isfinite(stated).all() or not stated.any():
        return np.full(4, np.nan)
    matrix = stated.reshape(3, 3).T
    if np.abs(matrix.T @ matrix - np.eye(3)).max() > 0.02 or np.linalg.det(matrix) <= 0:
        return None
    left, _, right = np.linalg.svd(matrix)
    nearest = left @ right
    # The rotation that the recorded quaternion is, compared as a matrix: there the sign is no matter.
    return got if np.abs(matrix_of(got) - nearest).max() < 1e-9 and abs(got @ got - 1) < 1e-12 else None
