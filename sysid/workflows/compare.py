"""`sysid compare FIT FIT...`: do two fits differ by more than they may, and which predicts what best?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.errors import FitError
from sysid.journal import Journal, Say
from sysid.parameter_sets import ParameterSets
from sysid.trust.comparison import compare_values, unjudged
from sysid.trust.documents import TRUST, read_part
from sysid.types import FloatArray
from sysid.workflows.predict import open_under, predict
from sysid.workflows.reopen import OpenedFit, open_fit


def compare_fits(
    folders: Sequence[Path], *, cross: bool = True, threads: int | None = None, say: Say = None
) -> tuple[dict[str, Any], tuple[ParameterSets, ...]]:
    """Compare fits of one kind; return the comparison and the sets of each fit.

    The campaigns of the fits must lie where they lay. With `cross`, every fit's best set predicts every other
    fit's trials: ``cross`` is the NRMSE of the fits' best sets by the campaigns' trials, or None. The other
    keys are ``fits`` (names), ``kind``, ``differences`` (per parameter and pair), ``sentences`` and
    ``warnings``. Raises `FitError` for fewer than two fits, or fits of several kinds.
    """
    if len(folders) < 2:
        raise FitError("one fit compares with nothing; name two or more")
    with Journal(say) as journal:
        opened = [open_fit(folder, None, threads) for folder in folders]
        kinds = sorted({fit.result.kind for fit in opened})
        if len(kinds) > 1:
            raise FitError(f"a {kinds[0]} and a {kinds[1]} fit share no parameters; compare fits of one kind")
        short = [folder.name for folder in folders]
        names = short if len(set(short)) == len(short) else [folder.as_posix() for folder in folders]
        documents = [read_part(fit.folder, TRUST) for fit in opened]
        # Two fits of one campaign share its name; a table's columns must not.
        sets = tuple(
            replace(fit.result.parameter_sets(), name=label) for fit, label in zip(opened, names, strict=True)
        )
        missing = [label for label, document in zip(names, documents, strict=True) if document is None]
        if missing:
            journal.tell(
                f"{', '.join(missing)}: no profile intervals, so no difference is judged (runs that reach "
                "one optimum agree whatever the data leave open); run sysid trust on each"
            )
        differences = compare_values(names, sets, documents)
        table = _cross(opened, threads) if cross else None
    lines = [row["sentence"] for row in differences if row["differs"]]
    lines += unjudged(differences)
    if table is not None:
        for j, label in enumerate(names):
            best = int(np.argmin(table[:, j]))
            lines.append(
                f"the trials of {label} are predicted best by {names[best]} ({100 * table[best, j]:.2f} %)"
            )
    document = {
        "fits": names,
        "kind": kinds[0],
        "differences": differences,
        "cross": table,
        "sentences": lines,
        "warnings": journal.sentences(),
    }
    return document, sets


def _cross(opened: Sequence[OpenedFit], threads: int | None) -> FloatArray:
    """Return the NRMSE (F, F) of the best set of each fit (row) on the fitted trials of each (column)."""
    out = np.full((len(opened), len(opened)), np.nan)
    for j, home in enumerate(opened):
        for i, guest in enumerate(opened):
            fit, whole = guest.result, home.whole
            # The trials are taken under the law of the fit that predicts them.
            if home.kind.under(whole.campaign, fit.settings)[0] != whole.campaign:
                whole = open_under(fit, home.path, threads)[1]
            predicted = predict(fit, whole.only(whole.fitted.names))
            out[i, j] = float(predicted.problem.cost.mean(predicted.scored.by_channel)[0])
    return out
