"""Many candidates on many trials at once: what a search asks of the motor."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sysid.errors import FitError
from sysid.motor import kernel
from sysid.motor.model import PARAMETERS, TOLERANCE, kernel_rows, schedule, supply
from sysid.parallel import in_threads
from sysid.types import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class SimulatedTrial:
    """One log as the simulator needs it.

    The command is u in [-1, 1] from each instant [s] on (m,). Torque and speed are wanted at `time` (n,) [s],
    strictly increasing; at the first of them the state is `initial`, a current [A] and a speed [rad/s]. The
    supply is knots [s] and V/V_ref there, (k,) each; left out: 1. `mapped` (m, 2) are loaded speed [rad/s]
    and drag [N·m] of the steady level of each command at V_ref; NaN or left out: Ω_0 is the line of the set.
    """

    command_time: FloatArray
    command: FloatArray
    time: FloatArray
    initial: tuple[float, float] | Literal["steady"] = "steady"
    supply: tuple[FloatArray, FloatArray] | None = None
    mapped: FloatArray | None = None


class SimulatedTrials:
    """Trials laid end to end for `simulate_population`; trial j owns ``slice(first[j], first[j + 1])``.

    `excitation` is what the kernels take in this order: command instants, commands, first of each trial,
    supply knots, V/V_ref, first of each trial.
    """

    def __init__(self, trials: Sequence[SimulatedTrial]) -> None:
        if not trials:
            raise FitError("no motor trial to simulate; expected at least one log in the campaign")
        self.trials = tuple(trials)
        instants, levels = zip(
            *(schedule(trial.command_time, trial.command) for trial in trials), strict=True
        )
        knots, ratios = zip(*(supply(trial.supply, 1.0) for trial in trials), strict=True)
        (commands, first_command), (supplies, first_supply) = map(_end_to_end, (instants, knots))
        (joined_levels, _), (joined_ratios, _) = map(_end_to_end, (levels, ratios))
        self.excitation = (commands, joined_levels, first_command, supplies, joined_ratios, first_supply)
        self.mapped = np.concatenate([
            np.full((len(each), 2), np.nan) if trial.mapped is None else trial.mapped
            for trial, each in zip(trials, levels, strict=True)
        ])  # fmt: skip
        self.time, self.first = _end_to_end([trial.time for trial in trials])
        self.edges, _ = _end_to_end([_edges(trial.time) for trial in trials])
        steady = [isinstance(trial.initial, str) for trial in trials]
        self.starts = np.where(steady, kernel.STEADY, kernel.AS_GIVEN).astype(np.int64)
        self.initial = np.array([(0.0, 0.0) if isinstance(t.initial, str) else t.initial for t in trials])

    def __len__(self) -> int:
        return len(self.trials)

    def delays(self, count: int, delays: FloatArray | None) -> FloatArray:
        """Return what `count` candidates add to their command delay per trial (count, n_trials) [s]."""
        shape = (count, len(self))
        # A copy: numba compiles again for arrays that are locked, as broadcast ones are.
        return np.zeros(shape) if delays is None else np.array(np.broadcast_to(delays, shape), order="C")


def _end_to_end(parts: Sequence[ArrayLike]) -> tuple[FloatArray, IntArray]:
    arrays = [np.asarray(part, dtype=np.float64) for part in parts]
    return np.concatenate(arrays), np.cumsum([0, *(a.size for a in arrays)], dtype=np.int64)


def _edges(time: ArrayLike) -> FloatArray:
    """Return the edges (n + 1,) of the samples' cells, each half-way to its neighbours."""
    t = np.asarray(time, dtype=np.float64)
    if t.size < 2 or np.any(np.diff(t) <= 0):
        raise FitError(f"a motor trial has {t.size} samples; expected at least 2 in the order of time")
    return np.concatenate([t[:1], 0.5 * (t[1:] + t[:-1]), t[-1:]])


class PopulationResult(NamedTuple):
    """Outputs of `simulate_population`.

    `outputs` (P, n_total, 2): stator torque [N·m], averaged over each sample's cell, and speed [rad/s]; NaN
    past a failure. `status` (P, n_trials): a key of `sysid.motor.model.STATUS_TEXT`. `reached` (P, n_trials):
    share of the duration that was simulated.
    """

    outputs: FloatArray
    status: IntArray
    reached: FloatArray


def simulate_population(
    parameters: FloatArray,
    trials: SimulatedTrials,
    *,
    delays: FloatArray | None = None,
    drags: FloatArray | None = None,
    ideal_reversal: bool = False,
    tolerance: float = TOLERANCE,
    threads: int | None = None,
) -> PopulationResult:
    """Simulate every candidate on every trial; one that cannot be simulated has a status, not an exception.

    `parameters` (P, n_table) are rows of `sysid.motor.model.PARAMETERS` [SI]; `delays` (P, n_trials) are
    added to ``command_delay`` [s], `drags` (P,) are factors on the drags of the trials' steady levels [1];
    `ideal_reversal` and `tolerance` as in `sysid.motor.model.simulate`. The result does not depend on the
    number of `threads`.

    The torque is averaged over each sample's cell, from half-way after the sample before to half-way
    before the next: it jumps when the dead band ends and, as L → 0, at each command.
    """
    rows = np.atleast_2d(parameters)
    if rows.shape[1] != len(PARAMETERS):
        raise ValueError(f"parameter rows have {rows.shape[1]} columns, the table {len(PARAMETERS)}")
    outputs = np.empty((len(rows), trials.time.size, 2))
    status = np.empty((len(rows), len(trials)), dtype=np.int64)
    reached = np.empty(status.shape)
    in_threads(
        kernel.integrate_population, status.size, threads,
        kernel_rows(rows), trials.delays(len(rows), delays), np.ones(len(rows)) if drags is None else drags,
        trials.mapped, *trials.excitation, trials.time, trials.edges, trials.first,
        int(np.diff(trials.first).max()), trials.starts, trials.initial, tolerance, ideal_reversal, outputs,
        status, reached,
    )  # fmt: skip
    return PopulationResult(outputs, status, reached)
