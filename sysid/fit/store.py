"""A fit on disk: one folder with everything, written whole or not at all.

``fit.h5`` has every number (the population of every generation, the sets, the trajectories), ``fit.json``
the ranked sets with settings and provenance as text (the same document that ``sysid export`` writes), and
``summary.txt`` what a person reads first. Every command reads ``fit.h5``; ``fit.json`` is a copy for other
programs. It names the SHA-256 of both, as every document of trust beside it does, see `Document.sealed`; a
folder in which either has changed is refused.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

import numpy as np

from sysid import exact_json
from sysid.errors import FitError, shell
from sysid.fit.history import RunHistory, StageHistory
from sysid.fit.provenance import FitDocument
from sysid.fit.result import FitResult, TrialResult
from sysid.fit.summary import run_record, summary
from sysid.parameter_sets import ParameterSets, SetsDocument, SetsMetadata, content_of
from sysid.storage import (
    FileKind,
    check_folder,
    get_texts,
    numbered,
    put,
    put_json,
    put_texts,
    replaced_folder,
)
from sysid.types import Spectrum

FIT_FILE = FileKind("sysid-fit", 3, "a fit", "run the fit again", FitError)
_STAGE_FIELDS = ("algorithm", "evaluations", "simulations", "wall_time", "stop_reason")


def check_new_fit(path: str | Path, force: bool = False) -> None:
    """Refuse a path that exists, unless `force` and it is a fit folder."""
    check_folder(path, force=force, marker="fit.h5", error_type=FitError)


def write_fit(
    result: FitResult,
    path: str | Path,
    force: bool = False,
    *,
    shown: FitResult | None = None,
    beside: Callable[[str], dict[str, bytes]] | None = None,
) -> Path:
    """Write a fit folder, whose parents are made, and return its path.

    ``fit.json`` and ``summary.txt`` are of the fit with its intervals where it is `shown` with them. `beside`
    returns further files of the folder by name, from the SHA-256 of ``fit.h5``. `force` replaces an existing
    fit folder, with all that is in it, once the new one is complete. Raises FitError, with nothing changed,
    when the folder exists and `force` is off, or it cannot be written.
    """
    path = Path(path)
    sets = result.parameter_sets()
    record, metadata = run_record(result), sets.metadata().line()
    numbers = FIT_FILE.content(lambda file: _write_numbers(file, result, sets, record, metadata))
    digest = hashlib.sha256(numbers).hexdigest()
    texts = fit_texts(shown or result, digest) | (beside(digest) if beside else {})
    with replaced_folder(path, force=force, marker="fit.h5", error_type=FitError) as folder:
        (folder / "fit.h5").write_bytes(numbers)
        for name, data in texts.items():
            (folder / name).write_bytes(data)
    return path


def fit_texts(result: FitResult, fit_sha256: str) -> dict[str, bytes]:
    """Return ``fit.json`` and ``summary.txt``, which change when intervals are known.

    `fit_sha256` is of the fit.h5 beside them.
    """
    document = FitDocument(**vars(result.parameter_sets().document()))
    content = document.sealed("fit.json", **{"fit.h5": fit_sha256})
    return {"fit.json": content, "summary.txt": summary(result).encode("utf-8")}


def _write_numbers(
    file: Any, result: FitResult, sets: ParameterSets, record: Mapping[str, object], metadata: str
) -> None:
    file.attrs["state"] = result.state
    put_texts(file, "metadata_json", metadata)
    put_json(file, "record_json", record)
    group = file.create_group("sets")
    put(group, "values", sets.values, "set, parameter", "SI, see parameters in metadata_json")
    put(group, "cube", result.cube, "set, free parameter")
    put(group, "nrmse", sets.nrmse, "set")
    put(group, "at_bound", sets.at_bound, "set, parameter")
    put(group, "nrmse_by_trial", sets.nrmse_by_trial, "set, trial, channel")
    for number, run in enumerate(result.runs, start=1):
        group = file.create_group(f"runs/{number}")
        group.attrs["seed"] = run.seed
        for index, stage in enumerate(run.stages, start=1):
            part = group.create_group(f"stages/{index}")
            for name in _STAGE_FIELDS:
                part.attrs[name] = getattr(stage, name)
            put(part, "cube", stage.cube, "generation, individual (best first), free parameter")
            put(part, "cost", stage.cost, "generation, individual")
            put(part, "failed", stage.failed, "generation")
            names = list(stage.failures)
            counts = [[generation.get(name, 0) for name in names] for generation in stage.causes]
            put(part, "failed_by_cause", np.array(counts, dtype=np.int64), "generation, cause")
            part["failed_by_cause"].attrs["causes"] = exact_json.dumps(names, indent=None)
    units = ", ".join(result.channel_units)
    for number, trial in enumerate(result.trials, start=1):
        group = file.create_group(f"trials/{number}")
        group.attrs["name"], group.attrs["use"] = trial.name, trial.use
        put(group, "time", trial.time, "sample", "s")
        put(group, "measured", trial.measured, "sample, channel", units)
        put(group, "valid", trial.valid, "sample, channel")
        put(group, "simulated", trial.simulated, "set, sample, channel", units)
        put(group, "nrmse", trial.nrmse, "set, channel")
        if trial.spectrum is not None:
            put(group, "spectrum/frequency", trial.spectrum.frequency, "point", "Hz")
            put(group, "spectrum/density", trial.spectrum.density, "point, channel", f"({units})/√Hz")
        if trial.thrust is not None:
            put(group, "thrust", trial.thrust, "sample", "N")
        if trial.commands is not None:
            put(group, "commands", trial.commands, "command, (time, level)", "s, 1")


def fit_folder(path: Path) -> Path:
    """Return a fit's folder from the folder or from the file of the sets in it."""
    return path.parent if path.name == "fit.h5" else path


def _meant(path: Path) -> str:
    """Return which fits a path that holds none may stand for, the likeliest first, in words."""
    place = path if path.is_dir() else path.parent
    found = [file.parent for pattern in ("*/fit.h5", "*/*/fit.h5") for file in place.glob(pattern)]
    found += [place] if (place / "fit.h5").is_file() else []
    found.sort(key=lambda one: (-SequenceMatcher(None, one.stem, path.stem).ratio(), one))
    names = [shell(one) for one in found[:3]]
    if not names and (path / "campaign.toml").is_file():
        return f"; fit its campaign first: sysid fit {shell(path)}"
    return f"; did you mean {' or '.join(names)}?" if names else ""


@contextmanager
def _opened(path: str | Path) -> Iterator[tuple[Any, ParameterSets]]:
    """Open a fit folder, or its ``fit.h5``; give the file and the sets in it.

    Raises FitError when that is missing, foreign, damaged or cut off, or it or ``fit.json`` beside it has
    changed.
    """
    path = Path(path)
    file_path = path / "fit.h5" if path.is_dir() else path
    if file_path.is_file() and file_path.suffix.lower() not in (".h5", ".hdf5"):
        raise FitError(
            f"{path}: is a {file_path.suffix or 'single'} file, which has neither runs nor trials; name the "
            "folder that sysid fit-motor or fit-gear wrote"
        )
    if not file_path.is_file():
        lacks = "no fit.h5 there" if path.is_dir() else "is not there"
        wanted = "expected a folder that sysid fit-motor or fit-gear wrote"
        absent = FitError(f"{path}: {lacks}; {wanted}{_meant(path)}")
        raise absent.also(FileNotFoundError)
    with FIT_FILE.opened(file_path) as file:
        check_unchanged(file_path.parent)
        group = file["sets"]
        yield (
            file,
            ParameterSets.from_metadata(
                SetsMetadata.parse(get_texts(file, "metadata_json"), file_path, FitError),
                **{name: group[name][()] for name in ("values", "nrmse", "at_bound", "nrmse_by_trial")},
            ),
        )


def read_sets(path: str | Path) -> ParameterSets:
    """Return the ranked sets of a fit without its runs and trajectories; raises as `read_fit`."""
    with _opened(path) as (_, sets):
        return sets


def read_fit(path: str | Path) -> FitResult:
    """Return a fit from its folder or ``fit.h5``; FitError for one missing, foreign, damaged or changed."""
    with _opened(path) as (file, sets):
        return FitResult(
            **content_of(sets),
            trials=tuple(map(_read_trial, numbered(file, "trials"))),
            state=file.attrs["state"],
            runs=tuple(
                RunHistory(int(run.attrs["seed"]), tuple(map(_read_stage, numbered(run, "stages"))))
                for run in numbered(file, "runs")
            ),
            set_runs=sets.runs,
            set_seeds=sets.seeds,
            cube=file["sets/cube"][()],
        )


def check_unchanged(folder: Path) -> None:
    """Refuse a ``fit.json`` that cannot be read, or states another SHA-256 than it or fit.h5 has.

    Those of the first versions state none.
    """
    path = folder / "fit.json"
    if not path.is_file():
        return
    remedy = "restore the file that was changed; without fit.json the folder is read as fit.h5 has it"
    try:
        content = path.read_bytes()
        document = SetsDocument.parse(content, path, FitError)
    except (FitError, OSError) as error:
        raise FitError(f"{str(error).removesuffix('; ' + SetsDocument.REMEDY)}; {remedy}") from error
    if name := document.changed(path, content):
        raise FitError(f"{path}: {name} has changed since sysid wrote it (another SHA-256); {remedy}")


def _read_stage(group: Any) -> StageHistory:
    counts = group["failed_by_cause"]
    causes = exact_json.loads(counts.attrs["causes"])
    return StageHistory(
        algorithm=group.attrs["algorithm"],
        cube=group["cube"][()],
        cost=group["cost"][()],
        failed=group["failed"][()],
        causes=tuple(
            {name: int(count) for name, count in zip(causes, row, strict=True) if count} for row in counts[()]
        ),
        evaluations=int(group.attrs["evaluations"]),
        simulations=int(group.attrs["simulations"]),
        wall_time=float(group.attrs["wall_time"]),
        stop_reason=group.attrs["stop_reason"],
    )


def _read_trial(group: Any) -> TrialResult:
    arrays = {name: item[()] for name, item in group.items() if name != "spectrum"}
    spectrum = None
    if "spectrum" in group:
        spectrum = Spectrum(group["spectrum/frequency"][()], group["spectrum/density"][()])
    return TrialResult(name=group.attrs["name"], use=group.attrs["use"], spectrum=spectrum, **arrays)
