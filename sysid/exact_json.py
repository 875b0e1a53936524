"""JSON that gives back what it was given: every float bit for bit, NaN and infinity included.

JSON has no NaN and no infinity. They are written as the strings ``"NaN"``, ``"Infinity"`` and
``"-Infinity"`` (the convention of Protocol Buffers' JSON); a text that happens to read so gets a leading
apostrophe, which reading takes off again.
"""

import json
import math
import re
from collections.abc import Mapping
from typing import Any, NoReturn

import numpy as np

# Texts that stand for the numbers that JSON lacks.
SPECIAL = {"NaN": math.nan, "Infinity": math.inf, "-Infinity": -math.inf}
_LOOKS_SPECIAL = re.compile(r"'*(NaN|-?Infinity)\Z")


def encoded(value: object) -> Any:
    """Return `value` in a form that JSON can store."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        if math.isfinite(value):
            return value
        return "NaN" if math.isnan(value) else ("Infinity" if value > 0 else "-Infinity")
    if isinstance(value, str):
        return "'" + value if _LOOKS_SPECIAL.match(value) else value
    if isinstance(value, Mapping):
        if not all(isinstance(key, str) for key in value):
            raise TypeError(f"keys {list(value)!r} are not all text")
        return {key: encoded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [encoded(item) for item in value]
    raise TypeError(f"{type(value).__name__} has no place in a result file; convert it to numbers or text")


def decoded(value: object) -> Any:
    """Return what `encoded` was given."""
    if isinstance(value, str):
        if value in SPECIAL:
            return SPECIAL[value]
        return value[1:] if value.startswith("'") and _LOOKS_SPECIAL.match(value) else value
    if isinstance(value, dict):
        return {key: decoded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [decoded(item) for item in value]
    return value


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not JSON")


def dumps(value: object, *, indent: int | None = 2) -> str:
    """Return the JSON text of mappings, sequences, arrays, numbers, text, booleans, None; else TypeError."""
    return json.dumps(encoded(value), indent=indent, ensure_ascii=False, allow_nan=False)


def loads(text: str) -> Any:
    """Return what `dumps` was given, arrays and tuples as lists; ValueError where that is no JSON."""
    try:
        return decoded(json.loads(text, parse_constant=_refuse))
    except RecursionError as error:
        raise ValueError(f"lists in lists without end ({error})") from error


def plain(value: object) -> Any:
    """Return `value` as reading it back would: arrays and tuples as lists, numpy scalars as numbers."""
    return decoded(encoded(value))
