"""Files that load without complaint and would mean something else: each is refused, noted or read right."""

import json
import re
import struct
import subprocess
import sys

import numpy as np
import pytest
from scipy.io import savemat
from typer.testing import CliRunner

from fakes.log_files import LBF_IN, NET_FT, ROS, c3d, hdf5, notes, refuses, row_lines, tdms
from sysid.cli import app
from sysid.errors import LogError, UnitError
from sysid.loaders import load
from sysid.storage import write_file
from sysid.units import factor_to_si
from sysid.workflows.inspect import inspect_files

pytestmark = pytest.mark.usefixtures("in_this_process")

COUNT = 300
RAMP = np.linspace(0.0, 6.0, COUNT)


def test_the_number_of_a_matrix_column_is_no_unit(tmp_path):
    path = tmp_path / "log.mat"
    savemat(path, {"Fs": 1000.0, "D": np.column_stack([1000 + RAMP, 2 * RAMP])})
    chosen = {"command": "D[1]", "thrust": "D[2]"}
    no_unit, options = r'"D\[1\]" states no unit; expected us, dshot, 1 or %', {"datasets": chosen}
    refuses(path, no_unit, UnitError, units={"thrust": "N"}, **options)
    log = load(path, units={"thrust": "N", "command": "us"}, **options)
    assert log["command"].unit == "us"
    np.testing.assert_array_equal(log["thrust"].values, 2 * RAMP)


def test_what_a_matlab_file_holds_besides_signals_is_named(tmp_path):
    path = tmp_path / "log.mat"
    cells = np.empty((1, 2), object)
    cells[0, 0] = cells[0, 1] = RAMP
    savemat(path, {"Fs": 1.0, "FT": np.tile(RAMP, (6, 1)), "c": cells, "z": RAMP + 1j, "ok": RAMP > 3})
    with pytest.raises(LogError) as refusal:
        load(path)
    # 300 columns are more than any sensor has: the matrix lies on its side.
    assert "passed over" in str(refusal.value)
    for words in ("FT (6 × 300 matrix)", "c (2 cells", "z (300 complex numbers)", "ok (300 logicals)"):
        assert words in str(refusal.value)


def test_a_column_of_an_hdf5_matrix_is_a_dataset(tmp_path):
    matrix = np.column_stack([k * RAMP for k in range(6)])
    path = hdf5(tmp_path / "log.h5", {"FT": ("N", matrix)}, rate=1000)
    log = load(path, datasets={"thrust": "/FT[3]"})
    np.testing.assert_array_equal(log["thrust"].values, 2 * RAMP)
    refuses(path, r'found "/FT\[1\]"')


def segments(path, starts, *, increment=1e-3):
    first = np.datetime64("2024-05-01T10:00:00", "us")
    stated = {"wf_increment": increment, "wf_start_offset": 0.0, "wf_samples": 100, "unit_string": "N"}
    begins = [{"wf_start_time": first + np.timedelta64(round(1e6 * start), "us")} for start in starts]
    return tdms(path, *([("g", "Fz", RAMP[:100], stated | begin)] for begin in begins))


def test_recordings_appended_to_one_tdms_after_a_pause_are_refused(tmp_path):
    path = segments(tmp_path / "a.tdms", [0, 10, 20])
    refuses(path, r"began 20 s after the first, but .* last 0\.2 s.* rate = 1000")
    glued = load(path, rate=1000)
    assert glued["thrust"].values.size == 300
    assert "all samples taken as consecutive" in notes(glued)
    # One recording written in blocks states the start of each block; its clock begins at the first.
    whole = load(segments(tmp_path / "b.tdms", [0, 0.1, 0.2]))
    np.testing.assert_allclose(whole["thrust"].time, 1e-3 * np.arange(300), atol=1e-12)
    assert "began at 2024-05-01T10:00:00.0" in notes(whole)


def test_a_whole_wf_increment_is_a_clock_and_a_temperature_is_none(tmp_path):
    log = load(segments(tmp_path / "a.tdms", [0], increment=1))
    np.testing.assert_allclose(log["thrust"].time, np.arange(100), atol=1e-12)
    wave = {"wf_increment": 1e-2}
    force = ("g", "Fz", RAMP, {**wave, "unit_string": "N"})
    warm = ("g", "T_deg", 20 + RAMP, {**wave, "unit_string": "°C"})
    log = load(tdms(tmp_path / "b.tdms", [force, warm]))
    np.testing.assert_allclose(log["thrust"].time, 1e-2 * np.arange(COUNT), atol=1e-12)
    np.testing.assert_array_equal(log["T_deg"].values, 20 + RAMP)


def tracker(rows):
    head = [
        "Objects", "100", ",,Global Angle d:d,,,,,,Global Angle e:e,,,,,,",
        "Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ,RX,RY,RZ,TX,TY,TZ,",
        ",,rad,rad,rad,mm,mm,mm,rad,rad,rad,mm,mm,mm,",
    ]  # fmt: skip
    return "\n".join([*head, *rows]) + "\n"


def test_a_lost_tracker_object_is_missing_and_takes_no_other_with_it(write):
    rows = []
    for i in range(40):
        first = "0,0,0,0,0,0," if 10 <= i < 15 else f"0,0,0.1,1,2,{i},"
        rows.append(f"{i + 1},0,{first}" + ("" if i in (20, 21) else "0,0,0.2,5,6,7,"))
    path = write(tracker(rows), "tracker.csv")
    log = load(path)
    assert log["d/position"].values[20, 2] == pytest.approx(0.020, rel=1e-12)
    lost = np.isnan(log["d/position"].values).any(axis=1)
    assert np.flatnonzero(lost).tolist() == [10, 11, 12, 13, 14]
    assert np.array_equal(lost, np.isnan(log["d/orientation"].values).any(axis=1))
    assert np.flatnonzero(np.isnan(log["e/position"].values).any(axis=1)).tolist() == [20, 21]
    assert "frames of d that are all zeros, taken as lost: 5" in notes(log)
    # A row cut inside a number has no delimiter behind it and is not trusted.
    rows[20] = rows[20].rstrip(",")
    path.write_text(tracker(rows), encoding="utf-8")
    assert 0.020 not in load(path)["d/position"].values[:, 2]


def capture(path, frames, **options):
    return notes(load(c3d(path, np.ones((frames, 1, 3)), labels=["A"], **options)))


def test_a_c3d_longer_than_its_header_counts_is_noted(tmp_path):
    assert "only the first 65535 frames were read" in capture(tmp_path / "long.c3d", 66000)
    full = capture(tmp_path / "full.c3d", 65535)
    assert "only the first" not in full
    assert "the capture may have gone on, so check its duration" in full


@pytest.mark.parametrize(
    ("trial", "words"), [((1, 65535), ""), ((1, 70000), "and the capture has 70000;"), ((4466, 70000), "")]
)
def test_a_c3d_says_in_its_trial_how_long_the_capture_is(tmp_path, trial, words):
    result = capture(tmp_path / "a.c3d", 65535, trial=trial)
    assert words in result
    assert ("only the first 65535 frames were read" in result) == bool(words)
    assert "may have gone on" not in result


def test_signals_of_unknown_unit_are_named(tmp_path, write):
    ones = np.ones(50)
    analogs = {"a0": ("in-lb", ones), "a1": ("quux", ones)}
    log = load(c3d(tmp_path / "a.c3d", np.ones((50, 1, 3)), analogs=analogs))
    np.testing.assert_allclose(log["analog/a0"].values, LBF_IN, rtol=1e-12)
    assert 'kept as recorded: "analog/a1 [quux]"' in notes(log)
    for unit, factor in (("in-lbs", 1 / 12), ("ft-lb", 1.0), ("ft-lbs", 1.0)):
        assert factor_to_si(unit, "N*m") == pytest.approx(1.3558179483314004 * factor, rel=1e-12)
    device = "Devices\n100\n,,Load\nFrame,Sub Frame,Pin 1\n,,quux\n"
    path = write(device + "".join(f"{i + 1},0,{i}\n" for i in range(30)), "vicon.csv")
    assert 'kept as recorded: "Load/Pin 1 [quux]"' in notes(load(path))


def test_whole_numbers_of_a_c3d_without_sign(tmp_path):
    numbers = np.array([0, 1, 32767, 32768, 65535] * 10)
    analogs = {"a0": ("N", numbers)}
    path = c3d(tmp_path / "a.c3d", np.ones((50, 1, 3)), analogs=analogs, form=["UNSIGNED"])
    data = path.read_bytes()
    # The same file as scaled whole numbers: a positive POINT:SCALE, also in the header, two bytes each.
    begin = (struct.unpack_from("<H", data, 16)[0] - 1) * 512
    reals = np.frombuffer(data[begin:], "<f4")[: 50 * 5]
    head = data[:begin].replace(struct.pack("<f", -1.0), struct.pack("<f", 1.0))
    for word, wanted in ((b"UNSIGNED", numbers), (b"SIGNED\0\0", numbers.astype(np.int16))):
        path.write_bytes(head.replace(b"UNSIGNED", word) + reals.astype(np.uint16).tobytes())
        np.testing.assert_array_equal(load(path)["analog/a0"].values, wanted)


ATI = {"format": "ati-text", "units": {"force": "N", "torque": "N*m"}}


def test_two_ati_columns_that_may_be_the_time_are_refused(write):
    path = write("".join(f"{0.1 * i:.1f},1,2,3,4,5,{0.01 * i:.2f}\n" for i in range(60)))
    refuses(path, "either may be the time", **ATI)
    stated = ATI | {"units": {**ATI["units"], "time": "s"}}
    assert load(path, **stated)["thrust"].values[0] == 3.0


@pytest.mark.parametrize("fault", ["pause", "repeated", "damaged", "none"])
def test_an_ati_time_in_the_last_column_is_refused(write, fault):
    time = 0.01 * np.arange(300)
    time[150:] += 2.0 * (fault == "pause")
    time = np.floor(time / 0.03) * 0.03 if fault == "repeated" else time
    time[77] += 50.0 * (fault == "damaged")
    path = write("".join(f"{np.sin(7.0 * i):.6f},1,2,0.1,0.2,0.3,{t:.3f}\n" for i, t in enumerate(time)))
    how = "rises steadily" if fault == "none" else "hardly ever falls"
    refuses(path, f"the last of seven columns {how}, as a time does, and the first", **ATI, rate=100)


def test_a_time_in_front_of_an_ati_torque_that_drifts_up_is_the_time(write):
    # The torque drifts up in steps of the converter's last bit.
    drift = np.round(np.linspace(0, 0.03, 300) + 2e-3 * np.sin(7.0 * np.arange(300)), 3)
    path = write("".join(f"{0.01 * i:.3f},1,2,3,4,5,{z:.3f}\n" for i, z in enumerate(drift)))
    np.testing.assert_allclose(load(path, **ATI)["torque"].values, drift)
    # A time in whole seconds hardly rises.
    path = write("".join(f"{i // 100},1,2,3,4,5,{z:.3f}\n" for i, z in enumerate(drift)))
    np.testing.assert_allclose(load(path, **ATI, rate=100)["torque"].values, drift)


@pytest.mark.parametrize("options", [{"rate": 100}, {"time_back": "drop"}])
def test_six_ati_loads_and_a_status_are_not_read_as_a_time_and_six_loads(write, options):
    path = write("".join(f"{np.sin(7 * i):.6f},1,2,3,4,5,0\n" for i in range(300)))
    refuses(path, r"the first of seven columns falls in \d+ steps, so it is no time", **ATI, **options)


STAND_HERTZ = "Time (s),ESC signal (µs),Thrust (N),Motor {} Speed (Hz)\n"


@pytest.mark.parametrize(("head", "row", "name"), [
    ("Time (s),Speed (Hz),Fz (N)\n", "{t},{i},{i}", "speed"),
    (STAND_HERTZ.format("Electrical"), "{t},1000,{i},{i}", "speed_electrical"),
    (STAND_HERTZ.format("Optical"), "{t},1000,{i},{i}", "speed_optical"),
])  # fmt: skip
def test_a_speed_in_hertz_is_advised_to_be_revolutions(write, head, row, name):
    path = write(head + row_lines(30, row))
    refuses(path, f'declare units = {{{name} = "rev/s"}}', UnitError)
    log = load(path, units={name: "rev/s"})
    for channel in (name, "speed"):
        np.testing.assert_allclose(log[channel].values, 2 * np.pi * np.arange(30), rtol=1e-12)
    assert "read in the declared unit 'rev/s'" in notes(log)


def test_inspect_reports_each_log_and_refuses_at_the_end(write, capsys):
    good = write("Time (s),Fz (N)\n" + row_lines(30, "{t},{i}"), "good.csv")
    bad = write("Time (s),Fz (N)\n", "bad.csv")
    with pytest.raises(LogError, match=r"bad\.csv.*1 of 3 logs refused"):
        inspect_files([good, bad, good], as_json=True)
    entries = json.loads(capsys.readouterr().out)
    assert [("error" in entry) for entry in entries] == [False, True, False]


def test_the_command_inspect_shows_and_draws_the_logs_around_a_bad_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time = np.arange(0, 3, 0.01)
    for name, level in (("a.csv", 3.0), ("c.csv", 7.0)):
        rows = "".join(f"{t:.2f},{level + np.sin(t):.4f}\n" for t in time)
        (tmp_path / name).write_text("Time (s),Fz (N)\n" + rows, encoding="utf-8")
    (tmp_path / "bad.csv").write_text("Time (s),Fz (N)\n", encoding="utf-8")
    result = CliRunner().invoke(
        app, ["inspect", "a.csv", "bad.csv", "c.csv", "--figure", "look.png", "--details"]
    )
    assert isinstance(result.exception, LogError)
    assert re.search(r"bad\.csv.*1 of 3 logs refused", str(result.exception))
    for words in ("a.csv", "c.csv", "refused: bad.csv", "wrote look.png"):
        assert words in result.stdout
    assert result.stdout.count("thrust") >= 2
    drawn = (tmp_path / "look.png").read_bytes()
    assert drawn.startswith(b"\x89PNG")
    # The figure shows the good logs alone.
    assert CliRunner().invoke(app, ["inspect", "a.csv", "c.csv", "--figure", "two.png"]).exit_code == 0
    assert struct.unpack_from(">2I", drawn, 16) == struct.unpack_from(
        ">2I", (tmp_path / "two.png").read_bytes(), 16
    )
    # Without a good log nothing is drawn; the process exits with 2 and one sentence.
    ended = subprocess.run(
        [sys.executable, "-m", "sysid", "inspect", "bad.csv", "bad.csv", "--figure", "none.png"],
        capture_output=True, text=True, encoding="utf-8", check=False,
    )  # fmt: skip
    assert ended.returncode == 2
    assert "2 of 2 logs refused" in ended.stderr
    assert "Traceback" not in ended.stderr
    assert not (tmp_path / "none.png").exists()


def test_a_missing_folder_is_not_a_full_disk(tmp_path):
    with pytest.raises(LogError, match=r"the folder .*nowhere does not exist"):
        write_file(tmp_path / "nowhere" / "x.h5", b"1", LogError)


def test_a_qualisys_cell_is_named_as_the_file_names_it(write):
    head = "NO_OF_FRAMES\t2\nNO_OF_BODIES\t1\nFREQUENCY\t100\nDATA_INCLUDED\t6D\nBODY_NAMES\tB2\n"
    names = ["Frame", "Time", "B2 X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual"]
    head += "\t".join([*names, *(f"Rot[{i}]" for i in range(9))]) + "\n"
    rest = "\t1\t1" + "\t0" * 4 + "\t1\t0\t0\t0\t1\t0\t0\t0\t1\n"
    refuses(write(head + "1\t0.00\tx9" + rest + "2\t0.01\t1" + rest), "'x9' in column 'B2 X'")


def test_net_ft_rows_with_a_status_are_counted(write):
    status = ["0", "0x0", "00000000", "80010000", "0", "0000000A", "80010000", "0"]
    rows = "".join(f"{s}, {i}, {i}, 1, 2, 3, 4, 5, 6, 0:0:{i}\n" for i, s in enumerate(status))
    log = load(write(NET_FT.format(10) + rows))
    assert 'rows with a status other than 0: 3 (first: line 10; "80010000", "0000000A")' in notes(log)
    np.testing.assert_array_equal(log["thrust"].values, 3 * 0.1)  # kept, with a note
    rows = rows.replace("80010000", "0").replace("0000000A", "0x0")
    assert "status" not in notes(load(write(NET_FT.format(10) + rows)))


STAND = "Time (s),ESC signal (µs),Servo 1 (µs),Thrust (N),Motor Optical Speed (RPM),App message,Mark,\n"
CELL = "Time (s),Fz (N),Note no,Temp (degC)\n"
POSE = "t,x_m,y_m,z_m,qw,qx,qy,qz,error_m\n"


@pytest.mark.parametrize(("head", "row", "named"), [
    (STAND, "{t},1000,1500,2,{i},,7,\n", '"Servo 1 (µs)", "Mark"'),
    (CELL, "{t},1,{i},20\n", '"Note no", "Temp (degC)"'),
    (POSE, "{t},0,0,0,1,0,0,0,0.1\n", '"error_m"'),
    (ROS + ",field.extra\n", "{n},{i},{n},0,0,0,0,0,0,1,5\n", '"%time", "field.header.seq", "field.extra"'),
])  # fmt: skip
def test_columns_that_are_not_read_are_named(write, head, row, named):
    rows = "".join(row.format(t=f"{i * 0.01:.2f}", i=i, n=10**18 + i * 10**7) for i in range(20))
    sentences = notes(load(write(head + rows)))
    assert f"columns not read: {named}" in sentences
    assert sentences.count("not read") == 1


def test_datasets_that_are_not_read_are_named(tmp_path):
    signals = {"Fz": "N", "Mz": "N*m", "Strain 1": "N"}
    path = hdf5(tmp_path / "log.h5", {k: (unit, np.arange(50.0)) for k, unit in signals.items()}, rate=100.0)
    assert 'datasets not read: "/Strain 1"' in notes(load(path))
    # Named by the user, the others are left out on purpose.
    assert "not read" not in notes(load(path, datasets={"thrust": "Fz"}))


@pytest.mark.parametrize("units", [("deg", "deg", "rad"), ("deg", "", "deg")])
def test_vicon_angles_in_two_units_are_refused(write, units):
    text = "Segments\n100\n,,q:q\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,{},{},{},mm,mm,mm\n" + "".join(
        f"{i + 1},0,10,0,0,1,2,3\n" for i in range(9)
    )
    with pytest.raises(UnitError, match='line 5: the angles of "q" are in') as caught:
        load(write(text.format(*units)), angles="XYZ")
    assert " and ".join(sorted({item or "no unit" for item in units})) in str(caught.value)
    log = load(write(text.format("deg", "deg", "deg")), angles="XYZ")
    # Half of 10 degrees about x.
    assert log["q/orientation"].values[0, 1] == pytest.approx(np.sin(np.radians(5.0)), rel=1e-12)


def stamped(stamps):
    return ROS + "\n" + "".join(f"{s},{i},{s},{i},0,0,0,0,0,1\n" for i, s in enumerate(stamps))


def test_ros_stamps_in_seconds(write):
    log = load(write(stamped([f"{1.6e9 + i * 0.01:.4f}" for i in range(40)])))
    assert log["body/position"].rate == pytest.approx(100.0, rel=1e-4)  # a float of 1.6e9 s ends at 0.24 µs
    assert "read as seconds, not as nanoseconds" in notes(log)
    assert "as seconds" not in notes(load(write(stamped([10**18 + i * 10**7 for i in range(40)]))))
    # Microseconds or milliseconds as whole numbers are neither: not guessed.
    for step in (10, 1):
        path = write(stamped([1_600_000_000_000 + i * step for i in range(40)]))
        refuses(path, f"steps by {step}, too little for nanoseconds")


def test_qualisys_frequency_with_a_decimal_comma(write):
    head = "NO_OF_FRAMES\t9\nNO_OF_MARKERS\t1\nFREQUENCY\t{}\nDATA_INCLUDED\t3D\nMARKER_NAMES\tm\n"
    rows = "".join(f"{i}\t2\t3\n" for i in range(1, 10))
    assert load(write(head.format("99,5") + rows))["m/position"].rate == pytest.approx(99.5)
    refuses(write(head.format("1,000,5") + rows), "the header states no FREQUENCY")


def test_a_log_cut_at_the_end_of_a_row_is_told_by_its_header(write, tmp_path):
    lvm = (
        "LabVIEW Measurement\nX_Columns\tNo\n***End_of_Header***\n\nChannels\t1\nSamples\t60\n"
        "Y_Unit_Label\tN\nDelta_X\t0.01\n***End_of_Header***\nX_Value\tFz\tComment\n"
    )
    qualisys = "NO_OF_FRAMES\t60\nNO_OF_MARKERS\t1\nFREQUENCY\t100\nDATA_INCLUDED\t3D\nMARKER_NAMES\tm\n"
    motive = (
        "Format Version,1.23,Export Frame Rate,100,Total Exported Frames,60,Rotation Type,Quaternion,"
        "Length Units,Meters\n\n,Type,Marker,Marker,Marker\n,Name,a,a,a\n,ID,1,1,1\n"
        ",,Position,Position,Position\nFrame,Time (Seconds),X,Y,Z\n"
    )
    for head, row, word in [
        (lvm, "\t{i}\n", "Samples"),
        (qualisys, "{i}\t2\t3\n", "NO_OF_FRAMES"),
        (motive, "{i},{t},1,2,3\n", "Total Exported Frames"),
    ]:
        rows = [row.format(i=i, t=f"{i * 0.01:.6f}") for i in range(60)]
        assert "the log was cut" not in notes(load(write(head + "".join(rows))))
        sentences = notes(load(write(head + "".join(rows[:-7]))))
        assert f"{word} is 60 but 53 rows are there: the log was cut, or rows were left out" in sentences


def test_a_c3d_cut_between_frames(tmp_path):
    path = c3d(tmp_path / "log.c3d", np.ones((50, 2, 3)), labels=["a", "b"])
    assert "was cut" not in notes(load(path))
    data = path.read_bytes()
    begin = (struct.unpack_from("<H", data, 16)[0] - 1) * 512  # of two points of four floats of four bytes
    path.write_bytes(data[: begin + 42 * 32])
    log = load(path)
    assert len(log["a/position"].values) == 42
    assert "the header's number of frames is 50 but 42 rows are there: the log was cut" in notes(log)


TABLE = "Time (s){0}Speed (rad/s){0}Fz (N)\n" + "".join(f"{i}.5{{0}}{i}.25{{0}}7.125\n" for i in range(12))


@pytest.mark.parametrize("before", [
    "sep=;\n", '"sep=;"\r\n', "SEP=;;;\n", "Recorded by Bob\n\n", "thrust stand log of 3 May 2024;;\n",
    "# a\nRun 7\n",
])  # fmt: skip
def test_lines_before_the_header(write, before):
    text = TABLE.format(";").replace(".", ",")
    plain, other = load(write(text)), load(write(before + text, "other"))
    for name, channel in plain.channels.items():
        np.testing.assert_array_equal(other[name].values, channel.values)
        np.testing.assert_array_equal(other[name].time, channel.time)
    refuses(write(before + text.replace("2,5;", "x;")), f"line {before.count(chr(10)) + 4}: 'x' in column")


def test_the_separator_line_of_excel_before_a_capture(write):
    vicon = "Trajectories\n100\n;;a;;\nFrame;Sub Frame;X;Y;Z\n;;mm;mm;mm\n"
    rows = "".join(f"{i + 1};0;{i};2;3\n" for i in range(9))
    log = load(write("sep=;\n" + vicon + rows))
    np.testing.assert_array_equal(log["a/position"].values[:, 0], np.arange(9) * 1e-3)
    refuses(write("sep=;\n" + vicon + rows.replace("2;0;1;", "2;0;x;")), "line 8: 'x' in column")


def test_a_table_of_settings_before_the_header_is_refused(write):
    refuses(write("Operator;Bob\nDate;2024-05-03\n" + TABLE.format(";")), r"not recognized|no column")


@pytest.mark.parametrize("rate", ["150;75;500", "150,0;75;500"])
@pytest.mark.parametrize("mark", [";", "\t"])
def test_ati_text_with_decimal_commas(write, rate, mark):
    head = f"First line indicates sampling freq [Hz]\nFx;Fy;Fz;Tx;Ty;Tz\n{rate}\n".replace(";", mark)
    rows = "".join(f"0,125;-0,25;{i},5;1;2;3\n".replace(";", mark) for i in range(20))
    log = load(write(head + rows), units={"force": "N", "torque": "N*m"})
    np.testing.assert_array_equal(log["thrust"].values, np.arange(20) + 0.5)
    np.testing.assert_array_equal(log["force_x"].values, 0.125)
    assert log["thrust"].rate == pytest.approx(150.0)


def test_marks_between_thousands_are_never_decimals(write):
    def table(cells, time="{i}"):
        rows = "".join(f"{time.format(i=i)};{cell}\n" for i, cell in enumerate(cells))
        return "Time (s);Fz (N)\n" + rows

    # One thousand, or one: nothing in the table tells.
    for cells in (["950", "1,000", "1,050"], ["1,000"] * 3, ["-2,500", "0", "0"], ["1,000,000"] * 3):
        refuses(write(table(cells)), "may have three decimals or be one of thousands, and no other")
    for cells in (["1,000.5", "2", "3"], ["1,5", "1,000,000", "2"], ["1.000,5", "1", "2"]):
        refuses(write(table(cells)), "is not a number")
    refuses(write('Time (s),Fz (N)\n0,1\n1,"1,000"\n2,3\n'), "is not a number")
    # A decimal in another cell, however late, tells.
    for cells, time in ((["1,000", "2,500", "3,250"], "0,{i}"), (["1,000", "2,500", "0,125"], "{i}")):
        values = load(write(table(cells, time)))["thrust"].values
        np.testing.assert_array_equal(values, [float(cell.replace(",", ".")) for cell in cells])
