"""A running fit on disk: a kill costs a run the stage under way at most, and resuming gives equal bits.

Beside the result folder ``NAME`` lies ``NAME.checkpoint`` while a fit is unfinished. A stage of a run is a
pure function of the seed and of the stages before it. Finished stages are therefore kept, and the stage under
way starts again: in a search of hundreds of large generations that may be hours of work. What follows the
search starts again, too. The best generation of every run is kept beside the stages, so that a fit which is
continued and then stopped early still has what was found before.
"""

import time
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sysid import exact_json
from sysid.errors import FitError
from sysid.fit.breeders.breeder import Start
from sysid.fit.history import StageHistory
from sysid.fit.stopping import REASONS
from sysid.parallel import Columns
from sysid.resume import DAMAGE, BlockStore

# Least time between two writes of a run's best generation [s].
INTERVAL = 1.0

# Keys of an identity that may differ on another processor, which rounds the costs of candidates otherwise.
PROCESSOR = "processor"
PROBES = "cost of the same candidates (its inputs or code)"
# Relative difference of these costs that another processor may make [1]: an allowance for rounding.
SAME_COST = 1e-4

_TEXTS = ("algorithm", "evaluations", "simulations", "wall_time", "stop_reason", "causes")


class Checkpoint(BlockStore):
    """The unfinished state of one fit, see `BlockStore`; runs and stages count from 0."""

    ERROR = FitError
    SUFFIX = ".checkpoint"
    STATES = "run-*"
    WHAT = "fit"

    def __init__(
        self, result: str | Path, identity: Mapping[str, object], *, resume: bool = False, force: bool = False
    ) -> None:
        self._written: dict[int, tuple[float, StageHistory]] = {}
        super().__init__(result, identity, resume=resume, force=force)

    @classmethod
    def options(cls, result: str | Path) -> dict[str, Any]:
        """Return the options of the search of an unfinished fit by name; none where they cannot be read."""
        try:
            stored = exact_json.loads((cls.folder_of(result) / cls._FILE).read_text(encoding="utf-8"))
            return {key[7:]: value for key, value in stored.items() if key.startswith("option_")}
        except (OSError, ValueError, AttributeError):
            return {}

    def take_up(self) -> None:
        """Check the identity; refuse the files of versions that kept every cost."""
        for path in self.folder.glob("run-*.h5"):
            raise FitError(
                f"{path}: an earlier version of sysid wrote this state of a fit, and this cannot continue "
                "it; continue it with that version, or start the fit again with --force"
            )
        super().take_up()

    def refuse_other(self, stored: Mapping[str, object], but: Collection[str] = ()) -> None:
        """Refuse another identity; note another processor, whose rounding alone may change the costs."""
        then, now = stored.get(PROCESSOR), self.identity.get(PROCESSOR)
        if then != now:
            near = _near(stored.get(PROBES), self.identity.get(PROBES))
            but = (PROCESSOR, PROBES) if near else (PROCESSOR,)
            self.notes.append(
                f"the fit was begun on another processor ({then}; this is {now}): it goes on, but its result "
                "may differ in the last bits from an uninterrupted fit"
            )
        super().refuse_other(stored, but)

    def finished(
        self, run: int, stage: int, algorithm: str, n_free: int
    ) -> tuple[StageHistory, Start] | None:
        """Return a stage and where the next one starts; None where it must be computed (again)."""
        return self._unpacked(f"run-{run + 1}-stage-{stage + 1}", n_free, algorithm)

    def best(self, run: int, n_free: int) -> StageHistory | None:
        """Return the best generation of a run as a stage of one generation; None where there is none."""
        found = self._unpacked(f"run-{run + 1}-best", n_free)
        return None if found is None else found[0]

    def begun(self, run: int) -> bool:
        """Return whether something of a run is kept."""
        return any(self.folder.glob(f"run-{run + 1}-*.npz"))

    def state(self) -> tuple[int, int]:
        """Return how many runs were begun, and how many stages are finished."""
        return glance(self.folder)[0], len(list(self.folder.glob("run-*-stage-*.npz")))

    def keep(self, run: int, number: int, stage: StageHistory, start: Start) -> None:
        """Write a finished stage, and where the next one starts.

        Raises FitError when it cannot be written; what was written before stays intact.
        """
        self.save(f"run-{run + 1}-stage-{number + 1}", _packed(stage, start))

    def keep_best(self, run: int, best: StageHistory, *, now: bool = False) -> None:
        """Write the best generation of a run, unless it is written; at most every second, or `now`."""
        when, written = self._written.get(run, (-np.inf, None))
        if best is not written and (now or time.monotonic() - when >= INTERVAL):
            self.save(f"run-{run + 1}-best", _packed(best, Start.of_population(best.cube[-1])))
            self._written[run] = time.monotonic(), best

    def save(self, name: str, columns: Columns) -> None:
        """Keep a block; the refusal says how the fit goes on."""
        try:
            super().save(name, columns)
        except FitError as error:
            raise FitError(f"{error}; then continue the fit with --resume") from error

    def _unpacked(self, name: str, n_free: int, algorithm: str = "") -> tuple[StageHistory, Start] | None:
        columns = self.load(name)
        if columns is None:
            return None
        try:
            cube, cost, failed, mean, spread, axes, texts = columns
            stage = StageHistory(cube=cube, cost=cost, failed=failed, **exact_json.loads(str(texts)))
            start = Start(mean, spread, axes if len(axes) else None)
            _check(stage, start, n_free)
        except DAMAGE as error:
            self.damaged(name, error)
            return None
        if algorithm not in ("", stage.algorithm):
            raise FitError(
                f"the checkpoint cannot be continued: {algorithm} follows where {stage.algorithm} did, so "
                "another program wrote it; start again with --force"
            )
        return stage, start


def _near(then: object, now: object) -> bool:
    """Return whether two lists of costs (hexadecimal) are equal but for rounding."""
    if not isinstance(then, list) or not isinstance(now, list) or len(then) != len(now):
        return False
    pairs = [(float.fromhex(a), float.fromhex(b)) for a, b in zip(then, now, strict=True)]
    return all(abs(a - b) <= SAME_COST * abs(a) for a, b in pairs)


def _packed(stage: StageHistory, start: Start) -> Columns:
    texts = exact_json.dumps({name: getattr(stage, name) for name in _TEXTS}, indent=None)
    axes = np.empty((0, 0)) if start.axes is None else start.axes
    return stage.cube, stage.cost, stage.failed, start.mean, start.spread, axes, np.array(texts)


def _check(stage: StageHistory, start: Start, n_free: int) -> None:
    """Raise ValueError where the numbers of a stage do not fit each other."""
    generations, population, _ = stage.cube.shape
    numbers = (stage.cube, stage.cost, start.mean, start.spread)
    fits = (
        generations > 0
        and population > 0
        and stage.cube.shape[2:] == start.mean.shape == start.spread.shape == (n_free,)
        and stage.cost.shape == (generations, population)
        and stage.failed.shape == (generations,) == (len(stage.causes),)
        and (start.axes is None or start.axes.shape == (n_free, n_free))
        and all(array.dtype == np.float64 and np.all(np.isfinite(array)) for array in numbers)
        and stage.failed.dtype == np.int64
        # No candidate costs less than nothing, and no work takes less than no time.
        and min(stage.cost.min(), stage.failed.min(), stage.evaluations, stage.simulations) >= 0
        and 0 <= stage.wall_time < np.inf
        and stage.stop_reason in REASONS
    )
    if not fits:
        raise ValueError("its numbers do not fit each other")


def glance(folder: Path) -> tuple[int, float | None, float]:
    """Return of an unfinished fit: runs begun, lowest NRMSE [1], last change [s since 1970].

    The NRMSE is None where no file can be read.
    """
    states = sorted(folder.glob(Checkpoint.STATES))
    runs = {path.name.split(".")[0].split("-")[1] for path in states}
    lowest: list[float] = []
    for path in folder.glob("run-*-best.npz"):
        try:
            with np.load(path) as file:
                lowest.append(float(file["arr_1"].min()))
        except DAMAGE:
            continue
    return len(runs), min(lowest, default=None), max((path.stat().st_mtime for path in states), default=0.0)
