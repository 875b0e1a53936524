"""Columns by name stem and unit, never by position: ``Thrust (gf)``, ``x [mm]``, ``px_m``."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from sysid.errors import LogError, UnitError
from sysid.journal import Finding, note
from sysid.loaders.source import shortened
from sysid.units import factor_to_si

_BRACKETED = re.compile(r"^(?P<stem>.*?)\s*[(\[]\s*(?P<unit>[^()\[\]]*?)\s*[)\]]$")
# Units that headers append to a name with an underscore; the longest come first.
_SUFFIXED = re.compile(
    r"^(?P<stem>.+?)_(?P<unit>rad_s|deg_s|m_s2|m_s|N_m|mm|cm|ms|us|ns|Nm|rpm|deg|rad|m|s|N|V|A)$"
)
_SUFFIX_UNITS = {"rad_s": "rad/s", "deg_s": "deg/s", "m_s": "m/s", "m_s2": "m/s^2", "N_m": "N*m"}
# Standard gravity where an accelerometer writes "g", which is a gram elsewhere.
_ACCELERATION = {"g": "g_0", "G": "g_0"}

_LONGEST_NAME = 160

COMMAND_UNITS = {"us": "us", "µs": "us", "μs": "us", "dshot": "dshot", "1": "1", "-": "1", "": "1"}


@dataclass(frozen=True)
class Column:
    """One column of a header.

    `index` counts from 0; `label` is as the header writes it; `stem` is the lower-case name without unit,
    words separated by one space; `unit` is None where none is stated; `guessed`: the unit is only the end of
    the name, as in ``px_m``.
    """

    index: int
    label: str
    stem: str
    unit: str | None
    guessed: bool = False


def split_label(label: str) -> tuple[str, str | None]:
    """Return (stem, unit) of a header label; the unit is None where the label has none."""
    text = label.strip().strip('"').strip()
    match = _BRACKETED.match(text)
    unit: str | None = None
    if match:
        text, unit = match["stem"], match["unit"]
    elif match := _SUFFIXED.match(text):
        text, unit = match["stem"], _SUFFIX_UNITS.get(match["unit"], match["unit"])
    return re.sub(r"[\s_.:/]+", " ", text).strip().casefold(), unit


def suffix_unit(label: str) -> str | None:
    """Return the unit that a label without brackets seems to end in (``Fz_N``), or None."""
    return None if _BRACKETED.match(label.strip().strip('"').strip()) else split_label(label)[1]


def parse_header(names: Sequence[str]) -> tuple[Column, ...]:
    """Return the columns of a header line."""
    # A damaged line may be one name of a megabyte, on which patterns of names take for ever.
    shown = [shortened(name, _LONGEST_NAME) for name in names]
    return tuple(
        Column(index, name, *split_label(name), suffix_unit(name) is not None)
        for index, name in enumerate(shown)
    )


def listing(names: Iterable[str]) -> str:
    """Return names for a message, quoted, the first dozen."""
    names = [shortened(name, 80) for name in names if name]
    shown = ", ".join(f'"{name}"' for name in names[:12])
    return (f"{shown} and {len(names) - 12} more" if len(names) > 12 else shown) or "none"


@contextmanager
def naming(where: str) -> Iterator[None]:
    """Put `where` before the message of an error of units."""
    try:
        yield
    except UnitError as error:
        raise UnitError(f"{where}: {error}") from error


def listing_note(code: str, what: str, names: Collection[str]) -> list[Finding]:
    """Return a note that lists names; none without a name."""
    return [note(code, f"{what}: {listing(names)}")] if names else []


def unread_note(columns: Iterable[Column], read: Iterable[Column]) -> list[Finding]:
    """Return a note that names the columns of a header that are not read, so that none is missed."""
    known = {column.index for column in read}
    left = [column.label for column in columns if column.index not in known and column.label.strip()]
    return listing_note("columns-not-read", "columns not read", left)


def find_column(path: str, columns: Sequence[Column], stems: Collection[str]) -> Column | None:
    """Return the column whose stem is one of `stems`, or None; LogError when two columns answer to it."""
    matches = [column for column in columns if column.stem in stems]
    if len(matches) > 1:
        raise LogError(
            f"{path}: columns {matches[0].index + 1} and {matches[1].index + 1} are both named "
            f'"{shortened(matches[1].label, 80)}"; rename or remove one'
        )
    return matches[0] if matches else None


def missing_column(path: str, wanted: str, columns: Sequence[Column]) -> LogError:
    """Return the refusal of a log that lacks a column."""
    return LogError(
        f"{path}: no column {wanted}; found {listing(column.label for column in columns)}; "
        "rename the column in the log, or name the format if this is another kind of log"
    )


class DeclaredUnits:
    """Units that a user declares for columns, by label, stem or channel name; they win over the header."""

    def __init__(self, path: str, units: Mapping[str, str] | None) -> None:
        self.path = path
        if units is not None and not isinstance(units, Mapping):
            raise LogError(f'{path}: units = {units!r} is no table; expected for example {{thrust = "N"}}')
        self._declared = {str(name): str(unit) for name, unit in (units or {}).items()}
        self._used: set[str] = set()
        self._said: list[Finding] = []
        self._guessed: dict[str, str] = {}

    @property
    def notes(self) -> list[Finding]:
        """What a reader should know about the units, one sentence each."""
        if not self._guessed:
            return self._said
        by_unit: dict[str, list[str]] = {}
        for label, unit in self._guessed.items():
            by_unit.setdefault(unit, []).append(label)
        guessed = "; ".join(f"{unit} of {listing(labels)}" for unit, labels in by_unit.items())
        sentence = f"units taken from the ends of names, so check them: {guessed}"
        return [*self._said, note("units-from-names", sentence)]

    def unit_of(self, column: Column, channel: str, default: str | None = None) -> str | None:
        """Return the unit of a column: declared, else of the header, else `default`."""
        for name in (channel, column.label, split_label(column.label)[0], column.stem):
            match = next(
                (key for key in self._declared if key == name or key.casefold() == name.casefold()), None
            )
            if match is not None:
                self._used.add(match)
                declared = self._declared[match]
                if column.unit is not None and column.unit != declared:
                    sentence = (
                        f"column {column.label!r} read in the declared unit {declared!r}, not in the header's"
                    )
                    known = note("unit-declared-over-header", sentence)
                    self._said += [] if known in self._said else [known]
                return declared
        if column.guessed and column.unit is not None:
            self._guessed[column.label] = column.unit
        return default if column.unit is None else column.unit

    def factor(self, column: Column, channel: str, expected: str, default: str | None = None) -> float:
        """Return the factor from a column's unit to SI; UnitError without one or of another dimension."""
        unit = self.unit_of(column, channel, default)
        if unit is None:
            raise UnitError(
                f'{self.path}: column "{column.label}" states no unit; '
                f'declare it, for example units = {{{channel} = "{expected}"}}'
            )
        if expected == "m/s^2":
            unit = _ACCELERATION.get(unit, unit)
        try:
            return factor_to_si(unit, expected)
        except UnitError as error:
            turns = ""
            if expected == "rad/s" and unit.casefold() in ("hz", "1/s"):
                turns = f'; if these are revolutions per second, declare units = {{{channel} = "rev/s"}}'
            raise UnitError(f'{self.path}: column "{column.label}": {error}{turns}') from error

    def command(self, column: Column, default: str | None = None) -> str:
        """Return the unit of a command, ``us``, ``dshot`` or ``1`` (a fraction); UnitError for others."""
        unit = self.unit_of(column, "command", default)
        if unit is None or unit.casefold() not in COMMAND_UNITS:
            fault = "states no unit" if unit is None else f"has unit {unit!r}"
            raise UnitError(
                f'{self.path}: command column "{column.label}" {fault}; expected us, dshot or 1, '
                'declared for example as units = {command = "us"}'
            )
        return COMMAND_UNITS[unit.casefold()]

    def check_used(self, columns: Sequence[Column]) -> None:
        """Refuse declared units that belong to no column."""
        unused = sorted(set(self._declared) - self._used)
        if unused:
            raise UnitError(
                f'{self.path}: units names "{unused[0]}", which is no column that is read here; '
                f"found {listing(column.label for column in columns)}"
            )
