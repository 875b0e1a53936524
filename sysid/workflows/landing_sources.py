"""What every landing command shares: sets to drones, controllers, grids, files, progress."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.text import Text

from sysid import __version__
from sysid.errors import CampaignError, ExportError
from sysid.landing.controllers import Controller, find_controller, load_controllers
from sysid.landing.drone import PAIRINGS, Drone, drones
from sysid.landing.impact_sensor import Sensing
from sysid.parameter_sets import ParameterSets
from sysid.report.fit_plots import check_figure_name
from sysid.workflows.show import load_sets

# Between two plain lines [s].
_PLAIN = 10.0


@dataclass(frozen=True)
class LandingOptions:
    """What the command line says of drones and motors.

    Parameters
    ----------
    motor : Path
        Motor sets.
    pair : {"best", "each"}
        Which motor set goes with a gear set.
    controllers : tuple of str
        As `find_controller` reads them.
    controller_file : Path, optional
        A Python file that registers more of them.
    ideal_reversal : bool
        Motors without saturation.
    own_sensing : bool
        Trigger by the drone's accelerometer instead of the first contact.
    """

    motor: Path
    pair: str = "best"
    controllers: tuple[str, ...] = ("off", "reverse")
    controller_file: Path | None = None
    ideal_reversal: bool = False
    own_sensing: bool = False

    def told(self, horizon: float) -> tuple[Controller, ...]:
        """Return the controllers.

        Parameters
        ----------
        horizon : float
            Simulated time [s], in which all their steps must come.
        """
        if self.controller_file is not None:
            load_controllers(self.controller_file)
        sensing = Sensing() if self.own_sensing else None
        found = tuple(
            find_controller(text, ideal_reversal=self.ideal_reversal, sensing=sensing)
            for text in self.controllers
        )
        for number, one in enumerate(found):
            one.check_within(horizon)
            if one.label in (other.label for other in found[:number]):
                raise CampaignError(f"controller {one.name!r} is asked for twice; name each once")
        return found

    def fleets(self, gears: Sequence[Path]) -> tuple[tuple[tuple[Drone, ...], ...], dict[str, Any]]:
        """Return the drones of every gear file, and where their numbers come from, for the result."""
        if self.pair not in PAIRINGS:
            raise CampaignError(f"--pair {self.pair!r}: expected one of {', '.join(PAIRINGS)}")
        motor = load_sets(self.motor)
        loaded = [load_sets(path) for path in gears]
        out = tuple(drones(gear, motor, self.pair) for gear in loaded)
        surfaces = [fleet[0].surface for fleet in out]
        if len(set(surfaces)) < len(surfaces):
            raise ExportError(
                f"{', '.join(str(path) for path in gears)}: the surfaces are {', '.join(surfaces)}; give one "
                "gear file per surface"
            )
        origin: dict[str, Any] = {"sysid": __version__, "pairing": self.pair}
        # By surface: fits of two surfaces may well have folders of one name.
        for surface, path, sets in zip(surfaces, gears, loaded, strict=True):
            origin[f"gear {surface}"] = _origin(path, sets)
        return out, origin | {"motor": _origin(self.motor, motor)}


def _origin(path: Path, sets: ParameterSets) -> dict[str, Any]:
    own = {"file": path.name, "name": sets.name, "sets": len(sets), "nrmse": sets.nrmse.tolist()}
    return own | dict(sets.provenance)


@dataclass(frozen=True)
class LandingFiles:
    """Where a result goes and how it is computed.

    Parameters
    ----------
    out : Path
        HDF5 file to write; the figure goes beside it.
    force, resume : bool
        Replace what is there; continue what is unfinished.
    dask : str, optional
        Address of a Dask scheduler, or ``local``.
    threads : int, optional
        Cores; the result is the same.
    quiet, json : bool
        No progress, no table; print JSON.
    """

    out: Path
    force: bool = False
    resume: bool = False
    dask: str | None = None
    threads: int | None = None
    quiet: bool = False
    json: bool = False

    @property
    def picture(self) -> Path:
        """Where the figure goes."""
        return self.out.with_suffix(".png")

    def check(self, what: str, *more: Path) -> None:
        """Refuse what is in the way, before the minutes of a result are spent.

        Parameters
        ----------
        what : str
            The result in a word.
        *more : Path
            Files that are written besides.

        Raises
        ------
        ExportError
            When a file is of no known format or exists, or its folder does not.
        """
        if self.out.suffix.lower() not in (".h5", ".hdf5"):
            raise ExportError(f"{self.out}: a {what} is written as HDF5; give --out a name that ends in .h5")
        check_figure_name(self.picture)
        for path in (self.out, self.picture, *more):
            if path.exists() and not self.force:
                raise ExportError(f"{path}: exists already; choose a new name or add --force")
            if not path.resolve().parent.is_dir():
                raise ExportError(f"{path}: the folder {path.parent} does not exist; make it first")


def span(text: str, what: str) -> tuple[float, ...]:
    """Return ``first:last:step`` or a list ``a,b,c`` as increasing numbers.

    Raises
    ------
    CampaignError
        When it is neither.
    """
    try:
        if ":" in text:
            first, last, step = (float(part) for part in text.split(":"))
            # Never past the last one; the excess keeps 0:0.3:0.1 whole, whose quotient falls short of 3.
            values = first + step * np.arange(math.floor((last - first) / step + 1e-9) + 1)
        else:
            values = np.array([float(part) for part in text.split(",")])
    except (ValueError, ZeroDivisionError, OverflowError):
        values = np.array([np.nan])
    if not np.isfinite(values).all() or not len(values) or np.any(np.diff(values) <= 0):
        raise CampaignError(f"{what} {text!r}: expected first:last:step or increasing numbers, as in 0:45:1")
    return tuple(round(float(value), 9) for value in values)


class BlockProgress:
    """One live line in a terminal, a plain one every few seconds elsewhere: blocks, landings, time left."""

    def __init__(self, blocks: int, what: str, quiet: bool) -> None:
        self._blocks, self._what, self._quiet = blocks, what, quiet
        self._console = Console(stderr=True)
        self._done = self._now = self._rows = 0
        self._live: Live | None = None
        self._started = self._last = time.monotonic()

    def __enter__(self) -> BlockProgress:
        self._started = self._last = time.monotonic()
        if not self._quiet and self._console.is_terminal:
            self._live = Live(console=self._console, refresh_per_second=4, transient=True)
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._live is not None:
            self._live.stop()

    def on_block(self, rows: int, computed: bool) -> None:
        """Report a block."""
        self._done += 1
        self._now += computed
        self._rows += rows if computed else 0
        if self._quiet:
            return
        if self._live is not None:
            self._live.update(Text(self.line(), no_wrap=True, overflow="ellipsis"))
        elif time.monotonic() - self._last >= _PLAIN:
            self._last = time.monotonic()
            self._console.print(Text(self.line()), soft_wrap=True)

    def on_stop(self) -> None:
        """Say that Ctrl-C was heard."""
        if not self._quiet:
            self._console.print("stopping after the blocks at hand; Ctrl-C again aborts")

    def line(self) -> str:
        """Return the progress line."""
        spent = time.monotonic() - self._started
        # Before anything is computed no speed is known; a small map's is a fraction, as compilation counts.
        rate = self._rows / spent if spent > 0 else 0.0
        speed = "-" if not rate else f"{rate:.0f}" if rate >= 10 else f"{rate:.2g}"
        left = "-"
        if self._now:
            seconds = round(spent / self._now * (self._blocks - self._done))
            left = f"~ {seconds // 60}:{seconds % 60:02d}"
        return f"block {self._done}/{self._blocks}  {speed} {self._what}/s  left {left}"
