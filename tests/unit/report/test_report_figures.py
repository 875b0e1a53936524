"""Figures draw what the fit holds, labelled with units."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from fakes.fits import GEAR, MOTOR, made_fit
from sysid.report.drawing import BEST, MEASURED, OTHERS, RUNS, save_figure
from sysid.report.fit_figures import figure_convergence, figure_measured_against_simulated, trial_view
from sysid.report.motor_figures import curve_views
from sysid.report.plots import figure_of


def lines_in(axes, colour):
    return [line for line in axes.lines if line.get_color() == colour]


def overlapping_texts(figure):
    """Pairs of labels and titles that overlap once the figure is laid out."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    texts = [figure._suptitle] if figure._suptitle else []
    for axes in figure.axes:
        texts += [axes.xaxis.label, axes.yaxis.label, axes.title, axes._left_title, axes._right_title]
        # A locator also offers ticks beyond the axis, which are not drawn.
        for k, labels in enumerate((axes.get_xticklabels(), axes.get_yticklabels())):
            low, high = sorted((axes.get_xlim, axes.get_ylim)[k]())
            texts += [label for label in labels if low <= label.get_position()[k] <= high]
    boxes = [
        (t.get_text(), t.get_window_extent(renderer)) for t in texts if t and t.get_visible() and t.get_text()
    ]
    boxes = [(text, box) for text, box in boxes if box.width > 0]
    overlapping = []
    for i, (text, box) in enumerate(boxes):
        for other, second in boxes[i + 1 :]:
            # Touching corners of neighbouring tick labels are no overlap: one pixel inside.
            shrunk = second.padded(-1.0)
            if box.x0 < shrunk.x1 and shrunk.x0 < box.x1 and box.y0 < shrunk.y1 and shrunk.y0 < box.y1:
                overlapping.append((text, other))
    return overlapping


def test_a_figure_draws_the_valid_samples_and_every_set():
    fit = made_fit()
    trial = fit.trials[1]
    figure = figure_of([trial_view(fit, trial, ("drop-2", "drop-2"))])
    assert len(figure.axes) == 10
    for c in range(5):
        signal, residual = figure.axes[2 * c], figure.axes[2 * c + 1]
        (dots,) = lines_in(signal, MEASURED)
        factor = 180 / np.pi if c == 4 else 1.0
        drawn = dots.get_ydata()
        np.testing.assert_array_equal(np.isnan(drawn), ~trial.valid[:, c])
        np.testing.assert_allclose(drawn[trial.valid[:, c]], factor * trial.measured[trial.valid[:, c], c])
        (best,) = lines_in(signal, BEST)
        np.testing.assert_allclose(best.get_ydata(), factor * trial.simulated[0, :, c])
        assert len(lines_in(signal, OTHERS)) == 4
        # The time of the window, not Unix seconds.
        assert dots.get_xdata()[0] == 0.0
        assert dots.get_xdata()[-1] == pytest.approx(149 / 200)
        (error,) = lines_in(residual, BEST)
        finer = 1000.0 if c < 4 else factor
        expected = finer * (trial.simulated[0, :, c] - trial.measured[:, c])
        np.testing.assert_allclose(error.get_ydata()[trial.valid[:, c]], expected[trial.valid[:, c]])
        assert np.all(np.isnan(error.get_ydata()[~trial.valid[:, c]]))
        # One occlusion, shaded once.
        assert len(signal.patches) == 1


def test_a_figure_names_units_trials_and_nrmse():
    fit = made_fit()
    figure = figure_measured_against_simulated(fit)
    assert len(figure.axes) == 2 * 5 * 3
    column = figure.axes[-10:]
    labels = [axes.get_title(loc="left").replace("{", "").replace("}", "") for axes in column]
    signals = ["$x_B$ [m]", "$z_B$ [m]", "$ẋ_B$ [m/s]", "$ż_B$ [m/s]", "$q_B$ [deg]"]
    assert labels[::2] == signals
    assert labels[1] == "residual of $x_B$ [mm]"
    mean = 100 * fit.trials[2].nrmse[0].mean()
    assert column[0].texts[0].get_text() == f"drop-3 (not fitted): NRMSE {mean:.1f} %"
    assert column[0].get_title(loc="right") == f"NRMSE {100 * fit.trials[2].nrmse[0, 0]:.1f} %"
    assert column[-1].get_xlabel() == "time [s]"
    assert fit.name in figure.get_suptitle()


@pytest.mark.parametrize("channels", [GEAR, MOTOR], ids=["gear", "motor"])
def test_labels_of_figures_do_not_overlap(channels):
    fit = made_fit(channels)
    assert overlapping_texts(figure_measured_against_simulated(fit)) == []
    view = trial_view(fit, fit.trials[0], ("a", "drop-1 (fitted)"), {"foot down": [(0.2, 0.21)]})
    for across in (False, True):
        assert overlapping_texts(figure_of([view], across=across)) == []
    assert overlapping_texts(figure_convergence(fit, wide=True)) == []


def test_a_figure_keeps_to_the_measurement_when_a_set_goes_astray():
    fit = made_fit()
    fit.trials[0].simulated[3] *= 1e4
    signal = figure_measured_against_simulated(fit).axes[0]
    measured = fit.trials[0].measured[fit.trials[0].valid[:, 0], 0]
    low, high = signal.get_ylim()
    assert high - low < 2 * np.ptp(measured)


def test_a_figure_of_a_dense_motor_log_marks_contacts_and_one_set():
    fit = made_fit(MOTOR, samples=3000, runs=1, uses=("fit",), lost=slice(0, 0))
    view = trial_view(fit, fit.trials[0], ("a", "b"), {"foot down": [(2.0, 2.01)]})
    figure = figure_of([view])
    (line,) = lines_in(figure.axes[0], MEASURED)
    assert line.get_marker() == "None"
    assert not figure.axes[0].patches
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts == ["measured", "best set", "residual", "foot down"]


def test_trials_without_samples_are_drawn():
    fit = made_fit(lost=slice(0, 150))
    assert figure_measured_against_simulated(fit).axes == []


def test_report_convergence_draws_the_best_of_every_generation():
    fit = made_fit()
    (axes,) = figure_convergence(fit).axes
    for number, run in enumerate(fit.runs):
        curve, end = lines_in(axes, RUNS[number])
        np.testing.assert_array_equal(curve.get_xdata(), np.arange(1, len(run.best) + 1))
        np.testing.assert_allclose(curve.get_ydata(), run.best)
        assert end.get_xdata() == [len(run.best)]
    # Okabe and Ito's colours differ from each other.
    assert len(set(RUNS)) == len(RUNS)


@pytest.mark.parametrize(("suffix", "magic"), [(".png", b"\x89PNG"), (".pdf", b"%PDF"), (".svg", b"<?xml")])
def test_report_figures_are_saved_the_same_every_time(tmp_path, suffix, magic):
    for name in ("a", "b"):
        save_figure(figure_convergence(made_fit()), tmp_path / f"{name}{suffix}")
    data = (tmp_path / f"a{suffix}").read_bytes()
    assert data.startswith(magic)
    assert data == (tmp_path / f"b{suffix}").read_bytes()


def test_a_no_load_line_that_the_fit_does_not_follow_is_not_drawn_as_its_curve():
    row = {"quantity": "no_load", "direction": "forward", "coefficients": (3000.0, 100.0)}
    points = {"no_load_forward": (np.array([0.2, 0.5]), np.array([650.0, 1700.0]))}
    for maps, label, colour in (
        ((), "curve, forward", "best"),
        ({"forward"}, "straight line, forward", "faint"),
    ):
        _, (view,) = curve_views([row], points, maps)
        drawn = view.panels[0].curves[-1]
        assert (drawn.label, drawn.colour) == (label, colour)
        np.testing.assert_allclose(drawn.values[-1], 3100.0)
