"""The skeleton serves a model that it has never seen: a first-order lag that is fitted to steps.

The kind below is all that such a model needs: its campaign, its parameter table, how a simulation is scored.
No file of the package knows it.
"""

import hashlib
import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from sysid.campaign import FitTable
from sysid.campaign.common import CampaignTable, TomlTable, TrialTable
from sysid.errors import FitError
from sysid.fit.nrmse import CostChannel, FilteredNrmse, TrialTarget
from sysid.fit.problem import Kind, Problem, Scores, Trial
from sysid.fit.store import read_fit
from sysid.parameters import Parameter, ParameterTable
from sysid.report.trust_tables import print_check, print_trust, print_validation
from sysid.workflows.check import check_campaign
from sysid.workflows.compare import compare_fits
from sysid.workflows.export_models import export_sets
from sysid.workflows.fit import fit_campaign
from sysid.workflows.kinds import register
from sysid.workflows.options import FitOptions, ReportOptions, TrustOptions
from sysid.workflows.predict import cross_validate, validate_fit
from sysid.workflows.report import write_report
from sysid.workflows.trust import assess_fit

# --- the kind -----------------------------------------------------------------------------------------------

TABLE = ParameterTable(
    [
        Parameter("gain", "K", "rad/s", 1.0, 0.1, 10.0, "log", "Speed per unit step.", "guess"),
        Parameter("time_constant", "τ", "s", 0.2, 0.01, 2.0, "log", "Time to 63 %.", "guess"),
        Parameter("offset", "y_0", "rad/s", 0.0, -1.0, 1.0, "linear", "Speed at rest.", "guess"),
    ]
)


class LagCost(TomlTable):
    denominator: Literal["std", "range"] = "std"


class LagTrial(TrialTable):
    step: float


class LagCampaign(CampaignTable):
    kind: Literal["lag"]
    cost: LagCost = LagCost()
    fit: FitTable = FitTable()
    trials: tuple[LagTrial, ...]


@dataclass(frozen=True, eq=False)
class LagProblem(Problem):
    campaign: LagCampaign
    space: object
    logs_read: tuple
    threads: int | None = None
    channels, units = ("speed",), ("rad/s",)

    @cached_property
    def trials(self):
        return tuple(
            Trial(entry.name, entry.use, t, y[:, None], np.ones((t.size, 1), bool), record, 0.0)
            for entry, t, y, record in self.logs_read
        )

    @cached_property
    def cost(self):
        targets = [TrialTarget(trial.name, trial.measured) for trial in self.trials]
        return FilteredNrmse(targets, [CostChannel("speed", "rad/s", 0)], self.campaign.cost.denominator)

    def only(self, names):
        return replace(self, logs_read=tuple(log for log in self.logs_read if log[0].name in names))

    def signals(self, rows):
        gain, tau, offset = (rows[:, i, None] for i in range(3))
        out = [offset + gain * log[0].step * (1 - np.exp(-log[1] / tau)) for log in self.logs_read]
        return tuple(y[:, :, None] for y in out), np.zeros((len(rows), len(out)), bool)

    def score(self, rows):
        signals, _ = self.signals(rows)
        found = self.cost(np.concatenate(signals, axis=1), threads=self.threads)
        return Scores(found.by_channel, found.failed.astype(np.int8))


def open_lag(campaign, path, threads):
    logs = []
    for entry in campaign.trials:
        text = (Path(path).parent / entry.log).read_bytes()
        time, speed = np.array(json.loads(text))
        record = {"log": entry.log, "sha256": hashlib.sha256(text).hexdigest()}
        logs.append((entry, time, speed, record))
    space = campaign.parameters.search_space(TABLE, ("gain", "time_constant"), {})
    return LagProblem(campaign, space, tuple(logs), threads)


# --- what the verbs make of it ------------------------------------------------------------------------------

TRUE = {"gain": 3.0, "time_constant": 0.15}
SIGMA = 0.02


@pytest.fixture(scope="module")
def lag(tmp_path_factory):
    """A campaign of four steps, three to fit, and its fit."""
    register(Kind("lag", LagCampaign, open_lag))
    folder = tmp_path_factory.mktemp("lag")
    source = np.random.default_rng(3)
    text = 'name = "bench"\nkind = "lag"\n[fit]\nruns = 2\npopulation = 24\nmax_generations = 40\n'
    for k, step in enumerate((0.5, 1.0, 1.5, 2.0)):
        time = np.arange(200) * 0.005
        speed = TRUE["gain"] * step * (1 - np.exp(-time / TRUE["time_constant"]))
        speed += SIGMA * source.standard_normal(time.size)
        (folder / f"{k}.json").write_text(json.dumps([time.tolist(), speed.tolist()]), encoding="utf-8")
        use = "fit" if k < 3 else "validate"
        text += f'[[trials]]\nname = "step-{k}"\nlog = "{k}.json"\nuse = "{use}"\nstep = {step}\n'
    path = folder / "lag.toml"
    path.write_text(text, encoding="utf-8")
    return path, fit_campaign(path, FitOptions(out=folder / "fit", quiet=True))[1]


def test_the_fit_finds_the_truth_and_tells_what_it_expects(lag):
    fit = read_fit(lag[1])
    found = fit.parameter_sets().set_values()
    # 600 samples of 0.02 beside amplitudes of 1.5 to 4.5 leave 0.05 % of the gain and 0.5 % of τ.
    assert found["gain"] == pytest.approx(TRUE["gain"], rel=2e-3)
    assert found["time_constant"] == pytest.approx(TRUE["time_constant"], rel=0.02)
    assert [row["verdict"] for row in fit.provenance["expected"]] == ["well", "well"]
    assert [(trial.name, trial.use) for trial in fit.trials][-1] == ("step-3", "validate")


def test_every_verb_serves_it(lag, capsys):
    path, folder = lag
    checked = check_campaign(path)
    assert [row["verdict"] for row in checked["parameters"]] == ["well", "well"]
    print_check(checked, False)

    trusted = assess_fit(folder, TrustOptions(resamples=10))
    for row in trusted["parameters"]:
        low, high = row["interval_95"]
        assert low < TRUE[row["name"]] < high
    print_trust(trusted, folder, False)

    validated = validate_fit(folder, path)
    assert [trial["name"] for trial in validated["trials"]] == ["step-3"]
    assert validated["flagged"] is False
    print_validation(validated, folder, False)
    fit = read_fit(folder)
    assert validated["nrmse"] == fit.mean_nrmse("validate")[0]
    assert len(cross_validate(folder)["trials"]) == 3
    document, _ = compare_fits([folder, folder])
    assert all(row["differs"] is not True for row in document["differences"])
    assert document["cross"].tolist() == [[fit.nrmse[0]] * 2] * 2
    with pytest.raises(FitError, match="two or more"):
        compare_fits([folder])
    assert "step-3" in capsys.readouterr().out


def test_a_law_that_the_kind_does_not_know_is_refused(lag, refused):
    words = "lag.toml: a campaign of kind 'lag' has no surface; leave --surface out"
    refused(words, "check", lag[0], "--surface", "hf")


def test_its_report_and_exports_are_written(lag):
    folder = lag[1]
    page = write_report(folder, ReportOptions())["report"].read_text(encoding="utf-8")
    for words in ("lag", "time_constant", "step-3", "measured"):
        assert words in page
    for name in ("sets.csv", "sets.json", "sets.h5", "sets.mat"):
        export_sets(folder, folder.parent / name)
        assert (folder.parent / name).stat().st_size > 0
