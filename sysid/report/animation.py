"""Drops in motion inside a page: numbers for the script that draws them; nothing is fetched."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.report.drawing import USES
from sysid.report.drop_replay import RATE, DropReplay
from sysid.report.html import NOTHING, Html, filled
from sysid.report.plots import embedded

# Every second sample is drawn.
_EVERY = 2


@dataclass(frozen=True, eq=False)
class Scene:
    """A drop to be played: replays of one drop by the name of their fit, the first one judged.

    `key` ties it to the traces of the drop.
    """

    key: str
    replays: dict[str, DropReplay]


def animation(scenes: Sequence[Scene], static: Html = NOTHING) -> Html:
    """Return drops to be played, stepped through and slowed down; replays of one drop beside each other.

    Nothing moves until a reader asks for it; where a reader's system asks for reduced motion, playing steps
    from one instant of Fig. 7 to the next. `static` is what paper shows instead.
    """
    firsts = [next(iter(scene.replays.values())) for scene in scenes]
    # Drops of two campaigns may have one name.
    names = [next(iter(scene.replays)) for scene in scenes]
    choices = [
        f"{f'{name}, ' if len(set(names)) > 1 else ''}{drop.name}: "
        f"{math.degrees(drop.slope):.0f}°, {USES[drop.use]}"
        for name, drop in zip(names, firsts, strict=True)
    ]
    return filled(
        "animation.html.j2",
        names=", ".join(drop.name for drop in firsts),
        choices=choices,
        steepest=steepest(firsts),
        data=embedded({"drops": [_document(scene) for scene in scenes]}),
        static=static,
    )


def steepest(drops: Sequence[DropReplay]) -> int:
    """Return which of some drops falls on the steepest slope: it is shown first."""
    return max(range(len(drops)), key=lambda i: drops[i].slope)


def _document(scene: Scene) -> dict[str, object]:
    first = next(iter(scene.replays.values()))
    return {
        "key": scene.key,
        "name": first.name,
        "use": USES[first.use],
        "slope": round(float(first.slope), 5),
        "step": _EVERY / RATE,
        "snapshots": [[round(t, 4), what] for t, what in first.first_contacts()],
        "contacts": [[c.foot, round(c.start, 4), round(c.end, 4)] for c in first.contacts],
        "fits": [{"name": name, **_movement(drop)} for name, drop in scene.replays.items()],
    }


def _movement(drop: DropReplay) -> dict[str, object]:
    """Return what the script draws, in whole numbers: lengths [0.1 mm], angles [0.1 mrad], forces [N]."""
    # The script draws no ghost that is 9 m away.
    measured = np.where(np.isfinite(drop.measured), drop.measured, 9.0)
    points = np.concatenate([drop.joints, drop.feet], axis=1).reshape(-1, 8)
    forces = drop.normal_force, drop.friction_force
    frames = np.column_stack([1e4 * drop.body, 1e4 * points, *forces, 1e4 * measured])[::_EVERY]
    return {
        "frames": np.rint(np.nan_to_num(frames)).astype(int).tolist(),
        "arm": round(1e4 * drop.values["thrust_point_dx"]),
        "joint": [round(1e4 * drop.values[name]) for name in ("joint_dx", "joint_dz")],
        "foot": [round(1e4 * drop.values[name]) for name in ("foot_dx", "foot_dz")],
    }
