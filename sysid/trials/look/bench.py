"""A thrust-stand or load-cell log at a glance: commands, stalls, tare, speeds, and what looks wrong."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from sysid.journal import Finding
from sysid.recording import Channel, FloatArray, Recording
from sysid.trials.bench_log import Stall, command_steps, find_stalls
from sysid.trials.look.advice import unit_advice

# No propeller motor of a drone turns faster (95 000 rpm); a number beyond was meant in rpm.
_FASTEST = 10_000.0
# Largest thrust [N] and torque [N·m] of what is put on such stands; beyond, the unit is grams or mN·m.
_STRONGEST, _LARGEST_TORQUE = 2_000.0, 100.0
# A reading at rest beyond this share of the range is a missing tare.
_TARE = 0.02


@dataclass(frozen=True)
class BenchReport:
    """What happens in a log of one motor; NaN where unknown.

    How many levels were commanded one after the other, the lowest and the highest [unit of the protocol];
    pauses of the logger, and which of them hide when a command was given; readings before anything turns [N],
    [N·m]; the top speed [rad/s].
    """

    commands: int
    lowest_command: float
    highest_command: float
    stalls: int
    stalls_at_commands: int
    rest_thrust: float
    rest_torque: float
    top_speed: float


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
    return report, list(_suspicions(recording, known, report))


def _suspicions(recording: Recording, known: Mapping[str, Channel], report: BenchReport) -> Iterator[Finding]:
    if report.top_speed > _FASTEST:
        advice = unit_advice(recording, "speed", "rpm")
        yield Finding(
            "speed-unit",
            f"speed reaches {report.top_speed:.4g} rad/s, faster than any such motor: probably rpm; {advice}",
        )
    elif report.top_speed == 0.0:
        yield Finding("no-speed", "speed is zero throughout: the probe was off or saw no mark")
    largest = _largest(known, "thrust")
    if largest > _STRONGEST:
        advice = unit_advice(recording, "thrust", "gf")
        yield Finding("thrust-unit", f"thrust reaches {largest:.4g} N: probably grams; {advice}")
    if _largest(known, "torque") > _LARGEST_TORQUE:
        advice = unit_advice(recording, "torque", "mN*m")
        yield Finding("torque-unit", f"torque exceeds 100 N·m: probably mN·m; {advice}")
    for name, rest, unit in (("thrust", report.rest_thrust, "N"), ("torque", report.rest_torque, "N·m")):
        if np.isfinite(rest) and abs(rest) > _TARE * np.ptp(known[name].values[known[name].valid]) > 0:
            sentence = f"{name} reads {rest:.3g} {unit} before anything turns: no tare; subtract it"
            yield Finding("no-tare", sentence)
    if "speed" in known and "thrust" in known and _falls(known["speed"], known["thrust"]):
        yield Finding(
            "thrust-falls",
            "thrust falls when the speed rises: the sign of the axis is reversed, or the propeller turns in "
            "reverse",
        )
    sides = ("force_x", "force_y")
    spread = {name: float(np.nanstd(known[name].values)) for name in ("thrust", *sides) if name in known}
    for name in sides:
        if spread.get(name, 0.0) > 2.0 * spread.get("thrust", np.inf) > 0.0:
            sentence = f"{name} changes more than thrust (Fz): the cell's axes may be swapped"
            yield Finding("cell-axes-swapped", sentence)


def _falls(speed: Channel, thrust: Channel) -> bool:
    """Return whether thrust falls when the speed rises."""
    turning: FloatArray = np.interp(thrust.time, speed.time[speed.valid], np.abs(speed.values[speed.valid]))
    fast = thrust.valid & (turning > 0.7 * turning.max())
    slow = thrust.valid & (turning < 0.2 * turning.max())
    if fast.sum() < 5 or slow.sum() < 5:
        return False
    change = np.median(thrust.values[fast]) - np.median(thrust.values[slow])
    return bool(change < -3.0 * np.std(thrust.values[slow]))
