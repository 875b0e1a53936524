"""Landings obey physics: hover, triggers, rest, descent, impulses, borders."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from fakes.landings import published
from fakes.published import table_1
from sysid.errors import CampaignError
from sysid.gear.model import Ending, EventKind, simulate
from sysid.landing.approach import fly_down
from sysid.landing.controllers import Controller, Sensing, Step, find_controller
from sysid.landing.drone import Motors
from sysid.landing.impulse import Impulses, best_pair
from sysid.landing.maps import LandingWork
from sysid.landing.outcomes import LANDED, Outcome, Rules
from sysid.landing.settings import ImpulseSettings, MapSettings, Scenario, grid
from sysid.landing.simulate import ending_of, land, land_many, specific_force
from sysid.landing.static_limits import rigid_limits

SMALL = ImpulseSettings(
    delays=tuple(round(0.02 * k, 2) for k in range(8)), durations=tuple(round(0.04 * k, 2) for k in range(4))
)


def test_a_drone_that_is_told_to_hover_stays():
    drone = published()
    hold = Controller("hold", (Step(0.0, drone.hover_command, drone.hover_command),))
    # Clear of the ground: unloaded legs that begin to hang would push it off.
    body = drone.start(Scenario(0.0, 0.0)) + np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0])
    thrust = Motors(drone).propulsion(hold.steps)
    run = simulate(drone.row, 0.0, body, np.array([0.0, 0.5, 1.0]), propulsion=thrust)
    assert run.thrust.sum(axis=1) == pytest.approx(np.full(3, drone.weight), rel=1e-5)
    # Thrust carries all but 1e-5 of the weight, g/2 * 1e-5 over one second; hanging legs move it by microns.
    assert abs(run.state[-1, 1] - body[1]) < 6e-5


def test_thrust_is_that_of_the_motor_model():
    drone = published()
    run = land(drone, Scenario(0.1, 0.3), find_controller("reverse"))
    total = run.trajectory.thrust.sum(axis=1)
    assert total[0] == pytest.approx(drone.weight, rel=1e-6)
    # Settled: the loaded speed at full reverse solves Ω_0(-1) = Ω + R (τ_aero + k_d Ω)/(k_m k_v), here by
    # bisection; T of it is 3.44 N a motor. The paper's static limits imply about 12 N of its own motors.
    m = table_1().set_values()
    droop = m["winding_resistance"] / (m["torque_constant"] * m["back_emf_constant"])
    no_load = m["no_load_slope_reverse"] + m["no_load_intercept_reverse"]

    def short(speed):
        torque = (m["torque_quadratic_reverse"] * speed + m["torque_linear_reverse"]) * speed
        return speed + droop * (torque + m["viscous_damping"] * speed) - no_load

    speed = brentq(short, 0.0, no_load)
    each = (m["thrust_quadratic_reverse"] * speed + m["thrust_linear_reverse"]) * speed
    # One second after the command, ten time constants of 0.08 s: e^-10.
    assert total[-1] == pytest.approx(-4 * each, rel=1e-3)
    assert 12.0 < 4 * each < 14.5
    reached = np.flatnonzero(total < 0.9 * total[-1])[0] / 1000.0
    assert 0.17 <= reached <= 0.28  # the paper's 250 ms; an independent simulation gave 210 ms


def test_ideal_reversal_only_saves_the_dead_time():
    slow, fast = (
        land(published(), Scenario(0.1, 0.3), find_controller("reverse", ideal_reversal=ideal)).trajectory
        for ideal in (False, True)
    )
    before = slow.thrust[:, 0] > 0.1
    np.testing.assert_allclose(slow.thrust[before], fast.thrust[before], atol=1e-4)
    np.testing.assert_allclose(slow.thrust[-1], fast.thrust[-1], rtol=1e-5)
    at = [np.flatnonzero(run.thrust[:, 0] < 0.5 * run.thrust[-1, 0])[0] for run in (slow, fast)]
    # I^r Ω_min/(k_m I_sat) = 49 ms in the dead band (model.md §4).
    assert at[0] - at[1] == pytest.approx(49, abs=12)


@pytest.mark.parametrize("surface", ["lf", "hf"])
@pytest.mark.parametrize("controller", ["off", "reverse"])
def test_one_landing_and_many_agree(surface, controller):
    law = find_controller(controller)
    for slope, speed in ((8.0, 0.4), (38.0, 1.0)):
        cell = Scenario(math.radians(slope), speed)
        one = land(published(surface), cell, law)
        many = land_many(published(surface), [cell], law)
        assert many.outcome[0] == one.outcome
        # The many locate rest and flip to a step of at most 5 ms, and look at most one step later.
        np.testing.assert_allclose(many.time[0], one.time, atol=6e-3)
        np.testing.assert_allclose(many.distance[0], one.distance, atol=8e-3)


def test_nothing_rests_before_the_last_command():
    # Level and slow it stands at once; the push that comes a second later throws it over.
    late = Controller("late", (Step(0.0, 0.0, 0.0), Step(1.0, 0.0, 1.0), Step(1.6, -1.0, -1.0)))
    found = land_many(published(), [Scenario(0.0, 0.1)], late)
    assert found.outcome[0] == Outcome.FLIPPED
    assert found.flip[0] > 1.0
    calm = land_many(published(), [Scenario(0.0, 0.1)], find_controller("off"))
    assert calm.outcome[0] == Outcome.SHORT
    assert calm.time[0] < 0.5


def test_rules_reach_the_kernel():
    cells, off = [Scenario(0.1, 0.6)], find_controller("off")
    normal = land_many(published(), cells, off)
    longer = land_many(published(), cells, off, rules=Rules(rest_time=0.6))
    stricter = land_many(published(), cells, off, rules=Rules(rest_speed=1e-4, rest_turn=1e-3))
    assert longer.time[0] == pytest.approx(normal.time[0], abs=6e-3)  # a longest step
    # On low friction it creeps at 2.9 mm/s on this slope (eps_v r/(1 - r)) and is never that still.
    assert np.isnan(stricter.time[0])
    tipped = land_many(published("hf"), [Scenario(math.radians(20.0), 1.2)], off)
    early = land_many(published("hf"), [Scenario(math.radians(20.0), 1.2)], off, rules=Rules(flip_angle=0.7))
    assert tipped.outcome[0] == early.outcome[0] == Outcome.FLIPPED
    assert early.flip[0] < tipped.flip[0] - 0.02
    assert Ending().rest_speed == Rules().rest_speed
    assert ending_of(Rules(), "rest") == Ending("rest")


@pytest.mark.parametrize("surface", ["lf", "hf"])
def test_own_sensing_triggers_late_or_never(surface):
    law = find_controller("reverse", sensing=Sensing())
    cells = [Scenario(math.radians(15.0), speed) for speed in (0.0, 0.1, 0.6, 1.0)]
    found = land_many(published(surface), cells, law)
    # A gentle touchdown stays below 2 g: nothing triggers, the motors run on, nothing has landed.
    assert np.isnan(found.trigger[:2]).all()
    assert set(found.outcome[:2].tolist()) <= {Outcome.OTHER, Outcome.FLIPPED}
    assert np.isnan(found.time[:2]).all()
    # The filter needs some milliseconds.
    assert (found.trigger[2:] > 1e-3).all()
    assert (found.trigger[2:] < 0.05).all()
    run = land(published(surface), cells[2], law)
    assert run.trigger == found.trigger[2]
    hovering = run.trajectory.time < run.trigger
    assert run.trajectory.thrust[hovering].sum(axis=1) == pytest.approx(published(surface).weight, rel=1e-5)


def test_hovering_reads_one_g_and_falling_nothing():
    time = np.arange(50) / 1000.0
    states = np.zeros((50, 6))
    states[:, 2] = 0.3
    drone = published()
    read = specific_force(states, 1000.0, drone)
    # Body axes of a drone pitched by 0.3 rad.
    np.testing.assert_allclose(read[1:], np.tile([-9.81 * math.sin(0.3), 9.81 * math.cos(0.3)], (49, 1)))
    states[:, 4] = -9.81 * time
    np.testing.assert_allclose(specific_force(states, 1000.0, drone)[1:], 0.0, atol=1e-11)


def test_a_level_descent_arrives_as_it_began():
    drone = published()
    begin = Scenario(math.radians(20.0), 0.5)
    way = fly_down(drone, begin, 0.4)
    assert way.duration == pytest.approx(0.8, rel=1e-4)  # LSODA at 1e-8, hover to 1e-6 of the weight
    assert way.touchdown.pitch == pytest.approx(0.0, abs=1e-9)
    assert way.touchdown.speed == pytest.approx(0.5, rel=1e-4)
    direct = land(drone, begin, find_controller("reverse"))
    after = land(drone, way.touchdown, find_controller("reverse"), motors=Motors(drone, state=way.motors))
    assert after.outcome == direct.outcome
    assert after.distance == pytest.approx(direct.distance, abs=2e-3)  # bounces amplify 1e-4


def test_the_attitude_controller_levels_a_tilted_drone():
    drone = published()
    begin = Scenario(math.radians(10.0), 0.5, pitch=math.radians(8.0))
    near, far = fly_down(drone, begin, 0.05), fly_down(drone, begin, 1.0)
    assert abs(far.touchdown.pitch) < 0.02 * begin.pitch < abs(near.touchdown.pitch)
    # Tilted nose-down the thrust pulls it down-slope, as long as the tilt lasts.
    assert far.touchdown.horizontal_speed > 0.05
    with pytest.raises(CampaignError, match="give both above 0"):
        fly_down(drone, Scenario(0.1, 0.0), 1.0)
    with pytest.raises(CampaignError, match="never touches down"):
        fly_down(drone, Scenario(0.1, 0.5, pitch_rate=-60.0), 1.0)


@pytest.mark.parametrize("surface", ["lf", "hf"])
def test_pairs_that_share_a_simulation_equal_their_own(surface):
    drone = published(surface)
    cells = [
        Scenario(math.radians(slope), speed) for slope, speed in ((0, 0.5), (10, 0.3), (25, 0.6), (40, 1.2))
    ]
    impulses = Impulses(drone, SMALL)
    found, simulated = impulses.search(cells)
    assert (simulated <= SMALL.combinations + 1).all()  # and the one that idles
    # Level: both feet touch at once, at the first command or, by rounding, 1e-18 s after it.
    assert simulated[0] <= 3
    for c, cell in enumerate(cells):
        delay, duration = (a.ravel() for a in np.meshgrid(SMALL.delays, SMALL.durations, indexing="ij"))
        separate = impulses.second_impacts([cell] * len(delay), delay, duration)
        # Thrust histories agree within 1e-6 before the command that they do not share.
        np.testing.assert_allclose(found[c].reshape(-1, 3), separate, atol=1e-4)


def test_the_best_impulse_stops_the_pitching():
    drone = published()
    cells = [Scenario(math.radians(20.0), 0.4), Scenario(0.0, 1.0), Scenario(math.radians(3.0), 1.5)]
    impulses = Impulses(drone, ImpulseSettings())
    best = impulses.optimize(cells)
    bare = impulses.second_impacts(cells, np.zeros(3), np.zeros(3))
    # 3 rad/s without an impulse, next to nothing with the best one.
    assert abs(bare[0, 1]) > 2.0
    assert abs(best.turn[0]) < 0.5
    assert abs(best.refined_turn[0]) <= max(abs(best.turn[0]), 0.02)
    assert best.delay[0] > 0.0
    # Low and fast: the second impact comes before an impulse could act; reverse at once (section III-C).
    assert best.delay[1] == best.duration[1] == 0.0
    assert best.delay[2] == best.duration[2] == 0.0
    # Where it is asked for, the last few per cent are taken as well.
    all_of_it = Impulses(drone, ImpulseSettings(worth=0.0, finest=0.0)).optimize(cells[2:])
    assert 0.94 * abs(best.turn[2]) < abs(all_of_it.turn[0]) < abs(best.turn[2])
    # If turn rates below 1 rad/s are all the same, the attitude decides.
    level = Impulses(drone, ImpulseSettings(equal=1.0, finest=0.0)).optimize(cells[:1])
    assert abs(level.attitude[0]) <= abs(best.attitude[0])
    assert abs(level.turn[0]) <= 1.0
    again = impulses.second_impacts(cells[:1], best.delay[:1], best.duration[:1])
    assert again[0, 1] == pytest.approx(best.turn[0], abs=1e-9)


def test_ties_go_to_the_attitude_then_to_no_impulse():
    impacts = np.array([[0.1, 0.5, 0.2], [0.1, -0.5, 0.1], [0.1, 0.5, -0.1], [0.1, 0.6, 0.0], [np.nan] * 3])
    delay = np.array([0.0, 0.1, 0.0, 0.0, 0.0])
    duration = np.array([0.1, 0.0, 0.0, 0.0, 0.0])
    assert best_pair(impacts, delay, duration) == 2
    assert best_pair(impacts, delay, duration, equal=0.7) == 3
    assert best_pair(impacts[4:], delay[4:], duration[4:]) == 0


@pytest.mark.parametrize("surface", ["lf", "hf"])
def test_maps_equal_on_one_and_two_threads_and_in_any_order(surface):
    cells = grid(np.radians([2.0, 14.0, 24.0, 36.0]), [0.1, 0.7, 1.4])
    controllers = (find_controller("off"), find_controller("reverse"))
    work = (published(surface),), controllers, MapSettings(check=False)
    for number in range(2):
        rows = np.array([(0.0, number, cell.slope, cell.speed) for cell in cells])
        one, two = (LandingWork(*work, threads=threads)(rows) for threads in (1, 2))
        for a, b, c in zip(one, two, LandingWork(*work)(rows[::-1]), strict=True):
            np.testing.assert_array_equal(a, b)
            np.testing.assert_array_equal(a, c[::-1])


def test_borders_that_physics_fixes():
    """Slow and shut off, steeper is never better; thrust helps; beyond the static limit nothing rests."""
    slopes = np.arange(0, 61, 3)
    for surface in ("lf", "hf"):
        drone = published(surface)
        landed = {}
        for name in ("off", "command:-0.5", "reverse"):
            law = find_controller(name)
            found = land_many(drone, grid(np.radians(slopes), [0.1]), law)
            landed[name] = np.isin(found.outcome, LANDED)
            thrust = Motors(drone).propulsion(law.steps)
            push = -float(thrust.rear(9.0) + thrust.front(9.0))
            limit = rigid_limits(drone.gear, surface, push)
            # Creep at the speed of rest is rest on low friction.
            assert not landed[name][np.radians(slopes) > min(limit.slide, limit.tip)].any(), (surface, name)
        assert (np.diff(landed["off"].astype(int)) <= 0).all(), surface
        assert landed["off"].sum() <= landed["command:-0.5"].sum() <= landed["reverse"].sum()
        assert landed["off"].sum() < landed["reverse"].sum()


def test_events_of_a_landing_tell_the_story():
    run = land(published("hf"), Scenario(math.radians(20.0), 0.4), find_controller("reverse"))
    kinds = [(event.kind, event.foot) for event in run.trajectory.events]
    assert kinds[0] == (EventKind.TOUCHDOWN, "rear")
    assert (EventKind.TOUCHDOWN, "front") in kinds
    assert (EventKind.REST, "body") in kinds
    assert run.outcome in LANDED
    assert run.distance == pytest.approx(run.trajectory.state[-1, 0] / math.cos(math.radians(20.0)), abs=0.03)
