"""How every figure looks: colours, labels with units, the width of a page, files.

Nothing goes through pyplot: no window, no backend and no state is shared. Colours are Okabe and Ito's, which
colour-blind readers tell apart. matplotlib is imported where something is drawn, because commands that
print need this module as well.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid.errors import ExportError
from sysid.fit.result import FitResult
from sysid.storage import write_file
from sysid.types import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MEASURED = "#000000"
BEST = "#D55E00"
OTHERS = "#56B4E9"
MASKED = "#E6E6E6"
RUNS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#000000")
# Words for the use of a trial in a fit.
USES = {"fit": "fitted", "validate": "not fitted"}
# Width of a figure on a page that a phone shows too [in].
WIDTH = 4.3

# Greatest number of drawn points of a curve; of more only the least and largest of every stretch are drawn.
_POINTS = 900
# Unit in which a channel is shown where that is not its SI unit, and the factor to it.
_UNITS = {"q_B": ("deg", 180.0 / np.pi), "torque": ("mN·m", 1e3), "stator_torque": ("mN·m", 1e3)}
_FORMATS = (".png", ".pdf", ".svg")
_INDEXED = re.compile(r"(\w[^\W_]*)_([^\W_]+)")


# Keyword arguments of matplotlib.
Style = dict[str, Any]
# Drawing of each look of a curve, and of the bars of a legend.
LOOKS: dict[str, Style] = {
    "line": {"linewidth": 1.3},
    "thin": {"linewidth": 0.8},
    "thick": {"linewidth": 2.2},
    "bar": {"linewidth": 3.0},
    "dashed": {"linewidth": 1.3, "linestyle": "--"},
    "dots": {"linestyle": "none", "marker": ".", "markersize": 3.0},
    "steps": {"linewidth": 1.3, "drawstyle": "steps-post"},
}
# A line of a legend: a colour, how it is drawn (a key of `LOOKS`, or ``area``), words.
Entry = tuple[str, str, str]
# A place (x, z) in the units of the axes.
Point = tuple[float, float] | FloatArray


def panel(height: float, width: float = WIDTH, *, grid: bool = True, **rows: Any) -> tuple[Figure, Any]:
    """Return a figure [in] and its axes: one, or as many as `rows` says to `Figure.subplots`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    axes = figure.subplots(**rows)
    for each in figure.axes if grid else ():
        draw_grid(each)
    return figure, axes


def panels(
    count: int, columns: int, cell: tuple[float, float], around: tuple[float, float], *, grid: bool = True,
    **how: Any,
) -> tuple[Figure, list[Axes]]:  # fmt: skip
    """Return a figure of `count` panels, row by row; `cell` and `around` are width and height [in]."""
    rows = -(-max(1, count) // columns)
    size = (cell[0] * columns + around[0], cell[1] * rows + around[1])
    figure, every = panel(size[1], size[0], grid=grid, nrows=rows, ncols=columns, squeeze=False, **how)
    for axes in every.flat[count:]:
        axes.set_visible(False)
    return figure, every.ravel().tolist()[:count]


def draw_grid(axes: Axes) -> None:
    """Draw a pale grid behind the curves."""
    axes.grid(True, color="0.92")
    axes.set_axisbelow(True)


def draw_legend(figure: Figure, entries: Iterable[Entry], place: Any, ncols: int, **look: Any) -> None:
    """Draw a legend for all panels of a figure."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Patch(color=colour, label=as_words(words))
        if kind == "area"
        else Line2D([], [], color=colour, label=as_words(words), **LOOKS[kind])
        for colour, kind, words in entries
    ]
    figure.legend(handles=handles, loc=place, ncols=ncols, frameon=False, **look)


def directions(angle: float | FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the unit vectors (..., 2) in x and z along and normal to what is pitched by an angle [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([cosine, -sine], axis=-1), np.stack([sine, cosine], axis=-1)


def draw_line(axes: Axes, points: Sequence[Point], colour: str, width: float, **look: Any) -> None:
    """Draw a line from point to point."""
    axes.plot(*np.array(points).T, color=colour, linewidth=width, **look)


def arrow(
    axes: Axes, start: Point, end: Point, colour: str, width: float = 2.0, *, zorder: int = 6, **look: Any
) -> None:
    """Draw an arrow from point to point."""
    chosen = {"arrowstyle": "-|>", "color": colour, "linewidth": width, "shrinkA": 0, "shrinkB": 0} | look
    axes.annotate("", (end[0], end[1]), (start[0], start[1]), zorder=zorder, arrowprops=chosen)


def paper(pad: float, **look: Any) -> Style:
    """Return the white box behind words that a curve may cross."""
    return {"facecolor": "white", "edgecolor": "none", "pad": pad} | look


def peaks(curves: Sequence[FloatArray], points: int) -> IntArray:
    """Return which `points` at most of curves (n,) look like all: least and largest of every stretch."""
    count = len(curves[0])
    if count <= points:
        return np.arange(count)
    edges = np.linspace(0, count, points // (2 * len(curves) + 1)).astype(int)[:-1]
    kept = [edges, np.array([count - 1])]
    for values in curves:
        for worst, extreme in ((np.inf, np.argmin), (-np.inf, np.argmax)):
            stretches = np.split(np.where(np.isfinite(values), values, worst), edges[1:])
            kept.append(edges + [int(extreme(stretch)) for stretch in stretches])
    return np.unique(np.concatenate(kept))


def thinned(time: FloatArray, values: FloatArray, points: int = _POINTS) -> tuple[FloatArray, FloatArray]:
    """Return a curve (k,) that looks like one (n,) with few points."""
    kept = peaks([values], points)
    return time[kept], values[kept]


def as_words(words: str) -> str:
    """Return words in which matplotlib sees no formula, as names may hold dollars."""
    return words.replace("$", r"\$")


@contextmanager
def without_glyph_warnings() -> Iterator[None]:
    """Draw boxes for letters that the font lacks; matplotlib would warn of each in every picture."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        yield


def as_math(symbol: str) -> str:
    """Return a symbol of the tables, as ``k_h``, for a figure, its indices set lower."""
    return _INDEXED.sub(r"$\1_{\2}$", as_words(symbol))


def axis_label(name: str, unit: str) -> str:
    """Return ``name [unit]``; a number without unit is ``name [1]``."""
    return f"{name} [{unit or '1'}]"


def unit_of(fit: FitResult, c: int) -> tuple[str, float]:
    """Return the unit in which channel number `c` is shown, and the factor to it from SI."""
    return _UNITS.get(fit.channels[c], (fit.channel_units[c], 1.0))


def percent_text(share: float) -> str:
    """Return a share [1] in percent; a dash where it is unknown."""
    if not np.isfinite(share):
        return "—"
    return f"{100 * share:.{1 if share >= 0.1 else 2}f} %"


def check_figure_name(path: Path) -> None:
    """Raise an ExportError for another suffix than ``.png``, ``.pdf`` or ``.svg``."""
    if path.suffix.lower() not in _FORMATS:
        raise ExportError(
            f"{path}: unknown figure format {path.suffix!r}; expected one of {', '.join(_FORMATS)}"
        )


def figure_bytes(figure: Figure, kind: str, dpi: float = 150.0) -> bytes:
    """Return a figure as ``png``, ``pdf`` or ``svg``; the same figure gives the same bytes.

    `dpi` are the pixels per inch of a PNG, and of dense curves inside the others.
    """
    from matplotlib import rc_context

    buffer = io.BytesIO()
    # A date or random names would make the bytes of equal figures differ.
    metadata = {"png": {}, "pdf": {"CreationDate": None}, "svg": {"Date": None}}[kind]
    with rc_context({"svg.hashsalt": "sysid"}), without_glyph_warnings():
        figure.savefig(buffer, format=kind, dpi=dpi, metadata=metadata)
    return buffer.getvalue()


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a figure as PNG, PDF or SVG; an existing file is replaced only by a complete one.

    An ExportError names another suffix, or a file that cannot be written.
    """
    path = Path(path)
    check_figure_name(path)
    write_file(path, figure_bytes(figure, path.suffix.lower()[1:]), ExportError)
    return path
