"""Drops as trust sees them: residuals, the noise of the capture, and what a drop's start may be off by."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from sysid.filters import differentiate
from sysid.fit.nrmse import PopulationCost
from sysid.gear.drop_offsets import offsets, shifted_starts
from sysid.gear.drops import PreparedDrop
from sysid.gear.lost_drops import judged_drops
from sysid.gear.problem import GearObjective
from sysid.parameters import SearchSpace
from sysid.trust.problem import Block
from sysid.types import BoolArray, FloatArray

# Simulations of trust are this exact: at the fit's 3e-4 the integration's own error moves a sum of squares by
# as much as one standard deviation of a parameter does.
TRUST_TOLERANCE = 2e-5
# Position column of each compared channel, and whether it is its rate, as `sysid.gear.drops` orders
# them.
CHANNELS = ("x_B", "z_B", "x_B_rate", "z_B_rate", "q_B")
_COLUMN, _IS_RATE = (0, 1, 0, 1, 2), (False, False, True, True, False)
# Samples of the noise that walks through the filter to tell what it looks like then.
_NOISE_SAMPLES = 20_000
# The fit of the flight looks back so far into a hold at most [s].
_HOLD = 2.0


@dataclass(frozen=True, eq=False)
class GearProblem:
    """The drops of an objective as residuals; see `sysid.trust.problem.Problem`.

    Parameters
    ----------
    objective : GearObjective
        Of the trials; its tolerance should be `TRUST_TOLERANCE` or less.
    """

    objective: GearObjective
    blocks: tuple[Block, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "blocks", self._blocks())

    @property
    def space(self) -> SearchSpace:
        """The free parameters."""
        return self.objective.space

    @property
    def trials(self) -> tuple[str, ...]:
        """Names of the drops."""
        return tuple(drop.name for drop in self.objective.drops)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the compared channels."""
        return tuple(channel.name for channel in self.objective.cost.channels)

    @cached_property
    def _valid(self) -> tuple[BoolArray, ...]:
        out = []
        for drop in self.objective.drops:
            valid = np.isfinite(drop.target.measured)
            if drop.target.valid is not None:
                given = np.asarray(drop.target.valid, dtype=np.bool_)
                valid = valid & (given[:, None] if given.ndim == 1 else given)
            out.append(valid)
        return tuple(out)

    def _blocks(self) -> tuple[Block, ...]:
        cost = self.objective.cost
        weights = cost.weights / cost.weights.sum() / len(self.objective.drops)
        out, start = [], 0
        for t, drop in enumerate(self.objective.drops):
            noise = compared_noise(drop)
            for c in range(len(cost.channels)):
                if weights[c] == 0:
                    continue
                stop = start + len(drop.time)
                count = int(np.count_nonzero(self._valid[t][:, c]))
                spread = float(cost.denominators[t, c])
                out.append(Block(t, c, start, stop, count, float(weights[c]), spread, noise[c] / spread))
                start = stop
        return tuple(out)

    def residuals(self, cube: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return residuals (P, m) in units of each channel's spread [1], and which points failed (P,)."""
        return self.compared(self.space.full(cube))

    def compared(
        self, rows: FloatArray, body_states: FloatArray | None = None
    ) -> tuple[FloatArray, BoolArray]:
        """Return residuals and failures of rows (P, n_par) [SI], with starts of their own (P, D, 6)."""
        objective = self.objective
        samples, result = objective.simulate(rows, body_states)
        samples = np.nan_to_num(samples, nan=0.0, posinf=0.0, neginf=0.0)
        # Only why a drop is lost is asked here, not what it scores.
        unscored = PopulationCost(
            np.zeros(len(rows)), np.zeros((*result.reached.shape, len(self.channels))), result.reached < 1.0
        )
        judged, _ = judged_drops(
            objective.cost, objective.drops, objective.board_length, result, samples, unscored
        )
        out = np.zeros((len(rows), self.blocks[-1].stop))
        for block in self.blocks:
            first, last = objective.cost.offsets[block.trial], objective.cost.offsets[block.trial + 1]
            column, operator = self._operators[block.trial][block.channel]
            signal = samples[:, first:last, column] @ operator.T
            measured = objective.drops[block.trial].target.measured[:, block.channel]
            valid = self._valid[block.trial][:, block.channel]
            out[:, block.start : block.stop] = np.where(valid, signal - measured, 0.0) / block.spread
        return np.nan_to_num(out), np.any(judged.failed, axis=1)

    @cached_property
    def _operators(self) -> tuple[tuple[tuple[int, FloatArray], ...], ...]:
        """Per drop and channel: the column it comes from, and filter and difference as a matrix (n,
        n_samples).

        The way from samples to what is compared is linear: as matrices a whole population takes it at once.
        """
        cost = self.objective.cost
        out = []
        for t in range(len(self.objective.drops)):
            first, last = int(cost.offsets[t]), int(cost.offsets[t + 1])
            pulses = np.zeros((last - first, cost.n_total, 6))
            pulses[np.arange(last - first), np.arange(first, last)] = 1.0
            response = cost.prepared(pulses)[t]
            out.append(
                tuple(
                    (channel.column, np.ascontiguousarray(response[:, :, c].T))
                    for c, channel in enumerate(cost.channels)
                )
            )
        return tuple(out)

    def disturbances(self, cube: FloatArray) -> FloatArray:
        """Return how one standard deviation of every drop's start moves the residuals (K, m)."""
        rows = self.space.full(np.atleast_2d(cube))
        drops = self.objective.drops
        own = offsets(self.space.table, rows, drops)
        nominal = np.array([[drop.initial_state for drop in drops]])
        if own is not None:
            nominal = shifted_starts(drops, *own)
        roots = [start_roots(drop) for drop in drops]
        kinds = len(roots[0])
        states = np.repeat(nominal, 2 * kinds, axis=0)
        for d, root in enumerate(roots):
            states[:kinds, d] += root
            states[kinds:, d] -= root
        values, _ = self.compared(np.repeat(rows, 2 * kinds, axis=0), states)
        change = (values[:kinds] - values[kinds:]) / 2
        for block in self.blocks:
            if self.channels[block.channel] == "q_B":
                valid = self._valid[block.trial][:, block.channel]
                change[-1, block.start : block.stop] = valid * level_error(drops[block.trial]) / block.spread
        out = np.zeros((kinds * len(drops), values.shape[1]))
        for block in self.blocks:
            where = slice(block.start, block.stop)
            out[block.trial * kinds : (block.trial + 1) * kinds, where] = change[:, where]
        return out


def start_roots(drop: PreparedDrop) -> FloatArray:
    """Return a square root (6, 6) of the covariance of a drop's state at the start of its window [SI].

    Rows are independent changes of one standard deviation: height, instant of the release (or downward speed
    of a body that was thrown), place along x, pitch, and pitch rate; the last row is empty, kept for the
    error of the measured level (`level_error`). From the noise of the flight and the samples that its fit
    saw; a body that was held has no speed of its own, and one that was held level has exactly no pitch.
    """
    flight, motion = drop.flight, drop.motion
    before = motion.valid & (motion.time < drop.touchdown) & np.isfinite(motion.z)
    out = np.zeros((6, 6))
    noise_x, noise_z, noise_q = flight.noise
    elapsed_start = float(drop.time[0] - flight.start)
    if flight.held:
        seen = motion.time[before & (motion.time > flight.start - _HOLD)]
        still = max(1, int(np.count_nonzero(seen < flight.start)))
        fall = np.maximum(0.0, seen - flight.start)
        design = np.column_stack([np.ones_like(fall), flight.gravity * fall])
        covariance = noise_z**2 * np.linalg.inv(design.T @ design + 1e-9 * np.eye(2))
        root = np.linalg.cholesky(covariance).T
        falling = max(elapsed_start, 0.0)
        for k in range(2):
            height, late = root[k]
            out[k, 1] = height + late * flight.gravity * falling
            out[k, 4] = late * flight.gravity
        out[2, 0] = noise_x / np.sqrt(len(seen))
        if drop.initial_state[2] != 0.0:
            out[3, 2] = noise_q / np.sqrt(still)
        return out
    seen = motion.time[before & (motion.time >= flight.start - 1e-9)] - flight.start
    design = np.column_stack([np.ones_like(seen), seen])
    root = np.linalg.cholesky(np.linalg.inv(design.T @ design)).T
    out[0, [1, 4]] = noise_z * root[0]
    out[1, [1, 4]] = noise_z * root[1]
    out[2, [0, 3]] = noise_x * root[0]
    out[3, [2, 5]] = noise_q * root[0]
    out[4, [2, 5]] = noise_q * root[1]
    return out


def level_error(drop: PreparedDrop) -> float:
    """Return how far off the level may be that the pitch is measured from [rad]: as the mean of the hold."""
    motion, flight = drop.motion, drop.flight
    if not flight.held or drop.initial_state[2] != 0.0:
        return 0.0
    hold = motion.valid & (motion.time < flight.start) & (motion.time > flight.start - _HOLD)
    return float(flight.noise[2]) / float(np.sqrt(max(1, int(np.count_nonzero(hold)))))


def compared_noise(drop: PreparedDrop) -> FloatArray:
    """Return the standard deviation (5,) of the capture's noise in every compared channel [channel units]."""
    noise = noise_signals(drop, 0)
    return np.sqrt(np.mean(noise**2, axis=0))


def noise_signals(drop: PreparedDrop, seed: int) -> FloatArray:
    """Return (n, 5) samples of the capture's noise, filtered and differentiated as the log was."""
    source = np.random.default_rng(seed)
    white = source.standard_normal((_NOISE_SAMPLES, 3)) * drop.flight.noise
    taps = drop.target.taps
    if taps is not None:
        white = np.column_stack([np.convolve(white[:, c], taps, "valid") for c in range(3)])
    rates = differentiate(white, drop.target.rate)
    both = [rates[:, c] if rate else white[:, c] for c, rate in zip(_COLUMN, _IS_RATE, strict=True)]
    return np.column_stack(both)[1:-1]
