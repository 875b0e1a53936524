"""What a fit leaves behind: ranked sets, the history of every run, and trajectories to look at."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sysid.errors import FitError
from sysid.fit.history import RunHistory
from sysid.fit.optima import Agreement, agreement
from sysid.journal import Finding
from sysid.parameter_sets import ParameterRecord, ParameterSets, SetsContent, content_of
from sysid.parameters import SearchSpace, about, in_words, with_unit
from sysid.shown import Brief
from sysid.types import BoolArray, FloatArray, Spectrum


@dataclass(frozen=True, eq=False, repr=False)
class TrialResult(Brief):
    """One trial, measured and simulated with every set, inside its fit window."""

    name: str
    use: Literal["fit", "validate"]
    # (n,) instants on the recording's clock [s].
    time: FloatArray
    # (n, C) measurement as compared (filtered, differentiated) [channel units].
    measured: FloatArray
    # (n, C) samples that count.
    valid: BoolArray
    # (S, n, C) the same with every set, best first [channel units].
    simulated: FloatArray
    # (S, C) NRMSE [1].
    nrmse: FloatArray
    # Spectrum of the measured channels before the filter; None where nothing was filtered.
    spectrum: Spectrum | None = None
    # (n,) measured thrust of a motor [N], prepared like the channels; shown, never compared.
    thrust: FloatArray | None = None
    # (m, 2) instants [s] of a motor's commands and the level u in [-1, 1] from each on.
    commands: FloatArray | None = None


@dataclass(frozen=True, eq=False, repr=False)
class RankedSets(Brief):
    """The best individual of each run, best first, with the run (from 1) and its seed.

    `cube` (S, n_free) are unit-cube points, `cost` (S,) the NRMSE that the search saw [1], `values`
    (S, n_table) rows of the model's table [SI]. `at_bound` (S, n_table) is -1 within 1 % of the lower bound,
    +1 of the upper, else 0.
    """

    run: tuple[int, ...]
    seed: tuple[int, ...]
    cube: FloatArray
    cost: FloatArray
    values: FloatArray
    at_bound: NDArray[np.int8]


# The paper's number of sets.
SETS_KEPT = 5


def ranked_sets(runs: Sequence[RunHistory], space: SearchSpace) -> RankedSets:
    """Return one set per run, the best `SETS_KEPT`, ranked by cost; equal costs keep the order of runs.

    Five of one population would be clones: the paper's five sets are the best of each run's last generation.
    """
    if not runs:
        raise FitError("no run has finished a generation, so there is no set; run the fit again")
    cost = np.array([float(run.best[-1]) for run in runs])
    order = np.argsort(cost, kind="stable")[:SETS_KEPT]
    cube = np.stack([runs[i].best_point for i in order])
    at_bound = np.zeros((len(order), len(space.table)), dtype=np.int8)
    at_bound[:, space.columns] = space.at_bound(cube)
    return RankedSets(
        run=tuple(int(i) + 1 for i in order),
        seed=tuple(runs[i].seed for i in order),
        cube=cube,
        cost=cost[order],
        values=space.full(cube),
        at_bound=at_bound,
    )


def _wider(record: ParameterRecord, side: int) -> str:
    """Return the campaign's line that widens one side of the bounds; empty where nothing lies beyond."""
    lower, upper = record.lower, record.upper
    if lower is None or upper is None or record.trial or (side < 0 and lower == 0.0):
        return ""
    reach = upper - lower
    if side > 0:
        upper = 4.0 * upper if record.scale == "log" else upper + reach
    else:
        # A bound above zero declares a sign.
        lower = lower / 4.0 if lower > 0.0 else lower - reach
    edges = [with_unit(f"{edge:.2g}", record.unit) for edge in (lower, upper)]
    return f'{record.name} = ["{edges[0]}", "{edges[1]}"]'


def bound_findings(parameters: Sequence[ParameterRecord], at_bound: NDArray[np.int8]) -> tuple[Finding, ...]:
    """Return which sets end at a bound of which parameter; `at_bound` (S, n) as in `FitResult`."""
    out = []
    for record, flags in zip(parameters, np.asarray(at_bound).T, strict=True):
        for side, bound, word in ((-1, record.lower, "lower"), (1, record.upper, "upper")):
            count = int(np.count_nonzero(flags == side))
            if count and bound is not None:
                name, edge = in_words(record, of_trial=False), with_unit(f"{bound:g}", record.unit)
                sentence = (
                    f"{count} of {len(flags)} sets {'ends' if count == 1 else 'end'} at the {word} bound of "
                    f"{name}, {edge}: the data do not determine it there, or the bound cuts it off"
                )
                if wider := _wider(record, side):
                    sentence += f"; {wider} under [parameters.bounds] looks beyond"
                out.append(about(record, f"at-{word}-bound", sentence, count))
    return tuple(out)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class FitResult(SetsContent):
    """A finished or stopped fit."""

    # ``stopped``: cut short by the user or the time limit.
    state: Literal["done", "stopped"]
    # Runs in the order in which they ran.
    runs: tuple[RunHistory, ...]
    # Run (from 1) and seed of each set.
    set_runs: tuple[int, ...]
    set_seeds: tuple[int, ...]
    # (S, n_free) sets in the unit cube, best first [1].
    cube: FloatArray
    trials: tuple[TrialResult, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        # Building the sets checks every shape except the trajectories'.
        self.parameter_sets()
        for trial in self.trials:
            shape = (len(self.nrmse), len(trial.time), len(self.channels))
            if trial.simulated.shape != shape or trial.measured.shape != shape[1:]:
                raise ValueError(
                    f"trial {trial.name}: simulated {trial.simulated.shape}, measured "
                    f"{trial.measured.shape}, expected {shape} and {shape[1:]}"
                )

    @property
    def agreement(self) -> Agreement:
        """What the runs say about each other, runs that were asked for and not begun included."""
        asked = self.provenance.get("search", {}).get("runs")
        floor = self.provenance.get("adequacy", {}).get("floor")
        return agreement(self.runs, asked, self.searched, floor)

    @property
    def searched(self) -> tuple[ParameterRecord, ...]:
        """Records of the parameters along the cube's axes, in their order; none where it is not recorded."""
        names = self.provenance.get("search", {}).get("axes", ())
        by_name = {record.name: record for record in self.parameters}
        return tuple(by_name[name] for name in names) if {*names} <= {*by_name} else ()

    @property
    def law(self) -> Mapping[str, Any]:
        """What `sysid.workflows.kinds.open_campaign` needs to take a campaign as the fit took its own.

        A fit whose record does not say so took stated values as exact.
        """
        return {**self.settings, "exact": self.provenance.get("search", {}).get("exact", True)}

    @property
    def nrmse_by_trial(self) -> FloatArray:
        """(S, T, C) NRMSE per set, trial and channel [1]."""
        shape = (len(self.nrmse), len(self.trials), len(self.channels))
        if not self.trials:
            return np.empty(shape)
        return np.stack([trial.nrmse for trial in self.trials], axis=1)

    def mean_nrmse(self, use: Literal["fit", "validate"]) -> FloatArray:
        """(S,) weighted mean over channels, then over the trials of one use [1]; NaN without such trials."""
        chosen = [t for t, trial in enumerate(self.trials) if trial.use == use]
        if not chosen:
            return np.full(len(self.nrmse), np.nan)
        return self.over_channels(self.nrmse_by_trial[:, chosen]).mean(axis=1)

    def parameter_sets(self) -> ParameterSets:
        """Return the ranked sets in the form in which they are exported."""
        return ParameterSets(
            **content_of(self),
            runs=self.set_runs,
            seeds=self.set_seeds,
            trials=tuple(trial.name for trial in self.trials),
            uses=tuple(trial.use for trial in self.trials),
            nrmse_by_trial=self.nrmse_by_trial,
        )
