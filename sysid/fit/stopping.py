"""When a search ends: the paper's rule in both readings, budgets, and Ctrl-C.

"Stop after the NRMSE change over 4 generations was less than 0.01 %" can be read in two ways; with ``f``
the best cost of a generation, ``w`` the window of 4 generations and ``ε`` = 1e-4:

* ``relative``: ``|f[g − w] − f[g]| / |f[g]| < ε``;
* ``matlab`` (what MATLAB's ``ga`` computes): ``|f[g − w] − f[g]| / (w · max(1, |f[g]|)) < ε``, which is
  absolute for an NRMSE below 1.

Both are first tested at generation ``w + 1`` and both stop too early on some seeds, which is why a fit is
several runs. The rule is a pure function of what happened; `sysid.fit.search` asks it after every generation.
"""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import FrameType
from typing import Literal

from sysid.errors import FitError
from sysid.interrupt import raise_interrupt

Reading = Literal["relative", "matlab"]
StopReason = Literal[
    "converged", "unexplained", "generations", "evaluations", "time", "interrupted", "exhausted"
]  # fmt: skip
CutReason = Literal["time", "interrupted"]

# A launcher repeats Ctrl-C to a child that has it from the terminal: signals this close [s] are one press.
ONE_PRESS = 0.5

# What each reason means to a person; "exhausted" is pymoo's: no new candidate could be bred.
REASONS: dict[str, str] = {
    "converged": "NRMSE change below the tolerance",
    "unexplained": "more is left than noise",
    "generations": "generation limit",
    "evaluations": "evaluation budget",
    "time": "time limit",
    "interrupted": "stopped by the user",
    "exhausted": "no new candidate could be bred",
}


@dataclass(frozen=True)
class StopRule:
    """When a run ends, whichever comes first.

    Parameters
    ----------
    reading : {"relative", "matlab"}
        How "NRMSE change over 4 generations" is computed.
    window : int
        Generations over which the change is taken [1].
    tolerance : float
        Change below which the run has converged [1]; 0 never converges.
    spread : float
        Half of a generation must lie within this share of its best, too [1]; any spread by default. A search
        that has not found its valley yet stands still as one that has reached the bottom does. Three windows
        without a change end it anyhow.
    max_generations : int
        Generation limit [1].
    max_evaluations : int or None
        Candidates that may be scored [1]; a generation that would exceed it is not begun (the first always
        is).
    time_limit : float or None
        Wall time [s], looked at after each generation.
    """

    reading: Reading = "relative"
    window: int = 4
    tolerance: float = 1e-4
    spread: float = math.inf
    max_generations: int = 1000
    max_evaluations: int | None = None
    time_limit: float | None = None

    def __post_init__(self) -> None:
        if self.reading not in ("relative", "matlab"):
            raise FitError(f"unknown stop rule {self.reading!r}; expected 'relative' or 'matlab'")
        if self.window < 1 or self.max_generations < 1:
            raise FitError(
                f"stop rule: window {self.window} and generation limit {self.max_generations} "
                "must be at least 1"
            )
        if not (self.tolerance >= 0 and self.spread >= 0):
            raise FitError(
                f"stop rule: tolerance {self.tolerance:g} and spread {self.spread:g} must be 0 or above"
            )

    def change(self, best: Sequence[float], windows: int = 1) -> float:
        """Return the change of the best costs over the last `windows` windows [1]; inf while too few."""
        window = windows * self.window
        if len(best) <= window:
            return float("inf")
        first, last = best[-1 - window], best[-1]
        if first == last:
            return 0.0
        if self.reading == "matlab":
            return abs(first - last) / (window * max(1.0, abs(last)))
        return abs(first - last) / abs(last) if last != 0 else float("inf")

    def reason(
        self,
        best: Sequence[float],
        evaluations: int,
        next_evaluations: int,
        elapsed: float,
        spread: float = 0.0,
    ) -> StopReason | None:
        """Return why the run ends after this generation, or None.

        Parameters
        ----------
        best : sequence of float
            Best cost of every generation so far [1].
        evaluations, next_evaluations : int
            Candidates scored so far, and those that another generation would score [1].
        elapsed : float
            Wall time of the run [s].
        spread : float
            How far the median of the last generation lies above its best, as a share of that [1].
        """
        if self.change(best) < self.tolerance and (
            spread <= self.spread or self.change(best, 3) < self.tolerance
        ):
            return "converged"
        if len(best) >= self.max_generations:
            return "generations"
        if self.max_evaluations is not None and evaluations + next_evaluations > self.max_evaluations:
            return "evaluations"
        if self.time_limit is not None and elapsed >= self.time_limit:
            return "time"
        return None

    def share(self, runs: int) -> StopRule:
        """Return the rule of one of `runs` runs: an equal, fixed share of the evaluation budget."""
        if self.max_evaluations is None:
            return self
        return replace(self, max_evaluations=self.max_evaluations // runs)


class StopFlag(threading.Event):
    """A request to end at the next generation's end; calling it tells whether it was made."""

    def __call__(self) -> bool:
        """Return True once the end was asked for."""
        return self.is_set()


class CutShort(Exception):
    """What follows a search was ended by `reason`, a key of `REASONS`: the user, or the time limit."""

    def __init__(self, reason: CutReason) -> None:
        super().__init__(REASONS[reason])
        self.reason = reason


class Deadline:
    """When a whole fit must end: at Ctrl-C (`flag`), or when its time limit [s] from now on has passed."""

    def __init__(self, time_limit: float | None = None) -> None:
        self.flag = StopFlag()
        self._end = None if time_limit is None else time.monotonic() + time_limit

    @property
    def left(self) -> float | None:
        """Wall time that is left [s], at least 0; None without a limit."""
        return None if self._end is None else max(0.0, self._end - time.monotonic())

    def check(self) -> bool:
        """Return False while there is time, as a search asks whether to stop; else raise `CutShort`."""
        if self.flag():
            raise CutShort("interrupted")
        if self.left == 0.0:
            raise CutShort("time")
        return False


@contextmanager
def stop_on_interrupt(on_stop: Callable[[], None] | None = None) -> Iterator[StopFlag]:
    """Turn Ctrl-C into a stop flag while the block runs.

    The first Ctrl-C sets the flag (and calls `on_stop`); the next one raises KeyboardInterrupt as usual.
    Outside the main thread no handler can be installed, and the flag is only set by its owner.
    """
    flag = StopFlag()
    if threading.current_thread() is not threading.main_thread():
        yield flag
        return

    heard = 0.0

    def handler(signum: int, frame: FrameType | None) -> None:
        nonlocal heard
        if flag():
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
