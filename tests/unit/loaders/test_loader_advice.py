"""Advice must help: what a sentence tells the reader to declare makes the log readable, or right.

That a refusal names only options of the log's format is asserted wherever a test asks for one (`refuses`).
"""

import re

import numpy as np
import pytest

from fakes.log_files import NET_FT, ROS, refuses
from sysid.errors import SysidError
from sysid.journal import note
from sysid.loaders import formats, load
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
ATI = "First line indicates sampling freq [Hz]\nFx, Fy, Fz, Tx, Ty, Tz\n100,75,500"


def bench_csv(head, rows):
    return "\n".join([head, *rows, ""]).encode("utf-8")


@pytest.mark.parametrize(("name", "head", "row", "options"), [
    ("rcbenchmark-csv", "Time (s),ESC signal (µs),Motor Optical Speed (rad/s),Thrust (N),Torque (N·m)",
     "{t:.2f},{c},{s},{f},{m}", {}),
    ("load-cell-csv", "Time (s),Command (us),Speed (rad/s),Fz (N),Mz (N·m)", "{t:.2f},{c},{s},{f},{m}", {}),
    ("net-ft-csv", NET_FT.format(1).strip(), "0,{i},{i},0,0,{f},0,0,{m},0", {}),
    ("ati-text", ATI, "0,0,{f},0,0,{m}", {"units": {"force": "N", "torque": "N*m"}}),
])  # fmt: skip
def test_unit_advice_of_bench_formats_helps(write, name, head, row, options):
    rows = [
        row.format(i=i, t=0.01 * i, c=1000 if i < 100 else 1500, s=SPEED[i], f=THRUST[i], m=TORQUE[i])
        for i in RUN
    ]
    path = write(bench_csv(head, rows), name)
    recording = load(path, format=name, **options)
    sentences = suspicions(recording, "probably")
    assert len(sentences) == len({"speed", "thrust", "torque"} & set(recording.channels))
    units = dict(options.get("units", {}))
    for sentence in sentences:
        if "units" not in FORMATS[name].options:
            assert "units" not in sentence
            assert "correct it" in sentence
            continue
        declared = shell_words(sentence)
        if declared:
            units |= parse_options([declared[0]])["units"]
        else:  # two units for six channels: the sentence names the one to correct
            key, unit = re.search(r'correct (\w+) = "([^"]+)" in units', sentence).groups()
            units[key] = unit
    if units == options.get("units", {}):
        return
    again = load(path, format=name, **{**options, "units": units})
    assert not suspicions(again, "probably")
    if "speed" in again.channels:
        # 60 000 rpm
        assert again["speed"].values.max() == pytest.approx(60_000 * np.pi / 30, rel=1e-12)
    assert again["thrust"].values.max() == pytest.approx(3_000 * 9.80665e-3, rel=1e-9)


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


POSE = "t [s],x{u},y{u},z{u},qw,qx,qy,qz"
VICON = "Objects\n200\n,,Global Angle q:q\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,,,,{u},{u},{u}"


@pytest.mark.parametrize(("name", "head", "row", "options"), [
    ("pose-table", POSE.format(u=""), "{t:.4f},0,0,{z:.6f},1,0,0,0", {"length_unit": "m"}),
    ("pose-table", POSE.format(u=" [m]"), "{t:.4f},0,0,{z:.6f},1,0,0,0", {}),
    ("vicon-csv", VICON.format(u=""), "{i},0,0,0,0,0,0,{z:.6f}", {"length_unit": "m"}),
    ("vicon-csv", VICON.format(u="m"), "{i},0,0,0,0,0,0,{z:.6f}", {}),
    ("ros-csv", ROS, "{n},{i},{n},0,0,{z:.6f},0,0,0,1", {}),
])  # fmt: skip
def test_length_advice_of_captures_helps(write, name, head, row, options):
    """Heights in millimetres that are taken for metres."""
    numbers = enumerate(zip(FALL, 1000.0 * HEIGHT, strict=True))
    rows = [row.format(i=i + 1, t=t, z=z, n=int(t * 1e9) + 10**18) for i, (t, z) in numbers]
    path = write(bench_csv(head, rows), name)
    [sentence] = suspicions(load(path, format=name, **options), "lengths")
    declared = shell_words(sentence)
    if not declared:
        assert "the file states its length unit, so correct it there" in sentence
        path.write_bytes(bench_csv(VICON.format(u="mm"), rows))
    again = load(path, format=name, **{**options, **parse_options(declared)})
    assert not suspicions(again, "lengths")
    [body] = again.rigid_bodies
    assert again[f"{body}/position"].values[0, 2] == pytest.approx(0.5, abs=1e-9)


def test_length_advice_by_format():
    for name in ("ros-bag", "qualisys-tsv"):
        assert length_advice(log(name), "mm") == 'declare length_unit = "mm"'
        assert "length_unit" in FORMATS[name].options
    assert length_advice(log("c3d", {"length_unit": "m"}), "mm") == 'declare length_unit = "mm"'
    for name in ("c3d", "motive-csv"):
        assert "states its length unit" in length_advice(log(name), "mm")
    assert "where the log was written" in length_advice(log("tdms"), "mm")
    converted = log("ros-csv", notes=(note("converted", "converted from a.csv"),))
    for advice in (length_advice(converted, "mm"), unit_advice(converted, "speed", "rpm")):
        assert advice.startswith("convert the original log again")


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
