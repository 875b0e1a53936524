"""Synthesized campaigns of drops, as tests open and change them."""

from sysid.campaign import read_campaign
from sysid.gear.drops import prepare_drops
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
