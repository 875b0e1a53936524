"""Every real recording of our formats loads with the right units; the others are refused in a sentence."""

import csv
from pathlib import Path

import numpy as np
import pytest

from sysid.errors import LogError
from sysid.loaders import load

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"no real recordings beside the project ({DATA})")

RCBENCHMARK = DATA / "rcbenchmark"


def plain_rows(path):
    """The file's rows by column label, read the obvious way."""
    with path.open(encoding="utf-8-sig", newline="") as stream:
        lines = [line for line in stream if line.strip() and not line.startswith("#")]
    header, *rows = list(csv.reader(lines))
    return {
        label: np.array([float(row[i]) if i < len(row) and row[i].strip() else np.nan for row in rows])
        for i, label in enumerate(header)
        if label and label != "App message"
    }


@pytest.mark.parametrize(
    ("name", "rows", "blank_thrust", "median_step"),
    [
        # Row counts, blanks and steps as counted in these files by hand.
        ("sar_SOV5_TimeConstant_Test_2023-12-16_130840.csv", 8409, 0.33, 8.9e-3),
        ("sar_IM_TimeConstant_Test_2023-12-17_162234.csv", 3707, 0.11, 12.1e-3),
    ],
)
def test_running_thrust_stand(name, rows, blank_thrust, median_step):
    log = load(RCBENCHMARK / name)
    plain = plain_rows(RCBENCHMARK / name)
    assert log.kind == "thrust-stand"
    assert len(plain["Time (s)"]) == rows
    kept = np.append(np.diff(plain["Time (s)"]) > 0, True)
    assert rows - kept.sum() <= 1
    np.testing.assert_array_equal(log["thrust"].time, plain["Time (s)"][kept])
    np.testing.assert_allclose(log["thrust"].values, plain["Thrust (gf)"][kept] * 9.80665e-3, rtol=1e-14)
    np.testing.assert_array_equal(log["torque"].values, plain["Torque (N·m)"][kept])
    np.testing.assert_array_equal(log["speed"].values, plain["Motor Optical Speed (rad/s)"][kept])
    np.testing.assert_array_equal(log["command"].values, plain["ESC signal"][kept])
    np.testing.assert_array_equal(log["voltage"].values, plain["Voltage (V)"][kept])
    assert log["command"].unit == "dshot"
    assert 1 - log["thrust"].valid.mean() == pytest.approx(blank_thrust, abs=0.005)
    assert np.median(np.diff(log["thrust"].time)) == pytest.approx(median_step, abs=0.05e-3)
    assert not log["speed_electrical"].values.any()


@pytest.mark.parametrize(
    "name", ["sar_IM_StepsTestV2_2024-02-06_131025.csv", "sar_SOV5_StepsTestV2_2024-02-06_103903.csv"]
)
def test_static_points(name):
    log = load(RCBENCHMARK / name)
    plain = plain_rows(RCBENCHMARK / name)
    assert log.kind == "static-map"
    np.testing.assert_array_equal(log["thrust"].time, np.arange(len(plain["Time (s)"])))
    np.testing.assert_array_equal(log["log_time"].values, plain["Time (s)"])
    np.testing.assert_allclose(log["thrust"].values, plain["Thrust (gf)"] * 9.80665e-3, rtol=1e-14)
    pole_note = any("pole count" in note for note in log.provenance.notes)
    # 12 of 14 poles set for the first motor, right for the second.
    assert pole_note == ("_IM_" in name)


def test_static_points_of_series_1520():
    log = load(RCBENCHMARK / "strawson1520_raw_a1_11.csv")
    assert log.kind == "static-map"
    assert log.provenance.device.endswith("1520")
    assert log["command"].unit == "us"
    np.testing.assert_array_equal(log["command"].values, np.append(1050 + 95 * np.arange(10), 2000))
    assert log["speed"].values[0] == pytest.approx(3421 * 2 * np.pi / 60)
    assert log["thrust"].values[0] == pytest.approx(15.171654199725802e-3 * 9.80665)


def test_motive_take():
    log = load(DATA / "optitrack" / "cmu_v1.21_sample_optitrack_take.csv", rigid_body="Rigid Body 1")
    assert log.rigid_bodies == ("Rigid Body 1",)
    assert log.provenance.device == "OptiTrack Motive CSV 1.21"
    np.testing.assert_array_equal(log["Rigid Body 1/position"].time, np.arange(250) / 120.0)
    np.testing.assert_array_equal(log["Rigid Body 1/position"].values[0], [0.060002, 0.019150, 0.076611])
    # Written 0.000035, 0.000016, -0.000030, -1 in the order x, y, z, w: its length is 1 within 1e-8.
    np.testing.assert_allclose(
        log["Rigid Body 1/orientation"].values[0], [-1, 3.5e-5, 1.6e-5, -3e-5], atol=1e-8
    )
    with pytest.raises(LogError, match='no rigid body "F450"; found "Rigid Body 1"'):
        load(DATA / "optitrack" / "cmu_v1.21_sample_optitrack_take.csv", rigid_body="F450")


@pytest.mark.parametrize("folder", ["lvm", "tdms", "c3d", "vicon"])
def test_other_instruments_are_refused_in_a_sentence(folder):
    found = [path for path in sorted((DATA / folder).iterdir()) if "LICENSE" not in path.name]
    assert found
    for path in found:
        with pytest.raises(LogError, match=r"not recognized as any log format by its content"):
            load(path)
        for name in ("rcbenchmark-csv", "load-cell-csv", "load-cell-hdf5", "motive-csv", "pose-table"):
            with pytest.raises(LogError, match=path.name):
                load(path, format=name)
