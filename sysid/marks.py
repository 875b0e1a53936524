"""Marks: what a setting is called, means and accepts, stated once beside its field.

`Annotated` carries a mark: ``speed: Annotated[float, Flag("Touchdown speed.", unit="m/s", least=0)]``. The
command line (`sysid.cli.adapter`), Python (`sysid.api`) and a pydantic table with that field read it. A
field that is a dataclass itself contributes its fields. A field without a mark is stated only by code that
makes the object. The module imports nothing heavy: the program's help needs it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints

from annotated_types import Ge, Le

from sysid.errors import CampaignError, SysidError, UnitError
from sysid.units import parse_quantity

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler
    from pydantic_core import CoreSchema

# Heading of options that few users need.
MORE = "More"
# Headings of a long help that stand in `--help-all` only.
RARE = (MORE, "Search", "Impulses", "When a landing is over")
# Largest number of values of a grid; a slip of the pen asks for billions.
_MOST_VALUES = 100_000
# One of each unit in SI, for bare numbers; every other unit of a mark is an SI unit.
_SI = {"deg": math.pi / 180, "mm": 1e-3}


@dataclass(frozen=True)
class Argument:
    """A field that the command line takes by its position; `help` is what the user reads.

    `read` makes the field's value from what the user gives.
    """

    help: str
    read: Callable[..., object] | None = None


class Flag:
    """A field that the command line takes by its name, ``--name`` of the field or one of `names`.

    The user reads `help`, under the heading `panel` where a command has many options, see `RARE`. A field
    with a `unit` takes quantities such as ``"20 deg"``; a bare number is in that unit, but an angle needs
    its unit, because Python's bare angles are in rad. The field's value is in SI. `least` is the smallest
    number that is accepted, in that unit, `most` the largest whole number. `read` makes the field's value
    from the text that the user gives and the name of the option. The help shows `default`, or the field's
    default.
    """

    def __init__(
        self,
        help: str,
        *names: str,
        least: float | None = None,
        most: int | None = None,
        unit: str = "",
        read: Callable[[str, str], object] | None = None,
        default: str = "",
        panel: str = "",
    ) -> None:
        self.help, self.names, self.least, self.most, self.unit = help, names, least, most, unit
        self.read, self.default, self.panel = read, default, panel

    def spelled(self, field: str) -> tuple[str, ...]:
        """Return how the command line spells the option of a field."""
        return self.names or (f"--{field.replace('_', '-')}",)

    def quantity(self, text: str, name: str) -> float:
        """Return what the user gave for the option `name` in SI; `UnitError` where it cannot be used."""
        value = stated_quantity(text, self.unit, name)
        if self.least is not None and value < self.least * _SI.get(self.unit, 1.0):
            raise UnitError(f"{name} {text}: expected {self.least:g} {self.unit} or more")
        return value

    def bare(self, value: float) -> str:
        """Return a value, given in SI, as the shortest text that the option reads."""
        return f"{value / _SI.get(self.unit, 1.0):.12g}{'deg' if self.unit == 'deg' else ''}"

    def shown(self, value: float) -> str:
        """Return a default, given in SI, in the unit of the option."""
        return f"{value / _SI.get(self.unit, 1.0):.6g} {self.unit}"

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        # The rest of a mark is for texts, which are read before pydantic checks the value.
        least = None if self.least is None else self.least * _SI.get(self.unit, 1.0)
        source = source if least is None else Annotated[source, Ge(least)]
        return handler(source if self.most is None else Annotated[source, Le(self.most)])


def mark_of(hint: object) -> Argument | Flag | None:
    """Return the mark of an annotation."""
    marks = (mark for mark in get_args(hint)[1:] if isinstance(mark, (Argument, Flag)))
    return next(marks, None) if get_origin(hint) is Annotated else None


def field_hints(cls: Any) -> dict[str, object]:
    """Return the annotations of a dataclass by field: those with a mark, and nested dataclasses."""
    hints = get_type_hints(cls, include_extras=True)
    every = {f.name: hints[f.name] for f in fields(cls)}
    return {name: hint for name, hint in every.items() if mark_of(hint) or is_dataclass(hint)}


def field_values(
    hints: Mapping[str, object], given: Mapping[str, object], read: Callable[[str, object, object], object]
) -> dict[str, Any]:
    """Return the values of fields, by their `field_hints`, as far as they are given.

    `read` gets name, given value and annotation. A nested dataclass is made of what is given for its fields.
    """
    out: dict[str, object] = {}
    for name, hint in hints.items():
        if is_dataclass(hint):
            assert isinstance(hint, type)
            out[name] = hint(**field_values(field_hints(hint), given, read))
        elif name in given:
            out[name] = read(name, given[name], hint)
    return out


def stated_quantity(text: str, unit: str, name: str) -> float:
    """Return a quantity such as ``20 deg`` in SI, a bare number from `unit`; a refusal names `name`.

    An angle needs its unit.
    """
    also = "" if unit == "deg" else f"; a bare number is in {unit}"
    try:
        value = float(text) * _SI.get(unit, 1.0)
        if also == "" and math.isfinite(value):
            raise UnitError(f"{name}: {text!r} has no unit; expected for example '{text} deg'")
    except ValueError:
        try:
            value = parse_quantity(text, unit)
        except UnitError as error:
            raise UnitError(f"{name}: {error}{also}") from error
    if not math.isfinite(value):
        raise UnitError(f"{name} {text}: expected a finite number{also}")
    return value


def degrees(text: str, name: str) -> float:
    """Return an angle [deg] from a text such as ``0.1 rad``."""
    return round(math.degrees(stated_quantity(text, "deg", name)), 9)


def seconds(text: str, name: str) -> float:
    """Return a time [s] above 0 from a text such as ``20min``; a lone ``m`` means minutes."""
    try:
        value = parse_quantity(text.replace("m", "min") if text[-1:] == "m" else text, "s")
    except UnitError as error:
        raise SysidError(f"{name} {text}: {error}") from error
    if not value > 0:
        raise SysidError(f"{name} {text}: expected a time above 0, for example 20min")
    return value


def grid_flag(name: str, default: str, help: str, unit: str) -> Flag:
    """Return the mark of a grid of numbers in `unit`, see `span`; `default` is the text of the default."""
    help = f"{help} [{unit}]: first:last:step, or a list."
    return Flag(help, name, read=partial(span, unit=unit), default=default)


def span(text: str, name: str, unit: str = "1") -> tuple[float, ...]:
    """Return ``first:last:step`` or a list ``a,b,c`` as increasing numbers in `unit`.

    A unit stands behind each number, or behind the last one for all: ``0:45:1 deg``; angles need it. `name`
    stands in a refusal.
    """
    values: list[float] = []
    if not isinstance(text, str):
        raise CampaignError(f"{name} {text!r:.60}: expected a text such as '0:45:1' or '5,10,20'")
    parts = re.split("[:,]", text)
    behind = parts[-1].strip().lstrip("+-.0123456789eE")
    if behind and len(parts) > 1 and all(_is_number(part) for part in parts[:-1]):
        parts = [*(f"{part} {behind}" for part in parts[:-1]), parts[-1]]
    try:
        if ":" in text and len(parts) != 3:
            raise ValueError
        if unit == "deg" and any(map(_is_number, parts)):
            raise UnitError(f"an angle has no unit; expected for example '{text.strip()} deg'")
        # In `unit`, where bare numbers keep every digit.
        numbers = [
            float(part) if _is_number(part) else parse_quantity(part, unit) / _SI.get(unit, 1.0)
            for part in parts
        ]
        if ":" in text:
            first, last, step = numbers
            # Never past `last`; the excess keeps 0:0.3:0.1 whole, whose quotient falls short of 3.
            count = math.floor((last - first) / step + 1e-9) + 1
            values = [first + step * i for i in range(count if count <= _MOST_VALUES else 0)]
        else:
            values = numbers
    except UnitError as error:
        raise CampaignError(f"{name} {text!r}: {error}") from error
    except (ValueError, ZeroDivisionError, OverflowError):
        pass
    rising = all(b > a for a, b in pairwise(values))
    if not values or not rising or not all(math.isfinite(value) for value in values):
        example = "0:45:1 deg" if unit == "deg" else "0:45:1"
        raise CampaignError(
            f"{name} {text!r}: expected first:last:step or increasing numbers, as in {example}"
        )
    return tuple(round(value, 9) for value in values)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
