"""What is known about how far a fit can be trusted: ``NAME.json`` and ``NAME.h5`` in the fit folder.

Four documents: ``trust``, ``ladder`` and ``cross-validation`` (one per fit), and ``validation-CAMPAIGN``
(``validation-CAMPAIGN-HASH`` for a second campaign file of that name). Units are SI. The HDF5 file has
arrays, each with the attributes ``axes`` and ``unit``:

``trust``: ``correlation``, ``covariance`` (unit cube), ``profiles/NAME/{value, deviance, others}`` (ascending
values; deviance is chi-square-like, limits 0.989 and 3.841; others (k, n) are all free parameters),
``bootstrap/values`` (B, n). Validation: ``trials/NUMBER/{time, measured, valid, simulated}`` (in order, from
1) as in ``fit.h5``. Cross-validation: ``values`` (T, n).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import ConfigDict, Field

from sysid.documents import Document, Open, OpenMapping, Part
from sysid.errors import FitError
from sysid.fit.adequacy import Adequacy
from sysid.fit.provenance import CampaignFile
from sysid.parameter_sets import INTERVALS, SetsContent
from sysid.recording import file_sha256
from sysid.storage import FileKind, datasets, put, write_files

TRUST, CROSS_VALIDATION, LADDER, VALIDATION = "trust", "cross-validation", "ladder", "validation-"
Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Sets = TypeVar("Sets", bound=SetsContent)
Flags = Annotated[list[bool], Field(min_length=2, max_length=2)]


class Partner(Part):
    """A parameter that another one trades with, and the correlation of their estimates [1]."""

    name: str
    correlation: float


class FreeParameter(Part):
    """What is known of one free parameter, in its unit.

    ``value`` is the best set's. The sum of squares is least at ``refined``, which differs from ``value`` by
    less than the interval, or a warning says so. ``mean`` and ``sigma`` are over the fit's sets (Table II).
    ``fisher_sigma`` is the linearized standard deviation. ``derivative_doubt`` is the share by which the
    derivative changes when its step is halved; from a tenth on it is not trusted. Intervals [low, high] come
    from the profile; an open end is a bound of the search. ``half_width`` is half of ``interval_95`` over the
    profile's best value, infinite where open; ``expected_half_width`` is linearized, as in `sysid check`.
    ``verdict`` is "well" below 0.1, "weakly" below 0.5, else "not_identifiable"; never "well" with a
    ``doubt``, which says why the interval may miss the truth. It is "not_interpretable" where the
    model does not explain the trials and a bound cuts it or a partner. ``partners`` come strongest first,
    from a correlation of 0.8 on. ``at_bound`` is -1, 0 or 1: the best set ends within 1 % of a bound.
    ``measured`` is the campaign's independent measurement. ``rough_points`` of the profile needed a random
    search.
    """

    name: str
    symbol: str
    unit: str
    lower: float
    upper: float
    scale: str
    value: float
    refined: float
    mean: float
    sigma: float
    fisher_sigma: float
    derivative_doubt: float
    derivative_trusted: bool
    interval_68: Pair
    interval_95: Pair
    open_68: Flags
    open_95: Flags
    half_width: float
    verdict: str
    doubt: str | None
    expected_half_width: float
    partners: list[Partner]
    at_bound: int
    measured: Pair | None
    bootstrap_95: Pair | None
    rough_points: int


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
    """Residual over what noise alone costs; parameters of the fit without the trial.

    ``shift`` is how far they move, in standard deviations of what one trial less explains.
    """

    name: str
    ratio: float
    without: dict[str, float]
    shift: dict[str, float]


class Bootstrap(Part):
    """Fits of resampled trials; those that did not come to an end, ``failed``, count from where they are."""

    resamples: int
    failed: int


class JudgedTrial(Part):
    """A predicted trial. ``nrmse`` has a value per set, best first; the other numbers are the best's [1].

    ``floor`` is what the measurement's noise alone costs (NaN where not known), ``ratio`` the NRMSE over it.
    NRMSE and ratio are also stated up to the prediction's third touchdown, ``third_contact`` after the first
    one [s]. ``leaves`` is the first of three samples in a row beyond ``limits.leaves`` noise deviations: time
    [s], channel, contacts before.
    """

    name: str
    nrmse: list[float]
    by_channel: dict[str, float]
    floor: float
    ratio: float
    nrmse_third_contact: float | None
    ratio_third_contact: float | None
    third_contact: float | None
    leaves: OpenMapping | None


class ValidatedTrial(JudgedTrial):
    """A validated trial; further keys are its kind's, see `sysid.fit.problem.Problem.beyond`."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Open]


class LeftOutTrial(JudgedTrial):
    """A trial that was left out, and the parameters of the fit without it."""

    refit: dict[str, float]


class TrustPart(Document):
    """What every document of trust states."""

    WHAT: ClassVar[str] = "a document of trust"
    REMEDY: ClassVar[str] = "run it again"

    schema_: Literal["sysid-trust"] = Field("sysid-trust", alias="schema")
    version: Literal[1] = 1
    part: str
    fit: str
    kind: str
    fit_sha256: str
    written: str
    campaign: CampaignFile
    warnings: list[str]


class TrustDocument(TrustPart):
    """``trust.json``: intervals, verdicts and influence of trials."""

    adequacy: Adequacy | None = None
    parameters: list[FreeParameter]
    correlation: list[list[float]]
    noise: Noise
    trials: list[TrialInfluence]
    notes: list[str]
    spread: Spread
    bootstrap: Bootstrap | None
    evaluations: int
    seconds: float


class Judgement(TrustPart):
    """Predictions over all trials: flagged where they are off by more than a limit, and why."""

    flagged: bool
    reasons: list[str]
    limits: dict[str, float]
    nrmse: float
    nrmse_fitted: float
    ratio: float
    ratio_third_contact: float


class ValidationDocument(Judgement):
    """``validation-CAMPAIGN.json``: trials that were not fitted."""

    trials: list[ValidatedTrial]


class CrossValidationDocument(Judgement):
    """``cross-validation.json``: every fitted trial, predicted by the fit of the others."""

    trials: list[LeftOutTrial]


class LadderRung(Part):
    """A fit with some terms: their titles, the value of every free parameter, and how well it predicts.

    ``over_noise`` is NRMSE over what noise alone costs [1], ``left_out`` the same of each trial as the fit of
    the others predicts it, ``misfit`` its residual over noise there, root mean square over the channels, by
    which terms are judged. ``gain`` is the mean logarithm of what the last term takes off ``misfit``;
    ``chance`` the probability that it is luck, or of a term that is kept beside others that its value is none
    (Wald), for all terms looked at; NaN of the base. ``kept``: the last term is among those to keep.
    """

    terms: list[str]
    values: dict[str, float]
    nrmse: float
    over_noise: float
    left_out: list[float]
    misfit: list[float]
    gain: float
    chance: float
    kept: bool


class LadderDocument(TrustPart):
    """``ladder.json``: the fit, each term of its kind added alone, then those to keep together.

    ``simpler`` are models that lack something, by their title in ``terms``: their ``gain`` and ``chance`` are
    of the fit's model over them, ``kept`` says that what they lack is needed. ``trials`` names what was left
    out in turn: the trials, or ``parts`` of them. ``symbols`` and ``units`` are of all parameters that a rung
    has, ``keep`` the titles and ``parameters`` the names of the terms to keep; ``together`` is the nearest
    one where there is none. ``adequacy`` is of the model with what to keep.
    """

    trials: list[str]
    parts: bool
    symbols: dict[str, str]
    units: dict[str, str]
    adequacy: Adequacy
    base: LadderRung
    alone: list[LadderRung]
    together: list[LadderRung]
    simpler: list[LadderRung] = Field(default_factory=list)
    keep: list[str]
    parameters: list[str]
    evaluations: int
    seconds: float


class Expected(Part):
    """What the trials of a campaign are expected to determine of a parameter, before a fit.

    ``half_width`` is the relative 95 % half-width at ``value``, ``half_width_over_bounds`` the median over
    points drawn from the bounds [1]; ``verdict`` is on the worse of both. ``effect`` and ``interaction`` are
    mean size and standard deviation of the elementary effects on the NRMSE over the bounds (Morris 1991) [1].
    NaN where not computed.
    """

    name: str
    symbol: str
    unit: str
    value: float
    half_width: float
    half_width_over_bounds: float
    effect: float
    interaction: float
    partners: list[Partner]
    verdict: str

    @property
    def worse(self) -> float:
        """The larger of both half-widths [1]."""
        return max(self.half_width, self.half_width_over_bounds, key=lambda w: -1.0 if w != w else w)


class ExpectedParameter(Expected):
    """The same in a check. ``channels``: share of what is known that comes from each channel [1]."""

    channels: dict[str, float]


class CandidateRecording(Part):
    """A recording that could be made next: what it leaves open of each parameter, as `Expected` states it."""

    title: str
    gain: float
    half_widths: dict[str, float]
    half_widths_over_bounds: dict[str, float]
    verdicts: dict[str, str]


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
    seconds: float


_NAMED: dict[str, type[TrustPart]] = {
    TRUST: TrustDocument, CROSS_VALIDATION: CrossValidationDocument, LADDER: LadderDocument,
}  # fmt: skip
ARRAYS = FileKind("sysid-trust", 1, "the arrays of a trust document", "run it again", FitError)


def model_of(part: str) -> type[TrustPart]:
    """Return the model of a document."""
    return _NAMED.get(part, ValidationDocument)


def write_part(
    folder: Path,
    part: str,
    document: Mapping[str, Any],
    arrays: Mapping[str, tuple[Any, str, str]],
    *,
    fit: str,
    kind: str,
    beside: Mapping[str, bytes] | None = None,
) -> Path:
    """Write one document and its arrays into a fit folder, in place of an earlier one.

    `part` is ``trust``, ``cross-validation`` or ``validation-CAMPAIGN``. `document` has what `model_of` the
    part adds to `TrustPart`, and campaign and warnings; `arrays` are (values, axes, unit) by path in
    the HDF5 file. `fit` is the fit's name; `beside` are further files of the folder that change with it, by
    name. Raises FitError, with nothing changed, when it cannot be written.
    """
    text = model_of(part)(
        part=part, fit=fit, kind=kind, fit_sha256=file_sha256(folder / "fit.h5"),
        written=datetime.now(UTC).isoformat(timespec="seconds"), **document,
    ).text()  # fmt: skip

    def write(file: Any) -> None:
        file.attrs["part"] = part
        for path, (values, axes, unit) in arrays.items():
            put(file, path, values, axes, unit)

    target = folder / f"{part}.json"
    # The arrays first: without the document, which names them, they count as not there.
    files = {folder / f"{part}.h5": ARRAYS.content(write), target: text.encode("utf-8")}
    write_files(files | {folder / name: data for name, data in (beside or {}).items()}, FitError)
    return target


def read_part(folder: Path, part: str) -> dict[str, Any] | None:
    """Return a document of a fit folder; None where there is none, or where the fit has changed since.

    Raises FitError when it is damaged or of another version.
    """
    path = folder / f"{part}.json"
    if not path.is_file():
        return None
    try:
        text = path.read_bytes()
    except OSError as error:
        raise FitError(f"{path}: cannot be read ({error}); run it again") from error
    document = model_of(part).parse(text, path, FitError)
    return document.model_dump() if document.fit_sha256 == file_sha256(folder / "fit.h5") else None


def read_arrays(folder: Path, part: str) -> dict[str, Any]:
    """Return the arrays of a document by their path in the HDF5 file; FitError when it cannot be read."""
    with ARRAYS.opened(folder / f"{part}.h5") as file:
        return datasets(file)


def parts(folder: Path) -> tuple[str, ...]:
    """Return the documents in a fit folder, whether or not the fit has changed since."""
    stems = sorted(path.stem for path in folder.glob("*.json") if (folder / f"{path.stem}.h5").is_file())
    return tuple(name for name in stems if name in _NAMED or name.startswith(VALIDATION))


def with_intervals(sets: Sets, folder: Path) -> Sets:
    """Return the sets of a fit folder; settings state interval and verdict where the fit was assessed."""
    document = read_part(folder, TRUST) if folder.is_dir() else None
    return sets if document is None else stating_intervals(sets, document)


def stating_intervals(sets: Sets, document: Mapping[str, Any]) -> Sets:
    """Return sets whose settings state interval and verdict of a document, and which give its warnings."""
    keys = ("interval_95", "open_95", "verdict", "doubt")
    rows = {row["name"]: {key: row[key] for key in keys} for row in document["parameters"]}
    return replace(
        sets,
        settings={**sets.settings, INTERVALS: {**sets.settings.get(INTERVALS, {}), **rows}},
        warnings=tuple(dict.fromkeys((*sets.warnings, *document["warnings"]))),
    )


def free_part(folder: Path, part: str, campaign: Mapping[str, str]) -> str:
    """Return the name under which a validation replaces an earlier one of its campaign, and no other.

    `part` is the `validation_part` of the campaign's name, `campaign` what the document states of its file.
    Equal places (the file was edited) or equal contents (it was moved) mean the same campaign. The name for
    another campaign ends in part of its hash.
    """
    there = {}
    for name in parts(folder):
        if re.fullmatch(re.escape(part) + "(-[0-9a-f]{8})?", name):
            with suppress(FitError):
                if document := read_part(folder, name):
                    there[name] = document["campaign"]
    for key in ("from_fit_folder", "sha256"):
        same = [name for name, stated in there.items() if stated.get(key, "") == campaign.get(key)]
        if same:
            return same[0]
    return part if part not in there else f"{part}-{campaign['sha256'][:8]}"


def validation_part(campaign: str) -> str:
    """Return the name of a campaign's validation; characters that a file name cannot have become hyphens."""
    return VALIDATION + re.sub(r"[^A-Za-z0-9._-]", "-", campaign)
