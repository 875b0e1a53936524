"""Benches of a right motor in a campaign with a good lab's errors: all are fitted, a gross one is named."""

import pytest

from fakes.lab import MOTOR_LAB, misstated, scaled
from sysid.synthetic import read_truth, synthesize_motor
from sysid.trust.documents import TrustDocument
from sysid.workflows.explain import explain_and_print
from sysid.workflows.fit import fit_motor
from sysid.workflows.options import FitOptions
from sysid.workflows.show import verdict_on

pytestmark = pytest.mark.slow
# A motor that is not the paper's.
MOTOR = {
    "winding_resistance": 0.27, "winding_inductance": 0.0033, "rotor_inertia": 3.1e-5,
    "back_emf_constant": 0.0108, "torque_constant": 0.0108,
}  # fmt: skip


@pytest.fixture
def campaign(tmp_path):
    return synthesize_motor(tmp_path / "bench", seed=1, parameters=MOTOR) / "campaign.toml"


def fitted(path, **options):
    """The fit of a campaign by one run, its intervals and its folder."""
    choices = FitOptions(out=path.with_suffix(""), runs=1, seed=1, quiet=True, check=False, **options)
    result, folder = fit_motor(path, choices)
    text = (folder / "trust.json").read_text(encoding="utf-8")
    return result, TrustDocument.parse(text, folder / "trust.json", ValueError), folder


@pytest.mark.parametrize("seed", [1, 2, 4])
def test_a_good_labs_errors_are_fitted(campaign, seed):
    result, trust, _ = fitted(misstated(campaign, seed, name="good.toml", errors=MOTOR_LAB))
    assert trust.adequacy.verdict == "explained"
    for name in ("winding_resistance", "winding_inductance"):
        row = trust.by_name[name]
        assert row.contains(MOTOR[name])
        # 2 % of Kv are 4 % of R, one standard deviation.
        assert (row.interval_95[1] - row.interval_95[0]) / 2 / row.value > 0.06
        assert row.decided_by == "kv"
    by_name = {row.name: row for row in trust.stated}
    inertia = by_name["rotor_inertia"]
    assert inertia.fitted == pytest.approx(MOTOR["rotor_inertia"], rel=2e-3)
    # Torque and speed say nothing of Kv: it stays as stated.
    assert abs(by_name["back_emf_constant"].pull) < 0.05
    assert not any(row.contradicted for row in trust.stated)
    said = "the error of kv as stated decides winding resistance, winding inductance"
    assert said in verdict_on(result)


@pytest.mark.parametrize("key", ["rotor_inertia", "reference_voltage", "torque_curve_forward"])
def test_a_gross_error_is_named(campaign, key):
    gross = {} if key == "torque_curve_forward" else {key: 9.0}
    if not gross:
        scaled(campaign.with_name("static-forward.csv"), "Torque", 1.015)
    _, trust, _ = fitted(misstated(campaign, 4, name="gross.toml", errors=MOTOR_LAB, gross=gross))
    wrong = max((row for row in trust.stated if row.contradicted), key=lambda row: row.gain)
    assert any(name.startswith(key[:12]) for name in (wrong.name, *wrong.partners))
    (sentence, *_) = (one for one in trust.warnings if "the trials ask for" in one)
    assert sentence.startswith(f"the trials ask for {wrong.name} = ")
    if gross:
        true = read_truth(campaign.parent)["parameters"][key]
        assert wrong.asked == pytest.approx(true, abs=3 * wrong.sigma)


@pytest.mark.parametrize(("factor", "inertia"), [(1.015, "5 %"), (1.1, "5 %"), (1.1, "20 %")])
def test_a_load_cell_is_named_beyond_the_error_of_its_calibration(campaign, factor, inertia):
    for way in ("forward", "reverse"):
        scaled(campaign.with_name(f"static-{way}.csv"), "Torque", factor)
    errors = MOTOR_LAB | {"rotor_inertia": inertia}
    _, trust, _ = fitted(misstated(campaign, 4, name="cell.toml", errors=errors))
    assert trust.adequacy.verdict == "explained"
    # Three standard deviations of 1 % are the most that no chance explains.
    wrong = [row for row in trust.stated if row.contradicted]
    assert len(wrong) == (factor > 1.03)
    for row in wrong:
        cells = ["load_cell_factor_static", "load_cell_factor_trials"]
        named = sorted([row.name, *row.partners])
        # The torque of a step is the static curve's and the rotor's. Only an inertia that is known well may
        # say which of the two load cells is off.
        assert named == cells or (inertia == "5 %" and named == cells[:1])
        asked = factor if row.name == cells[1] else 1 / factor
        assert row.asked == pytest.approx(asked, abs=2 * row.sigma)
    for name in ("winding_resistance", "winding_inductance"):
        assert trust.by_name[name].contains(MOTOR[name])


def test_the_same_taken_as_exact_is_a_confident_error(campaign):
    path = misstated(campaign, 0, name="exact.toml", errors={"kv": "2 %"}, gross={"kv": 1.0})
    _, trust, _ = fitted(path, exact=True)
    assert not trust.stated
    assert not trust.by_name["winding_resistance"].contains(MOTOR["winding_resistance"])


def test_a_wrong_number_of_poles_is_named_beside_the_inertia(campaign):
    # Speeds of a motor of 12 poles, read as of 14, are those of another motor with 14/12 of its inertia.
    errors = {**MOTOR_LAB, "rotor_inertia": "3 %"}
    gross = {"rotor_inertia": (12 / 14 - 1) / 0.03}
    path = misstated(campaign, 4, name="poles.toml", errors=errors, gross=gross)
    poles = "(all speeds 1.167 times as high (a stand set to 14 poles for a motor of 12) would do the same)"
    # An optical probe of the static logs has counted marks, not poles.
    assert poles not in fitted(path)[1].warnings[0]
    for log in campaign.parent.glob("[ns]*.csv"):
        text = log.read_text(encoding="utf-8-sig").replace("Motor Optical", "X")
        text = text.replace("Motor Electrical", "Motor Optical").replace("X", "Motor Electrical")
        log.write_text(text, encoding="utf-8")
    _, trust, folder = fitted(path.rename(path.with_name("electrical.toml")))
    assert trust.warnings[0].startswith("the trials ask for rotor_inertia = ")
    assert trust.warnings[0].endswith(f"measure it again {poles}")
    # No key of the campaign contains poles.
    adopted = path.with_name("adopted.toml")
    explain_and_print(folder, adopt=adopted)
    assert not adopted.exists()
