"""The way of a simulated motor trial to its NRMSE: filter of fast logs, sensors of slow ones, failures."""

from types import SimpleNamespace

import numpy as np
import pytest

from fakes.nrmse import nrmse
from sysid.campaign.motor import ChebyshevFilter
from sysid.errors import FitError
from sysid.filters import ChebyshevLowpass
from sysid.fit.nrmse import FAILED_NRMSE
from sysid.motor.cost import BenchCost, MotorTarget
from sysid.motor.targets import filter_taps

RNG = np.random.default_rng(8)


TIME = np.linspace(0.01, 1.9, 50)


def _slow(measured: np.ndarray, time: np.ndarray = TIME, valid: np.ndarray | None = None) -> MotorTarget:
    mask = np.isfinite(measured) if valid is None else valid
    return MotorTarget("slow", time, measured, mask, 0.0, 0.002, 1001, np.zeros(0))


def _compared(cost: BenchCost, samples: np.ndarray, sensors: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the signals (P, n, 2) as compared; a population that fails nowhere scores the same with them."""
    reached = np.ones((len(samples), 1))
    by_channel, failed, signals = cost.compared(samples, reached, sensors)
    plain, lost = cost(samples, reached, sensors)
    np.testing.assert_array_equal(by_channel, plain)
    np.testing.assert_array_equal(failed, lost)
    return signals


def _zeros_score(measured: np.ndarray, weights: tuple[float, float]):
    """Return NRMSE (2,), its mean and failure of a simulation of zeros against 50 measured samples."""
    cost = BenchCost((_slow(measured),), weights, "std")
    by_channel, failed = cost(np.zeros((1, 1001, 2)), np.ones((1, 1)), np.zeros((1, 3)))
    return by_channel[0, 0], cost.mean(by_channel)[0], failed[0, 0]


def test_sensor_delay_and_lag_of_a_ramp() -> None:
    grid = 0.002 * np.arange(1001)
    time = np.sort(RNG.uniform(0.5, 1.9, 80))
    cost = BenchCost((_slow(np.column_stack([time, time]), time),), (1.0, 1.0), "std")
    ramp = np.column_stack([grid, grid])[None]
    (plain,) = _compared(cost, ramp, np.zeros((1, 3)))
    np.testing.assert_allclose(plain[0], np.column_stack([time, time]), atol=1e-12)
    (late,) = _compared(cost, ramp, np.array([[0.03, 0.0, 0.0]]))
    np.testing.assert_allclose(late[0], np.column_stack([time - 0.03, time]), atol=1e-12)
    (lagging,) = _compared(cost, ramp, np.array([[0.0, 0.02, 0.01]]))
    # A lag trails a ramp by its time constant; the hold over each grid step of 2 ms takes half of one off.
    np.testing.assert_allclose(lagging[0], np.column_stack([time - 0.02, time - 0.01]), atol=0.0011)


def test_slow_score_is_the_plain_nrmse_over_valid_samples() -> None:
    time = np.linspace(0.01, 1.9, 150)
    measured = RNG.normal(size=(150, 2))
    valid = RNG.uniform(size=(150, 2)) < 0.6
    cost = BenchCost((_slow(measured, time, valid),), (1.0, 3.0), "std")
    samples = RNG.normal(size=(2, 1001, 2))
    by_channel, failed = cost(samples, np.ones((2, 1)), np.zeros((2, 3)))
    (simulated,) = _compared(cost, samples, np.zeros((2, 3)))
    for p, c in np.ndindex(2, 2):
        expected = nrmse(simulated[p, :, c], measured[:, c], valid[:, c])
        assert by_channel[p, 0, c] == pytest.approx(expected, rel=1e-12)  # order of the sum
    assert not failed.any()
    np.testing.assert_allclose(cost.mean(by_channel), by_channel[:, 0] @ [0.25, 0.75])


def test_fast_score_filters_as_the_taps_say() -> None:
    half = np.array([0.4, 0.2, 0.1])
    full = np.concatenate([half[:0:-1], half])
    step, stride, grid = 1e-3, 4, 203
    rows = np.arange(5, 195, stride)
    time = 2.0 + step * rows
    target = MotorTarget(
        "fast", time, RNG.normal(size=(rows.size, 2)), np.ones((rows.size, 2), bool), 2.0, step, grid, half
    )
    cost = BenchCost((target,), (1.0, 1.0), "std")
    samples = RNG.normal(size=(1, grid, 2))
    (found,) = _compared(cost, samples, np.zeros((1, 3)))
    for c in range(2):
        slow_twin = np.convolve(samples[0, :, c], full, mode="same")[rows]
        np.testing.assert_allclose(found[0, :, c], slow_twin, atol=1e-12)  # order of the sum


def test_taps_of_a_fast_log_are_the_filter() -> None:
    campaign = SimpleNamespace(filter=ChebyshevFilter())
    taps = filter_taps(campaign, SimpleNamespace(interval=1e-4))
    lowpass = ChebyshevLowpass(10_000.0)
    lags = 1e-3 * np.arange(1, taps.size)
    for frequency in (0.0, 5.0, 20.0, 50.0, 60.0, 90.0):
        gain = taps[0] + 2.0 * np.sum(taps[1:] * np.cos(2 * np.pi * frequency * lags))
        # Taps below 1e-4 of the centre are cut: at most their sum is missing.
        assert gain == pytest.approx(float(lowpass.gain(np.array([frequency]))[0]), abs=2e-3)


def test_failed_simulation_scores_its_graded_penalty() -> None:
    cost = BenchCost((_slow(RNG.normal(size=(50, 2))),), (1.0, 1.0), "std")
    samples = np.zeros((3, 1001, 2))
    samples[1, 400:] = np.nan
    by_channel, failed = cost(samples, np.array([[1.0], [1.0], [0.25]]), np.zeros((3, 3)))
    np.testing.assert_array_equal(failed[:, 0], [False, True, True])
    np.testing.assert_allclose(by_channel[1], FAILED_NRMSE)
    np.testing.assert_allclose(by_channel[2], FAILED_NRMSE * 1.75)
    assert np.all(np.isfinite(cost.mean(by_channel)))


def test_channel_without_samples_is_refused_unless_it_has_no_weight() -> None:
    measured = np.column_stack([np.full(50, np.nan), RNG.normal(size=50)])
    with pytest.raises(FitError, match="slow, stator_torque: no valid sample"):
        BenchCost((_slow(measured),), (1.0, 1.0), "std")
    by_channel, mean, failed = _zeros_score(measured, (0.0, 1.0))
    # No number where nothing was recorded, instead of a perfect one.
    assert np.isnan(by_channel[0])
    assert np.isfinite(mean)
    assert not failed
    with pytest.raises(FitError, match="speed: constant"):
        BenchCost((_slow(np.ones((50, 2))),), (0.0, 1.0), "range")


def test_a_channel_without_weight_has_its_nrmse_and_no_say() -> None:
    # Torque of 10 mN·m: its rms error in N·m would be a hundredth of its NRMSE.
    measured = RNG.normal(size=(50, 2)) * (0.01, 1.0)
    by_channel, mean, _ = _zeros_score(measured, (0.0, 1.0))
    for c in range(2):
        assert by_channel[c] == pytest.approx(nrmse(np.zeros(50), measured[:, c]), rel=1e-12)
    assert mean == by_channel[1]
    # A constant one has none.
    by_channel, _, failed = _zeros_score(np.column_stack([np.full(50, 0.01), measured[:, 1]]), (0.0, 1.0))
    assert np.isnan(by_channel[0])
    assert not failed
