"""The skeleton of every model: what a verb needs to know of a fit problem, and of a kind of model.

A `Problem` is the prepared trials of one campaign under one model. The search scores it, trust takes its
residuals, validation and report its predictions; none of them asks which model it is. A `Kind` makes a
problem of a campaign and an outcome of a fit. A third model is one more folder with a `Problem` and a `Kind`,
see `sysid.workflows.kinds.register`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from functools import cache, cached_property
from typing import Any, Self

import numpy as np

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
)
from sysid.journal import Journal, notice, tell
from sysid.parameters import SearchSpace
from sysid.types import BoolArray, FloatArray, IntArray

# NRMSE of noise where a channel shows none: as coarse as its last digit, so not known any better.
ASSUMED_NOISE = 0.02
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
    # What trust counts as uncertain besides the noise.
    known_words: str = ""

    # --- what a model must say ------------------------------------------------------------------------------

    @property
    @abstractmethod
    def trials(self) -> tuple[Trial, ...]:
        """The trials, in the order of every array."""

    @property
    @abstractmethod
    def channels(self) -> tuple[str, ...]:
        """Names of the compared channels."""

    @property
    @abstractmethod
    def units(self) -> tuple[str, ...]:
        """SI units of the channels."""

    @property
    @abstractmethod
    def cost(self) -> Cost:
        """The NRMSE."""

    @abstractmethod
    def score(self, rows: FloatArray) -> Scores:
        """Simulate and score rows of the whole parameter table (P, n_table) [SI]."""

    @abstractmethod
    def signals(self, rows: FloatArray) -> tuple[tuple[FloatArray, ...], BoolArray]:
        """Return the signals as compared, (P, n, C) per trial [channel units], and which are lost (P, T)."""

    @abstractmethod
    def only(self, names: Collection[str]) -> Self:
        """Return the problem of some of the trials."""

    # --- what a model may say -------------------------------------------------------------------------------

    @property
    def fitted(self) -> Self:
        """The problem as the search sees it: the trials of use "fit"."""
        return self.only([trial.name for trial in self.trials if trial.use == "fit"])

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

    def floor_by_channel(self, row: FloatArray) -> FloatArray:
        """Return the same (T, C) [channel units]; NaN where it is not known."""
        return self.noise

    def known(self, fit: FitResult) -> Collection[str]:
        """Return the parameters for which this campaign's value replaces one that a fit took as known."""
        return self.campaign.parameters.fixed

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

    @property
    def hashes(self) -> Mapping[str, str]:
        """SHA-256 of every log that the fit depends on, by name."""
        return {trial.name: trial.digest for trial in self.trials}

    @property
    def logs(self) -> Mapping[str, Any]:
        """What a result states of every log, by name."""
        return {trial.name: trial.provenance for trial in self.trials}

    @property
    def accuracy(self) -> Mapping[str, Any]:
        """Further choices that must be equal for a fit to be continued; see `sysid.resume.Unfinished`."""
        return {}

    @property
    def filters(self) -> Mapping[str, Any]:
        """The filter's design."""
        return {"kind": "none"}

    def contacts(self, trial: int, row: FloatArray) -> FloatArray | None:
        """Return contacts (k,) [s] of a trial predicted by a row (n_table,) [SI]; None of a model without."""
        return None

    def phases(self, trial: int, row: FloatArray) -> list[tuple[float, str]]:
        """Return from when on [s] a predicted trial is in which phase, in words that follow "most …"."""
        return [(-np.inf, "throughout")]

    def evidence(self, row: FloatArray) -> Mapping[str, tuple[FloatArray, FloatArray]]:
        """Return points behind what the fit takes as known, x and y (n,) [SI] by name, for its report.

        At a row (n_table,) of the table [SI]; by default there are none.
        """
        return {}

    def beyond(self, rows: FloatArray) -> list[dict[str, Any]]:
        """Return what a validation adds to the scores of each trial, predicted by rows (S, n_table) [SI]."""
        return [{} for _ in self.trials]

    def quality(self) -> list[dict[str, Any]]:
        """Return what `sysid check` states of every log; by default of the compared instants."""
        out = []
        for trial in self.trials:
            steps = np.diff(trial.time)
            step = float(np.median(steps))
            out.append({
                "name": trial.name, "use": trial.use, "log": str(trial.provenance.get("log", "")),
                "rate": 1.0 / step, "jitter": float(np.median(np.abs(steps - step)) / step),
                "holes": int(np.count_nonzero(steps > 1.5 * step)), "saturated": 0.0, "suspicions": [],
            })  # fmt: skip
        return out

    def excitation(self) -> dict[str, Any]:
        """Return what the trials excite: a range [low, high] or a number by name."""
        return {}

    def about(self) -> dict[str, Any]:
        """Return further keys of the document of `sysid check`."""
        return {}

    def seen(self, journal: Journal) -> dict[str, Any]:
        """Return the quality of the logs and `about`; notice what they contradict in the campaign, first."""
        quality = self.quality()
        journal.fold(len(self.trials))
        return {"quality": quality, **self.about()}

    def advice(self, weak: Collection[str]) -> list[str]:
        """Return what to record for parameters that the trials do not determine well."""
        return []

    def given(self) -> Mapping[str, str]:
        """Return what the intervals take as exact, by the parameter whose range would count."""
        return {}

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

    def evaluate(self, cube: FloatArray) -> Evaluation:
        """Simulate and score points (P, n_free) [unit cube]."""
        scores = self.score(self.space.full(cube))
        failed = first_cause(scores.cause, len(self.causes))
        return Evaluation(self.cost.mean(scores.by_channel), failed, scores.cause.size)

    def examine(self, cube: FloatArray) -> tuple[Evaluation, FloatArray]:
        """Return what `evaluate` returns, and the residuals (P, m) [1]; NaN where a simulation failed.

        Unlike `residuals`, equal points give equal bits whatever their neighbours.
        """
        rows = self.space.full(cube)
        residuals = np.zeros((len(rows), self.blocks[-1].stop))
        parts = []
        for part in self._parts(len(rows)):
            parts.append(self.predict(rows[part]))
            self._subtract(parts[-1].signals, residuals[part])
        cause = np.concatenate([part.cause for part in parts])
        failed = first_cause(cause, len(self.causes))
        residuals[failed > 0] = np.nan
        cost = self.cost.mean(np.concatenate([part.by_channel for part in parts]))
        return Evaluation(cost, failed, cause.size), residuals

    def predict(self, rows: FloatArray) -> Prediction:
        """Return scores and signals of rows of the whole table (P, n_table) [SI]."""
        scores = self.score(rows)
        return Prediction(scores.by_channel, scores.cause, self.signals(rows)[0])

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
                level = level if np.isfinite(level) else ASSUMED_NOISE
                count = int(np.count_nonzero(trial.valid[:, c]))
                out.append(Block(t, int(c), start, stop, count, float(weights[c]), spread, level))
                start = stop
        return tuple(out)

    def residuals(self, cube: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return residuals (P, m) in units of each channel's spread [1], and which points failed (P,).

        The residuals of a failed point are finite and mean nothing.
        """
        return self.compared(self.space.full(cube))

    @property
    def samples(self) -> int:
        """Simulated samples of one candidate, which bound how many are compared at once."""
        return self.blocks[-1].stop

    def compared(self, rows: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return residuals and failures of rows of the whole table (P, n_table) [SI]."""
        out = np.zeros((len(rows), self.blocks[-1].stop))
        failed = np.zeros(len(rows), dtype=np.bool_)
        for part in self._parts(len(rows)):
            signals, lost = self.signals(rows[part])
            failed[part] = lost.any(axis=1)
            self._subtract(signals, out[part])
        return np.nan_to_num(out), failed

    def _parts(self, count: int) -> list[slice]:
        """Return the parts in which candidates are compared, so that their samples fit into memory."""
        share = max(1, int(_MEMORY / (16 * self.samples)))
        return [slice(first, min(first + share, count)) for first in range(0, count, share)]

    def _subtract(self, signals: Sequence[FloatArray], out: FloatArray) -> None:
        """Fill residuals (P, m) from signals as compared, (P, n, C) per trial."""
        for block in self.blocks:
            trial = self.trials[block.trial]
            error = signals[block.trial][:, :, block.channel] - trial.measured[:, block.channel]
            valid = trial.valid[:, block.channel]
            out[:, block.start : block.stop] = np.where(valid, error, 0.0) / block.spread

    def disturbances(self, cube: FloatArray) -> FloatArray:
        """Return `disturbances_at` of a point of the unit cube (n_free,)."""
        return self.disturbances_at(self.space.full(np.atleast_2d(cube))[0])

    @property
    def base(self) -> FloatArray:
        """(n_table,) what the campaign itself knows of every parameter, else the model's default [SI]."""
        values = {**self.space.table.nominal, **self.stated, **self.space.fixed}
        return np.array([values[name] for name in self.space.table])

    def adopt(self, fit: FitResult, values: FloatArray | None = None) -> FloatArray:
        """Return the rows (S, n_table) with which the sets of a fit predict these trials [SI].

        `values` (S, n) of the fit's parameters may replace its sets.

        The one rule of every prediction (`validate`, `cross-validate`, `compare`, `report --against`):

        * A parameter that the fit has found keeps the fit's value.
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
        column = self.space.table.index
        values = fit.values if values is None else values
        rows = np.repeat(self.base[None], len(values), axis=0)
        for i, record in enumerate(fit.parameters):
            name, instrument = record.name, record.name in instruments
            if name not in column or not np.isfinite(values[:, i]).all():
                continue
            if name in row_logs and row_logs[name] not in seen:
                continue
            kept = name in known and (record.status != "free" or instrument)
            # The mean delay of a fit is derived from the delays of its logs.
            if not kept and (instrument or record.status in ("free", "fixed", "measured")):
                rows[:, column[name]] = values[:, i]
        return self.completed(rows, fit)


@cache
def tell_of_kernel(name: str) -> None:
    """Say once per process, before the first simulation, why nothing else is printed for a while."""
    tell(f"preparing {name}: compiled once per version (under a minute), then loaded")
