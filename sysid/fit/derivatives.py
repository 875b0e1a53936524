"""Difference quotients along the axes of a valley, and of all trials' rows at once.

A difference along one coordinate of a narrow valley is a small difference of large numbers: the curvature
along the valley comes out 10 to 1000 times too large. Displacements along the principal axes of the last
curvature, each so long that the cost rises by the same amount, see the valley as it is. A coordinate that
concerns one trial alone, such as a slope, is displaced in every trial at once, and each trial's residuals
belong to its coordinate; along an axis of the others such coordinates follow, as they do in a fit.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sysid.types import BoolArray, FloatArray, IntArray

# Shortest and longest displacement along an axis [unit cube]; shorter ones are lost in the integration's
# error, longer ones leave the valley.
_SHORTEST, _LONGEST = 5e-4, 0.05
# Largest derivative, over the largest one of any coordinate, that is rounding [1].
_ROUNDING = 1e-11
# Displacement along a coordinate of which no curvature is known yet [unit cube].
FIRST = 3e-3


class Layout(NamedTuple):
    """What each of n coordinates and m residuals concerns."""

    # (n,) number of the kind of a coordinate of one trial; -1: the coordinate concerns all trials.
    kinds: IntArray
    # (n,) the trial of such a coordinate, from 0.
    trials: IntArray
    # (m,) the trial of each residual; -1: of none.
    residuals: IntArray
    # Number of stated values, the last coordinates, whose derivatives hardly bend.
    stated: int


@dataclass(eq=False)
class Displacements:
    """The displacements of one front, and the derivatives (n, m) that follow from their residuals."""

    # (n,) the front's point.
    at: FloatArray
    # (k, n) displaced points.
    ahead: FloatArray
    # (k, n) points on the other side, or the front's own.
    behind: FloatArray
    central: bool
    # Coordinates that are displaced one by one or kind by kind, and those that the axes span.
    alone: IntArray
    spanned: IntArray
    # (len(alone),) displacement that belongs to each coordinate of `alone`.
    of: IntArray
    layout: Layout

    @property
    def points(self) -> FloatArray:
        """All points that are to be simulated."""
        return np.concatenate([self.ahead, self.behind]) if self.central else self.ahead

    def columns(
        self, at: FloatArray, residuals: FloatArray, failed: BoolArray, known: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Return the derivatives (n, m), and which coordinates (n,) have one; `known` (n, m) are the others'.

        `at` (m,) are the residuals of the front, `residuals` those of `points`, which may have `failed`.
        """
        count = len(self.ahead)
        ahead, behind, forward = residuals[:count], np.broadcast_to(at, (count, len(at))), self.ahead.copy()
        backward = self.behind.copy()
        lost = failed[:count]
        if self.central:
            # The front itself replaces a point that cannot be simulated.
            ahead = np.where(lost[:, None], at, ahead)
            behind = np.where(failed[count:, None], at, residuals[count:])
            forward = np.where(lost[:, None], self.at, forward)
            backward = np.where(failed[count:, None], self.at, backward)
            lost = lost & failed[count:]
        moved = forward - backward
        difference = np.where(lost[:, None], 0.0, ahead - behind)
        out, usable = known.copy(), np.ones(len(known), dtype=np.bool_)
        for coordinate, k in zip(self.alone, self.of, strict=True):
            width = moved[k, coordinate]
            own = self.layout.kinds[coordinate] >= 0
            mine = self.layout.residuals == self.layout.trials[coordinate] if own else slice(None)
            out[coordinate] = 0.0
            usable[coordinate] = not lost[k] and width != 0.0
            if usable[coordinate]:
                out[coordinate, mine] = difference[k, mine] / width
        axes = slice(int(self.of.max(initial=-1)) + 1, count)
        if len(self.spanned):
            others = np.ones(len(known), dtype=np.bool_)
            others[self.spanned] = False
            rest = difference[axes] - moved[axes][:, others] @ out[others]
            rest[lost[axes]] = 0.0
            # `lstsq` computes the same, and takes many times as long for so many right-hand sides. A
            # pseudo-inverse would multiply the factors first and lose digits.
            left, sizes, right = np.linalg.svd(moved[axes][:, self.spanned], full_matrices=False)
            seen = sizes > 1e-12 * sizes.max()
            out[self.spanned] = (right[seen].T / sizes[seen]) @ (left[:, seen].T @ rest)
            # A coordinate that no residual sees has rounding errors for derivatives.
            size = np.linalg.norm(out, axis=1)
            out[size < _ROUNDING * size.max()] = 0.0
        return out, usable


def displaced(
    at: FloatArray,
    curvature: FloatArray,
    layout: Layout,
    *,
    asked: BoolArray,
    still: BoolArray,
    rise: float,
    central: bool,
    share: float = 1.0,
) -> Displacements:
    """Return displacements of a front at a point (n,) that derive the coordinates `asked` (n,).

    `curvature` (n, n) is half the second derivative of the cost, 0 where it is not known yet; the cost rises
    by about `rise` along each displacement, of which a `share` is gone. Coordinates that stand `still` (n,)
    do not follow the others.
    """
    n, unknown = len(at), not curvature.any()
    own = asked & (layout.kinds >= 0)
    # A coordinate on a face of the cube can move inward only.
    face = asked & ~own & ((at <= 0.0) | (at >= 1.0))
    spanned = np.flatnonzero(asked & ~own & ~face)
    following = np.flatnonzero(~still & ~face & ~(asked & ~own))
    lengths = np.full(n, FIRST)
    if not unknown:
        steep = np.maximum(np.diag(curvature), 1e-30)
        lengths = np.clip(np.sqrt(rise / steep), _SHORTEST, _LONGEST)
    moves: list[FloatArray] = []
    alone: list[int] = []
    of: list[int] = []
    groups = [np.array([j]) for j in np.flatnonzero(face)]
    groups += [np.flatnonzero(own & (layout.kinds == kind)) for kind in np.unique(layout.kinds[own])]
    for group in groups:
        move = np.zeros(n)
        # Each trial's coordinate goes to the side where the cube has room.
        move[group] = np.where(at[group] + lengths[group] <= 1.0, lengths[group], -lengths[group])
        alone += group.tolist()
        of += [len(moves)] * len(group)
        moves.append(move)
    if len(spanned):
        axes = np.zeros((len(spanned), n))
        axes[:, spanned] = np.eye(len(spanned)) * FIRST
        if not unknown:
            inner = curvature[np.ix_(spanned, spanned)]
            if len(following):
                stiff = curvature[np.ix_(following, following)]
                stiff = stiff + 1e-9 * max(float(np.trace(stiff)), 1e-30) * np.eye(len(following))
                along = -np.linalg.solve(stiff, curvature[np.ix_(following, spanned)])
                inner = inner + curvature[np.ix_(spanned, following)] @ along
            values, vectors = np.linalg.eigh((inner + inner.T) / 2)
            long = np.clip(np.sqrt(rise / np.maximum(values, 1e-30)), _SHORTEST, _LONGEST)
            axes[:, spanned] = (vectors * long).T
            if len(following):
                axes[:, following] = axes[:, spanned] @ along.T
            axes *= np.minimum(1.0, 2 * _LONGEST / np.maximum(np.abs(axes).max(axis=1), 1e-30))[:, None]
        moves += list(axes)
    move = share * np.array(moves).reshape(-1, n)
    ahead, behind = np.clip(at + move, 0.0, 1.0), np.clip(at - move, 0.0, 1.0)
    if not central:
        longer = np.linalg.norm(behind - at, axis=1) > np.linalg.norm(ahead - at, axis=1) + 1e-15
        longer[: len(groups)] = False
        ahead = np.where(longer[:, None], behind, ahead)
        behind = np.repeat(at[None], len(ahead), axis=0)
    return Displacements(
        at, ahead, behind, central, np.array(alone, dtype=np.int64), spanned, np.array(of, dtype=np.int64),
        layout,
    )  # fmt: skip
