"""Public logs of a Series 1580 stand: three motors and controllers with one propeller, so one truth."""

from pathlib import Path

import numpy as np
import pytest

from fakes import places
from fakes.motor_bench import bench_of
from sysid.export.numbers import numbers_for
from sysid.motor.follow_up import shown_by_stand
from sysid.workflows.fit import fit_motor
from sysid.workflows.options import FitOptions
from sysid.workflows.show import verdict_on

STAND = places.REAL / "esc_test"
# Log, Kv on the label [rpm/V], whether it has a command, drop-outs of the speed while it turns.
LOGS = [
    ("Log_2019-11-09_181347", 1900, True, 13),
    ("Log_2019-11-07_174807", 1750, False, 20),
    ("Log_2019-11-05_171350", 1600, False, 25),
]
# Least squares on the steady rows of six logs of this propeller at 1500 rad/s: 10.0 to 10.4 N, 0.129 to
# 0.134 N·m.
SPEED, TRUTH = 1500.0, {"thrust": 10.2, "torque": 0.132}


def _campaign(folder: Path, log: str, kv: float) -> Path:
    path = STAND / f"{log}.csv"
    if not path.exists():
        pytest.skip(f"real log {path.name} is not beside the project (shared/real/esc_test)")
    text = f"""
kind = "motor"
name = "stand"
trials = [{{ name = "steps", log = '{path}', direction = "forward" }}]
[motor]
kv = "{kv} rpm/V"
rotor_inertia = "1.2e-5 kg·m²"
[command]
unit = "us"
minimum = 1000
maximum = 2000
"""
    target = folder / f"{log}.toml"
    target.write_text(text, encoding="utf-8")
    return target


@pytest.fixture(scope="module")
def benches(tmp_path_factory: pytest.TempPathFactory) -> dict:
    folder = tmp_path_factory.mktemp("stand")
    with pytest.warns(match="no command is logged"):
        return {log: bench_of(_campaign(folder, log, kv)) for log, kv, _, _ in LOGS}


def test_one_propeller_has_one_thrust_and_torque(benches) -> None:
    intervals: dict[str, list[tuple[float, float]]] = {"thrust": [], "torque": []}
    for campaign, bench in benches.values():
        shown = [row for row in shown_by_stand(campaign, bench).curves if row.speed == SPEED]
        assert {row.quantity for row in shown} == {*TRUTH}
        for row in shown:
            # Required: 2.5 %.
            assert row.value == pytest.approx(TRUTH[row.quantity], rel=0.025)
            intervals[row.quantity].append(row.interval_95)
    for ends in intervals.values():
        assert len(ends) == 3
        assert max(low for low, _ in ends) < min(high for _, high in ends)


@pytest.mark.parametrize(("log", "kv", "commanded", "drop_outs"), LOGS)
def test_drop_outs_are_counted_and_empty_commands_found(benches, log, kv, commanded, drop_outs) -> None:
    bench = benches[log][1]
    (trial,) = bench.trials
    assert trial.log.commanded == commanded
    said = [str(note) for note in trial.log.notes if note.code == "speed-drops-out"]
    assert len(said) == 1
    assert f"drops out {drop_outs} times" in said[0]
    # Shown where they were recorded, and not compared.
    shown = np.isfinite(trial.target.measured[:, 1]) & ~trial.target.valid[:, 1]
    assert shown.sum() >= drop_outs
    # The walk has some twenty throttles.
    assert 17 <= len(bench.curves.loaded["forward"]) <= 22


def test_a_hobby_controller_is_no_line(benches) -> None:
    # A level of the speed is no command.
    assert [bool(benches[log][1].laws) for log, *_ in LOGS] == [True, False, False]
    curves = benches["Log_2019-11-09_181347"][1].curves
    assert curves.maps == ("forward",)
    levels = curves.ties["forward"].levels
    # It does not start below 1150 µs.
    assert levels[0].tolist() == pytest.approx([0.1, 0.0, 0.0])
    assert levels[1, 0] == pytest.approx(0.15)
    assert np.all(np.diff(levels, axis=0) >= 0)


@pytest.mark.parametrize(("log", "kv", "commanded", "drop_outs"), LOGS)
def test_a_log_gives_time_constants_and_power(benches, log, kv, commanded, drop_outs) -> None:
    shown = shown_by_stand(*benches[log])
    # A 7-inch propeller on 22 to 28 mm stators: first-order lags seen by eye in the plots.
    assert 0.025 < shown.times["time_constant_up"].value < 0.05
    assert ("dead_time" in shown.times) == commanded
    assert shown.power is not None
    assert 0.05 < shown.power.resistance < 0.25
    assert "power-of-no-resistance" in {finding.code for finding in shown.findings()}
    # One resistance: the fit takes what the lost power shows, for no step of such a log does.
    bench = benches[log][1]
    assert bench.values["winding_resistance"] == shown.power.resistance
    assert "lost power" in bench.measured["winding_resistance"]


@pytest.mark.slow
def test_fit_of_the_commanded_log(tmp_path: Path) -> None:
    log, kv, _, _ = LOGS[0]
    options = FitOptions(out=tmp_path / "fit", seed=1, quiet=True, trust=False, runs=1)
    result, _ = fit_motor(_campaign(tmp_path, log, kv), options)
    (trial,) = result.trials
    # Required: 4.5 %, what a first-order lag towards a free speed per command reaches.
    assert trial.nrmse[0, result.channels.index("speed")] < 0.045
    assert "record torque and speed at 1 kHz" in result.provenance["adequacy"]["sentence"]
    assert result.settings["supply_law"]["forward"]["law"] == "map"
    # What counts comes first, and full command is under the supply that sagged (1885 rad/s at most).
    assert verdict_on(result).startswith("use torque 0.13 N·m (")
    rows = numbers_for(result.parameter_sets(), "gazebo").to_frame()
    assert 1800 < rows.value["maxRotVelocity"] < 1885
