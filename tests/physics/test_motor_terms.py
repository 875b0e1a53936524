"""Terms on trial of the motor: no bit without them; with them the equations as a slow solver has them."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sysid.motor import model
from sysid.motor.model import PARAMETERS, simulate

TERMS = PARAMETERS.group("term")
STEPS, TIME = ([0.0, 0.3, 0.6, 0.9], [0.4, 0.9, 0.15, 0.6]), np.linspace(0.0, 1.2, 601)
SIZES = {"supply_resistance": 0.2, "dead_time_voltage": 0.4, "winding_warming": 2e-3}


def slow(true, sizes):
    """Current and speed at TIME, integrated without any code of the kernel."""
    row = {**PARAMETERS.nominal, **true}
    k, inertia = row["back_emf_constant"], row["rotor_inertia"]

    def rates(t, state, u):
        current, speed, heat = state
        sag = row["winding_resistance"] + sizes.get("supply_resistance", 0.0) * u**2
        resistance = sag * (1.0 + sizes.get("winding_warming", 0.0) * heat)
        dead = sizes.get("dead_time_voltage", 0.0) * (np.sign(u) - current / np.hypot(current, 0.1))
        volt = k * (row["no_load_slope_forward"] * u) + dead
        drag = row["torque_quadratic_forward"] * speed**2 + row["viscous_damping"] * speed
        flow = (volt - k * speed - resistance * current) / row["winding_inductance"]
        return flow, (k * current - drag) / inertia, current**2

    state, out = np.zeros(3), np.zeros((len(TIME), 2))
    instants = [*STEPS[0], TIME[-1]]
    for begin, end, u in zip(STEPS[0], instants[1:], STEPS[1], strict=True):
        inside = np.abs(TIME - (begin + end) / 2) <= (end - begin) / 2 + 1e-12
        run = solve_ivp(rates, (begin, end), state, "LSODA", np.clip(TIME[inside], begin, end), args=(u,),
                        rtol=1e-9, atol=1e-9)  # fmt: skip
        out[inside], state = run.y[:2].T, run.y[:, -1]
    return out


def test_terms_of_no_size_leave_every_bit():
    # At zero as well: the golden record has the bits of the motor's costs from before the terms.
    plain = simulate({}, *STEPS, TIME)
    for name in TERMS:
        tiny = simulate({name: 5e-324}, *STEPS, TIME)
        # What is constant in a step has steps of half a millisecond.
        limit = 0.0 if name == "supply_resistance" else 1e-6
        np.testing.assert_allclose(tiny.current, plain.current, rtol=0, atol=20.0 * limit)
        np.testing.assert_allclose(tiny.speed, plain.speed, rtol=0, atol=900.0 * limit)
        assert np.abs(simulate({name: SIZES[name]}, *STEPS, TIME).speed - plain.speed).max() > 1.0, name


@pytest.mark.parametrize("names", [(), *((name,) for name in TERMS), TERMS])
def test_terms_are_the_equations(names):
    sizes = {name: SIZES[name] for name in names}
    # A braking rotor turns its current round three times; the dead band is left out of both.
    run = simulate(sizes, *STEPS, TIME, ideal_reversal=True, tolerance=1e-6)
    current, speed = slow({}, sizes).T
    # Resistance and dead-time voltage are constant in a step: 1e-3 of 20 A and of 900 rad/s at worst.
    limit = 1e-3 if names else 1e-5
    np.testing.assert_allclose(run.speed, speed, atol=limit * np.abs(speed).max())
    np.testing.assert_allclose(run.current, current, atol=10 * limit * np.abs(current).max())


def test_the_steady_state_sags_with_the_supply():
    sizes = {"supply_resistance": 0.2}
    current, speed = model.steady_state(0.7, sizes)
    row = PARAMETERS.nominal
    volts = row["back_emf_constant"] * float(model.no_load_speed(0.7, {}) - speed)
    assert volts == pytest.approx((row["winding_resistance"] + 0.2 * 0.49) * float(current), rel=1e-12)
    run = simulate(sizes, [0.0], [0.7], [0.0, 1.0], initial="steady")
    np.testing.assert_allclose(run.speed, speed, rtol=1e-8)
