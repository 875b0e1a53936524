"""Poses that ``rostopic echo -p`` wrote as CSV: PoseStamped, TransformStamped and Odometry.

    %time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.position.x,...

Stamps are integer nanoseconds (seconds where they have fractions, with a note); the sender writes the
header's stamp, which is used where it runs; ``%time`` is the time of arrival. Lengths are metres and
quaternions x, y, z, w by the definition of the messages.
"""

import re

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.capture_log import Body, RawCapture, body_name, capture_format, declared_length
from sysid.loaders.clock import EXPORT_FINER, jitter_note, stamp_clock
from sysid.loaders.columns import Column, NamedTable, axis_columns, listing, unread_note
from sysid.loaders.options import CaptureOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.source import Source
from sysid.loaders.table import Numbers, find_header

_ARRIVAL, _STAMP = "%time", "field header stamp"
_SEQUENCE = "field header seq"
# Shortest step of a topic of poses [ns]; smaller numbers are of another unit.
_FEWEST_NANOSECONDS = 1000.0
# Axes of a pose's position and orientation, and the patterns of their columns' names. Columns of the pose's
# covariance end in numbers instead of axes, so that no pattern matches them.
_POSE = {
    "position": ("xyz", re.compile(r"^.* (?:position|translation) ([xyz])$")),
    "orientation": ("wxyz", re.compile(r"^.* (?:orientation|rotation) ([wxyz])$")),
}


def _recognize(source: Source) -> int:
    header = find_header(source.head_lines)
    names = [name.strip() for name in header[2]] if header else []
    return CERTAIN if names[:1] == [_ARRIVAL] and any(name.startswith("field.") for name in names) else NO


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


def _parse(source: Source, options: CaptureOptions) -> RawCapture:
    path, clock = source.path, options.clock or "header"
    body = body_name(path, options.rigid_body)
    scale = declared_length(path, options.length_unit)
    table = NamedTable(source, options, renames=False)
    columns = table.columns
    parts = []
    for part, (axes, pattern) in _POSE.items():
        matched = axis_columns(path, columns, pattern)
        if len(matched) < len(axes):
            raise LogError(
                f"{path}: no columns {part} {', '.join(axes)}; found "
                f"{listing(column.label for column in columns)}; "
                "echo a PoseStamped, TransformStamped or Odometry topic"
            )
        parts.append([matched[axis] for axis in axes])
    place, turn = parts
    clocks = {column.stem: column for column in columns if column.stem in (_ARRIVAL, _STAMP)}
    wanted = _ARRIVAL if clock == "arrival" or (clock == "frame" and _STAMP not in clocks) else _STAMP
    if wanted not in clocks:
        raise LogError(
            f"{path}: no column {wanted.replace(' ', '.')}; "
            f'choose clock = "{"arrival" if clock == "header" else "header"}"'
        )
    stamp = clocks[wanted]
    sequence = next((column for column in columns if column.stem == _SEQUENCE), None)
    if clock == "frame" and sequence is None:
        raise LogError(f'{path}: no column field.header.seq; choose clock = "header" or "arrival"')
    counted = sequence if clock == "frame" else None
    read = [stamp, *([counted] if counted else []), *place, *turn]
    numbers = table.read(read)
    if clock == "header" and not np.nan_to_num(numbers.columns[stamp.index]).any():
        raise LogError(f'{path}: every header stamp is 0; choose clock = "arrival"')
    unit, assumed = _stamp_unit(path, numbers, stamp)
    time, ordered = stamp_clock(
        path, numbers, stamp.index, unit, options, counted.index if counted else None,
        coarse='choose clock = "arrival"' if wanted == _STAMP and _ARRIVAL in clocks else EXPORT_FINER,
        other_clock="header" if wanted == _STAMP else "arrival",
    )  # fmt: skip
    notes = [*numbers.notes, *assumed, *ordered, *jitter_note(time), *unread_note(columns, read)]
    position = numbers.stacked(column.index for column in place) * scale
    pose = Body(body, time, position, numbers.stacked(column.index for column in turn), numbers)
    return RawCapture("ROS", notes, [pose])


FORMAT = capture_format(
    "ros-csv", "ROS pose topic as CSV (rostopic echo -p)", _recognize, _parse,
    {
        "rigid_body": (), "length_unit": (), "clock": ("header", "arrival", "frame"), "time_back": (),
        "segment": (),
    },
)  # fmt: skip
