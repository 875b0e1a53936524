"""Does noise explain what a fit leaves: right models, wrong ones, and the place of a known misfit."""

import numpy as np
import pytest

from fakes.foreign_gear import simulator
from sysid.campaign import read_campaign
from sysid.fit.adequacy import adequacy, misfit_finding, scores_in_words, verdict_of
from sysid.gear import model
from sysid.synthetic import read_truth, synthesize_gear
from sysid.synthetic.gear import DropPlan
from sysid.workflows.kinds import find_kind

DROPS = (DropPlan(np.radians(8), 0.5), DropPlan(np.radians(20), 0.7))


def judged(folder, at_bound=None, **terms):
    """Judge the true values on two drops, of a gear with foreign terms."""
    out = synthesize_gear(folder, seed=7, drops=DROPS, simulate=simulator(**terms))
    path = out / "campaign.toml"
    problem = find_kind("gear").open(read_campaign(path, "gear"), path, 1).exact
    true = read_truth(out)["parameters"]
    row = np.array([true.get(name, problem.base[i]) for name, i in problem.space.table.index.items()])
    return adequacy(problem, row, at_bound)


@pytest.mark.parametrize("excess", [0.0, 0.15])
def test_the_foreign_simulator_without_terms_is_the_model(excess):
    true = {**model.PARAMETERS.nominal, "front_friction_excess": excess}
    start = np.array([-0.2, 0.5, 0.0, 0.0, 0.0, 0.0])
    clock = np.linspace(0.0, 0.6, 61)
    arguments = (true, np.radians(15), start, clock)
    ours = model.simulate(*arguments, surface="lf", tolerance=model.TIGHT_TOLERANCE)
    theirs = simulator(front_friction=1.0 + excess)(*arguments, surface="lf", tolerance=model.TIGHT_TOLERANCE)
    # Ten thousandths of the capture's noise of 0.3 mm.
    np.testing.assert_allclose(ours.state[:, :3], theirs.state[:, :3], atol=3e-8)


def test_noise_explains_the_truth_and_nothing_is_noticed(tmp_path):
    found = judged(tmp_path / "right")
    assert found.verdict == "explained"
    assert found.sentence.startswith("explained: NRMSE ")
    assert "(noise alone: " in found.sentence
    # Two drops leave each channel 300 samples of noise.
    assert all(
        0.8 < channel.ratio < 1.2 and abs(channel.autocorrelation) < 0.15 for channel in found.channels
    )
    assert misfit_finding(found) == ()
    # One ratio in every command: errors of the inputs explain little here.
    assert found.ratio == pytest.approx(found.nrmse / found.floor, rel=1e-12)


def test_ratio_and_nrmse_of_a_verdict_are_of_one_definition():
    # 0.81 times a noise of 0.39 % is what errors of the inputs leave of 0.39 %, not the 0.39 % themselves.
    words = scores_in_words(0.0039, 0.0039, 0.81)
    assert (
        words
        == "NRMSE 0.39 %, 0.32 % without what errors of the measured inputs explain (noise alone: 0.39 %)"
    )
    assert scores_in_words(0.083, 0.083, 1.0) == "NRMSE 8.30 % (noise alone: 8.30 %)"
    # One number where errors of the inputs explain little, or nothing: weights of channels differ.
    assert scores_in_words(0.0356, 0.0012, 29.8) == "NRMSE 3.56 % (noise alone: 0.12 %)"


def test_a_misfit_that_the_mean_hides_is_named_with_its_place(tmp_path):
    found = judged(tmp_path / "wrong", {"ground_stiffness": 1, "joint_dx": 0}, front_bending=1.05)
    # Velocities are mostly noise: the mean stays low while the pitch is off by many noise deviations.
    assert found.ratio < 1.5
    assert found.verdict == "not_explained"
    (finding,) = misfit_finding(found)
    assert finding.code == "not-explained"
    worst = max(found.channels, key=lambda channel: channel.ratio)
    assert found.misfit.channel == worst.name
    assert worst.ratio > 2
    assert worst.autocorrelation > 0.3
    # Nothing is wrong with a fall.
    assert {phase.name: phase.ratio for phase in found.phases}["before the first contact"] < 1.2
    assert found.misfit.phase != "before the first contact"
    for words in (f"in {worst.name}", found.misfit.phase, found.misfit.trial, "no parameter is well known"):
        assert words in finding.sentence
    assert found.symptoms == ["ground_stiffness"]
    assert "k_s" in finding.sentence


@pytest.mark.parametrize(
    ("ratio", "word"),
    [
        (1.2, "explained"),
        (1.21, "roughly"),
        (1.5, "roughly"),
        (1.51, "not_explained"),
        (np.nan, "not_explained"),
    ],
)
def test_one_word_first(ratio, word):
    assert verdict_of(ratio) == word
