"""Landings for Python: drops, landings, maps, design studies and static limits of identified sets.

Gears and motors are sets, fits, fit folders or files, see `sysid.load_parameter_sets`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from sysid.api import Fit, documented, place_of, python_options
from sysid.errors import CampaignError, ExportError
from sysid.export import load_parameter_sets
from sysid.export.numbers import TargetNumbers
from sysid.export.numbers import numbers_for as motor_numbers
from sysid.landing.design_study import DesignStudy, find_changes
from sysid.landing.design_study import design_study as study_of
from sysid.landing.drone import Pairing, drone
from sysid.landing.maps import Fleets
from sysid.landing.outcomes import OUTCOMES
from sysid.landing.settings import ImpulseSettings, MapSettings, StudySettings
from sysid.landing.simulate import Landing
from sysid.landing.store import MapFile, write_maps, write_study
from sysid.marks import span
from sysid.parallel import LocalThreads
from sysid.parameter_sets import ParameterSets, RankedSet
from sysid.report.design_figures import figure_design_study
from sysid.report.landing_figures import figure_impulse, figure_of_file
from sysid.resume import Computing
from sysid.shown import Shown
from sysid.storage import check_file, path_of
from sysid.units import in_si
from sysid.workflows.draws import sets_or_draws
from sysid.workflows.landing import controller_of, land_drone
from sysid.workflows.landing_maps import controlled_maps, impulsive_maps
from sysid.workflows.landing_sources import chosen_controllers, paired_fleets
from sysid.workflows.options import (
    DesignStudyOptions,
    ImpulseMapOptions,
    LandingMapOptions,
    TouchdownOptions,
    TrustOptions,
)
from sysid.workflows.static_limits import limit_rows

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

Sets = str | Path | Fit | ParameterSets | RankedSet
Quantity = str | float
Trigger = Literal["contact", "imu"]
# A text such as "0:45:1 deg", or the numbers themselves.
Grid = str | Sequence[float]


def sets_of(given: object) -> ParameterSets:
    """Return ranked sets: of a fit, of a file or folder, or one set alone."""
    if isinstance(given, ParameterSets):
        return given
    if isinstance(given, Fit):
        return given.sets
    if isinstance(given, RankedSet):
        return given.alone()
    if isinstance(given, str | Path):
        return load_parameter_sets(given)
    found = type(given).__name__
    raise ExportError(f"expected sets, such as sets.best, a fit or its path, found a {found}").also(TypeError)


def numbers_for(sets: Sets, target: str, *, rank: int = 1, mass: Quantity | None = None) -> TargetNumbers:
    """Return a motor's numbers for a simulator or flight controller, with 95 % intervals and a check.

    Parameters
    ----------
    sets : ParameterSets, Fit, path or RankedSet
        Of a motor; the set of `rank` is taken, 1 is the best.
    target : str
        ``gazebo``, ``rotorpy``, ``crazyflow``, ``px4`` or ``ardupilot``.
    mass : float or str, optional
        Mass of a drone with four such motors [kg, or a text with its unit], of whose hover the check speaks.

    Raises
    ------
    ExportError
        When the target is unknown, the sets are no motor's, or they give none of its numbers.

    Notes
    -----
    An interval combines independent contributions: each judged parameter and each static curve at the ends
    of its own 95 % interval (both coefficients of a curve together), the calibration of the load cells for
    thrust and for torque, and the scatter of steady speeds under one command. A parameter whose interval is
    open counts up to the bound of the search. The inertia is taken as it stands in the set, and so is Kv
    beside the intervals of R and L, which contain its stated error. Where the steady speed is no line of the
    command, its levels count as they were measured, with the supply that sags under their load. Where the
    model does not explain the logs, time constants come from the steps in the logs, if the fit states them.

    Examples
    --------
    >>> import sysid
    >>> sets = sysid.load_parameter_sets("data_samples/published/published-motor.json")
    >>> numbers = sysid.numbers_for(sets, "gazebo", mass=1.2)
    >>> float(numbers.to_frame().value["motorConstant"])
    1.2e-05
    >>> numbers.check
    'at maxRotVelocity, 749.8 rad/s, one rotor gives 6.747 N and 0.09277 N·m; ...'
    """
    kilograms = None if mass is None else in_si(mass, "kg", "mass")
    return motor_numbers(sets_of(sets), target, rank=rank, mass=kilograms)


def _drawn(given: Sets, draws: int | None, *, best: bool = False) -> ParameterSets:
    """Return sets, or draws of a fit, see `sysid.workflows.draws.sets_or_draws`."""
    if draws is None or (best and isinstance(given, ParameterSets | RankedSet)):
        return sets_of(given)
    if isinstance(given, str | Path | Fit):
        return sets_or_draws(place_of(given), draws, best=best)
    found = type(given).__name__
    raise ExportError(f"draws are of a fit or its folder, found a {found}; leave draws out").also(TypeError)


def _set(given: Sets) -> RankedSet:
    return given if isinstance(given, RankedSet) else sets_of(given).best


@documented(TouchdownOptions)
def simulate_drop(
    gear: Sets, slope: Quantity, speed: Quantity, *, pitch: Quantity = 0.0, pitch_rate: Quantity = 0.0,
    horizontal_speed: Quantity = 0.0, change: str | None = None, rate: Quantity = 1000.0,
    horizon: Quantity = 3.0, short: Quantity = 0.45, long: Quantity = 1.0, rest_speed: Quantity = 0.05,
    rest_turn: Quantity = 0.2, rest_time: Quantity = 0.2, flip_angle: Quantity = "80 deg",
) -> Landing:  # fmt: skip
    """Simulate a drop without thrust, from the touchdown on, with the best set of a gear or the given one.

    Quantities are texts with a unit, or numbers in SI.

    Examples
    --------
    >>> import sysid
    >>> sets = sysid.load_parameter_sets("data_samples/published/published-gear-lf.json")
    >>> float(sets.best["k_h"])  # N/m
    6440.0
    >>> drop = sysid.simulate_drop(sets.best, slope="20 deg", speed="0.5 m/s")
    >>> drop
    <Landing (no thrust; 20 deg, 0.5 m/s, lf): other, 1.193 m>
    >>> drop.events[["event", "of"]].head(2).to_numpy().tolist()
    [['touchdown', 'rear'], ['lift_off', 'rear']]
    """
    fixed = {"controller": "off", "controller_file": None, "trigger": "contact", "height": None}
    return land_drone(drone(_set(gear)), python_options(TouchdownOptions, locals(), **fixed), None)


@documented(TouchdownOptions)
def simulate_landing(
    gear: Sets, motor: Sets, slope: Quantity, speed: Quantity, controller: str = "reverse", *,
    controller_file: str | Path | None = None, trigger: Trigger = "contact", ideal_reversal: bool = False,
    height: Quantity | None = None, pitch: Quantity = 0.0, pitch_rate: Quantity = 0.0,
    horizontal_speed: Quantity = 0.0, change: str | None = None, rate: Quantity = 1000.0,
    horizon: Quantity = 3.0, short: Quantity = 0.45, long: Quantity = 1.0, rest_speed: Quantity = 0.05,
    rest_turn: Quantity = 0.2, rest_time: Quantity = 0.2, flip_angle: Quantity = "80 deg",
) -> Landing:  # fmt: skip
    """Simulate a landing with motors under a controller; the rest is as for `simulate_drop`.

    Motors of an `ideal_reversal` reverse without delay.

    Examples
    --------
    >>> import sysid
    >>> gear = "data_samples/published/published-gear-lf.json"
    >>> motor = sysid.load_parameter_sets("data_samples/published/published-motor.json")
    >>> sysid.simulate_landing(gear, motor, slope="20 deg", speed="0.5 m/s")
    <Landing (reverse; 20 deg, 0.5 m/s, lf): short after 0.643 s, 0.204 m>
    """
    chosen = python_options(TouchdownOptions, locals())
    return land_drone(drone(_set(gear), _set(motor)), chosen, controller_of(chosen, ideal_reversal))


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
        """Return delay and duration of the best impulses (Figs. 9 and 10) of an `impulse_map`."""
        if not self.content.impulses:
            raise ExportError("these maps have no impulses; sysid.impulse_map searches them")
        return figure_impulse(self.content.impulses)

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the HDF5 file that ``sysid report`` reads, and return its path."""
        path = path_of(path, "the new file")
        check_file(path, force=force, error_type=ExportError)
        write_maps(path, self.content)
        return path


@documented(LandingMapOptions)
def landing_map(
    gears: Sets | Sequence[Sets], motor: Sets, *, slopes: Grid = "0:45:1deg", speeds: Grid = "0:2:0.05",
    controllers: str | Sequence[str] = ("off", "reverse"), controller_file: str | Path | None = None,
    trigger: Trigger = "contact", pitch: Quantity = 0.0, horizontal_speed: Quantity = 0.0,
    pair: Pairing = "best", ideal_reversal: bool = False, check: bool = True, horizon: Quantity = 3.0,
    short: Quantity = 0.45, long: Quantity = 1.0, rest_speed: Quantity = 0.05, rest_turn: Quantity = 0.2,
    rest_time: Quantity = 0.2, flip_angle: Quantity = "80 deg", draws: int | None = None,
    anyway: bool = False, threads: int | None = None,
) -> LandingMaps:  # fmt: skip
    """Return what becomes of landings over slope [deg] and touchdown speed [m/s].

    There is one of `gears` per surface. `slopes` and `speeds` are first:last:step or a list, `controllers` as
    for ``sysid landing-map``. Raises `SysidError` when an input cannot be used.

    Examples
    --------
    >>> import sysid
    >>> gear = "data_samples/published/published-gear-lf.json"
    >>> motor = "data_samples/published/published-motor.json"
    >>> sysid.landing_map(gear, motor, slopes="0:30:15 deg", speeds=[0.3, 0.6], check=False)
    <LandingMaps: 2 maps of 3 × 2 cells>
    """
    fleets, origin = _fleets(gears, motor, pair, ideal_reversal, draws, anyway)
    tilted = python_options(TouchdownOptions, {**locals(), "slope": 0.0, "speed": 0.0}).begin
    settings = python_options(
        MapSettings, locals(), slopes_deg=_grid(slopes, "slopes", "deg"), speeds=_grid(speeds, "speeds"),
        pitch=tilted.pitch, horizontal_speed=tilted.horizontal_speed,
    )  # fmt: skip
    chosen = chosen_controllers(
        _several(controllers, "controllers"), settings.rules.horizon, file=_file(controller_file),
        ideal_reversal=ideal_reversal, trigger=trigger,
    )  # fmt: skip
    content = controlled_maps(fleets, origin, chosen, settings, _computing(threads))
    assert content is not None  # nobody asks it to stop
    return LandingMaps(content)


@documented(ImpulseMapOptions)
def impulse_map(
    gears: Sets | Sequence[Sets], motor: Sets, *, slopes: Grid = "0:45:1deg", speeds: Grid = "0:2:0.05",
    delays: Grid = "0:0.26:0.01", durations: Grid = "0:0.16:0.01", front: float = 0.8,
    rear: float | None = None, idle: float = 0.1, after: float = -1.0, worth: float = 0.05,
    equal: Quantity = 0.0, pair: Pairing = "best", ideal_reversal: bool = False, check: bool = True,
    horizon: Quantity = 3.0, short: Quantity = 0.45, long: Quantity = 1.0, rest_speed: Quantity = 0.05,
    rest_turn: Quantity = 0.2, rest_time: Quantity = 0.2, flip_angle: Quantity = "80 deg",
    draws: int | None = None, anyway: bool = False, threads: int | None = None,
) -> LandingMaps:  # fmt: skip
    """Return the best impulse of every cell, and what becomes of landings with it.

    `delays` and `durations` are tried [s]. Motors of an `ideal_reversal` reverse without delay, and the rear
    pair then reverses in the impulse (Fig. 11). The rest is as for `landing_map`.

    Examples
    --------
    >>> import sysid
    >>> gear = "data_samples/published/published-gear-lf.json"
    >>> motor = "data_samples/published/published-motor.json"
    >>> grid = {"slopes": [10, 20], "speeds": [0.5], "delays": "0:0.2:0.1", "durations": [0, 0.1]}
    >>> sysid.impulse_map(gear, motor, check=False, **grid)
    <LandingMaps: 3 maps of 2 × 1 cells>
    """
    fleets, origin = _fleets(gears, motor, pair, ideal_reversal, draws, anyway)
    settings = python_options(
        MapSettings, locals(), slopes_deg=_grid(slopes, "slopes", "deg"), speeds=_grid(speeds, "speeds")
    )
    impulses = python_options(
        ImpulseSettings, locals(), delays=_grid(delays, "delays", "s"), ideal_reversal=ideal_reversal,
        durations=_grid(durations, "durations", "s"),
    )  # fmt: skip
    impulses.check_within(settings.rules.horizon)
    content = impulsive_maps(fleets, origin, settings, impulses, _computing(threads))
    assert content is not None  # nobody asks it to stop
    return LandingMaps(content)


@dataclass(frozen=True, repr=False)
class DesignTable(Shown):
    """Which change of legs, feet or motors buys most."""

    study: DesignStudy

    def __repr__(self) -> str:
        changes = ", ".join(change.label for change in self.study.changes)
        return f"<DesignTable of {self.study.name}: {len(self.study.points)} designs, {changes}>"

    def to_frame(self) -> pd.DataFrame:
        """Return what each change buys at its best value, and costs at its worst, what buys most first."""
        import pandas as pd

        return pd.DataFrame(self.study.gains()).set_index("change")

    def plot(self) -> Figure:
        """Return the steepest slope of every design."""
        return figure_design_study(self.study)

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the HDF5 file that ``sysid report`` reads, and return its path."""
        path = path_of(path, "the new file")
        check_file(path, force=force, error_type=ExportError)
        write_study(path, self.study, {})
        return path


@documented(DesignStudyOptions)
def design_study(
    gear: Sets, motor: Sets, vary: str, *, controller: str = "reverse",
    controller_file: str | Path | None = None, slopes: Grid = "0:60:1deg",
    speeds: Grid = (0.3, 0.6, 0.9, 1.2),
    share: float = 0.5, spread: float = 0.0, together: bool = False, pair: Pairing = "best",
    ideal_reversal: bool = False, horizon: Quantity = 3.0, short: Quantity = 0.45, long: Quantity = 1.0,
    rest_speed: Quantity = 0.05, rest_turn: Quantity = 0.2, rest_time: Quantity = 0.2,
    flip_angle: Quantity = "80 deg", draws: int | None = None, anyway: bool = False,
    threads: int | None = None,
) -> DesignTable:  # fmt: skip
    """Vary legs, feet and motors: which change buys most.

    `vary` are factors first:last:count, as in ``k_t=0.5:2:5,dx_f=0.8:1.4:4``; ``reversal_delay=0ms:200ms:5``
    adds. `spread` lands every set also with its nose this much up and down [deg].

    Examples
    --------
    >>> import sysid
    >>> gear = "data_samples/published/published-gear-lf.json"
    >>> motor = "data_samples/published/published-motor.json"
    >>> sysid.design_study(gear, motor, "k_t=0.5:2:3", slopes="0:40:20 deg", speeds=[0.6])
    <DesignTable of published-gear-lf: 3 designs, k_t ×>
    """
    changes = find_changes(vary)
    (fleet,), _ = _fleets([gear], motor, pair, ideal_reversal, draws, anyway)
    settings = python_options(
        StudySettings, locals() | {"spread_deg": spread}, slopes_deg=_grid(slopes, "slopes", "deg"),
        speeds=_grid(speeds, "speeds"),
    )  # fmt: skip
    (chosen,) = chosen_controllers(
        [controller], settings.rules.horizon, file=_file(controller_file), ideal_reversal=ideal_reversal
    )
    study = study_of(fleet[0].sets, fleet, changes, chosen, settings, _computing(threads))
    assert study is not None  # nobody asks it to stop
    return DesignTable(study)


def static_limits(sets: Sets, thrust: float | Sequence[float] = (0.0, 12.0)) -> pd.DataFrame:
    """Return the steepest slope on which a drone stays, under reverse thrusts [N].

    For every set, with rigid legs and with the legs as fitted.

    Examples
    --------
    >>> import sysid
    >>> table = sysid.static_limits("data_samples/published/published-gear-hf.json", thrust=12)
    >>> float(table.set_down_deg.iloc[0])
    39.75
    """
    import pandas as pd

    gear = sets_of(sets)
    return pd.DataFrame(limit_rows(gear, _numbers(thrust, "thrust"), gear.name))


def _fleets(
    gears: Sets | Sequence[Sets],
    motor: Sets,
    pair: Pairing,
    ideal_reversal: bool,
    draws: int | None,
    anyway: bool,
) -> tuple[Fleets, dict[str, object]]:
    """Return the drones of every gear, and where their numbers come from."""
    if pair not in get_args(Pairing):
        raise ExportError(f"pair = {pair!r}: expected 'best' or 'each'").also(ValueError)
    loaded = [_drawn(gear, draws) for gear in _several(gears, "gears")]
    rotor = _drawn(motor, draws, best=True)
    fleets = paired_fleets(loaded, rotor, pair, [one.name for one in (*loaded, rotor)], anyway=anyway)
    origins = {
        fleet[0].surface: {"name": sets.name, **sets.provenance}
        for fleet, sets in zip(fleets, loaded, strict=True)
    }
    origin = {"pairing": pair, "ideal_reversal": ideal_reversal, "gear": origins}
    return fleets, origin | {"motor": {"name": rotor.name, **rotor.provenance}}


def _several(given: Any, what: str) -> Sequence[Any]:
    """Return a list; one thing alone is a list of one."""
    given = given if isinstance(given, list | tuple) else [given]
    wrong = [one for one in given if isinstance(one, int | float | type(None) | Mapping)]
    # A set is a mapping.
    wrong = [one for one in wrong if not isinstance(one, RankedSet)]
    if not given or wrong:
        raise CampaignError(f"{what}: expected a list of one or more, found {given!r:.60}").also(TypeError)
    return given


def _numbers(given: float | Sequence[float], what: str) -> list[float]:
    try:
        numbers = [float(one) for one in np.atleast_1d(given)]
    except (TypeError, ValueError, OverflowError):
        numbers = [math.nan]
    if not np.isfinite(numbers).all():
        raise CampaignError(f"{what}: expected one or more numbers, found {given!r:.60}").also(TypeError)
    return numbers


def _grid(given: Grid, name: str, unit: str = "1") -> tuple[float, ...]:
    """Return increasing numbers: of a text such as ``0:45:1 deg``, or as they are, in the unit."""
    if isinstance(given, list | tuple | np.ndarray):
        given = ",".join(f"{one!r} {unit if unit == 'deg' else ''}" for one in _numbers(given, name))
    return span(given, name, unit)  # type: ignore[arg-type]


def _computing(threads: int | None) -> Computing:
    threads = python_options(TrustOptions, {"threads": threads}).threads
    return Computing(LocalThreads(threads), threads)


def _file(given: str | Path | None) -> Path | None:
    return None if given is None else path_of(given, "a Python file with controllers")
