"""Random valid binary logs, written by the libraries of their formats, read back equal."""

import struct

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from fakes.log_files import assert_turns, c3d, examples, quaternions_of, refuses, ros_recording, small_turns
from fakes.log_files import tdms as write_tdms
from sysid.loaders import load

SETTINGS, MORE = examples(20), examples(30)
SEEDS = st.integers(0, 2**32 - 1)


pytestmark = pytest.mark.usefixtures("in_this_process")

# Unix seconds in double precision resolve 0.24 µs.
STAMP = 5e-7


def random_c3d(tmp_path, random, unit="mm", gap="nan", analogs=2):
    """Write markers with occlusions and analog channels; return the path and what is in the file."""
    count, frames = int(random.integers(1, 6)), int(random.integers(2, 25))
    rate, ratio = float(random.choice([50.0, 120.0, 200.0])), int(random.integers(1, 5))
    names = [f"quad:m{i}" if i % 2 else f"M {i}" for i in range(count)]
    points = (random.normal(size=(frames, count, 3)) * 100).astype(np.float32).astype(float)
    lost = random.uniform(size=(frames, count)) < 0.25
    lost[0] = False
    volts = random.normal(size=(analogs, frames * ratio)).astype(np.float32).astype(float)
    written = np.where(lost[..., None] & (gap == "nan"), np.nan, points)
    path = c3d(
        tmp_path / "log.c3d", written, labels=names, rate=rate, unit=unit,
        residuals=np.where(lost & (gap != "nan"), -1.0, 0.0),
        analogs={f"Fz {i}": ("N", row) for i, row in enumerate(volts)},
    )  # fmt: skip
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
    path, *content = random_c3d(tmp_path, random, unit[0], gap, analogs=int(random.integers(0, 3)))
    assert_c3d(load(path), *content, unit[1])


def vax(data):
    """Return a little-endian number of single precision as DEC writes it: four times it, words swapped."""
    (number,) = struct.unpack("<f", data)
    if number == 0:
        return bytes(4)
    quadruple = struct.pack("<f", 4 * number)
    return quadruple[2:] + quadruple[:2]


def other_processor(data, mark):
    """Return an Intel C3D file with every number as another processor writes it: 85 DEC, 86 SGI/MIPS."""
    real, whole = (vax, bytes) if mark == 85 else (lambda data: data[::-1],) * 2
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
def test_c3d_of_dec_reads_as_that_of_intel(tmp_path, seed):
    # A float of DEC has no NaN: occlusions are negative residuals.
    path, *content = random_c3d(tmp_path, np.random.default_rng(seed), gap="residual")
    data = path.read_bytes()
    path.write_bytes(other_processor(data, 85))
    assert path.read_bytes() != data
    assert_c3d(load(path), *content, 1e-3)
    path.write_bytes(other_processor(data, 86))
    refuses(path, "in the number format of SGI/MIPS processors, which ezc3d does not read; export it again")


@pytest.mark.parametrize(("order", "mark"), [(86, 84), (84, 86), (86, 85), (85, 84), (84, 85)])
def test_c3d_marked_as_of_another_processor_is_refused(tmp_path, order, mark):
    path, *_ = random_c3d(tmp_path, np.random.default_rng(4), gap="residual")
    data = bytearray(path.read_bytes() if order == 84 else other_processor(path.read_bytes(), order))
    data[(data[0] - 1) * 512 + 3] = mark
    path.write_bytes(data)
    refuses(path, r"^[^\n]*log\.c3d: [^\n]*$", format="c3d")


def random_walk(random, count):
    """Return positions, unit quaternions (w first, of any sign) in small turns, and which are lost."""
    quaternions = quaternions_of(small_turns(random, count)) * random.choice([-1, 1], (count, 1))
    return random.normal(size=(count, 3)) * 3, quaternions, random.uniform(size=count) < 0.2


@SETTINGS
@given(
    SEEDS,
    st.sampled_from(["bag", "mcap", "sqlite"]),
    st.sampled_from(["PoseStamped", "PoseWithCovarianceStamped", "TransformStamped"]),
    st.sampled_from([["/quad/pose"], ["/vrpn/quad", "/vrpn/board"], ["/a", "/a/b", "/b"]]),
)
def test_ros_recordings(tmp_path_factory, seed, form, kind, names):
    tmp_path = tmp_path_factory.mktemp("bag")
    random = np.random.default_rng(seed)
    topics, lost = {}, {}
    for name in names:
        count = int(random.integers(1, 30))
        position, quaternions, lost[name] = random_walk(random, count)
        position[lost[name]] = np.nan
        quaternions[lost[name]] = np.nan
        # Frames of one rate, of which some are lost on the way.
        frames = np.cumsum(random.integers(1, 4, count))
        stamps = 1_700_000_000_123_456_789 + frames * int(random.choice([2_777_778, 10_000_000]))
        topics[name] = (stamps, position, quaternions, int(random.integers(0, 5_000_000)))
    path = ros_recording(tmp_path, form, topics, kind)
    by_clock = {clock: load(path, clock=clock) for clock in ("header", "arrival")}
    for name, (stamps, position, quaternions, delay) in topics.items():
        body = name.strip("/")
        for clock, log in by_clock.items():
            assert set(log.rigid_bodies) == {item.strip("/") for item in names}
            stated = (stamps + (delay if clock == "arrival" else 0)) * 1e-9
            np.testing.assert_allclose(log[f"{body}/position"].time, stated, rtol=0, atol=STAMP)
            np.testing.assert_array_equal(log[f"{body}/position"].values, position)
            assert_turns(log[f"{body}/orientation"], quaternions, lost[name], 1e-12)


@MORE
@given(SEEDS, st.sampled_from(["5", "7.3"]), st.sampled_from(["vectors", "struct", "matrix"]))
def test_mat(tmp_path, seed, version, form):
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 40))
    thrust, torque = random.normal(size=(2, count))
    options = {"units": {"thrust": "N", "torque": "N*m"}}
    if form == "vectors":
        content = {"Fz": thrust, "Mz": torque, "fs": 5000.0}
    elif form == "struct":
        cells = {"Fz": {"data": thrust, "unit": "kN"}, "Mz": {"data": torque, "unit": "Nm"}, "rate": 5e3}
        content, options, thrust = {"cell": cells}, {}, 1000 * thrust
    else:
        content = {"FT": np.column_stack([thrust, torque])}
        options |= {"rate": 5000, "datasets": {"thrust": "FT[1]", "torque": "FT[2]"}}
    path = tmp_path / "log.bin"
    if version == "5":
        savemat(path, content)
    else:
        path.unlink(missing_ok=True)
        with h5py.File(path, "w", userblock_size=512) as file:
            write_mat73(file, content)
        block = path.read_bytes()
        path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + block[512:])
    log = load(path, **options)
    assert log.provenance.format == "mat"
    np.testing.assert_allclose(log["thrust"].values, thrust, rtol=1e-15)
    np.testing.assert_array_equal(log["torque"].values, torque)
    np.testing.assert_allclose(log["thrust"].time, np.arange(count) / 5000, rtol=1e-14)


def write_mat73(group, content):
    """Lay content out as MATLAB does: columns first, text as codes, a class on each dataset."""
    for name, value in content.items():
        if isinstance(value, dict):
            write_mat73(group.create_group(name), value)
            continue
        text = isinstance(value, str)
        array = np.array([[ord(c)] for c in value], dtype=np.uint16) if text else np.atleast_2d(value)
        array = array if text or array.shape[0] == 1 else array.T
        group.create_dataset(name, data=array).attrs["MATLAB_class"] = np.bytes_("char" if text else "double")


@MORE
@given(SEEDS, st.booleans())
def test_tdms(tmp_path, seed, big):
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 50))
    thrust = random.normal(size=count)
    step = float(random.choice([1e-4, 0.001]))
    stated = {"wf_increment": step, "wf_start_offset": 0.25, "wf_samples": 7, "unit_string": "Newtons"}
    channels = [
        ("ft / raw", "Fz", thrust.astype("f4" if big else "f8"), stated),
        ("ft - Decimated Data_Level1", "Fz", thrust[:1], stated),
        ("other", "First  Channel", thrust, {"wf_increment": 2 * step}),
    ]
    log = load(write_tdms(tmp_path / "log.bin", channels))
    assert log.kind == "load-cell"
    np.testing.assert_array_equal(log["thrust"].values, thrust.astype("f4" if big else "f8").astype(float))
    np.testing.assert_allclose(log["thrust"].time, 0.25 + np.arange(count) * step, rtol=1e-12)
    np.testing.assert_allclose(log["First Channel"].time, np.arange(count) * 2 * step, atol=1e-15)
