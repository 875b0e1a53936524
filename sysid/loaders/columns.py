"""Columns by name stem and unit, never by position: ``Thrust (gf)``, ``x [mm]``, ``px_m``."""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from sysid.errors import LogError, UnitError
from sysid.journal import Finding, note
from sysid.loaders.options import LogOptions
from sysid.loaders.source import SPACES, Source, Text, read_text, shortened, split_line
from sysid.loaders.table import (
    HEADER_SEARCH,
    STAMPS,
    Numbers,
    TableHead,
    all_numeric,
    find_header,
    read_numbers,
    stamped,
)
from sysid.units import factor_to_si

_BRACKETED = re.compile(r"^(?P<stem>.*?)\s*[(\[]\s*(?P<unit>[^()\[\]]*?)\s*[)\]]$")
# A name and, behind an underscore, its unit; longer units come first, because the first that fits is taken.
_SUFFIXED = re.compile(
    r"^(?P<stem>.+?)_(?P<unit>rad_s|deg_s|m_s2|m_s|N_m|mm|cm|ms|us|ns|Nm|rpm|deg|rad|m|s|N|V|A)$"
)
_SUFFIX_UNITS = {"rad_s": "rad/s", "deg_s": "deg/s", "m_s": "m/s", "m_s2": "m/s^2", "N_m": "N*m"}
# Standard gravity, which accelerometers write as "g"; elsewhere that is a gram.
_ACCELERATION = {"g": "g_0", "G": "g_0"}

_LONGEST_NAME = 160

COMMAND_UNITS = {"us": "us", "µs": "us", "μs": "us", "dshot": "dshot", "1": "1", "-": "1", "": "1", "%": "%"}


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


def split_label(label: str) -> tuple[str, str | None, bool]:
    """Return (stem, unit, whether it is only the end of the name) of a label; without a unit it is None."""
    text = label.strip().strip('"').strip()
    bracketed, suffixed = _BRACKETED.match(text), _SUFFIXED.match(text)
    unit: str | None = None
    if match := bracketed or suffixed:
        text, unit = match["stem"], match["unit"]
    guessed = bracketed is None and suffixed is not None
    if guessed and unit is not None:
        unit = _SUFFIX_UNITS.get(unit, unit)
    return re.sub(r"[\s_.:/]+", " ", text).strip().casefold(), unit, guessed


def parse_header(names: Sequence[str]) -> tuple[Column, ...]:
    """Return the columns of a header line."""
    # A damaged line may be a single name of a megabyte, on which the patterns above take minutes.
    shown = [shortened(name, _LONGEST_NAME) for name in names]
    return tuple(Column(index, name, *split_label(name)) for index, name in enumerate(shown))


def header_columns(source: Source) -> tuple[Column, ...]:
    """Return the columns of a log's header line; none without one."""
    header = find_header(source.head_lines)
    return parse_header(header[2]) if header else ()


def listing(names: Iterable[str]) -> str:
    """Return names for a message, quoted, the first dozen."""
    names = [shortened(name, 80) for name in names if name]
    shown = ", ".join(f'"{name}"' for name in names[:12])
    return (f"{shown} and {len(names) - 12} more" if len(names) > 12 else shown) or "none"


def factor_or_none(unit: str, expected: str = "") -> float | None:
    """Return the factor from a unit to SI; None where it is not known or of another dimension."""
    try:
        return factor_to_si(unit, expected)
    except UnitError:
        return None


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


def axis_columns(path: str, columns: Iterable[Column], pattern: re.Pattern[str]) -> dict[str, Column]:
    """Return axis -> column of the columns whose stem fits a pattern, a group of which is the axis."""
    matched: dict[str, Column] = {}
    for column in columns:
        if match := pattern.match(column.stem):
            axis = next(group for group in match.groups() if group)
            if axis in matched:
                raise LogError(
                    f'{path}: columns "{matched[axis].label}" and "{column.label}" both name component '
                    f"{axis}; this format has one body, so remove or rename one"
                )
            matched[axis] = column
    return matched


def declare_unit(channel: str, unit: str) -> str:
    """Return the advice to declare a unit, as a campaign and as the command line write it."""
    units = f'units = {{{channel} = "{unit}"}}'
    return f"declare it, for example {units} (on the command line -o '{units}')"


class DeclaredUnits:
    """Units that a user declares for columns, by label, stem or channel name; they win over the header."""

    def __init__(self, path: str, units: Mapping[str, str] | None) -> None:
        self.path = path
        if units is not None and not isinstance(units, Mapping):
            raise LogError(f'{path}: units = {units!r} is no table; expected for example {{thrust = "N"}}')
        self._declared = {str(name): str(unit) for name, unit in (units or {}).items()}
        self._used: set[str] = set()
        self._overruled: dict[tuple[str, str], None] = {}
        self._guessed: dict[str, str] = {}

    @property
    def notes(self) -> list[Finding]:
        """What a reader should know about the units."""
        notes = [
            note(
                "unit-declared-over-header",
                f"column {label!r} read in the declared unit {unit!r}, not in the header's",
            )
            for label, unit in self._overruled
        ]
        by_unit: dict[str, list[str]] = {}
        for label, unit in self._guessed.items():
            by_unit.setdefault(unit, []).append(label)
        if by_unit:
            guessed = "; ".join(f"{unit} of {listing(labels)}" for unit, labels in by_unit.items())
            sentence = f"units taken from the ends of names, so check them: {guessed}"
            notes.append(note("units-from-names", sentence))
        return notes

    def unit_of(self, column: Column, channel: str, default: str | None = None) -> str | None:
        """Return the unit of a column: declared, else of the header, else `default`."""
        names = [name.casefold() for name in (channel, column.label, column.stem)]
        match = next((key for name in names for key in self._declared if key.casefold() == name), None)
        if column.unit == STAMPS:
            if match is not None:
                raise UnitError(f"{self.path}: times by ISO 8601 need no unit; leave {match} out of units")
            return "us"
        if match is not None:
            self._used.add(match)
            declared = self._declared[match]
            if column.unit not in (None, declared):
                self._overruled[column.label, declared] = None
            return declared
        if column.guessed and column.unit is not None:
            self._guessed[column.label] = column.unit
        return default if column.unit is None else column.unit

    def factor(self, column: Column, channel: str, expected: str, default: str | None = None) -> float:
        """Return the factor from a column's unit to SI; UnitError without one or of another dimension."""
        unit = self.unit_of(column, channel, default)
        if unit is None:
            raise UnitError(
                f'{self.path}: column "{column.label}" states no unit; ' + declare_unit(channel, expected)
            ).asking(units={column.label: expected})
        if expected == "m/s^2":
            unit = _ACCELERATION.get(unit, unit)
        try:
            return factor_to_si(unit, expected)
        except UnitError as error:
            turns = ""
            if expected == "rad/s" and unit.casefold() in ("hz", "1/s"):
                turns = f'; if these are revolutions per second, declare units = {{{channel} = "rev/s"}}'
            refusal = UnitError(f'{self.path}: column "{column.label}": {error}{turns}')
            weights = {"g": "gf", "kg": "kgf", "lb": "lbf", "oz": "ozf"} if expected == "N" else {}
            raise (
                refusal.asking(units={column.label: weights[unit]}) if unit in weights else refusal
            ) from error

    def command(self, column: Column) -> str:
        """Return the unit of a command, see `sysid.types.CommandUnit`; UnitError for others."""
        unit = self.unit_of(column, "command")
        if unit is None or unit.casefold() not in COMMAND_UNITS:
            fault = "states no unit" if unit is None else f"has unit {unit!r}"
            raise UnitError(
                f'{self.path}: command column "{column.label}" {fault}; expected us, dshot, 1 or %, '
                'declared for example as units = {command = "us"}'
            ).asking(units={column.label: "command"})
        return COMMAND_UNITS[unit.casefold()]

    def check_used(self, columns: Sequence[Column]) -> None:
        """Refuse declared units that belong to no column."""
        unused = sorted(set(self._declared) - self._used)
        if unused:
            raise UnitError(
                f'{self.path}: units names "{unused[0]}", which is no column that is read here; '
                f"found {listing(column.label for column in columns)}"
            )


def _renamed(path: str, names: Sequence[str], columns: Mapping[str, object]) -> list[str]:
    """Return the names of a header with some replaced; a unit in brackets stays with its column."""
    out = list(names)
    for new, stated in columns.items():
        place = names.index(stated) if isinstance(stated, str) and stated in names else -1
        if isinstance(stated, int) and not isinstance(stated, bool) and 1 <= stated <= len(names):
            place = stated - 1
        stems = [split_label(name)[0] for name in names]
        if place < 0 and isinstance(stated, str) and stems.count(split_label(stated)[0]) == 1:
            place = stems.index(split_label(stated)[0])
        if place < 0:
            raise LogError(
                f"{path}: columns says that {new} is {stated!r}, which is neither a column nor its number "
                f"from 1; found {listing(names)}"
            )
        unit = split_label(names[place])[1]
        out[place] = str(new) if unit is None else f"{new} ({unit})"
    return out


def table_head(
    text: Text, columns: Sequence[str] | Mapping[str, object] | None = None, *, renames: bool = True
) -> TableHead:
    """Return the header of a table.

    `columns` are names that the user declares for a log without header or with a wrong one: all of them in
    order, or new name -> name in the header (or its number from 1). `renames`: the format has an option for
    them, which a message may advise. A missing header and a wrong number of names are a LogError.
    """
    lines = list(text.lines(HEADER_SEARCH))
    header = find_header([line for _, _, line in lines])
    if header is None:
        raise LogError(
            f"{text.path}: only blank or comment lines; expected a header line and rows of numbers"
        )
    index, delimiter, names = header
    number, offset, _ = lines[index]
    headless = all_numeric(names)
    if headless:
        number, offset = number - 1, lines[index - 1][1] if index else 0
    if headless and (columns is None or isinstance(columns, Mapping)):
        advice = (
            "declare all of them in order, columns = [...]"
            if renames
            else "put the instrument's header line back"
        )
        raise LogError(
            f"{text.path}, line {lines[index][0]}: found numbers where the header line should name the "
            f"columns; {advice}"
        )
    if isinstance(columns, Mapping):
        names = _renamed(text.path, names, columns)
    elif columns is not None:
        if isinstance(columns, str) or not isinstance(columns, Sequence):
            raise LogError(f"{text.path}: columns = {columns!r} is no list of names")
        if len(columns) != len(names):
            raise LogError(
                f"{text.path}: columns declares {len(columns)} names but line {lines[index][0]} has "
                f"{len(names)} cells; name every column, in order"
            )
        names = [str(name) for name in columns]
    units, line = _units_below(lines[index + 1 :], delimiter, len(names)) if not headless else ([], None)
    if line is not None:
        number, offset = line
        names = [
            f"{name} ({unit})" if unit and split_label(name)[1] is None else name
            for name, unit in zip(names, units, strict=True)
        ]
    trailing = 0 if delimiter == SPACES else len(split_line(lines[index][2], delimiter)) - len(names)
    return TableHead(tuple(names), delimiter, number, offset, trailing)


def _units_below(
    lines: Sequence[tuple[int, int, str]], delimiter: str, count: int
) -> tuple[list[str], tuple[int, int] | None]:
    """Return the units of `count` columns in a row of their own below the header, and where that row ends."""
    number, offset, text = next((line for line in lines if line[2].strip()), (0, 0, ""))
    units = [cell.strip().strip("[]()").strip() for cell in split_line(text, delimiter)[:count]]
    filled = [unit for unit in units if unit]
    known = len(units) == count and filled and not any(all_numeric([unit]) for unit in filled)
    if known and all(unit.casefold() in COMMAND_UNITS or factor_or_none(unit) is not None for unit in filled):
        return units, (number, offset)
    return [], None


class NamedTable:
    """The table of a text log, whose `columns` are found by name, with the units that the user declares."""

    def __init__(self, source: Source, options: LogOptions, *, renames: bool = True) -> None:
        self.path, self.text = source.path, read_text(source)
        self.text, self.head = stamped(self.text, table_head(self.text, options.columns, renames=renames))
        self.columns = parse_header(self.head.names)
        self.declared = DeclaredUnits(self.path, options.units)

    def find(self, stems: Collection[str]) -> Column | None:
        """Return the column whose stem is one of `stems`, or None; LogError when two columns answer to it."""
        matches = [column for column in self.columns if column.stem in stems]
        if len(matches) > 1:
            raise LogError(
                f"{self.path}: columns {matches[0].index + 1} and {matches[1].index + 1} are both named "
                f'"{shortened(matches[1].label, 80)}"; rename or remove one'
            )
        return matches[0] if matches else None

    def missing(self, wanted: str) -> LogError:
        """Return the refusal of a log that lacks a column."""
        return LogError(
            f"{self.path}: no column {wanted}; found {listing(column.label for column in self.columns)}; "
            "rename the column in the log, or name the format if this is another kind of log"
        )

    def read(self, wanted: Iterable[Column]) -> Numbers:
        """Return the numbers of some columns; the file's bytes are released."""
        text = self.text
        del self.text
        return read_numbers(text, self.head, [column.index for column in wanted])
