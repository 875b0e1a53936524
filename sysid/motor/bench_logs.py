"""The bench logs that a motor campaign names: read, and their signs, tare and doubtful intervals settled."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sysid.campaign import MotorCampaign, MotorTrial
from sysid.campaign.file import resolve_log
from sysid.campaign.logs import load_stated, warn_of_idle_options
from sysid.campaign.motor import StaticLog
from sysid.errors import LogError
from sysid.journal import Finding, note, notice
from sysid.loaders import detect
from sysid.loaders.alignment import join_recordings
from sysid.recording import Recording
from sysid.trials import bench_log as trial_log
from sysid.trials.reversal import JITTER
from sysid.trials.steady import (
    SETTLE,
    SteadyPoints,
    sign_against_speed,
    sign_of_log,
    speed_steps,
    steady_points,
    turning_steps,
    zero_of_steady,
)
from sysid.types import BoolArray, FloatArray

# Times [s] and values of a channel.
Samples = tuple[FloatArray, FloatArray]
# Record of a second file that was joined: name, hash, clock offset [s], and the like.
SecondFile = dict[str, object] | None

_NEEDED = ("command", "speed", "torque", "thrust", "voltage", "current")
_CLOCK_OF = ("torque", "thrust", "speed")
# Least samples per period of the stop-band edge of a fast log, which is filtered.
_FAST = 10.0
# Least friction torque, over its standard error [1], with which the line of torque over current has a
# friction.
_SHOWN = 3.0
# Signs that a campaign may state of a channel; with "auto" the log decides.
STATED_SIGNS = {"+": 1, "-": -1}


def read_log(
    campaign: MotorCampaign, path: str | Path, entry: MotorTrial | StaticLog
) -> tuple[Recording, SecondFile]:
    """Load a log of the campaign, joined with its second file where it has one, all channels on one clock.

    The `[log]` table serves every log whose format takes the option; the entry's `log_options` win over it.
    SysidError when a log cannot be read, or the clock of the second one cannot be found.
    """
    log, options = resolve_log(path, entry.log), entry.log_options
    name = options.format or campaign.log.format or "auto"
    name = detect(log) if name == "auto" else name
    # Options of `[log]`, with its short forms of units in the words of the format.
    whole = campaign.log
    short = {"torque": whole.torque_unit}
    if name == "ati-text":  # six channels by place, which share two units
        short["force"] = whole.force_unit
    else:
        short |= {"command": whole.command_unit, "thrust": whole.force_unit, "speed": whole.speed_unit}
    units = {**(whole.units or {}), **{key: unit for key, unit in short.items() if unit is not None}}
    # A calibration states its units.
    stated = whole.loader_options() | {"units": None if options.calibration is not None else units or None}
    recording = load_stated(log, name, stated, options.loader_options())
    for finding in recording.provenance.notes:
        if finding.severity == "warning":
            notice(finding.code, finding.sentence, trial=entry.log)
    second = None
    if entry.second_log is not None:
        # Another instrument: the campaign's `[log]` does not describe it.
        other = resolve_log(path, entry.second_log.log)
        beside = load_stated(other, entry.second_log.format, {}, entry.second_log.loader_options())
        recording, clock = join_recordings(recording, beside, entry.second_log.align_by)
        second = beside.provenance.source | {
            "aligned": f"{clock.other} with {clock.reference}", "offset": clock.offset,
            "correlation": clock.correlation, "confidence": clock.confidence,
            "notes": beside.provenance.sentences,
        }  # fmt: skip
    return trial_log.on_one_clock(recording, _NEEDED, _CLOCK_OF), second


def check_options(campaign: MotorCampaign, path: str | Path) -> None:
    """Warn of what `[log]` says and no log of the campaign takes."""
    curves = campaign.curves
    entries: tuple[MotorTrial | StaticLog, ...] = (*campaign.trials, *curves.static, *curves.no_load)
    logs = [(resolve_log(path, e.log), e.log_options.format or campaign.log.format) for e in entries]
    warn_of_idle_options("log", campaign.log.loader_options(), logs)


@dataclass(eq=False)
class BenchLog:
    """One log with signs, tare and doubtful intervals settled."""

    name: str
    recording: Recording
    second: SecondFile
    steps: trial_log.CommandSteps
    time: FloatArray  # (n,) of the rows [s]
    # Real samples by name: signed ``speed`` [rad/s], ``torque`` [N·m], ``thrust`` [N], ``voltage`` [V] and
    # ``current`` of the supply, or of the motor where the campaign says so [A].
    channels: dict[str, Samples]
    window: tuple[float, float]  # the part of the log that the trial may use [s]
    doubtful: tuple[tuple[float, float], ...]  # intervals inside it whose command the logger lost [s]
    fast: bool  # whether the log is filtered
    notes: list[Finding]
    tares: dict[str, trial_log.Tare] = field(default_factory=dict)
    # Samples of the speed that no propeller can follow [s], [rad/s]; left out of the channel.
    dropped: Samples = (np.zeros(0), np.zeros(0))
    # Whether the log has a command; its steps are those of the speed where it has none.
    commanded: bool = True
    # Largest |u| below all commands that turn the rotor, under which it stands [1].
    standing: float = 0.0
    # Factors of the recorded torque and thrust.
    signs: dict[str, int] = field(default_factory=lambda: {"torque": 1, "thrust": 1})

    @property
    def where(self) -> str:
        """The log and the trial, as sentences name them."""
        return f"{self.recording.provenance.path}, trial {self.name!r}"

    @property
    def interval(self) -> float:
        """Median distance of the rows [s]."""
        return float(np.median(np.diff(self.time)))

    def note(self, code: str, sentence: str) -> None:
        """Keep what was done to the log."""
        self.notes.append(note(code, sentence))


def campaign_range(campaign: MotorCampaign) -> trial_log.CommandRange:
    """Return the campaign's command protocol; one direction where no neutral is given."""
    c = campaign.command
    if c.minimum is None or c.maximum is None:
        return trial_log.CommandRange(c.unit, 0.0, 0.0, 2047.0, c.forward_half)
    return trial_log.CommandRange(c.unit, c.minimum, c.minimum if c.neutral is None else c.neutral, c.maximum)


def bench_log(campaign: MotorCampaign, path: str | Path, entry: MotorTrial) -> BenchLog:
    """Read a trial's log and settle its signs, tare and doubtful intervals.

    LogError when command, speed or torque is missing, or the log turns another way than its direction says.
    """
    recording, second = read_log(campaign, path, entry)
    where = f"{recording.provenance.path}, trial {entry.name!r}"
    if recording.kind == "static-map":
        raise LogError(f"{where}: has averaged points, no transients; name it under curves.static")
    raw, command = recording["speed"], recording.channels.get("command")
    time = raw.time
    rate, settings = 1.0 / float(np.median(np.diff(time))), campaign.filter
    fast = settings.kind != "none" and rate >= _FAST * settings.stop_edge
    known = np.isfinite(raw.values)
    # The filter of a fast log needs every sample.
    lost = np.zeros(time.size, dtype=np.bool_)
    lost[known] = False if fast else trial_log.drop_outs(time[known], raw.values[known])
    kept = time[known & ~lost], raw.values[known & ~lost]
    commanded = command is not None and bool(command.valid.any())
    if command is not None and commanded:
        u = campaign_range(campaign).to_u(command.values, command.unit, where)
        # A neutral that jitters is a neutral, for the tare too.
        u = np.where(np.abs(u) <= JITTER, 0.0, u)
        steps = trial_log.command_steps(time, u)
    else:
        steps = _steps_without_command(entry, kept, where)
        u = steps.level[np.searchsorted(steps.time, time, side="right").clip(1) - 1]
    begin = float(time[0]) if entry.start is None else entry.start
    turning = turning_steps(steps, *kept)
    if entry.start is None and abs(steps.level[0]) < trial_log.AT_REST and turning.any():
        # A rest shows the tare. Compared, it would count as well explained.
        begin = float(steps.time[np.argmax(turning)])
    end = float(time[-1]) if entry.end is None else entry.end
    if not begin < end or begin > time[-1] or end < time[0]:
        raise LogError(
            f"{where}: window {begin:g} to {end:g} s lies outside the log's {time[0]:.3f} to {time[-1]:.3f} s"
        )
    if begin < 0.0 <= time[0]:
        early = f"start = {begin:g} s is before the log, which begins at {time[0]:g} s: check its sign"
        notice("odd-start", early, trial=entry.name)
    window = begin, end
    speed = _signed_speed(entry, raw.time, raw.values, u, window, where)
    stalls = [s for s in trial_log.find_stalls(time, steps) if s.end >= window[0] and s.start <= window[1]]
    if settings.kind == "chebyshev2" and not fast:
        raise LogError(
            f"{where}: {rate:.0f} Hz is too slow for a filter whose stop band begins at "
            f'{settings.stop_edge:g} Hz; set filter.kind = "auto" to leave slow logs unfiltered'
        )
    log = BenchLog(
        entry.name, recording, second, steps, time, {"speed": (time[known & ~lost], speed[known & ~lost])},
        window, tuple(s.doubtful for s in stalls if s.doubtful is not None), fast,
        list(recording.provenance.notes), dropped=(time[lost], speed[lost]), commanded=commanded,
        standing=_standing(steps, turning),
    )  # fmt: skip
    inside = lost & ~trial_log.outside(time, (window,))
    if inside.any():
        runs = np.flatnonzero(inside & ~np.roll(inside, 1))
        log.note(
            "speed-drops-out",
            f"the speed drops out {runs.size} times as no propeller can, first at {time[runs[0]]:.2f} s: "
            f"{np.count_nonzero(inside)} samples are left out",
        )
    if not commanded:
        notice(
            "no-command",
            "no command is logged: the fit takes each step of the speed for a command, and the speed over "
            "its top for u. Curves, Kv and R do not need a command; the dead time and the controller's map "
            "from command to voltage stay unknown: record the command beside the speed",
            trial=entry.name,
        )
    _warn_of_standing(log, u)
    _add_channels(campaign, log, u)
    if "torque" not in log.channels and campaign.cost.weights.torque > 0:
        raise LogError(
            f"{where}: no torque; record it, or set cost.weights.torque = 0 and name a log "
            "with torque in curves.static"
        )
    _estimate_zeros(campaign, log)
    _settle_signs(campaign, log)
    if not log.fast:
        log.note("unfiltered", f"rows every {1e3 * log.interval:.1f} ms: compared unfiltered")
    for stall in stalls:
        if stall.doubtful is not None:
            log.note(
                "logger-stalls",
                f"the logger stalls from {stall.start:.4f} to {stall.end:.4f} s around a command: "
                f"{stall.doubtful[0]:.4f} to {stall.doubtful[1]:.4f} s is not compared",
            )
    return log


def _standing(steps: trial_log.CommandSteps, turning: BoolArray) -> float:
    """Return the largest |u| under which the rotor stands, below all that turn it."""
    size = np.abs(steps.level)
    least = float(np.min(size[turning], initial=np.inf))
    return float(np.max(size[~turning & (size < least)], initial=0.0))


def _steps_without_command(entry: MotorTrial, speed: Samples, where: str) -> trial_log.CommandSteps:
    """Return the steps of a log of one direction whose command is empty."""
    if entry.direction == "reversal":
        raise LogError(f"{where}: has no command; a reversal trial needs command and speed")
    try:
        steps = speed_steps(*speed)
    except LogError as error:
        raise LogError(f"{where}: has no command, and {error}; hold each throttle for a second") from None
    sign = -1.0 if entry.direction == "reverse" else 1.0
    return replace(steps, level=sign * steps.level)


def _signed_speed(
    entry: MotorTrial,
    time: FloatArray,
    speed: FloatArray,
    u: FloatArray,
    window: tuple[float, float],
    where: str,
) -> FloatArray:
    """Return the speed with the sign of the trial's direction; NaN where unknown."""
    inside = ~trial_log.outside(time, (window,))
    trial_log.signed_speed(speed[inside], entry.direction, where)
    trial_log.check_command_direction(u[inside], entry.direction, where)
    return speed if entry.direction == "reversal" else trial_log.signed_speed(speed, entry.direction, where)


def _warn_of_standing(log: BenchLog, u: FloatArray) -> None:
    """Warn where the rotor stands under a command that should turn it: its unit or neutral is another."""
    raw = log.recording["speed"]
    seen = ~trial_log.outside(raw.time, (log.window,)) & np.isfinite(raw.values)
    level = None
    if log.commanded:
        level = trial_log.standing_command(raw.time[seen], raw.values[seen], log.steps, log.window)
    if level is not None:
        logged = float(log.recording["command"].values[np.flatnonzero(u == level)[0]])
        notice(
            "rotor-stands",
            f"the rotor stands under command {logged:g} (u = {level:.2g}); correct command.unit or "
            "command.neutral, or shorten the window where the controller did not start",
            trial=log.name,
        )


def _add_channels(campaign: MotorCampaign, log: BenchLog, u: FloatArray) -> None:
    """Add torque, thrust, voltage and current, as far as recorded, tares subtracted."""
    raw = log.recording["speed"]
    rest = trial_log.rows_at_rest(log.time, u, np.interp(log.time, raw.time, np.nan_to_num(raw.values)))
    for name in ("torque", "thrust", "voltage", "current"):
        if name not in log.recording.channels or not log.recording[name].valid.any():
            continue
        channel = log.recording[name]
        values = channel.values
        keep = channel.valid if log.fast or name in ("voltage", "current") else trial_log.real_samples(values)
        if name == "voltage":
            # A probe that is not connected reads 0; no supply that turns a motor does.
            keep = keep & (np.nan_to_num(values) > 0)
            if not keep.any():
                log.note(
                    "no-voltage", "the voltage is nowhere above 0: left out, the supply counts as constant"
                )
                continue
        else:
            row = np.minimum(np.searchsorted(log.time, channel.time), log.time.size - 1)
            log.tares[name] = trial_log.tare(values, rest[row])
            values = values - log.tares[name].value
        log.channels[name] = (channel.time[keep], values[keep])


def _estimate_zeros(campaign: MotorCampaign, log: BenchLog) -> None:
    """Estimate the tare of torque and thrust from steady points where the log has no row at rest."""
    points = log_points(log)
    for name, unit in (("torque", "N·m"), ("thrust", "N")):
        if name not in log.channels or log.tares[name].rows > 0:
            continue
        zero = zero_of_steady(getattr(points, name), points.speed)
        if zero is None:
            sentence = f"no row at rest and too few steady points: the tare of {name} is taken as 0"
        else:
            log.tares[name] = zero
            t, values = log.channels[name]
            log.channels[name] = (t, values - zero.value)
            sentence = (
                f"no row at rest: the tare of {name}, {1e3 * zero.value:.3g} ± {1e3 * zero.error:.2g} "
                f"m{unit}, is extrapolated from its steady points to standstill"
            )
        log.note("no-row-at-rest", sentence)
        if name == "torque" and campaign.cost.weights.torque > 0:
            notice("no-row-at-rest", f"{sentence}; record a second before the motor starts", trial=log.name)


def _settle_signs(campaign: MotorCampaign, log: BenchLog) -> None:
    """Turn torque and thrust so that steady values have the sign of their speed.

    LogError when a stated sign contradicts the steady points.
    """
    points = log_points(log)
    for name, stated in (("torque", campaign.log.torque_sign), ("thrust", campaign.log.thrust_sign)):
        if name not in log.channels:
            continue
        steady = getattr(points, name)
        seen = sign_against_speed(steady, points.speed)
        sign = STATED_SIGNS.get(stated, seen)
        if seen and sign != seen:
            worst, unit = int(np.nanargmax(np.abs(steady))), "mN·m" if name == "torque" else "mN"
            what = "a drag that drives the rotor" if name == "torque" else "a thrust against the rotation"
            raise LogError(
                f"{log.where}: log.{name}_sign = {stated!r} gives {1e3 * sign * steady[worst]:.3g} {unit} at "
                f"a steady {points.speed[worst]:.0f} rad/s, {what}; set {'+' if seen > 0 else '-'!r} or "
                "'auto'"
            )
        if sign == 0:
            sign = sign_of_log(log.channels[name], log.channels["speed"])
            log.note(
                "sign-of-whole-log",
                f"no steady stretch: how {name} follows the speed over the whole log gives its sign",
            )
        if sign == 0:
            sentence = f"nothing shows the sign of {name}, so it is taken as recorded; state log.{name}_sign"
            notice("sign-unknown", f"{sentence} = '+' or '-'", trial=log.name)
            sign = 1
        elif sign < 0:
            log.note("sign-turned", f"the recorded {name} opposes the rotation at steady speed: sign turned")
        log.signs[name] = sign
        t, values = log.channels[name]
        log.channels[name] = (t, sign * values)


def log_points(log: BenchLog) -> SteadyPoints:
    """Return the steady points of a step log inside its window."""
    skip = (*log.doubtful, (-np.inf, log.window[0]), (log.window[1], np.inf))
    zeros = {name: zero.rows for name, zero in log.tares.items()}
    points = steady_points(log.time, log.steps, log.channels, skip, zeros)
    if len(points) >= 3:
        return points
    # Too few plateaus for any curve: a command that creeps serves as well.
    creeping = steady_points(log.time, log.steps, log.channels, skip, zeros, ramp=True)
    return SteadyPoints.join([points, creeping])


class TorquePerCurrent(NamedTuple):
    """Torque constant k_m of a logged motor current and its standard error [N·m/A].

    `friction` is the torque of bearings and iron that the current pays for and the load cell does not feel
    [N·m]; 0 where the points do not show it.
    """

    value: float
    error: float
    points: int
    friction: float = 0.0


def torque_per_current(logs: Sequence[BenchLog]) -> TorquePerCurrent:
    """Return k_m from the steady points of logs of the winding's current.

    At a steady speed the load cell feels k_m I − τ_f, with τ_f the constant friction of bearings and iron,
    which the current pays for as well. Without τ_f k_m would come out too small; it is left out where the
    points do not show it, by three of its standard errors. LogError when a log has no current, or the
    points are fewer than three.
    """
    pairs = []
    for log in logs:
        if "current" not in log.channels or "torque" not in log.channels:
            missing = "current" if "torque" in log.channels else "torque"
            raise LogError(
                f"{log.where}: log.current = 'motor', but the log has no {missing}; record it, or leave "
                "log.current out"
            )
        points = log_points(log)
        pairs.append(np.column_stack([np.abs(points.current), np.abs(points.torque)]))
    current, torque = np.concatenate(pairs).T
    known = np.isfinite(current) & np.isfinite(torque) & (current > 0)
    current, torque = current[known], torque[known]
    if current.size < 3:
        raise LogError(
            f"{', '.join(log.where for log in logs)}: {current.size} steady points have torque and motor "
            "current; expected at least 3: hold more commands for over "
            f"{SETTLE:g} s, or leave log.current out"
        )
    with_friction = np.column_stack([current, -np.ones(current.size)])
    if current.size >= 5 and np.linalg.matrix_rank(with_friction) == 2:
        (value, friction), (error, slack) = _torque_line(with_friction, torque)
        if friction > _SHOWN * slack:
            return TorquePerCurrent(float(value), float(error), int(current.size), float(friction))
    (value,), (error,) = _torque_line(current[:, None], torque)
    return TorquePerCurrent(float(value), float(error), int(current.size))


def _torque_line(columns: FloatArray, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return coefficients and their standard errors."""
    value: FloatArray = np.linalg.lstsq(columns, torque, rcond=None)[0].astype(np.float64)
    residual = torque - columns @ value
    freedom = len(torque) - columns.shape[1]
    covariance = np.linalg.inv(columns.T @ columns) * float(residual @ residual) / freedom
    return value, np.asarray(np.sqrt(np.diag(covariance)), dtype=np.float64)
