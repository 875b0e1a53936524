"""What noise leaves open of the parameters, linearized at one point.

With weighted residuals rho, their derivatives J, curvature ``H = JᵀJ`` and gradient noise ``V = cov(Jᵀ
rho)``, the minimum of the sum of squares scatters with the covariance ``H⁻¹ V H⁻¹`` (White 1982, "sandwich").
V has what a plain Fisher matrix leaves out: neighbouring samples are correlated, rates are derived from
positions, blocks are weighted by their NRMSE, and what the fit takes as known (initial states) is uncertain
as well:

    V = sum over trials, channel pairs and lags of Jᵀ Γ(lag) J + G Gᵀ,  G = Jᵀ (one-sigma changes of rho)

Γ comes from the residuals of the fit, pooled over trials, with a flat-top lag window (Politis & Romano 1995)
as wide as the correlation lasts; before a fit from noise that walked through the same filter. The half-widths
use the bounds as well: a parameter is known to within its range in any case (a Gaussian of the range's
deviation).
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from sysid.fit.problem import Problem
from sysid.fit.trial import Block, NoiseModel
from sysid.parameters import AT_BOUND, SearchSpace
from sysid.trust.documents import Partner
from sysid.trust.problem import Jacobian, jacobian
from sysid.types import FloatArray

# Standard normal beyond which 5 % lie, on both sides together.
NORMAL_95 = 1.959964
# Chi-square of one degree of freedom by its share.
CHI2 = {0.68: 0.988946, 0.95: 3.841459}
# Inverse of the variance of a uniform density over the unit cube's edge.
_OF_BOUNDS = 12.0
# Least standard deviation of an estimate, over that of a uniform distribution over the parameter's range, at
# which the data count as saying nothing about the parameter [1].
_UNSEEN = 0.9
# Largest error of a minimized sum of squares, over the rise of the sum at one standard deviation of a
# parameter [1].
_TOLERANCE = 0.02
# Least correlation of parameters that trade with each other [1].
PARTNER = 0.8
# Correlation that counts as none, in its standard errors (Politis 2003), over this number of lags in a row.
_NEGLIGIBLE, _IN_A_ROW = 2.0, 5


@dataclass(frozen=True, eq=False)
class Information:
    """Linearized uncertainty at one point, in the unit cube."""

    curvature: FloatArray  # (n, n) H
    gradient_noise: FloatArray  # (n, n) V
    covariance: FloatArray  # (n, n) of the minimum, the bounds included
    # (n,) factor by which the drop of the cost along a parameter's profile exceeds chi-square,
    # ``(H⁻¹VH⁻¹)_ii/(H⁻¹)_ii`` (Kent 1982).
    inflation: FloatArray

    @property
    def sigma(self) -> FloatArray:
        """(n,) standard deviation [unit cube]."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> FloatArray:
        """(n, n) correlation of the estimates [1]."""
        sigma = self.sigma
        return self.covariance / np.outer(sigma, sigma)

    def partners(self, names: Sequence[str]) -> list[list[Partner]]:
        """Return with which of the first parameters, by name, each of them trades, the strongest first."""
        out, count = [], len(names)
        for i, row in enumerate(self.correlation[:count, :count].tolist()):
            strong = [(name, rho) for j, (name, rho) in enumerate(zip(names, row, strict=True))
                      if j != i and abs(rho) >= PARTNER]  # fmt: skip
            strong.sort(key=lambda pair: -abs(pair[1]))
            out.append([Partner(name=name, correlation=rho) for name, rho in strong])
        return out


@dataclass(frozen=True, eq=False)
class Linearized:
    """What noise leaves open at one point."""

    point: FloatArray  # (n,) [unit cube]
    levels: FloatArray  # (B,) NRMSE of every block [1]
    scale: FloatArray  # (m,) weights of the residuals
    jacobian: Jacobian
    noise: NoiseModel
    information: Information
    half_widths: FloatArray  # (n,) relative, 95 % [1]

    @property
    def derivatives(self) -> FloatArray:
        """(n, m) derivatives of the residuals without weights [1/unit cube]."""
        return np.asarray(self.jacobian.values.T / np.where(self.scale > 0, self.scale, 1.0))

    @property
    def tolerance(self) -> float:
        """What a fit's sum of squares is found to: a small share of any parameter's deviance 1."""
        return _TOLERANCE * float(np.min(self.information.inflation))


def linearized(
    problem: Problem,
    point: FloatArray,
    levels: FloatArray,
    scale: FloatArray,
    sample: float,
    noise: NoiseModel,
    disturbances: FloatArray,
    kept: FloatArray | None = None,
) -> Linearized:
    """Return what noise leaves open; `sample` is the root of a sample's share of the weighted squares.

    `kept` (S, m) are the derivatives by the stated values, where they are known.
    """
    derived = jacobian(problem, point, scale, sample, kept)
    spread = gradient_noise(problem.blocks, derived.values, scale, levels, noise, disturbances)
    known = bounded_information(derived.values, spread, point)
    widths = half_widths(problem.space, point, known.sigma)
    return Linearized(point, levels, scale, derived, noise, known, widths)


def information(jacobian: FloatArray, gradient_noise: FloatArray) -> Information:
    """Return the uncertainty from derivatives (m, n) [1] of weighted residuals and the gradient's noise."""
    n = jacobian.shape[1]
    curvature = jacobian.T @ jacobian
    size = np.sqrt(np.diag(curvature))
    seen = size > 1e-9 * max(float(size.max()), 1e-300)
    size = np.maximum(size, 1e-9 * max(float(size.max()), 1e-300))
    hessian = curvature / np.outer(size, size)
    noise = _positive(gradient_noise / np.outer(size, size))
    # The information of the data, H V⁻¹ H, and the information of the bounds add up.
    data = hessian @ np.linalg.pinv(noise, rcond=1e-10, hermitian=True) @ hessian * np.outer(size, size)
    covariance = np.linalg.inv(_positive(data) + _OF_BOUNDS * np.eye(n))
    # Directions that the data do not see at all would make the inverse infinite.
    inverse = np.linalg.pinv(hessian + 1e-12 * np.eye(n), hermitian=True)
    sandwich = inverse @ noise @ inverse
    rise = np.maximum(np.diag(sandwich), 1e-300) / np.maximum(np.diag(inverse), 1e-300)
    # A parameter that the residuals do not see has a flat profile whatever it is divided by.
    rise = np.where(seen, rise, np.median(rise[seen]) if seen.any() else 1.0)
    return Information(curvature, gradient_noise, np.asarray(covariance, dtype=np.float64), rise)


def bounded_information(jacobian: FloatArray, gradient_noise: FloatArray, point: FloatArray) -> Information:
    """Return the uncertainty at a point (n,) of the unit cube, where some parameters may not move.

    A parameter at its bound, or one that the data do not see, absorbs no error of the others. As a free
    parameter it would take a share (a motor's k_d takes the error of the torque curve), which the
    linearization counts as knowledge. The larger uncertainty of both is returned.
    """
    known = information(jacobian, gradient_noise)
    lost = known.sigma > _UNSEEN / np.sqrt(_OF_BOUNDS)
    kept = np.flatnonzero(~((point <= AT_BOUND) | (point >= 1.0 - AT_BOUND) | lost))
    if len(kept) in (0, len(point)):
        return known
    alone = information(jacobian[:, kept], gradient_noise[np.ix_(kept, kept)])
    rise = np.array(known.inflation)
    rise[kept] = np.maximum(rise[kept], alone.inflation)
    wider = np.ones(len(point))
    wider[kept] = np.maximum(1.0, alone.sigma / known.sigma[kept])
    return replace(known, inflation=rise, covariance=known.covariance * np.outer(wider, wider))


def _positive(matrix: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    floor = 1e-12 * max(float(values.max()), 1e-300)
    return np.asarray((vectors * np.maximum(values, floor)) @ vectors.T, dtype=np.float64)


def _pairs(
    blocks: Sequence[Block], channels: Sequence[int], parts: Iterable[FloatArray]
) -> Iterator[tuple[int, int, FloatArray, FloatArray]]:
    """Yield the parts of any two blocks of one trial, after the places of their channels."""
    trials: dict[int, dict[int, FloatArray]] = {}
    for block, part in zip(blocks, parts, strict=True):
        trials.setdefault(block.trial, {})[channels.index(block.channel)] = part
    for trial in trials.values():
        for (c, first), (d, second) in product(trial.items(), repeat=2):
            yield c, d, first, second


def noise_model(blocks: Sequence[Block], residuals: FloatArray) -> NoiseModel:
    """Estimate the correlations of residuals (m,) [1], pooled over trials."""
    channels = tuple(dict.fromkeys(block.channel for block in blocks))
    parts = []
    for block in blocks:
        values = residuals[block.start : block.stop]
        rms = np.sqrt(np.sum(values**2) / block.count)
        parts.append(values / max(float(rms), 1e-300))
    longest = max(1, min(map(len, parts)) // 3)
    total = np.zeros((len(channels), len(channels), longest + 1))
    samples = np.zeros((len(channels), len(channels)))
    for c, d, first, second in _pairs(blocks, channels, parts):
        n = len(first)
        spectrum = np.fft.rfft(second, 2 * n) * np.conj(np.fft.rfft(first, 2 * n))
        total[c, d] += np.fft.irfft(spectrum, 2 * n)[: longest + 1]
        samples[c, d] += n
    total /= np.maximum(samples, 1)[:, :, None]
    width = max(
        _lasting(total[c, c] / max(total[c, c, 0], 1e-300), samples[c, c]) for c in range(len(channels))
    )
    lags = np.arange(min(2 * width, longest) + 1)
    window = np.clip(2 - lags / max(width, 1), 0, 1)
    return NoiseModel(channels, total[:, :, : len(lags)] * window)


def _lasting(correlation: FloatArray, samples: float) -> int:
    """Return the lag from which on a channel's samples are uncorrelated."""
    small = np.abs(correlation) < _NEGLIGIBLE * np.sqrt(np.log10(max(samples, 10.0)) / samples)
    for lag in range(1, len(small)):
        if small[lag : lag + _IN_A_ROW].all():
            return lag
    return max(1, len(small) // 2)


def gradient_noise(
    blocks: Sequence[Block],
    jacobian: FloatArray,
    scale: FloatArray,
    levels: Sequence[float] | FloatArray,
    noise: NoiseModel,
    disturbances: FloatArray,
) -> FloatArray:
    """Return V (n, n), the covariance of ``Jᵀ rho``.

    `jacobian` (m, n) derives the residuals weighted by `scale` (m,). `levels` (B,) are the NRMSE of the noise
    in every block [1]. `disturbances` (K, m) are unweighted, see `Problem.disturbances_at`.
    """
    parts = []
    for block, level in zip(blocks, levels, strict=True):
        rows = slice(block.start, block.stop)
        amplitude = scale[rows] * level
        parts.append(jacobian[rows] * amplitude[:, None])
    out = np.zeros((jacobian.shape[1], jacobian.shape[1]))
    for c, d, first, second in _pairs(blocks, noise.channels, parts):
        length = len(first)
        for lag in np.flatnonzero(noise.covariance[c, d, :length]):
            part = noise.covariance[c, d, lag] * (first[: length - lag].T @ second[lag:])
            out += part if lag == 0 else part + part.T
    pushed = jacobian.T @ (disturbances * scale).T
    return _positive(out) + pushed @ pushed.T


def half_widths(space: SearchSpace, point: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return the expected relative 95 % half-width of every parameter (n,) [1]; infinite for a value of 0."""
    below, above = point - NORMAL_95 * sigma, point + NORMAL_95 * sigma
    low, centre, high = (space.decode(np.clip(place, 0.0, 1.0)) for place in (below, point, above))
    value = np.abs(centre)
    # An interval that a bound cuts is as wide as the side that is not cut.
    cut_low, cut_high = below < 0.0, above > 1.0
    width = np.where(cut_low & ~cut_high, 2 * (high - centre), high - low)
    width = np.where(cut_high & ~cut_low, 2 * (centre - low), width)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(value > 0, width / 2 / value, np.inf)
