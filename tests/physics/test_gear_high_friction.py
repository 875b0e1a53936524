"""The high-friction hybrid: references, no creep, no missed switch, cones, and one driver in two widths."""

import math
from pathlib import Path

import numpy as np
import pytest

from fakes.gear_drops import SIX, legs, level_start, nrmse, touchdowns
from fakes.published import table_2
from sysid.filters import runs
from sysid.gear import model
from sysid.gear.model import SURFACES, TIGHT_TOLERANCE, simulate

REFERENCES = Path(__file__).resolve().parents[1] / "reference"
P = table_2("hf").set_values(1)
# What a fit simulates with; a single drop takes a tighter one by default.
FIT = SURFACES["hf"].tolerance


def run(slope_deg, speed, time, tolerance=None, **changes):
    slope = math.radians(slope_deg)
    return simulate(
        P | changes, slope, level_start(slope, speed, p=P), time, surface="hf", tolerance=tolerance
    )


def feet(slope, state):
    """Place and speed of both feet along the slope (n, 2) [m, m/s]."""
    tangent = np.array([math.cos(slope), -math.sin(slope)])
    along = [(tangent @ foot, tangent @ speed) for foot, *_, speed in legs(P, state)]
    return tuple(np.stack(part, 1) for part in zip(*along, strict=True))


def stuck_feet(time, switches):
    """Whether each foot sticks at each time (n, 2)."""
    stuck = np.zeros((len(time), 2), dtype=bool)
    for at, foot, sticks, *_ in switches:
        stuck[time >= at, int(foot)] = bool(sticks)
    return stuck


@pytest.mark.parametrize(
    ("name", "slope_deg"), [("gear-hf-10deg-0.5mps.csv", 10), ("gear-hf-20deg-0.7mps.csv", 20)]
)
def test_references(name, slope_deg):
    table = np.loadtxt(REFERENCES / name, delimiter=",", skiprows=1, encoding="utf-8")
    time, state = table[:, 0], table[:, 1:15]
    body = state[0, [0, 1, 2, 7, 8, 9]]
    ours = simulate(P, math.radians(slope_deg), body, time, surface="hf", tolerance=TIGHT_TOLERANCE)
    error = nrmse(ours.state, state)
    # The references damp a stuck foot's residual slip of 1e-3 m/s and are converged to 3e-5 in the body.
    assert error[[0, 1, 2, 7, 8, 9]].max() < 1e-3


@pytest.mark.parametrize(("slope_deg", "speed"), SIX)
def test_fit_setting_up_to_the_third_contact(slope_deg, speed):
    dense = run(slope_deg, speed, np.arange(0, 0.5, 2e-4), tolerance=1e-7)
    until = [*(t for t, _ in touchdowns(dense)), 0.5, 0.5, 0.5][2]
    last = max(4, int(until / 5e-3))
    ours = run(slope_deg, speed, np.arange(0, 0.5, 5e-3), tolerance=FIT)
    exact, fit = dense.state[::25][:last], ours.state[:last]
    # 0.3 % mean NRMSE is what a fit may carry; 0.01 % at most is what the surface's setting claims, tested
    # here with room for another machine's rounding. The bounces after the third contact are chaotic.
    assert nrmse(fit, exact)[[0, 1, 2, 7, 8]].mean() < 2e-4


@pytest.mark.parametrize("slope_deg", [5, 20, 35])
def test_forces_and_stuck_feet_respect_the_modes(slope_deg):
    time = np.arange(0, 0.7, 1e-4)
    trajectory = run(slope_deg, 0.7, time, tolerance=1e-5)
    stuck = stuck_feet(time, trajectory.switches)
    place, speed = feet(math.radians(slope_deg), trajectory.state)
    assert stuck.any()
    for foot in range(2):
        for begin, end in runs(stuck[:, foot]):
            # The multiplier holds the foot's acceleration at zero; 10 um over a contact is promised.
            assert np.ptp(place[begin:end, foot]) < 1e-5
    normal, friction = trajectory.normal_force, trajectory.friction_force
    mu_s = P["kinetic_friction"] + P["static_friction_excess"]
    # Between step ends friction is interpolated linearly, the normal force is not: 0.02 N here, 0.002 N at a
    # tenth of the tolerance, beside contact forces of 100 N.
    assert (np.abs(friction) <= mu_s * normal + 0.05).all()
    slipping = (normal > 5.0) & ~stuck & (np.abs(speed) > 0.05)
    assert slipping.sum() > 10
    # Right direction of slip: friction opposes it at every sliding sample.
    assert (friction[slipping] * speed[slipping] < 0).all()
    np.testing.assert_allclose(
        np.abs(friction[slipping]), P["kinetic_friction"] * normal[slipping], rtol=1e-3, atol=0.05
    )


@pytest.mark.parametrize(
    ("slope", "speed", "excess"),
    [(20, 0.7, 0.0), (20, 0.7, 0.3), (10, 0.5, 0.0), (5, 0.8, 0.0), (5, 0.7, 0.0)],
)
def test_switches_are_consistent(slope, speed, excess):
    trajectory = run(slope, speed, np.arange(0, 0.7, 1e-3), front_friction_excess=excess)
    assert len(trajectory.switches) >= 4
    held = [False, False]
    failed_to_stick = 0
    instants = trajectory.switches[:, 0]
    kept = 0
    loaded = [0, 0]
    # The same drop sampled at the switches themselves: its normal forces say which coefficient was meant.
    sampled = run(slope, speed, np.concatenate([[0.0], np.unique(instants)]), front_friction_excess=excess)
    # Coefficients of the rear and of the front foot.
    mu_k = P["kinetic_friction"] * np.array([1.0, 1.0 + excess])
    mu_s = mu_k + P["static_friction_excess"] * np.array([1.0, 1.0 + excess])
    for time, foot, sticks, *forces in trajectory.switches:
        available, required = np.array(forces[:2]), np.abs(forces[2:])
        foot, other = int(foot), 1 - int(foot)
        if sticks:
            assert available[foot] > required[foot]
        else:
            # A release is located to 1e-7 s behind the loss; forces change by less than 1 % of a newton in
            # that time. A slipping foot that fails to stick lacks kinetic friction, not static one.
            assert available[foot] < required[foot] + 0.01
            failed_to_stick += not held[foot]
        before = held[foot]
        held[foot] = bool(sticks)
        if np.count_nonzero(instants == time) == 1:
            normal = sampled.normal_force[np.searchsorted(sampled.time, time)]
            # The foot itself is judged by the mode that it has just lost: mu_k where a slip came to zero,
            # whatever follows, and mu_s where it is released.
            mu = (mu_s if before else mu_k)[foot]
            assert available[foot] == pytest.approx(mu * normal[foot], rel=0.03, abs=0.05)
            # A release that nothing else brought about is where the required force crosses the cone, not
            # somewhere beyond it; what it gains within 1e-7 s is as above.
            if before:
                assert required[foot] == pytest.approx(available[foot], abs=0.01)
            loaded[before] += normal[foot] > 5.0
            # A foot that keeps its mode is judged by that mode's coefficient; the two differ by 9 %, sampling
            # between two steps of the integrator costs up to 2 %.
            mu = (mu_s if held[other] else mu_k)[other]
            assert available[other] == pytest.approx(mu * normal[other], rel=0.03, abs=0.05)
            kept += held[other] and normal[other] > 5.0
    assert kept > 0
    # At 5 N the two coefficients are 0.4 N apart, beyond the tolerance: both kinds of switch were seen there,
    # but for releases on the flattest board, which all fall to lighter feet.
    assert loaded[0] > 0
    assert loaded[1] > 0 or slope == 5
    # On the flattest board a foot comes to zero slip too lightly loaded to stick.
    assert failed_to_stick == (slope == 5)
    assert (np.diff(instants) >= 0).all()


@pytest.mark.parametrize(
    ("slope", "speed", "tolerances"),
    [
        (8, 0.3, (3e-4, None)),
        (15, 0.6, (3e-4, None)),
        (5, 0.5, (None,)),
        (5, 0.4, (FIT, 3e-4, 1e-4, None)),  # where looking at inner stages must not invent a switch
    ],
)
def test_a_short_release_is_not_stepped_over(slope, speed, tolerances):
    """A foot that is released and sticks again within one step is still seen, by default always."""
    time = np.arange(0, 0.5, 5e-3)
    exact = run(slope, speed, time, tolerance=1e-7)
    assert len(exact.switches) >= 15
    for tolerance in tolerances:
        ours = run(slope, speed, time, tolerance=tolerance)
        # Inner stages of a step are looked at as well; by the ends of steps alone the slow drop loses two.
        np.testing.assert_array_equal(ours.switches[:, 1:3], exact.switches[:, 1:3])
        if tolerance != FIT:
            np.testing.assert_allclose(ours.switches[:8, 0], exact.switches[:8, 0], atol=1e-4)


@pytest.mark.parametrize(("slope", "speed"), [(8, 0.3), (5, 0.5)])
def test_releases_that_the_fit_setting_misses_do_not_matter(slope, speed):
    time = np.arange(0, 0.5, 5e-3)
    fit, exact = (run(slope, speed, time, tolerance=tolerance) for tolerance in (FIT, 1e-7))
    missed = len(exact.switches) - len(fit.switches)
    # It may miss some, at most 4 as was measured, ...
    assert 0 <= missed <= 4
    # ... all late: before 0.2 s of 0.5 s (the first differs at 0.21 s) nothing is missed; ...
    early = [trajectory.switches[trajectory.switches[:, 0] < 0.2, 1:3] for trajectory in (fit, exact)]
    np.testing.assert_array_equal(*early)
    assert len(early[0]) > 3
    # ... and short: feet stick for as long as in the exact drop, but for 5 ms in all of 0.5 s.
    clock = np.arange(0.0, 0.5, 1e-5)
    apart = stuck_feet(clock, fit.switches) != stuck_feet(clock, exact.switches)
    assert 1e-5 * apart.sum() < 5e-3
    # ... and the body's motion over all 0.5 s stays within what is allowed up to the third contact.
    assert nrmse(fit.state, exact.state)[[0, 1, 2, 7, 8]].mean() < 3e-3


def test_every_event_is_kept(monkeypatch):
    time = np.arange(0, 0.4, 1e-2)
    whole = run(8, 0.3, time)
    monkeypatch.setattr(model, "_MARKS", 3)
    again = run(8, 0.3, time)
    # A drop whose log is full is repeated with more room.
    assert again.events == whole.events
    assert len(whole.events) > 24
    np.testing.assert_array_equal(again.switches, whole.switches)


def test_static_sag_of_a_stuck_drone_on_a_slope():
    slope = math.radians(10)
    trajectory = run(10, 0.1, np.arange(0, 3, 1e-2), leg_bending_damping=0.2)
    assert stuck_feet(trajectory.time, trajectory.switches)[-1].all()
    normal, friction = trajectory.normal_force[-1], trajectory.friction_force[-1]
    weight = (P["body_mass"] + 2 * P["leg_mass"]) * P["gravity"]
    parts = list(legs(P, trajectory.state[-1:]))
    depth = [-(foot[0] * math.sin(slope) + foot[1] * math.cos(slope)).item() for foot, *_ in parts]
    # Springs in static balance: every foot sinks by its load over the ground's stiffness. The legs still ring
    # by less than 0.1 % of the weight after 3 s.
    np.testing.assert_allclose(depth, normal / P["ground_stiffness"], rtol=1e-3)
    assert normal.sum() == pytest.approx(weight * math.cos(slope), rel=2e-3)
    assert friction.sum() == pytest.approx(-weight * math.sin(slope), rel=2e-3)
    # Moments about the feet's middle: the load shifts to the front foot.
    masses = [P["body_mass"], P["leg_mass"], P["leg_mass"]]
    places = [trajectory.state[-1, :2], *(middle[:, 0] for _, middle, *_ in parts)]
    centre = sum(m * np.asarray(p) for m, p in zip(masses, places, strict=True)) / sum(masses)
    tangent = np.array([math.cos(slope), -math.sin(slope)])
    rear, front = (tangent @ (foot[:, 0] - centre) for foot, *_ in parts)
    height = centre @ [math.sin(slope), math.cos(slope)]
    turning = rear * normal[0] + front * normal[1] - height * (-friction.sum())
    assert normal[1] > 1.5 * normal[0]
    assert abs(turning) < 2e-3 * weight * P["foot_dx"]


def test_rest_on_a_slope_below_the_friction_angle():
    # 15 deg is below atan(0.95) = 43 deg and below the tip limit: after the bounces both feet stick for good.
    time = np.arange(0, 3, 1e-2)
    trajectory = run(15, 0.2, time, leg_bending_damping=0.2)
    # Legs that ring on at less than 1 % of a radian per second are all that moves.
    assert np.abs(trajectory.state[-20:, 7:]).max() < 1e-2
    place, _ = feet(math.radians(15), trajectory.state[-100:])
    assert np.ptp(place, axis=0).max() < 1e-5


def test_friction_takes_energy():
    slope = math.radians(20)
    trajectory = run(20, 0.8, np.arange(0, 0.7, 2e-4), tolerance=1e-6)
    _, speed = feet(slope, trajectory.state)
    power = trajectory.friction_force * speed
    # Friction takes energy; a stuck foot's residue and the interpolation leave microwatts of sign.
    assert power.max() < 0.05
