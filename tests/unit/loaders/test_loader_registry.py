"""Detection by content, doubts as errors, and a format registered from outside the package."""

import sys
import textwrap

import h5py
import numpy as np
import pytest

from fakes.log_files import hdf5, refuses
from sysid.errors import LogError, SysidError, SysidWarning, UnitError
from sysid.loaders import LogFormat, detect, formats, load, registry
from sysid.loaders.readers import load_cell_csv

STAND = (
    "Time (s),ESC signal (µs),Thrust (N),Torque (N·m),Motor Optical Speed (RPM)\n"
    "0,1000,1,2,3\n1e-2,1000,1,2,3\n"
)
CELL = "Time (s),Command (us),Fz (N)\n0,1000,1\n1e-4,1000,1\n"
POSE = "t_s,x_m,y_m,z_m,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n0.01,0,0,0,1,0,0,0\n"
MOTIVE = "Format Version,1.23,Take Name,a\n\n"


@pytest.mark.parametrize(("content", "name"), [
    (STAND, "rcbenchmark-csv"),
    (CELL, "load-cell-csv"),
    ("Time (s),Command (us),Thrust (N),Torque (N·m)\n0,1,2,3\n", "load-cell-csv"),
    (POSE, "pose-table"),
    (MOTIVE, "motive-csv"),
])  # fmt: skip
def test_detect(write, content, name):
    assert detect(write(content, "wrong.h5")) == name
    assert detect(write("\ufeff" + content, "wrong.h5")) == name
    assert detect(write("\n\n" + content, "wrong.h5")) == name


@pytest.mark.parametrize("content", [
    "hello\n", "\n\n\n", "# only a comment\n", "1,2,3\n4,5,6\n", b"\x00\x01\x02", b"TDS\x0e\x00",
    "Devices\nnone\n",
])  # fmt: skip
def test_unknown_content_points_to_the_list_of_formats(write, content):
    with pytest.raises(LogError, match=r"not recognized .* 'sysid formats' lists .* format = "):
        detect(write(content))


def test_tie_names_candidates_and_the_option(write, monkeypatch):
    keen = LogFormat("keen", "claims all", lambda source: registry.CERTAIN, load_cell_csv.FORMAT.read)
    known = {**formats(), "keen": keen}
    monkeypatch.setattr(registry, "formats", lambda: known)
    path = write(CELL)
    refuses(path, r"fits load-cell-csv and keen; choose one with --format load-cell-csv")
    assert load(path, format="load-cell-csv").kind == "load-cell"


def test_missing_file_folder_and_empty_file(tmp_path, write):
    refuses(tmp_path / "absent.csv", r"absent\.csv: no such file")
    refuses(tmp_path, "is a folder")
    refuses(write(b""), "the file is empty")
    refuses("a\0b", r"no such file")


def test_unknown_format_and_option_name_the_nearest(write):
    path = write(CELL)
    refuses(path, 'did you mean "load-cell-csv"', format="loadcell-csv")
    refuses(path, r'no option "unit"; it has rate, units, .* did you mean "units"', unit={"thrust": "N"})
    # An option that is None is one that was not given, also where the format has no such option.
    assert load(path, quaternion_order=None).kind == "load-cell"


@pytest.mark.parametrize(("content", "message"), [
    ("Time (s),ESC signal (µs)\n0,1000\n", r'no column "Thrust".*found "Time \(s\)", "ESC signal \(µs\)"'),
    (STAND.replace("Thrust (N)", "Thrust (furlong)"), 'column "Thrust .furlong.": .*furlong'),
    (STAND.replace("Thrust (N)", "Thrust (V)"), 'column "Thrust .V.": .*dimension'),
    (STAND.replace("Thrust (N)", "Thrust"), 'column "Thrust" states no unit'),
    (STAND.splitlines()[0] + "\n", "no rows of numbers"),
    (STAND.splitlines()[0] + "\n# nothing\n\n", "no rows of numbers"),
    (STAND.replace("Time (s)", "Clock (s)"), 'no column "Time".*static = true'),
    (STAND.replace("Torque (N·m)", "Thrust (N)"), "columns 3 and 4 are both named"),
    (STAND + "0.02,1000,1,2,3\n0.01,1000,1,2,3\n", "line 5: time goes back from 0.02 s to 0.01 s"),
])  # fmt: skip
def test_thrust_stand_refusals(write, content, message):
    sentence = refuses(write(content), message, SysidError, format="rcbenchmark-csv")
    assert "log" in sentence.split(":")[0]


@pytest.mark.parametrize(("content", "options", "message"), [
    (CELL.replace("Fz (N)", "Force (N)"), {}, 'no column "Fz" or "Mz"; found'),
    (CELL.replace("(us)", "(V)"), {}, "has unit 'V'; expected us, dshot, 1 or %"),
    (CELL, {"rate": 0}, "rate = 0 is no sample rate"),
    (CELL, {"rate": "fast"}, "rate = 'fast': 'fast' is not a number with a unit"),
    (CELL, {"rate": "3 s"}, "rate = '3 s': unit 's' is not a 'Hz'"),
    (CELL, {"units": {"Fy": "N"}}, 'units names "Fy", which is no column'),
    (CELL, {"units": "N"}, "units = 'N' is no table"),
    (CELL, {"rate": 10.0}, "rate = 10 makes the log 0.1 s long but its time column spans 0.0001 s"),
    (CELL, {"columns": ["a"]}, "columns declares 1 names but line 1 has 3 cells"),
    ("0,1,2\n1e-4,2,3\n", {}, "found numbers where the header line should name the columns"),
    (CELL + "2e-4,1000,1,7\n", {}, "line 4: 4 cells where the header names 3 columns"),
    (CELL + "\n".join(["2e-4,1000"] * 9) + "\n", {}, "line 4: 2 cells where 3 are expected"),
    ("Time (s),Command (us),Fz (N)\n" + "0,1000,1\n" * 50, {}, "clock is too coarse; declare"),
])  # fmt: skip
def test_load_cell_refusals(write, content, options, message):
    refuses(write(content), message, SysidError, format="load-cell-csv", **options)


@pytest.mark.parametrize(("old", "new", "options", "message"), [
    ("qw,", "q9,", {}, 'no column "qw"; found'),
    ("x_m", "a_m", {}, 'no column "x"; found'),
    ("t_s", "u_s", {}, 'no column "t"; found'),
    ("x_m", "x_V", {}, 'column "x_V": .*dimension'),
    ("0.01,0,0,0,1,", "0.01,0,0,0,3,", {}, "line 3: the quaternion of body has length 3, expected 1"),
    ("t_s", "t", {"length_unit": "mm"}, 'length_unit = "mm" contradicts column "x_m"'),
    ("t_s", "t", {"length_unit": "kg"}, "length_unit: .*dimension"),
    ("0.01,", "10,", {"units": {"t_s": "parsec"}}, "'parsec' is not a 's'"),
    ("z_m", "y_m", {}, "both name component y"),
    ("t_s", "t", {"quaternion_order": "zyxw"}, 'expected "wxyz" or "xyzw"'),
    ("t_s", "t", {"rigid_body": ["a"]}, "a pose table has one body"),
])  # fmt: skip
def test_pose_refusals(write, old, new, options, message):
    refuses(write(POSE.replace(old, new)), message, SysidError, format="pose-table", **options)


def test_pose_time_that_cannot_be_seconds(write):
    path = write(POSE.replace("t_s", "t").replace("0.01,", "10,"))
    refuses(path, "states no unit and its steps of 10 cannot be seconds", SysidError)
    np.testing.assert_array_equal(load(path, units={"t": "ms"})["body/position"].time, [0, 0.01])


TOY = """
    import numpy as np
    from sysid.loaders.registry import CERTAIN, NO, LogFormat
    from sysid.recording import Channel, Recording

    def recognize(source):
        return CERTAIN if source.head.startswith(b"TOY") else NO

    def read(source, *, gain=1.0):
        values = np.frombuffer(source.read_bytes()[3:], dtype=np.uint8) * gain
        channel = Channel("thrust", "N", np.arange(values.size) * 0.5, values)
        return Recording("toy", {"thrust": channel}, source.provenance("toy", options={"gain": gain}))

    FORMAT = LogFormat("toy", "one byte per newton", recognize, read)
"""


def test_format_from_another_package(tmp_path, write, monkeypatch):
    # A package as pip leaves it: a module and a dist-info folder with one entry point.
    (tmp_path / "toy_format.py").write_text(textwrap.dedent(TOY), encoding="utf-8")
    info = tmp_path / "toy_format-1.0.dist-info"
    info.mkdir()
    metadata = "Metadata-Version: 2.1\nName: toy-format\nVersion: 1.0\n"
    (info / "METADATA").write_text(metadata, encoding="utf-8")
    (info / "entry_points.txt").write_text("[sysid.loaders]\ntoy = toy_format:FORMAT\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    try:
        path = write(b"TOY\x01\x02", "toy.csv")
        assert detect(path) == "toy"
        log = load(path, gain=2.0)
        np.testing.assert_array_equal(log["thrust"].values, [2, 4])
        assert log.provenance.format == "toy"
        (info / "entry_points.txt").write_text("[sysid.loaders]\ntoy = toy_format:ABSENT\n", encoding="utf-8")
        with pytest.warns(SysidWarning, match="'toy' cannot be loaded"):
            assert "toy" not in formats()
    finally:
        sys.modules.pop("toy_format", None)


def test_points_without_time_are_read_as_a_static_map(write):
    path = write(
        "ESC signal (µs);Torque (N·m);Thrust (kgf);Motor Optical Speed (RPM)\n"
        "1000;0,1;1,5;60\n1100;0,2;2;120\n"
    )
    log = load(path)
    assert log.kind == load(path, static=True).kind == "static-map"
    np.testing.assert_array_equal(log["torque"].time, [0, 1])
    np.testing.assert_allclose(log["thrust"].values, [14.709975, 19.6133])
    assert "log_time" not in log.channels


def test_hdf5_layouts_and_refusals(tmp_path):
    signals = {
        "a/Fz": ("gf", np.arange(4.0)), "b/Fz": ("gf", np.arange(4.0)), "a/time": (None, [0, 0.1, 0.2, 0.3]),
        "raw/volts": (None, np.arange(4)), "words": (None, ["no", "numbers"]), "Mz": (None, np.zeros((2, 2))),
    }  # fmt: skip
    path = hdf5(tmp_path / "log.bin", signals, device="cell 7")
    refuses(path, r"datasets /a/Fz and /b/Fz both look like thrust; choose with datasets")
    # Seconds or milliseconds: a file that does not say it is asked.
    question = r'column "time" states no unit; declare it, .* -o \'units = {time = "s"}\''
    refuses(path, question, SysidError, datasets={"thrust": "a/Fz"})
    milli = load(path, datasets={"thrust": "a/Fz"}, units={"time": "ms"})
    np.testing.assert_allclose(milli["thrust"].time, [0, 1e-4, 2e-4, 3e-4])
    with h5py.File(path, "a") as file:
        file["a/time"].attrs["unit"] = "s"
    log = load(path, datasets={"thrust": "a/Fz"})
    np.testing.assert_allclose(log["thrust"].values, np.arange(4) * 9.80665e-3)
    np.testing.assert_array_equal(log["thrust"].time, [0, 0.1, 0.2, 0.3])
    assert log.provenance.device == "cell 7"
    for options, message in [
        ({"datasets": {"thrust": "/b/Fz"}}, "has no clock"),
        ({"datasets": {"thrust": "/c/Fz"}}, r'no dataset /c/Fz; found "/Mz\[1\]", "/Mz\[2\]", "/a/Fz"'),
        ({"datasets": {"push": "/a/Fz"}}, 'datasets names "push"; it can name time, command'),
        ({"datasets": {"torque": "/words"}, "rate": 1.0}, "expected one row of numbers"),
        ({"datasets": {"torque": "/Mz"}, "rate": 1.0}, r'no dataset /Mz; found "/Mz\[1\]"'),
        ({"datasets": {"torque": "/raw/volts"}, "rate": 1.0}, 'column "volts" states no unit'),
        ({"datasets": {"speed": "/raw/volts"}, "rate": 1.0}, 'no dataset "Fz" or "Mz"'),
    ]:
        refuses(path, message, SysidError, **options)
    # Two rates in one file: each channel has its own clock.
    with h5py.File(path, "a") as file:
        file["raw/volts"].attrs["rate"] = 2.0
        file["raw/volts"].attrs["unit"] = "rpm"
    log = load(path, datasets={"thrust": "/a/Fz", "speed": "/raw/volts"})
    np.testing.assert_array_equal(log["speed"].time, [0, 0.5, 1, 1.5])
    np.testing.assert_array_equal(log["thrust"].time, [0, 0.1, 0.2, 0.3])


def test_a_time_of_a_stand_without_unit_is_asked_for(write):
    rows = "".join(f"{10 * i},1000,{0.1 * i:.1f}\n" for i in range(20))
    path = write("Time,ESC signal (µs),Thrust (N)\n" + rows)
    refuses(path, r'column "Time" states no unit; .* units = \{time = "s"\}', UnitError)
    assert load(path, units={"time": "ms"})["thrust"].time[-1] == pytest.approx(0.19, rel=1e-12)


def test_an_option_of_another_kind_is_refused(write):
    path = write("Time (s),ESC signal (µs),Thrust (N)\n0,1000,0\n0.1,1000,1\n")
    for value in ("no", "False", 1):
        refuses(path, f"static = {value!r} is neither true nor false", static=value)
    refuses(write("1,0,5,0,0,0.1\n" * 5), "calibration = 5 is no path", format="ati-text", calibration=5)
    capture = "NO_OF_FRAMES\t2\nFREQUENCY\t100\nDATA_INCLUDED\t3D\nMARKER_NAMES\ta\n1\t2\t3\n1\t2\t3\n"
    refuses(write(capture), "bodies gives q as 5, which is no list of markers", bodies={"q": 5})
