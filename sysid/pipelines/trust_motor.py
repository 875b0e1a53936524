"""Bench trials as trust sees them: residuals of the dynamic fit, and what the static curves leave open.

The dead band is fitted after the dynamic fit with all else held, so it takes no part here; R, L, k_d, the
delays and whatever else the dynamic fit frees do.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sysid.motor.static_curves import CurveFit
from sysid.parameters import SearchSpace
from sysid.pipelines.motor_cost import CHANNELS
from sysid.pipelines.motor_objective import MotorObjective
from sysid.trust.problem import Block

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# Simulated samples that are held at once [bytes].
_MEMORY = 64e6
# Correlation of a curve's two coefficients where its points lie evenly over the whole speed (or command):
# -(1/4)/sqrt(1/3 · 1/5) of c2 Ω² + c1 Ω, -(1/2)/sqrt(1/3) of a u + b.
_TIED = {"torque": -0.968, "no_load": -0.866}


def sensor_noise(values: FloatArray, valid: BoolArray) -> float:
    """Return the standard deviation of the noise in samples [their unit]; NaN where they show none.

    From the median third difference, in which a signal that is smooth most of the time leaves little.
    """
    known = values[valid]
    if len(known) < 20:
        return float("nan")
    sigma = float(np.median(np.abs(np.diff(known, 3)))) / 0.6745 / np.sqrt(20.0)
    return sigma if sigma > 0 else float("nan")


@dataclass(frozen=True, eq=False)
class MotorProblem:
    """The trials of an objective as residuals; see `sysid.trust.problem.Problem`.

    Parameters
    ----------
    objective : MotorObjective
    curves : tuple of CurveFit
        Static curves, whose standard errors the dynamic fit takes as zero.
    """

    objective: MotorObjective
    curves: tuple[CurveFit, ...] = ()
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
                out.append(Block(t, c, start, stop, count, float(weights[c]), spread, float("nan")))
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
        """Return how one standard deviation of every static curve moves the residuals (K, m)."""
        row = self.space.full(np.atleast_2d(cube))[0]
        index = {name: i for i, name in enumerate(self.space.table)}
        changes = []
        for fit in self.curves:
            columns = [index[name] for name in fit.parameters if name in index]
            free = [name for name in fit.parameters if name in self.space.names]
            if fit.quantity not in _TIED or len(columns) != 2 or free:
                continue
            first, second = fit.standard_errors
            rho = _TIED[fit.quantity]
            for root in ((first, rho * second), (0.0, np.sqrt(1 - rho**2) * second)):
                if np.isfinite(root).all():
                    change = np.zeros(len(row))
                    change[columns] = root
                    changes.append(change)
        if not changes:
            return np.zeros((0, self.blocks[-1].stop))
        moved = np.array(changes)
        values, _ = self.compared(np.concatenate([row + moved, row - moved]))
        return np.asarray((values[: len(moved)] - values[len(moved) :]) / 2)
