"""Long computations in blocks: computed by an executor, kept on disk one by one, continued after a kill.

Beside the result file ``NAME.h5`` lies ``NAME.h5.blocks`` while it is unfinished: what must be equal for it
to be continued, and one file per finished block, each written whole or not at all.
"""

from __future__ import annotations

import hashlib
import io
import shutil
import zipfile
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from sysid import exact_json
from sysid.errors import ExportError
from sysid.parallel import Columns, Executor, Work
from sysid.storage import write_file
from sysid.types import FloatArray

_IDENTITY = "identity.json"
# For another process that works on the same result [s].
_PATIENCE = 0.3


def blocks_folder(result: Path) -> Path:
    """Return where the finished blocks of an unfinished result lie."""
    return result.with_name(result.name + ".blocks")


class BlockStore:
    """Finished blocks of one result; locked against other processes until `close`.

    Parameters
    ----------
    result : Path
        File that the whole will be written to.
    identity : mapping of str to JSON-able
        What must be equal for it to be continued; the keys are words for a sentence.
    resume : bool
        Use the blocks that are there. Otherwise there must be none, or `force` discards them.
    force : bool
        Discard what is there.

    Raises
    ------
    ExportError
        When another process works on it, blocks are in the way, there are none, or the identity differs.
    """

    def __init__(
        self, result: Path, identity: Mapping[str, Any], *, resume: bool = False, force: bool = False
    ) -> None:
        self.folder = blocks_folder(result)
        self.notes: list[str] = []
        own = exact_json.plain(dict(identity))
        there = self.folder.is_dir() and any(self.folder.glob("*.npz"))
        if there and not (resume or force):
            raise ExportError(
                f"{self.folder}: an unfinished result is there; continue it with --resume, or discard it "
                "with --force"
            )
        if resume and not there:
            raise ExportError(f"{self.folder} holds nothing to continue; start without --resume")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._lock = FileLock(self.folder / "lock")
            self._lock.acquire(timeout=_PATIENCE)
        except Timeout:
            raise ExportError(
                f"{result}: another process is working on it; wait for it, or choose another --out"
            ) from None
        except OSError as error:
            raise ExportError(
                f"{self.folder}: cannot be made ({error.strerror or error}); write to another file with --out"
            ) from error
        try:
            if resume:
                self._check(own)
            else:
                for path in self.folder.glob("*.npz"):
                    path.unlink()
                write_file(self.folder / _IDENTITY, exact_json.dumps(own).encode("utf-8"), ExportError)
        except BaseException:
            self.close()
            raise

    def _check(self, own: Mapping[str, Any]) -> None:
        try:
            stored = exact_json.loads((self.folder / _IDENTITY).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ExportError(
                f"{self.folder}: cannot be continued ({error}); discard it with --force"
            ) from error
        differs = [key for key in {**stored, **own} if stored.get(key) != own.get(key)]
        if differs:
            raise ExportError(
                f"{self.folder}: cannot be continued because {differs[0]} differs; restore it, or start anew "
                "with --force"
            )

    def load(self, name: str) -> Columns | None:
        """Return a finished block, None where it must be computed (again)."""
        path = self.folder / f"{name}.npz"
        if not path.is_file():
            return None
        try:
            with np.load(path) as file:
                return tuple(file[f"arr_{i}"] for i in range(len(file.files)))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            self.notes.append(f"{path}: damaged ({error}), so it is computed again")
            return None

    def save(self, name: str, columns: Columns) -> None:
        """Keep a finished block."""
        buffer = io.BytesIO()
        np.savez(buffer, *columns)
        write_file(self.folder / f"{name}.npz", buffer.getvalue(), ExportError)

    def discard(self) -> None:
        """Remove everything: the result is written."""
        self._lock.release()
        shutil.rmtree(self.folder, ignore_errors=True)

    def close(self) -> None:
        """Let other processes in; a folder without blocks is removed."""
        self._lock.release()
        if not any(self.folder.glob("*.npz")):
            shutil.rmtree(self.folder, ignore_errors=True)


def compute_blocks(
    work: Work,
    blocks: Mapping[str, FloatArray],
    where: Executor,
    *,
    store: BlockStore | None = None,
    on_block: Callable[[int, bool], None] | None = None,
    stop: Callable[[], bool] | None = None,
) -> dict[str, Columns]:
    """Compute the rows of every block that is not kept already.

    Parameters
    ----------
    work : Work
        Rows to columns.
    blocks : mapping of str to (n, k) array
        Rows by the block's name.
    where : Executor
        Whose workers compute.
    store : BlockStore, optional
        What is finished already, and where to keep the others.
    on_block : callable, optional
        Told the rows of each block and whether it was computed now, in the caller's thread.
    stop : callable, optional
        Asked between blocks whether to end.

    Returns
    -------
    dict
        Columns by the block's name; some are missing only where `stop` said so.
    """
    done: dict[str, Columns] = {}
    todo: list[str] = []
    for name, rows in blocks.items():
        kept = store.load(name) if store is not None else None
        if kept is None:
            todo.append(name)
        else:
            done[name] = kept
            if on_block is not None:
                on_block(len(rows), False)
    shared = where.share(work)

    def one(name: str) -> Columns | None:
        return None if stop is not None and stop() else shared(blocks[name])

    with ThreadPoolExecutor(where.at_once) as pool:
        waiting: dict[Future[Columns | None], str] = {pool.submit(one, name): name for name in todo}
        try:
            for future in as_completed(waiting):
                columns = future.result()
                if columns is None:
                    continue
                name = waiting[future]
                if store is not None:
                    store.save(name, columns)
                done[name] = columns
                if on_block is not None:
                    on_block(len(blocks[name]), True)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return done


def digest(value: Any) -> str:
    """Return the SHA-256 of anything that JSON can hold, for an identity."""
    return hashlib.sha256(exact_json.dumps(value, indent=None).encode("utf-8")).hexdigest()
