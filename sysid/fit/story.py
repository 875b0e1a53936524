"""Descriptions of a problem's trials: in `sysid check`, in the record of a fit, its report and validation."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

import numpy as np

from sysid.fit.result import FitResult
from sysid.journal import tell
from sysid.parameters import common_name
from sysid.stated import error_of
from sysid.types import FloatArray

if TYPE_CHECKING:
    from sysid.fit.problem import Problem

P = TypeVar("P", bound="Problem")


# Seed of the errors that a prediction has of its own [1].
_SEED = 28


class Read(NamedTuple):
    """A number of use, read from a measurement, the prediction by the best set, and those by draws."""

    what: str
    unit: str
    # (2 + n,) NaN where a track does not show it.
    values: FloatArray


@dataclass(frozen=True)
class ReadTrial:
    """What is read from a trial and its predictions: numbers, and in words how each of them ends."""

    numbers: list[Read]
    ends: list[str] | None = None


class Story(Generic[P]):
    """Answers about the trials of a problem; a model replaces those for which it knows more than these."""

    # A quantity as a campaign states it with its error.
    stated_example: str = "1.24 kg ± 2 g"

    def __init__(self, problem: P) -> None:
        self.problem = problem

    @property
    def keys(self) -> Mapping[str, str]:
        """Key of the campaign by the parameter's name that it states, where they differ."""
        return {}

    # --- the record of a fit --------------------------------------------------------------------------------

    @property
    def logs(self) -> Mapping[str, Mapping[str, object]]:
        """What a result states of every log, by name."""
        return {trial.name: trial.provenance for trial in self.problem.trials}

    @property
    def hashes(self) -> Mapping[str, str]:
        """SHA-256 of every log that the fit depends on, by name."""
        return {trial.name: trial.digest for trial in self.problem.trials}

    @property
    def accuracy(self) -> Mapping[str, object]:
        """Further choices that must be equal for a fit to be continued; see `sysid.resume.BlockStore`."""
        return {}

    @property
    def filters(self) -> Mapping[str, object]:
        """The filter's design."""
        return {"kind": "none"}

    def tell_stated(self) -> None:
        """Tell which stated values are fitted within their errors, and which errors are merely assumed."""
        space, errors = self.problem.space, dict[str, str]()
        for name, value in space.stated.items():
            key = common_name(space.table[name])
            errors.setdefault(self.keys.get(name, self.keys.get(key, key)), value.assumed)
        if own := [key for key, assumed in errors.items() if not assumed]:
            tell(f"fitted within their errors as well: {', '.join(own)}", detail=True)
        if typical := [f"{key} {assumed}" for key, assumed in errors.items() if assumed]:
            advice = f"state your own, as in '{self.stated_example}'"
            # Also on a short output: it is the one assumption that a user has not made.
            tell(f"assumed errors, within which these are fitted: {', '.join(typical)}; {advice}")

    # --- sysid check ----------------------------------------------------------------------------------------

    def quality(self) -> list[dict[str, object]]:
        """Return what is stated of every log, and notice what it contradicts in the campaign.

        By default of the compared instants.
        """
        out = []
        for trial in self.problem.trials:
            steps = np.diff(trial.time)
            step = float(np.median(steps))
            out.append({
                "name": trial.name, "use": trial.use, "log": str(trial.provenance.get("log", "")),
                "rate": 1.0 / step, "jitter": float(np.median(np.abs(steps - step)) / step),
                "holes": int(np.count_nonzero(steps > 1.5 * step)), "saturated": 0.0, "suspicions": [],
            })  # fmt: skip
        return out

    def about(self) -> dict[str, object]:
        """Return further keys of the document of `sysid check`, and notice what contradicts the campaign."""
        return {}

    def excitation(self) -> dict[str, object]:
        """Return what the trials excite: a range [low, high] or a number by name."""
        return {}

    def advice(self, weak: Collection[str]) -> list[str]:
        """Return what to record for parameters that the trials do not determine well."""
        return []

    # --- trust, report and validation -----------------------------------------------------------------------

    def floor(self, row: FloatArray) -> FloatArray:
        """Return `Problem.floors` (T, C) [channel units] at a row (n_table,) [SI]; NaN where not known."""
        return self.problem.noise

    def contacts(self, trial: int, row: FloatArray) -> FloatArray | None:
        """Return contacts (k,) [s] of a trial predicted by a row (n_table,) [SI]; None of a model without."""
        return None

    def evidence(self, row: FloatArray) -> Mapping[str, tuple[FloatArray, FloatArray]]:
        """Return points behind what the fit takes as known at a row (n_table,): x and y (n,) [SI] by name."""
        return {}

    def drawn(self, fit: FitResult, values: FloatArray) -> FloatArray:
        """Return rows (n, n_table) [SI] of `Problem.with_rows_of_all` for values (n, parameters) of a fit.

        The first ones are the best set's. What the fit has not found is drawn from the error that the
        campaign states of it.
        """
        problem = self.problem.with_rows_of_all
        space, rows = problem.space, problem.adopt(fit, values)
        random = np.random.default_rng(_SEED)
        for name, value in space.stated.items():
            column = space.table.index[name]
            if np.all(rows[:, column] == problem.base[column]):
                rows[1:, column] += error_of(value) * random.standard_normal(len(rows) - 1)
        return rows

    def signals(self, fit: FitResult, values: FloatArray) -> tuple[FloatArray, ...]:
        """Return what values (n, parameters) of a fit predict (n, samples, C) of every trial [channel units].

        All but the first have errors of what the trials take as known, linearized: starts, tares, curves.
        """
        problem, rows = self.problem.with_rows_of_all, self.drawn(fit, values)
        signals, moves = problem.predict(rows).signals, problem.disturbances_at(rows[0])
        drawn = np.random.default_rng(_SEED + 1).standard_normal((len(rows) - 1, len(moves))) @ moves
        for block in problem.blocks:
            change = drawn[:, block.start : block.stop] * block.spread
            signals[block.trial][1:, :, block.channel] += change
        return signals

    def read(self, fit: FitResult, values: FloatArray) -> list[ReadTrial]:
        """Return numbers of use of every trial, predicted by values (n, parameters) of a fit, best first."""
        return [ReadTrial([]) for _ in self.problem.trials]
