"""What every fit shares: overrides, the search with its progress and Ctrl-C, warnings, provenance, folder."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sysid import __version__, exact_json
from sysid.campaign import FitTable
from sysid.errors import CampaignError, FitError, SysidWarning, UnitError
from sysid.fit.breeders.algorithms import DEFAULT_ALGORITHM, POPULATION, breeder
from sysid.fit.breeders.in_process import BreederApart
from sysid.fit.checkpoint import PROBES, PROCESSOR, Checkpoint, checkpoint_folder, run_numbers
from sysid.fit.history import RunHistory
from sysid.fit.objective import Objective, SpreadObjective
from sysid.fit.optima import agreement, waterfall
from sysid.fit.progress import FitProgress
from sysid.fit.result import FitResult
from sysid.fit.search import FINISH_POPULATION, Hooks, SearchSettings, run_many
from sysid.fit.stopping import CutReason, StopFlag, StopRule
from sysid.fit.store import check_new_fit, write_fit
from sysid.parallel import executor
from sysid.parameters import SearchSpace
from sysid.recording import file_sha256
from sysid.resume import held
from sysid.workflows.options import FitOptions as FitOptions

# Runs that share a cluster at the same time: while one breeds, the others keep its workers busy.
_RUNS_AT_ONCE = 8
# Workers that one process can breed for: a candidate takes 0.1 ms to breed and 3 ms to simulate.
_FED_BY_ONE = 16
# Candidates that are scored to recognise an objective.
_PROBES = 4
_LIBRARIES = ("numpy", "scipy", "numba", "pymoo", "cma", "pandas", "h5py")


def search_settings(options: FitOptions, table: FitTable) -> SearchSettings:
    """Return the campaign's search settings with the command's overrides."""

    def chosen(name: str) -> int:
        override = getattr(options, name)
        return int(getattr(table, name) if override is None else override)

    algorithm = options.algorithm or table.algorithm or DEFAULT_ALGORITHM
    return SearchSettings(
        population=options.population or table.population or POPULATION[algorithm],
        runs=chosen("runs"),
        seed=chosen("seed"),
        algorithm=algorithm,
        finish=options.finish or table.finish,
        stop=StopRule(
            reading=table.stop_reading,
            window=table.stop_window,
            tolerance=table.stop_tolerance,
            max_generations=chosen("max_generations"),
            max_evaluations=options.max_evaluations,
            time_limit=options.time_limit,
        ),
    )


@dataclass
class Search:
    """What a search found, and the hold on its folder until the result is written.

    Parameters
    ----------
    runs : tuple of RunHistory
        Those that were begun.
    cut : {"interrupted", "time"}, optional
        What cut the fit short, its runs or what follows them; `--resume` goes on.
    warnings : tuple of str
        What the runs say against each other, and what was noticed of a checkpoint.
    """

    runs: tuple[RunHistory, ...]
    cut: CutReason | None
    warnings: tuple[str, ...]
    _checkpoint: Checkpoint = field(repr=False)

    @property
    def state(self) -> Literal["done", "stopped"]:
        """What a result says of the fit."""
        return "done" if self.cut is None else "stopped"

    def close(self) -> None:
        """Let other processes in."""
        self._checkpoint.close()

    def write(self, result: FitResult, folder: Path, options: FitOptions) -> Path:
        """Write the fit folder; what is done needs no checkpoint any more."""
        path = write_fit(result, folder, options.force or options.resume)
        if self.state == "done":
            self._checkpoint.discard()
        else:
            self._checkpoint.close()
        return path


def check_start(folder: Path, options: FitOptions) -> None:
    """Refuse a fit that is there, or one that cannot be continued, before the hours of a fit are spent.

    Raises
    ------
    FitError
        When another process works on the fit; when the folder holds a fit and neither `force` nor `resume`
        is on; when an unfinished fit is there; when there is nothing to resume.
    """
    unfinished_runs = run_numbers(checkpoint_folder(folder))
    if held(checkpoint_folder(folder)):
        raise FitError(Checkpoint.running(folder))
    if options.resume:
        if options.force:
            raise FitError("--resume continues a fit and --force discards it; choose one")
        if not unfinished_runs:
            raise FitError(f"{folder}: no unfinished fit to continue is there; start it without --resume")
        check_new_fit(folder, force=True)
        return
    if unfinished_runs and not options.force:
        raise FitError(Checkpoint.in_the_way(folder))
    check_new_fit(folder, options.force)


def search(
    objective: Objective,
    settings: SearchSettings,
    *,
    folder: Path,
    options: FitOptions,
    identity: Mapping[str, Any],
    progress: FitProgress,
    flag: StopFlag,
    tell: Callable[[str], None],
) -> Search:
    """Run the search with live progress and checkpoints; a set flag ends it and keeps what was found.

    Parameters
    ----------
    objective : Objective
        Scores points of the unit cube.
    settings : SearchSettings
        Algorithm, population, runs, seed, stop rule.
    folder : Path
        Result folder of the fit; its checkpoint lies beside it.
    options : FitOptions
        Resume, force, quiet.
    identity : mapping
        What must be equal for a fit to be continued; see `fit_identity`.
    progress : FitProgress
        Told of every generation.
    flag : StopFlag
        Set by Ctrl-C.
    tell : callable
        Told one sentence at a time.

    Raises
    ------
    FitError
        When another process works on the fit, or it cannot be continued.
    """
    # What no hash of a log or a table covers (a static log, a kernel) shows in the costs of some candidates.
    points = np.random.default_rng(0).random((_PROBES, len(objective.space.free)))
    began = time.perf_counter()
    costs = [float(cost).hex() for cost in objective.evaluate(points).cost]
    # With what is loaded or compiled on the way rather too long, which only makes the first part shorter.
    candidate_time = (time.perf_counter() - began) / _PROBES
    identity = {**identity, PROBES: costs, PROCESSOR: processor()}
    checkpoint = Checkpoint(folder, identity, resume=options.resume, force=options.force)
    try:
        for note in checkpoint.notes:
            tell(f"warning: {note}")
        if checkpoint.memories:
            done = sum(len(stage.cost) for memory in checkpoint.memories for stage in memory.stages)
            tell(f"continuing {len(checkpoint.memories)} runs after {done} generations")
        with executor(options.dask, min(settings.runs, _RUNS_AT_ONCE)) as where, progress:
            hooks = Hooks(progress.on_generation, progress.on_run, checkpoint.keep, flag)
            runs = run_many(
                SpreadObjective(objective, where),
                settings,
                memories=checkpoint.memories,
                hooks=hooks,
                at_once=where.at_once,
                breeds=BreederApart if _breeds_apart(options.dask) else breeder,
                candidate_time=candidate_time,
            )
    except BaseException:
        checkpoint.close()
        raise
    ended = {stage.stop_reason for run in runs for stage in run.stages}
    # Runs that were not begun have been called off.
    called_off = "interrupted" in ended or len(runs) < settings.runs
    cut: CutReason | None = "interrupted" if called_off else "time" if "time" in ended else None
    found = agreement(runs, settings.runs, objective.space.free)
    if len(runs) > 1:
        for line in waterfall(runs, objective.space.free):
            tell(line)
    tell(found.sentence())
    doubts = () if found.agrees and len(runs) > 1 else (found.sentence(),)
    return Search(runs, cut, (*checkpoint.notes, *doubts), checkpoint)


def _breeds_apart(dask: str | None) -> bool:
    """Return whether one process would breed too slowly for the workers; each further one costs a start."""
    return dask is not None and (dask != "local" or (os.cpu_count() or 1) > _FED_BY_ONE)


def fit_identity(
    campaign_path: str | Path,
    settings: SearchSettings,
    space: SearchSpace,
    logs: Mapping[str, str],
    **more: Any,
) -> dict[str, Any]:
    """Return what must be equal for a fit to be continued; see `sysid.resume.Unfinished`.

    Parameters
    ----------
    campaign_path : str or Path
        Hashed.
    settings : SearchSettings
        Of the search. More runs, or another time limit, do not hinder.
    space : SearchSpace
        Free parameters with their bounds, values of all others.
    logs : mapping of str to str
        SHA-256 of every log, by name.
    **more
        Anything else that the command line can change.
    """
    rows = [[str(value) for value in vars(row).values()] for row in (*space.table.values(), *space.free)]
    table = exact_json.dumps([rows, dict(space.fixed)], indent=None)
    stop = settings.stop.share(settings.runs)
    return {
        "campaign_file": file_sha256(Path(campaign_path)),
        **{f"log {name}": digest for name, digest in logs.items()},
        "parameter_table": hashlib.sha256(table.encode()).hexdigest(),
        "version_of_sysid": __version__,
        "algorithm": settings.algorithm,
        "finisher": settings.finish,
        "population": settings.population,
        "seed": settings.seed,
        "stop_rule": [stop.reading, stop.window, stop.tolerance, stop.max_generations],
        "evaluation_budget_of_a_run": stop.max_evaluations,
        **more,
    }  # fmt: skip


@contextmanager
def collected_warnings(say: Callable[[str], None] | None) -> Iterator[list[str]]:
    """Collect SysidWarnings as sentences, each once, and say them as they come; pass others on."""
    sentences: list[str] = []
    show = warnings.showwarning

    def collect(message: Warning | str, category: type[Warning], *rest: Any, **more: Any) -> None:
        if not issubclass(category, SysidWarning):
            show(message, category, *rest, **more)
            return
        text = str(message)
        if text not in sentences:
            sentences.append(text)
            if say is not None:
                say(text)

    with warnings.catch_warnings():
        warnings.simplefilter("always", SysidWarning)
        warnings.showwarning = collect
        yield sentences


@contextmanager
def naming(campaign_path: str | Path) -> Iterator[None]:
    """Put the campaign's path before a complaint about its content."""
    try:
        yield
    except (CampaignError, UnitError) as error:
        if str(campaign_path) in str(error):
            raise
        raise CampaignError(f"{campaign_path}: {error}") from error


def provenance(
    campaign_path: str | Path,
    settings: SearchSettings,
    denominator: str,
    filters: Mapping[str, Any],
    logs: Mapping[str, Any],
    folder: Path,
    axes: Sequence[str],
) -> dict[str, Any]:
    """Return what a reader needs to repeat or doubt a fit.

    Parameters
    ----------
    campaign_path : str or Path
        Hashed and stored by name.
    settings : SearchSettings
        Of the search.
    denominator : str
        Of the NRMSE.
    filters : mapping
        Filter design.
    logs : mapping
        Per trial: file, hash, what was noticed.
    folder : Path
        Of the fit: where the campaign lies is stored as seen from there.
    axes : sequence of str
        Parameters along the axes of the runs' cube, in their order.
    """
    path = Path(campaign_path)
    return {
        "sysid": __version__,
        "git_revision": _git_revision(),
        "python": platform.python_version(),
        "libraries": {name: _version(name) for name in _LIBRARIES},
        "system": f"{platform.system()} {platform.machine()}",
        "processor": processor(),
        "cores": os.cpu_count(),
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
        "campaign": {
            "file": path.name,
            "sha256": file_sha256(path),
            "from_fit_folder": seen_from(folder, path),
        },
        "logs": dict(logs),
        "filter": dict(filters),
        "nrmse_denominator": denominator,
        "search": {
            "algorithm": settings.algorithm,
            "finish": settings.finish,
            "finish_population": FINISH_POPULATION,
            "population": settings.population,
            "runs": settings.runs,
            "axes": list(axes),
            "seed": settings.seed,
            "run_seeds": list(settings.run_seeds()),
            "stop_reading": settings.stop.reading,
            "stop_window": settings.stop.window,
            "stop_tolerance": settings.stop.tolerance,
            "max_generations": settings.stop.max_generations,
            "max_evaluations": settings.stop.max_evaluations,
            "time_limit": settings.stop.time_limit,
        },
    }


def seen_from(folder: Path, path: Path) -> str:
    """Return where a file lies, seen from a folder; absolute where they share no drive."""
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:
        return path.resolve().as_posix()


def processor() -> str:
    """Return the processor's model: equal bits are promised on equal processors only."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _git_revision() -> str | None:
    """Return the revision of the sources that run, where they lie in a git repository."""
    folder = Path(__file__).resolve().parents[2]
    if not (folder / ".git").exists():
        return None
    command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=5, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
