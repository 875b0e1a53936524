"""`sysid report --against`: which trials of the other campaign a fit has never seen."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from fakes.fits import made_fit
from sysid.errors import FitError
from sysid.workflows import predict

# "again" is the fitted log of drop-1 under another name; drop-3 was held back by the fit.
LOGS = {"again": "aa", "drop-1": "dd", "drop-3": "cc", "new": "ee"}
PROVENANCE = {"logs": {f"drop-{k}": {"sha256": sha} for k, sha in enumerate(("aa", "bb", "cc"), start=1)}}


def _predicted(monkeypatch, logs):
    """Return the fit on the trials that are predicted, without predicting them."""
    fit = replace(made_fit(runs=1), provenance=PROVENANCE)
    (template,) = made_fit(runs=1, uses=("fit",)).trials

    class Fake:
        def __init__(self, names):
            self.trials = [SimpleNamespace(name=name, digest=logs[name]) for name in names]
            self.logs, self.campaign = logs, SimpleNamespace(name="other")

        def only(self, names):
            return Fake(names)

        def results(self, rows):
            return tuple(replace(template, name=trial.name) for trial in self.trials)

    monkeypatch.setattr(predict, "open_under", lambda *arguments: (None, Fake(list(logs))))
    monkeypatch.setattr(predict, "predict", lambda fit, problem: SimpleNamespace(problem=problem, rows=None))
    return predict.predicted_fit(fit, "other.toml")


def test_what_the_fit_saw_is_not_predicted(monkeypatch):
    fit = _predicted(monkeypatch, LOGS)
    assert [(trial.name, trial.use) for trial in fit.trials] == [("drop-1", "validate"), ("new", "validate")]
    assert list(fit.provenance["logs"]) == ["drop-1", "new"]


@pytest.mark.parametrize(
    ("logs", "words"),
    [
        ({"again": "aa", "twice": "bb"}, "made from every trial in it, so they validate nothing"),
        ({"again": "aa", "held": "cc"}, "whose report shows the ones held back anyway; leave --against out"),
    ],
)
def test_a_campaign_without_unseen_trials_is_refused(monkeypatch, logs, words):
    with pytest.raises(FitError, match=words):
        _predicted(monkeypatch, logs)
