"""A design study from files to files: sets in; HDF5, figure and table out; resumable."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.text import Text

from sysid import __version__, exact_json
from sysid.errors import CampaignError, ExportError
from sysid.executor import executor
from sysid.fit.stopping import stop_on_interrupt
from sysid.landing.blocks import BlockStore
from sysid.landing.controllers import find_controller
from sysid.landing.design_store import write_study
from sysid.landing.design_study import (
    SLOPES_DEG,
    SPEEDS,
    DesignStudy,
    StudySettings,
    design_study,
    designs,
    find_changes,
    fleets_of,
)
from sysid.landing.drone import drones
from sysid.landing.maps import map_identity
from sysid.pipelines.results import load_sets
from sysid.report.design_figures import figure_design_study
from sysid.report.figures import save_figure
from sysid.report.landing_tables import gains_table

_PLAIN_INTERVAL = 10.0


@dataclass(frozen=True)
class StudyOptions:
    """What the command line may say.

    Parameters
    ----------
    speeds : sequence of float
        Touchdown speeds [m/s].
    steepest_deg, step_deg : float
        End and step of the slopes [deg].
    share, spread_deg, together
        As in `sysid.landing.design_study.StudySettings`.
    ideal_reversal : bool
        Motors without saturation.
    resume, force : bool
        Continue an unfinished study; replace a finished one.
    threads : int, optional
        Cores; the result is the same.
    dask : str, optional
        Address of a Dask scheduler, or ``local``.
    quiet : bool
        No progress, no table.
    """

    speeds: Sequence[float] = SPEEDS
    steepest_deg: float = SLOPES_DEG[-1]
    step_deg: float = 1.0
    share: float = 0.5
    spread_deg: float = 0.0
    together: bool = False
    ideal_reversal: bool = False
    resume: bool = False
    force: bool = False
    threads: int | None = None
    dask: str | None = None
    quiet: bool = False

    def settings(self) -> StudySettings:
        """Return the study's grid.

        Raises
        ------
        CampaignError
            For slopes that make no grid.
        """
        if not (0 < self.step_deg <= self.steepest_deg <= 80):
            raise CampaignError(
                f"slopes to {self.steepest_deg:g} deg in steps of {self.step_deg:g} deg; give a step above 0 "
                "and an end of at most 80 deg"
            )
        slopes = np.arange(0.0, self.steepest_deg + 1e-9, self.step_deg).round(9)
        return StudySettings(
            slopes_deg=tuple(slopes.tolist()),
            speeds=tuple(sorted(self.speeds)),
            share=self.share,
            spread_deg=self.spread_deg,
            together=self.together,
        )


def study_designs(
    gear: Path, motor: Path, vary: str, controller: str, out: Path, options: StudyOptions | None = None
) -> DesignStudy | None:
    """Compute a study and write `out` and the figure beside it.

    Parameters
    ----------
    gear, motor : Path
        Fit folders or parameter-set files.
    vary : str
        As `sysid.landing.design_study.find_changes` reads it.
    controller : str
        As `sysid.landing.controllers.find_controller` reads it.
    out : Path
        HDF5 file.
    options : StudyOptions, optional

    Returns
    -------
    DesignStudy or None
        None when it was stopped; what is finished is kept for ``--resume``.

    Raises
    ------
    SysidError
        Before anything is computed, where an input cannot be used.
    """
    own = options or StudyOptions()
    settings = own.settings()
    changes = find_changes(vary)
    sets, motor_sets = load_sets(gear), load_sets(motor)
    fleet = drones(sets, motor_sets)
    told = find_controller(controller, ideal_reversal=own.ideal_reversal)
    points = designs(changes, own.together)
    fleets = fleets_of(fleet, changes, points)
    for path in (out, out.with_suffix(".png")):
        if path.exists() and not (own.force or own.resume):
            raise ExportError(f"{path}: exists already; choose a new name or add --force")
    if out.suffix.lower() != ".h5" or not out.parent.is_dir():
        raise ExportError(f"{out}: give a file that ends in .h5, in a folder that exists")
    grids = settings.grids()
    stores: list[BlockStore] = []
    try:
        for number, grid in enumerate(grids):
            part = out if len(grids) == 1 else out.with_name(f"{out.stem}.{number + 1}{out.suffix}")
            identity = map_identity(fleets, [told], grid)
            stores.append(BlockStore(part, identity, resume=own.resume and _begun(part), force=own.force))
        total = len(grids) * len(points) * len(fleet) * len(settings.slopes_deg) * len(settings.speeds)
        with (
            Progress(total, own.quiet) as progress,
            stop_on_interrupt(progress.on_stop) as stop,
            executor(own.dask) as where,
        ):
            threads = 1 if own.dask else own.threads
            study = design_study(
                sets.name, fleet, changes, told, settings,
                where=where, threads=threads, stores=stores, on_block=progress.on_block, stop=stop,
            )  # fmt: skip
        if study is None:
            return None
        provenance = {
            "sysid": __version__,
            "gear": {"name": sets.name, "provenance": sets.provenance},
            "motor": {"name": motor_sets.name, "provenance": motor_sets.provenance},
        }
        write_study(out, study, provenance)
        save_figure(figure_design_study(study), out.with_suffix(".png"))
        for store in stores:
            store.discard()
        stores = []
        return study
    finally:
        for store in stores:
            store.close()


def _begun(part: Path) -> bool:
    """Whether blocks of it lie there: of a study stopped early the later attitudes have none."""
    from sysid.landing.blocks import blocks_folder

    return any(blocks_folder(part).glob("*.npz"))


def print_study(study: DesignStudy | None, out: Path, json: bool = False, quiet: bool = False) -> None:
    """Print which change buys most, or that the study was stopped."""
    if study is None:
        print(f"stopped; what is finished is kept beside {out}: continue with --resume")
        return
    gains = study.gains()
    base = dict(zip((f"{v:g} m/s" for v in study.settings.speeds), study.steepest[0].tolist(), strict=True))
    if json:
        document: dict[str, Any] = {"name": study.name, "controller": study.controller}
        document |= {"as it is, largest safe slope [deg]": base, "changes": gains, "file": str(out)}
        print(exact_json.dumps(document))
        return
    if not quiet:
        Console().print(gains_table(study.name, base, gains))
        print(f"wrote {out} and {out.with_suffix('.png')}")


class Progress:
    """Says on standard error how many landings are done and how long the rest will take.

    Parameters
    ----------
    total : int
        Landings.
    quiet : bool
        Say nothing.
    """

    def __init__(self, total: int, quiet: bool = False) -> None:
        self._total, self._quiet = total, quiet
        self._done = self._new = 0
        self._console = Console(stderr=True)
        self._live: Live | None = None
        self._began = self._said = time.perf_counter()

    def __enter__(self) -> Self:
        self._began = self._said = time.perf_counter()
        if not self._quiet and self._console.is_terminal:
            self._live = Live(console=self._console, refresh_per_second=4, transient=True)
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def on_block(self, landings: int, computed: bool) -> None:
        """Count a block."""
        self._done += landings
        self._new += landings if computed else 0
        if self._quiet:
            return
        if self._live is not None:
            self._live.update(Text(self.line(), no_wrap=True, overflow="ellipsis"))
        elif time.perf_counter() - self._said >= _PLAIN_INTERVAL:
            self._said = time.perf_counter()
            self._console.print(Text(self.line()), soft_wrap=True)

    def on_stop(self) -> None:
        """Say that Ctrl-C was heard."""
        if not self._quiet:
            self._console.print(Text("stopping and keeping what is finished; Ctrl-C again aborts"))

    def line(self) -> str:
        """Return the progress line."""
        spent = time.perf_counter() - self._began
        rate = self._new / spent if spent > 0 else 0.0
        left = f"{(self._total - self._done) / rate:.0f} s" if rate > 0 else "-"
        return f"{self._done} of {self._total} landings  {rate:.0f}/s  left {left}"
