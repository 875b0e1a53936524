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


@pytest.mark.parametrize(
    ("seed", "surface", "foreign", "terms", "word"),
    [(1009, "lf", 0, {}, "explained"), (1010, "lf", 0, {}, "explained"), (1012, "lf", 0, {}, "explained"),
     (202, "lf", 1, {}, "not_explained"), (203, "lf", 1, {}, "not_explained"),
     (204, "lf", 1, {}, "not_explained"), (21, "hf", 0, {}, "explained"),
     (22, "hf", 0, {"leg_joint_friction": 0.06}, "not_explained")],
)  # fmt: skip
def test_the_verdict_knows_right_models_from_wrong_ones(tmp_path, seed, surface, foreign, terms, word):
    """On low friction a number of terms are foreign to the kernel; on high friction they are its own."""
    lab = {"simulate": simulator(**drawn_terms(seed, foreign))} if foreign else {}
    folder = synthesize_gear(tmp_path / "drops", seed=seed, surface=surface, parameters=terms, **lab)
    path = folder / "campaign.toml"
    problem = find_kind("gear").open(read_campaign(path, "gear"), path, None).fitted.exact
    true = read_truth(folder)["parameters"]
    truth = problem.space.encode(np.array([true[name] for name in problem.space.names]))
    point = linearize(problem, np.clip(truth, 0.0, 1.0)).point
    assert adequacy(problem, problem.space.full(point[None])[0]).verdict == word
