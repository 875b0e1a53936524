"""A thrust-stand or load-cell log at a glance: commands, stalls, tare, speeds, and what looks wrong."""

from __future__ import annotations

from collections.abc import Iterator
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


def _largest(channel: Channel | None) -> float:
    if channel is None or not channel.valid.any():
        return float("nan")
    return float(np.nanmax(np.abs(channel.values)))


def _at_rest(recording: Recording, channel: Channel | None) -> float:
    """Return the mean reading of a sensor before the first command or turn; NaN where nothing rests."""
    if channel is None:
        return float("nan")
    end = float(channel.time[-1])
    begin = end
    for name in ("command", "speed"):
        other = recording.channels.get(name)
        if other is None or not other.valid.any():
            continue
        values, time = other.values[other.valid], other.time[other.valid]
        moved = values != values[0] if name == "command" else np.abs(values) > 1.0
        begin = min(begin, float(time[np.argmax(moved)]) if moved.any() else end)
    still = channel.valid & (channel.time < begin)
    return float(channel.values[still].mean()) if still.sum() >= 3 and begin < end else float("nan")


def inspect_bench(recording: Recording) -> tuple[BenchReport, list[Finding]]:
    """Return the report of a running log of a thrust stand or load cell, and its suspicions."""
    channels = recording.channels
    command, speed = channels.get("command"), channels.get("speed")
    thrust, torque = channels.get("thrust"), channels.get("torque")
    clock = next(iter(channels.values())).time
    levels, hidden, low, high = 0, 0, float("nan"), float("nan")
    stalls: tuple[Stall, ...] = ()
    if command is not None and command.valid.any():
        steps = command_steps(command.time, command.values)
        stalls = find_stalls(clock, steps)
        levels, hidden = len(steps.time), sum(stall.doubtful is not None for stall in stalls)
        low, high = float(steps.level.min()), float(steps.level.max())
    rest_thrust, rest_torque = _at_rest(recording, thrust), _at_rest(recording, torque)
    report = BenchReport(levels, low, high, len(stalls), hidden, rest_thrust, rest_torque, _largest(speed))
    return report, list(_suspicions(recording, report))


def _suspicions(recording: Recording, report: BenchReport) -> Iterator[Finding]:
    channels = recording.channels
    thrust, torque = channels.get("thrust"), channels.get("torque")
    if report.top_speed > _FASTEST:
        advice = unit_advice(recording, "speed", "rpm")
        sentence = (
            f"speed reaches {report.top_speed:.4g} rad/s, faster than any such motor: probably rpm; {advice}"
        )
        yield Finding("speed-unit", sentence)
    elif report.top_speed == 0.0:
        yield Finding("no-speed", "speed is zero throughout: the probe was off or saw no mark")
    largest = _largest(thrust)
    if largest > _STRONGEST:
        advice = unit_advice(recording, "thrust", "gf")
        yield Finding("thrust-unit", f"thrust reaches {largest:.4g} N: probably grams; {advice}")
    if _largest(torque) > _LARGEST_TORQUE:
        advice = unit_advice(recording, "torque", "mN*m")
        yield Finding("torque-unit", f"torque exceeds 100 N·m: probably mN·m; {advice}")
    for name, channel, rest, unit in (
        ("thrust", thrust, report.rest_thrust, "N"), ("torque", torque, report.rest_torque, "N·m"),
    ):  # fmt: skip
        if channel is None or not np.isfinite(rest):
            continue
        span = float(np.nanmax(channel.values) - np.nanmin(channel.values))
        if span > 0 and abs(rest) > _TARE * span:
            sentence = f"{name} reads {rest:.3g} {unit} before anything turns: no tare; subtract it"
            yield Finding("no-tare", sentence)
    if _falls(channels.get("speed"), thrust):
        sentence = (
            "thrust falls when the speed rises: the sign of the axis is reversed, or the propeller turns in "
            "reverse"
        )
        yield Finding("thrust-falls", sentence)
    for name in ("force_x", "force_y"):
        side = channels.get(name)
        if thrust is None or side is None or not side.valid.any():
            continue
        if np.nanstd(side.values) > 2.0 * np.nanstd(thrust.values) > 0.0:
            sentence = f"{name} changes more than thrust (Fz): the cell's axes may be swapped"
            yield Finding("cell-axes-swapped", sentence)


def _falls(speed: Channel | None, thrust: Channel | None) -> bool:
    """Return whether thrust falls when the speed rises."""
    if speed is None or thrust is None or not speed.valid.any() or not thrust.valid.any():
        return False
    turning: FloatArray = np.interp(thrust.time, speed.time[speed.valid], np.abs(speed.values[speed.valid]))
    known = thrust.valid
    fast = known & (turning > 0.7 * turning.max())
    slow = known & (turning < 0.2 * turning.max())
    if fast.sum() < 5 or slow.sum() < 5:
        return False
    change = np.median(thrust.values[fast]) - np.median(thrust.values[slow])
    return bool(change < -3.0 * np.std(thrust.values[slow]))
