"""Static curves of a motor campaign: from averaged logs, or from the steady stretches of its step logs."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from sysid.campaign import MotorCampaign, MotorTrial
from sysid.campaign.motor import StaticLog
from sysid.errors import FitError, LogError
from sysid.journal import Finding, notice
from sysid.motor.bench_logs import STATED_SIGNS, BenchLog, bench_log, campaign_range, log_points, read_log
from sysid.motor.static_curves import (
    CurveFit,
    NoLoadTie,
    fit_no_load_line,
    fit_speed_curve,
    no_load_line,
    turns,
)
from sysid.recording import Recording
from sysid.trials.bench_log import check_command_direction, signed_speed, tare
from sysid.trials.steady import SETTLE, SteadyPoints, sign_against_speed
from sysid.types import FloatArray, Rotation

# Distance of steady levels from a straight line over the command, over the top speed, beyond which the
# levels themselves are the supply law [1]: a line within it costs an NRMSE of 3 % at most.
_BENT = 0.01
# Torques of a log without propeller and of a log with one, over those of the trials at the same speed [1].
_BARE, _LEAST_LOADED, _MOST_LOADED = 0.3, 0.5, 2.0
_ROTATIONS: tuple[Rotation, Rotation] = ("forward", "reverse")


@dataclass(frozen=True, eq=False)
class CurveLog:
    """A log under `[curves]` after it was read; `provenance` is what a result states of it."""

    entry: StaticLog
    table: Literal["static", "no_load"]
    points: SteadyPoints
    provenance: dict[str, object]
    # Findings of the log's reader.
    notes: tuple[Finding, ...]
    # Whether its commands were logged; else they are shares of its largest speed.
    commanded: bool = True

    @property
    def name(self) -> str:
        """The name in a result; no trial has such a name."""
        return f"curves.{self.table}.{self.entry.direction}/{self.entry.log}"


def read_curve_logs(campaign: MotorCampaign, path: str | Path) -> tuple[CurveLog, ...]:
    """Read every log that the campaign names under `[curves]`; refuse those without a steady point."""
    curves = campaign.curves
    return (
        *(_curve_log(campaign, path, entry, "static") for entry in curves.static),
        *(_curve_log(campaign, path, entry, "no_load") for entry in curves.no_load),
    )


def _curve_log(
    campaign: MotorCampaign, path: str | Path, static: StaticLog, table: Literal["static", "no_load"]
) -> CurveLog:
    """Return a log with its points: rows of an averaged log, or steady stretches of steps."""
    recording, second = read_log(campaign, path, static)
    commanded = True
    if recording.kind == "static-map":
        points = _rows_as_points(campaign, recording, static.direction)
    else:
        entry = MotorTrial(
            name=Path(static.log).name, log=static.log, direction=static.direction,
            log_options=static.log_options, second_log=static.second_log,
        )  # fmt: skip
        log = bench_log(campaign, path, entry)
        points, commanded = log_points(log), log.commanded
    if len(points) == 0:
        raise LogError(
            f"{recording.provenance.path}: no steady segment; hold each command for over {SETTLE:g} s, "
            "or ramp from rest to full in 20 s or more"
        )
    provenance = {
        **recording.provenance.source,
        "direction": static.direction,
        "steady_points": len(points),
        **({} if second is None else {"second_log": second}),
        "notes": recording.provenance.sentences,
    }
    return CurveLog(static, table, points, provenance, recording.provenance.notes, commanded)


def _rows_as_points(campaign: MotorCampaign, recording: Recording, direction: Rotation) -> SteadyPoints:
    """Return the rows of an averaged log that turn, tare subtracted and signs settled."""
    where = str(recording.provenance.path)
    command = recording["command"]
    u = campaign_range(campaign).to_u(command.values, command.unit, where)
    check_command_direction(u, direction, where)
    speed = signed_speed(recording["speed"].values, direction, where)
    turning = np.nan_to_num(speed) != 0
    rest = (np.abs(u) < 1e-9) & ~turning
    columns, zeros = {}, {}
    for name in ("thrust", "torque", "voltage", "current"):
        values = recording[name].values if name in recording.channels else np.full(u.size, np.nan)
        zero = tare(values, rest)
        # A supply that reads 0 was not measured.
        volts = np.where(np.nan_to_num(values) > 0, values, np.nan)
        columns[name] = (volts if name == "voltage" else values - zero.value)[turning]
        zeros[name] = np.full(int(turning.sum()), zero.rows, dtype=np.int64)
    for name, stated in (("thrust", campaign.log.thrust_sign), ("torque", campaign.log.torque_sign)):
        seen = sign_against_speed(columns[name], speed[turning]) or 1
        columns[name] = columns[name] * STATED_SIGNS.get(stated, seen)
    return SteadyPoints(
        u[turning], speed[turning], columns["thrust"], columns["torque"], columns["voltage"],
        columns["current"], np.ones(int(turning.sum()), dtype=np.int64), zeros["thrust"], zeros["torque"],
    )  # fmt: skip


def supply_ratio(points: SteadyPoints, reference_voltage: float) -> FloatArray:
    """Return V/V_ref (n,) [1] of steady points; 1 where the voltage is not known."""
    return np.where(np.isfinite(points.voltage), points.voltage / reference_voltage, 1.0)


@dataclass(frozen=True, eq=False)
class StaticCurves:
    """Curves of the campaign by direction.

    `ties` are the no-load lines that come from loaded points, `loaded` the points behind thrust, torque and
    loaded speed; V_ref is in [V]. In the directions of `maps` the steady levels of the ties replace their
    straight line.
    """

    fits: tuple[CurveFit, ...]
    ties: dict[Rotation, NoLoadTie]
    reference_voltage: float
    loaded: dict[Rotation, SteadyPoints]
    logs: tuple[CurveLog, ...] = ()
    maps: tuple[Rotation, ...] = ()

    @property
    def parameters(self) -> dict[str, float]:
        """Coefficients by parameter name [SI]."""
        return {name: value for fit in self.fits for name, value in fit.parameters.items()}

    def mapped(self, u: FloatArray) -> FloatArray:
        """Return loaded speed [rad/s] and drag [N·m] (m, 2) of commands u (m,); NaN where a line serves."""
        out = np.full((u.size, 2), np.nan)
        for direction in self.maps:
            here = turns(u, direction)
            out[here] = self.ties[direction].mapped(u[here])
        return out


def static_curves(
    campaign: MotorCampaign,
    curve_logs: Sequence[CurveLog],
    logs: Sequence[BenchLog],
    reference_voltage: float,
) -> StaticCurves:
    """Fit the curves of every direction that the campaign's trials turn.

    Points come from `curves.static`; without any in a direction, from the steady stretches of the trials
    that are fitted. Ω_0 comes from `curves.no_load`, or from the loaded points, tied to R.
    """
    turning = {trial.direction for trial in campaign.trials}
    fits: list[CurveFit] = []
    ties: dict[Rotation, NoLoadTie] = {}
    loaded: dict[Rotation, SteadyPoints] = {}
    for direction in _ROTATIONS:
        if not turning & {direction, "reversal"}:
            continue
        _check_propeller(direction, curve_logs, logs)
        points, source = _loaded_points(direction, curve_logs, logs)
        loaded[direction] = points
        bare = _named(curve_logs, "no_load", direction)
        with _of_logs(source):
            zero = int(min(points.torque_zero, default=0))
            drift = {
                name: max((log.tares[name].error for log in logs if name in log.tares), default=0.0)
                for name in ("torque", "thrust")
                if not _named(curve_logs, "static", direction)
            }
            torque = fit_speed_curve(
                "torque", direction, points.speed, points.torque,
                zero_rows=zero, zero_error=float(np.nan_to_num(drift.get("torque", 0.0))),
            )  # fmt: skip
            fits.append(torque)
            if np.isfinite(points.thrust).any():
                zero = int(min(points.thrust_zero, default=0))
                fits.append(
                    fit_speed_curve(
                        "thrust", direction, points.speed, points.thrust,
                        zero_rows=zero, zero_error=float(np.nan_to_num(drift.get("thrust", 0.0))),
                    )
                )  # fmt: skip
            else:
                notice(
                    "no-thrust-curve",
                    f"no thrust in the {direction} direction: its curve keeps the default, which is a guess",
                )
            if not bare:
                standing = max((log.standing for log in logs), default=0.0)
                ties[direction] = _tie(direction, points, torque, reference_voltage, standing)
        if bare:
            free = SteadyPoints.join([log.points for log in bare])
            ratio = supply_ratio(free, reference_voltage)
            with _of_logs(", ".join(log.entry.log for log in bare)):
                fits.append(fit_no_load_line(direction, free.u, free.speed, supply_ratio=ratio))
    # A no-load line that the campaign fixes or frees is the law.
    chosen = {*campaign.parameters.fixed, *(campaign.parameters.free or ())}
    maps = tuple(d for d, tie in ties.items() if tie.misfit > _BENT and not {*no_load_line(d)} & chosen)
    return StaticCurves(tuple(fits), ties, reference_voltage, loaded, tuple(curve_logs), maps)


def _named(curve_logs: Sequence[CurveLog], table: str, direction: Rotation) -> list[CurveLog]:
    return [log for log in curve_logs if log.table == table and log.entry.direction == direction]


def _check_propeller(direction: Rotation, curve_logs: Sequence[CurveLog], logs: Sequence[BenchLog]) -> None:
    """Refuse a loaded log whose torque is not that of most, and a bare one with a propeller.

    Thrust is not fitted to trials, so another thrust than that of most is a warning.
    """
    static, bare = (_named(curve_logs, table, direction) for table in ("static", "no_load"))
    curves = {log.entry.log: f"{log.entry.log}, named under curves.static, {direction}" for log in static}
    loaded = [(log.where, log.name, log_points(log)) for log in logs]
    loaded += [(curves[log.entry.log], log.entry.log, log.points) for log in static]
    for quantity in ("torque", "thrust"):
        # A trial whose torque shows nothing is refused elsewhere.
        seen = [
            (where, name, load)
            for where, name, points in loaded
            if (load := _load(quantity, direction, points)) > 0 or (name in curves and np.isfinite(load))
        ]
        alike = {
            load: [name for _, name, other in seen if _LEAST_LOADED <= other / load <= _MOST_LOADED]
            for *_, load in seen
            if load > 0
        }
        if not alike:
            continue
        usual = max(alike, key=lambda load: len(alike[load]))
        said = f"that of {', '.join(alike[usual])} at the same speed"
        unit = f"correct the unit of {quantity} or speed in one of these logs"
        for where, name, load in seen:
            if name not in alike[usual]:
                differs = f"{where}: its {quantity} is {load / usual:.3g} times {said}"
                if quantity == "thrust":
                    notice("implausible-power", f"{differs}: {unit}")
                    continue
                bared = load < _BARE * usual and name in curves
                step = "name it under curves.no_load" if bared else "name the log of that propeller"
                raise LogError(f"{differs}; expected a log with the same propeller: {step}, or {unit}")
        for log in bare if quantity == "torque" else []:
            if (share := _load(quantity, direction, log.points) / usual) > _BARE:
                raise LogError(
                    f"{log.entry.log}, named under curves.no_load, {direction}: its torque is {share:.3g} "
                    f"times {said}; expected a log without propeller: name it under curves.static, or {unit}"
                )


def _load(quantity: str, direction: Rotation, points: SteadyPoints) -> float:
    """Return the median of torque or thrust over Ω|Ω|, in SI, in the faster half of the points, or NaN."""
    values = getattr(points, quantity)
    here = turns(points.speed, direction) & np.isfinite(values)
    speed, values = points.speed[here], values[here]
    fast = np.abs(speed) > 0.5 * np.max(np.abs(speed), initial=0.0)
    return float(np.median(values[fast] / (speed[fast] * np.abs(speed[fast])))) if fast.any() else np.nan


def _loaded_points(
    direction: Rotation, curve_logs: Sequence[CurveLog], logs: Sequence[BenchLog]
) -> tuple[SteadyPoints, str]:
    """Return the loaded steady points of a direction, and the logs that they come from."""
    named = _named(curve_logs, "static", direction)
    if not named and not logs:
        raise FitError(f"no log with steady points in the {direction} direction; name one in curves.static")
    parts = [log.points for log in named] or [log_points(log) for log in logs]
    points = SteadyPoints.join(parts)
    source = ", ".join([log.entry.log for log in named] or [log.where for log in logs])
    if not turns(points.speed, direction).any():
        raise LogError(
            f"{source}: no steady segment in the {direction} direction; hold each command for over "
            f"{SETTLE:g} s, ramp from rest to full in 20 s or more, or name another log in curves.static"
        )
    return points, source


@contextmanager
def _of_logs(source: str) -> Iterator[None]:
    """Put the logs' names before a refusal of their points."""
    try:
        yield
    except FitError as error:
        raise FitError(f"{source}: {error}") from None


def _tie(
    direction: Rotation, points: SteadyPoints, torque: CurveFit, reference_voltage: float, standing: float
) -> NoLoadTie:
    keep = turns(points.u, direction)
    u, speed = points.u[keep], points.speed[keep]
    ratio = supply_ratio(points, reference_voltage)[keep]
    drag = torque.coefficients[0] * speed * np.abs(speed) + torque.coefficients[1] * speed
    columns = np.column_stack([u, np.sign(u)]) * ratio[:, None]
    if np.unique(u).size < 3:
        raise FitError(
            f"no-load speed, {direction}: steady points at {np.unique(u).size} different commands; expected "
            "at least 3, or a log without propeller under curves.no_load"
        )
    return NoLoadTie(columns, np.column_stack([speed, drag]), standing)
