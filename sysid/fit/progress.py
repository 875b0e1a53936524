"""What a fit prints while it runs: run, generation, best and median NRMSE, simulations per second, time left.

A terminal shows one live line. Elsewhere (a file, a batch queue) a plain line follows each run and every few
seconds.
"""

from __future__ import annotations

import time
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

from sysid.fit.history import Generation, RunHistory
from sysid.fit.search import SearchSettings
from sysid.fit.summary import failures

# Between two plain lines [s].
PLAIN_INTERVAL = 10.0


class FitProgress:
    """Reports a fit on standard error; give its methods to `run_many` as `on_generation` and `on_run`.

    `simulated` is what a simulation is called: ``drops``, ``trials``. A time limit counts from
    the creation on.
    """

    def __init__(
        self,
        settings: SearchSettings,
        simulated: str = "simulations",
        quiet: bool = False,
        console: Console | None = None,
    ) -> None:
        self._settings = settings
        self._simulated = simulated
        self._quiet = quiet
        self._console = console if console is not None else Console(stderr=True)
        self._live: Live | None = None
        self._started = self._last_line = time.perf_counter()
        self._finished: list[float] = []

    def __enter__(self) -> Self:
        self._last_line = time.perf_counter()
        if not self._quiet and self._console.is_terminal:
            self._live = Live(console=self._console, refresh_per_second=4, transient=True)
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None

    def on_generation(self, run: int, generation: Generation) -> None:
        """Report a generation of a run (from 0)."""
        if self._quiet:
            return
        line = self.line(run, generation)
        if self._live is not None:
            self._live.update(Text(line, no_wrap=True, overflow="ellipsis"))
        elif time.perf_counter() - self._last_line >= PLAIN_INTERVAL:
            self._last_line = time.perf_counter()
            self._say(line)

    def on_run(self, run: int, history: RunHistory) -> None:
        """Report the end of a run (from 0)."""
        self._finished.append(history.wall_time)
        if self._quiet:
            return
        stages = ", ".join(
            f"{stage.algorithm} {len(stage.cost)} generations ({stage.ended})" for stage in history.stages
        )
        self._say(
            f"run {run + 1}/{self._settings.runs} ended: NRMSE {100 * history.best[-1]:.3f} %, "
            f"{history.wall_time:.1f} s, {history.evaluations} candidates, {failures(history)}; {stages}"
        )

    def on_stop(self) -> None:
        """Say that Ctrl-C was heard."""
        if not self._quiet:
            self._say(
                "stopping when what is under way is done, and keeping what was found; Ctrl-C again aborts"
            )

    def _say(self, line: str) -> None:
        self._console.print(Text(line), soft_wrap=True)

    def line(self, run: int, generation: Generation) -> str:
        """Return the progress line after a generation of a run (from 0); fits 80 columns."""
        speed = generation.simulations / generation.elapsed if generation.elapsed > 0 else 0.0
        return (
            f"run {run + 1}/{self._settings.runs}  {generation.algorithm} {generation.number}  "
            f"NRMSE best {100 * generation.best:.3f} % median {100 * generation.median:.2f} %  "
            f"{speed:.0f} {self._simulated}/s  left {self.time_left(run, generation)}"
        )

    def time_left(self, run: int, generation: Generation) -> str:
        """Return an estimate of the time that is left, or ``-``.

        A search that converges cannot tell when; further runs are taken to last as long as the finished ones
        on average. A limit gives an upper bound (``<``).
        """
        limit = self._settings.stop.time_limit
        bound = None if limit is None else max(0.0, limit - (time.perf_counter() - self._started))
        if not self._finished:
            return "-" if bound is None else f"< {_clock(bound)}"
        mean = sum(self._finished) / len(self._finished)
        left = max(0.0, mean - generation.elapsed) + mean * (self._settings.runs - run - 1)
        if bound is not None and bound < left:
            return f"< {_clock(bound)}"
        return f"~ {_clock(left)}"


def _clock(seconds: float) -> str:
    whole = round(seconds)
    minutes, rest = divmod(whole, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
