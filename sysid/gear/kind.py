"""Landing gears as a kind of model: opening a campaign of drops, and what follows its fit."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from sysid.campaign import GearCampaign
from sysid.fit.kind import Course, FitOutcome, Kind, Term, Words
from sysid.fit.nrmse import TrialTarget
from sysid.gear.drops import PreparedDrop, prepare_drops
from sysid.gear.model import PARAMETERS
from sysid.gear.out_of_plane import misfit_that_leans, notice_out_of_plane
from sysid.gear.problem import (
    CONSTANTS,
    TRUST_TOLERANCE,
    GearProblem,
    gear_space,
    on_surface,
    prepare_kernel,
    reaches,
)
from sysid.gear.starts import compared_noise
from sysid.gear.story import GearStory
from sysid.journal import notice, tell
from sysid.parameter_sets import ParameterRecord, parameter_records
from sysid.types import FloatArray

_DERIVED = tuple(
    ParameterRecord(name, symbol, unit, "derived", meaning, "Table II, note a")
    for name, symbol, unit, meaning in (
        ("leg_length", "l", "m", "Length of a leg at rest, joint to foot."),
        ("leg_rest_angle", "q_n", "rad", "Angle of a leg from the body at rest, outward from straight down."),
    )
)
# Slopes [deg] and touchdown speeds [m/s] of further drops that a lab can make.
_SLOPES_DEG = (5.0, 10.0, 15.0, 20.0, 25.0, 30.0)
_SPEEDS = (0.4, 0.6, 0.8, 1.0)
# Distance up-slope of the surface's point at which the rear foot of such a drop lands [m].
_FOOT_FROM_POINT = 0.3


def _open(campaign: GearCampaign, path: Path, threads: int | None) -> GearProblem:
    # Refused before the drops are read.
    space = gear_space(campaign)
    campaign.parameters.measured_ranges(PARAMETERS)
    drops = prepare_drops(campaign, path, partial(reaches, campaign, space))
    problem = GearProblem(campaign, gear_space(campaign, drops), drops, threads)
    notice_out_of_plane(problem)
    return problem


def _begin(problem: GearProblem) -> None:
    """Tell what is fitted, and compile the kernel."""
    count = len(problem.fitted.drops)
    validated, free = len(problem.drops) - count, len(problem.space.found)
    tell(f"{count} drops to fit, {validated} to validate; {free} free parameters")
    prepare_kernel(problem.campaign.surface.law)


def _follow_up(problem: GearProblem, course: Course) -> FitOutcome:
    """Return the ranked sets with the numbers that follow from them."""
    campaign, sets = problem.campaign, course.sets
    stated = problem.stated
    cause = misfit_that_leans(problem, sets.values[0])
    if cause is not None:
        notice(cause.code, cause.sentence, size=cause.size)
    records = parameter_records(
        problem.space,
        {name: "campaign" for name in stated if name not in CONSTANTS},
        campaign.parameters.measured_ranges(PARAMETERS),
        _DERIVED,
        stated=dict.fromkeys({*stated, *campaign.parameters.fixed}, "campaign"),
    )
    fitted, nrmse = problem.fitted, sets.cost
    if problem.space.stated:
        # The search adds to the NRMSE what stated values cost that are left.
        nrmse = fitted.cost.mean(fitted.score(sets.values).by_channel)
    # Further facts that a simulator must know.
    settings = {
        "surface": campaign.surface.law,
        "frame": (
            "x down-slope, z up, y into the page; positive pitch turns z toward x; a slope falls toward +x; "
            "rear leg up-slope at -x, front leg at +x; every leg value is of the pair at that end"
        ),
        "window": {
            "before_contact": campaign.window.before_contact,
            "after_contact": campaign.window.after_contact,
        },
        "slopes_deg": {drop.name: float(np.degrees(drop.slope)) for drop in problem.fitted.drops},
        "tolerance": problem.tolerance,
    }
    return FitOutcome(
        sets=sets,
        rows=sets.values,
        records=records,
        values=_numbers(problem, sets.values),
        at_bound=np.pad(sets.at_bound, ((0, 0), (0, len(_DERIVED)))),
        nrmse=nrmse,
        settings=settings,
        cut=course.cut,
    )


def _numbers(problem: GearProblem, rows: FloatArray) -> FloatArray:
    """Return rows (S, n_table) [SI] with the length and the rest angle of their legs behind."""
    column = {name: rows[:, i] for name, i in PARAMETERS.index.items()}
    across = column["foot_dx"] - column["joint_dx"]
    down = column["foot_dz"] - column["joint_dz"]
    return np.column_stack([rows, np.hypot(across, down), np.arctan2(across, down)])


def _candidates(problem: GearProblem, row: FloatArray) -> tuple[GearProblem, Sequence[str]] | None:
    """Return drops that could be made next at a row (n_table,) [SI], and their titles.

    None where none of them can be simulated.
    """
    problem = replace(problem, tolerance=TRUST_TOLERANCE)
    drops, titles = [], []
    for slope in _SLOPES_DEG:
        for speed in _SPEEDS:
            drop = _candidate(problem, row, np.radians(slope), speed)
            if drop is not None:
                drops.append(drop)
                titles.append(f"a drop on {slope:g} deg at {speed:g} m/s")
    return (replace(problem, drops=tuple(drops)), titles) if drops else None


def _candidate(problem: GearProblem, row: FloatArray, slope: float, speed: float) -> PreparedDrop | None:
    """Return a drop as it would be recorded at the parameters `row`; None where it cannot be compared."""
    template, campaign = problem.drops[0], problem.campaign
    gravity, feet = campaign.vehicle.gravity, template.feet
    rate = template.motion.rate
    fall = min(campaign.window.before_contact, speed / gravity)
    foot_x = -_FOOT_FROM_POINT * np.cos(slope)
    start = np.zeros(6)
    start[0] = foot_x + feet.dx
    start[1] = -foot_x * np.tan(slope) + feet.dz + speed * fall - gravity * fall**2 / 2
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
        template, name=f"{np.degrees(slope):g} deg, {speed:g} m/s",
        feet=replace(feet, slope=float(slope)), touchdown=float(time[0] + fall), impact_speed=speed,
        time=time[:window], initial_state=start, simulated_time=time, before=before, target=blank,
    )  # fmt: skip
    alone = replace(problem, drops=(drop,))
    samples, result = alone.simulate(row[None])
    scored = alone.judge_samples(np.nan_to_num(samples), result)
    if np.any(scored.cause > 0) or np.any(result.reached < 1.0) or np.any(np.isfinite(result.flip)):
        return None
    clean = alone.cost.prepared(samples)[0][0]
    noise = compared_noise(template) * np.random.default_rng(1).standard_normal(clean.shape)
    return replace(drop, target=replace(blank, measured=clean + noise))


GEAR = Kind(
    name="gear",
    campaign=GearCampaign,
    open=_open,
    begin=_begin,
    story=GearStory,
    follow_up=_follow_up,
    numbers=_numbers,
    candidates=_candidates,
    under=lambda campaign, fit: on_surface(campaign, str(fit.get("surface", campaign.surface.law))),
    terms=(
        Term("axial spring hardens", ("leg_axial_hardening",)),
        Term("bending spring hardens", ("leg_bending_hardening",)),
        Term("slide rubs dry", ("leg_slide_friction",)),
        Term("joint rubs dry", ("leg_joint_friction",)),
        Term("front k_h differs", ("front_leg_axial_stiffness_ratio",)),
        Term("front k_t differs", ("front_leg_bending_stiffness_ratio",)),
        Term("front feet rub unlike", ("front_friction_excess",)),
        Term("ground stiffens with speed", ("ground_rate_stiffening",)),
        Term("air damps pitch", ("pitch_drag",)),
    ),
    laws=("surface",),
    words=Words(
        trials="drops",
        single=f"drop on {_SLOPES_DEG[0]:g} to {_SLOPES_DEG[-1]:g} deg at {_SPEEDS[0]:g} to "
        f"{_SPEEDS[-1]:g} m/s",
        misleads="a bounce near a bifurcation",
        remedy="state its release or its point with an error",
        unlike="a start near a bifurcation of the bounces, or a misread slope, surface or log",
    ),
)
