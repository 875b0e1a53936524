"""`fit-gear`: drops in, five ranked parameter sets out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.campaign import GearCampaign
from sysid.errors import CampaignError
from sysid.fit.cost import FilteredNrmse, PopulationCost
from sysid.fit.objective import Evaluation
from sysid.gear.model import FIT_TOLERANCE, HF_FREE, LF_FREE, PARAMETERS, SURFACES, Drops, simulate_population
from sysid.parameters import SearchSpace
from sysid.pipelines.drops import PreparedDrop, cost_channels

FloatArray = NDArray[np.float64]


def search_space(campaign: GearCampaign) -> SearchSpace:
    """Return the free parameters of a campaign and the values of all others.

    Raises
    ------
    CampaignError
        For an unknown parameter, a wrong unit, crossed bounds, bounds that exclude a measured value.
    """
    law = campaign.surface.law
    if law not in SURFACES:
        raise CampaignError(f"surface.law is {law!r}; this version knows {', '.join(SURFACES)}")
    default = LF_FREE if law == "lf" else HF_FREE
    return campaign.parameters.search_space(PARAMETERS, default, measured_values(campaign))


def measured_values(campaign: GearCampaign) -> dict[str, float]:
    """Return what the campaign measured of the model's parameters, by name [SI]."""
    tables = {**campaign.vehicle.model_dump(), **campaign.surface.model_dump()}
    return {name: tables[name] for name in PARAMETERS if tables.get(name) is not None}


@dataclass(frozen=True, eq=False)
class GearObjective:
    """Mean NRMSE of a population over drops.

    Parameters
    ----------
    space : SearchSpace
        Free parameters and fixed values.
    drops : tuple of PreparedDrop
        What is compared.
    channels, denominator
        Of the cost.
    surface : str
        Friction law.
    threads : int, optional
        Cores to use; all by default. The numbers do not depend on it.
    """

    space: SearchSpace
    drops: tuple[PreparedDrop, ...]
    cost: FilteredNrmse
    surface: str
    threads: int | None = None
    tolerance: float = FIT_TOLERANCE
    _jobs: Drops = field(init=False, repr=False)

    def __post_init__(self) -> None:
        jobs = Drops(
            np.array([drop.slope for drop in self.drops]),
            np.array([drop.initial_state for drop in self.drops]),
            tuple(drop.simulated_time for drop in self.drops),
        )
        object.__setattr__(self, "_jobs", jobs)

    @classmethod
    def build(
        cls,
        campaign: GearCampaign,
        space: SearchSpace,
        drops: tuple[PreparedDrop, ...],
        threads: int | None = None,
        tolerance: float = FIT_TOLERANCE,
    ) -> GearObjective:
        """Join prepared drops with the campaign's cost."""
        cost = FilteredNrmse(
            [drop.target for drop in drops], cost_channels(campaign), campaign.cost.denominator
        )
        return cls(space, drops, cost, campaign.surface.law, threads, tolerance)

    def evaluate(self, cube: FloatArray) -> Evaluation:
        """Simulate and score unit-cube points (P, n_free)."""
        scored = self.score(self.space.full(cube))
        return Evaluation(scored.cost, scored.failed.any(axis=1), len(cube) * len(self.drops))

    def score(self, rows: FloatArray) -> PopulationCost:
        """Simulate and score rows of the whole parameter table (P, n_par) [SI]."""
        samples, reached = self.simulate(rows)
        return self.cost(samples, reached)

    def simulate(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return samples (P, n_total, 6) with every drop's margins, and the share that was reached (P, D)."""
        result = simulate_population(
            rows, self._jobs, surface=self.surface, tolerance=self.tolerance, threads=self.threads
        )
        offsets, ends = self.cost.offsets, self._jobs.offset
        samples = np.empty((len(rows), self.cost.n_total, 6))
        for d, drop in enumerate(self.drops):
            lead = len(drop.before)
            samples[:, offsets[d] : offsets[d] + lead, :3] = drop.before
            samples[:, offsets[d] : offsets[d] + lead, 3:] = np.nan
            samples[:, offsets[d] + lead : offsets[d + 1]] = result.samples[:, ends[d] : ends[d + 1]]
        return samples, result.reached


def score_values(
    campaign: GearCampaign, drops: tuple[PreparedDrop, ...], values: Mapping[str, float], **options: Any
) -> PopulationCost:
    """Score one set of parameter values [SI] on prepared drops; absent names take the campaign's.

    The way to ask what the truth of a synthetic campaign scores.
    """
    space = search_space(campaign)
    full = {**PARAMETERS.nominal, **measured_values(campaign), **space.fixed, **values}
    row = np.array([[full[name] for name in PARAMETERS]])
    return GearObjective.build(campaign, space, drops, **options).score(row)


def read_truth(path: str | Path) -> dict[str, float]:
    """Return the parameter values of a synthetic campaign's truth file [SI]."""
    import json

    return dict(json.loads(Path(path).read_text(encoding="utf-8"))["parameters"])
