"""What a motor fit makes of doubtful input, and says of it: a bad point, volts in some logs, half a scale."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fakes.motor_bench import bench_of, edited
from sysid.fit.problem import Course
from sysid.fit.result import ranked_sets
from sysid.fit.search import SearchSettings, run_one
from sysid.fit.stopping import StopRule
from sysid.journal import Journal
from sysid.motor.follow_up import curve_sentence, follow_up
from sysid.motor.inertia import SpikeInertia
from sysid.motor.known_values import search_space
from sysid.motor.problem import MotorProblem
from sysid.motor.static_curves import NoLoadTie
from sysid.parameter_sets import NOT_ALONE
from sysid.synthetic.motor import TrialPlan, synthesize_motor

TRIALS = (TrialPlan("forward-1", "forward", "fit", 0.25, (0.62, 0.35, 0.80), 0.45, "csv"),)
# R/(k_m k_v) of Table I [rad/s per N·m], its drag curve, and a no-load line.
DROP, DRAG, SLOPE, INTERCEPT = 0.299 / 0.00995**2, 1.65e-7, 973.0, 20.0


def _tie(bad: int | None, miss: float) -> NoLoadTie:
    """Return a tie of 12 loaded points with 0.5 rad/s of noise, one of them read `miss` times too fast."""
    u = np.linspace(0.2, 1.0, 12)
    omega_0 = SLOPE * u + INTERCEPT
    # Ω + DROP DRAG Ω² = Ω_0
    speed = (np.sqrt(1.0 + 4.0 * DROP * DRAG * omega_0) - 1.0) / (2.0 * DROP * DRAG)
    speed += np.random.default_rng(4).normal(0.0, 0.5, u.size)
    if bad is not None:
        speed[bad] *= miss
    return NoLoadTie(np.column_stack([u, np.ones(12)]), np.column_stack([speed, DRAG * speed**2]))


@pytest.mark.parametrize("bad", [None, 0, 6, 11])
@pytest.mark.parametrize("miss", [0.5, 12.0 / 14.0])
def test_one_bad_point_does_not_bend_the_no_load_line(bad: int | None, miss: float) -> None:
    tie = _tie(bad, miss)
    fit = tie.fit("forward", DROP, 0.0)
    # 12 points of 0.5 rad/s, lifted by 1 + 2 DROP DRAG Ω < 1.6: 0.8 rad/s over an rms distance of 0.25 in u
    # fixes the slope to 0.9 rad/s. A bad point pulls at most like one of the others at a few sigma.
    assert fit.coefficients[0] == pytest.approx(SLOPE, abs=5.0)
    assert fit.coefficients[1] == pytest.approx(INTERCEPT, abs=4.0)
    assert fit.outliers == (0 if bad is None else 1)
    assert fit.r_squared > 0.999
    # About the 0.9 rad/s of above, more where an end point is lost: it holds most of the slope.
    assert 0.4 < fit.standard_errors[0] < 3.0


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One short forward trial, its static logs at 11.1 V and no words on V_ref."""
    folder = synthesize_motor(tmp_path_factory.mktemp("doubts") / "motor", seed=3, trials=TRIALS)
    return edited(folder / "campaign.toml", (r"^reference_voltage = .*\n", ""))


def test_the_voltage_of_the_curves_serves_where_the_fitted_logs_hold_none(tmp_path: Path) -> None:
    true = {"reference_voltage": 14.8}
    path = synthesize_motor(tmp_path / "14.8 V", seed=3, trials=TRIALS, parameters=true)
    path = edited(path / "campaign.toml", (r"^reference_voltage = .*\n", ""))
    _, bench = bench_of(path)
    # The stand's supply begins 0.05 V above 14.8 V and sags by the current of full thrust, under 1 V.
    assert bench.values["reference_voltage"] == pytest.approx(14.8, rel=0.05)
    assert "logs under [curves]" in bench.stated["reference_voltage"]
    # The fitted log ran at V_ref, so its no-load line must be the true one; 25 % low beside 11.1 V.
    assert bench.values["no_load_slope_forward"] == pytest.approx(1030.0, rel=0.05)


def test_one_motor_constant_is_half_a_scale(campaign: Path) -> None:
    half = '[parameters.fixed]\ntorque_constant = "0.00995 N·m/A"\n'
    both = half + 'back_emf_constant = "0.00995 V·s/rad"\n'
    for name, fixed, known in (("half.toml", half, False), ("both.toml", both, True)):
        path = edited(campaign, (r"^kv = .*\n", ""), (r"^\[fit\]", f"{fixed}\n[fit]"), name=name)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            _, bench = bench_of(path)
        assert bench.scale_known is known
        assert any("determine only k²/R" in str(one.message) for one in said) is not known


def test_a_trial_that_is_little_but_a_start_is_warned_of(campaign: Path) -> None:
    read, bench = bench_of(campaign)
    trial = bench.fitted[0]
    (begin, end) = trial.target.time[[0, -1]]
    short = replace(bench, trials=(replace(trial, starts=((begin, begin + 0.9 * (end - begin)),)),))
    assert short.fitted[0].only_starts
    with pytest.warns(UserWarning, match="forward-1: little but a start from rest, so R, L and the"):
        search_space(read, short)
    # A dead band that the campaign states is held, and nothing is to be said.
    given = {"saturation_current": "campaign", "saturation_speed": "campaign"}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        search_space(read, replace(short, measured={**short.measured, **given}))
        search_space(read, bench)


def test_an_interrupted_fit_says_what_it_has_not_looked_at(campaign: Path) -> None:
    path = edited(campaign, (r"^kv = .*\n", ""), name="guess.toml")
    with pytest.warns(UserWarning, match="determine only k²/R"):
        read, bench = bench_of(path)
    space = search_space(read, bench)
    problem = MotorProblem.build(read, space, bench, bench.trials)
    run = run_one(problem.fitted, SearchSettings(8, 1, 1, StopRule(max_generations=1), "cmaes", "none"))
    runs = (replace(run, stages=(replace(run.stages[-1], stop_reason="interrupted"),)),)
    with Journal() as journal:
        after = follow_up(problem, Course(ranked_sets(runs, space), None, "interrupted", bool))
    # Torque and speed fix no R, L or I_sat alone, interrupted or not.
    assert {"winding_resistance", "winding_inductance", "saturation_current"} <= {*after.settings[NOT_ALONE]}
    (finding,) = (finding for finding in journal.findings if finding.code == "cut-short")
    assert "viscous_damping was not profiled" in finding.sentence


def test_a_static_curve_is_told_with_its_errors() -> None:
    sentence = curve_sentence(_tie(6, 0.5).fit("forward", DROP, 0.0))
    number = r"-?\d[\d.e+-]*"
    assert re.fullmatch(
        rf"no_load, forward: a = {number} ± {number} rad/s, b = {number} ± {number} rad/s; "
        r"R² 0\.99\d* over 12 points, 1 of them outliers",
        sentence,
    )


def test_too_few_torque_spikes_are_said() -> None:
    found = SpikeInertia(
        {"up": 2.7e-5, "down": float("nan")}, {"up": 1e-7, "down": 0.0}, {"up": 4, "down": 1}
    )
    assert found.doubt is not None
    assert "4 up-steps and 1 down-steps are too few" in found.doubt.sentence
