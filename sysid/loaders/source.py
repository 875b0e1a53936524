"""A log file as detection and the readers see it: checked once, hashed once, read once, as bytes or as text.

Every text format reads through here, so that a byte-order mark, a UTF-16 export, a carriage return or a
semicolon means the same everywhere. `sysid.loaders.table` reads the tables of numbers inside.
"""

from __future__ import annotations

import codecs
import csv
import hashlib
import io
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from sysid.errors import LogError, printable
from sysid.journal import Finding, note
from sysid.loaders.options import LogOptions
from sysid.recording import Provenance, file_sha256

_HEAD_BYTES = 65536
_DELIMITERS = ",;\t"
SPACES = " "
# A line of fewer words than this may be prose: its spaces part no columns.
_FEWEST_WORDS = 4
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
# Line before a table by which Excel tells itself the character between cells, without the line's end.
_SEPARATOR = re.compile(rb'\A[ ]*"?sep=[^\r\n"]?"?[,;\t ]*(?=[\r\n])', re.IGNORECASE)
# Most characters of a sentence about a log. A longer one keeps its end, which says what to do.
_LONGEST = 1200
# Bytes that show the encoding.
_SAMPLE = 4096
# Bytes that are decoded at once, and bytes of the longest line: a header of ten thousand columns is shorter.
_PIECE, _LINE = 1 << 20, 1 << 20


# First bytes (at a place) of files that are no log, what they are, and what to do with them.
_WORKBOOK = "save its sheet as CSV"
_UNPACK = "unpack it and give the log inside"
_EXPORT = "export the numbers themselves as CSV"
_FOREIGN = (
    (0, b"%PDF", "a PDF", _EXPORT),
    (0, b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "an old Excel workbook or Office document", _WORKBOOK),
    (0, b"PK\x03\x04", "a ZIP archive", _UNPACK),
    (0, b"PK\x05\x06", "an empty ZIP archive", _UNPACK),
    (0, b"\x1f\x8b", "a gzip archive", _UNPACK),
    (0, b"BZh", "a bzip2 archive", _UNPACK),
    (0, b"7z\xbc\xaf\x27\x1c", "a 7z archive", _UNPACK),
    (0, b"Rar!\x1a\x07", "a RAR archive", _UNPACK),
    (0, b"\xfd7zXZ\x00", "an xz archive", _UNPACK),
    (257, b"ustar", "a tar archive", _UNPACK),
    (0, b"\x89PNG\r\n", "a PNG image", _EXPORT),
    (0, b"\xff\xd8\xff", "a JPEG image", _EXPORT),
    (0, b"GIF8", "a GIF image", _EXPORT),
    (0, b"II*\x00", "a TIFF image", _EXPORT),
    (0, b"MM\x00*", "a TIFF image", _EXPORT),
    (8, b"WEBP", "a WebP image", _EXPORT),
    (8, b"AVI ", "a video", _EXPORT),
    (4, b"ftyp", "a video or HEIC image", _EXPORT),
    (0, b"\x93NUMPY", "an array of NumPy", _EXPORT),
    (0, b"PAR1", "a Parquet table", _EXPORT),
    (0, b"<!doctype html", "a web page", "download the log itself"),
    (0, b"<html", "a web page", "download the log itself"),
    (0, b"{\\rtf", "a document in RTF", _EXPORT),
    (0, b"version https://git-lfs", "a pointer of Git LFS", "fetch the file itself with git lfs pull"),
)
# Names inside a ZIP archive that tell what it is.
_INSIDE = (
    (b"xl/", "an Excel workbook", _WORKBOOK),
    (b"word/", "a Word document", _EXPORT),
    (b"opendocument.spreadsheet", "a LibreOffice workbook", _WORKBOOK),
    (b".npy", "arrays of NumPy", _EXPORT),
)


def check_foreign(source: Source) -> None:
    """Refuse a file that is no log by what it is."""
    head = source.head
    start = head[:64].lstrip().lower()
    for place, mark, what, advice in _FOREIGN:
        if head[place : place + len(mark)] == mark or (mark[:1] == b"<" and start.startswith(mark)):
            if mark == b"PK\x03\x04":
                inside = ((named, do) for part, named, do in _INSIDE if part in head)
                what, advice = next(inside, (what, advice))
            raise LogError(f"{source.path}: is {what}, no log; {advice}")


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
                absent = f"{self.path}: no such file; check the path, which counts from the current folder"
                raise LogError(absent).also(FileNotFoundError)
            if not self._file.is_file():
                raise LogError(f"{self.path} is not an ordinary file; copy the log to one first")
            with self._file.open("rb") as stream:
                self.head = stream.read(_HEAD_BYTES)
                self._state = _state(stream.fileno())
        except LogError:
            raise
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
        """SHA-256 of the bytes that were read, as hex; LogError where they have changed meanwhile."""
        if not self._sha256:
            # A library read the file: it is hashed in another reading.
            try:
                digest, same = file_sha256(self._file), _state(self._file) == self._state
            except OSError:
                same = False
            if not same:
                raise LogError(f"{self.path}: changed while it was read; try again when it is written")
            self._sha256 = digest
        return self._sha256

    @cached_property
    def head_lines(self) -> tuple[str, ...]:
        """Lines of `head` as text without their line ends; none for a binary file."""
        try:
            data, _ = _as_utf8(self.head, self.path, whole=False)
        except LogError:
            return ()
        return () if b"\0" in data else tuple(data.decode("utf-8").split("\n"))

    def provenance(
        self,
        format: str,
        *,
        device: str = "",
        options: LogOptions | Mapping[str, object] | None = None,
        notes: Sequence[Finding] = (),
    ) -> Provenance:
        """Return where a recording read from this file comes from; options left at None are not listed."""
        if isinstance(options, LogOptions):  # which rows are kept is no matter of what they mean
            options = {name: value for name, value in vars(options).items() if name != "time_back"}
        given = {name: str(value) for name, value in (options or {}).items() if value is not None}
        findings = tuple(replace(finding, sentence=one_line(finding.sentence)) for finding in notes)
        return Provenance(self.path, self.sha256, format, device, given, findings)


def length_note(stated: int, there: int) -> list[Finding]:
    """Return a note where a file has another length than it states, so that what follows the place moved."""
    sentence = f"the file has {there} bytes and its headers tell of {stated}: bytes were lost or added"
    return [] if stated == there else [note("other-length", f"{sentence}, so check the numbers")]


def _state(file: int | Path) -> tuple[int, int, int]:
    """Return what changes when a file is written or replaced."""
    state = os.stat(file)
    return state.st_ino, state.st_size, state.st_mtime_ns


@dataclass(frozen=True)
class Text:
    """A whole text log: `data` is UTF-8 without mark, with ``\\n`` as the only line end."""

    path: str
    data: bytes
    notes: tuple[Finding, ...] = ()

    def up_to(self, end: int) -> Text:
        """Return the part of the text before byte `end`, for a table that others follow."""
        return self if end >= len(self.data) else Text(self.path, self.data[:end], self.notes)

    def lines(self, count: int = -1, offset: int = 0, number: int = 0) -> Iterator[tuple[int, int, str]]:
        """Yield (line number from 1, byte offset of the next line, text) of at most `count` lines.

        They begin at byte `offset`, which is behind line `number`.
        """
        last = number + count
        while offset < len(self.data) and (count < 0 or number < last):
            end = self.data.find(b"\n", offset)
            end = len(self.data) if end < 0 else end
            number += 1
            line = self.data[offset:end].decode("utf-8", errors="replace")
            offset = end + 1
            yield number, offset, line


def read_text(source: Source) -> Text:
    """Read a text log whole; NUL bytes (binary, or UTF-16 without a mark) are a LogError."""
    data, notes = _as_utf8(source.read_bytes(), source.path)
    nul = data.find(b"\0")
    if nul >= 0:
        line = data.count(b"\n", 0, nul) + 1
        raise LogError(
            f"{source.path}, line {line}: NUL byte: the file is binary or damaged; export it again as UTF-8 "
            "text"
        )
    _check_lines(source.path, data)
    return Text(source.path, data, tuple(notes))


def _as_utf8(data: bytes, path: str, *, whole: bool = True) -> tuple[bytes, list[Finding]]:
    """Return text as UTF-8 without mark, with ``\\n`` as the only line end, and notes.

    Text is UTF-8 or UTF-16 by its mark, else UTF-8, else Windows-1252; without `whole`, it may end inside a
    character. A broken UTF-16 file is a LogError.
    """
    notes, sample = [], data[:_SAMPLE]
    # Every other byte of Latin text in UTF-16 is zero; no other text has a zero byte.
    zeros = sample[1::2].count(0), sample[::2].count(0)
    wide = "" if max(zeros) <= 0.4 * len(sample) or min(zeros) else ("utf-16-le", "utf-16-be")[zeros[1] > 0]
    if wide or not data.isascii():
        marked = data[:2] in _UTF16_MARKS
        if marked:
            notes.append(note("read-as-utf-16", "read as UTF-16, as its byte-order mark says"))
        elif wide:
            notes.append(note("read-as-utf-16", "read as UTF-16 without a mark: every other byte is zero"))
        code = "utf-16" if marked else wide or "utf-8-sig"
        decoder, out = codecs.getincrementaldecoder(code)(), io.BytesIO()
        try:
            for end in range(_PIECE, len(data) + _PIECE, _PIECE):
                piece = decoder.decode(data[end - _PIECE : end], whole and end >= len(data))
                out.write(piece.encode("utf-8"))
            data = out.getvalue().removeprefix(codecs.BOM_UTF8)  # of a text that was marked before
        except UnicodeError as error:  # a half of a surrogate pair is refused by the encoder
            if marked or wide:
                where = f"{'marked as' if marked else 'in'} UTF-16 but broken behind {out.tell()} bytes"
                raise LogError(f"{path}: {where} of text; save it as UTF-8") from error
            data = data.decode("cp1252", errors="replace").encode("utf-8")
            notes.append(note("read-as-windows-1252", "not UTF-8: read as Windows-1252"))
    data = _SEPARATOR.sub(b"", data)
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n")
        if b"\r" in data:
            # "\r\r\n", which a text-mode copy makes, is one line end; a lone "\r" is an old one.
            data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return data, notes


def _check_lines(path: str, data: bytes) -> None:
    """Refuse a line that is far too long for a table: its cells would take a hundred times its size."""
    begin = 0
    while len(data) - begin > _LINE:
        end = data.rfind(b"\n", begin, begin + _LINE)
        if end < 0:
            end, line = data.find(b"\n", begin), data.count(b"\n", 0, begin) + 1
            size = (len(data) if end < 0 else end) - begin
            raise LogError(
                f"{path}, line {line}: {size / 1e6:.3g} MB without a line end, which is no row of a table; "
                "the file is damaged or of another kind, so export it again"
            )
        begin = end + 1


def _on_one_line(text: str) -> str:
    return printable(text.replace("\n", " ").replace("\t", " "))


def shortened(text: str, most: int = 40) -> str:
    """Return a cell or a name for a message, of which a damaged file may make a whole page."""
    text = _on_one_line(text.strip()[: most + 1])
    return text if len(text) <= most else text[: most - 3] + "..."


def one_line(sentence: str) -> str:
    """Return a sentence about a log as one line of printable text, shortened if it is very long."""
    text = _on_one_line(sentence)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 300]} ... {text[-295:]}"


def split_line(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line; a quote never runs past the end of its line.

    The delimiter `SPACES` stands for any run of spaces or tabs.
    """
    if delimiter == SPACES:
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter))
    except (csv.Error, StopIteration):
        return line.split(delimiter)


def sniff_delimiter(line: str, *, spaces: bool = True) -> str:
    """Return the delimiter that cuts a header line into most cells (comma on a tie).

    With `spaces`, a line of four words or more and no other delimiter is delimited by spaces.
    """
    best = max(_DELIMITERS, key=lambda delimiter: len(split_line(line, delimiter)))
    if spaces and best not in line and len(line.split()) >= _FEWEST_WORDS:
        return SPACES
    return best
