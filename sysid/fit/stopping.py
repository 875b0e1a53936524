"""Why a search ends, and what asks it to end: its time limit and Ctrl-C."""

import _thread
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Literal

from sysid.interrupt import raise_interrupt

StopReason = Literal[
    "converged", "unexplained", "generations", "evaluations", "time", "interrupted", "exhausted"
]  # fmt: skip
CutReason = Literal["time", "interrupted"]

# A launcher repeats Ctrl-C to a child that has it from the terminal: signals this close [s] are one press.
ONE_PRESS = 0.5

# Reasons in words; "exhausted" is pymoo's: no new candidate could be bred.
REASONS: dict[str, str] = {
    "converged": "NRMSE change below the tolerance",
    "unexplained": "more is left than noise",
    "generations": "generation limit",
    "evaluations": "evaluation budget",
    "time": "time limit",
    "interrupted": "stopped by the user",
    "exhausted": "no new candidate could be bred",
}


class CutShort(Exception):
    """What follows a search was ended by `reason`, a key of `REASONS`: the user, or the time limit."""

    def __init__(self, reason: CutReason) -> None:
        super().__init__(REASONS[reason])
        self.reason = reason


class Deadline:
    """When a whole fit must end: at Ctrl-C (`flag`), or when its time limit [s] from now on has passed."""

    def __init__(self, time_limit: float | None = None) -> None:
        self.flag = threading.Event()
        self._end = None if time_limit is None else time.monotonic() + time_limit

    @property
    def left(self) -> float | None:
        """Wall time that is left [s], at least 0; None without a limit."""
        return None if self._end is None else max(0.0, self._end - time.monotonic())

    def check(self) -> bool:
        """Return False while there is time, as a search asks whether to stop; else raise `CutShort`."""
        if self.flag.is_set():
            raise CutShort("interrupted")
        if self.left == 0.0:
            raise CutShort("time")
        return False


@contextmanager
def cut_short_by(deadline: Deadline) -> Iterator[None]:
    """Raise `CutShort` in a block when the time of a deadline has passed; in the main thread only."""
    if deadline.left is None or threading.current_thread() is not threading.main_thread():
        yield
        return
    passed = threading.Event()

    def end() -> None:
        passed.set()
        _thread.interrupt_main()

    timer = threading.Timer(deadline.left, end)
    previous = signal.signal(signal.SIGINT, raise_interrupt)
    try:
        timer.start()
        yield
    except KeyboardInterrupt:
        if not passed.is_set():
            raise
        raise CutShort("time") from None
    finally:
        # An interrupt that comes after the work was done is late.
        with suppress(KeyboardInterrupt):
            timer.cancel()
            timer.join()
        signal.signal(signal.SIGINT, signal.default_int_handler if previous is None else previous)


@contextmanager
def stop_on_interrupt(on_stop: Callable[[], None] | None = None) -> Iterator[threading.Event]:
    """Turn Ctrl-C into a stop flag while the block runs.

    The first Ctrl-C sets the flag, a request to end at the next generation's end (and calls `on_stop`); the
    next one raises KeyboardInterrupt as usual.
    Outside the main thread no handler can be installed, and the flag is only set by its owner.
    """
    flag = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield flag
        return

    heard = 0.0

    def handler(signum: int, frame: FrameType | None) -> None:
        nonlocal heard
        if flag.is_set():
            if time.monotonic() - heard < ONE_PRESS:
                return
            raise_interrupt(signum, frame)
        heard = time.monotonic()
        flag.set()
        if on_stop is not None:
            on_stop()

    previous = signal.signal(signal.SIGINT, handler)
    try:
        yield flag
    finally:
        # A handler that was not installed from Python reads as None; the default is the nearest to it.
        signal.signal(signal.SIGINT, signal.default_int_handler if previous is None else previous)
