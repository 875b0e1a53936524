"""A campaign is held against what its logs show and against what a vehicle can be."""

import re

import pytest

from sysid.campaign import read_campaign
from sysid.errors import CampaignError, LogError
from sysid.gear.story import GearStory
from sysid.journal import Journal
from sysid.synthetic import synthesize_gear
from sysid.synthetic.gear import LF_DROPS
from sysid.workflows.kinds import find_kind


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return synthesize_gear(tmp_path_factory.mktemp("plausible") / "drop", seed=3, drops=LF_DROPS[2:3])


def noticed(folder, *changes):
    """What `sysid check` notices first of a campaign with texts replaced, and what refuses it, in order."""
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    for before, after in changes:
        text, count = re.subn(before, after, text)
        assert count
    path = folder / "changed.toml"
    path.write_text(text, encoding="utf-8")
    lines = []
    try:
        with Journal(lines.append, "drops") as journal:
            problem = find_kind("gear").open(read_campaign(path, "gear"), path, 1)
            story = GearStory(problem)
            story.quality()
            journal.fold(len(problem.trials))
            story.about()
    except LogError as error:
        lines.append(f"refused: {error}")
    return lines


@pytest.mark.parametrize("stated", [15, 14.6, 15.4])
def test_a_slope_as_well_as_an_inclinometer_tells_it_contradicts_nothing(folder, stated):
    assert noticed(folder, (r'slope = "15 deg"', f'slope = "{stated} deg"')) == []


# Beyond 1.5 deg too steep the drop looks as if its plane were wrong, and at 20 deg
# a foot is below the board: the cause is named before all of them.
@pytest.mark.parametrize(
    ("stated", "symptom"),
    [(13.0, ""), (13.4, ""), (14.0, ""), (16.5, ""), (17.0, "surface plane"), (20.0, "refused")],
)
def test_a_slope_that_the_board_markers_contradict_is_named_first(folder, stated, symptom):
    found, *others = noticed(folder, (r'slope = "15 deg"', f'slope = "{stated} deg"'))
    assert f"the campaign states slope = {stated} deg, the log shows 15.0 deg from markers" in found
    assert any(symptom in other for other in others) or not symptom
    assert all("slope" in other for other in others)


def test_named_markers_say_the_same_as_those_that_inspect_finds(folder):
    named = (r"point = \[.*", 'markers = ["board-1", "board-2", "board-3"]')
    found, *others = noticed(folder, (r'slope = "15 deg"', 'slope = "14 deg"'), named)
    assert "the log shows 15.0 deg from markers" in found
    assert not any("markers" in other for other in others)


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


@pytest.mark.parametrize(
    ("field", "slip", "words"),
    [
        ("body_mass", 1e-3, "sqrt(body_inertia/body_mass)"),
        ("body_inertia", 1e3, "sqrt(body_inertia/body_mass)"),
        ("leg_inertia", 1e3, "leg_inertia"),
        ("thrust_point_dx", 1e3, "thrust_point_dx"),
    ],
)
def test_a_slip_of_a_unit_is_refused(folder, field, slip, words):
    text = (folder / "campaign.toml").read_text(encoding="utf-8")
    value = float(re.search(rf'{field} = "([\d.e-]+)', text)[1])
    with pytest.raises(CampaignError, match=re.escape(words)):
        noticed(folder, (rf'{field} = "[\d.e-]+', f'{field} = "{slip * value:.6g}'))
