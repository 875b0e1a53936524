"""A function of time in cubic pieces: how one model hands a history to another without samples in between."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sysid.types import FloatArray

# Shortest piece, whatever its error [s]: a jump of the slope stays one.
_SHORTEST = 2e-5


@dataclass(frozen=True, eq=False)
class PiecewiseCubic:
    """Cubic polynomials between knots, constant before the first and after the last."""

    knots: FloatArray  # (n + 1,) increasing instants [s]
    coefficients: FloatArray  # (n, 4) of (t - knots[i])**0 .. **3 in piece i [unit of the value over s**k]

    def __post_init__(self) -> None:
        knots = np.array(self.knots, dtype=np.float64)
        coefficients = np.array(self.coefficients, dtype=np.float64)
        if knots.ndim != 1 or coefficients.shape != (len(knots) - 1, 4) or (np.diff(knots) <= 0).any():
            raise ValueError(
                f"piecewise cubic: {knots.shape} knots and {coefficients.shape} coefficients; expected n + 1 "
                "increasing knots and (n, 4) coefficients"
            )
        knots.flags.writeable = coefficients.flags.writeable = False
        object.__setattr__(self, "knots", knots)
        object.__setattr__(self, "coefficients", coefficients)

    @classmethod
    def constant(cls, value: float) -> PiecewiseCubic:
        """Return a history of one value."""
        return cls(np.array([0.0, 1.0]), np.array([[value, 0.0, 0.0, 0.0]]))

    @classmethod
    def from_slopes(cls, time: ArrayLike, value: ArrayLike, slope: ArrayLike) -> PiecewiseCubic:
        """Return the cubic Hermite interpolant of values and slopes (n,) at increasing times (n,) [s]."""
        t, y, v = (np.asarray(a, dtype=np.float64) for a in (time, value, slope))
        h = np.diff(t)
        rise = np.diff(y) / h
        second = (3 * rise - 2 * v[:-1] - v[1:]) / h
        return cls(t, np.column_stack([y[:-1], v[:-1], second, (v[:-1] + v[1:] - 2 * rise) / h**2]))

    def __call__(self, time: ArrayLike) -> FloatArray:
        """Return the values at times (...) [s]."""
        t = np.clip(np.asarray(time, dtype=np.float64), self.knots[0], self.knots[-1])
        piece = np.clip(np.searchsorted(self.knots, t, side="right") - 1, 0, len(self.coefficients) - 1)
        s = t - self.knots[piece]
        c = self.coefficients[piece]
        return c[..., 0] + s * (c[..., 1] + s * (c[..., 2] + s * c[..., 3]))

    def on(self, knots: FloatArray) -> FloatArray:
        """Return coefficients (n, 4) about other knots (n + 1,) [s], this history's among them."""
        middle = 0.5 * (knots[:-1] + knots[1:])
        piece = np.clip(np.searchsorted(self.knots, middle, side="right") - 1, 0, len(self.coefficients) - 1)
        s = np.asarray(knots[:-1] - self.knots[piece])
        a, b, c, d = self.coefficients[piece].T
        out = np.column_stack([a + s * (b + s * (c + s * d)), b + s * (2 * c + 3 * s * d), c + 3 * s * d, d])
        out[middle < self.knots[0]] = [self.coefficients[0, 0], 0.0, 0.0, 0.0]
        out[middle > self.knots[-1]] = [float(self(self.knots[-1])), 0.0, 0.0, 0.0]
        return out


def refined(
    sample: Callable[[FloatArray], tuple[FloatArray, FloatArray]], knots: ArrayLike, tolerance: float
) -> PiecewiseCubic:
    """Return cubic pieces that follow a function, halved until the middle of each agrees.

    `sample` returns values and slopes, (n,) each, at increasing times (n,) [s]. Pieces end at the `knots`
    (n,) [s]: first and last time, and instants at which the function is not smooth. `tolerance` is the
    largest error in the middle of a piece [unit of the value].
    """
    time = np.unique(np.asarray(knots, dtype=np.float64))
    while True:
        middle = 0.5 * (time[:-1] + time[1:])
        every = np.sort(np.concatenate([time, middle]))
        value, slope = sample(every)
        out = PiecewiseCubic.from_slopes(time, value[::2], slope[::2])
        poor = (np.abs(out(middle) - value[1::2]) > tolerance) & (np.diff(time) > 2 * _SHORTEST)
        if not poor.any():
            return PiecewiseCubic.from_slopes(every, value, slope)
        time = np.sort(np.concatenate([time, middle[poor]]))
