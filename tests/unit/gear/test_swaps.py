"""Exchanged entries of a campaign are named where drops cannot be opened, or touch out of time."""

import shutil
from contextlib import suppress
from functools import partial

import numpy as np
import pytest

from fakes.places import SAMPLES
from sysid.campaign import read_campaign
from sysid.errors import LogError, SysidError
from sysid.gear.drops import prepare_drops
from sysid.gear.problem import GearProblem, gear_space, reaches
from sysid.journal import Journal


def heard(tmp_path, *changes):
    """Sentences on exchanges of the sample drops, whose campaign was changed."""
    path = shutil.copytree(SAMPLES / "gear-lf", tmp_path / "drops") / "campaign.toml"
    text = path.read_text("utf-8")
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    path.write_text(text, "utf-8")
    with Journal() as journal, suppress(SysidError):
        prepare_drops(read_campaign(path, "gear"), path)
    return [finding.sentence for finding in journal.findings if finding.code == "contradicts-swapped"]


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ([('slope = "10 deg"', 'slope = "x"'), ('slope = "15 deg"', 'slope = "10 deg"'),
          ('slope = "x"', 'slope = "15 deg"')], "the slopes (or the logs) of drop-2 and drop-3 exchanged"),
        ([('foot_dx = "105 mm"', 'foot_dx = "151 mm"'), ('foot_dz = "151 mm"', 'foot_dz = "105 mm"')],
         "foot_dx and foot_dz exchanged"),
        ([('"-22 mm"', '"22 mm"')], "the other sign of y in centre_of_mass_offset"),
        ([('foot_dz = "151 mm"', 'foot_dz = "167 mm"')], "foot_dz about 1"),
    ],
)  # fmt: skip
def test_an_exchange_is_named(tmp_path, changes, named):
    (sentence,) = heard(tmp_path, *changes)
    assert f"with {named}" in sentence


@pytest.mark.parametrize("changes", [(), [('slope = "20 deg"', 'slope = "14 deg"')],
                                     [('slope = "20 deg"', 'slope = "31 deg"')]])  # fmt: skip
def test_a_right_campaign_and_one_wrong_slope_are_no_exchange(tmp_path, changes):
    assert heard(tmp_path, *changes) == []


@pytest.mark.parametrize("height", [0.169, 0.133])
def test_drops_are_read_with_the_height_that_fits_them(tmp_path, height):
    path = shutil.copytree(SAMPLES / "gear-lf", tmp_path / "drops") / "campaign.toml"
    text = path.read_text("utf-8")
    path.write_text(text.replace('foot_dz = "151 mm"', f'foot_dz = "{1000 * height:.0f} mm"'), "utf-8")
    campaign = read_campaign(path, "gear")
    # The default error of a ruler is 1 mm, and foot_dz may move by twenty errors.
    with Journal() as journal:
        drops = prepare_drops(campaign, path, partial(reaches, campaign, gear_space(campaign)))
    assert all(drop.touches_in_time for drop in drops)
    assert [drop.feet.dz for drop in drops] == [pytest.approx(0.151, abs=0.003)] * len(drops)
    assert {finding.code for finding in journal.findings if finding.severity == "warning"} == {
        "contradicts-swapped"
    }
    # The search begins there, and what is stated stays what it was.
    space = gear_space(campaign, drops)
    (row,) = (row for row in space.free if row.name == "foot_dz")
    assert row.nominal == drops[0].feet.dz
    assert float(space.stated["foot_dz"]) == pytest.approx(height)
    # A fit of other drops predicts these with the height with which they were read.
    problem = GearProblem(campaign, space, drops)
    assert problem.base[space.table.index["foot_dz"]] == drops[0].feet.dz


def test_the_height_that_is_known_worst_is_moved(tmp_path):
    path = shutil.copytree(SAMPLES / "gear-lf", tmp_path / "drops") / "campaign.toml"
    text = path.read_text("utf-8").replace('foot_dz = "151 mm"', 'foot_dz = "169 ± 0.5 mm"')
    path.write_text(text, "utf-8")
    campaign = read_campaign(path, "gear")
    drops = prepare_drops(campaign, path, partial(reaches, campaign, gear_space(campaign)))
    starts = {row.name: row.nominal for row in gear_space(campaign, drops).free}
    assert starts["foot_dz"] == pytest.approx(0.169)
    assert starts["surface_dz"] == pytest.approx(-0.018, abs=0.003)


def test_a_height_beyond_its_errors_is_not_read(tmp_path):
    path = shutil.copytree(SAMPLES / "gear-lf", tmp_path / "drops") / "campaign.toml"
    text = path.read_text("utf-8").replace('foot_dz = "151 mm"', 'foot_dz = "169 ± 0.5 mm"')
    path.write_text(
        text.replace('"430.5 mm"', '"430.5 ± 0.5 mm"').replace('"-22 mm"', '"-22 ± 0.5 mm"'), "utf-8"
    )
    campaign = read_campaign(path, "gear")
    with pytest.raises(LogError, match=r"a foot is .* below the surface"), Journal():
        prepare_drops(campaign, path, partial(reaches, campaign, gear_space(campaign)))


def test_drops_are_read_with_exchanged_slopes_that_a_fit_can_move(tmp_path):
    path = shutil.copytree(SAMPLES / "gear-lf", tmp_path / "drops") / "campaign.toml"
    text = path.read_text("utf-8").replace('slope = "10 deg"', 'slope = "x"')
    text = text.replace('slope = "12 deg"', 'slope = "10 deg"').replace('slope = "x"', 'slope = "12 deg"')
    path.write_text(text.replace('use = "validate"', 'use = "fit"'), "utf-8")
    campaign = read_campaign(path, "gear")
    with Journal() as journal:
        drops = prepare_drops(campaign, path, partial(reaches, campaign, gear_space(campaign)))
    (sentence,) = (one.sentence for one in journal.findings if one.code == "contradicts-swapped")
    assert "the slopes (or the logs) of drop-2 and drop-7 exchanged" in sentence
    slopes = {drop.name: np.degrees(drop.slope) for drop in drops}
    assert (slopes["drop-2"], slopes["drop-7"]) == (pytest.approx(10), pytest.approx(12))
    space = gear_space(campaign, drops)
    starts = {row.name: np.degrees(row.nominal) for row in space.free if row.name.startswith("slope")}
    assert (starts["slope[drop-2]"], starts["slope[drop-7]"]) == (pytest.approx(10), pytest.approx(12))
    assert np.degrees(space.stated["slope[drop-2]"]) == pytest.approx(12)


@pytest.mark.parametrize(("off", "named"), [(5, False), (7, True), (9, True), (-9, True)])
def test_a_height_is_named_where_feet_touch_out_of_time_and_nothing_else(tmp_path, off, named):
    sentences = heard(tmp_path, ('foot_dz = "151 mm"', f'foot_dz = "{151 + off} mm"'))
    assert all(" exchanged" not in sentence for sentence in sentences)
    assert not named or f"{'less' if off > 0 else 'more'}, or the surface" in sentences[0]


def test_a_height_beyond_its_errors_is_not_moved(tmp_path):
    path = shutil.copytree(SAMPLES / "gear-lf", tmp_path / "drops") / "campaign.toml"
    text = path.read_text("utf-8").replace('foot_dz = "151 mm"', 'foot_dz = "169 mm exact"')
    path.write_text(text, "utf-8")
    refused = pytest.raises(
        LogError, match=r"below the surface .* the likely cause: .* foot_dz about 18 mm less"
    )
    with refused, Journal() as journal, journal.blaming():
        prepare_drops(read_campaign(path, "gear"), path)


def test_a_refusal_names_the_exchange(tmp_path):
    path = shutil.copytree(SAMPLES / "gear-lf", tmp_path / "drops") / "campaign.toml"
    text = path.read_text("utf-8").replace('"105 mm"', '"x"').replace('"151 mm"', '"105 mm"')
    path.write_text(text.replace('"x"', '"151 mm"'), "utf-8")
    blamed = pytest.raises(LogError, match=r"the likely cause: .* foot_dx and foot_dz exchanged")
    with blamed, Journal() as journal, journal.blaming():
        prepare_drops(read_campaign(path, "gear"), path)
