"""The costs that a run has paid for: all that is needed to continue it exactly.

A breeder is a pure function of its seed and of the costs it was given. A run is therefore continued by
breeding again from the start and telling the remembered costs, until they are used up: no state of any
library is stored, and the candidates asked for are compared with a fingerprint of those that were scored.
Least squares is given residuals, which are not stored: its candidates are simulated again.

Another processor rounds otherwise, so the same seed and costs breed candidates that differ in their last
digits. A sketch of every generation tells these from candidates that have nothing to do with the scored ones.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sysid.errors import FitError
from sysid.fit.stopping import StopReason
from sysid.fit.trial import UNNAMED_CAUSE, Evaluation, count_causes
from sysid.types import FloatArray


def population_hash(cube: FloatArray) -> int:
    """Return 64 bits that tell one population of candidates (P, n_free) [unit cube] from another."""
    data = np.ascontiguousarray(cube, dtype="<f8").tobytes()
    return int.from_bytes(hashlib.blake2b(data, digest_size=8).digest(), "little")


def _not_continued(why: str) -> FitError:
    return FitError(
        f"the checkpoint cannot be continued: {why}, so a library has changed, or another program wrote it; "
        "continue where the fit was begun, or start again with --force"
    )


# Of a sketch's entries [1]: far above what rounding leaves of a replayed search, and a thousandth of what a
# fit resolves of a parameter.
SAME_SKETCH = 1e-5


def sketch(cube: FloatArray) -> FloatArray:
    """Return a few numbers (n_free,) that move as little as the candidates (P, n_free) do.

    Every candidate has another weight, so that exchanged ones show too.
    """
    weight = np.cos(np.arange(len(cube), dtype=np.float64))
    mean: FloatArray = (weight[:, None] * cube).mean(axis=0)
    return mean


@dataclass
class Begun:
    """The first k candidates of a long generation, which are already computed.

    `asked` is the `population_hash` of all candidates of the generation, `elapsed` the wall time of the stage
    until then [s]; the rest as in `sysid.fit.trial.Evaluation`.
    """

    asked: int
    cost: FloatArray
    failed: NDArray[np.int8]
    simulations: int
    elapsed: float


@dataclass
class StageMemory:
    """What one stage has scored, generation by generation.

    Parameters
    ----------
    cost : list of (P,) array
        In the order in which the candidates were asked for [1].
    failed, simulations, causes : lists
        Candidates that failed, simulations, and failures by cause [1].
    asked, sketch : lists
        `population_hash`, and `sketch` (n_free,), of the candidates.
    elapsed : list of float
        Wall time of the stage at the end of every generation [s].
    ended : str, optional
        Why the stage ended; None while it is running.
    begun : Begun, optional
        Of the generation after these.
    """

    algorithm: str
    cost: list[FloatArray] = field(default_factory=list)
    failed: list[int] = field(default_factory=list)
    causes: list[dict[str, int]] = field(default_factory=list)
    simulations: list[int] = field(default_factory=list)
    asked: list[int] = field(default_factory=list)
    sketch: list[FloatArray] = field(default_factory=list)
    elapsed: list[float] = field(default_factory=list)
    ended: StopReason | None = None
    begun: Begun | None = None

    @property
    def spent(self) -> float:
        """Wall time of the stage so far [s]."""
        return self.begun.elapsed if self.begun is not None else self.elapsed[-1] if self.elapsed else 0.0

    def append(
        self, points: FloatArray, scored: Evaluation, elapsed: float, causes: tuple[str, ...] = UNNAMED_CAUSE
    ) -> None:
        """Remember a generation of candidates (P, n_free)."""
        self.cost.append(np.array(scored.cost, dtype=np.float64))
        self.failed.append(int(np.count_nonzero(scored.failed)))
        self.causes.append(count_causes(scored.failed, causes))
        self.simulations.append(int(scored.simulations))
        self.asked.append(population_hash(points))
        self.sketch.append(sketch(points))
        self.elapsed.append(elapsed)
        self.begun = None

    def begin(self, points: FloatArray, scored: Evaluation, elapsed: float) -> Begun:
        """Remember the next candidates of a generation of which there are more; return all of it."""
        failed = np.asarray(scored.failed, dtype=np.int8)
        cost, simulations = np.array(scored.cost, dtype=np.float64), int(scored.simulations)
        if self.begun is not None:
            cost = np.concatenate([self.begun.cost, cost])
            failed = np.concatenate([self.begun.failed, failed])
            simulations += self.begun.simulations
        self.begun = Begun(population_hash(points), cost, failed, simulations, elapsed)
        return self.begun

    def recalls_begun(self, points: FloatArray, elsewhere: bool) -> int:
        """Return how many of the candidates asked for were scored before; see `recalls`."""
        if self.begun is None:
            return 0
        if self.begun.asked == population_hash(points) and len(self.begun.cost) <= len(points):
            return len(self.begun.cost)
        if not elsewhere:
            raise self._other_candidates(len(self.cost))
        self.begun = None
        return 0

    def _other_candidates(self, generation: int) -> FitError:
        return _not_continued(
            f"generation {generation + 1} of {self.algorithm} asks for other candidates than were scored"
        )

    def recalls(self, generation: int, points: FloatArray, elsewhere: bool) -> bool:
        """Return whether the costs of a generation (from 0) belong to the candidates (P, n_free) asked for.

        Where the costs were paid on another processor (`elsewhere`), candidates that differ by rounding are
        the same, and those that differ by more are not remembered. On the same processor other candidates
        are refused: the search cannot be continued to the result that it would have had.
        """
        same = len(self.cost[generation]) == len(points)
        if same and self.asked[generation] == population_hash(points):
            return True
        if not elsewhere:
            raise self._other_candidates(generation)
        if not same or np.max(np.abs(sketch(points) - self.sketch[generation])) > SAME_SKETCH:
            return False
        # From here on it is continued on this processor.
        self.asked[generation] = population_hash(points)
        return True

    def forget_from(self, generation: int) -> None:
        """Forget a generation (from 0) and all after it; the time that they took was spent."""
        numbers = (self.cost, self.failed, self.causes, self.simulations)
        for entries in (*numbers, self.asked, self.sketch, self.elapsed):
            del entries[generation:]
        self.ended = self.begun = None


@dataclass
class RunMemory:
    """What one run has scored in the stages that were begun; `elsewhere`: on another processor."""

    seed: int
    stages: list[StageMemory] = field(default_factory=list)
    elsewhere: bool = False

    def reopen(self) -> None:
        """Forget that the run was cut short, and what came after the cut: it goes on as if never cut."""
        for number, stage in enumerate(self.stages):
            if stage.ended in ("time", "interrupted"):
                stage.ended = None
                del self.stages[number + 1 :]
                return

    def forget_from(self, stage: StageMemory, generation: int) -> None:
        """Forget a generation (from 0) of a stage and all that came after it."""
        stage.forget_from(generation)
        del self.stages[next(i for i, other in enumerate(self.stages) if other is stage) + 1 :]

    def stage(self, number: int, algorithm: str) -> StageMemory:
        """Return the memory of a stage (from 0), which is begun if it is new."""
        if number == len(self.stages):
            self.stages.append(StageMemory(algorithm))
        if self.stages[number].algorithm != algorithm:
            raise _not_continued(f"{algorithm} follows where {self.stages[number].algorithm} did")
        return self.stages[number]
