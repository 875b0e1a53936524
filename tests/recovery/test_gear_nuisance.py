"""Offsets of single drops and the high-friction campaign: known truth through the pipeline."""

import numpy as np
import pytest

from fakes.gear_campaigns import EXACT, opened, score_values, used
from sysid.gear.drops import prepare_drops
from sysid.gear.model import LF_FREE, PARAMETERS, SURFACES, parameters_on
from sysid.gear.problem import GearProblem, gear_space
from sysid.synthetic import HF_DROPS, LF_DROPS, read_truth, synthesize_gear


@pytest.fixture(scope="module")
def drops(tmp_path_factory):
    return synthesize_gear(
        tmp_path_factory.mktemp("n") / "lf", seed=3, drops=(*LF_DROPS[:2], LF_DROPS[6]), **EXACT
    )


def test_offsets_of_a_drop_are_found_where_they_were_put(drops):
    assert gear_space(opened(drops)[0]).names == LF_FREE  # there are none by default
    campaign, prepared, truth = opened(drops, '[nuisance]\nheight = "2 mm"\nstart_time = "2 ms"\n')
    space = gear_space(campaign)
    assert space.names[8:] == tuple(
        f"{kind}[drop-{n}]" for n in (1, 2) for kind in ("height_offset", "start_offset")
    )
    objective = GearProblem(campaign, space, used(prepared))
    exact = np.array([truth.get(name, 0.0) for name in space.names])
    grid = np.linspace(-1e-3, 1e-3, 9)
    for column in range(8, 12):
        rows = np.tile(space.encode(exact), (len(grid), 1))
        low, high = space.free[column].lower, space.free[column].upper
        rows[:, column] = (grid - low) / (high - low)
        cost = objective.evaluate(rows).cost
        # Without an error in the plane or the clock the best offset is none, and a millimetre (a
        # millisecond) shows.
        assert np.argmin(cost) == 4
        assert min(cost[0], cost[-1]) > 5 * cost[4]
    # A validation drop has no offset: the offsets of the others change no bit of its score.
    accurate = campaign.model_copy(update={"fit": campaign.fit.model_copy(update={"tolerance": 1e-6})})
    every = GearProblem(accurate, space, prepared)
    moved = space.encode(exact)[None].repeat(2, axis=0)
    moved[1, 8:] = 0.9
    none, shifted = every.score(space.full(moved)).by_channel[:, 2]
    np.testing.assert_array_equal(shifted, none)
    # It is the score of a campaign without offsets, but for the last bits of the unit cube (2e-10 of a
    # parameter). Those turn a step that is just accepted into one that is not: 8e-6 of NRMSE at the fit's
    # setting, 2e-7 at 1e-4, 2e-8 here, 3e-9 at 1e-7, so it is the size of steps and no offset.
    plain = score_values(accurate, prepared, truth).by_channel[:, 2]
    np.testing.assert_allclose(shifted, plain[0], rtol=0, atol=1e-6)


def test_a_surface_that_is_a_millimetre_off_is_found_by_its_offset(drops):
    point = read_truth(drops)["capture"]["surface_point"]
    campaign, _, truth = opened(drops, '[nuisance]\nheight = "3 mm"\n')
    moved = (point[0], point[1] + 1e-3, point[2])
    surface = campaign.surface.model_copy(update={"point": moved})
    wrong = campaign.model_copy(update={"surface": surface})
    space = gear_space(wrong)
    objective = GearProblem(wrong, space, used(prepare_drops(wrong, drops / "changed.toml")))
    exact = np.array([truth.get(name, 0.0) for name in space.names])
    corrected = exact.copy()
    corrected[8:] = -1e-3
    cost = objective.evaluate(space.encode(np.array([exact, corrected]))).cost
    # The board lies 1 mm lower than the campaign says; told so, the truth scores what it scores with a right
    # plane, up to the window that begins a sample elsewhere.
    assert cost[1] < 0.1 * cost[0]
    assert cost[1] < 5e-3


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
