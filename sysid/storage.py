"""Files and folders that are there whole or not at all, and HDF5 files that say what they are.

New content goes to a temporary name next to its destination and takes that name only when it is complete on
disk; then the disk is asked to keep the folder's names. A full disk, an error or Ctrl-C leaves the earlier
content and nothing else; a killed process may leave a file or folder whose name starts with a dot and ends in
``.part``. While a folder is replaced (``--force``), its name is free for the instant between two renames:
after a kill just then, the earlier content lies whole in ``.NAME.old.*.part``.

An HDF5 file of sysid has the attributes ``schema`` and ``version``; its numeric datasets have ``axes`` and
``unit``; JSON texts have the rest. It is built in memory and written by `write_file`, because the
HDF5 library ends the process on a full disk.
"""

import io
import math
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import ArrayLike

from sysid import exact_json
from sysid.errors import SysidError
from sysid.types import FloatArray

# Number of tries to replace a file while the system refuses.
_TRIES = 20
# Time between two tries [s].
_PAUSE = 0.05
# Largest ratio of an array's size to the bytes that store it [1]: deflate packs no better.
_LARGEST_GAIN = 1032
# The errors of h5py on a damaged file depend on where the damage lies.
_DAMAGE = (
    OSError, LookupError, ValueError, TypeError, RuntimeError, AttributeError, MemoryError, OverflowError,
    SysidError,
)  # fmt: skip


def _sentence(path: Path, error: BaseException) -> str:
    folder = path.parent
    if not folder.is_dir():
        what = "is not a folder" if folder.exists() else "does not exist"
        return f"{path}: cannot be written: the folder {folder} {what}; make it first or choose another place"
    why = getattr(error, "strerror", None) or str(error).splitlines()[0]
    freed = "" if isinstance(error, PermissionError) else "free some space or "
    return (
        f"{path}: cannot be written ({why}); what was there before is unchanged: {freed}choose another place"
    )


def path_of(given: object, what: str = "a file or folder") -> Path:
    """Return the path that a caller gives; SysidError for what no system takes as one."""
    if not isinstance(given, str | os.PathLike) or not isinstance(os.fspath(given), str) or not str(given):
        raise SysidError(f"expected the path of {what} as text or a Path, found {given!r:.60}").also(
            TypeError
        )
    path = Path(given)
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        pass
    except (OSError, ValueError) as error:  # too long a name, a NUL byte
        why = getattr(error, "strerror", None) or error
        raise SysidError(f"{str(path)[:60]!r}… is no path ({why}); name {what}") from error
    return path


def write_file(path: str | Path, data: bytes, error_type: type[SysidError] = SysidError) -> None:
    """Write a file whole; `error_type`, and an existing file unchanged, where that is impossible."""
    write_files({Path(path): data}, error_type)


def write_files(files: Mapping[Path, bytes], error_type: type[SysidError] = SysidError) -> None:
    """Write files that belong together: all are complete on disk before the first takes its name."""
    temporary: dict[Path, Path] = {}
    path = next(iter(files))
    try:
        for path, data in files.items():
            handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent)
            temporary[path] = Path(name)
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            _open_to_others(temporary[path])
        for path, new in temporary.items():
            replace_file(new, path)
        for folder in {path.parent for path in files}:
            _keep_names(folder)
    except OSError as error:
        raise error_type(_sentence(path, error)) from error
    finally:
        for new in temporary.values():
            with suppress(OSError):
                new.unlink(missing_ok=True)


def replace_file(new: Path, path: Path) -> None:
    """Give a complete file, or a folder, its name.

    Windows refuses while a virus scanner or another command reads either; that passes within a second.
    """
    for _ in range(_TRIES):
        try:
            os.replace(new, path)
            return
        except PermissionError:
            time.sleep(_PAUSE)
    os.replace(new, path)


def _keep_names(folder: Path) -> None:
    """Let the disk keep the names in a folder, so that no loss of power undoes a rename.

    Windows opens no folder for that; NTFS keeps names in its own order.
    """
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _open_to_others(path: Path) -> None:
    # mkstemp and mkdtemp make private files; a result has the rights of any file the user makes.
    mask = os.umask(0)
    os.umask(mask)
    path.chmod((0o777 if path.is_dir() else 0o666) & ~mask)


@contextmanager
def replaced_folder(
    path: str | Path, *, force: bool, marker: str, error_type: type[SysidError] = SysidError
) -> Iterator[Path]:
    """Give a temporary folder that becomes `path`, whose parents are made, when the block ends well.

    `force` replaces an existing folder as a whole, if the file `marker` is in it. Raises `error_type`, with
    nothing changed, when the folder exists and may not be replaced, or cannot be written.
    """
    path = Path(path)
    check_folder(path, force=force, marker=marker, error_type=error_type)
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".part", dir=path.parent))
        yield temporary
        for file in filter(Path.is_file, temporary.rglob("*")):
            with open(file, "rb+") as stream:
                os.fsync(stream.fileno())
        _open_to_others(temporary)
        _keep_names(temporary)
        _swap(temporary, path)
        _keep_names(path.parent)
    # h5py reports a failing disk as RuntimeError when it closes a file.
    except (OSError, RuntimeError) as error:
        raise error_type(_sentence(path, error)) from error
    finally:
        if temporary is not None and temporary.exists():
            shutil.rmtree(temporary, ignore_errors=True)


def check_place(path: str | Path, error_type: type[SysidError] = SysidError) -> None:
    """Refuse a place whose name a result cannot take: the current folder, a root, a link, too long a name."""
    path = Path(path)
    if path.name in ("", ".."):
        raise error_type(f"{path}: no result can take the place of this folder; name a new one inside it")
    try:
        path.lstat()
        target = os.readlink(path) if path.is_symlink() else ""
    except (FileNotFoundError, NotADirectoryError):
        return
    except (OSError, ValueError) as error:  # ValueError: a NUL byte inside the path
        why = getattr(error, "strerror", None) or error
        raise error_type(f"{str(path)[:100]}: cannot be written ({why}); choose another name") from error
    if target:
        raise error_type(f"{path}: is a symbolic link to {target}; name the folder or file itself")


def check_folder(
    path: str | Path, *, force: bool, marker: str, error_type: type[SysidError] = SysidError
) -> None:
    """Refuse a result folder that exists, unless `force` is set and `marker` is in it."""
    path = Path(path)
    check_place(path, error_type)
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        return
    if not force:
        replaced = " or replace it with --force (in Python: force=True)" if (path / marker).is_file() else ""
        raise error_type(f"{path} exists already; choose a new name{replaced}")
    if not (path / marker).is_file():
        raise error_type(
            f"{path} holds no {marker}, so it is not a result folder and is not replaced; choose a new name"
        )


def _swap(new: Path, path: Path) -> None:
    if not path.exists():
        replace_file(new, path)
        return
    # No portable call replaces a folder that is not empty. A kill between the two renames leaves the old
    # folder whole, and the new one complete, under their temporary names.
    aside = Path(tempfile.mkdtemp(prefix=f".{path.name}.old.", suffix=".part", dir=path.parent))
    try:
        replace_file(path, aside / path.name)
        try:
            replace_file(new, path)
        except OSError:
            os.replace(aside / path.name, path)
            raise
    finally:
        # A second pass removes what a passing fault of the disk has kept from the first.
        for _ in range(2):
            shutil.rmtree(aside, ignore_errors=True)


def check_file(path: str | Path, *, force: bool, error_type: type[SysidError] = SysidError) -> None:
    """Refuse a result file that exists, unless `force`, that is a folder, or whose folder takes no file."""
    path = Path(path)
    check_place(path, error_type)
    if path.is_dir():
        raise error_type(f"{path}: is a folder; name a file in it")
    if path.exists() and not force:
        raise error_type(f"{path}: exists already; choose a new name or add --force (in Python: force=True)")
    try:
        tempfile.TemporaryFile(dir=path.resolve().parent).close()
    except OSError as error:
        raise error_type(_sentence(path, error)) from error


@dataclass(frozen=True)
class FileKind:
    """A kind of HDF5 file, by its attributes `schema` and `version`.

    A refusal is an `error_type`; it calls the file `what` (``a fit``) and advises the `remedy` (``run the fit
    again``).
    """

    schema: str
    version: int
    what: str
    remedy: str
    error_type: type[SysidError] = SysidError

    def content(self, write: Callable[[h5py.File], object]) -> bytes:
        """Return a file's bytes; `write` fills the open file."""
        buffer = io.BytesIO()
        with h5py.File(buffer, "w") as file:
            file.attrs["schema"], file.attrs["version"] = self.schema, self.version
            write(file)
        return buffer.getvalue()

    @contextmanager
    def opened(self, path: str | Path, content: bytes | None = None) -> Iterator[h5py.File]:
        """Open a file of this kind, or its content, for reading.

        Raises `error_type` when it is missing, foreign, of another version, damaged or cut off, also where
        only the block notices that.
        """
        if content is None and not Path(path).is_file():
            raise self.error_type(f"{path}: no such file; name {self.what} of sysid")
        try:
            with h5py.File(path if content is None else io.BytesIO(content), "r") as file:
                if file.attrs.get("schema") != self.schema:
                    raise self.error_type(f"{path}: not {self.what} of sysid; {self.remedy}")
                if file.attrs.get("version") != self.version:
                    raise self.error_type(
                        f"{path}: {self.what} of version {file.attrs.get('version')}, expected "
                        f"{self.version}; read it with the version of sysid that wrote it, or {self.remedy}"
                    )
                _check_content(file)
                yield file
        except self.error_type:
            raise
        except _DAMAGE as error:
            first = next(iter(str(error).splitlines()), type(error).__name__)
            raise self.error_type(f"{path}: damaged or cut off ({first}); {self.remedy}") from error


def _check_content(file: h5py.File) -> None:
    """Refuse (ValueError) what sysid never writes: links, data elsewhere, more values than bytes for them."""
    # An exception inside would be lost in the library. Its objects take a tenth of the time of h5py's.
    found: list[tuple[bytes, int]] = []
    file.id.links.visit(lambda key, link: found.append((key, link.type)), info=True)
    for key, kind in found:
        name = key.decode(errors="replace")
        if kind != h5py.h5l.TYPE_HARD:
            raise ValueError(f"{name} is a link")
        item = h5py.h5o.open(file.id, key)
        if not isinstance(item, h5py.h5d.DatasetID):
            continue
        made, size = item.get_create_plist(), math.prod(item.shape or (0,))
        if made.get_layout() == h5py.h5d.VIRTUAL or made.get_external_count():
            raise ValueError(f"{name} lies in another place")
        if item.dtype.kind not in "iufb" and h5py.check_string_dtype(item.dtype) is None:
            raise ValueError(f"{name} has neither numbers nor text")
        if size * item.dtype.itemsize > _LARGEST_GAIN * item.get_storage_size():
            raise ValueError(f"{name} claims more values than the file has bytes for")


def schema_of(path: Path, error_type: type[SysidError] = SysidError) -> str:
    """Return the schema of an HDF5 file; nothing for a file of others, `error_type` for a damaged one."""
    try:
        with h5py.File(path, "r") as file:
            return str(file.attrs.get("schema", ""))
    except OSError as error:
        first = next(iter(str(error).splitlines()), "")
        raise error_type(f"{path}: damaged or cut off ({first}); write it again") from error


def put(group: h5py.Group, name: str, values: ArrayLike, axes: str, unit: str = "1") -> None:
    """Write an array of numbers with the names of its axes and its unit.

    It has checksums, so that reading a flipped bit fails; a long one is compressed.
    """
    data = np.asarray(values)
    packed: dict[str, Any] = {"fletcher32": True} if data.ndim and data.size else {}
    if data.size > 64:
        packed |= {"compression": "gzip", "shuffle": True}
    dataset = group.create_dataset(name, data=data, **packed)
    dataset.attrs["axes"], dataset.attrs["unit"] = axes, unit


def put_texts(group: h5py.Group, name: str, texts: str | Iterable[str]) -> None:
    """Write a text, or a list of texts."""
    data = texts if isinstance(texts, str) else list(texts)
    group.create_dataset(name, data=data, dtype=h5py.string_dtype())


def put_json(group: h5py.Group, name: str, value: object) -> None:
    """Write a value as exact JSON; an attribute has room for 64 kB at most."""
    put_texts(group, name, exact_json.dumps(value, indent=None))


def get_texts(group: h5py.Group, name: str) -> Any:
    """Return a text of `put_texts`, or an array of texts."""
    return group[name].asstr()[()]


def get_json(group: h5py.Group, name: str) -> Any:
    """Return a value of `put_json`."""
    return exact_json.loads(get_texts(group, name))


def numbered(file: h5py.Group, name: str) -> list[h5py.Group]:
    """Return the groups ``NAME/1``, ``NAME/2``, … in order."""
    return [file[f"{name}/{i + 1}"] for i in range(len(file.get(name, ())))]


def datasets(file: h5py.File) -> dict[str, FloatArray]:
    """Return all arrays of a file by their path."""
    arrays: dict[str, FloatArray] = {}

    def take(path: str, item: h5py.Dataset | h5py.Group) -> None:
        if isinstance(item, h5py.Dataset):
            arrays[path] = item[()]

    file.visititems(take)
    return arrays
