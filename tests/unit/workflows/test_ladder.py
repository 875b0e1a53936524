"""`sysid ladder` keeps the term that the trials were made with, no other, and writes it into a campaign."""

import json
import tomllib

import numpy as np
import pytest

from fakes.lag_kind import TRUE, write_lag
from sysid.errors import FitError
from sysid.report.ladder import figure_rungs, print_rungs
from sysid.trust.documents import LADDER, read_part
from sysid.workflows.fit import fit_campaign
from sysid.workflows.ladder import climb_ladder, with_free
from sysid.workflows.options import FitOptions

NAMES = tuple(f"step-{k}" for k in range(7))


def fitted(folder, **lag):
    path = write_lag(folder, **lag)
    return path, fit_campaign(path, FitOptions(out=folder / "fit", quiet=True, trust=False))[1]


@pytest.fixture(scope="module")
def lag(tmp_path_factory):
    """A campaign of steps that begin at 0.2 rad/s, six to fit, and its fit, whose model begins at 0."""
    return fitted(tmp_path_factory.mktemp("ladder"), names=NAMES, offset=0.2)


def test_the_missing_term_is_kept_and_adopted(lag, capsys, tmp_path):
    path, folder = lag
    target = path.parent / "with-terms.toml"
    document = climb_ladder(folder, adopt=target)
    assert document["keep"] == ["speed at rest"]
    assert document["parameters"] == ["offset"]
    base, kept = document["base"], document["alone"][0]
    # The logs state no noise, so a ratio counts in units of the assumed one.
    assert base["over_noise"] > 1.5 * kept["over_noise"]
    assert np.mean(kept["left_out"]) == pytest.approx(kept["over_noise"], rel=0.02)
    assert kept["values"]["offset"] == pytest.approx(0.2, abs=0.01)
    assert kept["values"]["time_constant"] == pytest.approx(TRUE["time_constant"], rel=0.02)
    assert read_part(folder, LADDER)["keep"] == document["keep"]
    free = tomllib.loads(target.read_text("utf-8"))["parameters"]["free"]
    assert free == ["gain", "time_constant", "offset"]
    again, _ = fit_campaign(target, FitOptions(out=tmp_path / "fit", quiet=True, trust=False))
    assert again.parameter_sets().set_values()["offset"] == pytest.approx(0.2, abs=0.01)
    print_rungs(document, False, tmp_path / "rungs.png", target)
    assert "keep speed at rest" in capsys.readouterr().out
    labels = figure_rungs(document).axes[0].get_yticklabels()
    assert [label.get_text() for label in labels] == ["as fitted", "speed at rest"]


def test_a_right_model_is_kept_as_it_is(tmp_path):
    path, folder = fitted(tmp_path, names=NAMES)
    document = climb_ladder(folder)
    assert document["keep"] == []
    assert document["alone"][0]["chance"] > 0.05
    with pytest.raises(FitError, match="no term is worth its place"):
        climb_ladder(folder, adopt=path.parent / "nothing.toml")
    assert not (path.parent / "nothing.toml").exists()


def test_refusals(lag, tmp_path, refused):
    path, folder = lag
    refused("write it to", "ladder", folder, "--out", tmp_path / "elsewhere.toml")
    refused("exists", "ladder", folder, "--out", path)
    _, few = fitted(tmp_path, names=NAMES[:5])
    refused("needs 5 or more", "ladder", few)


@pytest.mark.parametrize(
    "text",
    [
        'name = "a"\n[[trials]]\nname = "b"\n',
        'name = "a"\n[parameters]  # chosen\nfixed = { c = "1 s" }\n[[trials]]\nname = "b"\n',
        'name = "a"\n[parameters]\nfree = [\n  "c", # one\n  "d",\n]\nbounds = {}\n[[trials]]\nname = "b"\n',
    ],
)
def test_only_the_free_parameters_of_a_campaign_change(text):
    changed = tomllib.loads(with_free(text, ["x", "y"]))
    expected = tomllib.loads(text)
    expected.setdefault("parameters", {})["free"] = ["x", "y"]
    assert json.dumps(changed, sort_keys=True) == json.dumps(expected, sort_keys=True)
