"""The command delay of every log: instruments have different clocks, and one delay for all would blur steps.

Every log that the search sees has a free delay; the set's `command_delay` is their mean, which serves logs
without a delay. The delay that fits a held-out log best is reported with its score, never used for it.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePath

import numpy as np

from sysid.motor.targets import PreparedTrial
from sysid.parameters import ParameterTable, SearchSpace
from sysid.types import FloatArray

_NAME = "command_delay"
MEAN_SOURCE = "mean of the delays of the fitted logs"


def delay_name(log: str) -> str:
    """Return the name of a log's delay in a table of parameters."""
    return f"{_NAME}[{log}]"


def with_log_delays(
    space: SearchSpace, fitted: Sequence[PreparedTrial], late: Sequence[PreparedTrial]
) -> SearchSpace:
    """Give every log a delay where the common one is free and there are several logs.

    The delays of the logs of `fitted`, the trials of the dynamic fit, become free; the delays of the logs of
    `late`, the trials of the stage after it, stay at the mean until then.
    """
    first = list(dict.fromkeys(trial.entry.log for trial in fitted))
    logs = list(dict.fromkeys([*first, *(trial.entry.log for trial in late)]))
    if _NAME not in space.names or len(logs) < 2:
        return space
    common = next(row for row in space.free if row.name == _NAME)
    meaning = "Time from a command in {} to the voltage, instruments included; no motor physics."
    # Tables show the file's name without its suffix, where that names one log.
    stems = {log: PurePath(log).stem for log in logs}
    short = stems if len({*stems.values()}) == len(logs) else {log: log for log in logs}
    rows = [
        replace(common.of_trial(log), symbol=f"{common.symbol} of {short[log]}", meaning=meaning.format(log))
        for log in logs
    ]
    free = tuple(row for row in space.free if row.name != _NAME)
    return SearchSpace(
        ParameterTable([*space.table.values(), *rows]),
        (*free, *rows[: len(first)]),
        {**space.fixed, **{row.name: common.nominal for row in (common, *rows[len(first) :])}},
    )


def log_rows(space: SearchSpace) -> tuple[str, ...]:
    """Return the names of the delays of logs in a table, free or not."""
    return tuple(row.name for row in space.table.values() if row.trial and row.common_name == _NAME)


def averaged(space: SearchSpace, rows: FloatArray) -> FloatArray:
    """Return rows (P, n) [SI] whose common delay, and every delay not fitted yet, is the mean of the free."""
    index, delays = space.table.index, log_rows(space)
    free = [index[name] for name in delays if name in space.names]
    if free:
        rows = np.array(rows, dtype=np.float64)
        late = [index[name] for name in (_NAME, *delays) if name not in space.names]
        rows[:, late] = rows[:, free].mean(axis=1)[:, None]
    return rows


def shifts(table: ParameterTable, rows: FloatArray, trials: Sequence[PreparedTrial]) -> FloatArray | None:
    """Return what each trial adds to the common delay (P, T) [s]; None where no row has delays of logs."""
    index = table.index
    common = index[_NAME]
    columns = [index.get(delay_name(trial.entry.log), common) for trial in trials]
    if rows.shape[1] != len(table) or {*columns} == {common}:
        return None
    return np.asarray(rows[:, columns] - rows[:, [common]], dtype=np.float64)
