"""ROS recordings (rosbags): ROS 1 bag, and the MCAP and SQLite files of ROS 2.

Every topic of poses (PoseStamped, PoseWithCovarianceStamped, TransformStamped, Odometry) is a rigid body of
the topic's name; a TFMessage gives one per child frame. Time is the stamp of the message's header, or the
time of arrival; lengths are metres and quaternions x, y, z, w by the definition of the messages.
"""

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding
from sysid.loaders.capture_log import Body, RawCapture, capture_format, declared_length, wanted_bodies
from sysid.loaders.clock import EXPORT_FINER, jitter_note, order_rows
from sysid.loaders.columns import listing, listing_note
from sysid.loaders.isolation import library
from sysid.loaders.options import CaptureOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.source import Source, shortened
from sysid.loaders.table import Numbers, promised_note

_BAG, _MCAP, _SQLITE = b"#ROSBAG V2.0", b"\x89MCAP0\r\n", b"SQLite format 3\0"
_Rows = list[tuple[float, ...]]
_POSES = ("PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry", "TFMessage")


# Names of what SQLite computes while it is read: views, triggers, virtual tables, generated columns.
_COMPUTED = (
    "SELECT entry.name FROM sqlite_master entry LEFT JOIN pragma_table_xinfo(entry.name) field "
    "WHERE entry.type NOT IN ('table', 'index') OR entry.sql LIKE 'CREATE VIRTUAL%' OR field.hidden > 0"
)


def _recognize(source: Source) -> int:
    head = source.head
    rows = b"topics" in head and b"messages" in head
    return CERTAIN if head.startswith((_BAG, _MCAP)) or (head.startswith(_SQLITE) and rows) else NO


def _open(source: Source) -> tuple[Any, bool]:
    """Return the library's reader for this kind of file, and whether messages are in the ROS 1 form."""
    path, file = source.path, Path(source.path)
    if source.head.startswith(_BAG):
        return library(path, "rosbags.rosbag1", "rosbags").Reader(file), True
    if source.head.startswith(_MCAP):
        return library(path, "rosbags.rosbag2.storage_mcap", "rosbags").McapReader(file), False
    if source.head.startswith(_SQLITE):
        address = f"{file.absolute().as_uri()}?mode=ro&immutable=1"
        with closing(sqlite3.connect(address, uri=True)) as base:
            if computed := base.execute(_COMPUTED).fetchone():
                raise LogError(
                    f"{path}: {shortened(str(computed[0]))} is computed by SQLite, where a recording has "
                    "plain tables; record it again"
                )
        return library(path, "rosbags.rosbag2.storage_sqlite3", "rosbags").Sqlite3Reader(file), False
    raise LogError(f"{path}: neither a ROS bag nor MCAP (its first bytes do not say so); check the format")


def _typestore(path: str, connections: Sequence[Any]) -> Any:
    """Return the message types that the file defines, else of ROS 2 Humble."""
    types = library(path, "rosbags.typesys", "rosbags")
    formats = library(path, "rosbags.interfaces", "rosbags").MessageDefinitionFormat
    messages: dict[str, Any] = {}
    for connection in connections:
        if connection.msgdef.format == formats.MSG:
            messages.update(types.get_types_from_msg(connection.msgdef.data, connection.msgtype))
    store = types.get_typestore(types.Stores.EMPTY if messages else types.Stores.ROS2_HUMBLE)
    if messages:
        store.register(messages)
    return store


def _poses(kind: str, message: Any) -> Iterator[tuple[str, Any, Any, Any]]:
    """Yield (child frame or "", header, position, orientation) of a message."""
    if kind == "TFMessage":
        for transform in message.transforms:
            pose = transform.transform
            yield transform.child_frame_id, transform.header, pose.translation, pose.rotation
    elif kind == "TransformStamped":
        yield "", message.header, message.transform.translation, message.transform.rotation
    else:
        pose = message.pose if kind == "PoseStamped" else message.pose.pose
        yield "", message.header, pose.position, pose.orientation


def _read_tracks(source: Source, topic: str | None, clock: str) -> tuple[dict[str, _Rows], list[Finding]]:
    """Return rows of (time [s], x, y, z, w, x, y, z) by body, and notes."""
    path = source.path
    reader, first_form = _open(source)
    tracks: dict[str, _Rows] = {}
    reader.open()
    try:
        connections = list(reader.connections)
        known = {topic_of.topic: topic_of.msgtype for topic_of in connections}
        if topic is not None and topic not in known:
            raise LogError(f'{path}: no topic "{topic}"; found {listing(sorted(known))}')
        chosen = [
            topic_of
            for topic_of in connections
            if topic_of.msgtype.rsplit("/", 1)[-1] in _POSES and topic in (None, topic_of.topic)
        ]
        if not chosen:
            topics = [f"{name} ({kind})" for name, kind in sorted(known.items())]
            raise LogError(f"{path}: no topic of poses; found {listing(topics)}; record a PoseStamped")
        store = _typestore(path, chosen)
        decode = store.deserialize_ros1 if first_form else store.deserialize_cdr
        messages = 0
        for connection, arrival, data in reader.messages(chosen):
            messages += 1
            kind = connection.msgtype.rsplit("/", 1)[-1]
            for child, header, place, turn in _poses(kind, decode(data, connection.msgtype)):
                stamp = arrival if clock == "arrival" else header.stamp.sec * 10**9 + header.stamp.nanosec
                row = (stamp * 1e-9, place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z)
                tracks.setdefault(child or connection.topic.strip("/"), []).append(row)
        left_out = sorted(set(known) - {topic_of.topic for topic_of in chosen})
        notes = listing_note("topics-left-out", "topics without poses, left out", left_out)
        stated = sum(topic_of.msgcount for topic_of in chosen)
        notes += promised_note("the file's number of messages", stated, messages)
    finally:
        reader.close()
    return tracks, notes


def _parse(source: Source, options: CaptureOptions) -> RawCapture:
    path, clock = source.path, options.clock or "header"
    scale = declared_length(path, options.length_unit)
    tracks, notes = _read_tracks(source, options.topic, clock)
    if not tracks:
        raise LogError(f"{path}: its topics of poses have no message; record it again")
    raw = RawCapture("ROS", notes)
    for name in wanted_bodies(path, list(tracks), options.rigid_body):
        table = np.array(tracks[name], dtype=np.float64)
        if clock == "header" and not table[:, 0].any():
            raise LogError(f'{path}: every header stamp of {name} is 0; choose clock = "arrival"')
        numbers = Numbers(
            dict(enumerate(table.T.copy())), np.arange(1, len(table) + 1), row_word=f"{name} message"
        )
        coarse = 'choose clock = "arrival"' if clock == "header" else EXPORT_FINER
        time, ordered = order_rows(path, numbers, 0, 1.0, options=options, coarse=coarse)
        raw.notes += [
            replace(finding, sentence=f"{name}: {finding}") for finding in (*ordered, *jitter_note(time))
        ]
        position = numbers.stacked((1, 2, 3)) * scale
        raw.bodies.append(Body(name, time, position, numbers.stacked((4, 5, 6, 7)), numbers))
    return raw


FORMAT = capture_format(
    "ros-bag", "ROS 1 bag, ROS 2 MCAP or SQLite (pose topics)", _recognize, _parse,
    {"topic": (), "rigid_body": (), "length_unit": (), "clock": ("header", "arrival"), "time_back": ()},
    foreign=True,
)  # fmt: skip
