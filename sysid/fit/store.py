"""A fit on disk: one folder with everything, written whole or not at all.

``fit.h5`` holds every number (the population of every generation, the sets, the trajectories), ``fit.json``
the ranked sets with settings and provenance as text (the same document that ``sysid export`` writes), and
``summary.txt`` what a person reads first.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from sysid import exact_json
from sysid.errors import ExportError, FitError
from sysid.fit.history import RunHistory, StageHistory
from sysid.fit.optima import waterfall
from sysid.fit.provenance import FitDocument
from sysid.fit.result import FitResult, TrialResult
from sysid.fit.stopping import REASONS
from sysid.fit.summary import failures, record_lines, run_record
from sysid.parameter_sets import ParameterSets, SetsMetadata, in_place_of_digits
from sysid.spectrum import Spectrum
from sysid.storage import check_folder, replaced_folder

FIT_SCHEMA = "sysid-fit"
FIT_VERSION = 3
_STAGE_FIELDS = ("algorithm", "evaluations", "simulations", "wall_time", "stop_reason")


def check_new_fit(path: str | Path, force: bool = False) -> None:
    """Refuse a fit folder that exists, before the hours of a fit are spent.

    Raises
    ------
    FitError
        When `path` exists and `force` is off, or is not a fit folder.
    """
    check_folder(path, force=force, marker="fit.h5", error_type=FitError)


def write_fit(result: FitResult, path: str | Path, force: bool = False) -> Path:
    """Write a fit folder.

    Parameters
    ----------
    result : FitResult
        What to write.
    path : str or Path
        The folder; its parents are made.
    force : bool
        Replace an existing fit folder, with all that is in it, once the new one is complete.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    FitError
        When the folder exists and `force` is off, or it cannot be written; nothing has changed then.
    """
    path = Path(path)
    sets = result.parameter_sets()
    text = FitDocument(**vars(sets.document())).text()
    # Built in memory: on a full disk the HDF5 library itself would go down with the process.
    numbers = io.BytesIO()
    with h5py.File(numbers, "w") as file:
        _write_numbers(file, result, sets)
    with replaced_folder(path, force=force, marker="fit.h5", error_type=FitError) as folder:
        (folder / "fit.h5").write_bytes(numbers.getvalue())
        (folder / "fit.json").write_text(text, encoding="utf-8", newline="\n")
        (folder / "summary.txt").write_text(summary(result), encoding="utf-8", newline="\n")
    return path


def _array(group: Any, name: str, data: Any, axes: str, unit: str = "1") -> None:
    data = np.asarray(data)
    packed = {"compression": "gzip", "compression_opts": 4, "shuffle": True} if data.size > 64 else {}
    dataset = group.create_dataset(name, data=data, **packed)
    dataset.attrs["axes"] = axes
    dataset.attrs["unit"] = unit


def _write_numbers(file: Any, result: FitResult, sets: ParameterSets) -> None:
    text = h5py.string_dtype()
    file.attrs["schema"] = FIT_SCHEMA
    file.attrs["version"] = FIT_VERSION
    file.attrs["state"] = result.state
    file.create_dataset("metadata_json", data=sets.metadata().line(), dtype=text)
    record = exact_json.dumps(run_record(result), indent=None)
    file.create_dataset("record_json", data=record, dtype=text)
    group = file.create_group("sets")
    _array(group, "values", sets.values, "set, parameter", "SI, see parameters in metadata_json")
    _array(group, "cube", result.cube, "set, free parameter")
    _array(group, "nrmse", sets.nrmse, "set")
    _array(group, "at_bound", sets.at_bound, "set, parameter")
    _array(group, "nrmse_by_trial", sets.nrmse_by_trial, "set, trial, channel")
    for number, run in enumerate(result.runs, start=1):
        group = file.create_group(f"runs/{number}")
        group.attrs["seed"] = run.seed
        for index, stage in enumerate(run.stages, start=1):
            part = group.create_group(f"stages/{index}")
            for name in _STAGE_FIELDS:
                part.attrs[name] = getattr(stage, name)
            _array(part, "cube", stage.cube, "generation, individual (best first), free parameter")
            _array(part, "cost", stage.cost, "generation, individual")
            _array(part, "failed", stage.failed, "generation")
            names = list(stage.failures)
            counts = [[generation.get(name, 0) for name in names] for generation in stage.causes]
            _array(part, "failed_by_cause", np.array(counts, dtype=np.int64), "generation, cause")
            part["failed_by_cause"].attrs["causes"] = exact_json.dumps(names, indent=None)
    units = ", ".join(result.channel_units)
    for number, trial in enumerate(result.trials, start=1):
        group = file.create_group(f"trials/{number}")
        group.attrs["name"] = trial.name
        group.attrs["use"] = trial.use
        _array(group, "time", trial.time, "sample", "s")
        _array(group, "measured", trial.measured, "sample, channel", units)
        _array(group, "valid", trial.valid, "sample, channel")
        _array(group, "simulated", trial.simulated, "set, sample, channel", units)
        _array(group, "nrmse", trial.nrmse, "set, channel")
        if trial.spectrum is not None:
            _array(group, "spectrum/frequency", trial.spectrum.frequency, "point", "Hz")
            _array(group, "spectrum/density", trial.spectrum.density, "point, channel", f"({units})/√Hz")
        if trial.thrust is not None:
            _array(group, "thrust", trial.thrust, "sample", "N")
        if trial.commands is not None:
            _array(group, "commands", trial.commands, "command, (time, level)", "s, 1")


def read_fit(path: str | Path) -> FitResult:
    """Read a fit folder, or its ``fit.h5``.

    Raises
    ------
    FitError
        When there is no fit, or it is foreign, damaged, cut off or of an unknown version.
    """
    path = Path(path)
    file_path = path / "fit.h5" if path.is_dir() else path
    if not file_path.is_file():
        raise FitError(f"{path}: no fit.h5 there; expected a folder that sysid fit-motor or fit-gear wrote")
    try:
        with h5py.File(file_path, "r") as file:
            if file.attrs.get("schema") != FIT_SCHEMA:
                raise FitError(f"{file_path}: not a fit of sysid; expected the fit.h5 of a fit folder")
            if file.attrs.get("version") != FIT_VERSION:
                raise FitError(
                    f"{file_path}: fit version {file.attrs.get('version')}, expected {FIT_VERSION}; "
                    "read it with the version of sysid that wrote it"
                )
            return _read_numbers(file)
    # What h5py raises on a damaged file depends on where the damage lies.
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, AttributeError, ExportError) as error:
        raise FitError(f"{file_path}: damaged or cut off ({error}); run the fit again") from error


def _read_numbers(file: Any) -> FitResult:
    group = file["sets"]
    sets = ParameterSets.from_metadata(
        SetsMetadata.parse(file["metadata_json"].asstr()[()], file.filename, FitError),
        values=group["values"][()],
        nrmse=group["nrmse"][()],
        at_bound=group["at_bound"][()],
        nrmse_by_trial=group["nrmse_by_trial"][()],
    )
    runs = [_read_run(file[f"runs/{i + 1}"]) for i in range(len(file.get("runs", ())))]
    trials = [_read_trial(file[f"trials/{i + 1}"]) for i in range(len(file.get("trials", ())))]
    return FitResult(
        kind=sets.kind,
        name=sets.name,
        state=file.attrs["state"],
        parameters=sets.parameters,
        runs=tuple(runs),
        set_runs=sets.runs,
        set_seeds=sets.seeds,
        cube=group["cube"][()],
        values=sets.values,
        at_bound=sets.at_bound,
        nrmse=sets.nrmse,
        trials=tuple(trials),
        channels=sets.channels,
        channel_units=sets.channel_units,
        channel_weights=sets.channel_weights,
        settings=sets.settings,
        provenance=sets.provenance,
        warnings=sets.warnings,
    )


def _read_run(group: Any) -> RunHistory:
    stages = [_read_stage(group[f"stages/{i + 1}"]) for i in range(len(group["stages"]))]
    return RunHistory(int(group.attrs["seed"]), tuple(stages))


def _read_stage(group: Any) -> StageHistory:
    return StageHistory(
        algorithm=group.attrs["algorithm"],
        cube=group["cube"][()],
        cost=group["cost"][()],
        failed=group["failed"][()],
        causes=_read_causes(group["failed_by_cause"]),
        evaluations=int(group.attrs["evaluations"]),
        simulations=int(group.attrs["simulations"]),
        wall_time=float(group.attrs["wall_time"]),
        stop_reason=group.attrs["stop_reason"],
    )


def _read_causes(dataset: Any) -> tuple[dict[str, int], ...]:
    names = exact_json.loads(dataset.attrs["causes"])
    return tuple(
        {name: int(count) for name, count in zip(names, row, strict=True) if count} for row in dataset[()]
    )


def _read_trial(group: Any) -> TrialResult:
    return TrialResult(
        name=group.attrs["name"],
        use=group.attrs["use"],
        time=group["time"][()],
        measured=group["measured"][()],
        valid=group["valid"][()],
        simulated=group["simulated"][()],
        nrmse=group["nrmse"][()],
        spectrum=_read_spectrum(group),
        thrust=group["thrust"][()] if "thrust" in group else None,
        commands=group["commands"][()] if "commands" in group else None,
    )


def _read_spectrum(group: Any) -> Spectrum | None:
    if "spectrum" not in group:
        return None
    return Spectrum(group["spectrum/frequency"][()], group["spectrum/density"][()])


def summary(result: FitResult) -> str:
    """Return what a person reads first: NRMSE of the sets, their values, how each run ended."""
    denominator = result.provenance.get("nrmse_denominator", "std")
    lines = [
        f"{result.kind} fit {result.name}: {result.state}",
        "",
        f"NRMSE (rms error / {denominator} of the measurement), mean over channels and trials",
        "",
        f"{'rank':>4}  {'run':>3}  {'seed':>10}  {'fitted':>8}  {'validated':>9}",
    ]
    fitted, validated = result.nrmse, result.mean_nrmse("validate")
    for s in range(len(fitted)):
        other = "-" if np.isnan(validated[s]) else f"{100 * validated[s]:.2f} %"
        own = f"{100 * fitted[s]:.2f} %"
        lines.append(f"{s + 1:>4}  {result.set_runs[s]:>3}  {result.set_seeds[s]:>10}  {own:>8}  {other:>9}")
    lines += ["", "sets, best first (SI; * ends at a bound)", ""]
    for i, record in enumerate(result.parameters):
        if record.status in ("free", "derived"):
            instead = in_place_of_digits(result.settings, record.name)
            cells = "".join(
                f"{result.values[s, i]:>13.5g}{'*' if result.at_bound[s, i] else ' '}"
                if instead is None
                else f"{instead:>13} "
                for s in range(len(fitted))
            )
            head = f"{record.symbol} [{record.unit}]"
            derived = " (derived)" if record.status == "derived" else ""
            lines.append(f"{head:<22}{cells}  {record.name}{derived}")
    lines += ["", "held (SI)", ""]
    for i, record in enumerate(result.parameters):
        if record.status in ("measured", "fixed"):
            value = result.values[0, i] if len(fitted) else np.nan
            head = f"{record.symbol} [{record.unit}]"
            lines.append(f"{head:<22}{value:>13.5g}   {record.name} ({record.status})")
    lines += ["", "NRMSE of the best set by trial and channel [%]", ""]
    width = max([len(trial.name) for trial in result.trials], default=0)
    lines.append(" " * (width + 12) + "".join(f"{channel:>14}" for channel in result.channels))
    for trial in result.trials:
        cells = "".join(f"{100 * value:>14.2f}" for value in trial.nrmse[0])
        lines.append(f"{trial.name:<{width}}  {trial.use:<10}{cells}")
    if result.runs:
        lines += ["", "runs, best first (runs of one letter ended in the same optimum)", ""]
        lines += [*waterfall(result.runs, result.searched), "", result.agreement.sentence()]
    lines += ["", "stages", ""]
    for number, run in enumerate(result.runs, start=1):
        lines.append(
            f"{number:>4}  NRMSE {100 * run.best[-1]:.3f} %, {run.evaluations} candidates "
            f"({failures(run)}), {run.wall_time:.1f} s"
        )
        lines += [
            f"      {stage.algorithm}: {len(stage.cost)} generations, {stage.evaluations} candidates, "
            f"NRMSE {100 * stage.cost.min():.3f} %, ended: {REASONS[stage.stop_reason]}"
            for stage in run.stages
        ]
    if result.warnings:
        lines += ["", "warnings", "", *(f"- {warning}" for warning in result.warnings)]
    lines += ["", "record", "", *record_lines(run_record(result))]
    return "\n".join(lines) + "\n"
