"""`sysid compare FIT FIT...`: do two fits differ by more than they may, and which predicts what best?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import FitError
from sysid.fit.problem import Problem
from sysid.fit.result import FitResult
from sysid.journal import Journal
from sysid.parameter_sets import ParameterSets
from sysid.trust.comparison import compare_values, unjudged
from sysid.trust.documents import TRUST, read_part
from sysid.types import FloatArray
from sysid.workflows.predict import open_under, predict
from sysid.workflows.reopen import OpenedFit, open_fit


def compare_fits(
    folders: Sequence[Path],
    *,
    cross: bool = True,
    threads: int | None = None,
    say: Callable[[str], None] | None = None,
) -> tuple[dict[str, Any], tuple[ParameterSets, ...]]:
    """Compare fits of one kind.

    Parameters
    ----------
    folders : sequence of Path
        Fit folders, two or more; their campaigns must lie where they lay.
    cross : bool
        Predict every fit's trials with every other fit's best set.

    Returns
    -------
    document : dict
        ``fits`` (names), ``differences`` (per parameter and pair), ``cross`` (NRMSE of the fits' best sets by
        the campaigns' trials) or None, ``sentences``, ``warnings``.
    sets : tuple of ParameterSets

    Raises
    ------
    FitError
        For fewer than two fits, or fits of several kinds.
    """
    if len(folders) < 2:
        raise FitError("one fit compares with nothing; name two or more")
    with Journal(say) as journal:
        opened = [open_fit(folder, None, threads) for folder in folders]
        kinds = sorted({fit.result.kind for fit in opened})
        if len(kinds) > 1:
            raise FitError(f"a {kinds[0]} and a {kinds[1]} fit share no parameters; compare fits of one kind")
        names = _labels(folders)
        documents = [read_part(fit.folder, TRUST) for fit in opened]
        # Two fits of one campaign share its name; a table's columns must not.
        sets = tuple(
            replace(fit.result.parameter_sets(), name=label) for fit, label in zip(opened, names, strict=True)
        )
        missing = [label for label, found in zip(names, documents, strict=True) if found is None]
        if missing:
            journal.tell(
                f"{', '.join(missing)}: no profile intervals, so no difference is judged (runs that reach "
                "one optimum agree whatever the data leave open); run sysid trust on each"
            )
        differences = compare_values(names, sets, documents)
        table = _cross(opened, threads) if cross else None
    lines = [one["sentence"] for one in differences if one["differs"]]
    lines += unjudged(differences)
    if table is not None:
        for j, label in enumerate(names):
            best = int(np.argmin(table[:, j]))
            lines.append(
                f"the trials of {label} are predicted best by {names[best]} ({100 * table[best, j]:.2f} %)"
            )
    document = {
        "fits": list(names),
        "kind": kinds[0],
        "differences": differences,
        "cross": None if table is None else table,
        "sentences": lines,
        "warnings": journal.sentences(),
    }
    return document, sets


def _labels(folders: Sequence[Path]) -> tuple[str, ...]:
    short = [folder.name for folder in folders]
    return tuple(short if len(set(short)) == len(short) else [folder.as_posix() for folder in folders])


def _cross(opened: Sequence[OpenedFit], threads: int | None) -> FloatArray:
    """Return the NRMSE (F, F) of the best set of each fit (row) on the fitted trials of each (column)."""
    out = np.full((len(opened), len(opened)), np.nan)
    for j, home in enumerate(opened):
        for i, guest in enumerate(opened):
            predicted = predict(guest.result, _under(guest.result, home, threads))
            out[i, j] = float(predicted.problem.cost.mean(predicted.found.by_channel)[0])
    return out


def _under(fit: FitResult, home: OpenedFit, threads: int | None) -> Problem:
    """Return the fitted trials of an opened fit under the law of another fit."""
    whole = home.whole
    if home.kind.under(whole.campaign, fit.settings)[0] != whole.campaign:
        whole = open_under(fit, home.path, threads)[1]
    return whole.only(whole.fitted.names)
