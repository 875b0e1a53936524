"""Right and wrong models on six drops: is the verdict right?

Three campaigns of each kind; `tests/benchmarks/interval_coverage.py` has twenty.
"""

import numpy as np
import pytest

from fakes.foreign_gear import drawn_terms, simulator
from sysid.campaign import read_campaign
from sysid.fit.adequacy import adequacy
from sysid.synthetic import read_truth, synthesize_gear
from sysid.trust.assessment import linearize
from sysid.workflows.kinds import find_kind

pytestmark = pytest.mark.slow


def opened(folder, seed, count):
    """The drops of a gear with a number of foreign terms, and the true values [unit cube]."""
    lab = {"simulate": simulator(**drawn_terms(seed, count))} if count else {}
    path = synthesize_gear(folder / "drops", seed=seed, **lab) / "campaign.toml"
    problem = find_kind("gear").open(read_campaign(path, "gear"), path, None).fitted.exact
    true = read_truth(path.parent)["parameters"]
    return problem, problem.space.encode(np.array([true[name] for name in problem.space.names]))


@pytest.mark.parametrize(
    ("seed", "count", "word"),
    [(1009, 0, "explained"), (1010, 0, "explained"), (1012, 0, "explained"),
     (202, 1, "not_explained"), (203, 1, "not_explained"), (204, 1, "not_explained")],
)  # fmt: skip
def test_the_verdict_knows_right_models_from_wrong_ones(tmp_path, seed, count, word):
    problem, truth = opened(tmp_path, seed, count)
    point = linearize(problem, truth).point
    assert adequacy(problem, problem.space.full(point[None])[0]).verdict == word


@pytest.mark.parametrize(
    ("seed", "terms", "word"),
    [(21, {}, "explained"), (22, {"leg_joint_friction": 0.06}, "not_explained")],
)
def test_the_verdict_knows_them_on_high_friction(tmp_path, seed, terms, word):
    path = synthesize_gear(tmp_path / "drops", seed=seed, surface="hf", parameters=terms) / "campaign.toml"
    problem = find_kind("gear").open(read_campaign(path, "gear"), path, None).fitted.exact
    true = read_truth(path.parent)["parameters"]
    truth = problem.space.encode(np.array([true[name] for name in problem.space.names]))
    point = linearize(problem, np.clip(truth, 0.0, 1.0)).point
    assert adequacy(problem, problem.space.full(point[None])[0]).verdict == word
