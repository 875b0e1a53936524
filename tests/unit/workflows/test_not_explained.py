"""A model that lacks something, from the end of its fit to its exports: what is said of it, and how often."""

import re
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

from fakes.lag_kind import SIGMA, write_lag
from fakes.shells import words_of
from sysid.api import load_fit
from sysid.errors import SysidWarning
from sysid.trust import influence
from sysid.trust.documents import TrustDocument
from sysid.workflows import fit as walk
from sysid.workflows.export_models import export_sets
from sysid.workflows.options import FitOptions
from sysid.workflows.show import print_fit


@pytest.fixture
def fit(tmp_path, capsys):
    """Fit steps from a speed that the lag does not know; a bound cuts the time constant that makes up.

    What is noticed as it comes (`heard`) and what is printed at the end (`printed`) are lines.
    """

    def call(noise=SIGMA, **options):
        path = write_lag(tmp_path, offset=-0.8, noise=noise)
        bounds = '[parameters.bounds]\ntime_constant = ["0.01 s", "0.12 s"]\n'
        path.write_text(path.read_text(encoding="utf-8") + bounds, encoding="utf-8")
        heard = []
        options = FitOptions(out=tmp_path / "fit", quiet=True, **options)
        result, folder = walk.fit_campaign(path, options, say=heard.append)
        capsys.readouterr()
        print_fit(result, folder, False)
        printed = capsys.readouterr().out.splitlines()
        return SimpleNamespace(result=result, folder=folder, heard=heard, printed=printed)

    return call


def test_no_trial_is_to_be_dropped_before_the_terms_were_tried(fit, monkeypatch):
    monkeypatch.setattr(influence, "HANGS", 0.0)
    lines = [line for line in fit().heard if "bends every parameter" in line or "hangs on" in line]
    assert len(lines) >= 2
    for line in lines:
        assert "; a term that the model lacks does that: try sysid explain first [" in line
        assert "validate" not in line


def test_commands_to_run_next_quote_a_path_with_a_space(fit, capsys):
    print_fit(fit().result, Path("my fits/ü"), False)
    printed = capsys.readouterr().out
    for verb in ("report", "explain"):
        line = next(line for line in printed.splitlines() if f"sysid {verb} " in line)
        assert words_of(line)[:3] == ["sysid", verb, str(Path("my fits/ü"))]


@pytest.mark.parametrize("bad", [1, None])
def test_one_bad_trial_is_named_and_right_ones_are_not(tmp_path, bad):
    path = write_lag(tmp_path, names=tuple(f"step-{k}" for k in range(6)))
    if bad is not None:
        table = pd.read_csv(tmp_path / f"{bad}.csv")
        table["speed [rad/s]"] *= 1.3
        table.to_csv(tmp_path / f"{bad}.csv", index=False)
    heard = []
    walk.fit_campaign(path, FitOptions(out=tmp_path / "fit", quiet=True), say=heard.append)
    accused = [line for line in heard if "noise explains the others without" in line]
    assert len(accused) == (bad is not None)
    assert all("others without step-1: " in line and "measure" not in line for line in accused)


@pytest.mark.parametrize(
    ("noise", "trust", "ranges"), [(1.0, False, True), (1.0, True, False), (0.02, False, False)]
)
def test_a_spread_of_the_sets_is_stated_where_no_interval_is_and_noise_explains(
    fit, monkeypatch, noise, trust, ranges
):
    asked = []
    monkeypatch.setattr(walk, "loose_findings", lambda *given: asked.append(given[-1]) or ())
    fit(noise=noise, trust=trust)
    assert asked == [ranges]


def test_not_explained_is_said_first_and_last_with_one_number(fit):
    done = fit(finish="none", max_generations=400)
    printed = (re.fullmatch(r"warning: (.*) \[[a-z-]+\]", line) for line in done.heard)
    warned = [line[1] for line in printed if line]
    (first,) = (line for line in warned if "not explained" in line)
    (last,) = (line for line in done.printed if "not explained" in line)
    assert ": not explained, NRMSE " in last
    # The trust goes on from the best set to where the sum of squares is least, which has other numbers.
    stated = TrustDocument.read(done.folder)
    assert stated.adequacy.sentence != first
    assert [line for line in stated.warnings if "not explained" in line] == [first]
    assert load_fit(done.folder).warnings == tuple(warned)
    for words in (
        "; no parameter is well known; not interpretable: time constant; not identifiable: gain; ",
        f"; {len(warned)} warnings",
    ):
        assert words in last


@pytest.mark.parametrize("trust", [False, True])
def test_a_model_is_not_blamed_before_a_run_of_the_search_has_ended(fit, run, trust):
    cut = fit(trust=trust, max_evaluations=30)
    (said,) = (line for line in cut.heard if "not explained" in line)
    assert "; no run of the search has ended by itself, so a better fit is likely [" in said
    assert "the model lacks something" not in said
    assert cut.result.provenance["adequacy"]["symptoms"] == []
    if trust:
        judged = TrustDocument.read(cut.folder).adequacy
        assert (judged.verdict, judged.symptoms) == ("not_explained", [])
        assert "the model lacks something" not in judged.sentence
    code, out, _ = run("validate", cut.folder, cut.folder.parent / "lag.toml")
    assert code == 3
    assert "fixed values are wrong" not in out
    assert "so a better fit is likely" in out


def test_without_intervals_no_digits_of_a_symptom_are_printed_or_exported(fit, run, tmp_path):
    done = fit(trust=False)
    out = run("show", done.folder)[1]
    assert out.count("not explained") == 1
    assert out.startswith("not explained: NRMSE ")
    rows = [line.split() for line in out.splitlines() if line.startswith(" time_constant [s]")]
    assert [row[2:4] for row in rows[:2]] == [["not", "interpretable"]] * 2
    assert "0.12*" not in out
    (last,) = (line for line in done.printed if line.startswith("verdict: "))
    assert "; no parameter is well known; not interpretable: time constant; " in last
    with pytest.warns(SysidWarning, match="does not explain"):
        (file,) = export_sets(done.folder, tmp_path / "sets.csv")
    (row,) = (
        line
        for line in file.read_text(encoding="utf-8-sig").splitlines()
        if line.startswith("parameter,time_constant")
    )
    assert ",not_interpretable," in row
