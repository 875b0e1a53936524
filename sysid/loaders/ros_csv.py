"""Poses that ``rostopic echo -p`` wrote as CSV: PoseStamped, TransformStamped and Odometry.

    %time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.position.x,...

Stamps are integer nanoseconds; the header's stamp is that of the sender and is used where it runs, ``%time``
is that of arrival. Lengths are metres and quaternions x, y, z, w by the definition of the messages.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.errors import LogError
from sysid.loaders.clock import frame_clock, jitter_note, order_rows
from sysid.loaders.columns import Column, listing, parse_header
from sysid.loaders.motion_capture import body_channels, unit_quaternions
from sysid.loaders.registry import CERTAIN, NO, LogFormat
from sysid.loaders.source import Source
from sysid.loaders.table import find_header, read_numbers, table_head
from sysid.loaders.text import read_text
from sysid.recording import Recording

_NAME = "ros-csv"
_ARRIVAL, _STAMP = "%time", "field header stamp"
_SEQUENCE = "field header seq"
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


def read(
    source: Source, *, rigid_body: str = "body", clock: str = "header", time_back: str = "refuse"
) -> Recording:
    """Read a pose topic as CSV.

    Parameters
    ----------
    source : Source
        The log.
    rigid_body : str
        The name that the body is given.
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
    text = read_text(source)
    head = table_head(text)
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
    numbers = read_numbers(
        text, head, [clocks[wanted].index, *counted, *(one.index for one in (*place, *turn))]
    )
    del text  # the file's bytes are not needed any more
    notes = numbers.notes
    stamps = numbers.columns[clocks[wanted].index]
    if clock == "header" and not np.nan_to_num(stamps).any():
        raise LogError(f'{path}: every header stamp is 0; choose clock = "arrival"')
    if counted:
        time, said = frame_clock(path, numbers, counted[0], clocks[wanted].index, 1e-9, time_back=time_back)
    else:
        time, said = order_rows(path, numbers, clocks[wanted].index, 1e-9, time_back=time_back)
    notes += [*said, *jitter_note(time)]
    raw = np.column_stack([numbers.columns[one.index] for one in turn])
    orientation, said = unit_quaternions(path, rigid_body, numbers, raw)
    notes += said
    position = np.column_stack([numbers.columns[one.index] for one in place])
    options = {"rigid_body": None if rigid_body == "body" else rigid_body, "clock": clock}
    return Recording(
        "motion-capture",
        body_channels(rigid_body, time, position, orientation),
        source.provenance(_NAME, device="ROS", options=options, notes=notes),
    )


FORMAT = LogFormat(_NAME, "ROS pose topic as CSV (rostopic echo -p)", _recognize, read)
