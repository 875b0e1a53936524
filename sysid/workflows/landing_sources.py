"""What every landing command shares: sets to drones, controllers, files, computation in blocks."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TypeVar

from rich.text import Text

from sysid import __version__
from sysid.errors import CampaignError, ExportError
from sysid.fit.progress import LiveBlock
from sysid.fit.stopping import stop_on_interrupt
from sysid.journal import notice, tell
from sysid.landing.controllers import Controller, Sensing, find_controller, load_controllers
from sysid.landing.drone import Pairing, drones
from sysid.landing.maps import Fleets
from sysid.parallel import executor
from sysid.parameter_sets import DRAWS, PREDICTS, ParameterSets
from sysid.report.drawing import check_figure_name
from sysid.resume import BlockStore, Computing
from sysid.storage import check_file
from sysid.trust.use import NOT
from sysid.workflows.draws import sets_or_draws
from sysid.workflows.options import ComputeOptions, MotorOptions
from sysid.workflows.provenance import seen_from

Computed = TypeVar("Computed")

# Blocks that share a cluster at the same time.
_AT_ONCE = 8


def chosen_controllers(
    names: Sequence[str],
    horizon: float,
    *,
    file: Path | None = None,
    ideal_reversal: bool = False,
    trigger: str = "contact",
) -> tuple[Controller, ...]:
    """Return controllers by name, as `find_controller` reads them; a Python `file` may register more.

    The first contact starts them, or with the trigger ``imu`` the drone's accelerometer. Raises
    `CampaignError` when a name is unknown or repeated, or a step comes later than the `horizon` [s].
    """
    if file is not None:
        load_controllers(file)
    sensing = Sensing() if trigger == "imu" else None
    chosen = tuple(find_controller(name, ideal_reversal=ideal_reversal, sensing=sensing) for name in names)
    labels: set[str] = set()
    for controller in chosen:
        controller.check_within(horizon)
        if controller.label in labels:
            raise CampaignError(f"controller {controller.name!r} is named twice; name each once")
        labels.add(controller.label)
    return chosen


def paired_fleets(
    gears: Sequence[ParameterSets], motor: ParameterSets, pair: Pairing, names: Sequence[str], *, anyway: bool
) -> Fleets:
    """Return the drones of the sets of every gear, see `sysid.landing.drone.drones`.

    ExportError, with one of the `names` of gears and motor, where two gears have one surface, or sets are of
    a fit that does not predict, unless they are taken `anyway`.
    """
    for name, sets in zip(names, (*gears, motor), strict=True):
        says = sets.settings.get(PREDICTS, {})
        if says.get("word") == NOT and not anyway:
            raise ExportError(
                f"{name}: {says['sentence']}; a map of these sets would mislead; see the validation in the "
                "report and mend the fit, or add --anyway (in Python anyway=True)"
            )
    fleets = tuple(drones(gear, motor, pair) for gear in gears)
    surfaces = [fleet[0].surface for fleet in fleets]
    if len(set(surfaces)) < len(surfaces):
        raise ExportError(
            f"{', '.join(names[:-1])}: the surfaces are {', '.join(surfaces)}; give one gear file per surface"
        )
    return fleets


def open_fleets(
    motors: MotorOptions, gears: Sequence[Path], out: Path | None = None
) -> tuple[Fleets, dict[str, object]]:
    """Return the drones of every gear file, and where their numbers come from, for the result in `out`.

    With draws, motors without intervals have their best set in all drones. Raises `SysidError` when sets
    cannot be used, or two gear files have one surface.
    """
    loaded = [sets_or_draws(path, motors.draws) for path in gears]
    motor = sets_or_draws(motors.motor, motors.draws, best=True)
    names = [str(path) for path in (*gears, motors.motor)]
    fleets = paired_fleets(loaded, motor, motors.pair, names, anyway=motors.anyway)
    # Keys are surfaces, because fits of two surfaces may well have folders of one name.
    places = zip([fleet[0].surface for fleet in fleets], gears, loaded, strict=True)
    gear = {surface: _origin(path, sets, out) for surface, path, sets in places}
    origin = {"sysid": __version__, "pairing": motors.pair, "ideal_reversal": motors.ideal_reversal}
    origin[DRAWS] = motors.draws
    return fleets, origin | {"gear": gear, "motor": _origin(motors.motor, motor, out)}


def _origin(path: Path, sets: ParameterSets, out: Path | None) -> dict[str, object]:
    source = {"file": path.name, "name": sets.name, "sets": len(sets)}
    source |= {} if DRAWS in sets.provenance else {"nrmse": sets.nrmse.tolist()}
    place = {} if out is None else {"from_result_folder": seen_from(out.parent, path)}
    return source | dict(sets.provenance) | place


def check_result(what: str, out: Path, force: bool, *pictures: Path) -> None:
    """Refuse an HDF5 file or pictures that cannot be written, before the minutes of a result are spent.

    Raises `ExportError` when a file has no known format or exists, or its folder does not exist.
    """
    if out.suffix.lower() not in (".h5", ".hdf5"):
        raise ExportError(f"{out}: a {what} is written as HDF5; give --out a name that ends in .h5")
    for picture in pictures:
        check_figure_name(picture)
    for path in (out, *pictures):
        check_file(path, force=force, error_type=ExportError)


def compute_and_write(
    out: Path,
    identity: Mapping[str, object],
    blocks: tuple[int, str],
    compute: Callable[[Computing], Computed | None],
    write: Callable[[Computed], object],
    *,
    options: ComputeOptions,
) -> Computed | None:
    """Compute with progress and write to `out`. Ctrl-C keeps the finished blocks for `--resume`.

    `identity` must be equal for the computation to be continued. `blocks` is their number and what a block
    counts. `compute` and this function return None where the computation was stopped.
    """
    store = BlockStore(out, identity, resume=options.resume, force=options.force)
    progress = BlockProgress(*blocks, options.quiet or options.json)
    with closing(store):
        where = executor(options.dask, _AT_ONCE, options.threads)
        with where, stop_on_interrupt(progress.on_stop) as stop, progress:
            threads = 1 if options.dask is not None else options.threads
            result = compute(Computing(where, threads, store, progress.on_block, stop.is_set))
        for note in store.notes:
            notice("damaged-block", note)
        if result is None:
            tell(f"stopped: the finished blocks are kept next to {out}; continue with --resume")
            return None
        try:
            write(result)
        except BaseException:
            computed = f"{out} is written, " if out.exists() else ""
            tell(f"{computed}the finished blocks are kept next to it; go on with --resume --force")
            raise
        store.discard()
        return result


class BlockProgress(LiveBlock):
    """Reports blocks, what they count per second, and the time left."""

    def __init__(self, blocks: int, what: str, quiet: bool) -> None:
        super().__init__(quiet)
        self._blocks, self._what = blocks, what
        self._done = self._now = self._rows = 0

    def on_block(self, rows: int, computed: bool) -> None:
        """Report a block."""
        self._done += 1
        self._now += computed
        self._rows += rows if computed else 0
        self.plain(self.line)

    def on_stop(self) -> None:
        """Acknowledge Ctrl-C."""
        self.say("stopping after the blocks at hand; Ctrl-C again aborts")

    def block(self) -> Text:
        """Return the progress line for a terminal."""
        return Text(self.line(), no_wrap=True, overflow="ellipsis")

    def line(self) -> str:
        """Return the progress line."""
        spent = time.perf_counter() - self._began
        # Before anything is computed no speed is known; a small map's is a fraction, as compilation counts.
        rate = self._rows / spent if spent > 0 else 0.0
        speed = "-" if not rate else f"{rate:.0f}" if rate >= 10 else f"{rate:.2g}"
        left = "-"
        if self._now:
            seconds = round(spent / self._now * (self._blocks - self._done))
            left = f"~ {seconds // 60}:{seconds % 60:02d}"
        return f"block {self._done}/{self._blocks}  {speed} {self._what}/s  left {left}"
