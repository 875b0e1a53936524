"""ATI force/torque logs as text: six channels per row, as forces and torques or as gauge voltages.

Read are the forms that labs write: a first line that states ``sampling freq``, rows of six numbers or of a
time and six numbers without header, ``Column1 ... Column7``, rows printed as ``[ 0.1 -0.2 ... ]``. The six
channels are Fx Fy Fz Tx Ty Tz by their place, because the labels of such logs repeat or mistype names; where
every label is a known name and none repeats, `load_cell_csv` reads the log by name. With `calibration` (the
transducer's ``.cal`` file) the six are gauge voltages. Units are not in the file: declare them.

A ``.cal`` file states FT = UserAxis · (V − V_bias): six rows Fx Fy Fz Tx Ty Tz of six numbers, in its force
and torque units. ``UserAxis`` is used and not ``Axis``, as the file itself asks: it contains the scale and
the maker's basic transform already.
"""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

from sysid.errors import LogError, UnitError
from sysid.journal import note
from sysid.loaders.clock import DECLARE_RATE, declared_rate, jitter_note, known_rate, order_rows, rate_clock
from sysid.loaders.columns import naming
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO, POSSIBLE
from sysid.loaders.source import Source, Text, read_text, sniff_delimiter, split_line
from sysid.loaders.table import TableHead, parse_number, read_numbers
from sysid.loaders.table_log import AXES, RawTable, table_format
from sysid.types import FloatArray
from sysid.units import factor_to_si

_STATES_RATE = "sampling freq"
_HEADER_LINES = 20
# Least step of a first column that counts rows or is not in seconds [s]: force/torque logs are faster.
_SLOWEST_STEP = 0.5
# Number of steps over which no load rises steadily.
_FEW_STEPS = 20
# Largest range of the steps of a steady clock [median steps].
_STEADY = 0.5
# Largest ratio of falling to rising steps of a clock [1]: a damaged number makes a clock fall, noise makes a
# load fall in half of its steps.
_FALLS = 0.02
_LARGEST_CALIBRATION = 1 << 20
_NO_BRACKETS = bytes.maketrans(b"[]", b"  ")


def _delimiter(line: str) -> str:
    """Return what parts a line: where there is a semicolon or a TAB, commas are decimal."""
    return next((mark for mark in ";\t" if mark in line), "") or sniff_delimiter(line)


def _value(cell: str) -> float | None:
    """Return the number in a cell, NaN for a blank one; None for words."""
    try:
        return parse_number(cell, "," if "," in cell else ".")
    except ValueError:
        return None


def _cells(line: str) -> list[str]:
    line = line.strip("[] ")
    cells = split_line(line, _delimiter(line))
    while cells and not cells[-1].strip():
        cells.pop()
    return [cell.strip() for cell in cells]


def _is_number(cell: str) -> bool:
    return math.isfinite(math.nan if (value := _value(cell)) is None else value)


def _is_row(cells: list[str]) -> bool:
    return len(cells) in (6, 7) and all(map(_is_number, cells))


def _recognize(source: Source) -> int:
    lines = [line for line in source.head_lines if line.strip()][:_HEADER_LINES]
    if not lines:
        return NO
    first, numbered = _cells(lines[0]), [f"column{i + 1}" for i in range(7)]
    labelled = [cell.casefold() for cell in first] in (numbered, numbered[:6])
    if _STATES_RATE in lines[0].casefold() or labelled or (lines[0].startswith("[") and _is_row(first)):
        return CERTAIN
    return POSSIBLE if all(_is_row(_cells(line)) for line in lines[:3]) else NO


def _table(text: Text, path: str) -> tuple[Text, TableHead, float | None]:
    """Return the text with one delimiter, where its rows and their columns are, and the rate."""
    start = text.data[:4096]
    if text.data.lstrip().startswith(b"[") or not any(mark in start for mark in (b",", b";", b"\t")):
        # Rows are printed by numpy, or delimited by spaces.
        text = Text(path, text.data.translate(_NO_BRACKETS), text.notes)
    rate = None
    states = False
    begin: tuple[int, int] | None = None
    for number, offset, line in text.lines(_HEADER_LINES):
        cells = _cells(line)
        if number == 1 and _STATES_RATE in line.casefold():
            states = True
        elif _is_row(cells):
            # Reading begins at a row above this one that has a damaged or a blank cell.
            names = ("t", *AXES) if len(cells) == 7 else AXES
            before, place = begin or (number - 1, offset - len(line.encode("utf-8")) - 1)
            return text, TableHead(names, _delimiter(line), before, max(place, 0)), rate
        elif states and rate is None:
            try:
                rate = known_rate(_value(cells[0])) if len(cells) > 1 else None
            except ValueError:
                continue
            # A line of settings with words in it is damaged and may have swallowed the first row.
            word = next((cell for cell in cells if _value(cell) is None), None)
            if word is not None:
                raise LogError(
                    f"{path}, line {number}: {word[:40]!r} is no number in the line that states the rate; "
                    "mend or delete that line and declare rate = ..."
                )
        elif begin is not None or not line.strip() or (rate is None and number > 1):
            continue
        elif not cells or any(map(_is_number, cells)):  # labels are no numbers
            begin = number - 1, offset - len(line.encode("utf-8")) - 1
    raise LogError(
        f"{path}: no row of six numbers, or of a time and six, in the first {_HEADER_LINES} "
        "lines; check the format"
    )


def _read_calibration(path: Path) -> tuple[str, FloatArray, FloatArray]:
    """Return device, (6, 6) matrix from volts to N and N·m, and (6,) largest loads of a ``.cal`` file."""
    where = str(path)
    try:
        data = path.read_bytes()
    except (OSError, ValueError) as error:
        raise LogError(f"{where}: the calibration cannot be read ({error}); check calibration") from error
    # A calibration declares no entities; one that does could unfold into gigabytes.
    if len(data) > _LARGEST_CALIBRATION or b"<!" in data.replace(b"<!--", b""):
        raise LogError(
            f"{where}: not a calibration as ATI writes it; use the file that came with the transducer"
        )
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise LogError(
            f"{where}: the calibration is no XML ({error}); use the file as ATI sent it"
        ) from error
    node = root if root.tag == "Calibration" else root.find(".//Calibration")
    rows = {axis.get("Name", ""): axis for axis in (node.findall("UserAxis") if node is not None else [])}
    missing = [axis for axis in AXES if axis not in rows]
    if node is None or missing:
        raise LogError(
            f"{where}: no UserAxis {', '.join(missing) or 'rows'} in it; use the file as ATI sent it"
        )
    factors = []
    for key, expected in (("ForceUnits", "N"), ("TorqueUnits", "N*m")):
        unit = node.get(key, "")
        if not unit:
            raise UnitError(f"{where}: states no {key}; use the file as ATI sent it")
        with naming(f"{where}: {key}"):
            factors.append(factor_to_si(unit, expected))
    scale = np.repeat(factors, 3)
    rows_of_six, limits = [], np.full(6, np.nan)
    for place, axis in enumerate(AXES):
        try:
            row = [float(cell) for cell in rows[axis].get("values", "").split()]
        except ValueError:
            row = []
        if len(row) != 6 or not np.all(np.isfinite(row)):
            raise LogError(f"{where}: UserAxis {axis} is not six numbers; use the file as ATI sent it")
        rows_of_six.append(row)
        with suppress(ValueError):
            limits[place] = float(rows[axis].get("max", "nan"))
    parts = [root.get("BodyStyle", ""), root.get("Serial", ""), node.get("PartNumber", "")]
    return " ".join(["ATI", *filter(None, parts)]), np.array(rows_of_six) * scale[:, None], limits * scale


def _turns(column: FloatArray) -> tuple[int, int, bool]:
    """Return in how many steps a column rises, in how many it falls, and whether it hardly ever falls.

    An unsteady clock hardly ever falls, and no load that is not flat.
    """
    steps = np.diff(column[np.isfinite(column)])
    rises, falls = int(np.count_nonzero(steps > 0)), int(np.count_nonzero(steps < 0))
    return rises, falls, rises > _FEW_STEPS and falls <= _FALLS * rises


def _check_time_is_first(path: str, first: FloatArray, last: FloatArray, *, unused: bool) -> None:
    """Refuse rows of seven whose last number may be the time, or whose first, `unused` as clock, is none."""
    steps = np.diff(last[np.isfinite(last)])
    # A clock rises by about one step all the way, and no load does.
    steady = steps.size > _FEW_STEPS and steps.min() > 0 and np.ptp(steps) <= _STEADY * np.median(steps)
    rises, falls, first_rises = _turns(first)
    if steady or (not first_rises and _turns(last)[2]):
        how = "rises steadily" if steady else "hardly ever falls"
        fault = f"the last of seven columns {how}, as a time does, and the first does not"
        if first_rises:
            fault = "the first and the last of seven columns rise steadily, so either may be the time"
        raise LogError(
            f"{path}: {fault}; expected the time and then Fx Fy Fz Tx Ty Tz: move or remove the column that "
            'is no load, or, where the first is the time, say so with units = {time = "s"}'
        )
    if unused and falls > max(1.0, _FALLS * rises):
        raise LogError(
            f"{path}: the first of seven columns falls in {falls} steps, so it is no time; expected the time "
            "and then Fx Fy Fz Tx Ty Tz: remove the column that is no load"
        )


def _parse(source: Source, options: BenchOptions) -> RawTable:
    path, rate = source.path, declared_rate(source.path, options.rate)
    loads, seconds = options.units, None
    if isinstance(loads, Mapping) and "time" in loads:
        with naming(f"{path}: time"):
            seconds = factor_to_si(str(loads["time"]), "s")
        loads = {name: unit for name, unit in loads.items() if name != "time"} or None
    if options.calibration is not None and loads is not None:
        raise UnitError(f"{path}: units and calibration exclude each other: the calibration states its own")
    device, limits = "ATI", None
    if options.calibration is None:
        if loads is None:
            raise UnitError(
                f"{path}: such a log does not state its units; declare them, for example "
                'units = {force = "N", torque = "N*m"} or {force = "lbf", torque = "lbf-in"}'
            ).asking(units={"force": "N", "torque": "N*m"})
        if isinstance(loads, Mapping) and "thrust" in loads and "force" not in loads:
            loads = {("force" if name == "thrust" else name): unit for name, unit in loads.items()}
        if not isinstance(loads, Mapping) or set(loads) != {"force", "torque"}:
            raise UnitError(f'{path}: units = {loads!r}; expected {{force = "N", torque = "N*m"}}')
        with naming(path):
            factors = [factor_to_si(str(loads["force"]), "N"), factor_to_si(str(loads["torque"]), "N*m")]
        scale = np.repeat(factors, 3)
    else:
        device, scale, limits = _read_calibration(Path(path).parent / options.calibration)
    text, table, stated = _table(read_text(source), path)
    lead = len(table.names) - 6
    numbers = read_numbers(text, table, range(len(table.names)), surplus=False)
    del text  # the file's bytes are not needed any more
    if lead and seconds is None:
        unused = rate is not None or options.time_back == "drop"
        _check_time_is_first(path, numbers.columns[0], numbers.columns[6], unused=unused)
    notes = numbers.notes
    rate = stated if rate is None else rate
    if seconds is not None and not lead:
        raise UnitError(f"{path}: units names a time, but rows have six numbers and no time; leave it out")
    if lead and rate is None:
        time, ordered = order_rows(path, numbers, 0, seconds or 1.0, options=options, coarse=DECLARE_RATE)
        step = float(np.median(np.diff(time))) if time.size > 1 else 0.0
        if seconds is None and step >= _SLOWEST_STEP:
            raise LogError(
                f"{path}: the first of seven columns, read as seconds, steps by {step:.6g}, too slow for "
                'a force log; declare its unit, for example units = {time = "ms"}, or the sample rate with '
                "rate = ... where it counts rows"
            )
        if seconds is None:
            sentence = "the first of seven columns is taken as the time in seconds, which no label says"
            notes.append(note("first-column-is-time", sentence))
        notes += [*ordered, *jitter_note(time)]
    elif rate is not None:
        rows = np.flatnonzero(np.isfinite(numbers.columns[0]))
        counts = rows.size > 1 and np.ptp(numbers.columns[0][rows] - rows) == 0
        counted = lead and seconds is None and counts
        written = numbers.columns[0] * (seconds or 1.0) if lead and not counted else None
        time = rate_clock(path, rate, numbers.lines.size, written)
        if counted:
            sentence = "the first of seven columns counts rows and was left out"
            notes.append(note("first-column-counts-rows", sentence))
        notes.append(note("time-from-rate", f"time rebuilt from the rate of {rate:g} Hz"))
    else:
        refusal = LogError(
            f"{path}: no time column and no rate in the header; declare it [Hz] with rate = ..."
        )
        raise refusal.asking(rate=None)
    load = numbers.stacked(range(lead, lead + 6))
    blank = int(np.isnan(load).all(axis=1).sum())
    notes += [note("blank-rows", f"blank rows, taken as missing: {blank}")] if blank else []
    notes.append(note("channels-by-place", "channels by place: Fx Fy Fz Tx Ty Tz"))
    return RawTable("load-cell", device, time, notes, loads=load, scale=scale, limits=limits)


FORMAT = table_format(
    "ati-text", "ATI force/torque text (six channels by place, .cal)", _recognize, _parse,
    {"rate": (), "units": (), "calibration": (), "transform": (), "tare": (), "time_back": ()},
)  # fmt: skip
