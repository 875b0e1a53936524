"""OptiTrack Motive CSV, versions 1.21 to 1.25: rigid bodies and markers.

Layout: row 1 is ``key,value`` pairs (version, rates, rotation type, length unit), row 2 is empty, then rows
of type, name, ID, (1.24 on) parent and component, then ``Frame,Time,X,Y,Z,W,...``. Rows are found by
their content, not by number. A column without axis label is an error or a quality and is not read.

Valid for quaternions and for the six Euler orders, which Motive defines as relative: about X, then the new Y,
then the new Z for ``XYZ`` (vendor's note on Motive 1.6 and later), right-handed, degrees. The axes are of the
export: a remapping at export leaves no trace in the file, so which axis is up is the campaign's to say.

Lost bodies and markers are blank cells, here NaN. Columns of type ``Rigid Body Marker`` are positions solved
from the body; columns of type ``Marker`` are measured, and keep the plain name where both have the same.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.capture_log import (
    EULER_ORDERS,
    Body,
    RawCapture,
    capture_format,
    length_factor,
    rotation_quaternions,
    wanted_bodies,
)
from sysid.loaders.clock import began_note, counted_clock, jitter_note, order_rows
from sysid.loaders.columns import listing_note, parse_header, unread_note
from sysid.loaders.options import CaptureOptions, is_positive
from sysid.loaders.registry import CERTAIN, NO
from sysid.loaders.source import Source, Text, read_text, sniff_delimiter, split_line
from sysid.loaders.table import Numbers, TableHead, promised_note, read_numbers
from sysid.types import FloatArray

_BODIES, _SOLVED, _MEASURED = {"rigid body", "bone"}, {"rigid body marker", "bone marker"}, {"marker"}
_KEYS = (
    "Format Version", "Take Name", "Take Notes", "Capture Frame Rate", "Export Frame Rate",
    "Capture Start Time", "Capture Start Frame", "Total Frames in Take", "Total Exported Frames",
    "Rotation Type", "Length Units", "Coordinate Space",
)  # fmt: skip
# Number of lines among which the column rows come; in every version seen they are in the first dozen.
_HEADER_LINES = 40
# Largest rounding of a time [s]: half of the last digit of newer versions, 1 ms, and a margin.
_TIME_ROUNDING = 0.6e-3


@dataclass
class _Asset:
    """One rigid body or marker: its columns by component and axis."""

    type: str
    name: str
    parts: dict[str, dict[str, int]] = field(default_factory=dict)

    def columns(self, component: str, axes: str) -> list[int]:
        """Return the columns of a component's axes; empty when one is missing."""
        part = self.parts.get(component, {})
        return [part[axis] for axis in axes] if all(axis in part for axis in axes) else []


@dataclass(frozen=True)
class _Header:
    settings: dict[str, str]
    assets: list[_Asset]
    table: TableHead
    clocks: dict[str, int]


def _recognize(source: Source) -> int:
    first = next((line for line in source.head_lines if line.strip()), "")
    return CERTAIN if first.lstrip('" ').startswith("Format Version") else NO


def _read_header(text: Text) -> _Header:
    lines = list(text.lines(_HEADER_LINES))
    filled = [line for _, _, line in lines if line.strip()]
    delimiter = sniff_delimiter(filled[0], spaces=False) if filled else ","
    rows = [[cell.strip().strip('"').strip() for cell in split_line(line, delimiter)] for _, _, line in lines]
    firsts = [row[0].casefold() for row in rows]
    last = next((i for i, word in enumerate(firsts) if word == "frame" or word.startswith("time")), None)
    if last is None:
        raise LogError(
            f'{text.path}: no column row "Frame,Time,..." in the first {_HEADER_LINES} lines; '
            "export again with the header information switched on"
        )
    number, offset, _ = lines[last]
    axes, upper = rows[last], [row for row in rows[:last] if any(row)]
    # Row 1 has pairs of key and value. Known keys are looked for, because a take's name may contain commas.
    pairs = [cell.strip().strip('"') for cell in upper.pop(0)] if upper else []
    settings = {key: pairs[pairs.index(key) + 1] for key in _KEYS if key in pairs[:-1]}
    known = _BODIES | _SOLVED | _MEASURED
    components = next((row for row in upper if "Position" in row or "Rotation" in row), None)
    types = next((row for row in upper if any(cell.casefold() in known for cell in row[2:])), None)
    if components is None or types is None:
        raise LogError(
            f"{text.path}: no rows of types and components (Rigid Body, Position) above line {number}; "
            "export again with the header information switched on"
        )
    labelled = {row[1].casefold(): row for row in upper if len(row) > 1 and row[1]}
    below = upper[upper.index(types) + 1 :]
    names = labelled.get("name", below[0] if below else [])
    ids = labelled.get("id", below[1] if len(below) > 1 else names)
    if components not in below and not labelled.keys() >= {"name", "id"}:
        raise LogError(
            f"{text.path}: the row of components (Position) stands above the row of types (Rigid Body), not "
            "in Motive's order; export again"
        )

    def cell(row: list[str], index: int) -> str:
        return row[index] if index < len(row) else ""

    words = [name.casefold() for name in axes[:2]]
    clocks = {key: i for i, word in enumerate(words) for key in ("frame", "time") if word.startswith(key)}
    assets: dict[tuple[str, str, str], _Asset] = {}
    labels = list(axes)
    for index in range(len(clocks), len(axes)):
        kind, name, axis = cell(types, index).casefold(), cell(names, index), axes[index].upper()
        component = cell(components, index)
        labels[index] = f"{name} {component} {axis}".strip()
        if kind not in known or component not in ("Position", "Rotation") or axis not in ("X", "Y", "Z", "W"):
            continue
        asset = assets.setdefault((kind, name, cell(ids, index)), _Asset(kind, name))
        if axis in asset.parts.setdefault(component, {}):
            raise LogError(
                f'{text.path}, line {number}: column {index + 1} repeats {component} {axis} of "{name}"; '
                "rename one of the two assets and export again"
            )
        asset.parts[component][axis] = index
    if not assets:
        raise LogError(
            f"{text.path}: no rigid body and no marker among {len(axes)} columns; select them at export"
        )
    return _Header(
        settings, list(assets.values()), TableHead(tuple(labels), delimiter, number, offset), clocks
    )


def _euler_order(path: str, stated: str, declared: str | None) -> str:
    known, order = ", ".join(EULER_ORDERS), (stated if declared is None else str(declared)).upper()
    if order not in EULER_ORDERS and declared is not None:
        raise LogError(f"{path}: euler_order = {declared!r} is unknown; expected one of {known}")
    if order not in EULER_ORDERS:
        raise LogError(
            f"{path}: rotations have no W column and the header's rotation type is {stated!r}; "
            f"declare euler_order, one of {known}"
        )
    if stated.upper() in EULER_ORDERS and order != stated.upper():
        raise LogError(f'{path}: euler_order = "{declared}" contradicts the header, which says {stated}')
    return order


def _clock(path: str, header: _Header, numbers: Numbers, clock: str) -> tuple[FloatArray, list[Finding]]:
    """Return the times [s]: rebuilt from frame numbers and checked against the Time column, or written."""
    known = []
    for key in ("Export Frame Rate", "Capture Frame Rate"):
        try:
            rate = float(header.settings.get(key, "nan").replace(",", "."))
        except ValueError:
            raise LogError(f"{path}: {key} is {header.settings[key]!r}; expected frames per second") from None
        known += [rate] if is_positive(rate) else []
    if "frame" not in header.clocks and "time" not in header.clocks:
        raise LogError(f"{path}, line {header.table.line}: neither a Frame nor a Time column; export them")
    if clock == "time" or "frame" not in header.clocks or not known:
        if "time" not in header.clocks:
            raise LogError(f"{path}: no Time column and no frame rate in the header; export one of them")
        time, notes = order_rows(path, numbers, header.clocks["time"], 1.0)
        notes.append(note("time-as-written", "time as written in the Time column"))
        return time, [*notes, *jitter_note(time)]

    _, notes = order_rows(path, numbers, header.clocks["frame"], 1.0 / known[0])
    if "time" not in header.clocks:
        rebuilt = numbers.columns[header.clocks["frame"]] / known[0]
        return rebuilt, [*notes, note("time-from-frames", f"time is the frame number over {known[0]:g} Hz")]
    time, rebuilt_note = counted_clock(
        path, numbers, (header.clocks["frame"], header.clocks["time"]), 0.0, known, _TIME_ROUNDING,
        'choose with clock = "frame" or clock = "time"', check=clock == "auto",
    )  # fmt: skip
    return time, [*notes, rebuilt_note]


def _parse(source: Source, options: CaptureOptions) -> RawCapture:
    path = source.path
    text = read_text(source)
    header = _read_header(text)
    stated = header.settings
    scale = length_factor(path, [stated.get("Length Units", "")], options.length_unit)
    bodies = [asset for asset in header.assets if asset.type in _BODIES]
    kept = wanted_bodies(path, [body.name for body in bodies], options.rigid_body)
    bodies = [body for body in bodies if body.name in kept]
    markers = [asset for kind in (_MEASURED, _SOLVED) for asset in header.assets if asset.type in kind]
    for asset in (*bodies, *markers):
        if not asset.columns("Position", "XYZ"):
            raise LogError(f'{path}: "{asset.name}" lacks one of Position X, Y, Z; export it whole')
    names = [body.name for body in bodies]
    for body in bodies:
        if not body.columns("Rotation", "XYZ"):
            raise LogError(f'{path}: rigid body "{body.name}" lacks a rotation column; export it whole')
        if names.count(body.name) > 1:
            raise LogError(f'{path}: two rigid bodies are named "{body.name}"; rename one and export again')

    def columns(assets: Iterable[_Asset]) -> set[int]:
        return {index for asset in assets for part in asset.parts.values() for index in part.values()}

    wanted = {*header.clocks.values(), *columns((*bodies, *markers))}
    numbers = read_numbers(text, header.table, sorted(wanted), least=max(wanted) + 1)
    del text  # the file's bytes are not needed any more
    exported = "Total Exported Frames"
    promised = promised_note(exported, stated.get(exported, ""), numbers.lines.size)
    time, ordered = _clock(path, header, numbers, options.clock or "auto")
    named = parse_header(header.table.names)
    read = wanted | columns(header.assets)
    unread = unread_note(named, [column for column in named if column.index in read])
    version = f"OptiTrack Motive CSV {stated.get('Format Version', '')}".strip()
    raw = RawCapture(version, [*numbers.notes, *promised, *ordered, *unread], marks_lost=True)
    raw.states_length = bool(stated.get("Length Units"))
    for body in bodies:
        quaternion = body.columns("Rotation", "WXYZ")
        if quaternion:
            turn = numbers.stacked(quaternion)
        else:
            order = _euler_order(path, stated.get("Rotation Type", ""), options.euler_order)
            turn = rotation_quaternions(
                "euler", numbers.stacked(body.columns("Rotation", order)), order=order
            )
        position = numbers.stacked(body.columns("Position", "XYZ")) * scale
        raw.bodies.append(Body(body.name, time, position, turn, numbers))
    places = [numbers.stacked(marker.columns("Position", "XYZ")) * scale for marker in markers]
    seen = [bool(np.isfinite(place).all(axis=1).any()) for place in places]
    # Markers that are never seen come last, so that they take no name from another.
    for k in sorted(range(len(markers)), key=lambda k: not seen[k]):
        marker, taken = markers[k], {*raw.markers, *names}
        name = marker.name + (" (solved)" if marker.type in _SOLVED and marker.name in taken else "")
        repeat = 2
        while name in taken:
            name, repeat = f"{marker.name} #{repeat}", repeat + 1
        raw.markers[name] = time, places[k]
    solved = [marker.name for marker in markers if marker.type in _SOLVED]
    raw.notes += listing_note(
        "positions-solved-from-body", "positions solved from the body, not measured", solved
    )
    raw.notes += began_note("capture", stated.get("Capture Start Time", ""))
    return raw


FORMAT = capture_format(
    "motive-csv", "OptiTrack Motive CSV 1.21 to 1.25 (rigid bodies, markers)", _recognize, _parse,
    {"rigid_body": (), "euler_order": (), "length_unit": (), "clock": ("auto", "frame", "time")},
)  # fmt: skip
