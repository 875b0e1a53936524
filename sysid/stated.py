"""Numbers that a campaign states, with the error of their measurement."""

from __future__ import annotations

import math
import re

from sysid.errors import UnitError
from sysid.units import ERROR_SIGN, NUMBER, parse_quantity


class Stated(float):
    """A number of a campaign [SI] with its standard error: a float wherever a float is expected."""

    # One sigma, in the unit of the number; 0: exact.
    error: float
    # Typical error of such a measurement, such as ``"1 g"``, where the campaign states none; else empty.
    assumed: str

    def __new__(cls, value: float, error: float = 0.0, assumed: str = "") -> Stated:
        number = super().__new__(cls, value)
        number.error, number.assumed = error, assumed
        return number

    def __reduce__(self) -> tuple[type[Stated], tuple[float, float, str]]:
        return Stated, (float(self), self.error, self.assumed)


def error_of(value: float) -> float:
    """Return the standard error of a number, in its unit; 0 of a plain float, which is exact."""
    return value.error if isinstance(value, Stated) else 0.0


def without_error(text: str) -> str:
    """Return a quantity's text without its error: ``"20 deg"`` of ``"20 ± 0.2 deg"``."""
    return _parted(text)[0]


def parse_stated(text: str, expected: str) -> tuple[float, float | None]:
    """Return a quantity and its standard error [SI], as in ``"20 ± 0.2 deg"``; None where none is stated.

    ``+-`` and ``+/-`` stand for ``±`` as well; the error may have a unit of its own, or be a share of the
    value, ``± 3 %``. ``± 0``, or ``exact`` after the quantity, is an error of 0. Raises UnitError as
    `parse_quantity` does, and for an error that is negative, infinite or a share of nothing.
    """
    quantity, error = _parted(text)
    value = parse_quantity(quantity, expected)
    return value, None if error is None else _error(error, value, expected, text)


def typical_error(error: str, value: float, expected: str) -> float:
    """Return an error [SI] that stands as ``"1 g"`` or ``"3 %"``, of a value [SI]; the share of 0 is 0."""
    return abs(value) * float(error[:-1]) / 100 if error.endswith("%") else parse_quantity(error, expected)


def _parted(text: str) -> tuple[str, str | None]:
    """Return the texts of a quantity and of its error; None where the text states none."""
    exact = re.fullmatch(r"\s*(.*\S)\s+exact\s*", text)
    if exact and not ERROR_SIGN.search(text):
        return exact[1], "0"
    quantity, *errors = (part.strip() for part in ERROR_SIGN.split(text, maxsplit=1))
    if errors and (ERROR_SIGN.search(errors[0]) or errors[0].endswith("exact")):
        raise UnitError(f"{text!r} states two errors; write one standard deviation")
    if not errors:
        return text, None
    # In "20 ± 0.2 deg" the unit belongs to both.
    if re.fullmatch(NUMBER, quantity) and "%" not in errors[0]:
        quantity = f"{quantity} {re.sub(f'^{NUMBER}', '', errors[0]).strip()}".strip()
    return quantity, errors[0]


def _error(error: str, value: float, expected: str, text: str) -> float:
    number = re.fullmatch(rf"({NUMBER})\s*(.*)", error)
    if number and number[1].startswith("-"):
        raise UnitError(f"the error in {text!r} is negative; write its size, one standard deviation")
    if number and float(number[1]) == 0.0 and number[2] in ("", "%"):
        return 0.0
    if number and "%" in error:
        if number[2] != "%" or "%" in ERROR_SIGN.split(text)[0] or value == 0:
            unit = "" if expected == "1" else f" {expected}"
            raise UnitError(
                f"the error in {text!r} is no share of a value; write a share as '2.5{unit} ± 3 %', or the "
                f"error itself as '2.5 ± 0.1{unit}'"
            )
        size = typical_error(error, value, expected)
    else:
        try:
            size = parse_quantity(error, expected)
        except UnitError as reason:
            raise UnitError(f"the error in {text!r}: {reason}") from None
    if not math.isfinite(size):
        raise UnitError(f"the error in {text!r} is not finite; write one standard deviation")
    return size
