"""A disk that fails, fills up, or stops the process, at one chosen operation that changes a folder."""

import errno
import io
import os
import tempfile
from contextlib import contextmanager

# What changes a disk, beside `tempfile` and `io.open`, by which `pathlib` and `os.fdopen` open for writing.
_CALLS = ("replace", "rename", "unlink", "rmdir", "mkdir", "fsync", "chmod", "link", "symlink")
KINDS = ("fails", "half", "full", "killed")


class Killed(BaseException):
    """The process has ended: nothing that follows changes the disk, cleaning up included."""


class Disk:
    """Counts operations that change the disk; the one numbered `at` (from 0) meets a fault of a kind.

    ``fails``: the device reports an error (EIO). ``full``: nothing is written (ENOSPC). ``half``: half of the
    bytes are written, then the disk is full. ``killed``: half of them are written, then the process ends.
    """

    def __init__(self, at=-1, kind="fails"):
        self.at, self.kind, self.count, self.dead = at, kind, 0, False
        self.names = []

    def meets(self, name):
        """Count an operation and return whether the fault is now."""
        if self.dead:
            raise Killed
        self.names.append(name)
        self.count += 1
        return self.count - 1 == self.at

    def fault(self):
        if self.kind == "killed":
            self.dead = True
            raise Killed
        code = errno.EIO if self.kind == "fails" else errno.ENOSPC
        raise OSError(code, os.strerror(code))


class _Stream:
    def __init__(self, disk, stream):
        self._disk, self._stream = disk, stream

    def write(self, data):
        if self._disk.meets("write"):
            if self._disk.kind in ("half", "killed"):
                self._stream.write(data[: len(data) // 2])
                self._stream.flush()
            self._disk.fault()
        return self._stream.write(data)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._stream.close()

    def __getattr__(self, name):
        return getattr(self._stream, name)


@contextmanager
def faulty(monkeypatch, disk):
    """Let the operations of this process meet the faults of a `Disk` while the block runs."""

    def counted(name, real):
        def call(*arguments, **more):
            if disk.meets(name):
                disk.fault()
            return real(*arguments, **more)

        return call

    def opened(file, mode="r", *arguments, **more):
        if not set(mode) & set("wax+"):
            return real_open(file, mode, *arguments, **more)
        if not isinstance(file, int) and disk.meets("open"):
            disk.fault()
        return _Stream(disk, real_open(file, mode, *arguments, **more))

    real_open = io.open
    with monkeypatch.context() as patch:
        patch.setattr(io, "open", opened)
        for name in _CALLS:
            patch.setattr(os, name, counted(name, getattr(os, name)))
        for name in ("mkstemp", "mkdtemp"):
            patch.setattr(tempfile, name, counted(name, getattr(tempfile, name)))
        yield disk
