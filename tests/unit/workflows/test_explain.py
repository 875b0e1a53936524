"""`sysid explain` keeps the term that the trials were made with, no other, and writes it into a campaign."""

import json
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fakes.fits import MOTOR, made_fit
from fakes.lag_kind import TRUE, write_lag
from fakes.places import SAMPLES
from fakes.reports import SHORT
from sysid.campaign import read_campaign
from sysid.fit.adequacy import EXPLAINED_BY, NOT_BY
from sysid.fit.store import fit_texts, read_fit, write_fit
from sysid.parameter_sets import ACCUSED
from sysid.recording import file_sha256
from sysid.report.explain import conclusion, figure_rungs, moves_table, rungs_table
from sysid.trust.documents import ExplainDocument, FreeParameter, LadderRung, TrustDocument, write_part
from sysid.workflows.explain import edited
from sysid.workflows.fit import fit_campaign, fit_gear
from sysid.workflows.options import FitOptions
from sysid.workflows.report import open_report

NAMES = tuple(f"step-{k}" for k in range(7))


def fitted(folder, **lag):
    path = write_lag(folder, **lag)
    return path, fit_campaign(path, FitOptions(out=folder / "fit", quiet=True, trust=False))[1]


@pytest.fixture(scope="module")
def lag(tmp_path_factory):
    """A campaign of steps that begin at 0.2 rad/s, six to fit, and its fit, whose model begins at 0."""
    return fitted(tmp_path_factory.mktemp("ladder"), names=NAMES, offset=0.2)


def test_the_missing_term_is_kept_and_adopted(lag, run, tmp_path):
    path, folder = lag
    target, picture = path.parent / "with-terms.toml", tmp_path / "rungs.svg"
    code, out, err = run("explain", folder, "--adopt", target, "--figure", picture)
    assert code == 0, err
    document = ExplainDocument.read(folder)
    assert document.keep == ["offset"]
    assert document.parameters == ["offset"]
    base, kept = document.base, document.alone[0]
    # The logs state no noise, so a ratio counts in units of the assumed one.
    assert base.over_noise > 1.5 * kept.over_noise
    assert np.mean(kept.left_out) == pytest.approx(kept.over_noise, rel=0.02)
    # Of one channel the misfit is the NRMSE; the gain is what is seen to go.
    np.testing.assert_allclose(kept.misfit, kept.left_out, rtol=1e-9)
    assert kept.gain == pytest.approx(np.mean(np.log(base.misfit) - np.log(kept.misfit)))
    assert kept.values["offset"] == pytest.approx(0.2, abs=0.01)
    assert kept.values["time_constant"] == pytest.approx(TRUE["time_constant"], rel=0.02)
    # What is asked for next must not take the place of the fit that the ladder began with.
    assert "keep offset" in out
    again = folder.with_name("fit-with-terms")
    assert f"sysid fit {target} --out {again}" in out.replace("\n", "")
    free = tomllib.loads(target.read_text("utf-8"))["parameters"]["free"]
    assert free == ["gain", "time_constant", "offset"]
    with_term, _ = fit_campaign(target, FitOptions(out=again, quiet=True, trust=False))
    assert with_term.parameter_sets().set_values()["offset"] == pytest.approx(0.2, abs=0.01)
    labels = figure_rungs(document).axes[0].get_yticklabels()
    assert [label.get_text() for label in labels] == ["as fitted", "offset", "kept: offset"]
    assert picture.stat().st_size > 1000
    # It can be read again without computing it again.
    assert "explain: keep offset" in run("show", folder)[1]
    assert run("report", folder)[0] == 0
    assert "offset 0.2" in (folder / "report.html").read_text("utf-8")


def test_a_right_model_is_kept_as_it_is(tmp_path, run):
    path, folder = fitted(tmp_path, names=NAMES)
    code, out, err = run("explain", folder, "--out", path.parent / "nothing.toml")
    assert code == 0, err
    document = ExplainDocument.read(folder)
    assert document.keep == []
    assert document.alone[0].chance > 0.05
    assert "What is wrong in the campaign, and missing in the model" in out
    assert "nothing.toml was not written: no term is kept" in out.replace("\n", " ")
    assert not (path.parent / "nothing.toml").exists()


def test_refusals(lag, tmp_path, refused):
    path, folder = lag
    refused("exists", "explain", folder, "--adopt", path)
    refused("unknown figure format '.gif'", "explain", folder, "--figure", tmp_path / "a.gif")
    refused("does not exist", "explain", folder, "--figure", tmp_path / "none" / "a.png")
    (tmp_path / "there.png").touch()
    refused("exists", "explain", folder, "--figure", tmp_path / "there.png")
    _, few = fitted(tmp_path, names=NAMES[:5])
    refused("needs 5 or more", "explain", few)
    # Terms that high friction lacks say nothing of the low friction that the campaign states.
    drops = shutil.copytree(SAMPLES / "gear-lf", tmp_path / "drops") / "campaign.toml"
    _, other = fit_gear(drops, FitOptions(tmp_path / "hf", **SHORT, trust=False), surface="hf")
    words = ["another law", "surface hf", "--campaign"]
    refused(words, "explain", other, "--adopt", drops.with_name("terms.toml"))


def test_a_campaign_is_adopted_in_any_folder_with_its_comments(lag, run, tmp_path):
    path, folder = lag
    (tmp_path / "deep").mkdir()
    target = tmp_path / "deep" / "new.toml"
    assert run("explain", folder, "--adopt", target, "--quiet") == (0, "", "")
    adopted, source = (tomllib.loads(file.read_text("utf-8")) for file in (target, path))
    assert adopted.pop("parameters")["free"] == ["gain", "time_constant", "offset"]
    for one, other in zip(adopted["trials"], source["trials"], strict=True):
        assert (target.parent / one.pop("log")).resolve() == (path.parent / other.pop("log")).resolve()
    source.pop("parameters", None)
    assert adopted == source
    assert read_campaign(target).name == read_campaign(path).name


FREE = (
    'name = "a"\n[parameters]\nfree = [\n  "c", # one [1]\n  "d",\n]\nbounds = {}\n[[trials]]\nname = "b"\n'
)


@pytest.mark.parametrize(
    "text",
    [
        'name = "a"\n[[trials]]\nname = "b"\n',
        'name = "a"\n[parameters]  # chosen\nfixed = { c = "1 s" }\n[[trials]]\nname = "b"\n',
        FREE,
        FREE.replace("[parameters]\n", '[other]\nfree = ["e"]\n[parameters]\n'),
        'parameters.free = ["c"]\n[[trials]]\nname = "b"\n',
        'parameters = { free = ["c"] }\n[[trials]]\nname = "b"\n',
        '[[trials]]\nname = "b"\n["parameters"]\n"free" = ["c"]\n',
    ],
)
def test_free_parameters_and_the_bad_trial_of_a_campaign_change_and_nothing_else(text):
    here = Path("a/campaign.toml")
    changed, expected = tomllib.loads(edited(text, ["x", "y"], ["b"], here, here)), tomllib.loads(text)
    expected.setdefault("parameters", {})["free"] = ["x", "y"]
    expected["trials"][0]["use"] = "validate"
    assert json.dumps(changed, sort_keys=True) == json.dumps(expected, sort_keys=True)
    assert ("# one [1]" in text) <= ("bounds = {}" in edited(text, ["x", "y"], [], here, here))


def ladder_of(parts=False, keep=("slide rubs dry",), verdict=NOT_BY, chance=0.02, kind="gear"):
    """A ladder of two terms over a fit of one parameter, as if 7 trials had been left out."""

    def rung(*terms, misfit, gain=np.nan, chance=np.nan, **values):
        return LadderRung(
            terms=list(terms), values={"leg_axial_stiffness": 6000.0, "foot_dx": 0.2, **values}, nrmse=0.1,
            over_noise=1.4, left_out=[1.4] * 7, misfit=[misfit] * 7, gain=gain, chance=chance,
            kept=bool(terms) and terms == keep,
        )  # fmt: skip

    dry = rung(
        "slide rubs dry", misfit=1.8, gain=np.log(2.4 / 1.8), chance=chance, leg_slide_friction=0.2911,
        leg_axial_stiffness=6300.0, foot_dx=0.9,
    )  # fmt: skip
    drag = rung("air damps pitch", misfit=2.4, gain=0.0, chance=0.7, pitch_drag=1e-4)
    judged = {
        "verdict": verdict, "sentence": "1.40 × the noise", "nrmse": 0.1, "floor": 0.07, "ratio": 1.4,
        "limits": {}, "channels": [], "phases": [], "symptoms": [],
        "misfit": {
            "channel": "q_B", "channel_ratio": 1.8, "phase": "at rest", "phase_ratio": 2.0, "trial": "drop-1",
            "trial_ratio": 2.0,
        },
    }  # fmt: skip
    return ExplainDocument(
        fit="bench", kind=kind, campaign={"file": "c.toml", "sha256": ""},
        trials=[f"drop-{k}" for k in range(7)], parts=parts, adequacy=judged, base=rung(misfit=2.4),
        alone=[drag, dry], together=[dry],
        symbols={
            "leg_axial_stiffness": "k_h", "foot_dx": "dx_f", "leg_slide_friction": "F_h", "pitch_drag": "c_q",
        },
        units={
            "leg_axial_stiffness": "N/m", "foot_dx": "m", "leg_slide_friction": "N", "pitch_drag": "N·m·s²",
        },
        keep=list(keep), parameters=["leg_slide_friction"] * len(keep), evaluations=10, warnings=[],
        seconds=1.0,
    )  # fmt: skip


def test_terms_are_shown_by_what_judges_them_and_with_the_moves_that_mean_something():
    document = ladder_of()
    lost = FreeParameter.model_construct(name="foot_dx", verdict="not_identifiable")
    trust = TrustDocument.model_construct(parameters=[lost])
    rows = [[cell.text for cell in row] for row in rungs_table(document).rows]
    assert [row[0] for row in rows] == [
        "as fitted", "slide rubs dry", "air damps pitch", "kept: slide rubs dry",
    ]  # fmt: skip
    assert rows[1][1:] == ["1.4", "1.8", "25.0", "0.02", "yes"]
    assert rows[2][5:] == ["no"]
    moves = [row[1].text for row in moves_table(document, trust).rows]
    told = document.model_copy(
        update={"meanings": {"pitch_drag": "Moment against turning.", "x": "Not here."}}
    )
    caption = moves_table(told, trust).caption
    assert ("c_q: Moment against turning" in caption, "Not here" in caption) == (True, False)
    assert moves == ["F_h 0.291 N, k_h +5 %", "c_q 0.0001 N·m·s²", "F_h 0.291 N, k_h +5 %"]
    assert "dx_f +350 %" in moves_table(document).rows[0][1].text
    bars = figure_rungs(document).axes[0].lines[0]
    np.testing.assert_allclose(bars.get_xdata(), 2.4)
    assert "each trial as" in rungs_table(document).caption
    assert "each part of a trial as" in rungs_table(ladder_of(parts=True)).caption
    # The kept term of this ladder is the one that was fitted alone; the other has a chance of its own.
    assert "beside the others" not in rungs_table(document).caption
    beside = [document.together[0].model_copy(update={"chance": 1e-9})]
    assert "beside the others" in rungs_table(document.model_copy(update={"together": beside})).caption


def test_a_conclusion_never_calls_a_wrong_model_right():
    document = ladder_of(keep=(), chance=0.2)
    said = conclusion(document)
    assert said[0] == (
        "7 trials cannot show which term is missing; the nearest is slide rubs dry, with a chance of 0.2 "
        "and a gain of 25.0 %"
    )
    assert said[1] == (
        "the model still lacks something: 1.40 × the noise is left that no error of the measured inputs "
        "explains, 1.80 × in q_B"
    )
    assert "fit more trials" in said[2]
    assert "7 parts of trials cannot" in conclusion(ladder_of(keep=(), parts=True))[0]
    assert conclusion(ladder_of(keep=(), verdict=EXPLAINED_BY))[-1].endswith("keep the model")
    assert conclusion(ladder_of(verdict=EXPLAINED_BY)) == ["keep slide rubs dry"]
    assert conclusion(ladder_of())[1].startswith("the model still lacks something")


@pytest.mark.parametrize("made", [{}, {"keep": ()}, {"keep": (), "verdict": EXPLAINED_BY}])
def test_a_simpler_model_that_predicts_as_well_takes_belief_from_what_it_lacks(made):
    document = ladder_of(**made)
    less = {"terms": ["without offset"], "values": {"leg_axial_stiffness": 6000.0}}
    served, needed = (document.base.model_copy(update={**less, "kept": kept}) for kept in (False, True))
    last = "without offset predicts what was left out as well: do not believe the fitted dx_f"
    before = conclusion(document)
    assert conclusion(document.model_copy(update={"simpler": [served]})) == [*before, last]
    assert conclusion(document.model_copy(update={"simpler": [needed]})) == before


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("kind", ["gear", "motor"])
def test_a_report_shows_the_ladder_and_takes_it_for_no_validation(kind, tmp_path, run):
    folder = tmp_path / "fit"
    if kind == "gear":
        fit_campaign(SAMPLES / "gear-lf" / "campaign.toml", FitOptions(folder, **SHORT, trust=False))
    else:
        write_fit(made_fit(MOTOR), folder)
    assert f"run sysid explain {folder}" in open_report(folder).section("What the model lacks").text
    write_part(folder, ladder_of(kind=kind), {})
    figures = tmp_path / "figures"
    code, _, err = run("report", folder, "--quiet", *(("--figure", figures) if kind == "motor" else ()))
    assert code == 0, err
    assert (figures / "ladder.pdf").is_file() == (kind == "motor")
    page = (folder / "report.html").read_text("utf-8")
    assert "What is wrong in the campaign, and missing in the model" in page
    assert "keep slide rubs dry" in page
    assert "validation on ladder" not in page
    shown = run("show", folder)[1]
    assert f"explain: keep slide rubs dry; all of it: sysid report {folder}" in shown.replace("\n", "")


def test_a_fit_that_accuses_its_campaign_is_read_again(lag):
    """An assessment writes its accusation into fit.json, and fit.h5 stays as it is."""
    fit = read_fit(lag[1])
    accused = replace(fit, settings={**fit.settings, ACCUSED: ["the trials ask for another gain"]})
    for name, content in fit_texts(accused, file_sha256(lag[1] / "fit.h5")).items():
        (lag[1] / name).write_bytes(content)
    assert read_fit(lag[1]).parameter_sets().names == fit.parameter_sets().names
