"""What every load-cell log shares: names of its columns and datasets, their channels, speed from pulses.

The speed from the pulses of a tachometer is valid for one edge per pulse and a sample rate well above twice
the pulse rate; it ignores the direction of turning, which one pulse train does not show.
"""

from collections.abc import Collection

import numpy as np

from sysid.errors import LogError
from sysid.journal import Finding, note
from sysid.loaders.options import is_positive
from sysid.recording import Channel, FloatArray

TIME = frozenset({"time", "t", "timestamp", "time stamp"})
TACHOMETER = frozenset({"tachometer", "tacho", "tach", "pulse", "pulses", "hall"})
COMMAND = frozenset({"command", "cmd", "throttle", "esc", "esc signal", "pwm"})
# Width of the band around the middle level, as a share of the pulse's height [1]: noise within it makes no
# edge.
_HYSTERESIS = 0.25
# Least length of a step that has lost a sample [median steps]; jitter alone stays below.
_HOLE = 2.5


def _axis(kind: str, letters: str, axis: str) -> frozenset[str]:
    return frozenset({f"{letter}{axis}" for letter in letters} | {f"{kind} {axis}", f"{letters[0]} {axis}"})


def shown_unit(unit: str) -> str:
    """Return a unit as a channel shows it."""
    return {"N*m": "N·m", "m/s^2": "m/s²"}.get(unit, unit)


# SI unit by channel. Thrust and torque are the z components: the axis of a motor on a six-axis cell.
UNITS = {
    "speed": "rad/s", "thrust": "N", "torque": "N*m", "force_x": "N", "force_y": "N", "torque_x": "N*m",
    "torque_y": "N*m", "voltage": "V", "current": "A",
}  # fmt: skip
# Names by channel, with the signals beside the quantities.
STEMS = {
    "time": TIME,
    "command": COMMAND,
    "tachometer": TACHOMETER,
    "speed": frozenset({"speed", "motor speed", "rotor speed", "omega", "ω", "rpm"}),
    "thrust": _axis("force", "f", "z") | {"thrust"},
    "torque": _axis("torque", "mt", "z") | {"moment z", "torque"},
    "force_x": _axis("force", "f", "x"),
    "force_y": _axis("force", "f", "y"),
    "torque_x": _axis("torque", "mt", "x") | {"moment x"},
    "torque_y": _axis("torque", "mt", "y") | {"moment y"},
    "voltage": frozenset({"voltage", "supply voltage", "battery voltage"}),
    "current": frozenset({"current", "supply current", "motor current"}),
}
# Channels that make a log a load-cell log; one suffices.
MEASURED = ("thrust", "torque")
# Names that only a force sensor has.
CELL_AXES = (STEMS["thrust"] - {"thrust"}) | {"mz", "moment z"}
# Names that suffice for a second log, recorded beside the load cell's.
BESIDE = STEMS["speed"] | STEMS["voltage"] | STEMS["current"] | TACHOMETER


def check_tachometer(path: str, channels: Collection[str], pulses_per_revolution: object) -> None:
    """Refuse pulses per revolution that are no number, belong to nothing, or rival a speed channel."""
    if pulses_per_revolution is None:
        return
    if not is_positive(pulses_per_revolution):
        raise LogError(
            f"{path}: pulses_per_revolution = {pulses_per_revolution!r} is no positive number; "
            "count the marks on the rotor"
        )
    if "tachometer" not in channels:
        raise LogError(
            f"{path}: pulses_per_revolution is declared but no tachometer is found; "
            "name its column Tachometer, or leave the option out"
        )
    if "speed" in channels:
        raise LogError(
            f"{path}: has both a speed and a tachometer; leave out pulses_per_revolution, or name only "
            "one of them"
        )


def _edges(time: FloatArray, values: FloatArray, low: float, high: float) -> FloatArray:
    """Return the times [s] at which the signal crosses the middle upward, each once per swing low to high."""
    state = np.where(values >= high, 1, np.where(values <= low, -1, 0))
    decided = np.flatnonzero(state)
    turns = np.flatnonzero(np.diff(state[decided]) == 2) + 1
    middle = 0.5 * (low + high)
    out = np.empty(turns.size)
    for place, turn in enumerate(turns):
        first, last = int(decided[turn - 1]), int(decided[turn])
        within = first + int(np.argmax(values[first : last + 1] >= middle))
        before, after = values[within - 1], values[within]
        share = (middle - before) / (after - before)
        out[place] = time[within - 1] + share * (time[within] - time[within - 1])
    return out


def pulse_speed(
    path: str, time: FloatArray, values: FloatArray, pulses_per_revolution: float
) -> tuple[Channel, list[Finding]]:
    """Return the channel ``speed`` [rad/s, never negative] of a pulse train, and notes.

    One sample per period, at its middle: 2π / (pulses per revolution · period). Between pulses nothing is
    known and nothing is filled in; a period with a lost sample or a hole in the clock is NaN. `values`
    are the level of the tachometer, any unit, either polarity. Fewer than two pulses, or pulses too fast for
    the samples, are a LogError.
    """
    seen = np.isfinite(values)
    low, high = (float(np.min(values[seen])), float(np.max(values[seen]))) if seen.any() else (0.0, 0.0)
    band = 0.5 * _HYSTERESIS * (high - low)
    middle = 0.5 * (low + high)
    edges = _edges(time[seen], values[seen], middle - band, middle + band) if high > low else np.empty(0)
    if edges.size < 2:
        raise LogError(
            f"{path}: the tachometer shows {edges.size} pulses between {low:g} and {high:g}; "
            "check which channel it is"
        )
    periods = np.diff(edges)
    steps = np.diff(time)
    step = float(np.median(steps))
    shortest = float(np.percentile(periods, 5))
    if shortest < 3.0 * step:
        raise LogError(
            f"{path}: pulses come every {shortest / step:.1f} samples, too fast to be told apart; record the "
            "tachometer at a higher rate or with fewer marks"
        )
    speed = 2.0 * np.pi / (pulses_per_revolution * periods)
    lost = time[~seen]
    holes = np.searchsorted(lost, edges[1:]) > np.searchsorted(lost, edges[:-1])
    missing = np.flatnonzero(steps > _HOLE * step)
    # An edge inside a hole is only interpolated, so both of its periods are unknown.
    begun = np.searchsorted(time[missing], edges[1:], side="left")
    ended = np.searchsorted(time[missing + 1], edges[:-1], side="right")
    torn = begun > ended
    speed = np.where(holes | torn, np.nan, speed)
    sentence = (
        f"speed from {edges.size} pulses at {pulses_per_revolution:g} per revolution, one value per "
        f"period (edges resolve {100 * step / float(np.median(periods)):.2g} % of a period at worst)"
    )
    notes = [note("speed-from-pulses", sentence)]
    if torn.any():
        sentence = (
            f"holes in the clock of the tachometer: {missing.size} (the longest {float(steps.max()):.3g} "
            f"s); the {int(torn.sum())} periods across them have no speed"
        )
        notes.append(note("tachometer-holes", sentence))
    return Channel("speed", "rad/s", 0.5 * (edges[1:] + edges[:-1]), speed), notes


def speed_channel(
    path: str,
    label: str,
    time: FloatArray,
    values: FloatArray | None,
    pulses_per_revolution: float | None,
    notes: list[Finding],
) -> dict[str, Channel]:
    """Return the speed of a signal that looks like pulses; without pulses per revolution, only note it."""
    if pulses_per_revolution is None or values is None:
        sentence = (
            f"{label!r} looks like the pulses of a tachometer and was left out; "
            "declare pulses_per_revolution to get the speed"
        )
        notes.append(note("tachometer-left-out", sentence))
        return {}
    speed, pulse_notes = pulse_speed(path, time, values, pulses_per_revolution)
    notes += pulse_notes
    return {"speed": speed}
