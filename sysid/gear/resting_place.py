"""Where and when a dropped drone comes to rest: measured, and as a distribution over sets and starts.

A start that noise has moved by a tenth of a millimetre ends elsewhere after five bounces, so one simulated
stopping place proves nothing; the spread over starts drawn from their own uncertainty says what can be known.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import signal

from sysid.filters import bridge_gaps
from sysid.gear.capture_noise import start_roots
from sysid.gear.drops import PreparedDrop
from sysid.gear.model import PARAMETERS, Drops, Ending, simulate_population
from sysid.types import FloatArray

# Starts that are drawn per set.
_STARTS = 20
_REST = Ending()
# Rates of the measurement are taken over this time [s]: differences of single samples are noise.
_SMOOTH = 0.11


def stopping(
    drop: PreparedDrop, rows: FloatArray, board_length: float | None, **simulation: Any
) -> dict[str, Any]:
    """Return place [m, down-slope] and time [s] of the end of a drop since its first touchdown.

    The end is the beginning of rest (`Ending`), else the end of the log, or where the body leaves the board.
    `rows` (S, n_table) are the sets [SI]; `board_length` counts down-slope from the touchdown [m];
    `simulation` gives law, tolerance and threads of `simulate_population`.
    """
    motion, tangent = drop.motion, drop.tangent
    touch = float(drop.flight.at(np.array([drop.touchdown]))[0, :2] @ tangent)
    last = motion.time[-1]
    if board_length is not None:
        along = np.column_stack([motion.x, motion.z]) @ tangent
        gone = np.flatnonzero((motion.time > drop.touchdown) & (along - touch > board_length))
        last = motion.time[gone[0]] if gone.size else last
    after = motion.time[(motion.time >= drop.time[0]) & (motion.time <= last)]
    measured_time, measured_place, stops = _measured(drop, after)
    roots = start_roots(drop)
    normal = np.random.default_rng(0).standard_normal((len(rows) * _STARTS, len(roots)))
    starts = drop.initial_state + normal @ roots
    many = np.repeat(rows[:, : len(PARAMETERS)], _STARTS, axis=0)
    # Rest is seen once it has lasted: simulated on, it shows up to the end of the log.
    beyond = after[-1] + np.arange(1, round(1.5 * _REST.rest_time * motion.rate) + 1) / motion.rate
    clock = np.concatenate([after, beyond])
    jobs = Drops(np.array([drop.slope]), drop.initial_state[None], (clock,))
    runs = simulate_population(many, jobs, body_states=starts[:, None], **simulation)
    good = runs.status[:, 0] == 0
    length = float(after[-1] - after[0])
    rests = np.nan_to_num(runs.rest[:, 0], nan=np.inf) < length
    end = np.where(rests, runs.rest[:, 0], length)
    since = drop.touchdown - after[0]
    index = np.minimum(np.searchsorted(after - after[0], end), len(after) - 1)
    at = runs.samples[np.arange(len(many)), index, :2] @ tangent
    place, moment = (at - touch)[good], (end - since)[good]
    return {
        "place": _three(measured_place - touch, place),
        "time": _three(measured_time - drop.touchdown, moment),
        "measured_stops": stops,
        "share_stops": float(np.mean(rests[good])) if good.any() else float("nan"),
    }


def _three(measured: float, simulated: FloatArray) -> dict[str, float]:
    mean, sigma = (simulated.mean(), simulated.std()) if len(simulated) else (np.nan, np.nan)
    return {"measured": float(measured), "mean": float(mean), "sigma": float(sigma)}


def _measured(drop: PreparedDrop, after: FloatArray) -> tuple[float, float, bool]:
    """Return when [s] and where along the slope [m] the measured body came to rest, and whether it did."""
    motion = drop.motion
    rows = (motion.time >= after[0]) & (motion.time <= after[-1])
    filled = bridge_gaps(motion.coordinates(), motion.valid)[rows]
    width = min(2 * int(_SMOOTH * motion.rate / 2) + 1, len(filled) - 1 + len(filled) % 2)
    smooth, rates = (
        signal.savgol_filter(filled, width, 2, deriv=order, delta=1 / motion.rate, axis=0) for order in (0, 1)
    )
    still = (np.hypot(rates[:, 0], rates[:, 1]) < _REST.rest_speed) & (np.abs(rates[:, 2]) < _REST.rest_turn)
    still &= after > drop.touchdown
    moving = np.flatnonzero(~still)
    first = int(moving[-1]) + 1 if len(moving) else 0
    stops = first < len(after) and after[-1] - after[first] >= _REST.rest_time
    at = first if stops else len(after) - 1
    return float(after[at]), float(smooth[at, :2] @ drop.tangent), bool(stops)
