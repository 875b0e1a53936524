"""Drops released with roll or yaw, which the planar model ignores: how much, what it costs, from where on.

Roll and yaw matter by one angle, the lean of the feet across the surface: with ``n`` normal to the surface
and ``y`` the body's lateral axis, lean = asin(n·y), which for small angles is roll·cos(slope) -
yaw·sin(slope). A roll and a yaw that cancel in it cost little; a yaw without lean only turns the plane of the
drop. The feet at one side touch first, the body starts to roll, and every bounce is another one. The cost
grows with the square of the lean until the bounces differ.

The axes of a rigid body are not those of the drone, so roll and yaw at the release are known up to an
offset that all drops of the body share. The offset is chosen, within its uncertainty, so that the drops begin
to roll against their leans: by `_BEGINS` of them in 30 ms. ``tests/benchmarks/spatial_drops.py`` has the
numbers.
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from sysid.fit.trial import EXPLAINED
from sysid.gear.drops import PreparedDrop
from sysid.gear.problem import GearProblem
from sysid.journal import Finding, notice, tell
from sysid.trials.capture import PLANAR_LIMIT
from sysid.types import FloatArray

# NRMSE over noise that makes a drop of a right model miss by `EXPLAINED` times its noise [1].
_MATTERS = float(np.sqrt(EXPLAINED**2 - 1.0))
# Roll against the lean over the lean [1], and when [s] after the touchdown: 0.3 to 0.9 in spatial drops on
# both laws and at all speeds, because the legs' springs and the body's inertia set the pace.
_BEGINS, _WHEN = 0.55, (0.02, 0.04)
# Error of a lean that the beginning roll tells, and its share of the lean [rad, 1].
_ERROR, _SHARE = np.radians(0.2), 0.5
# Least lean that is told from none [rad]: largest error of the leans of straight and crooked spatial drops
# whose leans are that small.
_LEAST = np.radians(0.15)
# Largest roll or yaw that a release by hand or magnet explains [rad].
_BY_HAND = np.radians(20.0)
# Share of a misfit that leans must predict to be named as its cause [1]: the table is right within a factor
# of two for most drops, of gears of another size too.
_EXPLAINS = 0.5


@dataclass(frozen=True)
class Lean:
    """How a drop was released, and the cost to a planar model.

    Angles [rad]; NRMSE beyond the noise and of the noise [1]; `limit` is the lean from which on it matters.
    """

    roll: float
    yaw: float
    lean: float
    cost: float
    noise: float
    limit: float

    @property
    def matters(self) -> bool:
        """Whether the drop misses the planar model by more than noise explains."""
        return abs(self.lean) > _LEAST and self.cost > _MATTERS * self.noise


@cache
def _table(law: str) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return slopes (n,) and leans (m,) [rad] and NRMSE (n, m) [1] of spatial drops; None of other laws."""
    text = resources.files("sysid").joinpath("gear", "out_of_plane.csv").read_text(encoding="utf-8")
    lines = csv.DictReader(line for line in text.splitlines() if not line.startswith("#"))
    cells = {
        (float(row["slope [deg]"]), float(row["lean [deg]"])): float(row["nrmse [%]"])
        for row in lines
        if row["law"] == law
    }
    if not cells:
        return None
    slopes, leans = (sorted({key[k] for key in cells}) for k in (0, 1))
    # A larger lean that happens to cost less makes no smaller one harmless.
    costs = np.maximum.accumulate([[cells[slope, lean] / 100 for lean in leans] for slope in slopes], axis=1)
    return np.radians(slopes), np.radians([0.0, *leans]), np.pad(costs, ((0, 0), (1, 0)))


def _curve(law: str, slope: float) -> tuple[FloatArray, FloatArray] | None:
    """Return leans (m,) [rad] and their NRMSE (m,) [1] on a slope [rad]; beyond the table its last slope."""
    table = _table(law)
    if table is None:
        return None
    slopes, leans, costs = table
    return leans, np.array([np.interp(slope, slopes, column) for column in costs.T])


def cost_of_lean(law: str, slope: float, lean: float) -> float:
    """Return the NRMSE [1] that a lean costs on a slope [rad]; NaN of a law without spatial drops."""
    curve = _curve(law, slope)
    return float("nan") if curve is None else float(np.interp(abs(lean), *curve))


def leans(problem: GearProblem) -> dict[str, Lean]:
    """Return the leans of the drops, by name; drops without another one of their body have none."""
    campaign, law = problem.campaign, problem.campaign.surface.law
    trials = {trial.name: trial for trial in campaign.trials}
    noise = np.zeros((2, len(problem.drops)))
    for block in problem.blocks:
        noise[:, block.trial] += block.weight * block.noise, block.weight
    groups: dict[object, list[int]] = {}
    for d, drop in enumerate(problem.drops):
        trial = trials[drop.name]
        groups.setdefault((trial.rigid_body or trial.log_options.rigid_body, trial.down_slope), []).append(d)
    out = {}
    for members in groups.values():
        roll, yaw = _released([problem.drops[d] for d in members], campaign.capture.level == "release")
        for d, phi, psi in zip(members, roll, yaw, strict=True):
            drop = problem.drops[d]
            curve = _curve(law, drop.slope)
            if curve is None or not np.isfinite(phi):
                continue
            lean = float(np.arcsin(np.cos(drop.slope) * np.sin(phi) - np.sin(drop.slope) * np.sin(psi)))
            floor = float(noise[0, d] / noise[1, d])
            angles, costs = curve
            limit = np.interp(_MATTERS * floor, costs, angles, right=np.inf)
            cost = cost_of_lean(law, drop.slope, lean)
            out[drop.name] = Lean(float(phi), float(psi), lean, cost, floor, float(limit))
    return out


def _released(drops: Sequence[PreparedDrop], against_others: bool) -> tuple[FloatArray, FloatArray]:
    """Return roll and yaw (n,) [rad] at the release of drops of one body; NaN where they are not known.

    A body that seems to be turned further than any hand turns it had its axes defined again in between.
    """
    turns = np.array([drop.attitude for drop in drops])
    if against_others:
        turns = turns @ turns[0].T
    angles = np.arcsin(np.clip([-turns[:, 1, 2], turns[:, 1, 0]], -1.0, 1.0))
    if against_others:
        angles -= np.median(angles, axis=1, keepdims=True)
    known = np.asarray((np.abs(angles) < _BY_HAND).all(axis=0))
    if against_others and known.sum() < 2:
        known[:] = False
    elif against_others:
        slopes = np.array([drop.slope for drop in drops])
        of_lean = np.array([np.cos(slopes), -np.sin(slopes)])
        lean = (of_lean * angles).sum(axis=0)
        begins = np.array([_begins(drop) for drop in drops])
        told = known & np.isfinite(begins)
        error = np.hypot(_ERROR, _SHARE * lean)
        # The middle of n normal numbers has 1.25 times the standard error of their mean.
        prior = np.maximum(1.25 * angles[:, known].std(axis=1) / np.sqrt(known.sum()), 1e-9)
        rows = np.vstack([(of_lean / error).T[told], np.diag(1 / prior)])
        target = np.append(((-begins / _BEGINS - lean) / error)[told], [0.0, 0.0])
        angles += np.linalg.lstsq(rows, target, rcond=None)[0][:, None]
    angles[:, ~known] = np.nan
    return angles[0], angles[1]


def _begins(drop: PreparedDrop) -> float:
    """Return the change of a drop's lean in the first contact [rad]; NaN where the body was lost."""
    motion, since = drop.motion, drop.motion.time - drop.touchdown
    first = (since > _WHEN[0]) & (since < _WHEN[1]) & motion.valid
    change = np.cos(drop.slope) * motion.roll[first] - np.sin(drop.slope) * motion.yaw[first]
    return float(change.mean()) if first.any() else float("nan")


def notice_out_of_plane(problem: GearProblem) -> None:
    """Notice drops whose roll or yaw a planar model cannot ignore, and tell from where on it cannot."""
    found = leans(problem)
    for drop in problem.drops:
        lean = found.get(drop.name)
        if lean is not None and lean.matters:
            roll, yaw = limits(lean.limit, drop.slope)
            notice(
                "released-out-of-plane",
                f"released with {np.degrees(lean.roll):.1f} deg of roll and {np.degrees(lean.yaw):.1f} deg "
                f"of yaw: the feet lean {abs(np.degrees(lean.lean)):.1f} deg across the surface, "
                f"which costs a planar model about {100 * lean.cost:.0f} % NRMSE beside "
                f"{100 * lean.noise:.1f} % of noise; on {np.degrees(drop.slope):.0f} deg it matters from "
                f"{roll} deg of roll or {yaw} deg of yaw on: release it again, straight",
                trial=drop.name,
                size=lean.cost / lean.noise,
            )  # fmt: skip
            continue
        window = (drop.motion.time >= drop.time[0]) & (drop.motion.time <= drop.time[-1])
        for angle, values in (("roll", drop.motion.roll), ("yaw", drop.motion.yaw)):
            largest = float(np.nanmax(np.abs(values[window])))
            if largest > PLANAR_LIMIT:
                notice(
                    f"{angle}-out-of-plane",
                    f"{angle} reaches {np.degrees(largest):.0f} deg, the planar model assumes less than "
                    f"{np.degrees(PLANAR_LIMIT):.0f} deg",
                    trial=drop.name,
                    size=largest,
                )  # fmt: skip


def tell_limits(problem: GearProblem) -> None:
    """Tell how straight the drops of a problem must be released, by slope."""
    found = leans(problem)
    by_slope: dict[float, float] = {}
    for drop in problem.drops:
        if drop.name in found:
            by_slope[drop.slope] = min(by_slope.get(drop.slope, np.inf), found[drop.name].limit)
    if by_slope:
        parts = [
            "{} or {} deg on {:.3g} deg".format(*limits(by_slope[slope], slope), np.degrees(slope))
            for slope in sorted(by_slope)
        ]
        tell(f"roll or yaw at release matters from {', '.join(parts)} of slope on", detail=True)


def limits(lean: float, slope: float) -> tuple[str, str]:
    """Return the roll and the yaw [deg] that lean the feet by an angle [rad] on a slope [rad], in words."""
    parts = np.sin(lean) if np.isfinite(lean) else 1.0
    return tuple(  # type: ignore[return-value]
        f"{np.degrees(np.arcsin(parts / share)):.2g}" if parts < share else "90"
        for share in (np.cos(slope), np.sin(slope))
    )


def misfit_that_leans(problem: GearProblem, row: FloatArray) -> Finding | None:
    """Return the finding that roll and yaw explain what a row (n_table,) [SI] leaves; None where not.

    The leans must predict at least half of what the fitted drops miss beyond their noise.
    """
    known, fitted = leans(problem), problem.fitted
    found = [known[drop.name] for drop in fitted.drops if drop.name in known]
    again = [name for name in fitted.names if name in known and known[name].matters]
    if len(found) < len(fitted.drops) or not again:
        return None
    missed = fitted.score(row[None]).by_channel[0] @ (fitted.cost.weights / fitted.cost.weights.sum())
    noise, costs = np.array([lean.noise for lean in found]), np.array([lean.cost for lean in found])
    ratio, worst = missed.mean() / noise.mean(), int(np.argmax(missed / noise))
    beyond = np.maximum(missed**2 - noise**2, 0.0).mean()
    if ratio <= EXPLAINED or np.mean(costs**2) < _EXPLAINS**2 * beyond:
        return None
    predicted = float(np.hypot(noise, costs).mean() / noise.mean())
    return Finding(
        "misfit-follows-roll",
        f"roll and yaw at release explain the misfit of {ratio:.1f} × the noise (worst "
        f"{fitted.names[worst]}, {missed[worst] / noise[worst]:.1f} ×): a gear on four legs, released like "
        f"that, leaves a planar model some {predicted:.1f} ×; release {', '.join(again)} again, straight, "
        "before other physics is looked for",
        size=predicted,
    )
