"""Tables that every kind of campaign has: quantities with units, parameter choices, search settings."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    PrivateAttr,
    ValidatorFunctionWrapHandler,
    model_validator,
)
from pydantic_core.core_schema import CoreSchema, no_info_wrap_validator_function

from sysid.errors import CampaignError, UnitError
from sysid.loaders.options import quantity
from sysid.parameters import ParameterTable, SearchSpace
from sysid.search_options import CampaignSearch
from sysid.stated import Stated, parse_stated, typical_error, without_error
from sysid.units import parse_quantity

TrialUse = Literal["fit", "validate"]
Number = TypeVar("Number")


def stated_in(unit: str) -> BeforeValidator:
    """Return what makes a quantity of a campaign, such as ``"1.242 kg"``, an SI value of this dimension."""
    return BeforeValidator(partial(quantity, unit=unit))


@dataclass(frozen=True)
class Measured:
    """What makes a measured quantity of a campaign, such as ``"1.242 kg ± 2 g"``, a `Stated` value.

    It stands behind all other annotations of a float.
    """

    # Dimension of the quantity.
    unit: str
    # Standard error where the campaign states none, such as ``"1 g"`` or ``"3 %"``; empty: exact.
    typical: str = ""
    # How such a thing is measured: the source of that error.
    how: str = ""
    # Largest error that a campaign may state of a value that may be 0, such as ``"10 deg"``; empty: any.
    most: str = ""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        schema = handler(source)
        positive = schema.get("gt", schema.get("ge")) == 0
        return no_info_wrap_validator_function(partial(self._stated, positive), schema)

    def _stated(self, positive: bool, value: object, inner: ValidatorFunctionWrapHandler) -> Stated:
        try:
            number, error = parse_stated(value, self.unit) if isinstance(value, str) else (value, None)
        except UnitError as refusal:
            raise ValueError(str(refusal)) from refusal
        number = inner(number if isinstance(value, str) else quantity(value, self.unit))
        if error is None:
            return Stated(number, self.typical_error(number), self.typical)
        if positive and error > number > 0:
            raise ValueError(f"the error in {value!r} is larger than the value; write one standard deviation")
        if self.most and error > parse_quantity(self.most, self.unit):
            raise ValueError(
                f"the error in {value!r} is beyond {self.most}; measure it, and write one standard deviation"
            )
        return Stated(number, error)

    def typical_error(self, value: float) -> float:
        """Return the typical error of a value [SI]."""
        return typical_error(self.typical, value, self.unit) if self.typical else 0.0


Length = Annotated[float, stated_in("m")]
PositiveLength = Annotated[float, stated_in("m"), Field(gt=0)]
Angle = Annotated[float, stated_in("rad")]
Time = Annotated[float, stated_in("s")]
PositiveTime = Annotated[float, stated_in("s"), Field(gt=0)]
Speed = Annotated[float, stated_in("m/s"), Field(gt=0)]
Frequency = Annotated[float, stated_in("Hz"), Field(gt=0)]


class TomlTable(BaseModel):
    """A TOML table: frozen, and closed to keys it does not know."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _no_truth_as_a_number(cls, data: Any) -> Any:
        for name, value in data.items() if isinstance(data, dict) else ():
            field = cls.model_fields.get(name)
            if isinstance(value, bool) and field is not None and field.annotation in (int, float):
                raise ValueError(f"{name} = {str(value).lower()}: expected a number")
        return data


class ParameterChoices(TomlTable):
    """`[parameters]`: which rows of the model are free, between which bounds, and what others are fixed to.

    Quantities stay text here: `search_space` checks their unit against the model's row. Fixed values may
    state an error, and are exact without one.
    """

    free: tuple[str, ...] | None = None
    bounds: dict[str, tuple[str, str]] = {}
    fixed: dict[str, str] = {}
    measured: dict[str, tuple[str, str]] = {}

    def search_space(
        self, table: ParameterTable, default_free: Iterable[str], campaign_values: Mapping[str, float]
    ) -> SearchSpace:
        """Resolve names and units against the model's table.

        `default_free` are the free parameters of the paper, taken where the campaign names none.
        `campaign_values` are measured elsewhere in the campaign (vehicle, surface), SI: a fixed parameter
        takes its value from `fixed`, from there, or from the row's nominal. An unknown parameter, a wrong
        unit, bounds that cross or exclude a measured value, and a parameter both fixed and free are a
        CampaignError.
        """
        # A parameter that the campaign fixes leaves the default list; one that it frees as well is a mistake.
        free = tuple(n for n in default_free if n not in self.fixed) if self.free is None else self.free
        if not free:
            raise CampaignError("parameters.free is empty; name at least one parameter to identify")
        with _prefixed("parameters.free: "):
            for name in free:
                table[name]  # refuses an unknown name
        duplicates = {name for name in free if free.count(name) > 1}
        if duplicates:
            raise CampaignError(f"parameters.free names {', '.join(sorted(duplicates))} twice; name it once")
        both = set(free) & set(self.fixed)
        if both:
            raise CampaignError(
                f"parameters.fixed and parameters.free both name {', '.join(sorted(both))}; keep it in one"
            )
        values = {**campaign_values, **self.fixed_values(table)}
        bounds = {}
        for name, pair in self.bounds.items():
            low, high = (_quantity_of("bounds", name, text, table, parse_quantity) for text in pair)
            if name not in free:
                raise CampaignError(
                    f"parameters.bounds.{name}: the parameter is not free, so bounds do nothing; "
                    f"name it in parameters.free or drop its bounds"
                )
            if low < 0 <= table[name].lower:
                raise CampaignError(
                    f"parameters.bounds.{name}: {pair[0]} is negative; a {name.replace('_', ' ')} cannot be"
                )
            bounds[name] = (low, high)
        with _prefixed("parameters.bounds."):
            space = SearchSpace.build(table, free, values, bounds)
        ranges = self.measured_ranges(table)
        for row in space.free:
            unit = "" if row.unit == "1" else f" {row.unit}"
            low, high = ranges.get(row.name, (row.lower, row.upper))
            shown = f"{low:g} to {high:g}" if high < row.lower or low > row.upper else ""
            value = campaign_values.get(row.name, row.lower)
            if not shown and not row.lower <= value <= row.upper:
                shown = f"value {value:g}"
            if shown:
                raise CampaignError(
                    f"parameters.bounds.{row.name}: {row.lower:g} to {row.upper:g}{unit} exclude the "
                    f"measured {shown}; widen the bounds or correct the measurement"
                )
        return space

    def fixed_values(self, table: ParameterTable) -> dict[str, Stated]:
        """Return the values to which the campaign fixes rows [SI], with the errors that it states."""
        out = {}
        for name, text in self.fixed.items():
            value, error = _quantity_of("fixed", name, text, table, parse_stated)
            # A row whose bounds exclude zero declares a sign: stiffness, damping, mass, current.
            signed = table[name].lower < 0
            if not signed and value < 0:
                raise CampaignError(
                    f"parameters.fixed.{name}: {text} is negative; a {name.replace('_', ' ')} cannot be"
                )
            if not signed and (error or 0.0) > value:
                raise CampaignError(
                    f"parameters.fixed.{name}: the error in {text!r} is larger than the value; write one "
                    "standard deviation"
                )
            out[name] = Stated(value, error or 0.0)
        return out

    def measured_ranges(self, table: ParameterTable) -> dict[str, tuple[float, float]]:
        """Return the independent ranges that the campaign states, SI (Table II's "measured" column)."""
        out = {}
        for name, pair in self.measured.items():
            low, high = (_quantity_of("measured", name, text, table, parse_quantity) for text in pair)
            if low > high:
                raise CampaignError(f"parameters.measured.{name}: {pair[0]} is above {pair[1]}; swap them")
            out[name] = (low, high)
        return out


@contextmanager
def _prefixed(prefix: str) -> Iterator[None]:
    try:
        yield
    except (CampaignError, UnitError) as error:
        raise CampaignError(f"{prefix}{error}") from error


def _quantity_of(
    where: str, name: str, text: str, table: ParameterTable, read: Callable[[str, str], Number]
) -> Number:
    """Return a quantity of `parameters.WHERE.NAME` in the unit of the model's row."""
    with _prefixed(f"parameters.{where}: "):
        unit = table[name].unit
    with _prefixed(f"parameters.{where}.{name}: "):
        return read(text, unit)


class FitTable(TomlTable, CampaignSearch):  # type: ignore[misc]
    """`[fit]`: the search; pydantic checks the fields of the dataclass."""


def _one_line(name: str) -> str:
    # It heads tables, pages and columns of files.
    if not name.isprintable():
        raise ValueError(f"{name!r} has characters that cannot be seen; use a name of one plain line")
    return name


class TrialTable(TomlTable):
    """What every `[[trials]]` entry has."""

    name: Annotated[str, AfterValidator(_one_line)] = Field(min_length=1, max_length=100)
    log: str = Field(min_length=1)
    use: TrialUse = "fit"


@dataclass(frozen=True)
class CampaignSource:
    """The file of a campaign as it was read, once: what becomes of it later changes no record."""

    path: Path
    sha256: str
    text: str


def _file_name(name: str) -> str:
    # The fit's folder takes it, on every system.
    if name.endswith(".") or re.fullmatch(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?", name):
        raise ValueError(f"{name!r} is no name of a folder on Windows; choose another")
    return name


class CampaignTable(TomlTable):
    """Top level of every campaign; `source` is the file that it was read from."""

    kind: str
    name: Annotated[str, AfterValidator(_file_name)] = Field(
        min_length=1, max_length=100, pattern=r"^[A-Za-z0-9_-][A-Za-z0-9._-]*$"
    )
    parameters: ParameterChoices = ParameterChoices()
    trials: tuple[TrialTable, ...]
    _source: CampaignSource = PrivateAttr()

    @property
    def source(self) -> CampaignSource:
        """The file; AttributeError where the campaign was made in memory."""
        return self._source

    @model_validator(mode="after")
    def _trials_are_usable(self) -> CampaignTable:
        names = [trial.name for trial in self.trials]
        if not names:
            raise ValueError("no [[trials]]; add at least one with name and log")
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"two trials are called {twice[0]!r}; give each another name")
        if not any(trial.use == "fit" for trial in self.trials):
            raise ValueError("every trial has use = 'validate'; at least one must have use = 'fit'")
        return self


def as_exact(part: Any) -> Any:
    """Return a campaign, or a part of one, in which every stated value is exact, as the paper takes it."""
    if isinstance(part, Stated):
        return Stated(part) if part.error or part.assumed else part
    if isinstance(part, tuple):
        items = tuple(map(as_exact, part))
        return part if all(map(operator.is_, items, part)) else items
    if not isinstance(part, BaseModel):
        return part
    # A field that stays the same is not written: it would count as stated by the campaign.
    changed = {name: new for name, old in part if (new := as_exact(old)) is not old}
    if isinstance(part, ParameterChoices) and part.fixed:
        changed["fixed"] = {name: without_error(text) for name, text in part.fixed.items()}
    if isinstance(part, FitTable):
        changed["exact"] = True
    return part.model_copy(update=changed) if changed else part


class Weights(TomlTable):
    """`[cost.weights]`: weight of each channel in the mean of a trial."""

    @model_validator(mode="after")
    def _something_counts(self) -> Weights:
        if not any(self.model_dump().values()):
            raise ValueError("all weights are 0; give at least one channel a weight")
        return self


class CostTable(TomlTable):
    """`[cost]`: the NRMSE."""

    denominator: Literal["std", "range"] = "std"
