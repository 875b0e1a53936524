"""Documents of trust on a terminal, as tables or JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from sysid import exact_json
from sysid.parameter_sets import ParameterSets
from sysid.report.fold import print_table
from sysid.report.tables import mean_sigma_table
from sysid.report.trust_tables import (
    comparison_table,
    cross_table,
    expected_table,
    narrow_table,
    noise_table,
    quality_table,
    spread_table,
    uncertainty_table,
    validation_table,
)
from sysid.workflows.reopen import fit_folder


def _lines(sentences: Sequence[str], style: str = "") -> None:
    console = Console(soft_wrap=True)
    for sentence in sentences:
        console.print(Text(sentence, style=style))


def print_check(document: Mapping[str, Any], json: bool) -> None:
    """Print a check: logs, excitation, verdicts, what to record next."""
    if json:
        print(exact_json.dumps(document))
        return
    print_table(quality_table(document))
    for row in document["quality"]:
        _lines([f"{row['name']}: suspicious: {one}" for one in row["suspicions"]], "bold yellow")
    _lines([*check_lines(document), ""])
    print_table(expected_table(document))
    _lines(channel_lines(document))
    _lines(document["sentences"])


# Of what excites a model; the others count.
_UNITS = {"slope_deg": "deg", "impact_speed": "m/s", "pitch_rate": "rad/s", "speed": "rad/s",
          "command": "of full"}  # fmt: skip
# A channel that holds less of what is known of a parameter is not named.
_TELLS = 0.2


def check_lines(document: Mapping[str, Any]) -> list[str]:
    """Return what the logs' table has no column for: instants, clocks, centre of mass, excitation."""
    out = []
    rows = document["quality"]
    held = [f"{r['name']} {r['release']:.3f} / {r['touchdown']:.3f}" for r in rows if "release" in r]
    if held:
        out.append(f"start of the fall / touchdown on the log's clock [s]: {', '.join(held)}")
    for row in rows:
        if row.get("second log"):
            second = row["second log"]
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
    out.append(f"excitation: {', '.join(spans)}")
    return out


def channel_lines(document: Mapping[str, Any]) -> list[str]:
    """Return which channels tell each parameter, the one that tells most first."""
    said = []
    for row in document["parameters"]:
        order = sorted(row["channels"].items(), key=lambda pair: -pair[1])
        told = [f"{name} {100 * share:.0f} %" for name, share in order if share >= _TELLS]
        # Many channels may tell a little each.
        little = [name for name, share in order[:1] if share > 0]
        said.append(f"{row['symbol']}: {', '.join(told or little) or 'nothing'}")
    return [f"told by: {'; '.join(said)}", ""]


def print_trust(document: Mapping[str, Any], folder: Path, json: bool, *, long: bool = False) -> None:
    """Print the intervals and verdicts of a fit, and where they are stored."""
    if json:
        print(exact_json.dumps(document))
        return
    folder = fit_folder(folder)
    named = {**document, "fit": folder.name}
    print_table(uncertainty_table(named))
    if long:
        print_table(narrow_table(named))
        print_table(spread_table(named))
    print_table(noise_table(named))
    _lines([trials_line(document), *document["notes"]])
    _lines([f"written to {folder / 'trust.json'} and .h5 in {document['seconds']:.0f} s"])


def trials_line(document: Mapping[str, Any]) -> str:
    """Return what every fitted trial scores, in one line."""
    scores = ", ".join(f"{one['name']} {one['ratio']:.2f}" for one in document["trials"])
    return f"residual over noise by trial: {scores}"


def print_validation(document: Mapping[str, Any], folder: Path, json: bool) -> None:
    """Print a validation or cross-validation."""
    if json:
        print(exact_json.dumps(document))
        return
    print_table(validation_table({"fit": fit_folder(folder).name, "part": "prediction", **document}))
    said = list(document["reasons"]) or ["not flagged: the predictions are within what noise explains"]
    _lines(said)


def print_comparison(document: Mapping[str, Any], sets: Sequence[ParameterSets], json: bool) -> None:
    """Print fits side by side, their differences and the cross-table."""
    if json:
        print(exact_json.dumps(document))
        return
    print_table(mean_sigma_table(*sets))
    print_table(comparison_table(document))
    if document["cross"] is not None:
        print_table(cross_table(document))
    _lines(document["sentences"])
