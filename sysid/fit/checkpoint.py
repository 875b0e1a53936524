"""A running fit on disk: lost by no kill, continued to the same bits, by one process at a time.

Beside the result folder ``NAME`` lies ``NAME.checkpoint`` while a fit is unfinished. Each run has its own
file ``run-3.h5``, which holds the costs it has paid for (see `sysid.fit.run_log`). It is an HDF5 file behind
a block of 512 bytes (HDF5's user block, so every reader opens it) that carries the SHA-256 of the rest. A new
state is written whole to a temporary name and synced; then the last one becomes ``run-3.previous.h5`` and the
new one takes its place, so that at every byte there is a file that is whole.
"""

from __future__ import annotations

import hashlib
import io
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from filelock import FileLock, Timeout

from sysid import exact_json
from sysid.errors import FitError
from sysid.fit.run_log import Begun, RunMemory, StageMemory
from sysid.fit.stopping import REASONS
from sysid.storage import replace_file, write_file

CHECKPOINT_SCHEMA = "sysid-checkpoint"
CHECKPOINT_VERSION = 4
# Between two states of a run [s]; longer only where writing is slow.
INTERVAL = 1.0
# What a kill may cost at most [s], less what writing takes.
_OLDEST = 1.9
# A generation may take longer than the one before.
_LONGER = 1.1
_LONGEST_INTERVAL = 1.5
_SHARE = 0.03  # of the time may go into writing
# For another process that only looks whether the fit is running [s].
_PATIENCE = 0.3
_BLOCK = 512  # the smallest user block


# Words of an identity with a meaning of their own: another processor is only noted, and it may round the
# costs of the same candidates.
PROCESSOR = "the processor"
PROBES = "the cost of the same candidates (its inputs or code)"
# Relative [1]: an allowance for rounding, not a measured difference between two machines.
SAME_COST = 1e-4


class DamagedState(FitError):
    """A state file that is not whole; the one before it may be."""


def checkpoint_folder(fit_folder: str | Path) -> Path:
    """Return where the unfinished state of a fit folder lies."""
    path = Path(fit_folder)
    return path.with_name(path.name + ".checkpoint")


class Checkpoint:
    """The unfinished state of one fit; locked against other processes until `close`.

    Parameters
    ----------
    fit_folder : str or Path
        Result folder of the fit, which need not exist.
    identity : mapping of str to JSON-able
        What must be equal for a fit to be continued; the keys are words for a sentence.
    resume : bool
        Continue what is there. Otherwise there must be nothing, or `force` discards it.
    force : bool
        Discard what is there.

    Attributes
    ----------
    memories : list of RunMemory
        What was found.
    notes : list of str
        What is worth saying about it: a damaged file of which the previous state was used.

    Raises
    ------
    FitError
        When another process holds the fit, there is nothing to resume or something in the way, or the
        identity differs.
    """

    def __init__(
        self,
        fit_folder: str | Path,
        identity: Mapping[str, Any],
        *,
        resume: bool = False,
        force: bool = False,
    ) -> None:
        self.folder = checkpoint_folder(fit_folder)
        self.fit_folder = Path(fit_folder)
        self._identity = exact_json.dumps(dict(identity), indent=None)
        self._begun = time.monotonic()
        self._written: dict[int, float] = {}
        self._offered: dict[int, float] = {}
        self._interval = INTERVAL
        self.memories: list[RunMemory] = []
        self.notes: list[str] = []
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock = lock(self.folder)
            self._lock.acquire(timeout=_PATIENCE)
        except Timeout:
            raise FitError(running(self.fit_folder)) from None
        except OSError as error:
            raise FitError(
                f"{self.folder}: cannot be made ({error.strerror or error}); choose another folder with --out"
            ) from error
        try:
            self._open(resume, force)
        except BaseException:
            self.close()
            raise

    def _open(self, resume: bool, force: bool) -> None:
        runs = run_numbers(self.folder)
        if resume:
            if not runs:
                raise FitError(
                    f"{self.folder} holds no state of a fit to continue; start it without --resume"
                )
            self.memories = [memory for run in runs if (memory := self._read(run)) is not None]
        elif runs:
            if not force:
                raise FitError(unfinished(self.fit_folder))
            self._remove_states()

    def _read(self, run: int) -> RunMemory | None:
        damage = []
        for path in state_files(self.folder, run):
            if not path.is_file():
                continue
            try:
                memory, identity = read_state(path)
            except DamagedState as error:
                damage.append(str(error))
                continue
            self._check(identity)
            memory.elsewhere = self._begun_elsewhere(identity)
            if damage:
                done = sum(len(stage.cost) for stage in memory.stages)
                self.notes.append(
                    f"{'; '.join(damage)}: run {run} goes on from the state before, {done} generations"
                )
            return memory
        self.notes.append(f"{'; '.join(damage)}: nothing of run {run} can be used, it starts anew")
        return None

    def _check(self, stored: Mapping[str, Any]) -> None:
        own = exact_json.loads(self._identity)
        elsewhere = self._begun_elsewhere(stored)
        for key in {**stored, **own}:
            if key == PROCESSOR or (key == PROBES and elsewhere and _near(stored.get(key), own.get(key))):
                continue
            if stored.get(key) != own.get(key):
                found, expected = (_short(values.get(key)) for values in (own, stored))
                raise FitError(
                    f"{self.folder}: cannot be continued because {key} differs (now {found}, then "
                    f"{expected}); restore it, or start anew with --force"
                )

    def _begun_elsewhere(self, stored: Mapping[str, Any]) -> bool:
        """Return whether the state is of another processor, and note it."""
        then, now = stored.get(PROCESSOR), exact_json.loads(self._identity).get(PROCESSOR)
        if then == now:
            return False
        note = (
            f"the fit was begun on another processor ({then}; this is {now}): it goes on, but the same bits "
            "as of an uninterrupted fit are no longer promised, and candidates that come out otherwise here "
            "are computed again"
        )
        if note not in self.notes:
            self.notes.append(note)
        return True

    def keep(self, run: int, memory: RunMemory, stage_ended: bool) -> None:
        """Write the state of a run (from 0) when it is due: every second, and when a stage has ended.

        It is due, too, where the next state that is offered, after as long as this one, would come too late.

        Raises
        ------
        FitError
            When it cannot be written; the state before is intact.
        """
        now = time.monotonic()
        age, step = (now - times.get(run, self._begun) for times in (self._written, self._offered))
        self._offered[run] = now
        if not stage_ended and age < self._interval and age + _LONGER * step < _OLDEST:
            return
        current, previous = state_files(self.folder, run + 1)
        new = current.with_name(f"run-{run + 1}.next")
        try:
            write_file(new, state_bytes(memory, self._identity), FitError)
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

    def _remove_states(self) -> None:
        for path in self.folder.glob("run-*"):
            path.unlink(missing_ok=True)

    def discard(self) -> None:
        """Remove everything: the fit is done."""
        self._remove_states()
        self.close()

    def close(self) -> None:
        """Let other processes in, once; an empty folder is removed."""
        if not self._lock.is_locked:
            return
        self._lock.release()
        if not run_numbers(self.folder):
            shutil.rmtree(self.folder, ignore_errors=True)


def lock(folder: Path) -> FileLock:
    """Return the lock of a checkpoint folder: the system's own, which a crash releases."""
    return FileLock(folder / "lock")


def held(folder: Path) -> bool | None:
    """Return whether a process holds the lock of a checkpoint folder; None where that cannot be told.

    A folder without a lock is held by nobody, and stays without one. A lock that may not be opened (of
    another user, on a read-only disk) tells nothing.
    """
    if not (folder / "lock").exists():
        return False
    hold = lock(folder)
    try:
        hold.acquire(timeout=0)
    except Timeout:
        return True
    except OSError:
        return None
    hold.release()
    return False


def running(fit_folder: Path) -> str:
    """Return the sentence that refuses a fit on which a process works."""
    return (
        f"{fit_folder}: another process is working on this fit; wait for it, or choose another folder with "
        "--out"
    )


def unfinished(fit_folder: Path) -> str:
    """Return the sentence that refuses to start over what is unfinished."""
    return (
        f"{checkpoint_folder(fit_folder)}: an unfinished fit is there; continue it with --resume, or discard "
        "it with --force"
    )


def run_numbers(folder: Path) -> list[int]:
    """Return the runs (from 1) of which a checkpoint folder holds a state."""
    numbers = {path.name.split(".")[0].removeprefix("run-") for path in folder.glob("run-*.h5")}
    return sorted(int(number) for number in numbers if number.isdigit())


def state_files(folder: Path, run: int) -> tuple[Path, Path]:
    """Return the files of the last and of the previous state of a run (from 1)."""
    return folder / f"run-{run}.h5", folder / f"run-{run}.previous.h5"


def state_bytes(memory: RunMemory, identity: str) -> bytes:
    """Return the file of a run's state."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file.attrs["schema"] = CHECKPOINT_SCHEMA
        file.attrs["version"] = CHECKPOINT_VERSION
        file.attrs["seed"] = memory.seed
        # An attribute holds 64 kB at most; a campaign of many logs says more.
        file.create_dataset("identity_json", data=identity, dtype=h5py.string_dtype())
        for number, stage in enumerate(memory.stages, start=1):
            group = file.create_group(f"stages/{number}")
            group.attrs["algorithm"] = stage.algorithm
            group.attrs["ended"] = stage.ended or ""
            sizes = [len(cost) for cost in stage.cost]
            group["candidates"] = np.array(sizes, dtype=np.int64)
            group["cost"] = np.concatenate(stage.cost) if stage.cost else np.empty(0)
            group["failed"] = np.array(stage.failed, dtype=np.int64)
            causes = exact_json.dumps(stage.causes, indent=None)
            group.create_dataset("causes_json", data=causes, dtype=h5py.string_dtype())
            group["simulations"] = np.array(stage.simulations, dtype=np.int64)
            group["asked"] = np.array(stage.asked, dtype=np.uint64)
            group["sketch"] = np.array(stage.sketch, dtype=np.float64)
            group["elapsed"] = np.array(stage.elapsed, dtype=np.float64)
            if stage.begun is not None:
                for name, value in vars(stage.begun).items():
                    group[f"begun/{name}"] = np.uint64(value) if name == "asked" else value
    content = buffer.getvalue()
    return _header(content) + content


def _header(content: bytes) -> bytes:
    digest = hashlib.sha256(content).hexdigest()
    return f"{CHECKPOINT_SCHEMA} sha256 {digest} {len(content)}\n".encode("ascii").ljust(_BLOCK, b"\0")


def read_state(path: Path) -> tuple[RunMemory, dict[str, Any]]:
    """Return what a run had scored, and the identity of its fit.

    Raises
    ------
    DamagedState
        When the file is damaged, cut off or foreign.
    FitError
        When it is of an unknown version.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DamagedState(f"{path}: cannot be read ({error.strerror or error})") from error
    content = data[_BLOCK:]
    if data[:_BLOCK] != _header(content):
        raise DamagedState(f"{path}: damaged or cut off, its checksum does not fit")
    with h5py.File(io.BytesIO(content), "r") as file:
        if file.attrs["version"] != CHECKPOINT_VERSION:
            raise FitError(
                f"{path}: checkpoint version {file.attrs['version']}, expected {CHECKPOINT_VERSION}; "
                "continue with the version of sysid that wrote it"
            )
        stages = [_read_stage(file[f"stages/{i + 1}"]) for i in range(len(file.get("stages", ())))]
        identity = exact_json.loads(file["identity_json"].asstr()[()])
        return RunMemory(int(file.attrs["seed"]), stages), identity


def _read_stage(group: Any) -> StageMemory:
    ends = np.cumsum(group["candidates"][()])
    ended = group.attrs["ended"]
    return StageMemory(
        algorithm=group.attrs["algorithm"],
        cost=np.split(group["cost"][()], ends[:-1]) if len(ends) else [],
        failed=[int(value) for value in group["failed"][()]],
        causes=exact_json.loads(group["causes_json"].asstr()[()]),
        simulations=[int(value) for value in group["simulations"][()]],
        asked=[int(value) for value in group["asked"][()]],
        sketch=list(group["sketch"][()]),
        elapsed=[float(value) for value in group["elapsed"][()]],
        ended=ended if ended in REASONS else None,
        begun=_read_begun(group["begun"]) if "begun" in group else None,
    )


def _read_begun(group: Any) -> Begun:
    return Begun(
        asked=int(group["asked"][()]),
        cost=group["cost"][()],
        failed=group["failed"][()],
        simulations=int(group["simulations"][()]),
        elapsed=float(group["elapsed"][()]),
    )


def _near(then: Any, now: Any) -> bool:
    """Return whether two lists of costs (hexadecimal) are equal but for rounding."""
    if not isinstance(then, list) or not isinstance(now, list) or len(then) != len(now):
        return False
    pairs = [(float.fromhex(a), float.fromhex(b)) for a, b in zip(then, now, strict=True)]
    return all(abs(a - b) <= SAME_COST * abs(a) for a, b in pairs)


def _short(value: Any) -> str:
    text = "nothing" if value is None else str(value)
    return text if len(text) <= 40 else f"{text[:12]}…"
