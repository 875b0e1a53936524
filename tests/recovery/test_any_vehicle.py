"""Vehicles and motors of other sizes than the paper's, recovered between default bounds."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fakes.gear_campaigns import opened, score_values, used
from sysid.gear.model import PARAMETERS as GEAR
from sysid.gear.model import parameters_on
from sysid.motor.parameters import PARAMETERS as MOTOR
from sysid.motor.parameters import kv_to_si, parameters_of
from sysid.synthetic import synthesize_gear, synthesize_motor
from sysid.synthetic.gear import HF_DROPS, LF_DROPS
from sysid.workflows.fit import fit_gear, fit_motor
from sysid.workflows.options import FitOptions

# Mass [kg], feet [m] and pitch inertia [kg·m²].
VEHICLES = {
    "Table II": (1.242, 0.105, 0.151, 0.0137),
    "quarter of a kilogram": (0.25, 0.055, 0.060, 4.2e-4),
    "two and a half kilograms": (2.5, 0.15, 0.20, 0.052),
    "twelve kilograms": (12.0, 0.24, 0.35, 0.73),
}
SPRUNG = (
    "leg_axial_stiffness", "leg_axial_damping", "leg_bending_stiffness", "leg_bending_damping",
    "ground_stiffness",
)  # fmt: skip
# Kv [rpm/V], supply [V], inertia of rotor and propeller [kg·m²], R [Ω], torque and thrust over Ω².
MOTORS = {
    "heavy lifter": (100.0, 48.0, 1.2e-2, 0.06, 5e-5, 2.4e-3),
    "survey drone": (400.0, 22.2, 3.5e-4, 0.09, 1.5e-6, 1e-4),
    "racer": (2000.0, 14.8, 4.5e-6, 0.045, 1.8e-8, 1.4e-6),
}


def options(folder):
    return FitOptions(out=folder / "fit", quiet=True, trust=False, runs=1)


def test_the_papers_vehicle_and_motor_have_the_tables_bounds():
    for law in ("lf", "hf"):
        named = ("body_mass", "foot_dx", "foot_dz", "gravity")
        known = {name: GEAR[name].nominal for name in named}
        assert parameters_on(law, known) == parameters_on(law)
    assert parameters_of({}) == dict(MOTOR)
    # A scale's error in the mass leaves them as well.
    near = parameters_on("lf", {"body_mass": 1.2425})
    assert {name: (row.lower, row.upper) for name, row in near.items()} == {
        name: (row.lower, row.upper) for name, row in GEAR.items()
    }


def test_bounds_scale_as_the_equations_do():
    # The same motion: all masses doubled.
    twice = parameters_on("lf", {"body_mass": 2 * 1.242})
    for name in (*SPRUNG, "ground_damping", "leg_mass", "leg_inertia"):
        assert (twice[name].lower, twice[name].upper) == pytest.approx(
            (2 * GEAR[name].lower, 2 * GEAR[name].upper)
        )
        assert twice[name].nominal == pytest.approx(2 * GEAR[name].nominal)
    assert (twice["joint_dx"].lower, twice["joint_dx"].upper) == (0.04, 0.1)
    # Four times as long, eight times as heavy: twice the time of fall.
    large = parameters_on("lf", {"body_mass": 8 * 1.242, "foot_dx": 4 * 0.105, "foot_dz": 4 * 0.151})
    assert large["leg_axial_stiffness"].upper == pytest.approx(2 * 12000)
    assert large["leg_axial_damping"].upper == pytest.approx(4 * 40)
    assert large["leg_bending_stiffness"].upper == pytest.approx(32 * 25)
    assert large["kinetic_friction"] == replace(
        GEAR["kinetic_friction"], source=large["kinetic_friction"].source
    )
    # 40 mΩ of a racing motor lie within its bounds.
    k = kv_to_si(2400)
    known = {"back_emf_constant": k, "torque_constant": k, "reference_voltage": 16.0}
    racer = parameters_of({**known, "torque_quadratic_forward": 2.2e-8})["winding_resistance"]
    assert racer.lower < 0.5 * 0.04 < 0.04 < racer.upper


@pytest.mark.slow
@pytest.mark.parametrize("law", ["lf", "hf"])
@pytest.mark.parametrize("vehicle", VEHICLES)
def test_a_vehicle_of_any_size_is_recovered(vehicle, law, tmp_path):
    size = dict(zip(("body_mass", "foot_dx", "foot_dz", "body_inertia"), VEHICLES[vehicle], strict=True))
    true = {**parameters_on(law, size).nominal, **size}
    # No multiple of the paper's gear.
    random = np.random.default_rng(7)
    true |= {name: true[name] * math.exp(random.uniform(-0.4, 0.4)) for name in SPRUNG}
    feet = math.sqrt(size["foot_dx"] * size["foot_dz"] / (0.105 * 0.151))
    drops = [
        replace(d, impact_speed=d.impact_speed * math.sqrt(feet))
        for d in (HF_DROPS if law == "hf" else LF_DROPS)
    ]
    folder = synthesize_gear(tmp_path / "drops", seed=7, surface=law, drops=drops, parameters=true)
    fit, _ = fit_gear(folder / "campaign.toml", options(folder))
    sets = fit.parameter_sets()
    campaign, prepared, truth = opened(folder)
    assert fit.nrmse[0] <= 1.002 * float(score_values(campaign, used(prepared), truth).cost[0])
    # A capture's noise is three times as large beside the small one.
    loose = 3.0 if vehicle.startswith("quarter") else 1.0
    for name, error in {"joint_dx": 0.01, "leg_axial_stiffness": 0.03, "leg_bending_stiffness": 0.03}.items():
        assert sets.set_values(1)[name] == pytest.approx(true[name], rel=loose * error), name
    ends = {row.name for row, side in zip(fit.parameters, fit.at_bound.T, strict=True) if side.any()}
    assert ends <= {"ground_damping", "static_friction_excess"}


@pytest.mark.slow
@pytest.mark.parametrize("motor", MOTORS)
def test_a_motor_of_any_size_is_recovered(motor, tmp_path):
    kv, volts, inertia, resistance, torque, thrust = MOTORS[motor]
    k = kv_to_si(kv)
    true = {
        "winding_resistance": resistance, "winding_inductance": 0.008 * resistance,
        "viscous_damping": 0.056 * torque, "back_emf_constant": k, "torque_constant": k,
        "rotor_inertia": inertia,
        "saturation_current": 0.005 * volts / resistance, "saturation_speed": 0.006 * volts / k,
        "reference_voltage": volts, "no_load_slope_forward": 0.95 * volts / k,
        "no_load_slope_reverse": 0.95 * volts / k, "thrust_quadratic_forward": thrust,
        "thrust_quadratic_reverse": 0.5 * thrust, "torque_quadratic_forward": torque,
        "torque_quadratic_reverse": 1.03 * torque,
    }  # fmt: skip
    folder = synthesize_motor(tmp_path / "stand", seed=1, parameters=true)
    fit, _ = fit_motor(folder / "campaign.toml", options(folder))
    found = fit.parameter_sets().set_values(1)
    assert found["winding_resistance"] == pytest.approx(resistance, rel=0.005)
    assert found["winding_inductance"] == pytest.approx(0.008 * resistance, rel=0.01)
