"""A fit in words: the summary that a person reads first, and the record of what was run and what it cost."""

from typing import Any

import numpy as np

from sysid.documents import channel_symbol, label
from sysid.fit.history import RunHistory
from sysid.fit.optima import waterfall
from sysid.fit.result import FitResult


def run_record(result: FitResult) -> dict[str, Any]:
    """Return the provenance of a fit and what its runs cost (wall time in seconds); JSON-able."""
    evaluations = sum(run.evaluations for run in result.runs)
    simulations = sum(run.simulations for run in result.runs)
    wall_time = sum(run.wall_time for run in result.runs)
    return {
        "fit": result.name,
        "kind": result.kind,
        "state": result.state,
        **result.provenance,
        "totals": {
            "candidates": evaluations,
            "failed": sum(int(run.failed.sum()) for run in result.runs),
            "simulations": simulations,
            "wall_time": wall_time,
            "simulations_per_second": simulations / wall_time if wall_time > 0 else None,
        },
        "runs": [
            {
                "seed": run.seed,
                "nrmse": float(run.best[-1]),
                "stages": [
                    {
                        "algorithm": stage.algorithm, "generations": len(stage.cost),
                        "candidates": stage.evaluations, "failed": int(stage.failed.sum()),
                        "failures": stage.failures, "wall_time": stage.wall_time, "ended": stage.stop_reason,
                    }
                    for stage in run.stages
                ],
            }
            for run in result.runs
        ],
    }  # fmt: skip


# What a cause of failed candidates means.
_CAUSES = {
    "diverged": "a leg was pushed through its joint",
    "too_expensive": "many times the work of an ordinary trial, as very stiff parts or many bounces need",
    "step_collapsed": "the step of the integration shrank to nothing",
    "never_touched": "no touchdown in the window",
    "left_the_board": "the drone slid or bounced off the board",
    "no_steady_state": "the motor has no steady speed at the trial's start",
    "not_finite": "the simulation is not finite",
}


def failures(run: RunHistory) -> str:
    """Return how many candidates of a run failed, and of what: ``3 failed: 2 diverged, 1 never touched``."""
    by_cause = ", ".join(f"{count} {cause.replace('_', ' ')}" for cause, count in run.failures.items())
    return f"{int(run.failed.sum())} failed" + (f": {by_cause}" if by_cause else "")


def record_lines(record: dict[str, Any], indent: str = "") -> list[str]:
    """Return the record as lines of text, nested ones indented; the runs are left to the run table."""
    lines = []
    for name, value in record.items():
        if name == "runs" and not indent:
            continue
        key = label(name)
        if isinstance(value, dict) and value:
            lines += [f"{indent}{key}", *record_lines(value, indent + "  ")]
        elif isinstance(value, list | tuple) and any(isinstance(item, dict | list) for item in value):
            lines += [f"{indent}{key}", *(f"{indent}  {_in_line(item)}" for item in value)]
        elif isinstance(value, str) and "\n" in value:
            lines += [f"{indent}{key}", *(f"{indent}  {line}".rstrip() for line in value.splitlines())]
        else:
            lines.append(f"{indent}{key}: {_in_line(value)}")
    return lines


def _in_line(value: Any) -> str:
    """Return a value of the record in one line, six digits of every number."""
    if isinstance(value, float):
        # A clock of Unix seconds has ten digits before the point.
        return f"{value:{'.3f' if 1e6 <= abs(value) < 1e15 else '.6g'}}"
    if isinstance(value, dict):
        return ", ".join(f"{label(name)}: {_in_line(one)}" for name, one in value.items()) or "-"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_in_line, value))}]" if value else "-"
    return "-" if value is None or value == "" else str(value)


def summary(result: FitResult) -> str:
    """Return what a person reads first: NRMSE of the sets, their values, how each run ended."""
    denominator = result.provenance.get("nrmse_denominator", "std")
    lines = [
        f"{result.kind} fit {result.name}: {result.state}",
        "",
        *([explained["sentence"], ""] if (explained := result.provenance.get("adequacy")) else []),
        f"NRMSE (rms error / {denominator} of the measurement), mean over channels and trials",
        "",
        f"{'rank':>4}  {'run':>3}  {'seed':>10}  {'fitted':>8}  {'validated':>9}",
    ]
    fitted, validated = result.nrmse, result.mean_nrmse("validate")
    for s in range(len(fitted)):
        other = "-" if np.isnan(validated[s]) else f"{100 * validated[s]:.2f} %"
        fit = f"{100 * fitted[s]:.2f} %"
        lines.append(f"{s + 1:>4}  {result.set_runs[s]:>3}  {result.set_seeds[s]:>10}  {fit:>8}  {other:>9}")
    lines += ["", "sets, best first (SI; * ends at a bound)", ""]
    unsearched: list[str] = []
    moved: list[str] = []
    for name, row in result.known.items():
        status, head = row.record.status, f"{row.record.symbol} [{row.record.unit}]"
        if status in ("measured", "fixed"):
            value = row.values[0] if len(fitted) else np.nan
            unsearched.append(f"{head:<22}{value:>16.5g}   {name} ({status})")
        elif status == "stated":
            value = row.values[0] if len(fitted) else np.nan
            moved.append(f"{head:<22}{value:>16.5g}   {name} ({row.record.source})")
        elif status in ("free", "derived"):
            cells = "".join(
                f"{value:>16.5g}{'*' if bound else ' '}" if row.instead is None else f"{row.instead:>16} "
                for value, bound in zip(row.values, row.at_bound, strict=True)
            )
            worth = (
                f": 95 % {row.judged.interval}, {row.judged.verdict.replace('_', ' ')}" if row.judged else ""
            )
            lines.append(f"{head:<22}{cells}  {name}{' (derived)' if status == 'derived' else ''}{worth}")
    lines += ["", "fitted within their stated errors (SI, best set)", "", *moved] if moved else []
    lines += ["", "not searched (SI)", "", *unsearched]
    lines += ["", "NRMSE of the best set by trial and channel [%]", ""]
    width = max([len(trial.name) for trial in result.trials], default=0)
    lines.append(
        " " * (width + 12) + "".join(f"{channel_symbol(channel):>14}" for channel in result.channels)
    )
    for trial in result.trials:
        cells = "".join(f"{100 * value:>14.2f}" for value in trial.nrmse[0])
        lines.append(f"{trial.name:<{width}}  {trial.use:<10}{cells}")
    if result.runs:
        lines += ["", "runs, best first (runs of one letter ended in the same optimum)", ""]
        lines += [*waterfall(result.runs, result.searched), "", result.agreement.sentence()]
    lines += ["", "stages", ""]
    for number, run in enumerate(result.runs, start=1):
        lines.append(
            f"{number:>4}  NRMSE {100 * run.best[-1]:.2f} %, {run.evaluations} candidates "
            f"({failures(run)}), {run.wall_time:.1f} s"
        )
        lines += [
            f"      {stage.algorithm}: {len(stage.cost)} generations, {stage.evaluations} candidates, "
            f"NRMSE {100 * stage.cost.min():.2f} %, ended: {stage.ended}"
            for stage in run.stages
        ]
    if causes := sorted({cause for run in result.runs for cause in run.failures} & {*_CAUSES}):
        lines += ["", "failed candidates, whose NRMSE has a penalty", ""]
        lines += [f"  {cause.replace('_', ' ')}: {_CAUSES[cause]}" for cause in causes]
    if result.warnings:
        lines += ["", "warnings", "", *(f"- {warning}" for warning in result.warnings)]
    lines += ["", "record", "", *record_lines(run_record(result))]
    return "\n".join(lines) + "\n"
