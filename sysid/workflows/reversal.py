"""`sysid reversal-time`: how long speed controllers take to reverse the thrust, log by log."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sysid.errors import LogError
from sysid.filters import ChebyshevLowpass
from sysid.journal import Finding, note, notice
from sysid.loaders import load
from sysid.motor.targets import uniform_filtered
from sysid.recording import Channel
from sysid.report.drawing import save_figure
from sysid.report.fold import print_result, print_table
from sysid.report.motor_figures import ReversalCurves, figure_reversals
from sysid.report.table import listed
from sysid.trials.bench_log import (
    CommandRange,
    CommandSteps,
    Tare,
    command_steps,
    find_stalls,
    on_one_clock,
    real_samples,
    rows_at_rest,
    tare,
)
from sysid.trials.reversal import JITTER, LEVEL, Repetitions, find_reversals, held_commands, repetitions
from sysid.trials.steady import steady_points, zero_of_steady
from sysid.types import BoolArray, FloatArray
from sysid.workflows.options import ReversalOptions


class NoReversalError(LogError):
    """A log without a reversal; among several logs it is left out."""


# Stop-band edge of the low-pass of fast logs [Hz].
_STOP_EDGE = 100.0
# A log is filtered when it has this many samples per period of the stop-band edge.
_FAST = 10.0
# The channel whose clock serves, where channels have different clocks.
_NEEDED, _CLOCK_OF = ("command", "speed", "thrust"), ("thrust",)
_NO_TARE = Tare(0.0, math.nan, 0, "assumed")
# Minimum, neutral and maximum of a protocol where the user says nothing. Bidirectional DShot is no single
# line over its numbers, so it has no default.
_PROTOCOLS = {"us": (1000.0, 1500.0, 2000.0), "1": (-1.0, 0.0, 1.0), "%": (-100.0, 0.0, 100.0)}


def command_range(options: ReversalOptions, unit: str, where: str) -> CommandRange:
    """Return the command range in the log's unit.

    Raises `LogError` when the protocol has no default and the user gave no neutral.
    """
    given = (options.minimum, options.neutral, options.maximum)
    if options.forward_half is not None:
        if unit != "dshot" or any(value is not None for value in given):
            raise LogError(
                f"{where}: --forward-half says what every DShot number means; commands are in {unit}: "
                "give it without --minimum, --neutral, --maximum, or give them instead"
            )
        return CommandRange(unit, 0.0, 0.0, 2047.0, options.forward_half)
    known = _PROTOCOLS.get(unit)
    if known is None and any(value is None for value in given):
        raise LogError(
            f"{where}: commands are in {unit}, whose neutral is not known; give --minimum, --neutral and "
            "--maximum in that unit, or --forward-half low or high for bidirectional DShot"
        )
    low, rest, high = (
        default if stated is None else stated
        for stated, default in zip(given, known or (0.0,) * 3, strict=True)
    )
    if not low < rest < high:
        raise LogError(
            f"{where}: minimum {low:g}, neutral {rest:g}, maximum {high:g} {unit} are not in order; a "
            "reversal needs a neutral between the two"
        )
    return CommandRange(unit, low, rest, high)


@dataclass(frozen=True, eq=False)
class LogReversals(ReversalCurves):
    """Reversals of one log; its thrust as timed: tared, filtered where the log is fast."""

    crossing_from: str  # channel of zero crossing and dead band, speed or thrust
    lost: int  # reversals left out because the logger stalled around their command
    notes: tuple[Finding, ...]

    def document(self, slow: float) -> dict[str, object]:
        """Return what `--json` prints."""
        return {
            "log": self.name,
            "crossing_from": self.crossing_from,
            "lost_to_stalls": self.lost,
            "notes": [finding.document() for finding in self.notes],
            "repetitions": [
                {
                    "before": group.before,
                    "after": group.after,
                    "count": len(group.reversals),
                    "outliers": group.outliers(slow),
                    "outlier_share": group.outliers(slow) / len(group.reversals),
                    **{
                        name: {
                            "median": group.median(name),
                            "quartiles": list(group.quartiles(name)),
                            "each": [getattr(r, name) for r in group.reversals],
                        }
                        for name in ("to_level", "zero_crossing", "dead_band")
                    },
                    "final_thrust": [r.final_thrust for r in group.reversals],
                }
                for group in self.groups
            ],
        }


def log_reversals(path: str | Path, options: ReversalOptions | None = None) -> LogReversals:
    """Read a log and time its reversals.

    Raises `LogError` when it cannot be read, or has no thrust, command or reversal.
    """
    options = options or ReversalOptions()
    path = Path(path)
    if not path.is_file():
        raise LogError(f"{path}: no such log; check the path")
    recording = load(path, units={"command": options.command_unit} if options.command_unit else None)
    where = recording.provenance.path
    if recording.kind == "static-map":
        refusal = f"{where}: has averaged points, no transients; a reversal time needs a running log"
        raise NoReversalError(refusal)
    recording = on_one_clock(recording, _NEEDED, _CLOCK_OF)
    command, thrust = recording["command"], recording["thrust"]
    u = command_range(options, command.unit, where).to_u(command.values, command.unit, where)
    time = command.time
    # A neutral that jitters is a neutral, for the tare too.
    u = np.where(np.abs(u) <= JITTER, 0.0, u)
    steps = held_commands(command_steps(time, u))
    rate = 1.0 / float(np.median(np.diff(time)))
    fast = rate >= _FAST * _STOP_EDGE
    speed = recording["speed"] if "speed" in recording.channels else None
    zero = tare(thrust.values, rows_at_rest(time, u, None if speed is None else speed.values))
    notes = list(recording.provenance.notes)
    keep = thrust.valid if fast else real_samples(thrust.values)
    if zero.rows == 0:
        zero, finding = _zero_without_rest(steps, thrust, keep, speed)
        notes.append(finding)
    forces = (thrust.time[keep], options.thrust_sign * (thrust.values[keep] - zero.value))
    turns = None if speed is None else (speed.time[speed.valid], speed.values[speed.valid])
    if fast:
        lowpass = ChebyshevLowpass(rate, _STOP_EDGE)
        forces = _known(uniform_filtered(*forces, lowpass, f"{where}, thrust"))
        turns = None if turns is None else _known(uniform_filtered(*turns, lowpass, f"{where}, speed"))
    else:
        sentence = f"rows every {1e3 / rate:.1f} ms: timed between real samples, unfiltered"
        notes.append(note("unfiltered", sentence))
    doubtful = tuple(s.doubtful for s in find_stalls(time, steps) if s.doubtful is not None)
    _check_sense(steps, forces, options.thrust_sign < 0, where)
    everything = find_reversals(time, steps, forces, turns, sense=options.sense)
    kept = find_reversals(time, steps, forces, turns, skip=doubtful, sense=options.sense)
    if not kept:
        lowest, highest = float(np.min(steps.level)), float(np.max(steps.level))
        raise NoReversalError(
            f"{where}: no reversal that can be timed: commands run from u = {lowest:.3g} to {highest:.3g}, "
            f"and {len(everything)} reversals were lost to stalls of the logger; check --neutral and "
            "--sense, or record one"
        )
    groups = repetitions(kept)
    for group in groups:
        if group.unsettled:
            hold = max(r.hold for r in group.reversals)
            notes.append(
                Finding(
                    "reversals-unsettled",
                    f"u {group.before:+.2f} → {group.after:+.2f}: no repetition settled during its command "
                    f"(at most {hold:.2g} s), so its final thrust is not known; command it for longer",
                )
            )
    signed = turns is not None and bool(np.any(turns[1] < 0) and np.any(turns[1] > 0))
    return LogReversals(
        path.name, groups, forces, "speed" if signed else "thrust",
        len(everything) - len(kept), tuple(notes),
    )  # fmt: skip


def _zero_without_rest(
    steps: CommandSteps, thrust: Channel, keep: BoolArray, speed: Channel | None
) -> tuple[Tare, Finding]:
    """Return the tare [N] of a thrust without a row at rest, and where it comes from."""
    zero, basis = None, "the tare of thrust is taken as 0"
    if speed is not None:
        # Steady stretches turn as they are commanded, whatever an unsigned probe shows.
        step = np.maximum(np.searchsorted(steps.time, speed.time, side="right") - 1, 0)
        turning = np.sign(steps.level[step]) * np.abs(speed.values)
        channels = {"speed": (speed.time, turning), "thrust": (thrust.time[keep], thrust.values[keep])}
        points = steady_points(thrust.time, steps, channels)
        zero = zero_of_steady(points.thrust, points.speed)
        basis = f"too few steady points in this log, so {basis}"
    if zero is not None:
        basis = f"the tare of thrust, {1e3 * zero.value:.3g} ± {1e3 * zero.error:.2g} mN, is what its steady "
        basis += "points over Ω|Ω| leave at standstill"
    return zero or _NO_TARE, note("no-row-at-rest", f"no row at rest: {basis}")


def _known(signal: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
    keep = np.isfinite(signal[1])
    return signal[0][keep], signal[1][keep]


def _check_sense(
    steps: CommandSteps, forces: tuple[FloatArray, FloatArray], turned: bool, where: str
) -> None:
    """Refuse a log whose thrust opposes its commands, or never reverses."""
    ends = np.append(steps.time[1:], np.inf)
    means: dict[bool, list[float]] = {True: [], False: []}
    for start, end, level in zip(steps.time, ends, steps.level, strict=True):
        inside = (forces[0] >= start) & (forces[0] < end)
        if level != 0 and np.count_nonzero(inside) >= 4:
            means[bool(level > 0)].append(float(np.mean(forces[1][inside][-(inside.sum() // 4 + 1) :])))
    if not (means[True] and means[False]):
        return
    ahead, back = float(np.median(means[True])), float(np.median(means[False]))
    states = f"{where}: thrust is {ahead:.3g} N under forward and {back:.3g} N under reverse commands; "
    if ahead < 0 < back:
        remedy = "leave out --thrust-sign -1" if turned else "turn it with --thrust-sign -1"
        raise LogError(states + remedy)
    if ahead * back > 0:
        raise LogError(states + "the rotor never reverses, or the thrust was logged without its sign")


def print_reversal_times(
    logs: Sequence[Path], options: ReversalOptions, *, figure: Path | None = None, json: bool = False
) -> None:
    """Time the reversals of several logs by `log_reversals`, print them side by side, draw them as in Fig. 3.

    Of several logs, those without a reversal are named and left out. Raises `SysidError` where none has
    one, or a log cannot be used; nothing is written then.
    """
    timed: list[LogReversals] = []
    used: list[Path] = []
    refusals: list[NoReversalError] = []
    for path in logs:
        try:
            timed.append(log_reversals(path, options))
            used.append(path)
        except NoReversalError as error:
            refusals.append(error)
    if not timed:
        raise refusals[0]
    for refusal in refusals:
        notice("not-timed", f"left out: {refusal}")
    names = [log.name for log in timed]
    # The folders distinguish two logs of one file name.
    if len(set(names)) < len(names):
        timed = [replace(log, name=str(path)) for log, path in zip(timed, used, strict=True)]
    if figure is not None:
        save_figure(figure_reversals(timed), figure)
    document = {"level": LEVEL, "logs": [log.document(options.slow) for log in timed]}
    if print_result(document, json):
        return
    rows = []
    for log in timed:
        read_from = "" if log.crossing_from == "speed" else " T"
        for group in log.groups:
            count = len(group.reversals)
            rows.append((
                log.name, f"{group.before:+.2f} → {group.after:+.2f}", str(count),
                _milliseconds(group, "to_level"), _milliseconds(group, "zero_crossing") + read_from,
                _milliseconds(group, "dead_band") + read_from,
                # A single repetition is the quickest of its group.
                f"{100 * group.outliers(options.slow) / count:.0f} %" if count > 1 else "–",
            ))  # fmt: skip
    words = (
        f"outliers: over {options.slow:g} times the quickest, or 90 % not seen to be reached; zero crossing "
    )
    words += "and dead band of the speed where it is signed, else (T) of the thrust"
    heads = ("log", "u", "n", "to 90 %", "to zero", "dead band", "outliers")
    title = "reversal times from the command, median (quartiles) [ms]"
    print_table(listed(title, rows, heads, words, texts=2))
    for log in timed:
        for finding in log.notes:
            print(f"{log.name}: {finding}")
        if log.lost:
            print(f"{log.name}: {log.lost} reversals left out, the logger stalled around their command")
    if figure is not None:
        print(f"{figure}  thrust after the command")


def _milliseconds(group: Repetitions, name: str) -> str:
    median = group.median(name)
    if not math.isfinite(median):
        return "unsettled" if name == "to_level" and group.unsettled else "never"
    low, high = group.quartiles(name)
    spread = f" ({1e3 * low:.0f}–{1e3 * high:.0f})" if len(group.reversals) > 1 else ""
    return f"{1e3 * median:.0f}{spread}"
