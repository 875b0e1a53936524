"""Maps in blocks: resume, damage, stops, files, experiments, figures."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import QuadMesh

from fakes.printed import printed
from sysid.errors import ExportError, LogError
from sysid.landing.impulse import OPTIMUM, UNITS, ImpulseMap
from sysid.landing.maps import LandingMap, cell_edges, nearest_cell
from sysid.landing.outcomes import Outcome
from sysid.landing.real_landings import Experiment, confusion, of_map, read_experiments
from sysid.landing.settings import SLOPES_DEG, SPEEDS, ImpulseSettings
from sysid.landing.store import MapFile, read_maps, write_maps
from sysid.report.drawing import save_figure
from sysid.report.landing_figures import DrawnLimits, figure_impulse, figure_landing_maps, legend_entries
from sysid.report.landing_tables import maps_table
from sysid.resume import BlockStore, Computing


class Squares:
    """Work that counts its calls and may stop after some."""

    def __init__(self):
        self.calls = 0

    def __call__(self, rows):
        self.calls += 1
        return rows[:, 0] ** 2, np.arange(len(rows), dtype=np.int64)


BLOCKS = {f"block-{k}": np.arange(6.0).reshape(3, 2) + k for k in range(5)}


def some_map(controller="off", sets=4):
    rng = np.random.default_rng(3)
    slopes, speeds = np.arange(0.0, 46.0, 5.0), np.arange(0.0, 2.05, 0.25)
    steep = slopes[:, None] + 10 * speeds[None] + 4 * rng.random((sets, 1, 1))
    outcome = np.digitize(steep, [18.0, 22.0, 32.0]).astype(np.int8)
    rested = outcome <= 1
    return LandingMap(
        "lf", controller, tuple(f"set {k + 1}" for k in range(sets)), slopes, speeds, outcome,
        np.where(rested, steep / 40, np.nan), np.where(rested, 0.2 + steep / 30, np.nan), outcome == 7,
    )  # fmt: skip


ALL = slice(None)


def cut(one, rows=ALL, columns=ALL, speeds=None):
    """Some rows and columns of a map, perhaps over other speeds."""
    names = ("outcome", "distance", "time", "uncertain")
    parts = {name: getattr(one, name)[:, rows][:, :, columns] for name in names}
    speeds = one.speeds[columns] if speeds is None else np.asarray(speeds)
    return replace(one, slopes_deg=one.slopes_deg[rows], speeds=speeds, **parts)


def some_impulse():
    one = some_map()
    rng = np.random.default_rng(4)
    return ImpulseMap(
        "lf", "impulse", one.sets, one.slopes_deg, one.speeds,
        {name: 0.1 * rng.random(one.outcome.shape) for name in OPTIMUM},
    )  # fmt: skip


def test_the_papers_grid():
    assert (len(SLOPES_DEG), SLOPES_DEG[-1], len(SPEEDS), SPEEDS[-1]) == (46, 45.0, 41, 2.0)
    tried = ImpulseSettings()
    assert (len(tried.delays), tried.delays[-1]) == (27, 0.26)
    assert (len(tried.durations), tried.durations[-1]) == (17, 0.16)
    assert 5 * 46 * 41 * tried.combinations == 4_328_370  # the 4.3 million combinations of a map


def test_blocks_that_are_damaged_are_computed_again(tmp_path):
    result = tmp_path / "map.h5"
    store = BlockStore(result, {})
    Computing(store=store).blocks(Squares(), BLOCKS)
    store.close()
    folder = BlockStore.folder_of(result)
    cut = folder / "block-0.npz"
    cut.write_bytes(cut.read_bytes()[:100])
    flipped = folder / "block-1.npz"
    data = bytearray(flipped.read_bytes())
    data[data.index(b"NUMPY") + 130] ^= 1  # in the numbers
    flipped.write_bytes(data)
    work = Squares()
    store = BlockStore(result, {}, resume=True)
    found = Computing(store=store).blocks(work, BLOCKS)
    store.close()
    assert work.calls == 2
    assert len(store.notes) == 2
    assert "damaged" in store.notes[0]
    np.testing.assert_array_equal(found["block-1"][0], BLOCKS["block-1"][:, 0] ** 2)


def test_blocks_are_never_mixed_up(tmp_path):
    result = tmp_path / "map.h5"
    store = BlockStore(result, {"controller": "off"})
    with pytest.raises(ExportError, match="another process"):
        BlockStore(result, {"controller": "off"})
    Computing(store=store).blocks(Squares(), BLOCKS)
    store.close()
    store = BlockStore(result, {"controller": "reverse"}, force=True)
    assert not list(BlockStore.folder_of(result).glob("*.npz"))
    store.close()
    assert not BlockStore.folder_of(result).exists()


def test_files_give_back_what_was_written(tmp_path):
    content = MapFile(
        (some_map(), some_map("reverse")), (some_impulse(),), {"rules": {"short": 0.45}}, {"a": [1]}
    )
    path = write_maps(tmp_path / "map.h5", content)
    back = read_maps(path)
    assert back.settings == content.settings
    assert back.provenance == content.provenance
    for written, read in zip(content.maps, back.maps, strict=True):
        assert (written.title, written.sets) == (read.title, read.sets)
        for name in ("slopes_deg", "speeds", "outcome", "distance", "time", "uncertain"):
            np.testing.assert_array_equal(getattr(written, name), getattr(read, name))
    assert set(UNITS) == set(OPTIMUM)
    for name in OPTIMUM:
        np.testing.assert_array_equal(content.impulses[0].optimum[name], back.impulses[0].optimum[name])
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(ExportError, match=r"map\.h5: damaged or cut off"):
        read_maps(path)
    with pytest.raises(ExportError, match="no such file"):
        read_maps(tmp_path / "missing.h5")


def test_shares_means_and_borders():
    one = some_map()
    total = sum(one.share(outcome) for outcome in Outcome if outcome != Outcome.LOST)
    np.testing.assert_allclose(total, 1.0)
    np.testing.assert_array_equal(one.landed, np.mean(one.outcome <= 1, axis=0))
    assert np.isnan(one.mean_time[-1, -1])
    assert one.mean_distance[0, 0] == pytest.approx(one.distance[:, 0, 0].mean())
    # 18 + 4 deg at rest, less 10 deg per m/s, less 0 to 4 deg of each set.
    assert one.steepest(0.0) == 20.0
    assert one.steepest(1.0) == 10.0
    assert np.isnan(one.steepest(2.0)) or one.steepest(2.0) == 0.0
    lost = some_map()
    lost.outcome[0] = Outcome.LOST
    np.testing.assert_array_equal(lost.landed, np.mean(one.outcome[1:] <= 1, axis=0))
    # Cells in which every set is lost are of no class, least of all the best one.
    lost.outcome[:, 0, 0] = Outcome.LOST
    assert lost.likeliest[0, 0] == Outcome.LOST
    assert lost.likeliest[0, 1] == Outcome.SHORT
    found = confusion([Experiment("lf", "off", 0.0, 0.0, "landed")], lost)
    assert (found.counts.sum(), found.agreeing, found.outside, found.lost) == (0, 0, 0, 1)
    lost.outcome[:] = some_map().outcome
    lost.outcome[0] = Outcome.LOST
    entry = lost.summary()
    assert entry["lost"] == lost.outcome[0].size
    assert entry["sets"] == 4


def test_the_summary_tells_no_speed_that_the_map_lacks():
    slow = cut(some_map(), speeds=np.linspace(0.0, 0.4, 9))
    assert np.isnan(slow.steepest(0.6))
    assert np.isnan(slow.steepest(0.43))
    assert slow.steepest(0.42) == slow.steepest(0.4)  # half a cell beyond the last one
    assert slow.summary()["speeds"] == [0.3]
    # Nothing was computed at 0.6, 1 and 1.5 m/s, though the two wide cells reach there.
    two = cut(some_map(), columns=slice(2), speeds=[0.3, 1.2])
    assert two.summary()["speeds"] == [0.3, 1.2]
    five = cut(some_map(), columns=slice(5), speeds=[0.1, 0.3, 0.7, 1.2, 1.7])
    assert five.summary()["speeds"] == [0.3]
    single = cut(some_map(), columns=slice(1), speeds=[0.45])
    assert single.summary()["speeds"] == [0.45]
    # Uneven cells end half-way; the outer ones reach as far outward as inward, not half the widest step.
    uneven = np.array([0.1, 0.2, 0.8, 1.6])
    np.testing.assert_allclose(cell_edges(uneven), [0.05, 0.15, 0.5, 1.2, 2.0], rtol=1e-12)
    assert [nearest_cell(uneven, v) for v in (0.04, 0.05, 0.49, 0.51, 1.3, 2.01)] == [None, 0, 1, 2, 3, None]


def test_a_slope_at_the_edge_of_the_map_is_a_lower_bound():
    easy = replace(some_map(), speeds=np.array([0.0, 0.3, 0.6, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0]))
    easy.outcome[:, :, :4] = Outcome.SHORT  # up to 0.75 m/s every slope is landed on
    easy.outcome[:, :, 6] = Outcome.FLIPPED  # at 1.5 m/s none
    entry = easy.summary()
    assert (entry["speeds"], entry["at_edge"]) == ([0.3, 0.6, 1.0, 1.5], [True, True, False, False])
    (row,) = (line for line in printed(maps_table([entry])).splitlines() if line.startswith(" LF"))
    assert row.count("≥ 45") == 2
    assert "–" in row


def test_doubts_that_were_not_looked_for_are_not_told(tmp_path):
    entry = replace(some_map(), checked=False).summary()
    assert entry["uncertain"] is None
    (row,) = (line for line in printed(maps_table([entry])).splitlines() if line.startswith(" LF"))
    assert row.rstrip().endswith("–")
    write_maps(tmp_path / "m.h5", MapFile((replace(some_map(), checked=False), some_map()), (), {}, {}))
    assert [one.checked for one in read_maps(tmp_path / "m.h5").maps] == [False, True]
    with h5py.File(tmp_path / "m.h5") as file:
        assert ["uncertain" in file[f"maps/{k}"] for k in (1, 2)] == [False, True]


CSV = """surface,controller,slope [deg],speed [m/s],outcome
lf,off,5,0.3,landed
lf,off,40,0.5,failed
lf,off,40,0.5,landed
lf,reverse,5,0.3,short
lf,off,60,0.3,failed
"""


def test_experiments_against_a_map(write):
    rows = read_experiments(write(CSV, "real.csv"))
    assert rows[0] == Experiment("lf", "off", 5.0, 0.3, "landed")
    one = some_map()
    chosen = of_map(rows, one)
    assert len(chosen) == 4
    found = confusion(chosen, one)
    assert found.words == ("landed", "failed")
    assert found.counts.tolist() == [[1, 0, 0, 1], [0, 0, 0, 1]]
    assert (found.agreeing, found.outside) == (2, 1)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("outcome", "result", "no column 'outcome'"),
        ("landed", "fell", "row 2: outcome 'fell'"),
        ("40,0.5,failed", "steep,0.5,failed", "row 3: slope 'steep'"),
        ("5,0.3,landed", "5,-0.3,landed", "row 2: .*speed '-0.3'"),
    ],
)
def test_experiments_that_make_no_sense(write, old, new, says):
    with pytest.raises(LogError, match=says):
        read_experiments(write(CSV.replace(old, new, 1), "real.csv"))


def test_figures_show_every_map(tmp_path):
    maps = [some_map(), some_map("reverse")]
    limits = {
        ("lf", "off"): DrawnLimits(-9e-13, 23.7, 22.0),
        ("lf", "reverse"): DrawnLimits(13.76, 49.9, 70.0),
    }
    figure = figure_landing_maps(
        maps, limits=limits, experiments=[Experiment("lf", "off", 5.0, 0.3, "landed")]
    )
    shown = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_title().split("\n")[0] for axes in shown] == ["LF, off", "LF, reverse"]
    lines = [line.get_ydata()[0] for line in shown[0].lines]
    assert lines == [23.7, 22.0]
    # The colour of a cell is that of its classes: green where every set lands close by, white for B.
    (mesh,) = (one for one in shown[0].collections if isinstance(one, QuadMesh))
    image = mesh.get_array()
    np.testing.assert_allclose(image[0, 0], np.array([0, 158, 115]) / 255)
    np.testing.assert_allclose(image[-1, -1], 1.0)
    drawn = {one.get_label(): one for one in shown[0].collections}
    assert {"mean distance to rest", "mean time to rest", "real landing: landed"} <= set(drawn)
    # The marker stands at its speed and slope, the other map has none.
    np.testing.assert_array_equal(drawn["real landing: landed"].get_offsets(), [[0.3, 5.0]])
    assert "real landing: landed" not in {one.get_label() for one in shown[1].collections}
    # The mean time is 0.2 s + (slope + 10 deg per m/s + what the sets add) / 30, so 0.5 s is a straight line.
    added = 40 * maps[0].distance[:, 0, 0].mean()
    places = drawn["mean time to rest"].get_paths()[0].vertices
    assert len(places) > 3
    np.testing.assert_allclose(places[:, 1] + 10 * places[:, 0], 9.0 - added, rtol=1e-6)
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "static limit of the first set, rigid legs (off: 0 N; reverse: 13.8 N)" in words
    assert "not simulated" in words  # between the map's 47.5 deg and the limit of 49.9 deg
    assert shown[0].get_ylim() == (-2.5, 50.9)
    # Beside the map, where it hides no cell.
    assert shown[1].get_title().split("\n")[1] == "static limit above: 70° (bending legs)"
    assert figure.legends[0].get_title().get_text() == (
        "4 sets per map; blended colours are shares of the sets"
    )
    assert save_figure(figure, tmp_path / "map.png").stat().st_size > 10_000
    best = figure_impulse([some_impulse()])
    assert len([axes for axes in best.axes if axes.get_title()]) == 4
    # A single set has no spread to draw.
    one = some_impulse()
    single = ImpulseMap(
        "lf", "impulse", one.sets[:1], one.slopes_deg, one.speeds, {n: v[:1] for n, v in one.optimum.items()}
    )
    assert len([axes for axes in figure_impulse([single]).axes if axes.get_title()]) == 2


def test_the_legend_lists_what_is_drawn_and_nothing_else():
    one = some_map()
    (legend,) = figure_landing_maps([one]).legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "at rest within 45 cm", "at rest within 1 m", "A: flipped within 1 m",
        "B: still moving, or beyond 1 m", "mean distance to rest", "mean time to rest",
    ]  # fmt: skip
    one.uncertain[2, 3, 4] = True
    # A limit that is stated beside the map is no line of the legend.
    limits = {("lf", "off"): DrawnLimits(0.0, 30.0, 90.0)}
    words = [
        t.get_text() for t in figure_landing_maps([some_map("off")], limits=limits).legends[0].get_texts()
    ]
    assert [word for word in words if "limit" in word] == [
        "static limit of the first set, rigid legs (off: 0 N)"
    ]
    # A page's one legend takes the entries, and the figure bears none.
    legend = {}
    assert figure_landing_maps([some_map("off")], limits=limits, legend=legend).legends == []
    assert sorted(entry[2] for entry in legend_entries(legend)) == sorted(words)
    assert ("#d55e00", "dashed", words[-1]) in legend_entries(legend)
    far = replace(one, outcome=np.minimum(one.outcome, 1))
    figure = figure_landing_maps([far])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "at rest within 45 cm", "at rest within 1 m", "class of a set changes with half the tolerance",
        "mean distance to rest", "mean time to rest",
    ]  # fmt: skip
    (dots,) = (c for c in figure.axes[0].collections if "tolerance" in c.get_label())
    np.testing.assert_array_equal(dots.get_offsets(), [[one.speeds[4], one.slopes_deg[3]]])


def test_every_set_lost_is_drawn_as_such():
    one = some_map()
    one.outcome[:, 9, 8] = Outcome.LOST
    figure = figure_landing_maps([one])
    (mesh,) = (c for c in figure.axes[0].collections if isinstance(c, QuadMesh))
    assert not np.allclose(mesh.get_array()[9, 8], 1.0)  # not the white of B
    assert "the simulation failed" in [text.get_text() for text in figure.legends[0].get_texts()]


def test_uneven_cells_are_drawn_between_their_edges():
    speeds = np.array([0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.2, 1.6, 2.0])
    edges = [0.05, 0.15, 0.25, 0.4, 0.6, 0.85, 1.1, 1.4, 1.8, 2.2]
    best = replace(some_impulse(), speeds=speeds)
    for figure in (figure_landing_maps([cut(some_map(), speeds=speeds)]), figure_impulse([best])):
        for axes in (axes for axes in figure.axes if axes.get_title()):
            (mesh,) = (c for c in axes.collections if isinstance(c, QuadMesh))
            corners = mesh.get_coordinates()
            np.testing.assert_allclose(corners[0, :, 0], edges, rtol=1e-12)
            np.testing.assert_allclose(corners[:, 0, 1], np.arange(-2.5, 48.0, 5.0), rtol=1e-12)
            assert axes.get_xlim() == pytest.approx((0.05, 2.2))


@pytest.mark.parametrize(("rows", "columns"), [([3], ALL), (ALL, [2]), ([2], [2]), ([0, 1, 4, 9], [0, 1, 8])])
def test_odd_grids_are_drawn(rows, columns):
    one = cut(some_map(), rows, columns)
    limits = {("lf", "off"): DrawnLimits(0.0, 23.7, 22.0)}
    real = [Experiment("lf", "off", 12.0, 0.5, "landed")]
    figure = figure_landing_maps([one], limits=limits, experiments=real)
    figure.canvas.draw()
    axes = figure.axes[0]
    (mesh,) = (c for c in axes.collections if isinstance(c, QuadMesh))
    assert mesh.get_array().shape[:2] == one.landed.shape
    # A single cell has no width: its middle is the only tick.
    if len(one.slopes_deg) == 1:
        np.testing.assert_array_equal(axes.get_yticks(), one.slopes_deg)
    if len(one.speeds) == 1:
        np.testing.assert_array_equal(axes.get_xticks(), one.speeds)
    best = replace(some_impulse(), slopes_deg=one.slopes_deg, speeds=one.speeds)
    best.optimum.update({name: v[:, rows][:, :, columns] for name, v in best.optimum.items()})
    panels = [axes for axes in figure_impulse([best]).axes if axes.get_title()]
    for panel, name in zip(panels, ("delay", "delay", "duration", "duration"), strict=True):
        (mesh,) = (c for c in panel.collections if isinstance(c, QuadMesh))
        values = 1e3 * (best.mean(name) if "mean" in panel.get_title() else best.sigma(name))
        np.testing.assert_allclose(mesh.get_array(), values, rtol=1e-12)


def test_limits_are_lines_within_the_axes_and_words_outside():
    limits = {("lf", "off"): DrawnLimits(0.0, 23.7, 22.0)}
    drawn = {}
    for rows in ([0, 1], [4, 5], [8, 9]):
        axes = figure_landing_maps([cut(some_map(), rows, ALL)], limits=limits).axes[0]
        words = axes.get_title().split("\n")[1:]
        drawn[rows[0]] = ([line.get_ydata()[0] for line in axes.lines], words)
    assert drawn == {
        0: ([], ["static limit above: 24° (rigid legs), 22° (bending legs)"]),
        4: ([23.7, 22.0], []),
        8: ([], ["static limit below: 24° (rigid legs), 22° (bending legs)"]),
    }


def test_letters_and_labels_keep_off_lines_and_real_landings():
    one = some_map()
    limits = {("lf", "off"): DrawnLimits(0.0, 35.0, 33.0)}  # through the middle of B
    (letter,) = (t for t in figure_landing_maps([one]).axes[0].texts if t.get_text() == "B")
    x, middle = letter.get_position()
    assert 30.0 <= middle <= 40.0
    real = [Experiment("lf", "off", 2.5, 0.3, "landed")]
    figure = figure_landing_maps([one], limits=limits, experiments=real)
    axes = figure.axes[0]
    (letter,) = (t for t in axes.texts if t.get_text() == "B")
    assert min(abs(letter.get_position()[1] - line) for line in (35.0, 33.0)) > 2.0
    (low, high), (left, right) = axes.get_ylim(), axes.get_xlim()
    labels = [text for text in axes.texts if text.get_text().endswith((" m", " s"))]
    assert labels
    for text in labels:
        x, y = text.get_position()
        assert np.hypot((x - 0.3) / (right - left), (y - 2.5) / (high - low)) > 0.1


def test_labels_keep_apart_and_inside():
    """Letters and contour labels inside their axes, legends inside the figure; long names are drawn once."""
    names = ("impulse, then reverse", "refined impulse, then reverse", "impulse alone")
    limits = {("lf", name): DrawnLimits(0.0 if "alone" in name else 13.76, 30.0, 25.0) for name in names}
    figure = figure_landing_maps([some_map(name) for name in names], limits=limits)
    FigureCanvasAgg(figure).draw()
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "static limit of the first set, rigid legs (13.8 N or 0 N)" in words
    boxes = {}
    for k, axes in enumerate(figure.axes):
        frame = axes.get_window_extent().padded(1.0)
        for text in axes.texts:
            boxes[k, text.get_text()] = box = text.get_window_extent()
            assert all(frame.contains(*corner) for corner in box.corners()), text
    assert {text for _, text in boxes} >= {"A", "B", "0.2 m", "0.5 s"}
    every = [*boxes.values(), *(legend.get_window_extent() for legend in figure.legends)]
    assert not [1 for k, box in enumerate(every) if any(box.overlaps(other) for other in every[:k])]
    for legend in figure.legends:
        assert (
            figure.bbox.x0 <= legend.get_window_extent().x0 <= legend.get_window_extent().x1 <= figure.bbox.x1
        )


def test_loops_around_single_cells_are_no_contours():
    slopes, speeds = np.arange(46.0), 0.05 * np.arange(41)
    distance = np.broadcast_to(slopes[:, None] / 60, (1, 46, 41)).copy()
    distance[0, 10, [5, 20, 30]] = 0.9  # as single bounces make it, among 0.17 m
    shape = distance.shape
    one = LandingMap(
        "lf", "off", ("set 1",), slopes, speeds, np.zeros(shape, np.int8), distance, np.full(shape, 0.3),
        np.zeros(shape, bool),
    )  # fmt: skip
    axes = figure_landing_maps([one]).axes[0]
    (contour,) = (c for c in axes.collections if c.get_label() == "mean distance to rest")
    # 0.1, 0.2 and 0.45 m, a straight line each at 60 deg/m times that; the loops are gone.
    pieces = [path.to_polygons(closed_only=False) for path in contour.get_paths()]
    assert [len(one) for one in pieces] == [1, 1, 1]
    for (line,), level in zip(pieces, (0.1, 0.2, 0.45), strict=True):
        np.testing.assert_allclose(line[[0, -1], 1], 60 * level, rtol=1e-9)
