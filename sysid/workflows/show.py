"""What happens to a fit after it: print it, export it; and the campaign templates."""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path
from typing import Any

from sysid import exact_json
from sysid.errors import CampaignError, ExportError, FitError
from sysid.export import export, load_parameter_sets
from sysid.fit.result import FitResult
from sysid.fit.store import read_fit
from sysid.parameter_sets import ParameterSets
from sysid.report.fold import print_table
from sysid.report.tables import ladder_table, mean_sigma_table, ranked_table, trial_table
from sysid.storage import write_file


def load_sets(path: str | Path) -> ParameterSets:
    """Return the ranked sets of a fit folder or of a parameter-set file of any format.

    Raises
    ------
    SysidError
        When there is neither.
    """
    path = Path(path)
    if path.is_dir() or path.name == "fit.h5":
        return read_fit(path).parameter_sets()
    return load_parameter_sets(path)


def export_sets(
    source: str | Path,
    target: Path,
    force: bool = False,
    *,
    rank: int | None = None,
    slope_deg: float = 0.0,
    per_leg: bool = False,
) -> list[Path]:
    """Write the ranked sets of a fit folder or file; the suffix of `target` chooses the format.

    `rank`, `slope_deg` and `per_leg` are for models of other simulators, see `export_models`; the files that
    were written are returned.

    Raises
    ------
    ExportError
        When `target` exists and `force` is off, or cannot be written; the old file survives then.
    """
    sets = load_sets(source)
    if target.suffix.lower() in (".xml", ".sdf"):
        from sysid.workflows.export_models import export_models

        slope = math.radians(slope_deg)
        return export_models(sets, target, rank=rank, slope=slope, per_leg=per_leg, force=force)
    if rank is not None or slope_deg or per_leg:
        raise ExportError(
            f"{target}: --set, --slope-deg and --per-leg are for models of other simulators (.xml, .sdf); "
            "leave them out"
        )
    if target.exists() and not force:
        raise ExportError(f"{target}: exists already; choose a new name or add --force")
    return [export(sets, target)]


def print_sets(source: str | Path, json: bool) -> None:
    """Print the ranked sets of a fit folder or file."""
    sets = load_sets(source)
    if json:
        print(sets.document().text(), end="")
        return
    _print_tables(sets)


def stopped_by_user(result: Any) -> bool:
    """Return whether Ctrl-C cut a fit short, which the shell is told by its exit code."""
    assert isinstance(result, FitResult)
    return bool(result.provenance.get("cut_short") == "interrupted")


def print_fit(result: Any, folder: Path, json: bool) -> None:
    """Print what a fit found and where it lies."""
    assert isinstance(result, FitResult)
    sets = result.parameter_sets()
    if json:
        print(
            exact_json.dumps({"folder": str(folder), "state": result.state, **sets.document().model_dump()})
        )
        return
    _print_tables(sets)
    state = "" if result.state == "done" else " (stopped early: the sets are what was found until then)"
    print(f"fit written to {folder}{state}; next: sysid export {folder} --to sets.json")


def _print_tables(sets: ParameterSets) -> None:
    print_table(ranked_table(sets))
    print_table(mean_sigma_table(sets))
    if sets.trials:
        print_table(trial_table(sets))
    if "ladder" in sets.settings:
        print_table(ladder_table(sets))


def write_template(kind: str, path: Path, force: bool = False) -> Path:
    """Write a commented campaign file.

    Raises
    ------
    CampaignError
        When the file exists and `force` is off.
    """
    if path.exists() and not force:
        raise CampaignError(f"{path}: exists already; choose a new name or add --force")
    template = resources.files("sysid").joinpath("templates", f"{kind}.toml")
    write_file(path, template.read_bytes(), FitError)
    return path
