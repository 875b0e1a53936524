"""Which parameters a gear campaign may free, and between which bounds, on either surface."""

import shutil

import pytest

from fakes.places import SAMPLES
from sysid.campaign import read_campaign
from sysid.errors import CampaignError, SysidWarning
from sysid.gear.model import PARAMETERS, SURFACES, parameters_on
from sysid.gear.problem import GearProblem, gear_space, on_surface
from sysid.gear.story import notice_defaults
from sysid.workflows.check import check_campaign


def opened(tmp_path, surface, text="", stated=""):
    source = (SAMPLES / f"gear-{surface}" / "campaign.toml").read_text(encoding="utf-8")
    path = tmp_path / "campaign.toml"
    source = source.replace("[fit]\n", f"{text}\n[fit]\n").replace("[surface]\n", f"[surface]\n{stated}\n")
    path.write_text(source, encoding="utf-8", newline="\n")
    return read_campaign(path, "gear")


@pytest.mark.parametrize("surface", ["lf", "hf"])
@pytest.mark.parametrize(
    ("name", "law"),
    [("static_friction_excess", "hf"), ("slip_regularization", "lf"), ("thrust_point_dx", None)],
)
def test_what_no_drop_depends_on_cannot_be_free(surface, name, law, tmp_path):
    campaign = opened(tmp_path, surface, f'[parameters]\nfree = ["joint_dx", "{name}"]\n')
    if surface == law:
        assert [row.name for row in gear_space(campaign).found] == ["joint_dx", name]
        return
    with pytest.raises(CampaignError, match=rf"parameters\.free: .*'{surface}' depends on {name}; remove it"):
        gear_space(campaign)


def test_bounds_are_the_surfaces_own(tmp_path):
    stated = '[parameters.bounds]\nkinetic_friction = ["0.3", "0.9"]\n'
    for text, bounds in (("", (0.5, 1.2)), (stated, (0.3, 0.9))):
        space = gear_space(opened(tmp_path, "hf", text))
        row = next(row for row in space.free if row.name == "kinetic_friction")
        assert (row.lower, row.upper) == bounds
    assert (PARAMETERS["kinetic_friction"].lower, parameters_on("lf")["kinetic_friction"].lower) == (0.1, 0.1)
    # Every default of a surface lies within its bounds.
    for surface in SURFACES:
        for row in parameters_on(surface).values():
            assert row.lower <= row.nominal <= row.upper, (surface, row.name)


def test_a_stated_value_that_is_free_is_said_to_be_unused(tmp_path, recwarn):
    campaign = opened(tmp_path, "hf", stated="kinetic_friction = 0.8")
    space = gear_space(campaign)
    assert tuple(row.name for row in space.found) == SURFACES["hf"].free
    with pytest.warns(SysidWarning, match="kinetic_friction is stated in the campaign and free on hf"):
        notice_defaults(GearProblem(campaign, space, ()))
    fixed = opened(
        tmp_path, "hf", '[parameters.fixed]\nkinetic_friction = "0.8"\n', stated="kinetic_friction = 0.8"
    )
    recwarn.clear()
    notice_defaults(GearProblem(fixed, gear_space(fixed), ()))
    assert not [w for w in recwarn if "is stated" in str(w.message)]
    # No drop depends on where the thrust acts.
    assert not [w for w in recwarn if "thrust_point_dx" in str(w.message)]


def test_a_drop_with_an_exact_point_of_its_own_has_no_value_of_the_paper(tmp_path, recwarn):
    path = shutil.copytree(SAMPLES / "gear-lf", tmp_path / "drops") / "campaign.toml"
    first = 'slope = "5 deg"'
    text = path.read_text("utf-8")
    assert text.count(first) == 1
    point = 'point = ["364 mm exact", "430.5 mm exact", "-812.5 mm exact"]'
    path.write_text(text.replace(first, f"{point}\n{first}"), "utf-8")
    campaign = read_campaign(path, "gear")
    space = gear_space(campaign)
    assert "surface_dx[drop-1]" not in space.stated
    notice_defaults(GearProblem(campaign, space, ()))
    assert not [w for w in recwarn if "surface_dx" in str(w.message)]


def test_check_names_what_the_campaign_leaves_to_the_paper(tmp_path):
    path = shutil.copytree(SAMPLES / "gear-lf", tmp_path / "drops") / "campaign.toml"
    lines = path.read_text("utf-8").splitlines()
    path.write_text(
        "\n".join(one for one in lines if not one.startswith(("law =", "kinetic_friction ="))), "utf-8"
    )
    warnings = check_campaign(path, say=lambda sentence: None).warnings
    (warning,) = (one for one in warnings if "values of the paper" in one)
    assert "law lf, kinetic_friction 0.44" in warning


def test_a_stated_value_outside_the_surfaces_bounds_is_refused(tmp_path):
    with pytest.raises(
        CampaignError, match=r"kinetic_friction: 0\.5 to 1\.2 exclude the measured value 0\.44"
    ):
        gear_space(opened(tmp_path, "hf", stated="kinetic_friction = 0.44"))


@pytest.mark.parametrize(
    ("surface", "other", "stated", "fixed", "names"),
    [
        ("lf", "hf", "", "", ("kinetic_friction", "slip_regularization")),
        (
            "hf",
            "lf",
            "kinetic_friction = 0.87",
            '[parameters.fixed]\nstatic_friction_excess = "0.1"\n'
            '[parameters.bounds]\nleg_mass = ["10 g", "30 g"]\n',
            ("kinetic_friction", "static_friction_excess"),
        ),
    ],
)
def test_friction_of_another_surface_is_dropped_and_said(surface, other, stated, fixed, names, tmp_path):
    campaign = opened(tmp_path, surface, fixed, stated=stated)
    moved, (ignored,) = on_surface(campaign, other)
    assert ignored.code == "other-law"
    assert f"ignoring {', '.join(names)}, which the campaign states for {surface}" in ignored.sentence
    # What is not of the surface is kept.
    assert moved.vehicle == campaign.vehicle
    assert moved.parameters.bounds == campaign.parameters.bounds
    assert moved.surface.point == campaign.surface.point
    space = gear_space(
        moved.model_copy(update={"parameters": moved.parameters.model_copy(update={"bounds": {}})})
    )
    assert tuple(row.name for row in space.found) == SURFACES[other].free
    default = parameters_on(other)
    assert all(space.fixed.get(name, default[name].nominal) == default[name].nominal for name in names)
    # The campaign's own law drops nothing.
    assert on_surface(campaign, surface) == (campaign, ())


def test_an_unknown_law_is_refused_with_the_known_ones(tmp_path):
    campaign = opened(tmp_path, "lf")
    with pytest.raises(CampaignError, match="no friction law 'ice'; known are lf, hf"):
        on_surface(campaign, "ice")
    written = campaign.model_copy(update={"surface": campaign.surface.model_copy(update={"law": "ice"})})
    with pytest.raises(CampaignError, match="no friction law 'ice'; known are lf, hf"):
        gear_space(written)
