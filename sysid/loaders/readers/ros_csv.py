"""Poses that ``rostopic echo -p`` wrote as CSV: PoseStamped, TransformStamped and Odometry.

    %time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.position.x,...

Stamps are integer nanoseconds (seconds where they have fractions, with a note); the header's stamp is that
of the sender and is used where it runs, ``%time`` is that of arrival. Lengths are metres and quaternions
x, y, z, w by the definition of the messages.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.clock import EXPORT_FINER, frame_clock, jitter_note, order_rows
from sysid.loaders.columns import Column, listing, parse_header, unread_note
from sysid.loaders.motion_capture import body_channels, declared_length, unit_quaternions
from sysid.loaders.registry import CERTAIN, NO, LogFormat
from sysid.loaders.source import Source
from sysid.loaders.table import Numbers, find_header, read_numbers, table_head
from sysid.loaders.text import read_text
from sysid.recording import Recording

_NAME = "ros-csv"
_ARRIVAL, _STAMP = "%time", "field header stamp"
_SEQUENCE = "field header seq"
# No topic of poses is faster than a megahertz [ns].
_FEWEST_NANOSECONDS = 1000.0
_CLOCKS = ("header", "arrival", "frame")
_POSITION = ("position", "translation")
_TURN = ("orientation", "rotation")


def _recognize(source: Source) -> int:
    found = find_header(source.head_lines)
    names = [name.strip() for name in found[2]] if found else []
    return CERTAIN if names[:1] == [_ARRIVAL] and any(name.startswith("field.") for name in names) else NO


def _axes(path: str, columns: Sequence[Column], words: Sequence[str], axes: str) -> list[Column]:
    found: dict[str, Column] = {}
    for column in columns:
        parts = column.stem.split()
        if len(parts) > 2 and parts[-2] in words and parts[-1] in axes and "covariance" not in parts:
            if parts[-1] in found:
                raise LogError(
                    f'{path}: columns "{found[parts[-1]].label}" and "{column.label}" are both {words[0]} '
                    f"{parts[-1]}; record one pose per file"
                )
            found[parts[-1]] = column
    if len(found) < len(axes):
        raise LogError(
            f"{path}: no columns {words[0]} {', '.join(axes)}; found "
            f"{listing(one.label for one in columns)}; echo a PoseStamped, TransformStamped or Odometry topic"
        )
    return [found[axis] for axis in axes]


def _stamp_unit(path: str, numbers: Numbers, column: Column) -> tuple[float, list[Finding]]:
    """Return the factor from stamps to seconds, and a note where they are not the nanoseconds of the format.

    A program that saved the file again may have written seconds; then most of them have a fraction, which a
    count of nanoseconds has not.
    """
    stamps = numbers.columns[column.index]
    known = stamps[np.isfinite(stamps)]
    if known.size and np.count_nonzero(known % 1.0) * 2 > known.size:
        return 1.0, [
            note("time-unit-assumed", f"{column.label} has fractions: read as seconds, not as nanoseconds")
        ]
    steps = np.abs(np.diff(known))
    step = float(np.median(steps)) if steps.size else 0.0
    if 0.0 < step < _FEWEST_NANOSECONDS:
        raise LogError(
            f"{path}, line {numbers.lines[0]}: {column.label} steps by {step:g}, too little for "
            "nanoseconds; echo the topic again, or write nanoseconds, or seconds with their fractions"
        )
    return 1e-9, []


def read(
    source: Source,
    *,
    rigid_body: str = "body",
    length_unit: str | None = None,
    clock: str = "header",
    time_back: str = "refuse",
) -> Recording:
    """Read a pose topic as CSV.

    Parameters
    ----------
    source : Source
        The log.
    rigid_body : str
        The name that the body is given.
    length_unit : str, optional
        Where the sender wrote another unit than the metres that the messages define.
    clock : str
        ``"header"``: the stamp of the message; ``"arrival"``: when it was received; ``"frame"``: rebuilt from
        the sequence numbers of the headers, where their stamps are times of arrival too.
    time_back : str
        ``"refuse"`` a log whose time goes back, or ``"drop"`` the rows that do not pass the latest time.

    Returns
    -------
    Recording
        Kind ``motion-capture``: ``NAME/position`` [m] and ``NAME/orientation``, w first; time in Unix
        seconds, which a float resolves to 0.24 µs.

    Raises
    ------
    LogError
        One sentence with file, line and cause.
    """
    path = source.path
    if clock not in _CLOCKS:
        raise LogError(f'{path}: clock = {clock!r} is unknown; expected "header", "arrival" or "frame"')
    if not isinstance(rigid_body, str) or not rigid_body:
        raise LogError(f"{path}: rigid_body = {rigid_body!r} is no name; a pose topic holds one body")
    scale = declared_length(path, length_unit)
    text = read_text(source)
    head = table_head(text, renames=False)
    columns = parse_header(head.names)
    place = _axes(path, columns, _POSITION, "xyz")
    turn = _axes(path, columns, _TURN, "wxyz")
    clocks = {column.stem: column for column in columns if column.stem in (_ARRIVAL, _STAMP)}
    wanted = _ARRIVAL if clock == "arrival" or (clock == "frame" and _STAMP not in clocks) else _STAMP
    if wanted not in clocks:
        raise LogError(
            f"{path}: no column {wanted.replace(' ', '.')}; "
            f'choose clock = "{"arrival" if clock == "header" else "header"}"'
        )
    sequence = next((column for column in columns if column.stem == _SEQUENCE), None)
    if clock == "frame" and sequence is None:
        raise LogError(f'{path}: no column field.header.seq; choose clock = "header" or "arrival"')
    counted = [sequence.index] if sequence is not None and clock == "frame" else []
    read = [clocks[wanted], *([sequence] if sequence is not None and counted else []), *place, *turn]
    numbers = read_numbers(text, head, [one.index for one in read])
    del text  # the file's bytes are not needed any more
    notes = numbers.notes
    stamps = numbers.columns[clocks[wanted].index]
    if clock == "header" and not np.nan_to_num(stamps).any():
        raise LogError(f'{path}: every header stamp is 0; choose clock = "arrival"')
    unit, said = _stamp_unit(path, numbers, clocks[wanted])
    notes += said
    if counted:
        other = "header" if wanted == _STAMP else "arrival"
        time, said = frame_clock(
            path, numbers, counted[0], clocks[wanted].index, unit, time_back=time_back, other_clock=other
        )
    else:
        arrival = wanted == _STAMP and _ARRIVAL in clocks
        coarse = 'choose clock = "arrival"' if arrival else EXPORT_FINER
        time, said = order_rows(path, numbers, clocks[wanted].index, unit, time_back=time_back, coarse=coarse)
    notes += [*said, *jitter_note(time), *unread_note(columns, read)]
    raw = np.column_stack([numbers.columns[one.index] for one in turn])
    orientation, said = unit_quaternions(path, rigid_body, numbers, raw)
    notes += said
    position = np.column_stack([numbers.columns[one.index] for one in place]) * scale
    options = {
        "rigid_body": None if rigid_body == "body" else rigid_body,
        "length_unit": length_unit,
        "clock": clock,
    }
    return Recording(
        "motion-capture",
        body_channels(rigid_body, time, position, orientation),
        source.provenance(_NAME, device="ROS", options=options, notes=notes),
    )


FORMAT = LogFormat(_NAME, "ROS pose topic as CSV (rostopic echo -p)", _recognize, read)
