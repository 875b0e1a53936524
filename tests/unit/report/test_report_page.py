"""Pieces of a report: what is drawn is what was computed, nothing of a log's names becomes markup."""

import base64
import json
import re
from dataclasses import replace
from urllib.parse import unquote
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure

import model_notes
from fakes.fits import GEAR, MOTOR, made_fit
from fakes.places import PUBLISHED
from sysid.export import load_parameter_sets
from sysid.filters import Spectrum, amplitude_spectrum
from sysid.fit.result import TrialResult
from sysid.fit.store import read_fit, write_fit
from sysid.gear.model import PARAMETERS, EventKind, pack, simulate
from sysid.parameter_sets import ParameterRecord
from sysid.report import diagrams, gear_report
from sysid.report.answer import Reopened
from sysid.report.drawing import as_math, thinned, unit_of
from sysid.report.drop_replay import START, DropReplay, animation, drone_of, foot_points, placed, replay_drop
from sysid.report.fit_figures import figure_spread, figure_waterfall
from sysid.report.fit_report import FitReport
from sysid.report.gear_report import GearReport
from sysid.report.html import bullets, heading, markup_table, page, paragraph, picture, unfoldable
from sysid.report.motor_report import MotorReport
from sysid.report.plots import Curve, Panel, View, interactive
from sysid.report.snapshots import figure_snapshots
from sysid.report.table import Cell, table, words
from sysid.report.trust_tables import interval_table, narrow_table
from sysid.trust.documents import FreeParameter, TrustDocument
from sysid.workflows.provenance import seen_from
from sysid.workflows.reopen import shown_from_here
from sysid.workflows.report import open_report

NASTY = "</script><img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def sets():
    names = ("motor", "gear-lf")
    return {name: load_parameter_sets(PUBLISHED / f"published-{name}.json") for name in names}


def small_figure():
    figure = Figure(figsize=(2, 1))
    figure.add_subplot().plot([0, 1, 2], [0.123456789, 1, 0])
    return figure


def test_names_of_a_log_are_text_and_never_markup():
    for piece in (
        paragraph(NASTY),
        bullets([NASTY]),
        unfoldable(NASTY, paragraph("a")),
        markup_table(table(NASTY, [NASTY], [words("trial", str)], NASTY)),
        picture(small_figure(), NASTY, NASTY),
    ):
        assert "<img src=x" not in piece.text
        assert "&lt;img src=x" in piece.text
    text = page(NASTY, heading(NASTY) + paragraph("a"))
    assert "<img" not in text
    assert text.count("&lt;img src=x") == 3  # title, link, heading


def test_a_figure_has_a_text_alternative_or_is_refused():
    with pytest.raises(ValueError, match="text alternative"):
        picture(small_figure(), "  ")
    assert 'alt="speed over time"' in picture(small_figure(), "speed over time").text


def test_a_vector_figure_keeps_its_shape_and_a_large_one_becomes_pixels():
    def drawn(figure):
        kind, data = re.search(r"data:image/([a-z+]+)[;,]([^\"]+)", picture(figure, "a").text).groups()
        return kind, unquote(data)

    kind, svg = drawn(small_figure())
    assert kind == "svg+xml"
    root = ElementTree.fromstring(svg)
    paths = [one.get("d") for one in root.iter("{http://www.w3.org/2000/svg}path")]
    (curve,) = [d for d in paths if d.startswith("M") and d.count("L") == 2 and "Z" not in d.upper()]
    x, y = np.array(re.findall(r"[-\d.]+", curve), dtype=float).reshape(-1, 2).T
    # Evenly spaced in x; heights 0.123456789, 1, 0 of the whole, to a hundredth of a point.
    np.testing.assert_allclose(np.diff(x), x[1] - x[0], atol=0.02)
    assert (y[2] - y[0]) / (y[2] - y[1]) == pytest.approx(0.123456789, abs=0.02 / (y[2] - y[1]))
    assert not any(re.search(r"\d\.\d{3}", d) for d in paths)
    figure = Figure(figsize=(4, 3))
    axes = figure.add_subplot()
    for _ in range(40):
        axes.scatter(*np.random.default_rng(1).random((2, 200)))
    assert drawn(figure)[0] == "png"


def test_thinning_keeps_every_peak():
    time = np.linspace(0, 1, 20_000)
    values = np.sin(20 * time)
    values[7777], values[12_345] = 9.0, -9.0
    few, kept = thinned(time, values, 600)
    assert len(few) <= 600
    assert (kept.max(), kept.min()) == (9.0, -9.0)
    assert np.all(np.diff(few) > 0)


def test_symbols_are_set_as_formulas():
    assert as_math("k_h") == r"$k_{h}$"
    assert as_math("μ_s − μ_k") == r"$μ_{s}$ − $μ_{k}$"
    assert as_math("R") == "R"


def plot_data(text):
    """Return what a plot's script reads."""
    return json.loads(re.search(r'<script type="application/json">(.*?)</script>', text, re.DOTALL).group(1))


def unpacked(text):
    return np.frombuffer(base64.b64decode(text), "<f4")


@pytest.mark.parametrize("channels", [GEAR, MOTOR])
def test_traces_are_the_samples_of_the_fit_with_their_units(channels, tmp_path):
    fit = made_fit(channels)
    text = FitReport(tmp_path, fit).measured_against_simulated().text
    view = plot_data(text)["views"][0]
    signals = view["panels"][::2]
    assert len(signals) == len(fit.channels)
    assert all(panel["unit"] for panel in view["panels"])
    trial, factor = fit.trials[0], unit_of(fit, 0)[1]
    np.testing.assert_allclose(unpacked(view["x"]), trial.time - trial.time[0], rtol=1e-6)
    curves = {curve["label"]: unpacked(curve["y"]) for curve in signals[0]["curves"]}
    np.testing.assert_allclose(curves["best set"], factor * trial.simulated[0, :, 0], rtol=1e-6)
    measured = np.where(trial.valid[:, 0], factor * trial.measured[:, 0], np.nan)
    np.testing.assert_allclose(curves["measured"], measured, rtol=1e-6)
    # Paper has every trial and every channel.
    figures = re.findall(r'alt="([^"]*)"', text)
    assert len(figures) == len(fit.trials)
    assert all(panel["label"] in figures[0] for panel in view["panels"])


def test_residuals_are_over_the_noise_and_a_band_lies_around(tmp_path):
    fit = made_fit()
    trial, count = fit.trials[0], len(fit.channels)
    low, high = trial.simulated[0] - 0.5, trial.simulated[0] + 0.5
    known = Reopened(band={trial.name: (low, high)}, noise={trial.name: np.full(count, 0.02)})
    view = plot_data(FitReport(tmp_path, fit, known=known).measured_against_simulated().text)["views"][0]
    band = view["panels"][0]["curves"][0]
    assert band["label"] == "95 % prediction"
    np.testing.assert_allclose(unpacked(band["upto"]) - unpacked(band["y"]), 1.0, rtol=1e-5)
    (residual,) = view["panels"][1]["curves"]
    expected = (trial.simulated[0, :, 0] - trial.measured[:, 0]) / 0.02
    np.testing.assert_allclose(
        unpacked(residual["y"]), np.where(trial.valid[:, 0], expected, np.nan), rtol=1e-5
    )
    assert view["panels"][1]["shade"] == [-2, 2]


def test_a_plot_of_many_samples_keeps_its_peaks_and_joins_curves_of_other_places():
    x = np.linspace(0, 10, 40_000)
    y = np.sin(x)
    y[12_345], y[23_456] = 9.0, -9.0
    points = Curve("points", np.array([1.0, 2.0]), "blue", "dots", x=np.array([0.5, 20.0]))
    view = View("a", NASTY, x, [Panel("y", "m", [Curve("line", y), points])], {NASTY: [(1, 2)]})
    text = interactive([view], NASTY).text
    assert "<img src=x" not in text
    data = plot_data(text)["views"][0]
    place, line, dots = (unpacked(t) for t in (data["x"], *(c["y"] for c in data["panels"][0]["curves"])))
    assert len(place) < 5000
    assert (np.nanmax(line), np.nanmin(line)) == (9.0, -9.0)
    assert np.all(np.diff(place) > 0)
    np.testing.assert_allclose(place[np.isfinite(dots)], [0.5, 20.0])
    with pytest.raises(ValueError, match="at least one view"):
        interactive([], "a")


def test_the_spread_shows_every_set_between_its_bounds():
    fit = made_fit()
    (axes,) = figure_spread(fit).axes
    place = np.concatenate([line.get_xdata() for line in axes.lines if line.get_linestyle() == "None"])
    # The table has one free parameter, searched on a logarithmic scale: the unit cube itself.
    np.testing.assert_allclose(np.sort(place), np.sort(fit.cube[:, 0]), atol=1e-12)


def test_the_spectrum_of_white_noise_is_flat_at_its_density():
    rate = 1000.0
    spectrum = amplitude_spectrum(0.3 * np.random.default_rng(2).standard_normal((200_000, 1)), rate)
    # 100 averaged stretches: 5 % of the amplitude per point, less in the wide bands.
    inner = (spectrum.frequency > 3) & (spectrum.frequency < 490)
    np.testing.assert_allclose(spectrum.density[inner, 0], 0.3 * np.sqrt(2 / rate), rtol=0.2)
    assert len(spectrum.frequency) <= 80


def test_the_spectrum_peaks_at_the_frequency_of_a_tone_and_skips_lost_channels():
    rate, tone = 200.0, 23.0
    time = np.arange(1000) / rate
    values = np.column_stack([np.sin(2 * np.pi * tone * time), np.full(1000, np.nan)])
    spectrum = amplitude_spectrum(values, rate)
    # Bands are 6 % wide.
    assert spectrum.frequency[np.argmax(spectrum.density[:, 0])] == pytest.approx(tone, rel=0.06)
    assert np.isnan(spectrum.density[:, 1]).all()


def test_a_fit_keeps_what_its_report_shows(tmp_path):
    fit = made_fit(channels=MOTOR)
    n = len(fit.trials[0].time)
    more = {
        "spectrum": Spectrum(np.arange(1.0, 6.0), np.ones((5, 2))),
        "thrust": np.linspace(0, 3, n),
        "commands": np.array([[0.0, 0.5], [1.0, -1.0]]),
    }
    fit = replace(fit, trials=(replace(fit.trials[0], **more), *fit.trials[1:]))
    first, second, *_ = read_fit(write_fit(fit, tmp_path / "fit")).trials
    for part in ("density", "frequency"):
        np.testing.assert_array_equal(getattr(first.spectrum, part), getattr(more["spectrum"], part))
    for part in ("thrust", "commands"):
        np.testing.assert_array_equal(getattr(first, part), more[part])
    assert second.spectrum is second.thrust is second.commands is None


SLOPE = np.radians(15.0)
BODY = [0.0, 0.21, 0.0, 0.0, -0.7, 0.0]


@pytest.fixture(scope="module")
def drop_fit():
    """A fit of one drop whose measurement is a simulation with the published low-friction values."""
    row = pack({})
    time = np.arange(0.0, 0.75, 0.005)
    run = simulate(row, SLOPE, BODY, time)
    measured = run.state[:, [0, 1, 7, 8, 2]]
    base = made_fit(runs=1, uses=("fit",))
    records = tuple(ParameterRecord.of(parameter, "fixed") for parameter in PARAMETERS.values())
    valid = np.ones(measured.shape, bool)
    trial = TrialResult("drop-1", "fit", 100.0 + time, measured, valid, measured[None], np.zeros((1, 5)))
    log = {START: BODY, "slope_deg": 15.0}
    inside = np.zeros((1, len(row)), np.int8)
    return replace(
        base, parameters=records, values=row[None], at_bound=inside, trials=(trial,),
        settings={"surface": "lf"}, provenance={"logs": {"drop-1": log}},
    )  # fmt: skip


@pytest.fixture(scope="module")
def drop(drop_fit):
    return replay_drop(drop_fit, drop_fit.trials[0])


def test_a_replay_repeats_the_drop_with_its_feet_and_forces(drop_fit, drop):
    every = slice(None, None, 5)
    # The same simulation on another clock: only the interpolation between its steps differs.
    np.testing.assert_allclose(drop.body[every], drop_fit.trials[0].measured[:, [0, 1, 4]], atol=1e-9)
    np.testing.assert_allclose(drop.measured[every], drop.body[every], atol=1e-9)
    normal = np.array([np.sin(SLOPE), np.cos(SLOPE)])
    depth = -(drop.feet @ normal)
    pressed = drop.normal_force > 0
    # k_s p, the ground's damper (0.04 N·s/m at some 0.5 m/s) adds 0.02 N.
    np.testing.assert_allclose(drop.normal_force[pressed], 1.10e5 * depth[pressed], atol=0.05)
    assert np.all(depth[~pressed] <= 1e-12)
    assert np.all(np.abs(drop.friction_force) <= 0.44 * drop.normal_force + 1e-9)
    joints = placed(drone_of(drop.values).joints, drop.body[0])
    np.testing.assert_allclose(joints, [[-0.088, 0.186], [0.088, 0.186]], atol=1e-12)
    np.testing.assert_allclose(drop.feet[0], [[-0.105, 0.059], [0.105, 0.059]], atol=1e-12)


def test_contacts_of_a_replay_are_the_events_of_the_simulation(drop):
    run = simulate(pack({}), SLOPE, BODY, drop.time)
    for foot, name in enumerate(("rear", "front")):
        touches = [e.time for e in run.events if e.kind is EventKind.TOUCHDOWN and e.foot == name]
        starts = [contact.start for contact in drop.contacts if contact.foot == foot]
        # Sampled every millisecond; touches within 5 ms of a lift-off belong to one contact.
        assert starts[0] == pytest.approx(touches[0], abs=1.1e-3)
        assert all(min(abs(t - touch) for touch in touches) < 1.1e-3 for t in starts)
    (first, what), *_ = drop.first_contacts()
    assert what == "the rear leg touches"
    assert first == drop.contacts[0].start
    assert len(drop.first_contacts()) == 4


def test_a_replay_s_modes_are_those_of_the_located_switches(drop_fit):
    fit = replace(drop_fit, settings={"surface": "hf"}, values=pack({}, "hf")[None])
    drop = replay_drop(fit, fit.trials[0])
    run = simulate(pack({}, "hf"), SLOPE, BODY, drop.time, surface="hf")
    sticks = np.zeros((len(drop.time), 2), dtype=bool)
    for event in run.events:
        if event.kind in (EventKind.STICK, EventKind.SLIP):
            foot = ("rear", "front").index(event.foot)
            sticks[drop.time >= event.time, foot] = event.kind is EventKind.STICK
    down = run.normal_force > 0
    assert np.sum(sticks & down) > 100
    # The page's simulation is coarser: a switch may fall one sample aside.
    assert np.sum(drop.sticks != (sticks & down)) <= 3


def test_legs_at_rest_end_in_the_feet():
    state = np.zeros((1, 7))
    values = {"joint_dx": 0.08, "joint_dz": 0.02, "foot_dx": 0.1, "foot_dz": 0.15, "thrust_point_dx": 0.16}
    state[0, [4, 6]] = np.arctan2(0.02, 0.13)
    feet = foot_points(state, values)
    np.testing.assert_allclose(feet[0], [[-0.1, -0.15], [0.1, -0.15]], atol=1e-15)
    state[0, 5] = 0.01  # the front leg alone, longer
    longer = foot_points(state, values)[0] - feet[0]
    assert np.allclose(longer[0], 0)
    assert np.hypot(*longer[1]) == pytest.approx(0.01)


def test_drops_of_one_name_keep_to_their_own_campaign(drop_fit, tmp_path, monkeypatch):
    # The same name of campaign and drop, but let go 5 cm higher: the feet touch later.
    log = drop_fit.provenance["logs"]["drop-1"] | {START: [BODY[0], BODY[1] + 0.05, *BODY[2:]]}
    other = replace(drop_fit, provenance={"logs": {"drop-1": log}})
    report = GearReport(tmp_path, drop_fit, other)
    first, second = report.drops()
    assert second.contacts[0].start > first.contacts[0].start + 0.01

    for fit, drop in ((drop_fit, first), (other, second)):
        assert report.view(fit, fit.trials[0]).bars["rear foot down"][0][0] == drop.contacts[0].start
    monkeypatch.setattr(gear_report, "figure_snapshots", lambda drop, legend: drop)
    figures = [report.trial_figures(fit, fit.trials[0]) for fit in report.fits]
    assert figures[0]["snapshots-drop-1"] is first
    assert figures[1]["snapshots-against-bench-drop-1"] is second


def motor_fit():
    """A motor fit of four trials with thrust, each with three reversals far enough from its ends."""
    fit = made_fit(channels=MOTOR, samples=600, uses=("fit", "fit", "fit", "validate"))
    start = fit.trials[0].time[0]
    commands = np.array([[0.0, 0.6], [0.5, -1.0], [1.2, 0.6], [2.0, -1.0]])
    commands[:, 0] += start
    trials = tuple(replace(t, thrust=np.linspace(0, 3, 600), commands=commands) for t in fit.trials)
    return replace(fit, trials=trials)


def test_the_figures_of_a_motor_for_a_paper(tmp_path, monkeypatch):
    monkeypatch.setattr(MotorReport, "simulated_thrust", staticmethod(lambda fit, trial: np.ones((5, 600))))
    report = MotorReport(tmp_path, motor_fit())
    figures = report.figures()
    names = {f"reversal-drop-{t}-{k}" for t in (1, 2, 3, 4) for k in (1, 2, 3)}
    assert {name for name in figures if name.startswith("reversal")} == names
    labels = ["other sets", "measured", "best set", "command"]
    (legend,) = figures["reversal-drop-1-1"].legends
    assert [text.get_text() for text in legend.get_texts()] == labels
    top, *_, bottom = figures["reversal-drop-1-1"].axes
    # 0 is the command.
    assert top.get_xlim() == pytest.approx((-0.1, 0.5), abs=0.006)
    assert bottom.get_xlabel() == "time after the command [s]"
    titles = [axes.get_title(loc="left") for axes in figures["trial-drop-1"].axes]
    assert titles[-2:] == ["thrust, not compared [N]", "command [%]"]
    text = report.reversals().text
    assert text.count("<img") == 6
    assert "6 of 12 reversals are drawn" in text
    # Those held back are among them.
    assert "drop-4 (not fitted): from +60 % to −100 %" in text


def test_every_trial_has_a_figure_whatever_a_system_makes_of_its_name(tmp_path):
    names = ("a b", "a-b", "A/B", "a-b-2", "ä")
    fit = made_fit(uses=("fit",) * 5)
    trials = tuple(replace(trial, name=name) for trial, name in zip(fit.trials, names, strict=True))
    other = replace(fit, trials=trials, name="A-b")
    figures = FitReport(tmp_path, other, replace(other, trials=trials[:2])).figures()
    drawn = [name for name in figures if name.startswith("trial-")]
    assert drawn == [
        "trial-a-b", "trial-a-b-2", "trial-A-B-3", "trial-a-b-2-2", "trial--", "trial-against-A-b-a-b",
        "trial-against-A-b-a-b-2",
    ]  # fmt: skip
    assert len({name.casefold() for name in figures}) == len(figures)


def test_the_options_of_the_animation_tell_the_drops_apart(drop_fit, tmp_path):
    trial = replace(drop_fit.trials[0], use="validate")
    other = replace(drop_fit, name="other", trials=(trial,))
    report = GearReport(tmp_path, drop_fit, other)
    options = re.findall(r"<option [^>]*>([^<]*drop-1[^<]*)</option>", report.animation().text)
    assert options == ["bench, drop-1: 15°, fitted", "other, drop-1: 15°, not fitted"]
    text = report.measured_against_simulated().text
    assert re.findall(r"<option [^>]*>(.*?) \(", text) == ["drop-1", "other, drop-1"]


def test_snapshots_are_titled_with_the_instants_that_the_caption_names(drop_fit, drop, tmp_path):
    panels = figure_snapshots(drop, legend=True).axes
    titles = [axes.get_title(loc="left") for axes in panels if axes.get_visible()]
    assert titles == [f"({k}) {1e3 * t:.0f} ms" for k, (t, _) in enumerate(drop.first_contacts(), 1)]
    caption = GearReport(tmp_path, drop_fit).snapshots().text
    for title in titles:
        assert title.replace(") ", ") at ") in caption


def test_a_fit_without_starts_has_no_animation_and_says_so(tmp_path):
    report = open_report(write_fit(made_fit(), tmp_path / "fit"))
    assert "fit again" in report.animation().text
    assert "<canvas" not in report.animation().text


def test_the_animation_holds_the_numbers_and_no_way_out_of_its_script(drop_fit):
    trial = replace(drop_fit.trials[0], name=NASTY)
    log = {NASTY: drop_fit.provenance["logs"]["drop-1"]}
    drop = replay_drop(replace(drop_fit, trials=(trial,), provenance={"logs": log}), trial)
    text = animation({"a": {"fit": drop}}).text
    assert text.count("</script") == 1
    data = json.loads(re.search(r'<script type="application/json">(.*?)</script>', text, re.DOTALL).group(1))
    (document,) = data["drops"]
    assert document["name"] == NASTY
    frames = np.array(document["fits"][0]["frames"])
    # Tenths of a millimetre and of a milliradian, rounded.
    np.testing.assert_allclose(frames[:, :3] / 1e4, drop.body[::2], atol=0.6e-4)
    np.testing.assert_allclose(frames[:, 3:7].reshape(-1, 2, 2) / 1e4, drop.feet[::2], atol=0.6e-4)
    np.testing.assert_allclose(frames[:, 7:9], drop.normal_force[::2], atol=0.51)
    np.testing.assert_allclose(
        document["fits"][0]["drone"]["feet"], [[-1050, -1510], [1050, -1510]], atol=0.6
    )
    assert [what for _, what in document["snapshots"]] == [what for _, what in drop.first_contacts()]


def test_the_diagram_of_modes_asks_the_code():
    switches = [f"{before} {after}" for before, _, after in diagrams.foot_transitions()]
    assert switches == ["slips sticks", "slips slips", "sticks slips", "sticks sticks"]


def test_the_shares_of_modes_follow_friction():
    # The rear foot bears 10 N: it moves at 8 N = mu_k F_n, and holds at 3 N as at 8.5 N, below mu_s F_n.
    rear = np.array([1.0, 0.0])
    normal, friction, speed = (
        np.array(values)[:, None] * rear
        for values in ([10.0] * 4, [-8.0, 8.0, 3.0, 8.5], [0.3, -0.02, 1e-5, -3e-5])
    )
    body, feet, time = np.zeros((4, 3)), np.zeros((4, 2, 2)), np.arange(4) / 1e3
    values = {"kinetic_friction": 0.8}
    drop = DropReplay("a", "fit", 0.0, time, body, feet, normal, friction, body, (), values, speed)
    shares = diagrams.mode_shares([drop])
    assert shares == {"both slip": 0.5, "rear sticks": 0.5, "front sticks": 0.0, "both stick": 0.0}
    assert diagrams.mode_shares([]) == {}


def test_the_labelled_diagram_tells_the_lengths(sets):
    (axes,) = diagrams.figure_geometry(sets["gear-lf"].set_values(1), np.radians(15)).axes
    words = " ".join(text.get_text() for text in axes.texts)
    for length in ("dx_j$ = 88", "dz_j$ = 24", "dx_f$ = 105", "dz_f$ = 151", "dx_m$ = 159"):
        assert f"{length} mm" in words
    assert "= 8°" in words
    subscripts = [f"_{frame}" for frame in "NABCD"]
    for symbol in ["T_r", "T_f", "m_B", "m_{leg}", "F_n", "F_t", "k_h", "k_t", "k_s", *subscripts]:
        assert symbol in words


def test_the_numbers_beside_the_misprints_are_those_of_the_design_notes(sets):
    text = re.sub("<[^>]*>", " ", model_notes.misprints(sets["motor"], sets["gear-lf"]).text)
    # 960 rpm/V; I^r R/k² with both constants; 0.44 g/1.01; creep of 16 mm/s at 15°; L/R of Table I.
    numbers = "0.00995 V·s/rad, 0.8 ms as printed, 82 ms, -4.27 m/s, 16 mm/s, 12.7 ms, 10.2 V"
    assert [number for number in numbers.split(", ") if number not in text] == []
    checked = re.sub("<[^>]*>", " ", model_notes.checks(sets["motor"], sets["gear-lf"]).text)
    assert "23.7°" in checked
    assert "34.8°" in checked
    # The reference of the reversal gives 0.21 s.
    assert model_notes.reversal_delay(sets["motor"]) == pytest.approx(0.21, abs=0.01)


def cut_fit(cut=1):
    """A fit of which some runs met the generation limit."""
    fit = made_fit(runs=3)
    runs = list(fit.runs)
    for i in range(cut):
        stage = replace(runs[i].stages[0], stop_reason="generations")
        runs[i] = replace(runs[i], stages=(stage,))
    return replace(fit, runs=tuple(runs))


@pytest.mark.parametrize("cut", [1, 3])
def test_an_unfinished_search_is_not_told_as_a_finding(tmp_path, cut):
    whole, fit = cut_fit(0), cut_fit(cut)
    sentences = " ".join(FitReport(tmp_path, whole).sentences())
    assert "The data identify" in sentences
    assert "of 3 independent runs" in sentences
    sentences = " ".join(FitReport(tmp_path, fit).sentences())
    assert "The search was not finished: nothing is known about what the data identify." in sentences
    for claim in ("The data identify", "do not identify", "independent runs", "optimum"):
        assert claim not in sentences
    (axes,) = figure_waterfall(fit).axes
    names = axes.get_legend_handles_labels()[1]
    assert names.count("not finished") == 1
    (marked,) = [line for line in axes.lines if line.get_label() == "not finished"]
    assert len(marked.get_xdata()) == cut
    assert sum("optimum" in name for name in names) <= 3 - cut
    assert sum(len(line.get_xdata()) for line in axes.lines) == 3
    text = FitReport(tmp_path, fit).convergence().text
    assert "share the best optimum" not in text
    assert "no optimum is known" in text


def test_what_the_data_do_not_determine_has_no_digits(tmp_path, monkeypatch):
    fit = made_fit()
    plain = FitReport(tmp_path, fit).parameters().text
    assert "not identifiable" not in plain
    monkeypatch.setattr(FitReport, "open_parameters", ("leg_axial_stiffness",))
    text = FitReport(tmp_path, fit).parameters().text
    assert '<td class="number">not identifiable</td>' in text
    cells = re.search(r"k_h \[N/m\] †</th>(.*?)</tr>", text).group(1)
    values = re.findall(r">([^<]+)<", cells)
    assert len(values) == 5
    assert all(float(value.rstrip("*")) % 1000 == 0 for value in values)
    monkeypatch.undo()
    # An unfinished search knows of nothing that it is open.
    assert "not identifiable" not in FitReport(tmp_path, cut_fit()).parameters().text


def test_every_warning_that_is_listed_is_counted(tmp_path):
    fit = replace(made_fit(), warnings=("one", "both"))
    other = replace(fit, name="other", warnings=("both", "of the other campaign"))
    text = FitReport(tmp_path, fit, other).verdict().text
    assert "3 warnings" in text
    assert "of the other campaign" in text


def test_a_parameter_that_scores_equally_far_apart_is_open(tmp_path):
    fit = made_fit(runs=1)
    stage = fit.runs[0].stages[0]
    cost, cube = stage.cost.copy(), stage.cube.copy()
    cost[-1, :2], cube[-1, 0], cube[-1, 1] = 0.01, 0.05, 0.95

    def seen(places):
        cube[-1, :2, 0] = places
        run = replace(fit.runs[0], stages=(replace(stage, cost=cost, cube=cube),))
        return FitReport(tmp_path, replace(fit, runs=(run,))).open_parameters

    # Bounds 2000 to 12000: 0.05 to 0.95 of that is a factor of 5, 0.4 to 0.5 one of 1.2.
    assert seen([0.05, 0.95]) == ("leg_axial_stiffness",)
    assert seen([0.4, 0.5]) == ()


def test_open_intervals_are_shown_as_open():
    row = FreeParameter.model_construct(
        name="ground_damping", symbol="b_s", unit="N·s/m", value=2.0, mean=2.0, sigma=1.0,
        interval_68=[0.001, 5.0], open_68=[True, False], interval_95=[0.001, 10.0], open_95=[True, True],
        verdict="not_identifiable", at_bound=0, measured=None, half_width=float("inf"), bootstrap_95=None,
        refined=2.0, fisher_sigma=1.0, doubt=None, partners=[],
    )  # fmt: skip
    document = TrustDocument.model_construct(parameters=[row])
    wide, narrow = interval_table(document), narrow_table(document)
    assert [cell.text for cell in wide.rows[0][2:4]] == ["open", "open"]
    assert [cell.text for cell in narrow.rows[0][1:4]] == ["—", "≤ 5", "—"]
    assert wide.rows[0][4] == Cell("not identifiable", "bad")


def test_a_slow_sensor_beside_a_fast_one_is_drawn_as_dots(tmp_path):
    fit = made_fit(samples=600)
    trial = fit.trials[0]
    valid = trial.valid.copy()
    valid[:, -1] = np.arange(600) % 20 == 0
    fit = replace(fit, trials=(replace(trial, valid=valid),))
    panels = plot_data(FitReport(tmp_path, fit).measured_against_simulated().text)["views"][0]["panels"]
    looks = [
        [curve["look"] for curve in panel["curves"] if curve["label"] != "other sets"] for panel in panels
    ]
    assert looks[:2] == [["thick", "line"], ["thin"]]
    assert looks[-2:] == [["dots", "line"], ["dots"]]


def test_a_report_says_why_points_are_not_shown(tmp_path, monkeypatch):
    monkeypatch.setattr(MotorReport, "_best", lambda report, name: 1e-5)
    spikes = {kind: {"steps": 2, "inertia": 1e-5, "standard_error": 1e-6} for kind in ("up", "down")}
    fit = replace(made_fit(channels=MOTOR), settings={"rotor_inertia_from_torque_spikes": spikes})
    known = Reopened(why_not="c.toml: is gone")
    assert "are not shown: c.toml: is gone." in MotorReport(tmp_path, fit, known=known).spikes().text
    silent = {kind: row | {"steps": 0} for kind, row in spikes.items()}
    fit = replace(fit, settings={"rotor_inertia_from_torque_spikes": silent})
    text = MotorReport(tmp_path, fit, known=known).spikes().text
    assert "No step shows a whole spike: record two steps up and two down" in text
    assert "c.toml" not in text


def test_the_way_to_a_campaign_that_is_a_link_leads_to_the_link(tmp_path):
    """Its logs lie beside the link; the folder of the fit may be a link too."""
    for name in ("logs", "store", "fits/a"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "store/c.toml").write_text("", encoding="utf-8")
    (tmp_path / "logs/c.toml").symlink_to("../store/c.toml")
    (tmp_path / "here").symlink_to("fits/a")
    place = seen_from(tmp_path / "here", tmp_path / "logs/c.toml")
    assert place == "../../logs/c.toml"
    assert shown_from_here(tmp_path / "here" / place) == tmp_path.resolve() / "logs/c.toml"
