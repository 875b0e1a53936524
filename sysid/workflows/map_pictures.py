"""Landing maps for a page: computed on a coarse grid, one narrow picture per map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.landing.impulse import ImpulseSettings, rear_command
from sysid.landing.impulse_maps import after_impulses, impulse_maps
from sysid.landing.maps import Fleets, LandingMap, MapSettings, landing_maps
from sysid.landing.outcomes import Outcome
from sysid.landing.store import MapFile
from sysid.report.html import Html, in_true_colours, legend, picture, side_by_side
from sysid.report.landing_figures import MapLegend, figure_impulse, figure_of_file
from sysid.workflows.landing_maps import limits_of
from sysid.workflows.landing_sources import chosen_controllers, open_fleets
from sysid.workflows.options import MotorOptions, span


def landing_pictures(
    gears: Sequence[str | Path],
    motor: str | Path,
    *,
    slopes: str = "0:45:3",
    speeds: str = "0.1:2:0.19",
    controllers: Sequence[str] = ("off", "reverse"),
) -> Html:
    """Return the maps of every surface under every controller, in the manner of Fig. 8.

    There is one file of `gears` per surface. `slopes` [deg] and `speeds` [m/s] are first:last:step or a list,
    `controllers` as for ``sysid landing-map``.
    """
    fleets, settings = _opened(gears, MotorOptions(Path(motor)), slopes, speeds)
    chosen = chosen_controllers(controllers, settings.rules.horizon)
    maps = landing_maps(fleets, chosen, settings)
    return file_pictures(MapFile(maps, (), _settings(settings, limits_of(fleets, chosen)), {}))


def impulse_pictures(
    gears: Sequence[str | Path],
    motor: str | Path,
    *,
    slopes: str = "5:40:7",
    speeds: str = "0.3:1.5:0.3",
    delays: str = "0:0.24:0.04",
    durations: str = "0:0.16:0.04",
    ideal_reversal: bool = False,
) -> Html:
    """Return the landings after the best impulse and that impulse itself, in the manner of Figs. 9 to 11.

    `delays` and `durations` are tried [s]. Motors of an `ideal_reversal` reverse without delay, and the rear
    pair then reverses in the impulse (Fig. 11). The rest is as for `landing_pictures`.
    """
    motors = MotorOptions(Path(motor), ideal_reversal=ideal_reversal)
    fleets, settings = _opened(gears, motors, slopes, speeds)
    tried = (span(delays, "delays"), span(durations, "durations"))
    rear = rear_command(ideal_reversal=ideal_reversal)
    impulses = ImpulseSettings(*tried, rear=rear, ideal_reversal=ideal_reversal)
    best, maps = impulse_maps(fleets, settings, impulses)
    limits = limits_of(fleets, after_impulses(impulses))
    return file_pictures(MapFile(maps, best, _settings(settings, limits), {}))


def _opened(
    gears: Sequence[str | Path], motors: MotorOptions, slopes: str, speeds: str
) -> tuple[Fleets, MapSettings]:
    settings = MapSettings(span(slopes, "slopes"), span(speeds, "speeds"), check=False)
    return open_fleets(motors, [Path(gear) for gear in gears])[0], settings


def _settings(settings: MapSettings, limits: Any) -> dict[str, Any]:
    return {"rules": asdict(settings.rules), "static_limits": limits}


def file_pictures(content: MapFile) -> Html:
    """Return a narrow picture of every map of a file and of its best impulses, under one legend."""
    pieces, key = [], MapLegend()
    for chart in content.maps:
        pieces.append(picture(figure_of_file(replace(content, maps=(chart,)), key), _words(chart)))
    for best in content.impulses:
        figure = figure_impulse([best], stacked=True)
        words = f"delay and duration of the best impulse over touchdown speed and slope, {best.surface}"
        pieces.append(picture(figure, words))
    return in_true_colours(legend(key.entries()) + side_by_side(pieces))


def _words(chart: LandingMap) -> str:
    safe = chart.share(Outcome.SHORT) + chart.share(Outcome.NEAR)
    rows = np.flatnonzero(np.nan_to_num(safe).max(axis=1) >= 0.5)
    steepest = f"{chart.slopes_deg[rows[-1]]:g}°" if len(rows) else "none"
    return (
        f"{chart.title}: outcome of landings over touchdown speed in m/s and slope in degrees; steepest "
        f"slope of the grid on which half of the sets come to rest within 1 m at some speed: {steepest}"
    )
