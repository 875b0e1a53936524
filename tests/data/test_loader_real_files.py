"""Every real recording of our formats loads with the right units; the others are refused in a sentence."""

import csv

import numpy as np
import pytest

from fakes.log_files import refuses
from fakes.places import DATA
from sysid.loaders import load

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


@pytest.mark.parametrize(("name", "rows", "blank_thrust", "median_step"), [
    # Row counts, blanks and steps as counted in these files by hand.
    ("sar_SOV5_TimeConstant_Test_2023-12-16_130840.csv", 8409, 0.33, 8.9e-3),
    ("sar_IM_TimeConstant_Test_2023-12-17_162234.csv", 3707, 0.11, 12.1e-3),
])  # fmt: skip
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
    pole_note = any("pole count" in note for note in log.provenance.sentences)
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
    path = DATA / "optitrack" / "cmu_v1.21_sample_optitrack_take.csv"
    log = load(path, rigid_body="Rigid Body 1")
    assert log.rigid_bodies == ("Rigid Body 1",)
    assert log.provenance.device == "OptiTrack Motive CSV 1.21"
    np.testing.assert_array_equal(log["Rigid Body 1/position"].time, np.arange(250) / 120.0)
    np.testing.assert_array_equal(log["Rigid Body 1/position"].values[0], [0.060002, 0.019150, 0.076611])
    # Written 0.000035, 0.000016, -0.000030, -1 in the order x, y, z, w: its length is 1 within 1e-8.
    np.testing.assert_allclose(
        log["Rigid Body 1/orientation"].values[0], [-1, 3.5e-5, 1.6e-5, -3e-5], atol=1e-8
    )
    refuses(path, 'no rigid body "F450"; found "Rigid Body 1"', rigid_body="F450")


def test_tdms_lengths_rates_and_starts():
    # Counted with the library: wf_samples says 2000, 500 and 1 where there are 20000, 3500 and 2000.
    digital = load(DATA / "tdms" / "Digital_Input.tdms")["Dev1_port3_line7 - line 0"]
    assert (len(digital.values), digital.rate) == (20000, pytest.approx(2000))
    sweep = load(DATA / "tdms" / "big_endian.tdms")
    assert sweep.kind == "signals"
    assert len(sweep["Phase sweep"].values) == 3500
    assert not any("1904" in note for note in sweep.provenance.sentences)
    raw = load(DATA / "tdms" / "raw1.tdms")
    assert raw["First Channel"].unit == "V"
    assert raw["First Channel"].rate == pytest.approx(50000)
    named = load(DATA / "tdms" / "raw1.tdms", datasets={"thrust": "Third Chan"}, units={"thrust": "kN"})
    assert named.kind == "load-cell"
    np.testing.assert_allclose(named["thrust"].values, 1000 * raw["Third Chan"].values)


@pytest.mark.parametrize("path", sorted((DATA / "lvm").glob("*.lvm")), ids=lambda p: p.name)
def test_lvm_is_what_the_library_of_the_field_reads(path):
    lvm_read = pytest.importorskip("lvm_read", reason="lvm_read comes with the test extra")
    # Not lvm_read.read, which unpickles what lies beside the file.
    channels = lvm_read.read_str(path.read_bytes().decode("utf-8", "replace"))[0]
    names, data = channels["Channel names"], channels["data"]
    ours = load(path)
    free = list(ours.channels.values())
    for name, values in zip(names, data.T, strict=False):
        if name in ("X_Value", "Comment") or np.isnan(values).all():
            continue
        channel = free.pop(0)
        factor = 1e6 if "MPa" in name else 1.0
        np.testing.assert_allclose(channel.values, values * factor, rtol=1e-15)
        times = channels["Channel names"].index("X_Value") if "X_Value" in names else None
        if times is not None:
            np.testing.assert_array_equal(channel.time, data[:, times])
    assert not free


def test_lvm_rounded_clock_is_said():
    log = load(DATA / "lvm" / "long_single_header_multi_ch.lvm")
    assert len(log["m_1"].values) == 16384
    assert any("0.000977" in note for note in log.provenance.sentences)
    exact = load(DATA / "lvm" / "long_single_header_multi_ch.lvm", rate=1024)
    assert exact["m_1"].time[-1] == pytest.approx(16383 / 1024)


@pytest.mark.parametrize(("name", "points", "frames", "missing"), [
    # Counted in these files with another reader.
    ("ktk_pc_int", 36, 89, 0.0712),
    ("ktk_pc_real", 36, 89, 0.0712),
    ("ktk_kinematics_tennis_serve_nan", 39, 1092, 0.0034),
])  # fmt: skip
def test_c3d_points_and_gaps(name, points, frames, missing):
    log = load(DATA / "c3d" / f"{name}.c3d")
    channels = [log[f"{marker}/position"] for marker in log.markers]
    assert (len(channels), len(channels[0].time)) == (points, frames)
    assert np.mean([~channel.valid for channel in channels]) == pytest.approx(missing, abs=5e-5)
    # A person: no marker further than some metres from the origin, in metres.
    assert 0.1 < np.nanmax([np.nanmax(np.abs(channel.values)) for channel in channels]) < 10


def test_c3d_integer_and_real_numbers_agree():
    whole, real = (load(DATA / "c3d" / f"ktk_pc_{kind}.c3d") for kind in ("int", "real"))
    for name in whole.channels:
        if name.endswith("/position"):
            # Integers step by 0.28 mm.
            np.testing.assert_allclose(whole[name].values, real[name].values, atol=0.29e-3)
    assert whole["analog/FX1"].unit == "N"
    assert whole["analog/MX1"].unit == "N·m"
    assert whole["analog/FX1"].rate == pytest.approx(200)


def test_c3d_pose_of_three_markers():
    log = load(DATA / "c3d" / "ktk_pc_int.c3d", bodies={"pelvis": ["RPV1", "RPV2", "RPV3"]})
    assert log.rigid_bodies == ("pelvis",)
    residual = log["pelvis/residual"].values
    # Markers on skin move by millimetres against each other.
    assert np.sqrt(np.nanmean(residual**2)) < 3e-3
    loose = r'the markers of "Derrick" move by .* are not one rigid body'
    refuses(DATA / "c3d" / "ktk_kinematics_tennis_serve_nan.c3d", loose, rigid_body="Derrick")


def test_vicon_markers_and_devices():
    log = load(DATA / "vicon" / "pyomeca_nexus_markers.csv")
    box = log["boite:gauche_ext/position"]
    np.testing.assert_allclose(box.values[0], [0.0441628, -0.276862, 0.675697], rtol=1e-12)
    np.testing.assert_allclose(box.time, np.arange(1, 581) / 100)
    devices = load(DATA / "vicon" / "pyomeca_nexus_devices_first3000lines.csv")
    assert devices.kind == "signals"
    emg = devices["Imported Analog EMG - Voltage/1"]
    assert (emg.unit, len(emg.values)) == ("V", 2995)
    # Frame 1, sub frame 1 of twenty, at 2000 Hz.
    np.testing.assert_allclose(emg.time[:2], [0.01, 0.0105], rtol=1e-12)
    box = load(DATA / "vicon" / "pyomeca_nexus_markers.csv", rigid_body="boite")
    # A box carried by hand: its eight markers keep their distances.
    assert np.nanmax(box["boite/residual"].values) < 5e-3


def test_static_points_given_as_a_running_log_are_refused():
    path = RCBENCHMARK / "sar_IM_StepsTestV2_2024-02-06_131025.csv"
    refuses(path, r"s apart .median.: averaged points, not a running log", static=False)
