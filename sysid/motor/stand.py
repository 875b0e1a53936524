"""What the log of a thrust stand gives before any winding is fitted: curves, power, time constants, delays.

A stand of some 100 Hz shows neither R nor L in the response to a step: the winding settles between two of its
rows. Its steady levels and the speed after a step need no winding::

    V I − τ Ω = R I_m² + τ_f Ω,      I_m = τ/k                       lost power of motor and controller
    Ω(t) = Ω_1 + (Ω_0 − Ω_1) exp(−(t − t_d)/T)                       a step from Ω_0 to Ω_1

Valid for a supply whose voltage and current are logged in front of the controller, and for steps between
steady levels of one direction. Ignores the controller's own loss, which R and τ_f take up.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares, nnls

from sysid.journal import Finding
from sysid.motor.bench_logs import BenchLog
from sysid.motor.curves import StaticCurves
from sysid.trials.bench_log import AT_REST
from sysid.trials.steady import SETTLE, SteadyPoints
from sysid.types import FloatArray, Rotation

# Curves are stated at round speeds, of which logs of one propeller share some: at least this number up to the
# fastest steady point, and farther by this factor [1].
_ROUND, _FARTHER = 2, 1.1
# Least step of the speed and least speed that show a time constant, as shares of the top speed [1], and the
# time before and after a step over which its levels are averaged [s].
_LEAST_STEP, _LEAST_SPEED, _AVERAGED = 0.02, 0.1, 0.3
# Least number of steps or levels from which a value is stated.
_FEWEST = 3
# Ratio of the largest apparent resistance of a level to the least one from which one resistance does not
# explain the lost power [1].
_CLIMBS = 1.5
# Share by which the supply current may exceed what a stated Kv allows [1].
_KV_AGREES = 0.03
# Half-width of a 95 % interval [standard errors].
_WIDE = 1.96


@dataclass(frozen=True)
class CurveValue:
    """Thrust [N] or torque [N·m] at a speed [rad/s]; the interval contains the stand's calibration.

    A `common` speed is a round one, which logs of one propeller share; else it is the fastest steady point.
    """

    quantity: str
    direction: Rotation
    speed: float
    value: float
    interval_95: tuple[float, float]
    common: bool


@dataclass(frozen=True)
class LostPower:
    """R [Ω] and friction [N·m] of the lost power of steady levels, under a torque constant [N·m/A].

    `least_kv` [rad/s/V] is the least with which the supply current is possible, at a duty of 1. Speeds
    [rad/s] and the lost power over I_m² [Ω] are by level, the lowest torque first.
    """

    torque_constant: float
    resistance: float
    interval_95: tuple[float, float]
    friction_torque: float
    least_kv: float
    speeds: tuple[float, ...]
    apparent_resistances: tuple[float, ...]


@dataclass(frozen=True)
class StepTime:
    """Median of a time [s] over the steps of the speed."""

    value: float
    interval_95: tuple[float, float]
    steps: int


@dataclass(frozen=True)
class StandValues:
    """What steady levels and steps of the fitted logs show; `times` by name, see `step_times`."""

    curves: tuple[CurveValue, ...]
    power: LostPower | None
    times: dict[str, StepTime]
    # Standard error of the calibration of the load cells [1]: no log shows it.
    calibration: float = 0.0

    def document(self) -> dict[str, Any]:
        """Return what a result states."""
        said = [*self.sentences(), *(found.sentence for found in self.findings())]
        return {**asdict(self), "sentences": said}

    def sentences(self) -> Iterator[str]:
        """Yield the values in words."""
        tops = {row.direction: abs(row.speed) for row in self.curves if not row.common}
        for name, each in itertools.groupby(self.curves, lambda row: f"{row.quantity}, {row.direction}"):
            rows = list(each)
            top = tops[rows[0].direction]
            unit = "N" if name.startswith("thrust") else "N·m"
            words = (
                f"{row.value:.4g} {unit} ({row.interval_95[0]:.4g} to {row.interval_95[1]:.4g}) at "
                f"{abs(row.speed):.4g} rad/s{'' if abs(row.speed) <= top else ', beyond the steady points'}"
                for row in rows
            )
            yield (
                f"{name}: {', '.join(words)}; 95 %, with {100 * self.calibration:g} % for the calibration of "
                "the load cells"
            )
        if self.times:
            words = (
                f"{name.replace('_', ' ')} {1e3 * row.value:.3g} ms ({1e3 * row.interval_95[0]:.3g} to "
                f"{1e3 * row.interval_95[1]:.3g}, {row.steps} steps)"
                for name, row in self.times.items()
            )
            yield f"steps of the speed: {', '.join(words)}"
        if self.power is not None:
            p = self.power
            low, high = (1e3 * end for end in p.interval_95)
            yield (
                f"lost power of {len(p.speeds)} steady levels: an apparent R of {1e3 * p.resistance:.3g} mΩ "
                f"({low:.3g} to {high:.3g}) and {1e3 * p.friction_torque:.2g} mN·m of friction at Kv "
                f"{rpm(1 / p.torque_constant):.4g} rpm/V; supply current and torque are possible with a Kv "
                f"of {rpm(p.least_kv):.4g} rpm/V or more"
            )

    @property
    def in_short(self) -> str:
        """What counts whatever the winding is, in words: curves at the fastest common speed, times."""
        tops = {row.direction: abs(row.speed) for row in self.curves if not row.common}
        shared = [row for row in self.curves if row.common and abs(row.speed) <= tops[row.direction]]
        speed = max((row.speed for row in shared), key=abs, default=0.0)
        words = [
            f"{row.quantity} {row.value:.4g} {'N' if row.quantity == 'thrust' else 'N·m'} "
            f"({row.interval_95[0]:.4g} to {row.interval_95[1]:.4g})"
            for row in shared
            if row.speed == speed
        ]
        out = [f"{' and '.join(words)} at {abs(speed):.4g} rad/s"] if words else []
        out += [
            f"{name.replace('_', ' ')} {1e3 * row.value:.3g} ms"
            for name, row in self.times.items()
            if row.value > 0
        ]
        return ", ".join(out)

    def beside(self, delay: float, resistance: float | None) -> Iterator[str]:
        """Yield why the fitted delay [s] and resistance [Ω] differ from these; None where R was not free."""
        if (time := self.times.get("dead_time")) and not time.interval_95[0] <= delay <= time.interval_95[1]:
            yield (
                f"the fit's command delay is {1e3 * delay:.3g} ms: it comes before a rotor of the stated "
                f"inertia and R, the dead time of {1e3 * time.value:.3g} ms before a lag with the time "
                "constants above; the dead time is what the log shows, the delay makes up for inertia and R"
            )
        if self.power is not None and resistance is not None:
            yield (
                f"the fit's R is {1e3 * resistance:.3g} mΩ, from the response to steps; the lost power's "
                f"{1e3 * self.power.resistance:.3g} mΩ contain what iron and controller lose"
            )

    def findings(self) -> Iterator[Finding]:
        """Yield clocks that are offset, and where steady levels contradict a motor of one R, or its Kv."""
        if (time := self.times.get("dead_time")) and time.interval_95[1] < 0:
            sentence = (
                f"the speed moves {-1e3 * time.value:.3g} ms before its command "
                f"({-1e3 * time.interval_95[1]:.3g} to {-1e3 * time.interval_95[0]:.3g}): their clocks are "
                "offset by that and the dead time, which is not known; record both on one clock, or join the "
                "loggers by a signal that both recorded at 1 kHz"
            )
            yield Finding("speed-before-command", sentence)
        if self.power is None:
            return
        p, each = self.power, self.power.apparent_resistances
        if p.least_kv * p.torque_constant > 1.0 + _KV_AGREES:
            sentence = (
                f"the fit takes Kv as {rpm(1 / p.torque_constant):.4g} rpm/V, but the logged supply current "
                f"and torque are possible only with {rpm(p.least_kv):.4g} rpm/V or more: measure Kv (speed "
                "over supply voltage without propeller) and state it as motor.kv; R changes as 1/Kv²"
            )
            yield Finding("kv-below-current", sentence)
        if max(each) > _CLIMBS * min(each):
            sentence = (
                "one resistance does not explain the lost power: over the square of the motor's current it "
                f"is {1e3 * each[0]:.0f} mΩ at the lowest load, {1e3 * min(each):.0f} mΩ at its least and "
                f"{1e3 * each[-1]:.0f} mΩ at the highest load, because iron, controller and a warm winding "
                "lose power too; an R from lost power counts at such loads only"
            )
            yield Finding("power-of-no-resistance", sentence)


def rpm(speed: float) -> float:
    """Return a speed [rad/s] in rpm, or a Kv [rad/s/V] in rpm/V."""
    return 30.0 / np.pi * speed


def stand_values(
    logs: Sequence[BenchLog], curves: StaticCurves, constant: float, calibration: float
) -> StandValues:
    """Return what fitted logs, each of one direction, give under a torque constant k_m [N·m/A].

    The `calibration` of the load cells has this standard error [1].
    """
    rows = []
    for fit in curves.fits:
        if fit.quantity == "no_load":
            continue
        speeds = curves.loaded[fit.direction].speed
        top = float(np.max(speeds) if fit.direction == "forward" else np.min(speeds))
        decade = 10.0 ** np.floor(np.log10(abs(top) / _ROUND))
        step = max(k * decade for k in (1.0, 2.0, 5.0) if k * decade <= abs(top) / _ROUND)
        shared = np.sign(top) * step * np.arange(1.0, 1.0 + np.floor(_FARTHER * abs(top) / step))
        for speed in sorted((*shared.tolist(), top), key=abs):
            value, error = fit.at(speed)
            half = _WIDE * float(np.hypot(error, calibration * value))
            ends = (value - half, value + half)
            rows.append(CurveValue(fit.quantity, fit.direction, speed, value, ends, speed != top))
    power = lost_power(SteadyPoints.join(list(curves.loaded.values())), constant)
    return StandValues(tuple(rows), power, step_times(logs), calibration)


def lost_power(points: SteadyPoints, constant: float) -> LostPower | None:
    """Return R and friction of the power that steady points lose, with k_m [N·m/A]; None where unknown."""
    flow, torque, speed = np.abs(points.current), np.abs(points.torque), np.abs(points.speed)
    lost = points.voltage * flow - torque * speed
    known = np.isfinite(lost) & (torque > 0.01 * np.nanmax(torque, initial=0.0)) & (lost > 0)
    if np.count_nonzero(known) < _FEWEST + 1:
        return None
    order = np.flatnonzero(known)[np.argsort(torque[known])]
    flow, torque, speed, lost = (each[order] for each in (flow, torque, speed, lost))
    motor = torque / constant
    columns = np.column_stack([motor**2, speed])
    (resistance, friction), _ = nnls(columns, lost)
    # Unlike loads break the law of two terms, so the scatter about it gives the error of R.
    residual = lost - columns @ [resistance, friction]
    spread = float(residual @ residual) / (lost.size - 2)
    half = _WIDE * float(np.sqrt(spread * np.linalg.inv(columns.T @ columns)[0, 0]))
    return LostPower(
        constant, float(resistance), (float(resistance) - half, float(resistance) + half), float(friction),
        float(np.max(flow / (torque + friction))), tuple(speed.tolist()), tuple((lost / motor**2).tolist()),
    )  # fmt: skip


def step_times(logs: Sequence[BenchLog]) -> dict[str, StepTime]:
    """Return ``time_constant_up``, ``time_constant_down`` and ``dead_time`` of the speed's steps.

    The interval comes from the scatter over the steps. Times of a single step are left out, and the dead time
    of logs without a command.
    """
    found: dict[str, list[float]] = {"time_constant_up": [], "time_constant_down": [], "dead_time": []}
    for log in logs:
        for start, before, after, share, time in _steps(log):
            fit = least_squares(
                lambda x, t, y: 1.0 - np.exp(-np.maximum(t - x[0], 0.0) / x[1]) - y,  # type: ignore[misc]
                [0.02, 0.04],
                bounds=([-0.1, 1e-3], [0.2, 1.0]),
                args=(time - start, share),
            )
            found["time_constant_up" if after > before else "time_constant_down"].append(float(fit.x[1]))
            if log.commanded:
                found["dead_time"].append(float(fit.x[0]))
    out = {}
    for name, values in found.items():
        if len(values) > 1:
            middle = float(np.median(values))
            scatter = float(np.median(np.abs(np.array(values) - middle))) / 0.6745
            # The median of normal values scatters by 1.25 of what their mean does.
            half = _WIDE * 1.2533 * scatter / float(np.sqrt(len(values)))
            out[name] = StepTime(middle, (middle - half, middle + half), len(values))
    return out


def _steps(log: BenchLog) -> Iterator[tuple[float, float, float, FloatArray, FloatArray]]:
    """Yield instant, speed before and after, and the share (n,) of the step that is done at times (n,)."""
    time, size = log.channels["speed"][0], np.abs(log.channels["speed"][1])
    top, level = float(size.max()), np.abs(log.steps.level)
    edges = np.append(log.steps.time, time[-1])
    for i, (start, end) in enumerate(itertools.pairwise(edges.tolist())):
        inside = log.window[0] < start and end < log.window[1] + 1e-9 and end - start > SETTLE + _AVERAGED
        if i == 0 or not inside or min(level[i], level[i - 1]) < AT_REST:
            continue
        earlier = (time > max(edges[i - 1] + SETTLE, start - _AVERAGED)) & (time < start - 0.01)
        later = (time > start + SETTLE) & (time < start + SETTLE + _AVERAGED)
        shown = (time > start - 0.05) & (time < start + SETTLE)
        if min(earlier.sum(), later.sum(), shown.sum()) < _FEWEST:
            continue
        before, after = float(size[earlier].mean()), float(size[later].mean())
        if abs(after - before) > _LEAST_STEP * top and min(before, after) > _LEAST_SPEED * top:
            yield start, before, after, (size[shown] - before) / (after - before), time[shown]
