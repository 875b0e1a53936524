"""The bench logs that a motor campaign names: read, and their signs, tare and doubtful intervals settled."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sysid.campaign import MotorCampaign
from sysid.campaign.motor import MotorTrial as TrialEntry
from sysid.errors import LogError, SysidWarning
from sysid.motor.bench_reading import read_log
from sysid.recording import Channel, Recording
from sysid.trials.bench_log import (
    CommandRange,
    CommandSteps,
    Tare,
    check_command_direction,
    command_steps,
    find_stalls,
    real_samples,
    rows_at_rest,
    signed_speed,
    standing_command,
    tare,
)
from sysid.trials.reversal import JITTER
from sysid.trials.signs import sign_against_speed, sign_of_log, zero_of_steady
from sysid.trials.steady import SETTLE, SteadyPoints, ramp_points, steady_points
from sysid.types import FloatArray

Direction = Literal["forward", "reverse"]
DIRECTIONS: tuple[Direction, Direction] = ("forward", "reverse")

# A log is fast, and filtered, when it has this many samples per period of the stop-band edge.
_FAST = 10.0
# Standard errors by which a friction must differ from none before a torque constant makes room for it.
_SHOWN = 3.0
# What a campaign may say of a channel's sign; "auto" leaves it to the log.
STATED_SIGNS = {"+": 1, "-": -1}


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
        Signed ``speed`` [rad/s], ``torque`` [N·m], ``thrust`` [N], ``voltage`` [V]; ``current`` of the motor
        [A] where the campaign says that it is logged; real samples only.
    window : (start, end)
        Part of the log that the trial may use [s].
    doubtful : tuple of (start, end)
        Intervals inside it whose command the logger lost [s].
    fast : bool
        Fast enough for the filter.
    tares : dict of name to Tare
    torque_sign, thrust_sign : int
        What the recorded torque and thrust were multiplied by.
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
    thrust_sign: int
    notes: list[str]
    second: dict[str, Any] | None = None

    @property
    def where(self) -> str:
        """The log and the trial, as sentences name them."""
        return f"{self.recording.provenance.path}, trial {self.name!r}"


def command_range(campaign: MotorCampaign) -> CommandRange:
    """Return the campaign's command protocol; one direction where no neutral is given."""
    c = campaign.command
    if c.minimum is None or c.maximum is None:
        return CommandRange(c.unit, 0.0, 0.0, 2047.0, c.forward_half)
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
    if not np.isfinite(u).any():
        raise LogError(f"{where}: holds no command; a motor fit needs the command beside the speed")
    # A neutral that jitters is a neutral, for the tare too.
    u = np.where(np.abs(u) <= JITTER, 0.0, u)
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
    _warn_of_standing(raw.time[inside], known, steps, (begin, end), command, u, where)
    rate = 1.0 / float(np.median(np.diff(time)))
    fast = campaign.filter.kind != "none" and rate >= _FAST * campaign.filter.stop_edge
    if campaign.filter.kind == "chebyshev2" and not fast:
        raise LogError(
            f"{where}: {rate:.0f} Hz is too slow for a filter whose stop band begins at "
            f'{campaign.filter.stop_edge:g} Hz; set filter.kind = "auto" to leave slow logs unfiltered'
        )
    notes = recording.provenance.sentences
    stalls = [s for s in find_stalls(time, steps) if s.end >= begin and s.start <= end]
    doubtful = tuple(s.doubtful for s in stalls if s.doubtful is not None)
    rest = rows_at_rest(time, u, np.interp(time, raw.time, np.nan_to_num(raw.values)))
    channels = {"speed": (raw.time[np.isfinite(speed)], speed[np.isfinite(speed)])}
    tares: dict[str, Tare] = {}
    for name in ("torque", "thrust", "voltage", "current"):
        if name not in recording.channels or (name == "current" and campaign.log.current != "motor"):
            continue
        channel = recording[name]
        keep = channel.valid if fast or name in ("voltage", "current") else real_samples(channel.values)
        values = channel.values
        if name == "voltage":
            # A probe that is not connected reads 0; no supply that turns a motor does.
            keep = keep & (np.nan_to_num(values) > 0)
            if not keep.any():
                notes.append("the voltage is nowhere above 0: left out, the supply counts as constant")
                continue
        else:
            row = np.minimum(np.searchsorted(time, channel.time), time.size - 1)
            tares[name] = tare(values, rest[row])
            values = values - tares[name].value
        channels[name] = (channel.time[keep], values[keep])
    if "torque" not in channels and campaign.cost.weights.torque > 0:
        raise LogError(
            f"{where}: no torque; record it, or set cost.weights.torque = 0 and name a log "
            "with torque in curves.static"
        )
    _zeros_from_steady(campaign, where, channels, tares, notes, (time, steps, (begin, end), doubtful))
    points = _points_in(time, steps, channels, (begin, end), doubtful, tares)
    signs = {"torque": 1, "thrust": 1}
    for name, stated in (("torque", campaign.log.torque_sign), ("thrust", campaign.log.thrust_sign)):
        if name in channels:
            signs[name] = _sign(name, stated, channels, points, where, notes)
            t, values = channels[name]
            channels[name] = (t, signs[name] * values)
    if not fast:
        notes.append(f"rows every {1e3 / rate:.1f} ms: compared unfiltered at its own real samples")
    for stall in stalls:
        if stall.doubtful is not None:
            notes.append(
                f"the logger stalls from {stall.start:.4f} to {stall.end:.4f} s around a command: "
                f"{stall.doubtful[0]:.4f} to {stall.doubtful[1]:.4f} s is left out of the cost"
            )
    return BenchLog(
        entry.name, recording, steps, time, channels, (begin, end), doubtful, fast, tares,
        signs["torque"], signs["thrust"], notes, file.second,
    )  # fmt: skip


def _warn_of_standing(
    time: FloatArray,
    speed: FloatArray,
    steps: CommandSteps,
    window: tuple[float, float],
    command: Channel,
    u: FloatArray,
    where: str,
) -> None:
    """Warn where the rotor stands under a command that should turn it: its unit or neutral is another."""
    seen = np.isfinite(speed)
    level = standing_command(time[seen], speed[seen], steps, window)
    if level is not None:
        logged = float(command.values[np.flatnonzero(u == level)[0]])
        warnings.warn(
            f"{where}: the rotor stands under command {logged:g} (u = {level:.2g}); correct command.unit or "
            "command.neutral, or shorten the window where the controller did not start",
            SysidWarning,
            stacklevel=3,
        )


def _zeros_from_steady(
    campaign: MotorCampaign,
    where: str,
    channels: dict[str, tuple[FloatArray, FloatArray]],
    tares: dict[str, Tare],
    notes: list[str],
    log: tuple[FloatArray, CommandSteps, tuple[float, float], tuple[tuple[float, float], ...]],
) -> None:
    """Estimate the tare of torque and thrust where the log has no row at rest, and say so."""
    time, steps, window, doubtful = log
    points = _points_in(time, steps, channels, window, doubtful, tares)
    for name, unit in (("torque", "N·m"), ("thrust", "N")):
        if name not in channels or tares[name].rows > 0:
            continue
        found = zero_of_steady(getattr(points, name), points.speed)
        if found is None:
            said = f"no row at rest and too few steady points: the tare of {name} is taken as 0"
        else:
            tares[name] = found
            t, values = channels[name]
            channels[name] = (t, values - found.value)
            said = (
                f"no row at rest: the tare of {name}, {1e3 * found.value:.3g} ± {1e3 * found.error:.2g} "
                f"m{unit}, is what its steady points over Ω|Ω| leave at standstill"
            )
        notes.append(said)
        if name == "torque" and campaign.cost.weights.torque > 0:
            warnings.warn(
                f"{where}: {said}; record a second before the motor starts", SysidWarning, stacklevel=3
            )


def _sign(
    name: str,
    stated: str,
    channels: dict[str, tuple[FloatArray, FloatArray]],
    points: SteadyPoints,
    where: str,
    notes: list[str],
) -> int:
    """Return what a channel is multiplied by so that a steady value has the sign of its speed.

    Raises
    ------
    LogError
        When the stated sign contradicts the steady points.
    """
    steady = getattr(points, name)
    seen = sign_against_speed(steady, points.speed)
    sign = STATED_SIGNS.get(stated, seen)
    if seen and sign != seen:
        worst, unit = int(np.nanargmax(np.abs(steady))), "mN·m" if name == "torque" else "mN"
        what = "a drag that drives the rotor" if name == "torque" else "a thrust against the rotation"
        raise LogError(
            f"{where}: log.{name}_sign = {stated!r} gives {1e3 * sign * steady[worst]:.3g} {unit} at a "
            f"steady {points.speed[worst]:.0f} rad/s, {what}; set {'+' if seen > 0 else '-'!r} or 'auto'"
        )
    if sign == 0:
        sign = sign_of_log(channels[name], channels["speed"])
        notes.append(f"no steady stretch: the sign of {name} is that of the whole log against its speed")
    if sign == 0:
        warnings.warn(
            f"{where}: nothing tells the sign of {name}, so it is taken as recorded; state "
            f"log.{name}_sign = '+' or '-'",
            SysidWarning,
            stacklevel=3,
        )
        return 1
    if sign < 0:
        notes.append(f"the recorded {name} opposes the rotation at steady speed: its sign was turned")
    return sign


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


@dataclass(frozen=True)
class TorquePerCurrent:
    """Torque constant of a logged motor current.

    Parameters
    ----------
    value, error : float
        k_m and its standard error [N·m/A].
    points : int
        Steady points behind it.
    friction : float
        Torque of bearings and iron that the current pays for and the load cell does not feel [N·m]; 0 where
        the points do not show it.
    """

    value: float
    error: float
    points: int
    friction: float = 0.0


def torque_per_current(logs: Sequence[BenchLog]) -> TorquePerCurrent:
    """Return k_m from the steady points of logs that hold the winding's current.

    At a steady speed the load cell feels k_m I − τ_f, with τ_f the constant friction of bearings and iron,
    which the current pays for as well. Without τ_f k_m would come out too small; it is left out where the
    points do not show it, by three of its standard errors.

    Raises
    ------
    LogError
        When a log holds no current, or the points are fewer than three.
    """
    pairs = []
    for log in logs:
        if "current" not in log.channels or "torque" not in log.channels:
            missing = "current" if "torque" in log.channels else "torque"
            raise LogError(
                f"{log.where}: log.current = 'motor', but the log holds no {missing}; record it, or leave "
                "log.current out"
            )
        channels = {
            "speed": log.channels["speed"], "torque": log.channels["torque"],
            "thrust": log.channels["current"],
        }  # fmt: skip
        points = _points_in(log.time, log.steps, channels, log.window, log.doubtful, {})
        pairs.append(np.column_stack([np.abs(points.thrust), np.abs(points.torque)]))
    current, torque = np.concatenate(pairs).T
    known = np.isfinite(current) & np.isfinite(torque) & (current > 0)
    current, torque = current[known], torque[known]
    if current.size < 3:
        raise LogError(
            f"{', '.join(log.where for log in logs)}: {current.size} steady points hold torque and motor "
            "current; expected at least 3: hold more commands for over "
            f"{SETTLE:g} s, or leave log.current out"
        )
    plain = _torque_line(current[:, None], torque)
    friction = _torque_line(np.column_stack([current, -np.ones(current.size)]), torque)
    if friction is not None and friction[0][1] > _SHOWN * friction[1][1]:
        value, error = friction
        return TorquePerCurrent(float(value[0]), float(error[0]), int(current.size), float(value[1]))
    assert plain is not None
    return TorquePerCurrent(float(plain[0][0]), float(plain[1][0]), int(current.size))


def _torque_line(columns: FloatArray, torque: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return coefficients and their standard errors; None where the points leave nothing to judge them by."""
    freedom = len(torque) - columns.shape[1]
    if freedom < (1 if columns.shape[1] == 1 else 3) or np.linalg.matrix_rank(columns) < columns.shape[1]:
        return None
    value: FloatArray = np.linalg.lstsq(columns, torque, rcond=None)[0].astype(np.float64)
    residual = torque - columns @ value
    covariance = np.linalg.inv(columns.T @ columns) * float(residual @ residual) / freedom
    return value, np.asarray(np.sqrt(np.diag(covariance)), dtype=np.float64)
