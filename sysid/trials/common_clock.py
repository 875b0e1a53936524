"""Channels of several sensors on the clock of one of them.

A load cell, a tachometer and a second logger sample at different times; a fit compares rows. A command holds
until the next command; every other quantity is interpolated linearly between two samples that lie close
together. Valid for sensors faster than the motion; a note states how far apart their samples lie.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.journal import Finding, note
from sysid.recording import Channel, FloatArray, Recording

# A value is taken between two samples no further apart than this [s], or than three median steps of a slow
# sensor: a rotor's speed changes little in either.
_LONGEST, _STEPS = 0.05, 3.0


def _between(channel: Channel, time: FloatArray) -> FloatArray:
    """Return a channel at other times: NaN outside its samples and in its holes."""
    seen, values = channel.time[channel.valid], channel.values[channel.valid]
    if seen.size < 2:
        return np.full(time.size, np.nan)
    longest = max(_LONGEST, _STEPS * float(np.median(np.diff(seen))))
    right = np.clip(np.searchsorted(seen, time), 1, seen.size - 1)
    known = (time >= seen[0]) & (time <= seen[-1]) & (seen[right] - seen[right - 1] <= longest)
    return np.where(known, np.interp(time, seen, values), np.nan)


def _held(channel: Channel, time: FloatArray) -> FloatArray:
    """Return a command at other times: the last one given; NaN before the first and after the last row."""
    seen, values = channel.time[channel.valid], channel.values[channel.valid]
    if not seen.size:
        return np.full(time.size, np.nan)
    last = np.clip(np.searchsorted(seen, time, side="right") - 1, 0, seen.size - 1)
    step = float(np.median(np.diff(seen))) if seen.size > 1 else 0.0
    return np.where((time >= seen[0]) & (time <= seen[-1] + step), values[last], np.nan)


def on_one_clock(recording: Recording, names: Sequence[str], reference: Sequence[str]) -> Recording:
    """Return a recording whose channels `names` share a clock; unchanged where they do already.

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
        elif name == "command":
            moved[name] = _held(channel, clock)
        else:
            moved[name] = _between(channel, clock)
            steps = np.diff(channel.time[channel.valid])
            middle = f", {1e3 * float(np.median(steps)):.3g} ms apart (median)" if steps.size else ""
            sentence = f"{name}: {channel.valid.sum()} samples{middle}, taken linear between them"
            notes.append(note("interpolated", sentence))
    rows = slice(0, clock.size)
    if not on_clock.get("command", True) and np.isfinite(moved["command"]).any():
        known = np.flatnonzero(np.isfinite(moved["command"]))
        rows = slice(int(known[0]), int(known[-1]) + 1)
        left_out = clock.size - (rows.stop - rows.start)
        if left_out:
            sentence = f"rows at which the other log gives no command, left out: {left_out}"
            notes.append(note("rows-without-command", sentence))
    time = clock[rows]
    for name, values in moved.items():
        channels[name] = Channel(name, channels[name].unit, time, values[rows])
    provenance = replace(recording.provenance, notes=(*recording.provenance.notes, *notes))
    return Recording(recording.kind, channels, provenance)
