"""A lab that measures with the errors that its campaign states: true campaigns, misstated."""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

# Standard error of each key of a synthetic gear campaign: its unit, or a share in percent.
GOOD_LAB = {
    "body_mass": "1 g", "body_inertia": "3 %", "foot_dx": "1 mm", "foot_dz": "1 mm", "leg_mass": "1 g",
    "leg_inertia": "10 %", "kinetic_friction": "3 %", "centre_of_mass_offset": "1 mm", "point": "1 mm",
    "slope": "0.2 deg", "tilt": "0.1 deg",
}  # fmt: skip
# The same of a synthetic motor campaign; the errors of static curves are in their logs.
MOTOR_LAB = {"kv": "2 %", "rotor_inertia": "5 %", "reference_voltage": "0.5 %"}
_QUANTITY = re.compile(r'"?(-?[0-9.e-]+) ?([^"\s±]*)"?')
_SMALLER = {"g": ("kg", 1e-3)}


def misstated(
    path: Path, seed: int, *, name: str, errors: Mapping[str, str] = GOOD_LAB, times: float = 1.0,
    gross: Mapping[str, float] | None = None, written: bool = True,
) -> Path:  # fmt: skip
    """Write a copy of a campaign whose values are drawn from `errors`, `times` larger than it states.

    `gross` errors [standard errors] replace those that are drawn, by key; a key of one drop is ``slope[3]``,
    a component of a point ``point[1]``. The copy states the errors if they are `written`. Without a seed
    above 0 nothing is drawn.
    """
    random, gross, seen = np.random.default_rng(seed), dict(gross or {}), {}
    # Synthetic captures are level and do not say so. Their tilt is drawn apart: the other draws stay.
    of_tilt = np.random.default_rng([max(seed, 0), 1])
    text = re.sub(r"(?m)^centre_of_mass_offset", r'tilt = "0 deg"\n\g<0>', path.read_text(encoding="utf-8"))
    lines = []
    for line in text.splitlines():
        if line.startswith("exact = true"):
            continue
        key = line.partition(" = ")[0]
        if key not in errors or key == line:
            lines.append(line)
            continue
        seen[key] = seen.get(key, 0) + 1
        number = iter(range(9))

        head, _, tail = line.partition(" = ")

        def stated(match: re.Match[str], key: str = key, number=number, tail: str = tail) -> str:
            value, unit = float(match[1]), match[2]
            size, error_unit = errors[key].split()
            where = next(number)
            sigma = abs(value) * float(size) / 100 if error_unit == "%" else float(size)
            other, factor = _SMALLER.get(error_unit, (unit, 1.0))
            sigma *= factor if other == unit and error_unit != "%" else 1.0
            drawn = (of_tilt if key == "tilt" else random).standard_normal() * (seed > 0)
            one = f"slope[{seen[key]}]" if key == "slope" else f"{key}[{where}]" if "[" in tail else key
            drawn = gross.get(one, drawn * times) / times
            text = f"{value + times * drawn * sigma:.8g}"
            return f'"{text} ± {sigma:.4g} {unit}"' if written else f'"{text} {unit}"'

        body, hash_, comment = tail.partition("  #")
        lines.append(f"{head} = {_QUANTITY.sub(stated, body)}{hash_}{comment}")
    assert set(errors) >= {one.partition("[")[0] for one in gross}
    other = path.with_name(name)
    other.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return other


def scaled(log: Path, column: str, factor: float) -> None:
    """Multiply the numbers of a column of a CSV log, whose header begins with `column`."""
    head, *rows = log.read_text(encoding="utf-8-sig").splitlines()
    place = next(i for i, name in enumerate(head.split(",")) if name.startswith(column))
    cells = [row.split(",") for row in rows]
    for row in cells:
        row[place] = row[place] and f"{factor * float(row[place]):.9g}"
    log.write_text("\n".join([head, *map(",".join, cells)]) + "\n", encoding="utf-8")
