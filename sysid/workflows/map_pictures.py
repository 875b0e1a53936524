"""Landing maps for Python: a table, and one picture of all maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from sysid.errors import CampaignError
from sysid.landing.impulse_maps import after_impulses, impulse_maps
from sysid.landing.maps import Fleets, landing_maps
from sysid.landing.outcomes import OUTCOMES
from sysid.landing.settings import ImpulseSettings, MapSettings
from sysid.landing.store import MapFile
from sysid.marks import span
from sysid.report.landing_figures import figure_impulse, figure_of_file
from sysid.shown import Shown
from sysid.storage import path_of
from sysid.workflows.landing_maps import limits_of
from sysid.workflows.landing_sources import chosen_controllers, open_fleets
from sysid.workflows.options import MotorOptions

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, repr=False)
class LandingMaps(Shown):
    """Maps of every surface under every controller, and the best impulses where they were searched."""

    content: MapFile

    def __repr__(self) -> str:
        first = self.content.maps[0]
        cells = f"{len(first.slopes_deg)} × {len(first.speeds)} cells"
        return f"<LandingMaps: {len(self.content.maps)} maps of {cells}>"

    def to_frame(self) -> pd.DataFrame:
        """Return the share of the landings of every map that end in each class [%]."""
        import pandas as pd

        rows = [
            {"surface": chart.surface, "controller": chart.controller}
            | {f"{o.name.lower()} [%]": 100.0 * float(np.nanmean(chart.share(o))) for o in OUTCOMES}
            for chart in self.content.maps
        ]
        return pd.DataFrame(rows).round(1)

    def plot(self) -> Figure:
        """Return the maps in the manner of Fig. 8."""
        return figure_of_file(self.content)

    def plot_impulse(self) -> Figure:
        """Return delay and duration of the best impulses in the manner of Figs. 9 and 10."""
        return figure_impulse(self.content.impulses)


def landing_map(
    gears: Sequence[str | Path],
    motor: str | Path,
    *,
    slopes: str = "0:45:3",
    speeds: str = "0.1:2:0.19",
    controllers: Sequence[str] = ("off", "reverse"),
) -> LandingMaps:
    """Return what becomes of landings over slope and touchdown speed.

    There is one file of `gears` per surface. `slopes` [deg] and `speeds` [m/s] are first:last:step or a list,
    `controllers` as for ``sysid landing-map``. Raises `SysidError` when an input cannot be used.
    """
    fleets, settings = _opened(gears, MotorOptions(path_of(motor, "the motor's sets")), slopes, speeds)
    chosen = chosen_controllers(_several(controllers, "controllers"), settings.rules.horizon)
    maps = landing_maps(fleets, chosen, settings)
    stated = {"rules": asdict(settings.rules), "static_limits": limits_of(fleets, chosen)}
    return LandingMaps(MapFile(maps, (), stated, {}))


def impulse_map(
    gears: Sequence[str | Path],
    motor: str | Path,
    *,
    slopes: str = "5:40:7",
    speeds: str = "0.3:1.5:0.3",
    delays: str = "0:0.24:0.04",
    durations: str = "0:0.16:0.04",
    ideal_reversal: bool = False,
) -> LandingMaps:
    """Return the best impulse of every cell, and what becomes of landings with it.

    `delays` and `durations` are tried [s]. Motors of an `ideal_reversal` reverse without delay, and the rear
    pair then reverses in the impulse (Fig. 11). The rest is as for `landing_map`.
    """
    motors = MotorOptions(path_of(motor, "the motor's sets"), ideal_reversal=ideal_reversal)
    fleets, settings = _opened(gears, motors, slopes, speeds)
    tried = (span(delays, "delays"), span(durations, "durations"))
    impulses = ImpulseSettings(*tried, ideal_reversal=ideal_reversal)
    best, maps = impulse_maps(fleets, settings, impulses)
    limits = limits_of(fleets, after_impulses(impulses))
    stated = {"rules": asdict(settings.rules), "static_limits": limits}
    return LandingMaps(MapFile(maps, best, stated, {}))


def _opened(
    gears: Sequence[str | Path], motors: MotorOptions, slopes: str, speeds: str
) -> tuple[Fleets, MapSettings]:
    settings = MapSettings(span(slopes, "slopes"), span(speeds, "speeds"), check=False)
    paths = [path_of(gear, "the gear's sets") for gear in _several(gears, "gears")]
    return open_fleets(motors, paths)[0], settings


def _several(given: Any, what: str) -> Sequence[Any]:
    """Return a list; one text or path alone is a list of one."""
    given = [given] if isinstance(given, str | Path) else given
    if not isinstance(given, list | tuple) or not given:
        raise CampaignError(f"{what}: expected a list of one or more, found {given!r:.60}")
    return given
