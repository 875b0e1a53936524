"""From settled bench logs to what a fit simulates and compares: filter, grids, command schedule, supply."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from sysid.campaign import MotorCampaign, MotorTrial
from sysid.errors import LogError
from sysid.filters import ChebyshevLowpass, Spectrum, amplitude_spectrum
from sysid.motor.batch import SimulatedTrial
from sysid.motor.bench_logs import BenchLog, Samples
from sysid.motor.cost import MotorTarget
from sysid.motor.curves import StaticCurves
from sysid.motor.parameters import PARAMETERS
from sysid.trials.bench_log import outside
from sysid.trials.steady import SETTLE, find_starts
from sysid.types import BoolArray, FloatArray

# Samples of the simulation and of the comparison per period of the stop-band edge of a fast log.
_SIMULATED, _COMPARED = 10.0, 2.5
# Step of the simulation of a slow log over its row interval [1], and the limits of that step [s]. The NRMSE
# of public logs at 121 and 143 Hz is within 0.05 % of its value at a tenth of the step.
_SLOW_SHARE, _SLOW_GRID = 0.55, (1e-3, 4e-3)
# Time over which the supply voltage is averaged [s]: its noise is no physics.
_SUPPLY_MEAN = 0.04
# Largest error of the supply's polyline [share of V_ref]: every knot of it ends a simulated step.
_SUPPLY_LINE = 2e-3
# Least filter tap that is kept [share of the centre].
_TAP_LEAST = 1e-4
# Least share of a trial's compared samples outside its starts from rest [1]; a trial with less keeps its
# starts in the dynamic fit.
_LEAST_LEFT = 0.25
# Number of samples of the speed that a start from rest needs to show a dead band.
_LEAST_SHOWN = 10


@dataclass(frozen=True, eq=False)
class PreparedTrial:
    """One trial of the campaign: its log, what is simulated, what is compared, what a result states of it."""

    entry: MotorTrial
    log: BenchLog
    simulated: SimulatedTrial
    target: MotorTarget
    # Spin-ups from rest inside the window [s], as far as the filter carries them.
    starts: tuple[tuple[float, float], ...]
    thrust: FloatArray | None  # (n,) measured and filtered like the rest [N]; None: not recorded
    provenance: dict[str, object]

    @property
    def started(self) -> BoolArray:
        """(n,) True where a compared instant belongs to a start from rest."""
        return ~outside(self.target.time, self.starts)

    @property
    def shows_start(self) -> bool:
        """Whether enough samples of the speed belong to starts from rest."""
        return bool(self.target.valid[self.started, 1].sum() >= _LEAST_SHOWN)

    @property
    def only_starts(self) -> bool:
        """Whether too little of the trial is left without its starts from rest."""
        left = self.target.valid & ~self.started[:, None]
        return bool(self.starts) and left.sum() < _LEAST_LEFT * self.target.valid.sum()

    @property
    def dynamic_target(self) -> MotorTarget:
        """The target without its starts from rest, whose dead band is not known before the dynamic fit."""
        if not self.starts or self.only_starts:
            return self.target
        return replace(self.target, valid=self.target.valid & ~self.started[:, None])


def prepare_run(
    campaign: MotorCampaign, entry: MotorTrial, log: BenchLog, curves: StaticCurves
) -> PreparedTrial:
    """Filter a log where it is fast, choose the grids, and join command schedule and supply."""
    window, begin = log.window, float(log.time[0])
    taps = filter_taps(campaign, log) if log.fast else np.zeros(0)
    # The simulation begins at a steady state, at the latest where the filter begins to look.
    reach = (len(taps) - 1) * _fast_step(campaign) if log.fast else 0.0
    start = _steady_start(log, max(begin, window[0] - reach))
    name = f"trial {entry.name!r} of {entry.log}"
    target = _fast_target(campaign, log, name, start, taps) if log.fast else _slow_target(log, name, start)
    grid = np.asarray(start + target.grid_step * np.arange(target.grid_size), dtype=np.float64)
    starts = find_starts(
        *log.channels["speed"], log.steps, PARAMETERS["saturation_speed"].upper, float(log.time[-1])
    )
    starts = tuple((a - reach, b + reach) for a, b in starts if b + reach > start and a - reach < window[1])
    thrust = None
    if "thrust" in log.channels:
        thrust = np.interp(target.time, *filtered(campaign, log, "thrust"))
    provenance = {
        **log.recording.provenance.source,
        "direction": entry.direction,
        "rate": 1.0 / log.interval,
        "window": [float(w) for w in log.window],
        "commands": int(log.steps.time.size),
        **{f"{name}_sign": sign for name, sign in log.signs.items()},
        "tare": {
            name: asdict(tare) | {"error": tare.error if np.isfinite(tare.error) else None}
            for name, tare in log.tares.items()
        },
        "doubtful": [list(interval) for interval in log.doubtful],
        "starts_from_rest": [list(interval) for interval in starts],
        **({} if log.second is None else {"second_log": log.second}),
        "notes": [str(note) for note in log.notes],
    }
    supply, mapped = _supply(log, curves.reference_voltage), curves.mapped(log.steps.level)
    simulated = SimulatedTrial(log.steps.time, log.steps.level, grid, "steady", supply, mapped)
    return PreparedTrial(entry, log, simulated, target, starts, thrust, provenance)


def filter_design(campaign: MotorCampaign, logs: Sequence[BenchLog]) -> dict[str, object]:
    """Return the filter of the fast logs as it goes into a result, and which logs went without."""
    fast = [log for log in logs if log.fast]
    slow = [log.name for log in logs if not log.fast]
    design: dict[str, object] = _lowpass(campaign, fast[0]).design() if fast else {"kind": "none"}
    if slow:
        why = "filter_off" if campaign.filter.kind == "none" else "too_slow"
        design["unfiltered"] = {"trials": slow, "why": why}
    return design


def _fast_step(campaign: MotorCampaign) -> float:
    return 1.0 / (_SIMULATED * campaign.filter.stop_edge)


def _lowpass(campaign: MotorCampaign, log: BenchLog) -> ChebyshevLowpass:
    """Return the campaign's filter at the rate of a log."""
    settings = campaign.filter
    return ChebyshevLowpass(1.0 / log.interval, settings.stop_edge, settings.order, settings.attenuation_db)


def filter_taps(campaign: MotorCampaign, log: BenchLog) -> FloatArray:
    """Return centre and one side (h + 1,) of the campaign's filter on the grid of a fast log's simulation."""
    lowpass = _lowpass(campaign, log)
    step = _fast_step(campaign)
    size = 4 * lowpass.edge_samples + lowpass.minimum_samples
    pulse = np.zeros(2 * size + 1)
    pulse[size] = 1.0
    response = lowpass.apply(pulse)[size:]
    lags = np.arange(0.0, (size - 1) / lowpass.rate, step)
    # The response contains nothing above the stop band, so a grid of ten samples per period carries it whole.
    taps = np.interp(lags, np.arange(response.size) / lowpass.rate, response) * step * lowpass.rate
    large = np.flatnonzero(np.abs(taps) > _TAP_LEAST * abs(taps[0]))
    taps = taps[: large[-1] + 1]
    taps /= taps[0] + 2.0 * taps[1:].sum()
    return np.asarray(taps, dtype=np.float64)


def _fast_target(
    campaign: MotorCampaign, log: BenchLog, name: str, start: float, taps: FloatArray
) -> MotorTarget:
    """Compare the filtered log every few samples of the grid, as far from its ends as the filter reaches."""
    step, window = _fast_step(campaign), log.window
    half = len(taps) - 1
    end = min(window[1] + half * step, float(log.time[-1]))
    grid = np.asarray(start + step * np.arange(int((end - start) / step)), dtype=np.float64)
    rows = np.arange(half, grid.size - half, int(_SIMULATED / _COMPARED))
    rows = rows[~outside(grid[rows], (window,))]
    if rows.size < 10:
        raise LogError(
            f"{log.where}: {rows.size} compared instants between {window[0]:g} and {window[1]:g} s; "
            f"the filter takes {half * step:.2f} s at each end of the log: widen the window"
        )
    time = grid[rows]
    measured = _compared(log, time, lambda channel: np.interp(time, *filtered(campaign, log, channel)))
    valid = np.isfinite(measured) & outside(time, log.doubtful)[:, None]
    return MotorTarget(name, time, measured, valid, start, step, grid.size, taps)


def _slow_target(log: BenchLog, name: str, start: float) -> MotorTarget:
    """Compare the real samples of a slow log, each at its row."""
    step = float(np.clip(_SLOW_SHARE * log.interval, *_SLOW_GRID))
    rows = log.time[~outside(log.time, (log.window,))]

    def at_rows(channel: str) -> FloatArray:
        t, values = log.channels[channel]
        out = np.full(rows.size, np.nan)
        at = np.searchsorted(rows, t)
        hit = (at < rows.size) & (rows[np.minimum(at, rows.size - 1)] == t)
        out[at[hit]] = values[hit]
        return out

    measured = _compared(log, rows, at_rows)
    seen = np.isfinite(measured)
    # Figures show speeds that drop out; the NRMSE leaves them out.
    place = np.searchsorted(rows, log.dropped[0])
    inside = (place < rows.size) & ~outside(log.dropped[0], (log.window,))
    measured[place[inside], 1] = log.dropped[1][inside]
    size = int(np.ceil((rows[-1] - start) / step)) + 2
    valid = seen & outside(rows, log.doubtful)[:, None]
    return MotorTarget(name, rows, measured, valid, start, step, size, np.zeros(0))


def _compared(log: BenchLog, time: FloatArray, values: Callable[[str], FloatArray]) -> FloatArray:
    """Return torque and speed (n, 2) at some times (n,); NaN for a channel that was not recorded."""
    out = np.full((time.size, 2), np.nan)
    for c, channel in enumerate(("torque", "speed")):
        if channel in log.channels:
            out[:, c] = values(channel)
    return out


def measured_spectrum(log: BenchLog, time: FloatArray) -> Spectrum | None:
    """Return the spectrum of torque and speed before the filter, over `time` (n,) [s]; None if too short.

    A channel that was not recorded is NaN.
    """
    clock = np.arange(time[0], time[-1], log.interval)
    if clock.size < 16:
        return None

    def unfiltered(channel: str) -> FloatArray:
        t, values = log.channels[channel]
        known = np.isfinite(values)
        return np.interp(clock, t[known], values[known])

    return amplitude_spectrum(_compared(log, clock, unfiltered), 1.0 / log.interval)


def filtered(campaign: MotorCampaign, log: BenchLog, channel: str) -> Samples:
    """Return times and values of a channel; of a fast log filtered, NaN in its holes."""
    if not log.fast:
        return log.channels[channel]
    return uniform_filtered(*log.channels[channel], _lowpass(campaign, log), f"{log.where}, {channel}")


def uniform_filtered(time: FloatArray, values: FloatArray, lowpass: ChebyshevLowpass, where: str) -> Samples:
    """Return a filtered channel (n,) on a clock [s] without holes: rows that the log lacks are NaN there."""
    if time.size < lowpass.minimum_samples:
        raise LogError(
            f"{where}: {time.size} samples are fewer than the {lowpass.minimum_samples} that the filter "
            'needs; record longer or set filter.kind = "none"'
        )
    intervals = np.diff(time)
    if float(intervals.max()) < 1.5 * float(np.median(intervals)):
        return time, lowpass.apply(values)
    index = np.rint((time - time[0]) * lowpass.rate).astype(np.int64)
    full = np.full(int(index[-1]) + 1, np.nan)
    full[index] = values
    return time[0] + np.arange(full.size) / lowpass.rate, lowpass.apply(full)


def _steady_start(log: BenchLog, start: float) -> float:
    """Return the latest time not after `start` at which the command has been the same for long enough."""
    for instant in log.steps.time[::-1]:
        if instant <= start:
            if start - instant >= SETTLE or instant <= log.time[0]:
                return start
            start = float(np.nextafter(instant, -np.inf))
    return max(start, float(log.time[0]))


def _supply(log: BenchLog, reference_voltage: float) -> tuple[FloatArray, FloatArray] | None:
    """Return knots [s] and V/V_ref there, (k,) each; None where the log lacks the supply."""
    if "voltage" not in log.channels:
        return None
    t, volts = log.channels["voltage"]
    block = np.floor((t - t[0]) / _SUPPLY_MEAN).astype(np.int64)
    _, index, count = np.unique(block, return_inverse=True, return_counts=True)
    mean_time = np.bincount(index, t) / count
    ratio = np.bincount(index, volts) / count / reference_voltage
    # The fewest knots whose polyline is close to all others.
    kept = {0, mean_time.size - 1}
    open_parts = [(0, mean_time.size - 1)]
    while open_parts:
        first, last = open_parts.pop()
        if last - first < 2:
            continue
        inside = slice(first + 1, last)
        line = np.interp(mean_time[inside], mean_time[[first, last]], ratio[[first, last]])
        distance = np.abs(ratio[inside] - line)
        worst = int(np.argmax(distance))
        if distance[worst] > _SUPPLY_LINE:
            middle = first + 1 + worst
            kept.add(middle)
            open_parts += [(first, middle), (middle, last)]
    knots = sorted(kept)
    return mean_time[knots], ratio[knots]
