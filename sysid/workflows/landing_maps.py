"""Landing maps from the command line: compute in blocks, write HDF5, draw, compare with real landings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sysid import exact_json
from sysid.fit.stopping import stop_on_interrupt
from sysid.landing.controllers import Controller
from sysid.landing.drone import Drone
from sysid.landing.impulse import ImpulseSettings
from sysid.landing.impulse_maps import after_impulses, impulse_identity, impulse_maps
from sysid.landing.map_store import MapFile, summary, write_maps
from sysid.landing.maps import LandingMap, MapSettings, landing_maps, map_identity
from sysid.landing.outcomes import OUTCOMES
from sysid.landing.real_landings import Experiment, confusion, of_map, read_experiments, strangers
from sysid.landing.static_limits import ramp_limit, rigid_limits
from sysid.landing.thrust import Motors
from sysid.parallel import executor
from sysid.report.fit_plots import save_figure
from sysid.report.landing_figures import DrawnLimits, figure_impulse, figure_landing_maps
from sysid.resume import BlockStore
from sysid.workflows.landing_sources import BlockProgress, LandingFiles, LandingOptions

Say = Callable[[str], None] | None
# Blocks that share a cluster at the same time.
_AT_ONCE = 8


@dataclass(frozen=True)
class MapOptions(LandingFiles):
    """What the command line says of a map, besides `LandingFiles`.

    Parameters
    ----------
    figure : Path, optional
        Where else the figure goes.
    experiments : Path, optional
        Real landings (CSV).
    """

    figure: Path | None = None
    experiments: Path | None = None

    @property
    def picture(self) -> Path:
        """Where the figure goes."""
        return self.figure or super().picture

    @property
    def impulse_picture(self) -> Path:
        """Where the figure of the best impulses goes."""
        return self.picture.with_name(f"{self.picture.stem}-impulse{self.picture.suffix}")


def compute_landing_maps(
    gears: Sequence[Path],
    sources: LandingOptions,
    settings: MapSettings,
    options: MapOptions,
    say: Say = None,
) -> MapFile | None:
    """Compute, write, draw and print the maps of every surface under every controller; None if stopped."""
    options.check("map")
    fleets, origin = sources.fleets(gears)
    told = sources.told(settings.rules.horizon)
    real = read_experiments(options.experiments) if options.experiments else ()
    _warn_of_strangers(options, real, [(f[0].surface, one.label) for f in fleets for one in told], say)
    identity = map_identity(fleets, told, settings)
    blocks = sum(len(fleet) for fleet in fleets) * len(told)

    def compute(**how: Any) -> tuple[tuple[LandingMap, ...], tuple[()]]:
        return landing_maps(fleets, told, settings, **how), ()

    def write(maps: tuple[LandingMap, ...], _: Any) -> MapFile:
        document = settings.document() | {"controllers": [one.document() for one in told]}
        if options.experiments:
            document["real landings"] = [asdict(one) for one in real]
        content = MapFile(maps, (), document, origin)
        write_maps(options.out, content)
        _draw_maps(content, options, settings, static_lines(fleets, told), real)
        return content

    content = _computed(compute, write, identity, blocks, "landings", options, say)
    if content is not None:
        _print(content, options, real, say)
    return content


def compute_impulse_maps(
    gears: Sequence[Path],
    sources: LandingOptions,
    settings: MapSettings,
    impulses: ImpulseSettings,
    options: MapOptions,
    say: Say = None,
) -> MapFile | None:
    """Search the best impulse of every cell and set, land with it, write and draw; None if stopped."""
    options.check("map", options.impulse_picture)
    impulses.check_within(settings.rules.horizon)
    fleets, origin = sources.fleets(gears)
    identity = impulse_identity(fleets, settings, impulses)
    blocks = sum(len(fleet) for fleet in fleets) * len(settings.slopes_deg)

    def compute(**how: Any) -> tuple[Any, Any]:
        best, maps = impulse_maps(fleets, settings, impulses, **how)
        return maps, best

    def write(maps: Any, best: Any) -> MapFile:
        content = MapFile(maps, best, settings.document() | {"impulses": impulses.document()}, origin)
        write_maps(options.out, content)
        save_figure(figure_impulse(best), options.impulse_picture)
        _draw_maps(content, options, settings, static_lines(fleets, after_impulses(impulses)), ())
        return content

    content = _computed(compute, write, identity, blocks, "cells", options, say)
    if content is None:
        return None
    tried = sum(one.optimum["delay"].size for one in content.impulses) * impulses.combinations
    simulated = sum(int(one.optimum["simulated"].sum()) for one in content.impulses)
    if say is not None:
        say(
            f"{tried} combinations of delay and duration judged by {simulated} landings to the second "
            "impact; the others equal one of them, their commands differing only after it"
        )
    _print(content, options, (), say)
    return content


def _warn_of_strangers(
    options: MapOptions, real: Sequence[Experiment], maps: Sequence[tuple[str, str]], say: Say
) -> None:
    """Name the real landings that no map of surface and controller shows, before the minutes are spent."""
    lost = strangers(real, maps)
    if lost and say is not None:
        names = ", ".join(f"{surface} {told!r} ({count})" for (surface, told), count in lost.items())
        own = ", ".join(f"{surface} {label!r}" for surface, label in maps)
        say(
            f"warning: {options.experiments}: {sum(lost.values())} of {len(real)} real landings belong to no "
            f"map and are left out: {names}; the maps are {own}"
        )


def _computed(
    compute: Callable[..., tuple[Any, Any]],
    write: Callable[[Any, Any], MapFile],
    identity: dict[str, Any],
    blocks: int,
    what: str,
    options: MapOptions,
    say: Say,
) -> MapFile | None:
    """Compute with progress and write; Ctrl-C keeps the finished blocks, which go once all is written."""
    store = BlockStore(options.out, identity, resume=options.resume, force=options.force)
    progress = BlockProgress(blocks, what, options.quiet)
    threads = 1 if options.dask is not None else options.threads
    try:
        with (
            executor(options.dask, _AT_ONCE) as where,
            stop_on_interrupt(progress.on_stop) as flag,
            progress,
        ):
            found = compute(where=where, threads=threads, store=store, on_block=progress.on_block, stop=flag)
    except BaseException:
        store.close()
        raise
    for note in store.notes:
        if say is not None:
            say(f"warning: {note}")
    if not found[0]:
        store.close()
        if say is not None:
            say(f"stopped: the finished blocks are kept in {store.folder}; continue with --resume")
        return None
    try:
        content = write(*found)
    except BaseException:
        store.close()
        if say is not None:
            what = f"the maps are in {options.out}, " if options.out.exists() else ""
            say(f"{what}the finished blocks are kept in {store.folder}; go on with --resume --force")
        raise
    store.discard()
    return content


def static_lines(
    fleets: Sequence[Sequence[Drone]], controllers: Sequence[Controller]
) -> dict[tuple[str, str], DrawnLimits]:
    """Return the static limits of each surface's first set under each controller's last command."""
    out = {}
    for fleet in fleets:
        drone = fleet[0]
        for told in controllers:
            push = final_reverse_thrust(drone, told)
            if push <= -drone.weight:
                continue  # held up by its motors: no static limit
            rigid = rigid_limits(drone.gear, drone.surface, push).first.slope
            bending = ramp_limit(drone.gear, drone.surface, push).slope
            out[(drone.surface, told.label)] = DrawnLimits(
                push, float(np.degrees(rigid)), float(np.degrees(bending))
            )
    return out


def final_reverse_thrust(drone: Drone, controller: Controller) -> float:
    """Return the thrust toward the ground [N] of all motors once the last command has settled."""
    thrust = Motors(drone, controller.ideal_reversal).propulsion(controller.steps)
    return -float(thrust.rear(thrust.rear.knots[-1]) + thrust.front(thrust.front.knots[-1]))


def _draw_maps(
    content: MapFile, options: MapOptions, settings: MapSettings, limits: Any, real: Sequence[Experiment]
) -> None:
    figure = figure_landing_maps(
        content.maps, limits=limits, experiments=real, short=settings.rules.short, long=settings.rules.long
    )
    save_figure(figure, options.picture)


def _print(content: MapFile, options: MapOptions, real: Sequence[Experiment], say: Say) -> None:
    counts = summary(content.maps)
    for entry, one in zip(counts, content.maps, strict=True):
        if entry["lost"] and say is not None:
            say(f"warning: {one.title}: {entry['lost']} landings could not be simulated and count nowhere")
    if options.json:
        for entry, one in zip(counts, content.maps, strict=True) if options.experiments else ():
            entry["real landings"] = confusion(of_map(real, one), one).document()
        print(exact_json.dumps({"file": str(options.out), "figure": str(options.picture), "maps": counts}))
        return
    if not options.quiet:
        console = Console()
        console.print(_summary_table(counts))
        for one in content.maps:
            chosen = of_map(real, one)
            if chosen:
                _print_confusion(console, one, chosen)
        print(f"wrote {options.out} and {options.picture}")


def _summary_table(counts: Sequence[dict[str, Any]]) -> Table:
    speeds = list(next(iter(counts))["steepest slope that half of the sets land on [deg]"])
    table = Table(
        title=Text("Steepest slope [deg] that half of the sets land on, by touchdown speed [m/s]"),
        box=box.SIMPLE_HEAD,
    )
    table.add_column("map", min_width=22)
    for speed in speeds:
        table.add_column(speed.removesuffix(" m/s"), justify="right")
    for name in ("time [s]", "way [m]", "doubt [%]"):
        table.add_column(Text(name), justify="right")
    for entry in counts:
        slopes = entry["steepest slope that half of the sets land on [deg]"]
        edge = entry["lower bounds, at the map's edge"]
        means = (
            entry[f"mean {name} where landed {unit}"]
            for name, unit in (("time to rest", "[s]"), ("distance", "[m]"))
        )
        table.add_row(
            f"{entry['surface'].upper()}, {entry['controller']}",
            *(_slope(slopes[speed], speed in edge) for speed in speeds),
            *(f"{value:.2f}" for value in means),
            "–" if entry["uncertain [%]"] is None else f"{entry['uncertain [%]']:.2f}",
        )
    return table


def _slope(value: float, at_edge: bool) -> str:
    """A slope [deg] for the table; at the map's upper edge it is a lower bound."""
    return f"{'≥ ' if at_edge else ''}{value:g}" if np.isfinite(value) else "–"


def _print_confusion(console: Console, one: LandingMap, chosen: Sequence[Experiment]) -> None:
    found = confusion(chosen, one)
    total = int(found.counts.sum())
    title = (
        f"{one.title}: {found.agreeing} of {total} real landings agree with the likeliest class of their cell"
    )
    title += f", {found.outside} outside the map" if found.outside else ""
    title += f", {found.lost} in cells that could not be simulated" if found.lost else ""
    # Above the table, not its title: that would be folded to the width of the few short columns.
    console.print(Text(title))
    table = Table(box=box.SIMPLE_HEAD)
    for head in ("observed", "simulated:", *(outcome.name.lower() for outcome in OUTCOMES)):
        table.add_column(head, justify="left" if head == "observed" else "right")
    for word, row in zip(found.words, found.counts, strict=True):
        table.add_row(word, "", *(str(int(count)) for count in row))
    console.print(table)
