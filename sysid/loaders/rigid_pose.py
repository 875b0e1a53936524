"""Pose of a rigid body from its markers, frame by frame (Kabsch), with residuals.

The origin of the body's frame is the centre of the markers; its axes are parallel to the capture's in the
frame that shows most markers first. The shape is the mean over all frames, so that the noise of no single
frame stays in it. Valid for three markers or more that do not lie on one line; a frame with fewer is lost.

References
----------
W. Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta Cryst. A32 (1976) 922.
"""

from collections.abc import Sequence

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.columns import listing
from sysid.recording import BoolArray, FloatArray

# Least ratio of the second to the first singular value of markers that do not lie on one line [1].
_FLAT = 0.02
# Largest RMS residual of the markers of a rigid body, as a share of the RMS distance from their centre [1].
_LOOSE = 0.1


def fit_rotations(shape: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return rotations (n, 3, 3), origins (n, 3) [m] and residuals (n,) that bring a shape onto points.

    `shape` (k, 3) are markers in the body's frame [m], `points` (n, k, 3) in the capture's, NaN where not
    seen. Rotations turn body axes into capture axes; they are NaN in frames with fewer than three markers or
    markers on one line. A residual is the RMS distance of the seen markers from the shape [m].
    """
    seen: BoolArray = np.asarray(np.isfinite(points).all(axis=2))
    weight = seen / np.maximum(seen.sum(axis=1), 1)[:, None]
    known = np.where(seen[..., None], points, 0.0)
    middle = np.einsum("nk,nki->ni", weight, known)
    local_middle = weight @ shape
    centred = np.where(seen[..., None], known - middle[:, None], 0.0)
    local = np.where(seen[..., None], shape[None] - local_middle[:, None], 0.0)
    u, spread, vt = np.linalg.svd(np.einsum("nki,nkj->nij", centred, local))
    # The nearest rotation: a reflection is turned back about the direction that the points determine least.
    turn = np.sign(np.linalg.det(u @ vt))
    vt = vt.copy()
    vt[:, 2] *= turn[:, None]
    rotation = u @ vt
    origin = middle - np.einsum("nij,nj->ni", rotation, local_middle)
    error = np.where(seen[..., None], centred - np.einsum("nij,nkj->nki", rotation, local), 0.0)
    residual = np.sqrt(np.einsum("nki,nki->n", error, error) / np.maximum(seen.sum(axis=1), 1))
    lost = (seen.sum(axis=1) < 3) | (spread[:, 1] <= _FLAT**2 * spread[:, 0])
    rotation[lost], origin[lost], residual[lost] = np.nan, np.nan, np.nan
    return rotation, origin, residual


def _mean_shape(points: FloatArray) -> FloatArray:
    """Return the (k, 3) mean shape of markers, NaN for one never seen together with three others."""
    seen = np.isfinite(points).all(axis=2)
    best = int(np.argmax(seen.sum(axis=1)))
    shape = points[best] - np.nanmean(points[best], axis=0)
    for _ in range(3):  # markers hidden in the first frame join; three rounds settle to far below the noise
        use = np.isfinite(shape).all(axis=1)
        rotation, origin, _ = fit_rotations(shape[use], points[:, use])
        local = np.einsum("nji,nkj->nki", rotation, points - origin[:, None])
        if not np.isfinite(local).any():
            break  # markers on one line: no frame has a rotation
        counted = np.isfinite(local).all(axis=2).sum(axis=0)
        total = np.nansum(local, axis=0)
        shape = np.where(counted[:, None] > 0, total / np.maximum(counted, 1)[:, None], np.nan)
        shape -= np.nanmean(shape, axis=0)
    return np.asarray(shape)


def fit_pose(
    path: str, name: str, markers: Sequence[str], points: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, Finding]:
    """Return rotation, origin and residual of a body over time, as `fit_rotations` does, and a note.

    `points` (n, k, 3) [m] are the places of its `markers`. Markers that are never seen together, move against
    each other or lie on one line are a LogError.
    """
    together = np.isfinite(points).all(axis=2).sum(axis=1)
    if together.max(initial=0) < 3:
        raise LogError(f'{path}: never are three markers of "{name}" seen together; check the labelling')
    shape = _mean_shape(points)
    use = np.isfinite(shape).all(axis=1)
    rotation, origin, residual = fit_rotations(shape[use], points[:, use])
    seen = np.isfinite(residual)
    if not seen.any():
        raise LogError(f'{path}: the markers of "{name}" lie on one line, so it has no orientation; add one')
    rms = float(np.sqrt(np.mean(residual[seen] ** 2)))
    size = float(np.sqrt(np.mean(np.sum(shape[use] ** 2, axis=1))))
    if rms > _LOOSE * size:
        raise LogError(
            f'{path}: the markers of "{name}" move by {1e3 * rms:.3g} mm against each other, so they are not '
            f"one rigid body ({listing(markers)}); name its markers with bodies = {{{name} = [...]}}"
        )
    sentence = (
        f"pose of {name} from {int(use.sum())} markers: residual {1e3 * rms:.3g} mm rms, at most "
        f"{1e3 * float(residual[seen].max()):.3g} mm; lost in {int((~seen).sum())} of {seen.size} "
        "frames; origin at the centre of the markers"
    )
    return rotation, origin, residual, note("pose-from-markers", sentence)
