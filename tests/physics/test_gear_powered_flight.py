"""Thrust on the gear: against a joint integration of all 18 states, at the first contact, and simple laws."""

import math

import numpy as np
import pytest
from numba import njit

from fakes.gear_drops import level_start as start
from gear_rivals import body_rates
from sysid.errors import CampaignError
from sysid.gear.kernel import parameter_row
from sysid.gear.kernel.dynamics import derived
from sysid.gear.model import (
    PARAMETERS,
    Drops,
    Ending,
    Propulsion,
    Status,
    pack,
    simulate,
    simulate_population,
)
from sysid.integrate.piecewise import PiecewiseCubic
from sysid.motor.model import PARAMETERS as MOTOR
from sysid.motor.model import simulate as simulate_motor
from sysid.motor.pair_thrust import thrust_history

P = PARAMETERS.nominal
M = MOTOR.nominal | {
    "winding_resistance": 0.299,
    "winding_inductance": 0.0038,
    "saturation_current": 0.35,
    "saturation_speed": 6.3,
    "command_delay": 0.0,
}
# A landing at half command: idle at first contact, an impulse of the front motors, then full reverse.
REAR = ([-1.0, 0.0, 0.09], [0.5, 0.1, -1.0])
FRONT = ([-1.0, 0.0, 0.02, 0.09], [0.5, 0.1, 0.8, -1.0])


@njit(error_model="numpy")
def motor_rates(current, speed, no_load, m):
    """Equations (1-3) as printed, with the corrected constants; one pair of coefficients per direction."""
    res, ind, k, inertia, k_d, i_sat, omega_min, quad_f, quad_r = m
    effective = current
    torque = (quad_f if speed >= 0 else quad_r) * speed * abs(speed) + k_d * speed
    direction = 1.0 if speed > 0 else (-1.0 if speed < 0 else (1.0 if current > 0 else -1.0))
    rising = direction * (k * current - torque) > 0
    if abs(speed) < omega_min and rising:
        effective = min(max(current, -i_sat), i_sat)
    return k * (no_load - speed) / ind - res / ind * current, (k * effective - torque) / inertia


@njit(error_model="numpy")
def joint(y, commands, motor, thrust, p, c, law):
    """Rates of 14 coordinates and rates in the slope's frame and of current and speed of two motors."""
    out = np.empty(18)
    push = np.empty(2)
    for pair in range(2):
        i, w = y[14 + 2 * pair], y[15 + 2 * pair]
        out[14 + 2 * pair], out[15 + 2 * pair] = motor_rates(i, w, commands[pair], motor)
        push[pair] = 2 * (thrust[0] if w >= 0 else thrust[1]) * w * abs(w)
    m_b, i_b, dx_m, k_s, b_s = p
    lift = ((push[0] + push[1]) / m_b, dx_m * (push[0] - push[1]) / i_b)
    out[:14], depth = body_rates(y, lift, c, k_s, b_s, law)
    return out, depth


@njit(error_model="numpy")
def march(y, h, every, count, rear_t, rear_u, front_t, front_u, motor, thrust, p, c, law, idle):
    """Classical Runge-Kutta in fixed steps; the schedules start at the first contact."""
    out = np.empty((count, 18))
    began = np.inf
    commands = np.array([idle, idle])
    for n in range(count * every):
        if n % every == 0:
            out[n // every] = y
        t = n * h
        for k in range(len(rear_t)):
            if t >= began + rear_t[k] - 1e-12:
                commands[0] = rear_u[k]
        for k in range(len(front_t)):
            if t >= began + front_t[k] - 1e-12:
                commands[1] = front_u[k]
        k1, _ = joint(y, commands, motor, thrust, p, c, law)
        k2, _ = joint(y + 0.5 * h * k1, commands, motor, thrust, p, c, law)
        k3, _ = joint(y + 0.5 * h * k2, commands, motor, thrust, p, c, law)
        k4, _ = joint(y + h * k3, commands, motor, thrust, p, c, law)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        if began == np.inf:
            _, sink = joint(y, commands, motor, thrust, p, c, law)
            began = t + h if sink > 0 else began
    return out


def propulsion(**options):
    rear = thrust_history(M, *REAR, 0.5, **options)
    front = thrust_history(M, *FRONT, 0.5, **options)
    return Propulsion(rear, front, begins="first contact")


def no_load(command):
    slope = M["no_load_slope_forward"] if command > 0 else M["no_load_slope_reverse"]
    bias = M["no_load_intercept_forward"] if command > 0 else M["no_load_intercept_reverse"]
    return slope * command + math.copysign(bias, command)


def test_histories_equal_a_joint_integration_of_18_states():
    slope, speed = math.radians(15), 0.6
    c = derived(np.array([P[name] for name in parameter_row.NAMES]), slope)
    rest = c.q_n
    x, z, q, dx, dz, dq = start(slope, speed)
    co, si = math.cos(slope), math.sin(slope)
    steady = simulate_motor(M, [0.0], [0.5], [0.0], initial="steady")
    pair = [float(steady.current[0]), float(steady.speed[0])]
    y = [co * x - si * z, si * x + co * z, q - slope, 0, q - slope + rest, 0, q - slope - rest]
    y = np.array([*y, co * dx - si * dz, si * dx + co * dz, dq, 0, dq, 0, dq, *pair, *pair])
    motor = (M["winding_resistance"], M["winding_inductance"], M["back_emf_constant"], M["rotor_inertia"],
             M["viscous_damping"], M["saturation_current"], M["saturation_speed"],
             M["torque_quadratic_forward"], M["torque_quadratic_reverse"])  # fmt: skip
    assert M["torque_constant"] == M["back_emf_constant"]
    names = ("body_mass", "body_inertia", "thrust_point_dx", "ground_stiffness", "ground_damping")
    body = tuple(P[name] for name in names)
    exact = march(
        y, 1e-6, 5000, 60, np.array(REAR[0][1:]), np.array([no_load(u) for u in REAR[1][1:]]),
        np.array(FRONT[0][1:]), np.array([no_load(u) for u in FRONT[1][1:]]), motor,
        (M["thrust_quadratic_forward"], M["thrust_quadratic_reverse"]), body, c,
        (P["kinetic_friction"], P["slip_regularization"], 0.0), no_load(0.5),
    )  # fmt: skip
    time = np.arange(60) * 5e-3
    ours = simulate(P, slope, start(slope, speed), time, tolerance=1e-7, propulsion=propulsion())
    speeds = np.column_stack([exact[:, 15], exact[:, 17]])
    curves = np.where(speeds >= 0, M["thrust_quadratic_forward"], M["thrust_quadratic_reverse"])
    # The joint integration runs over the beginning of the dead band, where its torque jumps by 0.3 N·m, by up
    # to a step of 1e-6 s: 0.01 rad/s, which the clipped torque takes 0.1 ms to make, at 70 N/s of thrust.
    np.testing.assert_allclose(ours.thrust, 2 * curves * speeds * np.abs(speeds), atol=8e-3)
    assert ours.thrust.min() < -0.5
    along, normal = exact[:, 0], exact[:, 1]
    np.testing.assert_allclose(ours.state[:, 0], co * along + si * normal, atol=2e-5)
    np.testing.assert_allclose(ours.state[:, 1], co * normal - si * along, atol=2e-5)
    np.testing.assert_allclose(ours.state[:, 2], exact[:, 2] + slope, atol=2e-4)


def test_a_history_follows_its_motor_everywhere():
    for ideal in (False, True):
        history = thrust_history(M, *FRONT, 0.4, ideal_reversal=ideal)
        initial = simulate_motor(M, [0.0], [0.5], [0.0], initial="steady")
        time = np.linspace(0, 0.4, 7919)
        state = (float(initial.current[0]), float(initial.speed[0]))
        run = simulate_motor(M, *FRONT, time, initial=state, ideal_reversal=ideal)
        # Halved until the middles agree within 1e-6 of the largest thrust; elsewhere at most ten times that.
        assert np.abs(history(time) - 2 * run.thrust).max() < 1e-5 * 2 * np.abs(run.thrust).max() + 1e-5
        assert len(history.knots) < 1000
    assert history(-1.0) == history(0.0)
    assert history(9.0) == pytest.approx(float(history(0.4)))


def test_without_saturation_the_reversal_is_faster():
    crossing = []
    for ideal in (False, True):
        history = thrust_history(M, [-1.0, 0.0], [0.62, -1.0], 0.6, ideal_reversal=ideal)
        time = np.linspace(0, 0.6, 6001)
        values = history(time)
        crossing.append(time[np.argmax(values < 0.9 * values[-1])])
    # Reversal delay: the dead band costs about I^r Omega_min/(k I_sat), 49 ms.
    assert 0.02 < crossing[0] - crossing[1] < 0.1


def constant(rear, front, **options):
    return Propulsion(PiecewiseCubic.constant(rear), PiecewiseCubic.constant(front), **options)


def test_hover_and_roll_moment():
    weight = (P["body_mass"] + 2 * P["leg_mass"]) * P["gravity"]
    time = np.linspace(0, 0.4, 41)
    high, half = [0, 5, 0, 0, 0, 0], weight / 2
    hover = simulate(P, 0.1, high, time, propulsion=constant(half, half), tolerance=1e-8)
    # Thrust acts on the body, weight on the legs too: they sag by m_leg g/k_h, 0.03 mm, and nothing falls.
    assert np.abs(hover.state[:, 1] - 5.0).max() < 1e-4
    assert np.abs(hover.state[:, 2]).max() < 1e-9
    tilted = simulate(P, 0.1, high, time, propulsion=constant(half + 0.1, half - 0.1))
    # More thrust at the rear pitches the nose down, which is positive.
    assert tilted.state[-1, 2] > 0.05
    assert tilted.state[-1, 0] > 0.0


def test_nothing_starts_before_the_first_contact():
    slope = math.radians(15)
    time = np.arange(0, 0.5, 1e-3)
    high = start(slope, 0.3, height=0.1)
    ours = simulate(P, slope, high, time, propulsion=propulsion())
    touch = next(event.time for event in ours.events if event.kind.name == "TOUCHDOWN")
    before = time < touch
    np.testing.assert_allclose(ours.thrust[before], ours.thrust[0].reshape(1, 2) * np.ones((before.sum(), 1)))
    assert np.ptp(ours.thrust[~before], axis=0).min() > 1
    late = Propulsion(propulsion().rear, propulsion().front, begins="first contact", delay=0.05)
    delayed = simulate(P, slope, high, time, propulsion=late)
    changed = np.argmax(np.abs(np.diff(delayed.thrust[:, 0])) > 1e-3)
    assert time[changed] == pytest.approx(touch + 0.05, abs=6e-3)


def test_lanes_and_threads_under_thrust():
    slopes = np.radians([5, 15, 25, 30])
    states = np.array([start(q, 0.5) for q in slopes])
    each = [propulsion(), None, constant(-3.0, -3.0, begins=0.1), propulsion(ideal_reversal=True)]
    drops = Drops(slopes, states, [np.arange(0, 0.6, 5e-3)] * 4, each)
    rows = np.stack([pack({"leg_axial_stiffness": k}) for k in np.linspace(3000, 9000, 5)])
    forward = simulate_population(rows, drops, threads=1)
    back = simulate_population(rows[::-1], drops, threads=2)
    np.testing.assert_array_equal(forward.samples, back.samples[::-1])
    np.testing.assert_array_equal(forward.first_contact, back.first_contact[::-1])
    for d in range(4):
        single = simulate(rows[2], slopes[d], states[d], drops.time[d], propulsion=each[d])
        in_lanes = forward.samples[2, drops.offset[d] : drops.offset[d + 1]]
        # One text in two widths.
        np.testing.assert_allclose(single.state[:, [0, 1, 2, 7, 8, 9]], in_lanes, rtol=0, atol=1e-12)
    plain = simulate_population(rows, Drops(slopes[1:2], states[1:2], [drops.time[1]]))
    np.testing.assert_array_equal(plain.samples[0], forward.samples[0, drops.offset[1] : drops.offset[2]])


def test_landings_end_early_and_say_how():
    slopes = np.radians([5.0, 40.0])
    states = np.array([start(slopes[0], 0.3), start(slopes[1], 1.2)])
    down = Propulsion(*(thrust_history(M, [-1, 0], [0.5, -1], 1.0) for _ in range(2)), begins="first contact")
    drops = Drops(slopes, states, [np.array([0.0, 3.0])] * 2, down)
    row = pack({}, "hf")
    early = simulate_population(row, drops, surface="hf", ending=Ending("rest"))
    full = simulate_population(row, drops, surface="hf")
    assert list(early.status[0]) == [Status.CAME_TO_REST, Status.FLIPPED_OVER]
    assert early.rhs_evaluations.sum() < 0.6 * full.rhs_evaluations.sum()
    assert early.rest[0, 0] == full.rest[0, 0]
    assert early.flip[0, 1] == full.flip[0, 1]
    # At rest: the end is where it still is later, but for the reverse thrust that goes on bending the legs.
    np.testing.assert_allclose(early.end_state[0, 0, :3], full.end_state[0, 0, :3], atol=8e-3)
    assert np.isfinite(early.contact_state[0, 0]).all()
    assert early.first_contact[0, 0, 0] == pytest.approx(1e-3 / 0.3, rel=0.1)


@pytest.mark.parametrize("begins", ["contact", math.nan])
def test_propulsion_refusals(begins):
    with pytest.raises(CampaignError, match="first contact"):
        constant(1.0, 1.0, begins=begins)
    with pytest.raises(CampaignError, match="one for all"):
        Drops(np.zeros(2), np.zeros((2, 6)), [np.arange(2.0)] * 2, [None])
