"""sysid simulate, landing-map and impulse-map as a user meets them."""

import csv
import json
import signal
from pathlib import Path

import h5py
import numpy as np
import pytest

from fakes.landings import HF, LF, MOTOR
from sysid.errors import ExportError
from sysid.landing.maps import LandingWork
from sysid.landing.outcomes import Outcome
from sysid.landing.simulate import HISTORY
from sysid.landing.store import read_maps
from sysid.resume import BlockStore
from sysid.storage import check_file, datasets
from sysid.workflows import landing_sources
from sysid.workflows.landing_sources import BlockProgress

GRID = ("--slopes", "4,40 deg", "--speeds", "0.3,1.5")


def assert_same(*paths, but=()):
    """Two files hold the same arrays, but for some names."""
    with h5py.File(paths[0]) as one, h5py.File(paths[1]) as other:
        first, second = datasets(one), datasets(other)
    for name in {*first, *second}:
        if name.rpartition("/")[2] not in but:
            np.testing.assert_array_equal(first[name], second[name], name)


def rows_of(path):
    with Path(path).open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_one_landing_per_set_as_csv_and_hdf5(done, tmp_path):
    command = ("simulate", LF, "--motor", MOTOR, "--slope", "10 deg", "--speed", 0.5)
    command += ("--flip-angle", "70 deg")
    out, _ = done(*command, "--controller", "off", "--out", "x.csv")
    assert "short" in out
    rows = rows_of("x.csv")
    assert tuple(rows[0]) == ("set", *HISTORY)
    assert len(rows) == 3001
    assert float(rows[0]["z_B_rate [m/s]"]) == pytest.approx(-0.5)  # turned into the slope and back
    (outcome,) = rows_of("x-outcomes.csv")
    assert [outcome[key] for key in ("surface", "controller", "outcome")] == ["lf", "off", "short"]
    names = ("slope [deg]", "touchdown speed [m/s]", "horizon [s]", "short [m]", "flip angle [deg]")
    np.testing.assert_allclose([float(outcome[name]) for name in names], [10.0, 0.5, 3.0, 0.45, 70.0])
    events = rows_of("x-events.csv")
    assert events[0] == {"set": "1", "time [s]": "0.0", "event": "touchdown", "of": "rear"}
    assert {"event": "rest", "of": "body"}.items() <= events[-1].items()
    out, _ = done(*command, "--controller", "off", "--out", "x.h5", "--json")
    (entry,) = json.loads(out)
    assert entry["outcome"] == "short"
    with h5py.File("x.h5") as file:
        group = file["sets/1"]
        assert group["q_B"].attrs["unit"] == "rad"
        np.testing.assert_array_equal(group["z_B"][()], [float(row["z_B [m]"]) for row in rows])
        assert group.attrs["distance [m]"] == float(outcome["distance [m]"])
        assert json.loads(file["settings_json"].asstr()[()])["rules"]["short"] == 0.45


def test_options_reach_the_landing(run):
    command = ("simulate", LF, "--motor", MOTOR, "--slope", "10 deg", "--speed", 0.5, "--json")
    wide = json.loads(run(*command, "--short", "0.001", "--long", "5")[1])[0]
    assert wide["outcome"] == "near"
    imu = json.loads(run(*command, "--trigger", "imu")[1])[0]
    assert 0.001 < imu["trigger"] < 0.05
    down = json.loads(run(*command, "--height", "0.5", "--pitch", "3 deg")[1])[0]
    assert down["distance"] != wide["distance"]
    Path("mine.py").write_text(
        "from sysid.landing.controllers import Step, controller\n\n\n"
        "@controller('hold')\ndef hold(u: float) -> list[Step]:\n    return [Step(0.0, u, u)]\n",
        encoding="utf-8",
    )
    stopped = json.loads(run(*command, "--controller-file", "mine.py", "--controller", "hold:0")[1])[0]
    off = json.loads(run(*command, "--controller", "off")[1])[0]
    assert stopped["distance"] == off["distance"]


def test_a_landing_map_of_both_surfaces(done, refused):
    Path("real.csv").write_text(
        "surface,controller,slope [deg],speed [m/s],outcome\nlf,off,4,0.3,landed\nhf,off,40,1.5,failed\n",
        encoding="utf-8",
    )
    command = ("landing-map", LF, HF, "--motor", MOTOR, *GRID, "--out", "map.h5")
    out, _ = done(*command, "--experiments", "real.csv")
    assert "1 of 1 real landings agree" in out
    # One line of headings on a terminal of 80 columns.
    heads = [line.split() for line in out.splitlines() if "observed" in line]
    assert heads == 2 * [["observed", "simulated:", "short", "near", "flipped", "other"]]
    found = read_maps("map.h5")
    assert [one.title for one in found.maps] == ["LF, off", "LF, reverse", "HF, off", "HF, reverse"]
    for one in found.maps:
        assert one.outcome.shape == (1, 2, 2)
        assert one.outcome[0, 0, 0] == Outcome.SHORT
        assert not one.uncertain.any()
    assert found.maps[2].outcome[0, 1, 1] == Outcome.FLIPPED
    assert found.settings["rules"]["horizon"] == 3.0
    assert found.settings["controllers"][1]["steps"][0]["rear"] == -1.0
    assert found.provenance["gear"]["lf"]["name"] == "published-gear-lf"
    assert Path("map.png").stat().st_size > 10_000
    assert not BlockStore.folder_of(Path("map.h5")).exists()
    refused("exists already", *command)
    assert found.settings["real_landings"][1] == {
        "surface": "hf", "controller": "off", "slope_deg": 40.0, "speed": 1.5, "outcome": "failed"
    }  # fmt: skip
    Path("map.h5").rename("first.h5")
    out, _ = done(*command, "--force", "--json", "--no-repeat", "--threads", "1", "--experiments", "real.csv")
    compared = [entry["real_landings"] for entry in json.loads(out)["maps"]]
    assert compared[0] == {
        "counts": {"landed": {"short": 1, "near": 0, "flipped": 0, "other": 0}},
        "agreeing": 1, "outside": 0, "lost": 0,
    }  # fmt: skip
    assert compared[2]["counts"]["failed"]["flipped"] == 1
    assert compared[1]["counts"] == compared[3]["counts"] == {}
    again = read_maps("map.h5")
    assert not any(one.checked for one in again.maps)
    assert [entry["uncertain"] for entry in json.loads(out)["maps"]] == [None] * 4
    assert_same("first.h5", "map.h5", but=("uncertain", "settings_json"))
    entry = json.loads(out)["maps"][0]
    assert sum(entry["cells"].values()) == 4
    assert entry["lost"] == 0


def test_progress_of_few_landings_is_a_fraction(monkeypatch):
    clock = iter([0.0, 20.0, 20.0, 20.0])
    monkeypatch.setattr(landing_sources.time, "perf_counter", lambda: next(clock))
    progress = BlockProgress(3, "landings", quiet=True)
    assert "- landings/s" in progress.line()
    progress.on_block(4, computed=True)
    assert "0.2 landings/s" in progress.line()  # 4 in 20 s
    progress.on_block(796, computed=True)
    assert " 40 landings/s" in progress.line()


def test_ctrl_c_keeps_the_finished_blocks(run, done, monkeypatch, refused):
    command = ("landing-map", LF, HF, "--motor", MOTOR, *GRID, "--out", "map.h5", "--no-repeat")
    compute, calls = LandingWork.__call__, []

    def pressed(self, rows):
        if not calls:
            signal.raise_signal(signal.SIGINT)
        calls.append(rows)
        return compute(self, rows)

    with monkeypatch.context() as patch:
        patch.setattr(LandingWork, "__call__", pressed)
        code, _, err = run(*command)
    assert code == 130
    assert "continue with --resume" in err
    folder = BlockStore.folder_of(Path("map.h5"))
    assert 1 <= len(list(folder.glob("*.npz"))) < 4
    done(*command, "--resume")
    assert not folder.exists()
    done(*command[:-3], "--out", "whole.h5", "--no-repeat")
    assert_same("map.h5", "whole.h5")


def test_an_impulse_map(done):
    tried = ("--delays", "0:0.12:0.04", "--durations", "0:0.1:0.05")
    command = (
        "impulse-map",
        LF,
        "--motor",
        MOTOR,
        "--slopes",
        "0,20 deg",
        "--speeds",
        "0.4",
        "--out",
        "i.h5",
    )
    done(*command, *tried, "--quiet")
    found = read_maps("i.h5")
    (best,) = found.impulses
    assert best.optimum["delay"].shape == (1, 2, 1)
    # Level: both feet touch at once, so there is nothing to stop.
    assert best.optimum["duration"][0, 0, 0] == 0.0
    assert best.optimum["duration"][0, 1, 0] > 0.0
    assert abs(best.optimum["refined_turn"][0, 1, 0]) <= abs(best.optimum["turn"][0, 1, 0]) + 1e-12
    assert [one.controller for one in found.maps] == [
        "impulse, then reverse", "refined impulse, then reverse", "impulse alone"
    ]  # fmt: skip
    assert found.settings["impulses"]["delays"] == [0.0, 0.04, 0.08, 0.12]
    assert found.settings["impulses"]["rear"] == 0.1
    assert Path("i.png").exists()
    assert Path("i-impulse.png").exists()


IMPULSE = ("impulse-map", LF, "--motor", MOTOR, "--slopes", "0,20 deg", "--speeds", "0.4,0.8")
IMPULSE += ("--quiet", "--no-repeat")


@pytest.mark.parametrize(
    ("options", "rear"), [((), -0.8), (("--front", "0.5"), -0.5), (("--rear", "0.1"), 0.1)]
)
def test_motors_without_delay_pull_behind_as_they_push_in_front(done, options, rear):
    tried = ("--delays", "0,0.04", "--durations", "0,0.05")
    done(*IMPULSE, *tried, "--ideal-reversal", *options, "--out", "i.h5")
    assert read_maps("i.h5").settings["impulses"]["rear"] == rear


STUDY = ("design-study", HF, "--motor", MOTOR, "--slopes", "10:30:10 deg", "--speeds", "0.4,0.8")
STUDY += ("--vary", "dx_f=1.3:1.3:1")


@pytest.mark.parametrize(
    ("command", "other", "words"),
    [
        (("landing-map", LF, HF, "--motor", MOTOR, *GRID), ("--controller", "off"), "the controller differs"),
        (
            (*IMPULSE, "--delays", "0:0.08:0.04", "--durations", "0,0.05"),
            ("--delays", "0,0.04"),
            "the impulse search differs",
        ),
        (STUDY, ("--share", "0.9", "--short", "0.3"), "the grid or rule differs"),
        ((*STUDY, "--spread", "5 deg"), ("--spread", "0 deg"), "the grid or rule"),
    ],
)
def test_what_was_stopped_goes_on_on_another_number_of_threads(command, other, words, done, killed, refused):
    done(*command, "--out", "whole.h5", "--threads", "1")
    killed(*command, "--out", "cut.h5", "--threads", "1")
    assert not Path("cut.h5").exists()
    assert len(list(BlockStore.folder_of(Path("cut.h5")).glob("*.npz"))) == 1
    refused("continue it with --resume", *command, "--out", "cut.h5")
    refused(words, *command, *other, "--out", "cut.h5", "--resume")
    done(*command, "--out", "cut.h5", "--resume", "--threads", "2")
    assert not list(Path().glob("*.blocks"))
    assert_same("whole.h5", "cut.h5")


def test_a_folder_that_takes_no_file_is_refused_before_any_work():
    with pytest.raises(ExportError, match="cannot be written"):
        check_file("/proc/x.csv", force=False, error_type=ExportError)


DROP = ("simulate", LF, "--motor", MOTOR, "--slope", "10 deg", "--speed", 0.5)
MAP = ("landing-map", LF, "--motor", MOTOR, "--out", "map.h5")
SEARCH = ("impulse-map", *MAP[1:])
DESIGNS = ("design-study", HF, "--motor", MOTOR, "--out", "s.h5", "--vary")
LATE = "impulse:50,100"  # milliseconds were meant


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ((*DROP, "--controller", "revers"), "known are off, reverse"),
        ((*DROP, "--controller", LATE), "50ms"),
        ((*DROP, "--out", "x.txt"), "ends in .csv or .h5"),
        ((*DROP, "--out", "no/x.csv"), "make it first"),
        ((*DROP, "--out", "/proc/x.csv"), "cannot be written"),
        ((*DROP, "--slope", "95 deg"), "expected a slope within 85 deg"),
        ((*DROP, "--motor", LF), "expected motor sets"),
        ((*DROP, "--height", "-1"), "give both above 0"),
        ((*DROP, "--short", "2"), "swap them"),
        ((*DROP, "--horizon", "1e9"), "at most 100 s"),
        ((*DROP, "--rate", "1e12"), "lower the rate"),
        ((*MAP, "--slopes", "45:0:1 deg"), "as in 0:45:1 deg"),
        ((*MAP, "--slopes", "0:45"), "as in 0:45:1 deg"),
        ((*MAP, "--out", "map.csv"), "ends in .h5"),
        ((*MAP, "--resume"), "nothing to continue"),
        ((*MAP, "--controller", "off", "--controller", "off"), "'off' is named twice"),
        ((*MAP, "--controller", LATE), ("a step at 50 s, but only 3 s are simulated", "50ms")),
        ((*MAP, "--slopes", "0:90:10 deg"), "expected a slope within 85 deg"),
        ((*MAP, "--speeds=-1:1:1"), "a downward speed of 0 or more"),
        ((*MAP, "--experiments", "missing.csv"), "cannot be read as CSV"),
        ((*MAP, LF), "one gear file per surface"),
        ((*SEARCH, "--front", "3"), "'front' is 3; give -1 to 1"),
        ((*SEARCH, "--rear", "nan"), "'rear' is nan"),
        ((*SEARCH, "--worth", "2"), "a worth below 1"),
        ((*SEARCH, "--delays", "0:0.26"), "--delays"),
        ((*SEARCH, "--delays", "0:260:10"), "delays up to 260 s"),
        ((*SEARCH, "--durations", "0:1"), "--durations"),
        ((*DESIGNS, "k_t=1:2:3,dx_f=1:2:2,b_t=1:2:2", "--together"), "exactly two"),
        ((*DESIGNS, "k_t=1:2:3", "--share", "0"), "share of 0"),
        ((*DESIGNS, "k_t=1:2:3", "--slopes", "5 deg"), "two or more"),
        ((*DESIGNS, "k_t=1:2:3", "--resume"), "nothing to continue"),
        ((*DESIGNS, "k_t=1:2:3", "--controller", "fly"), "no controller"),
        ((*DESIGNS, "k_t=1:2:3", "--controller", LATE), ("only 3 s are simulated", "--horizon")),
        ((*DESIGNS, "reversal_delay=-1s:0s:2"), "pause for"),
        ((*DESIGNS, "k_t=1:1:1", "--slopes", "50:60:10 deg", "--spread", "15 deg"), "within 74 deg"),
    ],
)
def test_refusals_are_one_sentence_and_write_nothing(tmp_path, command, says, refused):
    assert refused(says, *command).count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_cluster_gives_the_same_map(done):
    pytest.importorskip("distributed", reason="Dask comes with the test extra")
    command = ("landing-map", HF, "--motor", MOTOR, "--slopes", "5:40:7 deg", "--speeds", "0.2:1.4:0.4")
    done(*command, "--out", "here.h5")
    done(*command, "--out", "there.h5", "--dask", "local")
    tried = (*IMPULSE, "--delays", "0:0.08:0.04", "--durations", "0,0.05")
    for where in ((), ("--dask", "local")):
        done(*tried, *where, "--out", f"impulse-{len(where)}.h5")
    assert_same("here.h5", "there.h5")
    assert_same("impulse-0.h5", "impulse-2.h5")
