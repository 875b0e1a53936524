"""Landing gears as a kind of model: how a campaign of drops is opened, and what its fit leaves behind."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from sysid.campaign import GearCampaign
from sysid.fit.problem import Course, Kind, Outcome, Words
from sysid.gear.candidates import candidate_drops
from sysid.gear.drops import prepare_drops
from sysid.gear.model import PARAMETERS
from sysid.gear.problem import CONSTANTS, GearProblem, fit_tolerance, on_surface, search_space
from sysid.journal import Finding
from sysid.parameter_sets import ParameterRecord, parameter_records
from sysid.types import FloatArray

_DERIVED = tuple(
    ParameterRecord(name, symbol, unit, "derived", meaning, "Table II, note a")
    for name, symbol, unit, meaning in (
        ("leg_length", "l", "m", "Length of a leg at rest, joint to foot."),
        ("leg_rest_angle", "q_n", "rad", "Angle of a leg from the body at rest, outward from straight down."),
    )
)


def _derived(rows: FloatArray) -> FloatArray:
    """Return leg length and rest angle (S, 2) of rows of the parameter table (S, n_par)."""
    column = {name: rows[:, i] for i, name in enumerate(PARAMETERS)}
    across = column["foot_dx"] - column["joint_dx"]
    down = column["foot_dz"] - column["joint_dz"]
    return np.column_stack([np.hypot(across, down), np.arctan2(across, down)])


def _open(campaign: GearCampaign, path: Path, threads: int | None) -> GearProblem:
    space = search_space(campaign)
    # Refused before the drops are read.
    campaign.parameters.measured_ranges(PARAMETERS)
    return GearProblem.build(campaign, space, prepare_drops(campaign, path), threads, path=path)


def _follow_up(problem: GearProblem, course: Course) -> Outcome:
    """Return the ranked sets with the numbers that follow from them."""
    campaign, sets = problem.campaign, course.sets
    stated = problem.stated
    records = parameter_records(
        problem.space,
        {name: "campaign" for name in stated if name not in CONSTANTS},
        campaign.parameters.measured_ranges(PARAMETERS),
        _DERIVED,
        stated=dict.fromkeys({*stated, *campaign.parameters.fixed}, "campaign"),
    )
    # What a simulator must know beside the numbers.
    settings = {
        "surface": campaign.surface.law,
        "frame": (
            "x down-slope, z up, y into the page; positive pitch turns z toward x; a slope falls toward +x; "
            "rear leg up-slope at -x, front leg at +x; every leg value is of the pair at that end"
        ),
        "window": {
            "before_contact [s]": campaign.window.before_contact,
            "after_contact [s]": campaign.window.after_contact,
        },
        "slopes [deg]": {drop.name: float(np.degrees(drop.slope)) for drop in problem.fitted.drops},
        "tolerance": fit_tolerance(campaign),
    }
    return Outcome(
        sets=sets,
        rows=sets.values,
        records=records,
        values=np.hstack([sets.values, _derived(sets.values)]),
        at_bound=np.pad(sets.at_bound, ((0, 0), (0, len(_DERIVED)))),
        nrmse=sets.cost,
        settings=settings,
        cut=course.cut,
    )


def _under(campaign: GearCampaign, settings: Mapping[str, Any]) -> tuple[GearCampaign, tuple[Finding, ...]]:
    return on_surface(campaign, str(settings.get("surface", campaign.surface.law)))


GEAR = Kind(
    name="gear",
    campaign=GearCampaign,
    open=_open,
    begin=GearProblem.begin,
    follow_up=_follow_up,
    candidates=candidate_drops,
    under=_under,
    words=Words(
        trials="drops",
        single="level drop on this surface",
        misleads="a bounce beside a bifurcation",
        remedy="free its start ([nuisance] start_time, height)",
        unlike="a start beside a fork of the bounces, or a misread slope, surface or log",
    ),
)
