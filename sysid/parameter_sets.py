"""Ranked parameter sets with all that a simulator and a sceptic need: the form in which results leave sysid.

A `ParameterSets` contains every number of the model (the free ones as fitted, all others as they were set),
what is known about each, how well each set fits, and where it comes from. Files of every format carry
exactly this; see `sysid.export`.
"""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from numbers import Integral
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from sysid import exact_json
from sysid.documents import Document, OpenMapping, Part, interval, rounded
from sysid.errors import ExportError
from sysid.parameters import Parameter, SearchSpace, with_unit
from sysid.shown import Shown
from sysid.storage import path_of
from sysid.types import BoolArray, FloatArray
from sysid.units import in_si

if TYPE_CHECKING:
    import pandas as pd

Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Flags = Annotated[list[bool], Field(min_length=2, max_length=2)]
# Origin of a number, in this order: the search between its bounds; a measurement with an error, which the fit
# moved; a measurement outside the fit; a default,
# rating or guess, see its source; other values of the set; nothing that was recorded, so that it is NaN.
Status = Literal["free", "stated", "measured", "fixed", "derived", "unknown"]


@dataclass(frozen=True)
class ParameterRecord:
    """What is known about one number of every set; other fields as in `sysid.parameters.Parameter`."""

    name: str
    symbol: str
    unit: str
    status: Status
    meaning: str
    source: str
    # Default and the bounds that the search used [unit]; None where the model declares none.
    nominal: float | None = None
    lower: float | None = None
    upper: float | None = None
    scale: Literal["linear", "log"] | None = None
    # Range of an independent measurement of a free number [unit] (Table II, "measured").
    measured_range: tuple[float, float] | None = None
    # Standard deviation stated by the source [unit], where the sets themselves do not carry it.
    stated_sigma: float | None = None
    group: str = ""
    trial: str = ""

    def __post_init__(self) -> None:
        if self.status not in get_args(Status):
            raise ValueError(
                f"{self.name}: status {self.status!r}, expected one of {', '.join(get_args(Status))}"
            )
        if self.measured_range is not None:
            low, high = self.measured_range
            object.__setattr__(self, "measured_range", (float(low), float(high)))

    @classmethod
    def of(
        cls, row: Parameter, status: Status, measured_range: tuple[float, float] | None = None
    ) -> ParameterRecord:
        """Return the record of a model's row."""
        return cls(**vars(row), status=status, measured_range=measured_range)

    def computed(self, source: str) -> ParameterRecord:
        """Return the record of the same number, computed from other values."""
        kept = {key: getattr(self, key) for key in ("name", "symbol", "unit", "meaning", "group", "trial")}
        return ParameterRecord(**kept, status="derived", source=source)


class Judged(Part):
    """Interval and verdict of one parameter [its unit]."""

    interval_95: Pair
    # Whether the lower and the upper end are open: the data end them nowhere inside the bounds of the search.
    open_95: Flags
    # "well" for a half-width below 0.1, "weakly" below 0.5, else "not_identifiable"; never "well" with a
    # doubt. "not_interpretable" where the model does not explain the trials and a bound cuts the parameter or
    # a partner.
    verdict: str
    # Reason for which the interval may miss the truth.
    doubt: str | None = None
    # Value of the campaign whose stated error makes up most of the interval.
    decided_by: str | None = None

    @property
    def low(self) -> float:
        """Lower end, -inf where open."""
        return -math.inf if self.open_95[0] else self.interval_95[0]

    @property
    def high(self) -> float:
        """Upper end, inf where open."""
        return math.inf if self.open_95[1] else self.interval_95[1]

    @property
    def lost(self) -> bool:
        """Whether digits of the parameter mean nothing."""
        return self.verdict.startswith("not_")

    @property
    def interval(self) -> str:
        """The 95 % interval as text."""
        return interval(self.interval_95, self.open_95)

    @property
    def words(self) -> str:
        """The verdict as it reads after a parameter."""
        words = self.verdict.replace("_", " ")
        return words if self.lost else f"{words} identifiable"

    @property
    def in_place_of_digits(self) -> str | None:
        """What a table prints instead of a number that the data do not determine; None where they do."""
        if not self.lost:
            return None
        (low, high), (below, above) = self.interval_95, self.open_95
        if self.verdict == "not_interpretable":
            return self.words
        if below and above:
            return "not identifiable"
        return f"≤ {high:.2g}" if below else f"≥ {low:.2g}" if above else f"{low:.2g} to {high:.2g}"

    def contains(self, value: float) -> bool:
        """Return whether a value lies in the interval."""
        return self.low <= value <= self.high


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of one parameter of ranked sets: a row of every table of parameters [its unit]."""

    record: ParameterRecord
    # The search found it, by itself or as a combination of others.
    found: bool
    # (S,) each, as in `SetsContent`.
    values: FloatArray
    at_bound: NDArray[np.int8]
    mean: float
    sigma: float
    # Interval and verdict, where the fit was assessed.
    judged: Judged | None
    # Words in place of digits that the data do not determine.
    instead: str | None

    def text(self, s: int = 0, digits: int = 4) -> str:
        """Return the value of one set, with * where it ends at a bound, or what stands in its place.

        That is a dash where the parameter has an interval, which stands beside it in every table.
        """
        if self.instead and self.judged and self.judged.verdict != "not_interpretable":
            return "—"
        return self.instead or rounded(self.values[s], digits) + ("*" if self.at_bound[s] else "")


class TrialUse(Part):
    """A trial and what it is for: ``fit`` or ``validate``."""

    name: str
    use: str


class ChannelUse(Part):
    """A compared channel, its SI unit and its weight in a trial's mean [1]."""

    name: str
    unit: str
    weight: float


def _no_text(value: object) -> object:
    # pydantic takes "1.2" and true for numbers, too.
    if isinstance(value, bool) or (isinstance(value, str) and value not in exact_json.SPECIAL):
        raise ValueError(f"expected a number, found {value!r}")
    return value


Number = Annotated[float, BeforeValidator(_no_text)]


class OneSet(Part):
    """One ranked set: numbers by the parameter's name, NRMSE by trial and channel [1]."""

    rank: int
    run: int
    seed: int
    nrmse: Number
    values: dict[str, Number]
    at_bound: dict[str, int]
    nrmse_by_trial: dict[str, dict[str, Number]]


class SetsHead(Document):
    """What every file of parameter sets says besides the numbers."""

    WHAT: ClassVar[str] = "a parameter-set file"
    REMEDY: ClassVar[str] = "export the fit again with sysid export"

    schema_: Literal["sysid-parameter-sets"] = Field("sysid-parameter-sets", alias="schema")
    version: Literal[1] = 1
    kind: str
    name: str
    units: str = "SI without exception; angles in rad"
    parameters: tuple[ParameterRecord, ...]
    trials: tuple[TrialUse, ...]
    channels: tuple[ChannelUse, ...]
    settings: OpenMapping
    provenance: OpenMapping
    warnings: tuple[str, ...]


class SetsMetadata(SetsHead):
    """What a file with arrays says besides the arrays."""

    runs: tuple[int, ...]
    seeds: tuple[int, ...]


class SetsDocument(SetsHead):
    """Parameter sets as one JSON document: sets by rank, numbers by name."""

    sets: tuple[OneSet, ...]
    mean: dict[str, float]
    sigma: dict[str, float]


# Fields of `ParameterSets` that every file of sets states under the same names.
_SAME = ("kind", "name", "parameters", "settings", "provenance", "warnings")
# Keys of a result's settings: numbers that the data determine only in combination, and those combinations.
NOT_ALONE, COMBINATIONS = "not_identifiable_alone", "combinations"
# Key of the settings: interval, open ends, verdict and doubt of every free parameter of an assessed fit.
INTERVALS = "intervals"
# Key of the settings: each stated value with its error, as fitted, and its distance from what is stated.
STATED = "stated_values"
# Key of the settings: parameters that data may only bound, whose digits are not printed without an interval.
NOT_ASSESSED = "not_assessed"
# Key of the settings: sentences on the stated values or the trial that a fit accuses.
ACCUSED = "accused"
# Key of the settings: word and sentence of `sysid.trust.use.Use` on what a fit predicts.
PREDICTS = "predicts"
# Key of the settings: what the trials show without the model, in words; it counts where the model does not.
KNOWN_ANYHOW = "known_anyhow"
# Key of the provenance: residuals of the fit over the noise, see `sysid.fit.adequacy`.
ADEQUACY = "adequacy"
# Key of the provenance: number of draws, where the sets are draws of what a fit leaves open.
DRAWS = "draws"
# Largest deviation of the sets over half of a parameter's 95 % interval [1] that counts as one optimum.
_ONE_OPTIMUM = 0.1
# Largest NRMSE over the best one [1] of a set that counts for the spread of a fit that was cut short.
NEAR_BEST = 1.1
_ENDS = {"interval_95", "open_95", "verdict"}
_JUDGED = {"verdict", "sentence", "nrmse", "floor", "ratio", "limits", "channels"}
_BY_CHANNEL = {"name", "ratio", "by_trial", "autocorrelation"}


def _readable(stated: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return settings or provenance without intervals and an adequacy that lack what their readers take.

    Older versions wrote such ones; all else of their fits can be read.
    """
    judged, rows = stated.get(ADEQUACY), stated.get(INTERVALS)
    if judged is not None:
        whole = judged.keys() >= _JUDGED and all(row.keys() >= _BY_CHANNEL for row in judged["channels"])
        stated = stated if whole else {key: stated[key] for key in stated if key != ADEQUACY}
    if rows is not None:
        stated = {**stated, INTERVALS: {name: row for name, row in rows.items() if row.keys() >= _ENDS}}
    return stated


def interval_columns(row: Judged | None) -> dict[str, float | str]:
    """Return ends and verdict by column; an open end is infinite, unknown is NaN."""
    if row is None:
        return {"interval_low": math.nan, "interval_high": math.nan, "verdict": ""}
    return {"interval_low": row.low, "interval_high": row.high, "verdict": row.verdict}


def parameter_records(
    space: SearchSpace,
    measured: Mapping[str, str] | None = None,
    measured_ranges: Mapping[str, tuple[float, float]] | None = None,
    derived: Sequence[ParameterRecord] = (),
    *,
    stated: Mapping[str, str] | None = None,
    unknown: Iterable[str] = (),
) -> tuple[ParameterRecord, ...]:
    """Return the record of every row of a model's table, in table order, then the derived ones.

    `measured` and `stated` are sources of values that were measured, or were not (a rating, the campaign, a
    guess); `measured_ranges` are independent measurements of free rows [SI]. Nothing recorded determines the
    `unknown` rows. A record's source is about the value in the sets, a row's about its default.
    """
    free = {row.name: row for row in space.free}
    known, others, ranges, missing = measured or {}, stated or {}, measured_ranges or {}, set(unknown)
    out = []
    for name, row in space.table.items():
        status: Status
        if name in space.stated:
            value, error = space.stated[name], space.stated[name].error
            states = "the static logs give" if row.source == "static logs" else "the campaign states"
            source = f"{states} {with_unit(f'{value:.5g} ± {error:.2g}', row.unit)}; the fit moved it"
            record = replace(ParameterRecord.of(row, "stated"), nominal=float(value), source=source)
            out.append(replace(record, lower=None, upper=None, scale=None, stated_sigma=error))
            continue
        if name in free:
            changed = (row.lower, row.upper) != (free[name].lower, free[name].upper)
            bounds = "the campaign" if changed else "the model's table"
            status, source = "free", f"found by the search; bounds of {bounds}"
        elif name in missing:
            status, source = "unknown", "not tested"
        elif name in known:
            status, source = "measured", known[name]
        else:
            status, source = "fixed", others.get(name, f"default of the model, not measured: {row.source}")
        out.append(replace(ParameterRecord.of(free.get(name, row), status, ranges.get(name)), source=source))
    return (*out, *derived)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class SetsContent:
    """Ranked sets of one model, best first: what a fit and the sets exported from it share."""

    # The model, such as ``motor``, and the name of the fit.
    kind: str
    name: str
    # Columns of `values`: every row of the model's table, then the derived numbers.
    parameters: tuple[ParameterRecord, ...]
    # (S, n) every number of every set [its unit].
    values: FloatArray
    # (S,) mean over channels and fitted trials [1]; NaN where unknown.
    nrmse: FloatArray
    # (S, n) -1 within 1 % of the lower bound, +1 of the upper, else 0.
    at_bound: NDArray[np.int8]
    # Compared channels, their SI units, and the weight of each in a trial's mean [1].
    channels: tuple[str, ...]
    channel_units: tuple[str, ...]
    channel_weights: tuple[float, ...]
    # Laws, command mapping, filter design, conventions: all that a simulator must know too; JSON-able.
    settings: Mapping[str, Any]
    # Hashes of the logs, versions, seeds, search settings, NRMSE denominator; JSON-able.
    provenance: Mapping[str, Any]
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("settings", "provenance"):
            object.__setattr__(self, name, _readable(exact_json.plain(getattr(self, name))))

    def __repr__(self) -> str:
        count = len(self.nrmse)
        best = f", best NRMSE {100 * self.nrmse[0]:.2f} %" if count and math.isfinite(self.nrmse[0]) else ""
        sets = f"{count} set{'' if count == 1 else 's'} of {len(self.parameters)} parameters"
        return f"<{type(self).__name__} {self.name} ({self.kind}): {sets}{best}>"

    @property
    def judged(self) -> dict[str, Judged]:
        """Interval and verdict by parameter, where they were found."""
        keys, alone = Judged.model_fields, self.settings.get(NOT_ALONE, ())
        rows = self.settings.get(INTERVALS, {}).items()
        # Digits and ends of a parameter that rests on a guessed scale are the guess's.
        guessed = {"verdict": "not_identifiable", "open_95": (True, True)}
        return {
            name: Judged(**{key: row[key] for key in keys if key in row} | (guessed if name in alone else {}))
            for name, row in rows
        }

    @property
    def counted(self) -> BoolArray:
        """(S,) which sets enter mean and sigma: where a fit was cut short, those near the best NRMSE."""
        limit = NEAR_BEST * self.nrmse[:1] if "cut_short" in self.provenance else np.inf
        return ~(self.nrmse > limit)

    @property
    def mean(self) -> FloatArray:
        """(n,) mean over the `counted` sets [unit of each]."""
        with np.errstate(invalid="ignore", over="ignore"):
            return self.values[self.counted].mean(axis=0)

    @property
    def sigma(self) -> FloatArray:
        """(n,) standard deviation over the `counted` sets, divided by their number - 1 [unit of each].

        With a single set: what the source states, or NaN.
        """
        values = self.values[self.counted]
        if len(values) > 1:
            # An infinite value that all sets share (no saturation) has no spread.
            with np.errstate(invalid="ignore", over="ignore"):
                spread = values.std(axis=0, ddof=1)
            return np.where(np.all(values == values[:1], axis=0), 0.0, spread)
        stated = [r.stated_sigma for r in self.parameters]
        return np.array([np.nan if value is None else value for value in stated], dtype=np.float64)

    @property
    def one_optimum(self) -> bool:
        """Whether the sets differ by far less than what the data leave open, so that σ says nothing."""
        rows = [(row.sigma, row.judged) for row in self.known.values() if row.judged and not row.judged.lost]
        close = [sigma <= _ONE_OPTIMUM * np.ptp(judged.interval_95) / 2 for sigma, judged in rows]
        return len(self.nrmse) > 1 and bool(rows) and all(close) and bool(self.counted.all())

    def over_channels(self, nrmse: FloatArray) -> FloatArray:
        """Return the weighted mean (...) of NRMSE (..., C) over the channels [1]; NaN without any weight."""
        weights = np.asarray(self.channel_weights, dtype=np.float64)
        used = weights > 0
        if not used.any():
            return np.full(nrmse.shape[:-1], np.nan)
        return np.asarray(nrmse[..., used] @ (weights[used] / weights[used].sum()))

    @property
    def known(self) -> dict[str, Known]:
        """What is known of every parameter, by name, in column order."""
        judged, alone = self.judged, self.settings.get(NOT_ALONE, ())
        together, unassessed = self.settings.get(COMBINATIONS, ()), self.settings.get(NOT_ASSESSED, ())
        unknown = np.full(len(self.parameters), np.nan)
        means, sigmas = (self.mean, self.sigma) if len(self.nrmse) else (unknown, unknown)
        out = {}
        for i, record in enumerate(self.parameters):
            row = judged.get(record.name)
            instead = "not identifiable" if record.name in alone else row.in_place_of_digits if row else None
            if row is None and record.name in unassessed:
                instead = instead or "not assessed"
            out[record.name] = Known(
                record=record,
                found=record.status == "free" or record.name in together,
                values=self.values[:, i],
                at_bound=self.at_bound[:, i],
                mean=float(means[i]),
                sigma=float(sigmas[i]),
                judged=row,
                instead=instead,
            )
        return out


def content_of(sets: SetsContent) -> dict[str, Any]:
    """Return the shared fields by name."""
    return {field.name: getattr(sets, field.name) for field in fields(SetsContent)}


class RankedSet(dict[str, float]):
    """One set: every number by the parameter's name [SI], read and set by its symbol too.

    `sets` are where it comes from and `rank` its place in them; simulators read the surface and the source
    from there.
    """

    def __init__(self, sets: ParameterSets, rank: int) -> None:
        super().__init__(zip(sets.names, sets.values[rank - 1].tolist(), strict=True))
        self.sets, self.rank = sets, rank

    def __missing__(self, key: str) -> float:
        return self[self.sets.names[self.sets.column(key)]]

    def __setitem__(self, key: str, value: float) -> None:
        super().__setitem__(self.sets.names[self.sets.column(key)], float(value))

    def alone(self) -> ParameterSets:
        """Return parameter sets with this one alone, with its changed values."""
        one = slice(self.rank - 1, self.rank)
        arrays = {name: getattr(self.sets, name)[one] for name in ("nrmse", "at_bound", "nrmse_by_trial")}
        values = np.array([[self[name] for name in self.sets.names]])
        return replace(
            self.sets, values=values, runs=self.sets.runs[one], seeds=self.sets.seeds[one], **arrays
        )

    def known(self, names: Collection[str] | None = None) -> dict[str, float]:
        """Return the values [SI], or those that are among `names`; refuse NaN."""
        values = {name: value for name, value in self.items() if names is None or name in names}
        missing = [name for name, value in values.items() if math.isnan(value)]
        if missing:
            raise ExportError(
                f"{self.sets.name}, set {self.rank}: {', '.join(missing)} unknown (NaN), so nothing can be "
                "simulated; record what determines it, or state it in the campaign, and fit again"
            )
        return values

    def __reduce__(self) -> tuple[object, ...]:
        # A copy starts as `sets` and then takes the changed values.
        return type(self), (self.sets, self.rank), None, None, iter(self.items())

    def __repr__(self) -> str:
        return f"<RankedSet {self.rank} of {self.sets.name} ({self.sets.kind}): {len(self)} parameters>"


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ParameterSets(SetsContent, Shown):
    """Parameter sets of one model, best first, without the search behind them.

    Examples
    --------
    >>> import sysid
    >>> sets = sysid.load_parameter_sets("data_samples/published/published-motor.json")
    >>> isinstance(sets, sysid.ParameterSets)
    True
    >>> float(sets["torque_constant"][0]) == sets.best["torque_constant"]
    True
    >>> [file.name for file in sets.save("motor.csv")]
    ['motor.csv']
    """

    # Number (from 1) and seed of the search run that found each set; 0 where there was none.
    runs: tuple[int, ...]
    seeds: tuple[int, ...]
    # Names of the trials, and ``"fit"`` or ``"validate"`` of each.
    trials: tuple[str, ...]
    uses: tuple[str, ...]
    # (S, T, C) NRMSE per set, trial and channel [1].
    nrmse_by_trial: FloatArray

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("values", "nrmse", "nrmse_by_trial", "at_bound"):
            array = np.array(getattr(self, name), dtype=np.int8 if name == "at_bound" else np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        names = ("parameters", "trials", "uses", "channels", "channel_units", "warnings", "runs", "seeds")
        for name in names:
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "channel_weights", tuple(map(float, self.channel_weights)))
        n_sets, n = len(self.nrmse), len(self.parameters)
        n_trials, n_channels = len(self.trials), len(self.channels)
        shapes = {
            "values": (n_sets, n), "at_bound": (n_sets, n), "runs": (n_sets,), "seeds": (n_sets,),
            "uses": (n_trials,), "channel_units": (n_channels,), "channel_weights": (n_channels,),
            "nrmse_by_trial": (n_sets, n_trials, n_channels),
        }  # fmt: skip
        for name, expected in shapes.items():
            content = getattr(self, name)
            shape = content.shape if isinstance(content, np.ndarray) else (len(content),)
            if shape != expected:
                raise ValueError(f"{name} has shape {shape}, expected {expected}")
        for what, named in (("parameters", self.names), ("trials", self.trials), ("channels", self.channels)):
            if len(set(named)) != len(named):
                raise ValueError(f"two {what} share one name")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ParameterSets):
            return NotImplemented
        # In texts NaN equals NaN and 0.0 differs from -0.0: equal bit for bit, in any order of keys.
        texts = {json.dumps(json.loads(sets.document().line()), sort_keys=True) for sets in (self, other)}
        return len(texts) == 1

    __hash__ = None  # type: ignore[assignment]

    def __len__(self) -> int:
        return len(self.nrmse)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of every parameter, in column order."""
        return tuple(record.name for record in self.parameters)

    def column(self, name: str) -> int:
        """Return the column of `values` of a parameter, by name or symbol."""
        if not isinstance(name, str):
            raise ExportError(f"{self.name}: expected the name of a parameter, found {name!r:.60}").also(
                TypeError
            )
        if name in self.names:
            return self.names.index(name)
        found = [i for i, record in enumerate(self.parameters) if record.symbol == name]
        if len(found) == 1:
            return found[0]
        if found:
            several = " and ".join(self.names[i] for i in found)
            raise ExportError(f"{self.name}: {name!r} is the symbol of {several}; give the name")
        near = difflib.get_close_matches(name, [*self.names, *(r.symbol for r in self.parameters)], 1)
        hint = f"; nearest is {near[0]!r}" if near else f"; known are {', '.join(self.names)}"
        raise ExportError(f"{self.name}: no parameter {name!r}{hint}").also(KeyError)

    def __getitem__(self, name: str) -> FloatArray:
        """Return a number (S,) of every set, best first [SI], by the parameter's name or symbol."""
        values: FloatArray = self.values[:, self.column(name)]
        return values

    def __iter__(self) -> Iterator[RankedSet]:
        """Yield every set, best first."""
        return (self.set_values(rank) for rank in range(1, len(self) + 1))

    @property
    def best(self) -> RankedSet:
        """The best set, which a simulator takes."""
        return self.set_values(1)

    def to_frame(self) -> pd.DataFrame:
        """Return one row per parameter: symbol, unit, status, its values by rank, mean and sigma [SI].

        Where the fit was assessed, the 95 % interval and the verdict stand beside them.
        """
        import pandas as pd

        known = self.known
        assessed = any(row.judged for row in known.values())
        rows = [
            {"symbol": row.record.symbol, "unit": row.record.unit, "status": row.record.status}
            | {f"set {rank}": value for rank, value in enumerate(row.values.tolist(), start=1)}
            | {"mean": row.mean, "sigma": row.sigma}
            | (interval_columns(row.judged) if assessed else {})
            for row in known.values()
        ]
        return pd.DataFrame(rows, index=pd.Index(self.names, name="parameter"))

    def remarks(self) -> tuple[str, ...]:
        """Return the warnings."""
        return self.warnings

    def set_values(self, rank: int = 1) -> RankedSet:
        """Return one set by parameter name [SI]; `rank` 1 is the best."""
        if not (isinstance(rank, Integral) and 1 <= rank <= len(self)):
            raise ExportError(
                f"{self.name}: no set of rank {rank!r:.60}; there are {len(self)}, the best is 1"
            ).also(IndexError)
        return RankedSet(self, rank)

    def save(
        self, path: str | Path, *, force: bool = False, rank: int | None = None, slope: float | str = 0.0,
        per_leg: bool = False, mass: float | str | None = None,
    ) -> list[Path]:  # fmt: skip
        """Write the sets in the format that the suffix of `path` names, and return the files.

        The suffix is ``.json``, ``.csv``, ``.h5`` or ``.mat``; ``.xml`` is a MuJoCo model and ``.sdf`` a
        Gazebo motor model of every set, or of the one of a `rank`. `slope` [rad] and `per_leg` are for
        MuJoCo, the `mass` [kg] of a drone for Gazebo; both may be texts with a unit. An existing file is
        replaced only with `force`. ExportError when the sets do not suit the format, or a file cannot be
        written.
        """
        # A writer stands above the sets that it writes.
        write = resolve_name("sysid.workflows.export_models:export_sets")
        files: list[Path] = write(
            self, path_of(path, "the new file"), force, rank=rank, per_leg=per_leg,
            slope=in_si(slope, "rad", "slope"), mass=None if mass is None else in_si(mass, "kg", "mass"),
        )  # fmt: skip
        return files

    def _head(self) -> dict[str, Any]:
        channels = zip(self.channels, self.channel_units, self.channel_weights, strict=True)
        return {name: getattr(self, name) for name in _SAME} | {
            "trials": [TrialUse(name=t, use=u) for t, u in zip(self.trials, self.uses, strict=True)],
            "channels": [ChannelUse(name=c, unit=u, weight=w) for c, u, w in channels],
        }

    def metadata(self) -> SetsMetadata:
        """Return everything but the arrays."""
        return SetsMetadata(**self._head(), runs=self.runs, seeds=self.seeds)

    def document(self) -> SetsDocument:
        """Return the whole as one JSON document."""
        # A stated value that moves may end at a bound as well.
        flagged = [
            i
            for i, record in enumerate(self.parameters)
            if record.status == "free" or self.at_bound[:, i].any()
        ]
        sets = [
            OneSet(
                rank=s + 1, run=self.runs[s], seed=self.seeds[s], nrmse=self.nrmse[s],
                values=self.set_values(s + 1),
                at_bound={self.names[i]: int(self.at_bound[s, i]) for i in flagged},
                nrmse_by_trial={
                    trial: dict(zip(self.channels, row, strict=True))
                    for trial, row in zip(self.trials, self.nrmse_by_trial[s].tolist(), strict=True)
                },
            )
            for s in range(len(self))
        ]  # fmt: skip
        mean, sigma = (
            dict(zip(self.names, row.tolist(), strict=True)) if len(self) else {}
            for row in (self.mean, self.sigma)
        )
        return SetsDocument(**self._head(), sets=tuple(sets), mean=mean, sigma=sigma)

    @classmethod
    def from_metadata(
        cls,
        metadata: SetsMetadata,
        values: FloatArray,
        nrmse: FloatArray,
        at_bound: NDArray[np.int8],
        nrmse_by_trial: FloatArray,
    ) -> ParameterSets:
        """Return the sets of `metadata` and arrays as in `ParameterSets`; ValueError where these disagree."""
        trials, channels = metadata.trials, metadata.channels
        return cls(
            **{name: getattr(metadata, name) for name in (*_SAME, "runs", "seeds")},
            values=values,
            nrmse=nrmse,
            at_bound=at_bound,
            trials=tuple(trial.name for trial in trials),
            uses=tuple(trial.use for trial in trials),
            channels=tuple(channel.name for channel in channels),
            channel_units=tuple(channel.unit for channel in channels),
            channel_weights=tuple(channel.weight for channel in channels),
            nrmse_by_trial=nrmse_by_trial,
        )

    @classmethod
    def from_document(cls, document: SetsDocument) -> ParameterSets:
        """Return the sets of a JSON document; KeyError or ValueError where it contradicts itself."""
        sets = document.sets
        names = [record.name for record in document.parameters]
        trials = [trial.name for trial in document.trials]
        channels = [channel.name for channel in document.channels]
        if [row.rank for row in sets] != list(range(1, len(sets) + 1)):
            raise ValueError("sets are not in the order of their rank")
        for row in sets:
            if {*row.values} != {*names}:
                raise ValueError(f"set {row.rank} does not name every parameter once")
        size = len(sets)
        head = {name: getattr(document, name) for name in SetsHead.model_fields}
        values = [[row.values[n] for n in names] for row in sets]
        bounds = [[row.at_bound.get(n, 0) for n in names] for row in sets]
        scores = [[[row.nrmse_by_trial[t][c] for c in channels] for t in trials] for row in sets]
        return cls.from_metadata(
            SetsMetadata(**head, runs=tuple(row.run for row in sets), seeds=tuple(row.seed for row in sets)),
            values=np.array(values).reshape(size, len(names)),
            nrmse=np.array([row.nrmse for row in sets], dtype=np.float64),
            at_bound=np.array(bounds, dtype=np.int8).reshape(size, len(names)),
            nrmse_by_trial=np.array(scores, dtype=np.float64).reshape(size, len(trials), len(channels)),
        )
