"""What `import sysid` offers: the examples of its documentation, results of a fit, and refusals."""

import dataclasses
import doctest
import inspect
import math
import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from threadpoolctl import threadpool_info

import sysid
from fakes.fits import full_fit
from fakes.lag_kind import TRUE, write_lag
from fakes.places import PUBLISHED, ROOT, SAMPLES
from sysid import api, api_landing, api_model, errors, marks, parameter_sets, testing
from sysid.gear import model as gear_model
from sysid.motor import model as motor_model
from sysid.workflows import options


@pytest.fixture(scope="module")
def lag(tmp_path_factory):
    """A campaign of the third kind and its fit, of which no folder is kept."""
    path = write_lag(tmp_path_factory.mktemp("lag"))
    return path, sysid.fit_campaign(sysid.Campaign.read(path))


@pytest.fixture(scope="module")
def gear():
    return sysid.load_parameter_sets(PUBLISHED / "published-gear-lf.json").best


@pytest.fixture(scope="module")
def motor():
    return sysid.load_parameter_sets(PUBLISHED / "published-motor.json").best


MOTOR_SETS = PUBLISHED / "published-motor.json"
NO_PATHS = [None, 5, b"drops", "a\0b", "a" * 5000, "", ["drops"], 1.5]


@pytest.mark.parametrize("given", NO_PATHS, ids=lambda given: repr(given)[:12])
def test_what_is_no_path_is_refused_by_every_verb(given):
    verbs = [sysid.load_log, sysid.inspect, sysid.load_fit, sysid.load_parameter_sets, sysid.Campaign.read]
    for verb in (*verbs, sysid.fit_gear, sysid.fit_motor):
        with pytest.raises(sysid.SysidError) as refusal:
            verb(given)
        assert len(str(refusal.value)) < 300
    if given is not None:
        with pytest.raises(sysid.SysidError):
            sysid.fit_gear(SAMPLES / "gear-lf", given)


def test_the_package_is_found_beside_a_clone_of_its_name(tmp_path):
    (tmp_path / "sysid").mkdir()
    command = [sys.executable, "-c", "import sysid; sysid.load_fit"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)


def test_numbers_and_exports_take_any_sets_and_masses_with_units(tmp_path):
    whole = sysid.load_parameter_sets(MOTOR_SETS)
    for sets in (whole, MOTOR_SETS, whole.best):
        assert "1.2 kg" in sysid.numbers_for(sets, "gazebo", mass="1200 g").check
    for mass in (-1, 0, math.nan, math.inf):
        with pytest.raises(sysid.SysidError, match=r"mass\b.*: expected a number( above 0, in kg| \[kg\])"):
            sysid.numbers_for(MOTOR_SETS, "gazebo", mass=mass)
        with pytest.raises(sysid.SysidError, match=r"mass\b.*: expected a number( above 0, in kg| \[kg\])"):
            whole.save(tmp_path / "m.sdf", rank=1, mass=mass)
    with pytest.raises(sysid.SysidError, match="found a int"):
        sysid.numbers_for(3, "gazebo")
    sysid.load_parameter_sets(PUBLISHED / "published-gear-lf.json").save(tmp_path / "g.xml", slope="20 deg")


def test_what_python_alone_can_state_wrongly_is_refused(gear, motor):
    campaign = SAMPLES / "gear-lf"
    for words, given in (
        ("law = 'hf': expected a mapping", {"law": "hf"}),
        ("time_limit = 0: expected a time above 0", {"time_limit": 0}),
        ("no folder was kept to go on with", {"resume": True}),
    ):
        with pytest.raises(sysid.SysidError, match=words):
            sysid.fit_campaign(campaign, **given)
    grid = {"slopes": [0, 10], "speeds": [0.5], "check": False}
    with pytest.raises(sysid.SysidError, match="pair = 'foo': expected 'best' or 'each'"):
        sysid.landing_map(gear, motor, pair="foo", **grid)
    with pytest.raises(sysid.SysidError, match="these maps have no impulses"):
        sysid.landing_map(gear, motor, **grid).plot_impulse()


def test_what_is_no_rank_no_kind_and_no_number_is_refused(gear):
    for rank in (None, 1.5, "1", 0, 10**400):
        with pytest.raises(sysid.SysidError, match="no set of rank"):
            gear.sets.set_values(rank)
    with pytest.raises(sysid.SysidError, match="expected the name of a parameter, found 3"):
        gear.sets[3]
    for slope in (10**400, -(10**400), math.inf, math.nan, True, None):
        with pytest.raises(sysid.SysidError, match="slope"):
            sysid.simulate_drop(gear, slope=slope, speed="0.5 m/s")


def test_options_of_another_kind_are_refused_in_a_short_sentence(gear, motor):
    log, campaign = SAMPLES / "motor" / "forward-1.csv", SAMPLES / "gear-lf"
    gears, motors = [PUBLISHED / "published-gear-lf.json"], PUBLISHED / "published-motor.json"
    for call, words in (
        (lambda: sysid.load_log(log, format=[]), "format = [] is no text"),
        (lambda: sysid.load_log(log, rate=10**400), "is no sample rate"),
        (lambda: sysid.load_log(log, time_back=np.arange(2)), "time_back = array"),
        (lambda: sysid.load_log(log, rate="a" * 5000), "rate = 'aaa"),
        (lambda: sysid.fit_gear(campaign, population=10**9), "expected at most 10000"),
        (lambda: sysid.fit_gear(campaign, runs=10**9), "expected at most 1000"),
        (lambda: sysid.Campaign.read(campaign).check(threads="2"), "threads = '2'"),
        (lambda: sysid.landing_map(gears, motors, slopes=5), "slopes 5: expected a text"),
        (lambda: sysid.landing_map(gears, motors, slopes=[5, 5]), "expected first:last:step or increasing"),
        (lambda: sysid.landing_map([], motors), "gears: expected a list of one or more"),
        (lambda: sysid.landing_map(gears, motors, controllers=3), "controllers: expected a list"),
        (lambda: sysid.simulate_landing(gear, motor, 0.1, 0.5, ideal_reversal="no"), "true or false"),
        (lambda: sysid.simulate_landing(gear, motor, 0.1, 0.5, controller_file="a" * 5000), "is no path"),
    ):
        with pytest.raises(sysid.SysidError) as refusal:
            call()
        assert words in str(refusal.value)
        assert len(str(refusal.value)) < 1500


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("module", [api, api_landing, api_model, errors, parameter_sets, testing])
def test_every_example_of_the_documentation_runs(tmp_path, monkeypatch, module):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data_samples").symlink_to(SAMPLES)
    names, flags = {"__name__": "example"}, doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    result = doctest.testmod(module, globs=names, optionflags=flags)
    assert result.attempted > 1
    assert result.failed == 0


def test_what_is_offered_is_listed_documented_and_shown():
    offered = [name for name in dir(sysid) if not name.startswith("_")]
    assert len(dir(sysid)) <= 35
    assert {"load_log", "Campaign", "fit_gear", "validate", "explain", "SysidError"} <= {*offered}
    documents = {name: getattr(sysid, name).__doc__ for name in offered}
    assert all(documents.values())
    examples = "".join(map(str, documents.values()))
    assert [name for name in offered if f"sysid.{name}" not in examples] == []
    with pytest.raises(AttributeError, match="no attribute 'fit_gears'"):
        _ = sysid.fit_gears


def members(offered):
    """Yield functions that a public name is or has, with their names."""
    if not inspect.isclass(offered):
        yield offered.__name__, offered
        return
    for name, member in inspect.getmembers(offered):
        made = member.fget if isinstance(member, property) else member
        if not name.startswith("_") and (inspect.isfunction(made) or inspect.ismethod(made)):
            yield f"{offered.__name__}.{name}", made


def test_no_public_name_returns_any():
    offered = [getattr(sysid, name) for name in dir(sysid) if not name.startswith("_")]
    returned = {
        name: str(inspect.signature(made).return_annotation)
        for one in (*offered, testing.check_kind)
        for name, made in members(one)
    }
    assert len(returned) > 40
    assert [name for name, what in returned.items() if re.search(r"\bAny\b|_empty", what)] == []


@pytest.mark.slow
def test_a_users_script_with_every_public_name_is_typed():
    script = ROOT / "tests" / "fakes" / "typed_script.py"
    text = script.read_text(encoding="utf-8")
    assert [name for name in dir(sysid) if f"sysid.{name}" not in text] == []
    assert (ROOT / "sysid" / "py.typed").is_file()
    mypy = [sys.executable, "-m", "mypy", "--strict", str(script)]
    done = subprocess.run(mypy, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


# What a command asks and Python does not: where results are printed and written.
PRINTED = {"quiet", "json", "out", "figure", "resume", "dask", "experiments"}
# Python's name of an option.
RENAMED = {"slopes_deg": "slopes", "spread_deg": "spread", "sets": "gears"}
SIGNATURES = [
    (sysid.fit_campaign, options.FitOptions, {"quiet", "details"}),
    (sysid.fit_gear, options.FitOptions, {"quiet", "details"}),
    (sysid.fit_motor, options.FitOptions, {"quiet", "details"}),
    (sysid.Fit.trust, options.TrustOptions, set()),
    (sysid.Fit.report, options.ReportOptions, set()),
    (sysid.cross_validate, options.TrustOptions, {"resamples", "seed"}),
    (sysid.explain, options.TrustOptions, {"resamples", "seed", "dask"}),
    (sysid.simulate_drop, options.TouchdownOptions, {"controller", "controller_file", "trigger", "height"}),
    (sysid.simulate_landing, options.TouchdownOptions, set()),
    (sysid.landing_map, options.LandingMapOptions, PRINTED | {"force"}),
    (sysid.impulse_map, options.ImpulseMapOptions, PRINTED | {"force"}),
    (sysid.design_study, options.DesignStudyOptions, PRINTED | {"force"}),
]


def declared(cls):
    """Return every marked field of an options class, with its default; nested ones in their place."""
    for field in dataclasses.fields(cls):
        hint = marks.field_hints(cls).get(field.name)
        if dataclasses.is_dataclass(hint):
            yield from declared(hint)
        elif hint is not None:
            yield field.name, hint, field.default


@pytest.mark.parametrize(("function", "cls", "left_out"), SIGNATURES)
def test_arguments_are_spelled_out_as_the_commands_declare_them(function, cls, left_out):
    given = inspect.signature(function).parameters
    assert all(p.kind is not inspect.Parameter.VAR_KEYWORD for p in given.values())
    assert all(p.annotation is not inspect.Parameter.empty for p in given.values() if p.name != "self")
    for name, hint, default in declared(cls):
        if name in left_out:
            assert RENAMED.get(name, name) not in given
            continue
        one = RENAMED.get(name, name)
        if one == "gears" and one not in given:
            one = "gear"
        assert one in given, name
        if default is dataclasses.MISSING:
            assert given[one].default is inspect.Parameter.empty or name == "out"
            continue
        mine, mark = given[one].default, marks.mark_of(hint)
        if isinstance(mine, str) and not isinstance(default, str):
            mine = mark.read(mine, name) if mark.read else mark.quantity(mine, name)
        assert mine == default, name
        if isinstance(mark, marks.Flag) and one == name:
            assert f"{name} : {mark.help}" in function.__doc__


def test_a_wrong_word_is_refused_as_python_does(lag):
    with pytest.raises(TypeError, match="resample"):
        lag[1].trust(resample=1)


def test_ctrl_c_keeps_what_was_found_and_progress_is_heard(lag, capsys):
    lines = []

    def stop(line):
        lines.append(line)
        if line.startswith("run 1/"):
            signal.raise_signal(signal.SIGINT)

    fit = sysid.fit_campaign(lag[0], runs=50, progress=stop)
    assert fit.result.state == "stopped"
    assert fit.table.loc["gain", "value"] == pytest.approx(TRUE["gain"], rel=0.01)
    assert any("3 trials to fit" in line for line in lines)
    assert any(line.startswith("stopping when") for line in lines)
    assert capsys.readouterr().err == ""
    sysid.fit_campaign(lag[0], runs=1, population=8, max_generations=2, trust=False, progress=True)
    assert "run 1/1 ended" in capsys.readouterr().err
    with pytest.raises(sysid.SysidError, match="expected True, False or a function"):
        sysid.fit_campaign(lag[0], progress="yes")


def test_the_verbs_judge_as_the_commands_do(lag):
    path, fit = lag
    seen = sysid.validate(fit, path)
    assert seen.table.index.tolist() == ["step-3"]
    assert seen.table.loc["step-3", "verdict"] == "within the noise"
    assert seen.document.flagged is False
    left = sysid.cross_validate(fit)
    assert left.table.index.tolist() == ["step-0", "step-1", "step-2"]
    with pytest.raises(sysid.SysidError, match="needs 5 or more; fit more trials"):
        sysid.explain(fit)
    same = sysid.compare(fit, fit)
    assert same.table.difference.tolist() == [0.0, 0.0]
    with pytest.raises(sysid.SysidError, match="two or more"):
        sysid.compare(fit)
    assert all(len(repr(one)) < 200 and "<table" in one._repr_html_() for one in (seen, left, same))
    checked = sysid.Campaign.read(path).check()
    assert checked.table.loc["gain", "half-width / value"] < 0.1


def test_sets_are_saved_in_every_format(gear, tmp_path):
    for suffix in ("json", "csv", "h5", "mat"):
        (file,) = gear.sets.save(tmp_path / f"sets.{suffix}")
        assert sysid.load_parameter_sets(file) == gear.sets
    (model,) = gear.sets.save(tmp_path / "gear.xml", rank=1, slope=0.1)
    assert "<mujoco" in model.read_text(encoding="utf-8")
    with pytest.raises(sysid.SysidError, match="exists"):
        gear.sets.save(model, rank=1)
    changed = gear.sets.best
    changed["k_h"] = 3000.0
    (file,) = changed.alone().save(tmp_path / "one.json")
    assert sysid.load_parameter_sets(file).best["k_h"] == 3000.0


def test_refusals_are_pythons_own_too(lag, gear):
    for kind, call in (
        (KeyError, lambda: gear["k_x"]),
        (KeyError, lambda: gear.sets["k_x"]),
        (KeyError, lambda: lag[1].trial("drop-9")),
        (KeyError, lambda: sysid.load_log(SAMPLES / "motor" / "forward-1.csv")["colour"]),
        (IndexError, lambda: gear.sets.set_values(9)),
        (FileNotFoundError, lambda: sysid.load_log("none.csv")),
        (FileNotFoundError, lambda: sysid.load_fit("none")),
        (FileNotFoundError, lambda: sysid.load_parameter_sets("none.json")),
        (FileNotFoundError, lambda: sysid.fit_gear("none.toml")),
        (TypeError, lambda: sysid.load_fit(3)),
        (TypeError, lambda: sysid.simulate_drop(3, 0.1, 0.5)),
        (ValueError, lambda: sysid.fit_gear(SAMPLES / "gear-lf", runs=0)),
        (ValueError, lambda: sysid.simulate_drop(gear, 20, 1.0)),
    ):
        with pytest.raises(kind) as refusal:
            call()
        assert isinstance(refusal.value, sysid.SysidError)
        assert str(refusal.value)[0] != "'"


def test_a_fit_without_a_folder_is_whole_and_prints_nothing(lag, tmp_path, capsys):
    path, fit = lag
    assert fit.folder is None
    rows = fit.table
    assert rows.columns.tolist() == ["symbol", "value", "unit", "interval_low", "interval_high", "verdict"]
    for name, row in rows.iterrows():
        assert row.interval_low < TRUE[name] < row.interval_high
    frame = fit.trial("step-3").to_frame()
    assert frame.columns.tolist() == [("speed [rad/s]", "measured"), ("speed [rad/s]", "predicted")]
    rest = (frame["speed [rad/s]", "measured"] - frame["speed [rad/s]", "predicted"]).to_numpy()
    assert rest.std() == pytest.approx(0.02, rel=0.2)  # the noise of the log
    judged = fit.trust(resamples=10)
    keys = ["interval_low", "interval_high", "verdict"]
    assert fit.table[keys].equals(judged.table[keys])
    assert sysid.Campaign.read(path).check().table.loc["gain", "verdict"] == "well"
    page = fit.report(str(tmp_path / "page.html"))
    assert "time_constant" in page.read_text(encoding="utf-8")
    assert capsys.readouterr() == ("", "")


def test_a_text_for_out_is_a_folder(lag, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fit = sysid.fit_campaign(lag[0], "fits/lag", runs=1, population=8, max_generations=2, trust=False)
    assert fit.folder.as_posix() == "fits/lag"
    assert sysid.load_fit("fits/lag").table.equals(fit.table)
    assert sysid.load_parameter_sets("fits/lag") == fit.sets


def test_sets_are_read_by_symbol_and_name(gear):
    sets = gear.sets
    assert sets["k_h"] == sets["leg_axial_stiffness"] == gear["k_h"] == 6440.0
    frame = sets.to_frame()
    assert frame.loc["leg_axial_stiffness", ["symbol", "unit", "set 1"]].tolist() == ["k_h", "N/m", 6440.0]
    gear = sets.best
    gear["k_h"] = 3000.0
    assert gear["leg_axial_stiffness"] == 3000.0
    assert "k_h" not in gear.keys()  # noqa: SIM118
    assert sets.best["k_h"] == 6440.0


def test_simulators_take_what_follows_from_a_set():
    start, time = [0, 0.3, 0, 0, 0, 0], np.linspace(0, 0.1, 5)
    derived = {"leg_axial_stiffness": 5e3, "leg_length": 0.1, "leg_axial_stiffness[drop-1]": 1.0}
    plain = gear_model.simulate({"leg_axial_stiffness": 5e3}, 0.1, start, time)
    assert np.array_equal(gear_model.simulate(derived, 0.1, start, time).state, plain.state)
    assert np.array_equal(motor_model.pack({"R_over_L": 1.0}), motor_model.pack({}))
    with pytest.raises(sysid.SysidError, match="no parameter 'leg_lenght'"):
        gear_model.simulate({"leg_lenght": 0.1}, 0.1, start, time)


def test_a_drop_is_a_landing_without_thrust(gear, motor):
    drop = sysid.simulate_drop(gear, slope="20 deg", speed="0.5 m/s", rate="500 Hz", horizon=1.0)
    frame = drop.to_frame()
    assert frame.index.tolist() == (np.arange(501) / 500).tolist()
    assert frame["rear_thrust [N]"].abs().max() == 0.0
    assert frame["z_B_rate [m/s]"].iloc[0] == -0.5
    assert drop.events.iloc[0].tolist()[1:] == ["touchdown", "rear"]
    same = sysid.simulate_drop(gear, math.radians(20), 0.5, rate=500.0, horizon="1 s")
    assert same.to_frame().equals(frame)
    landing = sysid.simulate_landing(gear, motor, slope="20 deg", speed="0.5 m/s")
    # Reverse thrust presses the drone down: it stops sooner than the drop.
    assert landing.to_frame()["rear_thrust [N]"].iloc[-1] < 0.0
    assert abs(landing.distance) < abs(drop.distance)


def test_reprs_are_short_and_shown_in_a_notebook(lag, gear):
    log = sysid.load_log(SAMPLES / "motor" / "forward-1.csv")
    fit = lag[1]
    drop = sysid.simulate_drop(gear, "10 deg", "0.5 m/s")
    for shown in (log, sysid.inspect(SAMPLES / "motor" / "forward-1.csv"), fit, fit.sets, drop,
                  fit.trial("step-0")):  # fmt: skip
        assert len(repr(shown)) < 200
        assert "<table" in shown._repr_html_()
        assert len(shown._repr_html_()) < 30_000
    for other in (log["speed"], gear, full_fit(), fit.result.trials[0], drop.trajectory, fit.result.runs[0]):
        assert len(repr(other)) < 300, repr(other)
    assert len(log.plot().axes) == 4


def test_clocks_of_their_own_are_joined(write):
    one = sysid.load_log(SAMPLES / "motor" / "reversal-1.h5")
    frame = one.to_frame()
    clocks = {channel.time.size for channel in one.channels.values()}
    assert len(frame) >= max(clocks)
    for channel in one.channels.values():
        column = frame[f"{channel.name} [{channel.unit}]"]
        assert np.array_equal(column.loc[channel.time].to_numpy(), channel.values, equal_nan=True)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda fit, gear: fit.trial("drop-9"), "no trial 'drop-9'; found step-0"),
        (lambda fit, gear: fit.report(), "no folder was kept; name the page"),
        (lambda fit, gear: fit.sets["gian"], "no parameter 'gian'; nearest is 'gain'"),
        (lambda fit, gear: sysid.load_fit("none"), "none: is not there"),
        (lambda fit, gear: sysid.load_log("none.csv"), "none.csv: no such file"),
        (lambda fit, gear: sysid.fit_gear("none.toml"), "none.toml: no such campaign file"),
        (lambda fit, gear: sysid.fit_motor(SAMPLES / "gear-lf"), "is a gear campaign, expected motor"),
        (lambda fit, gear: sysid.fit_gear(SAMPLES / "gear-lf", runs="3"), "runs = '3': expected a whole"),
        (lambda fit, gear: sysid.fit_gear(SAMPLES / "gear-lf", runs=0), "runs = 0: expected at least 1"),
        (
            lambda fit, gear: sysid.fit_gear(SAMPLES / "gear-lf", algorithm="gaa"),
            "expected 'ga', 'matlab-ga'",
        ),
        (lambda fit, gear: sysid.fit_gear(SAMPLES / "gear-lf", trust="no"), "expected true or false"),
        (lambda fit, gear: sysid.simulate_drop(gear, "20 kg", 1.0), "slope: unit 'kg' is not a 'deg'"),
        (lambda fit, gear: sysid.simulate_drop(gear, 20, 1.0), "in rad; write slope = '20 deg'"),
        (lambda fit, gear: sysid.simulate_drop(gear, 1.51, 1.0), "slope within 85 deg"),
        (
            lambda fit, gear: sysid.simulate_drop({"k_h": 1}, 0.1, 1.0),
            "such as sets.best, a fit or its path, found a dict",
        ),
        (lambda fit, gear: sysid.simulate_drop(fit.sets.best, 0.1, 1.0), "has lag sets, expected gear"),
        (lambda fit, gear: sysid.simulate_drop(gear, 0.1, "-1 m/s"), "expected 0 m/s or more"),
        (lambda fit, gear: sysid.simulate_landing(gear, gear, 0.1, 1.0), "has gear sets, expected motor"),
    ],
)
def test_refusals_are_one_sentence(lag, gear, call, words):
    with pytest.raises(sysid.SysidError) as refusal:
        call(lag[1], gear)
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_maps_are_tables_and_pictures(tmp_path):
    gears = [PUBLISHED / f"published-gear-{law}.json" for law in ("lf", "hf")]
    grid = {"slopes": "0:40:20 deg", "speeds": [0.3, 1.5], "check": False}
    maps = sysid.landing_map([sysid.load_parameter_sets(gears[0]), gears[1]], MOTOR_SETS, **grid)
    assert repr(maps) == "<LandingMaps: 4 maps of 3 × 2 cells>"
    frame = maps.to_frame().set_index(["surface", "controller"])
    # A level drone lands gently and stays; 40 degrees without thrust hold none. Classes share all cells.
    assert frame.sum(axis=1).to_numpy() == pytest.approx(100.0, abs=0.3)
    assert frame.loc[("lf", "reverse"), "short [%]"] > frame.loc[("lf", "off"), "short [%]"] > 0
    assert len(maps.plot().axes) >= 4
    with pytest.raises(sysid.SysidError, match="slopes 'steep'"):
        sysid.landing_map(gears, MOTOR_SETS, slopes="steep")
    alone = sysid.landing_map(sysid.load_parameter_sets(gears[0]).best, MOTOR_SETS, **grid)
    assert alone.to_frame().equals(maps.to_frame().iloc[:2])
    assert maps.save(tmp_path / "map.h5").is_file()
    with pytest.raises(sysid.SysidError, match="exists"):
        maps.save(tmp_path / "map.h5")


@pytest.mark.skipif(not threadpool_info(), reason="nobody can look into the BLAS of this numpy")
@pytest.mark.parametrize("order", ["import sysid, numpy", "import numpy, sysid"])
@pytest.mark.parametrize(("stated", "expected"), [({}, {1}), ({"OPENBLAS_NUM_THREADS": "2"}, {2})])
def test_blas_has_one_thread_unless_the_environment_says_another_number(order, stated, expected):
    others = {name: value for name, value in os.environ.items() if not name.endswith("_THREADS")}
    lines = (
        f"{order}, scipy.linalg, threadpoolctl",
        "print({found['num_threads'] for found in threadpoolctl.threadpool_info()})",
    )
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)], env=others | stated, capture_output=True, text=True
    )
    assert done.stdout.strip() == str(expected), done.stderr
