"""A prediction against a trial that was not fitted: how far off, from when on, and is that more than noise.

Bouncing is chaotic: a difference grows from contact to contact until nothing is predicted any more, even by
the true model. So the score is also taken up to the third touchdown, and the end of a landing is compared as
a distribution. A prediction is judged by the ratio of its NRMSE to what noise alone would cost: 1 for the
true model, more by what the parameters' own uncertainty adds.
"""

from collections.abc import Sequence

import numpy as np

from sysid.fit.adequacy import UNSEARCHED
from sysid.fit.result import FitResult
from sysid.fit.trial import Trial
from sysid.trust.documents import JudgedTrial, Leaves, Overall
from sysid.trust.use import PREDICTS, judged_use
from sysid.types import FloatArray

# Limits of the NRMSE over its noise floor, mean over trials [1]: whole windows, up to the third touchdown.
RATIO, RATIO_EARLY = 1.5, 1.25
# A sample this number of noise deviations away does not belong to the prediction; this number in a row are no
# outliers.
LEAVES, IN_A_ROW = 5.0, 3


def judge(
    trial: Trial,
    nrmse: FloatArray,
    by_channel: FloatArray,
    simulated: FloatArray,
    *,
    spread: FloatArray,
    noise: FloatArray,
    weights: FloatArray,
    channels: Sequence[str],
    contacts: FloatArray | None = None,
) -> JudgedTrial:
    """Compare a trial with its prediction.

    `nrmse` (S,) is the weighted mean over channels of every set, best first [1]; `by_channel` (C,) and
    `simulated` (n, C) are NRMSE [1] and samples as compared [channel units] of the best set. `spread` (C,) is
    what NRMSE divides by, `noise` (C,) the noise's standard deviation, NaN where not known [channel units].
    `contacts` (k,) are the prediction's touchdowns on the trial's clock [s]; None for a model without.
    """
    used = weights > 0
    share = np.where(used, weights, 0.0) / weights[used].sum()
    safe = np.where(spread > 0, spread, 1.0)
    time, valid = trial.time, trial.valid
    error = np.where(valid, simulated - trial.measured, 0.0) / safe
    floor = float(np.sum((share * noise / safe)[used]))
    early, until = None, None
    if contacts is not None:
        end = float(contacts[2]) if len(contacts) > 2 else float(time[-1])
        first = valid & (time <= end)[:, None]
        count = np.maximum(first.sum(axis=0), 1)
        rms = np.sqrt(np.sum(np.where(first, error, 0.0) ** 2, axis=0) / count)
        early, until = float(np.sum(share * rms)), end - trial.zero
    away = np.abs(error) > LEAVES * noise / safe
    away &= valid & used & np.isfinite(noise)
    leaves: Leaves | None = None
    # Without contacts, nothing but the log's clock tells a reader where to look.
    zero = 0.0 if contacts is None else trial.zero
    row = np.ones(IN_A_ROW, dtype=np.int64)
    for c in range(len(channels) if len(time) >= IN_A_ROW else 0):
        runs = np.flatnonzero(np.convolve(away[:, c].astype(np.int64), row, "valid") == IN_A_ROW)
        if len(runs) and (leaves is None or time[runs[0]] - zero < leaves.time):
            at = float(time[runs[0]])
            before = 0 if contacts is None else int(np.count_nonzero(contacts <= at))
            leaves = Leaves(time=at - zero, channel=channels[c], after_contacts=before)
    return JudgedTrial(
        name=trial.name,
        nrmse=nrmse.tolist(),
        by_channel=dict(zip(channels, by_channel.tolist(), strict=True)),
        floor=floor,
        ratio=float(nrmse[0] / floor),
        nrmse_third_contact=early,
        ratio_third_contact=None if early is None else early / floor,
        third_contact=until,
        leaves=leaves,
    )


def _ratios(trials: Sequence[JudgedTrial]) -> tuple[FloatArray, FloatArray]:
    """Return the NRMSE over its floor (T,): of whole windows, up to the third touchdown (else NaN)."""
    rows = [(trial.ratio, trial.ratio_third_contact) for trial in trials]
    whole, early = np.array(rows, dtype=np.float64).T
    return whole, early


def reasons(trials: Sequence[JudgedTrial], *, predicts: bool = False, ended: bool = True) -> tuple[str, ...]:
    """Return why a prediction is flagged, one sentence per number; none where noise explains it.

    The fixed values need not be wrong where the numbers of use lie within their bands (`predicts`), or where
    no run of the search has ended (`ended` is False).
    """
    out = []
    within = "more than noise, yet the numbers of use lie within their bands"
    whole, early = _ratios(trials)
    for ratios, limit, where, cause in (
        (whole, RATIO, "", "the model or its fixed values are wrong for these trials"),
        (early, RATIO_EARLY, " up to the third touchdown", "chaos does not explain it"),
    ):
        if np.isfinite(ratios).any() and np.nanmean(ratios) > limit:
            worst = int(np.nanargmax(ratios))
            meaning = cause if ended else UNSEARCHED
            meaning = within if predicts else meaning
            out.append(
                f"NRMSE{where} is {np.nanmean(ratios):.2f} × what noise alone costs, mean over {len(trials)} "
                f"trials (limit {limit:g}; worst {trials[worst].name}, {ratios[worst]:.2f} ×): {meaning}"
            )
    return tuple(out)


def judgement(trials: Sequence[JudgedTrial], fit: FitResult, *, drawn: bool) -> Overall:
    """Return what a validation or cross-validation states of all trials together, for its document.

    What is of use has a word where predictions by draws stand behind the trials' numbers (`drawn`).
    """
    use = judged_use(((trial.numbers, trial.ends) for trial in trials), drawn=drawn)
    why = reasons(trials, predicts=use.word == PREDICTS, ended=fit.agreement.finished > 0)
    whole, early = _ratios(trials)
    return Overall(
        flagged=bool(why),
        reasons=list(why),
        limits={"ratio": RATIO, "ratio_third_contact": RATIO_EARLY, "leaves": LEAVES},
        nrmse=float(np.mean([trial.nrmse[0] for trial in trials])),
        nrmse_fitted=float(fit.nrmse[0]),
        ratio=float(np.mean(whole)),
        ratio_third_contact=float(np.mean(early)),
        use=use,
    )
