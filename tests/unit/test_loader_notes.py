"""What a reader must be told: rows that the instrument doubts, columns not read, units of another kind."""

import re

import h5py
import numpy as np
import pytest

from sysid.errors import LogError, UnitError
from sysid.loaders import load


@pytest.fixture
def write(tmp_path):
    def write(content, name="log"):
        path = tmp_path / name
        path.write_text(content, encoding="utf-8")
        return path

    return write


def notes(recording):
    return " | ".join(recording.provenance.notes)


NET = (
    "RDT Sample Rate: 100\nForce Units: N\nCounts per Unit Force: 10\nTorque Units: Nm\n"
    "Counts per Unit Torque: 10\nStatus (hex), RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time\n"
)


def test_net_ft_rows_with_a_status_are_counted(write):
    status = ["0", "0x0", "00000000", "80010000", "0", "0x8", "80010000", "0"]
    rows = "".join(f"{s}, {i}, {i}, 1, 2, 3, 4, 5, 6, 0:0:{i}\n" for i, s in enumerate(status))
    log = load(write(NET + rows))
    assert 'rows with a status other than 0: 3 (first: line 10; "80010000", "0x8")' in notes(log)
    np.testing.assert_array_equal(log["thrust"].values, 3 * 0.1)  # told, not thrown away
    assert "status" not in notes(load(write(NET + rows.replace("80010000", "0").replace("0x8", "0x0"))))


STAND = "Time (s),ESC signal (µs),Servo 1 (µs),Thrust (N),Motor Optical Speed (RPM),App message,Mark,\n"
CELL = "Time (s),Fz (N),Note no,Temp (degC)\n"
POSE = "t,x_m,y_m,z_m,qw,qx,qy,qz,error_m\n"
ROS = (
    "%time,field.header.seq,field.header.stamp,"
    + ",".join(f"field.pose.position.{axis}" for axis in "xyz")
    + ","
    + ",".join(f"field.pose.orientation.{axis}" for axis in "xyzw")
)


@pytest.mark.parametrize(
    ("head", "row", "named"),
    [
        (STAND, "{t},1000,1500,2,{i},,7,\n", '"Servo 1 (µs)", "Mark"'),
        (CELL, "{t},1,{i},20\n", '"Note no", "Temp (degC)"'),
        (POSE, "{t},0,0,0,1,0,0,0,0.1\n", '"error_m"'),
        (
            ROS + ",field.extra\n",
            "{n},{i},{n},0,0,0,0,0,0,1,5\n",
            '"%time", "field.header.seq", "field.extra"',
        ),
    ],
)
def test_columns_that_are_not_read_are_named(write, head, row, named):
    rows = "".join(row.format(t=f"{i * 0.01:.2f}", i=i, n=10**18 + i * 10**7) for i in range(20))
    said = notes(load(write(head + rows)))
    assert f"columns not read: {named}" in said
    assert said.count("not read") == 1


def test_datasets_that_are_not_read_are_named(tmp_path):
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file.attrs["rate"] = 100.0
        for name in ("Fz", "Mz", "Strain 1"):
            file.create_dataset(name, data=np.arange(50.0)).attrs["unit"] = "N*m" if name == "Mz" else "N"
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
    assert " and ".join(sorted({one or "no unit" for one in units})) in str(caught.value)
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
        with pytest.raises(LogError, match=re.escape(f"steps by {step}, too little for nanoseconds")):
            load(write(stamped([1_600_000_000_000 + i * step for i in range(40)])))


def test_qualisys_frequency_with_a_decimal_comma(write):
    head = "NO_OF_FRAMES\t9\nNO_OF_MARKERS\t1\nFREQUENCY\t{}\nDATA_INCLUDED\t3D\nMARKER_NAMES\tm\n"
    rows = "".join(f"{i}\t2\t3\n" for i in range(1, 10))
    assert load(write(head.format("99,5") + rows))["m/position"].rate == pytest.approx(99.5)
    with pytest.raises(LogError, match="the header states no FREQUENCY"):
        load(write(head.format("1,000,5") + rows))
