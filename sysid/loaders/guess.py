"""What a refused text log does not state: its columns with their ranges, and options that may fit them.

A guess is printed for a person, who checks it and gives it as an option. No log is read with it in silence.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sysid.errors import LogError, SysidError
from sysid.loaders.columns import table_head
from sysid.loaders.load_cell import STEMS
from sysid.loaders.registry import detect, load
from sysid.loaders.source import Source, Text, check_foreign, read_text, split_line
from sysid.loaders.table import (
    HEADER_SEARCH,
    STAMPS,
    all_numeric,
    find_header,
    is_number,
    read_numbers,
    stamped,
)

# Parts of names by channel of a bench log, the surest first; a channel that stands earlier chooses first.
_WORDS = {
    "time": ("time", "stamp", "clock", "elapsed", "millis", "micros", "zeit"),
    "speed": ("rpm", "omega", "speed", "velocity", "tach", "drehzahl"),
    "torque": ("torque", "moment"),
    "thrust": ("thrust", "force", "lift", "load", "weight", "fz", "schub", "kraft"),
    "voltage": ("volt", "vbat", "battery", "spannung"),
    "current": ("current", "amp", "ibat", "strom"),
    "command": ("command", "throttle", "pwm", "duty", "cmd", "esc", "signal", "gas"),
}
# Units by the SI unit of a channel, each with its largest plausible value; a time is judged by its step.
_UNITS: dict[str, tuple[tuple[float, str], ...]] = {
    "rad/s": ((3000.0, "rad/s"), (np.inf, "rpm")),
    "N": ((50.0, "N"), (np.inf, "gf")),
    "N*m": ((5.0, "N*m"), (np.inf, "mN*m")),
    "V": ((100.0, "V"), (np.inf, "mV")),
    "A": ((400.0, "A"), (np.inf, "mA")),
    "m": ((50.0, "m"), (np.inf, "mm")),
    "s": ((0.5, "s"), (500.0, "ms"), (5e5, "us"), (np.inf, "ns")),
    "command": ((1.0, "1"), (100.0, "%"), (699.0, "dshot"), (2300.0, "us")),
}
# Most options that one log may lack; rows among which a column of words is told from one of numbers.
_MOST_MISSING, _ROWS = 30, 200
# Stands for a rate that nothing in the file tells.
_UNKNOWN_RATE = "TODO Hz"


@dataclass(frozen=True)
class RawColumn:
    """A column as the file has it; numbers in the file's own unit, NaN in a column of words."""

    name: str
    lowest: float
    highest: float
    # Median step between two rows, 0 where it falls somewhere.
    step: float
    first: float


@dataclass(frozen=True)
class Missing:
    """What a refused log has, and what has to be given with it.

    `columns` are of the file. With `format` (empty: the content tells) and `options` the log is read, unless
    it has a fault that no option mends: `fault` is its refusal then.
    """

    columns: tuple[RawColumn, ...]
    format: str
    options: dict[str, object]
    fault: str

    def guess(self, name: str) -> str:
        """Return the channel and the unit that are guessed for a column of the file; empty without one."""
        renamed, units = self.options.get("columns"), self.options.get("units")
        new = {old: new for new, old in renamed.items()} if isinstance(renamed, Mapping) else {}
        unit = units.get(new.get(name, name)) if isinstance(units, Mapping) else None
        return " ".join(filter(None, [new.get(name, ""), f"[{unit}]" if unit else ""]))


def missing(
    path: str | Path, format: str, options: Mapping[str, object], read: Collection[str] | None = None
) -> Missing | None:
    """Return what a text log lacks beside the given `options`.

    A log that is not refused has channels that are `read`; it lacks those that other columns are named after.
    None for a log that lacks nothing, and for a file that is no table.
    """
    try:
        source = Source(path)
        check_foreign(source)
        columns = _raw_columns(read_text(source))
    except SysidError:
        return None
    nearest, renamed = _nearest(columns) if format == "auto" else ("", {})
    renamed = {} if "columns" in options else renamed
    out = None
    if read is None:
        chosen, found = "", dict[str, object]()
        if format == "auto":
            try:
                detect(path)
            except LogError:
                if not nearest:
                    return Missing(columns, "", {}, "")
                chosen, found = nearest, {"columns": renamed} if renamed else {}
        out, read = _completed(path, format, options, columns, chosen, found)
        if chosen or out.fault:
            return out
    # A column whose name says a channel, beside others that the format of the content knows.
    if nearest == "load-cell-csv" and {*renamed} - {"time", *read}:
        whole, more = _completed(path, format, options, columns, nearest, {"columns": renamed})
        if {*read} & {*renamed} < {*more} & {*renamed}:
            return whole
    return out


def _completed(
    path: str | Path, format: str, options: Mapping[str, object], columns: tuple[RawColumn, ...],
    chosen: str, found: dict[str, object],
) -> tuple[Missing, tuple[str, ...]]:  # fmt: skip
    """Return what a log lacks beside what is `found`, and the channels that are read with all of it."""
    by_name = {column.name: column for column in columns}
    read: tuple[str, ...] = ()
    for _ in range(_MOST_MISSING):
        given = {name: found.get(name, value) for name, value in options.items()} | found
        if given.get("rate") == _UNKNOWN_RATE:
            given["rate"] = 1000.0
        try:
            read = tuple(load(path, format=chosen or format, **given).channels)
        except SysidError as error:
            more = {
                name: value for name, value in error.needs.items() if name == "units" or name not in given
            }
            if not more:
                return Missing(columns, chosen, found, str(error)), ()
            for name, value in more.items():
                stated = given.get("columns", {})
                found[name] = _guess(
                    name, value, given, by_name, stated if isinstance(stated, Mapping) else {}
                )
        else:
            break
    return Missing(columns, chosen, found, ""), read


def _guess(
    option: str,
    value: object,
    given: Mapping[str, object],
    columns: Mapping[str, RawColumn],
    renamed: Mapping[str, object],
) -> object:
    """Return the guess of an option that a refusal asks for, together with what is given of it."""
    if option == "rate":
        return _UNKNOWN_RATE if value is None else f"{value} Hz"
    if isinstance(value, list):
        parts = [
            columns[name] for name in (str(renamed.get(name, name)) for name in value) if name in columns
        ]
        if option == "quaternion_order":  # a body that starts level has |w| near 1
            return "xyzw" if np.argmax([abs(part.first) for part in parts]) == 3 else "wxyz"
        return _unit("m", max((max(-part.lowest, part.highest) for part in parts), default=0.0))
    if not isinstance(value, Mapping):
        return value
    stated = given.get(option)
    out: dict[str, object] = dict(stated) if isinstance(stated, Mapping) else {}
    for name, expected in value.items():
        column = columns.get(str(renamed.get(name, name)))
        out[name] = expected
        if column is not None and expected in _UNITS:
            size = column.step if expected == "s" else max(abs(column.lowest), abs(column.highest))
            counted = expected == "rad/s" and re.search("rpm|drehzahl", column.name, re.IGNORECASE)
            out[name] = "rpm" if counted else _unit(expected, size)
    return out


def _unit(expected: str, size: float) -> str:
    return next((unit for most, unit in _UNITS[expected] if size <= most), "TODO")


def _raw_columns(text: Text) -> tuple[RawColumn, ...]:
    """Return the columns of a text table; LogError where it has none."""
    header = find_header([line for _, _, line in text.lines(HEADER_SEARCH)])
    names = header[2] if header else []
    headless = all_numeric(names)
    head = table_head(text, [f"column {i}" for i in range(1, len(names) + 1)] if headless else None)
    text, head = stamped(text, head)
    rows = [
        split_line(line, head.delimiter)
        for _, _, line in text.lines(_ROWS, head.offset)
        if line.strip() and not line.startswith("#")
    ]
    wanted = [
        i for i in range(len(head.names))
        if all(is_number(row[i]) or is_number(row[i], ",") for row in rows if i < len(row))
    ]  # fmt: skip
    if len(head.names) < 2 or not wanted:
        raise LogError(f"{text.path}: no table of numbers")
    values = read_numbers(text, head, wanted, least=1).columns
    out = []
    for index, name in enumerate(head.names):
        known = values[index][np.isfinite(values[index])] if index in values else np.empty(0)
        steps = np.diff(known)
        seconds = 1e-6 if f"({STAMPS})" in name else 1.0
        rises = known.size > 1 and bool((steps >= 0).all())
        edges = (known.min(), known.max(), known[0]) if known.size else (np.nan,) * 3
        low, high, first = (float(edge) * seconds for edge in edges)
        step = float(np.median(steps)) * seconds if rises else 0.0
        out.append(RawColumn(name, low, high, step, first))
    return tuple(out)


def _nearest(columns: Sequence[RawColumn]) -> tuple[str, dict[str, str]]:
    """Return the format that columns of unknown names come nearest to, and its name -> theirs."""
    words = {column.name: column.name.casefold() for column in columns if np.isfinite(column.lowest)}
    poses: dict[str, str] = {}
    for name, word in words.items():
        if axis := re.search(r"(?:^|[^a-z])(q?)[a-z]*?[ _.]*([wxyz])(?:$|[^a-z])|([wxyz])$", word):
            turned = "q" if "q" in word or "rot" in word or "orient" in word else ""
            poses.setdefault(turned + (axis[2] or axis[3]), name)
    if {"x", "y", "z", "qw", "qx", "qy", "qz"} <= set(poses):
        clock = _column_of("time", words, set(poses.values()))
        poses.pop("w", None)
        return "pose-table", ({"t": clock} if clock else {}) | poses
    rising = next((column.name for column in columns if column.step > 0), "")
    found: dict[str, str] = {}
    for channel in _WORDS:
        name = _column_of(channel, words, set(found.values()))
        if name := name or (rising if channel == "time" else ""):
            found[channel] = name
    return ("load-cell-csv", found) if {"thrust", "torque", "speed"} & set(found) else ("", {})


def _column_of(channel: str, words: Mapping[str, str], taken: set[str]) -> str:
    """Return the column whose name comes nearest to a channel; empty if none does."""
    free = {name: word for name, word in words.items() if name not in taken}
    exact = next((name for name, word in free.items() if word in STEMS[channel]), "")
    parts = (name for part in _WORDS[channel] for name, word in free.items() if part in word)
    return exact or next(parts, "")
