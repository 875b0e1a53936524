"""Small logs beside this file, good and broken: each loads to the numbers written in it, or is refused."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from fakes.log_files import LBF, LBF_IN, notes, refuses
from sysid.errors import UnitError
from sysid.loaders import load

HERE = Path(__file__).parent
RPM = 2 * np.pi / 60


def test_stand_1580_with_mark_ragged_rows_quotes_and_comments():
    log = load(HERE / "stand_1580_us.csv")
    assert log.kind == "thrust-stand"
    assert log.provenance.format == "rcbenchmark-csv"
    assert log["command"].unit == "us"
    # The two rows at t = 0 become one; ragged rows and the quoted message keep their places.
    np.testing.assert_array_equal(log["speed"].time, [0, 0.02, 0.04, 0.06])
    np.testing.assert_array_equal(log["command"].values, [1000, 1200, 1200, 1200])
    np.testing.assert_allclose(log["speed"].values, np.array([600, 1200, 1800, 1800]) * RPM, rtol=1e-15)
    np.testing.assert_allclose(log["thrust"].values, np.array([0.1, np.nan, 0.2, 0.2]) * 9.80665, rtol=1e-15)
    np.testing.assert_array_equal(log["thrust"].valid, [True, False, True, True])
    np.testing.assert_allclose(log["acceleration_z"].values, -9.80665)
    assert "optical" in notes(log)
    assert "repeat the time" in notes(log)
    assert "Servo" not in " ".join(log.channels)


def test_stand_semicolon_decimal_comma_cp1252_old_line_ends_stale_row():
    log = load(HERE / "stand_semicolon_cp1252_cr.csv")
    assert log["command"].unit == "dshot"
    np.testing.assert_array_equal(log["thrust"].time, [0, 0.01, 0.02])
    np.testing.assert_allclose(log["thrust"].values, np.array([0, 10.5, 20.5]) * 9.80665e-3, rtol=1e-15)
    np.testing.assert_array_equal(log["torque"].values, [0, 0.001, 0.002])
    assert "stale" in notes(log)
    assert "Windows-1252" in notes(log)


@pytest.mark.parametrize("options", [{}, {"time_back": "drop"}])
def test_a_row_of_a_stand_that_comes_late_is_dropped_with_a_note_or_refused_on_demand(options):
    path = HERE / "stand_time_back.csv"
    refuses(path, r"csv, line 5: time goes back from 3.214 s to 3.209 s", time_back="refuse")
    log = load(path, **options)
    np.testing.assert_array_equal(log["thrust"].time, [3.19, 3.20, 3.214, 3.22])
    assert "time goes back, left out: 1 (first: line 5), by up to 0.45 sample periods" in notes(log)


def test_load_cell_without_clock_needs_a_rate_and_command_unit():
    path = HERE / "load_cell_lbf.csv"
    refuses(path, r"no time column among .*columns = .*, or declare the sample rate")
    refuses(path, r'command column "Command" states no unit; expected us, dshot', UnitError, rate=10000)
    log = load(path, rate=10000, units={"command": "us"})
    np.testing.assert_array_equal(log["thrust"].time, [0, 1e-4])
    # 1 lbf and 1 lbf-in as the cell's maker states them, to the digits given there.
    np.testing.assert_allclose(log["thrust"].values, [LBF, 2 * LBF], rtol=1e-13)
    np.testing.assert_allclose(log["torque"].values, [LBF_IN, 2 * LBF_IN], rtol=1e-13)
    np.testing.assert_allclose(log["speed"].values, [0, 2 * np.pi], rtol=1e-15)


def test_motive_121_millimetres_gap_flip_and_cut_last_line():
    log = load(HERE / "motive_121_mm_cut.csv")
    assert log.kind == "motion-capture"
    assert log.rigid_bodies == ("quad",)
    assert log.markers == ("board:1",)
    np.testing.assert_allclose(log["quad/position"].time, [0.5, 0.505, 0.51, 0.515, 0.525], rtol=1e-15)
    np.testing.assert_allclose(log["quad/position"].values[:2], [[0.01, 0.02, 0.03], [0.011, 0.021, 0.031]])
    np.testing.assert_array_equal(log["quad/orientation"].valid, [True, True, False, True, True])
    np.testing.assert_array_equal(log["board:1/position"].valid, [True, True, True, False, True])
    # Written +, -, lost, -, +: continuous after two changes of sign, w first.
    np.testing.assert_allclose(
        log["quad/orientation"].values,
        [[1, 0, 0, 0], [1, 0, 0, 0], [np.nan] * 4, [0.8, 0, 0, -0.6], [0.8, 0, 0, 0.6]],
        atol=1e-15,
    )
    stated = notes(log)
    assert "line 13, the last, is cut" in stated
    assert "changes sign" in stated
    assert "03.49.50.755 PM" in stated
    assert log.provenance.device == "OptiTrack Motive CSV 1.21"


def test_motive_124_euler_parent_row_and_times_rounded_to_milliseconds():
    log = load(HERE / "motive_124_zyx_m.csv")
    np.testing.assert_array_equal(log["quad/position"].time, np.arange(3) / 120.0)
    half = np.sqrt(0.5)
    orientation = log["quad/orientation"].values
    np.testing.assert_allclose(orientation[0], [half, 0, 0, half], atol=1e-15)
    np.testing.assert_allclose(orientation[1], [half, 0, half, 0], atol=1e-15)
    # ZYX intrinsic is Rz Ry Rx of the angles about z, y, x: multiplied out by hand, not by the code under
    # test.
    a, b, c = np.deg2rad([10.0, 20.0, 30.0])
    rz = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    rx = np.array([[1, 0, 0], [0, np.cos(c), -np.sin(c)], [0, np.sin(c), np.cos(c)]])
    w, x, y, z = orientation[2]
    written_out = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    np.testing.assert_allclose(written_out, rz @ ry @ rx, atol=1e-14)
    refuses(HERE / "motive_124_zyx_m.csv", "contradicts the header, which says ZYX", euler_order="XYZ")
    refuses(HERE / "motive_124_zyx_m.csv", "lengths are in Meters and mm", UnitError, length_unit="mm")


def test_pose_table_w_last_cut_and_duplicate_stamp():
    path = HERE / "pose_xyzw_cut.csv"
    refuses(path, "state no unit", UnitError)
    order = "contradicts the columns, which are named in the order xyzw"
    refuses(path, order, length_unit="m", quaternion_order="wxyz")
    log = load(path, length_unit="m", rigid_body="cf")
    assert log.rigid_bodies == ("cf",)
    np.testing.assert_array_equal(log["cf/position"].values[:, 2], [0.3, 0.32, 0.33])
    np.testing.assert_array_equal(log["cf/orientation"].values, [[1, 0, 0, 0]] * 3)
    stated = notes(log)
    assert "line 6, the last, is cut" in stated
    assert "repeat the time" in stated


def test_pose_table_numbered_quaternion_needs_its_order():
    path = HERE / "pose_numbered.tsv"
    refuses(path, "do not say which of them is w")
    first = load(path, quaternion_order="wxyz")
    np.testing.assert_allclose(first["body/orientation"].values, [[1, 0, 0, 0], [0.8, 0.6, 0, 0]])
    np.testing.assert_allclose(first["body/position"].values[1], [0.1, 0.2, 0.301])
    np.testing.assert_allclose(first["body/position"].time, [0, 0.005])
    last = load(path, quaternion_order="xyzw")
    np.testing.assert_allclose(last["body/orientation"].values, [[0, 1, 0, 0], [0, 0.8, 0.6, 0]])


def test_pose_table_commented_header_in_nanoseconds():
    log = load(HERE / "pose_euroc.csv")
    # 1.4e9 s in double precision resolves 0.24 µs.
    np.testing.assert_allclose(np.diff(log["body/position"].time), [0.00499968], atol=3e-7)
    np.testing.assert_allclose(log["body/orientation"].values[0], [0.5, -0.5, -0.5, -0.5])


def test_provenance_names_file_hash_and_options():
    path = HERE / "pose_numbered.tsv"
    stated = load(path, quaternion_order="wxyz").provenance
    assert stated.path == str(path)
    assert stated.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert stated.format == "pose-table"
    assert dict(stated.options) == {"quaternion_order": "wxyz"}
