"""Damaged logs end in a recording that holds nothing but what the file says, or in one sentence; "
"never a traceback."""

import io
import re
import time as clock
import warnings

import h5py
import numpy as np
import pytest

from sysid.errors import SysidError
from sysid.loaders import load

QUICK, MANY = 80, 5000
# Far above any load of these 40-row logs (some ms): only a hang reaches it.
HANG = 5.0


def stand():
    random = np.random.default_rng(1)
    names = "Time (s),ESC signal (µs),Servo 1 (µs),Torque (N·m),Thrust (gf),Motor Optical Speed (rad/s),"
    rows = []
    for i, (x, y, z) in enumerate(random.normal(size=(40, 3)) * 100 + 500):
        thrust, message = ("", "") if i % 3 else (f"{y:.9f}", '"late, sample"')
        rows.append(f"{i * 0.012:.6f},{1000 + 10 * i},,{x:.9f},{thrust},{abs(z):.6f},{message},")
    lines = ["\ufeff" + names + "App message,", *rows, "# fitted by hand", "# tau: 0.027", ""]
    return "\r\n".join(lines).encode("utf-8")


def cell():
    rows = ["Time (s),Command (us),Speed (rad/s),Fz (N),Mz (N·m)"]
    for i, (a, b, c) in enumerate(np.random.default_rng(2).normal(size=(40, 3))):
        rows.append(f"{i * 1e-4:.4f},{1500 + i},{a:.4f},{b:.6f},{c:.8f}")
    return "\n".join([*rows, ""]).encode("utf-8")


def motive():
    random = np.random.default_rng(3)
    parts = ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error"
    out = [
        "Format Version,1.23,Take Name,drop,Capture Frame Rate,200.000000,Export Frame Rate,200.000000,"
        "Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global",
        "",
        ",Type" + ",Rigid Body" * 8 + ",Marker" * 3,
        ",Name" + ",quad" * 8 + ",board" * 3,
        ",ID" + ',"AB"' * 8 + ",CD" * 3,
        parts + ",Position" * 3,
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z",
    ]
    for i in range(40):
        place = ",".join(f"{x:.6f}" for x in random.normal(size=3) * 1000)
        pose = f"0.600000,0.000000,0.000000,{-0.8 if i % 7 else 0.8:.6f},{place},0.000210"
        out.append(f"{i},{i / 200:.6f},{pose if i % 5 else ',' * 7},{place}")
    return "\r\n".join([*out, ""]).encode("utf-8")


def pose():
    rows = ["t,x_m,y_m,z_m,qx,qy,qz,qw"]
    for i, (x, y, z) in enumerate(np.random.default_rng(4).normal(size=(40, 3))):
        rows.append(f"{1.7e9 + i * 0.01:.4f},{x:.6f},{y:.6f},{z:.6f},0.6,0,0,0.8")
    return "\n".join([*rows, ""]).encode("utf-8")


def cell_hdf5():
    stream = io.BytesIO()
    random = np.random.default_rng(5)
    with h5py.File(stream, "w") as file:
        file.attrs["rate"] = 10000.0
        for name, unit in {"Command": "us", "Speed": "rad/s", "Fz": "N", "Mz": "N·m"}.items():
            data = file.create_dataset(name, data=random.normal(size=200), compression="gzip", chunks=(50,))
            data.attrs["unit"] = unit
    return stream.getvalue()


def lvm():
    lines = [
        "LabVIEW Measurement", "Writer_Version\t2", "Separator\tTab", "Decimal_Separator\t.",
        "X_Columns\tOne", "Date\t2024/01/02", "Time\t09:00:00.0", "***End_of_Header***", "",
        "Channels\t3\t\t\t", "Samples\t40\t40\t40\t", "Y_Unit_Label\tus\tNewtons\tN*m\t",
        "X0\t0.0\t0.0\t0.0\t", "Delta_X\t0.001\t0.001\t0.001\t", "***End_of_Header***\t\t\t\t",
        "X_Value\tCommand\tFz\tMz\tComment",
    ]  # fmt: skip
    for i, (a, b) in enumerate(np.random.default_rng(5).normal(size=(40, 2))):
        lines.append(f"{i * 0.001:.6f}\t{1000 + i}\t{a:.6f}\t{b:.8f}" + ("\tLOST" if i % 9 == 4 else ""))
    return "\n".join([*lines, ""]).encode("utf-8")


def vicon():
    random = np.random.default_rng(6)
    lines = ["Objects,", "100,", ",,Global Angle (Quaternion) quad:quad,,,,,,,"]
    lines += ["Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ,", ",,,,,,mm,mm,mm,"]
    for i in range(40):
        place = ",".join(f"{x:.4f}" for x in random.normal(size=3) * 1000)
        lines.append(f"{i + 1},0," + (f"0.6,0,0,0.8,{place}," if i % 5 else ""))
    lines += ["", "Trajectories,", "100,", ",,board:1,,,board:2,,,"]
    lines += ["Frame,Sub Frame,X,Y,Z,X,Y,Z,", ",,mm,mm,mm,mm,mm,mm,"]
    for i in range(40):
        place = ",".join(f"{x:.4f}" for x in random.normal(size=6) * 1000)
        lines.append(f"{i + 1},0,{place if i % 7 else ',,,,,'},")
    return "\r\n".join([*lines, ""]).encode("utf-8")


def qualisys():
    from scipy.spatial.transform import Rotation

    lines = [
        "NO_OF_FRAMES\t40", "NO_OF_CAMERAS\t8", "NO_OF_BODIES\t1", "FREQUENCY\t200",
        "TIME_STAMP\t2026-01-19, 10:19:43.755\t2063631.96", "DATA_INCLUDED\t6D", "BODY_NAMES\tquad",
        "Frame\tTime\tquad X\tY\tZ\tRoll\tPitch\tYaw\tResidual\t"
        + "\t".join(f"Rot[{i}]" for i in range(9)) + "\t",
    ]  # fmt: skip
    turns = Rotation.from_rotvec(np.random.default_rng(7).normal(size=(40, 3))).as_matrix()
    for i, matrix in enumerate(turns):
        cells = [i * 10.5, 2.0, 3.0, 0, 0, 0, 0.3, *matrix.T.ravel()] if i % 6 else [0.0] * 16
        lines.append(f"{i + 1}\t{i / 200:.5f}\t" + "\t".join(f"{x:.6f}" for x in cells) + "\t")
    return "\r\n".join([*lines, ""]).encode("utf-8")


def legacy():
    lines = ['comment,"OptiTrack Export Data"', "righthanded", "info,version,1.1", "info,framecount,40"]
    for i, place in enumerate(np.random.default_rng(8).normal(size=(40, 9))):
        x = [f"{one:.6f}" for one in place]
        markers = [f"{x[3 * k]},{x[3 * k + 1]},{x[3 * k + 2]},{k},M{k}" for k in range(i % 4)]
        body = f"1,{x[0]},{x[1]},{x[2]},0,0,0.6,0.8,0,0,73.7"
        lines.append(",".join([f"frame,{i},{i / 120:.8f},1", body, str(len(markers)), *markers]))
    return "\r\n".join([*lines, ""]).encode("utf-8")


def ros():
    names = "%time,field.header.seq,field.header.stamp,field.header.frame_id"
    names += "".join(f",field.pose.position.{axis}" for axis in "xyz")
    names += "".join(f",field.pose.orientation.{axis}" for axis in "xyzw")
    lines = [names]
    for i, (x, y, z) in enumerate(np.random.default_rng(9).normal(size=(40, 3))):
        stamp = 1538000000123456789 + i * 10_000_000
        lines.append(f"{stamp + 300_000},{i},{stamp},world,{x:.6f},{y:.6f},{z:.6f},0.0,0.6,0.0,0.8")
    return "\n".join([*lines, ""]).encode("utf-8")


def net_ft():
    lines = [
        "Start Time: 1/2/24 3:04 PM", "RDT Sample Rate: 1000", "Force Units: N",
        "Counts per Unit Force: 1000000.0", "Torque Units: Nm", "Counts per Unit Torque: 1000000.0",
        "Status (hex), RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time",
    ]  # fmt: skip
    for i, row in enumerate(np.random.default_rng(10).integers(-(10**7), 10**7, size=(40, 6))):
        counts = ", ".join(str(int(one)) for one in row)
        lines.append(f"0, {500 + i + (i > 20)}, {9000 + 7 * i}, {counts}, 3:04:05.{i:03d} PM")
    return "\n".join([*lines, ""]).encode("utf-8")


def ati():
    lines = ["First line indicates sampling freq [Hz], samples per channel, QTimer [ms] ,,,"]
    lines += ["Fx, Fy, Fz, Mz, My, Mz ", "150,75,500,0,0,"]
    for i, row in enumerate(np.random.default_rng(11).normal(size=(40, 6))):
        lines.append(",".join(f"{x:.6f}" for x in row) if i % 8 != 3 else ",,,,,")
    return "\n".join([*lines, ""]).encode("utf-8")


TEXTS = {
    "rcbenchmark-csv": stand, "load-cell-csv": cell, "motive-csv": motive, "pose-table": pose, "lvm": lvm,
    "vicon-csv": vicon, "qualisys-tsv": qualisys, "motive-legacy": legacy, "ros-csv": ros,
    "net-ft-csv": net_ft, "ati-text": ati,
}  # fmt: skip
# What these logs must be told: their units are not in the file.
OPTIONS = {"ati-text": {"units": {"force": "N", "torque": "N*m"}}}


def cut(data, random):
    return data[: random.integers(0, len(data))]


def flip(data, random):
    changed = bytearray(data)
    for _ in range(random.integers(1, 5)):
        changed[random.integers(0, len(changed))] ^= 1 << random.integers(0, 8)
    return bytes(changed)


def splash(data, random):
    at = int(random.integers(0, len(data)))
    return data[:at] + random.bytes(int(random.integers(1, 30))) + data[at + int(random.integers(0, 30)) :]


def drop_column(data, random):
    lines = data.decode("utf-8").split("\n")
    which = int(random.integers(0, lines[-2].count(",") + 1 if "," in lines[-2] else 6))
    return "\n".join(
        ",".join(c for i, c in enumerate(line.split(",")) if i != which) for line in lines
    ).encode("utf-8")


def shuffle_rows(data, random):
    lines = data.split(b"\n")
    first = int(random.integers(0, len(lines)))
    return b"\n".join(lines[:first] + [lines[i + first] for i in random.permutation(len(lines) - first)])


def drop_or_double_lines(data, random):
    lines = data.split(b"\n")
    return b"\n".join(line for line in lines for _ in range(int(random.integers(0, 3))))


def second_header(data, random):
    lines = data.split(b"\n")
    at = int(random.integers(1, len(lines)))
    return b"\n".join([*lines[:at], *lines[: int(random.integers(1, 8))], *lines[at:]])


def no_rows(data, random):
    return b"\n".join(data.split(b"\n")[: int(random.integers(1, 8))]) + b"\n"


def gigantic_field(data, random):
    at = int(random.integers(0, len(data)))
    filling = [b"9", b"a", b'"', b",", b"\n", b"1,"][int(random.integers(0, 6))]
    return data[:at] + filling * 200_000 + data[at:]


def nul(data, random):
    at = int(random.integers(0, len(data)))
    return data[:at] + b"\0" + data[at:]


def utf16(data, random):
    coding = ["utf-16", "utf-16-le", "utf-16-be"][int(random.integers(0, 3))]
    return data.decode("utf-8").encode(coding)[: len(data) * 2 - int(random.integers(0, 3))]


def other_delimiter(data, random):
    return data.replace(b",", [b";", b"\t", b" ", b"|", b",,"][int(random.integers(0, 5))])


MUTATIONS = [
    cut, flip, splash, drop_column, shuffle_rows, drop_or_double_lines, second_header, no_rows, nul, utf16,
    other_delimiter,
]  # fmt: skip


def outcome(path, format_name, options=None):
    """Load; return the recording or None, having checked the sentence."""
    began = clock.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return load(path, format=format_name, **(options or {}))
        except SysidError as error:
            said = str(error)
            if not said.startswith(str(path)) or "\n" in said or len(said) > 1500:
                raise AssertionError(f"not one short sentence that begins with the file: {said!r}") from error
            return None
        finally:
            assert clock.perf_counter() - began < HANG


def numbers_in(data):
    """Every number that stands in a text, however it is delimited."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16", errors="replace")
    else:
        text = data.decode("utf-8", errors="replace")
    cells = re.split(r'[,;\t\r\n" |]+', text)
    found = set()
    for cell in cells:
        for said in (cell, cell.replace(",", ".")):
            try:
                found.add(float(said))
            except ValueError:
                continue
    return np.array(sorted(found))


# The factor from each channel to the number in the file, where it is one factor for all mutations but unit
# typos.
PLAIN = {"command", "speed", "torque", "force_z"}


def assert_nothing_invented(recording, data):
    """Values of channels whose unit is SI in the file are numbers of the file; a gap is NaN, "
    "never a filler."""
    known = numbers_in(data)
    for name in PLAIN & set(recording.channels):
        values = recording[name].values
        values = values[np.isfinite(values)]
        if values.size and not np.isin(values, known).all():
            # A flipped letter may have changed the unit into another known one: then one factor explains all.
            assert recording[name].unit in ("rad/s", "N·m", "us", "dshot")
            strange = values[~np.isin(values, known)]
            pairs = strange[0] / known[known != 0]
            assert any(
                np.isclose(known[:, None], strange[None, :5] / f, rtol=1e-9).any(axis=0).all() for f in pairs
            )


def check(tmp_path, format_name, mutate, count, seed):
    random = np.random.default_rng(seed)
    original = TEXTS[format_name]()
    loaded = 0
    for case in range(count):
        path = tmp_path / f"{mutate.__name__}-{case % 50}.csv"
        data = mutate(original, random)
        path.write_bytes(data)
        options = OPTIONS.get(format_name)
        recording = outcome(path, "auto" if case % 4 == 0 and options is None else format_name, options)
        if recording is not None:
            loaded += 1
            assert_nothing_invented(recording, data)
    return loaded


@pytest.mark.parametrize("mutate", MUTATIONS, ids=lambda m: m.__name__)
@pytest.mark.parametrize("format_name", TEXTS)
def test_damaged_text(tmp_path, format_name, mutate):
    check(tmp_path, format_name, mutate, QUICK // 4, 7)


@pytest.mark.parametrize("format_name", TEXTS)
def test_gigantic_fields(tmp_path, format_name):
    check(tmp_path, format_name, gigantic_field, 3, 8)


@pytest.mark.slow
@pytest.mark.parametrize("format_name", TEXTS)
def test_damaged_text_many(tmp_path, format_name):
    for mutate in MUTATIONS:
        check(tmp_path, format_name, mutate, MANY // len(MUTATIONS) + 1, 9)


def same_start(cut_log, whole):
    """A cut log holds the first rows of the whole one; only the last number of the last row may "
    "be cut short."""
    assert cut_log.kind in (whole.kind, "static-map")
    for name, channel in cut_log.channels.items():
        rows = len(channel.values)
        reference = whole[name].values[:rows]
        assert rows <= len(whole[name].values)
        np.testing.assert_array_equal(channel.values[: rows - 1], reference[: rows - 1])


HEADER_ROWS = {
    "motive-csv": 7, "lvm": 16, "qualisys-tsv": 8, "motive-legacy": 4, "net-ft-csv": 7, "ati-text": 3,
}  # fmt: skip


# A Vicon file cut in the header of its second section is refused, rightly.
@pytest.mark.parametrize("format_name", [name for name in TEXTS if name != "vicon-csv"])
def test_cut_anywhere_after_the_header_keeps_the_rows_before(tmp_path, format_name):
    original = TEXTS[format_name]()
    path = tmp_path / "log.csv"
    path.write_bytes(original)
    options = OPTIONS.get(format_name, {})
    whole = load(path, **options)
    lines = original.split(b"\n")
    rows = HEADER_ROWS.get(format_name, 1)
    begin = len(b"\n".join(lines[: rows + 3])) + 1
    random = np.random.default_rng(10)
    for at in random.integers(begin, len(original), QUICK // 2):
        path.write_bytes(original[:at])
        recording = outcome(path, format_name, options)
        # A log cut after its third row is still a log.
        assert recording is not None
        same_start(recording, whole)


def test_every_single_cut_of_a_pose_table(tmp_path):
    original = pose()
    path = tmp_path / "log.csv"
    path.write_bytes(original)
    whole = load(path)
    for at in range(len(original) - 150, len(original)):
        path.write_bytes(original[:at])
        recording = outcome(path, "pose-table")
        assert recording is not None
        same_start(recording, whole)
        np.testing.assert_allclose(
            np.linalg.norm(recording["body/orientation"].values[:-1], axis=1), 1, atol=1e-12
        )


def stored_bytes(original):
    """Where the compressed samples lie in the file."""
    places = []
    with h5py.File(io.BytesIO(original), "r") as file:
        for data in file.values():
            for chunk in range(data.id.get_num_chunks()):
                info = data.id.get_chunk_info(chunk)
                places += range(info.byte_offset, info.byte_offset + info.size)
    return np.array(places)


def hdf5_cases(tmp_path, count, seed):
    """Cut files, and files damaged where the samples lie.

    Damage to the HDF5 library's own structures is left out: some of it makes the library itself loop for ever
    (seen with a string attribute whose heap is damaged), which no caller in the same process can stop.
    """
    random = np.random.default_rng(seed)
    original = cell_hdf5()
    places = stored_bytes(original)
    path = tmp_path / "log.h5"
    path.write_bytes(original)
    whole = load(path)
    for case in range(count):
        data = bytearray(original)
        if case % 2:
            for at in random.choice(places, random.integers(1, 5)):
                data[at] ^= 1 << random.integers(0, 8)
        else:
            data = data[: random.integers(0, len(data))]
        path.write_bytes(data)
        recording = outcome(path, "auto" if case % 4 == 0 else "load-cell-hdf5")
        if recording is not None:
            # The check sum of the compression finds every damaged sample; what loads is what was written.
            for name, channel in recording.channels.items():
                np.testing.assert_array_equal(channel.values, whole[name].values)


def test_damaged_hdf5(tmp_path):
    hdf5_cases(tmp_path, 2 * QUICK, 11)


@pytest.mark.slow
def test_damaged_hdf5_many(tmp_path):
    hdf5_cases(tmp_path, MANY, 12)
