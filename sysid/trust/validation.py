"""A prediction against a trial that was not fitted: how far off, from when on, and is that more than noise.

Bouncing is chaotic: a difference grows from contact to contact until nothing is predicted any more, even by
the true model. So the score is also taken up to the third touchdown, and the end of a landing is compared as
a distribution. A prediction is judged by the ratio of its NRMSE to what noise alone would cost: 1 for the
true model, more by what the parameters' own uncertainty adds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid.fit.problem import Trial
from sysid.types import FloatArray

# Of the NRMSE over its noise floor, mean over trials: whole windows, and up to the third touchdown.
RATIO, RATIO_EARLY = 1.5, 1.25
# A sample this number of noise deviations away does not belong to the prediction; this number in a row are no
# outliers.
LEAVES, IN_A_ROW = 5.0, 3


@dataclass(frozen=True, eq=False)
class Judged:
    """One trial against the prediction of the best set.

    Parameters
    ----------
    nrmse : (S,) array
        Weighted mean over channels of every set [1].
    by_channel : (C,) array
        Of the best set [1].
    floor : float
        Weighted mean of what noise alone costs [1]; NaN where not known.
    early : (nrmse, floor), or None
        The same up to `early_until`.
    early_until : float or None
        Third touchdown since the first one [s].
    leaves : dict or None
        Time, channel, contacts before; see `sysid.trust.documents`.
    """

    name: str
    nrmse: FloatArray
    by_channel: FloatArray
    floor: float
    early: tuple[float, float] | None
    early_until: float | None
    leaves: dict[str, Any] | None

    @property
    def ratio(self) -> float:
        """NRMSE of the best set over the floor [1]."""
        return float(self.nrmse[0] / self.floor)

    @property
    def early_ratio(self) -> float:
        """The same up to the third touchdown [1]; NaN where it was not scored."""
        return float("nan") if self.early is None else self.early[0] / self.early[1]


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
) -> Judged:
    """Compare a trial with its prediction.

    Parameters
    ----------
    nrmse, by_channel
        See `Judged`; the best set comes first.
    simulated : (n, C) array
        With the best set, as compared [channel units].
    spread : (C,) array
        What NRMSE divides by [channel units].
    noise : (C,) array
        Standard deviation of the noise as compared [channel units]; NaN where not known.
    weights : (C,) array
        Of the channels.
    contacts : (k,) array, optional
        Touchdowns of the prediction on the trial's clock [s]; of a trial without contacts: none.
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
        early, until = (float(np.sum(share * rms)), floor), end - trial.zero
    away = np.abs(error) > LEAVES * noise / safe
    away &= valid & used & np.isfinite(noise)
    leaves = None
    row = np.ones(IN_A_ROW, dtype=np.int64)
    for c in range(len(channels) if len(time) >= IN_A_ROW else 0):
        runs = np.flatnonzero(np.convolve(away[:, c].astype(np.int64), row, "valid") == IN_A_ROW)
        if len(runs) and (leaves is None or time[runs[0]] - trial.zero < leaves["time"]):
            at = float(time[runs[0]])
            before = 0 if contacts is None else int(np.count_nonzero(contacts <= at))
            leaves = {"time": at - trial.zero, "channel": channels[c], "after_contacts": before}
    return Judged(trial.name, nrmse, by_channel, floor, early, until, leaves)


def reasons(trials: Sequence[Judged]) -> tuple[str, ...]:
    """Return why a prediction is flagged, one sentence per number; none where noise explains it."""
    out = []
    whole, early = [judged.ratio for judged in trials], [judged.early_ratio for judged in trials]
    for ratios, limit, where, meaning in (
        (whole, RATIO, "", "the model or its held values are wrong for these trials"),
        (early, RATIO_EARLY, " up to the third touchdown", "chaos does not explain it"),
    ):
        if np.isfinite(ratios).any() and np.nanmean(ratios) > limit:
            worst = int(np.nanargmax(ratios))
            out.append(
                f"NRMSE{where} is {np.nanmean(ratios):.2f} × what noise alone costs, mean over {len(trials)} "
                f"trials (limit {limit:g}; worst {trials[worst].name}, {ratios[worst]:.2f} ×): {meaning}"
            )
    return tuple(out)


def document(judged: Judged, channels: Sequence[str]) -> dict[str, Any]:
    """Return a judged trial for JSON."""
    return {
        "name": judged.name,
        "nrmse": judged.nrmse,
        "by_channel": dict(zip(channels, judged.by_channel.tolist(), strict=True)),
        "floor": judged.floor,
        "ratio": judged.ratio,
        "nrmse_third_contact": None if judged.early is None else judged.early[0],
        "ratio_third_contact": None if judged.early is None else judged.early_ratio,
        "third_contact": judged.early_until,
        "leaves": judged.leaves,
    }


def summary(trials: Sequence[Judged], nrmse_fitted: float) -> dict[str, Any]:
    """Return what a validation or cross-validation states of all trials together, for JSON."""
    why = reasons(trials)
    return {
        "flagged": bool(why),
        "reasons": list(why),
        "limits": {"ratio": RATIO, "ratio_third_contact": RATIO_EARLY, "leaves": LEAVES},
        "nrmse": float(np.mean([judged.nrmse[0] for judged in trials])),
        "nrmse_fitted": nrmse_fitted,
        "ratio": float(np.mean([judged.ratio for judged in trials])),
        "ratio_third_contact": float(np.mean([judged.early_ratio for judged in trials])),
    }
