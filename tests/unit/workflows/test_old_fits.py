"""Fits of older versions lack newer keys: a command that reads one opens it, or refuses in a sentence."""

import json
import shutil
from pathlib import Path

import h5py
import pytest

import sysid
from fakes.lag_kind import write_lag
from fakes.places import SAMPLES


@pytest.fixture(scope="module")
def lag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lag")
    path = write_lag(folder)
    sysid.fit_campaign(path, folder / "fit", runs=2, population=16, max_generations=10)
    return path, folder / "fit"


def without(*names):
    def change(stated):
        part = stated
        for name in names[:-1]:
            part = part[name]
        for one in part if isinstance(part, list) else [part]:
            one.pop(names[-1])

    return change


def intervals(stated):
    # Older exports state intervals without a verdict.
    rows = stated["settings"].setdefault("intervals", {"gain": {}})
    rows["gain"] = {"interval_95": [1.0, 2.0]}


MOTOR = SAMPLES / "published/published-motor.json"
KEPT = sorted((Path(__file__).parents[2] / "data/old-fits").iterdir())


@pytest.mark.parametrize("kept", KEPT, ids=lambda path: path.name)
def test_a_fit_of_every_released_version_is_read(kept, tmp_path, run):
    """Two drops of the samples, fitted and assessed by that version; the numbers are what it printed."""
    fit = sysid.load_fit(kept)
    assert fit.sets.best["k_h"] == pytest.approx(7072.979, rel=1e-6)
    assert fit.result.nrmse == pytest.approx([0.1184544, 0.1213034], rel=1e-6)
    judged = fit.sets.judged["leg_axial_stiffness"]
    assert judged.interval_95 == pytest.approx([6363.945, 6825.142], rel=1e-6)
    assert fit.verdict.startswith("not explained, NRMSE 11.84 %")
    assert [trial.use for trial in fit.result.trials] == ["fit", "fit", "validate"]
    assert sysid.load_parameter_sets(kept / "fit.json") == fit.sets
    copy = shutil.copytree(kept, tmp_path / "copy")
    for command in (
        ("show", copy), ("report", copy), ("export", copy, "--out", tmp_path / "sets.json"),
        ("export", copy, "--out", tmp_path / "drone.xml"), ("fits", tmp_path),
        ("simulate", copy, "--motor", MOTOR, "--slope", "20 deg", "--speed", "0.5 m/s"),
    ):  # fmt: skip
        code, _, said = run(*command)
        assert code == 0, (command, said)


CHANGES = {
    "no adequacy": without("provenance", "adequacy"),
    "no channels": without("provenance", "adequacy", "channels"),
    "no autocorrelation": without("provenance", "adequacy", "channels", "autocorrelation"),
    "no ratio": without("provenance", "adequacy", "ratio"),
    "no findings": without("provenance", "findings"),
    "no search": without("provenance", "search"),
    "no campaign": without("provenance", "campaign"),
    "no logs": without("provenance", "logs"),
    "no provenance": lambda stated: stated["provenance"].clear(),
    "no settings": lambda stated: stated["settings"].clear(),
    "bare intervals": intervals,
}


def older(fit, target, change):
    """Write a copy of a fit whose files state what `change` leaves of it."""
    shutil.copytree(fit, target)
    with h5py.File(target / "fit.h5", "r+") as file:
        stated = json.loads(file["metadata_json"].asstr()[()])
        change(stated)
        del file["metadata_json"]
        file["metadata_json"] = json.dumps(stated)
    stated = json.loads((target / "fit.json").read_text(encoding="utf-8"))
    change(stated)
    stated.pop("sha256", None)
    (target / "fit.json").write_text(json.dumps(stated), encoding="utf-8")
    return target


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", CHANGES)
def test_every_reading_command_opens_or_refuses_it(lag, tmp_path, run, name):
    path, fit = lag
    # Beside the fit, from where the campaign is found.
    old = older(fit, fit.parent / name.replace(" ", "-"), CHANGES[name])
    commands = [("show", old), ("show", old / "fit.json"), ("report", old), ("fits", fit.parent)]
    commands += [
        ("export", old, "--out", tmp_path / f"sets{end}") for end in (".json", ".csv", ".h5", ".mat")
    ]
    if name in ("no adequacy", "no campaign", "no provenance", "no settings"):
        commands += [("compare", old, fit, "--no-cross"), ("validate", old, path), ("cross-validate", old)]
        commands += [("trust", old, "--resamples", "0")]
    refused = []
    for command in commands:
        code, _, said = run(*command)
        assert code in (0, 2, 3), (command, said)
        if code == 2:
            refused.append((command[0], said))
            assert said.count("error: ") == 1, said
    # Without a campaign nothing can be simulated again.
    needs = {"compare", "cross-validate", "trust"}
    lost = name in ("no campaign", "no provenance")
    assert {command for command, _ in refused} == (needs & {c[0] for c in commands} if lost else set()), (
        refused
    )
    fit = sysid.load_fit(old)
    assert fit.verdict
    assert fit._repr_html_()


def test_a_fit_without_adequacy_is_not_called_explained(lag):
    old = sysid.load_fit(older(lag[1], lag[1].parent / "old", CHANGES["no adequacy"]))
    assert old.verdict.startswith("not compared with the noise, NRMSE ")
    assert "explained" not in old.verdict
