"""Draws of a fit as parameter sets: what every verb takes that carries the uncertainty on."""

from collections.abc import Mapping
from dataclasses import replace
from numbers import Integral
from pathlib import Path

import numpy as np

from sysid.errors import FitError, shell
from sysid.export import load_parameter_sets
from sysid.fit.result import FitResult
from sysid.fit.store import fit_folder, read_fit
from sysid.journal import notice
from sysid.parameter_sets import DRAWS, ParameterSets
from sysid.trust.documents import TRUST, TrustDocument, read_arrays, stating_intervals, use_of
from sysid.trust.draws import evenly, joint_draws, normally
from sysid.types import FloatArray
from sysid.workflows.reopen import OpenedFit, reopen

# Largest number of draws: a hundred times what decides a map.
_MOST = 10_000


def draw_values(
    opened: OpenedFit, document: TrustDocument, arrays: Mapping[str, FloatArray], count: int
) -> FloatArray:
    """Return every number of draws (count, n) as the sets of a fit have them [SI].

    What a follow-up of the search has found has the value of the best set, or is uniform over its interval.
    """
    space, result = opened.space, opened.result
    best, judged = result.values[0], result.judged
    rows = space.full(joint_draws(space, document, arrays, count))
    kept = [i for i in range(rows.shape[1]) if i not in space.columns and np.isfinite(best[i])]
    rows[:, kept] = best[kept]
    names = [result.parameters[i].name for i in kept]
    intervals = {name: judged[name].interval_95 for name in names if name in judged}
    rows[:, [kept[names.index(name)] for name in intervals]] = evenly(intervals, count)
    for several, covariance in opened.kind.unmoved(opened.whole).items():
        if {*several} <= {*names}:
            rows[:, [kept[names.index(name)] for name in several]] += normally(several, covariance, count)
    return opened.kind.numbers(opened.whole, rows)


def stored_draws(folder: Path, fit: FitResult) -> FloatArray | None:
    """Return the draws (n, parameters) [SI] that a fit folder stores; None where it has none."""
    if TrustDocument.read(folder) is None:
        return None
    values = read_arrays(folder, TRUST).get("draws")
    return values if values is not None and values.shape[1] == len(fit.parameters) else None


def drawn_sets(source: str | Path, count: int) -> ParameterSets:
    """Return draws of a fit as sets, in place of the ranked ones; their rank is the number of the draw.

    The first ones that the fit stores; of more than these, all are made again, which needs the campaign.
    Raises `FitError` where the fit has no intervals, or an older version computed them.
    """
    if not (isinstance(count, Integral) and 1 <= count <= _MOST):
        raise FitError(f"{count!r:.60} draws of {source}: expected 1 or more, up to {_MOST}, for example 50")
    folder = fit_folder(Path(source))
    if Path(source).is_file() and folder == Path(source):
        raise FitError(
            f"{source}: --draws {count} needs the folder of a fit, and this is a file; name the folder that "
            "sysid fit wrote, or leave --draws out"
        )
    fit = read_fit(source)
    document = TrustDocument.read(folder)
    if document is None:
        raise FitError(
            f"{folder}: has no intervals, so nothing can be drawn; run sysid trust {shell(folder)} first"
        )
    values = stored_draws(folder, fit)
    if values is None:
        raise FitError(
            f"{folder}: its intervals are of an older version, without draws; run sysid trust {shell(folder)}"
        )
    if count > len(values):
        opened = reopen(folder, fit, None, None)
        values = draw_values(opened, document, read_arrays(folder, TRUST), count)
    sets, nothing = stating_intervals(fit, document, use_of(folder)).parameter_sets(), (0,) * count
    return replace(
        sets,
        values=values[:count],
        at_bound=np.zeros((count, len(sets.names)), dtype=np.int8),
        nrmse=np.full(count, np.nan),
        nrmse_by_trial=np.full((count, *sets.nrmse_by_trial.shape[1:]), np.nan),
        runs=nothing,
        seeds=nothing,
        provenance={**sets.provenance, DRAWS: count},
    )


def sets_or_draws(source: str | Path, draws: int | None, *, best: bool = False) -> ParameterSets:
    """Return the ranked sets of a fit folder or file, or that number of draws of a fit.

    With `best`, a source without intervals gives its best set to all draws.
    """
    if draws is None:
        return load_parameter_sets(source)
    if best and not (Path(source).is_dir() and load_parameter_sets(source).judged):
        notice("not-drawn", f"{source}: is no fit with intervals, so its best set goes with every draw")
        return load_parameter_sets(source)
    return drawn_sets(source, draws)
