"""The stop rule in both readings on made histories, budgets, and Ctrl-C."""

import os
import signal
import threading
import time

import pytest

from sysid.errors import FitError
from sysid.fit import stopping
from sysid.fit.settings import SearchSettings
from sysid.fit.stopping import REASONS, CutShort, Deadline, stop_on_interrupt
from sysid.interrupt import heard_interrupts

RELATIVE = SearchSettings(stop_reading="relative")
MATLAB = SearchSettings(stop_reading="matlab")


def test_change_by_hand():
    history = [0.5, 0.2, 0.1999, 0.1999, 0.1999, 0.1998]
    # Over the last 4 generations: 0.2 -> 0.1998.
    assert RELATIVE.change(history) == pytest.approx(0.0002 / 0.1998, rel=1e-12)
    assert MATLAB.change(history) == pytest.approx(0.0002 / 4, rel=1e-12)
    # Above 1 MATLAB's reading is relative too, per generation.
    assert MATLAB.change([2.02, 2.0, 2.0, 2.0, 2.0]) == pytest.approx(0.02 / 4 / 2.0, rel=1e-12)


FALLING = [1.0 / g for g in range(1, 30)]
# 0.1 % relative change of an NRMSE of 0.1 is 2.5e-5 per generation in MATLAB's reading.
FLAT = [0.1001, 0.10007, 0.10005, 0.10002, 0.1]


@pytest.mark.parametrize(
    ("rule", "best", "converged"),
    [
        (RELATIVE, FLAT, False),
        (MATLAB, FLAT, True),
        (RELATIVE, [0.1] * 4, False),  # the window is not full
        (RELATIVE, [0.1] * 5, True),
        (SearchSettings(stop_window=2), [0.1] * 3, True),
        (RELATIVE, FALLING, False),
        (RELATIVE, [*FALLING, *[FALLING[-1]] * 4], True),
        (SearchSettings(stop_tolerance=0.0), [0.1] * 9, False),  # zero is never undercut
    ],
)
def test_converged(rule, best, converged):
    reason = rule.stop_reason(best, evaluations=0, next_evaluations=1, elapsed=0.0)
    assert reason == ("converged" if converged else None)


def test_a_search_that_has_found_no_valley_goes_on():
    rule = SearchSettings()
    assert rule.stop_reason([0.1] * 5, 0, 1, 0.0, settled=False) is None
    assert rule.stop_reason([0.1] * 5, 0, 1, 0.0, settled=True) == "converged"
    # Three windows of 4: a cost that is too rough for half a generation to agree ends as well.
    assert rule.stop_reason([0.1] * 12, 0, 1, 0.0, settled=False) is None
    assert rule.stop_reason([0.1] * 13, 0, 1, 0.0, settled=False) == "converged"


def test_budgets():
    assert SearchSettings(max_generations=3).stop_reason([3.0, 2.0, 1.0], 0, 1, 0.0) == "generations"
    rule = SearchSettings(runs=5, max_evaluations=1000)
    assert rule.stop_reason([1.0], 600, 400, 0.0) is None
    assert rule.stop_reason([1.0], 601, 400, 0.0) == "evaluations"
    assert rule.of_a_run().max_evaluations == 200
    assert SearchSettings(time_limit=2.0).stop_reason([1.0], 0, 1, 2.0) == "time"
    assert {"converged", "generations", "evaluations", "time", "interrupted"} <= set(REASONS)


@pytest.mark.parametrize(
    "kwargs",
    [
        {"stop_reading": "both"},
        {"stop_window": 0},
        {"stop_tolerance": float("nan")},
        {"stop_tolerance": -1.0},
        {"max_generations": 0},
    ],
)
def test_refusals(kwargs):
    with pytest.raises(FitError, match="stop rule"):
        SearchSettings(**kwargs)


def test_first_interrupt_sets_the_flag_second_aborts_and_handler_returns(monkeypatch):
    before = signal.getsignal(signal.SIGINT)
    heard = []
    with stop_on_interrupt(on_stop=lambda: heard.append(True)) as flag:
        assert not flag.is_set()
        signal.raise_signal(signal.SIGINT)
        assert flag.is_set()
        # A launcher that passes the same press on does not abort.
        signal.raise_signal(signal.SIGINT)
        assert heard == [True]
        monkeypatch.setattr(stopping, "ONE_PRESS", 0.0)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.skipif(os.name == "nt", reason="a console event cannot be sent to this process alone on Windows")
def test_interrupt_from_outside():
    with stop_on_interrupt() as flag:
        os.kill(os.getpid(), signal.SIGINT)
        deadline = time.monotonic() + 5.0
        while not flag.is_set() and time.monotonic() < deadline:
            time.sleep(0.01)
        assert flag.is_set()


def test_handler_returns_after_an_error():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ValueError, match="inside"), stop_on_interrupt():
        raise ValueError("inside")
    assert signal.getsignal(signal.SIGINT) is before


def test_other_threads_get_a_flag_and_no_handler():
    before = signal.getsignal(signal.SIGINT)
    seen = []

    def work():
        with stop_on_interrupt() as flag:
            seen.append(signal.getsignal(signal.SIGINT) is before)
            flag.set()
            seen.append(flag.is_set())

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [True, True]


def test_a_deadline_is_over_when_its_time_is_or_the_user_says_so(monkeypatch):
    now = [50.0]
    monkeypatch.setattr(stopping.time, "monotonic", lambda: now[0])
    limited, unlimited = Deadline(20.0), Deadline()
    now[0] = 69.0
    assert (limited.left, unlimited.left) == (1.0, None)
    assert not limited.check()
    now[0] = 71.0
    assert limited.left == 0.0
    with pytest.raises(CutShort, match="time limit") as cut:
        limited.check()
    assert cut.value.reason == "time"
    assert not unlimited.check()
    unlimited.flag.set()
    with pytest.raises(CutShort, match="stopped by the user") as cut:
        unlimited.check()
    assert cut.value.reason == "interrupted"


def test_the_sigterm_of_a_scheduler_is_ctrl_c():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), heard_interrupts():
        signal.raise_signal(signal.SIGTERM)
    # A search under way is asked to stop, as by Ctrl-C.
    with heard_interrupts(), stop_on_interrupt() as flag:
        signal.raise_signal(signal.SIGTERM)
        assert flag.wait(5.0)
    assert signal.getsignal(signal.SIGTERM) is before
