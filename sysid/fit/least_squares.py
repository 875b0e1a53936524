"""Levenberg-Marquardt on many fronts at once, and the finisher that a search makes of it.

A front is one point that walks downhill. A population's kernel is fastest with hundreds of candidates, so
all fronts walk side by side: one population has every column of every front's difference Jacobian, the next
one several damping factors of every front's step. Fronts that start near a minimum know the derivatives
there; their steps correct these, and differences are rare. The finisher of a search takes differences at
every step: their length smooths a rough cost, and corrected derivatives ended up to 0.2 % higher. The walk
asks for residuals and does not know who computes them.

The finisher minimizes the mean NRMSE ``C = sum_k w_k s_k`` over blocks k (a channel of a trial). With
residuals r in units of what NRMSE divides by, ``s_k <= s_k'/2 + mean(r_k²)/(2 s_k')`` with equality and equal
gradient at ``s_k' = s_k``: a sum of squares weighted by the blocks' present scores descends where C does.
After the third contact of a drop the cost is rough, and a fit of the whole window stops in the first dent.
The finisher therefore begins with the first part of every trial's window and lets it grow. Where the model is
wrong, that may lead away from the best fit of the whole, so a second finisher begins with whole windows.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from sysid.fit.breeders.breeder import Breeder, Start
from sysid.fit.derivatives import Displacements, Layout, displaced
from sysid.fit.problem import Problem
from sysid.fit.stopping import StopReason
from sysid.fit.trial import EXPLAINED, noise_floor
from sysid.types import BoolArray, FloatArray

# Damping that is tried in every step, as multiples of a front's present damping.
_FACTORS = (0.1, 1.0, 10.0)
_DAMPING = (1e-8, 1e-3, 1e6)
# Rise of the finisher's cost along a difference step [1]: a step of 0.3 times the distance along which the
# NRMSE changes by 0.1 %.
RISE = 1.8e-4
# Iterations after which the derivatives by stated values are taken again.
_REFRESHED = 4
# Share of what derivatives promise with which a step says that they mislead [1].
_MISLED = 0.25
# Starts closer than this in every coordinate count as one [unit cube].
_SAME_START = 0.05
# A front of the finisher has converged when a step takes less than this share off its cost.
_TOLERANCE = 2e-5
# Relative rise of the NRMSE at the ends of the axes along which CMA-ES starts after least squares [1].
_AXIS_COST = 0.005
# Greatest length of an axis along which CMA-ES starts [unit cube].
_AXIS_LENGTH = 0.15
# A channel that fits better than this is not weighted up any further: noise-free samples have no scale [1].
LEAST_NRMSE = 1e-5

# Points (P, n) out, residuals (P, m) and which points failed (P,) in.
Walk = Generator[FloatArray, tuple[FloatArray, BoolArray], None]


class Weighing(Protocol):
    """What a walk minimizes: a sum of squares of weighted residuals, or a cost that behaves like one."""

    def cost(self, fronts: object, residuals: FloatArray) -> FloatArray:
        """Return the costs (F, ...) of residuals (F, ..., m) of fronts, an index of the first axis."""
        ...

    def scale(self, front: int, residuals: FloatArray) -> FloatArray:
        """Return what weights the residuals (m,) of a front at its point."""
        ...


@dataclass(eq=False)
class Fronts:
    """Where fronts stand; a walk changes the arrays in place."""

    # (F, n) places in the unit cube.
    points: FloatArray
    # (F,) cost by the walk's `Weighing`; inf where the simulation failed.
    cost: FloatArray
    # (F,) True where two steps in a row took less than the tolerance off the cost.
    converged: BoolArray
    # (F, n, n) half the second derivative of the cost at the last step.
    curvature: FloatArray

    @classmethod
    def at(cls, points: FloatArray, curvature: FloatArray | None = None) -> Fronts:
        """Return fronts at points (F, n) of the unit cube; `curvature` (n, n), if known, is that of all."""
        count, n = points.shape
        curvature = np.zeros((n, n)) if curvature is None else curvature
        return cls(
            np.array(points, dtype=np.float64), np.full(count, np.inf), np.zeros(count, dtype=np.bool_),
            np.repeat(curvature[None], count, axis=0),
        )  # fmt: skip

    def part(self, part: slice) -> Fronts:
        """Return some of the fronts, which share their arrays with these."""
        return Fronts(*(values[part] for values in vars(self).values()))

    def sort(self) -> None:
        """Bring the fronts of the lowest cost to the front."""
        order = np.argsort(self.cost, kind="stable")
        for values in vars(self).values():
            values[:] = values[order]


def descend(
    fronts: Fronts,
    weighing: Weighing,
    layout: Layout,
    *,
    rise: float = RISE,
    fixed: BoolArray | None = None,
    known: FloatArray | None = None,
    central: bool = True,
    tolerance: float,
    iterations: int,
) -> Walk:
    """Walk downhill, every front by at most `iterations` steps.

    The cost rises by about `rise` along each displacement of a difference quotient, see
    `sysid.fit.derivatives`. Coordinates that are `fixed` (F, n) keep their value. `central` differences cost
    two simulations each, one-sided ones cost one; those by stated values are taken at every fourth step.
    Where derivatives (F, n, m) are `known` at the starts (NaN: not by this coordinate), every step corrects
    them in place by what it has met (`_corrected`), and differences are taken again only where a step gains
    much less than was promised, by stated values never. A front has converged when two steps in a row reduce
    its cost by less than the `tolerance`.
    """
    points, cost = fronts.points, fronts.cost
    count, n = points.shape
    fixed = np.zeros(points.shape, dtype=np.bool_) if fixed is None else fixed
    damping = np.full(count, _DAMPING[1])
    little = np.zeros(count, dtype=np.int64)
    fronts.converged[:] = False
    current, failed = yield points
    cost[:] = np.where(failed, np.inf, weighing.cost(slice(None), current))
    derivatives = np.full((*points.shape, current.shape[1]), np.nan) if known is None else known
    doubted = np.asarray(np.isnan(derivatives[:, :, 0]).any(axis=1))
    usable = np.ones(points.shape, dtype=np.bool_)
    for iteration in range(iterations):
        walking = np.flatnonzero(~fronts.converged & np.isfinite(cost))
        numbers: list[int] = walking.tolist()
        if not numbers:
            return
        moves: dict[int, Displacements] = {}
        for front in numbers:
            if known is None or doubted[front]:
                asked, unknown = ~fixed[front], np.isnan(derivatives[front][:, 0])
                if unknown.any():
                    asked &= unknown
                    derivatives[front][unknown] = 0.0
                elif known is not None or iteration % _REFRESHED:
                    asked[n - layout.stated :] = False
                moves[front] = displaced(
                    points[front], fronts.curvature[front], layout, asked=asked, still=fixed[front],
                    rise=rise, central=central,
                )  # fmt: skip
        asked_for = np.concatenate([points[:0], *(move.points for move in moves.values())])
        values, failed = (yield asked_for) if len(asked_for) else (current[:0], failed[:0])
        last = 0
        trials = np.repeat(points[walking, None], len(_FACTORS), axis=1)
        promised = np.zeros((len(walking), len(_FACTORS)))
        for f, front in enumerate(numbers):
            at = points[front]
            if front in moves:
                first, last = last, last + len(moves[front].points)
                derivatives[front], usable[front] = moves[front].columns(
                    current[front], values[first:last], failed[first:last], derivatives[front]
                )
            scale = weighing.scale(front, current[front])
            weighted = derivatives[front] * scale
            gradient = weighted @ (current[front] * scale)
            curvature = fronts.curvature[front] = weighted @ weighted.T
            # A coordinate at its bound whose descent leads out of the cube stays there.
            stuck = (
                ((at <= 0) & (gradient > 0)) | ((at >= 1) & (gradient < 0)) | ~usable[front] | fixed[front]
            )
            free = np.flatnonzero(~stuck)
            inner = curvature[np.ix_(free, free)]
            for k, times in enumerate(_FACTORS[: len(_FACTORS) if len(free) else 0]):
                # A coordinate that the data hardly see must not be thrown across the cube by the noise of its
                # derivative: a way of half the cube costs the tolerance.
                damped = damping[front] * times * np.diag(inner) + 4 * tolerance
                step = _inside(inner + np.diag(damped), gradient[free], at[free])
                trials[f, k, free] += step
                promised[f, k] = -(2 * gradient[free] @ step + step @ inner @ step)
        values, failed = yield trials.reshape(-1, n)
        values = values.reshape(len(walking), len(_FACTORS), -1)
        failed = failed.reshape(len(walking), len(_FACTORS))
        reached = weighing.cost(walking, values)
        reached[failed] = np.inf
        best = np.argmin(reached, axis=1)
        for f, front in enumerate(numbers):
            k = best[f]
            gain = cost[front] - reached[f, k]
            # Differences are not taken twice at a point.
            mislead = promised[f, k] > tolerance and gain < _MISLED * promised[f, k]
            doubted[front] = mislead and front not in moves and not failed[f, k]
            if known is not None and not failed[f, k]:
                derivatives[front] = _corrected(
                    derivatives[front], trials[f, k] - points[front], values[f, k] - current[front],
                    fronts.curvature[front], layout, rise,
                )  # fmt: skip
            if doubted[front] and gain <= 0:
                continue
            if gain > 0:
                points[front], cost[front], current[front] = trials[f, k], reached[f, k], values[f, k]
            factor = _FACTORS[k] if gain > 0 else 100.0
            damping[front] = np.clip(damping[front] * factor, _DAMPING[0], _DAMPING[2])
            # A step that fails although it promises much was too long: damped more, it is tried again.
            if gain > 0 or promised[f, -1] < tolerance:
                little[front] = little[front] + 1 if gain < tolerance else 0
            fronts.converged[front] = bool(little[front] == 2)


def _corrected(
    derivatives: FloatArray,
    step: FloatArray,
    change: FloatArray,
    curvature: FloatArray,
    layout: Layout,
    rise: float,
) -> FloatArray:
    """Return derivatives (n, m) that agree with the `change` (m,) of the residuals along a `step` (n,).

    The least change that does so (Broyden 1965, for residuals of one trial Schubert 1970), where coordinates
    count by their `curvature` (n, n); those by stated values are kept. A step along which the cost rises by
    less than `rise` says little: the cost is rough.
    """
    concerns = (layout.kinds[:, None] < 0) | (layout.trials[:, None] == layout.residuals)
    # Along a thin valley stated values move with every step; they would take corrections of the others.
    concerns[len(step) - layout.stated :] = False
    along = np.diag(curvature)[:, None] * step[:, None] * concerns
    share = (change - step @ derivatives) / (step @ along + rise)
    return np.asarray(derivatives + along * share)


def drive(walk: Walk, residuals: Callable[[FloatArray], tuple[FloatArray, BoolArray]]) -> int:
    """Let a walk ask for residuals (P, m) [1] until it ends; return how many points were simulated."""
    asked, count = next(walk), 0
    with suppress(StopIteration):
        while True:
            count += len(asked)
            asked = walk.send(residuals(asked))
    return count


def _inside(matrix: FloatArray, gradient: FloatArray, at: FloatArray) -> FloatArray:
    """Return the step (k,) that solves ``matrix step = -gradient`` and stays in the cube.

    A coordinate that would leave it goes to its bound, and the others follow: a step that is merely cut
    there leads correlated parameters uphill, and a fit that ends at a bound would seem to have converged.
    """
    step = np.zeros(len(at))
    free = np.ones(len(at), dtype=np.bool_)
    for _ in range(len(at)):
        step[free] = np.linalg.solve(
            matrix[np.ix_(free, free)], -gradient[free] - matrix[np.ix_(free, ~free)] @ step[~free]
        )
        # One at a time, the farthest first: with it at its bound another may stay inside.
        excess = np.where(free, np.maximum(-(at + step), at + step - 1.0), 0.0)
        worst = int(np.argmax(excess))
        if excess[worst] <= 0.0:
            break
        step[worst] = np.clip(at[worst] + step[worst], 0.0, 1.0) - at[worst]
        free[worst] = False
        if not free.any():
            break
    return np.asarray(np.clip(at + step, 0.0, 1.0) - at)


class MeanNrmse:
    """The logarithm of the mean NRMSE over the first part of every trial's window, twice, as a `Weighing`.

    `share` is the part of the window after the instant from which its times are counted [1].
    """

    def __init__(self, objective: Problem, share: float = 1.0) -> None:
        blocks, trials = objective.blocks, objective.trials
        self._starts = np.array([block.start for block in blocks])
        self._weights = np.array([block.weight for block in blocks])
        self._counts = np.empty(len(blocks))
        self._seen = np.zeros(blocks[-1].stop)
        for k, block in enumerate(blocks):
            trial = trials[block.trial]
            since = trial.time - trial.zero
            inside = (since <= share * since[-1]) & trial.valid[:, block.channel]
            self._seen[block.start : block.stop] = inside
            self._counts[k] = max(1, int(np.count_nonzero(inside)))
        self._lengths = np.diff([*self._starts, len(self._seen)])
        # Weight of the square of each distance from a stated value, see `Problem.evaluate`.
        self._prior = 1.0 / objective.independent if objective.space.stated else 0.0

    def scores(self, residuals: FloatArray) -> FloatArray:
        """Return the NRMSE of every block (..., B)."""
        compared = residuals[..., : len(self._seen)]
        squares = np.add.reduceat(compared**2 * self._seen, self._starts, axis=-1)
        return np.maximum(np.sqrt(squares / self._counts), LEAST_NRMSE)

    def cost(self, fronts: object, residuals: FloatArray) -> FloatArray:
        mean = np.einsum("...b,b->...", self.scores(residuals), self._weights)
        pulls = residuals[..., len(self._seen) :]
        return np.asarray(2.0 * np.log(mean) + self._prior * np.sum(pulls**2, axis=-1))

    def scale(self, front: int, residuals: FloatArray) -> FloatArray:
        scores = self.scores(residuals)
        mean = float(np.sum(self._weights * scores))
        each = np.sqrt(self._weights / (self._counts * scores * mean))
        pulls = np.full(len(residuals) - len(self._seen), np.sqrt(self._prior))
        return np.concatenate([np.repeat(each, self._lengths) * self._seen, pulls])


# Stages of the finisher: part of the window [1], fronts, iterations at most, central differences.
STAGES = ((0.15, 6, 6, False), (0.4, 4, 5, False), (1.0, 3, 6, False), (1.0, 2, 8, True))
# The same where the walk begins with whole windows.
_WHOLE = ((1.0, 6, 8, False), (1.0, 1, 8, True))
# NRMSE over noise [1] above which a fit that began with partial windows is too far off for a last stage.
_ASTRAY = 2.2
# Two ends whose NRMSE differs by less than this share count as one optimum.
_ALIKE = 1e-3
# The first windows were fitted with stated values as they are stated. Where these were wrong, a later bounce
# may have ended in a dent, so the best front walks again with what it made of them.
_AGAIN = ((0.25, 1, 5, False), (0.5, 1, 5, False), (0.75, 1, 5, False), (1.0, 1, 6, False))
# Least residual over noise of a channel of a trial with which the best front walks again [1].
_DENT = 2.0


class LeastSquares(Breeder):
    """Least squares from the best distinct points of a population."""

    needs_residuals = True

    def __init__(self, objective: Problem, cube: FloatArray, cost: FloatArray, whole: bool = False) -> None:
        """Begin at the best of a population: points (P, n_free) and costs (P,), best first.

        With `whole` the walk begins with whole windows.
        """
        self._objective = objective
        self._whole, self._agreed = whole, False
        self._stages = _WHOLE if whole else STAGES
        self._fronts = Fronts.at(_distinct(cube, self._stages[0][1]))
        self._scored = {point.tobytes(): float(value) for point, value in zip(cube, cost, strict=True)}
        self._walk = self._staged()
        self._asked: FloatArray | None = next(self._walk)

    def _staged(self) -> Walk:
        yield from self._through(self._stages[:-1], self._fronts)
        self._agreed = self._whole and _alike(self._fronts.cost)
        stated = bool(self._objective.space.stated)
        # A wrong model of which no two fronts agree over whole windows is left to CMA-ES.
        most = EXPLAINED if self._whole else _ASTRAY
        if stated or self._agreed or not self._over_noise > most:
            yield from self._through(self._stages[-1:], self._fronts)
        if not stated:
            return
        self._fronts.sort()
        noise = np.array([block.noise for block in self._objective.blocks])
        residuals, _ = yield self._fronts.points[:1]
        if np.any(MeanNrmse(self._objective).scores(residuals[0]) > _DENT * noise):
            again = Fronts.at(self._fronts.points[:1])
            yield from self._through(_AGAIN, again)
            if again.cost[0] < self._fronts.cost[0]:
                for mine, other in zip(vars(self._fronts).values(), vars(again).values(), strict=True):
                    mine[0] = other[0]

    def _through(self, stages: Sequence[tuple[float, int, int, bool]], fronts: Fronts) -> Walk:
        for share, count, iterations, central in stages:
            # The best come first; those that are left behind stay where they are.
            fronts.sort()
            walking = fronts.part(slice(count))
            weighing = MeanNrmse(self._objective, share)
            yield from descend(
                walking, weighing, self._objective.layout, central=central, tolerance=_TOLERANCE,
                iterations=iterations,
            )  # fmt: skip
            fronts.cost[count:] = np.inf

    def ask(self) -> FloatArray | None:
        return self._asked

    def tell(self, cost: FloatArray, residuals: FloatArray | None = None) -> None:
        assert self._asked is not None
        assert residuals is not None, "least squares lives on residuals"
        for point, value in zip(self._asked, cost, strict=True):
            self._scored[point.tobytes()] = float(value)
        try:
            # A walk takes residuals without NaN, and which points failed.
            failed = np.asarray(np.isnan(residuals).any(axis=1))
            self._asked = self._walk.send((np.where(failed[:, None], 0.0, residuals), failed))
        except StopIteration:
            self._asked = None

    def population(self) -> tuple[FloatArray, FloatArray]:
        """Return points (F, n_free) and costs (F,) of the fronts, best first."""
        cost = np.array([self._scored[point.tobytes()] for point in self._fronts.points])
        order = np.argsort(cost, kind="stable")
        return self._fronts.points[order], cost[order]

    @property
    def ended(self) -> StopReason:
        """Why the walk ended: it converged, or more is left than noise explains and no two fronts agree."""
        return "unexplained" if self._over_noise > EXPLAINED and not self._agreed else "converged"

    @property
    def _over_noise(self) -> float:
        """The lowest NRMSE over that of noise alone [1]; NaN where no noise is known."""
        return float(np.exp(self._fronts.cost.min() / 2) / noise_floor(self._objective.blocks))

    def start(self) -> Start:
        """Return where and along which axes CMA-ES goes on: at the best front, by the cost's curvature."""
        best = int(np.argmin(self._fronts.cost))
        curvature, axes = np.linalg.eigh(self._fronts.curvature[best])
        lengths = np.sqrt(2 * _AXIS_COST / np.maximum(curvature, 1e-30))
        return Start(self._fronts.points[best], np.minimum(lengths, _AXIS_LENGTH), axes)


def _alike(cost: FloatArray) -> bool:
    """Return whether the two best fronts have reached the same optimum, by the costs (F,) of all [1]."""
    least = np.sort(cost)[:2]
    return len(least) == 2 and bool(np.isfinite(least).all() and np.ptp(least) <= 2 * _ALIKE)


def _distinct(cube: FloatArray, count: int) -> FloatArray:
    """Return at most `count` of the points (P, n), the first ones that differ."""
    chosen: list[FloatArray] = []
    for point in cube:
        if all(np.max(np.abs(point - other)) > _SAME_START for other in chosen):
            chosen.append(point)
        if len(chosen) == count:
            break
    return np.array(chosen)
