"""What inspection says of logs whose truth is known, and the commands inspect and convert."""

import json
import math
import re

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from fakes.log_files import examples
from fakes.places import SAMPLES
from sysid.errors import LogError, SysidError
from sysid.journal import Finding
from sysid.loaders import detect, load
from sysid.loaders.readers.sysid_hdf5 import write_recording
from sysid.recording import Channel, Provenance, Recording
from sysid.report.inspect_figures import figure_logs
from sysid.trials.look import inspect_channel, inspect_recording
from sysid.workflows.inspect import SecondFile, convert_file, parse_options


def recording(kind, *channels):
    return Recording(kind, {c.name: c for c in channels}, Provenance("log", "00", "pose-table"))


def drop(up="+z", slope=0.0, rate=200.0, noise=2e-4, scale=1.0, height=0.1, held=True, markers=True):
    """A body that hangs, falls by `height` and stays where it lands; the board's markers beside it."""
    random = np.random.default_rng(5)
    time = 3.0 + np.arange(0, 2, 1 / rate)
    release = 3.5
    touchdown = release + math.sqrt(2 * height / 9.80665)
    fallen = np.clip(time, release, touchdown) - release
    level = -0.5 * 9.80665 * fallen**2
    if not held:
        level = np.where(time < touchdown, 1.0 * (time - 3.0) - 0.5 * 9.80665 * (time - 3.0) ** 2, np.nan)
        stop = np.flatnonzero(np.isfinite(level))[-1]
        level = np.where(np.isfinite(level), level, level[stop])
    axis = np.zeros(3)
    axis["xyz".index(up[1])] = 1.0 if up[0] == "+" else -1.0
    place = np.outer(level, axis) + random.normal(size=(time.size, 3)) * noise
    side = np.roll(np.abs(axis), 1)
    tilt = Rotation.from_rotvec(slope * side)
    landed = time >= touchdown
    turns = np.where(landed[:, None], np.roll(tilt.as_quat(), 1), [[1.0, 0, 0, 0]])
    made = [Channel("quad/position", "m", time, place * scale), Channel("quad/orientation", "1", time, turns)]
    if markers:
        for i, corner in enumerate(([0, 0], [0.5, 0], [0, 0.5])):
            point = tilt.apply(np.roll(np.array([0.0, *corner]), int(np.argmax(np.abs(axis)))))
            where = np.tile(point, (time.size, 1)) + random.normal(size=(time.size, 3)) * noise
            made.append(Channel(f"board {i}/position", "m", time, where * scale))
    return recording("motion-capture", *made), release, touchdown


@pytest.mark.parametrize("up", ["+z", "-z", "+y", "-y", "+x"])
@pytest.mark.parametrize("height", [0.03, 0.1, 0.4])
def test_drop_is_found_whatever_is_up(up, height):
    log, release, touchdown = drop(up, slope=np.radians(20), height=height)
    report = inspect_recording(log)
    assert report.drop.up == up
    # 0.2 mm of noise at 200 Hz: two samples each way for events, 2 % for g over 80 ms of fall.
    assert report.drop.release == pytest.approx(release, abs=4e-3)
    assert report.drop.touchdown == pytest.approx(touchdown, abs=0.012)
    assert report.drop.gravity == pytest.approx(9.80665, rel=0.03)
    assert report.drop.impact_speed == pytest.approx(math.sqrt(2 * 9.80665 * height), abs=0.13)
    # The plane of three markers half a metre apart, each known to a hundredth of a millimetre.
    assert report.drop.slope == pytest.approx(np.radians(20), abs=1e-3)
    codes = {finding.code for finding in report.suspicions}
    assert ("axis-down" in codes, "axes-swapped" in codes) == (up[0] == "-", up[1] == "x")


def codes(log):
    return {finding.code for finding in inspect_recording(log).suspicions}


def changed(log, name, change):
    """Return the recording with the values of a channel changed by a function of a copy."""
    values = log[name].values.copy()
    change(values)
    channels = {**log.channels, name: Channel(name, log[name].unit, log[name].time, values)}
    return recording(log.kind, *channels.values())


@pytest.mark.parametrize(
    ("frames", "jumps"), [(slice(150, 151), True), (slice(150, None), True), (slice(0), False)]
)
def test_a_jump_that_no_motion_explains_is_suspicious(frames, jumps):
    """A row that was shifted by a cell reads x 444 mm off; a fall and a hard landing are no jump."""
    log, _, _ = drop(height=0.4)

    def shift(place):
        place[frames, 0] += 0.444

    doubts = [
        f for f in inspect_recording(changed(log, "quad/position", shift)).suspicions if f.code == "jump"
    ]
    assert bool(doubts) is jumps
    # The way of one frame of the fall, up to 14 mm, comes on top, at a right angle or along.
    assert all(re.search("quad jumps by 44[3-5] mm in one frame at 3.7", str(doubt)) for doubt in doubts)


@pytest.mark.parametrize(("lost", "suspicious"), [(0.3, False), (0.4, True)])
def test_a_body_that_is_lost_in_a_third_of_the_frames_is_suspicious(lost, suspicious):
    log, _, _ = drop()

    def blank(place):
        place[: int(lost * len(place))] = np.nan

    assert ("much-lost" in codes(changed(log, "quad/position", blank))) is suspicious


def test_rows_without_any_value_are_suspicious_and_a_slow_sensor_is_not():
    time = np.arange(200) * 0.01
    slow, fast = np.where(np.arange(200) % 20, np.nan, 1.0 + time), 100.0 + time
    pair = Channel("thrust", "N", time, slow), Channel("speed", "rad/s", time, fast)
    log = recording("thrust-stand", *pair)
    assert not codes(log) & {"blank-rows", "much-lost"}

    def blank(values):
        values[101:105] = np.nan

    found = inspect_recording(changed(log, "speed", blank)).suspicions
    assert "rows without any value: 4 (first: at 1.01 s)" in map(str, found)
    silent = changed(log, "thrust", lambda values: values.__setitem__(slice(100, None), np.nan))
    assert "much-lost" in codes(silent)


@pytest.mark.parametrize("missed", [(), (500,), (500, 900)])
def test_times_at_which_the_speed_drops_out_are_counted(missed):
    """Steps of command at 143 Hz, of a rotor with 60 ms, whose probe misses pulses at a steady speed."""
    random, time = np.random.default_rng(3), np.arange(1600) / 143.0
    speed = np.zeros(time.size)
    for i in range(1, time.size):
        speed[i] = speed[i - 1] + ([300.0, 900.0, 1300.0, 200.0][i // 400] - speed[i - 1]) / (0.06 * 143.0)
    speed += random.normal(size=time.size) * 2.0
    speed[list(missed)] = 0.0
    log = recording("thrust-stand", Channel("speed", "rad/s", time, speed))
    found = [str(f) for f in inspect_recording(log).suspicions if f.code == "speed-drop-outs"]
    assert len(found) == bool(missed)
    assert all(f"drops out {len(missed)} times (first: 0 rad/s at 3.496" in said for said in found)


@pytest.mark.parametrize("kind", ["gear-lf", "gear-hf"])
def test_stated_errors_hold_the_truth_of_the_sample_drops(kind):
    truth = json.loads((SAMPLES / kind / "truth.json").read_text(encoding="utf-8"))
    for known in truth["drops"]:
        seen = inspect_recording(load(SAMPLES / kind / known["log"])).drop
        assert abs(seen.release - known["release"]) < seen.release_error
        assert abs(seen.touchdown - known["touchdown"]) < seen.touchdown_error
        assert abs(seen.impact_speed - known["impact_speed"]) < seen.impact_speed_error
        # Not by being vague: 200 Hz and soft legs, in sixteen drops up to 15.5 ms and 0.145 m/s.
        assert seen.touchdown_error < 0.018
        assert seen.impact_speed_error < 0.18
        assert (seen.down_slope, seen.down_slope_doubt) == ("-z", "")
        if seen.slope is not None:
            assert "lie in one plane: check that they lie on the board" in seen.slope_source


def test_a_throw_does_not_tell_the_slope():
    log, *_ = drop(held=False, height=0.4, markers=False)
    place = log["quad/position"]
    # Thrown along +x: it flies, and slides on, that way, whatever the board does.
    moved = place.values + np.outer(np.minimum(place.time - 3.0, 1.5) * 0.5, [1.0, 0, 0])
    thrown = recording("motion-capture", Channel(place.name, "m", place.time, moved), log["quad/orientation"])
    report = inspect_recording(thrown).drop
    assert report.release is None
    assert report.gravity == pytest.approx(9.80665, rel=0.05)
    assert report.down_slope == "+x"
    assert "was thrown" in report.down_slope_doubt
    assert math.isnan(report.release_error)


def test_markers_beat_the_way_and_a_way_between_axes_is_said():
    # The board falls along +y (a turn of 12 degrees about -x); the body bounces off along +x.
    log, _, touchdown = drop(markers=False)
    place = log["quad/position"]
    gone = np.maximum(place.time - touchdown, 0)
    tilt = Rotation.from_rotvec([-np.radians(12), 0, 0])
    corners = [[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0], [0.5, 0.5, 0]]
    markers = [
        Channel(f"b{i}/position", "m", place.time, np.tile(tilt.apply(corner), (place.time.size, 1)))
        for i, corner in enumerate(corners)
    ]
    for way, axis, doubt in (([1.0, 0.1, 0], "+x", ""), ([0.8, 0.7, 0], "+x", "41 deg off that axis")):
        moved = Channel(place.name, "m", place.time, place.values + np.outer(gone, way))
        alone = inspect_recording(recording("motion-capture", moved, log["quad/orientation"])).drop
        assert alone.down_slope == axis
        assert (doubt in alone.down_slope_doubt) if doubt else alone.down_slope_doubt == ""
        seen = inspect_recording(recording("motion-capture", moved, log["quad/orientation"], *markers)).drop
        assert (seen.down_slope, seen.down_slope_doubt) == ("+y", "")
        assert seen.slope == pytest.approx(np.radians(12), abs=1e-3)
        assert "mm rms off it" in seen.slope_source


def test_static_points_have_no_clock(run, tmp_path):
    text = "Time (s),ESC signal (µs),Thrust (N),Motor Optical Speed (RPM)\n" + "".join(
        f"{2 * i},{1000 + 100 * i},{i if i != 3 else ''},{i * 1000}\n" for i in range(6)
    )
    (path := tmp_path / "points.csv").write_text(text, encoding="utf-8")
    log = load(path)
    assert log.kind == "static-map"
    report = inspect_recording(log).as_json()
    assert report["duration"] is None
    for channel in report["channels"]:
        assert [channel[key] for key in ("rate", "jitter", "longest_hole", "longest_blank")] == [None] * 4
    _, shown, _ = run("inspect", path)
    assert "6 points" in shown
    assert not re.search(r"\d Hz|\d s\b", shown.split("top speed")[0].split("note:")[0])
    to = write_recording(log, tmp_path / "points.h5")
    with h5py.File(to) as file:
        assert file["clocks/0"].attrs["unit"] == "1"
    assert load(to).kind == "static-map"


def test_drop_without_markers_suggests_the_tilt_at_rest():
    log, *_ = drop(slope=np.radians(12), markers=False)
    report = inspect_recording(log)
    assert report.drop.slope == pytest.approx(np.radians(12), abs=1e-6)
    assert "tilt between hold and rest" in report.drop.slope_source


@pytest.mark.parametrize(
    ("scale", "unit", "words"),
    [
        (1000.0, "mm", "mm"), (100.0, "cm", "cm"), (1 / 0.3048, "foot", "feet"),
        (1e-3, "m", "metres, read as mm"),
    ],
)  # fmt: skip
def test_lengths_in_a_wrong_unit_are_suspected(scale, unit, words):
    log, release, _ = drop(scale=scale)
    report = inspect_recording(log)
    assert report.drop.length_unit == unit
    assert report.drop.release == pytest.approx(release, abs=4e-3)
    assert any(f"as if lengths were in {words}" in sentence for sentence in map(str, report.suspicions))


@pytest.mark.parametrize("stretch", [0.5, 0.8, 1.1, 1.2, 1.5])
def test_a_wrong_rate_shows_in_gravity_and_invents_no_small_drop(stretch):
    log, release, _ = drop(height=0.8, noise=5e-5)
    slow = [Channel(c.name, c.unit, stretch * c.time, c.values) for c in log.channels.values()]
    report = inspect_recording(recording("motion-capture", *slow))
    assert report.drop.length_unit == ""
    assert report.drop.gravity == pytest.approx(9.80665 / stretch**2, rel=0.03)  # a few sample errors
    assert report.drop.fall_height == pytest.approx(0.8, rel=0.05)  # touchdown is found to a sample or two
    assert report.drop.release == pytest.approx(stretch * release, abs=0.01)
    assert any("check the rate" in sentence for sentence in map(str, report.suspicions))


def test_far_centimetres_have_one_suspicion():
    log, *_ = drop(scale=100.0, height=1.2)
    sentences = [str(finding) for finding in inspect_recording(log).suspicions if "length" in str(finding)]
    assert len(sentences) == 1
    assert "in cm" in sentences[0]


def test_hover_is_no_drop():
    time = np.arange(0, 10, 0.01)
    place = np.column_stack([np.sin(time), np.cos(0.7 * time), 1 + 0.1 * np.sin(3 * time)])
    log = recording("motion-capture", Channel("a/position", "m", time, place))
    assert inspect_recording(log).drop is None


def bench(thrust=1.0, speed=1.0, tare=0.0, sign=1.0):
    time = np.arange(0, 5, 0.02)
    turning = np.where(time > 1, 500 * (1 - np.exp(-np.maximum(time - 1, 0) / 0.1)), 0.0)
    noise = np.random.default_rng(0).normal(size=time.size) * 0.01
    return recording(
        "thrust-stand",
        Channel("command", "us", time, np.where(time > 1, 1500.0, 1000.0)),
        Channel("speed", "rad/s", time, turning * speed),
        Channel("thrust", "N", time, (sign * 2e-5 * turning**2 + tare + noise) * thrust),
    )


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, None),
        ({"speed": 60 / (2 * np.pi) * 3}, "probably rpm"),
        ({"thrust": 1000 / 9.80665 * 10}, "probably grams"),
        ({"tare": 0.6}, "N before anything turns: no tare"),
        ({"sign": -1.0}, "thrust falls when the speed rises"),
        ({"speed": 0.0}, "speed is zero throughout"),
    ],
)
def test_bench_suspicions(options, said):
    report = inspect_recording(bench(**options))
    assert report.bench.commands == 2
    if said is None:
        assert report.suspicions == ()
        assert report.bench.top_speed == pytest.approx(500, rel=1e-6)
    else:
        assert any(said in sentence for sentence in map(str, report.suspicions))


def test_channel_numbers():
    time = np.delete(np.arange(0, 1, 0.01), [40, 41, 42])
    values = np.clip(np.sin(20 * time), -1, 0.7)
    values[10:15] = np.nan
    report = inspect_channel(Channel("thrust", "N", time, values))
    assert (report.samples, report.holes, report.jitter, report.highest) == (97, 1, 0.0, 0.7)
    numbers = (report.longest_hole, report.rate, report.blank, report.longest_blank)
    assert numbers == pytest.approx((0.04, 100, 5 / 97, 0.06))
    assert 0.1 < report.saturated < 0.5


def test_channels_without_samples_or_values():
    for values in (np.zeros(0), np.full(3, np.nan), np.zeros(1)):
        channel = inspect_channel(Channel("a", "N", np.arange(values.size, dtype=float), values))
        assert channel.samples == values.size
    report = inspect_recording(recording("signals", Channel("a", "V", np.zeros(1), np.full(1, np.nan))))
    assert [str(finding) for finding in report.suspicions] == ["a has no value at all"]
    assert json.loads(json.dumps(report.as_json(), allow_nan=False))["channels"][0]["lowest"] is None


NAMES = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\x00"), min_size=1, max_size=12)


@examples(60)
@given(
    names=st.lists(st.one_of(NAMES, st.sampled_from(["a", "a/b", "a/b/c", "/", ".", "..", "#0", "a/"])),
                   min_size=1, max_size=6, unique=True),
    seed=st.integers(0, 2**32 - 1),
    notes=st.lists(NAMES, max_size=3),
)  # fmt: skip
def test_converted_recordings_read_back_equal(tmp_path, names, seed, notes):
    findings = tuple(
        Finding("a-code", sentence, severity)
        for severity, sentence in zip(("note", "warning", "note"), notes, strict=False)
    )
    random = np.random.default_rng(seed)
    clocks = [np.cumsum(random.uniform(1e-5, 1, size=int(random.integers(0, 20)))) for _ in range(2)]
    channels = {}
    for name in names:
        time = clocks[int(random.integers(0, 2))]
        shape = (time.size,) if random.uniform() < 0.5 else (time.size, 3)
        values = random.normal(size=shape)
        values[random.uniform(size=shape) < 0.2] = np.nan
        channels[name] = Channel(name, str(random.choice(["N", "rad/s", "", "m/s²"])), time, values)
    first = Recording(
        "load-cell", channels, Provenance("a.csv", "12", "lvm", "device µ", {"rate": "5"}, findings)
    )
    path = write_recording(first, tmp_path / "out.bin")
    assert detect(path) == "sysid-hdf5"
    again = load(path)
    assert list(again.channels) == list(first.channels)
    assert again.kind == first.kind
    for name, channel in first.channels.items():
        assert again[name].unit == channel.unit
        np.testing.assert_array_equal(again[name].time, channel.time)
        np.testing.assert_array_equal(again[name].values, channel.values)
    origin = again.provenance
    assert (origin.device, dict(origin.options), origin.format) == ("device µ", {"rate": "5"}, "lvm")
    assert origin.notes[:-1] == findings
    assert origin.notes[-1].code == "converted"
    assert "converted from a.csv (SHA-256 12)" in origin.sentences[-1]


def test_convert_refuses_to_replace_and_damage_is_named(tmp_path):
    source, to = tmp_path / "cell.csv", tmp_path / "out.h5"
    source.write_text("Time (s),Fz (N)\n0,1\n1e-3,2\n", encoding="utf-8")
    with pytest.raises(LogError, match=r"what is written is HDF5; name it out\.h5"):
        convert_file(source, to.with_name("out.csv"))
    assert "wrote" in convert_file(source, to)
    with pytest.raises(LogError, match=r"exists already.*--force"):
        convert_file(source, to)
    convert_file(source, to, force=True)
    data = to.read_bytes()
    for cut in range(0, len(data), 97):
        to.write_bytes(data[:cut])
        with pytest.raises(SysidError):
            load(to, format="sysid-hdf5")


def _table(path, header, *columns):
    rows = (",".join(f"{value:.5f}" for value in row) for row in zip(*columns, strict=True))
    path.write_text("\n".join([header, *rows, ""]), encoding="utf-8")


@pytest.fixture
def two_logs(tmp_path):
    """A log of a step of the speed, the places of a second log and of a result, and every fifth row."""
    time = np.arange(0, 5, 2e-3)
    speed = 300.0 * (1 - np.exp(-np.maximum(time - 2.5, 0) / 0.1)) * (time > 1)
    first, second, to = tmp_path / "a.csv", tmp_path / "b.csv", tmp_path / "out.h5"
    _table(first, "Time (s),Speed (rad/s),Fz (N)", time, speed, 0.01 * speed)
    return first, second, to, time[::5], speed[::5]


def test_convert_joins_a_second_file(two_logs):
    first, second, to, time, speed = two_logs
    volts = np.full(time.size, 16.1)
    _table(second, "Time (s),Speed (rad/s),Voltage (V),Current (A)", time + 7, speed, volts, volts / 50)
    sentence = convert_file(first, to, second=SecondFile(second))
    # Half of the second file's sample period of 10 ms.
    assert float(sentence.split("offset ")[1].split(" s")[0]) == pytest.approx(-7, abs=5e-3)
    log = load(to)
    assert log["voltage"].time[0] == pytest.approx(0, abs=5e-3)
    assert any("at the next best offset" in note for note in log.provenance.sentences)


def test_a_second_log_of_the_command_line_has_its_own_options(run, two_logs):
    first, second, to, _, speed = two_logs
    _table(second, "n,U", speed * 30 / np.pi, np.full(speed.size, 16.1))
    words = ["--add", second, "--add-format", "load-cell-csv", "--add-option", "rate=100"]
    words += ["--add-option", 'columns={speed = "n", voltage = "U"}']
    words += ["--add-option", 'units={speed = "rpm", voltage = "V"}']
    code, _, err = run("convert", first, "--out", to, *words)
    assert code == 0, err
    assert load(to)["voltage"].values[0] == 16.1
    assert load(to)["voltage"].time[0] == pytest.approx(0, abs=2.5e-3)


def test_options_of_the_command_line():
    words = ["rate=10000", 'units={thrust = "N"}', "rigid_body=F450", "static=true"]
    assert parse_options(words) == {
        "rate": 10000, "units": {"thrust": "N"}, "rigid_body": "F450", "static": True,
    }  # fmt: skip
    with pytest.raises(SysidError, match="'rate' is not NAME=VALUE"):
        parse_options(["rate"])


def test_commands(run, tmp_path):
    path, plot, to = tmp_path / "pose.csv", tmp_path / "out.png", tmp_path / "out.h5"
    log, *_ = drop(markers=False)
    place, turn = log["quad/position"], log["quad/orientation"]
    _table(path, "t,x,y,z,qw,qx,qy,qz", place.time, *place.values.T, *turn.values.T)
    code, shown, err = run("inspect", path, "-o", "length_unit=m", "--figure", plot)
    assert code == 0, err
    assert float(shown.split("released at ")[1].split(" ±")[0]) == pytest.approx(3.5, abs=4e-3)
    assert 'up = "+z"' in shown
    assert plot.read_bytes().startswith(b"\x89PNG")
    report = json.loads(run("inspect", path, "-o", "length_unit=m", "--json")[1])[0]
    assert report["drop"]["up"] == "+z"
    assert report["channels"][0]["unit"] == "m"
    assert run("convert", path, "--out", to, "-o", "length_unit=m")[0] == 0
    assert "drop of body" in run("inspect", to)[1]


@pytest.mark.parametrize(
    ("blank", "longest"),
    [
        # A clock of 10 ms: seven rows before the first value, or behind the last, are 70 ms without one.
        (range(7), 0.07),
        (range(93, 100), 0.07),
        # Between two values there is a step more than there are rows.
        (range(40, 47), 0.08),
        ([*range(3), 50, *range(95, 100)], 0.05),
        # A hole of the clock (0.5 s behind row 79) is no blank.
        ([20], 0.02),
        (range(100), 1.48),
    ],
)
def test_blanks_at_the_edges_of_a_log_count(blank, longest):
    time = np.arange(100) * 0.01 + np.where(np.arange(100) >= 80, 0.49, 0.0)
    values = np.random.default_rng(0).normal(size=100)
    values[list(blank)] = np.nan
    report = inspect_channel(Channel("thrust", "N", time, values))
    assert report.blank == pytest.approx(len(blank) / 100)
    assert report.longest_blank == pytest.approx(longest, abs=1e-9)


def test_a_sensor_of_every_third_row_is_drawn():
    """A line joins neighbours only: each sample between two blanks needs a dot, and no other has one."""
    time = np.arange(60) * 0.01
    thrust = np.where(np.arange(60) % 3 == 0, time + 1.0, np.nan)
    thrust[50:55] = 2.0
    log = recording(
        "thrust-stand", Channel("command", "us", time, time + 1000), Channel("thrust", "N", time, thrust)
    )
    _, axes = figure_logs([log], [inspect_recording(log)]).axes
    line, dots = axes.get_lines()
    np.testing.assert_array_equal(line.get_ydata(), thrust)
    np.testing.assert_array_equal(dots.get_xdata(), time[[i for i in range(0, 60, 3) if not 49 <= i <= 55]])
    assert dots.get_marker() == "."


def test_a_load_cell_without_a_speed_has_no_top_speed(run, tmp_path):
    path = tmp_path / "log.csv"
    _table(path, "Time (s),Fz (N)", np.arange(50) * 0.01, np.arange(50))
    _, shown, _ = run("inspect", path)
    assert "thrust" in shown
    assert "top speed" not in shown
