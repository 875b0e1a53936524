"""Formats one by one: what each states, what must be declared, and what is refused."""

import sys
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fakes import log_files
from fakes.log_files import (
    LBF,
    LBF_IN,
    NET_FT,
    c3d,
    hdf5,
    notes,
    quaternions_of,
    refuses,
    ros_recording,
    small_turns,
)
from sysid.errors import SysidError, UnitError
from sysid.loaders import detect, load
from sysid.loaders.rigid_pose import fit_rotations

pytestmark = pytest.mark.usefixtures("in_this_process")

CAL = """<?xml version="1.0" encoding="utf-8"?>
<!-- NOTE: use UserAxis, not Axis -->
<FTSensor Serial="FT00001" BodyStyle="Mini40" Family="DAQ" NumGages="6" CalFileVersion="1.1">
  <Calibration PartNumber="US-20-40" ForceUnits="lbf" TorqueUnits="lbf-in" OutputRange="20">
    <Axis Name="Fx" values="9 9 9 9 9 9" max="20" scale="3"/>
    <BasicTransform Dx="0" Dy="0" Dz="0.211" Rx="0" Ry="0" Rz="0"/>
    <UserAxis Name="Fx" values=" 1 0 0 0 0 0 " max="20"/>
    <UserAxis Name="Fy" values=" 0 2 0 0 0 0 " max="20"/>
    <UserAxis Name="Fz" values=" 0 0 3 0 0 1 " max="60"/>
    <UserAxis Name="Tx" values=" 0 0 0 4 0 0 " max="40"/>
    <UserAxis Name="Ty" values=" 0 0 0 0 5 0 " max="40"/>
    <UserAxis Name="Tz" values=" 0 0 0 0 0 6 " max="40"/>
  </Calibration>
</FTSensor>
"""
SI = {"force": "N", "torque": "N*m"}
VOLTS = "".join(f"{0.001 * i},1,0.5,0.25,2,3,{4 + i // 3}\n" for i in range(6))


def test_ati_voltages_with_calibration_tare_and_transform(write):
    write(CAL, "cell.cal")
    path = write(VOLTS)
    log = load(path, format="ati-text", calibration="cell.cal")
    # FT = UserAxis · V: Fz = 3·0.25 + 4 in lbf, Tz = 6·4 in lbf-in.
    np.testing.assert_allclose(log["thrust"].values[0], 4.75 * LBF, rtol=1e-12)
    np.testing.assert_allclose(log["torque"].values[0], 24 * LBF_IN, rtol=1e-12)
    assert log.provenance.device == "ATI Mini40 FT00001 US-20-40"
    tared = load(path, format="ati-text", calibration="cell.cal", tare=0.0025)
    # After three rows gauge 6 has grown by one volt: Fz by 1 lbf, Tz by 6 lbf-in, nothing else.
    np.testing.assert_allclose(tared["thrust"].values, [0, 0, 0, LBF, LBF, LBF], atol=1e-14)
    np.testing.assert_allclose(tared["torque"].values[3:], 6 * LBF_IN, rtol=1e-12)
    np.testing.assert_allclose(tared["force_x"].values, 0, atol=1e-14)
    # A force along z, seen from a point 10 mm along x: T' = T - d × F, so Ty' = 0.01 Fz.
    moved = load(path, format="ati-text", calibration="cell.cal", tare=0.0025, transform={"dx": "10 mm"})
    np.testing.assert_allclose(moved["torque_y"].values[3:], 0.01 * LBF, rtol=1e-12)
    # Axes turned by a quarter about x: the old z is the new -y... of old +y the new z.
    turned = load(path, format="ati-text", calibration="cell.cal", tare=0.0025, transform={"rx": "90 deg"})
    np.testing.assert_allclose(turned["force_y"].values[3:], LBF, rtol=1e-12)
    np.testing.assert_allclose(turned["thrust"].values, 0, atol=1e-14)


def test_ati_time_column_without_a_unit_is_noted_declared_or_refused(write):
    def log(step, units=None, read=load, **options):
        rows = "".join(f"{step * i:.6g},1,0,5,0,0,0.1\n" for i in range(200))
        return read(write(rows), format="ati-text", units=SI | (units or {}), **options)

    assert any("taken as the time in seconds" in note for note in log(1e-3).provenance.sentences)
    too_slow = r'steps by 1, too slow .* units = \{time = "ms"\}, or the sample rate'
    log(1, read=partial(refuses, sentence=too_slow))
    declared = log(1, units={"time": "ms"})
    np.testing.assert_allclose(declared["thrust"].time, 1e-3 * np.arange(200), rtol=1e-12)
    assert not any("taken as the time" in note for note in declared.provenance.sentences)
    counted = log(1, rate=1000)
    np.testing.assert_allclose(counted["thrust"].time, 1e-3 * np.arange(200), rtol=1e-12)
    assert "the first of seven columns counts rows and was left out" in counted.provenance.sentences
    for options, sentence, error in [
        ({"rate": 500}, r"rate = 500 makes the log .* but its time column spans 0.199 s", SysidError),
        ({"units": {"time": "V"}}, "time: .*dimension", UnitError),
    ]:
        log(1e-3, read=partial(refuses, sentence=sentence, error=error), **options)
    options = {"format": "ati-text", "rate": 100, "units": SI | {"time": "s"}}
    refuses(write("1,0,5,0,0,0.1\n" * 5), "rows have six numbers and no time", UnitError, **options)


def test_ati_loads_beyond_the_calibration_are_said(write):
    write(CAL, "cell.cal")
    log = load(write("0,0,30,0,0,0\n" * 3), format="ati-text", calibration="cell.cal", rate=100)
    assert "beyond the calibrated range: Fz" in log.provenance.sentences


@pytest.mark.parametrize(("cal", "options", "message"), [
    (CAL, {}, "does not state its units; declare them"),
    (CAL, {"units": {"force": "N"}}, "expected {force"),
    (CAL, {"units": {"force": "N", "torque": "V"}}, "dimension"),
    (CAL, {"calibration": "none.cal"}, "calibration cannot be read"),
    (CAL, {"calibration": "cell.cal", "units": {"force": "N", "torque": "N*m"}}, "exclude each other"),
    (CAL, {"calibration": "cell.cal", "tare": -1}, "expected seconds at the start"),
    (CAL, {"calibration": "cell.cal", "transform": {"dq": "1 m"}}, 'transform names "dq"'),
    (CAL, {"calibration": "cell.cal", "transform": {"dx": "1"}}, "has no unit"),
    (CAL.replace("UserAxis", "Other"), {"calibration": "cell.cal"}, "no UserAxis Fx"),
    (CAL.replace('6 "', 'x "'), {"calibration": "cell.cal"}, "UserAxis Tz is not six numbers"),
    (CAL.replace('"lbf"', '"stone"'), {"calibration": "cell.cal"}, "ForceUnits: unit 'stone'"),
    (CAL[:-20], {"calibration": "cell.cal"}, "the calibration is no XML"),
    ('<!DOCTYPE a [<!ENTITY b "c">]>' + CAL[40:], {"calibration": "cell.cal"}, "not a calibration as ATI"),
])  # fmt: skip
def test_ati_refusals(write, cal, options, message):
    write(cal, "cell.cal")
    refuses(write(VOLTS), message, SysidError, format="ati-text", **options)


LVM = log_files.LVM.format(columns="No", axis="")


@pytest.mark.parametrize(("content", "options", "message"), [
    (LVM + "\t1\n\tx\n", {}, r"line 14: 'x' in column 'Fz' is not a number"),
    (LVM + "\t1\n\n\t2\n", {}, r"line 15: '2' is neither a sample nor part of the header"),
    (LVM, {}, "no rows of numbers after line 12"),
    (LVM[:60], {}, r"no line \*\*\*End_of_Header\*\*\*"),
    (LVM.replace("\tTab", "\tPipe") + "\t1\n", {}, "Separator is 'pipe'"),
    (LVM.replace("0.5", "soon") + "\t1\n", {}, "line 12 states Delta_X as 'soon'"),
    (LVM.replace("\tN\n", "\tfurlong\n") + "\t1\n", {}, 'column "Fz": .*furlong'),
    (LVM.replace("Delta_X\t0.5\n", "") + "\t1\n", {}, "has no clock"),
    (LVM + "\t1\n" + LVM[LVM.index("\n\n") :] + "\t2\n", {}, "has 2 segments"),
    (LVM + "\t1\n", {"segment": 2}, "the file has segments 1 to 1"),
    (LVM + "\t1\n", {"datasets": {"thrust": "Fq"}}, 'no dataset /Fq; found "/Fz"'),
])  # fmt: skip
def test_lvm_refusals(write, content, options, message):
    refuses(write(content), message, SysidError, **options)


def test_lvm_second_segment(write):
    path = write(LVM + "\t1\n" + LVM[LVM.index("\n\n") :] + "\t2\n\t3\n")
    np.testing.assert_array_equal(load(path, segment=2)["thrust"].values, [2, 3])


TRACKER = (
    "Objects\n100\n,,Global Angle drone:drone,,,,,\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n"
    ",,{u},{u},{u},mm,mm,mm\n"
)


def test_tracker_helical_angles_in_radians_and_degrees_and_a_dropped_object(write):
    rows = f"1,0,0,0,{np.pi / 2},1,2,3\n2,0\n3,0,0,0,0,1,2,3\n"
    log = load(write(TRACKER.format(u="") + rows))
    half = np.sqrt(0.5)
    turns = [[half, 0, 0, half], [1, 0, 0, 0]]
    np.testing.assert_allclose(log["drone/orientation"].values, turns, atol=1e-12)
    np.testing.assert_allclose(log["drone/position"].time, [0.01, 0.03])
    np.testing.assert_allclose(log["drone/position"].values[0], [1e-3, 2e-3, 3e-3])
    log = load(write(TRACKER.format(u="deg") + "1,0,0,0,90,1,2,3\n2,0,0,0,0,1,2,3\n"))
    np.testing.assert_allclose(log["drone/orientation"].values[0], [half, 0, 0, half], atol=1e-12)


@pytest.mark.parametrize(("content", "options", "message"), [
    (TRACKER.format(u="deg").replace("Objects", "Segments") + "1,0,0,0,1,1,2,3\n", {}, "declare angles"),
    (TRACKER.format(u="deg"), {}, "no rows of numbers after line 5"),
    (TRACKER.format(u="deg") + "1,0,0,0,1,1,2,3\n", {"angles": "XYX"}, "angles = 'XYX' is unknown"),
    (TRACKER.format(u="V") + "1,0,0,0,1,1,2,3\n", {}, "dimension"),
    (TRACKER.format(u="").replace("mm", "") + "1,0,0,0,1,1,2,3\n", {}, "no length unit"),
    (TRACKER.format(u="").replace("Sub Frame", "Other") + "1,0,0,0,1,1,2,3\n", {}, "line 4: found"),
    (TRACKER.format(u="") + "1,0,0,0,1,1,2,3\n\nrest\n", {}, "line 8: 'rest' is no title of a section"),
    (TRACKER.format(u="") + "1,0,0,0,1,1,2,3\n", {"rigid_body": "F450"},
     'no rigid body "F450"; found "drone"'),
    (TRACKER.format(u="") + "1,0,0,0,x,1,2,3\n", {}, "line 6: 'x' in column"),
])  # fmt: skip
def test_vicon_refusals(write, content, options, message):
    refuses(write(content), message, SysidError, **options)


QTM = "NO_OF_FRAMES\t2\nFREQUENCY\t100\nDATA_INCLUDED\t6D\nBODY_NAMES\tquad\n"


@pytest.mark.parametrize(("content", "message"), [
    (QTM + "\t".join(["1"] * 16) + "\n", r"line 5: Rot.0. to Rot.8. of quad are no rotation"),
    (QTM + "1\t2\n", "rows have 2 cells where the header names 16"),
    (QTM.replace("6D", "EMG"), "DATA_INCLUDED is 'EMG'"),
    (QTM.replace("FREQUENCY\t100\n", ""), "states no FREQUENCY"),
    (QTM.replace("\tquad", "\t"), "states no BODY_NAMES"),
    (QTM.replace("\tquad", "\ta\ta"), 'BODY_NAMES repeats "a"'),
    (QTM, "rows have 1 cells|no rows of numbers"),
])  # fmt: skip
def test_qualisys_refusals(write, content, message):
    refuses(write(content), message)


def test_qualisys_frequency_is_checked_against_the_time_column(write):
    head = "NO_OF_FRAMES\t50\nFREQUENCY\t{rate}\nDATA_INCLUDED\t3D\nMARKER_NAMES\tm1\nFrame\tTime\tX\tY\tZ\n"
    rows = "".join(f"{i + 1}\t{i / 100:.5f}\t{i}\t2\t3\n" for i in range(50))
    time = load(write(head.format(rate=100) + rows))["m1/position"].time
    np.testing.assert_array_equal(time, np.arange(50) / 100)
    for rate in (800, 102):
        refuses(write(head.format(rate=rate) + rows), f"at {rate} Hz is at .* but the Time column says")
    # Times that count from another event keep their zero, which the frame numbers do not know.
    later = "".join(f"{i + 1}\t{2 + i / 100:.5f}\t{i}\t2\t3\n" for i in range(50))
    log = load(write(head.format(rate=100) + later))
    np.testing.assert_allclose(log["m1/position"].time, 2 + np.arange(50) / 100, atol=1e-9)  # double rounding
    assert "time rebuilt from frame numbers at 100 Hz, beginning 2 s later" in log.provenance.sentences


def test_net_ft_refusals(write):
    text = NET_FT.format(2).replace("Torque: 2", "Torque: 4") + "0, 5, 5, 1, 1, 2, 1, 1, 8, 0:00\n"
    log = load(write(text))
    assert (log["thrust"].values[0], log["torque"].values[0]) == (1, 2)
    for old, new, message in [
        ("Force: 2", "Force: none", "is 'none'; expected a positive number"),
        ("Units: Nm", "Units: V", "torque units"),
        ("Fz", "Fx", "columns Fx, Fz are missing or repeated"),
    ]:
        refuses(write(text.replace(old, new)), message, SysidError)


def test_missing_library_names_the_extra(write, monkeypatch):
    monkeypatch.setitem(sys.modules, "nptdms", None)
    refuses(write(b"TDSm" + bytes(40)), r'needs npTDMS .* pip install "sysid\[logs\]"')


@pytest.mark.parametrize(("data", "sentence"), [
    (b"ULog\x01\x12\x35\x01" + bytes(40), "a PX4 ULog, which sysid does not read.*"),
    (b"righthanded\ninfo,version,1.1\n", "an export of OptiTrack Motive 1.1 .*"),
])  # fmt: skip
def test_a_log_of_a_former_format_is_refused_by_name(write, data, sentence):
    refuses(write(data), sentence)


@pytest.mark.parametrize("data", [b"TDSm\x0e" + bytes(60), b"\x89MCAP0\r\n12"])
def test_damaged_binary_logs_end_in_a_sentence(write, data):
    refuses(write(data), r"damaged|has no signal|empty")


@pytest.mark.parametrize("form", ["bag", "mcap", "sqlite"])
def test_ros_recordings(tmp_path, form):
    random = np.random.default_rng(3)
    stamps = 1_700_000_000 * 10**9 + 10_000_000 * np.arange(150)
    places, turns = random.normal(size=(150, 3)), quaternions_of(small_turns(random, 150))
    file = ros_recording(tmp_path, form, {"/vrpn/quad/pose": (stamps, places, turns, 3_000_000)})
    path = file.rename(tmp_path / "log.csv")
    assert detect(path) == "ros-bag"
    log = load(path)
    assert log.rigid_bodies == ("vrpn/quad/pose",)
    assert "remark" in notes(log)
    refuses(path, 'no topic "/other"; found "/remark", "/vrpn/quad/pose"', topic="/other")
    refuses(path, "no topic of poses", topic="/remark")


def test_c3d_pose_follows_the_markers(tmp_path):
    random = np.random.default_rng(4)
    shape = np.array([[0, 0, 0], [200, 0, 0], [0, 150, 0], [0, 0, 90], [120, 80, 40.0]])
    turns = Rotation.from_rotvec(np.cumsum(random.uniform(-0.2, 0.2, (60, 3)), axis=0))
    way = np.cumsum(random.uniform(-20, 20, (60, 3)), axis=0)
    points = np.einsum("nij,kj->nki", turns.as_matrix(), shape) + way[:, None]
    points[10:14, 2] = np.nan
    points[20:23, :3] = np.nan  # two markers left: no pose
    path = c3d(tmp_path / "log.c3d", points)
    log = load(path, rigid_body="quad")
    assert log.rigid_bodies == ("quad",)
    seen = log["quad/orientation"].valid
    np.testing.assert_array_equal(np.flatnonzero(~seen), [20, 21, 22])
    # The body's axes are those of the capture in the first whole frame: turns count from there.
    relative = (turns * turns[0].inv())[np.flatnonzero(seen)]
    wanted, got = quaternions_of(relative), log["quad/orientation"].values[seen]
    # C3D keeps single precision: 1e-5 mm in 100 mm.
    np.testing.assert_allclose(np.abs(np.sum(got * wanted, axis=1)), 1, atol=1e-8)
    centre = (np.einsum("nij,j->ni", turns.as_matrix(), shape.mean(axis=0)) + way) / 1000
    np.testing.assert_allclose(log["quad/position"].values[seen], centre[seen], atol=1e-6)
    assert np.nanmax(log["quad/residual"].values) < 1e-6
    refuses(path, 'body "board" has 0 markers, a pose needs three', rigid_body="board")


def test_every_wanted_body_is_fitted_to_its_markers(tmp_path):
    points = np.random.default_rng(7).normal(size=(1, 6, 3)).repeat(5, axis=0) * 100
    labels = ["a1", "a2", "a3", "b1", "b2", "b3"]
    path = c3d(tmp_path / "log.c3d", points, labels=labels)
    log = load(path, bodies={"a": labels[:3]}, rigid_body=["a", "b"])
    assert log.rigid_bodies == ("a", "b")
    for place, name in enumerate(log.rigid_bodies):
        # Single precision in the file: 1e-5 mm in 100 mm.
        centre = points[:, 3 * place : 3 * place + 3].mean(axis=1) / 1000
        np.testing.assert_allclose(log[f"{name}/position"].values, centre, atol=1e-6)
        assert any(note.startswith(f"pose of {name} from 3 markers") for note in log.provenance.sentences)


def test_what_was_declared_of_signals_is_in_the_record(tmp_path):
    pulses = np.tile([0.0] * 5 + [1.0] * 5, 5)
    path = hdf5(tmp_path / "log.h5", {"a": (None, np.arange(50.0)), "b": (None, pulses)})
    stated = {"rate": 100.0, "datasets": {"thrust": "a", "tachometer": "b"}, "units": {"thrust": "N"}}
    log = load(path, **stated, pulses_per_revolution=2.0)
    wanted = {name: str(value) for name, value in stated.items()} | {"pulses_per_revolution": "2.0"}
    assert log.provenance.options == wanted


def test_c3d_units_and_lines(tmp_path):
    random = np.random.default_rng(5)
    points = random.normal(size=(10, 3, 3))
    refuses(c3d(tmp_path / "log.c3d", points, unit=""), "states no length unit", UnitError)
    refuses(c3d(tmp_path / "log.c3d", points), "lengths are in mm and m", UnitError, length_unit="m")
    line = np.arange(3)[None, :, None] * np.array([100.0, 0, 0]) + np.arange(10)[:, None, None]
    refuses(c3d(tmp_path / "log.c3d", line), "lie on one line", rigid_body="quad")


def test_kabsch_never_mirrors():
    # A flat body seen with noise fits its mirror image as well: the fit must stay a rotation.
    random = np.random.default_rng(6)
    shape = np.array([[0.1, 0, 0], [0, 0.1, 0], [-0.1, 0, 0], [0, -0.1, 0]])
    turns = Rotation.random(200, random)
    points = np.einsum("nij,kj->nki", turns.as_matrix(), shape) + random.normal(size=(200, 4, 3)) * 1e-3
    rotation, _, residual = fit_rotations(shape, points)
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-12)
    away = (Rotation.from_matrix(rotation) * turns.inv()).magnitude()
    # 1 mm of noise on a body of 100 mm turns it by about 7 mrad; five times that is no mirror image.
    assert away.max() < 0.035
    assert residual.max() < 5e-3


SETTINGS = (
    "Format Version,1.23,Take Name,a,Capture Frame Rate,100,Export Frame Rate,100,"
    "Rotation Type,{},Length Units,{}"
)
POINT = [("Position", axis) for axis in "XYZ"]
EULER = [("Rotation", axis) for axis in "XYZ"] + POINT
BODY = [("Rotation", axis) for axis in "XYZW"] + POINT


def take(columns, rows, rotation="Quaternion", unit="Meters", settings=SETTINGS):
    """Return a 1.23 take; columns are (type, name, component, axis)."""
    kinds, names, parts, axes = (",".join(cells) for cells in zip(*columns, strict=True))
    ids = ",".join(f'"{name}"' for name in names.split(","))
    lines = [settings.format(rotation, unit), "", f",Type,{kinds}", f",Name,{names}", f",ID,{ids}"]
    lines += [f",,{parts}", f"Frame,Time (Seconds),{axes}"]
    return "\r\n".join([*lines, *rows, ""]).encode("utf-8")


def asset(kind, name, parts):
    return [(kind, name, *part) for part in parts]


QUAD = asset("Rigid Body", "quad", BODY)
ROWS = ["0,0.00,0,0,0,1,1,2,3", "1,0.01,0,0,0,1,1,2,3"]


def test_length_unit_that_is_not_stated_is_asked_for(write):
    path = write(take(QUAD, ROWS, settings=SETTINGS.replace(",Length Units,{}", "")), "take.csv")
    refuses(path, "states no length unit; declare it", SysidError)
    assert load(path, length_unit="mm")["quad/position"].values[0, 2] == pytest.approx(3e-3)
    refuses(path, r"take\.csv: length unit: unknown unit 'smoot'", SysidError, length_unit="smoot")


def test_euler_order_that_is_not_stated_is_asked_for(write):
    rows = ["0,0.00,90,0,0,1,2,3", "1,0.01,0,90,0,1,2,3"]
    path = write(take(asset("Rigid Body", "quad", EULER), rows, rotation=""))
    refuses(path, "declare euler_order, one of XYZ, XZY")
    refuses(path, "euler_order = 'XYX' is unknown", euler_order="XYX")
    half = np.sqrt(0.5)
    turned = load(path, euler_order="xyz")["quad/orientation"].values
    np.testing.assert_allclose(turned, [[half, half, 0, 0], [half, 0, half, 0]], atol=1e-15)


def test_time_is_rebuilt_from_frames_and_a_contradiction_is_refused(write):
    data = take(QUAD, ["200,2.00,0,0,0,1,1,2,3", "203,2.0304,0,0,0,1,1,2,3", "204,2.04,0,0,0,1,1,2,3"])
    counted = np.array([200, 203, 204]) / 100
    np.testing.assert_array_equal(load(write(data))["quad/position"].time, counted)
    path = write(data.replace(b"203,2.0304", b"203,2.0350"))
    refuses(path, r"line 9: frame 203 at 100 Hz is at 2\.03 s but the Time column says 2\.035")
    for clock, time in (("time", [2.0, 2.035, 2.04]), ("frame", counted)):
        np.testing.assert_array_equal(load(path, clock=clock)["quad/position"].time, time)
    refuses(path, "clock = 'sun' is unknown; expected \"auto\"", clock="sun")


def test_export_at_half_the_capture_rate_with_capture_frame_numbers(write):
    settings = SETTINGS.replace("Export Frame Rate,100", "Export Frame Rate,50")
    rows = [f"{2 * i},{0.02 * i:.2f},0,0,0,1,1,2,3" for i in range(3)]
    log = load(write(take(QUAD, rows, settings=settings)))
    np.testing.assert_allclose(log["quad/position"].time, [0, 0.02, 0.04])


def test_measured_marker_keeps_the_plain_name(write):
    columns = [
        *QUAD, *asset("Rigid Body Marker", "quad:1", POINT), *asset("Marker", "quad:1", POINT),
        *asset("Marker", "never", POINT),
    ]  # fmt: skip
    log = load(write(take(columns, [row + ",7,7,7,8,8,8,,," for row in ROWS])))
    assert log.markers == ("quad:1", "quad:1 (solved)")
    assert log["quad:1/position"].values[0, 0] == 8
    assert log["quad:1 (solved)/position"].values[0, 0] == 7
    assert 'markers never seen, left out: "never"' in log.provenance.sentences


def test_body_lost_in_every_frame_is_kept_as_missing(write):
    columns = [*QUAD, *asset("Rigid Body", "gone", BODY)]
    log = load(write(take(columns, [row + "," * 7 for row in ROWS])))
    assert log.rigid_bodies == ("quad", "gone")
    assert not log["gone/position"].valid.any()
    assert not log["gone/orientation"].valid.any()
    assert "gone is lost in 2 of 2 frames" in log.provenance.sentences


def test_kept_bodies(write):
    columns = [*QUAD, *asset("Rigid Body", "board", BODY)]
    path = write(take(columns, [row + ",0,0,0,1,4,5,6" for row in ROWS]))
    assert load(path, rigid_body="board").rigid_bodies == ("board",)
    assert load(path, rigid_body=["quad", "board"]).rigid_bodies == ("quad", "board")
    refuses(path, 'no rigid body "F450"; found "quad", "board"; set rigid_body', rigid_body="F450")


@pytest.mark.parametrize(("data", "message"), [
    (take(QUAD, []), "no rows of numbers after line 7"),
    (take(QUAD, ROWS[::-1]), r"line 9: time goes back from 0\.01 s to 0 s"),
    (take(QUAD[:-1], [row[:-2] for row in ROWS]), '"quad" lacks one of Position X, Y, Z'),
    (take(asset("Rigid Body", "quad", POINT), ["0,0,1,2,3"]), 'rigid body "quad" lacks a rotation column'),
    (take([*QUAD, *QUAD], ROWS), 'repeats Rotation X of "quad"'),
    (take(asset("Skeleton", "man", BODY), ROWS), "no rows of types and components"),
    (take(QUAD, ROWS).replace(b"Frame,", b"Bild,"), 'no column row "Frame,Time,..."'),
    (take(QUAD, [ROWS[0].replace("3", "x")]), "line 8: 'x' in column 'quad Position Z' is not a number"),
    (take(QUAD, [ROWS[0].replace("0,0,0,1", "0,0,0,2")]), "line 8: the quaternion of quad has length 2"),
])  # fmt: skip
def test_motive_refusals(write, data, message):
    refuses(write(data), message)
