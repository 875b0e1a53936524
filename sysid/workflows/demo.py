"""`sysid demo`: the whole job on the sample data."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import sysid
from sysid import exact_json
from sysid.errors import SysidError
from sysid.fit.result import FitResult
from sysid.report.drawing import save_figure
from sysid.report.fit_figures import figure_convergence, figure_measured_against_simulated
from sysid.workflows.export_models import export_sets
from sysid.workflows.fit import fit_gear, fit_motor
from sysid.workflows.options import FitOptions
from sysid.workflows.report import write_report


def find_samples(given: Path | None) -> Path:
    """Return the data_samples folder: given, in the working directory, or beside the installed sources.

    Raises
    ------
    SysidError
        When it is not there.
    """
    candidates = [given] if given is not None else [
        Path("data_samples"), Path(sysid.__file__).resolve().parents[1] / "data_samples",
    ]  # fmt: skip
    for folder in candidates:
        if (folder / "motor" / "campaign.toml").is_file() and (
            folder / "gear-lf" / "campaign.toml"
        ).is_file():
            return folder
    raise SysidError(
        f"no sample data at {' or '.join(str(folder) for folder in candidates)}; run the demo from the "
        f"project's folder, or name the samples with --data"
    )


def run_demo(
    data: Path | None,
    out: Path,
    quiet: bool = False,
    say: Callable[[str], None] | None = None,
    json: bool = False,
) -> dict[str, Path]:
    """Fit motor and LF gear of the samples, export the sets, draw the figures, write the reports.

    Parameters
    ----------
    data : Path, optional
        The data_samples folder.
    out : Path
        Where the two fit folders go; an earlier demo there is replaced.
    quiet : bool
        No progress and no table.
    say : callable, optional
        Told what is going on.
    json : bool
        Print what was written as JSON.

    Returns
    -------
    dict
        What was written, by what it is.
    """
    samples = find_samples(data)
    tell = say or (lambda sentence: None)
    written: dict[str, Path] = {}
    started = time.perf_counter()

    def keep(name: str, result: FitResult, folder: Path) -> None:
        shares = "  ".join(f"{100 * value:.2f}" for value in result.nrmse)
        written[f"{name}, all of the fit (NRMSE of its sets: {shares} %)"] = folder
        for suffix in ("json", "csv"):
            (target,) = export_sets(folder, folder / f"sets.{suffix}", force=True)
            written[f"{name}, parameter sets as {suffix.upper()}"] = target
        figures = {
            "measured against simulated": figure_measured_against_simulated(result),
            "convergence": figure_convergence(result, wide=True),
        }
        for title, figure in figures.items():
            target = save_figure(figure, folder / f"{title.replace(' ', '-')}.png")
            written[f"{name}, {title}"] = target
        tell(f"report of the {name}")
        written[f"{name}, report to read in a browser"] = write_report(folder)["report"]

    tell("1/2 motor: load-cell logs of forward and reverse commands")
    keep(
        "motor",
        *fit_motor(
            samples / "motor" / "campaign.toml",
            FitOptions(out / "motor", force=True, quiet=quiet or json),
            say=say,
        ),
    )
    tell("2/2 landing gear on the low-friction surface: six drops to fit, two to validate")
    keep(
        "gear",
        *fit_gear(
            samples / "gear-lf" / "campaign.toml",
            FitOptions(out / "gear-lf", force=True, quiet=quiet or json),
            say=say,
        ),
    )
    if json:
        spent = time.perf_counter() - started
        paths = {what: str(path) for what, path in written.items()}
        print(exact_json.dumps({"written": paths, "seconds": spent}))
    elif not quiet:
        # Plain lines: a path that a table folds cannot be copied.
        for what, path in written.items():
            print(f"{path}  {what}")
        reports = [path for what, path in written.items() if "report" in what]
        print(f"done in {time.perf_counter() - started:.0f} s")
        if reports:
            print(f"look: open {reports[-1].resolve()} in a browser")
    return written
