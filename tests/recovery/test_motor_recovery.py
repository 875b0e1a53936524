"""Known truth → synthetic bench logs → static curves, cost and fit of the motor."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from fakes.motor_bench import bench_of, edited, problem_of, score_values, table_of, with_trials, write_table
from sysid.errors import CampaignError, LogError, UnitError
from sysid.fit.optima import SAME_NRMSE
from sysid.loaders import load
from sysid.motor.dead_band import saturation_space
from sysid.motor.inertia import spike_inertia
from sysid.motor.known_values import in_search, motor_space
from sysid.motor.model import PARAMETERS, simulate
from sysid.synthetic import read_truth
from sysid.synthetic.motor import TRUE_MOTOR, synthesize_motor
from sysid.workflows.fit import fit_motor
from sysid.workflows.options import FitOptions
from sysid.workflows.show import print_sets, verdict_on

TRUTH = {**PARAMETERS.nominal, **TRUE_MOTOR}
# The paper's NRMSE of its motor fit on real logs: a bound that a synthetic fit must beat.
PAPER = 0.0267
# What synthesized campaigns state: 1/0.00995 V·s/rad.
KV = 'kv = "959.7283001 rpm/V"'


@pytest.fixture(scope="module")
def campaign_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench") / "motor"
    synthesize_motor(folder, seed=11)
    return folder / "campaign.toml"


@pytest.fixture(scope="module")
def prepared(campaign_file):
    return bench_of(campaign_file)


def test_static_curves_come_back(prepared) -> None:
    _, bench = prepared
    found = bench.curves.parameters
    for direction in ("forward", "reverse"):
        for quantity in ("thrust", "torque"):
            for speed in (300.0, 700.0):
                name = f"{quantity}_quadratic_{direction}"
                curve = (found[name] * speed + found[f"{quantity}_linear_{direction}"]) * speed
                # Noise of 4 mN and 0.1 mN·m per point of 21, against 0.6 N and 15 mN·m at 300 rad/s.
                assert curve == pytest.approx(TRUE_MOTOR[name] * speed**2, rel=0.02)
        # Speed noise of 0.2 rad/s over 1000 rad/s; the stand's torque bearing is the winding, k_d aside.
        assert found[f"no_load_slope_{direction}"] == pytest.approx(1030.0, rel=1e-3)
        assert abs(found[f"no_load_intercept_{direction}"]) < 1.0
    assert min(fit.r_squared for fit in bench.curves.fits) > 0.998  # the paper's


def test_truth_scores_the_noise(prepared) -> None:
    campaign, bench = prepared
    scored = score_values(campaign, bench, TRUTH)
    # Torque noise of 1.5 mN·m at 10 kHz keeps sqrt(60 Hz/5 kHz) = 0.11 of itself behind the filter: 0.16 mN·m
    # of 30 to 60 mN·m. Anything above that is our own filter, grid or clock.
    assert np.all(scored[:, 0] < 0.008)
    assert np.all(scored[:, 1] < 0.002)


def test_simulation_walks_the_way_of_the_log(prepared) -> None:
    # The filtered and compared simulation of the truth against the filtered log, in one trial: what is left
    # has no memory of the steps, so it must not grow where the torque moves fastest.
    problem = problem_of(*prepared)
    signals = problem.predict(np.array([[TRUTH[name] for name in PARAMETERS]])).signals
    measured = problem.trials[0].measured[:, 0]
    residual = signals[0][0, :, 0] - measured
    fast = np.abs(np.gradient(measured)) > np.quantile(np.abs(np.gradient(measured)), 0.95)
    # Equal but for chance (43 samples fix an rms to 11 %) and the 1 ms grid: under twice.
    assert np.sqrt(np.mean(residual[fast] ** 2)) < 2.0 * np.sqrt(np.mean(residual[~fast] ** 2))


def test_holes_of_a_fast_log_are_masked_not_closed_up(campaign_file: Path, prepared) -> None:
    # 30 ms of blank speed and 50 ms of missing rows; closing the hole up would shift what follows by 50 ms.
    _, whole = prepared
    header, table = table_of(campaign_file.with_name("forward-1.csv"))
    table[30_000:30_300, 2] = np.nan
    table = np.delete(table, np.s_[34_000:34_500], axis=0)
    write_table(campaign_file.with_name("holed.csv"), header, table)
    path = edited(campaign_file, ('log = "forward-1.csv"', 'log = "holed.csv"'), name="holed.toml")
    campaign, bench = bench_of(path)
    lost = whole.trials[0].target.valid.sum(axis=0) - bench.trials[0].target.valid.sum(axis=0)
    # One compared instant every 4 ms: 50 ms of torque; 80 ms of speed; a hole's edges cost one more each.
    assert 11 <= lost[0] <= 15
    assert 18 <= lost[1] <= 25
    # A straight line across a hole during a steady stretch adds nothing beyond the noise.
    assert np.all(score_values(campaign, bench, TRUTH)[0] < 0.01)


def test_short_fit_finds_resistance_and_inductance(campaign_file: Path, tmp_path: Path, capsys) -> None:
    options = FitOptions(
        out=tmp_path / "fit", runs=1, population=60, max_generations=25, seed=4, quiet=True, trust=False
    )
    result, folder = fit_motor(campaign_file, options)
    values = result.parameter_sets().set_values(1)
    # Required: 5 %. A population of 60 for 25 generations stops near, not at, the optimum.
    assert values["winding_resistance"] == pytest.approx(0.299, rel=0.05)
    assert values["winding_inductance"] == pytest.approx(0.0038, rel=0.05)
    assert values["command_delay"] == pytest.approx(0.008, abs=5e-4)  # a quarter of the compared grid
    assert result.nrmse[0] < PAPER
    assert result.mean_nrmse("validate")[0] < PAPER
    # The second stage: required 5 % for the ratio. What the paper's "hand" saw is the delay: required 5 ms.
    ratio = values["saturation_speed"] / values["saturation_current"]
    assert ratio == pytest.approx(6.3 / 0.35, rel=0.05)
    found = {name: values[name] for name in PARAMETERS}
    for before, after in ((0.62, -1.0), (0.4, -0.8), (-0.62, 0.8)):
        assert _delay(found, before, after) == pytest.approx(_delay(TRUTH, before, after), abs=5e-3)
    records = {record.name: record for record in result.parameters}
    assert records["saturation_current"].status == records["saturation_speed"].status == "free"
    assert "second stage: reversals of reversal-1" in records["saturation_speed"].source
    assert {t.name: t.use for t in result.trials}["reversal-2"] == "validate"
    stage = result.settings["saturation"]
    assert stage["trials"] == ["reversal-1"]
    # Without the dead band the model is early by some 60 ms at each of six reversals.
    assert stage["nrmse"][0] < 0.02 < 0.2 < stage["nrmse_without_saturation"][0]
    worst = max(abs(d["measured"] - d["simulated"]) for d in result.settings["reversal_delays"])
    assert worst < 8e-3  # 5 ms, and the noise of the thrust at 90 % of 1 N
    # k_d = 9.2e-9 drags by 5 µN·m beside 40 mN·m: any small value serves; without a bound none is printed.
    said = "viscous damping (k_d) was not assessed"
    assert any(one.startswith(said) and f"until sysid trust {folder} " in one for one in result.warnings)
    capsys.readouterr()
    print_sets(folder, json=False)
    shown, kept = capsys.readouterr().out, (folder / "summary.txt").read_text(encoding="utf-8")
    assert "; not assessed: viscous damping; " in verdict_on(result)
    # Ranked sets and means, in place of digits.
    assert shown.count("not assessed") == 2, shown
    assert "not assessed   viscous_damping\n" in kept


def _delay(parameters: dict, before: float, after: float) -> float:
    """Return the time from the command to 90 % of the final thrust [s]."""
    time = np.linspace(0.0, 1.0, 10_001)
    found = simulate(parameters, [0.0, 0.1], [before, after], time, initial="steady").thrust
    return float(time[np.argmax(found * np.sign(after) >= 0.9 * abs(found[-1]))]) - 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise", "algorithm", "population", "seed"),
    [(11, "ga", 200, 11), (21, "pso", 100, 2), (31, "cmaes", 64, 3)],
)
def test_full_fit_of_five_runs(
    tmp_path: Path, noise: int, algorithm: str, population: int, seed: int
) -> None:
    path = synthesize_motor(tmp_path / "bench", seed=noise) / "campaign.toml"
    options = FitOptions(
        tmp_path / "fit", runs=5, population=population, algorithm=algorithm, seed=seed,
        quiet=True, trust=False
    )  # fmt: skip
    result, _ = fit_motor(path, options)
    found = {name: result.values[:, i] for i, name in enumerate(r.name for r in result.parameters)}
    # Of every set, not of the best alone.
    np.testing.assert_allclose(found["winding_resistance"], 0.299, rtol=0.03)  # required
    np.testing.assert_allclose(found["winding_inductance"], 0.0038, rtol=0.05)  # required
    ratio = found["saturation_speed"] / found["saturation_current"]
    np.testing.assert_allclose(ratio, 6.3 / 0.35, rtol=0.05)  # required
    for rank in range(5):
        values = {name: float(found[name][rank]) for name in PARAMETERS}
        for before, after in ((0.62, -1.0), (-0.62, 0.8)):
            # Required: 5 ms.
            assert _delay(values, before, after) == pytest.approx(_delay(TRUTH, before, after), abs=5e-3)
    assert np.all(result.nrmse < PAPER)
    # Required: sets of one optimum agree within 1 % in every parameter that no warning doubts.
    # The dead band is found after the search: an optimum is that of both stages.
    doubts, banded = " ".join(result.warnings), np.array(result.settings["saturation"]["nrmse"])
    best = (result.nrmse <= (1 + SAME_NRMSE) * result.nrmse[0]) & (banded <= (1 + SAME_NRMSE) * banded.min())
    assert best.all(), (result.nrmse, banded)
    free = [record.name for record in result.parameters if record.status == "free"]
    held = {name: np.ptp(found[name]) / abs(found[name].mean()) for name in free if name not in doubts}
    assert {"winding_resistance", "winding_inductance"} <= {*held}
    assert max(held.values()) <= 0.01, held


def test_numbers_do_not_depend_on_threads(prepared) -> None:
    campaign, bench = prepared
    problem = problem_of(campaign, bench, bench.fitted)
    cube = np.random.default_rng(2).uniform(size=(6, len(problem.space.free)))
    single, double = (dataclasses.replace(problem, threads=count).evaluate(cube) for count in (1, 2))
    np.testing.assert_array_equal(single.cost, double.cost)
    assert problem.evaluate(cube[3:4]).cost[0] == single.cost[3]


def test_reversals_stay_out_of_the_dynamic_fit(prepared) -> None:
    _, bench = prepared
    assert {t.entry.name for t in bench.fitted} == {"forward-1", "reverse-1"}
    assert not any(in_search(t.entry) for t in bench.trials if t.entry.direction == "reversal")
    assert [t.entry.name for t in bench.banded] == ["reversal-1"]


def test_without_reversals_the_dead_band_is_not_fitted(campaign_file: Path, tmp_path: Path) -> None:
    path = with_trials(
        campaign_file, lambda t: "reversal" not in t and "forward-2" not in t, "no-reversal.toml"
    )
    options = FitOptions(
        tmp_path / "fit", population=12, runs=1, max_generations=2, quiet=True, finish="none", trust=False
    )
    result, _ = fit_motor(path, options)
    assert result.settings["saturation"]["fitted"] is False
    assert any("saturation_current and saturation_speed are not fitted" in s for s in result.warnings)
    records = {record.name: record for record in result.parameters}
    assert records["saturation_speed"].status == "fixed"


def test_freeing_the_dead_band_needs_a_reversal_to_fit(campaign_file: Path) -> None:
    free = '[parameters]\nfree = ["winding_resistance", "saturation_speed"]\n\n[fit]'
    path = with_trials(campaign_file, lambda t: "reversal" not in t, "freed.toml", (r"^\[fit\]", free))
    with pytest.raises(CampaignError, match="saturation_speed, but no reversal trial has use = 'fit'"):
        fit_motor(path, FitOptions(campaign_file.with_name("none"), quiet=True, trust=False))
    assert not campaign_file.with_name("none").exists()


def test_a_given_dead_band_stays(campaign_file: Path) -> None:
    given = KV + '\nsaturation_current = "0.35 A"\nsaturation_speed = "6.3 rad/s"'
    path = edited(campaign_file, (KV, given), name="given.toml")
    campaign, bench = bench_of(path)
    assert saturation_space(campaign, bench, PARAMETERS, PARAMETERS.nominal) is None
    campaign, bench = bench_of(edited(path, ('saturation_current = "0.35 A"', "")))
    space = saturation_space(campaign, bench, PARAMETERS, PARAMETERS.nominal)
    assert space.names == ("saturation_current",)
    assert space.fixed["saturation_speed"] == PARAMETERS.nominal["saturation_speed"]


def test_tares_of_the_truth_file(campaign_file: Path, prepared) -> None:
    facts = {trial["name"]: trial for trial in read_truth(campaign_file.parent)["trials"]}
    for trial in prepared[1].trials:
        # 5000 rows of 1.5 mN·m noise: 21 µN·m, three of them.
        truth = facts[trial.entry.name]["tare_torque"]
        assert trial.log.tares["torque"].value == pytest.approx(truth, abs=7e-5)


def test_without_a_log_without_propeller_the_no_load_line_follows_r(campaign_file: Path) -> None:
    campaign, bench = bench_of(edited(campaign_file, (r"^no_load = \[[^\]]*\]", ""), name="loaded.toml"))
    problem = problem_of(campaign, bench, bench.fitted)
    assert "viscous_damping" not in problem.space.names
    truth = np.array([[TRUTH[name] for name in PARAMETERS]])
    row = dict(zip(PARAMETERS, problem.complete(truth)[0], strict=True))
    for direction in ("forward", "reverse"):
        # Torque noise of 0.1 mN·m times R/k² = 3000 rad/s per N·m is 0.3 rad/s per point.
        assert row[f"no_load_slope_{direction}"] == pytest.approx(1030.0, rel=2e-3)
        assert abs(row[f"no_load_intercept_{direction}"]) < 2.0
    assert np.all(problem.score(truth).by_channel < 0.01)


@pytest.mark.parametrize(
    ("old", "new", "error", "words"),
    [
        ('direction = "reversal"', 'direction = "forward"', LogError, 'both ways .* direction = "reversal"'),
        (KV, 'kv = "960 rad/s/V"', CampaignError, r'1\.066e\+04 .* show 1030.*write kv = "960 rpm/V"'),
        (KV, 'kv = "100.53 rpm/V"', CampaignError, r'looks like rad/s/V: write kv = "100\.5 rad/s/V"'),
        (r"^\[curves\]", '[log]\ntorque_sign = "-"\n\n[curves]', LogError, r"'-' gives -.* mN·m at .*'\+'"),
        (r"^start = .*", 'start = "900 s"', LogError, "lies outside the log"),
        ("maximum = 2000", "maximum = 1900", LogError, "outside 1000 to 1900 us"),
    ],
)
def test_a_campaign_that_the_logs_contradict_is_refused(
    campaign_file: Path, old: str, new: str, error: type[Exception], words: str
) -> None:
    path = edited(campaign_file, (old, new), name="contradicted.toml")
    with pytest.raises(error, match=words):
        bench_of(path)


@pytest.mark.parametrize(
    ("kv", "words"),
    [
        ("", "determine only k²/R, R/L and k·I_sat"),
        ('kv = "2300 rpm/V"', "check kv and reference_voltage"),
        # The trials are explained with it as well, and R comes out a third too small.
        ('kv = "1150 rpm/V"', "the supply gave 9.2.* A, which allows 95.* rpm/V at most"),
    ],
)
def test_a_doubtful_kv_is_warned_of(campaign_file: Path, kv: str, words: str) -> None:
    path = edited(campaign_file, (KV, kv), name="doubtful.toml")
    with pytest.warns(UserWarning, match=words):
        bench_of(path)


def test_kv_in_si_is_the_same_motor(campaign_file: Path) -> None:
    _, bench = bench_of(edited(campaign_file, (KV, 'kv = "100.5025126 rad/s/V"'), name="si.toml"))
    assert bench.values["torque_constant"] == pytest.approx(0.00995, rel=1e-8)


def test_reversals_alone_are_refused(campaign_file: Path) -> None:
    path = with_trials(
        campaign_file, lambda t: "reversal" in t, "alone.toml", ('use = "validate"', 'use = "fit"')
    )
    with pytest.raises(CampaignError, match="reversals alone cannot serve"):
        bench_of(path)


def test_reversal_without_signed_speed_given_as_forward_is_refused_by_its_commands(campaign_file) -> None:
    recording = load(campaign_file.parent / "reversal-2.h5")
    time, step = recording["command"].time, slice(None, None, 20)
    columns = {name: recording[name].values for name in ("command", "speed", "thrust", "torque")}
    columns["speed"] = np.abs(columns["speed"])
    table = np.column_stack([time[step], *(values[step] for values in columns.values())])
    header = "Time (s),Command (µs),Speed (rad/s),Fz (N),Mz (N·m)"
    write_table(campaign_file.with_name("unsigned.csv"), header, table)
    pairs = (("reversal-2.h5", "unsigned.csv"), ('"reversal"', '"forward"'))
    path = with_trials(campaign_file, lambda t: "reversal-1" not in t, "unsigned.toml", *pairs)
    with pytest.raises(LogError, match=r"a forward trial whose commands run from u = -1 to 0\.8; set"):
        bench_of(path)


def test_freed_parameters_that_no_log_fixes_are_noticed(campaign_file: Path) -> None:
    def space(*names: str, edits: tuple = ()):
        free = "[parameters]\nfree = [" + ", ".join(f'"{name}"' for name in names) + "]\n\n[fit]"
        pairs = ((r"^\[fit\]", free), *edits)
        return motor_space(*bench_of(edited(campaign_file, *pairs, name="freed-more.toml")))

    with pytest.warns(UserWarning, match="torque_constant free with winding_resistance.* only k²/R, R/L"):
        space("winding_resistance", "torque_constant")
    with pytest.raises(CampaignError, match="thrust_quadratic_forward, on which neither torque nor speed"):
        space("winding_resistance", "thrust_quadratic_forward")
    assert space("winding_resistance", "rotor_inertia").names[:2] == ("winding_resistance", "rotor_inertia")
    # Table I's inertia is another rotor's.
    with pytest.warns(UserWarning, match="inertia is neither measured nor free, so Table I's"):
        space("winding_resistance", edits=((r"^rotor_inertia.*", ""),))


def test_pulse_widths_without_a_unit_are_refused(campaign_file: Path) -> None:
    text = (campaign_file.parent / "static-forward.csv").read_text(encoding="utf-8-sig")
    bare = campaign_file.with_name("unitless.csv")
    bare.write_text(text.replace("ESC signal (µs)", "ESC signal"), encoding="utf-8")
    path = edited(campaign_file, ("static-forward.csv", "unitless.csv"), name="unitless.toml")
    with pytest.raises(UnitError, match=r"states no unit and runs from 1500 to 2000.*log\.command_unit"):
        bench_of(path)
    _, bench = bench_of(edited(path, (r"^\[curves\]", '[log]\ncommand_unit = "us"\n\n[curves]')))
    assert bench.curves.fits[0].points > 10


def test_torque_spikes_show_the_inertia(prepared) -> None:
    campaign, bench = prepared
    found = spike_inertia(campaign, [t.log for t in bench.fitted], {**PARAMETERS.nominal, **bench.values})
    assert min(found.steps.values()) >= 6
    for kind in ("up", "down"):
        # Both sides pass one filter; the curve's error of up to 1 % of 40 mN·m remains.
        assert found.value[kind] == pytest.approx(2.7e-5, rel=0.02)
    assert found.doubt is None
    half = dataclasses.replace(found, value={"up": 2.7e-5, "down": 2.0e-5})
    assert "do not belong to one rotor" in half.doubt.sentence
    few = dataclasses.replace(found, steps={"up": 4, "down": 1})
    assert "4 up-steps and 1 down-steps are too few" in few.doubt.sentence
