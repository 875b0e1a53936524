"""Documents of trust as tables, and on a terminal: checks, intervals, validations, comparisons of fits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

from sysid.documents import channel_symbol, interval, rounded
from sysid.parameter_sets import ParameterSets
from sysid.report.fold import print_lines, print_result, print_table
from sysid.report.set_tables import mean_sigma_table
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

Row = Mapping[str, Any]

# Units of what excites a model; the other entries count.
_UNITS = {"slope_deg": "deg", "impact_speed": "m/s", "pitch_rate": "rad/s", "speed": "rad/s",
          "command": "of full"}  # fmt: skip
# A channel with a smaller share of the information on a parameter is not named.
_TELLS = 0.2
TONES: dict[str, Tone] = {"well": "good", "weakly": "doubtful"}
_VERDICTS = {"well": "well identifiable", "weakly": "weakly identifiable"}
_OPEN = "≤ or ≥: open, the data do not end the interval inside the bounds of the search"


def _open_note(rows: Sequence[Row], level: int) -> list[str]:
    """Return the note that explains ≤ and ≥ if an interval shows either."""
    shown = any(interval(row, level).startswith(("≤", "≥")) for row in rows)
    return [_OPEN] if shown else []


def verdict_words(verdict: str) -> str:
    """Return a verdict of `sysid.trust.verdicts` as it reads after a parameter."""
    return _VERDICTS.get(verdict, verdict.replace("_", " "))


def ends_of(ends: Sequence[float] | None) -> str:
    """Return ``low to high``, one value where both are the same, or a dash."""
    return NONE if ends is None else " to ".join(dict.fromkeys(map(rounded, ends)))


def _name(header: str, key: str = "name") -> TableColumn:
    return words(header, itemgetter(key))


_PARAMETER = words("parameter", lambda row: name_and_unit(row["symbol"], row["unit"]))
_VERDICT = words(
    "verdict", lambda row: Cell(row["verdict"].replace("_", " "), TONES.get(row["verdict"], "bad"))
)


def partners(row: Row, symbols: Mapping[str, str]) -> str:
    """Return the two parameters that one trades with most, by symbol, and the correlations."""
    strongest = row.get("partners", ())[:2]
    names = [symbols.get(partner["name"], partner["name"]) for partner in strongest]
    pairs = zip(names, strongest, strict=True)
    return ", ".join(f"{name} {partner['correlation']:+.2f}" for name, partner in pairs) or NONE


def _trades(rows: Sequence[Row]) -> TableColumn:
    """Return the column of partners, by symbol."""
    return words("trades with", partial(partners, symbols={row["name"]: row["symbol"] for row in rows}))


def _lost(row: Row) -> bool:
    """Return whether digits of a parameter mean nothing."""
    return bool(row["verdict"].startswith("not_"))


def interval_table(document: Row) -> Table:
    """Return Table II with what the data leave open: value, mean ± σ of the sets, interval, verdict."""
    rows = document["parameters"]
    drawn, measured = (any(row.get(key) for row in rows) for key in ("bootstrap_95", "measured"))

    def best(row: Row) -> str:
        return NONE if _lost(row) else rounded(row["value"]) + ("*" if row.get("at_bound") else "")

    def spread(row: Row) -> tuple[float, float]:
        return row["mean"], row["sigma"]

    marked = any("*" in best(row) for row in rows)
    at_bound = ["* the best set ends at a bound"] if marked else []
    return table(
        "what the data determine: intervals of the profile likelihood",
        rows,
        (
            _PARAMETER,
            numbers("best set", best),
            numbers("mean ± σ of the sets", lambda row: mean_sigma(None if _lost(row) else spread(row))),
            numbers("95 % interval", lambda row: interval(row, 95)),
            numbers("half-width", lambda row: half_width(row["half_width"]), "%"),
            _VERDICT,
            _trades(rows),
            numbers("bootstrap 95 %", lambda row: ends_of(row["bootstrap_95"])) if drawn else None,
            numbers("measured", lambda row: ends_of(row["measured"])) if measured else None,
        ),
        "; ".join([*_open_note(rows, 95), *at_bound]),
    )


def narrow_table(document: Row) -> Table:
    """Return the 68 % intervals, the linearized deviation, and why an interval is doubtful."""
    return table(
        "68 % intervals",
        document["parameters"],
        (
            _PARAMETER,
            numbers("refined", lambda row: NONE if _lost(row) else number(row["refined"])),
            numbers("68 % interval", lambda row: interval(row, 68)),
            numbers("linearized σ", lambda row: NONE if _lost(row) else number(row["fisher_sigma"], 2)),
            words("doubt", lambda row: row["doubt"] or NONE),
        ),
        "".join(_open_note(document["parameters"], 68)),
    )


def spread_table(document: Row) -> Table:
    """Return the distance of the sets' predictions from their mean per trial and channel: rms, largest."""
    spread = document["spread"]

    def pair(c: int, row: Row) -> str:
        return ", ".join(number(float(row[which][c]), 2) for which in ("rms", "largest"))

    channels = enumerate(zip(spread["channels"], spread["units"], strict=True))
    return table(
        "predictions of the sets around their mean",
        spread["trials"],
        (
            _name("trial"),
            _name("use", "use"),
            *(numbers(name, partial(pair, c), unit) for c, (name, unit) in channels),
        ),
        "rms, largest",
    )


def noise_table(document: Row) -> Table:
    """Return the residuals per channel, the noise floor and the number of independent samples."""
    return table(
        "residuals, with errors of known values",
        document["noise"]["channels"],
        (
            words("channel", lambda row: channel_symbol(row["name"])),
            _name("unit", "unit"),
            numbers("rms residual", lambda row: number(row["residual"], 3)),
            numbers("noise floor", lambda row: number(row["floor"], 3)),
            numbers("ratio", lambda row: number(row["residual"] / (row["floor"] or math.nan), 3)),
            numbers("samples", lambda row: str(row["samples"])),
            numbers("independent", lambda row: f"{row['independent_samples']:.0f}"),
        ),
        "the adequacy of the fit leaves out what errors of known values explain",
    )


def expected_table(document: Row) -> Table:
    """Return the verdicts of a check, before a fit."""
    return table(
        f"{document['campaign']['name']}: what these trials are expected to determine",
        document["parameters"],
        (
            _PARAMETER,
            numbers("at", lambda row: number(row["value"])),
            numbers("half-width", lambda row: half_width(row["half_width"]), "%"),
            numbers("over bounds", lambda row: half_width(row["half_width_over_bounds"]), "%"),
            numbers("effect", lambda row: mean_sigma((row["effect"], row["interaction"]))),
            _VERDICT,
            _trades(document["parameters"]),
        ),
        "half-width: 95 %, from noise alone, at the defaults and (median) over the bounds; effect: mean size "
        "of the elementary effects on the NRMSE over the bounds (Morris), ± its standard deviation",
    )


def quality_table(document: Row) -> Table:
    """Return what the logs of a campaign look like, a row each."""

    def noise(row: Row) -> str:
        return f"{1000 * row['noise']['x']:.2f}, {1000 * row['noise']['z']:.2f}"

    columns = [
        _name("trial"),
        _name("use", "use"),
        numbers("rate", lambda row: number(row["rate"]), "Hz"),
        numbers("jitter", lambda row: percent(row["jitter"], 1), "%"),
        numbers("holes", lambda row: str(row["holes"])),
    ]
    if any("impact_speed" in row for row in document["quality"]):
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
    return table(f"{document['campaign']['name']}: logs", document["quality"], columns)


def validation_table(name: str, document: Row) -> Table:
    """Return the score of a validation or cross-validation, a row per trial.

    It compares the NRMSE of the best set with what noise alone explains, also up to the third contact.
    """
    rows = document["trials"]
    early = any(row.get("nrmse_third_contact") is not None for row in rows)
    # A cross-validation keeps no samples of the trial that it leaves out.
    leaving = not any("refit" in row for row in rows)
    stops = any(row.get("stop") for row in rows)

    def leaves(row: Row) -> str:
        place = row.get("leaves")
        return "never" if not place else f"{place['time']:.3f} ({channel_symbol(place['channel'])})"

    def stopping(what: str, unit: str) -> tuple[TableColumn, ...]:
        def measured(row: Row) -> str:
            return number(row["stop"][what]["measured"], 3) if row.get("stop") else NONE

        def predicted(row: Row) -> str:
            place = row["stop"][what] if row.get("stop") else {}
            return mean_sigma((place["mean"], place["sigma"])) if place else NONE

        return numbers(f"stop {what}, measured", measured, unit), numbers(
            f"stop {what}, predicted ± spread", predicted, unit, joined=True
        )

    third = (
        numbers("to 3rd contact", lambda row: percent(row.get("nrmse_third_contact")), "%"),
        numbers("ratio there", lambda row: number(row.get("ratio_third_contact"), 3), joined=True),
    )
    flag = "flagged" if document.get("flagged") else "not flagged"
    return table(
        f"prediction of trials that were not fitted, {name}: {flag}",
        rows,
        (
            _name("trial"),
            numbers("NRMSE", lambda row: percent(row["nrmse"][0]), "%"),
            numbers("noise alone", lambda row: percent(row.get("floor")), "%", joined=True),
            numbers("ratio", lambda row: number(row.get("ratio"), 3), joined=True),
            *(third if early else ()),
            numbers("leaves the noise at", leaves, "s") if leaving else None,
            *(stopping("place", "m") + stopping("time", "s") if stops else ()),
        ),
        "stop: where (down-slope) and when the body comes to rest, else its log or board ends, since the "
        "first touchdown; spread: standard deviation over the sets and the uncertainty of the start, without "
        "what the model lacks; the NRMSE alone is flagged"
        if stops
        else "",
    )


def comparison_table(document: Row) -> Table:
    """Return which parameters differ between fits by more than their intervals allow."""

    def allowed(row: Row) -> str:
        share = row["allowed"] / abs(row["values"][0]) if row["values"][0] else math.nan
        return f"± {percent(share, 1)}" if judged(row) else "open"

    def judged(row: Row) -> bool:
        return math.isfinite(row["allowed"])

    ends = all(map(judged, document["differences"]))
    differs = {True: Cell("yes", "bad"), False: Cell("no"), None: Cell("not known")}
    return table(
        "differences between the fits",
        document["differences"],
        (
            _PARAMETER,
            words("fits", lambda row: " / ".join(row["fits"])),
            numbers("values", lambda row: " / ".join(map(number, row["values"])) if judged(row) else NONE),
            numbers("difference", lambda row: percent(row["difference"], 1) if judged(row) else NONE, "%"),
            numbers("allowed", allowed, "%"),
            _name("by", "by"),
            words("real", lambda row: differs[row["differs"]]),
        ),
        "values: minima of the profiles (best sets where there are none); allowed: 95 % of the difference; "
        "real: larger than allowed" + ("" if ends else "; open: an interval has no end"),
    )


def cross_table(document: Row) -> Table:
    """Return the NRMSE of every fit's best set on every fit's trials."""
    return listed(
        "NRMSE [%] of the best set of a fit (row) on the fitted trials of another (column)",
        [(n, *map(percent, scores)) for n, scores in zip(document["fits"], document["cross"], strict=True)],
        ("best set of", *document["fits"]),
        "a set brings its fitted values; the values that its fit took as known count where the campaign "
        "states none; every log keeps its clock offset",
    )


def print_check(document: Row, json: bool, *, quiet: bool = False) -> None:
    """Print a check: logs, excitation, verdicts, what to record next, and the warnings once more."""
    if print_result(document, json):
        return
    print_table(quality_table(document))
    for row in document["quality"]:
        print_lines([f"{row['name']}: suspicious: {finding}" for finding in row["suspicions"]], "bold yellow")
    print_lines([*check_lines(document), ""])
    print_table(expected_table(document))
    print_lines([channel_line(document), "", *document["sentences"]])
    if warnings := document["warnings"]:
        plural = "" if len(warnings) == 1 else "s"
        above = "" if quiet else ", above"
        print_lines(["", f"{len(warnings)} warning{plural}{above}:", *warnings], "bold yellow")


def check_lines(document: Row) -> list[str]:
    """Return what the logs' table has no column for: instants, clocks, centre of mass, excitation."""
    rows, out = document["quality"], []
    instants = [f"{r['name']} {r['release']:.3f} / {r['touchdown']:.3f}" for r in rows if "release" in r]
    if instants:
        out.append(f"start of the fall / touchdown on the log's clock [s]: {', '.join(instants)}")
    for row in rows:
        if second := row.get("second_log"):
            out.append(
                f"{row['name']}: second log {second['log']}: clock offset {second['offset']:.4g} s, "
                f"confidence {second['confidence']:.4g}"
            )
    mass = document.get("centre_of_mass")
    if mass is not None:
        pairs = [
            f"{1e3 * mass[key]:.1f} ± {1e3 * mass[f'{key}_error']:.1f} mm {word}"
            for key, word in (("down_slope", "down-slope"), ("up", "up"))
        ]
        out.append(f"centre of mass off the stated one, from the turns in flight: {', '.join(pairs)}")
    spans = []
    for name, value in document["excitation"].items():
        word, unit = name.removesuffix("_deg").replace("_", " "), _UNITS.get(name, "")
        ends = f"{value[0]:.3g} to {value[1]:.3g}" if isinstance(value, list) else f"{value}"
        spans.append(f"{word} {ends} {unit}".rstrip())
    return [*out, f"excitation: {', '.join(spans)}"]


def channel_line(document: Row) -> str:
    """Return which channels inform each parameter, the most informative one first."""
    parts = []
    for row in document["parameters"]:
        order = sorted(row["channels"].items(), key=lambda pair: -pair[1])
        shares = [f"{channel_symbol(name)} {100 * share:.0f} %" for name, share in order if share >= _TELLS]
        # Where many channels inform a little each, the first one is named without its share.
        first = [channel_symbol(name) for name, share in order[:1] if share > 0]
        parts.append(f"{row['symbol']}: {', '.join(shares or first) or 'nothing'}")
    return f"informed by: {'; '.join(parts)}"


def print_trust(document: Row, folder: Path, json: bool, *, long: bool = False) -> None:
    """Print the intervals and verdicts of a fit, and where they are stored."""
    if print_result(document, json):
        return
    folder = folder if folder.is_dir() else folder.parent
    print_lines([f"{folder.name}:"])
    wide = [narrow_table(document), spread_table(document)] if long else []
    for part in (interval_table(document), *wide, noise_table(document)):
        print_table(part)
    scores = ", ".join(f"{trial['name']} {trial['ratio']:.2f}" for trial in document["trials"])
    print_lines([f"residual over noise by trial, with errors of known values: {scores}", *document["notes"]])
    print_lines([f"written to {folder / 'trust.json'} and .h5 in {document['seconds']:.0f} s"])


def print_validation(document: Row, folder: Path, json: bool) -> None:
    """Print a validation or cross-validation."""
    if print_result(document, json):
        return
    folder = folder if folder.is_dir() else folder.parent
    print_table(validation_table(folder.name, document))
    print_lines(document["reasons"] or ["not flagged: the NRMSE is within what noise explains"])


def print_comparison(document: Row, sets: Sequence[ParameterSets], json: bool) -> None:
    """Print fits side by side, their differences and the cross-table."""
    if print_result(document, json):
        return
    print_table(mean_sigma_table(*sets))
    print_table(comparison_table(document))
    if document["cross"] is not None:
        print_table(cross_table(document))
    print_lines(document["sentences"])
