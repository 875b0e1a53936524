"""Motive headers: what decides units, rotation, clock and names, and what is refused."""

import numpy as np
import pytest

from fakes.log_files import refuses
from sysid.errors import SysidError
from sysid.loaders import load

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
    (take(asset("Rigid Body", "quad", POINT), ["0,0,1,2,3"]), 'rigid body "quad" has no rotation columns'),
    (take([*QUAD, *QUAD], ROWS), 'repeats Rotation X of "quad"'),
    (take(asset("Skeleton", "man", BODY), ROWS), "no rows of types and components"),
    (take(QUAD, ROWS).replace(b"Frame,", b"Bild,"), 'no column row "Frame,Time,..."'),
    (take(QUAD, [ROWS[0].replace("3", "x")]), "line 8: 'x' in column 'quad Position Z' is not a number"),
    (take(QUAD, [ROWS[0].replace("0,0,0,1", "0,0,0,2")]), "line 8: the quaternion of quad has length 2"),
])  # fmt: skip
def test_refusals(write, data, message):
    refuses(write(data), message)
