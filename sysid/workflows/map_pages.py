"""Pages of landing maps and design studies: cells that a reader touches, each with what simulates it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.errors import shell
from sysid.gear.model import PARAMETERS as GEAR
from sysid.landing.design_study import DesignStudy
from sysid.landing.maps import LandingMap, cell_edges
from sysid.landing.outcomes import Rules
from sysid.landing.store import MAPS, STUDY, MapFile, read_maps, read_study
from sysid.marks import Flag, field_hints, mark_of
from sysid.motor.model import PARAMETERS as MOTOR
from sysid.parameter_sets import DRAWS
from sysid.report.answer import answer_box
from sysid.report.design_figures import narrow_figures
from sysid.report.html import (
    NOTHING,
    Html,
    definitions,
    filled,
    heading,
    in_true_colours,
    joined,
    legend,
    markup_table,
    page,
    picture,
    side_by_side,
)
from sysid.report.landing_figures import (
    COLOURS,
    MapLegend,
    class_words,
    figure_impulse,
    figure_of_file,
    legend_entries,
)
from sysid.report.landing_tables import gains_table, maps_table
from sysid.report.plots import embedded
from sysid.report.table import Cell
from sysid.types import BoolArray, FloatArray, IntArray
from sysid.workflows.reopen import shown_from_here

_SLOPE, _SPEED = ("slope", "deg"), ("touchdown speed", "m/s")
# Numbers of the parts that a cell fills into its command: value across, value up, first of its own texts.
_ACROSS, _UP, _FIRST = 0, 1, 2
# A command as `CellChart.command` has it.
Command = tuple[str | int, ...]


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


def map_page(path: Path) -> str:
    """Return the page of a file of maps; raises `ExportError` for anything else."""
    content = read_maps(path)
    rules, simulate = Rules(**content.settings["rules"]), _Simulate.of(content.provenance, path)
    charts = _map_charts(content, rules, simulate)
    notes = list(simulate.notes)
    if content.impulses:
        notes.append("The impulse in the command is the best one of set 1.")
    surfaces = " and ".join(dict.fromkeys(chart.surface.upper() for chart in content.maps))
    lost = sum(chart.summary()["lost"] for chart in content.maps)
    words = (
        f"{path.name}: {len(content.maps)} maps of {surfaces}, {len(charts[0].across.values)} touchdown "
        f"speeds and {len(charts[0].up.values)} slopes each"
        + (f"; {lost} landings could not be simulated" if lost else "")
    )
    if content.maps[0].numbers and DRAWS not in content.provenance["motor"]:
        words += "; the motor has no draws, so its best set goes with every one"
    table = markup_table(maps_table([chart.summary() for chart in content.maps]))
    explored = explorer(charts, rules, notes)
    box = _map_answer(content, words)
    return _page(box, explored, table, _pictures(content), simulate, path)


def _map_answer(content: MapFile, words: str) -> Html:
    """Return the box above a page of maps: how steep is landed on, at the speed nearest to 1 m/s."""
    first, tiles = content.maps[0], []
    speed = float(first.speeds[np.argmin(np.abs(first.speeds - 1.0))])
    for chart in content.maps[:4]:
        slope = chart.steepest(speed)
        edge = "≥ " if slope == chart.slopes_deg[-1] else ""
        figure = f"{edge}{slope:g}°" if np.isfinite(slope) else "nowhere"
        tiles.append((figure, f"{chart.title}: steepest slope at {speed:g} m/s that {chart.quorum} land on"))
    following = "point at a cell below; its command simulates it"
    if not first.numbers:
        following += ". Runs of one fit do not show what its data leave open; `--draws 50` does"
    word = Cell(f"{len(first.sets)} {first.of}", "good" if first.numbers else "doubtful")
    return answer_box("Landing maps", word, words, tiles, following, NOTHING)


def _pictures(content: MapFile) -> Html:
    """Return a narrow picture of every map of a file and of its best impulses, under one legend."""
    pieces = []
    key: MapLegend = {}
    for chart in content.maps:
        safe = np.nan_to_num(chart.landed).max(axis=1) >= chart.enough
        steepest = f"{chart.slopes_deg[safe][-1]:g}°" if safe.any() else "none"
        words = (
            f"{chart.title}: outcome of landings over touchdown speed in m/s and slope in degrees; steepest "
            f"slope of the grid on which {chart.quorum} come to rest within 1 m at some speed: {steepest}"
        )
        pieces.append(picture(figure_of_file(content, key, chart), words))
    for best in content.impulses:
        words = f"delay and duration of the best impulse over touchdown speed and slope, {best.surface}"
        pieces.append(picture(figure_impulse([best], stacked=True), words))
    return in_true_colours(legend(legend_entries(key)) + side_by_side(pieces))


def study_page(path: Path) -> str:
    """Return the page of a design study; raises `ExportError` for anything else."""
    study, provenance = read_study(path)
    rules, simulate = study.settings.rules, _Simulate.of(provenance, path)
    changes = " and ".join(change.label for change in study.changes)
    words = f"{path.name}: {study.name}, {study.controller}: {len(study.points)} designs over {changes}"
    figures = side_by_side([
        picture(figure, f"slopes landed on and largest safe slope over {changes}: {what}")
        for what, figure in narrow_figures(study).items()
    ])  # fmt: skip
    explored = explorer(_study_charts(study, simulate, provenance), rules, simulate.notes)
    gains = study.gains()
    tiles = [
        (f"{row['gain_deg']:+.1f}°", f"{row['change']} {', '.join(f'{value:.3g}' for value in row['best'])}: "
         "more slope to land on, mean over the speeds")
        for row in gains[:3]
    ]  # fmt: skip
    buys = bool(gains) and gains[0]["gain_deg"] > 0
    word = Cell("a change buys slope", "good") if buys else Cell("no change buys slope", "doubtful")
    following = "point at a cell below; its command simulates it"
    box = answer_box("Design study", word, words, tiles, following, NOTHING)
    return _page(box, explored, markup_table(gains_table(study)), figures, simulate, path)


# Makers of the page that `sysid report` writes for an HDF5 file, by the file's schema.
PAGES: dict[str, Callable[[Path], str]] = {MAPS.schema: map_page, STUDY.schema: study_page}


def _page(box: Html, explored: Html, table: Html, figures: Html, simulate: _Simulate, path: Path) -> str:
    rows = [(name, str(value)) for name, value in simulate.sources.items()]
    parts = [
        box,
        Html(f'<div class="unprinted">{heading("Cells").text}{explored.text}</div>'),
        heading("In numbers"), table,
        heading("Figures"), figures,
        heading("Provenance"), definitions(rows, "where it comes from"),
    ]  # fmt: skip
    return page(f"sysid: {path.name}", joined(parts))


@dataclass(frozen=True)
class _Simulate:
    """`sysid simulate` with the sets, motors and rules of a result, but for the landing itself.

    `gears` are the files of the gear's sets by surface; `notes` say what is not where it was.
    """

    gears: Mapping[str, Path]
    common: tuple[str, ...]
    folder: Path
    notes: tuple[str, ...]
    sources: Mapping[str, object]

    @classmethod
    def of(cls, provenance: Mapping[str, Any], path: Path) -> _Simulate:
        """Return the commands of a result in a file, from its provenance."""
        folder = path.resolve().parent

        def place(origin: Mapping[str, Any]) -> Path:
            return shown_from_here(folder / origin["from_result_folder"])

        gears = {surface: place(origin) for surface, origin in provenance["gear"].items()}
        motor = place(provenance["motor"])
        common = ["--motor", str(motor)]
        common += ["--pair", "each"] if provenance["pairing"] == "each" else []
        common += ["--ideal-reversal"] if provenance["ideal_reversal"] else []
        common += ["--draws", str(provenance[DRAWS])] if provenance.get(DRAWS) else []
        notes = tuple(
            f"{place} is not there any more: put the place of these sets into the command."
            for place in (*gears.values(), motor)
            if not place.exists()
        )
        sources = {f"{surface.upper()} sets": place for surface, place in gears.items()} | {"motors": motor}
        return cls(gears, tuple(common), folder, notes, sources | {"sysid": provenance["sysid"]})

    def __call__(
        self, surface: str, slope: str | int, speed: str | int, rules: Rules, *more: str | int
    ) -> Command:
        """Return the command of a landing; a number is what each cell replaces, and `more` is as written."""
        head = shell("sysid", "simulate", self.gears[surface], *self.common)
        parts = [f"{head} --slope ", slope, "deg --speed ", speed, *more]
        usual = Rules()
        for name, hint in field_hints(Rules).items():
            flag = mark_of(hint)
            value = getattr(rules, name)
            if isinstance(flag, Flag) and value != getattr(usual, name):
                parts.append(f" {shell(*flag.spelled(name), flag.bare(value))}")
        return tuple(parts)

    def controller(self, stated: Mapping[str, Any], file: str | None) -> str:
        """Return the options of a controller as `asdict` states it."""
        words = ["--controller", stated["name"]]
        words += ["--trigger", "imu"] if stated["sensing"] else []
        words += ["--controller-file", str(shown_from_here(self.folder / file))] if file else []
        return f" {shell(*words)}"


def _map_charts(content: MapFile, rules: Rules, simulate: _Simulate) -> list[CellChart]:
    """Return the maps of a file; best impulses have three of each surface, as computed and refined."""
    settings, charts = content.settings, []
    for number, chart in enumerate(content.maps):
        texts = []
        if content.impulses:
            impulses, kind = settings["impulses"], number % 3
            best = content.impulses[number // 3].optimum
            names = [f"{'refined_' if kind == 1 else ''}{name}" for name in ("delay", "duration")]
            texts = [
                np.array([[f"{v:.12g}" for v in row] for row in best[name][0].tolist()]) for name in names
            ]
            after = 0.0 if kind == 2 else impulses["after"]
            levels = "".join(f",{name}={impulses[name]:.12g}" for name in ("front", "rear", "idle"))
            delay, duration = " --controller impulse:delay=", ",duration="
            more: Command = (delay, _FIRST, duration, _FIRST + 1, f",after={after:.12g}{levels}")
        else:
            stated = settings["controllers"][number % len(settings["controllers"])]
            words = simulate.controller(stated, settings.get("controller_file"))
            if settings["pitch"]:
                words += f" --pitch {np.degrees(settings['pitch']):.12g}deg"
            if settings["horizontal_speed"]:
                words += f" --horizontal-speed {settings['horizontal_speed']:.12g}"
            more = (words,)
        charts.append(CellChart(
            chart.title,
            CellAxis(*_SPEED, tuple(chart.speeds.tolist())),
            CellAxis(*_SLOPE, tuple(chart.slopes_deg.tolist())),
            *_landings(chart), simulate(chart.surface, _UP, _ACROSS, rules, *more),
            texts=tuple(texts),
            doubt=np.asarray(chart.uncertain.any(axis=0)) if chart.checked else None,
            **_of_draws(chart),
        ))  # fmt: skip
    return charts


def _landings(chart: LandingMap) -> tuple[tuple[str, ...], NDArray[np.int8], FloatArray, FloatArray]:
    """Return names, classes, distances and times (R, n, m) of a cell: of every set, or one row for draws."""
    if not chart.numbers:
        names = tuple(f"set {number}" for number, _ in enumerate(chart.sets, start=1))
        return names, chart.outcome, chart.distance, chart.time
    means = chart.mean_distance[None], chart.mean_time[None]
    return (f"likeliest of {len(chart.sets)} draws; means",), chart.likeliest[None], *means


def _of_draws(chart: LandingMap) -> dict[str, Any]:
    """Return the share of draws that land in each cell, and what decides a doubtful one."""
    if not chart.numbers:
        return {}
    names, rho = chart.deciding()
    symbols = {name: row.symbol for table in (GEAR, MOTOR) for name, row in table.items()}
    words = [
        f"{symbols[name]} (rank correlation {r:+.2f})" if name else ""
        for name, r in zip(names.flat, rho.flat, strict=True)
    ]
    return {"share": chart.landed, "decides": np.array(words).reshape(names.shape)}


def _study_charts(study: DesignStudy, simulate: _Simulate, provenance: Mapping[str, Any]) -> list[CellChart]:
    """Return the designs over the values of one change, for every touchdown speed and other value."""
    settings, (surface,) = study.settings, simulate.gears
    slopes = CellAxis(*_SLOPE, settings.slopes_deg)
    more = simulate.controller(provenance["controller"], provenance.get("controller_file"))
    first = study.changes[0]
    groups: list[tuple[str, int, IntArray, Command]] = []
    if settings.together:
        second = study.changes[1]
        for value in second.axis:
            chosen = np.flatnonzero(study.points[:, 1] == value)
            chosen = chosen[np.argsort(study.points[chosen, 0])]
            changed: Command = (f" --change {first.name}=", _ACROSS, f",{second.name}={value:.12g}")
            groups.append((f"{second.label} {value:.3g}", 0, chosen, changed))
    else:
        for c, change in enumerate(study.changes):
            groups.append((change.label, c, study.along(c), (f" --change {change.name}=", _ACROSS)))
    charts = []
    for m, speed in enumerate(settings.speeds):
        for words, c, chosen, changed in groups:
            change = study.changes[c]
            name, unit = (change.symbol, "s more") if change.kind == "reversal" else (change.label, "")
            axis = CellAxis(name, unit, tuple(study.points[chosen, c].tolist()), even=True)
            command = simulate(surface, _UP, f"{speed:.12g}", settings.rules, *changed, more)
            charts.append(CellChart(
                f"{words}, {speed:g} m/s", axis, slopes, ("likeliest; means",),
                study.outcome[chosen, :, m].T[None], study.distance[chosen, :, m].T[None],
                study.time[chosen, :, m].T[None], command, share=study.landed[chosen, :, m].T,
            ))  # fmt: skip
    return charts
