"""Unit strings to SI, once, at the door: inside sysid every number is SI.

A thin shell over pint that adds the spellings of thrust stands and load cells and turns
pint's errors into one sentence.
"""

import math
import re
from functools import lru_cache
from numbers import Real
from tokenize import TokenError
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

# Longest unit that is read [characters], and a power of a number, which may have more digits than memory.
_LONGEST = 60
_POWER_OF_NUMBER = re.compile(r"[\d⁰¹²³⁴⁵⁶⁷⁸⁹][\s)]*(\*\*|\^|[⁰¹²³⁴⁵⁶⁷⁸⁹])")
# The errors of pint on what is no unit depend on where its parser ends.
_NO_UNIT = (
    ValueError, TypeError, AttributeError, LookupError, ArithmeticError, AssertionError, SyntaxError,
    TokenError, RecursionError,
)  # fmt: skip

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_QUANTITY = re.compile(rf"^\s*({NUMBER})\s*(.*?)\s*$")
# Sign between a value and its standard error; `sysid.stated` reads both.
ERROR_SIGN = re.compile(r"±|\+/?-")


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True)


@lru_cache(maxsize=512)
def _parse_unit(unit: str, number: float = 1.0) -> Any:
    text = _SPELLINGS.get(unit.strip(), unit.strip())
    # kg.m2, m2 and the like: an exponent typed without a caret.
    text = re.sub(r"(?<=[A-Za-zµΩ])([23])(?![\d.])", r"^\1", text.replace(".", "*"))
    # Outside of the try: an installation that lacks a part of pint knows no unit at all.
    registry = _registry()
    try:
        if len(text) > _LONGEST or _POWER_OF_NUMBER.search(text):
            raise ValueError("too long, or a number raised to a power")
        return registry.Quantity(number, text).to_base_units()
    except _NO_UNIT as error:
        raise UnitError(f"unknown unit {unit!r}; write for example mm, kg·m², N·s/m, deg, rpm/V") from error


def _angles(unit: Any) -> dict[str, Any]:
    """Return the powers of the angles in a unit, which for pint have no dimension."""
    return {name: power for name, power in unit.unit_items() if name in ("radian", "steradian")}


def powers_of_unit(unit: str) -> tuple[float, float, float]:
    """Return the powers of mass, length and time in a unit; an angle has none."""
    found = _parse_unit(unit).dimensionality
    mass, length, time = (float(found.get(f"[{name}]", 0.0)) for name in ("mass", "length", "time"))
    return mass, length, time


def factor_to_si(unit: str, expected: str = "") -> float:
    """Return the factor that turns a value in `unit` (``"gf"``, ``"RPM"``, ``"kg·m²"``) into SI.

    Raises UnitError when the unit is unknown, or of another dimension than the unit `expected`.
    """
    base = _parse_unit(unit)
    if expected:
        wanted = _parse_unit(expected)
        if unit.strip() in _PER_MINUTE and str(wanted.units) == "radian / second":
            base = _parse_unit("rpm")
        # A frequency is no angular speed although both are 1/s, and a ratio of lengths is no angle.
        if base.dimensionality != wanted.dimensionality or _angles(base) != _angles(wanted):
            likely = "expected a unit of that dimension"
            if base.check("[mass]") and wanted.check("[force]"):
                likely = f"did you mean {unit.strip() + 'f'!r}, the weight of that mass?"
            elif unit.strip() in ("%", "percent") and _angles(wanted):
                likely = "a slope of p % has the angle atan(p/100), so write '20 deg' for 36.4 %"
            elif base.dimensionality == wanted.dimensionality:
                likely = "one of the two has an angle that the other lacks"
            raise UnitError(f"unit {unit!r} is not a {expected!r}; {likely}")
        if _parse_unit(unit, 0.0).magnitude:
            raise UnitError(
                f"unit {unit!r} has another zero than {expected!r}, so no factor converts it; write kelvin"
            )
    return float(base.magnitude)


def in_si(value: float | str, unit: str, what: str = "a quantity") -> float:
    """Return a number in SI as it is, and a text with a unit in SI, see `parse_quantity`.

    UnitError, which says `what`, where the value is neither or not finite.
    """
    try:
        number = parse_quantity(value, unit) if isinstance(value, str) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number) or isinstance(value, bool | bytes):
        raise UnitError(
            f"{what}: expected a number [{unit}] or a text such as '1 {unit}', found {value!r:.60}"
        ).also(ValueError if isinstance(value, Real | str) else TypeError)
    return number


def parse_quantity(text: str, expected: str) -> float:
    """Return the SI value of a quantity written as ``"1.242 kg"``; a pure number where ``"1"`` is expected.

    Raises UnitError when there is no number, no unit, an unknown unit or one of another dimension.
    """
    match = _QUANTITY.match(text)
    if match and ERROR_SIGN.search(match[2]):
        raise UnitError(
            f"{text!r} states an error, and none can be stated here; write '{match[1]}' with its unit"
        )
    if not match:
        raise UnitError(f"{text!r} is not a number with a unit; expected for example '1 {expected}'")
    number, unit = match.groups()
    if unit[:1] == "," and unit[1:2].isdigit():
        raise UnitError(f"{text!r} has a comma; write a point before decimals, and nothing between thousands")
    if not unit and expected != "1":
        # Nothing of a drone is as long as 10 m.
        long = expected == "m" and abs(float(number)) >= 10
        # Angles are read off in degrees.
        likely = "mm" if long else "deg" if expected == "rad" else expected
        raise UnitError(f"{text!r} has no unit; expected for example '{number} {likely}'")
    try:
        return float(number) * factor_to_si(unit, expected)
    except UnitError as error:
        raise UnitError(f"{error}; found {text!r}") from None
