"""Motion captures: the bodies and markers of a file become a `Recording`."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np

from sysid.errors import LogError, UnitError
from sysid.journal import Finding, note
from sysid.loaders.columns import listing, listing_note, naming
from sysid.loaders.options import CaptureOptions
from sysid.loaders.registry import family_format
from sysid.loaders.rigid_pose import fit_pose
from sysid.loaders.signal_log import plain_unit, unknown_units_note
from sysid.loaders.source import Source
from sysid.loaders.table import Numbers
from sysid.recording import BoolArray, Channel, FloatArray, Recording
from sysid.units import factor_to_si

EULER_ORDERS = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX")
# Units of length by the words that Motive writes for them.
_LENGTHS = {"meters": "m", "millimeters": "mm", "centimeters": "cm", "inches": "inch", "feet": "foot"}
# Largest error of a quaternion's length [1]: logs print two decimals or more, so a larger error means wrong
# columns or a damaged number.
_LENGTH_TOLERANCE = 0.02


@dataclass
class Body:
    """One rigid body over `time` (n,) [s].

    `position` (n, 3) [m]; `orientation` (n, 4), quaternion, w first, body axes to capture axes, NaN where
    lost. With `rows`, the quaternion is as recorded in these rows of the file: its length and sign are still
    to be checked. `extra` has (unit, values) of other channels of the body: ``residual``, ``velocity``.
    """

    name: str
    time: FloatArray
    position: FloatArray
    orientation: FloatArray
    rows: Numbers | None = None
    extra: dict[str, tuple[str, FloatArray]] = field(default_factory=dict)


@dataclass
class RawCapture:
    """Content of a motion capture.

    `markers` are (time [s], position (n, 3) [m]) by name; `others` are signals beside the capture. `chosen`:
    the option ``rigid_body`` has chosen `bodies`, so none is fitted for it. `states_length`: the
    file states its length unit, so the option ``length_unit`` changes nothing. `marks_lost`: the system
    writes frames in which it lost a body, so a note counts them.
    """

    device: str
    notes: list[Finding]
    bodies: list[Body] = field(default_factory=list)
    markers: dict[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    others: dict[str, Channel] = field(default_factory=dict)
    chosen: bool = True
    states_length: bool = False
    marks_lost: bool = False
    kind: str = "motion-capture"
    unknown_units: list[str] = field(default_factory=list)

    def add_signal(self, name: str, stated: str, time: FloatArray, values: FloatArray) -> None:
        """Add a signal beside the capture, in SI where its `stated` unit is known."""
        unit, factor = plain_unit(stated)
        self.unknown_units += [] if unit else [f"{name} [{stated}]" if stated else name]
        self.others[name] = Channel(name, unit, time, values * factor)


def unit_quaternions(
    path: str, body: str, numbers: Numbers, raw: FloatArray
) -> tuple[FloatArray, list[Finding]]:
    """Return unit quaternions (n, 4) of continuous sign, in the component order of `raw`, and notes.

    A quaternion and its negative are one orientation, and capture systems switch between them; of the
    two, the result has the one nearest to the last recorded frame's. A row that lacks a component, or is
    all zero, is NaN; a length that is not 1 within 2 % is a LogError that names the row in `numbers`.
    """
    notes: list[Finding] = []
    with np.errstate(over="ignore"):  # a damaged number may be too large to square
        length = np.linalg.norm(raw, axis=1)
    lost = np.isnan(length)
    zero = length == 0.0
    if zero.any():
        sentence = f"frames with an all-zero quaternion of {body}, taken as lost: {int(zero.sum())}"
        notes.append(note("zero-quaternions", sentence))
    wrong = ~lost & ~zero & (np.abs(length - 1.0) > _LENGTH_TOLERANCE)
    if numbers.open_end and wrong.any() and wrong.argmax() == wrong.size - 1:
        notes.append(note("last-quaternion-cut", f"the last quaternion of {body} is cut; taken as lost"))
        zero, wrong = zero | wrong, np.zeros_like(wrong)
    if wrong.any():
        row = int(wrong.argmax())
        raise LogError(
            f"{path}, {numbers.row_word} {numbers.lines[row]}: the quaternion of {body} has length "
            f"{length[row]:.4g}, expected 1; check which columns it is in"
        )
    unit = np.where((lost | zero)[:, None], np.nan, raw / np.where(lost | zero, 1.0, length)[:, None])
    unit, turned = continuous_quaternions(unit)
    if turned:
        sentence = f"the quaternion of {body} changes sign {turned} times; made continuous"
        notes.append(note("quaternion-sign-made-continuous", sentence))
    return unit, notes


def continuous_quaternions(unit: FloatArray) -> tuple[FloatArray, int]:
    """Return quaternions (n, 4) of the sign nearest to the last recorded one, and how often it changed."""
    seen = np.flatnonzero(np.isfinite(unit[:, 0]))
    turned = np.einsum("ij,ij->i", unit[seen[1:]], unit[seen[:-1]]) < 0.0
    if turned.any():
        unit = unit.copy()
        unit[seen[1:][np.cumsum(turned) % 2 == 1]] *= -1.0
    return unit, int(turned.sum())


def rotation_quaternions(
    kind: Literal["rotvec", "matrix", "euler"],
    values: FloatArray,
    seen: BoolArray | None = None,
    order: str = "",
) -> FloatArray:
    """Return quaternions (n, 4), w first, of `values` (n, k) or (n, 3, 3); NaN where not `seen` (finite).

    `kind` is how scipy's ``Rotation.from_KIND`` takes the values. Euler angles [deg] are about the axes of
    the turning body, in an `order` such as ``"XYZ"``: upper-case letters are scipy's sign for that.
    """
    # Imported on first use: the import takes longer than everything that commands without logs do.
    from scipy.spatial.transform import Rotation

    seen = np.asarray(np.isfinite(values).all(axis=1)) if seen is None else seen
    quaternions = np.full((len(values), 4), np.nan)
    if seen.any():
        if kind == "euler":
            turns = Rotation.from_euler(order, values[seen], degrees=True)
        elif kind == "matrix":
            turns = Rotation.from_matrix(values[seen])
        else:
            turns = Rotation.from_rotvec(values[seen])
        quaternions[seen] = np.roll(turns.as_quat(), 1, axis=1)
    return quaternions


def matrix_quaternions(matrix: FloatArray, seen: BoolArray) -> FloatArray:
    """Return quaternions, w first, of continuous sign, of matrices (n, 3, 3); NaN where not `seen`."""
    return continuous_quaternions(rotation_quaternions("matrix", matrix, seen))[0]


def declared_length(path: str, declared: str | None, default: str = "m") -> float:
    """Return the factor to metres of a declared length unit, or of `default`; UnitError if none."""
    with naming(f"{path}: length_unit"):
        return factor_to_si(default if declared is None else str(declared), "m")


def length_factor(where: str, stated: Iterable[str], declared: str | None) -> float:
    """Return the factor to metres of a unit that is stated or declared; UnitError if they differ."""
    units = sorted({unit.strip() for unit in stated} - {""}) + ([] if declared is None else [str(declared)])
    if not units:
        refusal = UnitError(f'{where}: states no length unit; declare it with length_unit = "mm" or "m"')
        raise refusal.asking(length_unit="mm")
    with naming(f"{where}: length unit"):
        factors = {factor_to_si(_LENGTHS.get(unit.casefold(), unit), "m") for unit in units}
    if len(factors) > 1:
        raise UnitError(f"{where}: lengths are in {' and '.join(units)}; correct length_unit or export again")
    return factors.pop()


def wanted_bodies(path: str, names: Sequence[str], wanted: str | Sequence[str] | None) -> tuple[str, ...]:
    """Return the bodies to keep; LogError when a wanted one is not there."""
    if wanted is None:
        return tuple(names)
    kept = tuple(str(name) for name in wanted) if isinstance(wanted, list | tuple) else (str(wanted),)
    for name in kept:
        if name not in names:
            raise LogError(
                f'{path}: no rigid body "{name}"; found {listing(names)}; set rigid_body to one of them'
            )
    return kept


def body_name(path: str, declared: object) -> str:
    """Return the name that the only body of a table is given; LogError where `declared` is none."""
    if declared is not None and (not isinstance(declared, str) or not declared):
        raise LogError(f"{path}: rigid_body = {declared!r} is no name; a pose table has one body")
    return declared or "body"


def _marker_bodies(path: str, raw: RawCapture, options: CaptureOptions) -> dict[str, list[str]]:
    """Return body name -> its markers, as declared, or all whose name begins with the body's."""
    markers, rigid_body = raw.markers, None if raw.chosen else options.rigid_body
    if options.bodies is not None and not isinstance(options.bodies, Mapping):
        raise LogError(
            f"{path}: bodies = {options.bodies!r} is no table; expected for example "
            '{quad = ["q1", "q2", "q3"]}'
        )
    wanted: dict[str, list[str]] = {}
    for name, chosen in (options.bodies or {}).items():
        listed = [chosen] if isinstance(chosen, str) else [str(marker) for marker in chosen]
        missing = [marker for marker in listed if marker not in markers]
        if missing:
            raise LogError(
                f'{path}: body "{name}" names marker "{missing[0]}"; found {listing(markers)}; correct bodies'
            )
        wanted[str(name)] = listed
    if rigid_body is not None:
        names = [str(name) for name in (rigid_body if isinstance(rigid_body, list | tuple) else [rigid_body])]
        for name in names:
            if name not in wanted:
                wanted[name] = [marker for marker in markers if marker.startswith(name) and marker != name]
        wanted = {name: wanted[name] for name in names}
    for name, listed in wanted.items():
        if len(set(listed)) < 3:
            raise LogError(
                f'{path}: body "{name}" has {len(set(listed))} markers, a pose needs three; found '
                f"{listing(markers)}; name them with bodies = {{{name} = [...]}}"
            )
    return wanted


def _recording(
    source: Source, name: str, parse: Callable[[Source, CaptureOptions], RawCapture], options: CaptureOptions
) -> Recording:
    """Return the recording of a capture: unit quaternions of continuous sign, poses of marker sets fitted.

    A quaternion without unit length, a body that cannot be fitted and a capture that never saw anything are
    a LogError.
    """
    raw = parse(source, options)
    path, notes = source.path, list(raw.notes)
    bodies = list(raw.bodies)
    for body in bodies:
        if body.rows is not None:
            body.orientation, turned = unit_quaternions(path, body.name, body.rows, body.orientation)
            notes += turned
        lost = int(np.isnan(body.orientation[:, 0]).sum())
        if raw.marks_lost and lost:
            frames = len(body.orientation)
            notes.append(note("body-lost", f"{body.name} is lost in {lost} of {frames} frames"))
    for fitted, markers in _marker_bodies(path, raw, options).items():
        points = np.stack([raw.markers[marker][1] for marker in markers], axis=1)
        rotation, origin, residual, fit = fit_pose(path, fitted, markers, points)
        turn = matrix_quaternions(rotation, np.isfinite(residual))
        time = raw.markers[markers[0]][0]
        bodies.append(Body(fitted, time, origin, turn, extra={"residual": ("m", residual)}))
        notes.append(fit)
    channels: dict[str, Channel] = {}
    for body in bodies:
        parts = {"position": ("m", body.position), "orientation": ("1", body.orientation), **body.extra}
        for what, (unit, values) in parts.items():
            channels[f"{body.name}/{what}"] = Channel(f"{body.name}/{what}", unit, body.time, values)
    blank = [marker for marker, (_, place) in raw.markers.items() if not np.isfinite(place).all(axis=1).any()]
    notes += listing_note("markers-never-seen", "markers never seen, left out", blank)
    for marker, (time, place) in raw.markers.items():
        key = f"{marker}/position"
        if marker not in blank and key not in channels:
            channels[key] = Channel(key, "m", time, place)
    channels |= raw.others
    notes += unknown_units_note(raw.unknown_units)
    if not channels:
        raise LogError(f"{path}: no body, marker or signal is ever seen; the capture is empty")
    stated = replace(options, length_unit=None) if raw.states_length else options
    provenance = source.provenance(name, device=raw.device, options=stated, notes=notes)
    return Recording(raw.kind, channels, provenance)


capture_format = partial(family_format, CaptureOptions, _recording)
