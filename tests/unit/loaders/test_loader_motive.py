"""Motive headers: what decides units, rotation, clock and names, and what is refused."""

import numpy as np
import pytest

from sysid.errors import SysidError
from sysid.loaders import load

SETTINGS = (
    "Format Version,1.23,Take Name,a,Capture Frame Rate,100,Export Frame Rate,100,"
    "Rotation Type,{},Length Units,{}"
)
BODY = [("Rotation", "X"), ("Rotation", "Y"), ("Rotation", "Z"), ("Rotation", "W")] + [
    ("Position", a) for a in "XYZ"
]
EULER = BODY[:3] + BODY[4:]
POINT = BODY[4:]


def take(columns, rows, rotation="Quaternion", unit="Meters", settings=SETTINGS):
    """Return a 1.23 take; columns are (type, name, component, axis)."""
    kinds, names, parts, axes = zip(*columns, strict=True)
    lines = [settings.format(rotation, unit), ""]
    lines += [
        ",Type," + ",".join(kinds),
        ",Name," + ",".join(names),
        ",ID," + ",".join(f'"{n}"' for n in names),
    ]
    lines += [",," + ",".join(parts), "Frame,Time (Seconds)," + ",".join(axes)]
    return "\r\n".join([*lines, *rows, ""]).encode("utf-8")


def asset(kind, name, parts):
    return [(kind, name, *part) for part in parts]


@pytest.fixture
def read(tmp_path):
    def read(data, **options):
        path = tmp_path / "take.csv"
        path.write_bytes(data)
        return load(path, **options)

    return read


QUAD = asset("Rigid Body", "quad", BODY)
ROWS = ["0,0.00,0,0,0,1,1,2,3", "1,0.01,0,0,0,1,1,2,3"]


@pytest.mark.parametrize(("unit", "metres"), [("Meters", 1), ("Millimeters", 1e-3), ("Centimeters", 1e-2)])
def test_length_units(read, unit, metres):
    log = read(take(QUAD, ROWS, unit=unit))
    np.testing.assert_allclose(log["quad/position"].values, [[metres, 2 * metres, 3 * metres]] * 2)


def test_length_unit_that_is_not_stated_is_asked_for(read):
    data = take(QUAD, ROWS, settings=SETTINGS.replace(",Length Units,{}", ""))
    with pytest.raises(SysidError, match="states no length unit; declare it"):
        read(data)
    assert read(data, length_unit="mm")["quad/position"].values[0, 2] == pytest.approx(3e-3)
    with pytest.raises(SysidError, match=r"take\.csv: length unit: unknown unit 'smoot'"):
        read(data, length_unit="smoot")


def test_euler_order_that_is_not_stated_is_asked_for(read):
    rows = ["0,0.00,90,0,0,1,2,3", "1,0.01,0,90,0,1,2,3"]
    data = take(asset("Rigid Body", "quad", EULER), rows, rotation="")
    with pytest.raises(SysidError, match="declare euler_order, one of XYZ, XZY"):
        read(data)
    with pytest.raises(SysidError, match="euler_order = 'XYX' is unknown"):
        read(data, euler_order="XYX")
    half = np.sqrt(0.5)
    turned = read(data, euler_order="xyz")["quad/orientation"].values
    np.testing.assert_allclose(turned, [[half, half, 0, 0], [half, 0, half, 0]], atol=1e-15)


def test_time_is_rebuilt_from_frames_and_a_contradiction_is_refused(read):
    data = take(QUAD, ["200,2.00,0,0,0,1,1,2,3", "203,2.0304,0,0,0,1,1,2,3", "204,2.04,0,0,0,1,1,2,3"])
    np.testing.assert_array_equal(read(data)["quad/position"].time, np.array([200, 203, 204]) / 100)
    data = data.replace(b"203,2.0304", b"203,2.0350")
    with pytest.raises(
        SysidError, match=r"line 9: frame 203 at 100 Hz is at 2\.03 s but the Time column says 2\.035"
    ):
        read(data)
    np.testing.assert_array_equal(read(data, clock="time")["quad/position"].time, [2.0, 2.035, 2.04])
    np.testing.assert_array_equal(
        read(data, clock="frame")["quad/position"].time, np.array([200, 203, 204]) / 100
    )
    with pytest.raises(SysidError, match="clock = 'sun' is unknown; expected \"auto\""):
        read(data, clock="sun")


def test_export_at_half_the_capture_rate_with_capture_frame_numbers(read):
    settings = SETTINGS.replace("Export Frame Rate,100", "Export Frame Rate,50")
    data = take(
        QUAD, ["0,0.00,0,0,0,1,1,2,3", "2,0.02,0,0,0,1,1,2,3", "4,0.04,0,0,0,1,1,2,3"], settings=settings
    )
    np.testing.assert_allclose(read(data)["quad/position"].time, [0, 0.02, 0.04])


def test_frames_going_back_are_refused(read):
    with pytest.raises(SysidError, match=r"line 9: time goes back from 0\.01 s to 0 s"):
        read(take(QUAD, [ROWS[1], ROWS[0]]))


def test_measured_marker_keeps_the_plain_name(read):
    columns = [
        *QUAD, *asset("Rigid Body Marker", "quad:1", POINT), *asset("Marker", "quad:1", POINT),
        *asset("Marker", "never", POINT),
    ]  # fmt: skip
    rows = [row + ",7,7,7,8,8,8,,," for row in ROWS]
    log = read(take(columns, rows))
    assert log.markers == ("quad:1", "quad:1 (solved)")
    assert log["quad:1/position"].values[0, 0] == 8
    assert log["quad:1 (solved)/position"].values[0, 0] == 7
    assert 'markers never seen, left out: "never"' in log.provenance.sentences


def test_body_lost_in_every_frame_is_kept_as_missing(read):
    log = read(take([*QUAD, *asset("Rigid Body", "gone", BODY)], [row + "," * 7 for row in ROWS]))
    assert log.rigid_bodies == ("quad", "gone")
    assert not log["gone/position"].valid.any()
    assert not log["gone/orientation"].valid.any()
    assert "gone is lost in 2 of 2 frames" in log.provenance.sentences


def test_kept_bodies(read):
    data = take([*QUAD, *asset("Rigid Body", "board", BODY)], [row + ",0,0,0,1,4,5,6" for row in ROWS])
    assert read(data, rigid_body="board").rigid_bodies == ("board",)
    assert read(data, rigid_body=["quad", "board"]).rigid_bodies == ("quad", "board")
    with pytest.raises(SysidError, match='no rigid body "F450"; found "quad", "board"; set rigid_body'):
        read(data, rigid_body="F450")


@pytest.mark.parametrize(("data", "message"), [
    (take(QUAD, []), "no rows of numbers after line 7"),
    (take(QUAD[:-1], [row[:-2] for row in ROWS]), '"quad" lacks one of Position X, Y, Z'),
    (take(asset("Rigid Body", "quad", POINT), ["0,0,1,2,3"]), 'rigid body "quad" has no rotation columns'),
    (take([*QUAD, *QUAD], ROWS), 'repeats Rotation X of "quad"'),
    (take(asset("Skeleton", "man", BODY), ROWS), "no rows of types and components"),
    (take(QUAD, ROWS).replace(b"Frame,", b"Bild,"), 'no column row "Frame,Time,..."'),
    (take(QUAD, [ROWS[0].replace("3", "x")]), "line 8: 'x' in column 'quad Position Z' is not a number"),
    (take(QUAD, [ROWS[0].replace("0,0,0,1", "0,0,0,2")]), "line 8: the quaternion of quad has length 2"),
])  # fmt: skip
def test_refusals(read, data, message):
    with pytest.raises(SysidError, match=message):
        read(data)
