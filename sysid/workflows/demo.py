"""`sysid demo`: the whole job on the sample data."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import sysid
from sysid import exact_json
from sysid.errors import SysidError
from sysid.fit.result import FitResult
from sysid.journal import Say
from sysid.report.drawing import save_figure
from sysid.report.fit_figures import figure_convergence, figure_measured_against_simulated
from sysid.workflows.export_models import export_sets
from sysid.workflows.fit import fit_campaign
from sysid.workflows.options import FitOptions
from sysid.workflows.report import write_report

# What is written for every fit, by the name in `--json`.
_WORDS = {
    "fit": "all of the fit",
    "sets_json": "parameter sets as JSON",
    "sets_csv": "parameter sets as CSV",
    "measured_against_simulated": "figure, measured against simulated",
    "convergence": "figure, convergence of the search",
    "report": "report to read in a browser",
}
# Campaigns of the samples, and what the demo says about them.
_CAMPAIGNS = {
    "motor": "motor: load-cell logs of forward and reverse commands",
    "gear-lf": "landing gear on the low-friction surface: six drops to fit, two to validate",
}


def find_samples(given: Path | None) -> Path:
    """Return the data_samples folder: given, in the working directory, or next to the installed sources.

    Raises `SysidError` when it is not there.
    """
    beside = Path(sysid.__file__).resolve().parents[1] / "data_samples"
    candidates = [given] if given is not None else [Path("data_samples"), beside]
    for folder in candidates:
        if all((folder / name / "campaign.toml").is_file() for name in _CAMPAIGNS):
            return folder
    raise SysidError(
        f"no sample data at {' or '.join(map(str, candidates))}; run the demo from the project's folder, or "
        "name the samples with --data"
    )


def run_demo(
    data: Path | None, out: Path, quiet: bool = False, say: Say = None, json: bool = False
) -> list[dict[str, Any]]:
    """Fit motor and LF gear of the samples in `data`, export the sets, draw the figures, write the reports.

    The two fit folders go to `out`, where an earlier demo is replaced. Returns a row per written
    file: the kind of the fit, what the file is, its path, and the NRMSE of the sets [1].
    """
    samples, started = find_samples(data), time.perf_counter()
    tell = say or (lambda sentence: None)
    written: list[dict[str, Any]] = []
    for number, (name, words) in enumerate(_CAMPAIGNS.items(), start=1):
        tell(f"{number}/{len(_CAMPAIGNS)} {words}")
        options = FitOptions(out / name, force=True, quiet=quiet or json)
        result, folder = fit_campaign(samples / name / "campaign.toml", options, say=say)
        tell(f"report of the {result.kind}")
        nrmse = result.nrmse.tolist()
        for what, path in _outputs(result, folder).items():
            written.append({"kind": result.kind, "what": what, "path": str(path), "nrmse": nrmse})
    if json:
        print(exact_json.dumps({"written": written, "seconds": time.perf_counter() - started}))
    elif not quiet:
        # Plain lines: a path that a table folds cannot be copied.
        for row in written:
            shares = "  ".join(f"{100 * value:.2f}" for value in row["nrmse"])
            scores = f" (NRMSE of its sets: {shares} %)" if row["what"] == "fit" else ""
            print(f"{row['path']}  {row['kind']}, {_WORDS[row['what']]}{scores}")
        print(f"done in {time.perf_counter() - started:.0f} s")
        for name in _CAMPAIGNS:
            print(f"look: open {(out / name / 'report.html').resolve()} in a browser")
        print("next, for your logs: sysid new-campaign motor, or sysid new-campaign gear")
    return written


def _outputs(result: FitResult, folder: Path) -> dict[str, Path]:
    """Write exports, figures and the report of a fit; return the files by their keys in `_WORDS`."""
    out = {"fit": folder}
    for suffix in ("json", "csv"):
        (out[f"sets_{suffix}"],) = export_sets(folder, folder / f"sets.{suffix}", force=True)
    for what, figure in (
        ("measured_against_simulated", figure_measured_against_simulated(result)),
        ("convergence", figure_convergence(result, wide=True)),
    ):
        out[what] = save_figure(figure, folder / f"{what.replace('_', '-')}.png")
    return out | {"report": write_report(folder)["report"]}
