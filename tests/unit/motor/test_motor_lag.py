"""The first-order lag: exact between commands, through zero, under a sagging supply."""

import numpy as np
import pytest

from sysid.motor import simpler as lag
from sysid.motor.batch import SimulatedTrial, SimulatedTrials

VALUES = {
    "rise_time_constant": 0.05, "fall_time_constant": 0.12, "command_delay": 0.013,
    "steady_speed_0_forward": 20.0, "steady_speed_1_forward": 900.0, "steady_speed_2_forward": -200.0,
    "steady_speed_1_reverse": 800.0,
    "torque_quadratic_forward": 1.6e-7, "torque_quadratic_reverse": 1.7e-7,
}  # fmt: skip


def _row(**changes):
    values = {**lag.PARAMETERS.nominal, **VALUES, **changes}
    return np.array([[values[name] for name in lag.PARAMETERS]])


def _trial(instants, levels, time, **more):
    return SimulatedTrials([SimulatedTrial(np.array(instants), np.array(levels), time, "steady", **more)])


def test_steps_up_and_down_have_their_own_time_constants():
    time = np.arange(0.0, 2.0, 0.0037)
    out = lag.simulate_lag(_row(), _trial([0.0, 0.5, 1.2], [0.2, 0.8, 0.4], time))[0]
    low, high, middle = (20 + 900 * u - 200 * u * u for u in (0.2, 0.8, 0.4))
    expected = np.full(time.size, low)
    up, down = time - 0.513, time - 1.213
    expected[up > 0] = high + (low - high) * np.exp(-up[up > 0] / 0.05)
    top = high + (low - high) * np.exp(-0.7 / 0.05)
    expected[down > 0] = middle + (top - middle) * np.exp(-down[down > 0] / 0.12)
    # Exact but for rounding: commands fall between samples and must not be smeared.
    np.testing.assert_allclose(out[:, 1], expected, rtol=1e-10)
    np.testing.assert_allclose(out[:, 0], 1.6e-7 * out[:, 1] ** 2, rtol=1e-12)


def test_reversal_falls_to_zero_and_rises_from_there():
    time = np.linspace(0.0, 1.5, 1500)
    out = lag.simulate_lag(_row(command_delay=0.0), _trial([0.0, 0.3], [0.5, -0.5], time))[0]
    start, target = 20 + 450 - 50, -400.0
    zero = 0.3 + 0.12 * np.log((start - target) / -target)
    before, after = (time > 0.3) & (time < zero), time > zero
    np.testing.assert_allclose(
        out[before, 1], target + (start - target) * np.exp(-(time[before] - 0.3) / 0.12), rtol=1e-9
    )
    np.testing.assert_allclose(out[after, 1], target * (1 - np.exp(-(time[after] - zero) / 0.05)), rtol=1e-9)
    assert np.all(out[after, 0] < 0)


def test_supply_scales_the_steady_speed():
    time = np.linspace(0.0, 3.0, 300)
    sag = {"supply": (np.array([0.0, 1.0]), np.array([1.0, 0.9]))}
    out = lag.simulate_lag(_row(), _trial([0.0], [0.5], time, **sag))[0]
    assert out[0, 1] == pytest.approx(420.0)
    assert out[-1, 1] == pytest.approx(378.0, rel=1e-6)


def test_steady_speeds_are_mapped_by_a_parabola_or_a_line():
    u = np.array([-0.2, -0.4, -0.6, -0.8])
    ratio = np.array([1.0, 0.98, 0.97, 0.95])
    speed = -(10.0 + 900.0 * -u - 150.0 * u * u) * ratio
    np.testing.assert_allclose(lag.steady_speed_map(u, speed, ratio), [10.0, 900.0, -150.0], rtol=1e-9)
    few = lag.steady_speed_map(np.array([0.2, 0.5, 0.5]), np.array([200.0, 500.0, 500.0]), np.ones(3))
    np.testing.assert_allclose(few, [0.0, 1000.0, 0.0], atol=1e-9)
