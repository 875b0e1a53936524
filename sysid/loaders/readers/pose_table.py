"""Plain pose table of one body: ``t,x,y,z,q...``, in any column order, with what the names leave open
declared.

    t,x,y,z,qx,qy,qz,qw                                  lengths declared: length_unit = "m"
    t_s,qw,qx,qy,qz,px_m,py_m,pz_m,vx_m_s,...            nothing to declare
    t [ms];x (mm);y (mm);z (mm);q0;q1;q2;q3              quaternion_order = "wxyz" or "xyzw" declared

Times are kept as written; without a unit they are seconds, if their steps are as short as a
capture's. A network that stamps them on arrival adds jitter: it is kept and noted, or, with frame numbers,
taken out on demand.
Velocities, where the table has them, are kept as channels; the frame of an angular velocity is not in the
file.
"""

import re
from collections.abc import Mapping

import numpy as np

from sysid.errors import LogError, UnitError
from sysid.journal import note
from sysid.loaders.capture_log import Body, RawCapture, body_name, capture_format, declared_length
from sysid.loaders.clock import EXPORT_FINER, jitter_note, stamp_clock
from sysid.loaders.columns import (
    Column,
    DeclaredUnits,
    NamedTable,
    axis_columns,
    declare_unit,
    header_columns,
    listing,
    unread_note,
)
from sysid.loaders.options import CaptureOptions
from sysid.loaders.registry import CERTAIN, NO, POSSIBLE
from sysid.loaders.source import Source
from sysid.units import factor_to_si

_FRAME = frozenset({"frame", "frame number", "frame no", "frame id", "seq"})
_TIME = frozenset({"t", "time", "timestamp", "time stamp", "stamp"})
_POSITION = re.compile(
    r"^(?:(?:.* )?(?:p|pos|position|translation)(?: \w+)*? ([xyz])|[pt]?([xyz])|([xyz]) pos(?:ition)?)$"
)
_QUATERNION = re.compile(
    r"^(?:(?:.* )?(?:q|quat|quaternion|orientation|rotation)(?: \w+)*? ([wxyz])|q([wxyz]))$"
)
_NUMBERED = re.compile(r"^(?:q|quat|quaternion) ?([0-4])$")
# SI unit and pattern of column names, by kind of velocity beside a pose.
_TRIPLES = {
    "velocity": ("m/s", re.compile(r"^v ?([xyz])$")),
    "angular_velocity": ("rad/s", re.compile(r"^(?:w|omega) ?([xyz])$")),
}
# Longest step of a capture system [s]: a unitless time with longer ones is not in seconds.
_LONGEST_STEP = 0.5


def _recognize(source: Source) -> int:
    columns = header_columns(source)
    clocks = sum(column.stem in _TIME for column in columns)
    try:
        position = axis_columns(source.path, columns, _POSITION)
        named = sum(len(axis_columns(source.path, columns, names)) for names in (_QUATERNION, _NUMBERED))
    except LogError:
        return POSSIBLE if clocks else NO
    if clocks != 1 or named < 3:
        return POSSIBLE if clocks > 1 else NO
    return CERTAIN if len(position) == 3 and named == 4 else POSSIBLE


def _quaternion_columns(table: NamedTable, order: str | None) -> list[Column]:
    """Return the four quaternion columns, w first."""
    path = table.path
    named = axis_columns(path, table.columns, _QUATERNION)
    if set(named) == set("wxyz"):
        placed = sorted(named, key=lambda axis: named[axis].index)
        if order is not None and "".join(placed) != order:
            raise LogError(
                f'{path}: quaternion_order = "{order}" contradicts the columns, which are named in the order '
                f"{''.join(placed)}; leave it out or correct it"
            )
        return [named[axis] for axis in "wxyz"]
    numbered = axis_columns(path, table.columns, _NUMBERED)
    if len(numbered) == 4:
        if order is None:
            labels = ", ".join(column.label for column in numbered.values())
            raise LogError(
                f"{path}: quaternion columns {labels} do not say which of them is w; "
                'declare quaternion_order = "wxyz" or "xyzw"'
            ).asking(quaternion_order=[numbered[number].label for number in sorted(numbered)])
        placed_columns = [numbered[number] for number in sorted(numbered)]
        return [placed_columns[order.index(axis)] for axis in "wxyz"]
    missing = [f'"q{axis}"' for axis in "wxyz" if axis not in named]
    raise table.missing(", ".join(missing))


def _scales(
    path: str, declared: DeclaredUnits, position: Mapping[str, Column], length_unit: str | None
) -> tuple[list[float], bool]:
    """Return the factors of x, y, z to metres, and whether the header states their unit."""
    if length_unit is not None:
        declared_length(path, length_unit)
    factors, stated = [], True
    for axis in "xyz":
        column = position[axis]
        unit = declared.unit_of(column, axis)
        stated = stated and unit is not None
        if unit is None and length_unit is None:
            raise UnitError(
                f"{path}: position columns {listing(position[a].label for a in 'xyz')} state no unit; "
                'declare it, for example length_unit = "m"'
            ).asking(length_unit=[position[axis].label for axis in "xyz"])
        factor = declared.factor(column, axis, "m", length_unit)
        if length_unit is not None and factor != factor_to_si(length_unit, "m"):
            raise UnitError(f'{path}: length_unit = "{length_unit}" contradicts column "{column.label}"')
        factors.append(factor)
    return factors, stated


def _parse(source: Source, options: CaptureOptions) -> RawCapture:
    path = source.path
    body = body_name(path, options.rigid_body)
    table = NamedTable(source, options)
    header, declared = table.columns, table.declared
    stamp = table.find(_TIME)
    if stamp is None:
        raise table.missing('"t"')
    frame = table.find(_FRAME)
    if options.clock == "frame" and frame is None:
        raise table.missing('"frame"')
    position = axis_columns(path, header, _POSITION)
    if len(position) < 3:
        raise table.missing(", ".join(f'"{axis}"' for axis in "xyz" if axis not in position))
    quaternion = _quaternion_columns(table, options.quaternion_order)
    # A velocity without a stated unit is left out and not refused: fits need the pose alone.
    extra = {
        name: columns
        for name, (_, pattern) in _TRIPLES.items()
        if len(columns := axis_columns(path, header, pattern)) == 3
        and all(declared.unit_of(column, column.label) is not None for column in columns.values())
    }
    length_unit = None if options.length_unit is None else str(options.length_unit)
    scale, states_length = _scales(path, declared, position, length_unit)
    seconds = declared.factor(stamp, "t", "s", "s")
    states_time = declared.unit_of(stamp, "t") is not None
    rates = {
        name: [declared.factor(columns[axis], columns[axis].label, _TRIPLES[name][0]) for axis in "xyz"]
        for name, columns in extra.items()
    }
    declared.check_used(header)
    counted = frame if options.clock == "frame" else None
    triples = [column for columns in extra.values() for column in columns.values()]
    wanted = [stamp, *([counted] if counted else []), *position.values(), *quaternion, *triples]
    numbers = table.read(wanted)
    time, ordered = stamp_clock(
        path, numbers, stamp.index, seconds, options, counted.index if counted else None,
        coarse=EXPORT_FINER if frame is None else 'choose clock = "frame"',
    )  # fmt: skip
    notes = [*numbers.notes, *ordered, *unread_note(header, wanted)]
    if not states_time:
        step = float(np.median(np.diff(time))) if time.size > 1 else 0.0
        if step > _LONGEST_STEP:
            raise UnitError(
                f'{path}: column "{stamp.label}" states no unit and its steps of {step:g} cannot be seconds; '
                + declare_unit(stamp.label, "ms")
            ).asking(units={stamp.label: "s"})
        notes.append(note("time-unit-assumed", f'column "{stamp.label}" states no unit: read as seconds'))
    jitter = jitter_note(time)
    notes += jitter
    if jitter and frame is not None:
        sentence = 'the column of frame numbers gives a steady clock: clock = "frame"'
        notes.append(note("frame-clock-available", sentence))
    place = numbers.stacked(position[axis].index for axis in "xyz") * scale
    pose = Body(body, time, place, numbers.stacked(column.index for column in quaternion), numbers)
    for name, columns in extra.items():
        values = numbers.stacked(columns[axis].index for axis in "xyz") * rates[name]
        pose.extra[name] = (_TRIPLES[name][0], values)
    if "angular_velocity" in extra:
        sentence = "angular velocity as written: the file does not say in which frame"
        notes.append(note("angular-velocity-frame-unknown", sentence))
    return RawCapture("", [*notes, *declared.notes], [pose], states_length=states_length)


FORMAT = capture_format(
    "pose-table", "plain pose table t,x,y,z,q... of one body", _recognize, _parse,
    {
        "quaternion_order": ("wxyz", "xyzw"), "length_unit": (), "units": (), "columns": (), "rigid_body": (),
        "clock": ("auto", "time", "frame"), "time_back": (), "segment": (),
    },
)  # fmt: skip
