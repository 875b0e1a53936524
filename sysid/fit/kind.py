"""A kind of model: how a verb makes a problem of a campaign, and an outcome of a search."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.fit.problem import Problem
from sysid.fit.result import RankedSets
from sysid.fit.settings import SearchSettings
from sysid.fit.stopping import CutReason
from sysid.fit.story import Story
from sysid.journal import Finding, tell
from sysid.parameter_sets import ParameterRecord, parameter_records
from sysid.types import FloatArray


@dataclass(frozen=True)
class Words:
    """What a kind's trials are called, and what sentences about them advise."""

    trials: str = "trials"
    # A further recording that `sysid check` could suggest.
    single: str = "trial"
    # The fault that makes a fit hang on one trial.
    misleads: str = "an error of that log"
    # A further remedy for a trial that fits unlike the others.
    remedy: str = ""
    # The fault that makes the prediction of one trial far worse than the others.
    unlike: str = "a misread unit, clock or log"


@dataclass(frozen=True, eq=False)
class Course:
    """A fit after its search.

    `cut` is what cut the search short. `go_on` returns False, or raises `sysid.fit.stopping.CutShort` where
    the fit must end.
    """

    sets: RankedSets
    settings: SearchSettings
    cut: CutReason | None
    go_on: Callable[[], bool]


@dataclass(frozen=True, eq=False)
class FitOutcome:
    """What a kind makes of the ranked sets of a fit."""

    # Sets in their final order.
    sets: RankedSets
    # (S, n_table) rows with which the trials are scored [SI].
    rows: FloatArray
    # One per column of `values`.
    records: tuple[ParameterRecord, ...]
    # The same as in `FitResult`.
    values: FloatArray
    at_bound: NDArray[np.int8]
    nrmse: FloatArray
    settings: Mapping[str, Any] = field(default_factory=dict)
    # Further keys of the fit's provenance.
    provenance: Mapping[str, Any] = field(default_factory=dict)
    # Reason that cut the search or the follow-up short.
    cut: CutReason | None = None


def _as_found(problem: Problem, course: Course) -> FitOutcome:
    """Return ranked sets as they are."""
    sets, choices = course.sets, problem.campaign.parameters
    ranges = choices.measured_ranges(problem.space.table)
    records = parameter_records(problem.space, None, ranges, stated=dict.fromkeys(choices.fixed, "campaign"))
    return FitOutcome(sets, sets.values, records, sets.values, sets.at_bound, sets.cost, cut=course.cut)


def begin(problem: Problem) -> None:
    """Tell what is fitted."""
    count = len(problem.fitted.trials)
    free = ", ".join(problem.space.names)
    tell(f"{count} trial{'s' * (count != 1)} to fit, {len(problem.trials) - count} to validate; free: {free}")


@dataclass(frozen=True)
class Term:
    """Physics that a model may be given: `parameters` of its table that are not free by default.

    `title` is what a table calls it, ``joint rubs dry``.
    """

    title: str
    parameters: tuple[str, ...]


@dataclass(frozen=True)
class Kind:
    """A kind of model."""

    # Name that campaign files and results state.
    name: str
    # Model of the campaign file: a subclass of `sysid.campaign.common.CampaignTable` with the tables ``fit``
    # and ``cost``.
    campaign: type
    # (campaign, path, threads) -> the problem of all its trials.
    open: Callable[[Any, Path, int | None], Problem]
    # (problem of all trials) -> None: refuses early what could not be fitted, tells what is fitted.
    begin: Callable[[Any], None] = begin
    # (problem of all trials, `Course`) -> `FitOutcome`.
    follow_up: Callable[[Any, Course], FitOutcome] = _as_found
    # (fitted problem, row (n_table,) [SI]) -> (problem with one trial per recording that could be made next,
    # their titles), or None.
    candidates: Callable[[Any, FloatArray], tuple[Problem, Sequence[str]] | None] = lambda fitted, row: None
    # (campaign, settings of a fit) -> (the campaign under the law of that fit, what is noticed).
    under: Callable[[Any, Mapping[str, Any]], tuple[Any, tuple[Finding, ...]]] = lambda campaign, settings: (
        campaign,
        (),
    )
    # (problem, rows (S, n_table) [SI]) -> every number (S, n) of such sets, as in `FitOutcome.values`.
    numbers: Callable[[Any, FloatArray], FloatArray] = lambda problem, rows: rows
    # (problem) -> covariances (k, k) of measured values that no parameter moves, by their k names [SI].
    unmoved: Callable[[Any], Mapping[tuple[str, ...], FloatArray]] = lambda problem: {}
    # Physics on trial, see `sysid.trust.ladder`.
    terms: tuple[Term, ...] = ()
    # (fitted problem) -> (title, simpler model of the same trials) pairs that the ladder compares.
    simpler: Callable[[Any], Sequence[tuple[str, Problem]]] = lambda problem: ()
    # Settings that a user may state instead of the campaign's; `under` reads them.
    laws: tuple[str, ...] = ()
    words: Words = Words()
    # Makes the descriptions of a problem's trials.
    story: type[Story[Any]] = Story
