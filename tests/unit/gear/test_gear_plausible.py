"""A campaign is held against what its logs show and against what a vehicle can be."""

import re
import warnings

import pytest

from sysid.campaign import read_campaign
from sysid.errors import SysidWarning
from sysid.synthetic import synthesize_gear
from sysid.synthetic.gear import LF_DROPS
from sysid.workflows.kinds import find_kind


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return synthesize_gear(tmp_path_factory.mktemp("plausible") / "drop", seed=3, drops=LF_DROPS[2:3])


def noticed(folder, *changes):
    """What `sysid check` notices of a campaign with texts replaced."""
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    for before, after in changes:
        text, count = re.subn(before, after, text)
        assert count
    path = folder / "changed.toml"
    path.write_text(text, encoding="utf-8")
    problem = find_kind("gear").open(read_campaign(path, "gear"), path, 1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        problem.quality()
    return [str(each.message) for each in caught if issubclass(each.category, SysidWarning)]


def test_a_right_campaign_contradicts_nothing(folder):
    assert noticed(folder) == []


def test_a_slope_that_the_board_markers_contradict_is_named(folder):
    (found,) = noticed(folder, (r'slope = "15 deg"', 'slope = "12 deg"'))
    assert "the campaign states slope = 12.0 deg, the log shows 15.0 deg from markers" in found


@pytest.mark.parametrize(
    ("field", "factor", "words"),
    [
        ("body_mass", 10.0, ("sqrt(body_inertia/body_mass)", "kg/m³")),
        ("body_mass", 0.1, ("sqrt(body_inertia/body_mass)", "kg/m³")),
        ("body_inertia", 10.0, ("sqrt(body_inertia/body_mass)",)),
        ("body_inertia", 0.1, ("sqrt(body_inertia/body_mass)",)),
    ],
)
def test_a_vehicle_that_cannot_be_is_named(folder, field, factor, words):
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    value = float(re.search(rf'{field} = "([\d.]+)', text)[1])
    found = noticed(folder, (rf'{field} = "[\d.]+', f'{field} = "{factor * value:.6g}'))
    assert len(found) == len(words)
    for word, sentence in zip(words, found, strict=True):
        assert word in sentence
