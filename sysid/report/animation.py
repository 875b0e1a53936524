"""Drops in motion inside a page: numbers and a small script that draws them; nothing is fetched."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from sysid.report.drawing import USES
from sysid.report.drop_replay import RATE, DropReplay
from sysid.report.html import Html, filled

# Every second sample is drawn.
_EVERY = 2


def animation(drops: Sequence[DropReplay], campaigns: Sequence[str] = ()) -> Html:
    """Return drops to be played, stepped through and slowed down; `campaigns` tells drops of several apart.

    Nothing moves until a reader asks for it; where a reader's system asks for reduced motion, playing steps
    from one instant of Fig. 7 to the next.
    """
    documents = [_document(drop) for drop in drops]
    choices = [
        f"{drop.name}: {math.degrees(drop.slope):.0f}°, {document['use']}"
        for drop, document in zip(drops, documents, strict=True)
    ]
    if campaigns:
        choices = [f"{campaign}, {words}" for campaign, words in zip(campaigns, choices, strict=True)]
    # A page ends a script at the first "</script"; JSON may write "<" as an escape.
    data = json.dumps({"drops": documents}, separators=(",", ":")).replace("<", "\\u003c")
    return filled(
        "animation.html.j2",
        names=", ".join(drop.name for drop in drops),
        choices=choices,
        steepest=max(range(len(drops)), key=lambda i: drops[i].slope),
        data=Html(data),
    )


def _document(drop: DropReplay) -> dict[str, Any]:
    """Return what the script draws, in whole numbers: lengths [0.1 mm], angles [0.1 mrad], forces [N]."""
    # The script draws no ghost that is 9 m away.
    measured = np.where(np.isfinite(drop.measured), drop.measured, 9.0)
    points = np.concatenate([drop.joints, drop.feet], axis=1).reshape(-1, 8)
    forces = drop.normal_force, drop.friction_force
    frames = np.column_stack([1e4 * drop.body, 1e4 * points, *forces, 1e4 * measured])[::_EVERY]
    return {
        "name": drop.name,
        "use": USES[drop.use],
        "slope": round(float(drop.slope), 5),
        "step": _EVERY / RATE,
        "frames": np.rint(np.nan_to_num(frames)).astype(int).tolist(),
        "snapshots": [[round(t, 4), what] for t, what in drop.first_contacts()],
        "arm": round(1e4 * drop.values["thrust_point_dx"]),
        "joint": [round(1e4 * drop.values[name]) for name in ("joint_dx", "joint_dz")],
        "foot": [round(1e4 * drop.values[name]) for name in ("foot_dx", "foot_dz")],
    }
