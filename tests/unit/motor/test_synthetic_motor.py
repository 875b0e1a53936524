"""Synthesized bench logs: what instruments under a known motor would have written."""

import csv

import numpy as np
import pytest

from sysid.campaign.file import read_campaign
from sysid.errors import CampaignError, ExportError
from sysid.loaders import detect, load
from sysid.motor import model
from sysid.synthetic import read_truth, synthesize_motor
from sysid.synthetic.bench import NOISE, RESOLUTION


@pytest.fixture(scope="module")
def exact(tmp_path_factory):
    return synthesize_motor(tmp_path_factory.mktemp("exact") / "motor", seed=21, noise=False)


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    return synthesize_motor(tmp_path_factory.mktemp("noisy") / "motor", seed=22)


def trials_of(folder):
    """Yield what the truth says of each trial, the times of its log, and its channels."""
    for trial in read_truth(folder)["trials"]:
        recording = load(folder / trial["log"])
        channels = {name: recording[name].values for name in ("command", "speed", "thrust", "torque")}
        yield trial, recording["speed"].time, channels


def test_synthetic_motor_campaign_is_the_asked_for_one(noisy):
    campaign = read_campaign(noisy / "campaign.toml", "motor")
    both = ("fit", "validate")
    expected = {("reverse", "fit"), *((way, use) for way in ("forward", "reversal") for use in both)}
    assert {(t.direction, t.use) for t in campaign.trials} == expected
    assert {detect(noisy / t.log) for t in campaign.trials} == {"load-cell-csv", "load-cell-hdf5"}
    for entry in (*campaign.curves.static, *campaign.curves.no_load):
        recording = load(noisy / entry.log)
        assert recording.kind == "static-map"
        assert "1580" in recording.provenance.device
    # Stated to ten digits: R goes as its square and is known to 0.1 %.
    true = read_truth(noisy)["parameters"]["back_emf_constant"]
    assert 1 / campaign.motor.kv == pytest.approx(true, rel=1e-9)


def test_synthetic_motor_steady_speeds_are_those_of_the_model(exact):
    truth = read_truth(exact)
    for trial, time, log in trials_of(exact):
        steps = trial["command_steps"]
        ends = [t for t, _ in steps[1:]] + [time[-1]]
        for (start, u), end in zip(steps, ends, strict=True):
            if u == 0.0 or end - start < 0.45:
                continue
            late = (time > end - 0.01) & (time < end)
            _, speed = model.steady_state(u, truth["parameters"])
            # Quantum 0.05 rad/s; after 0.49 s (six to ten time constants of 50 to 80 ms, less a reversal
            # delay of 0.2 s in the trials that turn round) little of the step is missing.
            slack = 3.0 if trial["direction"] == "reversal" else 0.3
            assert log["speed"][late].mean() == pytest.approx(float(speed), abs=slack), (trial["name"], u)


def test_synthetic_motor_cell_feels_the_stator_not_the_air(exact):
    truth = read_truth(exact)
    p = truth["parameters"]
    for trial, time, log in trials_of(exact):
        assert abs(trial["tare_force"]) > 0
        torque = log["torque"] - trial["tare_torque"]
        air = model.aerodynamic_torque(log["speed"], p)
        # I^r ΔΩ = ∫ (stator − air) dt over an acceleration: the first step from idle.
        start = trial["command_steps"][2][0]
        inside = (time >= start) & (time <= start + 0.1)
        gained = p["rotor_inertia"] * (log["speed"][inside][-1] - log["speed"][inside][0])
        impulse = np.sum((torque - air)[inside]) / truth["rate"]
        # The dead band, if any, jumps within one sample: 1e-4 s of 0.3 N·m, 3e-5; else quantization only.
        assert impulse == pytest.approx(gained, rel=0.005, abs=3.5e-5), trial["name"]
        assert np.max(np.abs(torque - air)[inside]) > 0.01
        thrust = log["thrust"] - trial["tare_force"]
        # Half a quantum each of the cell (0.01 N) and of the speed (0.05 rad/s at 1.2e-5·2·900 N·s/rad).
        np.testing.assert_allclose(thrust, model.thrust(log["speed"], p), atol=0.0051 + 0.0006)


def test_synthetic_motor_rows_at_rest_show_the_tare_only(exact):
    for trial, time, log in trials_of(exact):
        assert time[0] == pytest.approx(trial["log_start"], abs=1e-9)
        assert time[0] > 1.0
        rest = log["command"] == 1500
        assert rest[: round(0.4 * 10_000)].all()
        assert not np.any(log["speed"][rest])
        # Half a quantum.
        np.testing.assert_allclose(log["thrust"][rest], trial["tare_force"], atol=0.5001 * RESOLUTION.force)
        np.testing.assert_allclose(log["torque"][rest], trial["tare_torque"], atol=0.5001 * RESOLUTION.torque)


def test_synthetic_motor_responds_after_the_command_delay(exact):
    delay = read_truth(exact)["parameters"]["command_delay"]
    assert delay > 0
    trial, time, log = next(trials_of(exact))
    start, u = trial["command_steps"][3]
    row = int(np.argmin(np.abs(time - start)))
    assert log["command"][row] == 1500 + 500 * u
    assert log["command"][row - 1] != log["command"][row]
    before = log["torque"][row - 50 : row]
    moved = np.abs(log["torque"][row:] - before.mean()) > 5 * RESOLUTION.torque
    # The current needs a fraction of a millisecond (ΔV/L of some 900 A/s) to show: five quanta are 0.06 A.
    assert int(np.argmax(moved)) / 10_000 == pytest.approx(delay, abs=5e-4)


def test_synthetic_motor_noise_has_the_stated_size(noisy):
    for trial, time, log in trials_of(noisy):
        start = trial["window_start"]
        idle = (time > start) & (time < start + 0.19)
        for name, size in (("speed", NOISE.speed), ("thrust", NOISE.force), ("torque", NOISE.torque)):
            jumps = np.diff(log[name][idle]) / np.sqrt(2)
            # 1900 differences: the size is known to about 2 %; quantization adds 0.3 % at most.
            assert jumps.std() == pytest.approx(size, rel=0.1), (trial["name"], name)


def test_synthetic_motor_stand_files_look_like_the_programs(noisy):
    units = {"static-forward.csv": "gf", "static-reverse.csv": "N", "no-load-forward.csv": "gf"}
    for name, unit in units.items():
        data = (noisy / name).read_bytes()
        assert data.startswith(b"\xef\xbb\xbfTime (s),ESC signal (\xc2\xb5s),Servo 1")
        lines = data.decode("utf-8-sig").split("\n")
        assert all(line.endswith(",") for line in lines[:-1])
        rows = list(csv.reader(lines[:-1]))
        assert {len(row) for row in rows} == {22}
        assert rows[0][9] == f"Thrust ({unit})"
        # Blanks beside the servos and the message: one thrust and one torque, at least.
        blank = sum(cell == "" for row in rows[1:] for cell in row[5:20])
        assert blank >= 2
        table = [dict(zip(rows[0], row, strict=True)) for row in rows[1:]]
        assert all(float(row["Motor Optical Speed (RPM)"]) >= 0 for row in table)
        volts = np.array([float(row["Voltage (V)"]) for row in table])
        assert np.all(np.abs(volts / 11.1 - 1) < 0.025)
        if name.startswith("static"):
            assert np.ptp(volts) > 0.02  # it sags


@pytest.mark.parametrize(("direction", "sign", "thrust"), [("forward", 1, 1.2e-5), ("reverse", -1, 0.62e-5)])
def test_synthetic_motor_stand_gives_the_true_curves(noisy, direction, sign, thrust):
    truth = read_truth(noisy)
    recording = load(noisy / f"static-{direction}.csv")
    tare = truth["thrust_stand"][f"static-{direction}.csv"]
    speed = recording["speed"].values
    for name, key, size in (
        ("thrust", "tare_thrust", thrust),
        ("torque", "tare_torque", truth["parameters"][f"torque_quadratic_{direction}"]),
    ):
        values = sign * (recording[name].values - tare[key])
        known = np.isfinite(values)
        found = np.sum((values * speed**2)[known]) / np.sum(speed[known] ** 4)
        # 20 points with noise of 4 mN on 4 to 8 N, 0.1 mN·m on 0.1 N·m, 0.2 rad/s on 700: below 0.1 %.
        assert found == pytest.approx(size, rel=3e-3)
    empty = load(noisy / f"no-load-{direction}.csv")
    u = (empty["command"].values - 1500) / 500
    turning = u != 0
    slope = empty["speed"].values[turning] * 11.1 / empty["voltage"].values[turning] / np.abs(u[turning])
    # One reading: 0.2 rad/s on 100 and more, 2 mV on 11 V; the mean of twenty is below 0.1 %. k_d takes 3e-5.
    assert slope.mean() == pytest.approx(1030.0, rel=1e-3)
    assert np.nanmax(np.abs(sign * empty["thrust"].values)) < 0.06  # tare and noise


def test_synthetic_motor_same_seed_same_numbers(tmp_path, noisy):
    again = synthesize_motor(tmp_path / "again", seed=22)
    for file in sorted(noisy.iterdir()):
        if file.suffix == ".h5":
            repeated = load(again / file.name)
            for name, channel in load(file).channels.items():
                np.testing.assert_array_equal(channel.values, repeated[name].values)
        else:
            assert file.read_bytes() == (again / file.name).read_bytes(), file.name


def test_synthetic_motor_refuses_and_writes_nothing(tmp_path):
    with pytest.raises(CampaignError, match="no parameter"):
        synthesize_motor(tmp_path / "new", seed=1, parameters={"resistance": 1.0})
    with pytest.raises(CampaignError, match="1 kHz"):
        synthesize_motor(tmp_path / "new", seed=1, rate=100.0)
    assert not (tmp_path / "new").exists()
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "log.csv").write_text("mine", encoding="utf-8")
    with pytest.raises(ExportError, match="there"):
        synthesize_motor(tmp_path / "there", seed=1)
