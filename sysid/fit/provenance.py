"""Where a fit comes from, and the content of ``fit.json``."""

from typing import ClassVar, Required, get_type_hints

from pydantic import with_config
from typing_extensions import TypedDict

from sysid.documents import CONFIG, Open, OpenMapping
from sysid.fit.adequacy import Adequacy
from sysid.fit.stopping import CutReason
from sysid.parameter_sets import SetsDocument
from sysid.search_options import SearchOptions


@with_config(CONFIG)
class CampaignFile(TypedDict, total=False):
    """A campaign file: its path seen from the fit folder and its text (fitted), its name (checked)."""

    file: Required[str]
    sha256: Required[str]
    from_fit_folder: str
    name: str
    text: str


# How a fit searched: every option, the seed of each run, the population of CMA-ES as a finisher [1], and the
# parameters along the axes of the runs' cube, in their order.
_SEARCH = {
    **get_type_hints(SearchOptions), "run_seeds": list[int], "finish_population": int, "axes": list[str],
}  # fmt: skip
SearchRecord = TypedDict("SearchRecord", _SEARCH, total=False)  # type: ignore[misc]
with_config(CONFIG)(SearchRecord)


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
    # Findings, repeats over trials joined; the sentences of its warnings are `warnings`.
    findings: list[FindingRecord]
    # How far noise explains what the fit leaves, and where the misfit sits.
    adequacy: Adequacy
    # Half-widths that the trials were expected to leave, per parameter.
    expected: list[Open]


class FitDocument(SetsDocument):
    """``fit.json``: the ranked sets, settings and provenance of a fit."""

    WHAT: ClassVar[str] = "a fit"
    REMEDY: ClassVar[str] = "run the fit again"

    provenance: FitProvenance  # type: ignore[assignment]
