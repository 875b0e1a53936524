"""Controllers as small declared objects; rules of outcomes; how a landing starts."""

import math

import numpy as np
import pytest

from fakes.landings import published
from fakes.published import table_1, table_2
from sysid.errors import CampaignError, ExportError
from sysid.landing.controllers import (
    STANDARD_GRAVITY,
    Controller,
    Sensing,
    Step,
    find_controller,
    load_controllers,
)
from sysid.landing.drone import Drone, drones
from sysid.landing.outcomes import Outcome, Rules
from sysid.landing.settings import MapSettings, Scenario
from sysid.landing.simulate import classes, down_slope, land_many
from sysid.motor.model import simulate as simulate_motor

OWN = """\
from sysid.landing.controllers import Step, controller


@controller("staged")
def staged(pause: float = 0.05) -> list[Step]:
    "Little thrust for a while, then full reverse."
    return [Step(0.0, 0.3, 0.3), Step(pause, -1.0, -1.0)]
"""


def test_the_papers_controllers():
    assert find_controller("off").steps == (Step(0.0, 0.0, 0.0),)
    assert find_controller("reverse").steps == (Step(0.0, -1.0, -1.0),)
    assert find_controller("command:-0.4").steps == (Step(0.0, -0.4, -0.4),)
    assert find_controller("command:u=-40%").steps == (Step(0.0, -0.4, -0.4),)
    impulse = find_controller("impulse:delay=50ms,duration=0.1", ideal_reversal=True)
    # 10 % at impact, 80 % on the front pair, then full reverse (section III-C).
    assert impulse.steps == (Step(0.0, 0.1, 0.1), Step(0.05, 0.1, 0.8), Step(0.05 + 0.1, -1.0, -1.0))
    assert impulse.label == "impulse:delay=50ms,duration=0.1, ideal reversal"


def test_an_impulse_without_length_is_none():
    assert find_controller("impulse:0,0").steps == find_controller("reverse").steps
    assert find_controller("impulse:0.1,0").steps == (Step(0.0, 0.1, 0.1), Step(0.1, -1.0, -1.0))
    assert find_controller("impulse:0,0.1").steps == (Step(0.0, 0.1, 0.8), Step(0.1, -1.0, -1.0))


def test_a_user_adds_a_controller_in_ten_lines(write):
    assert len(OWN.splitlines()) <= 10
    load_controllers(write(OWN, "mine.py"))
    assert find_controller("staged:pause=80ms").steps[1] == Step(0.08, -1.0, -1.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("revers", "known are off, reverse"),
        ("command", "its options are u"),
        ("command:1.5", "expected -1 to 1"),
        ("impulse:delay=5kg,duration=0.1", "expected a unit of that dimension"),
        ("impulse:delay=-0.1,duration=0.2", "in the order of time"),
        ("impulse:delay=50ms,duration=nan", "'nan' is not finite"),
        ("off:1", "its options are none"),
    ],
)
def test_controllers_that_cannot_be_used(text, says):
    with pytest.raises(CampaignError, match=says):
        find_controller(text)


@pytest.mark.parametrize(
    ("made", "values", "says"),
    [
        (Controller, {"name": "wrong", "steps": (Step(0.1, 0.0, 0.0), Step(0.0, 0.0, 0.0))}, "order of time"),
        (Controller, {"name": "empty", "steps": ()}, "order of time"),
        *((Rules, wrong, "landing rules") for wrong in (
            {"horizon": 0.0}, {"rest_speed": -1.0}, {"short": 2.0}, {"flip_angle": math.inf}
        )),
        *((Scenario, {"slope": 0.1, "speed": 0.5} | wrong, "landing") for wrong in (
            {"speed": -0.1}, {"slope": 1.6}, {"pitch": 1.5}, {"pitch_rate": math.nan}
        )),
        (MapSettings, {"slopes_deg": (2.0, 1.0)}, "increasing"),
        (Sensing, {"corner": 600.0}, "half the rate"),
    ],
)  # fmt: skip
def test_settings_that_make_no_sense(made, values, says):
    with pytest.raises(CampaignError, match=says):
        made(**values)


def test_classes_of_fig_8():
    rules = Rules()
    distance = np.array([0.2, -0.2, 0.45, 0.46, 1.0, 1.1, 0.9, 1.1, 0.1, 0.1, 0.3])
    rest = np.array([1, 1, 1, 1, 1, 1, np.nan, np.nan, np.nan, 0.5, 1.5])
    flip = np.array([np.nan] * 6 + [0.5, 0.5, np.nan, 1.0, 1.0])
    lost = np.zeros(11, dtype=bool)
    codes = classes(rules, distance, rest, flip, lost)
    expected = "SHORT SHORT SHORT NEAR NEAR OTHER FLIPPED OTHER OTHER SHORT FLIPPED"
    assert " ".join(Outcome(code).name for code in codes) == expected
    assert classes(rules, distance, rest, flip, ~lost).tolist() == [Outcome.LOST] * 11
    wider = classes(Rules(short=0.1, long=2.0), distance, rest, flip, lost)
    assert [Outcome(code).name for code in wider[:6]] == ["NEAR"] * 6


@pytest.mark.parametrize(("slope", "pitch"), [(0.0, 0.0), (0.3, 0.0), (0.2, 0.5), (0.3, -0.1)])
def test_the_lowest_foot_touches_and_the_other_does_not_sink(slope, pitch):
    x, z, q = published().start(Scenario(slope, 0.5, pitch=pitch))[:3]
    gaps = []
    for side in (-0.105, 0.105):
        foot = np.array(
            [x + side * math.cos(q) - 0.151 * math.sin(q), z - side * math.sin(q) - 0.151 * math.cos(q)]
        )
        gaps.append(foot @ [math.sin(slope), math.cos(slope)])
    # Rounding of numbers near 0.2 m.
    assert min(gaps) == pytest.approx(0.0, abs=1e-15)
    assert (np.argmin(gaps) == 0) == (slope >= pitch)


def test_distance_is_along_the_slope():
    down = np.array([[math.cos(0.3), -math.sin(0.3)], [math.sin(0.3), math.cos(0.3)]])
    np.testing.assert_allclose(down_slope(down, 0.3), [1.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("surface", ["lf", "hf"])
def test_the_hover_command_carries_the_weight(surface):
    drone = published(surface)
    run = simulate_motor(drone.motor, [0.0], [drone.hover_command], [0.0, 1.0], initial="steady")
    assert 4 * run.thrust == pytest.approx([drone.weight] * 2, rel=1e-6)  # the motor's own tolerance
    legs = 2 * drone.gear["leg_mass"]
    assert drone.weight == pytest.approx((1.242 + legs) * 9.81)


def test_a_drone_too_heavy_for_its_motors():
    heavy = Drone({"body_mass": 8.0}, {}, "lf", "heavy")
    with pytest.raises(ExportError, match="heavy: hovering at 78"):
        heavy.hover_command  # noqa: B018


def test_a_step_after_the_simulated_time_is_refused():
    with pytest.raises(CampaignError, match="a step at 50 s"):
        land_many(published(), [Scenario(0.1, 0.3)], find_controller("impulse:50,100"))


def test_sets_pair_one_by_one_or_with_the_best():
    gear, motor = table_2("lf"), table_1()
    assert len(drones(gear, motor, "each")) == 1
    with pytest.raises(ExportError, match="expected gear sets"):
        drones(motor, motor)
    with pytest.raises(ExportError, match="expected motor sets"):
        drones(gear, gear)


def test_an_accelerometer_sees_a_step_after_the_filters_delay():
    sensing = Sensing()
    quiet = np.tile([0.0, STANDARD_GRAVITY], (100, 1))
    assert math.isnan(sensing.trigger(quiet))
    hit = quiet.copy()
    hit[50:, 1] = 10 * STANDARD_GRAVITY
    seen = sensing.trigger(hit)
    # A third-order Butterworth of 30 Hz has passed (2 - 1)/9 of a step after 4 to 6 ms.
    assert 0.053 <= seen <= 0.057
    # A single sample of 5 g is no impact: its filtered peak stays below 2 g.
    spike = quiet.copy()
    spike[50, 1] = 5 * STANDARD_GRAVITY
    assert math.isnan(sensing.trigger(spike))
