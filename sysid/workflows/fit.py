"""The walk that every fit takes, whatever it fits: campaign, search, ranked sets, fit folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from sysid.campaign import GearCampaign, MotorCampaign
from sysid.fit.checkpoint import checkpoint_folder, run_numbers
from sysid.fit.objective import Objective
from sysid.fit.optima import loose_warnings
from sysid.fit.progress import FitProgress
from sysid.fit.result import FitResult, RankedSets, TrialResult, bound_warnings
from sysid.fit.search import SearchSettings
from sysid.fit.stopping import Deadline, stop_on_interrupt
from sysid.parameter_sets import ParameterRecord
from sysid.parameters import SearchSpace
from sysid.workflows.options import FitOptions
from sysid.workflows.search import (
    Search,
    check_start,
    collected_warnings,
    fit_identity,
    naming,
    provenance,
    search,
    search_settings,
)


@dataclass(frozen=True)
class Outcome:
    """What a fit of one kind makes of its ranked sets.

    Parameters
    ----------
    records : tuple of ParameterRecord
        One per column of `values`.
    values, at_bound : (S, n) array
        Of the sets [SI]; -1, 0, 1 where a value ends at a bound.
    nrmse : (S,) array
        Of the sets [1].
    trials : tuple of TrialResult
        Scored with the sets.
    channels : sequence of (name, unit, weight)
        Compared.
    settings : mapping
        What a simulator must know beside the numbers.
    filters, logs : mapping
        For the provenance.
    warnings : tuple of str
        Doubts about the sets, still to be told.
    told : tuple of str
        Doubts that were told already.
    more : mapping
        Further provenance.
    """

    records: tuple[ParameterRecord, ...]
    values: Any
    at_bound: Any
    nrmse: Any
    trials: tuple[TrialResult, ...]
    channels: Sequence[tuple[str, str, float]]
    settings: dict[str, Any]
    filters: Mapping[str, Any]
    logs: Mapping[str, Any]
    warnings: tuple[str, ...] = ()
    told: tuple[str, ...] = ()
    more: Mapping[str, Any] = field(default_factory=dict)


class FitWalk:
    """One fit under way; enter it, and Ctrl-C keeps what was found from the search's begin to the end.

    Parameters
    ----------
    path : str or Path
        Campaign file.
    campaign : GearCampaign or MotorCampaign
        Its content.
    options : FitOptions, optional
        Overrides of the command line.
    say : callable, optional
        Told, one sentence at a time, what is going on and what is doubtful.

    Raises
    ------
    FitError
        When the folder holds a fit that must not be replaced, or one that cannot be continued.
    """

    def __init__(
        self,
        path: str | Path,
        campaign: GearCampaign | MotorCampaign,
        options: FitOptions | None,
        say: Callable[[str], None] | None,
    ) -> None:
        self.path, self.campaign = path, campaign
        self.options = options or FitOptions()
        self.tell = say or (lambda sentence: None)
        self.folder = self.options.folder(campaign.name)
        self.deadline = Deadline(self.options.time_limit)
        self._doubts: list[str] = []
        self._open = ExitStack()
        check_start(self.folder, self.options)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()
        # Aborted by a second Ctrl-C, or before the first one was listened to.
        if isinstance(error, KeyboardInterrupt) and run_numbers(checkpoint_folder(self.folder)):
            self.tell(f"{self.folder}: aborted; what was scored is kept, continue with --resume")

    @property
    def settings(self) -> SearchSettings:
        """The search that the campaign and the command line ask for."""
        return search_settings(self.options, self.campaign.fit)

    @contextmanager
    def prepared(self) -> Iterator[None]:
        """Tell and keep the warnings of what happens inside; complaints name the campaign."""
        with naming(self.path), collected_warnings(lambda text: self.tell(f"warning: {text}")) as doubts:
            self._doubts = doubts
            yield

    def search(
        self, objective: Objective, hashes: Mapping[str, str], simulated: str, **accuracy: Any
    ) -> Search:
        """Search; `hashes` of the logs and `accuracy` must be equal for the fit to be continued."""
        identity = fit_identity(self.path, self.settings, objective.space, hashes, **accuracy)
        settings = replace(self.settings, stop=replace(self.settings.stop, time_limit=self.deadline.left))
        progress = FitProgress(settings, simulated, self.options.quiet)
        self.deadline.flag = self._open.enter_context(stop_on_interrupt(progress.on_stop))
        found = search(
            objective, settings, folder=self.folder, options=self.options, identity=identity,
            progress=progress, flag=self.deadline.flag, tell=self.tell,
        )  # fmt: skip
        self._open.callback(found.close)
        return found

    def finish(
        self, space: SearchSpace, found: Search, sets: RankedSets, outcome: Outcome
    ) -> tuple[FitResult, Path]:
        """Tell what is doubtful, write the fit folder, and return the result and where it was written."""
        closing = (
            *bound_warnings(outcome.records, outcome.at_bound),
            *loose_warnings(found.runs, space),
            *outcome.warnings,
        )
        for sentence in closing:
            self.tell(f"warning: {sentence}")
        names, units, weights = zip(*outcome.channels, strict=True)
        result = FitResult(
            kind=self.campaign.kind,
            name=self.campaign.name,
            state=found.state,
            parameters=outcome.records,
            runs=found.runs,
            set_runs=sets.run,
            set_seeds=sets.seed,
            cube=sets.cube,
            values=outcome.values,
            at_bound=outcome.at_bound,
            nrmse=outcome.nrmse,
            trials=outcome.trials,
            channels=names,
            channel_units=units,
            channel_weights=weights,
            settings=outcome.settings,
            provenance={
                **provenance(
                    self.path,
                    self.settings,
                    self.campaign.cost.denominator,
                    outcome.filters,
                    outcome.logs,
                    self.folder,
                    space.names,
                ),
                **({} if found.cut is None else {"cut_short": found.cut}),
                **outcome.more,
            },
            warnings=(*self._doubts, *found.warnings, *closing, *outcome.told),
        )
        return result, found.write(result, self.folder, self.options)
