"""Order of the motor's integrator, with reversals and the dead band in the log."""

import numpy as np

from sysid.motor.model import simulate

# Few samples, none near an event: the continuous extension is of order 3, the steps of order 4.
TIMES = np.array([0.0, 0.31, 0.52, 0.83, 1.17, 1.4])


def test_error_falls_with_the_tolerance_through_reversals() -> None:
    schedule = ([0.0, 0.4, 0.9, 1.25], [0.6, -1.0, 0.8, -0.2])
    exact = simulate({}, *schedule, TIMES, tolerance=1e-12)
    tolerances = np.array([1e-4, 1e-5, 1e-6, 1e-7, 1e-8])
    errors = []
    for tolerance in tolerances:
        run = simulate({}, *schedule, TIMES, tolerance=tolerance)
        errors.append(np.max(np.abs(run.speed - exact.speed)) / 500.0)
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    # An event that is smeared over a step stops this line; proportional error is slope 1, and a method of
    # order 4 whose estimate is of order 3 gives 4/4 to 4/3.
    assert slope > 0.85, (slope, errors)
    assert errors[2] < 2e-6, errors  # the default tolerance: about its own size


def test_samples_do_not_change_the_steps() -> None:
    # Output comes from the continuous extension: a finer grid moves no earlier sample.
    coarse = simulate({}, [0.0, 0.3], [0.5, -0.9], np.linspace(0.0, 1.0, 11))
    fine = simulate({}, [0.0, 0.3], [0.5, -0.9], np.linspace(0.0, 1.0, 1001))
    np.testing.assert_allclose(fine.speed[::100], coarse.speed, atol=1e-9)  # rounding of the grid


def test_time_of_an_event_is_exact() -> None:
    # Constant torque k_m I_sat in the dead band (no drag): Ω_min is left after I^r Ω_min/(k_m I_sat),
    # counted from the instant at which the rising current meets I_sat.
    parameters = {
        "torque_quadratic_forward": 0.0,
        "viscous_damping": 0.0,
        "torque_constant": 0.01,
        "back_emf_constant": 0.01,
        "winding_inductance": 1e-5,
        "winding_resistance": 0.5,
        "saturation_current": 0.4,
        "saturation_speed": 8.0,
        "rotor_inertia": 3e-5,
    }
    time = np.linspace(0.0, 0.1, 100_001)
    run = simulate(parameters, [0.0], [0.5], time)
    clipped = run.effective_current != run.current
    duration = time[clipped][-1] - time[clipped][0]
    # Before the clip the current rises for 8e-7 s; the grid of 1 µs counts on either side.
    assert abs(duration - 3e-5 * 8.0 / (0.01 * 0.4)) < 3e-6
