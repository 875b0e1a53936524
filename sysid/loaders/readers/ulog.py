"""PX4 ULog (pyulog): pose, battery, ESC speeds and motor commands as the drone logged them itself.

Frames are those of PX4: positions north, east, down from the point of take-off; body axes front, right, down;
quaternions w first, body to world. A body ``vehicle`` needs position and attitude on one clock, which
``vehicle_odometry`` or ``vehicle_visual_odometry`` has; the estimates of ``vehicle_attitude`` and
``vehicle_local_position`` are channels of their own. Of a topic that several sensors publish the lowest
instance is read. What PX4 writes for unknown (current -1 A, 0 V) or marks as not valid is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.clock import order_rows
from sysid.loaders.columns import listing
from sysid.loaders.motion_capture import body_channels, unit_quaternions
from sysid.loaders.optional import library, reading
from sysid.loaders.registry import CERTAIN, NO, LogFormat
from sysid.loaders.source import Source
from sysid.loaders.table import Numbers
from sysid.recording import Channel, FloatArray, Recording

_NAME = "ulog"
_MAGIC = b"ULog\x01\x12\x35"
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


def _rows(topic: Any, fields: Sequence[str], word: str) -> Numbers:
    """Return the fields of a topic on its clock [s]; pyulog gives microseconds since boot."""
    columns: dict[int, FloatArray] = {0: np.asarray(topic.data["timestamp"], dtype=np.float64) * 1e-6}
    for i, name in enumerate(fields, start=1):
        values = np.asarray(topic.data[name], dtype=np.float64)
        columns[i] = np.where(np.isinf(values), np.nan, values)
    return Numbers(columns, np.arange(1, columns[0].size + 1), row_word=f"{word} message")


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
            notes.append(
                note(
                    "marked-unknown",
                    f"{topic.name}.{name} is {why}, in {int(unknown.sum())} messages; taken as missing",
                )
            )
    return notes


def _instance_note(topic: Any) -> list[Finding]:
    return (
        [note("lowest-instance-read", f"{topic.name} is of instance {topic.multi_id}, the lowest in the log")]
        if topic.multi_id
        else []
    )


def _frame(topic: Any, body: str) -> tuple[str, list[Finding]]:
    """Return the frame of the poses of an odometry topic (empty where it changes), and notes."""
    field = next((name for name in _FRAMES if name in topic.data), "")
    if not field:
        return "NED", []  # all that PX4 knew then
    found = [
        _FRAMES[field].get(int(one), f"number {int(one)}") for one in np.unique(topic.data[field]).tolist()
    ]
    if len(found) > 1:
        return "", [
            note("frame-changes", f"{body} was left out: its {field} changes between {' and '.join(found)}")
        ]
    if found == ["NED"]:
        return "NED", []
    turned = "z is down, but x and y are turned from north and east by an unknown heading"
    what = turned if found == ["FRD"] else "its axes are not known; check them before use"
    return found[0], [note("other-frame", f"{field} of {body} is {found[0]}, not NED: {what}")]


def _axes_note(channels: Sequence[str], others: Sequence[str]) -> Finding:
    """Return a note on the axes of the channels, but not of the bodies `others` in frames of their own."""
    placed = [one for one in channels if one.endswith("position") or one in ("local_velocity", "attitude")]
    known = [name for name in placed if name.rpartition("/")[0] not in others]
    whose = f" of {' and '.join(known)}" if others else ""
    north = f"axes{whose}: north, east, down; " if known else "axes: "
    return note("axes", f"{north}body front, right, down, as PX4 defines them")


def _stack(numbers: Numbers, first: int, width: int) -> FloatArray:
    return np.column_stack([numbers.columns[first + i] for i in range(width)])


def _load(source: Source) -> Any:
    path = source.path
    core = library(path, "pyulog.core", "pyulog")
    error = library(path, "pyulog.exceptions", "pyulog").ULogException
    if not source.head.startswith(_MAGIC):
        raise LogError(f"{path}: not a ULog (its first bytes do not say so); check the format")
    with reading(path, "ULog", "copy it from the drone again", error):
        return core.ULog(path)


def _read(source: Source, *, time_back: str = "drop") -> Recording:
    path = source.path
    log = _load(source)
    topics = {topic.name: topic for topic in sorted(log.data_list, key=lambda one: -one.multi_id)}
    notes: list[Finding] = []
    channels: dict[str, Channel] = {}
    others: list[str] = []

    def clocked(numbers: Numbers) -> FloatArray:
        time, said = order_rows(path, numbers, 0, 1.0, time_back=time_back)
        notes.extend(note for note in said if note not in notes)
        return time

    for topic_name, body in _ODOMETRY.items():
        topic = topics.get(topic_name)
        place = ("position[0]", "position[1]", "position[2]")
        if topic is not None and place[0] not in topic.data:
            place = ("x", "y", "z")  # before PX4 1.14
        fields = (*place, "q[0]", "q[1]", "q[2]", "q[3]")
        if (
            topic is None
            or any(name not in topic.data for name in fields)
            or not len(topic.data["timestamp"])
        ):
            continue
        frame, said = _frame(topic, body)
        notes += said
        if not frame:
            continue
        others += [body] if frame != "NED" else []
        numbers = _rows(topic, fields, topic_name)
        time = clocked(numbers)
        orientation, said = unit_quaternions(path, body, numbers, _stack(numbers, 4, 4))
        notes += said
        channels |= body_channels(body, time, _stack(numbers, 1, 3), orientation)
    attitude = topics.get("vehicle_attitude")
    quaternion = [f"q[{i}]" for i in range(4)]
    if attitude is not None and all(name in attitude.data for name in quaternion):
        numbers = _rows(attitude, quaternion, "vehicle_attitude")
        if numbers.lines.size:
            time = clocked(numbers)
            values, said = unit_quaternions(path, "vehicle_attitude", numbers, _stack(numbers, 1, 4))
            notes += said
            channels["attitude"] = Channel("attitude", "1", time, values)
    for topic_name, channel, wanted, unit, factor in _PLAIN:
        topic = topics.get(topic_name)
        if (
            topic is None
            or any(name not in topic.data for name in wanted)
            or not len(topic.data["timestamp"])
        ):
            continue
        numbers = _rows(topic, wanted, topic_name)
        said = _mask_unknown(topic, wanted, numbers)
        time = clocked(numbers)
        values = numbers.columns[1] if len(wanted) == 1 else _stack(numbers, 1, len(wanted))
        if np.isfinite(values).any() and (np.nan_to_num(values).any() or not channel[-1].isdigit()):
            channels[channel] = Channel(channel, unit, time, values * factor)
            notes += [*said, *_instance_note(topic)]
        elif said and np.isnan(values).all():
            notes += [
                *said,
                note(
                    "no-known-value",
                    f"{channel} was left out: no message holds a value that PX4 marks as known",
                ),
            ]
    if not channels and notes:
        raise LogError(f"{path}: nothing is left to read: {'; '.join(dict.fromkeys(map(str, notes)))}")
    if not channels:
        raise LogError(
            f"{path}: none of the topics that sysid reads is in this log; found {listing(sorted(topics))}"
        )
    if any(name.startswith("output_") for name in channels):
        notes.append(
            note(
                "actuator-outputs-as-recorded",
                "actuator outputs as recorded: µs where the speed controllers take PWM, levels of DShot or "
                "CAN where they do not",
            )
        )
    notes = list(dict.fromkeys(notes))
    if log.dropouts:
        lost = 1e-3 * sum(one.duration for one in log.dropouts)
        notes.append(
            note("logger-dropouts", f"the logger dropped out {len(log.dropouts)} times, {lost:.3g} s in all")
        )
    if log.file_corruption:
        notes.append(note("file-damaged", "parts of the file are damaged and were passed over"))
    device = str(log.msg_info_dict.get("sys_name", "PX4"))
    version = str(log.msg_info_dict.get("ver_hw", "")).strip()
    notes.append(_axes_note(list(channels), others))
    return Recording(
        "onboard", channels, source.provenance(_NAME, device=f"{device} {version}".strip(), notes=notes)
    )


FORMAT = LogFormat(_NAME, "PX4 ULog (onboard log)", _recognize, _read, {"time_back": ()})
