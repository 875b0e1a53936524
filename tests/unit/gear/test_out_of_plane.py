"""Drops released with roll and yaw: their leans, what those cost, which drops are named."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sysid.campaign import read_campaign
from sysid.gear import model
from sysid.gear.out_of_plane import cost_of_lean, leans, limits, misfit_that_leans
from sysid.journal import Journal
from sysid.synthetic import DropPlan, read_truth, synthesize_gear
from sysid.workflows.kinds import find_kind

pytest.importorskip("mujoco", reason="drops in space run in another simulator, with the extra 'dev' only")

from fakes.spatial_gear import released
from spatial_drops import SPEEDS, compared, mean_nrmse

# Roll and yaw at the release [deg]: the yaw of the third leans its feet on 20 deg, the fourth leans nothing.
ATTITUDES = ((0.0, 1.0), (1.2, 1.0), (0.0, -2.5), (1.456, 4.0), (0.0, 1.0), (0.0, 1.0))
DROPS = ((10, 0.6), (15, 0.6), (20, 0.7), (20, 0.6), (25, 0.6), (12, 0.7))


def opened(path, **changes):
    """The problem of a campaign, and what was noticed."""
    text = path.read_text(encoding="utf-8")
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    path = path.with_name("changed.toml") if changes else path
    path.write_text(text, encoding="utf-8")
    with Journal() as journal:
        problem = find_kind("gear").open(read_campaign(path, "gear"), path, None)
        return problem, journal.findings


@pytest.fixture(scope="module")
def crooked(tmp_path_factory):
    attitudes = iter(np.radians(ATTITUDES))

    def simulate(*arguments, **law):
        roll, yaw = next(attitudes)
        return released(roll, yaw)(*arguments, **law)

    return synthesize_gear(
        tmp_path_factory.mktemp("crooked") / "drops",
        seed=5,
        drops=[DropPlan(math.radians(slope), speed) for slope, speed in DROPS],
        simulate=simulate,
        noise_position=0.15e-3,
        noise_angle=math.radians(0.1),
    ) / "campaign.toml"  # fmt: skip


def expected():
    """Leans of the drops [deg]: the angle between the body's lateral axis and the surface."""
    out = []
    for (slope, _), (roll, yaw) in zip(DROPS, ATTITUDES, strict=True):
        lateral = Rotation.from_euler("ZX", [yaw, roll], degrees=True).apply([0.0, 1.0, 0.0])
        normal = [math.sin(math.radians(slope)), 0.0, math.cos(math.radians(slope))]
        out.append(math.degrees(math.asin(lateral @ normal)))
    return out


def test_leans_are_measured_although_all_share_a_yaw_that_the_body_s_axes_hide(crooked):
    found = leans(opened(crooked)[0])
    measured = [math.degrees(lean.lean) for lean in found.values()]
    # The middle of the yaws is 1 deg and counts as none; on 25 deg that alone would be 0.42 deg of lean.
    np.testing.assert_allclose(measured, expected(), atol=0.2)


def test_the_capture_s_axes_tell_roll_and_yaw_where_the_campaign_says_so(crooked):
    problem, _ = opened(crooked, **{'level = "release"': 'level = "capture"'})
    # A magnet holds the drone level, the rigid body's axes are pitched by 0.6 deg.
    assert math.degrees(problem.drops[0].initial_state[2]) == pytest.approx(0.6, abs=0.06)
    for lean, (roll, yaw) in zip(leans(problem).values(), ATTITUDES, strict=True):
        # The rigid body's axes are rolled by -0.4 and yawed by 0.3 deg against the drone's.
        assert math.degrees(lean.roll) == pytest.approx(roll - 0.4, abs=0.06)
        assert math.degrees(lean.yaw) == pytest.approx(yaw + 0.3, abs=0.06)


def test_drops_that_lean_are_named_with_what_it_costs(crooked):
    problem, findings = opened(crooked)
    named = [finding for finding in findings if finding.code == "released-out-of-plane"]
    assert [name for finding in named for name in finding.trials] == ["drop-2", "drop-3", "drop-5"]
    found = leans(problem)
    sentence = named[0].sentence
    worst = max(
        (found[name] for name in ("drop-2", "drop-3", "drop-5")), key=lambda lean: lean.cost / lean.noise
    )
    assert f"about {100 * worst.cost:.0f} % NRMSE beside {100 * worst.noise:.1f} % of noise" in sentence
    assert "release it again" in sentence
    # A lean costs what it costs whatever the noise, and ten times the noise hides these.
    assert found["drop-2"].matters
    assert not replace(found["drop-2"], noise=10 * found["drop-2"].noise).matters


def test_the_misfit_is_named_as_roll_before_any_physics(crooked):
    problem, _ = opened(crooked)
    true = read_truth(crooked.parent)["parameters"]
    row = np.array([true.get(name, problem.space.table[name].nominal) for name in problem.space.table])
    finding = misfit_that_leans(problem, row)
    assert "release drop-2, drop-3, drop-5 again" in finding.sentence
    assert finding.code == "misfit-follows-roll"
    # Straight drops that miss as much for another reason.
    straight = problem.only(["drop-1", "drop-4", "drop-5", "drop-6"])
    stiff = row.copy()
    stiff[problem.space.table.index["leg_axial_stiffness"]] *= 1.3
    assert straight.score(stiff[None]).by_channel.mean() > 0.1
    assert misfit_that_leans(straight, stiff) is None


def test_drops_that_cannot_be_compared_have_no_lean(crooked):
    problem = opened(crooked)[0]
    assert leans(problem.only(["drop-2"])) == {}
    # Somebody defined the axes of the rigid body again before the last drop.
    again = Rotation.from_euler("XYZ", [20, 5, 70], degrees=True).as_matrix()
    last = problem.drops[-1]
    changed = replace(problem, drops=(*problem.drops[:-1], replace(last, attitude=last.attitude @ again)))
    found = leans(changed)
    assert list(found) == [drop.name for drop in problem.drops[:-1]]
    assert found["drop-2"].matters
    assert found["drop-3"].matters


def test_planar_drops_are_not_accused(tmp_path):
    # They swing by 0.4 deg after the contact, and hang straight.
    path = synthesize_gear(tmp_path / "drops", seed=1, drops=[DropPlan(0.1, 0.5), DropPlan(0.4, 0.6)])
    problem, findings = opened(path / "campaign.toml")
    assert [finding.code for finding in findings if "plane" in finding.code] == []
    assert max(abs(lean.lean) for lean in leans(problem).values()) < math.radians(0.05)


@pytest.mark.parametrize("law", ["lf", "hf"])
def test_the_table_of_spatial_drops(law):
    for slope in np.radians([0, 5, 12.5, 35, 50]):
        costs = [cost_of_lean(law, slope, lean) for lean in np.radians([0, 0.1, 0.5, 1, 2, 4, 8])]
        assert costs[0] == 0.0
        assert np.all(np.diff(costs[:-1]) >= 0)
        # The last lean of the table counts beyond it.
        assert costs[-1] == costs[-2] > 0.1
        assert cost_of_lean(law, slope, -0.01) == cost_of_lean(law, slope, 0.01)
    assert math.isnan(cost_of_lean("ice", 0.1, 0.1))


@pytest.mark.slow
def test_one_cell_of_the_table_is_that_of_a_drop_in_space():
    true, slope = dict(model.parameters_on("lf").nominal), math.radians(10)
    roll = math.asin(math.sin(math.radians(0.5)) / math.cos(slope))
    costs = [
        mean_nrmse(compared(true, "lf", slope, speed, roll), compared(true, "lf", slope, speed))
        for speed in SPEEDS["lf"]
    ]
    # Two decimals of a percent are written.
    assert np.median(costs) == pytest.approx(cost_of_lean("lf", slope, math.radians(0.5)), abs=1e-4)


def test_limits_are_the_roll_and_the_yaw_that_lean_the_feet_alike():
    assert limits(math.radians(0.5), math.radians(30)) == ("0.58", "1")
    assert limits(math.radians(0.5), 0.0) == ("0.5", "90")
    assert limits(math.inf, 0.3) == ("90", "90")


def test_a_drop_in_space_is_its_mirror_image_s():
    true, slope, start = (
        dict(model.parameters_on("lf").nominal),
        math.radians(15),
        np.array([0, 0.25, 0, 0, 0, 0]),
    )
    clock = np.arange(0, 0.35, 5e-3)
    runs = [
        released(side * 0.02, side * 0.05)(true, slope, start, clock, surface="lf", tolerance=0)
        for side in (1, -1)
    ]
    np.testing.assert_allclose(runs[0].state, runs[1].state, atol=1e-6)
    np.testing.assert_allclose(runs[0].pose[0], -runs[1].pose[0], atol=1e-6)
    # Free until the first foot touches, 0.1 s or more after the release: no moment, one g. Half a time step
    # of 0.1 ms at 1 m/s is 0.05 mm.
    free = clock < 0.1
    np.testing.assert_allclose(
        runs[0].state[free, 1], 0.25 - 0.5 * true["gravity"] * clock[free] ** 2, atol=1e-4
    )
    assert runs[0].pose[1][free].approx_equal(runs[0].pose[1][0], atol=1e-9).all()
    assert np.abs(runs[0].pose[0][-1]) > 1e-4
