"""Drop-outs of a speed, steps of a log without a command, and tares of a stand that drifts or is touched."""

import numpy as np
import pytest

from sysid.errors import LogError
from sysid.trials.bench_log import command_steps, drop_outs, tare
from sysid.trials.steady import speed_steps, turning_steps

RATE, LAG = 140.0, 0.035
TIME = np.arange(0.0, 24.0, 1.0 / RATE)
# Instants [s] and free speeds [rad/s] of a stand's walk through its throttles.
INSTANTS = np.array([0.0, 2.0, 5.0, 8.0, 11.0, 14.0, 18.0, 21.0])
LEVELS = np.array([0.0, 410.0, 840.0, 1180.0, 1480.0, 1240.0, 800.0, 0.0])


def rotor() -> np.ndarray:
    """Return a first-order rotor with the noise of a stand [rad/s]."""
    speed, out = 0.0, []
    for t in TIME:
        target = LEVELS[np.searchsorted(INSTANTS, t, side="right") - 1]
        speed += (target - speed) * (1.0 - np.exp(-1.0 / RATE / LAG))
        out.append(speed)
    noise = 3.0 * np.random.default_rng(1).standard_normal(TIME.size)
    return np.maximum(np.array(out) + noise * (np.array(out) > 1.0), 0.0)


def test_missed_pulses_are_found_with_the_tail_that_averaging_leaves() -> None:
    speed = rotor()
    clean = speed.copy()
    places = [500, 1000, 1800, 2300]
    for place, depth in zip(places, (0.3, 0.5, 1.0, 0.2), strict=True):
        tail = np.exp(-np.arange(12) / 2.0)
        speed[place : place + 12] -= depth * speed[place] * tail
    lost = drop_outs(TIME, speed)
    starts = np.flatnonzero(np.diff(lost.astype(int)) == 1) + 1
    assert starts.tolist() == places
    # What is left of each fall is below 2 % of the top speed.
    assert np.max(np.abs(speed - clean)[~lost]) < 0.02 * 1480.0
    assert lost.sum() < 4 * 14


def test_nothing_that_a_rotor_does_drops_out() -> None:
    assert not drop_outs(TIME, rotor()).any()
    # A command that falls for 60 ms and comes back: the rotor's lag of 35 ms makes a dip that is no step.
    speed, out = 1000.0, []
    for t in TIME:
        speed += ((500.0 if 5.0 < t < 5.06 else 1000.0) - speed) * (1.0 - np.exp(-1.0 / RATE / LAG))
        out.append(speed)
    assert min(out) < 700.0
    assert not drop_outs(TIME, np.array(out)).any()


def test_steps_of_the_speed_are_those_of_its_commands() -> None:
    steps = speed_steps(TIME, rotor())
    np.testing.assert_allclose(steps.level * 1480.0, LEVELS, atol=15.0)
    # The instant before the first sample that has left its level, by a tenth of the step.
    np.testing.assert_allclose(steps.time, INSTANTS, atol=2.0 / RATE)


def test_a_speed_without_levels_has_no_steps() -> None:
    with pytest.raises(LogError, match="no steady levels"):
        speed_steps(TIME, np.full(TIME.size, 800.0))


def test_a_controller_that_stutters_does_not_turn() -> None:
    u = np.array([0.0, 0.1, 0.3, 0.6, 0.8, 0.7, 0.4, 0.1])[np.searchsorted(INSTANTS, TIME, side="right") - 1]
    speed = rotor()
    speed[u == 0.1] = 0.0
    speed[(u == 0.1) & (np.arange(TIME.size) % 20 == 0)] = 250.0
    turning = turning_steps(command_steps(TIME, u), TIME, speed)
    assert turning.tolist() == [False, False, True, True, True, True, True, False]


def test_a_touched_stand_keeps_its_tare_and_a_drift_is_its_error() -> None:
    source = np.random.default_rng(2)
    values = 0.1 + 0.01 * source.standard_normal(400)
    rest = np.zeros(400, dtype=bool)
    rest[:100] = rest[300:] = True
    exact = tare(values, rest)
    assert exact.error == pytest.approx(0.01 / np.sqrt(200), rel=0.6)
    touched = values.copy()
    touched[380:] = 0.6
    assert tare(touched, rest).value == pytest.approx(exact.value, abs=2e-3)
    drifted = values + np.where(np.arange(400) > 200, 0.02, 0.0)
    assert tare(drifted, rest).error == pytest.approx(0.01, rel=0.2)
