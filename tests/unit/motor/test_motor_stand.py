"""What a stand's steady levels and steps give: map of the supply law, lost power, time constants."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from sysid.motor.batch import SimulatedTrial, SimulatedTrials, simulate_population
from sysid.motor.model import PARAMETERS, pack
from sysid.motor.stand import LostPower, StandValues, StepTime, lost_power, step_times
from sysid.motor.static_curves import NoLoadTie, fit_speed_curve
from sysid.trials.bench_log import CommandSteps
from sysid.trials.steady import SteadyPoints

DRAG = 1.65e-7
# Levels of a controller whose loaded speed is no line of its command; the supply sags with the load.
U = np.array([0.15, 0.3, 0.5, 0.7, 0.9, 0.5])
SPEED = np.array([200.0, 500.0, 700.0, 800.0, 850.0, 700.0])
RATIO = np.array([1.0, 0.99, 0.97, 0.95, 0.92, 0.97])
TIE = NoLoadTie(
    np.column_stack([U, np.ones(6)]) * RATIO[:, None], np.column_stack([SPEED, DRAG * SPEED**2]), standing=0.1
)


def test_map_passes_through_its_levels_and_never_falls() -> None:
    np.testing.assert_allclose(TIE.mapped(U), TIE.points / RATIO[:, None], rtol=1e-9)
    many = TIE.mapped(np.linspace(0.0, 1.0, 500))
    assert np.all(np.diff(many, axis=0) >= 0)
    assert np.all(TIE.mapped(np.array([0.0, 0.05, 0.1])) == 0)
    np.testing.assert_allclose(TIE.mapped(-U), -TIE.mapped(U))
    # What was measured is not scaled to a supply that does not sag.
    measured = TIE.measured[1:]
    np.testing.assert_allclose(measured, np.column_stack([U, SPEED, RATIO])[:5])
    assert TIE.repeats == 0
    # A line misses the levels by some 80 rad/s of 920.
    assert 0.05 < TIE.misfit < 0.15


def test_speeds_under_one_command_say_how_far_they_repeat() -> None:
    speed = np.append(SPEED[:5], 1.02 * SPEED[2])
    tie = NoLoadTie(TIE.columns, np.column_stack([speed, DRAG * speed**2]), standing=0.1)
    # One degree of freedom: 1 % off the mean, twice.
    assert tie.repeats == pytest.approx(np.sqrt(2) * 0.01 / 1.01)


@pytest.mark.parametrize("resistance", [0.1, 0.4])
def test_a_mapped_motor_settles_on_its_levels_whatever_its_resistance(resistance: float) -> None:
    grid = np.arange(0.0, 2.0, 1e-3)
    parameters = {**PARAMETERS.nominal, "winding_resistance": resistance, "torque_quadratic_forward": DRAG}
    parameters |= {"torque_linear_forward": 0.0, "viscous_damping": 0.0}
    for k in range(5):
        supply = np.array([0.0, 2.0]), np.full(2, RATIO[k])
        command = np.array([0.3, U[k]])
        instants = np.array([-1.0, 0.5])
        trial = SimulatedTrial(instants, command, grid, "steady", supply, TIE.mapped(command))
        run = simulate_population(pack(parameters)[None], SimulatedTrials([trial]))
        assert run.outputs[0, -1, 1] == pytest.approx(SPEED[k], rel=1e-4)


def _points(resistance: float, friction: float, constant: float) -> SteadyPoints:
    """Return steady points of a motor of one resistance behind a lossless controller."""
    speed = np.linspace(400.0, 1800.0, 12)
    torque = 5.9e-8 * speed**2
    power = torque * speed + resistance * (torque / constant) ** 2 + friction * speed
    zero = np.zeros(12, dtype=np.int64)
    nothing = np.full(12, np.nan)
    return SteadyPoints(
        speed / 2000, speed, nothing, torque, np.full(12, 16.0), power / 16.0, zero + 100, zero, zero
    )


def test_lost_power_gives_resistance_and_friction() -> None:
    found = lost_power(_points(0.125, 2e-3, 5e-3), 5e-3)
    assert found is not None
    assert found.resistance == pytest.approx(0.125, rel=1e-6)
    assert found.friction_torque == pytest.approx(2e-3, rel=1e-6)
    low, high = found.interval_95
    assert low - 1e-9 <= 0.125 <= high + 1e-9
    # Nothing is known without the supply's current.
    dark = _points(0.125, 2e-3, 5e-3)
    dark.current[:] = np.nan
    assert lost_power(dark, 5e-3) is None


def test_power_that_is_not_of_one_resistance_is_said() -> None:
    def codes(power: LostPower | None) -> set[str]:
        return {finding.code for finding in StandValues((), power, {}).findings()}

    assert codes(lost_power(_points(0.125, 0.0, 5e-3), 5e-3)) == set()
    assert codes(lost_power(_points(0.125, 4e-3, 5e-3), 5e-3)) == {"power-of-no-resistance"}
    # At full duty the supply gives the motor's current, which shows twice the stated Kv.
    full = _points(0.125, 0.0, 2.5e-3)
    full.current[:] = full.torque / 2.5e-3
    full.voltage[:] = 2.5e-3 * full.speed + 0.125 * full.current
    assert codes(lost_power(full, 2.5e-3)) == set()
    assert codes(lost_power(full, 5e-3)) == {"kv-below-current"}


def test_one_dead_time_and_one_resistance_are_stated_and_the_others_explained() -> None:
    def stand(dead_time: float) -> StandValues:
        times = {"dead_time": StepTime(dead_time, (dead_time - 5e-3, dead_time + 5e-3), 18)}
        return StandValues((), lost_power(_points(0.125, 0.0, 5e-3), 5e-3), times)

    assert list(stand(0.03).beside(0.031, None)) == []
    delay, resistance = stand(0.03).beside(0.045, 0.3)
    assert "command delay is 45 ms" in delay
    assert "dead time of 30 ms" in delay
    assert "fit's R is 300 mΩ" in resistance
    assert "lost power's 125 mΩ" in resistance
    # No rotor moves before its command.
    assert [found.code for found in stand(0.03).findings()] == []
    (found,) = stand(-0.012).findings()
    assert found.code == "speed-before-command"
    assert "moves 12 ms before its command (7 to 17): their clocks are offset" in found.sentence
    assert "dead time" not in stand(-0.012).in_short


@pytest.mark.parametrize("commanded", [True, False])
def test_steps_give_time_constants_and_the_dead_time_of_a_command(commanded: bool) -> None:
    time = np.arange(0.0, 22.0, 7e-3)
    instants, levels = (
        np.arange(0.0, 22.0, 2.0),
        np.array([0, 400, 700, 900, 1100, 1300, 1000, 800, 1200, 900, 0.0]),
    )
    speed, now = np.zeros(time.size), 0.0
    for i in range(1, time.size):
        target = levels[max(np.searchsorted(instants + 0.03, time[i]) - 1, 0)]
        constant = 0.035 if target > now else 0.055
        now += (target - now) * (1.0 - np.exp(-7e-3 / constant))
        speed[i] = now
    speed += 3.0 * np.random.default_rng(3).standard_normal(time.size)
    log = SimpleNamespace(
        steps=CommandSteps(instants, levels / 1300.0), channels={"speed": (time, speed)},
        window=(0.0, float(time[-1])), commanded=commanded,
    )  # fmt: skip
    found = step_times([log])  # type: ignore[list-item]
    # Samples of 7 ms, of which the first after a command is half an interval late.
    assert found["time_constant_up"].value == pytest.approx(0.035, abs=2e-3)
    assert found["time_constant_down"].value == pytest.approx(0.055, abs=3e-3)
    assert ("dead_time" in found) == commanded
    if commanded:
        assert found["dead_time"].value == pytest.approx(0.03, abs=5e-3)


def test_an_error_of_the_tare_widens_the_curve() -> None:
    speed = np.linspace(400.0, 1800.0, 20)
    thrust = 4.5e-6 * speed**2 + 0.01 * np.random.default_rng(4).standard_normal(20)
    exact = fit_speed_curve("thrust", "forward", speed, thrust)
    loose = fit_speed_curve("thrust", "forward", speed, thrust, zero_error=0.1)
    assert exact.at(1500.0)[0] == pytest.approx(4.5e-6 * 1500.0**2, rel=3e-3)
    # An offset of 0.1 N of every point is at most about that much anywhere between them.
    assert 0.05 < loose.at(1500.0)[1] < 0.2
    assert exact.at(1500.0)[1] < 0.01


def test_a_stand_of_100_hz_frees_no_inductance(write, run) -> None:
    time, k, resistance = np.arange(0.0, 24.0, 0.01), 30.0 / (np.pi * 1900.0), 0.125
    command = np.array([0, 400, 700, 900, 1100, 1300, 1000, 800, 1200, 900, 600, 0.0])[
        (time // 2).astype(int)
    ]
    speed = np.zeros(time.size)
    for i in range(1, time.size):
        speed[i] = speed[i - 1] + 0.25 * (command[i - 1] - speed[i - 1])
    torque = 5.9e-8 * speed**2
    watts = torque * speed + resistance * (torque / k) ** 2
    columns = [time, command / 1500.0, torque, 78.0 * torque, np.full(time.size, 16.0), watts / 16.0, speed]
    noisy = np.column_stack(columns)
    noisy[:, 2:] += np.random.default_rng(1).normal(0.0, 1e-3, (time.size, 5)) * np.ptp(noisy[:, 2:], axis=0)
    header = "time [s],command [1],torque [N·m],thrust [N],voltage [V],current [A],speed [rad/s]\n"
    rows = "\n".join(",".join(f"{value:.7g}" for value in row) for row in noisy)
    log = write(header + rows + "\n", "log.csv")
    text = f"""
kind = "motor"
name = "stand"
trials = [{{ name = "steps", log = '{log}', direction = "forward" }}]
[motor]
kv = "1900 rpm/V"
rotor_inertia = "1.2e-5 kg·m²"
[log]
current = "supply"
[command]
unit = "1"
minimum = 0
maximum = 1
"""
    code, out, err = run("check", write(text, "stand.toml"), "--json")
    assert code == 0, err
    document = json.loads(out)
    # A winding of 10 to 100 µH settles within 1 ms.
    assert [row["name"] for row in document["parameters"]] == [
        "command_delay", "torque_sensor_delay", "torque_sensor_lag",
    ]  # fmt: skip
    assert any(said.startswith("L is not fitted: the winding settles") for said in document["sentences"])
    # A campaign may free L all the same.
    text += '[parameters]\nfree = ["winding_inductance"]\n'
    _, out, _ = run("check", write(text, "stand.toml"), "--json")
    assert json.loads(out)["parameters"][0]["name"] == "winding_inductance"
