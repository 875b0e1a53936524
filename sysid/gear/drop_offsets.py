"""What a single drop may be off by: the height of the surface and the instant of the start, within bounds.

One free number per drop and kind, appended to the search: 1 mm of height is 1.4 ms of touchdown at 0.7 m/s,
which no stiffness explains. Off unless the campaign asks for it; validation drops are never given any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.campaign import GearCampaign
from sysid.gear.drops import PreparedDrop
from sysid.parameters import Parameter, ParameterTable, SearchSpace
from sysid.types import FloatArray

_HEIGHT = Parameter(
    "height_offset", "δz", "m", 0.0, -1.0, 1.0, "linear",
    "Height of the surface above its stated place", "campaign, [nuisance]", "nuisance",
)  # fmt: skip
_START = Parameter(
    "start_offset", "δt", "s", 0.0, -1.0, 1.0, "linear",
    "Delay of the motion behind its stated start", "campaign, [nuisance]", "nuisance",
)  # fmt: skip


def with_nuisance(space: SearchSpace, campaign: GearCampaign) -> SearchSpace:
    """Append the free offsets that a campaign asks for, one per fitted drop and kind."""
    bounds = ((_HEIGHT, campaign.nuisance.height), (_START, campaign.nuisance.start_time))
    rows = [
        replace(
            kind.of_trial(trial.name), lower=-bound, upper=bound, meaning=f"{kind.meaning}, {trial.name}."
        )
        for trial in campaign.trials
        if trial.use == "fit"
        for kind, bound in bounds
        if bound is not None
    ]
    if not rows:
        return space
    return SearchSpace(ParameterTable([*space.table.values(), *rows]), (*space.free, *rows), space.fixed)


def offsets(
    table: ParameterTable, rows: FloatArray, drops: Sequence[PreparedDrop]
) -> tuple[FloatArray, FloatArray] | None:
    """Return heights [m] and delays [s] (P, D) of rows of a table (P, n); None where it has none."""
    index = {(row.common_name, row.trial): i for i, row in enumerate(table.values()) if row.trial}
    if not index or rows.shape[1] <= min(index.values()):
        return None
    out = np.zeros((2, len(rows), len(drops)))
    for k, kind in enumerate((_HEIGHT, _START)):
        for d, drop in enumerate(drops):
            column = index.get((kind.name, drop.name))
            if column is not None:
                out[k, :, d] = rows[:, column]
    return out[0], out[1]


def shifted_starts(drops: Sequence[PreparedDrop], height: FloatArray, delay: FloatArray) -> FloatArray:
    """Return initial states (P, D, 6) over a surface that is higher, of a motion that is later."""
    out = np.empty((*height.shape, 6))
    for d, drop in enumerate(drops):
        out[:, d] = drop.flight.at(drop.time[0] - delay[:, d], free=True)
        out[:, d, 1] -= height[:, d]
    return out


def shifted_before(drop: PreparedDrop, delay: FloatArray) -> FloatArray:
    """Return x, z, pitch (P, margin, 3) at the samples before the window, of a motion that is later."""
    lead = len(drop.before)
    time = drop.time[0] - np.arange(lead, 0, -1) / drop.motion.rate
    return drop.flight.at((time - delay[:, None]).ravel())[:, :3].reshape(len(delay), lead, 3)
