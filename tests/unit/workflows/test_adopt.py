"""What a fit brings to another campaign, and that every verb predicts with the same bits."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fakes.places import SAMPLES
from sysid.campaign import read_campaign
from sysid.fit.store import read_fit, write_fit
from sysid.gear.problem import GearProblem, gear_space, on_surface
from sysid.motor.model import PARAMETERS as MOTOR
from sysid.motor.problem import MotorProblem
from sysid.parameters import SearchSpace
from sysid.workflows.compare import compare_fits
from sysid.workflows.fit import fit_gear
from sysid.workflows.options import FitOptions
from sysid.workflows.predict import cross_validate, predicted_fit, validate_fit

LF = SAMPLES / "gear-lf" / "campaign.toml"


def _fit(settings=None, **values):
    """A fit of one set; each value with its status."""
    records = [SimpleNamespace(name=name, status=status) for name, (_, status) in values.items()]
    numbers = np.array([[value for value, _ in values.values()]])
    return SimpleNamespace(
        parameters=records, values=numbers, settings=settings or {}, trials=(), provenance={"logs": {}}
    )


def _drops(campaign):
    return GearProblem(campaign, gear_space(campaign), ())


def _row(problem, fit):
    return dict(zip(problem.space.table, problem.adopt(fit)[0], strict=True))


K_FIT, K_RATED = 0.0080, 0.00995


@pytest.mark.parametrize(("status", "k"), [("free", K_FIT), ("fixed", K_RATED)])
def test_a_resistance_that_was_found_keeps_the_constant_it_was_found_under(status, k):
    values = {"back_emf_constant": K_RATED, "torque_constant": K_RATED, "rotor_inertia": 2.7e-5}
    bench = SimpleNamespace(values=values, guessed=set(), trials=())
    campaign = SimpleNamespace(parameters=SimpleNamespace(fixed={}))
    space = SearchSpace(MOTOR, (), MOTOR.nominal | values)
    problem = MotorProblem(campaign, bench, space, (), (), {})
    constants = {name: (K_FIT, "fixed") for name in ("back_emf_constant", "torque_constant")}
    row = _row(problem, _fit(winding_resistance=(0.2, status), rotor_inertia=(1e-5, "fixed"), **constants))
    # k²/R is what torque and speed have fixed; with the rated k it would be 55 % more.
    assert row["torque_constant"] == row["back_emf_constant"] == k
    # An inertia that the campaign has measured is the campaign's all the same.
    assert row["rotor_inertia"] == 2.7e-5


def test_what_a_fit_held_counts_where_the_campaign_says_nothing():
    campaign = read_campaign(LF, "gear")
    fit = _fit(ground_damping=(0.5, "fixed"), leg_mass=(0.04, "measured"), joint_dx=(0.07, "free"))
    row = _row(_drops(campaign), fit)
    assert row["ground_damping"] == 0.5
    assert row["joint_dx"] == 0.07
    assert row["leg_mass"] == campaign.vehicle.leg_mass != 0.04
    fixed = campaign.parameters.model_copy(update={"fixed": {"ground_damping": "2 N·s/m"}})
    assert _row(_drops(campaign.model_copy(update={"parameters": fixed})), fit)["ground_damping"] == 2.0


@pytest.mark.parametrize("law", ["lf", "hf"])
def test_friction_stays_with_its_law(law):
    campaign = on_surface(read_campaign(LF, "gear"), law)[0]
    # The campaign is opened under the law of the fit, whose friction then counts.
    assert _row(_drops(campaign), _fit(kinetic_friction=(0.6, "free")))["kinetic_friction"] == 0.6
    stated = read_campaign(LF, "gear").surface.kinetic_friction
    kept = _row(_drops(campaign), _fit(kinetic_friction=(0.6, "fixed")))["kinetic_friction"]
    # What the campaign states of its surface is not of the other law.
    assert kept == (stated if law == "lf" else 0.6)


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory):
    """Two campaigns of the sample's drops; the second one states another mass."""
    head, *trials = LF.read_text(encoding="utf-8").split("[[trials]]\n")
    trials = [trial.replace('log = "', f'log = "{LF.parent.as_posix()}/') for trial in trials]
    folder = tmp_path_factory.mktemp("adopt")
    for name, chosen, mass in (("first", (0, 2), None), ("second", (1, 3), "2.0 kg")):
        text = "[[trials]]\n".join([head, *(trials[i] for i in chosen)])
        if mass is not None:
            stated = next(line for line in text.splitlines() if line.startswith("body_mass"))
            text = text.replace(stated, f'body_mass = "{mass}"')
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    return folder


def test_every_verb_predicts_with_the_same_bits(campaigns):
    options = FitOptions(
        runs=1, population=8, max_generations=2, finish="none", quiet=True, check=False, trust=False
    )
    first, second = (
        fit_gear(campaigns / f"{name}.toml", replace(options, out=campaigns / name))[1]
        for name in ("first", "second")
    )
    other = campaigns / "second.toml"
    result = read_fit(first)
    mass = result.parameter_sets().set_values()["body_mass"]
    assert mass != 2.0
    validated = validate_fit(first, other)
    nrmse = [trial.nrmse[0] for trial in validated.trials]
    by_channel = [list(trial.by_channel.values()) for trial in validated.trials]

    against = predicted_fit(result, other)
    assert [trial.nrmse[0].tolist() for trial in against.trials] == by_channel
    assert against.mean_nrmse("validate")[0] == validated.nrmse

    cross = compare_fits([first, second])[0].cross
    assert cross[0][1] == np.mean(nrmse)
    # The fit's own mass predicts otherwise, far beyond rounding.
    freed = replace(result, parameters=tuple(replace(r, status="free") for r in result.parameters))
    write_fit(freed, campaigns / "freed")
    assert validate_fit(campaigns / "freed", other).nrmse != pytest.approx(validated.nrmse, rel=1e-3)

    # Leaving a trial out and predicting it is validating the refit on it.
    left_out = cross_validate(second).trials
    fitted = read_fit(second)
    column = {record.name: i for i, record in enumerate(fitted.parameters)}
    for t, trial in enumerate(left_out):
        values = fitted.values.copy()
        for name, value in trial.refit.items():
            values[:, column[name]] = value
        kept = tuple(
            replace(one, use="validate" if one.name == trial.name else "fit") for one in fitted.trials
        )
        folder = write_fit(replace(fitted, values=values, trials=kept), campaigns / f"refit-{t}")
        again = validate_fit(folder, other).trials
        assert [one.name for one in again] == [trial.name]
        assert again[0].nrmse == trial.nrmse
        assert again[0].by_channel == trial.by_channel
