"""Values that a campaign states with their errors: what is read, refused, assumed, and taken as exact."""

import copy
import json
import math
import pickle
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.places import SAMPLES
from sysid.campaign import read_campaign
from sysid.campaign.common import ParameterChoices
from sysid.errors import CampaignError, UnitError
from sysid.gear.model import PARAMETERS
from sysid.gear.problem import measured_values
from sysid.stated import Stated, error_of, parse_stated
from sysid.units import parse_quantity
from sysid.workflows.kinds import open_campaign

GEAR, MOTOR = (SAMPLES / name / "campaign.toml" for name in ("gear-lf", "motor"))
DEG = math.pi / 180.0


@pytest.fixture
def stating(tmp_path):
    """Return a sample campaign in which the values of some keys are written in another way."""

    def written(sample=GEAR, more="", **texts):
        text = sample.read_text(encoding="utf-8")
        for key, value in texts.items():
            text, count = re.subn(rf"(?m)^{key} = [^#\n]*", f"{key} = {value} ", text)
            assert count
        path = tmp_path / "campaign.toml"
        path.write_text(text + more, encoding="utf-8")
        return path

    return written


@pytest.mark.parametrize(("text", "unit", "value", "error"), [
    ("0.0137 ± 0.0003 kg·m²", "kg·m²", 0.0137, 0.0003),
    ("20 ± 0.2 deg", "rad", 20 * DEG, 0.2 * DEG),
    ("1.242 kg ± 2 g", "kg", 1.242, 0.002),
    ("1242+-2g", "kg", 1.242, 0.002),
    ("1.242 +/- 0.002 kg", "kg", 1.242, 0.002),
    ("-22 ± 1 mm", "m", -0.022, 0.001),
    ("-22 mm ± 5 %", "m", -0.022, 0.0011),
    ("0.0137 kg·m² ± 3%", "kg·m²", 0.0137, 0.0137 * 0.03),
    ("0.44 ± 0.02", "1", 0.44, 0.02),
    ("920 ± 20 rpm/V", "rad/s/V", 920 * math.pi / 30, 20 * math.pi / 30),
    # Revolutions that the unit leaves out count in the error as in the value.
    ("5000 1/min ± 30 rpm", "rad/s", 5000 * math.pi / 30, math.pi),
    ("1.242 kg exact", "kg", 1.242, 0.0),
    ("0.44 exact", "1", 0.44, 0.0),
    ("1.242 kg ± 0", "kg", 1.242, 0.0),
    ("1.242 kg", "kg", 1.242, None),
])  # fmt: skip
def test_a_value_and_its_error_are_read(text, unit, value, error):
    found = parse_stated(text, unit)
    assert found[0] == pytest.approx(value, rel=1e-14)
    assert found[1] == (None if error is None else pytest.approx(error, rel=1e-12))


@given(
    st.floats(-1e6, 1e6).filter(lambda number: abs(number) > 1e-6),
    st.floats(1e-9, 1e6),
    st.sampled_from(["±", "+-", "+/-"]),
    st.sampled_from(["", " "]),
    st.sampled_from([("kg·m²", "g·mm²"), ("m", "mm"), ("rad", "deg"), ("1", "")]),
    st.sampled_from(["both", "each", "share"]),
)
def test_every_way_to_write_an_error_means_the_same(value, error, sign, gap, units, way):
    expected, unit = units
    behind = f"{value!r} {unit}" if way != "both" and unit else repr(value)
    size = f"{error!r} %" if way == "share" else f"{error!r} {unit}"
    found = parse_stated(f"{behind}{gap}{sign}{gap}{size}", expected)
    assert found[0] == parse_quantity(f"{value!r} {unit}", expected)
    if way == "share":
        assert found[1] == pytest.approx(abs(found[0]) * error / 100, rel=1e-12)
    else:
        assert found[1] == parse_quantity(f"{error!r} {unit}", expected)


@pytest.mark.parametrize(("text", "unit", "words"), [
    ("20 ± -0.2 deg", "rad", "the error in '20 ± -0.2 deg' is negative; write its size"),
    ("20 deg ± -3 %", "rad", "is negative"),
    ("1.242 kg ± 2 mm", "kg", "the error in '1.242 kg ± 2 mm': unit 'mm' is not a 'kg'"),
    ("1.242 kg ± 0.002", "kg", "'0.002' has no unit; expected for example '0.002 kg'"),
    ("1.242 ± 0.002", "kg", "'1.242' has no unit; expected for example '1.242 kg'"),
    ("1.242 kg ± little", "kg", "'little' is not a number with a unit"),
    ("1.242 kg ±", "kg", "'' is not a number with a unit"),
    ("± 2 g", "kg", "'' is not a number with a unit"),
    ("1.242 kg ± 1 ± 2 g", "kg", "'1.242 kg ± 1 ± 2 g' states two errors"),
    ("1.242 kg ± 1 g exact", "kg", "'1.242 kg ± 1 g exact' states two errors"),
    # A comma is no point, and no zero.
    ("1.242 kg ± 0,002 kg", "kg", "the error in '1.242 kg ± 0,002 kg': '0,002 kg' has a comma"),
    ("1.242 kg ± 0 mm", "kg", "unit 'mm' is not a 'kg'"),
    ("1.242 kg ± 1e999 g", "kg", "is not finite; write one standard deviation"),
    # A share of nothing, and a share that might be one of the value or one of 1.
    ("0 mm ± 3 %", "m", "is no share of a value; write a share as '2.5 m ± 3 %'"),
    ("50 % ± 3 %", "1", "is no share of a value; write a share as '2.5 ± 3 %'"),
    ("1.242 kg ± 3 % kg", "kg", "is no share of a value"),
])  # fmt: skip
def test_what_is_no_error_is_refused(text, unit, words):
    with pytest.raises(UnitError, match=re.escape(words)):
        parse_stated(text, unit)


def test_a_stated_value_is_a_float_that_keeps_its_error():
    mass = Stated(1.242, 0.002, "2 g")
    for copied in (pickle.loads(pickle.dumps(mass)), copy.copy(mass), copy.deepcopy([mass])[0]):
        assert (copied, copied.error, copied.assumed) == (1.242, 0.002, "2 g")
    assert {1.242: "found"}[mass] == "found"
    assert (repr(mass), f"{mass:.2f}", json.dumps(mass)) == ("1.242", "1.24", "1.242")
    assert type(mass + 1.0) is type(2 * mass) is type(-mass) is float
    assert (error_of(mass), error_of(1.242), error_of(mass + 1.0)) == (0.002, 0.0, 0.0)


def test_values_without_an_error_get_the_one_of_their_measurement():
    gear, motor = read_campaign(GEAR), read_campaign(MOTOR)
    vehicle, rated = gear.vehicle, motor.motor
    typical = {
        vehicle.body_mass: 1e-3, vehicle.body_inertia: 0.03 * 0.0137, vehicle.foot_dx: 1e-3,
        vehicle.foot_dz: 1e-3, vehicle.leg_mass: 1e-3, vehicle.leg_inertia: 0.1 * 2e-4,
        gear.surface.kinetic_friction: 0.03 * 0.44,
        rated.kv: 0.02 * rated.kv, rated.rotor_inertia: 0.05 * rated.rotor_inertia,
        rated.reference_voltage: 0.005 * rated.reference_voltage,
        **{trial.slope: 0.2 * DEG for trial in gear.trials},
        **dict.fromkeys((*gear.surface.point, *gear.capture.centre_of_mass_offset), 1e-3),
    }  # fmt: skip
    for value, error in typical.items():
        assert error_of(value) == pytest.approx(error, rel=1e-12)
        assert value.assumed
    # Nobody measures these in the course of drops.
    for value in (vehicle.gravity, vehicle.leg_mass_fraction, vehicle.thrust_point_dx):
        assert error_of(value) == 0.0
    # What a fit reads of the campaign keeps the errors; a table of it is plain.
    assert error_of(measured_values(gear)["body_mass"]) == 1e-3
    assert '"body_mass":1.242,' in gear.vehicle.model_dump_json()


def test_a_left_out_offset_is_zero_as_well_as_one_measures_it(stating):
    path = stating()
    text = re.sub(r"(?m)^centre_of_mass_offset.*\n", "", path.read_text(encoding="utf-8"))
    path.write_text(text, encoding="utf-8")
    offset = read_campaign(path).capture.centre_of_mass_offset
    assert [(value, value.error, value.assumed) for value in offset] == [(0.0, 1e-3, "1 mm")] * 3


def test_stated_errors_win_element_by_element(stating):
    path = stating(
        body_mass='"1.242 kg ± 2 g"', body_inertia='"0.0137 kg·m² exact"', gravity='"9.81 ± 0.001 m/s²"',
        leg_mass_fraction='"0.5 ± 0.05"', kinetic_friction='"0.44 ± 0.02"',
        point='["364 mm", "430.5 ± 0.2 mm", "-812.5 mm ± 2 mm"]', slope='"5 ± 0.05 deg"',
    )  # fmt: skip
    campaign = read_campaign(path)
    vehicle, surface = campaign.vehicle, campaign.surface
    measured = (
        vehicle.body_mass, vehicle.body_inertia, vehicle.gravity, vehicle.leg_mass_fraction,
        surface.kinetic_friction, *surface.point, campaign.trials[0].slope,
    )  # fmt: skip
    assert [error_of(value) for value in measured] == pytest.approx(
        [2e-3, 0.0, 1e-3, 0.05, 0.02, 1e-3, 2e-4, 2e-3, 0.05 * DEG], rel=1e-12
    )
    assert [value.assumed for value in measured] == [""] * 5 + ["1 mm"] + [""] * 3
    # The numbers themselves are those of the sample.
    assert (vehicle.body_mass, surface.point) == (1.242, read_campaign(GEAR).surface.point)
    assert read_campaign(stating(MOTOR, kv='"920 ± 10 rpm/V"')).motor.kv.error == pytest.approx(math.pi / 3)


@pytest.mark.parametrize(("key", "text", "words"), [
    ("body_mass", '"1.242 kg ± -2 g"', "vehicle.body_mass: the error in '1.242 kg ± -2 g' is negative"),
    ("body_mass", '"1.242 ± 2 kg"', "vehicle.body_mass: the error in '1.242 ± 2 kg' is larger than"),
    ("leg_mass_fraction", '"0.5 ± 0.6"', "vehicle.leg_mass_fraction: the error in '0.5 ± 0.6' is larger"),
    ("leg_mass", '"20 ± 25 g"', "vehicle.leg_mass: the error in '20 ± 25 g' is larger"),
    ("kinetic_friction", '"0.44 ± 120 %"', "surface.kinetic_friction: the error in '0.44 ± 120 %' is larger"),
    ("foot_dx", '"105 mm ± 1 g"', "vehicle.foot_dx: the error in '105 mm ± 1 g': unit 'g' is not a 'm'"),
    ("point", '["0 m", "0 m ± 1 deg", "0 m"]', "surface.point[2]: the error in '0 m ± 1 deg': unit 'deg'"),
    ("slope", '"5 ± 0.2 mm"', "trials['drop-1'].slope: "),
    ("slope", '"5 ± 11 deg"', "trials['drop-1'].slope: the error in '5 ± 11 deg' is beyond 5 deg"),
    ("point", '["0 m", "0 ± 9 m", "0 m"]', "surface.point[2]: the error in '0 ± 9 m' is beyond 10 cm"),
    ("body_mass", '"-1.242 kg ± 2 g"', "vehicle.body_mass: expected more than 0"),
    ("thrust_point_dx", '"159 ± 1 mm"', "vehicle.thrust_point_dx: '159 ± 1 mm' states an error"),
    ("slip_regularization", '"0.01 ± 0.001 m/s"', "surface.slip_regularization: '0.01 ± 0.001 m/s' states"),
    ("board_length", '"1.2 m ± 1 cm"', "surface.board_length: '1.2 m ± 1 cm' states an error"),
    ("runs", '"5 ± 1"', "fit.runs: expected a whole number, found '5 ± 1'"),
    ("up", '"+y ± 2 deg"', "capture.up: "),
    ("use", '"fit ± 1"', "trials['drop-1'].use: "),
    ("name", '"lf ± 1"', "name: expected letters, digits"),
])  # fmt: skip
def test_an_error_that_cannot_be_is_refused_with_its_key(key, text, words, stating):
    path = stating(**{key: text})
    with pytest.raises(CampaignError) as refusal:
        read_campaign(path)
    assert str(refusal.value).startswith(f"{path}: {words}")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(("table", "words"), [
    ("[window]\nbefore_contact = '50 ms ± 1 ms'", "window.before_contact: '50 ms ± 1 ms' states an error"),
    ("[filter]\ncutoff = '65 ± 1 Hz'", "filter.cutoff: '65 ± 1 Hz' states an error"),
    ("[filter]\nattenuation_db = '60 ± 1'", "filter.attenuation_db: expected a number, found '60 ± 1'"),
])  # fmt: skip
def test_what_is_chosen_has_no_error(table, words, stating):
    path = stating(more=f"\n{table}\n")
    with pytest.raises(CampaignError) as refusal:
        read_campaign(path)
    assert str(refusal.value).startswith(f"{path}: {words}")


def test_fixed_values_may_state_an_error_and_ranges_may_not():
    fixed = ParameterChoices(fixed={"ground_damping": "0.04 ± 0.01 N·s/m", "gravity": "9.81 m/s²"})
    values = fixed.fixed_values(PARAMETERS)
    assert [(values[name], error_of(values[name])) for name in fixed.fixed] == [(0.04, 0.01), (9.81, 0.0)]
    assert fixed.search_space(PARAMETERS, ("joint_dx",), {}).fixed["ground_damping"] == 0.04
    for choices, words in (
        (
            {"fixed": {"ground_damping": "0.04 ± 0.05 N·s/m"}},
            "parameters.fixed.ground_damping: the error in ",
        ),
        (
            {"fixed": {"ground_damping": "0.04 N·s/m ± 1 kg"}},
            "parameters.fixed.ground_damping: the error in ",
        ),
        (
            {"bounds": {"joint_dx": ("80 ± 1 mm", "90 mm")}},
            "parameters.bounds.joint_dx: '80 ± 1 mm' states an",
        ),
        (
            {"measured": {"joint_dx": ("80 mm", "90 ± 1 mm")}},
            "parameters.measured.joint_dx: '90 ± 1 mm' states",
        ),
    ):
        with pytest.raises(CampaignError) as refusal:
            ParameterChoices(**choices).search_space(PARAMETERS, ("joint_dx",), {})
        assert str(refusal.value).startswith(words)


def errors(part):
    """Return every error in a part of a campaign."""
    if isinstance(part, Stated):
        return [part.error]
    inner = (
        part
        if isinstance(part, tuple)
        else [value for _, value in part]
        if hasattr(part, "model_copy")
        else ()
    )
    return [error for one in inner for error in errors(one)]


def test_an_exact_campaign_has_the_same_numbers_without_errors(stating):
    fixed = "\n[parameters.fixed]\nground_damping = '0.04 ± 0.01 N·s/m'\n"
    path = stating(body_mass='"1.242 ± 0.002 kg"', more=fixed)
    as_stated, exact = (open_campaign(path, law=law)[1] for law in ({}, {"exact": True}))
    assert sum(errors(as_stated)) > 0.0
    assert len(errors(exact)) == len(errors(as_stated)) > 20
    assert not any(errors(exact))
    assert exact.parameters.fixed == {"ground_damping": "0.04 N·s/m"}
    assert exact.fit.exact
    assert exact.source == as_stated.source
    # What the campaign leaves out is not stated by it now.
    assert measured_values(exact) == measured_values(as_stated)
    assert "gravity" not in measured_values(open_campaign(_without_gravity(path), law={"exact": True})[1])
    # The file may ask for it, and another law keeps it.
    text = path.read_text(encoding="utf-8").replace("runs = 5", "runs = 5\nexact = true")
    path.write_text(text, encoding="utf-8")
    for law in ({}, {"surface": "hf"}):
        assert not any(errors(open_campaign(path, law=law)[1]))
    assert any(errors(open_campaign(path, "gear", {"surface": "lf", "exact": False})[1]))


def _without_gravity(path: Path) -> Path:
    text = re.sub(r"(?m)^gravity.*\n", "", path.read_text(encoding="utf-8"))
    path.write_text(text, encoding="utf-8")
    return path
