"""ATI Net F/T and Ethernet Axia CSV, as the maker's demo program writes it: counts, and the counts per unit.

    Start Time: ...
    RDT Sample Rate: 7000
    Force Units: N
    Counts per Unit Force: 1000000.0
    Torque Units: Nm
    Counts per Unit Torque: 1000000.0
    Status (hex), RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time

Time is the RDT sequence number over the rate: a jump is a lost packet and stays a hole. The column Time is
the PC's clock at arrival and is not read.
"""

import re
from collections.abc import Mapping

import numpy as np

from sysid.errors import LogError, UnitError
from sysid.journal import Finding, note
from sysid.loaders.clock import began_note, known_rate, order_rows
from sysid.loaders.columns import listing, naming
from sysid.loaders.options import BenchOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.source import Source, Text, read_text, shortened, split_line
from sysid.loaders.table import TableHead, parse_number, read_numbers
from sysid.loaders.table_log import AXES, RawTable, table_format
from sysid.units import factor_to_si

_SEQUENCE = "rdt sequence"
_HEADER_LINES = 15


def _recognize(source: Source) -> int:
    lines = [line.strip(' "').casefold() for line in source.head_lines[:_HEADER_LINES]]
    counts = any(line.startswith("counts per unit force") for line in lines)
    return CERTAIN if counts and any(_SEQUENCE in line for line in lines) else NO


def _header(text: Text) -> tuple[dict[str, str], TableHead]:
    stated: dict[str, str] = {}
    for number, offset, line in text.lines(_HEADER_LINES):
        names = [cell.strip() for cell in split_line(line, ",")]
        if _SEQUENCE in [name.casefold() for name in names]:
            return stated, TableHead(tuple(names), ",", number, offset)
        key, _, value = line.strip(' ",').partition(":")
        if not value:  # the value may be in the next cell
            key, _, value = line.strip(' ",').partition(",")
        stated[key.strip(' "').casefold()] = value.strip(' ",')
    raise LogError(f'{text.path}: no header row with "RDT Sequence" in the first {_HEADER_LINES} lines')


def _positive(path: str, stated: Mapping[str, str], key: str) -> float:
    try:
        return known_rate(parse_number(stated[key]))
    except (KeyError, ValueError):
        fault = f"is {stated[key][:40]!r}" if key in stated else "is missing"
        raise LogError(f'{path}: "{key}" in the header {fault}; expected a positive number') from None


def _unit(path: str, stated: Mapping[str, str], key: str, expected: str) -> float:
    if not stated.get(key):
        raise UnitError(f'{path}: "{key}" is missing in the header; record again with the header')
    with naming(f"{path}: {key}"):
        return factor_to_si(stated[key], expected)


def _status_note(text: Text, table: TableHead, known: list[str]) -> list[Finding]:
    """Return a note of the rows whose status is not 0: the transducer doubts them (saturated, off its range).

    The word is hexadecimal. What each bit means differs between boxes, so the note lists the values and does
    not explain them.
    """
    place = next((index for index, name in enumerate(known) if name.startswith("status")), None)
    if place is None:
        return []
    wrong = re.compile(
        rb"^(?:[^,\n]*,){%d}[ \t\"]*((?:0[xX])?0*[1-9A-Fa-f][0-9A-Fa-f]*)" % place, re.MULTILINE
    )
    matches = list(wrong.finditer(text.data, table.offset))
    if not matches:
        return []
    first = text.data.count(b"\n", 0, matches[0].start()) + 1
    words = listing(dict.fromkeys(shortened(match[1].decode(), 20) for match in matches))
    sentence = (
        f"rows with a status other than 0: {len(matches)} (first: line {first}; {words}); the "
        "transducer reports an error or an overload there, so check them"
    )
    return [note("status-not-zero", sentence)]


def _parse(source: Source, options: BenchOptions) -> RawTable:
    path = source.path
    text = read_text(source)
    stated, table = _header(text)
    rate = _positive(path, stated, "rdt sample rate")
    per_force = _positive(path, stated, "counts per unit force")
    per_torque = _positive(path, stated, "counts per unit torque")
    force, torque = _unit(path, stated, "force units", "N"), _unit(path, stated, "torque units", "N*m")
    known = [name.casefold() for name in table.names]
    missing = [axis for axis in AXES if known.count(axis.casefold()) != 1]
    if missing:
        raise LogError(
            f"{path}, line {table.line}: columns {', '.join(missing)} are missing or repeated; found "
            f"{listing(table.names)}"
        )
    places = [known.index(axis.casefold()) for axis in AXES]
    sequence = known.index(_SEQUENCE)
    numbers = read_numbers(text, table, [sequence, *places], least=max(sequence, *places) + 1)
    notes = [*numbers.notes, *_status_note(text, table, known)]
    del text  # the file's bytes are not needed any more
    counted = numbers.columns[sequence]
    first = counted[np.isfinite(counted)][:1]
    if not first.size:
        raise LogError(f"{path}: no row has an RDT sequence number; the log is empty")
    numbers.columns[sequence] = counted - first[0]
    time, ordered = order_rows(path, numbers, sequence, 1.0 / rate, options=options)
    lost = round(float(time[-1] * rate)) + 1 - time.size
    notes += [*ordered, *([note("packets-lost", f"packets lost, left as holes: {lost}")] if lost > 0 else [])]
    notes.append(note("time-from-sequence", f"time rebuilt from RDT sequence numbers at {rate:g} Hz"))
    scale = np.repeat([force / per_force, torque / per_torque], 3)
    load = numbers.stacked(places) * scale
    notes += began_note("recording", stated.get("start time", ""))
    return RawTable("load-cell", "ATI Net F/T", time, notes, loads=load)


FORMAT = table_format(
    "net-ft-csv", "ATI Net F/T CSV (counts)", _recognize, _parse,
    {"transform": (), "tare": (), "time_back": ()},
)  # fmt: skip
