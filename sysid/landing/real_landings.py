"""Real landings compared with a map: read from a table, looked up in the map, counted."""

import csv
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sysid.errors import LogError
from sysid.landing.controllers import Controller
from sysid.landing.maps import LandingMap, nearest_cell
from sysid.landing.outcomes import OUTCOMES, Outcome

COLUMNS = ("surface", "controller", "slope [deg]", "speed [m/s]", "outcome")
# Words of a table for an outcome, and the classes that agree with each: a board of 45 cm cannot tell a drone
# that left the board and came to rest later from one that flipped.
WORDS: dict[str, tuple[Outcome, ...]] = {
    "short": (Outcome.SHORT,),
    "near": (Outcome.NEAR,),
    "flipped": (Outcome.FLIPPED,),
    "other": (Outcome.OTHER,),
    "landed": (Outcome.SHORT,),
    "failed": (Outcome.NEAR, Outcome.FLIPPED, Outcome.OTHER),
}
# Words of a table for a surface.
SURFACE_WORDS = {"low friction": "lf", "low": "lf", "high friction": "hf", "high": "hf"}


@dataclass(frozen=True)
class Experiment:
    """One landing of a real drone."""

    surface: str  # as the map calls it
    controller: str  # as the map calls it, or its name alone, whatever triggers it
    slope_deg: float
    speed: float  # vertical touchdown speed [m/s]
    outcome: str  # one of `WORDS`


@dataclass(frozen=True, eq=False)
class Confusion:
    """Observed against simulated on one map."""

    words: tuple[str, ...]  # n observed outcomes
    counts: NDArray[np.int64]  # (n, 4) landings by observed word and likeliest simulated class (`OUTCOMES`)
    agreeing: int  # landings whose cell agrees with what was observed
    # Landings off the map, and landings in cells that the simulation lost: both are counted nowhere else.
    outside: int
    lost: int = 0

    def document(self) -> dict[str, object]:
        """Return the counts by observed outcome and simulated class, and the totals, ready for JSON."""
        names = [outcome.name.lower() for outcome in OUTCOMES]
        counts = {
            word: dict(zip(names, row, strict=True))
            for word, row in zip(self.words, self.counts.tolist(), strict=True)
        }
        totals = {"agreeing": self.agreeing, "outside": self.outside, "lost": self.lost}
        return {"counts": counts, **totals}


def read_experiments(path: Path) -> tuple[Experiment, ...]:
    """Return the rows of a CSV file with the columns of `COLUMNS`.

    Raises `LogError` for a table that cannot be read, or a row that makes no sense.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream)
            rows = list(reader)
            columns = [name.strip() for name in reader.fieldnames or ()]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise LogError(f"{path}: cannot be read as CSV ({error}); give a table of landings") from error
    missing = [name for name in COLUMNS if name not in columns]
    if missing:
        raise LogError(
            f"{path}: no column {missing[0]!r}, found {', '.join(columns) or 'nothing'}; expected the "
            f"columns {', '.join(COLUMNS)}"
        )
    out = []
    for number, row in enumerate(rows, start=2):
        cells = {(key or "").strip(): (value or "").strip() for key, value in row.items() if key is not None}
        word = cells["outcome"].lower()
        if word not in WORDS:
            raise LogError(
                f"{path}, row {number}: outcome {cells['outcome']!r}; expected one of {', '.join(WORDS)}"
            )
        try:
            slope, speed = float(cells["slope [deg]"]), float(cells["speed [m/s]"])
        except ValueError:
            slope = speed = math.nan
        if not (math.isfinite(slope) and math.isfinite(speed) and speed >= 0):
            raise LogError(
                f"{path}, row {number}: slope {cells['slope [deg]']!r}, speed {cells['speed [m/s]']!r}; "
                "expected numbers, the speed downward and 0 or more"
            )
        surface = " ".join(cells["surface"].lower().replace("-", " ").replace("_", " ").split())
        out.append(Experiment(SURFACE_WORDS.get(surface, surface), cells["controller"], slope, speed, word))
    return tuple(out)


def of_map(experiments: Sequence[Experiment], landings: LandingMap) -> list[Experiment]:
    """Return the experiments that were made on the map's surface under its controller."""
    return [e for e in experiments if _belongs(e, landings.surface, landings.controller, landings.law)]


def strangers(
    experiments: Sequence[Experiment], maps: Sequence[tuple[str, Controller]]
) -> dict[tuple[str, str], int]:
    """Count the experiments that belong to no map, by surface and controller."""
    left = [e for e in experiments if not any(_belongs(e, s, c.label, c.name) for s, c in maps)]
    return dict(Counter((e.surface, e.controller) for e in left))


def _belongs(experiment: Experiment, surface: str, *names: str) -> bool:
    """Say whether an experiment is one of a map; a real drone names neither its trigger nor its motors."""
    stated, *known = ("".join(name.lower().split()) for name in (experiment.controller, *names))
    return experiment.surface == surface and stated in known


def confusion(experiments: Sequence[Experiment], landings: LandingMap) -> Confusion:
    """Count what was observed against the likeliest class of the nearest cell of a map."""
    words = tuple(word for word in WORDS if any(e.outcome == word for e in experiments))
    counts = np.zeros((len(words), len(OUTCOMES)), dtype=np.int64)
    agreeing = outside = lost = 0
    likeliest = landings.likeliest
    for experiment in experiments:
        row = nearest_cell(landings.slopes_deg, experiment.slope_deg)
        column = nearest_cell(landings.speeds, experiment.speed)
        if row is None or column is None:
            outside += 1
            continue
        code = Outcome(int(likeliest[row, column]))
        if code == Outcome.LOST:
            lost += 1
            continue
        counts[words.index(experiment.outcome), OUTCOMES.index(code)] += 1
        agreeing += code in WORDS[experiment.outcome]
    return Confusion(words, counts, agreeing, outside, lost)
