"""Tables of one instrument (thrust stands, load cells, force/torque transducers) become a `Recording`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.clock import declared_rate, row_clock
from sysid.loaders.columns import Column, NamedTable, listing_note, naming, unread_note
from sysid.loaders.load_cell import UNITS, shown_unit
from sysid.loaders.options import BenchOptions, is_positive
from sysid.loaders.registry import family_format
from sysid.loaders.source import Source
from sysid.loaders.table import Numbers
from sysid.recording import Channel, Recording
from sysid.types import FloatArray
from sysid.units import parse_quantity

# Options of a table whose columns are found by name.
NAMED_TABLE: Mapping[str, tuple[str, ...]] = {
    "rate": (), "units": (), "columns": (), "time_back": (), "segment": (),
}  # fmt: skip
AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
# Channels of the loads on these axes.
_LOADS = ("force_x", "force_y", "thrust", "torque_x", "torque_y", "torque")
# Share of the highest speed from which rows count as fast [1].
_FAST = 0.7
# Largest plausible ratio of shaft power to electrical power [1]; above 1, because probes err.
_MOST_EFFICIENT = 1.3
# Least and largest plausible thrust over power [N/W]. It is one over the speed of the air in the disk: at its
# highest speeds a drone's propeller drives the air faster than 1 m/s and slower than 200 m/s.
_PER_WATT = (0.005, 1.0)
# Least correlation of a propeller's thrust or torque with Ω² [1], and fewest rows that show it.
_GROWS, _FEWEST = 0.9, 6
# Over the range of command or speed [1]: a change up to the first is none, one above the second is a step.
# Largest number of changes that are looked at. Time in which every rotor follows half of a step [s].
_SAME, _STEP, _STEPS, _SLOWEST = 0.01, 0.1, 2000, 3.0


@dataclass
class RawTable:
    """Content of a table of one instrument.

    `channels` are those that are ready. `loads` (n, 6) are Fx Fy Fz Tx Ty Tz before tare and transform.
    `scale`, six factors or a (6, 6) matrix, turns them into N and N·m; None where they are. `limits` (6,) are
    the largest calibrated loads, NaN where not stated.
    """

    kind: str
    device: str
    time: FloatArray
    notes: list[Finding]
    channels: dict[str, Channel] = field(default_factory=dict)
    loads: FloatArray | None = None
    scale: FloatArray | None = None
    limits: FloatArray | None = None

    def add(
        self,
        values: dict[int, FloatArray],
        columns: Mapping[str, tuple[Column, str]],
        factors: Mapping[str, float],
    ) -> None:
        """Add a channel per column with any value: `columns` has its SI unit, `factors` what makes it SI."""
        blank = []
        for name, (column, unit) in columns.items():
            column_values = values.pop(column.index)
            if np.isnan(column_values).all():
                blank.append(column.label)
                continue
            scaled = column_values * factors[name] if factors[name] != 1.0 else column_values
            self.channels[name] = Channel(name, shown_unit(unit), self.time, scaled)
        self.notes += listing_note("columns-without-values", "columns without a single value", blank)


def named_table(
    table: NamedTable,
    options: BenchOptions,
    device: str,
    found: Mapping[str, tuple[Column | None, str, str | None]],
    clock: Column | None,
    *others: Column,
) -> tuple[RawTable, Numbers]:
    """Return a table of signals, and the numbers of its rows, the columns `others` included.

    `found` has for each channel its column, its SI unit, and the unit of a column that states none. Rows
    without a clock and a declared rate are points, which are counted.
    """
    path, rate = table.path, declared_rate(table.path, options.rate)
    columns = {name: (column, unit) for name, (column, unit, _) in found.items() if column is not None}
    factors = {
        name: table.declared.factor(column, name, unit, found[name][2])
        for name, (column, unit) in columns.items()
    }
    seconds = table.declared.factor(clock, "time", "s") if clock else 1.0
    table.declared.check_used(table.columns)
    wanted = [*filter(None, [clock]), *others, *(column for column, _ in columns.values())]
    numbers = table.read(wanted)
    kind, time = "static-map", np.arange(numbers.lines.size, dtype=np.float64)
    words = 'rows have no time: each is a steady point; for a running log declare rate = "100 Hz"'
    timed = [note(kind, words)]
    if clock or rate:
        kind, place = "signals", clock.index if clock else None
        time, timed = row_clock(path, numbers, place, seconds, rate, options)
    notes = [*numbers.notes, *timed, *table.declared.notes, *unread_note(table.columns, wanted)]
    raw = RawTable(kind, device, time, notes)
    raw.add(numbers.columns, columns, factors)
    return raw, numbers


def motor_transform(path: str, transform: Mapping[str, object]) -> FloatArray:
    """Return the (6, 6) matrix that turns a load at the transducer into one at the motor's axes.

    `transform` has ``dx dy dz``, from the transducer's origin to the motor's in the transducer's axes (``"10
    mm"``), and ``rx ry rz``, then turns of the axes about x, the new y, the new z (``"90 deg"``); 0 where
    not named. F' = Rᵀ F and T' = Rᵀ (T − d × F), with the columns of R the new axes. A key or a quantity
    that is not understood is a LogError or a UnitError.
    """
    if not isinstance(transform, Mapping):
        raise LogError(
            f'{path}: transform = {transform!r} is no table; expected for example {{dz = "20 mm"}}'
        )
    unknown = sorted(set(transform) - {"dx", "dy", "dz", "rx", "ry", "rz"})
    if unknown:
        raise LogError(f'{path}: transform names "{unknown[0]}"; it can name dx, dy, dz, rx, ry, rz')
    with naming(f"{path}: transform"):
        d = np.array([parse_quantity(str(transform.get(key, "0 m")), "m") for key in ("dx", "dy", "dz")])
        angles = [parse_quantity(str(transform.get(key, "0 rad")), "rad") for key in ("rx", "ry", "rz")]
    from scipy.spatial.transform import Rotation  # takes long to import

    back = Rotation.from_euler("XYZ", angles).as_matrix().T
    cross = np.array([[0.0, -d[2], d[1]], [d[2], 0.0, -d[0]], [-d[1], d[0], 0.0]])
    out = np.zeros((6, 6))
    out[:3, :3], out[3:, 3:], out[3:, :3] = back, back, -back @ cross
    return out


def _load_channels(path: str, raw: RawTable, load: FloatArray, options: BenchOptions) -> dict[str, Channel]:
    """Return the six loads: tare off, scaled, at the motor's axes."""
    tare = options.tare
    if tare is not None:
        if not is_positive(tare):
            raise LogError(
                f"{path}: tare = {tare!r}; expected seconds at the start of the log without load, or with "
                'their unit: tare = "1 s"'
            )
        first = load[raw.time < raw.time[0] + float(tare)]
        if not np.isfinite(first).any(axis=0).all():
            raise LogError(f"{path}: the first {float(tare):g} s have no sample to take the tare from")
        load = load - np.nanmean(first, axis=0)
        raw.notes.append(note("tare-subtracted", f"tare: the mean of the first {tare:g} s was subtracted"))
    if raw.scale is not None:
        load = load @ raw.scale.T if raw.scale.ndim == 2 else load * raw.scale
    if raw.limits is not None and (over := np.any(np.abs(load) > raw.limits, axis=0)).any():
        beyond = ", ".join(AXES[i] for i in np.flatnonzero(over))
        raw.notes.append(note("beyond-calibrated-range", f"beyond the calibrated range: {beyond}"))
    if options.transform:
        load = load @ motor_transform(path, options.transform).T  # NaN in all loads that a blank cell enters
        raw.notes.append(note("loads-transformed", "loads are at the motor's axes, as declared by transform"))
    return {
        name: Channel(name, shown_unit(UNITS[name]), raw.time, load[:, i].copy())
        for i, name in enumerate(_LOADS)
    }


def _power_findings(channels: Mapping[str, Channel]) -> list[Finding]:
    """Return warnings where thrust, torque, speed and electrical power cannot belong to one propeller.

    A unit that is wrong by 4.4 (lbf for N) passes; one that is wrong by 100 or 1000 (kgf for gf) does not.
    """
    speed, none = channels["speed"].values if "speed" in channels else np.empty(0), np.empty(0)
    if not np.isfinite(speed).any():
        return []
    # Channels of another length than the speed are left out: a speed that is counted from pulses has its own
    # clock, so its rows are not the rows of the other channels.
    thrust, torque, voltage, current = (
        channels[name].values if name in channels and channels[name].values.size == speed.size else none
        for name in ("thrust", "torque", "voltage", "current")
    )
    fast = np.abs(speed) >= _FAST * np.nanmax(np.abs(speed))

    def middle(values: FloatArray) -> float:
        seen = np.abs(values[fast & np.isfinite(values)]) if values.size else none
        return float(np.median(seen)) if seen.size else 0.0

    def grows(values: FloatArray) -> bool:
        whole = np.isfinite(speed * values) if values.size else np.zeros(speed.size, dtype=np.bool_)
        y, x = values[whole] if whole.any() else none, speed[whole] ** 2
        enough = y.size >= _FEWEST and np.ptp(x) > 0 and np.ptp(y) > 0
        return bool(enough and abs(np.corrcoef(y, x)[0, 1]) > _GROWS)

    shaft = middle(torque * speed) if grows(torque) else 0.0
    supply = middle(voltage * current) if voltage.size and current.size else 0.0
    sentences = []
    if supply > 0 and shaft > _MOST_EFFICIENT * supply:
        sentences.append(
            f"torque × speed is {shaft:.3g} W at the highest speeds where voltage × current is {supply:.3g} "
            "W, which no motor gives: check the units of torque, speed and current"
        )
    pull = middle(thrust) if grows(thrust) else 0.0
    for name, power in (("torque × speed", shaft), ("voltage × current", supply)):
        if pull > 0 and power > 0 and not _PER_WATT[0] <= pull / power <= _PER_WATT[1]:
            sentences.append(
                f"thrust over {name} is {pull / power:.3g} N/W at the highest speeds; propellers give "
                f"{_PER_WATT[0]:g} to {_PER_WATT[1]:g} N/W: check the units of both"
            )
    return [Finding("implausible-power", sentence) for sentence in sentences]


def _clock_findings(channels: Mapping[str, Channel]) -> list[Finding]:
    """Return a warning where the speed follows steps of the command far more slowly than any rotor."""
    command, speed = channels.get("command"), channels.get("speed")
    if command is None or speed is None or command.values.size != speed.values.size:
        return []
    known = np.isfinite(command.values) & np.isfinite(speed.values)
    time, u, turns = speed.time[known], command.values[known], speed.values[known]
    if not u.size:
        return []
    changes = np.flatnonzero(np.abs(np.diff(u)) > _SAME * np.ptp(u))
    halves = []
    for start, end in pairwise([*changes[:_STEPS], u.size - 1]):
        moved = np.abs(turns[start : end + 1] - turns[start])
        half = int(np.argmax(moved > moved[-1] / 2))
        # Fewer samples only show that the log is slow.
        stepped = abs(u[start + 1] - u[start]) > _STEP * np.ptp(u) and moved[-1] > _STEP * np.ptp(turns)
        if stepped and half >= _FEWEST:
            halves.append(time[start + half] - time[start])
    if not halves or (taken := float(np.median(halves))) < _SLOWEST:
        return []
    return [Finding("implausible-clock", (
        f"after a step of the command the speed takes {taken:.2g} s for half of its way, and a rotor takes "
        "0.01 to 1 s: correct the unit in the heading of the time column, or state units = {time = \"ms\"}"
    ))]  # fmt: skip


def _recording(
    source: Source, name: str, parse: Callable[[Source, BenchOptions], RawTable], options: BenchOptions
) -> Recording:
    if options.transform is not None:
        motor_transform(source.path, options.transform)  # refused before the file is read
    raw = parse(source, options)
    channels = raw.channels
    if raw.loads is not None:
        channels |= _load_channels(source.path, raw, raw.loads, options)
    raw.notes += _power_findings(channels)
    raw.notes += _clock_findings(channels) if raw.kind != "static-map" else []
    provenance = source.provenance(name, device=raw.device, options=options, notes=raw.notes)
    return Recording(raw.kind, channels, provenance)


table_format = partial(family_format, BenchOptions, _recording)
