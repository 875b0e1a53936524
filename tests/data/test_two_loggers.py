"""One run on two loggers: a stand whose command column is empty, and the speed controller's own telemetry."""

import re

import numpy as np
import pytest

from fakes.motor_bench import bench_of
from fakes.places import REAL
from sysid.loaders import load
from sysid.motor.follow_up import shown_by_stand
from sysid.motor.model import aerodynamic_torque, thrust

STAND, CONTROLLER = (REAL / "esc_test" / name for name in ("Log_2019-11-05_171350.csv", "f40_steps_5-2.csv"))


@pytest.fixture
def joined(tmp_path, run):
    if not STAND.exists():
        pytest.skip("the real run on two loggers is not beside the project (shared/real/esc_test)")
    code, out, err = run("convert", STAND, "--add", CONTROLLER, "--out", tmp_path / "f40.h5")
    assert code == 0, err
    return tmp_path / "f40.h5", out


def test_clocks_are_aligned_by_the_speed_that_both_measured(joined):
    path, out = joined
    both, telemetry = load(path), load(CONTROLLER)["speed"]
    offset = float(re.search(r"offset \+([\d.]+) s", out).group(1))
    # The stand started 13 s before the telemetry did.
    speed = both["speed"]
    seen = np.interp(speed.time, telemetry.time + offset, telemetry.values, left=np.nan, right=np.nan)
    turning = seen > 200
    assert turning.sum() > 2500
    # At constant duty both read the same speed to 0.5 %; half a second off, two in five rows of the
    # steps down at the end and each step up would differ.
    apart = np.abs(speed.values - seen)[turning] / seen[turning]
    assert np.median(apart) < 0.005
    moved = [
        np.nanmean(
            np.abs(speed.values - np.interp(speed.time, telemetry.time + offset + late, telemetry.values))
        )
        for late in (-0.1, 0.0, 0.1)
    ]
    assert moved[1] < min(moved[0], moved[2])
    # The command is the telemetry's duty, at the telemetry's own rate.
    command = both["command"]
    assert (command.unit, command.values.min(), command.values.max()) == ("1", 0.0, 1.0)
    assert command.time.size == telemetry.time.size
    assert {"thrust", "torque", "voltage", "motor_voltage"} <= {*both.channels}


def test_its_curves_are_those_of_the_propeller(joined, run, tmp_path):
    path = tmp_path / "f40.toml"
    code, _, err = run("new-campaign", "motor", "--minimal", "--from", joined[0], "--out", path)
    assert code == 0, err
    text = path.read_text(encoding="utf-8")
    assert 'unit = "1"\nminimum = -1\nneutral = 0\nmaximum = 1\n' in text
    # Only what the label states is typed in.
    text = text.replace("TODO rpm/V", "1600 rpm/V")
    path.write_text(re.sub(r"^rotor_inertia.*\n", "", text, flags=re.MULTILINE), encoding="utf-8")
    campaign, bench = bench_of(path)
    # Least squares on the steady rows of six public logs with this propeller: 10.2 N, 0.132 N·m.
    assert float(thrust(1500.0, bench.values)) == pytest.approx(10.2, rel=0.025)
    assert float(aerodynamic_torque(1500.0, bench.values)) == pytest.approx(0.132, rel=0.025)
    (trial,) = bench.trials
    assert trial.entry.direction == "forward"
    assert trial.log.steps.level.max() == 1.0
    # Joined by a speed of 42 Hz, the command comes later than the speed that it causes.
    assert "speed-before-command" in {found.code for found in shown_by_stand(campaign, bench).findings()}
