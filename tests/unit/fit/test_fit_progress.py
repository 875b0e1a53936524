"""What a fit says while it runs."""

import io
from dataclasses import replace

import numba
import numpy as np
import pytest
from rich.console import Console

from sysid.fit import progress as progress_module
from sysid.fit.compiling import tell_of_kernel
from sysid.fit.history import Generation, RunHistory, StageHistory
from sysid.fit.progress import FitProgress
from sysid.fit.settings import SearchSettings
from sysid.journal import Journal

GENERATION = Generation(7, np.zeros((3, 1)), np.array([0.05, 0.06, 0.3]), 1, 21, 126, elapsed=2.0)
STAGE = StageHistory(
    "ga", np.zeros((1, 3, 1)), np.array([[0.05, 0.06, 0.3]]), np.array([1]), 21, 126, 10.0, "converged"
)
HISTORY = RunHistory(11, (STAGE,))


def report(**kwargs):
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=False, width=120)
    return stream, FitProgress(SearchSettings(runs=5, **kwargs), "drops", console=console)


def test_a_run_says_its_stage_its_cost_over_noise_and_its_speed():
    _, progress = report()
    assert progress.line(1) == "run 2/5  waits"
    progress.on_generation(1, GENERATION)
    assert progress.line(1) == "run 2/5  ga 7  NRMSE 5.00 %  63 drops/s"
    progress.expect(0.04, 1e-3)
    assert progress.line(1) == "run 2/5  ga 7  NRMSE 5.00 % = 1.25 × noise  63 drops/s"
    progress.on_run(1, HISTORY)
    assert progress.line(1) == "run 2/5  ended  NRMSE 5.00 % = 1.25 × noise"
    # The cost of stated values is no NRMSE.
    progress.expect(0.04, 1e-3, lambda point: 1.25)
    assert progress.line(1) == "run 2/5  ended  NRMSE 4.00 % = 1.00 × noise"


def test_the_time_left_is_known_from_the_first_second(monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(progress_module.time, "perf_counter", lambda: clock[0])
    _, progress = report()
    assert progress.time_left() == "-"
    # Five runs of some 2000 candidates.
    progress.expect(0.04, 0.003)
    assert progress.time_left() == "~ 0:30"
    # 21 candidates in 2 s: the others take as long.
    with progress:
        clock[0] += 2.0
        progress.on_generation(0, replace(GENERATION, evaluations=3))
        assert progress.time_left() == "~ 1:51:05"
        # The first run needed 21 candidates, 7 s for each third of it: so will the other four.
        progress.on_generation(0, GENERATION)
        progress.on_run(0, HISTORY)
        clock[0] += 19.0
        assert progress.time_left() == "~ 1:24"
        assert "20 %" in progress.block().plain
    _, limited = report(time_limit=3600.0)
    assert limited.time_left() == "< 1:00:00"


def test_plain_lines_where_there_is_no_terminal(monkeypatch):
    stream, progress = report()
    with progress:
        assert stream.getvalue() == "5 runs of the search; left -\n"
        progress.on_generation(0, GENERATION)
        monkeypatch.setattr(progress_module, "PLAIN_INTERVAL", 0.0)
        progress.on_generation(0, GENERATION)
        progress.on_run(0, HISTORY)
        progress.on_stop()
        progress.on_run(1, RunHistory(12, (STAGE, replace(STAGE, stop_reason="time"))))
    lines = stream.getvalue().splitlines()[1:]
    assert lines[0].startswith("run 1/5  ga 7")
    assert lines[1] == "run 1/5 ended: NRMSE 5.00 %, 10.0 s, 21 candidates, 1 failed"
    assert lines[3] == "run 2/5 ended: NRMSE 5.00 %, 20.0 s, 42 candidates, 2 failed (time limit)"
    assert "Ctrl-C again aborts" in lines[2]
    assert "\x1b" not in stream.getvalue()


@pytest.mark.parametrize("quiet", [False, True])
def test_a_terminal_shows_a_live_block_unless_quiet(quiet):
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=True, width=120)
    with FitProgress(SearchSettings(), quiet=quiet, console=console) as progress:
        progress.on_generation(0, GENERATION)
        progress.on_run(0, HISTORY)
        progress.on_stop()
    shown = stream.getvalue()
    assert shown == "" if quiet else all(word in shown for word in ("ended: ", "run 5/5  waits", "━"))


def test_the_wait_for_a_compiler_is_announced_once_and_only_where_it_compiles():
    lines = []
    with Journal(lines.append):
        tell_of_kernel("a kernel of this test")
        assert lines == []
        for _ in range(2):
            numba.njit(lambda x: x + 1)(1)
    said = [line for line in lines if "a kernel of this test" in line]
    assert said == ["compiling a kernel of this test, once per version: under a minute"]
