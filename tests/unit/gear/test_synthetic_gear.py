"""Synthesized drops: files say what was simulated, to their quantization, and hold what real logs have."""

import csv
import math

import numpy as np
import pytest

from fakes.gear_campaigns import EXACT
from sysid.campaign.file import read_campaign
from sysid.errors import CampaignError, ExportError
from sysid.gear import model
from sysid.loaders import detect, load
from sysid.synthetic import LF_DROPS, DropPlan, read_truth, synthesize_gear
from sysid.trials.capture import CaptureFrame, held_level, planar_motion, spatial_motion

ONE_DROP = (DropPlan(math.radians(15), 0.6),)


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    return synthesize_gear(tmp_path_factory.mktemp("noisy") / "lf", seed=11)


@pytest.fixture(scope="module")
def exact(tmp_path_factory):
    return synthesize_gear(tmp_path_factory.mktemp("exact") / "lf", seed=12, **EXACT)


def log_of(folder, drop):
    return load(folder / drop["log"], **({"rigid_body": "F450"} if "pose" in drop["export"] else {}))


def planar_of(folder, drop):
    """Motion of one drop in the plane, relative to the surface point, level as held by the magnet."""
    capture = read_campaign(folder / "campaign.toml", "gear").capture
    frame, offset = CaptureFrame(capture.up, capture.down_slope), capture.centre_of_mass_offset
    motion = spatial_motion(log_of(folder, drop), "F450", frame, centre_of_mass_offset=offset)
    held = slice(0, int(np.searchsorted(motion.time, drop["release"])))
    point = frame.matrix @ np.array(read_truth(folder)["capture"]["surface_point"])
    return planar_motion(motion, point, held_level(motion, held)), held


def true_motion(truth, drop, time):
    """Simulate a drop again from its truth file alone: (n, 3) x, z, pitch at times of its own clock."""
    begin = drop["state_at_release"]
    start = np.array([begin["x_B"], begin["z_B"], begin["q_B"], 0.0, 0.0, 0.0])
    release = drop["release"]
    falling = time > release
    clock = np.concatenate([[0.0], time[falling] - release])
    run = model.simulate(truth["parameters"], drop["slope"], start, clock, tolerance=model.TIGHT_TOLERANCE)
    out = np.tile(start[:3], (len(time), 1))
    out[falling] = run.state[1:, :3]
    return out


def test_synthetic_gear_logs_read_back_to_the_truth(exact):
    truth = read_truth(exact)
    for drop in truth["drops"]:
        motion, _ = planar_of(exact, drop)
        expected = true_motion(truth, drop, motion.time)
        # Files keep micrometres and millionths of a quaternion (2e-6 rad; over the 22 mm from origin to
        # centre of mass far below 1 µm); Unix seconds in double precision keep 0.24 µs, 0.25 µm at 1 m/s,
        # and that error moves the simulation that is compared too. 5 µm and 5e-6 rad cover them.
        assert np.max(np.abs(motion.coordinates() - expected)) < 5e-6, drop["name"]


def test_synthetic_gear_free_fall_gives_g(exact, noisy):
    # One sigma of g from a parabola through 20 samples is sqrt(720/20^5)·noise/(5 ms)²: 0.18 m/s², 1.8 %,
    # with 0.3 mm; 2e-5 of g with the 0.3 µm rms of the file's quantization. Some four and fifty sigma.
    for path, tolerance in ((exact, 1e-3), (noisy, 0.08)):
        truth = read_truth(path)
        drop = next(each for each in truth["drops"] if each["impact_speed"] == 1.0)
        motion, _ = planar_of(path, drop)
        inside = (motion.time > drop["release"]) & (motion.time < drop["touchdown"])
        elapsed = motion.time[inside] - drop["release"]
        acceleration = 2 * np.polyfit(elapsed, motion.z[inside], 2)[0]
        assert acceleration == pytest.approx(-truth["parameters"]["gravity"], rel=tolerance)


def test_synthetic_gear_rear_foot_touches_when_and_as_fast_as_stated(exact):
    truth = read_truth(exact)
    p = truth["parameters"]
    for drop in truth["drops"]:
        motion, held = planar_of(exact, drop)
        slope = drop["slope"]
        # Level body: the rear foot hangs at (-dx_f, -dz_f), the plane falls through the origin.
        x, z = motion.x[held].mean() - p["foot_dx"], motion.z[held].mean() - p["foot_dz"]
        height = z + x * math.tan(slope)
        # 2 µm of 8 mm and more, see the quantization above.
        assert height == pytest.approx(drop["fall_height"], abs=2e-6)
        fall = drop["touchdown"] - drop["release"]
        # Unix seconds round by 0.24 µs, 5e-6 of the shortest fall.
        assert p["gravity"] * fall == pytest.approx(drop["impact_speed"], rel=2e-5)
        assert height == pytest.approx(0.5 * p["gravity"] * fall**2, abs=2e-6)


def test_synthetic_gear_noise_has_the_stated_size(noisy):
    truth = read_truth(noisy)
    places, angles, neighbours = [], [], []
    for drop in truth["drops"]:
        recording = log_of(noisy, drop)
        position, orientation = recording["F450/position"], recording["F450/orientation"]
        held = position.valid & (position.time < drop["release"])
        place = position.values[held] - position.values[held].mean(axis=0)
        places.append(place)
        neighbours.append(np.mean(place[1:] * place[:-1]) / np.mean(place**2))
        # Small rotations: twice the vector part relative to the mean is the angle about each axis.
        q = orientation.values[held] - orientation.values[held].mean(axis=0)
        angles.append(2 * np.linalg.norm(q, axis=1))
    # About 130 frames x 3 axes x 8 drops: the standard deviation is known to 1.3 %; 6 % is over four sigma.
    assert np.concatenate(places).std() == pytest.approx(0.3e-3, rel=0.06)
    spread = np.sqrt(np.mean(np.concatenate(angles) ** 2) / 3)
    assert spread == pytest.approx(math.radians(0.2), rel=0.06)
    # White: the mean of eight lag-one correlations of some 400 numbers has a sigma of 0.018.
    assert abs(np.mean(neighbours)) < 0.08


def test_synthetic_gear_motive_layout_is_that_of_the_program(noisy):
    text = (noisy / read_truth(noisy)["drops"][0]["log"]).read_bytes().decode("utf-8")
    lines = text.split("\r\n")
    head = lines[0].split(",")
    assert head[:2] == ["Format Version", "1.23"]
    keys = dict(zip(head[::2], head[1::2], strict=True))
    assert keys["Rotation Type"] == "Quaternion"
    assert keys["Length Units"] == "Meters"
    assert keys["Export Frame Rate"] == "200.000000"
    assert lines[1] == ""
    places = [",".join(line.split(",")[:2]) for line in lines[2:7]]
    assert places == [",Type", ",Name", ",ID", ",", "Frame,Time (Seconds)"]
    assert lines[6].endswith("X,Y,Z")
    first = lines[7].split(",")
    assert int(first[0]) > 0
    assert float(first[1]) == pytest.approx(int(first[0]) / 200)
    assert int(keys["Total Exported Frames"]) == len(lines) - 8


def test_synthetic_gear_every_export_format_is_there(noisy):
    drops = read_truth(noisy)["drops"]
    exports = {drop["export"]: noisy / drop["log"] for drop in drops}
    assert detect(exports["pose-table"]) == "pose-table"
    assert all(detect(path) == "motive-csv" for name, path in exports.items() if "motive" in name)
    assert "Length Units,Millimeters" in exports["motive-mm"].read_text(encoding="utf-8")
    assert "Rotation Type,XYZ" in exports["motive-euler"].read_text(encoding="utf-8")


def test_synthetic_gear_occluded_frames_are_blank_and_flips_flip(noisy):
    for drop in read_truth(noisy)["drops"]:
        gaps = drop["occlusions"]
        assert len(gaps) == 3
        assert all(1 <= length <= 4 for _, length in gaps)
        lost = {first + k for first, length in gaps for k in range(length)}
        text = (noisy / drop["log"]).read_text(encoding="utf-8")
        rows = list(csv.reader(text.splitlines()))
        if drop["export"] == "pose-table":
            body, table = slice(1, 8), rows[1:]
        else:
            names = rows[3]
            columns = [i for i, name in enumerate(names) if name == "F450"]
            body, table = slice(columns[0], columns[-1] + 1), rows[7:]
            others = [i for i, name in enumerate(names) if i > 1 and name != "F450"]
            assert all(row[i] for row in table for i in others)
        assert {i for i, row in enumerate(table) if not any(row[body])} == lost
        assert all(all(row[body]) for i, row in enumerate(table) if i not in lost)
        if drop["export"] == "motive":
            seen = [row[columns[0] : columns[0] + 4] for i, row in enumerate(table) if i not in lost]
            q = np.array(seen, dtype=float)
            assert np.sum(np.sum(q[1:] * q[:-1], axis=1) < 0) == len(set(drop["sign_flips"]))


def test_synthetic_gear_default_campaign_is_the_asked_for_one(noisy):
    campaign = read_campaign(noisy / "campaign.toml", "gear")
    uses = [trial.use for trial in campaign.trials]
    assert uses.count("fit") == 6
    assert uses.count("validate") == 2
    for trial in campaign.trials:
        assert math.radians(5) <= trial.slope <= math.radians(35)
    assert all(0.4 <= drop.impact_speed <= 1.0 for drop in LF_DROPS)
    for drop in read_truth(noisy)["drops"]:
        time = log_of(noisy, drop)["F450/position"].time
        assert time[0] > 0
        assert drop["release"] - time[0] > 0.5
        # The filter's 37 samples and one for the rate must fit after the 0.7 s that are compared.
        assert time[-1] - drop["touchdown"] > 0.7 + 38 / 200
        assert drop["travel"] < campaign.surface.board_length


def test_synthetic_gear_axes_of_the_room_change_nothing_in_the_plane(tmp_path):
    quiet = {"noise_position": 0.0, "noise_angle": 0.0, "occlusions": False, "drops": ONE_DROP, "seed": 3}
    motions = []
    for number, (up, down) in enumerate((("+y", "-z"), ("+z", "+y"), ("-x", "+z"))):
        path = synthesize_gear(tmp_path / str(number), up=up, down_slope=down, **quiet)
        motions.append(planar_of(path, read_truth(path)["drops"][0])[0])
    for other in motions[1:]:
        # Quantization of two files, see above.
        np.testing.assert_allclose(other.coordinates(), motions[0].coordinates(), atol=5e-6)
        # Roll and yaw swing by 0.4 and 0.28 deg after the contact, whatever the axes are called.
        assert np.max(np.abs(other.roll)) == pytest.approx(math.radians(0.4), rel=0.05)
        assert np.max(np.abs(other.yaw)) == pytest.approx(math.radians(0.28), rel=0.05)


def test_synthetic_gear_same_seed_same_bytes(tmp_path):
    for name, seed in (("a", 7), ("b", 7), ("c", 8)):
        synthesize_gear(tmp_path / name, seed=seed, drops=ONE_DROP)
    names = sorted(file.name for file in (tmp_path / "a").iterdir())
    assert names == ["campaign.toml", "drop-1-15deg-0.60mps.csv", "truth.json"]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    assert (tmp_path / "a" / names[1]).read_bytes() != (tmp_path / "c" / names[1]).read_bytes()


def test_synthetic_gear_refuses_and_writes_nothing(tmp_path):
    full = tmp_path / "full"
    full.mkdir()
    (full / "notes.txt").write_text("mine", encoding="utf-8")
    for force in (False, True):  # not a synthesized folder: not replaced either
        with pytest.raises(ExportError, match="full"):
            synthesize_gear(full, seed=1, drops=ONE_DROP, force=force)
    assert [file.name for file in full.iterdir()] == ["notes.txt"]
    soft = {"leg_axial_stiffness": 20.0, "leg_axial_damping": 0.01}
    for parameters, words in (({"leg_stiffness": 1.0}, "no parameter"), (soft, "cannot be simulated")):
        with pytest.raises(CampaignError, match=words):
            synthesize_gear(tmp_path / "new", seed=1, drops=ONE_DROP, parameters=parameters)
    with pytest.raises(CampaignError, match="at least one of them to fit"):
        synthesize_gear(tmp_path / "new", seed=1, drops=(DropPlan(0.1, 0.5, "validate"),))
    with pytest.raises(CampaignError, match="radians"):
        DropPlan(15.0, 0.5)
    assert not (tmp_path / "new").exists()
    path = synthesize_gear(tmp_path / "new", seed=1, drops=ONE_DROP)
    with pytest.raises(ExportError, match="exists"):
        synthesize_gear(tmp_path / "new", seed=2, drops=ONE_DROP)
    assert synthesize_gear(tmp_path / "new", seed=2, drops=ONE_DROP, force=True) == path
    assert read_truth(path)["seed"] == 2
    assert [file.name for file in tmp_path.iterdir() if file.name.startswith(".")] == []


def test_synthetic_truth_is_refused_where_there_is_none(tmp_path):
    with pytest.raises(ExportError, match="no readable truth"):
        read_truth(tmp_path)
    (tmp_path / "truth.json").write_text("[" * 100_000, encoding="utf-8")
    with pytest.raises(ExportError, match=r"no readable truth \(lists in lists without end"):
        read_truth(tmp_path)
    (tmp_path / "truth.json").write_text('{"schema": "other"}', encoding="utf-8")
    with pytest.raises(ExportError, match="schema"):
        read_truth(tmp_path)
