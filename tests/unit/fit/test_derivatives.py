"""Difference quotients along axes and of all trials at once, and what steps correct, of known derivatives."""

import numpy as np
import pytest

from sysid.fit.derivatives import Layout, displaced
from sysid.fit.least_squares import Fronts, descend, drive

# Two coordinates of all trials in a valley of condition 1e4, and one of each of two trials.
_RANDOM = np.random.default_rng(3)
_VALLEY = np.array([[1.0, 1.0, 0.0, 0.0], [1.0, 1.0001, 0.0, 0.0]])


def _linear(at):
    rows = np.repeat([0, 1], 20)
    matrix = _RANDOM.standard_normal((40, 2)) @ _VALLEY
    matrix[rows == 0, 2] = _RANDOM.standard_normal(20)
    matrix[rows == 1, 3] = _RANDOM.standard_normal(20)
    layout = Layout(np.array([-1, -1, 2, 2]), np.array([-1, -1, 0, 1]), rows, 0)
    return matrix, layout, lambda points: (points - at) @ matrix.T


@pytest.mark.parametrize("central", [False, True])
@pytest.mark.parametrize("at", [[0.5, 0.5, 0.5, 0.5], [0.0, 1.0, 1.0, 0.0], [0.999, 0.4, 0.2, 0.9999]])
def test_derivatives_of_a_linear_model_are_its_matrix(at, central):
    at = np.array(at)
    matrix, layout, residuals = _linear(at)
    for curvature in (np.zeros((4, 4)), matrix.T @ matrix):
        moves = displaced(
            at, curvature, layout, asked=np.ones(4, bool), still=np.zeros(4, bool), rise=1e-4, central=central
        )
        assert np.all((moves.points >= 0) & (moves.points <= 1))
        # One displacement serves the coordinates of both trials.
        assert len(moves.points) == 3 * (1 + central)
        values = residuals(moves.points)
        columns, usable = moves.columns(residuals(at), values, np.zeros(len(values), bool), np.zeros((4, 40)))
        assert usable.all()
        np.testing.assert_allclose(columns.T, matrix, atol=1e-9)


def test_along_the_valley_the_cost_rises_as_across_it():
    at = np.full(4, 0.5)
    matrix, layout, residuals = _linear(at)
    curvature = matrix.T @ matrix
    moves = displaced(
        at, curvature, layout, asked=np.ones(4, bool), still=np.zeros(4, bool), rise=1e-4, central=False
    )
    rises = np.sum(residuals(moves.points) ** 2, axis=1)
    across, along = rises[-1], rises[-2]
    # By coordinates the valley is seen as a difference of numbers 1e4 times larger. The longest displacement
    # limits the rise along it.
    assert across == pytest.approx(1e-4, rel=1e-6)
    assert np.max(np.abs(moves.points[-2] - at)) == pytest.approx(0.05, rel=0.5)
    assert along < across


def test_a_derivative_that_is_kept_counts_in_the_others():
    at = np.full(4, 0.5)
    matrix, layout, residuals = _linear(at)
    asked = np.array([True, True, False, False])
    known = np.zeros((4, 40))
    known[2:] = matrix.T[2:]
    moves = displaced(
        at, matrix.T @ matrix, layout, asked=asked, still=np.zeros(4, bool), rise=1e-4, central=False
    )
    # The kept coordinates follow along the axes.
    assert np.abs(moves.points[:, 2:] - 0.5).max() > 1e-4
    values = residuals(moves.points)
    columns, _ = moves.columns(residuals(at), values, np.zeros(len(values), bool), known)
    np.testing.assert_allclose(columns.T, matrix, atol=1e-9)


def test_a_point_that_cannot_be_simulated_costs_its_direction_alone():
    at = np.full(4, 0.5)
    matrix, layout, residuals = _linear(at)
    moves = displaced(
        at, np.zeros((4, 4)), layout, asked=np.ones(4, bool), still=np.zeros(4, bool), rise=1e-4, central=True
    )
    values, failed = residuals(moves.points), np.zeros(6, bool)
    failed[1] = True
    columns, _ = moves.columns(residuals(at), values, failed, np.zeros((4, 40)))
    # The other side is left.
    np.testing.assert_allclose(columns.T, matrix, atol=1e-9)
    failed[4] = True
    columns, _ = moves.columns(residuals(at), values, failed, np.zeros((4, 40)))
    assert not columns[0].any()
    np.testing.assert_allclose(columns[1:].T, matrix[:, 1:], atol=1e-9)


class _Squares:
    def cost(self, fronts, residuals):
        return np.sum(residuals**2, axis=-1)

    def scale(self, front, residuals):
        return np.ones(residuals.shape[-1])


def _walked(known, bend=0.0, stated=0):
    """Walk to (0.4, 0.5, 0.6, 0.3) from the middle; return cost, derivatives, true ones and populations."""
    matrix, layout, _ = _linear(0.0)
    layout = layout._replace(stated=stated)
    bottom = np.array([0.4, 0.5, 0.6, 0.3])
    fronts, sizes = Fronts.at(np.full((1, 4), 0.5)), []

    def residuals(points):
        sizes.append(len(points))
        away = points - bottom
        return (away + bend * away**2) @ matrix.T, np.zeros(len(points), bool)

    known = known(matrix)[None]
    drive(descend(fronts, _Squares(), layout, known=known, tolerance=1e-12, iterations=40), residuals)
    return fronts.cost[0], known[0], matrix.T, sizes


def test_known_derivatives_are_corrected_by_steps_alone():
    # Off by a tenth in one coordinate, and bent: no differences, which take six points of this model.
    cost, derivatives, true, sizes = _walked(lambda matrix: matrix.T * [[1.1], [1.0], [0.9], [1.0]], bend=0.2)
    assert cost < 1e-9
    assert {*sizes} == {1, 3}
    # What no residual of the other trial sees stays unseen.
    np.testing.assert_array_equal(derivatives[2:][true[2:] == 0.0], 0.0)


def test_derivatives_that_mislead_are_taken_again():
    cost, derivatives, true, sizes = _walked(lambda matrix: -matrix.T)
    assert cost < 1e-9
    assert 6 in sizes
    np.testing.assert_allclose(derivatives, true, atol=1e-3)


def test_only_derivatives_that_are_not_known_are_taken():
    cost, derivatives, true, sizes = _walked(
        lambda matrix: np.where([[False], [False], [True], [True]], matrix.T, np.nan)
    )
    assert cost < 1e-9
    # Two axes of the first two coordinates, central; nothing of the slopes of both trials.
    assert sizes[1] == 4
    np.testing.assert_allclose(derivatives, true, atol=1e-3)


def test_derivatives_by_stated_values_are_kept():
    # The last two coordinates follow the others along valleys; corrected, they would take their share.
    cost, derivatives, true, _ = _walked(lambda matrix: matrix.T * [[1.1], [1.0], [0.9], [0.9]], stated=2)
    assert cost < 1e-9
    np.testing.assert_array_equal(derivatives[2:], 0.9 * true[2:])
    assert np.abs(derivatives[:2] - true[:2] * [[1.1], [1.0]]).max() > 1e-3
