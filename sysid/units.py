"""Unit strings to SI, once, at the door: inside sysid every number is SI.

A thin shell over pint that adds the spellings of thrust stands and load cells and turns
pint's errors into one sentence.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any

from sysid.errors import UnitError

# Spellings that instruments write and pint does not know.
_SPELLINGS = {
    "RPM": "rpm",
    "Rpm": "rpm",
    "RPS": "revolution/s",
    "rev/s": "revolution/s",
    "mNm": "mN*m",
    "lbf-in": "lbf*inch",
    "lbf-ft": "lbf*foot",
    "in-lbf": "lbf*inch",
    "in-lb": "lbf*inch",
    "in-lbs": "lbf*inch",
    "lb-in": "lbf*inch",
    "ft-lbf": "lbf*foot",
    "ft-lb": "lbf*foot",
    "ft-lbs": "lbf*foot",
    "lb-ft": "lbf*foot",
    "Nm": "N*m",
    "N-m": "N*m",
    "Nmm": "N*mm",
    "N-mm": "N*mm",
    "ºC": "degC",
    "º": "deg",
    "Ohm": "ohm",
    "": "1",
    "-": "1",
}

_QUANTITY = re.compile(r"^\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*$")


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


@lru_cache(maxsize=512)
def _parse_unit(unit: str) -> Any:
    text = _SPELLINGS.get(unit.strip(), unit.strip())
    # kg.m2, m2 and the like: an exponent typed without a caret.
    text = re.sub(r"(?<=[A-Za-zµΩ])([23])(?![\d.])", r"^\1", text.replace(".", "*"))
    try:
        return _registry().Quantity(1.0, text).to_base_units()
    except Exception as error:  # pint raises several unrelated types for one typo
        raise UnitError(f"unknown unit {unit!r}; write for example mm, kg·m², N·s/m, deg, rpm/V") from error


def factor_to_si(unit: str, expected: str = "") -> float:
    """Return the factor that turns a value in `unit` into SI.

    Parameters
    ----------
    unit : str
        Unit string as an instrument or a campaign writes it, e.g. ``"gf"``, ``"RPM"``, ``"kg·m²"``.
    expected : str
        A unit of the dimension that the caller needs; another dimension is refused. Empty: any.

    Raises
    ------
    UnitError
        When the unit is unknown or of another dimension than `expected`.
    """
    found = _parse_unit(unit)
    if expected:
        wanted = _parse_unit(expected)
        # A frequency is no angular speed although both are 1/s: compare the base units, radian included,
        # where the caller names an angle; elsewhere radian is the pure number it is.
        mixes_hertz = "radian" in str(wanted.units) and "radian" not in str(found.units)
        if found.dimensionality != wanted.dimensionality or (
            mixes_hertz and wanted.dimensionality == {"[time]": -1}
        ):
            raise UnitError(f"unit {unit!r} is not a {expected!r}; expected a unit of that dimension")
    return float(found.magnitude)


def parse_quantity(text: str, expected: str) -> float:
    """Return the SI value of a quantity written as ``"1.242 kg"``.

    Parameters
    ----------
    text : str
        Number and unit; a pure number is accepted only where `expected` is ``"1"``.
    expected : str
        A unit of the dimension that is expected, e.g. ``"kg"``.

    Raises
    ------
    UnitError
        When there is no number, no unit, an unknown unit or one of another dimension.
    """
    match = _QUANTITY.match(text)
    if not match:
        raise UnitError(f"{text!r} is not a number with a unit; expected for example '1 {expected}'")
    number, unit = match.groups()
    if not unit and expected != "1":
        raise UnitError(f"{text!r} has no unit; expected for example '{number} {expected}'")
    return float(number) * factor_to_si(unit, expected)
