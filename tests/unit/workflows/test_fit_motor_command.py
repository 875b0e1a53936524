"""A motor fit on the command line: what its record names, and what becomes of it when it is cut short."""

import json
import shutil
import signal
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from fakes.places import SAMPLES
from sysid.campaign import logs
from sysid.fit.store import read_fit
from sysid.journal import Finding, Journal, hear
from sysid.loaders import load
from sysid.motor import follow_up as motor_stages
from sysid.recording import file_sha256
from sysid.workflows.fit import _add_doubts, fit_campaign
from sysid.workflows.options import FitOptions
from sysid.workflows.report import write_report

SEARCH = ("--population", "8", "--runs", "2", "--max-generations", "2", "--finish", "none")
SMALL = ("--no-trust", *SEARCH, "--no-check")
CURVES = ("static-forward.csv", "static-reverse.csv", "no-load-forward.csv", "no-load-reverse.csv")

LEFT_OUT = "{}: the dead band was not fitted; continue it with --resume"


def test_a_parameter_that_is_not_identifiable_is_named_once():
    with Journal() as journal:
        hear(Finding("not-identifiable", "k_d is not", parameters=("viscous_damping",)))
        _add_doubts(journal, [Finding("at-lower-bound", "k_d ends", parameters=("viscous_damping",))])
    assert [(one.code, one.parameters) for one in journal.findings] == [
        ("not-identifiable", ("viscous_damping",))
    ]


@pytest.fixture
def campaign(tmp_path, monkeypatch):
    """A copy of the sample bench logs; results go to a fits/ beside it."""
    shutil.copytree(SAMPLES / "motor", tmp_path / "bench")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "bench" / "campaign.toml"


def document(folder):
    return json.loads((Path(folder) / "fit.json").read_text(encoding="utf-8"))


def test_the_record_names_the_logs_of_the_curves_and_a_changed_one_is_not_continued(campaign, run):
    fit = ("fit-motor", campaign, *SMALL, "--out", "cut", "--time-limit", "0.001 s", "--quiet")
    assert run(*fit)[0] == 0
    logs = document("cut")["provenance"]["logs"]
    by_file = {one["log"]: one["sha256"] for one in logs.values()}
    assert {*CURVES, "forward-1.csv", "reversal-2.h5"} <= {*by_file}
    for name, digest in by_file.items():
        assert digest == file_sha256(campaign.parent / name)
    text = (Path("cut") / "summary.txt").read_text(encoding="utf-8")
    for name in CURVES:
        assert name in text
        assert by_file[name] in text

    # Of the limit nothing was left for what follows the search.
    settings = document("cut")["settings"]
    assert settings["saturation"] == {"fitted": False, "why": "the time limit ended the fit"}
    assert LEFT_OUT.format("the time limit ended the fit") in document("cut")["warnings"]
    assert document("cut")["provenance"]["cut_short"] == "time"

    # The points that it holds are the same: only the hash can tell.
    log = campaign.parent / "static-forward.csv"
    log.write_bytes(log.read_bytes() + b"\r\n")
    code, _, err = run(*fit, "--resume")
    assert code == 2
    assert "log curves.static.forward/static-forward.csv differs" in err


def interrupting(monkeypatch, step):
    """Have Ctrl-C pressed when a step after the search begins."""
    real = getattr(motor_stages, step)

    def begun(*arguments):
        signal.raise_signal(signal.SIGINT)
        return real(*arguments)

    monkeypatch.setattr(motor_stages, step, begun)


def test_ctrl_c_after_the_search_keeps_it_and_resume_does_the_rest(campaign, monkeypatch, run):
    assert run("fit-motor", campaign, *SMALL, "--out", "whole", "--quiet")[0] == 0
    before = signal.getsignal(signal.SIGINT)

    fit = ("fit-motor", campaign, *SMALL, "--out", "cut")
    with monkeypatch.context() as patched:
        interrupting(patched, "fit_saturation")
        code, out, err = run(*fit)
    assert code == 130
    assert signal.getsignal(signal.SIGINT) is before
    assert "fit written to cut (stopped early" in " ".join(out.split())
    assert LEFT_OUT.format("the fit was interrupted") in err
    assert read_fit("cut").state == "stopped"
    assert document("cut")["provenance"]["cut_short"] == "interrupted"

    assert run(*fit, "--resume", "--quiet")[0] == 0
    assert not Path("cut.checkpoint").exists()
    done = document("cut")
    assert done["sets"] == document("whole")["sets"]
    assert done["settings"] == document("whole")["settings"]
    assert "cut_short" not in done["provenance"]

    # The cube's axes are in the search's order, which need not be the table's.
    fit = read_fit("cut")
    axes = fit.provenance["search"]["axes"]
    assert len(axes) == fit.cube.shape[1]
    assert [one.name for one in fit.searched] == axes
    turned = replace(fit, provenance={"search": {"axes": axes[::-1]}})
    assert [one.name for one in turned.searched] == axes[::-1]
    assert replace(fit, provenance={}).searched == ()


@pytest.mark.parametrize(
    ("kind", "trust"),
    # The intervals of the gear take two minutes.
    [("motor", True), ("gear-lf", False), pytest.param("gear-lf", True, marks=pytest.mark.slow)],
)
@pytest.mark.usefixtures("undrawn")
def test_a_fit_opens_each_log_once_and_its_report_once_more(kind, trust, tmp_path, monkeypatch):
    opened = Counter()

    def counted(path, **options):
        opened[Path(path).name] += 1
        return load(path, **options)

    monkeypatch.setattr(logs, "load", counted)
    small = {"population": 8, "runs": 1, "max_generations": 1, "finish": "none", "quiet": True}
    options = FitOptions(out=tmp_path / "fit", check=False, trust=trust, **small)
    _, folder = fit_campaign(SAMPLES / kind / "campaign.toml", options)
    assert len(opened) >= 8
    assert set(opened.values()) == {1}
    write_report(folder)
    assert set(opened.values()) == {2}
