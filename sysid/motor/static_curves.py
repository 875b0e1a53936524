"""Static curves by robust least squares: T(Ω), τ_aero(Ω) and Ω_0(u), one set of coefficients per direction.

A point is a row of an averaged log, or the mean over a steady segment of a log with steps
(`sysid.trials.steady.steady_points`). A point far from the curve loses weight, so that a speed probe that
misses a blade does not bend the curve.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from scipy.optimize import isotonic_regression, least_squares
from scipy.stats import norm
from scipy.stats import t as student

from sysid.errors import FitError
from sysid.motor.parameters import curve_factor
from sysid.parameters import Parameter
from sysid.types import BoolArray, FloatArray, IntArray, Rotation

# Median absolute deviation of a normal distribution in units of its standard deviation.
_MAD = 0.6745
# Distance from the curve beyond which a point is an outlier [robust standard deviations].
_OUTLIER = 5.0
# Chance at which the tails of a measured curve's errors are those of a normal distribution [1].
_RARE = 1e-3
# Group of the rows by which a fit moves measured static curves.
MEASURED_CURVE = "measured curve"


def no_load_line(direction: Rotation) -> tuple[str, ...]:
    """Return the names of slope and intercept of a no-load line in the motor's parameter table."""
    return f"no_load_slope_{direction}", f"no_load_intercept_{direction}"


@dataclass(frozen=True)
class CurveFit:
    """A curve of two coefficients, and how well the points determine it.

    The coefficients are (c2, c1) of c2 Ω|Ω| + c1 Ω, or (a, b) of a u + b sign(u) where `quantity` is
    "no_load". `standard_errors` are one standard deviation each, with a `correlation` [1] between them.
    Outliers lie more than 5 robust standard deviations from the curve. R² is 1 − Σr²/Σ(y − ȳ)² over all other
    points.
    """

    quantity: str
    direction: Rotation
    coefficients: tuple[float, float]
    standard_errors: tuple[float, float]
    units: tuple[str, str]
    r_squared: float
    points: int
    outliers: int
    correlation: float

    @classmethod
    def of(
        cls,
        quantity: str,
        direction: Rotation,
        coefficients: FloatArray,
        errors: FloatArray,
        covariance: FloatArray,
        units: tuple[str, str],
        y: FloatArray,
        residual: FloatArray,
        inlier: BoolArray,
    ) -> CurveFit:
        """Return a fit of y (n,); only the correlation of the covariance (2, 2) is used, not its scale."""
        total = float(np.sum((y[inlier] - y[inlier].mean()) ** 2))
        r_squared = 1.0 - float(np.sum(residual[inlier] ** 2)) / total if total > 0 else float("nan")
        sizes = np.sqrt(np.diag(covariance))
        correlation = float(covariance[0, 1] / (sizes[0] * sizes[1])) if np.all(sizes > 0) else 0.0
        return cls(
            quantity, direction, tuple(coefficients.tolist()), tuple(errors.tolist()), units, r_squared,
            y.size, int(np.count_nonzero(~inlier)), correlation,
        )  # fmt: skip

    def at(self, speed: float) -> tuple[float, float]:
        """Return thrust [N] or torque [N·m] at a speed [rad/s], and its standard error."""
        columns = self.columns(speed)
        return float(columns @ self.coefficients), float(np.sqrt(columns @ self.covariance @ columns))

    def columns(self, place: float) -> FloatArray:
        """Return the factors (2,) of the coefficients at a speed [rad/s] or command [1]."""
        return np.array(
            [place, np.sign(place)] if self.quantity == "no_load" else [place * abs(place), place]
        )

    @property
    def covariance(self) -> FloatArray:
        """(2, 2) covariance of the coefficients [SI]."""
        errors = np.outer(self.standard_errors, self.standard_errors)
        return np.asarray(errors * np.array([[1.0, self.correlation], [self.correlation, 1.0]]))

    @property
    def parameters(self) -> dict[str, float]:
        """The two coefficients under their names in the motor's parameter table [SI]."""
        names = no_load_line(self.direction)
        if self.quantity != "no_load":
            names = tuple(f"{self.quantity}_{name}_{self.direction}" for name in ("quadratic", "linear"))
        return dict(zip(names, self.coefficients, strict=True))

    def document(self) -> dict[str, object]:
        """Return the fit as a result states it."""
        return {
            "quantity": self.quantity, "direction": self.direction, "coefficients": list(self.coefficients),
            "standard_errors": list(self.standard_errors), "correlation": self.correlation,
            "units": list(self.units), "r_squared": self.r_squared, "points": self.points,
            "outliers": self.outliers,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class MeasuredCurve:
    """A static curve of logs under `[curves]`, and two parameters that move it within its errors.

    The first parameter is a factor [1] on the curve at full speed or command, the second one a factor
    half-way with the end unchanged. Their errors are independent. A unit of parameter i changes the
    coefficients by `changes[i]` [SI].
    """

    fit: CurveFit
    rows: tuple[Parameter, ...]
    errors: tuple[float, ...]
    changes: FloatArray

    @classmethod
    def of(cls, fit: CurveFit, top: float) -> MeasuredCurve | None:
        """Return a curve whose points reach to `top` [rad/s] or [1]; None where its errors are not known."""
        if fit.points < 3:
            return None
        # The scatter of few points is itself uncertain, so its tails follow Student's t.
        wider = float(student.isf(_RARE, fit.points - 2) / norm.isf(_RARE))
        left, rows, errors, changes = wider**2 * fit.covariance, [], [], []
        name, symbol = ("no_load_line", "Ω_0") if fit.quantity == "no_load" else ("torque_curve", "τ")
        for share, place, words in ((1.0, "top", "at full speed or command"), (0.5, "middle", "half-way")):
            columns = fit.columns(share * top)
            value, spread = float(columns @ fit.coefficients), float(columns @ left @ columns)
            if not (np.isfinite(spread) and spread > 0.0 and value):
                return None
            move = left @ columns
            left = left - np.outer(move, move) / spread
            changes.append(move * value / spread)
            errors.append(float(np.sqrt(spread)) / abs(value))
            rows.append(
                Parameter(
                    curve_factor(name, place, fit.direction), f"{symbol} {fit.direction}, {place}", "1", 1.0,
                    0.0, 2.0, "linear", f"Factor on the measured static curve, {words}.", "static logs",
                    MEASURED_CURVE,
                )
            )  # fmt: skip
        return cls(fit, tuple(rows), tuple(errors), np.array(changes))


@dataclass(frozen=True, eq=False)
class NoLoadTie:
    """No-load line of loaded steady points, which moves with R: Ω_0 = Ω + R (τ + k_d Ω)/(k_m k_v).

    `columns` (n, 2) are u and sign(u) of the points, times V/V_ref. `points` (n, 2) are the loaded speeds Ω
    [rad/s] and the drags τ [N·m]. The rotor stands at commands up to `standing` |u| [1].

    Notes
    -----
    The soft-L1 weights of the points are computed once, about a parabola of Ω over u. The line is then linear
    in R/(k_m k_v), and a candidate of the search costs one product.
    """

    columns: FloatArray
    points: FloatArray
    standing: float = 0.0

    @cached_property
    def _by_level(self) -> tuple[FloatArray, IntArray, FloatArray]:
        """|u| (k,) of the levels [1], the level of each point (n,) and the point's weight in it (n,) [1]."""
        size = np.abs(self.columns)
        u, index = np.unique(np.round(size[:, 0] / size[:, 1], 6), return_inverse=True)
        return u, index, self.weights / np.bincount(index, self.weights)[index]

    @cached_property
    def levels(self) -> FloatArray:
        """(k, 3) the map of the supply law: |u|, and |Ω| [rad/s] and |τ| [N·m] over V/V_ref, never falling.

        Points of one command are one level, their weighted mean. The first level is a rotor at rest.
        """
        u, index, share = self._by_level
        ratio = np.abs(self.columns[:, 1])
        means = [np.bincount(index, share * np.abs(each) / ratio) for each in self.points.T]
        rising = [isotonic_regression(each, weights=np.bincount(index, self.weights)).x for each in means]
        map_ = np.column_stack([u, *rising])
        return np.vstack([[min(self.standing, u[0] - 1e-3), 0.0, 0.0], map_])

    @cached_property
    def measured(self) -> FloatArray:
        """(k, 3) the levels as measured, under the supply of the logs: |u|, |Ω| [rad/s], V/V_ref [1].

        The speeds never fall. At V_ref the rotor would be faster, by less than V_ref/V.
        """
        u, index, share = self._by_level
        speed, ratio = (
            np.bincount(index, share * np.abs(each)) for each in (self.points[:, 0], self.columns[:, 1])
        )
        rising = isotonic_regression(speed, weights=np.bincount(index, self.weights)).x
        return np.vstack([[self.levels[0, 0], 0.0, 1.0], np.column_stack([u, rising, ratio])])

    @cached_property
    def repeats(self) -> float:
        """Relative standard deviation of speeds at a repeated command [1]; NaN if no command is repeated."""
        _, index, _ = self._by_level
        speed, count = np.abs(self.points[:, 0]), np.bincount(index)
        off = speed / (np.bincount(index, speed) / count)[index] - 1.0
        freedom = len(speed) - len(count)
        return float(np.sqrt(off @ off / freedom)) if freedom else float("nan")

    @cached_property
    def misfit(self) -> float:
        """Distance (rms) of the levels from a straight line over u, over the top speed [1]."""
        u, speed, _ = self.levels[1:].T
        slope, intercept = self.lines[0]
        return float(np.sqrt(np.mean((slope * u + intercept - speed) ** 2)) / np.max(speed))

    def document(self, is_map: bool) -> dict[str, object]:
        """Return the supply law as a result states it: levels, line, and which of both the fit uses."""
        columns = ["command [1]", "loaded speed V_ref/V [rad/s]", "drag V_ref/V [N·m]"]
        measured = ["command [1]", "loaded speed [rad/s]", "V/V_ref [1]"]
        law = "map" if is_map else "line"
        return {
            "law": law, "misfit_of_line": self.misfit, "line": self.lines[0].tolist(), "columns": columns,
            "levels": self.levels.tolist(), "measured_columns": measured, "measured": self.measured.tolist(),
            "repeats": self.repeats if np.isfinite(self.repeats) else None,
        }  # fmt: skip

    def mapped(self, u: FloatArray) -> FloatArray:
        """Return loaded speed [rad/s] and drag [N·m] (m, 2) at V_ref of commands u (m,), monotone in |u|."""
        levels, size = self.levels, np.abs(u)
        curves = PchipInterpolator(levels[:, 0], levels[:, 1:])
        inside = curves(np.clip(size, levels[0, 0], levels[-1, 0]))
        slope = (levels[-1, 1:] - levels[-2, 1:]) / (levels[-1, 0] - levels[-2, 0])
        return np.asarray(
            np.sign(u)[:, None] * (inside + np.maximum(size - levels[-1, 0], 0.0)[:, None] * slope)
        )

    @cached_property
    def weights(self) -> FloatArray:
        """(n,) soft-L1 weights of the points [1]."""
        # The drag bends Ω(u) about like u|u|. The measured drag of a misread speed is wrong as well, so the
        # parabola does without it.
        u, sign = self.columns.T
        columns, speed = np.column_stack([u, sign, u * u / sign]), self.points[:, 0]
        scaled = columns / np.max(np.abs(columns), axis=0)
        solution, sigma = _robust_solution(scaled, speed)
        # Weighted least squares with these weights is the robust fit.
        return np.asarray(1.0 / np.sqrt(1.0 + ((speed - scaled @ solution) / sigma) ** 2), dtype=np.float64)

    @cached_property
    def lines(self) -> FloatArray:
        """Slope and intercept (4, 2) of the weighted lines over u, at V_ref: of Ω, τ, u²Ω and u²τ [SI]."""
        root = np.sqrt(self.weights)
        columns = root[:, None] * self.columns
        u = self.columns[:, 0] / np.abs(self.columns[:, 1])
        values = [*self.points.T, *(u * u * self.points.T)]
        return np.array([np.linalg.lstsq(columns, root * each, rcond=None)[0] for each in values])

    def line(self, drop: FloatArray, damping: FloatArray, sag: FloatArray | None = None) -> FloatArray:
        """Return slope and intercept (P, 2) of Ω_0 for R/(k_m k_v) (P,) [rad/s per N·m] and k_d (P,).

        `sag` (P,) is R_s/(k_m k_v) with the supply's resistance R_s, whose drop is proportional to u².
        """
        speed, torque, squared_speed, squared_torque = self.lines
        line = (1.0 + drop * damping)[:, None] * speed + drop[:, None] * torque
        if sag is not None:
            line = line + sag[:, None] * (damping[:, None] * squared_speed + squared_torque)
        return np.asarray(line, dtype=np.float64)

    def fit(self, direction: Rotation, drop: float, damping: float) -> CurveFit:
        """Return the line at one R/(k_m k_v) and k_d, and how well the points lie on it.

        The standard errors are those of the points. They leave out the error of R, which moves all points
        together.
        """
        line = self.line(np.array([drop]), np.array([damping]))[0]
        speed, torque = self.points.T
        lifted = np.asarray(speed + drop * (torque + damping * speed), dtype=np.float64)
        residual = lifted - self.columns @ line
        sigma = max(float(np.median(np.abs(residual))) / 0.6745, 1e-9 * float(np.max(np.abs(lifted))))
        near = np.abs(residual) <= _OUTLIER * sigma
        # Outliers keep their weight in the line, but the error is the scatter of the other points.
        weight = np.where(near, self.weights, 0.0)
        spread = float(weight @ residual**2) / max(float(weight.sum()) - 2.0, 1.0)
        weighted = self.weights[:, None] * self.columns
        information = np.asarray(np.linalg.inv(self.columns.T @ weighted), dtype=np.float64)
        errors = np.sqrt(np.diag(spread * information))
        units = ("rad/s", "rad/s")
        return CurveFit.of("no_load", direction, line, errors, information, units, lifted, residual, near)


def fit_speed_curve(
    quantity: Literal["thrust", "torque"],
    direction: Rotation,
    speed: ArrayLike,
    value: ArrayLike,
    *,
    zero_rows: int = 0,
    zero_error: float = 0.0,
) -> CurveFit:
    """Fit c2 Ω|Ω| + c1 Ω to the points of one direction.

    `speed` (n,) are steady speeds [rad/s], `value` (n,) thrust [N] or aerodynamic torque [N·m] with the sign
    of the speed. NaN pairs, and points that turn the other way, are left out. The mean of `zero_rows` points
    at rest was subtracted as the tare, whose error shifts all points together and counts in the standard
    errors; 0 is an exact tare. `zero_error` [N] or [N·m] is that error, where it is known.
    FitError when fewer than three points at different speeds remain, or the curve has the wrong sign.
    """
    unit = "N" if quantity == "thrust" else "N·m"
    omega, y = _of_direction(direction, speed, value)
    columns = np.column_stack([omega * np.abs(omega), omega])
    units = (f"{unit}·s²/rad²", f"{unit}·s/rad")
    fit = _robust_line(quantity, direction, columns, y, units, zero_rows, zero_error)
    top = float(np.max(np.abs(omega)))
    at_top = (fit.coefficients[0] * top + fit.coefficients[1]) * top
    if not at_top > 0:
        raise FitError(
            f"{quantity} curve, {direction}: {abs(at_top):.3g} {unit} against the rotation at {top:.0f} "
            "rad/s; expected the sign of the speed, correct the sign of the channel"
        )
    return fit


def fit_no_load_line(
    direction: Rotation, command: ArrayLike, speed: ArrayLike, *, supply_ratio: ArrayLike = 1.0
) -> CurveFit:
    """Fit Ω_0 = a u + b sign(u) to no-load speeds (n,) [rad/s] of one direction, divided by V/V_ref (n,).

    Commands u (n,) of the other sign, and u = 0, are left out.
    """
    ratio = np.broadcast_to(np.asarray(supply_ratio, dtype=np.float64), np.shape(speed))
    u, omega = _of_direction(direction, command, np.asarray(speed, dtype=np.float64) / ratio)
    columns = np.column_stack([u, np.sign(u)])
    return _robust_line("no_load", direction, columns, omega, ("rad/s", "rad/s"))


def turns(values: FloatArray, direction: Rotation) -> BoolArray:
    """Return True (n,) where a speed or command (n,) [any unit] has the direction."""
    return values > 0 if direction == "forward" else values < 0


def _of_direction(direction: Rotation, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    xs, ys = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    keep = np.isfinite(xs) & np.isfinite(ys) & turns(xs, direction)
    return xs[keep], ys[keep]


def _robust_line(
    quantity: str,
    direction: Rotation,
    columns: FloatArray,
    y: FloatArray,
    units: tuple[str, str],
    zero_rows: int = 0,
    zero_error: float = 0.0,
) -> CurveFit:
    """Fit y (n,) by two columns (n, 2), of which the first differs wherever speed or command differs."""
    different = np.unique(columns[:, 0]).size
    if different < 3:
        what = "command" if quantity == "no_load" else "speed"
        raise FitError(
            f"{quantity} curve, {direction}: steady points at {different} different {what}s; expected at "
            "least 3: add a log with more steady steps in this direction"
        )
    # Columns scaled to 1, because c2 and c1 differ by the speed, three orders of magnitude.
    size = np.max(np.abs(columns), axis=0)
    scaled = columns / size
    start, sigma = _robust_solution(scaled, y)
    residual = y - scaled @ start
    weight = 1.0 / np.sqrt(1.0 + (residual / sigma) ** 2)
    inlier = np.abs(residual) <= _OUTLIER * sigma
    # Huber's covariance of an M-estimator (Robust Statistics, 1981, §7.6), from pull and curvature of each
    # point. The formula of weighted least squares states a fifth too little.
    pull, curvature = (residual / sigma) * weight, weight**3
    small = 1.0 + 2.0 / y.size * float(np.var(curvature)) / float(np.mean(curvature)) ** 2
    spread = (
        (small * sigma / float(np.mean(curvature))) ** 2 * float(np.sum(pull**2)) / max(1.0, y.size - 2.0)
    )
    covariance = spread * np.linalg.inv(scaled.T @ scaled)
    if zero_rows or zero_error:
        # The error of the tare shifts all points together.
        shift = np.linalg.solve(scaled.T @ (curvature[:, None] * scaled), scaled.T @ curvature)
        of_rows = spread / zero_rows if zero_rows else 0.0
        covariance = covariance + max(of_rows, zero_error**2) * np.outer(shift, shift)
    coefficients, errors = start / size, np.sqrt(np.diag(covariance)) / size
    return CurveFit.of(quantity, direction, coefficients, errors, covariance, units, y, residual, inlier)


def _robust_solution(columns: FloatArray, y: FloatArray) -> tuple[FloatArray, float]:
    """Return the coefficients (k,) of the soft-L1 fit of y over columns, and the scale of its residuals."""
    floor = 1e-9 * (float(np.max(np.abs(y))) or 1.0)
    # Scale and solution in turn, until both stay.
    start: FloatArray = np.asarray(np.linalg.lstsq(columns, y, rcond=None)[0], dtype=np.float64)
    for _ in range(10):
        residual = y - columns @ start
        sigma = max(float(np.median(np.abs(residual))) / _MAD, floor)
        scaled, target = columns / sigma, y / sigma
        fit = least_squares(
            lambda x, a, b: a @ x - b,  # type: ignore[misc]
            start,
            jac=lambda x, a, b: a,  # type: ignore[misc]
            args=(scaled, target),
            loss="soft_l1",
        )
        solution = np.asarray(fit.x, dtype=np.float64)
        done = np.max(np.abs(solution - start)) <= 1e-10 * np.max(np.abs(solution))
        start = solution
        if done:
            break
    residual = y - columns @ start
    return start, max(float(np.median(np.abs(residual))) / _MAD, floor)
