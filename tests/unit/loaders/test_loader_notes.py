"""What the notes must state: rows that the instrument doubts, columns not read, units of another kind."""

import struct

import numpy as np
import pytest

from fakes.log_files import NET_FT, ROS, c3d, hdf5, notes, refuses
from sysid.errors import UnitError
from sysid.loaders import load

pytestmark = pytest.mark.usefixtures("in_this_process")


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
