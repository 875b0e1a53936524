"""Content of a recording and what looks wrong with it, before anything is fitted.

    from sysid.trials.look import inspect_recording
    report = inspect_recording(load("drop.csv"))
    report.suspicions, report.drop, report.bench

Judges only what one recording shows; nothing is changed, and a suspicion is for a human to check.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import TypeAdapter

from sysid.filters import runs
from sysid.journal import Finding
from sysid.loaders.registry import formats
from sysid.recording import Channel, FloatArray, Recording
from sysid.shown import Shown
from sysid.trials.bench_log import Stall, command_steps, drop_outs, find_stalls
from sysid.trials.capture import signed_axis
from sysid.trials.look.drop import HANGING, STANDARD_GRAVITY, DropReport, inspect_drop, mean_turn

if TYPE_CHECKING:
    import pandas as pd

# Largest distance from the origin of a capture volume [m].
_FARTHEST = 100.0
# Largest error of the measured g that is no suspicion [1], and of the direction of the fall [rad].
_WRONG_GRAVITY, _CROOKED = 0.03, np.radians(5.0)
# Largest tilt of a body that hangs level by eye, with axes defined on a table [rad].
_TILTED = np.radians(10.0)
# Acceleration of a body [m/s²] that no impact between two frames explains, and the least jump of it [m].
_IMPOSSIBLE, _LEAST_JUMP = 2_000.0, 0.01
# Share of a log without a value of a channel, from which it is suspicious [1].
_MUCH = 1.0 / 3.0
# Words of a sentence for units of length whose name as an option differs.
_IN_WORDS = {"inch": "inches", "foot": "feet", "m": "metres, read as mm"}
# Highest speed of a drone's propeller motor [rad/s] (95 000 rpm); a number beyond was meant in rpm.
_FASTEST = 10_000.0
# Largest thrust [N] and torque [N·m] on such stands; larger numbers are grams or mN·m.
_STRONGEST, _LARGEST_TORQUE = 2_000.0, 100.0
# Largest reading at rest of a tared sensor, as a share of its range in the log [1].
_TARE = 0.02
# Least length of a hole in the clock [median steps].
_HOLE = 2.5
# Fewest equal samples in a row, and their least share of all, that show a sensor at its limit.
_FLAT_RUN, _FLAT_SHARE = 5, 0.005
# Formats whose files state a length unit; a declared one that contradicts it is refused.
_STATES_LENGTHS = frozenset({"motive-csv", "pose-table", "vicon-csv", "c3d"})


@dataclass(frozen=True)
class ChannelReport:
    """Numbers of one channel; of all its components together."""

    name: str
    unit: str
    # Rows on its clock, and the share of them without a value [1].
    samples: int
    blank: float
    # Range [unit]; NaN without a value.
    lowest: float
    highest: float
    # Median sample rate [Hz]; NaN below two samples and where rows have no time.
    rate: float
    # 90th percentile of |step - median step| over the median step [1]; NaN where the rate is.
    jitter: float
    # Steps longer than 2.5 times the median.
    holes: int
    # Longest step of the clock, and longest time without a value, at either end too [s]; NaN without times.
    longest_hole: float
    longest_blank: float
    # Share of values equal to the one before [1].
    repeated: float
    # Share of values in runs of five or more at either extreme [1].
    saturated: float


@dataclass(frozen=True)
class BenchReport:
    """What happens in a log of one motor; NaN where unknown."""

    # Levels commanded one after the other, the lowest and the highest [unit of the protocol].
    commands: int
    lowest_command: float
    highest_command: float
    # Pauses of the logger, and those that hide when a command was given.
    stalls: int
    stalls_at_commands: int
    # Readings before anything turns [N], [N·m].
    rest_thrust: float
    rest_torque: float
    # Top speed [rad/s].
    top_speed: float


@dataclass(frozen=True, repr=False)
class LogReport(Shown):
    """What is known about one log."""

    path: str
    sha256: str
    format: str
    device: str
    kind: str
    # First to last sample of any channel [s]; NaN for a static map.
    duration: float
    channels: tuple[ChannelReport, ...]
    drop: DropReport | None
    # Only for a running log of a thrust stand or load cell.
    bench: BenchReport | None
    # Sentences on what looks like a mistake.
    suspicions: tuple[Finding, ...]
    # Sentences of the loader: what it noticed and did.
    notes: tuple[Finding, ...]

    def __repr__(self) -> str:
        lasts = "" if math.isnan(self.duration) else f", {self.duration:.4g} s"
        doubts = f"{len(self.suspicions) or 'no'} suspicion{'' if len(self.suspicions) == 1 else 's'}"
        head = f"<LogReport {Path(self.path).name} ({self.kind}, {self.format})"
        return f"{head}: {len(self.channels)} channels{lasts}, {doubts}>"

    def to_frame(self) -> pd.DataFrame:
        """Return what is known about each channel, one row each."""
        import pandas as pd

        return pd.DataFrame([asdict(channel) for channel in self.channels]).set_index("name")

    def remarks(self) -> tuple[Finding, ...]:
        """Return suspicions and notes."""
        return tuple(dict.fromkeys((*self.suspicions, *self.notes)))

    def as_json(self) -> dict[str, object]:
        """Return the report as plain values for JSON; a number that is unknown is None."""
        stated: dict[str, object] = json.loads(TypeAdapter(LogReport).dump_json(self))
        for name in ("suspicions", "notes"):
            stated[name] = [str(finding) for finding in getattr(self, name)]
        return stated


def log_quality(name: str, use: str, report: LogReport) -> dict[str, object]:
    """Return how good the log of a trial is, as `sysid check` states it."""
    channels = report.channels
    return {
        "name": name,
        "use": use,
        "log": Path(report.path).name,
        "rate": max((channel.rate for channel in channels), default=math.nan),
        "jitter": max((channel.jitter for channel in channels), default=math.nan),
        "holes": max((channel.holes for channel in channels), default=0),
        "saturated": max((channel.saturated for channel in channels), default=0.0),
        "suspicions": [str(finding) for finding in report.suspicions],
    }


def inspect_recording(recording: Recording, gravity: float = STANDARD_GRAVITY) -> LogReport:
    """Return the content of a recording and what looks wrong with it, under a gravity [m/s²]."""
    clock = recording.kind != "static-map"  # averaged points have no times
    channels = tuple(inspect_channel(channel, clock) for channel in recording.channels.values())
    suspicions = [finding for finding in recording.provenance.notes if finding.severity == "warning"]
    drop, bench = None, None
    if recording.kind in ("thrust-stand", "load-cell"):
        bench, findings = inspect_bench(recording)
        suspicions += findings
    if recording.kind == "motion-capture":
        drop = inspect_drop(recording, gravity)
        suspicions += _capture_suspicions(recording, drop, gravity)
    suspicions += [
        Finding(
            "saturated",
            f"{c.name} sits at its limit ({c.highest:.4g} {c.unit}) for {100 * c.saturated:.2g} % of the "
            "samples: the sensor may be saturated",
        )
        for c in channels
        if c.saturated > 0
    ]
    suspicions += [
        Finding("blank-channel", f"{c.name} has no value at all") for c in channels if c.blank == 1.0
    ]
    if clock:
        suspicions += _lost(recording, channels)
    clocks = [channel.time for channel in recording.channels.values() if channel.time.size]
    first, last = min((t[0] for t in clocks), default=0.0), max((t[-1] for t in clocks), default=0.0)
    provenance = recording.provenance
    return LogReport(
        provenance.path, provenance.sha256, provenance.format, provenance.device, recording.kind,
        float(last - first) if clock else math.nan,
        channels, drop, bench, tuple(suspicions), provenance.notes,
    )  # fmt: skip


def _lost(recording: Recording, channels: Sequence[ChannelReport]) -> Iterator[Finding]:
    """Yield suspicions of parts that a log does not have: much of a channel, rows without any value."""
    captured = recording.kind == "motion-capture"
    for report in channels:
        time = recording.channels[report.name].time
        # A slow sensor beside a fast one is blank in most rows and never for long.
        part = report.blank if captured else report.longest_blank / max(float(np.ptp(time)), 1e-300)
        if part >= _MUCH and report.blank < 1.0:
            where = "of the frames" if captured else "of the log at a stretch"
            yield Finding("much-lost", f"{report.name} has no value in {100 * part:.0f} % {where}")
    rows: dict[tuple[float, ...], list[Channel]] = {}
    for channel in recording.channels.values():
        clock = (channel.time.size, *channel.time[[0, -1]]) if channel.time.size else ()
        rows.setdefault(clock, []).append(channel)
    for members in rows.values():
        # A body has two channels and is lost in both.
        if len({channel.name.rpartition("/")[0] or channel.name for channel in members}) > 1:
            blank = ~np.logical_or.reduce([channel.valid for channel in members])
            if blank.any() and not blank.all():
                first = members[0].time[np.argmax(blank)]
                sentence = f"rows without any value: {int(blank.sum())} (first: at {first:.6g} s)"
                yield Finding("blank-rows", sentence)


def _jumps(body: str, channel: Channel) -> Iterator[Finding]:
    """Yield a suspicion of a body that is elsewhere in one frame, or from one frame on."""
    time, place = channel.time[channel.valid], channel.values[channel.valid]
    if time.size < 3:
        return
    steps = np.diff(time)
    step = float(np.median(steps))
    even = np.maximum(steps[1:], steps[:-1]) < 1.5 * step
    bend = np.linalg.norm(np.diff(place, 2, axis=0), axis=1) * even
    if bend.max() > max(_LEAST_JUMP, _IMPOSSIBLE * step**2):
        worst = int(bend.argmax()) + 1
        size = max(float(np.linalg.norm(place[worst] - place[worst + way])) for way in (-1, 1))
        yield Finding(
            "jump",
            f"{body} jumps by {1e3 * size:.3g} mm in one frame at {time[worst]:.6g} s, which no motion "
            "explains: a marker was taken for another, or the row is damaged",
        )


def _capture_suspicions(recording: Recording, drop: DropReport | None, gravity: float) -> Iterator[Finding]:
    far = [
        (name, float(np.nanmax(np.abs(channel.values))))
        for name, channel in recording.channels.items()
        if name.endswith("/position") and channel.valid.any()
    ]
    name, distance = max(far, key=lambda place: place[1], default=("", 0.0))
    if distance > _FARTHEST and (drop is None or not drop.length_unit):  # one unit is suspected, not two
        yield Finding(
            "length-unit",
            f"{name} reaches {distance:.4g} m: lengths are probably mm; {length_advice(recording, 'mm')}",
        )
    elif drop is None or not drop.length_unit:  # in a wrong unit, noise is a jump
        for body in recording.rigid_bodies:
            yield from _jumps(body, recording[f"{body}/position"])
    if drop is None:
        return
    if drop.length_unit:
        words = _IN_WORDS.get(drop.length_unit, drop.length_unit)
        advice = length_advice(recording, drop.length_unit)
        yield Finding("length-unit", f"{drop.body} falls as if lengths were in {words}; {advice}")
        return
    # 3 % over a flight of 0.2 s is a few sample errors; shorter flights determine g worse.
    flight = drop.touchdown - (drop.release if drop.release is not None else drop.touchdown - 0.1)
    if abs(drop.gravity / gravity - 1.0) > max(_WRONG_GRAVITY, 0.01 / max(flight, 1e-3)):
        yield Finding(
            "wrong-gravity",
            f"{drop.body} falls with {drop.gravity:.3g} m/s² instead of {gravity:.4g}: check the rate, the "
            "length unit and that nothing brakes it",
        )
    if drop.up_error > _CROOKED:
        yield Finding(
            "tilted-capture",
            f"the fall is {np.degrees(drop.up_error):.0f} deg off the axis {drop.up}: the capture's ground "
            "plane is tilted",
        )
    orientation = recording.channels.get(f"{drop.body}/orientation")
    if orientation is not None and drop.release is not None:
        up = signed_axis(drop.up)
        hanging = mean_turn(orientation, drop.release - HANGING, drop.release)
        tilt = 0.0 if hanging is None else float(np.arccos(np.clip(hanging.apply(up) @ up, -1.0, 1.0)))
        if tilt > _TILTED:
            yield Finding(
                "hangs-tilted",
                f"{drop.body} hangs {np.degrees(tilt):.0f} deg off level before its release: check the order "
                "of the quaternion's components, and that the body was level when the capture defined it",
            )
    if drop.up[0] == "-":
        sentence = f'{drop.body} falls toward +{drop.up[1]}: that axis points down; set up = "{drop.up}"'
        yield Finding("axis-down", sentence)
    elif drop.up[1] == "x":
        sentence = f'{drop.body} falls along x: axes may be swapped; set up = "{drop.up}"'
        yield Finding("axes-swapped", sentence)


def inspect_channel(channel: Channel, clock: bool = True) -> ChannelReport:
    """Return the numbers of a channel; without a clock all is NaN that a clock would tell."""
    time, valid = channel.time, channel.valid
    steps = np.diff(time)
    median = float(np.median(steps)) if steps.size else float("nan")
    # Deviations within the rounding of times of this size count as zero.
    rounding = 4.0 * float(np.spacing(np.abs(time).max(initial=1.0)))
    deviation = float(np.percentile(np.abs(steps - median), 90)) if steps.size else float("nan")
    known = channel.values[valid]
    repeats = np.diff(known, axis=0) == 0
    equal = repeats if repeats.ndim == 1 else repeats.all(axis=1)
    seen = np.flatnonzero(valid)
    longest_blank = 0.0  # between two values, or from one to an end of the log
    if seen.size:
        between = np.diff(time[seen])[np.diff(seen) > 1].max(initial=0.0)
        longest_blank = float(max(between, time[seen[0]] - time[0], time[-1] - time[seen[-1]]))
    elif time.size:
        longest_blank = float(time[-1] - time[0])
    discrete = channel.unit in ("us", "dshot", "rad/s") or channel.name in ("command", "log_time")
    saturated = 0.0  # stuck at a limit other than zero
    low, high = (float(known.min()), float(known.max())) if known.size else (float("nan"), float("nan"))
    if not discrete and known.ndim == 1 and known.size >= 10 * _FLAT_RUN and low != high:
        stuck = [b - a for limit in (low, high) if limit != 0.0 for a, b in runs(known == limit)]
        saturated = sum(length for length in stuck if length >= _FLAT_RUN) / known.size
        # Half of the samples at one value is a plateau or a probe that is off, not a sensor at its limit.
        saturated = saturated if _FLAT_SHARE <= saturated <= 0.5 else 0.0
    report = ChannelReport(
        channel.name,
        channel.unit,
        int(time.size),
        float(1.0 - valid.mean()) if time.size else 0.0,
        low,
        high,
        channel.rate,
        0.0 if deviation <= rounding else deviation / median,
        int(np.count_nonzero(steps > _HOLE * median)) if steps.size else 0,
        float(steps.max()) if steps.size else 0.0,
        longest_blank,
        float(equal.mean()) if equal.size else 0.0,
        saturated,
    )
    if clock:
        return report
    unknown = float("nan")
    return replace(report, rate=unknown, jitter=unknown, holes=0, longest_hole=unknown, longest_blank=unknown)


def _largest(known: Mapping[str, Channel], name: str) -> float:
    return float(np.nanmax(np.abs(known[name].values))) if name in known else float("nan")


def _at_rest(known: Mapping[str, Channel], name: str) -> float:
    """Return the mean reading of a sensor before the first command or turn; NaN where nothing rests."""
    if name not in known:
        return float("nan")
    channel = known[name]
    begin = end = float(channel.time[-1])
    for cause in ("command", "speed"):
        if cause in known:
            valid = known[cause].valid
            values, time = known[cause].values[valid], known[cause].time[valid]
            moved = values != values[0] if cause == "command" else np.abs(values) > 1.0
            begin = min(begin, float(time[np.argmax(moved)]) if moved.any() else end)
    still = channel.valid & (channel.time < begin)
    return float(channel.values[still].mean()) if still.sum() >= 3 and begin < end else float("nan")


def inspect_bench(recording: Recording) -> tuple[BenchReport, list[Finding]]:
    """Return the report of a running log of a thrust stand or load cell, and its suspicions."""
    known = {name: channel for name, channel in recording.channels.items() if channel.valid.any()}
    levels, low, high = 0, float("nan"), float("nan")
    stalls: tuple[Stall, ...] = ()
    if "command" in known:
        steps = command_steps(known["command"].time, known["command"].values)
        stalls = find_stalls(next(iter(recording.channels.values())).time, steps)
        levels, low, high = len(steps.time), float(steps.level.min()), float(steps.level.max())
    hidden = sum(stall.doubtful is not None for stall in stalls)
    rests = _at_rest(known, "thrust"), _at_rest(known, "torque")
    report = BenchReport(levels, low, high, len(stalls), hidden, *rests, _largest(known, "speed"))
    found: list[Finding] = []
    if report.top_speed > _FASTEST:
        advice = unit_advice(recording, "speed", "rpm")
        sentence = f"speed reaches {report.top_speed:.4g} rad/s, faster than any such motor: probably rpm"
        found.append(Finding("speed-unit", f"{sentence}; {advice}"))
    elif report.top_speed == 0.0:
        found.append(Finding("no-speed", "speed is zero throughout: the probe was off or saw no mark"))
    largest = _largest(known, "thrust")
    if largest > _STRONGEST:
        advice = unit_advice(recording, "thrust", "gf")
        found.append(Finding("thrust-unit", f"thrust reaches {largest:.4g} N: probably grams; {advice}"))
    if _largest(known, "torque") > _LARGEST_TORQUE:
        advice = unit_advice(recording, "torque", "mN*m")
        found.append(Finding("torque-unit", f"torque exceeds 100 N·m: probably mN·m; {advice}"))
    for name, rest, unit in (("thrust", report.rest_thrust, "N"), ("torque", report.rest_torque, "N·m")):
        if np.isfinite(rest) and abs(rest) > _TARE * np.ptp(known[name].values[known[name].valid]) > 0:
            sentence = f"{name} reads {rest:.3g} {unit} before anything turns: no tare; subtract it"
            found.append(Finding("no-tare", f"{sentence} (fit-motor does)"))
    if "speed" in known:
        time, turns = known["speed"].time[known["speed"].valid], known["speed"].values[known["speed"].valid]
        lost = drop_outs(time, turns)
        starts = np.flatnonzero(lost & ~np.roll(lost, 1))
        if starts.size:
            sentence = (
                f"speed drops out {starts.size} times (first: {abs(turns[starts[0]]):.4g} rad/s at "
                f"{time[starts[0]]:.6g} s; {np.count_nonzero(lost)} samples in all), which no propeller can "
                "follow: the probe missed pulses"
            )
            found.append(Finding("speed-drop-outs", sentence))
    if "speed" in known and "thrust" in known:
        speed, thrust = known["speed"], known["thrust"]
        signed: FloatArray = np.interp(thrust.time, speed.time[speed.valid], speed.values[speed.valid])
        turning = np.abs(signed)
        fast = thrust.valid & (turning > 0.7 * turning.max())
        slow = thrust.valid & (turning < 0.2 * turning.max())
        idle = thrust.values[slow]
        # A signed speed says itself that the propeller turns in reverse.
        along = np.sign(signed[fast]) * (thrust.values[fast] - (np.median(idle) if idle.size else 0.0))
        if along.size >= 5 and idle.size >= 5 and np.median(along) < -3.0 * np.std(idle):
            sentence = "thrust falls when the speed rises: the sign of the axis is reversed, or the propeller"
            found.append(Finding("thrust-falls", f"{sentence} turns in reverse"))
    sides = ("force_x", "force_y")
    spread = {name: float(np.nanstd(known[name].values)) for name in ("thrust", *sides) if name in known}
    for name in sides:
        if spread.get(name, 0.0) > 2.0 * spread.get("thrust", np.inf) > 0.0:
            sentence = f"{name} changes more than thrust (Fz): the cell's axes may be swapped"
            found.append(Finding("cell-axes-swapped", sentence))
    return report, found


def _mend(recording: Recording, option: str) -> str:
    """Return where to correct the unit if the file's format has no `option`; empty if it has."""
    provenance = recording.provenance
    if any(finding.code == "converted" for finding in provenance.notes[-1:]):
        return "convert the original log again with its true unit"
    known = formats().get(provenance.format)
    if known is None or option not in known.options:
        return "correct it where the log was written, or in its header"
    return ""


def unit_advice(recording: Recording, channel: str, unit: str) -> str:
    """Return how to say the unit that the speed, thrust or torque of a bench log is probably in.

    The recording's format and options decide.
    """
    mend = _mend(recording, "units")
    if mend:
        return mend
    provenance = recording.provenance
    if channel == "speed" and "pulses_per_revolution" in provenance.options:
        return "check pulses_per_revolution"
    if provenance.format == "ati-text":  # six channels by place share two units
        if "calibration" in provenance.options:
            return "check that the calibration belongs to this transducer"
        return f'correct {"torque" if channel == "torque" else "force"} = "{unit}" in units'
    return f'declare units = {{{channel} = "{unit}"}}'


def length_advice(recording: Recording, unit: str) -> str:
    """Return how to say the length unit of a capture, as `unit_advice`."""
    mend = _mend(recording, "length_unit")
    if mend:
        return mend
    provenance = recording.provenance
    if provenance.format in _STATES_LENGTHS and "length_unit" not in provenance.options:
        if provenance.format == "pose-table":
            return f'declare units = {{x = "{unit}", y = "{unit}", z = "{unit}"}}'
        return "the file states its length unit, so correct it there or export again"
    return f'declare length_unit = "{unit}"'
