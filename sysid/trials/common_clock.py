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

# Largest gap between two samples that a value is taken from [s], and in median steps of a slow sensor: a
# rotor's speed changes little in either.
_LONGEST, _STEPS = 0.05, 3.0


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
            continue
        seen, values = channel.time[channel.valid], channel.values[channel.valid]
        step = float(np.median(np.diff(seen))) if seen.size > 1 else 0.0
        moved[name] = np.full(clock.size, np.nan)
        if name == "command" and seen.size:
            # The last one given; none before the first and after the last row.
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
