"""PX4 ULog (pyulog): pose, battery, ESC speeds and motor commands as the drone logged them itself.

Frames are PX4's: positions north, east, down from the point of take-off; body axes front, right, down;
quaternions w first, body to world. A body ``vehicle`` needs position and attitude on one clock, which
``vehicle_odometry`` or ``vehicle_visual_odometry`` has; the estimates of ``vehicle_attitude`` and
``vehicle_local_position`` are further channels. Of a topic that several sensors publish the lowest
instance is read. What PX4 writes for unknown (current -1 A, 0 V) or marks as not valid is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.binary import length_note, library, reading
from sysid.loaders.capture_log import Body, RawCapture, capture_format, unit_quaternions
from sysid.loaders.clock import order_rows
from sysid.loaders.columns import listing
from sysid.loaders.options import CaptureOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.source import Source
from sysid.loaders.table import Numbers
from sysid.recording import Channel
from sysid.types import FloatArray

_MAGIC = b"ULog\x01\x12\x35"
# Bytes before the first message, and the kinds of messages.
_HEADER, _KINDS = 16, b"BFIMPQARDLCSO"
_ODOMETRY = {"vehicle_odometry": "vehicle", "vehicle_visual_odometry": "visual"}
# The field of vehicle_odometry that names the frame of the poses, and its numbers; PX4 1.14 renamed and
# renumbered it. x and y of FRD are turned by an unknown heading.
_FRAMES = {
    "pose_frame": {0: "unknown", 1: "NED", 2: "FRD"},
    "local_frame": {0: "NED", 1: "FRD", 2: "unknown", 3: "FRD of the body"},
}
# What PX4 writes for unknown, by topic and field.
_UNKNOWN = {("battery_status", "current_a"): -1.0, ("battery_status", "voltage_v"): 0.0}
# Fields of flags, by topic, and the fields that count only where the flag is set.
_VALID = {
    "vehicle_local_position": {
        "xy_valid": ("x", "y"), "z_valid": ("z",), "v_xy_valid": ("vx", "vy"), "v_z_valid": ("vz",),
    },
}  # fmt: skip
_QUATERNION = ("q[0]", "q[1]", "q[2]", "q[3]")
_RPM = 2.0 * np.pi / 60.0
# topic: (channel, fields, unit, factor); {} in a channel is the number of the topic's instance
_PLAIN: tuple[tuple[str, str, tuple[str, ...], str, float], ...] = (
    ("vehicle_local_position", "local_position", ("x", "y", "z"), "m", 1.0),
    ("vehicle_local_position", "local_velocity", ("vx", "vy", "vz"), "m/s", 1.0),
    ("sensor_combined", "acceleration", tuple(f"accelerometer_m_s2[{i}]" for i in range(3)), "m/s²", 1.0),
    ("sensor_combined", "angular_velocity", tuple(f"gyro_rad[{i}]" for i in range(3)), "rad/s", 1.0),
    ("battery_status", "voltage", ("voltage_v",), "V", 1.0),
    ("battery_status", "current", ("current_a",), "A", 1.0),
    *(("esc_status", f"esc_{i}/speed", (f"esc[{i}].esc_rpm",), "rad/s", _RPM) for i in range(8)),
    *(("actuator_outputs", f"output_{i}", (f"output[{i}]",), "", 1.0) for i in range(8)),
    *(("actuator_motors", f"motor_{i}", (f"control[{i}]",), "1", 1.0) for i in range(8)),
)


def _recognize(source: Source) -> int:
    return CERTAIN if source.head.startswith(_MAGIC) else NO


def _mask_unknown(topic: Any, fields: Sequence[str], numbers: Numbers) -> list[Finding]:
    """Blank what PX4 marks as unknown or not valid; return notes."""
    notes = []
    for i, name in enumerate(fields, start=1):
        unknown = numbers.columns[i] == _UNKNOWN.get((topic.name, name), np.nan)
        why = f"{_UNKNOWN.get((topic.name, name), 0.0):g}, which PX4 writes for unknown"
        for flag, flagged in _VALID.get(topic.name, {}).items():
            if name in flagged and flag in topic.data:
                unknown, why = np.asarray(topic.data[flag]) == 0, f"not valid by {flag}"
        if unknown.any():
            numbers.columns[i] = np.where(unknown, np.nan, numbers.columns[i])
            sentence = f"{topic.name}.{name} is {why}, in {int(unknown.sum())} messages; taken as missing"
            notes.append(note("marked-unknown", sentence))
    return notes


def _frame(topic: Any, body: str) -> tuple[str, list[Finding]]:
    """Return the frame of the poses of an odometry topic (empty where it changes), and notes."""
    field = next((name for name in _FRAMES if name in topic.data), "")
    if not field:
        return "NED", []  # all that PX4 knew then
    numbers = [int(number) for number in np.unique(topic.data[field]).tolist()]
    frames = [_FRAMES[field].get(number, f"number {number}") for number in numbers]
    if len(frames) > 1:
        sentence = f"{body} was left out: its {field} changes between {' and '.join(frames)}"
        return "", [note("frame-changes", sentence)]
    if frames == ["NED"]:
        return "NED", []
    turned = "z is down, but x and y are turned from north and east by an unknown heading"
    what = turned if frames == ["FRD"] else "its axes are not known; check them before use"
    return frames[0], [note("other-frame", f"{field} of {body} is {frames[0]}, not NED: {what}")]


def _axes_note(channels: Sequence[str], others: Sequence[str]) -> Finding:
    """Return a note on the axes of the channels, but not of the bodies `others` in other frames."""
    placed = [
        name for name in channels if name.endswith("position") or name in ("local_velocity", "attitude")
    ]
    known = [name for name in placed if name.rpartition("/")[0] not in others]
    whose = f" of {' and '.join(known)}" if others else ""
    north = f"axes{whose}: north, east, down; " if known else "axes: "
    return note("axes", f"{north}body front, right, down, as PX4 defines them")


def _messages_end(data: bytes) -> int:
    """Return where the chain of messages ends, each of which states its length and its kind."""
    at = _HEADER
    while at + 3 <= len(data) and data[at + 2] in _KINDS:
        at += 3 + data[at] + (data[at + 1] << 8)
    return at


class _Topics:
    """Topics of a log by name, the lowest instance of each; their content becomes a capture."""

    def __init__(self, path: str, log: Any, time_back: str) -> None:
        self.path, self.time_back = path, time_back
        by_instance = sorted(log.data_list, key=lambda topic: -topic.multi_id)
        self.topics = {topic.name: topic for topic in by_instance}
        self.raw = RawCapture("", [], kind="onboard")

    def rows(self, name: str, fields: Sequence[str]) -> tuple[Any, Numbers] | None:
        """Return a topic and its fields, unordered, on its clock [s]; None where it has them not."""
        topic = self.topics.get(name)
        if topic is None or not set(fields) <= set(topic.data) or not len(topic.data["timestamp"]):
            return None
        columns: dict[int, FloatArray] = {0: np.asarray(topic.data["timestamp"], dtype=np.float64) * 1e-6}
        for i, field in enumerate(fields, start=1):
            values = np.asarray(topic.data[field], dtype=np.float64)
            columns[i] = np.where(np.isinf(values), np.nan, values)
        return topic, Numbers(columns, np.arange(1, columns[0].size + 1), row_word=f"{name} message")

    def clock(self, numbers: Numbers) -> FloatArray:
        """Put rows in order and return their times [s]."""
        time, ordered = order_rows(self.path, numbers, 0, 1.0, time_back=self.time_back)
        self.raw.notes += ordered
        return time

    def add_odometry(self, name: str, body: str) -> bool:
        """Add a body from a topic of odometry; return whether it is in another frame than NED."""
        topic = self.topics.get(name)
        place = ("position[0]", "position[1]", "position[2]")
        if topic is not None and place[0] not in topic.data:
            place = ("x", "y", "z")  # before PX4 1.14
        read = self.rows(name, (*place, *_QUATERNION))
        if read is None:
            return False
        frame, notes = _frame(read[0], body)
        self.raw.notes += notes
        if frame:
            time = self.clock(read[1])
            position, turn = read[1].stacked((1, 2, 3)), read[1].stacked((4, 5, 6, 7))
            self.raw.bodies.append(Body(body, time, position, turn, read[1]))
        return frame not in ("NED", "")

    def add_attitude(self) -> None:
        """Add the estimate of attitude."""
        read = self.rows("vehicle_attitude", _QUATERNION)
        if read is not None:
            time, turn = self.clock(read[1]), read[1].stacked((1, 2, 3, 4))
            unit, turned = unit_quaternions(self.path, "vehicle_attitude", read[1], turn)
            self.raw.notes += turned
            self.raw.others["attitude"] = Channel("attitude", "1", time, unit)

    def add_plain(self, name: str, channel: str, fields: Sequence[str], unit: str, factor: float) -> None:
        """Add fields of a topic as a channel; an output, a motor or an ESC of a number only where it ran."""
        read = self.rows(name, fields)
        if read is None:
            return
        topic, numbers = read
        masked = _mask_unknown(topic, fields, numbers)
        time = self.clock(numbers)
        values = numbers.columns[1] if len(fields) == 1 else numbers.stacked(range(1, len(fields) + 1))
        if np.isfinite(values).any() and (np.nan_to_num(values).any() or not channel[-1].isdigit()):
            self.raw.others[channel] = Channel(channel, unit, time, values * factor)
            self.raw.notes += masked
            if topic.multi_id:
                sentence = f"{topic.name} is of instance {topic.multi_id}, the lowest in the log"
                self.raw.notes.append(note("lowest-instance-read", sentence))
        elif masked and np.isnan(values).all():
            sentence = f"{channel} was left out: no message has a value that PX4 marks as known"
            self.raw.notes += [*masked, note("no-known-value", sentence)]


def _parse(source: Source, options: CaptureOptions) -> RawCapture:
    path = source.path
    core = library(path, "pyulog.core", "pyulog")
    if not source.head.startswith(_MAGIC):
        raise LogError(f"{path}: not a ULog (its first bytes do not say so); check the format")
    with reading(path, "ULog", "copy it from the drone again"):
        log = core.ULog(path)
        topics = _Topics(path, log, options.time_back or "drop")
        others = [body for name, body in _ODOMETRY.items() if topics.add_odometry(name, body)]
        topics.add_attitude()
        for plain in _PLAIN:
            topics.add_plain(*plain)
    raw = topics.raw
    raw.notes = list(dict.fromkeys(raw.notes))
    channels = [*(f"{body.name}/position" for body in raw.bodies), *raw.others]
    if not channels and raw.notes:
        raise LogError(f"{path}: nothing is left to read: {'; '.join(map(str, raw.notes))}")
    if not channels:
        raise LogError(
            f"{path}: none of the topics that sysid reads is in this log; found "
            f"{listing(sorted(topics.topics))}"
        )
    if any(name.startswith("output_") for name in channels):
        sentence = (
            "actuator outputs as recorded: µs where the speed controllers take PWM, levels of DShot or CAN "
            "where they do not"
        )
        raw.notes.append(note("actuator-outputs-as-recorded", sentence))
    if log.dropouts:
        lost = 1e-3 * sum(dropout.duration for dropout in log.dropouts)
        sentence = f"the logger dropped out {len(log.dropouts)} times, {lost:.3g} s in all"
        raw.notes.append(note("logger-dropouts", sentence))
    data = source.read_bytes()
    raw.notes += length_note(_messages_end(data), len(data))
    if log.file_corruption:
        raw.notes.append(note("file-damaged", "parts of the file are damaged and were passed over"))
    raw.notes.append(_axes_note(channels, others))
    name, version = log.msg_info_dict.get("sys_name", "PX4"), log.msg_info_dict.get("ver_hw", "")
    raw.device = f"{name} {str(version).strip()}".strip()
    return raw


FORMAT = capture_format("ulog", "PX4 ULog (onboard log)", _recognize, _parse, {"time_back": ()})
