"""What a fit says while it runs."""

import io
import re

import numpy as np
import pytest
from rich.console import Console

from sysid.fit import progress as progress_module
from sysid.fit.history import Generation, RunHistory, StageHistory
from sysid.fit.progress import FitProgress
from sysid.fit.search import SearchSettings
from sysid.fit.stopping import StopRule

GENERATION = Generation(7, np.zeros((3, 1)), np.array([0.05, 0.06, 0.3]), 1, 21, 126, elapsed=2.0)
STAGE = StageHistory(
    "ga", np.zeros((1, 3, 1)), np.array([[0.05, 0.06, 0.3]]), np.array([1]), 21, 126, 10.0, "converged"
)
HISTORY = RunHistory(11, (STAGE,))


def report(**kwargs):
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=False, width=120)
    return stream, FitProgress(SearchSettings(runs=5, **kwargs), "drops", console=console)


def test_line_says_what_is_asked():
    _, progress = report()
    line = progress.line(1, GENERATION)
    expected = "run 2/5  ga 7  NRMSE best 5.000 % median 6.00 %  63 drops/s  left -"
    assert line == expected


def test_time_left_is_honest():
    _, progress = report()
    assert progress.time_left(0, GENERATION) == "-"
    progress.on_run(0, HISTORY)
    # One run took 10 s, this one has run for 2 s and three follow.
    assert progress.time_left(1, GENERATION) == "~ 0:38"
    _, limited = report(stop=StopRule(time_limit=3600.0))
    assert re.fullmatch(r"< (1:00:00|59:59)", limited.time_left(0, GENERATION))


def test_plain_lines_where_there_is_no_terminal(monkeypatch):
    stream, progress = report()
    with progress:
        progress.on_generation(0, GENERATION)
        assert stream.getvalue() == ""
        monkeypatch.setattr(progress_module, "PLAIN_INTERVAL", 0.0)
        progress.on_generation(0, GENERATION)
        progress.on_run(0, HISTORY)
        progress.on_stop()
    lines = stream.getvalue().splitlines()
    assert lines[0].startswith("run 1/5  ga 7")
    assert lines[1].startswith("run 1/5 ended: NRMSE 5.000 %, 10.0 s, 21 candidates")
    assert "ga 1 generations (NRMSE change below the tolerance)" in lines[1]
    assert "Ctrl-C again aborts" in lines[2]
    assert "\x1b" not in stream.getvalue()


@pytest.mark.parametrize("quiet", [False, True])
def test_a_terminal_shows_a_live_line_unless_quiet(quiet):
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=120)
    with FitProgress(SearchSettings(), quiet=quiet, console=console) as progress:
        progress.on_generation(0, GENERATION)
        progress.on_run(0, HISTORY)
        progress.on_stop()
    shown = stream.getvalue()
    assert shown == "" if quiet else ("ga 7" in shown and "ended: " in shown)
