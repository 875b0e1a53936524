"""What a campaign is expected to determine, before a fit: at one point, and over the bounds.

At a point: the linearized half-widths of `sysid.trust.linearized` with the noise that the instrument shows
while nothing happens, walked through the filter. Over the bounds: the half-widths at points drawn from them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.fit.problem import Problem
from sysid.fit.trial import NoiseModel
from sysid.parameters import SearchSpace
from sysid.trust.documents import CandidateRecording, Expected, larger
from sysid.trust.linearized import Linearized, bounded_information, gradient_noise, half_widths, linearized
from sysid.trust.problem import jacobian, scales
from sysid.trust.verdicts import verdict
from sysid.types import BoolArray, FloatArray

# Points drawn from the bounds.
ELSEWHERE = 8
# Margin of the drawn points from the faces of the unit cube: a difference must not leave it.
_INSIDE = 0.05
# Candidates that are judged over the bounds as well, the best by their gain.
_JUDGED = 6


def outlook(problem: Problem, point: FloatArray, noise: NoiseModel) -> Linearized:
    """Return what noise, correlated like `noise`, would leave open at a point (n_free,) of the unit cube."""
    floor = np.array([block.noise for block in problem.blocks])
    scale, floor = scales(problem, problem.blocks, floor), np.nan_to_num(floor)
    weight = sum(block.weight * level for block, level in zip(problem.blocks, floor, strict=True))
    sample = float(np.sqrt(weight / sum(block.count for block in problem.blocks)))
    return linearized(problem, point, floor, scale, sample, noise, problem.disturbances(point))


def drawn_outlooks(problem: Problem, noise: NoiseModel) -> tuple[Linearized, ...]:
    """Return the outlooks at points drawn from the bounds, as far as they can be simulated.

    What the campaign states stays as stated: its bounds are twenty errors away.
    """
    drawn = np.random.default_rng(0).random((ELSEWHERE, len(problem.space.free)))
    drawn = _INSIDE + (1 - 2 * _INSIDE) * drawn
    found = len(problem.space.found)
    drawn[:, found:] = nominal_point(problem.space)[found:]
    _, failed = problem.residuals(drawn)
    return tuple(outlook(problem, point, noise) for point in drawn[~failed])


def expectations(
    problem: Problem, point: FloatArray, noise: NoiseModel, drawn: Sequence[Linearized] = ()
) -> tuple[Linearized, tuple[Expected, ...]]:
    """Return what the trials should determine of every free parameter, at a unit-cube point (n_free,).

    With `drawn_outlooks` also over the bounds.
    """
    view = outlook(problem, point, noise)
    elsewhere = np.full(len(point), np.nan)
    if drawn:
        elsewhere = np.median([other.half_widths for other in drawn], axis=0)
    partners = view.information.partners(problem.space.names)
    value = problem.space.decode(point)
    return view, tuple(
        Expected(
            name=row.name, symbol=row.symbol, unit=row.unit, value=value[i], half_width=view.half_widths[i],
            half_width_over_bounds=elsewhere[i], partners=partners[i],
            verdict=verdict(larger(float(view.half_widths[i]), float(elsewhere[i]))),
        )
        for i, row in enumerate(problem.space.found)
    )  # fmt: skip


def nominal_point(space: SearchSpace) -> FloatArray:
    """Return the model's default values (n,) in the unit cube, a little inside."""
    nominal = np.array([space.stated.get(name, space.table[name].nominal) for name in space.names])
    return np.clip(space.encode(nominal), 0.02, 0.98)


def any_noise(problem: Problem) -> bool:
    """Return whether the noise of a channel is known."""
    return bool(np.isfinite([block.noise for block in problem.blocks]).any())


def quick_expectations(problem: Problem) -> tuple[Expected, ...]:
    """Return what trials are expected to determine at the default values; takes a second.

    Nothing is expected where no noise is known.
    """
    if not any_noise(problem):
        return ()
    noise = problem.correlation()
    return expectations(problem, nominal_point(problem.space), noise)[1]


def information_by_channel(problem: Problem, view: Linearized) -> FloatArray:
    """Return which share of what is known about each found parameter comes from each channel (n, C) [1].

    From the curvature of the weighted sum of squares along the parameter.
    """
    found = len(problem.space.found)
    out = np.zeros((found, len(problem.channels)))
    for block in problem.blocks:
        part = view.jacobian.values[block.start : block.stop, :found]
        out[:, block.channel] += np.sum(part**2, axis=0)
    return out / np.maximum(out.sum(axis=1, keepdims=True), 1e-300)


def rank_candidates(
    problem: Problem,
    view: Linearized,
    others: Problem,
    titles: tuple[str, ...],
    weak: BoolArray,
    drawn: Sequence[Linearized] = (),
) -> list[CandidateRecording]:
    """Rank recordings by what they would add, the best first.

    `problem` is what was recorded, and `view` what it leaves open. `others` has the same free parameters and
    one trial per candidate; `weak` (n,) are the parameters that need more. With `drawn_outlooks` the best
    ones alone are returned, judged over the bounds as well.
    """
    widths = _with_each(problem, view, others)
    if widths is None:
        return []
    found = [row.name for row in problem.space.found]
    widths, known = widths[:, : len(found)], view.half_widths[: len(found)]
    gains = np.log(np.maximum(known, 1e-12) / np.maximum(widths, 1e-12))[:, weak].sum(axis=1)
    order = np.argsort(-gains, kind="stable")
    elsewhere = np.full(widths.shape, np.nan)
    if drawn:
        best = {*order[:_JUDGED].tolist(), *np.argmin(widths[:, weak], axis=0).tolist()}
        order = np.array([t for t in order if t in best])
        few = others.only([others.names[t] for t in sorted(best)])
        # A recording that cannot be simulated at a drawn point adds nothing there.
        every = (_with_each(problem, other, few) for other in drawn)
        filled = [np.tile(o.half_widths, (len(best), 1)) if e is None else e
                  for o, e in zip(drawn, every, strict=True)]  # fmt: skip
        elsewhere[sorted(best)] = np.median(filled, axis=0)[:, : len(found)]
    by_name = [dict(zip(found, row, strict=True)) for row in widths.tolist()]
    over_bounds = [dict(zip(found, row, strict=True)) for row in elsewhere.tolist()]
    return [
        CandidateRecording(
            title=titles[t], gain=gains[t], half_widths=by_name[t], half_widths_over_bounds=over_bounds[t],
            verdicts={name: verdict(larger(w, over_bounds[t][name])) for name, w in by_name[t].items()},
        )
        for t in order
    ]  # fmt: skip


def _with_each(problem: Problem, view: Linearized, others: Problem) -> FloatArray | None:
    """Return the half-widths (T, n) with each candidate's trial at a view's point; None where one is lost.

    The last `common` disturbances are the same in both problems (an error of a static curve), so that one
    more trial does not average them. What a trial has of its own, such as a delay of its log, is one more
    unknown with each candidate.
    """
    _, failed = others.residuals(view.point[None])
    if failed.any():
        return None
    levels = np.array([block.noise for block in others.blocks])
    # Weighted as a trial of the campaign.
    count, common = len(others.trials), problem.common
    blocks = [replace(b, weight=b.weight * count / len(problem.trials)) for b in others.blocks]
    scale, levels = scales(others, blocks, levels), np.nan_to_num(levels)
    weight = sum(b.weight * max(level, 1e-9) for b, level in zip(others.blocks, levels, strict=True))
    sample = float(np.sqrt(weight / sum(block.count for block in others.blocks)))
    derived = jacobian(others, view.point, scale, sample).values
    changes = others.disturbances(view.point)
    first = len(changes) - common
    shared = problem.disturbances(view.point)[-common:] * view.scale if common else changes[:0]
    n, m = len(view.point), len(view.jacobian.values)
    own = [i for i, row in enumerate(problem.space.free) if row.trial]
    derived = np.column_stack([derived, derived[:, own].sum(axis=1)])
    derived[:, own] = 0.0
    known = np.zeros((m, n + 1))
    known[:, :n] = view.jacobian.values
    noise = np.zeros((n + 1, n + 1))
    noise[:n, :n] = view.information.gradient_noise
    used, point = n + bool(own), np.append(view.point, 0.5)
    before = known.T @ shared.T if common else np.zeros((n + 1, 0))
    out = []
    for t in range(count):
        chosen = [b for b, block in enumerate(blocks) if block.trial == t]
        alone = np.zeros_like(derived)
        for b in chosen:
            alone[blocks[b].start : blocks[b].stop] = derived[blocks[b].start : blocks[b].stop]
        spread = gradient_noise(
            [blocks[b] for b in chosen], alone, scale, levels[chosen], view.noise, changes[:first]
        )
        after = before + alone.T @ (changes[first:] * scale).T
        both = np.concatenate([known, alone])[:, :used]
        whole = (noise + spread + after @ after.T - before @ before.T)[:used, :used]
        sigma = bounded_information(both, whole, point[:used]).sigma[:n]
        out.append(half_widths(problem.space, view.point, sigma))
    return np.array(out)
