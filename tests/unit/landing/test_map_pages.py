"""`sysid report` on landing maps and design studies: the command of a cell lands as the cell says."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from fakes.hostile import VISIBLE
from fakes.published import table_1, table_2
from fakes.shells import words_of
from sysid.export import export
from sysid.landing.outcomes import Outcome, Rules
from sysid.workflows.map_pages import CellAxis, CellChart, explorer

FOLDER = "my sets; 1"
HEAD = f"{FOLDER}/lf.json", "--motor", "motor.json"
GRID = ("--slopes", "12,31 deg", "--speeds", "0.4,1.1", "--quiet")
RULES = ("--long", "1.5", "--flip-angle", "70 deg", "--horizon", "2.5")


@pytest.fixture(autouse=True)
def files(tmp_path):
    (tmp_path / FOLDER).mkdir()
    export(table_2("lf"), tmp_path / FOLDER / "lf.json")
    export(table_1(), tmp_path / "motor.json")


def shown(page):
    """Return the charts of a page as its script reads them."""
    (data,) = re.findall(r'<script type="application/json">(.*?)</script>', Path(page).read_text("utf-8"))
    return json.loads(data)["charts"]


def landed_as_said(chart, k, done):
    """Whether the command of a cell gives its class, distance and time."""
    n = len(chart["x"]["texts"])
    fields = [chart["x"]["texts"][k % n], chart["y"]["texts"][k // n], *(each[k] for each in chart["texts"])]
    words = words_of("".join(fields[part] if isinstance(part, int) else part for part in chart["command"]))
    (landing,) = json.loads(done(*words[1:], "--json")[0])
    assert landing["outcome"] == Outcome(int(chart["outcome"][0][k])).name.lower(), words
    if chart["distance"][0][k] is not None:
        # The history's own steps are shorter: it ends within a millisecond of the map's landing.
        assert landing["distance"] == pytest.approx(chart["distance"][0][k] / 1e3, abs=1e-3)
        assert landing["time_to_rest"] == pytest.approx(chart["time"][0][k] / 1e3, abs=3e-3)
    return words


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--controller", "command:-50%", "--controller", "impulse:delay=50ms, duration=0.05"), ()),
        (
            ("--trigger", "imu", "--controller", "reverse", "--pitch", "3 deg", *RULES),
            ("--trigger", "--pitch"),
        ),
        (("--ideal-reversal", "--horizontal-speed", "0.2"), ("--ideal-reversal", "--horizontal-speed")),
    ],
)
def test_commands_of_a_map_land_as_its_cells_say(options, words, done):
    done("landing-map", *HEAD, "--out", "map.h5", *GRID, *options)
    done("report", "map.h5", "--quiet")
    for chart in shown("map.html"):
        # The steep fast corner and the flat slow one.
        for k in (0, 3):
            command = landed_as_said(chart, k, done)
            assert {*words} <= {*command}


def test_commands_of_impulses_and_designs_land_as_their_cells_say(done):
    tried = ("--delays", "0,0.1", "--durations", "0.05,0.1")
    done("impulse-map", *HEAD, "--out", "i.h5", *GRID, *tried)
    done("report", "i.h5", "--quiet")
    charts = shown("i.html")
    assert len(charts) == 3
    for chart in charts:
        landed_as_said(chart, 1, done)
    vary = ("--vary", "k_t=0.5:2:2,reversal_delay=0:0.05:2", "--together")
    done("design-study", *HEAD, "--out", "s.h5", *vary, *GRID)
    done("report", "s.h5", "--quiet")
    charts = shown("s.html")
    # A map per touchdown speed and value of the second change, over the values of the first.
    assert len(charts) == 4
    assert [chart["x"]["texts"] for chart in charts] == [["0.5", "1", "2"]] * 4
    for chart in charts:
        landed_as_said(chart, 2, done)


def test_what_the_report_of_a_map_refuses(done, refused, tmp_path):
    done("landing-map", *HEAD, "--out", "map.h5", "--slopes", "5 deg", "--speeds", "0.3", "--quiet")
    refused("--gif is for the report of a fit", "report", "map.h5", "--gif", "a.gif")
    done("report", "map.h5", "--out", "a.html", "--quiet")
    refused(("exists already", "--force"), "report", "map.h5", "--out", "a.html")
    Path("cut.h5").write_bytes(Path("map.h5").read_bytes()[:-400])
    refused(("damaged or cut off", "write it again"), "report", "cut.h5")
    refused(
        "expected NAME=VALUE", "simulate", *HEAD, "--slope", "5 deg", "--speed", "1", "--change", "k_t=1:2:3"
    )
    # Sets that have moved: the page says what is missing.
    (tmp_path / "motor.json").unlink()
    done("report", "map.h5", "--out", "b.html", "--quiet")
    assert "motor.json is not there any more" in Path("b.html").read_text(encoding="utf-8")
    assert not Path("map.html").exists()


def test_names_do_not_leave_their_script():
    cells = np.zeros((1, 1, 1))
    axis = CellAxis("slope", "deg", (1.0,))
    name = f"{VISIBLE[0]}</script><img src=x onerror=alert(1)>"
    chart = CellChart(name, axis, axis, (name,), cells.astype(np.int8), cells, cells, (name, 0))
    text = explorer([chart], Rules()).text
    assert "<img" not in text
    # The page's script puts the parts of a cell's command together; the browser tests read it.
    assert chart.document()["command"] == [name, 0]
