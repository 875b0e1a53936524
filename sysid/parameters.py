"""Declared parameters of a model, and the unit cube in which an optimiser sees the free ones.

A model is a table of `Parameter` rows; a `SearchSpace` chooses which of them are free, between which bounds,
and the fixed values of all others.
"""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from sysid.errors import CampaignError
from sysid.journal import Finding
from sysid.stated import Stated
from sysid.types import BoolArray, FloatArray

Scale = Literal["linear", "log"]

# A value within this share of the unit-cube edge counts as lying at its bound.
AT_BOUND = 0.01
# Distance of a stated value's bounds from the value [its standard errors], and the least share of it.
_FARTHEST_PULL, _LEAST_SHARE = 20.0, 0.05
# The same of a value whose statement is taken out.
_FARTHEST_OFF = 200.0
# Group of rows that count from what a campaign states of a place or a direction.
FROM_STATED = "stated place"
# Distance from a stated value from which on its statement is a slip rather than chance [standard errors].
_SLIP = 3.0


@dataclass(frozen=True)
class Parameter:
    """One number of a model."""

    # Words of the field, e.g. ``leg_axial_stiffness``.
    name: str
    # Short form in equations and tables, e.g. ``k_h``.
    symbol: str
    # SI, also of the next three.
    unit: str
    nominal: float
    # Bounds of the search.
    lower: float
    upper: float
    # How the unit cube is laid between the bounds.
    scale: Scale
    # One sentence.
    meaning: str
    # Origin of nominal and bounds ("guess" is an answer, silence is not).
    source: str
    # Owner of the number, e.g. ``leg``, ``ground``, ``instrument``, ``nuisance``.
    group: str = ""
    # The trial or log that alone has this number, whose name ends in ``[trial]``; empty for the model's.
    trial: str = ""

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise CampaignError(
                f"{self.name}: lower bound {self.lower:g} {self.unit} is not below "
                f"upper bound {self.upper:g} {self.unit}; swap or widen them"
            )
        if self.scale == "log" and self.lower <= 0:
            raise CampaignError(
                f"{self.name}: lower bound {self.lower:g} {self.unit} on a logarithmic scale must be above 0"
            )

    @property
    def common_name(self) -> str:
        """The name without the trial: ``command_delay`` of ``command_delay[step-1.csv]``."""
        return common_name(self)

    def scaled(self, factor: float) -> Parameter:
        """Return the row with bounds `factor` times as far from zero, to two digits as all defaults have."""
        lower, upper = (float(f"{factor * bound:.2g}") for bound in (self.lower, self.upper))
        return replace(self, lower=lower, upper=upper)

    def of_trial(self, trial: str) -> Parameter:
        """Return the row of the same number for one trial alone, named ``name[trial]``."""
        return replace(self, name=f"{self.name}[{trial}]", symbol=f"{self.symbol} of {trial}", trial=trial)


class ParameterTable(dict[str, Parameter]):
    """Ordered rows of a model, by name; not changed after it is made.

    `derived` names the numbers that follow from the rows and stand beside them in the sets of a fit.
    """

    def __init__(self, rows: Iterable[Parameter], derived: Iterable[str] = ()) -> None:
        rows, self.derived = tuple(rows), frozenset(derived)
        super().__init__((row.name, row) for row in rows)
        if len(self) != len(rows):
            raise ValueError("two parameters share one name")

    def __missing__(self, name: str) -> Parameter:
        near = difflib.get_close_matches(name, [*self, *(row.symbol for row in self.values())], 1)
        hint = f"; nearest is {near[0]!r}" if near else f"; known are {', '.join(self)}"
        raise CampaignError(f"no parameter {name!r}{hint}")

    def filled(self, given: Mapping[str, float]) -> dict[str, float]:
        """Return a number for every row [its unit]; a name left out takes the nominal.

        A set's derived numbers and its numbers of single trials are left out. An unknown
        name is a CampaignError.
        """
        for name in given:
            if (common := name.partition("[")[0]) not in self.derived:
                self[common]
        return {name: float(given.get(name, row.nominal)) for name, row in self.items()}

    @property
    def nominal(self) -> dict[str, float]:
        """Default value of every row [its unit]."""
        return {name: row.nominal for name, row in self.items()}

    @cached_property
    def index(self) -> Mapping[str, int]:
        """Place of every row in the table."""
        return {name: i for i, name in enumerate(self)}

    def group(self, *groups: str) -> tuple[str, ...]:
        """Return the names of the rows of some groups, in table order."""
        return tuple(name for name, row in self.items() if row.group in groups)


@dataclass(frozen=True, eq=False)
class SearchSpace:
    """Which parameters are free, between which bounds, and the values of the others.

    A value that the campaign states with an error is free as well: its distance from what is stated, in
    standard errors, is a further residual of the fit.
    """

    table: ParameterTable
    # Free rows in search order, bounds already overridden by the campaign.
    free: tuple[Parameter, ...]
    # Value of every other row [its unit].
    fixed: Mapping[str, float]
    # The last of the free rows: those that the campaign states with an error [its unit].
    stated: Mapping[str, Stated] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("fixed", "stated"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    @classmethod
    def build(
        cls,
        table: ParameterTable,
        free: Iterable[str],
        values: Mapping[str, float],
        bounds: Mapping[str, tuple[float, float]] | None = None,
    ) -> SearchSpace:
        """Choose the free rows, override bounds, and fix the others to `values` or their nominal."""
        rows = {name: table[name] for name in free}
        for name, (lower, upper) in (bounds or {}).items():
            if name in rows:
                rows[name] = replace(rows[name], lower=lower, upper=upper)
        fixed = {
            name: float(values.get(name, row.nominal)) for name, row in table.items() if name not in rows
        }
        return cls(table, tuple(rows.values()), fixed)

    def __reduce__(self) -> tuple[type[SearchSpace], tuple[object, ...]]:
        # The content of a read-only view can travel to another process.
        return SearchSpace, (self.table, self.free, dict(self.fixed), dict(self.stated))

    def freeing(self, rows: Iterable[Parameter]) -> SearchSpace:
        """Return the space with further rows of its table free, between their bounds."""
        rows = tuple(rows)
        fixed = {name: value for name, value in self.fixed.items() if name not in {row.name for row in rows}}
        free = (*self.found, *rows, *self.free[len(self.found) :])
        return SearchSpace(self.table, free, fixed, self.stated)

    def with_stated(self, stated: Mapping[str, Stated], more: Sequence[Parameter] = ()) -> SearchSpace:
        """Return the space in which values with an error [SI] move; `more` are rows that the table lacks."""
        table = ParameterTable([*self.table.values(), *more], self.table.derived)
        rows = []
        for name, value in stated.items():
            row = replace(table[name], nominal=float(value), scale="linear")
            rows.append(_between(row, table[name], value, _FARTHEST_PULL))
        fixed = {name: value for name, value in self.fixed.items() if name not in stated}
        fixed |= {row.name: row.nominal for row in more if row.name not in stated}
        return SearchSpace(table, (*self.free, *rows), fixed, {**self.stated, **stated})

    def restating(self, stated: Mapping[str, Stated]) -> SearchSpace:
        """Return the space in which other values are stated of some rows [their units]."""
        return SearchSpace(self.table, self.found, self.fixed).with_stated({**self.stated, **stated})

    def starting(self, name: str, value: float) -> SearchSpace:
        """Return the space whose search keeps a stated value near another [its unit] until its finisher."""
        free = [
            replace(row, nominal=float(np.clip(value, row.lower, row.upper))) if row.name == name else row
            for row in self.free
        ]
        return replace(self, free=tuple(free))

    def unstating(self, names: Collection[str]) -> SearchSpace:
        """Return the space in which the search looks for some rows, whatever is stated of them."""
        wider = self.widened(names)
        stated = {name: value for name, value in self.stated.items() if name not in names}
        rows = sorted(wider.free[len(self.found) :], key=lambda row: row.name in stated)
        return SearchSpace(self.table, (*self.found, *rows), self.fixed, stated)

    def widened(self, names: Collection[str]) -> SearchSpace:
        """Return the space in which stated values may be off by far."""
        return replace(
            self,
            free=tuple(
                _between(row, self.table[row.name], self.stated[row.name], _FARTHEST_OFF)
                if row.name in names
                else row
                for row in self.free
            ),
        )

    @property
    def found(self) -> tuple[Parameter, ...]:
        """The free rows of which nothing is stated: what the search looks for."""
        return self.free[: len(self.free) - len(self.stated)]

    def pulls(self, rows: FloatArray) -> FloatArray:
        """Return how far rows (P, n_table) [SI] lie from the stated values (P, S) [standard errors]."""
        places = [self.table.index[name] for name in self.stated]
        errors = np.array([value.error for value in self.stated.values()])
        # In rows of memory, so that a sum over one has the same bits whatever its neighbours.
        return np.ascontiguousarray((rows[:, places] - np.array([*self.stated.values()])) / errors)

    def misses(self, rows: FloatArray) -> FloatArray:
        """Return the residuals of rows (P, n_table) [SI] by what is stated (P, S) [1].

        Up to three standard errors that is the distance. Beyond, a slip is likelier than chance, and a square
        would bend all other parameters to it: the square of the residual grows like the logarithm of the
        distance (Cauchy's tail, smoothly joined), so that a statement which the trials contradict lets go.
        """
        return loosened(self.pulls(rows))[0]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters in search order."""
        return tuple(p.name for p in self.free)

    @cached_property
    def columns(self) -> list[int]:
        """Places of the free parameters in the table, in search order."""
        return [self.table.index[p.name] for p in self.free]

    @cached_property
    def _edges(self) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Lower and upper bounds, as logarithms on logarithmic scales, and which scales are logarithmic."""
        log = np.array([p.scale == "log" for p in self.free], dtype=np.bool_)
        bounds = np.array([[p.lower, p.upper] for p in self.free], dtype=np.float64).reshape(-1, 2)
        low, high = (np.where(log, np.log(np.where(log, edge, 1.0)), edge) for edge in bounds.T)
        return low, high, log

    def decode(self, cube: FloatArray) -> FloatArray:
        """Map unit-cube points (..., n_free) to parameter values (..., n_free) [SI]."""
        low, high, log = self._edges
        linear = low + np.asarray(cube, dtype=np.float64) * (high - low)
        return np.where(log, np.exp(np.where(log, linear, 0.0)), linear)

    def encode(self, values: FloatArray) -> FloatArray:
        """Map parameter values (..., n_free) [SI] to the unit cube; outside the bounds gives < 0 or > 1."""
        low, high, log = self._edges
        values = np.asarray(values, dtype=np.float64)
        linear = np.where(log, np.log(np.where(log, values, 1.0)), values)
        return (linear - low) / (high - low)

    def full(self, cube: FloatArray) -> FloatArray:
        """Map unit-cube points (n, n_free) to rows of the whole table (n, len(table)) in table order [SI]."""
        cube = np.atleast_2d(cube)
        out = np.empty((len(cube), len(self.table)))
        for name, value in self.fixed.items():
            out[:, self.table.index[name]] = value
        out[:, self.columns] = self.decode(cube)
        return out

    def at_bound(self, cube: FloatArray) -> NDArray[np.int8]:
        """Return -1 within 1 % of the lower bound, +1 of the upper, else 0, of points (P, n_free) [1]."""
        cube = np.asarray(cube)
        return np.where(cube < AT_BOUND, -1, np.where(cube > 1 - AT_BOUND, 1, 0)).astype(np.int8)


def loosened(pulls: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the residuals of distances from stated values [standard errors], and their derivatives [1]."""
    far = np.maximum(np.abs(pulls) / _SLIP, 1.0)
    size = np.sqrt(1.0 + 2.0 * np.log(far))
    return np.where(far > 1.0, np.sign(pulls) * _SLIP * size, pulls), 1.0 / (far * size)


class Named(Protocol):
    """A parameter's name and symbol, and the trial that alone has it; a row or a record."""

    @property
    def name(self) -> str: ...
    @property
    def symbol(self) -> str: ...
    @property
    def trial(self) -> str: ...


def common_name(parameter: Named) -> str:
    """Return a parameter's name without its trial."""
    return parameter.name.removesuffix(f"[{parameter.trial}]")


def in_words(parameter: Named, of_trial: bool = True) -> str:
    """Return a parameter as a sentence names it: ``ground damping (b_s)``; with its trial or without."""
    words, symbol = common_name(parameter).replace("_", " "), parameter.symbol
    if parameter.trial:
        symbol = symbol if of_trial else symbol.partition(" of ")[0]
        words += f" of {parameter.trial}" if of_trial else ""
    return words if symbol in ("", words) else f"{words} ({symbol})"


def about(parameter: Named, code: str, sentence: str, size: float = 0.0) -> Finding:
    """Return a finding about a parameter; one about a parameter of a single trial can be folded."""
    trials = (parameter.trial,) if parameter.trial else ()
    return Finding(code, sentence, trials=trials, size=size, parameters=(common_name(parameter),))


def with_unit(text: str, unit: str) -> str:
    """Return a number with its unit; alone where that is 1."""
    return text if unit in ("", "1") else f"{text} {unit}"


def _between(row: Parameter, unbound: Parameter, value: Stated, farthest: float) -> Parameter:
    """Return a row between bounds `farthest` standard errors from its stated value; `unbound` has a sign."""
    reach = farthest * value.error
    low = max(value - reach, _LEAST_SHARE * value) if unbound.lower >= 0 else value - reach
    return replace(row, lower=float(low), upper=float(value + reach))
