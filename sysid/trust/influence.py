"""Does a fit hang on a single trial? How each trial scores among the others, and the fit without it.

A bounce that begins near a bifurcation (which foot touches first, does it stick) predicts nothing: a shift
of 0.04 ms at its start changes all that follows, and the parameters absorb the noise of such a start. Two
signs tell: the trial fits worse than the others, or the fit without the trial moves farther than one trial
less explains.
"""

from dataclasses import dataclass

import numpy as np

from sysid.fit.problem import Problem
from sysid.trust.assessment import FEWEST
from sysid.trust.least_squares import Solved
from sysid.trust.linearized import Linearized, bounded_information, gradient_noise
from sysid.trust.problem import trial_rows
from sysid.trust.verdicts import WEAKLY
from sysid.types import FloatArray

# NRMSE over noise, in medians of the trials, of a trial that does not belong to the others [1].
STANDS_OUT = 2.0
# Least shift of a parameter at which the fit depends on a single trial [standard deviations of what one trial
# less explains]: that shift is about 1 without an unusual trial. Among twenty synthetic campaigns (seeds 1001
# to 1020) the one whose fit was wrong moved by 6.4, the farthest of the others by 4.1, the next by 3.3.
HANGS = 4.5
# Least share of the variance without a trial that its loss explains [1]: the weighting of the trials hides
# smaller differences.
_LEAST = 0.2


def standing_out(ratio: FloatArray) -> tuple[int, ...]:
    """Return the trials whose NRMSE over noise (T,) [1] is unlike the others'; of fewer than three, none."""
    if len(ratio) < FEWEST or not np.isfinite(ratio).all():
        return ()
    limit = max(STANDS_OUT * float(np.median(ratio)), 1.0)
    return tuple(int(t) for t in np.flatnonzero(ratio > limit))


@dataclass(frozen=True, eq=False)
class Influence:
    """What the T trials of a fit do to it."""

    ratio: FloatArray  # (T,) NRMSE over what noise alone costs [1]
    without: FloatArray  # (T, n) parameters of the fit without the trial [unit cube]; NaN: no such fit
    # (T, n) how far they move, in standard deviations of what one trial less explains [1]; 0 for parameters
    # that the data do not determine.
    shift: FloatArray
    evaluations: int = 0  # points that those fits simulated

    @property
    def outliers(self) -> tuple[int, ...]:
        """Trials that score unlike the others."""
        return standing_out(self.ratio)

    @property
    def held_by(self) -> tuple[tuple[int, tuple[int, ...]], ...]:
        """Trials without which parameters go elsewhere: (trial, parameters, the farthest first)."""
        rows = np.nan_to_num(np.abs(self.shift))
        moved = [tuple(int(i) for i in np.argsort(-row) if row[i] > HANGS) for row in rows]
        return tuple((t, far) for t, far in enumerate(moved) if far)


def influence(problem: Problem, linear: Linearized, floors: FloatArray, refits: Solved | None) -> Influence:
    """Return what each trial scores, and what the fit at its minimum would be without it.

    `floors` (B,) is the NRMSE that noise alone costs [1]; `refits` are the fits without each trial, if any.
    """
    blocks, count, n = problem.blocks, len(problem.trials), len(linear.point)
    scored = np.zeros((2, count))
    for block, level, floor in zip(blocks, linear.levels, floors, strict=True):
        scored[:, block.trial] += block.weight * np.array([level, floor])
    ratio = scored[0] / np.where(scored[1] > 0, scored[1], np.nan)
    if refits is None:
        return Influence(ratio, np.full((count, n), np.nan), np.zeros((count, n)))
    shift = np.zeros((count, n))
    changes = problem.disturbances(linear.point)
    for t in range(count):
        kept = [b for b, block in enumerate(blocks) if block.trial != t]
        rows = trial_rows(blocks, (np.arange(count) != t).astype(np.float64)[None], len(linear.scale))[0]
        values = linear.jacobian.values * rows[:, None]
        spread = gradient_noise(
            [blocks[b] for b in kept], values, linear.scale, linear.levels[kept], linear.noise, changes
        )  # fmt: skip
        # Both variances follow one rule of bounds; one trial less explains their difference.
        variance = np.diag(bounded_information(values, spread, linear.point).covariance)
        expected = np.maximum(variance - np.diag(linear.information.covariance), _LEAST * variance)
        shift[t] = (refits.points[t] - linear.point) / np.sqrt(np.maximum(expected, 1e-24))
    shift *= linear.half_widths < WEAKLY
    # What the campaign states hangs on no trial alone.
    shift[:, len(problem.space.found) :] = 0.0
    usable = np.isfinite(refits.squares)[:, None]
    return Influence(
        ratio, np.where(usable, refits.points, np.nan), np.where(usable, shift, 0.0), refits.evaluations
    )
