"""What a log means but does not state: units of names, axes that are no time, arrivals, averaged points."""

import re

import h5py
import numpy as np
import pytest

from fakes.log_files import LVM, ROS, hdf5, notes, refuses, row_lines, tdms
from sysid.errors import LogError, SysidError, UnitError
from sysid.loaders import load
from sysid.trials.look import inspect_recording

pytestmark = pytest.mark.usefixtures("in_this_process")


def test_a_unit_at_the_end_of_a_name_is_said(write):
    path = write("t_s,px_m,py_m,pz_m,qw,qx,qy,qz\n" + row_lines(5, "{t},1,2,3,1,0,0,0"))
    sentences = load(path).provenance.sentences
    assert any(sentence.startswith("units taken from the ends of names") for sentence in sentences)
    assert [str(note) for note in inspect_recording(load(path)).notes] == sentences
    for name in ("t_s", "px_m", "py_m", "pz_m"):
        assert f'"{name}"' in notes(load(path))
    # In brackets, or declared, nothing was guessed.
    path = write("t (s),px (m),py (m),pz (m),qw,qx,qy,qz\n" + row_lines(5, "{t},1,2,3,1,0,0,0"))
    assert "ends of names" not in notes(load(path))
    path = write("Time (s),Fz_N\n" + row_lines(5, "{t},1"))
    assert 'N of "Fz_N"' in notes(load(path))
    declared = load(path, units={"thrust": "gf"})
    np.testing.assert_allclose(declared["thrust"].values, 9.80665e-3)
    assert "ends of names" not in notes(declared)
    # A suffix of another dimension than the quantity's is refused, as a bracket is.
    refuses(write("Time (s),Fz_V\n" + row_lines(5, "{t},1")), r'column "Fz_V": .*dimension', UnitError)


@pytest.mark.parametrize(("axis", "factor"), [
    ("", 1.0),
    ("X_Dimension\tTime\n", 1.0),
    ("X_Dimension\tTime\nX_Unit_Label\tms\n", 1e-3),
    ("X_Unit_Label\tSeconds\n", 1.0),
])  # fmt: skip
def test_the_x_axis_of_lvm_is_time_in_the_unit_that_it_states(write, axis, factor):
    implied = load(write(LVM.format(columns="No", axis=axis) + "\t1\n\t2\n\t3\n"))["thrust"]
    np.testing.assert_allclose(implied.time, factor * np.array([2.0, 2.5, 3.0]))
    written = load(write(LVM.format(columns="One", axis=axis) + "0\t1\n4\t2\n5\t3\n"))["thrust"]
    np.testing.assert_allclose(written.time, factor * np.array([0.0, 4.0, 5.0]))


@pytest.mark.parametrize("axis", ["X_Dimension\tFrequency\n", "X_Unit_Label\tHz\n", "X_Unit_Label\tmm\n"])
def test_an_x_axis_of_lvm_that_is_no_time_is_refused(write, axis):
    path = write(LVM.format(columns="No", axis=axis) + "\t1\n\t2\n\t3\n")
    refuses(path, r"the header above line \d+ gives 'Fz' over \w+ in \w+, not over time")
    np.testing.assert_allclose(load(path, rate=4.0)["thrust"].time, [2.0, 2.25, 2.5])


def test_the_axis_of_a_tdms_waveform_counts_in_its_own_unit(tmp_path):
    values = np.arange(4.0)
    wave = {"wf_increment": 0.5, "wf_start_offset": 3.0, "unit_string": "N"}
    spectrum = ("cell", "FFT", values, {"wf_increment": 2.0, "wf_xunit_string": "Hz", "unit_string": "V"})
    force = ("cell", "Fz", values, wave | {"wf_xunit_string": "ms"})
    log = load(tdms(tmp_path / "a.tdms", [force, spectrum]))
    np.testing.assert_allclose(log["thrust"].time, [3e-3, 3.5e-3, 4e-3, 4.5e-3])
    assert list(log.channels) == ["thrust"]
    assert 'over another axis than time, left out: "/cell/FFT"' in notes(log)
    path = tdms(tmp_path / "b.tdms", [("cell", "Fz", values, wave)])
    np.testing.assert_allclose(load(path)["thrust"].time, [3.0, 3.5, 4.0, 4.5])


def test_times_beside_a_signal_say_their_unit_or_are_asked_for(tmp_path):
    values = np.arange(4.0)
    force = ("cell", "Fz", values, {"unit_string": "N"})
    path = tdms(tmp_path / "a.tdms", [force, ("cell", "Time", values, {})])
    refuses(path, 'column "Time" states no unit', UnitError)
    np.testing.assert_allclose(load(path, units={"time": "ms"})["thrust"].time, 1e-3 * values)
    stamps = np.datetime64("2026-01-01T00:00:00") + (500 * np.arange(4)).astype("timedelta64[ms]")
    path = tdms(tmp_path / "b.tdms", [force, ("cell", "Time", stamps.astype("datetime64[us]"), {})])
    np.testing.assert_allclose(load(path)["thrust"].time, 0.5 * values)


def test_a_name_alone_makes_no_ampere(tmp_path):
    wave = (np.arange(4.0), {"wf_increment": 0.5})
    log = load(tdms(tmp_path / "a.tdms", [("cell", "phase_A", *wave), ("cell", "Fz_N", *wave)]))
    assert log["phase_A"].unit == ""
    assert log["thrust"].unit == "N"
    assert any('N of "Fz_N"' in note and "phase" not in note for note in log.provenance.sentences)


STAND = "Time (s),ESC signal,Thrust (N),Motor Optical Speed (RPM)\n"


@pytest.mark.parametrize(("low", "high", "known"), [
    (1000, 1800, False), (0, 2047, True), (48, 1046, True), (0, 100, False),
])  # fmt: skip
def test_a_command_without_unit_is_dshot_only_where_nothing_else_looks_so(write, low, high, known):
    path = write(STAND + row_lines(9, f"{{t}},{low},1,2") + row_lines(9, f"1{{t}},{high},1,2"))
    if known:
        assert load(path)["command"].unit == "dshot"
        return
    looks, unit = ("percent", "%") if high == 100 else ("pulse widths in us", "us")
    refuses(path, f"runs from {low} to {high}, as {looks} do", UnitError)
    assert load(path, units={"command": unit})["command"].unit == unit


def arrivals(count=400):
    """Frames at 100 Hz, some lost, stamped when a network delivered them: 1 to 41 ms late."""
    random = np.random.default_rng(8)
    frames = np.delete(np.arange(7, 7 + count), [50, 51, 200])
    late = np.maximum.accumulate(frames / 100 + random.uniform(0.001, 0.041, frames.size))
    return frames, late + 1e-6 * np.arange(frames.size)


def test_jitter_of_arrival_is_taken_out_by_frame_numbers(write):
    frames, late = arrivals()
    text = "frame,t,x,y,z,qx,qy,qz,qw\n"
    text += "".join(f"{f},{t:.6f},{f},2,3,0,0,0,1\n" for f, t in zip(frames, late, strict=True))
    path = write(text)
    jittery = load(path, length_unit="m")
    assert 'gives a steady clock: clock = "frame"' in notes(jittery)
    log = load(path, length_unit="m", clock="frame")["body/position"]
    # The delays of 1 to 41 ms leave their mean in the clock, and 12 ms/sqrt(400) each way of it.
    np.testing.assert_allclose(log.time - frames / 100, 0.024, atol=4e-3)
    np.testing.assert_allclose(np.diff(log.time), np.diff(frames) / 100, rtol=2e-3)
    np.testing.assert_array_equal(log.values[:, 0], frames)
    refuses(write(text.replace("frame,", "n,")), 'no column "frame"', length_unit="m", clock="frame")
    other = "".join(f"{f},{t:.6f},1,2,3,0,0,0,1\n" for f, t in zip(frames, 3 * np.sqrt(late), strict=True))
    refuses(path, 'expected "auto", "time" or "frame"', length_unit="m", clock="soon")
    path = write(text.splitlines()[0] + "\n" + other)
    refuses(path, "do not belong together", length_unit="m", clock="frame")


def test_sequence_numbers_of_ros_messages_are_frames(write):
    frames, late = arrivals()
    lines = [
        f"{round(1e9 * t)},{f},{round(1e9 * t)},1,2,3,0,0,0,1" for f, t in zip(frames, late, strict=True)
    ]
    log = load(write("\n".join([ROS, *lines, ""])), clock="frame")["body/position"]
    np.testing.assert_allclose(np.diff(log.time), np.diff(frames) / 100, rtol=2e-3)
    bare = "\n".join([ROS.replace("seq", "other"), *lines, ""])
    refuses(write(bare), r"no column field\.header\.seq", SysidError, clock="frame")
    bare = "\n".join([ROS.replace("header.stamp", "other"), *lines, ""])
    refuses(write(bare), r"no column field\.header\.stamp", SysidError)


def test_a_time_column_of_another_language_is_named(write):
    path = write("Zeit (s);Befehl (us);Fz (N)\n" + row_lines(5, "{t};1000;1"))
    refuses(path, r'no time column among "Zeit \(s\)", .* name it with columns')
    log = load(path, columns={"time": "Zeit", "command": "Befehl"})
    assert (log["command"].unit, log["thrust"].time[1]) == ("us", 0.01)


def test_one_rate_for_datasets_of_other_lengths_and_a_rate_against_times_are_refused(tmp_path):
    path = tmp_path / "log.h5"

    def log(lengths, rate=None, time=None, speed_rate=None):
        signals = {
            name: ({"Fz": "N", "Speed": "rad/s"}[name], np.arange(float(n))) for name, n in lengths.items()
        }
        stated = {} if rate is None else {"rate": rate}
        hdf5(path, signals | ({} if time is None else {"time": ("s", time)}), **stated)
        if speed_rate is not None:
            with h5py.File(path, "a") as file:
                file["Speed"].attrs["rate"] = speed_rate
        return load(path)

    other = {"Fz": 10000, "Speed": 1000}
    with pytest.raises(LogError, match=r"/Speed has 1000 samples and /Fz has 10000, but both take one rate"):
        log(other, rate=10000)
    refuses(path, r"both take one rate of 5000 Hz", rate=5000)
    log(other, rate=10000, speed_rate=1000)
    assert load(path)["speed"].time[-1] == pytest.approx(0.999, rel=1e-12)
    # A sample more or less is how two devices stop.
    assert log({"Fz": 1000, "Speed": 999}, rate=1000)["speed"].time.size == 999
    times = np.arange(1000) / 500
    with pytest.raises(LogError, match=r"/Fz states 1000 Hz but its clock /time steps by 0\.002 s"):
        log({"Fz": 1000}, rate=1000, time=times)
    assert log({"Fz": 1000}, rate=500, time=times)["thrust"].time[-1] == pytest.approx(1.998, rel=1e-12)
    assert load(path, rate=1000)["thrust"].time[-1] == pytest.approx(0.999, rel=1e-12)


def test_a_delta_x_that_the_times_contradict_is_said(write):
    for step, noted in ((0.5, False), (0.001, True)):
        rows_ = "".join(f"{step * i if noted is False else i}\t{i}\n" for i in range(5))
        text = LVM.format(columns="One", axis="").replace("Delta_X\t0.5", f"Delta_X\t{step}")
        doubt = "states 1000 Hz but its column of times steps by 1 s"
        assert (doubt in notes(load(write(text + rows_)))) is noted


_VICON = (
    "Trajectories,,,,\n100,,,,\n,,a:m1,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n1,0,0,2,3\n2,0,1,2,3\n{blank}\n"
    "Devices,,,,\n200,,,,\n,,cell,,\nFrame,Sub Frame,Fz,,\n,,N,,\n1,0,5,,\n1,1,6,,\n{last},0,7,,\n2,1,8,,\n"
)


@pytest.mark.parametrize("blank", ["", ",,,,", "  ", ";\t "])
def test_vicon_sections_are_parted_by_any_blank_line(write, blank):
    path = write(_VICON.format(blank=blank, last=2), "log.csv")
    log = load(path)
    assert list(log["a:m1/position"].values[:, 0]) == [0.0, 1e-3]
    assert list(log["cell/Fz"].values) == [5.0, 6.0, 7.0, 8.0]


def test_time_that_goes_back_in_a_section_is_refused(write):
    refuses(write(_VICON.format(blank="", last=0), "log.csv"), "time goes back")


def test_hdf5_unit_may_be_an_array_of_one_text(tmp_path):
    path = tmp_path / "log.h5"
    hdf5(path, {"Fz": (np.array([b"mN"]), np.arange(20.0))}, rate=100.0)
    assert load(path)["thrust"].values[10] == pytest.approx(0.01, rel=1e-12)


POINTS = (
    "Time (s),ESC signal (µs),Torque (N·m),Thrust (gf),Voltage (V),Current (A),Motor Optical Speed (RPM),"
    "Electrical Power (W),Mechanical Power (W),App message,"
)


def point_rows():
    out = []
    for i in range(12):
        speed = 300.0 + 60.0 * i
        thrust, torque = 1.5e-5 * speed**2, 2.2e-7 * speed**2
        power = torque * speed / 0.75  # 75 % efficient
        out.append(
            f"{2.0 * i:.1f},{1100 + 60 * i},{torque:.6f},{thrust / 9.80665e-3:.3f},16.0,{power / 16:.3f},"
            f"{speed * 30 / np.pi:.1f},{power:.3f},{torque * speed:.3f},,"
        )
    return out


def stand_points(write, head, lines):
    return load(write("\n".join([head, *lines, ""]), "stand.csv"))


def test_a_whole_table_has_nothing_to_note(write):
    log = stand_points(write, POINTS, point_rows())
    assert log.kind == "static-map"
    assert {note.code for note in log.provenance.notes} == {"static-map", "optical-speed"}


@pytest.mark.parametrize(("lines", "points", "sentence"), [
    (lambda r: [x for row in r for x in (row, row)], 24, "rows that stand twice: 12 (first: line 3)"),
    (lambda r: r + r[3:], 21, "the clock starts again 1 times (first: line 14)"),
    (lambda r: [*r[:6], POINTS, *r[6:]], 12, "the header stands again in line 8"),
])  # fmt: skip
def test_joined_and_doubled_tables_are_noted(write, lines, points, sentence):
    log = stand_points(write, POINTS, lines(point_rows()))
    assert log.kind == "static-map"
    assert log["thrust"].values.size == points
    assert sentence in notes(log)


@pytest.mark.parametrize(("right", "wrong", "words"), [
    ("(gf)", "(kgf)", "thrust over torque × speed is"),
    ("(gf)", "(N)", "thrust over voltage × current is"),
    ("(N·m)", "(kN·m)", "torque × speed is .* which no motor gives"),
    ("(A)", "(mA)", "torque × speed is .* which no motor gives"),
    ("(N·m)", "(N·mm)", "thrust over torque × speed is"),
])  # fmt: skip
def test_a_unit_that_no_propeller_can_have_is_a_warning(write, right, wrong, words):
    found = [n for n in stand_points(write, POINTS.replace(right, wrong), point_rows()).provenance.notes
             if n.code == "implausible-power"]  # fmt: skip
    assert found
    assert all(finding.severity == "warning" for finding in found)
    assert any(re.search(words, finding.sentence) for finding in found)


def test_a_rotor_without_a_propeller_is_no_wrong_unit(write):
    bare = []
    noise = np.random.default_rng(3).normal(size=(12, 2))
    for row, (a, b) in zip(point_rows(), noise, strict=True):
        cells = row.split(",")
        cells[2], cells[3] = f"{1e-3 * a:.6f}", f"{5 * b:.3f}"
        bare.append(",".join(cells))
    assert "check the unit" not in notes(stand_points(write, POINTS, bare))


@pytest.mark.parametrize(("response", "unit", "levels", "found"), [
    (0.04, "s", (0.3, 0.7, 0.4, 0.9), False),
    (0.04, "ms", (0.3, 0.7, 0.4, 0.9), False),
    (40.0, "s", (0.3, 0.7, 0.4, 0.9), True),  # ms under the heading of s
    (1.0, "s", (0.3, 0.7, 0.4, 0.9), False),  # a large rotor
    (0.04, "s", (0.9, *np.linspace(0.1, 0.9, 20)), False),  # a staircase
])  # fmt: skip
def test_a_rotor_that_takes_many_seconds_has_a_wrong_clock(write, response, unit, levels, found):
    hold = 12.0 * response
    lines, speed = [], 0.0
    step = min(response / 8, 0.05) if response < 5 else response / 8
    for number, level in enumerate(levels):
        for k in range(round(hold / step)):
            speed += (600.0 * level - speed) * (1.0 - np.exp(-step / response))
            time = (number * hold + k * step) * (1000.0 if unit == "ms" else 1.0)
            lines.append(f"{time:.4f},{1000 + 1000 * level:.0f},{speed:.3f},{1e-7 * speed**2:.6f}")
    head = f"Time ({unit}),Command (us),Speed (rad/s),Mz (N·m)"
    log = load(write("\n".join([head, *lines, ""]), "steps.csv"))
    assert log.kind == "load-cell"
    clocks = [n for n in log.provenance.notes if n.code == "implausible-clock"]
    assert bool(clocks) == found
    assert not found or re.search(r"takes 30 s for half of its way", clocks[0].sentence)


def test_points_without_a_clock_are_points_where_the_command_differs(write):
    head, lines = POINTS.split(",", 1)[1], [row.split(",", 1)[1] for row in point_rows()]
    assert stand_points(write, head, lines).kind == "static-map"
    held = [lines[0]] * 30
    refuses(write("\n".join([head, *held, ""])), 'no column "Time".* static = true')
    refuses(write("\n".join([head, *lines, ""])), "rows have no clock", static=False)
    refuses(write("\n".join(["Clock (s)," + head, *point_rows(), ""])), "rows have no clock")
