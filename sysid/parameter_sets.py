"""Ranked parameter sets with all that a simulator and a sceptic need: the form in which results leave sysid.

A `ParameterSets` holds every number of the model (the free ones as fitted, all others as they were held),
what is known about each, how well each set fits, and where it comes from. Files of every format carry
exactly this; see `sysid.export`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sysid import exact_json
from sysid.errors import ExportError
from sysid.parameters import Parameter, SearchSpace
from sysid.types import FloatArray

Status = Literal["free", "measured", "fixed", "derived", "unknown"]

SCHEMA = "sysid-parameter-sets"
SCHEMA_VERSION = 1

STATUS_MEANING: dict[str, str] = {
    "free": "found by the search between its bounds",
    "measured": "measured outside the fit and held",
    "fixed": "held at a value that was not measured (default, datasheet or guess; see source)",
    "derived": "computed from the other values of the set",
    "unknown": "nothing that was recorded says anything about it; the value is NaN",
}


@dataclass(frozen=True)
class ParameterRecord:
    """What is known about one number of every set.

    Parameters
    ----------
    name, symbol, unit : str
        As in the model's table; the unit is SI.
    status : {"free", "measured", "fixed", "derived", "unknown"}
        How it got its value; see `STATUS_MEANING`.
    meaning, source : str
        One sentence each.
    nominal, lower, upper : float or None
        Default and the bounds that the search used [unit]; None where the model declares none.
    scale : {"linear", "log"} or None
        How the search walked between the bounds.
    measured_range : (float, float) or None
        What an independent measurement of a free number found [unit] (Table II, "measured").
    stated_sigma : float or None
        Standard deviation stated by the source [unit], where the sets themselves do not carry it.
    """

    name: str
    symbol: str
    unit: str
    status: Status
    meaning: str
    source: str
    nominal: float | None = None
    lower: float | None = None
    upper: float | None = None
    scale: Literal["linear", "log"] | None = None
    measured_range: tuple[float, float] | None = None
    stated_sigma: float | None = None

    def __post_init__(self) -> None:
        if self.status not in STATUS_MEANING:
            raise ValueError(
                f"{self.name}: status {self.status!r}, expected one of {', '.join(STATUS_MEANING)}"
            )
        if self.measured_range is not None:
            low, high = self.measured_range
            object.__setattr__(self, "measured_range", (float(low), float(high)))

    @classmethod
    def of(
        cls, row: Parameter, status: Status, measured_range: tuple[float, float] | None = None
    ) -> ParameterRecord:
        """Return the record of a model's row."""
        return cls(
            row.name, row.symbol, row.unit, status, row.meaning, row.source,
            row.nominal, row.lower, row.upper, row.scale, measured_range,
        )  # fmt: skip


# Keys of a result's settings: numbers that the data fix only in combination, and those combinations.
NOT_ALONE, COMBINATIONS = "fixed only in combination", "combinations"


def in_place_of_digits(settings: Mapping[str, Any], name: str) -> str | None:
    """Return what a table prints instead of a number that the data do not fix; None where they do.

    A parameter below a bound of its profile is printed as that bound; one that rests on a guessed scale is
    not printed at all, because its digits would be the guess's.
    """
    if name in settings.get(NOT_ALONE, ()):
        return "not fixed"
    found = settings.get("profiles", {}).get(name)
    if not found or found["identified"]:
        return None
    return f"< {found['below']:.0e}"


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

    Parameters
    ----------
    space : SearchSpace
        Which rows are free, with the bounds that the search used.
    measured : mapping of str to str, optional
        Where the value of each measured row comes from, by name.
    measured_ranges : mapping, optional
        Independent measurements of free rows, by name [SI].
    derived : sequence of ParameterRecord
        Numbers that the model computes from the rows.
    stated : mapping of str to str, optional
        Where the value of a row comes from that was not measured (a rating, the campaign, a guess), by name.
    unknown : iterable of str
        Rows of which nothing recorded says anything.

    Notes
    -----
    A row's own source speaks of its default; a record speaks of the value that the sets hold.
    """
    free = {row.name: row for row in space.free}
    known, others = measured or {}, stated or {}
    missing = set(unknown)
    ranges = measured_ranges or {}
    out = []
    for name, row in space.table.items():
        status: Status
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


@dataclass(frozen=True, eq=False)
class ParameterSets:
    """Parameter sets of one model, best first.

    Parameters
    ----------
    kind : {"motor", "gear"}
        The model.
    name : str
        Of the fit.
    parameters : tuple of ParameterRecord
        The columns of `values`.
    values : (S, n) array
        Every number of every set [its unit].
    nrmse : (S,) array
        Cost of each set over the trials of the fit [1]; NaN where unknown.
    runs, seeds : tuple of int
        The search run (from 1) that found the set and its seed; 0 where there was none.
    at_bound : (S, n) int8 array
        -1 within 1 % of the lower bound, +1 of the upper, else 0.
    trials, uses : tuple of str
        Names of the trials, and ``"fit"`` or ``"validate"`` of each.
    channels, channel_units : tuple of str
        Compared channels and their SI units.
    channel_weights : tuple of float
        Weight of each in a trial's mean [1].
    nrmse_by_trial : (S, T, C) array
        NRMSE per set, trial and channel [1].
    settings : mapping
        What a simulator must also know: laws, command mapping, filter design, conventions.
    provenance : mapping
        Hashes of the logs, versions, seeds, search settings, NRMSE denominator.
    warnings : tuple of str
        One sentence each.
    """

    kind: Literal["motor", "gear"]
    name: str
    parameters: tuple[ParameterRecord, ...]
    values: FloatArray
    nrmse: FloatArray
    runs: tuple[int, ...]
    seeds: tuple[int, ...]
    at_bound: NDArray[np.int8]
    trials: tuple[str, ...]
    uses: tuple[str, ...]
    channels: tuple[str, ...]
    channel_units: tuple[str, ...]
    channel_weights: tuple[float, ...]
    nrmse_by_trial: FloatArray
    settings: Mapping[str, Any]
    provenance: Mapping[str, Any]
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("values", "nrmse", "nrmse_by_trial"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        flags = np.array(self.at_bound, dtype=np.int8)
        flags.setflags(write=False)
        object.__setattr__(self, "at_bound", flags)
        for name in ("settings", "provenance"):
            object.__setattr__(self, name, exact_json.plain(getattr(self, name)))
        texts = ("parameters", "trials", "uses", "channels", "channel_units", "warnings")
        for name in (*texts, "runs", "seeds"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "channel_weights", tuple(float(w) for w in self.channel_weights))
        if self.kind not in ("motor", "gear"):
            raise ValueError(f"kind {self.kind!r}, expected 'motor' or 'gear'")
        n_sets, n = len(self.nrmse), len(self.parameters)
        shapes = {
            "values": (self.values.shape, (n_sets, n)),
            "at_bound": (self.at_bound.shape, (n_sets, n)),
            "runs": ((len(self.runs),), (n_sets,)),
            "seeds": ((len(self.seeds),), (n_sets,)),
            "uses": ((len(self.uses),), (len(self.trials),)),
            "channel_units": ((len(self.channel_units),), (len(self.channels),)),
            "channel_weights": ((len(self.channel_weights),), (len(self.channels),)),
            "nrmse_by_trial": (self.nrmse_by_trial.shape, (n_sets, len(self.trials), len(self.channels))),
        }
        for name, (found, expected) in shapes.items():
            if found != expected:
                raise ValueError(f"{name} has shape {found}, expected {expected}")
        for what, names in (
            ("parameters", self.names),
            ("trials", self.trials),
            ("channels", self.channels),
        ):
            if len(set(names)) != len(names):
                raise ValueError(f"two {what} share one name")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ParameterSets):
            return NotImplemented
        # As text NaN equals NaN and 0.0 differs from -0.0: equal means equal bit for bit.
        return exact_json.dumps(self.document()) == exact_json.dumps(other.document())

    __hash__ = None  # type: ignore[assignment]

    def __len__(self) -> int:
        return len(self.nrmse)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of every parameter, in column order."""
        return tuple(record.name for record in self.parameters)

    def set_values(self, rank: int = 1) -> dict[str, float]:
        """Return one set by parameter name [SI]; `rank` 1 is the best."""
        if not 1 <= rank <= len(self):
            raise ExportError(f"{self.name}: no set of rank {rank}; there are {len(self)}, the best is 1")
        return dict(zip(self.names, self.values[rank - 1].tolist(), strict=True))

    @property
    def mean(self) -> FloatArray:
        """(n,) mean over the sets [unit of each]."""
        with np.errstate(invalid="ignore", over="ignore"):
            return self.values.mean(axis=0)

    @property
    def sigma(self) -> FloatArray:
        """(n,) standard deviation over the sets, divided by S - 1 [unit of each].

        With a single set: what the source states, or NaN.
        """
        if len(self) > 1:
            # An infinite value that all sets share (no saturation) has no spread.
            with np.errstate(invalid="ignore", over="ignore"):
                spread = self.values.std(axis=0, ddof=1)
            return np.where(np.all(self.values == self.values[:1], axis=0), 0.0, spread)
        stated = [r.stated_sigma for r in self.parameters]
        return np.array([np.nan if value is None else value for value in stated], dtype=np.float64)

    def metadata(self) -> dict[str, Any]:
        """Return everything but the arrays, ready for JSON."""
        return {
            "schema": SCHEMA,
            "version": SCHEMA_VERSION,
            "kind": self.kind,
            "name": self.name,
            "units": "SI without exception; angles in rad",
            "parameters": [asdict(record) for record in self.parameters],
            "runs": list(self.runs),
            "seeds": list(self.seeds),
            "trials": [{"name": t, "use": u} for t, u in zip(self.trials, self.uses, strict=True)],
            "channels": [
                {"name": c, "unit": u, "weight": w}
                for c, u, w in zip(self.channels, self.channel_units, self.channel_weights, strict=True)
            ],
            "settings": self.settings,
            "provenance": self.provenance,
            "warnings": list(self.warnings),
        }

    def document(self) -> dict[str, Any]:
        """Return the whole as one JSON document, sets by rank and numbers by name."""
        free = [i for i, record in enumerate(self.parameters) if record.status == "free"]
        document = self.metadata()
        runs, seeds = document.pop("runs"), document.pop("seeds")
        document["sets"] = [
            {
                "rank": s + 1,
                "run": runs[s],
                "seed": seeds[s],
                "nrmse": float(self.nrmse[s]),
                "values": self.set_values(s + 1),
                "at_bound": {self.names[i]: int(self.at_bound[s, i]) for i in free},
                "nrmse_by_trial": {
                    trial: dict(zip(self.channels, self.nrmse_by_trial[s, t].tolist(), strict=True))
                    for t, trial in enumerate(self.trials)
                },
            }
            for s in range(len(self))
        ]
        document["mean"] = dict(zip(self.names, self.mean.tolist(), strict=True)) if len(self) else {}
        document["sigma"] = dict(zip(self.names, self.sigma.tolist(), strict=True)) if len(self) else {}
        return document

    @classmethod
    def from_metadata(
        cls,
        metadata: Mapping[str, Any],
        values: FloatArray,
        nrmse: FloatArray,
        at_bound: NDArray[np.int8],
        nrmse_by_trial: FloatArray,
    ) -> ParameterSets:
        """Return the sets that `metadata` and the arrays describe.

        Raises
        ------
        ExportError
            When the schema is foreign or its version unknown.
        KeyError, TypeError, ValueError
            When something is missing or contradicts itself.
        """
        check_schema(metadata)
        known = {field.name for field in fields(ParameterRecord)}
        records = []
        for row in metadata["parameters"]:
            if set(row) != known:
                raise ValueError(
                    f"parameter {row.get('name')!r} has other fields than schema {SCHEMA_VERSION}"
                )
            records.append(ParameterRecord(**row))
        return cls(
            kind=metadata["kind"],
            name=metadata["name"],
            parameters=tuple(records),
            values=values,
            nrmse=nrmse,
            runs=tuple(metadata["runs"]),
            seeds=tuple(metadata["seeds"]),
            at_bound=at_bound,
            trials=tuple(trial["name"] for trial in metadata["trials"]),
            uses=tuple(trial["use"] for trial in metadata["trials"]),
            channels=tuple(channel["name"] for channel in metadata["channels"]),
            channel_units=tuple(channel["unit"] for channel in metadata["channels"]),
            channel_weights=tuple(channel["weight"] for channel in metadata["channels"]),
            nrmse_by_trial=nrmse_by_trial,
            settings=metadata["settings"],
            provenance=metadata["provenance"],
            warnings=tuple(metadata["warnings"]),
        )

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> ParameterSets:
        """Return the sets of a JSON document; raises as `from_metadata`."""
        check_schema(document)
        sets = document["sets"]
        names = [row["name"] for row in document["parameters"]]
        trials = [trial["name"] for trial in document["trials"]]
        channels = [channel["name"] for channel in document["channels"]]
        if [one["rank"] for one in sets] != list(range(1, len(sets) + 1)):
            raise ValueError("sets are not in the order of their rank")
        for one in sets:
            if set(one["values"]) != set(names):
                raise ValueError(f"set {one['rank']} does not name every parameter once")
        metadata = dict(document)
        metadata["runs"] = [one["run"] for one in sets]
        metadata["seeds"] = [one["seed"] for one in sets]
        by_trial = [[[one["nrmse_by_trial"][t][c] for c in channels] for t in trials] for one in sets]
        return cls.from_metadata(
            metadata,
            values=np.array([[one["values"][n] for n in names] for one in sets]).reshape(
                len(sets), len(names)
            ),
            nrmse=np.array([one["nrmse"] for one in sets], dtype=np.float64),
            at_bound=np.array(
                [[one["at_bound"].get(n, 0) for n in names] for one in sets], dtype=np.int8
            ).reshape(len(sets), len(names)),
            nrmse_by_trial=np.array(by_trial, dtype=np.float64).reshape(
                len(sets), len(trials), len(channels)
            ),
        )


def check_schema(metadata: Any) -> None:
    """Refuse a document that is not ours or of a version this code does not know.

    Raises
    ------
    ExportError
        With the reason.
    """
    if not isinstance(metadata, Mapping) or metadata.get("schema") != SCHEMA:
        raise ExportError("not a parameter-set file of sysid; expected one written by sysid export")
    if metadata.get("version") != SCHEMA_VERSION:
        raise ExportError(
            f"schema version {metadata.get('version')!r}, expected {SCHEMA_VERSION}; "
            "read it with the version of sysid that wrote it, or export the fit again"
        )
