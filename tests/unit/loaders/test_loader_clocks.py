"""Clocks of logs that fall: rows that come late, runs that follow each other in one file."""

import json

import numpy as np
import pytest

from sysid.errors import SegmentError
from sysid.loaders import load
from sysid.workflows.inspect import inspect_files
from tests.fakes.log_files import LVM, notes, refuses

STAND = "Time (s),ESC signal (µs),Torque (N·m),Thrust (N),Motor Optical Speed (RPM)\n"
CELL = "Time (s),Fz (N),Mz (N·m)\n"
POSES = "t,x,y,z,qx,qy,qz,qw\n"


def rows(times, first=0):
    """Rows of a stand, whose thrust counts them."""
    return "".join(f"{t:.6f},1000,0.1,{i},60\n" for i, t in enumerate(times, start=first))


def test_rows_that_come_late_are_left_out_with_a_note(write):
    """The rows of a Series 1580 at 143 Hz: four of 15 876 are written behind their successor."""
    times = np.arange(4000) * 0.007
    order = np.arange(4000)
    late = (700, 3000)
    for row in late:
        order[[row, row + 1]] = row + 1, row
    log = load(write(STAND + rows(times[order])))
    np.testing.assert_allclose(log["thrust"].time, np.delete(times, late), atol=1e-6)
    np.testing.assert_array_equal(log["thrust"].values, np.delete(np.arange(4000), np.array(late) + 1))
    assert "time goes back, left out: 2 (first: line 703), by up to 1 sample periods" in notes(log)


def test_a_clock_that_is_no_clock_is_refused(write):
    """A quarter of the rows in disorder, or a fall row by row, is no late row."""
    noisy = np.arange(400) * 0.01 - np.where(np.arange(400) % 4 == 3, 0.015, 0.0)
    refuses(write(STAND + rows(noisy)), 'time goes back from .* set time_back = "drop"')
    refuses(write(STAND + rows(np.arange(400)[::-1] * 0.01)), 'time goes back .* set time_back = "drop"')


RUNS = np.arange(300) * 0.01, np.arange(200) * 0.01
POSE = ["0,0,1,0,0,0,1"] * 500


@pytest.mark.parametrize(("content", "channel", "options"), [
    (STAND + rows(RUNS[0]) + rows(RUNS[1], 300), "thrust", {}),
    (CELL + "".join(f"{t:.3f},{i},0\n" for i, t in enumerate(np.concatenate(RUNS))), "thrust", {}),
    (
        POSES + "".join(f"{t:.3f},{i},0,1,0,0,0,1\n" for i, t in enumerate(np.concatenate(RUNS))),
        "body/position", {"length_unit": "m"},
    ),
], ids=["stand", "load cell", "poses"])  # fmt: skip
def test_runs_that_follow_each_other_in_a_file_are_segments(write, content, channel, options):
    path = write(content)
    where = r"its clock starts again in line 302 \(0 to 2.99 s, 0 to 1.99 s\)"
    sentence = refuses(path, f"has 2 segments: {where}", SegmentError, **options)
    assert sentence.endswith("choose one with segment = 1 to 2")
    for number, times, first in ((1, RUNS[0], 0), (2, RUNS[1], 300)):
        log = load(path, segment=number, **options)
        np.testing.assert_allclose(log[channel].time, times, atol=1e-9)
        values = log[channel].values.reshape(times.size, -1)[:, 0]
        np.testing.assert_array_equal(values, first + np.arange(times.size))
        assert f"segment {number} of 2: its clock starts again in line 302" in notes(log)
    refuses(path, "segment = 3; the file has segments 1 to 2", segment=3, **options)
    refuses(path, "line 302: time goes back from 2.99 s to 0 s", time_back="refuse", **options)
    assert load(path, time_back="drop", **options)[channel].time.size == 300


def test_a_log_of_one_run_has_one_segment(write):
    path = write(STAND + rows(RUNS[0]))
    assert load(path, segment=1)["thrust"].time.size == 300
    refuses(path, "segment = 2; the file has segments 1 to 1", segment=2)


def test_inspect_shows_each_segment(write, capsys):
    inspect_files([write(STAND + rows(RUNS[0]) + rows(RUNS[1]))], as_json=True)
    reports = json.loads(capsys.readouterr().out)
    assert [report["duration"] for report in reports] == pytest.approx([2.99, 1.99])
    lvm = LVM.format(columns="No", axis="")
    path = write(lvm + "\t1\n\t2\n" + lvm[lvm.index("\n\n") :] + "\t2\n\t3\n\t4\n", "log.lvm")
    inspect_files([path], as_json=True)
    reports = json.loads(capsys.readouterr().out)
    assert [report["channels"][0]["samples"] for report in reports] == [2, 3]
    assert ["segment 1 of 2" in " ".join(report["notes"]) for report in reports] == [True, False]
