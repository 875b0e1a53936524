"""Plain pose table of one body: ``t,x,y,z,q...``, in any column order, with what the names leave open
declared.

    t,x,y,z,qx,qy,qz,qw                                  lengths declared: length_unit = "m"
    t_s,qw,qx,qy,qz,px_m,py_m,pz_m,vx_m_s,...            nothing to declare
    t [ms];x (mm);y (mm);z (mm);q0;q1;q2;q3              quaternion_order = "wxyz" or "xyzw" declared

Times are those of the file, seconds where no unit is stated and the steps are those of a capture; where a
network stamped them on arrival their jitter is kept and noted, or, with frame numbers, taken out on demand.
Velocities, where the table has them, are kept as channels; the frame of an angular velocity is not in the
file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from sysid.errors import LogError, UnitError
from sysid.journal import note
from sysid.loaders.clock import EXPORT_FINER, frame_clock, jitter_note, order_rows
from sysid.loaders.columns import (
    Column,
    DeclaredUnits,
    find_column,
    listing,
    missing_column,
    parse_header,
    unread_note,
)  # fmt: skip
from sysid.loaders.motion_capture import body_channels, unit_quaternions
from sysid.loaders.registry import CERTAIN, NO, POSSIBLE, LogFormat
from sysid.loaders.source import Source
from sysid.loaders.table import find_header, read_numbers, table_head
from sysid.loaders.text import read_text
from sysid.recording import Channel, Recording
from sysid.units import factor_to_si

_NAME = "pose-table"
_FRAME = frozenset({"frame", "frame number", "frame no", "frame id", "seq"})
_TIME = frozenset({"t", "time", "timestamp", "time stamp", "stamp"})
_POSITION = re.compile(
    r"^(?:(?:.* )?(?:p|pos|position|translation)(?: \w+)*? ([xyz])|[pt]?([xyz])|([xyz]) pos(?:ition)?)$"
)
_QUATERNION = re.compile(
    r"^(?:(?:.* )?(?:q|quat|quaternion|orientation|rotation)(?: \w+)*? ([wxyz])|q([wxyz]))$"
)
_NUMBERED = re.compile(r"^(?:q|quat|quaternion) ?([0-4])$")
_VELOCITY = re.compile(r"^v ?([xyz])$")
_TURNING = re.compile(r"^(?:w|omega) ?([xyz])$")
# No capture system is slower than this, so a unitless time with longer steps is not in seconds.
_LONGEST_STEP = 0.5


def _matched(path: str, columns: Sequence[Column], pattern: re.Pattern[str]) -> dict[str, Column]:
    """Return axis -> column of the columns whose stem fits a pattern."""
    found: dict[str, Column] = {}
    for column in columns:
        match = pattern.match(column.stem)
        if match:
            axis = next(group for group in match.groups() if group)
            if axis in found:
                raise LogError(
                    f'{path}: columns "{found[axis].label}" and "{column.label}" both name component {axis}; '
                    "this format holds one body, so remove or rename one"
                )
            found[axis] = column
    return found


def _recognize(source: Source) -> int:
    header = find_header(source.head_lines)
    if header is None:
        return NO
    columns = parse_header(header[2])
    try:
        position = _matched(source.path, columns, _POSITION)
        named = len(_matched(source.path, columns, _QUATERNION)) + len(
            _matched(source.path, columns, _NUMBERED)
        )
        clock = find_column(source.path, columns, _TIME)
    except LogError:
        return POSSIBLE if any(column.stem in _TIME for column in columns) else NO
    if clock is None or named < 3:
        return NO
    return CERTAIN if len(position) == 3 and named == 4 else POSSIBLE


def _quaternion_columns(path: str, columns: Sequence[Column], order: str | None) -> list[Column]:
    """Return the four quaternion columns, w first."""
    if order is not None and order not in ("wxyz", "xyzw"):
        raise LogError(f'{path}: quaternion_order = {order!r} is unknown; expected "wxyz" or "xyzw"')
    named = _matched(path, columns, _QUATERNION)
    if set(named) == set("wxyz"):
        placed = sorted(named, key=lambda axis: named[axis].index)
        if order is not None and "".join(placed) != order:
            raise LogError(
                f'{path}: quaternion_order = "{order}" contradicts the columns, which are named in the order '
                f"{''.join(placed)}; leave it out or correct it"
            )
        return [named[axis] for axis in "wxyz"]
    numbered = _matched(path, columns, _NUMBERED)
    if len(numbered) == 4:
        if order is None:
            labels = ", ".join(column.label for column in numbered.values())
            raise LogError(
                f"{path}: quaternion columns {labels} do not say which of them is w; "
                'declare quaternion_order = "wxyz" or "xyzw"'
            )
        placed_columns = [numbered[number] for number in sorted(numbered)]
        return [placed_columns[order.index(axis)] for axis in "wxyz"]
    missing = [f'"q{axis}"' for axis in "wxyz" if axis not in named]
    raise missing_column(path, ", ".join(missing), columns)


def read(
    source: Source,
    *,
    quaternion_order: str | None = None,
    length_unit: str | None = None,
    units: Mapping[str, str] | None = None,
    columns: Sequence[str] | Mapping[str, object] | None = None,
    rigid_body: str = "body",
    clock: str = "time",
    time_back: str = "refuse",
) -> Recording:
    """Read a pose table.

    Parameters
    ----------
    source : Source
        The log.
    quaternion_order : str, optional
        ``"wxyz"`` or ``"xyzw"``, needed where the columns are only numbered.
    length_unit : str, optional
        Unit of the positions where the header states none.
    units : mapping of str to str, optional
        Units of other columns, for example ``{"t": "ms"}``.
    columns : sequence of str or mapping, optional
        Names of all columns in order, for a log without header; or, for one with other names, new name ->
        name in the header, for example ``{"speed": "tach"}``.
    rigid_body : str
        The name that the one body of the table is given.
    clock : str
        ``"time"`` (or ``"auto"``): the times as written; ``"frame"``: rebuilt from a column of frame numbers,
        where the written ones are times of arrival (`clock.frame_clock`).
    time_back : str
        ``"refuse"`` a log whose time goes back, or ``"drop"`` the rows that do not pass the latest time.

    Returns
    -------
    Recording
        Kind ``motion-capture``: ``NAME/position`` (n, 3) [m], ``NAME/orientation`` (n, 4) unit quaternion, w
        first, body axes to capture axes, and ``NAME/velocity`` [m/s], ``NAME/angular_velocity`` [rad/s] where
        given.

    Raises
    ------
    LogError, UnitError
        One sentence with file, line and cause.
    """
    path = source.path
    if not isinstance(rigid_body, str) or not rigid_body:
        raise LogError(f"{path}: rigid_body = {rigid_body!r} is no name; a pose table holds one body")
    text = read_text(source)
    head = table_head(text, columns)
    header = parse_header(head.names)
    declared = DeclaredUnits(path, units)
    stamp = find_column(path, header, _TIME)
    if stamp is None:
        raise missing_column(path, '"t"', header)
    frame = find_column(path, header, _FRAME)
    if clock not in ("auto", "time", "frame"):
        raise LogError(f'{path}: clock = {clock!r} is unknown; expected "time" or "frame"')
    if clock == "frame" and frame is None:
        raise missing_column(path, '"frame"', header)
    position = _matched(path, header, _POSITION)
    if len(position) < 3:
        raise missing_column(path, ", ".join(f'"{axis}"' for axis in "xyz" if axis not in position), header)
    quaternion = _quaternion_columns(path, header, quaternion_order)
    triples = {"velocity": ("m/s", _VELOCITY), "angular_velocity": ("rad/s", _TURNING)}
    extra = {name: _matched(path, header, pattern) for name, (_, pattern) in triples.items()}
    # Without a stated unit a velocity is left out: it is not what this format is for.
    extra = {
        name: found
        for name, found in extra.items()
        if len(found) == 3
        and all(declared.unit_of(column, column.label) is not None for column in found.values())
    }

    if length_unit is not None:
        length_unit = str(length_unit)
        try:
            factor_to_si(length_unit, "m")
        except UnitError as error:
            raise UnitError(f"{path}: length_unit: {error}") from error
    scale, lengths_stated = [], True
    for axis in "xyz":
        stated = declared.unit_of(position[axis], axis)
        lengths_stated = lengths_stated and stated is not None
        if stated is None and length_unit is None:
            raise UnitError(
                f"{path}: position columns {listing(position[a].label for a in 'xyz')} state no unit; "
                'declare it, for example length_unit = "m"'
            )
        factor = declared.factor(position[axis], axis, "m", length_unit)
        if length_unit is not None and factor != factor_to_si(length_unit, "m"):
            raise UnitError(
                f'{path}: length_unit = "{length_unit}" contradicts column "{position[axis].label}"'
            )
        scale.append(factor)
    seconds = declared.factor(stamp, "t", "s", "s")
    stated_time = declared.unit_of(stamp, "t")
    rates = {
        name: [declared.factor(found[axis], found[axis].label, triples[name][0]) for axis in "xyz"]
        for name, found in extra.items()
    }
    declared.check_used(header)

    wanted = [
        stamp,
        *([frame] if frame is not None and clock == "frame" else []),
        *position.values(),
        *quaternion,
        *(c for found in extra.values() for c in found.values()),
    ]
    numbers = read_numbers(text, head, [column.index for column in wanted])
    del text  # the file's bytes are not needed any more
    notes = numbers.notes
    if frame is not None and clock == "frame":
        time, said = frame_clock(path, numbers, frame.index, stamp.index, seconds, time_back=time_back)
    else:
        coarse = EXPORT_FINER if frame is None else 'choose clock = "frame"'
        time, said = order_rows(path, numbers, stamp.index, seconds, time_back=time_back, coarse=coarse)
    notes += [*said, *unread_note(header, wanted)]
    if stated_time is None:
        step = float(np.median(np.diff(time))) if time.size > 1 else 0.0
        if step > _LONGEST_STEP:
            raise UnitError(
                f'{path}: column "{stamp.label}" states no unit and its steps of {step:g} cannot be seconds; '
                f'declare it, for example units = {{{stamp.label} = "ms"}}'
            )
        notes.append(note("time-unit-assumed", f'column "{stamp.label}" states no unit: read as seconds'))
    jitter = jitter_note(time)
    if jitter and frame is not None:
        jitter.append(
            note("frame-clock-available", 'the column of frame numbers gives a steady clock: clock = "frame"')
        )
    notes += jitter

    raw = np.column_stack([numbers.columns[column.index] for column in quaternion])
    orientation, said = unit_quaternions(path, rigid_body, numbers, raw)
    notes += said
    place = np.column_stack([numbers.columns[position[axis].index] for axis in "xyz"]) * scale
    channels = body_channels(rigid_body, time, place, orientation)
    for name, found in extra.items():
        values = np.column_stack([numbers.columns[found[axis].index] for axis in "xyz"]) * rates[name]
        channels[f"{rigid_body}/{name}"] = Channel(f"{rigid_body}/{name}", triples[name][0], time, values)
    if "angular_velocity" in extra:
        notes.append(
            note(
                "angular-velocity-frame-unknown",
                "angular velocity as written: the file does not say in which frame",
            )
        )
    options = {
        "quaternion_order": quaternion_order,
        "length_unit": None if lengths_stated else length_unit,
        "units": units,
        "columns": columns,
        "rigid_body": None if rigid_body == "body" else rigid_body,
        "clock": clock if clock == "frame" else None,
    }
    return Recording(
        "motion-capture", channels, source.provenance(_NAME, options=options, notes=[*notes, *declared.notes])
    )


FORMAT = LogFormat(_NAME, "plain pose table t,x,y,z,q... of one body", _recognize, read)
