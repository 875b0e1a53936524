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
    "RPM": "rpm", "Rpm": "rpm", "U/min": "rpm", "r/min": "rpm", "min-1": "1/min", "RPS": "revolution/s",
    "rev/s": "revolution/s", "Ohm": "ohm",
    "Nm": "N*m", "N-m": "N*m", "Nmm": "N*mm", "N-mm": "N*mm", "mNm": "mN*m",
    **dict.fromkeys(("lbf-in", "in-lbf", "in-lb", "in-lbs", "lb-in"), "lbf*inch"),
    **dict.fromkeys(("lbf-ft", "ft-lbf", "ft-lb", "ft-lbs", "lb-ft"), "lbf*foot"),
    "ºC": "degC", "º": "deg", "": "1", "-": "1",
}  # fmt: skip

# Spellings of revolutions per minute that leave the revolutions out.
_PER_MINUTE = ("1/min", "min^-1", "min⁻¹", "min-1")

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
    """Return the factor that turns a value in `unit` (``"gf"``, ``"RPM"``, ``"kg·m²"``) into SI.

    Raises UnitError when the unit is unknown, or of another dimension than the unit `expected`.
    """
    base = _parse_unit(unit)
    if expected:
        wanted = _parse_unit(expected)
        if unit.strip() in _PER_MINUTE and str(wanted.units) == "radian / second":
            base = _parse_unit("rpm")
        # A frequency is no angular speed although both are 1/s: where the caller names an angle, the base
        # units are compared, radian included.
        mixes_hertz = "radian" in str(wanted.units) and "radian" not in str(base.units)
        if base.dimensionality != wanted.dimensionality or (
            mixes_hertz and wanted.dimensionality == {"[time]": -1}
        ):
            likely = "expected a unit of that dimension"
            if base.check("[mass]") and wanted.check("[force]"):
                likely = f"did you mean {unit.strip() + 'f'!r}, the weight of that mass?"
            raise UnitError(f"unit {unit!r} is not a {expected!r}; {likely}")
    return float(base.magnitude)


def parse_quantity(text: str, expected: str) -> float:
    """Return the SI value of a quantity written as ``"1.242 kg"``; a pure number where ``"1"`` is expected.

    Raises UnitError when there is no number, no unit, an unknown unit or one of another dimension.
    """
    match = _QUANTITY.match(text)
    if not match:
        raise UnitError(f"{text!r} is not a number with a unit; expected for example '1 {expected}'")
    number, unit = match.groups()
    if not unit and expected != "1":
        # Nothing of a drone is as long as 10 m.
        likely = "mm" if expected == "m" and abs(float(number)) >= 10 else expected
        raise UnitError(f"{text!r} has no unit; expected for example '{number} {likely}'")
    try:
        return float(number) * factor_to_si(unit, expected)
    except UnitError as error:
        raise UnitError(f"{error}; found {text!r}") from None
