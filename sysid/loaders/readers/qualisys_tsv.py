"""Qualisys QTM TSV: markers (3D) and rigid bodies (6D).

A header of ``KEY<TAB>value`` lines, then rows of numbers; the row of column names and the columns Frame and
Time are options of the export, so columns are counted from MARKER_NAMES or BODY_NAMES. Orientation is
the matrix Rot[0] ... Rot[8], which QTM writes by columns; its angles follow a definition that the user
can change and are not read. A body or marker whose cells are blank or all zero is missing. Lengths are mm
unless declared.
"""

from collections.abc import Sequence

import numpy as np

from sysid.errors import LogError
from sysid.journal import note
from sysid.loaders.capture_log import (
    Body,
    RawCapture,
    capture_format,
    declared_length,
    matrix_quaternions,
    wanted_bodies,
)
from sysid.loaders.clock import began_note, counted_clock, known_rate, order_rows, rate_clock
from sysid.loaders.options import CaptureOptions
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.source import Source, Text, read_text
from sysid.loaders.table import Numbers, TableHead, is_number, parse_number, promised_note, read_numbers
from sysid.types import FloatArray

_FIRST = "NO_OF_FRAMES"
_HEADER_LINES = 40
# Number of cells of a body (X Y Z, three angles, residual, matrix), and place of the first one of its matrix.
_BODY_WIDTH, _MATRIX = 16, 7
_BODY_PARTS = ("X", "Y", "Z", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{i}]" for i in range(9)))
# Largest element of RᵀR - 1 [1] of a matrix printed to few decimals; a larger one means a wrong column or a
# damaged number.
_ORTHOGONAL = 0.02
# Largest rounding of a time [s]: times have five decimals, in some versions three.
_TIME_ROUNDING = 5.5e-4


def _recognize(source: Source) -> int:
    first = next((line for line in source.head_lines if line.strip()), "")
    return CERTAIN if first.startswith((_FIRST + "\t", _FIRST + " ")) else NO


def _header(text: Text) -> tuple[dict[str, list[str]], int, int, bool]:
    """Return the keys, the line before the rows with the offset behind it, and if the clock is exported."""
    keys: dict[str, list[str]] = {}
    number, offset = 0, 0
    for line_number, behind, line in text.lines(_HEADER_LINES):
        cells = [cell.strip() for cell in line.split("\t")]
        word = cells[0]
        if word == "Frame":
            return keys, line_number, behind, True
        if word[:1].isalpha() and word.upper() == word:
            keys[word] = cells[1:]
        elif line.strip():
            if is_number(word):
                return keys, number, offset, False
            return keys, line_number, behind, False  # column names without Frame and Time
        number, offset = line_number, behind
    return keys, number, offset, False


def _orientation(path: str, name: str, numbers: Numbers, columns: Sequence[int]) -> FloatArray:
    """Return quaternions, w first, of continuous sign; NaN where the matrix is missing."""
    cells = numbers.stacked(columns)
    matrix = cells.reshape(-1, 3, 3).transpose(0, 2, 1)
    seen = np.asarray(np.isfinite(cells).all(axis=1) & cells.any(axis=1))
    error = np.abs(np.einsum("nij,nik->njk", matrix, matrix) - np.eye(3)).max(axis=(1, 2))
    mirrored = np.linalg.det(np.where(seen[:, None, None], matrix, 0.0)) <= 0
    wrong = np.asarray(seen & ((error > _ORTHOGONAL) | mirrored))
    if numbers.open_end and wrong.any() and wrong.argmax() == wrong.size - 1:
        wrong[-1] = seen[-1] = False
    if wrong.any():
        row = int(wrong.argmax())
        raise LogError(
            f"{path}, line {numbers.lines[row]}: Rot[0] to Rot[8] of {name} are no rotation; check which "
            "columns were exported"
        )
    return matrix_quaternions(matrix, seen)


def _parse(source: Source, options: CaptureOptions) -> RawCapture:
    path = source.path
    text = read_text(source)
    keys, line, offset, clocked = _header(text)
    if _FIRST not in keys:
        raise LogError(
            f"{path}: not a Qualisys TSV (no line {_FIRST}); check the format or export the header"
        )
    missing = f"{path}: the header states no {{}}; export it with the header"
    try:
        rate = known_rate(parse_number(keys["FREQUENCY"][0].replace(",", ".")))
    except (KeyError, IndexError, ValueError):
        raise LogError(missing.format("FREQUENCY")) from None
    included = (keys.get("DATA_INCLUDED") or [""])[0].upper()
    if included not in ("3D", "6D"):
        raise LogError(f"{path}: DATA_INCLUDED is {included[:40]!r}; export 3D or 6D data")
    scale = declared_length(path, options.length_unit, "mm")
    width, key = (3, "MARKER_NAMES") if included == "3D" else (_BODY_WIDTH, "BODY_NAMES")
    names = [name for name in keys.get(key, []) if name]
    if not names:
        raise LogError(missing.format(key))
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise LogError(f'{path}: {key} repeats "{twice[0]}"; rename one and export again')
    lead, cells = 2, width * len(names)
    if not clocked:  # and the columns may have no names
        row = next((line for _, _, line in text.lines(1, offset)), "")
        lead = len(row.rstrip("\t").split("\t")) - cells
        if lead not in (0, 2):
            raise LogError(
                f"{path}: rows have {cells + lead} cells where the header names {cells} (or {cells + 2} with "
                "Frame and Time); export again with the header"
            )
    labels = [f"{name} {part}" for name in names for part in _BODY_PARTS[:width]]
    table = TableHead((*["Frame", "Time"][:lead], *labels), "\t", line, offset)
    numbers = read_numbers(text, table, range(len(table.names)))
    del text  # the file's bytes are not needed any more
    promised = promised_note(_FIRST, (keys.get(_FIRST) or [""])[0], numbers.lines.size)
    raw = RawCapture(
        f"Qualisys QTM {included}", [*numbers.notes, *promised], chosen=included == "6D", marks_lost=True
    )
    if lead:
        _, ordered = order_rows(path, numbers, 0, 1.0 / rate)
        time, checked = counted_clock(
            path, numbers, (0, 1), 1.0, [rate], _TIME_ROUNDING,
            "correct FREQUENCY or the times, or export again",
        )  # fmt: skip
        raw.notes += [*ordered, checked]
    else:
        time = rate_clock(path, rate, numbers.lines.size)
        sentence = f"no Frame column: rows are taken as frames without a hole at {rate:g} Hz"
        raw.notes.append(note("time-from-rate", sentence))
    kept = wanted_bodies(path, names, options.rigid_body) if included == "6D" else names
    for place, name in enumerate(names):
        first = lead + place * width
        position = numbers.stacked(range(first, first + 3)) * scale
        position[~position.any(axis=1)] = np.nan
        if included == "3D":
            raw.markers[name] = time, position
        elif name in kept:
            quaternion = _orientation(path, name, numbers, range(first + _MATRIX, first + _BODY_WIDTH))
            seen = np.isfinite(quaternion[:, 0])
            position[~seen] = np.nan
            residual = np.where(seen, numbers.columns[first + 6] * scale, np.nan)
            raw.bodies.append(Body(name, time, position, quaternion, extra={"residual": ("m", residual)}))
    raw.notes += began_note("capture", " ".join((keys.get("TIME_STAMP") or [""])[:1]))
    return raw


FORMAT = capture_format(
    "qualisys-tsv", "Qualisys QTM TSV (3D markers, 6D bodies)", _recognize, _parse,
    {"rigid_body": (), "bodies": (), "length_unit": ()},
)  # fmt: skip
