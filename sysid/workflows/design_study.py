"""A design study from files to files: sets in; HDF5, figure and table out; resumable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from sysid import exact_json
from sysid.errors import ExportError
from sysid.fit.stopping import stop_on_interrupt
from sysid.landing.design_store import write_study
from sysid.landing.design_study import (
    LOWER_BOUNDS,
    DesignStudy,
    StudySettings,
    design_study,
    designs,
    find_changes,
    fleets_of,
)
from sysid.landing.maps import map_identity
from sysid.parallel import executor
from sysid.report.design_figures import figure_design_study
from sysid.report.fit_plots import save_figure
from sysid.report.landing_tables import gains_table
from sysid.resume import BlockStore, blocks_folder
from sysid.workflows.landing_sources import BlockProgress, LandingFiles, LandingOptions

# Blocks that share a cluster at the same time.
_AT_ONCE = 8


def study_designs(
    gear: Path, sources: LandingOptions, vary: str, settings: StudySettings, files: LandingFiles
) -> DesignStudy | None:
    """Compute a study, write it and its figure, and print what each change buys.

    Parameters
    ----------
    gear : Path
        Fit folder or parameter-set file.
    sources : LandingOptions
        Motors and the one controller.
    vary : str
        As `sysid.landing.design_study.find_changes` reads it.
    settings : StudySettings
    files : LandingFiles

    Returns
    -------
    DesignStudy or None
        None when it was stopped; what is finished is kept for ``--resume``.

    Raises
    ------
    SysidError
        Before anything is computed, where an input cannot be used.
    """
    files.check("study")
    changes = find_changes(vary)
    (fleet,), origin = sources.fleets([gear])
    (told,) = sources.told(settings.maps.rules.horizon)
    points = designs(changes, settings.together)
    fleets = fleets_of(fleet, changes, points)
    grids = settings.grids()
    for grid in grids:
        grid.cells()  # refuses an attitude that cannot touch down before any map is computed
    parts = _parts(files.out, len(grids))
    if files.resume and not any(blocks_folder(part).is_dir() for part in parts):
        raise ExportError(f"{files.out}: nothing unfinished to continue is there; start without --resume")
    stores: list[BlockStore] = []
    progress = BlockProgress(len(grids) * len(points) * len(fleet), "landings", files.quiet or files.json)
    try:
        for part, grid in zip(parts, grids, strict=True):
            # A study that was stopped early may have no block of its later maps.
            begun = any(blocks_folder(part).glob("*.npz"))
            identity = map_identity(fleets, [told], grid)
            stores.append(BlockStore(part, identity, resume=files.resume and begun, force=files.force))
        with (
            executor(files.dask, _AT_ONCE) as where,
            stop_on_interrupt(progress.on_stop) as stop,
            progress,
        ):
            study = design_study(
                fleet[0].name.removesuffix(" set 1"), fleet, changes, told, settings,
                where=where, threads=1 if files.dask else files.threads, stores=stores,
                on_block=progress.on_block, stop=stop,
            )  # fmt: skip
        if study is not None:
            write_study(files.out, study, origin | {"controller": told.document()})
            save_figure(figure_design_study(study), files.picture)
            for store in stores:
                store.discard()
            stores = []
    finally:
        for store in stores:
            store.close()
    _print(study, files)
    return study


def _parts(out: Path, count: int) -> list[Path]:
    """Return the name under which the blocks of each of `count` maps are kept."""
    if count == 1:
        return [out]
    return [out.with_name(f"{out.stem}.{n + 1}{out.suffix}") for n in range(count)]


def _print(study: DesignStudy | None, files: LandingFiles) -> None:
    if study is None:
        if not files.quiet:
            Console(stderr=True).print(
                f"stopped: what is finished is kept beside {files.out}; continue with --resume"
            )
        return
    lost = int(study.lost.sum())
    if lost and not files.quiet:
        Console(stderr=True).print(
            f"warning: {lost} landings of {np.count_nonzero(study.lost)} of {len(study.points)} designs "
            "could not be simulated and count nowhere; a slope on which none could counts as not safe",
            soft_wrap=True,
        )
    gains = study.gains()
    speeds = [f"{speed:g} m/s" for speed in study.settings.speeds]
    base = dict(zip(speeds, study.steepest[0].tolist(), strict=True))
    if files.json:
        document: dict[str, Any] = {"name": study.name, "controller": study.controller}
        document |= {"as it is, largest safe slope [deg]": base, LOWER_BOUNDS: study.bounds(0)}
        document |= {"changes": gains, "lost": lost, "file": str(files.out)}
        print(exact_json.dumps(document))
    elif not files.quiet:
        Console().print(gains_table(study.name, base, gains, study.bounds(0)))
        print(f"wrote {files.out} and {files.picture}")
