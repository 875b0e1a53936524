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
    """Find the spin-ups that begin inside a dead band.

    Parameters
    ----------
    time, speed : (n,) arrays
        Real samples of the speed [s], [rad/s]; its sign does not matter.
    steps : CommandSteps
        In u.
    edge : float
        The widest dead band to reckon with [rad/s].
    end : float
        Of the log [s].

    Returns
    -------
    tuple of (start, end)
        From the command that finds the rotor inside the band until `SETTLE` after it has left it [s];
        spin-ups that overlap are one.
    """
    size = np.abs(speed)
    if not size.size:
        return ()
    edge = min(edge, _SLOW * float(size.max()))
    intervals: list[tuple[float, float]] = []
    for i in range(steps.time.size):
        start = float(steps.time[i])
        at = int(np.searchsorted(time, start, side="right")) - 1
        # A command from before the first sample finds the rotor in the state of that sample.
        if abs(steps.level[i]) < AT_REST or size[max(at, 0)] >= edge:
            continue
        after = np.flatnonzero(size[max(at, 0) :] >= edge)
        until = min(float(time[max(at, 0) + after[0]]) + SETTLE, end) if after.size else end
        if intervals and start <= intervals[-1][1]:
            intervals[-1] = (intervals[-1][0], max(until, intervals[-1][1]))
        else:
            intervals.append((start, until))
    return tuple(intervals)
