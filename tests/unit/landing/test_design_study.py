"""Design studies: what is varied, what is counted, the file, the figure, the command."""

import json
import math

import numpy as np
import pytest

from fakes.landings import HF, MOTOR
from fakes.printed import printed
from fakes.published import table_1, table_2
from sysid.errors import CampaignError, ExportError
from sysid.landing.design_study import Change, DesignStudy, designs, find_changes, fleets_of, shares_of
from sysid.landing.drone import drones
from sysid.landing.maps import LandingWork
from sysid.landing.outcomes import Outcome, Rules
from sysid.landing.settings import StudySettings
from sysid.landing.store import read_study, write_study
from sysid.motor.pair_thrust import thrust_history
from sysid.report.design_figures import figure_design_study
from sysid.report.drawing import save_figure
from sysid.report.landing_tables import gains_table

FLEET = drones(table_2("hf"), table_1())


def test_changes_are_read_by_name_and_symbol():
    stiff, wide, later = find_changes("k_t=0.5:2:5, foot_dx=0.9:1.6:2,reversal_delay=0ms:200ms:3")
    assert (stiff.name, stiff.kind, stiff.values[2]) == ("leg_bending_stiffness", "gear", 1.0)
    np.testing.assert_allclose(stiff.values, [0.5, 0.5**0.5, 1, 2**0.5, 2], rtol=1e-9)
    assert (wide.name, wide.values) == ("foot_dx", (0.9, 1.6))
    assert later.values == (0.0, 0.1, 0.2)
    assert find_changes("saturation_current=1:3:2")[0].kind == "motor"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "nothing to vary"),
        ("stiffness=1:2:3", "no design parameter 'stiffness'"),
        ("k_t=1:2", "NAME=FIRST:LAST:COUNT"),
        ("k_t=1:2:99", "count of 1 to 41"),
        ("k_t=-1:2:3", "above 0"),
        ("k_t=1:2:3,k_t=2:3:2", "varied twice"),
        ("reversal_delay=0:200kg:3", "200kg"),
        ("k_t=nan:2:3", "finite"),
    ],
)
def test_refused_changes(text, words):
    with pytest.raises(CampaignError, match=words):
        find_changes(text)


def test_a_change_moves_its_number_alone():
    changes = find_changes("k_t=2:2:1,thrust_quadratic_reverse=0.5:0.5:1")
    points = designs(changes)
    np.testing.assert_array_equal(points, [[1, 1], [2, 1], [1, 0.5]])
    fleets = fleets_of(FLEET, changes, points)
    assert fleets[0][0] == FLEET[0]
    assert fleets[1][0].gear["leg_bending_stiffness"] == 2 * FLEET[0].gear["leg_bending_stiffness"]
    assert fleets[1][0].motor == FLEET[0].motor
    assert fleets[2][0].motor["thrust_quadratic_reverse"] == 0.31e-5
    assert {**fleets[1][0].gear, "leg_bending_stiffness": 3.44} == FLEET[0].gear
    with pytest.raises(CampaignError, match="above the joints"):
        find_changes("dz_f=0.1:1:2")[0].apply(FLEET[0], 0.1)


def reversal_time(drone):
    """From the command to 90 % of the final reverse thrust [s]."""
    history = thrust_history(drone.motor, [-1.0, 0.0], [0.62, -1.0], 1.5)
    time = np.linspace(0, 1.5, 15001)
    values = history(time)
    return time[np.argmax(values < 0.9 * values[-1])]


def test_an_added_reversal_delay_is_what_the_thrust_shows():
    (later,) = find_changes("reversal_delay=-30ms:150ms:3")
    base = reversal_time(FLEET[0])
    for value in later.values:
        # The pause ends a little later than the formula: drag grows on the way to the dead band's edge.
        added = reversal_time(later.apply(FLEET[0], value)) - base
        assert added == pytest.approx(value, abs=0.12 * abs(value) + 2e-3)
    with pytest.raises(CampaignError, match=r"pause for 0\.0488 s"):
        later.apply(FLEET[0], -0.05)


def study(landed, *, share=0.5, changes=None, points=None, together=False, lost=None):
    landed = np.asarray(landed, dtype=float)
    speeds = (0.5, 1.0)[: landed.shape[2]]
    settings = StudySettings((0.0, 10.0, 20.0, 30.0), speeds, share, together=together)
    changes = changes or (Change("leg_bending_stiffness", "k_t", "gear", (0.5, 2.0)),)
    points = np.array([[1.0], [0.5], [2.0]][: len(landed)]) if points is None else np.array(points)
    lost = np.zeros(len(landed), dtype=np.int64) if lost is None else np.array(lost)
    means = (landed < 0.5).astype(np.int8), landed / 2, landed
    # What does not land has flipped.
    shares = np.stack([landed, 0.0 * landed, 1.0 - landed, 0.0 * landed], axis=1)
    return DesignStudy("sets", "reverse", changes, settings, points, shares, lost, *means)


def test_largest_safe_slope_and_landable_width():
    # Up to 10 deg; a failure at 10 deg by chance; not even level ground.
    one = study(np.array([[1, 1, 0, 0], [1, 0.4, 1, 1], [0.4, 1, 1, 1]])[:, :, None])
    np.testing.assert_array_equal(one.steepest[:, 0], [10.0, 0.0, math.nan])
    np.testing.assert_allclose(one.landable[:, 0], [15.0, 24.0, 27.0])
    assert study(one.landed, share=0.4).steepest[1, 0] == 30.0
    (row,) = one.gains()
    assert (row["best"], row["worst"]) == ([2.0], [1.0])
    assert row["gain_deg"] == pytest.approx(12.0)


def test_the_change_that_buys_most_comes_first():
    changes = find_changes("k_t=2:2:1,b_t=2:2:1,dx_f=1.2:1.2:1")
    points = designs(changes)
    landed = np.zeros((4, 4, 1))
    for design, reach in enumerate([1, 2, 1, 4]):
        landed[design, :reach] = 1.0
    rows = study(landed, changes=changes, points=points).gains()
    assert [row["change"] for row in rows] == ["dx_f ×", "k_t ×", "b_t ×"]
    assert rows[0]["steepest_deg"] == [30.0]


def test_the_grids_edge_is_a_lower_bound():
    changes = find_changes("k_t=2:2:1,b_t=2:2:1")
    points = designs(changes)
    landed = np.zeros((3, 4, 2))
    landed[:, 0] = 1.0
    landed[1, :, 0] = 1.0  # safe up to the last slope, at 0.5 m/s alone
    one = study(landed, changes=changes, points=points)
    np.testing.assert_array_equal(one.at_edge, [[False, False], [True, False], [False, False]])
    stiff, damped = one.gains()
    assert stiff["at_edge"] == [True, False]
    assert damped["at_edge"] == [False, False]
    shown = printed(gains_table(one))
    assert shown.count("≥ 30") == 1
    assert "raise --slopes" in shown
    within = study(landed[:1].repeat(3, axis=0), changes=changes, points=points)
    shown = printed(gains_table(within))
    assert "≥" not in shown
    # The sets as they are may be cut off, too, where no change buys anything.
    base = study(np.ones((1, 4, 2)), changes=find_changes("k_t=1:1:1"))
    assert base.gains() == []
    assert "raise --slopes" in printed(gains_table(base))
    (triangles,) = (line for line in figure_design_study(one).axes[0].lines if line.get_marker() == "^")
    np.testing.assert_array_equal(triangles.get_xydata(), [[2.0, 30.0]])
    pair = find_changes("k_t=2:2:1,b_t=2:2:1")
    both = designs(pair, together=True)
    cut = np.zeros((4, 4, 1))
    cut[0] = 1.0
    panel = figure_design_study(study(cut, changes=pair, points=both, together=True)).axes[0]
    assert sorted(text.get_text() for text in panel.texts) == ["–", "–", "–", "≥30"]


def test_what_could_not_be_simulated_counts_nowhere():
    outcome = np.full((2, 4, 2, 1), Outcome.SHORT, dtype=np.int8)
    outcome[0, :2, 0, 0] = Outcome.LOST, Outcome.FLIPPED
    outcome[1, :, 1] = Outcome.LOST
    shares, lost = shares_of(outcome)
    # Of four landings one is lost, one flips and two land; where all are lost nothing is known to be safe.
    np.testing.assert_allclose(shares[:, 0, :, 0], [[2 / 3, 1.0], [1.0, 0.0]], rtol=1e-12)
    np.testing.assert_allclose(shares[:, Outcome.FLIPPED, :, 0], [[1 / 3, 0.0], [0.0, 0.0]], rtol=1e-12)
    assert lost.tolist() == [1, 4]


def test_the_file_reads_back(tmp_path):
    changes = find_changes("k_t=0.5:2:2,reversal_delay=0:0.1:2")
    points = designs(changes, together=True)
    assert [1.0, 0.0] in points.tolist()
    random = np.random.default_rng(1).random((len(points), 4, 2))
    one = study(random, changes=changes, points=points, together=True, lost=np.arange(len(points)))
    found, provenance = read_study(write_study(tmp_path / "s.h5", one, {"motor": "x"}))
    assert provenance == {"motor": "x"}
    assert (found.name, found.controller, found.changes) == (one.name, one.controller, one.changes)
    assert found.settings == one.settings
    np.testing.assert_array_equal(found.landed, one.landed)
    np.testing.assert_array_equal(found.steepest, one.steepest)
    for name in ("lost", "outcome", "distance", "time"):
        np.testing.assert_array_equal(getattr(found, name), getattr(one, name))
    (tmp_path / "cut.h5").write_bytes((tmp_path / "s.h5").read_bytes()[:900])
    with pytest.raises(ExportError, match="compute the study again"):
        read_study(tmp_path / "cut.h5")
    figure = figure_design_study(found)
    # A panel per speed, a number per cell, a frame around the sets as they are.
    panels = [axes for axes in figure.axes if axes.texts]
    assert len(panels) == 2
    assert len(panels[0].texts) == 9 - 3
    assert save_figure(figure, tmp_path / "s.png").stat().st_size > 5000


def test_curves_show_every_value():
    changes = find_changes("k_t=0.5:2:3,dx_f=0.8:1.4:3")
    points = designs(changes)
    one = study(np.ones((len(points), 4, 2)), changes=changes, points=points)
    panels = figure_design_study(one).axes
    # 1.06, the middle of 0.8 to 1.4, would be written over 1.
    assert panels[1].get_xticks().tolist() == [0.8, 1.0, 1.4]
    assert [panel.get_xlabel() for panel in panels] == ["k_t ×", "dx_f ×"]
    for c, panel in enumerate(panels):
        lines = [line for line in panel.lines if len(line.get_xdata()) > 2]
        # A line and dots per speed.
        assert len(lines) == 4
        np.testing.assert_allclose(lines[0].get_xdata(), changes[c].axis)


BASE = ("design-study", HF, "--motor", MOTOR, "--out", "s.h5")
SMALL = (*BASE, "--slopes", "10:30:10 deg", "--speeds", "0.4,0.8", "--vary", "dx_f=1.3:1.3:1")


def test_a_study_writes_its_file_and_figure(tmp_path, done, refused):
    document = json.loads(done(*SMALL, "--json")[0])
    assert document["changes"][0]["change"] == "dx_f ×"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["s.h5", "s.png"]
    refused("exists already", *SMALL)
    assert "dx_f" in done(*SMALL, "--force")[0]


def test_rules_are_options_of_a_study(tmp_path, done):
    late = (
        *BASE, "--vary", "k_t=1:1:1", "--slopes", "10,20 deg", "--speeds", "0.4",
        "--controller", "impulse:3,0.1",
    )  # fmt: skip
    rules = ("--short", 0.1, "--long", 2, "--rest-speed", 0.06, "--rest-turn", 0.3, "--rest-time", 0.1)
    done(*late, "--horizon", "3.5", *rules, "--flip-angle", "70 deg", "--quiet")
    found, _ = read_study(tmp_path / "s.h5")
    assert found.settings.rules == Rules(3.5, 0.1, 2.0, 0.06, 0.3, 0.1, math.radians(70.0))


def test_a_study_warns_of_lost_landings(monkeypatch, run):
    land = LandingWork.__call__

    def lose_the_first(work, rows):
        outcome, *others = land(work, rows)
        outcome[0] = Outcome.LOST
        return outcome, *others

    monkeypatch.setattr(LandingWork, "__call__", lose_the_first)
    code, out, err = run(*SMALL, "--json")
    assert code == 0
    assert "warning: 2 landings of 2 of 2 designs could not be simulated" in err
    assert json.loads(out)["lost"] == 2
