"""Random valid logs of each format read back equal to what was written in them."""

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fakes.log_files import assert_turns, examples, quaternions_of, small_turns
from sysid.loaders import load

SETTINGS = examples(60)

NUMBER = st.floats(-1e6, 1e6, allow_nan=False, width=64)
RPM = 2 * np.pi / 60
# Conversion is one multiplication in SI of a factor that is itself rounded: some units in the last place.
ULPS = 1e-15


@st.composite
def clocks(draw, least=2, most=30, step=(1e-4, 0.05)):
    count = draw(st.integers(least, most))
    steps = draw(st.lists(st.floats(*step), min_size=count - 1, max_size=count - 1))
    start = draw(st.sampled_from([0.0, 10.85, 1723310285.692]))
    time = start + np.concatenate(([0.0], np.cumsum(steps)))
    # Written with repr, so what is equal in memory is equal in the file.
    return time if all(b > a for a, b in pairwise(time)) else start + np.arange(count) * 0.01


@st.composite
def columns(draw, count, number=NUMBER, gaps=True):
    cell = st.one_of(st.just(float("nan")), number) if gaps else number
    return np.array(draw(st.lists(cell, min_size=count, max_size=count)))


@st.composite
def dress(draw, names, table):
    """Write a table with a random delimiter, line end, encoding and blanks, and with comments."""
    delimiter = draw(st.sampled_from([",", ";", "\t"]))
    line_end = draw(st.sampled_from(["\n", "\r\n", "\r", "\r\r\n"]))
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "cp1252", "utf-16"]))
    blank = draw(st.sampled_from(["", " ", "nan", "NaN"]))
    trailing = draw(st.sampled_from(["", delimiter]))
    closed = draw(st.booleans())
    comma = delimiter != "," and draw(st.booleans())

    def text(value):
        if np.isnan(value):
            return blank
        shown = repr(float(value))
        return shown.replace(".", ",") if comma else shown

    lines = [delimiter.join(names) + trailing]
    lines += [delimiter.join(text(value) for value in row) + trailing for row in table]
    if draw(st.booleans()):
        lines.insert(draw(st.integers(1, len(lines))), "# a note; with, delimiters")
    if draw(st.booleans()):
        lines.insert(draw(st.integers(1, len(lines))), "")
    return (line_end.join(lines) + (line_end if closed else "")).encode(encoding)


@st.composite
def stands(draw):
    time = draw(clocks())
    unit = {
        "Thrust": draw(st.sampled_from(["N", "gf", "kgf"])),
        "Motor Optical Speed": draw(st.sampled_from(["RPM", "rad/s"])),
        "ESC signal": draw(st.sampled_from(["µs", None])),
    }
    values = {
        "ESC signal": np.array([draw(st.integers(0, 2000)) for _ in time], dtype=float),
        "Torque (N·m)": draw(columns(time.size)),
        "Thrust": draw(columns(time.size)),
        "Motor Optical Speed": draw(columns(time.size)),
        "Servo 1 (µs)": np.full(time.size, np.nan),
    }
    order = draw(st.permutations(list(values)))
    names = [f"{name} ({unit[name]})" if unit.get(name) else name for name in order]
    table = np.column_stack([time] + [values[name] for name in order])
    return time, values, unit, draw(dress(["Time (s)", *names], table))


def assert_same(channel, time, values, rtol=ULPS):
    if np.isnan(values).all():
        return
    np.testing.assert_array_equal(channel.time, time)
    np.testing.assert_allclose(channel.values, values, rtol=rtol)


@SETTINGS
@given(stands())
def test_thrust_stand(write, case):
    time, values, unit, text = case
    log = load(write(text), static=False)
    factor = {"N": 1.0, "gf": 9.80665e-3, "kgf": 9.80665, "RPM": RPM, "rad/s": 1.0}
    assert log["command"].unit == ("us" if unit["ESC signal"] else "dshot")
    assert_same(log["command"], time, values["ESC signal"])
    if "thrust" in log.channels:
        assert_same(log["thrust"], time, values["Thrust"] * factor[unit["Thrust"]])
    else:
        assert np.isnan(values["Thrust"]).all()
    if "speed" in log.channels:
        speed = values["Motor Optical Speed"] * factor[unit["Motor Optical Speed"]]
        assert_same(log["speed"], time, speed)
    if "torque" in log.channels:
        assert_same(log["torque"], time, values["Torque (N·m)"])


CELL = {
    "command": ["Command (us)", "command [µs]", "Cmd_us"],
    "speed": ["Speed (rad/s)", "Rotor speed [rad/s]", "speed_rad_s"],
    "force_x": ["Fx (N)", "Force x [N]"],
    "thrust": ["Fz (N)", "force_z_N", "Fz [N]"],
    "torque": ["Mz (N·m)", "Tz (N*m)", "Mz_Nm", "moment z [N.m]"],
}


@st.composite
def cells(draw):
    time = draw(clocks(step=(1e-4, 2e-4)))
    chosen = ["thrust", *draw(st.lists(st.sampled_from(sorted(set(CELL) - {"thrust"})), unique=True))]
    values = {name: draw(columns(time.size)) for name in chosen}
    labels = {name: draw(st.sampled_from(CELL[name])) for name in chosen}
    order = draw(st.permutations(["time", *chosen]))
    names = [labels.get(name, "Time (s)") for name in order]
    table = np.column_stack([values.get(name, time) for name in order])
    return time, values, draw(dress(names, table))


@SETTINGS
@given(cells())
def test_load_cell_csv(write, case):
    time, values, text = case
    log = load(write(text), format="load-cell-csv")
    for name, expected in values.items():
        if not np.isnan(expected).all():
            assert_same(log[name], time, expected)
        elif name != "command":
            assert name not in log.channels


@SETTINGS
@given(
    values=st.dictionaries(st.sampled_from(["Fz", "Mz", "Fx"]), columns(12), min_size=1),
    rate=st.sampled_from([1000.0, 10000.0, 12345.678]),
    start=st.sampled_from([None, 0.0, 41.5]),
    by_time=st.booleans(),
    group=st.sampled_from(["", "cell/"]),
    kind=st.sampled_from(["f8", "f4"]),
    shape=st.sampled_from([(12,), (12, 1), (1, 12)]),
)
def test_load_cell_hdf5(tmp_path, values, rate, start, by_time, group, kind, shape):
    path = tmp_path / "cell.h5"
    time = (start or 0.0) + np.arange(12) / rate
    with h5py.File(path, "w") as file:
        for name, numbers in values.items():
            data = file.create_dataset(group + name, data=numbers.astype(kind).reshape(shape))
            data.attrs["unit"] = "N·m" if name.startswith("M") else "N"
        if by_time:
            file[group + "time"] = time
            file[group + "time"].attrs["unit"] = "s"
        else:
            file.attrs["rate"] = rate
            if start is not None:
                file.attrs["start"] = start
    if not set(values) & {"Fz", "Mz"}:
        return
    log = load(path)
    for name, channel in {"Fz": "thrust", "Mz": "torque", "Fx": "force_x"}.items():
        if name in values:
            np.testing.assert_array_equal(log[channel].time, time)
            np.testing.assert_array_equal(log[channel].values, values[name].astype(kind).astype(float))


@st.composite
def turns(draw, count, gaps=True):
    """Return unit quaternions in steps of less than half a turn: of one sign, as written, and lost rows."""
    seed = draw(st.integers(0, 2**32 - 1))
    random = np.random.default_rng(seed)
    q = quaternions_of(small_turns(random, count))
    continuous = q.copy()
    for i in range(1, count):
        continuous[i] *= np.sign(continuous[i] @ continuous[i - 1])
    flips = random.choice([-1.0, 1.0], count)
    lost = random.uniform(size=count) < (0.3 if gaps else 0.0)
    return continuous, continuous * flips[:, None], lost


MOTIVE_TURNS = ["Quaternion", "XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"]


@st.composite
def takes(draw):
    count = draw(st.integers(2, 20))
    first = draw(st.integers(0, 100000))
    skipped = np.array(draw(st.lists(st.integers(1, 3), min_size=count, max_size=count)))
    frames = first + np.cumsum(skipped)
    rate = draw(st.sampled_from([100.0, 120.0, 200.0, 240.0, 360.0]))
    unit, scale, digits = draw(
        st.sampled_from([("Meters", 1.0, 9), ("Millimeters", 1e3, 6), ("Centimeters", 1e2, 7)])
    )
    rotation = draw(st.sampled_from(MOTIVE_TURNS))
    version = draw(st.sampled_from(["1.21", "1.22", "1.23", "1.24", "1.25"]))
    bodies = {}
    for name in draw(st.sampled_from([["quad"], ["quad", "board"], ["b 2", "quad"]])):
        place = draw(st.integers(0, 2**32 - 1))
        bodies[name] = (np.random.default_rng(place).uniform(-3, 3, (count, 3)), *draw(turns(count)))
    axes = "XYZW" if rotation == "Quaternion" else "XYZ"
    width = len(axes) + 4
    decimals = [12] * len(axes) + [digits] * 4
    cells = [[str(f), f"{f / rate:.{3 if version == '1.23' else 6}f}"] for f in frames]
    for position, _, written, lost in bodies.values():
        angles = np.roll(written, -1, axis=1)
        if rotation != "Quaternion":
            turned = Rotation.from_quat(angles).as_euler(rotation, degrees=True)
            angles = turned[:, [rotation.index(axis) for axis in "XYZ"]]
        block = np.column_stack([angles, position * scale, np.full(count, 1e-4)])
        for row, numbers, gone in zip(cells, block, lost, strict=True):
            row += [""] * width if gone else [f"{x:.{n}f}" for x, n in zip(numbers, decimals, strict=True)]
    labels = [("Type", "Rigid Body"), ("Name", None), ("ID", '"AB12"')]
    labels += [("Parent", '"0"')] if version >= "1.24" else []
    lead = version == "1.21"
    head = (
        f"Format Version,{version},Take Name,a, b,Capture Frame Rate,{rate:.6f},Export Frame Rate,{rate:.6f},"
        f"Capture Start Time,2023-03-29 06.23.40.520 下午,Rotation Type,{rotation},Length Units,{unit},"
        "Coordinate Space,Global"
    )
    rows = [[head], []]
    rows += [["", "" if lead else k, *(v or n for n in bodies for _ in range(width))] for k, v in labels]
    parts = ["Rotation"] * len(axes) + ["Position"] * 3 + ["Mean Marker Error"]
    rows += [["", "", *parts * len(bodies)]]
    rows += [
        ["Frame", "Time" if lead else "Time (Seconds)", *[*axes, "X", "Y", "Z", ""] * len(bodies)],
        *cells,
    ]
    end = draw(st.sampled_from(["\n", "\r\n"]))
    text = "".join(",".join(row) + end for row in rows)
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]))
    return frames / rate, bodies, digits, scale, text.encode(encoding)


@SETTINGS
@given(takes())
def test_motive(write, case):
    time, bodies, digits, scale, text = case
    log = load(write(text))
    assert log.rigid_bodies == tuple(bodies)
    for name, (position, continuous, _, lost) in bodies.items():
        np.testing.assert_array_equal(log[f"{name}/position"].time, time)
        np.testing.assert_array_equal(log[f"{name}/position"].valid, ~lost)
        # Written to `digits` decimals of the file's unit: half of the last one.
        got = log[f"{name}/position"].values[~lost]
        np.testing.assert_allclose(got, position[~lost], atol=0.51 * 10.0**-digits / scale + 1e-15)
        # Twelve decimals of a quaternion or an angle; the last is squared away in a dot product, but not its
        # rounding.
        assert_turns(log[f"{name}/orientation"], continuous, lost, 1e-12)


@st.composite
def pose_tables(draw):
    time = draw(clocks(step=(1e-3, 0.04)))
    continuous, written, lost = draw(turns(time.size))
    position = np.column_stack([draw(columns(time.size, st.floats(-5, 5))) for _ in range(3)])
    unit, factor = draw(st.sampled_from([("m", 1.0), ("mm", 1e-3), ("cm", 1e-2)]))
    form = draw(st.sampled_from(["{} [{}]", "{} ({})", "{}_{}", "p{}_{}", "{}"]))
    order = draw(st.sampled_from(["wxyz", "xyzw"]))
    numbered = draw(st.booleans())
    options = {"length_unit": unit} if form == "{}" else {}
    if numbered:
        options["quaternion_order"] = order
    place_names = [form.format(axis, unit) if "{}" in form[2:] else axis for axis in "xyz"]
    turn_names = [f"q{i if numbered else axis}" for i, axis in enumerate(order)]
    first = draw(st.booleans())
    shown = written[:, ["wxyz".index(axis) for axis in order]]
    shown = np.where(lost[:, None], np.nan, shown)
    blocks = [(turn_names, shown), (place_names, position)][:: 1 if first else -1]
    names = ["t_s", *blocks[0][0], *blocks[1][0]]
    table = np.column_stack([time, blocks[0][1], blocks[1][1]])
    return time, position * factor, continuous, lost, options, draw(dress(names, table))


@SETTINGS
@given(pose_tables())
def test_pose_table(write, case):
    time, position, continuous, lost, options, text = case
    log = load(write(text), **options)
    np.testing.assert_array_equal(log["body/position"].time, time)
    np.testing.assert_allclose(log["body/position"].values, position, rtol=ULPS)
    assert_turns(log["body/orientation"], continuous, lost, 1e-14)


@pytest.mark.parametrize("dialect", ["spaces", "quoted", "utf-16"])
def test_memory_above_the_imports_is_no_more_than_five_times_the_arrays(tmp_path, dialect):
    """Ten seconds at 10 kHz in 8 columns, read in a process whose peak is that of this load alone."""
    script = Path(__file__).parents[1] / "benchmarks" / "loaders.py"
    out = tmp_path / "found.json"
    options = ["--rows", "100000", "--dialects", dialect, "--json", str(out)]
    subprocess.run([sys.executable, str(script), *options], check=True, capture_output=True)
    (entry,) = json.loads(out.read_text(encoding="utf-8"))
    assert entry["rows"] == 100_000
    # The text is itself 1.4 times the arrays, 2.7 in UTF-16.
    assert 1 < entry["memory"] <= 5
