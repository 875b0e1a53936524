"""Rotor inertia from torque spikes alone: up-steps and down-steps must agree.

At a step the load cell feels τ_aero(Ω) + I^r dΩ/dt, whatever the winding does. The slope of torque over the
acceleration of the *measured* speed needs no R, L, Kv or command delay, so it checks a fitted I^r.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.signal import lfilter

from sysid.campaign import MotorCampaign
from sysid.journal import Finding
from sysid.motor.bench_logs import BenchLog
from sysid.motor.model import aerodynamic_torque
from sysid.motor.targets import filtered
from sysid.trials.bench_log import outside
from sysid.types import BoolArray, FloatArray

# Length of a spike with its decay [s].
_SPIKE = 0.4
# Least step of the command u that shows a spike [1].
_LEAST_STEP = 0.02
# Step of the grid on which the speed of a slow log is differentiated [s].
_GRID = 1e-3
# Time after which a sensor's lag has forgotten its input [time constants].
_MEMORY = 3.0
# Largest relative difference of up- and down-steps that show one inertia [1].
_AGREEMENT = 0.15
# Least number of steps of each kind that show something.
_FEWEST = 2


@dataclass(frozen=True)
class SpikeInertia:
    """Inertia [kg·m²] with its standard error (NaN without steps), by kind of step: "up" and "down".

    `steps` counts those whose transient is whole in the log.
    """

    value: dict[str, float]
    error: dict[str, float]
    steps: dict[str, int]

    def document(self) -> dict[str, object]:
        """Return what a result states."""
        names = ("inertia", "standard_error", "steps")
        return {
            kind: dict(zip(names, (self.value[kind], self.error[kind], self.steps[kind]), strict=True))
            for kind in ("up", "down")
        }

    @property
    def doubt(self) -> Finding | None:
        """That the steps of a kind are too few or that the kinds contradict each other; else None."""
        rises, falls, (up, down) = self.steps["up"], self.steps["down"], self.value.values()
        if min(rises, falls) < _FEWEST:
            sentence = (
                f"torque spikes of {rises} up-steps and {falls} down-steps are too few to check the rotor "
                f"inertia: record {_FEWEST} of each, whole for {_SPIKE:g} s"
            )
        elif abs(up - down) <= _AGREEMENT * 0.5 * (up + down):
            return None
        else:
            sentence = (
                f"torque spikes of {rises} up-steps give a rotor inertia of {up:.3g} kg·m², {falls} "
                f"down-steps give {down:.3g} kg·m²: torque and speed do not belong to one rotor on one clock"
            )
        return Finding("inertia-from-spikes", sentence)


def spike_inertia(
    campaign: MotorCampaign, logs: Sequence[BenchLog], parameters: Mapping[str, float]
) -> SpikeInertia:
    """Return the inertia that the torque spikes of some logs show, each log of one direction.

    Logs are forward or reverse; logs without torque are passed over. `parameters` are the torque curve, the
    delay and the lag of the torque sensor, by name [SI].
    """
    sums = {kind: np.zeros(4) for kind in ("up", "down")}  # Σ a², Σ a y, Σ y², n
    steps = {"up": 0, "down": 0}
    for kind, a, y in spikes(campaign, logs, parameters):
        sums[kind] += np.array([a @ a, a @ y, y @ y, a.size])
        steps[kind] += 1
    value, error = {}, {}
    for kind, (aa, ay, yy, n) in sums.items():
        value[kind] = float(ay / aa) if aa > 0 else float("nan")
        left = max(yy - ay * ay / aa, 0.0) if aa > 0 else float("nan")
        error[kind] = float(np.sqrt(left / max(n - 1.0, 1.0) / aa)) if aa > 0 else float("nan")
    return SpikeInertia(value, error, steps)


def spikes(
    campaign: MotorCampaign, logs: Sequence[BenchLog], parameters: Mapping[str, float]
) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """Yield each step that is whole: "up" or "down", dΩ/dt (n,) [rad/s²], torque above the static one [N·m].

    The arguments are as in `spike_inertia`.
    """
    for log in logs:
        if "torque" not in log.channels:
            continue
        time, acceleration, excess, whole = _seen(campaign, log, parameters)
        levels = log.steps.level
        ends = np.append(log.steps.time[1:], np.inf)
        for i in range(1, levels.size):
            change = abs(levels[i]) - abs(levels[i - 1])
            start = float(log.steps.time[i])
            inside = (time >= start) & (time < min(start + _SPIKE, ends[i]))
            inside &= ~outside(time, (log.window,))
            shown = np.count_nonzero(inside) >= 5 and whole[inside].all()
            if levels[i] == 0 or abs(change) < _LEAST_STEP or not shown:
                continue
            yield "up" if change > 0 else "down", acceleration[inside], excess[inside]


def _seen(
    campaign: MotorCampaign, log: BenchLog, parameters: Mapping[str, float]
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Return time, dΩ/dt, torque above the static one, and where the log is whole.

    Torque and speed of a fast log are filtered alike; the speed of a slow one passes the torque sensor's lag
    to the real samples of the torque.
    """
    if log.fast:
        time, speed = filtered(campaign, log, "speed")
        acceleration = np.gradient(speed, time)
        excess = np.interp(time, *filtered(campaign, log, "torque")) - aerodynamic_torque(speed, parameters)
        return time, acceleration, excess, np.isfinite(acceleration) & np.isfinite(excess)
    rows, speed = log.channels["speed"]
    time, torque = log.channels["torque"]
    delay, constant = parameters["torque_sensor_delay"], parameters["torque_sensor_lag"]
    curve = PchipInterpolator(rows, speed)
    grid = np.arange(rows[0], rows[-1], _GRID)
    felt = [aerodynamic_torque(curve(grid), parameters), curve(grid, 1)]
    if constant > 0:
        keep = float(np.exp(-_GRID / constant))
        felt = [lfilter([1.0 - keep], [1.0, -keep], x, zi=[keep * x[0]])[0] for x in felt]
    static, acceleration = (np.interp(time - delay, grid, x) for x in felt)
    whole = outside(time, log.doubtful)
    pause = 3.0 * float(np.median(np.diff(rows)))
    for i in np.flatnonzero(np.diff(rows) > pause):
        whole &= ~((time - delay > rows[i]) & (time - delay - _MEMORY * constant < rows[i + 1]))
    return time, acceleration, torque - static, whole
