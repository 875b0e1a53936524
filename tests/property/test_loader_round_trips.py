"""Random valid logs of each format read back equal to what was written in them."""

from itertools import pairwise

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fakes.log_files import LBF, LBF_IN, assert_turns, examples, notes, quaternions_of, small_turns
from sysid.loaders import load, table

SETTINGS, FEWER = examples(60), examples(30)


@pytest.fixture(autouse=True, params=[-1, table._SMALL], ids=["by-engine", "by-line"])
def both_ways(request, monkeypatch):
    """A table is parsed by the engine, and line by line as small tables are."""
    monkeypatch.setattr(table, "_SMALL", request.param)


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
        # A command without a unit begins at rest, from 700 on it could be a pulse width; up to 100, percent.
        "ESC signal": np.array([0, *(draw(st.integers(101, 2000)) for _ in time[1:])], dtype=float),
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


SEEDS = st.integers(0, 2**32 - 1)
# How the lines of a text log end, and its encoding.
ENDS = st.tuples(st.sampled_from(["\n", "\r\n", "\r"]), st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]))


def write_lines(tmp_path, lines, dress):
    end, encoding = dress
    path = tmp_path / "log.txt"
    path.write_bytes((end.join([*lines, ""])).encode(encoding))
    return path


def assert_poses(log, name, time, place, turns, lost, atol):
    np.testing.assert_allclose(log[f"{name}/position"].time, time, rtol=1e-14)
    # The places are written to nine decimals of a millimetre or more.
    np.testing.assert_allclose(log[f"{name}/position"].values[~lost], place[~lost], atol=1e-12)
    assert_turns(log[f"{name}/orientation"], quaternions_of(turns), lost, atol)


@FEWER
@given(SEEDS, ENDS, st.sampled_from(["No", "One", "Multi"]), st.sampled_from([".", ","]), st.booleans())
def test_lvm(tmp_path, seed, end, times, decimal, comments):
    random = np.random.default_rng(seed)
    count, step = int(random.integers(2, 30)), float(random.choice([1e-4, 0.001, 1 / 1024]))
    names = ["Fz", "Speed", "Mz"][: int(random.integers(1, 4))]
    units = {"Fz": "N", "Speed": "rad/s", "Mz": "N*m"}
    values = random.normal(size=(count, len(names))) * 100
    time = 0.5 + np.arange(count) * step

    def text(x):
        return repr(float(x)).replace(".", decimal)

    def row(key, cells):
        return "\t".join([key, *(("\t".join([c, ""]) if times == "Multi" else c) for c in cells)])

    lines = ["LabVIEW Measurement", "Separator\tTab", f"Decimal_Separator\t{decimal}", f"X_Columns\t{times}",
             "***End_of_Header***", "", row("Channels", [str(len(names))]),
             row("Samples", ["9"] * len(names)),
             row("Y_Unit_Label", [units[name] for name in names]), row("X0", [text(0.5)] * len(names)),
             row("Delta_X", [text(step)] * len(names)), "***End_of_Header***"]  # fmt: skip
    if times == "Multi":
        lines.append("\t".join([*(f"X_Value\t{name}" for name in names), "Comment"]))
        rows = zip(time, values, strict=True)
        lines += ["\t".join(f"{text(t)}\t{text(x)}" for x in cells) for t, cells in rows]
    else:
        lines.append("\t".join(["X_Value", *names, "Comment"]))
        first = [text(t) if times == "One" else "" for t in time]
        lines += ["\t".join([t, *map(text, rows)]) for t, rows in zip(first, values, strict=True)]
    if comments:
        lines[-1] += "\tLOST COMMUNICATION"
    log = load(write_lines(tmp_path, lines, end))
    channels = {"Fz": "thrust", "Speed": "speed", "Mz": "torque"}
    for i, name in enumerate(names):
        np.testing.assert_array_equal(log[channels[name]].values, values[:, i])
        # X0 + i · step against i / (1 / step): two roundings.
        np.testing.assert_allclose(log[channels[name]].time, time, rtol=1e-14)


@FEWER
@given(SEEDS, ENDS, st.sampled_from([",", ";"]), st.sampled_from(["quaternion", "helical", "XYZ", "ZYX"]))
def test_vicon_objects_and_trajectories(tmp_path, seed, end, delimiter, angles):
    random = np.random.default_rng(seed)
    count = int(random.integers(3, 20))
    turns = small_turns(random, count)
    place = random.uniform(-2, 2, (count, 3))
    lost = random.uniform(size=count) < 0.2
    lost[: count // 2 + 1] = False
    marker = random.uniform(-2, 2, (count, 3))
    hidden = random.uniform(size=count) < 0.3
    hidden[0] = False

    def text(x):
        shown = f"{x:.10f}"
        return shown.replace(".", ",") if delimiter == ";" else shown

    def head(*cells):
        return delimiter.join(["", "", *cells])

    def body(cells, gone):
        return delimiter.join([""] * len(cells) if gone else map(text, cells))

    whole, euler = angles == "quaternion", angles in ("XYZ", "ZYX")
    turned = {
        "quaternion": lambda turn: turn.as_quat() * random.choice([-1, 1]),
        "helical": lambda turn: turn.as_rotvec(),
    }.get(angles, lambda turn: turn.as_euler(angles, degrees=True)[[angles.index(axis) for axis in "XYZ"]])
    label = "quad" if euler else f"Global Angle {'(Quaternion) ' * whole}quad:quad"
    fields = ["RX", "RY", "RZ", *["RW"] * whole, "TX", "TY", "TZ"]
    unit = [""] * 4 if whole else ["deg" if euler else "rad"] * 3
    lines = ["Segments" if euler else "Objects", "100", head(label, *[""] * (len(fields) - 1)),
             delimiter.join(["Frame", "Sub Frame", *fields]), head(*unit, "mm", "mm", "mm")]  # fmt: skip
    for i, turn in enumerate(turns):
        row = body([*turned(turn), *(1e3 * place[i])], lost[i])
        lines.append(delimiter.join([str(i + 5), "0", row]))
    lines += ["", "Trajectories", "200", head("board:a", "", ""),
              delimiter.join(["Frame", "Sub Frame", "X", "Y", "Z"]), head("mm", "mm", "mm")]  # fmt: skip
    lines += [delimiter.join([str(i + 1), "0", body(1e3 * marker[i], hidden[i])]) for i in range(count)]
    options = {"angles": angles} if euler else {}
    log = load(write_lines(tmp_path, lines, end), **options)
    assert_poses(log, "quad", (np.arange(count) + 5) / 100, place, turns, lost, 1e-9)
    np.testing.assert_allclose(log["board:a/position"].time, (np.arange(count) + 1) / 200, rtol=1e-14)
    np.testing.assert_array_equal(log["board:a/position"].valid, ~hidden)
    np.testing.assert_allclose(log["board:a/position"].values[~hidden], marker[~hidden], atol=1e-13)


@FEWER
@given(SEEDS, ENDS, st.booleans(), st.booleans())
def test_qualisys_6d(tmp_path, seed, end, named, clocked):
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 15))
    bodies = ["quad", "board"][: int(random.integers(1, 3))]
    turns = {name: small_turns(random, count) for name in bodies}
    place = {name: random.uniform(-2, 2, (count, 3)) for name in bodies}
    lost = {name: random.uniform(size=count) < 0.2 for name in bodies}
    lines = [f"NO_OF_FRAMES\t{count}", f"NO_OF_BODIES\t{len(bodies)}", "FREQUENCY\t250", "DATA_INCLUDED\t6D"]
    lines += ["BODY_NAMES\t" + "\t".join(bodies)]
    fields = ["X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{i}]" for i in range(9))]
    if named:
        head = ["Frame", "Time"] if clocked else []
        lines.append(
            "\t".join([*head, *(f"{name} {f}" if f == "X" else f for name in bodies for f in fields), ""])
        )
    for i in range(count):
        row = [str(i + 1), f"{i / 250:.5f}"] if clocked else []
        for name in bodies:
            numbers = [*(1e3 * place[name][i]), 1, 2, 3, 0.5, *turns[name][i].as_matrix().T.ravel()]
            row += [f"{x:.9f}" for x in (np.zeros(16) if lost[name][i] else numbers)]
        lines.append("\t".join(row) + "\t")
    log = load(write_lines(tmp_path, lines, end))
    assert log.rigid_bodies == tuple(bodies)
    for name in bodies:
        # The matrix has nine decimals.
        assert_poses(log, name, np.arange(count) / 250, place[name], turns[name], lost[name], 1e-8)
        np.testing.assert_allclose(log[f"{name}/residual"].values[~lost[name]], 0.5e-3, rtol=1e-12)


@FEWER
@given(SEEDS, ENDS)
def test_qualisys_3d(tmp_path, seed, end):
    random = np.random.default_rng(seed)
    count, names = int(random.integers(2, 12)), ["a 1", "b"]
    points = random.uniform(-3, 3, (count, 2, 3))
    hidden = random.uniform(size=(count, 2)) < 0.3
    hidden[0] = False
    lines = [f"NO_OF_FRAMES\t{count}", "NO_OF_MARKERS\t2", "FREQUENCY\t100", "DATA_INCLUDED\t3D"]
    lines += ["MARKER_NAMES\t" + "\t".join(names), "TRAJECTORY_TYPES\tMeasured\tMeasured"]
    for i in range(count):
        shown = [["", "", ""] if hidden[i, k] else [f"{1e3 * x:.9f}" for x in points[i, k]] for k in range(2)]
        lines.append("\t".join([*shown[0], *shown[1]]))
    log = load(write_lines(tmp_path, lines, end))
    for k, name in enumerate(names):
        channel = log[f"{name}/position"]
        np.testing.assert_allclose(channel.time, np.arange(count) / 100, atol=1e-12)
        np.testing.assert_array_equal(channel.valid, ~hidden[:, k])
        np.testing.assert_allclose(channel.values[~hidden[:, k]], points[~hidden[:, k], k], atol=1e-11)


@FEWER
@given(SEEDS, ENDS, st.sampled_from(["header", "arrival"]), st.sampled_from(["pose", "pose.pose"]))
def test_ros_csv(tmp_path, seed, end, clock, field):
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 20))
    turns = small_turns(random, count)
    place = random.uniform(-5, 5, (count, 3))
    stamps = 1538000000123456789 + np.cumsum(random.integers(1_000_000, 20_000_000, count))
    names = ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id"]
    names += [f"field.{field}.position.{axis}" for axis in "xyz"]
    names += [f"field.{field}.orientation.{axis}" for axis in "xyzw"]
    lines = [",".join(names)]
    for i in range(count):
        cells = [*map(repr, map(float, place[i])), *map(repr, map(float, turns[i].as_quat()))]
        lines.append(",".join([str(stamps[i] + 700_000), str(i), str(stamps[i]), "world", *cells]))
    log = load(write_lines(tmp_path, lines, end), clock=clock)
    wanted = (stamps + (700_000 if clock == "arrival" else 0)) * 1e-9
    # 1.5e9 s in double precision resolves 0.24 µs.
    np.testing.assert_allclose(log["body/position"].time, wanted, rtol=0, atol=5e-7)
    np.testing.assert_array_equal(log["body/position"].values, place)
    assert_turns(log["body/orientation"], quaternions_of(turns), np.zeros(count, dtype=bool), 1e-14)


@FEWER
@given(SEEDS, ENDS, st.sampled_from([("N", "Nm", 1.0, 1.0), ("lbf", "lbf-in", LBF, LBF_IN)]))
def test_net_ft_counts_and_lost_packets(tmp_path, seed, end, units):
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 30))
    counts = random.integers(-(10**7), 10**7, (count, 6))
    sequence = 1000 + np.cumsum(random.integers(1, 4, count))
    force, torque, to_newton, to_newton_metre = units
    lines = [
        "Start Time: 3/4/24", "RDT Sample Rate: 7000", f"Force Units: {force}",
        "Counts per Unit Force: 1000000.0",
        f"Torque Units: {torque}", "Counts per Unit Torque: 2000000.0",
        "Status (hex), RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time",
    ]  # fmt: skip
    lines += [
        f"0, {sequence[i]}, {8 * sequence[i]}, {', '.join(map(str, counts[i]))}, 1:02:03 PM"
        for i in range(count)
    ]
    log = load(write_lines(tmp_path, lines, end))
    np.testing.assert_allclose(log["thrust"].time, (sequence - sequence[0]) / 7000, rtol=1e-14)
    np.testing.assert_allclose(log["thrust"].values, counts[:, 2] * 1e-6 * to_newton, rtol=1e-13)
    np.testing.assert_allclose(log["torque"].values, counts[:, 5] * 0.5e-6 * to_newton_metre, rtol=1e-13)
    lost = int(sequence[-1] - sequence[0]) + 1 - count
    assert (f"packets lost, left as holes: {lost}" in notes(log)) == (lost > 0)


@FEWER
@given(SEEDS, ENDS, st.sampled_from(["stated", "time", "numbered", "printed"]))
def test_ati_text(tmp_path, seed, end, form):
    random = np.random.default_rng(seed)
    count = int(random.integers(4, 30))
    load_6 = random.normal(size=(count, 6))
    time = 19.2 + np.cumsum(random.uniform(0.009, 0.011, count))
    lines, options = [], {"units": {"force": "lbf", "torque": "lbf-in"}}
    mark = str(random.choice([",", ";", "\t", " "])) if form == "time" else ","
    if form == "stated":
        lines = ["First line indicates sampling freq [Hz], samples per channel, QTimer [ms] ,,,"]
        lines += ["Fx, Fy, Fz, Mz, My, Mz ", "150,75,500,0,0,"]
    elif form == "numbered":
        lines = [",".join(f"Column{i + 1}" for i in range(7))]
    elif form == "printed":
        options["rate"] = 150
    for i in range(count):
        cells = [repr(float(x)) for x in load_6[i]]
        if form in ("time", "numbered"):
            cells.insert(0, repr(float(time[i])))
        lines.append("[ " + "  ".join(cells) + "]" if form == "printed" else mark.join(cells))
    log = load(write_lines(tmp_path, lines, end), format="ati-text", **options)
    wanted = time if form in ("time", "numbered") else np.arange(count) / 150
    np.testing.assert_allclose(log["thrust"].time, wanted, rtol=1e-14)
    np.testing.assert_allclose(log["force_x"].values, load_6[:, 0] * LBF, rtol=1e-12)
    np.testing.assert_allclose(log["torque"].values, load_6[:, 5] * LBF_IN, rtol=1e-12)


@FEWER
@given(SEEDS, st.sampled_from(["  ", " ", "\t "]), st.booleans())
def test_tables_parted_by_spaces(tmp_path, seed, gap, led):
    random = np.random.default_rng(seed)
    count = int(random.integers(2, 20))
    turns = small_turns(random, count)
    place = random.normal(size=(count, 3))
    time = 1.5e9 + np.arange(count) * 0.01
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for i in range(count):
        cells = [time[i], *place[i], *turns[i].as_quat()]
        lines.append((gap if led else "") + gap.join(repr(float(x)) for x in cells))
    log = load(write_lines(tmp_path, lines, ("\n", "utf-8")), length_unit="m")
    np.testing.assert_array_equal(log["body/position"].values, place)
    np.testing.assert_array_equal(log["body/position"].time, time)
    assert_turns(log["body/orientation"], quaternions_of(turns), np.zeros(count, dtype=bool), 1e-14)
