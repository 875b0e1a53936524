"""The rows of a campaign's parameter table with which a fit predicts that campaign's trials.

A fit brings what it has found. What it held (a value that its own campaign fixed or measured) counts as well
where the other campaign says nothing of that parameter; what the other campaign fixes or measures is its own.
Two things stay together: a motor's R with its k, and friction with its law.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from sysid.campaign import GearCampaign, MotorCampaign
from sysid.fit.result import FitResult
from sysid.gear import problem as gear
from sysid.gear.model import PARAMETERS, parameters_on
from sysid.motor.known_values import CONSTANTS, Bench
from sysid.parameters import SearchSpace
from sysid.types import FloatArray


def fit_rows(
    result: FitResult, names: tuple[str, ...], base: FloatArray, known: Collection[str]
) -> FloatArray:
    """Return rows (S, n) of a campaign's table [SI], one per set of a fit.

    Parameters
    ----------
    result : FitResult
    names : tuple of str
        Of the campaign's table.
    base : (n,) array
        What the campaign itself has [SI].
    known : collection of str
        Names that the campaign fixes or measures: of those only what the fit has *found* replaces the base.
    """
    rows = np.repeat(base[None], len(result.nrmse), axis=0)
    for i, record in enumerate(result.parameters):
        if record.name not in names:
            continue
        held = record.status in ("fixed", "measured") and record.name not in known
        if (record.status == "free" or held) and np.isfinite(result.values[:, i]).all():
            rows[:, names.index(record.name)] = result.values[:, i]
    return rows


def campaign_row(campaign: GearCampaign) -> FloatArray:
    """Return the row (n_par,) of the gear's table that a campaign states [SI]; else the law's defaults."""
    space = gear.search_space(campaign)
    known = {**parameters_on(campaign.surface.law).nominal, **gear.measured_values(campaign), **space.fixed}
    return np.array([known[name] for name in PARAMETERS])


def gear_rows(result: FitResult, campaign: GearCampaign, surface: FloatArray | None = None) -> FloatArray:
    """Return the rows (S, n_par) with which a gear's fit predicts the drops of a campaign [SI].

    Parameters
    ----------
    result : FitResult
    campaign : GearCampaign
    surface : (n_par,) array, optional
        Row whose friction stands where the campaign's friction law is not the fit's: what was found or held
        under one law says nothing of another. By default what the campaign states, else its law's defaults.
    """
    base = campaign_row(campaign)
    known = {*gear.measured_values(campaign), *campaign.parameters.fixed}
    rows = fit_rows(result, tuple(PARAMETERS), base, known)
    if campaign.surface.law != result.settings["surface"]:
        own = base if surface is None else surface
        for i, name in enumerate(PARAMETERS):
            if name in type(campaign.surface).model_fields:
                rows[:, i] = own[i]
    return rows


def motor_rows(
    result: FitResult, campaign: MotorCampaign, bench: Bench, space: SearchSpace, base: FloatArray
) -> FloatArray:
    """Return the rows (S, n) with which a motor's fit predicts the trials of a campaign [SI].

    Parameters
    ----------
    result : FitResult
    campaign : MotorCampaign
    bench : Bench
        Its logs.
    space : SearchSpace
        Whose table the rows are of.
    base : (n,) array
        For what neither of them says anything of.

    Notes
    -----
    Torque and speed fix k²/R, R/L and k·I_sat: an R that was found keeps the k under which it was found,
    whatever Kv the campaign states.
    """
    guessed = {name for name, source in bench.stated.items() if source.startswith("guess")}
    known = {*bench.values, *campaign.parameters.fixed} - guessed
    if any(one.name == "winding_resistance" and one.status == "free" for one in result.parameters):
        known -= {*CONSTANTS}
    return fit_rows(result, tuple(space.table), base, known)
