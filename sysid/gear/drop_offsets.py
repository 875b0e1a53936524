"""What a single drop may be off by: the height of the surface and the instant of the start, within bounds.

One free number per drop and kind, appended to the search: 1 mm of height is 1.4 ms of touchdown at 0.7 m/s,
which no stiffness explains. Off unless the campaign asks for it; validation drops are never given any.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid.campaign import GearCampaign
from sysid.gear.drops import PreparedDrop
from sysid.parameters import Parameter, ParameterTable, SearchSpace
from sysid.types import FloatArray

_HEIGHT = "height_offset"
_START = "start_offset"


def with_nuisance(space: SearchSpace, campaign: GearCampaign) -> SearchSpace:
    """Append the free offsets that a campaign asks for, one per fitted drop and kind."""
    wanted = campaign.nuisance
    rows = []
    for trial in campaign.trials:
        if trial.use != "fit":
            continue
        if wanted.height is not None:
            meaning = "Height of the surface above its stated place"
            rows.append(_row(_HEIGHT, "δz", trial.name, "m", wanted.height, meaning))
        if wanted.start_time is not None:
            meaning = "Delay of the motion behind its stated start"
            rows.append(_row(_START, "δt", trial.name, "s", wanted.start_time, meaning))
    if not rows:
        return space
    return SearchSpace(ParameterTable([*space.table.values(), *rows]), (*space.free, *rows), space.fixed)


def _row(kind: str, symbol: str, drop: str, unit: str, bound: float, meaning: str) -> Parameter:
    return Parameter(
        f"{kind}[{drop}]", f"{symbol}[{drop}]", unit, 0.0, -bound, bound, "linear",
        f"{meaning}, {drop}.", "campaign, [nuisance]",
    )  # fmt: skip


def offsets(
    table: ParameterTable, rows: FloatArray, drops: Sequence[PreparedDrop]
) -> tuple[FloatArray, FloatArray] | None:
    """Return heights [m] and delays [s] (P, D) of rows of a table (P, n); None where it has none."""
    index = {name: i for i, name in enumerate(table) if "[" in name}
    if not index or rows.shape[1] <= min(index.values()):
        return None
    out = np.zeros((2, len(rows), len(drops)))
    for kind, name in enumerate((_HEIGHT, _START)):
        for d, drop in enumerate(drops):
            column = index.get(f"{name}[{drop.name}]")
            if column is not None:
                out[kind, :, d] = rows[:, column]
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
