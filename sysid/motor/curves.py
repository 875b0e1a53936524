"""Static curves of a motor campaign: from averaged logs, or from the steady stretches of its step logs."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sysid.campaign import MotorCampaign
from sysid.campaign.motor import MotorTrial as TrialEntry
from sysid.campaign.motor import StaticLog
from sysid.errors import FitError, LogError, SysidWarning
from sysid.motor.bench_logs import (
    STATED_SIGNS,
    BenchLog,
    bench_log,
    command_range,
    log_hashes,
    log_points,
    read_log,
)
from sysid.motor.static_curves import (
    OUTLIER,
    CurveFit,
    coefficient_correlation,
    fit_no_load_line,
    fit_speed_curve,
    soft_weights,
)
from sysid.trials.bench_log import signed_speed, tare
from sysid.trials.signs import sign_against_speed
from sysid.trials.steady import SETTLE, SteadyPoints
from sysid.types import FloatArray, Rotation

_ROTATIONS: tuple[Rotation, Rotation] = ("forward", "reverse")


@dataclass(frozen=True, eq=False)
class CurveLog:
    """A log under `[curves]` after it was read.

    Parameters
    ----------
    entry : StaticLog
        Of the campaign.
    table : {"static", "no_load"}
        Where it stands there.
    points : SteadyPoints
        Rows of averaged points, or steady stretches of steps.
    provenance : dict
        Its file, hash, format and what was noticed.
    """

    entry: StaticLog
    table: Literal["static", "no_load"]
    points: SteadyPoints
    provenance: dict[str, Any]

    @property
    def name(self) -> str:
        """How a result calls it; no trial is called so."""
        return f"{self.entry.log} (curves.{self.table}, {self.entry.direction})"

    @property
    def hashes(self) -> str:
        """SHA-256 of its file, and of the second one where there is one."""
        return log_hashes(self.provenance)


def read_curve_logs(campaign: MotorCampaign, path: str | Path) -> tuple[CurveLog, ...]:
    """Read every log that the campaign names under `[curves]`.

    Raises
    ------
    SysidError
        For the first one that cannot be read, or holds no steady point.
    """
    curves = campaign.curves
    return (
        *(_curve_log(campaign, path, entry, "static") for entry in curves.static),
        *(_curve_log(campaign, path, entry, "no_load") for entry in curves.no_load),
    )


def _curve_log(
    campaign: MotorCampaign, path: str | Path, static: StaticLog, table: Literal["static", "no_load"]
) -> CurveLog:
    """Return a log with its points: rows of averaged points, or steady stretches of steps."""
    file, direction = read_log(campaign, path, static), static.direction
    recording = file.recording
    if recording.kind != "static-map":
        entry = TrialEntry(
            name=Path(static.log).name, log=static.log, direction=direction,
            log_options=static.log_options, second_log=static.second_log,
        )  # fmt: skip
        points = log_points(bench_log(campaign, path, entry))
    else:
        where = recording.provenance.path
        command = recording["command"]
        u = command_range(campaign).to_u(command.values, command.unit, where)
        speed = signed_speed(recording["speed"].values, direction, where)
        rest = (np.abs(u) < 1e-9) & (np.nan_to_num(speed) == 0)
        turning = np.nan_to_num(speed) != 0
        columns, zeros = {}, {}
        for name in ("thrust", "torque", "voltage"):
            values = recording[name].values if name in recording.channels else np.full(u.size, np.nan)
            zero = tare(values, rest)
            # A supply that reads 0 was not measured.
            volts = np.where(np.nan_to_num(values) > 0, values, np.nan)
            columns[name] = volts if name == "voltage" else values - zero.value
            zeros[name] = np.full(int(turning.sum()), zero.rows, dtype=np.int64)
        for name, stated in (("thrust", campaign.log.thrust_sign), ("torque", campaign.log.torque_sign)):
            seen = sign_against_speed(columns[name][turning], speed[turning]) or 1
            columns[name] = columns[name] * STATED_SIGNS.get(stated, seen)
        points = SteadyPoints(
            u[turning], speed[turning], columns["thrust"][turning], columns["torque"][turning],
            columns["voltage"][turning], np.ones(int(turning.sum()), dtype=np.int64),
            zeros["thrust"], zeros["torque"],
        )  # fmt: skip
    if len(points) == 0:
        raise LogError(
            f"{recording.provenance.path}: no steady segment; hold each command for over {SETTLE:g} s, "
            "or ramp from rest to full in 20 s or more"
        )
    said = recording.provenance
    provenance = {
        "log": Path(said.path).name,
        "sha256": said.sha256,
        "format": said.format,
        "device": said.device,
        "direction": direction,
        "steady points": len(points),
        **({} if file.second is None else {"second log": file.second}),
        "notes": said.sentences,
    }
    return CurveLog(static, table, points, provenance)


@dataclass(frozen=True, eq=False)
class NoLoadTie:
    """No-load line of loaded steady points, which moves with R: Ω_0 = Ω + R (τ + k_d Ω)/(k_m k_v).

    Parameters
    ----------
    columns : (n, 2) array
        u and sign(u) of the points, times V/V_ref.
    points : (n, 2) array
        Their loaded speed Ω [rad/s] and drag τ [N·m].

    Notes
    -----
    A point far from the others (a speed probe that missed a blade, a stand that settled late) loses weight as
    in the other curves. The soft-L1 weights are found once, about a parabola of Ω over u, so that the line
    stays linear in R/(k_m k_v) and a candidate of the search costs one product.
    """

    columns: FloatArray
    points: FloatArray

    @cached_property
    def weights(self) -> FloatArray:
        """(n,) soft-L1 weights of the points [1]."""
        # The drag bends Ω(u) about like u|u|. A misread speed has a misread drag, which may not judge it.
        u, sign = self.columns.T
        return soft_weights(np.column_stack([u, sign, u * u / sign]), self.points[:, 0])

    @cached_property
    def speed(self) -> FloatArray:
        """(2,) slope and intercept of the weighted least-squares line of Ω over u, at V_ref [rad/s]."""
        return self._line(self.points[:, 0])

    @cached_property
    def torque(self) -> FloatArray:
        """(2,) the same of τ [N·m]."""
        return self._line(self.points[:, 1])

    def _line(self, values: FloatArray) -> FloatArray:
        root = np.sqrt(self.weights)
        return np.asarray(np.linalg.lstsq(root[:, None] * self.columns, root * values, rcond=None)[0])

    def _lifted(self, drop: float, damping: float) -> FloatArray:
        """Return Ω_0 (n,) of the points [rad/s]."""
        speed, torque = self.points.T
        return np.asarray(speed + drop * (torque + damping * speed), dtype=np.float64)

    def line(self, drop: FloatArray, damping: FloatArray) -> FloatArray:
        """Return slope and intercept (P, 2) of Ω_0 for R/(k_m k_v) (P,) [rad/s per N·m] and k_d (P,)."""
        loaded = (1.0 + drop * damping)[:, None] * self.speed
        return np.asarray(loaded + drop[:, None] * self.torque, dtype=np.float64)

    def fit(self, direction: Rotation, drop: float, damping: float) -> CurveFit:
        """Return the line at one R/(k_m k_v) and k_d, and how well the points lie on it.

        The standard errors are those of the points; an error of R moves all points together and is not in
        them.
        """
        line = self.line(np.array([drop]), np.array([damping]))[0]
        lifted = self._lifted(drop, damping)
        residual = lifted - self.columns @ line
        sigma = max(float(np.median(np.abs(residual))) / 0.6745, 1e-9 * float(np.max(np.abs(lifted))))
        near = np.abs(residual) <= OUTLIER * sigma
        total = float(np.sum((lifted[near] - lifted[near].mean()) ** 2))
        # Outliers pull by their weight alone: what the others scatter is the error.
        weight = np.where(near, self.weights, 0.0)
        spread = float(weight @ residual**2) / max(float(weight.sum()) - 2.0, 1.0)
        information = np.asarray(
            np.linalg.inv(self.columns.T @ (self.weights[:, None] * self.columns)), dtype=np.float64
        )
        errors = np.sqrt(np.diag(spread * information))
        return CurveFit(
            "no_load", direction, (float(line[0]), float(line[1])), (float(errors[0]), float(errors[1])),
            ("rad/s", "rad/s"),
            1.0 - float(np.sum(residual[near] ** 2)) / total if total > 0 else float("nan"),
            residual.size, int(np.count_nonzero(~near)), coefficient_correlation(information),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class StaticCurves:
    """Curves of the campaign by direction.

    Parameters
    ----------
    fits : tuple of CurveFit
    ties : dict of direction to NoLoadTie
        Where Ω_0 comes from loaded points.
    reference_voltage : float
        V_ref [V].
    loaded : dict of direction to SteadyPoints
        What thrust, torque and loaded speed were read from.
    logs : tuple of CurveLog
        Those that the campaign names under `[curves]`.
    """

    fits: tuple[CurveFit, ...]
    ties: dict[Rotation, NoLoadTie]
    reference_voltage: float
    loaded: dict[str, SteadyPoints]
    logs: tuple[CurveLog, ...] = ()

    @property
    def parameters(self) -> dict[str, float]:
        """Coefficients by parameter name [SI]."""
        return {name: value for fit in self.fits for name, value in fit.parameters.items()}


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
    turning = {t.direction for t in campaign.trials}
    wanted = [d for d in _ROTATIONS if d in turning or "reversal" in turning]
    own = SteadyPoints.join([log_points(log) for log in logs]) if logs else None
    fits: list[CurveFit] = []
    ties: dict[Rotation, NoLoadTie] = {}
    loaded: dict[str, SteadyPoints] = {}
    for direction in wanted:
        named, bare = (
            [log for log in curve_logs if log.table == table and log.entry.direction == direction]
            for table in ("static", "no_load")
        )
        points = SteadyPoints.join([log.points for log in named]) if named else own
        if points is None:
            raise FitError(
                f"no log with steady points in the {direction} direction; name one in curves.static"
            )
        source = ", ".join([log.entry.log for log in named] or [f"{log.where}" for log in logs])
        turns = (points.speed > 0) if direction == "forward" else (points.speed < 0)
        if not turns.any():
            raise LogError(
                f"{source}: no steady segment in the {direction} direction; hold each command for over "
                f"{SETTLE:g} s, ramp from rest to full in 20 s or more, or name another log in curves.static"
            )
        loaded[direction] = points
        zero = int(min(points.torque_zero, default=0))
        with _of_logs(source):
            torque = fit_speed_curve("torque", direction, points.speed, points.torque, zero_rows=zero)
        fits.append(torque)
        if np.isfinite(points.thrust).any():
            zero = int(min(points.thrust_zero, default=0))
            with _of_logs(source):
                fits.append(fit_speed_curve("thrust", direction, points.speed, points.thrust, zero_rows=zero))
        else:
            warnings.warn(
                f"no thrust in the {direction} direction: its curve keeps the default, which is a guess",
                SysidWarning,
                stacklevel=2,
            )
        if bare:
            free = SteadyPoints.join([log.points for log in bare])
            ratio = np.where(np.isfinite(free.voltage), free.voltage / reference_voltage, 1.0)
            with _of_logs(", ".join(log.entry.log for log in bare)):
                fits.append(fit_no_load_line(direction, free.u, free.speed, supply_ratio=ratio))
        else:
            with _of_logs(source):
                ties[direction] = _tie(direction, points, torque, reference_voltage)
    return StaticCurves(tuple(fits), ties, reference_voltage, loaded, tuple(curve_logs))


@contextmanager
def _of_logs(source: str) -> Iterator[None]:
    """Put the logs' names before a complaint about their points."""
    try:
        yield
    except FitError as error:
        raise FitError(f"{source}: {error}") from None


def _tie(direction: Rotation, points: SteadyPoints, torque: CurveFit, reference_voltage: float) -> NoLoadTie:
    keep = (points.u > 0) if direction == "forward" else (points.u < 0)
    u, speed = points.u[keep], points.speed[keep]
    ratio = np.where(np.isfinite(points.voltage[keep]), points.voltage[keep] / reference_voltage, 1.0)
    drag = torque.coefficients[0] * speed * np.abs(speed) + torque.coefficients[1] * speed
    columns = np.column_stack([u, np.sign(u)]) * ratio[:, None]
    if np.unique(u).size < 3:
        raise FitError(
            f"no-load speed, {direction}: steady points at {np.unique(u).size} different commands; expected "
            "at least 3, or a log without propeller under curves.no_load"
        )
    return NoLoadTie(columns, np.column_stack([speed, drag]))
