"""Bench trials as trust sees them: residuals of the dynamic fit, and what the static curves leave open.

The dead band is fitted after the dynamic fit with all else held, so it takes no part here; R, L, k_d, the
delays and whatever else the dynamic fit frees do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sysid.motor.cost import CHANNELS, MotorTarget
from sysid.motor.known_values import CONSTANTS
from sysid.motor.objective import MotorObjective
from sysid.motor.static_curves import CurveFit
from sysid.parameters import SearchSpace
from sysid.trust.linearized import NoiseModel
from sysid.trust.problem import Block
from sysid.types import BoolArray, FloatArray

# Simulated samples that are held at once [bytes].
_MEMORY = 64e6
# NRMSE of noise where a channel shows none: as coarse as its last digit, so not known any better.
ASSUMED_NOISE = 0.02
# A range is a uniform density: its standard deviation is the width over this root.
_UNIFORM = 12.0


def sensor_noise(target: MotorTarget, channel: int) -> float:
    """Return the standard deviation of a channel's noise as compared [its unit]; NaN where it shows none.

    From the median third difference, in which a signal that is smooth most of the time leaves little. White
    noise that has passed the filter of a fast log leaves less there, too, by what the filter's taps say.
    """
    known = target.measured[target.valid[:, channel], channel]
    if len(known) < 20:
        return float("nan")
    share = filtered_correlation(target, 3)
    gain = 20.0 * share[0] - 30.0 * share[1] + 12.0 * share[2] - 2.0 * share[3]
    sigma = float(np.median(np.abs(np.diff(known, 3)))) / 0.6745 / np.sqrt(gain)
    return sigma if sigma > 0 else float("nan")


def filtered_correlation(target: MotorTarget, lags: int) -> FloatArray:
    """Return the correlation (lags + 1,) of white noise as compared, by samples apart [1]."""
    out = np.zeros(lags + 1)
    out[0] = 1.0
    if len(target.taps):
        stride = round(float(np.median(np.diff(target.time))) / target.grid_step)
        whole = np.concatenate([target.taps[:0:-1], target.taps])
        own = np.correlate(whole, whole, "full")[len(whole) - 1 :: stride][: lags + 1]
        out[: len(own)] = own / own[0]
    return out


@dataclass(frozen=True, eq=False)
class MotorProblem:
    """The trials of an objective as residuals; see `sysid.trust.problem.Problem`.

    Parameters
    ----------
    objective : MotorObjective
    curves : tuple of CurveFit
        Static curves, whose standard errors the dynamic fit takes as zero.
    ranges : mapping of str to (low, high)
        Within which values lie that the fit takes as known [SI], such as a Kv or an inertia.
    """

    objective: MotorObjective
    curves: tuple[CurveFit, ...] = ()
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    blocks: tuple[Block, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "blocks", self._blocks())

    @property
    def space(self) -> SearchSpace:
        """The free parameters."""
        return self.objective.space

    @property
    def trials(self) -> tuple[str, ...]:
        """Names of the trials."""
        return tuple(trial.entry.name for trial in self.objective.trials)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the compared channels."""
        return CHANNELS

    def _blocks(self) -> tuple[Block, ...]:
        cost = self.objective.cost
        weights = cost.weights / cost.weights.sum() / len(cost.targets)
        out, start = [], 0
        for t, target in enumerate(cost.targets):
            for c in range(2):
                if weights[c] == 0:
                    continue
                stop = start + len(target.time)
                count = int(np.count_nonzero(target.valid[:, c]))
                spread = float(cost.denominators[t, c])
                noise = sensor_noise(target, c) / spread
                noise = noise if np.isfinite(noise) else ASSUMED_NOISE
                out.append(Block(t, c, start, stop, count, float(weights[c]), spread, noise))
                start = stop
        return tuple(out)

    def residuals(self, cube: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return residuals (P, m) in units of each channel's spread [1], and which points failed (P,)."""
        return self.compared(self.space.full(cube))

    def compared(self, rows: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return residuals and failures of rows of the whole table (P, n_par) [SI]."""
        objective = self.objective
        rows = objective.complete(rows)
        share = max(1, int(_MEMORY / (16 * objective.jobs.time.size)))
        out = np.zeros((len(rows), self.blocks[-1].stop))
        failed = np.zeros(len(rows), dtype=np.bool_)
        for first in range(0, len(rows), share):
            part = slice(first, min(first + share, len(rows)))
            samples, reached = objective.simulate(rows[part])
            failed[part] = np.any(reached < 1.0, axis=1)
            prepared = objective.cost.prepared(np.nan_to_num(samples), objective.sensors(rows[part]))
            for block in self.blocks:
                target = objective.cost.targets[block.trial]
                valid = target.valid[:, block.channel]
                signal = prepared[block.trial][:, :, block.channel]
                error = np.where(valid, signal - target.measured[:, block.channel], 0.0)
                out[part, block.start : block.stop] = error / block.spread
        return np.nan_to_num(out), failed

    def disturbances(self, cube: FloatArray) -> FloatArray:
        """Return how one standard deviation of what the fit takes as known moves the residuals (K, m).

        Static curves, values that the campaign states within a range, and the tare of every trial's torque.
        """
        return self.disturbances_at(self.space.full(np.atleast_2d(cube))[0])

    def disturbances_at(self, row: FloatArray) -> FloatArray:
        """Return the same at a row (n_par,) of the whole table [SI]."""
        changes = self._changes(row)
        out = [np.zeros((0, self.blocks[-1].stop)), self._tares()]
        if len(changes):
            values, _ = self.compared(np.concatenate([row + changes, row - changes]))
            out.append((values[: len(changes)] - values[len(changes) :]) / 2)
        return np.concatenate(out)

    @property
    def common(self) -> int:
        """How many of the disturbances, the last ones, are of no single trial: curves and stated ranges."""
        return len(self._changes(self.space.full(np.full((1, len(self.space.free)), 0.5))[0]))

    def _changes(self, row: FloatArray) -> FloatArray:
        index = {name: i for i, name in enumerate(self.space.table)}
        changes = []
        for fit in self.curves:
            columns = [index[name] for name in fit.parameters if name in index]
            free = [name for name in fit.parameters if name in self.space.names]
            if fit.quantity == "thrust" or len(columns) != 2 or free:
                continue
            first, second = fit.standard_errors
            rho = fit.correlation
            for root in ((first, rho * second), (0.0, np.sqrt(1 - rho**2) * second)):
                if np.isfinite(root).all():
                    change = np.zeros(len(row))
                    change[columns] = root
                    changes.append(change)
        for names, width in self._stated():
            change = np.zeros(len(row))
            change[[index[name] for name in names]] = width / np.sqrt(_UNIFORM)
            changes.append(change)
        return np.array(changes).reshape(len(changes), len(row))

    def _stated(self) -> list[tuple[tuple[str, ...], float]]:
        """Return names that move together and the width of their range [SI], of what is not free."""
        out: list[tuple[tuple[str, ...], float]] = []
        held = {name: pair for name, pair in self.ranges.items() if name not in self.space.names}
        constants = [held.pop(name) for name in CONSTANTS if name in held]
        if constants and not {*CONSTANTS} & {*self.space.names}:
            out.append((CONSTANTS, max(high - low for low, high in constants)))
        out += [((name,), high - low) for name, (low, high) in held.items() if name in self.space.table]
        return [(names, width) for names, width in out if width > 0]

    def _tares(self) -> FloatArray:
        """Return how one standard error of each trial's tare of torque moves the residuals (K, m)."""
        changes = []
        for t, trial in enumerate(self.objective.trials):
            tare = trial.log.tares.get("torque")
            for block in self.blocks:
                if tare is None or block.trial != t or block.channel != 0 or not np.isfinite(tare.error):
                    continue
                change = np.zeros(self.blocks[-1].stop)
                valid = self.objective.cost.targets[t].valid[:, 0]
                change[block.start : block.stop] = valid * tare.error / block.spread
                changes.append(change)
        return np.array(changes).reshape(len(changes), self.blocks[-1].stop)


def bench_floors(problem: MotorProblem, row: FloatArray) -> FloatArray:
    """Return what noise and the errors of what a fit takes as known cost, NRMSE of every block (B,) [1].

    The sensor's noise as compared, and beside it one standard deviation of each static curve, tare and stated
    range at the row (n_par,) [SI]: no dynamic parameter can take those away.
    """
    moved = problem.disturbances_at(row)
    known = np.array([np.sum(moved[:, b.start : b.stop] ** 2) / b.count for b in problem.blocks])
    noise = np.array([block.noise for block in problem.blocks])
    return np.asarray(np.sqrt(noise**2 + known))


def noise_correlation(problem: MotorProblem) -> NoiseModel:
    """Return the correlations of sensor noise as compared: what the filter of fast logs leaves, else none."""
    channels = tuple(sorted({block.channel for block in problem.blocks}))
    targets = problem.objective.cost.targets
    shortest = min(len(target.time) for target in targets)
    lags = max(1, min(20, shortest // 3))
    # The widest: logs of two kinds in one campaign are rare, and white ones do not mind much.
    own = max((filtered_correlation(t, lags) for t in targets), key=lambda row: float(row.sum()))
    return NoiseModel(channels, np.eye(len(channels))[:, :, None] * own)


def without_noise(problem: MotorProblem) -> tuple[str, ...]:
    """Return the channels of trials that show no noise, so that a level was assumed; as a person says it."""
    return tuple(
        f"{problem.trials[block.trial]} ({CHANNELS[block.channel]})"
        for block in problem.blocks
        if not np.isfinite(sensor_noise(problem.objective.cost.targets[block.trial], block.channel))
    )
