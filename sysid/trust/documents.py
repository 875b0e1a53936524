"""What is known about how far a fit can be trusted: ``NAME.json`` and ``NAME.h5`` in the fit folder.

Four documents: ``trust``, ``explain`` and ``cross-validation`` (one per fit), and ``validation-CAMPAIGN``
(``validation-CAMPAIGN-HASH`` for a second campaign file of that name). Units are SI. The HDF5 file has
arrays, each with the attributes ``axes`` and ``unit``:

``trust``: ``correlation``, ``covariance`` (unit cube), ``profiles/NAME/{value, deviance, others}`` (ascending
values; deviance is chi-square-like, limits 0.989 and 3.841; others (k, n) are all free parameters),
``bootstrap/values`` (B, n), ``draws`` (200, all parameters).
Validation: ``trials/NUMBER/{time, measured, valid, simulated}`` (in order, from 1) as in ``fit.h5``.
Cross-validation: ``values`` (T, n).
"""

import hashlib
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar, Literal, Self, TypeVar

from pydantic import ConfigDict, Field

from sysid.documents import Document, OpenMapping, Part
from sysid.errors import FitError
from sysid.fit.adequacy import NOT_BY, Adequacy
from sysid.fit.provenance import CampaignFile
from sysid.journal import MISSTATED, notice
from sysid.parameter_sets import ACCUSED, INTERVALS, PREDICTS, STATED, Flags, Judged, Pair, SetsContent
from sysid.recording import file_sha256
from sysid.storage import FileKind, datasets, put, write_files
from sysid.trust.use import ClassOfUse, NumberOfUse, Use, judged_use
from sysid.types import BoolArray, FloatArray

TRUST, CROSS_VALIDATION, EXPLAIN, VALIDATION = "trust", "cross-validation", "explain", "validation-"
Sets = TypeVar("Sets", bound=SetsContent)
# Arrays of a document by path in its HDF5 file: values, axes, unit.
Arrays = Mapping[str, tuple[FloatArray | BoolArray, str, str]]


class Partner(Part):
    """A parameter that another one trades with, and the correlation of their estimates [1]."""

    name: str
    correlation: float


class FreeParameter(Judged):
    """What is known of one free parameter [its unit]; the intervals come from the profile."""

    name: str
    symbol: str
    unit: str
    lower: float
    upper: float
    scale: str
    # Best set.
    value: float
    # Least sum of squares; it differs from `value` by less than the interval, or a warning says so.
    refined: float
    # Over the fit's sets (Table II).
    mean: float
    sigma: float
    # Linearized standard deviation.
    fisher_sigma: float
    # Share by which the derivative changes when its step is halved [1]; from a tenth on it is not trusted.
    derivative_doubt: float
    derivative_trusted: bool
    interval_68: Pair
    open_68: Flags
    # Half of `interval_95` over the profile's best value [1], infinite where open.
    half_width: float
    # The same, linearized, as in `sysid check`.
    expected_half_width: float
    # Strongest first, from a correlation of 0.8 on.
    partners: list[Partner]
    # -1, 0 or 1: the best set ends within 1 % of the lower bound, of none, of the upper one.
    at_bound: int
    # The campaign's independent measurement.
    measured: Pair | None
    bootstrap_95: Pair | None
    # Points of the profile that needed a random search.
    rough_points: int


class StatedValue(Part):
    """A value that the campaign states with an error, and what the fit made of it [its unit]."""

    name: str
    symbol: str
    unit: str
    # Value in the campaign, and its standard error there.
    stated: float
    error: float
    # Value in the best set, its standard deviation after the fit, and its distance from the stated value
    # [standard errors].
    fitted: float
    sigma: float
    pull: float
    # Fall of the deviance were the value not stated [1], and the value that the trials ask for then.
    gain: float
    asked: float
    # Whether no chance explains that fall, and the values that would explain the trials as well.
    contradicted: bool
    partners: list[str]


class Suspect(Part):
    """What may be wrong, and what noise explains without it.

    Values of which nothing is stated then, a mistake such as an exchange, or a trial that is left out; the
    first one of several is the fit as it is, without names.
    """

    what: Literal["fit", "value", "swap", "trial"]
    names: list[str]
    # NRMSE over what noise costs, and the worst channel's [1].
    over_noise: float
    worst_channel: float
    verdict: str
    # Sentences of the accusation; none where nobody is accused.
    sentences: list[str]


class ChannelNoise(Part):
    """Rms of the residuals and of the measurement's noise [unit], over all trials; NaN where not known."""

    name: str
    unit: str
    residual: float
    floor: float
    samples: int
    independent_samples: float


class Noise(Part):
    """What the intervals rest on, in words, and the noise of every channel."""

    statement: str
    channels: list[ChannelNoise]


class SpreadOfTrial(Part):
    """How far the predictions of all sets lie around their mean, one number per channel [its unit]."""

    name: str
    use: str
    rms: list[float]
    largest: list[float]


class Spread(Part):
    """The spread of every trial's predictions."""

    channels: list[str]
    units: list[str]
    trials: list[SpreadOfTrial]


class TrialInfluence(Part):
    """How much of a fit hangs on one trial."""

    name: str
    # Residual over what noise alone costs [1].
    ratio: float
    # Parameters of the fit without the trial [SI].
    without: dict[str, float]
    # Moves of the parameters, in standard deviations of what one trial less explains [1].
    shift: dict[str, float]


class Bootstrap(Part):
    """Fits of resampled trials; those that did not come to an end, ``failed``, count from where they are."""

    resamples: int
    failed: int


class Leaves(Part):
    """The first of three samples in a row beyond ``limits.leaves`` noise deviations."""

    # Time since the first touchdown, or on the log's clock for a model without contacts [s].
    time: float
    channel: str
    # Contacts of the prediction until then.
    after_contacts: int


class JudgedTrial(Part):
    """A predicted trial; all numbers but ``nrmse`` are the best set's."""

    # Earlier versions stated where a drop came to rest by keys of its own.
    model_config = ConfigDict(extra="ignore")

    name: str
    # One value per set, best first [1].
    nrmse: list[float]
    by_channel: dict[str, float]
    # NRMSE that the measurement's noise alone costs [1]; NaN where not known.
    floor: float
    # NRMSE over that floor [1].
    ratio: float
    # The same two up to the prediction's third touchdown [1].
    nrmse_third_contact: float | None
    ratio_third_contact: float | None
    # Time from the first touchdown to the third [s].
    third_contact: float | None
    leaves: Leaves | None
    # What of use is predicted; none of a fit of an older version.
    numbers: list[NumberOfUse] = Field(default_factory=list)
    ends: ClassOfUse | None = None


class LeftOutTrial(JudgedTrial):
    """A trial that was left out."""

    # Parameters of the fit without it [SI].
    refit: dict[str, float]


def _with_digests(stated: dict[str, Any]) -> dict[str, Any]:
    """Return a document of version 1, which named the SHA-256 of two files by keys."""
    named = {"fit.h5": "fit_sha256", f"{stated.get('part')}.h5": "arrays_sha256"}
    kept = {key: value for key, value in stated.items() if key not in named.values()}
    return kept | {"sha256": {name: stated[key] for name, key in named.items() if stated.get(key)}}


class TrustPart(Document):
    """What every document of trust states."""

    WHAT: ClassVar[str] = "a document of trust"
    REMEDY: ClassVar[str] = "run it again"

    schema_: Literal["sysid-trust"] = Field(default="sysid-trust", alias="schema")
    MIGRATIONS: ClassVar = {1: _with_digests}

    version: Literal[2] = 2
    # Name of the file without its suffix.
    part: str
    # Name and kind of the fit.
    fit: str
    kind: str
    # Time of writing, set by `part_files`.
    written: str = ""
    campaign: CampaignFile
    warnings: list[str]

    @classmethod
    def read(cls, folder: Path, part: str = "") -> Self | None:
        """Return a document of a fit folder; None where there is none.

        One that names another fit.h5 or other arrays than lie beside it does not count either, and is
        noticed. A class of one document knows its `part`. Raises FitError when the file is damaged, changed
        or of another version.
        """
        path = folder / f"{part or cls.model_fields['part'].default}.json"
        if not path.is_file():
            return None
        try:
            text = path.read_bytes()
        except OSError as error:
            raise FitError(f"{path}: cannot be read ({error}); run it again") from error
        document = cls.parse(text, path, FitError)
        for name in ("part", "sha256", "written"):
            if name not in document.model_fields_set:
                raise FitError(f"{path}: damaged or cut off ({name}: it is missing); {cls.REMEDY}")
        changed = document.changed(path, text)
        if changed == path.name:
            raise FitError(
                f"{path}: has changed since sysid wrote it (another SHA-256); restore it, or {cls.REMEDY}"
            )
        if changed:
            sentence = f"{path} is not used: what it says is of another {changed} than lies beside it"
            notice("of-another-fit", f"{sentence}; restore the file that was changed, or write {path} again")
        return None if changed else document

    def printed(self) -> dict[str, Any]:
        """Return what a command prints: all but what only the file needs."""
        return self.model_dump(exclude=_OF_THE_FILE)


_OF_THE_FILE = {"schema_", "version", "part", "fit", "kind", "written"}


class TrustDocument(TrustPart):
    """``trust.json``: intervals, verdicts and influence of trials."""

    part: str = TRUST
    adequacy: Adequacy | None = None
    parameters: list[FreeParameter]
    stated: list[StatedValue] = Field(default_factory=list)
    suspects: list[Suspect] = Field(default_factory=list)
    correlation: list[list[float]]
    noise: Noise
    trials: list[TrialInfluence]
    notes: list[str]
    spread: Spread
    bootstrap: Bootstrap | None
    evaluations: int
    seconds: float

    @property
    def by_name(self) -> dict[str, FreeParameter]:
        """The parameters by name."""
        return {row.name: row for row in self.parameters}


class Overall(Part):
    """Predictions over all trials: flagged where they are off by more than a limit, and why."""

    flagged: bool
    reasons: list[str]
    limits: dict[str, float]
    nrmse: float
    nrmse_fitted: float
    ratio: float
    ratio_third_contact: float
    # What the prediction is good for; None of a validation by an older version.
    use: Use | None = None


class Judgement(Overall, TrustPart):
    """What a validation and a cross-validation state."""


class ValidationDocument(Judgement):
    """``validation-CAMPAIGN.json``: trials that were not fitted."""

    trials: list[JudgedTrial]


class CrossValidationDocument(Judgement):
    """``cross-validation.json``: every fitted trial, predicted by the fit of the others."""

    part: str = CROSS_VALIDATION
    trials: list[LeftOutTrial]


class LadderRung(Part):
    """A fit with some terms, and how well it predicts."""

    # Titles of its terms.
    terms: list[str]
    # Every free parameter [SI].
    values: dict[str, float]
    nrmse: float
    # NRMSE over what noise alone costs [1].
    over_noise: float
    # The same of each trial as the fit of the others predicts it [1].
    left_out: list[float]
    # Its residual over noise there, root mean square over the channels, by which terms are judged [1].
    misfit: list[float]
    # Mean logarithm of what the last term takes off `misfit` [1].
    gain: float
    # Probability that the gain is luck, or that a kept term has no value beside the others (Wald), for all
    # terms looked at [1]; NaN of the base.
    chance: float
    # The last term is among those to keep.
    kept: bool


class ExplainDocument(TrustPart):
    """``explain.json``: what the campaign may state wrongly, then each term of the fit's kind.

    Terms are added alone, then those to keep together, to what is left without the accused. There is none
    where noise explains that.
    """

    part: str = EXPLAIN
    suspects: list[Suspect] = Field(default_factory=list)
    # Names of what was left out in turn: the trials, or `parts` of them.
    trials: list[str]
    parts: bool
    # All parameters that a rung has, by name.
    symbols: dict[str, str]
    units: dict[str, str]
    meanings: dict[str, str] = Field(default_factory=dict)
    # The model without the accused and with the terms to keep.
    adequacy: Adequacy
    base: LadderRung
    alone: list[LadderRung]
    # The terms to keep, one more in each rung; the nearest one where there is none.
    together: list[LadderRung]
    # Models that lack something, by their title in `terms`: `gain` and `chance` are of the fit's model over
    # them, `kept` says that what they lack is needed.
    simpler: list[LadderRung] = Field(default_factory=list)
    # Titles and parameters of the terms to keep.
    keep: list[str]
    parameters: list[str]
    evaluations: int
    seconds: float


def larger(width: float, other: float) -> float:
    """Return the larger of two half-widths [1]; NaN counts as not there."""
    return max(width, other, key=lambda w: -1.0 if w != w else w)


class Expected(Part):
    """What the trials of a campaign are expected to determine of a parameter, before a fit.

    NaN where not computed.
    """

    name: str
    symbol: str
    unit: str
    value: float
    # Relative 95 % half-width at `value`, and its median over points drawn from the bounds [1].
    half_width: float
    half_width_over_bounds: float
    partners: list[Partner]
    # On the worse half-width.
    verdict: str

    @property
    def worse(self) -> float:
        """The larger of both half-widths [1]."""
        return larger(self.half_width, self.half_width_over_bounds)


class ExpectedParameter(Expected):
    """The same in a check."""

    # Share of what is known that comes from each channel [1].
    channels: dict[str, float]


class CandidateRecording(Part):
    """A recording that could be made next: what it leaves open of each parameter, as `Expected` states it."""

    # Such as ``a drop on 25 deg at 0.8 m/s``.
    title: str
    # Logarithm by which the half-widths of the weakly determined parameters fall, summed [1].
    gain: float
    half_widths: dict[str, float]
    half_widths_over_bounds: dict[str, float]
    verdicts: dict[str, str]

    def worse(self, name: str) -> float:
        """Return the larger of both half-widths of a parameter [1]."""
        return larger(self.half_widths[name], self.half_widths_over_bounds[name])


class CheckDocument(Part):
    """What `sysid check` prints as JSON. Quality and excitation are in the words of the kind."""

    campaign: CampaignFile
    kind: str
    parameters: list[ExpectedParameter]
    limits: dict[str, float]
    candidates: list[CandidateRecording]
    sentences: list[str]
    quality: list[OpenMapping]
    excitation: OpenMapping
    centre_of_mass: OpenMapping | None = None
    warnings: list[str]
    # Whether the verdicts are withheld, because the logs contradict the campaign.
    withheld: bool = False
    seconds: float


ARRAYS = FileKind("sysid-trust", 1, "the arrays of a trust document", "run it again", FitError)


def write_part(
    folder: Path,
    document: TrustPart,
    arrays: Arrays,
    beside: Callable[[str], dict[str, bytes]] = lambda fit_sha256: {},
) -> Path:
    """Write one document and its arrays into a fit folder, in place of an earlier one.

    `beside` returns further files of the folder that change with it, by name, from the SHA-256 of ``fit.h5``.
    Raises FitError, with nothing changed, when it cannot be written.
    """
    digest = file_sha256(folder / "fit.h5")
    files = part_files(document, arrays, digest) | beside(digest)
    write_files({folder / name: data for name, data in files.items()}, FitError)
    return folder / f"{document.part}.json"


def part_files(document: TrustPart, arrays: Arrays, fit_sha256: str) -> dict[str, bytes]:
    """Return the files of a document and its arrays by name; `fit_sha256` is of the fit.h5 beside them."""

    def write(file: Any) -> None:
        file.attrs["part"] = document.part
        for path, (values, axes, unit) in arrays.items():
            put(file, path, values, axes, unit)

    content = ARRAYS.content(write)
    document = document.model_copy(update={"written": datetime.now(UTC).isoformat(timespec="seconds")})
    digests = {"fit.h5": fit_sha256, f"{document.part}.h5": hashlib.sha256(content).hexdigest()}
    name = f"{document.part}.json"
    # The arrays first: without the document, which names them, they count as not there.
    return {f"{document.part}.h5": content, name: document.sealed(name, **digests)}


def read_arrays(folder: Path, part: str) -> dict[str, FloatArray]:
    """Return the arrays of a document by their path in the HDF5 file; FitError when it cannot be read."""
    with ARRAYS.opened(folder / f"{part}.h5") as file:
        return datasets(file)


def parts(folder: Path) -> tuple[str, ...]:
    """Return the documents in a fit folder, whether or not the fit has changed since."""
    stems = sorted(path.stem for path in folder.glob("*.json") if (folder / f"{path.stem}.h5").is_file())
    return tuple(
        name for name in stems if name in (TRUST, CROSS_VALIDATION, EXPLAIN) or name.startswith(VALIDATION)
    )


def with_intervals(sets: Sets, folder: Path) -> Sets:
    """Return the sets of a fit folder; settings state interval and verdict where the fit was assessed."""
    document = TrustDocument.read(folder) if folder.is_dir() else None
    return sets if document is None else stating_intervals(sets, document, use_of(folder))


def use_of(folder: Path) -> Use | None:
    """Return what the validations of a fit say that it predicts; without any, its cross-validation.

    None where nothing was predicted. A document that cannot be read does not count.
    """
    read: list[ValidationDocument | CrossValidationDocument] = []
    with suppress(FitError):
        names = [part for part in parts(folder) if part.startswith(VALIDATION)]
        read += [document for part in names if (document := ValidationDocument.read(folder, part))]
        if not read and (cross := CrossValidationDocument.read(folder)):
            read.append(cross)
    used = [document for document in read if document.use is not None]
    if not used:
        return None
    trials = ((trial.numbers, trial.ends) for document in used for trial in document.trials)
    return judged_use(trials, drawn=all(document.use is not None and document.use.drawn for document in used))


def stating_intervals(sets: Sets, document: TrustDocument, use: Use | None = None) -> Sets:
    """Return sets whose settings state interval and verdict of a document, and what `use` says of them.

    They give the document's warnings.
    """
    rows = {row.name: row.model_dump(include={*Judged.model_fields}) for row in document.parameters}
    findings = sets.provenance.get("findings", ())
    settled = {one["sentence"] for one in findings if one["code"] == "not-assessed"}
    warnings = dict.fromkeys((*sets.warnings, *document.warnings))
    accused = [sentence for one in document.suspects for sentence in one.sentences]
    if not accused and document.adequacy and document.adequacy.verdict == NOT_BY:
        # A contradiction between a log and the campaign is the likeliest cause.
        accused = [
            ": ".join([*one.get("trials", ()), one["sentence"]])
            for one in findings
            if one["code"].startswith(MISSTATED)
        ]
    settings = {**sets.settings, INTERVALS: {**sets.settings.get(INTERVALS, {}), **rows}}
    if document.stated:
        fields = {"unit", "stated", "error", "fitted", "sigma", "pull"}
        settings[STATED] = {row.name: row.model_dump(include=fields) for row in document.stated}
    return replace(
        sets,
        settings=settings
        | ({ACCUSED: accused} if accused else {})
        | ({PREDICTS: {"word": use.word, "sentence": use.sentence}} if use is not None and use.word else {}),
        warnings=tuple(warning for warning in warnings if warning not in settled),
    )


def free_part(folder: Path, part: str, campaign: CampaignFile) -> str:
    """Return the name under which a validation replaces an earlier one of its campaign, and no other.

    `part` is the `validation_part` of the campaign's name, `campaign` what the document states of its file.
    Equal places (the file was edited) or equal contents (it was moved) mean the same campaign. The name for
    another campaign ends in part of its hash.
    """
    there = {}
    for name in parts(folder):
        if re.fullmatch("(?i)" + re.escape(part) + "(-[0-9a-f]{8})?", name):
            with suppress(FitError):
                if document := ValidationDocument.read(folder, name):
                    there[name] = document.campaign
    for key in ("from_fit_folder", "sha256"):
        same = [name for name, stated in there.items() if stated.get(key, "") == campaign.get(key)]
        if same:
            return same[0]
    taken = {name.casefold() for name in there}
    return part if part.casefold() not in taken else f"{part}-{campaign['sha256'][:8]}"


def validation_part(campaign: str) -> str:
    """Return the name of a campaign's validation; characters that a file name cannot have become hyphens."""
    return VALIDATION + re.sub(r"[^A-Za-z0-9._-]", "-", campaign)
