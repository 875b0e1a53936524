"""What landings must not lose: finished work, real landings, faults of a user's file, units, origins."""

import csv
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from fakes.landing_files import read_maps
from fakes.places import PUBLISHED
from sysid.errors import CampaignError, ExportError
from sysid.export.published import table_1, table_2
from sysid.landing.controllers import find_controller, load_controllers
from sysid.landing.drone import drones
from sysid.landing.impulse import Impulses, ImpulseSettings
from sysid.landing.impulse_maps import variants
from sysid.landing.outcomes import Outcome, Rules
from sysid.landing.real_landings import Experiment, read_experiments, strangers
from sysid.landing.scenario import Scenario
from sysid.landing.simulate import land, land_many
from sysid.resume import BlockStore
from sysid.workflows import landing_maps
from sysid.workflows.options import span

LF, HF, MOTOR = (PUBLISHED / f"published-{name}.json" for name in ("gear-lf", "gear-hf", "motor"))
CELLS = ("--slopes", "4", "--speeds", "0.3", "--no-check")
MAP = ("landing-map", LF, "--motor", MOTOR, *CELLS, "--controller", "off", "--out", "map.h5")
IMPULSE = ("impulse-map", LF, "--motor", MOTOR, *CELLS, "--delays", 0, "--durations", 0, "--out", "map.h5")


@pytest.mark.parametrize("command", [MAP, IMPULSE])
def test_a_figure_of_no_known_format_is_refused_before_anything_is_computed(run, tmp_path, command):
    code, _, err = run(*command, "--figure", "map.jpeg2000")
    assert code == 2
    assert "unknown figure format '.jpeg2000'" in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("command", "names"), [(MAP, ["map.png"]), (IMPULSE, ["map.png", "map-impulse.png"])]
)
def test_no_figure_is_replaced_unasked(run, tmp_path, command, names):
    for name in names:
        Path(name).write_bytes(b"mine")
        code, _, err = run(*command)
        assert code == 2
        assert f"{name}: exists already" in err
        assert [path.name for path in tmp_path.iterdir()] == [name]
        assert Path(name).read_bytes() == b"mine"
        Path(name).unlink()


def test_a_figure_that_fails_costs_no_landing(run, done, monkeypatch):
    def fail(*_, **__):
        raise ExportError("map.png: the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(landing_maps, "save_figure", fail)
        code, _, err = run(*MAP)
    assert code == 2
    assert "the disk is full" in err
    assert "go on with --resume --force" in err
    assert read_maps("map.h5").maps[0].outcome[0, 0, 0] == Outcome.SHORT
    assert len(list(BlockStore.folder_of(Path("map.h5")).glob("*.npz"))) == 1

    def computes(*_, **__):
        raise AssertionError("a finished block is computed again")

    monkeypatch.setattr("sysid.landing.maps.LandingWork.__call__", computes)
    done(*MAP, "--resume", "--force")
    assert Path("map.png").exists()
    assert not BlockStore.folder_of(Path("map.h5")).exists()


def test_a_result_that_cannot_be_written_keeps_its_blocks(run, monkeypatch):
    def fail(*_):
        raise ExportError("map.h5: the disk is full")

    monkeypatch.setattr(landing_maps, "write_maps", fail)
    code, _, err = run(*MAP)
    assert code == 2
    assert "the finished blocks are kept" in err
    assert "the maps are in" not in err
    assert len(list(BlockStore.folder_of(Path("map.h5")).glob("*.npz"))) == 1


def test_real_landings_find_their_map_by_the_controllers_name(done):
    Path("real.csv").write_text(
        "surface,controller,slope [deg],speed [m/s],outcome\nLow friction,Off,4,0.3,landed\n"
        "lf,reverse,4,0.3,landed\ngrass,off,4,0.3,landed\ngrass,off,4,0.3,landed\n",
        encoding="utf-8",
    )
    out, err = done(*MAP, "--experiments", "real.csv", "--trigger", "imu")
    assert "LF, off, own sensing: 1 of 1 real landings agree" in " ".join(out.split())
    assert "real.csv: 3 of 4 real landings belong to no map" in err
    assert "lf 'reverse' (1), grass 'off' (2)" in err


def test_names_of_surfaces_and_controllers(tmp_path):
    path = tmp_path / "real.csv"
    words = ("LF", "low-friction", "Low_Friction", "low")
    rows = "".join(f"{word},impulse:0.05, 4,0.3,landed\n".replace(" 4", "4") for word in words)
    path.write_text("surface,controller,slope [deg],speed [m/s],outcome\n" + rows, encoding="utf-8")
    assert {one.surface for one in read_experiments(path)} == {"lf"}
    told = find_controller("reverse", ideal_reversal=True)
    assert told.label == "reverse, ideal reversal"
    assert told.name == "reverse"
    real = [
        Experiment("hf", name, 5.0, 0.3, "landed") for name in ("Reverse", "reverse, ideal reversal", "off")
    ]
    assert strangers(real, [("hf", told)]) == {("hf", "off"): 1}
    assert strangers(real[:1], [("lf", told)]) == {("hf", "Reverse"): 1}


HEAD = "from sysid.landing.controllers import Step, controller\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("def broken(:\n", r"mine\.py, line 2: "),
        ("x = 1\ny = x / 0\n", r"mine\.py, line 3: ZeroDivisionError: division by zero"),
        ("import nothing_of_that_name\n", r"mine\.py, line 2: ModuleNotFoundError"),
    ],
)
def test_a_file_of_controllers_that_cannot_run(run, tmp_path, text, says):
    path = tmp_path / "mine.py"
    path.write_text(HEAD + text, encoding="utf-8")
    with pytest.raises(CampaignError, match=says):
        load_controllers(path)
    code, _, err = run(*MAP, "--controllers", "mine.py")
    assert code == 2
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("returns", "says"),
    [
        ("[(0.0, 1.0 / (u - u), 1.0)]", r"mine\.py, line 6: ZeroDivisionError"),
        (
            "[(0.0, u, u)]",
            r"mine\.py, line 4: the function returned \(0\.0, 0\.5, 0\.5\); expected a list of Step",
        ),
        ("[Step('soon', u, u)]", r"mine\.py, line 4: the function returned Step"),
        ("None", r"mine\.py: TypeError"),
    ],
)
def test_a_controller_that_returns_no_steps(run, tmp_path, returns, says):
    path = tmp_path / "mine.py"
    path.write_text(
        f"{HEAD}\n\n@controller('mine')\ndef mine(u: float):\n    return {returns}\n", encoding="utf-8"
    )
    load_controllers(path)
    with pytest.raises(CampaignError, match=says):
        find_controller("mine:0.5")


def test_steps_after_the_simulated_time_are_refused(run, tmp_path):
    wrong = "impulse:50,100"  # milliseconds were meant
    code, _, err = run(*MAP[:-4], "--controller", wrong, "--out", "map.h5")
    assert code == 2
    assert "a step at 50 s, but only 3 s are simulated" in err
    assert not list(tmp_path.iterdir())
    code, _, err = run(
        "simulate", LF, "--motor", MOTOR, "--slope-deg", 4, "--speed", 0.3, "--controller", wrong
    )
    assert code == 2
    assert "50ms" in err
    code, _, err = run("impulse-map", LF, "--motor", MOTOR, *CELLS, "--delays", "0:260:10", "--out", "map.h5")
    assert code == 2
    assert "delays up to 260 s" in err
    assert not list(tmp_path.iterdir())
    (drone,) = drones(table_2("lf"), table_1())
    with pytest.raises(CampaignError, match="a step at 50 s"):
        land_many(drone, [Scenario(0.1, 0.3)], find_controller(wrong))


def test_what_follows_an_impulse_names_its_maps():
    named = {after: variants(ImpulseSettings(after=after))[0] for after in (-1.0, 0.0, -0.5)}
    then = {-1.0: "reverse", 0.0: "off", -0.5: "command:-0.5"}
    assert named == {after: f"impulse, then {name}" for after, name in then.items()}


def test_no_impulse_is_always_tried():
    (drone,) = drones(table_2("lf"), table_1())
    grid = ImpulseSettings(delays=(0.02, 0.04), durations=(0.04,), finest=0.0)
    assert grid.combinations == 3
    # Level and fast both feet touch at once: nothing to stop.
    level = Impulses(drone, grid).optimize([Scenario(0.0, 1.0)])
    assert (level.delay[0], level.duration[0]) == (0.0, 0.0)
    # Within 1 ms the front foot, 0.3 m down-slope, comes nowhere near the ground.
    blind = ImpulseSettings(delays=(0.02,), durations=(0.04,), horizon=1e-3)
    never = Impulses(drone, blind).optimize([Scenario(math.radians(25.0), 0.3)])
    assert (never.delay[0], never.duration[0]) == (0.0, 0.0)
    assert (never.refined_delay[0], never.refined_duration[0]) == (0.0, 0.0)
    assert math.isnan(never.turn[0])
    # Where an impulse is worth it, the grid still decides: 3 rad/s without one.
    worth = Impulses(drone, grid).optimize([Scenario(math.radians(20.0), 0.4)])
    assert worth.duration[0] == 0.04


def test_the_search_for_an_impulse_keeps_the_rules_of_landings():
    (drone,) = drones(table_2("lf"), table_1())
    grid = ImpulseSettings(delays=(0.0, 0.02), durations=(0.0, 0.04), finest=0.0)
    # The front foot comes down after some 0.1 s; a level drone stands 20 deg from this slope to begin with.
    cell = [Scenario(math.radians(20.0), 0.4)]
    found = Impulses(drone, grid, Rules(horizon=0.5)).optimize(cell)
    assert math.isfinite(found.turn[0])
    for rules in (Rules(horizon=0.02), Rules(flip_angle=math.radians(10.0))):
        assert math.isnan(Impulses(drone, grid, rules).optimize(cell).turn[0])


def test_the_horizon_and_the_flip_angle_reach_the_search_of_an_impulse_map(done):
    command = (*IMPULSE, "--slopes", "20", "--speeds", "0.4", "--delays", "0,0.02", "--durations", "0,0.04")
    seen = {}
    for rules in ((), ("--flip-deg", "10"), ("--horizon", "0.07")):
        done(*command, *rules, "--quiet", "--force")
        (best,) = read_maps("map.h5").impulses
        seen[rules] = bool(np.isfinite(best.optimum["turn"]).all())
    assert list(seen.values()) == [True, False, False]


def test_origins_of_two_fits_of_one_name_are_both_kept(done):
    for surface, source in (("low", LF), ("high", HF)):
        Path(surface).mkdir()
        shutil.copy(source, Path(surface) / "gear.json")
    done("landing-map", "low/gear.json", "high/gear.json", *MAP[2:])
    origin = read_maps("map.h5").provenance
    assert {*origin["gear"]} == {"lf", "hf"}
    assert origin["gear"]["lf"]["file"] == origin["gear"]["hf"]["file"] == "gear.json"
    assert origin["gear"]["lf"] != origin["gear"]["hf"]


@pytest.mark.parametrize(
    ("text", "last", "count"),
    [
        ("0:2:0.3", 1.8, 7),
        ("0:0.3:0.1", 0.3, 4),
        ("0:2:0.05", 2.0, 41),
        ("0:0.26:0.01", 0.26, 27),
        ("0:45:1", 45.0, 46),
        ("1:1:2", 1.0, 1),
        ("3,5", 5.0, 2),
    ],
)
def test_spans_end_at_or_before_their_last(text, last, count):
    found = span(text, "--speeds")
    assert (found[-1], len(found)) == (last, count)


@pytest.mark.parametrize("text", ["0:45", "a", "1,1", "5:0:1", "0:1:0", ""])
def test_spans_that_make_no_sense(text):
    with pytest.raises(CampaignError, match="--slopes"):
        span(text, "--slopes")


def test_what_flips_first_has_no_time_to_rest():
    """On 10 deg at 2 m/s the drone is over after 0.40 s and lies still on its back after 2.5 s."""
    (drone,) = drones(table_2("lf"), table_1())
    cell, told = Scenario(math.radians(10.0), 2.0), find_controller("off")
    one, many = land(drone, cell, told), land_many(drone, [cell], told)
    kinds = [event.kind.name for event in one.trajectory.events]
    assert kinds.index("FLIP") < kinds.index("REST")
    assert one.outcome == many.outcome[0] == Outcome.FLIPPED
    assert math.isnan(one.time)
    assert math.isnan(many.time[0])


def test_tables_of_landings_say_under_what_they_happened(done):
    rest = ["--slope-deg", "10", "--speed", "0.5", "--flip-deg", "70", "--out", "x.csv"]
    done("simulate", LF, "--motor", MOTOR, *rest)
    with Path("x-outcomes.csv").open(newline="", encoding="utf-8") as stream:
        (row,) = csv.DictReader(stream)
    assert (row["surface"], row["controller"], row["outcome"]) == ("lf", "reverse", "short")
    numbers = ("slope [deg]", "touchdown speed [m/s]", "horizon [s]", "short [m]", "flip angle [deg]")
    np.testing.assert_allclose([float(row[name]) for name in numbers], [10.0, 0.5, 3.0, 0.45, 70.0])


def test_rules_reach_the_impulse_map(done):
    rules = ("--rest-speed", "0.06", "--rest-turn", "0.3", "--rest-time", "0.1", "--flip-deg", "70")
    done(*IMPULSE, *rules, "--quiet")
    found = read_maps("map.h5").settings["rules"]
    assert (found["rest_speed"], found["rest_turn"], found["rest_time"]) == (0.06, 0.3, 0.1)
    assert found["flip_angle"] == pytest.approx(math.radians(70.0))


@pytest.mark.parametrize(
    ("command", "unit"),
    [(("simulate",), "[deg]"), (("landing-map",), "[m/s]"), (("synthesize", "gear"), "[deg]")],
)
def test_help_keeps_the_units(run, command, unit):
    code, out, _ = run(*command, "--help")
    assert code == 0
    assert unit in out


def test_resume_is_not_of_fits_alone(run):
    assert "unfinished fit" not in run("landing-map", "--help")[1]
