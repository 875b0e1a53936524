"""Random valid binary logs, written by the libraries of their formats, read back equal."""

import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sysid.errors import LogError
from sysid.loaders import load

SETTINGS = settings(
    max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
SEEDS = st.integers(0, 2**32 - 1)
# Unix seconds in double precision resolve 0.24 µs.
STAMP = 5e-7


def c3d_bytes(tmp_path, random, unit="mm", gap="nan", analogs=2):
    """Write markers with occlusions and analog channels; return the bytes and what is in them."""
    ezc3d = pytest.importorskip("ezc3d", reason="ezc3d comes with the test extra")
    count, frames = int(random.integers(1, 6)), int(random.integers(2, 25))
    rate, ratio = float(random.choice([50.0, 120.0, 200.0])), int(random.integers(1, 5))
    names = [f"quad:m{i}" if i % 2 else f"M {i}" for i in range(count)]
    points = (random.normal(size=(frames, count, 3)) * 100).astype(np.float32).astype(float)
    lost = random.uniform(size=(frames, count)) < 0.25
    lost[0] = False
    volts = random.normal(size=(analogs, frames * ratio)).astype(np.float32).astype(float)
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [rate]
    file["parameters"]["POINT"]["LABELS"]["value"] = names
    file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    data = np.ones((4, count, frames))
    data[:3] = points.transpose(2, 1, 0)
    residuals = np.zeros((1, count, frames))
    if gap == "nan":
        data[:3, lost.T] = np.nan
    else:
        residuals[0, lost.T] = -1
    file["data"]["points"] = data
    file["data"]["meta_points"]["residuals"] = residuals
    if analogs:
        file["parameters"]["ANALOG"]["RATE"]["value"] = [rate * ratio]
        file["parameters"]["ANALOG"]["LABELS"]["value"] = [f"Fz {i}" for i in range(analogs)]
        file["parameters"]["ANALOG"]["UNITS"]["value"] = ["N"] * analogs
        file["data"]["analogs"] = volts[None]
    path = tmp_path / "log.c3d"
    file.write(str(path))
    return path, names, points, lost, rate, volts, ratio


def assert_c3d(log, names, points, lost, rate, volts, ratio, factor):
    frames = len(points)
    assert [name for name in log.channels if name.endswith("/position")] == [f"{n}/position" for n in names]
    for i, name in enumerate(names):
        channel = log[f"{name}/position"]
        np.testing.assert_allclose(np.diff(channel.time), 1 / rate, rtol=1e-9)
        np.testing.assert_array_equal(channel.valid, ~lost[:, i])
        # One product with the unit's factor.
        np.testing.assert_allclose(channel.values[~lost[:, i]], points[~lost[:, i], i] * factor, rtol=1e-15)
    for i, row in enumerate(volts):
        channel = log[f"analog/Fz {i}"]
        assert channel.unit == "N"
        assert channel.time.size == frames * ratio
        np.testing.assert_allclose(np.diff(channel.time), 1 / (rate * ratio), rtol=1e-9)
        assert channel.time[0] == log[f"{names[0]}/position"].time[0]
        np.testing.assert_array_equal(channel.values, row)


@SETTINGS
@given(SEEDS, st.sampled_from([("mm", 1e-3), ("m", 1.0)]), st.sampled_from(["nan", "residual"]))
def test_c3d(tmp_path, seed, unit, gap):
    random = np.random.default_rng(seed)
    path, *told = c3d_bytes(tmp_path, random, unit[0], gap, analogs=int(random.integers(0, 3)))
    assert_c3d(load(path), *told, unit[1])


def vax(data):
    """Return a little-endian number of single precision as DEC writes it: four times it, words swapped."""
    (number,) = struct.unpack("<f", data)
    if number == 0:
        return bytes(4)
    quadruple = struct.pack("<f", 4 * number)
    return quadruple[2:] + quadruple[:2]


def reversed_bytes(data):
    return data[::-1]


def other_processor(data, mark):
    """Return an Intel C3D file with every number as another processor writes it: 85 DEC, 86 SGI/MIPS."""
    real = vax if mark == 85 else reversed_bytes
    whole = bytes if mark == 85 else reversed_bytes
    out = bytearray(data)

    def convert(start, size, count, how):
        for at in range(start, start + size * count, size):
            out[at : at + size] = how(bytes(data[at : at + size]))

    parameters, (first_block,) = (data[0] - 1) * 512, struct.unpack_from("<H", data, 16)
    convert(2, 2, 5, whole)
    convert(12, 4, 1, real)
    convert(16, 2, 2, whole)
    convert(20, 4, 1, real)
    convert(24, 2, 244, whole)
    out[parameters + 3] = mark
    at = parameters + 4
    while data[at]:
        length = struct.unpack_from("b", data, at)[0]
        after = at + 2 + abs(length)
        (step,) = struct.unpack_from("<h", data, after)
        convert(after, 2, 1, whole)
        if struct.unpack_from("b", data, at + 1)[0] > 0:
            kind, dimensions = struct.unpack_from("bB", data, after + 2)
            count = int(np.prod([data[after + 4 + k] for k in range(dimensions)], dtype=int))
            begin = after + 4 + dimensions
            if kind in (2, 4):
                convert(begin, kind, count, whole if kind == 2 else real)
        if not step:
            break
        at = after + step
    start = (first_block - 1) * 512
    convert(start, 4, (len(data) - start) // 4, real)
    return bytes(out)


@SETTINGS
@given(SEEDS)
def test_c3d_of_a_dec_machine_reads_as_that_of_intel(tmp_path, seed):
    # A float of DEC has no NaN: occlusions are negative residuals.
    path, *told = c3d_bytes(tmp_path, np.random.default_rng(seed), gap="residual")
    data = path.read_bytes()
    path.write_bytes(other_processor(data, 85))
    assert path.read_bytes() != data
    assert_c3d(load(path), *told, 1e-3)


def test_c3d_of_an_sgi_machine_is_refused(tmp_path):
    path, *_ = c3d_bytes(tmp_path, np.random.default_rng(3))
    data = path.read_bytes()
    path.write_bytes(other_processor(data, 86))
    for asked in ("auto", "c3d"):
        with pytest.raises(LogError, match=r"log\.c3d: numbers are in the byte order of SGI/MIPS"):
            load(path, format=asked)


@pytest.mark.parametrize(("order", "mark"), [(86, 84), (84, 86), (86, 85), (85, 84), (84, 85)])
def test_c3d_marked_as_of_another_processor_is_refused(tmp_path, order, mark):
    path, *_ = c3d_bytes(tmp_path, np.random.default_rng(4), gap="residual")
    data = bytearray(path.read_bytes() if order == 84 else other_processor(path.read_bytes(), order))
    data[(data[0] - 1) * 512 + 3] = mark
    path.write_bytes(data)
    with pytest.raises(LogError, match=r"^[^\n]*log\.c3d: [^\n]*$"):
        load(path, format="c3d")


def walk(random, count, gaps):
    """Positions, unit quaternions (w first, of any sign) in small turns, and which poses are not known."""
    turns = [Rotation.random(rng=random)]
    for step in random.uniform(-0.5, 0.5, (count - 1, 3)):
        turns.append(turns[-1] * Rotation.from_rotvec(step))
    quaternions = np.array([np.roll(turn.as_quat(), 1) for turn in turns]) * random.choice(
        [-1, 1], (count, 1)
    )
    lost = (random.uniform(size=count) < 0.2) & gaps
    return random.normal(size=(count, 3)) * 3, quaternions, lost


def assert_body(log, name, position, quaternions, lost, atol):
    np.testing.assert_array_equal(log[f"{name}/position"].values, position)
    channel = log[f"{name}/orientation"]
    np.testing.assert_array_equal(channel.valid, ~lost)
    got, wanted = channel.values[~lost], quaternions[~lost]
    np.testing.assert_allclose(np.abs(np.sum(got * wanted, axis=1)), 1, atol=atol)
    assert np.all(np.sum(got[1:] * got[:-1], axis=1) >= 0)


def fill_bag(writer, store, first_form, topics, kind):
    types = store.types
    encode = store.serialize_ros1 if first_form else store.serialize_cdr

    def of(name, *args, **given):
        return types[f"{name}"](*args, **given)

    for topic, (stamps, position, quaternions, delay) in topics.items():
        place = writer.add_connection(topic, kind, typestore=store)
        for i, stamp in enumerate(stamps):
            time = of("builtin_interfaces/msg/Time", sec=int(stamp // 10**9), nanosec=int(stamp % 10**9))
            first = {"seq": i} if first_form else {}
            header = of("std_msgs/msg/Header", stamp=time, frame_id="world", **first)
            w, x, y, z = map(float, quaternions[i])
            turn = of("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
            if kind.endswith("TransformStamped"):
                way = of("geometry_msgs/msg/Vector3", *map(float, position[i]))
                body = of("geometry_msgs/msg/Transform", translation=way, rotation=turn)
                message = types[kind](header=header, child_frame_id="x", transform=body)
            else:
                point = of("geometry_msgs/msg/Point", *map(float, position[i]))
                pose = of("geometry_msgs/msg/Pose", position=point, orientation=turn)
                if "Covariance" in kind:
                    pose = of("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36))
                message = types[kind](header=header, pose=pose)
            writer.write(place, int(stamp) + delay, encode(message, kind))


@SETTINGS
@given(
    SEEDS,
    st.sampled_from(["bag", "mcap", "sqlite"]),
    st.sampled_from(["PoseStamped", "PoseWithCovarianceStamped", "TransformStamped"]),
    st.sampled_from([["/quad/pose"], ["/vrpn/quad", "/vrpn/board"], ["/a", "/a/b", "/b"]]),
)
def test_ros_recordings(tmp_path_factory, seed, form, kind, names):
    pytest.importorskip("rosbags", reason="rosbags comes with the test extra")
    from rosbags.typesys import Stores, get_typestore

    tmp_path = tmp_path_factory.mktemp("bag")
    random = np.random.default_rng(seed)
    topics, lost = {}, {}
    for name in names:
        count = int(random.integers(1, 30))
        position, quaternions, lost[name] = walk(random, count, gaps=True)
        position[lost[name]] = np.nan
        quaternions[lost[name]] = np.nan
        # Frames of one rate, of which some are lost on the way.
        frames = np.cumsum(random.integers(1, 4, count))
        stamps = 1_700_000_000_123_456_789 + frames * int(random.choice([2_777_778, 10_000_000]))
        topics[name] = (stamps, position, quaternions, int(random.integers(0, 5_000_000)))
    if form == "bag":
        from rosbags.rosbag1 import Writer

        path = tmp_path / "a.bag"
        with Writer(path) as writer:
            fill_bag(writer, get_typestore(Stores.ROS1_NOETIC), True, topics, f"geometry_msgs/msg/{kind}")
    else:
        from rosbags.rosbag2 import StoragePlugin, Writer

        plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
        with Writer(tmp_path / "a", version=9, storage_plugin=plugin) as writer:
            fill_bag(writer, get_typestore(Stores.ROS2_HUMBLE), False, topics, f"geometry_msgs/msg/{kind}")
        path = next(one for one in (tmp_path / "a").iterdir() if one.suffix in (".mcap", ".db3"))
    by_clock = {clock: load(path, clock=clock) for clock in ("header", "arrival")}
    for name, (stamps, position, quaternions, delay) in topics.items():
        body = name.strip("/")
        for clock, log in by_clock.items():
            assert set(log.rigid_bodies) == {one.strip("/") for one in names}
            told = (stamps + (delay if clock == "arrival" else 0)) * 1e-9
            np.testing.assert_allclose(log[f"{body}/position"].time, told, rtol=0, atol=STAMP)
            assert_body(log, body, position, quaternions, lost[name], 1e-12)


ULOG_TOPICS = {
    "vehicle_odometry": "float[3] position;float[4] q;",
    "battery_status": "float voltage_v;float current_a;",
    "actuator_motors": "float[4] control;",
    "sensor_combined": "float[3] gyro_rad;float[3] accelerometer_m_s2;",
    "unknown_to_us": "uint8_t[5] said;",
}


def ulog(topics):
    """A ULog by the format's definition: topic -> (stamps [µs], rows of single precision)."""

    def message(kind, body):
        return struct.pack("<HB", len(body), ord(kind)) + body

    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    for name in topics:
        out += message("F", f"{name}:uint64_t timestamp;{ULOG_TOPICS[name]}".encode())
    for number, name in enumerate(topics):
        out += message("A", struct.pack("<BH", 0, number) + name.encode())
    rows = [
        (stamp, number, row.tobytes())
        for number, (stamps, table) in enumerate(topics.values())
        for stamp, row in zip(stamps.tolist(), table, strict=True)
    ]
    for stamp, number, row in sorted(rows):
        out += message("D", struct.pack("<HQ", number, stamp) + row)
    return out


@SETTINGS
@given(SEEDS, st.lists(st.sampled_from(sorted(ULOG_TOPICS)), min_size=0, max_size=4, unique=True))
def test_ulog(tmp_path, seed, others):
    pytest.importorskip("pyulog", reason="pyulog comes with the test extra")
    random = np.random.default_rng(seed)
    topics = {}
    for name in sorted({"vehicle_odometry", *others}):
        count = int(random.integers(1, 40))
        stamps = 1_000_000 + np.cumsum(random.integers(1, 4, count)) * int(random.choice([4000, 10_001]))
        width = {"battery_status": 2, "actuator_motors": 4, "sensor_combined": 6, "unknown_to_us": 5}.get(
            name
        )
        table = random.normal(size=(count, width or 7)).astype("<f4")
        if width is None:
            position, quaternions, lost = walk(random, count, gaps=True)
            table[:, :3], table[:, 3:] = position, quaternions
            table[lost] = np.nan
        elif width == 5:
            table = random.integers(0, 255, (count, 5)).astype("u1")
        else:
            table[random.uniform(size=table.shape) < 0.2] = np.nan
            table[0] = 1
        topics[name] = (stamps, table)
    path = tmp_path / "log.bin"
    path.write_bytes(ulog(topics))
    log = load(path)
    stamps, table = topics["vehicle_odometry"]
    np.testing.assert_allclose(log["vehicle/position"].time, stamps * 1e-6, rtol=1e-14)
    # Quaternions are normalised, those of single precision too.
    assert_body(log, "vehicle", table[:, :3].astype(float), table[:, 3:].astype(float), lost, 1e-6)
    told = {
        "voltage": ("battery_status", 0), "current": ("battery_status", 1), "motor_0": ("actuator_motors", 0),
        "motor_3": ("actuator_motors", 3), "angular_velocity": ("sensor_combined", slice(0, 3)),
        "acceleration": ("sensor_combined", slice(3, 6)),
    }  # fmt: skip
    for channel, (name, column) in told.items():
        assert (channel in log.channels) == (name in topics)
        if name in topics:
            stamps, table = topics[name]
            np.testing.assert_allclose(log[channel].time, stamps * 1e-6, rtol=1e-14)
            np.testing.assert_array_equal(log[channel].values, table[:, column].astype(float))
