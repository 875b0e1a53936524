"""Synthesized campaigns of drops, as tests open and change them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from sysid.campaign import read_campaign
from sysid.gear.drops import prepare_drops
from sysid.gear.problem import GearProblem, gear_space
from sysid.synthetic import read_truth

# Only the quantization of the files is left.
EXACT = {"noise_position": 0.0, "noise_angle": 0.0, "occlusions": False, "wobble": 0.0}


def opened(folder, new="", old="[fit]\n"):
    """Campaign, prepared drops and true values; `new` stands in the campaign's place of `old`, if stated."""
    path = folder / "campaign.toml"
    if new:
        text = path.read_text(encoding="utf-8")
        assert old in text
        path = folder / "changed.toml"
        new = f"{new}\n{old}" if old == "[fit]\n" else new
        path.write_text(text.replace(old, new, 1), encoding="utf-8")
    campaign = read_campaign(path, "gear")
    return campaign, prepare_drops(campaign, path), read_truth(folder)["parameters"]


def used(drops, use="fit"):
    return tuple(drop for drop in drops if drop.use == use)


def score_values(campaign, drops, values, **options):
    """Score one set of parameter values [SI] on prepared drops; absent names take the campaign's."""
    problem = GearProblem(campaign, gear_space(campaign), drops, **options)
    known = dict(zip(problem.space.table, problem.base, strict=True)) | values
    scored = problem.score(np.array([[known[name] for name in problem.space.table]]))
    cost = problem.cost.mean(scored.by_channel)
    return SimpleNamespace(cost=cost, by_channel=scored.by_channel, failed=scored.cause > 0)


def on_board(problem, length):
    """The problem on a board that ends `length` [m] down-slope of the touchdown."""
    surface = problem.campaign.surface.model_copy(update={"board_length": length})
    return replace(problem, campaign=problem.campaign.model_copy(update={"surface": surface}))
