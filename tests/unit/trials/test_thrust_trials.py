"""Bench logs without a model: command ranges, stalls, repeated samples, tare, steady points, signs."""

import re

import numpy as np
import pytest

from fakes import places
from sysid.errors import LogError
from sysid.loaders import load
from sysid.loaders.readers.rcbenchmark_csv import wrong_poles
from sysid.trials.bench_log import (
    CommandRange,
    check_command_direction,
    command_steps,
    find_stalls,
    outside,
    real_samples,
    rows_at_rest,
    signed_speed,
    tare,
)
from sysid.trials.steady import sign_against_speed, sign_of_log, steady_points, zero_of_steady

DATA = places.DATA / "rcbenchmark"
PULSES = CommandRange("us", 1000.0, 1500.0, 2000.0)
DSHOT = CommandRange("dshot", 0.0, 0.0, 2047.0, "low")


def test_command_range_in_both_directions_and_in_one() -> None:
    u = PULSES.to_u(np.array([1000.0, 1250.0, 1500.0, 1810.0, 2000.0]), "us", "log")
    np.testing.assert_allclose(u, [-1.0, -0.5, 0.0, 0.62, 1.0], atol=1e-15)
    throttle = CommandRange("us", 1000.0, 1000.0, 2000.0)
    np.testing.assert_allclose(throttle.to_u(np.array([950.0, 1000.0, 1500.0]), "us", "log"), [0, 0, 0.5])


@pytest.mark.parametrize(
    ("protocol", "commands", "unit", "words"),
    [
        (PULSES, [1500, 2047], "us", r"a\.csv: 1 commands lie outside 1000 to 2000 us, for example 2047"),
        (PULSES, [1000, np.nan, 2000], "dshot", "run from 1000 to 2000 and are read as dshot, .* says us"),
        (
            DSHOT,
            [48, 2048],
            "dshot",
            r"a\.csv: 1 commands are no DShot number of 0 to 2047, for example 2048",
        ),
        (DSHOT, [1500], "us", "are read as us, the campaign says dshot"),
    ],
)
def test_command_refusals(protocol, commands: list[float], unit: str, words: str) -> None:
    with pytest.raises(LogError, match=words):
        protocol.to_u(np.array(commands), unit, "a.csv")


@pytest.mark.parametrize(("half", "sign"), [("low", 1.0), ("high", -1.0)])
def test_command_range_of_bidirectional_dshot(half, sign: float) -> None:
    protocol = CommandRange("dshot", 0.0, 0.0, 2047.0, half)
    # 0 stops, 1 to 47 are no throttle; each half runs from the slowest step of 1000 to the fastest.
    logged = np.array([0.0, 47.0, 48.0, 547.0, 1047.0, 1048.0, 1547.0, 2047.0, np.nan])
    u = sign * np.array([0.0, 0.0, 0.001, 0.5, 1.0, -0.001, -0.5, -1.0, np.nan])
    np.testing.assert_allclose(protocol.to_u(logged, "dshot", "log"), u, atol=1e-15)


def test_sign_and_zero_from_the_log_itself() -> None:
    time = np.linspace(0.0, 10.0, 2000)
    speed = 400.0 + 200.0 * np.sin(time)
    # Never steady: drag and the rotor's own acceleration, I^r dΩ/dt.
    torque = 1.6e-7 * speed**2 + 2.7e-5 * 200.0 * np.cos(time)
    assert sign_of_log((time, -torque), (time, speed)) == -1
    assert sign_of_log((time, torque), (time, -speed)) == -1
    assert sign_of_log((np.zeros(0), np.zeros(0)), (time, speed)) == 0
    assert sign_against_speed(np.array([np.nan]), np.array([100.0])) == 0
    steady = np.array([300.0, 450.0, 600.0])
    # Both directions, of which one thrusts half as hard: the difference is no zero.
    turned = np.array([300.0, 600.0, 900.0, -400.0, -700.0])
    for omega, curve in ((steady, -1.6e-7), (turned, np.where(turned > 0, 1.2e-5, -0.6e-5))):
        zero = zero_of_steady(curve * omega**2 + 0.02, omega)
        assert zero is not None
        assert (zero.value, zero.rows) == (pytest.approx(0.02, abs=1e-12), 0)
    assert zero_of_steady(np.array([5.0, 3.0, -1.0]), turned[[0, 1, 3]]) is None
    # Two speeds, or speeds within 30 % of each other, say nothing about standstill.
    assert zero_of_steady(np.array([1.0, 2.0]), np.array([300.0, 600.0])) is None
    assert zero_of_steady(np.array([1.0, 1.1, 1.2]), np.array([500.0, 550.0, 600.0])) is None


def test_steps_of_a_log_with_blank_commands() -> None:
    steps = command_steps(np.arange(6.0), np.array([0.1, np.nan, 0.1, 0.5, np.nan, 0.5]))
    np.testing.assert_array_equal(steps.time, [0.0, 3.0])
    np.testing.assert_array_equal(steps.level, [0.1, 0.5])


def test_stalls_are_found_and_only_those_near_a_command_are_doubtful() -> None:
    time = np.arange(0.0, 4.0, 0.01)
    u = np.where(time < 1.0, 0.2, np.where(time < 3.0, 0.6, 0.3))
    # One pause 20 ms after the first command, one while nothing happens, none at the second command.
    keep = outside(time, [(1.025, 1.105), (2.005, 2.095)])
    steps = command_steps(time[keep], u[keep])
    near, idle = find_stalls(time[keep], steps)
    assert (near.start, near.end) == pytest.approx((1.02, 1.11))  # rows of the grid
    assert near.doubtful == pytest.approx((1.0, 1.26))
    assert idle.doubtful is None


def test_command_in_the_first_row_after_a_pause_is_doubtful() -> None:
    time = np.concatenate([np.arange(0.0, 1.0, 0.01), np.arange(1.09, 2.0, 0.01)])
    steps = command_steps(time, np.where(time < 1.05, 0.2, 0.6))
    (stall,) = find_stalls(time, steps)
    assert stall.doubtful == pytest.approx((0.99, 1.24))


def test_jitter_and_fast_logs_are_no_stalls() -> None:
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.007, 0.02, 500))
    steps = command_steps(time, np.where(time < 3.0, 0.2, 0.6))
    assert find_stalls(time, steps) == ()
    fast = np.arange(0.0, 1.0, 1e-4)
    assert find_stalls(fast, command_steps(fast, np.zeros(fast.size))) == ()


def test_repeated_and_blank_samples_are_not_real() -> None:
    values = np.array([1.0, 1.0, np.nan, 1.0, 2.0, np.nan, 3.0, 3.0])
    np.testing.assert_array_equal(real_samples(values), [True, *[False] * 3, True, False, True, False])


def test_tare_from_rows_before_the_spin() -> None:
    time = np.arange(0.0, 3.0, 0.01)
    u = np.where((time > 1.0) & (time < 2.0), 0.4, 0.0)
    speed = np.where((time > 1.05) & (time < 2.2), 300.0, 0.0)
    rest = rows_at_rest(time, u, speed)
    assert rest[:100].all()
    # After the stop at 2.2 s the sensor rings for 0.5 s.
    assert not rest[101:270].any()  # the command of 1.01 s is the first
    assert rest[275:].all()
    zero = tare(np.where(speed > 0, 5.0, 0.3), rest)
    assert zero.value == pytest.approx(0.3)
    assert zero.error == pytest.approx(0.0, abs=1e-12)
    assert tare(np.ones(3), np.zeros(3, dtype=bool)).rows == 0


def test_steady_points_of_a_step_log() -> None:
    time = np.arange(0.0, 6.0, 0.01)
    u = np.where(time < 2.0, 0.3, np.where(time < 4.0, 0.6, 0.4))
    speed = 1000.0 * u
    speed[time >= 4.0] *= np.linspace(1.0, 1.5, np.sum(time >= 4.0))  # never settles
    torque = 1e-7 * speed**2
    channels = {"speed": (time, speed), "torque": (time[::3], torque[::3])}
    points = steady_points(time, command_steps(time, u), channels)
    np.testing.assert_allclose(points.u, [0.3, 0.6])
    np.testing.assert_allclose(points.speed, [300.0, 600.0])
    np.testing.assert_allclose(points.torque, [0.009, 0.036])
    assert np.isnan(points.thrust).all()
    assert len(points) == 2


def test_ramp_points_of_a_creeping_command() -> None:
    # 1 to 2 ms in steps of 0.5 µs over 47 s, as a thrust stand's ramp script walks; a rotor of 0.1 s.
    time = np.arange(0.0, 47.0, 0.023)
    u = np.clip(np.round((time - 1.0) / 46.0 * 2000.0) / 2000.0, 0.0, 1.0)
    speed = 1000.0 * np.maximum(0.0, (time - 1.1) / 46.0)
    channels = {"speed": (time, speed), "torque": (time, 1e-7 * speed**2)}
    assert len(steady_points(time, command_steps(time, u), channels)) == 0
    points = steady_points(time, command_steps(time, u), channels, (), {"torque": 7}, ramp=True)
    assert len(points) > 40
    # Slower than 1 % per 0.2 s: a ramp of 1000 rad/s in 46 s is that above 0.2 · 1000/46/0.01 = 435 rad/s.
    assert points.speed.min() > 400.0
    # The rotor trails by 0.1 s of 2 %/s of full: 2.2 rad/s, half a percent.
    np.testing.assert_allclose(points.speed, 1000.0 * points.u, rtol=0.006)
    np.testing.assert_allclose(points.torque, 1e-7 * points.speed**2, rtol=1e-3)  # curvature over 0.4 s
    assert set(points.torque_zero) == {7}
    # Nor is a staircase whose rotor has not answered yet: a steady speed, but whose?
    stairs = np.floor(time / 0.7) / 70.0
    late = {"speed": (time, np.full(time.size, 300.0))}
    assert len(steady_points(time, command_steps(time, 5.0 * stairs % 1.0), late, ramp=True)) == 0
    # A ramp of 5 s is no steady log: the rotor would trail by a tenth of it.
    quick = np.arange(0.0, 5.0, 0.01)
    fast = {"speed": (quick, 200.0 * quick)}
    assert len(steady_points(quick, command_steps(quick, 0.2 * quick), fast, ramp=True)) == 0


@pytest.mark.parametrize(
    ("u", "direction", "words"),
    [
        ([0.0, 0.5, -1.0], "forward", 'commands run from u = -1 to 0.5; set direction = "reversal"'),
        ([-0.3, -0.9, -0.4], "forward", 'commands run from u = -0.9 to -0.3; set direction = "reverse"'),
        ([0.0, -0.5, 0.4], "reverse", 'commands run from u = -0.5 to 0.4; set direction = "reversal"'),
        ([0.0, 0.5, 0.9], "reversal", "commands only run from u = 0 to 0.9"),
    ],
)
def test_commands_against_the_direction_are_refused(u: list[float], direction: str, words: str) -> None:
    with pytest.raises(LogError) as refusal:
        check_command_direction(np.array(u), direction, "a.csv")
    assert words in str(refusal.value)
    check_command_direction(np.array([0.0, 0.5, np.nan]), "forward", "a.csv")
    check_command_direction(np.array([0.0, 0.5, -0.5]), "reversal", "a.csv")


@pytest.mark.parametrize(
    ("ratio", "words"),
    [
        (12 / 14, "0.8571 times .* likely 14 entered for a motor of 12"),
        (7.0, "likely 2 entered for a motor of 14;"),
        (2.0, "likely 6 entered for a motor of 12, or the optical probe counts the wrong number of marks"),
        (0.5, "for a motor of 12, or the optical probe"),
    ],
)
def test_wrong_pole_count_names_the_poles(ratio: float, words: str) -> None:
    assert re.search(words, wrong_poles(ratio))


def test_a_speed_takes_the_sign_of_its_direction() -> None:
    unsigned = np.array([0.0, 100.0, 200.0])
    np.testing.assert_array_equal(signed_speed(unsigned, "reverse", "log"), -unsigned)
    np.testing.assert_array_equal(signed_speed(-unsigned, "forward", "log"), unsigned)


@pytest.mark.parametrize(
    ("speed", "direction", "message"),
    [
        (np.zeros(4), "forward", "zero in all of its 4 samples"),
        (np.array([300.0, -300.0]), "forward", 'direction = "reversal"'),
        (np.array([300.0, 200.0]), "reversal", "never changes its sign"),
    ],
)
def test_speed_refusals(speed: np.ndarray, direction: str, message: str) -> None:
    with pytest.raises(LogError, match=message):
        signed_speed(speed, direction, "a.csv")


def test_known_stall_of_a_real_log() -> None:
    path = DATA / "sar_SOV5_TimeConstant_Test_2023-12-16_130840.csv"
    if not path.exists():
        pytest.skip("the real log is not beside the project (shared/data/rcbenchmark)")
    recording = load(path)
    command = recording["command"]
    u = CommandRange("dshot", 0.0, 0.0, 2047.0).to_u(command.values, command.unit, path.name)
    stalls = find_stalls(command.time, command_steps(command.time, u))
    (known,) = [s for s in stalls if abs(s.start - 12.2953) < 1e-3 and abs(s.end - 12.3828) < 1e-3]
    # Command 702 is in the row at 12.2874 s.
    assert known.doubtful is not None
    assert known.doubtful[0] == pytest.approx(12.2874, abs=1e-4)
    # 15 of its 27 commands (all up-steps) have a pause of 84 to 97 ms within 150 ms, one of them two.
    assert sum(s.doubtful is not None for s in stalls) == 16
