"""A motor fit on the command line: what its record names, and what becomes of it when it is cut short."""

import json
import shutil
from pathlib import Path

import pytest
from test_fit_command import SAMPLES, run

from sysid.recording import file_sha256

SMALL = (
    "--population",
    "8",
    "--runs",
    "2",
    "--max-generations",
    "2",
    "--finish",
    "none",
    "--no-check",
    "--quiet",
)
CURVES = ("static-forward.csv", "static-reverse.csv", "no-load-forward.csv", "no-load-reverse.csv")


@pytest.fixture
def campaign(tmp_path, monkeypatch):
    """A copy of the sample bench logs; results go to a fits/ beside it."""
    shutil.copytree(SAMPLES / "motor", tmp_path / "bench")
    monkeypatch.chdir(tmp_path)
    return tmp_path / "bench" / "campaign.toml"


def document(folder):
    return json.loads((Path(folder) / "fit.json").read_text(encoding="utf-8"))


def test_the_record_names_the_logs_of_the_curves_and_a_changed_one_is_not_continued(
    campaign, monkeypatch, capsys
):
    fit = ("fit-motor", campaign, *SMALL, "--out", "cut", "--time-limit", "0.001 s", "--quiet")
    assert run(monkeypatch, capsys, *fit)[0] == 0
    logs = document("cut")["provenance"]["logs"]
    by_file = {one["log"]: one["sha256"] for one in logs.values()}
    assert {*CURVES, "forward-1.csv", "reversal-2.h5"} <= {*by_file}
    for name, digest in by_file.items():
        assert digest == file_sha256(campaign.parent / name)
    text = (Path("cut") / "summary.txt").read_text(encoding="utf-8")
    for name in CURVES:
        assert name in text
        assert by_file[name] in text

    # The points that it holds are the same: only the hash can tell.
    log = campaign.parent / "static-forward.csv"
    log.write_bytes(log.read_bytes() + b"\r\n")
    code, _, err = run(monkeypatch, capsys, *fit, "--resume")
    assert code == 2
    assert "log static-forward.csv (curves.static, forward) differs" in err
