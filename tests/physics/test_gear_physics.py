"""Laws that the landing gear obeys whatever its numbers: energy, momentum, symmetry, statics, friction."""

import math

import numpy as np
import pytest

from fakes.gear_drops import legs
from fakes.gear_drops import level_start as start
from sysid.gear.model import PARAMETERS, Drops, Status, pack, simulate, simulate_population

NOMINAL = PARAMETERS.nominal


def energy(p, slope, state):
    """Kinetic, gravitational and elastic energy [J] in each state (n, 14)."""
    _, z, _, h_c, q_c, h_d, q_d, dx, dz, dq, *_ = state.T
    rest = math.atan2(p["foot_dx"] - p["joint_dx"], p["foot_dz"] - p["joint_dz"])
    total = p["body_mass"] * (0.5 * (dx**2 + dz**2) + p["gravity"] * z) + 0.5 * p["body_inertia"] * dq**2
    total = total + 0.5 * p["leg_axial_stiffness"] * (h_c**2 + h_d**2)
    total = total + 0.5 * p["leg_bending_stiffness"] * ((q_c - rest) ** 2 + (q_d - rest) ** 2)
    for foot, middle, speed, dtheta, _ in legs(p, state):
        total = total + p["leg_mass"] * (0.5 * (speed**2).sum(0) + p["gravity"] * middle[1])
        total = total + 0.5 * p["leg_inertia"] * dtheta**2
        sink = -(foot[0] * math.sin(slope) + foot[1] * math.cos(slope))
        total = total + 0.5 * p["ground_stiffness"] * np.maximum(sink, 0.0) ** 2
    return total


@pytest.mark.parametrize("slope_deg", [5, 20, 35])
@pytest.mark.parametrize(("surface", "friction"), [("lf", 0.44), ("hf", 0.87)])
def test_energy_never_grows(slope_deg, surface, friction):
    slope = math.radians(slope_deg)
    time = np.linspace(0, 0.7, 3501)
    p = NOMINAL | {"kinetic_friction": friction}
    run = simulate(p, slope, start(slope, 0.8), time, surface=surface, tolerance=1e-6)
    total = energy(p, slope, run.state)
    # Interpolated samples of an integration good to 1e-6: nothing above 1e-5 J of the 2 J that the drop has.
    assert np.diff(total).max() < 1e-5
    assert total[-1] < total[0] - 0.3  # and the dampers and friction do take some


def test_energy_is_conserved_without_damping_and_friction():
    lossy = ("leg_axial_damping", "leg_bending_damping", "ground_damping", "kinetic_friction")
    p = NOMINAL | dict.fromkeys(lossy, 0.0)
    slope = math.radians(15)
    run = simulate(p, slope, start(slope, 0.8), np.linspace(0, 0.3, 301), tolerance=1e-9)
    total = energy(p, slope, run.state)
    assert run.normal_force.max() > 50  # it did bounce
    # 1e-6 of the energy that the drop brings, through flight and elastic contact.
    assert np.abs(total - total[0]).max() < 1e-6 * abs(total[0])


@pytest.mark.parametrize("surface", ["lf", "hf"])
def test_momentum_in_flight(surface):
    state = np.zeros(14)
    state[:7] = [0.0, 5.0, 0.3, 0.004, 0.2, -0.003, 0.05]
    state[7:] = [0.4, -0.2, 2.0, 0.1, 3.0, -0.2, -4.0]
    time = np.linspace(0, 0.5, 101)
    run = simulate(NOMINAL, 0.2, None, time, state=state, tolerance=1e-8, surface=surface)
    assert run.normal_force.max() == 0
    assert (run.status, run.reached) == (Status.OK, pytest.approx(0.5))
    p, s = NOMINAL, run.state
    masses = [p["body_mass"], p["leg_mass"], p["leg_mass"]]
    parts = [(s[:, :2].T, s[:, 7:9].T, p["body_inertia"] * s[:, 9])]
    parts += [(middle, speed, p["leg_inertia"] * spin) for _, middle, speed, spin, _ in legs(p, s)]
    momentum = sum(m * part[1] for m, part in zip(masses, parts, strict=True))
    weight = sum(masses) * p["gravity"]
    # Linear invariants of the equations; the integrator keeps what its tolerance and the interpolation leave.
    np.testing.assert_allclose(momentum[0], momentum[0, 0], atol=1e-7)
    np.testing.assert_allclose(momentum[1] + weight * time, momentum[1, 0], atol=1e-7)
    centre = sum(m * part[0] for m, part in zip(masses, parts, strict=True)) / sum(masses)
    drift = momentum / sum(masses)
    spin = 0.0
    for m, (place, speed, turning) in zip(masses, parts, strict=True):
        r, v = place - centre, speed - drift
        spin = spin + turning + m * (r[1] * v[0] - r[0] * v[1])
    np.testing.assert_allclose(spin, spin[0], atol=1e-7)


@pytest.mark.parametrize(("surface", "friction"), [("lf", 0.44), ("hf", 0.87)])
def test_mirrored_slope_mirrors_the_motion(surface, friction):
    p = NOMINAL | {"kinetic_friction": friction}
    slope = math.radians(15)
    state = np.zeros(14)
    state[:7] = [0.01, 0.19, 0.1, 0.0, 0.13, 0.0, 0.15]
    state[7:] = [0.3, -0.8, 0.5, 0.1, 1.0, -0.1, 0.4]
    mirrored = state * np.tile([-1, 1, -1, 1, 1, 1, 1], 2)
    swap = [0, 1, 2, 5, 6, 3, 4]
    order = [*swap, *(7 + i for i in swap)]
    time = np.linspace(0, 0.4, 81)
    run = simulate(p, slope, None, time, state=state, tolerance=1e-6, surface=surface)
    twin = simulate(p, -slope, None, time, state=mirrored[order], tolerance=1e-6, surface=surface)
    back = twin.state[:, order] * np.tile([-1, 1, -1, 1, 1, 1, 1], 2)
    # Sums run in another order, so that now and then a step is accepted on one side only: the motions agree
    # as well as either is integrated, 1e-5 for leg rates of 10 rad/s at this tolerance.
    np.testing.assert_allclose(back, run.state, rtol=0, atol=1e-4)
    assert (len(run.switches) >= 4) == (surface == "hf")
    # Rear and front change places, and with them the modes.
    np.testing.assert_array_equal(twin.switches[:, 1], 1 - run.switches[:, 1])
    np.testing.assert_array_equal(twin.switches[:, 2], run.switches[:, 2])
    assert run.normal_force.max() > 20


def test_static_sag():
    run = simulate(NOMINAL, 0.0, start(0.0, 0.05, 1e-4), np.linspace(0, 3, 31))
    last = run.state[-1:]
    weight = (NOMINAL["body_mass"] + 2 * NOMINAL["leg_mass"]) * NOMINAL["gravity"]
    # After 3 s the bounces are gone (b_h/m damps within 0.1 s); what is left is friction's creep, slow and
    # horizontal.
    np.testing.assert_allclose(run.normal_force[-1], weight / 2, rtol=1e-3)
    for foot, *_ in legs(NOMINAL, last):
        np.testing.assert_allclose(-foot[1], weight / 2 / NOMINAL["ground_stiffness"], rtol=1e-3)


@pytest.mark.parametrize("slope_deg", [5, 27])
def test_friction_stays_in_its_cone(slope_deg):
    slope = math.radians(slope_deg)
    run = simulate(NOMINAL, slope, start(slope, 0.7), np.linspace(0, 0.7, 1401))
    assert (run.normal_force >= 0).all()
    # Equality is never reached: |v|/(|v| + eps_v) < 1.
    assert (np.abs(run.friction_force) <= NOMINAL["kinetic_friction"] * run.normal_force + 1e-12).all()
    assert np.abs(run.friction_force).max() > 5


@pytest.mark.parametrize("slope_deg", [10, 15])
def test_creep_on_a_slope_below_the_friction_angle(slope_deg):
    slope = math.radians(slope_deg)
    run = simulate(NOMINAL, slope, start(slope, 0.1), np.linspace(0, 4, 41))
    ratio = math.tan(slope) / NOMINAL["kinetic_friction"]
    along = run.state[-1, 7] * math.cos(slope) - run.state[-1, 8] * math.sin(slope)
    # Both feet share one speed once the legs have stopped spreading; after 4 s within 2 %.
    assert along == pytest.approx(NOMINAL["slip_regularization"] * ratio / (1 - ratio), rel=0.02)


@pytest.mark.parametrize("clock", [np.linspace(0, 0.5, 6), np.array([3.0, 3.001, 3.0013, 3.2, 3.5])])
def test_any_clock_samples_the_same_motion(clock):
    slope = math.radians(20)
    body = start(slope, 0.6)
    dense_time = np.union1d(np.linspace(0, 0.5, 501), clock - clock[0])
    dense = simulate(NOMINAL, slope, body, dense_time)
    drops = Drops(np.array([slope]), np.array([body]), [clock])
    sparse = simulate_population(pack({}), drops)
    rows = np.searchsorted(dense_time, clock - clock[0])
    # Sampling never changes the steps, so the numbers agree to the last bits of the interpolation.
    np.testing.assert_allclose(
        sparse.samples[0], dense.state[rows][:, [0, 1, 2, 7, 8, 9]], rtol=0, atol=1e-12
    )
