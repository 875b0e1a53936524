"""`sysid compare FIT FIT...`: do two fits differ by more than they may, and which predicts what best?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from sysid.campaign import GearCampaign, MotorCampaign
from sysid.errors import FitError
from sysid.gear.problem import GearObjective
from sysid.motor.objective import MotorObjective
from sysid.parameter_sets import ParameterSets
from sysid.trust.comparison import compare_values, unjudged
from sysid.trust.documents import TRUST, read_part
from sysid.workflows.predicted_rows import gear_rows, motor_rows
from sysid.workflows.reopen import OpenedFit, open_fit, table_rows
from sysid.workflows.search import collected_warnings


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
    threads : int, optional
    say : callable, optional

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
    tell = say or (lambda sentence: None)
    with collected_warnings(lambda text: tell(f"warning: {text}")) as doubts:
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
            tell(
                f"{', '.join(missing)}: no profile intervals, so no difference is judged (runs that reach "
                "one optimum agree whatever the data leave open); run sysid trust on each"
            )
        differences = compare_values(names, sets, documents)
        table = _cross(opened) if cross else None
    said = [one["sentence"] for one in differences if one["differs"]]
    said += unjudged(differences)
    if table is not None:
        for j, label in enumerate(names):
            best = int(np.argmin(table[:, j]))
            said.append(
                f"the trials of {label} are predicted best by {names[best]} ({100 * table[best, j]:.2f} %)"
            )
    document = {
        "fits": list(names),
        "kind": kinds[0],
        "differences": differences,
        "cross": None if table is None else table,
        "sentences": said,
        "warnings": list(doubts),
    }
    return document, sets


def _labels(folders: Sequence[Path]) -> tuple[str, ...]:
    short = [folder.name for folder in folders]
    return tuple(short if len(set(short)) == len(short) else [folder.as_posix() for folder in folders])


def _cross(opened: Sequence[OpenedFit]) -> np.ndarray:
    """Return the NRMSE (F, F) of the best set of each fit (row) on the fitted trials of each (column).

    A set brings what it has found, and what it held where the campaign states nothing of it; what that
    campaign fixes or measures (vehicle, surface, rotor) and its clocks are its own, and so is the friction,
    a fitted one as well, where the laws differ.
    """
    out = np.full((len(opened), len(opened)), np.nan)
    for j, home in enumerate(opened):
        for i, guest in enumerate(opened):
            if isinstance(home.campaign, GearCampaign):
                rows = table_rows(home)[:1]
                if i != j:
                    rows = gear_rows(guest.result, home.campaign, rows[0])[:1]
                out[i, j] = float(_gear_objective(home).score(rows).cost[0])
            else:
                assert isinstance(home.campaign, MotorCampaign)
                rows = table_rows(home)[:1]
                if i != j:
                    rows = _motor_rows(guest, home, rows[0])
                objective = home.problem.objective
                assert isinstance(objective, MotorObjective)
                out[i, j] = float(objective.cost.mean(objective.score(rows)[0])[0])
    return out


def _gear_objective(opened: OpenedFit) -> GearObjective:
    objective = opened.problem.objective
    assert isinstance(objective, GearObjective)
    return objective


def _motor_rows(guest: OpenedFit, home: OpenedFit, base: np.ndarray) -> np.ndarray:
    """Return a row of a guest's motor; delays and lags of instruments stay the campaign's own."""
    assert isinstance(home.campaign, MotorCampaign)
    assert home.bench is not None
    rows = motor_rows(guest.result, home.campaign, home.bench, home.space, base)[:1]
    for k, row in enumerate(home.space.table.values()):
        if row.group == "instrument":
            rows[:, k] = base[k]
    return rows
