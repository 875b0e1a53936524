"""A bench as a newcomer records it: logs begin at rest, no window is stated, the tachometer is noisy."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fakes.motor_bench import bench_of, edited, problem_of, table_of, write_table
from sysid.fit.adequacy import Adequacy, adequacy
from sysid.motor.log_delays import log_rows
from sysid.synthetic.motor import TRUE_MOTOR, TrialPlan, synthesize_motor
from sysid.trials.look import inspect_recording
from sysid.workflows.fit import fit_motor
from sysid.workflows.options import FitOptions

PLANS = (
    TrialPlan("forward-1", "forward", "fit", 0.25, (0.62, 0.35, 0.80, 0.50, 0.95), 0.5, "csv"),
    TrialPlan("forward-2", "forward", "fit", 0.30, (0.90, 0.45, 0.55, 0.75, 0.35), 0.5, "csv"),
    TrialPlan("reverse-1", "reverse", "fit", -0.25, (-0.60, -0.35, -0.80, -0.45, -0.95), 0.5, "csv"),
    TrialPlan("reverse-2", "reverse", "fit", -0.30, (-0.70, -0.40, -0.90, -0.50, -0.60), 0.5, "csv"),
)
# Noise of the tachometer, also at rest [rad/s].
NOISE = 1.0


@pytest.fixture(scope="module")
def campaign_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rests") / "motor"
    synthesize_motor(folder, seed=12, rate=2000.0, trials=PLANS)
    source = np.random.default_rng(5)
    for plan in PLANS:
        header, table = table_of(folder / f"{plan.name}.csv")
        still = table[:, 2] == 0
        # Half a second at rest; rounded to 0.01 rad/s, some of its samples are exactly 0.
        assert 900 < still.sum() < 1100
        table[still, 2] = np.round(NOISE * source.standard_normal(still.sum()), 2)
        write_table(folder / f"{plan.name}.csv", header, table)
    return edited(folder / "campaign.toml", (r"^start = .*\n", ""))


def test_a_noisy_rest_is_a_rest(campaign_file: Path) -> None:
    _, bench = bench_of(campaign_file)
    for trial in bench.trials:
        tare = trial.log.tares["torque"]
        assert tare.source == "rows_at_rest"
        # All but the tail of a normal distribution beyond five deviations.
        assert tare.rows > 900
        # The window begins at the command, not at the half second before it.
        assert trial.target.time[0] == pytest.approx(trial.log.steps.time[1], abs=5e-3)


def test_noise_is_that_of_a_turning_rotor(campaign_file: Path) -> None:
    problem = problem_of(*bench_of(campaign_file))
    (target, *_), half = problem.targets, len(problem.targets[0].time) // 2
    # A tachometer that sees nothing pass has no noise: counted, its zeros would be the median.
    still = np.concatenate([np.zeros((2 * half, 2)), target.measured])
    time = np.concatenate([target.time[0] - 4e-3 * np.arange(2 * half, 0, -1), target.time])
    rested = replace(target, time=time, measured=still, valid=np.ones(still.shape, dtype=bool))
    noise = replace(problem, targets=(rested, *problem.targets[1:])).noise
    np.testing.assert_allclose(noise, problem.noise, rtol=0.05)


def test_size_of_a_misfit_is_told_apart_from_its_significance(campaign_file: Path) -> None:
    campaign, bench = bench_of(campaign_file)
    problem = problem_of(campaign, bench).fitted
    truth = problem.complete(problem.space.full(np.full((1, len(problem.space.free)), 0.5)))[0]
    for name, value in TRUE_MOTOR.items():
        truth[problem.space.table.index[name]] = value
    truth[[problem.space.table.index[name] for name in log_rows(problem.space)]] = 0.008

    def judged(size: float) -> Adequacy:
        # A ripple that no parameter makes.
        ripple = [size * np.sqrt(2) * np.sin(20.0 * t.time)[:, None] * [0.0, 1.0] for t in problem.targets]
        moved = [replace(t, measured=t.measured + r) for t, r in zip(problem.targets, ripple, strict=True)]
        return adequacy(replace(problem, targets=tuple(moved)), truth)

    assert judged(0.0).verdict == "explained"
    # An rms of 1.2 rad/s is several noise deviations behind the filter, and 0.1 % of the top speed.
    small, large = judged(1.2), judged(12.0)
    assert small.misfit.channel_ratio > 1.5
    assert small.verdict == "roughly"
    assert small.sentence.startswith("explained but for 1.2 rad/s, 0.16 % of the largest speed: ")
    assert not small.symptoms
    assert large.verdict == "not_explained"
    assert not large.but_for


def test_signed_reverse_logs_are_not_suspicious(campaign_file: Path) -> None:
    _, bench = bench_of(campaign_file)
    for trial in bench.trials:
        found = {finding.code for finding in inspect_recording(trial.log.recording).suspicions}
        # The load cell has a tare, which nothing has subtracted.
        assert found <= {"no-tare"}


def test_a_right_fit_with_rests_is_explained(campaign_file: Path, tmp_path: Path) -> None:
    options = FitOptions(
        out=tmp_path / "fit", runs=1, population=40, max_generations=20, seed=4, quiet=True, trust=False
    )
    result, _ = fit_motor(campaign_file, options)
    judged = result.provenance["adequacy"]
    assert judged["verdict"] == "explained", judged["sentence"]
    values = result.parameter_sets().set_values(1)
    assert values["winding_resistance"] == pytest.approx(TRUE_MOTOR["winding_resistance"], rel=0.02)
    assert values["winding_inductance"] == pytest.approx(TRUE_MOTOR["winding_inductance"], rel=0.02)
