"""The bench logs that a motor campaign names: read, and their signs, tare and doubtful intervals settled."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sysid.campaign import MotorCampaign
from sysid.campaign.motor import MotorTrial as TrialEntry
from sysid.errors import LogError, SysidWarning
from sysid.pipelines.bench_reading import read_log
from sysid.recording import Recording
from sysid.trials.steady import SteadyPoints, ramp_points, steady_points
from sysid.trials.thrust import (
    CommandRange,
    CommandSteps,
    Tare,
    check_command_direction,
    command_steps,
    find_stalls,
    real_samples,
    rows_at_rest,
    sign_against_speed,
    signed_speed,
    tare,
)

FloatArray = NDArray[np.float64]
Direction = Literal["forward", "reverse"]
DIRECTIONS: tuple[Direction, Direction] = ("forward", "reverse")

# A log is fast, and filtered, when it has this many samples per period of the stop-band edge.
_FAST = 10.0


@dataclass(frozen=True, eq=False)
class BenchLog:
    """One log with signs, tare and doubtful intervals settled.

    Parameters
    ----------
    name : str
    recording : Recording
    steps : CommandSteps
        In u.
    time : (n,) array
        Row times [s].
    channels : dict of name to (times, values)
        Signed ``speed`` [rad/s], ``torque`` [N·m], ``thrust`` [N], ``voltage`` [V]; real samples only.
    window : (start, end)
        Part of the log that the trial may use [s].
    doubtful : tuple of (start, end)
        Intervals inside it whose command the logger lost [s].
    fast : bool
        Fast enough for the filter.
    tares : dict of name to Tare
    torque_sign : int
        What the recorded torque was multiplied by.
    notes : list of str
    second : dict or None
        Of a second file that was joined: what it is and how its clock was found.
    """

    name: str
    recording: Recording
    steps: CommandSteps
    time: FloatArray
    channels: dict[str, tuple[FloatArray, FloatArray]]
    window: tuple[float, float]
    doubtful: tuple[tuple[float, float], ...]
    fast: bool
    tares: dict[str, Tare]
    torque_sign: int
    notes: list[str]
    second: dict[str, Any] | None = None


def command_range(campaign: MotorCampaign) -> CommandRange:
    """Return the campaign's command protocol; one direction where no neutral is given."""
    c = campaign.command
    return CommandRange(c.unit, c.minimum, c.minimum if c.neutral is None else c.neutral, c.maximum)


def bench_log(campaign: MotorCampaign, path: str | Path, entry: TrialEntry) -> BenchLog:
    """Read a trial's log and settle its signs, tare and doubtful intervals.

    Raises
    ------
    LogError
        When command, speed or torque is missing, or the log turns another way than its direction says.
    """
    file = read_log(campaign, path, entry)
    recording = file.recording
    where = f"{recording.provenance.path}, trial {entry.name!r}"
    if recording.kind == "static-map":
        raise LogError(f"{where}: holds averaged points, no transients; name it under curves.static")
    command = recording["command"]
    time = command.time
    u = command_range(campaign).to_u(command.values, command.unit, where)
    steps = command_steps(time, u)
    raw = recording["speed"]
    begin = float(time[0]) if entry.start is None else entry.start
    end = float(time[-1]) if entry.end is None else entry.end
    if not begin < end or begin > time[-1] or end < time[0]:
        raise LogError(
            f"{where}: window {begin:g} to {end:g} s lies outside the log's {time[0]:.3f} to {time[-1]:.3f} s"
        )
    inside = (raw.time >= begin) & (raw.time <= end)
    known = raw.values[inside]
    signed_speed(known, entry.direction, where)
    check_command_direction(u[(time >= begin) & (time <= end)], entry.direction, where)
    speed = raw.values if entry.direction == "reversal" else signed_speed(raw.values, entry.direction, where)
    rate = 1.0 / float(np.median(np.diff(time)))
    fast = campaign.filter.kind != "none" and rate >= _FAST * campaign.filter.stop_edge
    if campaign.filter.kind == "chebyshev2" and not fast:
        raise LogError(
            f"{where}: {rate:.0f} Hz is too slow for a filter whose stop band begins at "
            f'{campaign.filter.stop_edge:g} Hz; set filter.kind = "auto" to leave slow logs unfiltered'
        )
    notes = list(recording.provenance.notes)
    stalls = [s for s in find_stalls(time, steps) if s.end >= begin and s.start <= end]
    doubtful = tuple(s.doubtful for s in stalls if s.doubtful is not None)
    rest = rows_at_rest(time, u, np.interp(time, raw.time, np.nan_to_num(raw.values)))
    channels = {"speed": (raw.time[np.isfinite(speed)], speed[np.isfinite(speed)])}
    tares: dict[str, Tare] = {}
    for name in ("torque", "thrust", "voltage"):
        if name not in recording.channels:
            continue
        channel = recording[name]
        keep = channel.valid if fast or name == "voltage" else real_samples(channel.values)
        values = channel.values
        if name != "voltage":
            row = np.minimum(np.searchsorted(time, channel.time), time.size - 1)
            tares[name] = tare(values, rest[row])
            values = values - tares[name].value
            if tares[name].rows == 0:
                notes.append(f"no row at rest: the tare of {name} is taken as 0")
                if name == "torque" and campaign.cost.weights.torque > 0:
                    warnings.warn(
                        f"{where}: no row at rest, so the torque's tare is taken as 0 and an offset of the "
                        "sensor counts as torque; record a second before the motor starts",
                        SysidWarning,
                        stacklevel=2,
                    )
        channels[name] = (channel.time[keep], values[keep])
    if "torque" not in channels and campaign.cost.weights.torque > 0:
        raise LogError(f"{where}: no torque; set cost.weights.torque = 0 or record it")
    points = _points_in(time, steps, channels, (begin, end), doubtful, tares)
    sign = 1
    if "torque" in channels:
        seen = sign_against_speed(points.torque, points.speed)
        sign = {"+": 1, "-": -1}.get(campaign.log.torque_sign, seen)
        if sign != seen and np.isfinite(points.torque).any():
            worst = int(np.nanargmax(np.abs(points.torque)))
            raise LogError(
                f"{where}: log.torque_sign = {campaign.log.torque_sign!r} gives "
                f"{1e3 * sign * points.torque[worst]:.3g} mN·m at a steady {points.speed[worst]:.0f} rad/s, "
                f"a drag that drives the rotor; set it to {'+' if seen > 0 else '-'!r} or 'auto'"
            )
        t, values = channels["torque"]
        channels["torque"] = (t, sign * values)
        if sign < 0:
            notes.append("the recorded torque opposes the rotation at steady speed: its sign was turned")
    if not fast:
        notes.append(f"rows every {1e3 / rate:.1f} ms: compared unfiltered at its own real samples")
    for stall in stalls:
        if stall.doubtful is not None:
            notes.append(
                f"the logger stalls from {stall.start:.4f} to {stall.end:.4f} s around a command: "
                f"{stall.doubtful[0]:.4f} to {stall.doubtful[1]:.4f} s is left out of the cost"
            )
    return BenchLog(
        entry.name, recording, steps, time, channels, (begin, end), doubtful, fast, tares, sign, notes,
        file.second,
    )  # fmt: skip


def log_points(log: BenchLog) -> SteadyPoints:
    """Return the steady points of a step log inside its window."""
    return _points_in(log.time, log.steps, log.channels, log.window, log.doubtful, log.tares)


def _points_in(
    time: FloatArray,
    steps: CommandSteps,
    channels: dict[str, tuple[FloatArray, FloatArray]],
    window: tuple[float, float],
    doubtful: tuple[tuple[float, float], ...],
    tares: Mapping[str, Tare],
) -> SteadyPoints:
    skip = (*doubtful, (-np.inf, window[0]), (window[1], np.inf))
    zeros = {name: found.rows for name, found in tares.items()}
    points = steady_points(time, steps, channels, skip, zero_rows=zeros)
    if len(points) >= 3:
        return points
    # Too few plateaus for any curve: a command that creeps serves as well.
    return SteadyPoints.join([points, ramp_points(time, steps, channels, skip, zeros)])
