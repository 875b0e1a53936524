"""Binary logs: libraries that an installation may lack, and damage on which a parser fails or never ends."""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType

from sysid.errors import LogError

# What begins a global heap of an HDF5 file, and the bytes before each of its texts.
_HEAP, _HEAD = b"GCOL\x01\0\0\0", 16
# What parsers of binary files let through on a damaged file besides errors of their library.
_DAMAGE = (
    OSError, ValueError, KeyError, IndexError, TypeError, AttributeError, AssertionError, RuntimeError,
    OverflowError, MemoryError, EOFError, struct.error, zlib.error,
)  # fmt: skip


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
def reading(path: str, what: str, remedy: str, *errors: type[Exception]) -> Iterator[None]:
    """Refuse a file (`what`) whose parser fails, by `errors` of its library or by what it lets through."""
    damage: tuple[type[Exception], ...] = (*errors, *_DAMAGE)
    try:
        yield
    except damage as error:
        words = " ".join(str(error).split())[:200] or type(error).__name__
        raise LogError(f"{path}: {what} is damaged or cut ({words}); {remedy}") from error


def check_heaps(path: str) -> None:
    """Refuse an HDF5 file whose heaps of texts cannot be walked to their end (lengths of 8 bytes).

    Each text in a heap states its length. The HDF5 library walks from text to text, and a free space that
    states no length keeps it at one place for ever, where no caller can stop it.
    """
    try:
        with Path(path).open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            start = data.find(_HEAP)
            while start >= 0:
                if not _walkable(data, start):
                    raise LogError(
                        f"{path}: HDF5 file is damaged: the list of texts at byte {start} has no end; "
                        "copy or export it again"
                    )
                start = data.find(_HEAP, start + 1)
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: cannot be read ({error}); check its permissions") from error


def _walkable(data: mmap.mmap, start: int) -> bool:
    if start + _HEAD > len(data):
        return True  # the file is cut, which the library itself sees
    (size,) = struct.unpack_from("<Q", data, start + 8)
    end = start + size
    if end > len(data):
        return True
    place = start + _HEAD
    while place + _HEAD <= end:
        index, _, _, length = struct.unpack_from("<HHIQ", data, place)
        step = length if index == 0 else _HEAD + (length + 7) // 8 * 8
        if step < _HEAD or step % 8 or place + step > end:
            return False
        place += step
    return True
