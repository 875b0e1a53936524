"""Cells of a map that a reader touches: class, distance, time, and the command that simulates the cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.landing.maps import cell_edges
from sysid.landing.outcomes import Rules
from sysid.report.html import Html, filled
from sysid.report.landing_figures import COLOURS, class_words
from sysid.report.plots import embedded
from sysid.types import BoolArray, FloatArray


@dataclass(frozen=True)
class CellAxis:
    """An axis of cells: its name, and the value of each cell; `even` cells are as wide as each other."""

    name: str
    unit: str
    values: tuple[float, ...]
    even: bool = False


@dataclass(frozen=True, eq=False)
class CellChart:
    """Landings over two axes, and how to simulate each; NaN where nothing came to rest."""

    title: str
    across: CellAxis
    up: CellAxis
    rows: tuple[str, ...]  # landings in every cell: R sets, or one row for all
    outcome: NDArray[np.int8]  # (R, n, m) `Outcome` codes
    distance: FloatArray  # (R, n, m) displacement [m]
    time: FloatArray  # (R, n, m) time to rest [s]
    # Texts, and numbers of the parts that each cell replaces: 0 the value across, 1 up, 2 and on `texts`.
    command: tuple[str | int, ...]
    texts: tuple[NDArray[Any], ...] = ()  # (n, m) each
    doubt: BoolArray | None = None  # (n, m) half the tolerance changes a class
    share: FloatArray | None = None  # (n, m) landings that come to rest within the long distance [1]
    decides: NDArray[np.str_] | None = None  # (n, m) what decides a doubtful cell, in words

    def document(self) -> dict[str, object]:
        """Return what the page's script draws: thousandths as whole numbers, cells row by row."""

        def whole(values: FloatArray) -> list[list[int | None]]:
            flat = 1e3 * values.reshape(len(values), -1)
            return [[None if not np.isfinite(v) else round(v) for v in row] for row in flat.tolist()]

        def axis(chosen: CellAxis) -> dict[str, object]:
            edges = cell_edges(np.array(range(len(chosen.values)) if chosen.even else chosen.values)).tolist()
            # The values as a command states them.
            texts = [f"{value:.12g}" for value in chosen.values]
            return {"name": chosen.name, "unit": chosen.unit, "texts": texts, "edges": edges}

        return {
            "title": self.title, "x": axis(self.across), "y": axis(self.up), "rows": list(self.rows),
            "outcome": ["".join(map(str, row.ravel().tolist())) for row in self.outcome],
            "distance": whole(np.abs(self.distance)), "time": whole(self.time),
            "command": list(self.command), "texts": [text.ravel().tolist() for text in self.texts],
            "doubt": None if self.doubt is None else "".join(map(str, self.doubt.ravel().astype(int))),
            "share": None if self.share is None else whole(self.share[None])[0],
            "decides": None if self.decides is None else self.decides.ravel().tolist(),
        }  # fmt: skip


def explorer(charts: Sequence[CellChart], rules: Rules, notes: Sequence[str] = ()) -> Html:
    """Return charts to choose from, whose cells pointer, touch and keys read; `notes` stand below."""
    document = {
        "charts": [chart.document() for chart in charts],
        "colours": list(COLOURS.values()),
        "words": list(class_words(rules.short, rules.long).values()),
        "long": f"{rules.long:g} m",
    }
    titles = [chart.title for chart in charts]
    return filled("cells.html.j2", titles=titles, notes=notes, data=embedded(document))
