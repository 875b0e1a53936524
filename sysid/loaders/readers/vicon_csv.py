"""Vicon CSV: Nexus sections (Trajectories, Segments, Devices, Model Outputs, Joints) and Tracker objects.

A section is a title, its rate [Hz], a row of names, ``Frame,Sub Frame,X,Y,Z,...``, a row of units and the
rows; a blank line ends it and another may follow, at another rate. Time is (frame + sub frame share) over
the capture's rate. Lost markers are blank cells; a lost object leaves a short row.

Rotations: ``Global Angle (Quaternion)`` is x, y, z, w. ``Global Angle`` of Tracker is a rotation vector
(helical angle) in the unit of its unit row, radians where it has none. What the angles of Nexus segments are
depends on the pipeline and is not in the file: declare ``angles``.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.errors import LogError, UnitError
from sysid.journal import Finding, note
from sysid.loaders.capture_log import (
    EULER_ORDERS,
    Body,
    RawCapture,
    capture_format,
    length_factor,
    rotation_quaternions,
    wanted_bodies,
)  # fmt: skip
from sysid.loaders.clock import known_rate, order_rows
from sysid.loaders.columns import listing, naming
from sysid.loaders.options import CaptureOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.signal_log import unique_names
from sysid.loaders.source import Source, Text, read_text, sniff_delimiter, split_line
from sysid.loaders.table import Numbers, TableHead, parse_number, read_numbers
from sysid.types import FloatArray
from sysid.units import factor_to_si

_TRACKS = ("trajectories", "segments", "objects")
_TITLES = ("trajectories", "segments", "objects", "devices", "model outputs", "joints")
_HEADER_LINES = 5
_BLANK_LINE = re.compile(rb"\n[,; \t]*\n")
# Largest number of samples of a device within a frame.
_MOST_SUBS = 1e6
# Fields that a marker needs, and fields that a body needs.
_PLACE, _BODY = ("X", "Y", "Z"), ("RX", "RY", "RZ", "TX", "TY", "TZ")
_LENGTHS = (*_PLACE, *_BODY[3:])


@dataclass(frozen=True)
class _Section:
    """One section: where its rows are, and each column's name, field and unit."""

    title: str
    rate: float
    table: TableHead
    end: int
    names: tuple[str, ...]
    fields: tuple[str, ...]
    units: tuple[str, ...]

    @property
    def states_length(self) -> bool:
        """Whether it has markers or bodies and states their length unit."""
        pairs = zip(self.fields, self.units, strict=True)
        return self.title in _TRACKS and any(unit for field, unit in pairs if field.upper() in _LENGTHS)

    def length(self, path: str, columns: Sequence[int], declared: str | None) -> float:
        """Return the factor to metres of columns."""
        where = f"{path}, line {self.table.line}"
        return length_factor(where, [self.units[column] for column in columns], declared)

    def groups(self) -> dict[str, list[int]]:
        """Return name -> columns, in order; the first two columns are the clock."""
        groups: dict[str, list[int]] = {}
        for column in range(2, len(self.fields)):
            if self.names[column] and self.fields[column]:
                groups.setdefault(self.names[column], []).append(column)
        return groups


def _title(line: str) -> str:
    return line.strip(',;\t "').casefold()


def _recognize(source: Source) -> int:
    lines = [line for line in source.head_lines if line.strip(",;\t ")][:_HEADER_LINES]
    if len(lines) < 2 or _title(lines[0]) not in _TITLES:
        return NO
    rate = lines[1].strip(",;\t ").replace(",", ".").replace(".", "", 1)
    return CERTAIN if rate.isdigit() else NO


def _section(text: Text, offset: int) -> _Section | None:
    """Return the section whose title is the first line behind `offset` that is not blank; None at the end."""
    path = text.path
    rows: list[tuple[int, int, str]] = []
    for line_number, behind, line in text.lines(-1, offset, text.data.count(b"\n", 0, offset)):
        if rows or line.strip(",;\t "):
            rows.append((line_number, behind, line))
        if len(rows) == _HEADER_LINES:
            break
    if not rows:
        return None
    first, _, title = rows[0]
    if _title(title) not in _TITLES:
        raise LogError(
            f"{path}, line {first}: {title.strip()[:40]!r} is no title of a section; expected one of "
            f"{', '.join(known.title() for known in _TITLES)}"
        )
    if len(rows) < _HEADER_LINES:
        raise LogError(f"{path}, line {rows[-1][0]}: the file ends in a section's header; export it again")
    delimiter = sniff_delimiter(rows[3][2], spaces=False)
    stated, names, fields, units = (
        [cell.strip() for cell in split_line(line, delimiter)] for _, _, line in rows[1:]
    )
    try:
        rate = known_rate(parse_number(stated[0].replace(",", ".")))
    except ValueError:
        raise LogError(
            f"{path}, line {rows[1][0]}: {stated[0][:40]!r} is no sample rate; it stands below the title"
        ) from None
    if [cell.casefold() for cell in fields[:2]] != ["frame", "sub frame"]:
        raise LogError(
            f"{path}, line {rows[3][0]}: found {listing(fields[:3])} where Frame, Sub Frame and the fields "
            "should be; export the file again"
        )
    while fields and not fields[-1]:
        fields.pop()
    width = len(fields)
    filled, last = [], ""
    for column in range(width):
        last = names[column] if column < len(names) and names[column] else last
        filled.append("" if column < 2 else last)
    nameless = next((column for column in range(2, width) if fields[column] and not filled[column]), None)
    if nameless is not None:
        raise LogError(
            f"{path}, line {rows[2][0]}: column {nameless + 1} has no name above its field "
            f"{fields[nameless]!r}; export the file again"
        )
    units = (units + [""] * width)[:width]
    labels = [f"{name} {cell}".strip() for name, cell in zip(filled, fields, strict=True)]
    line_number, behind, _ = rows[-1]
    # A program that saved the file again may leave delimiters or spaces on the blank line.
    blank = _BLANK_LINE.search(text.data, behind - 1)
    end = len(text.data) if blank is None else blank.start() + 1
    table = TableHead(tuple(labels), delimiter, line_number, behind)
    return _Section(_title(title), rate, table, end, tuple(filled), tuple(fields), tuple(units))


def _clock(path: str, section: _Section, numbers: Numbers) -> tuple[FloatArray, list[Finding]]:
    """Return times [s]: frame numbers over the capture's rate, sub frames between them."""
    sub = numbers.columns[1]
    known = sub[np.isfinite(sub)]
    if known.size and (known.min() < 0 or known.max() > _MOST_SUBS or np.any(known != np.floor(known))):
        raise LogError(f"{path}, line {numbers.lines[0]}: sub frames must be 0, 1, 2, ...; check the columns")
    shares = float(known.max(initial=0.0)) + 1.0
    seen = np.bincount(known.astype(np.int64), minlength=1)
    if np.any(seen < 0.5 * seen.max()):  # one damaged number there would change the whole clock
        odd = int(np.flatnonzero(seen < 0.5 * seen.max())[-1])
        row = int(np.argmax(sub == odd)) if seen[odd] else int(np.argmax(sub == known.max()))
        raise LogError(
            f"{path}, line {numbers.lines[row]}: sub frame {sub[row]:g} is not one that every frame has; "
            "repair or remove the row"
        )
    numbers.columns[0] = (numbers.columns[0] * shares + np.where(np.isfinite(sub), sub, 0.0)) / section.rate
    return order_rows(path, numbers, 0, 1.0)


def _rotation(
    path: str, section: _Section, name: str, fields: Mapping[str, int], numbers: Numbers, angles: str | None
) -> FloatArray:
    """Return quaternions, w first, of unchecked length."""

    def stacked(wanted: Sequence[str]) -> FloatArray:
        return numbers.stacked(fields[field] for field in wanted)

    if "RW" in fields:
        return stacked(("RW", "RX", "RY", "RZ"))
    if angles is None and section.title != "objects":
        raise LogError(
            f'{path}: the angles of "{name}" depend on the pipeline that made them; '
            f'declare angles = "helical" or an Euler order such as "XYZ"'
        )
    chosen = angles or "helical"
    stated_units = {section.units[fields[f"R{axis}"]] for axis in "XYZ"}
    if len(stated_units) > 1:
        raise UnitError(
            f'{path}, line {section.table.line}: the angles of "{name}" are in '
            f"{' and '.join(sorted(unit or 'no unit' for unit in stated_units))}; correct the row of units"
        )
    with naming(f'{path}: angles of "{name}"'):
        factor = factor_to_si(stated_units.pop() or "rad", "rad")
    if chosen == "helical":
        return rotation_quaternions("rotvec", stacked(("RX", "RY", "RZ")) * factor)
    angles_deg = np.degrees(stacked([f"R{axis}" for axis in chosen]) * factor)
    return rotation_quaternions("euler", angles_deg, order=chosen)


def _body_name(name: str) -> str:
    """Return the name of an object: ``Global Angle (Quaternion) drone:drone`` is drone."""
    name = name.removeprefix("Global Angle").strip().removeprefix("(Quaternion)").strip()
    first, _, second = name.partition(":")
    return first if first == second else name


def _read_section(
    text: Text, section: _Section, kept: Sequence[str] | None, options: CaptureOptions, raw: RawCapture
) -> None:
    """Add a section to a capture."""
    path = text.path
    groups = section.groups()
    columns = sorted({0, 1, *(column for group in groups.values() for column in group)})
    # If the last objects of a row are lost, the row ends behind an earlier object, with a delimiter.
    ends = [max(group) + 1 for group in groups.values()] if section.title == "objects" else []
    numbers = read_numbers(text.up_to(section.end), section.table, columns, least=columns[-1] + 1, ends=ends)
    time, ordered = _clock(path, section, numbers)
    raw.notes += [*numbers.notes, *ordered]
    taken = {*(body.name for body in raw.bodies), *raw.markers, *raw.others}

    def free(name: str) -> str:
        if name in taken:
            raise LogError(
                f'{path}, line {section.table.line}: "{name}" stands in two sections; export one of them'
            )
        return name

    for name, group in groups.items():
        fields = {section.fields[column].upper(): column for column in group}
        # If a component is missing or stands twice, its name may belong to a neighbouring column.
        wanted = {"trajectories": _PLACE, "objects": _BODY, "segments": _BODY}.get(section.title, ())
        if section.title == "objects" and "(Quaternion)" in name:
            wanted = (*_BODY, "RW")
        there = [section.fields[column].upper() for column in group]
        missing = [field for field in wanted if field not in there]
        twice = sorted({field for field in there if field in wanted and there.count(field) > 1})
        if twice or (missing and len(missing) < len(wanted)):
            fault = f"has {', '.join(twice)} twice" if twice else f"lacks {', '.join(missing)}"
            raise LogError(
                f'{path}, line {section.table.line - 1}: "{name}" {fault}; export the file again with whole '
                "markers and bodies"
            )
        if section.title == "trajectories" and set(_PLACE) <= set(fields):
            place = [fields[axis] for axis in "XYZ"]
            position = numbers.stacked(place)
            if np.isfinite(position).all(axis=1).any():
                position *= section.length(path, place, options.length_unit)
            raw.markers[free(name)] = time, position
        elif section.title in ("segments", "objects") and set(_BODY) <= set(fields):
            body = _body_name(name)
            if kept is not None and body not in kept:
                continue
            place = [fields[f"T{axis}"] for axis in "XYZ"]
            position = numbers.stacked(place)
            turn = _rotation(path, section, body, fields, numbers, options.angles)
            # Tracker writes a lost object as zeros; none stands exactly at the origin without any turn.
            zeros = ~numbers.stacked(group).any(axis=1)
            if section.title == "objects" and zeros.any():
                position[zeros], turn[zeros] = np.nan, np.nan
                sentence = f"frames of {body} that are all zeros, taken as lost: {int(zeros.sum())}"
                raw.notes.append(note("zero-poses", sentence))
            position = position * section.length(path, place, options.length_unit)
            raw.bodies.append(Body(free(body), time, position, turn, numbers))
        else:
            labels = unique_names([f"{name}/{section.fields[column]}" for column in group])
            for label, column in zip(labels, group, strict=True):
                raw.add_signal(free(label), section.units[column], time, numbers.columns[column])


def _parse(source: Source, options: CaptureOptions) -> RawCapture:
    path = source.path
    text = read_text(source)
    sections: list[_Section] = []
    while (section := _section(text, sections[-1].end if sections else 0)) is not None:
        sections.append(section)
    if not sections:
        raise LogError(f"{path}: only blank lines; export the file again")
    moving = [section for section in sections if section.title in ("segments", "objects")]
    bodies = [_body_name(name) for section in moving for name in section.groups()]
    chosen = bodies and options.rigid_body is not None
    kept = wanted_bodies(path, bodies, options.rigid_body) if chosen else None
    raw = RawCapture("Vicon " + ", ".join(section.title.title() for section in sections), [])
    for section in sections:
        _read_section(text, section, kept, options, raw)
    raw.chosen, raw.marks_lost = kept is not None, True
    raw.states_length = any(section.states_length for section in sections)
    raw.kind = "motion-capture" if raw.bodies or raw.markers else "signals"
    return raw


FORMAT = capture_format(
    "vicon-csv", "Vicon Nexus / Tracker CSV (markers, segments, objects, devices)", _recognize, _parse,
    {"rigid_body": (), "bodies": (), "length_unit": (), "angles": ("helical", *EULER_ORDERS)},
)  # fmt: skip
