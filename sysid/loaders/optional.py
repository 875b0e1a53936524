"""Libraries of single formats: an installation need not have them, and a damaged file makes them fail."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from types import ModuleType

from sysid.errors import LogError

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
