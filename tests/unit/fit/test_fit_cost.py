"""The NRMSE: hand numbers, MATLAB's definition, and the compiled population cost against its slow twin."""

import threading
import time
from itertools import chain

import numpy as np
import pytest

from fakes.nrmse import nrmse
from sysid.errors import FitError
from sysid.filters import KaiserLowpass, bridge_gaps, differentiate
from sysid.fit import nrmse as module
from sysid.fit.nrmse import FAILED_NRMSE, CostChannel, FilteredNrmse, TrialTarget, spread

RATE = 200.0
GEAR = (
    CostChannel("x", "m", 0),
    CostChannel("z", "m", 1),
    CostChannel("vx", "m/s", 0, rate=True),
    CostChannel("vz", "m/s", 1, rate=True),
    CostChannel("q", "rad", 2),
)


def smooth(rng, n, columns):
    """Random walks: as wide-band as an impact, and of the size of a coordinate."""
    return np.cumsum(rng.normal(size=(n, columns)), axis=0) * 0.01


def twin_signals(samples, delivered, taps, rate, margin):
    """Bridge, filter and differentiate one trial with the functions of the measured side."""
    lowpass = KaiserLowpass(RATE)
    assert len(lowpass.taps) == len(taps)
    bridged = bridge_gaps(samples, delivered)
    filtered = lowpass.apply(bridged)
    rates = differentiate(filtered, rate)
    inside = slice(margin, len(samples) - margin)
    x, z, q = filtered[inside].T
    vx, vz, _ = rates[inside].T
    return np.column_stack([x, z, vx, vz, q])


def gear_cost(rng, gap=True, weights=(1.0, 1.0, 1.0, 1.0, 1.0), denominator="std"):
    taps = KaiserLowpass(RATE).taps
    margin = len(taps) // 2 + 1
    channels = tuple(
        CostChannel(c.name, c.unit, c.column, c.rate, w) for c, w in zip(GEAR, weights, strict=True)
    )
    trials, targets = [], []
    for name, n_window in (("drop-1", 60), ("drop-2", 81)):
        n = n_window + 2 * margin
        delivered = np.ones(n, dtype=bool)
        if gap:
            delivered[margin + 20 : margin + 27] = False
            delivered[:3] = False
            delivered[-2:] = False
        measured = twin_signals(smooth(rng, n, 3), delivered, taps, RATE, margin)
        valid = np.ones((n_window, 5), dtype=bool)
        valid[20:27] = not gap
        valid[5, 3] = False
        targets.append((measured, valid, delivered))
        trials.append(TrialTarget(name, measured, valid, RATE, taps, delivered))
    return FilteredNrmse(trials, channels, denominator), targets, margin


def scored(simulated, measured, valid=None, denominator="std"):
    """The compiled NRMSE of one channel of one trial."""
    cost = FilteredNrmse(
        [TrialTarget("steps", measured[:, None], valid)], [CostChannel("x", "m", 0)], denominator
    )
    return cost(np.asarray(simulated)[None, :, None])[0].item()


def test_nrmse_by_hand():
    # measured 1 2 3 4: std = sqrt(1.25), range = 3; a constant error of 0.5 has rms 0.5.
    measured = np.array([1.0, 2.0, 3.0, 4.0])
    assert scored(measured + 0.5, measured) == pytest.approx(0.5 / np.sqrt(1.25), rel=1e-14)
    assert scored(measured - 0.5, measured, denominator="range") == pytest.approx(0.5 / 3, rel=1e-14)
    assert scored(np.full(4, 2.5), measured) == pytest.approx(1.0, rel=1e-14)
    assert scored(measured, measured) == 0.0
    # Samples that are not valid do not count, whatever they are.
    lost = np.array([1.0, 2.0, np.nan, 3.0, 4.0, 100.0])
    simulated, valid = np.array([1.5, 2.5, 7.0, 3.5, 4.5, 0.0]), np.array([1, 1, 0, 1, 1, 0], dtype=bool)
    assert scored(simulated, lost, valid) == pytest.approx(0.5 / np.sqrt(1.25), rel=1e-14)


def test_nrmse_is_matlabs_goodness_of_fit():
    # goodnessOfFit(x, xref, 'NRMSE') = ||xref - x|| / ||xref - mean(xref)||, without any count of samples.
    rng = np.random.default_rng(1)
    measured, simulated = rng.normal(size=(2, 500))
    expected = np.linalg.norm(measured - simulated) / np.linalg.norm(measured - measured.mean())
    # Same formula, summed differently: a few rounding errors.
    assert scored(simulated, measured) == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize("gap", [False, True])
@pytest.mark.parametrize("denominator", ["std", "range"])
def test_compiled_cost_equals_slow_twin(gap, denominator):
    rng = np.random.default_rng(7)
    weights = (1.0, 2.0, 0.5, 1.0, 0.0)
    cost, targets, margin = gear_cost(rng, gap, weights, denominator)
    samples = np.stack([smooth(rng, cost.n_total, 3) for _ in range(9)])
    by_channel, failed = cost(samples)
    taps = cost.trials[0].taps
    for p, candidate in enumerate(samples):
        by_trial = []
        for t, (measured, valid, delivered) in enumerate(targets):
            rows = candidate[cost.offsets[t] : cost.offsets[t + 1]]
            signals = twin_signals(rows, delivered, taps, RATE, margin)
            scores = [nrmse(signals[:, c], measured[:, c], valid[:, c], denominator) for c in range(5)]
            # Another order of summation over 75 taps and 80 samples: well below 1e-12.
            np.testing.assert_allclose(by_channel[p, t], scores, rtol=1e-12)
            np.testing.assert_allclose(cost.prepared(samples)[t][p], signals, rtol=0, atol=1e-12)
            by_trial.append(np.average(scores, weights=weights))
        assert cost.mean(by_channel)[p] == pytest.approx(np.mean(by_trial), rel=1e-12)
    assert not failed.any()


def test_same_samples_score_zero_through_the_same_operator():
    # A simulation that reproduces the raw log exactly must not be blamed for filter, gaps or differentiation.
    rng = np.random.default_rng(3)
    taps = KaiserLowpass(RATE).taps
    margin = len(taps) // 2 + 1
    log = smooth(rng, 70 + 2 * margin, 3)
    delivered = np.ones(len(log), dtype=bool)
    delivered[margin + 30 : margin + 40] = False
    recorded = np.where(delivered[:, None], log, np.nan)
    filtered = KaiserLowpass(RATE).apply(recorded)
    rates = differentiate(filtered, RATE)
    inside = slice(margin, len(log) - margin)
    measured = np.column_stack(
        [filtered[inside, 0], filtered[inside, 1], rates[inside, 0], rates[inside, 1], filtered[inside, 2]]
    )
    cost = FilteredNrmse([TrialTarget("drop", measured, None, RATE, taps, delivered)], GEAR)
    # Rounding of 75-tap sums, divided by a step of 5 ms.
    assert cost(log[None])[0].max() < 1e-11


def test_plain_mode_compares_columns_as_they_are():
    rng = np.random.default_rng(5)
    measured = rng.normal(size=(50, 2))
    channels = (CostChannel("speed", "rad/s", 1), CostChannel("torque", "N*m", 0))
    cost = FilteredNrmse([TrialTarget("steps", measured)], channels)
    assert cost.n_total == 50
    assert cost.margins.tolist() == [0]
    samples = rng.normal(size=(3, 50, 2))
    by_channel, _ = cost(samples)
    for p in range(3):
        expected = [nrmse(samples[p, :, 1], measured[:, 0]), nrmse(samples[p, :, 0], measured[:, 1])]
        np.testing.assert_allclose(by_channel[p, 0], expected, rtol=1e-13)


def test_thread_count_and_neighbours_do_not_change_a_bit():
    rng = np.random.default_rng(11)
    cost, _, _ = gear_cost(rng)
    samples = np.stack([smooth(rng, cost.n_total, 3) for _ in range(17)])
    one, two = cost(samples, threads=1), cost(samples, threads=2)
    assert np.array_equal(one[0], two[0])
    assert np.array_equal(cost(samples[::-1])[0][::-1], two[0])


def test_penalty_is_finite_graded_and_counted():
    rng = np.random.default_rng(2)
    cost, _, _ = gear_cost(rng)
    samples = np.stack([smooth(rng, cost.n_total, 3) for _ in range(4)])
    reached = np.ones((4, 2))
    reached[1, 0] = 0.25
    reached[2, 0] = 0.75
    # The whole second trial of candidate 3 is not finite from its first row on.
    samples[3, cost.offsets[1] :] = np.nan
    by_channel, failed = cost(samples, reached)
    means = cost.mean(by_channel)
    assert np.isfinite(means).all()
    assert failed.tolist() == [[False, False], [True, False], [True, False], [False, True]]
    assert by_channel[1, 0] == pytest.approx(np.full(5, FAILED_NRMSE * 1.75))
    assert by_channel[2, 0] == pytest.approx(np.full(5, FAILED_NRMSE * 1.25))
    assert by_channel[3, 1] == pytest.approx(np.full(5, FAILED_NRMSE * 2.0))
    assert means[1] > means[2] > means[0]


@pytest.mark.parametrize("bad", [np.inf, np.nan, 1e200])
def test_samples_that_blow_up_are_penalised_where_they_do(bad):
    rng = np.random.default_rng(4)
    cost, _, margin = gear_cost(rng, gap=False)
    samples = np.stack([smooth(rng, cost.n_total, 3)] * 2)
    row = margin + 30
    samples[1, row, 1] = bad
    by_channel, failed = cost(samples)
    assert failed.tolist() == [[False, False], [True, False]]
    # 1e200 is finite as a sample and overflows as a square: failed, but it got to the end.
    share = 1.0 if np.isfinite(bad) else row / (cost.offsets[1] - cost.offsets[0])
    assert by_channel[1, 0] == pytest.approx(np.full(5, FAILED_NRMSE * (2 - share)))
    assert np.array_equal(by_channel[1, 1], by_channel[0, 1])


def test_refusals_name_trial_and_channel():
    measured = np.column_stack([np.ones(20), np.arange(20.0)])
    channels = (CostChannel("x", "m", 0), CostChannel("z", "m", 1))
    with pytest.raises(FitError, match=r"trial drop-1, x: constant"):
        FilteredNrmse([TrialTarget("drop-1", measured)], channels)
    with pytest.raises(FitError, match=r"trial drop-1, x: no valid sample"):
        FilteredNrmse([TrialTarget("drop-1", measured * [np.nan, 1.0])], channels)
    with pytest.raises(FitError, match="'std' or 'range'"):
        spread([1.0, 2.0], denominator="mad")
    with pytest.raises(FitError, match="weights"):
        FilteredNrmse([TrialTarget("drop-1", measured)], [CostChannel("z", "m", 1, weight=0.0)] * 2)
    with pytest.raises(ValueError, match="symmetric"):
        FilteredNrmse([TrialTarget("a", measured, taps=np.array([0.2, 0.5, 0.3]))], channels)
    free = (CostChannel("x", "m", 0, weight=0.0), CostChannel("z", "m", 1))
    # A constant channel of weight 0 does not count.
    unweighted = FilteredNrmse([TrialTarget("drop-1", measured)], free)
    assert np.isfinite(unweighted.mean(unweighted(np.zeros((1, 20, 2)))[0])).all()


def test_scoring_keeps_to_the_threads_that_it_is_given(monkeypatch):
    trial = TrialTarget("a", np.arange(6.0)[:, None])
    scorer = FilteredNrmse([trial], [CostChannel("x", "m", 0)])
    samples, ours, shares = np.ones((50, scorer.n_total, 1)), threading.get_ident(), []

    def score(first, last, *_):
        shares.append((threading.get_ident(), range(first, last)))
        time.sleep(0.01)

    monkeypatch.setattr(module, "score_population", score)
    scorer(samples, threads=1)
    assert shares == [(ours, range(50))]
    shares.clear()
    scorer(samples, threads=2)
    # Compiled in this thread, computed by two others, every candidate once.
    assert shares.pop(0) == (ours, range(0))
    assert len({thread for thread, _ in shares} - {ours}) == 2
    assert sorted(chain(*(share for _, share in shares))) == list(range(50))
