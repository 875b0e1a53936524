"""Text logs: encoding, line ends, delimiter.

Every text format reads through here, so that a byte-order mark, a UTF-16 export, a carriage return or a
semicolon means the same everywhere. The tables of numbers inside are the matter of `sysid.loaders.table`.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from sysid.errors import LogError
from sysid.journal import Finding, note

_DELIMITERS = ",;\t"
SPACES = " "
# A line of fewer words than this may be prose: its spaces part no columns.
_FEWEST_WORDS = 4
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
# What Excel writes before a table, to itself: which character parts its cells. The line's end stays.
_SEPARATOR = re.compile(rb'\A[ ]*"?sep=[^\r\n"]?"?[,;\t ]*(?=[\r\n])', re.IGNORECASE)
# Bytes that are decoded at once.
_PIECE = 1 << 20


def decode(data: bytes, path: str, *, partial: bool = False) -> str:
    """Return the text of `data`: UTF-8 or UTF-16 by its mark, else UTF-8, else Windows-1252.

    With `partial`, `data` may end inside a character. A broken UTF-16 file is a LogError.
    """
    if data[:2] in _UTF16_MARKS:
        body = data[: len(data) // 2 * 2] if partial else data
        try:
            return body.decode("utf-16")
        except UnicodeDecodeError as error:
            raise LogError(
                f"{path}: marked as UTF-16 but broken at byte {error.start}; save it as UTF-8"
            ) from error
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if partial and error.start >= len(data) - 3:
            return data[: error.start].decode("utf-8-sig")
        return data.decode("cp1252", errors="replace")


class _File(Protocol):
    """What is read: a `Source`."""

    path: str

    def read_bytes(self) -> bytes: ...


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


def without_separator(text: str) -> str:
    """Return text with a blank first line where that line names the separator for Excel (``sep=;``)."""
    return _SEPARATOR.sub(b"", text[:40].encode("utf-8", "surrogatepass")).decode("utf-8") + text[40:]


def read_text(source: _File) -> Text:
    """Read a text log whole; NUL bytes (binary, or UTF-16 without a mark) are a LogError."""
    data = source.read_bytes()
    notes = []
    if data[:2] in _UTF16_MARKS:
        data = _as_utf8(data, "utf-16", source.path)
        notes.append(note("read-as-utf-16", "read as UTF-16, as its byte-order mark says"))
    nul = data.find(b"\0")
    if nul >= 0:
        line = data.count(b"\n", 0, nul) + 1
        raise LogError(
            f"{source.path}, line {line}: NUL byte at byte {nul}: the file is binary, damaged or "
            "UTF-16 without a mark; export it again as UTF-8 text"
        )
    data = _SEPARATOR.sub(b"", data.removeprefix(b"\xef\xbb\xbf"))
    if not data.isascii() and not _is_utf8(data):
        data = _as_utf8(data, "cp1252", source.path)
        notes.append(note("read-as-windows-1252", "not UTF-8: read as Windows-1252"))
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n")
        if b"\r" in data:
            # "\r\r\n", which a text-mode copy makes, is one line end; a lone "\r" is an old one.
            data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return Text(source.path, data, tuple(notes))


def _pieces(data: bytes, coding: str, errors: str = "strict") -> Iterator[str]:
    """Yield the text of `data` piece by piece: a whole one would take four bytes a character."""
    decoder = codecs.getincrementaldecoder(coding)(errors)
    for begin in range(0, len(data), _PIECE):
        yield decoder.decode(data[begin : begin + _PIECE], begin + _PIECE >= len(data))


def _is_utf8(data: bytes) -> bool:
    try:
        for _ in _pieces(data, "utf-8"):
            pass
    except UnicodeDecodeError:
        return False
    return True


def _as_utf8(data: bytes, coding: str, path: str) -> bytes:
    out = io.BytesIO()
    try:
        for piece in _pieces(data, coding, "strict" if coding == "utf-16" else "replace"):
            out.write(piece.encode("utf-8"))
    except UnicodeError as error:  # a half of a surrogate pair is refused by the encoder
        raise LogError(
            f"{path}: marked as UTF-16 but broken behind {out.tell()} bytes of text; save it as UTF-8"
        ) from error
    return out.getvalue()


def shortened(text: str, most: int = 40) -> str:
    """Return a cell or a name for a message, of which a damaged file may make a whole page."""
    text = text.strip()
    return text if len(text) <= most else text[: most - 3] + "..."


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
