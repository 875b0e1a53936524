"""Tables of averaged points of a thrust stand: rows twice, a clock that restarts, units that cannot be."""

import re

import numpy as np
import pytest

from fakes.log_files import notes, refuses
from sysid.loaders import load

HEAD = (
    "Time (s),ESC signal (µs),Torque (N·m),Thrust (gf),Voltage (V),Current (A),Motor Optical Speed (RPM),"
    "Electrical Power (W),Mechanical Power (W),App message,"
)


def rows():
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


def table(write, head, lines):
    return load(write("\n".join([head, *lines, ""]), "stand.csv"))


def test_a_whole_table_has_nothing_to_note(write):
    log = table(write, HEAD, rows())
    assert log.kind == "static-map"
    assert {note.code for note in log.provenance.notes} == {"static-map", "optical-speed"}


@pytest.mark.parametrize(("lines", "points", "sentence"), [
    (lambda r: [x for row in r for x in (row, row)], 24, "rows that stand twice: 12 (first: line 3)"),
    (lambda r: r + r[3:], 21, "the clock starts again 1 times (first: line 14)"),
    (lambda r: [*r[:6], HEAD, *r[6:]], 12, "the header stands again in line 8"),
])  # fmt: skip
def test_joined_and_doubled_tables_are_noted(write, lines, points, sentence):
    log = table(write, HEAD, lines(rows()))
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
    found = [n for n in table(write, HEAD.replace(right, wrong), rows()).provenance.notes
             if n.code == "implausible-power"]  # fmt: skip
    assert found
    assert all(finding.severity == "warning" for finding in found)
    assert any(re.search(words, finding.sentence) for finding in found)


def test_a_rotor_without_a_propeller_is_no_wrong_unit(write):
    bare = []
    noise = np.random.default_rng(3).normal(size=(12, 2))
    for row, (a, b) in zip(rows(), noise, strict=True):
        cells = row.split(",")
        cells[2], cells[3] = f"{1e-3 * a:.6f}", f"{5 * b:.3f}"
        bare.append(",".join(cells))
    assert "check the unit" not in notes(table(write, HEAD, bare))


def test_points_without_a_clock_are_points_where_the_command_differs(write):
    head, lines = HEAD.split(",", 1)[1], [row.split(",", 1)[1] for row in rows()]
    assert table(write, head, lines).kind == "static-map"
    held = [lines[0]] * 30
    refuses(write("\n".join([head, *held, ""])), 'no column "Time".* static = true')
    refuses(write("\n".join([head, *lines, ""])), "rows have no clock", static=False)
    refuses(write("\n".join(["Clock (s)," + head, *rows(), ""])), "rows have no clock")
