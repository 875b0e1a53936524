"""Landing maps and design studies: compute in blocks, write HDF5, draw, compare with real landings."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from sysid.journal import notice, tell
from sysid.landing.controllers import Controller
from sysid.landing.design_study import DesignStudy, design_study, designs, find_changes, fleets_of
from sysid.landing.drone import Motors
from sysid.landing.impulse import after_impulses, impulse_maps
from sysid.landing.maps import Fleets, landing_maps, map_identity
from sysid.landing.outcomes import OUTCOMES
from sysid.landing.real_landings import Experiment, confusion, of_map, read_experiments, strangers
from sysid.landing.settings import ImpulseSettings, MapSettings
from sysid.landing.static_limits import rigid_limits, set_down_limit
from sysid.landing.store import MapFile, write_maps, write_study
from sysid.report.design_figures import figure_design_study
from sysid.report.drawing import save_figure
from sysid.report.fold import print_lines, print_result, print_table
from sysid.report.landing_figures import DrawnLimits, figure_impulse, figure_of_file
from sysid.report.landing_tables import gains_table, maps_table
from sysid.report.table import listed
from sysid.resume import Computing
from sysid.workflows.landing_sources import check_result, chosen_controllers, compute_and_write, open_fleets
from sysid.workflows.options import DesignStudyOptions, ImpulseMapOptions, LandingMapOptions
from sysid.workflows.provenance import seen_from


def compute_landing_maps(options: LandingMapOptions) -> MapFile | None:
    """Compute, write, draw and print the maps of every surface under every controller; None if stopped."""
    picture = options.picture
    settings = replace(options.grid, pitch=options.pitch, horizontal_speed=options.horizontal_speed)
    check_result("map", options.out, options.compute.force, picture)
    fleets, origin = open_fleets(options.motors, options.sets, options.out)
    controllers = chosen_controllers(
        options.controllers, settings.rules.horizon, file=options.controller_file,
        ideal_reversal=options.motors.ideal_reversal, trigger=options.trigger,
    )  # fmt: skip
    real = read_experiments(options.experiments) if options.experiments else ()
    maps = [(fleet[0].surface, controller) for fleet in fleets for controller in controllers]
    if lost := strangers(real, maps):
        names = ", ".join(f"{surface} {label!r} ({count})" for (surface, label), count in lost.items())
        known = ", ".join(f"{surface} {controller.label!r}" for surface, controller in maps)
        notice(
            "landings-without-map",
            f"{options.experiments}: {sum(lost.values())} of {len(real)} real landings belong to no "
            f"map and are left out: {names}; the maps are {known}",
        )

    def compute(how: Computing) -> MapFile | None:
        more: dict[str, object] = {}
        if options.controller_file is not None:
            more["controller_file"] = seen_from(options.out.parent, options.controller_file)
        if options.experiments:
            more["real_landings"] = [asdict(landing) for landing in real]
        return controlled_maps(fleets, origin, controllers, settings, how, more)

    def write(content: MapFile) -> None:
        write_maps(options.out, content)
        save_figure(figure_of_file(content), picture)

    identity = map_identity(fleets, controllers, settings)
    blocks = (sum(map(len, fleets)) * len(controllers), "landings")
    content = compute_and_write(options.out, identity, blocks, compute, write, options=options.compute)
    if content is not None:
        _print(content, options, picture, real if options.experiments else None)
    return content


def compute_impulse_maps(options: ImpulseMapOptions) -> MapFile | None:
    """Search the best impulse of every cell and set, land with it, write and draw; None if stopped."""
    picture = options.picture
    impulse_picture = picture.with_name(f"{picture.stem}-impulse{picture.suffix}")
    settings = options.grid
    impulses = replace(options.impulses, ideal_reversal=options.motors.ideal_reversal)
    impulses = replace(impulses, rear=impulses.rear_pair)
    check_result("map", options.out, options.compute.force, picture, impulse_picture)
    impulses.check_within(settings.rules.horizon)
    fleets, origin = open_fleets(options.motors, options.sets, options.out)

    def compute(how: Computing) -> MapFile | None:
        return impulsive_maps(fleets, origin, settings, impulses, how)

    def write(content: MapFile) -> None:
        write_maps(options.out, content)
        save_figure(figure_impulse(content.impulses), impulse_picture)
        save_figure(figure_of_file(content), picture)

    identity = map_identity(fleets, (), settings) | {"impulse_search": asdict(impulses)}
    blocks = (sum(map(len, fleets)) * len(settings.slopes_deg), "cells")
    content = compute_and_write(options.out, identity, blocks, compute, write, options=options.compute)
    if content is None:
        return None
    tried = sum(best.optimum["delay"].size for best in content.impulses) * impulses.combinations
    simulated = sum(int(best.optimum["simulated"].sum()) for best in content.impulses)
    tell(
        f"{tried} combinations of delay and duration judged by {simulated} landings to the second "
        "impact; every other combination equals one of them, because the commands differ after it only"
    )
    _print(content, options, picture, None)
    return content


def controlled_maps(
    fleets: Fleets,
    origin: Mapping[str, object],
    controllers: Sequence[Controller],
    settings: MapSettings,
    how: Computing,
    more: Mapping[str, object] | None = None,
) -> MapFile | None:
    """Return the maps under every controller with what their file states, and `more`; None if stopped."""
    maps = landing_maps(fleets, controllers, settings, how)
    stated = asdict(settings) | {"controllers": [asdict(controller) for controller in controllers]}
    stated |= {"static_limits": limits_of(fleets, controllers), **(more or {})}
    return MapFile(maps, (), stated, origin) if maps else None


def impulsive_maps(
    fleets: Fleets,
    origin: Mapping[str, object],
    settings: MapSettings,
    impulses: ImpulseSettings,
    how: Computing,
) -> MapFile | None:
    """Return the best impulses and the maps of landings with them, as a file has them; None if stopped."""
    best, maps = impulse_maps(fleets, settings, impulses, how)
    stated = asdict(settings) | {"impulses": asdict(impulses)}
    stated["static_limits"] = limits_of(fleets, after_impulses(impulses))
    return MapFile(maps, best, stated, origin) if maps else None


def limits_of(fleets: Fleets, controllers: Sequence[Controller]) -> list[dict[str, object]]:
    """Return the static limits of each surface's first set under each controller's last command.

    The keys of each are ``surface``, ``controller`` and the fields of `DrawnLimits`.
    """
    out = []
    for fleet in fleets:
        drone = fleet[0]
        for controller in controllers:
            # Toward the ground, once the last command has settled [N].
            thrust = Motors(drone, controller.ideal_reversal).propulsion(controller.steps)
            push = -float(sum(pair(pair.knots[-1]) for pair in (thrust.rear, thrust.front)))
            if push <= -drone.weight:
                continue  # the motors carry the drone, so there is no static limit
            rigid = rigid_limits(drone.gear, drone.surface, push).first.slope
            bending = set_down_limit(drone.gear, drone.surface, push).slope
            limit = DrawnLimits(push, float(np.degrees(rigid)), float(np.degrees(bending)))
            out.append({"surface": drone.surface, "controller": controller.label} | asdict(limit))
    return out


def _print(
    content: MapFile,
    options: LandingMapOptions | ImpulseMapOptions,
    picture: Path,
    real: Sequence[Experiment] | None,
) -> None:
    """Print the maps in numbers; `real` landings, if any were given, are compared with them."""
    counts = [drawn.summary() for drawn in content.maps]
    for entry, drawn in zip(counts, content.maps, strict=True):
        if entry["lost"]:
            sentence = f"{drawn.title}: {entry['lost']} landings could not be simulated and count nowhere"
            notice("lost-landings", sentence)
        if real is not None:
            entry["real_landings"] = confusion(of_map(real, drawn), drawn).document()
    document = {"file": str(options.out), "figure": str(picture), "maps": counts}
    if print_result(document, options.compute.json):
        return
    print_table(maps_table(counts))
    for drawn in content.maps:
        chosen = of_map(real or (), drawn)
        if not chosen:
            continue
        compared = confusion(chosen, drawn)
        total = int(compared.counts.sum())
        sentence = f"{drawn.title}: {compared.agreeing} of {total} real landings agree with the likeliest "
        sentence += "class of their cell"
        sentence += f", {compared.outside} outside the map" if compared.outside else ""
        sentence += f", {compared.lost} in cells that could not be simulated" if compared.lost else ""
        # Above the table: a title would be folded to the width of the few short columns.
        print_lines([sentence])
        rows = [
            (word, "", *map(str, counts))
            for word, counts in zip(compared.words, compared.counts.tolist(), strict=True)
        ]
        heads = ("observed", "simulated:", *(outcome.name.lower() for outcome in OUTCOMES))
        print_table(listed("", rows, heads, texts=2))
    print(f"wrote {options.out} and {picture}")


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
        return design_study(fleet[0].sets, fleet, changes, controller, settings, where)

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
