"""Nothing that came in a file executes or reaches outside: hostile names go through every output."""

import csv
import io
import json
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import pytest

from fakes.fits import full_fit
from fakes.hostile import HIDDEN, VISIBLE, Page
from fakes.lag_kind import write_lag
from fakes.places import SAMPLES
from sysid.errors import CampaignError, printable
from sysid.export import load_parameter_sets
from sysid.fit.store import read_fit, write_fit
from sysid.report.html import joined, page
from sysid.workflows.check import check_campaign
from sysid.workflows.export_models import export_sets
from sysid.workflows.fit import fit_campaign
from sysid.workflows.options import FitOptions, ReportOptions, TrustOptions
from sysid.workflows.predict import validate_fit
from sysid.workflows.report import open_report, write_report
from sysid.workflows.trust import assess_fit

SEARCH = "runs = 2\npopulation = 16\nmax_generations = 10\n"


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A campaign whose trials have hostile names, its fit, and everything that lies in their folder."""
    folder = tmp_path_factory.mktemp("hostile") / "a" / "b" / "c" / "d"
    folder.mkdir(parents=True)
    path = write_lag(folder, SEARCH, VISIBLE)
    fit = fit_campaign(path, FitOptions(out=folder / "fit", quiet=True, trust=False))[1]
    validate_fit(fit, path)
    assess_fit(fit, TrustOptions(resamples=5))
    write_report(fit, ReportOptions(figure=folder / "figures"))
    return path, fit


def test_pages_have_no_element_of_a_name(fitted):
    _, fit = fitted
    plain = fit.parent / "plain"
    path = write_lag(fit.parent, SEARCH, [f"step-{k}" for k in range(len(VISIBLE))])
    fit_campaign(path, FitOptions(out=plain, quiet=True, trust=False))
    expected = Page(write_report(plain, ReportOptions())["report"].read_text(encoding="utf-8"))
    found = Page((fit / "report.html").read_text(encoding="utf-8"))
    assert (found.scripts, found.handlers, found.policies) == (expected.scripts, [], expected.policies)
    assert found.policies[0].startswith("default-src 'none'")
    assert found.links == expected.links
    # The words are on the page all the same.
    text = (fit / "report.html").read_text(encoding="utf-8")
    assert "&lt;script&gt;document.title" in text
    assert "{{ 7 * 7 }}" in text
    # A notebook shows the same sections.
    report = open_report(fit)
    cells = Page(page("cells", joined([report.section(title) for title in report.section_titles()])))
    assert (cells.scripts, cells.handlers) == (expected.scripts, [])


def test_nothing_is_written_outside(fitted):
    path, _ = fitted
    folder = path.parent
    outside = {file for file in folder.parents[3].rglob("*") if folder not in (file, *file.parents)}
    assert {file.name for file in outside} == {"a", "b", "c"}
    names = {file.name for file in folder.rglob("*")}
    assert not [name for name in names if set(name) & set("<>{}=$\"'| ")], names


def test_every_file_of_sets_reads_back_to_the_same_names(fitted, tmp_path):
    sets = read_fit(fitted[1]).parameter_sets()
    assert sets.trials == VISIBLE
    for name in ("sets.csv", "sets.json", "sets.h5", "sets.mat"):
        export_sets(fitted[1], tmp_path / name)
        assert load_parameter_sets(tmp_path / name).trials == VISIBLE
    text = (tmp_path / "sets.csv").read_text(encoding="utf-8-sig")
    cells = [cell for row in csv.reader(io.StringIO(text, newline="")) for cell in row]
    numbers = [cell for cell in cells if cell.startswith(("=", "+", "-", "@"))]
    for number in numbers:
        float(number)


def test_models_of_simulators_are_sound_xml(tmp_path):
    published = load_parameter_sets(SAMPLES / "published" / "published-motor.json")
    for number, name in enumerate((*VISIBLE, *HIDDEN)):
        sets = replace(published, name=name)
        (tmp_path / "sets.json").write_text(sets.document().text(), encoding="utf-8")
        (file,) = export_sets(tmp_path / "sets.json", tmp_path / f"{number}.sdf", rank=1)
        (model,) = ElementTree.parse(file).getroot()
        assert [element.tag for element in model] == ["plugin"] * 4
        assert model.get("name").split() == printable(f"{name}-1").split()


def test_a_terminal_shows_what_would_move_its_cursor(run, tmp_path):
    fit = full_fit()
    trials = [replace(trial, name=name) for trial, name in zip(fit.trials, HIDDEN, strict=False)]
    folder = write_fit(replace(fit, trials=tuple(trials), warnings=HIDDEN), tmp_path / "fit")
    code, out, err = run("show", folder)
    assert code == 0, err
    assert not {"\x1b", "\u202e", "\0", "\r"} & set(out + err)
    assert "\\u001b[31mred" in out
    code, out, _ = run("show", folder, "--json")
    assert [trial["name"] for trial in json.loads(out)["trials"]] == list(HIDDEN[: len(trials)])
    code, _, err = run("show", "no\x1b[31m\u202esuch")
    assert code == 2
    assert not {"\x1b", "\u202e"} & set(err)


@pytest.mark.parametrize("name", HIDDEN)
def test_a_campaign_refuses_names_that_cannot_be_read(tmp_path, name):
    path = write_lag(tmp_path, SEARCH, [name, "step-1"])
    with pytest.raises(CampaignError) as refusal:
        check_campaign(path)
    assert "trials[" in str(refusal.value)
