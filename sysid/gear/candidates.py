"""Drops that could be recorded next, simulated as they would be compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.fit.nrmse import TrialTarget
from sysid.gear.capture_noise import compared_noise
from sysid.gear.drops import PreparedDrop
from sysid.gear.problem import TRUST_TOLERANCE, GearProblem
from sysid.types import FloatArray

# Drops that a lab can make.
SLOPES_DEG = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
SPEEDS = (0.4, 0.6, 0.8, 1.0)
# Where the rear foot lands, up-slope of the surface's point [m].
_FOOT_FROM_POINT = 0.3


def candidate_drops(problem: GearProblem, row: FloatArray) -> tuple[GearProblem, Sequence[str]] | None:
    """Return drops that could be made next at a row (n_table,) [SI], and what they are called.

    None where none of them can be simulated.
    """
    problem = replace(problem, tolerance=TRUST_TOLERANCE)
    drops, titles = [], []
    for slope in SLOPES_DEG:
        for speed in SPEEDS:
            drop = _candidate(problem, row, np.radians(slope), speed)
            if drop is not None:
                drops.append(drop)
                titles.append(f"a drop on {slope:g} deg at {speed:g} m/s")
    return (replace(problem, drops=tuple(drops)), titles) if drops else None


def _candidate(problem: GearProblem, row: FloatArray, slope: float, speed: float) -> PreparedDrop | None:
    """Return a drop as it would be recorded at the parameters `row`; None where it cannot be compared."""
    template, campaign = problem.drops[0], problem.campaign
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
    alone = replace(problem, drops=(drop,))
    samples, result = alone.simulate(row[None])
    _, causes = alone.judge_samples(np.nan_to_num(samples), result)
    if np.any(causes > 0) or np.any(result.reached < 1.0) or np.any(np.isfinite(result.flip)):
        return None
    clean = alone.cost.prepared(samples)[0][0]
    noise = compared_noise(template) * np.random.default_rng(1).standard_normal(clean.shape)
    return replace(drop, target=replace(blank, measured=clean + noise))
