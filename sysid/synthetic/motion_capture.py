"""What a motion-capture system sees of a body, and the files in which it says so."""

from __future__ import annotations

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

    Parameters
    ----------
    position : (n, 3) array
        Of the body's origin in capture axes [m].
    quaternion : (n, 4) array
        Unit, x y z w, from body axes to capture axes; the sign may flip.
    seen : (n,) array
        False where it was occluded.
    marker_error : (n,) array
        Mean distance of the body's markers from where they should be [m].
    """

    position: FloatArray
    quaternion: FloatArray
    seen: BoolArray
    marker_error: FloatArray


@dataclass(frozen=True)
class CaptureNoise:
    """Noise of the solved pose, one standard deviation per axis: position [m] and angle [rad]."""

    position: float = 0.3e-3
    angle: float = float(np.radians(0.2))


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
    noise: CaptureNoise,
    seed: np.random.Generator,
    *,
    gaps: Sequence[tuple[int, int]] = (),
    flips: Sequence[int] = (),
) -> SeenBody:
    """Add noise, occlusions and sign flips to the true pose of a body in capture axes.

    Parameters
    ----------
    position, rotation
        (n, 3) array of the origin [m], and n rotations from body axes to capture axes.
    noise : CaptureNoise
        White, independent from frame to frame; that of the angle is about each body axis.
    gaps : sequence of (first sample, samples)
        Where the body is not seen.
    flips : sequence of int
        Samples from which on the quaternion has the other sign.
    """
    count = len(position)
    shaken = position + noise.position * seed.standard_normal((count, 3))
    turned = rotation * Rotation.from_rotvec(noise.angle * seed.standard_normal((count, 3)))
    quaternion = turned.as_quat(canonical=True)
    # Keep the sign continuous first, so that the only flips are those asked for.
    sign = np.cumprod(np.where(np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0, -1.0, 1.0))
    quaternion[1:] *= sign[:, None]
    for sample in flips:
        quaternion[sample:] *= -1.0
    seen = np.ones(count, dtype=np.bool_)
    for first, length in gaps:
        seen[first : first + length] = False
    error = np.abs(noise.position * (0.5 + 0.1 * seed.standard_normal(count)))
    return SeenBody(shaken, quaternion, seen, error)


def motive_csv(take: Take, *, unit: LengthUnit = "Meters", rotation: RotationType = "Quaternion") -> str:
    """Return a take as Motive exports it, format version 1.23, occluded frames blank.

    Quaternion x y z w, or intrinsic Euler angles about x, y', z'' [deg], right-handed. Six decimals in
    metres, three in millimetres, six of a quaternion or an angle: its quantization.
    """
    decimals, scale = _DECIMALS[unit], _SCALE[unit]
    turns = ("X", "Y", "Z", "W") if rotation == "Quaternion" else ("X", "Y", "Z")
    kinds, names, identifiers, components, axes = [["", label] for label in ("Type", "Name", "ID", "")] + [
        ["Frame", "Time (Seconds)"]
    ]
    columns: list[tuple[FloatArray, int, BoolArray]] = []
    for number, (name, body) in enumerate(take.bodies.items()):
        width = len(turns) + 4
        kinds += ["Rigid Body"] * width
        names += [name] * width
        identifiers += [f'"{_identifier(name, number)}"'] * width
        components += ["Rotation"] * len(turns) + ["Position"] * 3 + ["Mean Marker Error"]
        axes += [*turns, "X", "Y", "Z", ""]
        angles = body.quaternion
        if rotation != "Quaternion":
            angles = Rotation.from_quat(body.quaternion).as_euler("XYZ", degrees=True)
        columns += [(column, 6, body.seen) for column in angles.T]
        columns += [(scale * column, decimals, body.seen) for column in body.position.T]
        columns.append((scale * body.marker_error, decimals, body.seen))
    everywhere = np.ones(len(take.frames), dtype=np.bool_)
    for number, (name, position) in enumerate(take.markers.items()):
        kinds += ["Marker"] * 3
        names += [name] * 3
        identifiers += [f'"{_identifier(name, 64 + number)}"'] * 3
        components += ["Position"] * 3
        axes += ["X", "Y", "Z"]
        columns += [(scale * column, decimals, everywhere) for column in position.T]
    count = len(take.frames)
    out = io.StringIO()
    out.write(
        f"Format Version,1.23,Take Name,{take.name},Take Notes,,Capture Frame Rate,{take.rate:.6f},"
        f"Export Frame Rate,{take.rate:.6f},Capture Start Time,{take.started},Capture Start Frame,0,"
        f"Total Frames in Take,{take.first_frame + count + 200},Total Exported Frames,{count},"
        f"Rotation Type,{rotation},Length Units,{unit},Coordinate Space,Global\r\n\r\n"
    )
    for row in (kinds, names, identifiers, components, axes):
        out.write(",".join(row) + "\r\n")
    cells = [[str(frame) for frame in take.frames], [f"{t:.6f}" for t in take.time]]
    cells += [_cells(values, places, seen) for values, places, seen in columns]
    for parts in zip(*cells, strict=True):
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
