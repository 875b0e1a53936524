"""A log file as detection and the readers see it: checked once, hashed once, read once."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path

from sysid.errors import LogError
from sysid.journal import Finding
from sysid.loaders.options import LogOptions
from sysid.loaders.text import decode, without_separator
from sysid.recording import Provenance, file_sha256

_HEAD_BYTES = 65536


class Source:
    """One file on disk, ordinary, readable and not empty; else a LogError.

    `path` is the file as it was named, with which every message begins; `head` are its first 64 KiB, enough
    for detection by content.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = str(path)
        self._file = Path(path)
        self._sha256 = ""
        try:
            if self._file.is_dir():
                raise LogError(f"{self.path} is a folder; give the log file inside it")
            if not self._file.exists():
                raise LogError(
                    f"{self.path}: no such file; check the path, which counts from the current folder"
                )
            if not self._file.is_file():
                raise LogError(f"{self.path} is not an ordinary file; copy the log to one first")
            with self._file.open("rb") as stream:
                self.head = stream.read(_HEAD_BYTES)
        except (OSError, ValueError) as error:  # ValueError: a NUL byte inside the path
            raise LogError(f"{self.path}: cannot be read ({error}); check its permissions") from error
        if not self.head:
            raise LogError(f"{self.path}: the file is empty (0 bytes); export or copy the log again")

    def read_bytes(self) -> bytes:
        """Return the whole content, hashing it on the way; not kept, so that memory is freed early."""
        try:
            data = self._file.read_bytes()
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read ({error}); check its permissions") from error
        self._sha256 = hashlib.sha256(data).hexdigest()
        return data

    @property
    def sha256(self) -> str:
        """SHA-256 of the file's bytes as hex."""
        if not self._sha256:
            self._sha256 = file_sha256(self._file)
        return self._sha256

    @cached_property
    def head_lines(self) -> tuple[str, ...]:
        """Lines of `head` as text without their line ends; none for a binary file."""
        try:
            text = without_separator(decode(self.head, self.path, partial=True))
        except LogError:
            return ()
        if "\0" in text:
            return ()
        return tuple(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"))

    def provenance(
        self,
        format: str,
        *,
        device: str = "",
        options: LogOptions | Mapping[str, object] | None = None,
        notes: Sequence[Finding] = (),
    ) -> Provenance:
        """Return where a recording read from this file comes from; options left at None are not listed."""
        if isinstance(options, LogOptions):  # which rows are kept is not a matter of what they hold
            options = {name: value for name, value in vars(options).items() if name != "time_back"}
        given = {name: str(value) for name, value in (options or {}).items() if value is not None}
        return Provenance(self.path, self.sha256, format, device, given, tuple(notes))
