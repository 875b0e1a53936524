"""Trust on drops with known truth: intervals hold it, wrong models are flagged, the next drop helps."""

import math
import re

import numpy as np
import pytest

from fakes.gear_campaigns import on_board
from fakes.places import SAMPLES
from sysid.campaign import read_campaign
from sysid.campaign.common import as_exact
from sysid.errors import FitError
from sysid.fit.trial import nrmse_of
from sysid.gear.drops import prepare_drops
from sysid.gear.problem import TRUST_TOLERANCE, GearProblem, gear_space
from sysid.gear.starts import compared_noise, start_roots
from sysid.gear.story import centre_of_mass, turning_point
from sysid.synthetic import read_truth, synthesize_gear
from sysid.synthetic.gear import DropPlan
from sysid.trust.assessment import leave_one_out, linearize
from sysid.trust.documents import TRUST, TrustDocument, ValidationDocument, parts, read_arrays, use_of
from sysid.trust.influence import influence
from sysid.trust.sensitivity import quick_expectations
from sysid.trust.use import NOT
from sysid.trust.verdicts import VERDICTS
from sysid.workflows.check import check_campaign
from sysid.workflows.fit import fit_gear
from sysid.workflows.kinds import find_kind
from sysid.workflows.options import FitOptions, TrustOptions
from sysid.workflows.predict import cross_validate, validate_fit
from sysid.workflows.reopen import open_fit
from sysid.workflows.trust import assess_fit

LF = SAMPLES / "gear-lf" / "campaign.toml"


@pytest.fixture(scope="module")
def lf():
    """The sample, whose stated values are the truth, so they are taken as exact."""
    campaign = as_exact(read_campaign(LF, "gear"))
    whole = find_kind("gear").open(campaign, LF, None)
    return campaign, whole.drops, whole.fitted.exact


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """A campaign of three of the sample's drops to fit and one to validate."""
    head, *trials = LF.read_text(encoding="utf-8").split("[[trials]]\n")
    kept = [trials[i].replace('log = "', f'log = "{LF.parent.as_posix()}/') for i in (0, 2, 4, 6)]
    path = tmp_path_factory.mktemp("three") / "campaign.toml"
    path.write_text("[[trials]]\n".join([head, *kept]), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def fit(three, tmp_path_factory):
    """A short fit: trust refines it itself."""
    folder = tmp_path_factory.mktemp("trust") / "lf"
    options = FitOptions(
        out=folder, runs=2, population=32, max_generations=20, quiet=True, check=False, trust=False
    )
    return fit_gear(three, options)[1]


def _truth(problem, folder=LF.parent):
    true = read_truth(folder)["parameters"]
    return problem.space.encode(np.array([true[name] for name in problem.space.names]))


def test_residuals_are_those_of_the_cost(lf):
    problem = lf[2]
    point = np.stack([_truth(problem), np.full(8, 0.5)])
    values, failed = problem.residuals(point)
    weights = np.array([block.weight for block in problem.blocks])
    assert not failed.any()
    # The same filter as a matrix: rounding alone.
    assert nrmse_of(problem.blocks, values) @ weights == pytest.approx(problem.evaluate(point).cost, rel=1e-9)


def test_a_candidate_that_the_cost_penalizes_has_failed(lf):
    problem = lf[2]
    short = on_board(problem, 0.05)
    # Every drop of the sample slides farther than 5 cm.
    assert short.residuals(_truth(problem)[None])[1].all()


def test_the_noise_floor_is_what_the_truth_scores(lf):
    _, drops, problem = lf
    values, _ = problem.residuals(_truth(problem)[None])
    ratio = nrmse_of(problem.blocks, values[0]) / np.array([block.noise for block in problem.blocks])
    # Starts that noise has moved add to single channels; the median block is noise alone.
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)
    assert ratio.min() > 0.8
    assert compared_noise(drops[0]).shape == (5,)


def test_starts_err_by_what_their_covariance_says(lf):
    _, drops, _ = lf
    scores = []
    for drop, fact in zip(drops, read_truth(LF.parent)["drops"], strict=True):
        root = start_roots(drop)
        late = (drop.flight.start - fact["release"]) * drop.flight.gravity
        scores.append(late / math.sqrt((root.T @ root)[4, 4]))
    # Eight releases: their rms of one standard deviation lies between 0.5 and 1.6 in 99 % of all draws.
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.6


def test_disturbances_move_their_own_drop_alone(lf):
    _, drops, problem = lf
    moved = problem.disturbances(_truth(problem))
    kinds = len(start_roots(drops[0]))
    assert moved.shape == (kinds * len(problem.trials), problem.blocks[-1].stop)
    for block in problem.blocks:
        own = moved[block.trial * kinds : (block.trial + 1) * kinds, block.start : block.stop]
        others = np.delete(moved, np.s_[block.trial * kinds : (block.trial + 1) * kinds], axis=0)
        assert np.any(own != 0)
        assert np.all(others[:, block.start : block.stop] == 0)


def test_six_drops_fix_all_but_the_ground(lf):
    _, _, problem = lf
    found = {one.name: one for one in quick_expectations(problem)}
    assert found["ground_damping"].verdict == "not_identifiable"
    assert found["ground_stiffness"].verdict == "weakly"
    for name in ("joint_dx", "leg_axial_stiffness", "leg_axial_damping", "leg_bending_stiffness"):
        assert found[name].verdict == "well"
    # Linearized one sigma of six such drops, exact starts: 0.1 %, 0.3 %; with uncertain starts up to 2.5
    # times.
    assert 0.001 < found["joint_dx"].half_width / 1.96 < 0.0025
    assert 0.003 < found["leg_axial_stiffness"].half_width / 1.96 < 0.0085


def test_a_tumbling_body_tells_its_centre_of_mass(lf):
    campaign, drops, _ = lf
    source = np.random.default_rng(3)
    time = np.arange(80) / 200.0
    flights = []
    for turn in (6.0, -5.0):
        q = 0.3 + turn * time
        # The tracked point lies 12 mm down-slope of and 4 mm below the centre of mass.
        x = 0.4 * time + 0.012 * np.cos(q) - 0.004 * np.sin(q) + 3e-4 * source.standard_normal(80)
        z = time - 4.905 * time**2 - 0.012 * np.sin(q) - 0.004 * np.cos(q)
        flights.append((time, x, z + 3e-4 * source.standard_normal(80), q))
    offset, error = turning_point(flights, 9.81, 3e-4)
    assert np.all(error < 1e-3)
    assert np.all(np.abs(offset - [-0.012, 0.004]) < 4 * error)
    # The sample's short hops tell it to within their own error, and nobody is warned.
    found = centre_of_mass(drops, campaign)
    assert found is None or abs(found["up"]) < 4 * found["up_error"]


def test_trust_is_stored_and_holds_the_truth(fit, lf):
    problem = lf[2]
    document = assess_fit(fit, TrustOptions(resamples=10))
    rows = document.by_name
    assert parts(fit) == (TRUST,)
    again = TrustDocument.read(fit)
    assert again is not None
    assert again.parameters == document.parameters
    assert rows["ground_damping"].verdict == "not_identifiable"
    assert rows["ground_damping"].open_95 == [True, True]
    true = dict(zip(problem.space.names, problem.space.decode(_truth(problem)), strict=True))
    for name, row in rows.items():
        low, high = row.interval_95
        # Seven intervals of 95 %: one may miss the truth by a little.
        assert low - (high - low) / 2 < true[name] < high + (high - low) / 2
        assert row.verdict in VERDICTS
        assert low <= row.refined <= high
    arrays = read_arrays(fit, TRUST)
    deviance = arrays["profiles/joint_dx/deviance"]
    assert deviance.min() == 0.0
    assert deviance[0] > 3.84 < deviance[-1]
    assert np.all(np.diff(arrays["profiles/joint_dx/value"]) > 0)
    assert arrays["bootstrap/values"].shape == (10, 23)
    assert len(document.spread.trials) == 4
    # A new fit, and what was known of the old one is not taken for it.
    changed = fit / "fit.h5"
    whole = changed.read_bytes()
    try:
        changed.write_bytes(whole + b"x")
        assert TrustDocument.read(fit) is None
    finally:
        changed.write_bytes(whole)


def test_validation_takes_the_trials_that_were_not_fitted(fit):
    found = validate_fit(fit, LF)
    # By the logs' content: drops 1, 3 and 5 were fitted under another campaign file.
    assert [one.name for one in found.trials] == [f"drop-{i}" for i in (2, 4, 6, 7, 8)]
    row = found.trials[0]
    assert set(row.by_channel) == {"x_B", "z_B", "x_B_rate", "z_B_rate", "q_B"}
    assert row.third_contact > 0.05
    assert row.nrmse_third_contact > 0
    numbers = {number.what: number for number in row.numbers}
    place, tilt = numbers["rest place"], numbers["largest pitch"]
    assert place.low < place.predicted < place.high < place.low + 10.0
    assert tilt.measured == pytest.approx(tilt.predicted, abs=1.0)
    # The foot that touches second does so within milliseconds of the prediction.
    second = next(number for name, number in numbers.items() if name.startswith("touchdown, first"))
    assert second.high - second.low < 10.0
    assert abs(second.measured - second.predicted) < 5.0
    assert row.ends.measured == row.ends.predicted == "at rest"
    assert found.use.word != NOT
    assert use_of(fit).held == found.use.held
    assert ValidationDocument.read(fit, "validation-synthetic-lf").flagged is found.flagged
    assert read_arrays(fit, "validation-synthetic-lf")["trials/1/simulated"].shape[0] == 2


@pytest.mark.slow
def test_the_drop_that_misleads_a_fit_is_named(tmp_path):
    # Seed 1011: at the truth drop-5 alone scores 2.3 times its noise, and the fit bends k_h and b_h to it.
    path = synthesize_gear(tmp_path / "c", seed=1011) / "campaign.toml"
    campaign = read_campaign(path, "gear")
    problem = find_kind("gear").open(campaign, path, None).fitted.exact
    linear = linearize(problem, _truth(problem, path.parent))
    floors = np.array([block.noise for block in problem.blocks])
    found = influence(problem, linear, floors, leave_one_out(problem, linear))
    # Its residual tells nothing, for the fit has bent to it.
    assert found.outliers == ()
    named = {problem.names[t]: {problem.space.names[i] for i in far} for t, far in found.held_by}
    assert {"leg_axial_stiffness", "leg_axial_damping"} <= named["drop-5"]
    # Without it k_h comes back to within one percent, its half-width; with it it is 5 % off.
    stiffness = problem.space.names.index("leg_axial_stiffness")
    back = problem.space.decode(found.without[problem.names.index("drop-5")])[stiffness]
    true = read_truth(path.parent)["parameters"]["leg_axial_stiffness"]
    assert back == pytest.approx(true, rel=0.012)
    assert problem.space.decode(linear.point)[stiffness] < 0.97 * true


def test_campaigns_without_unseen_trials_or_file_are_refused(fit, three, tmp_path):
    seen = tmp_path / "seen.toml"
    text = three.read_text(encoding="utf-8").split('[[trials]]\nname = "drop-7"')[0]
    seen.write_text(text, encoding="utf-8")
    with pytest.raises(FitError, match="each trial is then predicted by the others"):
        validate_fit(fit, seen)
    with pytest.raises(FitError, match="no such campaign file; --campaign names the one of the fit"):
        open_fit(fit, tmp_path / "gone.toml")


@pytest.mark.slow
def test_leaving_drops_out_predicts_them(fit):
    found = cross_validate(fit)
    assert [one.name for one in found.trials] == ["drop-1", "drop-3", "drop-5"]
    # The right model, but two drops to fit it: what they leave open adds to the noise.
    assert 0.9 < found.ratio < 2.0
    # Eight parameters and fourteen stated values, of which the slope of the left-out drop is as stated.
    assert len(found.trials[0].refit) == 23
    assert found.trials[0].refit["slope[drop-1]"] == math.radians(5)


def _plan(slope_deg, speed):
    return DropPlan(math.radians(slope_deg), speed)


@pytest.mark.slow
def test_level_drops_name_what_they_cannot_fix_and_the_drop_that_does(tmp_path):
    drops = [_plan(0, 0.4), _plan(0, 0.6), _plan(0, 0.8)]
    before = check_campaign(synthesize_gear(tmp_path / "a", seed=7, drops=drops) / "campaign.toml")
    rank = {word: i for i, word in enumerate(VERDICTS)}
    old = {row.name: row for row in before.parameters}
    named = [s for s in before.sentences if s.startswith("to determine ")]
    assert old["leg_bending_stiffness"].verdict == "not_identifiable"
    assert any("k_t" in sentence for sentence in named)
    first = before.candidates[0].title
    slope, speed = map(float, re.fullmatch(r"a drop on ([\d.]+) deg at ([\d.]+) m/s", first).groups())
    added = [*drops, _plan(slope, speed)]
    after = check_campaign(synthesize_gear(tmp_path / "b", seed=7, drops=added) / "campaign.toml")
    new = {row.name: row for row in after.parameters}
    promised = before.candidates[0].verdicts
    for name in ("joint_dx", "joint_dz", "leg_bending_stiffness", "leg_bending_damping"):
        assert rank[promised[name]] < rank[old[name].verdict]
        assert rank[new[name].verdict] < rank[old[name].verdict]
    assert new["ground_damping"].verdict == "not_identifiable"


@pytest.mark.slow
@pytest.mark.parametrize("case", ["leg mass", "friction law", "right"])
def test_a_wrong_model_is_flagged_by_its_ratio_to_the_noise(case, tmp_path):
    if case == "leg mass":
        path = synthesize_gear(tmp_path / "c", seed=11, parameters={"leg_mass": 0.06}) / "campaign.toml"
        text = path.read_text(encoding="utf-8")
        path.write_text(text.replace('leg_mass = "0.06 kg"', 'leg_mass = "0.02 kg"'), encoding="utf-8")
    elif case == "friction law":
        path = SAMPLES / "gear-hf" / "campaign.toml"
    else:
        path = synthesize_gear(tmp_path / "c", seed=11) / "campaign.toml"
    law = "lf" if case == "friction law" else None
    options = FitOptions(out=tmp_path / "fit", runs=1, quiet=True, check=False, trust=False)
    _, folder = fit_gear(path, options, surface=law)
    found = validate_fit(folder, path)
    assert found.flagged is (case != "right")
    if case == "right":
        # Noise and the uncertainty of the parameters.
        assert found.ratio < 1.2
    else:
        assert found.ratio > 1.5
        assert "× what noise alone costs" in found.reasons[0]


@pytest.mark.slow
def test_three_replications_hold_the_truth(tmp_path):
    from interval_coverage import replicate  # type: ignore[import-not-found]

    found = [one for seed in (1001, 1002, 1003) for one in replicate(seed, "lf", tmp_path)[1]]
    known = [one for one in found if one.name != "ground_damping"]
    # 21 intervals of 95 %, seven of each campaign correlated: fewer than 18 by chance in 1 %.
    assert sum(one.inside for one in known) >= 18
    assert all(one.beyond < 2.0 for one in known if one.verdict == "well")
    assert all(one.verdict == "not_identifiable" for one in found if one.name == "ground_damping")


def test_trust_tolerance_is_finer_than_the_fit():
    campaign = as_exact(read_campaign(LF, "gear"))
    drops = tuple(drop for drop in prepare_drops(campaign, LF) if drop.use == "fit")
    space = gear_space(campaign)
    exact = GearProblem(campaign, space, drops, None, 1e-6)
    point = _truth(exact)[None]
    best, _ = exact.residuals(point)
    errors = {}
    for tolerance in (TRUST_TOLERANCE, 3e-4):
        values, _ = GearProblem(campaign, space, drops, None, tolerance).residuals(point)
        errors[tolerance] = nrmse_of(exact.blocks, values[0] - best[0]).max()
    # An error of 1e-3 in NRMSE beside noise of 5e-2 to 2e-1 shifts a deviance of 1 by less than a tenth.
    assert errors[TRUST_TOLERANCE] < 1e-3
    assert errors[TRUST_TOLERANCE] < errors[3e-4]
