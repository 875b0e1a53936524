"""Attenuation and phase against the design, derivative, impulse, edges, gaps."""

import numpy as np
import pytest

from sysid.errors import CampaignError, LogError
from sysid.filters import ChebyshevLowpass, KaiserLowpass, bridge_gaps, differentiate


@pytest.mark.parametrize(
    ("low", "frequencies", "n", "edge", "limits"),
    [
        # What is left of the edges' transients half a second inside.
        (ChebyshevLowpass(rate=10_000.0), (5.0, 20.0, 45.0, 60.0, 80.0), 20_000, 5_000, (1e-4, 1e-3)),
        (KaiserLowpass(rate=200.0), (3.0, 30.0, 58.0, 66.0), 1_000, 37, (1e-9, 1e-9)),
    ],
)
def test_sines_pass_with_designed_gain_and_no_phase(low, frequencies, n, edge, limits):
    time = np.arange(n) / low.rate
    for frequency in frequencies:
        sine, cosine = np.sin(2 * np.pi * frequency * time), np.cos(2 * np.pi * frequency * time)
        basis = np.column_stack([sine, cosine])[edge:-edge]
        (a, b), *_ = np.linalg.lstsq(basis, low.apply(sine)[edge:-edge], rcond=None)
        gain = np.hypot(a, b)
        assert gain == pytest.approx(abs(low.gain(np.array([frequency]))[0]), abs=limits[0])
        assert gain < 0.01 or abs(np.arctan2(b, a)) < limits[1]


def test_chebyshev_corner_is_the_stop_band_edge():
    low = ChebyshevLowpass(rate=10_000.0)
    stop = low.gain(np.array([100.0, 150.0, 400.0, 3_000.0]))
    # Forward-backward: twice the 40 dB of one pass, everywhere beyond the edge.
    assert np.all(20 * np.log10(stop) <= -80 + 0.01)
    assert 20 * np.log10(low.gain(np.array([low.cutoff_3db])))[0] == pytest.approx(-3.0, abs=0.02)
    # Analogue type II magnitude, |H|² = 1/(1 + 1/(ε² T_10²(edge/f))), loses 1.5 dB a pass at:
    chebyshev = np.sqrt((10**4 - 1) / (10**0.15 - 1))
    assert low.cutoff_3db == pytest.approx(100.0 / np.cosh(np.arccosh(chebyshev) / 10), rel=1e-3)


def test_kaiser_default_is_75_taps_and_meets_its_design():
    low = KaiserLowpass(rate=200.0)
    assert len(low.taps) == 75
    assert low.edge_samples == 37
    passband = low.gain(np.linspace(0, 60, 200))
    stopband = low.gain(np.linspace(70, 100, 200))
    ripple = 10 ** (-60 / 20)
    # kaiserord's estimate of the length is good to about 10 % of the ripple.
    assert np.max(np.abs(passband - 1)) < 1.15 * ripple
    assert np.max(np.abs(stopband)) < 1.15 * ripple
    assert low.gain(np.array([65.0]))[0] == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize(
    ("low", "n"), [(KaiserLowpass(rate=200.0), 301), (ChebyshevLowpass(rate=10_000.0), 20_001)]
)
def test_impulse_response_is_symmetric_and_keeps_the_mean(low, n):
    impulse = np.zeros(n)
    impulse[n // 2] = 1.0
    response = np.nan_to_num(low.apply(impulse))
    # A forward-backward recursion is symmetric up to the truncation at the ends.
    assert np.allclose(response, response[::-1], atol=1e-6)
    assert response.sum() == pytest.approx(1.0, abs=2e-3)


def test_kaiser_edges_are_masked_not_invented():
    low = KaiserLowpass(rate=200.0)
    out = low.apply(np.ones(100))
    assert np.isnan(out[:37]).all()
    assert np.isnan(out[-37:]).all()
    assert np.allclose(out[37:-37], 1.0, atol=2e-3)


def test_gap_stays_masked_and_neighbours_survive():
    low = KaiserLowpass(rate=200.0)
    time = np.arange(400) / 200.0
    values = np.sin(2 * np.pi * 2.0 * time)
    gap = slice(180, 186)
    values[gap] = np.nan
    out = low.apply(values)
    assert np.isnan(out[gap]).all()
    beside = np.r_[150:180, 186:220]
    # A straight line across 35 ms of a 2 Hz sine is off by its sagitta, (ω T)²/8 = 0.024 of the amplitude.
    assert np.max(np.abs(out[beside] - np.sin(2 * np.pi * 2.0 * time[beside]))) < 0.024


def test_bridge_is_linear_in_the_valid_samples():
    rng = np.random.default_rng(1)
    valid = rng.random(50) > 0.3
    a, b = rng.normal(size=(2, 50, 3))
    together = bridge_gaps(2 * a - 3 * b, valid)
    assert np.allclose(together, 2 * bridge_gaps(a, valid) - 3 * bridge_gaps(b, valid), atol=1e-12)


def test_derivative_of_a_parabola_is_exact_inside_and_masked_at_the_ends():
    time = np.arange(50) / 200.0
    rate = differentiate(3.0 + 2.0 * time - 4.905 * time**2, 200.0)
    assert np.allclose(rate[1:-1], 2.0 - 9.81 * time[1:-1], atol=1e-12)
    assert np.isnan(rate[[0, -1]]).all()


def test_derivative_error_has_second_order():
    errors = []
    for rate in (100.0, 200.0):
        time = np.arange(int(rate)) / rate
        error = differentiate(np.sin(10 * time), rate) - 10 * np.cos(10 * time)
        errors.append(np.nanmax(np.abs(error)))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)


def test_refusals():
    with pytest.raises(LogError, match="20 samples are fewer than the 75"):
        KaiserLowpass(rate=200.0).apply(np.zeros(20))
    with pytest.raises(LogError, match="Chebyshev filter needs"):
        ChebyshevLowpass(rate=1_000.0).apply(np.zeros(20))
    with pytest.raises(CampaignError, match="half of the sample rate"):
        KaiserLowpass(rate=100.0, cutoff=65.0)
    with pytest.raises(CampaignError, match="half of the sample rate"):
        ChebyshevLowpass(rate=120.0)
    with pytest.raises(LogError, match="every sample is masked"):
        KaiserLowpass(rate=200.0).apply(np.full(100, np.nan))
