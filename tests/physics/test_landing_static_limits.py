"""Static limits: closed forms, the paper's numbers, and legs that bend against statics written out anew."""

import json
import math

import pytest
from scipy.optimize import brentq

from fakes.landings import values
from fakes.published import table_2
from fakes.standing import tips_under_thrust, tips_without_thrust
from sysid.errors import CampaignError
from sysid.landing.static_limits import StaticLimit, rigid_limits, set_down_limit, slide_limit, tip_limit

REVERSE = 12.0


def deg(angle):
    return math.degrees(angle)


LF, HF = values("lf"), values("hf")


def test_closed_forms_are_the_paper_s_numbers():
    # Massless legs: atan mu_k and atan(dx_f/dz_f); the paper prints 22 and 35 deg.
    light = {"leg_mass": 1e-9}
    assert deg(rigid_limits(LF | light, "lf").slide) == pytest.approx(deg(math.atan(0.44)), abs=1e-9)
    assert deg(rigid_limits(HF | light, "hf").tip) == pytest.approx(deg(math.atan(105 / 151)), abs=1e-5)
    # With 12 N of reverse thrust the paper prints 48 and 67 deg; 2 deg is what its rounding of mu_k and of
    # the thrust leaves open.
    found = rigid_limits(LF, "lf", REVERSE), rigid_limits(HF, "hf", REVERSE)
    assert deg(found[0].slide) == pytest.approx(48.0, abs=2.0)
    assert deg(found[1].tip) == pytest.approx(67.0, abs=2.0)
    assert deg(rigid_limits(LF, "lf").slide) == pytest.approx(22.0, abs=2.0)
    assert deg(rigid_limits(HF, "hf").tip) == pytest.approx(35.0, abs=2.0)
    assert [one.first.how for one in found] == ["slides", "tips"]


@pytest.mark.parametrize("thrust", [-4.0, 0.0, 5.0, REVERSE])
def test_closed_forms_balance_forces_and_moments(thrust):
    p = values("hf", front_leg_mass_ratio=1.8, leg_mass_fraction=0.3)
    bodies = [(p["body_mass"], 0.0, 0.0)]
    for side, ratio in ((-1, 1.0), (1, 1.8)):
        x = p["foot_dx"] + 0.3 * (p["joint_dx"] - p["foot_dx"])
        z = p["foot_dz"] + 0.3 * (p["joint_dz"] - p["foot_dz"])
        bodies.append((ratio * p["leg_mass"], side * x, -z))

    def moment(slope):
        """Of weight and thrust about the front feet, positive turns the drone over [N·m]."""
        total = thrust * -p["foot_dx"]
        for mass, x, z in bodies:
            along, normal = mass * p["gravity"] * math.sin(slope), mass * p["gravity"] * math.cos(slope)
            total += along * (z + p["foot_dz"]) - normal * (p["foot_dx"] - x)
        return total

    def slip(slope):
        weight = sum(mass for mass, _, _ in bodies) * p["gravity"]
        return weight * math.sin(slope) - 0.95 * (weight * math.cos(slope) + thrust)

    found = rigid_limits(p, "hf", thrust)
    assert found.tip == pytest.approx(brentq(moment, 0, 1.57), abs=1e-9)
    assert found.slide == pytest.approx(brentq(slip, 0, 1.57), abs=1e-9)


def test_limits_of_the_closed_forms():
    assert slide_limit(0.0) == 0.0
    assert slide_limit(0.5, -1.5) == 0.0
    assert slide_limit(1.0, 10.0) == tip_limit(0.1, 0.1, 10.0) == math.pi / 2
    assert rigid_limits(LF, "lf", 1e3).first == StaticLimit(math.pi / 2, "stays")
    assert slide_limit(0.44, 1e-9) == pytest.approx(math.atan(0.44), abs=1e-9)
    # The law (8) creeps at eps_v r/(1 - r), r = tan(slope)/mu.
    creep = rigid_limits(LF, "lf").creep
    r = math.tan(creep) / 0.44
    assert 0.01 * r / (1 - r) == pytest.approx(0.05, rel=1e-9)
    assert rigid_limits(HF, "hf").creep == rigid_limits(HF, "hf").slide
    with pytest.raises(CampaignError, match="lift"):
        rigid_limits(LF, "lf", -13.0)


def test_bending_legs_tip_before_rigid_ones():
    # Bending costs more than six degrees of the rigid 35; earlier studies of this set found 28 to 29.
    assert 28.0 < deg(tips_without_thrust(HF)) < 29.0
    # Pressed on by thrust the drone goes over as soon as the rear feet slip, so friction decides as well.
    assert deg(tips_under_thrust(HF, REVERSE)) == pytest.approx(44.8, abs=0.15)
    assert deg(tips_under_thrust(HF | {"kinetic_friction": 1.1}, REVERSE)) > 45.8


@pytest.mark.parametrize(
    ("thrust", "about", "balance"),
    [(0.0, 25.5, tips_without_thrust(HF)), (REVERSE, 39.5, tips_under_thrust(HF, REVERSE))],
)
def test_set_down_at_once_the_drone_tips_earlier(thrust, about, balance):
    """An independent study of these legs gave about 38 deg under 12 N, less than any equilibrium leaves."""
    found = set_down_limit(HF, "hf", thrust)
    assert found.how == "tips"
    # Judged every half degree.
    assert deg(found.slope) == pytest.approx(about, abs=0.5)
    # It swings through the equilibrium, so what it lacks goes with the swing: dampers that are critical give
    # back at least half of it (all and two degrees more under thrust, for the feet slide into better places).
    mass, inertia = (
        0.5 * HF["body_mass"],
        0.5 * HF["body_inertia"] + 0.5 * HF["body_mass"] * HF["foot_dz"] ** 2,
    )
    dampers = {
        "leg_axial_damping": math.sqrt(HF["leg_axial_stiffness"] * mass),
        "leg_bending_damping": math.sqrt(HF["leg_bending_stiffness"] * inertia),
        # Critical for the foot alone, which bounces on the ground without the body.
        "ground_damping": math.sqrt(HF["ground_stiffness"] * HF["leg_mass"]),
    }
    damped = set_down_limit(
        HF | {name: max(HF[name], value) for name, value in dampers.items()}, "hf", thrust
    )
    assert damped.slope > 0.5 * (found.slope + balance)


def test_a_drone_that_does_not_stand_on_level_ground_is_refused():
    with pytest.raises(CampaignError, match="does not stand on level ground"):
        set_down_limit(HF | {"leg_axial_stiffness": 1.0}, "hf")


def test_a_creeping_drone_set_down_rests_up_to_the_creep_limit():
    # LF: it rests while it creeps slower than 0.05 m/s, which is what `creep` says; half-degree steps.
    found = set_down_limit(LF, "lf")
    assert found.how == "slides"
    assert deg(found.slope) == pytest.approx(deg(rigid_limits(LF, "lf").creep), abs=0.5)


def test_stiffer_legs_and_wider_feet_hold_better():
    def limit(**factors):
        return set_down_limit(HF | {name: HF[name] * f for name, f in factors.items()}, "hf").slope

    rigid = rigid_limits(HF, "hf").tip
    bends = [limit(leg_bending_stiffness=f) for f in (0.7, 1.0, 2.0, 6.0)]
    assert sorted(bends) == bends
    assert bends[-1] < rigid
    assert limit(foot_dx=1.2) > bends[1] + math.radians(3)


def test_command(run, tmp_path):
    from sysid.export import export

    file = export(table_2("hf"), tmp_path / "hf.json")
    code, out, err = run("static-limits", file, "--thrust", "0", "--json")
    assert code == 0, err
    (row,) = json.loads(out)["limits"]
    assert row["rigid_tip_deg"] == pytest.approx(35.17, abs=0.01)
    assert row["set_down_deg"] == pytest.approx(25.5, abs=0.5)
    assert row["set_down_how"] == "tips"
    code, _, err = run("static-limits", file, "--thrust", "-20")
    assert code == 2
    assert "lift" in err
