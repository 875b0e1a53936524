"""Documents of trust on a terminal, as tables or JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from sysid import exact_json
from sysid.parameter_sets import ParameterSets
from sysid.pipelines.trust_setup import fit_folder
from sysid.report.printing import print_table
from sysid.report.tables import mean_sigma_table
from sysid.report.trust_tables import (
    comparison_table,
    cross_table,
    expected_table,
    noise_table,
    quality_table,
    uncertainty_table,
    validation_table,
)


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
    spans = [
        f"{name} {value[0]:.4g} to {value[1]:.4g}" if isinstance(value, list) else f"{name} {value}"
        for name, value in document["excitation"].items()
    ]
    _lines([f"excitation: {', '.join(spans)}", ""])
    print_table(expected_table(document))
    _lines(document["sentences"])


def print_trust(document: Mapping[str, Any], folder: Path, json: bool) -> None:
    """Print the intervals and verdicts of a fit, and where they are stored."""
    if json:
        print(exact_json.dumps(document))
        return
    folder = fit_folder(folder)
    named = {**document, "fit": folder.name}
    print_table(uncertainty_table(named))
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
