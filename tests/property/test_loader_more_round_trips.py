"""Random valid logs of the formats with headers of their own read back equal to what was written in them."""

import h5py
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from fakes.log_files import LBF, LBF_IN, assert_turns, examples, notes, quaternions_of, small_turns
from fakes.log_files import tdms as write_tdms
from sysid.loaders import load

SETTINGS = examples(30)
SEEDS = st.integers(0, 2**32 - 1)
# How the lines of a text log end, and its encoding.
ENDS = st.tuples(st.sampled_from(["\n", "\r\n", "\r"]), st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]))


def write(tmp_path, lines, dress):
    end, encoding = dress
    path = tmp_path / "log.txt"
    path.write_bytes((end.join([*lines, ""])).encode(encoding))
    return path


def assert_poses(log, name, time, place, turns, lost, atol):
    np.testing.assert_allclose(log[f"{name}/position"].time, time, rtol=1e-14)
    # The places are written to nine decimals of a millimetre or more.
    np.testing.assert_allclose(log[f"{name}/position"].values[~lost], place[~lost], atol=1e-12)
    assert_turns(log[f"{name}/orientation"], quaternions_of(turns), lost, atol)


@SETTINGS
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
    log = load(write(tmp_path, lines, end))
    channels = {"Fz": "thrust", "Speed": "speed", "Mz": "torque"}
    for i, name in enumerate(names):
        np.testing.assert_array_equal(log[channels[name]].values, values[:, i])
        # X0 + i · step against i / (1 / step): two roundings.
        np.testing.assert_allclose(log[channels[name]].time, time, rtol=1e-14)


@SETTINGS
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
    log = load(write(tmp_path, lines, end), **options)
    assert_poses(log, "quad", (np.arange(count) + 5) / 100, place, turns, lost, 1e-9)
    np.testing.assert_allclose(log["board:a/position"].time, (np.arange(count) + 1) / 200, rtol=1e-14)
    np.testing.assert_array_equal(log["board:a/position"].valid, ~hidden)
    np.testing.assert_allclose(log["board:a/position"].values[~hidden], marker[~hidden], atol=1e-13)


@SETTINGS
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
    log = load(write(tmp_path, lines, end))
    assert log.rigid_bodies == tuple(bodies)
    for name in bodies:
        # The matrix has nine decimals.
        assert_poses(log, name, np.arange(count) / 250, place[name], turns[name], lost[name], 1e-8)
        np.testing.assert_allclose(log[f"{name}/residual"].values[~lost[name]], 0.5e-3, rtol=1e-12)


@SETTINGS
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
    log = load(write(tmp_path, lines, end))
    for k, name in enumerate(names):
        channel = log[f"{name}/position"]
        np.testing.assert_allclose(channel.time, np.arange(count) / 100, atol=1e-12)
        np.testing.assert_array_equal(channel.valid, ~hidden[:, k])
        np.testing.assert_allclose(channel.values[~hidden[:, k]], points[~hidden[:, k], k], atol=1e-11)


@SETTINGS
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
    log = load(write(tmp_path, lines, end), clock=clock)
    wanted = (stamps + (700_000 if clock == "arrival" else 0)) * 1e-9
    # 1.5e9 s in double precision resolves 0.24 µs.
    np.testing.assert_allclose(log["body/position"].time, wanted, rtol=0, atol=5e-7)
    np.testing.assert_array_equal(log["body/position"].values, place)
    assert_turns(log["body/orientation"], quaternions_of(turns), np.zeros(count, dtype=bool), 1e-14)


@SETTINGS
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
    log = load(write(tmp_path, lines, end))
    np.testing.assert_allclose(log["thrust"].time, (sequence - sequence[0]) / 7000, rtol=1e-14)
    np.testing.assert_allclose(log["thrust"].values, counts[:, 2] * 1e-6 * to_newton, rtol=1e-13)
    np.testing.assert_allclose(log["torque"].values, counts[:, 5] * 0.5e-6 * to_newton_metre, rtol=1e-13)
    lost = int(sequence[-1] - sequence[0]) + 1 - count
    assert (f"packets lost, left as holes: {lost}" in notes(log)) == (lost > 0)


@SETTINGS
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
    log = load(write(tmp_path, lines, end), format="ati-text", **options)
    wanted = time if form in ("time", "numbered") else np.arange(count) / 150
    np.testing.assert_allclose(log["thrust"].time, wanted, rtol=1e-14)
    np.testing.assert_allclose(log["force_x"].values, load_6[:, 0] * LBF, rtol=1e-12)
    np.testing.assert_allclose(log["torque"].values, load_6[:, 5] * LBF_IN, rtol=1e-12)


@SETTINGS
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
    log = load(write(tmp_path, lines, ("\n", "utf-8")), length_unit="m")
    np.testing.assert_array_equal(log["body/position"].values, place)
    np.testing.assert_array_equal(log["body/position"].time, time)
    assert_turns(log["body/orientation"], quaternions_of(turns), np.zeros(count, dtype=bool), 1e-14)


@SETTINGS
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


@SETTINGS
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
