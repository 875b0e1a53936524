"""What `import sysid` offers: the examples of its documentation, results of a fit, and refusals."""

import doctest
import math

import numpy as np
import pytest

import sysid
from fakes.fits import full_fit
from fakes.lag_kind import TRUE, write_lag
from fakes.places import PUBLISHED, SAMPLES
from sysid import api
from sysid.gear import model as gear_model
from sysid.motor import model as motor_model
from sysid.workflows import kinds


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


def test_what_is_no_rank_no_kind_and_no_number_is_refused(gear):
    for rank in (None, 1.5, "1", 0, 10**400):
        with pytest.raises(sysid.SysidError, match="no set of rank"):
            gear.sets.set_values(rank)
    for kind in (None, 5, "gear"):
        with pytest.raises(sysid.SysidError, match=r"expected a sysid.Kind to register"):
            sysid.register(kind)
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
        (lambda: sysid.landing_map([], motors), "gears: expected a list of one or more"),
        (lambda: sysid.landing_map(gears, motors, controllers=3), "controllers: expected a list"),
        (lambda: sysid.simulate_landing(gear, motor, 0.1, 0.5, ideal_reversal="no"), "true or false"),
        (lambda: sysid.simulate_landing(gear, motor, 0.1, 0.5, controller_file="a" * 5000), "is no path"),
    ):
        with pytest.raises(sysid.SysidError) as refusal:
            call()
        assert words in str(refusal.value)
        assert len(str(refusal.value)) < 1500


@pytest.mark.parametrize("module", [api, kinds])
def test_every_example_of_the_documentation_runs(tmp_path, monkeypatch, module):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data_samples").symlink_to(SAMPLES)
    names, flags = {"__name__": "example"}, doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    result = doctest.testmod(module, globs=names, optionflags=flags)
    assert result.attempted > 10
    assert result.failed == 0


def test_what_is_offered_is_listed_and_documented():
    offered = [name for name in dir(sysid) if not name.startswith("_")]
    assert {"load_log", "inspect", "Campaign", "fit_gear", "fit_motor", "load_fit", "load_parameter_sets",
            "simulate_drop", "simulate_landing", "Kind", "register", "SysidError"} <= {*offered}  # fmt: skip
    assert all(getattr(sysid, name).__doc__ for name in offered)
    with pytest.raises(AttributeError, match="no attribute 'fit_gears'"):
        _ = sysid.fit_gears


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
        (lambda fit, gear: fit.trust(resample=1), "no option 'resample'; did you mean 'resamples'?"),
        (lambda fit, gear: sysid.load_fit("none"), "none: no fit.h5 there"),
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
        (lambda fit, gear: sysid.simulate_drop({"k_h": 1}, 0.1, 1.0), "such as sets.best, found a dict"),
        (lambda fit, gear: sysid.simulate_drop(fit.sets.best, 0.1, 1.0), "has lag sets, expected gear"),
        (lambda fit, gear: sysid.simulate_drop(gear, 0.1, "-1 m/s"), "expected 0 m/s or more"),
        (lambda fit, gear: sysid.simulate_drop(gear, 0.1, 1.0, height="1 m"), "no option 'height'"),
        (lambda fit, gear: sysid.simulate_landing(gear, gear, 0.1, 1.0), "has gear sets, expected motor"),
    ],
)
def test_refusals_are_one_sentence(lag, gear, call, words):
    with pytest.raises(sysid.SysidError) as refusal:
        call(lag[1], gear)
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_maps_are_tables_and_pictures():
    gears = [PUBLISHED / f"published-gear-{law}.json" for law in ("lf", "hf")]
    maps = sysid.landing_map(gears, PUBLISHED / "published-motor.json", slopes="0:40:20", speeds="0.3,1.5")
    assert repr(maps) == "<LandingMaps: 4 maps of 3 × 2 cells>"
    frame = maps.to_frame().set_index(["surface", "controller"])
    # A level drone lands gently and stays; 40 degrees without thrust hold none. Classes share all cells.
    assert frame.sum(axis=1).to_numpy() == pytest.approx(100.0, abs=0.3)
    assert frame.loc[("lf", "reverse"), "short [%]"] > frame.loc[("lf", "off"), "short [%]"] > 0
    assert len(maps.plot().axes) >= 4
    with pytest.raises(sysid.SysidError, match="slopes 'steep'"):
        sysid.landing_map(gears, PUBLISHED / "published-motor.json", slopes="steep")
