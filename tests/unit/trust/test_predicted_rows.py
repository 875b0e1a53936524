"""What a fit brings to another campaign: R with the k under which it was found, friction with its law."""

from types import SimpleNamespace

import numpy as np
import pytest

from fakes.places import SAMPLES
from sysid.campaign import read_campaign
from sysid.gear.model import PARAMETERS
from sysid.motor.model import PARAMETERS as MOTOR
from sysid.workflows.predicted_rows import campaign_row, gear_rows, motor_rows
from sysid.workflows.reopen import law_of

K_FIT, K_RATED = 0.0080, 0.00995
NAMES = ("winding_resistance", "back_emf_constant", "torque_constant", "rotor_inertia")


def _motor_row(resistance_status):
    """The row of a fit that was made on a guessed k, for a campaign that states Kv and the inertia."""
    status = (resistance_status, "fixed", "fixed", "fixed")
    fit = SimpleNamespace(
        nrmse=[0.1],
        parameters=[SimpleNamespace(name=n, status=s) for n, s in zip(NAMES, status, strict=True)],
        values=np.array([[0.2, K_FIT, K_FIT, 1e-5]]),
    )
    values = {"back_emf_constant": K_RATED, "torque_constant": K_RATED, "rotor_inertia": 2.7e-5}
    bench = SimpleNamespace(
        values=values, stated=dict.fromkeys(NAMES[1:3], "campaign: 1/motor.kv, a rating"), measured={}
    )
    campaign = SimpleNamespace(parameters=SimpleNamespace(fixed={}))
    space = SimpleNamespace(table=MOTOR)
    base = np.array([values.get(name, row.nominal) for name, row in MOTOR.items()])
    return dict(zip(MOTOR, motor_rows(fit, campaign, bench, space, base)[0], strict=True))


def test_a_resistance_that_was_found_keeps_the_constant_it_was_found_under():
    row = _motor_row("free")
    # k²/R is what torque and speed have fixed; with the rated k it would be 55 % more.
    found = row["torque_constant"] * row["back_emf_constant"] / row["winding_resistance"]
    assert found == pytest.approx(K_FIT**2 / 0.2)
    # An inertia that the campaign has measured is its own all the same.
    assert row["rotor_inertia"] == 2.7e-5


def test_a_campaign_keeps_its_constant_beside_a_resistance_that_was_held():
    row = _motor_row("fixed")
    assert row["torque_constant"] == row["back_emf_constant"] == K_RATED


LF = SAMPLES / "gear-lf" / "campaign.toml"


@pytest.mark.parametrize(("law", "other"), [("lf", "hf"), ("hf", "lf")])
def test_friction_that_one_law_found_is_no_friction_of_another(law, other):
    campaign = law_of(read_campaign(LF, "gear"), law)
    records = [SimpleNamespace(name=n, status="free") for n in ("kinetic_friction", "joint_dx")]
    fit = SimpleNamespace(
        nrmse=[0.1], parameters=records, values=np.array([[0.6, 0.07]]), settings={"surface": other}
    )
    at = {name: i for i, name in enumerate(PARAMETERS)}
    row = gear_rows(fit, campaign)[0]
    assert row[at["kinetic_friction"]] == campaign_row(campaign)[at["kinetic_friction"]] != 0.6
    assert row[at["joint_dx"]] == 0.07
    # Where the drops have a fit of their own, its friction stands, and nothing else of it.
    own = campaign_row(campaign)
    own[at["kinetic_friction"]], own[at["joint_dx"]] = 0.9, 0.05
    row = gear_rows(fit, campaign, own)[0]
    assert row[at["kinetic_friction"]] == 0.9
    assert row[at["joint_dx"]] == 0.07
    fit.settings["surface"] = law
    assert gear_rows(fit, campaign, own)[0][at["kinetic_friction"]] == 0.6
