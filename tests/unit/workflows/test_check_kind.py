"""`sysid.testing.check_kind`: kinds that pass, and one planted fault for each of its checks."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import sysid
from fakes.lag_kind import write_lag
from fakes.places import SAMPLES
from sysid.own import OwnProblem
from sysid.parameters import ParameterTable
from sysid.testing import check_kind

TIME = np.arange(40) / 40


def decay(values, time, trial):
    return values["start"] * np.exp(-values["rate"] * time)


def campaign(simulate, changed=lambda content: content, **options):
    made = sysid.model(
        "decay_checked", simulate, channels={"level": "V"},
        parameters={"rate": (0.1, 10.0, "1/s"), "start": (0.1, 5.0, "V")}, **options,
    )  # fmt: skip
    noise, level = np.random.default_rng(1), decay({"rate": 3.0, "start": 2.0}, TIME, {})
    logs = {
        name: pd.DataFrame({"level": level + 0.01 * noise.standard_normal(len(TIME))}, index=TIME)
        for name in "ab"
    }
    return sysid.Model(changed(made.content)).campaign(logs)


class Remembering:
    """A decay that changes by a part in 1e12 after so many calls."""

    def __init__(self, calls):
        self.calls, self.left = calls, calls

    def __call__(self, values, time, trial):
        self.left -= 1
        return decay(values, time, trial) * (1 + 1e-12 * (self.left < 0))


# The motor is the example of the documentation.
@pytest.mark.parametrize("kind", ["lag", "decay", pytest.param("gear-lf", marks=pytest.mark.slow)])
def test_kinds_that_keep_the_rules_pass(kind, tmp_path):
    made = {"lag": lambda: write_lag(tmp_path), "decay": lambda: campaign(decay)}
    check_kind(made.get(kind, lambda: SAMPLES / kind)())


def blind(values, time, trial):
    return values["start"] * np.exp(-3.0 * time)


def lost(values, time, trial):
    return decay(values, time, trial) * np.nan


def neighbourly(values, time, trial):
    return decay(values, time, trial) + 1e-12 * values["rate"].mean()


def hiding(values, time, trial):
    return np.nan_to_num(decay(values, time, trial))


def strange_unit(content):
    return replace(content, table=ParameterTable([replace(r, unit="blub") for r in content.table.values()]))


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: campaign(decay, strange_unit), "unknown unit 'blub'"),
        (lambda: campaign(lost), "and so at every point that was tried"),
        (lambda: campaign(blind), "no residual moves with rate"),
        (lambda: campaign(neighbourly, vectorized=True), "has other numbers without its neighbours"),
        (lambda: campaign(Remembering(60)), "has other numbers when it is computed again"),
        (lambda: campaign(hiding), "values that are NaN do not make a simulation fail"),
    ],
)
def test_each_check_finds_its_fault(made, words):
    with pytest.raises(AssertionError, match=words) as refusal:
        check_kind(made())
    assert isinstance(refusal.value, sysid.SysidError)
    assert "\n" not in str(refusal.value)


def test_a_model_that_remembers_is_found_when_its_search_is_resumed():
    whole = Remembering(10**9)
    check_kind(campaign(whole))
    # The last call is one of the resumed search.
    with pytest.raises(AssertionError, match="stopped and resumed found other numbers"):
        check_kind(campaign(Remembering(10**9 - whole.left - 8)))


@pytest.mark.parametrize(
    ("name", "fault", "words"),
    [
        ("_cost", lambda problem, cost: cost * np.inf, "a cost is not finite"),
        ("residuals", lambda problem, got: (got[0] + (problem.threads == 2), got[1]), "with two threads"),
    ],
)
def test_faults_that_no_function_can_have_are_found_in_a_problem(monkeypatch, name, fault, words):
    real = getattr(OwnProblem, name)
    monkeypatch.setattr(OwnProblem, name, lambda problem, *given: fault(problem, real(problem, *given)))
    with pytest.raises(AssertionError, match=words):
        check_kind(campaign(decay))
