"""`sysid report --against`: which trials of the other campaign a fit has never seen."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import pytest

from fakes.fits import made_fit
from sysid.errors import FitError
from sysid.fit.store import write_fit
from sysid.workflows import predict
from sysid.workflows.options import ReportOptions
from sysid.workflows.report import open_report, second_fit, write_report

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
            self.campaign = SimpleNamespace(name="other")

        def only(self, names):
            return Fake(names)

        def results(self, rows):
            return tuple(replace(template, name=trial.name) for trial in self.trials)

    monkeypatch.setattr(predict, "open_under", lambda *arguments: (None, Fake(list(logs))))

    def predicted(fit, kind, problem):
        return SimpleNamespace(problem=problem, rows=None, story=SimpleNamespace(logs=logs))

    monkeypatch.setattr(predict, "predict", predicted)
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


def test_fits_are_compared_on_the_logs_that_both_have(tmp_path):
    first, *rest = made_fit().trials
    same = {"logs": {trial.name: {"sha256": trial.name} for trial in (first, *rest)}}
    mixed = {"logs": same["logs"] | {trial.name: {"sha256": "another"} for trial in rest}}
    folder = write_fit(replace(made_fit(), provenance=same), tmp_path / "first")
    other = write_fit(replace(made_fit(), name="other", provenance=mixed), tmp_path / "other")
    report = open_report(folder)
    text = replace(report, beside=second_fit(report, other)).measured_against_simulated().text
    data = json.loads(re.search(r'<script type="application/json">(.*?)</script>', text, re.DOTALL)[1])
    drawn = {view["key"]: "best set of other" in json.dumps(view) for view in data["views"]}
    assert drawn == {f"bench: {t.name}": t is first for t in (first, *rest)}


def test_fits_of_other_logs_are_not_compared(tmp_path):
    fit = replace(made_fit(), provenance=PROVENANCE)
    folder = write_fit(fit, tmp_path / "first")
    strange = {"logs": {trial.name: {"sha256": "other bytes"} for trial in fit.trials}}
    other = write_fit(replace(fit, provenance=strange), tmp_path / "other")
    with pytest.raises(FitError, match=r"shares no trial with .*names or logs differ"):
        write_report(folder, ReportOptions(compare=other))
    assert not (folder / "report.html").exists()
