"""Unfinished results: kept on disk while they are computed, continued after a kill, by one process at a time.

An unfinished result has a folder next to it: a lock, the identity (what must be equal for the result to be
continued) and the finished blocks, each written whole or not at all. A block of a map or of a design study is
some of its rows, a block of a fit is a stage of a run (`sysid.fit.checkpoint`).
"""

import hashlib
import io
import shutil
import threading
import zipfile
import zlib
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
from filelock import FileLock, Timeout

from sysid import exact_json
from sysid.errors import ExportError, SysidError
from sysid.journal import notice
from sysid.parallel import Columns, Executor, LocalThreads, Work
from sysid.storage import check_place, write_file
from sysid.types import FloatArray

# Errors that reading a damaged block may raise.
DAMAGE = (
    OSError, ValueError, TypeError, LookupError, EOFError, MemoryError, OverflowError, zipfile.BadZipFile,
    zlib.error, NotImplementedError, SyntaxError,
)  # fmt: skip
# Time to wait for the lock [s]: another process may only be looking at it.
_PATIENCE = 0.3


class BlockStore:
    """The finished blocks of an unfinished result; locked against other processes until `close`.

    `result` is where the whole will be written. `identity` (JSON-able) must be equal for it to be continued;
    the words of a key, joined by underscores, stand in the refusal. `resume` continues from existing blocks;
    otherwise there must be none, or `force` discards them. `notes` are sentences about the blocks.

    Raises
    ------
    SysidError
        (`ERROR`) when another process works on the result, blocks are in the way, there are none to continue,
        or the identity differs.
    """

    ERROR: ClassVar[type[SysidError]] = ExportError
    SUFFIX: ClassVar[str] = ".blocks"
    STATES: ClassVar[str] = "*.npz"
    WHAT: ClassVar[str] = "result"
    _FILE: ClassVar[str] = "identity.json"

    def __init__(
        self, result: str | Path, identity: Mapping[str, object], *, resume: bool = False, force: bool = False
    ) -> None:
        self.result = Path(result)
        self.folder = self.folder_of(result)
        self.identity: dict[str, object] = exact_json.plain(dict(identity))
        self.notes: list[str] = []
        # Held while a block is written: a thread that still ends after another one has failed must not write
        # into a folder that `close` removes.
        self._writing = threading.Lock()
        # Checked before the lock is made, too: a refused command leaves the folder as it was.
        if not in_use(self.folder):
            self._check(resume, force)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._closed = False
            self._lock = FileLock(self.folder / "lock")
            self._lock.acquire(timeout=_PATIENCE)
        except Timeout:
            raise self.ERROR(self._running(self.result)) from None
        except OSError as error:
            raise self.ERROR(
                f"{self.result}: cannot be made ({error.strerror or error}); choose another place with --out"
            ) from error
        try:
            self._check(resume, force)
            if not resume:
                self._remove_states()
                identity_text = exact_json.dumps(self.identity).encode("utf-8")
                write_file(self.folder / self._FILE, identity_text, self.ERROR)
        except BaseException:
            self.close()
            raise

    @classmethod
    def check_start(cls, result: str | Path, *, resume: bool, force: bool) -> None:
        """Refuse early: no place for a result, another process works on it, blocks are in the way or lack."""
        check_place(result, cls.ERROR)
        if in_use(cls.folder_of(result)):
            raise cls.ERROR(cls._running(result))
        cls._check_states(result, resume, force)

    def _check(self, resume: bool, force: bool) -> None:
        self._check_states(self.result, resume, force)
        if resume:
            self.take_up()

    @classmethod
    def _check_states(cls, result: str | Path, resume: bool, force: bool) -> None:
        folder = cls.folder_of(result)
        kept = cls.kept(folder)
        if resume and not kept:
            ended = f" (the {cls.WHAT} {result} is finished)" if Path(result).exists() else ""
            raise cls.ERROR(f"{folder} holds nothing to continue{ended}; start without --resume")
        if kept and not (resume or force):
            raise cls.ERROR(
                f"{folder}: an unfinished {cls.WHAT} is there; continue it with --resume, or discard it with "
                "--force"
            )

    def take_up(self) -> None:
        """Check the identity, and keep the stored one: it is the one of the blocks."""
        try:
            stored = exact_json.loads((self.folder / self._FILE).read_text(encoding="utf-8"))
            if not isinstance(stored, dict):
                raise ValueError(f"{self._FILE} holds no identity")
        except (OSError, ValueError) as error:
            refusal = f"{self.folder}: cannot be continued ({error}); discard it with --force"
            raise self.ERROR(refusal) from error
        self.refuse_other(stored)
        self.identity = stored

    def refuse_other(self, stored: Mapping[str, object], but: Collection[str] = ()) -> None:
        """Refuse an identity that differs from this result's in a key that is not one of `but`."""
        for key in {**stored, **self.identity}:
            now, then = self.identity.get(key), stored.get(key)
            if key not in but and now != then:
                raise self.ERROR(
                    f"{self.folder}: cannot be continued because the {key.replace('_', ' ')} differs (now "
                    f"{_short(now)}, then {_short(then)}); restore it, or start again with --force"
                )

    def _remove_states(self) -> None:
        try:
            for path in self.folder.glob(self.STATES):
                path.unlink(missing_ok=True)
        except OSError as error:
            why = error.strerror or error
            raise self.ERROR(f"{self.folder}: cannot be removed ({why}); delete this folder") from error

    def discard(self) -> None:
        """Remove everything: the result is written, so that a folder that stays is only noticed."""
        try:
            self._remove_states()
        except self.ERROR as error:
            notice("states-left", f"{self.result} is written, but {error}")
        self.close()

    def close(self) -> None:
        """Let other processes in, once; a folder without blocks is removed."""
        with self._writing:
            if self._closed:
                return
            self._closed = True
        self._lock.release()
        if not self.kept(self.folder):
            shutil.rmtree(self.folder, ignore_errors=True)

    @classmethod
    def folder_of(cls, result: str | Path) -> Path:
        """Return the folder in which the blocks of an unfinished result lie."""
        path = Path(result)
        return path.parent / (path.name + cls.SUFFIX)

    @classmethod
    def kept(cls, folder: Path) -> bool:
        """Return whether a folder has blocks."""
        return any(folder.glob(cls.STATES))

    @classmethod
    def _running(cls, result: str | Path) -> str:
        return f"{result}: another process is working on this {cls.WHAT}; wait for it, or choose --out"

    def load(self, name: str) -> Columns | None:
        """Return a finished block, None where it must be computed (again)."""
        path = self.folder / f"{name}.npz"
        if not path.is_file():
            return None
        try:
            with np.load(path) as file:
                if str(file["block"]) != self._block(name):
                    raise ValueError("it is no block of this result")
                return tuple(file[f"arr_{i}"] for i in range(len(file.files) - 1))
        except DAMAGE as error:
            self.damaged(name, error)
            return None

    def damaged(self, name: str, error: BaseException) -> None:
        """Note that a block cannot be used."""
        path = self.folder / f"{name}.npz"
        self.notes.append(f"{path}: damaged ({error}), so it is computed again")

    def _block(self, name: str) -> str:
        """Return what a block's file states, so that no file of another name, result or program is one."""
        return digest([self.identity, name])

    def save(self, name: str, columns: Columns) -> None:
        """Keep a finished block."""
        buffer = io.BytesIO()
        np.savez(buffer, *columns, block=np.array(self._block(name)))
        with self._writing:
            if not self._closed:
                write_file(self.folder / f"{name}.npz", buffer.getvalue(), self.ERROR)


def in_use(folder: Path) -> bool | None:
    """Return whether a process holds the lock of a folder of blocks; no lock is made for that.

    None where the lock may not be opened (another user's, or on a read-only disk).
    """
    if not (folder / "lock").exists():
        return False
    lock = FileLock(folder / "lock")
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return True
    except OSError:
        return None
    lock.release()
    return False


def _short(value: object) -> str:
    text = "nothing" if value is None else str(value)
    return text if len(text) <= 40 else f"{text[:12]}…"


@dataclass(frozen=True)
class Computing:
    """Where blocks of rows are computed, and who hears of them.

    `where` computes, on `threads` cores of this process, which do not change the result. `store` has finished
    blocks and keeps the others. `on_block` is called in the caller's thread with the rows of each block and
    whether it was computed now. `stop` is asked between blocks; True ends the work. Where a result takes
    several computations, the names of this one's stored blocks begin with `part`.
    """

    where: Executor = field(default_factory=LocalThreads)
    threads: int | None = None
    store: BlockStore | None = None
    on_block: Callable[[int, bool], None] = lambda rows, new: None
    stop: Callable[[], bool] = lambda: False
    part: str = ""

    def blocks(self, work: Work, blocks: Mapping[str, FloatArray]) -> dict[str, Columns]:
        """Compute the rows (n, k) of every block that is not stored; return columns by the block's name.

        Some are missing only where `stop` ended the work.
        """
        store = self.store
        done: dict[str, Columns] = {}
        todo: list[str] = []
        for name, rows in blocks.items():
            kept = store.load(self.part + name) if store is not None else None
            if kept is None:
                todo.append(name)
            else:
                done[name] = kept
                self.on_block(len(rows), False)
        shared = self.where.share(work)

        def compute(name: str) -> Columns | None:
            return None if self.stop() else shared(blocks[name])

        with ThreadPoolExecutor(self.where.at_once) as pool:
            waiting: dict[Future[Columns | None], str] = {pool.submit(compute, name): name for name in todo}
            try:
                for future in as_completed(waiting):
                    name, columns = waiting[future], future.result()
                    if columns is not None:
                        if store is not None:
                            store.save(self.part + name, columns)
                        done[name] = columns
                        self.on_block(len(blocks[name]), True)
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        return done


def digest(value: object) -> str:
    """Return the SHA-256 of anything that JSON can store, for an identity."""
    return hashlib.sha256(exact_json.dumps(value, indent=None).encode("utf-8")).hexdigest()
