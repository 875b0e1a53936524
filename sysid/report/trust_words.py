"""Documents of trust on a terminal: their tables, and in lines what no table has a column for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sysid.parameter_sets import ParameterSets
from sysid.report.fold import print_lines, print_result, print_table
from sysid.report.set_tables import mean_sigma_table
from sysid.report.trust_tables import (
    comparison_table,
    cross_table,
    expected_table,
    interval_table,
    narrow_table,
    noise_table,
    quality_table,
    spread_table,
    validation_table,
)

# Units of what excites a model; the other entries count.
_UNITS = {"slope_deg": "deg", "impact_speed": "m/s", "pitch_rate": "rad/s", "speed": "rad/s",
          "command": "of full"}  # fmt: skip
# A channel with a smaller share of the information on a parameter is not named.
_TELLS = 0.2


def print_check(document: Mapping[str, Any], json: bool) -> None:
    """Print a check: logs, excitation, verdicts, what to record next."""
    if print_result(document, json):
        return
    print_table(quality_table(document))
    for row in document["quality"]:
        print_lines([f"{row['name']}: suspicious: {finding}" for finding in row["suspicions"]], "bold yellow")
    print_lines([*check_lines(document), ""])
    print_table(expected_table(document))
    print_lines([channel_line(document), "", *document["sentences"]])


def check_lines(document: Mapping[str, Any]) -> list[str]:
    """Return what the logs' table has no column for: instants, clocks, centre of mass, excitation."""
    rows, out = document["quality"], []
    instants = [f"{r['name']} {r['release']:.3f} / {r['touchdown']:.3f}" for r in rows if "release" in r]
    if instants:
        out.append(f"start of the fall / touchdown on the log's clock [s]: {', '.join(instants)}")
    for row in rows:
        if second := row.get("second log"):
            out.append(
                f"{row['name']}: second log {second['log']}: clock offset {second['offset [s]']:.4g} s, "
                f"confidence {second['confidence']:.4g}"
            )
    mass = document.get("centre_of_mass")
    if mass is not None:
        pairs = [
            f"{1e3 * mass[f'{key} [m]']:.1f} ± {1e3 * mass[f'{key} error [m]']:.1f} mm {word}"
            for key, word in (("down_slope", "down-slope"), ("up", "up"))
        ]
        out.append(f"centre of mass off the stated one, from the turns in flight: {', '.join(pairs)}")
    spans = []
    for name, value in document["excitation"].items():
        word, unit = name.removesuffix("_deg").replace("_", " "), _UNITS.get(name, "")
        span = f"{value[0]:.3g} to {value[1]:.3g}" if isinstance(value, list) else f"{value}"
        spans.append(f"{word} {span} {unit}".rstrip())
    return [*out, f"excitation: {', '.join(spans)}"]


def channel_line(document: Mapping[str, Any]) -> str:
    """Return which channels inform each parameter, the most informative one first."""
    parts = []
    for row in document["parameters"]:
        order = sorted(row["channels"].items(), key=lambda pair: -pair[1])
        shares = [f"{name} {100 * share:.0f} %" for name, share in order if share >= _TELLS]
        # Where many channels inform a little each, the first one is named without its share.
        first = [name for name, share in order[:1] if share > 0]
        parts.append(f"{row['symbol']}: {', '.join(shares or first) or 'nothing'}")
    return f"informed by: {'; '.join(parts)}"


def print_trust(document: Mapping[str, Any], folder: Path, json: bool, *, long: bool = False) -> None:
    """Print the intervals and verdicts of a fit, and where they are stored."""
    if print_result(document, json):
        return
    folder = folder if folder.is_dir() else folder.parent
    print_lines([f"{folder.name}:"])
    wide = [narrow_table(document), spread_table(document)] if long else []
    for part in (interval_table(document), *wide, noise_table(document)):
        print_table(part)
    print_lines([trials_line(document), *document["notes"]])
    print_lines([f"written to {folder / 'trust.json'} and .h5 in {document['seconds']:.0f} s"])


def trials_line(document: Mapping[str, Any]) -> str:
    """Return the residual of every fitted trial over its noise, in one line."""
    scores = ", ".join(f"{trial['name']} {trial['ratio']:.2f}" for trial in document["trials"])
    return f"residual over noise by trial: {scores}"


def print_validation(document: Mapping[str, Any], folder: Path, json: bool) -> None:
    """Print a validation or cross-validation."""
    if print_result(document, json):
        return
    folder = folder if folder.is_dir() else folder.parent
    print_table(validation_table(folder.name, document))
    print_lines(document["reasons"] or ["not flagged: the predictions are within what noise explains"])


def print_comparison(document: Mapping[str, Any], sets: Sequence[ParameterSets], json: bool) -> None:
    """Print fits side by side, their differences and the cross-table."""
    if print_result(document, json):
        return
    print_table(mean_sigma_table(*sets))
    print_table(comparison_table(document))
    if document["cross"] is not None:
        print_table(cross_table(document))
    print_lines(document["sentences"])
