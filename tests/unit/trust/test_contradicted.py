"""Stated values against trials, on linear models where the answer is known in closed form."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares

from sysid.parameters import FROM_STATED, Parameter, ParameterTable, SearchSpace, loosened
from sysid.stated import Stated
from sysid.trust.linearized import Information, Linearized
from sysid.trust.problem import Jacobian
from sysid.trust.stated import contradictions, stated_values

ERRORS = np.array([0.01, 0.02, 0.05])
TRUE = np.array([1.0, 2.0, 3.0])
FALLS = "4.00 × the noise falls to 1.01 ×"


def space_of(stated):
    rows = [
        Parameter(f"v{i}", f"v_{i}", "kg", 1.0, 0.0, 9.0, "linear", "A number.", "test") for i in range(4)
    ]
    space = SearchSpace.build(ParameterTable(rows), ["v3"], {})
    return space.with_stated(
        {f"v{i}": Stated(value, error) for i, (value, error) in enumerate(zip(stated, ERRORS, strict=True))}
    )


def fitted(stated, design, data):
    """The space, and the least squares of ``data = design v + noise of 1`` and what is stated of v0 to v2."""
    space = space_of(stated)

    def residuals(values):
        return np.concatenate([design @ values - data, loosened((values[1:] - stated) / ERRORS)[0]])

    start = np.linalg.lstsq(design, data, rcond=None)[0]
    values = least_squares(residuals, start, xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    slopes = loosened((values[1:] - stated) / ERRORS)[1][:, None]
    prior = np.eye(4)[1:] / ERRORS[:, None] * slopes
    covariance = np.linalg.inv(design.T @ design + prior.T @ prior)
    reach = np.array([row.upper - row.lower for row in space.free])
    columns = np.concatenate([design, prior]) * reach
    # One standard error moves the residual of a statement by its slope.
    noise = columns.T @ np.concatenate([columns[:-3], slopes**2 * columns[-3:]])
    known = Information(noise, noise, covariance / np.outer(reach, reach), np.ones(4))
    nothing = np.zeros(0)
    derived = Jacobian(columns, nothing, nothing)
    linear = Linearized(space.encode(values), nothing, np.ones(len(columns)), derived, None, known, nothing)
    return space, linear, values


def drawn(seed, wrong=0.0):
    """What is stated, a design (40, 4) of v3, v0, v1, v2, and data; v0 is stated wrong by so many errors."""
    random = np.random.default_rng(seed)
    design = random.standard_normal((40, 4)) * np.array([1.0, 60.0, 40.0, 2.0])
    data = design @ np.array([5.0, *TRUE]) + random.standard_normal(40)
    errors = random.standard_normal(3)
    errors[0] = wrong or errors[0]
    return TRUE + errors * ERRORS, design, data


def test_a_wrong_value_is_named_and_its_true_value_is_asked_for():
    inside = 0
    for seed in range(40):
        stated, design, data = drawn(seed, wrong=8.0)
        space, linear, _ = fitted(stated, design, data)
        rows = stated_values(space, linear)
        assert [row.name for row in rows if row.contradicted] == ["v0"]
        # Exactly the least squares in which nothing is stated of v0.
        none = np.diag([0.0, 0.0, *1 / ERRORS[1:] ** 2])
        normal = design.T @ design + none
        free = np.linalg.solve(normal, design.T @ data + none @ np.array([0.0, *stated]))
        assert rows[0].asked == pytest.approx(free[1], rel=1e-9)
        assert rows[0].sigma == pytest.approx(np.sqrt(np.linalg.inv(normal)[1, 1]), rel=1e-6)
        inside += abs(rows[0].asked - 1.0) < 1.96 * rows[0].sigma
        (finding,) = contradictions(rows, space, FALLS)
        assert finding.code == "stated-value-contradicted"
        assert "the campaign states 1.080 ± 0.010 kg (" in finding.sentence
        assert finding.sentence.endswith(f" standard errors): with it {FALLS}; measure it again")
    assert inside >= 35


def test_a_place_is_said_to_count_from_where_it_is_stated():
    space, linear, _ = fitted(*drawn(1, wrong=8.0))
    rows = stated_values(space, linear)
    free = tuple(
        dataclasses.replace(row, group=FROM_STATED, meaning="Point above its stated place.")
        if row.name == "v0"
        else row
        for row in space.free
    )
    (finding,) = contradictions(rows, dataclasses.replace(space, free=free), FALLS, ["another motor"])
    assert " kg (point above its stated place), which is good to 0.010 kg (" in finding.sentence
    assert "the campaign states" not in finding.sentence
    assert finding.sentence.endswith("measure it again (another motor would do the same)")


def test_right_values_are_left_alone():
    accused = 0
    for seed in range(300):
        space, linear, values = fitted(*drawn(seed))
        rows = stated_values(space, linear)
        assert [row.fitted for row in rows] == pytest.approx(values[1:])
        accused += any(row.contradicted for row in rows)
        assert all(row.sigma <= row.error for row in rows)
    # The chance of an accusation is 2 %.
    assert accused <= 14


def test_values_that_trials_cannot_tell_apart_are_named_together():
    random = np.random.default_rng(0)
    design = random.standard_normal((40, 4)) * np.array([1.0, 60.0, 0.0, 0.0])
    # The trials see the sum of v0 and v1 in units of their errors.
    design[:, 2] = design[:, 1] / 2
    data = design @ np.array([5.0, *TRUE]) + random.standard_normal(40)
    space, linear, _ = fitted(TRUE + np.array([10.0, 0.0, 0.0]) * ERRORS, design, data)
    rows = {row.name: row for row in stated_values(space, linear)}
    (wrong,) = (row for row in rows.values() if row.contradicted)
    assert {wrong.name, *wrong.partners} == {"v0", "v1"}
    assert rows["v0"].asked == pytest.approx(1.0, abs=0.04)
    assert rows["v1"].asked == pytest.approx(1.8, abs=0.08)
    assert "would do the same" in contradictions([*rows.values()], space, FALLS)[0].sentence


def test_a_statement_lets_go_beyond_three_errors_and_pulls_like_a_square_before():
    pulls = np.linspace(-20, 20, 4001)
    residuals, slopes = loosened(pulls)
    near = np.abs(pulls) <= 3
    np.testing.assert_array_equal(residuals[near], pulls[near])
    # Odd, growing, without a kink; its derivative is the stated one.
    np.testing.assert_allclose(residuals, -residuals[::-1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.gradient(residuals, pulls)[1:-1], slopes[1:-1], rtol=0, atol=3e-3)
    # Half the derivative of the square is what bends the other parameters: 3 at most, 0.6 at 15 errors.
    force = residuals * slopes
    assert force.max() == pytest.approx(3, abs=0.01)
    assert force[np.searchsorted(pulls, 15.0)] == pytest.approx(0.6, abs=0.01)
