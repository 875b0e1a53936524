"""One landing per set from the command line: histories with units, events and outcome as CSV or HDF5."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from sysid import exact_json
from sysid.errors import CampaignError, ExportError
from sysid.landing.approach import descend
from sysid.landing.outcomes import Rules
from sysid.landing.scenario import Scenario
from sysid.landing.simulate import Landing, land
from sysid.landing.thrust import Motors
from sysid.storage import write_file
from sysid.workflows.landing_sources import LandingOptions

SCHEMA, VERSION = "sysid-landings", 1
COLUMNS = (
    "time [s]",
    "x_B [m]", "z_B [m]", "q_B [rad]", "h_C [m]", "q_C [rad]", "h_D [m]", "q_D [rad]",
    "x_B_rate [m/s]", "z_B_rate [m/s]", "q_B_rate [rad/s]", "h_C_rate [m/s]", "q_C_rate [rad/s]",
    "h_D_rate [m/s]", "q_D_rate [rad/s]",
    "rear_normal_force [N]", "front_normal_force [N]", "rear_friction [N]", "front_friction [N]",
    "rear_thrust [N]", "front_thrust [N]",
)  # fmt: skip


def simulate_landings(
    gear: Path,
    sources: LandingOptions,
    scenario: Scenario,
    rules: Rules,
    *,
    out: Path | None = None,
    height: float | None = None,
    rate: float = 1000.0,
    force: bool = False,
    json: bool = False,
) -> list[Landing]:
    """Simulate one landing per set, write and print them.

    Parameters
    ----------
    gear : Path
        Gear sets: fit folder or file.
    sources : LandingOptions
        Motors and the one controller.
    scenario : Scenario
        The touchdown; with `height` what the drone has when it starts to descend.
    rules : Rules
        When a landing is over.
    out : Path, optional
        ``.csv`` (and one file each for events and outcomes beside it) or ``.h5``.
    height : float, optional
        Descend from here above the touchdown with the attitude controller on [m].
    rate : float
        Samples per second [Hz].
    force, json : bool
        Replace what is there; print JSON.

    Raises
    ------
    SysidError
        When the sets, the controller or the place to write cannot be used.
    """
    files = _files(out, force)
    (fleet,), origin = sources.fleets([gear])
    told = sources.told(rules.horizon)
    if len(told) != 1:
        raise CampaignError(f"--controller: found {len(told)}, give one")
    landings = []
    for drone in fleet:
        begin, motors = scenario, None
        if height is not None:
            way = descend(drone, scenario, height)
            begin, motors = way.touchdown, Motors(drone, told[0].ideal_reversal, way.motors)
        landings.append(land(drone, begin, told[0], rules=rules, rate=rate, motors=motors))
    _write(files, landings, origin)
    rows = [outcome_row(rank, one) for rank, one in enumerate(landings, start=1)]
    if json:
        events = [event_rows(one) for one in landings]
        print(exact_json.dumps([row | {"events": e} for row, e in zip(rows, events, strict=True)]))
    else:
        Console().print(_table(rows, landings[0]))
        for path in files:
            print(f"wrote {path}")
    return landings


def _files(out: Path | None, force: bool) -> list[Path]:
    """Return the files to write; refuse what is in the way."""
    if out is None:
        return []
    kind = out.suffix.lower()
    if kind not in (".csv", ".h5", ".hdf5"):
        raise ExportError(f"{out}: unknown format {out.suffix!r}; give --out a name that ends in .csv or .h5")
    files = [out]
    if kind == ".csv":
        files += [out.with_name(f"{out.stem}-{what}.csv") for what in ("events", "outcomes")]
    for path in files:
        if path.exists() and not force:
            raise ExportError(f"{path}: exists already; choose a new name or add --force")
    if not out.resolve().parent.is_dir():
        raise ExportError(f"{out}: the folder {out.parent} does not exist; make it first")
    return files


def samples(landing: Landing) -> NDArray[np.float64]:
    """Return the history (n, len(COLUMNS)) in the columns' units."""
    t = landing.trajectory
    return np.column_stack([t.time, t.state, t.normal_force, t.friction_force, t.thrust])


def event_rows(landing: Landing) -> list[dict[str, Any]]:
    """Return the events of a landing in the order of time."""
    own = [(landing.trigger, "trigger", "body")] if math.isfinite(landing.trigger) else []
    own += [(event.time, event.kind.name.lower(), event.foot) for event in landing.trajectory.events]
    return [{"time [s]": t, "event": kind, "of": foot} for t, kind, foot in sorted(own)]


def outcome_row(rank: int, landing: Landing) -> dict[str, Any]:
    """Return what became of a landing."""
    return {
        "set": rank,
        "outcome": landing.outcome.name.lower(),
        "distance [m]": landing.distance,
        "time to rest [s]": landing.time,
        "trigger [s]": landing.trigger,
    }


def conditions(landing: Landing) -> dict[str, Any]:
    """Return under what a landing happened: surface, controller, touchdown and rules."""
    scenario, rules = landing.scenario, landing.rules
    return {
        "surface": landing.drone.surface,
        "controller": landing.controller.label,
        "slope [deg]": math.degrees(scenario.slope),
        "touchdown speed [m/s]": scenario.speed,
        "pitch [deg]": math.degrees(scenario.pitch),
        "pitch rate [rad/s]": scenario.pitch_rate,
        "horizontal speed [m/s]": scenario.horizontal_speed,
        "horizon [s]": rules.horizon,
        "short [m]": rules.short,
        "long [m]": rules.long,
        "rest speed [m/s]": rules.rest_speed,
        "rest turn [rad/s]": rules.rest_turn,
        "rest time [s]": rules.rest_time,
        "flip angle [deg]": math.degrees(rules.flip_angle),
    }


def _write(files: Sequence[Path], landings: Sequence[Landing], sources: dict[str, Any]) -> None:
    if not files:
        return
    rows = [outcome_row(rank, one) for rank, one in enumerate(landings, start=1)]
    if len(files) == 1:
        write_file(files[0], _hdf5(landings, rows, sources), ExportError)
        return
    events = [{"set": rank} | row for rank, one in enumerate(landings, start=1) for row in event_rows(one)]
    table = io.StringIO(newline="")
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(("set", *COLUMNS))
    for rank, one in enumerate(landings, start=1):
        writer.writerows((rank, *(repr(value) for value in line)) for line in samples(one).tolist())
    outcomes = [row | conditions(one) for row, one in zip(rows, landings, strict=True)]
    for path, text in zip(files, (table.getvalue(), _csv(events), _csv(outcomes)), strict=True):
        write_file(path, text.encode("utf-8"), ExportError)


def _csv(rows: Sequence[dict[str, Any]]) -> str:
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]) if rows else ["set"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _hdf5(landings: Sequence[Landing], rows: Sequence[dict[str, Any]], sources: dict[str, Any]) -> bytes:
    buffer = io.BytesIO()
    text = h5py.string_dtype()
    with h5py.File(buffer, "w") as file:
        file.attrs["schema"], file.attrs["version"] = SCHEMA, VERSION
        first = landings[0]
        settings = {
            "scenario": [one.scenario.document() for one in landings],
            "controller": first.controller.document(),
            "rules": first.rules.document(),
        }
        file.create_dataset("settings_json", data=exact_json.dumps(settings), dtype=text)
        file.create_dataset("provenance_json", data=exact_json.dumps(sources), dtype=text)
        for row, one in zip(rows, landings, strict=True):
            group = file.create_group(f"sets/{row['set']}")
            for name, value in row.items():
                group.attrs[name] = value
            for name, values in zip(COLUMNS, samples(one).T, strict=True):
                quantity, _, unit = name.partition(" [")
                group.create_dataset(quantity, data=values).attrs["unit"] = unit.rstrip("]")
            events = event_rows(one)
            group["events/time"] = np.array([event["time [s]"] for event in events])
            group["events/time"].attrs["unit"] = "s"
            for key in ("event", "of"):
                group.create_dataset(f"events/{key}", data=[event[key] for event in events], dtype=text)
    return buffer.getvalue()


def _table(rows: Sequence[dict[str, Any]], first: Landing) -> Table:
    scenario = first.scenario
    table = Table(
        box=box.SIMPLE_HEAD,
        title=f"{first.drone.surface.upper()}, {math.degrees(scenario.slope):g} deg, {scenario.speed:g} m/s: "
        f"{first.controller.label}",
    )
    for name in rows[0]:
        table.add_column(Text(name), justify="left" if name == "outcome" else "right")
    for row in rows:
        table.add_row(*(f"{v:.3f}" if isinstance(v, float) else str(v) for v in row.values()))
    return table
