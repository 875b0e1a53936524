"""A design study from files to files: sets in; HDF5, figure and table out; resumable."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from sysid.journal import notice
from sysid.landing.design_study import (
    DesignStudy,
    design_study,
    designs,
    find_changes,
    fleets_of,
)
from sysid.landing.maps import map_identity
from sysid.landing.store import write_study
from sysid.report.design_figures import figure_design_study
from sysid.report.drawing import save_figure
from sysid.report.fold import print_result, print_table
from sysid.report.landing_tables import gains_table
from sysid.resume import Computing
from sysid.workflows.landing_sources import (
    check_result,
    chosen_controllers,
    compute_and_write,
    open_fleets,
)
from sysid.workflows.options import DesignStudyOptions
from sysid.workflows.provenance import seen_from


def study_designs(options: DesignStudyOptions) -> DesignStudy | None:
    """Compute a study, write it and its figure, and print what each change buys; None if stopped.

    Raises `SysidError` before anything is computed, where an input cannot be used.
    """
    how, motors, settings = options.compute, options.motors, options.study
    picture = options.out.with_suffix(".png")
    check_result("study", options.out, how.force, picture)
    changes = find_changes(options.vary)
    (fleet,), origin = open_fleets(motors, [options.sets], options.out)
    (controller,) = chosen_controllers(
        [options.controller], settings.rules.horizon, file=options.controller_file,
        ideal_reversal=motors.ideal_reversal,
    )  # fmt: skip
    points = designs(changes, settings.together)
    fleets = fleets_of(fleet, changes, points)
    grids = settings.grids()
    for grid in grids:
        grid.cells()  # refuses an attitude that cannot touch down before any map is computed

    def compute(where: Computing) -> DesignStudy | None:
        name = fleet[0].name.rsplit(" ", 2)[0]
        return design_study(name, fleet, changes, controller, settings, where)

    def write(study: DesignStudy) -> None:
        more: dict[str, object] = {"controller": asdict(controller)}
        if options.controller_file is not None:
            more["controller_file"] = seen_from(options.out.parent, options.controller_file)
        write_study(options.out, study, origin | more)
        save_figure(figure_design_study(study), picture)

    identity = map_identity(fleets, [controller], *grids)
    blocks = (len(grids) * len(points) * len(fleet), "landings")
    study = compute_and_write(options.out, identity, blocks, compute, write, options=how)
    if study is None:
        return None
    lost = int(study.lost.sum())
    if lost:
        notice(
            "lost-landings",
            f"{lost} landings of {np.count_nonzero(study.lost)} of {len(study.points)} designs "
            "could not be simulated and count nowhere; a slope on which none could counts as not safe",
        )
    if how.json:
        print_result({
            "name": study.name, "controller": study.controller, "speeds": list(study.settings.speeds),
            "steepest_deg": study.steepest[0].tolist(), "at_edge": study.at_edge[0].tolist(),
            "changes": study.gains(), "lost": lost, "file": str(options.out),
        }, json=True)  # fmt: skip
    else:
        print_table(gains_table(study))
        print(f"wrote {options.out} and {picture}")
    return study
