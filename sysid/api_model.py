"""A model of one's own for Python: `model`, and campaigns of its trials."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Collection, Mapping
from numbers import Real
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from sysid.api import Campaign, plain
from sysid.errors import CampaignError, UnitError
from sysid.own import OwnModel
from sysid.parameters import Parameter, ParameterTable
from sysid.storage import check_file, path_of, write_file
from sysid.types import FloatArray
from sysid.units import factor_to_si, in_si
from sysid.workflows.kinds import register

Spec = tuple[float, float, str] | tuple[float, float, str, str]
Recorded = pd.DataFrame | str | Path
# Bounds this far apart are searched on a logarithmic scale [1].
_DECADE = 10.0
_MARKS = ("term", "each trial")
_TAKEN = {"name", "log", "use", "time"}


class Model:
    """A model of your own, registered as a kind: campaigns of that kind are checked, fitted and reported."""

    def __init__(self, content: OwnModel) -> None:
        self.content = content
        register(content.kind())

    def __repr__(self) -> str:
        content = self.content
        return f"<Model {content.name}: {', '.join(content.table)}; compares {', '.join(content.channels)}>"

    @property
    def name(self) -> str:
        """Name of the kind, which campaign files state."""
        return self.content.name

    def campaign(
        self, trials: Mapping[str, Recorded], folder: str | Path | None = None, *,
        inputs: Mapping[str, Mapping[str, float | str]] | None = None, validate: Collection[str] = (),
        noise: Mapping[str, str | float] | None = None, weights: Mapping[str, float] | None = None,
        force: bool = False,
    ) -> Campaign:  # fmt: skip
        """Write a campaign of trials, and return it; files of that name are replaced only with `force`.

        Parameters
        ----------
        trials : mapping
            Tables or recorded files by name. A table has the time [s] as its index or as the column ``time``;
            a column states its unit, ``angle [deg]``, or is in SI.
        folder : path, optional
            Where the campaign goes; without it, it lasts as long as this object and the fits of it.
        inputs : mapping, optional
            Quantities of each trial that `simulate` reads, such as ``{"swing-1": {"load": "0.2 kg"}}``;
            a bare number has no unit, and is refused where the model's input has one.
        validate : collection of str
            Names of the trials that are not fitted.
        noise : mapping, optional
            Standard deviation of the samples of channels, such as ``{"angle": "0.5 deg"}``, instead of what
            the logs show.
        weights : mapping, optional
            Weight of each channel in the mean, by default 1.
        """
        kept = TemporaryDirectory(prefix="sysid-") if folder is None else None
        place = Path(kept.name) if kept else path_of(folder, "the folder of the campaign")
        if not isinstance(trials, Mapping) or not trials:
            refusal = CampaignError(f"trials: expected tables or files by name, found {trials!r:.60}")
            raise refusal.also(TypeError)
        _check_mappings(inputs=inputs or {}, noise=noise or {}, weights=weights or {})
        validate = (validate,) if isinstance(validate, str) else validate
        if not isinstance(validate, Collection):
            refusal = CampaignError(f"validate {validate!r:.60}: expected names of trials")
            raise refusal.also(TypeError)
        unknown = [name for name in (*validate, *(inputs or {})) if name not in trials]
        if unknown:
            raise CampaignError(f"no trial {unknown[0]!r}; there are {', '.join(trials)}").also(KeyError)
        self.content.check_channels("weights", weights or {})
        self.content.check_channels("noise", noise or {})
        given = {name: self._inputs(name, (inputs or {}).get(name, {})) for name in trials}
        tables = {
            name: self._table(name, recorded, given[name])
            for name, recorded in trials.items()
            if isinstance(recorded, pd.DataFrame)
        }
        try:
            place.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CampaignError(f"{place}: cannot be made ({error.strerror}); name another folder") from error
        check_file(place / "campaign.toml", force=force, error_type=CampaignError)
        lines = [f"kind = {json.dumps(self.name)}", f'name = "{place.name if folder else self.name}"']
        stated = {
            name: _quantity(value, self.content.channels[name]) for name, value in (noise or {}).items()
        }
        weighted = {name: in_si(value, "1", f"weights: {name}") for name, value in (weights or {}).items()}
        for table, values in (("cost.weights", weighted), ("noise", stated)):
            lines += [f"[{table}]"] if values else []
            lines += [f"{json.dumps(name)} = {json.dumps(value)}" for name, value in values.items()]
        for number, (name, recorded) in enumerate(trials.items(), start=1):
            log = f"{number}-{re.sub(r'[^A-Za-z0-9._-]', '_', str(name))[:60]}.csv"
            if name in tables:
                check_file(place / log, force=force, error_type=CampaignError)
                write_file(place / log, tables[name].encode("utf-8"), CampaignError)
            else:
                log = Path(os.path.relpath(path_of(recorded, "a log"), place)).as_posix()
            lines += ["[[trials]]", f"name = {json.dumps(name)}", f"log = {json.dumps(log)}"]
            lines += ['use = "validate"'] if name in validate else []
            lines += [f"{json.dumps(key)} = {json.dumps(value)}" for key, value in given[name].items()]
        write_file(place / "campaign.toml", ("\n".join(lines) + "\n").encode("utf-8"), CampaignError)
        return Campaign.read(place / "campaign.toml", kept)

    def _inputs(self, name: str, given: Mapping[str, float | str]) -> dict[str, str]:
        """Return the inputs of a trial as a campaign states them."""
        _check_mappings(**{f"inputs of trial {name!r}": given})
        known = self.content.inputs
        if unknown := [one for one in given if one not in known]:
            has = ", ".join(known) or "none"
            refusal = f"trial {name!r}: {unknown[0]!r} is no input of {self.name}; it has {has}"
            raise CampaignError(refusal).also(KeyError)
        for one, value in given.items():
            if not isinstance(value, str) and known[one] != "1":
                refusal = f"trial {name!r}: {one} = {value!r} has no unit; write '{value} {known[one]}'"
                raise CampaignError(refusal).also(ValueError)
        return {one: _quantity(value, known[one]) for one, value in given.items()}

    def _table(self, name: str, frame: pd.DataFrame, inputs: Mapping[str, str]) -> str:
        """Return a table as a text log, every column with its unit."""
        columns: dict[str, FloatArray] = {}
        clock = next((c for c in frame.columns if str(c).split("[")[0].strip() in ("time", "t")), None)
        try:
            columns["time [s]"] = (frame.index if clock is None else frame[clock]).to_numpy(dtype=np.float64)
            for column in frame.columns:
                stem = str(column).split("[")[0].strip()
                unit = {**self.content.channels, **self.content.inputs}.get(stem)
                if column != clock and unit is not None:
                    head = f"{column}" if "[" in str(column) else f"{stem} [{unit}]"
                    columns[head] = frame[column].to_numpy(dtype=np.float64)
        except (TypeError, ValueError) as error:
            refusal = CampaignError(f"trial {name!r}: a column is not of numbers ({error})")
            raise refusal.also(TypeError) from None
        have = {column.split("[")[0].strip() for column in columns}
        if lacking := [channel for channel in self.content.channels if channel not in have]:
            found = ", ".join(map(str, frame.columns))
            raise CampaignError(
                f"trial {name!r}: no column for the channel {lacking[0]!r}; found {found}; name it as the "
                "model does"
            ).also(KeyError)
        if lacking := [one for one in self.content.inputs if one not in have and one not in inputs]:
            raise CampaignError(
                f"trial {name!r}: no column for the input {lacking[0]!r}; add the column, or state a number "
                f"for the trial: inputs={{{name!r}: {{{lacking[0]!r}: ...}}}}"
            ).also(KeyError)
        return pd.DataFrame(columns).to_csv(index=False)


def model(
    name: str, simulate: Callable[[Any, FloatArray, Mapping[str, Any]], Any], *,
    parameters: Mapping[str, Spec], channels: Mapping[str, str], inputs: Mapping[str, str] | None = None,
    vectorized: bool = False, patience: str | float = 60.0,
) -> Model:  # fmt: skip
    """Make a model of your own, for which fit, check, trust, explain, validate, report and export work.

    ``simulate(values, time, trial)`` returns what the trial should have measured: an array (n, channels), or
    (n,) for one channel. `values` has a number for every parameter [SI], `time` (n,) are the log's instants
    [s], and `trial` has the measured channels and the inputs by name. Both are
    read-only: copy what you change. An exception, NaN, another shape and a
    simulation longer than `patience` [s] are counted failures; compiled code cannot be ended.

    Parameters
    ----------
    name : str
        What campaigns state as their ``kind``.
    parameters : mapping
        ``(lower, upper, unit)`` by name, in SI. A fourth item ``"term"`` marks physics that is 0 unless
        `explain` adds it, ``"each trial"`` a number that every trial has for itself. Bounds a decade apart
        are searched on a logarithmic scale. A campaign file states others, and fixed values, with units:
        ``[parameters.bounds]`` ``rate = ["0.5 1/s", "20 1/s"]``, ``[parameters.fixed]`` ``rate = "3 1/s"``.
    channels : mapping
        SI unit of every compared channel, by its name in the logs.
    inputs : mapping, optional
        SI unit of what else `simulate` reads: columns of the logs, or quantities of each trial.
    vectorized : bool
        `simulate` gets values of shape (P, 1) and returns (P, n) or (P, n, channels).

    Examples
    --------
    >>> import numpy as np, pandas as pd, sysid
    >>> def simulate(values, time, trial):
    ...     return values["start"] * np.exp(-values["rate"] * time) + values["rest"]
    >>> decay = sysid.model(
    ...     "decay", simulate, channels={"level": "V"},
    ...     parameters={"rate": (0.1, 10, "1/s"), "start": (0.1, 5, "V"), "rest": (-1, 1, "V", "term")},
    ... )
    >>> decay
    <Model decay: rate, start, rest; compares level>
    >>> isinstance(decay, sysid.Model)
    True
    >>> time, noise = np.arange(100) / 100, np.random.default_rng(1)
    >>> level = lambda: 2 * np.exp(-3 * time) + 0.3 + 0.01 * noise.standard_normal(100)
    >>> trials = {f"run-{k}": pd.DataFrame({"level": level()}, index=time) for k in range(5)}
    >>> fit = sysid.fit_campaign(decay.campaign(trials), runs=2)
    >>> fit.verdict.split(",")[0]
    'not explained'
    >>> sysid.explain(fit).document.parameters
    ['rest']
    """
    _check_mappings(parameters=parameters, channels=channels, inputs=inputs or {})
    given = dict(parameters)
    if not isinstance(name, str) or not name.isidentifier() or name in ("gear", "motor"):
        raise CampaignError(f"name {name!r:.60}: expected one word other than gear and motor").also(
            ValueError
        )
    if not callable(simulate):
        refusal = CampaignError(f"simulate {simulate!r:.60}: expected a function of values, time, trial")
        raise refusal.also(TypeError)
    if not given or not channels:
        raise CampaignError(f"{name}: expected one parameter and one channel at least").also(ValueError)
    for what, units in (("channels", channels), ("inputs", inputs or {})):
        for one, unit in units.items():
            if one in _TAKEN:
                refusal = CampaignError(f"{what}: {one!r} has a meaning in campaigns; choose another name")
                raise refusal.also(ValueError)
            _check_si(f"{what}: {one}", unit)
    chosen = [_row(one, spec) for one, spec in given.items()]
    marks = {one: spec[3] for one, spec in given.items() if len(spec) == 4}
    terms = tuple(one for one, mark in marks.items() if mark == "term")
    seconds = in_si(patience, "s", "patience")
    if not seconds > 0:
        raise CampaignError(f"patience = {patience!r}: expected a time above 0, in s").also(ValueError)
    if both := [one for one in channels if one in (inputs or {})]:
        raise CampaignError(
            f"{both[0]!r} is a channel and an input; simulate finds the channels in `trial` as well"
        ).also(ValueError)
    return Model(OwnModel(
        name, simulate, ParameterTable(chosen), tuple(one for one in given if one not in terms), terms,
        tuple(one for one, mark in marks.items() if mark == "each trial"), dict(channels), dict(inputs or {}),
        vectorized, seconds,
    ))  # fmt: skip


def _check_mappings(**given: object) -> None:
    """Refuse what is no mapping."""
    for what, mapping in given.items():
        if not isinstance(mapping, Mapping):
            raise CampaignError(f"{what} {mapping!r:.60}: expected a mapping by name").also(TypeError)


def _row(name: str, spec: Any) -> Parameter:
    """Return a row of the parameter table; CampaignError where it is none."""
    expected = f"{name}: {spec!r:.80}; expected (lower, upper, 'unit'), such as (0.5, 2.0, 'm')"
    if not isinstance(spec, tuple | list) or len(spec) not in (3, 4) or not isinstance(spec[2], str):
        raise CampaignError(expected).also(TypeError)
    if len(spec) == 4 and spec[3] not in _MARKS:
        raise CampaignError(f"{name}: {spec[3]!r:.60}; expected 'term' or 'each trial'").also(ValueError)
    try:
        low, high = float(spec[0]), float(spec[1])
    except (TypeError, ValueError, OverflowError):
        raise CampaignError(expected).also(TypeError) from None
    if isinstance(spec[0], str) or isinstance(spec[1], str) or not np.isfinite([low, high]).all():
        raise CampaignError(expected).also(ValueError)
    _check_si(name, spec[2])
    term = spec[3:] == ("term",)
    if term and not low <= 0 <= high:
        refusal = CampaignError(f"{name}: a term is absent at 0, which is outside {low:g} to {high:g}")
        raise refusal.also(ValueError)
    wide = low > 0 and high / low >= _DECADE
    nominal = 0.0 if term else float(np.sqrt(low * high)) if wide else (low + high) / 2
    return Parameter(
        name, name, spec[2], nominal, low, high, "log" if wide else "linear", f"{name}.", "guess"
    )


def _quantity(value: Any, unit: str) -> Any:
    """Return a quantity as a campaign states it; a bare number is in SI."""
    return f"{plain(value)!r} {unit}" if isinstance(value, Real) else str(value)


def _check_si(what: str, unit: str) -> None:
    """Refuse a unit that is not SI."""
    try:
        factor = factor_to_si(unit)
    except (UnitError, AttributeError) as error:
        raise CampaignError(f"{what}: {error}").also(ValueError) from None
    if factor != 1.0:
        raise CampaignError(
            f"{what}: {unit!r} is no SI unit, and simulate computes in SI; only logs may state any unit"
        ).also(ValueError)
