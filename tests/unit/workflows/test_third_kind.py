"""The verbs serve a user's model, `fakes.lag_kind`, as they serve a gear and a motor."""

import csv
import hashlib
import json
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import sysid
from fakes.lag_kind import TRUE, write_lag
from sysid import exact_json
from sysid.errors import FitError, SysidWarning
from sysid.export import load_parameter_sets
from sysid.export.spreadsheet import to_csv
from sysid.fit.adequacy import adequacy
from sysid.fit.store import read_fit
from sysid.own import OwnProblem
from sysid.parameter_sets import INTERVALS
from sysid.report.trust_tables import print_check, print_trust, print_validation
from sysid.trust.documents import TrustDocument
from sysid.workflows.check import check_campaign
from sysid.workflows.compare import compare_fits
from sysid.workflows.export_models import export_sets
from sysid.workflows.fit import fit_campaign
from sysid.workflows.options import FitOptions, ReportOptions, TrustOptions
from sysid.workflows.predict import cross_validate, validate_fit
from sysid.workflows.reopen import open_fit
from sysid.workflows.report import write_report
from sysid.workflows.trust import assess_fit


@pytest.fixture(scope="module")
def lag(tmp_path_factory):
    """A campaign of four steps, three to fit, and its fit."""
    folder = tmp_path_factory.mktemp("lag")
    path = write_lag(folder)
    return path, fit_campaign(path, FitOptions(out=folder / "fit", quiet=True, trust=False))[1]


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
    assert [row.verdict for row in checked.parameters] == ["well", "well"]
    print_check(checked, False)
    assert "warning" not in capsys.readouterr().out
    print_check(checked.model_copy(update={"warnings": ["one is wrong", "so is two"]}), False)
    # They were printed as they came.
    assert capsys.readouterr().out.endswith("\n2 warnings above\n")

    trusted = assess_fit(folder, TrustOptions(resamples=10))
    for row in trusted.parameters:
        low, high = row.interval_95
        assert low < TRUE[row.name] < high
    print_trust(trusted, folder, False)

    validated = validate_fit(folder, path)
    assert [trial.name for trial in validated.trials] == ["step-3"]
    assert validated.flagged is False
    print_validation(validated, folder, False)
    fit = read_fit(folder)
    assert validated.nrmse == fit.mean_nrmse("validate")[0]
    assert len(cross_validate(folder).trials) == 3
    document, _ = compare_fits([folder, folder])
    assert all(row.differs is not True for row in document.differences)
    assert document.cross == [[fit.nrmse[0]] * 2] * 2
    with pytest.raises(FitError, match="two or more"):
        compare_fits([folder])
    assert "step-3" in capsys.readouterr().out


def test_a_systematic_residual_is_named(lag):
    opened = open_fit(lag[1], None, 1)
    problem, row = opened.problem, opened.problem.adopt(opened.result)[0]
    assert adequacy(problem, row).biases == []
    problem.trials[1].measured[:] += 0.05
    (bias,) = adequacy(problem, row).biases
    assert (bias.trial, bias.assumed_explains) == (problem.trials[1].name, False)
    # Simulated less measured; the noise of 0.02 leaves a mean of 200 samples an error of 0.0014.
    assert bias.mean == pytest.approx(-0.05, abs=4 * 0.0014)
    # The log shows no noise, so a share of its spread counts as noise.
    assert -5 < bias.over_noise < -2
    assert "no error of the measured inputs explains it" in bias.sentence


def test_no_digits_of_what_the_data_do_not_determine(lag, tmp_path, run):
    assess_fit(lag[1], TrustOptions(resamples=0))
    folder = Path(shutil.copytree(lag[1], lag[1].parent / "open"))
    trust = json.loads((folder / "trust.json").read_text(encoding="utf-8"))
    row = next(row for row in trust["parameters"] if row["name"] == "gain")
    row |= {"verdict": "not_identifiable", "open_95": [True, True]}
    # Else its text is refused as changed.
    del trust["sha256"]["trust.json"]
    (folder / "trust.json").write_text(json.dumps(trust), encoding="utf-8")
    table = sysid.load_fit(folder).table
    assert math.isnan(table.loc["gain", "value"])
    assert table.loc["time_constant", "value"] > 0
    sides = run("compare", lag[1], folder)[1]
    (ours,) = (line for line in sides.splitlines() if "not identifiable" in line)
    assert ours.startswith(" gain [rad/s]")
    (apart,) = (line for line in sides.splitlines() if re.match(r" gain .* open ", line))
    assert apart.count(" — ") == 2


def test_two_fits_on_a_page(lag, tmp_path, run, refused):
    name = "<img src=x onerror=alert(1)>"
    other = Path(shutil.copytree(lag[1], tmp_path / name))
    page = tmp_path / "both.html"
    both = ("compare", lag[1], other, "--report", "--out", page, "--quiet")
    # The copy sees no campaign from its place.
    refused("its campaign", *both)
    assert not page.exists()
    shutil.copytree(lag[1], lag[1].parent / name)
    both = ("compare", lag[1], lag[1].parent / name, "--report", "--out", page, "--quiet")
    assert run(*both)[0] == 0
    text = page.read_text(encoding="utf-8")
    assert "<img src=x" not in text
    for words in ("Who predicts whom", "time constant", "step-0", "gain"):
        assert words in text
    refused(("exists already", "--force"), *both)
    refused("leave --no-cross out", *both, "--no-cross", "--force")


def test_a_law_that_the_kind_does_not_know_is_refused(lag, refused):
    words = "lag.toml: a campaign of kind 'lag' has no surface; leave --surface out"
    refused(words, "check", lag[0], "--surface", "hf")


@pytest.mark.parametrize("verb", ["trust", "cross-validate", "explain"])
def test_a_campaign_that_is_not_there_is_refused_by_the_name_that_was_typed(lag, refused, verb):
    words = f"nope.toml: no such campaign file; --campaign names the one of the fit {lag[1]}"
    refused(words, verb, lag[1], "--campaign", "nope.toml")


def test_a_fit_ends_with_intervals_that_no_export_leaves_out(tmp_path):
    path = write_lag(tmp_path)
    result, folder = fit_campaign(path, FitOptions(out=tmp_path / "fit", quiet=True))
    assert TrustDocument.read(folder).adequacy.verdict == result.provenance["adequacy"]["verdict"]
    rows = result.settings[INTERVALS]
    assert [*rows] == [record.name for record in result.parameters if record.status == "free"]
    assert all(row.low < row.high for row in result.judged.values())
    for suffix in (".json", ".csv", ".h5", ".mat"):
        (file,) = export_sets(folder, tmp_path / f"sets{suffix}")
        assert load_parameter_sets(file).settings[INTERVALS] == rows
        assert load_parameter_sets(file).provenance["adequacy"] == result.provenance["adequacy"]
    page = write_report(folder, ReportOptions())["report"].read_text(encoding="utf-8")
    assert all(words in page for words in ("lag", "time_constant", "step-3", "measured"))
    stated = exact_json.loads((folder / "fit.json").read_text(encoding="utf-8"))
    assert exact_json.plain(stated["settings"][INTERVALS]) == exact_json.plain(rows)
    assert "interval_low" in (tmp_path / "sets.csv").read_text(encoding="utf-8-sig").split("\n")[0]
    # An open end has no number: a bound of the search is no end.
    sets, name = load_parameter_sets(folder), next(iter(rows))
    below = {**rows, name: {**rows[name], "open_95": [True, False]}}
    table = to_csv(replace(sets, settings={**sets.settings, INTERVALS: below})).decode("utf-8-sig")
    row = next(one for one in csv.DictReader(table.splitlines()) if one["name"] == name)
    assert (row["interval_low"], float(row["interval_high"])) == ("", rows[name]["interval_95"][1])
    # What a person reads first was written before the intervals were known.
    lines = (folder / "summary.txt").read_text(encoding="utf-8").splitlines()
    for name, row in result.judged.items():
        (line,) = (one for one in lines if f" {name}: 95 % " in one)
        assert line.endswith(f"{row.interval}, {row.verdict.replace('_', ' ')}")


@pytest.mark.parametrize("change", ["edited", "deleted"])
def test_a_campaign_that_changes_while_the_fit_runs_is_recorded_as_it_was_read(tmp_path, monkeypatch, change):
    path = write_lag(tmp_path, "runs = 1\npopulation = 24\nmax_generations = 2\n")
    read = path.read_text(encoding="utf-8")
    evaluate = OwnProblem.score

    def meanwhile(problem, rows):
        path.write_text(read + "# edited\n", encoding="utf-8") if change == "edited" else path.unlink(True)
        return evaluate(problem, rows)

    monkeypatch.setattr(OwnProblem, "score", meanwhile)
    result, folder = fit_campaign(path, FitOptions(out=tmp_path / "fit", quiet=True, trust=False))
    stated = result.provenance["campaign"]
    assert stated["text"] == read
    assert stated["sha256"] == hashlib.sha256(read.encode()).hexdigest()
    assert (
        exact_json.loads((folder / "fit.json").read_text(encoding="utf-8"))["provenance"]["campaign"]
        == stated
    )
    assert '    kind = "lag"\n' in (folder / "summary.txt").read_text(encoding="utf-8")
    if change == "edited":
        with pytest.warns(SysidWarning, match="lag.toml has changed since the fit"):
            opened = open_fit(folder)
        # Where the campaign lies is told without the steps back that the record has.
        assert opened.path == path.resolve()


@pytest.mark.parametrize(
    ("out", "words"),
    [
        (".", ".: no result can take the place of this folder; name a new one inside it"),
        ("/", "/: no result can take the place of this folder"),
        ("..", "..: no result can take the place of this folder"),
        ("link", "link: is a symbolic link to elsewhere; name the folder or file itself"),
        ("x" * 10_000, "cannot be written (File name too long); choose another name"),
    ],
)
@pytest.mark.parametrize("force", [False, True])
def test_an_out_that_no_folder_can_be_is_refused_before_anything_is_read(
    tmp_path, monkeypatch, out, words, force
):
    monkeypatch.chdir(tmp_path)
    path = write_lag(tmp_path)
    (tmp_path / "link").symlink_to("elsewhere")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(FitError, match=re.escape(words)) as refusal:
        fit_campaign(path, FitOptions(out=Path(out), force=force, quiet=True, trust=False))
    assert len(str(refusal.value)) < 250
    assert sorted(tmp_path.iterdir()) == before
