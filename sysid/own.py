"""A model of one's own: a Python function that simulates one trial, its parameters, channels and logs.

`sysid.model` makes one. Logs are text tables whose columns state units, or any file that `sysid.load_log`
reads. What the function does, vectorized or not, compiled or not, is its own business; an exception, a number
that is not finite and a simulation without end are counted failures.
"""

from __future__ import annotations

import ctypes
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from pydantic import ConfigDict, Field

from sysid.campaign import FitTable
from sysid.campaign.common import CampaignTable, TomlTable, TrialTable
from sysid.campaign.file import resolve_log
from sysid.errors import CampaignError, FitError, LogError, UnitError
from sysid.filters import shown_noise
from sysid.fit.kind import Kind, Term, begin
from sysid.fit.nrmse import CostChannel, FilteredNrmse, TrialTarget
from sysid.fit.problem import Problem
from sysid.fit.trial import Prediction, Trial, name_order
from sysid.journal import notice
from sysid.loaders import load
from sysid.loaders.columns import NamedTable
from sysid.loaders.options import LogOptions
from sysid.loaders.source import Source
from sysid.parameters import ParameterTable, SearchSpace
from sysid.recording import file_sha256
from sysid.types import FloatArray
from sysid.units import parse_quantity

Simulate = Callable[[Any, FloatArray, Mapping[str, Any]], Any]
CAUSES = (
    "simulate raised an exception", "simulate returned NaN or infinity", "simulate did not end in time",
    "simulate returned another shape",
)  # fmt: skip
_RAISED, _NOT_FINITE, _ENDLESS, _SHAPE = 1, 2, 3, 4
# Points between the bounds at which a model is tried before a fit.
_TRIED = 4
_TIME = ("time", "t", "timestamp")


class OwnTrial(TrialTable):
    """One log; further keys are quantities that the model's function reads."""

    model_config = ConfigDict(extra="allow", frozen=True)


class OwnCost(TomlTable):
    """`[cost]`: the NRMSE, with the weight of each channel."""

    denominator: Literal["std", "range"] = "std"
    weights: Mapping[str, float] = Field(default_factory=dict)


class OwnLog(TomlTable):
    """`[log]`: names and units of the columns of text logs that do not state them."""

    columns: dict[str, str | int] | list[str] | None = None
    units: Mapping[str, str] = Field(default_factory=dict)


class OwnCampaign(CampaignTable):
    """Logs of a model of one's own; `noise` is the standard deviation of a channel's samples."""

    cost: OwnCost = OwnCost()
    fit: FitTable = FitTable()
    log: OwnLog = OwnLog()
    noise: Mapping[str, str] = Field(default_factory=dict)
    trials: tuple[OwnTrial, ...]


@dataclass(frozen=True, eq=False)
class OwnModel:
    """What `sysid.model` was given, checked."""

    name: str
    simulate: Simulate
    table: ParameterTable
    # Names of the free parameters, of terms, and of parameters that every trial has for itself.
    free: tuple[str, ...]
    terms: tuple[str, ...]
    by_trial: tuple[str, ...]
    # SI units by name.
    channels: Mapping[str, str]
    inputs: Mapping[str, str]
    vectorized: bool
    # Longest time of one simulation [s].
    patience: float

    def kind(self) -> Kind:
        """Return the kind that the verbs know."""
        terms = tuple(Term(name.replace("_", " "), (name,)) for name in self.terms)
        return Kind(self.name, OwnCampaign, self._open, begin=_begin, terms=terms)

    def check_channels(self, where: str, names: Iterable[str]) -> None:
        """Refuse names that are not channels; CampaignError says `where` they stand."""
        for name in names:
            if name not in self.channels:
                known = ", ".join(self.channels)
                raise CampaignError(f"{where}: no channel {name!r}; {self.name} has {known}")

    def _open(self, campaign: OwnCampaign, path: Path, threads: int | None) -> OwnProblem:
        self.check_channels("cost.weights", campaign.cost.weights)
        self.check_channels("noise", campaign.noise)
        for name, text in campaign.noise.items():
            if not parse_quantity(text, self.channels[name]) > 0:
                raise CampaignError(f"noise: {name} = {text!r}; expected more than 0")
        logs = tuple(self._log(campaign, entry, path) for entry in campaign.trials)
        rows, drawn = [], sorted((log.name for log in logs), key=name_order)
        for row in self.table.values():
            rows += [row.of_trial(name) for name in drawn] if row.name in self.by_trial else [row]
        table = ParameterTable(rows)
        held = {log.name for log in logs if log.use != "fit"}
        free = [row.name for row in rows if row.common_name in self.free and row.trial not in held]
        return OwnProblem(campaign, campaign.parameters.search_space(table, free, {}), self, logs, threads)

    def _log(self, campaign: OwnCampaign, entry: OwnTrial, path: Path) -> OwnRecord:
        given = dict(entry.__pydantic_extra__ or {})
        constants = {}
        for name, value in given.items():
            if name not in self.inputs:
                known = ", ".join(self.inputs) or "none"
                refusal = f"trials[{entry.name!r}]: {name!r} is no input of {self.name}; it has {known}"
                raise CampaignError(refusal)
            unit = self.inputs[name]
            try:
                constants[name] = parse_quantity(str(value), unit)
            except UnitError as error:
                raise CampaignError(f"trials[{entry.name!r}].{name}: {error}") from None
        series = {name: unit for name, unit in self.inputs.items() if name not in given}
        log = resolve_log(path, entry.log)
        instants, columns = read_columns(log, {**self.channels, **series}, campaign.log)
        measured = np.column_stack([columns[name] for name in self.channels])
        for name in series:
            if not np.isfinite(columns[name]).all():
                raise LogError(f"{log}: {name}: has blank samples, and simulate reads it; fill or cut them")
        inputs = {name: columns[name] for name in (*self.channels, *series)} | constants
        # A function that computes in place would change the data that it is compared with.
        for values in (instants, *columns.values()):
            values.setflags(write=False)
        record = {"log": entry.log, "sha256": file_sha256(log)}
        return OwnRecord(entry.name, entry.use, instants, measured, inputs, record)


@dataclass(frozen=True, eq=False)
class OwnRecord:
    """One log as it is compared; `inputs` are what the model's function finds in its third argument."""

    name: str
    use: Literal["fit", "validate"]
    time: FloatArray
    measured: FloatArray
    inputs: Mapping[str, Any]
    provenance: Mapping[str, Any]


def read_columns(
    path: Path, units: Mapping[str, str], options: OwnLog
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return the instants (n,) [s] of a log and its columns (n,) in SI units, by name.

    Channels of other clocks are interpolated. LogError, UnitError where a column or its unit is missing.
    """
    source = Source(path)
    if b"\0" in source.head:
        recording = load(path)
        first = recording[next(iter(units))]
        return first.time, {
            name: np.interp(first.time, recording[name].time, recording[name].values) for name in units
        }
    table = NamedTable(source, LogOptions(units=dict(options.units) or None, columns=options.columns or None))
    clock = table.find(_TIME)
    if clock is None:
        raise table.missing("time, such as 'time [s]'")
    found = {}
    for name in units:
        column = table.find((name.replace("_", " ").casefold(),))
        if column is None:
            raise table.missing(f"{name!r}")
        found[name] = column
    factors = {
        name: table.declared.factor(found[name], name, unit, "1" if unit == "1" else None)
        for name, unit in units.items()
    }
    second = table.declared.factor(clock, "time", "s")
    table.declared.check_used(table.columns)
    numbers = table.read([clock, *found.values()])
    instants = numbers.columns[clock.index] * second
    if len(instants) < 3 or not np.all(np.diff(instants) > 0):
        raise LogError(f"{path}: time does not increase from row to row; sort the rows or cut the log")
    return instants, {name: numbers.columns[found[name].index] * factors[name] for name in units}


@dataclass(frozen=True, eq=False)
class OwnProblem(Problem):
    """Prepared trials of a campaign under a model of one's own."""

    campaign: OwnCampaign
    space: SearchSpace
    model: OwnModel
    records: tuple[OwnRecord, ...]
    threads: int | None = None
    # First message by cause, of this problem and those made of it.
    messages: dict[int, str] = field(default_factory=dict)
    causes = CAUSES

    @property
    def lost_advice(self) -> str:
        """First message of every cause."""
        return "; ".join(self.messages.values())

    @cached_property
    def trials(self) -> tuple[Trial, ...]:
        """The trials."""
        return tuple(
            Trial(log.name, log.use, log.time, log.measured, np.isfinite(log.measured), log.provenance, 0.0)
            for log in self.records
        )

    @cached_property
    def cost(self) -> FilteredNrmse:
        """The NRMSE."""
        targets = [TrialTarget(log.name, log.measured) for log in self.records]
        weights = self.campaign.cost.weights
        channels = [
            CostChannel(name, unit, c, weight=weights.get(name, 1.0))
            for c, (name, unit) in enumerate(self.model.channels.items())
        ]
        return FilteredNrmse(targets, channels, self.campaign.cost.denominator)

    @cached_property
    def noise(self) -> FloatArray:
        """(T, C) as the campaign states it, else as the log shows it [channel units]."""
        stated = {
            name: parse_quantity(text, self.model.channels[name])
            for name, text in self.campaign.noise.items()
        }
        names = list(self.model.channels)
        return np.array([
            [stated.get(name, shown_noise(log.measured[:, c])) for c, name in enumerate(names)]
            for log in self.records
        ])  # fmt: skip

    def only(self, names: Sequence[str]) -> OwnProblem:
        """Return the problem of some of the trials, in the order of their `names`."""
        return replace(self, records=tuple(self.records[self.names.index(name)] for name in names))

    @cached_property
    def _places(self) -> list[dict[str, int]]:
        """Columns of a row by the names that the function reads, for each trial."""
        index, own = self.space.table.index, self.model.by_trial
        return [
            {name: index[f"{name}[{log.name}]" if name in own else name] for name in self.model.table}
            for log in self.records
        ]

    def predict(self, rows: FloatArray) -> Prediction:
        """Simulate and score rows of the whole parameter table (P, n_table) [SI]; return the signals too."""
        samples = np.full((len(rows), self.cost.n_total, len(self.model.channels)), np.nan)
        cause = np.zeros((len(rows), len(self.records)), dtype=np.int8)
        signals = tuple(samples[:, a:b] for a, b in pairwise(self.cost.offsets.tolist()))
        numbers = rows.tolist()
        for t, (log, places) in enumerate(zip(self.records, self._places, strict=True)):
            if self.model.vectorized:
                values = {name: rows[:, [i]] for name, i in places.items()}
                cause[:, t] = self._simulated(values, log, signals[t])
                continue
            for p, row in enumerate(numbers):
                one = {name: row[i] for name, i in places.items()}
                cause[p, t] = self._simulated(one, log, signals[t][p])
        by_channel, failed = self.cost(samples, threads=self.threads)
        for p, t in zip(*np.nonzero(failed & (cause == 0)), strict=True):
            lost = {name: numbers[p][i] for name, i in self._places[t].items()}
            cause[p, t] = self._keep(_NOT_FINITE, self.records[t], lost, "")
        return Prediction(by_channel, cause, signals)

    def _simulated(self, values: Mapping[str, Any], log: OwnRecord, out: FloatArray) -> int:
        """Simulate into `out` (..., n, C); return the cause of a failure, 0 without one."""
        try:
            try:
                _WATCH.begin(self.model.patience)
                got = self.model.simulate(values, log.time, MappingProxyType(log.inputs))
            finally:
                _WATCH.end()
            got = np.asarray(got, dtype=np.float64)
        except _OverdueError:
            return self._keep(_ENDLESS, log, values, f"still ran after {self.model.patience:g} s")
        except Exception as error:
            return self._keep(_RAISED, log, values, _said(error))
        if got.shape != out.shape:
            if got.shape != out.shape[:-1] or out.shape[-1] != 1:
                one = "(P, n, channels), for P candidates" if self.model.vectorized else "(n, channels)"
                said = f"{got.shape}; expected {out.shape}, which is {one}"
                return self._keep(_SHAPE, log, values, said)
            got = got[..., None]
        out[...] = got
        return 0

    def _keep(self, cause: int, log: OwnRecord, values: Mapping[str, Any], said: str) -> int:
        if cause not in self.messages:
            numbers = {name: float(np.ravel(value)[0]) for name, value in values.items()}
            at = ", ".join(f"{name} {value:.4g}" for name, value in numbers.items())
            self.messages[cause] = f"{CAUSES[cause - 1]}{f' ({said})' if said else ''} on {log.name} at {at}"
        return cause

    def results(self, rows: FloatArray) -> Any:
        """Return every trial, measured and simulated; say what the first failure of each cause was."""
        for cause, message in self.messages.items():
            notice("simulate-failed", f"{message}; such candidates are lost (code {cause})")
        return super().results(rows)


def try_out(problem: Problem) -> None:
    """Try a model inside the bounds; FitError where it cannot be fitted."""
    fitted, kind = problem.fitted, problem.campaign.kind
    space, samples = fitted.space, fitted.blocks[-1].stop
    drawn = np.random.default_rng(0).random((_TRIED, len(space.free)))
    points = np.vstack([np.full(len(space.free), 0.5), drawn])
    base, failed = fitted.residuals(points)
    if failed.all():
        raise FitError(f"{kind}: {fitted.lost_advice}; and so at every point that was tried")
    for i, row in enumerate(space.free):
        moved = points.copy()
        moved[:, i] = (moved[:, i] + 0.37) % 1.0
        other, lost = fitted.residuals(moved)
        if np.array_equal(base[~failed, :samples], other[~failed, :samples]) and not lost[~failed].any():
            raise FitError(
                f"{kind}: no residual moves with {row.name}; the simulation must read {row.common_name!r}, "
                "or the campaign must fix it under [parameters.fixed]"
            )


def _begin(problem: Problem) -> None:
    try_out(problem)
    begin(problem)


def _said(error: Exception) -> str:
    """Return an exception in words, with the line of the user's file."""
    frames = traceback.extract_tb(error.__traceback__)
    place = f", {Path(frames[1].filename).name} line {frames[1].lineno}" if len(frames) > 1 else ""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}{place}"


class _OverdueError(BaseException):
    """Raised inside a simulation that takes too long; an ``except Exception`` of it does not catch this."""


class _Watch:
    """Ends simulations that take too long, in any thread; one thread watches all."""

    def __init__(self) -> None:
        self._lock, self._until = threading.Lock(), dict[int, float]()
        self._thread: threading.Thread | None = None

    def begin(self, seconds: float) -> None:
        self._until[threading.get_ident()] = time.monotonic() + seconds
        if self._thread is None or not self._thread.is_alive():
            self._thread = threading.Thread(target=self._look, daemon=True)
            self._thread.start()

    def end(self) -> None:
        with self._lock:
            self._until.pop(threading.get_ident(), None)
        # An exception that is on its way arrives at this call.
        (lambda: None)()

    def _look(self) -> None:
        raise_there = ctypes.pythonapi.PyThreadState_SetAsyncExc
        while True:
            time.sleep(0.05)
            with self._lock:
                for ident, until in list(self._until.items()):
                    if time.monotonic() > until:
                        del self._until[ident]
                        raise_there(ctypes.c_ulong(ident), ctypes.py_object(_OverdueError))


_WATCH = _Watch()
