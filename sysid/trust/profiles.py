"""Profile likelihood: move one parameter off its best value, fit all others, see what that costs.

The deviance of a fixed value is the rise of the least sum of squares over the best one, divided by the
inflation of that parameter (`sysid.trust.linearized`). It follows chi-square with one degree of freedom
(Kent 1982): values below 0.99 lie in the 68 % interval, below 3.84 in the 95 % one. An interval whose
deviance stays below the limit up to a bound of the search is open there.

All parameters walk outward at the same time, both sides of each as one front; every point starts where the
last one ended, moved along the tangent of the valley.
"""

from dataclasses import dataclass

import numpy as np

from sysid.fit.problem import Problem
from sysid.parameters import SearchSpace
from sysid.trust.least_squares import search_around, solve
from sysid.trust.linearized import CHI2, Linearized
from sysid.types import FloatArray

# Square roots of the deviance that the points of a profile aim at.
_AIMS = (0.5, 1.0, 1.5, 1.96, 2.5)
# Deviance beyond which a profile ends.
_ENOUGH = 4.6
# Largest number of points on a side.
_MOST_POINTS = 14
# Largest step between two points [unit cube].
_FARTHEST = 0.15
# Factor by which steps grow in a flat valley [1].
_STRETCH = 2.0
# Largest number of steps of the fit at a point.
_ITERATIONS = 12
# Least rise over the last point that is a bump of a rough cost, not a valley's wall [deviance].
_BUMP = 1.0


@dataclass(frozen=True, eq=False)
class Profile:
    """Deviance over one parameter at k points, all others fitted.

    An interval is open at an end where the data do not end it inside the bounds of the search.
    """

    name: str
    unit: str
    values: FloatArray  # (k,) of the parameter, ascending [SI]
    deviance: FloatArray  # (k,) chi-square with one degree of freedom where the value is true [1]
    others: FloatArray  # (k, n) all free parameters at each point, in the order of the space [SI]
    best: float  # value of deviance 0 [SI]
    interval_68: tuple[float, float]  # [SI]; a bound of the search where open
    interval_95: tuple[float, float]
    open_68: tuple[bool, bool]
    open_95: tuple[bool, bool]
    rough: int  # points whose least cost CMA-ES found, because derivatives led nowhere

    @property
    def half_width(self) -> float:
        """Half of the 95 % interval over the best value [1]; infinite where an end is open."""
        if any(self.open_95) or self.best == 0.0:
            return float("inf")
        return (self.interval_95[1] - self.interval_95[0]) / 2 / abs(self.best)


@dataclass(frozen=True, eq=False)
class Profiles:
    """All profiles in the order of the space, and the best point (n,) that they found [unit cube].

    That point lies below the start by `lowered`, the most that it is for any parameter [deviance].
    `evaluations` counts the simulated points.
    """

    profiles: tuple[Profile, ...]
    best: FloatArray
    lowered: float
    evaluations: int


@dataclass(eq=False)
class _Side:
    """One parameter walking one way."""

    parameter: int
    sign: float
    points: list[FloatArray]
    squares: list[float]
    aims: list[float]
    derivatives: FloatArray
    done: bool = False
    rough: int = 0


def walk_profiles(problem: Problem, linear: Linearized, seed: int = 0) -> Profiles:
    """Walk every parameter of which nothing is stated outward; `seed` is for CMA-ES where costs are rough."""
    best, scale, info = linear.point, linear.scale, linear.information
    n, found, derivatives = len(best), len(problem.space.found), linear.derivatives
    values, _ = problem.residuals(best[None])
    lowest = float(np.sum((values[0] * scale) ** 2))
    sides = [
        _Side(i, sign, [best], [lowest], list(_AIMS), derivatives.copy(), done=bool(best[i] == bound))
        for i in range(found)
        for sign, bound in ((-1.0, 0.0), (1.0, 1.0))
    ]
    curvature = info.curvature + 1e-12 * np.trace(info.curvature) * np.eye(n)
    inverse = np.linalg.inv(curvature)
    tangent = inverse / np.diag(inverse)
    # Deviance 1 lies here where the cost is quadratic.
    unit = np.sqrt(np.diag(inverse) * info.inflation)
    evaluations = 1
    for _ in range(_MOST_POINTS):
        moving = [side for side in sides if not side.done]
        if not moving:
            break
        starts = np.empty((len(moving), n))
        fixed = np.zeros((len(moving), n), dtype=np.bool_)
        for f, side in enumerate(moving):
            rise = (side.squares[-1] - lowest) / info.inflation[side.parameter]
            starts[f] = _next(side, best, unit, tangent, np.sqrt(max(rise, 0.0)))
            fixed[f, side.parameter] = True
        known = np.array([side.derivatives for side in moving])
        solved = solve(
            problem, starts, scale, rise=linear.jacobian.rise, curvature=info.curvature, fixed=fixed,
            known=known, tolerance=linear.tolerance, iterations=_ITERATIONS,
        )  # fmt: skip
        # An unconverged point that ends an interval walks on: it may lie in a dent.
        inflation = info.inflation[[side.parameter for side in moving]]
        late = np.flatnonzero(~solved.converged & ((solved.squares - lowest) / inflation > CHI2[0.95]))
        if len(late):
            more = solve(
                problem, solved.points[late], scale, rise=linear.jacobian.rise, fixed=fixed[late],
                tolerance=linear.tolerance, iterations=_ITERATIONS,
            )  # fmt: skip
            solved = solved.walked_on(late, more)
        evaluations += solved.evaluations
        for f, side in enumerate(moving):
            i, side.derivatives = side.parameter, known[f]
            point, squares = solved.points[f], float(solved.squares[f])
            last = side.squares[-1]
            aimed = (abs(point[i] - best[i]) / unit[i]) ** 2
            bumped = (squares - last) / info.inflation[i] > max(_BUMP, 2.0 * aimed)
            if not np.isfinite(squares) or (bumped and not solved.converged[f]):
                around = np.clip(3 * unit, 1e-3, 0.05)
                again, lower, spent = search_around(
                    problem, starts[f], around, scale, fixed[f], seed + 2 * i + (side.sign > 0)
                )
                evaluations += spent
                if lower < squares:
                    point, squares = again, lower
                side.rough += 1
            side.points.append(point)
            side.squares.append(squares)
            side.done = point[i] in (0.0, 1.0) or (squares - lowest) / info.inflation[i] > _ENOUGH
    winner = min(sides, key=lambda side: min(side.squares))
    least, lowered = min(winner.squares), 0.0
    if least < lowest:
        best = winner.points[int(np.argmin(winner.squares))]
        lowered = (lowest - least) / float(info.inflation[:found].min())
    out = [
        _profile(problem.space, i, sides[2 * i : 2 * i + 2], best, least, float(info.inflation[i]))
        for i in range(found)
    ]
    return Profiles(tuple(out), best, lowered, evaluations)


def _next(side: _Side, best: FloatArray, unit: FloatArray, tangent: FloatArray, reached: float) -> FloatArray:
    """Return the start of a side's next point: a little farther out, the others along the valley.

    `reached` is the square root of the deviance at its last point.
    """
    i, last = side.parameter, side.points[-1]
    gone = abs(last[i] - best[i])
    while side.aims and side.aims[0] <= 1.05 * reached:
        side.aims.pop(0)
    aim = side.aims[0] if side.aims else np.sqrt(_ENOUGH) * 1.1
    # The deviance of the walk so far tells how far the next aim lies.
    slope = unit[i] if gone == 0.0 or reached < 0.1 else gone / reached
    step = min((aim - reached) * slope, _FARTHEST, max(_STRETCH * gone, unit[i]))
    place = np.clip(last[i] + side.sign * max(step, 1e-4), 0.0, 1.0)
    direction = tangent[:, i]
    if len(side.points) > 1:
        before = side.points[-2]
        direction = (last - before) / (last[i] - before[i])
    start = np.clip(last + np.clip((place - last[i]) * direction, -0.2, 0.2), 0.0, 1.0)
    start[i] = place
    return start


def _profile(
    space: SearchSpace, i: int, sides: list[_Side], best: FloatArray, least: float, inflation: float
) -> Profile:
    points = np.array([*sides[0].points[:0:-1], *sides[1].points])
    squares = np.array([*sides[0].squares[:0:-1], *sides[1].squares])
    # The lowest point of any parameter's walk lies on this parameter's profile, too.
    if not np.any(np.all(points == best, axis=1)):
        points, squares = np.vstack([points, best]), np.append(squares, least)
    order = np.argsort(points[:, i], kind="stable")
    points, squares = points[order], squares[order]
    deviance = np.maximum((squares - least) / inflation, 0.0)
    centre = int(np.argmin(deviance))

    def interval(limit: float) -> tuple[tuple[float, float], tuple[bool, bool]]:
        low, high = ends(points[:, i], deviance, limit)
        cube = np.full((2, len(space.free)), 0.5)
        cube[:, i] = 0.0 if low is None else low, 1.0 if high is None else high
        below, above = space.decode(cube)[:, i].tolist()
        return (below, above), (low is None, high is None)

    interval_68, open_68 = interval(CHI2[0.68])
    interval_95, open_95 = interval(CHI2[0.95])
    row, decoded = space.free[i], space.decode(points)
    return Profile(
        row.name, row.unit, decoded[:, i], deviance, decoded, float(decoded[centre, i]),
        interval_68, interval_95, open_68, open_95, sum(side.rough for side in sides),
    )  # fmt: skip


def ends(place: FloatArray, rise: FloatArray, limit: float) -> tuple[float | None, float | None]:
    """Return below and above which ascending places (k,) a rise (k,) exceeds a limit for good.

    The rise is 0 at its least; between two places its square root is linear. None: the end is open.
    """
    # A bump between two points below the limit ends no interval.
    within = np.flatnonzero(rise <= limit)
    out: list[float | None] = []
    for inside, outside in ((within[0], within[0] - 1), (within[-1], within[-1] + 1)):
        if not 0 <= outside < len(place):
            out.append(None)
            continue
        low, high = np.sqrt(rise[inside]), np.sqrt(rise[outside])
        share = (np.sqrt(limit) - low) / (high - low)
        out.append(float(place[inside] + share * (place[outside] - place[inside])))
    return out[0], out[1]
