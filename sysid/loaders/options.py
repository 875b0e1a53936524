"""What a user may declare of a log: each option once, with its unit, its check and a sentence of help.

A format names the options that it takes; `sysid.loaders.load`, the refusals and the tables `[log]` and
`[capture]` of a campaign read the same declarations.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, get_type_hints

from sysid.errors import UnitError
from sysid.units import factor_to_si, parse_quantity


def quantity(value: object, unit: str) -> float:
    """Return the SI value of a quantity of a campaign, such as ``"5 kHz"``; ValueError for anything else."""
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ValueError(f"expected a quantity such as '1 {unit}'")
    try:
        return parse_quantity(value if isinstance(value, str) else repr(value), unit)
    except UnitError as error:
        raise ValueError(str(error)) from error


@dataclass(frozen=True)
class Option:
    """One option of loaders.

    `unit` is of a positive quantity, given as a number in it or as a text with a unit; `choices` are the
    values of all formats together (empty: any); `check` returns the value or raises ValueError.
    """

    help: str
    unit: str = ""
    choices: tuple[str, ...] = ()
    check: Callable[[object], object] | None = None

    def stated(self, value: object) -> object:
        """Return a value as a campaign states it, a quantity with its unit; ValueError says what is wrong."""
        if value is None:
            return None
        if self.unit:
            value = quantity(value, self.unit)
            if not value > 0:
                raise ValueError(f"expected more than 0 {self.unit}")
        if self.choices and value not in self.choices:
            raise ValueError(f"expected one of {', '.join(self.choices)}")
        return value if self.check is None else self.check(value)

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        # A pydantic table that inherits the option checks it by `stated`, then by its type.
        from pydantic_core import core_schema

        return core_schema.no_info_before_validator_function(self.stated, handler(source))


def known_unit(unit: object) -> object:
    """Return a unit that sysid knows; the unit of a command belongs to its protocol."""
    if isinstance(unit, str) and unit not in ("us", "µs", "dshot", "DShot", "1", "%"):
        try:
            factor_to_si(unit)
        except UnitError as error:
            raise ValueError(str(error)) from error
    return unit


def _columns(value: object) -> object:
    if isinstance(value, Mapping) and all(type(place) in (str, int) for place in value.values()):
        return value
    if isinstance(value, list | tuple) and all(isinstance(name, str) for name in value):
        return value
    raise ValueError(
        'expected { speed = "tach" } (a new name and the one in the header, or its number), or a list of all '
        "names"
    )


def is_positive(value: object) -> bool:
    """Return whether an option is a number, finite and greater than 0."""
    # A whole number may be too large for a floating-point number.
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value <= sys.float_info.max


def _positive(value: object) -> object:
    if not is_positive(value):
        raise ValueError("expected a number greater than 0")
    return value


@dataclass(frozen=True)
class LogOptions:
    """What may be declared of every log; None is not declared."""

    units: Annotated[
        Mapping[str, Annotated[str, Option("Unit", check=known_unit)]] | None,
        Option("Units by channel or column, where the file states none or a wrong one."),
    ] = None
    columns: Annotated[
        Sequence[str] | Mapping[str, str | int] | None,
        Option(
            "All names in order for a log without header, or new name -> name in the header.", check=_columns
        ),
    ] = None
    time_back: Annotated[
        str | None,
        Option(
            "Drop rows whose time goes back, or refuse them; without it, only those late by some periods go.",
            choices=("refuse", "drop"),
        ),
    ] = None
    segment: Annotated[
        int | None, Option("Which segment to read, from 1, where the clock starts again.", check=_positive)
    ] = None

    def declared(self) -> dict[str, Any]:
        """Return the options that are declared; an empty table takes a declaration back and is None."""
        given = {field.name: getattr(self, field.name) for field in fields(type(self))}
        return {
            name: value if isinstance(value, bool) else value or None
            for name, value in given.items()
            if value is not None
        }


@dataclass(frozen=True)
class BenchOptions(LogOptions):
    """What may be declared of a load-cell or thrust-stand log."""

    rate: Annotated[
        float | None,
        Option("Sample rate; it wins over what the file states and replaces a clock too coarse.", unit="Hz"),
    ] = None
    datasets: Annotated[Mapping[str, str] | None, Option("Signals by channel; only these are read.")] = None
    static: Annotated[bool | None, Option("True: rows are averaged points; False: a running log.")] = None
    pulses_per_revolution: Annotated[
        float | None, Option("Pulses of the tachometer in one turn of the rotor.", check=_positive)
    ] = None
    calibration: Annotated[
        str | None, Option("The transducer's .cal file; the six channels are then gauge voltages.")
    ] = None
    transform: Annotated[
        Any, Option("From the load cell to the motor's axes: dx dy dz, then rx ry rz (`motor_transform`).")
    ] = None
    tare: Annotated[float | None, Option("Start without load, whose mean is subtracted.", unit="s")] = None


@dataclass(frozen=True)
class CaptureOptions(LogOptions):
    """What may be declared of a motion-capture log."""

    rigid_body: Annotated[
        str | Sequence[str] | None, Option("Bodies to keep; of a format of one body, its name.")
    ] = None
    bodies: Annotated[Mapping[str, tuple[str, ...]] | None, Option("Markers by body; fits its pose.")] = None
    topic: Annotated[str | None, Option("The only topic to read.")] = None
    quaternion_order: Annotated[str | None, Option("Order of q0 to q3.", choices=("wxyz", "xyzw"))] = None
    length_unit: Annotated[str | None, Option("Unit of lengths, if not stated.", check=known_unit)] = None
    euler_order: Annotated[str | None, Option("Order of the rotations, if not stated.")] = None
    angles: Annotated[str | None, Option('"helical" (rotation vector) or an Euler order.')] = None
    clock: Annotated[
        str | None, Option("Which times to use.", choices=("auto", "frame", "time", "header", "arrival"))
    ] = None


DECLARED: dict[str, Option] = {
    name: hint.__metadata__[0]
    for family in (BenchOptions, CaptureOptions)
    for name, hint in get_type_hints(family, include_extras=True).items()
}
