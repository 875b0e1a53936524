"""Values that a gear campaign states with errors: what moves, what that does to drops, what a pull costs."""

import math
import pickle
import re
import shutil

import numpy as np
import pytest
import tomlkit

from fakes.lab import misstated
from sysid.campaign import read_campaign
from sysid.errors import CampaignError
from sysid.gear.plausible import capture_frame
from sysid.gear.problem import gear_space
from sysid.gear.stated import places_apart, without_mistake
from sysid.gear.swaps import swaps
from sysid.journal import Journal
from sysid.synthetic import DropPlan, synthesize_gear
from sysid.workflows.kinds import find_kind, open_campaign

DROPS = tuple(DropPlan(math.radians(slope), 0.6) for slope in (10, 20, 30))


def opened(path, **exact):
    """The fitted drops of a campaign, as trust simulates them."""
    _, campaign, _ = open_campaign(path, "gear", law=exact)
    return find_kind("gear").open(campaign, path, 1).fitted.exact


@pytest.fixture(scope="module")
def exact(tmp_path_factory):
    return synthesize_gear(tmp_path_factory.mktemp("lab") / "drops", seed=3, drops=DROPS) / "campaign.toml"


@pytest.fixture(scope="module")
def stated(exact):
    return opened(misstated(exact, 0, name="stated.toml"))


def shifted(exact, name, **gross):
    """The drops of the campaign with some values stated elsewhere, by standard errors."""
    return opened(misstated(exact, 0, name=f"{name}.toml", gross=gross, written=False), exact=True)


def row_of(problem, **values):
    """The row of the true values of the campaign, and of some others."""
    space = problem.space
    row = problem.base.copy()
    for name, value in {**space.stated, **values}.items():
        row[space.table.index[name]] = value
    return row[None]


def test_what_is_stated_with_an_error_moves(stated, exact):
    space = stated.space
    assert [row.name for row in space.found] == [row.name for row in opened(exact).space.free]
    # Errors that nobody states are the typical ones, which the good lab has.
    assumed = opened(misstated(exact, 0, name="assumed.toml", written=False)).space.stated
    assert set(assumed) == set(space.stated)
    for name, value in assumed.items():
        assert (bool(value.assumed), space.stated[name].assumed) == (True, "")
        assert (value, value.error) == pytest.approx((space.stated[name], space.stated[name].error))
    assert set(space.stated) == {
        "body_mass", "body_inertia", "foot_dx", "foot_dz", "leg_mass", "leg_inertia", "kinetic_friction",
        "capture_tilt", "centre_of_mass_dx", "centre_of_mass_dz", "surface_dx", "surface_dz",
        *(f"slope[drop-{d}]" for d in (1, 2, 3)),
    }  # fmt: skip
    assert space.stated["slope[drop-2]"].error == pytest.approx(math.radians(0.2))
    assert space.stated["leg_inertia"].error == pytest.approx(2e-5)
    by_name = {row.name: row for row in space.free}
    # Twenty standard errors, and no mass below a twentieth of what is stated.
    assert by_name["foot_dz"].upper == pytest.approx(0.151 + 20e-3)
    assert by_name["leg_inertia"].lower == pytest.approx(1e-5)
    assert by_name["slope[drop-1]"].lower == pytest.approx(math.radians(6))


def test_the_papers_way_moves_nothing(exact):
    path = misstated(exact, 0, name="paper.toml")
    _, campaign, _ = open_campaign(path, "gear", law={"exact": True})
    assert not find_kind("gear").open(campaign, path, 1).space.stated


def test_a_space_keeps_what_is_stated_when_terms_are_freed_and_when_it_travels(stated):
    space = stated.space
    wider = space.freeing([space.table["pitch_drag"]])
    assert [row.name for row in wider.found] == [*(row.name for row in space.found), "pitch_drag"]
    assert wider.free[len(wider.found) :] == space.free[len(space.found) :]
    assert "pitch_drag" not in wider.fixed
    again = pickle.loads(pickle.dumps(wider))
    assert {name: value.error for name, value in again.stated.items()} == {
        name: value.error for name, value in space.stated.items()
    }


def test_a_pull_is_a_residual_and_costs_what_it_costs_a_likelihood(stated):
    space, stop = stated.space, stated.blocks[-1].stop
    at = np.array([space.table[name].nominal for name in space.names])
    at[len(space.found) :] = list(space.stated.values())
    point = space.encode(at)
    moved = at.copy()
    moved[space.names.index("slope[drop-3]")] += math.radians(0.5)
    moved[space.names.index("leg_mass")] -= 2e-3
    points = np.stack([point, space.encode(moved)])
    residuals, failed = stated.residuals(points)
    assert residuals.shape == (2, stop + len(space.stated))
    assert not failed.any()
    pulls = dict(zip(space.stated, residuals[1, stop:], strict=True))
    assert residuals[0, stop:] == pytest.approx(0.0, abs=1e-9)
    assert pulls.pop("slope[drop-3]") == pytest.approx(2.5)
    assert pulls.pop("leg_mass") == pytest.approx(-2.0)
    assert np.abs([*pulls.values()]).max() < 1e-9
    # N independent samples at noise s: -2 log L = N (rms/s)², whose rise by p² is that of the cost by p²/2N.
    nrmse = stated.cost.mean(stated.score(space.full(points)).by_channel)
    found = stated.evaluate(points).cost / nrmse
    assert found[0] == pytest.approx(1.0, abs=1e-12)
    assert found[1] == pytest.approx(math.exp((2.5**2 + 2.0**2) / (2 * stated.independent)))
    samples = sum(block.count for block in stated.blocks)
    assert samples / 50 < stated.independent < samples
    # What one standard error does to the residuals, for the interval's covariance.
    changes = stated.disturbances(point)[: len(space.stated)]
    assert np.array_equal(changes[:, stop:], np.eye(len(space.stated)))
    assert not changes[:, :stop].any()


def test_a_higher_surface_is_the_surface_stated_higher(stated, exact):
    # The capture's +y is up, and the plane of motion is its z and y.
    higher = shifted(exact, "higher", **{"point[1]": 1.0})
    signals = stated.predict(row_of(stated, surface_dz=1e-3)).signals
    expected = higher.predict(row_of(higher)).signals
    for d, (ours, theirs) in enumerate(zip(signals, expected, strict=True)):
        both, here, there = np.intersect1d(stated.drops[d].time, higher.drops[d].time, return_indices=True)
        assert len(both) > 100
        # A place relative to a plane that lies 1 mm higher is 1 mm less; rates and pitch are the same.
        difference = ours[0][here] - theirs[0][there]
        # The flight is fitted anew up to another touchdown, from a noisy log.
        assert np.abs(difference[:, 1] - 1e-3).max() < 2e-5
        assert np.abs(difference[:, 0]).max() < 2e-5
        assert np.abs(difference[:, 4]).max() < 1e-3
    moved = signals[0][0] - stated.predict(row_of(stated)).signals[0][0]
    assert np.abs(moved[:, 1]).max() > 5e-4


def test_another_centre_of_mass_is_the_centre_stated_there(stated, exact):
    # Of the body's axes the capture's -z points down-slope.
    other = shifted(exact, "other", **{"centre_of_mass_offset[1]": 2.0, "centre_of_mass_offset[2]": -3.0})
    centre = np.array([3e-3, 2e-3])
    row = row_of(stated, centre_of_mass_dx=centre[0], centre_of_mass_dz=centre[1])
    signals = stated.predict(row).signals
    expected = other.predict(row_of(other)).signals
    for d, (ours, theirs) in enumerate(zip(signals, expected, strict=True)):
        both, here, there = np.intersect1d(stated.drops[d].time, other.drops[d].time, return_indices=True)
        assert len(both) > 100
        pitch = theirs[0][there][:, 4]
        turn = np.array([[np.cos(pitch), np.sin(pitch)], [-np.sin(pitch), np.cos(pitch)]])
        way = np.einsum("ijn,j->ni", turn, centre)
        # The flights of two bodies are fitted anew from noisy logs, and bounces carry the difference on.
        error = np.abs(theirs[0][there][:, :2] - ours[0][here][:, :2] - way)
        assert error[:15].max() < 1.5e-4
        assert np.median(error, axis=0).max() < 2e-4


def test_a_steeper_slope_is_the_slope_stated_steeper(stated, exact):
    steeper = shifted(exact, "steeper", **{"slope[2]": 5.0})
    angle = math.radians(21)
    signals = stated.predict(row_of(stated, **{"slope[drop-2]": angle})).signals
    expected = steeper.predict(row_of(steeper)).signals
    for d, (ours, theirs) in enumerate(zip(signals, expected, strict=True)):
        both, here, there = np.intersect1d(stated.drops[d].time, steeper.drops[d].time, return_indices=True)
        assert len(both) > 100
        error = np.abs(ours[0][here] - theirs[0][there])
        assert error.max() < (5e-3 if d == 1 else 1e-9)
    assert np.abs(signals[1] - stated.predict(row_of(stated)).signals[1]).max() > 0.05


def test_a_drop_with_an_exact_point_does_not_follow_the_point_of_the_others(exact):
    path = misstated(exact, 0, name="own.toml")
    head, last = path.read_text(encoding="utf-8").rsplit("[[trials]]", 1)
    own = '[[trials]]\npoint = ["364 mm exact", "430.5 mm exact", "-812.5 mm exact"]'
    path.write_text(head + own + last, encoding="utf-8")
    problem = opened(path)
    assert "surface_dz" in problem.space.stated
    assert "surface_dz[drop-3]" not in problem.space.stated
    before, after = (problem.predict(row_of(problem, surface_dz=place)).signals for place in (0.0, 1e-3))
    moved = [np.abs(there - here).max() for here, there in zip(before, after, strict=True)]
    assert moved[0] > 5e-4
    assert moved[1] > 5e-4
    assert moved[2] == 0.0


@pytest.mark.parametrize("level", ["release", "capture"])
def test_a_capture_that_leans_is_the_tilt_stated_there(exact, level, tmp_path):
    folder = shutil.copytree(exact.parent, tmp_path / "drops")
    path = folder / "campaign.toml"
    text = path.read_text(encoding="utf-8").replace('level = "release"', f'level = "{level}"')
    path.write_text(text, encoding="utf-8")
    upright = opened(misstated(path, 0, name="stated.toml"))
    leaning = shifted(path, "leaning", tilt=5.0)
    tilt = math.radians(0.5)
    signals = upright.predict(row_of(upright, capture_tilt=tilt)).signals
    expected = leaning.predict(row_of(leaning)).signals
    for d, (ours, theirs) in enumerate(zip(signals, expected, strict=True)):
        both, here, there = np.intersect1d(upright.drops[d].time, leaning.drops[d].time, return_indices=True)
        assert len(both) > 100
        x, z = theirs[0][there][:, :2].T
        # The same drops, seen along axes that lean, and pitch from them where the hold is not its zero.
        seen = np.stack([x * np.cos(tilt) - z * np.sin(tilt), z * np.cos(tilt) + x * np.sin(tilt)], axis=1)
        error = np.abs(ours[0][here][:, :2] - seen)
        assert error[:15].max() < 2e-4
        assert np.median(error, axis=0).max() < 2e-4
        turned = 0.0 if upright.drops[d].levelled else tilt
        assert np.abs(ours[0][here][:15, 4] - theirs[0][there][:15, 4] + turned).max() < 1e-3
    moved = signals[0][0] - upright.predict(row_of(upright)).signals[0][0]
    assert np.abs(moved[:, 0]).max() > 2e-3


def test_board_markers_and_a_rest_log_state_height_and_slope(tmp_path):
    path = synthesize_gear(tmp_path / "drops", seed=3, drops=DROPS, plane="markers") / "campaign.toml"
    text = path.read_text(encoding="utf-8").replace("exact = true", "")
    own = re.sub(r'(?m)^(marker_height = "[^"]*)"', r'\1 ± 0.3 mm"', re.sub(r"(?m)^slope = .*\n", "", text))
    path.write_text(own, encoding="utf-8")
    problem = opened(path)
    stated = problem.space.stated
    assert (stated["surface_dz"], stated["surface_dz"].error) == (0.0, pytest.approx(0.3e-3))
    assert stated["slope[drop-2]"] == pytest.approx(math.radians(20), abs=math.radians(0.2))
    # The markers' own error, and that of the axes along which they show it.
    assert stated["slope[drop-2]"].error == pytest.approx(math.radians(0.1) * math.sqrt(2))
    moved = problem.predict(row_of(problem, surface_dz=1e-3)).signals[0][0]
    assert np.abs(moved - problem.predict(row_of(problem)).signals[0][0]).max() > 5e-4
    assert not opened(path, exact=True).space.stated
    # A body that rests shows the surface as exactly as its feet are known and its legs sag.
    text = re.sub(r"(?m)^marker_height = .*\n", "", re.sub("markers = .*", 'rest_log = "rest.csv"', text))
    path.write_text(text, encoding="utf-8")
    stated = gear_space(read_campaign(path, "gear")).stated
    assert stated["surface_dz"].error == pytest.approx(math.sqrt(2) * 1e-3)


@pytest.mark.parametrize("wrong", [{"slope[1]": -14.0}, {"tilt": 20.0}])
def test_a_wrong_slope_or_tilt_does_not_bend_how_a_drop_starts(tmp_path, wrong):
    high = (DropPlan(math.radians(15), 1.0),)
    path = synthesize_gear(tmp_path / "drop", seed=3, drops=high) / "campaign.toml"
    (right,), (other,) = opened(path).drops, shifted(path, "wrong", **wrong).drops
    # The log shows 35 ms of contact before this surface, or a fall that leans by 2 deg.
    assert abs(other.touchdown - right.touchdown) > 5e-3
    assert other.flight.start == pytest.approx(right.flight.start, abs=1e-3)
    assert other.flight.noise == pytest.approx(right.flight.noise, rel=0.2)
    # A magnet releases a body at rest.
    assert not other.flight.state[3:].any()


def test_a_mistake_moves_what_is_stated_unless_a_part_of_it_is_exact(exact, tmp_path):
    problem = opened(misstated(exact, 0, name="mistakes.toml"))
    moved = {
        swap.title: {name for name, value in space.stated.items() if value != problem.space.stated[name]}
        for swap, space in problem.mistakes
    }
    assert moved["the slopes (or the logs) of drop-1 and drop-2 exchanged"] == {
        "slope[drop-1]",
        "slope[drop-2]",
    }
    assert moved["foot_dx and foot_dz exchanged"] == {"foot_dx", "foot_dz"}
    assert moved["the other sign of y in centre_of_mass_offset"] == {"centre_of_mass_dz"}
    text = problem.campaign.source.text
    path = tmp_path / "drops.toml"
    path.write_text(re.sub(r'(?m)^(slope = "10) .*$', r'\1 deg exact"', text), encoding="utf-8")
    campaign = read_campaign(path, "gear")
    space = gear_space(campaign)
    assert "slope[drop-1]" not in space.stated
    for swap in swaps(campaign):
        if "slopes" in swap.title and "drop-1" in swap.title:
            assert without_mistake(space, campaign, swap) is space


def test_exchanged_logs_exchange_all_that_is_stated_of_their_drops(exact, tmp_path):
    head, *trials = exact.read_text(encoding="utf-8").split("[[trials]]")
    points = (f'point = ["364 mm", "{430 + k}.5 mm ± 1 mm", "-812.5 mm"]' for k in range(3))
    slopes = (re.sub(r'(?m)^(slope = "[^"]*) deg"', r'\1 ± 0.2 deg"', trial) for trial in trials)
    parts = (f"[[trials]]\n{point}{trial}" for point, trial in zip(points, slopes, strict=True))
    path = tmp_path / "drops.toml"
    path.write_text(head.replace("exact = true", "") + "".join(parts), encoding="utf-8")
    campaign = read_campaign(path, "gear")
    space = gear_space(campaign)
    (logs,) = (swap for swap in swaps(campaign) if swap.title == "the logs of drop-1 and drop-3 exchanged")
    right = without_mistake(space, campaign, logs).stated
    moved = {name: right[name] - space.stated[name] for name in right if right[name] != space.stated[name]}
    assert moved == pytest.approx({
        "slope[drop-1]": math.radians(20), "slope[drop-3]": -math.radians(20),
        "surface_dz[drop-1]": 2e-3, "surface_dz[drop-3]": -2e-3,
    })  # fmt: skip


def test_a_mistake_is_undone_in_the_text(exact, tmp_path):
    text = exact.read_text(encoding="utf-8").replace('"3 mm"]', '"+3 mm"]')
    path = tmp_path / "drops.toml"
    path.write_text(text, encoding="utf-8")
    campaign = read_campaign(path, "gear")
    (sign,) = (swap for swap in swaps(campaign) if swap.title.startswith("the other sign of z"))
    document = tomlkit.parse(text)
    sign.undo_in(document)
    assert tomlkit.dumps(document) == text.replace('"+3 mm"]', '"-3 mm"]')
    path.write_text(tomlkit.dumps(document), encoding="utf-8")
    assert read_campaign(path, "gear").capture.centre_of_mass_offset[2] == pytest.approx(-3e-3)


def test_a_capture_leans_along_the_way_down_of_the_campaign(exact, tmp_path):
    text = exact.read_text(encoding="utf-8")
    text = text.replace("level =", 'tilt = "2 deg"\nlevel =', 1)
    path = tmp_path / "drops.toml"
    path.write_text(text, encoding="utf-8")
    campaign = read_campaign(path, "gear")
    ups = []
    for way in ("-z", "+z", "+x"):
        trial = campaign.trials[0].model_copy(update={"down_slope": way})
        ups.append(capture_frame(campaign, trial).matrix[2])
    # One laboratory has one up, however a body slides.
    assert ups[1] == pytest.approx(ups[0])
    assert ups[2] == pytest.approx([0.0, 1.0, 0.0])
    path.write_text(text.replace('"2 deg"', '"95 deg"'), encoding="utf-8")
    with pytest.raises(CampaignError, match="a tilt of 95 deg is beyond 10 deg"):
        read_campaign(path, "gear")


def test_places_of_another_campaign_are_shifted_to_where_it_states_them(stated, exact):
    gross = {"point[1]": 3.0, "centre_of_mass_offset[2]": -4.0, "tilt": 2.0}
    other = opened(misstated(exact, 0, name="other-places.toml", gross=gross))
    moved = places_apart(other.campaign, stated.campaign)
    # Down-slope is -z of the capture.
    assert {name: value for name, value in moved.items() if value} == pytest.approx(
        {"surface_dz": 3e-3, "centre_of_mass_dx": 4e-3, "capture_tilt": math.radians(0.2)}
    )
    back = {name: -value for name, value in moved.items()}
    costs = [
        of.score(row).by_channel for of, row in ((stated, row_of(stated)), (other, row_of(other, **back)))
    ]
    assert costs[1].mean() == pytest.approx(costs[0].mean(), rel=0.05)
    assert other.score(row_of(other)).by_channel.mean() > 1.5 * costs[0].mean()


@pytest.mark.parametrize(
    ("drop", "told"),
    [
        ('point = ["364 mm", "430.5 mm", "-812.5 mm"]', "point 1 mm"),
        ('down_slope = "+z"', "centre_of_mass_offset, tilt and surface.point are taken as exact"),
    ],
)
def test_what_is_fitted_is_called_by_its_key(exact, tmp_path, drop, told):
    path = misstated(exact, 0, name="keys.toml", written=False)
    head, _, tail = path.read_text(encoding="utf-8").rpartition("[[trials]]")
    path.write_text(f"{head}[[trials]]\n{drop}{tail}", encoding="utf-8")
    problem = opened(path)
    said: list[str] = []
    with Journal(said.append):
        find_kind("gear").story(problem).tell_stated()
    assert any(told in sentence for sentence in said)
