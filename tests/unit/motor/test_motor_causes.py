"""A motor candidate that costs too much is cut at a number of steps, fails and is counted under its cause."""

from __future__ import annotations

import numpy as np

from sysid.fit.trial import count_causes, first_cause
from sysid.motor import kernel
from sysid.motor.batch import SimulatedTrial, SimulatedTrials, simulate_population
from sysid.motor.model import pack
from sysid.motor.problem import MotorProblem, _causes

GRID = np.arange(0.0, 1.0, 1e-3)


def test_candidate_that_costs_too_much_is_cut_and_counted() -> None:
    # A supply that changes a million times takes a step for each: nothing ends it but the bound.
    knots = np.linspace(0.0, 1.0, 1_000_001)
    supply = (knots, 1.0 + 0.01 * np.sin(1e3 * knots))
    ordinary, slow = (
        SimulatedTrial(np.array([0.0]), np.array([0.5]), GRID, "steady", volts) for volts in (None, supply)
    )
    rows = pack({})[None]
    run = simulate_population(rows, SimulatedTrials([ordinary, slow]), threads=1)
    assert run.status.tolist() == [[kernel.DONE, kernel.TOO_MANY_STEPS]]
    assert 0.2 < run.reached[0, 1] < 0.6
    # On 60 trials no candidate may take 60 times as long: every trial has its share of the steps.
    many = simulate_population(rows, SimulatedTrials([ordinary] + [slow] * 59), threads=1)
    assert many.status[0].tolist() == [kernel.DONE] + [kernel.TOO_MANY_STEPS] * 59
    share = kernel.CANDIDATE_STEPS / 60 / kernel.MAX_STEPS
    np.testing.assert_allclose(many.reached[0, 1:], share * run.reached[0, 1], rtol=0.01)

    cause = _causes(run.status > 0, run.status)
    failed = first_cause(cause, len(MotorProblem.causes))
    assert count_causes(failed, MotorProblem.causes) == {"too_expensive": 1}


def test_every_status_of_the_kernel_has_its_cause() -> None:
    statuses = np.array([[kernel.NO_STEADY_STATE, kernel.NOT_FINITE, kernel.STUCK, kernel.DONE]])
    cause = _causes(np.array([[True, True, True, True]]), statuses)[0]
    names = [MotorProblem.causes[code - 1] for code in cause]
    assert names == ["no_steady_state", "not_finite", "step_collapsed", "not_finite"]
    assert not _causes(np.zeros((1, 4), dtype=bool), statuses).any()
