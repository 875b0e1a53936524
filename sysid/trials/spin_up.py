"""Starts from rest in a bench log: spin-ups through the dead band of a sensorless speed controller.

Knows no motor model. What a rotor does until it has left the dead band says how long the controller kept it
there, and everything until it has caught up is late by as much.
"""

from __future__ import annotations

import numpy as np

from sysid.trials.bench_log import AT_REST, CommandSteps
from sysid.trials.steady import SETTLE
from sysid.types import FloatArray

# A rotor below this share of the log's top speed may still be in a dead band; so may one below the upper
# bound of its edge, of propellers that turn fast enough for that.
_SLOW = 0.25


def find_starts(
    time: FloatArray, speed: FloatArray, steps: CommandSteps, edge: float, end: float
) -> tuple[tuple[float, float], ...]:
    """Return (start, end) [s] of the spin-ups that begin inside a dead band.

    Each runs from the command that finds the rotor inside the band until `SETTLE` after the rotor has left
    it, at most to the `end` of the log [s]; spin-ups that overlap are one. `time` and `speed` (n,) are real
    samples of the speed [s], [rad/s], whose sign does not matter; `edge` is the widest dead band to reckon
    with [rad/s].
    """
    size = np.abs(speed)
    if not size.size:
        return ()
    edge = min(edge, _SLOW * float(size.max()))
    intervals: list[tuple[float, float]] = []
    for i in range(steps.time.size):
        start = float(steps.time[i])
        # A command from before the first sample finds the rotor in the state of that sample.
        at = max(int(np.searchsorted(time, start, side="right")) - 1, 0)
        if abs(steps.level[i]) < AT_REST or size[at] >= edge:
            continue
        after = np.flatnonzero(size[at:] >= edge)
        until = min(float(time[at + after[0]]) + SETTLE, end) if after.size else end
        if intervals and start <= intervals[-1][1]:
            intervals[-1] = (intervals[-1][0], max(until, intervals[-1][1]))
        else:
            intervals.append((start, until))
    return tuple(intervals)
