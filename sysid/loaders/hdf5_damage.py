"""Damage in an HDF5 file on which the HDF5 library itself never ends.

Texts of an HDF5 file lie in global heaps, lists of objects each of which says how long it is. The library
walks such a list to the end of its heap, and a free space that claims no length keeps it at one place for
ever, where no caller can stop it. So the lists are walked here first.
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path

from sysid.errors import LogError

_HEAP = b"GCOL\x01\0\0\0"
_HEAD = 16


def check_heaps(path: str) -> None:
    """Refuse an HDF5 file whose heaps of texts cannot be walked to their end (lengths of 8 bytes)."""
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
