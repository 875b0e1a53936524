"""`sysid report`: what is refused, what every command offers."""

import json
import os

import pytest
from typer.main import get_command

from fakes.fits import made_fit
from fakes.places import ROOT
from sysid import cli
from sysid.errors import ExportError
from sysid.fit.store import write_fit
from sysid.report.snapshots import check_film


def test_every_command_that_prints_a_result_speaks_json():
    group = get_command(cli.app)
    commands = {**group.commands, **group.commands["synthesize"].commands}
    # A schema is JSON anyway.
    del commands["synthesize"], commands["schema"]
    without = [
        name for name, command in commands.items() if not any("--json" in p.opts for p in command.params)
    ]
    assert without == []


def test_json_of_the_commands_that_list_and_write(tmp_path, run):
    write_fit(made_fit(), tmp_path / "fits" / "a")
    code, out, _ = run("fits", tmp_path / "fits", "--json")
    assert code == 0
    (entry,) = json.loads(out)
    assert (entry["name"], entry["state"], entry["runs"]) == ("a", "done", 5)
    code, out, _ = run("formats", "--json")
    assert "motive-csv" in {row["format"] for row in json.loads(out)}
    target = tmp_path / "sets.json"
    code, out, _ = run("export", tmp_path / "fits" / "a", "--out", target, "--json")
    assert json.loads(out) == {"written": [str(target)]}
    code, out, _ = run("new-campaign", "gear", "--out", tmp_path / "c.toml", "--json")
    assert json.loads(out)["written"] == [str(tmp_path / "c.toml")]


def test_what_report_refuses(tmp_path, refused):
    fit = write_fit(made_fit(), tmp_path / "fit")
    refused("is not there", "report", tmp_path / "nothing")
    there = tmp_path / "there.html"
    there.write_text("mine", encoding="utf-8")
    refused(("exists already", "--force"), "report", fit, "--out", there)
    assert there.read_text(encoding="utf-8") == "mine"
    refused("does not exist", "report", fit, "--out", tmp_path / "no" / "a.html")
    refused("--gif", "report", fit, "--drop", "drop-1")
    refused("found drop-1", "report", fit, "--gif", tmp_path / "a.gif", "--drop", "x")
    refused("fit again", "report", fit, "--gif", tmp_path / "a.gif")
    refused("is a file", "report", fit, "--figure", there)
    refused("--gif writes a .gif file", "report", fit, "--gif", tmp_path / "x.mp4")
    refused("--mp4 writes a .mp4 file", "report", fit, "--mp4", tmp_path / "x.gif")
    both = tmp_path / "a.gif"
    refused("named for two files", "report", fit, "--out", both, "--gif", both)
    refused(("is a folder", "report.html"), "report", fit, "--out", tmp_path, "--force")
    motor = ROOT / "data_samples" / "motor" / "campaign.toml"
    words = ("is a motor campaign, but the fit is a gear fit", "name a gear campaign")
    refused(words, "report", fit, "--against", motor, "--quiet")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fit", "there.html"]


def test_a_film_needs_ffmpeg_or_another_name(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", os.devnull)
    with pytest.raises(ExportError, match=r"ffmpeg was not found.*write a \.gif"):
        check_film(tmp_path / "a.mp4")
    with pytest.raises(ExportError, match=r"expected \.gif or \.mp4"):
        check_film(tmp_path / "a.avi")
    check_film(tmp_path / "a.gif")
