"""Candidates that describe no measured drop: recognized, penalized by degree, counted by cause."""

from dataclasses import replace

import numpy as np
import pytest

from fakes.gear_campaigns import EXACT, on_board, opened
from sysid import exact_json
from sysid.campaign import read_campaign
from sysid.errors import CampaignError
from sysid.fit.nrmse import FAILED_NRMSE
from sysid.fit.store import read_fit
from sysid.fit.trial import first_cause
from sysid.gear.model import SURFACES, pack
from sysid.gear.problem import CAUSES, GearProblem, gear_space
from sysid.journal import Journal
from sysid.synthetic import LF_DROPS, synthesize_gear
from sysid.workflows.fit import fit_gear
from sysid.workflows.options import FitOptions


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    drops = (LF_DROPS[1], LF_DROPS[5])  # 10 deg and 35 deg: the steep one slides
    return synthesize_gear(tmp_path_factory.mktemp("causes") / "lf", seed=3, drops=drops, **EXACT)


@pytest.fixture(scope="module")
def problem(folder):
    """Objective, and the truth's row of the table."""
    campaign, prepared, truth = opened(folder)
    return GearProblem(campaign, gear_space(campaign), prepared), pack(truth)


def cause(objective, row):
    scored = objective.judge_samples(*objective.simulate(row[None]))
    assert np.isfinite(scored.by_channel).all()
    code = first_cause(scored.cause, len(CAUSES))[0]
    return float(objective.cost.mean(scored.by_channel)[0]), "fine" if not code else CAUSES[code - 1]


def lifted(objective, *heights):
    """The same drops from higher up, each by its height [m]."""
    up = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    drops = tuple(
        replace(drop, initial_state=drop.initial_state + height * up)
        for drop, height in zip(objective.drops, heights, strict=True)
    )
    return replace(objective, drops=drops)


def changed(row, column, value):
    out = row.copy()
    out[column] = value
    return out


def test_a_drop_that_never_touches_is_penalized_by_its_height(problem):
    objective, row = problem
    judged = [cause(lifted(objective, height, height), row) for height in (5.0, 10.0)]
    assert [why for _, why in judged] == ["never_touched"] * 2
    # Finite, above what any simulation that touches scores, and graded.
    assert FAILED_NRMSE < judged[0][0] < judged[1][0]
    # What is missing, the whole window, is paid on top of how far away it is.
    high = lifted(objective, 5.0, 5.0)
    samples, result = high.simulate(row[None])
    raw = high.cost.mean(high.cost(samples, result.reached)[0])[0]
    assert judged[0][0] == pytest.approx(raw + FAILED_NRMSE, rel=1e-12)
    low, why = cause(lifted(objective, 0.2, 0.2), row)
    assert why == "fine"
    assert low < FAILED_NRMSE


def test_leaving_the_board_is_penalized_by_what_is_missing(problem):
    objective, row = problem
    boards = (0.05, 0.1, 0.2, 0.3, 5.0)
    judged = [cause(on_board(objective, board), row) for board in boards]
    assert [why for _, why in judged[:2]] == ["left_the_board"] * 2
    assert judged[-1] == cause(objective, row)
    assert judged[-1][1] == "fine"
    assert judged[-1][0] < 2e-3  # integration and quantization, as elsewhere in these tests
    costs = [cost for cost, _ in judged]
    # The sooner it leaves, the more it pays; who stays on is scored as ever.
    assert costs == sorted(costs, reverse=True)
    assert costs[0] > costs[1] > costs[-1]
    # Both drops reach the shortest board's end, and neither before its touchdown.
    assert costs[0] < FAILED_NRMSE + costs[-1]


def test_the_penalty_of_leaving_begins_at_nothing(problem):
    """A candidate beside the truth that crosses the board's end just before the window's end pays little."""
    objective, row = problem
    steep = objective.drops[1]
    along = steep.target.measured[:, :2] @ [np.cos(steep.slope), -np.sin(steep.slope)]
    touch = np.searchsorted(steep.time, steep.touchdown)
    way = along[-1] - along[touch]
    plain, _ = cause(objective, row)
    # Up to 5 % before the end of the measured way nothing is paid; 2 % more are some samples of the window.
    assert cause(on_board(objective, 0.97 * way), row) == (plain, "fine")
    cost, why = cause(on_board(objective, 0.92 * way), row)
    assert why == "left_the_board"
    assert plain < cost < plain + 0.1 * FAILED_NRMSE


def test_every_way_to_be_lost_is_told_apart(problem):
    objective, row = problem
    assert cause(objective, changed(row, 8, 5.0))[1] == "diverged"
    assert cause(objective, changed(row, 12, 1e13))[1] == "too_expensive"
    cost, why = cause(objective, changed(row, 15, 0.0))
    assert why == "step_collapsed"
    # Lost before the first touchdown it pays for what it did not reach, once.
    assert FAILED_NRMSE < cost <= 2 * FAILED_NRMSE
    later, sooner = (cause(objective, changed(row, 8, k_h))[0] for k_h in (50.0, 5.0))
    # Both are lost, the softer legs earlier.
    assert FAILED_NRMSE / 2 < later < sooner < 2 * FAILED_NRMSE


def test_a_candidate_with_several_causes_is_counted_by_the_first(problem):
    objective, row = problem
    # The flat drop starts far too high, the steep one leaves a short board.
    drops = lifted(objective, 5.0, 0.0).drops
    for order in (drops, drops[::-1]):
        assert cause(on_board(replace(objective, drops=order), 0.05), row)[1] == "never_touched"


def lost(objective, rows):
    """What is noticed of lost sets."""
    with Journal() as journal:
        objective.results(rows)
    return [finding.sentence.split(";")[0] for finding in journal.findings]


def test_a_ranked_set_that_is_lost_on_a_drop_says_why(problem):
    objective, row = problem
    # The third set's legs are pushed through their joints; on a short board every set leaves it.
    rows = np.stack([row, row, changed(row, 8, 5.0)])
    both = ", ".join(objective.names)
    assert lost(objective, rows) == [f"set 3: diverged on {both}"]
    ways = ("set 1: left the board", "set 2: left the board", "set 3: diverged")
    assert lost(on_board(objective, 0.05), rows) == [f"{way} on {both}" for way in ways]
    assert lost(objective, rows[:2]) == []


def test_a_fit_counts_them_by_cause(folder, tmp_path):
    path = folder / "soft.toml"
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    text = text.replace('board_length = "1.2 m"', 'board_length = "0.25 m"')
    text += '\n[parameters.bounds]\nleg_axial_stiffness = ["5 N/m", "12000 N/m"]\n'
    path.write_text(text, encoding="utf-8")
    options = FitOptions(
        out=tmp_path / "fit", population=24, runs=1, max_generations=2, algorithm="ga", finish="none",
        quiet=True, trust=False
    )  # fmt: skip
    result, out = fit_gear(path, options)
    counts = result.runs[0].failures
    assert {"diverged", "left_the_board"} <= set(counts) <= set(CAUSES)
    assert sum(counts.values()) == result.runs[0].failed.sum()
    # The accuracy is kept beside what it led to.
    assert read_fit(out).settings["tolerance"] == SURFACES["lf"].tolerance
    # In text, numbers and JSON.
    assert read_fit(out).runs[0].failures == counts
    for code, count in counts.items():
        assert f"{count} {code.replace('_', ' ')}" in (out / "summary.txt").read_text(encoding="utf-8")
    document = exact_json.loads((out / "fit.json").read_text(encoding="utf-8"))
    assert document["provenance"]["failures"] == counts


def test_the_accuracy_of_a_simulation_is_the_campaigns(folder, problem):
    objective, row = problem
    assert objective.tolerance == SURFACES["lf"].tolerance
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    path = folder / "exact.toml"
    path.write_text(text.replace("[fit]\n", "[fit]\ntolerance = 1e-5\n"), encoding="utf-8")
    campaign = read_campaign(path, "gear")
    exact = GearProblem(campaign, gear_space(campaign), objective.drops)
    assert exact.tolerance == 1e-5
    # It reaches the kernel: 30 times the accuracy of a method of order 3 takes three times the work where
    # accuracy rules the steps, and none more where the slip's stability does.
    spent = [each.simulate(row[None])[1].rhs_evaluations.sum() for each in (objective, exact)]
    assert 1.5 < spent[1] / spent[0] < 4
    for wrong in ("0", "-1e-3", "0.5", '"fine"'):
        path.write_text(text.replace("[fit]\n", f"[fit]\ntolerance = {wrong}\n"), encoding="utf-8")
        with pytest.raises(CampaignError, match=r"fit\.tolerance"):
            read_campaign(path, "gear")
