"""Documents of trust as tables, and on a terminal: checks, intervals, validations, comparisons of fits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.documents import channel_symbol, interval, rounded
from sysid.fit.store import fit_folder
from sysid.parameter_sets import Judged, Known, ParameterSets
from sysid.report.fold import print_lines, print_result, print_table
from sysid.report.set_tables import INTERVAL, PARAMETER
from sysid.report.table import (
    NONE,
    Cell,
    Table,
    TableColumn,
    Tone,
    half_width,
    listed,
    mean_sigma,
    name_and_unit,
    number,
    numbers,
    percent,
    table,
    words,
)
from sysid.trust.documents import (
    CheckDocument,
    CrossValidationDocument,
    Expected,
    FreeParameter,
    JudgedTrial,
    Partner,
    SpreadOfTrial,
    StatedValue,
    TrustDocument,
    ValidationDocument,
)
from sysid.trust.use import ClassOfUse, NumberOfUse
from sysid.trust.verdicts import sentences

if TYPE_CHECKING:
    from sysid.trust.comparison import Comparison, Difference

# Units of the entries of an excitation by name; an entry without a unit is a number of events.
_UNITS = {"slope_deg": "deg", "impact_speed": "m/s", "pitch_rate": "rad/s", "speed": "rad/s",
          "command": "of full"}  # fmt: skip
# Least share of the information on a parameter that a named channel has [1].
_TELLS = 0.2
TONES: dict[str, Tone] = {"well": "good", "weakly": "doubtful"}
AT_BOUND = "* the best set ends at a bound of the search"
_USE_NOTE = (
    "places down-slope and times since the first touchdown; a foot touches where it would with its leg "
    "unloaded; bands hold errors of start, stated values and capture as well"
)
_OPEN = "≤ or ≥: open, the data do not end the interval inside the bounds of the search"


def judged_cell(row: Judged) -> Cell:
    """Return a verdict in its colour."""
    return Cell(row.words, TONES.get(row.verdict, "bad"))


def ends_of(ends: Sequence[float] | None) -> str:
    """Return ``low to high``, one value where both are the same, or a dash."""
    return NONE if ends is None else " to ".join(dict.fromkeys(map(rounded, ends)))


_PARAMETER = words("parameter", lambda row: name_and_unit(row.symbol, row.unit))
_VERDICT = words("verdict", lambda row: Cell(row.verdict.replace("_", " "), TONES.get(row.verdict, "bad")))
_TRIAL, _USE = words("trial", attrgetter("name")), words("use", attrgetter("use"))


def partners_of(strongest: Sequence[Partner], symbols: Mapping[str, str]) -> str:
    """Return the two parameters that one correlates with most, by symbol, and the correlations."""
    pairs = (f"{symbols.get(each.name, each.name)} {each.correlation:+.2f}" for each in strongest[:2])
    return ", ".join(pairs) or NONE


def _correlated(rows: Iterable[FreeParameter | Expected | StatedValue]) -> TableColumn:
    """Return the column of the correlated among some parameters, by symbol."""
    symbols = {row.name: row.symbol for row in rows}
    return words("correlates with", lambda row: partners_of(row.partners, symbols))


def answer_table(sets: ParameterSets) -> Table:
    """Return what a fit found: best set, 95 % interval and verdict of every parameter."""
    rows = [row for row in sets.known.values() if row.found]
    return table(
        "",
        rows,
        (
            PARAMETER,
            numbers("best set", Known.text),
            INTERVAL,
            words("verdict", lambda row: judged_cell(row.judged) if row.judged else NONE),
        ),
        AT_BOUND if any("*" in row.text() for row in rows) else "",
    )


def interval_table(document: TrustDocument) -> Table:
    """Return Table II with what the data leave open: best set, interval, verdict."""
    rows = document.parameters

    def best(row: FreeParameter) -> str:
        return NONE if row.lost else rounded(row.value) + ("*" if row.at_bound else "")

    notes = [_OPEN] if any(row.interval.startswith(("≤", "≥")) for row in rows) else []
    notes += [AT_BOUND] if any("*" in best(row) for row in rows) else []
    return table(
        "what the data determine: intervals of the profile likelihood",
        rows,
        (
            _PARAMETER,
            numbers("best set", best),
            numbers("95 % interval", attrgetter("interval")),
            numbers("half-width", lambda row: half_width(row.half_width), "%"),
            _VERDICT,
            _correlated([*rows, *document.stated]),
            numbers("bootstrap 95 %", lambda row: ends_of(row.bootstrap_95))
            if any(row.bootstrap_95 for row in rows)
            else None,
            numbers("measured", lambda row: ends_of(row.measured))
            if any(row.measured for row in rows)
            else None,
        ),
        "; ".join(notes),
    )


def stated_table(document: TrustDocument) -> Table | None:
    """Return the values that the campaign states with errors, as stated and as fitted."""
    if not document.stated:
        return None

    def shown(row: StatedValue, value: float, error: float) -> str:
        factor = math.degrees(1.0) if row.unit == "rad" else 1.0
        return mean_sigma((factor * value, factor * error))

    names = " ".join(row.name for row in document.stated)
    notes = ["error: one standard deviation; errors apart: fitted less stated, in stated errors"]
    if "surface_d" in names or "centre_of_mass_d" in names:
        notes.append("dx and dz of surface and centre of mass: distance from the stated place")
    if "_curve_" in names or "_line_" in names:
        notes.append(
            "torque_curve, no_load_line: factor on the measured curve, at full speed or command (top) and "
            "half-way (middle), with the error that the scatter of its points gives"
        )
    if "load_cell" in names:
        notes.append("load_cell_factor: true torque over the measured one, of static logs and of trials")
    return table(
        "what the campaign states, and what the fit made of it",
        document.stated,
        (
            words("value", lambda row: name_and_unit(row.name, "deg" if row.unit == "rad" else row.unit)),
            numbers("stated ± error", lambda row: shown(row, row.stated, row.error)),
            numbers("fitted ± error", lambda row: shown(row, row.fitted, row.sigma)),
            words("errors apart", lambda r: Cell(f"{r.pull:+.1f}", "bad" if r.contradicted else "")),
        ),
        "; ".join(notes),
    )


def narrow_table(document: TrustDocument) -> Table:
    """Return the 68 % intervals, the linearized deviation, and why an interval is doubtful."""

    def narrow(row: FreeParameter) -> str:
        return interval(row.interval_68, row.open_68)

    return table(
        "68 % intervals",
        document.parameters,
        (
            _PARAMETER,
            numbers("refined", lambda row: NONE if row.lost else number(row.refined)),
            numbers("68 % interval", narrow),
            numbers("linearized σ", lambda row: NONE if row.lost else number(row.fisher_sigma, 2)),
            words("why doubtful", lambda row: row.doubt or NONE),
        ),
        _OPEN if any(narrow(row).startswith(("≤", "≥")) for row in document.parameters) else "",
    )


def spread_table(document: TrustDocument) -> Table:
    """Return the distance of the sets' predictions from their mean per trial and channel: rms, largest."""
    spread = document.spread

    def pair(c: int, row: SpreadOfTrial) -> str:
        return f"{number(row.rms[c], 2)}, {number(row.largest[c], 2)}"

    channels = enumerate(zip(spread.channels, spread.units, strict=True))
    return table(
        "predictions of the sets around their mean",
        spread.trials,
        (_TRIAL, _USE, *(numbers(name, partial(pair, c), unit) for c, (name, unit) in channels)),
        "rms, largest",
    )


def noise_table(document: TrustDocument) -> Table:
    """Return the residuals per channel, the noise floor and the number of independent samples."""
    return table(
        "residuals, with errors of the measured inputs",
        document.noise.channels,
        (
            words("channel", lambda row: channel_symbol(row.name)),
            words("unit", attrgetter("unit")),
            numbers("rms residual", lambda row: number(row.residual, 3)),
            numbers("noise floor", lambda row: number(row.floor, 3)),
            numbers("ratio", lambda row: number(row.residual / (row.floor or math.nan), 3)),
            numbers("samples", lambda row: str(row.samples)),
            numbers("independent", lambda row: f"{row.independent_samples:.0f}"),
        ),
        "the verdict on a fit leaves out what errors of the measured inputs explain",
    )


def expected_table(document: CheckDocument, *, details: bool = True) -> Table:
    """Return the verdicts of a check, before a fit."""
    return table(
        f"{document.campaign['name']}: what these trials are expected to determine",
        document.parameters,
        (
            _PARAMETER,
            numbers("default value", lambda row: number(row.value)) if details else None,
            numbers("95 % half-width", lambda row: half_width(row.half_width), "%"),
            numbers("at other values", lambda row: half_width(row.half_width_over_bounds), "%"),
            _VERDICT,
            _correlated(document.parameters) if details else None,
        ),
        "from noise alone, at the default values; at other values: the median over points within the bounds",
    )


def quality_table(document: CheckDocument) -> Table:
    """Return what the logs of a campaign look like, a row each."""

    def noise(row: Mapping[str, Any]) -> str:
        return f"{1000 * row['noise']['x']:.2f}, {1000 * row['noise']['z']:.2f}"

    columns = [
        words("trial", itemgetter("name")),
        words("use", itemgetter("use")),
        numbers("rate", lambda row: number(row["rate"]), "Hz"),
        numbers("jitter", lambda row: percent(row["jitter"], 1), "%"),
        numbers("holes", lambda row: str(row["holes"])),
    ]
    if any("impact_speed" in row for row in document.quality):
        columns += [
            numbers("lost", lambda row: str(row["lost_in_window"])),
            numbers("noise x, z", noise, "mm"),
            numbers("pitch", lambda row: f"{math.degrees(row['noise']['pitch']):.2f}", "deg"),
            numbers("fall g", lambda row: mean_sigma((row["gravity"], row["gravity_error"])), "m/s²"),
            numbers("slope", lambda row: number(row["slope_deg"], 3), "deg"),
            numbers("impact", lambda row: number(row["impact_speed"], 3), "m/s"),
            numbers("out of plane", lambda row: number(row["out_of_plane_deg"], 2), "deg"),
        ]
    else:
        columns.append(numbers("at its limit", lambda row: percent(row["saturated"], 1), "%"))
    return table(f"{document.campaign['name']}: logs", document.quality, columns)


def validation_table(name: str, document: ValidationDocument | CrossValidationDocument) -> Table:
    """Return the score of a validation or cross-validation, a row per trial.

    It compares the NRMSE of the best set with what noise alone explains, also up to the third contact.
    """
    rows: Sequence[JudgedTrial] = document.trials
    early = any(row.nrmse_third_contact is not None for row in rows)
    # A cross-validation keeps no samples of the trial that it leaves out.
    leaving = isinstance(document, ValidationDocument)

    def leaves(row: JudgedTrial) -> str:
        place = row.leaves
        return f"{place.time:.3f} ({channel_symbol(place.channel)})" if place else "never"

    third = (
        numbers("to 3rd touchdown", lambda row: percent(row.nrmse_third_contact), "%"),
        numbers("its ratio", lambda row: number(row.ratio_third_contact, 3), joined=True),
    )
    notes = ["off from: when the prediction is first off by more than noise"] if leaving else []
    flag = "flagged" if document.flagged else "not flagged"
    return table(
        f"prediction of trials that were not fitted, {name}: {flag}",
        rows,
        (
            _TRIAL,
            numbers("NRMSE", lambda row: percent(row.nrmse[0]), "%"),
            numbers("noise alone", lambda row: percent(row.floor), "%", joined=True),
            numbers("ratio", lambda row: number(row.ratio, 3), joined=True),
            *(third if early else ()),
            numbers("off from", leaves, "s") if leaving else None,
        ),
        "; ".join(notes),
    )


def use_tables(document: ValidationDocument | CrossValidationDocument) -> list[Table]:
    """Return what of use is predicted, number by number and in total; none where nothing is."""
    if document.use is None or not document.use.count + document.use.classes:
        return []
    rows: list[tuple[str, NumberOfUse | ClassOfUse]]
    rows = [(trial.name, each) for trial in document.trials for each in trial.numbers]
    rows += [(trial.name, trial.ends) for trial in document.trials if trial.ends is not None]

    def band(row: tuple[str, NumberOfUse | ClassOfUse]) -> str | Cell:
        each = row[1]
        if isinstance(each, ClassOfUse):
            return f"{100 * each.share:.0f} % of draws so"
        text = f"{number(each.low)} to {number(each.high)}"
        return text if each.held else Cell(f"{text}, not held", "doubtful")

    def shown(row: tuple[str, NumberOfUse | ClassOfUse], which: str) -> str:
        value = getattr(row[1], which)
        return value if isinstance(value, str) else number(value, 4)

    single = table(
        "numbers of use, predicted",
        rows,
        (
            words("trial", itemgetter(0)),
            words("what", lambda row: getattr(row[1], "what", "end of the landing")),
            words("unit", lambda row: getattr(row[1], "unit", "")),
            numbers("measured", lambda row: shown(row, "measured")),
            numbers("predicted", lambda row: shown(row, "predicted")),
            numbers("95 % of draws", band),
        ),
        _USE_NOTE,
    )
    total = table(
        "numbers of use, in total",
        document.use.widths,
        (
            words("what", attrgetter("what")),
            words("unit", attrgetter("unit")),
            numbers("off by", lambda row: rounded(row.error, 2)),
            numbers("95 % half-width", lambda row: rounded(row.half_width, 2)),
            words("held", lambda row: f"{row.held} of {row.count}"),
        ),
        "medians over the trials",
    )
    return [single, total]


def known_table(document: Comparison) -> Table | None:
    """Return the known values that differ between fits, as each campaign states them; None: none."""
    rows = [("law", *document.laws)] if document.laws else []
    for row in document.known:
        shown = ("free" if value is None else rounded(value) for value in row.values)
        rows.append((name_and_unit(row.parameter.replace("_", " "), row.unit), *shown))
    return listed("known values that differ", rows, ("known value", *document.fits)) if rows else None


def comparison_table(document: Comparison) -> Table:
    """Return which parameters differ between fits by more than their intervals allow."""

    def allowed(row: Difference) -> str:
        share = row.allowed / abs(row.values[0]) if row.values[0] else math.nan
        return f"± {percent(share, 1)}" if judged(row) else "open"

    def judged(row: Difference) -> bool:
        return math.isfinite(row.allowed)

    ends = all(map(judged, document.differences))
    differs = {True: Cell("yes", "bad"), False: Cell("no"), None: Cell("not known")}
    # What is alike in every row is said once.
    pairs, ways = {tuple(row.fits) for row in document.differences}, {row.by for row in document.differences}
    return table(
        f"differences between {' and '.join(*pairs) if len(pairs) == 1 else 'the fits'}",
        document.differences,
        (
            _PARAMETER,
            words("fits", lambda row: " / ".join(row.fits)) if len(pairs) > 1 else None,
            numbers("values", lambda row: " / ".join(map(number, row.values)) if judged(row) else NONE),
            numbers("difference", lambda row: percent(row.difference, 1) if judged(row) else NONE, "%"),
            numbers("allowed", allowed, "%"),
            words("by", attrgetter("by")) if len(ways) > 1 else None,
            words("real", lambda row: differs[row.differs]),
        ),
        "values: minima of the profiles (best sets where there are none); allowed: 95 % of the difference"
        f"{f', by {ways.pop()}' if len(ways) == 1 else ''}; "
        "real: larger than allowed" + ("" if ends else "; open: an interval has no end"),
    )


def cross_table(document: Comparison) -> Table:
    """Return the NRMSE of every fit's best set on every fit's trials."""
    return listed(
        "NRMSE [%] of the best set of a fit (row) on the fitted trials of another (column)",
        [(n, *map(percent, scores)) for n, scores in zip(document.fits, document.cross or (), strict=True)],
        ("best set of", *document.fits),
        "each trial is simulated with the set's fitted values; the others are those that the trial's own "
        "campaign states, or else those of the set's fit; every log keeps its clock offset",
    )


def print_check(document: CheckDocument, json: bool, *, details: bool = False) -> None:
    """Print a check: what the trials excite and determine, and what to record next."""
    if print_result(document.model_dump(exclude_unset=True), json):
        return
    rows, said = document.quality, set(sentences(document.parameters) if document.parameters else ())
    if details:
        print_table(quality_table(document))
        print_lines(check_lines(document))
    for row in rows:
        print_lines([f"{row['name']}: suspicious: {finding}" for finding in row["suspicions"]], "bold yellow")
    covered = excitation_line(document)
    print_lines([f"{document.campaign['name']}, {len(rows)} logs{f': {covered}' if covered else ''}"])
    if document.parameters:
        print_table(expected_table(document, details=details))
    if details:
        print_lines([channel_line(document)])
    # Sentences on single parameters repeat the table.
    print_lines([sentence for sentence in document.sentences if details or sentence not in said])
    if warnings := len(document.warnings):
        print_lines([f"{warnings} warning{'' if warnings == 1 else 's'} above"], "bold yellow")


def check_lines(document: CheckDocument) -> list[str]:
    """Return what the logs' table has no column for: instants, clocks, centre of mass."""
    rows, out = document.quality, []
    instants = [f"{r['name']} {r['release']:.3f} / {r['touchdown']:.3f}" for r in rows if "release" in r]
    if instants:
        out.append(f"start of the fall / touchdown on the log's clock [s]: {', '.join(instants)}")
    for row in rows:
        if second := row.get("second_log"):
            out.append(
                f"{row['name']}: second log {second['log']}: clock offset {second['offset']:.4g} s, "
                f"confidence {second['confidence']:.4g}"
            )
    mass = document.centre_of_mass
    if mass is not None:
        pairs = [
            f"{1e3 * mass[key]:.1f} ± {1e3 * mass[f'{key}_error']:.1f} mm {word}"
            for key, word in (("down_slope", "down-slope"), ("up", "up"))
        ]
        out.append(f"centre of mass off the stated one, from the turns in flight: {', '.join(pairs)}")
    return out


def excitation_line(document: CheckDocument) -> str:
    """Return the ranges that the trials cover; empty where the kind names none."""
    spans = []
    for name, value in document.excitation.items():
        word, unit = name.removesuffix("_deg").replace("_", " "), _UNITS.get(name, "")
        ends = f"{value[0]:.3g} to {value[1]:.3g}" if isinstance(value, list) else f"{value}"
        spans.append(f"{word} {ends} {unit}".rstrip())
    return ", ".join(spans)


def channel_line(document: CheckDocument) -> str:
    """Return which channels inform each parameter, the most informative one first."""
    parts = []
    for row in document.parameters:
        order = sorted(row.channels.items(), key=lambda pair: -pair[1])
        shares = [f"{channel_symbol(name)} {100 * share:.0f} %" for name, share in order if share >= _TELLS]
        # The first of many channels that inform a little each is named without its share.
        first = [channel_symbol(name) for name, share in order[:1] if share > 0]
        parts.append(f"{row.symbol}: {', '.join(shares or first) or 'nothing'}")
    return f"channels that determine each parameter most: {'; '.join(parts)}"


def print_trust(document: TrustDocument, folder: Path, json: bool, *, long: bool = False) -> None:
    """Print the intervals and verdicts of a fit, and where they are stored."""
    if print_result(document.printed(), json):
        return
    folder = fit_folder(folder)
    print_lines([f"{folder.name}:"])
    wide = [narrow_table(document), spread_table(document)] if long else []
    for part in (interval_table(document), stated_table(document), *wide, noise_table(document)):
        if part is not None:
            print_table(part)
    scores = ", ".join(f"{trial.name} {trial.ratio:.2f}" for trial in document.trials)
    print_lines(
        [f"residual over noise by trial, with errors of the measured inputs: {scores}", *document.notes]
    )
    print_lines([f"written to {folder / 'trust.json'} and .h5 in {document.seconds:.0f} s"])


def print_validation(
    document: ValidationDocument | CrossValidationDocument, folder: Path, json: bool
) -> None:
    """Print a validation or cross-validation."""
    if print_result(document.printed(), json):
        return
    print_table(validation_table(fit_folder(folder).name, document))
    for part in use_tables(document)[-1:]:
        print_table(part)
    if document.use is not None and document.use.sentence:
        print_lines([document.use.sentence])
    worst = max(document.trials, key=lambda trial: trial.ratio)
    mean = f"mean over {len(document.trials)} trials {document.ratio:.2f} × noise alone"
    print_lines(document.reasons or [f"not flagged: {mean} (worst {worst.name}: {worst.ratio:.2f} ×)"])
