"""Advice must help: what a sentence tells the reader to declare makes the log readable, or right.

That a refusal names only options of the log's format is asserted wherever a test asks for one (`refuses`).
"""

import re

import numpy as np
import pytest

from fakes.log_files import refuses
from sysid.errors import SysidError
from sysid.journal import note
from sysid.loaders import formats, load
from sysid.loaders.readers.sysid_hdf5 import write_recording
from sysid.recording import Channel, Provenance, Recording
from sysid.trials.look import inspect_recording, length_advice, unit_advice
from sysid.workflows.inspect import parse_options

FORMATS = formats()


def shell_words(sentence):
    """Return the options that a sentence tells the reader to declare, as a shell would hand them over."""
    return re.findall(r"\b((?:units|length_unit) = (?:\{.*?\}|\".*?\"))", sentence)


def suspicions(recording, word):
    """Return the sentences with a word among the suspicions of a look at a recording."""
    return [str(finding) for finding in inspect_recording(recording).suspicions if word in str(finding)]


RUN = np.arange(400)
# 60 000 rpm, 900 gf and 300 mN·m, taken for rad/s, N and N·m; at rest in the first rows.
SPEED, THRUST, TORQUE = (np.where(RUN < 100, 0.0, top) for top in (60_000.0, 3_000.0, 300.0))


def bench_csv(head, rows):
    return "\n".join([head, *rows, ""]).encode("utf-8")


def bench_logs(tmp_path):
    """Write logs of formats whose advice differs, in other units than they say; yield path and options."""
    rows = list(zip(RUN * 0.01, np.where(RUN < 100, 1000, 1500), SPEED, THRUST, TORQUE, strict=True))
    numbers = [",".join(f"{x:.6g}" for x in row) for row in rows]
    texts = {
        "rcbenchmark-csv": (
            "Time (s),ESC signal (µs),Motor Optical Speed (rad/s),Thrust (N),Torque (N·m)", numbers, {}),
        "load-cell-csv": ("Time (s),Command (us),Speed (rad/s),Fz (N),Mz (N·m)", numbers, {}),
        "net-ft-csv": (
            "RDT Sample Rate: 100\nForce Units: N\nCounts per Unit Force: 1\nTorque Units: Nm\n"
            "Counts per Unit Torque: 1\nStatus, RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time",
            [f"0,{i},{i},0,0,{r[3]},0,0,{r[4]},0" for i, r in enumerate(rows)], {}),
        "ati-text": (
            "First line indicates sampling freq [Hz]\nFx, Fy, Fz, Tx, Ty, Tz\n100,75,500",
            [f"0,0,{r[3]},0,0,{r[4]}" for r in rows], {"units": {"force": "N", "torque": "N*m"}}),
    }  # fmt: skip
    for name, (head, lines, options) in texts.items():
        path = tmp_path / name
        path.write_bytes(bench_csv(head, lines))
        yield name, path, options
    path = tmp_path / "converted.h5"
    write_recording(load(tmp_path / "load-cell-csv"), path)
    yield "sysid-hdf5", path, {}


def test_unit_advice_of_bench_formats_helps(tmp_path):
    walked = set()
    for name, path, options in bench_logs(tmp_path):
        recording = load(path, format=name, **options)
        sentences = suspicions(recording, "probably")
        assert len(sentences) == len({"speed", "thrust", "torque"} & set(recording.channels)), name
        units = dict(options.get("units", {}))
        for sentence in sentences:
            if "units" not in FORMATS[name].options:
                assert "units" not in sentence
                assert re.search("correct it|convert the original", sentence)
                continue
            declared = shell_words(sentence)
            if declared:
                units |= parse_options([declared[0]])["units"]
            else:  # two units for six channels: the sentence names the one to correct
                key, unit = re.search(r'correct (\w+) = "([^"]+)" in units', sentence).groups()
                units[key] = unit
        walked.add(name)
        if units == dict(options.get("units", {})):
            continue
        again = load(path, format=name, **{**options, "units": units})
        assert not suspicions(again, "probably"), name
        if "speed" in again.channels:
            # 60 000 rpm
            assert again["speed"].values.max() == pytest.approx(60_000 * np.pi / 30, rel=1e-12)
        assert again["thrust"].values.max() == pytest.approx(3_000 * 9.80665e-3, rel=1e-9)
    assert walked == {"rcbenchmark-csv", "load-cell-csv", "net-ft-csv", "ati-text", "sysid-hdf5"}


def log(name, options=None, notes=()):
    """Return a recording of a format with a channel of speed and one of positions."""
    time = np.arange(3.0)
    channels = [Channel("speed", "rad/s", time, time), Channel("q/position", "m", time, np.zeros((3, 3)))]
    provenance = Provenance("a", "", name, "", options or {}, notes)
    return Recording("load-cell", {channel.name: channel for channel in channels}, provenance)


@pytest.mark.parametrize("name", FORMATS)
def test_a_look_advises_no_option_that_the_format_has_not(name):
    sentences = [unit_advice(log(name), channel, "rpm") for channel in ("speed", "thrust", "torque")]
    named = {option for advice in (*sentences, length_advice(log(name), "mm"))
             for option in re.findall(r"\b(units|length_unit)\b", advice)}  # fmt: skip
    assert named <= set(FORMATS[name].options)


def test_a_tachometer_and_a_calibration_are_checked_not_given_a_unit():
    pulses = log("tdms", {"pulses_per_revolution": "2"})
    assert unit_advice(pulses, "speed", "rpm") == "check pulses_per_revolution"
    assert unit_advice(pulses, "thrust", "gf") == 'declare units = {thrust = "gf"}'
    assert "calibration" in unit_advice(log("ati-text", {"calibration": "a.cal"}), "thrust", "gf")


FALL = np.arange(200) * 0.005
# Half a second at rest 0.4 m above the floor, then down and still: 286 ms of fall.
HEIGHT = np.maximum(0.4 - 0.5 * 9.80665 * np.maximum(FALL - 0.5, 0.0) ** 2, 0.0) + 0.1


def capture_logs(tmp_path, stated, number):
    """Yield a drop in every text format of captures; `stated` is what the file says of its unit."""
    place = [(0.0, 0.0, h * number) for h in HEIGHT]
    word = {"m": "Meters", "mm": "Millimeters", "": ""}[stated]
    at = [f"{x:.6f},{y:.6f},{z:.6f}" for x, y, z in place]
    pose = (
        "t [s]," + ",".join(f"{a} [{stated}]" if stated else a for a in "xyz") + ",qw,qx,qy,qz",
        [f"{t:.4f},{p},1,0,0,0" for t, p in zip(FALL, at, strict=True)],
    )
    motive = (
        "Format Version,1.23,Capture Frame Rate,200,Export Frame Rate,200,Rotation Type,Quaternion"
        + (f",Length Units,{word}" if word else "")
        + "\n\n,Type" + ",Rigid Body" * 7 + "\n,Name" + ",q" * 7 + "\n,ID" + ",1" * 7
        + "\n,," + "Rotation," * 4 + "Position,Position,Position\nFrame,Time (Seconds),X,Y,Z,W,X,Y,Z",
        [f"{i},{t:.6f},0,0,0,1,{p}" for i, (t, p) in enumerate(zip(FALL, at, strict=True))],
    )  # fmt: skip
    vicon = (
        "Objects\n200\n,,Global Angle q:q\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,,," + f",{stated}" * 3,
        [f"{i + 1},0,0,0,0,{p}" for i, p in enumerate(at)],
    )
    yield from {"pose-table": pose, "motive-csv": motive, "vicon-csv": vicon}.items()
    if stated:
        return
    ros = (
        "%time,field.header.seq,field.header.stamp,field.header.frame_id,"
        + ",".join(f"field.pose.position.{a}" for a in "xyz")
        + "," + ",".join(f"field.pose.orientation.{a}" for a in "xyzw"),
        [f"{int(t * 1e9) + 10**18},{i},{int(t * 1e9) + 10**18},w,{p},0,0,0,1"
         for i, (t, p) in enumerate(zip(FALL, at, strict=True))],
    )  # fmt: skip
    yield "ros-csv", ros


@pytest.mark.parametrize("stated", ["", "m"])
def test_length_advice_of_every_capture_format_helps(tmp_path, write, stated):
    walked = set()
    for name, (head, rows) in capture_logs(tmp_path, stated, 1000.0):
        path = write(bench_csv(head, rows), name)
        options = {}
        if not stated and name in ("pose-table", "motive-csv", "vicon-csv"):
            options["length_unit"] = "m"
        recording = load(path, format=name, **options)
        [sentence] = suspicions(recording, "lengths")
        declared = shell_words(sentence)
        if not declared:
            assert stated
            assert name in ("motive-csv", "vicon-csv")
            assert "the file states its length unit, so correct it there" in sentence
            other = "Millimeters" if name == "motive-csv" else "mm"
            text = path.read_text(encoding="utf-8")
            text = text.replace("Meters", other) if name == "motive-csv" else text.replace(",m", ",mm")
            path.write_text(text, encoding="utf-8")
        again = load(path, format=name, **{**options, **parse_options(declared)})
        assert not suspicions(again, "lengths"), name
        [body] = again.rigid_bodies
        assert again[f"{body}/position"].values[0, 2] == pytest.approx(0.5, abs=1e-9)
        walked.add(name)
    assert len(walked) == (3 if stated else 4)


def test_length_advice_by_format():
    for name in ("ros-bag", "ros-csv", "qualisys-tsv"):
        assert length_advice(log(name), "mm") == 'declare length_unit = "mm"'
        assert "length_unit" in FORMATS[name].options
    assert length_advice(log("c3d", {"length_unit": "m"}), "mm") == 'declare length_unit = "mm"'
    assert "states its length unit" in length_advice(log("c3d"), "mm")
    assert "where the log was written" in length_advice(log("tdms"), "mm")
    converted = log("ros-csv", notes=(note("converted", "converted from a.csv"),))
    assert length_advice(converted, "mm").startswith("convert the original log again")


COARSE = np.repeat(np.arange(30) * 0.1, 4)


def test_a_coarse_clock_is_answered_by_what_the_format_has(write):
    cell = "Time (s),Fz (N)\n" + "".join(f"{t:.1f},{i}\n" for i, t in enumerate(COARSE))
    stand = "Time (s),ESC signal (µs),Thrust (N)\n" + "".join(f"{t:.1f},1000,2\n" for t in COARSE)
    table = "t,frame,x_m,y_m,z_m,qw,qx,qy,qz\n" + "".join(
        f"{t:.1f},{i},0,0,{i},1,0,0,0\n" for i, t in enumerate(COARSE)
    )
    still = table.replace(",frame", ",mark")
    for name, text, advice, options in [
        ("load-cell-csv", cell, "declare the sample rate with rate = ...", {"rate": "40 Hz"}),
        ("rcbenchmark-csv", stand, "export the log again with finer times", None),
        ("pose-table", table, 'choose clock = "frame"', {"clock": "frame"}),
        ("pose-table", still, "export the log again with finer times", None),
    ]:
        path = write(text)
        assert refuses(path, "the clock is too coarse", format=name).endswith(advice)
        if options is not None:
            channel = next(iter(load(path, format=name, **options).channels.values()))
            assert channel.rate == pytest.approx(40, rel=0.01)  # stamps of 0.1 s fix it no better


@pytest.mark.parametrize("name", ["rcbenchmark-csv", "ros-csv", "load-cell-csv", "pose-table"])
def test_names_are_asked_for_where_they_can_be_said(write, name):
    path = write("".join(f"{i},1,2,3,4,5,6,7\n" for i in range(9)))
    asked = r"columns = \[...\]" if "columns" in FORMATS[name].options else "put the instrument's header line"
    refuses(path, f"found numbers where the header line should name the columns; .*{asked}", format=name)


def test_a_rate_and_a_tare_may_say_their_unit(write):
    path = write("".join("0,0,5,0,0,1\n" for _ in range(60)))
    words = ['units={force="N",torque="N*m"}', 'rate="0.02 kHz"', "tare=1 s"]  # as a shell hands them over
    log = load(path, format="ati-text", **parse_options(words))
    assert log["thrust"].rate == pytest.approx(20.0)
    np.testing.assert_array_equal(log["thrust"].values, 0.0)
    for word, sentence in [("tare=1 N", "tare = '1 N': unit 'N' is not a 's'"),
                           ("rate=fast", "rate = 'fast': 'fast' is not a number with a unit")]:  # fmt: skip
        refuses(path, sentence, SysidError, format="ati-text", **parse_options([word]))
