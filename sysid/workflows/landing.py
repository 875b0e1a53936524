"""One landing per set from the command line: histories with units, events and outcome as CSV or HDF5."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from operator import itemgetter
from pathlib import Path

import h5py

from sysid.documents import label
from sysid.errors import ExportError
from sysid.export.spreadsheet import csv_text
from sysid.landing.approach import fly_down
from sysid.landing.controllers import Controller
from sysid.landing.design_study import find_changes
from sysid.landing.drone import Drone, Motors
from sysid.landing.simulate import EVENT, HISTORY, Landing, land
from sysid.report.fold import print_result, print_table
from sysid.report.table import TableColumn, table
from sysid.storage import FileKind, check_file, put, put_json, put_texts, write_file
from sysid.workflows.landing_sources import chosen_controllers, open_fleets
from sysid.workflows.options import SimulateOptions, TouchdownOptions

LANDINGS = FileKind("sysid-landings", 1, "a file of landings", "simulate again", ExportError)


def simulate_landings(options: SimulateOptions) -> None:
    """Simulate one landing per set, write the landings, and print their outcomes and the files.

    With a height the drone descends first, with the attitude controller on. Raises `SysidError` when the
    sets, the controller or the place to write cannot be used.
    """
    out, files = options.out, []
    if out is not None:
        kind = out.suffix.lower()
        if kind not in (".csv", ".h5", ".hdf5"):
            raise ExportError(
                f"{out}: unknown format {out.suffix!r}; give --out a name that ends in .csv or .h5"
            )
        parts = ("events", "outcomes") if kind == ".csv" else ()
        files = [out, *(out.with_name(f"{out.stem}-{what}.csv") for what in parts)]
        for path in files:
            check_file(path, force=options.force, error_type=ExportError)
    controller = controller_of(options, options.motors.ideal_reversal)
    (fleet,), origin = open_fleets(options.motors, [options.sets])
    landings = [land_drone(drone, options, controller) for drone in fleet]
    rows = [
        {
            "set": rank,
            "outcome": landing.outcome.name.lower(),
            "distance": landing.distance,
            "time_to_rest": landing.time,
            "trigger": landing.trigger,
        }
        for rank, landing in enumerate(landings, start=1)
    ]
    if len(files) == 1:
        write_file(files[0], LANDINGS.content(lambda file: _hdf5(file, landings, rows, origin)), ExportError)
    elif files:
        _write_csv(files, landings, rows)
    document = [row | {"events": landing.event_rows} for row, landing in zip(rows, landings, strict=True)]
    if not print_result(document, options.json):
        first = landings[0]
        title = f"{first.drone.surface.upper()}, {math.degrees(first.scenario.slope):g} deg, "
        title += f"{first.scenario.speed:g} m/s: {first.label}"
        cells = [[f"{v:.3f}" if isinstance(v, float) else str(v) for v in row.values()] for row in rows]
        columns = [
            TableColumn(label(name), itemgetter(k), number=name != "outcome")
            for k, name in enumerate(rows[0])
        ]
        print_table(table(title, cells, columns))
        for path in files:
            print(f"wrote {path}")


def controller_of(options: TouchdownOptions, ideal_reversal: bool = False) -> Controller:
    """Return the controller of one landing."""
    (controller,) = chosen_controllers(
        [options.controller], options.rules.horizon, file=options.controller_file,
        ideal_reversal=ideal_reversal, trigger=options.trigger,
    )  # fmt: skip
    return controller


def land_drone(drone: Drone, options: TouchdownOptions, controller: Controller | None) -> Landing:
    """Simulate one landing, or without a controller a drop; see `simulate_landings`."""
    scenario, motors = options.begin, None
    for change in find_changes(options.change, single=True) if options.change else ():
        drone = change.apply(drone, change.values[0])
    if options.height is not None and controller is not None:
        way = fly_down(drone, scenario, options.height)
        scenario, motors = way.touchdown, Motors(drone, controller.ideal_reversal, way.motors)
    return land(drone, scenario, controller, rules=options.rules, rate=options.rate, motors=motors)


def headed(row: Mapping[str, object]) -> dict[str, object]:
    """Return a row by the heads of its columns."""
    return {label(name): value for name, value in row.items()}


def _write_csv(files: Sequence[Path], landings: Sequence[Landing], rows: Sequence[dict[str, object]]) -> None:
    events, histories, outcomes = [], [], []
    for rank, (row, landing) in enumerate(zip(rows, landings, strict=True), start=1):
        events += [headed({"set": rank} | event) for event in landing.event_rows]
        histories += [
            dict(zip(("set", *HISTORY), (rank, *line), strict=True)) for line in landing.samples.tolist()
        ]
        scenario, rules = landing.scenario, landing.rules
        outcomes.append(headed(row) | {
            "surface": landing.drone.surface, "controller": landing.label,
            "slope [deg]": math.degrees(scenario.slope), "touchdown speed [m/s]": scenario.speed,
            "pitch [deg]": math.degrees(scenario.pitch), "pitch rate [rad/s]": scenario.pitch_rate,
            "horizontal speed [m/s]": scenario.horizontal_speed,
            "horizon [s]": rules.horizon, "short [m]": rules.short, "long [m]": rules.long,
            "rest speed [m/s]": rules.rest_speed, "rest turn [rad/s]": rules.rest_turn,
            "rest time [s]": rules.rest_time, "flip angle [deg]": math.degrees(rules.flip_angle),
        })  # fmt: skip
    texts = (csv_text(histories), csv_text(events, ("set", *map(label, EVENT))), csv_text(outcomes))
    for path, text in zip(files, texts, strict=True):
        write_file(path, text.encode("utf-8"), ExportError)


def _hdf5(
    file: h5py.File,
    landings: Sequence[Landing],
    rows: Sequence[dict[str, object]],
    sources: dict[str, object],
) -> None:
    first = landings[0]
    settings = {
        "scenario": [asdict(landing.scenario) for landing in landings],
        "controller": asdict(first.controller) if first.controller else None,
        "rules": asdict(first.rules),
    }
    put_json(file, "settings_json", settings)
    put_json(file, "provenance_json", sources)
    for row, landing in zip(rows, landings, strict=True):
        group = file.create_group(f"sets/{row['set']}")
        group.attrs.update(headed(row))
        for name, values in zip(HISTORY, landing.samples.T, strict=True):
            quantity, _, unit = name.partition(" [")
            put(group, quantity, values, "sample", unit.rstrip("]"))
        events = landing.event_rows
        put(group, "events/time", [event["time"] for event in events], "event", "s")
        for key in ("event", "of"):
            put_texts(group, f"events/{key}", [event[key] for event in events])
