"""Fits of synthetic drops: every run's score, errors, drops that were not fitted, two accuracies.

0.3 mm and 0.2 deg of noise.
"""

from dataclasses import replace

import numpy as np
import pytest

from fakes.gear_campaigns import opened, score_values, used
from fakes.gear_drops import touchdowns
from fakes.sets import assert_sets_agree
from sysid.fit.search import run_one
from sysid.fit.settings import SearchSettings
from sysid.gear.model import simulate
from sysid.gear.problem import GearProblem, gear_space, measured_values
from sysid.parameters import SearchSpace
from sysid.synthetic import read_truth, synthesize_gear
from sysid.workflows.fit import fit_gear
from sysid.workflows.options import FitOptions

# Relative errors that six drops allow [1]; the damper of the ground and, on most campaigns, mu_s - mu_k are
# not fixed by such data.
_LEGS = {
    "leg_axial_stiffness": 0.02, "leg_axial_damping": 0.02, "leg_bending_stiffness": 0.02,
    "ground_stiffness": 0.15,
}  # fmt: skip
BOUNDS = {
    "lf": _LEGS | {"joint_dx": 0.005, "joint_dz": 0.06, "leg_bending_damping": 0.02},
    "hf": _LEGS | {"kinetic_friction": 0.01, "leg_mass": 0.05, "leg_inertia": 0.05, "joint_dz": 0.05},
}  # fmt: skip
SEEDS = (1, 2, 3, 4, 5)
# Parameters in which sets of one optimum agree within 1 %. Dampings of the leg lie at that limit.
HELD = {
    "lf": {"joint_dx", "leg_axial_stiffness", "leg_bending_stiffness"},
    "hf": {"joint_dx", "leg_axial_stiffness", "leg_bending_stiffness", "kinetic_friction"},
}
# Low friction: three times the rms over noise draws of a feasibility study; k_s and dz_j are the weak ones.
# High friction: linearized spreads of 0.2 to 2 %, two to three of them.
NEAR = {
    "lf": {
        "joint_dx": 0.01, "leg_axial_stiffness": 0.02, "leg_axial_damping": 0.04,
        "leg_bending_stiffness": 0.02, "leg_bending_damping": 0.04, "joint_dz": 0.10,
        "ground_stiffness": 0.30,
    },
    "hf": {
        "kinetic_friction": 0.03, "leg_axial_stiffness": 0.03, "leg_bending_stiffness": 0.03,
        "leg_axial_damping": 0.03,
    },
}  # fmt: skip


def third_contact(drop, truth, surface):
    """Time of the third touchdown of the true drop on the log's clock [s]."""
    run = simulate(
        truth, drop.slope, drop.initial_state, drop.simulated_time, surface=surface, tolerance=1e-6
    )
    return drop.time[0] + touchdowns(run)[2][0]


def up_to_third_contact(drops, truth, surface):
    """The same drops, compared up to their third contact only; after it the bounces are chaotic."""
    out = []
    for drop in drops:
        early = drop.time < third_contact(drop, truth, surface)
        valid = early if drop.target.valid is None else drop.target.valid & early
        out.append(replace(drop, target=replace(drop.target, valid=valid)))
    return tuple(out)


@pytest.fixture(scope="module", params=["lf", "hf"])
def fitted(request, tmp_path_factory):
    """Five runs as by default: surface, opened campaign, result."""
    surface = request.param
    folder = synthesize_gear(tmp_path_factory.mktemp("fit") / surface, seed=1, surface=surface)
    options = FitOptions(out=folder / "result", quiet=True, trust=False)
    result, _ = fit_gear(folder / "campaign.toml", options)
    return surface, opened(folder), result


@pytest.mark.slow
def test_every_run_ends_where_the_truth_scores(fitted):
    surface, (campaign, drops, truth), result = fitted
    at_truth = float(score_values(campaign, used(drops), truth).cost[0])
    ratio = result.nrmse / at_truth
    assert len(ratio) == 5
    # Free parameters soak up some of the noise of 900 samples per channel: about 2 % of the truth's NRMSE.
    assert (ratio > 0.97).all()
    if surface == "lf":
        assert (ratio <= 1.002).all()
    else:
        assert (ratio <= 1.005).sum() >= 4


@pytest.mark.slow
def test_sets_agree_and_lie_near_the_truth(fitted):
    surface, (_, _, truth), result = fitted
    agreed = assert_sets_agree(result)
    found = result.parameter_sets()
    # On high friction one run of five may end elsewhere. A finding then doubts what agrees in the other four.
    assert surface == "hf" or agreed >= HELD["lf"]
    agreeing = found.values if surface == "lf" else found.values[:4]
    for name in HELD[surface]:
        column = agreeing[:, found.names.index(name)]
        assert np.ptp(column) <= 0.01 * column.mean(), name
    sets = found.values if surface == "lf" else found.values[:1]
    for name, error in NEAR[surface].items():
        assert sets[:, found.names.index(name)] == pytest.approx(np.full(len(sets), truth[name]), rel=error)


@pytest.mark.slow
def test_drops_that_were_not_fitted(fitted):
    surface, (campaign, drops, truth), result = fitted
    early = up_to_third_contact(used(drops, "validate"), truth, surface)
    assert len(early) == 2
    best = result.parameter_sets().set_values(1)
    best = {name: value for name, value in best.items() if name in truth}
    at_truth, of_fit = (
        score_values(campaign, early, values).by_channel.mean(axis=2)[0] for values in (truth, best)
    )
    # A fit that has learnt noise instead of a drone fails here.
    assert (of_fit <= 1.1 * at_truth).all()


def exact_start(drops, facts, gravity):
    """The same drops from where they truly were at their first sample, instead of from what the log says."""
    by_name = {fact["name"]: fact for fact in facts["drops"]}
    out = []
    for drop in drops:
        fact = by_name[drop.name]
        held = fact["state_at_release"]
        fall = max(0.0, drop.time[0] - fact["release"])
        x, z, q = held["x_B"], held["z_B"] - 0.5 * gravity * fall**2, held["q_B"]
        out.append(replace(drop, initial_state=np.array([x, z, q, 0.0, -gravity * fall, 0.0])))
    return tuple(out)


def errors(objective, truth, seed, **search):
    """Relative errors of one run."""
    run = run_one(objective, SearchSettings(runs=1, seed=seed, **search))
    values = objective.space.full(run.best_point[None])[0]
    row = dict(zip(objective.space.table, values, strict=True))
    return {name: row[name] / truth[name] - 1 for name in objective.space.names}


@pytest.mark.slow
@pytest.mark.parametrize("surface", ["lf", "hf"])
def test_parameters_are_found_within_what_the_data_fix(surface, tmp_path):
    """Median over five draws of noise, from the true start, as in the study that the bounds are from.

    The start that the pipeline estimates from a hold errs, and some parameters pay; linearized medians: low
    friction k_s 16 % and b_h 2.7 %, high friction m_leg 16 % and mu_k 2.2 %, all beyond these bounds.
    """
    draws = []
    for seed in SEEDS:
        folder = synthesize_gear(tmp_path / str(seed), seed=seed, surface=surface)
        campaign, drops, truth = opened(folder)
        start = exact_start(used(drops, "fit"), read_truth(folder), truth["gravity"])
        objective = GearProblem(campaign, gear_space(campaign), start)
        draws.append(errors(objective, truth, seed))
    median = {name: float(np.median([abs(draw[name]) for draw in draws])) for name in draws[0]}
    for name, bound in BOUNDS[surface].items():
        assert median[name] <= bound, (name, [draw[name] for draw in draws])


@pytest.mark.slow
def test_two_accuracies_find_the_same_high_friction_parameters(tmp_path):
    """From near the truth, which spares the search: what moves is where the cost is least."""
    folder = synthesize_gear(tmp_path / "drops", seed=1, surface="hf")
    campaign, drops, truth = opened(folder)
    wide = gear_space(campaign)
    near = {r.name: (max(r.lower, 0.7 * truth[r.name]), min(r.upper, 1.4 * truth[r.name])) for r in wide.free}
    space = SearchSpace.build(wide.table, wide.names, measured_values(campaign), near)
    # Ends with more digits of weak parameters (leg_mass) than the default, which stops where NRMSE does.
    search = {"algorithm": "pso", "population": 100, "finish": "cmaes"}
    problems = (GearProblem(campaign, space, used(drops, "fit"), tolerance=one) for one in (1e-3, 1e-4))
    errs = [errors(problem, truth, seed=1, **search) for problem in problems]
    moved = {name: (1 + errs[0][name]) / (1 + errs[1][name]) - 1 for name in space.names}
    # Not fixed by such data at either accuracy.
    loose = ("ground_damping", "static_friction_excess")
    for name in space.names:
        # What is claimed beside the surface's tolerance is 0.6 %, at most 1 %, of k_s and 0.5 % of others.
        assert name in loose or abs(moved[name]) < (0.015 if name == "ground_stiffness" else 0.01), name


@pytest.mark.slow
def test_two_accuracies_find_the_same_parameters(tmp_path):
    folder = synthesize_gear(tmp_path / "drops", seed=1)
    path = folder / "campaign.toml"
    text = path.read_text(encoding="utf-8")
    sets = []
    for tolerance in (3e-4, 3e-5):
        path.write_text(text.replace("[fit]\n", f"[fit]\ntolerance = {tolerance}\n"), encoding="utf-8")
        # The best of five, as a fit has by default: on some processors three end in dents, 1.1 % off in k_s.
        options = FitOptions(out=tmp_path / f"{tolerance}", runs=5, quiet=True, check=False, trust=False)
        result, _ = fit_gear(path, options)
        assert result.settings["tolerance"] == tolerance
        sets.append(result.parameter_sets().set_values(1))
    moved = {name: sets[0][name] / sets[1][name] - 1 for name in BOUNDS["lf"]}
    # A setting that were wrong by 1 % of NRMSE would move the optimum by that order.
    assert max(abs(m) for m in moved.values()) < 0.01, moved
