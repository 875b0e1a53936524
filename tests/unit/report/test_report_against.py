"""`sysid report --against`: which trials of the other campaign a fit may be said never to have seen."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fakes.fits import MOTOR, made_fit
from fakes.places import SAMPLES
from sysid.errors import FitError
from sysid.gear import drops
from sysid.gear import problem as gear
from sysid.gear.model import PARAMETERS
from sysid.motor import known_values as motor_bench
from sysid.motor import objective as motor_objective
from sysid.motor import problem as motor
from sysid.parameter_sets import ParameterRecord
from sysid.workflows import report

# "again" is the fitted log of drop-1 under another name; drop-3 was held back by the fit.
LOGS = {"again": "aa", "drop-1": "dd", "drop-3": "cc", "new": "ee"}
UNSEEN = ["drop-1", "new"]
PROVENANCE = {"logs": {f"drop-{k}": {"sha256": sha} for k, sha in enumerate(("aa", "bb", "cc"), start=1)}}


def gear_choice(monkeypatch, logs):
    """Return the drops that are simulated, without simulating them."""
    prepared = tuple(SimpleNamespace(name=name, provenance={"sha256": sha}) for name, sha in logs.items())
    monkeypatch.setattr(drops, "prepare_drops", lambda campaign, path: prepared)
    kept = SimpleNamespace(space=SimpleNamespace(table=PARAMETERS))
    monkeypatch.setattr(
        gear.GearObjective, "build", lambda campaign, space, drops: SimpleNamespace(**vars(kept), drops=drops)
    )
    monkeypatch.setattr(gear, "trial_results", lambda objective, rows: (_results(objective.drops), None))
    records = tuple(ParameterRecord.of(parameter, "fixed") for parameter in PARAMETERS.values())
    fit = replace(
        made_fit(runs=1), parameters=records, values=np.ones((1, len(records))),
        at_bound=np.zeros((1, len(records)), np.int8), settings={"surface": "lf"}, provenance=PROVENANCE,
    )  # fmt: skip
    return report.predicted(fit, SAMPLES / "gear-lf" / "campaign.toml", lambda sentence: None)


def motor_choice(monkeypatch, logs):
    prepared = tuple(
        # A trial of several files names the log's own hash first.
        SimpleNamespace(
            name=name, entry=SimpleNamespace(name=name), hashes=f"{sha} 00", provenance={"sha256": sha}
        )
        for name, sha in logs.items()
    )
    monkeypatch.setattr(motor_bench, "prepare_bench", lambda campaign, path: SimpleNamespace(trials=prepared))
    monkeypatch.setattr(motor_bench, "search_space", lambda campaign, bench: SimpleNamespace(table={}))
    build = lambda campaign, space, bench, trials: SimpleNamespace(cost=None, jobs=None)  # noqa: E731
    objective = type("Objective", (SimpleNamespace,), {"build": staticmethod(build)})
    objective.__init__ = lambda self, space=None, trials=(), *rest: vars(self).update(trials=trials)
    monkeypatch.setattr(motor_objective, "MotorObjective", objective)
    monkeypatch.setattr(motor, "motor_trial_results", lambda objective, rows: _results(objective.trials))
    fit = replace(made_fit(MOTOR, runs=1), provenance=PROVENANCE)
    return report.predicted(fit, SAMPLES / "motor" / "campaign.toml", lambda sentence: None)


def _results(trials):
    (template,) = made_fit(runs=1, uses=("fit",)).trials
    motor_like = any(hasattr(trial, "entry") for trial in trials)
    if motor_like:
        (template,) = made_fit(MOTOR, runs=1, uses=("fit",)).trials
    return tuple(replace(template, name=trial.name) for trial in trials)


@pytest.mark.parametrize("choice", [gear_choice, motor_choice])
def test_what_the_fit_saw_is_not_told_as_unseen(monkeypatch, choice):
    found = choice(monkeypatch, LOGS)
    assert [(trial.name, trial.use) for trial in found.trials] == [(name, "validate") for name in UNSEEN]
    assert list(found.provenance["logs"]) == UNSEEN


@pytest.mark.parametrize("choice", [gear_choice, motor_choice])
def test_a_campaign_of_fitted_trials_alone_is_refused(monkeypatch, choice):
    with pytest.raises(FitError, match="made from every trial in it, so they validate nothing"):
        choice(monkeypatch, {"again": "aa", "twice": "bb"})


@pytest.mark.parametrize("choice", [gear_choice, motor_choice])
def test_what_the_fit_held_back_is_not_shown_twice(monkeypatch, choice):
    with pytest.raises(FitError, match="whose report shows the ones held back anyway; leave --against out"):
        choice(monkeypatch, {"again": "aa", "held": "cc"})
