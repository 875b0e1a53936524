"""What landings must not lose: finished work, real landings, faults of a user's file, units, origins."""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from fakes.landings import HF, LF, MOTOR, published
from sysid.errors import CampaignError, ExportError
from sysid.landing.controllers import find_controller, load_controllers
from sysid.landing.impulse import Impulses
from sysid.landing.outcomes import Outcome, Rules
from sysid.landing.real_landings import Experiment, read_experiments, strangers
from sysid.landing.settings import ImpulseSettings, Scenario
from sysid.landing.simulate import land, land_many
from sysid.landing.store import read_maps
from sysid.resume import BlockStore
from sysid.workflows import landing_maps

CELLS = ("--slopes", "4 deg", "--speeds", "0.3", "--no-repeat")
MAP = ("landing-map", LF, "--motor", MOTOR, *CELLS, "--controller", "off", "--out", "map.h5")
IMPULSE = ("impulse-map", LF, "--motor", MOTOR, *CELLS, "--delays", 0, "--durations", 0, "--out", "map.h5")


@pytest.mark.parametrize(
    ("command", "names"), [(MAP, ["map.png"]), (IMPULSE, ["map.png", "map-impulse.png"])]
)
def test_a_figure_that_cannot_be_written_is_refused_before_anything_is_computed(refused, command, names):
    refused("unknown figure format '.jpeg2000'", *command, "--figure", "map.jpeg2000")
    for name in names:
        Path(name).write_bytes(b"mine")
        refused(f"{name}: exists already", *command)
        assert [path.name for path in Path().iterdir()] == [name]
        assert Path(name).read_bytes() == b"mine"
        Path(name).unlink()


def full(*_, **__):
    raise ExportError("the disk is full")


def test_a_figure_that_fails_costs_no_landing(refused, done, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(landing_maps, "save_figure", full)
        assert "go on with --resume --force" in refused("the disk is full", *MAP)
    assert read_maps("map.h5").maps[0].outcome[0, 0, 0] == Outcome.SHORT
    assert len(list(BlockStore.folder_of(Path("map.h5")).glob("*.npz"))) == 1

    def computes(*_, **__):
        raise AssertionError("a finished block is computed again")

    monkeypatch.setattr("sysid.landing.maps.LandingWork.__call__", computes)
    done(*MAP, "--resume", "--force")
    assert Path("map.png").exists()
    assert not BlockStore.folder_of(Path("map.h5")).exists()


def test_a_result_that_cannot_be_written_keeps_its_blocks(refused, monkeypatch):
    monkeypatch.setattr(landing_maps, "write_maps", full)
    err = refused("the disk is full", *MAP)
    assert "the finished blocks are kept" in err
    assert "is written" not in err
    assert len(list(BlockStore.folder_of(Path("map.h5")).glob("*.npz"))) == 1


def test_real_landings_find_their_map_by_the_controllers_name(done):
    Path("real.csv").write_text(
        "surface,controller,slope [deg],speed [m/s],outcome\nLow friction,Off,4,0.3,landed\n"
        "lf,reverse,4,0.3,landed\ngrass,off,4,0.3,landed\ngrass,off,4,0.3,landed\n",
        encoding="utf-8",
    )
    out, err = done(*MAP, "--experiments", "real.csv", "--trigger", "imu")
    assert "LF, off, accelerometer trigger: 1 of 1 real landings agree" in " ".join(out.split())
    assert "real.csv: 3 of 4 real landings belong to no map" in err
    assert "lf 'reverse' (1), grass 'off' (2)" in err


def test_names_of_surfaces_and_controllers(write):
    words = ("LF", "low-friction", "Low_Friction", "low")
    rows = "".join(f"{word},impulse:0.05, 4,0.3,landed\n".replace(" 4", "4") for word in words)
    path = write("surface,controller,slope [deg],speed [m/s],outcome\n" + rows, "real.csv")
    assert {one.surface for one in read_experiments(path)} == {"lf"}
    ideal = find_controller("reverse", ideal_reversal=True)
    assert ideal.label == "reverse, ideal reversal"
    assert ideal.name == "reverse"
    real = [
        Experiment("hf", name, 5.0, 0.3, "landed") for name in ("Reverse", "reverse, ideal reversal", "off")
    ]
    assert strangers(real, [("hf", ideal)]) == {("hf", "off"): 1}
    assert strangers(real[:1], [("lf", ideal)]) == {("hf", "Reverse"): 1}


HEAD = "from sysid.landing.controllers import Step, controller\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("def broken(:\n", "mine.py, line 2: "),
        ("x = 1\ny = x / 0\n", "mine.py, line 3: ZeroDivisionError: division by zero"),
        ("import nothing_of_that_name\n", "mine.py, line 2: ModuleNotFoundError"),
        ("x = 1\n", "registers no controller"),
        (None, "no Python file"),
    ],
)
def test_a_file_of_controllers_that_cannot_be_used(refused, write, text, says):
    if text is not None:
        write(HEAD + text, "mine.py")
    assert refused(says, *MAP, "--controller-file", "mine.py").count("\n") == 1


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
def test_a_controller_that_returns_no_steps(write, returns, says):
    text = f"{HEAD}\n\n@controller('mine')\ndef mine(u: float):\n    return {returns}\n"
    load_controllers(write(text, "mine.py"))
    with pytest.raises(CampaignError, match=says):
        find_controller("mine:0.5")


def test_no_impulse_is_always_tried():
    drone = published()
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
    drone = published()
    grid = ImpulseSettings(delays=(0.0, 0.02), durations=(0.0, 0.04), finest=0.0)
    # The front foot comes down after some 0.1 s; a level drone stands 20 deg from this slope to begin with.
    cell = [Scenario(math.radians(20.0), 0.4)]
    found = Impulses(drone, grid, Rules(horizon=0.5)).optimize(cell)
    assert math.isfinite(found.turn[0])
    for rules in (Rules(horizon=0.02), Rules(flip_angle=math.radians(10.0))):
        assert math.isnan(Impulses(drone, grid, rules).optimize(cell).turn[0])


def test_the_horizon_and_the_flip_angle_reach_the_search_of_an_impulse_map(done):
    command = (
        *IMPULSE,
        "--slopes",
        "20 deg",
        "--speeds",
        "0.4",
        "--delays",
        "0,0.02",
        "--durations",
        "0,0.04",
    )
    seen = {}
    for rules in ((), ("--flip-angle", "10 deg"), ("--horizon", "0.07")):
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


def test_what_flips_first_has_no_time_to_rest():
    """On 10 deg at 2 m/s the drone is over after 0.40 s and lies still on its back after 2.5 s."""
    drone, cell, off = published(), Scenario(math.radians(10.0), 2.0), find_controller("off")
    one, many = land(drone, cell, off), land_many(drone, [cell], off)
    kinds = [event.kind.name for event in one.trajectory.events]
    assert kinds.index("FLIP") < kinds.index("REST")
    assert one.outcome == many.outcome[0] == Outcome.FLIPPED
    assert math.isnan(one.time)
    assert math.isnan(many.time[0])
