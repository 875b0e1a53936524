"""Design studies: what is varied, what is counted, the file, the figure, the command."""

import json
import math

import numpy as np
import pytest

from sysid import cli
from sysid.errors import CampaignError, ExportError
from sysid.export import export
from sysid.landing import blocks
from sysid.landing.design_store import read_study, write_study
from sysid.landing.design_study import Change, DesignStudy, StudySettings, designs, find_changes, fleets_of
from sysid.landing.drone import drones
from sysid.motor.thrust import thrust_history
from sysid.published import table_1, table_2
from sysid.report.design_figures import figure_design_study
from sysid.report.figures import save_figure

FLEET = drones(table_2("hf"), table_1())


def test_changes_are_read_by_name_and_symbol():
    stiff, wide, later = find_changes("k_t=0.5:2:5, foot_dx=0.9:1.6:2,reversal_delay=0ms:200ms:3")
    assert (stiff.name, stiff.kind, stiff.values[2]) == ("leg_bending_stiffness", "gear", 1.0)
    np.testing.assert_allclose(stiff.values, [0.5, 0.5**0.5, 1, 2**0.5, 2], rtol=1e-9)
    assert (wide.name, wide.values) == ("foot_dx", (0.9, 1.6))
    assert later.values == (0.0, 0.1, 0.2)
    assert find_changes("saturation_current=1:3:2")[0].kind == "motor"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "nothing to vary"),
        ("stiffness=1:2:3", "no design parameter 'stiffness'"),
        ("k_t=1:2", "NAME=FIRST:LAST:COUNT"),
        ("k_t=1:2:99", "count of 1 to 41"),
        ("k_t=-1:2:3", "above 0"),
        ("k_t=1:2:3,k_t=2:3:2", "varied twice"),
        ("reversal_delay=0:200kg:3", "200kg"),
        ("k_t=nan:2:3", "finite"),
    ],
)
def test_refused_changes(text, words):
    with pytest.raises(CampaignError, match=words):
        find_changes(text)


def test_a_change_moves_its_number_alone():
    changes = find_changes("k_t=2:2:1,thrust_quadratic_reverse=0.5:0.5:1")
    points = designs(changes)
    np.testing.assert_array_equal(points, [[1, 1], [2, 1], [1, 0.5]])
    fleets = fleets_of(FLEET, changes, points)
    assert fleets[0][0] == FLEET[0]
    assert fleets[1][0].gear["leg_bending_stiffness"] == 2 * FLEET[0].gear["leg_bending_stiffness"]
    assert fleets[1][0].motor == FLEET[0].motor
    assert fleets[2][0].motor["thrust_quadratic_reverse"] == 0.31e-5
    assert {**fleets[1][0].gear, "leg_bending_stiffness": 3.44} == FLEET[0].gear
    with pytest.raises(CampaignError, match="above the joints"):
        find_changes("dz_f=0.1:1:2")[0].apply(FLEET[0], 0.1)


def reversal_time(drone):
    """From the command to 90 % of the final reverse thrust [s]."""
    history = thrust_history(drone.motor, [-1.0, 0.0], [0.62, -1.0], 1.5)
    time = np.linspace(0, 1.5, 15001)
    values = history(time)
    return time[np.argmax(values < 0.9 * values[-1])]


def test_an_added_reversal_delay_is_what_the_thrust_shows():
    (later,) = find_changes("reversal_delay=-30ms:150ms:3")
    base = reversal_time(FLEET[0])
    for value in later.values:
        # The pause ends a little later than the formula: drag grows on the way to the dead band's edge.
        added = reversal_time(later.apply(FLEET[0], value)) - base
        assert added == pytest.approx(value, abs=0.12 * abs(value) + 2e-3)
    with pytest.raises(CampaignError, match=r"pause for 0\.0488 s"):
        later.apply(FLEET[0], -0.05)


def study(landed, *, share=0.5, slopes=(0.0, 10.0, 20.0, 30.0), changes=None, points=None, together=False):
    landed = np.asarray(landed, dtype=float)
    settings = StudySettings(slopes, (0.5,) * 0 + (0.5, 1.0)[: landed.shape[2]], share, together=together)
    changes = changes or (Change("leg_bending_stiffness", "k_t", "gear", (0.5, 2.0)),)
    points = np.array([[1.0], [0.5], [2.0]][: len(landed)]) if points is None else np.array(points)
    return DesignStudy("sets", "reverse", changes, settings, points, landed)


def test_largest_safe_slope_and_landable_width():
    one = study(
        [
            [[1.0], [1.0], [0.0], [0.0]],  # up to 10 deg
            [[1.0], [0.4], [1.0], [1.0]],  # fails at 10 deg by chance
            [[0.4], [1.0], [1.0], [1.0]],  # not even level ground
        ]
    )
    np.testing.assert_array_equal(one.steepest[:, 0], [10.0, 0.0, math.nan])
    np.testing.assert_allclose(one.landable[:, 0], [15.0, 24.0, 27.0])
    assert study(one.landed, share=0.4).steepest[1, 0] == 30.0
    (row,) = one.gains()
    assert (row["best value"], row["worst value"]) == ([2.0], [1.0])
    assert row["gain [deg]"] == pytest.approx(12.0)


def test_the_change_that_buys_most_comes_first():
    changes = find_changes("k_t=2:2:1,b_t=2:2:1,dx_f=1.2:1.2:1")
    points = designs(changes)
    landed = np.zeros((4, 4, 1))
    for design, reach in enumerate([1, 2, 1, 4]):
        landed[design, :reach] = 1.0
    rows = study(landed, changes=changes, points=points).gains()
    assert [row["change"] for row in rows] == ["dx_f ×", "k_t ×", "b_t ×"]
    assert rows[0]["largest safe slope [deg]"] == {"0.5 m/s": 30.0}


def test_the_file_reads_back(tmp_path):
    changes = find_changes("k_t=0.5:2:2,reversal_delay=0:0.1:2")
    points = designs(changes, together=True)
    assert [1.0, 0.0] in points.tolist()
    random = np.random.default_rng(1).random((len(points), 4, 2))
    one = study(random, changes=changes, points=points, together=True)
    found, provenance = read_study(write_study(tmp_path / "s.h5", one, {"motor": "x"}))
    assert provenance == {"motor": "x"}
    assert (found.name, found.controller, found.changes) == (one.name, one.controller, one.changes)
    assert found.settings == one.settings
    np.testing.assert_array_equal(found.landed, one.landed)
    np.testing.assert_array_equal(found.steepest, one.steepest)
    (tmp_path / "cut.h5").write_bytes((tmp_path / "s.h5").read_bytes()[:900])
    with pytest.raises(ExportError, match="compute the study again"):
        read_study(tmp_path / "cut.h5")
    figure = figure_design_study(found)
    # A panel per speed, a number per cell, a frame around the sets as they are.
    panels = [axes for axes in figure.axes if axes.texts]
    assert len(panels) == 2
    assert len(panels[0].texts) == 9 - 3
    assert save_figure(figure, tmp_path / "s.png").stat().st_size > 5000


def test_curves_show_every_value():
    changes = find_changes("k_t=0.5:2:3,dx_f=0.8:1.4:3")
    points = designs(changes)
    one = study(np.ones((len(points), 4, 2)), changes=changes, points=points)
    panels = figure_design_study(one).axes
    # 1.06, the middle of 0.8 to 1.4, would be written over 1.
    assert panels[1].get_xticks().tolist() == [0.8, 1.0, 1.4]
    assert [panel.get_xlabel() for panel in panels] == ["k_t ×", "dx_f ×"]
    for c, panel in enumerate(panels):
        lines = [line for line in panel.lines if len(line.get_xdata()) > 2]
        # A line and dots per speed.
        assert len(lines) == 4
        np.testing.assert_allclose(lines[0].get_xdata(), changes[c].axis)


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    export(table_2("hf"), tmp_path / "gear.json")
    export(table_1(), tmp_path / "motor.json")
    return tmp_path


def run(monkeypatch, capsys, *arguments):
    base = ["sysid", "design-study", "gear.json", "--motor", "motor.json", "--out", "s.h5"]
    monkeypatch.setattr("sys.argv", [*base, *map(str, arguments)])
    code = 0
    try:
        cli.main()
    except SystemExit as stop:
        code = int(stop.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


SMALL = ("--slopes", "10:30:10", "--speeds", "0.4,0.8", "--vary", "dx_f=1.3:1.3:1")


def test_command_threads_and_resume(files, monkeypatch, capsys):
    code, out, err = run(monkeypatch, capsys, *SMALL, "--json", "--threads", "1")
    assert code == 0, err
    document = json.loads(out)
    assert document["changes"][0]["change"] == "dx_f ×"
    first, _ = read_study(files / "s.h5")
    assert sorted(p.name for p in files.iterdir()) == ["gear.json", "motor.json", "s.h5", "s.png"]
    code, _, err = run(monkeypatch, capsys, *SMALL)
    assert (code, "exists already" in err) == (2, True)
    # Ctrl-C after the first block, then on, with another number of threads.
    (files / "s.h5").unlink()
    (files / "s.png").unlink()
    save = blocks.BlockStore.save

    def save_and_die(store, name, columns):
        save(store, name, columns)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(blocks.BlockStore, "save", save_and_die)
        code, _, _ = run(patch, capsys, *SMALL, "--quiet")
    assert code == 130
    assert not (files / "s.h5").exists()
    code, out, err = run(monkeypatch, capsys, *SMALL, "--resume", "--threads", "2")
    assert code == 0, err
    assert "dx_f" in out
    second, _ = read_study(files / "s.h5")
    np.testing.assert_array_equal(first.landed, second.landed)
    assert not list(files.glob("*.blocks"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--vary", "k_t=1:2:3,dx_f=1:2:2,b_t=1:2:2", "--together"), "exactly two"),
        (("--vary", "k_t=1:2:3", "--share", "0"), "share of 0"),
        (("--vary", "k_t=1:2:3", "--slopes", "5"), "two or more"),
        (("--vary", "k_t=1:2:3", "--resume"), "nothing unfinished"),
        (("--vary", "k_t=1:2:3", "--controller", "fly"), "no controller"),
        (("--vary", "k_t=1:2:3", "--controller", "impulse:50,100"), "only 3 s are simulated"),
        (("--vary", "reversal_delay=-1s:0s:2"), "pause for"),
        (
            ("--vary", "k_t=1:1:1", "--slopes", "50:60:10", "--speeds", "0.3", "--spread-deg", "15"),
            "within 74 deg",
        ),
    ],
)
def test_command_refusals(files, monkeypatch, capsys, arguments, words):
    code, _, err = run(monkeypatch, capsys, *arguments)
    assert (code, err.startswith("error: ")) == (2, True), err
    assert words in err
    assert sorted(p.name for p in files.iterdir()) == ["gear.json", "motor.json"]
