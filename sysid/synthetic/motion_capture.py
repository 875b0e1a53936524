"""What a motion-capture system sees of a body, and the files in which it says so."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from sysid.types import BoolArray, FloatArray, IntArray

# Decimals that Motive writes: micrometres either way, and millionths of a quaternion or degree.
_DECIMALS = {"Meters": 6, "Millimeters": 3}
_SCALE = {"Meters": 1.0, "Millimeters": 1000.0}
LengthUnit = Literal["Meters", "Millimeters"]
RotationType = Literal["Quaternion", "XYZ"]


@dataclass(frozen=True, eq=False)
class SeenBody:
    """A rigid body as the cameras solved it.

    Position (n, 3) of the origin in capture axes [m]; unit quaternion (n, 4) x y z w from body axes to
    capture axes, whose sign may flip; `seen` (n,) is False where the body was occluded; mean distance (n,) of
    the markers from where they should be [m].
    """

    position: FloatArray
    quaternion: FloatArray
    seen: BoolArray
    marker_error: FloatArray


@dataclass(frozen=True, eq=False)
class Take:
    """One recording: frames, rate, and what was seen in capture axes."""

    name: str
    started: str
    first_frame: int
    rate: float
    bodies: Mapping[str, SeenBody]
    markers: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def frames(self) -> IntArray:
        """(n,) frame numbers."""
        count = len(next(iter(self.bodies.values())).position)
        return np.arange(self.first_frame, self.first_frame + count, dtype=np.int64)

    @property
    def time(self) -> FloatArray:
        """(n,) times on the file's clock [s]: frame number over rate."""
        return np.asarray(self.frames / self.rate, dtype=np.float64)


def observe(
    position: FloatArray,
    rotation: Rotation,
    noise: tuple[float, float],
    seed: np.random.Generator,
    *,
    gaps: Sequence[tuple[int, int]] = (),
    flips: Sequence[int] = (),
) -> SeenBody:
    """Add noise, occlusions and sign flips to the true pose of a body in capture axes.

    Origins (n, 3) [m] and n rotations from body axes to capture axes; standard deviations of white noise per
    axis [m] and about each body axis [rad]; `gaps` (first sample, samples) in which the body is not seen;
    `flips`, samples from which on the quaternion has the other sign.
    """
    count = len(position)
    shaken = position + noise[0] * seed.standard_normal((count, 3))
    turned = rotation * Rotation.from_rotvec(noise[1] * seed.standard_normal((count, 3)))
    quaternion = turned.as_quat(canonical=True)
    # Keep the sign continuous first, so that the only flips are those asked for.
    sign = np.cumprod(np.where(np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0, -1.0, 1.0))
    quaternion[1:] *= sign[:, None]
    for sample in flips:
        quaternion[sample:] *= -1.0
    seen = np.ones(count, dtype=np.bool_)
    for first, length in gaps:
        seen[first : first + length] = False
    error = np.abs(noise[0] * (0.5 + 0.1 * seed.standard_normal(count)))
    return SeenBody(shaken, quaternion, seen, error)


def motive_csv(take: Take, *, unit: LengthUnit = "Meters", rotation: RotationType = "Quaternion") -> str:
    """Return a take as Motive exports it, format version 1.23, occluded frames blank.

    Quaternion x y z w, or intrinsic Euler angles about x, y', z'' [deg], right-handed. Six decimals in
    metres, three in millimetres, six of a quaternion or an angle: its quantization.
    """
    decimals, scale = _DECIMALS[unit], _SCALE[unit]
    turns = "XYZW" if rotation == "Quaternion" else "XYZ"
    # Five lines of header, column by column: type, name, identifier, component, axis.
    header = [("", "", "", "", "Frame"), ("Type", "Name", "ID", "", "Time (Seconds)")]
    cells = [[str(frame) for frame in take.frames], [f"{t:.6f}" for t in take.time]]
    for number, (name, body) in enumerate(take.bodies.items()):
        what = ("Rigid Body", name, f'"{_identifier(name, number)}"')
        angles = body.quaternion
        if rotation != "Quaternion":
            angles = Rotation.from_quat(body.quaternion).as_euler("XYZ", degrees=True)
        header += [(*what, "Rotation", axis) for axis in turns]
        header += [*((*what, "Position", axis) for axis in "XYZ"), (*what, "Mean Marker Error", "")]
        cells += [_cells(column, 6, body.seen) for column in angles.T]
        lengths = (*body.position.T, body.marker_error)
        cells += [_cells(scale * column, decimals, body.seen) for column in lengths]
    everywhere = np.ones(len(take.frames), dtype=np.bool_)
    for number, (name, position) in enumerate(take.markers.items()):
        what = ("Marker", name, f'"{_identifier(name, 64 + number)}"')
        header += [(*what, "Position", axis) for axis in "XYZ"]
        cells += [_cells(scale * column, decimals, everywhere) for column in position.T]
    count = len(take.frames)
    out = io.StringIO()
    out.write(
        f"Format Version,1.23,Take Name,{take.name},Take Notes,,Capture Frame Rate,{take.rate:.6f},"
        f"Export Frame Rate,{take.rate:.6f},Capture Start Time,{take.started},Capture Start Frame,0,"
        f"Total Frames in Take,{take.first_frame + count + 200},Total Exported Frames,{count},"
        f"Rotation Type,{rotation},Length Units,{unit},Coordinate Space,Global\r\n\r\n"
    )
    for parts in (*zip(*header, strict=True), *zip(*cells, strict=True)):
        out.write(",".join(parts) + "\r\n")
    return out.getvalue()


def pose_table_csv(take: Take, body: str, *, epoch: float) -> str:
    """Return one body as a plain table ``t,x (m),y (m),z (m),qw,qx,qy,qz``, as a script writes a stream.

    The table's clock is ``epoch + frame/rate`` [s], `epoch` the Unix time of frame 0. Metres and capture
    axes. An occluded frame keeps its row, with blank cells.
    """
    seen = take.bodies[body]
    order = seen.quaternion[:, [3, 0, 1, 2]]
    cells = [[f"{epoch + t:.6f}" for t in take.time]]
    cells += [_cells(column, 6, seen.seen) for column in (*seen.position.T, *order.T)]
    rows = ["t,x (m),y (m),z (m),qw,qx,qy,qz", *(",".join(parts) for parts in zip(*cells, strict=True))]
    return "\n".join(rows) + "\n"


def _cells(values: FloatArray, decimals: int, seen: BoolArray) -> list[str]:
    return [f"{value:.{decimals}f}" if ok else "" for value, ok in zip(values, seen, strict=True)]


def _identifier(name: str, number: int) -> str:
    """Return a made-up identifier of the shape Motive writes, the same every time."""
    return f"{sum(name.encode()) * 2654435761 % 2**32:08X}{number:024X}"
