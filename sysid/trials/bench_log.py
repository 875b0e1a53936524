"""Content of a bench log of one motor: commands, logger stalls, real samples, tare, signs, one clock.

Knows no motor model: it sees channels of a `Recording` and turns them into what a fit can trust. Speeds and
torques leave here signed: positive in the forward direction, a steady torque with the sign of its speed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.ndimage import median_filter

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.recording import Channel, Recording
from sysid.types import BoolArray, Direction, FloatArray

# Least length of a stall, in median intervals and in seconds [s]: logs of 8 to 27 ms jitter by up to 20 ms,
# stalls last 40 to 100 ms.
_STALL_INTERVALS = 3.0
_STALL_LEAST = 0.03
# Longest time between a logged command and a stall that may have delayed that command [s].
_REACH = 0.15
# Time that the response needs after a stall [s]: several times the slowest rotor seen.
_RECOVERY = 0.15
# Time for which a sensor rings after a stop [s].
_RINGING = 0.5
# Last DShot number that is no throttle, steps per half (one direction has twice as many), and last number.
_DSHOT_STOP, _DSHOT_HALF, _DSHOT_LAST = 47, 1000, 2047
# Largest |u| that is no command [1].
AT_REST = 1e-9
# Shortest standstill of a rotor [s], and least |u| during it [1], that show a wrong unit or neutral.
_STANDING, _DRIVEN = 0.5, 0.1
# Least number of samples of a rest that shows how a tare drifts.
_LEAST_REST = 5
# Share of its top speed below which a rotor stands, and above which it turns [1].
STANDS, _TURNS = 0.02, 0.1
# Span of the running median that passes steps of a speed and no drop-out [s], and least fall of a drop-out as
# a share of the top speed [1].
LEVEL_SPAN, _FALL = 0.2, 0.02
# Least |u| that commands a direction [1].
_COMMANDED = 0.02
# Largest gap between two samples that a value is interpolated from, in seconds and in median steps of a slow
# sensor: a rotor's speed changes little in either.
_LONGEST, _STEPS = 0.05, 3.0


@dataclass(frozen=True)
class CommandRange:
    """Which logged numbers, in a `unit` such as "us", mean full reverse, rest and full forward.

    A controller of one direction has neutral = minimum. `forward_half` is the half of bidirectional DShot
    that turns forward: each half runs from slowest to fastest (48 to 1047, 1048 to 2047; below them the motor
    stands), and the three numbers do not count then.
    """

    unit: str
    minimum: float
    neutral: float
    maximum: float
    forward_half: Literal["low", "high"] | None = None

    def to_u(self, command: FloatArray, unit: str, where: str) -> FloatArray:
        """Return u (n,) in [-1, 1] of logged commands (n,); below the neutral of one direction is rest.

        Raises LogError for another unit of the log and for commands outside the range.
        """
        values = np.asarray(command, dtype=np.float64)
        if unit != self.unit:
            low, high = (float(f(values, initial=np.nan)) for f in (np.fmin.reduce, np.fmax.reduce))
            raise LogError(
                f"{where}: commands run from {low:g} to {high:g} and are read as {unit}, the campaign says "
                f"{self.unit}; correct command.unit, or log.command_unit where the log states none"
            )
        if self.forward_half is not None:
            with np.errstate(invalid="ignore"):
                outside = values[(values < 0) | (values > _DSHOT_LAST) | (values != np.rint(values))]
                outside = outside[np.isfinite(outside)]
                one = np.where(values > _DSHOT_STOP, (values - _DSHOT_STOP) / _DSHOT_HALF, 0.0)
                other = (values - _DSHOT_STOP - _DSHOT_HALF) / _DSHOT_HALF
            if outside.size:
                raise LogError(
                    f"{where}: {outside.size} commands are no DShot number of 0 to {_DSHOT_LAST}, for "
                    f"example {outside[0]:g}; leave out command.forward_half and state command.minimum and "
                    "its kin"
                )
            sign = 1.0 if self.forward_half == "low" else -1.0
            return np.where(other > 0, -sign * other, sign * one) + 0.0 * values
        above = values - self.neutral
        span = np.where(above >= 0, self.maximum - self.neutral, max(self.neutral - self.minimum, 1e-300))
        u = above / span
        if self.neutral <= self.minimum:
            u = np.maximum(u, 0.0)
        with np.errstate(invalid="ignore"):
            outside = values[np.abs(u) > 1.0 + 1e-6]
        if outside.size:
            raise LogError(
                f"{where}: {outside.size} commands lie outside {self.minimum:g} to {self.maximum:g} "
                f"{self.unit}, for example {outside[0]:g}; correct command.minimum and command.maximum"
            )
        return u


def drop_outs(time: FloatArray, speed: FloatArray) -> BoolArray:
    """Return True (n,) where a tachometer misses pulses: a fall and a recovery that no propeller can follow.

    A running median of 0.2 s passes every step of a speed and no shorter dip. A dip counts whose first sample
    falls by over half of its depth, down to where the speed is back in its noise: the averaging of a stand
    spreads a missed pulse over some samples. Valid for logs of up to some 1 kHz; ignores commands that are
    shorter than 0.1 s. Samples (n,) are [s], [rad/s].
    """
    out = np.zeros(speed.size, dtype=np.bool_)
    size = np.abs(speed)
    width = round(0.5 * LEVEL_SPAN / float(np.median(np.diff(time)))) if time.size > 2 else 0
    if width < 1:
        return out
    depth = median_filter(size, 2 * width + 1, mode="nearest") - size
    noise = float(np.median(np.abs(depth))) / 0.6745
    fall = _FALL * float(size.max())
    low, over = depth > max(fall, 6.0 * noise), depth <= max(0.1 * fall, 2.0 * noise)
    for first in np.flatnonzero(low & ~np.roll(low, 1)):
        end = first + int(np.argmax(np.append(over[first:], True)))
        deepest = float(depth[first:end].max())
        fell = first > 0 and size[first - 1] - size[first] > 0.5 * deepest
        if fell and end < speed.size and time[end] - time[first] < LEVEL_SPAN:
            out[first:end] = True
    return out


@dataclass(frozen=True, eq=False)
class CommandSteps:
    """Command schedule of a log: `level[i]` (u) holds from `time[i]` [s] on, the first from the first row."""

    time: FloatArray
    level: FloatArray


def command_steps(time: FloatArray, u: FloatArray) -> CommandSteps:
    """Return the changes of a logged command u (n,) [1] over time (n,) [s]; a blank one repeats the last."""
    known = np.isfinite(u)
    if not known.any():
        raise LogError("the log has no command; a motor fit needs command and speed")
    t, level = time[known], u[known]
    changes = np.concatenate([[0], np.flatnonzero(np.diff(level)) + 1])
    return CommandSteps(t[changes], level[changes])


@dataclass(frozen=True)
class Stall:
    """A pause of the logger from the last row before it to the first one after it [s].

    `doubtful` runs from the command whose time was lost until its response is over [s]; None: no command was
    in flight.
    """

    start: float
    end: float
    doubtful: tuple[float, float] | None


def find_stalls(time: FloatArray, steps: CommandSteps) -> tuple[Stall, ...]:
    """Find pauses in the timestamps and the commands whose time they lost.

    A logger that stalls around a command writes the command's row before the pause although the motor gets
    it, or is read, some unknown time later: the rotor seems to wait for up to 0.1 s. The interval from the
    command to 0.15 s after the pause then says nothing about the motor. `time` (n,) are the rows [s].
    """
    interval = np.diff(time)
    if interval.size == 0:
        return ()
    limit = max(_STALL_LEAST, _STALL_INTERVALS * float(np.median(interval)))
    out = []
    for i in np.flatnonzero(interval > limit):
        start, end = float(time[i]), float(time[i + 1])
        # The command's own row may be the first after the pause.
        in_flight = steps.time[1:][(steps.time[1:] >= start - _REACH) & (steps.time[1:] <= end + 1e-9)]
        doubtful = (min(float(in_flight[0]), start), end + _RECOVERY) if in_flight.size else None
        out.append(Stall(start, end, doubtful))
    return tuple(out)


def outside(time: FloatArray, intervals: Sequence[tuple[float, float]]) -> BoolArray:
    """Return True (n,) where a time [s] lies in none of the closed intervals."""
    keep = np.ones(time.size, dtype=np.bool_)
    for start, end in intervals:
        keep &= (time < start) | (time > end)
    return keep


def real_samples(values: FloatArray) -> BoolArray:
    """Return True (n,) where a slow sensor delivered a new value: neither blank nor the last one repeated.

    For thrust stands, whose load cells update more slowly than rows are written. A new value that happens to
    equal the last one is lost with the repeats.
    """
    keep = np.isfinite(values)
    keep[keep] = np.diff(values[keep], prepend=np.nan) != 0
    return keep


@dataclass(frozen=True)
class Tare:
    """Reading of a sensor while nothing turned, to subtract, and its standard error [unit of the channel].

    Without a row at rest the value is 0 and its error NaN. `rows` counts the samples at rest behind it.
    """

    value: float
    error: float
    rows: int
    source: Literal["rows_at_rest", "steady_points", "assumed"] = "rows_at_rest"


def tare(values: FloatArray, at_rest: BoolArray) -> Tare:
    """Return the mean of a sensor's values (n,) [SI] over the rows (n,) at rest.

    A hand on a stand at rest is no tare: values far from the others are left out. The error contains half of
    what the mean drifts from the first rest to the last.
    """
    known = np.flatnonzero(at_rest & np.isfinite(values))
    if known.size == 0:
        return Tare(0.0, float("nan"), 0, "assumed")
    off = np.abs(values[known] - np.median(values[known]))
    known = known[off <= 5.0 * np.median(off) / 0.6745] if np.median(off) > 0 else known
    used = values[known]
    rests = np.split(used, np.flatnonzero(np.diff(np.cumsum(~at_rest)[known])) + 1)
    means = [float(rest.mean()) for rest in rests if rest.size >= _LEAST_REST]
    drift = 0.5 * abs(means[-1] - means[0]) if len(means) > 1 else 0.0
    return Tare(float(used.mean()), float(np.hypot(used.std() / np.sqrt(used.size), drift)), int(used.size))


def rows_at_rest(time: FloatArray, u: FloatArray, speed: FloatArray | None) -> BoolArray:
    """Return True (n,) where no command u is given and nothing turns, nor has turned for the last 0.5 s.

    Nothing turns where the speed [rad/s] is within five times its noise at rest. A probe that sees nothing
    pass reads zero and has no noise then.
    """
    rest = idle = np.abs(u) < AT_REST
    if speed is not None:
        # The noise of the quietest 0.5 s without a command [rad/s]; a rotor that never stood has none.
        size = max(round(_RINGING / float(np.median(np.diff(time)))), 2) if time.size > 1 else 2
        turned, limit = np.nan_to_num(speed), 0.0
        if time.size >= size:
            squares, idles = (np.append(0.0, np.cumsum(x)) for x in (np.where(idle, turned**2, 0.0), idle))
            whole = idles[size:] - idles[:-size] == size
            quietest = max(np.min((squares[size:] - squares[:-size])[whole], initial=np.inf), 0.0)
            limit = min(5.0 * np.sqrt(quietest / size), STANDS * np.max(np.abs(turned)))
        rest = idle & (np.abs(turned) <= limit)
    moving = time[~rest]
    if moving.size == 0:
        return rest
    index = np.searchsorted(moving, time)
    since = time - moving[np.maximum(index - 1, 0)]
    return rest & ((index == 0) | (since > _RINGING))


def signed_speed(speed: FloatArray, direction: Direction, where: str) -> FloatArray:
    """Return speeds (n,) [rad/s] with the sign of the direction; optical probes see none.

    The whole log changes its sign, so that noise at rest keeps its mean of zero.

    Raises LogError for a channel of zeros, a log of one direction that turns both ways, and one of reversals
    that never does.
    """
    known = speed[np.isfinite(speed)]
    if known.size == 0 or not np.any(known):
        raise LogError(
            f"{where}: the speed is zero in all of its {known.size} samples; switch the probe on, or name "
            "another signal as speed (log.columns of a table, log.datasets of HDF5, MAT, TDMS and LVM)"
        )
    top = float(np.max(np.abs(known)))
    forward, reverse = bool(np.any(known > 0.05 * top)), bool(np.any(known < -0.05 * top))
    if direction == "reversal":
        if not (forward and reverse):
            raise LogError(
                f"{where}: a reversal trial whose speed never changes its sign ({known.min():.0f} to "
                f"{known.max():.0f} rad/s); record a signed speed, or correct the trial's direction"
            )
        return speed
    if forward and reverse:
        raise LogError(
            f"{where}: a {direction} trial that turns both ways ({known.min():.0f} to {known.max():.0f} "
            'rad/s); set direction = "reversal", or cut the trial with start and end'
        )
    sign = 1.0 if direction == "forward" else -1.0
    return speed * (sign if top == known.max() else -sign)


def check_command_direction(u: FloatArray, direction: Direction, where: str) -> None:
    """Refuse a log whose commands (n,) [1] contradict its direction; a probe without sign shows nothing."""
    if not np.isfinite(u).any():
        return
    low, high = float(np.nanmin(u)), float(np.nanmax(u))
    backward, ahead = low < -_COMMANDED, high > _COMMANDED
    if direction == "reversal":
        if not (backward and ahead):
            raise LogError(
                f"{where}: a reversal trial whose commands only run from u = {low:.3g} to {high:.3g}; "
                "correct the trial's direction, or command.neutral"
            )
    elif backward if direction == "forward" else ahead:
        seen = "reversal" if backward and ahead else "reverse" if backward else "forward"
        cut = ", cut the trial with start and end," if seen == "reversal" else ""
        raise LogError(
            f"{where}: a {direction} trial whose commands run from u = {low:.3g} to {high:.3g}; set "
            f'direction = "{seen}"{cut} or correct command.neutral'
        )


def standing_command(
    time: FloatArray, speed: FloatArray, steps: CommandSteps, window: tuple[float, float]
) -> float | None:
    """Return a command u at which the rotor stands because unit or neutral seem wrong; None: no such u.

    The rotor must stand throughout a hold of over 0.5 s. It must also turn at a smaller |u| elsewhere, or the
    log must command no smaller |u|. A late start, a start above some throttle and a stand's safety cut
    do not count. `time` and `speed` (n,) are known samples [s], [rad/s]; `window` is the part of the log that
    counts [s].
    """
    if not speed.size or not (top := float(np.abs(speed).max())) > 0.0:
        return None
    starts = np.maximum(steps.time, window[0])
    ends = np.minimum(np.append(steps.time[1:], np.inf), window[1])
    holds = []  # u; whether the rotor stands throughout; whether it mostly turns
    for start, end, level in zip(starts, ends, steps.level, strict=True):
        inside = (time >= start) & (time < end)
        if np.count_nonzero(inside) >= 2 and time[inside][-1] - time[inside][0] > _STANDING:
            share = np.abs(speed[inside]) / top
            holds.append((float(level), share.max() < STANDS, np.median(share) > _TURNS))
    least = min((abs(u) for u, _, _ in holds), default=0.0)
    least_turning = min((abs(u) for u, _, turns in holds if turns), default=np.inf)
    for u, stands, _ in holds:
        if stands and abs(u) > _DRIVEN and (abs(u) > least_turning or abs(u) <= least):
            return u
    return None


def on_one_clock(recording: Recording, names: Sequence[str], reference: Sequence[str]) -> Recording:
    """Return a recording whose channels `names` share a clock; unchanged where they do already.

    A load cell, a tachometer and a second logger sample at different times. A command holds until the next
    one; every other quantity is linear between two samples that lie close together. Valid for sensors faster
    than the motion.

    The clock is the one of the first of `reference` that the recording has; names that it lacks are passed
    over. Rows before the first or after the last known command are left out; notes say what was done.
    """
    channels = dict(recording.channels)
    clock = next((channels[name].time for name in reference if name in channels), None)
    if clock is None:
        return recording
    on_clock = {name: np.array_equal(channels[name].time, clock) for name in names if name in channels}
    if all(on_clock.values()):
        return recording
    moved: dict[str, FloatArray] = {}
    notes: list[Finding] = []
    for name, there in on_clock.items():
        channel = channels[name]
        if there:
            moved[name] = channel.values
            continue
        seen, values = channel.time[channel.valid], channel.values[channel.valid]
        step = float(np.median(np.diff(seen))) if seen.size > 1 else 0.0
        moved[name] = np.full(clock.size, np.nan)
        if name == "command" and seen.size:
            # The last command given; none before the first row and after the last.
            last = np.clip(np.searchsorted(seen, clock, side="right") - 1, 0, seen.size - 1)
            moved[name] = np.where((clock >= seen[0]) & (clock <= seen[-1] + step), values[last], np.nan)
        elif name != "command":
            if seen.size > 1:
                right = np.clip(np.searchsorted(seen, clock), 1, seen.size - 1)
                close = seen[right] - seen[right - 1] <= max(_LONGEST, _STEPS * step)
                known = (clock >= seen[0]) & (clock <= seen[-1]) & close
                moved[name] = np.where(known, np.interp(clock, seen, values), np.nan)
            middle = f", {1e3 * step:.3g} ms apart (median)" if seen.size > 1 else ""
            sentence = f"{name}: {seen.size} samples{middle}, taken linear between them"
            notes.append(note("interpolated", sentence))
    rows = slice(0, clock.size)
    if not on_clock.get("command", True) and np.isfinite(moved["command"]).any():
        commanded = np.flatnonzero(np.isfinite(moved["command"]))
        rows = slice(int(commanded[0]), int(commanded[-1]) + 1)
        left_out = clock.size - (rows.stop - rows.start)
        if left_out:
            sentence = f"rows at which the other log gives no command, left out: {left_out}"
            notes.append(note("rows-without-command", sentence))
    time = clock[rows]
    for name, values in moved.items():
        channels[name] = Channel(name, channels[name].unit, time, values[rows])
    provenance = replace(recording.provenance, notes=(*recording.provenance.notes, *notes))
    return Recording(recording.kind, channels, provenance)
