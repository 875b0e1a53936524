"""What a campaign of drops is expected to fix, and which drop to record next."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sysid.campaign import GearCampaign
from sysid.errors import SysidWarning
from sysid.fit.cost import TrialTarget
from sysid.pipelines.drops import PreparedDrop
from sysid.pipelines.gear import GearObjective
from sysid.pipelines.trust_gear import TRUST_TOLERANCE, GearProblem, compared_noise, noise_signals
from sysid.trials.drop import Feet, SlopedPlane
from sysid.trust.fisher import NoiseModel, noise_model
from sysid.trust.problem import Block
from sysid.trust.sensitivity import Candidate, Outlook, rank_candidates

FloatArray = NDArray[np.float64]

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
    campaign: GearCampaign, problem: GearProblem, here: Outlook, noise: NoiseModel, weak: NDArray[np.bool_]
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


def warn_of_centre_of_mass(drops: tuple[PreparedDrop, ...], campaign: GearCampaign) -> None:
    """Warn where the free flights between contacts say that the body turns about another point.

    In flight the centre of mass moves on a parabola; a point beside it circles it while the body turns.
    """
    rows, values, weights = [], [], []
    feet = Feet(campaign.vehicle.foot_dx, campaign.vehicle.foot_dz)
    for drop in drops:
        for part in _flights(drop, feet):
            time, x, z, q = part
            polynomial = np.vander(time - time.mean(), 2, increasing=True)
            fall = campaign.vehicle.gravity * (time - time.mean()) ** 2 / 2
            # A point at (dx, dz) in the body is at dx ex(q) + dz ez(q).
            for signal, columns, sigma in (
                (x, np.column_stack([np.cos(q), np.sin(q)]), drop.flight.noise[0]),
                (z + fall, np.column_stack([-np.sin(q), np.cos(q)]), drop.flight.noise[1]),
            ):
                both = np.column_stack([columns, signal])
                basis, _ = np.linalg.qr(polynomial)
                left = both - basis @ (basis.T @ both)
                rows.append(left[:, :2] / sigma)
                values.append(left[:, 2] / sigma)
                weights.append(len(time))
    if not rows or sum(weights) < 4 * _LEAST_FLIGHT:
        return
    design, target = np.concatenate(rows), np.concatenate(values)
    offset, *_ = np.linalg.lstsq(design, target, rcond=None)
    rest = target - design @ offset
    inverse = np.linalg.pinv(design.T @ design)
    error = np.sqrt(np.diag(inverse) * max(1.0, float(np.mean(rest**2))))
    for name, value, sigma in zip(("down-slope", "up"), offset, error, strict=True):
        if abs(value) > max(_SURE * sigma, _FAR):
            warnings.warn(
                f"in free flight the body turns about a point {1000 * value:.1f} ± {1000 * sigma:.1f} mm "
                f"off the "
                f"stated centre of mass ({name}); check capture.centre_of_mass_offset",
                SysidWarning,
                stacklevel=2,
            )


def _flights(drop: PreparedDrop, feet: Feet) -> list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
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
