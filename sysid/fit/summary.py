"""The run record: what was run on what, and what it cost."""

from __future__ import annotations

from typing import Any

from sysid.fit.history import RunHistory
from sysid.fit.result import FitResult


def run_record(result: FitResult) -> dict[str, Any]:
    """Return everything that a reader needs to repeat a fit or to doubt it; JSON-able.

    Provenance (versions, git revision, processor, hashes, settings) and what the runs cost: seeds,
    candidates, failed ones, simulations, wall time [s] and simulations per second.
    """
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
                        "algorithm": stage.algorithm,
                        "generations": len(stage.cost),
                        "candidates": stage.evaluations,
                        "failed": int(stage.failed.sum()),
                        "failures": stage.failures,
                        "wall_time": stage.wall_time,
                        "ended": stage.stop_reason,
                    }
                    for stage in run.stages
                ],
            }
            for run in result.runs
        ],
    }


def failures(run: RunHistory) -> str:
    """Return how many candidates of a run failed, and of what: ``3 failed: 2 blew up, 1 never touched``."""
    by_cause = ", ".join(f"{count} {cause}" for cause, count in run.failures.items())
    return f"{int(run.failed.sum())} failed" + (f": {by_cause}" if by_cause else "")


def record_lines(record: dict[str, Any]) -> list[str]:
    """Return the record as lines of text, nested ones indented; the runs are left to the run table."""
    return _lines({key: value for key, value in record.items() if key != "runs"}, "")


def _lines(values: dict[str, Any], indent: str) -> list[str]:
    lines = []
    for name, value in values.items():
        key = name.replace("_", " ")
        if isinstance(value, dict) and value:
            lines += [f"{indent}{key}", *_lines(value, indent + "  ")]
        elif isinstance(value, list | tuple) and any(isinstance(item, dict | list) for item in value):
            lines += [f"{indent}{key}", *(f"{indent}  {item}" for item in value)]
        else:
            shown = f"{value:.6g}" if isinstance(value, float) else value
            lines.append(f"{indent}{key}: {'-' if value is None or value == [] else shown}")
    return lines
