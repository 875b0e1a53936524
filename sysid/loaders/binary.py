"""Binary logs: libraries that an installation may lack, and headers that promise more than a file has."""

from __future__ import annotations

import ctypes
import io
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from sysid.errors import LogError, SysidError
from sysid.journal import Finding, note
from sysid.loaders.source import shortened


def library(path: str, module: str, package: str) -> ModuleType:
    """Return an optional library; LogError, which names the extra that brings it, without it."""
    try:
        return import_module(module)
    except ImportError as error:
        raise LogError(
            f"{path}: reading this format needs {package} ({error}); install it with: "
            'python -m pip install "sysid[logs]"'
        ) from error


@contextmanager
def reading(path: str, what: str, remedy: str) -> Iterator[None]:
    """Refuse a file (`what`) whose parser fails: of a damaged file parsers let anything through."""
    try:
        yield
    except SysidError:
        raise
    except Exception as error:
        words = shortened(" ".join(str(error).split()), 200) or type(error).__name__
        raise LogError(f"{path}: {what} is damaged or cut ({words}); {remedy}") from error


# A file may unpack to 20 times its size, and any file to 256 MB.
_GAIN, _SMALL = 20, 1 << 28
_LIMIT = threading.Lock()


def most_bytes(size: int) -> float:
    """Return how many bytes the numbers of a file of `size` bytes may take."""
    return float(max(_GAIN * size, _SMALL))


def check_claim(path: str, what: str, claimed: float, there: float) -> None:
    """Refuse a damaged header, which claims more bytes for something than there are, before any are taken."""
    if claimed > there:
        raise LogError(
            f"{path}: {what} claims {claimed:.4g} bytes where the file has at most {there:.4g} for it; it is "
            "damaged; copy or export it again"
        )


@contextmanager
def bounded_memory(most: float) -> Iterator[None]:
    """Let this process take at most this much more memory [bytes]; only Linux keeps such a limit.

    A library in C may believe a length before it looks for that many bytes. There is one limit at a time: a
    second one in another thread leaves the first.
    """
    pages = Path("/proc/self/statm")
    if not pages.exists() or not _LIMIT.acquire(blocking=False):
        yield
        return
    import resource  # not on Windows

    before = resource.getrlimit(resource.RLIMIT_AS)
    now = int(pages.read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    lowest = [now + int(most), *(limit for limit in before if limit != resource.RLIM_INFINITY)]
    try:
        resource.setrlimit(resource.RLIMIT_AS, (min(lowest), before[1]))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
        _LIMIT.release()


# A load may take a minute and a second more for each 500 kB: thirty times what a whole file takes.
_TIME, _TIME_PER_BYTE = 60.0, 2e-6


class _OverdueError(BaseException):
    """Raised inside a load that takes too long; a parser's ``except Exception`` does not catch it."""


@contextmanager
def bounded_time(path: str) -> Iterator[None]:
    """Refuse a file whose load computes far longer than its size explains, in any thread and on any system.

    Counted is the processor time of the process, so that a busy machine or a laptop that sleeps refuses no
    file. A library in C is stopped when it returns to Python. What could keep it for ever is refused before,
    by `sysid.loaders.hdf5` and `sysid.loaders.readers.ros_bag`.
    """
    size = Path(path).stat().st_size
    most = _TIME + _TIME_PER_BYTE * size
    thread, ended, lock = ctypes.c_ulong(threading.get_ident()), threading.Event(), threading.Lock()
    raise_there, last = ctypes.pythonapi.PyThreadState_SetAsyncExc, time.process_time() + most

    def watch() -> None:
        while not ended.wait(max(last - time.process_time(), 0.0)):
            with lock:
                if not ended.is_set() and time.process_time() >= last:
                    raise_there(thread, ctypes.py_object(_OverdueError))
                    return

    threading.Thread(target=watch, daemon=True).start()
    try:
        try:
            yield
        finally:
            with lock:
                ended.set()
            raise_there(thread, None)  # where it has not arrived yet
    except _OverdueError:
        raise LogError(
            f"{path}: not read after {most:.3g} s of processor time, far longer than {size / 1e6:.3g} MB "
            "explain; the file is damaged, so copy or export it again"
        ) from None


def length_note(stated: int, there: int) -> list[Finding]:
    """Return a note where a file has another length than it states, so that what follows the place moved."""
    sentence = f"the file has {there} bytes and its headers tell of {stated}: bytes were lost or added"
    return [] if stated == there else [note("other-length", f"{sentence}, so check the numbers")]


class _Bounded(io.BufferedReader):
    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._size = path.stat().st_size

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(self._size - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))


class BoundedPath(type(Path())):  # type: ignore[misc]
    """A path whose file is asked for no more bytes than it has, however long a damaged record says it is."""

    def open(self, *_: Any, **__: Any) -> io.BufferedReader:
        """Open the file for reading, as bytes."""
        return _Bounded(self)
