"""Where a fit comes from, and the content of ``fit.json``."""

from __future__ import annotations

from typing import ClassVar, Required

from pydantic import with_config
from typing_extensions import TypedDict

from sysid.documents import CONFIG, Open, OpenMapping
from sysid.fit.adequacy import Adequacy
from sysid.fit.settings import Reading
from sysid.fit.stopping import CutReason
from sysid.parameter_sets import SetsDocument


@with_config(CONFIG)
class CampaignFile(TypedDict, total=False):
    """A campaign file: its path seen from the fit folder and its text (fitted), its name (checked)."""

    file: Required[str]
    sha256: Required[str]
    from_fit_folder: str
    name: str
    text: str


@with_config(CONFIG)
class SearchRecord(TypedDict, total=False):
    """How a fit searched; see `sysid.fit.search.SearchSettings`. `time_limit` in seconds."""

    algorithm: str
    finish: str
    finish_population: int
    population: int
    runs: int
    # Parameters along the axes of the runs' cube, in their order.
    axes: list[str]
    seed: int
    run_seeds: list[int]
    stop_reading: Reading
    stop_window: int
    stop_tolerance: float
    max_generations: int
    max_evaluations: int | None
    time_limit: float | None


@with_config(CONFIG)
class FindingRecord(TypedDict, total=False):
    """A `sysid.journal.Finding`."""

    code: str
    severity: str
    sentence: str
    trials: list[str]
    parameters: list[str]


@with_config(CONFIG)
class FitProvenance(TypedDict, total=False):
    """What a reader needs to repeat a fit, or to doubt it."""

    sysid: str
    git_revision: str | None
    python: str
    libraries: dict[str, str]
    system: str
    processor: str
    cores: int | None
    written: str
    campaign: CampaignFile
    # By trial: file, hash, what was noticed; the model's own words.
    logs: dict[str, OpenMapping]
    filter: OpenMapping
    nrmse_denominator: str
    search: SearchRecord
    # Why the fit was stopped before its end; absent from a fit that is done.
    cut_short: CutReason
    # Failed candidates by cause.
    failures: dict[str, int]
    # What was noticed, repeats over trials joined; the sentences of its warnings are `warnings`.
    findings: list[FindingRecord]
    # How far noise explains what the fit leaves, and where the misfit sits.
    adequacy: Adequacy
    # What the trials were expected to determine, per parameter.
    expected: list[Open]


class FitDocument(SetsDocument):
    """``fit.json``: the ranked sets, settings and provenance of a fit."""

    WHAT: ClassVar[str] = "a fit"
    REMEDY: ClassVar[str] = "run the fit again"

    provenance: FitProvenance  # type: ignore[assignment]
