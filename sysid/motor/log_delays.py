"""The command delay of every log: instruments have their own clocks, and one delay for all would blur steps.

A log that the search sees has a free delay of its own; the set's `command_delay` is their mean, which serves
logs that have none. The delay that fits a held-out log best is reported beside its score, never used for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid.motor.targets import PreparedTrial
from sysid.parameters import ParameterTable, SearchSpace
from sysid.types import FloatArray

_NAME = "command_delay"
MEAN_SOURCE = "mean of the fitted logs' own delays"


def delay_name(log: str) -> str:
    """Return the name of a log's own delay in a table of parameters."""
    return f"{_NAME}[{log}]"


def with_log_delays(
    space: SearchSpace, fitted: Sequence[PreparedTrial], late: Sequence[PreparedTrial]
) -> SearchSpace:
    """Give every log its own delay where the common one is free and there are several logs.

    The delays of the logs of `fitted`, the trials of the dynamic fit, become free; those of `late`, which the
    stage after it sees, are held at the mean until then.
    """
    first = list(dict.fromkeys(trial.entry.log for trial in fitted))
    others = [log for log in dict.fromkeys(t.entry.log for t in late) if log not in first]
    if _NAME not in space.names or len(first) + len(others) < 2:
        return space
    common = next(row for row in space.free if row.name == _NAME)
    rows = [
        replace(
            common.of_trial(log),
            meaning=f"Time from a command in {log} to the voltage, instruments included; no motor physics.",
        )
        for log in (*first, *others)
    ]
    free = tuple(row for row in space.free if row.name != _NAME)
    return SearchSpace(
        ParameterTable([*space.table.values(), *rows]),
        (*free, *rows[: len(first)]),
        {**space.fixed, _NAME: common.nominal, **{row.name: common.nominal for row in rows[len(first) :]}},
    )


def own_rows(space: SearchSpace) -> tuple[str, ...]:
    """Return the names of the logs' own delays in a table, free or not."""
    return tuple(row.name for row in space.table.values() if row.trial and row.common_name == _NAME)


def averaged(space: SearchSpace, rows: FloatArray) -> FloatArray:
    """Return rows (P, n) whose common delay, and that of logs not fitted yet, is the mean of the free."""
    index = space.table.index
    own = own_rows(space)
    free = [index[name] for name in own if name in space.names]
    if free:
        rows = np.array(rows, dtype=np.float64)
        mean = rows[:, free].mean(axis=1)
        for name in (_NAME, *(name for name in own if name not in space.names)):
            rows[:, index[name]] = mean
    return rows


def shifts(table: ParameterTable, rows: FloatArray, trials: Sequence[PreparedTrial]) -> FloatArray | None:
    """Return what each trial adds to the common delay (P, T) [s]; None where no row has delays of logs."""
    index = table.index
    common = index[_NAME]
    columns = [index.get(delay_name(trial.entry.log), common) for trial in trials]
    if rows.shape[1] != len(table) or {*columns} == {common}:
        return None
    return np.asarray(rows[:, columns] - rows[:, [common]], dtype=np.float64)
