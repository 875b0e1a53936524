"""Joint draws of a fit: ends of the intervals, correlations, the valley of an open parameter, refusals."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from fakes.fits import made_fit
from fakes.lag_kind import write_lag
from sysid import load_fit, load_parameter_sets
from sysid.errors import FitError
from sysid.fit.store import write_fit
from sysid.parameters import Parameter, ParameterTable, SearchSpace
from sysid.trust.documents import TrustDocument
from sysid.trust.draws import STORED, evenly, joint_draws, normally
from sysid.workflows.draws import drawn_sets
from sysid.workflows.fit import fit_campaign
from sysid.workflows.options import FitOptions


@pytest.fixture(scope="module")
def lag(tmp_path_factory):
    """A campaign of a first-order lag, and its fit with intervals."""
    folder = tmp_path_factory.mktemp("lag")
    path = write_lag(folder)
    return path, fit_campaign(path, FitOptions(out=folder / "fit", quiet=True))[1]


NAMES = ("stiffness", "damping", "ground")
SPACE = SearchSpace.build(
    ParameterTable([Parameter(name, name, "1", 1.0, 0.0, 2.0, "linear", name, "made up") for name in NAMES]),
    NAMES,
    {},
)


def row(name, best, low, high, low_68, high_68, opened=False):
    return SimpleNamespace(
        name=name, refined=best, interval_95=[low, high], interval_68=[low_68, high_68],
        open_95=[opened, opened],
    )  # fmt: skip


@pytest.fixture
def judged():
    """A skewed interval, an even one, and an open parameter along whose valley the first one rises."""
    rows = [
        row("stiffness", 1.0, 0.8, 1.4, 0.9, 1.19),
        row("damping", 1.0, 0.9, 1.1, 0.95, 1.05),
        row("ground", 1.2, 0.0, 2.0, 0.0, 2.0, opened=True),
    ]
    ground = np.linspace(0.0, 2.0, 21)
    valley = np.column_stack([1.0 + 0.1 * (ground - 1.2), np.ones(21), ground])
    correlation = np.array([[1.0, 0.7, 0.2], [0.7, 1.0, 0.1], [0.2, 0.1, 1.0]])
    deviation = np.array([0.07, 0.025, 0.28])
    arrays = {
        "correlation": correlation,
        "covariance": correlation * np.outer(deviation, deviation),
        "profiles/ground/others": valley,
    }
    return SimpleNamespace(parameters=rows, stated=[]), arrays


def test_draws_end_where_the_intervals_end_and_have_their_correlation(judged):
    document, arrays = judged
    draws = SPACE.decode(joint_draws(SPACE, document, arrays, STORED))
    low, high = np.quantile(draws, [0.025, 0.975], axis=0)
    ends = np.array([one.interval_95 for one in document.parameters])
    half = np.ptp(ends, axis=1) / 2
    # The issue allows 15 %; 200 stratified draws leave 5 % of the half-width.
    assert np.all(np.abs(low - ends[:, 0]) < 0.1 * half)
    assert np.all(np.abs(high - ends[:, 1]) < 0.1 * half)
    assert np.corrcoef(draws[:, :2].T)[0, 1] == pytest.approx(0.7, abs=0.1)
    assert draws.min() >= 0.0
    assert draws.max() <= 2.0


def test_an_open_parameter_is_uniform_and_takes_others_along_its_valley(judged):
    document, arrays = judged
    draws = SPACE.decode(joint_draws(SPACE, document, arrays, STORED))
    # Of a uniform distribution a tenth lies in each tenth; ranks of normal numbers scatter by some draws.
    counts, _ = np.histogram(draws[:, 2], bins=10, range=(0.0, 2.0))
    assert counts.min() > 8
    assert counts.max() < 32
    # 0.1 × a uniform deviation of 0.58 beside a scatter of 0.07 × 2: a correlation of 0.38.
    assert np.corrcoef(draws[:, 0], draws[:, 2])[0, 1] == pytest.approx(0.38, abs=0.1)


def test_a_measured_curve_is_drawn_with_its_covariance():
    covariance = np.array([[4.0, -1.8], [-1.8, 1.0]])
    drawn = normally(("a", "b"), covariance, STORED)
    np.testing.assert_allclose(np.cov(drawn.T), covariance, rtol=0.02)
    np.testing.assert_array_equal(normally(("a", "b"), covariance, 50), drawn[:50])


def test_fewer_draws_are_the_first_ones_and_equal_every_time(judged):
    document, arrays = judged
    whole = joint_draws(SPACE, document, arrays, STORED)
    np.testing.assert_array_equal(joint_draws(SPACE, document, arrays, 50), whole[:50])
    assert joint_draws(SPACE, document, arrays, 300).shape == (300, 3)


def test_draws_of_other_names_are_independent(judged):
    document, arrays = judged
    draws = joint_draws(SPACE, document, arrays, STORED)
    alone = evenly({"saturation_current": [0.3, 0.4], "saturation_speed": [6.0, 6.4]}, STORED)
    assert alone.min(axis=0) == pytest.approx([0.3, 6.0], abs=2e-3)
    # Of 200 unrelated pairs the correlation scatters by 0.07; the same numbers for all have 0.98.
    assert np.abs(np.corrcoef(draws.T, alone.T)[:3, 3:]).max() < 0.3
    assert np.array_equal(
        alone[:50], evenly({"saturation_current": [0.3, 0.4], "saturation_speed": [6.0, 6.4]}, 50)
    )


def test_a_fit_without_intervals_and_no_draws_are_refused(tmp_path):
    folder = write_fit(made_fit(), tmp_path / "fit")
    with pytest.raises(FitError, match="has no intervals, so nothing can be drawn; run sysid trust"):
        drawn_sets(folder, 50)
    with pytest.raises(FitError, match=r"0 draws of .*expected 1 or more"):
        drawn_sets(folder, 0)


def test_draws_of_a_fit_are_exported_and_tabulated(lag, run, tmp_path):
    fit = load_fit(lag[1])
    frame = fit.draws(120)
    row = TrustDocument.read(lag[1]).parameters[0]
    low, high = frame[row.name].quantile([0.025, 0.975])
    assert (low, high) == pytest.approx(row.interval_95, abs=0.15 * np.ptp(row.interval_95) / 2)
    # The fit keeps 200; more are made from its campaign, and equal every time.
    assert len(fit.draws(250)) == 250
    pd.testing.assert_frame_equal(fit.draws(250), fit.draws(250))
    pd.testing.assert_frame_equal(fit.draws(50), frame[:50])
    for suffix in ("json", "csv", "h5", "mat"):
        assert run("export", lag[1], "--draws", "7", "--out", tmp_path / f"draws.{suffix}")[0] == 0
    table = pd.read_csv(tmp_path / "draws.csv", index_col="draw")
    np.testing.assert_array_equal(table.to_numpy(), frame[:7].to_numpy())
    assert [head.partition(" [")[0] for head in table] == [*frame]
    code, _, err = run("show", tmp_path / "draws.csv")
    assert (code, "a table of draws, for other programs" in err) == (2, True)
    back = load_parameter_sets(tmp_path / "draws.json")
    np.testing.assert_array_equal(back.values, frame[:7])
    assert "mean ± σ of the draws" in run("show", tmp_path / "draws.json")[1]
    code, _, err = run("export", lag[1], "--draws", "0", "--out", tmp_path / "none.json")
    assert code == 2
    assert "--draws" in err
    code, _, err = run("export", tmp_path / "draws.json", "--draws", "5", "--out", tmp_path / "none.json")
    assert (code, "--draws 5 needs the folder of a fit" in err) == (2, True)
    assert not (tmp_path / "none.json").exists()


def test_a_fit_without_intervals_has_no_draws(lag, run, tmp_path):
    fit_campaign(lag[0], FitOptions(out=tmp_path / "fit", quiet=True, trust=False))
    code, _, err = run("export", tmp_path / "fit", "--draws", "5", "--out", tmp_path / "draws.json")
    assert code == 2
    assert f"has no intervals, so nothing can be drawn; run sysid trust {tmp_path / 'fit'}" in err
    assert not (tmp_path / "draws.json").exists()
