"""Writers of logs that several tests share, and what several tests ask of what was loaded."""

import re

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from scipy.spatial.transform import Rotation

from sysid.errors import LogError
from sysid.loaders import detect, formats, load
from sysid.loaders.options import DECLARED

# One lbf and one lbf-in as the maker of the transducers states them.
LBF, LBF_IN = 4.4482216152605, 0.1129848290276167
# Headers of text logs: what several tests change in them stands in braces.
LVM = (
    "LabVIEW Measurement\nSeparator\tTab\nDecimal_Separator\t.\nX_Columns\t{columns}\n***End_of_Header***\n\n"
    "Channels\t1\nY_Unit_Label\tN\n{axis}X0\t2\nDelta_X\t0.5\n***End_of_Header***\nX_Value\tFz\tComment\n"
)
NET_FT = (
    "RDT Sample Rate: 100\nForce Units: N\nCounts per Unit Force: {0}\nTorque Units: Nm\n"
    "Counts per Unit Torque: {0}\n"
    "Status (hex), RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time\n"
)
ROS = "%time,field.header.seq,field.header.stamp," + ",".join(
    f"field.pose.{part}"
    for part in (*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw"))
)


def examples(count):
    """Settings of a property of `count` examples: a file is written for each, so one may be slow."""
    return settings(
        max_examples=count, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
    )


def refuses(path, sentence, error=LogError, **options):
    """Load a log that must be refused in one sentence, which matches this pattern; return the sentence.

    It may only name options that the log's format takes.
    """
    with pytest.raises(error, match=sentence) as caught:
        load(path, **options)
    said = str(caught.value)
    assert "\n" not in said
    advised = set(re.findall(r"\b(\w+) = ", said)) & set(DECLARED)
    if advised:
        known = formats()[options.get("format") or detect(path)].options
        assert advised <= set(known), said
    return said


def notes(recording):
    """Return the sentences of a recording's notes, joined."""
    return " | ".join(recording.provenance.sentences)


def row_lines(count, row):
    """Return `count` lines of a pattern that may name the row's number `{i}` and its time `{t}` of 10 ms."""
    return "".join(row.format(i=i, t=f"{i * 0.01:.6f}") + "\n" for i in range(count))


def small_turns(random, count):
    """Return rotations that differ from the one before by less than half a turn."""
    turns = [Rotation.random(None, random)]
    for step in random.uniform(-0.5, 0.5, (count - 1, 3)):
        turns.append(turns[-1] * Rotation.from_rotvec(step))
    return turns


def quaternions_of(turns):
    """Return the unit quaternions of rotations, w first."""
    return np.array([np.roll(turn.as_quat(), 1) for turn in turns])


def assert_turns(channel, quaternions, lost, atol):
    """Assert the rotations, whatever the sign that was written, and one sign through the whole log."""
    np.testing.assert_array_equal(channel.valid, ~lost)
    got, wanted = channel.values[~lost], quaternions[~lost]
    np.testing.assert_allclose(np.abs(np.sum(got * wanted, axis=1)), 1, atol=atol)
    assert np.all(np.sum(got[1:] * got[:-1], axis=1) >= 0)


def c3d(
    path, points, *, labels=None, rate=100.0, unit="mm", residuals=None, analogs=None, trial=None, form=()
):
    """Write points (frames, markers, 3) and analog channels {label: (unit, values)}, of any number per frame.

    ``trial`` is the first and the last frame that the TRIAL group states, ``form`` states ANALOG:FORMAT.
    """
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d comes with the logs extra")
    frames, count, _ = points.shape
    file = ezc3d.c3d()

    def state(group, **values):
        for key, value in values.items():
            file["parameters"][group][key]["value"] = value

    state("POINT", RATE=[rate], LABELS=labels or [f"quad:{i}" for i in range(count)], UNITS=[unit])
    data = np.ones((4, count, frames))
    data[:3] = points.transpose(2, 1, 0)
    file["data"]["points"] = data
    if residuals is not None:
        file["data"]["meta_points"]["residuals"] = residuals.T[None]
    for key, number in zip(("ACTUAL_START_FIELD", "ACTUAL_END_FIELD"), trial or (), strict=False):
        file.add_parameter("TRIAL", key, [number & 0xFFFF, number >> 16])
    if analogs:
        units, values = zip(*analogs.values(), strict=True)
        state("ANALOG", RATE=[rate * len(values[0]) / frames], LABELS=list(analogs), UNITS=list(units))
        state("ANALOG", FORMAT=list(form))
        file["data"]["analogs"] = np.array(values)[None]
    file.write(str(path))
    return path


def tdms(path, *segments):
    """Write segments, each of which is a list of channels (group, name, values, properties)."""
    nptdms = pytest.importorskip("nptdms", reason="npTDMS comes with the test extra")
    with nptdms.TdmsWriter(str(path)) as writer:
        for segment in segments:
            writer.write_segment([nptdms.ChannelObject(*channel) for channel in segment])
    return path


def hdf5(path, datasets, **attributes):
    """Write datasets {name: (unit, values)}; no unit is stated where it is None."""
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs.update(attributes)
        for name, (unit, values) in datasets.items():
            data = file.create_dataset(name, data=values)
            if unit is not None:
                data.attrs["unit"] = unit
    return path


def ros_recording(folder, form, topics, kind="PoseStamped"):
    """Write a bag, mcap or sqlite recording of topics {name: (stamps [ns], positions, quaternions, delay)}.

    The delay [ns] is how much later than its stamp a message arrived. A topic /remark holds a text.
    """
    pytest.importorskip("rosbags", reason="rosbags comes with the test extra")
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    first = form == "bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    encode = store.serialize_ros1 if first else store.serialize_cdr
    kind = f"geometry_msgs/msg/{kind}"

    def geometry(name, *arguments, **fields):
        return store.types[f"geometry_msgs/msg/{name}"](*arguments, **fields)

    def message(i, stamp, position, quaternion):
        time = store.types["builtin_interfaces/msg/Time"](*(int(part) for part in divmod(stamp, 10**9)))
        header = store.types["std_msgs/msg/Header"](
            stamp=time, frame_id="world", **({"seq": i} if first else {})
        )
        w, x, y, z = map(float, quaternion)
        turn = geometry("Quaternion", x=x, y=y, z=z, w=w)
        if kind.endswith("TransformStamped"):
            way = geometry("Vector3", *map(float, position))
            body = geometry("Transform", translation=way, rotation=turn)
            return store.types[kind](header=header, child_frame_id="x", transform=body)
        pose = geometry("Pose", position=geometry("Point", *map(float, position)), orientation=turn)
        if "Covariance" in kind:
            pose = geometry("PoseWithCovariance", pose=pose, covariance=np.zeros(36))
        return store.types[kind](header=header, pose=pose)

    if first:
        path = folder / "a.bag"
        writer = rosbag1.Writer(path)
    else:
        plugin = rosbag2.StoragePlugin.MCAP if form == "mcap" else rosbag2.StoragePlugin.SQLITE3
        writer = rosbag2.Writer(folder / "a", version=9, storage_plugin=plugin)
    with writer:
        for topic, (stamps, positions, quaternions, delay) in topics.items():
            place = writer.add_connection(topic, kind, typestore=store)
            for i, stamp in enumerate(stamps):
                data = encode(message(i, stamp, positions[i], quaternions[i]), kind)
                writer.write(place, int(stamp) + delay, data)
        text = "std_msgs/msg/String"
        place = writer.add_connection("/remark", text, typestore=store)
        writer.write(place, int(stamps[0]), encode(store.types[text](data="x"), text))
    return path if first else next(x for x in (folder / "a").iterdir() if x.suffix in (".mcap", ".db3"))
