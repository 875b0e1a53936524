"""`sysid demo`: the whole job on the sample data."""

import time
from pathlib import Path

import sysid
from sysid import exact_json
from sysid.errors import SysidError
from sysid.journal import Say
from sysid.report.drawing import save_figure
from sysid.report.fit_figures import figure_convergence, figure_measured_against_simulated
from sysid.report.fold import print_table
from sysid.report.set_tables import truth_table
from sysid.report.table import Table
from sysid.workflows.export_models import export_sets
from sysid.workflows.fit import fit_campaign
from sysid.workflows.options import FitOptions
from sysid.workflows.report import write_report

# Campaigns of the samples, and what the demo says about them.
_CAMPAIGNS = {
    "motor": "motor: load-cell logs of forward and reverse commands",
    "gear-lf": "landing gear on the low-friction surface: six drops to fit, two to predict",
    "gear-hf": "landing gear on the high-friction surface: six drops to fit, two to predict",
}


def run_demo(data: Path | None, out: Path, quiet: bool = False, say: Say = None, json: bool = False) -> None:
    """Fit the samples in `data`, write exports, figures and reports, and compare with the truth.

    Without `data` they lie in the working directory or next to the installed sources; `SysidError` where they
    do not.

    The fit folders go to `out`, where an earlier demo is replaced. As JSON it prints a row per written file:
    the kind of the fit, what the file is, its path, and the NRMSE of the sets [1].
    """
    started = time.perf_counter()
    beside = Path(sysid.__file__).resolve().parents[1] / "data_samples"
    candidates = [data] if data is not None else [Path("data_samples"), beside]
    found = [d for d in candidates if all((d / name / "campaign.toml").is_file() for name in _CAMPAIGNS)]
    if not found:
        raise SysidError(
            f"no sample data at {' or '.join(map(str, candidates))}; run the demo from the project's folder, "
            "or name the samples with --data"
        )
    samples = found[0]
    tell = say or (lambda sentence: None)
    written: list[dict[str, object]] = []
    reports: list[Path] = []
    tables: list[Table] = []
    for number, (name, words) in enumerate(_CAMPAIGNS.items(), start=1):
        tell(f"{number}/{len(_CAMPAIGNS)} {words}")
        options = FitOptions(out / name, force=True, quiet=quiet or json)
        result, folder = fit_campaign(samples / name / "campaign.toml", options, say=say)
        outputs = {"fit": folder}
        for suffix in ("json", "csv"):
            (outputs[f"sets_{suffix}"],) = export_sets(folder, folder / f"sets.{suffix}", force=True)
        for what, figure in (
            ("measured_against_simulated", figure_measured_against_simulated(result)),
            ("convergence", figure_convergence(result, wide=True)),
        ):
            outputs[what] = save_figure(figure, folder / f"{what.replace('_', '-')}.png")
        outputs["report"] = write_report(folder)["report"]
        tell(f"wrote {outputs['report']}")
        reports.append(outputs["report"].resolve())
        nrmse = result.nrmse.tolist()
        for what, path in outputs.items():
            written.append({"kind": result.kind, "what": what, "path": str(path), "nrmse": nrmse})
        truth = exact_json.loads((samples / name / "truth.json").read_text(encoding="utf-8"))
        tables.append(truth_table(result.parameter_sets(), truth["parameters"]))
    seconds = time.perf_counter() - started
    if json:
        print(exact_json.dumps({"written": written, "seconds": seconds}))
    else:
        for one in tables:
            print_table(one)
        print(f"done in {seconds:.0f} s; all of it lies in {out}. Reports, to open in a browser:")
        # Plain lines: a path that a table folds cannot be copied.
        for report in reports:
            print(f"  {report}")
        print("next, with your own logs: sysid new-campaign gear --minimal --from LOG... (or motor)")
