"""What a log may be off by: starts from rest, command delay, tare, signs, volts; and the scale of R."""

import re
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fakes.motor_bench import bench_of, edited, held_out, problem_of, table_of, write_table
from sysid.errors import CampaignError, FitError, LogError
from sysid.fit.kind import Course
from sysid.fit.result import ranked_sets
from sysid.fit.search import run_one
from sysid.fit.settings import SearchSettings
from sysid.journal import Journal
from sysid.motor.dead_band import fit_saturation
from sysid.motor.follow_up import follow_up, log_delays
from sysid.motor.known_values import motor_space
from sysid.motor.log_delays import averaged
from sysid.motor.model import PARAMETERS, simulate, unpack
from sysid.parameter_sets import NOT_ALONE
from sysid.synthetic import read_truth
from sysid.synthetic.motor import TRUE_MOTOR, TrialPlan, synthesize_motor
from sysid.workflows.fit import fit_motor
from sysid.workflows.options import FitOptions
from sysid.workflows.show import print_sets

TRUTH = {**PARAMETERS.nominal, **TRUE_MOTOR}
# CMA-ES ends in the one optimum of these short logs; a default algorithm may change.
SEARCH = SearchSettings(32, 1, 1, algorithm="cmaes", finish="none")
SHORT = (
    TrialPlan("forward-1", "forward", "fit", 0.25, (0.62, 0.35, 0.80, 0.50, 0.95), 0.45, "csv"),
    TrialPlan("reverse-1", "reverse", "fit", -0.25, (-0.60, -0.35, -0.90), 0.45, "hdf5"),
    TrialPlan("forward-2", "forward", "validate", 0.30, (0.90, 0.45, 0.75), 0.45, "hdf5"),
)
REVERSAL = TrialPlan("reversal-1", "reversal", "fit", 0.30, (0.62, -1.0, 0.62, -0.5, 0.4, -0.8), 0.7, "hdf5")


def _synthesize(folder: Path, seed: int, trials=SHORT, **true: float) -> Path:
    return synthesize_motor(folder, seed=seed, trials=trials, parameters=true) / "campaign.toml"


def _dynamic_fit(campaign, bench):
    """Return the problem of all trials, the row (1, n) of its dynamic fit, and its values by name."""
    problem = problem_of(campaign, bench)
    space, best = problem.space, run_one(problem.fitted, SEARCH).best_point
    row = averaged(space, problem.complete(space.full(best)))
    return problem, row, unpack(row[0], space.table)


def _forward_log(path: Path):
    """Return the first forward log of a campaign, its header and its numbers."""
    log = path.with_name("forward-1.csv")
    return log, *table_of(log)


@pytest.mark.parametrize("reversal", [True, False])
def test_starts_from_rest_do_not_bias_the_winding(tmp_path: Path, reversal: bool) -> None:
    # A dead band that lasts 0.12 s where Table I's lasts 0.05 s. With the starts in the search, and Table I's
    # band, L comes out 29 % low and the delay 2.6 ms late.
    trials = (*SHORT[:2], REVERSAL) if reversal else SHORT[:2]
    path = _synthesize(tmp_path / "rest", 5, trials, saturation_current=0.25, saturation_speed=11.0)
    campaign, bench = bench_of(edited(path, (r"^start = .*\n", "")))
    for trial in bench.fitted:
        ((begin, end),) = trial.starts
        steps = trial.log.steps.time
        # From the first command, but for the filter's reach, to 0.4 s after the rotor has left the band.
        assert begin == pytest.approx(steps[1], abs=0.2)
        assert steps[1] + 0.5 < end < steps[1] + 1.0
    problem, rows, values = _dynamic_fit(campaign, bench)
    assert values["winding_resistance"] == pytest.approx(0.299, rel=0.03)  # required
    assert values["winding_inductance"] == pytest.approx(0.0038, rel=0.05)  # required
    assert values["command_delay"] == pytest.approx(0.008, abs=5e-4)  # a quarter of the compared grid
    band = fit_saturation(problem, rows, SEARCH, (1,))
    assert band is not None
    assert band.shown_by == ("reversals" if reversal else "starts_from_rest")
    current, speed = band.values[0, :2]
    assert speed / current == pytest.approx(11.0 / 0.25, rel=0.05)  # required
    assert band.nrmse[0] < 0.02 < 0.1 < band.without[0]
    if reversal:
        # The reversal's log has its own delay, which no forward log shows.
        assert band.values[0, 2] == pytest.approx(0.008, abs=5e-4)


def test_a_dead_band_that_no_log_feels_is_not_fitted(tmp_path: Path) -> None:
    path = _synthesize(tmp_path / "steady", 5, SHORT[:2])
    campaign, bench = bench_of(path)
    assert bench.banded == ()
    problem = problem_of(campaign, bench)
    row = np.array([[TRUTH.get(name, 0.008) for name in problem.space.table]])
    assert fit_saturation(problem, row, SEARCH, (1,)) is None
    # A start that a mask leaves no sample of shows nothing either.
    trial = replace(bench.fitted[0], starts=((0.0, 1e-3),))
    assert not trial.shows_start
    # One that leaves nothing else is searched whole.
    whole = replace(bench.fitted[0], starts=((0.0, 1e3),))
    assert whole.only_starts
    assert whole.dynamic_target is whole.target


def test_every_log_has_its_own_command_delay(tmp_path: Path) -> None:
    # The reverse log comes from an instrument that is 17 ms later.
    path = _synthesize(tmp_path / "one", 7)
    late = _synthesize(tmp_path / "late", 7, command_delay=0.025)
    shutil.copy(late.with_name("reverse-1.h5"), path.with_name("reverse-1.h5"))
    shutil.copy(late.with_name("forward-2.h5"), path.with_name("forward-2.h5"))
    campaign, bench = bench_of(path)
    every, rows, values = _dynamic_fit(campaign, bench)
    assert values["command_delay[forward-1.csv]"] == pytest.approx(0.008, abs=5e-4)
    assert values["command_delay[reverse-1.h5]"] == pytest.approx(0.025, abs=5e-4)
    assert values["command_delay"] == pytest.approx(0.0165, abs=5e-4)
    assert values["winding_inductance"] == pytest.approx(0.0038, rel=0.05)
    facts = {fact["log"]: fact for fact in log_delays(every, rows[0])}
    delay = pytest.approx(0.025, abs=5e-4)
    assert facts["reverse-1.h5"] == {"log": "reverse-1.h5", "delay": delay, "estimated": True}
    # A held-out log is scored with the mean; what it shows of its own is said beside.
    held_out = facts["forward-2.h5"]
    assert held_out["own_delay"] == pytest.approx(0.025, abs=5e-4)
    assert held_out["nrmse_with_own_delay"] < 0.01 < held_out["nrmse"]


def test_a_tare_without_rows_at_rest_is_estimated(tmp_path: Path) -> None:
    path = _synthesize(tmp_path / "tare", 3, SHORT[:2])
    log, header, table = _forward_log(path)
    start = float(re.search(r'start = "([\d.]+) s"', path.read_text(encoding="utf-8")).group(1))
    _, rested = bench_of(path)
    write_table(log, header, table[table[:, 0] > start - 0.3])
    # Without rows at rest an offset would pass as torque.
    with Journal() as journal:
        _, bench = bench_of(path)
    (finding,) = (finding for finding in journal.findings if finding.code == "no-row-at-rest")
    assert finding.trials == ("forward-1",)
    assert re.match(r"no row at rest: the tare of torque, .* ± .* mN·m.*record a second", finding.sentence)
    fact = next(t for t in read_truth(path.parent)["trials"] if t["name"] == "forward-1")
    tares = bench.trials[0].log.tares
    # 2000 rows of 1.5 mN·m per point, six points of which the slowest is at 260 rad/s: 0.1 mN·m.
    assert tares["torque"].value == pytest.approx(fact["tare_torque"], abs=3e-4)
    assert tares["thrust"].value == pytest.approx(fact["tare_force"], abs=0.02)
    assert tares["torque"].source == "steady_points"
    for name, off in (("torque", 3e-4), ("thrust", 0.02)):
        cut, whole = (b.trials[0].log.channels[name][1] for b in (bench, rested))
        # Taken off the channel, not only reported.
        assert np.mean(cut) == pytest.approx(np.mean(whole[-cut.size :]), abs=off)
    assert bench.trials[0].provenance["tare"]["torque"]["error"] > 0


def test_signs_of_torque_and_thrust_are_settled(tmp_path: Path) -> None:
    path = _synthesize(tmp_path / "signs", 4, SHORT[:2])
    log, header, table = _forward_log(path)
    _, plain = bench_of(path)
    columns = [i for i, name in enumerate(header.split(",")) if name.startswith(("Fz", "Mz"))]
    assert len(columns) == 2
    table[:, columns] *= -1.0
    write_table(log, header, table)
    _, bench = bench_of(path)
    turned, before = bench.trials[0].log, plain.trials[0].log
    assert turned.signs == {name: -sign for name, sign in before.signs.items()}
    for name in ("torque", "thrust"):
        # Written with nine digits.
        np.testing.assert_allclose(turned.channels[name][1], before.channels[name][1], rtol=1e-6, atol=1e-6)
    stated = "+" if turned.signs["thrust"] < 0 else "-"
    edited(path, (r"^\[curves\]", f'[log]\nthrust_sign = "{stated}"\n\n[curves]'))
    with pytest.raises(
        LogError, match=r"forward-1\.csv, trial 'forward-1': log\.thrust_sign = '.' gives .* mN"
    ):
        bench_of(path)


def test_a_logged_motor_current_fixes_the_scale(tmp_path: Path) -> None:
    path = _synthesize(tmp_path / "current", 6, SHORT[:1])
    log, header, table = _forward_log(path)
    steps = np.array(read_truth(path.parent)["trials"][0]["command_steps"])
    run = simulate(TRUTH, steps[:, 0], steps[:, 1], table[:, 0])
    noise = 0.05 * np.random.default_rng(0).standard_normal(len(table))
    wider = header + ",Motor current (A)"
    write_table(log, wider, np.column_stack([table, run.effective_current + noise + 0.2]))
    edited(path, (r"^kv = .*\n", ""), (r"^\[curves\]", '[log]\ncurrent = "motor"\n\n[curves]'))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        campaign, bench = bench_of(path)
    assert bench.scale_known
    # 0.2 A of zero offset is tared; 0.05 A of noise over 500 rows and more: 0.1 % of 2 to 10 A.
    assert bench.values["torque_constant"] == pytest.approx(0.00995, rel=5e-3)
    assert "logged motor current" in bench.measured["back_emf_constant"]
    # 2 mN·m of bearings and iron, which the current pays for and the load cell does not feel: 5 % of hover's
    # torque, and of k_m where it is not told apart. A second coefficient triples the error.
    paid = run.effective_current + noise + 0.002 / 0.00995 * (run.speed > 1.0)
    write_table(log, wider, np.column_stack([table, paid]))
    rubbed = bench_of(path)[1]
    assert rubbed.values["torque_constant"] == pytest.approx(0.00995, rel=0.015)
    assert re.search(r"less (1\.[5-9]|2(\.\d)?) mN·m of friction", rubbed.measured["torque_constant"])
    _, _, values = _dynamic_fit(campaign, bench)
    assert values["winding_resistance"] == pytest.approx(0.299, rel=0.03)
    assert values["winding_inductance"] == pytest.approx(0.0038, rel=0.05)
    edited(path, (r"^\[motor\]", '[motor]\nkv = "480 rpm/V"'))
    with pytest.warns(
        UserWarning, match=r"motor\.kv says 0\.01989 N·m/A, torque over the logged motor current 0\.0099"
    ):
        bench_of(path)
    write_table(log, header, table)
    with pytest.raises(LogError, match=r"forward-1\.csv, trial 'forward-1': .* has no current"):
        bench_of(path)


def test_without_a_scale_only_its_combinations_are_reported(tmp_path: Path, capsys) -> None:
    path = edited(_synthesize(tmp_path / "scale", 8, (*SHORT, REVERSAL)), (r"^kv = .*\n", ""))
    options = FitOptions(
        tmp_path / "fit", population=24, runs=2, max_generations=40, seed=1, quiet=True,
        algorithm="cmaes", finish="none", trust=False
    )  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        result, folder = fit_motor(path, options)
    values = result.parameter_sets().set_values(1)
    # 40 generations come near, not to, the optimum.
    assert values["k2_over_R"] == pytest.approx(0.00995**2 / 0.299, rel=0.05)
    assert values["R_over_L"] == pytest.approx(0.299 / 0.0038, rel=0.1)
    assert values["k_I_sat"] == pytest.approx(0.00995 * 0.35, rel=0.15)
    capsys.readouterr()
    print_sets(folder, json=False)
    shown = capsys.readouterr().out
    for text in (shown, (folder / "summary.txt").read_text(encoding="utf-8")):
        # Of a table that is folded the first part has the values.
        lines = {
            line.split(" ")[1 if line.startswith(" ") else 0]: line
            for line in reversed(text.splitlines())
            if line.strip()
        }
        for symbol in ("R", "L", "I_sat"):
            assert "not identifiable" in lines[symbol]
            # The fitted column stands before the measured one and the bounds.
            assert not re.search(r"\d\.\d", lines[symbol].split("]", 1)[1].split("—")[0])
        for symbol in ("k²/R", "R/L", "k·I_sat"):
            assert re.search(r"\d", lines[symbol].split("]", 1)[1])


@pytest.mark.parametrize(
    ("inductance", "useful"), [(1e-5, False), pytest.param(0.0038, True, marks=pytest.mark.slow)]
)
def test_l_pays_on_held_out_runs_only_where_it_is(tmp_path: Path, inductance: float, useful: bool) -> None:
    path = _synthesize(tmp_path / "simpler", 9, winding_inductance=inductance)
    found = held_out(problem_of(*bench_of(path)), TRUTH)
    lag, without, motor = (found[title] for title in ("first-order lag", "without L", "motor"))
    # The equations pay in torque whatever L is.
    assert without[0] < 0.7 * lag[0]
    assert (motor.mean() < 0.95 * without.mean()) == useful
    assert motor.mean() < 1.02 * without.mean() + 1e-4


def test_refusals_name_the_log_and_the_trial(tmp_path: Path) -> None:
    path = _synthesize(tmp_path / "refusals", 12, SHORT[:2])
    original = path.read_text(encoding="utf-8")
    log, header, table = _forward_log(path)
    names = header.split(",")
    torque, command = (next(i for i, n in enumerate(names) if n.startswith(s)) for s in ("Mz", "Command"))
    start = re.search(r'start = "([\d.]+) s"', original).group(1)
    end = f"{float(start) + 0.15:.4f}"
    # A window at one steady command, and a torque that never moves in it.
    dead = table.copy()
    dead[:, torque] = 0.01
    write_table(log, header, dead)
    campaign, bench = bench_of(path)
    with pytest.raises(FitError, match=r"trial 'forward-1' of forward-1\.csv, stator_torque: constant"):
        assert problem_of(campaign, bench, bench.fitted).cost
    write_table(log, header, table)
    # Static curves from the trial itself, whose commands change too fast for one steady segment.
    edited(
        path,
        (r"^static = \[(.|\n)*?^\]\n", ""),
        (rf'^start = "{start} s"', f'start = "{start} s"\nend = "{end} s"'),
    )
    with pytest.raises(
        (LogError, FitError), match=r"forward-1\.csv, trial 'forward-1'.*(no steady segment|at least 3)"
    ):
        bench_of(path)
    path.write_text(original, encoding="utf-8")
    blank = table.copy()
    blank[:, command] = np.nan
    write_table(log, header, blank)
    # The levels of the speed serve as steps, which says nothing of a reversal.
    with pytest.warns(match="no command is logged"):
        _, bench = bench_of(path)
    assert not bench.trials[0].log.commanded
    edited(path, (r'(log = "forward-1\.csv"\n)direction = "forward"', r'\1direction = "reversal"'))
    with pytest.raises(LogError, match=r"forward-1\.csv.*: has no command; a reversal trial needs"):
        bench_of(path)


def test_bounds_of_either_stage_do_not_hinder_the_other(tmp_path: Path) -> None:
    # The template states bounds of R; with a reversal to fit the second stage does not free R.
    path = _synthesize(tmp_path / "bounds", 13, (*SHORT[:1], REVERSAL))
    text = '[parameters.bounds]\nwinding_resistance = ["0.1 ohm", "1 ohm"]\n'
    text += 'saturation_speed = ["1 rad/s", "50 rad/s"]\n'
    campaign, bench = bench_of(edited(path, (r"^\[fit\]", text + "\n[fit]")))
    problem = problem_of(campaign, bench)
    assert (problem.space.free[0].lower, problem.space.free[0].upper) == (0.1, 1.0)
    row = np.array([[TRUTH.get(name, 0.008) for name in problem.space.table]])
    few = replace(SEARCH, max_generations=2)
    band = fit_saturation(problem, row, few, (1,))
    assert band is not None
    assert [(r.lower, r.upper) for r in band.free[1:2]] == [(1.0, 50.0)]
    edited(path, (r"^saturation_speed = .*$", 'rotor_inertia = ["1e-5 kg·m²", "1e-4 kg·m²"]'))
    campaign, bench = bench_of(path)
    with pytest.raises(CampaignError, match=r"parameters\.bounds\.rotor_inertia: the parameter is not free"):
        motor_space(campaign, bench)


@pytest.fixture(scope="module")
def forward(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One short forward trial, its static logs at 11.1 V and no words on V_ref."""
    path = _synthesize(tmp_path_factory.mktemp("doubts") / "motor", 3, SHORT[:1])
    return edited(path, (r"^reference_voltage = .*\n", ""))


def test_the_voltage_of_the_curves_serves_where_the_fitted_logs_hold_none(tmp_path: Path) -> None:
    path = _synthesize(tmp_path / "14.8 V", 3, SHORT[:1], reference_voltage=14.8)
    _, bench = bench_of(edited(path, (r"^reference_voltage = .*\n", "")))
    # The stand's supply begins 0.05 V above 14.8 V and sags by the current of full thrust, under 1 V.
    assert bench.values["reference_voltage"] == pytest.approx(14.8, rel=0.05)
    assert "logs under [curves]" in bench.stated["reference_voltage"]
    # The fitted log ran at V_ref, so its no-load line must be the true one; 25 % low beside 11.1 V.
    assert bench.values["no_load_slope_forward"] == pytest.approx(1030.0, rel=0.05)


def test_one_motor_constant_is_half_a_scale(forward: Path) -> None:
    half = '[parameters.fixed]\ntorque_constant = "0.00995 N·m/A"\n'
    both = half + 'back_emf_constant = "0.00995 V·s/rad"\n'
    for name, fixed, known in (("half.toml", half, False), ("both.toml", both, True)):
        path = edited(forward, (r"^kv = .*\n", ""), (r"^\[fit\]", f"{fixed}\n[fit]"), name=name)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            _, bench = bench_of(path)
        assert bench.scale_known is known
        assert any("determine only k²/R" in str(warning.message) for warning in caught) is not known


def test_a_trial_that_is_little_but_a_start_is_warned_of(forward: Path) -> None:
    read, bench = bench_of(forward)
    trial = bench.fitted[0]
    (begin, end) = trial.target.time[[0, -1]]
    short = replace(bench, trials=(replace(trial, starts=((begin, begin + 0.9 * (end - begin)),)),))
    assert short.fitted[0].only_starts
    with pytest.warns(
        UserWarning, match="forward-1: little but a start from rest, so R, L and the delay depend"
    ):
        motor_space(read, short)
    # A dead band that the campaign states stays, and there is nothing to warn of.
    given = {"saturation_current": "campaign", "saturation_speed": "campaign"}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        motor_space(read, replace(short, measured={**short.measured, **given}))
        motor_space(read, bench)


def test_an_interrupted_fit_says_what_it_has_not_looked_at(forward: Path) -> None:
    path = edited(forward, (r"^kv = .*\n", ""), name="guess.toml")
    with pytest.warns(UserWarning, match="determine only k²/R"):
        read, bench = bench_of(path)
    problem = problem_of(read, bench)
    run = run_one(problem.fitted, SearchSettings(8, 1, 1, 1, "cmaes", "none"))
    runs = (replace(run, stages=(replace(run.stages[-1], stop_reason="interrupted"),)),)
    with Journal() as journal:
        after = follow_up(problem, Course(ranked_sets(runs, problem.space), None, "interrupted", bool))
    # Torque and speed fix no R, L or I_sat alone, interrupted or not.
    assert {"winding_resistance", "winding_inductance", "saturation_current"} <= {*after.settings[NOT_ALONE]}
    (finding,) = (finding for finding in journal.findings if finding.code == "cut-short")
    assert "the dead band was not fitted" in finding.sentence
