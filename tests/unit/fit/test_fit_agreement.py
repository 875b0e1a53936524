"""What several runs say about each other, on made histories."""

import numpy as np
import pytest

from sysid.fit.history import RunHistory, StageHistory
from sysid.fit.optima import agreement, loose_findings, waterfall
from sysid.fit.result import SETS_KEPT, bound_findings, ranked_sets
from sysid.journal import folded
from sysid.parameter_sets import ParameterRecord
from sysid.parameters import Parameter, ParameterTable, SearchSpace


def run(cost, place, width=0.0, seed=1, loose=(0.0, 0.0), ended="converged"):
    """A run that closed in on `place`; along `loose` its candidates scored alike."""
    place = np.asarray(place, dtype=float)
    steps = np.array([0.3, 0.1, 0.01, 0.0])
    cube = np.stack([np.clip([place + step, place - step], 0, 1) for step in steps])
    cube[2] = place + np.array([loose, np.negative(loose)])
    costs = cost * (1 + np.stack([[step, step] for step in (0.5, 0.1, 0.001, 0.0)]))
    stage = StageHistory("ga", cube, costs, np.zeros(4, dtype=np.int64), 8, 48, 1.0, ended)
    return RunHistory(seed, (stage,))


def test_same_place_and_nrmse_is_one_optimum():
    runs = [run(0.0800, (0.2, 0.5)), run(0.08005, (0.21, 0.5)), run(0.0800, (0.2, 0.51))]
    found = agreement(runs)
    assert (found.reached, found.agrees) == (3, True)
    assert found.sentence() == "3 of 3 runs reached the same optimum (NRMSE 8.00 %)"


def test_worse_runs_are_said_to_be_local():
    runs = [run(0.10, (0.9, 0.5)), run(0.08, (0.2, 0.5)), run(0.11, (0.9, 0.9)), run(0.08, (0.2, 0.5))]
    found = agreement(runs)
    assert found.optimum.tolist() == [1, 0, 2, 0]
    assert found.order == (1, 3, 0, 2)
    text = found.sentence()
    assert text.startswith("the runs disagree: 2 of 4 reached the best optimum (NRMSE 8.00 %)")
    assert "1.250 to 1.375 × it in 2 other optima" in text
    assert "--runs 20" in text
    assert "1 of 3 alone reached" in agreement(runs[:3]).sentence()
    equal = agreement([run(0.08, (0.2, 0.5)), run(0.08, (0.8, 0.5))]).sentence()
    assert "the data prefer none of these sets" in equal
    assert "a single run cannot say" in agreement(runs[:1]).sentence()


@pytest.mark.parametrize(
    ("ended", "reason", "advice"),
    [
        ("interrupted", "stopped by the user", "continue with --resume"),
        ("time", "time limit", "continue with --resume"),
        ("evaluations", "evaluation budget", "start again with a larger limit"),
        ("generations", "generation limit", "start again with a larger limit"),
    ],
)
def test_where_a_run_was_cut_is_no_optimum(ended, reason, advice):
    best, worse = run(0.08, (0.2, 0.5)), run(0.10, (0.9, 0.5))
    cut = run(0.12, (0.9, 0.9), ended=ended)
    found = agreement([best, worse, cut])
    assert found.sentence() == (
        f"1 of 3 runs was not finished ({reason}) and says nothing about optima yet; best so far: NRMSE "
        f"8.00 %, the finished ones end at 1.000 to 1.250 × it; {advice}"
    )
    assert [line.split()[5] for line in waterfall([best, worse, cut])[1:]] == ["A", "B", "-"]
    # Neither one that agrees with the others nor one alone is finished.
    near = agreement([best, run(0.08, (0.2, 0.5), ended=ended)])
    assert not near.agrees
    assert agreement([cut]).sentence().startswith(f"1 of 1 runs was not finished ({reason})")
    assert "2 of 2 runs were not finished" in agreement([cut, cut]).sentence()


def test_runs_that_were_not_begun_are_missed():
    best, cut = run(0.08, (0.2, 0.5)), run(0.12, (0.9, 0.9), ended="interrupted")
    ends = "which says nothing about optima yet; best so far: NRMSE"
    stop, go_on = "(stopped by the user)", "; continue with --resume"
    assert agreement([cut, cut], 5).sentence() == (
        f"2 of 5 runs were begun, none of them finished {stop}, {ends} 12.00 %{go_on}"
    )
    tail = ", the finished ones end at 1.000 to 1.000 × it"
    assert agreement([best, cut], 5).sentence() == (
        f"2 of 5 runs were begun, 1 of them finished {stop}, {ends} 8.00 %{tail}{go_on}"
    )
    # Stopped between two runs: what was begun was finished, and the fit still is not.
    between = agreement([best, best], 5)
    assert between.sentence() == f"2 of 5 runs were begun, all of them finished, {ends} 8.00 %{tail}{go_on}"
    assert not between.agrees
    assert agreement([best, best], 2).agrees


def test_a_parameter_that_the_data_do_not_hold_does_not_tear_runs_apart():
    # Both searches saw candidates as good along 0.3 of the second axis.
    runs = [run(0.08, (0.2, 0.4), loose=(0.0, 0.3)), run(0.08, (0.2, 0.6), loose=(0.0, 0.3))]
    assert agreement(runs).agrees
    assert not agreement([run(0.08, (0.2, 0.4)), run(0.08, (0.2, 0.6))]).agrees


def space_of_two():
    rows = [Parameter(n, n, "N/m", 3.0, 1.0, 100.0, "log", "Test.", "guess") for n in ("a", "b")]
    return SearchSpace.build(ParameterTable(rows), ["a", "b"], {})


def test_what_sets_of_one_nrmse_spread_over_is_named():
    near, off = run(0.08, (0.2, 0.5)), run(0.08 * (1 + 1e-5), (0.2005, 0.51))
    (finding,) = loose_findings([near, off], space_of_two())
    # Along the cube's edge b grows a hundredfold: 0.01 of it are 4.7 %; 0.0005 of it are 0.2 % of a.
    assert (finding.code, finding.parameters) == ("weakly-identifiable", ("b",))
    assert finding.sentence.startswith(
        "identifiable no better than this, over sets that score within 0.003 %"
    )
    assert finding.sentence.endswith(" of it: b 4.6 %")
    # A run that ends in a neighbouring dent counts, as runs agree within 0.2 %. One that ends worse says
    # nothing, and one run alone does not know.
    (beside,) = loose_findings([near, run(0.08 * (1 + 1e-4), (0.2, 0.51))], space_of_two())
    assert beside.parameters == ("b",)
    assert loose_findings([near, run(0.08 * (1 + 3e-3), (0.2, 0.51))], space_of_two()) == ()
    assert loose_findings([near], space_of_two()) == ()
    # Neither does a run that was cut short.
    assert loose_findings([near, run(0.08, (0.2, 0.9), ended="time")], space_of_two()) == ()
    assert loose_findings([run(0.08, (0.2, 0.1), ended="generations")] * 2, space_of_two()) == ()


def test_beside_intervals_no_spread_is_named_but_what_is_open_still_is():
    near, off = run(0.08, (0.2, 0.5)), run(0.08 * (1 + 1e-5), (0.2005, 0.51))
    assert loose_findings([near, off], space_of_two(), ranges=False) == ()
    apart = [run(0.08, (0.2, 0.4)), run(0.08, (0.2, 0.7))]
    stated, bare = (loose_findings(apart, space_of_two(), ranges)[0] for ranges in (True, False))
    assert (stated.code, stated.parameters) == (bare.code, bare.parameters) == ("not-identifiable", ("b",))
    # 0.4 and 0.7 of the edge from 1 to 100.
    assert "sets from 6.3 to 25 N/m score within 0.2 %" in stated.sentence
    assert "sets far apart score within 0.2 %" in bare.sentence


def test_runs_that_differ_only_in_what_the_data_do_not_fix_share_an_optimum():
    # Both searches closed in tightly, far apart along b (0.3 of the edge: a factor of four), at one NRMSE.
    runs = [run(0.08, (0.2, 0.4)), run(0.08, (0.2, 0.7))]
    free = space_of_two().free
    assert not agreement(runs).agrees
    assert agreement(runs, free=free).agrees
    assert [line.split()[5] for line in waterfall(runs, free)[1:]] == ["A", "A"]
    # 0.1 of the edge is a factor of 1.6: the data may fix b, and the runs disagree about it.
    assert not agreement([run(0.08, (0.2, 0.4)), run(0.08, (0.2, 0.5))], free=free).agrees
    # What is open along b excuses neither another place along a nor another NRMSE.
    assert agreement([*runs, run(0.08, (0.3, 0.4))], free=free).optimum.tolist() == [0, 0, 1]
    assert agreement([*runs, run(0.081, (0.2, 0.4))], free=free).optimum.tolist() == [0, 0, 1]


def test_waterfall_lists_every_run_best_first():
    lines = waterfall([run(0.10, (0.9, 0.5)), run(0.08, (0.2, 0.5))])
    assert len(lines) == 3
    assert lines[1].split()[:6] == ["1", "2", "8.00", "%", "1.0000", "A"]
    assert lines[2].split()[:6] == ["2", "1", "10.00", "%", "1.2500", "B"]
    assert "NRMSE change below the tolerance" in lines[1]


def test_twenty_runs_keep_the_best_five_sets():
    runs = [run(0.08 + 0.001 * (i * 7 % 20), (0.2, 0.5), seed=i) for i in range(20)]
    ranked = ranked_sets(runs, space_of_two())
    assert len(ranked.cost) == SETS_KEPT == 5
    assert ranked.cost == pytest.approx([0.080, 0.081, 0.082, 0.083, 0.084], rel=1e-12)
    assert len(set(ranked.run)) == 5


def test_a_bound_that_many_trials_reach_is_one_line_for_each_parameter():
    rows = [Parameter(n, n, "s", 0.1, 0.0, 1.0, "linear", "Test.", "guess") for n in ("delay", "tare")]
    records = [ParameterRecord.of(row.of_trial(f"log-{i}"), "free") for row in rows for i in range(3)]
    findings = folded(bound_findings(records, np.array([[-1, -1, -1, 1, 1, 0], [0, -1, 0, 1, 1, 0]])))
    assert [(one.code, one.parameters, len(one.trials)) for one in findings] == [
        ("at-lower-bound", ("delay",), 3),
        ("at-upper-bound", ("tare",), 2),
    ]
    assert findings[0].sentence.startswith("2 of 2 sets end at the lower bound of delay, 0 s: ")
    assert findings[0].sentence.endswith(" (worst: log-1)")
