"""What a fit prints while it runs: stage and best NRMSE of every run, a bar over all, time left.

A terminal shows one live block. Elsewhere (a file, a batch queue) a plain line follows each run and every few
seconds.
"""

import math
import sys
import time
from collections.abc import Callable
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

from sysid.fit.history import Generation, RunHistory
from sysid.fit.optima import CUT
from sysid.fit.settings import SearchSettings
from sysid.fit.stopping import REASONS
from sysid.journal import Say
from sysid.types import FloatArray

# Least time between two plain lines [s]: in a file, and in a notebook or for a function that hears them.
PLAIN_INTERVAL, LINE_INTERVAL = 10.0, 0.5
# Whether this is the kernel of a notebook, which has no terminal but replaces a line after a return.
_NOTEBOOK = "ipykernel" in sys.modules
# Width of a line that covers the one before [characters].
_WIDTH = 100
# Expected length of a run with least squares on the samples while none has ended [candidates]; measured: 1300
# for a motor, 2600 for a gear.
_FAST_RUN = 2000
# Expected length of a run without least squares while none has ended [generations].
_GENERATIONS = 60
# A run that takes more candidates than expected is taken to need this share of them still.
_STILL = 0.05
_BAR = 30


class LiveBlock:
    """A live `block` on standard error in a terminal, a plain line every few seconds elsewhere.

    In a notebook that line takes the place of the one before. `hear` gets the lines instead.
    """

    def __init__(self, quiet: bool, console: Console | None = None, hear: Say = None) -> None:
        self._quiet, self._hear = quiet, hear
        self._console = console if console is not None else Console(stderr=True)
        self._live: Live | None = None
        self._began = self._last_line = time.perf_counter()

    def block(self) -> Text:
        """Return what a terminal shows."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        self._began = self._last_line = time.perf_counter()
        if not self._quiet and not self._hear and not _NOTEBOOK and self._console.is_terminal:
            self._live = Live(
                console=self._console, get_renderable=self.block, refresh_per_second=4, transient=True
            )
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None

    def plain(self, line: Callable[[], str]) -> None:
        """Print a line where no block is shown and the last line is some seconds old."""
        interval = LINE_INTERVAL if self._hear or _NOTEBOOK else PLAIN_INTERVAL
        if self._quiet or self._live is not None or time.perf_counter() - self._last_line < interval:
            return
        self._last_line = time.perf_counter()
        if _NOTEBOOK and not self._hear:
            print(f"\r{line():<{_WIDTH}}", end="", file=sys.stderr, flush=True)
        else:
            self.say(line())

    def say(self, line: str) -> None:
        """Print a line that stays, unless quiet."""
        if self._quiet:
            return
        if self._hear:
            self._hear(line)
        elif _NOTEBOOK:
            print(f"\r{line:<{_WIDTH}}", file=sys.stderr, flush=True)
        else:
            self._console.print(Text(line), soft_wrap=not self._console.is_terminal)


class FitProgress(LiveBlock):
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
        hear: Say = None,
    ) -> None:
        super().__init__(quiet, console, hear)
        self._settings = settings
        self._simulated = simulated
        self._started = self._began
        self._noise = self._candidate_time = math.nan
        self._of_stated: Callable[[FloatArray], float] = lambda point: 1.0
        self._running: dict[int, Generation] = {}
        self._ended: dict[int, RunHistory] = {}
        # Candidates of every run that a checkpoint had scored before.
        self._before: dict[int, int] = {}

    def expect(
        self,
        noise: float,
        candidate_time: float,
        of_stated: Callable[[FloatArray], float] = lambda point: 1.0,
    ) -> None:
        """Take what noise alone costs (NaN: unknown) [1], and what a candidate takes at first [s].

        `of_stated` tells by how much stated values raise the cost of a point (n_free,) over its NRMSE [1].
        """
        self._noise, self._candidate_time, self._of_stated = noise, candidate_time, of_stated

    def __enter__(self) -> Self:
        super().__enter__()
        if self._live is None:
            runs = self._settings.runs
            self.say(f"{runs} run{'s' if runs > 1 else ''} of the search; left {self.time_left()}")
        return self

    def on_generation(self, run: int, generation: Generation) -> None:
        """Report a generation of a run (from 0)."""
        self._running[run] = generation
        self._before.setdefault(run, generation.evaluations - len(generation.cost))
        self.plain(lambda: f"{self.line(run)}  left {self.time_left()}")

    def on_run(self, run: int, history: RunHistory) -> None:
        """Report the end of a run (from 0)."""
        self._ended[run] = history
        lost, why = int(history.failed.sum()), history.stop_reason
        self.say(
            f"run {run + 1}/{self._settings.runs} ended: {self._score_of(history)}, "
            f"{history.wall_time:.1f} s, {history.evaluations} candidates"
            + (f", {lost} failed" if lost else "")
            + (f" ({REASONS[why]})" if why in CUT else "")
        )

    def on_stop(self) -> None:
        """Say that Ctrl-C was heard."""
        self.say("stopping when what is under way is done, and keeping what was found; Ctrl-C again aborts")

    def _score(self, nrmse: float) -> str:
        over = f" = {nrmse / self._noise:.2f} × noise" if self._noise > 0 else ""
        return f"NRMSE {100 * nrmse:.2f} %{over}"

    def _score_of(self, history: RunHistory) -> str:
        """Return the score of a run that ended, as the verdict on its best set states it."""
        return self._score(float(history.best[-1]) / self._of_stated(history.best_point))

    def line(self, run: int) -> str:
        """Return how far a run (from 0) is; fits 80 columns."""
        head = f"run {run + 1}/{self._settings.runs}"
        if run in self._ended:
            return f"{head}  ended  {self._score_of(self._ended[run])}"
        if run not in self._running:
            return f"{head}  waits"
        now = self._running[run]
        speed = now.simulations / now.elapsed if now.elapsed > 0 else 0.0
        stage = f"{now.algorithm} {now.number}"
        return f"{head}  {stage}  {self._score(now.best)}  {speed:.0f} {self._simulated}/s"

    def block(self) -> Text:
        """Return a line for every run, and a bar over all."""
        share = 1.0 - self._left() / (self._expected() * self._settings.runs)
        full = round(_BAR * share)
        bar = f"{'━' * full}{'─' * (_BAR - full)} {100 * share:3.0f} %  left {self.time_left()}"
        lines = [*(self.line(run) for run in range(self._settings.runs)), bar]
        return Text("\n".join(lines), no_wrap=True, overflow="ellipsis")

    def _expected(self) -> float:
        """Return how many candidates a run takes: as many as those that have ended, on average."""
        if self._ended:
            return max(1.0, sum(run.evaluations for run in self._ended.values()) / len(self._ended))
        if self._settings.finish == "least-squares":
            return _FAST_RUN
        generations = min(_GENERATIONS, self._settings.max_generations)
        return float(self._settings.population * generations)

    def _left(self) -> float:
        """Return how many candidates are left."""
        expected, left = self._expected(), 0.0
        for run in range(self._settings.runs):
            if run not in self._ended:
                scored = self._running[run].evaluations if run in self._running else 0
                left += max(expected - scored, _STILL * expected)
        return left

    def time_left(self) -> str:
        """Return an estimate of the time that is left (``~``), or the bound that a limit sets (``<``)."""
        scored = sum(now.evaluations - self._before[run] for run, now in self._running.items())
        candidate = (time.perf_counter() - self._began) / scored if scored else self._candidate_time
        left = candidate * self._left()
        limit = self._settings.time_limit
        bound = math.inf if limit is None else max(0.0, limit - (time.perf_counter() - self._started))
        if not left < bound:
            return "-" if bound == math.inf else f"< {_clock(bound)}"
        return f"~ {_clock(left)}"


def _clock(seconds: float) -> str:
    whole = round(seconds)
    minutes, rest = divmod(whole, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
