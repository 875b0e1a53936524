"""HDF5 logs as all their readers open them: what a file claims is checked before the library believes it.

A link that leads out of the file or to nothing, a dataset that is only a view of others or lies in another
file, and one that claims more samples than its bytes can hold are refused. The library survived 7,500
damaged files in this process (tests/property) but for lists of texts without end, which are checked first.
"""

from __future__ import annotations

import mmap
import posixpath
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sysid.errors import LogError, SysidError
from sysid.loaders.source import Source, length_note, shortened
from sysid.types import FloatArray

if TYPE_CHECKING:
    import h5py

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
# First bytes of a global heap, and length of what precedes each of its texts [bytes].
_HEAP, _HEAD = b"GCOL\x01\0\0\0", 16
# Largest ratio of samples to stored bytes of one signal: compression of a constant gains less.
_LARGEST_GAIN = 1000
# Largest memory for the samples of a file, over the file's size [1].
_GAIN = 20
# Memory that the samples of any file may take, however small the file is [bytes].
_SMALL = 1 << 28
# Held while the limit of memory is set: the process has one.
_LIMIT = threading.Lock()


def is_hdf5(source: Source) -> bool:
    """Return whether a file begins as HDF5 does."""
    # A user block (MATLAB writes one) moves the signature to 512 bytes or a power of two beyond.
    return any(source.head.startswith(_SIGNATURE, start) for start in (0, *(512 << k for k in range(7))))


def _most_bytes(path: str) -> int:
    return max(_GAIN * Path(path).stat().st_size, _SMALL)


def attribute_value(value: object) -> object:
    """Return an attribute as a number or as text, whatever of the two HDF5 wrapped."""
    value = value.item() if isinstance(value, np.ndarray | np.generic) and value.size == 1 else value
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


class Hdf5Log:
    """An open HDF5 log: its `file`, `datasets` by path, and `notes`."""

    def __init__(self, path: str, file: h5py.File) -> None:
        self.path, self.file = path, file
        self._bytes = Path(path).stat().st_size
        self._left = float(_most_bytes(path))
        begin = file.userblock_size
        with Path(path).open("rb") as stream:
            head = stream.read(begin + 48)[begin:]
        # The superblock states the length of the file, at a place of its version; addresses have 8 bytes.
        place, stated = {0: 40, 1: 44, 2: 28, 3: 28}.get(head[8]), self._bytes
        if place is not None and (head[9] if head[8] > 1 else head[13]) == 8:
            (stated,) = struct.unpack_from("<Q", head, place)
        self.notes = length_note(stated, self._bytes)
        self.datasets = self._found()

    def _found(self) -> dict[str, h5py.Dataset]:
        import h5py

        items: dict[str, h5py.HLObject] = {}
        links: dict[str, h5py.HardLink] = {}
        self.file.visititems(lambda name, item: items.setdefault("/" + name, item) and None)
        self.file.visititems_links(lambda name, link: links.setdefault("/" + name, link) and None)
        for name, link in links.items():
            target = ""
            if isinstance(link, h5py.ExternalLink):
                target = f"{shortened(link.filename)}, another file"
            elif isinstance(link, h5py.SoftLink):
                to = posixpath.normpath(posixpath.join(posixpath.dirname(name), link.path))
                if not isinstance(links.get(to), h5py.HardLink):
                    target = f"{shortened(link.path)}, which is nothing in the file"
            if target:
                raise LogError(
                    f"{self.path}: link {shortened(name)} leads to {target}; write a copy that contains the "
                    "data, for example with h5repack or h5copy"
                )
        return {name: item for name, item in items.items() if isinstance(item, h5py.Dataset)}

    def numbers(self, name: str, dataset: h5py.Dataset, column: int | None = None) -> FloatArray:
        """Return a dataset, or a column of it, as numbers."""
        if dataset.dtype.kind not in "iuf" or dataset.size is None:
            raise LogError(f"{self.path}: dataset {name} is {dataset.dtype}; expected one row of numbers")
        if dataset.is_virtual or dataset.external:
            raise LogError(
                f"{self.path}: dataset {name} is made of other files or datasets; write a copy that contains "
                "the data"
            )
        stored = dataset.id.get_storage_size()
        claimed = float(np.prod(dataset.shape, dtype=float)) * dataset.dtype.itemsize
        for claim, there in ((stored, self._bytes), (claimed, min(_LARGEST_GAIN * stored, self._left))):
            if claim > there:
                raise LogError(
                    f"{self.path}: dataset {name} claims {claim:.4g} bytes where the file has at most "
                    f"{there:.4g} for it; it is damaged; copy or export it again"
                )
        share = 1 if column is None else dataset.shape[1]
        self._left -= claimed / share
        return np.asarray(dataset[()] if column is None else dataset[:, column], dtype=np.float64)


@contextmanager
def _bounded_memory(most: int) -> Iterator[None]:
    """Let this process take at most this much more memory [bytes]; only Linux keeps such a limit.

    The library takes as much memory as the length of a text in an attribute states before it looks for the
    text. There is one limit at a time: a second one in another thread leaves the first.
    """
    pages = Path("/proc/self/statm")
    if not pages.exists() or not _LIMIT.acquire(blocking=False):
        yield
        return
    import resource  # not on Windows

    before = resource.getrlimit(resource.RLIMIT_AS)
    now = int(pages.read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    lowest = [now + most, *(limit for limit in before if limit != resource.RLIM_INFINITY)]
    try:
        resource.setrlimit(resource.RLIMIT_AS, (min(lowest), before[1]))
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
        _LIMIT.release()


@contextmanager
def open_hdf5(source: Source, remedy: str) -> Iterator[Hdf5Log]:
    """Open an HDF5 log, refusing one that is none or is damaged, also while it is read."""
    import h5py

    if not is_hdf5(source):
        raise LogError(f"{source.path}: not an HDF5 file (its signature is missing); check the format")
    try:
        _check_heaps(source.path)
        # Copies of the numbers exist beside them while they are read.
        most = 3 * _most_bytes(source.path)
        with _bounded_memory(most), h5py.File(source.path, "r") as file:
            yield Hdf5Log(source.path, file)
    except SysidError:
        raise
    except Exception as error:  # the library lets anything through from a damaged file
        words = shortened(" ".join(str(error).split()), 200) or type(error).__name__
        raise LogError(f"{source.path}: HDF5 file is damaged or cut ({words}); {remedy}") from error


def _check_heaps(path: str) -> None:
    """Refuse an HDF5 file whose heaps of texts cannot be walked to their end (lengths of 8 bytes).

    Each text in a heap states its length. The HDF5 library walks from text to text, and a free space that
    states no length keeps it at one place for ever, where no caller can stop it.
    """
    with Path(path).open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        start = data.find(_HEAP)
        while 0 <= start <= len(data) - _HEAD:  # a file that is cut is seen by the library itself
            place, end = start + _HEAD, start + int(struct.unpack_from("<Q", data, start + 8)[0])
            while place + _HEAD <= end <= len(data):
                index, _, _, length = struct.unpack_from("<HHIQ", data, place)
                step = length if index == 0 else _HEAD + (length + 7) // 8 * 8
                if step < _HEAD or step % 8 or place + step > end:
                    raise LogError(
                        f"{path}: HDF5 file is damaged: the list of texts at byte {start} has no end; "
                        "copy or export it again"
                    )
                place += step
            start = data.find(_HEAP, start + 1)
