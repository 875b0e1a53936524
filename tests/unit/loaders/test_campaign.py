"""Campaign files: templates are complete and valid; every mistake is one sentence that names the place."""

import re
from importlib import resources

import numpy as np
import pytest

from sysid.campaign import GearCampaign, MotorCampaign, read_campaign
from sysid.campaign.file import resolve_log
from sysid.errors import CampaignError
from sysid.parameters import Parameter, ParameterTable
from sysid.stated import Stated, error_of

# What is measured, by line of a template.
MEASURED = {
    "body_mass": "1.242 kg", "body_inertia": "0.0137 kg·m²", "foot_dx": "105 mm", "foot_dz": "151 mm",
    "thrust_point_dx": "159 mm", "leg_mass": "0.02 kg", "leg_inertia": "2.0e-4 kg·m²",
    "kinetic_friction": "0.44", "law": "lf", "kv": "960 rpm/V", "rotor_inertia": "2.7e-5 kg·m²",
    "reference_voltage": "11.1 V",
}  # fmt: skip
PLAIN = {
    kind: resources.files("sysid").joinpath("templates", f"{kind}.toml").read_text(encoding="utf-8")
    for kind in ("gear", "motor")
}


def measured(text):
    """Return a campaign whose placeholders are filled in."""
    for key, value in MEASURED.items():
        text = re.sub(rf'(?m)^{key} = "TODO[^"±]*', f'{key} = "{value}', text)
    return re.sub("TODO( m+)? ", "0 m ", text)


WITH_ERRORS = {kind: measured(text) for kind, text in PLAIN.items()}
TEMPLATES = {kind: re.sub(r'(?m)(?<=\S) *±[^"\n]*(?=")', "", text) for kind, text in WITH_ERRORS.items()}


def _write(tmp_path, text):
    path = tmp_path / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(("kind", "model"), [("gear", GearCampaign), ("motor", MotorCampaign)])
def test_template_shows_every_key_of_the_schema(kind, model):
    schema = model.model_json_schema()
    tables = [schema, *schema["$defs"].values()]
    assert not [key for table in tables for key in table["properties"] if key not in TEMPLATES[kind]]


def test_templates_are_valid_and_their_quantities_become_si(tmp_path):
    gear = read_campaign(_write(tmp_path, TEMPLATES["gear"]), "gear")
    assert isinstance(gear, GearCampaign)
    assert gear.vehicle.foot_dx == pytest.approx(0.105)
    assert gear.trials[0].slope == pytest.approx(0.2617993878)
    assert gear.window.before_contact == pytest.approx(0.05)
    motor = read_campaign(_write(tmp_path, TEMPLATES["motor"]), "motor")
    assert isinstance(motor, MotorCampaign)
    assert motor.motor.kv == pytest.approx(100.53, rel=1e-4)  # 960 rpm/V


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("gear", ["vehicle.body_mass", "vehicle.leg_inertia", "surface.kinetic_friction", "surface.point"]),
        ("motor", ["motor.kv", "motor.rotor_inertia", "motor.reference_voltage"]),
    ],
)
def test_what_the_user_must_measure_is_refused_until_it_is_filled_in(kind, words, tmp_path):
    """No number of another drone survives in a new campaign."""
    with pytest.raises(CampaignError, match="still TODO: ") as refusal:
        read_campaign(_write(tmp_path, PLAIN[kind]), kind)
    for word in words:
        assert word in str(refusal.value)
    stated = "\n".join(line.partition("#")[0] for line in PLAIN[kind].splitlines())
    for value in MEASURED.values():
        assert value not in stated


@pytest.mark.parametrize("kind", ["gear", "motor"])
def test_a_new_campaign_states_the_typical_errors(kind, tmp_path):
    """The same campaign without errors assumes those that the template states."""

    def errors(text):
        campaign = read_campaign(_write(tmp_path, text), kind)
        tables = (
            (campaign.motor,) if kind == "motor" else (campaign.vehicle, campaign.capture, campaign.surface)
        )
        fields = [value for table in tables for _, value in table]
        flat = [one for value in fields for one in (value if isinstance(value, tuple) else (value,))]
        return [(float(one), error_of(one)) for one in flat if isinstance(one, Stated)]

    stated, assumed = errors(WITH_ERRORS[kind]), errors(TEMPLATES[kind])
    assert sum(error > 0 for _, error in stated) >= (3 if kind == "motor" else 13)
    np.testing.assert_allclose(stated, assumed, rtol=1e-9)


@pytest.mark.parametrize(("kind", "old", "new", "sentence"), [
    ("gear", "body_mass =", "body_mas =", "unknown key vehicle.body_mas; nearest known key is 'body_mass'"),
    ("gear", "foot_dx =", "foot_xd =", "unknown key vehicle.foot_xd; nearest known key is 'foot_dx'"),
    ("gear", "foot_dx =", "foot_d =", "unknown key vehicle.foot_d; nearest known key is 'foot_dx'"),
    ("gear", "foot_dz =", "foot_d =", "unknown key vehicle.foot_d; nearest known key is 'foot_dz'"),
    ("gear", '"1.242 kg"', '"1.242"', "vehicle.body_mass: '1.242' has no unit"),
    ("gear", '"1.242 kg"', '"1.242 furlong"', "not a 'kg'"),
    ("gear", '"1.242 kg"', '"1.242 kgg"', "unknown unit 'kgg'"),
    ("gear", '"1.242 kg"', '"-1 kg"', "expected more than 0"),
    ("gear", 'slope = "15 deg"', 'slope = "95 deg"', "trials['drop-1'].slope: a slope of 95 deg is outside"),
    ("gear", 'slope = "15 deg"', 'slop = "15 deg"', "unknown key trials['drop-1'].slop; nearest known"),
    ("gear", 'down_slope = "+x"', 'down_slope = "-y"', "lie on one axis"),
    ("gear", 'use = "fit"', 'use = "validate"', "every trial has use = 'validate'"),
    ("gear", "[[trials]]", "[[trails]]", "unknown key trails; nearest known key is 'trials'"),
    ("gear", 'point = ["0 m", "0 m", "0 m"] ', "#", "nothing says where the surface lies"),
    ("gear", 'name = "my-drops"', "name = 'a b'", "name: expected letters, digits, dots, hyphens"),
    ("gear", 'kind = "gear"', 'kind = "glider"', "kind is 'glider'; expected 'motor' or "),
    ("gear", 'kind = "gear"', 'kind = []', "kind is []; expected 'motor' or "),
    ("gear", "[fit]", "[fit", "not valid TOML"),
    ("motor", "maximum = 2000", "maximum = 900", "are not in order"),
    ("motor", "maximum = 2000", "", "maximum is missing; state the logged numbers"),
    ("motor", "maximum = 2000", 'forward_half = "low"', "forward_half belongs to unit = 'dshot'"),
    ("motor", 'unit = "us"                              # or', 'unit = "dshot"\nforward_half = "low" #',
     "forward_half says what every DShot number means; drop minimum, neutral, maximum"),
    ("motor", 'kv = "960 rpm/V"', 'kv = "960 V"', "unit 'V' is not a 'rad/s/V'"),
    ("motor", 'direction = "forward"                    #', 'direction = "sideways" #', "forward"),
])  # fmt: skip
def test_mistakes_are_one_sentence(kind, old, new, sentence, tmp_path):
    text = TEMPLATES[kind]
    assert old in text
    path = _write(tmp_path, text.replace(old, new))
    with pytest.raises(CampaignError) as caught:
        read_campaign(path)
    assert sentence in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "more)" not in str(caught.value)


@pytest.mark.parametrize("value", ["[" * 100_000, "[" * 900 + "]" * 900, "9" * 5000, "{a=" * 50_000])
def test_a_campaign_without_end_is_refused(value, tmp_path):
    path = tmp_path / "c.toml"
    path.write_text(f'kind = "gear"\nx = {value}\n', encoding="utf-8")
    with pytest.raises(CampaignError, match=r"c.toml: not valid TOML: .*; correct that line"):
        read_campaign(path)


@pytest.mark.parametrize("name", ["CON", "nul.a", "Com1", "fit."])
def test_a_name_that_no_folder_may_have_everywhere_is_refused(name, tmp_path):
    text = re.sub(r'(?m)^name = ".*?"', f'name = "{name}"', TEMPLATES["gear"], count=1)
    with pytest.raises(CampaignError, match="is no name of a folder on Windows"):
        read_campaign(_write(tmp_path, text))


def test_wrong_kind_and_missing_files(tmp_path):
    path = _write(tmp_path, TEMPLATES["gear"])
    with pytest.raises(CampaignError, match="expected motor; use 'sysid fit'"):
        read_campaign(path, "motor")
    with pytest.raises(CampaignError, match="no such campaign file"):
        read_campaign(tmp_path / "nowhere.toml")
    with pytest.raises(CampaignError, match=r"is a folder; name the campaign in it, such as .*toml"):
        read_campaign(tmp_path)
    with pytest.raises(CampaignError, match=r"log 'drop-1.csv' does not exist"):
        resolve_log(path, "drop-1.csv")


TABLE = ParameterTable(
    [
        Parameter("mass", "m", "kg", 1.0, 0.5, 2.0, "linear", "a mass", "guess"),
        Parameter("stiffness", "k", "N/m", 100.0, 10.0, 1000.0, "log", "a spring", "guess"),
    ]
)


def _choices(tmp_path, text):
    base = TEMPLATES["motor"].split("[parameters]")[0]
    tail = '[[trials]]\nname="a"\nlog="a.csv"\ndirection="forward"\n'
    return read_campaign(_write(tmp_path, base + text + tail)).parameters


def test_search_space_takes_bounds_and_fixed_values(tmp_path):
    choices = _choices(
        tmp_path,
        '[parameters]\nfree=["stiffness"]\n[parameters.bounds]\nstiffness=["20 N/m","0.5 N/mm"]\n'
        '[parameters.fixed]\nmass="700 g"\n',
    )
    space = choices.search_space(TABLE, ["mass"], {})
    assert space.names == ("stiffness",)
    assert space.fixed["mass"] == pytest.approx(0.7)
    assert space.decode([[0.0], [0.5], [1.0]]).ravel() == pytest.approx([20.0, 100.0, 500.0])
    assert space.encode(space.decode([[0.3]]))[0, 0] == pytest.approx(0.3)


@pytest.mark.parametrize(("text", "sentence"), [
    ('[parameters]\nfree=["stifness"]\n', "no parameter 'stifness'; nearest is 'stiffness'"),
    ("[parameters]\nfree=[]\n", "free is empty"),
    ('[parameters.bounds]\nmass=["2 kg","1 kg"]\n', "parameters.bounds.mass: lower bound 2 kg is not below"),
    ('[parameters.bounds]\nmass=["2 N","3 N"]\n', "parameters.bounds.mass: unit 'N' is not a 'kg'"),
    ('[parameters]\nfree=["mass"]\n[parameters.fixed]\nmass="1 kg"\n', "both name mass"),
    ('[parameters.fixed]\nmass="1 kg"\n', "free is empty"),
    ('[parameters.fixed]\nstiffness="-1 N/m"\n', "parameters.fixed.stiffness: -1 N/m is negative"),
    ('[parameters.bounds]\nstiffness=["20 N/m","30 N/m"]\n', "bounds.stiffness: the parameter is not free"),
    ('[parameters.bounds]\nmas=["1 kg","2 kg"]\n',
     "parameters.bounds: no parameter 'mas'; nearest is 'mass'"),
    # Against the model's own bounds too, 0.5 to 2 kg.
    ('[parameters.measured]\nmass=["2.5 kg","3 kg"]\n', "exclude the measured 2.5 to 3"),
    ('[parameters.bounds]\nmass=["1.5 kg","2 kg"]\n', "exclude the measured value 1"),
    (
        '[parameters.bounds]\nmass=["0.5 kg","0.9 kg"]\n'
        '[parameters.measured]\nmass=["1.5 kg","1.6 kg"]\n',
        "exclude the measured 1.5 to 1.6",
    ),
    ('[parameters.measured]\nmass=["2 kg","1 kg"]\n', "2 kg is above 1 kg; swap them"),
])  # fmt: skip
def test_search_space_refusals(text, sentence, tmp_path):
    with pytest.raises(CampaignError, match=sentence):
        _choices(tmp_path, text).search_space(TABLE, ["mass"], {"mass": 1.0})


@pytest.mark.parametrize("kind", ["gear", "motor"])
def test_every_commented_line_of_a_template_is_valid_in_its_place(kind, tmp_path):
    """A user uncomments a line; it must be accepted where it stands, alternatives of the plane aside."""
    lines = TEMPLATES[kind].splitlines()
    for i, line in enumerate(lines):
        if not re.match(r"# \w+ = ", line):
            continue
        name = line[2:].split(" =")[0]
        changed = [*lines[:i], line[2:], *lines[i + 1 :]]
        if name in ("markers", "rest_log") and "[surface]" in "".join(lines[:i]):
            changed = [other for other in changed if not other.startswith('point = ["0 m"')]
        if name == "forward_half":
            changed = [o for o in changed if not o.startswith(("minimum", "neutral", "maximum"))]
            changed = ['unit = "dshot"' if o.startswith('unit = "us"') else o for o in changed]
        campaign = read_campaign(_write(tmp_path, "\n".join(changed)), kind)
        module = pytest.importorskip(f"sysid.{kind}.model")
        default = module.LF_FREE if kind == "gear" else module.FREE_DEFAULT
        campaign.parameters.search_space(module.PARAMETERS, default, {})


def test_a_folder_in_place_of_a_log_is_called_a_folder(tmp_path):
    (tmp_path / "logs").mkdir()
    with pytest.raises(CampaignError, match=r"log 'logs' is a folder in .*; correct its path"):
        resolve_log(tmp_path / "motor.toml", "logs")
    with pytest.raises(CampaignError, match=r"log 'a\.csv' does not exist in .*; correct its path"):
        resolve_log(tmp_path / "motor.toml", "a.csv")
