"""What several runs say about each other: which of them ended in the same optimum.

Two runs ended in the same optimum when neither their NRMSE nor their place in the unit cube differs by more
than a search can tell: NRMSE by less than 0.2 %, every free parameter by less than 2 % of its range plus the
widths over which the candidates of either run scored within 0.2 % of its best. A parameter that the data do
not determine is wide, or left out, so it does not separate runs that agree otherwise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.fit.history import RunHistory
from sysid.fit.stopping import REASONS, StopReason
from sysid.journal import Finding
from sysid.parameter_sets import ParameterRecord
from sysid.parameters import Parameter, SearchSpace, about, common_name, in_words, with_unit
from sysid.types import BoolArray, FloatArray, IntArray

# Relative difference of NRMSE that tells optima apart: twice what adaptive integration leaves uncertain.
SAME_NRMSE = 2e-3
# Distance along an axis of the unit cube within which two places are one, as a share of its edge [1].
SAME_PLACE = 0.02
# Relative difference of NRMSE that no search resolves [1], three times the tolerance of CMA-ES as the only
# finisher.
ENDS_WITHIN = 3e-5
# Reasons that end a run before its stop rule does.
CUT: tuple[StopReason, ...] = ("interrupted", "time", "evaluations", "generations")
# Least relative spread of a parameter over equally good sets at which a finding names the parameter [1].
_NAMED = 0.01
# A free parameter, of whose search scale and bounds must be known.
Searched = Parameter | ParameterRecord
# The data do not determine a parameter when equally good candidates spread over more than a factor
# (logarithmic scale), a share of its range (linear scale).
_FACTOR, _SHARE = 3.0, 1 / 3


@dataclass(frozen=True, eq=False)
class Agreement:
    """Runs grouped by the optimum in which they ended."""

    # Runs (from 0), best first; the other arrays are in the order of the runs.
    order: tuple[int, ...]
    # (R,) optimum (from 0, best first).
    optimum: IntArray
    # (R,) NRMSE [1].
    cost: FloatArray
    # Reason that cut a run short; None for a run that ended by itself. Where a run was cut is no optimum.
    cut: tuple[StopReason | None, ...]
    # Runs that the fit was to have, including those that were not begun [1].
    asked: int
    # NRMSE that noise alone costs [1]; sentences state it beside the NRMSE.
    floor: float | None = None

    @property
    def unfinished(self) -> bool:
        """True when a run was cut short, or never begun."""
        return any(self.cut) or len(self.cost) < self.asked

    @property
    def finished(self) -> int:
        """Runs that ended by themselves [1]."""
        return sum(reason is None for reason in self.cut)

    @property
    def reached(self) -> int:
        """Runs that ended in the best optimum [1]."""
        return int(np.count_nonzero(self.optimum == 0))

    @property
    def agrees(self) -> bool:
        """True when every run ended in the best optimum."""
        return self.reached == len(self.cost) and not self.unfinished

    def sentence(self) -> str:
        """Return what the runs say about the result, in one sentence."""
        runs, best = len(self.cost), float(self.cost.min())
        if self.unfinished:
            return self._unfinished(runs, best)
        if runs == 1:
            return "a single run cannot say whether its optimum is the best one; ask for more with --runs 5"
        if self.agrees:
            return f"{runs} of {runs} runs reached the same optimum ({self._scored(best)})"
        others = self.cost[self.optimum != 0]
        places = int(self.optimum.max())
        word = "optimum" if places == 1 else "optima"
        if others.max() <= best * (1 + SAME_NRMSE):
            return (
                f"{self.reached} of {runs} runs reached the best optimum and the others end as low in "
                f"{places} other {word}: the data prefer none of these sets; sysid show prints them side by "
                "side"
            )
        alone = " alone" if self.reached == 1 else ""
        return (
            f"the runs disagree: {self.reached} of {runs}{alone} reached the best optimum "
            f"({self._scored(best)}), the others end at {others.min() / best:.3f} to "
            f"{others.max() / best:.3f} × it in {places} other {word}: sets beyond the best optimum are "
            "local ones; ask for more runs with --runs 20"
        )

    def _scored(self, nrmse: float) -> str:
        return beside_noise(f"{100 * nrmse:.2f} %", self.floor)

    def _unfinished(self, runs: int, best: float) -> str:
        reasons = ", ".join(dict.fromkeys(REASONS[reason] for reason in self.cut if reason))
        cut = sum(bool(reason) for reason in self.cut)
        why = f" ({reasons})" if reasons else ""
        if runs < self.asked:
            whole = "none" if cut == runs else "all" if not cut else str(runs - cut)
            text = (
                f"{runs} of {self.asked} runs {'was' if runs == 1 else 'were'} begun, {whole} of them "
                f"finished{why}, which says nothing about optima yet; best so far: {self._scored(best)}"
            )
        else:
            text = (
                f"{cut} of {runs} runs {'was' if cut == 1 else 'were'} not finished{why} and "
                f"{'says' if cut == 1 else 'say'} nothing about optima yet; best so far: "
                f"{self._scored(best)}"
            )
        ended = self.cost[[not reason for reason in self.cut]]
        if len(ended):
            text += f", the finished ones end at {ended.min() / best:.3f} to {ended.max() / best:.3f} × it"
        if {*self.cut} & {"time", "interrupted"} or runs < self.asked:
            return text + "; continue with --resume"
        return text + "; start again with a larger limit"


def agreement(
    runs: Sequence[RunHistory],
    asked: int | None = None,
    free: Sequence[Searched] = (),
    floor: float | None = None,
) -> Agreement:
    """Group runs, at least one of the `asked` ones, by the optimum in which they ended.

    `free` are the parameters along the cube's axes; those that are `unfixed` do not tell optima apart.
    Without `free` all axes count. `floor` is the NRMSE that noise alone costs [1].
    """
    determined = ~unfixed(runs, free) if free else np.ones(runs[0].best_point.shape, dtype=bool)
    cost = np.array([run.best[-1] for run in runs])
    place = np.stack([run.best_point for run in runs])
    # Half widths (n_free,) [1] over which a run's candidates scored as well as its best.
    width = np.stack([np.asarray(np.ptp(_good([run], SAME_NRMSE), axis=0)) / 2 for run in runs])
    order = np.argsort(cost, kind="stable")
    optimum = np.full(len(runs), -1, dtype=np.int64)
    first: list[int] = []
    for run in order:
        for number, other in enumerate(first):
            near = abs(cost[run] - cost[other]) <= SAME_NRMSE * cost[other]
            apart = np.abs(place[run] - place[other])
            if near and np.all((apart <= SAME_PLACE + width[run] + width[other]) | ~determined):
                optimum[run] = number
                break
        else:
            optimum[run] = len(first)
            first.append(int(run))
    cut = tuple(run.stop_reason if run.stop_reason in CUT else None for run in runs)
    return Agreement(tuple(int(i) for i in order), optimum, cost, cut, asked or len(runs), floor)


def beside_noise(nrmse: str, floor: float | None) -> str:
    """Return an NRMSE as people read it: beside what noise alone costs [1], where that is known."""
    return f"NRMSE {nrmse}" + (f" (noise alone: {100 * floor:.2f} %)" if floor and floor > 0 else "")


def _good(runs: Sequence[RunHistory], within: float) -> FloatArray:
    """Return all candidates (k, n_free) of runs that score within a share of their best NRMSE."""
    limit = min(float(run.best[-1]) for run in runs) * (1 + within)
    return np.concatenate([stage.cube[stage.cost <= limit] for run in runs for stage in run.stages])


def unfixed(runs: Sequence[RunHistory], free: Sequence[Searched]) -> BoolArray:
    """Return which free parameters (n_free,) the data do not determine, judged from all candidates.

    The candidates within 0.2 % of the best NRMSE spread over more than a factor of three (logarithmic scale)
    or a third of the range (linear). That is a lower bound: a search does not explore what does not pay.
    """
    width = np.ptp(_good(runs, SAME_NRMSE), axis=0)
    out = np.zeros(len(width), dtype=np.bool_)
    for i, (row, share) in enumerate(zip(free, width, strict=True)):
        if row.lower is not None and row.upper is not None:
            log = row.scale == "log"
            out[i] = share * np.log(row.upper / row.lower) > np.log(_FACTOR) if log else share > _SHARE
    return out


def loose_findings(
    runs: Sequence[RunHistory], space: SearchSpace, ranges: bool = True
) -> tuple[Finding, ...]:
    """Return which free parameters the data do not determine, judged from the candidates.

    Without `ranges`, where intervals say how far a value may be off or none can be read, no spread is stated.

    An `unfixed` parameter is not identifiable. Of the others those are named whose value differs by more than
    1 % between candidates within 0.003 % of the best NRMSE, which no search tells apart, or between runs that
    end within 0.2 % of it. Runs that were cut short do not count: far from an optimum candidates score alike
    for other reasons.
    """
    runs = [run for run in runs if run.stop_reason not in CUT]
    if not runs:
        return ()
    low, high = _span(runs, space, SAME_NRMSE)
    wide = unfixed(runs, space.free)
    wide[len(space.found) :] = False
    # Runs that end in one optimum may end in neighbouring dents of it.
    best = min(float(run.best[-1]) for run in runs)
    ends = space.decode(np.stack([r.best_point for r in runs if r.best[-1] <= (1 + SAME_NRMSE) * best]))
    least, most = _span(runs, space, ENDS_WITHIN)
    least, most = np.minimum(least, ends.min(axis=0)), np.maximum(most, ends.max(axis=0))
    spread = (most - least) / np.maximum(np.abs(most + least) / 2, np.finfo(float).tiny)
    out = []
    for i in np.flatnonzero(wide):
        row = space.free[i]
        span = f"from {low[i]:.2g} to {with_unit(f'{high[i]:.2g}', row.unit)}" if ranges else "far apart"
        sentence = (
            f"{in_words(row, of_trial=False)} is not identifiable: sets {span} score within "
            f"{100 * SAME_NRMSE:g} % of the best NRMSE; do not read digits into it"
        )
        out.append(about(row, "not-identifiable", sentence, float(high[i] - low[i])))
    weak = np.flatnonzero((~wide & (spread > _NAMED))[: len(space.found)]) if ranges and len(runs) > 1 else ()
    if len(weak):
        shares = ", ".join(f"{in_words(space.free[i])} {100 * spread[i]:.2g} %" for i in weak)
        sentence = (
            f"identifiable no better than this, over sets that score within {100 * ENDS_WITHIN:g} % of the "
            f"best NRMSE, or with which a run ended within {100 * SAME_NRMSE:g} % of it: {shares}"
        )
        names = tuple(dict.fromkeys(common_name(space.free[i]) for i in weak))
        out.append(Finding("weakly-identifiable", sentence, parameters=names))
    return tuple(out)


def _span(runs: Sequence[RunHistory], space: SearchSpace, within: float) -> tuple[FloatArray, FloatArray]:
    """Return least and largest value (n_free,) [SI] of all candidates within a share of the best NRMSE."""
    good = _good(runs, within)
    return space.decode(good.min(axis=0)), space.decode(good.max(axis=0))


def waterfall(runs: Sequence[RunHistory], free: Sequence[Searched] = ()) -> list[str]:
    """Return a table of all runs, best first: NRMSE, its ratio to the best, optimum, cost, why it ended.

    A run that was cut short reached no optimum: a dash. `free` as for `agreement`.
    """
    groups = agreement(runs, free=free)
    best = float(groups.cost.min())
    lines = [
        f"{'rank':>4}  {'run':>3}  {'NRMSE':>9}  {'× best':>7}  {'optimum':>7}  {'candidates':>10}  ended"
    ]
    for rank, i in enumerate(groups.order, start=1):
        run = runs[i]
        lines.append(
            f"{rank:>4}  {i + 1:>3}  {100 * groups.cost[i]:>7.2f} %  {groups.cost[i] / best:>7.4f}  "
            f"{'-' if groups.cut[i] else _letter(int(groups.optimum[i])):>7}  {run.evaluations:>10}  "
            f"{REASONS[run.stop_reason]}"
        )
    return lines


def _letter(number: int) -> str:
    """Return A to Z, AA, AB, …"""
    more, last = divmod(number, 26)
    return (_letter(more - 1) if more else "") + chr(ord("A") + last)
