"""From a motion-capture recording to planar motion: the capture's axes, the body, the sloped plane.

The plane of motion is spanned by a horizontal down-slope direction ``x`` and up ``z``; ``y`` points into
the page and a positive pitch turns ``z`` toward ``x`` (nose down the slope).
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.recording import Recording
from sysid.types import BoolArray, FloatArray

# Largest distance of a frame from its slot on the uniform clock without interpolation [periods].
_SNAP = 0.05
# Largest rotation out of the plane that the planar model allows (the paper's assumption) [rad].
PLANAR_LIMIT = np.radians(10.0)


@dataclass(frozen=True)
class CaptureFrame:
    """Rotation from capture axes to (x down-slope, y into the page, z up).

    `up` and `down_slope` are signed capture axes such as ``"+y"``; they must not lie on one axis. The capture
    calls up what leans down-slope by `tilt` [rad]. `axes` is the rotation without a tilt.
    """

    up: str
    down_slope: str
    tilt: float = 0.0
    axes: FloatArray = field(init=False, repr=False, compare=False)
    matrix: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        z, x = signed_axis(self.up), signed_axis(self.down_slope)
        axes = np.array([x, np.cross(z, x), z])
        object.__setattr__(self, "axes", axes)
        object.__setattr__(self, "matrix", Rotation.from_rotvec([0.0, self.tilt, 0.0]).as_matrix() @ axes)


def signed_axis(name: str) -> FloatArray:
    """Return the unit vector (3,) of a signed axis such as ``"-y"``."""
    vector = np.zeros(3)
    vector["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
    return vector


@dataclass(frozen=True, eq=False)
class SpatialMotion:
    """A rigid body on the recording's uniform clock [s] of a rate [Hz], in the (x, y, z) of a `CaptureFrame`.

    `position` (n, 3) is the centre of mass [m] and `rotation` (n, 3, 3) leads from the axes of the body to
    (x, y, z); both are NaN where the body was lost, which `valid` (n,) tells. `notes` say what was done to
    the clock.
    """

    time: FloatArray
    rate: float
    position: FloatArray
    rotation: FloatArray
    valid: BoolArray
    notes: tuple[Finding, ...] = ()


def spatial_motion(
    recording: Recording,
    rigid_body: str | None,
    frame: CaptureFrame,
    *,
    centre_of_mass_offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rate: float | None = None,
) -> SpatialMotion:
    """Put a rigid body, by default the only one, onto a uniform clock and into the frame of motion.

    The offset leads from the body's origin to the centre of mass, in the axes of the body [m]; a rate [Hz] is
    stated where the file's clock is the arrival time. Raises LogError when the body is not there, was never
    seen, or the file has several and none is named.
    """
    where = recording.provenance.path
    bodies = recording.rigid_bodies
    if rigid_body is None:
        if len(bodies) != 1:
            raise LogError(
                f"{where}: has {len(bodies)} rigid bodies ({', '.join(bodies) or 'none'}); "
                f"name one in capture.rigid_body"
            )
        rigid_body = bodies[0]
    elif rigid_body not in bodies:
        known = ", ".join(bodies) or "none"
        raise LogError(f"{where}: no rigid body {rigid_body!r}; found {known}; set capture.rigid_body")
    position = recording[f"{rigid_body}/position"]
    orientation = recording[f"{rigid_body}/orientation"]
    valid = position.valid & orientation.valid
    if valid.sum() < 3:
        raise LogError(
            f"{where}: rigid body {rigid_body!r} was seen in {valid.sum()} frames; record it again"
        )

    steps = np.diff(position.time)
    median = float(np.median(steps))
    span = float(position.time[-1] - position.time[0])
    count = round(span / median)
    # The span over a whole count of periods gives the rate to many digits, with or without lost frames.
    period = 1.0 / rate if rate else (span / count if abs(span / count - median) < 0.02 * median else median)
    found_rate = 1.0 / period
    time = position.time[0] + period * np.arange(int(np.floor(span / period + 0.5)) + 1)
    jitter = float(np.percentile(np.abs(steps - np.round(steps / period) * period), 95)) / period  # [frames]
    quaternion = orientation.values.copy()
    quaternion[~valid] = np.nan
    columns = np.column_stack([position.values, quaternion])
    columns[~valid] = np.nan
    placed = _place(position.time, columns, time, found_rate, snap=0.0 if jitter > _SNAP else _SNAP)
    seen = np.asarray(np.isfinite(placed).all(axis=1), dtype=np.bool_)

    turn = np.full((len(time), 3, 3), np.nan)
    turn[seen] = frame.matrix @ Rotation.from_quat(placed[seen][:, [4, 5, 6, 3]]).as_matrix()
    centre = placed[:, :3] @ frame.matrix.T + turn @ np.asarray(centre_of_mass_offset)
    notes = []
    if jitter > _SNAP:
        sentence = (
            f"the clock jitters by {100 * jitter:.0f} % of a frame (arrival time?); "
            f"frames were interpolated onto {found_rate:.6g} Hz"
        )
        notes.append(note("clock-jitters", sentence))
    return SpatialMotion(time, found_rate, centre, turn, seen, tuple(notes))


def _place(source: FloatArray, values: FloatArray, time: FloatArray, rate: float, snap: float) -> FloatArray:
    """Return `values` at `time`: the sample itself where one is there, else linear between two close ones."""
    right = np.clip(np.searchsorted(source, time), 1, len(source) - 1)
    left = right - 1
    nearest = np.where(time - source[left] < source[right] - time, left, right)
    snapped = np.abs(source[nearest] - time) * rate <= snap
    share = (time - source[left]) / (source[right] - source[left])
    close = ((source[right] - source[left]) * rate < 1.5) & (share >= 0) & (share <= 1)
    between = values[left] + share[:, None] * (values[right] - values[left])
    return np.where(snapped[:, None], values[nearest], np.where(close[:, None], between, np.nan))


@dataclass(frozen=True, eq=False)
class PlanarMotion:
    """Centre of mass and pitch in the plane of motion, relative to a point of the sloped surface.

    Arrays (n,): x down-slope (horizontal) and z up [m], NaN where lost; continuous pitch [rad]; roll and yaw
    out of the plane [rad]. Time [s], rate [Hz] and valid as in `SpatialMotion`.
    """

    time: FloatArray
    rate: float
    x: FloatArray
    z: FloatArray
    pitch: FloatArray
    roll: FloatArray
    yaw: FloatArray
    valid: BoolArray

    def coordinates(self) -> FloatArray:
        """Return (n, 3): x, z, pitch [m, rad]."""
        return np.column_stack([self.x, self.z, self.pitch])


def planar_motion(motion: SpatialMotion, point: FloatArray, level: FloatArray) -> PlanarMotion:
    """Project onto the plane of motion, relative to a point (3,) of the surface in (x, y, z) [m].

    `level` (3, 3) is the rotation that counts as level: `held_level` of the samples before release, or the
    frame's matrix, where the body's axes are the capture's.
    """
    turn = motion.rotation @ level.T
    relative = motion.position - point
    pitch = np.full(len(motion.time), np.nan)
    angle = np.arctan2(turn[motion.valid, 0, 2], turn[motion.valid, 2, 2])
    pitch[motion.valid] = np.unwrap(angle)
    roll, yaw = -np.arcsin(np.clip(turn[:, 1, 2], -1, 1)), np.arcsin(np.clip(turn[:, 1, 0], -1, 1))
    return PlanarMotion(
        motion.time, motion.rate, relative[:, 0], relative[:, 2], pitch, roll, yaw, motion.valid
    )


def held_level(motion: SpatialMotion, hold: slice) -> FloatArray:
    """Return the mean rotation (3, 3) over samples during which the body kept its attitude."""
    turn = motion.rotation[hold][motion.valid[hold]]
    return np.asarray(Rotation.from_matrix(turn).mean().as_matrix())


def marker_plane(
    recording: Recording, markers: tuple[str, ...], frame: CaptureFrame, height: float, slope: float | None
) -> tuple[FloatArray, float | None, float]:
    """Fit the surface through board markers whose centres lie at a height above it [m].

    Returns a point (3,) of the surface below the markers' centroid, in (x, y, z) [m], the fall toward +x
    [rad], and the RMS distance of the markers from the plane [m]. With fewer than three markers the slope
    must be known [rad], and none is returned. Raises LogError when a marker is not there, was never seen, or
    all lie on one line.
    """
    where = recording.provenance.path
    centres = []
    for name in markers:
        if name not in recording.markers:
            known = ", ".join(recording.markers) or "none"
            raise LogError(f"{where}: no marker {name!r}; found {known}; set surface.markers")
        channel = recording[f"{name}/position"]
        if not channel.valid.any():
            raise LogError(f"{where}: marker {name!r} was never seen; name another one")
        # The board does not move: the median ignores the few frames in which a marker was mistaken.
        centres.append(np.median(channel.values[channel.valid], axis=0) @ frame.matrix.T)
    points = np.array(centres)
    centre = points.mean(axis=0)
    if len(points) < 3:
        if slope is None:
            raise LogError(f"{where}: {len(points)} markers cannot give a slope; give it or name three")
        normal = np.array([np.sin(slope), 0.0, np.cos(slope)])
        return centre - height * normal, None, 0.0
    _, singular, axes = np.linalg.svd(points - centre)
    if singular[1] < 0.02 * singular[0]:
        raise LogError(f"{where}: markers {', '.join(markers)} are on one line; name one off that line")
    normal = axes[2] * np.sign(axes[2][2] or 1.0)
    residual = float(np.sqrt(np.mean(((points - centre) @ normal) ** 2)))
    return centre - height * normal, float(np.arctan2(normal[0], normal[2])), residual
