"""What a campaign of drops is expected to fix, and which drop to record next."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.campaign import GearCampaign
from sysid.errors import SysidWarning
from sysid.fit.nrmse import TrialTarget
from sysid.gear.drops import PreparedDrop
from sysid.gear.problem import GearObjective
from sysid.gear.trust import TRUST_TOLERANCE, GearProblem, compared_noise, noise_signals
from sysid.trials.fall import Feet, SlopedPlane
from sysid.trust.linearized import NoiseModel, noise_model
from sysid.trust.problem import Block
from sysid.trust.sensitivity import Candidate, Outlook, rank_candidates
from sysid.types import BoolArray, FloatArray

# Drops that a lab can make.
SLOPES_DEG = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
SPEEDS = (0.4, 0.6, 0.8, 1.0)
# Where the rear foot lands, up-slope of the surface's point [m].
_FOOT_FROM_POINT = 0.3
# A flight phase tells the centre of mass from so many samples on, feet so far above the surface [m].
_LEAST_FLIGHT, _CLEAR = 8, 4e-3
# An offset is worth a word beyond so many standard errors and this length [m].
_SURE, _FAR = 4.0, 3e-3


def capture_noise(problem: GearProblem) -> NoiseModel:
    """Return the correlations of the capture's noise as compared, by filtering noise as the log was."""
    drop = problem.objective.drops[0]
    signals = noise_signals(drop, 0)
    used = sorted({block.channel for block in problem.blocks})
    n = len(signals)
    blocks = [Block(0, c, k * n, (k + 1) * n, n, 1.0, 1.0, 1.0) for k, c in enumerate(used)]
    model = noise_model(blocks, np.concatenate([signals[:, c] for c in used]))
    shortest = min(block.stop - block.start for block in problem.blocks)
    return NoiseModel(model.channels, model.covariance[:, :, : max(2, shortest // 3)])


def suggest_drops(
    campaign: GearCampaign, problem: GearProblem, here: Outlook, noise: NoiseModel, weak: BoolArray
) -> tuple[Candidate, ...]:
    """Simulate drops that could be made next and rank them by what they add, the best first."""
    row = problem.space.full(here.point[None])[0]
    drops, titles = [], []
    for slope in SLOPES_DEG:
        for speed in SPEEDS:
            made = _candidate(problem, campaign, row, np.radians(slope), speed)
            if made is not None:
                drops.append(made)
                titles.append(f"a drop on {slope:g} deg at {speed:g} m/s")
    if not drops:
        return ()
    objective = problem.objective
    others = GearProblem(
        GearObjective.build(campaign, problem.space, tuple(drops), objective.threads, TRUST_TOLERANCE)
    )
    return rank_candidates(problem, here, noise, others, tuple(titles), weak)


def _candidate(
    problem: GearProblem, campaign: GearCampaign, row: FloatArray, slope: float, speed: float
) -> PreparedDrop | None:
    """Return a drop as it would be recorded at the parameters `row`; None where it cannot be compared."""
    template = problem.objective.drops[0]
    gravity, feet = campaign.vehicle.gravity, campaign.vehicle
    rate = template.motion.rate
    fall = min(campaign.window.before_contact, speed / gravity)
    foot_x = -_FOOT_FROM_POINT * np.cos(slope)
    start = np.zeros(6)
    start[0] = foot_x + feet.foot_dx
    start[1] = -foot_x * np.tan(slope) + feet.foot_dz + speed * fall - gravity * fall**2 / 2
    start[4] = -(speed - gravity * fall)
    window = round((fall + campaign.window.after_contact) * rate)
    extra = len(template.simulated_time) - len(template.time)
    time = template.time[0] + np.arange(window + extra) / rate
    back = np.arange(len(template.before), 0, -1) / rate
    before = np.tile(start[:3], (len(back), 1))
    before[:, 1] -= start[4] * back + gravity * back**2 / 2
    blank = TrialTarget(
        "candidate", np.random.default_rng(0).standard_normal((window, 5)), np.ones(window, dtype=np.bool_),
        template.target.rate, template.target.taps, None,
    )  # fmt: skip
    drop = replace(
        template, name=f"{np.degrees(slope):g} deg, {speed:g} m/s", slope=float(slope),
        touchdown=float(time[0] + fall), impact_speed=speed, time=time[:window], initial_state=start,
        simulated_time=time, before=before, target=blank,
    )  # fmt: skip
    objective = GearObjective.build(
        campaign, problem.space, (drop,), problem.objective.threads, TRUST_TOLERANCE
    )  # fmt: skip
    samples, result = objective.simulate(row[None])
    _, causes = objective.judge_samples(np.nan_to_num(samples), result)
    if np.any(causes > 0) or np.any(result.reached < 1.0) or np.any(np.isfinite(result.flip)):
        return None
    clean = objective.cost.prepared(samples)[0][0]
    noise = compared_noise(template) * np.random.default_rng(1).standard_normal(clean.shape)
    return replace(drop, target=replace(blank, measured=clean + noise))


FlightPhase = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def centre_of_mass(drops: tuple[PreparedDrop, ...], campaign: GearCampaign) -> dict[str, float] | None:
    """Return how far from the stated centre of mass the body turns in flight [m], with errors; warn where
    sure.

    Down-slope and up in the body while it hangs level. None where it flew too little after a contact. Flights
    of some 50 ms tell it to centimetres only: what they look like is then mostly a start's velocity.
    """
    feet = Feet(campaign.vehicle.foot_dx, campaign.vehicle.foot_dz)
    flights = [part for drop in drops for part in _flights(drop, feet)]
    noise = max(float(np.max(drop.flight.noise[:2])) for drop in drops)
    if sum(len(part[0]) for part in flights) < 4 * _LEAST_FLIGHT:
        return None
    offset, error = turning_point(flights, campaign.vehicle.gravity, noise)
    for name, value, sigma in zip(("down-slope", "up"), offset, error, strict=True):
        if abs(value) > max(_SURE * sigma, _FAR):
            warnings.warn(
                f"in free flight the body turns about a point {1000 * value:.1f} ± {1000 * sigma:.1f} mm off "
                f"the stated centre of mass ({name}); check capture.centre_of_mass_offset",
                SysidWarning,
                stacklevel=2,
            )
    return {
        "down_slope [m]": float(offset[0]), "down_slope error [m]": float(error[0]),
        "up [m]": float(offset[1]), "up error [m]": float(error[1]),
    }  # fmt: skip


def turning_point(
    flights: Sequence[FlightPhase], gravity: float, noise: float
) -> tuple[FloatArray, FloatArray]:
    """Return where in the body the point lies that moves on parabolas (2,), and the standard errors (2,) [m].

    Parameters
    ----------
    flights : sequence of (time, x, z, pitch)
        Of a point of the body [s, m, m, rad].
    gravity : float
        [m/s²]
    noise : float
        Standard deviation of the positions [m].

    Notes
    -----
    A point at d from the centre of mass moves as ``c(t) + d_x ex(q) + d_z ez(q)``; c is linear in time but
    for the fall. What is linear in time is taken out of both sides first. The result points from the tracked
    point to the centre of mass.
    """
    rows, values = [], []
    for time, x, z, q in flights:
        since = time - time.mean()
        basis, _ = np.linalg.qr(np.vander(since, 2, increasing=True))
        for signal, columns in (
            (x, np.column_stack([np.cos(q), np.sin(q)])),
            (z + gravity * since**2 / 2, np.column_stack([-np.sin(q), np.cos(q)])),
        ):
            both = np.column_stack([columns, signal])
            left = both - basis @ (basis.T @ both)
            rows.append(left[:, :2])
            values.append(left[:, 2])
    design, target = np.concatenate(rows), np.concatenate(values)
    found, *_ = np.linalg.lstsq(design, target, rcond=None)
    rest = float(np.sqrt(np.mean((target - design @ found) ** 2)))
    error = max(noise, rest) * np.sqrt(np.diag(np.linalg.pinv(design.T @ design)))
    return -found, np.asarray(error)


def _flights(drop: PreparedDrop, feet: Feet) -> list[FlightPhase]:
    """Return (time, x, z, pitch) of the flights after the first contact in which the body turns."""
    motion = drop.motion
    inside = (motion.time > drop.touchdown + 0.02) & (motion.time < drop.time[-1]) & motion.valid
    clear = feet.clearances(SlopedPlane(drop.slope), motion.x, motion.z, motion.pitch).min(axis=1)
    free = inside & (np.nan_to_num(clear, nan=-1.0) > _CLEAR)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], free.astype(np.int8), [0]])))
    out = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if last - first >= _LEAST_FLIGHT:
            part = slice(first, last)
            out.append((motion.time[part], motion.x[part], motion.z[part], motion.pitch[part]))
    return out


def excitation(problem: GearProblem) -> dict[str, object]:
    """Return what the drops excite: slopes [deg], impact speeds [m/s], largest pitch rate [rad/s]."""
    drops = problem.objective.drops
    slopes = [float(np.degrees(drop.slope)) for drop in drops]
    speeds = [drop.impact_speed for drop in drops]
    turn = [float(np.nanmax(np.abs(np.gradient(d.target.measured[:, 4], 1 / d.motion.rate)))) for d in drops]
    return {
        "slope_deg": [min(slopes), max(slopes)],
        "impact_speed": [min(speeds), max(speeds)],
        "pitch_rate": [min(turn), max(turn)],
    }
