"""Does the model explain the trials? Residuals over the noise floor, and where the misfit sits.

The noise is known without any fit: a body in free fall or at rest, and a sensor between steps, show it. What
a fit takes as known (the state in which a drop starts, tares, static curves) adds errors that last through a
whole trial; `undisturbed` takes away what their stated uncertainty explains. What is left of a right model
scores 1.0 times the noise in every channel. Velocities are mostly noise, so that a mean over channels hides a
position that is ten noise deviations off: the verdict is by the worse of the mean and the worst channel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field

from sysid.documents import Part, channel_symbol
from sysid.fit.optima import beside_noise
from sysid.fit.trial import EXPLAINED, Block, noise_floor, nrmse_of
from sysid.journal import Finding
from sysid.parameters import in_words, with_unit
from sysid.types import FloatArray

if TYPE_CHECKING:
    from sysid.fit.problem import Problem

# Residual over noise floor up to which a model explains its trials roughly [1]; beyond, it does not.
ROUGHLY = 1.5
EXPLAINED_BY, ROUGHLY_BY, NOT_BY, UNJUDGED = "explained", "roughly", "not_explained", "not_judged"
WORDS = {
    EXPLAINED_BY: "explained", ROUGHLY_BY: "roughly explained", NOT_BY: "not explained",
    UNJUDGED: "not judged",
}  # fmt: skip
# Why a fit may be bad although its model is right.
UNSEARCHED = "no run of the search has ended by itself, so a better fit is likely"
# Multiple of the standard error that noise alone gives a channel's mean residual [1]. A systematic mean
# exceeds this limit and the next one.
_ERRORS = 4.0
# Multiple of the noise's standard deviation that a systematic mean residual exceeds [1].
_OF_NOISE = 0.5
# Share of the NRMSE that errors of the measured inputs explain from which on it is told [1].
_SHOWS = 0.05
# Autocorrelation of the noise below which two samples count as independent [1].
_APART = 0.1


class ChannelAdequacy(Part):
    """Residual over noise of a channel, over all trials and by trial [1].

    ``autocorrelation`` is of the residuals, at the shortest lag at which the noise has none [1]: 0 for noise.
    """

    name: str
    ratio: float
    by_trial: dict[str, float]
    autocorrelation: float


class PhaseAdequacy(Part):
    """Residual over noise in a phase of the trials, all channels together [1]."""

    name: str
    ratio: float


class Bias(Part):
    """A mean residual, simulated less measured, that lasts through a trial [channel units].

    ``expected`` is the standard error of the mean of noise alone, ``over_noise`` the mean over the noise of a
    sample [1]. ``assumed_explains`` is whether the uncertainty of assumed values takes the mean away.
    """

    trial: str
    channel: str
    unit: str
    mean: float
    expected: float
    over_noise: float
    assumed_explains: bool

    @property
    def sentence(self) -> str:
        """The bias in words."""
        text = (
            f"{channel_symbol(self.channel)} is {with_unit(f'{self.mean:+.2g}', self.unit)} off on average "
            f"over {self.trial} (simulated less measured): {abs(self.over_noise):.1f} × its noise, which "
            f"alone leaves {with_unit(f'{self.expected:.1g}', self.unit)}"
        )
        if self.assumed_explains:
            return f"{text}; errors of the measured inputs explain it"
        return f"{text}; no error of the measured inputs explains it"


class Misfit(Part):
    """Where the misfit sits: channel, phase and trial, each with its residual over noise there [1]."""

    channel: str
    channel_ratio: float
    phase: str
    phase_ratio: float
    trial: str
    trial_ratio: float


class Adequacy(Part):
    """How far noise explains what a fit leaves.

    ``verdict`` is "explained" up to ``limits`` 1.2, "roughly" up to 1.5, else "not_explained", by the larger
    of ``ratio`` and the largest ratio of a channel. It is "roughly" as well where noise does not explain a
    misfit that is small beside the signal; ``but_for`` then states that misfit in words. ``nrmse`` is of the
    best set and ``floor`` what noise alone costs [1]; ``ratio`` is the mean NRMSE over that floor, without
    what the uncertainty of assumed values explains. Channels whose noise is not known count in neither; where
    no noise is known, ``verdict`` is "not_judged" and both are NaN. ``symptoms`` are parameters whose bound
    cuts although the model is wrong. ``biases`` are systematic residuals, largest over noise first.
    """

    verdict: str
    sentence: str
    nrmse: float
    floor: float
    ratio: float
    limits: dict[str, float]
    channels: list[ChannelAdequacy]
    phases: list[PhaseAdequacy]
    misfit: Misfit
    symptoms: list[str]
    but_for: str = ""
    biases: list[Bias] = Field(default_factory=list)


def undisturbed(blocks: Sequence[Block], residuals: FloatArray, disturbances: FloatArray) -> FloatArray:
    """Return residuals (m,) without what one-sigma changes (K, m) of the assumed values explain.

    That part lasts through a whole trial; counted as noise it would count twice. The prior of each change is
    its standard deviation, and each block is weighted by its NRMSE.
    """
    weight = np.zeros(len(residuals))
    for block in blocks:
        values = residuals[block.start : block.stop]
        weight[block.start : block.stop] = block.count / max(float(np.sum(values**2)), 1e-300)
    weighted = disturbances * weight
    normal = weighted @ disturbances.T + np.eye(len(disturbances))
    return residuals - np.linalg.solve(normal, weighted @ residuals) @ disturbances


def adequacy(
    problem: Problem,
    row: FloatArray,
    at_bound: Mapping[str, int] | None = None,
    stated_nrmse: float | None = None,
    *,
    ended: bool = True,
) -> Adequacy:
    """Judge a row (n_table,) of the parameter table [SI] on the trials of a problem.

    `at_bound` names the parameters that end at a bound of the search: -1 the lower, 1 the upper one.
    `stated_nrmse` is the NRMSE that the fit states of this row: two accuracies of a simulation differ by
    digits that no reader should meet as two numbers. A model is not blamed before a run of the search
    has `ended` by itself.
    """
    blocks = problem.blocks
    residuals, lost = problem.compared(row[None])
    residuals = residuals[:, : blocks[-1].stop]
    # A lost simulation predicts nothing, which is an NRMSE of 1.
    whole = np.ones_like(residuals[0]) if lost[0] else residuals[0]
    rest = undisturbed(blocks, whole, problem.disturbances_at(row))
    phases = [_phases(problem, t, row) for t in range(len(problem.trials))]
    noise = np.array([block.noise for block in blocks])
    weights = np.array([block.weight for block in blocks])
    nrmse = float(weights @ nrmse_of(blocks, whole)) if stated_nrmse is None else stated_nrmse
    known = np.isfinite(noise)
    if not known.any():
        return _unjudged(problem, nrmse)
    share = np.where(known, weights, 0.0) / (1.0 if known.all() else weights[known].sum())
    # As the search states it, unless errors of the measured inputs explain a part, which the sentence names.
    cost = nrmse if known.all() else float(share @ nrmse_of(blocks, whole))
    left = float(share @ nrmse_of(blocks, rest))
    left = left if left < (1.0 - _SHOWS) * cost else cost
    # Squares of residuals over noise, and samples, by channel, trial and phase.
    kinds = list(dict.fromkeys(name for names in phases for name in names))
    size = (len(problem.channels), len(problem.trials), len(kinds))
    squares, counts = np.zeros(size), np.zeros(size)
    for block, level in zip(blocks, noise, strict=True):
        if not level > 0:
            continue
        part = (rest[block.start : block.stop] / level) ** 2
        valid = problem.trials[block.trial].valid[:, block.channel]
        place = np.array([kinds.index(name) for name in phases[block.trial]])
        squares[block.channel, block.trial] += np.bincount(place, part, len(kinds))
        counts[block.channel, block.trial] += np.bincount(place, valid, len(kinds))
    used = [c for c in range(size[0]) if counts[c].any()]
    by_trial = _ratio(squares.sum(axis=2), counts.sum(axis=2))
    by_channel = _ratio(squares.sum(axis=(1, 2)), counts.sum(axis=(1, 2)))
    by_phase = _ratio(squares.sum(axis=(0, 1)), counts.sum(axis=(0, 1)))
    channel = max(used, key=lambda c: by_channel[c])
    # A phase of a few samples has no ratio worth a name: the excess over noise decides.
    excess = squares - counts
    phase = int(np.argmax(excess[channel].sum(axis=0)))
    trial = int(np.argmax(excess[channel, :, phase]))
    misfit = Misfit(
        channel=problem.channels[channel],
        channel_ratio=by_channel[channel],
        phase=kinds[phase],
        phase_ratio=float(_ratio(squares[channel, :, phase].sum(), counts[channel, :, phase].sum())),
        trial=problem.names[trial],
        trial_ratio=by_trial[channel, trial],
    )
    floor = noise_floor(blocks) if known.all() else float(share[known] @ noise[known])
    ratio = left / floor
    verdict, but_for = verdict_of(max(ratio, misfit.channel_ratio)), ""
    if verdict != EXPLAINED_BY and not lost[0] and (but_for := _small_misfit(problem, rest)):
        verdict = ROUGHLY_BY
    blamed = (at_bound or {}) if ended and verdict == NOT_BY else {}
    symptoms = [name for name, side in blamed.items() if side]
    out = Adequacy(
        verdict=verdict, sentence="", nrmse=nrmse, floor=floor, ratio=ratio,
        limits={EXPLAINED_BY: EXPLAINED, ROUGHLY_BY: ROUGHLY},
        channels=[
            ChannelAdequacy(
                name=problem.channels[c], ratio=by_channel[c], autocorrelation=_lasting(problem, rest, c),
                by_trial=dict(zip(problem.names, by_trial[c].tolist(), strict=True)),
            )
            for c in used
        ],
        phases=[PhaseAdequacy(name=name, ratio=each) for name, each in zip(kinds, by_phase, strict=True)],
        misfit=misfit, symptoms=symptoms, but_for=but_for,
        biases=[] if lost[0] else _biases(problem, whole, rest),
    )  # fmt: skip
    names = [in_words(row, of_trial=False) for row in problem.space.free if row.name in symptoms]
    return out.model_copy(update={"sentence": _sentence(out, names, problem.remedy, ended)})


def _unjudged(problem: Problem, nrmse: float) -> Adequacy:
    """Return that nothing is judged, because the noise of no channel is known."""
    none = Misfit(
        channel=problem.channels[0], channel_ratio=np.nan, phase="", phase_ratio=np.nan,
        trial=problem.names[0], trial_ratio=np.nan,
    )  # fmt: skip
    return Adequacy(
        verdict=UNJUDGED,
        sentence=f"not judged: NRMSE {100 * nrmse:.2f} %, but the noise of the channels is not known",
        nrmse=nrmse, floor=np.nan, ratio=np.nan, limits={EXPLAINED_BY: EXPLAINED, ROUGHLY_BY: ROUGHLY},
        channels=[], phases=[], misfit=none, symptoms=[],
    )  # fmt: skip


def _small_misfit(problem: Problem, residuals: FloatArray) -> str:
    """Return the misfit beyond noise of residuals (m,) in words; empty where it is not small."""
    parts = []
    for c, channel in enumerate(problem.channels):
        blocks = [block for block in problem.blocks if block.channel == c and block.count]
        if not blocks:
            continue
        squares = sum(float(np.sum((residuals[b.start : b.stop] * b.spread) ** 2)) for b in blocks)
        noise, count = sum((b.noise * b.spread) ** 2 * b.count for b in blocks), sum(b.count for b in blocks)
        if not np.isfinite(noise):
            return ""
        excess = float(np.sqrt(max(squares - noise, 0.0) / count))
        signals = [problem.trials[b.trial].measured[problem.trials[b.trial].valid[:, c], c] for b in blocks]
        share = excess / max(float(np.max(np.abs(values))) for values in signals)
        if share > problem.small:
            return ""
        if squares > EXPLAINED**2 * noise:
            size = with_unit(f"{excess:.2g}", problem.units[c])
            parts.append(f"{size}, {100 * share:.2g} % of the largest {channel.replace('_', ' ')}")
    return " and ".join(parts)


def verdict_of(ratio: float) -> str:
    """Return the verdict on a residual over noise [1]; unknown: not explained."""
    return EXPLAINED_BY if ratio <= EXPLAINED else ROUGHLY_BY if ratio <= ROUGHLY else NOT_BY


def misfit_finding(judged: Adequacy) -> tuple[Finding, ...]:
    """Return what to notice of an adequacy: nothing where noise explains the trials."""
    if judged.verdict in (EXPLAINED_BY, UNJUDGED):
        return tuple(
            Finding("systematic-residual", bias.sentence, trials=(bias.trial,), size=abs(bias.over_noise))
            for bias in judged.biases
            if not bias.assumed_explains
        )
    code = "not-explained" if judged.verdict == NOT_BY else "roughly-explained"
    size = max(judged.ratio, judged.misfit.channel_ratio)
    return (Finding(code, judged.sentence, size=size, parameters=tuple(judged.symptoms)),)


def _biases(problem: Problem, whole: FloatArray, rest: FloatArray) -> list[Bias]:
    """Return the means of residuals (m,) beyond what noise explains; `rest` is `undisturbed`."""
    model = problem.correlation()
    worth = dict(zip(model.channels, model.inflation, strict=True))
    out = []
    for block in problem.blocks:
        if not block.noise > 0:
            continue
        error = float(np.sqrt(worth[block.channel] / max(block.count, 1)))
        mean, left = (
            float(values[block.start : block.stop].sum()) / max(block.count, 1) / block.noise
            for values in (whole, rest)
        )
        if abs(mean) > max(_ERRORS * error, _OF_NOISE):
            sigma = block.noise * block.spread
            out.append(
                Bias(
                    trial=problem.names[block.trial], channel=problem.channels[block.channel],
                    unit=problem.units[block.channel], mean=mean * sigma, expected=error * sigma,
                    over_noise=mean, assumed_explains=abs(left) <= max(_ERRORS * error, _OF_NOISE),
                )
            )  # fmt: skip
    return sorted(out, key=lambda bias: -abs(bias.over_noise))


def _ratio(squares: FloatArray, counts: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(squares / np.maximum(counts, 1)))


def _phases(problem: Problem, trial: int, row: FloatArray) -> list[str]:
    """Return the phase of every sample of a trial."""
    starts, names = zip(*problem.phases(trial, row), strict=True)
    time = problem.trials[trial].time
    place = np.clip(np.searchsorted(starts, time + 1e-9, side="right") - 1, 0, len(names) - 1)
    return [names[k] for k in place]


def _lasting(problem: Problem, residuals: FloatArray, channel: int) -> float:
    """Return the correlation [1] of a channel's residuals at the shortest lag at which noise has none."""
    model = problem.correlation()
    noise = model.covariance[model.channels.index(channel), model.channels.index(channel)]
    small = np.flatnonzero(np.abs(noise) < _APART * noise[0])
    lag = int(small[0]) if len(small) else len(noise)
    above = below = 0.0
    for block in problem.blocks:
        if block.channel == channel and block.noise > 0:
            part = residuals[block.start : block.stop] / block.noise
            above += float(part[:-lag] @ part[lag:])
            below += float(part @ part)
    return above / max(below, 1e-300)


def scores_in_words(nrmse: float, floor: float, ratio: float) -> str:
    """Return the NRMSE of the best set beside the noise; numbers as in `Adequacy`.

    The ratio is without what errors of the measured inputs (curves, tares, starts) explain where that part is
    5 % or more, and the NRMSE without it stands beside.
    """
    shows = ratio * floor < (1.0 - _SHOWS) * nrmse
    explained = ", {:.2f} % without what errors of the measured inputs explain" if shows else ""
    return beside_noise(f"{100 * nrmse:.2f} %{explained.format(100 * ratio * floor)}", floor)


def _sentence(judged: Adequacy, at_bound: Sequence[str], remedy: str, ended: bool) -> str:
    word, where = WORDS[judged.verdict], judged.misfit
    scores = f"{scores_in_words(judged.nrmse, judged.floor, judged.ratio)}, {judged.ratio:.2f} × the noise"
    if judged.but_for:
        word = f"explained but for {judged.but_for}"
    if judged.verdict == EXPLAINED_BY:
        return f"{word}: {scores}; worst channel {channel_symbol(where.channel)}, {where.channel_ratio:.2f} ×"
    text = (
        f"{word}: {scores}; the misfit sits in {channel_symbol(where.channel)} ({where.channel_ratio:.1f} × "
        f"its noise), most {where.phase} ({where.phase_ratio:.1f} ×) and on {where.trial} "
        f"({where.trial_ratio:.1f} ×)"
    )
    if not ended:
        return f"{text}; {UNSEARCHED}"
    if judged.verdict == NOT_BY:
        text += "; the model lacks something, so no parameter is well known"
        text += f"; {remedy}" if remedy else ""
        if at_bound:
            are = "ends" if len(at_bound) == 1 else "end"
            text += f"; {', '.join(at_bound)} {are} at a bound, which is a symptom of that"
    return text
