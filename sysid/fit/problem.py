"""A fit problem: what search and trust need to know of the prepared trials of a campaign under one model.

The search scores a `Problem`, trust takes its residuals, validation and report its predictions; none of them
asks which model it is. Further descriptions of its trials stand in `sysid.fit.story`, how it is made of a
campaign in `sysid.fit.kind`. A user's model is one too: `sysid.own`.
"""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sysid.campaign.swaps import Swap
from sysid.fit.derivatives import Layout
from sysid.fit.result import FitResult, TrialResult
from sysid.fit.trial import (
    UNNAMED_CAUSE,
    Block,
    Cost,
    Evaluation,
    NoiseModel,
    Prediction,
    Scores,
    Trial,
    first_cause,
    name_order,
)
from sysid.journal import notice
from sysid.parallel import Executor
from sysid.parameters import SearchSpace, loosened
from sysid.types import BoolArray, FloatArray, IntArray

# Simulated samples of a population that are in memory at once [bytes].
_MEMORY = 8e6


class Problem(ABC):
    """Prepared trials of one campaign under one model.

    Equal rows give equal numbers whatever their neighbours and the number of threads. A subclass is a frozen
    dataclass; cached properties, which it computes from its fields, stay behind when it travels to another
    process.
    """

    campaign: Any
    space: SearchSpace
    # Causes of a lost simulation, in the order in which a candidate is counted.
    causes: tuple[str, ...] = UNNAMED_CAUSE
    # Misfit that no user of the model would feel, over the largest value of its channel [1].
    small: float = 0.0
    # Advice for a user whose trials the model does not explain; empty: none.
    remedy: str = ""

    # --- what a model must say ------------------------------------------------------------------------------

    @property
    @abstractmethod
    def trials(self) -> tuple[Trial, ...]:
        """The trials, in the order of every array."""

    @property
    @abstractmethod
    def cost(self) -> Cost:
        """The NRMSE."""

    @abstractmethod
    def predict(self, rows: FloatArray) -> Prediction:
        """Simulate and score rows of the whole parameter table (P, n_table) [SI]; return the signals too."""

    @abstractmethod
    def only(self, names: Sequence[str]) -> Self:
        """Return the problem of some of the trials, in the order of their `names`."""

    # --- what a model may say -------------------------------------------------------------------------------

    @property
    def lost_advice(self) -> str:
        """Advice for a user whose trials cannot be simulated."""
        return "check the masses, lengths and units that the campaign states"

    def score(self, rows: FloatArray) -> Scores:
        """Return what `predict` scores; a model that can do so without keeping the signals is faster."""
        return self.predict(rows)

    @property
    def fitted(self) -> Self:
        """The problem as the search sees it: the trials of use "fit", in the order of `name_order`."""
        return self.only(sorted((t.name for t in self.trials if t.use == "fit"), key=name_order))

    @property
    def with_rows_of_all(self) -> Self:
        """The problem in which what is stated of a single trial is a row for every trial, fitted or not."""
        return self

    @property
    def exact(self) -> Self:
        """The problem with simulations that are exact enough for derivatives."""
        return self

    @property
    def noise(self) -> FloatArray:
        """(T, C) standard deviation of the measurement's noise as compared [channel units]; NaN: unknown."""
        return np.full((len(self.trials), len(self.channels)), np.nan)

    def correlation(self) -> NoiseModel:
        """Return the correlations of the measurement's noise as compared; by default it is white."""
        used = tuple(sorted({block.channel for block in self.blocks}))
        return NoiseModel(used, np.eye(len(used))[:, :, None])

    def disturbances_at(self, row: FloatArray) -> FloatArray:
        """Return how one standard deviation of each assumed value moves the residuals: (K, m).

        At a row (n_table,) of the table [SI]. The initial state of a drop is such a value: noise moves it as
        well. They are independent; the last `common` of them concern all trials.
        """
        return np.zeros((0, self.blocks[-1].stop))

    @property
    def common(self) -> int:
        """Number of disturbances, the last ones, that concern all trials."""
        return 0

    def floors(self, row: FloatArray) -> FloatArray:
        """Return the NRMSE of every block (B,) that a right model scores at a row (n_table,) [SI]."""
        return np.array([block.noise for block in self.blocks])

    def known(self, fit: FitResult) -> Collection[str]:
        """Return the parameters for which this campaign's value replaces one that a fit took as known."""
        return self.campaign.parameters.fixed

    def shifts(self, fit: FitResult) -> Mapping[str, float]:
        """Return how far this campaign states values that count from what is stated, by name [SI]."""
        return {}

    @property
    def mistakes(self) -> Iterable[tuple[Swap, SearchSpace]]:
        """Mistakes that the campaign may contain, and the space of stated values without each."""
        return ()

    @property
    def instruments(self) -> Collection[str]:
        """Parameters of logs and instruments, not of the vehicle."""
        return ()

    @property
    def stated(self) -> Mapping[str, float]:
        """Values that the campaign states or measures, by name [SI]."""
        return {}

    def completed(self, rows: FloatArray, fit: FitResult) -> FloatArray:
        """Return adopted rows (S, n_table) [SI] with what follows from the other values."""
        return rows

    @property
    def row_logs(self) -> Mapping[str, str]:
        """SHA-256 of the log of every row of one log, by the row's name."""
        digest = {trial.name: trial.digest for trial in self.trials}
        return {row.name: digest.get(row.trial, "") for row in self.space.table.values() if row.trial}

    def phases(self, trial: int, row: FloatArray) -> list[tuple[float, str]]:
        """Return from when on [s] a predicted trial is in which phase, in words that follow "most …"."""
        return [(-np.inf, "throughout")]

    @cached_property
    def pieces(self) -> tuple[tuple[str, ...], IntArray]:
        """What a ladder leaves out in turn: names, and which one each residual (m,) belongs to; trials."""
        rows = np.repeat([block.trial for block in self.blocks], [b.stop - b.start for b in self.blocks])
        return self.names, rows

    # --- what every model shares ----------------------------------------------------------------------------

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the trials."""
        return tuple(trial.name for trial in self.trials)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the compared channels."""
        return tuple(channel.name for channel in self.cost.channels)

    @property
    def units(self) -> tuple[str, ...]:
        """SI units of the channels."""
        return tuple(channel.unit for channel in self.cost.channels)

    def evaluate(self, cube: FloatArray) -> Evaluation:
        """Simulate and score points (P, n_free) [unit cube]."""
        rows = self.space.full(cube)
        scores = self.score(rows)
        failed = first_cause(scores.cause, len(self.causes))
        return Evaluation(self._cost(rows, scores), failed, scores.cause.size)

    @cached_property
    def independent(self) -> float:
        """Number of independent samples that the compared ones are worth [1]."""
        model = self.correlation()
        worth = dict(zip(model.channels, model.inflation, strict=True))
        return sum(block.count / worth.get(block.channel, 1.0) for block in self.blocks)

    def _cost(self, rows: FloatArray, scores: Scores) -> FloatArray:
        """Return the mean NRMSE (P,) of rows [1], times what stated values cost that are left.

        With N independent samples the logarithm of the NRMSE is the log-likelihood over -N, and a stated
        value that is left with a residual p takes p²/2 off the log-likelihood.
        """
        return np.asarray(self.cost.mean(scores.by_channel) * self.of_stated(rows))

    def of_stated(self, rows: FloatArray) -> FloatArray:
        """Return by how much stated values that are left raise the cost of rows (P,) over their NRMSE [1]."""
        if not self.space.stated:
            return np.ones(len(rows))
        return np.asarray(np.exp(np.sum(self.space.misses(rows) ** 2, axis=1) / (2 * self.independent)))

    def examine(self, cube: FloatArray) -> tuple[Evaluation, FloatArray]:
        """Return what `evaluate` returns, and the residuals (P, m) [1]; NaN where a simulation failed."""
        rows = self.space.full(cube)
        residuals, scores = self._compared(rows)
        failed = first_cause(scores.cause, len(self.causes))
        residuals[failed > 0] = np.nan
        return Evaluation(self._cost(rows, scores), failed, scores.cause.size), residuals

    def residuals(self, cube: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return residuals (P, m) in units of each channel's spread [1], and which points failed (P,).

        The last residuals are those of the stated values, see `SearchSpace.misses`. The residuals of a failed
        point are finite and mean nothing.
        """
        return self.compared(self.space.full(cube))

    def compared(self, rows: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return residuals and failures of rows of the whole table (P, n_table) [SI]."""
        residuals, scores = self._compared(rows)
        return np.nan_to_num(residuals, copy=False), np.any(scores.cause > 0, axis=1)

    def _compared(self, rows: FloatArray) -> tuple[FloatArray, Scores]:
        """Return the residuals (P, m) and scores of rows, as many at once as their samples fit in memory."""
        out = np.zeros((len(rows), self.size))
        out[:, self.blocks[-1].stop :] = self.space.misses(rows)
        by_channel = np.zeros((len(rows), len(self.trials), len(self.channels)))
        cause = np.zeros((len(rows), len(self.trials)), dtype=np.int8)
        for part in self.parts(len(rows)):
            prediction = self.predict(rows[part])
            by_channel[part], cause[part] = prediction.by_channel, prediction.cause
            for block in self.blocks:
                trial = self.trials[block.trial]
                signal = prediction.signals[block.trial][:, :, block.channel]
                error = signal - trial.measured[:, block.channel]
                valid = trial.valid[:, block.channel]
                out[part, block.start : block.stop] = np.where(valid, error, 0.0) / block.spread
        return out, Scores(by_channel, cause)

    def parts(self, count: int) -> list[slice]:
        """Return the parts in which candidates are simulated, so that their samples fit into memory."""
        share = max(1, int(_MEMORY / (16 * self.blocks[-1].stop)))
        return [slice(first, min(first + share, count)) for first in range(0, count, share)]

    def results(self, rows: FloatArray) -> tuple[TrialResult, ...]:
        """Return every trial, measured and simulated with ranked sets (S, n_table) [SI]; name the lost."""
        prediction = self.predict(rows)
        for s, causes in enumerate(prediction.cause, start=1):
            for code in np.unique(causes[causes > 0]):
                where = ", ".join(self.trials[t].name for t in np.flatnonzero(causes == code))
                cause = self.causes[code - 1].replace("_", " ")
                notice("simulation-lost", f"set {s}: {cause} on {where}; its NRMSE there is a penalty")
        return tuple(
            TrialResult(
                trial.name, trial.use, trial.time, trial.measured, trial.valid, prediction.signals[t],
                prediction.by_channel[:, t], **trial.shown,
            )
            for t, trial in enumerate(self.trials)
        )  # fmt: skip

    @property
    def size(self) -> int:
        """Number of residuals m: those of the blocks, then one for every stated value."""
        return self.blocks[-1].stop + len(self.space.stated)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Where the residuals of each trial's channels lie; channels without weight are left out."""
        weights = self.cost.weights / self.cost.weights.sum() / len(self.trials)
        out: list[Block] = []
        start = 0
        for t, (trial, noise) in enumerate(zip(self.trials, self.noise, strict=True)):
            for c in np.flatnonzero(weights):
                stop = start + len(trial.time)
                spread = float(self.cost.denominators[t, c])
                level = float(noise[c] / spread)
                count = int(np.count_nonzero(trial.valid[:, c]))
                out.append(Block(t, int(c), start, stop, count, float(weights[c]), spread, level))
                start = stop
        return tuple(out)

    @cached_property
    def layout(self) -> Layout:
        """What the free parameters and the residuals concern; a parameter of a trial left out, no trial."""
        free, places = self.space.free, {trial.name: t for t, trial in enumerate(self.trials)}
        trials = np.array([places.get(row.trial, -1) for row in free], dtype=np.int64)
        names = [row.common_name for row in free]
        kinds = np.array([names.index(name) for name in names], dtype=np.int64)
        stated = len(self.space.stated)
        samples = [np.full(block.stop - block.start, block.trial) for block in self.blocks]
        residuals = np.concatenate([*samples, trials[len(free) - stated :]])
        return Layout(np.where(trials >= 0, kinds, -1), trials, residuals, stated)

    def disturbances(self, cube: FloatArray) -> FloatArray:
        """Return what one standard deviation of each assumed value does to the residuals (K, m).

        At a point of the unit cube (n_free,): the errors of stated values, then `disturbances_at`.
        """
        count, stop = len(self.space.stated), self.blocks[-1].stop
        rows = self.space.full(np.atleast_2d(cube))
        of_trials = self.disturbances_at(rows[0])
        out = np.zeros((count + len(of_trials), self.size))
        if count:
            out[:count, stop:] = np.diag(loosened(self.space.pulls(rows)[0])[1])
        out[count:, :stop] = of_trials
        return out

    def at_stated_scale(self, cube: FloatArray) -> FloatArray:
        """Return points (S, n) [unit cube] of the same residuals, at what a statement alone determines.

        Least squares hardly moves along such a direction where it is a narrow curve.
        """
        return cube

    @property
    def base(self) -> FloatArray:
        """(n_table,) what the campaign itself knows of every parameter, else the model's default [SI]."""
        # A value that is stated with an error counts as its trials were read: as it is where a search starts.
        stated = {row.name: row.nominal for row in self.space.free if row.name in self.space.stated}
        values = {**self.space.table.nominal, **self.stated, **self.space.fixed, **stated}
        return np.array([values[name] for name in self.space.table])

    def adopt(self, fit: FitResult, values: FloatArray | None = None) -> FloatArray:
        """Return the rows (S, n_table) with which the sets of a fit predict these trials [SI].

        `values` (S, n) of the fit's parameters may replace its sets.

        The one rule of every prediction (`validate`, `compare`, `report --against`):

        * A parameter that the fit has found keeps the fit's value. So does a value that was stated with an
          error, unless this campaign states another number than the fit's. Where both state a place of the
          same logs, the fit's counts, from where this campaign states it.
        * A value that the campaign states or measures (vehicle, surface, rotor, static curves) replaces one
          that the fit only took as known. Where the campaign states none, the fit's value counts.
        * Delays and lags of instruments are the campaign's where it states them. Else a log that the fit has
          seen keeps the value found for that log, and any other takes the fit's mean. Tares are read from
          each log.
        * Friction stays with its law: the campaign is opened under the fit's law (`Kind.under`), where
          friction stated for another law does not count.
        * A motor's R stays with its k: torque and speed determine k²/R, so a found R keeps the k under which
          it was found.

        Predictions are simulated as exactly as by `exact`, whatever the accuracy of the fit.
        """
        known = set(self.known(fit))
        instruments, row_logs = set(self.instruments), self.row_logs
        fitted = {trial.name for trial in fit.trials if trial.use == "fit"}
        logs = fit.provenance.get("logs", {})
        seen = {str(log.get("sha256")) for name, log in logs.items() if name in fitted}
        column, shifts = self.space.table.index, self.shifts(fit)
        values = fit.values if values is None else values
        rows = np.repeat(self.base[None], len(values), axis=0)
        for i, record in enumerate(fit.parameters):
            name, instrument = record.name, record.name in instruments
            if name not in column or not np.isfinite(values[:, i]).all():
                continue
            if name in row_logs and row_logs[name] not in seen:
                continue
            searched = record.status == "free" or (
                record.status == "stated"
                and self.space.stated.get(name, self.base[column[name]]) == record.nominal
            )
            kept = name in known and (not searched or instrument)
            # The mean delay of a fit is derived from the delays of its logs.
            if not kept and (instrument or searched or record.status in ("fixed", "measured")):
                rows[:, column[name]] = values[:, i] - shifts.get(name, 0.0)
        return self.completed(rows, fit)


@dataclass(frozen=True, eq=False)
class _Scored:
    """A problem as work for an executor: cost, failure, simulations, and residuals if asked for."""

    problem: Problem
    residuals: bool

    def __call__(self, rows: FloatArray) -> tuple[NDArray[Any], ...]:
        further: list[FloatArray] = []
        if self.residuals:
            scored, *further = self.problem.examine(rows)
        else:
            scored = self.problem.evaluate(rows)
        each, rest = divmod(scored.simulations, len(rows))
        simulations = np.full(len(rows), each, dtype=np.int64)
        simulations[:rest] += 1
        return scored.cost, scored.failed, simulations, *further


def computed_by(problem: Problem, executor: Executor) -> Problem:
    """Return a problem whose candidates and residuals an executor computes; it travels at the first use."""
    scored, examined = (executor.share(_Scored(problem, residuals)) for residuals in (False, True))

    def evaluate(cube: FloatArray) -> Evaluation:
        cost, failed, simulations = scored(cube)
        return Evaluation(cost, failed, int(simulations.sum()))

    def examine(cube: FloatArray) -> tuple[Evaluation, FloatArray]:
        cost, failed, simulations, residuals = examined(cube)
        return Evaluation(cost, failed, int(simulations.sum())), residuals

    spread = copy(problem)
    ways = {"evaluate": evaluate, "examine": examine, "residuals": executor.share(problem.residuals)}
    for name, way in ways.items():
        object.__setattr__(spread, name, way)
    return spread
