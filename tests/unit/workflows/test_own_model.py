"""A model of one's own: fits, judgements and commands, and what a function may do wrong."""

import inspect

import numpy as np
import pandas as pd
import pytest
from scipy.signal import StateSpace, lsim

import sysid
from sysid.workflows.kinds import open_campaign

TIME = np.arange(200) / 200
SIGMA = 0.01
PARAMETERS = {"rate": (0.1, 10.0, "1/s"), "start": (0.1, 5.0, "V")}
SMALL = {"runs": 1, "population": 16, "max_generations": 20}
SOURCE = """import numpy as np
import sysid
def simulate(values, time, trial):
    return values["start"] * np.exp(-values["rate"] * time)
sysid.model("decay_file", simulate, channels={"level": "V"},
            parameters={"rate": (0.1, 10.0, "1/s"), "start": (0.1, 5.0, "V")})
"""


def decay(values, time, trial):
    return values["start"] * np.exp(-values["rate"] * time)


def table(rate=3.0, seed=1, noise=SIGMA):
    level = 2.0 * np.exp(-rate * TIME) + noise * np.random.default_rng(seed).standard_normal(len(TIME))
    return pd.DataFrame({"level": level}, index=TIME)


def made(simulate=decay, **changed):
    given = {"parameters": PARAMETERS, "channels": {"level": "V"}} | changed
    return sysid.model("decay_tested", simulate, **given)


def campaign(simulate=decay, noise=None, **changed):
    return made(simulate, **changed).campaign({"a": table(), "b": table(seed=2)}, validate=["b"], noise=noise)


def test_the_true_model_is_explained_by_the_noise_that_its_logs_show():
    trials = campaign()
    assert set(trials.check().table.verdict) == {"well"}
    fit = sysid.fit_campaign(trials, **SMALL)
    assert fit.result.provenance["adequacy"]["verdict"] == "explained"
    assert fit.result.provenance["adequacy"]["channels"][0]["ratio"] == pytest.approx(1.0, abs=0.15)
    assert fit.table.loc["rate", "interval_low"] < 3.0 < fit.table.loc["rate", "interval_high"]
    assert sysid.validate(fit, trials).table.loc["b", "verdict"] == "within the noise"
    assert fit.sets.best["start"] == pytest.approx(2.0, rel=0.01)


def test_a_noise_that_is_not_known_judges_nothing_and_a_stated_one_counts():
    quiet = made().campaign({"a": table(noise=0.0).round(1)})
    assert quiet.check().table.empty
    assert "noise" in quiet.check().sentences[0]
    fit = sysid.fit_campaign(quiet, **SMALL)
    assert fit.verdict.startswith("not judged, NRMSE")
    assert "noise alone" not in fit.verdict
    assert fit.table.loc["rate", "interval_low"] < fit.table.loc["rate", "interval_high"]
    stated = made().campaign({"a": table(noise=0.0).round(1)}, noise={"level": "50 mV"})
    fit = sysid.fit_campaign(stated, trust=False, **SMALL)
    assert fit.result.provenance["adequacy"]["verdict"] == "explained"


def test_vectorized_and_one_by_one_are_the_same_numbers():
    rows = np.array([[3.0, 2.0], [1.0, 0.5], [9.0, 4.0]])
    problems = [
        kind.open(read, trials.path, 1)
        for flag in (False, True)
        for trials in [campaign(vectorized=flag)]
        for kind, read, _ in [open_campaign(trials.path)]
    ]
    one, many = (problem.predict(rows) for problem in problems)
    assert np.array_equal(one.by_channel, many.by_channel)
    alone = problems[0].predict(rows[1:2])
    assert np.array_equal(alone.by_channel[0], one.by_channel[1])


def test_each_trial_has_its_own_number_and_reads_its_inputs():
    def scaled(values, time, trial):
        return trial["gain"] * values["start"] * np.exp(-values["rate"] * (time + trial["lag"]))

    parameters = {"rate": (0.1, 10.0, "1/s"), "start": (0.1, 5.0, "V", "each trial")}
    owner = made(scaled, parameters=parameters, inputs={"gain": "1", "lag": "s"})
    half, full = table(), table(seed=2).assign(lag=0.0)
    inputs = {"half": {"gain": 0.5, "lag": "0 ms"}, "full": {"gain": 1}}
    fit = sysid.fit_campaign(
        owner.campaign({"half": half, "full": full}, inputs=inputs), trust=False, **SMALL
    )
    assert fit.sets.best["start[half]"] == pytest.approx(4.0, rel=0.02)
    assert fit.sets.best["start[full]"] == pytest.approx(2.0, rel=0.02)
    # A bare number has no unit: 0 ms might as well be 0 s, and 35 be degrees.
    bare = {"half": {"gain": 0.5, "lag": 0.0}, "full": {"gain": 1}}
    with pytest.raises(sysid.SysidError, match=r"trial 'half': lag = 0\.0 has no unit; write '0\.0 s'"):
        owner.campaign({"half": half, "full": full}, inputs=bare)
    with pytest.raises(sysid.SysidError, match="trial 'half': no column for the input 'lag'; add the column"):
        owner.campaign({"half": half}, inputs={"half": {"gain": np.int64(1)}})
    with pytest.raises(sysid.SysidError, match="trial 'half': 'gian' is no input of"):
        owner.campaign({"half": half}, inputs={"half": {"gian": 1}})


def test_a_function_cannot_change_what_it_is_compared_with():
    def greedy(values, time, trial):
        time -= 0.1
        return decay(values, time, trial)

    with pytest.raises(sysid.SysidError, match="read-only"):
        sysid.fit_campaign(campaign(greedy), trust=False, **SMALL)


def test_a_campaign_is_replaced_only_with_force(tmp_path):
    owner = made()
    owner.campaign({"b": table()}, tmp_path / "bench")
    with pytest.raises(sysid.SysidError, match="exists already"):
        owner.campaign({"c": table()}, tmp_path / "bench")
    owner.campaign({"c": table()}, tmp_path / "bench", force=True)
    assert [file.name for file in sorted((tmp_path / "bench").glob("*.csv"))] == ["1-b.csv", "1-c.csv"]
    for noise in (0, -0.1, "-1 V"):
        with pytest.raises(sysid.SysidError, match="expected more than 0"):
            owner.campaign({"a": table()}, noise={"level": noise}).check()


def test_failures_are_counted_and_their_first_message_is_told():
    def fragile(values, time, trial):
        if values["rate"] > 6.0:
            raise ArithmeticError("too stiff")
        if values["start"] < 0.5:
            # As solve_ivp does where it gives up.
            return decay(values, time, trial)[:10]
        return decay(values, time, trial) + (np.nan if values["start"] > 4.0 else 0.0)

    fit = sysid.fit_campaign(campaign(fragile), trust=False, **SMALL)
    counts = fit.result.provenance["failures"]
    assert counts["simulate raised an exception"] > 0
    assert counts["simulate returned NaN or infinity"] > 0
    assert counts["simulate returned another shape"] > 0
    (told,) = (line for line in fit.warnings if "too stiff" in line)
    assert "ArithmeticError: too stiff, test_own_model.py line" in told
    assert fit.sets.best["rate"] == pytest.approx(3.0, rel=0.02)


def fit_a_quarter_car(trials):
    def simulate(values, time, trial):
        body, wheel = 300.0, 40.0
        spring, damper, tyre = values["spring"], values["damper"], values["tyre"]
        upper = [-spring / body, -damper / body, spring / body, damper / body]
        lower = [spring / wheel, damper / wheel, -(spring + tyre) / wheel, -damper / wheel]
        moved = [[0, 1, 0, 0], upper, [0, 0, 0, 1], lower]
        car = StateSpace(moved, [[0], [0], [0], [tyre / wheel]], np.eye(4)[[0, 2]], np.zeros((2, 1)))
        return lsim(car, trial["road"], time)[1]

    bounds = {"spring": (5e3, 5e4, "N/m"), "damper": (300, 5e3, "N*s/m"), "tyre": (5e4, 5e5, "N/m")}
    car = sysid.model(
        "quarter_car", simulate, parameters=bounds, channels={"body": "m", "wheel": "m"}, inputs={"road": "m"}
    )
    return sysid.fit_campaign(car.campaign(trials(simulate)), runs=1, population=16, trust=False)


def test_a_quarter_car_with_two_trials_takes_fifteen_lines():
    right = {"spring": 18e3, "damper": 1200.0, "tyre": 180e3}

    def driven(simulate):
        noise = np.random.default_rng(4)
        time, tables = np.arange(120) / 100, {}
        roads = {"kerb": 0.04 * (time > 0.3), "waves": 0.03 * np.sin(20 * time * time)}
        for name, road in roads.items():
            moved = simulate(right, time, {"road": road}) + 5e-4 * noise.standard_normal((120, 2))
            tables[name] = pd.DataFrame({"road": road, "body": moved[:, 0], "wheel": moved[:, 1]}, index=time)
        return tables

    fit = fit_a_quarter_car(driven)
    for name, value in right.items():
        # Noise of 0.5 mm beside 40 mm in 480 samples leaves 0.5 %.
        assert fit.sets.best[name] == pytest.approx(value, rel=0.01)
    assert fit.result.provenance["adequacy"]["verdict"] == "explained"
    lines = [line for line in inspect.getsource(fit_a_quarter_car).splitlines()[1:] if line.strip()]
    assert len(lines) <= 15


def endless(values, time, trial):
    while True:
        pass


@pytest.mark.parametrize(
    ("simulate", "words"),
    [
        (
            lambda v, t, trial: np.zeros((len(t), 2)),
            "returned another shape ((200, 2); expected (200, 1), which is (n, channels)) on a",
        ),
        (lambda v, t, trial: v["start"] * t * np.nan, "simulate returned NaN or infinity on a at rate"),
        (lambda v, t, trial: v["start"] * t, "no residual moves with rate; the simulation must read 'rate'"),
        (lambda v, t, trial: v["length"] * t, "raised an exception (KeyError: 'length', test_own_model.py"),
        (endless, "did not end in time (still ran after 0.2 s)"),
    ],
)
def test_a_function_that_cannot_be_fitted_is_refused_in_a_sentence(simulate, words):
    with pytest.raises(sysid.SysidError) as refusal:
        sysid.fit_campaign(campaign(simulate, patience=0.2), **SMALL)
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"parameters": {"rate": (0.1, 10, "1/min")}}, "'1/min' is no SI unit"),
        ({"parameters": {"rate": (0.1, 10)}}, "expected (lower, upper, 'unit')"),
        ({"parameters": {"rate": (10, 0.1, "1/s")}}, "lower bound 10 1/s is not below"),
        ({"parameters": {"rate": (1, 2, "1/s", "term")}}, "a term is absent at 0"),
        ({"parameters": {"rate": (1, 2, "blub")}}, "unknown unit 'blub'"),
        ({"channels": {"level": "mV"}}, "'mV' is no SI unit"),
        ({"simulate": 3}, "expected a function of values, time, trial"),
        ({"parameters": ["rate"]}, "parameters ['rate']: expected a mapping by name"),
        ({"parameters": {"rate": (1, np.inf, "1/s")}}, "expected (lower, upper, 'unit')"),
        ({"inputs": {"level": "V"}}, "'level' is a channel and an input"),
        ({"patience": 0}, "expected a time above 0"),
    ],
)
def test_what_declares_no_model_is_refused_in_a_sentence(changed, words):
    with pytest.raises(sysid.SysidError) as refusal:
        made(**changed)
    assert words in str(refusal.value)


def test_logs_that_lack_a_column_or_its_unit_are_refused(tmp_path):
    for text, words in (
        ("time [s],height [V]\n0,1\n1,2\n2,3\n", "no column 'level'"),
        ("time [s],level\n0,1\n1,2\n2,3\n", "states no unit"),
        ("time [s],level [m]\n0,1\n1,2\n2,3\n", "is not a 'V'"),
        ("time [s],level [V]\n0,1\n2,2\n1,3\n", "time does not increase"),
    ):
        (tmp_path / "log.csv").write_text(text, encoding="utf-8")
        with pytest.raises(sysid.SysidError, match=r"log\.csv") as refusal:
            made().campaign({"a": tmp_path / "log.csv"}, tmp_path / "campaign", force=True).check()
        assert words in str(refusal.value)


@pytest.mark.parametrize(
    ("frame", "given", "words"),
    [
        (
            table().rename(columns={"level": "levle [V]"}),
            {},
            "no column for the channel 'level'; found levle",
        ),
        (table(), {"noise": {"levle": "50 mV"}}, "noise: no channel 'levle'; decay_tested has level"),
        (table(), {"weights": {"levle": 2.0}}, "weights: no channel 'levle'; decay_tested has level"),
    ],
)
def test_a_misspelt_channel_is_refused_before_anything_is_written(frame, given, words, tmp_path):
    with pytest.raises(sysid.SysidError) as refusal:
        made().campaign({"b": table(), "a": frame}, tmp_path / "campaign", **given)
    assert words in str(refusal.value)
    assert list(tmp_path.iterdir()) == []


def test_an_installed_package_brings_its_kind(tmp_path, monkeypatch):
    package = tmp_path / "decays-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: decays\nVersion: 1.0\n", encoding="utf-8")
    (package / "entry_points.txt").write_text("[sysid.kinds]\ndecay_point = decays\n", encoding="utf-8")
    source = SOURCE.replace("decay_file", "decay_point")
    (tmp_path / "decays.py").write_text(source, encoding="utf-8")
    table().rename_axis("time [s]").rename(columns={"level": "level [V]"}).to_csv(tmp_path / "a.csv")
    text = 'kind = "decay_point"\nname = "d"\n[[trials]]\nname = "a"\nlog = "a.csv"\n'
    (tmp_path / "d.toml").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    assert set(sysid.Campaign.read(tmp_path / "d.toml").check().table.verdict) == {"well"}


def test_the_commands_take_a_file_with_a_model(tmp_path, run, refused, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "decay.py").write_text(SOURCE, encoding="utf-8")
    frame = table().rename_axis("time [s]").rename(columns={"level": "level [V]"})
    frame.to_csv(tmp_path / "a.csv")
    (tmp_path / "decay.toml").write_text(
        'kind = "decay_file"\nname = "d"\n[[trials]]\nname = "a"\nlog = "a.csv"\n', encoding="utf-8"
    )
    refused("--plugin names the Python file", "check", "decay.toml")
    small = ("--runs", "1", "--population", "16", "--max-generations", "9")
    code, out, _ = run("fit", "decay.toml", *small, "--plugin", "decay.py")
    assert code == 0
    # The commands that come next need the model too.
    after = out.partition("next:")[2].split("sysid ")[1:]
    assert len(after) == 3
    assert all("--plugin decay.py " in line for line in after)
    assert "rate" in run("show", "fits/d")[1]
    assert run("report", "fits/d", "--quiet")[0] == 0
    assert run("export", "fits/d", "--out", "d.csv")[0] == 0
    refused("no Python file", "check", "decay.toml", "--plugin", "none.py")
