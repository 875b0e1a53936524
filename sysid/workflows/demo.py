"""`sysid demo`: the whole job on the sample data."""

from __future__ import annotations

import time
from pathlib import Path

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

# Campaigns of the samples, and what the demo says about them.
_CAMPAIGNS = {
    "motor": "motor: load-cell logs of forward and reverse commands",
    "gear-lf": "landing gear on the low-friction surface: six drops to fit, two to validate",
}


def find_samples(given: Path | None) -> Path:
    """Return the data_samples folder: given, in the working directory, or beside the installed sources.

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
) -> dict[str, Path]:
    """Fit motor and LF gear of the samples in `data`, export the sets, draw the figures, write the reports.

    The two fit folders go to `out`, where an earlier demo is replaced. The written files are
    returned by their description.
    """
    samples, started = find_samples(data), time.perf_counter()
    tell = say or (lambda sentence: None)
    written: dict[str, Path] = {}
    for number, (name, words) in enumerate(_CAMPAIGNS.items(), start=1):
        tell(f"{number}/{len(_CAMPAIGNS)} {words}")
        options = FitOptions(out / name, force=True, quiet=quiet or json)
        result, folder = fit_campaign(samples / name / "campaign.toml", options, say=say)
        tell(f"report of the {result.kind}")
        for description, path in _outputs(result, folder).items():
            written[f"{result.kind}, {description}"] = path
    if json:
        paths = {what: str(path) for what, path in written.items()}
        print(exact_json.dumps({"written": paths, "seconds": time.perf_counter() - started}))
    elif not quiet:
        # Plain lines: a path that a table folds cannot be copied.
        for what, path in written.items():
            print(f"{path}  {what}")
        print(f"done in {time.perf_counter() - started:.0f} s")
        print(f"look: open {(folder / 'report.html').resolve()} in a browser")
    return written


def _outputs(result: FitResult, folder: Path) -> dict[str, Path]:
    """Write exports, figures and the report of a fit; return the files by their description."""
    shares = "  ".join(f"{100 * value:.2f}" for value in result.nrmse)
    out = {f"all of the fit (NRMSE of its sets: {shares} %)": folder}
    for suffix in ("json", "csv"):
        (out[f"parameter sets as {suffix.upper()}"],) = export_sets(
            folder, folder / f"sets.{suffix}", force=True
        )
    for title, figure in (
        ("measured against simulated", figure_measured_against_simulated(result)),
        ("convergence", figure_convergence(result, wide=True)),
    ):
        out[title] = save_figure(figure, folder / f"{title.replace(' ', '-')}.png")
    return out | {"report to read in a browser": write_report(folder)["report"]}
