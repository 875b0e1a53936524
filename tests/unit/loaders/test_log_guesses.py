"""What a newcomer is told of a log that is refused: what it is, what is in it, and all that it lacks."""

import io
import re
import zipfile
from itertools import pairwise

import numpy as np
import pytest

from fakes.log_files import notes, refuses
from fakes.shells import words_of
from sysid.errors import LogError, SysidError
from sysid.loaders import load
from sysid.workflows.inspect import inspect_files, parse_options

ROWS = 200


def lines(header, *columns):
    """A table of `ROWS` rows whose columns are functions of the row number."""
    rows = (",".join(f"{column(i):.6g}" for column in columns) for i in range(ROWS))
    return "\n".join([header, *rows, ""])


def told(path, capsys, **options):
    """Inspect a log that is refused; return what is printed, and the words of the command that is offered."""
    with pytest.raises(SysidError):
        inspect_files([path], options=options)
    text = capsys.readouterr().out
    command = re.search(r"(?m)^ +(sysid inspect .*)$", text)
    return text, words_of(command[1]) if command else []


def offered(words):
    """Return the format and the loader options of an offered command."""
    form = words[words.index("--format") + 1] if "--format" in words else "auto"
    return form, parse_options([word for flag, word in pairwise(words) if flag == "-o"])


def milliseconds(i):
    return 8.0 * i


def still(i):
    return 0.0


@pytest.mark.parametrize(("content", "form", "options"), [
    (
        lines("timestamp_ms,pwm_us,motor_rpm,load_g,vbat", milliseconds, lambda i: 1000 + i, lambda i: 70 * i,
              lambda i: 3.1 * i, lambda i: 16 - i / 1000),
        "load-cell-csv",
        {"columns": {"time": "timestamp_ms", "speed": "motor_rpm", "thrust": "load_g", "voltage": "vbat",
                     "command": "pwm_us"}, "units": {"thrust": "gf", "voltage": "V"}},
    ),
    (
        lines("t,x,y,z,q0,q1,q2,q3", milliseconds, lambda i: 1000 + i, milliseconds, *[still] * 4,
              lambda i: 1),
        "auto", {"quaternion_order": "xyzw", "length_unit": "mm", "units": {"t": "ms"}},
    ),
    (
        lines("Time (s),ESC signal,Thrust (g),Motor Optical Speed", lambda i: 0.008 * i, lambda i: 1000 + i,
              milliseconds, lambda i: 40 * i),
        "auto", {"units": {"ESC signal": "us", "Thrust (g)": "gf", "Motor Optical Speed": "rpm"}},
    ),
    (
        lines("ros_time,pos_x,pos_y,pos_z,quat_w,quat_x,quat_y,quat_z", lambda i: 0.008 * i, still, still,
              lambda i: i / 100, lambda i: 1, still, still, still),
        "pose-table",
        {"columns": {"t": "ros_time"} | {axis: f"pos_{axis}" for axis in "xyz"}
         | {f"q{axis}": f"quat_{axis}" for axis in "wxyz"}, "length_unit": "m"},
    ),
    (
        lines("Zeit,PWM,Drehzahl,Schub,Drehmoment", lambda i: i / 50, lambda i: 1000 + i, lambda i: 40 * i,
              lambda i: i / 50, lambda i: i / 5000),
        "load-cell-csv",
        {"columns": {"time": "Zeit", "speed": "Drehzahl", "torque": "Drehmoment", "thrust": "Schub",
                     "command": "PWM"},
         "units": {"time": "s", "speed": "rpm", "thrust": "N", "torque": "N*m", "command": "us"}},
    ),
    (  # A slow motor, whose speed could as well be in rad/s.
        lines("time,esc,thrust,rpm", lambda i: i / 50, lambda i: 1000 + i, lambda i: i / 50,
              lambda i: 5 * i),
        "load-cell-csv",
        {"columns": {"time": "time", "speed": "rpm", "thrust": "thrust", "command": "esc"},
         "units": {"time": "s", "speed": "rpm", "thrust": "N", "command": "us"}},
    ),
    (  # Columns that the format of the content passes over.
        lines("timestamp,omega,load_cell_1,moment", lambda i: i / 50, lambda i: 6 * i, lambda i: i / 50,
              lambda i: i / 5000),
        "load-cell-csv",
        {"columns": {"time": "timestamp", "speed": "omega", "torque": "moment", "thrust": "load_cell_1"},
         "units": {"time": "s", "speed": "rad/s", "thrust": "N", "torque": "N*m"}},
    ),
], ids=["names of a lab", "poses", "stand", "other poses", "language", "slow", "passed over"])  # fmt: skip
def test_one_command_has_all_that_a_log_lacks(write, capsys, content, form, options):
    path = write(content)
    text, words = told(path, capsys)
    assert offered(words) == (form, options)
    assert all(name in text for name in content.splitlines()[0].split(","))
    load(path, format=form, **options)  # the offered options suffice


def test_what_nothing_in_the_log_tells_stands_as_todo_which_is_refused(write, capsys):
    path = write(lines("Fz,Mz,rpm", lambda i: i / 10, lambda i: i / 1e4, milliseconds))
    _, words = told(path, capsys)
    form, options = offered(words)
    assert (form, options) == ("auto", {"rate": "TODO Hz", "units": {"Fz": "N", "Mz": "N*m"}})
    refuses(path, "rate = 'TODO Hz': 'TODO Hz' is not a number with a unit", SysidError, **options)
    assert load(path, **(options | {"rate": "1 kHz"}))["speed"].time.size == ROWS


def test_given_columns_stay_and_the_format_is_offered_with_them(write, capsys):
    path = write(lines("a,motor_rpm,load_g", milliseconds, lambda i: 40 * i, lambda i: 3.1 * i))
    columns = {"time": "a", "speed": "motor_rpm", "thrust": "load_g"}
    _, words = told(path, capsys, columns=columns)
    units = {"time": "ms", "thrust": "gf"}
    assert offered(words) == ("load-cell-csv", {"columns": columns, "units": units})


def test_a_log_that_is_read_without_its_speed_is_offered_with_it(write, capsys):
    path = write(
        lines("Time [ms],ESC [us],Motor speed [rpm],Thrust [gf]", milliseconds, lambda i: 1000 + i,
              lambda i: 40 * i, milliseconds)
    )  # fmt: skip
    assert "speed" not in load(path).channels
    inspect_files([path])
    text = capsys.readouterr().out
    assert "columns that are not read" in text
    form, options = offered(words_of(re.search(r"(?m)^ +(sysid inspect .*)$", text)[1]))
    assert load(path, format=form, **options)["speed"].values[1] == pytest.approx(40 * np.pi / 30)


def test_units_may_stand_in_a_row_of_their_own(write):
    content = lines("Time,PWM,Speed,Fz,Note", lambda i: i / 50, lambda i: 1000 + i, lambda i: 40 * i,
                    milliseconds, still)  # fmt: skip
    path = write(content.replace("Note\n", "Note\ns,us,[rpm],gf,\n"))
    log = load(path, format="load-cell-csv")
    assert log["thrust"].values[1] == pytest.approx(8 * 9.80665e-3)
    assert log["speed"].values[1] == pytest.approx(40 * np.pi / 30)
    assert log["command"].unit == "us"
    assert log["speed"].time.size == ROWS
    # A row of words is none of units.
    path.write_text(content.replace("Note\n", "Note\ns,us,rpm,fast,\n"), encoding="utf-8")
    with pytest.raises(SysidError):
        load(path, format="load-cell-csv")


def test_columns_of_unknown_names_are_asked_for(write, capsys):
    text, words = told(write(lines("c1,c2,c3", milliseconds, still, still)), capsys)
    assert not words
    assert '--format load-cell-csv -o \'columns = {time = "c1", speed = "TODO"' in text


def test_what_is_given_stays_in_the_offered_command(write, capsys):
    path = write(lines("Fz,Mz", lambda i: i / 10, lambda i: i / 1e4))
    _, words = told(path, capsys, rate="1 kHz", units={"Fz": "mN"})
    assert offered(words)[1] == {"rate": "1 kHz", "units": {"Fz": "mN", "Mz": "N*m"}}


def test_a_table_of_another_trade_is_shown_without_advice(write, capsys):
    text, words = told(write("date,place,people\n2020,here,7\n2021,there,8\n"), capsys)
    assert re.search(r"people +7 +8", text)
    assert not words


def test_a_fault_that_no_option_mends_is_named_behind_the_options(write, capsys):
    content = lines("Time,Fz (N),Mz (N·m)", lambda i: i / 1000, still, lambda i: -i % 7)
    path = write(content.replace("\n0.05,0,", "\n0.05,one,"))
    text, words = told(path, capsys)
    assert offered(words)[1] == {"units": {"Time": "s"}}
    assert "even then: " in text
    assert "'one' in column 'Fz (N)' is not a number" in text


def archive(*names):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as whole:
        for name in names:
            whole.writestr(name, "1,2,3\n" * 100)
    return data.getvalue()


@pytest.mark.parametrize(("data", "sentence"), [
    (b"%PDF-1.7\n1 0 obj", "is a PDF, no log; export the numbers themselves as CSV"),
    (archive("[Content_Types].xml", "xl/workbook.xml"), "is an Excel workbook, no log; save its"),
    (archive("log.csv"), "is a ZIP archive, no log; unpack it and give the log inside"),
    (bytes.fromhex("d0cf11e0a1b11ae1") + bytes(600), "is an old Excel workbook"),
    (b"\x89PNG\r\n\x1a\n" + bytes(range(256)), "is a PNG image, no log"),
    (b"\xff\xd8\xff\xe0\x00\x10JFIF", "is a JPEG image, no log"),
    (b"\n <!DOCTYPE HTML><html>", "is a web page, no log; download the log itself"),
    (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "git lfs pull"),
])  # fmt: skip
@pytest.mark.parametrize("form", ["auto", "rcbenchmark-csv"])
def test_a_file_that_is_no_log_is_named_as_what_it_is(tmp_path, data, sentence, form):
    path = tmp_path / "log.csv"
    path.write_bytes(data)
    with pytest.raises(LogError, match=re.escape(sentence)):
        load(path, format=form)


@pytest.mark.parametrize(("code", "mark"), [
    ("utf-16-le", b"\xff\xfe"), ("utf-16-be", b"\xfe\xff"), ("utf-16-le", b""), ("utf-16-be", b""),
    ("utf-16-le", b"\xff\xfe\xff\xfe"),
])  # fmt: skip
def test_text_in_utf_16_is_read_with_and_without_a_mark(tmp_path, code, mark):
    """The last is a text with a mark that was converted and marked again."""
    content = lines("Time (s),ESC signal (µs),Thrust (N)", lambda i: i / 100, lambda i: 1000, milliseconds)
    path = tmp_path / "log.csv"
    path.write_bytes(mark + content.encode(code))
    log = load(path)
    np.testing.assert_array_equal(log["thrust"].values, 8.0 * np.arange(ROWS))
    assert "read as UTF-16" in notes(log)
