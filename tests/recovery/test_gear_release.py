"""Releases of single drops and the high-friction campaign: known truth through the pipeline."""

import numpy as np
import pytest

from fakes.gear_campaigns import EXACT, opened, score_values, used
from sysid.gear.drops import prepare_drops
from sysid.gear.model import LF_FREE, PARAMETERS, SURFACES, parameters_on
from sysid.gear.problem import GearProblem, gear_space
from sysid.stated import Stated
from sysid.synthetic import HF_DROPS, LF_DROPS, read_truth, synthesize_gear


@pytest.fixture(scope="module")
def drops(tmp_path_factory):
    return synthesize_gear(
        tmp_path_factory.mktemp("n") / "lf", seed=3, drops=(*LF_DROPS[:2], LF_DROPS[6]), **EXACT
    )


def test_a_release_that_is_stated_with_an_error_is_found_where_it_was(drops):
    facts = {fact["name"]: fact["release"] for fact in read_truth(drops)["drops"]}
    campaign, _, truth = opened(drops)
    trials = tuple(
        trial.model_copy(update={"release": Stated(facts[trial.name], 1e-3 * (trial.name != "drop-1"))})
        for trial in campaign.trials
    )
    campaign = campaign.model_copy(update={"trials": trials})
    prepared = prepare_drops(campaign, drops / "campaign.toml")
    space = gear_space(campaign)
    # An exact release does not move, and neither does that of a drop that is only predicted.
    assert [row.name for row in space.free] == [*LF_FREE, "release_delay[drop-2]"]
    objective = GearProblem(campaign, space, used(prepared))
    exact = np.array([truth.get(name, 0.0) for name in space.names])
    late = np.linspace(-1e-3, 1e-3, 9)
    rows = np.tile(space.full(space.encode(exact)[None]), (len(late), 1))
    rows[:, space.table.index["release_delay[drop-2]"]] = late
    scored = objective.score(rows).by_channel.mean(axis=2)
    assert np.argmin(scored[:, 1]) == 4
    assert min(scored[0, 1], scored[-1, 1]) > 5 * scored[4, 1]
    # The other drop's score keeps its bits.
    np.testing.assert_array_equal(scored[:, 0], scored[0, 0])


def test_the_truth_of_high_friction_drops_scores_nothing(tmp_path):
    folder = synthesize_gear(tmp_path / "hf", seed=3, surface="hf", drops=HF_DROPS[:3], **EXACT)
    campaign, prepared, truth = opened(folder)
    free = SURFACES["hf"].free
    assert gear_space(campaign).names == free
    assert {name: truth[name] for name in free} == {n: parameters_on("hf").nominal[n] for n in free}
    scored = score_values(campaign, prepared, truth)
    # Quantization, and 0.3 % of integration where a foot switches its mode.
    assert scored.cost[0] < 5e-3
    assert not scored.failed.any()
    # Parameters that are left alone take the surface's own defaults.
    assert score_values(campaign, prepared, {}).cost[0] == scored.cost[0]
    beside = score_values(campaign, prepared, {**truth, "kinetic_friction": 0.7}).cost[0]
    assert beside > 10 * scored.cost[0]


def test_front_legs_may_differ(drops):
    campaign, prepared, truth = opened(drops)
    equal = score_values(campaign, prepared, truth).cost[0]
    names = [name for name in PARAMETERS if name.startswith("front_leg_")]
    assert len(names) == 6
    for name in names:
        assert score_values(campaign, prepared, {**truth, name: 1.5}).cost[0] > 1.5 * equal
