"""What a population of motors costs on the trials of a bench."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numba
import numpy as np

from sysid.campaign import MotorCampaign
from sysid.fit.objective import Evaluation
from sysid.motor.batch import MotorTrials, simulate_population
from sysid.motor.cost import MotorCost
from sysid.motor.curves import NoLoadTie
from sysid.motor.known_values import Bench, search_space
from sysid.motor.log_delays import shifts
from sysid.motor.model import PARAMETERS, pack
from sysid.motor.targets import PreparedTrial
from sysid.parameters import SearchSpace
from sysid.types import BoolArray, FloatArray, Rotation

# Local error of the simulations of a search: 1e-5 keeps the worst candidate within 0.01 % NRMSE.
FIT_TOLERANCE = 1e-5
# Simulated samples that are held at once, per thread [bytes]: the allocator keeps blocks of this size, while
# for larger ones it asks the system for fresh pages every time, which cost more than the simulation.
_MEMORY = 4e6
_INDEX = {name: i for i, name in enumerate(PARAMETERS)}


@dataclass(frozen=True, eq=False)
class MotorObjective:
    """Mean NRMSE of a population over bench trials.

    Parameters
    ----------
    space : SearchSpace
    trials : tuple of PreparedTrial
    ties : dict of direction to NoLoadTie
        No-load lines that follow R and k_d.
    cost : MotorCost
    threads : int, optional
        Cores to use; the numbers do not depend on it.
    ideal_reversal : bool
        No saturation (I_sat = ∞), as in Fig. 11.
    """

    space: SearchSpace
    trials: tuple[PreparedTrial, ...]
    ties: Mapping[Rotation, NoLoadTie]
    cost: MotorCost
    jobs: MotorTrials
    threads: int | None = None
    ideal_reversal: bool = False

    @classmethod
    def build(
        cls,
        campaign: MotorCampaign,
        space: SearchSpace,
        bench: Bench,
        trials: tuple[PreparedTrial, ...],
        threads: int | None = None,
        *,
        dynamic: bool = False,
    ) -> MotorObjective:
        """Join prepared trials with the campaign's cost.

        `dynamic`: for the dynamic fit, which looks past the starts from rest: their dead band is not known
        yet, and a wrong one would be paid for by L and the delay.
        """
        weights = campaign.cost.weights
        targets = tuple(t.dynamic_target if dynamic else t.target for t in trials)
        cost = MotorCost(targets, (weights.torque, weights.speed), campaign.cost.denominator)
        jobs = MotorTrials([t.simulated for t in trials])
        return cls(space, trials, ties_of(campaign, space, bench), cost, jobs, threads)

    def complete(self, rows: FloatArray) -> FloatArray:
        """Return rows (P, n_table) with the no-load lines that belong to their R and k_d."""
        rows = np.array(rows, dtype=np.float64)
        drop = rows[:, _INDEX["winding_resistance"]] / (
            rows[:, _INDEX["torque_constant"]] * rows[:, _INDEX["back_emf_constant"]]
        )
        for direction, tie in self.ties.items():
            line = tie.line(drop, rows[:, _INDEX["viscous_damping"]])
            rows[:, _INDEX[f"no_load_slope_{direction}"]] = line[:, 0]
            rows[:, _INDEX[f"no_load_intercept_{direction}"]] = line[:, 1]
        return rows

    def evaluate(self, cube: FloatArray) -> Evaluation:
        """Simulate and score unit-cube points (P, n_free)."""
        by_channel, failed = self.score(self.space.full(cube))
        return Evaluation(self.cost.mean(by_channel), np.any(failed, axis=1), failed.size)

    def score(self, rows: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return NRMSE (P, T, 2) and failures (P, T) of rows (P, n_table) [SI]; 25 columns: one delay."""
        rows = self.complete(rows)
        threads = min(self.threads or numba.get_num_threads(), numba.get_num_threads())
        share = max(1, threads, int(threads * _MEMORY / (16 * self.jobs.time.size)))
        scored = [self._score(rows[first : first + share]) for first in range(0, len(rows), share)]
        return np.concatenate([s[0] for s in scored]), np.concatenate([s[1] for s in scored])

    def _score(self, rows: FloatArray) -> tuple[FloatArray, BoolArray]:
        samples, reached = self.simulate(rows)
        return self.cost(samples, reached, self.sensors(rows), self.threads)

    def simulate(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return samples (P, n_total, 2) on the trials' grids, and the share reached (P, T), of full rows."""
        found = simulate_population(
            rows[:, : len(PARAMETERS)],
            self.jobs,
            delays=shifts(self.space.table, rows, self.trials),
            tolerance=FIT_TOLERANCE,
            threads=self.threads,
            ideal_reversal=self.ideal_reversal,
        )
        # Success is a status, not a share that rounding could leave at 1 - 1e-16.
        return found.outputs, np.where(found.status == 0, 1.0, np.minimum(found.reached, 1.0 - 1e-9))

    @staticmethod
    def sensors(rows: FloatArray) -> FloatArray:
        """Return torque delay, torque lag and speed lag (P, 3) [s] of rows."""
        names = ("torque_sensor_delay", "torque_sensor_lag", "speed_sensor_lag")
        return np.ascontiguousarray(rows[:, [_INDEX[name] for name in names]])


def ties_of(campaign: MotorCampaign, space: SearchSpace, bench: Bench) -> dict[Rotation, NoLoadTie]:
    """Return the no-load lines that follow R and k_d: neither free nor fixed by the campaign."""
    chosen = {*space.names} | {*campaign.parameters.fixed}
    return {
        direction: tie
        for direction, tie in bench.curves.ties.items()
        if not {f"no_load_slope_{direction}", f"no_load_intercept_{direction}"} & chosen
    }


def score_values(
    campaign: MotorCampaign, bench: Bench, values: Mapping[str, float], threads: int | None = None
) -> FloatArray:
    """Return the NRMSE (T, 2) of one set of parameter values [SI] on every trial of a prepared bench.

    Names left out take what the campaign fixes. The way to ask what the truth of a synthetic campaign scores.
    """
    space = search_space(campaign, bench)
    every = MotorObjective.build(campaign, space, bench, bench.trials, threads)
    own = {d: tie for d, tie in every.ties.items() if f"no_load_slope_{d}" not in values}
    objective = MotorObjective(space, bench.trials, own, every.cost, every.jobs, threads)
    known = {name: value for name, value in space.fixed.items() if name in PARAMETERS}
    return objective.score(pack({**bench.values, **known, **values})[None])[0][0]
