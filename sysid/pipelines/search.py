"""What every fit shares: overrides, the search with its progress and Ctrl-C, warnings, provenance, folder."""

from __future__ import annotations

import os
import platform
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from sysid import __version__
from sysid.campaign import FitTable
from sysid.errors import CampaignError, SysidWarning
from sysid.fit.algorithms import ALGORITHMS
from sysid.fit.engine import FINISH_POPULATION, Hooks, SearchSettings, run_many
from sysid.fit.history import RunHistory
from sysid.fit.objective import Objective
from sysid.fit.progress import FitProgress
from sysid.fit.stopping import StopRule, stop_on_interrupt
from sysid.recording import file_sha256

_LIBRARIES = ("numpy", "scipy", "numba", "pymoo", "cma", "pandas", "h5py")


@dataclass(frozen=True)
class FitOptions:
    """What the command line may say beside the campaign.

    Parameters
    ----------
    out : Path, optional
        Result folder; default ``fits/NAME``.
    force : bool
        Replace an existing fit folder.
    population, runs, seed, max_generations : int, optional
        Override the campaign's `[fit]`.
    time_limit : float, optional
        Of the whole fit [s].
    threads : int, optional
        Cores; all by default. The result does not depend on it.
    quiet : bool
        No progress.
    algorithm : str, optional
        A key of `sysid.fit.algorithms.ALGORITHMS`; overrides the campaign's `[fit]`.
    finish : {"cmaes", "none"}, optional
        Overrides the campaign's `[fit]`.
    """

    out: Path | None = None
    force: bool = False
    population: int | None = None
    runs: int | None = None
    seed: int | None = None
    max_generations: int | None = None
    time_limit: float | None = None
    threads: int | None = None
    quiet: bool = False
    algorithm: str | None = None
    finish: str | None = None

    def folder(self, name: str) -> Path:
        """Return where a fit called `name` goes."""
        return self.out if self.out is not None else Path("fits") / name

    def settings(self, table: FitTable) -> SearchSettings:
        """Return the campaign's search settings with this command's overrides."""

        def chosen(name: str) -> int:
            own = getattr(self, name)
            return int(getattr(table, name) if own is None else own)

        return SearchSettings(
            population=chosen("population"),
            runs=chosen("runs"),
            seed=chosen("seed"),
            algorithm=self.algorithm or table.algorithm,
            finish=self.finish or table.finish,
            stop=StopRule(
                reading=table.stop_reading,
                window=table.stop_window,
                tolerance=table.stop_tolerance,
                max_generations=chosen("max_generations"),
                time_limit=self.time_limit,
            ),
        )


def search(
    objective: Objective, settings: SearchSettings, *, simulated: str, quiet: bool
) -> tuple[tuple[RunHistory, ...], bool]:
    """Run the search with live progress; Ctrl-C ends it after the generation and keeps what was found.

    Parameters
    ----------
    objective : Objective
        Scores points of the unit cube.
    settings : SearchSettings
        Population, runs, seed, stop rule.
    simulated : str
        What a simulation is called: ``drops``, ``trials``.
    quiet : bool
        No progress.

    Returns
    -------
    runs : tuple of RunHistory
        Those that were begun.
    interrupted : bool
        True when Ctrl-C ended it.
    """
    progress = FitProgress(settings, simulated, quiet)
    with stop_on_interrupt(progress.on_stop) as flag, progress:
        hooks = Hooks(progress.on_generation, progress.on_run, should_stop=flag)
        runs = run_many(objective, settings, hooks=hooks)
    return runs, any(run.stop_reason == "interrupted" for run in runs)


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
    except CampaignError as error:
        if str(campaign_path) in str(error):
            raise
        raise CampaignError(f"{campaign_path}: {error}") from error


def provenance(
    campaign_path: str | Path,
    settings: SearchSettings,
    denominator: str,
    filters: Mapping[str, Any],
    logs: Mapping[str, Any],
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
    """
    path = Path(campaign_path)
    return {
        "sysid": __version__,
        "python": platform.python_version(),
        "libraries": {name: _version(name) for name in _LIBRARIES},
        "system": f"{platform.system()} {platform.machine()}",
        "processor": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "written": datetime.now(UTC).isoformat(timespec="seconds"),
        "campaign": {"file": path.name, "sha256": file_sha256(path)},
        "logs": dict(logs),
        "filter": dict(filters),
        "nrmse_denominator": denominator,
        "search": {
            "algorithm": settings.algorithm,
            "what it is": ALGORITHMS[settings.algorithm],
            "finish": settings.finish,
            "finish_population": FINISH_POPULATION,
            "population": settings.population,
            "runs": settings.runs,
            "seed": settings.seed,
            "stop_reading": settings.stop.reading,
            "stop_window": settings.stop.window,
            "stop_tolerance": settings.stop.tolerance,
            "max_generations": settings.stop.max_generations,
            "time_limit [s]": settings.stop.time_limit,
        },
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
