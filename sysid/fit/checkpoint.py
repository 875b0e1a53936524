"""A running fit on disk: no kill loses more than two seconds, and it is continued to the same bits.

Least squares is the exception: it needs residuals, which are not stored, so its seconds are simulated again.

Beside the result folder ``NAME`` lies ``NAME.checkpoint`` while a fit is unfinished. Each run has a file
``run-3.h5``, which holds the costs that it has paid for (see `sysid.fit.run_log`). It is an HDF5 file behind
a block of 512 bytes (HDF5's user block, so every reader opens it) that carries the SHA-256 of the rest. A new
state is written whole to a temporary name and synced; then the last one becomes ``run-3.previous.h5`` and the
new one takes its place, so that at every byte there is a file that is whole.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import FitError
from sysid.fit.run_log import Begun, RunMemory, StageMemory
from sysid.fit.stopping import REASONS
from sysid.resume import PROBES, Unfinished
from sysid.storage import FileKind, get_json, numbered, put_json, replace_file, write_file

STATE_FILE = FileKind(
    "sysid-checkpoint", 4, "the state of a fit", "start the fit again with --force", FitError
)
# Between two states of a run [s]; longer only where writing is slow.
INTERVAL = 1.0
# What a kill may cost at most [s], less what writing takes.
_OLDEST = 1.9
# A generation may take longer than the one before.
_LONGER = 1.1
_LONGEST_INTERVAL = 1.5
_SHARE = 0.03  # of the time may go into writing
_BLOCK = 512  # the smallest user block

# Key of an identity. Another processor does not hinder a resume: it is noted, and it may round the costs of
# the same candidates.
PROCESSOR = "processor"
# Relative [1]: an allowance for rounding, not a measured difference between two machines.
SAME_COST = 1e-4

_NUMBERS = {
    "failed": np.int64, "simulations": np.int64, "asked": np.uint64, "sketch": np.float64,
    "elapsed": np.float64,
}  # fmt: skip


class DamagedState(FitError):
    """A state file that is not whole; the one before it may be."""


class ForeignState(DamagedState):
    """A whole file that another program, or another version of sysid, wrote."""


class Checkpoint(Unfinished):
    """The unfinished state of one fit, see `Unfinished`; `memories` is what the runs had scored."""

    ERROR = FitError
    SUFFIX = ".checkpoint"
    STATES = "run-*"
    WHAT = "fit"

    def __init__(
        self, result: str | Path, identity: Mapping[str, Any], *, resume: bool = False, force: bool = False
    ) -> None:
        self._begun = time.monotonic()
        self._written: dict[int, float] = {}
        self._offered: dict[int, float] = {}
        self._interval = INTERVAL
        self.memories: list[RunMemory] = []
        super().__init__(result, identity, resume=resume, force=force)

    @classmethod
    def kept(cls, folder: Path) -> bool:
        """Return whether a folder holds the state of a run."""
        return bool(run_numbers(folder))

    def take_up(self) -> None:
        """Read the last whole state of every run."""
        read = (self._read(run) for run in run_numbers(self.folder))
        self.memories = [memory for memory in read if memory is not None]

    def _read(self, run: int) -> RunMemory | None:
        damage, foreign = [], False
        for path in state_files(self.folder, run):
            if not path.is_file():
                continue
            try:
                memory, identity = read_state(path)
            except DamagedState as error:
                damage.append(str(error))
                foreign = foreign or isinstance(error, ForeignState)
                continue
            memory.elsewhere = self._begun_elsewhere(identity)
            near = memory.elsewhere and _near(identity.get(PROBES), self.identity.get(PROBES))
            self.refuse_other(identity, but=(PROCESSOR, PROBES) if near else (PROCESSOR,))
            if damage:
                done = sum(len(stage.cost) for stage in memory.stages)
                self.notes.append(
                    f"{'; '.join(damage)}: run {run} goes on from the state before, {done} generations"
                )
            return memory
        if foreign:
            raise FitError("; ".join(damage))
        self.notes.append(f"{'; '.join(damage)}: nothing of run {run} can be used, it starts again")
        return None

    def _begun_elsewhere(self, stored: Mapping[str, Any]) -> bool:
        """Return whether another processor wrote the state, and note it."""
        then, now = stored.get(PROCESSOR), self.identity.get(PROCESSOR)
        if then == now:
            return False
        note = (
            f"the fit was begun on another processor ({then}; this is {now}): it goes on, but its result "
            "may differ in the last bits from an uninterrupted fit, and candidates that score differently "
            "here are computed again"
        )
        if note not in self.notes:
            self.notes.append(note)
        return True

    def keep(self, run: int, memory: RunMemory, stage_ended: bool) -> None:
        """Write the state of a run (from 0) when it is due: every second, and when a stage has ended.

        It is also due when the next state would probably come too late.
        Raises FitError when the state cannot be written; the state before stays intact.
        """
        now = time.monotonic()
        age, step = (now - times.get(run, self._begun) for times in (self._written, self._offered))
        self._offered[run] = now
        if not stage_ended and age < self._interval and age + _LONGER * step < _OLDEST:
            return
        current, previous = state_files(self.folder, run + 1)
        new = current.with_name(f"run-{run + 1}.next")
        try:
            write_file(new, state_bytes(memory, self.identity), FitError)
            if current.exists():
                replace_file(current, previous)
            replace_file(new, current)
        except FitError as error:
            raise FitError(f"{error}; then continue the fit with --resume") from error
        except OSError as error:
            raise FitError(
                f"{current}: cannot be replaced ({error.strerror or error}); the state before is intact: "
                "continue the fit with --resume"
            ) from error
        self._written[run] = time.monotonic()
        spent = self._written[run] - now
        self._interval = min(max(spent / _SHARE, INTERVAL), _LONGEST_INTERVAL)


def run_numbers(folder: Path) -> list[int]:
    """Return the runs (from 1) of which a checkpoint folder holds a state."""
    numbers = {path.name.split(".")[0].removeprefix("run-") for path in folder.glob("run-*.h5")}
    return sorted(int(number) for number in numbers if number.isdigit())


def state_files(folder: Path, run: int) -> tuple[Path, Path]:
    """Return the files of the last and of the previous state of a run (from 1)."""
    return folder / f"run-{run}.h5", folder / f"run-{run}.previous.h5"


def state_bytes(memory: RunMemory, identity: Mapping[str, Any]) -> bytes:
    """Return the file of a run's state."""

    def write(file: Any) -> None:
        file.attrs["seed"] = memory.seed
        put_json(file, "identity_json", identity)
        for number, stage in enumerate(memory.stages, start=1):
            group = file.create_group(f"stages/{number}")
            group.attrs["algorithm"], group.attrs["ended"] = stage.algorithm, stage.ended or ""
            group["candidates"] = np.array([len(cost) for cost in stage.cost], dtype=np.int64)
            group["cost"] = np.concatenate(stage.cost) if stage.cost else np.empty(0)
            put_json(group, "causes_json", stage.causes)
            for name, kind in _NUMBERS.items():
                group[name] = np.array(getattr(stage, name), dtype=kind)
            if stage.begun is not None:
                for name, value in vars(stage.begun).items():
                    group[f"begun/{name}"] = np.uint64(value) if name == "asked" else value

    content = STATE_FILE.content(write)
    return _header(content) + content


def _header(content: bytes) -> bytes:
    digest = hashlib.sha256(content).hexdigest()
    return f"{STATE_FILE.schema} sha256 {digest} {len(content)}\n".encode("ascii").ljust(_BLOCK, b"\0")


def read_state(path: Path) -> tuple[RunMemory, dict[str, Any]]:
    """Return what a run had scored, and the identity of its fit.

    Raises `DamagedState` when the file is damaged or cut off, `ForeignState` when this version of sysid did
    not write it.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DamagedState(f"{path}: cannot be read ({error.strerror or error})") from error
    content = data[_BLOCK:]
    if data[:_BLOCK] != _header(content):
        raise DamagedState(f"{path}: damaged or cut off, its checksum does not fit")
    try:
        with STATE_FILE.opened(path, content) as file:
            stages = [_read_stage(group) for group in numbered(file, "stages")]
            return RunMemory(int(file.attrs["seed"]), stages), dict(get_json(file, "identity_json"))
    except FitError as error:
        raise ForeignState(str(error)) from error


def _read_stage(group: Any) -> StageMemory:
    """Return a stage; ValueError, among others, where its numbers do not fit each other."""
    sizes, cost = group["candidates"][()], _numbers(group, "cost", np.float64)
    ends = np.cumsum(sizes)
    ended, causes = group.attrs["ended"], get_json(group, "causes_json")
    columns = {name: _numbers(group, name, kind) for name, kind in _NUMBERS.items()}
    lengths = {len(sizes), len(causes), *map(len, columns.values())}
    if len(lengths) > 1 or np.any(sizes < 1) or cost.shape != (sizes.sum(),):
        raise ValueError("its generations do not fit each other")
    begun = None
    if "begun" in group:
        kinds = {"cost": np.float64, "failed": np.int8}
        arrays = {name: _numbers(group["begun"], name, kind) for name, kind in kinds.items()}
        if len({array.shape for array in arrays.values()}) > 1:
            raise ValueError("the generation under way does not fit")
        singles = {"asked": int, "simulations": int, "elapsed": float}
        begun = Begun(**arrays, **{name: kind(group[f"begun/{name}"][()]) for name, kind in singles.items()})
    return StageMemory(
        algorithm=str(group.attrs["algorithm"]),
        cost=np.split(cost, ends[:-1]) if len(ends) else [],
        causes=[dict(cause) for cause in causes],
        ended=ended if ended in REASONS else None,
        begun=begun,
        **{k: list(v) if v.ndim > 1 else v.tolist() for k, v in columns.items()},
    )


def _numbers(group: Any, name: str, kind: Any) -> Any:
    """Return an array of finite numbers of a kind."""
    values = group[name][()].astype(kind, casting="safe")
    if not np.all(np.isfinite(values)):
        raise ValueError(f"{name} has a number that is not finite")
    return values


def _near(then: Any, now: Any) -> bool:
    """Return whether two lists of costs (hexadecimal) are equal but for rounding."""
    if not isinstance(then, list) or not isinstance(now, list) or len(then) != len(now):
        return False
    pairs = [(float.fromhex(a), float.fromhex(b)) for a, b in zip(then, now, strict=True)]
    return all(abs(a - b) <= SAME_COST * abs(a) for a, b in pairs)
